"""Steady states of a position observer: fixed points of its step, poles,
and the noise that it lets through.

In coordinates that turn with the rotor a steady drive stands still, and so does its observer: its
state is a fixed point of the step, found by Newton's method at many speeds and many wrong machines
at once. The derivative there has the poles of the whole observer, loop included, as eigenvalues; it
carries the noise of currents and voltages into the angle (Lyapunov equation). A constant
acceleration is a steady state, too, with a speed that moves by a t_s per sample.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.drive_motion import ComplexArray, Plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.method import ObserverMethod
from dqforge.optimizer.observers.parts import EXACT, ObserverState, Pair

_NEWTON_STEPS = 12


_DOUBLINGS = 40


@dataclass(frozen=True, slots=True, eq=False)
class SteadyObserver:
    """Steady states of an observer, arrays over M cases.

    ``theta_error`` in rad and ``omega_error`` in rad/s are estimate minus truth, shape (M,);
    ``jacobian`` (M, n, n) the derivative of one step by the state (vectors, angle, speed);
    ``by_current``, ``by_voltage`` (M, n, 2) that by the measured current and voltage; ``found``
    (M,) whether a fixed point was found, ``states`` (M, n) its vectors, scalars, angle error and
    speed error.
    """

    theta_error: FloatArray
    omega_error: FloatArray
    jacobian: FloatArray
    by_current: FloatArray
    by_voltage: FloatArray
    found: NDArray[np.bool_]
    states: FloatArray

    @property
    def poles(self) -> ComplexArray:
        """Poles in the z plane, largest modulus first, shape (M, n)."""
        values = np.linalg.eigvals(self.jacobian).astype(np.complex128)
        order = np.argsort(-np.abs(values), axis=1, kind="stable")
        return np.take_along_axis(values, order, axis=1)

    def angle_noise(self, i_noise: float, v_noise: float) -> FloatArray:
        """Standard deviation of the angle in rad under white noise of A and V per component;
        inf if unstable.
        """
        drive = i_noise**2 * _square(self.by_current) + v_noise**2 * _square(self.by_voltage)
        covariance, power = drive, self.jacobian.copy()
        stable = np.max(np.abs(np.linalg.eigvals(self.jacobian)), axis=1) < 1.0 - 1e-9
        power[~stable] = 0.0
        for _ in range(_DOUBLINGS):
            covariance = covariance + power @ covariance @ np.swapaxes(power, 1, 2)
            power = power @ power
        return np.where(stable, np.sqrt(np.maximum(covariance[:, -2, -2], 0.0)), np.inf)


def _square(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix @ np.swapaxes(matrix, 1, 2), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """M steady operating points in rotor coordinates at the instant of sampling."""

    omega: FloatArray
    turn: FloatArray
    drift: FloatArray
    v: ComplexArray
    i: ComplexArray

    def repeated(self, count: int) -> _Case:
        omega, turn, drift = (np.tile(part, count) for part in (self.omega, self.turn, self.drift))
        return _Case(omega, turn, drift, np.tile(self.v, count), np.tile(self.i, count))


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


def vector_count(method: ObserverMethod) -> int:
    """How many vectors the state of an observer holds."""
    return len(method.start(np.zeros(1), np.zeros(1)).vectors)


def _stepped(method: ObserverMethod, gains: Any, case: _Case, states: FloatArray) -> FloatArray:
    """States (M, n) one sample on; angle and speed in them are relative to the truth."""
    back = np.exp(-1j * case.turn)
    count = vector_count(method)
    vectors = tuple(
        _pair((states[:, 2 * n] + 1j * states[:, 2 * n + 1]) * back) for n in range(count)
    )
    scalars = tuple(states[:, n] for n in range(2 * count, states.shape[1] - 2))
    angle, speed = states[:, -2] - case.turn, states[:, -1] + case.omega - case.drift
    before = ObserverState(vectors, angle, speed, scalars=scalars)
    after = method.step(gains, before, _pair(case.v), _pair(case.i), EXACT)
    columns = [part for vector in after.vectors for part in vector] + list(after.scalars)
    return np.stack([*columns, EXACT.wrap(after.theta_e), after.omega_e - case.omega], axis=1)


def _first(method: ObserverMethod, gains: Any, case: _Case) -> FloatArray:
    state = method.step(
        gains,
        method.start(np.zeros_like(case.omega), case.omega),
        _pair(case.v),
        _pair(case.i),
        EXACT,
    )
    columns = [part for vector in state.vectors for part in vector] + list(state.scalars)
    states = np.stack([*columns, np.zeros_like(case.omega), np.zeros_like(case.omega)], axis=1)
    for _ in range(method.settle):
        states = _stepped(method, gains, case, states)
    return states


def _derivative(method: ObserverMethod, gains: Any, case: _Case, states: FloatArray) -> FloatArray:
    """Central differences of a step by the state, shape (M, n, n)."""
    m, n = states.shape
    size = np.ones((m, n))
    count = 2 * vector_count(method)
    if method.sizes is not None:
        size[:, count:-2] = method.sizes(states[:, count:-2], case.omega)
    for k in range(0, count, 2):
        norm = np.hypot(states[:, k], states[:, k + 1])
        size[:, k] = size[:, k + 1] = np.where(norm > 1e-6, norm, 1.0)
    size[:, -1] = np.maximum(np.abs(case.omega), 1.0)
    steps = 1e-6 * size
    moved = np.concatenate(
        [states + sign * steps * np.eye(n)[k] for sign in (1.0, -1.0) for k in range(n)]
    )
    values = _stepped(method, gains, case.repeated(2 * n), moved).reshape(2, n, m, n)
    slope = (values[0] - values[1]) / (2.0 * steps.T[:, :, None])
    return np.asarray(np.moveaxis(slope, 0, -1), dtype=np.float64)


def _by_input(
    method: ObserverMethod, gains: Any, case: _Case, states: FloatArray, name: str
) -> FloatArray:
    """Central differences of a step by current or voltage, shape (M, n, 2)."""
    columns = []
    value = case.i if name == "i" else case.v
    size = 1e-6 * (np.max(np.abs(value)) + 1e-3)
    for direction in (1.0, 1j):
        ends = []
        for sign in (1.0, -1.0):
            other = value + sign * size * direction
            moved = _Case(
                case.omega,
                case.turn,
                case.drift,
                case.v if name == "i" else other,
                other if name == "i" else case.i,
            )
            ends.append(_stepped(method, gains, moved, states))
        columns.append((ends[0] - ends[1]) / (2.0 * size))
    return np.stack(columns, axis=-1)


def steady_observer(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    plant: Plants,
    i_dq: ComplexArray,
    omega: FloatArray,
    acceleration: FloatArray | float = 0.0,
    lost: FloatArray | float = 0.0,
) -> SteadyObserver:
    """Steady states of an observer on M drives.

    Args:
        plant: The true machines, M of them; the observer knows the one of its gains.
        i_dq: True currents i_d + j i_q in A, shape (M,).
        omega, acceleration: Electrical speed in rad/s at the sampling instant and acceleration in
            rad/s^2, shape (M,).
        lost: Voltage in V along the current that the inverter loses and the observer knows nothing
            of (dead time), scalar or shape (M,).
    """
    drift = np.broadcast_to(np.asarray(acceleration, dtype=np.float64) * t_s, omega.shape)
    mean = omega - 0.5 * drift
    i_dq = np.array(np.broadcast_to(i_dq, omega.shape), dtype=np.complex128)
    acted = steady_voltage(plant, i_dq, mean, t_s)
    # The current turns with the rotor; what is lost along it lies, on average over the period,
    # half a turn behind.
    believed = acted + np.asarray(lost) * np.exp(1j * (np.angle(i_dq) - 0.5 * mean * t_s)) * (
        i_dq != 0.0
    )
    case = _Case(omega, mean * t_s, np.array(drift), believed, i_dq)
    with np.errstate(
        all="ignore"
    ):  # beyond the range of an observer its numbers may grow without bound
        return _solved(method, gains, case)


def newton_moves(slope: FloatArray, gap: FloatArray) -> FloatArray:
    """Newton's moves, shape (N, n); where a matrix is singular the shortest that fits best, nan
    where its numbers are not finite.
    """
    try:
        return np.asarray(np.linalg.solve(slope, gap[..., None])[..., 0])
    except np.linalg.LinAlgError:
        finite = np.all(np.isfinite(slope), axis=(1, 2))
        inverse = np.linalg.pinv(np.where(finite[:, None, None], slope, 0.0))
        return np.where(finite[:, None], (inverse @ gap[..., None])[..., 0], np.nan)


def _solved(method: ObserverMethod, gains: Any, case: _Case) -> SteadyObserver:
    """Newton's method on all cases.

    One whose numbers are not finite counts as lost and unstable.
    """
    states = _first(method, gains, case)
    jacobian = _derivative(method, gains, case, states)
    for _ in range(_NEWTON_STEPS):
        gap = _stepped(method, gains, case, states) - states
        gap[:, -2] = EXACT.wrap(gap[:, -2])
        if np.max(np.abs(gap) / (1.0 + np.abs(states))) < 1e-11:
            break
        states = states + newton_moves(np.eye(states.shape[1]) * (1.0 + 1e-13) - jacobian, gap)
        states[:, -2] = EXACT.wrap(states[:, -2])
        jacobian = _derivative(method, gains, case, states)
    gap = _stepped(method, gains, case, states) - states
    found = (np.abs(EXACT.wrap(gap[:, -2])) < 1e-9) & (np.abs(states[:, -2]) < 0.5 * np.pi)
    inputs = [_by_input(method, gains, case, states, name) for name in ("i", "v")]
    finite = np.all(np.isfinite(states), axis=1)
    for part in (jacobian, *inputs):
        finite &= np.all(np.isfinite(part), axis=(1, 2))
    jacobian[~finite] = 2.0 * np.eye(states.shape[1])
    return SteadyObserver(
        theta_error=states[:, -2],
        omega_error=states[:, -1],
        jacobian=jacobian,
        by_current=np.where(finite[:, None, None], inputs[0], 0.0),
        by_voltage=np.where(finite[:, None, None], inputs[1], 0.0),
        found=found & finite,
        states=states,
    )


def closed_form_error(
    machine: LinearMachine, believed: LinearMachine, i_dq: complex, omega: FloatArray
) -> FloatArray:
    """Steady angle error in rad of the extended EMF and of the open-loop flux, shape (S,).

    Both follow psi_a = psi_pm + (L_d - L_q^) i_d + j (L_q - L_q^) i_q + (R - R^) (i_d + j i_q)/(j
    omega), with ^ for what the observer believes; neither L_d^ nor psi_pm^ matters. The error
    theta_hat - theta is the angle of psi_a.
    """
    along = machine.psi_pm + (machine.l_d - believed.l_q) * i_dq.real
    across = (machine.l_q - believed.l_q) * i_dq.imag
    drop = (machine.r_s - believed.r_s) * i_dq / (1j * omega)
    return np.asarray(np.arctan2(across + drop.imag, along + drop.real), dtype=np.float64)
