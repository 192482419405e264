"""Emitted C as it was when it was last accepted: what a change of it alters is seen and named.

A case of `kept_drives` gives texts of programs, none of which is compiled. Of each text
`tests/kept/CASE.json` keeps, definition by definition, a few letters for the words of every
statement, and its numbers. Words are compared exactly. Numbers may differ by 1e-3, as solvers on
other machines round otherwise; those of at most four digits, and powers of two, are taken to be
written by hand and must be the same. Of a long table some entries and two
sums are kept.

This finds what was not meant to change; it proves nothing of what the program does: tests of its
physics do that. Where the change is meant, look at the text and accept it:

    python tests/kept_output.py --update             all cases
    python tests/kept_output.py --update simulation  one
"""

from __future__ import annotations

import base64
import cProfile
import hashlib
import json
import multiprocessing
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

import house

KEPT = Path(__file__).with_name("kept")
TEST = "tests/test_kept_output.py::test_text_is_as_it_was_kept"
TEXTS = (".h", ".c", ".xml", ".ld", "_ranges.json")
# Of one case, definitions by the name of the text: letters of the statements, and numbers; or
# which earlier text has the same.
Kept = dict[str, dict[str, str]]
SAME = "@"
COMMENT = re.compile(r"/\*.*?\*/|<!--.*?-->", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])(?!0x)\d+\.?\d*(?:[eE][-+]?\d+)?(?=[FfULul]*(?![\w.]))")
ENTRY = re.compile(r"-?0x[0-9A-F]+|-?" + NUMBER.pattern)
ORIGIN = re.compile(r"Made by dqforge[^\n]*|Input file: [^\n]*")
TABLE = re.compile(r"^[^{;]*=\s*\{")
# What is asked of the cases that come to it (`mutants`): templates and number formats.
MAKERS = re.compile(r"reports/.*\.j2$|optimizer/(fixed_\w+|curves)/")
LONG, ENTRIES, LETTERS = 48, 12, 2
WITHIN, EXACT, NOTHING = 1e-3, 1e-6, 1e-12
FEW_DIGITS, SMALL_CODE = 4, 64
# Numbers in comments are rounded: the last digit may be another.
COMMENTS, MACROS = "comments", "macros"


def definitions(text: str) -> Iterator[tuple[str, str]]:
    """What stands at the top level of a text, by its name; all macros together, and comments."""
    plain = ORIGIN.sub("", text)
    yield COMMENTS, "".join(f"{' '.join(found.split())};" for found in COMMENT.findall(plain))
    lines = COMMENT.sub(" ", plain).replace("\\\n", " ").splitlines()
    yield MACROS, "".join(f"{line};" for line in lines if line.startswith("#"))
    held: list[str] = []
    depth = 0
    for line in lines:
        if line.startswith(("#", 'extern "C"')) or not line.strip():
            continue
        held.append(line)
        depth += line.count("{") - line.count("}")
        if depth <= 0 and line.rstrip().endswith((";", "}")):
            whole, depth = " ".join(held), 0
            names = re.search(r"(\w+)\s*(?:[\[=(]|;\s*$)", whole)
            yield names.group(1) if names else "rest", whole
            held = []
    if held:
        yield "rest", " ".join(held)


