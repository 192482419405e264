"""The section ``simulation``: what may be written, the scenario that is made of it, and what is
refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import ControlSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    Angle,
    Current,
    DeadTime,
    Listing,
    PointSpeed,
    PointTorque,
    Section,
    Voltage,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule, not_truth, si_of
from dqforge.machines.errors import InputError, KeyPath
from dqforge.machines.names import SPEED_OBSERVER, OpenPhase, StartLoadName, Topology
from dqforge.machines.plants.scenario import (
    ControlMode,
    CurrentSensor,
    Drift,
    Encoder,
    InverterModel,
    PhaseOpening,
    PlantErrors,
    Profile,
    Scenario,
    Sensorless,
    Shape,
    SpeedSource,
)
from dqforge.machines.topologies import TOPOLOGIES

MOST_SAMPLES = 10_000_000


_PATH: KeyPath = ("simulation",)


_MODES: tuple[ControlMode, ...] = ("speed", "torque", "current")


_BAND = 0.8  # speed at which the encoder takes over again, of that at which it is left


def _profile(
    section: SpeedProfileSection | TorqueProfileSection | VoltageProfileSection,
    value: str,
    name: str,
    reading: Reading,
    rest: float = 0.0,
) -> Profile:
    """A profile; ``value`` is the key of a point's value, ``rest`` what holds without points."""
    path: KeyPath = (*_PATH, name)
    if (section.amplitude is None) != (section.frequency is None):
        message = f"simulation.{name}: amplitude and frequency belong together; write both, or none"
        raise reading.document.error(message, path, key=True)
    points: Sequence[Any] = section.points or ()
    times = [point.time for point in points]
    values = tuple(getattr(point, value).si for point in points) or (rest,)
    if points and times[0].si > 0.0 and values[0] != 0.0:
        reading.remarks.append(
            f"simulation.{name} is {getattr(points[0], value).text} from the start on, since its "
            f"first point holds before {times[0].text} too; begin with {{time: 0 s, ...}} for "
            "another value until then"
        )
    return _points(
        times, values, section.shape, path, reading, (section.amplitude, section.frequency)
    )


def _points(
    times: Sequence[Quantity],
    values: tuple[float, ...],
    shape: Shape,
    path: KeyPath,
    reading: Reading,
    sine: tuple[Quantity | None, Quantity | None] = (None, None),
) -> Profile:
    for k in range(1, len(times)):
        if times[k].si <= times[k - 1].si:
            message = (
                f"{path[0]}.{path[1]}: time {times[k].text} does not lie after "
                f"{times[k - 1].text}; sort the points"
            )
            raise reading.document.error(message, (*path, "points", k, "time"))
    instants = tuple(time.si for time in times) or (0.0,)
    return Profile(instants, values, shape, si_of(sine[0]) or 0.0, si_of(sine[1]) or 0.0)


def _references(
    section: SimulationSection, reading: Reading
) -> tuple[ControlMode, Profile, Profile]:
    """Mode and references; exactly one kind may be given."""
    given = [mode for mode in _MODES if getattr(section, mode) is not None]
    if len(given) != 1:
        found = f"{' and '.join(given)} are given" if given else "none is given"
        message = (
            f"simulation needs one of speed, torque and current as its reference, {found}; write "
            "one"
        )
        raise reading.document.error(f"{message}, such as speed: 1000 rpm", _PATH, key=True)
    if section.speed is not None:
        return "speed", _profile(section.speed, "speed", "speed", reading), Profile()
    if section.torque is not None:
        return "torque", _profile(section.torque, "torque", "torque", reading), Profile()
    current = section.current
    assert isinstance(current, CurrentProfileSection)
    times = [point.time for point in current.points]
    pair = [
        _points(
            times,
            tuple(getattr(point, axis).si for point in current.points),
            current.shape,
            (*_PATH, "current"),
            reading,
        )
        for axis in ("i_q", "i_d")
    ]
    return "current", pair[0], pair[1]


