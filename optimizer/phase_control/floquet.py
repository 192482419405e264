"""How fast the current loop of a phase machine forgets: the multipliers of its step over whole
periods of the back-EMF (Floquet), per sample.

The product of the steps over N samples has eigenvalues lambda; what a disturbance keeps of itself
per sample is the radius |lambda|^(1/N), stable below 1. Where the step is the same at every angle
(integrators in dq0) N is 1. Else N samples must make whole periods: the speed is taken where they
do (`whole_samples`), and the worst of some angles of the first sample within a step counts.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.phase_control.periodic_step import (
    LoopState,
    PhasePlants,
    controller_rows,
    loop_state,
    plant_rows,
)
from dqforge.optimizer.phase_control.phase_controller import PhaseControl

FEW_SAMPLES = 40  # Samples of a period below which it matters where within a step they fall.
STARTS = 3  # Angles of the first sample within a step at which a period of few samples is begun.

# Share of the distance of two starts by which the first lies off angle 0, a node, where the slope
# of the back-EMF jumps.
OFF_NODES = 0.382
MOST_PERIODS = 4  # Periods of few samples that may pass until samples fall on the same angles.

# Samples of a period beyond which the loop is judged at rest, at so many angles.
MOST_SAMPLES = 400
_RESCALED = 32  # samples after which a product is scaled, far before it could under- or overflow


@dataclass(frozen=True, slots=True)
class WholePeriods:
    """``samples`` that make ``periods`` whole periods of the back-EMF, at ``omega_e`` in rad/s."""

    samples: int
    periods: int
    omega_e: float


def turns_at_rest(control: PhaseControl) -> bool:
    """Whether the step of the loop is the same at every angle."""
    return control.frame in ("dq", "table") and control.midpoint is None


def whole_samples(control: PhaseControl, omega_e: float) -> WholePeriods:
    """The speed nearest to a given one at which one period is a whole number of samples, or, where
    those are few, some periods are.

    Args:
        control: The current control.
        omega_e: Electrical speed in rad/s, not zero.
    """
    turn = 2.0 * np.pi * control.shape.turns
    samples = turn / (abs(omega_e) * control.t_s)
    most = MOST_PERIODS if samples < FEW_SAMPLES * control.shape.turns else 1
    share = Fraction(samples).limit_denominator(most)
    speed = turn * share.denominator / (share.numerator * control.t_s)
    return WholePeriods(share.numerator, share.denominator, float(np.copysign(speed, omega_e)))


def radius(control: PhaseControl, plants: PhasePlants, omega_e: float) -> FloatArray:
    """Largest modulus of a multiplier per sample, shape (M,), of M plants; stable below 1.

    Args:
        control: The current control.
        plants: The windings.
        omega_e: Electrical speed in rad/s. Where the frame does not turn with the rotor, the
            nearest that makes periods whole; with more than `MOST_SAMPLES` samples per period, and
            at standstill, the largest radius of the steps at fixed angles.
    """
    if turns_at_rest(control):
        return _over_period(control, plants, omega_e, np.zeros((1, 1)))
    turn = 2.0 * np.pi * control.shape.turns
    if abs(omega_e) * control.t_s * MOST_SAMPLES * control.shape.turns < turn:
        fixed = turn * np.arange(MOST_SAMPLES // 4) / (MOST_SAMPLES // 4)
        return _over_period(control, plants, omega_e, fixed[:, np.newaxis])
    whole = whole_samples(control, omega_e)
    step = whole.omega_e * control.t_s
    starts = STARTS if whole.samples < FEW_SAMPLES * control.shape.turns * whole.periods else 1
    first = (np.arange(starts) + OFF_NODES) / starts * turn / whole.samples
    theta = first[:, np.newaxis] + step * np.arange(whole.samples)
    return _over_period(control, plants, whole.omega_e, theta)


def _over_period(
    control: PhaseControl, plants: PhasePlants, omega_e: float, theta: FloatArray
) -> FloatArray:
    """Largest radius per sample over S runs of angles, shape (S, N) in rad -> (M,)."""
    state = loop_state(control, omega_e)
    own = plant_rows(plants, state, omega_e, control.t_s)
    others = controller_rows(control, state, omega_e, theta.ravel())
    return _growth(state, own, others.reshape(*theta.shape, *others.shape[1:]))


def _growth(state: LoopState, own: FloatArray, others: FloatArray) -> FloatArray:
    """Radius per sample of the products of steps, the largest over the runs.

    ``own`` (M, plant, n) are the rows of the plants, ``others`` (S, N, n - plant, n) those of the
    controller.
    """
    runs, samples = others.shape[:2]
    product = np.tile(np.eye(state.size), (runs, len(own), 1, 1))
    size = np.zeros((runs, len(own)))
    for sample in range(samples):
        product = np.concatenate([own @ product, others[:, sample, np.newaxis] @ product], axis=-2)
        if sample % _RESCALED == _RESCALED - 1:
            largest = np.max(np.abs(product), axis=(-2, -1))
            product /= largest[..., np.newaxis, np.newaxis]
            size += np.log(largest)
    largest = np.max(np.abs(np.linalg.eigvals(product)), axis=-1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.max(np.exp((np.log(largest) + size) / samples), axis=0))
