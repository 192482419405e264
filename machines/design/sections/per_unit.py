"""The section ``control.per_unit``: bases of per-unit gains, given or found."""

from __future__ import annotations

import math

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import PerUnitBases
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import PhaseCurrent, Section, Speed, Torque, Voltage
from dqforge.machines.topologies.regions import largest_phase_voltage
from dqforge.machines.units.quantities import format_quantity


class PerUnitSection(Section):
    """Bases of the per-unit gains."""

    current: PhaseCurrent | None = Field(
        default=None, description="base current (A); default the current limit"
    )
    voltage: Voltage | None = Field(
        default=None,
        description="base voltage (V, peak of phase); default v_dc/sqrt(3); "
        "machines of model: waveform: the largest voltage of a phase",
    )
    speed: Speed | None = Field(
        default=None,
        description="base mechanical speed (rad/s; write rpm); default the largest speed",
    )
    torque: Torque | None = Field(
        default=None, description="base torque (N m); default 3/2 p psi_pm times the base current"
    )


def read_bases(
    section: PerUnitSection,
    machine: Machine,
    inverter: Inverter,
    i_max: float,
    rated_speed: float | None,
    reading: Reading,
    *,
    any_back_emf: bool,
) -> PerUnitBases:
    """Bases of the per-unit gains; what the file leaves open is stated among the assumptions.

    ``i_max`` in A (peak) is the current limit of the drive, ``rated_speed`` in rad/s (mechanical)
    that of the machine, if known. ``any_back_emf`` says whether the machine is one of model:
    waveform, whose controller makes voltages of any shape.
    """
    current = (
        i_max
        if section.current is None
        else reading.peak(section.current, "control.per_unit.current")
    )
    voltage, voltage_from = (
        _base_voltage(inverter, any_back_emf)
        if section.voltage is None
        else (section.voltage.si, "")
    )
    speed, speed_from = (
        _base_speed(machine, inverter, rated_speed, reading)
        if section.speed is None
        else (section.speed.si, "")
    )
    torque = (
        (machine.torque_per_ampere * current or 1.0)
        if section.torque is None
        else section.torque.si
    )
    torque_from = (
        "3/2 p psi_pm times the base current" if machine.psi_pm else "1 N m, there are no magnets"
    )
    for name, value, unit, source, entry in (
        ("current", current, "A", "the current limit", section.current),
        ("voltage", voltage, "V", voltage_from, section.voltage),
        ("speed", speed, "rpm", speed_from, section.speed),
        ("torque", torque, "N m", torque_from, section.torque),
    ):
        if entry is None:
            reading.remarks.append(
                f"control.per_unit.{name} is {format_quantity(value, unit)}: {source}"
            )
    return PerUnitBases(current=current, voltage=voltage, speed=speed, torque=torque)


def _base_voltage(inverter: Inverter, any_back_emf: bool) -> tuple[float, str]:
    """Base voltage in V that the file leaves open, and where it comes from."""
    if any_back_emf:
        needed = largest_phase_voltage(inverter.topology, inverter.v_dc)
        return needed, f"the largest voltage of a phase, {inverter.topology}"
    return inverter.v_dc / math.sqrt(3.0), "v_dc/sqrt(3)"


def _base_speed(
    machine: Machine, inverter: Inverter, rated_speed: float | None, reading: Reading
) -> tuple[float, str]:
    """Base speed in rad/s that the file leaves open, and where it comes from."""
    if machine.omega_m_max is not None:
        return machine.omega_m_max, "machine.max_speed"
    if rated_speed is not None:
        return rated_speed, "machine.rated.speed"
    if machine.psi_pm == 0.0:
        message = (
            "machine: nothing tells the speed range of this machine; write max_speed: 3000 rpm"
        )
        raise reading.document.error(message, ("machine",), key=True)
    omega_m = inverter.v_dc / math.sqrt(3.0) / (machine.pole_pairs * machine.psi_pm)
    return omega_m, "where the back-EMF reaches v_dc/sqrt(3)"
