"""The topologies of paper 002, chapter 5: their legs, and what becomes of the zero sequence.

A phase voltage is that of the phase's leg less what its other end is tied to: the mean of the legs
(no neutral), the neutral's leg, the phase's second leg, or the midpoint of the link.
"""

from __future__ import annotations

from dataclasses import dataclass

from dqforge.machines.names import Topology


@dataclass(frozen=True, slots=True)
class TopologyRule:
    """How the phases are fed.

    Parameters
    ----------
    legs:
        Names of the half bridges, in the order of their duty cycles; ``a2`` is the second one of
        phase a.
    neutral:
        Whether the legs drive a zero-sequence current.
    midpoint:
        Whether the neutral lies on the midpoint of the link, whose voltage moves with its current.
    """

    legs: tuple[str, ...]
    neutral: bool
    midpoint: bool = False


TOPOLOGIES: dict[Topology, TopologyRule] = {
    "three-wire": TopologyRule(("a", "b", "c"), neutral=False),
    "four-leg": TopologyRule(("a", "b", "c", "n"), neutral=True),
    "split-capacitor": TopologyRule(("a", "b", "c"), neutral=True, midpoint=True),
    # A current flows through the diodes only where a voltage of the machine forces it.
    "diode-neutral": TopologyRule(("a", "b", "c"), neutral=False),
    "six-leg": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=True),
    "six-leg-isolated": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=False),
}
