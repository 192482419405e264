"""Losses and junction temperature over the time of Figure 5 of paper 000.

Losses follow the currents and the speed of the simulated runs, with the switching energy that
Table 4's first column gives. The paper states neither thermal resistance nor coolant nor a time
constant. The first two follow from its three temperatures (0.306 K/W a switch over 64 degC); the
time constant is assumed, and how far Table 4's instant depends on it is told.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import drive_budget
from dqforge.reports.papers.paper000.load_test import ALTERNATIVES, LoadTest
from dqforge.reports.papers.paper000.loss_columns import PRINTED_TABLE_4, calibrated_inverter

TIME_CONSTANT = 0.1  # Of junction against coolant in s: assumed.

# The largest time constant in s with which the last 0.1 s still are Table 4's steady state.
SLOWEST = 0.4
SWITCHES = 6
_POINTS = 1200


@dataclass(frozen=True, slots=True, eq=False)
class HeatCurve:
    """One alternative over time, arrays of shape (N,): losses in W, temperature in degC.

    ``total``, ``junction`` and ``slow_junction`` are the means of the loss and the largest
    temperatures between 5.9 and 6 s, the last with the slowest time constant; beside the printed
    ones.
    """

    name: str
    t: FloatArray
    machine_loss: FloatArray
    inverter_loss: FloatArray
    junction_temperature: FloatArray
    total: float
    junction: float
    slow_junction: float
    printed_total: float
    printed_junction: float

    @property
    def loss(self) -> FloatArray:
        """Whole loss in W."""
        return self.machine_loss + self.inverter_loss


def warmed(
    time: FloatArray, loss: FloatArray, resistance: float, ambient: float, constant: float
) -> FloatArray:
    """Temperature in degC behind one resistance and one capacity, from the ambient one on.

    Args:
        time, loss: Instants in s, evenly spaced, and the loss in W that flows from each to the
            next, shape (N,).
        resistance, ambient, constant: Thermal resistance in K/W, temperature in degC, time constant
            in s.
    """
    left = np.exp(-np.diff(time) / constant)
    rise = np.zeros_like(loss)
    for k, (share, watts) in enumerate(zip(left, loss[:-1], strict=True)):
        rise[k + 1] = share * rise[k] + (1.0 - share) * resistance * watts
    return ambient + rise


def _curve(design: Design, inverter: Inverter, test: LoadTest, alternative: int) -> HeatCurve:
    run, column = test.run, PRINTED_TABLE_4[alternative]
    few = slice(None, None, max(1, run.t.size // _POINTS))
    modulation = ALTERNATIVES[alternative][2]
    found = drive_budget(
        design.machine, inverter, run.i_d[few], run.i_q[few], run.omega_m[few], (modulation,)
    )
    heat = (found.conduction + found.dead_time + found.switching)[0, 0]
    whole = found.total[0, 0]
    device = inverter.device
    if device is None:
        raise InputError(f"{design.name}: its inverter has no device")
    time, resistance = run.t[few], device.thermal_resistance / SWITCHES
    fast, slow = (
        warmed(time, heat, resistance, inverter.coolant_temperature, constant)
        for constant in (TIME_CONSTANT, SLOWEST)
    )
    last = time >= 5.9
    return HeatCurve(
        name=test.name,
        t=time,
        machine_loss=whole - heat,
        inverter_loss=heat,
        junction_temperature=fast,
        total=float(np.mean(whole[last])),
        junction=float(np.max(fast[last])),
        slow_junction=float(np.max(slow[last])),
        printed_total=column[2],
        printed_junction=column[3],
    )


def heat_curves(design: Design, tests: Sequence[LoadTest]) -> tuple[HeatCurve, ...]:
    """Losses and temperatures of all alternatives.

    Args:
        design: The drive.
        tests: Its runs, in the order of `ALTERNATIVES`.
    """
    inverter = calibrated_inverter(design)
    return tuple(_curve(design, inverter, test, k) for k, test in enumerate(tests))
