"""Captures of the back-EMF from the columns of one or several tables, in SI units."""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf import checks
from dqforge.machines.back_emf import harmonics as numerics
from dqforge.machines.back_emf.checks import Axis, Origin, factor, find_axis, kind_and_unit
from dqforge.machines.back_emf.harmonics import (
    ComplexArray,
    HarmonicFit,
    Motion,
    PolePairs,
    pole_pairs_of,
)
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray, decoded_text
from dqforge.machines.files.text_table import Progress, TextTable, read_table
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

Connection = Literal["phase", "line-to-line"]
MOST_SAMPLES = 8_000_000  # Samples of a capture: what is computed of them takes less than 1 GiB.

# Share of a sample interval by which the times of two files may differ: that of their rounding.
_SAME_TIME = 0.05


@dataclass(frozen=True, slots=True)
class BemfCapture:
    """Samples of three voltages (or flux linkages) of a machine without current, as recorded.

    Args:
        source: File name for messages.
        time: Ascending times in s, shape (N,), need not be even; None when the angle is given.
        angle: Electrical angle in rad, any origin, shape (N,), may contain both ends of the period;
            None when time is given.
        voltages: In V, shape (3, N): phases a, b, c, or line-to-line ab, bc, ca; or ab alone,
            shape (1, N).
        lines: Line of each sample in the file, shape (N,).
        connection: What the channels were connected to.
        quantity: ``flux`` if `voltages` holds flux linkages in Wb over the angle.
    """

    source: str
    time: FloatArray | None
    angle: FloatArray | None
    voltages: FloatArray
    lines: NDArray[np.intp]
    connection: Connection = "phase"
    quantity: Literal["voltage", "flux"] = "voltage"


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """What the user says about the columns of a capture.

    Args:
        connection: What the channels were connected to.
        time_unit, voltage_unit: Units of the first and the other columns where the file has none or
            wrong ones; s and V if it has none.
        columns: Headings (without unit) of the time (or angle) and the voltages to use instead, or
            their one-based numbers among the columns that hold numbers; of the voltages alone where
            there is an interval. The same in each file.
        scale: Factors of the channels, for probes whose setting the oscilloscope did not know.
        pole_pairs: Needed only for an angle that the heading calls mechanical.
        interval: Time between two samples in s, for files that do not say it.
    """

    connection: Connection = "phase"
    time_unit: str | None = None
    voltage_unit: str | None = None
    columns: Sequence[str | int] | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    pole_pairs: int | None = None
    interval: float | None = None


@dataclass(frozen=True, slots=True)
class _Part:
    """The samples of one table: their axis, and places of the channels with their
    kinds and factors to SI units.
    """

    table: TextTable
    origin: Origin
    axis: Axis
    channels: list[int]
    kinds: set[str]
    factors: list[float]


def capture_from_tables(tables: Sequence[TextTable], options: CaptureOptions) -> BemfCapture:
    """Samples in SI units from the columns of one file, or of several with
    some of the channels each.

    The first column of a file is the time or the angle (told by its heading, unit or numbers);
    where there is none the file or the user must say the interval. Of the others those in volts,
    else those in Wb, else all are the channels: three, or one or two voltages between wires (ab,
    bc).

    Raises:
        InputError: Nothing tells the times; columns that are missing or too many, a unit that does
            not fit, a scale that is zero or not finite, more than `MOST_SAMPLES` samples; several
            files that do not belong together.
    """
    source = tables[0].source
    origin = Origin(source, tables[0].lines)
    scale = options.scale
    if len(scale) != 3 or not (np.all(np.isfinite(scale)) and np.all(scale)):
        raise origin.error(
            f"scale must be three factors that are finite and not 0, got {scale}", None
        )
    if options.interval is not None and options.interval <= 0.0:
        raise origin.error(
            "the interval must be above 0; write the time between two samples, such as 2 us", None
        )
    parts = [_part(table, options) for table in tables]
    _check_count(
        [part.table.names[k] for part in parts for k in part.channels], options.connection, origin
    )
    for part in parts[1:]:
        _check_together(parts[0], part)
    kinds = set[str]().union(*(part.kinds for part in parts))
    axis = parts[0].axis
    if kinds == {"voltage", "flux"} or (axis.kind == "time" and "flux" in kinds):
        raise origin.error(
            "flux linkages are read over an angle, and not beside voltages; choose other columns", 0
        )
    time, angle = (
        (axis.values, None)
        if axis.kind == "time"
        else (None, _electrical(parts[0], options.pole_pairs))
    )
    quantity: Literal["voltage", "flux"] = "flux" if kinds == {"flux"} else "voltage"
    voltages = _voltages(parts, scale)
    return BemfCapture(source, time, angle, voltages, tables[0].lines, options.connection, quantity)


