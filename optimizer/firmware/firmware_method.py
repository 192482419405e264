"""One record per firmware: from a design to its configuration, and from that to its loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.names import Firmware
    from dqforge.optimizer.firmware.configuration import Configuration, DriveValues, PiGains
    from dqforge.optimizer.firmware.profile import LoopProfile

# What a firmware leaves to choose: kp and ki of each axis, one pair for both, or only a bandwidth
# from which it works out the gains by itself.
FreeGains = Literal["axes", "one-pair", "bandwidth"]


@dataclass(frozen=True, slots=True)
class Asked:
    """What a configuration is to hold.

    Args:
        design: The design; its machine may be saturated.
        drive: What can be told of it in constants
            (`dqforge.optimizer.firmware.asked.drive_values`).
        current_d, current_q: Gains wished for, V/A and V/(A s); a structure that cannot hold them
            takes what is nearest.
        speed: Gains wished for in A s/rad and A/rad, None without a speed loop.
        pll: Gains wished for (1/s and 1/s^2) of the phase-locked loop that makes the speed, s^2 +
            kp s + ki; None for the firmware's own. A firmware without one takes no notice.
    """

    design: Design
    drive: DriveValues
    current_d: PiGains
    current_q: PiGains
    speed: PiGains | None = None
    pll: PiGains | None = None


@dataclass(frozen=True, slots=True)
class Price:
    """What something costs: of what (``torque``, ``copper loss``, ``phase margin``, ...), how much,
    in which unit (SI; shares are plain numbers with the unit ``""``).
    """

    of: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Something of the design that a format cannot hold: in words, with its price where it has
    one in numbers.
    """

    words: str
    prices: tuple[Price, ...] = ()


@dataclass(frozen=True, slots=True)
class FirmwareMethod:
    """How one firmware is configured, and what it then runs.

    Args:
        name, version: The firmware and the version of its format.
        free: Which gains of its current loops can be chosen.
        configure: The configuration for what is asked, rounded as its file prints it. Raises
            InputError where a value that it needs is missing or does not fit its numbers, and names
            the key.
        profile: The loops that a configuration amounts to. Raises InputError where it says too
            little.
        shortfalls: What the configuration cannot hold of what was asked.
        needs: Keys that a design may leave out and this firmware needs.
    """

    name: Firmware
    version: str
    free: FreeGains
    configure: Callable[[Asked], Configuration]
    profile: Callable[[Configuration], LoopProfile]
    shortfalls: Callable[[Asked, Configuration], tuple[Shortfall, ...]]
    needs: tuple[str, ...] = ()
