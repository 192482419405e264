"""How many planted changes the tests notice: a mutation score over physics, proofs and emitted C.

A change turns a sign, a factor, a comparison or a constant round, swaps two arguments, or drops a
statement, in a place that a seed draws; the tests nearest to it then run in a copy of the tree, for
so many seconds of processor time at most, and those farther away for as long again. What none of
them notices is printed. What changes no number stands in `tests/equivalent_changes.toml`, with the
reason, and is not counted.

    python tests/mutants.py 30                 thirty, drawn by the commit
    python tests/mutants.py 30 --within 150    as many of them as are begun in 150 s
    python tests/mutants.py 200 --seed a --against OLD_CHECKOUT
    python tests/mutants.py 100 --seed a --out OLD.json
    python tests/mutants.py 100 --seed a --since OLD.json --evidence

``--against`` plants the same changes in another checkout too, where their lines stand there once.
``--out`` goes on where an earlier run with the same file ended. ``--since`` asks first the case
that noticed a change in an earlier run, and counts both runs; ``--evidence`` writes the counts to
`docs/project/evidence.md`.
"""

from __future__ import annotations

import argparse
import ast
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
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import drawn_cases
import house

# What the score is about; words, pages and readers of files are held by other tests.
KINDS = {
    "proofs": r"optimizer/(certificates|box_proofs|axis_margins|speed_box|changing_loops)/",
    "number formats": r"optimizer/fixed_\w+/|optimizer/curves/",
    "formulas": r"optimizer/|machines/(\w+_machines|losses|modulation|plants|transforms|back_emf)",
    "emitted code": r"reports/(?!pages/)\w+/templates/(?!.*(harness|vectors|main\.)).*\.[ch]\.j2$",
}
BINARY = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*"}
COMPARISONS = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
OF_C = {" + ": " - ", " - ": " + ", " * ": " / ", " < ": " >= ", " > ": " <= ", " <= ": " > "}
# Of these the order of the arguments does not matter.
SYMMETRIC = {"min", "max", "minimum", "maximum", "fmin", "fmax", "hypot", "gcd", "lcm"}
EVIDENCE = house.ROOT / "docs/project/evidence.md"
MARKS = "<!-- planted changes -->", "<!-- end of planted changes -->"
EQUIVALENT = Path(__file__).with_name("equivalent_changes.toml")
Span = Callable[["ast.expr | ast.stmt"], tuple[int, int]]
# In place of a case, where the tests can no longer be loaded.
LOADING = "loading"
WAIT_S = 300.0
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
            yield where(node)[0], where(operand)[0], ""
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
def nearest(path: str) -> tuple[str, ...]:
    """The tests of a file: its own first, then those that import it, then those of its room.

    A template is imported with the modules that name it.
    """
    module = path.removesuffix(".py").replace("/", ".")
    room, name = path.split("/")[1], Path(path).name
    loads = {module}
    if path.endswith(".j2"):
        texts = ((module, file.read_text("utf-8")) for module, file in house.modules().items())
        loads = {module for module, text in texts if name in text}
    own = house.own_test(module)
    cost = drawn_cases.kept_costs()
    loading = sorted(test for test, loaded in house.tests().items() if loads & loaded)
    beside = (test for test in house.tests() if test.split("/")[2:-1][:1] == [room])
    ordered = sorted(beside, key=lambda test: (cost.get(test, 0.0), test))
    by_distance = [own, *sorted(loading, key=lambda test: cost.get(test, 0.0)), *ordered]
    return tuple(dict.fromkeys(test for test in by_distance if test in house.tests()))


