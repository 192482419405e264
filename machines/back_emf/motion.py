"""Frequency and angle of a periodic record over time, good enough to begin a
fit of its harmonics with.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

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
