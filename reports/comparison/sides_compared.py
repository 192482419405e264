"""Two designs or results beside each other: what differs, by how much, and which one loses less.

Every number is one of `dqforge run`; nothing is computed here but differences,
bytes of constants and checksums.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from itertools import groupby
from typing import Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity, signed_percent
from dqforge.optimizer.firmware.configuration import DriveValues, PiGains
from dqforge.optimizer.firmware.solve import OwnGains
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Quantity, Value
from dqforge.reports.comparison.sources import Side
from dqforge.reports.firmware.target import TextFile
from dqforge.reports.firmware.written_files import DRIVE_KEYS
from dqforge.reports.pages.answer import Table
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


# Tables and plain data of a comparison.

_SI = {"rpm": "rad/s", "deg": "rad", "%": "1"}


_NONE = "-"


def _text(value: Value, unit: str) -> str:
    if value is None:
        return _NONE
    return value if isinstance(value, str) else format_quantity(value, unit)


def _share(relative: float, ratio: float) -> str:
    # Beyond ten times a share in percent is hard to read.
    return signed_percent(relative) if abs(relative) < 9.0 else f"{ratio:.3g} times"


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
        title = f"total losses at {torque:.4g} N m, {in_rpm(omega_m):.5g} rpm"
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


# Quantities of two designs or results side by side: machine, limits, references,
# gains and phase currents.


@dataclass(frozen=True, slots=True)
class Row:
    """One quantity of both sides.

    ``unit`` is that of the text (`format_quantity`); numbers are in SI, angles in rad, shares as
    fractions. A side that lacks the quantity has None.
    """

    section: str
    label: str
    unit: str
    a: Value
    b: Value

    @property
    def differs(self) -> bool:
        """Whether the two sides are not the same."""
        return self.a != self.b

    @property
    def difference(self) -> float | None:
        """B less A; None where they are no numbers."""
        if isinstance(self.a, str) or isinstance(self.b, str) or self.a is None or self.b is None:
            return None
        return self.b - self.a

    @property
    def relative(self) -> float | None:
        """The difference relative to A; None where that is 0 or no number."""
        if self.difference is None or not isinstance(self.a, float | int) or self.a == 0.0:
            return None
        return self.difference / abs(self.a)


_MACHINE: tuple[tuple[str, str, str], ...] = (
    ("pole pairs", "pole_pairs", ""),
    ("phase resistance", "r_s_Ohm", "Ohm"),
    ("inductance d", "l_d_H", "H"),
    ("inductance q", "l_q_H", "H"),
    ("magnet flux linkage", "psi_pm_Wb", "Wb"),
    ("inertia", "inertia_kg_m2", "kg m^2"),
    ("friction", "friction_Nms_per_rad", "N m s/rad"),
)


_LIMITS: tuple[tuple[str, str, str], ...] = (
    ("current limit (peak)", "i_max_A", "A"),
    ("largest speed", "omega_m_max_rad_per_s", "rpm"),
    ("DC link", "v_dc_V", "V"),
    ("switching frequency", "f_sw_Hz", "Hz"),
    ("dead time", "dead_time_s", "s"),
    ("topology", "topology", ""),
    ("sampling period", "t_s_s", "s"),
)


_DRIVE = (
    *(Quantity("machine", label, unit, ("drive", key)) for label, key, unit in _MACHINE),
    *(Quantity("limits", label, unit, ("drive", key)) for label, key, unit in _LIMITS),
)


def _checked(side: Side, *path: str) -> Value:
    """A number or text of a side."""
    found = side.value(*path)
    if found is None or isinstance(found, str):
        return found
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise InputError(
            f"{'.'.join(path)}: expected a number or a text; run the design again",
            source=side.source,
        )
    return float(found)


def _value(side: Side, quantity: Quantity) -> Value:
    """What a side has of a quantity; None where it has none."""
    if quantity.derived is None:
        return _checked(side, *quantity.path)
    found = side.value(*quantity.path)
    if found is None:
        return None
    try:
        return quantity.derived(found)
    except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{'.'.join(quantity.path)}: cannot be read; run the design again", source=side.source
        ) from error


def _row(sides: tuple[Side, Side], quantity: Quantity) -> Row:
    a, b = (_value(side, quantity) for side in sides)
    return Row(quantity.section, quantity.label, quantity.unit, a, b)


def quantity_rows(
    sides: tuple[Side, Side], capabilities: Capabilities = CAPABILITIES
) -> tuple[Row, ...]:
    """Rows of every quantity that at least one of two results has, whether it differs or not.

    Those of one section stand together, where its first one stands.

    Raises:
        InputError: A result holds something else than dqforge writes.
    """
    asked = [*_DRIVE, *(part for capability in capabilities for part in capability.quantities)]
    sections = list(dict.fromkeys(quantity.section for quantity in asked))
    asked.sort(key=lambda quantity: sections.index(quantity.section))
    rows = [_row(sides, quantity) for quantity in asked]
    return tuple(row for row in rows if row.a is not None or row.b is not None)


def code_row(sides: tuple[Side, Side]) -> Row:
    """Checksums of what the headers compile to, without comments and prefixes."""
    a, b = (
        None if side.code is None else hashlib.sha256(side.code.encode()).hexdigest()[:12]
        for side in sides
    )
    return Row("header", "checksum of the code", "", a, b)


# Headers and results that dqforge wrote, as gains on a machine.

# Macros of the main header by the field of `DriveValues`.
_MACROS = {
    "pole_pairs": "POLE_PAIRS",
    "r_s": "R_S_OHM",
    "l_d": "L_D_H",
    "l_q": "L_Q_H",
    "psi_pm": "PSI_PM_WB",
    "i_max": "CURRENT_MAX_A",
    "t_s": "T_S_S",
}

_LOOPS = {
    "current_d": ("ID_KP_V_PER_A", "ID_KI_V_PER_AS"),
    "current_q": ("IQ_KP_V_PER_A", "IQ_KI_V_PER_AS"),
    "speed": ("SPEED_KP_NMS_PER_RAD", "SPEED_KI_NM_PER_RAD"),
}


def is_own(file: TextFile) -> bool:
    """Whether a text is a header or a JSON of dqforge."""
    if file.source.lower().endswith(".json"):
        return '"dqforge"' in file.text[:200] and '"command"' in file.text[:400]
    return "controller coefficients for " in file.text[:400] and "#ifndef" in file.text


def own_gains(side: Side) -> OwnGains:
    """Gains and machine of what dqforge wrote.

    Args:
        side: As `dqforge.reports.comparison.sources.read_side` gives it.

    Raises:
        InputError: It holds none, or something that is no number.
    """
    found = _of_macros(side) if side.header_only else _of_result(side)
    if found.current_q is None and found.current_d is None:
        raise InputError(
            "holds no gains: its design has none; tune it, and run it again",
            source=side.source,
        )
    return found


def _of_result(side: Side) -> OwnGains:
    drive = {name: _own_files_number(side, "drive", key) for name, key in DRIVE_KEYS.items()}
    drive["t_speed"] = _own_files_number(side, "gains", "speed", "t_s")
    i_d, i_q, speed = (
        _pair(
            _own_files_number(side, "gains", name, "kp"),
            _own_files_number(side, "gains", name, "ki"),
        )
        for name in ("i_d", "i_q", "speed")
    )
    observed = any(side.value("gains", key) is not None for key in ("observer", "position"))
    return OwnGains(_drive(drive), i_d, i_q, speed, observed=observed)


def _own_files_number(side: Side, *path: str) -> float | None:
    value: Any = side.value(*path)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(
            f"{'.'.join(path)}: expected a number, got {json.dumps(value)[:40]}; run the design "
            "again",
            source=side.source,
        )
    return float(value)


def _of_macros(side: Side) -> OwnGains:
    macros: Mapping[str, str] = side.macros or {}

    def value(name: str) -> float | None:
        text = macros.get(name)
        try:
            return None if text is None else float(text.removesuffix("F"))
        except ValueError:
            raise InputError(
                f"{name}: expected a number, got {text!r}; run the design again",
                source=side.source,
            ) from None

    drive = {name: value(macro) for name, macro in _MACROS.items()}
    ratio = value("SPEED_RATIO")
    if ratio is not None and drive["t_s"] is not None:
        drive["t_speed"] = ratio * drive["t_s"]
    i_d, i_q, speed = (_pair(value(kp), value(ki)) for kp, ki in _LOOPS.values())
    observed = any(name.startswith("OBSERVER_") for name in macros)
    return OwnGains(_drive(drive), i_d, i_q, speed, observed=observed)


def _pair(kp: float | None, ki: float | None) -> PiGains | None:
    return None if kp is None or ki is None else PiGains(kp, ki)


def _drive(values: Mapping[str, float | None]) -> DriveValues:
    pole_pairs = values.get("pole_pairs")
    rest = {name: value for name, value in values.items() if name != "pole_pairs"}
    return DriveValues(None if pole_pairs is None else int(pole_pairs), **rest)
