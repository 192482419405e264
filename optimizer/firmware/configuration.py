"""What a configuration of another firmware amounts to: machine, gains and limits in SI units, as
that firmware computes with them.

Amplitude-invariant dq quantities (peak of phase), resistances and inductances per phase of the
star. Readers make a `Configuration` of a file, methods make one of a design; files are written
from it. Its numbers are those that the file can hold, already rounded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.plants import PiLoop, close_pi
from dqforge.optimizer.sampled_systems import SampledSystem, delayed_plant, discretise, lift

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.names import Firmware


Number = float | int
OwnValue = Number | str


@dataclass(frozen=True, slots=True)
class DriveValues:
    """Machine, inverter and timing as a firmware is told them; None where a file does not say.

    Args:
        pole_pairs: Number of pole pairs.
        r_s, l_d, l_q, psi_pm: Resistance in ohm, inductances in H and magnet flux linkage in Wb of
            one phase.
        inertia, viscous: Inertia in kg m^2 and viscous friction in N m s/rad.
        i_max, omega_m_max: Limits: current in A (peak of phase) and mechanical speed in rad/s.
        v_dc, f_sw, dead_time: Of the inverter, in V, Hz and s.
        t_s, t_speed: Periods in s with which the current and the speed controller run.
        shunt, sense_gain, sense_reference: Of the current measurement, in Ohm, V/V and V, where a
            firmware counts in integers.
    """

    pole_pairs: int | None = None
    r_s: float | None = None
    l_d: float | None = None
    l_q: float | None = None
    psi_pm: float | None = None
    inertia: float | None = None
    viscous: float | None = None
    i_max: float | None = None
    omega_m_max: float | None = None
    v_dc: float | None = None
    f_sw: float | None = None
    dead_time: float | None = None
    t_s: float | None = None
    t_speed: float | None = None
    shunt: float | None = None
    sense_gain: float | None = None
    sense_reference: float | None = None


@dataclass(frozen=True, slots=True)
class PiGains:
    """Gains of the parallel form, per second: V/A and V/(A s) of a current loop; A s/rad and A/rad
    (q current per mechanical speed) of a speed loop.
    """

    kp: float
    ki: float


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a value stands in a file: its key there, the text as printed, the line (from 1), and
    how it was converted.
    """

    key: str
    text: str
    line: int | None = None
    conversion: str = ""


@dataclass(frozen=True, slots=True)
class Configuration:
    """One configuration of a firmware.

    Args:
        firmware, version: Whose it is, and the version of its format.
        drive: Machine, inverter and timing.
        current_d, current_q: Gains of the current controllers as the firmware runs them (worked out
            by its own rule where it has one); None where neither file nor rule gives them.
        speed: Gains of the speed controller, None without one.
        own: Everything else that the file says or that is to be written, by the format's own name
            and in its own unit: PLL, observer, filters, dividers, tables as text.
        origins: Where values stand, by the name of the field (``r_s``, ``current_d.kp``); empty for
            a configuration that no file was read for.
        conventions: How its numbers are to be understood, one sentence each.
        contradictions: What in it does not fit together, one sentence each with both numbers.
    """

    firmware: Firmware
    version: str
    name: str
    drive: DriveValues
    current_d: PiGains | None = None
    current_q: PiGains | None = None
    speed: PiGains | None = None
    own: Mapping[str, OwnValue] = field(default_factory=dict)
    origins: Mapping[str, Origin] = field(default_factory=dict)
    conventions: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()


# The structure of a firmware's loops, with its numbers: what is judged, and what is simulated.

# ``integral-first``: I += ki T e, u = kp e + I (backward Euler); ``integral-last``: u = kp e + I,
# then I += ki T e (forward Euler); ``trapezoid``: I += ki T (e + e_before)/2, u = kp e + I.
PiRule = Literal["integral-first", "integral-last", "trapezoid"]

# What the integral does where the output is limited: it is clamped to the limit, it stands still,
# it is driven back by the excess, or it runs on.
AntiWindup = Literal["clamp", "hold", "back-calculation", "none"]

# Which voltage gives way: the vector along its direction, q after d, d after q, each by itself.
LimitOrder = Literal["vector", "d-first", "q-first", "axes"]
SpeedKind = Literal["ideal", "pll", "low-pass", "difference"]


@dataclass(frozen=True, slots=True)
class PiController:
    """One PI controller as it is computed.

    ``kp`` and ``ki`` are those of the parallel form, per second; ``t_s`` its period in s; ``limit``
    that of its output in the unit of the output, None where only what follows limits it.
    ``filter_time`` is the time constant in s of a first-order filter on what it measures,
    ``tracking`` the back-calculation gain in 1/s.
    """

    kp: float
    ki: float
    t_s: float
    rule: PiRule = "integral-first"
    anti_windup: AntiWindup = "clamp"
    limit: float | None = None
    filter_time: float = 0.0
    tracking: float = 0.0


