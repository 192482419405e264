"""The pages of the documentation: the tables of contents of the site hold every one, and every link
leads to a file and a heading that are there.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from schema_keys import groups

from dqforge.machines.design.schema import json_schema

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@cache
def _links(page: Path) -> list[tuple[Path, str]]:
    """Files and headings that a page links to; those of the web left out."""
    prose = re.sub(r"`[^`\n]*`", "", page.read_text(encoding="utf-8"))
    found = re.findall(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)", prose)
    near = [(name, heading) for name, heading in found if not name.startswith("http")]
    return [((page.parent / name).resolve() if name else page, part) for name, part in near]


@cache
def _headings(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", title.strip().lower()) for title in titles]
    return {title.replace(" ", "-") for title in plain} | _keys(page)


def _keys(page: Path) -> set[str]:
    """Addresses of the keys of the design file that a page lists."""
    named = re.findall(
        r"^```\{design-keys\} (\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE
    )
    listed = [group for name in named for group in groups(json_schema(), name)]
    return {key.path for group in listed for key in group.keys}


def _contents(page: Path) -> list[Path]:
    """Pages that the tables of contents of a page name, patterns resolved."""
    text = page.read_text(encoding="utf-8")
    found = []
    for table in re.findall(r"^```\{toctree\}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        lines = [line for line in table.split("\n") if line and not line.startswith(":")]
        names = [re.sub(r".*<(.*)>", r"\1", line) for line in lines]
        found += [path for name in names for path in sorted(page.parent.glob(f"{name}.md"))]
    return [path.resolve() for path in found if path != page]


def test_the_tables_of_contents_hold_every_page_once() -> None:
    """From the home page, of which the others are a step or two away."""
    home = ROOT / "docs" / "index.md"
    listed, reached = [home], [home]
    while listed:
        listed = [child for page in listed for child in _contents(page)]
        reached += listed
    assert sorted(reached) == PAGES[1:]


def test_links_lead_somewhere() -> None:
    lost = [
        f"{page.name}: {target.name}#{heading}"
        for page in PAGES
        for target, heading in _links(page)
        if not target.exists()
        or (heading and target.suffix == ".md" and heading not in _headings(target))
    ]
    assert lost == []


EVIDENCE = (ROOT / "docs" / "project" / "evidence.md").read_text(encoding="utf-8").splitlines()


def test_evidence_names_tests_that_are_there() -> None:
    """Names without a folder lie in that of a name before them in the row."""
    lost = []
    for line in EVIDENCE:
        folders: list[Path] = []
        for name in re.findall(r"`((?:tests/)?[\w/]*(?:test_\w+\.py|\w/))(?:::\w+)?`", line):
            if name.startswith("tests/"):
                folders.append((ROOT / name).parent if name.endswith(".py") else ROOT / name)
                lost += [] if (ROOT / name).exists() else [name]
            elif name.endswith(".py") and not any((each / name).exists() for each in folders):
                lost.append(name)
    assert lost == []


def test_evidence_has_one_row_for_each_requirement() -> None:
    rows = [line.split("|")[1].strip() for line in EVIDENCE if line.startswith("| ")]
    draws = re.compile("`[0-9a-f]{12}`")  # of planted changes, by their commit
    named = [row for row in rows if not row.startswith("...") and not draws.fullmatch(row)]
    assert sorted({row for row in named if named.count(row) > 1}) == []
