"""What a design file says of losses: of the machine beside its dc resistance,
and where they are compared.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from dqforge.machines.design.design import ROUNDING_OF_DATA, InputValue, Reading
from dqforge.machines.design.sections.machine_schema import LossMapSection, MachineSection
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
from dqforge.machines.errors import InputError
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

if TYPE_CHECKING:
    from dqforge.machines.losses.loss_map import LossMap

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


def read_machine_loss(section: MachineSection, machine: Machine, reading: Reading) -> MachineLoss:
    """Losses of the machine beyond the dc copper loss; a loss map is held against their formula.

    Raises:
        InputError: The iron loss has no part, or no flux linkage, or the loss map cannot be used.
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
    formula = MachineLoss.measured(
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
    given = section.loss_map
    if given is None:
        return formula
    mapped = _loss_map(section, given, machine, reading)
    coefficients = None if iron is None else (formula.hysteresis, formula.eddy)
    from dqforge.machines.losses.loss_map import held_against_flux

    compared = held_against_flux(mapped, machine.flux, machine.i_max, coefficients)
    if compared is None:
        return replace(formula, mapped=mapped)
    reading.remarks.append(f"{given.file}: {compared.sentence}")
    reading.derived.append(
        InputValue(
            "machine.loss_map.flux_misfit",
            "",
            compared.misfit,
            "",
            note=f"{given.file}: r.m.s. difference of the loss by |psi|^2 over that of the map",
        )
    )
    return replace(
        formula,
        hysteresis=compared.hysteresis,
        eddy=compared.eddy,
        mapped=replace(mapped, compared=compared),
    )


_MAP = ("machine", "loss_map")


def _loss_map(
    section: MachineSection, given: LossMapSection, machine: Machine, reading: Reading
) -> LossMap:
    """The loss map of a file, its findings among the remarks."""
    # A design without a map starts faster without the readers.
    from dqforge.machines.losses.loss_columns import DeclaredLoss, read_loss_map

    document, flux_map = reading.document, section.flux_map
    why = ""
    if section.model == "waveform":
        why = "model: waveform, whose currents are no dq currents"
    elif section.connection == "delta":
        why = "connection: delta; convert its currents to those of the equivalent star"
    if why:
        raise document.error(f"machine.loss_map does not go with {why}", _MAP, key=True)
    if section.magnet_loss is not None:
        raise document.error(
            "machine.magnet_loss: the loss of the magnets is that of machine.loss_map; remove the "
            "key",
            ("machine", "magnet_loss"),
            key=True,
        )
    stated = flux_map is not None and "scaling" in flux_map.model_fields_set
    columns = {key: value for key, value in given.columns if value is not None}
    frequency = si_of(given.frequency)
    declared = DeclaredLoss(
        machine.pole_pairs,
        0.0 if frequency is None else 2.0 * math.pi * frequency,
        si_of(given.exponent),
        given.axes or ("magnet-d" if flux_map is None else flux_map.axes),
        given.scaling or (flux_map.scaling if flux_map is not None and stated else None),
    )
    path = (*_MAP, "file")
    content = reading.read_beside(given.file, path)
    try:
        found = read_loss_map(content, given.file, declared, columns)
    except InputError as error:
        if error.line is not None:
            raise
        about = error.message if given.file in error.message else f"{given.file}: {error.message}"
        raise document.error(f"machine.loss_map: {about}", path) from None
    mapped = found.loss_map
    hertz = mapped.omega / (2.0 * math.pi)
    reading.remarks.extend(f"{given.file}: {finding}" for finding in found.findings)
    reading.remarks.append(
        f"{given.file}: iron and magnet loss over the currents are those of the map, at up to "
        f"{hertz:.4g} Hz"
    )
    if mapped.iron.region.reach < machine.i_max * (1.0 - ROUNDING_OF_DATA):
        reading.remarks.append(
            f"{given.file}: the loss map ends within the current limit; beyond it losses are "
            "extrapolated along tangents"
        )
    if found.mechanical is not None:
        omega_m = mapped.omega / machine.pole_pairs
        friction = format_quantity(machine.friction * omega_m**2, "W", 3)
        reading.remarks.append(
            f"{given.file}: the mechanical loss of the map, up to "
            f"{format_quantity(found.mechanical, 'W', 3)} at "
            f"{format_quantity(omega_m, 'rpm', 4)}, is compared alone: machine.friction makes "
            f"{friction} there"
        )
    return mapped


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
