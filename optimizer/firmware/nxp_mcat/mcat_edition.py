"""The ages of MCAT and its two kinds of arithmetic: what the same macro means in each."""

from __future__ import annotations

from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Edition:
    """One age of the format.

    Args:
        version: Its name in a configuration.
        fixed: Whether the firmware computes in fractions of its scales.
        commented: Whether inputs stand in line comments; else in one JSON comment.
        current_share, speed_share: Integral macro over ki times the period: 1 where MCAT takes the
            integral for a sum of rectangles, 1/2 for one of trapezoids.
    """

    version: str
    fixed: bool
    commented: bool
    current_share: float
    speed_share: float


FLOAT_2025 = Edition("2025", False, False, 0.5, 0.5)

FLOAT_2022 = Edition("2022", False, False, 1.0, 1.0)

FLOAT_2019 = Edition("2019", False, True, 1.0, 1.0)

FIXED_2022 = Edition("2022 fixed point", True, False, 0.5, 1.0)

FIXED_2019 = Edition("2019 fixed point", True, True, 0.5, 1.0)


EDITIONS = {
    edition.version: edition
    for edition in (FLOAT_2025, FLOAT_2022, FLOAT_2019, FIXED_2022, FIXED_2019)
}
