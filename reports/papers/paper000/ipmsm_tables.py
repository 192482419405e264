"""Paper 000 recomputed: its Tables 1, 2 and 4 beside the printed values.

The printed values are facts of the paper; where they contain misprints the
notes say how they are read.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.breakpoints import search
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve, squared_error_integral
from dqforge.optimizer.operating_points.mtpa import mtpa_currents, mtpa_per_unit, per_unit_base
from dqforge.reports.papers.paper000.loss_columns import LossRow, table_4

DESIGN_NAME = "paper000-ipmsm-100kw"
_DOMAIN = 5.0  # End of the per-unit torque domain of the paper.

# Degree: (phi_d, phi_q, reduction of epsilon in %).
PRINTED_TABLE_1 = {
    2: (1.5545, 2.7667, 98.6767),
    3: (1.8455, 1.5545, 99.6578),
    4: (1.9424, 1.4576, 98.9986),
}

# (Axis, degree): the two segments, highest power first, in A/(N m)^k. The paper's row m = 0 is the
# highest power.
PRINTED_TABLE_2 = {
    ("d", 2): ((-3.33e-3, -101e-3, 0.0), (225e-6, -786e-3, 32.9)),
    ("d", 3): ((18.1e-6, -6.17e-3, -736e-6, 0.0), (463e-9, -60e-6, -736e-3, 30.9)),
    ("d", 4): (
        (-43.9e-9, 28.9e-6, -6.97e-3, 15.7e-3, 0.0),
        (-3.25e-9, 3.5e-6, -1.08e-3, -591e-3, 23.6),
    ),
    ("q", 2): ((-1.88e-3, 1.63, 0.0), (-753e-6, 1.22, 37.3)),
    ("q", 3): ((-4.17e-6, -1.27e-3, 1.62, 0.0), (1.89e-6, -2.26e-3, 1.62, 3.82)),
    ("q", 4): ((80e-9, -21.9e-6, -71.7e-6, 1.59, 0.0), (-3.92e-9, 5.43e-6, -3.41e-3, 1.77, -3.61)),
}

_CURVE_END = 250.0


@dataclass(frozen=True, slots=True)
class BreakpointRow:
    """One row of Table 1: the reduction of epsilon in % at the paper's breakpoints
    and at the best ones (p.u.).
    """

    degree: int
    printed_breakpoints: tuple[float, float]
    printed_reduction: float
    reduction: float
    best_breakpoints: tuple[float, float]
    best_reduction: float


@dataclass(frozen=True, slots=True)
class PolynomialRow:
    """One column pair of Table 2 against the exact MTPA over 0 to 250 N m: r.m.s.
    and largest error in A.
    """

    axis: str
    degree: int
    breakpoint: float
    rms_error: float
    largest_error: float


@dataclass(frozen=True, slots=True)
class Reproduction:
    """The three tables."""

    breakpoints: tuple[BreakpointRow, ...]
    polynomials: tuple[PolynomialRow, ...]
    losses: tuple[LossRow, ...]


_CURVES = {
    "d": lambda torque: mtpa_per_unit(torque)[0],
    "q": lambda torque: mtpa_per_unit(torque)[1],
}

_FREE = SideConditions(exact_at_zero=False, continuous=False)


def _epsilon(axis: str, edges: FloatArray, degree: int) -> float:
    """One axis of the paper's metric (30) for its own method, Lagrange on Chebyshev nodes,
    in per unit.
    """
    return squared_error_integral(
        _CURVES[axis], fit_curve(_CURVES[axis], edges, degree, "lagrange", _FREE)
    )


def _breakpoint_row(degree: int) -> BreakpointRow:
    phi_d, phi_q, printed = PRINTED_TABLE_1[degree]
    whole = np.array([0.0, _DOMAIN])
    undivided = sum(_epsilon(axis, whole, degree) for axis in _CURVES)

    def reduction(edges: dict[str, FloatArray]) -> float:
        return 100.0 * (
            1.0 - sum(_epsilon(axis, edges[axis], degree) for axis in _CURVES) / undivided
        )

    best = {}
    for axis in _CURVES:

        def objective(edges: FloatArray, axis: str = axis) -> float:
            return _epsilon(axis, edges, degree)

        best[axis] = search(objective, objective, 2, _DOMAIN)
    at_printed = {"d": np.array([0.0, phi_d, _DOMAIN]), "q": np.array([0.0, phi_q, _DOMAIN])}
    return BreakpointRow(
        degree,
        (phi_d, phi_q),
        printed,
        reduction(at_printed),
        (float(best["d"][1]), float(best["q"][1])),
        reduction(best),
    )


def table_1() -> tuple[BreakpointRow, ...]:
    """Reduction of epsilon by the second segment, at the paper's breakpoints and at
    those that the search finds.
    """
    return tuple(_breakpoint_row(degree) for degree in PRINTED_TABLE_1)


def table_2(design: Design) -> tuple[PolynomialRow, ...]:
    """Errors of the printed polynomials against the exact MTPA of the library
    machine over 0 to 250 N m.
    """
    torque = np.linspace(0.0, _CURVE_END, 25_001)
    exact = dict(zip("dq", mtpa_currents(linearised(design.machine), torque), strict=True))
    base = per_unit_base(linearised(design.machine)).torque
    rows = []
    for (axis, degree), (first, second) in PRINTED_TABLE_2.items():
        phi = PRINTED_TABLE_1[degree]["dq".index(axis)] * base
        value = np.where(torque < phi, np.polyval(first, torque), np.polyval(second, torque))
        error = value - exact[axis]
        rows.append(
            PolynomialRow(
                axis, degree, phi, float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
            )
        )
    return tuple(rows)


def reproduce_paper() -> Reproduction:
    """Recompute the three tables from the library drive."""
    design = catalogue.load(DESIGN_NAME)
    return Reproduction(table_1(), table_2(design), table_4(design))
