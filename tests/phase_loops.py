"""Current control of paper 002's machine as its stability was published, and its plants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from phase_drives import T_S, near_sinusoidal, plain_control

from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.optimizer.phase_control.judged_box import PhasePlants
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    PhaseControl,
    PhaseShape,
)

INDUCTANCES = (8e-3, 8e-3, 5e-3)
PSI = 0.2233
HARMONICS = HarmonicGains((-5, 7, -11, 13), (3, 9), 60.0, 1.0 / (6.0 * T_S), 1.0)


def harmonic_shape(nodes: int = 360) -> PhaseShape:
    """Back-EMF of paper 002's machine."""
    return PhaseShape(near_sinusoidal(nodes).flux[:1])


def page_control(
    frame: CurrentFrame = "table",
    feedforward: Feedforward = "references",
    *,
    topology: Topology = "four-leg",
    bandwidth: float = 500.0,
    inductances: tuple[float, float, float] = INDUCTANCES,
    harmonics: HarmonicGains | None = None,
) -> PhaseControl:
    """Control with kp = omega_c L and ki = kp omega_c/10 of each axis, ``bandwidth`` in Hz."""
    omega = 2.0 * np.pi * bandwidth
    d, q, zero = (AxisGains(omega * size, omega * size * omega / 10.0) for size in inductances)
    return plain_control(
        near_sinusoidal(360), topology, frame, feedforward, bandwidth,
        inductances=inductances, gains=(d, q, zero), harmonics=harmonics,
    )  # fmt: skip


def with_one_gain(control: PhaseControl) -> PhaseControl:
    """The same with the gains of the plane on the 0 axis too."""
    d, q, _ = control.gains
    return replace(control, gains=(d, q, d))


def plants_of(
    control: PhaseControl, share: float = 1.0, capacitance: float | None = None
) -> PhasePlants:
    """One winding, its inductances a share of those that the control is made for."""
    l_d, l_q, l_0 = (np.array([share * size]) for size in control.inductances)
    held = None if capacitance is None else np.array([capacitance])
    return PhasePlants(np.array([control.r_s]), l_d, l_q, l_0, np.ones(1), held)


def speed_of(samples: float) -> float:
    """Electrical speed in rad/s of so many samples per period."""
    return 2.0 * np.pi / (samples * T_S)
