"""What the integers of the control functions can become: proof that nothing overflows,
and what moves nothing.

The emitted functions (`fixed_control`, `fixed_transforms`) run on ranges in place of numbers, from
every code that a word can hold: currents, speed and references from -2^(w-1) to 2^(w-1) - 1, errors
up to two full scales, any angle, and the states between the values that they are clamped to. So the
result holds for every input and every past.
"""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.fixed_control.codes import (
    code_clarke,
    code_clarke_inverse,
    code_park,
    code_park_inverse,
    full_scale,
    rotation,
)
from dqforge.optimizer.fixed_control.transforms import (
    FixedControl,
    FixedObserver,
    FixedPi,
    Measured,
    Pi,
    PiForm,
    PiVelocity,
    ReducedOrder,
    SpeedControlled,
    SpeedLoop,
    control_at_rest,
    decoupling,
    pi_gains,
    pi_integral,
    pi_output,
    pi_step,
    pi_update,
    pi_velocity_step,
    reduced_order_gains,
    reduced_order_step,
    speed_loop,
    speed_loop_gains,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq
from dqforge.optimizer.steps.integer_arithmetic import Range, Ranges, Reach, scaled


@dataclass(frozen=True, slots=True)
class DeadBand:
    """Smallest errors in codes that still move an integral, upwards (positive)
    and downwards (negative).

    Below them the loop does not see an error: it rests there, or swings slowly
    between both ends (limit cycle).
    """

    positive: int
    negative: int

    @property
    def largest(self) -> int:
        """The larger of both."""
        return max(self.positive, self.negative)


def dead_band(gain: FixedGain, *, rounding: bool = True) -> DeadBand:
    """Dead band of an integral gain.

    Args:
        gain: From the error to the state, positive.
        rounding: Whether the shift rounds to nearest, as the emitted code does; without, it rounds
            downwards, as the program of paper 001 does, and any negative error moves the integral
            by a whole unit.

    Raises:
        NoSolutionError: The gain is not positive: nothing moves the integral.
    """
    if gain.mantissa <= 0:
        raise NoSolutionError("an integral gain of 0 moves nothing")
    half = gain.half if rounding else 0
    step = 1 << gain.shift
    return DeadBand(-((half - step) // gain.mantissa), half // gain.mantissa + 1)


def codes(width: int) -> Range:
    """Every code of a word."""
    return Range(-(2 ** (width - 1)), 2 ** (width - 1) - 1)


def pi_ranges(width: int, name: str, pi: FixedPi, form: PiForm, further: int = 0) -> Ranges:
    """Ranges of a controller: any error of two codes, any past.

    ``further`` is the largest feedforward in codes that is added before the output is limited.
    """
    found = Ranges(width, f"{name}: ")
    top = full_scale(width)
    error, limit, gains = Range(1 - 2**width, 2**width - 1), Range(0, top), pi_gains(width, pi)
    state = Range(-gains.most, gains.most)
    if form == "parallel":
        pi_step(found, gains, Pi(state), error, limit)
        if not further:
            return found
        present = pi_integral(found, gains, Pi(state), error)
        fed = Range(-further, further)
        output = found.total("output + feedforward", pi_output(found, gains, present, error), fed)
        kept = found.within(output, limit)
        excess = found.total("limited - output", kept, found.negative(output))
        pi_update(found, gains, Pi(state), present, excess)
        return found
    silent = Ranges(width)
    last = scaled(silent, "kp e", pi.kp, error)  # what the state can hold of the sample before
    pi_velocity_step(found, gains, PiVelocity(state, last), error, limit)
    return found


def observer_ranges(width: int, part: FixedObserver) -> Ranges:
    """Ranges of the observer's step."""
    found = Ranges(width, "observer: ")
    gains, every = reduced_order_gains(width, part), codes(width)
    pair = Dq(every, every)
    state = ReducedOrder(Range(-gains.zeta_max, gains.zeta_max), every, pair)
    reduced_order_step(found, width, gains, state, pair, pair)
    return found


def step_ranges(control: FixedControl) -> Ranges:
    """Ranges of the whole step of the current control, and of its parts for any codes."""
    width = control.width
    found = Ranges(width, "current control: ")
    every, angle = codes(width), Range(0, 2**width - 1)
    phases, pair, dq = Abc(every, every, every), AlphaBeta(every, every), Dq(every, every)
    gains, state = control.gains, control_at_rest(Range(0, 0))
    for own, pi in ((state.d, gains.d), (state.q, gains.q)):
        own.integral = Range(-pi.most, pi.most)
    measured = Measured(phases, angle, every, every)
    control.steps.current_control(found, gains, state, measured, dq)
    found.prefix = "parts: "
    turn = rotation(found, width, angle)
    code_park(found, width, pair, turn)
    code_park_inverse(found, width, dq, turn)
    code_clarke(found, width, phases)
    code_clarke_inverse(found, width, pair)
    decoupling(found, width, control.decoupling, every, dq)
    control.steps.duties.duties(found, pair, Range(1, full_scale(width)), phases)
    return found


def speed_ranges(control: SpeedControlled) -> Ranges:
    """Ranges of the speed loop with its filter."""
    found = Ranges(control.width, "speed loop: ")
    every, gains = codes(control.width), speed_loop_gains(control)
    most = full_scale(control.width) << (control.width - 2)
    integral = Range(-gains.speed.most, gains.speed.most)
    count = Range(0, max(control.ratio - 1, 0))
    state = SpeedLoop(Pi(integral), Range(-most, most), every, every, count)
    speed_loop(found, control.width, gains, state, every, every)
    return found


def control_ranges(control: FixedControl) -> tuple[Reach, ...]:
    """Range of every named product and sum of the emitted functions, in the order of evaluation.

    Raises:
        NoSolutionError: A quantity can leave its word; the message names it.
    """
    parts = [
        pi_ranges(control.width, name, pi, form)
        for name, forms in control.loops.items()
        for form, pi in forms.items()
    ]
    if control.observer is not None:
        parts.append(observer_ranges(control.width, control.observer))
    parts.append(speed_ranges(control))
    parts.append(step_ranges(control))
    for part in parts:
        require(part)
    return tuple(reach for part in parts for reach in part.reaches.values())


def require(
    found: Ranges, advice: str = "use larger bases in control.per_unit, or smaller gains"
) -> None:
    """Refuse ranges that a word cannot hold, naming the first.

    Raises:
        NoSolutionError: With the quantity, what it can reach, what the word holds, and the advice.
    """
    worst = found.overflowing()
    if worst is not None:
        raise NoSolutionError(
            f"fixed point: '{worst.name}' can reach {worst.range.largest}, int{worst.bits}_t ends "
            f"at {2 ** (worst.bits - 1) - 1}; {advice}"
        )


def finest(
    width: int, name: str, pi: FixedPi, form: PiForm, most: int, further: int = 0
) -> FixedPi | None:
    """The controller with the most fractional bits of its state, up to ``most``,
    that cannot overflow; None if none.

    ``pi`` has its gains for no fractional bits; ``further`` as of `pi_ranges`.
    """
    for fraction in range(min(most, width - 2), -1, -1):
        trial = with_fraction(pi, fraction)
        if trial is not None and pi_ranges(width, name, trial, form, further).overflowing() is None:
            return trial
    return None


def with_fraction(pi: FixedPi, fraction: int) -> FixedPi | None:
    """The same integers for a state with so many more bits.

    None where a shift would become negative.
    """
    if fraction > min(pi.ki.shift, pi.tracking.shift):
        return None
    scale = 2.0**fraction

    def finer(gain: FixedGain) -> FixedGain:
        return replace(gain, shift=gain.shift - fraction, value=gain.value * scale)

    return replace(pi, ki=finer(pi.ki), tracking=finer(pi.tracking), fraction=fraction)
