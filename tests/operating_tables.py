"""Operating points as vendors publish them: every speed by every share of the largest current,
at most torque within the voltage, made from a saturated machine that is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from saturated import ArctanMachine

from dqforge.machines.arrays import FloatArray

# 21 N m at 148 A, as a drive of a wheel hub is.
VENDOR = ArctanMachine(
    pole_pairs=5,
    r_s=0.1,
    i_max=148.0,
    psi_m=0.0265,
    a_d=0.05,
    b_d=250.0,
    a_q=0.039,
    b_q=150.0,
    c=3e-8,
)


@dataclass(frozen=True)
class OperatingTable:
    """Points over speeds (rows) and shares of the largest current (columns), peak values in SI."""

    speed: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    v_d: FloatArray
    v_q: FloatArray
    torque: FloatArray
    copper: FloatArray
    iron: FloatArray


def operating_table(
    machine: ArctanMachine = VENDOR,
    speeds: int = 41,
    shares: int = 15,
    top: float = 2100.0,
    v_max: float = 330.0,
) -> OperatingTable:
    """A table from standstill to ``top`` rad/s; where the largest current does not fit into
    ``v_max`` (peak of phase), shares of the largest one that does, along MTPV.
    """
    speed = np.linspace(0.0, top, speeds)
    angle = np.linspace(0.5 * np.pi, np.pi, 721)
    size = np.linspace(0.0, machine.i_max, 75)
    i_d, i_q = (np.multiply.outer(size, part) for part in (np.cos(angle), np.sin(angle)))
    psi_d, psi_q = machine.flux(i_d, i_q)
    torque = 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
    rows = []
    for omega_m in speed:
        omega = machine.pole_pairs * omega_m
        v = np.hypot(machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d)
        fits = v <= v_max
        reached = int(np.flatnonzero(fits.any(axis=1))[-1])
        picked = np.round(np.linspace(0.0, reached, shares)).astype(int)
        best = np.argmax(np.where(fits, torque, -np.inf), axis=1)
        first = int(np.argmax(fits.any(axis=1)))  # at high speed, no current does not fit
        rows.append(np.stack([np.maximum(picked, first), best[np.maximum(picked, first)]]))
    at = np.stack(rows)  # speeds, 2, shares
    i_d, i_q = i_d[at[:, 0], at[:, 1]], i_q[at[:, 0], at[:, 1]]
    psi_d, psi_q = machine.flux(i_d, i_q)
    omega_m = np.broadcast_to(speed[:, np.newaxis], i_d.shape)
    omega = machine.pole_pairs * omega_m
    return OperatingTable(
        omega_m,
        i_d,
        i_q,
        psi_d,
        psi_q,
        machine.r_s * i_d - omega * psi_q,
        machine.r_s * i_q + omega * psi_d,
        1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d),
        1.5 * machine.r_s * (i_d**2 + i_q**2),
        20.0 * (omega_m / 1000.0) * (1.0 + np.hypot(psi_d, psi_q) / 0.03),
    )
