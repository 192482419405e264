"""How many planted changes the tests notice: a mutation score over physics, proofs and emitted C.

A change turns a sign, a factor, a comparison or a constant round, swaps two arguments, or drops a
statement, in a place that a seed draws; the tests then run in a copy of the tree, those first that
come to the place over the fewest names, until one fails, for so many seconds of processor time at
most. What none of them notices is printed. What changes no number stands in
`tests/equivalent_changes.toml`, with the reason, and is not counted.

    python tests/mutants.py 30                 thirty, drawn by the commit
    python tests/mutants.py 30 --within 150    as many of them as are begun in 150 s
    python tests/mutants.py 200 --seed a --against OLD_CHECKOUT
    python tests/mutants.py 100 --seed a --out OLD.json
    python tests/mutants.py 100 --seed a --since OLD.json
    python tests/mutants.py 40 --seed b --evidence
    python tests/mutants.py 40 --only "emitted code" proofs
    python tests/mutants.py 20 --beneath optimizer/losses machines/back_emf
    python tests/mutants.py 100 --again

``--against`` plants the same changes in another checkout too, where their lines stand there once.
``--again`` tries what the page lists as not noticed, and takes out what is noticed now or gone.
``--out`` goes on where an earlier run with the same file ended. ``--since`` asks first the case
that noticed a change in an earlier run; ``--evidence`` adds the counts of a draw to those of
`docs/project/evidence.md`.
"""

from __future__ import annotations

import argparse
import ast
import gc
import hashlib
import itertools
import json
import math
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import callers
import drawn_cases
import house
import kept_output
import kept_values

# What the score is about; words, pages and readers of files are held by other tests.
KINDS = {
    "proofs": r"optimizer/(certificates|box_proofs|axis_margins|speed_box|changing_loops)/",
    "number formats": r"optimizer/fixed_\w+/|optimizer/curves/",
    "formulas": kept_values.PHYSICS,
    "emitted code": r"reports/(?!pages/)\w+/templates/(?!.*(harness|vectors|main\.)).*\.[ch]\.j2$",
}
BINARY = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*"}
COMPARISONS = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
OF_C = {" + ": " - ", " - ": " + ", " * ": " / ", " < ": " >= ", " > ": " <= ", " <= ": " > "}
# Of these the order of the arguments does not matter.
SYMMETRIC = {"min", "max", "minimum", "maximum", "fmin", "fmax", "hypot", "gcd", "lcm", "union1d"}
COLUMNS = (*sorted(KINDS), "all")
EVIDENCE = house.ROOT / "docs/project/evidence.md"
MARKS = "<!-- planted changes -->", "<!-- end of planted changes -->"
EQUIVALENT = Path(__file__).with_name("equivalent_changes.toml")
Span = Callable[["ast.expr | ast.stmt"], tuple[int, int]]
# In place of a case, where the tests can no longer be loaded.
LOADING = "loading"
WAIT_S = 1200.0
# So many files of tests are asked anew of what runs while modules load.
AT_LOAD = 12
# So many kept cases before all else.
FIRST = 5
# Steps that a whole file of tests is taken to be away.
WHOLE_FILE = 2
# Lines on either side of a change whose words say which tests are about it.
AROUND = 20
SECONDS = itertools.count(1)
NUMBER_OF_C = re.compile(r"(?<![\w.])\d+\.\d+F\b")


@dataclass(frozen=True, slots=True)
class Change:
    """One planted change: which characters of which file become what."""

    kind: str
    path: str
    start: int
    end: int
    text: str
    old: str
    line: int
    words: str
    place: int  # of the change in its words

    @property
    def named(self) -> str:
        """What becomes what, on one line."""
        return " ".join(f"{self.old} -> {self.text}".split())

    @property
    def key(self) -> str:
        """The change by the words of its line, wherever that stands in the file."""
        return f"{self.path}: {self.words}: {self.place}: {self.named}"

    @property
    def listed(self) -> str:
        """The change as the page lists what is not noticed."""
        return f"* `{self.path}`: `{self.words}`: `{self.named}`"

    def planted(self, source: str) -> str:
        """The file with the change in it."""
        return source[: self.start] + self.text + source[self.end :]

    def elsewhere(self, mine: str, other: str) -> Change | None:
        """The same change in another version of the file, None where its line is not there once."""
        begin = mine.rfind("\n", 0, self.start) + 1
        line = mine[begin : mine.find("\n", self.end) + 1]
        if other.count(line) != 1:
            return None
        shift = other.index(line) - begin
        return replace(
            self,
            start=self.start + shift,
            end=self.end + shift,
            line=other.count("\n", 0, self.start + shift) + 1,
        )


