"""Command lines that no one would write: every command with options of the parser's own list and
hostile values. Each ends with 0, 1 or 2, says what is wrong in lines of its own, without a
traceback or a warning, and writes nowhere but where it was told to.

    python tests/command_lines.py --minutes 1              drawn by the commit
    python tests/command_lines.py '["mtpa", "--speed", ""]'    one of them again

What fails is kept, a line each, in `tests/corpus/commands`, which `tests/test_command_lines.py`
tries again. The seed is the commit, or ``DQFORGE_SEED``.
"""

from __future__ import annotations

import io
import json
import os
import random
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import drawn_cases
import faults
import fuzz
from kept_failures import Campaign

KEPT = Campaign(
    "commands",
    "Command lines that no one would write: 0, 1 or 2, told in lines, nothing written elsewhere",
    "`make fuzz-commands`, `tests/test_command_lines.py`",
)
LONGEST_S = 6.0
_MEMORY = 6 << 30
# What ends by a signal, or asks and answers for long, belongs to other campaigns.
SLOW = 130

NUMBERS = ("", " ", "nan", "-inf", "1e999", "-1", "0", "9" * 400, "1_0", "\u0663", "1e-400")
QUANTITIES = (
    "nan rpm",
    "5 kg",
    "1e400 Ohm",
    "-3000 rpm",
    "50 N m",
    "0 %",
    "101 %",
    "5 \u00b5\u03a9",
)
WORDS = ("x" * 3000, "\u202e\u0000"[:1], "\udcff", "a\nb", "%s{}{0}", "*", "[]", "{", "&a [*a]")
PATHS = (
    *("../out", "../../x/y", "/proc/self/mem", "/dev/null/a", "folder", "dangling", "loop", "~/a"),
    *("empty", "noise", "-", ".", "..", "no/such/place", "written", "a" * 300, "map.csv"),
    *("design.yaml", "study.yaml", "bench.yaml", "log.csv", "cap.csv", "x.svg", "x.csv", "x.png"),
    *("out/x.pdf", "../secret.svg"),
)
SETTINGS = (
    *["machine.resistance=nan", "machine.resistance=", "=", "a=b=c", "machine=[1,2]", "fit={"],
    *["machine.pole_pairs=1e9", "export.prefix=../x", "name=\u202e"],
    "machine.resistance=1e400 Ohm",
    "control.speed.bandwidth=-1 Hz",
    "export={prefix: '/tmp/x'}",
)
LISTS = (
    *("1,2,,", ",", "mtpa,mtpa", "all,", "9x9", "0x0", "-1x3", "100000x100000", "3x", "row:-1"),
    *("row:99999999999999999999", "front", "losses.total < nan", "state = ", "spwm,\u00e9"),
)
NAMED = (faults.DRIVE, "paper002-phase-waveforms", "thor-pmsyrm-5k", "vesc", "cortex-m4", "001")
VALUES = (NUMBERS, QUANTITIES, WORDS, PATHS, SETTINGS, LISTS, NAMED)

