"""Which keys of a study change numbers of a drive or factors of its flux map and nothing else, and
by what factor.

Found by trial, not by a list of what each key means: designs are made at the corners of what the
keys may be, and compared. A key whose corners differ in anything but the numbers that the batch
path knows, or not in proportion, varies design by design. Checks of a design are monotonic in each
of these numbers, so that what holds at all corners holds between them.
"""

from __future__ import annotations

import hashlib
import itertools
import pickle
from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import field, fields, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ControlSettings, FitSettings, LoadPoint, LossSettings
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine, ScaledMachines
from dqforge.machines.dq_machines.machine_batch import MachineBatch, faults
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import DqforgeError
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.batch_currents import (
    currents_of_size,
    fit_references,
    largest_torques,
    why_not_in_batch,
)
from dqforge.optimizer.exploration.machine_axis import (
    STRATEGIES,
    AxisBudgets,
    budgets_over_machines,
    drive_axis,
)
from dqforge.optimizer.exploration.row_outputs import (
    FIT_PATHS,
    LOOP_QUANTITIES,
    Asked,
    LossRows,
    LossTable,
    Step,
    loss_columns,
    mapped,
)
from dqforge.optimizer.exploration.sensitivities import scaled_loci
from dqforge.optimizer.loops.loop_axes import (
    BY_SEARCH,
    CurrentLoopAxis,
    tuned_current_loops,
    tuned_speed_loops,
)
from dqforge.optimizer.loops.observed_margins import CurrentMargins
from dqforge.optimizer.loops.pi_methods import BatchMargins, is_vendor
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.losses.phase_comparison import LossComparison

MACHINE_FIELDS = (
    "r_s",
    "l_d",
    "l_q",
    "psi_pm",
    "i_max",
    "inertia",
    "friction",
    "omega_m_max",
)

SATURATED_FIELDS = ("r_s", "i_max", "inertia", "friction", "omega_m_max")
INVERTER_FIELDS = ("v_dc", "f_sw", "i_max")
MOST_KEYS = 6  # Keys whose corners are all tried; with more the rows are made one by one.

