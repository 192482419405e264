"""The section ``control`` with its loops and its bases of per-unit gains: what may be written,
what is made of it, and what is checked across it.
"""

from __future__ import annotations

import math
from typing import Annotated, get_args

from pydantic import Field

from dqforge.machines.design.design import ROUNDING_OF_DATA, Reading
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.firmware import AnyFirmware, read_firmware
from dqforge.machines.design.sections.observer import (
    CommissioningSection,
    ObserverSection,
    OnlineEstimationSection,
    SixStepSection,
    SpeedMeasurementSection,
    check_measurement,
    check_observer,
    chosen_together,
    read_measurement,
    read_six_step,
)
from dqforge.machines.design.sections.references import ReferencesSection, read_references
from dqforge.machines.design.sections.start_up import StartUpSection, read_start_up
from dqforge.machines.design.sections.tolerances import TolerancesSection, read_tolerances
from dqforge.machines.design.settings import (
    CommissioningSettings,
    ControlSettings,
    CurrentLoopSettings,
    GainWish,
    ObserverSettings,
    OnlineEstimationSettings,
    PerUnitBases,
    SpeedLoopSettings,
    StartUpSettings,
    settings_from,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, largest_torque_within
from dqforge.machines.entries.former_keys import former
from dqforge.machines.entries.kinds import (
    Bandwidth,
    Current,
    CurrentGain,
    CurrentIntegralGain,
    FilterTime,
    GainFormats,
    PhaseCurrent,
    PhaseMargin,
    Rate,
    Section,
    Speed,
    SpeedGain,
    SpeedIntegralGain,
    Torque,
    Voltage,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule, si_of
from dqforge.machines.errors import KeyPath, about
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    LEARNED_OBSERVERS,
    SPEED_OBSERVER,
    AxisGainRule,
    CurrentFrame,
    CurrentLoopMethod,
    Feedforward,
    SpeedLoopMethod,
    VendorMethod,
)
from dqforge.machines.topologies import largest_phase_voltage
from dqforge.machines.transforms import linear_voltage
from dqforge.machines.units.quantities import format_quantity, to_digits


class StartUpWithObserverSection(StartUpSection):
    """From standstill to speed without an encoder."""

    observer: ObserverSection | None = Field(
        default=None, description="estimator from standstill on, for saliency"
    )


_CURRENT = CurrentLoopSettings()


_SPEED = SpeedLoopSettings()


ComparatorBand = Annotated[Quantity, QuantityRule("voltage", 0.0, 2e4)]


class CurrentLoopSection(Section):
    """PI current controllers of both axes."""

    method: CurrentLoopMethod = Field(
        default=_CURRENT.method, description="how the gains are found"
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="for bandwidth and damping (there the natural frequency): in Hz or rad/s",
    )
    damping: float = Field(
        default=_CURRENT.damping, gt=0.0, le=10.0, description="damping ratio, for damping"
    )
    spread: float = Field(
        default=_CURRENT.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum"
    )
    kp: CurrentGain | None = Field(default=None, description="for given: proportional gain (V/A)")
    ki: CurrentIntegralGain | None = Field(
        default=None, description="for given: integral gain (V/(A s))"
    )
    min_phase_margin: PhaseMargin | None = Field(
        default=None,
        json_schema_extra=former("phase_margin_min"),
        description="least phase margin (rad; write deg); default 30 deg",
    )
    q_formats: GainFormats | None = Field(
        default=None,
        description=(
            "fractional bits of the per-unit integers kp and ki t_s, such as [10, 15], or auto"
        ),
    )
    max_sensitivity: float = Field(
        default=_CURRENT.max_sensitivity,
        ge=1.05,
        le=4.0,
        description="for optimised: largest M_s within the tolerances",
    )
    schedule: bool = Field(
        default=_CURRENT.schedule,
        description="gains over the current, for machines that saturate: in a separate header",
    )
    frame: CurrentFrame | None = Field(
        default=_CURRENT.frame,
        description=(
            "for machines of model: waveform: dq (sinusoidal references), dqx, dqy, or table "
            "(references over the angle); default: what the machine needs"
        ),
    )
    feedforward: Feedforward = Field(
        default=_CURRENT.feedforward,
        description=(
            "for machines of model: waveform, what is added to the PI: references (their whole "
            "voltage), emf, measured (back-EMF, and coupling of measured currents) or none"
        ),
    )
    axis_gains: AxisGainRule = Field(
        default=_CURRENT.axis_gains,
        description=(
            "for machines of model: waveform: own gains for the zero-sequence axis, or one set"
        ),
    )
    harmonic_integrators: bool = Field(
        default=_CURRENT.harmonic_integrators,
        description=(
            "for machines of model: waveform: integrators that turn with the harmonics of dead "
            "time and back-EMF"
        ),
    )
    limited_waveforms: bool = Field(
        default=_CURRENT.limited_waveforms,
        description=(
            "for machines of model: waveform, frame table: currents over torque, speed and angle "
            "where the link limits them, instead of less torque"
        ),
    )
    band: Current | None = Field(
        default=None,
        description=(
            "for hysteresis, circle and look-up-table: half of the tolerance band, the radius of "
            "the circle (A); default v_dc/(8 L f_sw)"
        ),
    )
    outer_band: Current | None = Field(
        default=None,
        description="for look-up-table: error that it takes for a transient (A); default 2 band",
    )
    carrier: Rate | None = Field(
        default=None,
        description="for ramp-comparison: frequency of the triangle (Hz); default f_sw",
    )
    comparator_band: ComparatorBand | None = Field(
        default=None,
        description="for ramp-comparison: hysteresis of its comparators (V); default 0",
    )
    sampling: Rate | None = Field(
        default=None,
        description=(
            "for look-up-table, circle, predictive and trajectory: sampling of the currents (Hz); "
            "default 10 f_sw, of trajectory 2 f_sw"
        ),
    )
    pulses: Annotated[int, Field(ge=3, le=25)] | None = Field(
        default=None,
        description="for trajectory: most pulses of a leg per electrical period, odd; default 15",
    )


class SpeedLoopSection(Section):
    """PI speed controller that commands torque."""

    method: SpeedLoopMethod = Field(default=_SPEED.method, description="how the gains are found")
    ratio: int = Field(
        default=_SPEED.ratio, ge=1, le=100_000, description="current samples per speed sample"
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="for bandwidth and damping (there the natural frequency): in Hz or rad/s",
    )
    damping: float = Field(
        default=_SPEED.damping, gt=0.0, le=10.0, description="damping ratio, for damping"
    )
    spread: float = Field(
        default=_SPEED.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum"
    )
    filter_time: FilterTime | None = Field(
        default=None, description="first-order filter on the speed (s); default 0"
    )
    kp: SpeedGain | None = Field(
        default=None, description="for given: proportional gain (N m s/rad)"
    )
    ki: SpeedIntegralGain | None = Field(
        default=None, description="for given: integral gain (N m/rad)"
    )
    min_phase_margin: PhaseMargin | None = Field(
        default=None,
        json_schema_extra=former("phase_margin_min"),
        description="least phase margin (rad; write deg); default 30 deg",
    )
    q_formats: GainFormats | None = Field(
        default=None,
        description=(
            "fractional bits of the per-unit integers kp and ki t_s, such as [10, 10], or auto"
        ),
    )
    max_sensitivity: float = Field(
        default=_SPEED.max_sensitivity,
        ge=1.05,
        le=4.0,
        description="for optimised: largest M_s within the tolerances",
    )
    measurement: SpeedMeasurementSection | None = Field(
        default=None,
        description="how the speed is measured; default: taken as exact, without delay",
    )


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
        default=None,
        description="base torque (N m); default the largest torque at the base current",
    )


