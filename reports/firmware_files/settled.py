"""What does not settle is not exported."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.reports.firmware.loop_code import modulation_of
from dqforge.reports.firmware.target import Verdict, firmware_simulator, settles

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.reports.simulation.recorded_run import Simulator


def settling_verdicts(
    design: Design, fits: Sequence[FirmwareFit], told: Callable[[str], None]
) -> Iterator[Verdict]:
    """Run the loops of each firmware on the design's machine, one after the other.

    All that modulate alike run in one program, which is compiled once.

    Args:
        design: The design.
        fits: What each firmware is given of it.
        told: Called with the name of each before it runs.

    Raises:
        NoSolutionError, VerificationError: As `require_settling`.
    """
    with ExitStack() as stack:
        programs: dict[str, Simulator] = {}
        for fit in fits:
            told(fit.name)
            kind = modulation_of(fit.profile)
            if kind not in programs:
                made = firmware_simulator(fit.profile, fit.configuration.drive)
                programs[kind] = stack.enter_context(made)
            yield require_settling(design, fit, programs[kind])


def require_settling(design: Design, fit: FirmwareFit, program: Simulator | None = None) -> Verdict:
    """Run the loops of a firmware on the design's machine.

    Args:
        design: The design.
        fit: What the firmware is given of it.
        program: A compiled one of the same modulation, where it is there already.

    Raises:
        NoSolutionError: They do not settle; says which step does not, and what the margins say.
        VerificationError: There is no C compiler.
    """
    verdict = settles(fit.profile, design, fit.configuration.drive, program=program)
    if not verdict.settles:
        why = "; ".join((verdict.reason, *fit.judged.faults[:1]))
        asked_for = design.control.firmware
        within = asked_for is not None and asked_for.name == fit.name
        calmer = calmer_bandwidth(design, fit, verdict, program)
        if calmer is not None:
            advice = (
                f"write method: bandwidth and bandwidth: {calmer:g} Hz under control.speed_loop, "
                "with which they settle"
            )
        elif within:
            advice = "choose slower loops under control"
        else:
            advice = f"write control.firmware: {fit.name} to have gains chosen within its structure"
        raise NoSolutionError(
            f"export.firmware: {fit.name} does not control this drive, nothing is written: {why}; "
            f"{advice}, or --no-verify to write the file all the same"
        )
    return verdict


def settling_text(verdict: Verdict) -> str:
    """What was tried, in one line."""
    steps = ", ".join(step.name for step in verdict.tried) or "nothing"
    left = f"; not tried: {'; '.join(verdict.left_out)}" if verdict.left_out else ""
    return f"the loops of {verdict.firmware} settle (tried: {steps}){left}"


# A slower speed loop for firmware that does not settle with that of the design.

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
