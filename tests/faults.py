"""Whatever happens while a command writes: what it writes is wholly old or wholly new, it says so
in one line, and the next run works.

    python tests/faults.py 1000                        so many, drawn by the commit
    python tests/faults.py 'run kill 0.4312 writing over exchange'     one of them again

A process with everything loaded is forked for each. The fault comes at a step (something below the
folder is opened to be written, made, renamed, removed, flushed, or a compiler is started) or at a
moment, when the command, a worker or the scheduler of its study is killed; both are drawn over the
length of an undisturbed run. What fails is kept, a line each, in `tests/corpus/faults`, which
`tests/test_corpus.py` tries again. The seed is the commit, or ``DQFORGE_SEED``.
"""

from __future__ import annotations

import atexit
import errno
import io
import math
import os
import random
import shlex
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import drawn_cases
import fuzz
import psutil
from kept_failures import Campaign
from study_clusters import Cluster

KEPT = Campaign(
    "faults",
    "Faults while a command writes leave it wholly old or wholly new, said in one line",
    "`make faults`, `tests/test_faults.py`",
)
DRIVE = "paper001-pmsm-bench"
OTHER = "--set machine.resistance=2.2Ohm"
PENDING, MANIFEST = ".dqforge-swap", "dqforge-manifest.json"
LONGEST_S = 120.0

