"""MTPA against the quartic in high precision, against brute force, IPOPT and
another tool's printed points.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import casadi as ca
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.operating_points import mtpa_locus as mtpa
from dqforge.optimizer.operating_points.current_choice import CurrentChoice


def quartic_root(torque: float) -> tuple[float, float]:
    """i_d and i_q of paper 000 (19), written out as a quartic, from mpmath's
    polynomial roots at 60 digits.
    """
    with mpmath.workdps(60):
        t = mpmath.mpf(torque)
        roots = mpmath.polyroots([-t * t, -8, 12, -6, 1], maxsteps=500, extraprec=400, asc=True)
        i_d = next(root.real for root in roots if abs(root.imag) < 1e-40 and root.real < 0)
        return float(i_d), float(t / (2 - i_d))


@pytest.mark.parametrize("torque", [1e-6, 1e-3, 0.1, 0.7, 1.0, 2.5, 5.0, 40.0, 1e4])
def test_per_unit_curve_equals_the_quartic_to_rounding(torque: float) -> None:
    i_d, i_q = mtpa.mtpa_per_unit(np.array([torque]))
    expected_d, expected_q = quartic_root(torque)
    assert i_d[0] == pytest.approx(expected_d, rel=1e-14)
    assert i_q[0] == pytest.approx(expected_q, rel=1e-15)


def test_zero_torque_takes_no_current_and_signs_follow_the_torque() -> None:
    i_d, i_q = mtpa.mtpa_per_unit(np.array([0.0, -2.0, 2.0]))
    assert i_d[0] == 0.0
    assert i_q[0] == 0.0
    assert i_d[1] == i_d[2] < 0.0
    assert i_q[1] == -i_q[2]


machines = st.builds(
    LinearMachine,
    pole_pairs=st.integers(1, 20),
    r_s=st.just(0.1),
    l_d=st.floats(1e-6, 0.1),
    l_q=st.floats(1e-6, 0.1),
    psi_pm=st.floats(1e-4, 2.0),
    i_max=st.floats(0.1, 1000.0),
)


def chosen(machine: LinearMachine) -> CurrentChoice:
    return CurrentChoice(machine, "mtpa", machine.i_max)


@settings(max_examples=200, deadline=None)
@given(machine=machines, fraction=st.floats(-1.0, 1.0))
def test_no_point_of_a_dense_scan_gives_more_torque_per_ampere(
    machine: LinearMachine, fraction: float
) -> None:
    most = chosen(machine).largest_torque()
    point = chosen(machine).points(np.array([fraction * most]))
    current = np.hypot(point.i_d, point.i_q)
    angle = np.linspace(0.0, 2.0 * np.pi, 7201)
    scan = machine.torque(current * np.cos(angle), current * np.sin(angle))
    assert np.max(np.abs(scan)) <= abs(point.torque[0]) * (1.0 + 1e-9) + 1e-300
    assert abs(point.torque_residual[0]) < 1e-12
    assert abs(point.stationarity[0]) < 1e-9
    assert not point.limited[0]


def test_dense_scan_is_attained(ipm100: LinearMachine) -> None:
    """The scan's best angle approaches the solution from below: a wrong optimum
    would be beaten or never met.
    """
    i_d, i_q = mtpa.mtpa_at_current(ipm100, np.array([200.0]))
    angle = np.linspace(np.pi / 2, np.pi, 200_001)
    scan = ipm100.torque(200.0 * np.cos(angle), 200.0 * np.sin(angle))
    best = int(np.argmax(scan))
    assert ipm100.torque(i_d, i_q)[0] == pytest.approx(scan[best], rel=1e-9)
    assert i_d[0] == pytest.approx(200.0 * np.cos(angle[best]), abs=0.01)


@pytest.mark.parametrize(
    "machine",
    [
        LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0),
        LinearMachine(3, 2.35, 1.61e-3, 1.74e-3, 0.06, 2.3),
        LinearMachine(3, 0.1, 2e-3, 1e-3, 0.1, 50.0),
        LinearMachine(3, 0.1, 1e-3, 1e-3, 0.1, 50.0),
        LinearMachine(2, 0.54, 41.5e-3, 6.2e-3, 0.0, 22.0),
        LinearMachine(2, 0.54, 6.2e-3, 41.5e-3, 0.0, 22.0),
    ],
    ids=["ipm", "nearly-surface", "l_d>l_q", "surface", "reluctance", "reluctance-q"],
)
def test_ipopt_finds_the_same_currents(machine: LinearMachine) -> None:
    torque = 0.8 * chosen(machine).largest_torque()
    i_d, i_q = ca.SX.sym("i_d"), ca.SX.sym("i_q")
    air_gap = 1.5 * machine.pole_pairs * (machine.psi_pm + (machine.l_d - machine.l_q) * i_d) * i_q
    problem = {
        "x": ca.vertcat(i_d, i_q),
        "f": (i_d**2 + i_q**2) / machine.i_max**2,
        "g": air_gap / torque,
    }
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.tol": 1e-12}
    solver = ca.nlpsol("mtpa", "ipopt", problem, options)
    start_d = -np.sign(machine.saliency) * 0.3 * machine.i_max
    solution = np.asarray(solver(x0=[start_d, 0.5 * machine.i_max], lbg=1.0, ubg=1.0)["x"]).ravel()
    point = chosen(machine).points(np.array([torque]))
    np.testing.assert_allclose([point.i_d[0], point.i_q[0]], solution, atol=1e-6 * machine.i_max)


def test_points_printed_by_another_tool(shared_data: Path) -> None:
    """MTPA points of the ABB 2.2 kW machine, printed by another tool and equal to
    brute force (its README).
    """
    machine = LinearMachine(3, 3.6, 0.036, 0.051, 0.545, 10.0)
    with (shared_data / "params" / "motulator_oracle_mtpa_mtpv.csv").open() as stream:
        rows = [
            row
            for row in csv.DictReader(stream)
            if row["machine"] == "ABB_2kW" and row["kind"] == "MTPA"
        ]
    assert len(rows) >= 4
    level = np.array([float(row["level_A_or_Vs"]) for row in rows])
    i_d, i_q = mtpa.mtpa_at_current(machine, level)
    np.testing.assert_allclose(i_d, [float(row["id_brute"]) for row in rows], atol=5e-5)
    np.testing.assert_allclose(i_q, [float(row["iq_brute"]) for row in rows], atol=5e-5)
    np.testing.assert_allclose(
        machine.torque(i_d, i_q), [float(row["T_brute"]) for row in rows], rtol=2e-6
    )


def test_current_limit_returns_the_largest_torque_and_says_so(ipm100: LinearMachine) -> None:
    point = chosen(ipm100).points(np.array([-1e4, 100.0, 1e4]))
    np.testing.assert_array_equal(point.limited, [True, False, True])
    np.testing.assert_allclose(np.hypot(point.i_d, point.i_q)[[0, 2]], 283.0, rtol=1e-12)
    assert point.torque[2] == -point.torque[0] == pytest.approx(chosen(ipm100).largest_torque())


def test_id0_draws_paper_000_current(ipm100: LinearMachine) -> None:
    """206.54 A at 130 N m: i_q = 2 T / (3 p psi_pm) by hand."""
    point = CurrentChoice(ipm100, "id0", ipm100.i_max).points(np.array([130.0]))
    assert point.i_d[0] == 0.0
    assert point.i_q[0] == pytest.approx(2.0 * 130.0 / (3.0 * 4.0 * 0.1049), rel=1e-14)


def test_base_values_of_paper_000(ipm100: LinearMachine) -> None:
    base = mtpa.per_unit_base(ipm100)
    assert base.current == pytest.approx(216.7355, rel=1e-6)  # 0.1049 / (2 * 242e-6)
    assert base.torque == pytest.approx(68.2067, rel=1e-5)  # 0.75 * 4 * 0.1049 * 216.7355


def test_refusals_name_the_reason(ipm100: LinearMachine) -> None:
    with pytest.raises(InputError, match="neither magnet flux nor saliency"):
        mtpa.mtpa_currents(replace(ipm100, psi_pm=0.0, l_q=ipm100.l_d), np.array([1.0]))
    with pytest.raises(InputError, match="strategy id0 needs magnet flux"):
        mtpa.id0_currents(replace(ipm100, psi_pm=0.0), np.array([1.0]))
    with pytest.raises(InputError, match="must be finite"):
        chosen(ipm100).points(np.array([np.nan]))
    with pytest.raises(InputError, match="straight line"):
        mtpa.per_unit_base(replace(ipm100, l_q=ipm100.l_d))
    with pytest.raises(NoSolutionError, match=r"283 A \(peak\) give at most"):
        chosen(ipm100).require(1000.0, "fit.max_torque")


def test_a_given_limit_replaces_that_of_the_machine(ipm100: LinearMachine) -> None:
    """At i_d = 0 the largest torque is 3/2 p psi_pm i_max = 0.6294 N m/A times 100 A."""
    points = CurrentChoice(ipm100, "id0", 100.0).points(np.array([60.0, 70.0]))
    assert points.limited.tolist() == [False, True]
    assert points.torque.tolist() == pytest.approx([60.0, 62.94])
