"""The documentation's figures of a saturated machine, and of one over the rotor angle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, torque_ripple
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.map_files import read_flux_points
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
)

_COLOURS = (BLUE, TEAL, ORANGE)


def flux_map(path: Path) -> None:
    """Flux linkages of the Baldor machine over one current for three values of the other,
    and the inductances.
    """
    design = catalogue.load("baldor-pmsyrm-5k6")
    machine, i_max = design.machine, design.i_max
    current = np.linspace(-i_max, i_max, 241)
    with style():
        figure = new_figure(
            "flux-map", 3.2, "Flux linkages over the currents, and incremental inductances"
        )
        left, middle, right = (figure.add_axes((x, 0.15, 0.25, 0.74)) for x in (0.075, 0.4, 0.735))
        for share, colour in zip((0.0, 0.5, 1.0), _COLOURS, strict=True):
            other = np.full_like(current, share * i_max)
            along_d, along_q = machine.jet(current, other), machine.jet(-other, current)
            label, sign = f"{share * i_max:.3g} A", "\u2212" if share > 0.0 else ""
            left.plot(current, along_d.psi_d, color=colour, label=f"$i_q$ = {label}")
            middle.plot(
                current,
                along_q.psi_q,
                color=colour,
                label=f"$i_d$ = {sign}{label}",
            )
            right.plot(
                -current, along_d.l_dd * 1e3, color=colour, label=f"$L_{{dd}}$, $i_q$ = {label}"
            )
        at_rest = machine.jet(np.zeros_like(current), current)
        right.plot(
            current, at_rest.l_qq * 1e3, color=INK, linestyle="dashed", label="$L_{qq}$, $i_d$ = 0"
        )
        for axes in (left, middle):
            axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
        left.set(xlabel="$i_d$ in A", ylabel="$\u03c8_d$ in Wb", title="d axis")
        middle.set(xlabel="$i_q$ in A", ylabel="$\u03c8_q$ in Wb", title="q axis")
        right.set(
            xlabel="\u2212$i_d$ of $L_{dd}$, $i_q$ of $L_{qq}$ in A",
            ylabel="Inductance in mH",
            title="Incremental",
            xlim=(0.0, i_max),
            ylim=(0.0, None),
        )
        for axes in (left, middle, right):
            axes.legend(fontsize=6.5, loc="best")
    save(figure, path)


def _of_slots(i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> list[FloatArray]:
    """Flux linkages in Wb and torque in N m of four pole pairs, in closed form."""
    six, twelve = 6.0 * theta, 12.0 * theta
    psi_d = 0.09 + 8e-4 * i_d + 1.1e-3 * np.cos(six) + 9e-6 * i_q * np.sin(six)
    psi_q = 1.9e-3 * i_q + (1.4e-3 + 9e-6 * i_d) * np.sin(six) + 3e-4 * np.sin(twelve)
    by_angle = 6.0 * ((1.4e-3 + 9e-6 * i_d) * i_q * np.cos(six) - 1.1e-3 * i_d * np.sin(six))
    by_angle += 12.0 * (3e-4 * i_q * np.cos(twelve) - 1.5e-3 * np.sin(twelve))
    return [psi_d, psi_q, 6.0 * (psi_d * i_q - psi_q * i_d + by_angle)]


def rotor_angle(path: Path) -> None:
    """Torque over the rotor angle and its orders along the MTPA reference, from a map file."""
    angles = np.arange(0.0, 60.0, 2.5)
    at = np.meshgrid(np.linspace(-60.0, 20.0, 9), np.linspace(0.0, 80.0, 9), angles, indexing="ij")
    columns = [*at, *_of_slots(at[0], at[1], np.radians(at[2]))]
    rows = np.stack([part.ravel() for part in columns], axis=1)
    head = "i_d [A],i_q [A],theta_el [deg],psi_d [Wb],psi_q [Wb],torque [Nm]\n"
    text = head + "\n".join(",".join(f"{cell:.9g}" for cell in row) for row in rows)
    found = build_flux_map(read_flux_points(text.encode(), "map.csv"), pole_pairs=4).flux_map
    machine = SaturatedMachine(4, 0.05, found, 60.0)
    torque = np.linspace(0.0, 40.0, 41)
    points = CurrentChoice(machine, "mtpa", 60.0).points(torque)
    ripple = torque_ripple(machine, points.i_d, points.i_q)
    assert ripple is not None
    theta = np.linspace(0.0, 60.0, 241)
    with style():
        figure = new_figure("rotor-angle", 3.0, "Torque over the rotor angle, and its orders")
        left, right = (figure.add_axes((x, 0.16, 0.39, 0.72)) for x in (0.085, 0.585))
        for row, colour in zip((0, 20, 40), _COLOURS, strict=True):
            i_d, i_q = points.i_d[row], points.i_q[row]
            course = _of_slots(i_d, i_q, np.radians(theta))[2]
            left.plot(theta, course, color=colour, label=f"{torque[row]:.3g} N m")
        right.plot(torque, ripple.peak_to_peak, color=INK, label="peak to peak")
        for order, part, colour in zip(ripple.orders, ripple.amplitudes, _COLOURS, strict=False):
            right.plot(torque, part, color=colour, label=f"order {order:g}")
        left.set(xlabel="Electrical angle in deg", ylabel="Torque in N m", title="At MTPA currents")
        right.set(xlabel="Torque in N m", ylabel="Ripple in N m", title="Along MTPA")
        left.legend(fontsize=6.5, loc="lower right", bbox_to_anchor=(1.0, 0.1))
        right.legend(fontsize=6.5, loc="upper left")
    save(figure, path)
