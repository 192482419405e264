"""Transients of a shipped drive with its emitted controller in the loop,
and the figures that papers state of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.design_run import controller_files, drive_of, observers_of
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

RPM = np.pi / 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """A solved design whose emitted controller is compiled into a simulation.

    ``gains`` are those of its header.
    """

    solution: Solution
    program: Simulator
    gains: PlainData

    @property
    def drive(self) -> Drive:
        """The plant that the design describes."""
        return drive_of(self.solution.design)

    def run(
        self, scenario: Scenario, changes: Mapping[str, Any] | None = None, stride: int = 1
    ) -> Simulation:
        """One scenario, with some members of the gains changed."""
        gains = b"" if changes is None else gain_bytes({**self.gains, **changes})
        return simulate(self.program, self.drive, scenario, stride=stride, gains=gains)


@contextmanager
def bench(design: Design) -> Iterator[Bench]:
    """A bench that lasts as long as the block.

    Raises:
        VerificationError: There is no compiler.
    """
    solution = solve_control(design)
    with simulator(
        controller_files(solution), design.export.prefix, observers_of(solution)[1]
    ) as program:
        yield Bench(solution, program, plain_control(solution))


def settling_time(found: Simulation, start: float, end: float, target: float, band: float) -> float:
    """Time in s from ``start`` after which the speed stays within ``band``
    (relative) of the target in rad/s.

    Raises:
        NoSolutionError: The speed is outside at ``end``, in s.
    """
    chosen = (found.t >= start) & (found.t < end)
    outside = np.flatnonzero(np.abs(found.omega_m[chosen] - target) > band * abs(target))
    if outside.size == 0:
        return 0.0
    if outside[-1] + 1 == int(np.count_nonzero(chosen)):
        raise NoSolutionError(
            f"the speed does not stay within {100.0 * band:g} % of {target:.4g} rad/s"
        )
    return float(found.t[chosen][outside[-1] + 1] - start)


def settled_or_nan(
    found: Simulation, start: float, end: float, target: float, band: float
) -> float:
    """As `settling_time`, nan where the speed does not settle."""
    try:
        return settling_time(found, start, end, target, band)
    except NoSolutionError:
        return float("nan")
