"""Crossings, thresholds and torque of blocks against sums of harmonics worked out here."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from dqforge.machines.design import catalogue
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.six_step.design import backwards
from dqforge.optimizer.six_step.sectors import block_shape, dq_inductances, phases_of

ORDERS = (1.0, 3.0, 5.0, 7.0)


def machine(shares: tuple[float, ...], lags: tuple[float, ...] = (0.0,) * 4) -> PhaseMachine:
    return PhaseMachine.from_harmonics(
        ORDERS, shares, lags, pole_pairs=2, r_s=1.0, l_s=5e-3, m_s=0.0, i_max=5.0
    )


def seen(theta: float, phase: int, shares: tuple[float, ...], lags: tuple[float, ...]) -> float:
    """Back-EMF over the speed without the harmonics that all phases share."""
    angle = theta - 2.0 * math.pi / 3.0 * phase
    return -sum(
        share * math.sin(order * angle - lag)
        for order, share, lag in zip(ORDERS, shares, lags, strict=True)
        if order % 3.0
    )


def test_a_sine_has_the_figures_of_the_textbook() -> None:
    shape = block_shape(machine((0.1, 0.0, 0.0, 0.0)))
    assert shape.crossings == pytest.approx(np.radians([-120, -60, 0, 60, 120, 180]), abs=1e-9)
    assert math.degrees(shape.delay) == pytest.approx(30.0, abs=1e-9)
    assert shape.threshold == pytest.approx(0.1 * (1.0 - math.cos(math.pi / 6.0)), rel=1e-6)
    assert shape.slope == pytest.approx(0.1, rel=1e-6)
    assert shape.level == pytest.approx(0.05, rel=1e-9)
    assert shape.torque == pytest.approx(2 * 0.1 * 3.0 * math.sqrt(3.0) / math.pi, rel=1e-4)


@pytest.mark.parametrize("lags", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.5, 0.3, -0.2)])
def test_other_waveforms_have_their_own(lags: tuple[float, ...]) -> None:
    shares = (0.1, 0.02, 0.008, 0.003)
    shape = block_shape(machine(shares, lags))

    def floating(theta: float) -> float:
        return seen(theta, 0, shares, lags)

    start = brentq(floating, -0.5, 0.5)
    # b is fed and c returns: a takes over where it equals the one that stops
    end = brentq(
        lambda x: floating(x) - seen(x, 2, shares, lags), math.pi / 6 - 0.4, math.pi / 6 + 0.4
    )
    assert shape.crossings[2] == pytest.approx(start, abs=1e-6)
    assert shape.delay == pytest.approx(end - start, abs=1e-6)
    area = quad(lambda x: -floating(x), start, end)[0]
    assert shape.threshold == pytest.approx(area, rel=3e-6)
    assert shape.spread < 1e-6


def test_backwards_is_the_mirrored_machine() -> None:
    lags = (0.0, 0.5, 0.3, -0.2)
    forwards = block_shape(machine((0.1, 0.02, 0.008, 0.003), lags))
    other = block_shape(backwards(machine((0.1, 0.02, 0.008, 0.003), lags)))
    assert forwards.delay + other.delay == pytest.approx(math.pi / 3.0, abs=1e-6)
    assert other.spread < 1e-6


def test_dq_parameters_become_phases() -> None:
    design = catalogue.load("paper001-pmsm-bench")
    made = phases_of(design.machine, None)
    assert dq_inductances(made) == pytest.approx((1.61e-3, 1.74e-3))
    assert made.psi_pm == pytest.approx(0.06)


def test_what_is_no_waveform_for_blocks_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="crosses zero once more is no waveform for blocks"):
        block_shape(machine((0.1, 0.0, 0.0, 0.9)))
    with pytest.raises(NoSolutionError, match="constant inductances"):
        phases_of(catalogue.load("abb-syrm-6k7-saturated").machine, None)
