"""Kalman filter and Matsui's estimators as the firmware runs them: written once,
in the order of operations of the C.

They run on numpy arrays of shape (N,), in double precision for comparison with
`dqforge.optimizer.observers.models.kalman_model` and
`dqforge.optimizer.observers.models.matsui_model`, and in single precision as the model of the
emitted C (`observer_ekf.j2`, `observer_matsui_voltage.j2`, `observer_matsui_current.j2`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import Pair
from dqforge.optimizer.observers.sampled_machine import SampledMachine

EVEN = 5


_ORDER = (0, 3, 4, 7, 8, 1, 2, 5, 6, 9)

"""Rows of `SampledMachine.table` in the order of the C: the even ones first."""


@dataclass(frozen=True, slots=True)
class SampledGains:
    """`SampledMachine` for the firmware: ``t_s`` in s, ``x_max`` in rad, forty coefficients,
    four per entry.
    """

    t_s: float
    x_max: float
    table: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse another number of coefficients."""
        if len(self.table) != 8 * EVEN:
            raise ValueError


def sampled_gains(model: SampledMachine) -> SampledGains:
    """What the firmware needs of a sampled machine."""
    table = model.table[list(_ORDER)].ravel()
    return SampledGains(
        model.t_s, model.omega_max * model.t_s, tuple(float(value) for value in table)
    )


def limited(value: Reals, limit: Any) -> Reals:
    """A value within -limit to limit."""
    return np.where(value > limit, limit, np.where(value < -limit, -limit, value))


def matrix_entries(model: SampledGains, x: Reals) -> list[Reals]:
    """Entries of the sampled machine at ``x`` = omega_e T_s in rad."""
    s = x * x
    found = []
    for n in range(2 * EVEN):
        c = model.table[4 * n : 4 * n + 4]
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        found.append(value if n < EVEN else x * value)
    return found


def matrix_slopes(model: SampledGains, x: Reals) -> list[Reals]:
    """Derivatives by ``x`` = omega_e T_s in rad of the entries of the sampled machine."""
    s = x * x
    found = []
    for n in range(2 * EVEN):
        c = model.table[4 * n : 4 * n + 4]
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        rate = ((3.0 * c[3]) * s + 2.0 * c[2]) * s + c[1]
        found.append(model.t_s * ((2.0 * x) * rate if n < EVEN else value + (2.0 * s) * rate))
    return found


def next_currents(e: list[Reals], i: Pair, v: Pair) -> Pair:
    """Currents in A one sample after ``i`` in A under the voltage ``v`` in V, with the
    entries ``e``.
    """
    return (
        (((e[0] * i[0] + e[5] * i[1]) + e[2] * v[0]) + e[7] * v[1]) + e[4],
        (((e[6] * i[0] + e[1] * i[1]) + e[8] * v[0]) + e[3] * v[1]) + e[9],
    )


def model_scale(gains: Any) -> tuple[float, float]:
    """``scale`` of gains that hold a sampled machine: its period in s and magnet flux linkage in
    Wb.

    Parameters
    ----------
    gains:
        With the member ``model``.
    """
    t_s = float(gains.model.t_s)
    # h_q over gamma_qq, to first order in the speed: the back-EMF over the speed.
    return t_s, abs(float(gains.model.table[36])) * t_s / float(gains.model.table[12])
