"""Gains as integers: a mantissa that uses its word and a right shift,
with what rounding does to the loop.

A gain g between per-unit codes is mantissa / 2^shift. Plain Qn formats have shifts below the width
of the word; with power-of-two dividers the shift may be larger, so that small gains keep all their
digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import QFormats
from dqforge.machines.transforms import C, N
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_control.q_numbers import to_q
from dqforge.optimizer.loops.gains import (
    LoopGains,
    analyse_current_loop,
    analyse_speed_loop,
    per_unit,
)

GainStyle = Literal["power-of-two", "q"]


@dataclass(frozen=True, slots=True)
class FixedGain:
    """A gain in integers, mantissa / 2^shift.

    ``value`` is the real gain that it stands for, dimensionless (between per-unit codes).
    """

    mantissa: int
    shift: int
    value: float

    @property
    def realised(self) -> float:
        """The gain that the integers make."""
        return float(self.mantissa * 2.0**-self.shift)

    @property
    def error(self) -> float:
        """Relative error of the gain, 0 where the gain is 0."""
        return self.realised / self.value - 1.0 if self.value else 0.0

    @property
    def half(self) -> int:
        """Half of what the shift leaves, added before it to round to nearest."""
        return (1 << self.shift) >> 1

    def text(self) -> str:
        """Integers as they are written: ``20000 / 2^10``."""
        return f"{self.mantissa} / 2^{self.shift}"


def quantise(
    value: float, width: int, argument: int, style: GainStyle = "power-of-two"
) -> FixedGain:
    """Largest mantissa that a word of ``width`` bits holds and whose product with the
    argument twice the width holds.

    Parameters
    ----------
    value:
        The gain, dimensionless.
    width:
        Bits of the mantissa, 16 or 32; the product with half of what the shift
        leaves has twice as many.
    argument:
        Largest magnitude of what the gain is multiplied with.
    style:
        ``power-of-two``: any shift up to 2 width - 2; ``q``: below the width,
        as Qn formats have it.

    Raises
    ------
    NoSolutionError
        The gain is too large for the mantissa even without a shift, or so small that it becomes 0.
    """
    largest = width - 1 if style == "q" else 2 * width - 2
    if value == 0.0:
        return FixedGain(0, 0, 0.0)
    for shift in range(largest, -1, -1):
        mantissa = _rounded(value, shift)
        if abs(mantissa) < 2 ** (width - 1) and abs(mantissa) * argument + (
            (1 << shift) >> 1
        ) < 2 ** (2 * width - 1):
            if mantissa == 0:
                raise NoSolutionError(
                    f"{value:.4g} is 0 in {width} bits with a shift of {shift}; use other bases"
                )
            return FixedGain(mantissa, shift, value)
    raise NoSolutionError(
        f"{value:.4g} is more than int{width}_t holds; use larger bases of what it multiplies"
    )


def given(value: float, bits: int, width: Literal[16, 32] = 16) -> FixedGain:
    """A gain in a format that was asked for; errors as `to_q`."""
    return FixedGain(to_q(value, bits, width), bits, value)


def _rounded(value: float, bits: int) -> int:
    magnitude = int(abs(value) * 2.0**bits + 0.5)
    return -magnitude if value < 0.0 else magnitude


def scaled(o: Arithmetic[N, C], name: str, gain: FixedGain, argument: N) -> N:
    """Gain times argument, rounded to nearest, as the emitted C computes it."""
    product = o.product(name, o.const(gain.mantissa), argument)
    return rounded(o, name, product, gain.shift)


def pi_integers(
    kp: float, ki_ts: float, q_formats: QFormats | None
) -> tuple[FixedGain, FixedGain] | None:
    """Integers of 16 bits of kp and ki t_s per unit in the formats of the settings,
    None where none are asked for.

    ``auto`` gives each gain the plain Qn format, n up to 30, with the most digits.

    Raises
    ------
    NoSolutionError
        An integer does not fit its format, or becomes 0.
    """
    if q_formats is None:
        return None
    if q_formats == "auto":
        argument = 2**16 - 1  # an error of two full scales
        return quantise(kp, 16, argument), quantise(ki_ts, 16, argument)
    return given(kp, q_formats[0]), given(ki_ts, q_formats[1])


def velocity_integers(kp: float, ki_ts: float, width: int = 16) -> tuple[FixedGain, FixedGain]:
    """Integers of q0 = kp + ki t_s and q1 = -kp with one shift, d[k] = d[k-1] + q0 e[k] + q1
    e[k-1] (paper 001, (8.9)).

    The integral gain is the small difference q0 + q1, so that it loses the digits that both share.
    """
    coarse = quantise(kp + ki_ts, width, 2**width - 1)
    return coarse, FixedGain(_rounded(-kp, coarse.shift), coarse.shift, -kp)


@dataclass(frozen=True, slots=True)
class QuantisedLoop:
    """One loop with the gains that integers make.

    Parameters
    ----------
    kp, ki_ts:
        The integers, per unit.
    q0, q1:
        Those of the velocity form with two products.
    exact, found:
        Evidence for the real gains and for those of ``kp`` and ``ki_ts``.
    velocity:
        Evidence for the gains that ``q0`` and ``q1`` make; None where their
        integral gain is not positive.
    """

    kp: FixedGain
    ki_ts: FixedGain
    q0: FixedGain
    q1: FixedGain
    exact: LoopGains
    found: LoopGains
    velocity: LoopGains | None

    @property
    def velocity_ki_error(self) -> float:
        """Relative error of the integral gain q0 + q1."""
        return (self.q0.realised + self.q1.realised) / self.ki_ts.value - 1.0


def quantised_loop(
    design: Design,
    gains: LoopGains,
    integers: tuple[FixedGain, FixedGain],
    width: int = 16,
    current_gains: LoopGains | None = None,
) -> QuantisedLoop:
    """Poles and margins of a loop with its gains in integers.

    Parameters
    ----------
    design:
        Machine, sampling and bases.
    gains:
        The loop with real gains.
    integers:
        kp and ki t_s per unit.
    width:
        Bits of q0 and q1.
    current_gains:
        Gains of the q axis, for the speed loop.

    Raises
    ------
    NoSolutionError
        The loop with these integers is unstable or has less than the required phase margin.
    """
    kp, ki_ts = integers
    q0, q1 = velocity_integers(kp.value, ki_ts.value, width)
    found = _analysed(design, gains, (kp.realised, ki_ts.realised), current_gains)
    velocity_ki = q0.realised + q1.realised
    velocity = (
        None
        if velocity_ki <= 0.0
        else _analysed(design, gains, (-q1.realised, velocity_ki), current_gains)
    )
    _require(design, found, kp, ki_ts)
    return QuantisedLoop(kp, ki_ts, q0, q1, gains, found, velocity)


def loop_bases(design: Design, gains: LoopGains) -> tuple[float, float]:
    """Bases of what a loop controls and of its output: A and V, or rad/s and N m."""
    bases = design.control.bases
    return (bases.speed, bases.torque) if gains.loop == "speed" else (bases.current, bases.voltage)


def real_pi(design: Design, gains: LoopGains) -> tuple[float, float]:
    """Per-unit (kp, ki t_s) of a loop of the design."""
    return per_unit(gains, *loop_bases(design, gains))


def _analysed(
    design: Design, gains: LoopGains, found: Sequence[float], current_gains: LoopGains | None
) -> LoopGains:
    base_in, base_out = loop_bases(design, gains)
    kp, ki = found[0] * base_out / base_in, found[1] * base_out / base_in / gains.t_s
    if gains.loop == "speed":
        assert current_gains is not None
        return analyse_speed_loop(
            design.machine, current_gains, design.control, kp, ki, gains.method, respond=False
        )
    inductance = gains.inductance or design.machine.l_q
    return analyse_current_loop(
        design.machine.r_s, inductance, gains.t_s, kp, ki, gains.method, gains.loop, respond=False
    )


def _require(design: Design, found: LoopGains, kp: FixedGain, ki_ts: FixedGain) -> None:
    control = design.control
    loop = control.speed_loop if found.loop == "speed" else control.current_loop
    section = "speed_loop" if found.loop == "speed" else "current_loop"
    required = 0.0 if loop is None else loop.phase_margin_min
    if found.stable and abs(found.phase_margin) >= required:
        return
    raise NoSolutionError(
        (
            f"control.{section}: with kp = {kp.text()} and ki t_s = {ki_ts.text()} the "
            f"{found.loop} loop "
        )
        + ("misses its phase margin" if found.stable else "is unstable")
        + f" (rounded by {kp.error:+.2%} and {ki_ts.error:+.2%}); write q_formats: auto"
    )