def _part(table: TextTable, options: CaptureOptions) -> _Part:
    """Axis and channels of one table."""
    origin = Origin(table.source, table.lines)
    if table.lines.size > MOST_SAMPLES:
        count = f"the capture has {table.lines.size / 1e6:.3g} million samples"
        advice = "give fewer periods, or sample more slowly"
        raise origin.error(
            f"{count}, at most {MOST_SAMPLES / 1e6:g} million can be read; {advice}", None
        )
    named = _named(table, options.columns, origin) if options.columns else None
    if named is None or options.interval is not None:
        axis = find_axis(table, None, options.time_unit, options.interval, origin)
    else:
        axis = find_axis(table, named[0], options.time_unit, None, origin)
        named = named[1:]
    if axis.column is None and axis.ignored is None and kind_and_unit(table, 0)[0] == "time":
        # What the heading calls the horizontal unit was laid upon the first channel.
        table = replace(table, units=(table.units[-1], *table.units[1:]))
    channels = named if named is not None else _guessed(table, axis)
    scaled = [
        factor(table, column, options.voltage_unit, ("voltage", "flux"), origin)
        for column in channels
    ]
    return _Part(
        table, origin, axis, channels, {kind for kind, _ in scaled}, [unit for _, unit in scaled]
    )


def _guessed(table: TextTable, axis: Axis) -> list[int]:
    """Places of the channels: of the columns beside the axis those in V, else those in Wb,
    else all.

    Columns that repeat the axis, as blocks side by side have them, are none.
    """
    others = [
        column
        for column in range(table.values.shape[1])
        if column not in (axis.column, axis.ignored)
    ]
    if axis.column is not None:
        first = table.values[:, axis.column]
        others = [column for column in others if not np.array_equal(table.values[:, column], first)]
    kinds = {column: kind_and_unit(table, column)[0] for column in others}
    by_kind = [
        [column for column in others if kinds[column] == kind] for kind in ("voltage", "flux")
    ]
    return next((found for found in by_kind if found), others)


def _named(table: TextTable, columns: Sequence[str | int], origin: Origin) -> list[int]:
    """Places of columns given by heading or one-based number."""
    places = []
    names = list(table.names)
    for column in columns:
        if isinstance(column, str) and column in names:
            places.append(names.index(column))
        elif isinstance(column, int) and 1 <= column <= table.values.shape[1]:
            places.append(column - 1)
        else:
            raise origin.error(
                f"there is no column {column!r}; the file has {', '.join(table.names)}", None
            )
    return places


def _check_count(names: list[str], connection: Connection, origin: Origin) -> None:
    """Refuse anything but three channels, or one or two between wires."""
    if len(names) == 3 or (0 < len(names) < 3 and connection == "line-to-line"):
        return
    listed = ", ".join(names) or "none"
    if len(names) > 3:
        raise origin.error(
            f"there are {len(names)} columns of voltages ({listed}); name the time and three of "
            "them",
            0,
        )
    missing = "a third phase is needed" if len(names) == 2 else "three phases are needed"
    count = "is 1 channel" if len(names) == 1 else f"are {len(names)} channels"
    raise origin.error(
        f"there {count} ({listed}): {missing}; capture them together, name the files of all "
        "channels, or say that what was recorded lies between two wires: --line-to-line, in a "
        "design connection: line-to-line",
        0,
    )


