"""Tables of the HTML report: results become cells of text here; the template only lays them out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.observers.reduced_order import (
    ErrorsAtLoad,
    ReducedOrderObserver,
)
from dqforge.reports.observers.html import speed_error_text
from dqforge.reports.pages.html_text import (
    NARROW,
    ceiling,
    number,
    quantity,
    share,
    symbols,
)

if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True, slots=True)
class Row:
    """Cells of one row; ``mark`` is ``best``, ``chosen`` or ``muted``, or empty."""

    cells: tuple[str | Markup, ...]
    mark: str = ""


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """A table with a caption.

    The first ``text_columns`` columns are text, the others are set as numbers.
    """

    caption: str | Markup
    columns: tuple[str | Markup, ...]
    rows: tuple[Row, ...]
    text_columns: int = 1


def headings(*texts: str) -> tuple[Markup, ...]:
    return tuple(symbols(text) for text in texts)


def error_cells(errors: ReferenceErrors) -> tuple[str, ...]:
    return (
        quantity(ceiling(errors.torque), "N m", 3),
        share(ceiling(errors.torque_relative), 3),
        quantity(ceiling(errors.i_d), "A", 3),
        quantity(ceiling(errors.i_q), "A", 3),
        quantity(ceiling(errors.loss), "W", 3),
        share(ceiling(errors.loss_relative), 3),
        quantity(ceiling(errors.step_at_zero), "A", 3),
    )


def coefficients_table(observer: ReducedOrderObserver) -> HtmlTable:
    coefficients = (
        ("A", f"{number(observer.a, 8)}", "pole in the z plane"),
        ("B_u", f"{number(observer.b_u, 8)}{NARROW}rad/(s V)", "factor of the voltage u_q"),
        ("B_i", f"{number(observer.b_i, 8)}{NARROW}rad/(s A)", "factor of the current i_q"),
        ("C", f"{number(observer.c, 8)}{NARROW}rad/(s A)", "current taken off the estimate"),
    )
    return HtmlTable(
        symbols(
            "Speed observer: \u03c9\u0302[k] = \u03b6[k] \u2212 C i_q[k], "
            "\u03b6[k+1] = A \u03b6[k] + B_u u_q[k] + B_i i_q[k]"
        ),
        ("", "", "value"),
        tuple(Row((symbols(name), symbols(text), value)) for name, value, text in coefficients),
        2,
    )


def speed_error_table(errors: Sequence[ErrorsAtLoad]) -> HtmlTable:
    """Steady errors of the speed at half the base speed."""
    rows = []
    for label, found in zip(("no load", "half the largest torque"), errors, strict=True):
        cells = [speed_error_text(error) for error in (found.exact, found.resistance)]
        rows.append(Row((label, quantity(found.torque_load, "N m"), *cells)))
    speed = quantity(errors[0].exact.omega_m, "rpm")
    caption = f"Steady speed error at {speed}, half the base speed, with an unknown load at i_d = 0"
    columns = (
        "",
        "load torque",
        "exact values",
        f"resistance {100.0 * errors[0].r_error:.0f} % too large",
    )
    return HtmlTable(symbols(caption), headings(*columns), tuple(rows))
