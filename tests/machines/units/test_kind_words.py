"""Words of kinds: what each is called, where it may stand in a text, and what leaves it open."""

from __future__ import annotations

import itertools
import re

import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import kind_said, read_quantity
from dqforge.machines.units.registry import (
    COMPOUNDS,
    SYMBOLS,
    kind_words,
    without_kind,
    words_pattern,
)

PLACES = {
    "line-to-line": (
        "line-to-line",
        "line to line",
        "line-line",
        "line line",
        "line_to_line",
        "l-l",
        "ll",
        "l to l",
        "l2l",
        "phase-to-phase",
        "phase to phase",
        "phase-phase",
        "ph-ph",
        "between phases",
        "between two lines",
        "between two wires",
        "two wires",
        "wire to wire",
        "between the motor wires",
        "lead-to-lead",
    ),
    "terminal": (
        "terminal",
        "terminals",
        "terminal-to-terminal",
        "terminal to terminal",
        "t-t",
        "between terminals",
        "between two terminals",
        "two terminals",
    ),
    "phase": (
        "phase",
        "ph",
        "per phase",
        "of a phase",
        "each phase",
        "phase-to-neutral",
        "line-to-neutral",
        "line to neutral",
        "l-n",
        "ln",
        "ph-n",
        "phase to star point",
    ),
    "winding": ("winding", "per winding", "of one winding"),
    "line": ("line", "per line"),
}
MEASURES = {
    "rms": ("rms", "r.m.s.", "eff", "effective"),
    "peak": ("peak", "pk", "amplitude", "crest", "zero-to-peak", "0-pk", "0-p"),
    "power-invariant": ("power-invariant", "power invariant"),
}
WORDS = [(place, "", word) for place, words in PLACES.items() for word in words] + [
    ("", measure, word) for measure, words in MEASURES.items() for word in words
]


def cases(word: str) -> set[str]:
    return {word, word.upper(), word.capitalize(), word.title()}


@pytest.mark.parametrize(("place", "measure", "word"), WORDS)
def test_each_word_alone(place: str, measure: str, word: str) -> None:
    for text in cases(word):
        found = kind_words(text)
        assert found is not None, text
        assert (found.place, found.measure) == (place, measure), text


def test_places_and_measures_together_in_either_order_and_form() -> None:
    tried = 0
    for place, measure in itertools.product(PLACES, MEASURES):
        for one, other in itertools.product(PLACES[place], MEASURES[measure]):
            texts = [f"{one} {other}", f"{other} {one}", f"({one}, {other})", f"{one}-{other}"]
            for text in [*texts, *(text.upper() for text in texts)]:
                found = kind_words(text)
                assert found is not None, text
                assert (found.place, found.measure) == (place, measure), text
                tried += 1
    assert tried > 4000


def test_the_pattern_for_editors_permits_every_word_and_refuses_others() -> None:
    pattern = re.compile(words_pattern())
    for (_, _, one), (_, _, other) in itertools.product(WORDS, repeat=2):
        for text in (f"{one} {other}", f"{one}, ({other})", f"{one.upper()}_{other.title()}"):
            assert pattern.search(text), text
    for text in ("root", "", "5", "line-to-lime", "rms furlong"):
        assert not pattern.search(text), text


UNITS = {
    "mOhm": "mOhm",
    "mΩ": "mΩ",
    "uH": "uH",
    "V/krpm": "V/krpm",
    "V s/rad": "V s/rad",
    "V/(rad/s)": "V/(rad/s)",
    "N m/A": "N m/A",
    "A": "A",
    "V per 1000 rpm": "V per 1000 rpm",
    "min^-1/V": "min^-1/V",
}
BEHIND = ("{unit} {word}", "{unit} ({word})", "{unit}, {word}", "{unit} [{word}]", "{unit}_{word}")


