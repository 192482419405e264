"""Inductance mapping as a tracker: INFORM, with a table of where the axis of the saliency lies
under load.

Paper 001's (7.21) of one phase has no solution where the inductance is largest or least, and two
elsewhere; of three phases it is the sum that INFORM takes.
"""

from __future__ import annotations

from dqforge.optimizer.saliency.inform import pulse_tracker

TRACKER = pulse_tracker(
    "inductance-mapping",
    "inductance mapping: pairs of voltage pulses, with the axis of the flux map",
    mapped=True,
)
