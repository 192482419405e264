"""The section ``control``: what may be written, what is made of it, and
what is checked across it.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, get_args

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from dqforge.machines.design.from_section import settings_from
from dqforge.machines.design.reading import ROUNDING_OF_DATA, Reading
from dqforge.machines.design.sections.firmware import AnyFirmware, read_firmware
from dqforge.machines.design.sections.per_unit import PerUnitSection, read_bases
from dqforge.machines.design.sections.references import ReferencesSection, read_references
from dqforge.machines.design.sections.tolerances import TolerancesSection, read_tolerances
from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    GainWish,
    ObserverSettings,
    SpeedLoopSettings,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.entries.kinds import (
    Bandwidth,
    CurrentGain,
    CurrentIntegralGain,
    FilterTime,
    GainFormats,
    PhaseMargin,
    Rate,
    Section,
    SpeedGain,
    SpeedIntegralGain,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    OBSERVER_KEYS,
    SPEED_OBSERVER,
    AxisGainRule,
    CurrentFrame,
    CurrentLoopMethod,
    Feedforward,
    ObserverMethodName,
    ObserverTuningName,
    SpeedLoopMethod,
    VendorMethod,
)
from dqforge.machines.places import KeyPath, about
from dqforge.machines.units.quantities import format_quantity

_CURRENT = CurrentLoopSettings()


_SPEED = SpeedLoopSettings()


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
    phase_margin_min: PhaseMargin | None = Field(
        default=None, description="least phase margin (rad; write deg); default 30 deg"
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
        description="gains over the current, for machines that saturate: a header of its own",
    )
    frame: CurrentFrame | None = Field(
        default=_CURRENT.frame,
        description=(
            "for machines of model: waveform: dq (sinusoidal references), dqx, dqy, or table "
            "(references over the angle); default: what the machine asks for"
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
    phase_margin_min: PhaseMargin | None = Field(
        default=None, description="least phase margin (rad; write deg); default 30 deg"
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


def _known(value: Any, words: ValidatorFunctionWrapHandler) -> Any:
    """Let a registered method pass; all else is judged by the words of the package."""
    return value if isinstance(value, str) and value in OBSERVER_KEYS else words(value)


def _users(key: str) -> str:
    """The methods that take a key, in words."""
    return " and ".join(name for name, keys in OBSERVER_KEYS.items() if key in keys)


class ObserverSection(Section):
    """Speed or position observer."""

    method: Annotated[ObserverMethodName, WrapValidator(_known)] = Field(
        default=SPEED_OBSERVER, description="how speed or position is observed"
    )
    pole: Bandwidth | None = Field(
        default=None,
        description="for reduced-order: the pole lies at -pole (rad/s, or Hz times 2 pi)",
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="of the EMF filter or of the flux correction at rest (rad/s, or Hz times 2 pi)",
    )
    pll_bandwidth: Bandwidth | None = Field(
        default=None,
        description="natural frequency of the phase-locked loop (rad/s, or Hz times 2 pi)",
    )
    damping: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None, description="damping ratio of the phase-locked loop; default 1"
    )
    speed_gain: Annotated[float, Field(ge=0.0, le=10.0)] | None = Field(
        default=None,
        description=f"for {_users('speed_gain')}: share of the speed in the correction of the flux",
    )
    tuning: ObserverTuningName = Field(
        default="named",
        description="named: what is left open has its usual value; optimised: it is searched for",
    )


class ControlSection(Section):
    """Sampling and controllers."""

    sampling_frequency: Rate | None = Field(
        default=None,
        description="sampling of the current control (Hz); default the switching frequency",
    )
    current_loop: CurrentLoopSection = Field(
        default=CurrentLoopSection(), description="current controllers"
    )
    speed_loop: SpeedLoopSection | None = Field(
        default=None, description="speed controller, if one is wanted"
    )
    observer: ObserverSection | None = Field(
        default=None, description="speed observer, if one is wanted"
    )
    per_unit: PerUnitSection = Field(
        default=PerUnitSection(), description="bases of the per-unit gains"
    )
    tolerances: TolerancesSection | None = Field(
        default=None,
        description="how far the drive may be from its data; every loop must hold throughout",
    )
    references: ReferencesSection | None = Field(
        default=None, description="slopes of the references, and what corrects them"
    )
    firmware: AnyFirmware | None = Field(
        default=None,
        description="firmware of others whose loops run the drive: vesc, simplefoc, ...",
    )
    gains: bool = Field(
        default=True, description="false: no loops are tuned, the header holds the references alone"
    )


_EXAMPLES: dict[tuple[str | int, str], str] = {
    ("current_loop", "bandwidth"): "500 Hz",
    ("current_loop", "kp"): "1.1 V/A",
    ("current_loop", "ki"): "32 V/(A s)",
    ("speed_loop", "bandwidth"): "20 Hz",
    ("speed_loop", "kp"): "0.1 N m s/rad",
    ("speed_loop", "ki"): "6 N m/rad",
}


def check_loops(control: ControlSection, machine: Machine, document: YamlDocument) -> None:
    """Check that each controller has the keys that its method needs.

    Raises `InputError` with a position.
    """
    _check_method(control.current_loop, ("control", "current_loop"), document)
    _check_schedule(control.current_loop, machine, document)
    wants_inertia = []
    if control.speed_loop is not None:
        _check_method(control.speed_loop, ("control", "speed_loop"), document)
        wants_inertia.append("speed_loop")
    if control.observer is not None:
        _check_observer(control.observer, document)
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


def _check_observer(observer: ObserverSection, document: YamlDocument) -> None:
    path, used = ("control", "observer"), OBSERVER_KEYS[observer.method]
    if observer.method == SPEED_OBSERVER and observer.pole is None:
        message = (
            "control.observer: the method 'reduced-order' needs the key 'pole'; write pole: 400 "
            "rad/s"
        )
        raise document.error(message, path, key=True)
    for key in ("pole", "bandwidth", "pll_bandwidth", "damping", "speed_gain"):
        if getattr(observer, key) is not None and key not in used:
            raise document.error(
                f"control.observer: the method '{observer.method}' does not use '{key}'; remove "
                f"it, or write another method (it uses {', '.join(used) or 'no key but tuning'})",
                (*path, key),
                key=True,
            )


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


def _check_method(
    loop: CurrentLoopSection | SpeedLoopSection, path: KeyPath, document: YamlDocument
) -> None:
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


def _check_schedule(loop: CurrentLoopSection, machine: Machine, document: YamlDocument) -> None:
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
    return ControlSettings(
        t_s=1.0 / f_s,
        current_loop=settings_from(CurrentLoopSettings, section.current_loop),
        speed_loop=None if speed_loop is None else settings_from(SpeedLoopSettings, speed_loop),
        observer=None if observer is None else settings_from(ObserverSettings, observer),
        bases=read_bases(
            section.per_unit,
            machine,
            inverter,
            i_max,
            rated_speed,
            reading,
            any_back_emf=any_back_emf,
        ),
        tolerances=read_tolerances(
            section.tolerances, speed_loop is not None, machine, inverter, i_max, reading
        ),
        references=read_references(section.references),
        firmware=read_firmware(section.firmware),
    )


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
