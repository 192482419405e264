"""Plain data: what JSON and templates are given, and what was read of a design as such data."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.flux_maps.evidence import FluxEvidence


PlainData = dict[str, Any]


def finite(value: float) -> float | None:
    """The number, or null for what JSON cannot hold."""
    return value if math.isfinite(value) else None


def shortest(value: np.float32) -> float:
    """The double whose shortest decimal is that of the float: 0.1 for float32(0.1)."""
    return float(str(value))


# What was read of a design as plain data: for ``check --json`` and ``result.json``.


def plain_design(design: Design) -> PlainData:
    """Name, origin of every value, assumptions and the digest of the input."""
    return {
        "name": design.name,
        "about": design.about,
        "digest": design.digest,
        "values": [asdict(value) for value in design.values],
        "assumptions": list(design.assumptions),
        **(
            {"flux_maps": [plain_flux_map(evidence) for evidence in design.flux_evidence]}
            if design.flux_evidence
            else {}
        ),
    }


def plain_flux_map(evidence: FluxEvidence) -> PlainData:
    """Fit and asymmetry of the flux map of one file, in Wb, A, N m and rad.

    The asymmetry is None for a half plane.
    """
    fit, found = evidence.fit, evidence.asymmetry
    rms, most = evidence.torque_residual
    plain = asdict(fit) | {"torque_rms": rms, "torque_largest": most}
    asymmetry = None
    if found is not None:
        asymmetry = asdict(found) | {
            "torque": found.torque,
            "share": found.share,
            "share_left": found.share_left,
        }
    return {"file": evidence.source, "fit": plain, "asymmetry": asymmetry}
