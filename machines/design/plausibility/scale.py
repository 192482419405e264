"""Sizes of a drive that its figures are shares of."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Scale:
    """Sizes of a drive, in SI units.

    Args:
        voltage: v_dc/sqrt(3), the largest phase voltage in the linear range.
        current: Current limit, peak of phase.
        flux: Flux linkage at half the current limit, 45 degrees ahead of the q axis.
        base_speed: Mechanical speed in rad/s at which this flux linkage uses the voltage up.
        torque: Largest torque within the current limit.
        power: Apparent power at voltage and current.
        top_speed: Largest mechanical speed in rad/s, or None.
    """

    voltage: float
    current: float
    flux: float
    base_speed: float
    torque: float
    power: float
    top_speed: float | None
