"""Current-loop gains of a machine that saturates, over the current: from incremental inductances
to float32, as polynomials or as a table.

Along the current reference (MTPA, or i_d = 0) the loops of both axes see the incremental
inductances l_dd and l_qq. The design's method gives gains for each, which become functions of
|i_q|. All margins are those of frozen currents.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, Reals
from dqforge.optimizer.curves.fitting import Curve, SideConditions, fit_curve
from dqforge.optimizer.curves.single_precision import (
    SingleArray,
    between,
    compiled,
    horner,
    in_segments,
    rest,
)
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    BatchMargins,
    batch_margins,
    close_loops,
    current_pi,
    current_plants,
    require_positive,
)
from dqforge.optimizer.loops.robustness import Axis, BoxPoints, DriveBox, LoopRobustness, summarise
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.steps.step_arithmetic import Arithmetic

FloatArray = NDArray[np.float64]
TOLERANCE = 0.02  # Largest relative error of a gain in the firmware.
_SHOWN = 41
_OPTIMISED_POINTS = 7
_OFF_REFERENCE = 25


@dataclass(frozen=True, slots=True)
class AxisSchedule:
    """One axis along the reference, arrays of shape (P,).

    ``inductance`` is the incremental one in H, ``kp`` and ``ki`` in V/A and V/(A s) are those of
    the firmware; ``scheduled`` and ``constant`` the margins with them and with the constant gains.
    ``robust`` is the worst over all currents and the tolerances, None without them.
    ``off_reference`` is the least phase margin in rad and the largest pole modulus with scheduled
    gains over the currents that field weakening may ask for.
    """

    axis: Axis
    inductance: FloatArray
    kp: FloatArray
    ki: FloatArray
    scheduled: BatchMargins
    constant: BatchMargins
    robust: LoopRobustness | None
    off_reference: tuple[float, float]


ScheduleForm = Literal["polynomial", "table"]


class Gains(NamedTuple):
    """Gains of both current controllers, the integral ones times the sampling period, in V/A."""

    kp_d: Reals
    ki_ts_d: Reals
    kp_q: Reals
    ki_ts_q: Reals


GAIN_NAMES = Gains._fields
# Their names in the firmware until they are put through its pointers.
_LOCALS = "proportional_d", "integral_d", "proportional_q", "integral_q"

# Thumb-2 with an FPU: bytes of a multiply and an add with their literal, of what every gain takes,
# and of the rest.
_PER_POWER, _PER_GAIN, _PER_SEGMENT = 16, 12, 12
_TABLE_BASE, _TABLE_PER_GAIN = 44, 28


@dataclass(frozen=True, slots=True)
class GainEvaluator:
    """What the firmware evaluates, by `step`; every number is a float32.

    Args:
        end: Largest |i_q| in A; beyond it the gains stay.
        fallback: Gains by name for a current that is not a number: the constant ones, for the least
            inductance.
        constants: Gains that do not change with the current.
        starts: Of polynomials the first current of each segment, shape (S,).
        polynomials: Ascending coefficients by gain, shape (S, n + 1) each, of |i_q| less the start
            of the segment.
        inverse_step: Of a table the points per ampere.
        tables: Values at even steps from 0 by gain, shape (N,) each.
    """

    end: np.float32
    fallback: Mapping[str, np.float32]
    constants: Mapping[str, np.float32]
    starts: SingleArray = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    polynomials: Mapping[str, SingleArray] = field(default_factory=dict)
    inverse_step: np.float32 = field(default_factory=np.float32)
    tables: Mapping[str, SingleArray] = field(default_factory=dict)

    @property
    def form(self) -> ScheduleForm:
        """Whether the gains that change are polynomials or a table."""
        return "table" if self.tables else "polynomial"

    @property
    def flash(self) -> int:
        """Bytes of code and constants on a Cortex-M4F, estimated."""
        constant = 8 * len(self.constants)
        if self.tables:
            points = sum(table.size for table in self.tables.values())
            return constant + 4 * points + _TABLE_BASE + _TABLE_PER_GAIN * len(self.tables)
        powers = sum(rows.shape[0] * (rows.shape[1] - 1) for rows in self.polynomials.values())
        segments = self.starts.size * (_PER_GAIN * len(self.polynomials) + _PER_SEGMENT)
        return int(constant + _PER_POWER * powers + segments)

    def gains(self, i_q: SingleArray, *, fused: bool = False) -> SingleArray:
        """Gains at float32 currents in A, shape (M,) -> (M, 4) in the order of `GAIN_NAMES`; with
        ``fused`` as of a compiler that contracts products and sums.
        """
        rows = np.stack([*self.tables.values()], axis=1) if self.tables else None
        with np.errstate(invalid="ignore", over="ignore"):
            found = self.step(compiled(fused=fused), i_q, self.end, rows)
        return np.stack([np.broadcast_to(part, i_q.shape) for part in found], axis=1)

    def step(self, o: Arithmetic, i_q: Reals, end: Any, rows: Any) -> Gains:
        """Gains for any current in A, shape (M,); not-a-number gives those that are constant.

        Args:
            o: The arithmetic.
            i_q: In A.
            end: What stands for ``end``.
            rows: What stands for the tables, shape (N, gains of these).
        """
        size = o.let("size", o.choose(i_q < 0.0, -i_q, i_q))
        a = o.let("a", o.choose(size > end, end, size))

        def chosen(found: Mapping[str, Any]) -> tuple[Any, ...]:
            constants = {name: float(value) for name, value in self.constants.items()}
            every = {**constants, **found}
            return tuple(every[name] for name in GAIN_NAMES)

        def within(number: int, x: Reals) -> tuple[Any, ...]:
            polynomials = self.polynomials.items()
            return chosen({name: horner(o, part[number], x) for name, part in polynomials})

        def between_points() -> tuple[Any, ...]:
            place = o.let("place", a * float(self.inverse_step))
            k = o.placed("k", place, len(rows) - 2)
            share, found = rest(o, k, place), dict[str, Any]()
            for column, name in enumerate(self.tables):
                low = o.let(f"low_{column}", o.at(rows, k, column))
                found[name] = between(o, share, low, o.at(rows, k + 1, column))
            return chosen(found)

        def other() -> tuple[Any, ...]:
            o.remark("not-a-number")
            return tuple(float(self.fallback[name]) for name in GAIN_NAMES)

        if self.tables:
            return Gains(*o.cases(_LOCALS, (a >= 0.0, between_points), otherwise=other))
        return Gains(*in_segments(o, _LOCALS, self.starts, a, within, (a >= 0.0, other)))


@dataclass(frozen=True, slots=True)
class ScheduleFit:
    """An evaluator, its largest relative error by gain, and the bytes of the best of each form,
    None if none held.
    """

    evaluator: GainEvaluator
    errors: Mapping[str, float]
    flash: Mapping[ScheduleForm, int | None]


@dataclass(frozen=True, slots=True)
class GainSchedule:
    """Gains over the current: currents of the reference in A, shape (P,), the fit,
    and both axes.
    """

    i_d: FloatArray
    i_q: FloatArray
    fit: ScheduleFit
    axes: tuple[AxisSchedule, AxisSchedule]


@dataclass(frozen=True, slots=True)
class _Path:
    """The reference as a function of i_q: currents in A and incremental inductances in H,
    shape (L,) each.
    """

    i_d: FloatArray
    i_q: FloatArray
    l_d: FloatArray
    l_q: FloatArray


def _path(machine: Machine, i_max: float, strategy: str) -> _Path:
    if strategy == "mtpa":
        locus = mtpa_locus(machine, i_max)
        i_d, i_q = np.append(0.0, locus.i_d), np.append(0.0, locus.i_q)
    else:
        i_q = np.linspace(0.0, i_max, 161)
        i_d = np.zeros_like(i_q)
    if not np.all(np.diff(i_q) > 0.0):
        raise InputError(
            "control.current_loop.schedule: i_q does not rise with the current along the "
            "reference, so that gains cannot follow it; write schedule: false"
        )
    jet = machine.jet(i_d, i_q)
    return _Path(i_d, i_q, jet.l_dd, jet.l_qq)


def _method_gains(
    design: Design, box: DriveBox | None, axis: Axis, inductance: FloatArray
) -> tuple[Curve, Curve]:
    """Gains (kp, ki) of the design's method as functions of the inductance in H."""
    from scipy.interpolate import PchipInterpolator

    r_s, t_s, settings = design.machine.r_s, design.control.t_s, design.control.current_loop
    low, high = float(np.min(inductance)), float(np.max(inductance))
    optimised = settings.method == "optimised"
    widened = (1.0 - 1e-6) * low, (1.0 + 1e-6) * high  # one axis may not saturate
    at = np.geomspace(*widened, _OPTIMISED_POINTS if optimised else 65)

    def gains(value: float) -> tuple[float, float]:
        if not optimised:
            pair = current_pi(r_s, value, t_s, settings)
            require_positive("control.current_loop", axis, settings, pair, r_s / (2.0 * value))
            return pair
        if box is None:
            plants = current_plants(np.array([r_s]), np.array([value]), t_s, np.ones(1))
        else:
            points = box.current_points(axis)
            plants = box.current_loop_plants(axis, points, value).some(np.arange(points.corners))
        scale = pi_scale(value, r_s, CURRENT_DELAY * t_s)
        return optimised_pi(plants, settings.max_sensitivity, scale, "control.current_loop")

    pairs = np.log([gains(float(value)) for value in at])
    curves = [
        PchipInterpolator(np.log(at), pairs[:, column], extrapolate=True) for column in (0, 1)
    ]
    return (lambda x: np.exp(curves[0](np.log(x)))), (lambda x: np.exp(curves[1](np.log(x))))