CAPTURE = b"t [ms];u [V];v [V];w [V]\n" + b"".join(
    ";".join(
        f"{x:.5f}" for x in (0.1 * k, *(9 * math.sin(0.0628 * k - 2.0944 * n) for n in range(3)))
    ).encode()
    + b"\n"
    for k in range(500)
)
# A machine of 0.1 Ohm and 10 mWb in both directions.
LOG = b"time [s],id [A],iq [A],uq [V],w [rad/s],T [N m]\n" + b"".join(
    f"{0.1 * k:.2f},0,{i},{0.1 * i + 0.04 * w:.4f},{w},{0.06 * i:.4f}\n".encode()
    for k, (i, w) in enumerate(
        (k % 7 - 3, (20 + 5 * (k % 9)) * (-1) ** (k // 20)) for k in range(40)
    )
)
BENCH = fuzz.BENCH.replace(b"inertia:", b"inductance: 1 mH, inertia:")
STUDY = f"""\
dqforge_study: 1
name: Resistances
design: {DRIVE}
vary:
  machine.resistance: {{range: {{from: 2 Ohm, to: 3 Ohm, count: 22, spacing: linear}}}}
  machine.inertia: {{range: {{from: 1e-4 kg m^2, to: 3e-4 kg m^2, count: 50, spacing: linear}}}}
outputs: [gains.i_q.phase_margin]
"""


@dataclass(frozen=True)
class Command:
    """A command that writes.

    Args:
        words: It, in a folder of its own.
        earlier: What wrote to the same place before.
        setup: What is run before either.
        whole: How it is tried: the whole of it, what it has computed already written, or both.
        once: Whether it refuses to write over what is there.
        parts: Whether what it wrote until a fault is kept, and continued.
        files: What lies there before everything, by name.
        beside: Processes that it works with: ``workers`` of its own, or a ``cluster``.
    """

    words: str
    earlier: str = ""
    setup: tuple[str, ...] = ()
    whole: tuple[bool, ...] = (*[False] * 19, True)
    once: bool = False
    parts: bool = False
    files: tuple[tuple[str, bytes], ...] = ()
    beside: str = ""

    @property
    def always_whole(self) -> bool:
        """Whether it writes while it computes."""
        return False not in self.whole

    @property
    def faults(self) -> tuple[str, ...]:
        """What can happen to it."""
        lost = {"": (), "workers": LOST[:1], "cluster": LOST}[self.beside]
        usual = FAULTS[: -len(LOST)] if not self.beside else (*SIGNALS, *AT_A_MOMENT)
        return tuple(each for each in usual if each != "compiler" or True in self.whole) + lost


WRITING = (False,)
_STUDY_FILE = (("study.yaml", STUDY.encode()),)
_BENCH_FILES = (("bench.yaml", BENCH), ("log.csv", LOG))
_SIGN = "--sign 'cp {} {}.sig'"
_EXPLORE = "explore study.yaml -o out --workers 1"
_EXPORT = f"export {DRIVE} -o out"
_FOR = f"export {DRIVE} --for simplefoc -o out"
COMMANDS = {
    "export": Command(_EXPORT, f"{_EXPORT} {OTHER}"),
    "run": Command(f"run {DRIVE} -o out", f"run {DRIVE} -o out {OTHER}"),
    "beside": Command(f"simulate {DRIVE} -o out", "", (_EXPORT,)),
    "simulate": Command(f"simulate {DRIVE} -o out", f"simulate {DRIVE} -o out {OTHER}"),
    "firmware": Command(_FOR, f"{_FOR} {OTHER}"),
    "into": Command(f"export {DRIVE} --for vesc --into out/bench001_mcconf.xml {OTHER}", "", (
        f"export {DRIVE} --for vesc -o out",
    )),
    "new": Command("new out --template", once=True),
    "schema": Command("schema -o out/schema.json", "schema --study -o out/schema.json"),
    "figure": Command(f"tune {DRIVE} --plot drawn.svg", f"tune {DRIVE} --plot drawn.svg {OTHER}"),
    "data": Command(f"losses {DRIVE} --plot data.csv", f"losses {DRIVE} --plot data.csv {OTHER}"),
    "reproduce": Command("reproduce 002 --figures out", "reproduce 001 --figures out", (), WRITING),
    "estimators": Command(f"estimators {DRIVE} -o out", "", (), WRITING),
    "plan": Command("identify --plan hoverboard-hub -o out"),
    "identify": Command("identify bench.yaml -o out", files=_BENCH_FILES),
    "capture": Command("bemf capture.csv --plot drawn.svg", whole=WRITING, files=(
        ("capture.csv", CAPTURE),
    )),
    "signed": Command(f"{_EXPORT} {_SIGN}", f"{_EXPORT} {OTHER} {_SIGN}"),
    "currents": Command(f"mtpa {DRIVE} --plot drawn.svg", f"mtpa {DRIVE} --plot drawn.svg {OTHER}"),
    "fitted": Command(f"fit {DRIVE} --plot data.csv", f"fit {DRIVE} --plot data.csv {OTHER}"),
    "shaped": Command("dqy paper002-phase-waveforms --plot data.csv", whole=WRITING),
    "explore": Command(_EXPLORE, whole=(True,), parts=True, files=_STUDY_FILE),
    "workers": Command("explore study.yaml -o out --workers 2", whole=(True,), parts=True,
        files=_STUDY_FILE, beside="workers",
    ),
    "cluster": Command("explore study.yaml -o out --scheduler-file ../scheduler.json",
        whole=(True,), parts=True, files=_STUDY_FILE, beside="cluster",
    ),
    "table": Command("explore out --csv rows.csv", "explore out --csv rows.csv --first 2", (
        _EXPLORE,
    ), (True,), files=_STUDY_FILE),
    "winner": Command("explore out --export row:2", "", (_EXPLORE,), (True,), files=_STUDY_FILE),
}  # fmt: skip

# What happens, and the error that every step from there on raises, or one alone.
LASTING = {"full": errno.ENOSPC, "readonly": errno.EROFS, "denied": errno.EACCES}
ONCE = {"broken": errno.EIO, "crowded": errno.EMFILE}
SIGNALS = {
    "kill": signal.SIGKILL,
    "term": signal.SIGTERM,
    "interrupt": signal.SIGINT,
}
AT_A_MOMENT = {"killed": signal.SIGKILL, "terminated": signal.SIGTERM}
LOST = ("worker", "scheduler")
FAULTS = (*LASTING, *ONCE, *SIGNALS, *AT_A_MOMENT, "disk", "two", "compiler", "clock", *LOST)
_SILENT = ("kill", "killed")
# Where nothing can be removed any more, what was begun stays until the next run.
_STUCK = (*_SILENT, "readonly", "denied")


@dataclass(frozen=True)
class Case:
    """One fault: which command, what, where on its way, how much of it is run, over what, and
    whether folders can be exchanged. Its text is what makes it again.
    """

    command: str
    fault: str
    share: float
    whole: bool
    over: bool
    exchange: bool

    def __str__(self) -> str:
        words = ("whole" if self.whole else "writing", "over" if self.over else "new")
        way = "exchange" if self.exchange else "inside"
        return " ".join((self.command, self.fault, f"{self.share:.4f}", *words, way))

    @classmethod
    def read(cls, line: str) -> Case:
        """The case of a text."""
        command, fault, share, whole, over, way = line.split()
        flags = (whole == "whole", over == "over", way == "exchange")
        return cls(command, fault, float(share), *flags)


def drawn(count: int, seed: str, commands: tuple[str, ...] = tuple(COMMANDS)) -> Iterator[Case]:
    """Every command with every fault in turn, at places that the seed gives."""
    chance = random.Random(seed)
    pairs = [
        (command, fault)
        for command in commands
        for fault in COMMANDS[command].faults
        # what compiles, or starts processes, takes ten times as long as what only writes
        for _ in range(1 if COMMANDS[command].beside or fault == "compiler" else 3)
    ]
    chance.shuffle(pairs)
    for k in range(count):
        command, fault = pairs[k % len(pairs)]
        about = COMMANDS[command]
        whole = fault == "compiler" or chance.choice(about.whole)
        over = bool(about.earlier) and chance.random() < 0.7
        yield Case(command, fault, chance.random(), whole, over, chance.random() < 0.7)


def _computes(process: psutil.Process) -> bool:
    """Whether it is a worker, and not what watches over one."""
    return "--multiprocessing-fork" in process.cmdline()


Tree = dict[str, bytes]


def tree(folder: Path) -> Tree:
    """Every file below a folder."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() or path.is_symlink()
    }


def shown(files: Tree) -> Tree:
    """What is not hidden."""
    return {name: content for name, content in files.items() if "/." not in f"/{name}"}


# What happens inside the process.

_CHANGES = ("os.rename", "os.link", "os.mkdir", "os.rmdir", "os.remove", "os.chmod", "os.truncate")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


@dataclass
class Steps:
    """Counts the steps of this process below a folder, and lets something happen at one."""

    root: str
    at: int = 0
    happen: Callable[[str, tuple[Any, ...]], None] | None = None
    lasting: bool = False
    done: int = 0

    def start(self) -> None:
        """From now on."""
        sys.addaudithook(self.audit)
        os.fsync = lambda handle: self.step("fsync", (handle,))  # type: ignore[assignment]

    def audit(self, event: str, given: tuple[Any, ...]) -> None:
        """See what the interpreter is about to do."""
        if event == "open":
            if isinstance(given[0], int) or not (given[2] or 0) & _WRITES:
                return
        elif event == "ctypes.dlsym":
            if given[1] != "renameat2":
                return
        elif event not in _CHANGES and event != "subprocess.Popen":
            return
        if event in ("open", *_CHANGES) and not self._inside(given[0]):
            return
        self.step(event, given)

    def _inside(self, name: object) -> bool:
        if isinstance(name, int):
            return False
        path = os.fsdecode(name) if isinstance(name, (str, bytes, os.PathLike)) else ""
        return not path.startswith("/") or path.startswith(self.root)

    def step(self, event: str, given: tuple[Any, ...]) -> None:
        """One more."""
        self.done += 1
        due = self.done >= self.at if self.lasting else self.done == self.at
        if due and self.happen is not None:
            self.happen(event, given)


def halved(handle: int) -> None:
    """A file loses its second half; a folder has none."""
    about = os.fstat(handle)
    if stat.S_ISREG(about.st_mode):
        os.ftruncate(handle, about.st_size // 2)


def failing(code: int, *, only_new: bool) -> Callable[[str, tuple[Any, ...]], None]:
    """A step that the system refuses; ``only_new`` lets what takes no room pass."""

    def happen(event: str, given: tuple[Any, ...]) -> None:
        free = ("os.remove", "os.rmdir", "os.rename", "os.chmod", "os.truncate", "ctypes.dlsym")
        if event == "subprocess.Popen" or (only_new and event in free):
            return
        if event == "fsync":
            halved(given[0])
            raise OSError(code, os.strerror(code))
        raise OSError(code, os.strerror(code), given[0] if isinstance(given[0], str) else None)

    return happen


def struck(number: int) -> Callable[[str, tuple[Any, ...]], None]:
    """A signal at a step; what is flushed there has lost its second half."""

    def happen(event: str, given: tuple[Any, ...]) -> None:
        if event == "fsync" and number == signal.SIGKILL:
            halved(given[0])
        os.kill(os.getpid(), number)

    return happen


def set_back(_event: str, _given: tuple[Any, ...]) -> None:
    """The clock goes back by a day."""
    now, now_ns = time.time, time.time_ns
    time.time = lambda: now() - 86400.0
    time.time_ns = lambda: now_ns() - 86_400_000_000_000


def happening(case: Case, compiler: Path) -> Callable[[str, tuple[Any, ...]], None] | None:
    """What a step of a case does."""
    if case.fault in LASTING:
        return failing(LASTING[case.fault], only_new=case.fault == "full")
    if case.fault in ONCE:
        return failing(ONCE[case.fault], only_new=case.fault == "crowded")
    if case.fault in SIGNALS:
        return struck(SIGNALS[case.fault])
    if case.fault == "compiler":
        return lambda *_: compiler.unlink(missing_ok=True)
    return set_back if case.fault == "clock" else None


@dataclass(frozen=True)
class Ended:
    """How a process ended; ``steps`` that it made, in ``seconds``."""

    code: int
    err: str
    steps: int
    seconds: float


@dataclass
class Place:
    """A folder to work in, and one for temporary files."""

    root: Path
    answers: dict[str, Any] = field(default_factory=dict)
    clusters: list[Cluster] = field(default_factory=list)

    def cluster(self) -> Cluster:
        """A scheduler with a worker, others in the place of those that were lost."""
        if not self.clusters or self.clusters[-1].scheduler.poll() is not None:
            for lost in self.clusters:
                lost.close()
            found = Cluster(self.root / f"cluster-{len(self.clusters)}")
            self.clusters.append(found)
            atexit.register(found.close)
            found.start_worker()
            shutil.copy(found.file, self.root / "scheduler.json")
        return self.clusters[-1]

    def own(self, child: int) -> list[psutil.Process]:
        """Processes that compute for a command."""
        with suppress(psutil.NoSuchProcess):
            each = psutil.Process(child).children(recursive=True)
            return [one for one in each if _computes(one)]
        return []

    @property
    def work(self) -> Path:
        return self.root / "work"

    def ready(self, files: Tree) -> None:
        """Put this there, and nothing else."""
        for folder in (self.work, self.root / "tmp"):
            folder.mkdir(parents=True, exist_ok=True)
            for path in folder.iterdir():
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path)
                else:
                    path.unlink()
        for name, content in files.items():
            (self.work / name).parent.mkdir(parents=True, exist_ok=True)
            (self.work / name).write_bytes(content)
        compiler = self.root / "compiler"
        compiler.unlink(missing_ok=True)
        if found := shutil.which("cc"):
            compiler.symlink_to(found)

    def begin(self, words: str, steps: Steps, *, whole: bool, exchange: bool, tag: str = "") -> int:
        """Fork a process that runs a command; its number."""
        told = {name: self.root / f"{name}{tag}" for name in ("out", "err", "steps")}
        for path in told.values():
            path.unlink(missing_ok=True)
        if "--scheduler-file" in words:
            self.cluster()
        child = os.fork()
        if child:
            return child
        code = 99
        try:
            code = self._run(words, steps, told, whole=whole, exchange=exchange)
        finally:
            os._exit(code)

    def _run(
        self, words: str, steps: Steps, told: dict[str, Path], *, whole: bool, exchange: bool
    ) -> int:
        from dqforge import cli
        from dqforge.reports.output import folder as output

        for number, name in ((1, "out"), (2, "err")):
            os.dup2(os.open(told[name], os.O_WRONLY | os.O_CREAT, 0o644), number)
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
        os.chdir(self.work)
        os.environ["TMPDIR"] = str(self.root / "tmp")
        tempfile.tempdir = os.environ["TMPDIR"]  # found by trial, it may leave a file of Python's
        if (self.root / "compiler").is_symlink():
            os.environ["DQFORGE_CC"] = str(self.root / "compiler")
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        if not exchange:
            output._can_exchange = lambda *_: False
        original = vars(cli)["respond"]
        if not whole and words in self.answers:
            answer = self.answers[words]
            vars(cli)["respond"] = lambda command, _, *more, **named: original(
                command, lambda: answer, *more, **named
            )
        code: Any = 98
        steps.start()
        try:
            cli.main(shlex.split(words))
        except SystemExit as left:
            code = left.code
        except BaseException:
            import traceback

            traceback.print_exc()
        steps.happen = None
        count = steps.done
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        told["steps"].write_text(str(count), encoding="ascii")
        return code if isinstance(code, int) else 97

    def end(
        self,
        child: int,
        began: float,
        tag: str = "",
        after: float = 0.0,
        strike: Callable[[int], bool] | None = None,
    ) -> Ended:
        """Wait for a process; after some seconds it is struck, again until that has done
        something.
        """
        while True:
            found, status = os.waitpid(child, os.WNOHANG)
            if found:
                break
            passed = time.monotonic() - began
            if strike is not None and passed >= after and strike(child):
                strike = None
            if passed > LONGEST_S:
                os.kill(child, signal.SIGKILL)
            time.sleep(0.002)
        seconds = time.monotonic() - began
        steps, err = self.root / f"steps{tag}", self.root / f"err{tag}"
        return Ended(
            os.waitstatus_to_exitcode(status),
            err.read_text("utf-8", "replace") if err.exists() else "",
            int(steps.read_text() or 0) if steps.exists() else 0,
            seconds,
        )

    def run(self, words: str, *, whole: bool = True, exchange: bool = True) -> Ended:
        """A command without a fault."""
        began = time.monotonic()
        steps = Steps(str(self.root))
        return self.end(self.begin(words, steps, whole=whole, exchange=exchange), began)


class Warm:
    """A command with all that it needs: what it computes, what lies there before and after."""

    def __init__(self, name: str, root: Path) -> None:
        self.about = COMMANDS[name]
        self.place = Place(root / name)
        self.before: dict[bool, Tree] = {}
        self.after: dict[bool, Tree] = {}
        self.lengths: dict[tuple[bool, bool, bool], Ended] = {}
        self.place.ready(dict(self.about.files))
        if name == "schema":
            (self.place.work / "out").mkdir()
        for words in self.about.setup:
            self._must(words)
        self.before[False] = tree(self.place.work)
        if not self.about.beside:
            self._answer(self.about.words)
        if self.about.earlier:
            self._answer(self.about.earlier)
            self.place.ready(self.before[False])
            self._must(self.about.earlier)
            self.before[True] = tree(self.place.work)
        for over, files in self.before.items():
            self.place.ready(files)
            self._must(self.about.words)
            self.after[over] = tree(self.place.work)

    def _must(self, words: str) -> None:
        ended = self.place.run(words, whole=self.about.always_whole)
        if ended.code:
            raise RuntimeError(f"{words}: {ended.err}")

    def _answer(self, words: str) -> None:
        """What a command computes, kept for all that write it, and with everything loaded."""
        from dqforge import cli

        def keep(command: str, ask: Callable[[], Any], *more: Any, **named: Any) -> int:
            answer = self.place.answers[words] = ask()
            return int(original(command, lambda: answer, *more, **named))

        original, here = vars(cli)["respond"], Path.cwd()
        vars(cli)["respond"] = keep
        os.chdir(self.place.work)
        try:
            with redirect_stdout(io.StringIO()):
                cli.main(shlex.split(words))
        except SystemExit as left:
            if left.code:
                raise RuntimeError(words) from None
        finally:
            os.chdir(here)
            vars(cli)["respond"] = original

    def length(self, case: Case) -> Ended:
        """Of an undisturbed run of this kind."""
        kind = (case.whole, case.over, case.exchange)
        if kind not in self.lengths:
            self.place.ready(self.before[case.over])
            self.lengths[kind] = self.place.run(
                self.about.words, whole=case.whole, exchange=case.exchange
            )
        return self.lengths[kind]

    def tried(self, case: Case) -> str:
        """Let a fault happen; what is wrong afterwards, empty where nothing is."""
        usual = self.length(case)
        place, about = self.place, self.about
        before, after = self.before[case.over], self.after[case.over]
        with disk(place.root / "work", case, before, after) as room:
            place.ready(before)
            if case.fault == "clock":
                for path in place.work.rglob("*"):
                    os.utime(path, (time.time() + 86400.0,) * 2, follow_symlinks=False)
            if room:
                room(case.share)
            fault = happening(case, place.root / "compiler")
            steps = Steps(
                str(place.root),
                1 + int(case.share * usual.steps),
                fault,
                case.fault in LASTING,
            )
            began = time.monotonic()
            child = place.begin(about.words, steps, whole=case.whole, exchange=case.exchange)
            if case.fault == "two":
                time.sleep(case.share * usual.seconds)
                second = time.monotonic()
                words = about.earlier or about.words
                other = place.begin(
                    words,
                    Steps(str(place.root)),
                    whole=about.always_whole,
                    exchange=case.exchange,
                    tag="2",
                )
                both = (place.end(child, began), place.end(other, second, "2"))
                wrong = "".join(self.judged(case, ended, two=True) for ended in both)
            else:
                ended = place.end(child, began, "", case.share * usual.seconds, self.striking(case))
                wrong = self.judged(case, ended) or self.running(child)
            if room:
                room(100.0)
            return wrong or self.next_run(case)

    def striking(self, case: Case) -> Callable[[int], bool] | None:
        """What happens at the moment of a case; whether it has."""

        def signalled(child: int) -> bool:
            os.kill(child, AT_A_MOMENT[case.fault])
            return True

        def lost(child: int) -> bool:
            if self.about.beside == "cluster":
                cluster = self.place.cluster()
                one = psutil.Process(cluster.running[-1].pid)
                there = [cluster.scheduler] if case.fault == "scheduler" else one.children()
            else:
                there = self.place.own(child)
            for each in there[:1]:
                with suppress(psutil.NoSuchProcess):
                    each.kill()
            return bool(there)

        if case.fault in AT_A_MOMENT:
            return signalled
        return lost if case.fault in LOST else None

    def running(self, child: int) -> str:
        """What still runs of a command that has ended, after a while."""
        if self.about.beside != "workers":
            return ""
        until, left = time.monotonic() + 20.0, ["?"]
        while left and time.monotonic() < until:
            left = [
                " ".join(one.info["cmdline"])[:80]
                for one in psutil.process_iter(["cmdline", "cwd"])
                if one.info["cwd"] == str(self.place.work) and one.pid != child
            ]
            time.sleep(0.05)
        return f"still running: {left}" if left else ""

    def judged(  # noqa: PLR0911 - one for each fault
        self, case: Case, ended: Ended, *, two: bool = False
    ) -> str:
        """What is wrong with how a process ended, and what it left."""
        silent = case.fault in _SILENT and ended.code == -signal.SIGKILL
        if "Traceback" in ended.err:
            return f"a traceback: {ended.err.strip().splitlines()[-1]}"
        # Before the command began, or when it had ended, nothing of it is there to say so.
        if case.fault == "terminated" and ended.code == -signal.SIGTERM:
            silent = tree(self.place.work) in (self.before[case.over], self.after[case.over])
        if ended.code < 0 and not silent:
            return f"ended by signal {-ended.code} and said {ended.err!r}"
        if ended.code > 0 and not (ended.err.startswith("dqforge") and ended.err.count("\n") == 1):
            return f"code {ended.code} and not one line: {ended.err!r}"
        if ended.code == 0 and ended.err:
            return f"code 0, and said {ended.err!r}"
        found = tree(self.place.work)
        old, new = self.before[case.over], self.after[case.over]
        if self.about.parts:
            return self._parts(ended, found, new)
        said = any(f"{PENDING}/" in f"{name}" for name in found)
        if case.fault == "compiler" and ended.code == 0:  # which the list of hashes names
            found = found | {name: new[name] for name in found.keys() & new if MANIFEST in name}
        stuck = case.fault in _STUCK
        if (
            not two
            and ended.code == 0
            and (shown(found) if stuck else found) != (shown(new) if stuck else new)
        ):
            return f"code 0, and {differing(found, new)}"
        allowed = [new, old] + ([self.before[True]] if two and self.about.earlier else [])
        if not said and not two and shown(found) not in [shown(each) for each in allowed]:
            return f"neither old nor new: {differing(shown(found), shown(new))}"
        if said and case.fault not in _STUCK and not two:
            return f"left half moved: code {ended.code}, {ended.err!r}"
        if case.fault not in _STUCK and not two:
            hidden = found.keys() - shown(found).keys() - old.keys() - new.keys()
            left = [path.name for path in (self.place.root / "tmp").iterdir()]
            if hidden or left:
                return f"left behind: {sorted(hidden)} {left}"
        return ""

    def _parts(self, ended: Ended, found: Tree, new: Tree) -> str:
        wrong = [
            name
            for name, content in shown(found).items()
            if name.endswith(".parquet") and new.get(name) != content
        ]
        if wrong:
            return f"other parts: {wrong}"
        return differing(found, new) if ended.code == 0 else ""

    def next_run(self, case: Case) -> str:
        """What is wrong with the run after it."""
        if case.fault == "two":
            found = shown(tree(self.place.work))
            either = [*self.before.values(), *self.after.values()]
            if found not in [shown(each) for each in either]:
                return f"two runs left a mix: {differing(found, shown(self.after[case.over]))}"
        if (self.place.root / "compiler").parent.is_dir() and not (
            self.place.root / "compiler"
        ).is_symlink():
            (self.place.root / "compiler").symlink_to(str(shutil.which("cc")))
        ended = self.place.run(
            self.about.words, whole=self.about.always_whole, exchange=case.exchange
        )
        found, new = tree(self.place.work), self.after[case.over]
        there = self.about.once and ended.code == 2
        if ended.code and not there:
            return f"the next run: {ended.err!r}"
        if found != new:
            return f"after the next run {differing(found, new)}"
        return ""


def differing(found: Tree, wanted: Tree) -> str:
    """How two trees differ, in a few words."""
    more, less = sorted(found.keys() - wanted.keys()), sorted(wanted.keys() - found.keys())
    other = [name for name in found if name in wanted and found[name] != wanted[name]]
    words = [f"{what} {names[:4]}" for what, names in (
        ("more:", more), ("missing:", less), ("other:", other)
    ) if names]  # fmt: skip
    return "; ".join(words) or ""


@contextmanager
def disk(
    folder: Path, case: Case, before: Tree, after: Tree
) -> Iterator[Callable[[float], None] | None]:
    """A disk of its own for the fault of that name, where the right to mount one is there."""
    if case.fault != "disk" or not can_mount():
        yield None
        return
    folder.mkdir(parents=True, exist_ok=True)
    mount("-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder))
    need = [sum(4096 * (2 + len(content) // 4096) for content in files.values()) for files in (
        before, after
    )]  # fmt: skip

    def leave(share: float) -> None:
        mount(
            "-o", f"remount,size={int(need[0] + share * 1.2 * need[1]) // 1024 + 8}k", str(folder)
        )

    try:
        yield leave
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def mount(*words: str) -> None:
    subprocess.run(["mount", *words], check=True, capture_output=True)


@cache
def can_mount() -> bool:
    """Whether this process may mount a disk."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            mount("-t", "tmpfs", "-o", "size=64k", "tmpfs", folder)
        except (OSError, subprocess.CalledProcessError):
            return False
        subprocess.run(["umount", "-l", folder], check=True)
    return True


@cache
def warm(name: str, root: Path) -> Warm:
    """A command, made once."""
    return Warm(name, root)


def tried(line: str, root: Path) -> str:
    """A case again; what is wrong, empty where nothing is."""
    case = Case.read(line)
    return warm(case.command, root).tried(case)


def main(words: list[str]) -> int:
    """The program."""
    again = len(words) == 1 and not words[0].isdigit()
    count = int(words[0]) if words and not again else 100
    commands = tuple(words[1:]) or tuple(COMMANDS)
    cases = [Case.read(words[0])] if again else list(drawn(count, drawn_cases.seed(), commands))
    failed: list[str] = []
    counts: Counter[str] = Counter()
    took: dict[str, float] = defaultdict(float)
    # Ctrl-C ends it with what has been tried.
    folder = tempfile.TemporaryDirectory(prefix="faults-")
    with folder as root, suppress(KeyboardInterrupt):
        for case in sorted(cases, key=lambda case: case.command):
            began = time.monotonic()
            wrong = tried(str(case), Path(root))
            counts[case.fault] += 1
            if wrong:
                failed.append(str(case))
                sys.stdout.write(f"{case}: {wrong}\n")
                sys.stdout.flush()
            took[case.command] += time.monotonic() - began
    times = ", ".join(f"{name} {took[name]:.0f}" for name in sorted(took))
    sys.stdout.write(f"seconds: {times}\n")
    if not again:
        sys.stdout.write(KEPT.ended(counts, failed))
    return int(bool(failed))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from dqforge.reports.operating_system.system import prepare_process

    prepare_process()
    sys.exit(main(sys.argv[1:]))