class ControlSection(Section):
    """Sampling and controllers."""

    sampling_frequency: Rate | None = Field(
        default=None,
        description="sampling of the current control (Hz); default the switching frequency",
    )
    current_loop: CurrentLoopSection = Field(
        default_factory=CurrentLoopSection, description="current controllers"
    )
    speed_loop: SpeedLoopSection | None = Field(
        default=None, description="speed controller, optional"
    )
    observer: ObserverSection | None = Field(default=None, description="speed observer, optional")
    per_unit: PerUnitSection = Field(
        default_factory=PerUnitSection, description="bases of the per-unit gains"
    )
    tolerances: TolerancesSection | None = Field(
        default=None,
        description="tolerances of the drive data; every loop must hold throughout",
    )
    references: ReferencesSection | None = Field(
        default=None, description="slopes of the references, and what corrects them"
    )
    firmware: AnyFirmware | None = Field(
        default=None,
        description="third-party firmware whose loops run the drive: vesc, simplefoc, ...",
    )
    six_step: SixStepSection | None = Field(
        default=None,
        description="for the observers zero-crossing, emf-integration and diode-conduction: the "
        "six-step drive",
    )
    start_up: StartUpWithObserverSection | None = Field(
        default=None, description="from standstill to speed without an encoder"
    )
    online_estimation: OnlineEstimationSection | None = Field(
        default=None, description="resistance and magnet flux estimated while the drive runs"
    )
    commissioning: CommissioningSection | None = Field(
        default=None, description="tests of the drive on its own machine, for dqforge identify"
    )
    gains: bool = Field(
        default=True, description="false: no loops are tuned, the header holds the references alone"
    )


