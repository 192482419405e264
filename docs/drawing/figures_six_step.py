"""Figure of the page on six-step drives: a start from standstill, and its commutations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dqforge.machines.design.catalogue import load_design
from dqforge.optimizer.six_step.design import solve_six_step
from dqforge.reports.pages.figures_style import INK, new_figure, save, style
from dqforge.reports.six_step.drive_run import commutations, simulate_six_step

_EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "six-step-drive.yaml"
_RPM = 30.0 / math.pi


@style()
def start(path: Path) -> None:
    """Speed of the example from standstill on, two turns of its currents, and how late each
    commutation was beside the formula.
    """
    design = load_design(_EXAMPLE)
    made = solve_six_step(design)
    assert made is not None
    run = simulate_six_step(design, found=made).run
    assert run.phases is not None
    changed, late = commutations(made, run)
    figure = new_figure(
        "six-step-start", 5.4, "A start, its currents, and how late commutations are", arranged=True
    )
    speed, currents, errors = figure.subplots(3, 1)

    speed.plot(run.t[::20], run.omega_m[::20] * _RPM, label="speed")
    speed.plot(run.t[::20], run.omega_m_observed[::20] * _RPM, linewidth=0.8, label="estimated")
    speed.plot(
        run.t[::20], run.reference[::20] * _RPM, ":", color=INK, linewidth=0.8, label="reference"
    )
    speed.set(xlabel="Time in s", ylabel="Speed in rpm", xlim=(0.0, float(run.t[-1])))
    speed.legend()

    shown = (run.t > 1.9) & (run.t < 1.9 + 4.0 * math.pi / (3.0 * float(run.omega_m[-1])))
    time = 1e3 * (run.t[shown] - 1.9)
    for phase, name in enumerate("abc"):
        currents.plot(time, run.phases.i_phases[shown, phase], linewidth=1.0, label=name)
    currents.set(xlabel="Time from 1.9 s on in ms", ylabel="Phase currents in A")
    currents.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0)

    omega = 3.0 * np.abs(run.omega_m[changed])
    hertz = omega / (2.0 * math.pi)
    errors.plot(hertz, np.degrees(late), ".", markersize=2.5, label="commutations")
    bound = np.degrees(made.curve.largest)
    for sign in (1.0, -1.0):
        errors.plot(
            made.curve.omega / (2.0 * math.pi), sign * bound, color=INK, linewidth=0.8,
            label="formula" if sign > 0.0 else None,
        )  # fmt: skip
    errors.set(
        xlabel="Electrical frequency in Hz",
        ylabel="Late in deg",
        xlim=(0.0, 1.1 * float(np.max(hertz))),
        ylim=(-8.0, 8.0),
    )
    errors.legend()
    save(figure, path)
