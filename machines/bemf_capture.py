"""Back-EMF as an oscilloscope, or a finite-element program, recorded it: from samples to harmonics per speed.

Convention: theta is the electrical angle of the d axis from phase a, and

    e_k / omega_e = - sum_h A_kh sin(h theta - phi_kh),    psi_k = sum_h (A_kh / h) cos(h theta - phi_kh),

so that phi is the phase of the magnet's flux linkage and an ideal machine has phi_1 = 0, 120 and -120 degrees in
phases a, b and c. The d axis lies along the positive sequence of the fundamental: that is how the angle is aligned.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines import bemf_checks as checks
from dqforge.machines import bemf_harmonics as numerics
from dqforge.machines.bemf_checks import BemfSymmetry, Origin
from dqforge.machines.bemf_harmonics import ComplexArray, HarmonicFit, Motion
from dqforge.machines.quantities import parse_quantity
from dqforge.machines.synchronous import FloatArray
from dqforge.machines.text_table import TextTable
from dqforge.machines.units import COMPOUNDS, DIMENSIONS, SYMBOLS

Connection = Literal["phase", "line-to-line"]
IntArray = NDArray[np.int64]

WAVEFORM_POINTS = 360
_COARSE_HARMONICS = 7
_COARSE_SAMPLES = 100.0  # to the period: harmonics that they fold onto the first seven are of order 93 and more
_TURN = np.exp(2j * np.pi / 3.0)
# e_a = (e_ab - e_ca) / 3 and so on: phase voltages without zero sequence.
_TO_PHASES = (np.eye(3) - np.roll(np.eye(3), -1, axis=1)) / 3.0

_WORDS = {"v": "V", "volt": "V", "volts": "V", "sec": "s", "second": "s", "seconds": "s", "degree": "deg"} | {
    "degrees": "deg",
    "s": "s",
    "v*s": "Vs",
    "v s": "Vs",
}
_UNIT_KINDS: dict[str, frozenset[str]] = {
    "time": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("second")),
    "angle": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith(("radian", "degree"))),
    "voltage": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("volt")),
    "flux": frozenset(symbol for symbol, name in SYMBOLS.items() if name.endswith("weber"))
    | frozenset(symbol for symbol, names in COMPOUNDS.items() if names[0].endswith("volt")),
}


_NAMES_OF_SECOND_KIND = {"angle": "theta|angle|phi|winkel", "flux": "psi|flux|lambda"}
"""How the heading of a column without unit begins that is an angle instead of a time, or a flux linkage."""


@dataclass(frozen=True, slots=True)
class BemfCapture:
    """Samples of three voltages (or flux linkages) of a machine without current, as recorded.

    Parameters
    ----------
    source:
        File name for messages.
    time:
        Ascending times in s, shape (N,), need not be even; None when the angle is given.
    angle:
        Electrical angle in rad, any origin, shape (N,), may contain both ends of the period; None when time is given.
    voltages:
        In V, shape (3, N): phases a, b, c, or line-to-line ab, bc, ca.
    lines:
        Line of each sample in the file, shape (N,).
    connection:
        What the channels were connected to.
    quantity:
        ``flux`` if `voltages` holds flux linkages in Wb over the angle.
    """

    source: str
    time: FloatArray | None
    angle: FloatArray | None
    voltages: FloatArray
    lines: NDArray[np.intp]
    connection: Connection = "phase"
    quantity: Literal["voltage", "flux"] = "voltage"


@dataclass(frozen=True, slots=True)
class BemfResult:
    """Back-EMF per electrical speed, with theta and phi as in the module's description.

    Parameters
    ----------
    frequency:
        Mean electrical frequency in Hz; nan when the angle was given.
    drift:
        Speed at the end less that at the start, over the mean.
    periods:
        Electrical periods captured.
    start_angle:
        theta of the first sample in rad, 0 to 2 pi.
    orders:
        Harmonic orders 1..H.
    amplitudes:
        A in V s/rad (peak of phase), shape (3, H).
    phases:
        phi in rad, -pi to pi, shape (3, H).
    amplitude_uncertainty:
        Half width of the 95 % interval in V s/rad, shape (3, H); nan for what the connection cannot show.
    offsets:
        Constant part of each phase in V, shape (3,).
    noise:
        What the harmonics leave, in V r.m.s., shape (3,).
    sequence:
        ``acb`` where phase c followed phase a: taken as a machine turning backwards, with theta falling.
    symmetry:
        Differences between the phases and between the half waves.
    waveform:
        e / omega_e in V s/rad over theta = 2 pi j / 360, from the harmonics, shape (3, 360).
    psi_pm:
        Positive sequence of the fundamental, peak of phase, in Wb.
    zero_sequence_known:
        False for line-to-line voltages, which do not contain it.
    findings:
        Sentences for the user.
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


