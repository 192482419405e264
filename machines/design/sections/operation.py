"""The section ``operation``: what may be written, what is made of it,
and what is checked across it.
"""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.design import ROUNDING_OF_DATA
from dqforge.machines.design.settings import (
    ModulatorKey,
    OperationSettings,
    bare_speed_hint,
    settings_from,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    Section,
    Share,
    SixStepShare,
    Speed,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.modulation.registry import follows_hexagon
from dqforge.machines.names import (
    OvermodulationName,
    Strategy,
)
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.units.quantities import format_quantity

_OPERATION = OperationSettings()


class OperationSection(Section):
    """Which currents make the torque."""

    strategy: Strategy = Field(
        default="mtpa", description="mtpa: least current for the torque; id0: no d current"
    )
    speed: Speed | None = Field(
        default=None,
        description=(
            "mechanical speed for which the field is weakened (rad/s; write rpm); default: none"
        ),
    )
    modulation: ModulatorKey = Field(
        default=_OPERATION.modulation,
        description="whose linear range limits the voltage at the speed",
    )
    voltage_margin: Share | None = Field(
        default=None,
        description="share of that voltage kept free for control (write 5 %); default 0",
    )
    overmodulation: OvermodulationName = Field(
        default=_OPERATION.overmodulation,
        description=(
            "none; least-phase-error, least-magnitude-error: voltages beyond the linear range, "
            "with the requested fundamental"
        ),
    )
    overmodulation_limit: SixStepShare | None = Field(
        default=None,
        description=(
            "largest fundamental there, as a share of that of six-step operation; default 95.14 %, "
            "where a vector follows the hexagon"
        ),
    )


def check_operation(
    operation: OperationSection, weakened: bool, machine: Machine, document: YamlDocument
) -> None:
    """Check the strategy, and the speed for which the field is weakened.

    ``weakened`` says that the design has a two-dimensional reference. Raises `InputError` with a
    position.
    """
    if operation.strategy == "id0" and machine.psi_pm == 0.0:
        message = "operation.strategy: id0 gives no torque without magnets; write strategy: mtpa"
        raise document.error(message, ("operation", "strategy"))
    for key in ("modulation", "voltage_margin"):
        if operation.speed is None and not weakened and key in operation.model_fields_set:
            message = (
                f"operation.{key} limits the voltage at a speed; write speed: 3000 rpm, or remove "
                "the key"
            )
            raise document.error(message, ("operation", key), key=True)
    if operation.speed is None:
        return
    if operation.strategy == "id0":
        message = (
            "operation.speed: id0 cannot weaken the field; write strategy: mtpa, or remove the "
            "speed"
        )
        raise document.error(message, ("operation", "speed"), key=True)
    most = machine.omega_m_max
    if most is not None and operation.speed.si > most * (1.0 + ROUNDING_OF_DATA):
        shown, limit = format_quantity(operation.speed.si, "rpm"), format_quantity(most, "rpm")
        message = (
            f"operation.speed: {shown} is above machine.max_speed {limit}; "
            f"{bare_speed_hint(operation.speed)}"
        )
        raise document.error(message, ("operation", "speed"))


def check_overmodulation(
    operation: OperationSection,
    inverter: Inverter,
    formats: tuple[str, ...],
    any_back_emf: bool,
    document: YamlDocument,
) -> None:
    """Check that what is asked for can overmodulate.

    ``formats`` are those of the emitted control; ``any_back_emf`` says that the machine's phase
    currents have a shape. Raises `InputError` with a position.
    """
    if operation.overmodulation == "none":
        if operation.overmodulation_limit is not None:
            message = (
                "operation.overmodulation_limit: nothing goes beyond the linear range; write "
                "overmodulation: least-phase-error, or remove the key"
            )
            raise document.error(message, ("operation", "overmodulation_limit"), key=True)
        return
    fixed = [name for name in formats if name != "float32"]
    found = ""
    if any_back_emf:
        found = "a machine with any back-EMF needs voltages of any shape; remove the key"
    elif not TOPOLOGIES[inverter.topology].modulated:
        found = f"{inverter.topology} has its own modulator; remove the key"
    elif not follows_hexagon(operation.modulation):
        found = (
            f"the duty cycles of {operation.modulation} leave the rails at the corners of the "
            "hexagon; write modulation: svpwm, or a discontinuous one"
        )
    elif fixed:
        found = f"there is no {fixed[0]} of it; write export.control: float32, or remove the key"
    if found:
        message = f"operation.overmodulation: {found}"
        raise document.error(message, ("operation", "overmodulation"), key=True)


def read_operation(section: OperationSection) -> OperationSettings:
    """What the section ``operation`` asks for."""
    return settings_from(OperationSettings, section, omega_m=si_of(section.speed))
