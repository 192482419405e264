"""Figure of a back-EMF capture: what was recorded, the averaged period, and its harmonics."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.reports.back_emf.capture import CaptureReading
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, prefixed, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PHASE_COLOURS = {"a": BLUE, "b": ORANGE, "c": TEAL}


_SHOWN_PERIODS = 3.0


_MOST_SAMPLES = 2500


_SHOWN_ORDERS = 25


def _draw_record(axes: Axes, reading: CaptureReading) -> None:
    """The first periods as they were recorded."""
    capture, result = reading.capture, reading.result
    if capture.time is not None:
        argument = capture.time - capture.time[0]
        end, label, unit = _SHOWN_PERIODS / result.frequency, "Time", "s"
    elif capture.angle is not None:
        argument, end, label, unit = np.degrees(capture.angle), np.inf, "Electrical angle", "deg"
    shown = np.flatnonzero(argument <= end)
    shown = shown[:: max(1, shown.size // _MOST_SAMPLES)]
    factor, unit = prefixed(float(np.max(argument[shown])), unit) if unit == "s" else (1.0, unit)
    volts = "Wb" if capture.quantity == "flux" else "V"
    names = ("ab", "bc", "ca") if capture.connection == "line-to-line" else ("a", "b", "c")
    for colour, name, values in zip(PHASE_COLOURS.values(), names, capture.voltages, strict=True):
        axes.plot(argument[shown] * factor, values[shown], color=colour, linewidth=0.7, label=name)
    quantity = "Flux linkage" if volts == "Wb" else "Voltage"
    axes.set(xlabel=f"{label} in {unit}", ylabel=f"{quantity} in {volts}", title="As recorded")
    axes.legend(
        frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.0
    )


def plot_capture(reading: CaptureReading) -> Figure:
    """Record, averaged period over the electrical angle, and harmonics of each
    phase with their uncertainty.
    """
    from matplotlib.transforms import ScaledTranslation

    result = reading.result
    with style():
        figure = new_figure(
            "bemf", 4.6, "Back-EMF: the record, the averaged period and its harmonics"
        )
        top = figure.add_axes((0.09, 0.6, 0.87, 0.32))
        left, right = (
            figure.add_axes((0.09, 0.11, 0.4, 0.34)),
            figure.add_axes((0.59, 0.11, 0.37, 0.34)),
        )
        _draw_record(top, reading)
        theta = np.linspace(0.0, 360.0, result.waveform.shape[1], endpoint=False)
        factor, unit = prefixed(float(np.max(np.abs(result.waveform))), "Wb")
        for (phase, colour), values in zip(PHASE_COLOURS.items(), result.waveform, strict=True):
            left.plot(theta, values * factor, color=colour, label=phase)
        left.set(
            xlabel="Electrical angle in deg",
            ylabel=f"e / $\u03c9_e$ in {unit}",
            title="Averaged period",
            xlim=(0.0, 360.0),
            xticks=np.arange(0, 361, 60),
        )
        shown = (result.orders > 1) & (result.orders <= _SHOWN_ORDERS)
        base = result.amplitudes[:, :1]
        for j, (phase, colour) in enumerate(PHASE_COLOURS.items()):
            aside = ScaledTranslation(1.8 * (j - 1) / 72.0, 0.0, figure.dpi_scale_trans)
            right.errorbar(
                result.orders[shown],
                100.0 * (result.amplitudes / base)[j, shown],
                yerr=np.nan_to_num(100.0 * (result.amplitude_uncertainty / base)[j, shown]),
                fmt="o",
                markersize=2.5,
                linewidth=0.8,
                color=colour,
                label=phase,
                transform=right.transData + aside,
            )
        right.set(
            xlabel="Order", ylabel="% of the fundamental", title="Harmonics", ylim=(0.0, None)
        )
    return figure
