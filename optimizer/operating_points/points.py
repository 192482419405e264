"""Optimal operating points of any machine, whole arrays of torque and speed at once.

Least loss for a torque at a speed, within the current limit and the voltage limit of the modulator,
the resistance drop included. In two currents every optimum is the meeting of two curves: the torque
and the valley of the loss, the torque and the voltage limit, the voltage limit and the current
limit, or the touching point of torque and voltage limit (MTPV); where the data of a flux map end
before, it lies on their edge. Each is solved by Newton's method from a start that a scan of the
feasible region gives, never from the user.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.ends_of_data.data_limit import hold_by_data
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.missed_points import missed_points, replace_missed_points
from dqforge.optimizer.operating_points.mtpa_locus import free_locus
from dqforge.optimizer.operating_points.optimality import residual
from dqforge.optimizer.operating_points.point_problem import Active, BoolArray, Problem
from dqforge.optimizer.operating_points.point_solver import solve_chunk
from dqforge.optimizer.operating_points.region_edges import region_that_holds

# Points solved together: bounds the memory whatever the number of points, and keeps the arrays in
# the cache.
__all__ = ["Active", "OptimalPoints", "copper_only", "optimal_points"]
CHUNK = 32_768


@dataclass(frozen=True, slots=True)
class OptimalPoints:
    """Operating points, arrays of shape (N,).

    ``torque_request`` and ``torque`` in N m (equal where ``reached``), ``omega_m`` in rad/s,
    ``i_d``, ``i_q`` in A, ``voltage`` is the phase amplitude in V, ``loss`` in W by the objective's
    model. ``active`` holds codes of `Active`. ``kkt_residual`` is the largest of the relative
    violations of torque, limits, stationarity and multiplier signs. ``extrapolated`` is true where
    the currents lie beyond the data of a flux map.
    """

    torque_request: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    voltage: FloatArray
    loss: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    kkt_residual: FloatArray
    extrapolated: BoolArray


def _as_points(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    array = np.broadcast_to(np.asarray(values, dtype=np.float64), shape).ravel()
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name} must be finite; got nan or inf")
    return array


def copper_only(machine: Machine) -> LossCoefficients:
    """Coefficients of the winding alone, 3/2 R |i|^2 (1 W/A^2 for a machine without resistance:
    the same optimum).
    """
    square = np.array(1.5 * machine.r_s if machine.r_s > 0.0 else 1.0)
    return LossCoefficients(square, np.array(0.0), np.array(0.0))


def optimal_points(
    machine: Machine,
    torque: ArrayLike,
    omega_m: ArrayLike,
    *,
    v_max: ArrayLike,
    i_max: float | None = None,
    loss: LossCoefficients | None = None,
) -> OptimalPoints:
    """Currents of least loss for arrays of torque and speed.

    Args:
        machine: Any machine: linear or flux map.
        torque, omega_m: Requested torque in N m and mechanical speed in rad/s, any sign, broadcast
            together to N points.
        v_max: Largest phase-voltage amplitude in V, positive, broadcast to the points.
        i_max: Current limit in A (peak); the machine's own when None.
        loss: What is minimised, as coefficients at each point; copper loss when None.

    Raises:
        InputError: A number is not finite or a limit not positive.

    Notes:
        A negative torque is the mirror image (i_q, omega reversed) of a positive one. Where the
        torque cannot be had, the largest that can is returned with ``reached`` false, and
        ``active`` names what stands in the way. No point leaves the data of a flux map unless that
        permits it.
    """
    shape = np.broadcast_shapes(np.shape(torque), np.shape(omega_m), np.shape(v_max))
    limit = machine.i_max if i_max is None else i_max
    request, speed = _as_points(torque, shape, "torque"), _as_points(omega_m, shape, "speed")
    volts = _as_points(v_max, shape, "v_max")
    if not (limit > 0.0 and np.all(volts > 0.0)):
        raise InputError("current and voltage limits must be positive")
    coefficients = copper_only(machine) if loss is None else loss
    spread = LossCoefficients(
        *(
            _as_points(values, shape, "loss")
            for values in (coefficients.square, coefficients.linear, coefficients.iron)
        )
    )
    sign = np.where(request < 0.0, -1.0, 1.0)
    whole = Problem(
        machine,
        free_locus(machine, limit),
        np.abs(request),
        sign * machine.pole_pairs * speed,
        volts,
        limit,
        spread,
        region_that_holds(machine, limit),
    )
    solved = [
        _solve(whole.take(np.arange(k, min(k + CHUNK, request.size))))
        for k in range(0, request.size, CHUNK)
    ]
    i_d, i_q, produced, volts_taken, losses, active, reached, residuals = (
        np.concatenate([part[column] for part in solved]) if solved else np.zeros(0)
        for column in range(8)
    )
    met = reached.astype(np.bool_)
    return OptimalPoints(
        torque_request=request,
        torque=np.where(met, request, sign * produced),
        omega_m=speed,
        i_d=i_d,
        i_q=sign * i_q,
        voltage=volts_taken,
        loss=losses,
        active=active.astype(np.int8),
        reached=met,
        kkt_residual=residuals,
        # What the region holds lies inside but for rounding, which is no extrapolation.
        extrapolated=~(
            machine.known(i_d, i_q) if whole.region is None else whole.region.contains(i_d, i_q)
        ),
    )


def _solve(problem: Problem) -> tuple[NDArray[Any], ...]:
    """Columns of one chunk: i_d, i_q, torque, voltage, loss, active, reached, residual."""
    free = replace(problem, region=None)
    state = solve_chunk(free)
    residuals, torque, voltage, losses = residual(free, state)
    again = missed_points(state, residuals)
    if again.size:
        replace_missed_points(free, state, again, residuals)
        residuals, torque, voltage, losses = residual(free, state)
    if problem.region is not None:
        hold_by_data(problem, state, problem.region)
        residuals, torque, voltage, losses = residual(problem, state)
    return state.i_d, state.i_q, torque, voltage, losses, state.active, state.reached, residuals
