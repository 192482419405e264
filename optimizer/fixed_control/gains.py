"""What rounding gains to integers (`dqforge.optimizer.loops.integer_gains`) does to the loop."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import C, N
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.loops.analysis import analyse_current_loop, analyse_speed_loop
from dqforge.optimizer.loops.integer_gains import FixedGain, quantise, rounded_mantissa
from dqforge.optimizer.loops.loop_gains import LoopGains, loop_bases, per_unit


def scaled(o: Arithmetic[N, C], name: str, gain: FixedGain, argument: N) -> N:
    """Gain times argument, rounded to nearest, as the emitted C computes it."""
    product = o.product(name, o.const(gain.mantissa), argument)
    return rounded(o, name, product, gain.shift)


def velocity_integers(kp: float, ki_ts: float, width: int = 16) -> tuple[FixedGain, FixedGain]:
    """Integers of q0 = kp + ki t_s and q1 = -kp with one shift, d[k] = d[k-1] + q0 e[k] + q1
    e[k-1] (paper 001, (8.9)).

    The integral gain is the small difference q0 + q1, so that it loses the digits that both share.
    """
    coarse = quantise(kp + ki_ts, width, 2**width - 1)
    return coarse, FixedGain(rounded_mantissa(-kp, coarse.shift), coarse.shift, -kp)


@dataclass(frozen=True, slots=True)
class QuantisedLoop:
    """One loop with the gains that integers make.

    Args:
        kp, ki_ts: The integers, per unit.
        q0, q1: Those of the velocity form with two products.
        exact, found: Evidence for the real gains and for those of ``kp`` and ``ki_ts``.
        velocity: Evidence for the gains that ``q0`` and ``q1`` make; None where their integral gain
            is not positive.
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

    Args:
        design: Machine, sampling and bases.
        gains: The loop with real gains.
        integers: kp and ki t_s per unit.
        width: Bits of q0 and q1.
        current_gains: Gains of the q axis, for the speed loop.

    Raises:
        NoSolutionError: The loop with these integers is unstable or has less than the required
            phase margin.
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


def real_pi(design: Design, gains: LoopGains) -> tuple[float, float]:
    """Per-unit (kp, ki t_s) of a loop of the design."""
    return per_unit(gains, *loop_bases(design.control.bases, gains.loop))


def _analysed(
    design: Design, gains: LoopGains, found: Sequence[float], current_gains: LoopGains | None
) -> LoopGains:
    base_in, base_out = loop_bases(design.control.bases, gains.loop)
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
    required = 0.0 if loop is None else loop.min_phase_margin
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
