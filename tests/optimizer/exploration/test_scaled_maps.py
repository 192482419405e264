"""Rows of machines that saturate: factors of their flux maps go together, as one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from study_trials import Rows, outputs, plan_of

from dqforge.machines.dq_machines.flux_map import ScaledMachines
from dqforge.optimizer.exploration import variation as batch_steps
from dqforge.optimizer.exploration.sensitivities import ScaledLoci, scaled_loci
from dqforge.optimizer.exploration.study_plan import SINGLE_BATCH, TOGETHER_BATCH, YIELD_BATCH

SCALES = """tolerances:
  machine.resistance: {normal: 5 %}
  machine.map_scale.magnet: {normal: 2 %}
  machine.map_scale.inductance_d: {normal: 5 %}
  machine.map_scale.inductance_q: {normal: 5 %}
  machine.map_scale.current: {normal: 3 %}
set:
  machine.map_scale: {magnet: 1, inductance_d: 1, inductance_q: 1, current: 1}
"""

TORQUE = ("reference.torque_max", "reference.i_d", "reference.i_q")


FEW = """tolerances:
  machine.map_scale.magnet: {normal: 2 %}
  machine.map_scale.inductance_q: {normal: 5 %}
set:
  machine.map_scale: {magnet: 1, inductance_d: 1, inductance_q: 1, current: 1}
"""


def _draw(count: int) -> str:
    return f"draw: {{count: {count}, seed: 7}}\n"


def _apart(body: str, rows: Rows, most: int, design: str) -> dict[str, float]:
    """Largest deviation of the first rows from those of designs with maps of their own, each made
    and computed by itself.
    """
    plan = plan_of(body, design)
    plan._made.grouping.bounds = {}
    alone = Rows.of(plan, most)
    assert plan.work.batches == 0
    return {
        spec.name: float(np.max(np.abs(rows[spec.name][:most] / alone[spec.name] - 1.0)))
        for spec in plan.columns
        if spec.name.startswith("out.")
    }


@pytest.mark.parametrize(
    ("design", "scales", "count", "shown"),
    [
        ("baldor-pmsyrm-5k6", FEW, 16, 4),
        pytest.param("baldor-pmsyrm-5k6", SCALES, 100, 100, marks=pytest.mark.slow),
        pytest.param("abb-syrm-6k7-saturated", SCALES, 100, 100, marks=pytest.mark.slow),
    ],
)
def test_largest_torques_are_those_of_maps_written_out(
    design: str, scales: str, count: int, shown: int
) -> None:
    body = scales + outputs(*TORQUE) + _draw(count)
    rows = Rows.of(plan_of(body, design))
    assert rows.plan.batch == TOGETHER_BATCH
    assert set(rows.states) == {"ok"}
    work = rows.plan.work
    assert (work.limits, work.batches) == (0, 1)  # no row by itself
    deviations = _apart(body, rows, shown, design)
    assert deviations["out.reference.torque_max"] < 1e-12
    assert max(deviations.values()) < 1e-9  # torque is flat in the angle
    assert np.ptp(rows["out.reference.torque_max"]) > 0.02 * rows["out.reference.torque_max"][0]
    assert set(rows.blocks[0].audited) == set(TORQUE)
    assert max(rows.blocks[0].audited.values()) < 1e-9


HEADER = """  inverter.device: {name: fuji-2mbi300xbe120-50}
  inverter.dead_time: 1 us
  inverter.coolant_temperature: 40 degC
  losses.points:
    - {torque: 20 N m, speed: 100 rad/s}
header: nominal
"""


@pytest.mark.parametrize(
    ("scales", "count", "shown"),
    [(FEW, 16, 3), pytest.param(SCALES, 100, 100, marks=pytest.mark.slow)],
)
def test_a_header_on_scaled_maps_is_that_on_maps_written_out(
    scales: str, count: int, shown: int
) -> None:
    names = ("reference.torque_error", "reference.torque_made", "reference.loss_penalty")
    asked = outputs(*names, "gains.phase_margin", "losses.total")
    body = scales + HEADER + asked + _draw(count)
    rows = Rows.of(plan_of(body, "baldor-pmsyrm-5k6"))
    assert rows.plan.batch == YIELD_BATCH
    assert rows.plan.work.designs <= 32  # corners alone
    assert np.ptp(rows["out.losses.total"]) > 0.0
    deviations = _apart(body, rows, shown, "baldor-pmsyrm-5k6")
    penalty = deviations.pop("out.reference.loss_penalty")  # a difference of nearly equal numbers
    assert max(deviations.values()) < 1e-11
    assert penalty < 1e-7


def test_what_a_map_does_to_fits_and_loops_is_left_to_the_single_path() -> None:
    asked = outputs("fit.error.torque_relative", "gains.i_q.phase_margin", *TORQUE)
    plan = plan_of(FEW + asked + _draw(17), "baldor-pmsyrm-5k6")
    assert plan.batch == SINGLE_BATCH
    block = plan.rows(1, 3)
    work = plan.work
    assert (work.limits, work.fits, work.gain_sets, work.batches) == (0, 2, 2, 1)
    assert len(set(block.columns["out.gains.i_q.phase_margin"].tolist())) == 2


def test_a_locus_that_is_not_solved_is_asked_of_the_single_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unsolved(machines: ScaledMachines) -> ScaledLoci:
        found = scaled_loci(machines)
        return replace(found, solved=found.solved & (machines.magnet > np.min(machines.magnet)))

    body = FEW + outputs(*TORQUE) + _draw(16)
    together = plan_of(body, "baldor-pmsyrm-5k6").rows(1, 6)
    monkeypatch.setattr(batch_steps, "scaled_loci", unsolved)
    plan = plan_of(body, "baldor-pmsyrm-5k6")
    block = plan.rows(1, 6)
    assert (plan.work.limits, plan.work.batches) == (1, 1)
    for name in TORQUE:
        np.testing.assert_allclose(
            block.columns[f"out.{name}"], together.columns[f"out.{name}"], rtol=1e-9
        )