def _sensor(section: CurrentSensorSection, reading: Reading) -> CurrentSensor:
    if section.bits > 0 and section.full_scale is None:
        message = "simulation.current_sensor: bits need full_scale; write full_scale: 20 A"
        raise reading.document.error(message, (*_PATH, "current_sensor", "bits"))
    offset = tuple(entry.si for entry in section.offset or ())
    gain = tuple(entry.si for entry in section.gain_error or ())
    none = (0.0, 0.0, 0.0)
    return CurrentSensor(
        bits=section.bits,
        full_scale=si_of(section.full_scale) or 1.0,
        noise=si_of(section.noise) or 0.0,
        offset=(offset[0], offset[1], offset[2]) if offset else none,
        gain_error=(gain[0], gain[1], gain[2]) if gain else none,
    )


def _sensorless(
    section: SensorlessSection | None, control: ControlSettings, reading: Reading
) -> Sensorless | None:
    """Speeds of the handover.

    Raises `InputError` with a position where there is no observer or no band.
    """
    if section is None:
        return None
    path: KeyPath = (*_PATH, "sensorless")
    if control.observer is None or control.observer.method == SPEED_OBSERVER:
        message = (
            "simulation.sensorless needs an observer of the position; write control.observer: "
            "{method: flux}"
        )
        raise reading.document.error(message, path, key=True)
    for name, speed in (("above", section.above), ("below", section.below)):
        if speed is not None and speed.si < 0.0:
            message = (
                f"simulation.sensorless.{name}: {speed.text} is negative; write the magnitude, for "
                "both directions"
            )
            raise reading.document.error(message, (*path, name))
    if section.below is not None and section.below.si > section.above.si:
        message = (
            f"simulation.sensorless.below: {section.below.text} exceeds above = "
            f"{section.above.text}; write less"
        )
        raise reading.document.error(message, (*path, "below"))
    below = _BAND * section.above.si if section.below is None else section.below.si
    return Sensorless(section.above.si, below)


def _errors(section: PlantErrorsSection) -> PlantErrors:
    entries = (
        section.resistance,
        section.inductance_d,
        section.inductance_q,
        section.magnet_flux,
        section.inertia,
        section.v_dc,
    )
    return PlantErrors(*(si_of(entry) or 0.0 for entry in entries))


def _drift(section: DriftSection | None, waveform: bool, reading: Reading) -> Drift | None:
    """The change of the plant, None for none.

    Raises `InputError` with a position.
    """
    if section is None:
        return None
    path: KeyPath = (*_PATH, "drift")
    begin = si_of(section.begin) or 0.0
    if begin >= section.end.si:
        message = f"simulation.drift: it ends at {section.end.text}; write an end behind its begin"
        raise reading.document.error(message, (*path, "end"))
    if waveform:
        message = "simulation.drift is not there for machines of model: waveform; remove it"
        raise reading.document.error(message, path, key=True)
    changes = (si_of(section.resistance) or 0.0, si_of(section.magnet_flux) or 0.0)
    return Drift(begin, section.end.si, *changes)


def _load_kind(section: SimulationSection, control: ControlSettings) -> StartLoadName:
    """That of the start where there is no encoder; a torque that always acts where there is."""
    start = control.start_up if section.encoder.absent else None
    return "active" if start is None else start.load


def _opening(
    section: PhaseOpeningSection | None, waveform: bool, topology: Topology, reading: Reading
) -> PhaseOpening | None:
    """The phase that opens, None for none; ``waveform`` says whether there are phases.

    Raises `InputError` with a position where no plant or no controller knows of it.
    """
    if section is None:
        return None
    path: KeyPath = (*_PATH, "open_phase")
    if not waveform:
        message = (
            "simulation.open_phase: a phase opens in machines of model: waveform; write that "
            "model, or remove the key"
        )
        raise reading.document.error(message, path, key=True)
    if section.detected_after is not None and not TOPOLOGIES[topology].neutral:
        message = (
            f"simulation.open_phase.detected_after: two phases of {topology} make no constant "
            "torque, so that its controller has no answer; remove the key"
        )
        raise reading.document.error(message, (*path, "detected_after"))
    return PhaseOpening(section.phase, section.time.si, si_of(section.detected_after))


