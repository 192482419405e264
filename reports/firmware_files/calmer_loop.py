"""A slower speed loop for firmware that does not settle with that of the design."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.reports.firmware.target import Verdict, settles

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.reports.simulation.recorded_run import Simulator

_BANDWIDTHS = (50.0, 20.0, 10.0, 5.0, 2.0)  # In Hz; those that are tried, fastest first.


def calmer_bandwidth(
    design: Design, fit: FirmwareFit, verdict: Verdict, program: Simulator | None
) -> float | None:
    """Fastest of a few bandwidths in Hz with which the loops settle, where it is the speed that
    does not; None where none of them does, or something else is wrong.

    Args:
        design: The design.
        fit: What the firmware is given of it.
        verdict: What came of its loops.
        program: A compiled one of the same modulation, where it is there already.
    """
    settings = design.control.speed_loop
    failed = [step for step in verdict.tried if not step.settles]
    of_speed = all(
        step.quantity == "the speed" and step.answer.outcome != "steady error" for step in failed
    )
    inertia, asked = design.machine.inertia, fit.asked.speed
    if settings is None or inertia is None or asked is None or not of_speed:
        return None
    rate = asked.kp * design.machine.torque_per_ampere / inertia / (2.0 * math.pi)
    for bandwidth in _BANDWIDTHS:
        if bandwidth >= rate:
            continue
        slower = replace(settings, method="bandwidth", bandwidth=2.0 * math.pi * bandwidth)
        trial = replace(design, control=replace(design.control, speed_loop=slower))
        try:
            found = solve_firmware(trial, solve_gains(trial, proofs=False), [fit.name])[0]
        except (InputError, NoSolutionError):
            continue
        if settles(found.profile, trial, found.configuration.drive, program=program).settles:
            return bandwidth
    return None
