"""Kalman filter and Matsui's estimators as the firmware runs them: written once, in the order of operations of the C.

They run on numpy arrays of shape (N,), in double precision for comparison with `dqforge.optimizer.ekf` and
`dqforge.optimizer.matsui`, and in single precision as the model of the emitted C (`observer_ekf.j2`,
`observer_matsui_voltage.j2`, `observer_matsui_current.j2`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.ekf import Ekf
from dqforge.optimizer.matsui import Matsui
from dqforge.optimizer.observer_parts import Arithmetic, ObserverState, Pair, Reals, park
from dqforge.optimizer.sampled_machine import SampledMachine

EVEN = 5
_TURN = np.float32(6.2831855)
_I_SQUARE = np.float32(1e30)
_P_THETA = np.float32(10.0)
"""Largest variance of an angle in rad^2: one of which nothing is known has pi^2/3."""
_ORDER = (0, 3, 4, 7, 8, 1, 2, 5, 6, 9)
"""Rows of `SampledMachine.table` in the order of the C: the even ones first."""


@dataclass(frozen=True, slots=True)
class SampledGains:
    """`SampledMachine` for the firmware: ``t_s`` in s, ``x_max`` in rad, forty coefficients, four per entry."""

    t_s: float
    x_max: float
    table: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse another number of coefficients."""
        if len(self.table) != 8 * EVEN:
            raise ValueError


def sampled_gains(model: SampledMachine) -> SampledGains:
    """What the firmware needs of a sampled machine."""
    table = model.table[list(_ORDER)].ravel()
    return SampledGains(model.t_s, model.omega_max * model.t_s, tuple(float(value) for value in table))


def limited(value: Reals, limit: Any) -> Reals:
    """A value within -limit to limit."""
    return np.where(value > limit, limit, np.where(value < -limit, -limit, value))


def _entries(model: SampledGains, x: Reals) -> list[Reals]:
    s = x * x
    found = []
    for n in range(2 * EVEN):
        c = model.table[4 * n : 4 * n + 4]
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        found.append(value if n < EVEN else x * value)
    return found


def _slopes(model: SampledGains, x: Reals) -> list[Reals]:
    s = x * x
    found = []
    for n in range(2 * EVEN):
        c = model.table[4 * n : 4 * n + 4]
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        rate = ((3.0 * c[3]) * s + 2.0 * c[2]) * s + c[1]
        found.append(model.t_s * ((2.0 * x) * rate if n < EVEN else value + (2.0 * s) * rate))
    return found


def _next(e: list[Reals], i: Pair, v: Pair) -> Pair:
    return (
        (((e[0] * i[0] + e[5] * i[1]) + e[2] * v[0]) + e[7] * v[1]) + e[4],
        (((e[6] * i[0] + e[1] * i[1]) + e[8] * v[0]) + e[3] * v[1]) + e[9],
    )


@dataclass(frozen=True, slots=True)
class EkfGains:
    """Variances of `dqforge.optimizer.ekf.Ekf` per sample, and the limit of the speed in rad/s."""

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


def _full(upper: tuple[Reals, ...]) -> list[list[Reals]]:
    rows = [[upper[0]] * 4 for _ in range(4)]
    for (n, m), value in zip(_UPPER, upper, strict=True):
        rows[n][m] = rows[m][n] = value
    return rows


def ekf_gains(filter_: Ekf) -> EkfGains:
    """What the firmware needs of a filter."""
    q, p = filter_.q, filter_.p_0
    values = (filter_.q_i, q[2, 2], q[2, 3], q[3, 3], filter_.r, p[2, 2], p[3, 3], filter_.model.omega_max)
    return EkfGains(sampled_gains(filter_.model), *(float(value) for value in values))


