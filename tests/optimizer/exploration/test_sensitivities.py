"""Sensitivities by bins and by Saltelli's design, against formulas and scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc
from scipy.stats import sobol_indices as by_scipy

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.exploration.acceptance import SaltelliSums, sobol_indices
from dqforge.optimizer.exploration.row_block import saltelli_inputs, saltelli_places
from dqforge.optimizer.exploration.sensitivities import (
    BINS,
    BinnedOutput,
    Sensitivities,
    binned_output,
    sensitivities,
)

# Of Ishigami's function with a = 7, b = 0.1 (Saltelli and others 2008, section 4.6).
FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)


def ishigami(x: FloatArray) -> FloatArray:
    """Of inputs (n, 3), uniform from -pi to pi."""
    one, two, three = x.T
    return np.asarray(np.sin(one) + 7.0 * np.sin(two) ** 2 + 0.1 * three**4 * np.sin(one))


def by_bins(inputs: FloatArray, output: FloatArray, part: int) -> Sensitivities:
    found = binned_output(inputs[:part], output[:part])
    for start in range(0, len(inputs), part):
        found = found.plus(inputs[start : start + part], output[start : start + part])
    return sensitivities("y", ("a", "b", "c"), found)


def test_bins_find_what_ishigami_depends_on() -> None:
    inputs = np.random.default_rng(2).uniform(-np.pi, np.pi, (100_000, 3))
    found = by_bins(inputs, ishigami(inputs), 1000)
    assert found.rows == 100_000
    assert found.first == pytest.approx(FIRST, abs=0.01)
    correlations = np.asarray(np.corrcoef(np.column_stack([ishigami(inputs), inputs]).T))[0, 1:]
    assert found.squared_correlation == pytest.approx(correlations**2, abs=1e-12)
    # A straight line sees nothing of the second input, on which most depends.
    assert found.squared_correlation[1] < 0.001


def test_what_has_no_influence_has_none_on_average() -> None:
    random = np.random.default_rng(4)
    first = []
    for _ in range(300):
        inputs = random.random((1000, 3))
        first.append(by_bins(inputs, random.standard_normal(1000), 500).first)
    assert np.mean(first) == pytest.approx(0.0, abs=1e-3)
    assert by_bins(inputs, random.standard_normal(1000), 500).bias == pytest.approx(49 / 999)


def test_all_that_one_input_says_is_a_sensitivity_of_one() -> None:
    inputs = np.random.default_rng(4).standard_normal((50_000, 3))
    found = by_bins(inputs, 5.0 + 1e-6 * inputs[:, 1], 1000)
    # Half a percent lies within the outermost of fifty bins of a normal distribution.
    assert found.first == pytest.approx([0.0, 1.0, 0.0], abs=0.008)
    assert found.squared_correlation[1] == pytest.approx(1.0, abs=1e-9)


def test_rows_without_numbers_count_nowhere_and_a_constant_depends_on_nothing() -> None:
    inputs = np.random.default_rng(4).standard_normal((4000, 3))
    output = inputs[:, 0].copy()
    bad = output.copy()
    bad[::7] = np.nan
    found = by_bins(inputs, bad, 1000)
    assert found.rows == 4000 - len(range(0, 4000, 7))
    assert found.first[0] > 0.99
    flat = by_bins(inputs, np.full(4000, 3.7), 1000)
    assert np.all(np.isnan(flat.first))
    assert np.all(np.isnan(flat.squared_correlation))


@pytest.mark.parametrize("rows", [0, 1, 3, 10, 60, 220])
def test_few_rows_have_fewer_bins_and_no_trouble(rows: int) -> None:
    inputs = np.random.default_rng(rows).standard_normal((rows, 3))
    with np.errstate(all="raise"):
        bins = binned_output(inputs, inputs[:, 0]).plus(inputs, inputs[:, 0])
        found = sensitivities("y", ("a", "b", "c"), bins)
    assert bins.counts.shape[1] <= min(BINS, max(rows // 4, 1))
    assert found.first.shape == (3,)
    if rows >= 60:
        assert found.first[0] > 0.9


def saltelli(base: int) -> tuple[FloatArray, np.ndarray]:
    sample = qmc.Sobol(6, rng=np.random.default_rng(1)).random(base)
    places, which = saltelli_places(0, 5 * base, 3)
    return -np.pi + 2.0 * np.pi * saltelli_inputs(sample[places], which), which


def test_saltellis_design_gives_first_order_and_total_sensitivities() -> None:
    inputs, _ = saltelli(4096)
    found = sobol_indices(ishigami(inputs), 3)
    assert found.base == 4096
    assert found.first == pytest.approx(FIRST, abs=0.02)
    assert found.total == pytest.approx(TOTAL, abs=0.02)


def test_the_estimators_are_those_of_scipy() -> None:
    inputs, which = saltelli(512)
    output = ishigami(inputs)
    tables = {
        "f_A": output[which == 0][np.newaxis],
        "f_B": output[which == 1][np.newaxis],
        "f_AB": np.array([output[which == 2 + place][np.newaxis] for place in range(3)]),
    }
    expected, found = by_scipy(func=tables, n=512), sobol_indices(output, 3)
    assert found.first == pytest.approx(np.ravel(expected.first_order), rel=1e-9, abs=1e-12)
    assert found.total == pytest.approx(np.ravel(expected.total_order), rel=1e-9, abs=1e-12)


def test_parts_of_any_length_make_the_same_sums() -> None:
    inputs, _ = saltelli(256)
    output = ishigami(inputs)
    whole, sums = sobol_indices(output, 3), SaltelliSums(3)
    for start in range(0, output.size, 137):  # which ends inside a base row
        sums = sums.plus(output[start : start + 137])
    found = sums.indices()
    assert found.base == whole.base == 256
    assert found.first == pytest.approx(whole.first, rel=1e-9)
    assert found.total == pytest.approx(whole.total, rel=1e-9)


def test_a_base_row_that_lacks_a_value_is_left_out() -> None:
    inputs, _ = saltelli(256)
    output = ishigami(inputs)
    output[7] = np.nan
    output[1200] = np.inf
    kept = np.delete(output.reshape(-1, 5), [1, 240], axis=0).ravel()
    found, expected = sobol_indices(output, 3), sobol_indices(kept, 3)
    assert found.base == expected.base == 254
    assert found.first == pytest.approx(expected.first, rel=1e-12)
    assert np.all(np.isnan(sobol_indices(np.ones(50), 3).first))


def test_rows_of_the_design_are_the_same_from_any_batch() -> None:
    places, which = saltelli_places(0, 60, 4)
    some, some_which = saltelli_places(17, 31, 4)
    assert np.array_equal(places[17:31], some)
    assert np.array_equal(which[17:31], some_which)
    sample = np.random.default_rng(0).random((10, 8))
    rows = saltelli_inputs(sample[places], which).reshape(10, 6, 4)
    assert np.array_equal(rows[:, 0], sample[:, :4])
    assert np.array_equal(rows[:, 1], sample[:, 4:])
    for place in range(4):
        mixed = sample[:, :4].copy()
        mixed[:, place] = sample[:, 4 + place]
        assert np.array_equal(rows[:, 2 + place], mixed)


@pytest.mark.parametrize("centre", [1e3, -1e3])
@pytest.mark.parametrize(("share", "flat"), [(0.9, True), (1.1, False)])
def test_an_output_that_changes_by_its_rounding_alone_depends_on_nothing(
    centre: float, share: float, *, flat: bool
) -> None:
    """Below a variance of 1e-28 of the square of its size, by bins and by the design."""
    variance, rows = share * 1e-28 * centre**2, 100
    size = np.sqrt(variance)
    binned = BinnedOutput(
        edges=np.zeros((1, 1)),
        centre=np.array([centre, 0.0]),
        counts=np.array([[50.0, 50.0]]),
        sums=np.array([[-50.0 * size, 50.0 * size]]),
        moments=np.array([[rows * variance, 0.0], [0.0, rows], [0.0, 0.0]]),
    )
    assert np.isnan(sensitivities("y", ("x",), binned).first[0]) == flat
    one = np.ones(1)
    sums = SaltelliSums(1, centre, 10, (0.0, 20.0 * variance), one, variance * one, variance * one)
    assert np.isnan(sums.indices().first[0]) == flat
