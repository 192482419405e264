"""Measured losses held against the budget of a design: what is left, where it is below zero, and
what it goes with.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.measured_losses import MeasuredLosses
from dqforge.machines.records import dataclass
from dqforge.optimizer.identification.correlated_errors import regress
from dqforge.optimizer.identification.parameters import Parameter, judged
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import compare_alternatives

_LEAST_ROWS = 6
_DRY = ("torque", "torque that does not depend on the speed", "N m")
_SQUARE = ("square", "loss with the square of the speed", "W s^2/rad^2")


@dataclass(frozen=True, slots=True)
class MeasuredComparison:
    """Measured losses beside those of the design with its strategy, modulator and carrier.

    Args:
        measured: What was measured, N points.
        model: The same losses by the budget, W, shape (N,); NaN where the design does not reach
            the point.
        left: Measured less modelled, W, shape (N,).
        reached: Shape (N,).
        parts: Losses of the model by name, W, shape (N,) each.
        goes_with: What is left as T |w| + c w^2, each with its 95 % interval; empty of few points.
    """

    measured: MeasuredLosses
    model: FloatArray
    left: FloatArray
    reached: BoolArray
    parts: dict[str, FloatArray]
    goes_with: tuple[Parameter, ...]

    @property
    def below(self) -> BoolArray:
        """Points at which less was measured than the model has."""
        return np.asarray(self.reached & (self.left < 0.0))

    @property
    def rms(self) -> float:
        """R.m.s. of what is left, W."""
        return float(np.sqrt(np.mean(self.left[self.reached] ** 2)))


_MACHINE = ("copper", "ripple_copper", "iron", "ripple_iron", "magnet", "friction")
_BRIDGE = ("conduction", "dead_time", "switching", "capacitor")


@on_design("losses")
def compare_measured(design: Design, measured: MeasuredLosses) -> MeasuredComparison:
    """Hold measured losses against a design.

    The torque of the currents is that of the shaft and of the design's friction. Losses of the
    bridge are in the model where those of the drive were measured.

    Raises:
        NoSolutionError: The design reaches none of the points.
    """
    torque = measured.torque + design.machine.friction * measured.omega_m
    only = Alternatives((design.strategy,), (design.operation.modulation,), (design.inverter.f_sw,))
    margin = design.operation.voltage_margin
    found = compare_alternatives(design, torque, measured.omega_m, only, margin)
    names = _MACHINE + (_BRIDGE if measured.whose == "drive" else ())
    parts = {name: np.asarray(getattr(found.budget, name))[0, 0, 0] for name in names}
    reached = np.asarray(found.usable[0, 0, 0])
    if not reached.any():
        raise NoSolutionError(
            f"{measured.source}: the design reaches none of the {reached.size} points; check the "
            "units of torque and speed"
        )
    model = np.where(reached, sum(parts.values()), np.nan)
    left = measured.loss - model
    return MeasuredComparison(
        measured, model, left, reached, parts, _along(np.abs(measured.omega_m), left, reached)
    )


def _along(omega: FloatArray, left: FloatArray, reached: BoolArray) -> tuple[Parameter, ...]:
    """What is left over the speed, each point a row of its own."""
    omega, left = omega[reached], left[reached]
    if omega.size < _LEAST_ROWS or np.ptp(omega) <= 0.1 * float(omega.max()):
        return ()
    rows = np.column_stack([omega, omega**2])
    fit = regress(rows, left, np.arange(omega.size))
    return tuple(
        judged(
            named,
            float(fit.coefficients[place]),
            float(np.sqrt(fit.covariance[place, place])),
            fit.freedom,
            may_vanish=True,
        )
        for place, named in enumerate((_DRY, _SQUARE))
    )
