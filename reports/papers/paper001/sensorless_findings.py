"""Figures 8.29 to 8.33 of paper 001: simulation with and without estimator, and the bench without
encoder.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.papers.paper001.program_findings import Finding, Quantity
from dqforge.reports.papers.transients import RPM
from dqforge.reports.simulation.recorded_run import Simulation

_STEADY = 1.0  # s


def _lag(run: Simulation) -> FloatArray:
    """Electrical angle in turns by which the estimated position is behind, shape (N,)."""
    gap = run.theta_e - run.theta_e_observed
    return np.asarray(np.angle(np.exp(1j * gap)) / (2.0 * np.pi))


def sensorless_findings(
    without: Simulation, observed: Simulation, bench: Simulation
) -> tuple[Finding, ...]:
    """What is read off the runs.

    Args:
        without: The start with the speed of the encoder.
        observed: The start with the speed of the exact observer.
        bench: The drive on its estimator, with the errors of the bench.
    """
    target = float(bench.reference[-1])
    last = np.asarray(bench.t >= _STEADY)
    seen = float(np.mean(bench.omega_m_observed[last])) / RPM
    true = float(np.mean(bench.omega_m[last])) / RPM
    behind = 100.0 * _lag(bench)[last]
    ends = (float(np.mean(run.omega_m[run.t >= _STEADY])) for run in (without, observed))
    plain, estimated = (100.0 * (end / target - 1.0) for end in ends)
    apart = float(np.max(np.abs(observed.omega_m_measured - observed.omega_m))) / RPM
    span = bench.t[last]
    turns = np.unwrap(bench.theta_e[last])
    rate = float((turns[-1] - turns[0]) / (span[-1] - span[0]))
    return (
        Finding(
            "8.29",
            "simulated start with and without estimator",
            "no significant error after 80 ms from the start; about 1 % off the reference",
            (
                Quantity("largest error of the estimate on the way", apart, "rpm"),
                Quantity("off the reference with the estimator", estimated, "%"),
                Quantity("without", plain, "%"),
            ),
        ),
        Finding("8.30", "the control without encoder", "diagram, nothing to compute"),
        Finding(
            "8.31",
            "estimated and measured speed at 1500 rpm",
            "about 60 rpm apart, 4 %",
            (
                Quantity("estimated", seen, "rpm"),
                Quantity("measured", true, "rpm"),
                Quantity("apart", seen - true, "rpm"),
            ),
        ),
        Finding(
            "8.32",
            "estimated and measured position",
            "",
            (
                Quantity("electrical turn", 2e3 * np.pi / rate, "ms"),
                Quantity("behind by", 3.6 * float(np.mean(behind)), "deg"),
            ),
        ),
        Finding(
            "8.33",
            "error of the position in percent",
            "about 10 % electrical, 3.33 % mechanical",
            (
                Quantity("mean", float(np.mean(behind)), "% of an electrical turn"),
                Quantity("from peak to peak", float(np.ptp(behind)), "%"),
                Quantity("mechanical, mean", float(np.mean(behind)) / 3.0, "% of a turn"),
            ),
        ),
    )
