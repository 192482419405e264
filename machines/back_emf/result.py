"""What a capture of the back-EMF says: harmonics per speed and the agreement of the phases."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf import checks
from dqforge.machines.back_emf import harmonics as numerics
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.back_emf.columns import Connection
from dqforge.machines.back_emf.harmonics import ComplexArray, HarmonicFit
from dqforge.machines.back_emf.motion import Motion
from dqforge.machines.back_emf.pole_pairs import PolePairs, pole_pairs_of
from dqforge.machines.back_emf.remarks import BemfSymmetry, remarks
from dqforge.machines.records import dataclass

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
    findings += remarks(
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
