"""The circle of Holtz and Stadtfeld, acting at the very instant at which the error reaches it.

The error i* - i moves within a circle of the radius h around the reference. Where it arrives at the
circle, the time until it would arrive again is predicted for each switching state, along a straight
line in rotor coordinates; the state with the longest time per commutation is taken. While the
voltage that the references need lies inside the hexagon of the bridge, the active vectors surround
it, and at least one of them leads back into the circle from any place on it.

Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.4 and figure 6.15; J. Holtz, S.
Stadtfeld, IPEC Tokyo 1983, pp. 1665-1675. The thesis takes "the state that stays on longest"; over
commutations, as in the source, the switching frequency is less.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.plants.current_regulators.state_table import COMMUTATIONS, LEGS, codes_of
from dqforge.machines.plants.fed_machine import I_D, I_Q, Plant

_BLIND = 0.5  # Share of the predicted time before which the error is within the circle for certain.


def times_within(
    plant: Plant, state: FloatArray, time: FloatArray, codes: NDArray[np.int64]
) -> FloatArray:
    """Predicted times in s (..., N) until the error of states (N, 9) on the circle is on it again.

    Zero where a switching state leads out. ``codes`` (..., N) are the states that are tried.
    """
    legs = LEGS[codes]
    wide = np.broadcast_to(state, (*codes.shape, state.shape[-1]))
    theta = np.broadcast_to(plant.omega_e * time, codes.shape)
    slope = np.matmul(plant.matrix, plant.switched(wide, theta, legs)[..., None])[..., 0]
    x, y = plant.i_d - state[:, I_D], plant.i_q - state[:, I_Q]
    along = -(x * slope[..., I_D] + y * slope[..., I_Q])
    square = slope[..., I_D] ** 2 + slope[..., I_Q] ** 2
    return np.where(along < 0.0, -2.0 * along / np.where(square > 0.0, square, 1.0), 0.0)


class CircleController:
    """Controller of `follow` that acts at the circle itself.

    Args:
        radius: h in A.
        points: N operating points.
        per_commutation: Whether the time is weighed by the commutations that it costs.
    """

    def __init__(self, radius: float, points: int, *, per_commutation: bool = True) -> None:
        self.interval, self.scale = math.inf, radius
        self._radius, self._weighed = radius, per_commutation
        self._blind_until = np.zeros(points)

    def margin(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        """How far the error is outside, for each leg alike."""
        error = np.hypot(plant.i_d - state[:, I_D], plant.i_q - state[:, I_Q]) - self._radius
        early = time < self._blind_until[plant.number]
        return np.repeat(np.where(early, -self._radius, error)[:, None], legs.shape[-1], axis=-1)

    def decide(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        """Nothing is sampled."""
        return legs

    def react(
        self,
        plant: Plant,
        state: FloatArray,
        time: FloatArray,
        legs: BoolArray,
        _wanted: NDArray[np.intp],
    ) -> BoolArray:
        """The state with the longest predicted time within the circle per commutation."""
        codes = codes_of(legs)
        tried = np.broadcast_to(np.arange(8)[:, None], (8, codes.size))
        within = times_within(plant, state, time, tried)
        moves = np.maximum(COMMUTATIONS[codes, tried], 1)
        score = np.where(tried == codes, 0.0, within / (moves if self._weighed else 1))
        # Of both zero vectors, alike but for rounding, the nearer one.
        score = score * (1.0 - 1e-9 * moves)
        chosen = np.argmax(score, axis=0)
        self._blind_until[plant.number] = time + _BLIND * within[chosen, np.arange(codes.size)]
        return np.asarray(LEGS[chosen])
