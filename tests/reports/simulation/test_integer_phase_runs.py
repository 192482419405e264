"""Control of phase machines in integers in the loop, beside float32."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.plants.scenario import Profile, Scenario, constant
from dqforge.reports.simulation.design_run import DriveSimulation, simulate_design


def designed(frame: CurrentFrame, scenario: Scenario, topology: Topology = "four-leg") -> Design:
    """The machine with a trapezoidal back-EMF, its currents within half of full scale."""
    base = catalogue.load("paper002-phase-waveforms")
    control = replace(
        base.control,
        current_loop=replace(base.control.current_loop, frame=frame),
        speed_loop=SpeedLoopSettings("symmetrical-optimum", ratio=10),
        bases=replace(base.control.bases, current=12.0),
    )
    return replace(
        base,
        control=control,
        inverter=replace(base.inverter, topology=topology),
        simulation=scenario,
        losses=None,
        export=replace(base.export, control=("float32", "q15")),
    )


def runs(
    frame: CurrentFrame, scenario: Scenario, topology: Topology = "four-leg"
) -> list[DriveSimulation]:
    found = simulate_design(designed(frame, scenario, topology))
    assert found.formats == ("float32", "q15")
    return list(found.every)


def test_what_a_step_in_integers_logs_is_what_the_machine_has() -> None:
    """References turned back to the axes of the rotor, as the currents that follow them."""
    scenario = Scenario(
        0.02, "torque", constant(1.0), shaft=constant(78.5), omega_m=78.5, dead_time=0.0
    )
    design = designed("table", scenario, "six-leg")
    alone = replace(design, export=replace(design.export, control=("q15",)))
    run = simulate_design(alone).run
    assert run.torque_reference[2:] == pytest.approx(1.0, abs=1e-3)
    assert run.torque[100:] == pytest.approx(1.0, abs=0.1)
    assert np.mean(run.i_q_reference[100:]) == pytest.approx(np.mean(run.i_q[100:]), rel=0.03)
    assert run.i_q_reference[100:] == pytest.approx(run.i_q[100:], abs=0.15)
    assert run.i_d_reference[100:] == pytest.approx(run.i_d[100:], abs=0.15)


@pytest.mark.slow
def test_torque_control_in_integers_holds_the_torque() -> None:
    scenario = Scenario(
        0.1, "torque", constant(1.0), shaft=constant(78.5), omega_m=78.5, dead_time=0.0
    )
    fine, coarse = runs("table", scenario)
    assert fine.phases is not None
    assert coarse.phases is not None
    assert coarse.phases.torque == pytest.approx(1.0, abs=2e-3)
    assert coarse.phases.ripple_means < 5e-3
    assert coarse.phases.neutral_rms == pytest.approx(fine.phases.neutral_rms, rel=0.02)
    np.testing.assert_allclose(coarse.run.i_q, fine.run.i_q, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["dq", "dqx", "dqy", "table"])
def test_speed_control_in_integers_follows_that_in_float32(frame: CurrentFrame) -> None:
    scenario = Scenario(
        0.3,
        "speed",
        Profile((0.0, 0.3), (40.0, 70.0), "linear"),
        omega_m=40.0,
        load=constant(0.5),
        dead_time=0.0,
    )
    fine, coarse = runs(frame, scenario)
    assert float(coarse.run.omega_m[-1]) == pytest.approx(70.0, abs=1.0)
    np.testing.assert_allclose(coarse.run.omega_m, fine.run.omega_m, atol=0.5)
    peak = [float(run.run.figures.peak_current[0]) for run in (fine, coarse)]
    assert peak[1] == pytest.approx(peak[0], rel=0.1)
    assert math.isfinite(coarse.tracking[1])


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["three-wire", "six-leg"])
def test_every_way_to_feed_the_phases(topology: Topology) -> None:
    scenario = Scenario(
        0.1, "torque", constant(0.6), shaft=constant(50.0), omega_m=50.0, dead_time=0.0
    )
    fine, coarse = runs("dqx", scenario, topology)
    assert fine.phases is not None
    assert coarse.phases is not None
    assert coarse.phases.torque == pytest.approx(fine.phases.torque, rel=0.01)
