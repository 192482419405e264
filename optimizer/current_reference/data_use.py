"""Where a current reference depends on the ends of a flux map: held on the edge of its data,
or beyond them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

_GRID = 801
_NARROWINGS = 3
_ALL_OF_IT = 1e-3  # Share of the domain below which a range is said to begin at zero torque.


@dataclass(frozen=True, slots=True)
class DataUse:
    """Ranges of the torque in N m, from and to; None where there is none.

    ``held``: the data of the flux map hold the currents on their edge, and better ones may lie
    beyond. ``extrapolated``: the currents lie beyond the data, which the design permits.
    """

    held: tuple[float, float] | None = None
    extrapolated: tuple[float, float] | None = None


COVERED = DataUse()  # Of references whose currents all lie well inside the data, or need none.


def data_use(choice: CurrentChoice, end: float) -> DataUse:
    """What the currents of a choice owe to the ends of its data, for torques from 0 to ``end`` N
    m.
    """

    def held(torque: FloatArray) -> NDArray[np.bool_]:
        return choice.held(torque)

    def beyond(torque: FloatArray) -> NDArray[np.bool_]:
        return ~choice.machine.known(*choice.currents(torque))

    if choice.region is not None:
        return DataUse(held=_range(held, end))
    return DataUse(extrapolated=_range(beyond, end))


def _range(
    holds: Callable[[FloatArray], NDArray[np.bool_]], end: float
) -> tuple[float, float] | None:
    """First and last torque in N m at which a property holds, the ends narrowed
    far below what is printed.
    """
    torque = np.linspace(0.0, end, _GRID)
    # At zero torque no current flows, which is not held by anything.
    true = np.flatnonzero(holds(torque[1:])) + 1
    if true.size == 0:
        return None
    low, high = torque[true[0] - 1], torque[true[0]]
    for _ in range(_NARROWINGS):
        finer = np.linspace(low, high, 65)
        first = max(int(np.argmax(holds(finer[1:]))) + 1, 1)
        low, high = finer[first - 1], finer[first]
    last = torque[true[-1]]
    return (0.0 if high < _ALL_OF_IT * end else float(high)), float(last)
