"""Emitted C, and what functions of physics return, as they were when last accepted: what a change
alters is seen and named.

A case of `kept_drives` gives texts of programs, none of which is compiled; one of `kept_runs` is a
command, or are tests. Of what functions return meanwhile, see `kept_values`. Of each text
`tests/kept/CASE.json` keeps, definition by definition, a few letters for the words of every
statement, and its numbers. Words are compared exactly. Numbers may differ by 1e-3, as solvers on
other machines round otherwise; those of at most four digits, and powers of two, are taken to be
written by hand and must be the same. Of a long table some entries and two
sums are kept.

This finds what was not meant to change; it proves nothing of what the program does: tests of its
physics do that. Where the change is meant, look at what is named and accept it:

    python tests/kept_output.py --update             all cases
    python tests/kept_output.py --update simulation  one
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import Any

import drawn_cases

from dqforge.reports.operating_system.system import fix_kernels

if __name__ == "__main__" and "--other" not in sys.argv:
    fix_kernels()  # before numpy is there

import kept_values
from kept_values import in_short

KEPT = Path(__file__).with_name("kept")
TEST = drawn_cases.OF_KEPT.rstrip("[")
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


def kept_form(texts: Mapping[str, str]) -> Kept:
    """What is kept of texts by their names."""
    kept: Kept = {}
    first: dict[tuple[str, str], str] = {}
    for name, text in texts.items():
        kept[name] = {}
        for title, body in _bodies(text).items():
            found = list(statements(body))
            letters = "".join(in_short(words, LETTERS) for words, _ in found)
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
        if k >= len(was) or in_short(words, LETTERS) != was[k]:
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
    """What is kept of a case: the templates that it renders, their texts, and values by file."""
    found: dict[str, Any] = json.loads((KEPT / f"{case}.json").read_text(encoding="utf-8"))
    return found


def cases() -> dict[str, Callable[[], Mapping[str, bytes | str]]]:
    """All of them by name; those of texts first, quick ones first."""
    import kept_drives
    import kept_runs

    return kept_drives.CASES | kept_runs.cases()


@cache
def making(path: str, line: int = 0) -> list[str]:
    """Cases that render a template, or come to a function around the line, the quick ones first."""
    costs = drawn_cases.kept_costs()
    names = kept_values.around(path, line) if path.endswith(".py") else []
    letters = {in_short(name) for name in names}

    def makes(case: str) -> bool:
        if not (KEPT / f"{case}.json").is_file():
            return False  # new, not yet kept
        kept = kept_of(case)
        return path in kept["made by"] or not letters.isdisjoint(
            kept["values"].get(path, "").split()[::2]
        )

    return sorted(filter(makes, cases()), key=lambda case: costs.get(f"{TEST}[{case}]", 0.0))


def recorded(case: str) -> tuple[dict[str, str], dict[str, str], kept_values.Record]:
    """Templates that a case renders, texts that it makes, and what functions return meanwhile."""
    import kept_drives

    record = kept_values.Record()
    with kept_drives.rendered() as names:
        made = record.of(cases()[case])
    return names, texts_of(made), record


def all_differences(case: str) -> list[str]:
    """What is not as it was kept, the texts first."""
    kept = kept_of(case)
    names, texts, record = recorded(case)
    found = [*differences(texts, kept["texts"])]
    found += [f"{name} is rendered" for name in sorted(names.keys() - set(kept["made by"]))]
    found += [f"{name} is not rendered" for name in sorted(set(kept["made by"]) - names.keys())]
    return [*found, *kept_values.differences(record, kept["values"])]


def _each(wanted: Iterable[str], work: Callable[[str], Any]) -> Iterator[Any]:
    """What work on cases gives, each in a process of its own, as what one solves the next would not
    come to.

    Raises:
        SystemExit: One fails.
    """
    kept_values.forget()
    for case in wanted:
        mine, theirs = os.pipe()
        child = os.fork()
        if not child:
            with os.fdopen(theirs, "w") as end, redirect_stdout(sys.stderr):
                json.dump(work(case), end)
            os._exit(0)
        os.close(theirs)
        with os.fdopen(mine) as end:
            said = end.read()
        if os.waitpid(child, 0)[1]:
            sys.exit(f"{case}: fails")
        yield json.loads(said)


def _rows(record: kept_values.Record) -> list[list[Any]]:
    return [[*key, total] for key, total in record.sums.items()]


def _sums(case: str) -> list[list[Any]]:
    return _rows(recorded(case)[2])


def _kept(case: str) -> list[Any]:
    names, texts, record = recorded(case)
    return [sorted(names), kept_form(texts), _rows(record)]


def update(wanted: Sequence[str]) -> None:
    """Keep what cases make now, and what their functions return with other kernels, too."""
    words = [sys.executable, __file__, "--other", *wanted]
    KEPT.mkdir(exist_ok=True)
    known = {case: k for k, case in enumerate(cases())}
    for path in KEPT.iterdir():
        if path.stem not in known:
            path.unlink()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        for case, (names, texts, sums) in zip(wanted, _each(wanted, _kept), strict=True):
            there = {(path, name): total for path, name, total in json.loads(next(other.stdout))}
            here = {(path, name): total for path, name, total in sums}
            earlier = [
                kept_of(path.stem)["values"]
                for path in sorted(KEPT.iterdir())
                if known[path.stem] < known[case]
            ]
            values = kept_values.kept_form(here, there, earlier)
            kept = {"made by": names, "texts": texts, "values": values}
            text = json.dumps(kept, indent=0) + "\n"
            (KEPT / f"{case}.json").write_text(text, encoding="utf-8")


def main(how: str, *wanted: str) -> None:
    """Keep cases, all of them where none is named; or print what the functions of some return."""
    if how == "--update":
        update(wanted or list(cases()))
    elif how == "--other":
        for sums in _each(wanted, _sums):
            sys.stdout.write(json.dumps(sums) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
