"""Figures of docs/methods/modulation.md and docs/methods/loss-budget.md."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.machine_budget import bridge_load
from dqforge.machines.modulation.modulators import linear_limit, period_waveforms
from dqforge.machines.names import ModulationName
from dqforge.optimizer.exploration.machine_axis import calibrate_switching
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import solve_map
from dqforge.optimizer.losses.phase_comparison import LossComparison, compare_points
from dqforge.optimizer.modulation_choice.solve import solve_choice
from dqforge.optimizer.operating_points.mtpa_locus import id0_currents
from dqforge.reports.losses.map_figures import plot_loss_map
from dqforge.reports.modulation_choice.figures import plot_choice
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    PART_COLOURS,
    new_figure,
    save,
    style,
)
from dqforge.reports.papers.paper000_stated_method import table_4

COLOURS = {"spwm": MUTED, "svpwm": ORANGE, "ddt-gdpwm": BLUE}
PARTS = ("copper", "conduction", "switching")
LABELS = {
    "spwm": "SPWM",
    "svpwm": "SVPWM",
    "ddt-gdpwm": "DDT-GDPWM",
    "id0": "$i_d$ = 0",
    "mtpa": "MTPA",
}
NAMES: tuple[ModulationName, ...] = ("spwm", "svpwm", "ddt-gdpwm")

# Paper 000, Table 4: total loss in W by strategy and modulator; the first calibrates,
# the others are predicted.
PRINTED = {("id0", "spwm"): 1064.0, ("mtpa", "spwm"): 934.0, ("mtpa", "ddt-gdpwm"): 759.0}


@style()
def modulation_waveforms(path: Path) -> None:
    """Draw duty cycle and zero-sequence voltage of the three modulators over a period,
    as an SVG.
    """
    v_dc, lag = 1.0, math.radians(45.0)
    amplitude = 0.9 * linear_limit("spwm", v_dc)
    figure = new_figure(
        "modulation-waveforms",
        4.6,
        "Duty cycle and zero sequence of three modulators",
        arranged=True,
    )
    upper, middle, lower = figure.subplots(3, 1, sharex=True)
    for name in NAMES:
        wave = period_waveforms(
            name, amplitude, 0.0, math.cos(lag), -math.sin(lag), v_dc, angles=360
        )
        degrees = np.degrees(wave.theta_e)
        look = {"color": COLOURS[name], "label": LABELS[name]}
        upper.plot(degrees, wave.modulation.duty[:, 0], **look)
        middle.plot(degrees, wave.modulation.zero_sequence - 0.5 * v_dc, **look)
        current = np.abs(wave.current[:, 0])
        lower.plot(degrees, np.where(wave.modulation.clamped[:, 0], 0.0, current), **look)
    upper.set_ylabel("Duty cycle, phase a")
    middle.set_ylabel("$v_0$ / $v_{dc}$ \u2212 1/2")
    lower.set_ylabel("Switched |$i_a$|")
    lower.set_xlabel("Angle of the voltage vector in deg; the current lags by 45")
    lower.set_xticks(range(0, 361, 60))
    lower.set_xlim(0.0, 360.0)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save(figure, path)


@style()
def loss_comparison(path: Path) -> None:
    """Draw the losses of paper 000, Table 4, and the switching loss over the angle of the load,
    as an SVG.
    """
    figure = new_figure(
        "loss-comparison",
        3.4,
        "Losses of paper 000, and the switching loss over the load angle",
        arranged=True,
    )
    bars, curve = figure.subplots(1, 2, width_ratios=[1.4, 1.0])
    _draw_bars(bars, _table_4())
    _draw_switching_factor(curve)
    save(figure, path)


def loss_map(path: Path) -> None:
    """Draw who loses least over the map of paper 000's drive, as an SVG."""
    names: tuple[ModulationName, ...] = (
        "spwm",
        "svpwm",
        "dpwm0",
        "dpwm1",
        "dpwm2",
        "dpwm3",
        "dpwmmin",
        "ddt-gdpwm",
    )
    alternatives = Alternatives(("mtpa",), names, (100e3,))
    save(
        plot_loss_map(solve_map(catalogue.load("paper000-ipmsm-100kw"), alternatives, 0.0, 50, 50)),
        path,
    )


