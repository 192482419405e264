"""Machines whose flux maps end before the current limit, on one side or another, for the tests."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import CurrentRegion

I_MAX = 50.0
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
_SIDES = {
    "ends at i_d = 0": (-I_MAX, 0.0),
    "begins at i_d = 0": (0.0, I_MAX),
    "ends at 5 A": (-I_MAX, 5.0),
}
_HULLS = {
    "cut at a corner": (
        np.array([-50.0, -50.0, -25.0, 50.0, 50.0]),
        np.array([0.0, 18.0, 32.0, 45.0, 0.0]),
    ),
    "disc beside zero": (-10.0 + 40.0 * np.cos(_CIRCLE), 40.0 * np.sin(_CIRCLE)),
    "small disc": (-8.0 + 14.0 * np.cos(_CIRCLE), 20.0 * np.sin(_CIRCLE)),
}
KINDS = (*_SIDES, "i_q is short", *_HULLS)  # Where the data may end.

# l_d and l_q in H at zero current, and how much they saturate.
INDUCTANCES = (
    (0.5e-3, 0.25e-3, 0.0),
    (0.25e-3, 0.6e-3, 0.0),
    (0.4e-3, 0.4e-3, 0.0),
    (0.3e-3, 0.8e-3, 1.0),
)


def one_sided(
    kind: str, l_d: float, l_q: float, saturation: float, *, extrapolate: bool = False
) -> SaturatedMachine:
    """A machine of 50 mWb and 50 A whose map ends where ``kind`` says; "everywhere" covers all
    currents.
    """
    low, high = _SIDES.get(kind, (-I_MAX, I_MAX))
    end = 30.0 if kind == "i_q is short" else I_MAX
    hull = CurrentRegion.hull(*_HULLS[kind]) if kind in _HULLS else None
    d, q = np.linspace(low, high, 21), np.linspace(-end, end, 41)
    i_d, i_q = np.meshgrid(d, q, indexing="ij")
    psi_d = (
        0.05
        + l_d * i_d / np.sqrt(1.0 + saturation * (i_d / 50.0) ** 2)
        - saturation * 2e-6 * i_q**2
    )
    psi_q = (
        l_q * i_q / np.sqrt(1.0 + saturation * (i_q / 40.0) ** 2) - saturation * 4e-6 * i_d * i_q
    )
    return SaturatedMachine(3, 0.05, FluxMap(d, q, psi_d, psi_q, extrapolate, hull), I_MAX)


def measured_currents(machine: SaturatedMachine, count: int = 301) -> tuple[FloatArray, FloatArray]:
    """Currents in A all over what is measured within the current limit, its edges included."""
    even = np.linspace(-I_MAX, I_MAX, count)
    grid_d, grid_q = (part.ravel() for part in np.meshgrid(even, even, indexing="ij"))
    region = machine.flux_map.region
    share = np.linspace(0.0, 1.0, 1001)
    ends = np.roll(region.corner_d, -1), np.roll(region.corner_q, -1)
    edge_d = (region.corner_d + share[:, np.newaxis] * (ends[0] - region.corner_d)).ravel()
    edge_q = (region.corner_q + share[:, np.newaxis] * (ends[1] - region.corner_q)).ravel()
    i_d, i_q = np.append(grid_d, edge_d), np.append(grid_q, edge_q)
    kept = (region.beyond(i_d, i_q) <= 1e-9) & (np.hypot(i_d, i_q) <= I_MAX * (1.0 + 1e-9))
    return i_d[kept], i_q[kept]
