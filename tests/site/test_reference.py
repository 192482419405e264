"""The generated reference is complete: every key, command, option and public name has its place."""

from __future__ import annotations

import posixpath
import re
import subprocess
import sys
import typing
from collections.abc import Iterator
from html import escape, unescape
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
import typer
from pydantic import BaseModel
from schema_keys import groups

import dqforge
from dqforge.cli import app
from dqforge.machines.design.schema import DesignFile, json_schema
from dqforge.machines.exploration.study import StudyFile, study_json_schema

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMANDS: dict[str, Any] = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def sections_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Models that may stand at a key."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in (*typing.get_args(annotation), getattr(annotation, "__value__", None)):
        if part is not None and part is not annotation:
            yield from sections_in(part)


def paths_of(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Dotted keys of a file from its models, which the reference does not look at."""
    for name, field in model.model_fields.items():
        yield f"{prefix}{field.alias or name}"
        if isinstance(field.json_schema_extra, dict) and "former" in field.json_schema_extra:
            yield f"{prefix}{field.json_schema_extra['former']}"
        for part in dict.fromkeys(sections_in(field.annotation)):
            yield from paths_of(part, f"{prefix}{name}.")


def listed(schema: dict[str, Any]) -> set[str]:
    return {key.path for group in groups(schema) for key in group.keys}


def test_every_key_of_the_design_file_is_listed() -> None:
    assert listed(json_schema()) == set(paths_of(DesignFile))


def test_every_key_of_the_study_file_is_listed() -> None:
    assert listed(study_json_schema()) >= set(paths_of(StudyFile))


def test_every_key_says_what_stands_there() -> None:
    for schema in (json_schema(), study_json_schema()):
        keys = [key for group in groups(schema) for key in group.keys]
        assert [key.path for key in keys if not key.form or not key.meaning] == []


def test_keys_are_told_in_words() -> None:
    keys = {key.path: key for group in groups(json_schema()) for key in group.keys}
    resistance = keys["machine.resistance"]
    assert (resistance.form, resistance.unit) == ("resistance", "Ohm")
    assert "2 mOhm" in resistance.examples
    assert resistance.kinds == ("phase (default)", "line-to-line")
    assert resistance.required
    assert keys["fit.torque_max"].former
    assert not keys["fit.max_torque"].former
    assert not keys["machine.inertia"].required
    assert keys["fit.degree"].form == "whole number, from 1 to 6"
    assert keys["fit.degree"].default == "4"
    assert keys["operation.strategy"].choices == ("mtpa", "id0")
    assert keys["control.tolerances.r_s"].form == "number, or share in %, or {from: ..., to: ...}"


def test_every_section_has_a_page_in_the_table_of_contents() -> None:
    schema = json_schema()
    wanted = {name for name, entry in schema["properties"].items() if "$ref" in entry}
    pages = {
        path.stem: path.read_text(encoding="utf-8")
        for path in (DOCS / "reference/design").glob("*.md")
    }
    found = {
        name
        for text in pages.values()
        for name in re.findall(r"^```\{design-keys\} (\w+)$", text, re.M)
    }
    assert found == wanted


def test_every_command_is_listed_once() -> None:
    text = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    directives = re.findall(r"^### `dqforge (\w+)`\n\n```\{dqforge-command\} (\w+)$", text, re.M)
    assert [first for first, _ in directives] == [second for _, second in directives]
    assert sorted(first for first, _ in directives) == sorted(COMMANDS)
    assert {name for name in COMMANDS if f"(#dqforge-{name})" not in text} == set()
    examples = re.findall(r"^    dqforge (\w+)", text, re.M)
    assert set(examples) == set(COMMANDS)


def test_every_public_name_has_one_place() -> None:
    texts = [
        path.read_text(encoding="utf-8") for path in sorted((DOCS / "reference/api").glob("*.md"))
    ]
    names = [
        name
        for text in texts
        for name in re.findall(r"^\.\. auto\w+:: dqforge\.(\w+)$", text, re.M)
    ]
    assert sorted(names) == sorted(dqforge.__all__)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_with_every_address_in_it(tmp_path: Path) -> None:
    """Twice, to the same bytes."""
    for name in ("first", "second"):
        command = [sys.executable, "-m", "sphinx", "-b", "html", "-E", "-W", "-n", "-q"]
        command += ["-d", str(tmp_path / f"trees-{name}"), str(DOCS), str(tmp_path / name)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
    first, second = (
        {
            path.relative_to(tmp_path / name): path.read_bytes()
            for path in (tmp_path / name).rglob("*")
            if path.is_file()
        }
        for name in ("first", "second")
    )
    assert first == second
    pages = {
        path.as_posix(): data.decode() for path, data in first.items() if path.suffix == ".html"
    }
    assert missing(pages, "reference/design/", listed(json_schema())) == []
    assert missing(pages, "reference/study", set(paths_of(StudyFile))) == []
    assert missing(pages, "reference/api/", {f"dqforge.{name}" for name in dqforge.__all__}) == []
    options = {
        f"{name}{max(option.opts, key=len)}"
        for name, command in COMMANDS.items()
        for option in command.params
        if option.param_type_name == "option"
    }
    wanted = options | {f"dqforge-{name}" for name in COMMANDS}
    assert missing(pages, "reference/commands", wanted) == []
    assert [(page, link) for page in pages for link in lost_anchors(pages, page)] == []
    asked = r"""(?:src|href|url\()=?["']?(https?:)?//[^"' )>]+\.(?:js|css|woff2?|png|svg)"""
    assert [page for page, text in pages.items() if re.search(asked, text)] == []


def missing(pages: dict[str, str], start: str, wanted: set[str]) -> list[str]:
    """Addresses that no page below a folder has."""
    text = "".join(content for name, content in pages.items() if name.startswith(start))
    return sorted(each for each in wanted if f'id="{each}"' not in text)


def lost_anchors(pages: dict[str, str], page: str) -> list[str]:
    """Links of a page to an address that its target does not have; linkchecker looks at files."""
    lost = []
    for link in set(re.findall(r'href="([^":]*#[^"]+)"', pages[page])):
        name, _, anchor = unquote(unescape(link)).partition("#")
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page), name)) if name else page
        if not re.search(rf"""(?:id|name)="{re.escape(escape(anchor))}\"""", pages.get(target, "")):
            lost.append(link)
    return lost
