"""What explains a printed number: planted choices are found, and those of the papers hold."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.modulation.ripple import ripple
from dqforge.machines.names import ModulationName
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents, per_unit_base
from dqforge.reports.papers.explanations import (
    Alternative,
    Coefficients,
    Explanation,
    Printed,
    RippleColumn,
    explain,
    explain_coefficients,
    explain_largest_error,
    explain_ripple,
    explain_transients,
    explanation_table,
    plain_explanation,
)
from dqforge.reports.papers.paper000_stated_method import (
    DESIGN_NAME,
    PRINTED_TABLE_1,
    PRINTED_TABLE_2,
    ripple_explained,
)
from dqforge.reports.papers.paper001_bench_sensorless import explain_start
from dqforge.reports.papers.paper001_bench_transients import bench_design
from dqforge.reports.papers.paper001_emitted_control import program_bench

BREAKPOINTS = {degree: row[:2] for degree, row in PRINTED_TABLE_1.items()}


@pytest.fixture(scope="module")
def machine() -> LinearMachine:
    return linearised(catalogue.load(DESIGN_NAME).machine)


@pytest.fixture(scope="module")
def of_table_2(machine: LinearMachine) -> Explanation:
    return explain_coefficients(machine, PRINTED_TABLE_2, BREAKPOINTS)


def test_what_is_explained_counts_beyond_what_was_fitted() -> None:
    printed = [Printed("x", "A", 1.0, 0.1), Printed("y", "A", 2.0, 0.1)]
    all_fitted = Alternative("each number by itself", 2, (1.0, 2.0))
    one = Alternative("one number", 1, (1.05, 2.05))
    none = Alternative("nothing", 0, (1.5, float("nan")))
    found = explain("", printed, [none, all_fitted, one], "")
    assert [of.assumed for of in found.alternatives] == ["one number", *found_words(found)[1:]]
    assert [found.beyond(of) for of in found.alternatives] == [1, 0, 0]
    assert found.alternatives[1] is all_fitted  # misses nothing
    assert found.as_good == ()
    stays = explain("", printed, [none, all_fitted], "")
    assert any("stays open" in line for line in explanation_table(stays).notes)
    assert plain_explanation(stays)["alternatives"][1]["found"] == [1.5, None]


def found_words(found: Explanation) -> list[str]:
    return [of.assumed for of in found.alternatives]


def planted(machine: LinearMachine, edges: dict[str, float]) -> Coefficients:
    """Three digits of degree 3 through the Chebyshev extrema of both segments, by numpy in N m."""
    torque = per_unit_base(machine).torque
    table: Coefficients = {}
    for axis, edge in edges.items():
        rows: list[tuple[float, ...]] = []
        for low, high in ((0.0, edge), (edge, 5.0)):
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            at = torque * (middle - half * np.cos(np.pi * np.arange(4) / 3))
            current = mtpa_currents(machine, at)["dq".index(axis)]
            fitted = np.polyfit(at, current, 3)
            fitted[3] = 0.0 if low == 0.0 else fitted[3]
            rows.append(tuple(float(f"{value:.2e}") for value in fitted))
        table[axis, 3] = (rows[0], rows[1])
    return table


def test_planted_nodes_and_breakpoints_are_found(machine: LinearMachine) -> None:
    printed = planted(machine, {"d": 1.7, "q": 2.2})
    found = explain_coefficients(machine, printed, {3: (1.8455, 1.5545)})
    assert found.winner.assumed == ("Chebyshev extrema, other breakpoints, base as identified")
    assert all(found.explained(found.winner))
    # with its breakpoints printed, nothing has to be fitted
    stated = explain_coefficients(machine, printed, {3: (1.7, 2.2)})
    assert (stated.winner.fitted, stated.beyond(stated.winner)) == (0, 16)


def test_digits_of_table_2_follow_from_nodes_at_both_ends(of_table_2: Explanation) -> None:
    """Nodes that include the ends, over other breakpoints; the stated nodes explain less."""
    assert sum(of_table_2.explained(of_table_2.winner)) >= 36
    assert of_table_2.beyond(of_table_2.winner) >= 22
    assert "with both ends" in of_table_2.winner.assumed
    stated = next(
        of
        for of in of_table_2.alternatives
        if of.assumed == "Chebyshev nodes, printed breakpoints, base as identified"
    )
    assert stated.fitted == 0
    assert of_table_2.beyond(stated) < 10


@pytest.fixture(scope="module")
def of_figure_4(machine: LinearMachine) -> Explanation:
    return explain_largest_error(machine, PRINTED_TABLE_2, BREAKPOINTS)


def least_current(machine: LinearMachine, torque: float) -> tuple[float, float]:
    """MTPA by its quartic, (i_d, i_q) in A: T^2/k^2 = -i_d (psi/D - i_d)^3 with D = L_q - L_d."""
    ratio = machine.psi_pm / (machine.l_q - machine.l_d)
    k = 1.5 * machine.pole_pairs * (machine.l_q - machine.l_d)
    cube = np.poly1d([-1.0, ratio]) ** 3
    roots = (np.poly1d([-1.0, 0.0]) * cube - (torque / k) ** 2).roots
    own = [float(z.real) for z in roots if abs(z.imag) < 1e-6 and z.real <= 0.0]
    return own[0], torque / (k * (ratio - own[0]))


def test_figure_4_stays_open_and_its_nearest_explanation_is_what_it_says(
    machine: LinearMachine, of_figure_4: Explanation
) -> None:
    """Nothing gives both figures; the nearest by the printed row and the quartic alone."""
    assert all(sum(of_figure_4.explained(one)) < 2 for one in of_figure_4.alternatives)
    assert of_figure_4.beyond(of_figure_4.winner) == 0
    assert any("stays open" in line for line in explanation_table(of_figure_4).notes)
    assert of_figure_4.winner.assumed == (
        "printed coefficients of degree 2; i_d, % of the largest reference; to 137 N m"
    )
    torque = np.arange(1.0, 137.01, 0.5)
    exact = np.array([least_current(machine, float(each))[0] for each in torque])
    # the breakpoint of i_d lies at 1.5545 per unit
    unit = 0.375 * machine.pole_pairs * machine.psi_pm**2 / (machine.l_q - machine.l_d)
    first, second = PRINTED_TABLE_2["d", 2]
    row = np.where(torque < 1.5545 * unit, np.polyval(first, torque), np.polyval(second, torque))
    largest = float(np.max(np.abs(row - exact)))
    share = 100.0 * largest / float(np.max(np.abs(exact)))
    assert of_figure_4.winner.found == pytest.approx((largest, share), rel=5e-3)


def test_an_error_of_figure_4_follows_from_three_points(
    machine: LinearMachine, of_figure_4: Explanation
) -> None:
    """Both ends and the middle of each segment, by a parabola of numpy in N m."""
    said = "degree 2, Chebyshev, stretched to both ends, breakpoint 1.35; i_d, "
    one = next(of for of in of_figure_4.alternatives if of.assumed.startswith(said))
    assert one.assumed == f"{said}% of the reference there; to 250 N m"
    unit = per_unit_base(machine).torque
    worst = (0.0, 0.0)
    for low, high in ((0.0, 1.35 * unit), (1.35 * unit, 5.0 * unit)):
        at = [low, 0.5 * (low + high), high]
        row = np.polyfit(at, [least_current(machine, each)[0] if each else 0.0 for each in at], 2)
        for torque in np.arange(low + 0.5, min(high, 250.0), 0.5).tolist():
            exact = least_current(machine, torque)[0]
            gap = abs(float(np.polyval(row, torque)) - exact)
            worst = max(worst, (gap, 100.0 * gap / abs(exact)))
    assert one.found == pytest.approx(worst, rel=5e-3)


def test_planted_slots_are_found_beside_the_switching(machine: LinearMachine) -> None:
    """Slots of 0.9 N m at 200 A of i_q, in proportion to it, whose extremes meet those of the
    switching that `ripple` has.
    """
    points: list[tuple[ModulationName, float, float]] = [
        ("spwm", 0.0, 206.5), ("spwm", -64.8, 179.7), ("ddt-gdpwm", -64.8, 179.7),
    ]  # fmt: skip
    columns = []
    for name, i_d, i_q in points:
        switched = ripple(name, machine, i_d, i_q, 300.0, v_dc=500.0, f_sw=1e5).torque
        printed = round(float(switched) + 2.0 * 0.9 * i_q / 200.0, 2)
        columns.append(RippleColumn(f"{name} at {i_d} A", name, i_d, i_q, printed))
    found = explain_ripple(machine, columns, 300.0, v_dc=500.0, f_sw=1e5)
    assert found.winner.assumed == "slots as i_q; extremes meet"
    assert found.explained(found.winner) == (True, True, True)
    assert found.as_good == ()


def test_the_torque_ripple_of_table_4_is_that_of_equal_slots_but_without_i_d() -> None:
    """The step from SPWM to DDT-GDPWM is that of the switching; the column of i_d = 0 is 0.1 N m
    below what the same slots make there, and further below those that grow with flux or current.
    """
    found = ripple_explained(catalogue.load(DESIGN_NAME))
    assert found.winner.assumed == "slots the same everywhere; extremes meet"
    assert found.explained(found.winner) == (False, True, True)
    assert found.winner.found[0] == pytest.approx(3.27, abs=0.01)
    others = {one.assumed: one.found[0] for one in found.as_good}
    assert others["slots as i_q; extremes meet"] == pytest.approx(3.64, abs=0.01)
    assert others["slots as |psi|; extremes meet"] == pytest.approx(3.76, abs=0.01)
    assert not any(all(found.explained(one)) for one in found.alternatives)


def test_times_and_speed_of_the_bench_follow_together() -> None:
    """220 V rectified, dry friction and a limit of 3 A: both times and the speed of the figures."""
    with program_bench(bench_design()) as place:
        found = explain_transients(place)
    assert found.explained(found.winner) == (True, True, True, True, False)
    assert found.winner.fitted == 2
    assert found.winner.assumed.startswith("311 V")
    start, reversal = found.winner.found[:2]
    # longer than the torque of the limit needs, less the friction, against it while braking: the
    # rest is the integral's, which rests for errors up to the dead band
    torque, speed, inertia = 1.5 * 3 * 0.06 * 3.0, 1200.0 * np.pi / 30.0, 200e-6
    assert start > inertia * speed / (torque - 0.2)
    assert reversal > inertia * speed * (1.0 / (torque - 0.2) + 1.0 / (torque + 0.2))
    assert found.winner.found[3] == pytest.approx(2700.0 * 155 / 155.3445, rel=2e-4)


def test_figure_8_29_follows_from_the_observer_as_printed() -> None:
    """The winner by scipy's integration, and the steady error in closed form."""
    design = catalogue.load("paper001-pmsm-bench")
    found = explain_start(design)
    assert found.winner.assumed == "K_0 and A_0 as printed; g = 40 1/s; no load"
    assert all(found.explained(found.winner))
    assert all("K_0 and A_0 as printed" in one.assumed for one in found.as_good)
    # zeta decays with g - B/J where it should with g + B/J; 900 in place of 1350 for the torque
    r, l_q, p_psi, inertia, friction, g = 2.35, 1.74e-3, 0.18, 2e-4, 4e-5, 40.0
    loss = friction / inertia
    k = g**2 * l_q / p_psi + g * (loss * l_q - r) / p_psi + 900.0
    a = np.array(
        [
            [-r / l_q, -p_psi / l_q, 0.0],
            [1350.0, -loss, 0.0],
            [k, 0.0, loss - g],
        ]
    )
    b = np.array([1.0 / l_q, 0.0, g / p_psi])
    steady = np.linalg.solve(a, -b)
    seen = steady[2] - g * l_q / p_psi * steady[0]
    assert found.winner.found[1] == pytest.approx(100.0 * abs(steady[1] / seen - 1.0), abs=0.02)
    until = _last_significant(a, b, g * l_q / p_psi)
    assert found.winner.found[0] == pytest.approx(until, abs=0.004)


def _last_significant(a: np.ndarray, b: np.ndarray, c: float) -> float:
    """Time in s from which the estimate stays within 2 %, the start integrated period by period."""
    state, asked, voltage, error, missing, last = np.zeros(3), 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(1500):
        estimate = state[2] - c * state[0]
        if abs(estimate - state[1]) > 0.02 * 50.0 * np.pi:
            last = k * 2e-4
        if k % 10 == 0:
            before, error = error, 50.0 * np.pi - estimate
            moved = 20000 / 1024 * (error - before) + 2500 / 1024 * error
            asked = float(np.clip(asked + moved * 12.8 / (225.0 * np.pi), -12.5, 12.5))
        before, missing = missing, asked - state[0]
        moved = 136 / 1024 * (missing - before) + 26 / 32768 * missing
        most = 214.0 / np.sqrt(3.0)
        moved *= most / 12.8
        voltage = float(np.clip(voltage + moved, -13 / 32.768 * most, 13 / 32.768 * most))
        run = solve_ivp(lambda _, x, u: a @ x + b * u, (0.0, 2e-4), state, args=(voltage,))
        state = run.y[:, -1]
    return last
