"""Budgets of many drives with linear machines at once: a machine, a link voltage, a dead time and a
carrier for each, the device and all the rest in common.

The budgets are those of `dqforge.optimizer.losses.point_comparison.compare_points`, a row per
drive. The rows' points stand side by side as one list, so that averages over the electrical period
are taken of all of them together; what differs between rows alone scales them: duty cycles know
voltages over that of the link, energies of one table a power of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_tables import energy_factors
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import ModulationName, Strategy
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import fundamental_share
from dqforge.optimizer.losses.axis_currents import AxisCurrents, axis_currents
from dqforge.optimizer.losses.drive_budget import (
    BudgetOptions,
    DriveBudget,
    Supply,
    known_bridge,
    stacked_budgets,
    supplied_budget,
)

# Strategies whose currents are found for many machines at once.
STRATEGIES: tuple[Strategy, ...] = ("id0", "mtpa")


@dataclass(frozen=True, slots=True, eq=False)
class DriveAxis:
    """R drives that differ in what stands here, arrays of shape (R,).

    Args:
        machines: Their machines, with the current limits of the drives: the least of machine and
            inverter.
        inverter: What they have in common: device, coolant, topology. Its link voltage is the one
            at which the tables of the device are read; the carrier and the dead time are not looked
            at.
        v_dc, dead_time, f_sw: Link voltages in V, dead times in s, carrier frequencies in Hz.
    """

    machines: MachineBatch
    inverter: Inverter
    v_dc: FloatArray
    dead_time: FloatArray
    f_sw: FloatArray

    def taken(self, rows: IndexArray) -> DriveAxis:
        """The drives of some rows."""
        return replace(
            self,
            machines=self.machines.taken(rows),
            v_dc=self.v_dc[rows],
            dead_time=self.dead_time[rows],
            f_sw=self.f_sw[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class AxisBudgets:
    """Budgets of R drives with S strategies, M modulators and F carriers at P points, arrays of the
    shape (R, S, M, F, P).

    Args:
        budget: Powers, temperatures and marks; numbers are NaN where the torque is out of reach.
        reached: Whether the currents make the torque within the limits.
        doubtful: True where only the single path says whether they do: a limit lies nearer than
            1e-6.
    """

    budget: DriveBudget
    reached: BoolArray
    doubtful: BoolArray

    @property
    def usable(self) -> BoolArray:
        """True where the torque is made, the voltage can be, and every temperature is steady and
        permitted.
        """
        return np.asarray(self.reached & self.budget.feasible)

    @property
    def exact(self) -> BoolArray:
        """False for drives that belong on the single path, shape (R,)."""
        return np.asarray(~np.any(self.doubtful, axis=(1, 2, 3, 4)), dtype=np.bool_)

    def mean(self, name: str, weights: ArrayLike | None = None) -> FloatArray:
        """Mean over the points of a number of the budget, shape (R, S, M, F).

        Args:
            name: A field of `DriveBudget`.
            weights: Of the points, shape (P,) or (R, P); all alike when None.
        """
        values = np.asarray(getattr(self.budget, name))
        if weights is None:
            return np.asarray(np.mean(values, axis=-1))
        given = np.asarray(weights, dtype=np.float64)
        share = given / np.sum(given, axis=-1, keepdims=True)
        spread = share if share.ndim == 1 else share[:, None, None, None, :]
        # A point without weight need not be within reach.
        return np.asarray(np.sum(np.where(spread > 0.0, spread * values, 0.0), axis=-1))

    def largest(self, name: str) -> FloatArray:
        """Largest of a number of the budget over the points, shape (R, S, M, F); NaN where one is.

        Args:
            name: A field of `DriveBudget`.
        """
        return np.asarray(np.max(getattr(self.budget, name), axis=-1))


def drive_axis(
    machines: MachineBatch,
    inverter: Inverter,
    *,
    v_dc: ArrayLike | None = None,
    dead_time: ArrayLike | None = None,
    f_sw: ArrayLike | None = None,
) -> DriveAxis:
    """Drives with an inverter of which some numbers differ.

    Args:
        machines: R machines; the inverter's current limit is theirs too.
        inverter: The inverter.
        v_dc, dead_time, f_sw: In V, s and Hz, numbers or shape (R,); None for the inverter's own.
    """
    own = (inverter.v_dc, inverter.dead_time, inverter.f_sw)
    given = (v_dc, dead_time, f_sw)
    columns = [
        np.array(np.broadcast_to(mine if one is None else np.asarray(one), machines.count), float)
        for mine, one in zip(own, given, strict=True)
    ]
    if inverter.i_max is not None:
        machines = replace(machines, i_max=np.minimum(machines.i_max, inverter.i_max))
    return DriveAxis(machines, inverter, *columns)


def budgets_over_machines(
    drives: DriveAxis,
    torque: ArrayLike,
    omega_m: ArrayLike,
    strategies: Sequence[Strategy],
    modulations: Sequence[ModulationName],
    frequencies: ArrayLike | None = None,
    *,
    options: BudgetOptions | None = None,
    margin: float = 0.0,
) -> AxisBudgets:
    """Budgets of R drives at P points of torque and speed.

    Args:
        drives: R drives.
        torque, omega_m: In N m and rad/s, shape (P,) of all drives or (R, P) of each.
        strategies: S strategies of `STRATEGIES`.
        modulations: M modulators.
        frequencies: F carrier frequencies in Hz that every drive has, in the place of its own; they
            share the averages over the electrical period.
        options: What is counted beside copper, conduction and switching loss.
        margin: Share of the voltage that is kept free for control.

    Raises:
        InputError: A strategy is solved for single machines alone, or there is nothing to compare.
    """
    for strategy in strategies:
        if strategy not in STRATEGIES:
            raise InputError(
                f"losses of many machines: strategy {strategy} is solved one machine at a time; "
                f"take {' or '.join(STRATEGIES)}"
            )
    wanted = (np.asarray(value, dtype=np.float64) for value in (torque, omega_m))
    rows = drives.machines.count
    shape = np.broadcast_shapes((rows, 1), *(np.shape(value) for value in (torque, omega_m)))
    flat = [np.broadcast_to(value, shape).ravel() for value in wanted]
    if not (strategies and modulations and flat[0].size and len(shape) == 2):
        raise InputError(
            "losses of many machines: give a strategy, a modulator and points as (points,) or "
            "(machines, points) at least"
        )
    chosen = BudgetOptions() if options is None else options
    carriers = None if frequencies is None else np.atleast_1d(np.asarray(frequencies, float))
    parts = []
    for place in _alike(drives):
        some = _Rows(drives.taken(place), shape[1], carriers, chosen, margin)
        points = [value.reshape(shape)[place].ravel() for value in flat]
        parts.append(some.budgets(points[0], points[1], strategies, modulations))
    order = np.argsort(np.concatenate(_alike(drives)), kind="stable")
    return _joined(parts, order)


def _alike(drives: DriveAxis) -> list[IndexArray]:
    """Rows that go together: all, or those of one link voltage where it does more than scale."""
    every = np.arange(drives.v_dc.size)
    if np.all(drives.v_dc == drives.v_dc[0]):
        return [every]
    if drives.inverter.overmodulation == "none" and _factors(drives) is not None:
        return [every]
    return [np.flatnonzero(drives.v_dc == value) for value in np.unique(drives.v_dc)]


def _factors(drives: DriveAxis) -> FloatArray | None:
    if drives.inverter.device is None:
        return np.ones((2, drives.v_dc.size))
    return energy_factors(drives.inverter, drives.v_dc)


def _joined(parts: Sequence[AxisBudgets], order: IndexArray) -> AxisBudgets:
    """Groups of rows as one, in the order of the rows."""

    def whole(values: Sequence[Any]) -> Any:
        return values[0] if len(values) == 1 else np.concatenate(values)[order]

    columns: dict[str, Any] = {
        part.name: whole([getattr(one.budget, part.name) for one in parts])
        for part in fields(DriveBudget)
    }
    return AxisBudgets(
        DriveBudget(**columns),
        whole([one.reached for one in parts]),
        whole([one.doubtful for one in parts]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Drives that are reckoned together, their P points in one list, drive by drive."""

    drives: DriveAxis
    points: int
    carriers: FloatArray | None
    options: BudgetOptions
    margin: float

    @property
    def frequencies(self) -> FloatArray:
        """Carriers (F, 1) of all points, or (1, N) of each."""
        if self.carriers is not None:
            return self.carriers[:, None]
        return np.repeat(self.drives.f_sw, self.points)[None, :]

    def budgets(
        self,
        torque: FloatArray,
        omega_m: FloatArray,
        strategies: Sequence[Strategy],
        modulations: Sequence[ModulationName],
    ) -> AxisBudgets:
        """Budgets at N = R P points."""
        found = [self._strategy(torque, omega_m, one, modulations) for one in strategies]
        budget = stacked_budgets([one[0] for one in found], 0)
        made, doubt = np.stack([one[1] for one in found]), np.stack([one[2] for one in found])
        made = np.broadcast_to(made, budget.total.shape)
        columns: dict[str, Any] = {}
        for part in fields(DriveBudget):
            values = getattr(budget, part.name)
            blank = values if values.dtype == np.bool_ else np.where(made, values, np.nan)
            columns[part.name] = self._by_row(blank)
        doubt = np.broadcast_to(doubt, made.shape)
        return AxisBudgets(DriveBudget(**columns), self._by_row(made), self._by_row(doubt))

    def _by_row(self, values: Any) -> Any:
        """(S, M, F, N) as (R, S, M, F, P)."""
        split = values.reshape(*values.shape[:-1], -1, self.points)
        return np.ascontiguousarray(np.moveaxis(split, -2, 0))

    def _strategy(
        self,
        torque: FloatArray,
        omega_m: FloatArray,
        strategy: Strategy,
        modulations: Sequence[ModulationName],
    ) -> tuple[DriveBudget, BoolArray, BoolArray]:
        """Budget (M, F, N) of one strategy, reached and doubtful (M, F or 1, N)."""
        machines = self.drives.machines.repeated(self.points)
        frequency = self.frequencies
        known: dict[bytes, AxisCurrents] = {}  # modulators of one linear range share them

        def within(v_max: FloatArray) -> AxisCurrents:
            key = v_max.tobytes()
            if key not in known:
                known[key] = axis_currents(machines, strategy, torque, omega_m, v_max, self.options)
            return known[key]

        found = [[within(v_max) for v_max in self._limits(name, frequency)] for name in modulations]
        reached, doubtful = (
            np.array([[getattr(one, part) for one in row] for row in found])
            for part in ("reached", "doubtful")
        )
        if self._shared(found):
            budget = self._budget(
                machines, [row[0] for row in found], omega_m, modulations, frequency
            )
            return budget, reached, doubtful
        # Dead time leaves each carrier its own voltage, and the field is weakened for it.
        each = [
            self._budget(
                machines, [row[k] for row in found], omega_m, modulations, frequency[k : k + 1]
            )
            for k in range(frequency.shape[0])
        ]
        columns: dict[str, Any] = {
            part.name: np.concatenate([getattr(one, part.name) for one in each], axis=1)
            for part in fields(DriveBudget)
        }
        return DriveBudget(**columns), reached, doubtful

    def _limits(self, name: ModulationName, frequency: FloatArray) -> list[FloatArray]:
        """Largest phase amplitudes (N,) in V: one for all carriers, or one for each."""
        v_dc, dead_time = (
            np.repeat(column, self.points) for column in (self.drives.v_dc, self.drives.dead_time)
        )
        left = dead_time_factor(name, dead_time, frequency)
        limit = fundamental_share(self.drives.inverter, name) * v_dc * left * (1.0 - self.margin)
        return [limit[0]] if np.all(dead_time == 0.0) else list(limit)

    @staticmethod
    def _shared(found: Sequence[Sequence[AxisCurrents]]) -> bool:
        """Whether all carriers have the same currents."""
        return all(
            np.array_equal(one.i_d, row[0].i_d, equal_nan=True)
            and np.array_equal(one.i_q, row[0].i_q, equal_nan=True)
            for row in found
            for one in row[1:]
        )

    def _budget(
        self,
        machines: MachineBatch,
        currents: Sequence[AxisCurrents],
        omega_m: FloatArray,
        modulations: Sequence[ModulationName],
        frequency: FloatArray,
    ) -> DriveBudget:
        """Budget (M, F, N) with currents of each modulator."""
        drives, inverter = self.drives, self.drives.inverter
        dead_time = np.repeat(drives.dead_time, self.points)
        first, v_dc, factors = float(drives.v_dc[0]), drives.v_dc, None
        if np.all(v_dc == first):
            inverter = replace(inverter, v_dc=first)
        else:
            every = _factors(drives)
            assert every is not None
            factors = np.repeat(every, self.points, axis=1)
        i_d, i_q = (np.stack([getattr(one, axis) for one in currents]) for axis in ("i_d", "i_q"))
        return supplied_budget(
            machines,
            inverter,
            Supply(
                first if factors is None else np.repeat(v_dc, self.points),
                dead_time,
                frequency,
                factors,
            ),
            i_d,
            i_q,
            omega_m,
            modulations,
            options=self.options,
            tables=known_bridge(inverter),
        )