def capture_from_table(
    table: TextTable,
    *,
    connection: Connection = "phase",
    time_unit: str | None = None,
    voltage_unit: str | None = None,
    columns: Sequence[str | int] | None = None,
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    pole_pairs: int | None = None,
) -> BemfCapture:
    """Samples in SI units from the columns of a text file.

    Parameters
    ----------
    table:
        The file. The first column is the time or the angle (told by its unit or heading); of the others those in volts,
        else those in Wb, else all, must be three; of line-to-line voltages two will do (ab and bc).
    connection:
        What the channels were connected to.
    time_unit, voltage_unit:
        Units of the first and the other columns where the file has none or wrong ones; s and V if it has none.
    columns:
        Headings (without unit) of the time (or angle) and the voltages to use instead, or their one-based numbers among
        the columns that hold numbers.
    scale:
        Factors of the channels, for probes whose setting the oscilloscope did not know.
    pole_pairs:
        Needed only for an angle that the heading calls mechanical.

    Raises
    ------
    InputError
        Columns that are missing or too many, a unit that does not fit, or a scale that is zero or not finite.
    """
    origin = Origin(table.source, table.lines)
    if len(scale) != 3 or not (np.all(np.isfinite(scale)) and np.all(scale)):
        raise origin.error(f"scale must be three factors that are finite and not 0, got {scale}", None)
    first, *others = _named(table, columns, origin) if columns else _guessed(table)
    _check_count(others, connection, table, origin)
    kind, factor = _factor(table, first, time_unit, ("time", "angle"), origin)
    scaled = [_factor(table, column, voltage_unit, ("voltage", "flux"), origin) for column in others]
    quantities = {quantity for quantity, _ in scaled}
    if quantities == {"voltage", "flux"} or (kind == "time" and "flux" in quantities):
        raise origin.error("flux linkages are read over an angle, and not beside voltages; choose other columns", 0)
    factors = np.array([unit for _, unit in scaled]) * np.array(scale)[: len(others)]
    voltages = np.ascontiguousarray(table.values[:, others].T * factors[:, None])
    if len(others) == 2:
        voltages = np.concatenate([voltages, -np.sum(voltages, axis=0, keepdims=True)])
    axis = table.values[:, first] * factor
    if kind == "angle" and "mech" in table.names[first].casefold():
        if pole_pairs is None:
            raise origin.error(f"{table.names[first]} is a mechanical angle; give the number of pole pairs", None)
        axis = axis * pole_pairs
    time, angle = (axis, None) if kind == "time" else (None, axis)
    quantity: Literal["voltage", "flux"] = "flux" if quantities == {"flux"} else "voltage"
    return BemfCapture(table.source, time, angle, voltages, table.lines, connection, quantity)


def _kind_and_unit(table: TextTable, column: int) -> tuple[str, str]:
    """Kind of a column by its unit, empty if unknown, and the unit's symbol."""
    unit = _symbol(table.units[column])
    return next((kind for kind, symbols in _UNIT_KINDS.items() if unit in symbols), ""), unit


