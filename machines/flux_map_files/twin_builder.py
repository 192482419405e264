"""Equivalent circuits that Motor-CAD and Maxwell extract for Ansys Twin Builder (ECE):
tables over currents and angle.

Between the marks B_Sweepings and E_Sweepings stand both axes of currents and that of the rotor
angle, between B_OutputMatrix and E_OutputMatrix one row per point: index, d, q and zero-sequence
flux linkage, torque.
"""

from __future__ import annotations

import math
import re

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray

_AXIS = re.compile(r"\(\s*(\d+)\s*:([^()]*)\)")


_POLES = re.compile(r"^\s*Poles\s+(\d{1,3})\s*$", re.MULTILINE)


_COLUMNS = 5


def is_twin_builder(text: str) -> bool:
    """Whether a text is such a table."""
    return "B_OutputMatrix" in text and "B_Sweepings" in text


def twin_builder_arrays(text: str, source: str) -> list[NamedArray]:
    """Arrays i_d, i_q, angle (rad), psi_d, psi_q and torque of all points, shape (K,)."""
    sweeps = _between(text, "Sweepings", source)
    axes = []
    for count, numbers in _AXIS.findall(sweeps):
        try:
            axis = np.array([float(part) for part in numbers.split()])
        except ValueError:
            raise InputError(
                "an axis holds text among its numbers; export the table again", source=source
            ) from None
        if axis.size != int(count):
            raise InputError(
                f"an axis of {count} values has {axis.size}; export the table again", source=source
            )
        axes.append(axis)
    if len(axes) != 3:
        raise InputError(
            f"the table has {len(axes)} axes, not i_d, i_q and the rotor angle", source=source
        )
    rows = [
        line.split()
        for line in _between(text, "OutputMatrix", source).split("\n")[1:]
        if line.strip()
    ]
    first = text.count("\n", 0, text.index("B_OutputMatrix")) + 2
    for number, row in enumerate(rows, first):
        if len(row) != _COLUMNS:
            raise InputError(
                f"this row has {len(row)} numbers, not {_COLUMNS}", source=source, line=number
            )
    size = math.prod(axis.size for axis in axes)
    if len(rows) != size:
        raise InputError(
            f"the table has {len(rows)} rows, its axes make {size} points", source=source
        )
    try:
        table = np.array(rows, dtype=float)
    except ValueError as error:
        raise InputError(
            f"the table holds text among numbers ({error})"[:200], source=source, line=first
        ) from None
    i_d, i_q, angle = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
    lines = np.arange(first, first + size)
    # The torque of the circuit acts on its shaft port and counts against the motion.
    parts = {
        "i_d": i_d,
        "i_q": i_q,
        "angle": np.radians(angle),
        "psi_d": table[:, 1],
        "psi_q": table[:, 2],
    }
    parts["torque"] = -table[:, 4] + 0.0
    arrays = [NamedArray(name, name, values, lines=lines) for name, values in parts.items()]
    if poles := _POLES.search(text):
        arrays.append(NamedArray("poles", "poles", np.array([float(poles[1])])))
    return arrays


def _between(text: str, name: str, source: str) -> str:
    """What stands between the begin and the end mark of a part."""
    begin, end = text.find(f"B_{name}"), text.find(f"E_{name}")
    if not 0 <= begin < end:
        raise InputError(
            f"the part {name} is not closed by E_{name}; export the table again", source=source
        )
    return text[begin:end]
