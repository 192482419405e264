"""What observers are judged with: loads, lost voltage, box of the training, disturbances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design
from scipy.optimize import minimize_scalar

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.observers.conditions import (
    conditions,
    loads_of,
    lost_voltage,
    torque_of,
    training_box,
)

NAMES = ("r_s", "l_d", "l_q", "psi_pm")


def mtpa(machine: LinearMachine, torque: float) -> tuple[float, float]:
    """Least current for a torque, by a search over its angle."""
    kt, saliency = 1.5 * machine.pole_pairs, machine.l_d - machine.l_q

    def size(i_d: float) -> float:
        return float(np.hypot(i_d, torque / (kt * (machine.psi_pm + saliency * i_d))))

    i_d = minimize_scalar(
        size, bounds=(-machine.i_max, 0.0), method="bounded", options={"xatol": 1e-9}
    ).x
    return float(i_d), torque / (kt * (machine.psi_pm + saliency * float(i_d)))


def with_tolerances(design: Design, tolerances: Tolerances | None) -> Design:
    return replace(design, control=replace(design.control, tolerances=tolerances))


@pytest.mark.parametrize("machine", [IPM, SURFACE])
def test_loads_are_the_currents_of_half_and_all_of_the_torque(machine: LinearMachine) -> None:
    loads = loads_of(make_design(machine))
    angle = np.linspace(0.0, np.pi, 200_001)
    i_d, i_q = machine.i_max * np.cos(angle), machine.i_max * np.sin(angle)
    kt, saliency = 1.5 * machine.pole_pairs, machine.l_d - machine.l_q
    most = float(np.max(kt * (machine.psi_pm + saliency * i_d) * i_q))
    for load, share in zip(loads, (0.5, 1.0, -0.5, -1.0), strict=True):
        d, q = mtpa(machine, abs(share) * most)
        sign = np.sign(share)
        assert (load.i_d, load.i_q) == pytest.approx((d, sign * q), rel=1e-3, abs=2e-3)
        own = (machine.l_d, machine.l_q, machine.psi_pm)
        assert (load.l_d, load.l_q, load.psi_pm) == pytest.approx(own)
        assert torque_of(machine, load) == pytest.approx(share * most, rel=1e-5)


def test_constants_of_a_saturated_machine_are_those_of_its_flux_at_the_load() -> None:
    design = catalogue.load("baldor-pmsyrm-5k6")
    for load in loads_of(design):
        at = np.array([load.i_d]), np.array([load.i_q])
        psi_d, psi_q = (float(part[0]) for part in design.machine.flux(*at))
        h = 1e-4
        ahead, back = (design.machine.flux(at[0] + s * h, at[1])[0][0] for s in (1.0, -1.0))
        slope = float(ahead - back) / (2.0 * h)
        assert load.l_d == pytest.approx(slope, rel=1e-5)
        assert load.l_q == pytest.approx(psi_q / load.i_q)
        assert load.psi_pm == pytest.approx(psi_d - slope * load.i_d, rel=1e-5)


@pytest.mark.parametrize("named", [None, (-1e-7, 3e-7)])
def test_lost_voltage_and_box_are_those_of_dead_time_and_tolerances(
    named: tuple[float, float] | None,
) -> None:
    design = make_design(IPM)
    design = replace(design, inverter=replace(design.inverter, dead_time=5e-7))
    tolerances = Tolerances(
        r_s=(-0.2, 0.3), l_d=0.07, l_q=(-0.05, 0.09), psi_pm=0.04, dead_time=named or 0.0
    )
    square = 4.0 / np.pi * 500.0 * 100e3  # a square wave of the height f_sw v_dc, per s
    design = with_tolerances(design, tolerances)
    least, most = lost_voltage(design)
    ends = (5e-7, 5e-7) if named is None else named
    assert (least, most) == pytest.approx((square * ends[0], square * ends[1]))
    box = training_box(design, 900.0)
    assert box.lost == pytest.approx((0.0 if named is None else least, most))
    assert box.r_s == (-0.2, 0.3)
    assert (box.l_d, box.l_q, box.psi_pm) == ((-0.07, 0.07), (-0.05, 0.09), (-0.04, 0.04))
    full = min(load.i_d for load in loads_of(design))
    assert (box.i_max, box.i_d_low) == pytest.approx((283.0, min(-141.5, 1.1 * full)))
    assert (box.omega_low, box.omega_high) == pytest.approx((27.0, 990.0))
    plain = training_box(with_tolerances(design, None), 900.0)
    assert (plain.r_s, plain.l_d, plain.l_q) == ((-0.3, 0.4), (-0.1, 0.1), (-0.1, 0.1))
    assert plain.psi_pm == (-0.1, 0.05)


@pytest.mark.parametrize("inertia", [None, 0.05])
def test_disturbances_are_those_of_the_design(inertia: float | None) -> None:
    design = make_design(replace(IPM, inertia=inertia))
    for tolerances in (None, Tolerances(r_s=(-0.2, 0.3), l_d=0.07, l_q=0.08, psi_pm=0.04)):
        found = conditions(with_tolerances(design, tolerances), 900.0)
        half = torque_of(design.machine, loads_of(design)[0])
        expected = 900.0 / 0.2 if inertia is None else 4.0 * half / 0.05
        assert found.acceleration == pytest.approx(expected)
        assert found.i_noise == pytest.approx(5e-3 * 283.0)
        assert found.v_noise == pytest.approx(1.0)
        assert found.i_load == pytest.approx(141.5)
        assert found.loads == loads_of(design)
        usual = {"r_s": (-0.3, 0.3), "l_d": (-0.1, 0.1), "l_q": (-0.1, 0.1), "psi_pm": (-0.1, 0.1)}
        own = {
            "r_s": (-0.2, 0.3),
            "l_d": (-0.07, 0.07),
            "l_q": (-0.08, 0.08),
            "psi_pm": (-0.04, 0.04),
        }
        for name in NAMES:
            assert found.limits(name) == pytest.approx((usual if tolerances is None else own)[name])
