"""How many planted changes the tests notice: a mutation score over physics, proofs and emitted C.

A change turns a sign, a factor, a comparison or a constant round, swaps two arguments, or drops a
statement, in a place that a seed draws; the tests nearest to it then run in a copy of the tree, for
so many seconds of processor time at most. A change that they do not notice is printed.

    python tests/mutants.py 30                 thirty, drawn by the commit
    python tests/mutants.py 200 --seed a --against OLD_CHECKOUT

``--against`` plants the same changes in another checkout too, where their lines stand there once.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import itertools
import json
import os
import re
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import drawn_cases
import house

# What the score is about; words, pages and readers of files are held by other tests.
KINDS = {
    "proofs": r"optimizer/(certificates|box_proofs|axis_margins|speed_box|changing_loops)/",
    "number formats": r"optimizer/fixed_\w+/|optimizer/curves/",
    "formulas": r"optimizer/|machines/(\w+_machines|losses|modulation|plants|transforms|back_emf)",
    "emitted code": r"reports/(?!pages/)\w+/templates/(?!.*(html|harness|vectors|main\.)).*\.j2$",
}
BINARY = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*"}
COMPARISONS = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
OF_C = {" + ": " - ", " - ": " + ", " * ": " / ", " < ": " >= ", " > ": " <= ", " <= ": " > "}
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
        return Change(
            self.kind,
            self.path,
            self.start + shift,
            self.end + shift,
            self.text,
            self.old,
            other.count("\n", 0, self.start + shift) + 1,
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
        case ast.Call(args=[first, second]) if not isinstance(second, ast.Starred):
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


def changes(root: Path) -> list[Change]:
    """Every change that can be planted."""
    names = subprocess.run(
        ["git", "ls-files"], cwd=root, capture_output=True, text=True, check=True
    ).stdout.split()
    found = []
    for name in names:
        kind = kind_of(name)
        if kind is None or not name.endswith((".py", ".j2")):
            continue
        source = (root / name).read_text(encoding="utf-8")
        places = _in_python(source) if name.endswith(".py") else _in_template(source)
        for start, end, text in places:
            line = source.count("\n", 0, start) + 1
            if text != source[start:end]:
                found.append(Change(kind, name, start, end, text, source[start:end], line))
    return found


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
    """The tests of a file: its own first, then those that import it, then those of its room."""
    module = path.removesuffix(".py").replace("/", ".")
    room = path.split("/")[1]
    own = house.own_test(module)
    loading = sorted(test for test, loaded in house.tests().items() if module in loaded)
    beside = (test for test in house.tests() if test.split("/")[2:-1][:1] == [room])
    cost = drawn_cases.kept_costs()
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


def noticed(loaded: Loaded, change: Change, seconds: int) -> str:
    """The case that fails with the change, and not without it; "" for none.

    After the nearest tests those farther away are asked, for as long again; then, in a new process,
    the nearest once more, for what modules compute as they load.
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
    for tests in (near, farther(change.path)):
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


def score(title: str, tree: Path, planted: list[Change], seconds: int) -> None:
    """Plant changes one by one and print the survivors, then the share that was noticed."""
    loaded = Loaded(tree, ["tests"])
    killed: Counter[str] = Counter()
    for change in planted:
        begun = time.monotonic()
        case = noticed(loaded, change, seconds)
        killed[change.kind] += bool(case)
        what = f"{change.old.strip()!r} -> {change.text.strip()!r}"
        took = time.monotonic() - begun
        _say(f"{title}: {took:.1f} s {case or 'not noticed'}: {change.path}:{change.line}: {what}")
    loaded.close()
    whole = Counter(change.kind for change in planted)
    for kind, number in sorted(whole.items()):
        _say(f"{title}: {kind}: {killed[kind]} of {number} noticed")
    _say(f"{title}: {killed.total()} of {whole.total()} noticed")


def main() -> None:
    """Read the options and count."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("number", type=int)
    options.add_argument("--seed", default=drawn_cases.seed())
    options.add_argument("--seconds", type=int, default=60, help="processor time per change")
    options.add_argument("--against", type=Path, help="another checkout, for the same changes")
    asked = options.parse_args()
    found = drawn(changes(house.ROOT), 2 * asked.number, asked.seed)
    sides = {"here": house.ROOT}
    planted = {"here": found[: asked.number]}
    if asked.against:
        sides["there"] = asked.against.resolve()
        pairs = [(change, _there(change, sides["there"])) for change in found]
        both = [(change, other) for change, other in pairs if other is not None][: asked.number]
        planted = {"here": [pair[0] for pair in both], "there": [pair[1] for pair in both]}
    with tempfile.TemporaryDirectory() as place:
        for title, root in sides.items():
            tree = copied(root, Path(place) / title)
            score(title, tree, planted[title], asked.seconds)


def _there(change: Change, root: Path) -> Change | None:
    """A change in another checkout."""
    path = root / change.path
    if not path.is_file():
        return None
    mine = (house.ROOT / change.path).read_text(encoding="utf-8")
    return change.elsewhere(mine, path.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
