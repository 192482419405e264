"""Losses of alternatives over a map of torque and speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    DriveComparison,
    compare_drives,
    dead_time_share,
    usable_limit,
)
from dqforge.optimizer.losses.phase_comparison import PhaseDrive, compare_phases
from dqforge.optimizer.operating_points.characteristics import (
    VoltageLimit,
    characteristics,
    fastest_speed,
    voltage_limit,
)


@dataclass(frozen=True, slots=True)
class LossMap:
    """A comparison of A alternatives over N torques in N m and M mechanical speeds in rad/s.

    Its points run row by row, P = N M. ``dead_time_share`` is what dead time takes of the linear
    range, least and most of the alternatives.
    """

    torque: FloatArray
    omega_m: FloatArray
    comparison: DriveComparison
    dead_time_share: tuple[float, float]

    @property
    def usable(self) -> BoolArray:
        """Where each alternative drives the point within all limits, shape (A, P)."""
        return self.comparison.usable.reshape(-1, self.comparison.torque.size)

    @property
    def shared(self) -> BoolArray:
        """Points that all alternatives drive, shape (P,); those that drive none do not count."""
        somewhere = np.any(self.usable, axis=1)
        points = np.zeros(self.comparison.torque.size, dtype=np.bool_)
        return np.all(self.usable[somewhere], axis=0) if np.any(somewhere) else points

    @property
    def mean_losses(self) -> FloatArray:
        """Mean losses in W by kind over the shared points, shape (parts, A);
        NaN where there is no such point.
        """
        somewhere, shared = np.any(self.usable, axis=1), self.shared
        columns = []
        for part in PARTS:
            values = getattr(self.comparison.budget, part).reshape(self.usable.shape)
            mean = (
                np.mean(values[:, shared], axis=1)
                if np.any(shared)
                else np.full(somewhere.size, np.nan)
            )
            columns.append(np.where(somewhere, mean, np.nan))
        return np.stack(columns)

    @property
    def hottest_junction(self) -> FloatArray:
        """Largest junction temperature in degC where each alternative is usable, shape (A,);
        -inf where nowhere.
        """
        return self._largest(self.comparison.budget.junction_temperature)

    @property
    def largest_ripple(self) -> FloatArray:
        """Largest ripple current in A where each alternative is usable, shape (A,);
        -inf where nowhere.
        """
        return self._largest(self.comparison.budget.ripple_current)

    def _largest(self, values: FloatArray) -> FloatArray:
        return np.asarray(
            np.max(values.reshape(self.usable.shape), axis=1, initial=-np.inf, where=self.usable)
        )

    @property
    def least_share(self) -> FloatArray:
        """Share of the points at which each alternative loses least, shape (A,)."""
        best = self.comparison.best
        return np.bincount(best[best >= 0], minlength=self.usable.shape[0]) / best.size


def budget_options(design: Design) -> BudgetOptions:
    """What the design says of losses beside those of the fundamental."""
    return BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr)


def _widest(inverter: Inverter, alternatives: Alternatives, margin: float) -> VoltageLimit:
    """Largest limit that one of the alternatives has, dead time and margin taken off."""
    slowest = replace(inverter, f_sw=min(alternatives.frequencies))
    widest = max(alternatives.modulations, key=lambda name: usable_limit(slowest, name))
    taken = 1.0 - usable_limit(slowest, widest, margin) / voltage_limit(inverter, widest).v_max
    return voltage_limit(inverter, widest, taken)


def solve_map(
    design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int
) -> LossMap:
    """Compare over the motoring quadrant, up to the most torque and the largest
    speed of the best modulator.

    Args:
        design: The design.
        alternatives: Strategies, modulators and frequencies.
        margin: Share of the voltage of 0 to 1 that is kept for control.
        torques, speeds: Numbers of torques and speeds.
    """
    limit = _widest(design.inverter, alternatives, margin)
    figures = characteristics(design.machine, limit.v_max, design.i_max)
    fastest = fastest_speed(design.machine, figures, limit, design.i_max)
    torque = np.linspace(0.0, figures.torque_max, torques + 1)[1:]
    omega = np.linspace(0.0, fastest, speeds + 1)[1:]
    wanted, speed = np.meshgrid(torque, omega, indexing="ij")
    comparison = compare_alternatives(design, wanted.ravel(), speed.ravel(), alternatives, margin)
    return LossMap(
        torque, omega, comparison, dead_time_share(design.inverter, comparison.alternatives)
    )


def compare_alternatives(
    design: Design,
    torque: FloatArray,
    omega_m: FloatArray,
    alternatives: Alternatives,
    margin: float,
) -> DriveComparison:
    """Budgets of a design's machine by all alternatives, P points.

    Args:
        design: The design; one with any back-EMF is compared by the rules of its phase currents.
        torque, omega_m: In N m and rad/s, shape (P,).
        alternatives: Strategies, modulators and frequencies.
        margin: Share of the voltage of 0 to 1 that is kept for control.
    """
    options = budget_options(design)
    if design.phase_machine is not None:
        drive = PhaseDrive(
            design.phase_machine, design.machine, design.inverter, design.i_max, options, margin
        )
        return compare_phases(drive, torque, omega_m, alternatives).drives
    return compare_drives(
        design.machine,
        design.inverter,
        torque,
        omega_m,
        alternatives,
        i_max=design.i_max,
        options=options,
        margin=margin,
    )
