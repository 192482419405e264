"""A design as other firmware will run it: its configuration, the loops of that, their margins,
and what is lost on the way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware
from dqforge.machines.places import about
from dqforge.machines.records import dataclass
from dqforge.machines.wording import shown
from dqforge.optimizer.firmware.asked import asked
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod, Shortfall
from dqforge.optimizer.firmware.judge import JudgedFirmware, judge
from dqforge.optimizer.firmware.lacking import check_drivable
from dqforge.optimizer.firmware.registry import METHODS

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.configuration import Configuration
    from dqforge.optimizer.firmware.firmware_loops import FirmwareLoops
    from dqforge.optimizer.firmware.profile import LoopProfile
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
    found = next((method for key, method in methods.items() if key == name), None)
    if found is None:
        known = ", ".join(methods) or "none yet"
        raise InputError(f"{option}: no firmware {shown(name)} is known; write one of {known}")
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
