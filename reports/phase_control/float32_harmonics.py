"""Harmonic integrators of the control of phase machines on numpy arrays of float32: as
``harmonics.j2``, same operations, same bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.reports.c_code.float32_functions import turned
from dqforge.reports.phase_control.float32_duties import Stationary

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.reports.phase_control.float32_parts import Gains, Turn
    from dqforge.reports.phase_control.structure import Structure

_ZERO, _ONE, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)


class Integrals(Protocol):
    """Real and imaginary parts by order, arrays of shape (N,)."""

    harmonic: dict[int, tuple[SingleArray, ...]]
    harmonic_zero: dict[int, tuple[SingleArray, ...]]


def multiples_of(turn: Turn, orders: Sequence[int]) -> dict[int, Turn]:
    """Cosine and sine of multiples of an angle, ascending, by recurrence."""
    twice, x, reached, found = turned(turn, turn), turn, 1, {}
    for order in orders:
        for _ in range((order - reached) // 2):
            x = turned(x, twice)
        if (order - reached) % 2:
            x = turned(x, turn)
        reached, found[order] = order, x
    return found


def harmonic_share(gains: Gains, order: int, omega_e: SingleArray) -> SingleArray:
    """Share of a harmonic at an electrical speed in rad/s."""
    share = np.float32(5.0) - (gains["harmonic_fade"] * np.abs(np.float32(order) * omega_e))
    return np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))


def signed_turn(multiples: Mapping[int, Turn], order: int) -> Turn:
    """Rotation of a signed order."""
    cosine, sine = multiples[abs(order)]
    return cosine, (-sine if order < 0 else sine)


def harmonic_gain(
    kp: Any, r_s: Any, reactance: SingleArray, now: Turn, acting: Turn
) -> tuple[SingleArray, SingleArray]:
    """What turns an integral into its voltage, real and imaginary part in V/A.

    Args:
        kp: Of the controller in V/A.
        r_s, reactance: Of the machine at the harmonic, in Ohm.
        now, acting: Multiples of the angles of the sample and of the voltage.
    """
    return (
        (kp * now[0]) + ((r_s * acting[0]) - (reactance * acting[1])),
        (kp * now[1]) + ((r_s * acting[1]) + (reactance * acting[0])),
    )


@dataclass(frozen=True, slots=True)
class Turning:
    """The integrators at one sample of N drives.

    Args:
        gains, made: As of the model.
        omega_e: Electrical speed in rad/s, shape (N,).
        now, acting: Angles of the sample and of the voltage.
    """

    gains: Gains
    made: Structure
    omega_e: SingleArray
    now: Turn
    acting: Turn

    def voltage(self, state: Integrals, v: Stationary) -> Stationary:
        """A voltage in V with that of all integrals."""
        made, gains = self.made, self.gains
        now = multiples_of(self.now, made.multiples)
        acting = multiples_of(self.acting, made.multiples)
        alpha, beta, zero = v
        kp = _HALF * (gains["d"][0] + gains["q"][0])
        inductance = _HALF * (gains["l_d"] + gains["l_q"])
        for order in made.plane:
            share = harmonic_share(gains, order, self.omega_e)
            reactance = (np.float32(order) * self.omega_e) * inductance
            turns = signed_turn(now, order), signed_turn(acting, order)
            x, y = harmonic_gain(kp, gains["r_s"], reactance, *turns)
            r = state.harmonic[order]
            alpha = alpha + (share * ((r[0] * x) - (r[1] * y)))
            beta = beta + (share * ((r[0] * y) + (r[1] * x)))
        for order in made.zero:
            share = harmonic_share(gains, order, self.omega_e)
            reactance = (np.float32(order) * self.omega_e) * gains["l_0"]
            turns = now[order], acting[order]
            x, y = harmonic_gain(gains["zero"][0], gains["r_s"], reactance, *turns)
            r = state.harmonic_zero[order]
            zero = zero + (share * ((r[0] * x) - (r[1] * y)))
        return Stationary(alpha, beta, zero)

    def learn(self, state: Integrals, error: Stationary, learning: NDArray[np.bool_]) -> None:
        """The step of all integrals where they learn, for errors in A."""
        made, gains = self.made, self.gains
        size = (np.abs(error.alpha) + np.abs(error.beta)) + np.abs(error.zero)
        learning = learning & (size <= gains["harmonic_error_max"])
        now = multiples_of(self.now, made.multiples)
        for order in made.plane:
            cosine, sine = signed_turn(now, order)
            rate = gains["harmonic_rate"] * harmonic_share(gains, order, self.omega_e)
            r = state.harmonic[order]
            x = r[0] + (rate * ((error.alpha * cosine) + (error.beta * sine)))
            y = r[1] + (rate * ((error.beta * cosine) - (error.alpha * sine)))
            state.harmonic[order] = np.where(learning, x, r[0]), np.where(learning, y, r[1])
        for order in made.zero:
            cosine, sine = now[order]
            rate = gains["harmonic_rate"] * harmonic_share(gains, order, self.omega_e)
            r = state.harmonic_zero[order]
            x, y = r[0] + (rate * (error.zero * cosine)), r[1] - (rate * (error.zero * sine))
            state.harmonic_zero[order] = np.where(learning, x, r[0]), np.where(learning, y, r[1])