def read_scenario(
    section: SimulationSection | None,
    machine: Machine,
    inverter: Inverter,
    control: ControlSettings,
    reading: Reading,
    *,
    waveform: bool = False,
    program: bool = False,
) -> Scenario | None:
    """Simulation of the design, None where the file asks for none.

    ``waveform`` says whether the machine is one in phase quantities, ``program`` whether the
    program around the functions is emitted.

    Raises:
        InputError: No or several references, a profile that is none, or something that the design
            lacks for it; with a position.
    """
    if section is None:
        return None
    mode, reference, reference_d = _references(section, reading)
    _check(section, mode, (machine, inverter, control), reading, program=program)
    link = section.v_dc
    return Scenario(
        duration=section.duration.si,
        mode=mode,
        reference=reference,
        reference_d=reference_d,
        load=_profile(section.load, "torque", "load", reading),
        shaft=None if section.shaft is None else _profile(section.shaft, "speed", "shaft", reading),
        v_dc=None if link is None else _profile(link, "voltage", "v_dc", reading, inverter.v_dc),
        inverter=section.inverter,
        dead_time=si_of(section.dead_time),
        encoder=_encoder(section.encoder, control, reading),
        sensor=_sensor(section.current_sensor, reading),
        errors=_errors(section.errors),
        omega_m=si_of(section.initial.speed) or 0.0,
        theta_e=si_of(section.initial.angle) or 0.0,
        seed=section.seed,
        sub_steps=section.steps,
        sensorless=_sensorless(section.sensorless, control, reading),
        open_phase=_opening(section.open_phase, waveform, inverter.topology, reading),
        load_kind=section.load.kind or _load_kind(section, control),
        stop=si_of(section.stop),
        drift=_drift(section.drift, waveform, reading),
    )


def _encoder(section: EncoderSection, control: ControlSettings, reading: Reading) -> Encoder:
    """The encoder, with the lines and the measurement of the speed that the controller has.

    Raises `InputError` with a position.
    """
    measurement = None if control.speed_loop is None else control.speed_loop.measurement
    misalignment = si_of(section.misalignment) or 0.0
    given, path = section.model_fields_set, (*_PATH, "encoder")
    where = "control.speed_loop.measurement"
    if measurement is None:
        if section.speed == "measured":
            raise reading.document.error(
                f"simulation.encoder.speed: measured needs {where}; write its method, lines and "
                "clock, or speed: difference",
                (*path, "speed"),
            )
        return Encoder(section.lines, section.speed, misalignment, absent=section.absent)
    if "speed" in given and section.speed != "measured":
        return Encoder(section.lines, section.speed, misalignment, absent=section.absent)
    if "lines" in given and section.lines != measurement.lines:
        raise reading.document.error(
            f"simulation.encoder.lines {section.lines} contradicts {where}.lines "
            f"{measurement.lines}; write one number",
            (*path, "lines"),
        )
    return Encoder(
        measurement.lines, "measured", misalignment, measurement.edges, measurement.clock
    )


def _check_start(
    section: SimulationSection, mode: ControlMode, control: ControlSettings, reading: Reading
) -> None:
    """What a drive without encoder needs.

    Raises `InputError` with a position.
    """
    path: KeyPath = (*_PATH, "encoder")
    if control.start_up is None:
        message = (
            "simulation.encoder: a drive without encoder starts by control.start_up; write it, or "
            "give it an encoder"
        )
        raise reading.document.error(message, path, key=True)
    if mode != "speed":
        message = (
            "simulation.encoder: a drive without encoder follows a speed; write simulation.speed, "
            "or give it an encoder"
        )
        raise reading.document.error(message, path, key=True)
    if section.sensorless is not None:
        message = (
            "simulation.sensorless: without encoder control.start_up says where the observer takes "
            "over; remove it"
        )
        raise reading.document.error(message, (*_PATH, "sensorless"), key=True)


