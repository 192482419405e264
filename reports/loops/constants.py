"""Constants of the control loops for the main header."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_constant import Constant, ConstantGroup
from dqforge.reports.loops.robustness_text import robust_lines
from dqforge.reports.observers.speed_loop_text import observed_notes

if TYPE_CHECKING:
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.solution import Solution

_COMMENT_WIDTH = 110

_TITLES = {
    "i_d": "PI controller of i_d",
    "i_q": "PI controller of i_q",
    "speed": "PI controller of the speed (its output is torque)",
}

_UNITS = {
    "i_d": ("V/A", "V/(A s)"),
    "i_q": ("V/A", "V/(A s)"),
    "speed": ("N m s/rad", "N m/rad"),
}

_BASES = {
    "i_d": "base.voltage / base.current",
    "i_q": "base.voltage / base.current",
    "speed": "base.torque / base.speed",
}


def margin_text(gains: LoopGains) -> list[str]:
    """Two lines that say how good a loop is, in engineering units."""
    gain_margin = (
        20.0 * math.log10(gains.gain_margin) if math.isfinite(gains.gain_margin) else math.inf
    )
    crossover = gains.crossover / (2.0 * math.pi)
    phase_margin = math.degrees(gains.phase_margin)
    pole, delay = abs(gains.poles[0]), gains.delay_margin_samples
    seen = [
        line
        for note in observed_notes(gains)
        for line in textwrap.wrap(f"{note[0].upper()}{note[1:]}.", _COMMENT_WIDTH)
    ]
    return [
        *seen,
        (
            f"Crossover {crossover:.4g} Hz, phase margin {phase_margin:.1f} deg, gain margin "
            f"{gain_margin:.1f} dB,"
        ),
        (
            f"delay margin {delay:.2f} samples, largest pole {pole:.6f}, M_s "
            f"{gains.max_sensitivity:.2f}."
        ),
    ]


def _codes(loop: str, scaled: PerUnitGains) -> list[Constant]:
    """The gains per unit as whole numbers, where the design asks for them."""
    return [
        Constant(
            f"{loop}.{symbol}_code",
            number.mantissa,
            "",
            f"per unit times 2^{number.shift}",
            bits=number.shift,
        )
        for symbol, number in zip(("kp", "ki_ts"), scaled.integers or (), strict=False)
    ]


def _controller(
    gains: LoopGains, scaled: PerUnitGains, robust: list[str], ratio: int | None = None
) -> ConstantGroup:
    """One PI controller.

    ``scaled`` are the same gains per unit, ``robust`` the lines on the tolerances, ``ratio`` the
    current samples per sample of the loop where these differ.
    """
    loop, base = gains.loop, _BASES[gains.loop]
    kp, ki = _UNITS[loop]
    samples = "current samples per speed sample"
    velocity = "velocity form d[k] = d[k-1] + q0 e[k] + q1 e[k-1]"
    scaled_ki = "integral gain times sampling period"
    constants = [
        *([] if ratio is None else [Constant(f"{loop}.ratio", ratio, "", samples)]),
        Constant(f"{loop}.kp", gains.kp, kp, "proportional gain"),
        Constant(f"{loop}.ki", gains.ki, ki, "integral gain"),
        Constant(f"{loop}.ki_ts", gains.ki_ts, kp, scaled_ki),
        Constant(f"{loop}.t_i", gains.t_i, "s", "integral time kp/ki of the series form"),
        Constant(f"{loop}.q0", gains.velocity[0], kp, velocity),
        Constant(f"{loop}.q1", gains.velocity[1], kp, "its factor of e[k-1]"),
        Constant(f"{loop}.anti_windup", gains.anti_windup, "1/s", "back-calculation gain"),
        Constant(f"{loop}.kp_pu", scaled.kp, "per unit", "proportional gain", base=base),
        Constant(f"{loop}.ki_ts_pu", scaled.ki_ts, "per unit", scaled_ki, base=base),
        *_codes(loop, scaled),
    ]
    every = f"sampled every {gains.t_s * 1e6:.6g} us"
    return ConstantGroup(
        f"{_TITLES[loop]}: method {gains.method}, {every}",
        tuple(constants),
        ("d[k] = d[k-1] + kp (e[k] - e[k-1]) + ki_ts e[k]", *margin_text(gains), *robust),
    )


def loop_constants(solution: Solution) -> list[ConstantGroup]:
    """Sampling period and controllers, or why there are none."""
    control, gains = solution.design.control, solution.loops
    if gains is None:
        why = textwrap.wrap(solution.gains_left_out, _COMMENT_WIDTH)
        return [ConstantGroup("No controllers", comment=tuple(why))]
    period = Constant("sampling.period", control.t_s, "s", "sampling period of the current control")
    groups = [
        ConstantGroup("Sampling", (period,)),
        _controller(gains.i_d, gains.per_unit["i_d"], robust_lines(gains, "i_d")),
        _controller(gains.i_q, gains.per_unit["i_q"], robust_lines(gains, "i_q")),
    ]
    if gains.speed is not None and control.speed_loop is not None:
        lines, ratio = robust_lines(gains, "speed"), control.speed_loop.ratio
        groups.append(_controller(gains.speed, gains.per_unit["speed"], lines, ratio))
    return groups
