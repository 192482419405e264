"""PI controller, and the speed loop around the current control."""

from __future__ import annotations

from collections.abc import Callable

from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import UNKNOWN, Control, ControlGains, Pi, PiGains
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, limited, where


def pi_output(o: Arithmetic, gains: PiGains, state: Pi, error: Reals) -> Reals:  # noqa: ARG001
    """Output of a PI controller: kp error and the integral up to this sample (backward Euler)."""
    output: Reals = gains.kp * error + (state.integral + gains.ki_ts * error)
    return output


def pi_update(o: Arithmetic, gains: PiGains, state: Pi, error: Reals, excess: Reals) -> None:  # noqa: ARG001
    """The integral's step; excess is the limited less the unlimited output, 0 within the limits
    (back-calculation).
    """
    state.integral = state.integral + (gains.ki_ts * error + gains.tracking * excess)


def speed_loop(
    o: Arithmetic, gains: ControlGains, state: Control, omega_m: Reals, reference: Reals
) -> Reals:
    """Torque reference in N m for a mechanical speed in rad/s; call it at every current sample, it
    works at every ratio-th.
    """
    known = o.magnitude(omega_m) < UNKNOWN
    moved = state.omega_m + gains.speed_filter * (omega_m - state.omega_m)
    speed = o.let("speed", o.choose(known, moved, state.omega_m), "an unknown one keeps the last")
    later = o.let("later", state.count + 1)
    due = (state.count < 1) & (o.magnitude(reference) < UNKNOWN)
    state.omega_m = speed
    where(o, due, _controlled(o, gains, state, speed, reference), state)
    state.count = o.choose(later < gains.ratio, later, o.full(0, later))
    return o.let("torque", state.torque)


def _controlled(
    o: Arithmetic, gains: ControlGains, state: Control, speed: Reals, reference: Reals
) -> Callable[[], None]:
    def run() -> None:
        error = o.let("error", reference - speed)
        wanted = o.let("wanted", o.call(pi_output, gains.speed, state.speed, error))
        most = o.let("most", gains.torque_max)
        within = limited(o, wanted, most)
        if gains.references is not None and gains.references.torque_step is not None:
            step = o.let("step", o.real(gains.ratio) * gains.references.torque_step)
            up, down = o.let("up", state.torque + step), o.let("down", state.torque - step)
            high = o.let("high", o.choose(up < most, up, most))
            low = o.let("low", o.choose(down > -most, down, -most))
            within = o.choose(wanted > high, high, o.choose(wanted < low, low, wanted))
        given = o.let("given", within)
        o.call(pi_update, gains.speed, state.speed, error, given - wanted)
        state.torque = given

    return run
