"""The integers that current control of a phase machine consists of.

Codes of ``width`` bits stand for shares of full scale, 2^(width - 1) of them; a turn has 2^width
codes. Integrals have ``fraction`` more bits than a code.
"""

from __future__ import annotations

from typing import Generic, NamedTuple

from dqforge.machines.names import CurrentFrame, Feedforward, NumberFormat, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.codes import TurnSteps, full_scale, turn_steps
from dqforge.optimizer.fixed_control.transforms import FixedPi, PiForm
from dqforge.optimizer.loops.integer_gains import FixedGain


class Vector(NamedTuple, Generic[N]):
    """Values on the axes alpha, beta and zero."""

    alpha: N
    beta: N
    zero: N


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
