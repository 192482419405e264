"""Which kind of value an entry has: by the words of its text, or by its key ``kind``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.kind_words import KindWords, kind_words
from dqforge.machines.wording import close_matches, shown

# Words that suggestions know besides the names of the kinds.
SPELLINGS = (
    "phase-to-phase",
    "terminal",
    "terminal-to-terminal",
    "l-l",
    "per phase",
    "phase-to-neutral",
    "winding",
    "pk",
    "amplitude",
    "effective",
)


@dataclass(frozen=True, slots=True)
class KindChoice:
    """Kinds of which an entry has one.

    Args:
        kinds: Their names, such as ``phase`` and ``line-to-line``.
        places: What other places are called here (`Dimension.places`).
    """

    kinds: tuple[str, ...]
    places: Mapping[str, str]

    def named(self, text: str) -> KindWords:
        """Marks of the key ``kind``.

        Raises:
            InputError: The text is no kind, or leaves it open.
        """
        words = kind_words(text)
        if words is None:
            raise InputError(self._none_of(text))
        return words

    def meant(self, said: Sequence[KindWords]) -> str | None:
        """The kind that is meant by what the text and the key say, None where they say nothing.

        Raises:
            InputError: They contradict each other, name none of the kinds, or leave open which.
        """
        marks = [(words, (self._place(words), words.measure)) for words in said]
        place, measure = (
            next((mark[slot] for _, mark in marks if mark[slot]), "") for slot in (0, 1)
        )
        for words, mark in marks:
            if mark[0] not in ("", place) or mark[1] not in ("", measure):
                raise InputError(
                    f"the text says {shown(said[0].text)}, its kind says {shown(words.text)}; "
                    "remove the wrong one"
                )
        if not place and not measure:
            return None
        texts = ", ".join(words.text for words in said)
        slots = {kind: _slots(kind) for kind in self.kinds}
        exact = [kind for kind, own in slots.items() if own == (place, measure)]
        fitting = exact or [
            kind
            for kind, (own_place, own_measure) in slots.items()
            if place in ("", own_place) and measure in ("", own_measure)
        ]
        if not fitting:
            raise InputError(self._none_of(texts))
        if len(fitting) > 1:
            raise InputError(f"{shown(texts)} leaves open {' or '.join(fitting)}; write one")
        return fitting[0]

    def _place(self, words: KindWords) -> str:
        """The place that words name, as the kinds call it; empty where it says nothing here."""
        known = {_slots(kind)[0] for kind in self.kinds}
        place: str | None = words.place
        while place and place not in known:
            place = self.places.get(place)
        if place is None:
            raise InputError(self._none_of(words.text))
        return place

    def _none_of(self, text: str) -> str:
        near = close_matches(text, [*self.kinds, *SPELLINGS], limit=1)
        hint = f"; did you mean '{near[0]}'?" if near and near[0] != text else ""
        return f"expected one of {', '.join(self.kinds)}, got the text {shown(text)}{hint}"


@cache
def _slots(kind: str) -> tuple[str, str]:
    """Place and measure of the name of a kind."""
    words = kind_words(kind)
    return ("", "") if words is None else (words.place, words.measure)
