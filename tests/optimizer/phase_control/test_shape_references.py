"""Currents that make a torque of a shape, by the energy that the shape turns into it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.optimizer.phase_control.phase_records import Alphabetazero, Shape
from dqforge.optimizer.phase_control.shape_references import (
    ShapeSteps,
    WaveformSteps,
    balanced,
    linkage,
    reference_at,
    turning_reference,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, Dq, Rotation

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


PHASE = 2.0 * np.pi * np.arange(3) / 3.0


def in_phases(x: Alphabetazero) -> Any:
    """Phase quantities, shape (3, N), of which a lies along alpha."""
    return np.cos(PHASE)[:, None] * x.alpha + np.sin(PHASE)[:, None] * x.beta + x.zero


@pytest.mark.parametrize("opened", [0, 1, 2, 3])
def test_what_balances_the_midpoint_makes_no_torque(opened: int) -> None:
    """Less the mean of the balance in every phase, or in the two that are left: nothing of it flows
    in an open phase, and of what it would make of torque as much again is taken along the shape."""
    i = Alphabetazero(*np.random.default_rng(2).normal(size=(3, THETA.size)))
    shape, balance = SHAPE, 0.7
    if opened:  # what the other phases see of the shape
        kept = in_phases(SHAPE)
        kept[opened - 1] = 0.0
        shape = Alphabetazero(
            (2.0 * kept[0] - kept[1] - kept[2]) / 3.0,
            (kept[1] - kept[2]) / np.sqrt(3.0),
            np.mean(kept, axis=0),
        )
    full = np.full(THETA.size, balance)
    found = balanced(EXACT, i, shape, full, np.full(THETA.size, opened))
    added = in_phases(found) - in_phases(i)
    f = in_phases(shape)
    asked = np.full((3, THETA.size), -balance)
    if opened:
        asked = -1.5 * balance * np.ones((3, THETA.size))
        asked[opened - 1] = 0.0
    part = np.sum(f * asked, axis=0) / np.sum(f * f, axis=0)
    np.testing.assert_allclose(added, asked - part * f, atol=1e-7)
    np.testing.assert_allclose(np.sum(f * added, axis=0), 0.0, atol=1e-8)
    if opened:
        np.testing.assert_allclose(added[opened - 1], 0.0, atol=1e-7)


def test_linkage_is_that_of_both_axes() -> None:
    i = Alphabetazero(*np.random.default_rng(3).normal(size=(3, THETA.size)))
    gains: Any = SimpleNamespace(l_d=3e-3, l_q=8e-3)
    found = linkage(EXACT, gains, i, TURN)
    along = np.exp(1j * THETA)
    current = (i.alpha + 1j * i.beta) / along
    expected = (3e-3 * current.real + 8e-3j * current.imag) * along
    np.testing.assert_allclose(found.alpha + 1j * found.beta, expected, atol=1e-15)


def test_constant_currents_turn_with_the_rotor() -> None:
    found = turning_reference(EXACT, Dq(np.full(25, -2.0), np.full(25, 5.0)), TURN)
    expected = (-2.0 + 5.0j) * np.exp(1j * THETA)
    np.testing.assert_allclose(found.alpha + 1j * found.beta, expected, atol=1e-14)
    assert not np.any(found.zero)


def test_currents_of_the_header_take_a_d_current_and_a_share_of_their_zero_sequence() -> None:
    def phases(torque: Any, sine: Any, cosine: Any) -> tuple[Any, ...]:
        return tuple(torque * (cosine + 2.0 * n * sine + 0.3 * n) for n in range(3))

    full = np.full(25, 4.0)
    found = WaveformSteps(phases).waveform_reference(EXACT, TURN, full, -0.375 * full, 0.15 * full)
    made = np.array(phases(full, TURN.sine, TURN.cosine))
    mean = np.mean(made, axis=0)
    expected = made - mean + 0.6 * mean - 1.5 * np.cos(THETA - PHASE[:, None])
    np.testing.assert_allclose(in_phases(found), expected, atol=1e-6)


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("opened", [None, 1, 2, 3])
def test_a_table_is_read_by_straight_lines_at_any_place(rows: int, opened: int | None) -> None:
    """Whole turns make no difference; b and c lag by a third and two thirds where there is one row;
    an open phase counts as none; beyond 65536 lengths and at not-a-number the first entry."""
    nodes, generator = 12, np.random.default_rng(5)
    flux = generator.normal(size=(rows, nodes))
    table = Shape(tuple(np.column_stack([flux, flux[:, 0]])))
    inside = np.concatenate([generator.uniform(-3.0, 3.0, 60), np.arange(-4, 5) / 12.0])
    place = np.concatenate([inside, [65536.0, -65536.0, np.nan, np.inf]])
    asked = np.concatenate([inside, np.zeros(4)])
    reads = ShapeSteps(nodes, rows, nodes / (2.0 * np.pi))
    phase = None if opened is None else np.full(place.size, opened)
    with np.errstate(invalid="ignore"):
        found = in_phases(reads.shape_at(EXACT, table, place, phase))
        slope = in_phases(reads.slope_at(EXACT, table, place, phase))
    for n in range(3):
        row, lag = (flux[n], 0.0) if rows == 3 else (flux[0], n / 3.0)
        turned = np.mod(asked - lag + 1e-12, 1.0) * nodes
        k = np.floor(turned).astype(int)
        here, there = row[k], row[(k + 1) % nodes]
        none = opened == n + 1
        value = here + (turned - k) * (there - here)
        np.testing.assert_allclose(found[n], 0.0 if none else value, atol=1e-6)
        rate = (there - here) * nodes / (2.0 * np.pi)
        np.testing.assert_allclose(slope[n], 0.0 if none else rate, atol=1e-6)
