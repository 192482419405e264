"""Least-loss phase currents of many operating points: closed forms where nothing binds,
else quadratic programmes.

Measured on 360 angles, per binding point: DAQP (dual active set, dense) 0.2 to 1.1 ms on the 60 or
120 unknowns of a symmetric machine, where PIQP takes 2 to 6 ms, OSQP 3 to 12 ms, Clarabel 4 to 9
ms; on the 360 or 720 unknowns of a machine without symmetry PIQP (interior point, sparse) 6 to 16
ms, where OSQP takes 21 to 45 ms, Clarabel 20 to 50 ms and DAQP 50 to 210 ms. OSQP started from the
solution of the speed before, in pairs of runs: 5 to 29 times as long as DAQP, 4 to 21 times as
long as PIQP. So it is the second opinion, and solves no design.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.linear_programme import least_cost
from dqforge.optimizer.waveforms.constraint_rows import (
    DENSE_UNKNOWNS,
    LIMITS,
    UNBOUNDED,
    PointProblem,
    WaveformLimits,
    WaveformProblem,
    make_problem,
)

Status = Literal["closed form", "solved", "infeasible"]


BoolArray = NDArray[np.bool_]


_BINDING = 1e-6


_EQUALITY = 5  # a row whose bounds are equal, for DAQP


def complementarity(point: PointProblem, rows: FloatArray, multipliers: FloatArray) -> float:
    """Largest product of a multiplier, positive at an upper bound, and the room that
    its row leaves; shapes (m,).
    """
    at_upper, at_lower = multipliers > 0.0, multipliers < 0.0
    room = np.where(at_upper, point.upper - rows, np.where(at_lower, rows - point.lower, 0.0))
    return float(np.max(np.abs(multipliers * room)))


@dataclass(frozen=True, slots=True)
class WaveformSolutions:
    """Phase currents of least copper loss at K operating points.

    ``torque`` in N m and ``omega_m`` in rad/s, shape (K,); ``currents`` in A, shape (K, 3, N), NaN
    where infeasible; ``copper`` in W, shape (K,). ``status`` says how each was found; ``binding``
    tells for each of `LIMITS` whether it binds, shape (K, 5). ``violation`` is the largest
    violation of a limit in its own scale (dc link, current limit, the torque of the current limit,
    slew rate), ``stationarity`` the largest component of the Lagrangian's gradient over the current
    limit, and ``complementarity`` the largest product of a multiplier and the room that its row
    leaves; all shape (K,).
    """

    torque: FloatArray
    omega_m: FloatArray
    currents: FloatArray
    copper: FloatArray
    status: tuple[Status, ...]
    binding: BoolArray
    violation: FloatArray
    stationarity: FloatArray
    complementarity: FloatArray

    @property
    def feasible(self) -> BoolArray:
        """Where there are currents, shape (K,)."""
        return np.array([status != "infeasible" for status in self.status], dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class Obstacle:
    """What would have to give at a point that cannot be had.

    None where changing that alone does not help.

    ``v_dc`` in V is the least dc-link voltage, ``i_max`` in A the least current limit, ``torque``
    in N m the largest torque (of the sign asked for) at the speed, each with all other limits as
    they are.
    """

    v_dc: float | None
    i_max: float | None
    torque: float | None

    @property
    def text(self) -> str:
        """The same as a sentence."""
        parts = []
        if self.v_dc is not None:
            parts.append(f"a dc link of {self.v_dc:.4g} V")
        if self.i_max is not None:
            parts.append(f"a current limit of {self.i_max:.4g} A")
        if self.torque is not None:
            parts.append(f"a torque of {self.torque:.4g} N m")
        if not parts:
            return (
                "no change of the dc link, the current limit or the torque alone makes it possible"
            )
        return f"it would take {' or '.join(parts)}"


def solve_waveforms(
    machine: PhaseMachine, torque: ArrayLike, omega_m: ArrayLike, limits: WaveformLimits
) -> WaveformSolutions:
    """Phase currents of least copper loss.

    Args:
        machine: The machine; its symmetry decides how large the problem is.
        torque, omega_m: Torques in N m and mechanical speeds in rad/s, any sign, broadcast together
            to K points.
        limits: What the currents keep.

    Raises:
        InputError: A number is not finite.
        NoSolutionError: Constant torque cannot be made at some angle, whatever the limits.
    """
    torque, omega_m = np.broadcast_arrays(
        np.asarray(torque, dtype=np.float64), np.asarray(omega_m, dtype=np.float64)
    )
    torque, omega_m = torque.ravel(), omega_m.ravel()
    if not (np.all(np.isfinite(torque)) and np.all(np.isfinite(omega_m))):
        raise InputError("torque and speed must be finite; got nan or inf")
    problem = make_problem(machine, limits)
    omega_e = machine.pole_pairs * omega_m
    z = np.zeros((torque.size, problem.unknowns))
    free = _keeps_all(problem, torque, omega_e) & (limits.ripple == 0.0)
    status: list[Status] = ["closed form" if found else "infeasible" for found in free]
    stationarity, products = np.zeros(torque.size), np.zeros(torque.size)
    solver = _Dense(problem) if problem.unknowns <= DENSE_UNKNOWNS else _Sparse(problem)
    for k in np.flatnonzero(~free):
        found = solver.solve(problem.point(float(torque[k]), float(omega_e[k])))
        if found is not None:
            z[k], stationarity[k], products[k] = found
            status[k] = "solved"
    currents = problem.currents(torque, z)
    rows = _rows(problem, z, torque, omega_e)
    infeasible = np.array([name == "infeasible" for name in status], dtype=np.bool_)
    lower, upper = problem.bounds(omega_e)
    over = np.maximum(rows - upper, lower - rows)
    currents[infeasible] = np.nan
    return WaveformSolutions(
        torque=torque,
        omega_m=omega_m,
        currents=currents,
        copper=machine.copper_loss(currents),
        status=tuple(status),
        binding=_binding(problem, over) & ~infeasible[:, np.newaxis],
        violation=np.where(infeasible, np.nan, np.maximum(np.max(over, axis=1), 0.0)),
        stationarity=np.where(infeasible, np.nan, stationarity),
        complementarity=np.where(infeasible, np.nan, products),
    )


def _rows(
    problem: WaveformProblem, z: FloatArray, torque: FloatArray, omega_e: FloatArray
) -> FloatArray:
    """Rows of all points, shape (K, m)."""
    still, moving = (problem.still @ z.T).T, (problem.moving @ z.T).T
    by_torque = (
        problem.still_unit + omega_e[:, np.newaxis] * problem.moving_unit - problem.torque_share
    )
    emf = omega_e[:, np.newaxis] * problem.emf
    return np.asarray(
        still + omega_e[:, np.newaxis] * moving + torque[:, np.newaxis] * by_torque + emf
    )


def _keeps_all(problem: WaveformProblem, torque: FloatArray, omega_e: FloatArray) -> BoolArray:
    """Whether the currents of least size keep every limit, shape (K,)."""
    rows = _rows(problem, np.zeros((torque.size, problem.unknowns)), torque, omega_e)
    lower, upper = problem.bounds(omega_e)
    return np.asarray(np.all((rows <= upper) & (rows >= lower), axis=1))


def _binding(problem: WaveformProblem, over: FloatArray) -> BoolArray:
    """For each kind of limit whether some row of it is at its bound, shape (K, 5)."""
    at_bound = over >= -_BINDING
    return np.stack(
        [np.any(at_bound & (problem.kinds == kind), axis=1) for kind in range(len(LIMITS))], axis=1
    )


def _optimality(point: PointProblem, z: FloatArray, multipliers: FloatArray) -> tuple[float, float]:
    """Stationarity and complementarity of a primal and dual pair."""
    gradient = z + point.gradient + np.asarray(point.matrix.T @ multipliers)
    return float(np.max(np.abs(gradient))), complementarity(
        point, np.asarray(point.matrix @ z), multipliers
    )


class _Dense:
    """DAQP: a dual active-set method, exact to rounding, fastest for few unknowns."""

    def __init__(self, problem: WaveformProblem) -> None:
        self.hessian = np.eye(problem.unknowns)
        self.sense = np.where(problem.kinds < 0, _EQUALITY, 0).astype(np.int32)

    def solve(self, point: PointProblem) -> tuple[FloatArray, float, float] | None:
        """Unknowns, stationarity and complementarity, or None where there is no solution."""
        import daqp

        z, _, code, info = daqp.solve(
            self.hessian,
            point.gradient,
            np.ascontiguousarray(point.matrix),
            point.upper,
            point.lower,
            self.sense,
            primal_tol=1e-9,
            dual_tol=1e-11,
        )
        if code <= 0:
            return None
        return z, *_optimality(point, z, info["lam"])


class _Sparse:
    """PIQP: an interior-point method on sparse matrices, for machines without symmetry."""

    def __init__(self, problem: WaveformProblem) -> None:
        from scipy.sparse import identity

        self.hessian = identity(problem.unknowns, format="csc")

    def solve(self, point: PointProblem) -> tuple[FloatArray, float, float] | None:
        """Unknowns, stationarity and complementarity, or None where there is no solution."""
        result = _interior_point(
            self.hessian, point.gradient, point.matrix, point.lower, point.upper
        )
        if result is None:
            return None
        z, multipliers = result
        return z, *_optimality(point, z, multipliers)


def _interior_point(
    hessian: Any, gradient: FloatArray, matrix: Any, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Minimum of x'Hx/2 + g'x for lower <= A x <= upper with sparse matrices,
    and the multipliers of the rows.

    None where there is none, or where it is not found.
    """
    import piqp

    solver = piqp.SparseSolver()
    solver.settings.eps_abs = 1e-9
    solver.settings.eps_rel = 1e-10
    solver.settings.max_iter = 300
    equal = lower == upper
    rows, fixed = matrix[~equal], matrix[equal]
    solver.setup(hessian, gradient, fixed, upper[equal], rows, lower[~equal], upper[~equal])
    if solver.solve() != piqp.PIQP_SOLVED:
        return None
    multipliers = np.zeros(lower.size)
    multipliers[~equal] = solver.result.z_u - solver.result.z_l
    multipliers[equal] = solver.result.y
    return np.array(solver.result.x), multipliers