# Parts of a design that tell of it and that no step looks at.
_RECORDS = ("values", "assumptions", "digest", "given", "places", "flux_evidence", "name", "about")
_PROPORTIONAL = 1e-12
Corner = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Effect:
    """What a key changes: fields as ``machine.r_s`` or ``inverter.v_dc``, by their factor over the
    key's SI value. Factors of a flux map, as ``machine.magnet``, are 1 in the machine of the base.
    """

    factors: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Variation:
    """Keys that vary numbers of a drive, or factors of its flux map, alone.

    Args:
        base: The design with every key at its lower end.
        corners: Designs by key with that key alone at its upper end.
        effects: What each key changes.
        ends: Least and largest value of each key in SI units.
    """

    base: Design
    corners: Mapping[str, Design]
    effects: Mapping[str, Effect]
    ends: Mapping[str, tuple[float, float]]

    def columns(self, numbers: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        """Values of the changed fields by their names, arrays of shape (N,).

        Args:
            numbers: Values of the keys in SI units, shape (N,).
        """
        return {
            name: factor * numbers[key]
            for key, effect in self.effects.items()
            for name, factor in effect.factors
        }

    def between(self, share: FloatArray) -> dict[str, FloatArray]:
        """Values of the changed fields on the way from the lower to the upper ends of all keys.

        Args:
            share: Shares of the way, shape (N,).
        """
        return self.columns(
            {key: low + share * (high - low) for key, (low, high) in self.ends.items()}
        )

    def keys_of(self, step_key: Callable[[Design], Hashable]) -> tuple[str, ...]:
        """Keys that a step depends on.

        Args:
            step_key: What the step of a design depends on.
        """
        plain = step_key(self.base)
        return tuple(key for key, made in self.corners.items() if step_key(made) != plain)


def variation(
    make: Callable[[Corner], Design], bounds: Mapping[str, tuple[float, float]]
) -> Variation | None:
    """How keys change a design between bounds.

    Args:
        make: The design with values of the keys in SI units.
        bounds: Least and largest value of each key in SI units.

    Returns:
        None where a corner is refused, or a key changes more than numbers of a drive or one factor
        of its flux map.
    """
    if len(bounds) > MOST_KEYS:
        return None
    try:
        corners = {pick: make(_corner(bounds, pick)) for pick in _picks(len(bounds))}
    except DqforgeError:
        return None
    base = corners[(0,) * len(bounds)]
    known = isinstance(base.machine, LinearMachine | SaturatedMachine)
    if not known or base.phase_machine is not None:
        return None
    ends = {key: corners[_single(len(bounds), place)] for place, key in enumerate(bounds)}
    effects = {}
    for key, made in ends.items():
        effect = _effect(base, made, bounds[key])
        if effect is None:
            return None
        effects[key] = effect
    if len({name for e in effects.values() for name, _ in e.factors}) != sum(
        len(e.factors) for e in effects.values()
    ):
        return None
    return Variation(base, ends, effects, dict(bounds))


def batch_keys(
    make: Callable[[Corner], Design], bounds: Mapping[str, tuple[float, float]]
) -> tuple[str, ...]:
    """Keys that change numbers of a drive, or factors of its flux map, alone, each by itself.

    Args:
        make: The design with values of some keys in SI units, the others as the study's first row.
        bounds: Least and largest value of each key in SI units.
    """
    return tuple(key for key, ends in bounds.items() if variation(make, {key: ends}) is not None)


def _picks(count: int) -> Sequence[tuple[int, ...]]:
    return list(itertools.product((0, 1), repeat=count))


def _single(count: int, place: int) -> tuple[int, ...]:
    return tuple(int(other == place) for other in range(count))


def _corner(bounds: Mapping[str, tuple[float, float]], pick: tuple[int, ...]) -> Corner:
    return {key: ends[end] for (key, ends), end in zip(bounds.items(), pick, strict=True)}


def _effect(base: Design, made: Design, ends: tuple[float, float]) -> Effect | None:
    """Fields that differ and their factors, None where anything else differs, too."""
    low, high = ends
    factors: list[tuple[str, float]] = []
    scaled = _scale(base, made, ends)
    if scaled is not None:
        factors.append((f"machine.{scaled}", 1.0 / low))
        made = _with_map_of(made, base)
    changed = _changed(base, made)
    if changed is None:
        return None
    for name in changed:
        first, last = _value(base, name), _value(made, name)
        if first is None or last is None or high == 0.0:
            return None
        if abs(last * low - first * high) > _PROPORTIONAL * abs(first * high):
            return None
        factors.append((name, last / high))
    return Effect(tuple(factors))


def _scale(base: Design, made: Design, ends: tuple[float, float]) -> str | None:
    """The factor of the flux map that differs, in proportion to the key; None where none does."""
    first, last = base.machine, made.machine
    if not isinstance(first, SaturatedMachine) or not isinstance(last, SaturatedMachine):
        return None
    low, high = ends
    if not low > 0.0 or _same(first.flux_map, last.flux_map):
        return None
    return scale_between(first, last, high / low)


def _with_map_of(design: Design, other: Design) -> Design:
    """The same with the flux map of another design."""
    machine, donor = design.machine, other.machine
    assert isinstance(machine, SaturatedMachine)
    assert isinstance(donor, SaturatedMachine)
    return replace(design, machine=replace(machine, flux_map=donor.flux_map))


def _changed(base: Design, made: Design) -> list[str] | None:
    """Numbers of machine and inverter that differ; None where more does."""
    found = []
    for part in fields(Design):
        first, last = getattr(base, part.name), getattr(made, part.name)
        if part.name in _RECORDS or _same(first, last):
            continue
        if part.name == "machine":
            names = [n for n in _machine_fields(first) if getattr(first, n) != getattr(last, n)]
            last = replace(last, **{name: getattr(first, name) for name in names})
        elif part.name == "inverter":
            names = [n for n in INVERTER_FIELDS if getattr(first, n) != getattr(last, n)]
            last = replace(last, **{name: getattr(first, name) for name in names})
        elif part.name == "control":  # bases of per-unit gains, which no output knows
            names, last = [], replace(last, bases=first.bases)
        elif part.name == "fit":
            names, first, last = [], used_settings(first), used_settings(last)
        else:
            return None
        if not _same(first, last):
            return None
        found += [f"{part.name}.{name}" for name in names]
    return found


def _machine_fields(machine: Machine) -> Sequence[str]:
    """Numbers of a machine that may vary."""
    return MACHINE_FIELDS if isinstance(machine, LinearMachine) else SATURATED_FIELDS


def used_settings(settings: FitSettings) -> FitSettings:
    """Settings of a fit without the full scale of fixed point where it is in floating point.

    Args:
        settings: The settings.
    """
    if settings.format == "float32" and settings.budget is None:
        return replace(settings, full_scale=None)
    return settings


def _same(first: object, last: object) -> bool:
    if first is last:
        return True
    return type(first) is type(last) and key_of(first) == key_of(last)


def _value(design: Design, name: str) -> float | None:
    part, _, own = name.partition(".")
    value = getattr(getattr(design, part), own)
    return None if value is None else float(value)


# Steps of many machines at once: largest torque, fit, loops, losses; of machines that saturate the
# largest torque.
#
# Each takes what varies as columns and says which rows it answers; the others, whose message or
# field weakening only the single path knows, are left to that.

# Errors of a fit that columns have; what a form costs in copper only the single path knows.
BATCH_ERRORS = ("i_d", "i_q", "torque", "torque_relative")
Column = FloatArray | NDArray[np.int32]  # Numbers, or places in the words of a choice, of N rows.


@dataclass(frozen=True, slots=True, eq=False)
class BatchRows:
    """N variants of a drive with constant inductances, or with factors of one flux map.

    Args:
        base: The design, for everything that does not vary.
        columns: What varies by the names ``machine.<field>`` and ``inverter.<field>``, arrays of
            shape (N,).
        asked: What the study asks for.
    """

    base: Design
    columns: Mapping[str, FloatArray]
    asked: Asked

    @property
    def count(self) -> int:
        """Number of rows N."""
        return int(next(iter(self.columns.values())).size)

    def of(self, section: str) -> dict[str, FloatArray]:
        """Columns of machine or inverter by the names of their fields."""
        start = f"{section}."
        return {
            name.removeprefix(start): values
            for name, values in self.columns.items()
            if name.startswith(start)
        }

    @property
    def sound(self) -> BoolArray:
        """Rows whose values a machine may have, (N,)."""
        wrong = faults(self.of("machine")).values()
        return np.asarray(~np.any([*wrong, np.zeros(self.count, np.bool_)], axis=0))

    @property
    def saturates(self) -> bool:
        """Whether the machine has a flux map."""
        return isinstance(self.base.machine, SaturatedMachine)

    def scaled_machines(self, fine: BoolArray) -> ScaledMachines:
        """The machines of some rows over the flux map of the base, with the current limit of drive
        and inverter together.

        Args:
            fine: Which rows, (N,).
        """
        machine = self.base.machine
        assert isinstance(machine, SaturatedMachine)
        columns = {
            name: values[fine]
            for name, values in self.of("machine").items()
            if name in SCALED_FIELDS
        }
        limit = self.of("inverter").get("i_max", self.base.inverter.i_max)
        if limit is not None:
            own = columns.get("i_max", np.full(int(np.sum(fine)), machine.i_max))
            limits = np.broadcast_to(limit, (self.count,))[fine]
            columns["i_max"] = np.minimum(own, limits)
        return ScaledMachines.varied(machine, int(np.sum(fine)), columns)

    def _linear(self) -> LinearMachine:
        assert isinstance(self.base.machine, LinearMachine)
        return self.base.machine

    def drawn_machines(self) -> tuple[MachineBatch | ScaledMachines, BoolArray]:
        """The machines of the rows that are machines at all, and which rows these are, (N,)."""
        fine = self.sound
        if self.saturates:
            return self.scaled_machines(fine), fine
        columns = {name: values[fine] for name, values in self.of("machine").items()}
        return MachineBatch.varied(self._linear(), int(np.sum(fine)), columns), fine

    def machines(self) -> tuple[MachineBatch, BoolArray]:
        """The machines with the current limit of drive and inverter together, and which of them
        are machines at all, (N,): the others stand there as the base.
        """
        machine, fine = self._linear(), self.sound
        sound = {
            name: np.where(fine, values, getattr(machine, name))
            for name, values in self.of("machine").items()
        }
        sound["i_max"] = (
            np.full(self.count, machine.i_max) if "i_max" not in sound else sound["i_max"]
        )
        limit = self.of("inverter").get("i_max", self.base.inverter.i_max)
        if limit is not None:
            sound["i_max"] = np.minimum(sound["i_max"], limit)
        return MachineBatch.varied(machine, self.count, sound), fine


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """What a step found.

    Args:
        columns: By name of the output, shape (N,).
        done: Rows that are answered, (N,).
        obstacles: Of rows that break a limit of the drive: which one.
    """

    columns: Mapping[str, Column]
    done: BoolArray
    obstacles: Mapping[int, str] = field(default_factory=dict)

    def taken(self) -> dict[str, Column]:
        """The columns of the rows that are answered."""
        return {name: values[self.done] for name, values in self.columns.items()}


def batch_limits(rows: BatchRows) -> Filled | None:
    """Largest torque and its currents; None where a voltage limits them.

    Args:
        rows: The variants.
    """
    if rows.base.operation.omega_m is not None:
        return None
    if rows.saturates:
        return _scaled_limits(rows)
    machines, fine = rows.machines()
    strategy = rows.base.operation.strategy
    most = largest_torques(machines, strategy)
    i_d, i_q = currents_of_size(machines, strategy, machines.i_max)
    columns: dict[str, Column] = {
        "reference.torque_max": most,
        "reference.i_d": i_d,
        "reference.i_q": i_q,
    }
    return Filled(columns, fine & np.isfinite(most))


def _scaled_limits(rows: BatchRows) -> Filled | None:
    """The ends of the loci of machines over one flux map; None where these are no optima."""
    if rows.base.operation.strategy != "mtpa":
        return None
    fine = rows.sound
    loci = scaled_loci(rows.scaled_machines(fine))
    names = ("reference.torque_max", "reference.i_d", "reference.i_q")
    columns: dict[str, Column] = {}
    for name, values in zip(names, (loci.torque, loci.i_d, loci.i_q), strict=True):
        whole = np.full(rows.count, np.nan)
        whole[fine] = values[-1]
        columns[name] = whole
    done = fine.copy()
    done[fine] = loci.solved
    return Filled(columns, done)


def batch_fits(rows: BatchRows) -> Filled | None:
    """Errors of the current references; None where columns do not have the form or method.

    Args:
        rows: The variants.
    """
    base = rows.base
    asked = {output.quantity for output in rows.asked.of_step("fit")}
    if (
        rows.saturates
        or base.operation.omega_m is not None
        or why_not_in_batch(base.fit) is not None
    ):
        return None
    if not asked <= {*BATCH_ERRORS, "path"}:
        return None
    machines, fine = rows.machines()
    found = fit_references(machines, base.fit, base.operation.strategy)
    columns: dict[str, Column] = {
        f"fit.error.{name}": getattr(found.errors, name) for name in BATCH_ERRORS
    }
    columns["fit.path"] = np.full(rows.count, FIT_PATHS.index("batch"), dtype=np.int32)
    return Filled(columns, fine & found.solved)


def batch_current_loops(rows: BatchRows) -> Filled | None:
    """Gains and margins of both current loops; None where these are searched for, or judged over
    tolerances.

    Args:
        rows: The variants.
    """
    control = rows.base.control
    method = control.current_loop.method
    if rows.saturates or method == BY_SEARCH or is_vendor(method) or control.tolerances is not None:
        return None
    machines, fine = rows.machines()
    found = _current_loops(machines, control)
    columns: dict[str, Column] = {}
    for name, loop in found.items():
        columns |= _loop_columns(name, loop.kp, loop.ki, loop.margins, loop.margins.stable)
    return Filled(_with_least(columns), fine & found["i_d"].holds & found["i_q"].holds)


def batch_all_loops(rows: BatchRows) -> Filled | None:
    """Gains and margins of all loops; None where the speed loop runs on an observer or on edges of
    an encoder, or where more is asked of the loops than these.

    Args:
        rows: The variants.
    """
    control = rows.base.control
    settings = control.speed_loop
    more = (control.observer, control.start_up, control.firmware, control.tolerances)
    if any(each is not None for each in more) or control.references.any:
        return None
    currents = batch_current_loops(rows)
    if settings is None or currents is None or control.current_loop.schedule:
        return currents if not control.current_loop.schedule else None
    if settings.method == BY_SEARCH or settings.measurement is not None:
        return None
    machines, _ = rows.machines()
    q_axis = _current_loops(machines, control)["i_q"]
    found = tuned_speed_loops(q_axis, machines.inertia, machines.friction, settings)
    own = _loop_columns("speed", found.kp, found.ki, found.margins, found.stable)
    return Filled(_with_least({**currents.columns, **own}), currents.done & found.holds)


def _current_loops(machines: MachineBatch, control: ControlSettings) -> dict[str, CurrentLoopAxis]:
    return {
        "i_d": tuned_current_loops(machines.r_s, machines.l_d, control.t_s, control.current_loop),
        "i_q": tuned_current_loops(machines.r_s, machines.l_q, control.t_s, control.current_loop),
    }


def _loop_columns(
    name: str,
    kp: FloatArray,
    ki: FloatArray,
    margins: CurrentMargins | BatchMargins,
    stable: BoolArray,
) -> dict[str, Column]:
    """Columns of one loop."""
    own: dict[str, FloatArray] = {"kp": kp, "ki": ki, "stable": stable.astype(np.float64)}
    return {
        f"gains.{name}.{quantity}": own[quantity] if quantity in own else getattr(margins, quantity)
        for quantity in LOOP_QUANTITIES
    }


def _with_least(columns: dict[str, Column]) -> dict[str, Column]:
    """The same with the least phase margin of all loops."""
    margins = [values for name, values in columns.items() if name.endswith(".phase_margin")]
    return columns | {"gains.phase_margin": np.min(margins, axis=0)}


def batch_losses(rows: BatchRows) -> Filled | None:
    """Losses at the points; None where their currents are solved for one machine at a time.

    Args:
        rows: The variants.
    """
    base, losses = rows.base, rows.base.losses
    if rows.saturates or losses is None or not losses.points:
        return None
    if base.machine_loss.mapped is not None:  # What is fitted to its map depends on the machine.
        return None
    strategies = [name for name in STRATEGIES if name in losses.strategies]
    if len(strategies) != len(losses.strategies):
        return None
    machines, fine = rows.machines()
    varied = rows.of("inverter")
    found = budgets_over_machines(
        drive_axis(machines, base.inverter, v_dc=varied.get("v_dc"), f_sw=varied.get("f_sw")),
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
        strategies,
        losses.modulations,
        options=budget_options(base),
        margin=base.operation.voltage_margin,
    )
    columns = loss_columns(_loss_rows(losses, strategies, found), rows.asked.of_step("losses"))
    done = fine & found.exact & ~columns.missing
    return Filled(
        columns.columns, done, {at: words for at, words in columns.obstacles.items() if done[at]}
    )


def _loss_rows(
    losses: LossSettings, strategies: Sequence[Strategy], found: AxisBudgets
) -> LossRows:
    """Budgets (N, S, M, 1, P) as rows, in the design's order of strategies."""
    order = [strategies.index(name) for name in losses.strategies if name in STRATEGIES]

    def by_row(values: NDArray[Any]) -> NDArray[Any]:
        return np.moveaxis(values[:, :, :, 0][:, order], 0, -1)

    return LossRows(
        losses.strategies,
        losses.modulations,
        losses.points,
        mapped(found.budget, by_row),
        by_row(found.reached),
        point_weights(losses.points),
    )


# Losses of rows from what was computed for many modulators and frequencies at once, for one
# design, or for many machines.


def point_weights(points: Sequence[LoadPoint]) -> FloatArray:
    """Weights of points with the sum 1.

    Args:
        points: Operating points with their own weights.
    """
    given = np.array([point.weight for point in points])
    return np.asarray(given / np.sum(given))


# Which factor of a flux map a key of a study changes, found by scaling one map to the other.

# Columns of `ScaledMachines` that are factors of the map.
SCALE_FIELDS = ("magnet", "inductance_d", "inductance_q", "current")
SCALED_FIELDS = (*SCALE_FIELDS, "r_s", "i_max")  # All its columns.

# What can be computed for many machines at once.
BATCH_STEPS: Mapping[Step, Callable[[BatchRows], Filled | None]] = {
    "limit": batch_limits,
    "fit": batch_fits,
    "current-loops": batch_current_loops,
    "speed-loop": batch_all_loops,
    "losses": batch_losses,
}


def of_comparison(found: LossComparison) -> LossRows:
    """One row from the comparison of one design.

    Args:
        found: Losses (S, M, P).
    """
    return LossRows(
        found.strategies,
        found.modulations,
        found.points,
        mapped(found.budget, lambda values: values[..., None]),
        found.reached[..., None],
        point_weights(found.points),
    )


def of_table(table: LossTable, losses: LossSettings, places: IndexArray) -> LossRows:
    """N rows that differ in carrier frequency alone.

    Args:
        table: Losses (S, M, F, P) with every modulator and frequency of the study.
        losses: Points, strategies and modulators of the rows.
        places: Places of their frequencies in the table, shape (N,).
    """
    known = table.modulations
    names = np.array([known.index(name) for name in losses.modulations], dtype=np.intp)

    def chosen(values: NDArray[Any]) -> NDArray[Any]:
        picked = values[:, names][:, :, places]
        return np.swapaxes(picked, -1, -2)

    return LossRows(
        losses.strategies,
        losses.modulations,
        losses.points,
        mapped(table.budget, chosen),
        chosen(table.reached),
        point_weights(losses.points),
    )


_EQUAL = 1e-12


def scale_between(first: SaturatedMachine, last: SaturatedMachine, ratio: float) -> str | None:
    """The one factor by which the map of a machine is another's; None where it is none.

    Args:
        first, last: The machines.
        ratio: What the factor would have to be.
    """
    for name in SCALE_FIELDS:
        scaled = ScaledMachines.varied(first, 1, {name: np.array([ratio])}).machine(0)
        if _same_map(scaled.flux_map, last.flux_map):
            return name
    return None


def _same_map(first: FluxMap, last: FluxMap) -> bool:
    """Whether maps are the same but for rounding, with the data that they have."""
    pairs = [(getattr(first, name), getattr(last, name)) for name in _TABLES]
    if first.extrapolate != last.extrapolate or (first.hull is None) != (last.hull is None):
        return False
    if first.hull is not None and last.hull is not None:
        pairs += [
            (first.hull.corner_d, last.hull.corner_d),
            (first.hull.corner_q, last.hull.corner_q),
        ]
    return all(_close(one, other) for one, other in pairs)


_TABLES = ("i_d", "i_q", "psi_d", "psi_q")


def _close(one: FloatArray, other: FloatArray) -> bool:
    if one.shape != other.shape:
        return False
    apart = float(np.max(np.abs(one - other), initial=0.0))
    return apart <= _EQUAL * float(np.max(np.abs(other), initial=0.0))


# Steps of a study that are computed once for all rows with the same inputs, and how many were.
#
# A step is given a design from which everything has been taken that it does not look at, so that
# the key of what it found is exactly what it was made of. What is kept never changes a number: a
# row that finds its step here gets what it would have computed.

Result = TypeVar("Result")
_MOST_KEPT = 512  # Results of one kind of step that are kept, the latest used ones.


@dataclass(slots=True)
class Work:
    """How often each step was computed.

    Args:
        designs: Designs that were read and checked.
        limits: Largest torques, one machine at a time.
        fits: Current references, one machine at a time.
        gain_sets: Sets of gains, one design at a time.
        budget_calls: Loss budgets: calls, whatever the number of points, modulators and frequencies
            of each.
        batches: Calls of the formulas for many machines at once.
    """

    designs: int = 0
    limits: int = 0
    fits: int = 0
    gain_sets: int = 0
    budget_calls: int = 0
    batches: int = 0


def key_of(inputs: object) -> Hashable:
    """What two equal inputs share: themselves where they can be hashed, else a digest.

    Args:
        inputs: Frozen dataclasses and tuples; a flux map in them is known by its numbers.
    """
    return hashlib.sha256(pickle.dumps(inputs, protocol=5)).digest()


@dataclass(slots=True)
class StepCache(Generic[Result]):
    """Results by their inputs; of a refused step the error, without a place in any file."""

    _kept: OrderedDict[Hashable, Result | DqforgeError] = field(default_factory=OrderedDict)

    def of(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """What ``compute`` gives, computed where nothing is kept for the key.

        Raises:
            DqforgeError: As ``compute``; a new one each time, for its place to be found.
        """
        if key not in self._kept:
            self._kept[key] = _outcome(compute)
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        found = self._kept[key]
        if isinstance(found, DqforgeError):
            raise _again(found)
        return found


def _outcome(compute: Callable[[], Result]) -> Result | DqforgeError:
    try:
        return compute()
    except DqforgeError as error:
        return error.with_traceback(None)


def _again(error: DqforgeError) -> DqforgeError:
    """The same refusal, to be given a place of its own."""
    again = type(error)(error.message, source=error.source, line=error.line, column=error.column)
    again.section = error.section
    return again
