"""Gains, state and samples of the control of phase machines, with units."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from dqforge.machines.names import CurrentFrame, Feedforward, ModulationName, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import Pi, PiGains
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq, Member, Rotation


class Alphabetazero(NamedTuple):
    """Stationary coordinates with the zero sequence, the mean of the phases."""

    alpha: Reals
    beta: Reals
    zero: Reals


@dataclass(frozen=True, slots=True)
class Shape:
    """Back-EMF over electrical speed in Wb at equal steps of the angle; the last entry repeats the
    first. Of phase a where there is one row.
    """

    flux: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class TorqueLimit:
    """Largest torque in N m over electrical speed in rad/s and DC-link voltage in V."""

    omega_e: Any
    v_dc: Any
    torque: Any


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Everything that can be tuned.

    Numbers, or arrays of shape (N,) where the drives differ; members are None where nothing needs
    them.
    """

    d: PiGains
    q: PiGains
    zero: PiGains
    speed: PiGains
    pole_pairs: Reals
    r_s: Annotated[Reals, Member("phase resistance", suffix="Ohm")]
    l_d: Annotated[Reals, Member("inductances of the d, q and 0 axes", suffix="H")]
    l_q: Annotated[Reals, Member("", suffix="H")]
    l_0: Annotated[Reals, Member("", suffix="H")]
    psi_pm: Annotated[
        Reals,
        Member("fundamental of the back-EMF over electrical speed, peak", suffix="Wb"),
    ]
    voltage_share: Reals
    t_s: Annotated[Reals, Member("sampling period", suffix="s")]
    sampling: Annotated[Reals, Member("1 over the sampling period", suffix="Hz")]
    torque_max: Annotated[Reals, Member("limit of the torque", suffix="Nm")]
    speed_filter: Reals
    fade_end: Reals
    fade: Annotated[Reals, Member("", suffix="s")]
    harmonic_rate: Reals | None
    harmonic_fade: Annotated[Reals | None, Member("", suffix="s")]
    harmonic_error_max: Annotated[Reals | None, Member("", suffix="A")]
    balance: Annotated[Reals | None, Member("", suffix="A_per_V")]
    zero_fade: Annotated[Reals | None, Member("", suffix="s")]
    ratio: Annotated[Reals, Member("current samples per speed sample", whole=True)]
    references: ClassVar[None] = None  # None of them moves by a slope.
    torque_limit: Annotated[TorqueLimit | None, Member("", pointed=True)]
    shape: Annotated[Shape, Member("", pointed=True)]


@dataclass(slots=True)
class Control:
    """What changes from sample to sample.

    Of N drives, arrays of shape (N,). Members are None where nothing needs them.
    """

    d: Pi
    q: Pi
    zero: Pi | None
    speed: Pi
    harmonic: tuple[AlphaBeta, ...]
    harmonic_zero: tuple[AlphaBeta, ...]
    reference: Dq
    v: AlphaBeta
    v_0: Reals
    omega_m: Reals
    torque: Reals
    count: Annotated[Reals, Member("current samples since the speed controller ran", whole=True)]
    held: Dq | None
    open: Annotated[Reals | None, Member("phase without current", whole=True)]


@dataclass(slots=True)
class Multiples:
    """Rotations by multiples of an angle, one for each of the harmonic integrators."""

    plane: tuple[Rotation, ...] | None
    zero: tuple[Rotation, ...] | None


@dataclass(frozen=True, slots=True)
class Measured:
    """Samples of one instant."""

    i: Abc
    theta_e: Reals
    omega_m: Reals
    v_dc: Reals
    v_m: Reals | None


def blank_gains(shape: Shape, limit: TorqueLimit | None) -> ControlGains:
    """Gains whose numbers stand for any, where their names alone are asked for."""
    number: Any = 0.0
    own = PiGains(number, number, number)
    names = [member.name for member in fields(ControlGains)]
    rest = dict.fromkeys(names[4:-2], number)
    return ControlGains(own, own, own, own, **rest, torque_limit=limit, shape=shape)


