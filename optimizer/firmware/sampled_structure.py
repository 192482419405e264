"""The loops of a firmware as exact sampled systems: its delay, its PI rules, its filters, its PLL.

Every controller is brought to the backward-Euler one of `dqforge.optimizer.loops.plants.close_pi`:
with I the integral before the sample, u = kp e + share ki T e + I and I += ki T e, where the share
is 1 for ``integral-first``, 1/2 for ``trapezoid`` and 0 for ``integral-last``; so that ki is the
same and the proportional gain kp - (1 - share) ki T.

What is measured is a state of every plant, after its filter or estimate has taken in the newest
sample. A first-order filter of the time constant T_f, sampled every T, runs as

    y[k] = y[k-1] + T/(T + T_f) (x[k] - y[k-1])          (backward Euler)

and the phase-locked loop as e = theta - theta', omega' += ki T e, theta' += (omega' + kp e) T.

References
----------
K. J. Astroem, B. Wittenmark, "Computer-Controlled Systems", 3rd edition, 1997: chapters 2 and 8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.firmware.profile import (
    CurrentLoops,
    PiController,
    PiRule,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.loops.plants import PiLoop, close_pi
from dqforge.optimizer.sampled_systems import SampledSystem, delayed_plant, discretise, lift

_SHARE: dict[PiRule, float] = {"integral-first": 1.0, "trapezoid": 0.5, "integral-last": 0.0}


@dataclass(frozen=True, slots=True)
class Winding:
    """One axis: resistance in ohm, inductance in H, and the gain of the voltage (1 as computed)."""

    r_s: float
    inductance: float
    gain: float = 1.0


@dataclass(frozen=True, slots=True)
class Mechanics:
    """What turns.

    ``inertia`` in kg m^2, ``viscous`` friction in N m s/rad, ``torque_constant`` in N m/A of q
    current, ``back_emf`` in V s/rad (mechanical): what the feedforward leaves of it.
    """

    inertia: float
    viscous: float
    torque_constant: float
    back_emf: float


def equivalent_gains(pi: PiController) -> tuple[float, float]:
    """(kp, ki) of the backward-Euler PI that computes the same outputs of the same errors.

    Parameters
    ----------
    pi:
        The controller; ki is per second.
    """
    return pi.kp - (1.0 - _SHARE[pi.rule]) * pi.ki * pi.t_s, pi.ki


def filter_share(filter_time: float, t_s: float) -> float:
    """Share of a new sample in a first-order filter sampled every ``t_s`` s; 1 without a filter."""
    return t_s / (t_s + max(filter_time, 0.0))


def _first_row(count: int, place: int) -> FloatArray:
    row = np.zeros((1, count))
    row[0, place] = 1.0
    return row


def _filtered(plant: SampledSystem, filter_time: float) -> SampledSystem:
    """The plant with a filter on its output, whose newest value is a state of its own."""
    if filter_time <= 0.0:
        return plant
    share, n = filter_share(filter_time, plant.t_s), len(plant.a)
    row = share * plant.c[:1]
    return SampledSystem(
        a=np.block([[plant.a, np.zeros((n, 1))], [row @ plant.a, np.array([[1.0 - share]])]]),
        b=np.vstack([plant.b, row @ plant.b]),
        c=_first_row(n + 1, n),
        d=np.zeros((1, plant.b.shape[1])),
        t_s=plant.t_s,
    )


def _with_load(plant: SampledSystem, a: FloatArray, b_load: FloatArray) -> SampledSystem:
    """Add an undelayed held disturbance as a second input."""
    column = np.zeros((len(plant.a), 1))
    column[: len(a)] = discretise(a, b_load, plant.t_s).gamma0
    return replace(plant, b=np.hstack([plant.b, column]), d=np.zeros((len(plant.c), 2)))


def current_plant(winding: Winding, pi: PiController, delay: float) -> SampledSystem:
    """From the computed voltage (and a voltage at the winding) to the current that is measured.

    Parameters
    ----------
    winding:
        The axis.
    pi:
        Its controller: period and filter.
    delay:
        Periods from the sample to the beginning of the held voltage.
    """
    a = np.array([[-winding.r_s / winding.inductance]])
    b = np.array([[winding.gain / winding.inductance]])
    plant = delayed_plant(a, b, np.ones((1, 1)), pi.t_s, tau=delay * pi.t_s)
    return _filtered(_with_load(plant, a, b / winding.gain), pi.filter_time)


def current_loop(winding: Winding, pi: PiController, delay: float) -> PiLoop:
    """One current loop as its firmware runs it.

    Parameters
    ----------
    winding, pi, delay:
        As in `current_plant`.
    """
    return close_pi(current_plant(winding, pi, delay), *equivalent_gains(pi))


def whole_ratio(slow: float, fast: float) -> int:
    """How many fast periods go into a slow one, at least 1."""
    return max(1, round(slow / fast))


def estimate_ratio(speed: SpeedController, t_s: float) -> int:
    """Periods ``t_s`` of the current control between two steps of the speed estimate.

    At most those of the speed controller, and a divisor of them.

    Parameters
    ----------
    speed:
        The speed controller with its estimate.
    t_s:
        Period of the current controllers in s.
    """
    most = whole_ratio(speed.pi.t_s, t_s)
    wanted = min(most, whole_ratio(speed.feedback.t_s or t_s, t_s))
    return min((n for n in range(1, most + 1) if most % n == 0), key=lambda n: abs(n - wanted))


@dataclass(frozen=True, slots=True)
class _Estimator:
    """Linear map of (drive states, own states) at a step of the estimate; ``row`` reads the speed
    after it.
    """

    states: int
    step: FloatArray
    row: FloatArray


def _estimator(feedback: SpeedEstimate, n: int, speed: int, angle: int, t_e: float) -> _Estimator:
    """The estimate behind ``n`` drive states, whose speed (rad/s) and angle since the last step
    (rad, mechanical) lie at the places named.
    """
    own = {"ideal": 0, "pll": 1, "low-pass": 1, "difference": max(feedback.samples, 1)}
    count = own[feedback.kind]
    step, row = np.eye(n + count), np.zeros((1, n + count))
    if feedback.kind == "ideal":
        row[0, speed] = 1.0
        return _Estimator(count, step, row)
    row[0, n] = 1.0
    if feedback.kind == "pll":  # the angle is that between the rotor and the estimate
        step[n, angle] = feedback.ki * t_e
        step[angle] = 0.0
        step[angle, angle] = 1.0 - (feedback.kp + feedback.ki * t_e) * t_e
        step[angle, n] = -t_e
        return _Estimator(count, step, row)
    step[angle, angle] = 0.0
    if feedback.kind == "low-pass":
        share = filter_share(feedback.filter_time, t_e)
        step[n, n], step[n, angle] = 1.0 - share, share / t_e
        return _Estimator(count, step, row)
    step[n:, n:] = np.eye(count, k=-1)
    step[n, angle] = 1.0
    row[0, n:] = 1.0 / (count * t_e)
    return _Estimator(count, step, row)


def _turning(winding: Winding, mechanics: Mechanics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Continuous (A, b of the voltage, b of the load) of current, speed and angle."""
    a, b_voltage, b_load = np.zeros((3, 3)), np.zeros((3, 1)), np.zeros((3, 1))
    a[0, 0] = -winding.r_s / winding.inductance
    a[0, 1] = -mechanics.back_emf / winding.inductance
    a[1, 0] = mechanics.torque_constant / mechanics.inertia
    a[1, 1] = -mechanics.viscous / mechanics.inertia
    a[2, 1] = 1.0
    b_voltage[0, 0], b_load[1, 0] = winding.gain / winding.inductance, -1.0 / mechanics.inertia
    return a, b_voltage, b_load


