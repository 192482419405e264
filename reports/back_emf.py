"""What a capture of the back-EMF says: tables, plain data and the lines for a design file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import (
    MOST_BYTES,
    BemfCapture,
    BemfResult,
    CaptureOptions,
    read_captures,
)
from dqforge.machines.back_emf.harmonics import PolePairs
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.text_table import Progress
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, parse_option
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, prefixed, style
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_PHASES = "abc"

# Harmonics below this share of the fundamental, or below their uncertainty, are not listed on the
# terminal.
_LEAST_SHARE = 1e-3


@dataclass(frozen=True, slots=True)
class CaptureRequest:
    """The options as they were written; None where an option was not given."""

    line_to_line: bool = False
    pole_pairs: int | None = None
    speed: str | None = None
    scale: str | None = None
    columns: str | None = None
    harmonics: int = 25
    interval: str | None = None


@dataclass(frozen=True, slots=True)
class CaptureReading:
    """A capture and what it says."""

    name: str
    capture: BemfCapture
    result: BemfResult
    pole_pairs: int | None

    @property
    def constants(self) -> dict[str, float]:
        """Back-EMF constants in V s/rad (mechanical) as data sheets name them.

        None without a number of pole pairs.
        """
        if self.pole_pairs is None:
            return {}
        constant = self.pole_pairs * self.result.psi_pm
        kinds = {
            "phase peak": 1.0,
            "phase rms": 1.0 / math.sqrt(2.0),
            "line-to-line rms": math.sqrt(1.5),
        }
        return {kind: constant * factor for kind, factor in kinds.items()}

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences for the user, what is to be said of the pole pairs last."""
        pairs = self.result.pole_pairs
        more = "" if pairs is None else pairs.finding
        return (*self.result.findings, more) if more else self.result.findings

    @property
    def omega_m(self) -> float:
        """Mechanical speed in rad/s; NaN without a number of pole pairs, or over an angle."""
        return (
            math.nan
            if self.pole_pairs is None
            else 2.0 * math.pi * self.result.frequency / self.pole_pairs
        )


def _scale(text: str | None) -> tuple[float, float, float]:
    if text is None:
        return (1.0, 1.0, 1.0)
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"--scale: expected three factors such as 1,1,10, got '{text}'") from None
    return (first, second, third)


def _columns(text: str | None) -> list[str | int] | None:
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    return [int(part) if part.isdigit() else part for part in parts]


def _interval(text: str | None) -> float | None:
    seconds = parse_option(text, "time", "--interval")
    if seconds is not None and seconds <= 0.0:
        raise InputError(f"--interval: expected a time above 0, got '{text}'; write e.g. 2 us")
    return seconds


def read_capture(
    paths: Sequence[Path], request: CaptureRequest, progress: Progress | None = None
) -> CaptureReading:
    """Read and analyse the back-EMF of three phases in one file, or in several with
    some of the channels each.

    Args:
        paths: The files.
        request: The options.
        progress: Told the share that is done, of which reading is half.

    Raises:
        InputError: A file is not what it claims to be, with the line where that begins, or an
            option is not understood.
    """
    speed = parse_option(request.speed, "speed", "--speed")
    if request.pole_pairs is not None and request.pole_pairs < 1:
        raise InputError(f"--pole-pairs: expected a whole number above 0, got {request.pole_pairs}")
    if not 1 <= request.harmonics <= 200:
        raise InputError(f"--harmonics: expected 1 to 200, got {request.harmonics}")
    options = CaptureOptions(
        connection="line-to-line" if request.line_to_line else "phase",
        columns=_columns(request.columns),
        scale=_scale(request.scale),
        pole_pairs=request.pole_pairs,
        interval=_interval(request.interval),
    )
    capture = read_captures(
        [str(path) for path in paths],
        lambda name: read_regular_file(name, MOST_BYTES),
        lambda name: Path(name).is_file(),
        options,
        _half(progress, 0.0),
    )
    result = analyse(
        capture,
        pole_pairs=request.pole_pairs,
        speed=speed,
        harmonics=request.harmonics,
        progress=_half(progress, 0.5),
    )
    return CaptureReading(
        ", ".join(path.name for path in paths), capture, result, request.pole_pairs
    )


