"""Byte code of templates: kept, taken, made again where the text changed or the file is broken."""

from __future__ import annotations

import sys
from importlib.util import cache_from_source
from pathlib import Path

import pytest
from jinja2 import Environment, FileSystemLoader

from dqforge.reports.pages.templating import CompiledTemplates


def rendered(folder: Path, name: str = "a.txt.j2") -> str:
    """As a process of its own renders it."""
    kept = CompiledTemplates(lambda name: folder / name)
    loaded = Environment(loader=FileSystemLoader(folder), bytecode_cache=kept, autoescape=False)
    return loaded.get_template(name).render(x=7)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    (tmp_path / "a.txt.j2").write_text("one {{ x }}")
    return tmp_path


def test_byte_code_is_kept_taken_and_never_that_of_another_text(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert rendered(folder) == "one 7"
    kept = Path(cache_from_source(str(folder / "a.txt.j2"), optimization="jinja"))
    first = kept.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(Environment, "compile", None)
        assert rendered(folder) == "one 7"
    (folder / "a.txt.j2").write_text("two {{ x }}")
    assert rendered(folder) == "two 7"
    assert kept.read_bytes() != first
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


@pytest.mark.parametrize("broken", [b"", b"no byte code", 40, -1])
def test_a_broken_file_is_written_again(folder: Path, broken: bytes | int) -> None:
    assert rendered(folder) == "one 7"
    kept = Path(cache_from_source(str(folder / "a.txt.j2"), optimization="jinja"))
    whole = kept.read_bytes()
    kept.write_bytes(broken if isinstance(broken, bytes) else whole[:broken])
    assert rendered(folder) == "one 7"
    assert kept.read_bytes() == whole


def test_nothing_is_written_where_nothing_can_or_may_be(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "__pycache__").write_text("a file in the way")
    assert rendered(folder) == "one 7"
    (folder / "__pycache__").unlink()
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert rendered(folder) == "one 7"
    assert not (folder / "__pycache__").exists()
