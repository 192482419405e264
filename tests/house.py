"""What imports what in the package and its tests, read from the source; and, started as a
programme, which test covers each module.
"""

from __future__ import annotations

import ast
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


def imported(path: Path) -> set[str]:
    """Modules of the package that a file imports."""
    found = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dqforge."):
            where = str(node.module).removeprefix("dqforge.")
            for name in node.names:
                whole = f"{where}.{name.name}"
                found.add(whole if whole in modules() else where)
    return found & set(modules())


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
    names = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "dqforge":
            names |= {f"dqforge.{name.name}" for name in node.names}
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
