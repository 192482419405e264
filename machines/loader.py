"""Reading a design file: YAML, schema, data-sheet conventions, cross-checks, and the design in SI units."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from pathlib import Path

from dqforge.machines import checks, datasheet
from dqforge.machines.checks import si_of
from dqforge.machines.datasheet import FluxStatement
from dqforge.machines.design import Design, InputValue
from dqforge.machines.entries import Quantity
from dqforge.machines.inverter import Inverter, SwitchDevice
from dqforge.machines.provenance import input_values, kind_assumptions
from dqforge.machines.quantities import format_quantity
from dqforge.machines.schema import (
    ControlSection,
    CurrentLoopSection,
    DesignFile,
    DeviceSection,
    FitSection,
    InverterSection,
    MachineSection,
    SpeedLoopSection,
)
from dqforge.machines.settings import (
    ControlSettings,
    CurrentLoopSettings,
    ExportSettings,
    FitSettings,
    LoadPoint,
    LossSettings,
    ObserverSettings,
    OperationSettings,
    PerUnitBases,
    SpeedLoopSettings,
)
from dqforge.machines.synchronous import LinearMachine
from dqforge.machines.validation import read_sections
from dqforge.machines.yaml_source import YamlDocument, parse_yaml, read_bytes

_DEFAULT_MARGIN = CurrentLoopSettings().phase_margin_min
_DEFAULT_COOLANT = 25.0
_DEFAULT_JUNCTION = 175.0  # degC, usual for the power modules of today


def load_design(path: str | Path) -> Design:
    """Design in a file.

    Raises
    ------
    InputError
        The file cannot be read, or its content is wrong; with the position where there is one.
    """
    return load_text(read_bytes(path), str(path))


def load_text(text: bytes, source: str) -> Design:
    """Design in the bytes of a file.

    Parameters
    ----------
    text:
        Content, UTF-8.
    source:
        File name for messages.

    Raises
    ------
    InputError
        The content is wrong; with the position of the first fault.
    """
    document = parse_yaml(text, source)
    sections = read_sections(document)
    return _Build(document, sections).design(hashlib.sha256(text).hexdigest())


@dataclass(slots=True)
class _Build:
    """One design in the making: `converted` and `remarks` collect what the file does not say itself."""

    document: YamlDocument
    sections: DesignFile
    converted: dict[str, tuple[float, str]] = field(default_factory=dict)
    derived: list[InputValue] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def design(self, digest: str) -> Design:
        """Build all parts in an order in which each check has what it needs."""
        sections, document = self.sections, self.document
        machine = self.machine(sections.machine)
        checks.check_machine(sections.machine, machine, document)
        checks.check_inverter(sections, document)
        checks.check_loops(sections, machine, document)
        inverter = self.inverter(sections.inverter)
        i_max = machine.i_max if inverter.i_max is None else min(machine.i_max, inverter.i_max)
        checks.check_fit(sections, machine, i_max, document)
        checks.check_comparison(sections, machine, document)
        control = self.control(sections.control, machine, inverter, i_max)
        self.general_remarks(machine, inverter, control)
        return Design(
            name=sections.name,
            about=sections.about,
            machine=machine,
            inverter=inverter,
            control=control,
            operation=OperationSettings(sections.operation.strategy),
            fit=_fit(sections.fit),
            losses=_losses(sections),
            export=ExportSettings(prefix=sections.export.prefix, vectors=sections.export.vectors),
            values=(*input_values(sections, self.converted), *self.derived),
            assumptions=(*kind_assumptions(sections), *self.remarks),
            digest=digest,
        )

    def peak(self, quantity: Quantity, path: str) -> float:
        """Peak of a current entry, with a note when it was converted."""
        value = datasheet.peak_current(quantity.si, quantity.kind or "peak")
        if quantity.kind == "rms":
            self.converted[path] = (value, "r.m.s. value times sqrt(2)")
        return value

    def per_phase(self, quantity: Quantity, path: str) -> float:
        """Phase value of a resistance or inductance, with a note when it was converted."""
        value = datasheet.phase_resistance(quantity.si, quantity.kind or "phase")
        if quantity.kind == "line-to-line":
            self.converted[path] = (value, "half of the line-to-line value (star connection)")
        return value

    def machine(self, section: MachineSection) -> LinearMachine:
        """Machine per phase and peak; raises `InputError` when its constants contradict each other."""
        counts = [None if q is None else int(q.si) for q in (section.pole_pairs, section.poles)]
        with self.document.at(("machine", "poles") if section.poles else ("machine",), key=section.poles is None):
            pole_pairs = datasheet.check_pole_counts(*counts)
        if section.poles is not None:
            self.converted["machine.poles"] = (section.poles.si, f"{pole_pairs} pole pairs")
        r_s = self.per_phase(section.resistance, "machine.resistance")
        l_d = self.per_phase(section.inductance_d, "machine.inductance_d")
        l_q = self.per_phase(section.inductance_q, "machine.inductance_q")
        psi_pm = self.magnet_flux(section, pole_pairs)
        if section.rated.current is not None:
            self.peak(section.rated.current, "machine.rated.current")
        return LinearMachine(
            pole_pairs=pole_pairs,
            r_s=r_s,
            l_d=l_d,
            l_q=l_q,
            psi_pm=psi_pm,
            i_max=self.peak(section.max_current, "machine.max_current"),
            inertia=si_of(section.inertia),
            friction=si_of(section.friction) or 0.0,
            omega_m_max=si_of(section.max_speed),
        )

    def magnet_flux(self, section: MachineSection, pole_pairs: int) -> float:
        """Flux linkage of the magnets from the first of the keys that imply it, once all agree."""
        statements = self.flux_statements(section, pole_pairs)
        if not statements:
            raise self.document.error(
                "machine needs magnet_flux, back_emf_constant or torque_constant; write e.g. magnet_flux: 0.06 Wb "
                "(0 Wb for a reluctance machine)",
                ("machine",),
                key=True,
            )
        # Whichever of the keys stands last in the file is the one that contradicts what was read before.
        last = max(statements, key=lambda s: self.document.position(("machine", s.key)))
        with self.document.at(("machine", last.key)):
            datasheet.check_flux_agreement(statements, pole_pairs)
        used = statements[0]
        if used.key != "magnet_flux":
            note = f"derived from {used.key} {used.text} with {pole_pairs} pole pairs"
            self.derived.append(InputValue("machine.magnet_flux", "", used.psi_pm, "Wb", inferred=True, note=note))
            self.remarks.append(f"machine.magnet_flux is {format_quantity(used.psi_pm, 'Wb')} (peak of phase), {note}")
        return used.psi_pm

    def flux_statements(self, section: MachineSection, pole_pairs: int) -> list[FluxStatement]:
        """What each given key says about the flux linkage, in order of trust."""
        statements = []
        if (flux := section.magnet_flux) is not None:
            psi_pm = datasheet.peak_flux(flux.si, flux.kind or "peak")
            statements.append(FluxStatement("magnet_flux", _said(flux), psi_pm, counts_poles=False))
            if flux.kind != "peak":
                self.converted["machine.magnet_flux"] = (psi_pm, f"peak of phase from the {flux.kind} value")
        if (emf := section.back_emf_constant) is not None:
            psi_pm = datasheet.flux_from_back_emf(emf.si, emf.kind or "", pole_pairs)
            statements.append(FluxStatement("back_emf_constant", _said(emf), psi_pm, counts_poles=True))
            inverted = "reciprocal of the speed per volt; " if emf.inverted else ""
            implied = f"{inverted}implies a magnet flux of {format_quantity(psi_pm, 'Wb')}"
            self.converted["machine.back_emf_constant"] = (emf.si, implied)
        if (constant := section.torque_constant) is not None:
            psi_pm = datasheet.flux_from_torque_constant(constant.si, constant.kind or "", pole_pairs)
            statements.append(FluxStatement("torque_constant", _said(constant), psi_pm, counts_poles=True))
            implied = f"implies a magnet flux of {format_quantity(psi_pm, 'Wb')}"
            self.converted["machine.torque_constant"] = (constant.si, implied)
        return statements

    def inverter(self, section: InverterSection) -> Inverter:
        """Inverter in SI units."""
        limit = section.max_current
        coolant = si_of(section.coolant_temperature)
        return Inverter(
            v_dc=section.v_dc.si,
            f_sw=section.switching_frequency.si,
            device=None if section.device is None else _device(section.device),
            coolant_temperature=_DEFAULT_COOLANT if coolant is None else coolant,
            dead_time=si_of(section.dead_time) or 0.0,
            i_max=None if limit is None else self.peak(limit, "inverter.max_current"),
            topology=section.topology,
        )

    def control(
        self, section: ControlSection, machine: LinearMachine, inverter: Inverter, i_max: float
    ) -> ControlSettings:
        """Controllers in SI units, with the bases that the file leaves open."""
        f_s = si_of(section.sampling_frequency)
        if f_s is None:
            f_s = inverter.f_sw
            self.remarks.append(
                f"control.sampling_frequency is taken as the switching frequency, {format_quantity(f_s, 'Hz')}"
            )
        warning = checks.sampling_warning(machine, f_s)
        self.remarks.extend([warning] if warning else [])
        return ControlSettings(
            t_s=1.0 / f_s,
            current_loop=_current_loop(section.current_loop),
            speed_loop=None if section.speed_loop is None else _speed_loop(section.speed_loop),
            observer=None if section.observer is None else ObserverSettings(section.observer.pole.si),
            bases=self.bases(section, machine, inverter, i_max),
        )

    def bases(self, section: ControlSection, machine: LinearMachine, inverter: Inverter, i_max: float) -> PerUnitBases:
        """Bases of the per-unit gains; what the file leaves open is stated among the assumptions."""
        given = section.per_unit
        current = i_max if given.current is None else self.peak(given.current, "control.per_unit.current")
        voltage = inverter.v_dc / math.sqrt(3.0) if given.voltage is None else given.voltage.si
        speed, speed_from = self.base_speed(machine, inverter) if given.speed is None else (given.speed.si, "")
        torque = (machine.torque_per_ampere * current or 1.0) if given.torque is None else given.torque.si
        torque_from = "3/2 p psi_pm times the base current" if machine.psi_pm else "1 N m, there are no magnets"
        for name, value, unit, source, entry in (
            ("current", current, "A", "the current limit", given.current),
            ("voltage", voltage, "V", "v_dc/sqrt(3)", given.voltage),
            ("speed", speed, "rpm", speed_from, given.speed),
            ("torque", torque, "N m", torque_from, given.torque),
        ):
            if entry is None:
                self.remarks.append(f"control.per_unit.{name} is {format_quantity(value, unit)}: {source}")
        return PerUnitBases(current=current, voltage=voltage, speed=speed, torque=torque)

    def base_speed(self, machine: LinearMachine, inverter: Inverter) -> tuple[float, str]:
        """Base speed in rad/s that the file leaves open, and where it comes from."""
        if machine.omega_m_max is not None:
            return machine.omega_m_max, "machine.max_speed"
        rated = self.sections.machine.rated.speed
        if rated is not None:
            return rated.si, "machine.rated.speed"
        if machine.psi_pm == 0.0:
            message = "machine: nothing tells the speed range of this machine; write max_speed: 3000 rpm"
            raise self.document.error(message, ("machine",), key=True)
        omega_m = inverter.v_dc / math.sqrt(3.0) / (machine.pole_pairs * machine.psi_pm)
        return omega_m, "where the back-EMF reaches v_dc/sqrt(3)"

    def general_remarks(self, machine: LinearMachine, inverter: Inverter, control: ControlSettings) -> None:
        """Sentences on defaults that change the result."""
        sections = self.sections
        if machine.omega_m_max is not None:
            warning = datasheet.back_emf_warning(machine.pole_pairs, machine.psi_pm, machine.omega_m_max, inverter.v_dc)
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
        if device is not None and device.on_resistance_temperature_coefficient is None:
            self.remarks.append("inverter.device.on_resistance is taken as independent of temperature")
        if device is not None and device.max_junction_temperature is None:
            self.remarks.append(f"inverter.device.max_junction_temperature is {_DEFAULT_JUNCTION:g} degC")
        if device is not None and sections.inverter.coolant_temperature is None:
            self.remarks.append(f"inverter.coolant_temperature is {format_quantity(_DEFAULT_COOLANT, 'degC')}")


def _said(quantity: Quantity) -> str:
    return f"{quantity.text} ({quantity.kind})"


def _device(section: DeviceSection) -> SwitchDevice:
    hottest = si_of(section.max_junction_temperature)
    return SwitchDevice(
        kind=section.kind,
        on_resistance=section.on_resistance.si,
        turn_on_energy=section.turn_on_energy.si,
        turn_off_energy=section.turn_off_energy.si,
        reference_current=section.reference_current.si,
        reference_voltage=section.reference_voltage.si,
        thermal_resistance=section.thermal_resistance.si,
        reverse_recovery_energy=si_of(section.reverse_recovery_energy) or 0.0,
        on_resistance_temperature_coefficient=si_of(section.on_resistance_temperature_coefficient) or 0.0,
        on_voltage=si_of(section.on_voltage) or 0.0,
        diode_voltage=si_of(section.diode_voltage) or 0.0,
        diode_resistance=si_of(section.diode_resistance) or 0.0,
        max_junction_temperature=_DEFAULT_JUNCTION if hottest is None else hottest,
    )


def _current_loop(section: CurrentLoopSection) -> CurrentLoopSettings:
    margin = si_of(section.phase_margin_min)
    return CurrentLoopSettings(
        method=section.method,
        bandwidth=si_of(section.bandwidth),
        damping=section.damping,
        spread=section.spread,
        kp=si_of(section.kp),
        ki=si_of(section.ki),
        phase_margin_min=_DEFAULT_MARGIN if margin is None else margin,
        q_formats=section.q_formats,
    )


def _speed_loop(section: SpeedLoopSection) -> SpeedLoopSettings:
    margin = si_of(section.phase_margin_min)
    return SpeedLoopSettings(
        method=section.method,
        ratio=section.ratio,
        bandwidth=si_of(section.bandwidth),
        damping=section.damping,
        spread=section.spread,
        filter_time=si_of(section.filter_time) or 0.0,
        kp=si_of(section.kp),
        ki=si_of(section.ki),
        phase_margin_min=_DEFAULT_MARGIN if margin is None else margin,
        q_formats=section.q_formats,
    )


def _fit(section: FitSection) -> FitSettings:
    return FitSettings(
        form=section.form,
        method=section.method,
        degree=section.degree,
        segments=section.segments,
        breakpoint_mode=section.breakpoint_mode,
        exact_at_zero=section.exact_at_zero,
        continuous=section.continuous,
        torque_max=si_of(section.torque_max),
        breakpoints=None if section.breakpoints is None else tuple(point.si for point in section.breakpoints),
    )


def _losses(sections: DesignFile) -> LossSettings | None:
    section = sections.losses
    if section is None:
        return None
    return LossSettings(
        points=tuple(LoadPoint(torque=point.torque.si, omega_m=point.speed.si) for point in section.points),
        strategies=section.strategies,
        modulations=section.modulations,
    )