def check_loops(control: ControlSection, machine: Machine, document: YamlDocument) -> None:
    """Check that each controller has the keys that its method needs.

    Raises `InputError` with a position.
    """
    check_method(control.current_loop, ("control", "current_loop"), document)
    check_schedule(control.current_loop, machine, document)
    wants_inertia = []
    if control.speed_loop is not None:
        check_method(control.speed_loop, ("control", "speed_loop"), document)
        check_measurement(control.speed_loop.measurement, control.observer is not None, document)
        wants_inertia.append("speed_loop")
    low = None if control.start_up is None else control.start_up.observer
    if low is not None and low.method != SPEED_OBSERVER:
        check_observer(low, document, ("control", "start_up", "observer"))
    if control.observer is not None:
        check_observer(control.observer, document)
        if control.observer.method == SPEED_OBSERVER:
            wants_inertia.append("observer")
        if machine.psi_pm == 0.0:
            message = (
                "control.observer: this observer needs a magnet flux, the machine has none; remove "
                "it"
            )
            raise document.error(message, ("control", "observer"), key=True)
    if wants_inertia and machine.inertia is None:
        message = (
            f"control.{wants_inertia[0]} needs the inertia; write machine.inertia, such as 200e-6 "
            "kg m^2"
        )
        raise document.error(message, ("control", wants_inertia[0]), key=True)


def check_observer_format(
    control: ControlSection, export: ExportSection, document: YamlDocument
) -> None:
    """Refuse integers where the observer has none.

    Raises `InputError` with a position.
    """
    method = None if control.observer is None else control.observer.method
    if method in LEARNED_OBSERVERS and not set(export.control) <= {"float32"}:
        message = (
            f"control.observer: the method '{method}' is not there in fixed point; write "
            "export.control: float32, or method: flux"
        )
        raise document.error(message, ("control", "observer", "method"))


def sampling_warning(machine: Machine, f_s: float) -> str:
    """Sentence on a sampling (Hz) that is slow against the electrical frequency at top speed,
    or an empty text.
    """
    if machine.omega_m_max is None:
        return ""
    f_e = machine.pole_pairs * machine.omega_m_max / (2.0 * math.pi)
    if f_s >= 10.0 * f_e:
        return ""
    return (
        f"at {format_quantity(machine.omega_m_max, 'rpm')} there are only {f_s / f_e:.2g} samples "
        "per electrical period; the current control needs about ten"
    )


def check_sampling(section: ControlSection, f_sw: float, document: YamlDocument) -> None:
    """Check the sampling against the switching frequency ``f_sw`` in Hz.

    Raises `InputError` with a position.
    """
    sampling = section.sampling_frequency
    if sampling is not None and not f_sw / 10.0 <= sampling.si <= 2.0 * f_sw * (
        1.0 + ROUNDING_OF_DATA
    ):
        raise document.error(
            f"control.sampling_frequency {sampling.text} does not belong to a switching frequency "
            f"of {format_quantity(f_sw, 'Hz')}; write {format_quantity(f_sw / 10.0, 'Hz')} to "
            f"{format_quantity(2.0 * f_sw, 'Hz')}",
            ("control", "sampling_frequency"),
        )


def _left_open(section: ControlSection) -> bool:
    """Whether a speed loop on a position observer is left to the rule for both."""
    loop, observer = section.speed_loop, section.observer
    if loop is None or observer is None or observer.method == SPEED_OBSERVER:
        return False
    return loop.method == "symmetrical-optimum" and "spread" not in loop.model_fields_set