def _over_current(path: _Path, inductance: FloatArray, gain: Curve, factor: float) -> Curve:
    from scipy.interpolate import PchipInterpolator

    spline = PchipInterpolator(path.i_q, np.log(inductance))
    return lambda i_q: factor * gain(np.exp(spline(np.minimum(i_q, path.i_q[-1]))))


def schedule_gains(
    design: Design, box: DriveBox | None, i_d: LoopGains, i_q: LoopGains
) -> GainSchedule:
    """Gains over |i_q| for the design's method, and what they and the constant
    gains keep at every current.

    Args:
        design: A design whose machine saturates.
        box: Its tolerances, None where it names none.
        i_d, i_q: The constant gains, which the firmware falls back on.

    Raises:
        NoSolutionError: A loop is unstable or misses its phase margin at a current, or the gains
            cannot be followed.
    """
    path, t_s = _path(design.machine, design.i_max, design.strategy), design.control.t_s
    curves: dict[str, Curve] = {}
    of_axes: tuple[tuple[Axis, str, FloatArray], ...] = (
        ("i_d", "d", path.l_d),
        ("i_q", "q", path.l_q),
    )
    for axis, letter, of_axis in of_axes:
        kp, ki = _method_gains(design, box, axis, of_axis)
        curves[f"kp_{letter}"] = _over_current(path, of_axis, kp, 1.0)
        curves[f"ki_ts_{letter}"] = _over_current(path, of_axis, ki, t_s)
    constant = (i_d.kp, i_d.ki_ts, i_q.kp, i_q.ki_ts)
    fit = fit_gains(
        curves, float(path.i_q[-1]), dict(zip(GAIN_NAMES, constant, strict=True)), TOLERANCE
    )
    at = np.linspace(0.0, float(path.i_q[-1]), _SHOWN)
    emitted = fit.evaluator.gains(at.astype(np.float32)).astype(np.float64)
    along_d = np.interp(at, path.i_q, path.i_d)
    jet = design.machine.jet(along_d, at)
    of_d = _axis_schedule(design, box, "i_d", i_d, (at, jet.l_dd), emitted[:, :2], fit, path)
    of_q = _axis_schedule(design, box, "i_q", i_q, (at, jet.l_qq), emitted[:, 2:], fit, path)
    return GainSchedule(along_d, at, fit, (of_d, of_q))