def _check_together(first: _Part, other: _Part) -> None:
    """Refuse two files whose samples do not lie over the same times or angles."""
    here, there = first.axis, other.axis
    name = first.table.source
    if here.kind != there.kind or (here.column is None) != (there.column is None):
        raise other.origin.error(
            f"one of this file and {name} has no time column; save both the same way", None
        )
    if here.values.size != there.values.size:
        count = f"{there.values.size} samples, {name} has {here.values.size}"
        raise other.origin.error(f"the file has {count}; save the channels of one capture", None)
    gap = float(np.max(np.abs(there.values - here.values)))
    if gap > _SAME_TIME * abs(float(here.values[-1] - here.values[0])) / (here.values.size - 1):
        unit = "s" if here.kind == "time" else "rad"
        message = f"its samples lie up to {format_quantity(gap, unit, 3)} beside those of {name}"
        raise other.origin.error(f"{message}; save the channels of one capture", None)


def _electrical(part: _Part, pole_pairs: int | None) -> FloatArray:
    """Electrical angle in rad, shape (N,)."""
    column = part.axis.column
    if column is None or "mech" not in part.table.names[column].casefold():
        return part.axis.values
    if pole_pairs is None:
        name = part.table.names[column]
        raise part.origin.error(
            f"{name} is a mechanical angle; give the number of pole pairs", None
        )
    return part.axis.values * pole_pairs


def _voltages(parts: Sequence[_Part], scale: tuple[float, float, float]) -> FloatArray:
    """Channels of all parts in SI units, shape (3, N), or (1, N) of one.

    The third of two is what makes their sum zero.
    """
    columns = [
        (part.table.values[:, k], unit)
        for part in parts
        for k, unit in zip(part.channels, part.factors, strict=True)
    ]
    voltages = np.empty((1 if len(columns) == 1 else 3, parts[0].axis.values.size))
    for row, (values, unit), share in zip(voltages, columns, scale, strict=False):
        np.multiply(values, unit * share, out=row)
    if len(columns) == 2:
        np.negative(voltages[0] + voltages[1], out=voltages[2])
    return voltages


# What a capture of the back-EMF says: harmonics per speed and the agreement of the phases.

IntArray = NDArray[np.int64]


WAVEFORM_POINTS = 360


_TURN = np.exp(2j * np.pi / 3.0)


@dataclass(frozen=True, slots=True)
class BemfResult:
    """Back-EMF per electrical speed, theta and phi as in `dqforge.machines.back_emf.capture`.

    Args:
        frequency: Mean electrical frequency in Hz; nan when the angle was given.
        drift: Speed at the end less that at the start, over the mean.
        periods: Electrical periods captured.
        start_angle: theta of the first sample in rad, 0 to 2 pi.
        orders: Harmonic orders 1..H.
        amplitudes: A in V s/rad (peak of phase), shape (3, H).
        phases: phi in rad, -pi to pi, shape (3, H).
        amplitude_uncertainty: Half width of the 95 % interval in V s/rad, shape (3, H); nan for
            what the connection cannot show.
        offsets: Constant part of each phase in V, shape (3,).
        noise: What the harmonics leave, in V r.m.s., shape (3,).
        sequence: ``acb`` where phase c followed phase a: taken as a machine turning backwards, with
            theta falling.
        symmetry: Differences between the phases and between the half waves.
        waveform: e / omega_e in V s/rad over theta = 2 pi j / 360, from the harmonics, shape (3,
            360).
        psi_pm: Positive sequence of the fundamental, peak of phase, in Wb.
        zero_sequence_known: False for line-to-line voltages, which do not contain it.
        findings: Sentences for the user.
        pole_pairs: What the pole pairs differ by; None where their number is not known or 1, or the
            record does not show each of them.
    """

    frequency: float
    drift: float
    periods: float
    start_angle: float
    orders: IntArray
    amplitudes: FloatArray
    phases: FloatArray
    amplitude_uncertainty: FloatArray
    offsets: FloatArray
    noise: FloatArray
    sequence: Literal["abc", "acb"]
    symmetry: BemfSymmetry
    waveform: FloatArray
    psi_pm: float
    zero_sequence_known: bool
    findings: tuple[str, ...]
    pole_pairs: PolePairs | None = None


