"""What imports what in the package and its tests, read from the source; and, started as a
programme, which test covers each module.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FLOORS = ("machines", "optimizer", "reports")

Imports = dict[str, set[str]]


@cache
def modules() -> dict[str, Path]:
    """Every module of the three floors by its dotted name without the package's."""
    found = {}
    for floor in FLOORS:
        for path in sorted((ROOT / floor).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """A file as its tree."""
    return ast.parse(path.read_text(encoding="utf-8"))


# A statement that imports, over several lines where it has brackets; and texts of several lines,
# in which such a line is no statement. Trees of all files would take a hundred times as long.
IMPORT = re.compile(
    r"^[ \t]*(?:import (?P<whole>[\w.]+)[^\n]*"
    r"|from (?P<where>[\w.]+) import (?P<names>\([^)]*\)|[^\n]*))",
    re.MULTILINE,
)
LONG_TEXT = re.compile(r'""".*?"""', re.DOTALL)


def imported_names(source: str) -> set[str]:
    """Every name that a source imports, with its module before it."""
    found = set()
    for statement in IMPORT.finditer(LONG_TEXT.sub("", source)):
        names = re.sub(r"#.*", "", statement["names"] or "")
        found |= {
            f"{statement['where']}.{name}" for name in re.findall(r"(\w+)(?: as \w+)?", names)
        } or {statement["whole"]}
    return found


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports."""
    names = _names(path)
    inside = [name.removeprefix("dqforge.") for name in names if name.startswith("dqforge.")]
    found = {name if name in modules() else name.rpartition(".")[0] for name in inside}
    return found & set(modules())


@cache
def _names(path: Path) -> set[str]:
    return imported_names(path.read_text(encoding="utf-8"))


@cache
def imports() -> Imports:
    return {name: imported(path) - {name} for name, path in modules().items()}


@cache
def tests() -> Imports:
    """Every test file of the three floors and beside them, with the modules that it imports."""
    found = sorted((ROOT / "tests").rglob("test_*.py"))
    return {
        path.relative_to(ROOT).as_posix(): imported(path) | _by_the_door(path) for path in found
    }


def _by_the_door(path: Path) -> set[str]:
    """What a test comes to by the public names of the package or by its command line."""
    names = _names(path)
    doors = {"__init__.py": "dqforge" in names, "cli.py": "dqforge.cli" in names}
    return set().union(*(imported(ROOT / name) for name, used in doors.items() if used))


def own_test(module: str) -> str:
    """Where the test of a module lies if it has one of its own."""
    *rooms, name = module.split(".")
    return "/".join(["tests", *rooms, f"test_{name}.py"])


def covered_by(module: str) -> tuple[str, int]:
    """The nearest test file that loads a module, and over how many modules it comes to it.

    Of tests that are equally near, the one that lies nearest to the module, then the first.
    """
    if own_test(module) in tests():
        return own_test(module), 0
    reached, steps = {module}, 0
    while reached:
        near = [name for name, used in tests().items() if used & reached]
        if near:
            return max(near, key=lambda name: (_shared(name, module), name)), steps
        wider = reached | {name for name, used in imports().items() if used & reached}
        if wider == reached:
            break
        reached, steps = wider, steps + 1
    return "", steps


def _shared(test: str, module: str) -> int:
    ours, theirs = test.split("/")[1:-1], module.split(".")[:-1]
    same = [a == b for a, b in zip(ours, theirs, strict=False)]
    return same.index(False) if False in same else len(same)


def main() -> None:
    for module, path in modules().items():
        if path.name != "__init__.py":
            test, steps = covered_by(module)
            sys.stdout.write(f"{module:60} {test}{f' (by way of {steps})' if steps else ''}\n")


if __name__ == "__main__":
    main()
