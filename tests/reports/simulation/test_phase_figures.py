"""What is shown of a simulated phase machine: figures of the last tenth of the run."""

from __future__ import annotations

import io
import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.names import Topology
from dqforge.machines.plants.scenario import PhaseOpening, Scenario, constant
from dqforge.reports.simulation.design_run import DriveSimulation, simulate_design
from dqforge.reports.simulation.tables import plain_simulation, simulation_tables


def found(topology: Topology) -> DriveSimulation:
    base = catalogue.load("paper002-phase-waveforms")
    speed = 750.0 * math.pi / 30.0
    scenario = Scenario(0.4, "torque", constant(1.0), shaft=constant(speed), omega_m=speed)
    link = replace(base.inverter, topology=topology, midpoint_capacitance=4e-3)
    return simulate_design(replace(base, inverter=link, simulation=scenario))


def test_split_link_shows_neutral_and_midpoint() -> None:
    drive = found("split-capacitor")
    rows = {row[0]: row[1] for row in simulation_tables(drive)[0].rows}
    shown = plain_simulation(drive)["phases"]
    assert drive.phases is not None
    assert shown["topology"] == "split-capacitor"
    assert shown["torque_mean_Nm"] == drive.phases.torque == pytest.approx(1.0, rel=5e-3)
    assert rows["neutral current, r.m.s."] == f"{1e3 * shown['neutral_rms_A']:.3g} mA"
    assert rows["midpoint off half the link, at most"].endswith("V")
    record = drive.run.phases
    assert record is not None
    late = slice(-400, None)
    neutral = float(np.sqrt(np.mean(record.i_neutral[late] ** 2)))
    assert shown["neutral_rms_A"] == pytest.approx(neutral, rel=1e-2)
    off = float(np.max(np.abs(record.v_midpoint - 110.0)[late]))
    assert shown["midpoint_off_V"] == pytest.approx(off, abs=1e-3)
    assert sum(shown["copper_W"]) == pytest.approx(3.30, abs=0.05)
    archive = np.load(io.BytesIO(drive.files()["pmsm002w_simulation.npz"]))
    np.testing.assert_array_equal(archive["v_midpoint"], record.v_midpoint)
    assert archive["duty_legs"].shape[1] == 3


@pytest.mark.slow
def test_emitted_control_answers_an_open_phase() -> None:
    """Told of it after 1 ms, it makes constant torque again, but for the dead times."""
    base = catalogue.load("paper002-phase-waveforms")
    speed = 750.0 * math.pi / 30.0
    scenario = Scenario(
        0.4,
        "torque",
        constant(1.0),
        shaft=constant(speed),
        omega_m=speed,
        dead_time=0.0,
        open_phase=PhaseOpening("b", 0.1, 1e-3),
    )
    drive = simulate_design(replace(base, simulation=scenario))
    assert drive.phases is not None
    assert drive.phases.torque == pytest.approx(1.0, rel=5e-3)
    assert drive.phases.ripple_means < 0.01
    assert drive.phases.copper[1] == 0.0
    assert sum(drive.phases.copper) == pytest.approx(5.31, rel=0.01)
    assert drive.phases.neutral_rms == pytest.approx(2.14, rel=0.01)


@pytest.mark.slow
def test_three_wires_show_neither() -> None:
    drive = found("three-wire")
    rows = {row[0]: row[1] for row in simulation_tables(drive)[0].rows}
    assert "neutral current, r.m.s." not in rows
    assert "midpoint off half the link, at most" not in rows
    assert "last tenth: mean torque" in rows
    shown = plain_simulation(drive)["phases"]
    assert shown["midpoint_off_V"] is None
    assert shown["neutral_rms_A"] == 0.0