def _symbol(unit: str) -> str:
    """Symbol of a unit that may be written as a word, as some oscilloscopes do."""
    unit = unit.strip()
    return unit if unit in SYMBOLS or unit in COMPOUNDS else _WORDS.get(unit.casefold(), unit)


def _guessed(table: TextTable) -> list[int]:
    """Columns of time and voltages: the first, and of the others those in V, else those in Wb, else all."""
    others = range(1, table.values.shape[1])
    kinds = [_kind_and_unit(table, column)[0] for column in others]
    by_kind = [[column for column in others if kinds[column - 1] == kind] for kind in ("voltage", "flux")]
    return [0, *next((found for found in by_kind if found), list(others))]


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
            raise origin.error(f"there is no column {column!r}; the file has {', '.join(table.names)}", None)
    return places


def _check_count(others: list[int], connection: Connection, table: TextTable, origin: Origin) -> None:
    """Refuse anything but three channels, or two line-to-line ones."""
    if len(others) == 3 or (len(others) == 2 and connection == "line-to-line"):
        return
    names = ", ".join(table.names[column] for column in others) or "none"
    if len(others) > 3:
        raise origin.error(f"there are {len(others)} columns of voltages ({names}); name the time and three of them", 0)
    missing = "a third phase is needed" if len(others) == 2 else "three phases are needed"
    count = "is 1 channel" if len(others) == 1 else f"are {len(others)} channels"
    raise origin.error(
        f"there {count} ({names}): {missing}; capture them together, or give line-to-line voltages",
        0,
    )


def _factor(
    table: TextTable, column: int, given: str | None, wanted: tuple[str, str], origin: Origin
) -> tuple[str, float]:
    """Which of the wanted kinds a column is, and the factor to SI units."""
    kind, unit = _kind_and_unit(table, column)
    if given is not None:
        unit = _symbol(given)
        kind = next((name for name in wanted if unit in _UNIT_KINDS[name]), "")
    if kind in wanted:
        return kind, 1.0 if unit == DIMENSIONS[kind].unit else parse_quantity(f"1 {unit}", kind)
    if unit:
        examples = " or ".join(DIMENSIONS[name].unit for name in wanted)
        raise origin.error(f"{table.names[column]} has the unit {unit!r}, expected e.g. {examples}", 0)
    named = re.match(_NAMES_OF_SECOND_KIND[wanted[1]], table.names[column], re.IGNORECASE)
    return wanted[1] if named else wanted[0], 1.0


