"""The sampled machine as the firmware runs it: what the Kalman filter and Matsui's estimators
predict with, over numpy arrays of shape (N,) or what else an `Arithmetic` counts with.

In double precision they are compared with `dqforge.optimizer.observers.models.kalman_model` and
`dqforge.optimizer.observers.models.matsui_model`.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import Arithmetic, Dq, Member, Pair
from dqforge.optimizer.observers.sampled_machine import SampledMachine

EVEN = 5

# Rows of `SampledMachine.table` in the order of the C: the even ones first.
_ORDER = (0, 3, 4, 7, 8, 1, 2, 5, 6, 9)


@dataclass(frozen=True, slots=True)
class SampledGains:
    """The sampled machine, i[k+1] = phi i[k] + gamma v + h in the rotor's frame: each entry is a
    polynomial of omega t_s.
    """

    t_s: Annotated[float, Member("sampling period", "s")]
    x_max: Annotated[float, Member("largest |omega| t_s", "rad")]
    table: Annotated[
        tuple[float, ...],
        Member(
            "four coefficients each of phi_dd phi_qq gamma_dd gamma_qq h_d (even), phi_dq phi_qd"
            " gamma_dq gamma_qd h_q (odd)"
        ),
    ]

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


def _polynomials(o: Arithmetic, model: SampledGains, x: Reals) -> tuple[Reals, Reals, Reals]:
    """x^2 and its four coefficients each: shapes (N,) and (4, 10, 1), and the value, (10, N)."""
    s = o.let("s", x * x)
    table = np.array(o.let("c", model.table)).reshape(2 * EVEN, 4).T
    c = table.reshape(4, 2 * EVEN, *(1,) * np.ndim(x)).copy()
    return s, c, ((c[3] * s + c[2]) * s + c[1]) * s + c[0]


def matrix_entries(o: Arithmetic, model: SampledGains, x: Reals) -> Reals:
    """Entries of the sampled machine at ``x`` = omega_e T_s in rad, (N,) -> (10, N)."""
    _, _, found = _polynomials(o, model, x)
    found[EVEN:] = x * found[EVEN:]
    return o.let("e", found)


def entries_and_slopes(o: Arithmetic, model: SampledGains, x: Reals) -> tuple[Reals, Reals]:
    """Those of `matrix_entries`, and their derivatives by ``x`` = omega_e T_s in rad times the
    period in s, both (10, N).
    """
    s, c, found = _polynomials(o, model, x)
    value = o.let("value", found)
    rate = o.let("rate", ((3.0 * c[3]) * s + 2.0 * c[2]) * s + c[1])
    even = o.let("x_2", 2.0 * x) * rate[:EVEN]
    odd = value[EVEN:] + o.let("s_2", 2.0 * s) * rate[EVEN:]
    slopes = o.let("slope", model.t_s * np.concatenate([even, odd]))
    return o.let("e", np.concatenate([value[:EVEN], x * value[EVEN:]])), slopes


def next_currents(e: Reals, i: Pair, v: Pair) -> Dq:
    """Currents in A one sample after ``i`` in A under the voltage ``v`` in V, with the
    entries ``e``.
    """
    return Dq(
        (((e[0] * i[0] + e[5] * i[1]) + e[2] * v[0]) + e[7] * v[1]) + e[4],
        (((e[6] * i[0] + e[1] * i[1]) + e[8] * v[0]) + e[3] * v[1]) + e[9],
    )


def model_scale(gains: Any) -> tuple[float, float]:
    """``scale`` of gains that hold a sampled machine: its period in s and magnet flux linkage in
    Wb.

    Args:
        gains: With the member ``model``.
    """
    t_s = float(gains.model.t_s)
    # h_q over gamma_qq, to first order in the speed: the back-EMF over the speed.
    return t_s, abs(float(gains.model.table[36])) * t_s / float(gains.model.table[12])
