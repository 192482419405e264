"""The drive's control loops as exact sampled systems: current loop of one axis,
speed loop with its own sampling.

Timing: the currents are sampled at k t_s, the voltage computed from them acts from (k+1) t_s to
(k+2) t_s (one period of computation, then a zero-order hold: 1.5 t_s on average). The speed
controller runs in every ``ratio``-th of the same interrupts, before the current controllers, so
that its torque reference adds no delay of its own.

The axes are taken as decoupled (see `dqforge.optimizer.loops.loop_gains.decoupling`),
the inverter as linear.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import SpeedMeasurementSettings, filter_share
from dqforge.machines.records import dataclass
from dqforge.optimizer.sampled_systems import (
    ComplexArray,
    SampledSystem,
    constant_input_states,
    delayed_plant,
    discretise,
    lift,
)

FloatArray = NDArray[np.float64]


SETTLED = 0.02  # of the peak deviation


LONGEST_RESPONSE = 400_000  # samples


@dataclass(frozen=True, slots=True)
class PiLoop:
    """A plant under PI control.

    ``open_loop`` leads from the control error to the measured value; ``closed`` has the inputs
    (reference, disturbance) and the measured value as its output. The first state of both is the
    controller's integral.
    """

    open_loop: SampledSystem
    closed: SampledSystem


@dataclass(frozen=True, slots=True)
class SpeedLoop:
    """The speed loop seen by its controller (``loop``) and the drive between the
    controller's samples (``drive``).

    ``drive`` steps with the current controller's period; its inputs are (torque reference, load
    torque) in N m, its state is (integral, torque N m, speed rad/s, previous
    voltage[, filtered speed]).
    """

    loop: PiLoop
    drive: SampledSystem
    ratio: int
    kp: float
    ki: float


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Unit step responses from rest.

    ``times`` in s, ``reference`` the answer to a unit step of the reference, ``disturbance`` that
    to a unit step of the disturbance (1 V at the winding, 1 N m of load torque), all of shape (N,).
    """

    times: FloatArray
    reference: FloatArray
    disturbance: FloatArray


@dataclass(frozen=True, slots=True)
class DisturbanceResponse:
    """Answer to a unit step of the disturbance.

    ``peak`` is the largest deviation (A per V of the current loop, rad/s per N m of the speed
    loop), ``settling_time`` the time in s from which the deviation stays within 2 % of that peak,
    inf where the response is not long enough.
    """

    peak: float
    settling_time: float


def close_pi(plant: SampledSystem, kp: float, ki: float) -> PiLoop:
    """Close a backward-Euler PI around a plant with the inputs (manipulated value, disturbance).

        C(z) = kp + ki t_s z/(z - 1),  i.e.  d[k] = d[k-1] + kp (e[k] - e[k-1]) + ki t_s e[k]
                                       (paper 001, (8.9))

    The plant's first output is measured and must not depend directly on
    the first input (``d`` = 0).
    """
    n = len(plant.a)
    step = ki * plant.t_s
    b_u = plant.b[:, :1]
    a = np.block([[np.ones((1, 1)), np.zeros((1, n))], [b_u, plant.a]])
    b = np.vstack([[[step]], b_u * (kp + step)])
    c = np.hstack([[[0.0]], plant.c[:1]])
    load = np.vstack([np.zeros((1, 1)), plant.b[:, 1:2]])
    return PiLoop(
        open_loop=SampledSystem(a=a, b=b, c=c, d=np.zeros((1, 1)), t_s=plant.t_s),
        closed=SampledSystem(
            a=a - b @ c, b=np.hstack([b, load]), c=c, d=np.zeros((1, 2)), t_s=plant.t_s
        ),
    )


def _with_disturbance(plant: SampledSystem, a: FloatArray, b_load: FloatArray) -> SampledSystem:
    """Add an undelayed held disturbance, entering the continuous states through ``b_load``,
    as a second input.
    """
    held = discretise(a, b_load, plant.t_s)
    column = np.zeros((len(plant.a), 1))
    column[: len(a)] = held.gamma0
    return replace(plant, b=np.hstack([plant.b, column]), d=np.zeros((len(plant.c), 2)))


def current_loop(r_s: float, inductance: float, t_s: float, kp: float, ki: float) -> PiLoop:
    """Current loop of one axis: L di/dt = v - R i, computation delay of one period,
    zero-order hold, PI.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        kp, ki: Gains in V/A and V/(A s).
    """
    a, b = np.array([[-r_s / inductance]]), np.array([[1.0 / inductance]])
    plant = delayed_plant(a, b, np.ones((1, 1)), t_s, tau=t_s)
    return close_pi(_with_disturbance(plant, a, b), kp, ki)


