"""What single precision costs: fits of many machines in float32 arithmetic
against the same fits in double.
"""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve
from dqforge.optimizer.curves.single_precision import (
    CONTRACTED,
    SINGLE,
    PiecewisePolynomial,
    SinglePolynomial,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

HALF_ULP = 2.0**-24
# Half units in the last place of the largest current that evaluation adds where nothing else is
# left.
FLOOR = 2.5


def random_machine(generator: np.random.Generator) -> LinearMachine:
    """Any salient machine whose current limit lies at 0.5 to 3 of the MTPA curve's own scale."""
    psi_pm, l_d = 10 ** generator.uniform(-2.0, 0.0), 10 ** generator.uniform(-4.0, -2.0)
    ratio = generator.uniform(1.2, 6.0)
    i_max = generator.uniform(0.5, 3.0) * psi_pm / (l_d * (ratio - 1.0))
    return LinearMachine(3, 0.1, l_d, l_d * ratio, psi_pm, i_max)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 6])
@pytest.mark.parametrize("segments", [1, 2, 4])
def test_float_costs_one_percent_and_the_rounding_floor(degree: int, segments: int) -> None:
    """20 machines: the largest error rises by at most 1 %, and what evaluation in floats cannot
    avoid.
    """
    generator = np.random.default_rng(11)
    for _ in range(20):
        machine = random_machine(generator)
        choice = CurrentChoice(machine, "mtpa", machine.i_max)
        end = choice.largest_torque()
        edges = np.linspace(0.0, 1.0, segments + 1) ** 1.5 * end
        torque = np.unique(np.linspace(0.0, end, 3001).astype(np.float32))
        torque = torque[torque <= np.float32(end)]
        for curve in choice.curves(end).values():
            fit = fit_curve(
                curve, edges, degree, "minimax", SideConditions(exact_at_zero=True, continuous=True)
            )
            exact = curve(torque.astype(np.float64))
            in_double = np.max(np.abs(fit(torque.astype(np.float64)) - exact))
            single = SinglePolynomial.from_double(fit)
            in_float = max(
                float(np.max(np.abs(single.evaluate(torque, way).astype(np.float64) - exact)))
                for way in (SINGLE, CONTRACTED)
            )
            floor = FLOOR * HALF_ULP * np.max(np.abs(exact))
            assert in_float <= 1.01 * in_double + floor


def test_rounding_in_turn_beats_plain_rounding() -> None:
    """Degree 6 on one and two segments: what rounding adds to the error falls,
    on average and at worst.
    """
    generator = np.random.default_rng(11)
    added: list[tuple[float, float]] = []
    for _ in range(10):
        machine = random_machine(generator)
        choice = CurrentChoice(machine, "mtpa", machine.i_max)
        end = choice.largest_torque()
        torque = np.linspace(0.0, end, 3001).astype(np.float32)[:-1]
        for curve in choice.curves(end).values():
            for edges in ([0.0, end], [0.0, 0.4 * end, end]):
                fit = fit_curve(curve, np.array(edges), 6, "minimax", SideConditions(True, True))
                exact = curve(torque.astype(np.float64))
                best = float(np.max(np.abs(fit(torque.astype(np.float64)) - exact)))
                plain = SinglePolynomial(
                    fit.edges[:-1].astype(np.float32), fit.coefficients.astype(np.float32)
                )
                found = [
                    float(np.max(np.abs(single.evaluate(torque).astype(np.float64) - exact))) - best
                    for single in (plain, SinglePolynomial.from_double(fit))
                ]
                unit = HALF_ULP * float(np.max(np.abs(exact)))
                added.append((found[0] / unit, found[1] / unit))
    before, after = np.array(added).T
    assert np.mean(after) < 0.7 * np.mean(before)
    assert np.max(after) < 0.7 * np.max(before)


def test_a_power_that_is_absent_stays_absent() -> None:
    fit = PiecewisePolynomial(np.array([0.0, 3.0]), np.array([[0.0, 0.0, 0.1, 0.3]]))
    single = SinglePolynomial.from_double(fit)
    assert single.coefficients[0, 1] == 0.0
    np.testing.assert_array_equal(single.coefficients[0], fit.coefficients[0].astype(np.float32))
