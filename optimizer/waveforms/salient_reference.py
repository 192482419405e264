"""Phase currents of salient machines as the firmware evaluates them:
harmonics whose weights are polynomials in torque.

Reluctance torque grows with the square of the current, so that the currents are not proportional to
the torque: what is emitted is i = T g(x, theta) with x = T / T_max and, per harmonic, a cosine and
a sine weight polynomial in x.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.frame_transforms import resampled
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import CONTRACTED, SINGLE
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    free_currents,
    least_currents,
    pointwise_currents,
    torque_forms,
)
from dqforge.optimizer.waveforms.firmware_fit import (
    PhaseCandidate,
    PhaseErrors,
    PhaseFit,
    PhasePolynomials,
    PhaseReference,
    are_equal,
)

_MOST_ORDER = 49


_MOST_DEGREE = 12


_NODES = 16  # even, so that none of them is zero torque


_COARSE_TORQUES = 21


_ANGLES = 1440


_TORQUES = 40  # even likewise: the currents per torque have no value at zero


_SYMMETRIC = 1e-9


_NOTHING = 1e-9


_SCAN = 64


_HALVINGS = 60


@lru_cache(maxsize=8)
def largest_torque(machine: SalientPhaseMachine, limits: WaveformLimits) -> float:
    """Largest torque in N m that is made constant with both signs within the current limit."""
    from scipy.optimize import brentq

    free = free_currents(limits.topology, limits.open_phase)
    forms = torque_forms(machine.flux, machine.slope, machine.pole_pairs, free)

    def room(torque: float) -> float:
        """What the current limit leaves in A, over both signs.

        Minus infinity where a torque cannot be made.
        """
        peak = float(np.max(np.abs(least_currents(forms, np.array([torque, -torque])))))
        return limits.i_max - peak if np.isfinite(peak) else -np.inf

    low = 0.0
    high = machine.pole_pairs * float(np.max(np.abs(machine.flux))) * limits.i_max / _SCAN
    # Refuses what no current makes, by the angle.
    pointwise_currents(machine, np.array([high, -high]), limits.topology, limits.open_phase)
    while room(high) >= 0.0:
        low, high = high, 1.125 * high
    if np.isfinite(room(high)):
        return float(brentq(room, low, high, xtol=1e-12 * high, rtol=1e-14))
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if room(middle) >= 0.0 else (low, middle)
    return low


@dataclass(frozen=True, slots=True, eq=False)
class _Exact:
    """Exact currents in A, shape (K, 3, M), at torques (K,) in N m, with what
    turns an error into torque.
    """

    machine: SalientPhaseMachine
    limits: WaveformLimits
    torque: FloatArray
    flux: FloatArray
    slope: FloatArray
    currents: FloatArray

    @property
    def turns(self) -> FloatArray:
        """Angles over 2 pi, shape (M,)."""
        count = self.flux.shape[1]
        return np.asarray(np.arange(count) / count)

    def made(self, currents: FloatArray) -> FloatArray:
        """Torque in N m, shape (K, M), of currents (K, 3, M) in A."""
        linear = np.einsum("km,xkm->xm", self.flux, currents)
        square = np.einsum("xkm,mkl,xlm->xm", currents, self.slope, currents)
        return np.asarray(self.machine.pole_pairs * (linear + 0.5 * square))


def _exact(
    machine: SalientPhaseMachine, limits: WaveformLimits, torque: FloatArray, count: int
) -> _Exact:
    """Optima at ``count`` even angles, on the trigonometric interpolation of the machine's data."""
    flux = resampled(machine.flux, count)
    slope = np.moveaxis(resampled(np.moveaxis(machine.slope, 0, -1), count), -1, 0)
    forms = torque_forms(
        flux, slope, machine.pole_pairs, free_currents(limits.topology, limits.open_phase)
    )
    return _Exact(machine, limits, torque, flux, slope, least_currents(forms, torque))


def _nodes() -> FloatArray:
    """Chebyshev nodes on -1 to 1, ascending."""
    return -np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Chebyshev coefficients over x of the harmonics' cosine and sine weights, shapes (R, H, n)."""

    cosine: FloatArray
    sine: FloatArray
    orders: FloatArray
    stride: int
    equal: bool


def _lines(machine: SalientPhaseMachine, limits: WaveformLimits, torque_max: float) -> _Lines:
    x = _nodes()
    currents = pointwise_currents(machine, torque_max * x, limits.topology, limits.open_phase)
    per_torque = currents / (torque_max * x)[:, np.newaxis, np.newaxis]
    equal = all(are_equal(waveform) for waveform in per_torque)
    spectrum = np.fft.rfft(per_torque[:, :1] if equal else per_torque, axis=-1) * (
        2.0 / machine.angles
    )
    most = float(np.max(np.abs(spectrum)))
    if np.max(np.abs(spectrum[:, :, 0])) > _SYMMETRIC * most:
        raise NoSolutionError(
            "waveform: the phase currents of this machine have a mean, which no form emits"
        )
    stride = 2 if np.max(np.abs(spectrum[:, :, 0::2])) <= _SYMMETRIC * most else 1
    orders = np.arange(1, _MOST_ORDER + 1, stride)
    chosen = np.moveaxis(spectrum[:, :, orders], 0, -1)
    basis = np.polynomial.chebyshev.chebvander(x, _NODES - 1).T * (2.0 / _NODES)
    basis[0] *= 0.5
    coefficients = np.einsum("rhx,nx->rhn", chosen, basis)
    parts = [
        np.where(np.abs(part) > _NOTHING * most, part, 0.0)
        for part in (coefficients.real, -coefficients.imag)
    ]
    return _Lines(parts[0], parts[1], orders.astype(np.float64), stride, equal)


