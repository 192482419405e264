"""The loops of a design as the firmware that it names runs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import (
    JudgedFirmware,
    JudgedLoop,
    judge,
    judged_loop,
)
from dqforge.optimizer.firmware.firmware_method import asked as asked_of
from dqforge.optimizer.firmware.gain_search import (
    AXES,
    CurrentSearch,
    axis_plants,
    speed_plants_over,
    speed_search,
)
from dqforge.optimizer.firmware.own_values import METHODS, check_drivable
from dqforge.optimizer.loops.plants import SpeedLoop

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.names import Firmware
    from dqforge.optimizer.firmware.configuration import LoopProfile, PiController
    from dqforge.optimizer.firmware.firmware_method import (
        Asked,
        FirmwareMethod,
        FreeGains,
        Shortfall,
    )
    from dqforge.optimizer.firmware.gain_search import Chosen
    from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
    from dqforge.optimizer.loops.robustness import LoopRobustness
    from dqforge.optimizer.loops.tolerance_box import DriveBox


@dataclass(frozen=True, slots=True, eq=False)
class FirmwareLoop:
    """One loop in both structures.

    Args:
        loop: ``i_d``, ``i_q`` or ``speed``.
        gains: Of the firmware: V/A and V/(A s), or A s/rad and A/rad.
        judged: As the firmware runs it.
        own: Gains of the emitted header: V/A and V/(A s), or N m s/rad and N m/rad.
        neutral: As that header runs them.
        worst: What it keeps over the corners of ``control.tolerances``, None without them.
    """

    loop: LoopName
    gains: PiGains
    judged: JudgedLoop
    own: PiGains
    neutral: JudgedLoop
    worst: LoopRobustness | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FirmwareLoops:
    """What a firmware makes of a design.

    Args:
        name, version: The firmware and the version of its format.
        free: Which gains of its current loops can be chosen.
        asked: What its configuration was asked to hold, with the gains that were chosen.
        configuration, profile: The configuration, rounded as its file prints it, and the loops that
            it amounts to.
        judged: These loops on the machine, with remarks.
        loops: Those of them that the design has, beside those of the header.
        changes: What was chosen otherwise than the design's own structure has it, one sentence
            each.
        shortfalls: What the configuration cannot hold of what was asked.
    """

    name: Firmware
    version: str
    free: FreeGains
    asked: Asked
    configuration: Configuration
    profile: LoopProfile
    judged: JudgedFirmware
    loops: tuple[FirmwareLoop, ...]
    changes: tuple[str, ...]
    shortfalls: tuple[Shortfall, ...]


def firmware_loops(
    design: Design,
    box: DriveBox,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
    methods: Mapping[Firmware, FirmwareMethod] = METHODS,
) -> FirmwareLoops | None:
    """Choose and judge the gains within the structure of ``control.firmware``; None without one.

    Args:
        design: The design.
        box: The drive with its tolerances.
        own: i_d, i_q and speed as the design's own structure has them: what is wished for.
        methods: The firmwares that are known.

    Raises:
        NoSolutionError: No gains within the structure keep what the design asks for; says what
            would.
        InputError: A value does not fit the firmware; with its key.
    """
    wanted = design.control.firmware
    if wanted is None:
        return None
    method = methods.get(wanted.name)
    if method is None:
        raise InputError(f"control.firmware: '{wanted.name}' is not known here; use another")
    check_drivable(design, [method])
    i_d, i_q, speed = own
    if design.control.tolerances is None:
        box = replace(box, spread=(1.0, 1.0))
    pll = None if wanted.pll is None else PiGains(*wanted.pll)
    asked = replace(asked_of(design, i_d, i_q, speed), pll=pll)
    chosen = CurrentSearch(method, box, asked, design.control.current_loop).solve()
    search = speed_search(method, box, chosen, asked, i_q)
    chosen = chosen if search is None else search.solve()
    return _record(method, box, chosen, asked, own)


def _record(
    method: FirmwareMethod,
    box: DriveBox,
    chosen: Chosen,
    asked: Asked,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
) -> FirmwareLoops:
    profile = chosen.profile
    drive = replace(chosen.asked.drive, l_d=box.nominal[0], l_q=box.nominal[1])
    judged = judge(profile, drive)
    return FirmwareLoops(
        method.name,
        method.version,
        method.free,
        chosen.asked,
        chosen.configuration,
        profile,
        judged,
        _loops(profile, judged, box, own),
        chosen.words,
        method.shortfalls(asked, chosen.configuration),
    )


def _loops(
    profile: LoopProfile,
    judged: JudgedFirmware,
    box: DriveBox,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
) -> tuple[FirmwareLoop, ...]:
    named, found = box.design.control.tolerances is not None, []
    current, speed = profile.current, profile.speed
    controllers, alone = (current.d, current.q), (judged.current_d, judged.current_q)
    for axis, pi, loop, header in zip(AXES, controllers, alone, own[:2], strict=True):
        assert loop is not None
        worst = axis_plants(box, axis, current).kept(pi) if named else None
        found.append(_beside(pi, loop, header, worst))
    if speed is not None and judged.speed is not None and own[2] is not None:
        worst = speed_plants_over(box, current, speed).kept(speed.pi) if named else None
        found.append(_beside(speed.pi, judged.speed, own[2], worst))
    return tuple(found)


def _beside(
    pi: PiController, loop: JudgedLoop, header: LoopGains, worst: LoopRobustness | None
) -> FirmwareLoop:
    """A loop of the firmware beside that of the header."""
    model = header.model
    neutral = judged_loop(model.loop if isinstance(model, SpeedLoop) else model)
    gains, own = PiGains(pi.kp, pi.ki), PiGains(header.kp, header.ki)
    return FirmwareLoop(header.loop, gains, loop, own, neutral, worst)
