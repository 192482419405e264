"""The loops of ST's MCSDK in the time domain, with its observer's loop and with its table."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace

import pytest
from firmware_loops import VALUES, scooter, vesc

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.control_design.gain_set import gains_or_reason
from dqforge.optimizer.firmware.firmware_method import asked
from dqforge.optimizer.firmware.targets.st import ST
from dqforge.reports.firmware.target import firmware_simulator, settles
from dqforge.reports.simulation.recorded_run import Simulator

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(scope="module")
def program() -> Iterator[Simulator]:
    """The loops of any firmware, compiled once."""
    with firmware_simulator(vesc(), VALUES) as compiled:
        yield compiled


def drive(*, salient: bool) -> Design:
    """The scooter's drive with a largest speed, and a speed loop of 15 Hz."""
    design = scooter()
    assert isinstance(design.machine, LinearMachine)
    assert design.control.speed_loop is not None
    machine = replace(design.machine, omega_m_max=260.0)
    if salient:
        machine = replace(machine, l_q=2.5e-4)
    loops = replace(
        design.control.speed_loop, method="bandwidth", bandwidth=95.0, ratio=20, filter_time=0.0
    )
    control = replace(design.control, speed_loop=loops, observer=None)
    operation = replace(design.operation, strategy="mtpa" if salient else "id0")
    return replace(design, machine=machine, control=control, operation=operation)


@pytest.mark.slow
@pytest.mark.parametrize("salient", [False, True])
def test_torque_current_and_speed_settle(program: Simulator, *, salient: bool) -> None:
    design = drive(salient=salient)
    gains, reason = gains_or_reason(design)
    assert gains is not None, reason
    found = ST.configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    loops = ST.profile(found)
    assert loops.speed is not None
    assert loops.speed.feedback.kind == "pll"
    assert (loops.reference == "table") == salient
    verdict = settles(loops, design, found.drive, program=program)
    assert verdict.settles, verdict.reason