def kind_of(path: str) -> str | None:
    """Which kind of code a file holds; None for what the score is not about."""
    return next((kind for kind, names in KINDS.items() if re.match(names, path)), None)


def _operator(source: str, left: int, right: int, swaps: dict[str, str]) -> tuple[int, int, str]:
    """Place and opposite of the operator that stands between two operands."""
    found = re.search(r"\*\*|//|[<>=!]=|[-+*/%@<>]", source[left:right])
    if found is None:
        raise KeyError(source[left:right])
    return left + found.start(), left + found.end(), swaps[found.group()]


def _name(function: ast.expr) -> str:
    """What a function is called, without where it comes from."""
    return ast.unparse(function).rpartition(".")[2]


def _swapped(a: tuple[int, int], b: tuple[int, int], source: str) -> tuple[int, int, str]:
    """Two places, each with what stood in the other."""
    return a[0], b[1], source[slice(*b)] + source[a[1] : b[0]] + source[slice(*a)]


def _of_node(node: ast.AST, where: Span, source: str) -> Iterator[tuple[int, int, str]]:
    """Changes of one node: characters from, to, and what they become."""
    match node:
        case ast.BinOp(left=first, right=second, op=ast.MatMult()):
            yield _swapped(where(first), where(second), source)
        case ast.BinOp(left=left, right=right):
            yield _operator(source, where(left)[1], where(right)[0], BINARY)
        case ast.Compare(left=left, comparators=[right], ops=[op]) if not isinstance(
            op, (ast.In, ast.NotIn, ast.Is, ast.IsNot)
        ):
            yield _operator(source, where(left)[1], where(right)[0], COMPARISONS)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            minus, at = where(node)[0], where(operand)[0]
            yield minus, at, source[minus + 1 : at]  # brackets stay
        case ast.Constant(value=float() as value):
            yield *where(node), repr(1.25 * value if value else 1.0)
        case ast.Call(args=[first, second]) if not (
            isinstance(second, ast.Starred) or _name(node.func) in SYMMETRIC
        ):
            yield _swapped(where(first), where(second), source)
        case ast.AugAssign():
            yield *where(node), "pass"
        case ast.Expr(value=ast.Call()):
            yield *where(node), "pass"


def _in_python(source: str) -> Iterator[tuple[int, int, str]]:
    """Every change of a module; docstrings, annotations and imports stay."""
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = source.encode()

    def span(node: ast.expr | ast.stmt) -> tuple[int, int]:
        first = starts[node.lineno - 1] + node.col_offset
        last = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        return len(data[:first].decode()), len(data[:last].decode())

    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for statement in function.body:
            for node in ast.walk(statement):
                try:
                    yield from _of_node(node, span, source)
                except KeyError:
                    continue  # brackets stand between operand and operator


def _in_template(source: str) -> Iterator[tuple[int, int, str]]:
    """Every change of emitted C, outside comments, macros and Jinja."""
    hidden = re.compile(r"/\*.*?\*/|\{[%{#].*?[%}#]\}|^#.*?$", re.DOTALL | re.MULTILINE)
    code = hidden.sub(lambda found: "\0" * len(found.group()), source)
    for words, becomes in OF_C.items():
        for found in re.finditer(re.escape(words), code):
            yield found.start(), found.end(), becomes
    for found in NUMBER_OF_C.finditer(code):
        yield found.start(), found.end(), f"{1.25 * float(found.group()[:-1]) or 1.0}F"


def files(root: Path) -> list[str]:
    """What git knows of a checkout."""
    return subprocess.run(
        ["git", "ls-files"], cwd=root, capture_output=True, text=True, check=True
    ).stdout.split()


