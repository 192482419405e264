"""Quantities of two designs or results side by side: machine, limits, references,
gains and phase currents.
"""

from __future__ import annotations

import hashlib

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Quantity, Value
from dqforge.reports.comparison.sources import Side


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