def ekf_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s.

    Its scalars are i_d and i_q in A and the upper triangle of the covariance of (i_d, i_q, omega, theta).
    """
    zero = np.zeros_like(theta_e)
    return ObserverState((), theta_e, omega_e, False, (zero,) * (2 + len(_UPPER)))


def ekf_sizes(scalars: FloatArray, _: FloatArray) -> FloatArray:
    """Noticeable changes of the scalars of M filters, shape (M, 12): a covariance counts by its two variances."""
    size = np.empty_like(scalars)
    norm = np.hypot(scalars[:, 0], scalars[:, 1])
    size[:, 0] = size[:, 1] = np.where(norm > 1e-6, norm, 1.0)
    root = np.sqrt(np.abs(scalars[:, [2 + _UPPER.index((n, n)) for n in range(4)]]))
    for k, (n, m) in enumerate(_UPPER):
        size[:, 2 + k] = np.maximum(root[:, n] * root[:, m], 1e-30)
    return size


def _ekf_predicted(
    gains: EkfGains, state: ObserverState, v: Pair, maths: Arithmetic
) -> tuple[Pair, list[list[Reals]], Reals]:
    model, p, i = gains.model, _full(state.scalars[2:]), (state.scalars[0], state.scalars[1])
    u = park(v, maths.rotation(state.theta_e))
    x = limited(model.t_s * state.omega_e, model.x_max)
    e = _entries(model, x)
    slope = _next(_slopes(model, x), i, u)
    f = (
        (e[0], e[5], slope[0], e[2] * u[1] - e[7] * u[0]),
        (e[6], e[1], slope[1], e[8] * u[1] - e[3] * u[0]),
    )
    a = [
        [((f[n][0] * p[0][m] + f[n][1] * p[1][m]) + f[n][2] * p[2][m]) + f[n][3] * p[3][m] for m in range(4)]
        for n in (0, 1)
    ]
    a.append([p[2][m] for m in range(4)])
    a.append([p[3][m] + model.t_s * p[2][m] for m in range(4)])
    zero = np.zeros_like(x)
    new = [[zero] * 4 for _ in range(4)]
    for n in range(2):
        for m in range(n + 1):
            total = ((a[m][0] * f[n][0] + a[m][1] * f[n][1]) + a[m][2] * f[n][2]) + a[m][3] * f[n][3]
            new[m][n] = new[n][m] = total + gains.q_i if m == n else total
    for m in range(2):
        new[m][2] = new[2][m] = a[m][2]
        new[m][3] = new[3][m] = a[m][3] + model.t_s * a[m][2]
    new[2][2] = a[2][2] + gains.q_22
    new[2][3] = new[3][2] = (a[2][3] + model.t_s * a[2][2]) + gains.q_23
    new[3][3] = (a[3][3] + model.t_s * a[3][2]) + gains.q_33
    return _next(e, i, u), new, maths.wrap(state.theta_e + model.t_s * state.omega_e)


def _ekf_begun(gains: EkfGains, theta: Reals, omega: Reals, i: Pair, maths: Arithmetic) -> ObserverState:
    """The measured current at a given angle and speed, with the covariance of the start."""
    first = park(i, maths.rotation(theta))
    zero = np.zeros_like(theta)
    diagonal = [zero + value for value in (gains.r, gains.r, gains.p_omega, gains.p_theta)]
    rows = tuple(diagonal[n] if n == m else zero for n, m in _UPPER)
    return ObserverState((), theta, omega, True, (*first, *rows))


def _ekf_sound(gains: EkfGains, i: Pair, speed: Reals, p: list[list[Reals]], det: Reals, turn: Reals) -> Any:
    """Whether all is within the range of a filter that works, shape (N,): false for not-a-number.

    ``det`` is the determinant of the innovation's covariance, ``turn`` the correction of the angle in rad.
    """
    good = (det > 0.0) & (turn >= -_TURN) & (turn <= _TURN)
    good &= (speed >= -gains.omega_max) & (speed <= gains.omega_max)
    good &= (i[0] * i[0] + i[1] * i[1]) < _I_SQUARE
    good &= (p[0][0] > 0.0) & (p[1][1] > 0.0) & (p[2][2] > 0.0) & (p[3][3] > 0.0)
    return good & (p[2][2] <= gains.omega_max * gains.omega_max + gains.p_omega) & (p[3][3] <= _P_THETA)


def ekf_step(gains: EkfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha, beta).

    A sample after which a number is out of range (`_ekf_sound`) begins anew with its current, the covariance of the
    start, the angle that was foretold and the speed before.
    """
    if not state.started:
        return _ekf_begun(gains, state.theta_e, state.omega_e, i, maths)
    (i_d, i_q), p, theta = _ekf_predicted(gains, state, v, maths)
    seen = park(i, maths.rotation(theta))
    nu_d, nu_q = seen[0] - i_d, seen[1] - i_q
    b_d, b_q = -i_q, i_d
    h = [(p[n][0] + b_d * p[n][3], p[n][1] + b_q * p[n][3]) for n in range(4)]
    s_dd = (h[0][0] + b_d * h[3][0]) + gains.r
    s_dq = h[0][1] + b_d * h[3][1]
    s_qq = (h[1][1] + b_q * h[3][1]) + gains.r
    det = s_dd * s_qq - s_dq * s_dq
    inverse = 1.0 / det
    k = [((h[n][0] * s_qq - h[n][1] * s_dq) * inverse, (h[n][1] * s_dd - h[n][0] * s_dq) * inverse) for n in range(4)]
    x = [k[n][0] * nu_d + k[n][1] * nu_q for n in range(4)]
    for n in range(4):
        for m in range(n + 1):
            p[m][n] = p[n][m] = p[m][n] - (k[m][0] * h[n][0] + k[m][1] * h[n][1])
    speed, current = limited(state.omega_e + x[2], gains.omega_max), (i_d + x[0], i_q + x[1])
    sound = _ekf_sound(gains, current, speed, p, det, x[3])
    values = (maths.wrap(theta + x[3]), speed, *current, *(p[n][m] for n, m in _UPPER))
    if not np.all(sound):
        anew = _ekf_begun(gains, theta, state.omega_e, i, maths)
        parts = zip(values, (anew.theta_e, anew.omega_e, *anew.scalars), strict=True)
        values = tuple(np.where(sound, own, other) for own, other in parts)
    return ObserverState((), values[0], values[1], True, values[2:])


