"""Which motor a header of MCAT is that of, and the line comments of its older age."""

from __future__ import annotations

import re

from dqforge.optimizer.firmware.nxp_mcat.mcat_names import MACROS

# Macros that are read and written, as of the first motor.
KNOWN = frozenset(macro for macros in MACROS.values() for macro in macros)

# Inputs by what stands before the sign of equality in a comment.
COMMENTED = {
    "pole-pair number": "parametersPP",
    "pole-pair numbers": "parametersPP",
    "stator resistance": "parametersRs",
    "direct axis inductance": "parametersLd",
    "quadrature axis inductance": "parametersLq",
    "back-emf constant": "parametersKe",
    "drive inertia": "parametersJ",
    "nominal current": "parametersIphNom",
}

# Inputs of the comments on bandwidth, attenuation and sample time, by the heading above them.
COMMENTED_LOOPS = {
    "current loop control": ("currentLoopF0", "currentLoopKsi", "currentLoopSampleTime"),
    "speed loop control": ("speedLoopF0", "speedLoopKsi", "speedLoopSampleTime"),
    "sensorless bemf": ("sensorlessBemfObsrvF0", "sensorlessBemfObsrvKsi", ""),
}

# Macros of headers that are kept by hand, inputs that they stand for, and whether as one over.
BY_HAND = (
    ("R", "parametersRs", False),
    ("LD", "parametersLd", False),
    ("LQ", "parametersLq", False),
    ("CLOOP_FREQ", "currentLoopF0", False),
    ("CURRENT_CLOOP_FREQ", "currentLoopF0", False),
    ("CLOOP_ATT", "currentLoopKsi", False),
    ("CURRENT_CLOOP_ATT", "currentLoopKsi", False),
    ("FAST_LOOP_FREQ", "currentLoopSampleTime", True),
    ("FASTLOOP_FREQ", "currentLoopSampleTime", True),
    ("SLOW_LOOP_FREQ", "speedLoopSampleTime", True),
    ("SLOWLOOP_FREQ", "speedLoopSampleTime", True),
)

LOOP_WORDS = ("loop bandwidth", "loop attenuation", "loop sample time")
HEADING_LINE = re.compile(r"^[ \t]*(?://|/?\*+)[ \t]*([A-Za-z][^=\n]*)$")
_PREFIX = re.compile(r"^[ \t]*#[ \t]*define[ \t]+M([1-9])_(?:MOTOR_PP|I_MAX|D_KP_GAIN)\b", re.M)


def motor_of(text: str) -> str | None:
    """The prefix of the macros, such as ``M1_``; None where no motor's macros stand there.

    Args:
        text: The text of the header.
    """
    found = _PREFIX.search(text)
    return None if found is None else f"M{found[1]}_"
