"""What a simulated current regulator did: currents, commutations, errors,
distortion and the balance of power.

Averages are integrals by Gauss rules over the pieces between switching instants,
so that no sampling smears an edge.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.plants.fed_machine import I_0, I_D, I_Q, V_D, V_Q, Plant, evaluate
from dqforge.machines.records import dataclass

ComplexArray = NDArray[np.complex128]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


_PLACES, _SHARES = 0.5 + 0.5 * _NODES, 0.5 * _WEIGHTS


@dataclass(frozen=True, slots=True)
class PowerBalance:
    """Mean powers over the observed time in W, arrays of the shape (N,).

    ``dc_link`` is what the bridge takes, from leg states and phase currents; ``copper`` is R times
    the squared phase currents; ``shaft`` is torque times speed; ``stored`` is the rate at which the
    field between the magnets takes up energy, 0 in the steady state but for the ripple.
    """

    dc_link: FloatArray
    copper: FloatArray
    shaft: FloatArray
    stored: FloatArray


@dataclass(frozen=True, slots=True)
class SwitchingFrequency:
    """Switching frequencies in Hz, shape (N,): a commutation up and one down are one cycle.

    ``average`` is that of the three legs together, commutations over twice the observed time and 3
    legs; ``lowest`` and ``highest`` belong to the longest and the shortest time between two
    turn-ons of one leg, NaN with less than two.
    """

    average: FloatArray
    lowest: FloatArray
    highest: FloatArray


@dataclass(frozen=True, slots=True)
class CurrentTrace:
    """The observed time at N operating points, in S pieces without commutation inside.

    Args:
        plant: The drive at the N points.
        time, length: Start in s from the angle 0, and length in s, of each piece, shape (S, N).
            Some have the length 0.
        state: State at the start of each piece, shape (S, N, 9).
        legs: True where the upper switch is on, shape (S, N, 3).
    """

    plant: Plant
    time: FloatArray
    length: FloatArray
    state: FloatArray
    legs: BoolArray

    @property
    def duration(self) -> FloatArray:
        """Observed time in s, shape (N,): whole electrical periods."""
        return np.asarray(np.sum(self.length, axis=0))

    def _theta(self, time: FloatArray) -> FloatArray:
        return np.asarray(self.plant.omega_e * time)

    def _samples(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights (5, S, N), which sum to 1 over pieces and nodes, angles (5, S, N) and states (5,
        S, N, 9).
        """
        series = self.plant.series(self.state)
        times = _PLACES[:, None, None] * self.length
        states = np.stack([evaluate(series, time) for time in times])
        return (
            _SHARES[:, None, None] * self.length / self.duration,
            self._theta(self.time + times),
            states,
        )

    def phase_currents(self, point: int, time: ArrayLike) -> FloatArray:
        """Phase currents in A, shape (n, 3), of one point at times in s (n,)
        within the observed ones.
        """
        wanted = np.atleast_1d(np.asarray(time, dtype=np.float64))
        one = self.plant.part(slice(point, point + 1))
        piece = np.clip(np.searchsorted(self.time[:, point], wanted, side="right") - 1, 0, None)
        states = evaluate(
            one.series(self.state[piece, point][:, None]),
            (wanted - self.time[piece, point])[:, None],
        )
        return one.phase_currents(states[:, 0], one.omega_e * wanted)

    def references(self, point: int, time: ArrayLike) -> FloatArray:
        """References of the phase currents in A, shape (n, 3), of one point at times in s (n,)."""
        wanted = np.atleast_1d(np.asarray(time, dtype=np.float64))
        one = self.plant.part(slice(point, point + 1))
        return one.phase_currents(
            np.stack([[one.i_d, one.i_q, 0 * one.i_q]]).reshape(1, 3), one.omega_e * wanted
        )

    def samples_of(self, point: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights (5, S), which sum to 1, phase currents in A and their errors, both (5, S, 3), of
        one point at the nodes of all pieces.
        """
        one = self.plant.part(slice(point, point + 1))
        series = one.series(self.state[:, point, None])
        length = self.length[:, point]
        times = _PLACES[:, None] * length
        states = np.stack([evaluate(series, time[:, None])[:, 0] for time in times])
        theta = one.omega_e * (self.time[:, point] + times)
        weight = _SHARES[:, None] * length / np.sum(length)
        return weight, one.phase_currents(states, theta), one.phase_errors(states, theta)

    def rms_error(self) -> FloatArray:
        """Root mean square of the errors of the three phase currents in A, shape (N,)."""
        weight, theta, states = self._samples()
        square = np.mean(self.plant.phase_errors(states, theta) ** 2, axis=-1)
        return np.asarray(np.sqrt(np.sum(weight * square, axis=(0, 1))))

    def largest_error(self) -> FloatArray:
        """Largest error of a phase current in A, shape (N,), at the starts of the pieces,
        where the slopes change.
        """
        error = np.abs(self.plant.phase_errors(self.state, self._theta(self.time)))
        return np.asarray(np.max(error, axis=(0, 2)))

    def share_within(self, band: float) -> FloatArray:
        """Share of the time, mean of the three phases, that the error is at most `band` in A,
        shape (N,).
        """
        weight, theta, states = self._samples()
        inside = np.mean(np.abs(self.plant.phase_errors(states, theta)) <= band, axis=-1)
        return np.asarray(np.sum(weight * inside, axis=(0, 1)))

    def spectrum(self, orders: ArrayLike) -> ComplexArray:
        """Harmonics of the phase currents in A (peak), shape (H, N, 3); of the order 0 the mean.

        The phasor X of the order n stands for Re(X exp(j n theta_e)). Orders up to some 450.

        Args:
            orders: Orders n, shape (H,); fractions with the denominator of the observed periods
                show subharmonics.
        """
        order = np.atleast_1d(np.asarray(orders, dtype=np.float64))
        weight, theta, states = self._samples()
        current = self.plant.phase_currents(states, theta) * weight[..., None]
        found = np.empty((order.size, self.plant.i_d.size, 3), dtype=np.complex128)
        for k, n in enumerate(order):
            scale = 2.0 if n else 1.0
            found[k] = scale * np.sum(current * np.exp(-1j * n * theta)[..., None], axis=(0, 1))
        return found

    def current_thd(self) -> FloatArray:
        """Distortion of the phase currents, shape (N,): r.m.s. of all but the
        fundamental over the fundamental.

        All three phases together; no order is left out.
        """
        weight, theta, states = self._samples()
        square = np.sum(
            weight[..., None] * self.plant.phase_currents(states, theta) ** 2, axis=(0, 1)
        )
        fundamental = np.mean(np.abs(self.spectrum([1])[0]) ** 2, axis=-1) / 2.0
        rest = np.mean(square, axis=-1) - fundamental
        return np.asarray(np.sqrt(np.maximum(rest, 0.0) / fundamental))

    def instants(self, point: int, phase: int) -> tuple[FloatArray, BoolArray]:
        """Switching instants of a leg: times in s (E,), and whether the upper
        switch turns on there (E,).
        """
        leg = self.legs[:, point, phase]
        (changed,) = np.nonzero(leg[1:] != leg[:-1])
        return self.time[changed + 1, point], leg[changed + 1]

    def commutations(self) -> NDArray[np.int64]:
        """Number of commutations of each leg, shape (N, 3); of both switches of a leg together."""
        return np.asarray(np.sum(self.legs[1:] != self.legs[:-1], axis=0), dtype=np.int64)

    def switching_frequency(self) -> SwitchingFrequency:
        """Average and range of the switching frequency."""
        average = np.sum(self.commutations(), axis=-1) / (6.0 * self.duration)
        lowest, highest = np.full((2, average.size), math.nan)
        for point in range(average.size):
            turn_ons = [
                time[on] for time, on in (self.instants(point, phase) for phase in range(3))
            ]
            gaps = np.concatenate([np.diff(times) for times in turn_ons])
            if gaps.size:
                lowest[point], highest[point] = 1.0 / np.max(gaps), 1.0 / np.min(gaps)
        return SwitchingFrequency(average, lowest, highest)

    def _field_energy(self, state: FloatArray) -> FloatArray:
        machine, neutral = self.plant.drive.machine, self.plant.drive.neutral_inductance or 0.0
        square_d, square_q, square_0 = (state[..., k] ** 2 for k in (I_D, I_Q, I_0))
        return np.asarray(
            0.75 * (machine.l_d * square_d + machine.l_q * square_q) + 1.5 * neutral * square_0
        )

    def power_balance(self) -> PowerBalance:
        """Where the power from the DC link goes."""
        machine, v_dc = self.plant.drive.machine, self.plant.drive.v_dc
        weight, theta, states = self._samples()
        current = self.plant.phase_currents(states, theta)
        leg = v_dc * (self.legs - 0.5)
        shaft = (
            machine.torque(states[..., I_D], states[..., I_Q])
            * self.plant.omega_e
            / machine.pole_pairs
        )
        end = evaluate(self.plant.series(self.state[-1]), self.length[-1])
        stored = (self._field_energy(end) - self._field_energy(self.state[0])) / self.duration
        powers = (np.sum(leg * current, axis=-1), machine.r_s * np.sum(current**2, axis=-1), shaft)
        dc_link, copper, mechanical = (np.sum(weight * power, axis=(0, 1)) for power in powers)
        return PowerBalance(dc_link=dc_link, copper=copper, shaft=mechanical, stored=stored)

    def fundamental_voltage(self) -> ComplexArray:
        """Mean voltage vector v_d + j v_q in V (peak), shape (N,), in rotor coordinates."""
        weight, _, states = self._samples()
        return np.asarray(np.sum(weight * (states[..., V_D] + 1j * states[..., V_Q]), axis=(0, 1)))
