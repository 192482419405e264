"""What the keys of other firmware mean that stand for no value of a drive, which of a format's
conventions concern a file, and how a file gets onto its controller.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.configuration import Configuration

# Of formats whose own modules do not say it of each key.
_MEANINGS: Mapping[str, Mapping[str, str]] = {
    "moteus": {
        "motor.inductance_d_scale": "fall of the inductance over the current, none",
        "motor.rotation_current_cutoff_A": "current above which the torque constant falls, A",
        "motor.rotation_current_scale": "shape of the torque above that current",
        "motor.rotation_torque_scale": "shape of the torque above that current",
        "servo.current_feedforward": "share of R i that is fed forward",
        "servo.cross_coupling_feedforward": "share of the coupling voltages that is fed forward",
    },
    "odrive": {
        "motor.config.motor_type": "0: motor with known or measured R and L",
        "motor.config.pre_calibrated": "R and L are known: they are not measured at the start",
        "motor.config.current_lim_margin": "above current_lim, where the drive trips, A",
        "motor.config.requested_current_range": "range of the current measurement, A",
        "motor.config.R_wL_FF_enable": "whether R i and the coupling voltages are fed forward",
        "motor.config.bEMF_FF_enable": "whether the back-EMF is fed forward",
    },
    "simplefoc": {
        "phase_inductance": "inductance of a phase that older versions know, H",
    },
}

# Words of a sentence that name keys of a file, and what a sentence about keys begins with.
_KEY = re.compile(r"\b[A-Za-z][A-Za-z0-9]*(?:[_.][A-Za-z0-9]+)+\b")
_SUBJECT = re.compile(rf"({_KEY.pattern}.*?) (?:is|are|counts?|commands?|limits?|stands) ")

# How a file gets onto its controller, what stays as it was there, and how to begin; by firmware.
_STEPS: Mapping[str, tuple[str, str]] = {
    "vesc": (
        (
            "in VESC Tool: Read Motor Configuration, File > Load Motor Configuration XML, Write "
            "Motor Configuration; battery limits, cut-offs and Hall table stay as they are"
        ),
        (
            "run no motor detection afterwards (it measures and replaces R, L and flux linkage); "
            "detect the Hall sensors or encoder only; start with a small current"
        ),
    ),
    "simplefoc": (
        (
            "in the sketch include the header, construct the motor and call its configure function "
            "as the head of the header shows, before motor.init(); sensor and driver stay yours"
        ),
        "or send the lines of the .txt to the Commander; start with a small current_limit",
    ),
    "moteus": (
        (
            "moteus_tool --write-config FILE; position limits, encoder and "
            "offset calibration stay as they are"
        ),
        (
            "run no calibration of R and Kv afterwards (it replaces them); start with a small "
            "servo.max_current_A"
        ),
    ),
    "odrive": (
        "odrivetool restore-config FILE; bus limits, brake resistor and encoder stay as they are",
        "calibrate the encoder offset only, not the motor; start with a small current_lim",
    ),
    "nxp": (
        (
            "replace the project's header by this one (or export with --into), build and flash; "
            "pins, converters and fault limits stay yours"
        ),
        "in MCAT: Load data shows the same values; start with a small current",
    ),
    "st": (
        (
            "in Motor Control Workbench: import the motor's JSON, generate, then export with "
            "--into onto the generated headers; board and protections stay yours"
        ),
        "run no motor profiler afterwards (it replaces R, L and flux); start with a small current",
    ),
    "ti": (
        (
            "include the header as the last line of the motor's block in user_mtr1.h; board, "
            "converters and fault limits stay yours"
        ),
        (
            "leave the identification of the motor off (it replaces R, L and flux); start with a "
            "small current"
        ),
    ),
    "infineon": (
        (
            "include the header and call its set functions as its head shows; board, protections "
            "and pins stay yours"
        ),
        "leave the profiler off (params.profiler.overwrite = false); start with a small current",
    ),
}


def meaning(firmware: Firmware, key: str) -> str:
    """What a key of a firmware's file means, with its unit; empty where it is not described."""
    if firmware == "vesc":
        from dqforge.optimizer.firmware.vesc_format import KEYS

        return KEYS[key].says if key in KEYS else ""
    if firmware == "infineon":
        from dqforge.optimizer.firmware.infineon_format import KEYS as MEMBERS_OF_PARAMS

        found = MEMBERS_OF_PARAMS.get(key)
        return "" if found is None else ", ".join(filter(None, (found.says, found.unit)))
    if firmware == "simplefoc":
        from dqforge.optimizer.firmware.targets.simplefoc import MEMBERS

        if key in MEMBERS:
            return MEMBERS[key].says
    return _MEANINGS.get(firmware, {}).get(key, "")


def conventions_here(found: Configuration) -> tuple[str, ...]:
    """Conventions of the keys that the file has: not those that name other keys alone.

    Args:
        found: The configuration of a file.
    """
    keys = " ".join((*found.own, *(origin.key for origin in found.origins.values())))

    def concerns(sentence: str) -> bool:
        about = _SUBJECT.match(sentence)
        if about is None or not found.origins:
            return True
        return any(name in keys for name in _KEY.findall(about[1]))

    return tuple(sentence for sentence in found.conventions if concerns(sentence))


def next_steps(firmware: Firmware) -> tuple[str, str]:
    """Two lines: what to do with the file in the vendor's tool, and how to begin.

    Args:
        firmware: Whose file it is.
    """
    return _STEPS[firmware]
