"""Which factor of a flux map a key of a study changes, found by scaling one map to the other."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.scaled_machines import ScaledMachines

# Columns of `ScaledMachines` that are factors of the map.
SCALE_FIELDS = ("magnet", "inductance_d", "inductance_q", "current")
SCALED_FIELDS = (*SCALE_FIELDS, "r_s", "i_max")  # All its columns.
_EQUAL = 1e-12


def scale_between(first: SaturatedMachine, last: SaturatedMachine, ratio: float) -> str | None:
    """The one factor by which the map of a machine is another's; None where it is none.

    Args:
        first, last: The machines.
        ratio: What the factor would have to be.
    """
    for name in SCALE_FIELDS:
        scaled = ScaledMachines.varied(first, 1, {name: np.array([ratio])}).machine(0)
        if _same_map(scaled.flux_map, last.flux_map):
            return name
    return None


def _same_map(first: FluxMap, last: FluxMap) -> bool:
    """Whether maps are the same but for rounding, with the data that they have."""
    pairs = [(getattr(first, name), getattr(last, name)) for name in _TABLES]
    if first.extrapolate != last.extrapolate or (first.hull is None) != (last.hull is None):
        return False
    if first.hull is not None and last.hull is not None:
        pairs += [
            (first.hull.corner_d, last.hull.corner_d),
            (first.hull.corner_q, last.hull.corner_q),
        ]
    return all(_close(one, other) for one, other in pairs)


_TABLES = ("i_d", "i_q", "psi_d", "psi_q")


def _close(one: FloatArray, other: FloatArray) -> bool:
    if one.shape != other.shape:
        return False
    apart = float(np.max(np.abs(one - other), initial=0.0))
    return apart <= _EQUAL * float(np.max(np.abs(other), initial=0.0))