# Where a command may write: what these say, and its default.
_PLACES = ("--out", "--plot", "--figures", "--csv", "--into")
_DEFAULTS = ("out", "design")


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, and where links lead."""
    return {
        path.relative_to(folder).as_posix(): os.fsencode(path.readlink())
        if path.is_symlink()
        else path.read_bytes()
        for path in folder.rglob("*")
        if path.is_symlink() or path.is_file()
    }


def commands() -> dict[str, Any]:
    """Those of the parser."""
    from dqforge import cli

    return dict(cli._command().commands)


def drawn(seed: str) -> Iterator[list[str]]:
    """Command lines without end."""
    chance = random.Random(seed)
    known = commands()
    while True:
        name = chance.choice(sorted(known))
        words = [name]
        for option in known[name].params:
            flags = [flag for flag in option.opts if flag.startswith("-")]
            if flags and (chance.random() > 0.25 or option.name == "help"):
                continue
            for _ in range(chance.choice((1, 1, 1, 2)) if flags else 1):
                if flags:
                    words.append(chance.choice(flags))
                if not getattr(option, "is_flag", False):
                    words.append(_value(chance, option))
        if name == "serve":  # which answers until it is ended, unless it is refused
            words += ["--port", chance.choice(("-1", "70000", "nan", "", "9" * 400))]
        yield words[: chance.choice((len(words), len(words), 2))]


def _value(chance: random.Random, option: Any) -> str:
    """More often than not of a kind that gets past the parser."""
    if option.name in {"design", "first", "second"} and chance.random() < 0.7:
        return chance.choice((faults.DRIVE, "design.yaml"))
    if option.name in {"sets", "set"} and chance.random() < 0.8:
        return chance.choice(SETTINGS)
    if option.name in {"out", "plot", "csv", "figures", "folder"} and chance.random() < 0.8:
        return chance.choice(PATHS)
    return chance.choice(chance.choice(VALUES))


class Place:
    """A folder with files of all kinds, in one that nothing may touch."""

    def __init__(self, root: Path) -> None:
        self.root, self.work = root.resolve(), root.resolve() / "work"
        library = fuzz.LIBRARY / f"{faults.DRIVE}.yaml"
        self.files = {
            "design.yaml": library.read_bytes(),
            "study.yaml": faults.STUDY.encode(),
            "bench.yaml": fuzz.BENCH,
            "log.csv": fuzz.LOG,
            "map.csv": fuzz.MAP,
            "cap.csv": fuzz.CAPTURE,
            "empty": b"",
            "noise": bytes(range(256)) * 20,
            "folder/inside": b"kept",
            "written/dqforge-manifest.json": b"{}",
        }

    def ready(self) -> None:
        """Everything as it was."""
        for path in self.root.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
        for name, data in self.files.items():
            (self.work / name).parent.mkdir(parents=True, exist_ok=True)
            (self.work / name).write_bytes(data)
        (self.work / "dangling").symlink_to("nowhere/at/all")
        (self.work / "loop").symlink_to("loop")
        (self.root / "secret.svg").write_bytes(b"kept")
        (self.root / "tmp").mkdir()

    def allowed(self, words: list[str], options: list[Any]) -> list[Path]:
        """Where a command line lets files be."""
        flags = {flag for each in options if f"--{each.name}" in _PLACES for flag in each.opts}
        named = [words[k + 1] for k in range(len(words) - 1) if words[k] in flags]
        named += words[1:] if words[0] in {"new", "serve"} else []
        named += words[1:] if words[0] == "explore" else []  # a study's folder may be looked into
        named += [*_DEFAULTS, "../tmp/matplotlib"]
        places = [self.work / name for name in named if name]
        return [
            *(Path(os.path.normpath(place)) for place in places),
            *(Path(os.path.realpath(place)) for place in places if "\0" not in str(place)),
        ]

    def tried(self, words: list[str]) -> str:
        """Let a command line be; what is wrong with how it ended, empty where nothing is."""
        self.ready()
        before = tree(self.root)
        code, out, err, raised = _run(words, self.work, self.root / "tmp")
        if raised:
            return raised
        if code not in {0, 1, 2, SLOW}:
            return f"code {code}: {err[-300:]!r}"
        if "Traceback" in err + out or "Warning" in err:
            return f"a traceback or warning: {err[-300:]!r}"
        told = err.splitlines()
        if code in {1, 2} and err and not all(line.startswith("dqforge") for line in told):
            return f"code {code}, and not lines of its own: {err[:300]!r}"
        if code == 2 and not err:
            return "code 2, and nothing told"
        options = commands()[words[0]].params
        places = self.allowed(words, options)
        after = tree(self.root)
        changed = {
            name for name in before.keys() | after.keys() if before.get(name) != after.get(name)
        }
        stray = [
            name
            for name in sorted(changed)
            if not any((self.root / name).is_relative_to(place) for place in places)
        ]
        return f"elsewhere: {stray[:5]}" if stray else ""


def _run(words: list[str], work: Path, temporary: Path) -> tuple[int, str, str, str]:
    """Exit code, what is said on both streams, and what was raised; in a process of its own, since
    a module whose import the end cuts off would fail in all command lines that follow.
    """
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.setpgid(0, 0)
        with suppress(BaseException), os.fdopen(writing, "w") as answer:
            json.dump(_ran(words, work, temporary), answer)
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        ends = select.select([answer], [], [], 2.0 * LONGEST_S)[0]
        said = answer.read() if ends else ""
    with suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if not ends:
        return SLOW, "", "", ""
    code, out, err, raised = json.loads(said) if said else (97, "", "", "ended without an answer")
    return code, out, err, raised


def _ran(
    words: list[str], work: Path, temporary: Path, longest: float = LONGEST_S
) -> tuple[int, str, str, str]:
    """The same, here."""
    from dqforge import cli

    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", "surrogateescape") for _ in range(2))
    code: Any = 0
    raised = ""
    with _surroundings(work, temporary, longest), redirect_stdout(out), redirect_stderr(err):
        try:
            cli.main(words)
        except SystemExit as left:
            code = left.code or 0
        except KeyboardInterrupt:
            code = SLOW
        except BaseException as error:
            raised = f"raised {type(error).__name__}: {str(error)[:200]}"
    said = []
    for stream in (out, err):
        with suppress(ValueError):
            stream.flush()
        said.append(stream.buffer.getvalue().decode("utf-8", "replace"))
    return code if isinstance(code, int) else 97, said[0], said[1], raised


@contextmanager
def _surroundings(work: Path, temporary: Path, longest: float) -> Iterator[None]:
    """The folder, no terminal, an end after some seconds, and warnings that are errors."""

    def late(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    here, stdin, before = Path.cwd(), sys.stdin, warnings.simplefilter
    heard = signal.signal(signal.SIGALRM, late)
    os.chdir(work)
    tempfile.tempdir = str(temporary)
    sys.stdin = io.StringIO()

    def strict(action: Any, *more: Any, **named: Any) -> None:
        own = any(getattr(kind, "__module__", "").startswith("matplotlib") for kind in more)
        before("error" if action == "ignore" and not own else action, *more, **named)
        before("ignore", ResourceWarning)  # of what is ended late, after some seconds

    vars(warnings)["simplefilter"] = strict
    signal.setitimer(signal.ITIMER_REAL, longest, 0.5)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, heard)
        vars(warnings)["simplefilter"] = before
        sys.stdin, tempfile.tempdir = stdin, None
        os.chdir(here)


def tried(line: str, root: Path) -> str:
    """A line of the corpus again; what is wrong, empty where nothing is."""
    return Place(root).tried(json.loads(line))


def _warmed(folder: Path) -> None:
    """Load what most commands load, once for all of their processes."""
    for words in (["losses", faults.DRIVE], ["run", faults.DRIVE, "--no-verify"]):
        _ran(words, folder, folder, 300.0)


def main(given: list[str]) -> int:
    """The program."""
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    minutes = float(given[1]) if given[:1] == ["--minutes"] else 0.0
    counts: Counter[str] = Counter()
    failed: list[str] = []
    until = time.monotonic() + 60.0 * minutes
    with tempfile.TemporaryDirectory() as folder:
        _warmed(Path(folder))
        place = Place(Path(folder) / "root")
        place.root.mkdir()
        lines = drawn(drawn_cases.seed()) if minutes else iter([json.loads(given[0])])
        for words in lines:
            counts[words[0]] += 1
            if wrong := place.tried(words):
                failed.append(json.dumps(words))
                sys.stdout.write(f"{failed[-1]}: {wrong}\n")
                sys.stdout.flush()
            if time.monotonic() > until:
                break
    if minutes:
        sys.stdout.write(KEPT.ended(counts, failed))
    return int(bool(failed))


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from dqforge.reports.operating_system.system import prepare_process

    prepare_process()
    sys.exit(main(sys.argv[1:]))