def speed_plant(
    winding: Winding, mechanics: Mechanics, current: CurrentLoops, speed: SpeedController
) -> SampledSystem:
    """From the q current asked for (and a load torque) to the speed that the controller sees.

    The closed current loop with mechanics and estimate is stepped under a held reference until the
    speed controller runs again; exact at both sampling rates.

    Parameters
    ----------
    winding, mechanics:
        The q axis and what it turns.
    current, speed:
        Both controllers.
    """
    t_c = current.q.t_s
    a, b_voltage, b_load = _turning(winding, mechanics)
    measured = _first_row(3, 0)
    plant = delayed_plant(a, b_voltage, measured, t_c, tau=current.delay * t_c)
    plant = _filtered(_with_load(plant, a, b_load), current.q.filter_time)
    drive = close_pi(plant, *equivalent_gains(current.q)).closed
    every = estimate_ratio(speed, t_c)
    # The controller's integral comes first: speed and angle are the third and the fourth state.
    n, t_e = len(drive.a), every * t_c
    estimator = _estimator(speed.feedback, n, 2, 3, t_e)
    size = n + estimator.states
    wide = SampledSystem(
        a=np.block(
            [
                [drive.a, np.zeros((n, estimator.states))],
                [np.zeros((estimator.states, n)), np.eye(estimator.states)],
            ]
        ),
        b=np.vstack([drive.b, np.zeros((estimator.states, 2))]),
        c=estimator.row,
        d=np.zeros((1, 2)),
        t_s=t_c,
    )
    steps = lift(wide, every)
    stepped = replace(steps, a=estimator.step @ steps.a, b=estimator.step @ steps.b)
    whole = lift(stepped, whole_ratio(speed.pi.t_s, t_c) // every)
    if speed.feedback.kind == "ideal":
        whole = _without(whole, 3)  # nothing sees the angle
        size -= 1
    return _filtered(_output_first(whole, size), speed.pi.filter_time)


def _without(system: SampledSystem, place: int) -> SampledSystem:
    """The system without a state that nothing else depends on."""
    kept = np.delete(np.arange(len(system.a)), place)
    return replace(system, a=system.a[np.ix_(kept, kept)], b=system.b[kept], c=system.c[:, kept])


def _output_first(system: SampledSystem, size: int) -> SampledSystem:
    """The same system with its output as a state of its own, in place of one of those it is made
    of.
    """
    place = int(np.argmax(np.abs(system.c[0])))
    change = np.eye(size)
    change[place] = system.c[0]
    back = np.linalg.inv(change)
    return replace(
        system, a=change @ system.a @ back, b=change @ system.b, c=_first_row(size, place)
    )


def speed_loop(
    winding: Winding, mechanics: Mechanics, current: CurrentLoops, speed: SpeedController
) -> PiLoop:
    """The speed loop as its firmware runs it.

    Parameters
    ----------
    winding, mechanics, current, speed:
        As in `speed_plant`.
    """
    plant = speed_plant(winding, mechanics, current, speed)
    period = whole_ratio(speed.pi.t_s, current.q.t_s) * current.q.t_s
    return close_pi(plant, *equivalent_gains(replace(speed.pi, t_s=period)))
