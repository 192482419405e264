"""Two designs or results beside each other: what differs, by how much, and which one loses less.

Every number is one of `dqforge run`; nothing is computed here but differences,
bytes of constants and checksums.
"""

from __future__ import annotations

import math

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities
from dqforge.reports.comparison.rows import Row, code_row, quantity_rows
from dqforge.reports.comparison.sources import Side
from dqforge.reports.plain_data import PlainData

# Numbers have nine digits; losses and points that agree in this share are the same.
_SAME = 1e-8


@dataclass(frozen=True, slots=True)
class LossRow:
    """Total losses in W of one alternative at a point that both sides have.

    None where it is not feasible.
    """

    torque: float
    omega_m: float
    strategy: str
    modulation: str
    a: float | None
    b: float | None

    @property
    def difference(self) -> float | None:
        """B less A in W."""
        return None if self.a is None or self.b is None else self.b - self.a

    @property
    def relative(self) -> float | None:
        """The difference relative to the larger of the two."""
        if self.difference is None or self.a is None or self.b is None:
            return None
        most = max(self.a, self.b)
        return self.difference / most if most > 0.0 else 0.0

    @property
    def better(self) -> str | None:
        """``a``, ``b`` or ``equal``; None where neither is feasible."""
        if self.a is None or self.b is None:
            return None if self.a is self.b else ("b" if self.a is None else "a")
        if math.isclose(self.a, self.b, rel_tol=_SAME):
            return "equal"
        return "a" if self.a < self.b else "b"


@dataclass(frozen=True, slots=True)
class MacroRow:
    """A macro of the header that differs, without its prefix.

    None where a side has none of this name.
    """

    name: str
    a: str | None
    b: str | None

    @property
    def relative(self) -> float | None:
        """B less A relative to A; None where one of them is no number, or A is 0."""
        a, b = (_number(text) for text in (self.a, self.b))
        return None if a is None or b is None or a == 0.0 else (b - a) / abs(a)

    @property
    def ratio(self) -> float | None:
        """B over A; None as with `relative`."""
        a, b = (_number(text) for text in (self.a, self.b))
        return None if a is None or b is None or a == 0.0 else b / a


