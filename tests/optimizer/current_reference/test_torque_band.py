"""The torque of machines within their tolerances, against machines that are drawn from them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, cast

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import Tolerances
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.map_deviations import MapDeviations
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.current_reference.torque_band import LEAST_TORQUE, torque_band
from dqforge.optimizer.operating_points.current_choice import OperatingPoints
from dqforge.optimizer.operating_points.solve import solve_curves

SHARES: dict[str, Any] = {"psi_pm": (-0.05, 0.03), "l_d": (-0.1, 0.2), "l_q": (-0.15, 0.1)}


def _machine(like: LinearMachine, psi_pm: float, l_d: float, l_q: float) -> LinearMachine:
    return replace(
        like,
        psi_pm=like.psi_pm * (1.0 + psi_pm),
        l_d=like.l_d * (1.0 + l_d),
        l_q=like.l_q * (1.0 + l_q),
    )


def _looked_at(machine: Machine, points: OperatingPoints) -> tuple[FloatArray, ...]:
    """Currents and torques from the least one on that counts."""
    wanted = machine.torque(points.i_d, points.i_q)
    seen = wanted >= LEAST_TORQUE * np.max(wanted)
    return points.i_d[seen], points.i_q[seen], wanted[seen]


def test_the_band_is_that_of_the_machines_at_its_corners() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    points = solve_curves(design).chosen
    band = torque_band(machine, points, Tolerances(**SHARES))
    assert band is not None
    i_d, i_q, wanted = _looked_at(machine, points)
    off = [
        _machine(machine, *corner).torque(i_d, i_q) / wanted - 1.0
        for corner in product(*SHARES.values())
    ]
    assert band.low == pytest.approx(np.min(off), rel=1e-9)
    assert band.high == pytest.approx(np.max(off), rel=1e-9)
    for part in band.parts:
        alone = [
            _machine(machine, **{**dict.fromkeys(SHARES, 0.0), part.name: end})
            for end in SHARES[part.name]
        ]
        ends = [one.torque(i_d, i_q) / wanted - 1.0 for one in alone]
        assert part.low == pytest.approx(min(0.0, np.min(ends)), rel=1e-9, abs=1e-15)
        assert part.high == pytest.approx(max(0.0, np.max(ends)), rel=1e-9, abs=1e-15)
    assert [part.size for part in band.parts] == sorted(
        (part.size for part in band.parts), reverse=True
    )


def test_intervals_of_95_percent_give_a_band_of_95_percent_or_more() -> None:
    design = catalogue.load("abb-ipmsm-2k2")
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    points = solve_curves(design).chosen
    halves = np.array([0.02, 0.05, 0.04])
    band = torque_band(machine, points, Tolerances(**dict(zip(SHARES, halves, strict=True))))
    assert band is not None
    random = np.random.default_rng(34)
    wanted = machine.torque(points.i_d, points.i_q)[-1]
    off = [
        _machine(machine, *(halves / 1.96 * random.standard_normal(3))).torque(
            points.i_d[-1:], points.i_q[-1:]
        )[0]
        / wanted
        - 1.0
        for _ in range(4000)
    ]
    held = np.mean(np.abs(off) <= band.independent)
    # The parts are the largest ones over the torque, here all at its end.
    assert 0.94 < held < 0.97


def test_a_saturated_machine_is_scaled_as_a_simulation_scales_it() -> None:
    design = catalogue.load("baldor-pmsyrm-5k6")
    machine = design.machine
    points = solve_curves(design).chosen
    band = torque_band(machine, points, Tolerances(l_q=0.1))
    assert band is not None
    i_d, i_q, wanted = _looked_at(machine, points)
    _, psi_q = machine.flux(i_d, i_q)
    change = -1.5 * machine.pole_pairs * 0.1 * psi_q * i_d / wanted
    assert band.high == pytest.approx(np.max(np.abs(change)), rel=1e-12)
    assert [part.name for part in band.parts] == ["l_q"]


def test_what_does_not_change_the_torque_has_no_band() -> None:
    design = catalogue.load("paper001-pmsm-bench")
    points = solve_curves(design).chosen
    assert torque_band(design.machine, points, None) is None
    assert torque_band(design.machine, points, Tolerances(r_s=0.3, inertia=0.2)) is None


def test_library_motors_say_what_their_torque_may_be_off_by() -> None:
    for name in catalogue.motors():
        tolerances = catalogue.load(name).control.tolerances
        assert tolerances is not None
        low, high = tolerances.limits("psi_pm")
        assert high - low > 0.0, name


def _measured() -> tuple[SaturatedMachine, OperatingPoints]:
    """A saturated machine whose map has points with deviations of their own and shared ones."""
    design = catalogue.load("baldor-pmsyrm-5k6")
    model = design.machine
    assert isinstance(model, SaturatedMachine)
    i_d, i_q = np.linspace(-20.0, 4.0, 9), np.linspace(-20.0, 20.0, 11)
    psi_d, psi_q = model.flux(i_d[:, None], i_q)
    flat_d, flat_q = (part.ravel() for part in np.meshgrid(i_d, i_q, indexing="ij"))
    deviations = MapDeviations(
        flat_d,
        flat_q,
        np.stack([2e-3 + 5e-5 * np.abs(flat_d), 1e-3 + 1e-4 * np.abs(flat_q)]),
        np.stack([[3e-5 * flat_d, 4e-5 * flat_q], [2e-3 + 0.0 * flat_d, 2e-5 * flat_q]]),
    )
    known = FluxMap(i_d, i_q, psi_d, psi_q, deviations=deviations)
    machine = replace(model, flux_map=known, i_max=18.0)
    return machine, solve_curves(replace(design, machine=machine)).chosen


def test_the_part_of_a_map_is_that_of_maps_that_are_drawn() -> None:
    """Maps whose points are drawn, symmetric in i_q, interpolated anew: 95 of 100 keep the torque
    within the part at all levels.
    """
    machine, points = _measured()
    band = torque_band(machine, points, None)
    assert band is not None
    (part,) = band.parts
    assert part.name == "flux_map"
    assert band.independent == part.size == band.high == -band.low
    nominal = machine.flux_map
    known = nominal.deviations
    assert known is not None
    i_d, i_q, wanted = _looked_at(machine, points)
    levels = np.linspace(wanted[0], wanted[-1], 201)
    i_d, i_q = np.interp(levels, wanted, i_d), np.interp(levels, wanted, i_q)
    rng = np.random.default_rng(1)
    shape = nominal.psi_d.shape
    worst, at_end = [], []
    for _ in range(400):
        off = known.own * rng.normal(size=known.own.shape)
        off += np.tensordot(rng.normal(size=known.shared.shape[0]), known.shared, 1)
        off_d, off_q = np.reshape(off, (2, *shape))
        half = shape[1] // 2
        off_d[:, :half], off_q[:, :half] = off_d[:, :half:-1], -off_q[:, :half:-1]
        off_q[:, half] = 0.0
        drawn = replace(nominal, psi_d=nominal.psi_d + off_d, psi_q=nominal.psi_q + off_q)
        torque = replace(machine, flux_map=drawn).torque(i_d, i_q)
        worst.append(np.max(np.abs(torque / levels - 1.0)))
        at_end.append(torque[-1])
    # Two standard deviations of 400 draws are 2 %; the width is a bound, not exact.
    assert 0.93 <= np.mean(np.array(worst) <= part.size) <= 0.985
    of_d, of_q = known.factors(i_d[-1:], i_q[-1:])
    factors = 1.5 * machine.pole_pairs * (of_d * i_q[-1] - of_q * i_d[-1])
    assert np.std(at_end) == pytest.approx(float(np.linalg.norm(factors)), rel=0.1)


def test_points_that_fill_no_grid_have_the_deviation_of_the_nearest() -> None:
    i_d, i_q = np.array([0.0, -1.0, -2.0]), np.array([0.0, 1.0, 3.0])
    known = MapDeviations(
        i_d, i_q, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.zeros((0, 2, 3))
    )
    found = known.factors(np.array([-1.1, -1.9]), np.array([1.2, -2.9]))
    assert np.linalg.norm(found, axis=2) == pytest.approx(np.array([[2.0, 3.0], [5.0, 6.0]]))


def test_the_error_of_the_reference_is_added() -> None:
    machine, points = _measured()

    class Short:
        """A reference whose currents make 1 % less."""

        def currents(self, torque: FloatArray) -> tuple[FloatArray, ...]:
            wanted = 0.99 * np.asarray(torque, np.float64)
            made = np.asarray(machine.torque(points.i_d, points.i_q))
            return np.interp(wanted, made, points.i_d), np.interp(wanted, made, points.i_q)

    alone = torque_band(machine, points, None)
    band = torque_band(machine, points, None, cast(Any, Short()))
    assert alone is not None
    assert band is not None
    assert band.independent - alone.independent == pytest.approx(0.01, rel=0.05)
    assert {part.name for part in band.parts} == {"flux_map", "reference"}
