"""Proof of optimality: how far each operating point is from the Karush-Kuhn-Tucker conditions of its problem."""

from __future__ import annotations

import numpy as np

from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.local_terms import Terms, current_terms, loss_terms, torque_terms, voltage_terms
from dqforge.optimizer.point_problem import Active, Problem, State


def _norm(terms: Terms) -> FloatArray:
    """Length of the gradient, never quite zero so that it may divide."""
    return np.maximum(np.hypot(terms.d, terms.q), 1e-300)


def _two_multipliers(goal: Terms, first: Terms, second: Terms) -> tuple[FloatArray, FloatArray]:
    """Multipliers (a, b) of goal = a first + b second (gradients)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (goal.d * second.q - goal.q * second.d) * scale, (first.d * goal.q - first.q * goal.d) * scale


def residual(problem: Problem, state: State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Largest relative violation of the conditions, torque in N m, voltage in V and loss in W, shape (N,)."""
    machine, d, q = problem.machine, state.i_d, state.i_q
    jet = machine.jet(d, q)
    torque = torque_terms(machine, jet, d, q)
    voltage = voltage_terms(machine, jet, d, q, problem.omega_e)
    loss = loss_terms(problem.loss, jet, d, q, problem.soft)
    circle = current_terms(d, q)
    most = float(problem.locus.torque[-1])
    square = problem.v_max**2
    over_voltage = np.maximum(voltage.value / square - 1.0, 0.0)
    over_current = np.maximum(circle.value / problem.i_max**2 - 1.0, 0.0)
    residual = np.maximum(np.abs(torque.value - state.torque) / most, np.maximum(over_voltage, over_current))
    active = state.active
    residual = np.where(active == Active.UNREACHABLE, 0.0, residual)
    # Near zero current the gradient of the loss vanishes; its direction is judged against a thousandth of its size.
    loss_scale = np.maximum(_norm(loss), 2e-3 * problem.loss.square * problem.i_max) * _norm(torque)
    slope = np.abs(loss.d * torque.q - loss.q * torque.d) / loss_scale
    residual = np.where(active == Active.NONE, np.maximum(residual, slope), residual)
    for code, limit, gap in (
        (Active.VOLTAGE, voltage, np.abs(voltage.value / square - 1.0)),
        (Active.CURRENT, circle, np.abs(circle.value / problem.i_max**2 - 1.0)),
    ):
        chosen = (active == code) & state.reached
        _, pull = _two_multipliers(loss, torque, limit)
        wrong = np.maximum(pull * _norm(limit) / _norm(loss), 0.0)
        residual = np.where(chosen, np.maximum(residual, np.maximum(gap, wrong)), residual)
    residual = _most_torque_residual(residual, state, torque, voltage, circle)
    return residual, torque.value, np.sqrt(voltage.value), loss.value


def _most_torque_residual(
    residual: FloatArray, state: State, torque: Terms, voltage: Terms, circle: Terms
) -> FloatArray:
    """Add the conditions of most torque: its gradient lies between those of the limits that hold it."""
    for code, limit in ((Active.CURRENT, circle), (Active.MTPV, voltage)):
        chosen = (state.active == code) & ~state.reached
        sine = np.abs(
            (torque.d / _norm(torque)) * (limit.q / _norm(limit))
            - (torque.q / _norm(torque)) * (limit.d / _norm(limit))
        )
        residual = np.where(chosen, np.maximum(residual, sine), residual)
    by_voltage, by_current = _two_multipliers(torque, voltage, circle)
    sense = np.where(state.least, -1.0, 1.0)
    with np.errstate(invalid="ignore"):
        wrong = np.maximum(-sense * by_voltage * _norm(voltage), -sense * by_current * _norm(circle)) / _norm(torque)
    return np.where(state.active == Active.BOTH, np.maximum(residual, np.maximum(wrong, 0.0)), residual)