def changes(root: Path, names: Iterable[str]) -> list[Change]:
    """Every change that can be planted in these files."""
    found = []
    for name in names:
        kind = kind_of(name)
        if kind is None or not name.endswith((".py", ".j2")):
            continue
        source = (root / name).read_text(encoding="utf-8")
        places = _in_python(source) if name.endswith(".py") else _in_template(source)
        lines = source.splitlines()
        # A function within another is met twice.
        for start, end, text in dict.fromkeys(places):
            line, old = source.count("\n", 0, start) + 1, source[start:end]
            if text != old:
                words = lines[line - 1].strip()
                place = start - source.index(words, source.rfind("\n", 0, start) + 1)
                found.append(Change(kind, name, start, end, text, old, line, words, place))
    return found


def equivalent(found: list[Change], listed: list[dict[str, str]]) -> dict[str, str]:
    """Why changes change no number, by their keys.

    Raises:
        ValueError: An entry of the list is no change that can be planted.
    """
    keys = {change.key for change in found}
    reasons = {
        f"{entry['path']}: {entry['line']}: {entry['place']}: {entry['change']}": entry
        for entry in listed
    }
    for key in reasons:
        if key not in keys:
            raise ValueError(f"{EQUIVALENT.name}: no such change: {key}: take the entry out")
    return {key: entry["reason"] for key, entry in reasons.items()}


def drawn(found: list[Change], number: int, seed: str) -> list[Change]:
    """So many changes: kinds in turn, files of a kind in turn, by the seed."""

    def place(change: Change) -> str:
        named = f"{seed} {change.path} {change.line} {change.old} {change.text}"
        return hashlib.sha256(named.encode()).hexdigest()

    queue = sorted(found, key=place)
    files: Counter[str] = Counter()
    turns = []
    for change in queue:
        files[change.path] += 1
        turns.append((files[change.path], change))
    per_kind: Counter[str] = Counter()
    order = []
    for turn, change in sorted(turns, key=lambda entry: entry[0]):
        per_kind[change.kind] += 1
        order.append((per_kind[change.kind], turn, place(change), change))
    return [change for *_, change in sorted(order, key=lambda entry: entry[:3])[:number]]


@cache
def _loading(path: str) -> frozenset[str]:
    """The modules that load a file, over whatever others; for a template, those beside it, too."""
    module, beside, _ = path.removesuffix(".py").replace("/", ".").partition(".templates.")
    reached = {name for name in house.modules() if name == module or name.startswith(module + ".")}
    if not beside:
        reached = {module}
    wider: set[str] = set()
    while wider != reached:
        reached |= wider
        wider = reached | {name for name, used in house.imports().items() if used & reached}
    return frozenset(reached)


def order(change: Change) -> tuple[str, ...]:
    """What is asked of a change, first what is likeliest to notice it soonest: some of the kept
    cases that come to its function or template, then functions of tests that come to it by name,
    and whole files that import it, over whatever others.

    Steps are counted by name; a whole file is as near as a function that is two steps away. The
    file's own tests, those of its folder, of its room on another floor, and others follow each
    other by a step. Of what is equally near, what is cheap and has the words around the change
    comes first, file by file.
    """
    reached = _loading(change.path)
    module = change.path.removesuffix(".py").replace("/", ".")
    own, (floor, room, *_) = house.own_test(module), change.path.split("/")
    cost = drawn_cases.kept_costs()
    lines = (house.ROOT / change.path).read_text(encoding="utf-8").splitlines()
    around = "\n".join(lines[max(0, change.line - AROUND) : change.line + AROUND])

    @cache
    def worth(test: str) -> float:
        return callers.alike(around, test) / math.sqrt(1.0 + cost.get(test, 0.0))

    def near(case: str) -> tuple[float, float, str, str]:
        test = case.partition("::")[0]
        _, *beside, _ = test.split("/")
        away = 0 if test == own else 3
        if away and beside[1:2] == [room]:
            away = 1 if beside[:1] == [floor] else 2
        return away + by_name.get(case, WHOLE_FILE), -worth(test), test, case

    by_name = callers.cases(change.path, change.line, set(reached))
    files = {test for test, loaded in house.tests().items() if loaded & reached}
    kept = kept_output.making(change.path, change.line)
    kept = [f"{kept_output.TEST}[{case}]" for case in kept]
    return (*kept[:FIRST], *sorted(by_name.keys() | files, key=near), *kept[FIRST:])


@dataclass(frozen=True, slots=True)
class Answer:
    """What tests say of a tree: the case that fails, "" for none, of how many; whether all of them
    ran; whether what changed runs while modules load, so that a new process must be asked.
    """

    failed: str
    cases: int
    whole: bool
    loads: bool


