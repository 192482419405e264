"""Kalman filter and Matsui's estimators as the firmware runs them: written once,
in the order of operations of the C.

They run on numpy arrays of shape (N,), in double precision for comparison with
`dqforge.optimizer.observers.models.kalman_model` and
`dqforge.optimizer.observers.models.matsui_model`, and in single precision as the model of the
emitted C (`observer_ekf.j2`, `observer_matsui_voltage.j2`, `observer_matsui_current.j2`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dqforge.machines.records import dataclass
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


def _polynomials(model: SampledGains, x: Reals) -> tuple[Reals, Reals, Reals]:
    """x^2 and its four coefficients each: shapes (N,) and (4, 10, 1), and the value, (10, N)."""
    s = x * x
    c = np.array(model.table, dtype=s.dtype).reshape(2 * EVEN, 4).T[..., np.newaxis].copy()
    return s, c, ((c[3] * s + c[2]) * s + c[1]) * s + c[0]


def matrix_entries(model: SampledGains, x: Reals) -> Reals:
    """Entries of the sampled machine at ``x`` = omega_e T_s in rad, (N,) -> (10, N)."""
    _, _, found = _polynomials(model, x)
    found[EVEN:] = x * found[EVEN:]
    return found


def entries_and_slopes(model: SampledGains, x: Reals) -> tuple[Reals, Reals]:
    """Those of `matrix_entries`, and their derivatives by ``x`` = omega_e T_s in rad times the
    period in s, both (10, N).
    """
    s, c, found = _polynomials(model, x)
    rate = ((3.0 * c[3]) * s + 2.0 * c[2]) * s + c[1]
    slopes = np.empty_like(found)
    slopes[:EVEN] = (2.0 * x) * rate[:EVEN]
    slopes[EVEN:] = found[EVEN:] + (2.0 * s) * rate[EVEN:]
    found[EVEN:] = x * found[EVEN:]
    return found, model.t_s * slopes


def next_currents(e: Reals, i: Pair, v: Pair) -> Pair:
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
