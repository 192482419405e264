"""A second opinion on quadratic programmes of phase currents: OSQP on the same problem,
judged by its own KKT pair.

OSQP is an operator-splitting method with its own scaling; nothing is shared with DAQP and PIQP but
the problem's data. Residuals are computed here from the primal and dual values that it returns, not
taken from its report.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.waveforms.constraint_rows import (
    UNBOUNDED,
    PointProblem,
    WaveformLimits,
    make_problem,
)
from dqforge.optimizer.waveforms.solver import WaveformSolutions, complementarity

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
