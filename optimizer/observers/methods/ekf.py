"""The extended Kalman filter over machine and rotor: tuning, gains and step."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.ekf_tuning import tuned_ekf, usual_noise
from dqforge.optimizer.observers.models.kalman_model import Ekf
from dqforge.optimizer.observers.parts import (
    USUAL_SHARE_OF_SPEED,
    USUAL_WIDTH,
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
)
from dqforge.optimizer.observers.sampled_machine import (
    SampledGains,
    entries_and_slopes,
    model_scale,
    next_currents,
    sampled_gains,
)
from dqforge.optimizer.step_arithmetic import Arithmetic, Dq, Member, Pair, limited


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

# Largest variance of an angle in rad^2: one of which nothing is known has pi^2/3.
_P_THETA = np.float32(10.0)


@dataclass(frozen=True, slots=True)
class EkfGains:
    """The sampled machine, variances per sample and at the start, and the limit of the speed."""

    model: SampledGains
    q_i: Annotated[float, Member("process variance of a current per sample", "A^2")]
    q_22: Annotated[float, Member("of the speed", "rad^2/s^2")]
    q_23: Annotated[float, Member("of speed and angle", "rad^2/s")]
    q_33: Annotated[float, Member("of the angle", "rad^2")]
    r: Annotated[float, Member("variance of a measured current", "A^2")]
    p_omega: Annotated[float, Member("variance of the first speed", "rad^2/s^2")]
    p_theta: Annotated[float, Member("variance of the first angle", "rad^2")]
    omega_max: Annotated[float, Member("limit of the speed", "rad/s")]


# Places of the covariance that are kept: behind i_d and i_q the upper triangle, row by row.
_UPPER = tuple((n, m) for n in range(4) for m in range(n, 4))

# The scalars of the state: currents, and the covariance in the order of `_UPPER`.
_MEMBERS = (
    ("i_d", Member("estimated current, d", "A")),
    ("i_q", Member("... and q", "A")),
    ("p_dd", Member("variance of i_d", "A^2")),
    ("p_dq", Member("covariance of i_d and i_q", "A^2")),
    ("p_d_omega", Member("... of i_d and speed", "A rad/s")),
    ("p_d_theta", Member("... of i_d and angle", "A rad")),
    ("p_qq", Member("variance of i_q", "A^2")),
    ("p_q_omega", Member("covariance of i_q and speed", "A rad/s")),
    ("p_q_theta", Member("... of i_q and angle", "A rad")),
    ("p_omega", Member("variance of the speed", "rad^2/s^2")),
    ("p_omega_theta", Member("covariance of speed and angle", "rad^2/s")),
    ("p_theta", Member("variance of the angle", "rad^2")),
)

_ROWS, _COLUMNS = (np.array(places) for places in zip(*_UPPER, strict=True))

# Where each entry of a covariance stands among those that are kept.
_FULL = np.array([[_UPPER.index((min(n, m), max(n, m))) for m in range(4)] for n in range(4)])
_DIAGONAL = _FULL.diagonal()
_LOW_ROWS, _LOW_COLUMNS = [0, 0, 1], [0, 1, 1]  # Places of the covariance of the currents alone.


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
) -> tuple[Dq, Reals, Reals]:
    """Currents, covariance of shape (4, 4, N) and angle, foretold."""
    o, model, i = maths, gains.model, (state.scalars[0], state.scalars[1])
    p = np.array(state.scalars[2:])[_FULL]
    u = o.let("u", o.park(v, o.rotation(state.theta_e)), "voltage in the rotor's frame, V")
    advance = o.let("advance", model.t_s * state.omega_e, "angle of the period, rad")
    x = o.let("x", limited(o, advance, model.x_max))
    o.remark("The sampled machine and its derivatives by the speed.")
    e, slopes = entries_and_slopes(o, model, x)
    f = np.empty((2, *p.shape[1:]), dtype=p.dtype)
    f[0, 0], f[0, 1], f[1, 0], f[1, 1] = e[0], e[5], e[6], e[1]
    f[0, 2], f[1, 2] = next_currents(slopes, i, u)
    f[0, 3], f[1, 3] = e[2] * u[1] - e[7] * u[0], e[8] * u[1] - e[3] * u[0]
    f = o.let("f", f)
    o.remark("Covariance one period on: f p f' + q.")
    by = f[:, :, np.newaxis]
    a = ((by[:, 0] * p[0] + by[:, 1] * p[1]) + by[:, 2] * p[2]) + by[:, 3] * p[3]
    a = o.let("a", a)
    last = o.let("last", p[3, 2:] + model.t_s * p[2, 2:])
    new = np.empty_like(p)
    parts = a[_LOW_ROWS] * f[_LOW_COLUMNS]
    total = ((parts[:, 0] + parts[:, 1]) + parts[:, 2]) + parts[:, 3]
    new[0, 0], new[1, 1] = total[0] + gains.q_i, total[2] + gains.q_i
    new[0, 1] = new[1, 0] = total[1]
    new[:2, 2] = new[2, :2] = a[:, 2]
    new[:2, 3] = new[3, :2] = a[:, 3] + model.t_s * a[:, 2]
    new[2, 2] = p[2, 2] + gains.q_22
    new[2, 3] = new[3, 2] = (p[2, 3] + model.t_s * p[2, 2]) + gains.q_23
    new[3, 3] = (last[1] + model.t_s * last[0]) + gains.q_33
    current = o.let("current", next_currents(e, i, u), "foretold, A")
    theta = o.let("theta", o.wrap(state.theta_e + advance), "foretold angle, rad")
    return current, o.let("p", new), theta


def _ekf_begun(
    gains: EkfGains, theta: Reals, omega: Reals, i: Pair, o: Arithmetic
) -> ObserverState:
    """The measured current at a given angle and speed, with the covariance of the start."""
    first = o.let("first", o.park(i, o.rotation(theta)), "measured current, A")
    zero = o.full(0.0, theta)
    values = (gains.r, gains.r, gains.p_omega, gains.p_theta)
    rows = tuple(o.full(values[n], theta) if n == m else zero for n, m in _UPPER)
    return ObserverState((), theta, omega, True, (*first, *rows))


def _ekf_sound(gains: EkfGains, i: Pair, speed: Reals, p: Reals, det: Reals, turn: Reals) -> Any:
    """Whether all is within the range of a filter that works, shape (N,): false for not-a-number.

    ``p`` are the variances, shape (4, N), ``det`` is the determinant of the innovation's
    covariance, ``turn`` the correction of the angle in rad.
    """
    good = (det > 0.0) & (turn >= -_TURN) & (turn <= _TURN)
    good &= (speed >= -gains.omega_max) & (speed <= gains.omega_max)
    good &= (i[0] * i[0] + i[1] * i[1]) < _I_SQUARE
    for variance in p:
        good &= variance > 0.0
    return good & (p[2] <= gains.omega_max * gains.omega_max + gains.p_omega) & (p[3] <= _P_THETA)


def ekf_step(
    gains: EkfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha,
    beta).

    A sample after which a number is out of range (`_ekf_sound`) begins anew with its current, the
    covariance of the start, the angle that was foretold and the speed before.
    """
    o = maths
    if not state.started:
        return _ekf_begun(gains, state.theta_e, state.omega_e, i, o)
    foretold, p, theta = _ekf_predicted(gains, state, v, o)
    seen = o.let("seen", o.park(i, o.rotation(theta)), "measured current, A")
    nu = o.let("nu", Dq(seen.d - foretold.d, seen.q - foretold.q), "innovation, A")
    o.remark("Covariance of the innovation, and the gain.")
    b = o.let("b", np.array([-foretold.q, foretold.d]))
    h = o.let("h", p[:, :2] + b * p[:, 3:])
    s_dd = o.let("s_dd", (h[0, 0] + b[0] * h[3, 0]) + gains.r)
    s_dq = o.let("s_dq", h[0, 1] + b[0] * h[3, 1])
    s_qq = o.let("s_qq", (h[1, 1] + b[1] * h[3, 1]) + gains.r)
    det = o.let("det", s_dd * s_qq - s_dq * s_dq)
    inverse = o.let("inverse", 1.0 / det)
    k = o.let("k", (h * np.array([s_qq, s_dd]) - h[:, ::-1] * s_dq) * inverse)
    shift = o.let("shift", k[:, 0] * nu.d + k[:, 1] * nu.q)
    taken = k[_ROWS] * h[_COLUMNS]
    upper = o.let("after", p[_ROWS, _COLUMNS] - (taken[:, 0] + taken[:, 1]))
    reached = o.let("reached", state.omega_e + shift[2])
    speed = o.let("speed", limited(o, reached, gains.omega_max), "rad/s")
    current = o.let("corrected", Dq(foretold.d + shift[0], foretold.q + shift[1]), "current, A")
    sound = _ekf_sound(gains, current, speed, upper[_DIAGONAL], det, shift[3])
    return o.either(
        sound,
        lambda: ObserverState((), o.wrap(theta + shift[3]), speed, True, (*current, *upper)),
        lambda: _ekf_begun(gains, theta, state.omega_e, i, o),
    )


def ekf_in_words(_tuning: ObserverTuning, gains: EkfGains, t_s: float) -> str:
    """What the innovations have tuned.

    Args:
        gains: Of `design_ekf`.
        t_s: Sampling period in s.
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
    members=StateMembers((), _MEMBERS),
)
