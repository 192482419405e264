"""Data-sheet conventions against hand-computed numbers, and the checks between constants."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import FluxStatement
from dqforge.machines.dq_machines.synchronous import LinearMachine, largest_torque
from dqforge.machines.errors import InputError

# One machine in all conventions: p = 3, psi = 0.06 Wb. Phase back-EMF 3 * 0.06 = 0.18 V s/rad peak,
# times sqrt(3) between terminals, divided by sqrt(2) for r.m.s.; torque 1.5 * 3 * 0.06 = 0.27 N m
# per ampere peak.
BACK_EMF = [
    (0.18, "phase peak"),
    (0.1272792206135786, "phase rms"),
    (0.3117691453623979, "line-to-line peak"),
    (0.22045407685048602, "line-to-line rms"),
]


@pytest.mark.parametrize(("constant", "kind"), BACK_EMF)
def test_flux_from_back_emf(constant: float, kind: str) -> None:
    assert datasheet.flux_from_back_emf(constant, kind, 3) == pytest.approx(0.06, rel=1e-14)


@pytest.mark.parametrize(("constant", "kind"), [(0.27, "peak"), (0.3818376618407357, "rms")])
def test_flux_from_torque_constant(constant: float, kind: str) -> None:
    assert datasheet.flux_from_torque_constant(constant, kind, 3) == pytest.approx(0.06, rel=1e-14)


@pytest.mark.parametrize(
    ("value", "kind"),
    [(0.06, "peak"), (0.04242640687119285, "rms"), (0.07348469228349534, "power-invariant")],
)
def test_flux_to_peak(value: float, kind: str) -> None:
    # r.m.s. is 0.06/sqrt(2); power-invariant 0.06 sqrt(3/2).
    assert datasheet.peak_flux(value, kind) == pytest.approx(0.06, rel=1e-14)


def test_torque_constant_and_back_emf_agree_with_energy() -> None:
    # Phase r.m.s. quantities: 3 E I = T omega, so K_t (per A r.m.s.) is 3 K_e (phase r.m.s.)
    # whatever p and psi are.
    k_e = 0.1272792206135786
    psi = datasheet.flux_from_torque_constant(3.0 * k_e, "rms", 3)
    assert psi == pytest.approx(datasheet.flux_from_back_emf(k_e, "phase rms", 3), rel=1e-14)


def test_star_connection_halves_terminal_values() -> None:
    assert datasheet.phase_resistance(4.7, "line-to-line") == 2.35
    assert datasheet.phase_resistance(2.35, "phase") == 2.35
    assert datasheet.phase_inductance(3.22e-3, "line-to-line") == 1.61e-3
    assert datasheet.phase_inductance(1.61e-3, "phase") == 1.61e-3


def test_peak_current() -> None:
    assert datasheet.peak_current(1.6, "rms") == pytest.approx(2.262741699796952, rel=1e-14)
    assert datasheet.peak_current(283.0, "peak") == 283.0


def _contradiction(first: float, other: float, *, counts: bool = True, pole_pairs: int = 3) -> str:
    statements = [
        FluxStatement("magnet_flux", "A", first, counts_poles=False),
        FluxStatement("back_emf_constant", "B", other, counts_poles=counts),
    ]
    with pytest.raises(InputError) as caught:
        datasheet.check_flux_agreement(statements, pole_pairs)
    return caught.value.message


def test_agreement_within_five_percent() -> None:
    statements = [
        FluxStatement("magnet_flux", "", 0.060, counts_poles=False),
        FluxStatement("torque_constant", "", 0.0629, counts_poles=True),
    ]
    datasheet.check_flux_agreement(statements, 3)
    datasheet.check_flux_agreement([], 3)
    assert "contradict" in _contradiction(0.060, 0.0641)


@pytest.mark.parametrize(
    ("factor", "phrase"),
    [
        (math.sqrt(2.0), "r.m.s. value given as peak"),
        (1.0 / math.sqrt(2.0), "r.m.s. value given as peak"),
        (math.sqrt(3.0), "line-to-line value given as phase"),
        (math.sqrt(6.0), "line-to-line r.m.s. value given as phase peak"),
        (math.sqrt(1.5), "power-invariant flux given as peak"),
        (1.5, "without the 3/2"),
        (2.0 * math.pi, "per revolution given per radian"),
        (30.0 / math.pi, "per rpm or krpm given per rad/s"),
        (1000.0, "milli omitted"),
        (1.13, "check both keys, their units and their kinds"),
        (7.0, "electrical speed given per mechanical speed"),
    ],
)
def test_likely_causes(factor: float, phrase: str) -> None:
    message = _contradiction(0.06 * factor, 0.06, pole_pairs=7)
    assert phrase in message
    assert "magnet_flux A implies" in message
    assert "back_emf_constant B implies psi_pm = 0.06 Wb" in message


def test_poles_are_blamed_only_where_they_enter() -> None:
    assert "write poles: 8" in _contradiction(0.06, 0.03, pole_pairs=8)
    assert "write pole_pairs: 8" in _contradiction(0.03, 0.06, pole_pairs=4)
    assert "poles" not in _contradiction(0.06, 0.03, counts=False, pole_pairs=8)


def test_magnets_against_no_magnets() -> None:
    assert "a machine without magnets has neither constant" in _contradiction(0.0, 0.06)


def test_pole_counts() -> None:
    assert datasheet.check_pole_counts(4, None) == 4
    assert datasheet.check_pole_counts(None, 8) == 4
    assert datasheet.check_pole_counts(4, 8) == 4
    for pairs, poles, phrase in (
        (None, None, "write poles: 8"),
        (None, 7, "write pole_pairs: 7"),
        (3, 7, "write poles: 6"),
        (8, 8, "poles 8 means 4 pole pairs, but pole_pairs is 8"),
    ):
        with pytest.raises(InputError, match=phrase.replace("(", r"\(")):
            datasheet.check_pole_counts(pairs, poles)


def test_rated_frequency() -> None:
    # 75 Hz and 1500 rpm belong to 3 pole pairs: p = 60 f/n.
    speed = 1500.0 * math.pi / 30.0
    datasheet.check_rated_frequency(3, 75.0, speed)
    datasheet.check_rated_frequency(3, 73.0, speed)
    for pole_pairs, frequency, phrase in (
        (6, 75.0, "write poles: 6"),
        (2, 75.0, "write pole_pairs: 3"),
        (3, 62.0, "has slip"),
        (3, 0.1, "has slip"),
    ):
        with pytest.raises(InputError, match=phrase):
            datasheet.check_rated_frequency(pole_pairs, frequency, speed)


def test_rated_power() -> None:
    # 14 N m at 1500 rpm are 2199 W.
    datasheet.check_rated_power(2200.0, 14.0, 1500.0 * math.pi / 30.0)
    with pytest.raises(InputError, match=r"is 2\.1991 kW; correct one of the three"):
        datasheet.check_rated_power(3000.0, 14.0, 1500.0 * math.pi / 30.0)


@pytest.mark.parametrize(
    ("pole_pairs", "psi_pm", "l_d", "l_q", "i_max"),
    [
        (4, 0.1049, 350e-6, 592e-6, 283.0),
        (2, 0.0, 6.2e-3, 41.5e-3, 22.0),
        (3, 0.06, 1.74e-3, 1.61e-3, 6.4),
        (3, 0.06, 1.6e-3, 1.6e-3, 6.4),
    ],
)
def test_largest_torque_is_the_maximum_over_the_current_angle(
    pole_pairs: int, psi_pm: float, l_d: float, l_q: float, i_max: float
) -> None:
    machine = LinearMachine(pole_pairs, 1.0, l_d, l_q, psi_pm, i_max)
    angle = np.linspace(0.0, np.pi, 200_001)
    torque = machine.torque(i_max * np.cos(angle), i_max * np.sin(angle))
    largest = largest_torque(pole_pairs, psi_pm, l_q - l_d, i_max)
    assert largest == pytest.approx(float(torque.max()), rel=1e-8)


def test_largest_torque_without_magnets_and_saliency_is_zero() -> None:
    assert largest_torque(3, 0.0, 0.0, 6.4) == 0.0


def test_rated_torque() -> None:
    datasheet.check_rated_torque(1.09, 1.0)
    with pytest.raises(InputError, match="check the kind of max_current"):
        datasheet.check_rated_torque(1.11, 1.0)


def test_back_emf_warning() -> None:
    # Paper 000 at 9000 rpm: sqrt(3) * 4 * 942.48 * 0.1049 = 685 V peak between terminals.
    text = datasheet.back_emf_warning(4, 0.1049, 300.0 * math.pi, 500.0)
    assert "9000 rpm" in text
    assert "684.96 V" in text
    assert datasheet.back_emf_warning(4, 0.1049, 300.0 * math.pi, 700.0) == ""


@pytest.mark.parametrize(
    ("other", "agrees"), [(0.951, True), (0.949, False), (1.052, True), (1.054, False)]
)
def test_five_percent_are_five_percent_of_the_larger(other: float, agrees: bool) -> None:
    statements = [
        FluxStatement("a", "1", 1.0, counts_poles=False),
        FluxStatement("b", "2", other, counts_poles=False),
    ]
    if agrees:
        datasheet.check_flux_agreement(statements, 3)
    else:
        with pytest.raises(InputError, match="contradict"):
            datasheet.check_flux_agreement(statements, 3)