def obstacle(
    machine: PhaseMachine, torque: float, omega_m: float, limits: WaveformLimits
) -> Obstacle:
    """What would have to give so that a point can be had: three linear programmes.

    Raises:
        NoSolutionError: Constant torque cannot be made at some angle, whatever the limits.
    """
    problem = make_problem(machine, limits)
    omega_e = machine.pole_pairs * omega_m
    sign = -1.0 if torque < 0.0 else 1.0
    none = np.zeros(problem.lower.size)
    stretch = [_least_stretch(problem, torque, omega_e, kind) for kind in (0, 1)]
    # A torque as unknown: T = sign * extra, as large as possible.
    most = _with_extra(
        problem,
        omega_e,
        problem.offset(0.0, omega_e),
        sign * problem.by_torque(omega_e),
        none,
        least=False,
    )
    v_dc, i_max = (
        None if share is None else share * limit
        for share, limit in zip(stretch, (limits.v_dc, limits.i_max), strict=True)
    )
    return Obstacle(
        v_dc=v_dc, i_max=i_max, torque=None if most is None or most <= 0.0 else sign * most
    )


def _least_stretch(
    problem: WaveformProblem, torque: float, omega_e: float, kind: int
) -> float | None:
    """Least factor on the bounds of one kind that makes the point possible, or None."""
    chosen = (problem.kinds == kind).astype(np.float64)
    return _with_extra(
        problem, omega_e, problem.offset(torque, omega_e), np.zeros(chosen.size), chosen, least=True
    )


