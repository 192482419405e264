"""What does not settle is not exported."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.firmware.solve import FirmwareFit
from dqforge.reports.firmware.settling import Verdict, settles


def require_settling(design: Design, fit: FirmwareFit) -> Verdict:
    """Run the loops of a firmware on the design's machine.

    Raises
    ------
    NoSolutionError
        They do not settle; says which step does not, and what the margins say.
    VerificationError
        There is no C compiler.
    """
    verdict = settles(fit.profile, design, fit.configuration.drive)
    if not verdict.settles:
        why = "; ".join((verdict.reason, *fit.judged.remarks[:1]))
        asked_for = design.control.firmware
        within = asked_for is not None and asked_for.name == fit.name
        advice = (
            "choose slower loops under control"
            if within
            else f"write control.firmware: {fit.name} to have gains chosen within its structure"
        )
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
