"""Figures of docs/modulation.md: the whole family of modulators."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dqforge.machines.modulation.clamping import DISCONTINUOUS, switching_loss_factor
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    linear_limit,
    period_waveforms,
)
from dqforge.machines.modulation.overmodulation import fundamental
from dqforge.machines.modulation.ripple import harmonic_distortion_factor
from dqforge.machines.names import ModulationName

# One colour for each modulator; those that coincide in a figure share a line there.
COLOURS = dict(
    zip(MODULATORS, (*mpl.colormaps["tab20"](range(0, 20, 2)), "#1d4ed8", "#111827"), strict=True)
)


def zero_sequences(path: Path) -> None:
    """Draw zero-sequence voltage and duty cycle of each modulator over an electrical period,
    as an SVG.
    """
    figure = Figure(figsize=(9.6, 6.6), layout="constrained")
    lag = math.radians(20.0)
    for axes, name in zip(
        figure.subplots(3, 4, sharex=True, sharey=True).ravel(), MODULATORS, strict=True
    ):
        amplitude = 0.8 * linear_limit("spwm", 1.0)
        wave = period_waveforms(
            name, amplitude, 0.0, math.cos(lag), -math.sin(lag), 1.0, angles=720
        )
        degrees = np.degrees(wave.theta_e)
        axes.plot(degrees, wave.modulation.duty[:, 0], color="#1d4ed8", label="duty cycle, phase a")
        axes.plot(
            degrees,
            wave.voltage[:, 0] + 0.5,
            color="#9ca3af",
            linestyle=":",
            label="reference + 1/2",
        )
        zero = wave.modulation.zero_sequence - 0.5
        axes.plot(degrees, zero, color="#d97706", label="V0 / v_dc - 1/2")
        axes.set_title(name, fontsize="small")
        axes.set_xticks(range(0, 361, 120))
        axes.set_xlim(0.0, 360.0)
        axes.grid(alpha=0.3)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    figure.supxlabel(
        "angle of the voltage vector in degrees; the current lags by 20", fontsize="small"
    )
    _save(figure, path)


def merits(path: Path) -> None:
    """Draw switching loss over the load angle, harmonic distortion and gain over the
    modulation index, as an SVG.
    """
    figure = Figure(figsize=(9.6, 7.6), layout="constrained")
    (loss, gain), (carrier, commutations) = figure.subplots(2, 2)
    _draw_loss(loss)
    _draw_gain(gain)
    _draw_distortion(carrier, equal_commutations=False)
    _draw_distortion(commutations, equal_commutations=True)
    _save(figure, path)


def _draw_loss(axes: Axes) -> None:
    degrees = np.linspace(-90.0, 90.0, 361)
    shown: dict[ModulationName, str] = {
        "spwm": "continuous",
        "dpwm0": "dpwm0",
        "dpwm1": "dpwm1",
        "dpwm2": "dpwm2",
        "dpwm3": "dpwm3",
        "dpwmmin": "dpwmmin, dpwmmax",
        "gdpwm": "gdpwm",
        "ddt-gdpwm": "ddt-gdpwm",
    }
    for name, label in shown.items():
        style = "--" if name == "ddt-gdpwm" else "-"
        axes.plot(
            degrees,
            switching_loss_factor(name, np.radians(degrees)),
            style,
            color=COLOURS[name],
            label=label,
        )
    axes.set_xlabel("lag of the current in degrees")
    axes.set_ylabel("switching loss, same carrier frequency")
    axes.set_xticks(range(-90, 91, 30))
    axes.set_ylim(0.45, 1.02)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", ncols=2, loc="upper center", bbox_to_anchor=(0.5, 0.97))


def _draw_gain(axes: Axes) -> None:
    reference = np.linspace(0.4, 1.3, 400)
    for name, label in (
        ("spwm", "spwm"),
        ("thipwm6", "thipwm6"),
        ("thipwm4", "thipwm4"),
        ("svpwm", "svpwm"),
    ):
        axes.plot(reference, fundamental(name, reference, 1.0), color=COLOURS[name], label=label)
    axes.plot(
        reference,
        fundamental("dpwm1", reference, 1.0),
        color=COLOURS["dpwm1"],
        label="all discontinuous",
    )
    axes.axhline(SIX_STEP_AMPLITUDE, color="#9ca3af", linestyle=":", label="six-step")
    axes.set_xlabel("amplitude of the reference / v_dc")
    axes.set_ylabel("fundamental / v_dc")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small", loc="lower right")


def _draw_distortion(axes: Axes, *, equal_commutations: bool) -> None:
    shown: dict[ModulationName, str] = {
        "spwm": "spwm",
        "thipwm6": "thipwm6",
        "svpwm": "svpwm",
        "thipwm4": "thipwm4",
        "dpwm0": "dpwm0, dpwm2, dpwmmin, dpwmmax",
        "dpwm1": "dpwm1",
        "dpwm3": "dpwm3",
    }
    for name, label in shown.items():
        index = np.linspace(0.0, MODULATORS[name].linear_limit / SIX_STEP_AMPLITUDE, 200)
        factor = harmonic_distortion_factor(name, index)
        if equal_commutations and name in DISCONTINUOUS:
            factor = factor / 1.5**2
        axes.plot(index, factor, color=COLOURS[name], label=label)
    axes.set_xlabel("modulation index")
    axes.set_ylabel(
        f"HDF at the same {'commutations' if equal_commutations else 'carrier frequency'}"
    )
    axes.grid(alpha=0.3)
    axes.set_ylim(0.0, 0.46 if equal_commutations else 1.0)
    axes.legend(fontsize="x-small", loc="upper left")


def _save(figure: Figure, path: Path) -> None:
    """Write the same bytes every time: no date, ids from a fixed salt, text as text."""
    with mpl.rc_context({"svg.hashsalt": "dqforge", "svg.fonttype": "none"}):
        figure.savefig(path, format="svg", metadata={"Date": None})
