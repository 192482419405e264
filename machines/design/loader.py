"""Reading a design file: YAML, schema, data-sheet conventions, cross-checks,
and the design in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from dqforge.machines.design import datasheet
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import located
from dqforge.machines.design.overrides import overridden
from dqforge.machines.design.plausibility.design import implausibilities
from dqforge.machines.design.provenance import input_values, kind_assumptions
from dqforge.machines.design.reading import Reading
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.control import (
    ControlSection,
    check_loops,
    read_current_loop,
    read_observer,
    read_speed_loop,
    sampling_warning,
)
from dqforge.machines.design.sections.export import read_export
from dqforge.machines.design.sections.field_weakening import read_weakening
from dqforge.machines.design.sections.fit import FitSection, check_fit, read_budget
from dqforge.machines.design.sections.inverter import (
    DEFAULT_COOLANT,
    InverterSection,
    check_inverter,
    read_inverter_device,
)
from dqforge.machines.design.sections.losses import (
    check_comparison,
    read_losses,
    read_machine_loss,
    read_winding_heat,
)
from dqforge.machines.design.sections.machine_model import check_halves, check_machine, read_machine
from dqforge.machines.design.sections.modulation_choice import read_choice
from dqforge.machines.design.sections.operation import read_operation
from dqforge.machines.design.sections.simulation import read_scenario
from dqforge.machines.design.sections.tolerances import read_tolerances
from dqforge.machines.design.sections.waveform import check_waveform, read_waveform
from dqforge.machines.design.settings import (
    ControlSettings,
    FitSettings,
    GainWish,
    PerUnitBases,
)
from dqforge.machines.design.speed_remarks import bare_speed_remarks
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.entries.complaints import read_model
from dqforge.machines.entries.rules import si_of
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.files.positioned_yaml import YamlDocument, parse_yaml, read_bytes
from dqforge.machines.places import Places, about
from dqforge.machines.units.quantities import format_quantity


def load_design(path: str | Path, settings: Sequence[str] = ()) -> Design:
    """Design in a file.

    Parameters
    ----------
    path:
        The file.
    settings:
        Keys that are set instead of what the file says, such as ``machine.resistance=12 mOhm``.

    Raises
    ------
    InputError
        The file cannot be read, or its content is wrong; with the position where there is one.
    """
    return load_text(read_bytes(path), str(path), Path(path).parent, settings)


def load_text(
    text: bytes, source: str, folder: Path | None = None, settings: Sequence[str] = ()
) -> Design:
    """Design in the bytes of a file.

    Parameters
    ----------
    text:
        Content, UTF-8.
    source:
        File name for messages.
    folder:
        Where the files lie that the design names; None where it may name none.
    settings:
        Keys that are set instead of what the file says, such as ``machine.resistance=12 mOhm``.

    Raises
    ------
    InputError
        The content is wrong; with the position of the first fault, or the option that is at fault.
    """
    document = parse_yaml(text, source)
    if settings:
        document, changed = overridden(document, text.decode("utf-8-sig"), settings)
        text = changed.encode("utf-8")
    places = Places(
        source, document.keys, document.values, tuple(DesignFile.model_fields), document.options
    )
    try:
        with located(places, "machine"):
            return _Build(
                document, read_sections(document), Reading(document, text, folder), places
            ).design()
    except NoSolutionError as error:
        # Nothing has been asked of the design yet: what it says is wrong.
        raise InputError(
            error.message, source=error.source, line=error.line, column=error.column
        ) from error


@dataclass(slots=True)
class _Build:
    """One design in the making."""

    document: YamlDocument
    sections: DesignFile
    reading: Reading
    places: Places

    @property
    def remarks(self) -> list[str]:
        """Sentences on what the file leaves open."""
        return self.reading.remarks

    def design(self) -> Design:
        """Build all parts in an order in which each check has what it needs."""
        sections, document = self.sections, self.document
        found = read_machine(sections.machine, self.reading)
        machine = found.machine
        check_machine(sections.machine, machine, document)
        check_inverter(sections, document)
        check_loops(sections, machine, document)
        inverter = self.inverter(sections.inverter, machine.i_max)
        i_max = machine.i_max if inverter.i_max is None else min(machine.i_max, inverter.i_max)
        check_halves(sections, document)
        check_fit(sections, machine, i_max, document)
        check_waveform(sections, document)
        check_comparison(sections, machine, document)
        control = self.control(sections.control, machine, inverter, i_max)
        self.general_remarks(machine, inverter, control)
        self.remarks.extend(bare_speed_remarks(sections))
        weakening = read_weakening(sections, machine, self.reading)
        choice = read_choice(sections, machine, i_max, self.reading)
        losses = read_losses(sections, machine, self.reading)
        design = Design(
            name=sections.name,
            about=sections.about,
            machine=machine,
            machine_loss=read_machine_loss(sections.machine, self.reading),
            phase_machine=found.phases,
            inverter=inverter,
            control=control,
            operation=read_operation(sections.operation),
            fit=self.fit(sections.fit, machine, control.bases),
            losses=losses,
            waveform=read_waveform(sections.waveform),
            export=read_export(sections),
            values=(*input_values(sections, self.reading.converted), *self.reading.derived),
            assumptions=(*kind_assumptions(sections), *self.remarks),
            digest=self.reading.digest(),
            given=self.reading.given(),
            weakening=weakening,
            winding=read_winding_heat(sections.machine, inverter.coolant_temperature),
            simulation=read_scenario(sections, machine, inverter, control, self.reading),
            modulation_choice=choice,
            flux_evidence=tuple(self.reading.flux_evidence),
            halves=found.halves,
            places=self.places,
        )
        return replace(
            design, assumptions=(*design.assumptions, *implausibilities(design, sections))
        )

    @about("inverter")
    def inverter(self, section: InverterSection, machine_limit: float) -> Inverter:
        """Inverter in SI units.

        The machine's current limit in A is where tables of a device are made constants.
        """
        limit = section.max_current
        coolant = si_of(section.coolant_temperature)
        i_max = None if limit is None else self.reading.peak(limit, "inverter.max_current")
        largest = machine_limit if i_max is None else min(machine_limit, i_max)
        device, model = read_inverter_device(section, largest, self.reading)
        return Inverter(
            v_dc=section.v_dc.si,
            f_sw=section.switching_frequency.si,
            device=device,
            coolant_temperature=DEFAULT_COOLANT if coolant is None else coolant,
            dead_time=si_of(section.dead_time) or 0.0,
            i_max=i_max,
            topology=section.topology,
            device_model=model,
            capacitor_esr=si_of(section.capacitor_esr) or 0.0,
        )

    @about("control")
    def control(
        self, section: ControlSection, machine: Machine, inverter: Inverter, i_max: float
    ) -> ControlSettings:
        """Controllers in SI units, with the bases that the file leaves open."""
        f_s = si_of(section.sampling_frequency)
        if f_s is None:
            f_s = inverter.f_sw
            self.remarks.append(
                "control.sampling_frequency is taken as the switching frequency, "
                f"{format_quantity(f_s, 'Hz')}"
            )
        warning = sampling_warning(machine, f_s)
        self.remarks.extend([warning] if warning else [])
        return ControlSettings(
            t_s=1.0 / f_s,
            current_loop=read_current_loop(section.current_loop),
            speed_loop=None if section.speed_loop is None else read_speed_loop(section.speed_loop),
            observer=None if section.observer is None else read_observer(section.observer),
            bases=self.bases(section, machine, inverter, i_max),
            tolerances=read_tolerances(self.sections, machine, inverter, i_max, self.reading),
            gains=self.gain_wish(section),
        )

    def gain_wish(self, section: ControlSection) -> GainWish:
        """Whether the design can do without gains, checked against what needs them."""
        named = "control" in self.sections.model_fields_set
        needed = bool(self.sections.export.control) or self.sections.simulation is not None
        if section.gains:
            return "required" if named or needed else "optional"
        wants = (section.speed_loop, section.observer, section.tolerances)
        if needed or section.current_loop.schedule or any(part is not None for part in wants):
            raise self.document.error(
                "control.gains is false, but the speed loop, observer, schedule, tolerances, "
                "export.control or simulation of this design need gains; leave it out, or those",
                ("control", "gains"),
            )
        return "none"

    def bases(
        self, section: ControlSection, machine: Machine, inverter: Inverter, i_max: float
    ) -> PerUnitBases:
        """Bases of the per-unit gains.

        What the file leaves open is stated among the assumptions.
        """
        given = section.per_unit
        current = (
            i_max
            if given.current is None
            else self.reading.peak(given.current, "control.per_unit.current")
        )
        voltage = inverter.v_dc / math.sqrt(3.0) if given.voltage is None else given.voltage.si
        speed, speed_from = (
            self.base_speed(machine, inverter) if given.speed is None else (given.speed.si, "")
        )
        torque = (
            (machine.torque_per_ampere * current or 1.0)
            if given.torque is None
            else given.torque.si
        )
        torque_from = (
            "3/2 p psi_pm times the base current"
            if machine.psi_pm
            else "1 N m, there are no magnets"
        )
        for name, value, unit, source, entry in (
            ("current", current, "A", "the current limit", given.current),
            ("voltage", voltage, "V", "v_dc/sqrt(3)", given.voltage),
            ("speed", speed, "rpm", speed_from, given.speed),
            ("torque", torque, "N m", torque_from, given.torque),
        ):
            if entry is None:
                self.remarks.append(
                    f"control.per_unit.{name} is {format_quantity(value, unit)}: {source}"
                )
        return PerUnitBases(current=current, voltage=voltage, speed=speed, torque=torque)

    def base_speed(self, machine: Machine, inverter: Inverter) -> tuple[float, str]:
        """Base speed in rad/s that the file leaves open, and where it comes from."""
        if machine.omega_m_max is not None:
            return machine.omega_m_max, "machine.max_speed"
        rated = self.sections.machine.rated.speed
        if rated is not None:
            return rated.si, "machine.rated.speed"
        if machine.psi_pm == 0.0:
            message = (
                "machine: nothing tells the speed range of this machine; write max_speed: 3000 rpm"
            )
            raise self.document.error(message, ("machine",), key=True)
        omega_m = inverter.v_dc / math.sqrt(3.0) / (machine.pole_pairs * machine.psi_pm)
        return omega_m, "where the back-EMF reaches v_dc/sqrt(3)"

    @about("fit")
    def fit(self, section: FitSection, machine: Machine, bases: PerUnitBases) -> FitSettings:
        """Settings of the fit; what the machine or the number format cannot have is no default."""
        form, budget = section.form, read_budget(section)
        open_form = "form" not in section.model_fields_set
        if open_form and not isinstance(machine, LinearMachine):
            form = "polynomial"
            self.remarks.append(
                "fit.form is polynomial: the machine saturates, so that no other form holds"
            )
        elif open_form and section.format in ("q15", "q31"):
            form = "polynomial"
            self.remarks.append(f"fit.form is polynomial: {section.format} has no other")
        return FitSettings(
            form=form,
            method=section.method,
            degree=section.degree,
            segments=section.segments,
            breakpoint_mode=section.breakpoint_mode,
            exact_at_zero=section.exact_at_zero,
            continuous=section.continuous,
            flat_at_zero=section.flat_at_zero,
            torque_max=si_of(section.torque_max),
            breakpoints=None
            if section.breakpoints is None
            else tuple(point.si for point in section.breakpoints),
            budget=budget,
            format="float32" if section.format is None and budget is None else section.format,
            full_scale=(bases.torque, bases.current),
            core=section.core,
        )

    def general_remarks(
        self, machine: Machine, inverter: Inverter, control: ControlSettings
    ) -> None:
        """Sentences on defaults that change the result."""
        sections = self.sections
        if machine.omega_m_max is not None:
            warning = datasheet.back_emf_warning(
                machine.pole_pairs, machine.psi_pm, machine.omega_m_max, inverter.v_dc
            )
            self.remarks.extend([warning] if warning else [])
        if "strategy" not in sections.operation.model_fields_set:
            self.remarks.append("operation.strategy is mtpa: the least current for each torque")
        if sections.fit.torque_max is None:
            self.remarks.append("fit.torque_max is the largest torque within the current limit")
        if "prefix" not in sections.export.model_fields_set:
            self.remarks.append(f"export.prefix is {sections.export.prefix}")
        if sections.machine.friction is None and (control.speed_loop or control.observer):
            self.remarks.append("machine.friction is taken as 0")
        device = sections.inverter.device
        if device is not None and sections.inverter.coolant_temperature is None:
            self.remarks.append(
                f"inverter.coolant_temperature is {format_quantity(DEFAULT_COOLANT, 'degC')}"
            )


def read_sections(document: YamlDocument) -> DesignFile:
    """Sections of a design file; raises `InputError` like `read_model`."""
    return read_model(document, DesignFile)
