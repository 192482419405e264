"""The torque of machines within their tolerances, against machines that are drawn from them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import Tolerances
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
