"""Numbers and text for C source: shortest decimals that read back to the same float,
comments that stay comments.
"""

from __future__ import annotations

import math
import re
from decimal import ROUND_UP, Context

import numpy as np
from numpy.typing import NDArray

_UNPRINTABLE = re.compile(r"[^\x20-\x7e]")


def float_literal(value: float) -> str:
    """Shortest decimal literal of a float, such as ``0.1049F``, that reads
    back to the same 32 bits.

    Raises:
        ValueError: The value is not finite as a float: an emitted header must not hold it.
    """
    with np.errstate(over="ignore"):
        single = np.float32(value)
    if not math.isfinite(single):
        raise ValueError(f"{value!r} is not finite in single precision")
    if single == 0.0 or 1e-4 <= abs(single) < 1e7:
        text = np.format_float_positional(single, unique=True, trim="0")
    else:
        text = np.format_float_scientific(single, unique=True, trim="0", exp_digits=1)
    return f"{text}F"


def addend(value: float) -> str:
    """A float literal behind a sum, with its sign as the operator: ``+ 1.5F`` or ``-
    1.5F`` (the same operation).
    """
    return f"{'-' if math.copysign(1.0, value) < 0.0 else '+'} {float_literal(abs(value))}"


def comment_text(text: str) -> str:
    """Text that cannot leave a C comment or add a line: printable ASCII without
    comment marks or trigraphs.
    """
    ascii_text = _UNPRINTABLE.sub(".", text.replace("\u00b5", "u").replace("\u03a9", "Ohm"))
    without_marks = ascii_text.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *")
    return re.sub(r"\?(?=\?)", "? ", without_marks)


def rounded_up(value: float, digits: int = 3) -> str:
    """Positive number with significant digits, rounded away from zero: a stated error is
    never below the found one.
    """
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    nearest = f"{value:.{digits}g}"
    if float(nearest) >= value:
        return nearest
    # In decimals, which hold every double exactly: a product with a power of ten
    # may already round downwards.
    return f"{float(Context(prec=digits, rounding=ROUND_UP).create_decimal(value)):.{digits}g}"


def hexadecimal_word(value: np.float32) -> str:
    """The 32 bits of a float as a C constant, such as ``0x3F800000U``."""
    return f"0x{int(np.float32(value).view(np.uint32)):08X}U"


def int32_literal(value: int) -> str:
    """An integer of 32 bits.

    The least one has no literal of its own, as the minus sign is an operator.
    """
    return "(-2147483647 - 1)" if value == -(2**31) else str(int(value))


def int32_addend(value: int) -> str:
    """An integer of 32 bits behind a sum, with its sign as the operator."""
    return (
        f"+ {int32_literal(value)}"
        if value == -(2**31)
        else f"{'-' if value < 0 else '+'} {abs(int(value))}"
    )


def int64_literal(value: int) -> str:
    """An integer of 64 bits as the constant macro of <stdint.h> makes it."""
    return f"INT64_C({int(value)})" if value != -(2**63) else "(-INT64_C(9223372036854775807) - 1)"


# Rows of numbers in C: the inside of an initialiser.


def number_rows(values: NDArray[np.float32], count: int) -> list[str]:
    """Lines of a table, shape (N, M), with so many numbers to a line."""
    lines = []
    for row in values:
        texts = [float_literal(float(value)) for value in row]
        parts = (texts[at : at + count] for at in range(0, len(texts), count))
        lines += ["    {", *(f"        {', '.join(part)}," for part in parts), "    },"]
    return lines
