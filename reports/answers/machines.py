"""What `dqforge machines` answers: the library of drives and motors, by the heads of its files.

Nothing heavy is imported, and no drive is loaded: a list is there at once.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.files.library_files import DESIGNS, MOTORS, LibraryEntry, read_design
from dqforge.reports.pages.answer import Answer, Table

# Between a digit and a letter: 48V is found as 48 V, and AK80 as AK 80.
_SEAM = re.compile(r"(?<=\d)(?=[^\W\d])|(?<=[^\W\d])(?=\d)")

_START = "dqforge new DIR --machine NAME starts from one"


def answer_machines(name: str | None, search: str | None = None) -> Answer:
    """The drives and motors of the library, those that match, or the design file of one.

    Args:
        name: Of the one whose file is asked for.
        search: Words of its name, title, sentence or tags.

    Raises:
        InputError: There is none of this name, nothing matches, or both are asked for.
    """
    if name is not None and search is not None:
        raise InputError("--search lists what matches and NAME prints one; omit one of them")
    if name is not None:
        text = read_design(name).decode("utf-8")
        return Answer(name, (), {"text": text}, notes=(text.removesuffix("\n"),))
    drives, motors = DESIGNS.entries(), MOTORS.entries()
    if search is None:
        notes = _START, "dqforge machines --search WORDS finds one"
        return _listed(drives, motors, notes=notes, more={})
    found = _matching([*motors, *drives], search)
    if not found:
        raise _nothing(search, [*drives, *motors])
    following = f"dqforge new my-{found[0].key} --machine {found[0].key}"
    kept = [entry for entry in drives if entry in found]
    kept_motors = [entry for entry in motors if entry in found]
    return _listed(kept, kept_motors, notes=(f"next: {following}",), more={"next": following})


def _listed(
    drives: Sequence[LibraryEntry],
    motors: Sequence[LibraryEntry],
    *,
    notes: tuple[str, ...],
    more: dict[str, str],
) -> Answer:
    """One table of each kind of which there is anything."""
    kinds = ("Library drives", "drive", drives), ("Library motors", "motor", motors)
    tables = [
        Table(title, ("name", kind, "about"), tuple((e.key, e.name, e.about) for e in entries))
        for title, kind, entries in kinds
        if entries
    ]
    plain = {
        f"{key}s": [{"name": e.key, kind: e.name, "about": e.about} for e in entries]
        for key, kind, entries in (("machine", "drive", drives), ("motor", "motor", motors))
    }
    return Answer("", tables, plain | more, notes=notes)


def _matching(entries: Sequence[LibraryEntry], search: str) -> list[LibraryEntry]:
    """Entries in which all words begin a word, the words of the search together where some do."""
    words = _spelled(search)
    texts = [(entry, f" {_spelled(_text(entry))}") for entry in entries]
    if together := [entry for entry, text in texts if words and f" {words}" in text]:
        return together
    return [
        entry
        for entry, text in texts
        if words and all(f" {word}" in text for word in words.split())
    ]


def _text(entry: LibraryEntry) -> str:
    return f"{entry.key}; {entry.name}; {entry.about}; {entry.tags}"


def _spelled(text: str) -> str:
    """Small letters and figures, one blank between words: E-Bike 48V is e bike 48 v."""
    return " ".join(re.sub(r"[^\w.]+", " ", _SEAM.sub(" ", text.casefold())).split())


def _nothing(search: str, entries: Sequence[LibraryEntry]) -> InputError:
    """Error that says what there is, or which words are like those of the search."""
    tags = [tag.strip() for entry in entries for tag in entry.tags.split(",") if tag.strip()]
    keys = [entry.key for entry in entries]
    near = close_matches(search.strip().casefold(), dict.fromkeys([*keys, *tags]))
    kinds = ", ".join(_commonest(tags))
    hint = (
        f"did you mean {' or '.join(shown(word) for word in near)}?"
        if near
        else f"there are {kinds} and more: 'dqforge machines' lists them"
    )
    return InputError(f"nothing in the library matches {shown(search)}; {hint}")


# Words that a line has room for.
_MOST_WORDS = 8


def _commonest(tags: Sequence[str]) -> list[str]:
    """Tags of most motors, in the order in which they first come where equally many have them."""
    return sorted(dict.fromkeys(tags), key=lambda tag: -tags.count(tag))[:_MOST_WORDS]
