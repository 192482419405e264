"""Proof that nothing overflows in the integers of a phase machine's control."""

from __future__ import annotations

from dqforge.machines.transforms import Pair, Triple
from dqforge.optimizer.fixed_control.arithmetic import Range, Ranges, Reach
from dqforge.optimizer.fixed_control.ranges import codes, pi_ranges, require, speed_ranges
from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl
from dqforge.optimizer.fixed_phase_control.phase_step import (
    PhaseState,
    Sample,
    control_step,
    torque_reference,
)


def phase_ranges(control: FixedPhaseControl) -> tuple[Reach, ...]:
    """Range of every named product and sum of the step, from any codes and any state.

    Raises:
        NoSolutionError: A quantity can leave its word; the message names it.
    """
    width, top = control.width, control.top
    found = Ranges(width, "phase control: ")
    every, angle = codes(width), Range(0, 2**width - 1)

    def state(fraction: int) -> Range:
        return Range(-top << fraction, top << fraction)

    axes = (control.d, control.q, control.zero)
    integral = Triple(*(state(0 if axis is None else axis.fraction) for axis in axes))
    turning = state(control.harmonic_fraction)
    sample = Sample(Triple(every, every, every), angle, every, every, Range(0, top), Range(0, 3))
    before = PhaseState(integral, tuple(Pair(turning, turning) for _ in control.harmonics))
    control_step(found, control, before, sample, every, Pair(every, every))
    torque_reference(found, control, every)
    parts = [found, speed_ranges(control)]
    if control.speed is not None:
        parts += [pi_ranges(width, "speed", pi, form) for form, pi in control.speed.items()]
    for part in parts:
        require(part)
    return tuple(reach for part in parts for reach in part.reaches.values())