class Loaded:
    """A tree with default tests collected, in a process that answers each question in a fork."""

    def __init__(self, tree: Path, tests: Sequence[str]) -> None:
        self.tree = tree
        self.unfit: set[str] = set()
        self._sound: set[str] = set()
        asked, asking = os.pipe()
        answers, answering = os.pipe()
        loop = Path(__file__).with_name("planted.py")
        self._running = subprocess.Popen(
            # Without the folder of the programme: the helpers are those of the tree.
            [sys.executable, "-P", str(loop), str(asked), str(answering), *tests],
            cwd=tree,
            env=os.environ | {"PYTHONPATH": str(tree.parent), "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(asked, answering),
        )
        os.close(asked)
        os.close(answering)
        self._from = os.fdopen(answers)
        self._to = os.fdopen(asking, "w")

    def ask(self, tests: Sequence[str], seconds: int, path: str = "", source: str = "") -> Answer:
        """What tests say of the tree as it is, of which the module at ``path`` was ``source``."""
        question = {"tests": tests, "seconds": seconds, "path": path, "source": source}
        with suppress(BrokenPipeError):
            self._to.write(json.dumps(question | {"unfit": sorted(self.unfit)}) + "\n")
            self._to.flush()
        ready, _, _ = select.select([self._from], [], [], WAIT_S + 10 * seconds)
        said = self._from.readline() if ready else ""
        return Answer(**json.loads(said)) if said else Answer(LOADING, 0, whole=False, loads=False)

    def fails_anyway(self, case: str, seconds: int) -> bool:
        """Whether a case fails in the tree as it is; it is left out from then on."""
        if case not in self._sound | self.unfit:
            failed = self.ask([case], seconds).failed
            (self.unfit if failed else self._sound).add(case)
        return case in self.unfit

    def close(self) -> None:
        """End the process."""
        with suppress(BrokenPipeError):
            self._to.close()
        self._from.close()
        self._running.kill()
        self._running.wait()


@contextmanager
def _planted(path: Path, change: Change) -> Iterator[str]:
    """The file with the change in it for as long; gives what it is without.

    Byte code is told apart by the second of the file: no two changes have the same.
    """
    source = path.read_text(encoding="utf-8")
    since = path.stat().st_mtime
    path.write_text(change.planted(source), encoding="utf-8")
    os.utime(path, (since, since + next(SECONDS)))
    try:
        yield source
    finally:
        path.write_text(source, encoding="utf-8")
        os.utime(path, (since, since))


def noticed(loaded: Loaded, change: Change, seconds: int, hint: str = "") -> str:
    """The case that fails with the change, and not without it; "" for none.

    ``hint`` is asked first. In the end a new process is asked, for what modules compute as they
    load.
    """
    path = loaded.tree / change.path

    def first(asked: Loaded, tests: Sequence[str]) -> Answer:
        while True:
            with _planted(path, change) as source:
                answer = asked.ask(tests, seconds, change.path, source)
            if not answer.failed or not loaded.fails_anyway(answer.failed, seconds):
                return answer
            asked.unfit = loaded.unfit

    tests = [*([hint] if hint else []), *order(change)]
    answer = first(loaded, tests)
    if answer.failed or not answer.loads:
        return answer.failed
    near = tuple(dict.fromkeys(test.partition("::")[0] for test in tests))[:AT_LOAD]
    with _planted(path, change):
        fresh = Loaded(loaded.tree, [test for test in near if (loaded.tree / test).is_file()])
        fresh.ask([], seconds)
    fresh.unfit = loaded.unfit
    answer = first(fresh, near)
    fresh.close()
    missing = answer.cases != loaded.ask(near, 0).cases
    return answer.failed or (LOADING if missing else "")


def copied(root: Path, place: Path) -> Path:
    """A copy of what git knows of a checkout, in a folder named as the package."""
    tree = place / "dqforge"
    tree.mkdir(parents=True)
    names = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True
    ).stdout.split("\0")
    for name in filter(None, names):
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(root / name, tree / name, follow_symlinks=False)
        for compiled in (root / name).parent.glob(f"__pycache__/{Path(name).stem}.*.pyc"):
            (tree / name).with_name("__pycache__").mkdir(exist_ok=True)
            shutil.copy2(compiled, (tree / name).with_name("__pycache__"))
    shared = root.parent / "shared"
    if shared.is_dir():
        (place / "shared").symlink_to(shared)
    return tree


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def score(
    title: str,
    tree: Path,
    planted: list[Change],
    asked: argparse.Namespace,
    before: dict[str, str],
) -> dict[str, str]:
    """Plant changes one by one, print survivors and the share that was noticed; give the cases."""
    ending = time.monotonic() + asked.within
    keeps = asked.out if title == "here" else None
    kept = json.loads(keeps.read_text(encoding="utf-8")) if keeps and keeps.is_file() else {}
    cases = {change.key: kept[change.key] for change in planted if change.key in kept}
    left = deque(change for change in planted if change.key not in cases)

    def work(root: Path) -> None:
        loaded = Loaded(copied(tree, root), ["tests"])
        while left and time.monotonic() < ending:
            change = left.popleft()
            case = noticed(loaded, change, asked.seconds, before.get(change.key, ""))
            with one_at_a_time:
                cases[change.key] = case
                if keeps:
                    keeps.write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")
                if asked.verbose or not case:
                    said = f"{change.path}:{change.line}: {change.named}"
                    _say(f"{title}: {case or 'not noticed'}: {said}")
        loaded.close()

    one_at_a_time = threading.Lock()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(asked.processes) as threads:
        for one in [
            threads.submit(work, Path(place) / str(number))
            for number in range(min(asked.processes, len(left)))
        ]:
            one.result()
    for kind, (count, whole) in tally(planted, cases).items():
        _say(f"{title}: {kind}: {share(count, whole)}")
    by_kept = sum(case.startswith(kept_output.TEST) for case in cases.values())
    _say(f"{title}: by what is kept: {by_kept}")
    return cases