def _axis_schedule(
    design: Design,
    box: DriveBox | None,
    axis: Axis,
    constant: LoopGains,
    along: tuple[FloatArray, FloatArray],
    emitted: FloatArray,
    fit: ScheduleFit,
    path: _Path,
) -> AxisSchedule:
    """Margins of one axis.

    ``along`` are i_q in A and the inductance in H, ``emitted`` kp and ki_ts there.
    """
    r_s, t_s = design.machine.r_s, design.control.t_s
    at, inductance = along
    kp, ki = emitted[:, 0], emitted[:, 1] / t_s
    plants = current_plants(np.full(at.shape, r_s), inductance, t_s, np.ones(at.shape))
    scheduled = batch_margins(close_loops(plants, kp, ki))
    _require(design, axis, scheduled, at)
    return AxisSchedule(
        axis=axis,
        inductance=inductance,
        kp=kp,
        ki=ki,
        scheduled=scheduled,
        constant=batch_margins(close_loops(plants, constant.kp, constant.ki)),
        robust=None if box is None else _robust(design, box, axis, at, inductance, (kp, ki)),
        off_reference=_off_reference(design, axis, fit, path),
    )


def _fault(margins: BatchMargins, required: float) -> tuple[int, str] | None:
    row = int(np.argmax(margins.radius))
    if margins.radius[row] >= 1.0:
        return row, f"is unstable (largest pole modulus {margins.radius[row]:.4g})"
    row = int(np.argmin(np.abs(margins.phase_margin)))
    if abs(margins.phase_margin[row]) < required:
        return row, f"has a phase margin of {np.degrees(abs(margins.phase_margin[row])):.1f} deg"
    return None