@about("control")
def read_control(
    section: ControlSection,
    machine: Machine,
    inverter: Inverter,
    i_max: float,
    rated_speed: float | None,
    reading: Reading,
    *,
    any_back_emf: bool,
) -> ControlSettings:
    """Controllers in SI units, with the bases that the file leaves open.

    ``i_max`` in A (peak) is the current limit of the drive, ``rated_speed`` in rad/s (mechanical)
    that of the machine, if known; ``any_back_emf`` as of `read_bases`. Gains are taken as required,
    see `read_gain_wish`.
    """
    f_s = si_of(section.sampling_frequency)
    if f_s is None:
        f_s = inverter.f_sw
        reading.remarks.append(
            "control.sampling_frequency is taken as the switching frequency, "
            f"{format_quantity(f_s, 'Hz')}"
        )
    warning = sampling_warning(machine, f_s)
    reading.remarks.extend([warning] if warning else [])
    speed_loop, observer = section.speed_loop, section.observer
    bases = read_bases(
        section.per_unit, machine, inverter, i_max, rated_speed, reading, any_back_emf=any_back_emf
    )
    largest = bases.speed if machine.omega_m_max is None else machine.omega_m_max
    own_loop = (
        None
        if speed_loop is None
        else settings_from(
            SpeedLoopSettings,
            speed_loop,
            measurement=read_measurement(speed_loop.measurement, largest),
        )
    )
    own_observer = None if observer is None else settings_from(ObserverSettings, observer)
    tolerances = read_tolerances(
        section.tolerances, speed_loop is not None, machine, inverter, i_max, reading
    )
    if own_loop is not None and own_observer is not None and _left_open(section):
        own_loop, own_observer = chosen_together(
            own_loop, own_observer, inverter, tolerances, reading
        )
    return ControlSettings(
        t_s=1.0 / f_s,
        current_loop=settings_from(CurrentLoopSettings, section.current_loop),
        speed_loop=own_loop,
        observer=own_observer,
        bases=bases,
        tolerances=tolerances,
        references=read_references(section.references),
        firmware=read_firmware(section.firmware),
        six_step=read_six_step(section.six_step, None if observer is None else observer.method),
        start_up=_read_start_up(section.start_up, reading),
        online_estimation=None
        if section.online_estimation is None
        else settings_from(OnlineEstimationSettings, section.online_estimation),
        commissioning=None
        if section.commissioning is None
        else settings_from(CommissioningSettings, section.commissioning),
    )


def _read_start_up(
    section: StartUpWithObserverSection | None, reading: Reading
) -> StartUpSettings | None:
    """The start, with the settings of its own observer."""
    own = None if section is None else section.observer
    low = None if own is None else settings_from(ObserverSettings, own)
    return read_start_up(section, reading, observer=low)


def read_gain_wish(
    section: ControlSection, named: bool, needed: bool, document: YamlDocument
) -> GainWish:
    """Whether the design can do without gains, checked against what needs them.

    ``named`` says that the file has the section, ``needed`` that something else of the design
    needs gains. Raises `InputError` with a position.
    """
    if section.gains:
        return "required" if named or needed else "optional"
    wants = (section.speed_loop, section.observer, section.tolerances)
    if needed or section.current_loop.schedule or any(part is not None for part in wants):
        raise document.error(
            "control.gains is false, but the speed loop, observer, schedule, tolerances, "
            "export.control or simulation of this design need gains; leave it out, or those",
            ("control", "gains"),
        )
    return "none"


# The sections ``control.current_loop`` and ``control.speed_loop``: what may be written, and which
# keys a method needs.

_EXAMPLES: dict[tuple[str | int, str], str] = {
    ("current_loop", "bandwidth"): "500 Hz",
    ("current_loop", "kp"): "1.1 V/A",
    ("current_loop", "ki"): "32 V/(A s)",
    ("speed_loop", "bandwidth"): "20 Hz",
    ("speed_loop", "kp"): "0.1 N m s/rad",
    ("speed_loop", "ki"): "6 N m/rad",
}


