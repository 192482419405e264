"""Matsui's position estimators: voltage model and current model in a frame of assumed
angle (paper 001, 7.2.6).

The frame gamma, delta stands at the assumed angle and turns with the assumed speed. A model of the
machine that stands exactly there foretells the current at the end of a period
(`dqforge.optimizer.observers.sampled_machine`); what is measured differs by delta_i, and the
voltage that would have made the measured current differs from the held one by

    delta_v = -exp(-j omega t_s/2) Gamma(omega)^-1 delta_i

(turned from the frame of the beginning, in which Gamma takes its voltage, into that of the middle
of the period). With the angle error eps = theta - theta_hat in the middle of the period, the speed
error d = omega - omega_hat and, for salient machines, the flux linkage psi_a = psi + (L_d - L_q)
i_d that shows them, to first order

    delta_v_delta  =  psi_a d + (L_d - L_q) i_q omega eps
    -delta_v_gamma =  psi_a omega eps - (L_d - L_q) i_q d

a scaled rotation, so that both errors come out apart: with n = psi_a^2 + ((L_d - L_q) i_q)^2

    d         = (psi_a delta_v_delta + (L_d - L_q) i_q delta_v_gamma) / n
    omega eps = ((L_d - L_q) i_q delta_v_delta - psi_a delta_v_gamma) / n

For a surface machine these are (7.38), (7.39) and the error of (7.37). omega eps is divided by
omega through omega/(omega^2 + omega_min^2), which fades the correction out near standstill, where
neither model sees the angle.

    voltage model (7.37) to (7.41)                        current model (7.46) to (7.49)
    speed = omega_hat + d, low-pass by the share l        omega_hat += l_omega d
    integral += k_i eps
        theta_hat += t_s omega_hat + l_theta (eps + d t_s/2)
    omega_hat = speed + k_p eps + integral
    theta_hat = theta_hat + t_s omega_hat
        delta_v = -diag(1/c_d, 1/c_q) exp(j omega t_s/2) delta_i

The current model takes delta_i through constants (c = (1 - exp(-R t_s/L))/R) instead of Gamma^-1.
Poles of the current model: 1 - l_theta and 1 - l_omega. Of the voltage model: 1 - l, and for S =
p_1 + p_2, P = p_1 p_2 at choice

    p_3 = (3 - S - P)/(1 + S + P),  k_i t_s/2 = P + S p_3 - 1,  (k_p + k_i) t_s/2 = 2 - S - p_3

from eps' = eps + t_s d, integral' = integral + k_i (eps + d t_s/2),
d' = -integral' - k_p (eps + d t_s/2).

Deviations from paper 001: with (7.38) a positive delta_v_gamma at positive speed means that the
assumed angle is ahead, as the text says, but (7.40) then adds to the speed where it must subtract;
(7.35) and (7.37) lack i_delta behind R + L d/dt; (7.42) and (7.44) lack 1/L before the second and
third term.

References:
    N. Matsui, "Sensorless PM brushless DC motor drives", IEEE Trans. Ind. Electronics 43, 1996
    ([99] of paper 001); S. Morimoto et al., "Sensorless control strategy for salient-pole PMSM
    based on extended EMF in rotating reference frame", IEEE Trans. Ind. Applications 38, 2002
    (psi_a).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.sampled_machine import (
    SampledMachine,
    Trial,
    applied,
    exact_entries,
    sampled_machine,
    turned,
    wrapped,
)
from dqforge.optimizer.sampled_systems import ComplexArray

MatsuiModel = Literal["voltage", "current"]


@dataclass(frozen=True, slots=True)
class Matsui:
    """One of Matsui's estimators.

    Args:
        model: The sampled machine as the firmware believes it to be.
        kind: ``voltage`` or ``current``.
        omega_min: Electrical speed in rad/s below which the angle is corrected less and less.
        speed_share: Share l, or l_omega, of the speed error that one period removes.
        k_p, k_i: Of the voltage model: speed per angle error in 1/s, and its increment per period
            in 1/s.
        l_theta: Of the current model: share of the angle error that one period removes.
    """

    model: SampledMachine
    kind: MatsuiModel
    omega_min: float
    speed_share: float
    k_p: float = 0.0
    k_i: float = 0.0
    l_theta: float = 0.0

    @property
    def poles(self) -> FloatArray:
        """Poles of the linearised error loop at speeds well above omega_min, in the z plane,
        by falling modulus.
        """
        t_s = self.model.t_s
        if self.kind == "current":
            loop = np.diag([1.0 - self.l_theta, 1.0 - self.speed_share])
        else:
            both, half = self.k_p + self.k_i, 0.5 * t_s
            loop = np.array(
                [
                    [1.0, t_s, 0.0, 0.0],  # angle, speed, integral, low-pass
                    [-both, -half * both, -1.0, 1.0 - self.speed_share],
                    [self.k_i, half * self.k_i, 1.0, 0.0],
                    [0.0, 0.0, 0.0, 1.0 - self.speed_share],
                ]
            )
        found = np.linalg.eigvals(loop)
        return np.asarray(found[np.argsort(-np.abs(found))])


@dataclass(frozen=True, slots=True, eq=False)
class ObserverRun:
    """Estimates at the samples: ``theta`` in rad and ``omega`` in rad/s (electrical), shape (K + 1,
    S).
    """

    theta: FloatArray
    omega: FloatArray

    def angle_error(self, trial: Trial) -> FloatArray:
        """Estimated minus true angle in rad, wrapped, shape (K + 1, S)."""
        return wrapped(self.theta - trial.theta)


def check_speeds(machine: LinearMachine, what: str, poles: dict[str, float], t_s: float) -> None:
    """Refuse what has no magnet or a pole in rad/s, by the key of the design,
    that the sampling cannot hold.
    """
    if not machine.psi_pm > 0.0:
        raise NoSolutionError(
            f"control.observer: {what} needs magnet flux (machine.psi_pm is 0); write method: "
            "injection or ekf"
        )
    for key, pole in poles.items():
        if not (pole > 0.0 and pole * t_s <= 1.0):
            raise InputError(
                f"control.observer.{key} must lie above 0 and up to {1.0 / t_s:g} rad/s (pole t_s "
                f"= 1), got {pole:g}"
            )


def matsui(
    machine: Machine,
    t_s: float,
    kind: MatsuiModel,
    bandwidth: float,
    *,
    damping: float = 1.0,
    speed_bandwidth: float | None = None,
    omega_min: float | None = None,
    omega_max: float | None = None,
) -> Matsui:
    """An estimator by pole placement of its sampled error loop (method ``pole-placement``).

    Args:
        kind: ``voltage`` or ``current``.
        bandwidth: Natural frequency in rad/s of the angle's poles: exp(s t_s) of s^2 + 2 damping
            bandwidth s + bandwidth^2 = 0 for the voltage model, the single pole exp(-bandwidth t_s)
            for the current model.
        speed_bandwidth: Pole of the speed in rad/s, by default the same.
        omega_min: Electrical speed in rad/s of `Matsui`, by default a fiftieth of the largest.

    Raises:
        InputError, NoSolutionError: No magnet, or a pole too fast for the sampling.
    """
    model = sampled_machine(machine, t_s, omega_max)
    of_speed = bandwidth if speed_bandwidth is None else speed_bandwidth
    poles = {"pll_bandwidth": bandwidth, "bandwidth": of_speed}
    check_speeds(model.machine, f"Matsui's {kind} model", poles, t_s)
    slow = model.omega_max / 50.0 if omega_min is None else omega_min
    share = 1.0 - np.exp(-of_speed * t_s)
    if kind == "current":
        return Matsui(
            model, kind, slow, float(share), l_theta=float(1.0 - np.exp(-bandwidth * t_s))
        )
    roots = np.exp(np.roots([1.0, 2.0 * damping * bandwidth, bandwidth**2]) * t_s)
    product, total = float(np.real(np.prod(roots))), float(np.real(np.sum(roots)))
    third = (3.0 - total - product) / (1.0 + total + product)
    k_i = 2.0 * (product + total * third - 1.0) / t_s
    return Matsui(model, kind, slow, float(share), 2.0 * (2.0 - total - third) / t_s - k_i, k_i)


def errors_of(
    observer: Matsui, omega: FloatArray, i: FloatArray, v: FloatArray, i_next: FloatArray
) -> FloatArray:
    """Angle error (rad, middle of the period) and speed error (rad/s), shape (..., 2),
    from what one period showed.

    ``i`` and ``v`` in the assumed frame at its beginning, ``i_next`` at its end, shape (..., 2).
    """
    model, machine = observer.model, observer.model.machine
    entries = model.entries(omega)
    gap = i_next - applied(entries, i, v)
    half = 0.5 * model.t_s * omega
    cosine = 1.0 - 0.5 * half * half
    if observer.kind == "voltage":
        a, b, c, d = (entries[..., k] for k in (4, 5, 6, 7))
        scale = -1.0 / (a * d - b * c)
        x, y = (
            scale * (d * gap[..., 0] - b * gap[..., 1]),
            scale * (a * gap[..., 1] - c * gap[..., 0]),
        )
        v_gamma, v_delta = cosine * x + half * y, cosine * y - half * x
    else:
        v_gamma = -(cosine * gap[..., 0] - half * gap[..., 1]) / model.table[4, 0]
        v_delta = -(cosine * gap[..., 1] + half * gap[..., 0]) / model.table[7, 0]
    salient = machine.l_d - machine.l_q
    active, cross = machine.psi_pm + salient * i_next[..., 0], salient * i_next[..., 1]
    scale = 1.0 / (active * active + cross * cross)
    speed = scale * (active * v_delta + cross * v_gamma)
    angle = (
        scale
        * (cross * v_delta - active * v_gamma)
        * omega
        / (omega * omega + observer.omega_min**2)
    )
    return np.stack([angle, speed], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class MatsuiState:
    """What an estimator remembers, all of shape (S,).

    ``theta`` in rad, ``turning`` in rad/s: the speed with which the frame turns; ``speed`` in rad/s
    before the correction by the angle, and ``integral`` in rad/s of it (voltage model).
    """

    theta: FloatArray
    turning: FloatArray
    speed: FloatArray
    integral: FloatArray


def step(
    observer: Matsui, state: MatsuiState, v: FloatArray, i: FloatArray, i_next: FloatArray
) -> MatsuiState:
    """The state one period later; voltage and currents in stator coordinates, shape (S, 2)."""
    t_s, limit = observer.model.t_s, observer.model.omega_max
    ahead = state.theta + t_s * state.turning
    own = turned(i, state.theta), turned(v, state.theta), turned(i_next, ahead)
    found = errors_of(observer, state.turning, *own)
    angle, slip = found[..., 0], found[..., 1]
    if observer.kind == "current":
        turning = np.clip(state.turning + observer.speed_share * slip, -limit, limit)
        return MatsuiState(
            ahead + observer.l_theta * (angle + 0.5 * t_s * slip), turning, turning, state.integral
        )
    speed = state.speed + observer.speed_share * (state.turning + slip - state.speed)
    integral = np.clip(state.integral + observer.k_i * angle, -limit, limit)
    return MatsuiState(
        ahead, np.clip(speed + observer.k_p * angle + integral, -limit, limit), speed, integral
    )


def run(
    observer: Matsui,
    trial: Trial,
    theta_error: float | FloatArray = 0.0,
    omega_error: float | FloatArray = 0.0,
) -> ObserverRun:
    """Run the estimator over a trial, from errors of angle (rad) and speed (rad/s)."""
    periods, drives = trial.v.shape[:2]
    theta, omega = np.empty((periods + 1, drives)), np.empty((periods + 1, drives))
    theta[0], omega[0] = trial.theta[0] + theta_error, trial.omega[0] + omega_error
    state = MatsuiState(theta[0], omega[0], omega[0], np.zeros(drives))
    for k in range(periods):
        state = step(observer, state, trial.v[k], trial.i[k], trial.i[k + 1])
        theta[k + 1], omega[k + 1] = state.theta, state.turning
    return ObserverRun(theta, omega)


# What Matsui's estimators err by: poles of the sampled error loop at any operating point, steady
# errors, least speed.
#
# With dX = X_hat - X of the parameters, dv = v - v_hat of the voltage and the machine in steady
# state, the right frame would see
#
#     g_gamma = dv_d - dR i_d + omega dL_q i_q
#     g_delta = dv_q - dR i_q - omega (dL_d i_d + dpsi)
#
# and with psi_a, n and c = (L_d - L_q) i_q of `dqforge.optimizer.observers.methods.matsui_model`
# these pass for the errors
#
#     e = (c g_delta - psi_a g_gamma)/(n omega)   of the angle, and
#         d = (psi_a g_delta + c g_gamma)/n   of the speed.
#
# The voltage model, whose integral leaves no angle error that it sees, settles at theta_hat -
# theta = e. The current model settles at the speed omega + d with the angle error e + d
# t_s/l_theta, in which it makes up for its wrong speed. To first order in all errors;
# `steady_error` solves the sampled equations without approximation.

_FACTORS = ("r_s", "l_d", "l_q", "psi_pm")


@dataclass(frozen=True, slots=True)
class SteadyError:
    """Steady errors, estimated minus true: ``theta`` in rad, ``omega`` in rad/s of the
    speed that turns the frame.
    """

    theta: float
    omega: float


def _believed(observer: Matsui, true: LinearMachine) -> dict[str, float]:
    machine = observer.model.machine
    return {name: getattr(machine, name) - getattr(true, name) for name in _FACTORS}


def closed_form_error(
    observer: Matsui,
    true: LinearMachine,
    omega: float,
    i_dq: tuple[float, float],
    dv: tuple[float, float] = (0.0, 0.0),
) -> SteadyError:
    """Steady error to first order at speed omega (electrical, rad/s), currents in A and
    voltage error (d, q) in V.

    ``dv`` is what the machine gets beyond what the firmware believes.
    """
    i_d, i_q = i_dq
    off = _believed(observer, true)
    g_gamma = dv[0] - off["r_s"] * i_d + omega * off["l_q"] * i_q
    g_delta = dv[1] - off["r_s"] * i_q - omega * (off["l_d"] * i_d + off["psi_pm"])
    machine = observer.model.machine
    cross = (machine.l_d - machine.l_q) * i_q
    active = machine.psi_pm + (machine.l_d - machine.l_q) * i_d
    n = active**2 + cross**2
    angle = (cross * g_delta - active * g_gamma) / (n * omega)
    speed = (active * g_delta + cross * g_gamma) / n
    if observer.kind == "voltage":
        return SteadyError(angle, 0.0)
    fading = 1.0 + (observer.omega_min / omega) ** 2
    return SteadyError(angle + fading * observer.model.t_s * speed / observer.l_theta, speed)


def _error_step(
    observer: Matsui, true: LinearMachine, omega: float, i_dq: FloatArray, x: FloatArray
) -> FloatArray:
    """Errors (theta, turning, speed, integral) one period later, shape (N, 4),
    of a machine in steady state.
    """
    t_s = observer.model.t_s
    entries = exact_entries(true, np.array([omega]), t_s)[0]
    phi, gamma, h = entries[:4].reshape(2, 2), entries[4:8].reshape(2, 2), entries[8:]
    v_dq = np.linalg.solve(gamma, i_dq - phi @ i_dq - h)
    count = len(x)
    ones = np.ones((count, 1))
    state = MatsuiState(x[:, 0], omega + x[:, 1], omega + x[:, 2], x[:, 3])
    after = turned(i_dq * ones, np.full(count, -omega * t_s))
    found = step(observer, state, v_dq * ones, i_dq * ones, after)
    rows = [found.theta - omega * t_s, found.turning - omega, found.speed - omega, found.integral]
    return np.stack(rows, axis=1)


def steady_error(
    observer: Matsui, true: LinearMachine, omega: float, i_dq: tuple[float, float]
) -> tuple[SteadyError, ComplexArray]:
    """Steady error without approximation, and the poles of the error loop around it,
    shape (2,) or (3,).

    Args:
        true: The machine as it is; the observer's is what the firmware believes.
        omega: Electrical speed in rad/s, not zero.
        i_dq: True currents (i_d, i_q) in A, held.

    Raises:
        NoSolutionError: The estimator finds no rest there.
    """
    from scipy.optimize import root

    current = np.asarray(i_dq, dtype=np.float64)
    # The frame of the voltage model turns with the machine at rest,
    # and its angle follows from nothing but that.
    used, shown = ([0, 1], [0, 1]) if observer.kind == "current" else ([0, 2, 3], [1, 2, 3])
    scale = np.array([1.0, 0.01 * observer.model.omega_max, 0.01 * observer.model.omega_max, 1.0])
    scale[3] = scale[2]

    def complete(part: FloatArray) -> FloatArray:
        """All four errors in rad and rad/s."""
        x = np.zeros((*part.shape[:-1], 4))
        x[..., used] = part
        return np.asarray(x * scale)

    def motion(part: FloatArray) -> FloatArray:
        x = complete(part[np.newaxis])
        return np.asarray(((_error_step(observer, true, omega, current, x) - x)[0] / scale)[shown])

    near = closed_form_error(observer, true, omega, i_dq)
    guess = np.array([near.theta, near.omega, 0.0, 0.0])[used] / scale[used]
    found = root(motion, guess, tol=1e-13)
    rest = complete(np.asarray(found.x))
    moved = _error_step(observer, true, omega, current, rest[np.newaxis])[0]
    if np.max(np.abs((moved - rest) / scale)[shown]) > 1e-7:
        raise NoSolutionError(
            f"control.observer: the estimator finds no rest at {omega:g} rad/s (electrical)"
        )
    states = [0, 1] if observer.kind == "current" else [0, 1, 2, 3]
    width = 1e-6 * np.diag(scale)[states]
    ahead = _error_step(observer, true, omega, current, rest + width)
    behind = _error_step(observer, true, omega, current, rest - width)
    jacobian = ((ahead - behind)[:, states] / (2e-6 * scale[states][:, np.newaxis])).T
    poles = np.asarray(np.linalg.eigvals(jacobian), dtype=np.complex128)
    return SteadyError(float(rest[0]), float(rest[1])), poles[np.argsort(-np.abs(poles))]


def least_speed(observer: Matsui, i_dq: tuple[float, float], dv: float, angle: float) -> float:
    """Electrical speed in rad/s from which a voltage error up to ``dv`` in V costs
    at most ``angle`` in rad.

    From the closed form of the voltage model: dv/(omega sqrt(n)) = angle; the current model adds
    what its speed loop makes of it, dv t_s/(l_theta sqrt(n)), which no speed makes smaller.

    Raises:
        NoSolutionError: The current model errs by more at every speed.
    """
    machine = observer.model.machine
    salient = machine.l_d - machine.l_q
    size = float(np.hypot(machine.psi_pm + salient * i_dq[0], salient * i_dq[1]))
    left = angle - (
        dv * observer.model.t_s / (observer.l_theta * size) if observer.kind == "current" else 0.0
    )
    if not left > 0.0:
        raise NoSolutionError(
            f"control.observer: a voltage error of {dv:g} V costs the current model more than "
            f"{angle:g} rad at every speed; write a faster control.observer.pole"
        )
    return max(dv / (size * left), observer.omega_min)


def with_errors(machine: LinearMachine, **relative: float) -> LinearMachine:
    """A machine whose ``r_s``, ``l_d``, ``l_q``, ``psi_pm`` are off by relative errors, e.g.
    0.3 for +30 %.
    """
    return replace(
        machine,
        **{name: getattr(machine, name) * (1.0 + value) for name, value in relative.items()},
    )