def _require(
    design: Design,
    axis: Axis,
    margins: BatchMargins,
    at: FloatArray,
    points: BoxPoints | None = None,
) -> None:
    """Refuse scheduled gains that do not hold.

    Rows of the margins are currents, or currents times corners.
    """
    settings = design.control.current_loop
    found = _fault(margins, settings.min_phase_margin)
    if found is None:
        return
    row, fault = found
    per_current = 1 if points is None else len(points.deviations)
    place = f"i_q = {at[row // per_current]:.4g} A"
    corner = "" if points is None else f" and {points.text(row % per_current)}"
    remedy = "lower max_sensitivity" if settings.method == "optimised" else "ask for a slower loop"
    raise NoSolutionError(
        f"control.current_loop: with scheduled gains the {axis} loop {fault} at {place}{corner}, "
        f"required: {np.degrees(settings.min_phase_margin):.1f} deg; {remedy}, or narrow "
        "control.tolerances"
    )


def _robust(
    design: Design,
    box: DriveBox,
    axis: Axis,
    at: FloatArray,
    inductance: FloatArray,
    gains: tuple[FloatArray, FloatArray],
) -> LoopRobustness:
    """Worst over all currents and the corners of the box."""
    points = box.current_points(axis)
    corners = BoxPoints(
        points.names,
        points.deviations[: points.corners],
        points.corners,
        points.loaded[: points.corners],
    )
    count = points.corners
    repeated = np.repeat(inductance, count) * (
        1.0 + np.tile(corners.of("l_d" if axis == "i_d" else "l_q"), at.size)
    )
    resistance = np.tile(box.resistance(corners), at.size)
    gain = np.tile(1.0 + corners.of("v_dc"), at.size)
    plants = current_plants(resistance, repeated, design.control.t_s, gain)
    kp, ki = (np.repeat(values, count) for values in gains)
    margins = batch_margins(close_loops(plants, kp, ki))
    _require(design, axis, margins, at, corners)
    names = (*corners.names,)
    every = BoxPoints(
        names,
        np.tile(corners.deviations, (at.size, 1)),
        count * at.size,
        np.zeros(count * at.size, np.bool_),
    )
    return summarise(margins, every)