def periods_of(motion: Motion) -> float:
    """Electrical periods in a record, the last sample's interval included.

    At least 1 for angles that cover one.
    """
    if motion.given is not None:
        return max(1.0, float(np.ptp(motion.given)) / (2.0 * np.pi))
    count = motion.u.size
    return motion.frequency * 2.0 * motion.half * count / (count - 1)


def result_of_fit(
    fit: HarmonicFit,
    omega: float,
    steps: FloatArray,
    connection: Connection,
    quantity: Literal["voltage", "flux"],
    findings: list[str],
    origin: Origin,
) -> BemfResult:
    """Align a fit of one or three phases, and put it into the units of the result.

    ``omega`` is the electrical speed in rad/s of rate 1, ``steps`` the converters' in V.
    """
    orders = np.arange(1, fit.coefficients.shape[1] + 1)
    periods = periods_of(fit.motion)
    radius, known = numerics.uncertainty(fit, periods)
    radius = radius + np.max(numerics.quantisation_error(steps, fit.noise))
    if not known:
        assumed = "white noise" if fit.motion.powers.size > 1 else "white noise and constant speed"
        findings.append(
            f"{periods:.1f} periods are too few to see disturbances; the uncertainty assumes "
            f"{assumed}."
        )
    volts = np.abs(fit.coefficients[:, 0])
    slope = 1j * orders if quantity == "flux" else np.ones(orders.size)
    phasors, sequence, direction, zero = _aligned(fit.coefficients * slope / omega)
    radius = np.broadcast_to(radius * np.abs(slope) / abs(omega), phasors.shape).copy()
    findings += checks.check_certain(np.abs(phasors[:, 0]), radius[:, 0], origin)
    if connection == "line-to-line":
        phasors[:, 2::3], radius[:, 2::3] = 0.0, np.nan
    theta = np.arange(WAVEFORM_POINTS) * (2.0 * np.pi / WAVEFORM_POINTS)
    waveform = (1j * phasors @ np.exp(1j * np.multiply.outer(orders, theta))).real
    symmetry = _symmetry(np.where(np.abs(phasors) > radius, phasors, 0.0), waveform)
    ends = fit.motion.rate()[[0, -1]]
    timed = fit.motion.given is None
    drift = float((ends[1] - ends[0]) / np.mean(fit.motion.rate())) if timed else 0.0
    if sequence == "acb":
        findings.append(
            "The sequence is a, c, b: taken as a machine turning backwards. If it turned forwards, "
            "two channels are swapped; exchange their columns."
        )
    offsets, noise = np.resize(fit.offsets, 3), np.resize(fit.noise, 3)
    unit = "Wb" if quantity == "flux" else "V"
    findings += remarks(symmetry, fit.offsets, fit.noise, volts, drift, unit)
    return BemfResult(
        frequency=fit.motion.frequency if timed else float("nan"),
        drift=drift,
        periods=periods,
        start_angle=float(np.mod(direction * fit.motion.angle()[0] + zero, 2.0 * np.pi)),
        orders=orders,
        amplitudes=np.abs(phasors),
        phases=-np.angle(phasors),
        amplitude_uncertainty=radius,
        offsets=offsets,
        noise=noise,
        sequence=sequence,
        symmetry=symmetry,
        waveform=waveform,
        psi_pm=float(np.abs(phasors[0, 0] + _TURN * phasors[1, 0] + phasors[2, 0] / _TURN)) / 3.0,
        zero_sequence_known=connection == "phase",
        findings=tuple(findings),
    )


