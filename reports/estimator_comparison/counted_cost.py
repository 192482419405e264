"""What a step of each estimator costs on the design's core: its emitted C compiled for it and run
on the emulation.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, VerificationError
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.observers.tracker_header import tracker_files
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.measured_cost import CallCost, cost_of_calls

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.candidate import EstimatorFigures, Question
    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator
    from dqforge.optimizer.estimator_comparison.solve import EstimatorComparison

_SAMPLES = 32

_SHARE = 0.5  # of the largest speed


def with_cost(found: EstimatorComparison) -> EstimatorComparison:
    """The comparison with instructions, cycles and bytes of each step, or why there are none.

    Args:
        found: The comparison.
    """
    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        try:
            rows = tuple(pool.map(lambda row: _counted(found.asked, row), found.estimators))
        except (VerificationError, InputError) as error:
            return replace(found, uncounted=error.message)
    return replace(found, estimators=rows, uncounted="")


def _counted(asked: Question, row: ComparedEstimator) -> ComparedEstimator:
    figures = row.figures
    if figures is None or (figures.tracker is None and figures.observer is None):
        return row
    if figures.tracker is not None and figures.tracker.tracker.hears:
        return row
    cost = _cost(asked, figures)
    return replace(row, cycles=cost.cycles, instructions=cost.instructions, flash=cost.flash)


def _files(design: Design, figures: EstimatorFigures) -> tuple[str, dict[str, bytes]]:
    """The word of the C names, and the header of an estimator."""
    if figures.tracker is not None:
        return figures.tracker.tracker.code, tracker_files(design, figures.tracker)
    assert figures.observer is not None
    return figures.observer.method.code, observer_files(design, figures.observer)


def _cost(asked: Question, figures: EstimatorFigures) -> CallCost:
    """Cost of a step at half the largest speed."""
    design = asked.design
    code, files = _files(design, figures)
    omega = _SHARE * asked.omega_max
    prefix = design.export.prefix
    context = {
        "prefix": prefix,
        "macro": prefix.upper(),
        "code": code,
        "omega": float_literal(omega),
        "rows": steady_rows(design, omega).view(np.uint32).tolist(),
    }
    made = {
        "measured_step.c": render("estimator_comparison/measured_step.c.j2", context),
        "step_calls.c": render("estimator_comparison/step_calls.c.j2", context),
    }
    sources = files | {name: text.encode("ascii") for name, text in made.items()}
    return cost_of_calls(sources, "measured_step", design.fit.core, ["measured_step.c"])


def steady_rows(design: Design, omega: float) -> NDArray[np.float32]:
    """Voltage and current (alpha, beta) of a drive at an electrical speed in rad/s that draws half
    its current limit across the magnets, shape (N, 4).

    Args:
        design: The drive.
        omega: Electrical speed in rad/s.
    """
    machine, i_q = linearised(design.machine), 0.5 * design.machine.i_max
    turn = np.exp(1j * omega * design.control.t_s * np.arange(_SAMPLES))
    voltage = complex(-omega * machine.l_q * i_q, machine.r_s * i_q + omega * machine.psi_pm)
    v, i = voltage * turn, 1j * i_q * turn
    return np.stack([v.real, v.imag, i.real, i.imag], axis=1).astype(np.float32)