def _off_reference(
    design: Design, axis: Axis, fit: ScheduleFit, path: _Path
) -> tuple[float, float]:
    """Least phase margin and largest pole modulus between the reference and
    the end of field weakening.

    i_d falls from the reference to the current limit, or to zero for a machine without magnets.
    """
    machine, t_s = design.machine, design.control.t_s
    i_q = np.linspace(0.0, float(path.i_q[-1]), _OFF_REFERENCE)
    from_d = np.interp(i_q, path.i_q, path.i_d)
    room = -np.sqrt(np.maximum(design.i_max**2 - i_q**2, 0.0))
    to_d = np.minimum(room, from_d) if machine.psi_pm > 0.0 else np.zeros_like(i_q)
    share = np.linspace(0.0, 1.0, _OFF_REFERENCE)[:, np.newaxis]
    grid_d, grid_q = (from_d + share * (to_d - from_d)).ravel(), np.tile(i_q, _OFF_REFERENCE)
    known = machine.known(grid_d, grid_q)
    grid_d, grid_q = grid_d[known], grid_q[known]
    jet = machine.jet(grid_d, grid_q)
    inductance, column = (jet.l_dd, 0) if axis == "i_d" else (jet.l_qq, 2)
    gains = fit.evaluator.gains(grid_q.astype(np.float32)).astype(np.float64)
    plants = current_plants(
        np.full(grid_q.shape, machine.r_s), inductance, t_s, np.ones(grid_q.shape)
    )
    margins = batch_margins(close_loops(plants, gains[:, column], gains[:, column + 1] / t_s))
    return float(np.min(np.abs(margins.phase_margin))), float(np.max(margins.radius))


# Gains over the current as float32 polynomials or as a table, whichever takes fewer bytes on the
# controller.

_CONSTANT = 1e-6  # relative range below which a gain is one number
_LARGEST_DEGREE = 6
_LARGEST_TABLE = 129
_BREAKPOINTS = np.linspace(0.1, 0.7, 13)
_DENSE = 2001
_FREE = SideConditions(exact_at_zero=False, continuous=True)


def fit_gains(
    curves: Mapping[str, Curve], end: float, fallback: Mapping[str, float], tolerance: float
) -> ScheduleFit:
    """Fit gains over |i_q| within a relative error, by the form that takes fewer bytes.

    Args:
        curves: The gains of `GAIN_NAMES` in V/A as functions of |i_q| in A.
        end: Largest current in A.
        fallback: Gains for a current that is not a number.
        tolerance: Largest relative error of a gain, in float32, with and without fused
            multiply-add.

    Raises:
        NoSolutionError: Neither form keeps the tolerance.
    """
    single_end = np.float32(end)
    dense = np.linspace(0.0, float(single_end), _DENSE)
    exact = {name: curves[name](dense) for name in GAIN_NAMES}
    varies = [
        name
        for name in GAIN_NAMES
        if np.ptp(exact[name]) > _CONSTANT * float(np.max(np.abs(exact[name])))
    ]
    common = {
        "end": single_end,
        "fallback": {name: np.float32(fallback[name]) for name in GAIN_NAMES},
        "constants": {
            name: np.float32(np.mean(exact[name])) for name in GAIN_NAMES if name not in varies
        },
    }

    def kept(evaluator: GainEvaluator | None) -> GainEvaluator | None:
        return (
            evaluator
            if evaluator is not None and max(errors_of(evaluator, curves).values()) <= tolerance
            else None
        )

    candidates: list[GainEvaluator] = []
    if not varies:
        candidates = [GainEvaluator(**common)]  # type: ignore[arg-type]
    for edges in [
        np.array([0.0, end]),
        *(np.array([0.0, share * end, end]) for share in _BREAKPOINTS),
    ] * bool(varies):
        found = kept(_polynomials(curves, varies, edges, tolerance, common))
        candidates += [] if found is None else [found]
    table = kept(_table(curves, varies, end, tolerance, common)) if varies else None
    least: dict[ScheduleForm, int | None] = {
        "polynomial": min((candidate.flash for candidate in candidates), default=None),
        "table": None if table is None else table.flash,
    }
    candidates += [] if table is None else [table]
    if not candidates:
        raise NoSolutionError(
            f"control.current_loop.schedule: neither polynomials of degree {_LARGEST_DEGREE} nor a "
            f"table of {_LARGEST_TABLE} points follow the gains within {100.0 * tolerance:g} %; "
            "check the flux data for kinks"
        )
    best = min(candidates, key=lambda candidate: candidate.flash)
    return ScheduleFit(best, errors_of(best, curves), least)


