"""Which kind an entry has: words of its text and its key ``kind``, together or alone."""

from __future__ import annotations

from typing import get_args

import pytest

from dqforge.machines.entries import kinds
from dqforge.machines.entries.rules import EntryError, QuantityRule


def rule(entry: object) -> QuantityRule:
    found = next(part for part in get_args(entry) if isinstance(part, QuantityRule))
    assert isinstance(found, QuantityRule)
    return found


RESISTANCE = rule(kinds.Resistance)
EMF = rule(kinds.BackEmfConstant)
FLUX = rule(kinds.Flux)
CURRENT = rule(kinds.MachineCurrent)
INVERTER_CURRENT = rule(kinds.PhaseCurrent)


@pytest.mark.parametrize(
    ("own", "value", "kind"),
    [
        (RESISTANCE, "0.1 Ohm terminal", "line-to-line"),
        (RESISTANCE, "0.1 Ohm per winding", "phase"),
        (RESISTANCE, "0.1 Ohm line-to-neutral", "phase"),
        (RESISTANCE, {"value": "0.1 Ohm", "kind": "Phase to Phase"}, "line-to-line"),
        (RESISTANCE, {"value": 0.1, "kind": "l-l"}, "line-to-line"),
        (RESISTANCE, {"value": "0.1 Ohm l-l", "kind": "terminal"}, "line-to-line"),
        (EMF, "12 V/krpm line rms", "line-to-line rms"),
        (EMF, "12 Vpk/krpm terminal to terminal", "line-to-line peak"),
        (EMF, "12 V/krpm winding rms", "phase rms"),
        (EMF, {"value": "12 Vrms/krpm", "kind": "line-to-line"}, "line-to-line rms"),
        (EMF, {"value": "12 V/krpm l-l", "kind": "peak"}, "line-to-line peak"),
        (EMF, {"value": 0.1, "kind": "rms phase"}, "phase rms"),
        (FLUX, "5 mWb phase peak", "peak"),
        (FLUX, "5 mWb power invariant", "power-invariant"),
        (CURRENT, "20 Arms", "rms"),
        (CURRENT, "20 A phase rms", "rms"),
        (CURRENT, "20 A line rms", "line rms"),
        (CURRENT, "20 A rms terminal", "line rms"),
        (CURRENT, "20 Apk winding", "winding peak"),
        (INVERTER_CURRENT, "20 A line rms", "rms"),
        (INVERTER_CURRENT, "20 A phase amplitude", "peak"),
    ],
)
def test_what_is_meant(own: QuantityRule, value: object, kind: str) -> None:
    found = own.read(value)
    assert found.kind == kind
    assert found.kind_given


@pytest.mark.parametrize(
    ("own", "value", "key", "phrase"),
    [
        (
            RESISTANCE,
            {"value": "0.1 Ohm line-to-line", "kind": "phase"},
            "kind",
            "the text states 'line-to-line', its kind is 'phase'; remove the wrong one",
        ),
        (EMF, {"value": "12 Vpk/krpm", "kind": "line-to-line rms"}, "kind", "remove the wrong one"),
        (EMF, "12 Vrms/krpm", "value", "leaves open phase rms or line-to-line rms; write one"),
        (EMF, {"value": 1, "kind": "phase"}, "kind", "leaves open phase peak or phase rms"),
        (CURRENT, "20 A line", "value", "leaves open line peak or line rms"),
        (RESISTANCE, "0.1 Ohm line", "value", "one of phase, line-to-line, got the text 'line'"),
        (RESISTANCE, "0.1 Ohm rms", "value", "expected one of phase, line-to-line"),
        (FLUX, "5 mWb line-to-line peak", "value", "expected one of peak, rms, power-invariant"),
        (INVERTER_CURRENT, "20 A winding rms", "value", "expected one of peak, rms"),
        (CURRENT, "20 A line-to-line rms", "value", "expected one of peak, rms, line peak"),
        (CURRENT, "20 A max", "value", "write peak or rms"),
        (CURRENT, "20 App", "value", "write half of the value"),
        (CURRENT, {"value": "20 A", "kind": "pp"}, "kind", "write half of the value"),
        (RESISTANCE, {"value": 1, "kind": "termnal"}, "kind", "did you mean 'terminal'?"),
        (RESISTANCE, {"value": 1, "kind": "lime-to-line"}, "kind", "did you mean 'line-to-line'?"),
        (RESISTANCE, {"value": 1, "kind": 5}, "kind", "expected one of phase, line-to-line, got 5"),
        (
            EMF,
            "12 V/krpm",
            None,
            "(data sheets differ); write '12 V/krpm phase peak', or phase rms",
        ),
        (EMF, 0.1, None, "write '0.1 V s/rad phase peak', or phase rms, line-to-line peak"),
    ],
)
def test_what_is_refused(own: QuantityRule, value: object, key: str | None, phrase: str) -> None:
    with pytest.raises(EntryError) as caught:
        own.read(value)
    assert phrase in caught.value.message
    assert caught.value.key == key
    assert "\n" not in caught.value.message


def test_what_is_not_said_is_the_custom() -> None:
    for own, value, kind in (
        (RESISTANCE, "0.1 Ohm", "phase"),
        (CURRENT, "20 A", "peak"),
        # The current of a phase may be that of the line or of the winding: it says no more.
        (CURRENT, "20 A phase", "peak"),
        (rule(kinds.SpeedConstant), 60, "line-to-line peak"),
    ):
        found = own.read(value)
        assert (found.kind, found.kind_given) == (kind, False)
