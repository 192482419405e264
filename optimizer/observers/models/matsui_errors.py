"""What Matsui's estimators err by: poles of the sampled error loop at any operating point,
steady errors, least speed.

With dX = X_hat - X of the parameters, dv = v - v_hat of the voltage and the machine in steady
state, the right frame would see

    g_gamma = dv_d - dR i_d + omega dL_q i_q
    g_delta = dv_q - dR i_q - omega (dL_d i_d + dpsi)

and with psi_a, n and c = (L_d - L_q) i_q of `dqforge.optimizer.observers.models.matsui_model`
these pass for the errors

    e = (c g_delta - psi_a g_gamma)/(n omega)   of the angle, and
        d = (psi_a g_delta + c g_gamma)/n   of the speed.

The voltage model, whose integral leaves no angle error that it sees, settles at theta_hat - theta =
e. The current model settles at the speed omega + d with the angle error e + d t_s/l_theta, in which
it makes up for its wrong speed. To first order in all errors; `steady_error` solves the sampled
equations without approximation.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.models.matsui_model import Matsui, MatsuiState, step
from dqforge.optimizer.observers.sampled_machine import exact_entries, turned
from dqforge.optimizer.sampled_systems import ComplexArray

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
