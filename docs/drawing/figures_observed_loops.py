"""Figure of the page on speed loops and observers judged as one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.speed_range import SpeedPi, corner_box, worst_corner
from dqforge.reports.pages.figures_style import MUTED, new_figure, save, style

_BOX = "tolerances: {r_s: 30 %, psi_pm: 4 %, inertia: 20 %}"


def _design(observer: str) -> Design:
    text = catalogue.template().decode().replace("    spread: 3\n", "")
    text = text.replace("    pole: 400 rad/s\n", f"{observer}  {_BOX}\n")
    return load_text(text.encode(), "template.yaml")


@style()
def corners_over_speed(path: Path) -> None:
    """Largest pole of all corners of the template on its flux observer, three shares of speed."""
    figure = new_figure("observed-loops", 2.9, "Largest pole of all corners", arranged=True)
    ax = figure.subplots()
    for gain in (0.2, 0.5, 1.0):
        design = _design(f"    method: flux\n    speed_gain: {gain:g}\n")
        gains, loop = solve_gains(design), design.control.speed_loop
        assert gains.position is not None
        assert gains.speed is not None
        assert loop is not None
        drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
        corners = corner_box(design).corners(dead_time=False)
        pi = SpeedPi(gains.speed.kp, gains.speed.ki, loop.ratio)
        omega = np.geomspace(0.03, 1.0, 40) * top_speed(design)
        radius = [
            worst_corner(drive, drive.data.machine, pi, corners, speed).radius
            for speed in omega.tolist()
        ]
        shown = np.where(np.isfinite(radius), radius, np.nan)
        ax.semilogx(omega / (2.0 * np.pi), shown, label=f"speed_gain {gain:g}")
    ax.axhline(1.0, color=MUTED, linewidth=0.8)
    ax.set(
        xlabel="Electrical frequency in Hz", ylabel="Largest pole of all corners",
        ylim=(0.96, 1.06),
    )  # fmt: skip
    ax.legend()
    save(figure, path)
