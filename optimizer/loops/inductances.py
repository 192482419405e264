"""Inductances that current loops are tuned for, and their range over the currents."""

from __future__ import annotations

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus


def inductance_range(
    machine: Machine, i_max: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest incremental inductances (l_d, l_q) in H along the
    MTPA locus up to ``i_max`` A.

    Current loops are tuned for the least ones: a loop is fastest there, so that it is slower and
    has more margin everywhere else.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
    """
    if isinstance(machine, LinearMachine):
        return (machine.l_d, machine.l_q), (machine.l_d, machine.l_q)
    locus = mtpa_locus(machine, i_max)
    jet = machine.jet(locus.i_d, locus.i_q)
    least, largest = ((float(of(jet.l_dd)), float(of(jet.l_qq))) for of in (np.min, np.max))
    return least, largest
