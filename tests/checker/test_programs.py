"""What holds of every program of the folder: it is short, and stands on the standard library."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from dqforge.checker import kit

FOLDER = Path(kit.__file__).parent
FILES = sorted(FOLDER.glob("[a-z]*.py"))
PROGRAMS = [path for path in FILES if path.name.startswith("check_")]
LIBRARY = {
    "__future__", "ast", "collections", "collections.abc", "contextlib", "fractions", "functools",
    "itertools", "json", "math", "operator", "pathlib", "re", "sys", "typing",
}  # fmt: skip


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_short_and_shares_nothing_with_what_it_checks(path: Path) -> None:
    source = path.read_text("utf-8")
    assert len(source.splitlines()) <= (300 if path.name == "kit.py" else 600)
    beside = {other.stem for other in FILES if other != path}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            assert {each.name for each in node.names} <= LIBRARY | beside
        elif isinstance(node, ast.ImportFrom) and node.level:
            assert (node.level, node.module) == (1, None)
            assert {each.name for each in node.names} <= beside
        elif isinstance(node, ast.ImportFrom):
            assert node.module in LIBRARY
        assert not (isinstance(node, ast.Constant) and isinstance(node.value, float))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_it_says_how_it_is_called_and_what_it_cannot_read(path: Path, tmp_path: Path) -> None:
    def told(*arguments: str) -> tuple[int, str]:
        command = [sys.executable, "-I", "-S", str(path), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert not done.stderr
        return done.returncode, done.stdout

    code, said = told()
    assert (code, said.split()[:2]) == (2, ["write:", path.name])
    damaged = tmp_path / said.split("PREFIX")[1].strip()
    code, line = told(str(damaged))
    assert code == 1
    assert line.startswith("not confirmed: the certificate or the header is damaged (FileNotFound")
    damaged.write_text('{"format": 1, "format": 2}')
    assert told(str(damaged)) == (1, "not confirmed: the certificate has a member twice\n")
    damaged.write_text(json.dumps({"not_covered": []}))
    code, line = told(str(damaged))
    assert (code, line.splitlines()[-1].split(":")[0]) == (1, "not confirmed")
