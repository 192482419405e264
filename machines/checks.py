"""Checks between the keys of a design file: what each value alone cannot show."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines import datasheet
from dqforge.machines.entries import Quantity
from dqforge.machines.places import KeyPath
from dqforge.machines.quantities import format_quantity
from dqforge.machines.schema import CurrentLoopSection, DesignFile, ObserverSection, SpeedLoopSection
from dqforge.machines.schema_machine import MachineSection
from dqforge.machines.settings import Strategy
from dqforge.machines.speed_remarks import bare_speed_hint
from dqforge.machines.synchronous import LinearMachine, Machine
from dqforge.machines.yaml_source import YamlDocument

# A torque that is written as the limit itself, rounded, is meant to be the limit.
_ROUNDING = 1e-3
_EXAMPLES: dict[tuple[str | int, str], str] = {
    ("current_loop", "bandwidth"): "500 Hz",
    ("current_loop", "kp"): "1.1 V/A",
    ("current_loop", "ki"): "32 V/(A s)",
    ("speed_loop", "bandwidth"): "20 Hz",
    ("speed_loop", "kp"): "0.1 N m s/rad",
    ("speed_loop", "ki"): "6 N m/rad",
}


def si_of(quantity: Quantity | None) -> float | None:
    """SI value of an optional entry."""
    return None if quantity is None else quantity.si


def check_machine(section: MachineSection, machine: Machine, document: YamlDocument) -> None:
    """Check the machine as a whole against its name plate; raises `InputError` with a position."""
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0 and machine.l_d == machine.l_q:
        raise document.error(
            "machine: no magnet flux and inductance_d equal to inductance_q, so it gives no torque; "
            "write magnet_flux or two different inductances",
            ("machine", "inductance_q"),
        )
    rated = section.rated
    torque, speed, power, frequency = map(si_of, (rated.torque, rated.speed, rated.power, rated.frequency))
    if frequency is not None and speed is not None:
        with document.at(("machine", "rated", "frequency")):
            datasheet.check_rated_frequency(machine.pole_pairs, frequency, speed)
    if power is not None and torque is not None and speed is not None:
        with document.at(("machine", "rated", "power")):
            datasheet.check_rated_power(power, torque, speed)
    if rated.current is not None:
        current = datasheet.peak_current(rated.current.si, rated.current.kind or "", section.connection)
        _check_rated_current(current, machine, document)
    if torque is not None:
        with document.at(("machine", "rated", "torque")):
            datasheet.check_rated_torque(torque, largest_torque_within(machine, machine.i_max))
    most = machine.omega_m_max
    if rated.speed is not None and most is not None and rated.speed.si > most * (1.0 + _ROUNDING):
        hint = bare_speed_hint(rated.speed)
        message = f"machine.rated.speed {format_quantity(rated.speed.si, 'rpm')} is above max_speed; {hint}"
        raise document.error(message, ("machine", "rated", "speed"))


def _check_rated_current(current: float, machine: Machine, document: YamlDocument) -> None:
    if current <= machine.i_max * (1.0 + _ROUNDING):
        return
    raise document.error(
        f"machine.rated.current is {format_quantity(current, 'A')} peak, above max_current "
        f"{format_quantity(machine.i_max, 'A')} peak; check the kinds (peak or rms) of both",
        ("machine", "rated", "current"),
    )


def check_inverter(sections: DesignFile, document: YamlDocument) -> None:
    """Check dead time and sampling against the switching frequency; raises `InputError` with a position."""
    f_sw = sections.inverter.switching_frequency.si
    dead_time = sections.inverter.dead_time
    if dead_time is not None and dead_time.si >= 0.5 / f_sw:
        raise document.error(
            f"inverter.dead_time {dead_time.text} is not shorter than half a switching period, "
            f"{format_quantity(0.5 / f_sw, 's')}; check both units",
            ("inverter", "dead_time"),
        )
    sampling = sections.control.sampling_frequency
    if sampling is not None and not f_sw / 10.0 <= sampling.si <= 2.0 * f_sw * (1.0 + _ROUNDING):
        raise document.error(
            f"control.sampling_frequency {sampling.text} does not belong to a switching frequency of "
            f"{format_quantity(f_sw, 'Hz')}; write {format_quantity(f_sw / 10.0, 'Hz')} to "
            f"{format_quantity(2.0 * f_sw, 'Hz')}",
            ("control", "sampling_frequency"),
        )
    if sections.losses is not None and sections.inverter.device is None:
        raise document.error(
            "losses: the loss comparison needs the switch; write the section inverter.device, or remove losses",
            ("losses",),
            key=True,
        )


def check_loops(sections: DesignFile, machine: Machine, document: YamlDocument) -> None:
    """Check that each controller has the keys that its method needs; raises `InputError` with a position."""
    control = sections.control
    _check_method(control.current_loop, ("control", "current_loop"), document)
    _check_schedule(control.current_loop, machine, document)
    wants_inertia = []
    if control.speed_loop is not None:
        _check_method(control.speed_loop, ("control", "speed_loop"), document)
        wants_inertia.append("speed_loop")
    if control.observer is not None:
        _check_observer(control.observer, document)
        if control.observer.method == "reduced-order":
            wants_inertia.append("observer")
        if machine.psi_pm == 0.0:
            message = "control.observer: this observer needs a magnet flux, the machine has none; remove it"
            raise document.error(message, ("control", "observer"), key=True)
    if wants_inertia and machine.inertia is None:
        message = f"control.{wants_inertia[0]} needs the inertia; write machine.inertia, such as 200e-6 kg m^2"
        raise document.error(message, ("control", wants_inertia[0]), key=True)


_OBSERVER_KEYS = {
    "reduced-order": ("pole",),
    "extended-emf": ("bandwidth", "pll_bandwidth", "damping"),
    "flux": ("bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    "open-loop-flux": ("bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    "matsui-voltage": ("bandwidth", "pll_bandwidth", "damping"),
    "matsui-current": ("bandwidth", "pll_bandwidth"),
    "ekf": (),
}


def _check_observer(observer: ObserverSection, document: YamlDocument) -> None:
    path, used = ("control", "observer"), _OBSERVER_KEYS[observer.method]
    if observer.method == "reduced-order" and observer.pole is None:
        message = "control.observer: the method 'reduced-order' needs the key 'pole'; write pole: 400 rad/s"
        raise document.error(message, path, key=True)
    for key in ("pole", "bandwidth", "pll_bandwidth", "damping", "speed_gain"):
        if getattr(observer, key) is not None and key not in used:
            raise document.error(
                f"control.observer: the method '{observer.method}' does not use '{key}'; remove it, or write another "
                f"method (it uses {', '.join(used) or 'no key but tuning'})",
                (*path, key),
                key=True,
            )


def _check_method(loop: CurrentLoopSection | SpeedLoopSection, path: KeyPath, document: YamlDocument) -> None:
    needed = {"bandwidth": ("bandwidth",), "damping": ("bandwidth",), "given": ("kp", "ki")}.get(loop.method, ())
    where = ".".join(map(str, path))
    for key in needed:
        if getattr(loop, key) is None:
            example = _EXAMPLES[path[-1], key]
            raise document.error(
                f"{where}: the method '{loop.method}' needs the key '{key}'; write {key}: {example}", (*path, "method")
            )
    for key in ("bandwidth", "kp", "ki"):
        if getattr(loop, key) is not None and key not in needed:
            method = "bandwidth" if key == "bandwidth" else "given"
            raise document.error(
                f"{where}: the method '{loop.method}' does not use '{key}'; write method: {method}, or remove the key",
                (*path, key),
                key=True,
            )
    if "max_sensitivity" in loop.model_fields_set and loop.method != "optimised":
        raise document.error(
            f"{where}: the method '{loop.method}' does not use 'max_sensitivity'; write method: optimised, "
            "or remove the key",
            (*path, "max_sensitivity"),
            key=True,
        )


def _check_schedule(loop: CurrentLoopSection, machine: Machine, document: YamlDocument) -> None:
    path = ("control", "current_loop", "schedule")
    if not loop.schedule:
        return
    if isinstance(machine, LinearMachine):
        message = "control.current_loop.schedule: the machine's inductances are constant, so are the gains; remove it"
        raise document.error(message, path)
    if loop.method == "given":
        message = "control.current_loop.schedule: given gains are constant; write another method, or schedule: false"
        raise document.error(message, path)


def check_halves(sections: DesignFile, document: YamlDocument) -> None:
    """Refuse what cannot keep the halves of a flux map apart."""
    section = sections.machine.flux_map
    if section is None or section.symmetry != "keep":
        return
    budget = any(
        part is not None for part in (sections.fit.torque_error, sections.fit.loss_penalty, sections.fit.flash)
    )
    if budget or sections.fit.format in ("q15", "q31"):
        raise document.error(
            "machine.flux_map.symmetry: keep needs references in float32 of a given form; write fit: format: float32 "
            "and leave the budget out, or symmetry: average",
            ("machine", "flux_map", "symmetry"),
        )


def check_fit(sections: DesignFile, machine: Machine, i_max: float, document: YamlDocument) -> None:
    """Check strategy, form and domain of the current references; raises `InputError` with a position."""
    strategy, fit = sections.operation.strategy, sections.fit
    if strategy == "id0" and machine.psi_pm == 0.0:
        message = "operation.strategy: id0 gives no torque without magnets; write strategy: mtpa"
        raise document.error(message, ("operation", "strategy"))
    _check_form(sections, machine, document)
    _check_speed(sections, machine, document)
    _check_budget(sections, document)
    largest = largest_torque_within(machine, i_max, strategy)
    end = largest if fit.torque_max is None else fit.torque_max.si
    if fit.breakpoints is not None:
        _check_breakpoints(fit.breakpoints, fit.segments, end, document)


def largest_torque_within(machine: Machine, i_max: float, strategy: Strategy = "mtpa") -> float:
    """Largest torque in N m within a current limit in A; of saturated machines by a scan, good for a cross-check."""
    if isinstance(machine, LinearMachine):
        saliency = machine.saliency if strategy == "mtpa" else 0.0
        return datasheet.largest_torque(machine.pole_pairs, machine.psi_pm, saliency, i_max)
    angle = np.linspace(0.0, np.pi, 721) if strategy == "mtpa" else np.array([0.5 * np.pi])
    region = machine.region
    if region is None or region.covers(i_max):
        return float(np.max(machine.torque(i_max * np.cos(angle), i_max * np.sin(angle))))
    length = np.array([min(i_max, region.end_of_ray(part)) for part in angle])
    return float(np.max(machine.torque(length * np.cos(angle), length * np.sin(angle))))


def _check_form(sections: DesignFile, machine: Machine, document: YamlDocument) -> None:
    """Check that the machine and the strategy have the form that is asked for."""
    form, path = sections.fit.form, ("fit", "form")
    if sections.fit.torque_error is not None or sections.fit.loss_penalty is not None:
        return  # it is searched for
    if (form == "even-odd" or sections.fit.flat_at_zero) and sections.fit.degree < 2:
        reason = "form: even-odd" if form == "even-odd" else "flat_at_zero"
        raise document.error(f"fit.degree: {reason} needs degree 2 or more; write degree: 3", ("fit", "degree"))
    if not isinstance(machine, LinearMachine):
        if form != "polynomial" and "form" in sections.fit.model_fields_set:
            message = f"fit.form: {form} needs constant inductances, the machine saturates; write form: polynomial"
            raise document.error(message, path)
        return
    if sections.operation.strategy == "mtpa" and form == "closed-form" and machine.l_d == machine.l_q:
        message = "fit.form: closed-form needs inductance_d and inductance_q to differ; write form: torque-exact"
        raise document.error(message, path)
    if form == "even-odd" and machine.psi_pm == 0.0:
        message = "fit.form: even-odd needs currents that are smooth at zero torque; write form: polynomial"
        raise document.error(message, path)
    if form in ("closed-form", "even-odd") and sections.operation.speed is not None:
        other = "polynomial" if machine.psi_pm == 0.0 else "torque-exact"
        message = f"fit.form: {form} follows the MTPA locus, which operation.speed leaves; write form: {other}"
        raise document.error(message, path)
    if form == "torque-exact" and machine.psi_pm == 0.0:
        other = "closed-form" if sections.operation.speed is None else "polynomial"
        message = f"fit.form: torque-exact divides by the magnet torque, the machine has none; write form: {other}"
        raise document.error(message, path)


def _check_budget(sections: DesignFile, document: YamlDocument) -> None:
    """Check that what a budget searches for is not given as well."""
    fit = sections.fit
    budget = [key for key in ("torque_error", "loss_penalty", "flash") if getattr(fit, key) is not None]
    for key in ("form", "degree", "segments", "breakpoints", "breakpoint_mode"):
        if budget and key in fit.model_fields_set:
            message = f"fit.{key} is chosen by the budget fit.{budget[0]}; remove one of the two"
            raise document.error(message, ("fit", key), key=True)
    if budget == ["flash"]:
        message = "fit.flash alone says nothing about errors; write torque_error: 0.2 % or loss_penalty: 0.1 %, too"
        raise document.error(message, ("fit", "flash"), key=True)


def _check_speed(sections: DesignFile, machine: Machine, document: YamlDocument) -> None:
    """Check the speed for which the field is weakened."""
    operation, weakening = sections.operation, sections.field_weakening
    for key in ("modulation", "voltage_margin"):
        if operation.speed is None and weakening is None and key in operation.model_fields_set:
            message = f"operation.{key} limits the voltage at a speed; write speed: 3000 rpm, or remove the key"
            raise document.error(message, ("operation", key), key=True)
    if operation.speed is None:
        return
    if operation.strategy == "id0":
        message = "operation.speed: id0 cannot weaken the field; write strategy: mtpa, or remove the speed"
        raise document.error(message, ("operation", "speed"), key=True)
    most = machine.omega_m_max
    if most is not None and operation.speed.si > most * (1.0 + _ROUNDING):
        shown, limit = format_quantity(operation.speed.si, "rpm"), format_quantity(most, "rpm")
        message = f"operation.speed: {shown} is above machine.max_speed {limit}; {bare_speed_hint(operation.speed)}"
        raise document.error(message, ("operation", "speed"))


def _check_breakpoints(breakpoints: tuple[Quantity, ...], segments: int, end: float, document: YamlDocument) -> None:
    path = ("fit", "breakpoints")
    if len(breakpoints) != segments - 1:
        raise document.error(
            f"fit.breakpoints lists {len(breakpoints)}, but {segments} segments meet at {segments - 1}; "
            f"write segments: {len(breakpoints) + 1}, or {segments - 1} breakpoints",
            path,
        )
    for index, point in enumerate(breakpoints):
        before = breakpoints[index - 1].si if index else 0.0
        if point.si <= before:
            message = f"fit.breakpoints: {point.text} does not ascend; write the breakpoints in order"
            raise document.error(message, (*path, index))
        if point.si >= end:
            limit = format_quantity(end, "N m")
            message = f"fit.breakpoints: {point.text} lies beyond the end of the domain, {limit}; write less"
            raise document.error(message, (*path, index))


def check_waveform(sections: DesignFile, document: YamlDocument) -> None:
    """Check that the section on phase currents, and a topology with a neutral, have a machine they are for."""
    is_waveform = sections.machine.model == "waveform"
    if sections.waveform.model_fields_set and not is_waveform:
        message = (
            "waveform: phase currents are shaped for a machine of model: waveform; write it, or remove the section"
        )
        raise document.error(message, ("waveform",), key=True)
    if sections.machine.inductance_harmonics is not None:
        _check_saliency(sections, document)
    if sections.inverter.topology != "three-wire" and not is_waveform:
        raise document.error(
            f"inverter.topology: {sections.inverter.topology} serves machines of model: waveform; write three-wire",
            ("inverter", "topology"),
        )


def _check_saliency(sections: DesignFile, document: YamlDocument) -> None:
    """Check that nothing is asked for that needs constant inductances."""
    if sections.waveform.form == "table":
        message = (
            "waveform.form: a table over the angle needs currents in proportion to the torque, which those of a machine"
            " with inductance_harmonics are not; write harmonics"
        )
        raise document.error(message, ("waveform", "form"))
    if sections.inverter.topology == "diode-neutral":
        message = (
            "inverter.topology: diode-neutral is not offered for a machine with inductance_harmonics; write three-wire"
        )
        raise document.error(message, ("inverter", "topology"))
    if sections.simulation is not None:
        message = (
            "simulation: a machine with inductance_harmonics is not simulated, the simulated phases have constant"
            " inductances; remove the section"
        )
        raise document.error(message, ("simulation",), key=True)


def check_comparison(sections: DesignFile, machine: Machine, document: YamlDocument) -> None:
    """Check the loss comparison: no alternative twice, no point beyond the largest speed."""
    if sections.losses is None:
        return
    for key, names in (("strategies", sections.losses.strategies), ("modulations", sections.losses.modulations)):
        for index, name in enumerate(names):
            if name in names[:index]:
                raise document.error(f"losses.{key}: '{name}' is listed twice; remove one", ("losses", key, index))
    most = machine.omega_m_max
    for index, point in enumerate(sections.losses.points):
        if most is not None and abs(point.speed.si) > most * (1.0 + _ROUNDING):
            shown, limit = format_quantity(point.speed.si, "rpm"), format_quantity(most, "rpm")
            message = f"losses.points[{index}].speed: {shown} is above machine.max_speed {limit}"
            raise document.error(f"{message}; {bare_speed_hint(point.speed)}", ("losses", "points", index, "speed"))


def sampling_warning(machine: Machine, f_s: float) -> str:
    """Sentence on a sampling (Hz) that is slow against the electrical frequency at top speed, or an empty text."""
    if machine.omega_m_max is None:
        return ""
    f_e = machine.pole_pairs * machine.omega_m_max / (2.0 * math.pi)
    if f_s >= 10.0 * f_e:
        return ""
    return (
        f"at {format_quantity(machine.omega_m_max, 'rpm')} there are only {f_s / f_e:.2g} samples per electrical "
        "period; the current control needs about ten"
    )
