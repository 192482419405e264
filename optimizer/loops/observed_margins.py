"""What is known of a speed loop that runs on an observer: its margins over the speed,
what the observer leaves, how it swings where it is unstable, and where all corners hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, in_rpm
from dqforge.machines.units.quantities import signed_percent
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import LEAST_SHARE, LoopMargins


@dataclass(frozen=True, slots=True)
class LimitCycle:
    """How an unstable speed loop ends: its torque a square wave at its limit.

    ``omega`` in rad/s is the frequency, ``swing`` in rad/s the mechanical speed from peak to peak.
    """

    omega: float
    swing: float

    @property
    def words(self) -> str:
        """Frequency, and peak to peak in rpm."""
        hertz, rpm = self.omega / (2.0 * np.pi), in_rpm(self.swing)
        return f"it swings at {hertz:.3g} Hz, the speed by {rpm:.3g} rpm from peak to peak"


@dataclass(frozen=True, slots=True)
class DeadTimeCycle:
    """A swing that the dead time keeps up in a speed loop that is stable without it.

    It takes a voltage of the sign of the current and of the size ``lost`` in V, of which the
    observer knows nothing: as much as a resistance that falls as the current grows, by its
    describing function 4 lost/(pi i). At the current amplitude ``current`` in A it is
    ``resistance`` in Ohm, from which on the loop is unstable; it swings at ``omega`` in rad/s, the
    mechanical speed by ``swing`` in rad/s from peak to peak; ``limited`` says that it grows until
    the current is at its limit. ``factor`` is that of a slower loop
    without the swing, ``advice`` what to write for it; None and empty without one.
    """

    lost: float
    resistance: float
    current: float
    omega: float
    swing: float
    limited: bool = False
    factor: float | None = None
    advice: str = ""

    @property
    def words(self) -> str:
        """What swings, and what helps."""
        hertz, rpm = self.omega / (2.0 * np.pi), in_rpm(self.swing)
        less = f", or make the loop slower ({self.advice})" if self.advice else ""
        size = (
            "it grows until the current is limited"
            if self.limited
            else f"the current by {self.current:.2g} A, the speed by {rpm:.2g} rpm peak to peak"
        )
        return (
            f"the dead time ({self.lost:.3g} V, unknown to the observer) keeps up a swing at about "
            f"{hertz:.3g} Hz where the current passes through zero: {size}, within a factor of "
            f"two; compensate the dead time{less}"
        )


_SYMBOLS = {"r_s": "R", "l_d": "L_d", "l_q": "L_q", "psi_pm": "psi", "inertia": "J", "v_dc": "V_dc"}


@dataclass(frozen=True, slots=True)
class Corner:
    """One corner: relative errors by name, load in N m, and voltage in V that a dead time costs."""

    errors: dict[str, float]
    load: float
    lost: float = 0.0

    @property
    def words(self) -> str:
        """Every error, the load, and the dead time."""
        parts = [f"{_SYMBOLS[name]} {signed_percent(error)}" for name, error in self.errors.items()]
        parts.append(f"load {self.load:.3g} N m" if self.load else "no load")
        return ", ".join(parts + [f"dead time {self.lost:.3g} V"] * (self.lost != 0.0))


# What ends a range: a loop that is not stable, a speed that is told too wrongly, or a voltage that
# the dc link does not have.
Failure = Literal["unstable", "speed-error", "voltage"]


@dataclass(frozen=True, slots=True)
class FailingCorner:
    """The worst corner at an electrical speed ``omega`` in rad/s.

    ``radius`` is the largest modulus of a pole of the speed period, inf where the drive has no
    steady state; ``speed_error`` the largest error of the speed over all corners, relative;
    ``settling`` how fast its slowest mode dies away, over the least rate that counts as holding.
    ``why`` is what fails there, None where nothing does.
    """

    omega: float
    corner: Corner
    radius: float
    speed_error: float = 0.0
    why: Failure | None = "unstable"
    settling: float = -np.inf

    @property
    def words(self) -> str:
        """The corner, and what fails there."""
        if self.why == "voltage":
            end = "the dc link lacks the voltage"
        elif self.why == "speed-error":
            end = f"the speed is wrong by {100.0 * self.speed_error:.3g} %"
        elif self.radius < 1.0:
            share = f"{100.0 * self.settling:.2g} % of the least rate"
            end = f"swings or creeps for long, dying away at {share}"
        elif np.isfinite(self.radius):
            end = f"unstable, largest pole {self.radius:.4g}"
        else:
            end = "no steady state"
        return f"{self.corner.words}: {end}"


@dataclass(frozen=True, slots=True)
class SpeedRange:
    """Electrical speeds in rad/s between which every corner holds; nan where none does.

    ``below`` and ``above`` are the worst corners just below ``low`` and just above ``high``; None
    where the lowest and the highest speed tried still hold; without a range those at the lowest and
    the highest. ``corners`` is the number of corners at
    each speed, ``speed_error`` the largest error of the speed in the range, relative.
    """

    low: float
    high: float
    below: FailingCorner | None
    corners: int
    above: FailingCorner | None = None
    speed_error: float = 0.0

    @property
    def any(self) -> bool:
        """Whether there is a speed at which all corners hold."""
        return bool(np.isfinite(self.low))


@dataclass(frozen=True, slots=True)
class StepsBorne:
    """Steps that a drive on its observer bears at every corner, within the limits of torque and
    voltage.

    A ``load`` step in N m, from none to as much either way or back, at steady mechanical speeds
    from ``load_low`` to ``load_high`` in rad/s (electrical): between, the dip stays above the
    lowest speed. A step of the reference of up to ``speed`` in rad/s (electrical) with that load or
    none, both of its ends within the range, that after an overshoot by ``overshoot`` of the step
    stays in it.
    """

    load: float
    load_low: float
    load_high: float
    speed: float
    overshoot: float


@dataclass(frozen=True, slots=True)
class CornerJudgement:
    """Where a drive on its observer holds throughout its box.

    ``named`` says whether the design names tolerances, ``limits`` the relative errors by name,
    ``loads`` the loads in N m. ``exact`` is the range without dead time, ``lost`` the voltages in V
    that it may cost and ``dead_time`` the range with them, an indication; None without. ``braking``
    is the range where the load drives the shaft with as much, None where it was not looked at.
    ``leaves`` is the electrical speed in rad/s down to which the simulation stays on the observer,
    None where it never runs on it. ``most_error`` is the speed error, relative, that ends a range;
    ``steps`` what steps are borne within `binding`, None where there is no range; ``pole_pairs``
    lead from electrical to mechanical speeds.
    """

    named: bool
    limits: dict[str, tuple[float, float]]
    loads: tuple[float, ...]
    exact: SpeedRange
    lost: tuple[float, ...] = ()
    dead_time: SpeedRange | None = None
    braking: SpeedRange | None = None
    leaves: float | None = None
    most_error: float = np.inf
    steps: StepsBorne | None = None
    pole_pairs: int = 1

    @property
    def binding(self) -> SpeedRange:
        """Where the drive holds motoring and braking."""
        if self.braking is None or not self.exact.any:
            return self.exact
        if not self.braking.any:
            return self.braking
        late = max(self.exact, self.braking, key=lambda part: part.low)
        early = min(self.exact, self.braking, key=lambda part: part.high)
        if late.low > early.high:
            return replace(late, low=np.nan, high=np.nan)
        return SpeedRange(
            late.low,
            early.high,
            late.below,
            self.exact.corners + self.braking.corners,
            early.above,
            max(self.exact.speed_error, self.braking.speed_error),
        )

    @property
    def failing(self) -> FailingCorner | None:
        """What keeps the range from the top speed; None where nothing but the voltage does."""
        found = self.binding
        worst = found.above or (None if found.any else found.below)
        return None if worst is None or worst.why == "voltage" else worst

    @property
    def holds(self) -> bool:
        """Whether there is a range, and nothing but the voltage of the link ends it upwards."""
        found = self.binding
        return found.any and self.failing is None

    @property
    def left_unstable(self) -> bool:
        """Whether the simulation stays on the observer below the lowest speed that holds; where
        no lower one was tried, nothing is known to fail there.
        """
        found = self.binding
        if self.leaves is None or found.below is None or not found.any:
            return False
        return self.leaves < found.low * (1.0 - 1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class ObservedLoop:
    """A speed loop with the lag of its observer, at S electrical speeds in rad/s.

    Arrays of shape (S,).

    Args:
        observer: The method, in words.
        omega, crossover, phase_margin, radius: Speeds, gain crossovers in rad/s, phase margins in
            rad, largest moduli of the closed loop's poles.
        worst: Index of the speed that counts: unstable, or with the least margin.
        loop: The loop there.
        required: Phase margin in rad that the design asks for.
        left: Crossover in rad/s that the observer leaves: the fastest loop of the same shape that
            is stable and has the required margin at all speeds. The loop's own where it has; None
            where no slower one has.
        advice: What to write for that loop; empty where the loop itself holds.
        cycle: How the loop swings; None where it is stable, or runs away without swinging.
        stable_advice: What to write for the fastest slower loop that is stable; empty where the
            loop itself is, or none is.
        pll_least: Least bandwidth of the observer's phase-locked loop in rad/s with which the loop
            as it is becomes stable; None where it is, or where none is found.
        corners: Where all corners of the tolerances hold; None for a speed observer, and for a
            tracker without a loop of its own.
        slowed: Spread of the speed loop where the one of the rule was too fast for the corners;
            None where it was not.
        relay: The swing that a dead time keeps up; None where it keeps up none.
        beyond: Largest electrical speed of the design in rad/s where the dc link does not reach it:
            the speeds end where it does. None where it reaches it.
    """

    observer: str
    omega: FloatArray
    crossover: FloatArray
    phase_margin: FloatArray
    radius: FloatArray
    worst: int
    loop: PiLoop
    required: float
    left: float | None
    advice: str
    cycle: LimitCycle | None = None
    stable_advice: str = ""
    pll_least: float | None = None
    corners: CornerJudgement | None = None
    slowed: float | None = None
    beyond: float | None = None
    relay: DeadTimeCycle | None = None

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every speed."""
        return bool((self.radius < 1.0).all())

    @property
    def holds(self) -> bool:
        """Whether the loop has the required margin at every speed."""
        return self.stable and bool((abs(self.phase_margin) >= self.required).all())


