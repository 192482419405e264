"""Keys that only some topologies have, refused elsewhere with their place and what to write."""

from __future__ import annotations

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError

TEXT = catalogue.read_text("paper002-phase-waveforms").decode()
TOPOLOGY = "  topology: four-leg\n"


def load(inverter: str, rest: str = "") -> Design:
    """The design with other lines in the place of its topology, and sections behind it."""
    assert TOPOLOGY in TEXT
    return load_text((TEXT.replace(TOPOLOGY, inverter) + rest).encode(), "d.yaml")


CASES = [
    (
        "  topology: six-leg\n  neutral_inductance: 1 mH\n",
        "",
        (
            "neutral_inductance: six-leg has no neutral on a fourth leg; remove the key, or "
            "write topology: four-leg"
        ),
        "neutral_inductance",
    ),
    (
        "  topology: split-capacitor\n  neutral_inductance: 1 mH\n",
        "",
        "neutral_inductance: split-capacitor has no neutral on a fourth leg",
        "neutral_inductance",
    ),
    (
        "  topology: four-leg\n  midpoint_capacitance: 4.7 mF\n",
        "",
        (
            "midpoint_capacitance: four-leg has no link in two halves; remove the key, or write "
            "topology: split-capacitor"
        ),
        "midpoint_capacitance",
    ),
    (
        "  topology: split-capacitor\n",
        "  control: float32\n",
        (
            "split-capacitor needs midpoint_capacitance for export.control; write "
            "midpoint_capacitance: 4.7 mF"
        ),
        "split-capacitor",
    ),
    (
        "  topology: split-capacitor\n",
        "simulation: {duration: 10 ms}\n",
        "split-capacitor needs midpoint_capacitance for simulation",
        "split-capacitor",
    ),
    (
        "  topology: six-leg-isolated\n",
        "operation: {strategy: mtpa, speed: 900 rpm, modulation: dpwm1}\n",
        "operation.modulation: six-leg-isolated has its own modulator",
        "dpwm1",
    ),
    (
        "  topology: split-capacitor\n  midpoint_capacitance: 4700\n",
        "",
        (
            "4700 F is outside 10 nF to 10 F: a bare number is in F, did you forget the unit? "
            "write e.g. '4700 uF'"
        ),
        "4700",
    ),
    (
        "  topology: split-capacitor\n  midpoint_capacitance: 4.7 mH\n",
        "",
        "expected a capacitance such as '4.7 mF', got '4.7 mH' which is an inductance",
        "4.7 mH",
    ),
]


@pytest.mark.parametrize(("inverter", "rest", "told", "place"), CASES)
def test_what_a_topology_has_not_is_refused_at_its_place(
    inverter: str, rest: str, told: str, place: str
) -> None:
    text = TEXT if "operation" not in rest else TEXT.replace("operation:\n  strategy: mtpa\n", "")
    text = text.replace(TOPOLOGY, inverter) + rest
    with pytest.raises(InputError) as caught:
        load_text(text.encode(), "d.yaml")
    assert told in caught.value.message
    before = text[: text.index(place, TEXT.index(TOPOLOGY))]
    where = before.count("\n") + 1, len(before) - before.rfind("\n")
    assert (caught.value.line, caught.value.column) == where


def test_what_a_topology_has_is_kept() -> None:
    choke = load("  topology: four-leg\n  neutral_inductance: 1.5 mH\n").inverter
    assert choke.neutral_inductance == 1.5e-3
    split = load(
        "  topology: split-capacitor\n  midpoint_capacitance: 4700 uF\n", "  control: float32\n"
    )
    assert split.inverter.midpoint_capacitance == pytest.approx(4.7e-3, rel=1e-15)
    assert load("  topology: split-capacitor\n").inverter.midpoint_capacitance is None


def test_the_centred_modulator_is_no_contradiction() -> None:
    text = TEXT.replace("operation:\n", "operation:\n  speed: 900 rpm\n  modulation: svpwm\n", 1)
    assert load_text(text.encode(), "d.yaml").inverter.topology == "four-leg"
    star = text.replace("svpwm", "dpwm1").replace("four-leg", "three-wire", 1)
    assert load_text(star.encode(), "d.yaml").operation.modulation == "dpwm1"


def test_there_is_no_modulator_to_choose() -> None:
    text = TEXT + "modulation_choice: {min_frequency: 8 kHz, max_frequency: 16 kHz}\n"
    with pytest.raises(InputError, match="four-leg has its own modulator, so there is"):
        load_text(text.encode(), "d.yaml")
