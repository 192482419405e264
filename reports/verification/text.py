"""What is said of a verification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.pages.html_text import count

if TYPE_CHECKING:
    from dqforge.reports.plain_data import PlainData
    from dqforge.reports.verification.cortex_m import TargetVerification
    from dqforge.reports.verification.host import Verification


def compared(verification: Verification | None) -> str:
    """What a verification compared, in a few words."""
    if verification is None:
        return "this run skipped it"
    languages = " and ".join(standard.upper() for standard in verification.languages)
    return (
        f"{count(verification.vectors + verification.sweep)} results equal the model, {languages}"
    )


def verification_text(verification: Verification | None) -> str:
    """One line on what was compiled, run and compared."""
    if verification is None:
        return "not verified (--no-verify)"
    done = " and ".join(
        check.standard.upper() for check in verification.checks if not check.missing
    )
    missing = [
        f"; {check.standard.upper()} was not tested: install the Debian package {check.missing}"
        for check in verification.checks
        if check.missing
    ]
    count = verification.vectors + verification.sweep
    return f"{count} results equal the model bit for bit, compiled as {done}{''.join(missing)}"


def target_text(outcome: TargetVerification) -> str:
    """One line on a run on an emulated core: what ran there, what did not,
    and what the reference costs.
    """
    low, high = outcome.cycles
    most = outcome.cycles_largest
    ran = "".join(f", {run.compared} of the {run.name}" for run in outcome.runs)
    left = f"; not run there: {', '.join(outcome.not_run)}" if outcome.not_run else ""
    return (
        f"on an emulated {outcome.target} all test vectors hold bit for "
        f"bit{' and these results' if ran else ''}{ran.replace(',', ':', 1)}{left}; both currents "
        f"of the reference take {outcome.instructions:.1f} instructions (mean of {outcome.costed} "
        f"vectors), an estimated {low:.0f}-{high:.0f} cycles (at most {most[0]}-{most[1]}; zero "
        f"wait states) and {outcome.flash} bytes"
    )


# What was compiled and compared, as plain data.


def plain_verification(found: Verification | None) -> PlainData | None:
    """What was compiled and compared; None where that was skipped."""
    if found is None:
        return None
    checks = [
        {
            "standard": check.standard,
            "compared": check.compared,
            "missing_package": check.missing or None,
        }
        for check in found.checks
    ]
    return {"vectors": found.vectors, "sweep": found.sweep, "checks": checks}
