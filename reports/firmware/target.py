"""One record per firmware whose files are written and read."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError, shown
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.names import Firmware, LoadedByName
from dqforge.machines.plants.scenario import ControlMode, Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.firmware.loop_code import (
    PREFIX,
    loop_bytes,
    loop_files,
    sampling_period,
    speed_ratio,
)
from dqforge.reports.simulation.plant_input import LONGEST_DELAY, Drive
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulator

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.optimizer.firmware.configuration import (
        Configuration,
        DriveValues,
        LoopProfile,
        OwnValue,
        PiController,
    )
    from dqforge.optimizer.firmware.firmware_method import FirmwareMethod
    from dqforge.reports.simulation.recorded_run import Simulation


@dataclass(frozen=True, slots=True)
class FileTitle:
    """What stands at the head of a file where its format permits: prefix of names, name of the
    design, digest of the design file, version of dqforge, and remarks (one line each).
    """

    prefix: str
    name: str
    digest: str
    version: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Target:
    """One firmware: how its files are written, recognised and read.

    Args:
        method: Its gains and its loops.
        title: Its name as people write it, with the versions that the format is that of.
        write: Files by name from a configuration; the text of an existing file, where one is given,
            is kept but for the values that the configuration decides.
        recognise: Whether a file, by its name and its text, is one of this firmware.
        read: The configuration in a text; the place (a path) is for messages. Raises InputError
            with place and line where it is not what the firmware writes.
        read_several: The configuration that several files state together, from text and place of
            each; None where each file is understood by itself.
        of_project: Own names of what a board or a project decides (scales of its sensing,
            thresholds of its faults): an existing file keeps them, whatever a new one would say.
        one_meaning: Whether an own name stands for the same number in files of every version.
    """

    method: FirmwareMethod
    title: str
    write: Callable[[Configuration, FileTitle, str | None], dict[str, bytes]]
    recognise: Callable[[str, str], bool]
    read: Callable[[str, str], Configuration]
    read_several: Callable[[Sequence[tuple[str, str]]], Configuration] | None = None
    of_project: frozenset[str] = frozenset()
    one_meaning: bool = False


# The steps by which the loops of a firmware are tried: of current, torque and speed, at rest and
# at half of the base speed.

# Of the current limit: step of the current, and (times its torque) of the torque.
CURRENT_SHARE = 0.5

# Of the base speed: steps of the speed, which leave the current limit alone and which do not.
SMALL_SHARE, LARGE_SHARE = 0.05, 0.8
_CONSTANTS = 12.0  # slowest time constants that a step is given
_LONGEST = 20.0
_MOST_SAMPLES = 400_000


@dataclass(frozen=True, slots=True)
class StandardStep:
    """One step: what it is called, from which to which reference, when, and its scenario."""

    name: str
    before: float
    after: float
    time: float
    scenario: Scenario


def standard_steps(
    profile: LoopProfile, values: DriveValues, machine: Machine, i_max: float, v_dc: float
) -> tuple[tuple[StandardStep, ...], tuple[str, ...]]:
    """The steps that a configuration is put through, and sentences on those left out.

    Args:
        profile: The loops.
        values: What the firmware is told.
        machine: The machine that is there.
        i_max: Current limit in A (peak of phase).
        v_dc: Voltage of the dc link in V.
    """
    base = base_speed(profile, machine, i_max, v_dc)
    left_out: list[str] = []
    speeds = (0.0, 0.5 * base) if base > 0.0 else (0.0,)
    steps = [_driven(profile, machine, "current", CURRENT_SHARE * i_max, speed) for speed in speeds]
    constant = torque_per_ampere(values.pole_pairs or 0, values.psi_pm or 0.0)
    if constant > 0.0:
        torque = CURRENT_SHARE * i_max * constant
        steps += [_driven(profile, machine, "torque", torque, speed) for speed in speeds]
    else:
        left_out.append(
            "no step of the torque: the firmware has no setting for the magnet flux linkage"
        )
    if profile.speed is None:
        left_out.append("no step of the speed: the configuration has no speed controller")
    elif machine.inertia is None:
        left_out.append("no step of the speed: the design has no machine.inertia")
    elif base <= 0.0:
        left_out.append("no step of the speed: the voltage does not reach beyond standstill")
    else:
        steps += [
            _free(profile, machine, i_max, name, before, before + share * base)
            for name, before, share in (
                ("small speed step at rest", 0.0, SMALL_SHARE),
                ("large speed step at rest", 0.0, LARGE_SHARE),
                ("small speed step at half of the base speed", 0.5 * base, SMALL_SHARE),
            )
        ]
    return tuple(steps), tuple(left_out)


def base_speed(profile: LoopProfile, machine: Machine, i_q: float, v_dc: float) -> float:
    """Mechanical speed in rad/s at which a q current alone takes the whole voltage, at most the
    machine's largest; 0 where it does so at rest.

    Args:
        profile: Whose share of the voltage holds.
        machine: The machine.
        i_q: Current in A (peak of phase).
        v_dc: Voltage of the dc link in V.
    """
    v_max = profile.current.voltage_share * linear_voltage(v_dc)
    flux_d, flux_q = machine.flux(np.array([0.0]), np.array([i_q]))
    psi_d, psi_q, drop = float(flux_d[0]), float(flux_q[0]), machine.r_s * i_q
    square, middle = psi_d**2 + psi_q**2, drop * psi_d
    if square <= 0.0 or drop >= v_max:
        return 0.0
    omega_e = (-middle + math.sqrt(middle**2 + square * (v_max**2 - drop**2))) / square
    return min(omega_e / machine.pole_pairs, machine.omega_m_max or math.inf)


def _slow_current(profile: LoopProfile, machine: Machine) -> float:
    """Slowest time constant of the current loops in s."""
    found = []
    for pi, inductance in ((profile.current.d, machine.l_d), (profile.current.q, machine.l_q)):
        if pi.ki > 0.0:
            found.append((machine.r_s + pi.kp) / pi.ki)
        found += [inductance / (machine.r_s + abs(pi.kp)), pi.filter_time, 10.0 * pi.t_s]
    return max(found)


def _slow_estimate(profile: LoopProfile) -> float:
    """Slowest time constant of the speed that the firmware makes, in s."""
    if profile.speed is None:
        return 0.0
    speed = profile.speed.feedback
    if speed.kind == "pll" and speed.ki > 0.0:
        return max(speed.kp / speed.ki, 2.0 / max(speed.kp, 1e-12))
    return {"low-pass": speed.filter_time, "difference": speed.samples * speed.t_s}.get(
        speed.kind, 0.0
    )


def _slow_speed(profile: LoopProfile, pi: PiController, machine: Machine) -> float:
    """Slowest time constant of the speed loop in s."""
    rate = pi.kp * machine.torque_per_ampere / max(machine.inertia or 0.0, 1e-12)
    found = [_slow_current(profile, machine), _slow_estimate(profile), pi.filter_time, 5.0 * pi.t_s]
    if rate > 0.0:
        found.append(2.0 / rate)
    if pi.ki > 0.0:
        found.append(pi.kp / pi.ki)
    return max(found)


def _bounded(duration: float, t_s: float) -> float:
    return min(max(duration, 40.0 * t_s), 0.5 * _LONGEST, 0.5 * _MOST_SAMPLES * t_s)


def _driven(
    profile: LoopProfile, machine: Machine, mode: ControlMode, after: float, speed: float
) -> StandardStep:
    """A step of current or torque while a load machine holds the speed, which it has come to."""
    t_s = profile.current.d.t_s
    length = _bounded(_CONSTANTS * _slow_current(profile, machine), t_s)
    follows = profile.current.cross or profile.current.back_emf or profile.current.angle_advance
    wait = _bounded(length + (_CONSTANTS * _slow_estimate(profile) if follows else 0.0), t_s)
    shaft = Profile((0.0, 0.25 * wait), (0.0, speed), "linear")
    scenario = Scenario(
        wait + length,
        mode,
        Profile((0.0, wait), (0.0, after)),
        shaft=shaft,
        dead_time=0.0,
    )
    return StandardStep(_named(mode, speed), 0.0, after, wait, scenario)


def _free(
    profile: LoopProfile,
    machine: Machine,
    i_max: float,
    name: str,
    before: float,
    after: float,
) -> StandardStep:
    """A step of the speed of a free shaft without load."""
    assert profile.speed is not None
    pi, ramp = profile.speed.pi, profile.speed.ramp
    t_s = profile.current.d.t_s
    torque = max(machine.torque_per_ampere * i_max, 1e-12)
    moving = 3.0 * (machine.inertia or 0.0) * (after - before) / torque
    moving += (after - before) / ramp if ramp else 0.0
    settling = _CONSTANTS * _slow_speed(profile, pi, machine)
    length = _bounded(settling + moving, t_s)
    wait = _bounded(settling, t_s) if before else 0.0
    scenario = Scenario(
        wait + length,
        "speed",
        Profile((0.0, wait), (before, after)) if wait else Profile((0.0,), (after,)),
        dead_time=0.0,
        omega_m=before,
    )
    return StandardStep(name, before, after, wait, scenario)


def _named(mode: ControlMode, speed: float) -> str:
    return f"{mode} step {'at half of the base speed' if speed else 'at rest'}"


# Whether the loops of a firmware settle on a machine, tried in the time domain.

_MOST_ROWS = 40_000


_UNITS = {"current": "A", "torque": "N m", "speed": "rad/s"}


@dataclass(frozen=True, slots=True)
class TriedStep:
    """One step and what became of it; ``quantity`` is what answered, ``unit`` its unit."""

    name: str
    quantity: str
    unit: str
    before: float
    after: float
    answer: StepAnswer

    @property
    def settles(self) -> bool:
        """Whether it does."""
        return self.answer.outcome == "settles"

    @property
    def words(self) -> str:
        """What happened, in one clause with its numbers."""
        step = f"{self.name} from {self._text(self.before)} to {self._text(self.after)}"
        found = self.answer
        if found.outcome == "settles":
            return f"{step}: settles within {format_quantity(found.settling, 's', 3)}"
        ends = f"{self._text(found.lowest)} and {self._text(found.highest)}"
        text = {
            "limit cycle": f"limit cycle of {self.quantity} between {ends}, every "
            f"{format_quantity(found.period, 's', 3)}",
            "divergence": f"{self.quantity} leaves all bounds",
            "steady error": f"{self.quantity} stays at {self._text(found.mean)}",
            "never reaches": f"{self.quantity} still moves between {ends} at the end",
        }[found.outcome]
        return f"{step}: {text}"

    def _text(self, value: float) -> str:
        return f"{value:.4g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the standard steps showed of one configuration.

    ``tried`` are the steps, ``left_out`` sentences on those that could not be tried.
    """

    firmware: Firmware
    tried: tuple[TriedStep, ...]
    left_out: tuple[str, ...] = ()

    @property
    def settles(self) -> bool:
        """Whether every step does."""
        return all(step.settles for step in self.tried)

    @property
    def failures(self) -> tuple[str, ...]:
        """What did not settle, a clause each."""
        return tuple(step.words for step in self.tried if not step.settles)

    @property
    def reason(self) -> str:
        """Why the configuration does not settle, empty where it does."""
        return "; ".join(self.failures[:2])


