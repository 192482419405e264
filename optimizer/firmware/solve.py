"""A design as other firmware will run it: its configuration, the loops of that, their margins,
and what is lost on the way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Protocol

from dqforge.machines.design.numerical import numerical_errors
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError, NoSolutionError, about, close_matches, shown
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
    Winding,
    current_loop,
    speed_loop,
)
from dqforge.optimizer.firmware.firmware_method import (
    METHODS,
    Asked,
    FirmwareMethod,
    JudgedFirmware,
    JudgedLoop,
    Shortfall,
    asked,
    check_drivable,
    judge,
    judged_loop,
    mechanics_of,
)

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.gain_search import FirmwareLoops
    from dqforge.optimizer.loops.loop_gains import LoopGains


Methods = Mapping[Firmware, FirmwareMethod]


class Gains(Protocol):
    """The gains of a design, as far as firmware of others takes them."""

    @property
    def i_d(self) -> LoopGains:
        """Of the d current."""

    @property
    def i_q(self) -> LoopGains:
        """Of the q current."""

    @property
    def speed(self) -> LoopGains | None:
        """Of the speed, None without such a controller."""

    @property
    def firmware(self) -> FirmwareLoops | None:
        """What was chosen within the structure of ``control.firmware``, None without that key."""


@dataclass(frozen=True, slots=True, eq=False)
class FirmwareFit:
    """What one firmware is given of a design.

    Args:
        asked: What it was asked to hold.
        configuration: Its numbers, rounded as its file prints them.
        profile: The loops that they amount to.
        judged: Those loops on the design's machine.
        shortfalls: What the format cannot hold.
    """

    asked: Asked
    configuration: Configuration
    profile: LoopProfile
    judged: JudgedFirmware
    shortfalls: tuple[Shortfall, ...]

    @property
    def name(self) -> Firmware:
        """The firmware."""
        return self.configuration.firmware


def solve_firmware(
    design: Design,
    gains: Gains | None,
    names: Sequence[Firmware] | None = None,
    methods: Methods = METHODS,
) -> tuple[FirmwareFit, ...]:
    """The design for each firmware that it names under ``export.firmware``.

    Args:
        design: The design.
        gains: Its gains, None where it has none.
        names: Other firmware than the design names.
        methods: Those of the package, or others.

    Raises:
        InputError: There are no gains, the machine is of a kind that none of them drives, or a
            firmware needs a value that the design lacks.
    """
    wanted = design.export.firmware if names is None else tuple(names)
    with about("export.firmware"):
        found = [method_of(name, methods) for name in wanted]
        check_drivable(design, found)
        return tuple(_fit(design, gains, method) for method in found)


def method_of(
    name: str, methods: Methods = METHODS, *, option: str = "export.firmware"
) -> FirmwareMethod:
    """The method of a firmware by its name; ``option`` is the key that named it.

    Raises:
        InputError: There is none.
    """
    found = next((method for key, method in methods.items() if key == name.casefold()), None)
    if found is None:
        known = ", ".join(methods) or "none yet"
        near = close_matches(name.casefold(), tuple(methods), limit=1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise InputError(
            f"{option}: no firmware {shown(name)} is known; write one of {known}{hint}"
        )
    return found


def _fit(design: Design, gains: Gains | None, method: FirmwareMethod) -> FirmwareFit:
    if gains is None:
        raise InputError(
            f"export.firmware: {method.name} needs gains, and the design has none; write control: "
            "with a current_loop that holds, and gains: true"
        )
    chosen = gains.firmware
    if chosen is not None and chosen.name == method.name:
        return FirmwareFit(
            chosen.asked, chosen.configuration, chosen.profile, chosen.judged, chosen.shortfalls
        )
    wanted = asked(design, gains.i_d, gains.i_q, gains.speed)
    configuration = method.configure(wanted)
    profile = method.profile(configuration)
    return FirmwareFit(
        wanted,
        configuration,
        profile,
        judge(profile, wanted.drive),
        method.shortfalls(wanted, configuration),
    )


# What the configuration of a firmware, or a header of our own, amounts to on a machine.

# Fields of `DriveValues` that say what machine it is.
OF_MACHINE = ("pole_pairs", "r_s", "l_d", "l_q", "psi_pm", "inertia", "viscous")

_NO_SPEED = (
    "the speed loop is not evaluated: a header lacks the inertia; name the design of the "
    "machine with --machine DESIGN"
)

_NAME_MACHINE = (
    "name the design of the machine with --machine DESIGN: values missing from the file "
    "are taken from it"
)

_COMPLETE_MACHINE = (
    "the design of the machine does not contain it either: write it there, such as machine.inertia"
)

_OBSERVED = (
    "the speed loop is evaluated with the true speed; it runs on an observer, whose lag is in the "
    "margins that 'dqforge tune' shows"
)


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """A configuration on a machine.

    Args:
        configuration: What was read.
        drive: The machine that its loops are judged on, in the file's timing.
        profile, judged: The loops; the profile is None where the configuration says too little.
    """

    configuration: Configuration
    drive: DriveValues
    profile: LoopProfile | None
    judged: JudgedFirmware


@dataclass(frozen=True, slots=True, eq=False)
class OwnGains:
    """Gains that dqforge wrote, of a header or a result: the speed's in N m s/rad and N m/rad.

    ``observed`` says that the speed is that of an observer.
    """

    drive: DriveValues
    current_d: PiGains | None
    current_q: PiGains | None
    speed: PiGains | None
    observed: bool = False


def on_machine(drive: DriveValues, machine: DriveValues | None) -> DriveValues:
    """The values of a file with those of a machine in place of its own.

    What neither limits nor machine are stays that of the file; what it lacks is the machine's.
    """
    if machine is None:
        return drive
    found = {part.name: getattr(drive, part.name) for part in fields(DriveValues)}
    for name, value in found.items():
        other = getattr(machine, name)
        if other is not None and (value is None or name in OF_MACHINE):
            found[name] = other
    return DriveValues(**found)


def explain(
    configuration: Configuration, machine: DriveValues | None = None, methods: Methods = METHODS
) -> Explained:
    """What a configuration amounts to.

    Args:
        configuration: Of a file.
        machine: The machine that it runs on, where that is not the one that it tells of.
        methods: Those of the package, or others.
    """
    drive = on_machine(configuration.drive, machine)
    profile = None
    try:
        with numerical_errors():
            profile = profile_of(configuration, machine, methods)
            judged = _advised(profile, judge(profile, drive), named=machine is not None)
    except (InputError, NoSolutionError) as error:
        judged = _nothing(error.message)
    return Explained(configuration, drive, profile, judged)


def profile_of(
    configuration: Configuration, machine: DriveValues | None = None, methods: Methods = METHODS
) -> LoopProfile:
    """The loops of a configuration; raises InputError where it says too little."""
    # What the file says counts for what the firmware computes from it; the machine completes it.
    told = on_machine(on_machine(configuration.drive, machine), configuration.drive)
    method = method_of(configuration.firmware, methods)
    return method.profile(replace(configuration, drive=told))


def _advised(profile: LoopProfile, judged: JudgedFirmware, *, named: bool) -> JudgedFirmware:
    """The loops with what to give where one of them could not be judged."""
    unknown = profile.speed is not None and judged.speed is None
    if not unknown and judged.current_q is not None:
        return judged
    advice = _COMPLETE_MACHINE if named else _NAME_MACHINE
    return replace(judged, remarks=(*judged.remarks, advice))


def _nothing(remark: str) -> JudgedFirmware:
    return JudgedFirmware(None, None, None, None, (remark,))


def explain_own(gains: OwnGains, machine: DriveValues | None = None) -> JudgedFirmware:
    """The loops of gains that dqforge wrote: voltage held from the next sample on, the integral
    counting at once, the speed known.

    Args:
        gains: Of a header or a result.
        machine: The machine that they run on, where that is not the one that they were made for.
    """
    drive = on_machine(gains.drive, machine)
    if drive.r_s is None or drive.t_s is None:
        missing = "phase resistance" if drive.r_s is None else "sampling period"
        return _nothing(f"without the {missing} no loop can be evaluated")
    d = _own_current(gains.current_d, drive, drive.l_d)
    q = _own_current(gains.current_q, drive, drive.l_q)
    speed = _own_speed(gains, drive)
    remarks = () if speed is not None or gains.speed is None else (_NO_SPEED,)
    if speed is not None and gains.observed:
        remarks = (_OBSERVED,)
    return JudgedFirmware(d, q, speed, None, remarks)


def _own_current(
    gains: PiGains | None, drive: DriveValues, inductance: float | None
) -> JudgedLoop | None:
    if gains is None or inductance is None or drive.r_s is None or drive.t_s is None:
        return None
    pi = PiController(gains.kp, gains.ki, drive.t_s)
    return judged_loop(current_loop(Winding(drive.r_s, inductance), pi, 1.0))


def _own_speed(gains: OwnGains, drive: DriveValues) -> JudgedLoop | None:
    """The speed loop, None where something that it needs is not known."""
    d, q, speed = gains.current_d, gains.current_q, gains.speed
    known = (drive.pole_pairs, drive.psi_pm, drive.inertia, drive.t_speed)
    if d is None or q is None or speed is None or None in known or not drive.psi_pm:
        return None
    assert drive.pole_pairs is not None
    assert drive.t_s is not None
    assert drive.r_s is not None
    assert drive.t_speed is not None
    if drive.l_q is None:
        return None
    per_ampere = torque_per_ampere(drive.pole_pairs, drive.psi_pm)
    current = CurrentLoops(
        PiController(d.kp, d.ki, drive.t_s), PiController(q.kp, q.ki, drive.t_s), back_emf=True
    )
    outer = SpeedController(
        PiController(speed.kp / per_ampere, speed.ki / per_ampere, drive.t_speed),
        SpeedEstimate(),
    )
    mechanics = mechanics_of(drive, current)
    return judged_loop(speed_loop(Winding(drive.r_s, drive.l_q), mechanics, current, outer))
