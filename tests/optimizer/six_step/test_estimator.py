"""The estimator on waveforms made here: instants of commutation, offset, noise, no number."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.six_step.sector_step import (
    BlockGains,
    BlockState,
    at_rest,
    block_start,
    block_step,
    six_step_seen,
)
from dqforge.optimizer.six_step.sectors import middle
from dqforge.optimizer.steps.step_arithmetic import EXACT, Abc, Arithmetic, cast

PSI, T_S = 0.1, 2e-5
GAINS = BlockGains(
    t_s=T_S,
    by_integral=0,
    delay=(0.5, 0.5),
    threshold=(PSI * (1.0 - math.cos(math.pi / 6.0)),) * 2,
    latency=0.5,
    blank_share=0.2,
    blank_least=1.5,
    smooth=1.0,
    patience=3.0,
    crossings=tuple(middle(sector, 1) for sector in range(6)),
)


def started(
    o: Arithmetic, gains: BlockGains, direction: int, omega: float, beyond: float
) -> BlockState:
    state, speed, angle = at_rest(), o.number(omega), o.number(beyond)
    block_start(o, gains, state, 0, direction, speed, angle)  # type: ignore[arg-type]
    return state


def late(
    gains: BlockGains,
    omega: float,
    direction: int = 1,
    offset: float = 0.0,
    noise: float = 0.0,
    turns: int = 12,
) -> FloatArray:
    """By how much each commutation is late, in rad; the first two turns do not count."""
    generator = np.random.default_rng(5)
    theta, found = middle(0, direction) - direction * 0.3, []
    state = started(EXACT, gains, direction, omega, -0.3)
    for k in range(round(turns * 2.0 * math.pi / (omega * T_S))):
        seen = theta + direction * 0.5 * omega * T_S  # sampled in the middle of the period
        sector = state.sector
        e = [-PSI * direction * omega * math.sin(seen - 2.0 * math.pi / 3.0 * n) for n in range(3)]
        u = np.array(e) + noise * generator.standard_normal(3) * math.sqrt(1.5)
        u += np.array([offset, -0.5 * offset, -0.5 * offset])
        block_step(EXACT, gains, state, Abc(*u))
        theta += direction * omega * T_S
        if state.sector != sector and k > 4.0 * math.pi / (omega * T_S):
            ideal = middle(state.sector, direction) - direction * math.pi / 6.0
            found.append(direction * math.remainder(theta - ideal, 2.0 * math.pi))
    assert state.lost == 0
    return np.array(found)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("by_integral", [0, 1])
def test_commutations_fall_on_their_periods(by_integral: int, direction: int) -> None:
    for omega in (200.0, 1000.0):
        error = late(replace(GAINS, by_integral=by_integral), omega, direction)
        assert error.size > 50
        assert np.max(np.abs(error)) <= 0.5 * omega * T_S * 1.05 + 1e-6


def test_an_offset_shifts_integral_and_crossing_as_the_formulas_say() -> None:
    omega = 200.0
    offset = 0.05 * PSI * omega
    integral = late(replace(GAINS, by_integral=1), omega, offset=offset)
    crossing = late(GAINS, omega, offset=offset)
    # Phase a sees it whole, the others half of it, rising and falling crossings the other way.
    assert np.max(np.abs(integral)) == pytest.approx(math.pi / 3.0 * 0.05, rel=0.06)
    # The crossing by 0.05, half of the mean interval behind it by three eighths of that.
    assert np.max(np.abs(crossing)) == pytest.approx(1.375 * 0.05, rel=0.06)
    assert abs(np.mean(integral)) < 0.003
    assert abs(np.mean(crossing)) < 0.003


def test_noise_moves_commutations_as_the_formula_says() -> None:
    gains = replace(GAINS, by_integral=1)
    omega, sigma = 200.0, 0.4
    moved = late(gains, omega, noise=sigma, turns=40)
    expected = sigma * math.sqrt(math.pi / 6.0 * T_S / omega) / (0.5 * PSI)
    grid = omega * T_S / math.sqrt(12.0)
    assert np.std(moved) == pytest.approx(math.hypot(expected, grid), rel=0.35)


def test_what_is_no_number_changes_nothing_but_the_time() -> None:
    gains, none = cast(GAINS, SINGLE), Abc(*np.full(3, np.nan, dtype=np.float32))
    state = started(SINGLE, gains, 1, 200.0, -0.5)
    for _ in range(300):
        block_step(SINGLE, gains, state, none)
    assert state.sector == 0
    assert np.isfinite([state.theta_e, state.omega_e, state.last, state.area, state.mean]).all()
    for _ in range(700):
        block_step(SINGLE, gains, state, none)
    assert state.lost == 1


def test_a_filter_is_late_by_what_is_taken_off() -> None:
    share = 0.1
    gains = replace(GAINS, smooth=share, latency=0.5 + (1.0 - share) / share)
    error = late(gains, 300.0)
    assert abs(np.mean(error)) < 0.002
    without = late(replace(gains, latency=0.5), 300.0)
    assert np.mean(without) == pytest.approx(9.0 * 300.0 * T_S, rel=0.1)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_rotor_that_turns_is_seen_at_rest(direction: int) -> None:
    for theta in np.linspace(0.0, 2.0 * np.pi, 50):
        v = [-direction * math.sin(theta - 2.0 * math.pi / 3.0 * n) for n in range(3)]
        sector, beyond, largest = six_step_seen(EXACT, Abc(*np.array(v)), direction)
        true = direction * math.remainder(theta - middle(sector, direction), 2.0 * math.pi)
        assert abs(true) <= math.pi / 6.0 + 1e-9
        assert beyond == pytest.approx(true, abs=0.055)
        assert largest >= 1.5 - 1e-9
