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
from dqforge.machines.phase_machines.phase_machine import angles_of, grid
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


# Frequency and angle of a periodic record over time, good enough to begin a
# fit of its harmonics with.

# Samples from which on spectra are taken in single precision, and residuals kept so: a record of
# 8e6 samples shall take less than 1 GiB.
LONG = 1 << 20

# Periods below which neighbouring lines of the spectrum run into each other, so that the frequency
# is searched.
_SHORT = 4.0


@dataclass(frozen=True, slots=True)
class Motion:
    """Electrical angle over a record of N samples.

    Args:
        u: Time from -1 at the first to 1 at the last sample, shape (N,); zeros where the angle is
            given.
        half: Half the length of the record in s.
        unit_speed: Electrical speed in rad/s that counts as 1 in `rate`.
        powers: theta = sum powers[i] u^(i + 1) in rad, shape (P,).
        given: The angle itself in rad, shape (N,), where it was recorded; the powers are then
            empty.
    """

    u: FloatArray
    half: float
    unit_speed: float
    powers: FloatArray
    given: FloatArray | None = None

    def angle(self) -> FloatArray:
        """Electrical angle in rad, 0 in the middle of a record over time, shape (N,)."""
        if self.given is not None:
            return self.given
        return np.asarray(
            np.polynomial.polynomial.polyval(self.u, np.concatenate([[0.0], self.powers]))
        )

    def rate(self) -> FloatArray:
        """Electrical speed at each sample over `unit_speed`, shape (N,)."""
        if self.given is not None:
            return np.ones_like(self.given)
        slopes = (
            np.arange(1.0, self.powers.size + 1.0) * self.powers / (self.half * self.unit_speed)
        )
        return np.asarray(np.polynomial.polynomial.polyval(self.u, slopes))

    def thinned(self, stride: int) -> Motion:
        """Every ``stride``-th sample of it."""
        return self.part(slice(None, None, stride))

    def part(self, samples: slice) -> Motion:
        """Some of its samples."""
        return replace(
            self, u=self.u[samples], given=None if self.given is None else self.given[samples]
        )

    @property
    def frequency(self) -> float:
        """Mean electrical frequency in Hz."""
        return float(np.sum(self.powers[::2])) / (2.0 * np.pi * self.half)


def sample_interval(time: FloatArray) -> float:
    """Mean distance in s of ascending sample times, shape (N,)."""
    return float(time[-1] - time[0]) / (time.size - 1)


def evenly(time: FloatArray, values: FloatArray) -> FloatArray:
    """Values, shape (K, N), at evenly spaced times.

    As they are if the times are even to a tenth of a step.
    """
    step = sample_interval(time)
    # In parts: a long record has no room for differences of all its samples.
    parts = ((start, time[start : start + LONG]) for start in range(0, time.size, LONG))
    if all(
        np.max(np.abs(part - (time[0] + step * np.arange(k, k + part.size)))) < 0.1 * step
        for k, part in parts
    ):
        return values
    even = np.linspace(time[0], time[-1], time.size)
    return np.stack([np.interp(even, time, row) for row in values])


