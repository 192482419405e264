"""Voltage error of an inverter over the current: a law with few numbers, or a table.

sign(i) is never taken: below a few tenths of an ampere the output capacitance of the switches
stretches the edges, and the error falls smoothly to zero.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import regress
from dqforge.optimizer.identification.parameters import (
    Analysis,
    Parameter,
    RunResiduals,
    judged,
    unknown,
)


@dataclass(frozen=True, slots=True)
class InverterTable:
    """Rows of a run: current (A) and error of the voltage (V), shape (N,)."""

    run: str
    current: FloatArray
    voltage: FloatArray


# Laws V(i) = V0 shape(i/width) + R i, by name.
_LAWS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "tanh": np.tanh,
    "2/pi atan": lambda x: np.asarray(2.0 / np.pi * np.arctan(x)),
    "i/(|i| + width)": lambda x: np.asarray(x / (1.0 + np.abs(x))),
}
_LEAST_POINTS = 8
# A law must come this near to the table: its three numbers are then worth more than the points.
_NEAR = 1.1
_V0 = ("inverter_voltage", "voltage error of the inverter along the current", "V")
_WIDTH = ("inverter_width", "current over which it comes", "A")
_SERIES = ("inverter_resistance", "resistance in series with it", "Ohm")
_DEAD = ("dead_time", "dead time", "s")


def table_fault(table: InverterTable) -> str:
    """Why a table says nothing, '' where it does."""
    if table.current.size < _LEAST_POINTS:
        return f"{table.current.size} points; a law needs {_LEAST_POINTS}"
    if np.unique(table.current).size < _LEAST_POINTS:
        return f"fewer than {_LEAST_POINTS} different currents; vary it"
    if float(np.ptp(table.voltage)) == 0.0:
        return "the voltage is the same at all currents"
    return ""


@dataclass(frozen=True, slots=True)
class _Law:
    """A law: V0 (V), width (A), R (Ohm), their covariance and what it leaves (V)."""

    name: str
    values: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    freedom: float

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residuals**2)))


def _fit(table: InverterTable, name: str) -> _Law:
    shape, current, voltage = _LAWS[name], table.current, table.voltage
    largest = float(np.max(np.abs(current)))

    def left(unknowns: FloatArray) -> FloatArray:
        size, log_width, series = unknowns
        return np.asarray(size * shape(current / np.exp(log_width)) + series * current - voltage)

    start = [float(np.max(np.abs(voltage))), np.log(0.1 * largest), 0.0]
    low = [-np.inf, np.log(1e-4 * largest), -np.inf]
    high = [np.inf, np.log(10.0 * largest), np.inf]
    found = least_squares(
        left,
        start,
        bounds=(low, high),
        x_scale=[max(start[0], 1e-9), 1.0, max(start[0], 1e-9) / largest],
        loss="soft_l1",
        f_scale=max(float(np.std(voltage)), 1e-9),
    )
    # The errors are those of the law made straight at its best values, neighbours correlated.
    order = np.argsort(current, kind="stable")
    straight = regress(
        found.jac[order], left(found.x)[order], np.zeros(current.size, dtype=np.intp), robust=False
    )
    width = float(np.exp(found.x[1]))
    scale = np.array([1.0, width, 1.0])
    values = np.array([found.x[0], width, found.x[2]])
    return _Law(
        name,
        values,
        straight.covariance * np.outer(scale, scale),
        -left(found.x),
        straight.freedom,
    )


def _table_rms(table: InverterTable) -> float:
    """R.m.s. error of a table, each point from the line between its neighbours."""
    order = np.argsort(table.current, kind="stable")
    current, voltage = table.current[order], table.voltage[order]
    share = (current[1:-1] - current[:-2]) / np.maximum(current[2:] - current[:-2], 1e-12)
    between = voltage[:-2] + share * (voltage[2:] - voltage[:-2])
    return float(np.sqrt(np.mean((voltage[1:-1] - between) ** 2)))


def analyse_table(table: InverterTable) -> Analysis:
    """The law, or the table, that describes points that `table_fault` has nothing against."""
    laws = [_fit(table, name) for name in _LAWS]
    best = min(laws, key=lambda law: law.rms)
    as_table = _table_rms(table)
    taken = best.name if best.rms <= _NEAR * as_table else "the table itself"
    tried = ", ".join(f"{law.name} {1e3 * law.rms:.3g} mV" for law in laws)
    remarks = [
        (
            f"{table.run}: {taken} is taken; left in r.m.s.: {tried}, a table {1e3 * as_table:.3g} "
            "mV (each point from its neighbours)"
        )
    ]
    parameters: list[Parameter] = [
        judged(
            named,
            float(best.values[place]),
            float(np.sqrt(best.covariance[place, place])),
            best.freedom,
            runs=(table.run,),
            may_vanish=named is _SERIES,
        )
        for place, named in enumerate((_V0, _WIDTH, _SERIES))
    ]
    why = "not separable from the drop of the devices at one DC-link voltage; run another"
    parameters.append(unknown(_DEAD, why))
    whole = np.full((4, 4), np.nan)
    whole[:3, :3] = best.covariance
    left = RunResiduals(
        table.run,
        "voltage",
        "V",
        best.rms,
        table.current.size,
        best.freedom + 3.0,
        best.residuals,
    )
    terms = (f"V0 {best.name}(i/width) + R i",)
    return Analysis("inverter-table", tuple(parameters), whole, (left,), tuple(remarks), (), terms)
