"""Fixed gains of the current loops on other machines than they were made for.

The loop sees the machine's resistance and inductance. Firmware that does not measure its DC link
divides by the voltage it was told of, so that a voltage that is higher by a factor raises the gain
of both loops by that factor.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.errors import InputError
from dqforge.optimizer.loops.loop_axes.current_loop_axis import given_current_loops
from dqforge.optimizer.yields.fixed_header import FixedHeader, FixedLoop
from dqforge.optimizer.yields.reference_yield import Machines, ReferencePoints

LOOPS = ("i_d", "i_q")  # Loops of a header whose gains are judged on every machine.

# What is known of each of them: rad, a factor, s, rad/s, a factor, and 1 or 0.
MARGINS = (
    "phase_margin",
    "gain_margin",
    "delay_margin",
    "crossover",
    "max_sensitivity",
    "stable",
)


def fixed_loop(header: FixedHeader, loop: str) -> FixedLoop:
    """Gains of a loop of the header.

    Args:
        header: The header.
        loop: ``i_d`` or ``i_q``.

    Raises:
        InputError: The header has no such loop.
    """
    found: FixedLoop | None = getattr(header, loop) if loop in LOOPS else None
    if found is None:
        raise InputError(
            f"gains.{loop}: a header's gains are judged on drawn machines for the current loops "
            "i_d and i_q; write gains.i_d.phase_margin or gains.i_q.phase_margin"
            if loop not in LOOPS
            else f"gains.{loop}: the header has no loops in rotor coordinates; leave gains out"
        )
    return found


def axis_inductance(loop: str, machines: Machines, points: ReferencePoints) -> FloatArray:
    """Inductance in H that a loop sees in every machine, shape (N,): of flux maps the least
    incremental one at rest and at the header's currents, where the loop is fastest.

    Args:
        loop: ``i_d`` or ``i_q``.
        machines: N machines.
        points: Currents of the header.
    """
    if isinstance(machines, MachineBatch):
        return machines.l_d if loop == "i_d" else machines.l_q
    i_d, i_q = (np.append(0.0, values)[:, np.newaxis] for values in (points.i_d, points.i_q))
    jet = machines.jet(i_d + np.zeros(machines.count), i_q + np.zeros(machines.count))
    return np.asarray(np.min(jet.l_dd if loop == "i_d" else jet.l_qq, axis=0))


def loop_outputs(
    fixed: FixedLoop,
    r_s: FloatArray,
    inductance: FloatArray,
    voltage_ratio: FloatArray | float,
) -> dict[str, FloatArray]:
    """Margins of one loop on every machine, by their names in `MARGINS`, arrays of shape (N,);
    NaN where the loop is not stable.

    Args:
        fixed: Gains of the loop.
        r_s: Phase resistance in Ohm of every machine, shape (N,).
        inductance: Inductance in H that the loop sees, shape (N,).
        voltage_ratio: DC-link voltage that they have over the one the loops were designed for, one
            number or shape (N,).
    """
    margins = given_current_loops(
        r_s, inductance, fixed.t_s, fixed.kp, fixed.ki, voltage_ratio
    ).margins
    found = {name: getattr(margins, name) for name in MARGINS if name != "stable"}
    return {name: np.where(margins.stable, found[name], np.nan) for name in found} | {
        "stable": margins.stable.astype(np.float64)
    }


def least_phase_margin(found: dict[str, dict[str, FloatArray]]) -> FloatArray:
    """Least phase margin in rad over the loops, shape (N,); NaN where one is not stable.

    Args:
        found: What `loop_outputs` gives, by loop.
    """
    return np.asarray(np.min([loop["phase_margin"] for loop in found.values()], axis=0))