@dataclass(frozen=True, slots=True)
class ShownGains:
    """What the machine shows of the errors: ``salient`` = L_d - L_q in H, ``psi_pm`` in Wb, (rad/s)^2."""

    salient: float
    psi_pm: float
    omega_min_2: float


@dataclass(frozen=True, slots=True)
class MatsuiVoltageGains:
    """`dqforge.optimizer.matsui.Matsui` of the kind ``voltage`` for the firmware."""

    model: SampledGains
    shown: ShownGains
    k_p: float
    k_i: float
    speed_share: float
    omega_max: float


@dataclass(frozen=True, slots=True)
class MatsuiCurrentGains:
    """`dqforge.optimizer.matsui.Matsui` of the kind ``current``; ``g_d``, ``g_q`` in V/A."""

    model: SampledGains
    shown: ShownGains
    g_d: float
    g_q: float
    l_theta: float
    speed_share: float
    omega_max: float


def matsui_gains(observer: Matsui) -> MatsuiVoltageGains | MatsuiCurrentGains:
    """What the firmware needs of an estimator."""
    model, machine = observer.model, observer.model.machine
    shown = ShownGains(machine.l_d - machine.l_q, machine.psi_pm, observer.omega_min**2)
    if observer.kind == "voltage":
        return MatsuiVoltageGains(
            sampled_gains(model), shown, observer.k_p, observer.k_i, observer.speed_share, model.omega_max
        )
    g_d, g_q = (-1.0 / float(model.table[row, 0]) for row in (4, 7))
    return MatsuiCurrentGains(
        sampled_gains(model), shown, g_d, g_q, observer.l_theta, observer.speed_share, model.omega_max
    )


def matsui_voltage_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s.

    Its vector is the last current; its scalars are the low-pass speed less omega_e, and the integral, both in rad/s.
    """
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, False, (zero, zero))


def matsui_voltage_sizes(scalars: FloatArray, omega: FloatArray) -> FloatArray:
    """Noticeable changes of the scalars of M estimators, shape (M, 2): both are speeds, nil in an ideal drive."""
    return np.maximum(np.abs(scalars), np.maximum(np.abs(omega), 1.0)[:, None])


def matsui_current_start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step: angle in rad (wrapped), speed in rad/s; its vector is the last current."""
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero),), theta_e, omega_e, started=False)


def _shown_errors(shown: ShownGains, omega: Reals, v: Pair, i: Pair) -> Pair:
    active, cross = shown.psi_pm + shown.salient * i[0], shown.salient * i[1]
    scale = 1.0 / (active * active + cross * cross)
    share = omega / (omega * omega + shown.omega_min_2)
    return (scale * (cross * v[1] - active * v[0])) * share, scale * (active * v[1] + cross * v[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn, current gap."""

    theta: Reals
    now: Pair
    entries: list[Reals]
    cosine: Reals
    half: Reals
    gap: Pair


def _gap(model: SampledGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic) -> _Gap:
    turn = maths.rotation(state.theta_e)
    theta = maths.wrap(state.theta_e + model.t_s * state.omega_e)
    now = park(i, maths.rotation(theta))
    x = limited(model.t_s * state.omega_e, model.x_max)
    half = 0.5 * x
    e = _entries(model, x)
    foretold = _next(e, park(state.vectors[0], turn), park(v, turn))
    return _Gap(theta, now, e, 1.0 - 0.5 * (half * half), half, (now[0] - foretold[0], now[1] - foretold[1]))


def matsui_voltage_step(
    gains: MatsuiVoltageGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha, beta)."""
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    found = _gap(gains.model, state, v, i, maths)
    e, gap = found.entries, found.gap
    scale = -1.0 / (e[2] * e[3] - e[7] * e[8])
    v_d, v_q = scale * (e[3] * gap[0] - e[7] * gap[1]), scale * (e[2] * gap[1] - e[8] * gap[0])
    difference = found.cosine * v_d + found.half * v_q, found.cosine * v_q - found.half * v_d
    angle, slip = _shown_errors(gains.shown, state.omega_e, difference, found.now)
    behind, integral = state.scalars
    speed = (state.omega_e + behind) + gains.speed_share * (slip - behind)
    integral = limited(integral + gains.k_i * angle, gains.omega_max)
    turning = limited(speed + (gains.k_p * angle + integral), gains.omega_max)
    return ObserverState((i,), found.theta, turning, True, (speed - turning, integral))


def matsui_current_step(
    gains: MatsuiCurrentGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """Next state; ``v`` in V acted over the period that ends at the instant of ``i`` in A (alpha, beta)."""
    if not state.started:
        return replace(state, vectors=(i,), started=True)
    found = _gap(gains.model, state, v, i, maths)
    gap, half = found.gap, found.half
    difference = (
        gains.g_d * (found.cosine * gap[0] - half * gap[1]),
        gains.g_q * (found.cosine * gap[1] + half * gap[0]),
    )
    angle, slip = _shown_errors(gains.shown, state.omega_e, difference, found.now)
    moved = maths.wrap(found.theta + gains.l_theta * (angle + (0.5 * gains.model.t_s) * slip))
    return ObserverState((i,), moved, limited(state.omega_e + gains.speed_share * slip, gains.omega_max))
