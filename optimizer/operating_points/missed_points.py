"""Second look at the rare points whose optimum the batched solver missed:
a scan of their torque curves, then Newton.

Measured flux maps are bumpy: a torque curve may have two valleys of the loss, of which one breaks
the voltage limit and the other keeps it. The scan finds the best part of the whole curve within the
limits.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import torque_from_flux
from dqforge.optimizer.operating_points.local_terms import (
    cross_of_gradients,
    loss_terms,
    newton_step,
    torque_terms,
    voltage_terms,
)
from dqforge.optimizer.operating_points.optimality import residual
from dqforge.optimizer.operating_points.point_problem import (
    Active,
    BoolArray,
    IndexArray,
    Problem,
    State,
)

WORST = 1e-8  # Residual of a reached point from which on it is looked at again.
_ANGLES, _RADII = 361, 181
_TOGETHER = 16
_STEPS = 20


def missed_points(state: State, residuals: FloatArray) -> IndexArray:
    """Points that were reached but are no optimum.

    Args:
        state: Currents of the points and whether they were reached.
        residuals: Largest relative violation of the conditions, shape (N,).
    """
    return np.flatnonzero(state.reached & ~(residuals <= WORST))


def replace_missed_points(
    problem: Problem, state: State, index: IndexArray, residuals: FloatArray
) -> None:
    """Replace points by better ones where the scan and Newton's method find any.

    ``state`` is changed in place.

    Args:
        problem: Machine, torques and limits of N points.
        state: Their currents and multipliers.
        index: The points to replace.
        residuals: Largest relative violation of the conditions, shape (N,).
    """
    for first in range(0, index.size, _TOGETHER):
        part = index[first : first + _TOGETHER]
        here = problem.take(part)
        start_d, start_q, found = _best_on_curve(here)
        best = residuals[part]
        for code in (Active.NONE, Active.VOLTAGE):
            i_d, i_q = _polished(here, start_d, start_q, code)
            trial = State(
                i_d,
                i_q,
                here.torque.copy(),
                np.full(part.size, code, dtype=np.int8),
                np.ones(part.size, dtype=np.bool_),
                np.zeros(part.size, dtype=np.bool_),
            )
            left, _, _, _ = residual(here, trial)
            better = found & (left < best)
            chosen = part[better]
            state.i_d[chosen], state.i_q[chosen], state.active[chosen] = (
                i_d[better],
                i_q[better],
                code,
            )
            best = np.where(better, left, best)


def _best_on_curve(problem: Problem) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Point of least loss within all limits among rays that meet the torque curve,
    and whether there is one, (N,).
    """
    angle = np.linspace(0.0, np.pi, _ANGLES)[:, np.newaxis]
    radius = np.linspace(0.0, problem.i_max, _RADII)
    i_d, i_q = radius * np.cos(angle), radius * np.sin(angle)
    machine = problem.machine
    psi_d, psi_q = machine.flux(i_d, i_q)
    torque = torque_from_flux(machine.pole_pairs, psi_d, psi_q, i_d, i_q)
    above = torque[np.newaxis] >= problem.torque[:, np.newaxis, np.newaxis]
    after = np.maximum(np.argmax(above, axis=2), 1)
    rays = np.arange(_ANGLES)
    low, high = torque[rays, after - 1], torque[rays, after]
    share = (problem.torque[:, np.newaxis] - low) / np.where(high > low, high - low, 1.0)
    length = radius[after - 1] + np.clip(share, 0.0, 1.0) * radius[1]
    on_d, on_q = length * np.cos(angle[:, 0]), length * np.sin(angle[:, 0])
    psi_d, psi_q = machine.flux(on_d, on_q)
    omega = problem.omega_e[:, np.newaxis]
    volts = np.hypot(machine.r_s * on_d - omega * psi_q, machine.r_s * on_q + omega * psi_d)
    loss = problem.loss
    lost = loss.square[:, np.newaxis] * length**2 + loss.linear[:, np.newaxis] * length
    lost += loss.iron[:, np.newaxis] * (psi_d**2 + psi_q**2)
    # The grid's own error must not exclude the point that touches the limit.
    kept = above.any(axis=2) & (volts <= problem.v_max[:, np.newaxis] * (1.0 + 1e-3))
    lost = np.where(kept, lost, np.inf)
    best, rows = np.argmin(lost, axis=1), np.arange(problem.torque.size)
    return on_d[rows, best], on_q[rows, best], np.isfinite(lost[rows, best])


def _polished(
    problem: Problem, i_d: FloatArray, i_q: FloatArray, code: Active
) -> tuple[FloatArray, FloatArray]:
    """Newton's method on the torque and the valley of the loss, or on the
    torque and the voltage limit.
    """
    i_d, i_q = i_d.copy(), i_q.copy()
    for _ in range(_STEPS):
        jet = problem.machine.jet(i_d, i_q)
        torque = torque_terms(problem.machine, jet, i_d, i_q)
        if code == Active.NONE:
            other = cross_of_gradients(
                loss_terms(problem.loss, jet, i_d, i_q, problem.soft), torque
            )
            step_d, step_q = newton_step(torque, other, problem.torque, 0.0)
        else:
            other = voltage_terms(problem.machine, jet, i_d, i_q, problem.omega_e)
            step_d, step_q = newton_step(torque, other, problem.torque, problem.v_max**2)
        size = np.hypot(step_d, step_q)
        finite = np.isfinite(size)
        damping = np.where(
            finite, np.minimum(1.0, 0.1 * problem.i_max / np.maximum(size, 1e-300)), 0.0
        )
        i_d = i_d + np.where(finite, damping * step_d, 0.0)
        i_q = i_q + np.where(finite, damping * step_q, 0.0)
    return i_d, i_q
