"""The flux observer with a correction behind it.

    theta^ = theta_f + kappa,   kappa += share (y - kappa)

theta_f is the angle of the flux observer and its phase-locked loop, which run as they do without a
correction; y is what was learned, within the limit, and nought where an input lies outside its
trained range. The correction never enters the loop: it is added to the angle that is handed out
and taken from it before the next step. Beside kappa the state keeps the share of samples at which
the correction acted, by the same filter, and why it did not at the last one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.learned_correction.correction_frame import (
    Inputs,
    brought,
    outside,
    speed_inputs,
)
from dqforge.optimizer.observers.methods import flux
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair

# (gains, inputs of -1 to 1, arithmetic) -> correction in rad, within the limit.
Learned = Callable[[Any, Inputs, Arithmetic], Reals]


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    return ObserverState(
        ((zero, zero), (zero, zero)), theta_e, omega_e, False, scalars=(zero, zero, zero)
    )


def seen(gains: Any, state: ObserverState, maths: Arithmetic) -> Inputs:
    """The six inputs after a step of the flux observer, of -1 to 1 where they were trained."""
    own, frame = gains.flux, gains.frame
    turn = maths.rotation(state.theta_e)
    psi, i = (park(maths, vector, turn) for vector in state.vectors)
    back = state.omega_e < 0.0
    residual_q, i_q = psi[1] - own.l_q * i[1], i[1]
    u, v = speed_inputs(frame, np.where(back, -state.omega_e, state.omega_e), maths)
    raw = (
        psi[0] - (own.l_d * i[0] + own.psi_pm),
        v,
        i[0],
        np.where(back, -i_q, i_q),
        u,
        np.where(back, -residual_q, residual_q),
    )
    return brought(frame, raw)


def limited(y: Reals, limit: Any) -> Reals:
    """A correction within -limit to limit."""
    y = np.where(y < limit, y, limit)
    return np.where(y > -limit, y, -limit)


def step(
    learned: Learned, gains: Any, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).
    """
    kappa, hits, _ = state.scalars
    core = ObserverState(
        state.vectors, maths.wrap(state.theta_e - kappa), state.omega_e, state.started
    )
    after = flux.step(gains.flux, core, v, i, maths)
    if not state.started:
        return ObserverState(after.vectors, state.theta_e, after.omega_e, scalars=state.scalars)
    x = seen(gains, after, maths)
    why = outside(x)
    acts = why == maths.number(0.0)
    y = limited(learned(gains, x, maths), gains.frame.limit)
    y = np.where(after.omega_e < 0.0, -y, y)
    y = np.where(acts, y, maths.number(0.0))
    hit = np.where(acts, maths.number(1.0), maths.number(0.0))
    kappa = kappa + gains.frame.share * (y - kappa)
    hits = hits + gains.frame.share * (hit - hits)
    return ObserverState(
        after.vectors,
        maths.wrap(after.theta_e + kappa),
        after.omega_e,
        scalars=(kappa, hits, why),
    )


def sizes(scalars: FloatArray, _omega: FloatArray) -> FloatArray:
    """A hundredth of a radian, and one, see `ObserverMethod`.

    Args:
        scalars: Of M states, shape (M, 3).
    """
    return np.broadcast_to(np.array([0.01, 1.0, 1.0]), scalars.shape).copy()


def scale(gains: Any) -> tuple[float, float]:
    """Sampling period in s and magnet flux linkage in Wb.

    Args:
        gains: With a member ``flux``.
    """
    return float(gains.flux.path.t_s), float(gains.flux.psi_pm)
