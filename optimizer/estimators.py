"""Estimators of the position that need more than voltage and current, or ask for a voltage of
their own, under one record: which of them a design asks for, what each says of itself, and all by
their names.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Protocol

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import TRACKER_NAMES, LoadedByName
from dqforge.machines.plants.scenario import ComplexArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import StateMembers
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Pair

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


class TrackerState(Protocol):
    """Angle in rad and speed in rad/s (electrical) of N trackers."""

    @property
    def theta_e(self) -> Reals:
        """Wrapped, shape (N,)."""
        ...

    @property
    def omega_e(self) -> Reals:
        """Shape (N,)."""
        ...


@dataclass(frozen=True, slots=True)
class TrackerSteps:
    """What the firmware runs of a tracker whose state is a record of its own.

    Args:
        state: The members of the state, for their names and types.
        start: (arithmetic, state, electrical angle in rad, electrical speed in rad/s).
        step: (arithmetic, gains, state, voltage that acted, current).
        names: What functions that these call are named in C.
        counts: Macros: name without prefix, value, what it is.
    """

    state: Any
    start: Callable[..., None]
    step: Callable[..., None]
    names: dict[str, str]
    counts: tuple[tuple[str, int, str], ...]


# For states that begin at angles which are wrapped already.
WRAPPED = Arithmetic(np.float64, lambda theta: theta, EXACT.rotation)


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
            ``current`` the current without what that voltage makes of it.
        gains: The dataclass that ``design`` returns.
        speeds: (design, gains) -> least and largest electrical speed in rad/s at which it holds.
        in_words: gains -> by what numbers it is tuned.
        hears: The further signals that it is told.
        injects: Whether it asks for a voltage.
        at_speed: Whether it must be started while the rotor turns, as it cannot follow from rest.
        loop: gains -> its phase-locked loop, with which a speed loop is judged; None where it has
            none.
        members: What the firmware calls vectors and scalars of the state: the C of the tracker is
            written from ``step``. None of one that has ``steps``.
        steps: gains -> what is emitted of one whose state is a record of its own.
    """

    name: str
    code: str
    title: str
    design: Callable[[Design, ObserverSettings], Any]
    start: Callable[[Any, Reals, Reals], TrackerState]
    step: Callable[[Any, Any, Pair, Pair, tuple[Reals, ...], Arithmetic], TrackerState]
    gains: type[Any]
    speeds: Callable[[Design, Any], tuple[float, float]]
    in_words: Callable[[Any], str]
    hears: tuple[Signal, ...] = ()
    injects: bool = False
    at_speed: bool = False
    loop: Callable[[Any], TrackerLoop] | None = None
    members: StateMembers | None = None
    steps: Callable[[Any], TrackerSteps] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class TunedTracker:
    """A tracker with its gains for the firmware.

    ``t_s`` is the sampling period in s; it holds from ``omega_low`` to ``omega_high`` in rad/s
    (electrical) of a drive that turns with up to ``omega_max``.
    """

    tracker: Tracker
    gains: Any
    t_s: float
    omega_low: float
    omega_high: float
    omega_max: float

    @property
    def loop(self) -> TrackerLoop | None:
        """Its phase-locked loop, None where it states none."""
        return None if self.tracker.loop is None else self.tracker.loop(self.gains)


def tune_tracker(design: Design, settings: ObserverSettings) -> TunedTracker:
    """A tracker of a design by the settings of one of its estimators.

    Raises:
        InputError: Its control functions are in integers, which no tracker is.
        NoSolutionError: Physics forbids it; the message has the number.
    """
    tracker = TRACKERS[settings.method]
    for name in design.export.control:
        if name != "float32":
            raise InputError(
                f"export.control: {name} has no {tracker.name} in integers; write float32, or "
                "another control.observer.method"
            )
    machine, control = design.machine, design.control
    omega_m = machine.omega_m_max if machine.omega_m_max is not None else control.bases.speed
    gains = tracker.design(design, settings)
    low, high = tracker.speeds(design, gains)
    if not high > low:
        raise NoSolutionError(
            f"control.observer: {tracker.name} serves at no speed: it would hold from {low:.4g} to "
            f"{high:.4g} rad/s (electrical)"
        )
    return TunedTracker(tracker, gains, control.t_s, low, high, omega_m * machine.pole_pairs)


