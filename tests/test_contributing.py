"""The code in docs/project/contributing.md is that of the toys which the tests run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def blocks(heading: str) -> list[str]:
    """Code in the section of a heading."""
    text = (ROOT / "docs" / "project" / "contributing.md").read_text(encoding="utf-8")
    section = text.split(f"## {heading}", 1)[1].split("\n## ", 1)[0]
    return re.findall(r"```\w+\n(.*?)\n```", section, re.DOTALL)


@pytest.mark.parametrize(("heading", "count"), [("A capability", 3), ("A header dialect", 1)])
def test_code_of_the_guide_is_run_as_it_stands(heading: str, count: int) -> None:
    sources = [
        path.read_text(encoding="utf-8")
        for path in (ROOT / "tests" / "toys").iterdir()
        if path.suffix in (".py", ".j2")
    ]
    found = blocks(heading)
    assert len(found) == count
    for block in found:
        assert any(block in source for source in sources), block
