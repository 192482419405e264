"""Captures over mechanical turns: what the pole pairs differ by, and what only looks like it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import BemfCapture
from dqforge.machines.back_emf.harmonics import PolePairs
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, grid
from dqforge.reports.session.losses import read_back_emf

MACHINE = PhaseMachine.from_harmonics(
    [1.0, 3.0, 0.8, 1.2],
    [0.01, 1e-3, 4e-4, 2e-4],
    [0.0, 0.3, 0.4, -0.7],
    pole_pairs=5,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=10.0,
)


def emf(theta: FloatArray, machine: PhaseMachine = MACHINE) -> FloatArray:
    """e / omega_e at any electrical angles, shape (3, N), from the spectrum of the machine."""
    lines = np.fft.rfft(machine.flux) * (2.0 / machine.angles)
    used = np.flatnonzero(np.max(np.abs(lines), axis=0) > 1e-9)
    turn = np.exp(1j * np.multiply.outer(used / machine.turns, theta))
    return np.asarray((lines[:, used] @ turn).real)


def capture(
    periods: float, *, backwards: bool = False, ripple: float = 0.0, machine: PhaseMachine = MACHINE
) -> BemfCapture:
    """So many electrical periods at 50 Hz with 0.5 % of noise, from 40 degrees on; the speed
    may ripple once per mechanical turn.
    """
    sign, omega = (-1.0 if backwards else 1.0), 2.0 * np.pi * 50.0
    time = np.arange(int(200 * periods)) / 10_000.0
    theta = 0.7 + omega * time
    speed = omega * (1.0 + ripple * np.cos(theta / 5.0))
    theta = theta + 5.0 * ripple * np.sin(theta / 5.0)
    volts = sign * speed * emf(sign * theta, machine)
    noise = 0.005 * 0.01 * omega * np.random.default_rng(3).standard_normal(volts.shape)
    return BemfCapture("scope.csv", time, None, volts + noise, np.arange(2, time.size + 2))


def pairs_of(given: BemfCapture, pole_pairs: int = 5) -> PolePairs:
    found = analyse(given, pole_pairs=pole_pairs, harmonics=5).pole_pairs
    assert found is not None
    return found


@pytest.mark.parametrize("backwards", [False, True])
def test_harmonics_over_the_turn_are_found_within_their_uncertainty(backwards: bool) -> None:
    """From three and a half turns; the first pole pair is that in which the record begins."""
    found = pairs_of(capture(17.5, backwards=backwards))
    assert found.differ
    assert found.revolutions == pytest.approx(3.5, abs=0.01)
    np.testing.assert_allclose(found.orders, np.arange(1, 26) / 5.0)
    phasors = found.amplitudes * np.exp(-1j * found.phases)
    lines = np.fft.rfft(MACHINE.flux)[:, 1:26] * (2.0 / MACHINE.angles) / 1j
    # Backwards the record begins just below the end of a turn: in the last pole pair.
    ahead = 4.0 if backwards else 0.0
    wanted = lines * np.exp(2j * np.pi * ahead * found.orders)
    assert np.max(np.abs(phasors - wanted) / found.amplitude_uncertainty) < 2.0
    assert np.mean(np.abs(phasors - wanted) < found.amplitude_uncertainty) > 0.9
    assert "The pole pairs differ" in found.finding
    assert "rise and fall together" not in found.finding


def test_fundamentals_within_the_pole_pairs_are_those_of_the_waveform() -> None:
    found = pairs_of(capture(17.5))
    theta = 2.0 * np.pi * np.arange(360) / 360.0
    exact = [
        [2.0 * abs(np.mean(row * np.exp(-1j * theta))) for row in flux.reshape(5, 360)]
        for flux in MACHINE.flux
    ]
    np.testing.assert_allclose(found.fundamentals, exact, rtol=3e-3)
    means = np.mean(exact, axis=1, keepdims=True)
    assert abs(found.spread - np.max(np.abs(exact - means) / means)) < found.doubt


@pytest.mark.parametrize(
    ("spread", "common", "differ", "words"),
    [
        (0.0099, 0.9, True, ""),
        (0.0101, 0.74, True, "by up to 1.0% (+- 0.4%)"),
        (0.052, 0.76, True, "rise and fall together (76% of it)"),
        (0.052, 0.76, False, ""),
    ],
)
def test_differences_are_told_from_one_percent_on(
    spread: float, common: float, differ: bool, words: str
) -> None:
    found = replace(pairs_of(capture(17.5)), spread=spread, doubt=0.004, common=common)
    told = replace(found, differ=differ).finding
    assert words in told
    assert bool(told) == bool(words)
    assert ("rise and fall together" in told) == (bool(words) and common > 0.75)


def test_equal_pole_pairs_do_not_differ() -> None:
    equal = PhaseMachine.from_harmonics(
        [1, 3], [0.01, 1e-3], [0.0, 0.3], pole_pairs=5, r_s=1.0, l_s=7e-3, m_s=0.0, i_max=1.0
    )
    found = pairs_of(capture(17.5, machine=equal))
    assert not found.differ
    assert found.finding == ""
    assert found.spread < found.doubt


def test_a_speed_that_ripples_with_the_turn_raises_all_phases_together() -> None:
    equal = PhaseMachine.from_harmonics(
        [1, 3], [0.01, 1e-3], [0.0, 0.3], pole_pairs=5, r_s=1.0, l_s=7e-3, m_s=0.0, i_max=1.0
    )
    found = pairs_of(capture(30.0, ripple=0.02, machine=equal))
    assert found.differ
    assert found.common > 0.95
    assert "All three phases rise and fall together" in found.finding
    assert pairs_of(capture(30.0)).common < 0.5


def test_less_than_a_mechanical_turn_tells_nothing_of_it() -> None:
    assert analyse(capture(4.5), pole_pairs=5).pole_pairs is None
    assert analyse(capture(17.5)).pole_pairs is None
    assert analyse(capture(17.5), pole_pairs=1).pole_pairs is None


@pytest.mark.parametrize(("wraps", "covers"), [(False, True), (True, False)])
def test_a_recorded_angle_must_count_the_pole_pairs(wraps: bool, covers: bool) -> None:
    """The zero of the recorded angle is that of the first pole pair."""
    theta = grid(1500, 5)
    given = np.asarray(np.mod(theta, 2.0 * np.pi)) if wraps else theta
    lines = np.arange(2, theta.size + 2)
    found = analyse(BemfCapture("f.csv", None, given, emf(theta), lines), pole_pairs=5, harmonics=5)
    assert (found.pole_pairs is not None) == covers
    if found.pole_pairs is not None:
        np.testing.assert_allclose(found.pole_pairs.waveform, MACHINE.flux, atol=1e-12)


def test_of_a_measured_motor_all_phases_rise_and_fall_together(shared_data: Path) -> None:
    """V-Dyno at 250 rpm, two and a half turns of seven pole pairs: orders 6/7 and 8/7 of 1.4 and 2
    % of the fundamental, 95 % of it common to the phases, as the speed of a drill ripples.
    """
    name = shared_data / "bemf" / "vdyno_trampa6340_0250rpm1_dec10.csv"
    found = read_back_emf(name, pole_pairs=7, scale=(1.0, 1.0, 10.0)).result.pole_pairs
    assert found is not None
    assert found.revolutions == pytest.approx(2.5, abs=0.05)
    assert found.differ
    assert found.common > 0.9
    shares = found.amplitudes / found.amplitudes[:, 6:7]
    assert np.all((shares[:, 5] > 0.012) & (shares[:, 7] > 0.018))
