"""What is known of a speed loop that runs on an observer: its margins over the speed,
what the observer leaves, how it swings where it is unstable, and where all corners hold.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.plants import PiLoop


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
        hertz, rpm = self.omega / (2.0 * np.pi), self.swing * 30.0 / np.pi
        return f"it swings at {hertz:.3g} Hz, the speed by {rpm:.3g} rpm from peak to peak"


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
        parts = [f"{_SYMBOLS[name]} {100.0 * error:+.3g} %" for name, error in self.errors.items()]
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

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every speed."""
        return bool((self.radius < 1.0).all())

    @property
    def holds(self) -> bool:
        """Whether the loop has the required margin at every speed."""
        return self.stable and bool((abs(self.phase_margin) >= self.required).all())