def _aligned(
    coefficients: ComplexArray,
) -> tuple[ComplexArray, Literal["abc", "acb"], float, float]:
    """Phasors A exp(-j phi) of three phases from coefficients of exp(j h angle),
    of one or three phases.

    With them the sequence and how theta follows from the angle: theta = direction angle + zero.
    """
    orders = np.arange(1, coefficients.shape[1] + 1)
    if coefficients.shape[0] == 1:
        coefficients = coefficients * _TURN ** (-np.multiply.outer(np.arange(3), orders))
    a, b, c = coefficients[:, 0]
    sequence: Literal["abc", "acb"] = "abc"
    direction = 1.0
    if abs(a + b * _TURN + c / _TURN) < abs(a + b / _TURN + c * _TURN):
        # Turning backwards, both the speed and the angle change sign: f(theta) = -e(-angle).
        sequence, direction = "acb", -1.0
        coefficients = -np.conj(coefficients)
        a, b, c = coefficients[:, 0]
    zero = float(np.angle(-1j * (a + b * _TURN + c / _TURN)))
    return -1j * coefficients * np.exp(-1j * orders * zero), sequence, direction, zero


def pole_pairs_of_fit(
    fit: HarmonicFit,
    omega: float,
    steps: FloatArray,
    quantity: Literal["voltage", "flux"],
    result: BemfResult,
    turns: int,
) -> PolePairs:
    """What a fit over the mechanical angle says of ``turns`` pole pairs, aligned as ``result``.

    ``omega`` and ``steps`` as in `result_of_fit`. A record over the time begins in the first pole
    pair; where the angle was recorded, its zero does, to half an electrical period.
    """
    orders = np.arange(1, fit.coefficients.shape[1] + 1) / turns
    direction = 1.0 if result.sequence == "abc" else -1.0
    zero = result.start_angle - direction * turns * float(fit.motion.angle()[0])
    if fit.motion.given is not None:
        zero = float(np.angle(np.exp(1j * zero)))
    revolutions = periods_of(fit.motion)
    radius = numerics.uncertainty(fit, revolutions)[0]
    radius = radius + np.max(numerics.quantisation_error(steps, fit.noise))
    slope = 1j * orders if quantity == "flux" else np.ones(orders.size)
    coefficients = fit.coefficients * slope / omega
    if direction < 0.0:
        coefficients = -np.conj(coefficients)
    phasors = -1j * coefficients * np.exp(-1j * orders * zero)
    radius = np.broadcast_to(radius * np.abs(slope) / abs(omega), phasors.shape).copy()
    return pole_pairs_of(phasors, radius, turns, revolutions)


def _symmetry(phasors: ComplexArray, waveform: FloatArray) -> BemfSymmetry:
    """Compare three aligned phases by the phasors beyond doubt, shape (3, H), relative to
    waveforms, shape (3, M).
    """
    fundamentals = phasors[:, 0] * _TURN ** np.arange(3)
    sizes = np.abs(fundamentals)
    mean = np.mean(sizes)
    evens = phasors[:, 1::2]
    theta = np.arange(WAVEFORM_POINTS) * (2.0 * np.pi / WAVEFORM_POINTS)
    halves = (
        1j * evens @ np.exp(2j * np.multiply.outer(np.arange(1, evens.shape[1] + 1), theta))
    ).real
    return BemfSymmetry(
        amplitude=float(np.max(np.abs(sizes - mean)) / mean),
        displacement=float(np.max(np.abs(np.angle(fundamentals)))),
        even=float(np.max(np.sqrt(np.sum(np.abs(evens) ** 2, axis=1)) / sizes)),
        half_wave=float(np.max(np.max(np.abs(halves), axis=1) / np.max(np.abs(waveform), axis=1))),
    )


# Files of captures: text, gzip and MATLAB, one with all channels or one for each,
# with their headings beside them.

MOST_BYTES = 256_000_000  # Bytes of a capture, packed and unpacked.
_MOST_HEADING = 1_000_000
_TIME_LIKE = re.compile(r"t|time.*|zeit.*|theta.*|angle.*|x", re.IGNORECASE)
_LEAST_SAMPLES = 2