# Margins of current loops in closed form, any number of loops at once.
#
# With the winding L di/dt = g v - R i, one period of computation, a zero-order hold and the PI of
# `dqforge.optimizer.loops.plants.close_pi` the open loop is::
#
#     L(z) = b (n1 z - n0) / (z (z - 1) (z - a)),   a = exp(-R t_s/L), s = 1 - a, b = g s/R,
#                                                   n0 = kp, q = ki t_s, n1 = n0 + q
#
# On the unit circle every square is a polynomial in y = 1 - cos(omega t_s), from 0 at standstill to
# 2 at the Nyquist frequency::
#
#     gain crossover   4 a y^2 + 2 (s^2 - b^2 n1 n0) y - b^2 q^2 = 0
#     phase crossing   4 n0 y^2 - 2 (n0 (1 + s) - q) y - s q = 0
#     peak of |S|      c1 e0 / y^2 + 2 c2 e0 / y + c2 e1 - c1 e2 - 2 c1 e3 y - c2 e3 y^2 = 0
#                      |S|^2 = (c1 y + c2 y^2) / (e0 + e1 y + e2 y^2 + e3 y^3)
#
# The two roots of the first have opposite signs: a loop has one crossover or none. The last falls
# over all of y > 0: |S| has one peak, whatever the gains. Nothing is scanned, and in y, with s from
# expm1, nothing cancels in loops that are slow against their sampling.
#
# Source: derived; stability by E. I. Jury, "Theory and Application of the z-Transform Method", 1964
# (quoted without the book at hand).