def modulation_choice(path: Path) -> None:
    """Draw the choice of modulator and frequency of paper 000's drive with its rule, as an SVG."""
    found = solve_choice(catalogue.load("paper000-ipmsm-100kw"))
    if found is None:
        raise LookupError("the library drive has no section modulation_choice")
    save(plot_choice(found), path)


def _table_4() -> LossComparison:
    """Compare all alternatives at the point of Table 4, calibrated on its first column."""
    machine = LinearMachine(
        pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0
    )
    device = SwitchDevice("mosfet", 9.5e-3, 1e-3, 1e-3, 200.0, 500.0, thermal_resistance=0.306)
    inverter = Inverter(v_dc=500.0, f_sw=100e3, device=device, coolant_temperature=64.0)
    id0 = id0_currents(machine, np.array([130.0]))
    device = calibrate_switching(
        1064.0, machine, inverter, float(id0[0][0]), float(id0[1][0]), 300.0, "spwm"
    )
    settings = LossSettings(points=(LoadPoint(torque=130.0, omega_m=300.0),))
    return compare_points(machine, replace(inverter, device=device), settings, i_max=machine.i_max)


def _draw_bars(axes: Axes, result: LossComparison) -> None:
    pairs = [(s, m) for s in result.strategies for m in result.modulations]
    position = np.arange(len(pairs))
    bottom = np.zeros(len(pairs))
    for part in PARTS:
        height = getattr(result.budget, part)[:, :, 0].ravel()
        axes.bar(position, height, bottom=bottom, color=PART_COLOURS[part], label=part, width=0.7)
        bottom = bottom + height
    for x, total in zip(position, bottom, strict=True):
        axes.text(float(x), total + 15.0, f"{total:.0f}", ha="center", fontsize=7.0)
    printed = [(k, PRINTED[pair]) for k, pair in enumerate(pairs) if pair in PRINTED]
    axes.plot(
        *zip(*printed, strict=True),
        "_",
        color=INK,
        markersize=22,
        markeredgewidth=2,
        label="printed in the paper",
    )
    implied = table_4(catalogue.load("paper000-ipmsm-100kw"))[2].implied_loss
    place = pairs.index(("mtpa", "ddt-gdpwm"))
    axes.plot(
        place, implied, "_", color=INK, markersize=22, markeredgewidth=1, label="by its temperature"
    )
    axes.set_xticks(position, [f"{LABELS[s]}\n{LABELS[m]}" for s, m in pairs], fontsize=6.0)
    axes.set(ylabel="Loss in W at 130 N m, 300 rad/s", ylim=(0.0, 1450.0))
    axes.grid(visible=False, axis="x")
    axes.legend(fontsize=6.5, ncols=2, loc="upper right")


def _draw_switching_factor(axes: Axes) -> None:
    device = SwitchDevice("mosfet", 1e-3, 1e-3, 1e-3, 1.0, 1.0, thermal_resistance=0.1)
    lag = np.radians(np.linspace(-90.0, 90.0, 361))
    loss = {
        name: bridge_load(
            Inverter(1.0, 1.0, device), name, 0.4, 0.0, np.cos(lag), -np.sin(lag)
        ).switching
        for name in NAMES
    }
    for name in ("spwm", "ddt-gdpwm"):
        label = "SPWM, SVPWM" if name == "spwm" else LABELS[name]
        axes.plot(np.degrees(lag), loss[name] / loss["spwm"], color=COLOURS[name], label=label)
    axes.set_xlabel("Lag of the current in deg")
    axes.set_ylabel("Switching loss relative to SPWM")
    axes.set_xticks(range(-90, 91, 30))
    axes.set_ylim(0.4, 1.05)
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.8))
