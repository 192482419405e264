"""Flux maps of known machines with noise, as files that designs name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine

NOISE = 0.01  # Standard deviation over the largest flux linkage of the same axis.


def grid_points(
    machine: Machine, shape: tuple[int, int] = (21, 27), *, half: bool = False
) -> tuple[FloatArray, ...]:
    """Points (i_d, i_q, psi_d, psi_q) of a grid up to 1.05 times the current limit,
    each of shape (K,).
    """
    end = 1.05 * machine.i_max
    i_d = np.linspace(-end, end, shape[0])
    i_q = np.linspace(0.0 if half else -end, end, shape[1])
    at_d, at_q = (part.ravel() for part in np.meshgrid(i_d, i_q, indexing="ij"))
    return at_d, at_q, *machine.flux(at_d, at_q)


def scattered_points(machine: Machine, count: int, seed: int) -> tuple[FloatArray, ...]:
    """Points spread at random over the same square."""
    at_d, at_q = np.random.default_rng(seed).uniform(-1.05, 1.05, (2, count)) * machine.i_max
    return at_d, at_q, *machine.flux(at_d, at_q)


def noisy(
    points: tuple[FloatArray, ...], seed: int, share: float = NOISE
) -> tuple[FloatArray, ...]:
    """The same points with normal noise of both flux linkages."""
    random = np.random.default_rng(seed)
    i_d, i_q, *fluxes = points
    return (
        i_d,
        i_q,
        *(psi + share * np.max(np.abs(psi)) * random.standard_normal(psi.size) for psi in fluxes),
    )


def mapped_design(
    folder: Path,
    machine: Machine,
    points: tuple[FloatArray, ...],
    *,
    keys: str = "",
    control: str | None = None,
) -> Path:
    """A design file whose machine is given by points of its flux map; ``keys`` go into flux_map."""
    table = np.column_stack(points)
    header = "id_A,iq_A,psi_d_Vs,psi_q_Vs"
    np.savetxt(folder / "map.csv", table, delimiter=",", header=header, comments="", fmt="%.12g")
    loops = (
        "control:\n  current_loop: {method: bandwidth, bandwidth: 300 Hz}\n"
        if control is None
        else control
    )
    text = f"""\
dqforge: 1
name: Mapped
machine:
  model: flux-map
  pole_pairs: {machine.pole_pairs}
  resistance: {{value: {machine.r_s!r} Ohm, kind: phase}}
  flux_map: {{file: map.csv{keys}}}
  max_current: {{value: {machine.i_max!r} A, kind: peak}}
  max_speed: 3000 rpm
inverter:
  v_dc: 400 V
  switching_frequency: 10 kHz
{loops}export: {{prefix: mapped}}
"""
    path = folder / "design.yaml"
    path.write_text(text, encoding="utf-8")
    return path