def read_captures(
    names: Sequence[str],
    read: Callable[[str], bytes],
    exists: Callable[[str], bool],
    options: CaptureOptions,
    progress: Progress | None = None,
) -> BemfCapture:
    """Samples of one capture in one file, or in several with some of the channels each.

    Args:
        names: Names of the files: text of any layout, .mat, or one of these with .gz behind it.
            Where oscilloscopes write the heading into a file of its own (cap.csv beside
            cap.Wfm.csv), either name will do.
        read: Content of a file of at most `MOST_BYTES`.
        exists: Whether there is a file.
        options: What the user says about the columns.
        progress: Told the share that is read.

    Raises:
        InputError: A file is not what it claims to be, with the line where that begins, or the
            files make no capture.
    """
    if len(set(names)) < len(names):
        raise InputError("one file is given twice; name one for each channel", source=names[-1])
    tables = []
    for place, name in enumerate(names):

        def share(done: float, place: int = place) -> None:
            if progress is not None:
                progress((place + done) / len(names))

        data, heading = _pair(name, exists)
        table = _table(read(data), data, share)
        tables.append(table if heading is None else _headed(table, read(heading), heading))
    return capture_from_tables(tables, options)


def _pair(name: str, exists: Callable[[str], bool]) -> tuple[str, str | None]:
    """Names of the file with the samples and of that with their heading, if there are two."""
    if (split := re.fullmatch(r"(.*)\.wfm\.csv", name, re.IGNORECASE)) is not None:
        headings = (f"{split[1]}.csv", f"{split[1]}.CSV")
        return name, next((heading for heading in headings if exists(heading)), None)
    if name.lower().endswith(".csv"):
        samples = (f"{name[:-4]}.Wfm.csv", f"{name[:-4]}.Wfm.CSV")
        return next(((data, name) for data in samples if exists(data)), (name, None))
    return name, None


def _headed(table: TextTable, content: bytes, source: str) -> TextTable:
    """Table with the lines of its heading's file before its own."""
    if len(content) > _MOST_HEADING:
        raise InputError(
            f"a heading has at most {_MOST_HEADING / 1e6:g} MB; check the file", source=source
        )
    lines = [line.strip() for line in decoded_text(content, source).split("\n")]
    return replace(table, preamble=(*(line for line in lines if line), *table.preamble))


def _table(content: bytes, source: str, progress: Progress) -> TextTable:
    """Table of a file by its suffix."""
    path = PurePath(source)
    if path.suffix.lower() == ".gz":
        content, path = _unpacked(content, source), path.with_suffix("")
    return (
        _matlab(content, source)
        if path.suffix.lower() == ".mat"
        else read_table(content, source, progress)
    )


def _unpacked(content: bytes, source: str) -> bytes:
    """Content of a gzip file, of one or several members; what it claims to be is not believed."""
    if content[:2] != b"\x1f\x8b":
        raise InputError("this is no gzip file; give it the suffix of its format", source=source)
    damaged = InputError("the gzip file is cut off or damaged; pack it again", source=source)
    parts, room = [], MOST_BYTES + 1
    while content:
        member = zlib.decompressobj(wbits=31)
        try:
            parts.append(member.decompress(content, room))
        except zlib.error as error:
            raise damaged from error
        room -= len(parts[-1])
        if room <= 0:
            message = (
                f"the file has more than {MOST_BYTES / 1e6:g} MB once unpacked; save fewer columns "
                "or samples"
            )
            raise InputError(message, source=source)
        if not member.eof:
            raise damaged
        content = member.unused_data.lstrip(b"\0")
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _matlab(content: bytes, source: str) -> TextTable:
    """Vectors of a MATLAB file as the columns of a table, its single numbers as settings.

    Lines count the samples.
    """
    arrays = [
        array
        for array in _arrays(content, source)
        if array.numeric and array.values.dtype.kind != "c"
    ]
    settings = tuple(
        f"{array.name},{array.values.item()!r}" for array in arrays if array.values.size == 1
    )
    columns = [column for array in arrays for column in _vectors(array)]
    sizes = [values.size for _, values in columns]
    count = max(sizes, key=lambda size: (sizes.count(size), size), default=0)
    if count < _LEAST_SAMPLES:
        raise InputError(
            "the file holds no vectors of numbers; save times and voltages as vectors",
            source=source,
        )
    columns = [(name, values) for name, values in columns if values.size == count]
    columns.sort(key=lambda column: _TIME_LIKE.fullmatch(column[0]) is None)
    table = np.empty((count, len(columns)))
    for place, (_, values) in enumerate(columns):
        table[:, place] = values
    names = tuple(name for name, _ in columns)
    return TextTable(source, names, ("",) * len(names), table, np.arange(1, count + 1), settings)