def _check(
    section: SimulationSection,
    mode: ControlMode,
    drive: tuple[Machine, Inverter, ControlSettings],
    reading: Reading,
    *,
    program: bool,
) -> None:
    """What the rest of the design must have for the simulation.

    Raises `InputError` with a position.
    """
    machine, inverter, control = drive

    def fault(message: str, *key: str) -> InputError:
        return reading.document.error(
            f"simulation{''.join(f'.{part}' for part in key)}: {message}", (*_PATH, *key)
        )

    if mode == "speed" and control.speed_loop is None:
        raise fault(
            "a speed reference needs control.speed_loop; write it, or give a torque", "speed"
        )
    if section.encoder.absent:
        _check_start(section, mode, control, reading)
    elif section.stop is not None and not (program and mode == "speed"):
        message = "it is for a drive without encoder, or with export.application; remove it"
        raise fault(message, "stop")
    if section.shaft is None and machine.inertia is None:
        message = "simulation: a free shaft needs machine.inertia; write it, or simulation.shaft"
        raise reading.document.error(message, _PATH, key=True)
    if section.encoder.speed == "observer" and control.observer is None:
        raise fault(
            "observer needs control.observer; write its pole, or speed: difference",
            "encoder",
            "speed",
        )
    if section.duration.si / control.t_s > MOST_SAMPLES:
        longest = MOST_SAMPLES * control.t_s
        raise fault(
            f"{section.duration.text} has more than {MOST_SAMPLES} samples; write {longest:g} s",
            "duration",
        )
    halves = 2.0 * inverter.f_sw * control.t_s
    if section.inverter == "switched" and (round(halves) < 1 or abs(halves - round(halves)) > 1e-6):
        message = (
            "switched needs a sampling frequency of one or two times the switching frequency, or a "
            "whole part of it"
        )
        raise fault(f"{message}; change one of them, or write averaged", "inverter")


# The section ``simulation`` of a design file: what the drive goes through in the time domain.

Instant = Annotated[Quantity, QuantityRule("time", 0.0, 1e4)]


Duration = Annotated[Quantity, QuantityRule("time", 1e-6, 1e4)]


SignedCurrent = Annotated[Quantity, QuantityRule("current", -1e5, 1e5)]


RippleVoltage = Annotated[Quantity, QuantityRule("voltage", 0.0, 2e4)]


ProfileFrequency = Annotated[Quantity, QuantityRule("frequency", 1e-3, 1e5)]


NoiseCurrent = Annotated[Quantity, QuantityRule("current", 0.0, 1e5)]


RelativeError = Annotated[Quantity, QuantityRule("number", -0.9, 10.0)]


SmallError = Annotated[Quantity, QuantityRule("number", -0.5, 0.5)]


Whole = Annotated[int, BeforeValidator(not_truth)]


_POINTS = (
    "a list of {time: ..., value: ...}, times ascending; before the first and behind the last its "
    "value holds"
)


_MOST = 100_000
_ALONE = "as a profile or as one value that stays"


_ENCODER, _SENSOR = Encoder(), CurrentSensor()


class SpeedPointSection(Section):
    """Speed at a time."""

    time: Instant = Field(description="time (s)")
    speed: PointSpeed = Field(description="mechanical speed (rad/s; write rpm)")


class TorquePointSection(Section):
    """Torque at a time."""

    time: Instant = Field(description="time (s)")
    torque: PointTorque = Field(description="torque (N m)")


class CurrentPointSection(Section):
    """Currents at a time."""

    time: Instant = Field(description="time (s)")
    i_d: SignedCurrent = Field(description="d current (A, peak)")
    i_q: SignedCurrent = Field(description="q current (A, peak)")


class VoltagePointSection(Section):
    """DC-link voltage at a time."""

    time: Instant = Field(description="time (s)")
    voltage: Voltage = Field(description="DC-link voltage (V)")


