"""The two machines of which figures of every topology are known."""

from __future__ import annotations

import numpy as np

from dqforge.machines.phase_machines.phase_machine import PhaseMachine

FUNDAMENTAL_P = 0.2233  # In Wb.


def paper_machine(angles: int = 360) -> PhaseMachine:
    """That of paper 002: third, fifth and seventh order of 12, 3 and 1 %; L_0 = 5 mH."""
    shares = np.array([1.0, 0.12, 0.03, 0.01])
    return PhaseMachine.from_harmonics(
        [1, 3, 5, 7],
        FUNDAMENTAL_P * shares,
        np.zeros(4),
        pole_pairs=2,
        r_s=1.0,
        l_s=7e-3,
        m_s=-1e-3,
        i_max=14.0,
        angles=angles,
    )


def trapezoid_machine(angles: int = 360) -> PhaseMachine:
    """The same with a back-EMF that is flat over 120 degrees at 0.2 Wb."""
    theta = 2.0 * np.pi * (np.arange(angles) / angles - np.arange(3)[:, np.newaxis] / 3.0)
    triangle = np.arcsin(np.sin(theta)) / (np.pi / 6.0)
    return PhaseMachine(2, 1.0, 7e-3, -1e-3, -0.2 * np.clip(triangle, -1.0, 1.0), 14.0)
