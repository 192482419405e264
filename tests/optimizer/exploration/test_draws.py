"""Draws: the same row wherever a batch begins, whatever else is drawn, and the right shape."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.exploration.study import Draw, Sampling, Tolerance
from dqforge.optimizer.exploration.row_block import draw_shares, draw_values, values_at

KEYS = ["inverter.v_dc", "machine.inductance_d", "machine.inductance_q", "machine.resistance"]
PAIRS = (("machine.inductance_d", "machine.inductance_q", 0.7),)


@pytest.mark.parametrize("sampling", ["random", "sobol"])
@pytest.mark.parametrize("correlations", [(), PAIRS])
def test_any_batch_starts_anywhere(
    sampling: Sampling, correlations: tuple[tuple[str, str, float], ...]
) -> None:
    draw = Draw(1000, 20261122, sampling, correlations)
    whole = draw_shares(draw, KEYS, 0, 1000)
    for first, end in [(0, 1), (1, 2), (3, 11), (250, 500), (997, 1000), (5, 5), (0, 1000)]:
        part = draw_shares(draw, KEYS, first, end)
        for key in KEYS:
            np.testing.assert_array_equal(part[key], whole[key][first:end])


def test_a_longer_study_keeps_its_rows_and_another_key_leaves_the_others_alone() -> None:
    one = draw_shares(Draw(10, 7), KEYS[:2], 0, 10)
    other = draw_shares(Draw(10_000, 7), [*KEYS, "fit.torque_max"], 0, 10_000)
    for key in KEYS[:2]:
        np.testing.assert_array_equal(one[key], other[key][:10])
    # Correlating two keys leaves all others and the first of the two.
    tied = draw_shares(Draw(10_000, 7, correlations=PAIRS), KEYS, 0, 10_000)
    for key in ("inverter.v_dc", "machine.resistance", "machine.inductance_d"):
        np.testing.assert_array_equal(tied[key], other[key])
    assert not np.array_equal(tied["machine.inductance_q"], other["machine.inductance_q"])


def test_far_rows_cost_no_walk() -> None:
    near = draw_shares(Draw(10**8, 3), KEYS[:1], 99_999_990, 10**8)
    assert near[KEYS[0]].shape == (10,)
    assert len(set(near[KEYS[0]])) == 10


def test_seeds_and_keys_draw_apart() -> None:
    one = draw_shares(Draw(4000, 1), KEYS, 0, 4000)
    two = draw_shares(Draw(4000, 2), KEYS, 0, 4000)
    large = draw_shares(Draw(4000, 2**63 - 1), KEYS, 0, 4000)
    columns = np.array([drawn[key] for drawn in (one, two, large) for key in KEYS])
    apart = np.corrcoef(columns) - np.eye(len(columns))
    assert np.max(np.abs(apart)) < 5.0 / np.sqrt(4000)
    assert np.all((columns > 0.0) & (columns < 1.0))


def test_uniform_shares_are_uniform() -> None:
    from scipy.stats import kstest

    for sampling in ("random", "sobol"):
        shares = draw_shares(Draw(10**4, 11, sampling), KEYS, 0, 10**4)
        for key in KEYS:
            assert kstest(shares[key], "uniform").pvalue > 1e-3


def test_a_cut_normal_distribution() -> None:
    from scipy.stats import kstest, truncnorm

    cut = Tolerance("machine.resistance", "normal", 0.05, cut=2.0, centre=2e-3)
    found = draw_values(Draw(20_000, 5), [cut], 0, 20_000)["machine.resistance"]
    scores = (found / 2e-3 - 1.0) / 0.05
    assert np.max(np.abs(scores)) <= 2.0 + 1e-12
    assert kstest(scores, truncnorm(-2.0, 2.0).cdf).pvalue > 1e-3


def test_the_other_distributions() -> None:
    share = np.array([1e-16, 0.25, 0.5, 1.0 - 1e-16])
    wide = Tolerance("a", "uniform", 0.1, centre=500.0)
    np.testing.assert_allclose(values_at(wide, share), [450.0, 475.0, 500.0, 550.0])
    absolute = Tolerance("a", "uniform", 3.0, relative=False, centre=64.0)
    np.testing.assert_allclose(values_at(absolute, share), [61.0, 62.5, 64.0, 67.0])
    ends = Tolerance("a", "between", low=-1.0, high=3.0)
    np.testing.assert_allclose(values_at(ends, share), [-1.0, 0.0, 1.0, 3.0], atol=1e-12)
    normal = Tolerance("a", "normal", 2.0, relative=False, centre=1.0)
    assert values_at(normal, np.array([0.5]))[0] == 1.0
    below = Tolerance("a", "uniform", 0.1, centre=-500.0)
    assert values_at(below, np.array([1.0 - 1e-16]))[0] == pytest.approx(-550.0)


def test_correlated_scores_have_their_correlation() -> None:
    from scipy.special import ndtri

    chain = (*PAIRS, ("inverter.v_dc", "machine.inductance_d", -0.5))
    shares = draw_shares(Draw(40_000, 9, correlations=chain), KEYS, 0, 40_000)
    found = np.corrcoef([ndtri(shares[key]) for key in KEYS])
    expected = np.eye(4)
    expected[0, 1] = expected[1, 0] = -0.5
    expected[1, 2] = expected[2, 1] = 0.7
    np.testing.assert_allclose(found, expected, atol=5.0 / np.sqrt(40_000))


def test_sobol_points_fill_more_evenly_than_random_ones() -> None:
    counts = {}
    for sampling in ("random", "sobol"):
        shares = draw_shares(Draw(1024, 3, sampling), KEYS[:2], 0, 1024)
        cells = (shares[KEYS[0]] * 8).astype(int) * 8 + (shares[KEYS[1]] * 8).astype(int)
        counts[sampling] = np.bincount(cells, minlength=64)
    assert np.ptp(counts["sobol"]) == 0
    assert np.ptp(counts["random"]) > 5