@dataclass(frozen=True, slots=True)
class CurrentLoops:
    """Both current controllers and what leads from them to the inverter.

    Args:
        d, q: The controllers; volts per ampere.
        delay: Periods from the sampling of the currents to the beginning of the period for which
            the voltage made of them is held: 1 where it is loaded with the next update.
        cross, back_emf: Whether the voltages of the other axis' current, and of the magnet, are fed
            forward.
        order, voltage_share: Which voltage gives way, and the limit as a share of v_dc/sqrt(3).
        angle_advance: Periods by which the angle is advanced when the voltage is turned back to the
            phases.
        modulation: As it is named among the modulators.
    """

    d: PiController
    q: PiController
    delay: float = 1.0
    cross: bool = False
    back_emf: bool = False
    order: LimitOrder = "vector"
    voltage_share: float = 1.0
    angle_advance: float = 0.0
    modulation: str = "svpwm"


@dataclass(frozen=True, slots=True)
class SpeedEstimate:
    """How the speed that is controlled is made of the angle.

    ``pll``: omega += ki e T, theta += (omega + kp e) T over the electrical angle, so that the speed
    has the transfer function ki/(s^2 + kp s + ki). ``low-pass``: a first-order filter of
    ``filter_time`` s on the difference of angles. ``difference``: that difference over
    ``samples`` periods. ``t_s`` is the period in s at which it runs. ``averaged`` is the number of
    periods over which the speed of any of them is averaged before it is used, and ``whole`` says
    that a ``pll`` hands on omega + kp e instead of omega alone, so that its transfer function is
    (kp s + ki)/(s^2 + kp s + ki).
    """

    kind: SpeedKind = "ideal"
    t_s: float = 0.0
    kp: float = 0.0
    ki: float = 0.0
    filter_time: float = 0.0
    samples: int = 1
    averaged: int = 1
    whole: bool = False


@dataclass(frozen=True, slots=True)
class SpeedController:
    """The speed controller: amperes of q current per rad/s (mechanical), and what it measures.

    ``ramp`` is the slope in rad/s^2 to which the reference is held, None without one.
    """

    pi: PiController
    feedback: SpeedEstimate
    ramp: float | None = None


@dataclass(frozen=True, slots=True)
class FluxObserver:
    """A position observer of a firmware: its name there, and the rate in rad/s with which its error
    decays at standstill and at speed, None where that depends on more than its numbers.
    """

    name: str
    rate: float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoopProfile:
    """The loops of one firmware with the numbers of one configuration.

    ``reference`` says where the currents for a torque come from: no d current, the closed form of
    linear machines, or a table of the firmware. ``sources`` name where the structure is taken from.
    ``table`` holds the points of that table, (command, i_d, i_q) in A, commands ascending from 0:
    joined by lines, held behind the last; for negative commands i_q changes its sign. The command
    is the torque over 1.5 p psi_pm, or what the speed controller puts out.
    """

    firmware: Firmware
    version: str
    current: CurrentLoops
    speed: SpeedController | None = None
    observer: FluxObserver | None = None
    reference: Literal["id-zero", "mtpa-linear", "table"] = "id-zero"
    sources: tuple[str, ...] = ()
    table: tuple[tuple[float, float, float], ...] = ()


# The loops of a firmware as exact sampled systems: its delay, its PI rules, its filters, its PLL.
#
# Every controller is brought to the backward-Euler one of
# `dqforge.optimizer.loops.plants.close_pi`: with I the integral before the sample, u = kp e +
# share ki T e + I and I += ki T e, where the share is 1 for ``integral-first``, 1/2 for
# ``trapezoid`` and 0 for ``integral-last``; so that ki is the same and the proportional gain kp -
# (1 - share) ki T.
#
# What is measured is a state of every plant, after its filter or estimate has taken in the newest
# sample. A first-order filter of the time constant T_f, sampled every T, runs as
#
#     y[k] = y[k-1] + T/(T + T_f) (x[k] - y[k-1])          (backward Euler)
#
# and the phase-locked loop as e = theta - theta', omega' += ki T e, theta' += (omega' + kp e) T. A
# speed goes through its filter first and then through its average.
#
# References:
#     K. J. Astroem, B. Wittenmark, "Computer-Controlled Systems", 3rd edition, 1997: chapters 2 and
#     8.

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

    Args:
        pi: The controller; ki is per second.
    """
    return pi.kp - added_gain(pi), pi.ki


def added_gain(pi: PiController) -> float:
    """What the proportional gain is above that of the backward-Euler PI with the same outputs.

    Args:
        pi: The controller; ki is per second.
    """
    return (1.0 - _SHARE[pi.rule]) * pi.ki * pi.t_s


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

    Args:
        winding: The axis.
        pi: Its controller: period and filter.
        delay: Periods from the sample to the beginning of the held voltage.
    """
    a = np.array([[-winding.r_s / winding.inductance]])
    b = np.array([[winding.gain / winding.inductance]])
    plant = delayed_plant(a, b, np.ones((1, 1)), pi.t_s, tau=delay * pi.t_s)
    return _filtered(_with_load(plant, a, b / winding.gain), pi.filter_time)


