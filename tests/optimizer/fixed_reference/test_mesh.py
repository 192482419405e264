"""Integer references against exact operating points, by the machine's equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from weakened_drives import CASES, SATURATED, line_fit, weakened_design, weakened_fit

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.fixed_control.design import dc_link
from dqforge.optimizer.fixed_reference.fit import CodePoints, mesh_currents
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range, Ranges

FAST = ("interior", "small ipm", "reluctance")
NAMES = [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in CASES]


def drawn(
    name: str, mesh: CurrentMesh, count: int
) -> tuple[CodePoints, FloatArray, FloatArray, FloatArray]:
    """Codes at random, and what they are: torque in N m, voltage limit in V, speed in rad/s.

    Half of the dc links are the least one, a third of the speeds the largest one.
    """
    design, (_, nominal, speed) = weakened_design(name), CASES[name]
    bases, one = design.control.bases, 2 ** (mesh.width - 1)
    scale = bases.voltage * 2.0 ** dc_link(design, mesh.width)[0]
    generator = np.random.default_rng(31)
    torque = generator.integers(-one, one, count)
    share = np.where(generator.random(count) < 0.5, 0.8, generator.uniform(0.8, 1.2, count))
    link = np.minimum(np.ceil(share * design.inverter.v_dc / scale * one), one - 1)
    volts = link / one * scale * design.v_max / design.inverter.v_dc
    along = generator.uniform(-1.0, 1.0, count)
    along = np.where(generator.random(count) < 0.3, np.sign(along), along)
    turning = np.trunc(along * speed * volts / nominal / bases.speed * one)
    codes = CodePoints(torque, link.astype(np.int64), turning.astype(np.int64))
    return codes, torque / one * bases.torque, volts, turning / one * bases.speed


def taken(name: str, currents: tuple[FloatArray, FloatArray], omega_m: FloatArray) -> FloatArray:
    """Phase amplitude in V, by the machine's equations written out once more."""
    machine = CASES[name][0]
    i_d, i_q = currents
    psi_d, psi_q = machine.flux(i_d, i_q)
    omega = machine.pole_pairs * omega_m
    return np.hypot(machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d)


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", NAMES)
def test_torque_is_that_of_the_exact_operating_point(name: str, width: int) -> None:
    """Where it can be had it is made, and where not the largest that can be, within the budget.

    The largest one of 0.8 of the voltage at the speed in proportion is steep over the speed.
    """
    mesh, machine = weakened_fit(name, width).reference, CASES[name][0]
    codes, torque, volts, omega_m = drawn(name, mesh, 2000)
    torque = np.clip(torque, -mesh.end_torque, mesh.end_torque)
    exact = optimal_points(machine, torque, omega_m, v_max=volts, i_max=machine.i_max)
    made = machine.torque(*mesh_currents(mesh, codes))
    budget = 0.005 * mesh.end_torque
    assert np.max(np.abs(made - exact.torque)) < 1.3 * budget
    assert np.quantile(np.abs(made - exact.torque), 0.99) < budget
    free = exact.voltage < 0.99 * volts
    assert np.count_nonzero(free & exact.reached) > 100
    assert np.count_nonzero(~exact.reached) > 30
    i_d, i_q = mesh_currents(mesh, codes)
    apart = np.hypot(i_d - exact.i_d, i_q - exact.i_q)
    assert np.max(apart[free & exact.reached]) < 0.02 * machine.i_max


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", NAMES)
def test_no_limit_is_exceeded_beyond_what_is_proven(name: str, width: int) -> None:
    fit = weakened_fit(name, width)
    codes, _, volts, omega_m = drawn(name, fit.reference, 100_000)
    currents = mesh_currents(fit.reference, codes)
    excess = float(np.max(taken(name, currents, omega_m) / volts)) - 1.0
    size = float(np.max(np.hypot(*currents)))
    assert size <= CASES[name][0].i_max * (1.0 + fit.proven.current)
    assert 0.0 < fit.proven.current < 1e-4
    if name in SATURATED:
        assert fit.proven.voltage is None
        assert excess < 0.005
    else:
        assert fit.proven.voltage is not None
        assert excess <= fit.proven.voltage < 4e-4
        # The limit is used: what is left lies within what a cell is linear by.
        assert excess > -0.001


def test_a_bound_is_missed_where_nodes_are_wrong() -> None:
    """The bound is of this mesh alone: squared flux linkages that are 2 % too small break it."""
    fit = weakened_fit("small ipm", 16)
    wrong = replace(fit.reference, flux=tuple(int(0.98 * value) for value in fit.reference.flux))
    codes, _, volts, omega_m = drawn("small ipm", wrong, 20_000)
    excess = taken("small ipm", mesh_currents(wrong, codes), omega_m) / volts - 1.0
    assert fit.proven.voltage is not None
    assert np.max(excess) > 10.0 * fit.proven.voltage


