"""What the edges of an encoder say of the speed: least and largest speed, resolution and delay.

An encoder gives N edges per revolution, a timer of the clock f_c and n bits takes their times, and
the speed controller asks every T_s seconds. With T_e = 2 pi/(N omega) between two edges:

    counts    omega = 2 pi m/(N T_s)            m edges in a speed period; window T_s
    capture   omega = 2 pi f_c/(N D)            D ticks between the last two edges; window T_e
    mixed     omega = 2 pi f_c m/(N D)          m edges in D ticks, from the last edge before the
                                                period to the last one in it; window about T_s

The mean over a window W that ended a time A ago lags by W/2 + A and is smaller by
sinc(omega W/2): A is nought for counts and T_e/2 on average for the others, as edges and samples
are not in step. One count more or less moves the speed by 2 pi/(N T_s), one tick by its share in D.

References:
    Paper 001, (8.1) to (8.6): capture with N = 1024, f_c = 1/33.9 ns and 16 bits. (8.1) is printed
    in rpm; its limits are (8.2) and one over D per unit. T. Ohmae et al., "A
    microprocessor-controlled high-accuracy wide-range speed regulator for motor drives", IEEE
    Trans. Industrial Electronics 29, 1982 (mixed, "M/T").
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import SpeedMeasurementSettings
from dqforge.machines.records import dataclass
from dqforge.optimizer.sampled_systems import ComplexArray

REST = 1.0  # Time in s without an edge after which the shaft counts as at rest.


@dataclass(frozen=True, slots=True)
class Edges:
    """Encoder and timer, asked every ``period`` s."""

    settings: SpeedMeasurementSettings
    period: float

    @property
    def timed(self) -> bool:
        """Whether a timer takes part."""
        return self.settings.method != "counts"

    @property
    def per_turn(self) -> int:
        """Edges per revolution that count."""
        return self.settings.lines * self.settings.edges

    @property
    def largest(self) -> float:
        """Mechanical speed in rad/s at which one tick lies between two edges, (8.2); endless for
        counts.
        """
        return 2.0 * np.pi * self.settings.clock / self.per_turn if self.timed else float("inf")

    @property
    def longest_period(self) -> float:
        """Longest period of the speed controller in s within which the timer runs over at most
        once; endless for counts.
        """
        own = self.settings
        return (2.0**own.counter_bits - 1.0) / own.clock if self.timed else float("inf")

    @property
    def patience(self) -> int:
        """Samples without an edge after which the shaft counts as at rest; 1 for counts."""
        if not self.timed:
            return 1
        return max(int(min(REST, 2.0**31 / self.settings.clock) / self.period), 1)

    @property
    def least(self) -> float:
        """Mechanical speed in rad/s below which the shaft counts as at rest; 0 for counts."""
        waited = self.patience * self.period
        return 2.0 * np.pi / (self.per_turn * waited) if self.timed else 0.0

    def window(self, omega_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Length of the window and its mean age at the sample, both in s, at mechanical speeds in
        rad/s of any shape.
        """
        between = 2.0 * np.pi / (self.per_turn * np.abs(omega_m))
        if not self.timed:
            return np.full_like(between, self.period), np.zeros_like(between)
        captured = self.settings.method == "capture"
        return between if captured else np.maximum(between, self.period), 0.5 * between

    def mean_delay(self, omega_m: FloatArray) -> FloatArray:
        """Mean delay of the speed in s, as `window`."""
        length, age = self.window(omega_m)
        return np.asarray(0.5 * length + age)

    def resolution(self, omega_m: FloatArray) -> FloatArray:
        """Change of the speed in rad/s by one count, or by one tick of the timer, as `window`."""
        if not self.timed:
            return np.full(np.shape(omega_m), 2.0 * np.pi / (self.per_turn * self.period))
        length, _ = self.window(omega_m)
        return np.asarray(np.abs(omega_m) / (length * self.settings.clock))

    def response(self, omega_m: float, omega: FloatArray) -> ComplexArray:
        """Measured over true speed at angular frequencies ``omega`` in rad/s, of their shape, at a
        mechanical speed in rad/s.
        """
        length, age = (float(part) for part in self.window(np.array(omega_m)))
        mean = np.sinc(omega * length / (2.0 * np.pi))
        return np.asarray(mean * np.exp(-1j * omega * (0.5 * length + age)))
