"""Axes and scaling of the points of a flux map: what a file means, and what was done about it."""

from __future__ import annotations

import math
from dataclasses import replace

from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.names import FluxAxes, FluxScaling

_TO_PEAK: dict[FluxScaling, float] = {
    "peak": 1.0,
    "rms": math.sqrt(2.0),
    "power-invariant": math.sqrt(2.0 / 3.0),
}


def converted(points: FluxPoints, axes: FluxAxes, scaling: FluxScaling) -> FluxPoints:
    """Points with the d axis along the magnets and in peak values, from the axes
    and the scaling of a file.
    """
    factor = _TO_PEAK[scaling]
    i_d, i_q, psi_d, psi_q = (
        factor * part for part in (points.i_d, points.i_q, points.psi_d, points.psi_q)
    )
    if axes == "reluctance":
        i_d, i_q, psi_d, psi_q = -i_q, i_d, -psi_q, psi_d
    return replace(points, i_d=i_d, i_q=i_q, psi_d=psi_d, psi_q=psi_q)


def scaling_of_points(
    points: FluxPoints, given: FluxScaling | None
) -> tuple[FluxScaling, tuple[str, ...]]:
    """Scaling of points, by what is given and what their names say, and a sentence
    where only the names say it.
    """
    if not points.claimed or points.claimed == given:
        return given or "peak", ()
    if given is not None:
        raise InputError(
            f"the names in the file say {points.claimed} values, which is not scaling: {given}; "
            f"write scaling: {points.claimed}, or correct the names",
            source=points.source,
        )
    return points.claimed, (
        f"currents and flux linkages are {points.claimed} values, as the names in the file say",
    )


def conversion_findings(axes: FluxAxes, scaling: FluxScaling) -> tuple[str, ...]:
    """What the conversion did, in sentences."""
    turned = (
        (
            "the axes were turned so that d lies along the magnets (i_d = -i_q and i_q = i_d of "
            "the file)"
        ),
    )
    scaled = (
        (
            f"currents and flux linkages were multiplied by {_TO_PEAK[scaling]:.4f} ({scaling} to "
            "peak)"
        ),
    )
    return (turned if axes == "reluctance" else ()) + (scaled if scaling != "peak" else ())
