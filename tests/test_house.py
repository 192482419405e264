"""The house: floors and rooms without circles, rooms of a size that can be surveyed, names with
one meaning, and tests that mirror the rooms.

Imports are those that stand in the source, wherever: inside functions and for the type checker
alone too.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from house import FLOORS, IMPORT, ROOT, Imports, imported_names, imports, modules

LARGEST_ROOM = 15
# Kept small by numbers; contributing.md says what each is for.
MOST_LINES = 800
MOST_DISTRICTS = 10
MOST_SERVANTS = 64
MOST_FILES_OF_A_GAIN = 25
LEAST_CODE = 0.625
# What several rooms may call a part of theirs: the room says of what.
# fmt: off
PARTS = {
    "capability", "catalogue", "checks", "constants", "design", "enclosures", "figures", "files",
    "fit", "fixed_header", "float32_model", "gains", "header", "html", "inputs", "map_figures",
    "map_tables", "names", "plain", "question", "reader", "registry", "sections", "settings",
    "solve", "tables", "target", "text", "units", "writer",
}
# fmt: on
# Rooms with a file for each thing that other rooms are about, by its name.
FACES = (
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


def test_imports_are_found_wherever_they_stand() -> None:
    source = (
        '"""import nothing\n\nfrom a.text import b\n"""\nimport json\nfrom a.b import (\n'
        "    c,  # from d import e\n    f as g,\n)\nif TYPE_CHECKING:\n    from h import o\n"
        "def l():\n    from i.j import k, m as n  # late\n    important = 1\n"
    )
    assert imported_names(source) == {"json", "a.b.c", "a.b.f", "h.o", "i.j.k", "i.j.m"}


@pytest.mark.slow
def test_imports_are_those_of_the_trees() -> None:
    for path in modules().values():
        of_tree = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                of_tree |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom):
                of_tree |= {f"{node.module}.{name.name}" for name in node.names}
        assert imported_names(path.read_text("utf-8")) == of_tree, path


def test_modules_import_each_other_in_no_circle() -> None:
    assert len(imports()) > 200
    assert circles(imports()) == []


def test_rooms_import_each_other_in_no_circle() -> None:
    rooms: Imports = {}
    for module, others in imports().items():
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
    # The sections of a design file lie in one room, a file per section, however many there are;
    # and so do the answers of the commands.
    sizes.pop("machines/design/sections")
    sizes.pop("reports/answers")
    assert {name: size for name, size in sizes.items() if size > LARGEST_ROOM} == {}


def test_no_module_is_too_long() -> None:
    lengths = {name: len(path.read_text("utf-8").splitlines()) for name, path in modules().items()}
    assert {name: lines for name, lines in lengths.items() if lines > MOST_LINES} == {}


def test_few_modules_serve_a_single_other() -> None:
    # A room's own file names its modules, and is no other that uses them.
    users = Counter(
        other
        for module, others in imports().items()
        for other in others
        if not other.startswith(f"{module}.")
    )
    assert sum(often == 1 for often in users.values()) <= MOST_SERVANTS


DOCSTRING = re.compile(r'(?:\A|:(?:  #[^\n]*)?\n)\s*r?""".*?"""', re.DOTALL)


def code_lines(source: str) -> int:
    """Code and comments, not docstrings, blank lines and imports."""
    return sum(map(bool, map(str.strip, IMPORT.sub("", DOCSTRING.sub("", source)).splitlines())))


def test_lines_of_code_are_counted() -> None:
    source = (
        '"""Text.\n\nMore.\n"""\n\nimport re as r\nfrom a import (\n    b,\n)\n\n# Why.\n'
        'def f():\n    """Text."""\n    x = """y\n    z"""\n\n    from a import b\n    return x\n'
    )
    assert code_lines(source) == 5


def test_most_lines_are_code() -> None:
    texts = [path.read_text("utf-8") for path in modules().values()]
    whole = sum(len(text.splitlines()) for text in texts)
    assert sum(map(code_lines, texts)) / whole >= LEAST_CODE


def test_one_name_means_one_thing_on_a_floor() -> None:
    """Two modules of one name on a floor are the same part of two rooms."""
    homes = [
        name
        for name in modules()
        if not name.startswith(tuple(f"{room_of_faces}." for room_of_faces in FACES))
    ]
    count = Counter((name.split(".")[0], name.split(".")[-1]) for name in homes)
    assert sorted(name for name, often in count.items() if often > 1 and name[1] not in PARTS) == []


def test_every_room_stands_in_one_of_few_districts() -> None:
    """The rows of the table in architecture.md, by the columns of the floors."""
    page = (ROOT / "docs/project/architecture.md").read_text("utf-8")
    rows = [line.split("|")[2:-1] for line in page.splitlines() if line.startswith("| ")][1:]
    for column, floor in enumerate(FLOORS):
        named = [set(re.findall(r"`(\w+)(?:\.py)?`", row[column])) for row in rows]
        assert sum(map(bool, named)) <= MOST_DISTRICTS
        rooms = {
            path.parent.relative_to(ROOT / floor).parts[0]
            for path in modules().values()
            if path.is_relative_to(ROOT / floor) and path.parent != ROOT / floor
        }
        assert rooms - set().union(*named) == set()


TESTED = re.compile(r"\btests/[\w/]+\.py\b")


def test_the_pages_name_tests_that_are_there() -> None:
    named = {
        (page.relative_to(ROOT).as_posix(), name)
        for page in (ROOT / "docs").rglob("*.md")
        for name in TESTED.findall(page.read_text(encoding="utf-8"))
    }
    assert {(page, name) for page, name in named if not (ROOT / name).is_file()} == set()


def test_tests_lie_in_rooms_of_the_package() -> None:
    folders = {
        path.parent.relative_to(ROOT / "tests")
        for floor in FLOORS
        for path in (ROOT / "tests" / floor).rglob("test_*.py")
    }
    assert {
        folder.as_posix()
        for folder in folders
        if not (ROOT / folder).is_dir() and not (ROOT / folder).with_suffix(".py").is_file()
    } == set()


@pytest.mark.parametrize(
    "command", ["tune", pytest.param("run -o out", marks=pytest.mark.slow)], ids=["tune", "run"]
)
def test_the_gain_of_i_q_goes_through_few_files(command: str, tmp_path: Path) -> None:
    """From where it is solved to the terminal, JSON, header and report."""
    name, *options = command.split()
    script = ROOT / "tests" / "gain_way.py"
    words = [sys.executable, str(script), name, "paper000-ipmsm-100kw", *options]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    files = json.loads(done.stderr.splitlines()[-1])
    assert "optimizer/loops/pi_methods.py" in files
    assert len(files) <= MOST_FILES_OF_A_GAIN, files
