"""Words that say of which kind a value is: ``line-to-line``, ``phase-to-phase``, ``rms``.

Data sheets write them behind a unit (``100 mOhm phase-to-phase``), within it (``12 Vrms/krpm``) or
alone, and each in many ways. Here they become two marks: the place that a value belongs to, and its
measure. Which of them a key may have, the key says (`dqforge.machines.entries.rules`).
"""

from __future__ import annotations

import re
from functools import lru_cache

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import COMPOUNDS, SYMBOLS
from dqforge.machines.wording import shown

_TO = r"[\s_-]*(?:to|2)?[\s_-]*"
_OF = r"(?:(?:per|of|each|one|a|the)[\s_-]+)*"
_BETWEEN = r"between[\s_-]+(?:(?:the|two)[\s_-]+)*"

# What each place is called, where ``phase`` is one phase to the star point.
_PLACES = {
    "line-to-line": (
        rf"(?:motor[\s_-]+)?line{_TO}line|l{_TO}l|phase{_TO}phase|ph{_TO}ph|{_BETWEEN}(?:phases|lines)"
    ),
    "terminal": rf"(?:{_BETWEEN}|{_OF})(?:motor[\s_-]+)?terminals?(?:{_TO}terminals?)?|t{_TO}t",
    "phase": rf"(?:line|phase|ph|l){_TO}(?:neutral|n|star[\s_-]*point)|{_OF}phase|{_OF}ph",
    "winding": rf"{_OF}winding",
    "line": rf"{_OF}line",
}

_MEASURES = {
    "rms": r"r\.?m\.?s\.?|eff(?:ective)?",
    "peak": r"(?:zero|0|o)[\s_-]*(?:to[\s_-]*)?(?:peak|pk|p)|peak|pk|p|amplitude|ampl|crest",
    "power-invariant": r"power[\s_-]*invariant",
}

# Words that leave the kind open, and what to say of them.
_OPEN = {
    "peak to peak": (
        rf"(?:peak|pk|p){_TO}(?:peak|pk|p)",
        "is twice the peak; write half of the value, and peak",
    ),
    "largest": (r"max(?:imum)?", "does not say of which kind the value is; write peak or rms"),
    "mean": (r"average|avg|mean", "is none of the kinds that are read; write peak or rms"),
    "direct": (r"dc", "is none of the kinds that are read; write peak or rms"),
    "alternating": (r"ac", "does not say of which kind the value is; write peak or rms"),
}

_PHRASES = [
    *((name, pattern) for name, (pattern, _) in _OPEN.items()),
    *_PLACES.items(),
    *_MEASURES.items(),
]
_PHRASE = "(?:" + "|".join(pattern for _, pattern in _PHRASES) + ")"
_GAP = r"[\s,;_-]*"
# At most six, so that a hostile text is not tried in every way to cut it.
_CHAIN = rf"(?i:{_PHRASE}(?:{_GAP}{_PHRASE}){{0,5}})"
_LETTER = r"A-Za-zµμΩ\N{OHM SIGN}°"
# Units that kinds are glued to: ``Arms``, ``mV_pk``.
_CARRIER = r"[munkµμM]?[AV]|(?i:amp(?:ere)?s?|volts?)"

_FOUND = re.compile(
    rf"(?:(?<![{_LETTER}])(?P<unit>{_CARRIER})|(?<![{_LETTER}])|(?=[\s,;_(\[-])){_GAP}"
    rf"(?:\(\s*(?P<round>{_CHAIN})\s*\)|\[\s*(?P<square>{_CHAIN})\s*\]|(?P<plain>{_CHAIN}))"
    rf"(?![{_LETTER}0-9])"
)

_SINGLE = (
    "lines?|phases?|to|2|l|ph|neutral|n|star|point|between|two|the|terminals?|t|motor|per|of|each"
    "|one|a|winding|r\\.?m\\.?s\\.?|eff|effective|zero|0|o|peak|pk|p|amplitude|ampl|crest|power"
    "|invariant"
)


def words_pattern() -> str:
    """Regular expression, as editors have it, of what consists of the words of kinds: it refuses
    what none can be, and leaves to the reader which words go together.
    """
    words = re.sub(r"\\.|[a-z]", lambda c: _either_case(c.group()), _SINGLE)
    return rf"^[\s(]*(?:(?:{words})[\s_,;()-]*)+$"


def _either_case(part: str) -> str:
    return part if part.startswith("\\") else f"[{part}{part.upper()}]"


@dataclass(frozen=True, slots=True)
class KindWords:
    """The marks that a text names: `place` and `measure`, empty where it does not say; `text` holds
    its words as they stand there.
    """

    place: str = ""
    measure: str = ""
    text: str = ""


@lru_cache(maxsize=512)
def kind_words(text: str) -> KindWords | None:
    """Marks of a text that consists of such words, None where it holds others.

    Raises:
        InputError: Its words leave the kind open (``max``), or contradict each other.
    """
    names = _phrases(text.strip(" ,;_-()[]"))
    if not names:
        return None
    for name in names:
        if name in _OPEN:
            raise InputError(f"{shown(text)} {_OPEN[name][1]}")
    marks = {}
    for slot, known in (("place", _PLACES), ("measure", _MEASURES)):
        found = dict.fromkeys(name for name in names if name in known)
        if len(found) > 1:
            raise InputError(f"{shown(text)} names two kinds, {' and '.join(found)}; write one")
        marks[slot] = next(iter(found), "")
    return KindWords(**marks, text=text.strip())


def without_kind(unit: str) -> tuple[str, str]:
    """A unit as it is without the words of kinds, and these words.

    Examples:
        >>> without_kind("Vrms/krpm line-to-line") ('V/krpm', 'rms line-to-line')
    """
    words = []

    def lift(match: re.Match[str]) -> str:
        chain = match["round"] or match["square"] or match["plain"]
        lone = chain.casefold() == "p" and not match["unit"]
        if lone or chain in SYMBOLS or chain in COMPOUNDS:  # 5 pH are picohenry
            return match.group()
        words.append(chain)
        return match["unit"] or ""

    plain = _FOUND.sub(lift, unit)
    return (plain.strip(" ,;") if words else unit), " ".join(words)


def _phrases(text: str) -> tuple[str, ...]:
    """Names of the phrases that a text consists of, none where it holds anything else."""
    for name, pattern in _PHRASES:
        match = re.match(f"(?i:{pattern})", text)
        if match is None:
            continue
        rest = text[match.end() :].lstrip(" ,;_-")
        if not rest:
            return (name,)
        if further := _phrases(rest):
            return (name, *further)
    return ()