def settles(
    profile: LoopProfile,
    design: Design,
    values: DriveValues,
    *,
    program: Simulator | None = None,
) -> Verdict:
    """Put the loops of a firmware through the standard steps on a design's machine.

    Steps of half of the current limit, at rest and at half of the base speed, and of its torque;
    small and large steps of the speed. The inverter is averaged and without dead time, sensors are
    exact, the shaft carries no load.

    Args:
        profile: The loops of a configuration.
        design: Machine and inverter that they drive.
        values: What the firmware is told, such as `Configuration.drive`.
        program: That of `firmware_simulator`, where it is there already.

    Raises:
        InputError: As `dqforge.reports.firmware.target.simulate_profile`.
        VerificationError: There is no C compiler.
    """
    i_max = min(design.i_max, values.i_max or design.i_max)
    told = replace(values, i_max=i_max, pole_pairs=values.pole_pairs or design.machine.pole_pairs)
    steps, left_out = standard_steps(profile, told, design.machine, i_max, design.inverter.v_dc)
    drive = firmware_drive(profile, design)
    tried: list[TriedStep] = []
    opened = firmware_simulator(profile, told) if program is None else nullcontext(program)
    with opened as made:
        for step in steps:
            stride = 1 + int(step.scenario.duration / drive.t_s) // _MOST_ROWS
            run = simulate_profile(profile, told, drive, step.scenario, stride=stride, program=made)
            tried.append(_tried(step, run, design.machine))
    return Verdict(profile.firmware, tuple(tried), left_out)


