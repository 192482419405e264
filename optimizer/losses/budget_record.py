"""What a budget of a drive counts, and what it holds at any number of points with several
modulators and carrier frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, fields

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import WindingHeat
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.records import dataclass

# Kinds of loss that make up the total, machine first.
PARTS = (
    "copper",
    "ripple_copper",
    "iron",
    "ripple_iron",
    "magnet",
    "conduction",
    "dead_time",
    "switching",
    "capacitor",
)


@dataclass(frozen=True, slots=True)
class BudgetOptions:
    """What is counted beside copper, conduction and switching.

    Args:
        machine_loss: AC copper, iron and magnet loss.
        winding: How warm the winding becomes; None keeps the machine's resistance.
        capacitor_esr: Series resistance of the DC-link capacitor in Ohm at the carrier frequency.
        ripple_resistance: Resistance of the winding at the carrier frequency over that of the
            fundamental; None leaves out what the ripple makes, in copper and in iron.
        sheet_corner: Frequency in Hz at which the skin depth equals the thickness of the sheets
            (`sheet_factor`); None leaves the skin effect out of the iron loss that the switching
            makes.
    """

    machine_loss: MachineLoss = field(default=NO_EXTRA_LOSS)
    winding: WindingHeat | None = None
    capacitor_esr: float = 0.0
    ripple_resistance: float | None = 1.0
    sheet_corner: float | None = None

    def __post_init__(self) -> None:
        """Refuse negative resistances and frequencies."""
        if self.sheet_corner is not None and not 0.0 < self.sheet_corner < np.inf:
            raise InputError(
                f"sheet_corner: expected a frequency such as 1000 Hz, got {self.sheet_corner:g} Hz"
            )
        if not 0.0 <= self.capacitor_esr < np.inf:
            raise InputError(
                "capacitor_esr: expected zero or a positive resistance, got "
                f"{self.capacitor_esr:g} Ohm"
            )
        if self.ripple_resistance is not None and not 0.0 <= self.ripple_resistance < np.inf:
            raise InputError(
                f"ripple_resistance: expected a ratio such as 1, got {self.ripple_resistance:g}"
            )


@dataclass(frozen=True, slots=True)
class DriveBudget:
    """Powers and temperatures, arrays of the shape (M, F, P): modulators, carrier frequencies,
    points.

    Args:
        torque, shaft_power: Of the currents, in N m and W.
        friction: Share of the shaft power in W that friction takes; no part of the total, since no
            alternative changes it.
        copper, ripple_copper, iron, ripple_iron, magnet: Losses of the machine in W; the second is
            what the ripple of the current adds, the fourth what switched voltages add.
        conduction, dead_time, switching: Losses of the bridge in W; dead time is what the diodes of
            a MOSFET bridge add in the gaps.
        capacitor: Loss in the DC-link capacitor in W.
        total, input_power: All losses, and power from the DC source, in W.
        junction_temperature, diode_temperature: Of the hotter position in degC; equal where both
            share a junction.
        winding_temperature: In degC; NaN where nothing is known of the winding's heat.
        voltage: Amplitude of the phase voltage in V, peak.
        voltage_error: Amplitude in V that dead time takes, against the current, where nothing
            compensates it.
        capacitor_current, ripple_current: R.m.s. in A: of the DC-link capacitor, and of the ripple
            of a phase current.
        thermal_residual: Largest residual of the balances of heat, in K.
        linear: False beyond the linear range of the modulator less the dead time's share
            (`dead_time_factor`): the voltage cannot be made there.
        steady: False where a junction or the winding runs away; what depends on it is NaN there.
        cool_enough: False where a junction is hotter than the device permits.
        within_tables: False where device tables were carried on beyond their ends.
        known: False where no currents were given (NaN); everything is NaN there.
    """

    torque: FloatArray
    shaft_power: FloatArray
    friction: FloatArray
    copper: FloatArray
    ripple_copper: FloatArray
    iron: FloatArray
    ripple_iron: FloatArray
    magnet: FloatArray
    conduction: FloatArray
    dead_time: FloatArray
    switching: FloatArray
    capacitor: FloatArray
    total: FloatArray
    input_power: FloatArray
    junction_temperature: FloatArray
    diode_temperature: FloatArray
    winding_temperature: FloatArray
    voltage: FloatArray
    voltage_error: FloatArray
    capacitor_current: FloatArray
    ripple_current: FloatArray
    thermal_residual: FloatArray
    linear: BoolArray
    steady: BoolArray
    cool_enough: BoolArray
    within_tables: BoolArray
    known: BoolArray

    @property
    def feasible(self) -> BoolArray:
        """True where the voltage can be made and every temperature is steady and permitted."""
        return self.linear & self.steady & self.cool_enough & self.known

    @property
    def imbalance(self) -> FloatArray:
        """Power in less losses and shaft power, in W, shape (M, F, P)."""
        return np.asarray(self.input_power - self.total - self.shaft_power)


def stacked_budgets(budgets: Sequence[DriveBudget], axis: int) -> DriveBudget:
    """Budgets of one shape along a new axis.

    Args:
        budgets: Budgets of one shape.
        axis: Place of the new axis.
    """
    names = [part.name for part in fields(DriveBudget)]
    return DriveBudget(
        **{name: np.stack([getattr(b, name) for b in budgets], axis=axis) for name in names}
    )
