"""Operating points where a flux map ends before the current limit, against brute
force over what is measured.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from one_sided import INDUCTANCES, KINDS, measured_currents, one_sided

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.certificates.current_reference import certify
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.solve import data_use
from dqforge.optimizer.operating_points.characteristics import characteristics, limit_speed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.ends_of_data import _hold, _within_voltage
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    Intervals,
    LossCoefficients,
    Problem,
    State,
    _split_where_torque_turns,
    mtpa_locus,
)
from dqforge.optimizer.operating_points.points import optimal_points

_V_MAX = 25.0


@pytest.mark.thinned
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("inductances", INDUCTANCES)
def test_points_are_the_best_that_is_measured(
    kind: str, inductances: tuple[float, float, float]
) -> None:
    machine = one_sided(kind, *inductances)
    i_d, i_q = measured_currents(machine)
    torque, loss = machine.torque(i_d, i_q), i_d**2 + i_q**2
    most = float(torque.max())
    generator = np.random.default_rng(7)
    request, speed = (
        generator.uniform(-1.3, 1.3, 16) * most,
        generator.uniform(0.0, 1.0, 16) ** 2 * 220.0,
    )
    found = optimal_points(machine, request, speed, v_max=_V_MAX)
    assert np.all(machine.flux_map.region.beyond(found.i_d, found.i_q) <= 1e-6)
    assert not np.any(found.extrapolated)
    assert np.max(found.kkt_residual) < 1e-6
    near = 0.006 * most
    for k in range(request.size):
        sign = -1.0 if request[k] < 0.0 else 1.0
        volts = np.hypot(
            *machine.voltage(i_d, i_q, np.full_like(i_d, machine.pole_pairs * speed[k]))
        )
        kept = volts <= _V_MAX
        if not kept.any():
            assert found.active[k] == Active.UNREACHABLE
            continue
        wanted, made = abs(request[k]), sign * torque[kept]
        if not found.reached[k]:
            here = sign * float(found.torque[k])
            spare = here - made.max() if here < wanted else made.min() - here
            assert spare >= -1e-9 * most
            continue
        mine = found.i_d[k] ** 2 + found.i_q[k] ** 2
        above = loss[kept][(made >= wanted) & (made <= wanted + near)]
        # Measured currents of a little more torque cannot lose less than the optimum for this one.
        assert above.size == 0 or mine <= above.min() * (1.0 + 1e-9) + 1e-9


def test_optimum_beyond_the_data_is_named() -> None:
    # With l_d > l_q and i_d <= 0 measured alone, MTPA wants i_d > 0:
    # the best that is measured is i_d = 0.
    machine = one_sided("ends at i_d = 0", 0.5e-3, 0.25e-3, 0.0)
    found = optimal_points(machine, np.linspace(1.0, 11.0, 6), 0.0, v_max=1e6)
    assert np.allclose(found.i_d, 0.0, atol=1e-7)
    assert np.allclose(found.i_q, np.linspace(1.0, 11.0, 6) / (1.5 * 3 * 0.05))
    assert [Active(code).label for code in found.active] == ["data"] * 6


def test_data_that_cover_the_optimum_change_nothing() -> None:
    whole, cut = (
        one_sided(kind, 0.25e-3, 0.6e-3, 0.0) for kind in ("everywhere", "ends at i_d = 0")
    )
    torque, speed = np.linspace(-14.0, 14.0, 41), np.linspace(0.0, 190.0, 41)
    one, other = (optimal_points(machine, torque, speed, v_max=_V_MAX) for machine in (whole, cut))
    assert not np.any(other.active == Active.DATA)
    assert np.array_equal(one.active, other.active)
    assert np.allclose(one.i_d, other.i_d, atol=1e-7)


def test_permitted_extrapolation_leaves_the_data_and_says_so() -> None:
    machine = one_sided("ends at i_d = 0", 0.5e-3, 0.25e-3, 0.0, extrapolate=True)
    found = optimal_points(machine, 5.0, 0.0, v_max=1e6)
    assert found.i_d[0] > 1.0
    assert found.extrapolated[0]
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    use = data_use(choice, choice.largest_torque())
    assert use.held is None
    assert use.extrapolated is not None
    assert np.allclose(use.extrapolated, [0.0, choice.largest_torque()])


@pytest.mark.thinned
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("inductances", INDUCTANCES)
def test_mtpa_locus_and_figures_stay_inside(
    kind: str, inductances: tuple[float, float, float]
) -> None:
    machine = one_sided(kind, *inductances)
    locus = mtpa_locus(machine, machine.i_max)
    assert np.all(machine.flux_map.region.beyond(locus.i_d, locus.i_q) <= 1e-6)
    i_d, i_q = measured_currents(machine)
    torque = machine.torque(i_d, i_q)
    assert locus.torque[-1] == pytest.approx(float(torque.max()), rel=2e-3)
    for k in range(0, locus.torque.size, 20):
        inside = np.hypot(i_d, i_q) <= locus.current[k] * (1.0 + 1e-9)
        assert locus.torque[k] >= float(torque[inside].max()) * (1.0 - 1e-9)
    figures = characteristics(machine, _V_MAX)
    assert ("torque_max" in figures.held) == ("base_speed" in figures.held) == bool(locus.held[-1])
    slow = np.hypot(
        *machine.voltage(locus.i_d[-1:], locus.i_q[-1:], np.array([3.0 * figures.base_speed]))
    )
    assert slow[0] == pytest.approx(_V_MAX, rel=1e-9)
    if figures.speed_max is not None:
        slower, faster = (
            np.full_like(i_d, 3.0 * factor * figures.speed_max) for factor in (0.99, 1.001)
        )
        assert np.any(np.hypot(*machine.voltage(i_d, i_q, slower)) <= _V_MAX)
        if "speed_max" in figures.held:
            assert not np.any(np.hypot(*machine.voltage(i_d, i_q, faster)) <= _V_MAX)


@pytest.mark.thinned
@pytest.mark.parametrize("strategy", ["mtpa", "id0"])
@pytest.mark.parametrize("kind", ["ends at i_d = 0", "small disc"])
def test_reference_stays_inside_the_data(kind: str, strategy: str) -> None:
    machine = one_sided(kind, *INDUCTANCES[0])
    choice = CurrentChoice(machine, "mtpa" if strategy == "mtpa" else "id0", machine.i_max)
    fit = fit_reference(choice, FitSettings(form="polynomial"))
    i_d, i_q = fit.reference.currents(np.linspace(0.0, fit.torque_max, 400))
    beyond = machine.flux_map.region.beyond(
        np.asarray(i_d, dtype=np.float64), np.asarray(i_q, dtype=np.float64)
    )
    assert float(np.max(beyond)) <= 1.01 * (fit.errors.i_d + fit.errors.i_q)
    use = data_use(choice, fit.torque_max)
    assert use.extrapolated is None
    if strategy == "mtpa":
        assert use.held is not None
        assert use.held[1] == pytest.approx(fit.torque_max)
        # What is proven are currents of least loss; on the edge of the data they are none.
        assert certify(choice, fit.reference, fit.errors) is None
    with pytest.raises(
        NoSolutionError, match=r"held by the data.*extrapolate: true|ask for less torque"
    ):
        fit_reference(choice, FitSettings(form="polynomial", torque_max=1.2 * fit.torque_max))


def problem_of(machine: Machine, torque: FloatArray, omega_e: FloatArray, v_max: float) -> Problem:
    """Points that lose what copper does."""
    return Problem(
        machine,
        mtpa_locus(machine, 50.0),
        torque,
        omega_e,
        np.full(torque.size, v_max),
        50.0,
        LossCoefficients(np.full(torque.size, 0.075), *np.zeros((2, torque.size))),
    )


def test_where_edges_keep_the_voltage_is_a_quadratic_equation() -> None:
    """On straight intervals of a linear machine with resistance: ends within the limit, and the
    roots of |v|^2 = v_max^2 between them, one where one end is beyond it, and two where the voltage
    dips below it between two ends that are."""
    machine = LinearMachine(3, 0.4, 0.5e-3, 1.1e-3, 0.05, 50.0)
    generator = np.random.default_rng(12)
    d, q, step_d, step_q = generator.uniform(-60.0, 60.0, (4, 60))
    step_d, step_q = 2.0 * step_d, 2.0 * step_q
    edges = Intervals(machine, d, q, step_d, step_q)
    omega_e = np.array([-250.0, 0.0, 180.0, 420.0, 1000.0])
    v_max = 17.0
    found = _within_voltage(problem_of(machine, np.ones(5), omega_e, v_max), edges)
    expected, dips = [], 0
    for row, omega in enumerate(omega_e):
        v_d = np.stack([step_d * 0.4 - omega * 1.1e-3 * step_q, d * 0.4 - omega * 1.1e-3 * q])
        v_q = np.stack(
            [step_q * 0.4 + omega * 0.5e-3 * step_d, q * 0.4 + omega * (0.05 + 0.5e-3 * d)]
        )
        for k in range(d.size):
            square = np.polymul(v_d[:, k], v_d[:, k]) + np.polymul(v_q[:, k], v_q[:, k])
            gap = np.polysub(square, [v_max**2])
            shares = [share for share in (0.0, 1.0) if np.polyval(gap, share) <= 0.0]
            roots = np.roots(gap)
            roots = np.sort(roots.real[np.abs(roots.imag) == 0.0])
            inside = [share for share in roots if 0.0 < share < 1.0]
            dips += len(inside) == 2
            expected += [
                (row, d[k] + share * step_d[k], q[k] + share * step_q[k])
                for share in (*shares, *inside)
            ]
    assert dips > 10
    rows = np.array(sorted(zip(found.rows, found.i_d, found.i_q, strict=True)))
    np.testing.assert_allclose(rows, np.array(sorted(expected)), atol=1e-6)


def test_edges_give_the_torque_with_least_loss_or_else_the_most_or_the_least() -> None:
    """By a dense walk along every edge: the crossing of the torque curve that loses least within
    the voltage; where there is none, the most torque if that is less than asked, else the least;
    and the end of an edge with the least voltage where no place keeps it."""
    machine = LinearMachine(3, 0.4, 0.5e-3, 1.1e-3, 0.05, 50.0)
    generator = np.random.default_rng(21)
    d, q = generator.uniform(-40.0, 15.0, 4), generator.uniform(2.0, 20.0, 4)
    edges = Intervals(machine, d, q, np.array([3.0, -8.0, 6.0, 1.0]), generator.uniform(4, 20, 4))
    count = 120
    torque = generator.uniform(0.0, 16.0, count)
    omega_e = generator.choice([-1.0, 1.0], count) * generator.uniform(50.0, 900.0, count)
    v_max, none = 18.0, np.zeros(count)
    order = generator.permutation(count)
    state = State(
        none + 7.0, none + 8.0, none + 9.0, np.zeros(count, dtype=np.int8), none > 0.0, none > 0.0
    )
    _hold(problem_of(machine, torque, omega_e, v_max), state, order, edges)
    share = np.linspace(0.0, 1.0, 4001)
    i_d, i_q = (x + share[:, None] * y for x, y in ((d, edges.step_d), (q, edges.step_q)))
    made, loss = machine.torque(i_d, i_q), i_d**2 + i_q**2
    seen: set[str] = set()
    for row, at in enumerate(order):
        omega = omega_e[row]
        volts = np.hypot(
            0.4 * i_d - omega * 1.1e-3 * i_q, 0.4 * i_q + omega * (0.05 + 0.5e-3 * i_d)
        )
        kept = volts <= v_max
        crossed = np.diff(np.sign(made - torque[row]), axis=0) != 0
        loss_there = np.where(crossed & kept[1:] & kept[:-1], loss[1:], np.inf)
        found_d, found_q, got = state.i_d[at], state.i_q[at], state.torque[at]
        if loss_there.min() < np.inf:
            case = "reached"
            assert got == pytest.approx(torque[row], rel=1e-9)
            assert machine.torque(found_d, found_q) == pytest.approx(got, rel=1e-6)
            assert found_d**2 + found_q**2 == pytest.approx(loss_there.min(), rel=2e-2)
            assert state.active[at] == Active.DATA
        elif kept.any():
            most, least = made[kept].max(), made[kept].min()
            case = "least" if most > torque[row] else "most"
            expected = least if case == "least" else most
            assert got == pytest.approx(expected, abs=5e-3)
            assert machine.torque(found_d, found_q) == pytest.approx(got, rel=1e-9)
            assert state.active[at] == Active.DATA
        else:
            case = "none"
            ends = volts[[0, -1]].ravel()
            k = int(np.argmin(ends))
            assert (found_d, found_q) == (i_d[[0, -1]].ravel()[k], i_q[[0, -1]].ravel()[k])
            assert (got, state.active[at]) == (0.0, Active.UNREACHABLE)
        assert (state.reached[at], state.least[at]) == (case == "reached", case == "least")
        seen.add(case)
    assert seen == {"reached", "most", "least", "none"}


@pytest.mark.parametrize("kind", ["begins at i_d = 0", "small disc"])
def test_the_largest_speed_is_that_of_the_best_measured_current(kind: str) -> None:
    """By a dense walk over what is measured; with data all over it is that of the machine, and the
    current of no flux is told where it lies inside the data alone."""
    machine = one_sided(kind, 0.3e-3, 0.8e-3, 1.0)
    i_d, i_q = measured_currents(machine)
    figures = characteristics(machine, _V_MAX)
    best = float(np.max(limit_speed(machine, i_d, i_q, _V_MAX)))
    assert figures.speed_max is not None
    assert figures.speed_max == pytest.approx(best, rel=1e-4)
    assert figures.speed_max >= best * (1.0 - 1e-9)
    assert figures.characteristic_current is None
    assert "speed_max" in figures.held
    free = characteristics(one_sided("everywhere", 0.3e-3, 0.8e-3, 1.0), _V_MAX)
    assert free.speed_max is None or free.speed_max > 1.02 * best
    assert "speed_max" not in free.held
    strong = one_sided("everywhere", 1.6e-3, 0.8e-3, 0.0)
    assert characteristics(strong, _V_MAX).characteristic_current == pytest.approx(0.05 / 1.6e-3)


def test_intervals_are_split_where_the_torque_turns_and_keep_their_ends() -> None:
    """On a straight interval of a linear machine the torque is a parabola of the share."""
    machine = LinearMachine(3, 0.4, 0.5e-3, 1.1e-3, 0.05, 50.0)
    generator = np.random.default_rng(13)
    d, q, step_d, step_q = generator.uniform(-60.0, 60.0, (4, 40))
    whole = Intervals(machine, d, q, step_d, step_q)
    found = _split_where_torque_turns(whole)
    expected = []
    for row in zip(d, q, step_d, step_q, strict=True):
        torque = [machine.torque(row[0] + x * row[2], row[1] + x * row[3]) for x in (0.0, 0.5, 1.0)]
        bent, slope, _ = np.polyfit([0.0, 0.5, 1.0], np.ravel(torque), 2)
        top = -slope / (2.0 * bent)
        shares = [0.0, top, 1.0] if 0.0 < top < 1.0 else [0.0, 1.0]
        expected += [
            (row[0] + a * row[2], row[1] + a * row[3], (b - a) * row[2], (b - a) * row[3])
            for a, b in itertools.pairwise(shares)
        ]
    assert 45 < len(expected) < 75
    rows = sorted(zip(found.d, found.q, found.step_d, found.step_q, strict=True))
    np.testing.assert_allclose(rows, sorted(expected), atol=1e-6)
