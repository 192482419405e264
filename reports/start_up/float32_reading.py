"""The start-up on numpy's single precision, one drive: its steps, and below them the models of the
emitted control and of the emitted estimators. The compiled C equals it bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair, Reals
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.estimators import Tracker
from dqforge.optimizer.float_control.records import Control, ControlGains
from dqforge.optimizer.start_up.start_parts import Neighbours
from dqforge.optimizer.start_up.start_records import (
    Followed,
    FollowedFromRest,
    Measured,
    Startup,
    StartupSample,
    StartupSettings,
)
from dqforge.optimizer.start_up.step import StartupSteps
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq
from dqforge.reports.c_code.harness import wrap
from dqforge.reports.control.header import ControlModel, gains_of
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.steps.record_text import kind_of

if TYPE_CHECKING:
    from dqforge.optimizer.observers.parts import ObserverMethod

_ZERO: Any = np.float32(0.0)
# Members that the state of the control over the angle shares with the other one.
_SHARED = ("d", "q", "speed", "reference", "v", "omega_m", "torque", "count", "held")
Phases = tuple[Any, Any, Any]


# The members of ``<prefix>_startup_settings_t``.


@dataclass(frozen=True, slots=True)
class SettingMember:
    """One member: its name, and whether it is a whole number."""

    name: str
    whole: bool


# In the order of the C structure.
MEMBERS: tuple[SettingMember, ...] = tuple(
    SettingMember(member.name, kind_of(StartupSettings, member.name) != "float")
    for member in fields(StartupSettings)
)


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


def _array(value: Any) -> Any:
    """A number in an array of shape (1,), as the models take it."""
    return np.array([value], dtype=np.uint32 if isinstance(value, int) else np.float32)


def _scalar(value: Any) -> Any:
    """The number of an array of shape (1,)."""
    found = np.asarray(value).ravel()[0]
    return int(found) if isinstance(found, np.integer) else found


def _pair(x: Iterable[Any]) -> Pair[Any]:
    return Pair(*map(_array, x))


def _of_numbers(value: Any, of: Callable[[Any], Any]) -> Any:
    """A number, a vector or a record with a function of each of its numbers."""
    if value is None:
        return None
    if is_dataclass(value):
        names = [member.name for member in fields(value)]
        return replace(
            cast("Any", value), **{name: _of_numbers(getattr(value, name), of) for name in names}
        )
    return type(value)(*map(of, value)) if isinstance(value, tuple) else of(value)


@dataclass(slots=True)
class _Estimate(Followed):
    """The estimator at speed: what is read of it, and its state."""

    kept: Any = None


@dataclass(slots=True)
class _EstimateFromRest(FollowedFromRest):
    """The same from standstill on."""

    kept: Any = None


class _FieldOriented:
    """The field-oriented control of one drive."""

    def __init__(self, model: ControlModel) -> None:
        self.model = model

    def at_rest(self) -> Control:
        """Its state, in numbers."""
        found: Control = _of_numbers(self.model.at_rest(1), _scalar)
        return found

    def run(self, function: Any, state: Control, *arguments: Any) -> Any:
        """Duty cycles of a function of the control."""
        arrays = _of_numbers(state, _array)
        made = function(arrays, *arguments)
        _put(state, _of_numbers(arrays, _scalar))
        return made


class _OverAngle:
    """The control over the angle of one drive; what no start-up touches stays in its model."""

    def __init__(self, model: PhaseControlModel) -> None:
        self.model = model
        self.kept = model.structure.at_rest(1)

    def at_rest(self) -> Control:
        """Its state, in numbers."""
        self.kept = self.model.structure.at_rest(1)
        return self._seen()

    def reset(self) -> None:
        """The integrals of its harmonics go."""
        none = AlphaBeta(_array(_ZERO), _array(_ZERO))
        self.kept.harmonic = (none,) * len(self.kept.harmonic)

    def run(self, function: Any, state: Control, *arguments: Any) -> Any:
        """Duty cycles of a function of the control."""
        for name in _SHARED:
            setattr(self.kept, name, _of_numbers(getattr(state, name), _array))
        made = function(self.kept, *arguments)
        _put(state, self._seen())
        return made

    def _seen(self) -> Control:
        return Control(**{name: _of_numbers(getattr(self.kept, name), _scalar) for name in _SHARED})


def _put(state: Control, found: Control) -> None:
    for member in fields(Control):
        setattr(state, member.name, getattr(found, member.name))


class SingleNeighbours(Neighbours):
    """Control and estimators in single precision, as their headers have them.

    Args:
        model: What the drive is made of.
    """

    __slots__ = ("control", "model")

    def __init__(self, model: StartUpModel) -> None:
        self.model = model
        over_angle = isinstance(model.control, PhaseControlModel)
        kind: Any = _OverAngle if over_angle else _FieldOriented
        self.control: _OverAngle | _FieldOriented = kind(model.control)

    def control_start(self, o: Arithmetic, state: Control) -> None:  # noqa: ARG002
        """Everything at rest."""
        _put(state, self.control.at_rest())

    def reset_integrals(self, o: Arithmetic, state: Control) -> None:  # noqa: ARG002
        """Integrals of a control over the angle, those of its harmonics as well."""
        assert isinstance(self.control, _OverAngle)
        self.control.reset()
        state.d.integral, state.q.integral = _ZERO, _ZERO

    def current_control(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: ControlGains,  # noqa: ARG002
        state: Control,
        measured: Measured,
        reference: Dq,
    ) -> Abc:
        """Duty cycles by current references in A."""
        function = self.model.control.current_control
        made = self.control.run(function, state, _samples(measured), _pair(reference))
        return Abc(*map(_scalar, made))

    def speed_control(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: ControlGains,  # noqa: ARG002
        state: Control,
        measured: Measured,
        reference: Reals,
    ) -> Abc:
        """Duty cycles by a mechanical speed in rad/s."""
        function = self.model.control.speed_control
        made = self.control.run(function, state, _samples(measured), _array(reference))
        return Abc(*map(_scalar, made))

    def duties(
        self,
        o: Arithmetic,  # noqa: ARG002
        voltage: AlphaBeta,
        v_dc: Reals,
        i: AlphaBeta,
    ) -> Abc:
        """Duty cycles of a voltage in V and currents in A."""
        made = self.model.control.duties(_pair(voltage), _array(v_dc), _pair(i))
        return Abc(*map(_scalar, made))

    def currents(self, torque: Reals) -> Iterable[Any]:
        """Current references d and q in A of a torque in N m."""
        reference = self.model.control.reference
        assert reference is not None
        return map(_scalar, reference.currents(_array(torque)))

    def observer_start(
        self,
        o: Arithmetic,  # noqa: ARG002
        observer: Followed,
        theta_e: Reals,
        omega_e: Reals,
    ) -> None:
        """The estimator at speed begins."""
        first = wrap(_array(theta_e)), _array(omega_e)
        method = self.model.method
        if isinstance(method, Tracker):
            _follow(observer, method.start(self.model.gains, *first))
        else:
            _follow(observer, method.start(*first))

    def observer_step(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: Any,
        observer: Followed,
        v: AlphaBeta,
        i: AlphaBeta,
        *heard: Reals,
    ) -> None:
        """Its next sample, with what else it is told."""
        method, told = self.model.method, (_pair(v), _pair(i))
        assert isinstance(observer, _Estimate)
        if isinstance(method, Tracker):
            further = tuple(map(_array, heard))
            _follow(observer, method.step(gains, observer.kept, *told, further, SINGLE))
        else:
            _follow(observer, method.step(gains, observer.kept, *told, SINGLE))

    def standstill_start(
        self,
        o: Arithmetic,  # noqa: ARG002
        low: FollowedFromRest,
        theta_e: Reals,
        omega_e: Reals,
    ) -> None:
        """The estimator from standstill on begins."""
        assert self.model.low is not None
        tracker, gains = self.model.low
        _follow(low, tracker.start(gains, wrap(_array(theta_e)), _array(omega_e)))

    def standstill_step(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: Any,
        low: FollowedFromRest,
        v: AlphaBeta,
        i: AlphaBeta,
    ) -> None:
        """Its next sample."""
        assert self.model.low is not None
        assert isinstance(low, _EstimateFromRest)
        state = replace(low.kept, theta_e=_array(low.theta_e))
        tracker = self.model.low[0]
        _follow(low, tracker.step(gains, state, _pair(v), _pair(i), (), SINGLE))


def _samples(measured: Measured) -> Any:
    """Samples of an instant as the models of the control take them."""
    row = [*measured.i, measured.theta_e, measured.omega_m, measured.v_dc]
    return np.array([row], dtype=np.float32)


def _follow(read: Followed | FollowedFromRest, state: Any) -> None:
    """Take what is read of an estimator from its state."""
    assert isinstance(read, _Estimate | _EstimateFromRest)
    read.kept = state
    read.theta_e, read.omega_e = _scalar(state.theta_e), _scalar(state.omega_e)
    if isinstance(read, FollowedFromRest):
        read.added = AlphaBeta(*map(_scalar, state.added))
        read.current = AlphaBeta(*map(_scalar, state.current))


class StartUpRun:
    """One drive that starts, step by step.

    Args:
        model: What it is made of.
        settings: None for those of the model.

    Attributes:
        drive: Its memory, as ``<prefix>_startup_t``.
    """

    def __init__(self, model: StartUpModel, settings: Mapping[str, float] | None = None) -> None:
        """As ``<prefix>_startup_init``."""
        own = model.settings if settings is None else settings
        numbers: dict[str, Any] = {
            name: value if isinstance(value, int) else np.float32(value)
            for name, value in own.items()
        }
        self.settings = StartupSettings(**numbers)
        self.model, around = model, SingleNeighbours(model)
        over_angle = isinstance(model.control, PhaseControlModel)
        ratio = (
            model.control.structure.ratio
            if isinstance(model.control, PhaseControlModel)
            else model.control.ratio
        )
        self.gains = gains_of(model.control.gains, ratio)
        self.steps = StartupSteps(
            around,
            hears=model.hears,
            feedforward=model.control.structure.feedforward
            if isinstance(model.control, PhaseControlModel)
            else None,
            by_torque=over_angle and model.control.reference is None,
        )
        pair = AlphaBeta(_ZERO, _ZERO)
        low = None if model.low is None else _EstimateFromRest(pair, pair, _ZERO, _ZERO)
        estimate = _Estimate(_ZERO, _ZERO)
        self.drive = Startup.blank(around.control.at_rest(), estimate, low, _ZERO)
        self.steps.init(SINGLE, self.drive)

    def step(
        self, i: Phases, v_dc: Any, reference: Any, run: int, u: Any = _ZERO
    ) -> tuple[Phases, int]:
        """Duty cycles and whether there are gate pulses, as ``<prefix>_startup_step``; ``u`` in V
        is the mean sum of the phase voltages, for a tracker that is told it.
        """
        sample = StartupSample(Abc(*i), v_dc, u if self.model.hears else None)
        steps, drive, gains = self.steps, self.drive, (self.gains, self.settings)
        observer = self.model.gains
        with np.errstate(all="ignore"):  # what a condition leaves out may be no number
            if self.model.low is None:
                found = steps.step(SINGLE, *gains, observer, drive, sample, reference, run)
            else:
                low = self.model.low[1]
                found = steps.step_from_standstill(
                    SINGLE, *gains, observer, low, drive, sample, reference, run
                )
        return found.duty, int(found.gate)
