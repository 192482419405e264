"""What an observer that learns is trained on, and what its training left: plain records."""

from __future__ import annotations

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

Limits = tuple[float, float]  # Least and largest value.

# Relative errors of R that are trained where a design names no tolerances: a cold winding, and one
# at 130 degrees C of a machine whose data were taken at 20.
USUAL_R_S: Limits = (-0.3, 0.4)
USUAL_PSI_PM: Limits = (-0.1, 0.05)  # The same of the magnet: warm, and cold.
USUAL_INDUCTANCE: Limits = (-0.1, 0.1)
LOWEST_SHARE = 0.03  # Share of the largest speed from which on steady states are trained.

# The same up to which they are: a drive at its largest speed still lies within.
HIGHEST_SHARE = 1.1


@dataclass(frozen=True, slots=True)
class TrainingBox:
    """The drives and operating points of a training.

    ``r_s``, ``l_d``, ``l_q``, ``psi_pm`` are relative errors, ``lost`` the voltage in V along the
    current that the inverter takes unknown to the observer. ``i_max`` in A is the largest current
    (peak), ``i_d_low`` in A the least i_d; ``omega_low`` and ``omega_high`` in rad/s (electrical)
    bound the size of the speed.
    """

    r_s: Limits
    l_d: Limits
    l_q: Limits
    psi_pm: Limits
    lost: Limits
    i_max: float
    i_d_low: float
    omega_low: float
    omega_high: float


def usual_training_box(
    lost: float, i_max: float, omega_max: float, i_d: float = 0.0
) -> TrainingBox:
    """The box where nothing is known of the tolerances.

    Args:
        lost: Voltage in V that the whole dead time takes: from none of it to all.
        i_max: Largest current in A (peak).
        omega_max: Largest electrical speed in rad/s.
        i_d: Least i_d in A that the drive needs; half the largest current towards weaker fields is
            trained in any case.
    """
    return TrainingBox(
        USUAL_R_S,
        USUAL_INDUCTANCE,
        USUAL_INDUCTANCE,
        USUAL_PSI_PM,
        (0.0, lost),
        i_max,
        min(-0.5 * i_max, 1.1 * i_d),
        LOWEST_SHARE * omega_max,
        HIGHEST_SHARE * omega_max,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """What a training gained on steady states that it has not seen, per band of speeds.

    ``edges`` in rad/s (electrical), shape (B, 2). ``rms`` and ``largest`` map who estimates to
    angle errors in rad, shape (B,); ``outside`` does with R beyond the box, ``beyond`` (two
    relative errors). ``held`` is the share of points at which the observer has a steady state at
    all, ``inside`` the share of those at rest with the correction at which it acts, and
    ``inside_beyond`` the same beyond the box, shape (B,). ``limit`` in rad is the largest
    correction that can come out, and ``rules`` the largest of a rule over its box before that
    limit, None where only the limit is known. ``numbers`` are the constants that were learned,
    ``points`` those it was trained on.
    """

    box: TrainingBox
    edges: FloatArray
    rms: dict[str, FloatArray]
    largest: dict[str, FloatArray]
    outside: dict[str, FloatArray]
    beyond: Limits
    held: FloatArray
    inside: FloatArray
    inside_beyond: FloatArray
    limit: float
    rules: float | None
    numbers: int
    points: int
