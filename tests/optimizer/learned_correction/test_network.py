"""The network: its tangent, its slopes, and the same bytes every time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from learned_drives import learned_observer

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.learned_correction import corrected_flux
from dqforge.optimizer.learned_correction.corrected_flux import (
    STEPS,
    TANH_ERROR,
    Network,
    answered,
    hyperbolic_tangent,
    residuals,
    trained_network,
)
from dqforge.optimizer.learned_correction.correction_frame import TOLD
from dqforge.optimizer.steps.step_arithmetic import EXACT, cast


def test_the_tangent_is_bounded_and_as_near_as_stated() -> None:
    x = np.concatenate([np.linspace(-12.0, 12.0, 400_001), [-3e38, 3e38]]).astype(np.float32)
    found = hyperbolic_tangent(SINGLE, x)
    assert found.dtype == np.float32
    assert np.max(np.abs(found)) <= 1.0
    assert np.max(np.abs(found - np.tanh(x.astype(np.float64)))) < TANH_ERROR
    assert np.all(np.diff(hyperbolic_tangent(EXACT, x[:-2].astype(np.float64))) >= 0.0)


@pytest.mark.parametrize("hidden", [(1, 1), (4, 3), (16, 16)])
def test_the_slopes_are_those_of_differences(hidden: tuple[int, int]) -> None:
    generator = np.random.default_rng(2)
    x, wanted = generator.uniform(-1.0, 1.0, (TOLD, 200)), generator.uniform(-0.9, 0.9, 200)
    first, second = hidden
    flat = 0.7 * generator.standard_normal((TOLD + 1) * first + (first + 1) * second + second + 1)
    _, slopes = residuals(flat, x, wanted, hidden)
    for _ in range(5):
        way = generator.standard_normal(flat.size)
        near = [residuals(flat + way * step, x, wanted, hidden)[0] for step in (1e-6, -1e-6)]
        change = (near[0] - near[1]) / 2e-6
        np.testing.assert_allclose(way @ slopes, change, rtol=1e-5, atol=1e-8)


def toy_answers() -> tuple[FloatArray, FloatArray]:
    """Inputs, and what a network is to answer to them."""
    x = np.random.default_rng(9).uniform(-1.0, 1.0, (6, 600))
    return x, 0.5 * x[0] * x[3] - 0.2 * np.abs(x[1])


@cache
def toy_network() -> Network:
    """A network that has learned them."""
    return trained_network(*toy_answers(), (5, 4), 1.0)


def test_training_repeats_to_the_bit_and_learns() -> None:
    x, wanted = toy_answers()
    first = toy_network()
    assert first == trained_network(x, wanted, (5, 4), 1.0)
    assert first.size == 5 * 5 + 5 + 5 * 4 + 4 + 4 + 1
    assert all(np.float32(value) == value for value in first.weights_1)
    left = answered(EXACT, first, 1.0, tuple(x)) - wanted
    assert np.std(left) < 0.1 * np.std(wanted)


def test_training_begins_with_weights_of_about_one_over_the_root_of_what_comes_in(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun: list[tuple[FloatArray, tuple[int, ...], FloatArray, object, int]] = []

    def stand_in(
        flat: FloatArray, seen: FloatArray, shares: FloatArray, hidden: object, steps: int
    ) -> FloatArray:
        begun.append((flat, seen.shape, shares, hidden, steps))
        return flat

    monkeypatch.setattr(corrected_flux, "_descended", stand_in)
    x, wanted = toy_answers()
    found = trained_network(x, wanted, (90, 40), 0.5)
    flat = begun[0][0]
    at = 0
    for rows, columns in ((90, TOLD), (40, 90), (1, 40)):
        weights, offsets = flat[at : at + rows * columns], flat[at + rows * columns :][:rows]
        assert np.std(weights) == pytest.approx(columns**-0.5, rel=0.25)
        assert np.max(np.abs(weights)) < 4.5 * columns**-0.5
        np.testing.assert_array_equal(offsets, 0.0)
        at += rows * columns + rows
    assert at == flat.size == found.size
    for (every, steps), (_, shape, shares, hidden, taken) in zip(STEPS, begun, strict=True):
        assert shape == (TOLD, -(-x.shape[1] // every))
        np.testing.assert_array_equal(shares, wanted[::every] / 0.5)
        assert (hidden, taken) == ((90, 40), steps)


@pytest.mark.parametrize("trained", ["toy", pytest.param("neural", marks=pytest.mark.slow)])
def test_the_limit_bounds_whatever_the_weights(trained: str) -> None:
    network = toy_network() if trained == "toy" else learned_observer("neural").gains.network
    x = np.random.default_rng(1).uniform(-50.0, 50.0, (6, 200_000)).astype(np.float32)
    for factor in (1.0, 1e3):
        weights = tuple(factor * value for value in network.weights_3)
        loud = cast(replace(network, weights_3=weights), SINGLE)
        found = np.abs(answered(SINGLE, loud, np.float32(0.35), tuple(x)))
        assert np.max(found) <= np.float32(0.35)
    assert np.max(found) > 0.99999 * 0.35


def test_layers_that_do_not_fit_are_refused() -> None:
    network = toy_network()
    with pytest.raises(ValueError, match="do not fit"):
        replace(network, weights_2=network.weights_2[:-1])