def at_rest(
    count: int,
    plane: int,
    zero: int,
    *,
    neutral: bool,
    holds: bool = False,
) -> Control:
    """No torque, no voltage, of so many drives in single precision.

    Args:
        count: Number of drives.
        plane, zero: Numbers of harmonic integrators in the plane, and of the zero sequence.
        neutral: Whether the legs drive a zero sequence.
        holds: Whether a start-up adds currents to the references of a torque.
    """

    def rest() -> Reals:
        return np.zeros(count, dtype=np.float32)

    words = np.zeros((2, count), dtype=np.uint32)
    return Control(
        d=Pi(rest()),
        q=Pi(rest()),
        zero=Pi(rest()) if neutral else None,
        speed=Pi(rest()),
        harmonic=tuple(AlphaBeta(rest(), rest()) for _ in range(plane)),
        harmonic_zero=tuple(AlphaBeta(rest(), rest()) for _ in range(zero)),
        reference=Dq(rest(), rest()),
        v=AlphaBeta(rest(), rest()),
        v_0=rest(),
        omega_m=rest(),
        torque=rest(),
        count=words[0],
        held=Dq(rest(), rest()) if holds else None,
        open=words[1] if neutral else None,
    )


@dataclass(frozen=True, slots=True)
class Structure:
    """What stands in the code, beside the numbers that can be changed at run time.

    Args:
        frame, feedforward, topology, modulation: As their words say; only topologies with three
            legs and no neutral use the modulator.
        turns: Electrical periods in the table of the back-EMF.
        ratio: Current samples per speed sample.
        plane, zero: Orders of the harmonic integrators in alpha and beta, signed, and of the zero
            sequence.
        torque_limit: Whether the torque is limited by a table.
        salient: Whether the inductances of d and q differ.
        by_waveform: Whether the references are those of the header of phase currents, over torque
            and angle.
        start_up: Whether a start without encoder adds currents to the references of a torque.
    """

    frame: CurrentFrame
    feedforward: Feedforward
    topology: Topology
    modulation: ModulationName
    turns: int
    ratio: int
    plane: tuple[int, ...] = ()
    zero: tuple[int, ...] = ()
    torque_limit: bool = False
    salient: bool = False
    by_waveform: bool = False
    start_up: bool = False

    @property
    def neutral(self) -> bool:
        """Whether the legs drive a zero sequence."""
        return TOPOLOGIES[self.topology].neutral

    @property
    def midpoint(self) -> bool:
        """Whether the neutral lies on the midpoint of the link."""
        return TOPOLOGIES[self.topology].midpoint

    @property
    def legs(self) -> tuple[str, ...]:
        """Names of the duty cycles."""
        return TOPOLOGIES[self.topology].legs

    @property
    def modulated(self) -> bool:
        """Whether duty cycles come from one of the modulators of three legs."""
        return self.topology in ("three-wire", "diode-neutral")

    @property
    def by_torque(self) -> bool:
        """Whether the references follow the back-EMF."""
        return self.frame != "dq"

    @property
    def proportional(self) -> bool:
        """Whether the references are the back-EMF times what makes the torque."""
        return self.by_torque and not self.by_waveform

    @property
    def follows(self) -> bool:
        """Whether the integrators live in a frame that follows the back-EMF."""
        return self.frame in ("dqx", "dqy")

    @property
    def multiples(self) -> tuple[int, ...]:
        """Multiples of the angle that the harmonic integrators need, ascending."""
        return tuple(sorted({abs(order) for order in (*self.plane, *self.zero)}))

    @property
    def has_balance_share(self) -> bool:
        """Whether the share of the zero sequence in the references changes in the running drive."""
        return self.by_torque and (self.midpoint or (self.neutral and self.frame == "dqx"))

    def at_rest(self, count: int) -> Control:
        """The state of so many drives."""
        return at_rest(
            count,
            len(self.plane),
            len(self.zero),
            neutral=self.neutral,
            holds=self.start_up,
        )

    @property
    def acts(self) -> bool:
        """Whether the shape is read where the voltage acts."""
        return self.feedforward != "none" or self.follows

    @property
    def shaped(self) -> bool:
        """Whether the shape is read at all."""
        return self.acts or self.by_torque or self.neutral

    @property
    def turning(self) -> bool:
        """Whether angles beside that of the sample are needed."""
        return not self.follows or bool(self.multiples) or self.feedforward == "references"

    @property
    def per_rad(self) -> float:
        """Lengths of the table per rad."""
        return shortest_single(1.0 / (2.0 * np.pi * self.turns))


def shortest_single(value: float) -> float:
    """The float32 next to a number."""
    return float(np.float32(value))
