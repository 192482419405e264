"""What a tracker is: an estimator of the position that injects a voltage, or that is told more than
voltage and current.

A position observer (`dqforge.optimizer.observers.method`) lives on the voltage that acted and the
current. A tracker may ask for a voltage of its own (saliency injection, INFORM) or be told a
further signal (the sum of the phase voltages, the voltages of the phases). Like an observer it is
written once, in the order of operations of the emitted C, and runs on numpy arrays in double
precision for analysis and in single precision as the model of the C.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair

# What a tracker may be told besides: the mean over the period that ends of v_a + v_b + v_c against
# the star point, or that of each phase voltage, in V.
Signal = Literal["sum-voltage", "voltage-a", "voltage-b", "voltage-c"]


@dataclass(frozen=True, slots=True)
class TrackerLoop:
    """The phase-locked loop of a tracker, for small errors: every ``t_s`` in s the angle is
    corrected by ``k_p`` of the measured error, and the speed by ``k_i`` in 1/s.

    ``seen`` are the measurements that count: samples ago and share. Each is the error of the
    predicted angle of that instant; with ``ahead`` that of a direction which was made then for so
    many samples later.
    """

    t_s: float
    k_p: float
    k_i: float
    seen: tuple[tuple[int, float], ...]
    ahead: float = 0.0

    @property
    def lag(self) -> float:
        """By how much it tells a changing speed too late, in s."""
        return self.k_p / self.k_i


@dataclass(frozen=True, slots=True)
class Tracker:
    """One method of tracking the position.

    Args:
        name: As in the design file; ``code`` is the part of C names, ``title`` says it in words.
        design: (design, its settings of this estimator) -> gains, a frozen dataclass of floats and
            tuples of floats; `NoSolutionError` with the number where physics forbids it.
        start: (gains, electrical angle in rad, electrical speed in rad/s) -> first state, shapes
            (N,).
        step: (gains, state, voltage that acted, current, further signals in the order of ``hears``,
            arithmetic) -> next state; with ``injects`` its ``added`` is the voltage (alpha, beta)
            in V that is to be added to the one that acts from the next sampling instant on, and its
            ``seen`` the current without what that voltage makes of it.
        gains: The dataclass that ``design`` returns.
        speeds: (design, gains) -> least and largest electrical speed in rad/s at which it holds.
        in_words: gains -> by what numbers it is tuned.
        hears: The further signals that it is told.
        injects: Whether it asks for a voltage.
        at_speed: Whether it must be started while the rotor turns, as it cannot follow from rest.
        loop: gains -> its phase-locked loop, with which a speed loop is judged; None where it has
            none.
    """

    name: str
    code: str
    title: str
    design: Callable[[Design, ObserverSettings], Any]
    start: Callable[[Any, Reals, Reals], ObserverState]
    step: Callable[[Any, Any, Pair, Pair, tuple[Reals, ...], Arithmetic], ObserverState]
    gains: type[Any]
    speeds: Callable[[Design, Any], tuple[float, float]]
    in_words: Callable[[Any], str]
    hears: tuple[Signal, ...] = ()
    injects: bool = False
    at_speed: bool = False
    loop: Callable[[Any], TrackerLoop] | None = None
