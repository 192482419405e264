"""The topologies of paper 002, chapter 5: their legs, what becomes of the zero sequence, and which
voltages their link makes.

A phase voltage is that of the phase's leg less what its other end is tied to: the mean of the legs
(no neutral), the neutral's leg, the phase's second leg, or the midpoint of the link. All else in
this room, and every limit of voltage elsewhere, follows from these records.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class TopologyRule:
    """How the phases are fed.

    Args:
        legs: Names of the half bridges, in the order of their duty cycles; ``a2`` is the second one
            of phase a.
        neutral: Whether the legs drive a zero-sequence current.
        phase, between: Largest phase voltage, and largest difference between two, over the voltage
            of the link; None where the other one is all that limits them.
        midpoint: Whether the neutral lies on the midpoint of the link, whose voltage moves with its
            current; ``phase`` is then that of a link in halves.
        diodes: Whether the neutral hangs on two diodes to the rails, which conduct but are not
            switched.
    """

    legs: tuple[str, ...]
    neutral: bool
    phase: float | None = None
    between: float | None = None
    midpoint: bool = False
    diodes: bool = False

    @property
    def modulated(self) -> bool:
        """Whether the design's modulator makes the duty cycles: three legs that share nothing with
        the neutral, so that what is common to them is free.
        """
        return len(self.legs) == 3 and not self.midpoint


TOPOLOGIES: dict[Topology, TopologyRule] = {
    "three-wire": TopologyRule(("a", "b", "c"), neutral=False, between=1.0),
    "four-leg": TopologyRule(("a", "b", "c", "n"), neutral=True, phase=1.0, between=1.0),
    "split-capacitor": TopologyRule(("a", "b", "c"), neutral=True, phase=0.5, midpoint=True),
    # A current flows through the diodes only where a voltage of the machine forces it.
    "diode-neutral": TopologyRule(("a", "b", "c"), neutral=False, between=1.0, diodes=True),
    "six-leg": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=True, phase=1.0),
    # Two links of the same voltage, one behind the other.
    "six-leg-isolated": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=False, between=2.0),
}


def leg_signs(topology: Topology) -> FloatArray:
    """How the legs add up to the phase voltages, shape (3, legs): 1 for the phase's own leg, -1 for
    that on its other end.

    Args:
        topology: The topology. Without a neutral only the differences of the rows act.
    """
    legs = TOPOLOGIES[topology].legs
    signs = np.zeros((3, len(legs)))
    for row, phase in enumerate("abc"):
        for column, leg in enumerate(legs):
            signs[row, column] = {phase: 1.0, phase + "2": -1.0, "n": -1.0}.get(leg, 0.0)
    return signs
