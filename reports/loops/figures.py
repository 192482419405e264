"""Figure of the control loops: step responses of the sampled closed loops and the
Bode plot of the open ones.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.reports.c_code.harness import Constant, ConstantGroup
from dqforge.reports.loops.firmware_text import robust_lines
from dqforge.reports.observers.speed_loop_text import observed_notes
from dqforge.reports.pages.figures_style import (
    INK,
    LOOP_COLOURS,
    MUTED,
    PAPER,
    new_figure,
    prefixed,
    style,
    thinned,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.integer_gains import LoopResponse, PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.solution import Solution


_DASHES: dict[str, Any] = {"i_d": "-", "i_q": (0, (4.0, 1.6)), "i_0": ":", "speed": "-"}


_LABELS = {"i_d": "$i_d$", "i_q": "$i_q$", "i_0": "$i_0$", "speed": "speed"}


_PHASE_FLOOR = -315.0


def _draw_steps(axes: Axes, curves: Sequence[LoopResponse], title: str) -> None:
    end = max(float(curve.step.times[-1]) for curve in curves)
    factor, unit = prefixed(end, "s")
    axes.axhline(1.0, color=MUTED, linewidth=0.7)
    for curve in curves:
        name = curve.gains.loop
        axes.plot(
            *thinned(curve.step.times * factor, curve.step.reference, 300),
            color=LOOP_COLOURS[name],
            linestyle=_DASHES[name],
            label=_LABELS[name] if len(curves) > 1 else f"_{_LABELS[name]}",
        )
    axes.set(
        title=title,
        xlabel=f"Time in {unit}",
        ylabel="Response per unit step",
        xlim=(0.0, end * factor),
    )
    axes.set_ylim(bottom=0.0)
    if len(curves) > 1:
        axes.legend(loc="lower right", frameon=False, fontsize=8, handlelength=2.6)


def _draw_bode(magnitude: Axes, phase: Axes, curves: Sequence[LoopResponse]) -> None:
    for curve in curves:
        name, crossover = curve.gains.loop, curve.gains.crossover / (2.0 * np.pi)
        look: dict[str, Any] = {
            "color": LOOP_COLOURS[name],
            "linestyle": _DASHES[name],
            "label": f"_{_LABELS[name]}",
        }
        mark = f"_crossover of {_LABELS[name]}"
        magnitude.plot(curve.frequency, 20.0 * np.log10(curve.gain), **look)
        magnitude.plot(
            [crossover], [0.0], "o", color=LOOP_COLOURS[name], markersize=4, zorder=4, label=mark
        )
        phase.plot(curve.frequency, curve.phase, **look)
        phase.plot(
            [crossover] * 2,
            [-180.0, curve.phase_at_crossover],
            color=LOOP_COLOURS[name],
            linewidth=2.4,
            label="_",
        )
        phase.plot(
            [crossover],
            [curve.phase_at_crossover],
            "o",
            color=LOOP_COLOURS[name],
            markersize=4,
            zorder=4,
            label=mark,
        )
    magnitude.axhline(0.0, color=MUTED, linewidth=0.8)
    top = 5.0 + 20.0 * float(np.log10(max(np.max(curve.gain) for curve in curves)))
    magnitude.set(title="Open loops", ylabel="Magnitude in dB", ylim=(-45.0, top))
    highest = max(float(np.max(curve.phase)) for curve in curves)
    phase.axhline(-180.0, color=INK, linewidth=0.8)
    phase.set(
        xlabel="Frequency in Hz",
        ylabel="Phase in degrees",
        ylim=(_PHASE_FLOOR, max(-60.0, highest + 12.0)),
    )
    phase.set_yticks(np.arange(-270.0, max(-60.0, highest + 12.0), 45.0))
    phase.set_xscale("log")
    low = min(float(curve.frequency[0]) for curve in curves)
    phase.set_xlim(low, max(float(curve.frequency[-1]) for curve in curves))
    _write_margins(phase, curves)


def _frequency(value: float) -> str:
    return f"{value / 1e3:.3g} kHz" if value >= 1e3 else f"{value:.3g} Hz"


def _write_margins(axes: Axes, curves: Sequence[LoopResponse]) -> None:
    """Phase margins in the lower left, where no loop with at most two integrators has its phase."""
    lines = [("phase margins", INK)]
    for curve in curves:
        gains = curve.gains
        margin, crossover = (
            np.degrees(gains.phase_margin),
            _frequency(gains.crossover / (2.0 * np.pi)),
        )
        lines.append(
            (f"{_LABELS[gains.loop]}: {margin:.1f}\u00b0 at {crossover}", LOOP_COLOURS[gains.loop])
        )
    for row, (text, colour) in enumerate(reversed(lines)):
        axes.text(
            0.03,
            0.04 + 0.09 * row,
            text,
            transform=axes.transAxes,
            color=colour,
            fontsize=7.5,
            fontweight="bold",
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
        )


def _frequency_tick(value: float, _position: int | None = None) -> str:
    return f"{value / 1e3:g}k" if value >= 1e3 else f"{value:g}"


def plot_gains(gains: GainSet) -> Figure:
    """Step responses of the current loops and the speed loop, and the open loops with
    crossovers and phase margins.
    """
    from matplotlib.ticker import FuncFormatter, NullLocator

    curves = gains.responses()
    with style():
        figure = new_figure(
            "loops", 5.0, "Step responses of the control loops and Bode plot of the open loops"
        )
        grid = figure.add_gridspec(
            2,
            2,
            left=0.08,
            right=0.98,
            bottom=0.085,
            top=0.945,
            wspace=0.24,
            hspace=0.42,
            width_ratios=[1.0, 1.25],
        )
        currents = [curve for curve in curves if curve.gains.loop != "speed"]
        speed = [curve for curve in curves if curve.gains.loop == "speed"]
        current = figure.add_subplot(grid[0, 0] if speed else grid[:, 0])
        _draw_steps(current, currents, "Current step")
        if speed:
            _draw_steps(figure.add_subplot(grid[1, 0]), speed, "Speed step")
        bode = grid[:, 1].subgridspec(2, 1, hspace=0.1, height_ratios=[1.0, 1.15])
        magnitude = figure.add_subplot(bode[0])
        phase = figure.add_subplot(bode[1], sharex=magnitude)
        magnitude.tick_params(labelbottom=False)
        _draw_bode(magnitude, phase, curves)
        phase.xaxis.set_major_formatter(FuncFormatter(_frequency_tick))
        phase.xaxis.set_minor_locator(NullLocator())
    return figure


# Constants of the control loops for the main header.

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