_MOST_STEPS = 80
_STILL = 1e-8  # Step in log y after which the peak stands still to rounding: |S| is level there.


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoops:
    """N current loops, arrays of shape (N,).

    Args:
        decay: s = 1 - exp(-R t_s/L), dimensionless; 0 without resistance, negative for a negative
            one.
        gain: b in A/V: current after one period of 1 V, with the gain of the voltage.
        kp: n0 in V/A, positive.
        step: q = ki t_s in V/A, positive.
        t_s: Sampling period in s.
    """

    decay: FloatArray
    gain: FloatArray
    kp: FloatArray
    step: FloatArray
    t_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class CurrentMargins:
    """Margins of N current loops as in `dqforge.optimizer.sampled_systems.LoopMargins`, arrays of
    shape (N,).

    ``stable`` by Jury's conditions; the others mean something where it holds.
    """

    stable: BoolArray
    crossover: FloatArray
    phase_margin: FloatArray
    gain_margin: FloatArray
    gain_reduction: FloatArray
    delay_margin: FloatArray
    max_sensitivity: FloatArray

    def of(self, place: int) -> LoopMargins:
        """Those of one loop."""
        crossover = float(self.crossover[place])
        found = [] if np.isnan(crossover) else [crossover]
        return LoopMargins(
            crossovers=np.array(found, dtype=np.float64),
            crossover=crossover,
            phase_margin=float(self.phase_margin[place]),
            gain_margin=float(self.gain_margin[place]),
            gain_reduction=float(self.gain_reduction[place]),
            delay_margin=float(self.delay_margin[place]),
            max_sensitivity=float(self.max_sensitivity[place]),
        )


