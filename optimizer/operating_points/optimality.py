"""Proof of optimality: how far each operating point is from the Karush-Kuhn-Tucker
conditions of its problem.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.optimizer.operating_points.local_terms import (
    Terms,
    current_terms,
    loss_terms,
    torque_terms,
    voltage_terms,
)
from dqforge.optimizer.operating_points.point_problem import (
    Active,
    BoolArray,
    IndexArray,
    Problem,
    State,
)

# Share of a limit within which a point on the edge of the data counts as held by that limit, too.
_ON_A_LIMIT = 1e-6


def _norm(terms: Terms) -> FloatArray:
    """Length of the gradient, never quite zero so that it may divide."""
    return np.maximum(np.hypot(terms.d, terms.q), 1e-300)


def _two_multipliers(goal: Terms, first: Terms, second: Terms) -> tuple[FloatArray, FloatArray]:
    """Multipliers (a, b) of goal = a first + b second (gradients)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (goal.d * second.q - goal.q * second.d) * scale, (
            first.d * goal.q - first.q * goal.d
        ) * scale


def residual(
    problem: Problem, state: State
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Largest relative violation of the conditions, torque in N m, voltage in V and loss in W,
    shape (N,).

    Args:
        problem: Machine, torques and limits of the points.
        state: Currents and multipliers of the points.
    """
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
    residual = np.maximum(
        np.abs(torque.value - state.torque) / most, np.maximum(over_voltage, over_current)
    )
    if problem.region is not None:
        residual = np.maximum(residual, problem.region.beyond(d, q) / problem.i_max)
    active = state.active
    residual = np.where(active == Active.UNREACHABLE, 0.0, residual)
    # Near zero current the gradient of the loss vanishes; its direction is judged against a
    # thousandth of its size.
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
    if problem.region is not None:
        residual = _data_residual(
            residual, problem, state, problem.region, (loss, torque, voltage, circle)
        )
    return residual, torque.value, np.sqrt(voltage.value), loss.value


def _most_torque_residual(
    residual: FloatArray, state: State, torque: Terms, voltage: Terms, circle: Terms
) -> FloatArray:
    """Add the conditions of most torque: its gradient lies between those
    of the limits that hold it.
    """
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
        wrong = np.maximum(
            -sense * by_voltage * _norm(voltage), -sense * by_current * _norm(circle)
        ) / _norm(torque)
    return np.where(
        state.active == Active.BOTH, np.maximum(residual, np.maximum(wrong, 0.0)), residual
    )


def _data_residual(
    residual: FloatArray,
    problem: Problem,
    state: State,
    region: CurrentRegion,
    terms: tuple[Terms, Terms, Terms, Terms],
) -> FloatArray:
    """Add the conditions of points on the edge of the data.

    ``terms`` are loss, torque, voltage and current.

    For a torque that is reached, less loss must lie beyond the edge alone. The gradient of a most
    torque must lie between the normals of an edge and of whatever else holds the point: another
    edge, the voltage or the current.
    """
    index = np.flatnonzero(state.active == Active.DATA)
    loss, torque, voltage, circle = (_taken(term, index) for term in terms)
    d, q = state.i_d[index], state.i_q[index]
    reached = state.reached[index]
    sense = np.where(reached, -1.0, np.where(state.least[index], -1.0, 1.0))
    goal_d, goal_q = (
        sense * np.where(reached, loss.d, torque.d),
        sense * np.where(reached, loss.q, torque.q),
    )
    size = np.maximum(np.hypot(goal_d, goal_q), 1e-300)
    slack = _ON_A_LIMIT * problem.i_max
    normals = [
        (
            normal_d + 0.0 * d,
            normal_q + 0.0 * d,
            np.abs(normal_d * d + normal_q * q - offset) <= slack,
        )
        for normal_d, normal_q, offset in zip(
            region.normal_d, region.normal_q, region.offset, strict=True
        )
    ]
    for term, limit in ((voltage, problem.v_max[index] ** 2), (circle, problem.i_max**2)):
        normals.append(
            (
                term.d / _norm(term),
                term.q / _norm(term),
                np.abs(term.value / limit - 1.0) <= _ON_A_LIMIT,
            )
        )
    unit = _norm(torque)
    along = [(sign * torque.d / unit, sign * torque.q / unit, reached) for sign in (1.0, -1.0)]
    left = _outside_cone(goal_d / size, goal_q / size, [*normals, *along])
    residual[index] = np.maximum(residual[index], left)
    return residual


def _taken(terms: Terms, index: IndexArray) -> Terms:
    return Terms(*(getattr(terms, name)[index] for name in ("value", "d", "q", "dd", "dq", "qq")))


def _outside_cone(
    goal_d: FloatArray, goal_q: FloatArray, normals: list[tuple[FloatArray, FloatArray, BoolArray]]
) -> FloatArray:
    """Distance of unit vectors from the cone of those of the given unit vectors that count,
    shape (N,).
    """
    left = np.ones_like(goal_d)
    held = [normal for normal in normals if np.any(normal[2])]
    for place, (first_d, first_q, first) in enumerate(held):
        share = np.maximum(goal_d * first_d + goal_q * first_q, 0.0)
        apart = np.hypot(goal_d - share * first_d, goal_q - share * first_q)
        left = np.where(first, np.minimum(left, apart), left)
        for second_d, second_q, second in held[place + 1 :]:
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 1.0 / (first_d * second_q - first_q * second_d)
                a, b = (
                    (goal_d * second_q - goal_q * second_d) * scale,
                    (first_d * goal_q - first_q * goal_d) * scale,
                )
                between = first & second & (a >= 0.0) & (b >= 0.0) & np.isfinite(scale)
            left = np.where(between, 0.0, left)
    return left
