"""How-to pages, run as written: every command, file and block of Python, and what the page says
that comes of it. `.ci/first-hour` does so with the tutorials, from the wheel in an empty
environment.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from documented_sessions import ROOT, environment, missing_programs, run_page
from session_pages import read_page

PAGES = [
    page for page in sorted((ROOT / "docs" / "how-to").glob("*.md")) if page.name != "index.md"
]


def _cases() -> list[object]:
    """Pages, those that do not call themselves quick with the campaign."""
    return [
        pytest.param(
            page,
            id=f"{page.parent.name}-{page.stem}",
            marks=() if read_page(page).is_quick else pytest.mark.slow,
        )
        for page in PAGES
    ]


@pytest.mark.parametrize("path", _cases())
def test_a_page_goes_as_written(path: Path, tmp_path: Path) -> None:
    page = read_page(path)
    variables = environment()
    missing = missing_programs(page, variables)
    if missing and not os.environ.get("CI"):
        pytest.skip(f"needs {' and '.join(missing)}")
    assert not missing
    folder = tmp_path / "session"
    folder.mkdir()
    run_page(page, folder, variables)