def has_closed_margins(kp: ArrayLike, ki: ArrayLike) -> BoolArray:
    """Whether the formulas hold: both gains positive and finite, any shapes that fit.

    Args:
        kp, ki: Gains in V/A and V/(A s).
    """
    both = np.stack(np.broadcast_arrays(np.asarray(kp), np.asarray(ki)))
    return np.asarray(np.all((both > 0.0) & np.isfinite(both), axis=0))


def current_loops(
    r_s: ArrayLike,
    inductance: ArrayLike,
    t_s: ArrayLike,
    kp: ArrayLike,
    ki: ArrayLike,
    gain: ArrayLike = 1.0,
) -> CurrentLoops:
    """Loops of windings under PI control, every argument one number or of shape (N,).

    Args:
        r_s: Phase resistances in Ohm; zero and negative ones are permitted.
        inductance: Inductances in H.
        t_s: Sampling periods in s.
        kp, ki: Gains in V/A and V/(A s), positive.
        gain: Gain of the voltage: link voltage that acts over the one that is reckoned with.
    """
    given = (np.asarray(value, dtype=np.float64) for value in (r_s, inductance, t_s, kp, ki, gain))
    r_s, inductance, t_s, kp, ki, gain = (
        np.atleast_1d(value) for value in np.broadcast_arrays(*given)
    )
    exponent = r_s * t_s / inductance
    decay = -np.expm1(-exponent)
    at_rest = exponent == 0.0
    share = np.where(at_rest, 1.0, decay / np.where(at_rest, 1.0, exponent))
    return CurrentLoops(decay, gain * share * t_s / inductance, kp, ki * t_s, t_s)


def current_margins(loops: CurrentLoops) -> CurrentMargins:
    """Stability and margins of current loops.

    As `dqforge.optimizer.sampled_systems.loop_margins` of each, which finds them by a scan; like
    there a crossover below `LEAST_SHARE` of the Nyquist frequency is none.

    Args:
        loops: N loops.
    """
    crossing = _crossover(loops)
    angle = 2.0 * np.arcsin(np.sqrt(0.5 * crossing))
    angle = np.where(angle < LEAST_SHARE * np.pi, np.nan, angle)
    none = np.isnan(angle)
    phase = _to_critical(loops, crossing)
    margin, reduction = _gain_factors(loops)
    return CurrentMargins(
        stable=_stable(loops),
        crossover=angle / loops.t_s,
        phase_margin=np.where(none, np.inf, phase),
        gain_margin=margin,
        gain_reduction=reduction,
        delay_margin=np.where(none, np.inf, np.mod(phase, 2.0 * np.pi) / angle * loops.t_s),
        max_sensitivity=_peak(loops),
    )


def _stable(loops: CurrentLoops) -> BoolArray:
    """Jury's conditions for z (z - 1) (z - a) + b (n1 z - n0): b n0 < 1 and (1 - b n0) (s + b n0) >
    b q; the others hold for all positive gains.
    """
    u = loops.gain * loops.kp
    return np.asarray((u < 1.0) & ((1.0 - u) * (loops.decay + u) > loops.gain * loops.step))


def _crossover(loops: CurrentLoops) -> FloatArray:
    """The y at which the loop gain is one, NaN where there is none."""
    a, square = 1.0 - loops.decay, loops.gain**2
    half = loops.decay**2 - square * (loops.kp + loops.step) * loops.kp
    rest = square * loops.step**2
    root = np.sqrt(half * half + 4.0 * a * rest)
    with np.errstate(divide="ignore", invalid="ignore"):
        y = np.where(half > 0.0, rest / (half + root), (root - half) / (4.0 * a))
    return np.where(y < 2.0, y, np.nan)


def _sine(y: FloatArray) -> FloatArray:
    return np.sqrt(y * (2.0 - y))


def _phase(loops: CurrentLoops, y: FloatArray) -> FloatArray:
    """Angle of -L in rad, not wrapped, at y of any shape (..., N)."""
    sine = _sine(y)
    turn = 2.0 * np.arcsin(np.sqrt(0.5 * y))
    n1 = loops.kp + loops.step
    ahead = np.arctan2(n1 * sine, loops.step - n1 * y)
    behind = np.arctan2(sine, loops.decay - y)
    return np.asarray(0.5 * np.pi - CURRENT_DELAY * turn + ahead - behind)


def _to_critical(loops: CurrentLoops, y: FloatArray) -> FloatArray:
    """Angle of -L in rad from -pi to pi."""
    phase = _phase(loops, y)
    return np.asarray(phase - 2.0 * np.pi * np.rint(phase / (2.0 * np.pi)))