def _needed(loop: CurrentLoopSection | SpeedLoopSection) -> tuple[str, ...]:
    """The keys that a method cannot do without.

    TI makes the gains of the speed loop of the bandwidth of the current loop.
    """
    if loop.method == "given":
        return ("kp", "ki")
    if loop.method == "ti" and isinstance(loop, SpeedLoopSection):
        return ()
    named = ("bandwidth", "damping", *get_args(VendorMethod))
    return ("bandwidth",) if loop.method in named else ()


def check_method(
    loop: CurrentLoopSection | SpeedLoopSection, path: KeyPath, document: YamlDocument
) -> None:
    """Check that a loop has the keys that its method needs, and no other.

    Raises `InputError` with a position.
    """
    needed = _needed(loop)
    where = ".".join(map(str, path))
    for key in needed:
        if getattr(loop, key) is None:
            example = _EXAMPLES[path[-1], key]
            raise document.error(
                f"{where}: the method '{loop.method}' needs the key '{key}'; write {key}: "
                f"{example}",
                (*path, "method"),
            )
    if loop.method == "ramp-comparison":
        return
    for key in ("bandwidth", "kp", "ki"):
        if getattr(loop, key) is not None and key not in needed:
            method = "bandwidth" if key == "bandwidth" else "given"
            raise document.error(
                f"{where}: the method '{loop.method}' does not use '{key}'; write method: "
                f"{method}, or remove the key",
                (*path, key),
                key=True,
            )
    if "max_sensitivity" in loop.model_fields_set and loop.method != "optimised":
        raise document.error(
            f"{where}: the method '{loop.method}' does not use 'max_sensitivity'; write method: "
            "optimised, or remove the key",
            (*path, "max_sensitivity"),
            key=True,
        )


def check_schedule(loop: CurrentLoopSection, machine: Machine, document: YamlDocument) -> None:
    """Check that gains over the current can be had.

    Raises `InputError` with a position.
    """
    path = ("control", "current_loop", "schedule")
    if not loop.schedule:
        return
    if isinstance(machine, LinearMachine):
        message = (
            "control.current_loop.schedule: the machine's inductances are constant, so are the "
            "gains; remove it"
        )
        raise document.error(message, path)
    if loop.method in get_args(VendorMethod):
        message = (
            f"control.current_loop.schedule: the gains by '{loop.method}' are constant in that "
            "firmware; write another method, or schedule: false"
        )
        raise document.error(message, path)
    if loop.method == "given":
        message = (
            "control.current_loop.schedule: given gains are constant; write another method, or "
            "schedule: false"
        )
        raise document.error(message, path)


# The section ``control.per_unit``: bases of per-unit gains, given or found.


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
    torque, torque_from = (
        _base_torque(machine, current) if section.torque is None else (section.torque.si, "")
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


def _base_torque(machine: Machine, current: float) -> tuple[float, str]:
    """Base torque in N m that the file leaves open, and where it comes from."""
    of_magnets = machine.torque_per_ampere * current
    largest = largest_torque_within(machine, current)
    if largest <= of_magnets * (1.0 + 1e-12):
        return of_magnets, "3/2 p psi_pm times the base current"
    # A saturated machine is scanned: the margin covers what lies between two angles.
    torque = to_digits(1.0001 * largest, 3, up=True)
    return torque, "the largest torque at the base current, rounded up"


def _base_voltage(inverter: Inverter, any_back_emf: bool) -> tuple[float, str]:
    """Base voltage in V that the file leaves open, and where it comes from."""
    if any_back_emf:
        needed = largest_phase_voltage(inverter.topology, inverter.v_dc)
        return needed, f"the largest voltage of a phase, {inverter.topology}"
    return linear_voltage(inverter.v_dc), "v_dc/sqrt(3)"


def _base_speed(
    machine: Machine, inverter: Inverter, rated_speed: float | None, reading: Reading
) -> tuple[float, str]:
    """Base speed in rad/s that the file leaves open, and where it comes from."""
    if machine.omega_m_max is not None:
        return machine.omega_m_max, "machine.max_speed"
    if rated_speed is not None:
        return rated_speed, "machine.rated.speed"
    if machine.psi_pm == 0.0:
        message = "machine: the speed range of this machine is unknown; write max_speed: 3000 rpm"
        raise reading.document.error(message, ("machine",), key=True)
    omega_m = linear_voltage(inverter.v_dc) / (machine.pole_pairs * machine.psi_pm)
    return omega_m, "where the back-EMF reaches v_dc/sqrt(3)"
