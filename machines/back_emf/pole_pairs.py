"""Whether the pole pairs of a machine differ: the harmonics of a capture over the mechanical turn.

With theta the electrical angle, orders are multiples of 1/p: those that are not whole are what one
pole pair has and another has not. A speed that ripples with the mechanical turn makes the same
orders, but raises and lowers the three phases at the same instant.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf import harmonics as numerics
from dqforge.machines.back_emf.harmonics import ComplexArray, HarmonicFit
from dqforge.machines.back_emf.motion import Motion
from dqforge.machines.phase_machines.phase_machine import angles_of, grid
from dqforge.machines.records import dataclass

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
    return numerics.fit_linear(mechanical, voltages[:, part], pole_pairs * count)


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
