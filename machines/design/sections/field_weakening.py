"""Reading of the section on two-dimensional current references."""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import (
    WeakeningSettings,
    settings_from,
)
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    ByteCount,
    Section,
    SmallShare,
    Speed,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.names import Strategy
from dqforge.machines.units.quantities import format_quantity

_WEAKENING = WeakeningSettings(omega_m=1.0)


class WeakeningSection(Section):
    """Current references over torque, voltage and speed, for field weakening."""

    speed: Speed | None = Field(
        default=None,
        description="largest mechanical speed (rad/s; write rpm); default machine.max_speed",
    )
    torque_error: SmallShare | None = Field(
        default=None, description="largest torque error over the largest torque; default 0.5 %"
    )
    voltage_excess: SmallShare | None = Field(
        default=None,
        description=(
            "largest excess over the voltage limit and over the current limit; default 0.5 %"
        ),
    )
    flash: ByteCount = Field(
        default=_WEAKENING.flash,
        ge=256,
        le=100_000,
        description="largest number of bytes of code and constants",
    )


def read_weakening(
    section: WeakeningSection | None, strategy: Strategy, machine: Machine, reading: Reading
) -> WeakeningSettings | None:
    """Two-dimensional references, None where the file asks for none; a speed that it
    leaves open is remarked on.

    Raises:
        InputError: The strategy is not mtpa, or nothing tells the largest speed.
    """
    document = reading.document
    if section is None:
        return None
    if strategy != "mtpa":
        message = (
            "field_weakening needs operation.strategy mtpa; write that, or leave the section out"
        )
        raise document.error(message, ("field_weakening",), key=True)
    omega_m = si_of(section.speed)
    if omega_m is None:
        if machine.omega_m_max is None:
            message = "field_weakening: the largest speed is unknown; write {speed: 6000 rpm} here"
            raise document.error(message, ("field_weakening",), key=True)
        omega_m = machine.omega_m_max
        reading.remarks.append(
            f"field_weakening.speed is {format_quantity(omega_m, 'rpm')}: machine.max_speed"
        )
    return settings_from(WeakeningSettings, section, omega_m=omega_m)
