"""Every dotted name of this package on a page of the documentation can be imported."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
FLOORS = "machines|optimizer|reports"
NAMED = re.compile(
    rf"(?<![\w./@-])(dqforge(?:\.[A-Za-z_]\w*)+|(?:{FLOORS})(?:\.[A-Za-z_]\w*)+)(?![\w/-])"
)
FILES = (".py", ".yaml", ".md", ".json", ".toml", ".html", ".npz", ".svg", ".sha256", ".columns")


# Lines of code in which changes were planted.
PLANTED = re.compile(r"<!-- planted changes -->.*<!-- end of planted changes -->", re.DOTALL)


def is_there(name: str) -> bool:
    """Whether modules and what is in them lead along a dotted name."""
    parts = name.removeprefix("dqforge.").split(".")
    found: object = import_module("dqforge")
    path = "dqforge"
    for part in parts:
        path += f".{part}"
        if not hasattr(found, part):
            try:
                import_module(path)
            except ModuleNotFoundError:
                return False
        found = getattr(found, part)
    return True


def test_every_dotted_name_of_a_page_can_be_imported() -> None:
    dead = [
        f"{page.relative_to(ROOT)}: {name}"
        for page in PAGES
        for name in sorted(set(NAMED.findall(PLANTED.sub("", page.read_text(encoding="utf-8")))))
        if not name.endswith(FILES) and not is_there(name)
    ]
    assert dead == []
