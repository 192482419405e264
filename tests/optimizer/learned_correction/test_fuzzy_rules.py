"""Rules: what one solve finds, the mean of neighbours, and the bound."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from learned_drives import learned_observer

from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.learned_correction.correction_frame import (
    CURRENT_KNOTS,
    KNOTS,
    SPEED_KNOTS,
    TERMS,
    answered,
    largest_rule,
    least_squares,
    trained_rules,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, cast


def test_least_squares_are_those_of_numpy() -> None:
    generator = np.random.default_rng(3)
    columns, wanted = generator.standard_normal((30, 500)), generator.standard_normal(500)
    expected = np.linalg.lstsq(columns.T, wanted, rcond=None)[0]
    np.testing.assert_allclose(least_squares(columns, wanted), expected, atol=1e-8)


def test_an_unknown_that_no_sample_tells_is_nought() -> None:
    columns = np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(least_squares(columns, 2.0 * columns[0]), [2.0, 0.0], atol=1e-6)


def test_rules_that_made_the_data_are_found_again() -> None:
    generator = np.random.default_rng(4)
    x = generator.uniform(-1.0, 1.0, (6, 20_000))
    made = trained_rules(x, generator.standard_normal(20_000))
    wanted = answered(EXACT, made, tuple(x))
    assert np.std(wanted) > 0.01
    again = trained_rules(x, wanted)
    np.testing.assert_allclose(again.answers, made.answers, atol=1e-4)


def test_at_a_knot_one_rule_speaks_and_between_them_the_mean_is_convex() -> None:
    rules = learned_observer("neuro-fuzzy").gains.rules
    answers = np.array(rules.answers).reshape(KNOTS, KNOTS, TERMS)
    rest = np.random.default_rng(6).uniform(-1.0, 1.0, 6)
    for k, u in enumerate(SPEED_KNOTS):
        for n, i_q in enumerate(CURRENT_KNOTS):
            x = [np.array([value]) for value in rest]
            x[3], x[4] = np.array([i_q]), np.array([u])
            expected = answers[k, n] @ np.array([1.0, *(float(part[0]) for part in x[:4])])
            assert answered(EXACT, rules, tuple(x))[0] == pytest.approx(expected, abs=1e-6)


def test_no_answer_within_the_trained_ranges_is_larger_than_the_largest_rule() -> None:
    """A million inputs in single precision, and the corners of all cells, where it is attained or
    nearly so: half of it at least.
    """
    observer = learned_observer("neuro-fuzzy")
    gains = observer.gains
    bound = largest_rule(gains.rules, gains.frame)
    assert observer.training is not None
    assert observer.training.rules == bound
    generator = np.random.default_rng(8)
    x = generator.uniform(-1.0, 1.0, (6, 1_000_000)).astype(np.float32)
    x[:, ::2] = np.sign(x[:, ::2])
    u = x[4].astype(np.float64) / gains.frame.scale[4] + gains.frame.centre[4]
    inverse = np.minimum(gains.frame.low * (1.0 - u) / (gains.frame.middle * (1.0 + u)), 1.0)
    x[1] = (inverse - gains.frame.centre[1]) * gains.frame.scale[1]  # the same speed
    found = np.abs(answered(SINGLE, cast(gains, SINGLE).rules, tuple(x)))
    assert float(np.max(found)) <= bound * (1.0 + 1e-6)
    assert float(np.max(found)) > 0.5 * bound


def test_another_number_of_rules_is_refused() -> None:
    rules = learned_observer("neuro-fuzzy").gains.rules
    with pytest.raises(ValueError, match="sixteen"):
        replace(rules, answers=rules.answers[:-1])
    with pytest.raises(ValueError, match="four speeds"):
        replace(rules, speed_knots=rules.speed_knots[:-1])
