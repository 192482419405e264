"""What is proven of single loops, in words, comment lines and plain data: margins axis by axis, the
speed loop, and current loops whose inductance changes.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.machines.transforms import in_rpm
from dqforge.reports.loops.firmware_text import (
    FIRMWARE_COLUMNS,
    FORM_COLUMNS,
    ROBUST_COLUMNS,
    SCHEDULE_COLUMNS,
    firmware_notes,
    firmware_rows,
    firmware_title,
    form_rows,
    plain_firmware,
    plain_robustness,
    plain_rotating,
    plain_schedule,
    robust_notes,
    robust_rows,
    rotating_words,
    schedule_notes,
    schedule_rows,
    stability_notes,
)
from dqforge.reports.observers.speed_loop_text import (
    leaving_notes,
    margin_words,
    observed_notes,
    plain_observed,
    plain_observer_errors,
    plain_tracker,
)
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import significant

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.axis_margins import ProvenMargins
    from dqforge.optimizer.changing_loops import ChangingAxis
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.reduced_order import ErrorsAtLoad
    from dqforge.optimizer.observers.tuning import ObserverProof
    from dqforge.optimizer.phase_control.design import PhaseLoops
    from dqforge.optimizer.phase_control.judged_box import JudgedLoops, JudgedSpeed
    from dqforge.optimizer.speed_box import SpeedProof
    from dqforge.reports.plain_data import PlainData


_WIDTH = 100


def margin_text(name: str, proven: ProvenMargins) -> str:
    """Bounds of one axis in words.

    Args:
        name: Of the loop.
        proven: What is proven.
    """
    if not proven.stable:
        return f"{name} alone: nothing is proven of its margins"
    parts = [f"M_s {proven.max_sensitivity:.3f} or less"]
    if proven.phase_margin is not None:
        degrees = math.floor(100.0 * math.degrees(proven.phase_margin)) / 100.0
        parts.append(f"phase margin {degrees:.2f} deg or more")
    return (
        f"{name} alone: proven stable for every drive in the box, {' and '.join(parts)} "
        f"({proven.cells} cells, rational arithmetic)"
    )


def speed_text(proof: SpeedProof) -> str:
    """What is proven of the speed loop.

    Args:
        proof: The proof.
    """
    samples = "one matrix" if proof.ratio == 1 else f"a cycle of {proof.ratio} matrices"
    scope = (
        "without torque, voltage and current limits, the torque following as i_q does; checked in "
        "double precision with the remainder of every cell"
    )
    if proof.complete:
        cells = "one cell" if proof.leaves == 1 else f"{proof.leaves} cells"
        return (
            "speed loop: proven stable for every drive in the box, which within a cell may change "
            f"at every current sample ({cells}, {samples} each): {scope}"
        )
    if proof.cells == 0:
        return (
            f"speed loop: not tried to prove, {samples} per cell are more than every run can "
            "afford; control.tolerances.thorough: true tries"
        )
    share = math.floor(1000.0 * proof.share) / 10.0
    cells = "one cell" if proof.leaves == 1 else f"{proof.leaves} cells"
    return (
        f"speed loop: proven stable for {share:.1f} % of the drives in the box ({cells}, "
        f"{samples} each), the others at corners and points alone; "
        f"control.tolerances.thorough: true tries longer: {scope}"
    )


def _range(axis: ChangingAxis) -> str:
    low, high = (f"{1e3 * value:.4g}" for value in axis.inductance)
    return f"l_{axis.axis[-1]} between {low} and {high} mH along the reference"


def _changes(axis: ChangingAxis) -> bool:
    """Whether the inductance takes two values that are printed differently."""
    low, high = axis.inductance
    return f"{1e3 * low:.4g}" != f"{1e3 * high:.4g}"


def changing_text(axis: ChangingAxis) -> str:
    """What is proven of an axis whose inductance changes with the current.

    Args:
        axis: The axis.
    """
    held = "one Lyapunov function" if axis.cells == 1 else f"{axis.cells} Lyapunov functions"
    if axis.any_current is None:
        if axis.proven:
            return (
                f"{axis.axis}, constant gains: stable however fast saturation changes "
                f"{_range(axis)} (proven by {held} in rational arithmetic)"
            )
        slower = (
            "not proven for any change of it"
            if axis.rate is None
            else f"proven while it changes by a factor of {axis.rate:.2f} per sample at most"
        )
        return f"{axis.axis}, constant gains: {_range(axis)}: {slower}"
    if not axis.proven:
        return f"{axis.axis}, scheduled gains: not proven while the current changes {_range(axis)}"
    other = (
        "of any size, also with the gains of any other current, such as the reference"
        if axis.any_current
        else "not with the gains of another current, such as the reference of one on its way"
    )
    return (
        f"{axis.axis}, scheduled gains in parallel form at the measured current: for small "
        f"deviations stable however fast the current changes {_range(axis)} (proven by {held} in "
        f"rational arithmetic); {other}"
    )


def velocity_text(axis: ChangingAxis) -> str:
    """Why the velocity form is refused with scheduled gains; empty where it does not grow.

    Args:
        axis: The axis.
    """
    if axis.velocity is None:
        return ""
    growth, (low, high) = axis.velocity
    every = "every sample" if growth.stay == 1 else f"every {growth.stay} samples"
    return (
        f"{axis.axis}: not in velocity form with kp (e[k] - e[k-1]): where i_q alternates between "
        f"{low:.4g} and {high:.4g} A {every} it grows by {growth.factor:.2f} per sample, though at "
        "each of these currents it is stable; kp[k] e[k] - kp[k-1] e[k-1] is the parallel form"
    )


def changing_notes(gains: GainSet) -> tuple[str, ...]:
    """What is proven while inductances change; nothing of those that are constant."""
    notes = [changing_text(axis) for axis in gains.proofs.changing if _changes(axis)]
    notes += [velocity_text(axis) for axis in gains.proofs.changing]
    return tuple(note for note in notes if note)


def box_notes(gains: GainSet) -> tuple[str, ...]:
    """What is proven of single loops over the tolerances; nothing without them."""
    proofs = gains.proofs
    notes = [margin_text(name, proven) for name, proven in proofs.margins.items()]
    if proofs.speed is not None:
        notes.append(speed_text(proofs.speed))
    if proofs.observed:
        notes.append(
            "speed loop: nothing is proven over the box, since its speed comes from an observer, "
            "which has too many states for this proof"
        )
    if proofs.measured:
        notes.append(
            "speed loop: nothing is tried or proven over the box, since the delay of its measured "
            "speed is part of neither"
        )
    return tuple(notes)


def proven_lines(gains: GainSet | None) -> list[str]:
    """Both as comment lines of a header."""
    return [] if gains is None else [*_wrapped(box_notes(gains)), *changing_lines(gains)]


def changing_lines(gains: GainSet) -> list[str]:
    """What is proven while inductances change as comment lines of a header."""
    return _wrapped(changing_notes(gains))


def _wrapped(notes: tuple[str, ...]) -> list[str]:
    lines = []
    for note in notes:
        lines += textwrap.wrap(f"{note}.", _WIDTH)
    return lines


def plain_box_proofs(gains: GainSet) -> PlainData:
    """What is proven over the tolerances as plain data."""
    proofs, speed = gains.proofs, gains.proofs.speed
    return {
        "margins": {
            name: {
                "proven_stable": proven.stable,
                "max_sensitivity": proven.max_sensitivity,
                "phase_margin_rad": proven.phase_margin,
                "cells": proven.cells,
            }
            for name, proven in proofs.margins.items()
        },
        "speed": None
        if speed is None
        else {
            "proven": speed.complete,
            "share": speed.share,
            "cells": speed.cells,
            "matrices": speed.leaves * (speed.ratio + 1),
        },
        "speed_observed": proofs.observed,
    }


def plain_changing(gains: GainSet) -> PlainData:
    """What is proven while inductances change; an empty mapping of a machine without saturation."""
    axes = gains.proofs.changing
    if not axes:
        return {}
    return {"changing_inductances": {axis.axis: _plain_axis(axis) for axis in axes}}


def _plain_axis(axis: ChangingAxis) -> PlainData:
    plain: PlainData = {
        "inductance_H": list(axis.inductance),
        "proven": axis.proven,
        "gains_of_any_current": axis.any_current,
        "largest_factor_per_sample": axis.rate,
        "cells": axis.cells,
    }
    if axis.velocity is not None:
        growth, currents = axis.velocity
        plain["velocity_form"] = {
            "growth_per_sample": growth.factor,
            "samples": growth.stay,
            "i_q_A": list(currents),
        }
    return plain


# How fast the currents of a phase machine forget, over speeds and tolerances: rows of text, words,
# plain data.

JUDGED_TITLE = "Currents over a period of the back-EMF"


_LINE = 88


_WORST = ("worst radius", "at")


def _rpm(speed: JudgedSpeed) -> str:
    return f"{in_rpm(speed.omega_m):.5g}"


def _orders(speed: JudgedSpeed) -> str:
    plane, zero = (", ".join(map(str, orders)) for orders in speed.orders)
    parts = [*([plane] if plane else []), *([f"zero sequence {zero}"] if zero else [])]
    return "; ".join(parts) or "none"


def _judged_row(speed: JudgedSpeed) -> tuple[str, ...]:
    still = math.isinf(speed.samples)
    return (
        _rpm(speed),
        "at rest" if still else f"{speed.samples:.4g}",
        f"{speed.nominal:.4f}",
        f"{speed.decay_time * 1e3:.3g}",
        *(() if speed.worst is None else (f"{speed.worst.value:.4f}", speed.worst.at)),
        "as the others" if still else _orders(speed),
        "" if speed.learning_time is None else f"{speed.learning_time * 1e3:.3g}",
    )


def judged_columns(judged: JudgedLoops) -> tuple[str, ...]:
    """Heads of the columns; those of the tolerances where there are any."""
    return (
        "rpm",
        "samples per period",
        "radius per sample",
        "decay to 1/e in ms",
        *(_WORST if judged.corners else ()),
        "harmonic integrators",
        "learnt to 1/e in ms",
    )


def judged_rows(judged: JudgedLoops) -> tuple[tuple[str, ...], ...]:
    """One row per speed."""
    return tuple(_judged_row(speed) for speed in judged.speeds)


def judged_notes(phases: PhaseLoops) -> tuple[str, ...]:
    """What was judged, and how many drives were tried."""
    judged, control = phases.judged, phases.control
    assert judged is not None
    what = "radius: largest modulus of a Floquet multiplier per sample, stable below 1"
    notes = [f"frame {control.frame}, feedforward {control.feedforward}; {what}"]
    if judged.corners:
        inside = f" and {judged.inside} points inside" if judged.inside else ""
        notes.append(
            f"{judged.corners} corners{inside} of the tolerances at each speed, l_0 as far as l_d "
            "or l_q, whichever is further"
        )
    if judged.midpoint_time is not None:
        notes.append(f"the midpoint returns to 1/e in {judged.midpoint_time * 1e3:.3g} ms")
    return tuple(notes)


def _largest(judged: JudgedLoops) -> tuple[float, str]:
    """The largest radius and where it is, in words."""
    slow = judged.slowest
    if slow.worst is None:
        return slow.nominal, f"{_rpm(slow)} rpm"
    return slow.worst.value, f"{_rpm(slow)} rpm, {slow.worst.at}"


def judged_words(judged: JudgedLoops) -> str:
    """The slowest of all in a few words."""
    value, where = _largest(judged)
    return f"radius per sample {value:.4f} or less ({where})"


def judged_sentence(judged: JudgedLoops) -> str:
    """The same as a sentence."""
    value, where = _largest(judged)
    return (
        "Over a period of the back-EMF the currents keep at most "
        f"{value:.4f} of a disturbance per sample ({where})."
    )


def judged_lines(judged: JudgedLoops) -> list[str]:
    """The same as lines at the head of a header."""
    return textwrap.wrap(judged_sentence(judged), _LINE)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain_speed(speed: JudgedSpeed) -> PlainData:
    return {
        "omega_m_rad_per_s": speed.omega_m,
        "samples_per_period": _finite(speed.samples),
        "radius": speed.nominal,
        "decay_time_s": _finite(speed.decay_time),
        "worst": None if speed.worst is None else asdict(speed.worst),
        "orders": {"plane": list(speed.orders[0]), "zero": list(speed.orders[1])},
        "learning_time_s": (None if speed.learning_time is None else _finite(speed.learning_time)),
    }


def plain_judged(phases: PhaseLoops) -> PlainData:
    """The judgement as plain data, in SI units; an empty mapping without one."""
    judged = phases.judged
    if judged is None:
        return {}
    return {
        "currents": {
            "frame": phases.control.frame,
            "feedforward": phases.control.feedforward,
            "radius": _largest(judged)[0],
            "corners": judged.corners,
            "inside": judged.inside,
            "midpoint_time_s": (
                None if judged.midpoint_time is None else _finite(judged.midpoint_time)
            ),
            "speeds": [_plain_speed(speed) for speed in judged.speeds],
        }
    }


# Loops as tables of the terminal.


def _loop_row(gains: LoopGains, unit: str, scaled: PerUnitGains) -> tuple[str, ...]:
    return (
        gains.loop,
        gains.method,
        f"{gains.kp:.5g} {unit}",
        f"{gains.ki:.5g}",
        _per_unit_text(scaled),
        significant(gains.crossover / (2.0 * math.pi)),
        margin_words(gains),
        f"{20.0 * math.log10(gains.gain_margin):.1f}"
        if math.isfinite(gains.gain_margin)
        else "none",
        significant(gains.delay_margin * 1e6, 3),
        f"{gains.max_sensitivity:.2f}",
    )


_COLUMN_UNITS = {"speed": "N m s/rad"}


def _per_unit_text(scaled: PerUnitGains) -> str:
    if scaled.integers is None:
        return f"{scaled.kp:.5g}, {scaled.ki_ts:.4g}"
    return ", ".join(f"{number.mantissa} (Q{number.shift})" for number in scaled.integers)


# What the margins of the first table are of, where other firmware shows others for the same gains.
OWN_TIMING = (
    "margins: of dqforge's control, whose voltage begins one period after the sampling; export "
    "--for shows those with another firmware's delay"
)


def gains_tables(design: Design, gains: GainSet, proof: ObserverProof | None = None) -> list[Table]:
    """Gains of each loop with their margins, and the observer with its errors
    and what is proven of it.
    """
    rows = [
        _loop_row(loop, _COLUMN_UNITS.get(loop.loop, "V/A"), gains.per_unit[loop.loop])
        for loop in gains.loops
    ]
    columns = (
        "loop",
        "method",
        "kp",
        "ki (kp unit)/s",
        "per unit: kp, ki t_s",
        "crossover Hz",
        "phase margin deg",
        "gain margin dB",
        "delay margin us",
        "M_s",
    )
    title, notes = (
        f"{design.name}: gains, sampled every {design.control.t_s * 1e6:.4g} us",
        (
            *rotating_words(gains.rotating),
            *observed_notes(gains.speed),
            *leaving_notes(gains.speed),
        ),
    )
    if gains.firmware is None:
        notes = (OWN_TIMING, *notes)
    if gains.schedule is None:
        notes = (*notes, *changing_notes(gains))
    tables = [Table(title, columns, tuple(rows), notes)]
    tables.append(Table("Parallel, series and velocity form", FORM_COLUMNS, form_rows(gains)))
    if gains.firmware is not None:
        title, found = firmware_title(gains.firmware), firmware_rows(gains.firmware)
        tables.append(Table(title, FIRMWARE_COLUMNS, found, firmware_notes(gains.firmware)))
    if gains.phases is not None and gains.phases.judged is not None:
        judged, notes = gains.phases.judged, judged_notes(gains.phases)
        heads, found = judged_columns(judged), judged_rows(judged)
        tables.append(Table(JUDGED_TITLE, heads, found, notes))
    if gains.robust is not None:
        rows_ = robust_rows(gains.robust)
        notes = (
            *robust_notes(gains.robust),
            *box_notes(gains),
            *stability_notes(gains, design.machine.pole_pairs),
        )
        tables.append(Table("Worst within control.tolerances", ROBUST_COLUMNS, rows_, notes))
    if gains.schedule is not None:
        rows_ = schedule_rows(gains.schedule)
        notes = (*schedule_notes(gains.schedule), *changing_notes(gains))
        tables.append(
            Table("Scheduled gains along the current reference", SCHEDULE_COLUMNS, rows_, notes)
        )
    if gains.observer is not None and gains.observer_slopes is not None:
        from dqforge.reports.observers.position_text import observer_table

        tables.append(observer_table(gains.observer, gains.observer_slopes))
    if gains.measured_speed is not None:
        from dqforge.reports.single_headers.speed_measurement import measured_tables

        tables += measured_tables(gains.measured_speed)
    if gains.position is not None:
        from dqforge.reports.observers.position_text import position_parts

        tables += [Table(*part) for part in position_parts(gains.position, proof)]
    if gains.tracker is not None:
        from dqforge.reports.observers.speed_loop_text import tracker_part

        tables.append(Table(*tracker_part(gains.tracker)))
    return tables


# Loops as plain data.


def _plain_position(gains: GainSet) -> PlainData | None:
    if gains.position is None:
        return None
    from dqforge.reports.observers.position_text import plain_position

    return plain_position(gains.position)


def _plain_loop(gains: LoopGains, scaled: PerUnitGains) -> PlainData:
    integers = {}
    if scaled.integers is not None:
        kp, ki_ts = scaled.integers
        integers = {
            "kp_q": kp.mantissa,
            "ki_ts_q": ki_ts.mantissa,
            "q_formats": (kp.shift, ki_ts.shift),
        }
    return {
        "method": gains.method,
        "kp": gains.kp,
        "ki": gains.ki,
        "t_s": gains.t_s,
        "ki_ts": gains.ki_ts,
        "t_i_s": gains.t_i,
        "q0": gains.velocity[0],
        "q1": gains.velocity[1],
        "anti_windup_per_s": gains.anti_windup,
        "kp_pu": scaled.kp,
        "ki_ts_pu": scaled.ki_ts,
        **integers,
        "crossover_rad_per_s": gains.crossover,
        "phase_margin_rad": gains.phase_margin,
        "gain_margin": gains.gain_margin,
        "delay_margin_s": gains.delay_margin,
        "delay_margin_samples": gains.delay_margin_samples,
        "max_sensitivity": gains.max_sensitivity,
        "stable": gains.stable,
        "disturbance_peak": gains.disturbance.peak,
        "disturbance_settling_s": gains.disturbance.settling_time,
        "poles": [[pole.real, pole.imag] for pole in gains.poles.tolist()],
        **plain_observed(gains),
    }


def _plain_tolerances(gains: GainSet) -> PlainData:
    found = plain_robustness(gains.robust)
    if found:
        found["tolerances"]["single_loops"] = plain_box_proofs(gains)
    return found


def plain_gains(
    design: Design, gains: GainSet, observer_errors: tuple[ErrorsAtLoad, ...] = ()
) -> PlainData:
    """Gains of each loop with their margins; None where the design has no such loop.

    ``observer_errors`` are the steady errors of the speed observer at loads, where they are known.
    """
    zero = None if gains.phases is None else gains.phases.zero
    return {
        "i_d": _plain_loop(gains.i_d, gains.per_unit["i_d"]),
        "i_q": _plain_loop(gains.i_q, gains.per_unit["i_q"]),
        **({} if zero is None else {"i_0": _plain_loop(zero, gains.per_unit["i_0"])}),
        "speed": None if gains.speed is None else _plain_loop(gains.speed, gains.per_unit["speed"]),
        "observer": None if gains.observer is None else asdict(gains.observer),
        **plain_observer_errors(gains.observer_slopes, observer_errors),
        "position": _plain_position(gains),
        **({} if gains.tracker is None else {"tracker": plain_tracker(gains.tracker)}),
        "bases": asdict(design.control.bases),
        "rotating": plain_rotating(gains.rotating),
        **_plain_tolerances(gains),
        **plain_schedule(gains.schedule),
        **plain_changing(gains),
        **({} if gains.phases is None else plain_judged(gains.phases)),
        **plain_firmware(gains),
    }
