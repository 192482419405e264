"""What the main header holds beside its evaluator: constants in groups, without names in C."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Constant:
    """One number of the header.

    Args:
        quantity: What it is, as ``<group>.<symbol>`` (``i_d.kp``); a dialect finds its name by it.
        value: In ``unit``; a whole number for what is counted and for codes.
        unit: SI unit, ``per unit``, or empty for a pure number.
        meaning, note: What it is, and what is said behind the unit.
        base: What one is of a value per unit, by the quantities of its bases.
        bits: Fractional bits of a code, None of other numbers.
    """

    quantity: str
    value: float
    unit: str
    meaning: str = ""
    note: str = ""
    base: str = ""
    bits: int | None = None


@dataclass(frozen=True, slots=True)
class ConstantGroup:
    """Constants that belong together, with a title and lines of comment."""

    title: str
    constants: tuple[Constant, ...] = ()
    comment: tuple[str, ...] = ()
