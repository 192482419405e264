"""Windings in delta: what can be converted to the equivalent star, and what cannot.

Seen from its terminals a delta without zero sequence is a star
(`dqforge.machines.design.design`). A zero sequence of the back-EMF short-circuits itself
in the delta, and its current is in no terminal: the star knows nothing of it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Reading
from dqforge.machines.design.sections.machine.flux_map_schema import FluxMapSection
from dqforge.machines.design.sections.machine.schema import MachineSection

if TYPE_CHECKING:
    from dqforge.machines.flux_maps.flux_points import FluxPoints


_SQRT3 = math.sqrt(3.0)


def check_connection(section: MachineSection, reading: Reading) -> None:
    """Refuse what a delta cannot have or leaves open, and tell what was converted.

    Raises:
        InputError: The model is one in phase quantities or by coefficients, or a flux map does not
            say what it holds.
    """
    given = section.flux_map
    if section.connection == "star":
        if given is not None and given.quantities is not None:
            message = (
                "machine.flux_map.quantities is for windings in delta; write connection: delta, or "
                "remove it"
            )
            raise reading.document.error(message, ("machine", "flux_map", "quantities"), key=True)
        return
    if section.model in _REFUSED:
        raise reading.document.error(
            f"machine.connection: delta does not go with model: {section.model}; "
            f"{_REFUSED[section.model]}",
            ("machine", "connection"),
        )
    if given is not None and given.quantities is None:
        raise reading.document.error(
            "machine.flux_map: in a delta the flux linkages and currents of windings are not those "
            "of lines; write quantities: winding (of finite elements, mostly) or quantities: line "
            "(as measured at the terminals)",
            ("machine", "flux_map"),
            key=True,
        )
    reading.remarks.append(
        "machine.connection is delta: its data are converted to the star that acts alike at the "
        "terminals; the angle counts from phase a of that star, 30 deg (electrical) behind the "
        "winding between terminals a and b"
    )
    reading.remarks.append(
        "the back-EMF of the delta is taken as sinusoidal: harmonics of orders 3, 9, 15, ... drive "
        "a current around it that no terminal carries, and whose loss and torque are not counted"
    )


_REFUSED = {
    "waveform": (
        "harmonics of orders 3, 9, 15, ... of its back-EMF drive a current around the delta that "
        "no terminal carries and that this program does not compute; write the line-to-line "
        "back-EMF over sqrt(3) as a star"
    ),
    "saturation": "published coefficients belong to the star; write connection: star",
}


def at_the_terminals(points: FluxPoints, section: FluxMapSection) -> FluxPoints:
    """Points of a flux map in quantities of lines: of windings in delta sqrt(3) i and psi /
    sqrt(3).
    """
    if section.quantities != "winding":
        return points
    return replace(
        points,
        i_d=points.i_d * _SQRT3,
        i_q=points.i_q * _SQRT3,
        psi_d=points.psi_d / _SQRT3,
        psi_q=points.psi_q / _SQRT3,
    )
