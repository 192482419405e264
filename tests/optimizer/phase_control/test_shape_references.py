"""Currents that make a torque of a shape, by the energy that the shape turns into it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.optimizer.phase_control.phase_records import Alphabetazero
from dqforge.optimizer.phase_control.shape_references import reference_at
from dqforge.optimizer.steps.step_arithmetic import EXACT, Rotation

MACHINE: Any = SimpleNamespace(pole_pairs=4.0, psi_pm=0.1)
THETA = np.linspace(0.0, 2.0 * np.pi, 25)
TURN = Rotation(np.cos(THETA), np.sin(THETA))
# Back-EMF over the electrical speed: 0.1 V s of a sine, a fifth harmonic, and a zero sequence.
SHAPE = Alphabetazero(
    -0.1 * np.sin(THETA) + 0.01 * np.sin(5.0 * THETA),
    0.1 * np.cos(THETA) + 0.01 * np.cos(5.0 * THETA),
    0.02 * np.sin(3.0 * THETA),
)


def currents(torque: float, d: float, fade: float, zero: float) -> Alphabetazero:
    rows = (np.full_like(THETA, value) for value in (torque, d, fade, zero))
    with np.errstate(divide="ignore"):
        found: Alphabetazero = reference_at(EXACT, MACHINE, SHAPE, TURN, *rows)
    return found


@pytest.mark.parametrize("zero", [0.0, 0.5, 1.0])
def test_the_torque_is_the_power_of_the_back_emf_over_the_speed(zero: float) -> None:
    """p (3/2 (f_a i_a + f_b i_b) + 3 f_0 i_0), at every angle."""
    i = currents(5.0, 0.0, 1.0, zero)
    plane = SHAPE.alpha * i.alpha + SHAPE.beta * i.beta
    assert 4.0 * (1.5 * plane + 3.0 * SHAPE.zero * i.zero) == pytest.approx(5.0, rel=1e-12)
    assert np.any(i.zero != 0.0) == (zero > 0.0)


def test_a_shape_that_has_faded_leaves_the_currents_of_its_fundamental() -> None:
    """T/(3/2 p psi) in quadrature, whatever the harmonics."""
    i = currents(6.0, 0.0, 0.0, 0.0)
    assert i.alpha == pytest.approx(-10.0 * np.sin(THETA), abs=1e-9)
    assert i.beta == pytest.approx(10.0 * np.cos(THETA), abs=1e-9)


def test_a_current_of_the_d_axis_is_added_along_it() -> None:
    without, along = currents(5.0, 0.0, 1.0, 0.5), currents(5.0, -3.0, 1.0, 0.5)
    assert along.alpha - without.alpha == pytest.approx(-3.0 * np.cos(THETA), abs=1e-9)
    assert along.beta - without.beta == pytest.approx(-3.0 * np.sin(THETA), abs=1e-9)
    assert np.array_equal(along.zero, without.zero)
