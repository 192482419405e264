"""Current references over torque, voltage and speed: the resistance drop taken off,
the torque held to what is left.

|v|^2 = R^2 |i|^2 + 2 R omega tau + omega^2 |psi|^2 with tau = T/(3/2 p), omega counted along the
torque. So the flux linkage a that is available follows from the torque and the magnitude of the
current alone: in closed form but for that magnitude, for which a bound stands first and then the
current that the bound gives. The currents over torque and a are those of
`dqforge.optimizer.field_weakening.form`. The evaluator is the list of float32 operations of the
header.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import (
    MultiplyAdd,
    SingleArray,
    fused_multiply_add,
    multiply_add,
)
from dqforge.optimizer.field_weakening.form import WeakeningReference

# Trials of the torque at most: what cannot be had is halved down to 2^-12 of what was asked for.
STEPS = 14

# Code and literals beside those of the surface: always, for a second look at the current, for a
# bound of the current that falls with the flux linkage. Above what gcc 12 makes for a Cortex-M4F
# with -O2.
_BYTES = 115, 255, 215
_ZERO, _HALF = np.float32(0.0), np.float32(0.5)


@dataclass(frozen=True, slots=True)
class DropReference:
    """i_d and i_q in A over torque in N m, largest phase-voltage amplitude in V and
    electrical speed in rad/s.

    Args:
        surface: Currents over torque and available flux linkage.
        torque_max: Largest torque in N m.
        per_torque: 2 R/(3/2 p) in Ohm, so that 2 R omega tau is this times speed and torque.
        square: R^2 in Ohm^2.
        reserve: R^2 I^2 in V^2 with the current limit I, not below it.
        near: (c, e) in V^2 and Ohm^2 A^2/Wb^2: at the largest torque of an available flux linkage
            a, where MTPV holds it, R^2 |i|^2 is at most c + e a^2; None where that does not matter.
        passes: Evaluations of the surface: 1, or 2 where the current of the first one tells the
            drop of the second.
    """

    surface: WeakeningReference
    torque_max: np.float32
    per_torque: np.float32
    square: np.float32
    reserve: np.float32
    near: tuple[np.float32, np.float32] | None
    passes: int

    @property
    def coefficients(self) -> int:
        """Number of constants that the emitted C spells out."""
        return self.surface.coefficients + 4 + (0 if self.near is None else 2)

    @property
    def flash(self) -> int:
        """Estimate of the bytes of code and constants on a Cortex-M4F, without fused
        multiply-add.
        """
        fixed, again, line = _BYTES
        return (
            self.surface.flash + fixed + again * (self.passes > 1) + line * (self.near is not None)
        )

    def available(self, squared: SingleArray, omega: SingleArray) -> SingleArray:
        """Flux linkage in Wb for a squared voltage in V^2 at a speed, up to the
        largest one that is of use.
        """
        high = self.surface.flux_max
        top = omega * high
        some = (squared > _ZERO) & ~(squared >= top * top)
        flux = np.sqrt(np.where(some, squared, _ZERO)) / np.where(some, omega, np.float32(1.0))
        flux = np.where(some, np.where(flux < high, flux, high), _ZERO)
        return np.asarray(np.where(squared >= top * top, high, flux))

    def _first(self, left: SingleArray, omega: SingleArray, muladd: MultiplyAdd) -> SingleArray:
        """Flux linkage that suffices whatever the current: bounds of the current stand for it."""
        flux = self.available(left - self.reserve, omega)
        if self.near is None:
            return flux
        constant, slope = self.near
        rest = left - constant
        some = rest > _ZERO
        found = np.sqrt(np.where(some, rest, _ZERO) / muladd(omega, omega, np.asarray(slope)))
        found = np.where(found < self.surface.flux_max, found, self.surface.flux_max)
        return np.asarray(np.where(some & (found > flux), found, flux))

    def granted(
        self, torque: SingleArray, v_max: SingleArray, omega_e: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, ...]:
        """Magnitude of the torque within reach in N m, flux linkage in Wb, and squared
        voltage in V^2, shape (N,).

        The squared voltage is what R^2 |i|^2 and omega^2 |psi|^2 may take together. NaN as a torque
        counts as none; NaN as voltage or speed as no voltage, which gives no torque at the least
        flux linkage.
        """
        muladd = fused_multiply_add if fused else multiply_add
        torque, v_max, omega_e = (
            np.asarray(part, dtype=np.float32) for part in (torque, v_max, omega_e)
        )
        with np.errstate(invalid="ignore", under="ignore", over="ignore", divide="ignore"):
            omega = np.where(omega_e < _ZERO, -omega_e, omega_e)
            volts = np.where(v_max > _ZERO, v_max, _ZERO)
            room, per = volts * volts, self.per_torque * omega
            per = np.where((torque < _ZERO) != (omega_e < _ZERO), -per, per)
            asked = np.where(torque < _ZERO, -torque, torque)
            asked = np.where(asked > _ZERO, asked, _ZERO)
            asked = np.where(asked < self.torque_max, asked, self.torque_max)
            low, a, high, trial = (
                np.zeros_like(asked),
                np.zeros_like(asked),
                asked.copy(),
                asked.copy(),
            )
            open_ones = np.ones(asked.shape, dtype=np.bool_)
            for step in range(STEPS):
                if step == STEPS - 1:  # no torque at all, where none of the others could be had
                    trial = np.where(open_ones & ~(low > _ZERO), _ZERO, trial)
                flux = self._first(muladd(-per, trial, room), omega, muladd)
                above = flux >= self.surface.flux_min
                limit = self.surface.limit.evaluate(
                    np.where(above, flux - self.surface.flux_min, _ZERO), muladd
                )
                fits = above & (trial <= limit) & open_ones
                low, a = np.where(fits, trial, low), np.where(fits, flux, a)
                high = np.where(fits, high, trial)
                open_ones &= ~(fits & ~(trial < asked))
                trial = np.where(open_ones, _HALF * (low + high), trial)
            a = np.where(a > _ZERO, a, self.surface.flux_min)
            return low, a, muladd(-per, low, room), omega

    def currents(
        self, torque: SingleArray, v_max: SingleArray, omega_e: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A as the emitted C returns them, bit for bit, for any float32 inputs,
        shape (N,).
        """
        muladd = fused_multiply_add if fused else multiply_add
        t, a, left, omega = self.granted(torque, v_max, omega_e, fused=fused)
        surface = self.surface
        with np.errstate(invalid="ignore", under="ignore", over="ignore", divide="ignore"):
            base_d, base_q = surface.d.evaluate(t, muladd), surface.q.evaluate(t, muladd)
            taken = surface.flux.evaluate(t, muladd)
            weakens = taken > a
            i_d, i_q = base_d, base_q
            for _ in range(self.passes):
                delta = np.where(taken > a, taken - a, _ZERO)
                weak_d, weak_q = surface.weakened(t, delta, (base_d, base_q), muladd)
                i_d, i_q = np.where(weakens, weak_d, base_d), np.where(weakens, weak_q, base_q)
                used = muladd(i_d, i_d, i_q * i_q)
                more = self.available(muladd(-used, np.asarray(self.square), left), omega)
                a = np.where(more > a, more, a)
            return i_d, np.where(np.asarray(torque, dtype=np.float32) < _ZERO, -i_q, i_q)