def _tried(step: StandardStep, run: Simulation, machine: Machine) -> TriedStep:
    """The worst answer of a step."""
    after = np.flatnonzero(run.t >= step.time - 1e-12)
    answers = [
        TriedStep(
            step.name,
            quantity,
            _UNITS[step.scenario.mode],
            step.before,
            step.after,
            step_answer(
                run.t[after],
                value[after],
                before,
                wanted,
                span=span,
                bounded=bool(run.figures.bounded[0]),
            ),
        )
        for quantity, value, before, wanted, span in _answers(step, run, machine)
    ]
    return next((answer for answer in answers if not answer.settles), answers[0])


def _answers(
    step: StandardStep, run: Simulation, machine: Machine
) -> Sequence[tuple[str, FloatArray, float, float, float]]:
    """What is to follow: its name, its values, its references before and after, and the span."""
    span = abs(step.after - step.before)
    if step.scenario.mode == "speed":
        return [("the speed", run.omega_m, step.before, step.after, span)]
    if step.scenario.mode == "current":
        return [
            ("i_q", run.i_q, step.before, step.after, span),
            ("i_d", run.i_d, 0.0, 0.0, span),
        ]
    # The firmware's constant makes currents of the torque: what those make is to be reached.
    torque = float(machine.torque(run.i_d_reference[-1:], run.i_q_reference[-1:])[0])
    return [("the torque", run.torque, 0.0, torque, abs(torque))]