def _with_extra(
    problem: WaveformProblem,
    omega_e: float,
    offset: FloatArray,
    column: FloatArray,
    chosen: FloatArray,
    *,
    least: bool,
) -> float | None:
    """Least or largest extra unknown s with lower <= A z + column s + offset <= upper,
    the chosen bounds times s.
    """
    from scipy.sparse import csr_matrix, hstack, vstack

    matrix = csr_matrix(problem.still + omega_e * problem.moving)
    kept = 1.0 - chosen
    lower, upper = problem.bounds(omega_e)
    above, below = upper < UNBOUNDED, lower > -UNBOUNDED
    high, low = np.where(above, upper, 0.0), np.where(below, lower, 0.0)
    rows = vstack(
        [
            hstack([matrix, csr_matrix((column - high * chosen)[:, np.newaxis])]).tocsr()[above],
            hstack([-matrix, csr_matrix((low * chosen - column)[:, np.newaxis])]).tocsr()[below],
        ]
    )
    bounds = np.concatenate([(high * kept - offset)[above], (offset - low * kept)[below]])
    slope = np.zeros(problem.unknowns + 1)
    slope[-1] = 1.0 if least else -1.0
    found = least_cost(slope, rows, bounds)
    return None if found is None else float(found[-1])


def require_solution(
    machine: PhaseMachine, solutions: WaveformSolutions, limits: WaveformLimits
) -> None:
    """Refuse points that cannot be had, naming the first and what would have to give.

    Raises:
        NoSolutionError: Some point has no currents.
    """
    missing = np.flatnonzero(~solutions.feasible)
    if missing.size == 0:
        return
    torque, omega_m = float(solutions.torque[missing[0]]), float(solutions.omega_m[missing[0]])
    reason = obstacle(machine, torque, omega_m, limits).text
    raise NoSolutionError(
        f"no phase currents make {torque:.4g} N m at {in_rpm(omega_m):.4g} rpm within "
        f"{limits.v_dc:.4g} V ({limits.topology}) and {limits.i_max:.4g} A: {reason}"
    )


