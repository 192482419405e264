"""Losses that a flux-map file gives beside its points: a total in W, or by an efficiency."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.flux_map_files.coordinates import Parts
from dqforge.machines.flux_maps.flux_points import FileLoss
from dqforge.machines.flux_maps.torque_check import SQUARED
from dqforge.machines.names import FluxScaling

_PER_CENT = 1.5  # Largest efficiency beyond which a column without a unit is in per cent.


def loss_of(
    parts: Parts, chosen: Mapping[str, NamedArray], scaling: FluxScaling
) -> FileLoss | None:
    """Total loss of the machine at each point, None where the file tells none.

    An efficiency makes it with the mechanical power, or with the electrical one; only of a machine
    that drives.
    """
    if "loss" in parts:
        return FileLoss(chosen["loss"].path, parts["loss"])
    if "efficiency" not in parts or "speed" not in parts:
        return None
    share = parts["efficiency"]
    if float(np.nanmax(share, initial=0.0)) > _PER_CENT:
        share = 1e-2 * share
    usual = (share > 0.0) & (share <= 1.0)
    if "torque" in parts:
        power = parts["torque"] * parts["speed"]
        loss = power * (1.0 / np.where(usual, share, np.nan) - 1.0)
    elif "frequency" in parts:  # psi_d and psi_q are still voltages over it
        power = (
            1.5
            * SQUARED[scaling]
            * parts["frequency"]
            * (parts["psi_d"] * parts["i_q"] - parts["psi_q"] * parts["i_d"])
        )
        loss = power * (1.0 - np.where(usual, share, np.nan))
    else:
        return None
    return FileLoss(f"by {chosen['efficiency'].path}", np.where(power > 0.0, loss, np.nan))