def statements(body: str) -> Iterator[tuple[str, list[str]]]:
    """Words of each statement, with # for the numbers, and these; long tables in short."""
    whole = " ".join(body.split())
    if TABLE.search(whole) and len(ENTRY.findall(whole)) > LONG:
        parts = [whole]
    else:
        parts = re.split(r"(?<=[;{}])", whole)
    for part in parts:
        entries = ENTRY.findall(part)
        if len(entries) > LONG:
            values = [float(entry) for entry in entries if "0x" not in entry]
            some = values[:: -(-len(values) // ENTRIES)] if values else []
            size = sum(map(abs, values)), sum(k * abs(x) for k, x in enumerate(values, 1))
            yield f"{len(entries)} entries", [f"{number:.6g}" for number in (*some, *size)]
        elif part.strip():
            yield NUMBER.sub("#", part.strip()), NUMBER.findall(part)


def in_short(words: str) -> str:
    """Some letters for the words of a statement."""
    return base64.b64encode(hashlib.sha256(words.encode()).digest()).decode()[:LETTERS]


def kept_form(texts: Mapping[str, str]) -> Kept:
    """What is kept of texts by their names."""
    kept: Kept = {}
    first: dict[tuple[str, str], str] = {}
    for name, text in texts.items():
        kept[name] = {}
        for title, body in _bodies(text).items():
            found = list(statements(body))
            letters = "".join(in_short(words) for words, _ in found)
            numbers = [_shortened(number) for _, those in found for number in those]
            form = " ".join([letters, *numbers])
            there = first.setdefault((title, form), name)
            kept[name][title] = form if there == name else SAME + there
    return kept


def _bodies(text: str) -> dict[str, str]:
    """Definitions by name, those of one name together."""
    found: dict[str, str] = {}
    for title, body in definitions(text):
        found[title] = found.get(title, "") + body
    return found


def _shortened(number: str) -> str:
    return number if number.isdecimal() else f"{float(number):.6g}"


def _same(kept: str, found: str, *, code: bool, table: bool) -> bool:
    """Whether a number is the one that was kept, as far as its digits say it."""
    was, now = float(kept), float(found)
    digits = len(re.sub(r"e.*|^0*\.?0*|\.", "", kept))
    apart = WITHIN * abs(was)
    if not code:
        apart = max(apart, 1.01 * 10.0 ** -len(kept.partition("e")[0].partition(".")[2]))
    elif kept.isdecimal() and table and was >= SMALL_CODE:
        apart = max(apart, 1.0)
    elif digits <= FEW_DIGITS or (kept.isdecimal() and _of_two(int(kept))):
        apart = EXACT * abs(was)
    return abs(now - was) <= apart + NOTHING


def _of_two(number: int) -> bool:
    return not number & (number - 1) or not number & (number + 1)


def differences(texts: Mapping[str, str], kept: Kept) -> Iterator[str]:
    """Text, definition and first differing statement or number, for each definition."""
    for name in sorted(kept.keys() ^ texts.keys()):
        yield f"{name}: {'is new' if name in texts else 'is no longer there'}"
    for name in sorted(kept.keys() & texts.keys()):
        bodies = _bodies(texts[name])
        for title in sorted(bodies.keys() | kept[name].keys()):
            was = kept[name].get(title, "")
            if was.startswith(SAME):
                was = kept[was.removeprefix(SAME)][title]
            said = _difference(title, bodies.get(title, ""), was)
            if said:
                yield f"{name}: {title}: {said}"


def _difference(title: str, body: str, kept: str) -> str:
    letters, *numbers = kept.split(" ")
    was, left = re.findall("." * LETTERS, letters), iter(numbers)
    now = list(statements(body))
    table = title == MACROS or TABLE.search(body) is not None
    for k, (words, found) in enumerate(now):
        if k >= len(was) or in_short(words) != was[k]:
            return f"statement {k + 1} is now: {words}"
        for number in found:
            before = next(left, "nan")
            if not _same(before, number, code=title != COMMENTS, table=table):
                return f"{before} is now {number} in: {words}"
    return f"{len(was) - len(now)} statements are gone" if len(was) > len(now) else ""


def texts_of(made: Mapping[str, bytes | str]) -> dict[str, str]:
    """Those of the files that are text of programs."""
    return {
        name: content.decode() if isinstance(content, bytes) else content
        for name, content in made.items()
        if name.endswith(TEXTS)
    }


@cache
def kept_of(case: str) -> dict[str, Any]:
    """What is kept of a case: its texts, and the files of the product that make them."""
    found: dict[str, Any] = json.loads((KEPT / f"{case}.json").read_text(encoding="utf-8"))
    return found


@cache
def making(path: str) -> list[str]:
    """Cases that run or render a file of the product, quick ones first."""
    import kept_drives

    return [case for case in kept_drives.CASES if path in kept_of(case)["made by"]]


def update(case: str) -> None:
    """Keep the texts of a case as they are now."""
    import kept_drives

    profile = cProfile.Profile(subcalls=False, builtins=False)
    with kept_drives.rendered() as names:
        made = profile.runcall(kept_drives.CASES[case])
    codes = [entry.code for entry in profile.getstats() if isinstance(entry.code, CodeType)]
    ran = {Path(code.co_filename) for code in codes if code.co_name != "<module>"}
    own = (path.relative_to(house.ROOT) for path in ran if path.is_relative_to(house.ROOT))
    makes = {path.as_posix() for path in own} | names.keys()
    kept = {"made by": sorted(filter(MAKERS.match, makes)), "texts": kept_form(texts_of(made))}
    KEPT.mkdir(exist_ok=True)
    (KEPT / f"{case}.json").write_text(json.dumps(kept, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    import kept_drives

    for wanted in sys.argv[2:] or kept_drives.CASES:
        # Each in a process of its own: what one solves, the next would not come to.
        process = multiprocessing.get_context("fork").Process(target=update, args=(wanted,))
        process.start()
        process.join()
