"""What was compiled and compared, as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.reports.plain_data import PlainData
    from dqforge.reports.verification.host import Verification


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
