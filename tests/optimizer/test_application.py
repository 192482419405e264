"""Settings of the program around a control, each by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from drives import SURFACE, make_design

from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.plants.scenario import Encoder, Scenario, constant
from dqforge.optimizer.application import alignment_time, application_plan


@pytest.mark.parametrize("omega_m_max", [None, 250.0])
@pytest.mark.parametrize("t_s", [1e-4, 5e-3, 1e-2])
def test_every_setting_is_that_of_its_rule(omega_m_max: float | None, t_s: float) -> None:
    inertia = 1e-3
    machine = replace(SURFACE, inertia=inertia, omega_m_max=omega_m_max)
    design = make_design(machine)
    scenario = Scenario(
        duration=1.0, mode="speed", reference=constant(1.0), encoder=Encoder(500, "exact")
    )
    control = replace(design.control, t_s=t_s, speed_loop=SpeedLoopSettings(ratio=7))
    design = replace(
        design,
        control=control,
        simulation=scenario,
        export=replace(design.export, application="skeleton"),
    )
    assert (
        application_plan(replace(design, export=replace(design.export, application=None))) is None
    )
    plan = application_plan(design)
    assert plan is not None
    largest = control.bases.speed if omega_m_max is None else 250.0
    i_max, v_dc, pairs = design.i_max, design.inverter.v_dc, machine.pole_pairs
    assert (plan.kind, plan.ratio, plan.counts, plan.pole_pairs) == ("observer", 7, 2000, pairs)
    assert plan.trip_current == pytest.approx(1.5 * i_max)
    assert (plan.v_dc_min, plan.v_dc_max) == pytest.approx((0.5 * v_dc, 1.3 * v_dc))
    assert plan.align_current == pytest.approx(0.5 * i_max)
    # theta'' = -(p K_T I/J) theta, in electrical rad.
    torque = 1.5 * pairs * machine.psi_pm * 0.5 * i_max
    swing = math.sqrt(pairs * torque / inertia)
    time = max(0.3, 3.0 * 2.0 * math.pi / swing)
    assert plan.align_samples == math.ceil(time / t_s)
    # A torque b omega_m against the rotor makes the ratio b/(2 J swing).
    against = 1.5 * pairs * machine.psi_pm * plan.align_damping
    assert against / (2.0 * inertia * swing) == pytest.approx(0.4)
    heavy = replace(machine, inertia=1e3 * inertia)
    slow = 3.0 * 2.0 * math.pi / swing * math.sqrt(1e3)
    assert alignment_time(heavy, 0.5 * i_max) == pytest.approx(max(0.3, slow))
    assert plan.stop_step == pytest.approx(largest * t_s)
    assert plan.rest == pytest.approx(0.01 * largest)
    assert plan.offset_samples == {1e-4: 1000, 5e-3: 20, 1e-2: 16}[t_s]
    assert plan.offset_limit == pytest.approx(0.05 * i_max)
