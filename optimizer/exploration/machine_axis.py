"""Budgets of many drives with linear machines at once: a machine, a link voltage, a dead time and a
carrier for each, the device and all the rest in common.

The budgets are those of `dqforge.optimizer.losses.phase_comparison.compare_points`, a row per
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
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import Machine, copper_loss
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.bridge_tables import energy_factors
from dqforge.machines.losses.machine_budget import (
    bridge_load,
    junction_temperature,
    machine_budget,
    required_device,
    resistance_factor,
    thermal_gain,
)
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import ModulationName, Strategy
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import amplitude_fits, amplitude_limit, fundamental_share
from dqforge.optimizer.exploration.batch_currents import largest_torques, strategy_currents
from dqforge.optimizer.losses.drive_budget import (
    BudgetOptions,
    DriveBudget,
    Supply,
    known_bridge,
    stacked_budgets,
    supplied_budget,
)
from dqforge.optimizer.losses.drive_comparison import AIM, EXCESS, ROUNDS

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


# Currents of many linear machines at points of torque and speed, within current and voltage.
#
# Where neither limits, the currents are those of a formula. Along the curve of one torque the
# squared voltage of a machine with constant inductances is convex in i_d::
#
#     |v|^2 = R^2 (i_d^2 + i_q^2) + omega^2 (psi_d^2 + psi_q^2) + 2 R omega T/k,   k = 3/2 p,
#     i_q = T / (k (psi - (l_q - l_d) i_d))
#
# since i_q^2 is. From the least-current point, where the voltage is too high, Newton's method
# therefore runs to the crossing with the limit of least current without ever passing it, or finds
# the curve level above the limit: then the voltage cannot be kept, whatever the current.

_STEPS = 60
_STILL = 1e-13  # Newton step over the size of the current after which a crossing stands still.
_ROUNDING = 1e-9  # Relative slack within which a limit counts as kept, as of single points.
_DOUBT = 1e-6  # Relative distance from a limit within which a single machine decides.


@dataclass(frozen=True, slots=True, eq=False)
class AxisCurrents:
    """Currents of N points, arrays of shape (N,).

    Args:
        i_d, i_q: In A, NaN where the torque is out of reach.
        reached: Whether they make the torque within the limits.
        doubtful: True where a limit is so near that only the solver of single machines says on
            which side the point lies, or finds it.
    """

    i_d: FloatArray
    i_q: FloatArray
    reached: BoolArray
    doubtful: BoolArray


def axis_currents(
    machines: MachineBatch,
    strategy: Strategy,
    torque: FloatArray,
    omega_m: FloatArray,
    v_max: FloatArray,
    options: BudgetOptions,
) -> AxisCurrents:
    """Currents of one strategy at N points, a machine for each, as
    `dqforge.optimizer.losses.drive_comparison.strategy_currents` of single machines.

    Args:
        machines: A machine per point, its current limit in ``i_max``.
        strategy: ``mtpa``, which weakens the field, or ``id0``, which does not look at the voltage.
        torque, omega_m: In N m and rad/s, any sign, shape (N,).
        v_max: Largest phase amplitudes in V, shape (N,).
        options: What else drops voltage; the field is weakened for it, too.
    """
    if strategy == "id0":
        return _without_weakening(machines, torque)
    found = _within(machines, torque, omega_m, v_max)
    i_d, i_q = found.i_d.copy(), found.i_q.copy()
    reached, doubtful = found.reached.copy(), found.doubtful.copy()
    volts = v_max.copy()
    for _ in range(ROUNDS):
        made = machine_budget(
            machines, i_d, i_q, omega_m, loss=options.machine_loss, heat=options.winding
        )
        amplitude = np.hypot(made.v_d, made.v_q)
        with np.errstate(invalid="ignore"):
            high = made.steady & (amplitude > v_max * (1.0 + EXCESS))
        (over,) = np.nonzero(high & reached)
        if not over.size:
            break
        volts[over] *= v_max[over] / amplitude[over] * (1.0 - AIM)
        again = _within(machines.taken(over), torque[over], omega_m[over], volts[over])
        i_d[over], i_q[over] = again.i_d, again.i_q
        reached[over], doubtful[over] = again.reached, doubtful[over] | again.doubtful
    return AxisCurrents(i_d, i_q, reached, doubtful)


def _without_weakening(machines: MachineBatch, torque: FloatArray) -> AxisCurrents:
    """i_d = 0, up to the current limit; a machine without magnet makes no torque."""
    magnet = machines.psi_pm > 0.0
    most = machines.torque(np.zeros(torque.shape), machines.i_max)
    reached = np.where(magnet, np.abs(torque) <= most * (1.0 + 1e-12), torque == 0.0)
    i_q = np.where(magnet, torque / np.where(magnet, machines.torque_per_ampere, 1.0), 0.0)
    return AxisCurrents(
        np.where(reached, 0.0, np.nan),
        np.where(reached, i_q, np.nan),
        reached,
        np.zeros(torque.shape, dtype=np.bool_),
    )


def _within(
    machines: MachineBatch, torque: FloatArray, omega_m: FloatArray, v_max: FloatArray
) -> AxisCurrents:
    """Least current for a torque within the limits of current and voltage."""
    i_d, i_q = strategy_currents(machines, "mtpa", torque)
    omega_e = machines.pole_pairs * omega_m
    most = largest_torques(machines, "mtpa")
    size = np.abs(torque)
    with np.errstate(invalid="ignore"):
        reached = size <= most * (1.0 + _ROUNDING)
        doubtful = np.abs(size / most - 1.0) < _DOUBT
    v_d, v_q = machines.voltage(i_d, i_q, omega_e)
    # An amplitude that rounding alone lifts over the limit leads to the same currents.
    (rows,) = np.nonzero(reached & (v_d * v_d + v_q * v_q > v_max * v_max))
    if rows.size:
        some = machines.taken(rows)
        weak = _weakened(some, i_d[rows], torque[rows], omega_e[rows], v_max[rows])
        i_d[rows], i_q[rows] = weak.i_d, weak.i_q
        reached[rows], doubtful[rows] = weak.reached, doubtful[rows] | weak.doubtful
    return AxisCurrents(
        np.where(reached, i_d, np.nan), np.where(reached, i_q, np.nan), reached, doubtful
    )


def _weakened(
    machines: MachineBatch,
    i_d: FloatArray,
    torque: FloatArray,
    omega_e: FloatArray,
    v_max: FloatArray,
) -> AxisCurrents:
    """Crossing of the torque's curve with the voltage limit from the least-current point on."""
    along = torque / (1.5 * machines.pole_pairs)
    limit = v_max * v_max
    x, moves = i_d.copy(), np.ones(i_d.shape, dtype=np.bool_)
    level = np.zeros(i_d.shape, dtype=np.bool_)
    excess = np.zeros(i_d.shape)
    for _ in range(_STEPS):
        square, slope = _square_and_slope(machines, x, along, omega_e)
        gap = square - limit
        excess = np.where(moves, gap / limit, excess)
        level |= moves & (slope <= 0.0) & (gap > 0.0)
        moves = moves & ~level
        step = np.where(moves, gap / np.where(slope > 0.0, slope, 1.0), 0.0)
        x = x - step
        moves = moves & (np.abs(step) > _STILL * (np.abs(x) + 1e-3 * machines.i_max))
        if not np.any(moves):
            break
    i_q = along / (machines.psi_pm - machines.saliency * x)
    room = np.hypot(x, i_q) / machines.i_max
    reached = ~level & ~moves & (room <= 1.0 + _ROUNDING)
    doubtful = (level & (excess < _DOUBT)) | moves | (~level & (np.abs(room - 1.0) < _DOUBT))
    return AxisCurrents(x, i_q, reached, doubtful)