def current_loop(winding: Winding, pi: PiController, delay: float) -> PiLoop:
    """One current loop as its firmware runs it.

    Args:
        winding, pi, delay: As in `current_plant`.
    """
    return close_pi(current_plant(winding, pi, delay), *equivalent_gains(pi))


def whole_ratio(slow: float, fast: float) -> int:
    """How many fast periods go into a slow one, at least 1."""
    return max(1, round(slow / fast))


def estimate_ratio(speed: SpeedController, t_s: float) -> int:
    """Periods ``t_s`` of the current control between two steps of the speed estimate.

    At most those of the speed controller, and a divisor of them.

    Args:
        speed: The speed controller with its estimate.
        t_s: Period of the current controllers in s.
    """
    most = whole_ratio(speed.pi.t_s, t_s)
    wanted = min(most, whole_ratio(speed.feedback.t_s or t_s, t_s))
    return min((n for n in range(1, most + 1) if most % n == 0), key=lambda n: abs(n - wanted))


@dataclass(frozen=True, slots=True, eq=False)
class _Estimate:
    """A step of the speed estimate on m states: the drive's, and its own behind them.

    ``step`` (m, m) maps the states before it to those after, ``value`` (m,) reads the speed from
    the states before it, ``place`` is the state that holds it afterwards (-1: none yet).
    """

    step: FloatArray
    value: FloatArray
    place: int = -1

    def with_state(self, row: FloatArray, place: int = -1) -> _Estimate:
        """One more state, whose new value is ``row`` times all states, itself included."""
        m = len(self.step)
        step = np.zeros((m + 1, m + 1))
        step[:m, :m], step[m] = self.step, row
        return _Estimate(step, np.append(self.value, 0.0), place)

    def filtered(self, share: float) -> _Estimate:
        """Behind a first-order filter that takes a share of each new value."""
        if share >= 1.0:
            return self
        row = np.append(share * self.value, 1.0 - share)
        return replace(self.with_state(row, len(self.step)), value=row)

    def averaged(self, count: int) -> _Estimate:
        """The mean of the last ``count`` values."""
        found, total, last = self, self.value, self.value
        for _ in range(count - 1):
            found = found.with_state(np.append(last, 0.0))
            last = np.zeros(len(found.step))
            last[-1] = 1.0
            total = np.append(total, 0.0) + last
        return found if count <= 1 else _Estimate(found.step, total / count)

    def held(self) -> _Estimate:
        """With the speed as a state."""
        if self.place >= 0:
            return self
        return self.with_state(np.append(self.value, 0.0), len(self.step))


def _estimate(feedback: SpeedEstimate, n: int, speed: int, angle: int, t_e: float) -> _Estimate:
    """The estimate behind ``n`` drive states, whose speed (rad/s) and angle (rad, mechanical) lie
    at the places named.

    The angle counts from the estimated one of a phase-locked loop, else from the last step.
    """
    made = _Estimate(np.eye(n), np.eye(n)[speed], speed)
    if feedback.kind == "pll":
        made = _tracked(feedback, n, angle, t_e)
    elif feedback.kind != "ideal":
        step = np.eye(n)
        step[angle] = 0.0
        made = _Estimate(step, np.eye(n)[angle] / t_e)
    if feedback.kind in ("pll", "low-pass"):
        made = made.filtered(filter_share(feedback.filter_time, t_e))
    if feedback.kind == "difference":
        made = made.averaged(feedback.samples)
    return made.held()


