"""How an inverter measures its phase currents: shunt, amplifier, converter."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class CurrentSensing:
    """One channel of the current measurement.

    Args:
        shunt: Volts per ampere before the amplifier in Ohm: the shunt, or the slope of a sensor.
        gain: Gain of the amplifier.
        reference: Reference voltage of the converter in V, its largest code.
        bits: Bits of the converter.
        offset: Voltage in V at the converter without current; None for half the reference.
    """

    shunt: float
    gain: float
    reference: float
    bits: int = 12
    offset: float | None = None

    @property
    def slope(self) -> float:
        """Volts at the converter per ampere."""
        return self.shunt * self.gain

    @property
    def full_scale(self) -> float:
        """Largest current in A (peak) that is measured in both directions."""
        zero = 0.5 * self.reference if self.offset is None else self.offset
        return min(zero, self.reference - zero) / self.slope

    @property
    def step(self) -> float:
        """Current in A of one code of the converter."""
        return float(self.reference / (self.slope * 2**self.bits))
