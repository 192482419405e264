"""Many rows: the work grows with their number and no faster, and what formulas give of 200 unlike
machines is what each gives alone.
"""

from __future__ import annotations

import numpy as np
import pytest
from study_commands import linear_study
from study_trials import POINTS, Rows, loop_names, outputs, plan_of

from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.optimizer.exploration.variation import Work

CORNERS = 2**5


def work_of(count: int) -> Work:
    """Of a study with so many full rows, the audit left out."""
    plan = StudyPlan(study_of_text(linear_study(count).encode(), "study.yaml"))
    return Rows.of(plan).plan.work


def test_work_is_proportional_to_the_rows() -> None:
    few, many = work_of(1000), work_of(3000)
    for work in (few, many):
        assert work.designs == CORNERS
        assert (work.fits, work.gain_sets, work.budget_calls, work.limits) == (0, 0, 0, 0)
    assert few.batches == 4  # limits, fits, loops, losses
    assert many.batches == 12


UNLIKE = (
    """tolerances:
  machine.resistance: {uniform: 50 %}
  machine.inductance_d: {uniform: 30 %}
  machine.inductance_q: {uniform: 20 %}
  machine.magnet_flux: {uniform: 40 %}
  machine.max_current: {uniform: 20 %}
draw: {count: 200, seed: 17}
set:
  fit.max_torque: 80 N m
  losses.modulations: [ddt-gdpwm]
"""
    + POINTS
    + outputs(
        *(f"reference.{name}" for name in ("torque_max", "i_d", "i_q")),
        "fit.error.i_d",
        "fit.error.i_q",
        *loop_names("i_d", "i_q"),
        "losses.total",
        "losses.junction_temperature",
        "losses.points.1.copper",
    )
)


@pytest.mark.slow
def test_200_unlike_machines_together_are_those_one_by_one() -> None:
    together = Rows.of(plan_of(UNLIKE))
    single = plan_of(UNLIKE)
    single._made.grouping.bounds = {}
    alone = Rows.of(single)
    assert together.plan.work.batches >= 3
    assert together.plan.work.fits < 20
    assert single.work.fits == 200
    assert together.states == alone.states
    for spec in single.columns:
        found, expected = together[spec.name], alone[spec.name]
        if spec.name.startswith("out.fit.error."):
            assert np.all(found <= 1.25 * expected), spec.name
        elif spec.name.endswith(".stable"):
            assert np.array_equal(found, expected), spec.name
        else:
            within = 1e-8 if spec.name.endswith("sensitivity") else 1e-12
            np.testing.assert_allclose(found, expected, rtol=within, err_msg=spec.name)
