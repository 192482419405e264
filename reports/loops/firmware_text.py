"""The loops as the firmware that a design names runs them: rows of text, words, plain data."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.reports.loops.robustness_text import plain_loop_robustness

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.firmware.configuration import PiGains
    from dqforge.optimizer.firmware.firmware_loops import FirmwareLoop, FirmwareLoops
    from dqforge.optimizer.firmware.firmware_method import Price, Shortfall
    from dqforge.optimizer.firmware.judge import JudgedLoop
    from dqforge.optimizer.firmware.turning_axes import TurningAxes
    from dqforge.optimizer.loops.robustness import LoopRobustness
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
            f"{turning.radius:.5f}, at {turning.omega_m * 30.0 / math.pi:.4g} rpm"
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
