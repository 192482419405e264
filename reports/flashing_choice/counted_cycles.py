"""What a sample of each row costs on the design's core: the emitted control compiled for it and run
on the emulation.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.flashing_choice import FlashComparison, FlashRow
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.flashing_choice.row_files import files_with_control
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.measured_cost import cost_on_target

_SAMPLES = 40


def counted_rows(solution: Solution, found: FlashComparison) -> tuple[FlashRow, ...]:
    """Rows with the cycles of a sample; those without a control stay as they are.

    Args:
        solution: Of the design; its fit names the core.
        found: The comparison, with the control of each row.

    Raises:
        VerificationError: A tool is missing, or the emulation failed.
    """

    def count(row: FlashRow) -> FlashRow:
        if row.control is None:
            return row
        return replace(row, cycles=_cycles(solution, found, row))

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(count, found.rows))


def _cycles(solution: Solution, found: FlashComparison, row: FlashRow) -> tuple[float, float]:
    """Mean cycles (low, high) of a sample."""
    assert row.control is not None  # asked for before
    prefix = solution.design.export.prefix
    omega_e = found.omega_m * row.control.pole_pairs
    sample = render(
        "flashing_choice/control_sample.h.j2",
        {
            "prefix": prefix,
            "omega_m": float_literal(found.omega_m),
            "v_dc": float_literal(found.v_dc),
            "step": float_literal(omega_e * row.control.t_s),
            "midpoint": TOPOLOGIES[row.topology].midpoint,
        },
    )
    files = files_with_control(solution, row.control)
    sources = files | {"control_sample.h": sample.encode("ascii")}
    torques = np.full(_SAMPLES, found.torque, dtype=np.float32)
    core = solution.design.fit.core
    return cost_on_target(sources, "control_sample.h", "control_sample", core, torques).cycles
