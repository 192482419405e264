"""What the emitted control of a phase machine is made of: the words that choose its code."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES

if TYPE_CHECKING:
    from dqforge.machines.names import CurrentFrame, Feedforward, ModulationName, Topology


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
    def slopes(self) -> bool:
        """Whether the slope of the back-EMF is read."""
        return self.follows and self.feedforward == "measured"

    @property
    def multiples(self) -> tuple[int, ...]:
        """Multiples of the angle that the harmonic integrators need, ascending."""
        return tuple(sorted({abs(order) for order in (*self.plane, *self.zero)}))

    @property
    def has_balance_share(self) -> bool:
        """Whether the share of the zero sequence in the references changes in the running drive."""
        return self.by_torque and (self.midpoint or (self.neutral and self.frame == "dqx"))
