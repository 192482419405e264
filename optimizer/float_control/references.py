"""How the references of the control move: no faster than their slopes, off the voltage's end."""

from __future__ import annotations

from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import Control, ControlGains
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq


def torque_ramp(o: Arithmetic, gains: ControlGains, state: Control, torque: Reals) -> Reals:
    """The torque reference in N m, no faster than its slope; not-a-number asks for none."""
    assert gains.references is not None
    assert state.references is not None
    step, last = gains.references.torque_step, state.references.torque
    assert step is not None
    assert last is not None
    asked = o.let("asked", o.choose(o.is_number(torque), torque, o.full(0.0, torque)))
    high, low = o.let("high", last + step), o.let("low", last - step)
    ramped = o.choose(asked > high, high, o.choose(asked < low, low, asked))
    state.references.torque = given = o.let("given", ramped)
    return given


def weakened(o: Arithmetic, gains: ControlGains, state: Control, v_max: Reals, reference: Dq) -> Dq:
    """The current references with what the voltage lacks taken from the d current: an integrator
    whose output is 0 or below. Within the limit the q current gives way.
    """
    assert gains.references is not None
    assert state.references is not None
    moving, kept = gains.references, state.references
    limit, most, gain = moving.i_max, moving.feedback_max, moving.feedback
    assert limit is not None
    assert most is not None
    assert gain is not None
    assert kept.square is not None
    assert kept.added is not None
    lack = o.let("lack", v_max * v_max - kept.square)
    sum_ = o.let("sum", kept.added + gain * lack)
    below = o.let("below", o.choose(sum_ < 0.0, sum_, o.full(0.0, sum_)))
    added = o.let("added", o.choose(below > -most, below, -most))
    shifted = o.let("shifted", reference.d + added)
    d = o.let("d", o.choose(shifted > -limit, shifted, -limit))
    left = o.let("left", limit * limit - d * d)
    room = o.let("room", o.choose(left > 0.0, left, o.full(0.0, left)))
    kept.added = added

    def at_the_edge() -> Reals:
        edge = o.let("edge", o.root(room))
        return o.choose(reference.q < 0.0, -edge, edge)

    beyond = (added < 0.0) & (reference.q * reference.q > room)
    return Dq(d, o.cases("q", (beyond, at_the_edge), otherwise=lambda: reference.q))


def current_ramp(o: Arithmetic, gains: ControlGains, state: Control, reference: Dq) -> Dq:
    """The current references, no faster than their slope, along a straight line."""
    assert gains.references is not None
    assert state.references is not None
    assert state.references.current is not None
    step, last = gains.references.current_step, state.references.current
    assert step is not None
    d, q = o.let("d", reference.d - last.d), o.let("q", reference.q - last.q)
    square = o.let("square", d * d + q * q)

    def moved() -> Dq:
        share = o.let("share", step / o.root(square))
        return Dq(last.d + share * d, last.q + share * q)

    given = o.cases("given", (square > step * step, moved), otherwise=lambda: reference)
    state.references.current = given
    return given