def _number(text: str | None) -> float | None:
    """Value of a macro such as 1.5F or 136."""
    if text is None:
        return None
    try:
        return float(text.removesuffix("F"))
    except ValueError:
        return None


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two sides with all quantities, common losses and different macros.

    ``macros_compared`` is the number of macros of both headers together, None where one has no
    header. ``alone`` says what only one side has, ``notes`` what could not be compared.
    """

    a: Side
    b: Side
    rows: tuple[Row, ...]
    losses: tuple[LossRow, ...]
    macros: tuple[MacroRow, ...]
    macros_compared: int | None
    alone: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def identical(self) -> bool:
        """Whether nothing that is compared differs."""
        losses = all(row.better in ("equal", None) for row in self.losses)
        return (
            losses
            and not self.macros
            and not any(row.differs for row in self.rows)
            and not self.alone
        )


def _loss_table(side: Side) -> list[PlainData]:
    rows = side.value("losses", "rows")
    if rows is None:
        return []
    wanted = {
        "torque_Nm": float | int,
        "omega_m_rad_per_s": float | int,
        "strategy": str,
        "modulation": str,
    }
    for row in rows if isinstance(rows, list) else [None]:
        if not isinstance(row, dict) or not all(
            isinstance(row.get(key), kind) for key, kind in wanted.items()
        ):
            raise InputError(
                "losses.rows: not what dqforge writes; run the design again", source=side.source
            )
    return list(rows)


def _total(row: PlainData) -> float | None:
    total = row.get("total_W")
    return float(total) if row.get("feasible") is True and isinstance(total, int | float) else None


def _same_alternative(a: PlainData, b: PlainData) -> bool:
    labels = all(a[key] == b[key] for key in ("strategy", "modulation"))
    return labels and _same_point(a, b)


def _same_point(a: PlainData, b: PlainData) -> bool:
    keys = ("torque_Nm", "omega_m_rad_per_s")
    return all(math.isclose(a[key], b[key], rel_tol=_SAME, abs_tol=_SAME) for key in keys)


def _loss_rows(sides: tuple[Side, Side]) -> tuple[tuple[LossRow, ...], list[str]]:
    """Common alternatives at common points, and notes on what only one side has."""
    first, second = (_loss_table(side) for side in sides)
    scopes = [side.value("losses", "scope") or "drive" for side in sides]
    if first and second and scopes[0] != scopes[1]:
        without = "AB"[scopes.index("without-bridge")]
        return (), [
            (
                f"losses are not compared: those of {without} are without the bridge, whose switch "
                "is unknown"
            )
        ]
    rows = []
    for a in first:
        b = next((other for other in second if _same_alternative(a, other)), None)
        if b is not None:
            point = float(a["torque_Nm"]), float(a["omega_m_rad_per_s"])
            rows.append(LossRow(*point, a["strategy"], a["modulation"], _total(a), _total(b)))
    notes = []
    for name, own, others in (("A", first, second), ("B", second, first)):
        alone = sum(not any(_same_alternative(row, other) for other in others) for row in own)
        if alone:
            plural = "alternatives" if alone > 1 else "alternative"
            notes.append(f"losses: {alone} {plural} in {name} alone (point, strategy or modulator)")
    return tuple(rows), notes


def _macro_rows(sides: tuple[Side, Side]) -> tuple[tuple[MacroRow, ...], int | None, list[str]]:
    a, b = (side.macros for side in sides)
    missing = [name for name, macros in (("A", a), ("B", b)) if macros is None]
    if a is None or b is None:
        return (
            (),
            None,
            [
                (
                    "headers are not compared: there is none beside the result of "
                    f"{' and '.join(missing)}"
                )
            ],
        )
    names = list(dict.fromkeys([*a, *b]))
    rows = tuple(
        MacroRow(name, a.get(name), b.get(name)) for name in names if a.get(name) != b.get(name)
    )
    return rows, len(names), []


def _of_both(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """Rows of the sections in which both sides have something."""
    common = {row.section for row in rows if row.a is not None and row.b is not None}
    return tuple(row for row in rows if row.section in common)


def _foreign_note(names: list[str]) -> str:
    plural = "are configurations" if len(names) > 1 else "is a configuration"
    return (
        f"{' and '.join(names)} {plural} of other firmware: machine, limits and loops are "
        "compared, margins as that firmware runs them"
    )


def compare_sides(a: Side, b: Side, capabilities: Capabilities = CAPABILITIES) -> Comparison:
    """Everything that two sides can be compared by.

    Args:
        a, b: Designs, results or headers (`sources.read_side`).
        capabilities: Those of the product, or these and some from outside, as the sides were solved
            with.

    Returns:
        Rows for every quantity that at least one side has, whether it differs or not; of a header
        alone only macros and code.

    Raises:
        InputError: A result holds something else than dqforge writes.
    """
    sides = (a, b)
    macros, compared, notes = _macro_rows(sides)
    headers = [name for name, side in (("A", a), ("B", b)) if side.header_only]
    rows: tuple[Row, ...] = () if headers else quantity_rows(sides, capabilities)
    foreign = [name for name, side in (("A", a), ("B", b)) if side.foreign]
    losses, alone = ((), []) if headers or foreign else _loss_rows(sides)
    if foreign:
        rows, notes = _of_both(rows), [_foreign_note(foreign)]
    if headers:
        plural = "are headers" if len(headers) > 1 else "is a header"
        notes.append(
            f"{' and '.join(headers)} {plural}: macros and code are compared, in the units of "
            "their names"
        )
    if compared is not None:
        rows += (code_row(sides),)
    return Comparison(a, b, rows, losses, macros, compared, tuple(alone), tuple(notes))
