"""Inductances that current loops are tuned for, and their range over the currents."""

from __future__ import annotations

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus


def tuning_inductances(machine: Machine, i_max: float) -> tuple[float, float]:
    """Inductances (l_d, l_q) in H that current loops are tuned for.

    Those of a saturated machine are the least incremental ones along its MTPA locus up to ``i_max``
    A: a loop is fastest there, so that it is slower and has more margin everywhere else.
    """
    return inductance_range(machine, i_max)[0]


def inductance_range(
    machine: Machine, i_max: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest incremental inductances (l_d, l_q) in H along the
    MTPA locus up to ``i_max`` A.

    Parameters
    ----------
    machine:
        Any machine.
    i_max:
        Current limit in A (peak).
    """
    if isinstance(machine, LinearMachine):
        return (machine.l_d, machine.l_q), (machine.l_d, machine.l_q)
    locus = mtpa_locus(machine, i_max)
    jet = machine.jet(locus.i_d, locus.i_q)
    least, largest = ((float(of(jet.l_dd)), float(of(jet.l_qq))) for of in (np.min, np.max))
    return least, largest
