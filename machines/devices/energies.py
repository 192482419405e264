"""Switching energies of a device over current, voltage, junction temperature and gate
resistance.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.curves import Family, Lookup
from dqforge.machines.devices.switch import DeviceKind
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

# Ratios to the nearest given voltage within which a power law is taken on trust.
_VOLTAGE_SPAN = (0.5, 1.5)

# Exponents of the voltage where only one is given.
#
# IGBT 1.3 to 1.4 and diode 0.6: A. Wintrich et al., "Application Manual Power Semiconductors",
# SEMIKRON, 2nd ed. 2015, chapter 5.2, quoted without the page at hand. MOSFET 1: current and
# voltage cross linearly, and what the output capacitance adds lies between 1 and 2.
EXPONENTS: dict[tuple[DeviceKind, str], float] = {
    ("mosfet", "turn_on"): 1.0,
    ("mosfet", "turn_off"): 1.0,
    ("mosfet", "recovery"): 0.6,
    ("igbt", "turn_on"): 1.3,
    ("igbt", "turn_off"): 1.3,
    ("igbt", "recovery"): 0.6,
}


@dataclass(frozen=True, slots=True)
class EnergyTable:
    """Energy of one switching event.

    Args:
        voltages: DC voltages of the tables in V, ascending, K >= 1.
        tables: One family per voltage: energy in J over current in A at junction temperatures in
            degC.
        exponent: Energy grows with (v / v_ref) to this power beyond the voltages given; between two
            it is linear in the voltage.
        gate_resistance: External gate resistance of the tables in Ohm; None where it is not known.
        gate: Energy in J over gate resistance in Ohm at junction temperatures in degC, for the
            ratio alone; or None.
    """

    voltages: tuple[float, ...]
    tables: tuple[Family, ...]
    exponent: float
    gate_resistance: float | None = None
    gate: Family | None = None

    def __post_init__(self) -> None:
        if not self.voltages or len(self.voltages) != len(self.tables):
            raise InputError(
                f"{len(self.voltages)} voltages for {len(self.tables)} tables of energy; write one "
                "for each"
            )
        if not (self.voltages[0] > 0.0 and all(a < b for a, b in pairwise(self.voltages))):
            raise InputError("the voltages of the energies must be positive and ascend, each once")
        if self.gate is not None and self.gate_resistance is None:
            raise InputError(
                "energies over the gate resistance need the one of the other tables; write r_g"
            )
        if not 0.0 <= self.exponent <= 3.0:
            raise InputError(
                f"the exponent of the voltage is {self.exponent:g}; write 0 to 3, such as 1.3"
            )

    def at(
        self,
        current: ArrayLike,
        voltage: ArrayLike,
        temperature: ArrayLike,
        gate_resistance: float | None = None,
    ) -> Lookup:
        """Energy in J.

        Args:
            current, voltage, temperature: Switched current in A (its magnitude counts), DC voltage
                in V and junction temperature in degC, broadcastable to the shape (...).
            gate_resistance: External gate resistance in Ohm; that of the tables if None.

        Returns:
            Outside beyond the tables; where the voltage is below half or above one and a half times
            the nearest given one; and everywhere when another gate resistance is asked for than the
            tables know of.
        """
        size, volt, kelvin = np.broadcast_arrays(
            *(np.asarray(part, dtype=np.float64) for part in (current, voltage, temperature))
        )
        size, volt = np.abs(size), np.abs(volt)
        grid = np.asarray(self.voltages)
        held = np.clip(volt, grid[0], grid[-1])
        ratio = volt / held
        found = Lookup(
            np.zeros(size.shape), (ratio < _VOLTAGE_SPAN[0]) | (ratio > _VOLTAGE_SPAN[1])
        )
        for k, table in enumerate(self.tables):
            weight = np.interp(held, grid, np.eye(grid.size)[k])
            part = table.at(size, kelvin)
            found = found.plus(Lookup(weight * part.value, part.outside & (weight > 0.0)))
        found = found.times(Lookup(ratio**self.exponent, np.zeros(size.shape, dtype=bool)))
        return (
            found
            if gate_resistance is None
            else found.times(self._gate_factor(gate_resistance, kelvin))
        )

    def _gate_factor(self, wanted: float, temperature: FloatArray) -> Lookup:
        """Energy at a gate resistance over that of the tables.

        One, and outside, where nothing tells it.
        """
        if self.gate is None or self.gate_resistance is None:
            known = self.gate_resistance is not None and wanted == self.gate_resistance
            return Lookup(np.ones(temperature.shape), np.full(temperature.shape, not known))
        asked, base = (
            self.gate.at(resistance, temperature) for resistance in (wanted, self.gate_resistance)
        )
        low = max(curve.x[0] for curve in self.gate.curves)
        outside = asked.outside | (wanted < low and wanted != self.gate_resistance)
        return Lookup(asked.value / base.value, np.asarray(outside))
