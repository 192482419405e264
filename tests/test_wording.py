"""What users read is free of the phrases that the list of words replaces."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "docs" / "project" / "wording.md"
PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "reference" / "messages.yaml",
    *sorted((ROOT / "docs").rglob("*.md")),
]
# Rooms and modules whose words go into emitted C, which keeps its bytes, or quote a paper.
EMITTED = re.compile(
    r"(?:optimizer/(?:fixed_|float_control|harmonic_trackers|learned_correction|observers"
    r"|saliency|six_step|steps|estimators)"
    r"|reports/(?:c_code|control|fixed_observers|observers|papers|phase_control|simulation/"
    r"|single_headers|six_step|steps|current_reference/plain|waveforms/tables|loops/proven_text"
    r"|[a-z_]+/(?:fixed_)?header))"
)


@cache
def phrases() -> re.Pattern[str]:
    """All phrases of the left column; a line may end within one."""
    rows = re.findall(r"^\| ([^|]+) \| [^|]+ \|$", LIST.read_text(encoding="utf-8"), re.MULTILINE)
    words = [word.strip() for row in rows[1:] for word in row.split(",")]
    either = "|".join(re.escape(word).replace(r"\ ", r"\s+") for word in words)
    return re.compile(rf"\b(?:{either})\b", re.IGNORECASE)


def prose(text: str) -> str:
    """A page without its code, lines kept."""

    def blank(found: re.Match[str]) -> str:
        return "\n" * found.group().count("\n")

    text = re.sub(r"^(`{3,}).*?^\1`*$", blank, text, flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"`[^`\n]*`", "`", text)


def suspect(source: str) -> bool:
    """Whether a line with a quotation mark has a phrase, docstrings aside: a module without one is
    not parsed.
    """
    source = re.sub(r'(\A|:\n *)"""[^"]*?"""\n', r"\1\n", source)
    lines = "\n".join(line for line in source.splitlines() if '"' in line)
    return phrases().search(re.sub(r'"\s*f?"', "", lines)) is not None


def literals(path: Path) -> list[tuple[int, str]]:
    """Texts of a module with a space in them, line by line; docstrings only of commands."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    silent = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, kinds) and node.body and isinstance(node.body[0], ast.Expr)
        if not (isinstance(node, ast.FunctionDef) and path.name == "cli.py")
    }
    texts = []
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [v.value if isinstance(v, ast.Constant) else "{}" for v in node.values]
            texts.append((node.lineno, "".join(map(str, parts))))
            silent |= {id(value) for value in node.values}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            texts += [(node.lineno, node.value)] * (id(node) not in silent)
    return [(line, text) for line, text in texts if " " in text.strip()]


def found(texts: list[tuple[int, str]]) -> list[str]:
    """Lines and phrases."""
    return [
        f"{line + text.count(chr(10), 0, hit.start())}: {hit.group()}"
        for line, text in texts
        for hit in phrases().finditer(text)
    ]


def test_the_list_is_small_enough_to_be_used() -> None:
    rows = LIST.read_text(encoding="utf-8").count("\n| ") - 1
    assert 25 <= rows <= 60


def test_phrases_are_found() -> None:
    assert phrases().search("the torque Asked for")
    assert not phrases().search("masked form")
    assert prose("a `told` b\n```\njudged\n```\n") == "a ` b\n\n\n\n"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_is_written_in_the_words_of_the_field(page: Path) -> None:
    if page != LIST:
        assert not found([(1, prose(page.read_text(encoding="utf-8")))])


def test_messages_and_help_are_written_in_the_words_of_the_field() -> None:
    """Those of C that keep their bytes are left out."""
    faults = []
    for folder in ("machines", "optimizer", "reports", "cli.py"):
        place = ROOT / folder
        for path in [place] if place.is_file() else sorted(place.rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not EMITTED.match(name) and (
                name == "cli.py" or suspect(path.read_text(encoding="utf-8"))
            ):
                faults += [f"{name}:{fault}" for fault in found(literals(path))]
    assert not faults


def test_reports_are_written_in_the_words_of_the_field() -> None:
    templates = sorted((ROOT / "reports").rglob("*.html.j2"))
    texts = {path: re.sub(r"<[^>]*>|\{[{%#].*?[%}#]\}", "", path.read_text()) for path in templates}
    assert not [f"{path.name}:{fault}" for path, t in texts.items() for fault in found([(1, t)])]
