"""The house: floors and rooms without circles, rooms of a size that can be surveyed, names with
one meaning, and tests that mirror the rooms.

Imports are read from the source, wherever they stand in it: inside functions and for the type
checker alone too.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from pathlib import Path

import pytest
from house import FLOORS, ROOT, Imports, covered_by, imports, modules

LARGEST_ROOM = 16
# What several rooms may call a part of theirs: the room says of what.
# fmt: off
PARTS = {
    "capability", "catalogue", "checks", "constants", "design", "dialect", "enclosures",
    "figures", "files", "fit", "fixed_header", "float32_model", "gains", "header", "html",
    "inputs", "map_figures", "map_tables", "names", "plain", "question", "registry", "sections",
    "settings", "solve", "tables", "text", "units",
}
# fmt: on
# Rooms with a file for each thing that other rooms are about, by its name.
FACES = (
    "machines.design.plausibility",
    "machines.design.sections",
    "optimizer.certificates",
    "reports.answers",
    "reports.session",
)


def room(module: str) -> str:
    """Floor and room; a room and the rooms inside it count as one, a file of the ground as its own.

    The file that only says what a room is for is the room.
    """
    return ".".join(module.split(".")[:2])


def circles(graph: Imports) -> list[list[str]]:
    """What is left of a graph when everything that leads nowhere, or comes from nowhere, goes."""
    left = {node: set(others) for node, others in graph.items()}
    while True:
        reached = set().union(*left.values())
        kept = {node: others & set(left) for node, others in left.items() if others & set(left)}
        kept = {node: others for node, others in kept.items() if node in reached}
        if kept == left:
            return [[node, *sorted(others)] for node, others in sorted(kept.items())]
        left = kept


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": set()}) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [["b", "c"], ["c", "b"]]


def test_modules_import_each_other_in_no_circle() -> None:
    assert len(imports()) > 200
    assert circles(imports()) == []


def excused() -> set[tuple[str, str]]:
    """Imports that the contract of circles names with a reason."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = project["tool"]["importlinter"]["contracts"]
    (contract,) = [entry for entry in contracts if entry["type"] == "acyclic_siblings"]
    lines = [line.replace("dqforge.", "").split(" -> ") for line in contract["ignore_imports"]]
    return {(importer, imported) for importer, imported in lines}


def test_rooms_import_each_other_in_no_circle() -> None:
    rooms: Imports = {}
    for module, all_of_them in imports().items():
        others = {other for other in all_of_them if (module, other) not in excused()}
        rooms.setdefault(room(module), set()).update(
            room(other) for other in others if room(other) != room(module)
        )
    assert circles(rooms) == []


def test_no_import_climbs() -> None:
    height = {floor: index for index, floor in enumerate(FLOORS)}
    assert [
        (module, other)
        for module, others in imports().items()
        for other in others
        if height[other.split(".")[0]] > height[module.split(".")[0]]
    ] == []


def test_no_room_is_too_large() -> None:
    sizes = Counter(
        path.parent.relative_to(ROOT).as_posix()
        for path in modules().values()
        if path.name != "__init__.py"
    )
    # The sections of a design file lie in one room, a file per section, however many there are.
    sizes.pop("machines/design/sections")
    assert {name: size for name, size in sizes.items() if size > LARGEST_ROOM} == {}


def test_one_name_means_one_thing_on_a_floor() -> None:
    """Two modules of one name on a floor are the same part of two rooms."""
    homes = [
        name
        for name in modules()
        if not name.startswith(tuple(f"{room_of_faces}." for room_of_faces in FACES))
    ]
    count = Counter((name.split(".")[0], name.split(".")[-1]) for name in homes)
    assert sorted(name for name, often in count.items() if often > 1 and name[1] not in PARTS) == []


TESTED = re.compile(r"\btests/[\w/]+\.py\b")


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.stem)
def test_the_pages_name_tests_that_are_there(page: Path) -> None:
    named = set(TESTED.findall(page.read_text(encoding="utf-8")))
    assert {name for name in named if not (ROOT / name).is_file()} == set()


def test_tests_lie_in_rooms_of_the_package() -> None:
    folders = {
        path.parent.relative_to(ROOT / "tests")
        for floor in FLOORS
        for path in (ROOT / "tests" / floor).rglob("test_*.py")
    }
    assert {folder.as_posix() for folder in folders if not (ROOT / folder).is_dir()} == set()


def test_every_module_is_near_a_test() -> None:
    """A module without a test file of its own is imported by a test, or by a module near
    one; `python tests/house.py` prints which.
    """
    far = {
        module: found
        for module, path in modules().items()
        if path.name != "__init__.py" and ((found := covered_by(module))[0] == "" or found[1] > 3)
    }
    assert far == {}