@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", ["interior", "reluctance"])
def test_all_that_is_seen_lies_in_the_proven_ranges(name: str, width: int) -> None:
    """Any codes, those of the ends of words among them."""
    for fit in (weakened_fit(name, width), line_fit(name, width)):
        low, high = -(2 ** (width - 1)), 2 ** (width - 1) - 1
        generator = np.random.default_rng(5)
        rows = generator.integers(low, high, (3, 100_000), endpoint=True)
        ends = generator.choice(np.array([low, low + 1, -1, 0, 1, high]), rows.shape)
        rows = np.where(generator.random(rows.shape) < 0.3, ends, rows)
        o = Integers(seen={})
        found = fit.reference.currents(o, *rows)
        assert np.max(np.abs([found.x, found.y])) <= high
        assert o.seen
        proven = {reach.name.removeprefix("reference: "): reach for reach in fit.reaches}
        assert set(o.seen) == set(proven)
        for quantity, (least, most) in o.seen.items():
            reach = proven[quantity]
            # What was seen begins with 0.
            assert min(reach.range.low, 0) <= least
            assert most <= max(reach.range.high, 0)
            assert reach.fits


def test_a_mesh_of_too_large_numbers_is_found_by_its_ranges() -> None:
    mesh = weakened_fit("interior", 16).reference
    assert mesh.voltage is not None
    large = replace(mesh, voltage=replace(mesh.voltage, heat=28))
    found = Ranges(16)
    word = Range(-(2**15), 2**15 - 1)
    large.currents(found, word, word, word)
    assert found.overflowing() is not None


@pytest.mark.parametrize("name", ["interior", "servo"])
def test_signs_mirror(name: str) -> None:
    """Torque and speed of the other sign: i_d stays and i_q turns; motoring and braking differ."""
    mesh = weakened_fit(name, 16).reference
    codes, _, _, _ = drawn(name, mesh, 20_000)
    held = np.maximum(codes.torque, 1 - 2**15)
    o = Integers()
    one = mesh.currents(o, held, codes.v_dc, codes.omega_m)
    other = mesh.currents(o, -held, codes.v_dc, -codes.omega_m)
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(np.abs(one.y), np.abs(other.y))
    assert np.all(one.y * held >= 0)
    braking = mesh.currents(o, held, codes.v_dc, -codes.omega_m)
    assert np.any(braking.x != one.x)


def test_torque_is_given_up_towards_no_voltage() -> None:
    """Beyond the largest speed the torque falls to none, and never rises again with the speed."""
    mesh, design = weakened_fit("interior", 16).reference, weakened_design("interior")
    speeds = np.arange(0, 2**15)
    full = np.full(speeds.shape, 2**15 - 1)
    scale, least = dc_link(design, 16)
    link = round(0.8 * design.inverter.v_dc / (design.control.bases.voltage * 2**scale) * 2**15)
    still = np.full(speeds.shape, link)
    found = mesh.currents(Integers(), full, still, speeds)
    assert found.y[0] > 20_000
    assert found.y[-1] == 0
    made = np.array(CASES["interior"][0].torque(found.x, found.y))
    assert np.max(np.diff(made)) < 3e-3 * made[0]
    # A dc link below the least one counts as that.
    low, none = (
        mesh.currents(Integers(), full, np.full(speeds.shape, code), speeds) for code in (least, -5)
    )
    assert np.array_equal(low.x, none.x)
    assert np.array_equal(low.y, none.y)


@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", NAMES)
def test_references_of_the_torque_alone(name: str, width: int) -> None:
    fit, machine = line_fit(name, width), CASES[name][0]
    mesh = fit.reference
    torque = np.random.default_rng(8).integers(-mesh.end, mesh.end, 3000)
    still = np.zeros_like(torque)
    found = mesh_currents(mesh, CodePoints(torque, still, still))
    asked = torque * mesh.bases[3] / 2 ** (width - 1)
    assert np.max(np.abs(machine.torque(*found) - asked)) < 0.00101 * mesh.end_torque
    exact = optimal_points(machine, asked, 0.0, v_max=1e9, i_max=machine.i_max)
    size, least = (found[0] ** 2 + found[1] ** 2), exact.i_d**2 + exact.i_q**2
    loaded = np.abs(asked) > 0.05 * mesh.end_torque
    assert np.max(size[loaded] / least[loaded]) < 1.001
    assert np.max(np.sqrt(size)) <= machine.i_max * (1.0 + fit.proven.current)


def test_a_straight_line_takes_one_cell() -> None:
    """A machine without saliency: i_q in proportion to the torque."""
    mesh = line_fit("servo", 16).reference
    assert (mesh.rows, mesh.columns) == (1, 1)
    assert set(mesh.d) == {0}
