"""Figure of the page on the loops of firmware: a speed loop behind three estimates of the speed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    Mechanics,
    PiController,
    SpeedController,
    SpeedEstimate,
    Winding,
    speed_loop,
)
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import constant_input_states, loop_margins
from dqforge.reports.pages.figures_style import MUTED, new_figure, save, style

# 48 V, 60 rpm/V (line to line, peak), 100 mOhm and 200 uH line to line, 15 pole pairs.
_WINDING = Winding(0.05, 1e-4)
_INERTIA = 2e-3
_CONSTANT = 1.5 * 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * 60.0)
_T_C, _T_N = 50e-6, 1e-3
_PI = PiController(2e3 * math.pi * 1e-4, 2e3 * math.pi * 0.05, _T_C)
_CURRENT = CurrentLoops(_PI, _PI, back_emf=True)
_FEEDBACKS = {
    "the speed itself": SpeedEstimate("ideal", _T_C),
    "PLL 2000 / 1e6": SpeedEstimate("pll", _T_C, 2000.0, 1e6),
    "PLL 2000 / 30000": SpeedEstimate("pll", _T_C, 2000.0, 30000.0),
}


def _loop(feedback: SpeedEstimate, omega: float) -> PiLoop:
    kp = omega * _INERTIA / _CONSTANT
    speed = SpeedController(PiController(kp, kp * omega / 8.0, _T_N), feedback)
    mechanics = Mechanics(_INERTIA, 0.0, _CONSTANT, 0.0)
    return speed_loop(_WINDING, mechanics, _CURRENT, speed)


def _margin(loop: PiLoop) -> float:
    """Phase margin in deg, nan of an unstable loop."""
    stable = abs(loop.closed.poles[0]) < 1.0
    return math.degrees(loop_margins(loop.open_loop).phase_margin) if stable else math.nan


@style()
def firmware_loops(path: Path) -> None:
    """Phase margin over the bandwidth that is requested, and steps of the speed at 30.9 Hz."""
    figure = new_figure(
        "firmware-loops",
        2.9,
        "Phase margin over the bandwidth, and steps of the speed",
        arranged=True,
    )
    left, right = figure.subplots(1, 2)
    hertz = np.geomspace(0.5, 120.0, 70)
    for label, feedback in _FEEDBACKS.items():
        margins = [_margin(_loop(feedback, 2.0 * math.pi * float(f))) for f in hertz]
        left.semilogx(hertz, margins, label=label)
        closed = _loop(feedback, 194.0).closed
        states = constant_input_states(closed, np.array([1.0, 0.0]), 200)
        times = 1e3 * _T_N * np.arange(len(states))
        # The drive's speed itself: after both integrals and the current.
        right.step(times, states[:, 3], where="post", label=label)
    left.axhline(0.0, color=MUTED, linewidth=0.8)
    left.set(xlabel="Requested bandwidth in Hz", ylabel="Phase margin in deg", ylim=(-40.0, 90.0))
    left.legend(loc="lower left")
    right.set(xlabel="Time in ms", ylabel="Speed after a step of 1 rad/s", ylim=(-1.0, 3.0))
    save(figure, path)
