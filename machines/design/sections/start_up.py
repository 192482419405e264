"""The section ``control.start_up``: how a drive without encoder comes from standstill to speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Protocol, get_args

from pydantic import BeforeValidator, Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import StartUpSettings, settings_from
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import PhaseCurrent, Section, Speed, Torque, Voltage
from dqforge.machines.entries.rules import Quantity, QuantityRule, not_truth
from dqforge.machines.errors import KeyPath
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    TRACKER_NAMES,
    AlignmentName,
    NumberFormat,
    ObserverMethodName,
    StartLoadName,
    StartUpMethodName,
)

StartTime = Annotated[Quantity, QuantityRule("time", 0.0, 100.0)]


LoadTorque = Annotated[Quantity, QuantityRule("torque", 0.0, 1e7)]


HeldCurrent = Annotated[Quantity, QuantityRule("current", 0.0, 1e5, ("peak", "rms"), "peak")]


_USUAL = StartUpSettings()


_AT_REST = ("injection", "inform", "inductance-mapping")


_HARMONIC = "third-harmonic"


_PATH: KeyPath = ("control", "start_up")


class StartUpSection(Section):
    """From standstill to speed without an encoder."""

    method: StartUpMethodName = Field(
        default=_USUAL.method,
        description=(
            "i-f: a current that turns; v-f: a voltage that turns; direct: from the alignment into "
            "the observer; saliency: the rotor found by its saliency; auto: saliency where there "
            "is any (1.1 and an observer for it), else i-f"
        ),
    )
    alignment: AlignmentName | None = Field(
        default=_USUAL.alignment,
        description=(
            "none, one-step, two-step (a quarter turn away first) or voltage; default two-step for "
            "i-f and v-f, one-step for direct, none for saliency"
        ),
    )
    load: StartLoadName = Field(
        default=_USUAL.load,
        description="friction: it resists motion; active: it drives the shaft (a hoist)",
    )
    load_torque: LoadTorque | None = Field(
        default=None, description="largest load torque to start (N m); default 30 % of the largest"
    )
    brake: bool = Field(
        default=_USUAL.brake,
        description="a brake holds an active load until the current stands",
    )
    current: PhaseCurrent | None = Field(
        default=None,
        description=(
            "of the ramp (A peak); default so that 60 % of its torque are used, half the limit or "
            "more"
        ),
    )
    alignment_current: PhaseCurrent | None = Field(
        default=None, description="of the alignment (A peak); default the current limit"
    )
    alignment_time: StartTime | None = Field(
        default=None,
        description="of the alignment (s); default 0.3 s, or three swings of the rotor",
    )
    acceleration_torque: Torque | None = Field(
        default=None,
        description="accelerates the ramp (N m); default a tenth of the largest torque",
    )
    damping: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        default=None,
        description="share of the change of voltage that slows the ramp; default 0.1, or 0",
    )
    hand_over: Speed | None = Field(
        default=None,
        description=(
            "mechanical speed from which the observer rules (rad/s; write rpm); default where "
            "resistance and dead time turn its angle by 15 deg"
        ),
    )
    held_current: HeldCurrent | None = Field(
        default=None,
        description="d current held until the observer rules (A peak); default by the method",
    )
    fade_time: StartTime | None = Field(
        default=None, description="in which it goes (s); default 50 ms, direct 1 s"
    )
    patience: StartTime | None = Field(
        default=None,
        description="time beyond the planned end until a start has failed (s); default 0.8 s",
    )
    run_torque: Torque | None = Field(
        default=None,
        description=(
            "accelerates the speed reference after the start (N m); default what the load leaves"
        ),
    )
    retries: Annotated[int, BeforeValidator(not_truth)] = Field(
        default=_USUAL.retries, ge=0, le=100, description="further tries after a failed start"
    )
    retry_pause: StartTime | None = Field(
        default=None, description="without current before the next try (s); default 0.5 s"
    )
    flying_start: bool = Field(
        default=_USUAL.flying_start, description="look for a rotor that turns already"
    )
    trip_current: PhaseCurrent | None = Field(
        default=None,
        description="current that trips (A peak); default 1.8 times the limit, v-f 2.5 times",
    )
    v_dc_min: Voltage | None = Field(
        default=None, description="dc-link voltage that trips below (V); default: none"
    )


class _Control(Protocol):
    """What is asked of the section ``control``."""

    @property
    def speed_loop(self) -> Any:
        """Its speed loop."""

    @property
    def observer(self) -> Any:
        """Its observer at speed."""

    @property
    def firmware(self) -> Any:
        """The third-party firmware whose loops run the drive."""

    @property
    def start_up(self) -> Any:
        """Its start-up, a `StartUpSection` with an observer."""


def check_start_up(
    control: _Control,
    machine: Machine,
    formats: Sequence[NumberFormat],
    document: YamlDocument,
    *,
    any_back_emf: bool,
) -> None:
    """Check what a start needs of machine and controllers.

    Args:
        control: The section ``control``.
        machine: The machine.
        formats: In which the control functions are emitted.
        document: For positions.
        any_back_emf: Whether the machine is one of model: waveform.

    Raises:
        InputError: With a position.
    """
    section = control.start_up
    if section is None:
        return
    if any_back_emf:
        _check_waveform(control, document)
    if control.observer is None or control.observer.method == SPEED_OBSERVER:
        message = (
            "control.start_up needs an observer of the position at speed; write control.observer: "
            "{method: flux}"
        )
        raise document.error(message, _PATH, key=True)
    if control.observer.method in SIX_STEP_METHODS:
        message = (
            f"control.start_up: a six-step drive (control.observer: {control.observer.method}) "
            "has its own start; omit it, or write another observer"
        )
        raise document.error(message, _PATH, key=True)
    if control.observer.method in TRACKER_NAMES and not any_back_emf:
        moved = (
            f", and {control.observer.method} under control.start_up.observer"
            if control.observer.method in _AT_REST
            else ""
        )
        message = (
            "control.start_up needs an observer at speed that lives on voltage and current alone; "
            f"write control.observer: {{method: flux}}{moved}"
        )
        raise document.error(message, _PATH, key=True)
    low = control.start_up.observer
    if low is not None and low.method not in _AT_REST:
        message = (
            f"control.start_up.observer: {low.method} knows nothing at rest; write one of "
            f"{', '.join(name for name in _AT_REST if name in get_args(ObserverMethodName))}"
        )
        raise document.error(message, (*_PATH, "observer"), key=True)
    if low is not None and section.method not in ("auto", "saliency"):
        message = (
            f"control.start_up: the method '{section.method}' does not use 'observer'; remove it, "
            "or write method: saliency"
        )
        raise document.error(message, (*_PATH, "observer"), key=True)
    if control.speed_loop is None:
        message = "control.start_up needs control.speed_loop; write it, or remove start_up"
        raise document.error(message, _PATH, key=True)
    if tuple(formats) != ("float32",):
        message = (
            "control.start_up is emitted beside the control functions in float32; write "
            "export.control: float32"
        )
        raise document.error(message, _PATH, key=True)
    if control.firmware is not None:
        message = (
            "control.start_up calls the control functions of this tool, but control.firmware has "
            "its own loops; remove one of them"
        )
        raise document.error(message, _PATH, key=True)
    if machine.inertia is None:
        message = "control.start_up needs the inertia; write machine.inertia, such as 200e-6 kg m^2"
        raise document.error(message, _PATH, key=True)


def _check_waveform(control: _Control, document: YamlDocument) -> None:
    """What a start of a machine of any back-EMF needs beside what every start does.

    Raises `InputError` with a position.
    """
    section, observer = control.start_up, control.observer
    named = "nothing" if observer is None else observer.method
    if named != _HARMONIC:
        message = (
            f"control.start_up: a machine of model: waveform runs on {_HARMONIC} after its start, "
            f"not on {named}; write control.observer: {{method: {_HARMONIC}}}"
        )
        raise document.error(message, _PATH, key=True)
    if section.method not in ("auto", "i-f"):
        message = (
            f"control.start_up.method: {section.method} is no start of a machine of model: "
            f"waveform, {_HARMONIC} takes over from a current that turns; write i-f"
        )
        raise document.error(message, (*_PATH, "method"))
    if section.observer is not None:
        message = (
            "control.start_up.observer: a machine of model: waveform starts by a current that "
            "turns, without an estimator at rest; remove it"
        )
        raise document.error(message, (*_PATH, "observer"), key=True)
    if section.flying_start:
        message = (
            "control.start_up.flying_start: a rotor that turns already is caught in machines with "
            "a sinusoidal back-EMF alone; write false"
        )
        raise document.error(message, (*_PATH, "flying_start"))


def read_start_up(
    section: StartUpSection | None, reading: Reading, **given: Any
) -> StartUpSettings | None:
    """Settings in SI units, None without the section.

    Args:
        section: The section.
        reading: Where currents are read as peak values.
        given: Fields that are more than their key.
    """
    if section is None:
        return None
    for key in ("current", "alignment_current", "held_current", "trip_current"):
        quantity = getattr(section, key)
        if quantity is not None:
            given[key] = reading.peak(quantity, f"control.start_up.{key}")
    return settings_from(StartUpSettings, section, **given)
