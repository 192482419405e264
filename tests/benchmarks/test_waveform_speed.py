"""Constrained phase currents beside a conic formulation that is built and solved for each point,
in one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms import solver as programmes
from dqforge.optimizer.waveforms.constraint_rows import (
    DENSE_UNKNOWNS,
    PointProblem,
    WaveformLimits,
    make_problem,
)
from dqforge.optimizer.waveforms.solver import solve_waveforms

pytestmark = pytest.mark.benchmark
POINTS = 100
BY_CVXPY = 6
LIMITS = WaveformLimits(130.0, "three-wire", 14.0)


def machine(*, symmetric: bool) -> PhaseMachine:
    size = np.array([0.2, 0.036, 0.012, 0.006])
    lag = np.array([0.0, 0.0, np.pi, 0.0])
    amplitudes = size if symmetric else np.stack([size, 0.97 * size, 1.01 * size])
    phases = (
        lag
        if symmetric
        else np.stack([lag + np.array([1, 3, 5, 7]) * 2.0 * np.pi / 3.0 * k for k in range(3)])
    )
    return PhaseMachine.from_harmonics(
        [1, 3, 5, 7], amplitudes, phases, pole_pairs=2, r_s=1.0, l_s=8e-3, m_s=-1e-3, i_max=14.0
    )


def built_anew(drive: PhaseMachine, torque: float, omega_m: float) -> float:
    """The problem as it is written on paper, over 360 angles and 3 phases."""
    count, omega = drive.angles, drive.pole_pairs * omega_m
    shifts = (-1, 0, 1, 2)
    mean, change = (
        sum(
            weight * np.roll(np.eye(count), offset, axis=0)
            for offset, weight in zip(shifts, weights, strict=True)
        )
        for weights in ((-1 / 16, 9 / 16, 9 / 16, -1 / 16), (1 / 24, -27 / 24, 27 / 24, -1 / 24))
    )
    i: Any = cp.Variable((3, count))
    slope = i @ (change * (count / (2.0 * np.pi)))
    v = drive.r_s * (i @ mean) + omega * (drive.inductances @ slope + drive.flux @ mean)
    pairs = cp.vstack([v[0] - v[1], v[1] - v[2], v[2] - v[0]])
    keeps = [
        drive.pole_pairs * cp.sum(cp.multiply(drive.flux, i), axis=0) == torque,
        cp.sum(i, axis=0) == 0,
        cp.abs(i) <= LIMITS.i_max,
        cp.abs(pairs) <= LIMITS.v_dc,
    ]
    programme = cp.Problem(cp.Minimize(drive.r_s * cp.sum_squares(i) / count), keeps)
    programme.solve(solver="CLARABEL")
    return float(programme.value)


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


@pytest.mark.parametrize(
    "symmetric", [True, False], ids=["a sixth of the period", "the whole period"]
)
def test_sweep_of_operating_points(*, symmetric: bool, capsys: pytest.CaptureFixture[str]) -> None:
    drive = machine(symmetric=symmetric)
    generator = np.random.default_rng(3)
    torque: FloatArray = generator.uniform(3.0, 4.5, POINTS)
    omega: FloatArray = generator.uniform(165.0, 190.0, POINTS)
    seconds, found = timed(lambda: solve_waveforms(drive, torque, omega, LIMITS))
    binding = found.status.count("solved")
    assert binding > 0.9 * POINTS
    theirs = 0.0
    for k in range(BY_CVXPY):
        spent, copper = timed(partial(built_anew, drive, float(torque[k]), float(omega[k])))
        theirs += spent / BY_CVXPY
        assert found.copper[k] == pytest.approx(copper, rel=1e-5)
    with capsys.disabled():
        print(
            "\n"
            f"{POINTS} points x 360 angles x 3 phases, {binding} binding: {seconds * 1e3:.0f} ms, "
            f"{theirs * POINTS / seconds:.0f} times faster than building and solving each with "
            "cvxpy and Clarabel"
        )


SPEEDS = np.linspace(120.0, 190.0, 30)
TORQUES = (3.0, 3.8, 4.3)
PAIRS = 5


def solved_by(solver: Any, points: list[PointProblem]) -> None:
    for point in points:
        solver.solve(point)


def warm_started(points: list[PointProblem]) -> None:
    """OSQP over points one after another, each from the solution of the one before;
    set up anew only where the zeros of the rows are others.
    """
    import osqp
    from scipy.sparse import csc_matrix, identity

    solver: Any = None
    last, found = csc_matrix((0, 0)), (np.zeros(0), np.zeros(0))
    for point in points:
        matrix = csc_matrix(point.matrix)
        matrix.sort_indices()
        if (
            solver is not None
            and matrix.nnz == last.nnz
            and np.array_equal(matrix.indices, last.indices)
        ):
            solver.update(q=point.gradient, l=point.lower, u=point.upper, Ax=matrix.data)
            solver.warm_start(x=found[0], y=found[1])
        else:
            hessian = identity(point.gradient.size, format="csc")
            solver, last = osqp.OSQP(), matrix
            settings = programmes._SETTINGS | {"polishing": True}
            solver.setup(hessian, point.gradient, matrix, point.lower, point.upper, **settings)
        result = solver.solve(raise_error=False)
        found = np.array(result.x), np.array(result.y)


@pytest.mark.parametrize("topology", ["three-wire", "four-leg"])
@pytest.mark.parametrize("symmetric", [True, False], ids=["sixth", "whole"])
def test_osqp_warm_started_over_the_speed(
    topology: Any, *, symmetric: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pairs of runs, one after the other: OSQP is a second opinion, not the solver, as long as it
    is the slower one.
    """
    drive = machine(symmetric=symmetric)
    problem = make_problem(drive, WaveformLimits(130.0, topology, 14.0))
    dense = problem.unknowns <= DENSE_UNKNOWNS
    own = programmes._Dense(problem) if dense else programmes._Sparse(problem)
    for torque in TORQUES:
        omega = drive.pole_pairs * SPEEDS
        bound = ~programmes._keeps_all(problem, np.full(SPEEDS.size, torque), omega)
        points = [problem.point(torque, float(one)) for one in omega[bound]]
        ratios = []
        for _ in range(PAIRS):
            ours, _ = timed(partial(solved_by, own, points))
            theirs, _ = timed(partial(warm_started, points))
            ratios.append(theirs / ours)
        with capsys.disabled():
            print(
                f"\n{topology}, {problem.unknowns} unknowns, {torque} N m: OSQP warm-started takes "
                f"{min(ratios):.1f} to {max(ratios):.1f} times as long",
                end="",
            )