def _square_and_slope(
    machines: MachineBatch, i_d: FloatArray, along: FloatArray, omega_e: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """|v|^2 in V^2 along the curve of one torque and its derivative by i_d."""
    flux = machines.psi_pm - machines.saliency * i_d
    i_q = along / flux
    bend = machines.saliency * i_q / flux
    v_d, v_q = machines.voltage(i_d, i_q, omega_e)
    slope_d = machines.r_s - omega_e * machines.l_q * bend
    slope_q = machines.r_s * bend + omega_e * machines.l_d
    return v_d * v_d + v_q * v_q, 2.0 * (v_d * slope_d + v_q * slope_q)


# Switching energies of a device from the total loss that was measured at one point.
#
# Source: paper 000, section 3 and Table 4, with the corrections on docs/methods/loss-budget.md.


def calibrate_switching(
    total_loss: float,
    machine: Machine,
    inverter: Inverter,
    i_d: float,
    i_q: float,
    omega_m: float,
    modulation: ModulationName,
) -> SwitchDevice:
    """Scale the switching energies of a device so that the total loss at one measured point is met.

    Args:
        total_loss: Measured copper plus inverter loss in W at the point.
        machine, inverter: The drive; the inverter with the data of its device.
        i_d, i_q, omega_m, modulation: The measured point: currents in A (peak), mechanical speed in
            rad/s, and its modulator.

    Returns:
        The device with all three switching energies multiplied by one factor.

    Raises:
        InputError: Where the measurement contradicts the other data.
        NoSolutionError: At thermal runaway, whatever the switching energies.
    """
    device = required_device(inverter)
    currents = np.array([i_d], dtype=np.float64), np.array([i_q], dtype=np.float64)
    omega = np.array([omega_m], dtype=np.float64)
    voltage = machine.voltage(*currents, machine.pole_pairs * omega)
    _check_measured_voltage(inverter, float(np.hypot(*voltage)[0]), modulation)
    load = bridge_load(inverter, modulation, *voltage, *currents)
    _refuse_runaway(machine, omega, *currents, thermal_gain(inverter, load))
    copper = copper_loss(machine.r_s, *currents)
    temperature = junction_temperature(inverter, total_loss - copper)
    conduction = load.threshold + load.resistive * resistance_factor(device, temperature)
    return _scaled_device(
        device, total_loss, float(copper[0]), float(conduction[0]), float(load.switching[0])
    )


def _check_measured_voltage(
    inverter: Inverter, amplitude: float, modulation: ModulationName
) -> None:
    if not amplitude_fits(inverter, modulation, amplitude):
        raise InputError(
            f"calibration: the measured point needs a phase voltage of {amplitude:.4g} V (peak), "
            f"but {modulation} makes at most {amplitude_limit(inverter, modulation):.4g} V from "
            f"{inverter.v_dc:.4g} V"
        )


def _scaled_device(
    device: SwitchDevice, total_loss: float, copper: float, conduction: float, switching: float
) -> SwitchDevice:
    """Scale the energies of the device so that its switching loss, now `switching`,
    makes up the total; all in W.
    """
    remainder = total_loss - copper - conduction
    if remainder < 0.0:
        raise InputError(
            f"calibration: the measured total loss of {total_loss:.4g} W is below the copper loss "
            f"of {copper:.4g} W plus the conduction loss of {conduction:.4g} W; check R_s, "
            "R_DS(on) and the currents"
        )
    if switching <= 0.0:
        raise InputError(
            "calibration: the device has no switching loss at the measured point, so that its "
            "energies cannot be scaled; give switching energies above zero, and a point with "
            "current"
        )
    factor = remainder / switching
    return replace(
        device,
        turn_on_energy=device.turn_on_energy * factor,
        turn_off_energy=device.turn_off_energy * factor,
        reverse_recovery_energy=device.reverse_recovery_energy * factor,
    )


def _refuse_runaway(
    machine: Machine, omega_m: FloatArray, i_d: FloatArray, i_q: FloatArray, gain: FloatArray
) -> None:
    if not np.all(np.isfinite(gain) & np.isfinite(omega_m)):
        raise InputError("calibration: currents and speeds must be finite numbers")
    if np.all(gain < 1.0):
        return
    worst = np.unravel_index(np.argmax(gain), gain.shape)
    raise NoSolutionError(
        f"thermal runaway at {machine.torque(i_d, i_q)[worst]:.4g} N m and {omega_m[worst]:.4g} "
        f"rad/s ({np.hypot(i_d, i_q)[worst]:.4g} A): each kelvin at the junction adds losses that "
        f"heat it by {gain[worst]:.3g} K more, so that no temperature is steady "
        f"({np.count_nonzero(gain >= 1.0)} of {gain.size} points); lower the current, the thermal "
        "resistance or the on resistance"
    )
