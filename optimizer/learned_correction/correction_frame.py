"""What the correction is told, and where it is silent.

Six inputs, in the angle of the observer: residual psi^_d - psi_model,d in Wb, omega_low/|omega|, at
most 1, current (d, q) in A, u = (|omega| - omega_m)/(|omega| + omega_m), which is the hyperbolic
tangent of half the logarithm of |omega|/omega_m, and the residual on q in Wb. The last tells
nothing: where the phase-locked loop rests, psi^ - L_q i lies on d and the residual on q is nil. It
is watched, for where it is not small the loop is not at rest.

A drive that turns backwards is seen in a mirror (q components and the correction change their
sign), so that what is learned forwards holds backwards exactly. Each input is brought to -1 to 1
over the range that was trained; where one lies outside, or is not a number, there is no correction.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.learned_correction.steady_errors import SteadyErrors
from dqforge.optimizer.observers.parts import EXACT, Arithmetic, at_least
from dqforge.optimizer.observers.training import TrainingBox

INPUTS = 6
TOLD = 5  # Of which the first five are learned from.
Inputs = tuple[Reals, ...]  # The six inputs, each shape (N,).


@dataclass(frozen=True, slots=True)
class CorrectionFrame:
    """``middle`` and ``low`` in rad/s; input k counts as (value - centre[k]) scale[k]; ``share`` of
    a new value in the filter of the correction; ``limit`` in rad.
    """

    middle: float
    low: float
    centre: tuple[float, ...]
    scale: tuple[float, ...]
    share: float
    limit: float

    def __post_init__(self) -> None:
        """Refuse what has not six inputs."""
        if not len(self.centre) == len(self.scale) == INPUTS:
            raise ValueError("a correction has six inputs")


# A frame in which nothing is ever corrected, of an observer that has not been trained.
SILENT = CorrectionFrame(1.0, 1.0, (3.0,) * INPUTS, (1.0,) * INPUTS, 1.0, 0.0)


def _single(value: float) -> float:
    """The number that single precision has for it."""
    return float(np.float32(value))


def speed_inputs(frame: Any, size: Reals, maths: Arithmetic) -> tuple[Reals, Reals]:
    """The two inputs of a size of the speed in rad/s."""
    u = (size - frame.middle) / (size + frame.middle)
    return u, np.asarray(frame.low / at_least(maths, size, maths.number(frame.low)))


def brought(frame: Any, raw: Inputs) -> Inputs:
    """Inputs over their trained ranges, -1 to 1."""
    return tuple(
        (value - centre) * scale
        for value, centre, scale in zip(raw, frame.centre, frame.scale, strict=True)
    )


def outside(x: Inputs) -> Reals:
    """0 within the trained ranges, 1 where a current or the speed lies beyond, else 2 where the
    residual does.
    """
    one = x[0].dtype.type(1.0)

    def within(values: Inputs) -> Any:
        found = np.ones(np.shape(values[0]), dtype=bool)
        for value in values:
            found &= (value >= -one) & (value <= one)
        return found

    residual = within((x[0], x[5]))
    return np.asarray(np.where(within(x[1:5]), np.where(residual, 0.0 * one, 2.0 * one), one))


def frame_of(seen: SteadyErrors, box: TrainingBox, share: float, limit: float) -> CorrectionFrame:
    """The frame of a training.

    Args:
        seen: The drives that are trained on: their residuals and currents bound the inputs; the
            residual on q, which is nil at rest, may be half as far from it as the other one varies.
        box: Bounds the speeds.
        share: Of a new value in the filter.
        limit: Of the correction, in rad.
    """
    middle = float(np.sqrt(box.omega_low * box.omega_high))
    ends = np.array([box.omega_low, box.omega_high])
    open_frame = CorrectionFrame(
        middle, box.omega_low, (0.0,) * INPUTS, (1.0,) * INPUTS, share, limit
    )
    u, v = speed_inputs(open_frame, ends, EXACT)

    def ends_of(part: FloatArray) -> tuple[float, float]:
        return float(np.min(part)), float(np.max(part))

    along = ends_of(seen.residual.real)
    across = 0.5 * (along[1] - along[0])
    ranges = [
        along,
        (float(v[1]), float(v[0])),
        ends_of(seen.current.real),
        ends_of(seen.current.imag),
        (float(u[0]), float(u[1])),
        (-across, across),
    ]
    return CorrectionFrame(
        _single(middle),
        _single(box.omega_low),
        tuple(_single(0.5 * (low + high)) for low, high in ranges),
        tuple(_single(2.0 / (high - low)) for low, high in ranges),
        _single(share),
        _single(limit),
    )


def inputs_of(frame: CorrectionFrame, seen: SteadyErrors) -> FloatArray:
    """Inputs of drives that turn forwards, shape (6, M)."""
    u, v = speed_inputs(frame, seen.omega, EXACT)
    raw = (
        seen.residual.real,
        v,
        seen.current.real,
        seen.current.imag,
        u,
        seen.residual.imag,
    )
    return np.stack(brought(frame, raw))