# A second opinion on quadratic programmes of phase currents: OSQP on the same problem, judged by
# its own KKT pair.
#
# OSQP is an operator-splitting method with its own scaling; nothing is shared with DAQP and PIQP
# but the problem's data. Residuals are computed here from the primal and dual values that it
# returns, not taken from its report.

# Largest residual, and largest relative difference of the loss, at which two solutions count as
# one.
Verdict = Literal["confirmed", "confirmed infeasible", "differs"]
AGREEMENT = 1e-6

# The step size adapts after fixed numbers of iterations, not by the clock:
# the same input gives the same bytes.
_SETTINGS: dict[str, Any] = {
    "eps_abs": 1e-9,
    "eps_rel": 1e-9,
    "eps_prim_inf": 1e-5,
    "max_iter": 20_000,
    "polish_refine_iter": 10,
    "adaptive_rho": 1,
    "adaptive_rho_interval": 50,
    "verbose": False,
}


@dataclass(frozen=True, slots=True)
class Residuals:
    """How far a primal and dual pair is from the optimality conditions.

    ``violation``: largest violation of a limit in its own scale; ``stationarity``: largest
    component of the Lagrangian's gradient over the current limit; ``complementarity``: largest
    product of a multiplier and the room that its row leaves. NaN where there is no solution.
    """

    violation: float
    stationarity: float
    complementarity: float

    @property
    def largest(self) -> float:
        """The largest of the three; NaN if one of them is."""
        return float(np.max([self.violation, self.stationarity, self.complementarity]))


@dataclass(frozen=True, slots=True)
class Confirmation:
    """One programme solved twice.

    Args:
        torque, omega_m: Torque in N m and mechanical speed in rad/s.
        ripple: Permitted deviation of the torque in N m.
        ours, theirs: Residuals of DAQP or PIQP (of the closed form where nothing binds), and of
            OSQP.
        loss_difference: Copper loss of OSQP's currents over ours, less one; NaN without currents.
        current_difference: Largest difference of a phase current in A; NaN without currents.
        iterations: Iterations of OSQP.
        verdict: ``confirmed``: both are optimal within `AGREEMENT` and lose the same; ``confirmed
            infeasible``: OSQP's certificate proves that there are no currents either; ``differs``:
            neither.
    """

    torque: float
    omega_m: float
    ripple: float
    ours: Residuals
    theirs: Residuals
    loss_difference: float
    current_difference: float
    iterations: int
    verdict: Verdict


