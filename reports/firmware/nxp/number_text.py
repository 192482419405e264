"""Numbers as MCAT's headers print them."""

from __future__ import annotations

from decimal import ROUND_HALF_UP, Decimal

DIGITS = 6


def constant_text(value: float, kind: str, *, commented: bool) -> str:
    """The text behind a macro.

    Args:
        value: Its number.
        kind: ``plain``, ``float``, ``FRAC16``, ``FRAC32`` or ``ACC32``.
        commented: Whether it is that of the older age, which prints all digits.
    """
    if kind == "plain":
        return f"({plain(value)})"
    text = _all_digits(value) if commented else six_digits(value)
    return f"({text}F)" if kind == "float" else f"{kind}({text})"


def six_digits(value: float) -> str:
    """As it is with fewer than six decimal places, else with six significant digits."""
    if value == int(value):
        return f"{value:.1f}"
    exact = Decimal(repr(value))
    exponent = exact.as_tuple().exponent
    if isinstance(exponent, int) and -exponent < DIGITS:
        return f"{exact:f}"
    step = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    return f"{Decimal(value).quantize(step, rounding=ROUND_HALF_UP):f}"


def plain(value: float | bool) -> str:
    """A number without exponent, whole ones without a point; true or false."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not value.is_integer():
        return f"{Decimal(repr(value)):f}"
    return str(int(value))


def _all_digits(value: float) -> str:
    return f"{value:.1f}" if value == int(value) else f"{Decimal(repr(value)):f}"
