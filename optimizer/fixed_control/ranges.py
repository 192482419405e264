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
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import Range, Ranges, Reach, scaled
from dqforge.optimizer.fixed_control.transforms import (
    IDLE,
    Codes,
    FixedControl,
    FixedObserver,
    FixedPi,
    Measured,
    ObserverState,
    PiForm,
    SpeedControlled,
    SpeedState,
    VelocityState,
    current_control,
    decouple,
    duties,
    full_scale,
    observe,
    pi_integral,
    pi_output,
    pi_step,
    pi_update,
    pi_velocity,
    rotation,
    speed_loop,
)
from dqforge.optimizer.loops.integer_gains import FixedGain


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
    error, limit = Range(1 - 2**width, 2**width - 1), Range(0, top)
    state = Range(-top << pi.fraction, top << pi.fraction)
    if form == "parallel":
        pi_step(found, width, pi, state, error, limit)
        if not further:
            return found
        present = pi_integral(found, pi, state, error)
        fed = Range(-further, further)
        output = found.total("output + feedforward", pi_output(found, pi, present, error), fed)
        kept = found.within(output, limit)
        excess = found.total("limited - output", kept, found.negative(output))
        pi_update(found, width, pi, present, excess)
        return found
    silent = Ranges(width)
    last = scaled(silent, "kp e", pi.kp, error)  # what the state can hold of the sample before
    pi_velocity(found, pi, VelocityState(state, last), error, limit)
    return found


def observer_ranges(width: int, part: FixedObserver) -> Ranges:
    """Ranges of the observer's step."""
    found = Ranges(width, "observer: ")
    most = part.reach * full_scale(width) << part.fraction
    every = codes(width)
    state = ObserverState(Range(-most, most), every, Pair(every, every))
    observe(found, width, part, state, Pair(every, every), Pair(every, every))
    return found


def step_ranges(control: FixedControl) -> Ranges:
    """Ranges of the whole step of the current control, and of its parts for any codes."""
    width = control.width
    found = Ranges(width, "current control: ")
    every, angle = codes(width), Range(0, 2**width - 1)
    measured = Measured(Triple(every, every, every), angle, every, every)
    top = full_scale(width)
    integral = Pair(
        *(
            Range(-top << pi.fraction, top << pi.fraction)
            for pi in (control.i_d["parallel"], control.i_q["parallel"])
        )
    )
    current_control(found, control, integral, measured, Pair(every, every))
    found.prefix = "parts: "
    turn = rotation(found, width, angle)
    numbers = Codes(found, width)
    park(numbers, Pair(every, every), turn)
    park_inverse(numbers, Pair(every, every), turn)
    clarke(numbers, Triple(every, every, every))
    clarke_inverse(numbers, Pair(every, every))
    decouple(found, width, control.decoupling, every, Pair(every, every))
    v_dc, phases = Range(1, top), Triple(every, every, every)
    duties(found, width, control.modulation, control.dc_scale, Pair(every, every), v_dc, phases)
    return found


def speed_ranges(control: SpeedControlled) -> Ranges:
    """Ranges of the speed loop with its filter."""
    found = Ranges(control.width, "speed loop: ")
    every, top = codes(control.width), full_scale(control.width)
    most, fraction = top << (control.width - 2), IDLE.fraction
    if control.speed is not None:
        fraction = control.speed["parallel"].fraction
    integral = Range(-top << fraction, top << fraction)
    count = Range(0, max(control.ratio - 1, 0))
    speed_loop(found, control, SpeedState(Range(-most, most), integral, every, count), every, every)
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
