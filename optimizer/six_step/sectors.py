"""The six sectors of block commutation: which phase is fed, which returns, which floats.

In sector s the current vector lies at -30 + 60 s electrical degrees. Turning forwards it is fed
while the d axis lies 120 to 60 degrees behind it, turning backwards 60 to 120 degrees ahead of it.
"""

from __future__ import annotations

import numpy as np

FED = (0, 0, 1, 1, 2, 2)  # Phase (0, 1, 2 for a, b, c) whose leg switches, by sector.
RETURN = (1, 2, 2, 0, 0, 1)  # Phase that returns the current, by sector.
FLOATING = (2, 1, 0, 2, 1, 0)  # Phase whose leg rests, by sector.
SECTOR = np.pi / 3.0


def middle(sector: int, direction: int) -> float:
    """Electrical angle in rad of the d axis in the middle of a sector, where the back-EMF of the
    phase that floats is zero for waveforms without even harmonics.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return -np.pi / 6.0 + SECTOR * sector - direction * np.pi / 2.0


def kept_fed(sector: int, direction: int) -> bool:
    """Whether the phase that carried the current before the sector began is the one that is fed;
    else it is the one that returns it.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return (sector % 2 == 1) == (direction > 0)


def rising(sector: int, direction: int) -> int:
    """Sign by which the voltage of the floating phase against the star of the terminals rises
    through zero over time in a sector: 1 or -1.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return direction if sector % 2 == 1 else -direction
