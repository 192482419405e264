"""What the figures of chapters 4 and 6 of paper 002 show, and what of them can be recomputed.

The thesis prints its curves without a scale in the text; its machine has a name plate (Table 6.1)
and no other data. So identities of the frames hold whatever the machine, and everything in amperes,
volts or revolutions here rests on the inferred data of the shipped drive.
"""

from __future__ import annotations

from dqforge.machines.records import dataclass

# Everything in numbers that chapter 6 states: value, unit, place.
PRINTED_CONDITIONS = {
    "poles": (4.0, "", "Table 6.1"),
    "rated power": (750.0, "W", "Table 6.1"),
    "dc link": (220.0, "V", "Table 6.1"),
    "rated current": (4.2, "A", "Table 6.1"),
    "rated speed": (1800.0, "rpm", "Table 6.1"),
    "speed": (750.0, "rpm", "section 6.2"),
    "torque": (1.0, "N m", "section 6.2"),
    "sampling period": (100.0, "us", "section 6.2"),
    "switching frequency": (10.0, "kHz", "section 6.2"),
}

DEFINED = "from the definitions"
INFERRED = "inferred data"
LOOP = "inferred data, emitted C in the loop"
PHOTOGRAPH = "not recomputed"


@dataclass(frozen=True, slots=True)
class ThesisFigure:
    """A figure of the thesis: its numbers, what it shows, on what the recomputed one rests, and
    what cannot be recomputed of it (empty: nothing).
    """

    numbers: str
    shows: str
    rests_on: str
    lacks: str = ""


_CURVES = "the measured curve"

FIGURES = (
    ThesisFigure(
        "4.1", "control in three parts: transforms, current controller, inverter", DEFINED
    ),
    ThesisFigure("4.2", "dqy control: references (4.4)-(4.6), PI controllers in dqy", DEFINED),
    ThesisFigure("4.3", "the same with decoupling (4.10)-(4.15) and (4.16)-(4.18)", DEFINED),
    ThesisFigure("6.1", "machine and load on the bench", PHOTOGRAPH, "a photograph"),
    ThesisFigure("6.2", "back-EMF over speed, three phases, measured", INFERRED, _CURVES),
    ThesisFigure("6.3", "harmonics of the back-EMF of phase a", INFERRED, "its numbers"),
    ThesisFigure("6.4", "theta_r, theta_r + theta_x and theta_y over the angle", INFERRED),
    ThesisFigure("6.5", "a_x and a_y over the angle", INFERRED),
    ThesisFigure("6.6", "current of phase a by dqx and dqy, simulated", INFERRED),
    ThesisFigure("6.7", "harmonics of that current", INFERRED),
    ThesisFigure("6.8", "the two diodes 1N5408 at the neutral", PHOTOGRAPH, "a photograph"),
    ThesisFigure("6.9", "i_qy, simulated and measured", LOOP, _CURVES),
    ThesisFigure("6.10", "i_qx of the same", LOOP, _CURVES),
    ThesisFigure("6.11, 6.12", "i_alpha, i_beta of the same", LOOP, _CURVES),
    ThesisFigure("6.13", "i_0 of the same", LOOP, _CURVES),
    ThesisFigure("6.14, 6.15", "path of the current in alpha-beta and alpha-beta-0", LOOP, _CURVES),
    ThesisFigure("6.16", "current of phase a", LOOP, _CURVES),
    ThesisFigure("6.17", "torque at a load step of 1 N m, 750 rpm", LOOP, _CURVES),
    ThesisFigure(
        "6.18", "speed at that step", LOOP, "the measured curve; inertia, speed controller"
    ),
)