def _half(progress: Progress | None, start: float) -> Progress | None:
    """What tells the share of one half of the work as that of the whole."""
    return None if progress is None else lambda share: progress(start + 0.5 * share)


def _constant_rows(reading: CaptureReading) -> list[tuple[str, str]]:
    """The magnet flux in the conventions of data sheets."""
    psi = reading.result.psi_pm
    rows = [
        (
            "magnet flux linkage psi_pm",
            f"{format_quantity(psi, 'Wb', 4)} (peak of phase, fundamental)",
        )
    ]
    if reading.pole_pairs is None:
        return [*rows, ("back-EMF constant", "needs --pole-pairs")]
    per_krpm = 1000.0 * math.pi / 30.0
    text = ", ".join(
        f"{value * per_krpm:.4g} V/krpm ({kind})" for kind, value in reading.constants.items()
    )
    return [*rows, ("back-EMF constant", text)]


def _summary_rows(reading: CaptureReading) -> list[tuple[str, str]]:
    result = reading.result
    symmetry = result.symmetry
    if math.isfinite(result.frequency):
        speed = (
            ""
            if reading.pole_pairs is None
            else f", {60.0 * result.frequency / reading.pole_pairs:.5g} rpm"
        )
        motion = (
            f"{result.frequency:.5g} Hz electrical{speed}, {100.0 * result.drift:+.2f} % over the "
            "capture"
        )
    else:
        motion = "given as an angle"
    unit = "Wb" if reading.capture.quantity == "flux" else "V"
    offsets = ", ".join(f"{value:.3g}" for value in result.offsets)
    noise = ", ".join(f"{value:.3g}" for value in result.noise)
    return [
        ("speed", motion),
        (
            "electrical periods",
            f"{result.periods:.2f}, {reading.capture.voltages.shape[1]} samples",
        ),
        ("sequence", result.sequence),
        ("offset of a, b, c", f"{offsets} {unit}"),
        ("noise of a, b, c", f"{noise} {unit} r.m.s."),
        *_difference_rows(reading),
        ("even harmonics", f"{100.0 * symmetry.even:.2f} % of the fundamental"),
        *_pole_pair_rows(result.pole_pairs),
        *_constant_rows(reading),
    ]


def _difference_rows(reading: CaptureReading) -> list[tuple[str, str]]:
    """How far the phases are from three equal ones, where more than one voltage was recorded."""
    symmetry = reading.result.symmetry
    if len(reading.capture.voltages) == 1:
        return [("phases", "taken for equal and 120 deg apart: one voltage was recorded")]
    return [
        ("amplitudes differ from their mean by", f"{100.0 * symmetry.amplitude:.2f} %"),
        ("displacements differ from 120 deg by", f"{math.degrees(symmetry.displacement):.2f} deg"),
    ]


def _pole_pair_rows(pairs: PolePairs | None) -> list[tuple[str, str]]:
    """What the pole pairs differ by, where the record shows each of them."""
    if pairs is None:
        return []
    text = (
        f"{100.0 * pairs.spread:.2f} +- {100.0 * pairs.doubt:.2f} % of the fundamental, over "
        f"{pairs.revolutions:.2f} mechanical turns"
    )
    if not pairs.differ:
        return [("pole pairs differ by", f"{text}: no more than its uncertainty")]
    return [
        ("pole pairs differ by", text),
        ("of it common to the phases", f"{100.0 * pairs.common:.0f} %"),
    ]


