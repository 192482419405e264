"""What firmware of paper 002 needs of the frames dqx and dqy at an angle, exactly.

Power-invariant and divided by a_x and a_y, as in paper 002 and in
:mod:`dqforge.machines.phase_machines.frame_models`, where its misprints are listed.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_models import frame_model
from dqforge.machines.phase_machines.frame_transforms import (
    amplitude_factor,
    frame_rates,
    resampled,
    spectral_derivative,
    to_frame,
)
from dqforge.machines.phase_machines.frames import CLARKE
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, grid
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT

DENSE = 23_040  # Angles of an electrical period at which tables are judged; all sizes divide it.

# Length of the alpha-beta vector of the back-EMF, of which the largest phase value is 1, below
# which the frames turn faster than a table follows.
LEAST_LENGTH = 0.05

# What a table holds, in its order: factors; angles in rad; 1 + theta_x' and theta_y'; a'/a in
# 1/rad; back-EMF of the qy axis over the electrical speed in Wb; coupling of dqy in H by row and
# column.
ANGLES = ("a_x", "a_y", "theta_x", "theta_y")
RATES = ("turn_x", "rate_y", "growth_x", "growth_y")
COUPLING = ("c_dd", "c_dq", "c_d0", "c_qd", "c_qq", "c_q0", "c_0d", "c_0q", "c_00")
COLUMNS = (*ANGLES, *RATES, "emf", *COUPLING)


@dataclass(frozen=True, slots=True, eq=False)
class ExactFrames:
    """The frames at M even angles over all turns.

    ``shape`` is the back-EMF over its largest phase value phi_m in Wb (`scale`), shape (3, M);
    ``columns`` the quantities of `COLUMNS`, shape (18, M).
    """

    scale: float
    shape: FloatArray
    columns: FloatArray


def exact_frames(machine: PhaseMachine) -> ExactFrames:
    """Everything at the dense angles.

    Raises:
        InputError: The frames have no direction at an angle, or turn too fast near it.
    """
    flux = resampled(machine.flux, machine.turns * DENSE)
    scale = float(np.max(np.abs(flux)))
    shape, theta = flux / scale, grid(machine.turns * DENSE, machine.turns)
    _require_length(shape, theta)
    slope = spectral_derivative(shape, machine.turns)
    rates = frame_rates(theta, shape, slope)
    _, size, zero = to_frame("dqx", theta, shape, shape)
    model = frame_model("dqy", theta, shape, slope, machine.l_s, machine.m_s, scaled=True)
    columns = (
        amplitude_factor("dqx", shape),
        amplitude_factor("dqy", shape),
        _unwrapped(theta, shape),
        np.arctan2(-size, zero),
        1.0 + rates.theta_x,
        rates.theta_y,
        rates.growth_x,
        rates.growth_y,
        scale * model.emf[:, 1],
        *np.moveaxis(model.coupling, 0, -1).reshape(9, -1),
    )
    return ExactFrames(scale, shape, np.stack(columns))


def torque_errors(shape: FloatArray, theta: FloatArray, found: FloatArray) -> tuple[float, float]:
    """Largest relative errors of the torque of currents that are constant in dqx and in dqy.

    Args:
        shape: Back-EMF shape at the angles, shape (3, M).
        theta: Electrical angles in rad, shape (M,).
        found: The first four of `COLUMNS` as the firmware reads them, shape (4, M).
    """
    a_x, a_y, theta_x, theta_y = found
    alpha, beta, zero = CLARKE @ shape
    ahead = np.cos(theta + theta_x) * beta - np.sin(theta + theta_x) * alpha
    of_x = a_x * ahead / POWER_INVARIANT - 1.0
    of_y = a_y * (np.cos(theta_y) * zero - np.sin(theta_y) * ahead) / POWER_INVARIANT - 1.0
    return float(np.max(np.abs(of_x))), float(np.max(np.abs(of_y)))


def _require_length(shape: FloatArray, theta: FloatArray) -> None:
    """Refuse an alpha-beta vector that comes near zero."""
    length = np.linalg.norm((CLARKE @ shape)[:2], axis=0)
    least = int(np.argmin(length))
    if length[least] < LEAST_LENGTH:
        raise InputError(
            "export.frame_tables: the alpha-beta vector of the back-EMF is as short as "
            f"{length[least]:.3g} of its largest phase value at {np.rad2deg(theta[least]):.0f} "
            f"degrees, {LEAST_LENGTH:g} are needed: dqx and dqy have no steady direction there; "
            "leave the key out and take the phase currents of <prefix>_waveform.h"
        )


def _unwrapped(theta: FloatArray, shape: FloatArray) -> FloatArray:
    """Angle theta_x in rad without jumps, which comes back to itself."""
    alpha, beta, _ = CLARKE @ shape
    direction = np.arctan2(-alpha, beta) - theta
    angle = np.unwrap(np.mod(direction + np.pi, 2.0 * np.pi) - np.pi)
    ahead = np.mod(angle[0] - angle[-1] + np.pi, 2.0 * np.pi) - np.pi
    if abs(angle[-1] + ahead - angle[0]) > np.pi:
        raise InputError(
            "export.frame_tables: the alpha-beta vector of the back-EMF does not turn once in an "
            "electrical period, as one of its harmonics outweighs the fundamental; leave the key "
            "out and take the phase currents of <prefix>_waveform.h"
        )
    return np.asarray(angle, dtype=np.float64)
