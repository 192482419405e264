"""What was chosen for a firmware: asked, configured and in words; what both searches share."""

from __future__ import annotations

from typing import get_args

from dqforge.machines.errors import InputError
from dqforge.machines.names import VendorMethod
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod
from dqforge.optimizer.firmware.gain_search.structure_box import Bounds
from dqforge.optimizer.firmware.profile import LoopProfile
from dqforge.optimizer.loops.pi_methods import Settings

# Shares of M_s - 1 that are tried until the rounded gains keep the bound.
SHRUNK = (1.0, 0.999, 0.99, 0.95, 0.9, 0.8, 0.6)

# Methods whose numbers the design names.
NAMED = ("bandwidth", "damping", "given", *get_args(VendorMethod))


@dataclass(frozen=True, slots=True)
class Chosen:
    """What was asked in the end, what the firmware makes of it, and in words what was changed."""

    asked: Asked
    configuration: Configuration
    profile: LoopProfile
    words: tuple[str, ...] = ()


def configured(method: FirmwareMethod, asked: Asked, *words: str) -> Chosen:
    """What a firmware makes of what is asked; raises as its ``configure``.

    Args:
        method: The firmware.
        asked: What its configuration is to hold.
        words: What was changed of what the design asks for.
    """
    configuration = method.configure(asked)
    return Chosen(asked, configuration, method.profile(configuration), words)


def possible(method: FirmwareMethod, asked: Asked) -> Chosen | None:
    """The same, None where the format cannot hold it.

    Args:
        method: The firmware.
        asked: What its configuration is to hold.
    """
    try:
        return configured(method, asked)
    except InputError:
        return None


def bounds_of(settings: Settings) -> Bounds:
    """What a loop must keep; M_s only by the method ``optimised``.

    Args:
        settings: Method and settings of the loop.
    """
    if settings.method == "optimised":
        return Bounds(settings.min_phase_margin, settings.max_sensitivity)
    return Bounds(settings.min_phase_margin)


def firmware_text(method: FirmwareMethod) -> str:
    """The firmware with its version.

    Args:
        method: The firmware.
    """
    return f"{method.name} {method.version}".strip()


def lowered(what: str, fault: str, factor: float, method: FirmwareMethod) -> str:
    """That a loop is slowed down, and why.

    Args:
        what: The loop, in words.
        fault: What it does not keep with what the design asks for.
        factor: Of its bandwidth.
        method: The firmware.
    """
    return (
        f"slowed down: {what}, to {factor:.3g} times what the method gives; with that, as "
        f"{firmware_text(method)} runs it, {fault}"
    )
