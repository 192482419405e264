"""Which frame the currents of a phase machine are controlled in, and which ones it cannot have."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.machines.transforms import clarke_matrix

# Distance of the back-EMF from its fundamental, over the fundamental's peak, up to which constant
# dq currents serve: the torque ripple stays below twice that.
SINUSOIDAL = 0.005

# Least length of the back-EMF vector over its largest for constant torque: the current for a torque
# grows as the inverse.
WEAKEST = 0.05

_NO_NEUTRAL = {
    "three-wire": "its star point is not connected",
    "six-leg-isolated": "no current returns from one link to the other",
    "diode-neutral": (
        "a current out of its neutral holds the neutral at the upper rail, where no phase voltage "
        "is positive, and motoring currents of dqy ask for positive ones at that angle"
    ),
}


@dataclass(frozen=True, slots=True)
class FrameChoice:
    """A frame, and why it is the one that the machine asks for."""

    frame: CurrentFrame
    reason: str


def flux_axes(machine: AnyPhaseMachine) -> FloatArray:
    """Back-EMF over electrical speed in Wb on alpha, beta and 0 (mean of the phases),
    shape (3, N).

    Args:
        machine: The machine in phase quantities.
    """
    return np.asarray(clarke_matrix() @ machine.flux)


def uses_zero_sequence(frame: CurrentFrame, topology: Topology) -> bool:
    """Whether the currents for a torque have a zero sequence.

    Only dqy and the table share the torque among all three axes; dqx is the frame of currents
    without zero sequence on any topology, and dq that of sinusoidal ones.

    Args:
        frame: The frame.
        topology: How the phases are fed.
    """
    return TOPOLOGIES[topology].neutral and frame in ("dqy", "table")


def zero_sequence_inductance(machine: AnyPhaseMachine, choke: float = 0.0) -> float:
    """Inductance L_0 in H that a zero-sequence current meets: L_s + 2 M_s, and 3 L_n of a choke.

    That of a salient machine is the mean over the angle.

    Args:
        machine: The machine in phase quantities.
        choke: Inductance L_n in the neutral in H.
    """
    if isinstance(machine, SalientPhaseMachine):
        return float(np.mean(np.sum(machine.inductance, axis=(1, 2))) / 3.0) + 3.0 * choke
    return machine.l_s + 2.0 * machine.m_s + 3.0 * choke


def distance_from_sine(machine: AnyPhaseMachine, topology: Topology) -> float:
    """Largest distance of the back-EMF vector from its fundamental, over the fundamental's peak.

    The zero sequence counts where the legs drive one.

    Args:
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    axes = flux_axes(machine)
    angle = phases.theta
    axes[0] += machine.psi_pm * np.sin(angle)
    axes[1] -= machine.psi_pm * np.cos(angle)
    used = axes if TOPOLOGIES[topology].neutral else axes[:2]
    return float(np.max(np.linalg.norm(used, axis=0)) / machine.psi_pm)


def _weakest(machine: AnyPhaseMachine, *, zero: bool) -> tuple[float, float]:
    """Least length of the back-EMF vector over its largest, and the angle in degrees.

    With ``zero`` all three axes count, weighted as the torque weighs them.
    """
    axes = flux_axes(machine) * np.array([[1.0], [1.0], [np.sqrt(2.0)]])
    length = np.linalg.norm(axes if zero else axes[:2], axis=0)
    where = int(np.argmin(length))
    largest = float(np.max(length))
    share = float(length[where]) / largest if largest > 0.0 else 0.0
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    return share, float(np.degrees(phases.theta[where]))


def tables_obstacle(machine: AnyPhaseMachine | None) -> str:
    """Why a machine has no frame tables, and what to write instead; empty where it has.

    Args:
        machine: The machine, None where its back-EMF is sinusoidal.
    """
    if machine is None:
        return (
            "with a sinusoidal back-EMF dqx and dqy are dq; leave the key out, or write "
            "machine.model: waveform with its back_emf"
        )
    if isinstance(machine, SalientPhaseMachine):
        return (
            "the decoupling terms of paper 002 hold for machines without saliency; leave out "
            "frame_tables, or machine.inductance_harmonics"
        )
    return ""


def frame_obstacle(frame: CurrentFrame, machine: AnyPhaseMachine, topology: Topology) -> str:
    """Why a machine on a topology cannot be controlled in a frame, with what to write instead.

    Empty where it can.

    Args:
        frame: The frame.
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    if frame == "dq":
        return ""
    if isinstance(machine, SalientPhaseMachine) and frame != "table":
        return (
            f"{frame} needs inductances that do not vary with the angle, this machine has "
            "inductance_harmonics; write table or dq"
        )
    neutral = TOPOLOGIES[topology].neutral
    if frame == "dqy" and not neutral:
        others = [
            name for name in ("dqx", "table") if not frame_obstacle(name, machine, topology)
        ] or ["dq"]
        return (
            f"dqy needs a zero-sequence current, and {topology} drives none: "
            f"{_NO_NEUTRAL[topology]}; write {' or '.join(others)}"
        )
    share, where = _weakest(machine, zero=frame == "table" and neutral)
    if share >= WEAKEST:
        return ""
    vector = "vector" if frame == "table" and neutral else "alpha-beta vector"
    instead = (
        "write table"
        if frame != "table" and not frame_obstacle("table", machine, topology)
        else "write dq, and accept the torque ripple"
    )
    return (
        f"the back-EMF's {vector} falls to {100.0 * share:.2g} % of its largest at {where:.0f} "
        f"degrees, {frame} needs {100.0 * WEAKEST:.0f} %: the current for constant torque would "
        f"grow without bound; {instead}"
    )


def choose_frame(machine: AnyPhaseMachine, topology: Topology) -> FrameChoice:
    """The frame of a design that names none.

    Args:
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    distance = distance_from_sine(machine, topology)
    away = f"the back-EMF is up to {100.0 * distance:.2g} % of its peak off a sine"
    if distance <= SINUSOIDAL:
        return FrameChoice("dq", f"{away}, sinusoidal currents serve up to {SINUSOIDAL:.1%}")
    obstacle = frame_obstacle("table", machine, topology)
    if obstacle:
        return FrameChoice("dq", obstacle.split(";")[0])
    return FrameChoice("table", f"{away}, references over the angle keep the torque constant")


def controlled_frame(
    wanted: CurrentFrame | None, machine: AnyPhaseMachine, topology: Topology
) -> CurrentFrame:
    """The frame that a design has: the one it names, else the one that its machine asks for.

    Args:
        wanted: What the design names, None for nothing.
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    return choose_frame(machine, topology).frame if wanted is None else wanted