def rough_frequency(time: FloatArray, voltages: FloatArray) -> tuple[float, float]:
    """Fundamental frequency in Hz of channels, shape (K, N), good to a fraction of 1 / length.

    With it the share of the channels' power that lies within 15 % of it: nearly all of a machine's,
    little of noise.
    """
    length = time.size * sample_interval(time)
    count = spectrum_size(time.size)
    length *= count / time.size
    window = np.hanning(count)
    power = np.zeros(count // 2 + 1)
    for row in voltages:
        even = evenly(time, row[None])[0, :count]
        power += spectrum((even - np.mean(even)) * window)
    peak = 1 + int(np.argmax(power[1:-1]))
    if peak < _SHORT + 1.0:
        return _searched_frequency(time, voltages)
    left, middle, right = np.log(power[peak - 1 : peak + 2] + 1e-300)
    bend = left - 2.0 * middle + right
    wide = 3 + int(0.15 * peak)
    share = float(np.sum(power[max(1, peak - wide) : peak + wide + 1]) / np.sum(power[1:]))
    return float(peak + (0.5 * (left - right) / bend if bend < 0.0 else 0.0)) / length, share


def spectrum_size(count: int) -> int:
    """Samples of a record that its spectrum is taken of: all, or nearly all of a long one,
    for which it is quick.
    """
    if count <= LONG:
        return count
    step = 1 << (count.bit_length() - 11)
    return count // step * step


def spectrum(values: FloatArray) -> FloatArray:
    """Squared magnitudes of the spectrum of samples, shape (N,); result shape (N / 2 + 1,)."""
    if values.size <= LONG:
        return np.asarray(np.abs(np.fft.rfft(values)) ** 2)
    from scipy.fft import rfft  # in single precision, unlike NumPy's

    lines = rfft(values.astype(np.float32, copy=False))
    return np.asarray(lines.real**2 + lines.imag**2, dtype=np.float64)


def _searched_frequency(time: FloatArray, voltages: FloatArray) -> tuple[float, float]:
    """Frequency in Hz whose offset and fundamental leave least of a record of few periods,
    from 0.3 to 6 of them.

    With it the share of the channels' power that they explain.
    """
    stride = max(1, time.size // 1024)
    length = time.size * sample_interval(time)
    phase = (time[::stride] - time[0]) / length
    values = voltages[:, ::stride] - np.mean(voltages, axis=1, keepdims=True)
    periods = np.linspace(0.3, 6.0, 229)
    turn = 2.0 * np.pi * np.multiply.outer(periods, phase)
    basis = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)  # (F, 3, n)
    right = basis @ values.T  # (F, 3, K)
    explained = np.sum(
        right * np.linalg.solve(basis @ basis.transpose(0, 2, 1), right), axis=(1, 2)
    )
    return float(periods[np.argmax(explained)]) / length, float(
        np.max(explained) / np.sum(values**2)
    )


def rough_motion(time: FloatArray, voltages: FloatArray, frequency: float) -> Motion:
    """Angle to start from: constant speed for a short record, else the phase of
    the channel with most of it.

    The phase of the fundamental is that of the channel times exp(-j w t), averaged twice over a
    period, which removes the offset and the harmonics. A polynomial goes through it: of degree 2 up
    to 5 periods, then of degree 3.
    """
    middle, half = 0.5 * (time[0] + time[-1]), 0.5 * float(time[-1] - time[0])
    omega = 2.0 * np.pi * frequency
    periods = frequency * time.size * sample_interval(time)
    degree = 1 + int(periods >= 1.5) + int(periods >= 5.0)
    start = Motion((time - middle) / half, half, omega, np.array([omega * half, 0.0, 0.0][:degree]))
    window = round(time.size / periods)
    if periods < _SHORT:
        return start
    if time.size > LONG:
        places, phase = _long_phase(time, voltages, omega * half, window)
    else:
        places, phase = _phase(time, voltages, omega * half, window)
    bends = np.polynomial.polynomial.polyfit(places, phase, degree)
    return replace(start, powers=start.powers + bends[1:])


def _phase(
    time: FloatArray, voltages: FloatArray, speed: float, window: int
) -> tuple[FloatArray, FloatArray]:
    """Some 2048 places from -1 to 1, and the phase in rad by which the best channel leads
    ``speed`` times the place.
    """
    grid = np.linspace(-1.0, 1.0, time.size)
    even = evenly(time, voltages - np.mean(voltages, axis=1, keepdims=True))
    slow = even * np.exp(-1j * speed * grid)
    for _ in range(2):
        total = np.cumsum(np.pad(slow, ((0, 0), (1, 0))), axis=1)
        slow = (total[:, window:] - total[:, :-window]) / window
    # The largest channel may be the one that is nothing but noise.
    share = np.mean(np.abs(slow) ** 2, axis=1) / (np.mean(even**2, axis=1) + 1e-300)
    inner = slice(window - 1, window - 1 + slow.shape[1])
    stride = max(1, slow.shape[1] // 2048)
    phase = np.unwrap(np.angle(slow[int(np.argmax(share))]))[::stride]
    return grid[inner][::stride], phase


def _long_phase(
    time: FloatArray, voltages: FloatArray, speed: float, window: int
) -> tuple[FloatArray, FloatArray]:
    """Like `_phase` for long records: of not many more samples to the period than that needs,
    once a period.
    """
    stride = max(1, window // 64)
    wide = max(1, window // stride)
    grid = np.linspace(-1.0, 1.0, time.size)[::stride]
    # Two running means over a period weigh its samples by a triangle of two.
    weights = np.minimum(np.arange(1.0, 2 * wide), np.arange(2.0 * wide - 1.0, 0.0, -1.0)) / wide**2
    firsts = np.arange(0, grid.size - weights.size + 1, wide)
    found, best = np.empty((0,)), -1.0
    for row in voltages:
        even = evenly(time, row[None])[0, ::stride]
        even = even - np.mean(even)
        slow = np.empty(firsts.size, np.complex128)
        for begin in range(0, firsts.size, 2048):
            samples = firsts[begin : begin + 2048, None] + np.arange(weights.size)
            slow[begin : begin + 2048] = (
                even[samples] * np.exp(-1j * speed * grid[samples])
            ) @ weights
        share = float(np.mean(np.abs(slow) ** 2) / (np.mean(even**2) + 1e-300))
        if share > best:
            found, best = np.unwrap(np.angle(slow)), share
    return grid[firsts + wide - 1], found


# Whether the pole pairs of a machine differ: the harmonics of a capture over the mechanical turn.
#
# With theta the electrical angle, orders are multiples of 1/p: those that are not whole are what
# one pole pair has and another has not. A speed that ripples with the mechanical turn makes the
# same orders, but raises and lowers the three phases at the same instant.

_MOST_UNKNOWNS = 400


_MOST_SAMPLES = 100_000


_SAMPLES_PER_PERIOD = 8.0  # of the highest order


_NOTED = 0.01


_TOGETHER = 0.75


_WIDEST_GAP = np.pi / 4.0


@dataclass(frozen=True, slots=True, eq=False)
class PolePairs:
    """The back-EMF over a mechanical turn of p pole pairs, per electrical speed.

    Args:
        turns: Number of pole pairs p.
        revolutions: Mechanical turns that it was found from.
        orders: Of the electrical angle, 1/p, 2/p, ..., shape (M,).
        amplitudes, phases, amplitude_uncertainty: As those of a `BemfResult`, shape (3, M).
        waveform: e / omega_e in V s/rad over theta = 2 pi p j / N, from the harmonics, shape (3,
            N).
        fundamentals: Amplitude of the fundamental in V s/rad within each pole pair, shape (3, p).
        spread: Largest deviation of one of them from the mean of its phase, over that mean.
        doubt: Half width of the 95 % interval of that deviation, from the uncertainty of the orders
            between 0 and 2.
        common: Share of the differences that all three phases have at the same instant, as a ripple
            of the speed makes them: 0 to 1.
        differ: Whether the differences exceed what their uncertainty explains.
    """

    turns: int
    revolutions: float
    orders: FloatArray
    amplitudes: FloatArray
    phases: FloatArray
    amplitude_uncertainty: FloatArray
    waveform: FloatArray
    fundamentals: FloatArray
    spread: float
    doubt: float
    common: float
    differ: bool

    @property
    def finding(self) -> str:
        """A sentence for the user; empty where there is nothing to say."""
        if not self.differ or self.spread < _NOTED:
            return ""
        text = (
            f"The pole pairs differ: within a mechanical turn the fundamental of a phase departs "
            f"from its mean by up to {self.spread:.1%} (+- {self.doubt:.1%}), which is averaged; "
            "back_emf.span: mechanical in a design keeps it."
        )
        if self.common < _TOGETHER:
            return text
        return (
            f"{text} All three phases rise and fall together ({self.common:.0%} of it), as where "
            "the speed ripples with the turn: capture with more inertia to tell the two apart."
        )


def covers_turn(motion: Motion, periods: float, pole_pairs: int) -> bool:
    """Whether a record of so many electrical periods shows each pole pair."""
    if motion.given is None:
        return periods >= 0.98 * pole_pairs
    whole = 2.0 * np.pi * pole_pairs
    seen = np.sort(np.mod(motion.given, whole))
    return bool(np.max(np.diff(np.concatenate([seen, seen[:1] + whole]))) <= 1.001 * _WIDEST_GAP)


def fit_pole_pairs(
    motion: Motion,
    voltages: FloatArray,
    periods: float,
    pole_pairs: int,
    harmonics: int,
) -> HarmonicFit:
    """Harmonics of three channels over the mechanical angle, of a motion that is known.

    Long records are thinned to what the highest order needs, and their beginning is taken.

    Args:
        motion: Of the electrical angle, as the whole periods have shown it.
        voltages: Channels, shape (3, N).
        periods: Electrical periods that they hold.
        pole_pairs: Number of pole pairs.
        harmonics: Highest order of the electrical angle that is wanted.
    """
    count = max(1, min(harmonics, _MOST_UNKNOWNS // pole_pairs))
    samples = voltages.shape[1] / periods
    stride = max(1, int(samples / (_SAMPLES_PER_PERIOD * count))) if motion.given is None else 1
    part = slice(0, stride * max(_MOST_SAMPLES, int(1.05 * pole_pairs * samples / stride)), stride)
    turning = motion.part(part)
    mechanical = replace(
        turning,
        unit_speed=turning.unit_speed / pole_pairs,
        powers=turning.powers / pole_pairs,
        given=None if turning.given is None else turning.given / pole_pairs,
    )
    return fit_linear(mechanical, voltages[:, part], pole_pairs * count)


def pole_pairs_of(
    phasors: ComplexArray, radius: FloatArray, pole_pairs: int, revolutions: float
) -> PolePairs:
    """What aligned phasors A exp(-j phi) in V s/rad and their uncertainty, shapes (3, M),
    say of the pole pairs.
    """
    orders = np.arange(1, phasors.shape[1] + 1) / pole_pairs
    theta = grid(angles_of(pole_pairs), pole_pairs)
    waveform = (1j * phasors @ np.exp(1j * np.multiply.outer(orders, theta))).real
    turned = (waveform * np.exp(-1j * theta)).reshape(3, pole_pairs, -1)
    fundamentals = 2.0 * np.abs(np.mean(turned, axis=2))
    means = np.mean(fundamentals, axis=1, keepdims=True)
    around = slice(0, min(2 * pole_pairs - 1, orders.size))
    between = np.flatnonzero(np.arange(1, orders.size + 1)[around] % pole_pairs)
    uncertain = np.sqrt(np.sum(radius[:, between] ** 2, axis=1, keepdims=True))
    ratio = np.abs(phasors[:, between]) / np.maximum(radius[:, between], 1e-300)
    sides = phasors[:, between] / phasors[:, pole_pairs - 1 : pole_pairs]
    power = float(np.sum(np.abs(sides) ** 2))
    together = 3.0 * float(np.sum(np.abs(np.mean(sides, axis=0)) ** 2))
    return PolePairs(
        turns=pole_pairs,
        revolutions=revolutions,
        orders=orders,
        amplitudes=np.abs(phasors),
        phases=-np.angle(phasors),
        amplitude_uncertainty=radius,
        waveform=waveform,
        fundamentals=fundamentals,
        spread=float(np.max(np.abs(fundamentals - means) / means)),
        doubt=float(np.max(uncertain / means)),
        common=together / power if power > 0.0 else 0.0,
        differ=bool(np.mean(ratio**2) > 1.0),
    )
