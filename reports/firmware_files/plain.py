"""Configurations and judged loops of firmware as plain data, by the keys of
docs/reference/json.md.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, DriveValues, PiGains
    from dqforge.optimizer.firmware.explained import Explained
    from dqforge.optimizer.firmware.firmware_method import Shortfall
    from dqforge.optimizer.firmware.judge import JudgedFirmware, JudgedLoop
    from dqforge.optimizer.firmware.profile import LoopProfile
    from dqforge.optimizer.firmware.solve import FirmwareFit
    from dqforge.reports.plain_data import PlainData

# Keys of the fields of `DriveValues`, as under ``drive`` of ``result.json``.
DRIVE_KEYS = {
    "pole_pairs": "pole_pairs",
    "r_s": "r_s_Ohm",
    "l_d": "l_d_H",
    "l_q": "l_q_H",
    "psi_pm": "psi_pm_Wb",
    "inertia": "inertia_kg_m2",
    "viscous": "friction_Nms_per_rad",
    "i_max": "i_max_A",
    "omega_m_max": "omega_m_max_rad_per_s",
    "v_dc": "v_dc_V",
    "f_sw": "f_sw_Hz",
    "dead_time": "dead_time_s",
    "t_s": "t_s_s",
    "t_speed": "t_speed_s",
    "shunt": "shunt_Ohm",
    "sense_gain": "sense_gain",
    "sense_reference": "sense_reference_V",
}


def plain_drive_values(drive: DriveValues) -> PlainData:
    """Machine, limits and timing; null where they are not known."""
    return {key: getattr(drive, name) for name, key in DRIVE_KEYS.items()}


def plain_pi(gains: PiGains | None) -> PlainData | None:
    """Both gains of a controller."""
    return None if gains is None else asdict(gains)


def plain_configuration(found: Configuration) -> PlainData:
    """Everything that a configuration says, with the places in its file."""
    return {
        "firmware": found.firmware,
        "version": found.version,
        "name": found.name,
        "drive": plain_drive_values(found.drive),
        "current_d": plain_pi(found.current_d),
        "current_q": plain_pi(found.current_q),
        "speed": plain_pi(found.speed),
        "own": dict(found.own),
        "origins": {name: asdict(origin) for name, origin in found.origins.items()},
        "conventions": list(found.conventions),
        "contradictions": list(found.contradictions),
    }


def plain_loop(found: JudgedLoop | None) -> PlainData | None:
    """Margins of a loop."""
    if found is None:
        return None
    return {
        "crossover_rad_per_s": found.crossover,
        "phase_margin_rad": found.phase_margin,
        "gain_margin": found.gain_margin,
        "delay_margin_s": found.delay_margin,
        "max_sensitivity": found.max_sensitivity,
        "bandwidth_rad_per_s": found.bandwidth,
        "damping": found.damping,
        "stable": found.stable,
        "poles": [[pole.real, pole.imag] for pole in found.poles.tolist()],
        "t_s": found.t_s,
    }


def plain_loops(found: JudgedFirmware) -> PlainData:
    """The loops of a firmware, the poles of its phase-locked loop, and the remarks."""
    poles = found.pll_poles
    return {
        "i_d": plain_loop(found.current_d),
        "i_q": plain_loop(found.current_q),
        "speed": plain_loop(found.speed),
        "pll_poles": None if poles is None else [[pole.real, pole.imag] for pole in poles],
        "remarks": list(found.remarks),
    }


def plain_observer_of(profile: LoopProfile | None) -> PlainData | None:
    """The position observer of a firmware, None where it has none or is not known."""
    if profile is None or profile.observer is None:
        return None
    found = asdict(profile.observer)
    found["rate_rad_per_s"] = found.pop("rate")
    return found


def plain_shortfall(found: Shortfall) -> PlainData:
    """What a format cannot hold, with its prices."""
    return {
        "words": found.words,
        "prices": [
            {**asdict(price), "value": price.value if math.isfinite(price.value) else None}
            for price in found.prices
        ],
    }


def plain_fit(found: FirmwareFit) -> PlainData:
    """What a firmware is given of a design."""
    return {
        "configuration": plain_configuration(found.configuration),
        "loops": plain_loops(found.judged),
        "observer": plain_observer_of(found.profile),
        "shortfalls": [plain_shortfall(shortfall) for shortfall in found.shortfalls],
    }


def plain_explained(found: Explained) -> PlainData:
    """What a file amounts to."""
    return {
        "configuration": plain_configuration(found.configuration),
        "machine": plain_drive_values(found.drive),
        "loops": plain_loops(found.judged),
        "observer": plain_observer_of(found.profile),
    }
