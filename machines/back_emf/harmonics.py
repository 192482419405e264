"""Numerics of a periodic record: its frequency, its drifting angle, and its
harmonics by least squares.

The record is modelled as v_k(t) = o_k + dtheta/dt Re sum_h C_kh exp(j h theta) for each channel k,
with theta a polynomial in time: a back-EMF grows with the speed at each instant, so that a record
of drifting speed needs neither resampling nor whole periods. The harmonics and offsets enter
linearly and are eliminated (variable projection); the few numbers of theta are found by
Gauss-Newton.

References:
    G. Golub, V. Pereyra, "Separable nonlinear least squares: the variable projection method and its
    applications", Inverse Problems 19(2), 2003, doi:10.1088/0266-5611/19/2/201.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf.motion import LONG, Motion, evenly, spectrum, spectrum_size
from dqforge.machines.records import dataclass

ComplexArray = NDArray[np.complex128]

# Samples multiplied at a time: products so small are not spread over threads, whose start would
# take longer.
_BLOCK = 128

# Blocks whose design matrix is held at a time: a long record needs no more memory than a short one.
_CHUNK = 16
_ITERATIONS = 12
_MISS = 0.05  # Probability that a coefficient lies outside its stated uncertainty.


@dataclass(frozen=True, slots=True)
class HarmonicFit:
    """Least-squares harmonics of K channels over a record of N samples.

    Args:
        motion: The angle at which they hold.
        coefficients: C of v = offset + rate Re sum C_h exp(j h theta), orders 1..H, in the unit of
            the channels, shape (K, H).
        offsets: Constant part of each channel, shape (K,).
        residual: What the model leaves, shape (K, N).
        noise: Its r.m.s., corrected for the number of unknowns, shape (K,).
        explained: Share of each channel's variance that the model explains, shape (K,).
        deviation: Standard deviation of the real or imaginary part of the coefficients for white
            noise, shape (K, H).
        condition: Condition number of the normal equations.
    """

    motion: Motion
    coefficients: ComplexArray
    offsets: FloatArray
    residual: FloatArray
    noise: FloatArray
    explained: FloatArray
    deviation: FloatArray
    condition: float


def _gram(
    motion: Motion,
    voltages: FloatArray,
    harmonics: int,
    coefficients: ComplexArray | None,
    progress: Callable[[float], None] | None = None,
) -> FloatArray:
    """Inner products of all columns of the model: cosines, sines, constant; slopes by the powers,
    (K, P); channels.
    """
    powers = np.arange(motion.powers.size)[:, None]
    gram = np.zeros(())
    for part in _parts(voltages.shape[1]):
        some = motion.part(part)
        angle, rate, one, u = _blocked(
            np.stack([some.angle(), some.rate(), np.ones_like(some.u), some.u])
        )
        turn, speed = _turns(angle, harmonics), rate[:, None]
        rows = [turn.real * speed, turn.imag * speed, one[:, None]]
        if coefficients is not None and powers.size:
            u_powers = u[:, None] ** powers * one[:, None]  # (B, P, n)
            shape = (coefficients @ turn).real
            slope = (coefficients * (1j * np.arange(1, harmonics + 1)) @ turn).real
            by_rate = (powers + 1) * u_powers / (motion.half * motion.unit_speed)
            by_angle = speed * u[:, None] * u_powers
            both = (
                shape[:, :, None] * by_rate[:, None] + slope[:, :, None] * by_angle[:, None]
            )  # (B, K, P, n)
            rows.append(both.reshape(both.shape[0], -1, _BLOCK))
        rows.append(_blocked(voltages[:, part]).transpose(1, 0, 2))
        block = np.concatenate(rows, axis=1)
        gram = gram + np.sum(block @ block.transpose(0, 2, 1), axis=0)
        if progress is not None:
            progress(min(part.stop / voltages.shape[1], 1.0))
    return gram


def _parts(count: int) -> list[slice]:
    """Samples that are looked at together."""
    return [slice(start, start + _CHUNK * _BLOCK) for start in range(0, count, _CHUNK * _BLOCK)]


def _blocked(rows: FloatArray) -> FloatArray:
    """Rows, shape (R, N), in blocks of samples, shape (R, B, n), with zeros behind the last."""
    count = rows.shape[1]
    blocks = -(-count // _BLOCK)
    return np.pad(rows, ((0, 0), (0, blocks * _BLOCK - count))).reshape(-1, blocks, _BLOCK)


def _turns(angle: FloatArray, harmonics: int) -> ComplexArray:
    """exp(j h theta) for h = 1..H of angles in rad, shape (B, n); result shape (B, H, n)."""
    turn = np.exp(1j * angle)[:, None]
    return np.asarray(
        np.cumprod(np.broadcast_to(turn, (turn.shape[0], harmonics, turn.shape[2])), axis=1)
    )


@dataclass(frozen=True, slots=True)
class _Step:
    """One Gauss-Newton step: new coefficients and powers, and what their covariance is made of."""

    linear: FloatArray  # (2H + 1, K)
    change: FloatArray  # (P,)
    spread: FloatArray  # covariance of the powers, (P, P)
    unit_variance: FloatArray  # of the linear unknowns, per noise variance, (2H + 1,)
    leverage: FloatArray  # change of the linear unknowns with the powers, (2H + 1, K, P)
    condition: float

    def coefficients(self) -> ComplexArray:
        harmonics = self.linear.shape[0] // 2
        return np.asarray((self.linear[:harmonics] - 1j * self.linear[harmonics : 2 * harmonics]).T)


def _solve(gram: FloatArray, harmonics: int, channels: int, powers: int, count: int) -> _Step:
    """Eliminate the linear unknowns from the inner products and solve for
    the change of the powers.
    """
    size = 2 * harmonics + 1
    scales, vectors = np.linalg.eigh(gram[:size, :size])
    condition = float(scales[-1] / max(scales[0], 1e-300))
    inverse = (vectors / np.maximum(scales, 1e-13 * scales[-1])) @ vectors.T
    across = inverse @ gram[:size, size:]
    rest = gram[size:, size:] - gram[:size, size:].T @ across
    slopes = gram.shape[0] - size - channels
    linear = across[:, slopes:]
    least = 1e-20 * np.diag(gram)[size + slopes :]
    left = np.maximum(np.diag(rest)[slopes:], least) / count
    change, spread = np.zeros(powers), np.zeros((powers, powers))
    leverage = across[:, :slopes].reshape(size, channels, -1)
    if slopes:
        picked = np.arange(channels)
        by_channel = rest[:slopes, :slopes].reshape(channels, powers, channels, powers)[
            picked, :, picked, :
        ]
        spread = np.linalg.pinv(np.sum(by_channel / left[:, None, None], axis=0), hermitian=True)
        towards = rest[:slopes, slopes:].reshape(channels, powers, channels)[picked, :, picked]
        change = spread @ np.sum(towards / left[:, None], axis=0)
        # What the step itself removes is no noise.
        removed = 2.0 * towards @ change - np.einsum("p,kpq,q->k", change, by_channel, change)
        left = np.maximum(np.diag(rest)[slopes:] - removed, least) / count
        spread = np.linalg.pinv(np.sum(by_channel / left[:, None, None], axis=0), hermitian=True)
        linear = linear - np.einsum("skp,p->sk", leverage, change)
    return _Step(linear, change, spread, np.diag(inverse), leverage, condition)


def fit_harmonics(
    motion: Motion,
    voltages: FloatArray,
    harmonics: int,
    coefficients: ComplexArray | None = None,
    progress: Callable[[float], None] | None = None,
) -> HarmonicFit:
    """Harmonics 1..H and offsets of channels, shape (K, N), and the angle
    that suits all of them best.

    Unequal sampling, fractions of a period and drifting speed are part of the model. ``motion`` is
    where the search begins, with the first ``coefficients``, shape (K, up to H), if they are known;
    an angle that was recorded is kept. ``progress`` is told the share that is done, as if each
    further step were half as likely as the one before.
    """
    channels, count = voltages.shape
    degree = motion.powers.size
    if coefficients is None or not degree:
        step = _solve(_gram(motion, voltages, harmonics, None), harmonics, channels, degree, count)
        coefficients = step.coefficients()
    coefficients = np.pad(coefficients, ((0, 0), (0, harmonics - coefficients.shape[1])))
    for place in range(_ITERATIONS if degree else 0):

        def tell(share: float, place: int = place) -> None:
            if progress is not None:
                progress(1.0 - 0.5 ** (place + share))

        step = _solve(
            _gram(motion, voltages, harmonics, coefficients, tell),
            harmonics,
            channels,
            degree,
            count,
        )
        coefficients = step.coefficients()
        size = float(np.sum(np.abs(step.change)))
        # Beyond a radian the model is not linear any more, and the step would overshoot.
        damping = min(1.0, 1.0 / max(size, 1e-300))
        motion = replace(motion, powers=motion.powers + damping * step.change)
        # The coefficients have followed the step already; what it still errs by is
        # of the order of its square.
        certain = 0.2 * float(np.sqrt(np.maximum(np.min(np.diag(step.spread)), 0.0)))
        if harmonics * size**2 < max(certain, 1e-11):
            break
    return _completed(motion, voltages, step)


def fit_linear(motion: Motion, voltages: FloatArray, harmonics: int) -> HarmonicFit:
    """Harmonics 1..H and offsets of channels, shape (K, N), of a motion that is known."""
    channels, count = voltages.shape
    gram = _gram(motion, voltages, harmonics, None)
    return _completed(motion, voltages, _solve(gram, harmonics, channels, 0, count))


def _completed(motion: Motion, voltages: FloatArray, step: _Step) -> HarmonicFit:
    """Residuals and their statistics for the solution of the last step."""
    channels, count = voltages.shape
    coefficients, offsets = step.coefficients(), step.linear[-1]
    harmonics = coefficients.shape[1]
    residual = np.empty((channels, count), np.float64 if count <= LONG else np.float32)
    left = np.zeros(channels)
    for part in _parts(count):
        some = motion.part(part)
        shape = (
            coefficients @ _turns(_blocked(some.angle()[None])[0], harmonics)
        ).real  # (B, K, n)
        shape = shape.transpose(1, 0, 2).reshape(channels, -1)[:, : some.u.size]
        rest = voltages[:, part] - offsets[:, None] - shape * some.rate()
        left += np.sum(rest**2, axis=1)
        residual[:, part] = rest
    freedom = max(count - step.linear.shape[0] - motion.powers.size / channels, 1.0)
    noise = np.sqrt(left / freedom)
    through_powers = np.einsum("skp,pq,skq->sk", step.leverage, step.spread, step.leverage)
    variance = step.unit_variance[:, None] * noise**2 + through_powers
    deviation = np.sqrt(
        np.maximum(np.maximum(variance[:harmonics], variance[harmonics : 2 * harmonics]), 0.0)
    ).T
    total = np.maximum(np.array([np.var(row) for row in voltages]) * count, 1e-300)
    return HarmonicFit(
        motion,
        coefficients,
        offsets,
        residual,
        noise,
        1.0 - left / total,
        np.asarray(deviation),
        step.condition,
    )


def uncertainty(fit: HarmonicFit, periods: float) -> tuple[FloatArray, bool]:
    """Radius of the disc that holds each complex coefficient with 95 %, shape (K, H).

    An amplitude errs by no more.

    White noise spreads evenly over the spectrum; hum, speed ripple and unequal magnets do not. The
    spectrum of the residual just beside each harmonic therefore tells how much more (never less)
    than white noise disturbs it, and from how few lines that is known widens the disc (F
    distribution). The flag is False where the record is too short to have lines between the
    harmonics, so that white noise had to be assumed.
    """
    harmonics = fit.coefficients.shape[1]
    excess, lines = np.ones_like(fit.deviation), np.full(harmonics, float(fit.residual.shape[1]))
    known = fit.motion.given is not None
    if not known:
        size = spectrum_size(fit.residual.shape[1])
        lines_per_order = periods * size / fit.residual.shape[1]
        order = (
            np.arange(min(size // 2 + 1, int((harmonics + 2) * lines_per_order) + 2))
            / lines_per_order
        )
        # The fit has taken out what lies within about a line of each harmonic.
        hole = np.abs(order - np.round(order)) * periods < 0.75
        free = np.where(hole & (order < harmonics + 0.5), 0.0, 1.0)
        wide = min(1.5, 16.0 / periods)
        centre = np.arange(1, harmonics + 1)
        first, last = np.searchsorted(order, centre - wide), np.searchsorted(order, centre + wide)
        counts = np.concatenate([[0.0], np.cumsum(free)])
        found = counts[last] - counts[first]
        known = bool(np.min(found) >= 4.0)
        if known:
            lines = found
            for row, channel in zip(excess, fit.residual, strict=True):
                power = spectrum(evenly(fit.motion.u, channel[None])[0, :size])
                power /= np.mean(power) + 1e-300
                sums = np.concatenate([[0.0], np.cumsum(power[: order.size] * free)])
                row[:] = np.maximum((sums[last] - sums[first]) / found, 1.0)
    freedom = 2.0 * lines
    return fit.deviation * np.sqrt(excess * freedom * (_MISS ** (-2.0 / freedom) - 1.0)), known


def resolution(values: FloatArray) -> float:
    """Step of the converter behind samples, shape (N,); 0 where most values occur once,
    so that none is seen.
    """
    levels = np.unique(values)
    if levels.size < 3 or levels.size > 0.5 * values.size:
        return 0.0
    return float(np.quantile(np.diff(levels), 0.1))


def quantisation_error(step: FloatArray, noise: FloatArray) -> FloatArray:
    """Largest error of a harmonic's amplitude by rounding to steps, for total r.m.s. noise,
    both of shape (K,).

    (q / pi) exp(-2 pi^2 (s / q)^2): the first term of the rounding error's Fourier series, averaged
    over the noise s before rounding. From half a step of noise on it vanishes; without noise it is
    all that there is.
    """
    before = np.maximum(noise**2 - step**2 / 12.0, 0.0)
    ratio = before / np.maximum(step**2, before / 30.0 + 1e-300)
    return np.asarray(step / np.pi * np.exp(-2.0 * np.pi**2 * ratio))
