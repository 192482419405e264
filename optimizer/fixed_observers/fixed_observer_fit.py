"""The position observer of a design in integers, with its evidence."""

from __future__ import annotations

import math
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS
from dqforge.optimizer.fixed_control.arithmetic import Reach
from dqforge.optimizer.fixed_control.design import require_scales
from dqforge.optimizer.fixed_control.transforms import TurnSteps, sine_error, turn_steps
from dqforge.optimizer.fixed_observers.fixed_method import FixedMethod
from dqforge.optimizer.fixed_observers.fixed_registry import fixed_method_named
from dqforge.optimizer.fixed_observers.kit import WIDTH
from dqforge.optimizer.fixed_observers.scales import Scales
from dqforge.optimizer.fixed_observers.state_proof import observer_reaches
from dqforge.optimizer.observers.tuning import PositionObserver


@dataclass(frozen=True, slots=True)
class FixedPositionObserver:
    """What ``<prefix>_observer_q15.h`` holds: method, integers, and bits of a code of the control;
    full scales of current in A, voltage in V and mechanical speed in rad/s; angle in rad by which
    the drive turns in a period at full speed.
    """

    method: FixedMethod
    gains: Any
    width: int
    bases: tuple[float, float, float]
    turn: float

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return "q15" if self.width == 16 else "q31"


@dataclass(frozen=True, slots=True)
class FixedObserverFit:
    """A position observer in integers with its evidence.

    Args:
        observer: The integers.
        reaches: Proven range of every product and sum.
        sine_error: Largest error of sine and cosine in codes of 32 bits.
    """

    observer: FixedPositionObserver
    reaches: tuple[Reach, ...]
    sine_error: float

    @property
    def fullest(self) -> Reach:
        """The quantity that comes nearest to its word's end."""
        return max(self.reaches, key=lambda reach: reach.share)

    @property
    def sine(self) -> TurnSteps:
        """Integers of sine and cosine."""
        return turn_steps(WIDTH)

    @property
    def angle_step(self) -> float:
        """What one code of the angle is, in rad."""
        return float(2.0 * math.pi / 2**self.observer.width)

    @property
    def speed_step(self) -> float:
        """What one code of the mechanical speed is, in rad/s."""
        return float(self.observer.bases[2] / 2 ** (self.observer.width - 1))


def fit_observer(design: Design, observer: PositionObserver, width: int) -> FixedObserverFit:
    """A position observer in integers behind a control of 16 or 32 bits.

    Args:
        design: Machine and bases.
        observer: The observer that was tuned.
        width: Bits of a code of the control.

    Raises:
        InputError: The bases do not hold the largest current or speed, or the method is not there
            in integers.
        NoSolutionError: A quantity can overflow, or a gain has no format.
    """
    require_scales(design)
    method, bases = fixed_method_named(observer.method.name), design.control.bases
    scales = Scales(
        current=bases.current,
        voltage=bases.voltage,
        speed=bases.speed * design.machine.pole_pairs,
        t_s=observer.t_s,
        machine=linearised(design.machine),
    )
    gains = method.design(observer.gains, scales)
    found = FixedPositionObserver(
        method, gains, width, (bases.current, bases.voltage, bases.speed), scales.turn
    )
    return FixedObserverFit(found, observer_reaches(method, gains, width), sine_error(WIDTH))


@on_design("export.control")
def solve_fixed_observers(
    design: Design, observer: PositionObserver | None
) -> tuple[FixedObserverFit, ...]:
    """The position observer in every fixed-point format that the design asks for.

    Errors as `fit_observer`.
    """
    if observer is None:
        return ()
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    return tuple(fit_observer(design, observer, width) for width in widths)
