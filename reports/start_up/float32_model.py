"""The state machine of ``startup.h.j2`` in single precision, one drive: same operations, same bits.

It calls the models of the emitted control and of the emitted observers; what it does itself stands
in the order of the C code, a method per function. docs/methods/start-up.md has the equations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.estimators import Tracker
from dqforge.optimizer.float_control.records import Control
from dqforge.optimizer.steps.step_arithmetic import Dq
from dqforge.reports.c_code.harness import rotation, wrap
from dqforge.reports.control.header import ControlModel
from dqforge.reports.phase_control.float32_model import PhaseControlModel

if TYPE_CHECKING:
    from dqforge.optimizer.observers.parts import ObserverMethod, ObserverState
    from dqforge.optimizer.phase_control.phase_records import Control as PhaseState

F = np.float32


Vector = tuple[Any, Any]


_ZERO, _ONE, _HALF, _PI = F(0.0), F(1.0), F(0.5), F(3.1415927)


_ANGLE = (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.0117212)


class State(IntEnum):
    """As ``<prefix>_startup_state_t``."""

    IDLE = 0
    CATCH = 1
    ALIGN = 2
    SEARCH = 3
    POLARITY = 4
    RAMP = 5
    LOW = 6
    RUN = 7
    WAIT = 8
    FAULT = 9


class Fault(IntEnum):
    """As ``<prefix>_startup_fault_t``."""

    NO_FAULT = 0
    SAMPLE = 1
    OVERCURRENT = 2
    UNDERVOLTAGE = 3
    NO_HANDOVER = 4
    STALLED = 5
    LOST = 6
    NO_POLARITY = 7


RESTING = (State.IDLE, State.WAIT, State.FAULT)


def array(value: Any) -> Any:
    """A number of single precision in an array of shape (1,), as the models take it."""
    return np.array([value], dtype=np.float32)


def scalar(value: Any) -> Any:
    """The number of an array of shape (1,)."""
    return F(value[0])


def pair(x: Any, y: Any) -> Pair[Any]:
    """Two numbers as arrays of shape (1,)."""
    return Pair(array(x), array(y))


def turned_into(v: Vector, theta: Any) -> Vector:
    """A vector in coordinates turned by an angle."""
    d, q = park(SINGLE, pair(*v), rotation(array(theta)))
    return scalar(d), scalar(q)


def turned_out(v: Vector, theta: Any) -> Vector:
    """A vector of coordinates turned by an angle in stationary ones."""
    alpha, beta = park_inverse(SINGLE, pair(*v), rotation(array(theta)))
    return scalar(alpha), scalar(beta)


def wrapped(theta: Any) -> Any:
    """An angle brought into -pi to pi."""
    return scalar(wrap(array(theta)))


def towards(value: Any, target: Any, step: Any) -> Any:
    """As ``<prefix>_startup_towards``."""
    gap = target - value
    return value + step if gap > step else (value - step if gap < -step else target)


def angle_of(x: Vector) -> Any:
    """As ``<prefix>_startup_angle``."""
    along, across = abs(x[0]), abs(x[1])
    steep = across > along
    large, small = (across, along) if steep else (along, across)
    ratio = small / large if large > _ZERO else _ZERO
    square, value = ratio * ratio, F(_ANGLE[-1])
    for coefficient in _ANGLE[-2::-1]:
        value = F(coefficient) + (square * value)
    first = ratio * value
    second = F(1.5707964) - first if steep else first
    third = _PI - second if x[0] < _ZERO else second
    return -third if x[1] < _ZERO else third


@dataclass(frozen=True, slots=True)
class StartUpModel:
    """What the machine is made of: the models of control and observers, with their gains in single
    precision.

    ``method`` is the observer at speed, or the tracker of a machine of any back-EMF, which is told
    the sum of the phase voltages.
    ``settings`` are the members of ``<prefix>_startup_settings_t``; ``low`` is the estimator from
    standstill on with its gains, None without one.
    """

    control: ControlModel | PhaseControlModel
    method: ObserverMethod | Tracker
    gains: Any
    settings: Mapping[str, float]
    low: tuple[Tracker, Any] | None = None

    @property
    def hears(self) -> bool:
        """Whether the estimator at speed is told the sum of the phase voltages."""
        return isinstance(self.method, Tracker) and bool(self.method.hears)


@dataclass(slots=True)
class Drive:
    """As ``<prefix>_startup_t``; numbers of single precision. ``control`` is the state of the
    model of the control, whichever that is.
    """

    control: Any
    observer: ObserverState
    low: Any = None
    state: State = State.IDLE
    fault: Fault = Fault.NO_FAULT
    tries: int = 0
    time: int = 0
    agreed: int = 0
    late: int = 0
    slow: int = 0
    settled: int = 0
    over: int = 0
    outside: int = 0
    fading: int = 0
    pulse: int = 0
    length: int = 0
    direction: Any = _ONE
    theta_e: Any = _ZERO
    omega_e: Any = _ZERO
    step: Any = _ZERO
    current: Any = _ZERO
    turning: Any = _ZERO
    last_q: Any = _ZERO
    power: Any = _ZERO
    emf: Any = _ZERO
    reference: Any = _ZERO
    share: Any = _ZERO
    ripple: list[Any] = field(default_factory=lambda: [_ZERO, _ZERO])
    along: Vector = (_ONE, _ZERO)
    fade: Vector = (_ZERO, _ZERO)
    acted: Vector = (_ZERO, _ZERO)
    first: Vector = (_ZERO, _ZERO)

    @property
    def made(self) -> Vector:
        """The voltage that the last duty cycles make."""
        return scalar(self.control.v[0]), scalar(self.control.v[1])

    @property
    def held(self) -> Vector:
        """The currents that are added to the references."""
        return scalar(array(self.control.held[0]).ravel()), scalar(
            array(self.control.held[1]).ravel()
        )

    def hold(self, d: Any, q: Any) -> None:
        """Add currents to the references."""
        self.control.held = Dq(array(d), array(q))


class Settings:
    """Members of the settings as attributes: whole numbers as int, others in single precision."""

    def __init__(self, values: Mapping[str, float]) -> None:
        """Take the values by name."""
        for name, value in values.items():
            setattr(self, name, value if isinstance(value, int) else F(value))

    def __getattr__(self, name: str) -> Any:
        """Refuse a member that is none."""
        raise AttributeError(name)


def control_at_rest(model: StartUpModel) -> Control | PhaseState:
    """As ``<prefix>_control_start``."""
    if isinstance(model.control, PhaseControlModel):
        found = model.control.structure.at_rest(1)
        found.held = Dq(array(0.0), array(0.0))
        return found
    return model.control.at_rest(1)


def observer_start(model: StartUpModel, theta: Any, omega: Any) -> Any:
    """As the start of the observer at speed."""
    if isinstance(model.method, Tracker):
        return model.method.start(model.gains, wrap(array(theta)), array(omega))
    return model.method.start(wrap(array(theta)), array(omega))


def observer_step(
    model: StartUpModel, state: ObserverState, acted: Vector, current: Vector, u: Any
) -> Any:
    """As the step of the observer at speed."""
    v, i = pair(*acted), pair(*current)
    if isinstance(model.method, Tracker):
        return model.method.step(model.gains, state, v, i, (array(u),), SINGLE)
    return model.method.step(model.gains, state, v, i, SINGLE)


def low_start(model: StartUpModel, theta: Any, omega: Any) -> Any:
    """As the start of the estimator from standstill on."""
    if model.low is None:
        return None
    tracker, gains = model.low
    return tracker.start(gains, wrap(array(theta)), array(omega))


def first_drive(model: StartUpModel) -> Drive:
    """As ``<prefix>_startup_init``."""
    observer = observer_start(model, 0.0, 0.0)
    return Drive(control_at_rest(model), observer, low_start(model, 0.0, 0.0))


def currents_of(i: Vector) -> tuple[Any, Any, Any]:
    """Phase currents of a vector."""
    a, b, c = clarke_inverse(SINGLE, pair(*i))
    return scalar(a), scalar(b), scalar(c)


def vector_of(phases: tuple[Any, Any, Any]) -> Vector:
    """The vector of phase currents."""
    alpha, beta = clarke(SINGLE, Triple(*(array(x) for x in phases)))
    return scalar(alpha), scalar(beta)


def enter(drive: Drive, state: State) -> None:
    """As ``<prefix>_startup_enter``."""
    drive.state = state
    drive.time = drive.agreed = drive.late = drive.slow = 0
    drive.settled = drive.over = drive.outside = 0


def off(model: StartUpModel, drive: Drive, state: State) -> None:
    """As ``<prefix>_startup_off``."""
    drive.control = control_at_rest(model)
    drive.acted = drive.made
    drive.fading = 0
    drive.omega_e = drive.reference = _ZERO
    enter(drive, state)


def trip(model: StartUpModel, s: Any, drive: Drive, fault: Fault) -> None:
    """As ``<prefix>_startup_trip``."""
    drive.fault = fault
    again = fault >= Fault.NO_HANDOVER and drive.tries <= s.retries
    off(model, drive, State.WAIT if again else State.FAULT)


def fade(drive: Drive) -> None:
    """As ``<prefix>_startup_fade``."""
    if drive.fading > 0:
        drive.fading -= 1
        held = drive.held
        if drive.fading > 0:
            drive.hold(held[0] - drive.fade[0], held[1] - drive.fade[1])
        else:
            drive.hold(_ZERO, _ZERO)


def restarted(state: ObserverState, theta: Any) -> ObserverState:
    """An estimate with another angle."""
    return replace(state, theta_e=array(theta))
