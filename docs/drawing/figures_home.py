"""The picture of the home page: currents of least loss, and what the code errs by."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import dqforge
from dqforge.reports.pages.figures_style import (
    AXIS_COLOURS,
    BLUE,
    INK,
    MUTED,
    PALE,
    new_figure,
    save,
    style,
)


def machine_to_code(path: Path) -> None:
    """Left the plane of the currents, right the errors of the code below their proven bounds."""
    design = dqforge.load_design("paper000-ipmsm-100kw")
    reference = dqforge.certify(design)
    torque = np.linspace(0.0, reference.torque_max, 1201)
    exact = dqforge.operating_points(design.machine, torque, v_dc=1e4, i_max=400.0)
    i_d, i_q = reference.currents(torque)
    bounds = reference.certificate
    assert bounds is not None
    errors = {"d": (i_d - exact.i_d, bounds.i_d), "q": (i_q - exact.i_q, bounds.i_q)}
    with style():
        figure = new_figure(
            "machine-to-code",
            2.75,
            "Currents of least loss in the plane of both currents, and the errors of the code that "
            "makes them, below bounds that are proven",
        )
        plane = figure.add_axes((0.075, 0.155, 0.385, 0.745))
        plane.set_title("Currents of least loss")
        axis_d, axis_q = np.meshgrid(np.linspace(-310.0, 90.0, 160), np.linspace(0.0, 310.0, 130))
        lines = plane.contour(
            axis_d, axis_q, design.machine.torque(axis_d, axis_q),
            levels=[25.0, 50.0, 100.0, 150.0, 200.0, 250.0], colors=PALE, linewidths=0.8,
        )  # fmt: skip
        plane.clabel(lines, fmt="%g N m", fontsize=6.5, colors=MUTED)
        angle = np.linspace(0.0, np.pi, 181)
        plane.plot(
            design.i_max * np.cos(angle), design.i_max * np.sin(angle), color=INK, linewidth=1.0
        )
        plane.plot(i_d, i_q, color=BLUE, linewidth=2.4)
        plane.set(xlim=(-310.0, 90.0), ylim=(0.0, 310.0), xlabel="$i_d$ in A", ylabel="$i_q$ in A")
        for place, (axis, (error, bound)) in enumerate(errors.items()):
            axes = figure.add_axes((0.575, 0.56 - 0.405 * place, 0.405, 0.34))
            axes.plot(torque, 1e3 * error, color=AXIS_COLOURS[axis])
            for side in (-1e3, 1e3):
                axes.axhline(side * bound, color=INK, linewidth=0.9, linestyle=(0, (4.0, 2.0)))
            axes.set(xlim=(0.0, torque[-1]), ylim=(-1.35e3 * bound, 1.35e3 * bound))
            axes.set_ylabel(f"$i_{axis}$ error in mA")
            if place == 0:
                axes.set_title("Errors of the code, and their proven bounds")
                axes.tick_params(labelbottom=False)
        axes.set_xlabel("Torque in N m")
    save(figure, path)
