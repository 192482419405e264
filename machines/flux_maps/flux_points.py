"""Points of a flux map as a file holds them."""

from __future__ import annotations

from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class FileTorque:
    """Torque that a file gives beside its flux linkages, in N m, shape (K,),
    NaN where it is unknown.
    """

    name: str
    values: FloatArray
    per_pole_pair: bool = False


@dataclass(frozen=True, slots=True)
class FluxPoints:
    """Points of a flux map as a file holds them, in its own axes and scaling but in A and Wb,
    arrays of shape (K,).

    ``lines`` are the lines of a text that the points stand in, ``claimed`` is what its names say of
    the scaling, ``findings`` are sentences on what the reader did, ``others`` names of a few
    further columns.
    """

    source: str
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    torque: FileTorque | None = field(default=None, kw_only=True)
    lines: NDArray[np.intp] | None = field(default=None, kw_only=True)
    claimed: Literal["", "peak", "rms"] = field(default="", kw_only=True)
    findings: tuple[str, ...] = field(default=(), kw_only=True)
    others: tuple[str, ...] = field(default=(), kw_only=True)