class SpeedProfileSection(Section):
    """Speed over time."""

    points: Annotated[Listing[SpeedPointSection], Field(min_length=1, max_length=_MOST)] | None = (
        Field(default=None, description=_POINTS.replace("value", "speed") + "; default: rest")
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: PointSpeed | None = Field(
        default=None, description="of a sine on top (rad/s; write rpm)"
    )
    frequency: ProfileFrequency | None = Field(default=None, description="of that sine (Hz)")


class TorqueProfileSection(Section):
    """Torque over time."""

    points: Annotated[Listing[TorquePointSection], Field(min_length=1, max_length=_MOST)] | None = (
        Field(default=None, description=_POINTS.replace("value", "torque") + "; default: none")
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: PointTorque | None = Field(default=None, description="of a sine on top (N m)")
    frequency: ProfileFrequency | None = Field(default=None, description="of that sine (Hz)")


def _constant(key: str) -> BeforeValidator:
    """A validator that takes a value alone for a profile that keeps it: `speed: 750 rpm`."""

    def profile(value: object) -> object:
        plain = isinstance(value, str | float | int) and not isinstance(value, bool)
        return {"points": [{"time": "0 s", key: value}]} if plain else value

    return BeforeValidator(profile)


class LoadSection(TorqueProfileSection):
    """Load torque over time."""

    kind: StartLoadName | None = Field(
        default=None,
        description=(
            "active: it acts at rest too; friction: it resists motion either way and holds the "
            "shaft; default active, without encoder that of control.start_up"
        ),
    )


class CurrentProfileSection(Section):
    """Currents over time."""

    points: Annotated[Listing[CurrentPointSection], Field(min_length=1, max_length=_MOST)] = Field(
        description="a list of {time: ..., i_d: ..., i_q: ...}, times ascending"
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )


class VoltageProfileSection(Section):
    """DC-link voltage over time."""

    points: (
        Annotated[Listing[VoltagePointSection], Field(min_length=1, max_length=_MOST)] | None
    ) = Field(
        default=None, description=_POINTS.replace("value", "voltage") + "; default: inverter.v_dc"
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: RippleVoltage | None = Field(
        default=None, description="of a sinusoidal ripple on top (V, peak)"
    )
    frequency: ProfileFrequency | None = Field(default=None, description="of that ripple (Hz)")


class EncoderSection(Section):
    """Position sensor."""

    lines: Whole = Field(
        default=_ENCODER.lines,
        ge=0,
        le=10_000_000,
        description="per revolution, four counts each; 0: exact",
    )
    speed: SpeedSource = Field(
        default=_ENCODER.speed,
        description=(
            "difference of the counts over a speed period, exact, that of control.observer, or "
            "measured by control.speed_loop.measurement, the default where that is there"
        ),
    )
    misalignment: Angle | None = Field(
        default=None, description="added to the electrical angle (rad; write deg)"
    )
    absent: bool = Field(
        default=_ENCODER.absent,
        description="there is none, control.start_up starts the drive; encoder: none for short",
    )


def _no_encoder(value: object) -> object:
    """The word none as what it stands for."""
    return {"absent": True} if value == "none" else value


class SensorlessSection(Section):
    """Control with angle and speed of the position observer (control.observer)."""

    above: PointSpeed = Field(
        description="from this speed on, mechanical, in either direction (rad/s; write rpm)"
    )
    below: PointSpeed | None = Field(
        default=None,
        description=(
            "under it the encoder takes over again (rad/s; write rpm); default 80 % of above"
        ),
    )


class CurrentSensorSection(Section):
    """Sensors and converters of the phase currents."""

    bits: Whole = Field(default=_SENSOR.bits, ge=0, le=24, description="of the converter; 0: exact")
    full_scale: Current | None = Field(
        default=None, description="the converter spans minus to plus this current (A)"
    )
    noise: NoiseCurrent | None = Field(
        default=None, description="standard deviation of normal noise (A)"
    )
    offset: Annotated[Listing[SignedCurrent], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="of the phases a, b and c, such as [10 mA, 0 A, -20 mA]"
    )
    gain_error: Annotated[Listing[SmallError], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="of the phases a, b and c, such as [1 %, 0, -1 %]"
    )


class PlantErrorsSection(Section):
    """How the simulated drive differs from the data that its controller was made for (write
    20 %).
    """

    resistance: RelativeError | None = Field(default=None, description="relative; default 0")
    inductance_d: RelativeError | None = Field(default=None, description="relative; default 0")
    inductance_q: RelativeError | None = Field(default=None, description="relative; default 0")
    magnet_flux: RelativeError | None = Field(default=None, description="relative; default 0")
    inertia: RelativeError | None = Field(default=None, description="relative; default 0")
    v_dc: RelativeError | None = Field(default=None, description="relative; default 0")


class DriftSection(Section):
    """How the simulated machine changes while it runs, by lines: a winding that warms up, magnets
    that cool down.
    """

    begin: Instant | None = Field(default=None, description="of the change (s); default 0")
    end: Instant = Field(description="of the change (s); from there on it is whole")
    resistance: RelativeError | None = Field(
        default=None, description="relative to the data, beside errors; default 0"
    )
    magnet_flux: RelativeError | None = Field(
        default=None, description="relative to the data, beside errors; default 0"
    )


class PhaseOpeningSection(Section):
    """A phase that opens while the drive runs."""

    phase: OpenPhase = Field(description="a, b or c")
    time: Instant = Field(
        description="from which its switches stay off (s); open for good once its current is zero"
    )
    detected_after: Instant | None = Field(
        default=None,
        description="delay until the controller is notified (s); default: never",
    )


class InitialSection(Section):
    """State at the start."""

    speed: PointSpeed | None = Field(
        default=None, description="mechanical speed (rad/s; write rpm); default 0"
    )
    angle: Angle | None = Field(
        default=None, description="electrical angle (rad; write deg); default 0"
    )


class SimulationSection(Section):
    """A simulation in the time domain with the emitted controller, whose reference is a
    speed, a torque or currents.
    """

    duration: Duration = Field(description="simulated time (s)")
    speed: Annotated[SpeedProfileSection | None, _constant("speed")] = Field(
        default=None, description=f"reference of the speed controller, {_ALONE}"
    )
    torque: Annotated[TorqueProfileSection | None, _constant("torque")] = Field(
        default=None, description=f"torque reference, {_ALONE}"
    )
    current: CurrentProfileSection | None = Field(default=None, description="current references")
    load: Annotated[LoadSection, _constant("torque")] = Field(
        default_factory=LoadSection,
        description=f"load torque, against positive speed, {_ALONE}",
    )
    shaft: Annotated[SpeedProfileSection | None, _constant("speed")] = Field(
        default=None,
        description=f"speed that a load machine imposes, {_ALONE}; default: the shaft is free",
    )
    v_dc: Annotated[VoltageProfileSection | None, _constant("voltage")] = Field(
        default=None, description=f"DC-link voltage, {_ALONE}; default inverter.v_dc"
    )
    inverter: InverterModel = Field(
        default="averaged",
        description="averaged: duty cycles as voltages; switched: every switching instant",
    )
    dead_time: DeadTime | None = Field(
        default=None, description="dead time (s); default inverter.dead_time"
    )
    encoder: Annotated[EncoderSection, BeforeValidator(_no_encoder)] = Field(
        default_factory=EncoderSection, description="position sensor, or none"
    )
    sensorless: SensorlessSection | None = Field(
        default=None,
        description=(
            "angle and speed from the position observer at speed; default: from the encoder"
        ),
    )
    current_sensor: CurrentSensorSection = Field(
        default_factory=CurrentSensorSection, description="current sensors"
    )
    errors: PlantErrorsSection = Field(
        default_factory=PlantErrorsSection, description="differences from the data"
    )
    drift: DriftSection | None = Field(
        default=None, description="how resistance and magnets change over the run; default: not"
    )
    initial: InitialSection = Field(
        default_factory=InitialSection, description="state at the start"
    )
    open_phase: PhaseOpeningSection | None = Field(
        default=None, description="a phase that opens (machines of model: waveform); default: none"
    )
    stop: Instant | None = Field(
        default=None, description="the command of a drive without encoder goes (s); default: never"
    )
    seed: Whole = Field(default=1, ge=0, le=2**31, description="of the noise")
    steps: Annotated[int, Field(ge=1, le=1000), BeforeValidator(not_truth)] | None = Field(
        default=None,
        description="integration steps per control period; default: as many as the accuracy needs",
    )
