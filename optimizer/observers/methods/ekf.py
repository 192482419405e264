"""The extended Kalman filter over machine and rotor: tuning, gains and step."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.observers.method import ObserverMethod
from dqforge.optimizer.observers.methods.ekf_tuning import tuned_ekf, usual_noise
from dqforge.optimizer.observers.models.kalman_model import Ekf
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair
from dqforge.optimizer.observers.sampled_gains import (
    SampledGains,
    entries_and_slopes,
    limited,
    model_scale,
    next_currents,
    sampled_gains,
)
from dqforge.optimizer.observers.tuning_numbers import (
    USUAL_SHARE_OF_SPEED,
    USUAL_WIDTH,
    ObserverTuning,
)


def usual_ekf(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Nothing of it is used: the filter is tuned by its innovations."""
    return ObserverTuning(
        min(USUAL_WIDTH, 0.05 / t_s), min(USUAL_WIDTH, 0.05 / t_s), omega_floor=0.02 * omega_max
    )


@lru_cache(maxsize=16)
def _consistent(machine: LinearMachine, t_s: float, omega_max: float) -> EkfGains:
    noise = usual_noise(machine, 2.0 * omega_max * machine.psi_pm, t_s)
    i_ref = np.array([0.0, 0.5 * machine.i_max])
    return ekf_gains(
        tuned_ekf(machine, t_s, noise, USUAL_SHARE_OF_SPEED * omega_max, i_ref, omega_max=omega_max)
    )