def tally(planted: list[Change], cases: dict[str, str]) -> dict[str, tuple[int, int]]:
    """How many changes of each kind were noticed, of how many that were tried; at last of all."""
    tried = [change for change in planted if change.key in cases]
    counts = {
        kind: (
            sum(bool(cases[change.key]) for change in tried if change.kind == kind),
            sum(change.kind == kind for change in tried),
        )
        for kind in sorted({change.kind for change in tried})
    }
    return counts | {"all": (sum(map(bool, cases.values())), len(tried))}


def listed(page: str, every: Iterable[Change]) -> dict[str, Change | None]:
    """Lines of the page that name what was not noticed, with the change where it is still there."""
    named = {one.listed: one for one in every}
    lines = [line for line in page.splitlines() if line.startswith("* `") and " (seed `" in line]
    return {line: named.get(line.rpartition(" (seed ")[0]) for line in lines}


def take_out(cases: dict[str, str], before: dict[str, Change | None]) -> None:
    """Take from the page what is noticed now, and what can no longer be planted."""
    gone = {line for line, one in before.items() if one is None or cases.get(one.key)}
    page = EVIDENCE.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in page if line.rstrip("\n") not in gone]
    EVIDENCE.write_text("".join(kept), encoding="utf-8")


def share(count: int, whole: int) -> str:
    """A share with Wilson's interval."""
    from dqforge.optimizer.exploration.acceptance import wilson

    if not whole:
        return "0 of 0"
    low, high = (100.0 * end for end in wilson(count, whole))
    return f"{count} of {whole}, {100.0 * count / whole:.0f} % ({low:.0f} to {high:.0f} %)"


def lines_of_evidence(
    page: str, planted: list[Change], same: dict[str, str], cases: dict[str, str], draw: list[str]
) -> str:
    """The table on the page with this draw in it, its commit and seed, the sum over fresh draws,
    and what no test notices.

    A draw is fresh where its seed has not been on the page: tests were written for the others.
    """
    rows = [
        [cell.strip() for cell in line.strip("| ").split("|")]
        for line in page.splitlines()
        if line.startswith("| `")
    ]
    rows = [row for row in rows if row[:2] != draw]
    fresh = "no" if draw[1] in {row[1] for row in rows} else "yes"
    now = tally(planted, cases)
    counts = [f"{one} of {of}" for one, of in (now.get(kind, (0, 0)) for kind in COLUMNS)]
    rows.append([*draw, fresh, *counts, str(sum(change.key in same for change in planted))])
    both = [
        [tuple(map(int, cell.split(" of "))) for cell in row[3:-1]]
        for row in rows
        if row[2] == "yes"
    ]
    sums = [tuple(map(sum, zip(*column, strict=True))) for column in zip(*both, strict=True)]
    equal = sum(int(row[-1]) for row in rows if row[2] == "yes")
    last = ["fresh", "", "", *(share(*one) for one in sums), str(equal)]
    head = ["commit", "seed", "fresh", *COLUMNS, "equivalent"]
    lines = [f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows, last]]
    ends = f" (seed {draw[1]})"
    kept = [
        line for line in page.splitlines() if line.startswith("* `") and not line.endswith(ends)
    ]
    kept += [f"{one.listed}{ends}" for one in planted if not cases.get(one.key, "tried")]
    survivors = ["", "What no default test noticed, when it was last tried:", "", *kept]
    return "\n".join(lines + (survivors if kept else []))


