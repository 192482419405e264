"""What Matsui's voltage and current model share: the usual tuning, and what a period showed."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.matsui_model import Matsui
from dqforge.optimizer.observers.parts import USUAL_WIDTH, ObserverState, ObserverTuning
from dqforge.optimizer.observers.sampled_machine import SampledGains, matrix_entries, next_currents
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, Member, Pair, limited


def usual_matsui(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Angle and speed at 200 rad/s, or 1/20 of the sampling rate in rad/s if less:
    a voltage error costs less so.
    """
    width = min(USUAL_WIDTH, 0.05 / t_s)
    return ObserverTuning(width, width, omega_floor=0.02 * omega_max)


@dataclass(frozen=True, slots=True)
class ShownGains:
    """What the machine shows of the errors."""

    salient: Annotated[float, Member("L_d - L_q", "H")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    omega_min_2: Annotated[float, Member("square of the least speed", "rad^2/s^2")]


class ShownErrors(NamedTuple):
    """What a voltage difference shows."""

    angle: Annotated[Reals, Member("error of the angle", "rad")]
    speed: Annotated[Reals, Member("error of the speed", "rad/s")]


def shown_gains(observer: Matsui) -> ShownGains:
    """What the firmware needs to tell the errors.

    Args:
        observer: The estimator.
    """
    machine = observer.model.machine
    return ShownGains(machine.l_d - machine.l_q, machine.psi_pm, observer.omega_min**2)


def shown_errors(o: Arithmetic, shown: ShownGains, omega: Reals, v: Pair, i: Pair) -> ShownErrors:
    """Errors of angle and speed that a voltage difference in V in the middle of the period shows.

    Args:
        shown: Of `shown_gains`.
        omega: Electrical speed in rad/s.
        v, i: Voltage difference in V and currents in A, in rotor coordinates.
    """
    active = o.let("active", shown.psi_pm + shown.salient * i[0], "flux linkage, Wb")
    cross = o.let("cross", shown.salient * i[1])
    scale = o.let("scale", 1.0 / (active * active + cross * cross))
    share = o.let("share", omega / (omega * omega + shown.omega_min_2))
    return ShownErrors(
        (scale * (cross * v[1] - active * v[0])) * share, scale * (active * v[1] + cross * v[0])
    )


@dataclass(frozen=True, slots=True, eq=False)
class ShownGap:
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn,
    current gap.
    """

    theta: Reals
    now: Dq
    entries: Reals
    cosine: Reals
    half: Reals
    gap: Dq


def shown_gap(
    model: SampledGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ShownGap:
    """What the period before a sample showed.

    Args:
        model: The sampled machine.
        state: Before the sample.
        v, i: Voltage in V that acted over the period, current in A at its end, alpha and beta.
        maths: The arithmetic.
    """
    o = maths
    turn = o.let("turn", o.rotation(state.theta_e))
    advance = o.let("advance", model.t_s * state.omega_e, "angle of the period, rad")
    theta = o.let("theta", o.wrap(state.theta_e + advance), "foretold angle, rad")
    now = o.let("now", o.park(i, o.rotation(theta)))
    x = o.let("x", limited(o, advance, model.x_max))
    half = o.let("half", 0.5 * x)
    cosine = o.let("cosine", 1.0 - 0.5 * (half * half))
    e = matrix_entries(o, model, x)
    before = o.let("before", o.park(state.vectors[0], turn))
    foretold = next_currents(e, before, o.let("u", o.park(v, turn)))
    gap = o.let("gap", Dq(now.d - foretold.d, now.q - foretold.q), "of the currents, A")
    return ShownGap(theta, now, e, cosine, half, gap)
