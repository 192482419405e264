"""Numbers in C text: every literal reads back to the same float, and no
text can leave its comment.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dqforge.reports.c_code.numbers import (
    addend,
    comment_text,
    float_literal,
    hexadecimal_word,
    rounded_up,
)

FLOAT_TOKEN = re.compile(r"-?(\d+\.\d+(e[+-]?\d+)?)F")


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_float_literals_read_back_and_are_c_floats(value: float) -> None:
    literal = float_literal(value)
    assert FLOAT_TOKEN.fullmatch(literal), literal
    assert np.float32(literal[:-1]).view(np.uint32) == np.float32(value).view(np.uint32)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_addends_carry_the_sign_as_operator(value: float) -> None:
    sign, literal = addend(value).split(" ")
    restored = np.float32(literal[:-1]) * np.float32(1 if sign == "+" else -1)
    assert restored == np.float32(value)
    assert not literal.startswith("-")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e39])
def test_what_is_no_float_is_refused(value: float) -> None:
    with pytest.raises(ValueError, match="not finite"):
        float_literal(value)


@given(st.text())
def test_no_text_leaves_a_comment_or_adds_a_line(text: str) -> None:
    safe = comment_text(text)
    assert "*/" not in safe
    assert "/*" not in safe
    assert "??" not in safe
    assert "\\" not in safe
    assert safe.isascii()
    assert safe.isprintable() or safe == ""


def test_words() -> None:
    assert hexadecimal_word(np.float32(1.0)) == "0x3F800000U"
    assert hexadecimal_word(np.float32(-0.0)) == "0x80000000U"


@given(st.floats(1e-30, 1e30), st.integers(2, 5))
def test_stated_errors_are_never_rounded_down(value: float, digits: int) -> None:
    stated = float(rounded_up(value, digits))
    assert value <= stated <= value * (1.0 + 10.0 ** (1 - digits) + 1e-12)


def test_numbers_of_few_digits_stay_and_others_rise_by_one_place() -> None:
    assert rounded_up(0.1) == "0.1"
    assert rounded_up(float(np.nextafter(1.23, 2.0))) == "1.24"
    assert rounded_up(1e-300, 2) == "1e-300"
    assert rounded_up(9.9999) == "10"
    assert rounded_up(0.0) == "0"


def test_comment_marks_that_overlap() -> None:
    assert comment_text("a*/b/*/c???\\") == "a* /b/ * /c? ? ?/"
    assert comment_text("5 \u00b5s, 2 m\u03a9") == "5 us, 2 mOhm"
