"""What a log itself shows to be wrong with it: each finding names its run, column and rows.

A wrong factor, sign or channel is not told from another machine by any fit; the balance of powers,
a second column of the same quantity and the values themselves tell it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.bench.bench_file import LoggedRun
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.optimizer.identification.correlated_errors import correlation_time, regress, separable
from dqforge.optimizer.identification.parameters import CONTRADICTION, named_ratio, student_95

# Fewer rows say nothing of a column.
_LEAST_ROWS = 8
# Rows below this share of the largest power, or speed, are those of friction and offsets.
_IDLE = 0.1
# Friction and iron take less than this share of the power that passes.
_MOST_LOSS = 0.5
# Torque sensors and voltages are not better than this share of the power.
_LEAST_LOSS = -0.02
# So many rows of a quadrant agree on the sign of a loss that is no noise.
_MOST_ROWS = 0.75
# A setpoint holds its number in more rows than this while a measured voltage holds it in fewer.
_HELD, _MOVING = 0.8, 0.2
# Rows within this share of the largest voltage lie on a plateau where at least that share of all
# does, and where they are so many times denser than just below it.
_PLATEAU, _CROWD, _DENSER = 1e-3, 0.03, 10.0
# Share of the linear limit from which a voltage is at it; that of a duty cycle.
_AT_LIMIT, _FULL_DUTY = 0.995, 0.95


@dataclass(frozen=True, slots=True)
class Fitted:
    """What a fit says of the losses in the winding: phase resistance in Ohm and voltage error of
    the inverter along the current in V.
    """

    resistance: float
    inverter_voltage: float


@dataclass(frozen=True, slots=True)
class Findings:
    """Sentences on a run: what is worth knowing, and what cannot be."""

    remarks: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()


def log_findings(run: LoggedRun, pole_pairs: int, fitted: Fitted) -> Findings:
    """Findings in the rows of currents, voltages and speed of one run."""
    speed, i_q = run.need("speed"), run.need("i_q")
    remarks, against = [], list(_wrong_pole_pairs(run, pole_pairs))
    moving = np.sign(speed[np.abs(speed) > _IDLE * float(np.max(np.abs(speed), initial=0.0))])
    if moving.size and abs(int(moving.sum())) == moving.size:
        remarks.append(
            f"{run.name}: column speed has one direction of rotation only: an error of the "
            "encoder's angle is not identified, and is in flux linkages and inductances; log the "
            "other direction too"
        )
    torque, electrical = run.column("torque"), _electrical(run)
    if torque is not None and electrical is not None and i_q.size >= _LEAST_ROWS:
        power = _Powers(run, speed, torque, electrical, _winding(run, fitted))
        told, contradicted = _torque_told(power)
        against += contradicted or _balance(power)
        remarks += told
    return Findings(tuple(remarks), tuple(against))


def rows_text(run: LoggedRun, chosen: BoolArray) -> str:
    """How many rows are meant, and between which of the log."""
    part = run.parts[0]
    lines = part.rows[chosen]
    return (
        f"{lines.size} of {chosen.size} rows of {part.file} (from row {lines[0]} to {lines[-1]})"
        if lines.size
        else f"no rows of {part.file}"
    )


# Voltages at their limit.


def at_limit(run: LoggedRun, v_dc: float | None) -> tuple[BoolArray, str]:
    """Rows whose voltage stood at its limit, shape (rows,), and by which column; '' for none.

    The limit is that of the DC link, logged or of the inverter (``v_dc`` in V), a duty cycle, or a
    plateau on which many rows have one and the same largest voltage at several currents or speeds.
    """
    u_q, u_d = run.need("u_q"), run.column("u_d")
    size = np.hypot(u_q, 0.0 if u_d is None else u_d)
    logged, duty = run.column("v_dc"), run.column("duty")
    limit = logged if logged is not None or v_dc is None else np.full(size.shape, v_dc)
    none: BoolArray = np.zeros(size.shape, dtype=np.bool_)
    if limit is not None:
        reached = size >= _AT_LIMIT * linear_voltage(limit)
        if reached.any():
            return reached, "u_d and u_q stand at v_dc/sqrt(3)"
    if duty is not None:
        full = np.abs(duty) >= _FULL_DUTY
        if full.any() and float(np.max(np.abs(duty))) <= 1.0:
            return full, "duty stands at its limit"
    if u_d is None and run.column("i_d") is not None:
        return none, ""
    top = float(size.max(initial=0.0))
    plateau = size >= (1.0 - _PLATEAU) * top
    below = (size >= (1.0 - 6.0 * _PLATEAU) * top) & ~plateau
    dense = plateau.sum() > max(_CROWD * size.size, _LEAST_ROWS, _DENSER / 5.0 * below.sum())
    moved = any(
        float(np.ptp(values[plateau])) > 0.05 * float(np.max(np.abs(values)))
        for values in (run.need("i_q"), run.need("speed"))
    )
    if dense and moved and not plateau.all():
        return plateau, f"|u| of u_d and u_q has one largest value, {top:.4g} V"
    return none, ""


# Currents that were asked for.


def requested(run: LoggedRun) -> Iterator[str]:
    """Says of currents that hold one number while the voltages move that they are setpoints."""
    i_q, u_q = run.need("i_q"), run.need("u_q")
    if i_q.size < _LEAST_ROWS:
        return
    held, still = (float(np.mean(np.diff(values) == 0.0)) for values in (i_q, u_q))
    if _HELD < held < 1.0 and still < _MOVING:
        same = np.concatenate([[False], np.diff(i_q) == 0.0])
        yield (
            f"{run.name}: column i_q has the number of the row before in {rows_text(run, same)} "
            "while u_q moves: a requested current, or a channel slower than the log; log the "
            "measured one"
        )


# Steady windows.

_CHECKED = ("i_d", "i_q", "u_d", "u_q", "speed")
# A new point is a jump of so many times the noise, and of that share of the largest value.
_JUMP, _LEAST_JUMP = 8.0, 0.02
# Within a window a column varies by less than this share of its largest value, and drifts by less
# than this one where its drift is no noise (1 % of windows without one fail).
_WIDEST, _DRIFT, _TWO_SIDED = 0.05, 1e-3, 2.58
# How much of the beginning of a point may go before it is given up.
_SETTLING = (0.0, 0.125, 0.25, 0.375, 0.5)
# So many windows are one row each; fewer are parted, for so many rows.
_ENOUGH = 24
# A log of held points is in windows for more than this share.
_HELD_SHARE, _LEAST_WINDOWS = 1.0 / 3.0, 6


def settled(run: LoggedRun) -> LoggedRun:
    """A run of held points as the means of its steady windows, with a remark on what is left out.

    A window is what is left of a point from where none of its columns drifts up or down: the means
    of its halves differ by no more than correlated noise permits. A log of which less than a
    third of the rows with a current or a speed is in windows, such as a ride or a list of points,
    stays as it is.
    """
    columns = {name: run.column(name) for name in _CHECKED}
    held = {name: values for name, values in columns.items() if values is not None}
    sizes = {name: max(float(np.max(np.abs(values))), 1e-300) for name, values in held.items()}
    count = run.parts[0].rows.size
    windows = [
        window
        for begin, end in _points(held, sizes, count)
        if (window := _steady(held, sizes, begin, end)) is not None
    ]
    # Where the drive rests there is nothing to be had, however steady it is.
    active: BoolArray = np.zeros(count, dtype=np.bool_)
    for name, values in held.items():
        if not name.startswith("u"):
            active |= np.abs(values) > _LEAST_JUMP * sizes[name]
    windows = [window for window in windows if np.mean(active[window]) > _MOST_ROWS]
    kept = sum(window.stop - window.start for window in windows)
    if len(windows) < _LEAST_WINDOWS or kept < _HELD_SHARE * np.count_nonzero(active):
        return run
    parts = -(-_ENOUGH // len(windows))
    blocks = [
        block
        for window in windows
        for block in np.array_split(
            np.arange(window.start, window.stop),
            max(1, min(parts, (window.stop - window.start) // (_LEAST_ROWS // 2))),
        )
    ]
    steps = {}
    for name, values in held.items():
        step = step_of(values)
        if step > 0.0 and np.median([float(np.std(values[one])) for one in windows]) < 0.5 * step:
            steps[name] = step
    part = run.parts[0]
    means = {
        name: np.array([float(np.mean(values[block])) for block in blocks])
        for name, values in part.columns.items()
    }
    told = (
        f"{run.name}: means of {len(windows)} steady windows, {kept} of {count} rows of "
        f"{part.file}; {count - kept} rows that settle or drift are left out"
    )
    less = replace(part, columns=means, rows=part.rows[[int(block[0]) for block in blocks]])
    return replace(run, parts=(less,), remarks=(*run.remarks, told), steps=steps)


def _points(
    held: Mapping[str, FloatArray], sizes: Mapping[str, float], count: int
) -> list[tuple[int, int]]:
    """First row of each held point, and of the next."""
    jumps: BoolArray = np.zeros(max(count - 1, 0), dtype=np.bool_)
    for name, values in held.items():
        moved = np.abs(np.diff(values))
        noise = float(np.median(moved)) if moved.size else 0.0
        jumps |= moved > max(_JUMP * noise, _LEAST_JUMP * sizes[name])
    edges = [0, *(np.flatnonzero(jumps) + 1).tolist(), count]
    return list(pairwise(edges))


def _steady(
    held: Mapping[str, FloatArray], sizes: Mapping[str, float], begin: int, end: int
) -> slice | None:
    """The steady part of a point; None where it has none."""
    for share in _SETTLING:
        first = begin + round(share * (end - begin))
        if end - first < _LEAST_ROWS:
            return None
        if not any(_drifts(held[name][first:end], sizes[name]) for name in held):
            return slice(first, end)
    return None


def _drifts(values: FloatArray, size: float) -> bool:
    """Whether a column moves within a window, to either side."""
    if float(np.std(values)) > _WIDEST * size:
        return True
    halves = np.array_split(values, 2)
    gap = abs(float(halves[1].mean() - halves[0].mean()))
    if gap <= _DRIFT * size:
        return False
    # The noise is that of the later half about a line: what settles would count as noise.
    later = halves[1]
    place = np.arange(later.size) - 0.5 * (later.size - 1)
    left = later - later.mean() - place * float(place @ later) / float(place @ place)
    time = correlation_time(left, np.zeros(left.size, dtype=np.intp))
    variance = time * float(left @ left) / max(left.size - 2, 1)
    return gap > _TWO_SIDED * math.sqrt(variance * sum(1.0 / half.size for half in halves))


# Two columns of the speed.


def _wrong_pole_pairs(run: LoggedRun, pole_pairs: int) -> Iterator[str]:
    """Pole pairs by the columns of electrical and mechanical speed."""
    speed, electrical = run.need("speed"), run.column("electrical_speed")
    if electrical is None:
        return
    turning = np.abs(speed) > _IDLE * float(np.max(np.abs(speed), initial=0.0))
    if not turning.any():
        return
    ratio = float(np.median(electrical[turning] / speed[turning]))
    if abs(ratio - pole_pairs) > 0.02 * pole_pairs:
        yield (
            f"{run.name}: columns electrical_speed and speed have a ratio of {ratio:.4g}, not "
            f"{pole_pairs} pole pairs; correct machine.pole_pairs or a unit"
        )


# Powers: all in W, positive into the machine.


@dataclass(frozen=True, slots=True)
class _Powers:
    """Rows of one run, each array of shape (rows,): mechanical speed in rad/s, torque column in
    N m, electrical power, and what winding and inverter take of it.
    """

    run: LoggedRun
    speed: FloatArray
    torque: FloatArray
    electrical: FloatArray
    winding: FloatArray

    @property
    def turning(self) -> BoolArray:
        """Rows fast enough for a torque to follow from a power."""
        size = np.abs(self.speed)
        return np.asarray(size > _IDLE * float(size.max()))


def _electrical(run: LoggedRun) -> FloatArray | None:
    """1.5 Re(u conj(i)); None where a product is not logged."""
    i_d, u_d = run.column("i_d"), run.column("u_d")
    power = 1.5 * run.need("u_q") * run.need("i_q")
    if i_d is None:
        return power
    return None if u_d is None else power + 1.5 * u_d * i_d


def _winding(run: LoggedRun, fitted: Fitted) -> FloatArray:
    i_d = run.column("i_d")
    size = np.hypot(run.need("i_q"), 0.0 if i_d is None else i_d)
    error = fitted.inverter_voltage if math.isfinite(fitted.inverter_voltage) else 0.0
    return np.asarray(1.5 * (fitted.resistance * size + error) * size)


def _torque_told(power: _Powers) -> tuple[list[str], list[str]]:
    """The torque column against 1.5 p Im(conj(psi) i) = (1.5 Re(u conj(i)) - winding)/w_m, less
    friction and offset of the sensor.
    """
    name = f"{power.run.name}: column torque"
    kept = power.turning & np.isfinite(power.winding)
    speed = power.speed[kept]
    if speed.size < _LEAST_ROWS:
        return [], []
    gap = (power.electrical[kept] - power.winding[kept]) / speed
    columns = np.column_stack([gap, np.ones(gap.size), np.sign(speed), speed])
    # Friction and offset give way where the speeds do not tell them.
    chosen = [0]
    for place in range(1, columns.shape[1]):
        if separable(columns[:, [*chosen, place]]).all():
            chosen.append(place)
    if not float(np.ptp(gap)) > 0.0:
        return [], []
    fit = regress(columns[:, chosen], power.torque[kept], np.zeros(gap.size, dtype=np.intp))
    ratio = float(fit.coefficients[0])
    half = student_95(fit.freedom) * math.sqrt(float(fit.covariance[0, 0]))
    against = "1.5 p Im(conj(psi) i) of the voltages and currents"
    if ratio + half < 0.0:
        text = "has the other sign than"
    elif abs(ratio) < 0.2 and half < 0.5:
        text = "does not follow"
    elif half > (CONTRADICTION - 1.0) * ratio:
        return [], []
    elif max(ratio, 1.0 / ratio) > CONTRADICTION:
        cause = named_ratio(ratio)
        text = f"is {ratio:.3g} times" + (f" (near {cause})" if cause else "")
    else:
        share = 100.0 * abs(ratio - 1.0)
        side = "above" if ratio >= 1.0 else "below"
        return [f"{name} is {share:.1f} % {side} {against}"], []
    advice = "repair it, or leave the column out"
    where = rows_text(power.run, kept)
    return [], [f"{name} {text} {against}, {where}; {advice}"]


def _balance(power: _Powers) -> list[str]:
    """Quadrants whose losses, electrical less mechanical power, cannot be."""
    found = []
    mechanical = power.torque * power.speed
    through = np.maximum(np.abs(power.electrical), np.abs(mechanical))
    loss = power.electrical - mechanical
    large = through > _IDLE * float(through.max())
    for direction in (1.0, -1.0):
        for sense, drives in (("motoring", 1.0), ("braking", -1.0)):
            quadrant = power.speed * direction > 0.0
            kept = large & quadrant & (power.electrical * drives > 0.0)
            if kept.sum() < _LEAST_ROWS:
                continue
            whole = float(through[kept].sum())
            share = float(loss[kept].sum()) / whole
            other = float((loss - power.winding)[kept].sum()) / whole
            if share < _LEAST_LOSS and float(np.mean(loss[kept] < 0.0)) > _MOST_ROWS:
                text = f"{100.0 * share:.2g} % of the power is lost, which is less than nothing"
            elif other > _MOST_LOSS:
                text = f"{100.0 * other:.2g} % of the power is lost outside the winding"
            else:
                continue
            way = in_rpm(float(np.mean(power.speed[kept])))
            found.append(
                f"{power.run.name}: power balance of {sense} at {way:.3g} rpm: {text} by columns "
                f"u_d, u_q, i_d, i_q against torque and speed, {rows_text(power.run, kept)}; check "
                "the zero of the torque sensor"
            )
    return found


# Numbers with steps.


def step_of(values: FloatArray) -> float:
    """The step of a column whose numbers are multiples of one, 0 where they are not.

    Args:
        values: Shape (N,).
    """
    found = np.unique(values)
    if found.size < _LEAST_LEVELS or found.size > values.size // 2:
        return 0.0
    gaps = np.diff(found)
    span = float(found[-1] - found[0])
    gaps = gaps[gaps > _PRINTED * span]
    step = float(gaps.min())
    multiples = gaps / step
    even = float(np.max(np.abs(multiples - np.round(multiples)))) < 0.05
    return step if even and step <= _LARGEST_STEP * span else 0.0


# Fewer levels, or steps of a larger share of the range, are set points; a smaller share is what
# printing leaves.
_LEAST_LEVELS, _LARGEST_STEP, _PRINTED = 8, 0.02, 1e-7
