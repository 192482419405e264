"""Steps in codes of one word as C: what the reader makes of conversions, loops and tables."""

from __future__ import annotations

from typing import Any

import pytest

from dqforge.machines.transforms import N
from dqforge.optimizer.steps.code_vectors import AlphaBeta, Coded, Dq, Turned
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic, rounded, saturated
from dqforge.reports.steps.code_reader import Code, CodeReader
from dqforge.reports.steps.code_text import basics_reader, code_reader, texts, write

_ANY: Any = Code("number", kind="wide")


def reader(width: int) -> CodeReader:
    return code_reader("d", width, known=basics_reader("d", width).functions)


def body(found: CodeReader) -> str:
    return texts(found).split("{\n", 1)[1].rsplit("}", 1)[0]


def doubled(o: Arithmetic[N, Any], width: int, x: Coded[N]) -> Coded[N]:
    """Twice a code."""
    return o.call(saturated, width, o.product("2 x", o.const(2), x))


@pytest.mark.parametrize(("width", "wide"), [(16, "int32_t"), (32, "int64_t")])
def test_operators_compute_in_wide_words(width: int, wide: str) -> None:
    """One cast widens a product, constants stand behind."""
    found = reader(width)
    write(found, doubled, width, _ANY)
    form = f"q{width - 1}"
    assert texts(found).split("\n")[1] == (
        f"static inline int{width}_t d_doubled_{form}(int{width}_t x)"
    )
    assert body(found).strip() == f"return d_saturated_{form}(({wide})x * 2);"


def halved(o: Arithmetic[N, Any], x: N) -> N:
    """Halves until it is small."""
    places = o.halvings("x", x, 100, into=("left", "places"))
    return o.rounded_by("x", x, places)


def test_halving_is_a_loop() -> None:
    found = reader(16)
    write(found, halved, _ANY)
    lines = [line.strip() for line in body(found).split("\n") if line]
    assert lines == [
        "int32_t left = x;",
        "uint32_t places = 0U;",
        "while (left > 100) {",
        "left >>= 1U;",
        "++places;",
        "}",
        "return d_rounded_q15(x, places);",
    ]


def looked_up(o: Arithmetic[N, Any], theta: Turned[N]) -> N:
    """A slope of a table."""
    index = o.let("index", o.shifted(theta, 14))
    low, high = o.neighbours((3, 5, 8, 13, 21), index, ("table", "at"))
    return o.total("slope", high, o.negative(low))


def test_a_table_stands_before_all_else() -> None:
    found = reader(16)
    write(found, looked_up, _ANY)
    lines = [line.strip() for line in body(found).split("\n") if line]
    assert lines == [
        "static const uint16_t table[5] = {",
        "3U, 5U, 8U, 13U, 21U",
        "};",
        "const uint16_t index = (uint16_t)(theta >> 14U);",
        "const uint16_t *at = &table[index];",
        "return (int32_t)at[1] - (int32_t)at[0];",
    ]


def kept(o: Arithmetic[N, Any], width: int, x: AlphaBeta[N]) -> Dq[N]:
    """Limits that are known leave no text, those that are not are a comparison."""
    y = o.let("y", o.clamp(x.y, None, 7))
    return Dq(o.known(x.x, 0, 5), o.call(rounded, "y", y, width))


def test_known_limits_leave_no_text() -> None:
    found = reader(16)
    write(found, kept, 16, AlphaBeta(_ANY, _ANY))
    text = body(found)
    assert "result.d = x.alpha;" in text
    assert "const int16_t y = (x.beta > 7) ? 7 : x.beta;" in text
    assert "result.q = (int16_t)d_rounded_q15(y, 16U);" in text


def twice(o: Arithmetic[N, Any], x: N) -> N:
    """A product that is used twice without a name."""
    square = o.product("x^2", x, x)
    return o.total("2 x^2", square, square)


def test_what_is_used_twice_needs_a_name() -> None:
    with pytest.raises(ValueError, match="used twice"):
        write(reader(16), twice, _ANY)