def _arrays(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of a MATLAB file of any version, of a bounded size."""
    from dqforge.machines.files.text_formats import arrays_of_hdf5, arrays_of_mat4, arrays_of_mat5

    if any(content[place : place + 8] == b"\x89HDF\r\n\x1a\n" for place in (0, 512, 1024, 2048)):
        return arrays_of_hdf5(content, source)
    reader = arrays_of_mat5 if content[124:128] in (b"\0\1IM", b"\1\0MI") else arrays_of_mat4
    return reader(content, source)


def _vectors(array: NamedArray) -> list[tuple[str, FloatArray]]:
    """Vectors of an array of one or two dimensions, the longer of which runs over the samples."""
    values = np.squeeze(array.values)
    if values.ndim == 1:
        return [(array.name, values)]
    if values.ndim != 2:
        return []
    rows = values if values.shape[0] < values.shape[1] else values.T
    return [(f"{array.name}({place})", row) for place, row in enumerate(rows, start=1)]


# What the user of a sound capture should know: its symmetry, noise and drift.

_NOTED = {
    "asymmetry": 0.03,
    "displacement": np.radians(2.0),
    "even": 0.01,
    "offset": 0.03,
    "noise": 0.05,
    "drift": 0.05,
}


@dataclass(frozen=True, slots=True)
class BemfSymmetry:
    """How far three phases are from three equal ones with equal poles.

    Args:
        amplitude: Largest difference of a phase's fundamental amplitude from the mean, over the
            mean.
        displacement: Largest deviation of a fundamental from its 120 degrees, in rad.
        even: Root of the sum of the squared even harmonics that exceed their uncertainty, over the
            fundamental, of the phase where it is largest.
        half_wave: Largest |f(theta) + f(theta + pi)| / 2 that these harmonics make, over the
            largest |f|: 0 if the half waves mirror each other.
    """

    amplitude: float
    displacement: float
    even: float
    half_wave: float


def remarks(
    symmetry: BemfSymmetry,
    offsets: FloatArray,
    noise: FloatArray,
    amplitudes: FloatArray,
    drift: float,
    unit: str,
) -> list[str]:
    """Sentences on what a user should know.

    Offsets, noise and fundamental amplitudes in one unit, shape (3,), or (1,) of one channel.
    """
    findings = []
    for phase, (offset, rms, amplitude) in enumerate(zip(offsets, noise, amplitudes, strict=True)):
        name = "abc"[phase]
        if abs(offset) > _NOTED["offset"] * amplitude:
            share = offset / amplitude
            findings.append(
                f"Phase {name} has an offset of {offset:.3g} {unit} ({share:+.1%} of its "
                "amplitude): removed."
            )
        if rms > _NOTED["noise"] * amplitude:
            findings.append(
                f"Phase {name} has {rms:.3g} {unit} r.m.s. ({rms / amplitude:.1%} of its "
                "amplitude) of noise."
            )
    if symmetry.amplitude > _NOTED["asymmetry"]:
        findings.append(
            f"The phases' amplitudes differ from their mean by up to {symmetry.amplitude:.1%}."
        )
    if symmetry.displacement > _NOTED["displacement"]:
        worst = float(np.degrees(symmetry.displacement))
        findings.append(f"The phases are not 120 degrees apart, but up to {worst:.1f} degrees off.")
    if symmetry.even > _NOTED["even"]:
        findings.append(
            f"Even harmonics make {symmetry.even:.1%} of the fundamental: north and south poles "
            "differ."
        )
    if abs(drift) > _NOTED["drift"]:
        findings.append(f"The speed changes by {drift:+.1%} over the capture: divided out.")
    return findings
