"""The integers that current control of a phase machine consists of.

Codes of ``width`` bits stand for shares of full scale, 2^(width - 1) of them; a turn has 2^width
codes. Integrals have ``fraction`` more bits than a code.
"""

from __future__ import annotations

from collections import namedtuple
from functools import cache
from typing import Annotated, Any, ClassVar, Generic, NamedTuple

from dqforge.machines.names import CurrentFrame, Feedforward, NumberFormat, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.codes import TurnSteps, full_scale, turn_steps
from dqforge.optimizer.fixed_control.transforms import (
    FixedPi,
    Pi,
    PiForm,
    PiGains,
    speed_loop_gains,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import (
    CODE,
    COUNT,
    FEW,
    TURN,
    WIDE,
    Abc,
    Coded,
    Turned,
)
from dqforge.optimizer.steps.step_arithmetic import Member


class Axes(NamedTuple, Generic[N]):
    """Values on the axes alpha, beta and zero."""

    alpha: N
    beta: N
    zero: N


class Vector(Axes[N]):
    """Alpha, beta and zero sequence (mean of the phases) in wide words."""

    WORDS: ClassVar[str] = WIDE


@cache
def duties_type(topology: Topology) -> Any:
    """The vector of the duty cycles of a topology's legs."""
    made: Any = namedtuple
    kind = made("Duties", TOPOLOGIES[topology].legs)
    kind.WORDS = TURN
    return kind


@dataclass(frozen=True, slots=True)
class FixedAxis:
    """PI controller of one axis; ``ki`` leads to a state with ``fraction`` more bits than a code.

    ``resistance`` and ``inductance`` (over t_s) turn currents into the voltage of the references,
    ``reactance`` is that of the inductance at the base speed.
    """

    kp: FixedGain
    ki: FixedGain
    fraction: int
    resistance: FixedGain
    inductance: FixedGain
    reactance: FixedGain


@dataclass(frozen=True, slots=True)
class FixedHarmonic:
    """An integrator that turns with a harmonic.

    ``order`` is signed in the plane; ``reactance`` is that of the harmonic at the base speed.
    ``fade`` leads from what the speed lacks of ``end`` (code) to its weight.
    """

    order: int
    zero: bool
    reactance: FixedGain
    fade: FixedGain
    end: int


@dataclass(frozen=True, slots=True)
class FixedMidpoint:
    """What keeps the midpoint of a split link.

    ``balance`` leads from the code of the midpoint's error to that of the zero-sequence current;
    ``fade`` from the code of the speed to the weight of the table's zero-sequence current.
    """

    balance: FixedGain
    fade: FixedGain


@dataclass(frozen=True, slots=True)
class FixedPhaseControl:
    """Everything that the header in integers holds.

    Args:
        width: Bits of a code, 16 or 32.
        bases: Full scales of current in A, voltage in V, mechanical speed in rad/s, torque in N m,
            flux (back-EMF over electrical speed) in Wb.
        frame, feedforward, topology: As in `PhaseControl`.
        shape: Codes of the flux of phase a, or of all three: one row or three, N + 1 entries each,
            of which the last repeats the first.
        turns: Electrical periods of the shape.
        fundamental: Code of the flux of the fundamental.
        fade, fade_end: From what the speed lacks of ``fade_end`` (code) to the share of the
            harmonics in the references.
        unit, unit_bits, least_square: i = t f / s with t = ``unit`` times the torque, s the square
            of the flux, at least ``least_square``; the quotient has ``unit_bits`` bits less than a
            code.
        sample: Turn of the shape in a sample, from codes of the speed to codes of its angle.
        electrical: Reactance of the flux: from speed times flux to voltage.
        d, q, zero: Controllers; None for a zero sequence that nothing drives.
        rate, harmonic_fraction: What harmonic integrators learn in a sample, and the further bits
            of their states.
        error_max: Sum of the magnitudes of the errors, in codes, above which they rest.
        harmonics: The integrators.
        midpoint: For a split link, else None.
        dc_scale, dc_least: Full scale of the link is 2^dc_scale times that of the voltage; below
            the code ``dc_least`` it counts as that.
        current_per_torque: For the frame dq: from the code of the torque to that of i_q.
        speed, speed_filter, torque_max, ratio: The speed loop, as in `FixedControl`.
    """

    width: int
    bases: tuple[float, float, float, float, float]
    frame: CurrentFrame
    feedforward: Feedforward
    topology: Topology
    shape: tuple[tuple[int, ...], ...]
    turns: int
    fundamental: int
    fade: FixedGain
    fade_end: int
    unit: FixedGain
    unit_bits: int
    least_square: int
    sample: FixedGain
    electrical: FixedGain
    d: FixedAxis
    q: FixedAxis
    zero: FixedAxis | None
    rate: FixedGain
    harmonic_fraction: int
    error_max: int
    harmonics: tuple[FixedHarmonic, ...]
    midpoint: FixedMidpoint | None
    dc_scale: int
    dc_least: int
    current_per_torque: FixedGain
    speed: dict[PiForm, FixedPi] | None
    speed_filter: FixedGain
    torque_max: int
    ratio: int

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return "q15" if self.width == 16 else "q31"

    @property
    def top(self) -> int:
        """The largest code."""
        return full_scale(self.width)

    @property
    def turn(self) -> TurnSteps:
        """Integers of sine and cosine."""
        return turn_steps(self.width)

    @property
    def nodes(self) -> int:
        """Intervals of the shape."""
        return len(self.shape[0]) - 1

    @property
    def has_zero(self) -> bool:
        """Whether a zero-sequence current is controlled."""
        return self.zero is not None

    @property
    def framed(self) -> bool:
        """Whether integrals lie along and across the flux."""
        return self.frame in ("dqx", "dqy")


# What the firmware has of them. Numbers are integers, or those of an arithmetic.


@dataclass(frozen=True, slots=True)
class Axis:
    """A PI controller, whose integral has fraction more bits than a code, and the voltage of its
    reference.
    """

    kp: FixedGain
    ki: FixedGain
    fraction: Annotated[int, FEW]
    resistance: FixedGain
    inductance: Annotated[FixedGain, Member("over the sampling period")]


@dataclass(frozen=True, slots=True)
class Shape:
    """Back-EMF over electrical speed at the nodes of a period, in codes of the flux."""

    POINTED: ClassVar[bool] = True  # Gains have its address.

    flux: Annotated[tuple[tuple[int, ...], ...], CODE]


@dataclass(frozen=True, slots=True)
class ControlGains:
    """The control as a whole: everything that differs from drive to drive."""

    d: Axis
    q: Axis
    zero: Axis | None
    unit: Annotated[FixedGain, Member("current per torque")]
    sample: Annotated[FixedGain, Member("turn in a sample, of the code of the speed")]
    back_emf: FixedGain
    current_per_torque: Annotated[FixedGain, Member("of sinusoids")]
    speed: Annotated[PiGains, Member("gains of 0: no speed loop")]
    speed_filter: Annotated[FixedGain, Member("share of a new sample, to the state of the filter")]
    torque_max: Annotated[int, CODE, Member("limit of the speed controller's output")]
    ratio: Annotated[int, COUNT, Member("current samples per speed sample")]
    shape: Shape


@dataclass(slots=True)
class Turning(Generic[N]):
    """An integrator that turns with a harmonic; in the firmware an array of two numbers."""

    ARRAY: ClassVar[bool] = True

    x: N
    y: N


@dataclass(slots=True)
class Control(Generic[N]):
    """What changes from sample to sample."""

    integral: Annotated[tuple[N, N, N], Member("of the axes of the frame")]
    harmonic: Annotated[tuple[Turning[N], ...], Member("integrators that turn with harmonics")]
    v: Annotated[Vector[N], Member("that the duty cycles make")]
    reference: Annotated[Vector[N], Member("of the currents")]
    open_phase: Annotated[N, FEW, Member("0: none, 1 to 3: a to c")]
    speed: Pi[N]
    filtered: Annotated[N, Member("speed with as many more bits as a code has, less 2")]
    omega_m: Annotated[N, CODE, Member("filtered speed")]
    torque: Annotated[N, CODE, Member("reference of the torque")]
    count: Annotated[N, COUNT, Member("current samples since the speed controller ran")]


@dataclass(frozen=True, slots=True)
class Measured(Generic[N]):
    """Samples of one instant; the angle is a share of the shape's period."""

    i: Abc[N]
    theta: Turned[N]
    omega_m: Coded[N]
    v_dc: Coded[N]
    v_m: Annotated[N, CODE, Member("midpoint of the link above its negative rail, as v_dc")] | None


def _axis(part: FixedAxis) -> Axis:
    return Axis(part.kp, part.ki, part.fraction, part.resistance, part.inductance)


def phase_gains(control: FixedPhaseControl) -> ControlGains:
    """Gains of the firmware."""
    loop = speed_loop_gains(control)
    return ControlGains(
        _axis(control.d),
        _axis(control.q),
        None if control.zero is None else _axis(control.zero),
        control.unit,
        control.sample,
        control.electrical,
        control.current_per_torque,
        loop.speed,
        loop.speed_filter,
        loop.torque_max,
        loop.ratio,
        Shape(control.shape),
    )


def phase_at_rest(control: FixedPhaseControl, zero: N) -> Control[N]:
    """Nothing turns, of numbers that are all 0."""
    none, turning = Vector(zero, zero, zero), tuple(Turning(zero, zero) for _ in control.harmonics)
    return Control((zero, zero, zero), turning, none, none, zero, Pi(zero), zero, zero, zero, zero)