def solve_tracker(design: Design) -> TunedTracker | None:
    """The tracker that ``control.observer`` names, None where it names an observer or there is
    none.

    Errors as `tune_tracker`.
    """
    wanted = design.control.observer
    if wanted is None or wanted.method not in TRACKER_NAMES:
        return None
    return tune_tracker(design, wanted)


# What a tracker is: an estimator of the position that injects a voltage, or that is told more than
# voltage and current.
#
# A position observer (`dqforge.optimizer.observers.parts`) lives on the voltage that acted and the
# current. A tracker may ask for a voltage of its own (saliency injection, INFORM) or be told a
# further signal (the sum of the phase voltages, the voltages of the phases). Like an observer it
# is written once, in the order of operations of the emitted C, and runs on numpy arrays in double
# precision for analysis and in single precision as the model of the C.

# A tracker as columns of the state of a drive, seen from its true rotor: its phase-locked loop
# with the age of what it measures, without the currents that it injects.


@dataclass(frozen=True, slots=True)
class TrackerEstimator:
    """A `TrackerLoop`: the angles whose errors it measures, from the latest to the oldest, angle
    error and electrical speed are its columns.

    A voltage that is asked for at a sample acts in the period after the next instant; the rotor
    turns meanwhile, up to the middle of that period (``ahead`` samples). The other measurements
    belong to the instant at which they were made.
    """

    loop: TrackerLoop

    @property
    def _oldest(self) -> int:
        return max(age for age, _ in self.loop.seen)

    def start(
        self,
        i: ComplexArray,  # noqa: ARG002
        v: ComplexArray,  # noqa: ARG002
        omega: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Columns of the steady state, which has no error, and their sizes."""
        turn = omega * self.loop.t_s
        columns = np.zeros((len(omega), self._oldest + 2))
        columns[:, -2], columns[:, -1] = -turn, omega
        # a direction asked for one sample ago still has half a period or more to go
        for age in range(1, self._oldest + 1):
            columns[:, age - 1] = max(self.loop.ahead - age, 0.0) * turn
        size = np.ones_like(columns)
        size[:, -1] = np.maximum(np.abs(omega), 1.0)
        return columns, size

    def step(
        self,
        columns: FloatArray,
        v: ComplexArray,  # noqa: ARG002
        i: ComplexArray,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Correct by the mean of the errors that are seen now."""
        loop, ahead = self.loop, columns[:, -2] + self.loop.t_s * columns[:, -1]
        error = np.zeros(len(columns))
        for age, share in loop.seen:
            error = error - share * (ahead if age == 0 else columns[:, age - 1])
        omega = columns[:, -1] + loop.k_i * error
        delta = ahead + loop.k_p * error
        now = delta + loop.ahead * loop.t_s * omega if loop.ahead > 0.0 else ahead
        kept = [now, *columns[:, : self._oldest - 1].T][: self._oldest]
        return np.stack([*kept, delta, omega], axis=1), delta, omega

    def turned(self, columns: FloatArray, turn: FloatArray) -> FloatArray:
        """The columns seen from the rotor one period later."""
        found = columns.copy()
        found[:, -2] -= turn
        for age in range(1, self._oldest + 1):
            # a direction leaves the rotor behind until the middle of the period in which it acts
            part = min(max(self.loop.ahead - (age - 1), 0.0), 1.0)
            found[:, age - 1] -= part * turn
        return found


# The trackers by name; a line per method, whose module holds its record ``TRACKER``.

# The trackers by name.
TRACKERS: LoadedByName[str, Tracker] = LoadedByName(
    {
        "injection": "dqforge.optimizer.saliency.injection:TRACKER",
        "inform": "dqforge.optimizer.saliency.inform:TRACKER",
        "inductance-mapping": "dqforge.optimizer.saliency.inductance_mapping:TRACKER",
        "third-harmonic": "dqforge.optimizer.harmonic_trackers:TRACKER",
    }
)
