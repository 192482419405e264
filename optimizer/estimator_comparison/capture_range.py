"""From which wrong starts a position observer locks: angle and speed of its start off by so much,
on the exact machine at a constant speed.

Every cell of the map is a run of the emitted step, all of them at once. Currents and voltages are
those of the steady drive, so that what a run shows is the observer's own way to the truth, as after
a hand-over or a flying start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.losses.machine_budget import COPPER_COEFFICIENT
from dqforge.machines.plants.drive_motion import Plants, plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.conditions import loads_at, lost_voltage
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT
from dqforge.optimizer.observers.parts import Load, ObserverMethod, steady_observer
from dqforge.optimizer.observers.tuning import SHOWN, PositionObserver
from dqforge.optimizer.step_arithmetic import EXACT

CAPTURE_SHARES = (0.1, 0.25, 0.5, 1.0)  # Speeds of the map over the largest one.

# Errors of the angle at the start in rad, estimate minus truth.
START_ANGLES = np.radians(np.arange(-180.0, 181.0, 15.0))

# Errors of the speed at the start over the speed: -1 starts from rest, -2 the wrong way round.
START_SPEEDS = np.array([-2.0, -1.5, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0])

# What became of a start: never at rest, at the rotor, or half a turn off.
LOST, LOCKED, HALF_TURN = 0, 1, 2
_TIME_CONSTANTS = 15.0
_SHORTEST, _LONGEST = 400, 4000  # samples
_WATCHED = 0.25  # share of a run, its end, that decides


@dataclass(frozen=True, slots=True, eq=False)
class CaptureMap:
    """What becomes of starts.

    Args:
        omega: Electrical speeds in rad/s, shape (S,).
        angles: Errors of the angle at the start in rad, estimate minus truth, shape (A,).
        speeds: Errors of the speed at the start, over the speed, shape (V,).
        outcome: `LOST`, `LOCKED` or `HALF_TURN`, shape (S, V, A).
        lock_time: Time in s after which the errors stay within the limits, shape (S, V, A); inf of
            starts that do not lock.
        duration: Length of a run in s.
    """

    omega: FloatArray
    angles: FloatArray
    speeds: FloatArray
    outcome: NDArray[np.int8]
    lock_time: FloatArray
    duration: float

    @property
    def share(self) -> FloatArray:
        """Share of the starts that lock, over the speeds, shape (S,).

        The angle of -180 degrees, which is that of 180, does not count twice.
        """
        return np.asarray(np.mean(self.outcome[:, :, 1:] == LOCKED, axis=(1, 2)))

    def angle_range(self, start_speed: float = 0.0) -> FloatArray:
        """Largest error of the angle to both sides in rad from which every start locks, shape
        (S, 2); nan where not even the true angle does.

        Args:
            start_speed: One of ``speeds``.
        """
        row = int(np.argmin(np.abs(self.speeds - start_speed)))
        middle = int(np.argmin(np.abs(self.angles)))
        locked = self.outcome[:, row] == LOCKED
        found = np.full((len(self.omega), 2), np.nan)
        for k, line in enumerate(locked):
            if line[middle]:
                below, above = np.flatnonzero(~line[:middle]), np.flatnonzero(~line[middle:])
                low = int(below[-1]) + 1 if below.size else 0
                high = middle + int(above[0]) - 1 if above.size else len(line) - 1
                found[k] = self.angles[low], self.angles[high]
        return found


def _samples(
    method: ObserverMethod, gains: Any, t_s: float, machine: LinearMachine, starts: _Starts
) -> int:
    """How many samples the slowest pole wants, within what a map may take."""
    speeds = np.unique(starts.omega)
    current = np.full(len(speeds), starts.current)
    found = steady_observer(method, gains, t_s, plants(machine, count=len(speeds)), current, speeds)
    radius = np.abs(found.poles[:, 0])
    slow = radius[found.found & (radius < 1.0)]
    if not slow.size:
        return _LONGEST
    wanted = -_TIME_CONSTANTS / np.log(min(float(np.max(slow)), 1.0 - 1e-9))
    return int(np.clip(np.ceil(wanted), _SHORTEST, _LONGEST))


@dataclass(frozen=True, slots=True, eq=False)
class _Starts:
    """N starts: electrical speed in rad/s, errors of angle and speed; one current in A."""

    omega: FloatArray
    angle: FloatArray
    speed: FloatArray
    current: complex


def _last_outside(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    machine: LinearMachine,
    starts: _Starts,
    samples: int,
) -> NDArray[np.int64]:
    """Index of the last sample at which each start was outside the limits around the rotor, and
    around half a turn from it, shape (2, N).
    """
    omega = starts.omega
    voltage = steady_voltage(
        plants(machine, count=len(omega)), np.full(len(omega), starts.current), omega, t_s
    )
    state = method.start(np.asarray(EXACT.wrap(starts.angle)), omega * (1.0 + starts.speed))
    last = np.zeros((2, len(omega)), dtype=np.int64)
    with np.errstate(all="ignore"):  # a start that is lost may run away
        for k in range(samples):
            theta = EXACT.wrap(omega * t_s * k)
            turn = np.exp(1j * theta)
            v, i = voltage * turn, starts.current * turn
            state = method.step(gains, state, (v.real, v.imag), (i.real, i.imag), EXACT)
            error = EXACT.wrap(np.asarray(state.theta_e) - theta)
            slow = np.abs(state.omega_e - omega) <= SPEED_LIMIT * np.abs(omega)
            near = np.abs(error)
            last[0, ~(slow & (near <= ANGLE_LIMIT))] = k
            last[1, ~(slow & (near >= np.pi - ANGLE_LIMIT))] = k
    return last


def capture_map(
    observer: PositionObserver,
    i_dq: complex,
    omega: FloatArray | None = None,
    angles: FloatArray = START_ANGLES,
    speeds: FloatArray = START_SPEEDS,
) -> CaptureMap:
    """Which starts lock.

    Args:
        observer: The observer, on its own machine.
        i_dq: Current i_d + j i_q of the drive in A.
        omega: Electrical speeds in rad/s, positive, shape (S,); None for shares of the largest one.
        angles, speeds: Errors at the start, as in `CaptureMap`.
    """
    method, gains, t_s, machine = observer.method, observer.gains, observer.t_s, observer.machine
    at = np.array(CAPTURE_SHARES) * observer.omega_max if omega is None else omega
    mesh = np.meshgrid(at, speeds, angles, indexing="ij")
    starts = _Starts(mesh[0].ravel(), mesh[2].ravel(), mesh[1].ravel(), i_dq)
    samples = _samples(method, gains, t_s, machine, starts)
    last = _last_outside(method, gains, t_s, machine, starts, samples)
    rest = last < (1.0 - _WATCHED) * samples
    outcome = np.where(rest[0], LOCKED, np.where(rest[1], HALF_TURN, LOST)).astype(np.int8)
    times = np.where(rest[0], (last[0] + 1) * t_s, np.inf)
    shape = mesh[0].shape
    return CaptureMap(
        at, angles, speeds, outcome.reshape(shape), times.reshape(shape), samples * t_s
    )


# Steady errors of a position observer on the machine as it becomes in operation: its copper and
# its magnets warmer than the constants of the firmware.
#
# R grows with the temperature of the copper and psi falls with that of the magnets, both at once
# and each by its own coefficient; the magnets are taken to warm up half as much as the winding.
# Where the design gives operating temperatures, the firmware's constants hold there, and the
# machine that has just been switched on is the one that differs: it is shown beside the warmer
# ones.

LOAD_SHARES = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Torques over the largest one at which errors are shown.

# Relative change of the magnet flux linkage per K where the design gives none: NdFeB.
MAGNET_COEFFICIENT = -0.11e-2
_RISES = (0.0, 40.0, 80.0)
_MAGNET_SHARE = 0.5  # of the rise of the winding
_REFERENCE = 20.0  # degC of constants without a temperature


@dataclass(frozen=True, slots=True)
class WarmState:
    """Rises in K above the temperatures at which the firmware's constants hold, and what they make.

    ``r_s`` and ``psi_pm`` are relative changes of resistance and magnet flux linkage.
    """

    winding: float
    magnet: float
    r_s: float
    psi_pm: float


@dataclass(frozen=True, slots=True, eq=False)
class WarmErrors:
    """Steady errors of an observer, estimate minus truth, inf where the angle is lost.

    Args:
        states: T states of the machine, by rising temperature.
        shares: Torques over the largest one, shape (L,).
        omega: Electrical speeds in rad/s, shape (S,).
        angle, speed: In rad and rad/s by temperature alone, shape (T, L, S).
        angle_with_dead_time, speed_with_dead_time: The same with the dead time that the design
            leaves besides.
    """

    states: tuple[WarmState, ...]
    shares: FloatArray
    omega: FloatArray
    angle: FloatArray
    speed: FloatArray
    angle_with_dead_time: FloatArray
    speed_with_dead_time: FloatArray

    @property
    def shown(self) -> tuple[int, ...]:
        """Indices of the states that a table shows: the cold one where there is one, and the
        hottest.
        """
        cold = (0,) if self.states[0].winding < 0.0 or self.states[0].magnet < 0.0 else ()
        return (*cold, len(self.states) - 1)


def _given(design: Design, key: str, default: float) -> float:
    """A value of the section machine.temperature in SI units (degC), or its default."""
    path = f"machine.temperature.{key}"
    return next((value.si for value in design.values if value.path == path), default)


def warm_states(design: Design) -> tuple[WarmState, ...]:
    """States of the machine from the constants of the firmware up, and the cold one where these
    hold at operating temperatures.
    """
    reference = _given(design, "winding_reference", _REFERENCE)
    winding = _given(design, "winding", reference)
    cold_magnet = _given(design, "magnet_reference", _REFERENCE)
    magnet = _given(design, "magnet", cold_magnet)
    copper = _given(design, "copper_coefficient", COPPER_COEFFICIENT)
    remanence = _given(design, "magnet_coefficient", MAGNET_COEFFICIENT)
    rises = [(rise, _MAGNET_SHARE * rise) for rise in _RISES]
    if (winding, magnet) != (reference, cold_magnet):
        rises.insert(0, (reference - winding, cold_magnet - magnet))
    scale = 1.0 + copper * (winding - reference), 1.0 + remanence * (magnet - cold_magnet)
    # Adding zero turns -0 into 0.
    return tuple(
        WarmState(w, m, copper * w / scale[0] + 0.0, remanence * m / scale[1] + 0.0)
        for w, m in rises
    )


def _plants(design: Design, loads: tuple[Load, ...], states: tuple[WarmState, ...]) -> FloatArray:
    """Rows (R, L_d, L_q, psi) of the true machines, shape (T, L, 4)."""
    linear = linearised(design.machine)
    rows = [
        [
            # Of a saturated machine the magnets' share alone follows their temperature.
            (
                linear.r_s * (1.0 + state.r_s),
                load.l_d,
                load.l_q,
                load.psi_pm + state.psi_pm * linear.psi_pm,
            )
            for load in loads
        ]
        for state in states
    ]
    return np.array(rows)


def warm_errors(
    design: Design, observer: PositionObserver, omega: FloatArray | None = None
) -> WarmErrors:
    """Steady errors over temperature, load and speed.

    Args:
        design: The drive.
        observer: Its position observer.
        omega: Electrical speeds in rad/s, positive, shape (S,); None for those of the tables.
    """
    speeds = np.array(SHOWN) * observer.omega_max if omega is None else omega
    states, loads = warm_states(design), loads_at(design, LOAD_SHARES)
    rows = _plants(design, loads, states)
    shape = (len(states), len(loads), len(speeds))
    spread = np.broadcast_to(rows[:, :, None, :], (*shape, 4)).reshape(-1, 4)
    current = np.array([complex(load.i_d, load.i_q) for load in loads])
    currents = np.broadcast_to(current[None, :, None], shape).ravel()
    every = np.broadcast_to(speeds, shape).ravel()

    def errors(lost: float) -> tuple[FloatArray, FloatArray]:
        found = steady_observer(
            observer.method,
            observer.gains,
            observer.t_s,
            Plants(*spread.T),
            currents,
            every,
            0.0,
            lost,
        )
        holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)
        angle, speed = (
            np.where(holds, part, np.inf).reshape(shape)
            for part in (found.theta_error, found.omega_error)
        )
        return angle, speed

    plain, dead = errors(0.0), errors(lost_voltage(design)[1])
    return WarmErrors(states, np.array(LOAD_SHARES), speeds, *plain, *dead)


# What is computed of a design's position observer when it is tuned: warm machines and starts.

_LOAD = 0.5  # torque of the capture map over the largest one


@dataclass(frozen=True, slots=True, eq=False)
class ObserverEvidence:
    """Steady errors on warm machines, and the starts from which the observer locks."""

    warm: WarmErrors
    capture: CaptureMap


def capture_of(design: Design, observer: PositionObserver) -> CaptureMap:
    """Starts from which an observer locks at half the largest torque.

    Args:
        design: The drive.
        observer: The observer.
    """
    load = loads_at(design, (_LOAD,))[0]
    return capture_map(observer, complex(load.i_d, load.i_q))


def observer_evidence(design: Design, observer: PositionObserver | None) -> ObserverEvidence | None:
    """Both of the design's own observer, None where it has none.

    Args:
        design: The drive.
        observer: As `solve_gains` tuned it.
    """
    if observer is None:
        return None
    return ObserverEvidence(warm_errors(design, observer), capture_of(design, observer))