def _mechanics(
    r_s: float, inductance: float, inertia: float, friction: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Continuous (A, b of the voltage, b of the load torque) of torque and speed.

    The first state is the torque K i_q; in this scale the winding reads L dT/dt = u - R T with u =
    K v_q, so that the current controller's gains hold unchanged and K = 3/2 p psi_pm drops out.
    """
    a = np.array([[-r_s / inductance, 0.0], [1.0 / inertia, -friction / inertia]])
    return a, np.array([[1.0 / inductance], [0.0]]), np.array([[0.0], [-1.0 / inertia]])


def _measured(drive: SampledSystem, share: float) -> SampledSystem:
    """The drive with its speed, the third state, as its output, where ``share`` is below 1 behind
    the emitted filter: w_f moves by that share of the newest speed's distance at each sample.
    """
    speed = np.eye(1, len(drive.a), 2)
    if share == 1.0:
        return replace(drive, c=speed)
    a = np.block(
        [
            [drive.a, np.zeros((len(drive.a), 1))],
            [share * speed @ drive.a, np.array([[1.0 - share]])],
        ]
    )
    b = np.vstack([drive.b, share * speed @ drive.b])
    return replace(drive, a=a, b=b, c=np.eye(1, len(a), len(a) - 1))


def speed_loop(
    winding: tuple[float, float],
    mechanics: tuple[float, float],
    t_s: float,
    current_gains: tuple[float, float],
    ratio: int,
    speed_gains: tuple[float, float],
    filter_time: float = 0.0,
) -> SpeedLoop:
    """Speed loop with torque as its output, exactly, as a system with two sampling rates.

    The closed current loop with the mechanics (J domega/dt = T - B omega - T_load, measurement
    filter) is stepped ``ratio`` times under a held torque reference; the speed controller closes
    around the result.

    Args:
        winding: Resistance in Ohm and q-axis inductance in H.
        mechanics: Inertia in kg m^2 and viscous friction in N m s/rad.
        t_s: Sampling period of the current controller in s.
        current_gains: kp in V/A and ki in V/(A s) of the q axis.
        ratio: Sampling period of the speed controller in current samples.
        speed_gains: kp in N m s/rad and ki in N m/rad.
        filter_time: Time constant in s of the first-order filter of the measured speed, which acts
            at each current sample; 0 for none.
    """
    a, b_voltage, b_load = _mechanics(*winding, *mechanics)
    torque = np.eye(1, 2)
    plant = _with_disturbance(delayed_plant(a, b_voltage, torque, t_s, tau=t_s), a, b_load)
    drive = _measured(close_pi(plant, *current_gains).closed, filter_share(filter_time, t_s))
    return SpeedLoop(
        loop=close_pi(lift(drive, ratio), *speed_gains),
        drive=drive,
        ratio=ratio,
        kp=speed_gains[0],
        ki=speed_gains[1],
    )


def response_length(closed: SampledSystem) -> int:
    """Samples until the slowest mode of a stable loop has decayed to 1e-5.

    Args:
        closed: The closed loop.
    """
    slowest = float(np.abs(closed.poles[0]))
    if slowest >= 1.0:
        return LONGEST_RESPONSE
    return int(np.clip(np.ceil(np.log(1e-5) / np.log(max(slowest, 1e-3))), 20, LONGEST_RESPONSE))


def _times(count: int, t_s: float) -> FloatArray:
    return np.asarray(np.arange(count) * t_s, dtype=np.float64)


def current_step(loop: PiLoop, steps: int, stride: int = 1) -> StepResponse:
    """Current in A after a unit step of its reference and of a voltage at the winding.

    ``steps`` counts the points, which are every ``stride``-th sample.

    Args:
        loop: A current loop.
        steps: Number of points.
        stride: Samples from point to point.
    """
    closed = lift(loop.closed, stride)
    reference = constant_input_states(closed, np.array([1.0, 0.0]), steps)
    disturbance = constant_input_states(closed, np.array([0.0, 1.0]), steps)
    return StepResponse(
        times=_times(steps, closed.t_s),
        reference=reference @ closed.c[0],
        disturbance=disturbance @ closed.c[0],
    )


def _between_samples(speed: SpeedLoop, inputs: FloatArray, steps: int) -> FloatArray:
    """Speed in rad/s at every current sample, shape (steps * ratio,), under constant (reference,
    load).
    """
    states = constant_input_states(speed.loop.closed, inputs, steps)
    error = inputs[0] - states @ speed.loop.closed.c[0]
    torque = states[:, 0] + (speed.kp + speed.ki * speed.loop.closed.t_s) * error
    forced = np.outer(torque, speed.drive.b[:, 0]) + inputs[1] * speed.drive.b[:, 1]
    now = states[:, 1:]
    omega = np.empty((steps, speed.ratio))
    for sub in range(speed.ratio):
        omega[:, sub] = now[:, 2]
        now = now @ speed.drive.a.T + forced
    return omega.reshape(-1)


def speed_step(speed: SpeedLoop, steps: int, stride: int = 1) -> StepResponse:
    """Speed in rad/s (before the filter) after a unit step of its reference (rad/s) and
    of the load torque (N m).

    ``steps`` counts samples of the speed controller; the result has one point per current sample.
    With a ``stride`` above 1 it has ``steps`` points instead, at every ``stride``-th sample of the
    speed controller.
    """
    if stride > 1:
        closed = lift(speed.loop.closed, stride)
        reference, disturbance = (
            constant_input_states(closed, inputs, steps)[:, 3] for inputs in np.eye(2)
        )
        return StepResponse(
            times=_times(steps, closed.t_s), reference=reference, disturbance=disturbance
        )
    return StepResponse(
        times=_times(steps * speed.ratio, speed.drive.t_s),
        reference=_between_samples(speed, np.array([1.0, 0.0]), steps),
        disturbance=_between_samples(speed, np.array([0.0, 1.0]), steps),
    )


def disturbance_summary(response: StepResponse) -> DisturbanceResponse:
    """Peak and settling time of the answer to the disturbance.

    Args:
        response: Samples of the response to a unit step.
    """
    deviation = np.abs(response.disturbance)
    peak = float(np.max(deviation))
    outside = np.flatnonzero(deviation > SETTLED * peak)
    first = int(outside[-1]) + 1 if len(outside) else 0
    settling_time = float(response.times[first]) if first < len(deviation) else np.inf
    return DisturbanceResponse(peak=peak, settling_time=settling_time)


# What the edges of an encoder say of the speed: least and largest speed, resolution and delay.
#
# An encoder gives N edges per revolution, a timer of the clock f_c and n bits takes their times,
# and the speed controller asks every T_s seconds. With T_e = 2 pi/(N omega) between two edges:
#
#     counts    omega = 2 pi m/(N T_s)            m edges in a speed period; window T_s
#     capture   omega = 2 pi f_c/(N D)            D ticks between the last two edges; window T_e
#     mixed     omega = 2 pi f_c m/(N D)          m edges in D ticks, from the last edge before the
#                                                 period to the last one in it; window about T_s
#
# The mean over a window W that ended a time A ago lags by W/2 + A and is smaller by sinc(omega
# W/2): A is nought for counts and T_e/2 on average for the others, as edges and samples are not in
# step. One count more or less moves the speed by 2 pi/(N T_s), one tick by its share in D.
#
# References:
#     Paper 001, (8.1) to (8.6): capture with N = 1024, f_c = 1/33.9 ns and 16 bits. (8.1) is
#     printed in rpm; its limits are (8.2) and one over D per unit. T. Ohmae et al., "A
#     microprocessor-controlled high-accuracy wide-range speed regulator for motor drives", IEEE
#     Trans. Industrial Electronics 29, 1982 (mixed, "M/T").

REST = 1.0  # Time in s without an edge after which the shaft counts as at rest.


@dataclass(frozen=True, slots=True)
class Edges:
    """Encoder and timer, asked every ``period`` s."""

    settings: SpeedMeasurementSettings
    period: float

    @property
    def timed(self) -> bool:
        """Whether a timer takes part."""
        return self.settings.method != "counts"

    @property
    def per_turn(self) -> int:
        """Edges per revolution that count."""
        return self.settings.lines * self.settings.edges

    @property
    def largest(self) -> float:
        """Mechanical speed in rad/s at which one tick lies between two edges, (8.2); endless for
        counts.
        """
        return 2.0 * np.pi * self.settings.clock / self.per_turn if self.timed else float("inf")

    @property
    def longest_period(self) -> float:
        """Longest period of the speed controller in s within which the timer runs over at most
        once; endless for counts.
        """
        own = self.settings
        return (2.0**own.counter_bits - 1.0) / own.clock if self.timed else float("inf")

    @property
    def patience(self) -> int:
        """Samples without an edge after which the shaft counts as at rest; 1 for counts."""
        if not self.timed:
            return 1
        return max(int(min(REST, 2.0**31 / self.settings.clock) / self.period), 1)

    @property
    def least(self) -> float:
        """Mechanical speed in rad/s below which the shaft counts as at rest; 0 for counts."""
        waited = self.patience * self.period
        return 2.0 * np.pi / (self.per_turn * waited) if self.timed else 0.0

    def window(self, omega_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Length of the window and its mean age at the sample, both in s, at mechanical speeds in
        rad/s of any shape.
        """
        between = 2.0 * np.pi / (self.per_turn * np.abs(omega_m))
        if not self.timed:
            return np.full_like(between, self.period), np.zeros_like(between)
        captured = self.settings.method == "capture"
        return between if captured else np.maximum(between, self.period), 0.5 * between

    def mean_delay(self, omega_m: FloatArray) -> FloatArray:
        """Mean delay of the speed in s, as `window`."""
        length, age = self.window(omega_m)
        return np.asarray(0.5 * length + age)

    def resolution(self, omega_m: FloatArray) -> FloatArray:
        """Change of the speed in rad/s by one count, or by one tick of the timer, as `window`."""
        if not self.timed:
            return np.full(np.shape(omega_m), 2.0 * np.pi / (self.per_turn * self.period))
        length, _ = self.window(omega_m)
        return np.asarray(np.abs(omega_m) / (length * self.settings.clock))

    def response(self, omega_m: float, omega: FloatArray) -> ComplexArray:
        """Measured over true speed at angular frequencies ``omega`` in rad/s, of their shape, at a
        mechanical speed in rad/s.
        """
        length, age = (float(part) for part in self.window(np.array(omega_m)))
        mean = np.sinc(omega * length / (2.0 * np.pi))
        return np.asarray(mean * np.exp(-1j * omega * (0.5 * length + age)))
