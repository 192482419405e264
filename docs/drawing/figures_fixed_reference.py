"""Figure of docs/methods/field-weakening.md: the mesh of operating points, and the torque that
integers leave over the speed.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.optimizer.field_weakening.voltage_region import voltage_region
from dqforge.optimizer.fixed_control.design import dc_link
from dqforge.optimizer.fixed_reference.fit import (
    CodePoints,
    FixedReferenceFit,
    fit_mesh,
    mesh_currents,
    phase_limit,
)
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PALE, new_figure, save, style

_DRIVE = "paper000-ipmsm-100kw"
_SPEEDS = 400


def _fit() -> tuple[Design, FixedReferenceFit]:
    """The drive of paper 000 in Q15, up to its largest speed."""
    design = catalogue.load(_DRIVE)
    speed = design.machine.omega_m_max
    assert speed is not None
    # The drive's own base of the torque ends below what the current limit allows.
    control = replace(design.control, bases=replace(design.control.bases, torque=220.0))
    design = replace(design, weakening=WeakeningSettings(speed), control=control)
    domain = voltage_region(design.machine, design.i_max, design.v_max, speed)
    return design, fit_mesh(design, domain, np.inf, 16, dc_link(design, 16))


def _draw_mesh(axes: Axes, design: Design, mesh: CurrentMesh) -> None:
    unit = mesh.bases[0] / 2 ** (mesh.width - 1)
    i_d, i_q = (np.array(part).reshape(-1, mesh.columns) * unit for part in (mesh.d, mesh.q))
    axes.plot(i_d, i_q, color=PALE, linewidth=0.7)
    axes.plot(i_d.T, i_q.T, color=BLUE, linewidth=0.7)
    axes.plot(i_d, i_q, ".", color=BLUE, markersize=3)
    angle = np.linspace(0.5 * np.pi, np.pi, 100)
    axes.plot(design.i_max * np.cos(angle), design.i_max * np.sin(angle), "--", color=ORANGE)
    axes.set_aspect("equal")
    axes.set(title="Nodes; rows are torques", xlabel="$i_d$ in A", ylabel="$i_q$ in A")


def _draw_torque(axes: Axes, design: Design, fit: FixedReferenceFit) -> None:
    """Torque that is granted of the largest, motoring and braking."""
    mesh = fit.reference
    assert fit.speed is not None
    assert mesh.voltage is not None
    one, machine = 2 ** (mesh.width - 1), design.machine
    speed = np.trunc(np.linspace(0.0, 1.0, _SPEEDS) * fit.speed / mesh.bases[2] * one)
    link = round(design.v_max / mesh.bases[1] / mesh.voltage.limit.value * one)
    for sign, name in ((1, "motoring"), (-1, "braking")):
        asked = np.full(_SPEEDS, mesh.end)
        codes = CodePoints(asked, np.full(_SPEEDS, link), np.asarray(sign * speed, dtype=np.int64))
        omega = codes.omega_m * mesh.bases[2] / one
        volts = phase_limit(mesh, codes.v_dc)
        exact = optimal_points(
            machine, asked * mesh.bases[3] / one, omega, v_max=volts, i_max=design.i_max
        )
        made = machine.torque(*mesh_currents(mesh, codes))
        rpm = np.abs(omega) * 30.0 / np.pi
        colour = BLUE if sign > 0 else ORANGE
        axes.plot(rpm, 100.0 * (made - exact.torque) / mesh.end_torque, color=colour, label=name)
    axes.set(
        title="Torque of the integers less the largest one",
        xlabel="Speed in rpm",
        ylabel="Torque in % of that at rest",
    )
    axes.legend()


@style()
def reference_in_integers(path: Path) -> None:
    """Draw the mesh and what it leaves of the torque."""
    design, fit = _fit()
    figure = new_figure(
        "fixed-reference", 3.0, "The mesh of nodes, and what it leaves of the torque", arranged=True
    )
    left, right = figure.subplots(1, 2)
    _draw_mesh(left, design, fit.reference)
    _draw_torque(right, design, fit)
    save(figure, path)


if __name__ == "__main__":
    reference_in_integers(Path(__file__).resolve().parents[1] / "figures" / "fixed-reference.svg")
