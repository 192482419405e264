"""The table of the back-EMF: sizes and errors against waveforms in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.phase_control.design import (
    LARGEST_ERROR,
    RIPPLE,
    SHAPE_ERROR,
    SIZES,
    fit_shape,
    resampled,
    shape_error,
)
from dqforge.optimizer.phase_control.phase_controller import PhaseShape, _remainder

SHARES = ((1, 1.0), (3, 0.12), (5, 0.03), (7, 0.01))


def wave(theta: np.ndarray) -> np.ndarray:
    return np.asarray(-0.2233 * sum(share * np.sin(order * theta) for order, share in SHARES))


def harmonic(angles: int = 360) -> PhaseMachine:
    theta = 2.0 * np.pi * np.arange(angles) / angles
    flux = np.stack([wave(theta - 2.0 * np.pi * k / 3.0) for k in range(3)])
    return PhaseMachine(2, 1.0, 7e-3, -1e-3, flux, 6.0)


def trapezoid(angles: int = 360) -> PhaseMachine:
    """Flat for 120 degrees, corners at multiples of 30 degrees."""
    theta = 2.0 * np.pi * np.arange(angles) / angles
    sine = np.sin(theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis])
    flux = -0.2 * np.clip(np.arcsin(np.clip(sine, -1.0, 1.0)) * 6.0 / np.pi, -1.0, 1.0)
    return PhaseMachine(2, 1.0, 7e-3, -1e-3, flux, 6.0)


@pytest.mark.parametrize(("nodes", "percent"), [(48, 0.28), (96, 0.07), (192, 0.02)])
def test_errors_are_those_of_tables_in_the_loop(nodes: int, percent: float) -> None:
    shape = PhaseShape(resampled(harmonic().flux[:1], nodes))
    error, _ = shape_error(harmonic(), shape, zero=True)
    assert 100.0 * error == pytest.approx(percent, rel=0.12)
    # The same from the formula of the waveform, at angles of the test's own.
    theta = np.linspace(0.0, 2.0 * np.pi, 50_001)[:-1]
    turns = [theta - 2.0 * np.pi * k / 3.0 for k in range(3)]
    exact = np.stack([wave(turn) for turn in turns])
    grid = 2.0 * np.pi * np.arange(nodes + 1) / nodes
    table = np.stack([np.interp(np.mod(turn, 2.0 * np.pi), grid, wave(grid)) for turn in turns])
    torque = np.sum(exact * table, axis=0) / np.sum(table**2, axis=0)
    assert error == pytest.approx(np.ptp(torque), rel=1e-2)


@pytest.mark.parametrize("seed", range(6))
def test_the_smallest_size_that_holds_is_taken(seed: int) -> None:
    """Random harmonics: the error of what is taken, by the formula of the waveform, is within the
    table's part of the ripple, and no smaller size has that.
    """
    generator = np.random.default_rng(seed)
    orders = np.array([1, 3, 5, 7, 11])
    shares = np.array([1.0, *(generator.uniform(-0.15, 0.15, 4) / (orders[1:] / 3.0))])

    def random_wave(theta: np.ndarray) -> np.ndarray:
        return np.asarray(-0.2 * np.sum(shares * np.sin(orders * theta[..., None]), axis=-1))

    theta = 2.0 * np.pi * np.arange(720) / 720
    flux = np.stack([random_wave(theta - 2.0 * np.pi * k / 3.0) for k in range(3)])
    found = fit_shape(PhaseMachine(2, 1.0, 7e-3, -1e-3, flux, 6.0), zero=True)
    size = found.shape.flux.shape[1]

    def spread(nodes: int) -> float:
        fine = np.linspace(0.0, 2.0 * np.pi, 30_001)[:-1]
        turns = [fine - 2.0 * np.pi * k / 3.0 for k in range(3)]
        grid = 2.0 * np.pi * np.arange(nodes + 1) / nodes
        exact = np.stack([random_wave(turn) for turn in turns])
        table = np.stack(
            [np.interp(np.mod(turn, 2.0 * np.pi), grid, random_wave(grid)) for turn in turns]
        )
        return float(np.ptp(np.sum(exact * table, axis=0) / np.sum(table**2, axis=0)))

    assert spread(size) <= 1.01 * SHAPE_ERROR < RIPPLE
    assert all(spread(less) > 0.99 * SHAPE_ERROR for less in SIZES if less < size)


def test_where_no_size_reaches_it_the_smallest_permitted_is_taken() -> None:
    """A corner that lies on no node errs with the first power of the distance of nodes."""
    theta = 2.0 * np.pi * (np.arange(5760) + 0.31) / 5760
    sine = np.sin(theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis])
    flat = np.clip(np.arcsin(np.clip(sine, -1.0, 1.0)) * 7.3 / np.pi, -1.0, 1.0)
    found = fit_shape(PhaseMachine(2, 1.0, 7e-3, -1e-3, -0.2 * flat, 6.0), zero=True)
    assert SHAPE_ERROR < found.error <= LARGEST_ERROR


def test_corners_lie_on_nodes_and_cost_nothing() -> None:
    found = fit_shape(trapezoid(), zero=True)
    assert found.shape.flux.shape == (1, 24)
    assert found.error < 1e-12
    # Off the corners the table is far worse, although it is larger.
    assert (
        shape_error(trapezoid(), PhaseShape(resampled(trapezoid().flux[:1], 128)), zero=True)[0]
        > 5e-3
    )


def test_phases_that_differ_have_three_rows() -> None:
    machine = harmonic()
    flux = machine.flux * np.array([[1.0], [0.5], [1.0]])
    found = fit_shape(replace(machine, flux=flux), zero=True)
    assert found.shape.flux.shape[0] == 3
    assert found.error <= SHAPE_ERROR


def test_data_with_noise_are_taken_as_they_are() -> None:
    """The angles of the data themselves are the largest table that says anything."""
    noise = np.random.default_rng(7).normal(0.0, 2e-3, (3, 360))
    machine = replace(harmonic(), flux=harmonic().flux + noise)
    found = fit_shape(machine, zero=True)
    assert found.shape.flux.shape == (3, 360)
    assert np.array_equal(found.shape.flux, machine.flux)


@pytest.mark.parametrize("divisor", [3, 60, 144, 512, 65521])
def test_remainders_are_those_of_the_library_bit_for_bit(divisor: int) -> None:
    draw = np.random.default_rng(divisor)
    whole = np.arange(-2000, 2000) * float(divisor)
    beside = [np.nextafter(whole, side) for side in (-np.inf, np.inf)]
    small = draw.normal(size=1000) * 10.0 ** draw.integers(-320, 1, size=1000)
    value = np.concatenate([whole, *beside, small, -small, [0.0, -0.0]])
    found, expected = _remainder(value, divisor), np.mod(value, divisor)
    np.testing.assert_array_equal(found.view(np.int64), expected.view(np.int64))
