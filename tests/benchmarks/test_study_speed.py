"""Rows of studies per second of processor time: full rows of a linear drive by formulas, rows by
the exact chain, how the cost grows with their number, and what a batch costs beside its rows.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from study_clusters import certificates, cluster
from study_commands import linear_study
from study_rows import StudyRows
from study_runs import run_in

from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.exploration.contained_rows import EngineSettings, contained_rows
from dqforge.reports.exploration.part_file import encode_part

pytestmark = pytest.mark.benchmark

EXACT = """dqforge_study: 1
name: Machines one by one
design: paper000-ipmsm-100kw
vary:
  machine.inductance_d: {range: {from: 300 uH, to: 360 uH, count: 15, spacing: linear}}
set:
  losses.modulations: [ddt-gdpwm]
  fit.max_torque: 150 N m
  losses.points:
    - {torque: 40 N m, speed: 450 rad/s, weight: 60 %}
    - {torque: 130 N m, speed: 300 rad/s, weight: 30 %}
    - {torque: 150 N m, speed: 200 rad/s, weight: 10 %}
outputs:
  [reference.torque_max, fit.error.i_d, gains.i_d.phase_margin, gains.i_q.phase_margin,
   losses.total]
"""


def seconds_of(plan: StudyPlan, parts: int) -> float:
    """Processor time of some parts of a study, with their bytes."""
    began = time.process_time()
    for part in range(parts):
        first = part * plan.batch
        block = contained_rows(plan, first, min(first + plan.batch, plan.count))
        encode_part(block, plan.columns, "0" * 64)
    return time.process_time() - began


def test_full_rows_together_against_the_exact_chain() -> None:
    plan = StudyPlan(study_of_text(linear_study(100_000).encode(), "study.yaml"))
    single = StudyPlan(study_of_text(EXACT.encode(), "study.yaml"))
    assert (plan.batch, single.batch, single.count) == (1000, 25, 15)
    seconds_of(plan, 1)
    few, many = (min(seconds_of(plan, parts) for _ in range(2)) / parts for parts in (5, 20))
    single.rows(0, 1)
    alone = seconds_of(single, 1) / single.count
    assert single.work.fits == single.count
    print(
        f"\n41 columns by formulas: {1000 / many:,.0f} rows/s of processor time; a row of 20 parts "
        f"takes {many / few:.2f} of one of 5; by the exact chain {1 / alone:.0f} rows/s, "
        f"{alone * 1000 / many:.0f} times as long"
    )


def test_a_batch_beside_its_rows(tmp_path: Path) -> None:
    """Batches with next to no rows, so that all they cost is the engine's."""
    rows, each = StudyRows(count=2000, batch=10), {}
    tls = certificates(tmp_path / "certificates")
    with cluster(tmp_path / "cluster", 2, tls) as there:
        ways = {
            "in this process": EngineSettings(workers=1),
            "2 processes": EngineSettings(workers=2),
            "2 separate ones with TLS": EngineSettings(scheduler=there.address, tls=tls),
        }
        for place, (way, settings) in enumerate(ways.items()):
            outcome = run_in(tmp_path / str(place), rows, settings)
            each[way] = outcome.seconds / 200 * 1e3
    print("\nper batch: " + ", ".join(f"{way} {took:.0f} ms" for way, took in each.items()))