def design_ekf(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> EkfGains:
    """Covariances of consistent innovations on simulated drives with the noise of
    `usual_noise` (`tuned_ekf`).

    The DC voltage, of which the noise of the voltage is a share, is taken as twice the
    back-EMF at ``omega_max``.
    """
    del tuning
    return _consistent(machine, t_s, omega_max)


_TURN = np.float32(6.2831855)


_I_SQUARE = np.float32(1e30)


_P_THETA = np.float32(10.0)

"""Largest variance of an angle in rad^2: one of which nothing is known has pi^2/3."""


@dataclass(frozen=True, slots=True)
class EkfGains:
    """Variances of `dqforge.optimizer.observers.models.kalman_model.Ekf` per sample, and the limit
    of the speed in rad/s.
    """

    model: SampledGains
    q_i: float
    q_22: float
    q_23: float
    q_33: float
    r: float
    p_omega: float
    p_theta: float
    omega_max: float


_UPPER = tuple((n, m) for n in range(4) for m in range(n, 4))

"""Places of the covariance that are kept: behind i_d and i_q the upper triangle, row by row."""


_ROWS, _COLUMNS = (np.array(places) for places in zip(*_UPPER, strict=True))


_FULL = np.array([[_UPPER.index((min(n, m), max(n, m))) for m in range(4)] for n in range(4)])
"""Where each entry of a covariance stands among those that are kept."""


_DIAGONAL = _FULL.diagonal()


_LOW_ROWS, _LOW_COLUMNS = [0, 0, 1], [0, 1, 1]
"""Places of the covariance of the currents alone."""


def ekf_gains(filter_: Ekf) -> EkfGains:
    """What the firmware needs of a filter."""
    q, p = filter_.q, filter_.p_0
    values = (
        filter_.q_i,
        q[2, 2],
        q[2, 3],
        q[3, 3],
        filter_.r,
        p[2, 2],
        p[3, 3],
        filter_.model.omega_max,
    )
    return EkfGains(sampled_gains(filter_.model), *(float(value) for value in values))


def ekf_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s.

    Its scalars are i_d and i_q in A and the upper triangle of the covariance of (i_d, i_q, omega,
    theta).
    """
    zero = np.zeros_like(theta_e)
    return ObserverState((), theta_e, omega_e, False, (zero,) * (2 + len(_UPPER)))


def ekf_sizes(scalars: FloatArray, _: FloatArray) -> FloatArray:
    """Noticeable changes of the scalars of M filters, shape (M, 12): a covariance
    counts by its two variances.
    """
    size = np.empty_like(scalars)
    norm = np.hypot(scalars[:, 0], scalars[:, 1])
    size[:, 0] = size[:, 1] = np.where(norm > 1e-6, norm, 1.0)
    root = np.sqrt(np.abs(scalars[:, 2 + _DIAGONAL]))
    for k, (n, m) in enumerate(_UPPER):
        size[:, 2 + k] = np.maximum(root[:, n] * root[:, m], 1e-30)
    return size


def _ekf_predicted(
    gains: EkfGains, state: ObserverState, v: Pair, maths: Arithmetic
) -> tuple[Pair, Reals, Reals]:
    """Currents, covariance of shape (4, 4, N) and angle, foretold."""
    model, i = gains.model, (state.scalars[0], state.scalars[1])
    p = np.array(state.scalars[2:])[_FULL]
    u = park(maths, v, maths.rotation(state.theta_e))
    x = limited(model.t_s * state.omega_e, model.x_max)
    e, slopes = entries_and_slopes(model, x)
    f = np.empty((2, *p.shape[1:]), dtype=p.dtype)
    f[0, 0], f[0, 1], f[1, 0], f[1, 1] = e[0], e[5], e[6], e[1]
    f[0, 2], f[1, 2] = next_currents(slopes, i, u)
    f[0, 3], f[1, 3] = e[2] * u[1] - e[7] * u[0], e[8] * u[1] - e[3] * u[0]
    a = np.empty_like(p)
    by = f[:, :, np.newaxis]
    a[:2] = ((by[:, 0] * p[0] + by[:, 1] * p[1]) + by[:, 2] * p[2]) + by[:, 3] * p[3]
    a[2] = p[2]
    a[3] = p[3] + model.t_s * p[2]
    new = np.empty_like(p)
    parts = a[_LOW_ROWS] * f[_LOW_COLUMNS]
    total = ((parts[:, 0] + parts[:, 1]) + parts[:, 2]) + parts[:, 3]
    new[0, 0], new[1, 1] = total[0] + gains.q_i, total[2] + gains.q_i
    new[0, 1] = new[1, 0] = total[1]
    new[:2, 2] = new[2, :2] = a[:2, 2]
    new[:2, 3] = new[3, :2] = a[:2, 3] + model.t_s * a[:2, 2]
    new[2, 2] = a[2, 2] + gains.q_22
    new[2, 3] = new[3, 2] = (a[2, 3] + model.t_s * a[2, 2]) + gains.q_23
    new[3, 3] = (a[3, 3] + model.t_s * a[3, 2]) + gains.q_33
    return next_currents(e, i, u), new, maths.wrap(state.theta_e + model.t_s * state.omega_e)


def _ekf_begun(
    gains: EkfGains, theta: Reals, omega: Reals, i: Pair, maths: Arithmetic
) -> ObserverState:
    """The measured current at a given angle and speed, with the covariance of the start."""
    first = park(maths, i, maths.rotation(theta))
    zero = np.zeros_like(theta)
    diagonal = [zero + value for value in (gains.r, gains.r, gains.p_omega, gains.p_theta)]
    rows = tuple(diagonal[n] if n == m else zero for n, m in _UPPER)
    return ObserverState((), theta, omega, True, (*first, *rows))


def _ekf_sound(gains: EkfGains, i: Pair, speed: Reals, p: Reals, det: Reals, turn: Reals) -> Any:
    """Whether all is within the range of a filter that works, shape (N,): false for not-a-number.

    ``p`` are the variances, shape (4, N), ``det`` is the determinant of the innovation's
    covariance, ``turn`` the correction of the angle in rad.
    """
    good = (det > 0.0) & (turn >= -_TURN) & (turn <= _TURN)
    good &= (speed >= -gains.omega_max) & (speed <= gains.omega_max)
    good &= (i[0] * i[0] + i[1] * i[1]) < _I_SQUARE
    good &= np.all(p > 0.0, axis=0)
    return good & (p[2] <= gains.omega_max * gains.omega_max + gains.p_omega) & (p[3] <= _P_THETA)


def ekf_step(
    gains: EkfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).

    A sample after which a number is out of range (`_ekf_sound`) begins anew with its current, the
    covariance of the start, the angle that was foretold and the speed before.
    """
    if not state.started:
        return _ekf_begun(gains, state.theta_e, state.omega_e, i, maths)
    (i_d, i_q), p, theta = _ekf_predicted(gains, state, v, maths)
    seen = park(maths, i, maths.rotation(theta))
    nu_d, nu_q = seen[0] - i_d, seen[1] - i_q
    b = np.array([-i_q, i_d])
    h = p[:, :2] + b * p[:, 3:]
    s_dd = (h[0, 0] + b[0] * h[3, 0]) + gains.r
    s_dq = h[0, 1] + b[0] * h[3, 1]
    s_qq = (h[1, 1] + b[1] * h[3, 1]) + gains.r
    det = s_dd * s_qq - s_dq * s_dq
    inverse = 1.0 / det
    k = (h * np.array([s_qq, s_dd]) - h[:, ::-1] * s_dq) * inverse
    x = k[:, 0] * nu_d + k[:, 1] * nu_q
    taken = k[_ROWS] * h[_COLUMNS]
    upper = p[_ROWS, _COLUMNS] - (taken[:, 0] + taken[:, 1])
    speed, current = limited(state.omega_e + x[2], gains.omega_max), (i_d + x[0], i_q + x[1])
    sound = _ekf_sound(gains, current, speed, upper[_DIAGONAL], det, x[3])
    values = (maths.wrap(theta + x[3]), speed, *current, *upper)
    if not np.all(sound):
        anew = _ekf_begun(gains, theta, state.omega_e, i, maths)
        parts = zip(values, (anew.theta_e, anew.omega_e, *anew.scalars), strict=True)
        values = tuple(np.where(sound, own, other) for own, other in parts)
    return ObserverState((), values[0], values[1], True, values[2:])


def ekf_in_words(_tuning: ObserverTuning, gains: EkfGains, t_s: float) -> str:
    """What the innovations have tuned.

    Parameters
    ----------
    gains:
        Of `design_ekf`.
    t_s:
        Sampling period in s.
    """
    return (
        f"tuned by its innovations: variance of the currents {gains.q_i:.3g} A^2 per sample, "
        f"of what is measured {gains.r:.3g} A^2, density of the acceleration "
        f"{gains.q_22 / t_s:.3g} rad^2/s^3"
    )


METHOD = ObserverMethod(
    name="ekf",
    code="ekf",
    title="extended Kalman filter",
    design=design_ekf,
    start=ekf_start,
    step=ekf_step,
    usual=usual_ekf,
    searched=(),
    gains=EkfGains,
    scale=model_scale,
    in_words=ekf_in_words,
    settle=300,
    sizes=ekf_sizes,
)
