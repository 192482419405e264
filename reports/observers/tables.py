"""Observers as tables of the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver, SpeedErrorSlopes


def observer_table(observer: ReducedOrderObserver, slopes: SpeedErrorSlopes) -> Table:
    """The speed observer as a table of the terminal."""
    rows = (
        ("A", f"{observer.a:.7g}", ""),
        ("B_U", f"{observer.b_u:.7g}", "rad/(s V)"),
        ("B_I", f"{observer.b_i:.7g}", "rad/(s A)"),
        ("C", f"{observer.c:.7g}", "rad/(s A)"),
    )
    rpm, wrong = 30.0 / math.pi, 100.0 * slopes.r_error
    notes = (
        "steady speed error: none with exact parameters and no load;",
        f"an unknown load torque shifts the estimate by {slopes.load * rpm:.3g} rpm per N m,",
        (
            f"a resistance that is {wrong:.0f} % too high by {slopes.resistance * rpm:.3g} rpm per "
            "A of i_q"
        ),
    )
    return Table(
        "Speed observer: omega_hat = zeta - C i_q; zeta' = A zeta + B_U u_q + B_I i_q",
        ("", "value", "unit"),
        rows,
        notes,
    )