@pytest.mark.parametrize("unit", UNITS)
def test_words_behind_a_unit(unit: str) -> None:
    for _, _, word in WORDS:
        for form, text in itertools.product(BEHIND, cases(word)):
            assert without_kind(form.format(unit=unit, word=text)) == (unit, text)


@pytest.mark.parametrize(
    ("written", "unit", "words"),
    [
        ("Arms", "A", "rms"),
        ("ARMS", "A", "RMS"),
        ("mA_pk", "mA", "pk"),
        ("Ap", "A", "p"),
        ("Aeff", "A", "eff"),
        ("A-rms", "A", "rms"),
        ("Nm/Arms", "Nm/A", "rms"),
        ("N m/A (rms)", "N m/A", "rms"),
        ("Vrms/krpm", "V/krpm", "rms"),
        ("VRMS/KRPM", "V/KRPM", "RMS"),
        ("V rms/krpm", "V/krpm", "rms"),
        ("V(rms)/krpm", "V/krpm", "rms"),
        ("Vpk/krpm", "V/krpm", "pk"),
        ("V_LL,rms/krpm", "V/krpm", "LL,rms"),
        ("VLLrms/krpm", "V/krpm", "LLrms"),
        ("mV_ph/rpm", "mV/rpm", "ph"),
        ("Vrms/krpm line-to-line", "V/krpm", "rms line-to-line"),
        ("rpm/Vrms", "rpm/V", "rms"),
        ("mV peak phase/rpm", "mV/rpm", "peak phase"),
    ],
)
def test_words_within_a_unit(written: str, unit: str, words: str) -> None:
    assert without_kind(written) == (unit, words)


def test_no_unit_is_taken_for_a_word() -> None:
    units = [*SYMBOLS, *COMPOUNDS, *(f"{one}/{other}" for one in SYMBOLS for other in SYMBOLS)]
    for unit in [*units, "V s", "N m s", "V/1000 rpm", "% per K", "kg m^2", "min-1", "A s/V"]:
        assert without_kind(unit) == (unit, "")


@pytest.mark.parametrize(
    ("text", "phrase"),
    [
        ("peak-to-peak", "twice the peak"),
        ("pp", "twice the peak"),
        ("pk-pk", "twice the peak"),
        ("line to line p-p", "twice the peak"),
        ("max", "write peak or rms"),
        ("dc", "write peak or rms"),
        ("average", "write peak or rms"),
        ("phase line-to-line", "two kinds, phase and line-to-line"),
        ("rms peak", "two kinds, rms and peak"),
    ],
)
def test_what_leaves_the_kind_open(text: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        kind_words(text)
    assert phrase in caught.value.message


@pytest.mark.parametrize("text", ["", "furlong", "rms furlong", "line-to-lime", "5"])
def test_other_texts_are_no_kind(text: str) -> None:
    assert kind_words(text) is None


def test_a_quantity_says_its_kind() -> None:
    reading = read_quantity("12.5 Vrms/krpm (L-L)", "back-emf", kinds=True)
    assert reading.text == "12.5 V/krpm"
    assert reading.kind is not None
    assert (reading.kind.place, reading.kind.measure) == ("line-to-line", "rms")
    assert kind_said("100 mOhm phase-to-phase") == "phase-to-phase"
    assert kind_said("190KV line-to-line rms") == "line-to-line rms"
    # What is no quantity keeps its words: titles of drives.
    assert kind_said("3 phase motor") == kind_said("3 phase") == kind_said("rms") == ""
    assert kind_said("100 mOhm") == ""


@pytest.mark.parametrize(
    "text",
    ["p " * 29, "l" + " " * 57 + "x", "ph-" * 19, "per " * 15, "line to " * 7, "p" * 58, "a " * 29],
)
def test_hostile_texts_come_to_an_end(text: str) -> None:
    # A text that can be cut in many ways would take years with a grammar that tries them all.
    assert without_kind(text + "q")[0].endswith("q")