def write_evidence(
    planted: list[Change], same: dict[str, str], cases: dict[str, str], seed: str
) -> None:
    """Put the draw between the marks of the page."""
    page = EVIDENCE.read_text(encoding="utf-8")
    start, _, rest = page.partition(MARKS[0])
    between, _, after = rest.partition(MARKS[1])
    draw = [f"`{drawn_cases.commit()}`", f"`{seed}`"]
    lines = lines_of_evidence(between, planted, same, cases, draw)
    text = f"{start}{MARKS[0]}\n\n{lines}\n\n{MARKS[1]}{after}"
    EVIDENCE.write_text(text, encoding="utf-8")


def main() -> None:
    """Read the options and count."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("number", type=int)
    options.add_argument("--seed", default=drawn_cases.seed())
    options.add_argument("--only", nargs="+", choices=sorted(KINDS), help="kinds that are drawn")
    options.add_argument("--beneath", nargs="+", default=[""], help="files or folders, alone")
    options.add_argument("--seconds", type=int, default=20, help="processor time per change")
    options.add_argument("--processes", type=int, default=2, help="at once")
    options.add_argument("--within", type=float, default=math.inf, help="no new one after so long")
    options.add_argument("--against", type=Path, help="another checkout, for the same changes")
    options.add_argument("--out", type=Path, help="keeps which case noticed which change")
    options.add_argument("--since", type=Path, help="what an earlier run kept")
    options.add_argument("--evidence", action="store_true", help="write the counts to the page")
    options.add_argument("--again", action="store_true", help="what the page lists, anew")
    options.add_argument("--verbose", action="store_true", help="print what was noticed, too")
    asked = options.parse_args()
    gc.disable()
    every = changes(house.ROOT, files(house.ROOT))
    same = equivalent(every, tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["change"])
    drawable = [
        change
        for change in every
        if change.kind in (asked.only or KINDS) and change.path.startswith(tuple(asked.beneath))
    ]
    found = drawn(drawable, 2 * asked.number, asked.seed)
    sides = {"here": house.ROOT}
    planted = {"here": found[: asked.number]}
    before_now = listed(EVIDENCE.read_text(encoding="utf-8"), every) if asked.again else {}
    if asked.again:
        still = dict.fromkeys(one for one in before_now.values() if one is not None)
        planted = {"here": [*still][: asked.number]}
    if asked.against:
        sides["there"] = asked.against.resolve()
        pairs = [(change, _there(change, sides["there"])) for change in found]
        both = [(change, other) for change, other in pairs if other is not None][: asked.number]
        planted = {"here": [pair[0] for pair in both], "there": [pair[1] for pair in both]}
    before = json.loads(asked.since.read_text(encoding="utf-8")) if asked.since else {}
    for title, root in sides.items():
        counted = [change for change in planted[title] if change.key not in same]
        cases = score(title, root, counted, asked, before)
        if asked.evidence and title == "here":
            tried = [change for change in planted[title] if change.key in {*cases, *same}]
            write_evidence(tried, same, cases, asked.seed)
        if asked.again:
            take_out(cases | dict.fromkeys(same, "the same"), before_now)
        _say(f"{title}: {len(planted[title]) - len(counted)} more change no number")


def _there(change: Change, root: Path) -> Change | None:
    """A change in another checkout."""
    path = root / change.path
    if not path.is_file():
        return None
    mine = (house.ROOT / change.path).read_text(encoding="utf-8")
    return change.elsewhere(mine, path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
