"""Figure of docs/methods/fixed-point-control.md: what the roundings of a controller do,
and how far its words are used.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.fixed_control.transforms import FixedPi, Pi, pi_gains, pi_step
from dqforge.optimizer.steps.integer_arithmetic import Integers, Reach
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, new_figure, save, style

_ASKED_A = 0.4
_SAMPLES = 4000


def _course(design: Design, pi: FixedPi, *, as_printed: bool) -> FloatArray:
    """i_q in A at standstill, (samples,): with the emitted controller, or with one
    word and shifts downwards.
    """
    bases, machine = design.control.bases, design.machine
    decay = math.exp(-machine.r_s * design.control.t_s / machine.l_q)
    current, waiting, found = 0.0, 0.0, np.empty(_SAMPLES)
    state, gains = Pi(np.zeros((), dtype=np.int64)), pi_gains(16, pi)
    output, last = 0, 0
    limit, wanted = np.array(13_000), round(_ASKED_A / bases.current * 2**15)
    for k in range(_SAMPLES):
        found[k] = current
        error = wanted - round(current / bases.current * 2**15)
        if as_printed:
            output += (pi.kp.mantissa * (error - last) >> pi.kp.shift) + (
                pi.ki.mantissa * error >> pi.ki.shift + pi.fraction
            )
            last = error
        else:
            output = int(pi_step(Integers(), gains, state, np.array(error), limit))
        current = decay * current + (1.0 - decay) / machine.r_s * waiting
        waiting = output / 2**15 * bases.voltage
    return found


def _fullest(fit: FixedControlFit, count: int) -> list[Reach]:
    """The fullest quantity of each kind, by the share of its word."""
    kinds: dict[str, Reach] = {}
    for reach in fit.reaches:
        name = reach.name.split(": ", 1)[1]
        if name not in kinds or kinds[name].share < reach.share:
            kinds[name] = reach
    return sorted(kinds.values(), key=lambda reach: -reach.share)[:count]


@style()
def integers_of_a_loop(path: Path) -> None:
    """Draw the thesis' current loop with its own arithmetic and with the emitted one,
    and the use of the words.
    """
    design = catalogue.load("paper001-pmsm-bench")
    gains = solve_gains(design)
    fit = fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, 16)
    figure = new_figure(
        "fixed-control", 3.4, "A step with two arithmetics, and the use of the words", arranged=True
    )
    left, right = figure.subplots(1, 2)
    time = np.arange(_SAMPLES) * design.control.t_s
    pi = fit.control.i_q["parallel"]
    for as_printed, colour, label in (
        (True, ORANGE, "one word, rounded down"),
        (False, BLUE, "as emitted"),
    ):
        left.plot(
            time,
            _course(design, pi, as_printed=as_printed),
            color=colour,
            linewidth=1.0,
            label=label,
        )
    left.axhline(_ASKED_A, color=MUTED, linewidth=0.8, zorder=0)
    left.set(title="Step to 0.4 A", xlabel="Time in s", ylabel="$i_q$ in A")
    left.legend(loc="lower right", bbox_to_anchor=(1.0, 0.05))
    shown = _fullest(fit, 14)[::-1]
    right.barh(
        [reach.name for reach in shown], [100.0 * reach.share for reach in shown], color=BLUE
    )
    right.axvline(100.0, color=MUTED, linewidth=0.8, linestyle="--")
    right.set(title="Use of the words", xlabel="Proven largest magnitude in % of 32 bits")
    right.tick_params(axis="y", labelsize=6.5)
    right.grid(visible=False, axis="y")
    save(figure, path)


if __name__ == "__main__":
    integers_of_a_loop(Path(__file__).resolve().parents[1] / "figures" / "fixed-control.svg")
