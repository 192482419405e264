"""How good a position observer is: errors of angle and speed over the speed,
and the range that follows.

Judged are steady states (`dqforge.optimizer.observers.parts`) at the loads of the drive,
with the machine as it is there: exact data, each parameter wrong to both sides, the voltage that a
dead time costs, noise, and an acceleration.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import ComplexArray, Plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.parts import (
    LARGEST_TURN,
    Disturbances,
    Load,
    ObserverMethod,
    steady_observer,
)

# Largest r.m.s. error of the angle in rad at which an observer counts as holding: 1.5 % of the
# torque.
ANGLE_LIMIT = np.radians(10.0)

# Largest r.m.s. of the steady speed error, over the speed, at which an observer counts as holding.
SPEED_LIMIT = 0.05
PARAMETERS = ("r_s", "l_d", "l_q", "psi_pm")
DEAD_TIME, EXACT_DATA = "dead_time", "exact_data"
_SPEEDS = 60


@dataclass(frozen=True, slots=True, eq=False)
class ObserverJudgement:
    """Errors of an observer over S electrical speeds in rad/s, ascending.

    Arrays of shape (S,), angles in rad.

    ``bias`` maps a cause to the steady angle error, estimate minus truth, inf where the angle is
    lost or not held stably: a parameter that is off by its tolerance to the worse side, the dead
    time, or exact data (what sampling and saturation leave). ``speed_bias`` likewise in rad/s,
    ``speed_total`` the root of the sum of its squares. ``lag`` is the angle error that the
    acceleration adds, ``noise`` the standard deviation of the angle, ``steady`` the root of the
    squares of bias and noise, ``total`` with the lag (both inf where unstable); ``poles`` (S, n) in
    the z plane, largest first. Of the loads that counts at each speed which is worst for the angle
    (``load``, its index), and for the speed.

    ``omega_low`` and ``omega_high`` in rad/s bound the speeds at which ``total`` stays below 10
    degrees and ``speed_total`` below 5 % of the speed, ``steady_low`` and ``steady_high`` those
    without acceleration; nan where they never do.
    """

    omega: FloatArray
    bias: dict[str, FloatArray]
    speed_bias: dict[str, FloatArray]
    speed_total: FloatArray
    lag: FloatArray
    noise: FloatArray
    steady: FloatArray
    total: FloatArray
    load: FloatArray
    poles: ComplexArray
    omega_low: float
    omega_high: float
    steady_low: float
    steady_high: float

    @property
    def radius(self) -> FloatArray:
        """Largest modulus of a pole, shape (S,)."""
        return np.abs(self.poles[:, 0])


@dataclass(frozen=True, slots=True)
class _Case:
    """One cause at one load: relative errors of the machine, voltage lost in V,
    acceleration in rad/s^2.
    """

    name: str
    load: int
    errors: dict[str, float]
    lost: float = 0.0
    acceleration: float = 0.0


def _cases(disturbances: Disturbances, count: int) -> list[_Case]:
    """All causes at all loads, block by block.

    The acceleration at the first load alone, last of all.
    """
    found: list[_Case] = []
    for k in range(count):
        found.append(_Case(EXACT_DATA, k, {}))
        for name in PARAMETERS:
            found += [
                _Case(name, k, {name: error}) for error in reversed(disturbances.limits(name))
            ]
        if (disturbances.lost_least, disturbances.lost) != (0.0, 0.0):
            found += [
                _Case(DEAD_TIME, k, {}, lost)
                for lost in (disturbances.lost, disturbances.lost_least)
            ]
    return [*found, _Case("lag", 0, {}, 0.0, disturbances.acceleration)]


def _plants(
    machine: LinearMachine, loads: tuple[Load, ...], cases: list[_Case], count: int
) -> Plants:
    """The true machines, ``count`` of each case."""
    rows = []
    for case in cases:
        load = loads[case.load]
        true = {"r_s": machine.r_s, "l_d": load.l_d, "l_q": load.l_q, "psi_pm": load.psi_pm}
        rows.append([true[name] * (1.0 + case.errors.get(name, 0.0)) for name in PARAMETERS])
    return Plants(*np.repeat(np.array(rows), count, axis=0).T)


def _worse(high: FloatArray, low: FloatArray) -> FloatArray:
    return np.where(np.abs(high) >= np.abs(low), high, low)


def _added(value: FloatArray, base: FloatArray) -> FloatArray:
    """What a cause adds to the error with exact data; inf where either is lost."""
    with np.errstate(invalid="ignore"):
        gap = value - base
    return np.where(np.isfinite(gap), gap, np.inf)


def _root(parts: list[FloatArray]) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)), dtype=np.float64)


def judge_at(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    machine: LinearMachine,
    disturbances: Disturbances,
    omega: FloatArray,
) -> ObserverJudgement:
    """Judge an observer at electrical speeds in rad/s, ascending, shape (S,)."""
    return _worst(omega, *judge_loads(method, gains, t_s, machine, disturbances, omega))


def judge_loads(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    machine: LinearMachine,
    disturbances: Disturbances,
    omega: FloatArray,
) -> tuple[list[LoadJudgement], FloatArray]:
    """The same at each load, and the lag at the first one in rad, shape (S,)."""
    loads = disturbances.loads or (Load.on(machine, disturbances.i_load),)
    count, cases = len(omega), _cases(disturbances, len(loads))

    def repeated(values: list[Any]) -> Any:
        return np.repeat(np.array(values), count)

    found = steady_observer(
        method,
        gains,
        t_s,
        _plants(machine, loads, cases, count),
        repeated([complex(loads[case.load].i_d, loads[case.load].i_q) for case in cases]),
        np.tile(omega, len(cases)),
        repeated([case.acceleration for case in cases]),
        repeated([case.lost for case in cases]),
    )
    shape = (len(cases), count)
    poles = found.poles.reshape(*shape, -1)
    holds = found.found.reshape(shape) & (
        np.abs(poles[..., 0]) < 1.0
    )  # nobody stays at an unstable rest
    theta = np.where(holds, found.theta_error.reshape(shape), np.inf)
    speed = np.where(holds, found.omega_error.reshape(shape), np.inf)
    noise = found.angle_noise(disturbances.i_noise, disturbances.v_noise).reshape(shape)
    per_load = (len(cases) - 1) // len(loads)
    lag = _added(theta[-1], np.where(np.isfinite(theta[0]), theta[0], 0.0))
    names = [case.name for case in cases[:per_load]]
    blocks = [slice(k * per_load, (k + 1) * per_load) for k in range(len(loads))]
    judged = [
        _at_load(names, theta[rows], speed[rows], noise[rows], poles[rows]) for rows in blocks
    ]
    return judged, lag


@dataclass(frozen=True, slots=True, eq=False)
class LoadJudgement:
    """Errors at one load; as in `ObserverJudgement`."""

    bias: dict[str, FloatArray]
    speed_bias: dict[str, FloatArray]
    noise: FloatArray
    steady: FloatArray
    speed_total: FloatArray
    poles: ComplexArray


def _at_load(
    names: list[str], theta: FloatArray, speed: FloatArray, noise: FloatArray, poles: ComplexArray
) -> LoadJudgement:
    """Rows: exact data, then pairs of each cause to either side."""

    def causes(rows: FloatArray) -> dict[str, FloatArray]:
        found = {EXACT_DATA: rows[0]}
        for k in range(1, len(names), 2):
            found[names[k]] = _worse(_added(rows[k], rows[0]), _added(rows[k + 1], rows[0]))
        return found

    bias, speed_bias = causes(theta), causes(speed)
    steady = _root([noise[0], *bias.values()])
    return LoadJudgement(
        bias, speed_bias, noise[0], steady, _root(list(speed_bias.values())), poles[0]
    )


def _worst(omega: FloatArray, judged: list[LoadJudgement], lag: FloatArray) -> ObserverJudgement:
    """The worst load at each speed."""
    angle = np.argmax([part.steady for part in judged], axis=0)
    slip = np.argmax([part.speed_total for part in judged], axis=0)

    def at(values: list[Any], index: Any) -> Any:
        return np.stack(values)[index, np.arange(len(omega))]

    steady, speed_total = (
        at([part.steady for part in judged], angle),
        at([part.speed_total for part in judged], slip),
    )
    total = _root([steady, lag])
    kept = speed_total <= SPEED_LIMIT * omega
    low, high = _range(omega, (total <= ANGLE_LIMIT) & kept)
    steady_low, steady_high = _range(omega, (steady <= ANGLE_LIMIT) & kept)
    names = judged[0].bias
    return ObserverJudgement(
        omega=omega,
        bias={name: at([part.bias[name] for part in judged], angle) for name in names},
        speed_bias={name: at([part.speed_bias[name] for part in judged], slip) for name in names},
        speed_total=speed_total,
        lag=lag,
        noise=at([part.noise for part in judged], angle),
        steady=steady,
        total=total,
        load=angle,
        poles=at([part.poles for part in judged], angle),
        omega_low=low,
        omega_high=high,
        steady_low=steady_low,
        steady_high=steady_high,
    )


def judge(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    machine: LinearMachine,
    disturbances: Disturbances,
    omega_max: float,
) -> ObserverJudgement:
    """Judge an observer from 0.1 % of ``omega_max`` rad/s to where sampling ends it,
    omega t_s = 0.8.
    """
    omega = np.unique(
        np.append(np.geomspace(1e-3 * omega_max, LARGEST_TURN / t_s, _SPEEDS), omega_max)
    )
    return judge_at(method, gains, t_s, machine, disturbances, omega)


def _range(omega: FloatArray, holds: Any) -> tuple[float, float]:
    """Ends of the longest run of speeds at which the observer holds, shape (S,)."""
    good = np.concatenate([[False], holds, [False]])
    starts, ends = np.flatnonzero(good[1:] & ~good[:-1]), np.flatnonzero(~good[1:] & good[:-1])
    if not len(starts):
        return float("nan"), float("nan")
    longest = int(np.argmax(ends - starts))
    return float(omega[starts[longest]]), float(omega[ends[longest] - 1])