def _form(
    lines: _Lines, torque_max: float, harmonics: int, degree: int, least: float
) -> PhasePolynomials:
    """Truncated polynomials; weights whose whole size stays below ``least`` A/(N m) are left
    out.
    """

    def monomials(part: FloatArray) -> tuple[tuple[tuple[float, ...], ...], ...]:
        rows = []
        for row in part[:, :harmonics, : degree + 1]:
            weights = []
            for series in row:
                kept = series if np.sum(np.abs(series)) > least else np.zeros(1)
                powers = np.polynomial.chebyshev.cheb2poly(kept)
                powers = np.where(
                    np.abs(powers) > _NOTHING * np.max(np.abs(powers), initial=0.0), powers, 0.0
                )
                weights.append(tuple(np.trim_zeros(powers.astype(np.float32), "b").tolist()))
            rows.append(tuple(weights))
        return tuple(rows)

    inverse = np.float32(1.0 / torque_max)
    return PhasePolynomials(monomials(lines.cosine), monomials(lines.sine), lines.stride, inverse)


def _errors(form: PhasePolynomials, exact: _Exact) -> PhaseErrors:
    """Largest errors over a dense grid of angles and torques, with and without fused
    multiply-add.
    """
    theta = 2.0 * np.pi * exact.turns
    sine, cosine = (
        np.tile(part.astype(np.float32), exact.torque.size)
        for part in (np.sin(theta), np.cos(theta))
    )
    torque = np.repeat(exact.torque.astype(np.float32), theta.size)
    peak, current, relative = float(np.max(np.abs(exact.currents))), 0.0, 0.0
    for o in (SINGLE, CONTRACTED):
        unit = np.stack(np.broadcast_arrays(*form.step(o, torque, sine, cosine)))
        found = np.moveaxis(
            (torque * unit).astype(np.float64).reshape(3, exact.torque.size, theta.size), 0, 1
        )
        current = max(current, float(np.max(np.abs(found - exact.currents))) / peak)
        away = (exact.made(found) - exact.torque[:, np.newaxis]) / exact.torque[:, np.newaxis]
        relative = max(relative, float(np.max(np.abs(away))))
    return PhaseErrors(current, relative, 2 * torque.size)


def _candidate(form: PhasePolynomials, exact: _Exact) -> PhaseCandidate:
    name = f"{form.size} harmonics of degree {form.degree} in the torque"
    return PhaseCandidate(name, form, _errors(form, exact), form.flash, form.operations)


def fit_salient_phases(
    machine: SalientPhaseMachine, limits: WaveformLimits, settings: WaveformSettings
) -> PhaseFit:
    """Phase currents over torque and angle for the firmware: constant torque at least copper loss,
    angle by angle.

    Raises:
        InputError: A table is asked for, or the pole pairs differ.
        NoSolutionError: Constant torque cannot be made at some angle, or no form keeps the error.
    """
    if settings.form == "table":
        raise InputError(
            "waveform.form: a table over the angle needs currents in proportion to the torque, "
            "which those of a salient machine are not; write harmonics"
        )
    if machine.turns > 1:
        raise InputError(
            "machine.inductance_harmonics: currents that are not in proportion to the torque, for "
            "pole pairs that differ, fit no form of the firmware; leave out back_emf.span"
        )
    torque_max = largest_torque(machine, limits)
    lines = _lines(machine, limits, torque_max)
    grid = torque_max * np.linspace(-1.0, 1.0, _TORQUES)
    exact = _exact(machine, limits, grid, _ANGLES)
    coarse = _exact(machine, limits, torque_max * np.linspace(-1.0, 1.0, _COARSE_TORQUES + 1), 180)
    least = 0.02 * settings.error * limits.i_max / torque_max
    found = []
    for degree in range(_MOST_DEGREE + 1):
        for harmonics in range(1, lines.orders.size + 1):
            form = _form(lines, torque_max, harmonics, degree, least)
            if _errors(form, coarse).current > settings.error:
                continue
            candidate = _candidate(form, exact)
            if candidate.errors.current <= settings.error:
                found.append(candidate)
                break
        if len(found) == 2:
            break
    if not found:
        raise NoSolutionError(
            f"waveform.error: no harmonics up to order {_MOST_ORDER} with polynomials of degree "
            f"{_MOST_DEGREE} keep {100.0 * settings.error:.3g} % of the peak; permit a larger error"
        )
    chosen = min(found, key=lambda entry: (entry.operations, entry.flash))
    rest = tuple(entry for entry in found if entry is not chosen)
    return PhaseFit(
        PhaseReference(chosen.form, np.float32(torque_max)), (chosen, *rest), torque_max
    )