# Configuration files of others as text: bounded, decoded, and encoded again as they were.

# Size of the largest file that is read; a larger one is refused by its size. The largest real ones,
# projects of a vendor's tool, have less than 1 MB.
MOST_BYTES = 8_000_000
_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_LONGEST_NUMBER = 60
_LEAST, _MOST = 1e-30, 1e30

# What to write for a number that `in_range` refuses.
IN_RANGE = f"write one from {_LEAST:g} to {_MOST:g}"


@dataclass(frozen=True, slots=True)
class TextFile:
    """A text of others.

    Args:
        source: File name as the user gave it.
        text: Its text with line feeds at the ends of lines, without byte order mark.
        encoding: Name of the encoding with which `encoded` gives it back.
        crlf: Whether its lines end in carriage return and line feed.
    """

    source: str
    text: str
    encoding: str = "utf-8"
    crlf: bool = False

    def encoded(self, text: str) -> bytes:
        """Another text in encoding and line ends of this one."""
        whole = text.replace("\n", "\r\n") if self.crlf else text
        try:
            return whole.encode(self.encoding)
        except UnicodeEncodeError:
            return whole.encode("utf-8")


def read_text_file(place: str | Path) -> TextFile:
    """Text of a regular file of at most `MOST_BYTES`.

    Raises:
        InputError: There is no such file, it is too large, or no text.
    """
    return decoded_file(read_regular_file(place, MOST_BYTES), str(place))


def decoded_file(content: bytes, source: str) -> TextFile:
    """Text in UTF-8, UTF-16 with its mark, or latin-1.

    Raises:
        InputError: It is binary, damaged or empty; with the line.
    """
    encoding = _encoding(content)
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        if encoding == "utf-16":
            raise InputError(
                "the UTF-16 text is damaged; save the file again", source=source
            ) from None
        encoding = "latin-1"
        text = content.decode(encoding)
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        message = "this is binary data, not text; name a file that the firmware's tool writes"
        raise InputError(message, source=source, line=line)
    if not text.strip():
        message = "the file is empty; name one that the firmware's tool writes"
        raise InputError(message, source=source, line=1)
    feeds = text.count("\n")
    crlf = feeds > 0 and text.count("\r\n") == feeds
    plain = text.replace("\r\n", "\n").replace("\r", "\n")
    return TextFile(source, plain, encoding, crlf)


