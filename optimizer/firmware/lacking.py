"""What firmware needs of a design that it does not say: all of it in one refusal, with text to
paste.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.firmware_method import FirmwareMethod

MAX_SPEED, INERTIA = "machine.max_speed", "machine.inertia"
CURRENT_SENSING = "inverter.current_sensing"
_HEADROOM = 1.25  # Full scale of a current measurement that is proposed, over the current limit.
_RUN_UP = 0.1  # Time in s in which a proposed inertia runs up to the largest speed.


def check_drivable(design: Design, methods: Sequence[FirmwareMethod]) -> None:
    """Refuse a machine of a kind that no firmware of others drives, and a design that lacks what
    they need.

    Raises:
        InputError: With everything that is missing, as keys with values that fit this drive.
    """
    names = " and ".join(method.name for method in methods)
    if methods and design.phase_machine is not None:
        raise InputError(
            f"export.firmware: {names} drives machines with a sinusoidal back-EMF, and this one "
            "has model: waveform; leave it out"
        )
    needed = {key for method in methods for key in method.needs}
    proposals = {
        MAX_SPEED: (design.machine.omega_m_max, _speed_text),
        INERTIA: (design.machine.inertia, _inertia_text),
        CURRENT_SENSING: (design.inverter.current_sensing, _sensing_text),
    }
    missing = {
        key: text(design)
        for key, (value, text) in proposals.items()
        if key in needed and value is None
    }
    if not missing:
        return
    who = " and ".join(method.name for method in methods if missing.keys() & set(method.needs))
    lines = [
        f"in {section} "
        + " and ".join(
            f"'{key.partition('.')[2]}: {text}'"
            for key, text in missing.items()
            if key.startswith(f"{section}.")
        )
        for section in dict.fromkeys(key.partition(".")[0] for key in missing)
    ]
    raise InputError(
        f"{next(iter(missing))}: {who} cannot do without {', '.join(missing)}; write "
        f"{', and '.join(lines)}, with your own values in place of these, which fit this drive"
    )


def _base_speed(design: Design) -> float:
    """Mechanical speed in rad/s at which flux linkage and link meet."""
    machine = design.machine
    flux = math.hypot(machine.psi_pm, machine.l_q * design.i_max)
    return design.inverter.v_dc / math.sqrt(3.0) / (flux * machine.pole_pairs)


def _speed_text(design: Design) -> str:
    return f"{float(f'{_base_speed(design) * 30.0 / math.pi:.2g}'):g} rpm"


def _inertia_text(design: Design) -> str:
    machine = design.machine
    flux = max(machine.psi_pm, abs(machine.l_q - machine.l_d) * design.i_max)
    torque = 1.5 * machine.pole_pairs * flux * design.i_max
    speed = machine.omega_m_max or _base_speed(design)
    return f"{torque * _RUN_UP / speed:.2g} kg m^2"


def _sensing_text(design: Design) -> str:
    gain, reference = 20.0, 3.3
    shunt = 0.5 * reference / gain / (_HEADROOM * design.i_max)
    milliohm = float(f"{1e3 * shunt:.2g}")
    return f"{{shunt: {milliohm:g} mOhm, gain: {gain:g}, reference: {reference:g} V}}"
