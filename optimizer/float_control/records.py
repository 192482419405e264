"""Gains, state and samples of the control, with units."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq, Member

# Beyond these a sample in rad/s, or a squared voltage in V^2, counts as unknown; so does
# not-a-number.
UNKNOWN, UNKNOWN_SQUARE = 1.0e15, 1.0e30


@dataclass(frozen=True, slots=True)
class PiGains:
    """Gains of a PI controller: kp, ki times the sampling period, and what the integral takes back
    per unit of excess.
    """

    kp: Reals
    ki_ts: Reals
    tracking: Reals


@dataclass(slots=True)
class Pi:
    """State of a PI controller."""

    integral: Reals


@dataclass(frozen=True, slots=True)
class ReferenceGains:
    """How fast references move, and what weakens the field where the voltage is at its end."""

    torque_step: Annotated[
        Reals | None, Member("largest change of the torque in a sample", suffix="Nm")
    ]
    current_step: Annotated[
        Reals | None,
        Member("largest change of the vector of the current reference in a sample", suffix="A"),
    ]
    feedback: Annotated[
        Reals | None, Member("d current per sample and lack of squared voltage", suffix="A_per_V2")
    ]
    feedback_max: Annotated[Reals | None, Member("largest d current that it adds", suffix="A")]
    i_max: Annotated[Reals | None, Member("limit of the vector", suffix="A")]


@dataclass(slots=True)
class References:
    """What the moving references keep."""

    torque: Annotated[Reals | None, Member("N m")]
    current: Annotated[Dq | None, Member("A")]
    square: Annotated[Reals | None, Member("of the voltage that the controllers asked for, V^2")]
    added: Annotated[Reals | None, Member("d current, 0 or below, A")]


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Everything that can be tuned; the constant behind it holds the values of the design.

    Numbers, or arrays of shape (N,) where the drives differ; ``references`` is None where none are
    asked for, and so are its members.
    """

    d: Annotated[PiGains, Member("V/A")]
    q: Annotated[PiGains, Member("V/A")]
    speed: Annotated[PiGains, Member("N m s/rad; all 0: no speed loop")]
    pole_pairs: Reals
    r_s: Annotated[Reals, Member("phase resistance", suffix="Ohm")]
    l_d: Annotated[Reals, Member("decoupling; 0 switches it off", suffix="H")]
    l_q: Annotated[Reals, Member("decoupling; 0 switches it off", suffix="H")]
    psi_pm: Annotated[Reals, Member("back-EMF feedforward; 0 switches it off", suffix="Wb")]
    voltage_share: Annotated[
        Reals, Member("largest phase-voltage amplitude over the DC-link voltage")
    ]
    advance: Annotated[
        Reals,
        Member(
            "from the sampling instant to the middle of the period in which the voltage acts",
            suffix="s",
        ),
    ]
    torque_max: Annotated[Reals, Member("limit of the speed controller's output", suffix="Nm")]
    speed_filter: Annotated[Reals, Member("share of a new speed sample, 1 without filter")]
    ratio: Annotated[Reals, Member("current samples per speed sample", whole=True)]
    references: ReferenceGains | None = None


@dataclass(slots=True)
class Control:
    """What changes from sample to sample; control_start begins it.

    Of N drives, arrays of shape (N,). ``added`` is None where no voltage is injected, ``held``
    without a start-up, ``references`` where none move.
    """

    d: Annotated[Pi, Member("V")]
    q: Annotated[Pi, Member("V")]
    speed: Annotated[Pi, Member("N m")]
    reference: Annotated[Dq, Member("current references, A")]
    v: Annotated[
        AlphaBeta,
        Member("voltage that the last duty cycles make, V; it acts from the next sample on"),
    ]
    omega_m: Annotated[Reals, Member("filtered mechanical speed, rad/s")]
    torque: Annotated[Reals, Member("torque reference, N m")]
    count: Annotated[Reals, Member("current samples since the speed controller ran", whole=True)]
    added: Annotated[
        AlphaBeta | None,
        Member("to be made besides, V; write it before a step, 0 where nothing is injected"),
    ] = None
    held: Annotated[
        Dq | None, Member("currents that the start-up adds to the references of a torque, A")
    ] = None
    references: References | None = None


@dataclass(frozen=True, slots=True)
class Measured:
    """Samples of one instant."""

    i: Annotated[Abc, Member("phase currents, A")]
    theta_e: Annotated[Reals, Member("electrical angle of the d axis from phase a, rad")]
    omega_m: Annotated[Reals, Member("mechanical speed, rad/s")]
    v_dc: Annotated[Reals, Member("DC-link voltage, V; above 0")]


def at_rest(
    count: int, gains: ReferenceGains | None, *, injects: bool = False, holds: bool = False
) -> Control:
    """No torque, no voltage, of so many drives in single precision.

    Args:
        count: Number of drives.
        gains: Which references move, None for none.
        injects: Whether a voltage is made besides.
        holds: Whether a start-up adds currents to the references of a torque.
    """

    def zero() -> Reals:
        return np.zeros(count, dtype=np.float32)

    def pair() -> Dq:
        return Dq(zero(), zero())

    moving = None
    if gains is not None:
        fed = gains.feedback is not None
        moving = References(
            None if gains.torque_step is None else zero(),
            None if gains.current_step is None else pair(),
            zero() if fed else None,
            zero() if fed else None,
        )
    return Control(
        d=Pi(zero()),
        q=Pi(zero()),
        speed=Pi(zero()),
        reference=pair(),
        v=AlphaBeta(*pair()),
        omega_m=zero(),
        torque=zero(),
        count=np.zeros(count, dtype=np.uint32),
        added=AlphaBeta(*pair()) if injects else None,
        held=pair() if holds else None,
        references=moving,
    )


# Members of `ControlGains` that are numbers, in their order.
NUMBERS = tuple(
    member.name
    for member in fields(ControlGains)
    if member.name not in ("d", "q", "speed", "ratio", "references")
)
