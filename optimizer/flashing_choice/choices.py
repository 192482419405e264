"""The rows of the comparison: which topology with which controller, and what is known of each."""

from __future__ import annotations

from dataclasses import field

from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.phase_control.phase_controller import PhaseControl

# What the torque ripple is asked for besides: an offset of one current sensor, noise of all of
# them, an inductance of the plant 30 % lower, and a back-EMF 5 % higher than the firmware's.
COMPARED: tuple[Topology, ...] = ("three-wire", "four-leg", "six-leg", "split-capacitor")
DEVIATIONS = ("offset", "noise", "inductance", "back_emf")
OFFSET = NOISE = 30e-3  # Of a sensor in A; the noise r.m.s.

# Relative deviations of the plant from the model in the firmware.
INDUCTANCE, BACK_EMF = -0.3, 0.05


@dataclass(frozen=True, slots=True)
class RippleFigures:
    """Torque ripple, peak to peak of the means over a PWM period, over the mean torque.

    Args:
        plain: With the design's dead time.
        deviating: With each of `DEVIATIONS` besides.
    """

    plain: float
    deviating: dict[str, float]


@dataclass(frozen=True, slots=True)
class FlashRow:
    """A topology with a controller at the operating point.

    Args:
        topology, frame: What is compared; ``table`` has harmonic integrators, the others none.
        obstacle: Why this cannot be run here; empty where it can. The numbers are NaN where it
            cannot.
        copper: Copper loss in W, of the switching's own currents and the neutral's conductor too.
        bridge: Loss of all legs in W; NaN where the design has no device.
        neutral_leg: Loss of the neutral's leg in W, NaN where there is none or it is not known.
        link: Voltage of the link in V that is needed, with what dead time takes.
        neutral: R.m.s. in A of the neutral current, that of the switching included.
        ripple: By closed form: references, and what the loop leaves of dead time and deviations.
        constants: Bytes of the table of the back-EMF.
        control: Current control of the row, None where it cannot be run.
        simulated: From the emitted C in the compiled simulation; None where it was not run.
        cycles: Mean estimate of a sample on the design's core, (low, high); None where it was not
            measured.
    """

    topology: Topology
    frame: CurrentFrame
    obstacle: str
    copper: float
    bridge: float
    neutral_leg: float
    link: float
    neutral: float
    ripple: RippleFigures | None
    constants: int
    control: PhaseControl | None = field(default=None, repr=False)
    simulated: RippleFigures | None = None
    cycles: tuple[float, float] | None = None

    @property
    def losses(self) -> float:
        """Copper and bridge in W; the copper alone where the bridge is not known."""
        return self.copper + (0.0 if self.bridge != self.bridge else self.bridge)

    @property
    def ripple_known(self) -> RippleFigures | None:
        """Simulated where it was simulated, else by closed form."""
        return self.ripple if self.simulated is None else self.simulated


def compared_frames(topology: Topology) -> tuple[CurrentFrame, ...]:
    """Controllers that are compared on a topology.

    Args:
        topology: Without a neutral there is no dqy.
    """
    if TOPOLOGIES[topology].neutral:
        return ("dq", "dqx", "dqy", "table")
    return ("dq", "dqx", "table")
