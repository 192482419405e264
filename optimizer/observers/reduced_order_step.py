"""The reduced-order speed observer as the firmware runs it; `reduced_order` has its theory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import FirmwareStep, ObserverState, StateMembers
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, Member, Pair

if TYPE_CHECKING:
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver


@dataclass(frozen=True, slots=True)
class ReducedOrderGains:
    """The sampled observer, and what takes the rotation out of the voltage."""

    a: Annotated[float, Member("pole in the z plane, dimensionless")]
    b_u: Annotated[float, Member("of u_q", "rad/(s V)")]
    b_i: Annotated[float, Member("of i_q", "rad/(s A)")]
    c: Annotated[float, Member("of i_q in the estimate", "rad/(s A)")]
    l_d: Annotated[float, Member("inductance of d", "H")]
    pole_pairs: float
    half_t_s: Annotated[float, Member("half a sampling period", "s")]

    @classmethod
    def of(cls, machine: Machine, observer: ReducedOrderObserver) -> ReducedOrderGains:
        """Those of an observer.

        Of the machine it takes L_d for the coupling and the number of pole pairs.
        """
        numbers = (observer.a, observer.b_u, observer.b_i, observer.c, machine.l_d)
        return cls(*numbers, float(machine.pole_pairs), 0.5 * observer.t_s)


MEMBERS = StateMembers(
    (("i", Member("last current", "A")),),
    (
        ("zeta", Member("state of the observer", "rad/s, mechanical")),
        ("omega_m", Member("estimated mechanical speed", "rad/s")),
    ),
    Member("last electrical angle, as given", "rad"),
)


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    return ObserverState((Dq(zero, zero),), theta_e, omega_e, False, (zero, zero))


def step(
    gains: ReducedOrderGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic,
    theta_e: Reals,
) -> ObserverState:  # fmt: skip
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A
    and of the angle ``theta_e`` in rad, shapes (N,).

    The first step knows no voltage and takes the speed of the start.
    """
    o, (last,), (zeta, _) = maths, state.vectors, state.scalars
    theta = o.let("theta", o.wrap(theta_e))
    now = o.let("now", o.park(i, o.rotation(theta)))
    if not state.started:
        zeta = o.let("zeta", (state.omega_e / gains.pole_pairs) + (gains.c * now.q))
    else:
        o.remark("the voltage rested while the rotor turned: seen from the middle of the period")
        middle = o.let("middle", o.wrap(state.theta_e + gains.half_t_s * state.omega_e))
        v_q = o.let("v_q", o.park(v, o.rotation(middle)).q)
        u_q = o.let("u_q", v_q - state.omega_e * (gains.l_d * last[0]))
        zeta = o.let("zeta", (gains.a * zeta + gains.b_u * u_q) + gains.b_i * last[1])
    omega_m = o.let("omega_m", zeta - gains.c * now.q)
    return ObserverState((now,), theta, gains.pole_pairs * omega_m, scalars=(zeta, omega_m))


SPEED_STEP = FirmwareStep(
    code="reduced_order",
    gains=ReducedOrderGains,
    start=start,
    step=step,
    members=MEMBERS,
    stepped=(
        "One sample: v in V acted over the period that ends at the sampling instant of i in A and "
        "of the angle theta_e in rad."
    ),
    further=("theta_e",),
)
