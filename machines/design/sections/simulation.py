"""The scenario of a simulation from the section ``simulation``, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from dqforge.machines.design.design import Reading
from dqforge.machines.design.sections.simulation_schema import (
    CurrentProfileSection,
    CurrentSensorSection,
    EncoderSection,
    PhaseOpeningSection,
    PlantErrorsSection,
    SensorlessSection,
    SimulationSection,
    SpeedProfileSection,
    TorqueProfileSection,
    VoltageProfileSection,
)
from dqforge.machines.design.settings import ControlSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.rules import Quantity, si_of
from dqforge.machines.errors import InputError
from dqforge.machines.names import SPEED_OBSERVER, StartLoadName, Topology
from dqforge.machines.places import KeyPath
from dqforge.machines.plants.scenario import (
    ControlMode,
    CurrentSensor,
    Encoder,
    PhaseOpening,
    PlantErrors,
    Profile,
    Scenario,
    Sensorless,
    Shape,
)
from dqforge.machines.topologies.topology import TOPOLOGIES

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
        raise reading.document.error(
            f"{message}, such as speed: {{points: [...]}}", _PATH, key=True
        )
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