def errors_of(evaluator: GainEvaluator, curves: Mapping[str, Curve]) -> dict[str, float]:
    """Largest relative error of each gain on a dense grid of currents, in float32, fused or not.

    Args:
        evaluator: The gains as the firmware computes them.
        curves: Exact gains over the current in A, by name.
    """
    at = np.linspace(0.0, float(evaluator.end), _DENSE).astype(np.float32)
    exact = np.stack([curves[name](at.astype(np.float64)) for name in GAIN_NAMES], axis=1)
    worst = np.zeros(len(GAIN_NAMES))
    for fused in (False, True):
        found = evaluator.gains(at, fused=fused)
        worst = np.maximum(worst, np.max(np.abs(found / exact - 1.0), axis=0))
    return dict(zip(GAIN_NAMES, worst.tolist(), strict=True))


def _relative_error(fit: Curve, curve: Curve, end: float) -> float:
    at = np.linspace(0.0, end, 401)
    return float(np.max(np.abs(fit(at) / curve(at) - 1.0)))


def _polynomials(
    curves: Mapping[str, Curve],
    varies: list[str],
    edges: FloatArray,
    tolerance: float,
    common: Mapping[str, object],
) -> GainEvaluator | None:
    """Polynomials of the least degree for each gain on given segments, or None."""
    starts = edges[:-1].astype(np.float32)
    edges = np.append(starts.astype(np.float64), edges[-1])
    rows: dict[str, SingleArray] = {}
    for name in varies:
        for degree in range(1, _LARGEST_DEGREE + 1):
            rough = fit_curve(curves[name], edges, degree, "least-squares", _FREE)
            if _relative_error(rough, curves[name], edges[-1]) > 2.0 * tolerance:
                continue
            fit = fit_curve(curves[name], edges, degree, "minimax", _FREE, exchange=False)
            better = min(
                (rough, fit),
                key=lambda candidate: _relative_error(candidate, curves[name], edges[-1]),
            )
            if _relative_error(better, curves[name], edges[-1]) <= 0.999 * tolerance:
                rows[name] = better.coefficients.astype(np.float32)
                break
        else:
            return None
    return GainEvaluator(**common, starts=starts, polynomials=rows)  # type: ignore[arg-type]


def _table(
    curves: Mapping[str, Curve],
    varies: list[str],
    end: float,
    tolerance: float,
    common: Mapping[str, object],
) -> GainEvaluator | None:
    """The shortest table on even steps, or None."""
    for points in range(3, _LARGEST_TABLE + 1):
        inverse = np.float32((points - 1) / end)
        at = np.arange(points) / float(inverse)
        tables = {name: curves[name](np.minimum(at, end)).astype(np.float32) for name in varies}
        found = GainEvaluator(**common, inverse_step=inverse, tables=tables)  # type: ignore[arg-type]
        if max(errors_of(found, curves).values()) <= tolerance:
            return found
    return None
