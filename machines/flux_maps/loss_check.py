"""The loss that a flux-map file gives, held against the copper loss that the design makes of its
currents: what remains is iron, magnet and mechanical loss, and never negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.units.quantities import format_quantity

_ROUNDING = 0.01  # Negative rest over the loss that digits of a file may make.


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLoss:
    """Loss of a file in W, shape (K,), NaN where it is unknown, at currents in A (peak, d along
    the magnets); ``name`` says where it is from.
    """

    name: str
    values: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def loss_findings(measured: MeasuredLoss, r_s: float) -> tuple[str, ...]:
    """What remains of a file's loss without the copper loss 3/2 R i^2, in a sentence, with a
    warning where that is negative; ``r_s`` in Ohm is that of a phase.
    """
    given = measured.values
    copper = 1.5 * r_s * (measured.i_d**2 + measured.i_q**2)
    known = np.isfinite(given) & np.isfinite(copper)
    if not known.any():
        return ()
    rest, loss = (given - copper)[known], given[known]
    low, high, least, most = (
        format_quantity(float(value), "W", 3)
        for value in (np.min(loss), np.max(loss), np.min(rest), np.max(rest))
    )
    where = f"R = {format_quantity(r_s, 'Ohm', 4)} of the design"
    about = (
        f"the loss of the file ({measured.name}) is {low} to {high} at {loss.size} points; "
        f"without the copper loss of {where} there remain {least} to {most}; it is compared, and "
        "no loss of the machine is made of it"
    )
    below = rest < -_ROUNDING * np.abs(loss)
    if not below.any():
        return (about,)
    worst = np.flatnonzero(known)[int(np.argmin(rest))]
    return (
        about,
        (
            f"warning: at {np.count_nonzero(below)} of {loss.size} points the file has less loss "
            f"than the copper loss of {where}, by up to {least.lstrip('-')} at i_d = "
            f"{measured.i_d[worst]:g} A, i_q = {measured.i_q[worst]:g} A (peak); check the "
            "resistance, its temperature, and the column"
        ),
    )
