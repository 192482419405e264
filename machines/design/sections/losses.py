"""What a design file says of losses: of the machine beside its dc resistance,
and where they are compared.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.design.design import ROUNDING_OF_DATA, Reading
from dqforge.machines.design.sections.machine_schema import MachineSection
from dqforge.machines.design.settings import (
    LoadPoint,
    LossSettings,
    LossStrategy,
    ModulatorList,
    bare_speed_hint,
)
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    FileName,
    Listing,
    PointSpeed,
    PointTorque,
    PointWeight,
    Section,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.losses.machine_budget import (
    COPPER_COEFFICIENT,
    MOST_BYTES,
    MachineLoss,
    Mission,
    WindingHeat,
    read_mission,
)
from dqforge.machines.units.quantities import format_quantity

_LOSSES = LossSettings(points=())


class PointSection(Section):
    """One operating point."""

    torque: PointTorque = Field(description="torque (N m)")
    speed: PointSpeed = Field(description="mechanical speed (rad/s; write rpm)")
    weight: PointWeight | None = Field(
        default=None,
        description="share of the point in the mean losses of a study (%), 1 unless given",
    )


class LossSection(Section):
    """Which alternatives are compared, and where."""

    points: Annotated[Listing[PointSection], Field(min_length=1, max_length=1000)] = Field(
        default=(), description="operating points, a list of {torque: ..., speed: ...}"
    )
    mission: FileName | None = Field(
        default=None,
        description=(
            "text file beside the design with time, speed and torque, over which energy is counted"
        ),
    )
    strategies: Annotated[Listing[LossStrategy], Field(min_length=1, max_length=10)] = Field(
        default=_LOSSES.strategies, description="strategies to compare: mtpa, id0, least-loss"
    )
    modulations: ModulatorList = Field(
        default=_LOSSES.modulations, description="modulations to compare"
    )


_REFERENCE = 20.0


def read_machine_loss(section: MachineSection, reading: Reading) -> MachineLoss:
    """Losses of the machine beyond the dc copper loss.

    Raises:
        InputError: The iron loss has no part, or no flux linkage.
    """
    iron, resistance, magnet, document = (
        section.iron_loss,
        section.ac_resistance,
        section.magnet_loss,
        reading.document,
    )
    if iron is not None and iron.hysteresis is None and iron.eddy is None:
        message = "machine.iron_loss needs hysteresis or eddy; write e.g. eddy: 40 W"
        raise document.error(message, ("machine", "iron_loss"), key=True)
    if iron is not None and iron.flux.si == 0.0:
        raise document.error(
            "machine.iron_loss.flux must be positive; write the flux linkage at which the losses "
            "hold",
            ("machine", "iron_loss", "flux"),
        )
    return MachineLoss.measured(
        frequency=iron.frequency.si if iron else 0.0,
        flux=reading.phase_flux(iron.flux, "machine.iron_loss.flux") if iron else 0.0,
        hysteresis=(si_of(iron.hysteresis) or 0.0) if iron else 0.0,
        eddy=(si_of(iron.eddy) or 0.0) if iron else 0.0,
        resistance_ratio=resistance.ratio.si if resistance else 1.0,
        resistance_frequency=resistance.frequency.si if resistance else 1.0,
        magnet=magnet.loss.si if magnet else 0.0,
        magnet_frequency=magnet.frequency.si if magnet else 1.0,
        magnet_current=reading.machine_peak(magnet.current, ("machine", "magnet_loss", "current"))
        if magnet
        else 1.0,
    )


def read_winding_heat(section: MachineSection, coolant: float) -> WindingHeat | None:
    """How warm the winding becomes, None where the file gives no thermal resistance.

    The resistance that the program has is that of ``temperature.winding``, or of its reference: the
    coefficient is converted to that temperature. ``coolant`` in degC is the inverter's, for
    machines that name none of their own.
    """
    temperature = section.temperature
    if temperature.winding_thermal_resistance is None:
        return None
    given, reference = si_of(temperature.copper_coefficient), si_of(temperature.winding_reference)
    coefficient = COPPER_COEFFICIENT if given is None else given
    reference = _REFERENCE if reference is None else reference
    at = si_of(temperature.winding)
    at = reference if at is None else at
    own = si_of(temperature.winding_coolant)
    return WindingHeat(
        thermal_resistance=temperature.winding_thermal_resistance.si,
        coolant_temperature=coolant if own is None else own,
        reference_temperature=at,
        coefficient=coefficient / (1.0 + coefficient * (at - reference)),
    )


def read_losses(
    section: LossSection | None, machine: Machine, reading: Reading
) -> LossSettings | None:
    """Loss comparison, None where the file asks for none.

    Raises:
        InputError: There is neither a point nor a mission, or the file of the mission cannot be
            used.
    """
    if section is None:
        return None
    if not section.points and section.mission is None:
        message = (
            "losses needs points or a mission; write points: [{torque: 1 N m, speed: 1500 rpm}]"
        )
        raise reading.document.error(message, ("losses",), key=True)
    return LossSettings(
        points=tuple(
            LoadPoint(
                torque=point.torque.si,
                omega_m=point.speed.si,
                weight=1.0 if point.weight is None else point.weight.si,
            )
            for point in section.points
        ),
        strategies=section.strategies,
        modulations=section.modulations,
        mission=None if section.mission is None else _mission(section.mission, machine, reading),
    )


def _mission(name: str, machine: Machine, reading: Reading) -> Mission:
    path = ("losses", "mission")
    content = reading.read_beside(name, path, MOST_BYTES)
    found = read_mission(content, name, omega_max=machine.omega_m_max)
    reading.remarks.extend(f"losses.mission: {sentence}" for sentence in found.findings)
    return found


def check_losses(
    section: LossSection | None, has_device: bool, machine: Machine, document: YamlDocument
) -> None:
    """Check the loss comparison: a switch, no alternative twice, no point beyond the largest speed.

    Raises `InputError` with a position.
    """
    if section is None:
        return
    if not has_device:
        raise document.error(
            "losses: the loss comparison needs the switch; write the section inverter.device, or "
            "remove losses",
            ("losses",),
            key=True,
        )
    for key, names in (
        ("strategies", section.strategies),
        ("modulations", section.modulations),
    ):
        for index, name in enumerate(names):
            if name in names[:index]:
                raise document.error(
                    f"losses.{key}: '{name}' is listed twice; remove one", ("losses", key, index)
                )
    most = machine.omega_m_max
    for index, point in enumerate(section.points):
        if most is not None and abs(point.speed.si) > most * (1.0 + ROUNDING_OF_DATA):
            shown, limit = format_quantity(point.speed.si, "rpm"), format_quantity(most, "rpm")
            message = f"losses.points[{index}].speed: {shown} is above machine.max_speed {limit}"
            raise document.error(
                f"{message}; {bare_speed_hint(point.speed)}", ("losses", "points", index, "speed")
            )