def _encoding(content: bytes) -> str:
    if content[:2] in _WIDE:
        return "utf-16"
    return "utf-8-sig" if content.startswith(codecs.BOM_UTF8) else "utf-8"


def in_range(value: float) -> bool:
    """Whether the float32 of a firmware can hold it, and products of a few such numbers a float."""
    return value == 0.0 or _LEAST <= abs(value) <= _MOST


def plain_number(text: str) -> float | None:
    """Value of a decimal number as files write it; None of anything else, and of what is not
    `in_range`.
    """
    stripped = text.strip()
    if len(stripped) > _LONGEST_NUMBER or not _NUMBER.fullmatch(stripped):
        return None
    value = float(stripped)
    return value if in_range(value) else None


def no_number(text: str) -> str:
    """What is wrong with a text of which `plain_number` makes nothing, and what to write."""
    kind = "beyond every firmware's range" if _NUMBER.fullmatch(text.strip()) else "not a number"
    return f"is {shown(text[:_LONGEST_NUMBER])}, {kind}; {IN_RANGE}"


def number_text(value: OwnValue, digits: int) -> str:
    """A value as plain files hold it: of a float that many significant digits, words and whole
    numbers as they are.
    """
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def c_float(value: float, digits: int) -> str:
    """A float constant of C: with a point or an exponent, and the suffix."""
    text = f"{value:.{digits}g}"
    return f"{text if '.' in text or 'e' in text else text + '.0'}f"


# The loops of another firmware in the time domain: its structure, compiled, around a machine.


def firmware_drive(profile: LoopProfile, design: Design) -> Drive:
    """The design's machine and inverter with the sampling and the delay of a firmware.

    Raises:
        InputError: The design has a machine that no firmware of others drives, or the delay cannot
            be simulated.
    """
    if design.phase_machine is not None:
        raise InputError(
            f"{profile.firmware} is for machines with a sinusoidal back-EMF; the design has "
            "model: waveform"
        )
    return drive_with(
        profile,
        Drive(design.machine, design.inverter, design.control.t_s),
    )


def drive_with(profile: LoopProfile, drive: Drive) -> Drive:
    """A drive with the sampling and the delay of a firmware."""
    if not 0.0 <= profile.current.delay <= LONGEST_DELAY:
        raise InputError(
            f"the delay of {profile.firmware}, {profile.current.delay:g} periods, cannot be "
            f"simulated; from 0 to {LONGEST_DELAY:g} can"
        )
    return replace(
        drive,
        t_s=sampling_period(profile),
        ratio=speed_ratio(profile),
        delay=profile.current.delay,
    )


@contextmanager
def firmware_simulator(profile: LoopProfile, values: DriveValues) -> Iterator[Simulator]:
    """A compiled program for all profiles that modulate as this one does.

    Raises:
        InputError: As `dqforge.reports.firmware.loop_code.loop_files`.
        VerificationError: There is no C compiler, or the code does not compile.
    """
    with simulator(loop_files(profile, values), PREFIX) as program:
        yield program


