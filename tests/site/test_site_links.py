"""The link checker reads a site that nobody else may read, and finds what leads nowhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("target", "code"), [("next.html", 0), ("gone.html", 1)])
def test_links_of_a_private_folder(tmp_path: Path, target: str, code: int) -> None:
    tmp_path.chmod(0o700)
    page = "<!DOCTYPE html><title>Page</title><a href='{}'>further</a>"
    (tmp_path / "index.html").write_text(page.format(target))
    (tmp_path / "next.html").write_text(page.format("index.html"))
    words: list[str | Path] = ["-f", ROOT / "docs" / "linkchecker.ini", tmp_path / "index.html"]
    done = subprocess.run(
        [sys.executable, ROOT / "tests" / "site_links.py", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, "2 links in 2 URLs checked" in done.stdout) == (code, True), done