def _tracked(feedback: SpeedEstimate, n: int, angle: int, t_e: float) -> _Estimate:
    """The phase-locked loop: its speed is the state behind those of the drive."""
    unit = np.eye(n + 1)
    omega = unit[n] + feedback.ki * t_e * unit[angle]
    made = _Estimate(np.eye(n), np.zeros(n)).with_state(omega, n)
    made.step[angle] = unit[angle] - t_e * (omega + feedback.kp * unit[angle])
    if feedback.whole:
        return _Estimate(made.step, omega + feedback.kp * unit[angle])
    return replace(made, value=omega)


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

    Args:
        winding, mechanics: The q axis and what it turns.
        current, speed: Both controllers.
    """
    t_c = current.q.t_s
    a, b_voltage, b_load = _turning(winding, mechanics)
    measured = _first_row(3, 0)
    plant = delayed_plant(a, b_voltage, measured, t_c, tau=current.delay * t_c)
    plant = _filtered(_with_load(plant, a, b_load), current.q.filter_time)
    drive = close_pi(plant, *equivalent_gains(current.q)).closed
    every = estimate_ratio(speed, t_c)
    # The controller's integral comes first: speed and angle are the third and the fourth state.
    n = len(drive.a)
    estimate = _estimate(speed.feedback, n, 2, 3, every * t_c)
    size = len(estimate.step)
    a, b = np.eye(size), np.zeros((size, 2))
    a[:n, :n], b[:n] = drive.a, drive.b
    wide = SampledSystem(a, b, _first_row(size, estimate.place), np.zeros((1, 2)), t_c)
    steps = lift(wide, every)
    stepped = replace(steps, a=estimate.step @ steps.a, b=estimate.step @ steps.b)
    ratio = whole_ratio(speed.pi.t_s, t_c) // every
    whole = _lifted_average(stepped, ratio, speed.feedback.averaged)
    if speed.feedback.kind == "ideal":
        whole = _without(whole, 3)  # nothing sees the angle
    return _filtered(whole, speed.pi.filter_time)


def _lifted_average(system: SampledSystem, ratio: int, count: int) -> SampledSystem:
    """Seen every ``ratio``-th step, with the mean of the last ``count`` outputs as its output.

    Of each period between two looks only the sum of its outputs is kept, and the sum of those at
    its end that the oldest period still gives: count = whole ratio + rest.
    """
    found = lift(system, ratio)
    if count <= 1:
        return found
    n, (whole, rest) = len(system.a), divmod(count, ratio)
    sums = np.zeros((2, n + system.b.shape[1]))  # of all, and of the last ones
    a, b = np.eye(n), np.zeros_like(system.b)
    for step in range(ratio):
        a, b = system.a @ a, system.a @ b + system.b
        row = np.hstack([system.c @ a, system.c @ b])[0]
        sums[0] += row
        sums[1] += row * (step >= ratio - rest)
    lengths = (whole, whole + 1 if rest else 0)
    size = n + sum(lengths) + 1
    wide_a, wide_b = np.zeros((size, size)), np.zeros((size, system.b.shape[1]))
    wide_a[:n, :n], wide_b[:n] = found.a, found.b
    start, weights = n, np.zeros(size)
    for kept, length in zip(sums, lengths, strict=True):
        if length:
            wide_a[start, :n], wide_b[start] = kept[:n], kept[n:]
            for place in range(start + 1, start + length):
                wide_a[place, place - 1] = 1.0
            start += length
    weights[n : n + whole] = 1.0 / count
    if rest:
        weights[start - 1] = 1.0 / count
    wide_a[-1], wide_b[-1] = weights @ wide_a, weights @ wide_b
    return SampledSystem(
        wide_a, wide_b, _first_row(size, size - 1), np.zeros((1, system.b.shape[1])), found.t_s
    )


def _without(system: SampledSystem, place: int) -> SampledSystem:
    """The system without a state that nothing else depends on."""
    kept = np.delete(np.arange(len(system.a)), place)
    return replace(system, a=system.a[np.ix_(kept, kept)], b=system.b[kept], c=system.c[:, kept])


def speed_loop(
    winding: Winding, mechanics: Mechanics, current: CurrentLoops, speed: SpeedController
) -> PiLoop:
    """The speed loop as its firmware runs it.

    Args:
        winding, mechanics, current, speed: As in `speed_plant`.
    """
    plant = speed_plant(winding, mechanics, current, speed)
    period = whole_ratio(speed.pi.t_s, current.q.t_s) * current.q.t_s
    return close_pi(plant, *equivalent_gains(replace(speed.pi, t_s=period)))


# Both current loops of a firmware together while the machine turns: what its decoupling, its delay
# and its angle leave of the coupling of the axes.
#
# With d + j q, omega the electrical speed, a the angle advance and T the period::
#
#     l_d di_d/dt = -R i_d + omega l_q i_q + v_d,   l_q di_q/dt = -R i_q - omega l_d i_d + v_q
#     v(t) = exp(j omega (a T - t)) v[k]         t since the sample k, from delay T to (delay + 1) T
#   v[k] = PI(-y[k]) (+ omega (-l_q y_q, l_d y_d) with cross feedforward),  y the filtered currents
#
# for references of zero; the magnets move no pole.

_SPEEDS = 9


@dataclass(frozen=True, slots=True)
class TurningAxes:
    """The worst of the poles of both current loops together up to the largest speed.

    ``radius`` is their largest modulus per period, at the mechanical speed ``omega_m`` in rad/s;
    ``unstable_from`` the least of the speeds looked at that is unstable, None without one.
    """

    radius: float
    omega_m: float
    unstable_from: float | None


def _rotation(angle: float) -> FloatArray:
    return np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=np.float64
    )


def _held(
    r_s: float, inductances: tuple[float, float], omega: float, time: float
) -> tuple[FloatArray, FloatArray]:
    """Currents after a time, of the currents before it and of a voltage that stands still."""
    from scipy.linalg import expm

    l_d, l_q = inductances
    flow = np.zeros((4, 4))
    flow[0, :3] = -r_s / l_d, omega * l_q / l_d, 1.0 / l_d
    flow[1] = -omega * l_d / l_q, -r_s / l_q, 0.0, 1.0 / l_q
    flow[2, 3], flow[3, 2] = omega, -omega
    found = np.asarray(expm(flow * time), dtype=np.float64)
    return found[:2, :2], found[:2, 2:]


def turning_matrix(
    r_s: float, inductances: tuple[float, float], loops: CurrentLoops, omega: float
) -> FloatArray:
    """Map of (i, y, I, v[k-1], v[k-2], ...), two numbers each, over one period.

    Args:
        r_s, inductances: Resistance in Ohm; l_d and l_q in H.
        loops: The structure with its gains; both axes have one period.
        omega: Electrical speed in rad/s.
    """
    t_s, whole = loops.d.t_s, math.floor(loops.delay + 1e-12)
    part, depth = max(loops.delay - whole, 0.0), whole + 1
    size, unit = 6 + 2 * depth, np.eye(2)
    gains = [equivalent_gains(pi) for pi in (loops.d, loops.q)]
    kp, step = np.diag([kp for kp, _ in gains]), np.diag([ki * t_s for _, ki in gains])
    share = np.diag([filter_share(pi.filter_time, t_s) for pi in (loops.d, loops.q)])
    feed = omega * np.array([[0.0, -inductances[1]], [inductances[0], 0.0]]) * loops.cross

    now = np.zeros((2, size))  # the filtered currents of this sample
    now[:, :2], now[:, 2:4] = share, unit - share
    voltage = (feed - kp - step) @ now
    voltage[:, 4:6] += unit
    past = [voltage, *(np.eye(size)[6 + 2 * n : 8 + 2 * n] for n in range(depth))]
    early, early_v = _held(r_s, inductances, omega, part * t_s)
    late, late_v = _held(r_s, inductances, omega, (1.0 - part) * t_s)
    lead = loops.angle_advance
    before = _rotation(omega * t_s * (lead - whole - 1.0)) @ past[whole + 1]
    after = _rotation(omega * t_s * (lead - loops.delay)) @ past[whole]

    matrix = np.zeros((size, size))
    matrix[:2, :2] = late @ early
    matrix[:2] += late @ early_v @ before + late_v @ after
    matrix[2:4] = now
    matrix[4:6] = -step @ now
    matrix[4:6, 4:6] += unit
    matrix[6:8] = voltage
    matrix[8:, 6:-2] = np.eye(size - 8)
    return matrix


def turning_axes(
    r_s: float,
    inductances: tuple[float, float],
    loops: CurrentLoops,
    pole_pairs: int,
    omega_m: float,
) -> TurningAxes:
    """The largest pole of both loops together from standstill to a mechanical speed in rad/s.

    Backwards is the mirror image.

    Args:
        r_s, inductances, loops: As in `turning_matrix`.
        pole_pairs: Number of pole pairs.
        omega_m: Largest mechanical speed in rad/s.
    """
    speeds = np.linspace(0.0, omega_m, _SPEEDS)
    radius = np.array(
        [
            np.max(
                np.abs(
                    np.linalg.eigvals(
                        turning_matrix(r_s, inductances, loops, pole_pairs * float(speed))
                    )
                )
            )
            for speed in speeds
        ]
    )
    worst, unstable = int(np.argmax(radius)), np.flatnonzero(radius >= 1.0)
    return TurningAxes(
        float(radius[worst]),
        float(speeds[worst]),
        float(speeds[unstable[0]]) if unstable.size else None,
    )
