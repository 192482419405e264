"""Constrained phase currents against a conic formulation of the whole period,
and against the closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms.constraint_rows import (
    LIMITS,
    WaveformLimits,
    bus_demand,
    unit_currents,
)
from dqforge.optimizer.waveforms.solver import obstacle, require_solution, solve_waveforms

MACHINE = PhaseMachine.from_harmonics(
    [1, 3, 5, 7],
    [0.2, 0.036, 0.012, 0.006],
    [0.0, 0.0, np.pi, 0.0],
    pole_pairs=2,
    r_s=1.0,
    l_s=8e-3,
    m_s=-1e-3,
    i_max=14.0,
)
UNEQUAL = PhaseMachine.from_harmonics(
    [1, 2, 3],
    [[0.2, 0.01, 0.03], [0.18, 0.0, 0.02], [0.21, 0.005, 0.025]],
    [[0.0, 0.3, 0.0], [2.05, 0.0, 0.2], [-2.1, 0.0, 0.1]],
    pole_pairs=2,
    r_s=1.0,
    l_s=8e-3,
    m_s=-1e-3,
    i_max=14.0,
    angles=120,
)
THIRD = PhaseMachine.from_harmonics(
    [1, 2, 3],
    [0.2, 0.02, 0.03],
    [0.0, 0.3, 0.1],
    pole_pairs=2,
    r_s=1.0,
    l_s=8e-3,
    m_s=-1e-3,
    i_max=14.0,
    angles=120,
)
STAR = WaveformLimits(130.0, "three-wire", 14.0)


def middle(count: int, weights: tuple[float, ...]) -> FloatArray:
    """Stencil over the angles -1, 0, 1 and 2 as a full circulant matrix,
    to be multiplied from the right.
    """
    shifts = zip((-1, 0, 1, 2), weights, strict=True)
    return np.asarray(
        sum(weight * np.roll(np.eye(count), offset, axis=0) for offset, weight in shifts)
    )


def conic(machine: PhaseMachine, torque: float, omega_m: float, limits: WaveformLimits) -> float:
    """Least copper loss by Clarabel over the whole period, written from the phase model alone."""
    count, omega = machine.angles, machine.pole_pairs * omega_m
    i: Any = cp.Variable((3, count))
    mean = middle(count, (-1 / 16, 9 / 16, 9 / 16, -1 / 16))
    slope = i @ middle(count, (1 / 24, -27 / 24, 27 / 24, -1 / 24)) * (count / (2.0 * np.pi))
    v = machine.r_s * (i @ mean) + omega * (machine.inductances @ slope + machine.flux @ mean)
    made = machine.pole_pairs * cp.sum(cp.multiply(machine.flux, i), axis=0)
    pairs = cp.vstack([v[0] - v[1], v[1] - v[2], v[2] - v[0]])
    keeps: list[Any] = [cp.abs(i) <= limits.i_max]
    if limits.ripple == 0.0:
        keeps.append(made == torque)
    else:
        keeps += [cp.abs(made - torque) <= limits.ripple, cp.sum(made) / count == torque]
    by_topology: dict[str, list[Any]] = {
        "three-wire": [cp.sum(i, axis=0) == 0, cp.abs(pairs) <= limits.v_dc],
        "four-leg": [cp.abs(pairs) <= limits.v_dc, cp.abs(v) <= limits.v_dc],
        "split-capacitor": [cp.abs(v) <= 0.5 * limits.v_dc, cp.sum(i) == 0],
        "six-leg": [cp.abs(v) <= limits.v_dc],
    }
    keeps += by_topology[limits.topology]
    if limits.neutral is not None:
        keeps.append(cp.abs(cp.sum(i, axis=0)) <= limits.neutral)
    if limits.open_phase is not None:
        keeps.append(i["abc".index(limits.open_phase)] == 0)
    if limits.slew is not None:
        keeps.append(cp.abs(omega * slope) <= limits.slew)
    programme = cp.Problem(cp.Minimize(machine.r_s * cp.sum_squares(i) / count), keeps)
    programme.solve(solver="CLARABEL", tol_gap_abs=1e-9, tol_gap_rel=1e-9, tol_feas=1e-9)
    return float(programme.value)


CASES: dict[str, tuple[PhaseMachine, float, float, WaveformLimits]] = {
    "bus, three-wire": (MACHINE, 4.0, 180.0, STAR),
    "bus, four-leg": (MACHINE, 4.0, 190.0, replace(STAR, v_dc=140.0, topology="four-leg")),
    "bus, split capacitor": (
        MACHINE,
        4.0,
        190.0,
        replace(STAR, v_dc=150.0, topology="split-capacitor"),
    ),
    "bus, six-leg": (MACHINE, 4.0, 190.0, replace(STAR, v_dc=70.0, topology="six-leg")),
    "ripple": (MACHINE, 4.0, 180.0, replace(STAR, v_dc=140.0, ripple=0.4)),
    "neutral": (MACHINE, 4.0, 180.0, replace(STAR, v_dc=140.0, topology="four-leg", neutral=1.0)),
    "slew": (MACHINE, 4.0, 150.0, replace(STAR, v_dc=200.0, slew=2400.0)),
    "current": (MACHINE, 4.0, 50.0, replace(STAR, topology="four-leg", i_max=5.3)),
    "generating backwards": (MACHINE, 4.0, -200.0, STAR),
    "braking": (MACHINE, -4.0, 200.0, STAR),
    "open phase": (
        MACHINE,
        2.0,
        190.0,
        replace(STAR, v_dc=152.0, topology="four-leg", open_phase="b"),
    ),
    "open phase in a star": (MACHINE, 2.0, 100.0, replace(STAR, ripple=2.6, open_phase="a")),
    "unequal phases": (UNEQUAL, 4.0, 180.0, replace(STAR, v_dc=135.0)),
    "unequal phases, split": (
        UNEQUAL,
        4.0,
        180.0,
        replace(STAR, v_dc=155.0, topology="split-capacitor"),
    ),
    "even harmonics": (THIRD, 4.0, 180.0, replace(STAR, v_dc=135.0)),
    "even harmonics, split": (
        THIRD,
        4.0,
        180.0,
        replace(STAR, v_dc=150.0, topology="split-capacitor"),
    ),
}


@pytest.mark.thinned
@pytest.mark.parametrize("name", CASES)
def test_conic_solver_finds_the_same_loss(name: str) -> None:
    machine, torque, omega, limits = CASES[name]
    found = solve_waveforms(machine, torque, omega, limits)
    assert found.status == ("solved",)
    assert found.copper[0] == pytest.approx(conic(machine, torque, omega, limits), rel=1e-6)
    assert found.violation[0] < 1e-8
    assert found.stationarity[0] < 1e-7
    assert found.binding.any()
    made = machine.torque(found.currents[0])
    if limits.ripple == 0.0:
        np.testing.assert_allclose(made, torque, atol=1e-9 * abs(torque))
    else:
        assert np.mean(made) == pytest.approx(torque, rel=1e-8)
        assert np.max(np.abs(made - torque)) <= limits.ripple * (1.0 + 1e-6)
    volts = machine.voltage(found.currents[0], machine.pole_pairs * omega)
    assert bus_demand(volts, limits.topology) <= limits.v_dc * (1.0 + 1e-7)


@pytest.mark.slow
def test_conic_solver_agrees_at_200_random_points() -> None:
    generator = np.random.default_rng(7)
    topologies: list[Topology] = ["three-wire", "four-leg", "split-capacitor", "six-leg"]
    compared = 0
    machine = PhaseMachine(2, 1.0, 8e-3, -1e-3, MACHINE.flux[:, ::3], 14.0)
    while compared < 200:
        topology = topologies[int(generator.integers(4))]
        need = {"three-wire": 1.7, "four-leg": 1.7, "split-capacitor": 2.0, "six-leg": 1.0}[
            topology
        ]
        torque, omega = generator.uniform(1.0, 6.0), generator.uniform(100.0, 300.0)
        v_dc = need * 2.0 * omega * 0.2 * generator.uniform(1.0, 1.25)
        limits = WaveformLimits(v_dc, topology, generator.uniform(8.0, 16.0))
        found = solve_waveforms(machine, torque, omega, limits)
        if found.status != ("solved",):
            continue
        assert found.copper[0] == pytest.approx(conic(machine, torque, omega, limits), rel=1e-5)
        compared += 1


@pytest.mark.parametrize("rule", ["dqx", "dqy"])
def test_programme_equals_the_closed_form_where_nothing_binds(rule: Any) -> None:
    """A ripple that is permitted but so small that it buys nothing makes the programme
    solve what has a formula.
    """
    topology: Topology = "three-wire" if rule == "dqx" else "four-leg"
    closed = 3.0 * unit_currents(MACHINE, rule)
    free = WaveformLimits(1e4, topology, 100.0)
    np.testing.assert_allclose(
        solve_waveforms(MACHINE, 3.0, 100.0, free).currents[0], closed, atol=1e-12
    )
    programme = solve_waveforms(MACHINE, 3.0, 100.0, replace(free, ripple=1e-9))
    assert programme.status == ("solved",)
    np.testing.assert_allclose(programme.currents[0], closed, atol=1e-6)
    assert programme.copper[0] == pytest.approx(MACHINE.copper_loss(closed), rel=1e-8)


def test_symmetry_changes_nothing_but_the_size() -> None:
    """The same machine with a phase disturbed by 1e-7 of its size has no symmetry left,
    and the same currents.
    """
    disturbed = MACHINE.flux.copy()
    disturbed[0, 0] += 1e-7 * 0.2
    whole = PhaseMachine(2, 1.0, 8e-3, -1e-3, disturbed, 14.0)
    assert (MACHINE.symmetry, THIRD.symmetry, whole.symmetry) == ("sixth", "third", "none")
    part, full = (solve_waveforms(machine, 4.0, 180.0, STAR) for machine in (MACHINE, whole))
    np.testing.assert_allclose(part.currents, full.currents, atol=1e-4)
    assert part.copper[0] == pytest.approx(full.copper[0], rel=1e-6)


def test_many_points_are_each_as_if_alone() -> None:
    torque, omega = np.array([1.0, 4.0, 4.0, 9.0]), np.array([100.0, 180.0, 150.0, 250.0])
    together = solve_waveforms(MACHINE, torque, omega, STAR)
    assert together.status == ("closed form", "solved", "closed form", "infeasible")
    assert np.isnan(together.copper[3])
    for k in range(3):
        alone = solve_waveforms(MACHINE, torque[k], omega[k], STAR)
        np.testing.assert_allclose(together.currents[k], alone.currents[0], atol=1e-10)


def test_more_freedom_never_costs_more() -> None:
    """Six legs permit what four legs do, those what a star does; a limit less,
    a longer ripple never cost.
    """
    losses = [
        solve_waveforms(MACHINE, 4.0, 185.0, WaveformLimits(135.0, topology, 14.0)).copper[0]
        for topology in ("six-leg", "four-leg", "diode-neutral", "three-wire")
    ]
    assert np.all(np.diff(losses) >= -1e-9)
    assert losses[0] < 0.9 * losses[3]
    permitted = (replace(STAR, ripple=ripple) for ripple in (0.0, 0.1, 0.3, 1.0))
    front = [solve_waveforms(MACHINE, 4.0, 185.0, limits).copper[0] for limits in permitted]
    assert np.all(np.diff(front) < 0.0)


def test_diode_neutral_carries_current_only_with_the_sign_of_all_phases() -> None:
    """A third harmonic as large as the fundamental makes all three back-EMFs
    of one sign at some angles.
    """
    machine = PhaseMachine.from_harmonics(
        [1, 3], [0.1, 0.12], [0.0, 0.0], pole_pairs=2, r_s=1.0, l_s=4e-3, m_s=0.0, i_max=20.0
    )
    limits = WaveformLimits(100.0, "diode-neutral", 20.0, ripple=1.0)
    found = solve_waveforms(machine, 3.0, 50.0, limits)
    neutral = np.sum(found.currents[0], axis=0)
    below, above = np.all(machine.flux < 0.0, axis=0), np.all(machine.flux > 0.0, axis=0)
    assert np.max(np.abs(neutral[~(below | above)])) < 1e-9
    assert np.all(neutral[below] >= -1e-9)
    assert np.all(neutral[above] <= 1e-9)
    backwards = solve_waveforms(machine, -3.0, -50.0, limits)
    assert backwards.copper[0] == pytest.approx(found.copper[0], rel=1e-9)


@pytest.mark.parametrize(
    "limits", [STAR, replace(STAR, topology="four-leg"), replace(STAR, ripple=0.3)]
)
def test_what_would_have_to_give_is_just_enough(limits: WaveformLimits) -> None:
    torque, omega = 9.0, 230.0
    wide = replace(limits, i_max=40.0)
    needs = obstacle(MACHINE, torque, omega, wide)
    assert needs.v_dc is not None
    assert needs.torque is not None
    for share, status in ((1.001, "solved"), (0.999, "infeasible")):
        enough = solve_waveforms(MACHINE, torque, omega, replace(wide, v_dc=share * needs.v_dc))
        assert enough.status == (status,)
        less = solve_waveforms(MACHINE, needs.torque / share, omega, wide)
        assert less.status == (status,)


def test_least_current_limit_is_just_enough() -> None:
    limits = replace(STAR, v_dc=300.0)
    needs = obstacle(MACHINE, 9.0, 100.0, limits)
    assert needs.i_max is not None
    for share in (1.001, 0.999):
        found = solve_waveforms(MACHINE, 9.0, 100.0, replace(limits, i_max=share * needs.i_max))
        assert found.feasible[0] == (share > 1.0)


def test_refusals_say_which_limit_must_give() -> None:
    found = solve_waveforms(MACHINE, 9.0, 100.0, replace(STAR, v_dc=300.0))
    with pytest.raises(
        NoSolutionError,
        match=r"9 N m at 954.9 rpm .* it would take a current limit of .* or a torque",
    ):
        require_solution(MACHINE, found, replace(STAR, v_dc=300.0))
    with pytest.raises(NoSolutionError, match="constant torque cannot be made near"):
        solve_waveforms(MACHINE, 1.0, 100.0, replace(STAR, open_phase="a"))
    with pytest.raises(InputError, match="v_dc must be positive"):
        replace(STAR, v_dc=0.0)
    with pytest.raises(InputError, match="ripple must be zero or positive"):
        replace(STAR, ripple=-1.0)
    with pytest.raises(InputError, match="must be finite"):
        solve_waveforms(MACHINE, np.nan, 1.0, STAR)


def test_binding_limits_are_named() -> None:
    found = solve_waveforms(
        MACHINE, 4.0, 180.0, replace(STAR, v_dc=140.0, topology="four-leg", neutral=1.0)
    )
    assert [name for name, binds in zip(LIMITS, found.binding[0], strict=True) if binds] == [
        "voltage",
        "neutral",
    ]


@pytest.mark.parametrize("count", [180, 360, 720])
def test_nothing_alternates_from_angle_to_angle_where_the_bus_binds(count: int) -> None:
    """Mean voltages over the steps, of currents that run straight from angle to angle,
    keep the bus but for the step.

    A slope that does not see what alternates would leave this unbounded:
    finer grids would then be worse.
    """
    machine = PhaseMachine.from_harmonics(
        [1, 3, 5, 7],
        [0.2233, 0.0268, 0.0067, 0.0022],
        [0.0] * 4,
        pole_pairs=2,
        r_s=1.0,
        l_s=7e-3,
        m_s=-1e-3,
        i_max=5.94,
        angles=count,
    )
    omega, v_dc = 60.0 * np.pi, 150.0
    found = solve_waveforms(machine, 3.5, omega, WaveformLimits(v_dc, "four-leg", 5.94))
    assert found.status == ("solved",)
    currents, following = found.currents[0], np.roll(found.currents[0], -1, axis=1)
    slope = (following - currents) * (count / (2.0 * np.pi))
    flux = 0.5 * (machine.flux + np.roll(machine.flux, -1, axis=1))
    volts = 0.5 * machine.r_s * (currents + following) + machine.pole_pairs * omega * (
        machine.inductances @ slope + flux
    )
    assert bus_demand(volts, "four-leg") < 1.05 * v_dc
    assert np.max(np.abs(np.diff(np.sum(currents, axis=0)))) < 0.4 * max(1.0, 360 / count)