def simulate_profile(
    profile: LoopProfile,
    values: DriveValues,
    drive: Drive,
    scenario: Scenario,
    *,
    stride: int = 1,
    program: Simulator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Simulation:
    """Run a drive with the loops of a firmware through a scenario.

    Args:
        profile: Structure and numbers of the loops; its sampling and its delay hold.
        values: What the firmware is told of machine and limits.
        drive: Machine and inverter that are there.
        scenario: What it goes through; angle and phase currents come from its sensors.
        stride: Samples per recorded row.
        program: That of `firmware_simulator`, where it is there already.
        progress: Called with the share that is done.

    Raises:
        InputError: The firmware has no such control, or the profile does not fit the simulation.
        VerificationError: There is no C compiler, or the program cannot be run.
    """
    _require_control(profile, values, scenario)
    gains = loop_bytes(profile, values)
    mine = drive_with(profile, drive)
    if program is not None:
        return simulate(program, mine, scenario, stride=stride, gains=gains, progress=progress)
    with firmware_simulator(profile, values) as made:
        return simulate(made, mine, scenario, stride=stride, gains=gains, progress=progress)


def _require_control(profile: LoopProfile, values: DriveValues, scenario: Scenario) -> None:
    if scenario.mode == "speed" and profile.speed is None:
        raise InputError(
            f"{profile.firmware} has no speed controller in this configuration; simulate torque "
            "or current"
        )
    if scenario.mode == "torque" and not (values.psi_pm or 0.0) > 0.0:
        raise InputError(
            f"{profile.firmware} makes amperes of a torque by the flux linkage of the magnets, "
            "which is 0 here; simulate current"
        )
    if scenario.sensorless is not None:
        raise InputError(
            f"the observer of {profile.firmware} is not simulated; leave simulation.sensorless out"
        )


# What becomes of the answer to a step: it settles, or why it does not.

Outcome = Literal["settles", "limit cycle", "divergence", "steady error", "never reaches"]
BAND = 0.05  # Share of a step within which an answer must lie over the last quarter of its time.
_KEPT = 0.9  # of the swing from the last quarter but one to the last: what keeps more swings on
_DRIFT = 0.1  # of the band, from quarter to quarter: what moves more has not come to rest
_TURNS = 4  # through its mean in the last half: fewer are no oscillation


@dataclass(frozen=True, slots=True)
class StepAnswer:
    """One answer over its last quarter.

    ``lowest``, ``highest`` and ``mean`` are those of the value there; ``period`` in s that of an
    oscillation, nan without one; ``settling`` in s the time from the step until the value stays in
    the band, nan where it does not.
    """

    outcome: Outcome
    lowest: float
    highest: float
    mean: float
    period: float
    settling: float


def step_answer(
    time: FloatArray,
    value: FloatArray,
    before: float,
    after: float,
    *,
    span: float | None = None,
    bounded: bool = True,
) -> StepAnswer:
    """Read off what a value did after a step of its reference.

    Args:
        time: In s from the step on, shape (N,).
        value: What was to follow, shape (N,).
        before, after: The reference, in the unit of the value.
        span: Size of the step that the band is a share of, where it is not that of this reference.
        bounded: Whether the run came to its end.
    """
    if not bounded or value.size < 8:
        return StepAnswer("divergence", *_ends(value), float("nan"), float("nan"))
    last = value[(3 * value.size) // 4 :]
    earlier = value[value.size // 2 : (3 * value.size) // 4]
    band = BAND * (abs(after - before) if span is None else span)
    off = np.abs(value - after) > band
    if not bool(np.any(off[(3 * value.size) // 4 :])):
        outside = np.flatnonzero(off)
        first = int(outside[-1]) + 1 if outside.size else 0
        return StepAnswer("settles", *_ends(last), float("nan"), float(time[first] - time[0]))
    period = _period(time[value.size // 2 :], value[value.size // 2 :])
    swing, swing_before = float(np.ptp(last)), float(np.ptp(earlier))
    outcome: Outcome
    if math.isfinite(period) and swing > band and swing > _KEPT * swing_before:
        outcome = "limit cycle"
    elif swing > 0.5 * band or abs(float(np.mean(last) - np.mean(earlier))) > _DRIFT * band:
        outcome = "never reaches"
    else:
        outcome = "steady error"
    return StepAnswer(
        outcome, *_ends(last), period if outcome == "limit cycle" else float("nan"), float("nan")
    )


def _ends(value: FloatArray) -> tuple[float, float, float]:
    kept = value[np.isfinite(value)]
    if not kept.size:
        return (float("nan"),) * 3
    return float(np.min(kept)), float(np.max(kept)), float(np.mean(kept))


def _period(time: FloatArray, value: FloatArray) -> float:
    """Mean period in s of passages through the mean, nan where there are too few."""
    above = value > np.mean(value)
    turns = np.flatnonzero(above[1:] != above[:-1])
    if turns.size < _TURNS:
        return float("nan")
    return float(2.0 * (time[turns[-1]] - time[turns[0]]) / (turns.size - 1))


# The firmware whose files are written and read, by name.

TARGETS: LoadedByName[Firmware, Target] = LoadedByName(
    {name: f"dqforge.reports.firmware.{name}:TARGET" for name in get_args(Firmware)}
)
