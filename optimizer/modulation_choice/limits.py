"""Limits that a choice of modulator and switching frequency keeps, the points where it is made,
and who keeps what.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import DriveBudget

# What may bind a choice; ``voltage`` is the linear range of a modulator that would lose less.
LIMITS = (
    "ripple",
    "junction",
    "carrier ratio",
    "avoided band",
    "voltage",
    "least frequency",
    "largest frequency",
)

ROUNDING = 1e-12  # Relative excess that is rounding.


@dataclass(frozen=True, slots=True)
class ChoiceLimits:
    """What a choice must keep.

    ``f_min`` and ``f_max`` in Hz bound the switching frequency: the least one keeps the noise out
    of hearing or the control fast enough; ``bands`` (low, high) in Hz are left out between them.
    ``ripple_max`` in A is the largest r.m.s. of the phase-current ripple, None for any.
    ``junction_max`` in degC, None for what the device permits. ``carrier_ratio`` is the least
    number of carrier periods in an electrical one.
    """

    f_min: float
    f_max: float
    ripple_max: float | None = None
    junction_max: float | None = None
    bands: tuple[tuple[float, float], ...] = ()
    carrier_ratio: float = 0.0

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        if not 0.0 < self.f_min <= self.f_max < np.inf:
            raise InputError(
                f"switching frequencies from {self.f_min:g} to {self.f_max:g} Hz are no range"
            )

    def outside_bands(self, frequency: FloatArray) -> BoolArray:
        """Where frequencies in Hz lie in none of the bands; their ends are permitted."""
        inside = np.zeros(frequency.shape, dtype=np.bool_)
        for low, high in self.bands:
            inside |= (frequency > low) & (frequency < high)
        return ~inside

    def edges(self) -> FloatArray:
        """Ends of the bands within the range, in Hz."""
        ends = np.array([end for band in self.bands for end in band], dtype=np.float64)
        return ends[(ends > self.f_min) & (ends < self.f_max)]


@dataclass(frozen=True, slots=True)
class ChoicePoints:
    """Operating points, arrays of shape (P,): torque in N m, mechanical speed in rad/s,
    currents in A (peak).

    The currents may have the shape (M, P), one row for each modulator, with NaN where it cannot
    make the torque. ``weights`` are shares of time, None for all alike.
    """

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    weights: FloatArray | None = None


def limit_marks(
    budget: DriveBudget, frequency: FloatArray, ratio: FloatArray, limits: ChoiceLimits
) -> dict[str, BoolArray]:
    """Which limits a budget keeps at frequencies (F,) in Hz.

    ``ratio`` are electrical frequencies in Hz, shape (P,).
    """
    ripple = np.inf if limits.ripple_max is None else limits.ripple_max
    hottest = np.inf if limits.junction_max is None else limits.junction_max
    warm = budget.steady & budget.cool_enough & (budget.junction_temperature <= hottest)
    return {
        "voltage": np.asarray(budget.linear & budget.known),
        "ripple": np.asarray(budget.ripple_current <= ripple * (1.0 + ROUNDING)),
        "junction": np.asarray(warm),
        **frequency_marks(frequency[:, np.newaxis], ratio, limits),
    }


def frequency_marks(
    frequency: FloatArray, ratio: FloatArray, limits: ChoiceLimits
) -> dict[str, BoolArray]:
    """Limits of the frequency alone, (M, F, P)."""
    return {
        "carrier ratio": np.asarray(frequency >= limits.carrier_ratio * ratio * (1.0 - ROUNDING)),
        "avoided band": limits.outside_bands(frequency),
    }


def all_kept(marks: dict[str, BoolArray], without: str = "") -> BoolArray:
    """Where all limits are kept, or all but one."""
    kept = np.ones((), dtype=np.bool_)
    for name, mark in marks.items():
        if name != without:
            kept = kept & mark
    return np.asarray(kept)


def electrical_frequency(machine: Machine, points: ChoicePoints) -> FloatArray:
    """Electrical frequency in Hz at the points, shape (P,)."""
    return np.asarray(machine.pole_pairs * np.abs(points.omega_m) / (2.0 * np.pi))
