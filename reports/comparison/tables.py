"""Tables and plain data of a comparison."""

from __future__ import annotations

import math
from itertools import groupby

from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.capability import Value
from dqforge.reports.comparison.rows import Row
from dqforge.reports.comparison.sides_compared import Comparison, LossRow, MacroRow
from dqforge.reports.comparison.sources import Side
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

_SI = {"rpm": "rad/s", "deg": "rad", "%": "1"}


_NONE = "-"


def _text(value: Value, unit: str) -> str:
    if value is None:
        return _NONE
    return value if isinstance(value, str) else format_quantity(value, unit)


def _share(relative: float, ratio: float) -> str:
    # Beyond ten times a share in percent is hard to read.
    return f"{100.0 * relative:+.3g} %" if abs(relative) < 9.0 else f"{ratio:.3g} times"


def _difference(row: Row) -> str:
    if not row.differs:
        return "="
    if row.a is None or row.b is None:
        return "only B" if row.a is None else "only A"
    if row.relative is not None and isinstance(row.a, float) and isinstance(row.b, float):
        return _share(row.relative, row.b / row.a)
    return "differs"


def _side_row(name: str, side: Side) -> tuple[str, ...]:
    return (name, side.source, side.name, side.digest[:12])


def _counts(quantities: int, losses: int, macros: int | None) -> str:
    parts = [(quantities, "quantity", "quantities"), (losses, "loss", "losses")]
    if macros is not None:
        parts.append((macros, "macro", "macros"))
    return ", ".join(f"{count} {one if count == 1 else many}" for count, one, many in parts)


def _summary(comparison: Comparison) -> tuple[str, ...]:
    count = _counts(len(comparison.rows), len(comparison.losses), comparison.macros_compared)
    if comparison.identical:
        same_file = comparison.a.digest and comparison.a.digest == comparison.b.digest
        why = (
            "the design files are the same"
            if same_file
            else "the design files differ, their results do not"
        )
        return (f"A and B are identical: {count}; {why}", *comparison.notes)
    losses = sum(row.better not in ("equal", None) for row in comparison.losses)
    differ = sum(row.differs for row in comparison.rows)
    macros = None if comparison.macros_compared is None else len(comparison.macros)
    different = f"different: {_counts(differ, losses, macros)}; compared: {count}"
    return (different, *comparison.alone, *comparison.notes)


def _rows_table(section: str, rows: list[Row]) -> Table:
    different = [row for row in rows if row.differs]
    title = section if different else f"{section}: no difference"
    cells = tuple(
        (row.label, _text(row.a, row.unit), _text(row.b, row.unit), _difference(row))
        for row in rows
    )
    return Table(title, ("", "A", "B", "B against A"), cells)


def _watts(value: float | None) -> str:
    return "not feasible" if value is None else f"{value:.4g}" if value < 1e4 else f"{value:.0f}"


def _loss_cells(row: LossRow) -> tuple[str, ...]:
    words = {"a": "A", "b": "B", "equal": "equal", None: _NONE}
    difference = _NONE if row.difference is None else f"{row.difference + 0.0:+.4g}"
    share = _NONE if row.relative is None else f"{100.0 * row.relative + 0.0:+.2f}"
    if row.better == "equal":
        difference, share = "0", "0"
    return (
        row.strategy,
        row.modulation,
        _watts(row.a),
        _watts(row.b),
        difference,
        share,
        words[row.better],
    )


def _least(rows: list[LossRow]) -> str:
    """One line on the best alternative of each side at a point."""
    parts = []
    totals = []
    for name in ("a", "b"):
        options = [(getattr(row, name), row) for row in rows if getattr(row, name) is not None]
        if not options:
            parts.append(f"{name.upper()} has no feasible alternative")
            continue
        total, row = min(options, key=lambda option: option[0])
        totals.append(total)
        parts.append(f"{name.upper()} {_watts(total)} W ({row.strategy} with {row.modulation})")
    text = "least: " + ", ".join(parts)
    if len(totals) == 2 and not math.isclose(*totals, rel_tol=1e-8):
        saved = abs(totals[0] - totals[1])
        better = "A" if totals[0] < totals[1] else "B"
        text += f"; {better} loses {saved:.3g} W less ({100.0 * saved / max(totals):.3g} %)"
    return text


def _loss_tables(comparison: Comparison) -> list[Table]:
    columns = ("strategy", "modulator", "A W", "B W", "B - A W", "%", "better")
    tables = []
    for (torque, omega_m), group in groupby(
        comparison.losses, key=lambda row: (row.torque, row.omega_m)
    ):
        rows = list(group)
        title = f"total losses at {torque:.4g} N m, {omega_m * 30.0 / math.pi:.5g} rpm"
        tables.append(
            Table(title, columns, tuple(_loss_cells(row) for row in rows), (_least(rows),))
        )
    return tables


def _macro_table(comparison: Comparison) -> list[Table]:
    if not comparison.macros:
        return []
    rows = tuple(
        (row.name, row.a or _NONE, row.b or _NONE, _macro_difference(row))
        for row in comparison.macros
    )
    title = f"header: {len(rows)} of {comparison.macros_compared} macros differ"
    return [Table(title, ("without prefix", "A", "B", "B against A"), rows)]


def _macro_difference(row: MacroRow) -> str:
    if row.a is None or row.b is None:
        return "only B" if row.a is None else "only A"
    return (
        "differs" if row.relative is None or row.ratio is None else _share(row.relative, row.ratio)
    )


def comparison_tables(comparison: Comparison) -> list[Table]:
    """Both sides in engineering units; of identical ones only that they are."""
    sides = (_side_row("A", comparison.a), _side_row("B", comparison.b))
    head = Table(
        "comparison", ("", "given", "design", "SHA-256 of the file"), sides, _summary(comparison)
    )
    if comparison.identical:
        return [head]
    sections = [
        (name, list(rows)) for name, rows in groupby(comparison.rows, key=lambda row: row.section)
    ]
    tables = [_rows_table(name, rows) for name, rows in sections]
    return [head, *tables, *_loss_tables(comparison), *_macro_table(comparison)]


def _plain_side(side: Side) -> PlainData:
    return {"source": side.source, "name": side.name, "digest": side.digest}


def plain_comparison(comparison: Comparison) -> PlainData:
    """Both sides as plain data; all rows, different or not."""
    return {
        "a": _plain_side(comparison.a),
        "b": _plain_side(comparison.b),
        "identical": comparison.identical,
        "rows": [
            {
                "section": row.section,
                "quantity": row.label,
                "unit": _SI.get(row.unit, row.unit),
                "a": row.a,
                "b": row.b,
                "difference": row.difference,
                "relative": row.relative,
                "differs": row.differs,
            }
            for row in comparison.rows
        ],
        "losses": [
            {
                "torque_Nm": row.torque,
                "omega_m_rad_per_s": row.omega_m,
                "strategy": row.strategy,
                "modulation": row.modulation,
                "a_W": row.a,
                "b_W": row.b,
                "difference_W": row.difference,
                "relative": row.relative,
                "better": row.better,
            }
            for row in comparison.losses
        ],
        "macros": [
            {"name": row.name, "a": row.a, "b": row.b, "relative": row.relative}
            for row in comparison.macros
        ],
        "macros_compared": comparison.macros_compared,
        "notes": [*comparison.alone, *comparison.notes],
    }
