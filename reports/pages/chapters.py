"""The chapters of the report and their order; capabilities write the parts of them."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter of the report.

    Args:
        id, title: Its anchor, and its name in the contents.
        opening: Template of what stands before its parts, whoever writes them; empty where its only
            part opens it.
        folded: Whether it is closed at first: what few readers want, or want last.
    """

    id: str
    title: str
    opening: str = ""
    folded: bool = False


REFERENCE = Chapter("reference", "Current reference")
ERRORS = Chapter("errors", "Torque error and loss", folded=True)
LOOPS = Chapter("loops", "Control loops", "loops/opening.html.j2")
LOSSES = Chapter("losses", "Loss comparison", "losses/opening.html.j2")
MODULATION = Chapter("modulation", "Modulator and frequency")
CURRENT_FEEDBACK = Chapter("current-feedback", "Current-feedback PWM")
WAVEFORMS = Chapter("waveforms", "Phase currents")
WEAKENING = Chapter("weakening", "Field weakening")
SIMULATION = Chapter("simulation", "Simulation")

# In the order of the report; a chapter that is not listed follows them.
CHAPTERS = (
    *(REFERENCE, ERRORS, LOOPS, LOSSES, MODULATION),
    *(CURRENT_FEEDBACK, WAVEFORMS, WEAKENING, SIMULATION),
)
