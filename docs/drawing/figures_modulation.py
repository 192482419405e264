"""Figures of docs/methods/modulation.md: the whole family of modulators."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    linear_limit,
    period_waveforms,
)
from dqforge.machines.modulation.registry import DISCONTINUOUS, switching_loss_factor
from dqforge.machines.modulation.ripple import harmonic_distortion_factor
from dqforge.machines.modulation.switched_period import fundamental
from dqforge.machines.names import ModulationName
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    PALE,
    SERIES,
    new_figure,
    save,
    style,
)

# One colour for each modulator; those that coincide in a figure share a line there.
COLOURS = dict(zip(MODULATORS, (*SERIES, PALE, BLUE, INK), strict=True))


@style()
def zero_sequences(path: Path) -> None:
    """Draw zero-sequence voltage and duty cycle of each modulator over an electrical period,
    as an SVG.
    """
    figure = new_figure(
        "modulation-family", 5.0, "Duty cycle and zero sequence of every modulator", arranged=True
    )
    lag = math.radians(20.0)
    for axes, name in zip(
        figure.subplots(3, 4, sharex=True, sharey=True).ravel(), MODULATORS, strict=True
    ):
        amplitude = 0.8 * linear_limit("spwm", 1.0)
        wave = period_waveforms(
            name, amplitude, 0.0, math.cos(lag), -math.sin(lag), 1.0, angles=720
        )
        degrees = np.degrees(wave.theta_e)
        axes.plot(degrees, wave.modulation.duty[:, 0], color=BLUE, label="duty cycle, phase a")
        axes.plot(
            degrees,
            wave.voltage[:, 0] + 0.5,
            color=MUTED,
            linestyle=":",
            label="reference + 1/2",
        )
        zero = wave.modulation.zero_sequence - 0.5
        axes.plot(degrees, zero, color=ORANGE, label="$v_0$ / $v_{dc}$ \u2212 1/2")
        axes.set_title(name)
        axes.set_xticks(range(0, 361, 120))
        axes.set_xlim(0.0, 360.0)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    figure.supxlabel("Angle of the voltage vector in deg; the current lags by 20", fontsize=8.0)
    save(figure, path)


@style()
def merits(path: Path) -> None:
    """Draw switching loss over the load angle, harmonic distortion and gain over the
    modulation index, as an SVG.
    """
    figure = new_figure("modulation-merits", 5.8, "Merits of every modulator", arranged=True)
    (loss, gain), (carrier, commutations) = figure.subplots(2, 2)
    _draw_loss(loss)
    _draw_gain(gain)
    _draw_distortion(carrier, equal_commutations=False)
    _draw_distortion(commutations, equal_commutations=True)
    save(figure, path)


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
        dashes = "--" if name == "ddt-gdpwm" else "-"
        axes.plot(
            degrees,
            switching_loss_factor(name, np.radians(degrees)),
            dashes,
            color=COLOURS[name],
            label=label,
        )
    axes.set_xlabel("Lag of the current in deg")
    axes.set_ylabel("Switching loss, same carrier frequency")
    axes.set_xticks(range(-90, 91, 30))
    axes.set_ylim(0.45, 1.4)
    axes.legend(fontsize=6.5, ncols=2, loc="upper center")


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
    axes.axhline(SIX_STEP_AMPLITUDE, color=MUTED, linestyle=":", label="six-step")
    axes.set_xlabel("Amplitude of the reference / $v_{dc}$")
    axes.set_ylabel("Fundamental / $v_{dc}$")
    axes.legend(fontsize=6.5, loc="lower right")


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
    axes.set_xlabel("Modulation index")
    axes.set_ylabel(
        f"HDF at the same {'commutations' if equal_commutations else 'carrier frequency'}"
    )
    axes.set_ylim(0.0, 0.62 if equal_commutations else 1.4)
    axes.legend(fontsize=6.5, loc="upper left")
