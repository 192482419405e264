"""Figures 4.1 to 4.3 of paper 002: the controller as it is drawn, and what its parts put out over
the angle.

Figure 4.2 has references (4.4) to (4.6) and PI controllers in dqy alone; Figure 4.3 adds the
coupling (4.10) to (4.15) and what the thesis calls compensation of the back-EMF, (4.16) to (4.18).
At a constant torque i_qy is constant and i_dy = i_0y = 0, so that these terms are

    d: A omega i_qy     q: H omega i_qy + omega phi_m sqrt(3/2)/a_y^2     0: F omega i_qy
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frame_transforms import spectral_derivative, to_frame
from dqforge.machines.phase_machines.frames import thesis_shapes
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT
from dqforge.reports.papers.paper002_definitions.model_equations import (
    FrameQuantities,
    ShapedMachine,
    frame_quantities,
    model_blocks,
)

# Largest flux in Wb of the machine with a trapezoid that stands beside the shipped one; chosen.
TRAPEZOID_FLUX = 0.2
_ANGLES = 7200


@dataclass(frozen=True, slots=True, eq=False)
class Compensation:
    """Voltages of Figure 4.3 over the angle, power-invariant and divided by a_y, in V, shape (N,).

    ``emf`` is that of the q axis; ``coupling`` of d, q and 0, shape (3, N), all but the back-EMF
    and the resistance. ``i_qy`` in A is the constant reference; ``theta`` in rad. ``theta_x`` and
    ``theta_y`` in rad, ``frame`` the other quantities.
    """

    name: str
    theta: FloatArray
    theta_x: FloatArray
    theta_y: FloatArray
    frame: FrameQuantities
    i_qy: float
    emf: FloatArray
    coupling: FloatArray

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest of every quantity: angles in deg, voltages in V, the others without
        unit.
        """
        values = {
            "a_x": self.frame.a_x,
            "a_y": self.frame.a_y,
            "theta_x": np.degrees(self.theta_x),
            "theta_y": np.degrees(self.theta_y),
            "turn": self.frame.turn,
            "theta_y_rate": self.frame.rate,
            "growth": self.frame.growth,
            "emf": self.emf,
            "coupling_d": self.coupling[0],
            "coupling_q": self.coupling[1],
            "coupling_0": self.coupling[2],
        }
        return {name: (float(np.min(part)), float(np.max(part))) for name, part in values.items()}


def shipped_machine(machine: PhaseMachine) -> ShapedMachine:
    """A machine whose back-EMF is smooth, at the angles of its grid."""
    phi_m = float(np.max(np.abs(machine.flux)))
    shape = machine.flux / phi_m
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    slope = spectral_derivative(shape)
    return ShapedMachine(theta, shape, slope, machine.l_s, machine.m_s, machine.r_s, phi_m)


def trapezoid_machine(machine: PhaseMachine) -> ShapedMachine:
    """A machine with the thesis's trapezoid, else like another; at angles between the corners."""
    nodes = thesis_shapes(_ANGLES)["trapezoid"]
    step = 2.0 * np.pi / _ANGLES
    ahead = np.roll(nodes, -1, axis=1)
    # Its lines are straight and their corners nodes: middle and slope are exact.
    theta = np.asarray(step * (np.arange(_ANGLES) + 0.5), dtype=np.float64)
    shape: FloatArray = 0.5 * (nodes + ahead)
    slope: FloatArray = (ahead - nodes) / step
    return ShapedMachine(theta, shape, slope, machine.l_s, machine.m_s, machine.r_s, TRAPEZOID_FLUX)


def compensation(
    name: str, machine: ShapedMachine, pole_pairs: int, torque: float, omega_e: float
) -> Compensation:
    """Terms of Figure 4.3 of a machine for a torque in N m at a speed in rad/s (electrical)."""
    frame = frame_quantities(machine)
    blocks = model_blocks(frame, machine.l_s, machine.m_s)
    d, q, _ = to_frame("dq0", machine.theta, machine.shape, machine.shape)
    i_qy = torque / (pole_pairs * machine.phi_m * POWER_INVARIANT)
    return Compensation(
        name=name,
        theta=machine.theta,
        theta_x=np.arctan2(-d, q),
        theta_y=np.arctan2(frame.sine, frame.cosine),
        frame=frame,
        i_qy=i_qy,
        emf=omega_e * machine.phi_m * POWER_INVARIANT / frame.a_y**2,
        coupling=omega_e * i_qy * np.stack([blocks[block] for block in ("A", "H", "F")]),
    )
