"""Estimates judged, averaged and compared, each number by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from dqforge.optimizer.identification.parameters import (
    compared,
    judged,
    mean_of_routes,
    named_ratio,
    suspected,
    unknown,
    with_partners,
    with_prior,
)

NAMED = ("flux", "flux linkage", "Wb")


@pytest.mark.parametrize(
    ("value", "sigma", "status"),
    [
        (2.0, 0.1, "identified"),
        (2.0, 0.6, "not identified"),
        (2.0, 1.2, "not identified"),
        (-2.0, 0.1, "not identified"),
        (math.nan, 0.1, "not identified"),
    ],
)
def test_an_interval_is_that_of_student(value: float, sigma: float, status: str) -> None:
    found = judged(NAMED, value, sigma, 12.0, runs=("a",))
    half = stats.t.ppf(0.975, 12.0) * sigma
    assert found.status == status
    assert (found.value, found.sigma) == pytest.approx((value, sigma), nan_ok=True)
    assert found.runs == ("a",)
    np.testing.assert_allclose([found.low, found.high], [value - half, value + half])
    if value > 0.0:
        assert (found.why == "the 95 % interval holds 0") == (half > value)
        wide = found.why == "the 95 % interval is wider than half of the value"
        assert wide == (0.5 * value < half <= value)
    assert judged(NAMED, 1e-3, 0.1, 12.0, may_vanish=True).status == "identified"
    assert judged(NAMED, -2.0, 0.1, 12.0, physical=False).status == "identified"
    # Less than one degree of freedom counts as one.
    assert judged(NAMED, 2.0, 0.01, 0.2).high == pytest.approx(2.0 + 0.01 * stats.t.ppf(0.975, 1.0))


@pytest.mark.parametrize("apart", [0.5, 4.0])
def test_routes_are_averaged_by_inverse_variance_and_widened_by_their_scatter(
    apart: float,
) -> None:
    values, sigmas = np.array([2.0, 2.0 + 0.1 * apart, 2.05]), np.array([0.1, 0.05, 0.2])
    freedoms = (4.0, 9.0, 30.0)
    routes = [
        judged(NAMED, *given, runs=(name, "shared"))
        for *given, name in zip(values, sigmas, freedoms, "abc", strict=True)
    ]
    mean, scale = mean_of_routes(routes)
    weights = 1.0 / sigmas**2 / sum(1.0 / sigmas**2)
    value = float(np.average(values, weights=1.0 / sigmas**2))
    assert mean.value == pytest.approx(value)
    wanted = max(1.0, math.sqrt(np.sum(((values - value) / sigmas) ** 2) / 2.0))
    assert scale == pytest.approx(wanted)
    assert (wanted > 1.0) == (apart > 1.0)
    assert mean.sigma == pytest.approx(wanted / math.sqrt(np.sum(1.0 / sigmas**2)))
    halves = np.array([stats.t.ppf(0.975, one) for one in freedoms]) * sigmas
    half = wanted * math.sqrt(np.sum((weights * halves) ** 2))
    assert (mean.low, mean.high) == pytest.approx((value - half, value + half))
    assert mean.runs == ("a", "shared", "b", "c")


@pytest.mark.parametrize("half", [0.02, 0.4])
def test_what_is_known_counts_by_its_interval(half: float) -> None:
    found = judged(NAMED, 2.0, 0.05, 1e9, runs=("a",))
    mean, scale = with_prior(found, 2.05, half, "the data sheet")
    sigma = half / stats.norm.ppf(0.975)
    weight = 1.0 / sigma**2 / (1.0 / sigma**2 + 400.0)
    assert mean.value == pytest.approx(2.0 + 0.05 * weight)
    assert mean.status == ("prior-dominated" if weight > 0.5 else "identified")
    assert mean.why == f"{100.0 * weight:.2g} % of the weight is that of the data sheet"
    assert scale == pytest.approx(max(1.0, 0.05 / math.hypot(sigma, 0.05)))
    alone, one = with_prior(unknown(NAMED, "nothing was driven"), 2.05, half, "the data sheet")
    assert (alone.value, alone.low, alone.high) == (2.05, 2.05 - half, 2.05 + half)
    assert (alone.status, one) == ("prior-dominated", 1.0)
    assert alone.sigma == pytest.approx(sigma)
    assert "from the data sheet with its interval: nothing was driven" in alone.why


def test_partners_are_those_whose_correlation_is_large() -> None:
    sigma, correlation = np.array([0.1, 2.0, 30.0]), np.eye(3)
    correlation[0, 1] = correlation[1, 0] = -0.71
    correlation[0, 2] = correlation[2, 0] = 0.69
    parameters = [replace(judged(NAMED, 1.0, 0.1, 9.0), key=key) for key in "abc"]
    first, second, third = with_partners(parameters, correlation * np.outer(sigma, sigma))
    for one, other in ((first, "b"), (second, "a")):
        ((key, value),) = one.partners
        assert key == other
        assert value == pytest.approx(-0.71)
    assert third.partners == ()


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (2.0, "line-to-line taken for phase"),
        (1.0 / 1.5, "3/2"),
        (1.7321, "sqrt(3)"),
        (0.7071, "sqrt(2)"),
        (1.2247, "sqrt(3/2)"),
        (1.97, "line-to-line"),
        (1.95, ""),
        (2.03, "line-to-line"),
        (2.05, ""),
    ],
)
def test_a_ratio_has_the_name_of_its_convention(ratio: float, words: str) -> None:
    found = named_ratio(ratio)
    assert words in found
    assert bool(words) == bool(found)


def test_two_routes_are_compared_with_share_and_interval() -> None:
    found = judged(NAMED, 2.0, 0.01, 9.0)
    text, against = compared(found, 1.9, "the sheet")
    assert not against
    assert "5.3 % above 1.9 Wb from the sheet, which lies outside the interval" in text
    text, against = compared(found, 2.01, "the sheet")
    assert not against
    assert "0.5 % below 2.01 Wb from the sheet, which lies within the interval" in text
    text, against = compared(found, 1.7, "the sheet")
    assert against
    assert "differ by a factor of 1.18: 2 Wb from the runs, 1.7 Wb from the sheet" in text
    assert compared(found, 1.75, "the sheet")[1] is False
    assert "near sqrt(3)" in compared(found, 2.0 * math.sqrt(3.0), "the sheet")[0]
    assert compared(judged(NAMED, 2.0, 0.3, 9.0), 1.7, "the sheet")[1] is False
    for value, other in ((math.nan, 1.0), (-1.0, 1.0), (1.0, 0.0)):
        assert compared(replace(found, value=value), other, "the sheet") == ("", False)


def test_the_column_that_is_off_is_named_by_what_it_does() -> None:
    for resistance, flux, words in (
        (1.5, 1.5, "columns u_d and u_q"),
        (1.5, 1.4, "columns u_d and u_q"),
        (2.0, 1.4, "more than one column"),
        (2.0, 1.1, "columns i_d and i_q"),
        (0.8, 1.1, "columns i_d and i_q"),
        (1.1, 0.8, "column speed"),
    ):
        assert suspected({"resistance": resistance, "magnet_flux": flux}).startswith(words)
    assert suspected({"resistance": 2.0}) == "columns of currents, voltages or speed"
