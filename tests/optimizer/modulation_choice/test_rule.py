"""Rules of a few thresholds: found where they are planted, as good as brute force,
priced against the best choice.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.modulation_choice.rule import Leaf, Question, decide, leaves, simplify


def points(count: int, seed: int) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(seed)
    return {
        "torque_Nm": generator.uniform(0.0, 200.0, count),
        "speed_rad_per_s": generator.uniform(0.0, 900.0, count),
    }


def test_planted_rule_of_two_questions_is_found() -> None:
    known = points(2500, 1)
    slow = Question("speed_rad_per_s", 300.0, Leaf(0), Leaf(2))
    fast = Question("speed_rad_per_s", 500.0, Leaf(1), Leaf(3))
    planted = Question("torque_Nm", 120.0, slow, fast)
    wanted = decide(planted, known)
    loss = np.full((2500, 5), 50.0) + 10.0 * np.arange(5)
    loss[np.arange(2500), wanted] = 20.0
    found = simplify(loss, np.ones(loss.shape, dtype=bool), known)
    assert leaves(found.rule) == 4
    agree = np.mean(decide(found.rule, known) == wanted)
    assert agree > 0.97  # thresholds come from 48 quantiles
    assert 0.0 <= found.price < 0.07


def brute_force(loss: np.ndarray, known: dict[str, np.ndarray]) -> float:
    """Least mean loss of all trees of depth two with thresholds between neighbouring values."""

    def best_leaf(mask: np.ndarray) -> float:
        return float(np.min(np.sum(loss[mask], axis=0), initial=np.inf)) if mask.any() else 0.0

    def cuts(mask: np.ndarray) -> list[np.ndarray]:
        return [
            mask & (values >= cut) for values in known.values() for cut in np.unique(values)[1:]
        ]

    everything = np.ones(loss.shape[0], dtype=bool)
    least = best_leaf(everything)
    for above in cuts(everything):
        sides = []
        for side in (above, everything & ~above):
            inner = [best_leaf(cut) + best_leaf(side & ~cut) for cut in cuts(side)]
            sides.append(min([best_leaf(side), *inner]))
        least = min(least, sum(sides))
    return float(least / loss.shape[0])


@pytest.mark.parametrize("seed", range(6))
def test_nothing_beats_the_rule(seed: int) -> None:
    known, generator = points(18, seed), np.random.default_rng(seed + 50)
    loss = generator.uniform(10.0, 100.0, (18, 4))
    found = simplify(loss, np.ones(loss.shape, dtype=bool), known)
    assert found.mean_loss == pytest.approx(brute_force(loss, known), rel=1e-12)
    assert found.best_loss == pytest.approx(np.mean(np.min(loss, axis=1)))
    fewer = [
        simplify(loss, np.ones(loss.shape, dtype=bool), known, questions=n).mean_loss
        for n in (0, 1, 2)
    ]
    assert fewer == sorted(fewer, reverse=True)


def test_limits_come_before_losses() -> None:
    """The cheapest alternative is forbidden at high torque: the rule leaves it there,
    whatever that costs.
    """
    known = points(400, 3)
    loss = np.tile([10.0, 30.0], (400, 1))
    permitted = np.ones((400, 2), dtype=bool)
    permitted[known["torque_Nm"] > 150.0, 0] = False
    found = simplify(loss, permitted, known, questions=1)
    assert found.permitted
    chosen = decide(found.rule, known)
    assert np.all(permitted[np.arange(400), chosen])
    assert found.mean_loss >= found.best_loss


def test_weights_move_the_rule() -> None:
    known = {"torque_Nm": np.array([10.0, 100.0])}
    loss = np.array([[5.0, 9.0], [9.0, 5.0]])
    for weights, choice in ((np.array([10.0, 1.0]), 0), (np.array([1.0, 10.0]), 1)):
        assert simplify(
            loss, np.ones((2, 2), dtype=bool), known, weights, questions=0
        ).rule == Leaf(choice)


def test_no_question_where_none_saves_anything() -> None:
    known = points(100, 4)
    found = simplify(np.tile([3.0, 2.0, 5.0], (100, 1)), np.ones((100, 3), dtype=bool), known)
    assert found.rule == Leaf(1)
    assert found.price == 0.0


def test_a_point_without_any_alternative_is_named() -> None:
    permitted = np.ones((5, 2), dtype=bool)
    permitted[3] = False
    with pytest.raises(
        NoSolutionError, match="at operating point 4 no alternative keeps all limits"
    ):
        simplify(np.ones((5, 2)), permitted, points(5, 0))


def test_thresholds_are_short_numbers_that_divide_as_asked() -> None:
    known = {"speed_rad_per_s": np.array([100.123, 200.456, 300.789, 400.5])}
    loss = np.array([[1.0, 2.0], [1.0, 2.0], [2.0, 1.0], [2.0, 1.0]])
    rule = simplify(loss, np.ones((4, 2), dtype=bool), known).rule
    assert isinstance(rule, Question)
    assert 200.456 < rule.threshold < 300.789
    assert len(f"{rule.threshold:g}") <= 4
    assert list(itertools.chain(decide(rule, known))) == [0, 0, 1, 1]
