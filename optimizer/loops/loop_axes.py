"""Gains and margins of the current loops of many machines at once.

Gains come from the rules of single loops (`dqforge.optimizer.loops.pi_methods`), margins in closed
form. What a single loop would be refused for is only marked here: `tune_current_loop` of that row
says why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import small_delays
from dqforge.optimizer.loops.observed_margins import (
    CurrentMargins,
    current_loops,
    current_margins,
    has_closed_margins,
)
from dqforge.optimizer.loops.pi_methods import (
    BatchMargins,
    DriveVariants,
    batch_margins,
    close_loops,
    current_pi,
    speed_pi,
    speed_plants,
)

Settings = TypeVar("Settings", CurrentLoopSettings, SpeedLoopSettings)
BY_SEARCH = "optimised"  # The method whose gains are searched for, loop by loop.


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoopAxis:
    """Current loops of one axis of N machines, arrays of shape (N,).

    Args:
        r_s, inductance, t_s: Ohm, H and s.
        kp, ki: Gains in V/A and V/(A s), NaN where no rule gives any.
        margins: NaN and not stable there.
        holds: True where a single loop would be accepted; of others `tune_current_loop` says what
            is wrong or, by the method ``optimised``, finds the gains.
    """

    r_s: FloatArray
    inductance: FloatArray
    t_s: FloatArray
    kp: FloatArray
    ki: FloatArray
    margins: CurrentMargins
    holds: BoolArray


def each_of(settings: Settings | Sequence[Settings], count: int) -> Sequence[Settings]:
    """Settings of every row: the ones given, or the one ``count`` times.

    Args:
        settings: One, or one per row.
        count: Number of rows.
    """
    if isinstance(settings, Sequence):
        return settings
    return [settings] * count


def columns(*values: ArrayLike) -> tuple[FloatArray, ...]:
    """Numbers and columns as columns of one length.

    Args:
        values: Numbers, or arrays of shape (N,).
    """
    given = [np.asarray(value, dtype=np.float64) for value in values]
    return tuple(np.atleast_1d(value) for value in np.broadcast_arrays(*given))


def tuned_current_loops(
    r_s: ArrayLike,
    inductance: ArrayLike,
    t_s: ArrayLike,
    settings: CurrentLoopSettings | Sequence[CurrentLoopSettings],
    rule_inductance: ArrayLike | None = None,
) -> CurrentLoopAxis:
    """Gains of N machines by the methods of the settings, with their margins.

    Args:
        r_s, inductance, t_s: Ohm, H and s, numbers or shape (N,).
        settings: Method and its settings, of all rows or of each.
        rule_inductance: Inductance in H that the rule of a vendor takes for this axis
            (`dqforge.optimizer.loops.pi_methods.vendor_inductance`); None for the axis' own.
    """
    taken = inductance if rule_inductance is None else rule_inductance
    count = len(settings) if isinstance(settings, Sequence) else 1
    r_s, inductance, t_s, taken, _ = columns(r_s, inductance, t_s, taken, np.ones(count))
    rules = each_of(settings, r_s.size)
    rows = zip(r_s.tolist(), taken.tolist(), t_s.tolist(), rules, strict=True)
    gains = np.array([_by_rule(*row) for row in rows]).reshape(-1, 2)
    least = np.array([rule.min_phase_margin for rule in rules])
    return given_current_loops(r_s, inductance, t_s, gains[:, 0], gains[:, 1], least=least)


def _by_rule(
    r_s: float, inductance: float, t_s: float, settings: CurrentLoopSettings
) -> tuple[float, float]:
    """Gains of one loop, NaN where its rule gives none."""
    if settings.method == BY_SEARCH:
        return np.nan, np.nan
    try:
        return current_pi(r_s, inductance, t_s, settings)
    except NoSolutionError:
        return np.nan, np.nan


def given_current_loops(
    r_s: ArrayLike,
    inductance: ArrayLike,
    t_s: ArrayLike,
    kp: ArrayLike,
    ki: ArrayLike,
    gain: ArrayLike = 1.0,
    *,
    least: ArrayLike = 0.0,
) -> CurrentLoopAxis:
    """Margins of N machines with given gains, such as those of one header on many machines.

    Args:
        r_s, inductance, t_s: Ohm, H and s, numbers or shape (N,).
        kp, ki: Gains in V/A and V/(A s), numbers or shape (N,).
        gain: Gain of the voltage, a number or shape (N,): link voltage that acts over the one that
            duty cycles are computed with.
        least: Least phase margin in rad that a loop must have to hold.
    """
    r_s, inductance, t_s, kp, ki, gain, least = columns(r_s, inductance, t_s, kp, ki, gain, least)
    proper = has_closed_margins(kp, ki)
    found = current_margins(
        current_loops(
            r_s, inductance, t_s, np.where(proper, kp, 1.0), np.where(proper, ki, 1.0), gain
        )
    )
    margins = _only(found, proper)
    holds = margins.stable & np.isfinite(margins.crossover)
    holds &= np.abs(margins.phase_margin) >= least
    return CurrentLoopAxis(
        r_s,
        inductance,
        t_s,
        np.where(proper, kp, np.nan),
        np.where(proper, ki, np.nan),
        margins,
        holds,
    )


def _only(margins: CurrentMargins, proper: BoolArray) -> CurrentMargins:
    """The same with NaN where there are no gains."""
    numbers = {
        part.name: np.where(proper, getattr(margins, part.name), np.nan)
        for part in fields(CurrentMargins)
        if part.name != "stable"
    }
    return replace(margins, stable=margins.stable & proper, **numbers)


# Gains and margins of the speed loops of many machines at once.
#
# The exact two-rate loops of a batch (`dqforge.optimizer.loops.pi_methods`) have one sampling
# period. Rows with their own are brought to it by taking their period as the unit of time::
#
#     L/t_s, J/t_s, T_f/t_s, ki t_s (of both loops), t_s = 1;   R, B, kp and the back-EMF stay

# Loops on one grid of frequencies: it bounds the memory, and how far their rates spread it.
_AT_ONCE = 250


@dataclass(frozen=True, slots=True, eq=False)
class SpeedDrives:
    """What the speed loops of N machines depend on beside their own gains, arrays of shape (N,).

    Args:
        drive: Windings, inertias and what the controller takes wrongly.
        friction: In N m s/rad.
        t_s: Sampling periods of the current loops in s.
        current_kp, current_ki: Gains of the q axis in V/A and V/(A s).
    """

    drive: DriveVariants
    friction: FloatArray
    t_s: FloatArray
    current_kp: FloatArray
    current_ki: FloatArray

    def taken(self, rows: IndexArray) -> SpeedDrives:
        """Those of some rows."""
        drive = DriveVariants(
            **{part.name: getattr(self.drive, part.name)[rows] for part in fields(DriveVariants)}
        )
        rest = {
            part.name: getattr(self, part.name)[rows]
            for part in fields(SpeedDrives)
            if part.name != "drive"
        }
        return SpeedDrives(drive, **rest)


@dataclass(frozen=True, slots=True, eq=False)
class SpeedLoopAxis:
    """Speed loops of N machines, arrays of shape (N,).

    Args:
        kp, ki: Gains in N m s/rad and N m/rad, NaN where no rule gives any.
        margins: In rad/s, rad, s; NaN where there are no gains.
        stable: Whether every pole lies inside the unit circle.
        holds: True where a single loop would be accepted; of others `tune_speed_loop` says what is
            wrong.
    """

    kp: FloatArray
    ki: FloatArray
    margins: BatchMargins
    stable: BoolArray
    holds: BoolArray


def nominal_drives(q_axis: CurrentLoopAxis, inertia: ArrayLike, friction: ArrayLike) -> SpeedDrives:
    """Drives whose controllers know them, as `tune_speed_loop` takes a single one.

    Args:
        q_axis: Current loops of the q axis.
        inertia, friction: In kg m^2 and N m s/rad, numbers or shape (N,).
    """
    inertia, friction, one = columns(inertia, friction, np.ones(q_axis.t_s.size))
    drive = DriveVariants(q_axis.r_s, q_axis.inductance, inertia, one, one, 0.0 * one)
    return SpeedDrives(drive, friction, q_axis.t_s, q_axis.kp, q_axis.ki)


def drives_of_one_controller(
    machines: MachineBatch,
    nominal: LinearMachine,
    t_s: float,
    current_gains: tuple[float, float],
    gain: ArrayLike = 1.0,
) -> SpeedDrives:
    """Machines that are driven by the controller of another, at no load; without magnets with the
    torque of their saliency.

    Args:
        machines: N machines that are built, with their inertias.
        nominal: The machine that the controller was made for: its magnets make torque out of
            current, and its back-EMF is fed forward.
        t_s: Sampling period of the current loops in s.
        current_gains: kp in V/A and ki in V/(A s) of the q axis.
        gain: Gain of the voltage, a number or shape (N,), as in `given_current_loops`.
    """
    kp, ki, period, factor, _ = columns(*current_gains, t_s, gain, machines.r_s)
    rest = nominal.torque_per_ampere * machines.pole_pairs * (machines.psi_pm - nominal.psi_pm)
    if nominal.psi_pm > 0.0:
        torque_factor = machines.torque_per_ampere / nominal.torque_per_ampere
    else:
        made = machines.pole_pairs * machines.saliency
        torque_factor = made / (nominal.pole_pairs * nominal.saliency)
    drive = DriveVariants(machines.r_s, machines.l_q, machines.inertia, factor, torque_factor, rest)
    return SpeedDrives(drive, machines.friction, period, kp, ki)


def tuned_speed_loops(
    q_axis: CurrentLoopAxis,
    inertia: ArrayLike,
    friction: ArrayLike,
    settings: SpeedLoopSettings | Sequence[SpeedLoopSettings],
) -> SpeedLoopAxis:
    """Gains of N machines by the methods of the settings, with their margins.

    Args:
        q_axis: Current loops of the q axis.
        inertia, friction: In kg m^2 and N m s/rad, numbers or shape (N,).
        settings: Method and its settings, of all rows or of each.
    """
    drives = nominal_drives(q_axis, inertia, friction)
    rules = each_of(settings, drives.t_s.size)
    lag = q_axis.inductance / q_axis.kp
    numbers = (drives.drive.inertia, drives.friction, q_axis.margins.crossover, lag, drives.t_s)
    rows = zip(*(column.tolist() for column in numbers), rules, strict=True)
    gains = np.array([_speed_by_rule(*row) for row in rows]).reshape(-1, 2)
    gains[~q_axis.holds] = np.nan
    return given_speed_loops(drives, gains[:, 0], gains[:, 1], rules)


def _speed_by_rule(
    inertia: float,
    friction: float,
    crossover: float,
    lag: float,
    t_s: float,
    settings: SpeedLoopSettings,
) -> tuple[float, float]:
    """Gains of one loop, NaN where its rule gives none."""
    if settings.method == BY_SEARCH:
        return np.nan, np.nan
    try:
        return speed_pi(inertia, friction, small_delays(crossover, lag, t_s, settings), settings)
    except NoSolutionError:
        return np.nan, np.nan


def given_speed_loops(
    drives: SpeedDrives,
    kp: ArrayLike,
    ki: ArrayLike,
    settings: SpeedLoopSettings | Sequence[SpeedLoopSettings],
) -> SpeedLoopAxis:
    """Margins of N machines with given gains.

    Args:
        drives: What they depend on; one whose inertia is not known (NaN) has no margins.
        kp, ki: Gains in N m s/rad and N m/rad, numbers or shape (N,).
        settings: Ratio of the sampling rates, filter and least phase margin, of all rows or of
            each.
    """
    kp, ki, _ = columns(kp, ki, drives.t_s)
    rules = each_of(settings, kp.size)
    positive = np.stack([kp, ki, drives.current_kp, drives.current_ki, drives.drive.inertia])
    proper = np.asarray(np.all((positive > 0.0) & np.isfinite(positive), axis=0))
    found = np.full((len(fields(BatchMargins)), kp.size), np.nan)
    for ratio, filtered, rows in _groups(rules, proper):
        filter_time = np.array([rules[row].filter_time for row in rows]) if filtered else None
        for start in range(0, rows.size, _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            some = drives.taken(rows[part])
            times = None if filter_time is None else filter_time[part]
            margins = _margins(some, kp[rows[part]], ki[rows[part]], ratio, times)
            found[:, rows[part]] = [getattr(margins, one.name) for one in fields(BatchMargins)]
    margins = BatchMargins(*found)
    with np.errstate(invalid="ignore"):
        stable = np.asarray(margins.radius < 1.0)
    least = np.array([rule.min_phase_margin for rule in rules])
    holds = stable & np.isfinite(margins.crossover) & (np.abs(margins.phase_margin) >= least)
    return SpeedLoopAxis(
        np.where(proper, kp, np.nan), np.where(proper, ki, np.nan), margins, stable, holds
    )


def _groups(
    rules: Sequence[SpeedLoopSettings], proper: BoolArray
) -> list[tuple[int, bool, NDArray[np.intp]]]:
    """Rows with gains whose plants have one order: by ratio, and whether a filter is there."""
    kinds: dict[tuple[int, bool], list[int]] = {}
    for row in np.flatnonzero(proper).tolist():
        kinds.setdefault((rules[row].ratio, rules[row].filter_time > 0.0), []).append(row)
    return [(*kind, np.array(rows, dtype=np.intp)) for kind, rows in kinds.items()]


def _margins(
    drives: SpeedDrives,
    kp: FloatArray,
    ki: FloatArray,
    ratio: int,
    filter_time: FloatArray | None,
) -> BatchMargins:
    """Margins with the sampling period of each row as its unit of time, brought back to s."""
    t_s, drive = drives.t_s, drives.drive
    scaled = DriveVariants(
        drive.r_s,
        drive.l_q / t_s,
        drive.inertia / t_s,
        drive.gain,
        drive.torque_factor,
        drive.back_emf,
    )
    current = (drives.current_kp, drives.current_ki * t_s)
    times = 0.0 if filter_time is None else filter_time / t_s
    plants = speed_plants(scaled, drives.friction, 1.0, current, ratio, times)
    found = batch_margins(close_loops(plants, kp, ki * t_s))
    return BatchMargins(
        radius=found.radius,
        crossover=found.crossover / t_s,
        phase_margin=found.phase_margin,
        gain_margin=found.gain_margin,
        delay_margin=found.delay_margin * t_s,
        max_sensitivity=found.max_sensitivity,
    )
