"""Paper 002 in tables and plain data: printed beside found."""

from __future__ import annotations

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper002 import COMPONENTS, Reproduction
from dqforge.reports.plain_data import PlainData

_ORDERS = (1, 3, 5, 7, 9)


def reproduction_tables(reproduction: Reproduction) -> list[Table]:
    """Printed and recomputed values side by side."""
    components = tuple(
        (
            row.shape,
            *(f"{row.printed[name]:.2f} / {row.found[name]:.3f}" for name in COMPONENTS),
            f"{row.loss_ratio:.3f}",
        )
        for row in reproduction.rows
    )
    names = ("", *(f"{name} printed / found" for name in COMPONENTS), "copper loss dqx over dqy")
    drive = reproduction.drive
    harmonics = tuple(
        (f"{order}", *(f"{1e3 * drive.harmonics[k, order]:.2f}" for k in range(2)))
        for order in _ORDERS
    )
    return [
        Table(
            "Paper 002, Table 3.1: r.m.s. of the components of the back-EMF of unit amplitude",
            names,
            components,
            (
                "The trapezoid's 1.83 and 1.92 are r.m.s.(|F|^2)/sqrt(3/2), another quantity.",
                "The trapezoid's printed d is not that of a flat top of 120 degrees.",
                (
                    "Copper losses at the same constant torque; power-invariant components, as in "
                    "the thesis."
                ),
            ),
        ),
        Table(
            "Paper 002, Figure 6.7 for the shipped drive at 1 N m: harmonics of the current of "
            "phase a",
            ("order", "dqx mA (peak)", "dqy mA (peak)"),
            harmonics,
            (
                (
                    f"i_qy is constant, {drive.i_qy:.4g} A = T / (p phi_m sqrt(3/2)), "
                    "power-invariant; (4.4) errs."
                ),
                (
                    "The drive's harmonics are assumed: the thesis shows its back-EMF as a figure "
                    "only."
                ),
            ),
        ),
    ]


def plain_reproduction(reproduction: Reproduction) -> PlainData:
    """Table and curves as plain data."""
    drive = reproduction.drive
    return {
        "table_3_1": [
            {
                "shape": row.shape,
                "printed": row.printed,
                "found": row.found,
                "loss_ratio_dqx_over_dqy": row.loss_ratio,
            }
            for row in reproduction.rows
        ],
        "drive": {
            "theta_x_rad": drive.angles.theta_x,
            "theta_y_rad": drive.angles.theta_y,
            "a_x": drive.angles.a_x,
            "a_y": drive.angles.a_y,
            "current_a_dqx_A": drive.currents[0],
            "current_a_dqy_A": drive.currents[1],
            "harmonics_a_dqx_A": drive.harmonics[0, : _ORDERS[-1] + 1],
            "harmonics_a_dqy_A": drive.harmonics[1, : _ORDERS[-1] + 1],
            "i_qy_A": drive.i_qy,
        },
    }
