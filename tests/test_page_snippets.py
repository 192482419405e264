"""What stands in code on the pages that are not run: command lines are those of the commands, keys
those of the schemas, whole designs are read, and blocks of Python are Python.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from documented_sessions import ROOT
from session_pages import Block, parts_of

from dqforge.cli import app
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.schema import json_schema

RUN = ("tutorials", "how-to")
PAGES = [
    page
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if page.parent.name not in RUN
]
# Keys of files that other programs read.
OF_OTHERS = {"distributed"}
# How pages write what a reader has to put in, and what may be left out.
_OPTIONAL = re.compile(r"[\[\]]|\.\.\.|…")


@dataclass(frozen=True)
class Snippet:
    """Code of a page: where, in which language, and whether it stands in the line of a sentence."""

    place: str
    language: str
    text: str
    inline: bool = False


@cache
def _snippets(page: Path) -> list[Snippet]:
    return list(_found(page.relative_to(ROOT), page.read_text(encoding="utf-8")))


def _found(page: Path, text: str) -> Iterator[Snippet]:
    begun = ""
    for part in parts_of(text.splitlines(), 1, str(page)):
        if isinstance(part, Block):
            yield Snippet(f"{page}:{part.line}", part.language, part.text)
            continue
        number, line = part
        if line.startswith("    "):
            begun += line.strip()
            if begun.endswith("\\"):  # it goes on in the next line
                begun = begun[:-1]
                continue
            yield Snippet(f"{page}:{number}", "console", begun)
            begun = ""
        for code in re.findall(r"`([^`]+)`", line):
            yield Snippet(f"{page}:{number}", "console", code, inline=True)


def _commands(snippet: Snippet) -> Iterator[list[str]]:
    """Words of every command line of dqforge in a snippet, without what a shell does with them."""
    for line in snippet.text.replace("\\\n", " ").splitlines():
        found = re.match(r"(?:\$ )?(?:\S*/)?dqforge (.*)", line.strip())
        if found is None or snippet.language not in ("console", "sh", "bash", "shell", "text", ""):
            continue
        words = shlex.split(_OPTIONAL.sub("", found[1]), comments=True)
        ends = [n for n, word in enumerate(words) if word[:1] in {"|", ">", "&", ";", "<"}]
        yield words[: ends[0]] if ends else words


@cache
def _group() -> Any:
    return typer.main.get_command(app)


def _fault(words: list[str], *, whole: bool) -> str:
    """What the command line says to these words; empty where it takes them.

    A line that is not ``whole`` may leave out arguments and the value of its last option: it names
    a command.
    """
    group = _group()
    if not words or words[0].startswith("-"):
        return "" if words and words[0] in {"-h", "--help", "--version"} else "no command"
    name, *arguments = words
    if name not in group.commands:
        return f"there is no command {name}"
    command = group.commands[name]
    context = command.context_class(command, info_name=name)
    try:
        values, left, _ = command.make_parser(context).parse_args(list(arguments))
    except Exception as error:  # whichever of click or its copy in typer says so
        named = not whole and words[-1].startswith("-") and "requires an argument" in str(error)
        return "" if named else str(error)
    missing = [
        parameter.name
        for parameter in command.params
        if parameter.param_type_name == "argument" and parameter.required
        if not values.get(parameter.name or "")
    ]
    if left:
        return f"{' '.join(left)} is too much"
    return f"{', '.join(map(str, missing))} is missing" if whole and missing else ""


def test_command_lines_are_those_of_the_commands() -> None:
    faults = [
        f"{snippet.place}: dqforge {' '.join(words)}: {fault}"
        for page in PAGES
        for snippet in _snippets(page)
        for words in _commands(snippet)
        if (fault := _fault(words, whole=not snippet.inline))
    ]
    assert faults == []


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("check design.yaml", ""),
        ("check", "design is missing"),
        ("chek design.yaml", "there is no command chek"),
        ("check design.yaml --plot x.svg", "No such option"),
        ("check one.yaml two.yaml", "two.yaml is too much"),
        ("tune design.yaml --set", "requires an argument"),
        ("run design.yaml -o out --set machine.resistance='12 mOhm'", ""),
        ("", "no command"),
    ],
)
def test_faults_of_command_lines_are_seen(line: str, said: str) -> None:
    assert said in _fault(shlex.split(line), whole=True)
    assert bool(said) == bool(_fault(shlex.split(line), whole=True))


@cache
def _design_schema() -> dict[str, Any]:
    return json_schema()


def _properties(node: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Keys that a node of the schema permits, each with the nodes that it leads to."""
    schema = _design_schema()
    found: dict[str, list[dict[str, Any]]] = {}
    waiting = [node]
    while waiting:
        each = waiting.pop()
        if "$ref" in each:
            waiting.append(schema["$defs"][each["$ref"].rsplit("/", 1)[1]])
        waiting += [*each.get("anyOf", ()), *each.get("oneOf", ()), *each.get("allOf", ())]
        for key, value in each.get("properties", {}).items():
            found.setdefault(key, []).append(value)
        if isinstance(each.get("items"), dict):
            found.setdefault("[]", []).append(each["items"])
    return found


def _strange_keys(data: Any, nodes: list[dict[str, Any]], at: str) -> Iterator[str]:
    """Keys of a fragment that the schema does not have where they stand."""
    if isinstance(data, list):
        inner = [each for node in nodes for each in _properties(node).get("[]", [])]
        for item in data:
            yield from _strange_keys(item, inner, at)
    elif isinstance(data, dict):
        known: dict[str, list[dict[str, Any]]] = {}
        for node in nodes:
            for key, values in _properties(node).items():
                known.setdefault(key, []).extend(values)
        for key, value in data.items():
            path = f"{at}.{key}" if at else str(key)
            if key in known:
                yield from _strange_keys(value, known[key], path)
            else:
                yield path


def _faults_of_yaml(snippet: Snippet) -> list[str]:
    data = yaml.safe_load(snippet.text)
    if not isinstance(data, dict):
        return [f"{snippet.place}: no mapping"]
    if "dqforge" in data and "machine" in data:
        load_text(snippet.text.encode(), snippet.place)
        return []
    if set(data) <= OF_OTHERS:
        return []
    return [f"{snippet.place}: {key}" for key in _strange_keys(data, [_design_schema()], "")]


def test_blocks_of_yaml_are_designs_or_parts_of_one() -> None:
    found = [snippet for page in PAGES for snippet in _snippets(page)]
    blocks = [snippet for snippet in found if snippet.language == "yaml"]
    assert blocks
    assert [fault for snippet in blocks for fault in _faults_of_yaml(snippet)] == []


def test_strange_keys_of_a_fragment_are_seen() -> None:
    text = "control: {speed_loop: {ratio: 2, raio: 3}}\nlosses: {points: [{torqe: 1}]}\nsorts: 1\n"
    snippet = Snippet("page.md:1", "yaml", text)
    assert _faults_of_yaml(snippet) == [
        "page.md:1: control.speed_loop.raio",
        "page.md:1: losses.points.torqe",
        "page.md:1: sorts",
    ]


def test_blocks_of_python_are_python() -> None:
    for snippet in (snippet for page in PAGES for snippet in _snippets(page)):
        if snippet.language == "python":
            compile(snippet.text, snippet.place, "exec")