def confirm_waveforms(
    machine: PhaseMachine, solutions: WaveformSolutions, limits: WaveformLimits
) -> tuple[Confirmation, ...]:
    """Solve the programme of each of K points again with OSQP.

    Raises:
        InputError: OSQP is not installed.
        NoSolutionError: Constant torque cannot be made at some angle, whatever the limits.
    """
    problem = make_problem(machine, limits)
    found = []
    for k, (torque, omega_m) in enumerate(
        zip(solutions.torque.tolist(), solutions.omega_m.tolist(), strict=True)
    ):
        point = problem.point(torque, machine.pole_pairs * omega_m)
        # Without any active row there is nothing to polish, and OSQP says so on standard
        # output whatever it is told.
        z, duals, iterations, proof = _solve(point, polishing=solutions.status[k] != "closed form")
        ours = Residuals(*(float(values[k]) for values in _ours(solutions)))
        theirs = _residuals(point, z, duals)
        loss = current = np.nan
        if solutions.feasible[k]:
            currents = problem.currents(np.array([torque]), z[np.newaxis])[0]
            copper = float(machine.copper_loss(currents))
            loss = (
                copper / float(solutions.copper[k]) - 1.0 if solutions.copper[k] > 0.0 else copper
            )
            current = float(np.max(np.abs(currents - solutions.currents[k])))
            agrees = max(ours.largest, theirs.largest, abs(loss)) <= AGREEMENT
            verdict: Verdict = "confirmed" if agrees else "differs"
        else:
            theirs = Residuals(np.nan, np.nan, np.nan)
            verdict = (
                "confirmed infeasible" if proof is not None and _proves(point, proof) else "differs"
            )
        found.append(
            Confirmation(
                torque, omega_m, limits.ripple, ours, theirs, loss, current, iterations, verdict
            )
        )
    return tuple(found)


def _ours(solutions: WaveformSolutions) -> tuple[FloatArray, FloatArray, FloatArray]:
    return solutions.violation, solutions.stationarity, solutions.complementarity


def _solve(
    point: PointProblem, *, polishing: bool
) -> tuple[FloatArray, FloatArray, int, FloatArray | None]:
    """Unknowns, multipliers of the rows, iterations, and a ray of multipliers
    where OSQP finds no solution.
    """
    from scipy.sparse import csc_matrix, identity

    try:
        import osqp
    except ImportError as error:
        raise InputError(
            "confirming phase currents needs osqp; install it with: pip install osqp"
        ) from error
    solver = osqp.OSQP()
    size = point.gradient.size
    matrix = csc_matrix(point.matrix)
    settings = _SETTINGS | {"polishing": polishing}
    solver.setup(
        identity(size, format="csc"), point.gradient, matrix, point.lower, point.upper, **settings
    )
    result = solver.solve(raise_error=False)
    if "primal infeasible" in result.info.status:
        return (
            np.zeros(size),
            np.zeros(point.lower.size),
            int(result.info.iter),
            np.array(result.prim_inf_cert),
        )
    return np.array(result.x), np.array(result.y), int(result.info.iter), None


def _residuals(point: PointProblem, z: FloatArray, duals: FloatArray) -> Residuals:
    rows = np.asarray(point.matrix @ z)
    over = np.maximum(rows - point.upper, point.lower - rows)
    gradient = z + point.gradient + np.asarray(point.matrix.T @ duals)
    return Residuals(
        max(float(np.max(over)), 0.0),
        float(np.max(np.abs(gradient))),
        complementarity(point, rows, duals),
    )


def _proves(point: PointProblem, ray: FloatArray) -> bool:
    """Whether multipliers prove that no unknowns keep the rows: A'y = 0 while
    u'y+ - l'y- < 0 (Farkas).

    The remainder of A'y is harmless as long as unknowns of ten times the current
    limit could not make it up.
    """
    ray = ray / np.max(np.abs(ray))
    above, below = np.maximum(ray, 0.0), np.maximum(-ray, 0.0)
    above[point.upper > UNBOUNDED], below[point.lower < -UNBOUNDED] = 0.0, 0.0
    support = float(np.sum(above * np.where(above > 0.0, point.upper, 0.0)))
    support -= float(np.sum(below * np.where(below > 0.0, point.lower, 0.0)))
    remainder = float(np.sum(np.abs(point.matrix.T @ (above - below))))
    return support + 10.0 * remainder < 0.0
