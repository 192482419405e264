"""Points per second of the batched solver, its growth, its memory, and the same
points one by one with SciPy.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from peak_memory import run_and_measure
from scipy.optimize import minimize

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine, complete_by_symmetry
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import optimal_points

pytestmark = pytest.mark.benchmark

V_MAX = 460.0 * np.sqrt(2.0 / 3.0)


@pytest.fixture(scope="module")
def baldor(shared_data: Path) -> SaturatedMachine:
    data = np.load(shared_data / "fluxmaps" / "baldor_400rpm_map.npz")
    current, flux = data["i_s_dq"], data["psi_s_dq"]
    i_q, psi_d, psi_q = complete_by_symmetry(current.imag[0], flux.real, flux.imag)
    return SaturatedMachine(2, 0.63, FluxMap(current.real[:, 0].copy(), i_q, psi_d, psi_q), 19.5)


def scipy_point(
    machine: SaturatedMachine, torque: float, omega_m: float, start: tuple[float, float]
) -> float:
    """Least |i|^2 of one point by SLSQP with a start near the solution, which the
    batched solver does not need.
    """
    omega = machine.pole_pairs * omega_m

    def flux(i: FloatArray) -> tuple[float, float]:
        psi_d, psi_q = machine.flux(np.array([i[0]]), np.array([i[1]]))
        return float(psi_d[0]), float(psi_q[0])

    def gap(i: FloatArray) -> float:
        psi_d, psi_q = flux(i)
        return float(3.0 * (psi_d * i[1] - psi_q * i[0]) - torque) / 10.0

    def volts(i: FloatArray) -> float:
        psi_d, psi_q = flux(i)
        v_d, v_q = machine.r_s * i[0] - omega * psi_q, machine.r_s * i[1] + omega * psi_d
        return float(1.0 - (v_d**2 + v_q**2) / V_MAX**2)

    rules = [
        {"type": "eq", "fun": gap},
        {"type": "ineq", "fun": volts},
        {"type": "ineq", "fun": lambda i: 1.0 - (i[0] ** 2 + i[1] ** 2) / machine.i_max**2},
    ]
    outcome = minimize(
        lambda i: (i[0] ** 2 + i[1] ** 2) / 100.0, start, method="SLSQP", constraints=rules
    )
    return 100.0 * float(outcome.fun)


def test_map_of_a_measured_machine_against_scipy(baldor: SaturatedMachine) -> None:
    most = float(mtpa_locus(baldor, baldor.i_max).torque[-1])
    torque, omega = np.meshgrid(np.linspace(-1.1, 1.1, 200) * most, np.linspace(-800.0, 800.0, 200))
    start = time.perf_counter()
    points = optimal_points(baldor, torque, omega, v_max=V_MAX)
    batched = torque.size / (time.perf_counter() - start)
    chosen = np.random.default_rng(1).choice(np.flatnonzero(points.reached), 40, replace=False)
    start = time.perf_counter()
    squares = [
        scipy_point(
            baldor,
            points.torque[k],
            points.omega_m[k],
            (0.9 * float(points.i_d[k]) - 0.1, 1.1 * float(points.i_q[k])),
        )
        for k in chosen
    ]
    single = chosen.size / (time.perf_counter() - start)
    ours = points.i_d[chosen] ** 2 + points.i_q[chosen] ** 2
    agree = int(np.count_nonzero(np.abs(np.array(squares) / ours - 1.0) < 1e-3))
    worst = float(np.max(points.kkt_residual))
    print(f"\n200 x 200 map: {batched:,.0f} points/s, residual {worst:.1e}")
    print(
        f"SLSQP point by point: {single:,.0f} points/s; the map is {batched / single:,.0f} times "
        "as fast"
    )
    print(f"{agree} of {chosen.size} of its points agree to 0.1 % in loss")
    assert worst < 1e-8


def test_time_grows_linearly(baldor: SaturatedMachine) -> None:
    counts, seconds = (1_000, 10_000, 100_000, 1_000_000), []
    for count in counts:
        generator = np.random.default_rng(2)
        torque = generator.uniform(-60.0, 60.0, count)
        omega = generator.choice(np.linspace(-800.0, 800.0, 201), count)
        start = time.perf_counter()
        optimal_points(baldor, torque, omega, v_max=V_MAX)
        seconds.append(time.perf_counter() - start)
    slope = np.polyfit(np.log(counts), np.log(seconds), 1)[0]
    last = np.log(seconds[-1] / seconds[-2]) / np.log(counts[-1] / counts[-2])
    print("\n" + ", ".join(f"{n:,}: {s:.3f} s" for n, s in zip(counts, seconds, strict=True)))
    print(
        f"log-log slope {slope:.2f} over all, {last:.2f} over the last decade (below 1: the scan "
        "of the 201 speeds)"
    )


def test_every_point_with_a_speed_of_its_own(baldor: SaturatedMachine) -> None:
    """The slowest case: the scan of the feasible region is made anew for every
    point beyond the base speed.
    """
    generator = np.random.default_rng(3)
    torque, omega = generator.uniform(-60.0, 60.0, 30_000), generator.uniform(-800.0, 800.0, 30_000)
    start = time.perf_counter()
    points = optimal_points(baldor, torque, omega, v_max=V_MAX)
    rate = torque.size / (time.perf_counter() - start)
    worst = float(np.max(points.kkt_residual))
    print(
        f"\n30,000 points, each at a speed of its own: {rate:,.0f} points/s, residual {worst:.1e}"
    )


def test_memory_of_a_million_points() -> None:
    """Peak memory of a fresh process that solves a million points of a linear machine."""
    program = (
        "import numpy as np\n"
        "from dqforge.machines.dq_machines.synchronous import LinearMachine\n"
        "from dqforge.optimizer.operating_points.points import optimal_points\n"
        "g = np.random.default_rng(0)\n"
        "m = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0)\n"
        "t, w = g.uniform(-250, 250, 10**6), g.choice(np.linspace(-900, 900, 201), 10**6)\n"
        "p = optimal_points(m, t, w, v_max=288.0)\n"
    )
    mebibytes = run_and_measure(program)[1] / 2.0**20
    print(f"\npeak memory of a million points: {mebibytes:.0f} MiB")
    assert mebibytes < 1024.0