def analyse(
    capture: BemfCapture, *, pole_pairs: int | None = None, speed: float | None = None, harmonics: int = 25
) -> BemfResult:
    """Harmonics of the back-EMF per electrical speed, with their uncertainty, and what is peculiar about the capture.

    Parameters
    ----------
    capture:
        The samples.
    pole_pairs, speed:
        Mechanical speed in rad/s. Over the time both are a check only; over an angle they are what the voltages are
        divided by, and without them the values are taken for e / omega_e.
    harmonics:
        Highest order wanted; lowered, and said so, where there are less than 4 samples in its period.

    Raises
    ------
    InputError
        The capture is not that of a turning three-phase machine, or speed and frequency contradict each other.
    """
    origin = Origin(capture.source, capture.lines)
    axis = checks.check_samples(capture.time, capture.angle, capture.voltages, origin)
    timed = capture.time is not None
    if capture.voltages.shape[0] != 3:
        raise origin.error(f"a three-phase capture needs three channels, got {capture.voltages.shape[0]}", None)
    checks.check_flat(capture.voltages, origin)
    findings: list[str] = []
    voltages = capture.voltages
    if timed:
        frequency, share = numerics.rough_frequency(axis, voltages)
        checks.check_line(share, origin)
        samples = 1.0 / (frequency * numerics.sample_interval(axis))
        checks.check_length(axis.size / samples, samples, origin)
        findings += checks.check_clipping(voltages, samples, origin)
        motion = numerics.rough_motion(axis, voltages, frequency)
    else:
        motion, samples = _given_motion(axis, origin)
    count = _orders_resolved(harmonics, samples, findings)
    stride = max(1, int(samples / _COARSE_SAMPLES))
    thin = replace(origin, lines=origin.lines[::stride])
    coarse = numerics.fit_harmonics(motion.thinned(stride), voltages[:, ::stride], min(_COARSE_HARMONICS, count))
    motion = replace(motion, powers=coarse.motion.powers)
    periods = _periods(motion)
    checks.check_periodic(coarse, voltages[:, ::stride], thin.lines.size / periods, thin)
    checks.check_length(periods, voltages.shape[1] / periods, origin)
    # A third channel that is nothing but the negative sum of the others would hide which of them is wrong.
    derived = capture.connection == "line-to-line" and np.array_equal(voltages[2], -(voltages[0] + voltages[1]))
    fundamentals = coarse.coefficients[: 2 if derived else 3, 0]
    checks.check_ratios(fundamentals, origin)
    checks.check_displacements(fundamentals, origin)
    start = coarse.coefficients
    if capture.connection == "line-to-line":
        findings += _line_to_line_findings(voltages)
        voltages, start = _TO_PHASES @ voltages, _TO_PHASES @ start
    fit = numerics.fit_harmonics(motion, voltages, count, start)
    checks.check_condition(fit, origin)
    checks.check_length(_periods(fit.motion), samples, origin)
    if timed:
        checks.check_speed(fit.motion.frequency, pole_pairs, speed, origin)
        omega = fit.motion.unit_speed
    else:
        omega = _speed_of_angle(capture, pole_pairs, speed, origin, findings)
    steps = np.array([numerics.resolution(row) for row in capture.voltages]) * timed
    return _result(fit, omega, steps, capture.connection, capture.quantity, findings, origin)


def analyse_period(
    angle: FloatArray,
    emf: FloatArray,
    *,
    source: str,
    lines: NDArray[np.intp] | None = None,
    harmonics: int = 25,
) -> BemfResult:
    """Like `analyse` for one phase over the angle; the other two are taken for the same, 120 degrees later each.

    Parameters
    ----------
    angle, emf:
        Electrical angle in rad, may contain both ends of the period, and e_a / omega_e in V s/rad, shapes (N,).
    source, lines:
        File name and the line of each sample, for messages.
    harmonics:
        As in `analyse`.

    Raises
    ------
    InputError
        The samples do not cover a period, are not finite, or are all the same.
    """
    origin = Origin(source, np.arange(1, angle.size + 1) if lines is None else lines)
    checks.check_samples(None, angle, emf[None], origin)
    checks.check_flat(emf[None], origin)
    findings = ["One phase was given; the other two are taken for the same, displaced by 120 degrees."]
    motion, samples = _given_motion(angle, origin)
    fit = numerics.fit_harmonics(motion, emf[None], _orders_resolved(harmonics, samples, findings))
    checks.check_condition(fit, origin)
    checks.check_periodic(fit, emf[None], emf.size, origin)
    return _result(fit, 1.0, np.zeros(1), "phase", "voltage", findings, origin)


def _given_motion(angle: FloatArray, origin: Origin) -> tuple[Motion, float]:
    """Motion of a recorded angle in rad, shape (N,), and how many of its largest gap make a period."""
    turned = np.sort(np.mod(angle, 2.0 * np.pi))
    gap = float(np.max(np.diff(np.concatenate([turned, turned[:1] + 2.0 * np.pi]))))
    checks.check_coverage(gap, origin)
    return Motion(np.zeros_like(angle), 1.0, 1.0, np.zeros(0), angle), 2.0 * np.pi / gap


