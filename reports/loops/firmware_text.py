"""The loops as the firmware that a design names runs them: rows of text, words, plain data."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.c_code.numbers import rounded_up

if TYPE_CHECKING:
    from dqforge.optimizer.certificates.cell_queue import BoxDrive
    from dqforge.optimizer.certificates.current_loop_proof import (
        CurrentLoopProof,
        DriveRange,
        ProvenSensitivity,
    )
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.firmware.configuration import PiGains, TurningAxes
    from dqforge.optimizer.firmware.firmware_method import JudgedLoop, Price, Shortfall
    from dqforge.optimizer.firmware.gain_search import FirmwareLoop, FirmwareLoops
    from dqforge.optimizer.loops.gain_schedule import AxisSchedule, GainSchedule
    from dqforge.optimizer.loops.robustness import LoopRobustness, RobustSet, RotatingAxes
    from dqforge.reports.plain_data import PlainData


FIRMWARE_COLUMNS = (
    "loop",
    "as run by",
    "kp",
    "ki (kp unit)/s",
    "crossover Hz",
    "phase margin deg",
    "gain margin dB",
    "delay margin us",
    "M_s",
    "damping",
)


_UNITS = {"speed": ("A s/rad", "N m s/rad")}


_FREE = {
    "axes": "kp and ki of each axis",
    "one-pair": "one pair of gains for both axes",
    "bandwidth": "one bandwidth, of which it makes its gains",
}


def firmware_name(firmware: FirmwareLoops) -> str:
    """The firmware with its version."""
    return f"{firmware.name} {firmware.version}".strip()


def firmware_title(firmware: FirmwareLoops) -> str:
    """Head of the table."""
    return f"As {firmware_name(firmware)} runs it"


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "none"


def _decibel(factor: float) -> str:
    return f"{20.0 * math.log10(factor):.1f}" if math.isfinite(factor) else "none"


def _microseconds(time: float) -> str:
    """A time in s in microseconds: three digits, without an exponent."""
    return f"{float(f'{1e6 * time:.3g}'):.10g}" if math.isfinite(time) else "none"


def _row(loop: str, runner: str, gains: PiGains, unit: str, found: JudgedLoop) -> tuple[str, ...]:
    phase = f"{math.degrees(found.phase_margin):.1f}" if found.stable else "unstable"
    return (
        loop,
        runner,
        f"{gains.kp:.6g} {unit}",
        f"{gains.ki:.6g}",
        _number(found.crossover / (2.0 * math.pi)),
        phase,
        _decibel(found.gain_margin),
        _microseconds(found.delay_margin),
        f"{found.max_sensitivity:.2f}",
        f"{found.damping:.2f}",
    )


def _worst_row(found: LoopRobustness) -> tuple[str, ...]:
    return (
        "",
        "at worst",
        "",
        "",
        "",
        f"{math.degrees(found.phase_margin.value):.1f}",
        _decibel(found.gain_margin.value),
        _microseconds(found.delay_margin.value),
        f"{found.max_sensitivity.value:.2f}",
        "",
    )


def _rows(firmware: FirmwareLoops, loop: FirmwareLoop) -> Iterator[tuple[str, ...]]:
    of_firmware, of_header = _UNITS.get(loop.loop, ("V/A", "V/A"))
    yield _row(loop.loop, firmware.name, loop.gains, of_firmware, loop.judged)
    if loop.worst is not None:
        yield _worst_row(loop.worst)
    yield _row("", "the header", loop.own, of_header, loop.neutral)


def firmware_rows(firmware: FirmwareLoops) -> tuple[tuple[str, ...], ...]:
    """Each loop of the firmware, what it keeps at worst, and the same loop of the header."""
    return tuple(row for loop in firmware.loops for row in _rows(firmware, loop))


def pole_text(pole: complex) -> str:
    """A pole in rad/s."""
    if pole.imag == 0.0:
        return f"{pole.real:.4g}"
    return f"{pole.real:.4g} {'+' if pole.imag > 0.0 else '-'} {abs(pole.imag):.4g}j"


def firmware_notes(firmware: FirmwareLoops) -> tuple[str, ...]:
    """What is free, what was changed, the poles of the phase-locked loop, remarks, shortfalls."""
    notes = [f"free in {firmware.name}: {_FREE[firmware.free]}"]
    if any(loop.worst is not None for loop in firmware.loops):
        notes.append("at worst: over the corners of control.tolerances")
    notes += firmware.changes
    poles, speed = firmware.judged.pll_poles, firmware.profile.speed
    if poles is not None and speed is not None:
        feedback = speed.feedback
        notes.append(
            f"PLL of the speed: kp {feedback.kp:.6g} 1/s, ki {feedback.ki:.6g} 1/s^2, poles at "
            f"{' and '.join(map(pole_text, poles))} rad/s"
        )
    turning = firmware.judged.turning
    if turning is not None:
        notes.append(
            f"both current loops together up to the largest speed: largest pole modulus "
            f"{turning.radius:.5f}, at {in_rpm(turning.omega_m):.4g} rpm"
        )
    notes += firmware.judged.remarks
    notes += [f"cannot be held: {_shortfall(found)}" for found in firmware.shortfalls]
    return tuple(notes)


def _shortfall(found: Shortfall) -> str:
    prices = ", ".join(map(_price, found.prices))
    return f"{found.words} ({prices})" if prices else found.words


def _price(found: Price) -> str:
    if found.unit:
        return f"{found.of} {found.value:.4g} {found.unit}"
    return f"{found.of} {100.0 * found.value:.3g} %"


def firmware_words(firmware: FirmwareLoops) -> str:
    """Phase margins of all loops in a few words."""
    return ", ".join(
        f"{loop.loop} {math.degrees(loop.judged.phase_margin):.1f} deg"
        if loop.judged.stable
        else f"{loop.loop} unstable"
        for loop in firmware.loops
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _plain_judged(found: JudgedLoop) -> PlainData:
    return {
        "crossover_rad_per_s": _finite(found.crossover),
        "phase_margin_rad": _finite(found.phase_margin),
        "gain_margin": _finite(found.gain_margin),
        "delay_margin_s": _finite(found.delay_margin),
        "max_sensitivity": found.max_sensitivity,
        "bandwidth_rad_per_s": _finite(found.bandwidth),
        "damping": found.damping,
        "stable": found.stable,
        "poles": [[pole.real, pole.imag] for pole in found.poles.tolist()],
        "t_s": found.t_s,
    }


def _plain_loop(found: FirmwareLoop) -> PlainData:
    return {
        **asdict(found.gains),
        **_plain_judged(found.judged),
        "header": {**asdict(found.own), **_plain_judged(found.neutral)},
        "worst": None if found.worst is None else plain_loop_robustness(found.worst),
    }


def _plain_turning(found: TurningAxes | None) -> PlainData | None:
    if found is None:
        return None
    return {
        "largest_pole": found.radius,
        "omega_m_rad_per_s": found.omega_m,
        "unstable_from_rad_per_s": found.unstable_from,
    }


def plain_firmware(gains: GainSet) -> PlainData:
    """The loops of the firmware as plain data, in SI units; an empty mapping without one."""
    firmware = gains.firmware
    if firmware is None:
        return {}
    poles, loops = firmware.judged.pll_poles, {loop.loop: loop for loop in firmware.loops}
    speed = firmware.profile.speed
    feedback = None if speed is None or poles is None else speed.feedback
    return {
        "firmware": {
            "name": firmware.name,
            "version": firmware.version,
            "free": firmware.free,
            "i_d": _plain_loop(loops["i_d"]),
            "i_q": _plain_loop(loops["i_q"]),
            "speed": _plain_loop(loops["speed"]) if "speed" in loops else None,
            "pll": None if feedback is None else {"kp": feedback.kp, "ki": feedback.ki},
            "pll_poles": None if poles is None else [[pole.real, pole.imag] for pole in poles],
            "turning": _plain_turning(firmware.judged.turning),
            "remarks": list(firmware.judged.remarks),
            "changes": list(firmware.changes),
            "shortfalls": [
                {"words": found.words, "prices": [asdict(price) for price in found.prices]}
                for found in firmware.shortfalls
            ],
        }
    }


# What is proven of both current loops together, in words, comment lines and plain data.

_PARAMETERS = ("b_d", "b_q", "s_Ohm", "x")
_WIDTH = 100

# How the file of a certificate ends, behind the prefix of the design.
CERTIFICATE = "_stability.json"


def _between(values: tuple[float, float], scale: float = 1.0) -> str:
    low, high = (f"{value * scale:.4g}" for value in values)
    return low if low == high else f"{low} to {high}"


def _rpm(omega_e: float, pole_pairs: int) -> float:
    return in_rpm(omega_e / pole_pairs)


def proof_text(proof: CurrentLoopProof, pole_pairs: int) -> str:
    """What is proven, of which drives, and what is not; one sentence or two.

    Args:
        proof: The proof.
        pole_pairs: Of the machine, for its speeds.
    """
    if not proof.proven:
        return f"both current loops together: {_open_text(proof, pole_pairs)}"
    assert proof.confirmation is not None
    count = proof.confirmation.matrices
    cells = "one cell" if count == 1 else f"{count} cells"
    return (
        "both current loops together: proven stable for every drive in the box at every constant "
        f"speed up to {_rpm(proof.box.omega_e, pole_pairs):.4g} rpm either way ({cells}, confirmed "
        f"in interval arithmetic): {scope_text(proof)}"
    )


def _open_text(proof: CurrentLoopProof, pole_pairs: int) -> str:
    confirmation = proof.confirmation
    if confirmation is None or confirmation.fault or proof.still_open is None:
        return "not proven stable over the box; corners and points inside are"
    share = math.floor(proof.share * 1000.0) / 10.0
    return (
        f"proven stable for {share:.1f} % of the drives in the box ({confirmation.matrices} cells, "
        "confirmed in interval arithmetic), the rest not decided within the budget: too close to "
        "the border; nothing is "
        f"proven of drives with {_range_text(proof.still_open, pole_pairs)}; {scope_text(proof)}"
    )


def _range_text(left: DriveRange, pole_pairs: int) -> str:
    speeds = tuple(_rpm(omega, pole_pairs) for omega in left.omega_e)
    return (
        f"{_between(left.r_s)} Ohm, l_d {_between(left.l_d, 1e3)} mH, l_q "
        f"{_between(left.l_q, 1e3)} mH, voltage gain {_between(left.gain)} at "
        f"{_between((speeds[0], speeds[1]))} rpm"
    )


def scope_text(proof: CurrentLoopProof) -> str:
    """The drives that the proof is about, and what it leaves aside."""
    box = proof.box
    parts = [f"resistance {_between(box.r_s)} Ohm"]
    if box.dead_time != (0.0, 0.0):
        parts.append(f"dead time worth {_between(box.dead_time)} Ohm")
    parts += [
        f"l_d {_between(box.l_d, 1e3)} mH",
        f"l_q {_between(box.l_q, 1e3)} mH",
        f"voltage gain {_between(box.gain)}",
    ]
    return (
        f"{', '.join(parts)}, each constant; with the gains as they stand, without voltage limit "
        "and without rounding of the control"
    )


def proof_summary(proof: CurrentLoopProof) -> str:
    """What is proven in a few words."""
    if proof.proven:
        return "proven stable together for every drive within the tolerances"
    share = math.floor(proof.share * 1000.0) / 10.0
    return f"proven stable together for {share:.1f} % of the drives within the tolerances"


def drive_text(drive: BoxDrive, pole_pairs: int) -> str:
    """A drive in words: ``2000 rpm, 1.6 Ohm, l_d 1.3 mH, l_q 2.1 mH, voltage gain 1.1``."""
    return (
        f"{_rpm(drive.omega_e, pole_pairs):.4g} rpm, {drive.r_s:.4g} Ohm, "
        f"l_d {drive.l_d * 1e3:.4g} mH, l_q {drive.l_q * 1e3:.4g} mH, voltage gain {drive.gain:.4g}"
    )


def sensitivity_text(robust: RobustSet, pole_pairs: int) -> str:
    """Sensitivity of both axes together beside that of each alone; empty where it is not known."""
    found = None if robust.proof is None else robust.proof.sensitivity
    if found is None:
        return ""
    alone = max(robust.i_d.max_sensitivity.value, robust.i_q.max_sensitivity.value)
    least = f"sensitivity of both axes together up to {found.found:.2f} "
    least += f"({drive_text(found.at, pole_pairs)}), axis by axis up to {alone:.2f}"
    if found.bound is None:
        return f"{least}; a bound of the first is not decided within the budget"
    turn = math.degrees(2.0 * math.asin(min(1.0, 0.5 / found.bound)))
    return (
        f"{least}; proven below {found.bound:.4g}, so that voltages turned by any constant angle "
        f"up to {math.floor(10.0 * turn) / 10.0:.1f} deg leave the loops stable"
    )


def stability_notes(gains: GainSet, pole_pairs: int) -> tuple[str, ...]:
    """What is proven of both current loops over the tolerances; nothing without them."""
    robust = gains.robust
    if robust is None or gains.phases is not None:
        return ()
    if robust.proof is None:
        return ("both current loops together: not proven, machine.max_speed is not known",)
    notes = (proof_text(robust.proof, pole_pairs), sensitivity_text(robust, pole_pairs))
    return tuple(note for note in notes if note)


def stability_lines(gains: GainSet | None, pole_pairs: int) -> list[str]:
    """The same as comment lines of a header."""
    notes = () if gains is None else stability_notes(gains, pole_pairs)
    lines = []
    for note in notes:
        lines += textwrap.wrap(f"{note[0].upper()}{note[1:]}.", _WIDTH)
    return ["", *lines] if lines else []


def plain_stability(robust: RobustSet) -> PlainData | None:
    """What is proven as plain data; None where nothing was asked."""
    proof = robust.proof
    if proof is None or proof.confirmation is None:
        return None
    return {
        "proven": proof.proven,
        "share": proof.share,
        "matrices": proof.confirmation.matrices,
        "empty": proof.confirmation.empty,
        "open": proof.confirmation.left_open,
        "still_open": None if proof.still_open is None else _plain_range(proof.still_open),
        "sensitivity": _plain_sensitivity(proof.sensitivity),
        "inputs": asdict(proof.box),
    }


def _plain_sensitivity(found: ProvenSensitivity | None) -> PlainData | None:
    if found is None:
        return None
    at = {
        "r_s_Ohm": found.at.r_s,
        "l_d_H": found.at.l_d,
        "l_q_H": found.at.l_q,
        "voltage_gain": found.at.gain,
        "omega_e_rad_per_s": found.at.omega_e,
    }
    return {"found": found.found, "at": at, "bound": found.bound}


def _plain_range(left: DriveRange) -> PlainData:
    return {
        "r_s_Ohm": left.r_s,
        "l_d_H": left.l_d,
        "l_q_H": left.l_q,
        "voltage_gain": left.gain,
        "omega_e_rad_per_s": left.omega_e,
    }


def certificate_bytes(proof: CurrentLoopProof) -> bytes:
    """A certificate as a file: JSON with a line per cell."""
    assert proof.certificate is not None
    parts = [
        json.dumps({"format": 1, "parameters": list(_PARAMETERS)})[1:-1],
        f'"inputs": {json.dumps(proof.certificate["inputs"])}',
        f'"tree": {_stability_text_rows(proof.certificate["tree"])}',
    ]
    found = proof.sensitivity
    if found is not None and found.certificate is not None:
        bound, tree = json.dumps(found.bound), _stability_text_rows(found.certificate["tree"])
        parts.append(f'"sensitivity": {{"bound": {bound}, "tree": {tree}}}')
    return ("{\n" + ",\n".join(parts) + "\n}\n").encode("ascii")


def _stability_text_rows(tree: list[Any]) -> str:
    rows = ",\n".join(json.dumps(verdict) for verdict in tree)
    return f"[\n{rows}\n]"


# What the loops keep over the tolerances, and their gains in three forms: rows of text,
# comment lines, plain data.

FORM_COLUMNS = (
    "loop",
    "parallel: kp",
    "ki t_s",
    "series: T_i",
    "velocity: q0 = kp + ki t_s",
    "q1 = -kp",
    "anti-windup 1/s",
)


ROBUST_COLUMNS = ("loop", "margin", "worst", "at")


def form_rows(gains: GainSet) -> tuple[tuple[str, ...], ...]:
    """Each loop's gains in parallel, series and velocity form.

    All but the times in the unit of kp.
    """
    return tuple(
        (
            loop.loop,
            f"{loop.kp:.6g}",
            f"{loop.ki_ts:.6g}",
            f"{loop.t_i * 1e3:.5g} ms",
            f"{loop.velocity[0]:.6g}",
            f"{loop.velocity[1]:.6g}",
            f"{loop.anti_windup:.5g}",
        )
        for loop in gains.loops
    )


def _robustness_text_decibel(factor: float) -> str:
    return f"{20.0 * math.log10(factor):.1f} dB" if math.isfinite(factor) else "none"


def _loops(robust: RobustSet) -> list[tuple[str, LoopRobustness]]:
    named = (
        ("i_d", robust.i_d),
        ("i_q", robust.i_q),
        ("i_0", robust.i_0),
        ("speed", robust.speed),
    )
    return [(name, loop) for name, loop in named if loop is not None]


def rotating_words(found: RotatingAxes | None) -> list[str]:
    """Both current loops together on the data alone, where they are unstable within the speeds."""
    if found is None or found.stable_to is None:
        return []
    axes = ", ".join(
        f"{name} is {format_quantity(value, 'H', 3)} (the decoupling uses "
        f"{format_quantity(used, 'H', 3)})"
        for name, value, used in zip(("l_d", "l_q"), found.needed, found.decoupled, strict=True)
        if abs(value - used) > 1e-3 * used
    )
    ways = "raise control.sampling_frequency"
    if found.better is not None:
        ways = f"{found.better} the bandwidth of the current loops, {ways}"
    return [
        f"both current loops together are unstable above {in_rpm(found.stable_to):.5g} rpm"
        + (f", where {axes}" if axes else "")
        + f"; {ways}, or write a smaller machine.max_speed"
    ]


def plain_rotating(found: RotatingAxes | None) -> PlainData | None:
    """The same as plain data."""
    if found is None:
        return None
    return {
        "largest_pole": found.radius,
        "at": found.at,
        "stable_to_rad_per_s": found.stable_to,
    }


def worst_words(robust: RobustSet) -> str:
    """The least phase margin of all loops over the tolerances, with its loop and corner."""
    name, loop = min(_loops(robust), key=lambda pair: pair[1].phase_margin.value)
    worst = loop.phase_margin
    margin = f"{math.degrees(worst.value):.1f} deg"
    return f"the least phase margin over the tolerances is {margin}: {name} loop at {worst.at}"


def robust_rows(robust: RobustSet) -> tuple[tuple[str, ...], ...]:
    """The worst of each margin with its corner, loop by loop."""
    rows: list[tuple[str, ...]] = []
    for name, loop in _loops(robust):
        texts = (
            (
                "phase margin",
                f"{math.degrees(loop.phase_margin.value):.1f} deg",
                loop.phase_margin.at,
            ),
            ("gain margin", _robustness_text_decibel(loop.gain_margin.value), loop.gain_margin.at),
            ("delay margin", f"{loop.delay_margin.value * 1e6:.3g} us", loop.delay_margin.at),
            ("M_s", f"{loop.max_sensitivity.value:.3f}", loop.max_sensitivity.at),
            ("largest pole", f"{loop.radius.value:.6f}", loop.radius.at),
        )
        rows += [(name if place == 0 else "", *text) for place, text in enumerate(texts)]
    if robust.turning is not None:
        rows.append(
            (
                "both axes, rotating",
                "largest pole",
                f"{robust.turning.value:.6f}",
                robust.turning.at,
            )
        )
    return tuple(rows)


def limits_text(robust: RobustSet) -> str:
    """The box in words: ``r_s -10 to +30 %, dead_time 0 to +2 us``."""
    parts = []
    for name, low, high in robust.limits:
        scale, unit = (1e6, "us") if name == "dead_time" else (100.0, "%")
        below, above = (f"{scale * side:+.3g}" if side else "0" for side in (low, high))
        parts.append(f"{name} {below} to {above} {unit}")
    return ", ".join(parts)


def robust_notes(robust: RobustSet) -> tuple[str, ...]:
    """The box, how many drives were tried, and whether one inside the box
    was worse than all corners.
    """
    counts = ", ".join(f"{name} {loop.corners} and {loop.samples}" for name, loop in _loops(robust))
    worse = [name for name, loop in _loops(robust) if loop.inside_worse]
    inside = (
        f"a point inside was worse than every corner: {', '.join(worse)}"
        if worse
        else "none inside was worse than a corner"
    )
    box = (f"tolerances: {limits_text(robust)}",) if robust.limits else ()
    return (*box, f"corners and points inside that were checked: {counts}; {inside}")


def robust_lines(gains: GainSet, loop: str) -> list[str]:
    """Comment lines of a header on what a loop keeps over the tolerances; none without them."""
    found = {} if gains.robust is None else dict(_loops(gains.robust))
    if loop not in found:
        return []
    kept = found[loop]
    phase, gain = (
        math.degrees(kept.phase_margin.value),
        _robustness_text_decibel(kept.gain_margin.value),
    )
    return [
        f"Within the tolerances at least {phase:.1f} deg phase margin and {gain} gain margin,",
        f"M_s at most {kept.max_sensitivity.value:.2f} ({kept.max_sensitivity.at}).",
    ]


def plain_loop_robustness(loop: LoopRobustness) -> PlainData:
    """Worst margins of one loop as plain data, in SI units."""
    units = {
        "phase_margin": "phase_margin_rad",
        "delay_margin": "delay_margin_s",
        "radius": "largest_pole",
    }
    return {units.get(key, key): value for key, value in asdict(loop).items()}


def plain_robustness(robust: RobustSet | None) -> PlainData:
    """Worst margins of every loop as plain data; an empty mapping without tolerances."""
    if robust is None:
        return {}
    plain: PlainData = {"i_d": None, "i_q": None, "speed": None}
    for name, loop in _loops(robust):
        plain[name] = plain_loop_robustness(loop)
    plain["both_turning"] = (
        None if robust.turning is None else {"largest_pole": asdict(robust.turning)}
    )
    plain["stability"] = plain_stability(robust)
    plain["limits"] = {
        "dead_time_s" if name == "dead_time" else name: [low, high]
        for name, low, high in robust.limits
    }
    return {"tolerances": plain}


def robust_text(kept: LoopRobustness) -> str:
    """Least phase margin and largest M_s over the tolerances in a few words."""
    return (
        f"phase margin {math.degrees(kept.phase_margin.value):.1f} deg or more "
        f"({kept.phase_margin.at}), M_s {kept.max_sensitivity.value:.2f} or less"
    )


# Gains over the current as rows of text, notes and plain data.

SCHEDULE_COLUMNS = (
    "loop",
    "i_q A",
    "inductance mH",
    "kp V/A",
    "ki t_s V/A",
    "crossover Hz",
    "phase margin deg",
    "M_s",
    "constant gains: crossover Hz",
    "phase margin deg",
    "M_s",
)


_SHOWN = 6


def _margin_cells(axis: AxisSchedule, row: int) -> list[str]:
    cells = []
    for margins in (axis.scheduled, axis.constant):
        cells += [
            f"{margins.crossover[row] / (2.0 * math.pi):.4g}",
            f"{math.degrees(abs(margins.phase_margin[row])):.1f}",
            f"{margins.max_sensitivity[row]:.2f}",
        ]
    return cells


def schedule_rows(schedule: GainSchedule) -> tuple[tuple[str, ...], ...]:
    """Gains and margins of both axes at a few currents, beside those of the constant gains."""
    rows = []
    places = np.unique(np.linspace(0, schedule.i_q.size - 1, _SHOWN).round().astype(int)).tolist()
    emitted = schedule.fit.evaluator.gains(schedule.i_q.astype(np.float32))
    for column, axis in enumerate(schedule.axes):
        for place in places:
            start = [
                axis.axis if place == 0 else "",
                f"{schedule.i_q[place]:.4g}",
                f"{axis.inductance[place] * 1e3:.4g}",
            ]
            gains = [
                f"{value:.5g}" for value in emitted[place, 2 * column : 2 * column + 2].tolist()
            ]
            rows.append((*start, *gains, *_margin_cells(axis, place)))
    return tuple(rows)


def schedule_lines(schedule: GainSchedule) -> list[str]:
    """How the gains are evaluated, how far they may be off, and the least
    margins with and without them.
    """
    fit, evaluator = schedule.fit, schedule.fit.evaluator
    kind = (
        f"a table of {next(iter(evaluator.tables.values())).size} currents"
        if evaluator.tables
        else "polynomials"
    )
    kind = kind if evaluator.tables or evaluator.polynomials else "constant"
    others = [
        f"{form} {size} B"
        for form, size in fit.flash.items()
        if size is not None and form != evaluator.form
    ]
    than = f" ({', '.join(others)})" if others else ""
    error = rounded_up(100.0 * max(fit.errors.values()), 2)
    lines = [
        (
            f"Gains over |i_q| are {kind}, about {evaluator.flash} bytes{than}; off by at most "
            f"{error} %."
        )
    ]
    for axis in schedule.axes:
        least = [float(np.min(np.abs(m.phase_margin))) for m in (axis.scheduled, axis.constant)]
        slowest = [
            float(np.nanmin(m.crossover)) / (2.0 * math.pi) for m in (axis.scheduled, axis.constant)
        ]
        lines.append(
            f"{axis.axis}: least phase margin {math.degrees(least[0]):.1f} deg "
            f"(constant gains {math.degrees(least[1]):.1f}), slowest crossover {slowest[0]:.4g} Hz "
            f"({slowest[1]:.4g})."
        )
    return lines


def schedule_notes(schedule: GainSchedule) -> tuple[str, ...]:
    """The lines of `schedule_lines`, and what holds over the tolerances and off the reference."""
    notes = [line.rstrip(".") for line in schedule_lines(schedule)]
    for axis in schedule.axes:
        phase, pole = axis.off_reference
        notes.append(
            f"{axis.axis}: from the reference to the end of field weakening phase margin "
            f"{math.degrees(phase):.1f} deg or more, largest pole {pole:.4f}"
        )
        if axis.robust is not None:
            notes.append(
                f"{axis.axis}: at all currents within control.tolerances {robust_text(axis.robust)}"
            )
    return tuple(notes)


def plain_schedule(schedule: GainSchedule | None) -> PlainData:
    """Currents, gains and margins of both axes as plain data.

    An empty mapping without a schedule.
    """
    if schedule is None:
        return {}
    plain: PlainData = {
        "i_d_A": schedule.i_d,
        "i_q_A": schedule.i_q,
        "form": schedule.fit.evaluator.form,
        "flash_B": schedule.fit.evaluator.flash,
        "flash_of_forms_B": dict(schedule.fit.flash),
        "errors": dict(schedule.fit.errors),
    }
    for axis in schedule.axes:
        of_axis: PlainData = {"inductance_H": axis.inductance, "kp": axis.kp, "ki": axis.ki}
        for name, margins in (("scheduled", axis.scheduled), ("constant", axis.constant)):
            of_axis[name] = {
                "crossover_rad_per_s": margins.crossover,
                "phase_margin_rad": margins.phase_margin,
                "gain_margin": margins.gain_margin,
                "max_sensitivity": margins.max_sensitivity,
                "largest_pole": margins.radius,
            }
        of_axis["off_reference"] = {
            "phase_margin_rad": axis.off_reference[0],
            "largest_pole": axis.off_reference[1],
        }
        if axis.robust is not None:
            of_axis["tolerances"] = plain_loop_robustness(axis.robust)
        plain[axis.axis] = of_axis
    return {"schedule": plain}
