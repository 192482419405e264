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
class FileLoss:
    """Loss that a file gives beside its flux linkages, in W of the whole machine, shape (K,),
    NaN where it is unknown; in words where it is from.
    """

    name: str
    values: FloatArray


@dataclass(frozen=True, slots=True)
class FluxPoints:
    """Points of a flux map as a file holds them, in its own axes and scaling but in A and Wb,
    arrays of shape (K,).

    ``lines`` are the lines of a text that the points stand in, ``claimed`` is what its names say of
    the scaling, ``findings`` are sentences on what the reader did, ``others`` the further arrays of
    numbers that nobody used. Points closer than ``blur`` times the largest current are one.
    ``pole_pairs`` is what the file says of them, 0 where it does not; ``ignored`` is the torque
    that nobody wants compared.
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
    loss: FileLoss | None = field(default=None, kw_only=True)
    blur: float = field(default=0.0, kw_only=True)
    pole_pairs: int = field(default=0, kw_only=True)
    ignored: str = field(default="", kw_only=True)
