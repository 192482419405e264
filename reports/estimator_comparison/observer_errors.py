"""Errors of a position observer on warm machines, and the starts from which it locks, as tables and
plain data.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import signed_percent
from dqforge.optimizer.estimator_comparison.candidate import LOCKED, CaptureMap
from dqforge.optimizer.estimator_comparison.solve import (
    BY_SALIENCY,
    NOBODY,
    UNREACHED,
    EstimatorComparison,
    FlashedPair,
)
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.observers.position_header import observer_files, tracker_files
from dqforge.reports.observers.position_text import dead_time_text, error_text
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.measured_cost import CallCost, cost_of_calls

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.candidate import (
        EstimatorFigures,
        Question,
        Slopes,
        WarmErrors,
        WarmState,
    )
    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart
    from dqforge.reports.plain_data import PlainData


_TURN = 2.0 * math.pi

_NOTICED = 5e-4  # relative error of the speed that a cell names


def _load_name(share: float) -> str:
    if share == 0.0:
        return "no load"
    return f"{100.0 * abs(share):.0f} % {'motoring' if share > 0.0 else 'braking'}"


def _state_name(state: WarmState) -> str:
    return f"{state.winding:+.0f} K, {state.magnet:+.0f} K"


def _cell(angle: float, speed: float, omega: float, *, with_speed: bool) -> str:
    if not math.isfinite(angle):
        return "lost"
    text = f"{math.degrees(angle):+.3g}"
    return f"{text}, {100.0 * speed / omega + 0.0:+.2g} %" if with_speed else text


def warm_table(warm: WarmErrors) -> Table:
    """Steady errors over speed and load, on the coldest and the hottest machine.

    Args:
        warm: The errors.
    """
    finite = warm.speed[np.isfinite(warm.speed)]
    relative = np.abs(np.where(np.isfinite(warm.speed), warm.speed, 0.0)) / warm.omega
    with_speed = bool(finite.size and np.max(relative) > _NOTICED)
    rows = tuple(
        (
            _state_name(warm.states[t]),
            f"{omega / _TURN:.4g}",
            *(
                _cell(
                    float(warm.angle[t, m, s]),
                    float(warm.speed[t, m, s]),
                    omega,
                    with_speed=with_speed,
                )
                for m in range(len(warm.shares))
            ),
        )
        for t in warm.shown
        for s, omega in enumerate(warm.omega.tolist())
    )
    columns = ("winding, magnets", "electrical Hz", *(_load_name(s) for s in warm.shares.tolist()))
    changes = "; ".join(
        f"{_state_name(warm.states[t])}: R {signed_percent(warm.states[t].r_s)}, psi "
        f"{signed_percent(warm.states[t].psi_pm)}"
        for t in warm.shown
    )
    own = "angle, and the speed in % of it" if with_speed else "angle; the speed has none"
    return Table(
        "Position observer on the warm machine; steady errors in deg (electrical)",
        columns,
        rows,
        (f"{own}; {changes}", "all else exact; the JSON also has them with dead time"),
    )


def plain_warm(warm: WarmErrors) -> PlainData:
    """The errors by the keys of docs/reference/json.md.

    Args:
        warm: The errors.
    """
    return {
        "states": [asdict(state) for state in warm.states],
        "torque_shares": warm.shares,
        "omega_rad_per_s": warm.omega,
        "angle_rad": warm.angle,
        "speed_rad_per_s": warm.speed,
        "angle_with_dead_time_rad": warm.angle_with_dead_time,
        "speed_with_dead_time_rad_per_s": warm.speed_with_dead_time,
    }


def _span(low: float, high: float) -> str:
    if math.isnan(low):
        return "none"
    return f"{math.degrees(low):+.0f} to {math.degrees(high):+.0f}"


def capture_table(found: CaptureMap) -> Table:
    """Starts that lock, a row per speed.

    Args:
        found: The map.
    """
    right, rest = found.angle_range(0.0), found.angle_range(-1.0)
    rows = []
    for s, omega in enumerate(found.omega.tolist()):
        times = found.lock_time[s][found.outcome[s] == LOCKED]
        slowest = f"{1e3 * float(np.max(times)):.3g}" if times.size else "-"
        rows.append(
            (
                f"{omega / _TURN:.4g}",
                _span(*right[s].tolist()),
                _span(*rest[s].tolist()),
                f"{100.0 * float(found.share[s]):.0f}",
                slowest,
            )
        )
    columns = (
        "electrical Hz",
        "right speed: angles deg",
        "speed 0: angles deg",
        "all starts %",
        "slowest ms",
    )
    speeds = f"{100.0 * found.speeds[0]:+.0f} to {100.0 * found.speeds[-1]:+.0f} %"
    off = f"starts with the angle off by up to 180 deg and the speed by {speeds}"
    ran = f"exact machine, half the largest torque; locked within {found.duration:.3g} s"
    notes = (f"{off}; {ran}",)
    return Table("Position observer: starts from which it locks", columns, tuple(rows), notes)


def plain_capture(found: CaptureMap) -> PlainData:
    """The map by the keys of docs/reference/json.md.

    Args:
        found: The map.
    """
    return {
        "omega_rad_per_s": found.omega,
        "start_angles_rad": found.angles,
        "start_speeds": found.speeds,
        "outcome": found.outcome.tolist(),
        "lock_time_s": found.lock_time,
        "duration_s": found.duration,
        "share": found.share,
        "angle_range_rad": found.angle_range(),
    }


# The comparison of estimators and start-ups as tables of the terminal.

_AT = (0.1, 0.5, 1.0)  # speeds of the first table over the largest one

_SENSITIVE_AT = (0.1, 0.5)

_NEAR = 0.3  # of a speed, within which a slope counts as there

_CAUSES = {
    "r_s": ("R +10 %", 0.1),
    "l_d": ("L_d +10 %", 0.1),
    "l_q": ("L_q +10 %", 0.1),
    "psi_pm": ("psi +10 %", 0.1),
    "dead_time": ("1 V of dead time", 1.0),
}


def estimator_tables(design: Design, found: EstimatorComparison) -> list[Table]:
    """All tables.

    Args:
        design: The drive.
        found: The comparison.
    """
    known = any(row.figures is not None for row in found.estimators)
    tables = [_estimators(design, found)]
    tables += [_sensitivities(found), _winners(found)] if known else []
    tables += [_starts(found)] if any(row.figures for row in found.starts) else []
    refused = _refused(found)
    return [*tables, refused] if refused.rows else tables


def _degrees(values: FloatArray, reached: FloatArray) -> str:
    """Largest error over the loads that are reached."""
    worst = float(np.max(np.where(reached, values, 0.0)))
    return f"{math.degrees(worst):.3g}" if math.isfinite(worst) else "lost"


def _row(found: EstimatorComparison, row: ComparedEstimator) -> tuple[str, ...]:
    figures, asked = row.figures, found.asked
    assert figures is not None
    at = [int(np.argmin(np.abs(asked.omega / asked.omega_max - share))) for share in _AT]
    quiet = 0 if row.candidate.from_standstill else at[1]
    capture = figures.capture
    return (
        row.candidate.name,
        held_text(row, asked.omega_max),
        *(_degrees(figures.angle[s], asked.reached[s]) for s in at),
        _degrees(figures.noise[quiet], asked.reached[quiet]),
        "" if figures.left is None else hertz(figures.left),
        "" if capture is None else f"{100.0 * float(np.mean(capture.share)):.0f}",
        "" if row.cycles is None else f"{0.5 * sum(row.cycles):.0f}",
        "" if row.flash is None else str(row.flash),
        "flash this"
        if row.candidate.name in {found.pair.at_speed, found.pair.from_standstill}
        else "",
    )


def _estimators(design: Design, found: EstimatorComparison) -> Table:
    columns = (
        "estimator",
        "holds, Hz",
        *(f"deg at {100.0 * share:.0f} %" for share in _AT),
        "noise deg",
        "speed loop Hz",
        "starts %",
        "cycles",
        "bytes",
        "",
    )
    rows = tuple(_row(found, row) for row in found.estimators if row.figures is not None)
    title = f"{design.name}: estimators of the position"
    if not rows:
        return Table(title, notes=pair_lines(found.asked, found.pair))
    known = found.asked.disturbances
    wrong = ", ".join(
        f"{symbol} {error_text(known, name)}"
        for symbol, name in (("R", "r_s"), ("L", "l_q"), ("psi", "psi_pm"))
    )
    notes = [
        *pair_lines(found.asked, found.pair),
        (
            f"deg: r.m.s. of {wrong} wrong, {dead_time_text(known)} and noise, at the worst load; "
            f"holds: below {math.degrees(ANGLE_LIMIT):.3g} deg and {100.0 * SPEED_LIMIT:.3g} % of "
            "the speed at every load"
        ),
        "speed loop: crossover that the lag leaves; starts: share of wrong starts that lock",
        f"cycles and bytes of a step on the {design.fit.core}"
        if not found.uncounted
        else f"no cycles: {found.uncounted}",
    ]
    return Table(title, columns, rows, tuple(notes))


def _slope(slopes: Slopes, cause: str, share: float, omega_max: float) -> str:
    gap = np.abs(slopes.omega / omega_max - share)
    at = int(np.argmin(gap))
    if gap[at] > _NEAR * share:
        return "-"
    value = float(slopes.angle[cause][at]) * _CAUSES[cause][1]
    # Adding zero turns -0 into 0.
    return f"{round(math.degrees(value), 3) + 0.0:+.3g}" if math.isfinite(value) else "lost"


def _sensitivities(found: EstimatorComparison) -> Table:
    omega_max = found.asked.omega_max
    rows = []
    for row in found.estimators:
        slopes = None if row.figures is None else row.figures.slopes
        if slopes is not None:
            cells = [
                ", ".join(_slope(slopes, cause, share, omega_max) for share in _SENSITIVE_AT)
                for cause in _CAUSES
            ]
            rows.append((row.candidate.name, *cells))
    at = " and ".join(f"{100.0 * share:.0f} %" for share in _SENSITIVE_AT)
    columns = ("estimator", *(label for label, _ in _CAUSES.values()))
    notes = (f"at {at} of the speed, half the largest torque; by the slope at exact data",)
    return Table("Error of the angle in deg (electrical)", columns, tuple(rows), notes)


def _winners(found: EstimatorComparison) -> Table:
    asked = found.asked
    pairs = asked.design.machine.pole_pairs
    rows = tuple(
        (
            hertz(omega),
            shaft_speed(omega, pairs),
            *(cell_name(found, s, m) for m in range(len(asked.shares))),
        )
        for s, omega in reversed(list(enumerate(asked.omega.tolist())))
    )
    columns = ("Hz", "speed", *(load_name(share) for share in asked.shares.tolist()))
    notes = ("least r.m.s. error of the angle in deg among those that hold; -: none does",)
    return Table("Who wins where", columns, rows, notes)


def _start_row(found: EstimatorComparison, row: ComparedStart) -> tuple[str, ...]:
    figures = row.figures
    assert figures is not None
    pairs = found.asked.design.machine.pole_pairs
    rates = ", ".join(f"{100.0 * part.rate:.0f}" for part in figures.tried)
    return (
        row.candidate.name,
        f"{figures.largest_load:.3g}",
        shaft_speed(figures.hand_over, pairs),
        f"{figures.duration:.2g}",
        rates or figures.untried,
        "flash this" if row.candidate.name == found.pair.start else "",
    )


def _starts(found: EstimatorComparison) -> Table:
    columns = ("start-up", "largest load N m", "hands over at", "after s", "succeed %", "")
    rows = tuple(_start_row(found, row) for row in found.starts if row.figures is not None)
    tried = next((row.figures.tried for row in found.starts if row.figures), ())
    notes: tuple[str, ...] = ()
    if tried:
        loads = ", ".join(f"{100.0 * part.load:.0f} %" for part in tried)
        of = f"succeed: of {tried[0].count} starts each at {loads} of the torque of the limit"
        notes = (f"{of} as friction, with machines drawn from the tolerances, at any angle",)
    return Table("Start-ups", columns, rows, notes)


def _refused(found: EstimatorComparison) -> Table:
    every: tuple[ComparedEstimator | ComparedStart, ...] = (*found.estimators, *found.starts)
    rows = tuple((row.candidate.name, row.refusal) for row in every if row.refusal)
    return Table("Not for this drive", ("", "because"), rows)


# The comparison of estimators and start-ups as plain data.

_NO_NAME = {NOBODY: None, UNREACHED: "unreached"}


def plain_comparison(found: EstimatorComparison) -> PlainData:
    """By the keys of docs/reference/json.md.

    Args:
        found: The comparison.
    """
    asked = found.asked
    names = [row.candidate.name for row in found.estimators]
    return {
        "omega_rad_per_s": asked.omega,
        "torque_shares": asked.shares,
        "reached": asked.reached.tolist(),
        "disturbances": asdict(asked.disturbances),
        "candidates": [_estimator(row) for row in found.estimators],
        "starts": [_start(row) for row in found.starts],
        "winner": [
            [names[index] if index >= 0 else _NO_NAME[index] for index in line]
            for line in found.winner.tolist()
        ],
        "pair": _pair(found),
        "uncounted": found.uncounted,
    }


def _estimator(row: ComparedEstimator) -> PlainData:
    named: PlainData = {
        "name": row.candidate.name,
        "title": row.candidate.title,
        "from_standstill": row.candidate.from_standstill,
        "refusal": row.refusal,
    }
    figures = row.figures
    if figures is None or row.holds is None:
        return named
    return named | {
        "angle_rad": figures.angle,
        "speed_rad_per_s": figures.speed,
        "noise_rad": figures.noise,
        "holds": row.holds.tolist(),
        "omega_low_rad_per_s": figures.omega_low,
        "omega_high_rad_per_s": figures.omega_high,
        "left_rad_per_s": figures.left,
        "slopes": None if figures.slopes is None else _slopes(figures.slopes),
        "capture": None if figures.capture is None else plain_capture(figures.capture),
        "cycles": None if row.cycles is None else list(row.cycles),
        "instructions": row.instructions,
        "flash_B": row.flash,
    }


def _slopes(slopes: Slopes) -> PlainData:
    return {
        "omega_rad_per_s": slopes.omega,
        "angle_rad": slopes.angle,
        "speed_rad_per_s": slopes.speed,
    }


def _start(row: ComparedStart) -> PlainData:
    named: PlainData = {
        "name": row.candidate.name,
        "title": row.candidate.title,
        "refusal": row.refusal,
    }
    figures = row.figures
    if figures is None:
        return named
    return named | {
        "largest_load_Nm": figures.largest_load,
        "hand_over_rad_per_s": figures.hand_over,
        "duration_s": figures.duration,
        "success": figures.success,
        "tried": [
            {
                "load": part.load,
                "count": part.count,
                "succeeded": part.succeeded,
                "interval": list(part.interval),
                "failures": dict(part.failures),
            }
            for part in figures.tried
        ],
        "untried": figures.untried,
    }


def _pair(found: EstimatorComparison) -> PlainData:
    pair = found.pair
    return {
        "at_speed": pair.at_speed,
        "from_standstill": pair.from_standstill,
        "start": pair.start,
        "up_rad_per_s": pair.up,
        "down_rad_per_s": pair.down,
        "held": pair.held,
        "held_at_speed": pair.held_at_speed,
        "loop": None
        if pair.loop is None
        else {
            "phase_margin_rad": pair.loop.margin,
            "crossover_rad_per_s": pair.loop.crossover,
            "holds": pair.loop.holds,
            "low_rad_per_s": pair.loop.low,
        },
        "passed_over": list(pair.passed),
        "gap_rad_per_s": None if pair.gap is None else list(pair.gap),
        "words": list(pair_lines(found.asked, pair)),
    }


# The comparison in words: who is refused and why, the pair to flash, and names of cells.


def hertz(omega: float) -> str:
    """An angular speed in rad/s as Hz."""
    return f"{omega / _TURN:.3g}"


def shaft_speed(omega: float, pole_pairs: int) -> str:
    """An electrical speed in rad/s as rpm of the shaft."""
    return f"{in_rpm(omega / pole_pairs):.4g} rpm"


def load_name(share: float) -> str:
    """A torque over the largest one."""
    if share == 0.0:
        return "no load"
    return f"{100.0 * abs(share):.0f} % {'motoring' if share > 0.0 else 'braking'}"


def cell_name(found: EstimatorComparison, speed: int, load: int) -> str:
    """Who wins at a speed and a load, with its error in deg; a dash where nobody holds, nothing
    where the voltage does not reach.
    """
    index = int(found.winner[speed, load])
    if index < 0:
        return "-" if index == NOBODY else ""
    row = found.estimators[index]
    assert row.figures is not None
    return f"{row.candidate.name} {math.degrees(float(row.figures.angle[speed, load])):.2g}"


def held_text(row: ComparedEstimator, omega_max: float) -> str:
    """Speeds in Hz at which an estimator holds at every load."""
    if row.figures is None:
        return ""
    low, high = row.figures.omega_low, row.figures.omega_high
    return f"{hertz(low)} to {hertz(min(high, omega_max))}" if math.isfinite(low) else "none"


def pair_lines(asked: Question, pair: FlashedPair) -> tuple[str, ...]:
    """Sentences on what to flash."""
    share = f"{100.0 * pair.held:.0f} % of the cells of speed and load that the voltage reaches"
    low = pair.from_standstill
    if pair.at_speed is None and low is not None:
        return (f"flash {low}: it holds in {share}; no estimator of higher speeds holds",)
    if pair.at_speed is None:
        return ("flash none of these: no estimator holds at any speed and load of this drive",)
    pairs = asked.design.machine.pole_pairs
    first = (
        f"flash {pair.at_speed} at speed: it holds in {share}"
        if low is None
        else f"flash {low} from standstill and {pair.at_speed} at speed: they hold in {share}"
    )
    if pair.start is not None:
        first += f"; start by {pair.start}"
    if pair.up is None or pair.down is None:
        over = "no speed for a hand-over: at none does it hold at every load"
    else:
        over = (
            f"hand over above {shaft_speed(pair.up, pairs)} ({hertz(pair.up)} Hz), and back below "
            f"{shaft_speed(pair.down, pairs)} ({hertz(pair.down)} Hz)"
        )
    lines = [first, over, *_loop_lines(asked, pair)]
    if pair.passed:
        lines.append(
            "rejected, as the speed loop over them is stable at every corner from a higher "
            f"speed on, or nowhere: {', '.join(pair.passed)}"
        )
    lines += _keys(asked, pair)
    if pair.gap is not None:
        from_, to = (shaft_speed(omega, pairs) for omega in pair.gap)
        lines.append(f"none holds at every load from {from_} to {to}")
    return tuple(lines)


def _loop_lines(asked: Question, pair: FlashedPair) -> list[str]:
    """The speed loop over the estimator at speed."""
    loop = pair.loop
    if loop is None:
        return []
    margin = f"{math.degrees(loop.margin):.3g} deg at {hertz(loop.crossover)} Hz"
    verdict = "" if loop.holds else ", too little: see dqforge tune"
    text = f"the speed loop over {pair.at_speed} has {margin}{verdict}"
    if not math.isfinite(loop.low):
        return [f"{text}; at no speed every corner of the tolerances is stable"]
    least = shaft_speed(loop.low, asked.design.machine.pole_pairs)
    return [f"{text}; every corner of the tolerances is stable from {least} on"]


def _keys(asked: Question, pair: FlashedPair) -> list[str]:
    """What to write into the design for the pair."""
    if pair.start is None:
        return [f"write control.observer: {{method: {pair.at_speed}}}"]
    keys = [f"method: {pair.start}"]
    if pair.up is not None:
        keys.append(f"hand_over: {shaft_speed(pair.up, asked.design.machine.pole_pairs)}")
    if pair.start == BY_SALIENCY:
        keys.append(f"observer: {{method: {pair.from_standstill}}}")
    start = f"{{{', '.join(keys)}}}"
    return [f"write control.observer: {{method: {pair.at_speed}}} and control.start_up: {start}"]


# What a step of each estimator costs on the design's core: its emitted C compiled for it and run
# on the emulation.

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
