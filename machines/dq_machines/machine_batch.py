"""Many machines with constant inductances as one: their constants as columns, one place each.

What a study draws or varies of a linear machine goes through the same formulas as one machine:
the columns broadcast against the last axis of the currents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.dq_machines.flux_map import ScaledMachines
from dqforge.machines.dq_machines.synchronous import (
    FluxFormulas,
    FluxJet,
    LinearMachine,
    Machine,
    torque_per_ampere,
)
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

_POSITIVE = ("l_d", "l_q", "i_max")
_NOT_NEGATIVE = ("r_s", "psi_pm", "friction")
_PERHAPS_UNKNOWN = ("inertia", "omega_m_max")


@dataclass(frozen=True, slots=True, eq=False)
class MachineBatch(FluxFormulas):
    """N machines with constant inductances; parameters as in `LinearMachine`, arrays of shape (N,).

    The last axis of currents and speeds that the methods take is that of the machines (or 1 long):
    (N,), or (P, N) for P points of each. A list of N P points, as the budgets of losses take it, is
    one of `repeated` machines.

    Args:
        pole_pairs: Numbers of pole pairs p, whole.
        r_s: Phase resistances in Ohm.
        l_d, l_q: Phase (synchronous) inductances in H.
        psi_pm: Magnet flux linkages in Wb, peak of phase; 0 for a reluctance machine.
        i_max: Largest permitted currents in A, peak of phase.
        inertia: Moments of inertia in kg m^2, NaN where unknown.
        friction: Viscous friction in N m s/rad.
        omega_m_max: Largest mechanical speeds in rad/s, NaN where unknown.

    Raises:
        InputError: Columns of different lengths, or a value that no machine has: names column and
            row.
    """

    pole_pairs: NDArray[np.int64]
    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    psi_pm: FloatArray
    i_max: FloatArray
    inertia: FloatArray
    friction: FloatArray
    omega_m_max: FloatArray

    def __post_init__(self) -> None:
        """Own the columns and refuse what no machine has."""
        given = {part.name: np.array(getattr(self, part.name)) for part in fields(self)}
        shape = given["pole_pairs"].shape
        for name, values in given.items():
            if values.ndim != 1 or values.shape != shape:
                raise InputError(
                    f"machines: {name} has the shape {values.shape}, pole_pairs {shape}; every "
                    "column needs one value per machine"
                )
        for name, wrong in faults(given).items():
            if np.any(wrong):
                row = int(np.argmax(wrong))
                raise InputError(
                    f"machines: {name} of machine {row} is {given[name][row]:g}; expected "
                    f"{_expected(name)}"
                )
        for name, values in given.items():
            owned = values.astype(np.int64 if name == "pole_pairs" else np.float64)
            owned.flags.writeable = False
            object.__setattr__(self, name, owned)

    @classmethod
    def of(cls, machines: Sequence[LinearMachine]) -> MachineBatch:
        """Machines side by side."""
        columns = {
            part.name: np.array([_number(getattr(machine, part.name)) for machine in machines])
            for part in fields(cls)
        }
        return cls(**columns)

    @classmethod
    def varied(
        cls, base: LinearMachine, count: int, columns: Mapping[str, ArrayLike]
    ) -> MachineBatch:
        """One machine ``count`` times, but for the ``columns`` given: by name, shape (count,)."""
        names = [part.name for part in fields(cls)]
        unknown = sorted(set(columns) - set(names))
        if unknown:
            raise InputError(f"machines: no column {unknown[0]}; there are {', '.join(names)}")
        whole: dict[str, Any] = {
            name: np.asarray(columns[name])
            if name in columns
            else np.full(count, _number(getattr(base, name)))
            for name in names
        }
        return cls(**whole)

    @property
    def count(self) -> int:
        """Number of machines N."""
        return int(self.pole_pairs.size)

    def machine(self, row: int) -> LinearMachine:
        """One of the machines."""
        values = {part.name: getattr(self, part.name)[row].item() for part in fields(self)}
        unknown = {name: None for name in _PERHAPS_UNKNOWN if np.isnan(values[name])}
        return LinearMachine(**(values | unknown))

    def taken(self, rows: IndexArray | BoolArray) -> MachineBatch:
        """The machines of some rows, by their places or by a mask, in that order."""
        return MachineBatch(**{part.name: getattr(self, part.name)[rows] for part in fields(self)})

    def repeated(self, count: int) -> MachineBatch:
        """Each machine ``count`` times in a row: one per point of a list, machine by machine."""
        return self.taken(np.repeat(np.arange(self.count), count))

    @property
    def saliency(self) -> FloatArray:
        """Inductance differences l_q - l_d in H, shape (N,)."""
        return self.l_q - self.l_d

    @property
    def torque_per_ampere(self) -> FloatArray:
        """Torque per ampere of i_q at zero current, 3/2 p psi_pm, in N m/A (peak), shape (N,)."""
        return torque_per_ampere(self.pole_pairs, self.psi_pm)

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, shape (..., N)."""
        return self.psi_pm + self.l_d * i_d, self.l_q * i_q

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, shape (..., N)."""
        psi_d, psi_q = self.flux(i_d, i_q)
        zero = np.zeros_like(psi_d)
        l_d, l_q = zero + self.l_d, zero + self.l_q
        return FluxJet(psi_d, psi_q, l_d, zero, zero, l_q, zero, zero, zero, zero, zero, zero)


# One machine for all points, or one per point.
MachineOrBatch = Machine | MachineBatch | ScaledMachines
BATCHES = (MachineBatch, ScaledMachines)


def faults(columns: Mapping[str, ArrayLike]) -> dict[str, BoolArray]:
    """Where values of columns are none that a machine has, by name, each of the column's shape.

    Args:
        columns: Some or all columns of a `MachineBatch` by name, any shapes: so that the rows of
            drawn machines can be told apart before they are made.
    """
    found = {}
    for name, given in columns.items():
        values = np.asarray(given, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            if name == "pole_pairs":
                fine = (values >= 1.0) & (values == np.floor(values)) & (values < 2.0**31)
            elif name in _PERHAPS_UNKNOWN:
                fine = np.isnan(values) | ((values > 0.0) & np.isfinite(values))
            else:
                least = values > 0.0 if name in _POSITIVE else values >= 0.0
                fine = np.isfinite(values) & least
        found[name] = ~fine
    return found


def _expected(name: str) -> str:
    if name == "pole_pairs":
        return "a whole number from 1"
    if name in _NOT_NEGATIVE:
        return "zero or a positive number"
    return "a positive number" + (", or NaN where unknown" if name in _PERHAPS_UNKNOWN else "")


def _number(value: float | None) -> float:
    return np.nan if value is None else value
