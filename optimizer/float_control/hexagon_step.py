"""The step of overmodulation on the voltage hexagon."""

from __future__ import annotations

from collections.abc import Callable

from dqforge.machines.modulation.registry import METHODS, on_hexagon
from dqforge.machines.names import OvermodulationName
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta, Arithmetic

# From a voltage in V and the DC-link voltage in V to the voltage that the duty cycles make.
Overmodulated = Callable[[Arithmetic, AlphaBeta, Reals], AlphaBeta]


def overmodulation_step(name: OvermodulationName) -> Overmodulated | None:
    """The step of a method; None where no voltage goes beyond the circle in the hexagon."""
    if name == "none":
        return None
    method = METHODS[name]

    def overmodulated(o: Arithmetic, voltage: AlphaBeta, v_dc: Reals) -> AlphaBeta:
        return on_hexagon(o, method, voltage, v_dc, o.clarke_inverse)

    return overmodulated