@cache
def farther(path: str) -> tuple[str, ...]:
    """The other tests that come to a file by way of what imports it, cheap ones first.

    To a template they come by way of the modules beside it.
    """
    module, beside, _ = path.removesuffix(".py").replace("/", ".").partition(".templates.")
    reached = {name for name in house.modules() if name == module or name.startswith(module + ".")}
    if not beside:
        reached = {module}
    wider: set[str] = set()
    while wider != reached:
        reached |= wider
        wider = reached | {name for name, used in house.imports().items() if used & reached}
    coming = {test for test, loaded in house.tests().items() if loaded & reached}
    cost = drawn_cases.kept_costs()
    others = coming - set(nearest(path))
    return tuple(sorted(others, key=lambda test: (cost.get(test, 0.0), test)))


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

    ``hint`` is asked first. After the nearest tests those farther away are asked, for as long
    again; then, in a new process, the nearest once more, for what modules compute as they load.
    """
    path = loaded.tree / change.path

    def first(asked: Loaded, tests: Sequence[str]) -> Answer:
        while True:
            with _planted(path, change) as source:
                answer = asked.ask(tests, seconds, change.path, source)
            if not answer.failed or not loaded.fails_anyway(answer.failed, seconds):
                return answer
            asked.unfit = loaded.unfit

    near = nearest(change.path)
    for tests in ([hint] if hint else [], near, farther(change.path)):
        answer = first(loaded, tests)
        if answer.failed:
            return answer.failed
    if not answer.loads:
        return ""
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
    left = [change for change in planted if change.key not in cases]
    loaded = Loaded(tree, ["tests"]) if left else None
    for change in left:
        if loaded is None or time.monotonic() > ending:
            break
        case = noticed(loaded, change, asked.seconds, before.get(change.key, ""))
        cases[change.key] = case
        if keeps:
            keeps.write_text(json.dumps(cases, indent=1) + "\n", encoding="utf-8")
        if asked.verbose or not case:
            said = f"{change.path}:{change.line}: {change.named}"
            _say(f"{title}: {case or 'not noticed'}: {said}")
    if loaded is not None:
        loaded.close()
    for kind, (count, whole) in tally(planted, cases).items():
        _say(f"{title}: {kind}: {share(count, whole)}")
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


def share(count: int, whole: int) -> str:
    """A share with Wilson's interval."""
    from dqforge.optimizer.exploration.acceptance import wilson

    if not whole:
        return "0 of 0"
    low, high = (100.0 * end for end in wilson(count, whole))
    return f"{count} of {whole}, {100.0 * count / whole:.0f} % ({low:.0f} to {high:.0f} %)"


def lines_of_evidence(
    every: list[Change],
    planted: list[Change],
    same: dict[str, str],
    cases: dict[str, str],
    before: dict[str, str],
    seed: str,
) -> str:
    """Counts of each kind, before and now, and what no test notices."""
    counted = {key: case for key, case in before.items() if key in cases}
    places = Counter(change.kind for change in every)
    left = Counter(change.kind for change in planted if change.key in same)
    then, now = tally(planted, counted), tally(planted, cases)
    rows = [
        f"Seed `{seed}`; with Wilson's interval at 95 %.",
        "",
        "| code | places | drawn | of which equivalent | noticed before | noticed |",
        "|---|---|---|---|---|---|",
    ]
    for kind, (_, whole) in now.items():
        of_all = kind == "all"
        equal = left.total() if of_all else left[kind]
        rows.append(
            f"| {kind} | {places.total() if of_all else places[kind]} | {whole + equal} | {equal}"
            f" | {share(*then[kind]) if counted else '-'} | {share(*now[kind])} |"
        )
    survivors = [change for change in planted if not cases.get(change.key, "tried")]
    if survivors:
        rows += ["", "What no default test notices:", ""]
        rows += [f"* `{one.path}`: `{one.words}`: `{one.named}`" for one in survivors]
    return "\n".join(rows)


def write_evidence(lines: str) -> None:
    """Put the lines between the marks of the page."""
    page = EVIDENCE.read_text(encoding="utf-8")
    start, _, rest = page.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    text = f"{start}{MARKS[0]}\n\n{lines}\n\n{MARKS[1]}{after}"
    EVIDENCE.write_text(text, encoding="utf-8")


def main() -> None:
    """Read the options and count."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("number", type=int)
    options.add_argument("--seed", default=drawn_cases.seed())
    options.add_argument("--seconds", type=int, default=20, help="processor time per change")
    options.add_argument("--within", type=float, default=math.inf, help="no new one after so long")
    options.add_argument("--against", type=Path, help="another checkout, for the same changes")
    options.add_argument("--out", type=Path, help="keeps which case noticed which change")
    options.add_argument("--since", type=Path, help="what an earlier run kept")
    options.add_argument("--evidence", action="store_true", help="write the counts to the page")
    options.add_argument("--verbose", action="store_true", help="print what was noticed, too")
    asked = options.parse_args()
    every = changes(house.ROOT, files(house.ROOT))
    same = equivalent(every, tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["change"])
    found = drawn(every, 2 * asked.number, asked.seed)
    sides = {"here": house.ROOT}
    planted = {"here": found[: asked.number]}
    if asked.against:
        sides["there"] = asked.against.resolve()
        pairs = [(change, _there(change, sides["there"])) for change in found]
        both = [(change, other) for change, other in pairs if other is not None][: asked.number]
        planted = {"here": [pair[0] for pair in both], "there": [pair[1] for pair in both]}
    before = json.loads(asked.since.read_text(encoding="utf-8")) if asked.since else {}
    with tempfile.TemporaryDirectory() as place:
        for title, root in sides.items():
            tree = copied(root, Path(place) / title)
            counted = [change for change in planted[title] if change.key not in same]
            cases = score(title, tree, counted, asked, before)
            if asked.evidence and title == "here":
                tried = [change for change in planted[title] if change.key in {*cases, *same}]
                write_evidence(lines_of_evidence(every, tried, same, cases, before, asked.seed))
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