def _gain_factors(loops: CurrentLoops) -> tuple[FloatArray, FloatArray]:
    """Gain margin, and the largest factor below one that reaches -1 too.

    At the Nyquist frequency L is positive for all positive gains.
    """
    y = _phase_crossings(loops)
    meets = np.isfinite(y) & (np.cos(_phase(loops, y)) > 0.0)
    y = np.where(meets, y, 1.0)
    a, n1 = 1.0 - loops.decay, loops.kp + loops.step
    above = 2.0 * y * (loops.decay**2 + 2.0 * a * y)
    below = loops.gain**2 * (loops.step**2 + 2.0 * n1 * loops.kp * y)
    factor = np.where(meets, np.sqrt(above / below), np.nan)
    margin = np.min(np.where(factor > 1.0, factor, np.inf), axis=0)
    return margin, np.max(np.where(factor <= 1.0, factor, 0.0), axis=0)


def _phase_crossings(loops: CurrentLoops) -> FloatArray:
    """The y between 0 and 2 at which L is real, shape (2, N), NaN where there is none."""
    half = loops.kp * (1.0 + loops.decay) - loops.step
    under = half * half + 4.0 * loops.kp * loops.decay * loops.step
    with np.errstate(invalid="ignore", divide="ignore"):
        far = half + np.copysign(np.sqrt(under), half)
        y = np.stack([far / (4.0 * loops.kp), -loops.decay * loops.step / far])
        return np.where((y > 0.0) & (y < 2.0), y, np.nan)


def _peak(loops: CurrentLoops) -> FloatArray:
    """Largest |S| up to the Nyquist frequency: at the one y where it is level, or at 2."""
    s, b, n0, q = loops.decay, loops.gain, loops.kp, loops.step
    c1, c2 = 2.0 * s * s, 4.0 * (1.0 - s)
    e0 = (b * q) ** 2
    e1 = c1 + 2.0 * b * (b * (n0 + q) * n0 + s * (2.0 * n0 - q) - 2.0 * q)
    e2 = c2 + 4.0 * b * (q - 3.0 * n0 - n0 * s)
    e3 = 8.0 * b * n0
    middle = c2 * e1 - c1 * e2
    y = _balance(
        (c1 * e0, 2.0 * c2 * e0, np.maximum(middle, 0.0)),
        (np.maximum(-middle, 0.0), 2.0 * c1 * e3, c2 * e3),
    )
    return _sensitivity(loops, y)


def _balance(
    falling: tuple[FloatArray, FloatArray, FloatArray],
    rising: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Least of 2 and the y with f2/y^2 + f1/y + f0 = r0 + r1 y + r2 y^2, all coefficients not
    negative.

    Newton's method on the difference of the logarithms over log y, whose slope lies between -4 and
    -1; a bracket that shrinks with every point holds it.
    """
    (f2, f1, f0), (r0, r1, r2) = falling, rising
    with np.errstate(divide="ignore"):
        least = f1 / (f0 + r0 + 2.0 * r1 + 4.0 * r2)
        low = np.log(np.clip(least, 1e-300, 2.0))
    high = np.full(low.shape, np.log(2.0))
    t, moves = 0.5 * (low + high), np.ones(low.shape, dtype=np.bool_)
    for _ in range(_MOST_STEPS):
        y = np.exp(t)
        one, two = f1 / y, f2 / (y * y)
        three, four = r1 * y, r2 * y * y
        left, right = one + two + f0, three + four + r0
        gap = np.log(left) - np.log(right)
        low, high = np.where(gap > 0.0, t, low), np.where(gap > 0.0, high, t)
        slope = -(one + 2.0 * two) / left - (three + 2.0 * four) / right
        aim = t - gap / slope
        step = np.where((aim >= low) & (aim <= high), aim, 0.5 * (low + high)) - t
        # A loop that stands still is left alone, so that its neighbours change no digit of it.
        t = np.where(moves, t + step, t)
        moves = moves & (np.abs(step) >= _STILL)
        if not np.any(moves):
            break
    return np.asarray(np.minimum(np.exp(t), 2.0))


def _sensitivity(loops: CurrentLoops, y: FloatArray) -> FloatArray:
    """|S| at y, from the factors themselves: of a peak next to instability little is left of the
    square.
    """
    turning = 1j * _sine(y)
    n1 = loops.kp + loops.step
    own = (1.0 - y + turning) * (turning - y) * (loops.decay - y + turning)
    closed = own + loops.gain * (loops.step + n1 * (turning - y))
    with np.errstate(divide="ignore"):
        return np.asarray(np.abs(own) / np.abs(closed))