def _orders_resolved(harmonics: int, samples: float, findings: list[str]) -> int:
    """Highest order that has 4 (to 1 %) of a period's ``samples`` in its own; a finding if that is less than wanted."""
    resolved = max(1, int(1.01 * samples / 4.0))
    if resolved < harmonics:
        findings.append(
            f"{samples:.0f} samples in a period resolve harmonics up to order {resolved}, not {harmonics} as wanted."
        )
    return min(resolved, harmonics)


def _periods(motion: Motion) -> float:
    """Electrical periods in a record, the last sample's interval included; at least 1 for angles that cover one."""
    if motion.given is not None:
        return max(1.0, float(np.ptp(motion.given)) / (2.0 * np.pi))
    count = motion.u.size
    return motion.frequency * 2.0 * motion.half * count / (count - 1)


def _line_to_line_findings(voltages: FloatArray) -> list[str]:
    """Say what line-to-line voltages cannot tell, and whether the three add to zero."""
    findings = ["Line-to-line voltages do not contain the zero sequence: harmonics of order 3, 6, 9, ... are unknown."]
    share = float(np.std(np.sum(voltages, axis=0)) / np.mean(np.std(voltages, axis=1)))
    if share > 0.05:
        findings.append(
            f"The three line-to-line voltages add to {share:.0%} of one of them instead of 0; are they phase voltages?"
        )
    return findings


def _speed_of_angle(
    capture: BemfCapture, pole_pairs: int | None, speed: float | None, origin: Origin, findings: list[str]
) -> float:
    """Electrical speed in rad/s that values over an angle are divided by."""
    if capture.quantity == "flux":
        return 1.0
    if speed is None:
        findings.append("No speed was given: the values over the angle are taken for e / omega_e in V s/rad.")
        return 1.0
    if pole_pairs is None or speed == 0.0:
        raise origin.error("voltages over an angle need the number of pole pairs and a speed other than 0", None)
    return pole_pairs * speed


def _result(
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
    periods = _periods(fit.motion)
    radius, known = numerics.uncertainty(fit, periods)
    radius = radius + np.max(numerics.quantisation_error(steps, fit.noise))
    if not known:
        assumed = "white noise" if fit.motion.powers.size > 1 else "white noise and constant speed"
        findings.append(f"{periods:.1f} periods are too few to see disturbances; the uncertainty assumes {assumed}.")
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
            "The sequence is a, c, b: taken as a machine turning backwards. If it turned forwards, two channels are "
            "swapped; exchange their columns."
        )
    offsets, noise = np.resize(fit.offsets, 3), np.resize(fit.noise, 3)
    findings += checks.remarks(
        symmetry, offsets, noise, np.resize(volts, 3), drift, "Wb" if quantity == "flux" else "V"
    )
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


def _aligned(coefficients: ComplexArray) -> tuple[ComplexArray, Literal["abc", "acb"], float, float]:
    """Phasors A exp(-j phi) of three phases from coefficients of exp(j h angle), of one or three phases.

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


def _symmetry(phasors: ComplexArray, waveform: FloatArray) -> BemfSymmetry:
    """Compare three aligned phases by the phasors beyond doubt, shape (3, H), relative to waveforms, shape (3, M)."""
    fundamentals = phasors[:, 0] * _TURN ** np.arange(3)
    sizes = np.abs(fundamentals)
    mean = np.mean(sizes)
    evens = phasors[:, 1::2]
    theta = np.arange(WAVEFORM_POINTS) * (2.0 * np.pi / WAVEFORM_POINTS)
    halves = (1j * evens @ np.exp(2j * np.multiply.outer(np.arange(1, evens.shape[1] + 1), theta))).real
    return BemfSymmetry(
        amplitude=float(np.max(np.abs(sizes - mean)) / mean),
        displacement=float(np.max(np.abs(np.angle(fundamentals)))),
        even=float(np.max(np.sqrt(np.sum(np.abs(evens) ** 2, axis=1)) / sizes)),
        half_wave=float(np.max(np.max(np.abs(halves), axis=1) / np.max(np.abs(waveform), axis=1))),
    )