def _pole_pair_table(pairs: PolePairs) -> Table:
    """The fundamental of each phase within each pole pair."""
    rows = tuple(
        (f"{index}", *(f"{1e3 * value:.4g}" for value in pair))
        for index, pair in enumerate(pairs.fundamentals.T, start=1)
    )
    columns = ("pole pair", *(f"{phase} mWb" for phase in _PHASES))
    return Table("Fundamental within each pole pair", columns, rows)


def _harmonic_rows(result: BemfResult) -> tuple[tuple[str, ...], ...]:
    """Harmonics of which some phase shows more than its uncertainty."""
    base = result.amplitudes[:, :1]
    share, doubt = result.amplitudes / base, result.amplitude_uncertainty / base
    seen = np.any((share > np.nan_to_num(doubt)) & (share > _LEAST_SHARE), axis=0)
    return tuple(
        (
            f"{result.orders[k]}",
            *(f"{100.0 * share[j, k]:.2f} +- {100.0 * doubt[j, k]:.2f}" for j in range(3)),
            *(f"{math.degrees(result.phases[j, k]):.1f}" for j in range(3)),
        )
        for k in np.flatnonzero(seen)
    )


def capture_tables(reading: CaptureReading) -> list[Table]:
    """Summary and harmonics of a capture."""
    columns = (
        "order",
        *(f"{phase} %" for phase in _PHASES),
        *(f"{phase} deg" for phase in _PHASES),
    )
    convention = (
        "e / omega_e = - sum A_h sin(h theta - phi_h), theta from phase a to the d axis; A_h in % "
        "of A_1 of its phase, +- the half width of the 95 % interval"
    )
    pairs = reading.result.pole_pairs
    return [
        Table(
            f"{reading.name}: back-EMF",
            ("", ""),
            tuple(_summary_rows(reading)),
            reading.findings,
        ),
        Table(
            "Harmonics above their uncertainty",
            columns,
            _harmonic_rows(reading.result),
            (convention,),
        ),
        *([_pole_pair_table(pairs)] if pairs is not None and pairs.differ else []),
    ]


def plain_capture(reading: CaptureReading) -> PlainData:
    """Everything that was found, as arrays per phase."""
    result = reading.result
    return {
        "quantity": reading.capture.quantity,
        "samples": reading.capture.voltages.shape[1],
        "pole_pairs": reading.pole_pairs,
        "omega_m_rad_per_s": reading.omega_m,
        "constants_Vs_per_rad": {
            kind.replace(" ", "_").replace("-", "_"): value
            for kind, value in reading.constants.items()
        },
        "frequency_Hz": result.frequency,
        "drift": result.drift,
        "periods": result.periods,
        "sequence": result.sequence,
        "psi_pm_Wb": result.psi_pm,
        "orders": result.orders,
        "amplitudes_Wb": result.amplitudes,
        "amplitude_uncertainty_Wb": result.amplitude_uncertainty,
        "phases_rad": result.phases,
        "offsets": result.offsets,
        "noise": result.noise,
        "symmetry": asdict(result.symmetry),
        "zero_sequence_known": result.zero_sequence_known,
        "waveform_Wb": result.waveform,
        "findings": list(reading.findings),
        "pole_pairs_differ": _plain_pole_pairs(result.pole_pairs),
    }


def _plain_pole_pairs(pairs: PolePairs | None) -> PlainData | None:
    """The harmonics over the mechanical turn, None where the record does not show them."""
    if pairs is None:
        return None
    return {
        "revolutions": pairs.revolutions,
        "differ": pairs.differ,
        "spread": pairs.spread,
        "uncertainty": pairs.doubt,
        "common": pairs.common,
        "fundamentals_Wb": pairs.fundamentals,
        "orders": pairs.orders,
        "amplitudes_Wb": pairs.amplitudes,
        "amplitude_uncertainty_Wb": pairs.amplitude_uncertainty,
        "phases_rad": pairs.phases,
    }


# Figure of a back-EMF capture: what was recorded, the averaged period, and its harmonics.

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
    for colour, name, values in zip(PHASE_COLOURS.values(), names, capture.voltages, strict=False):
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
