"""Last digits of another library or processor are told from changes."""

from __future__ import annotations

import io
import random
import struct

import numpy as np
import pytest

from dqforge.reports.output.recomputation import NOISE, RELATIVE, changed_sample, changed_value


def bits(value: float) -> str:
    return f"0x{struct.pack('>f', value).hex().upper()}U"


@pytest.mark.parametrize("seed", range(20))
def test_a_number_is_held_within_the_bound_wherever_it_stands(seed: int) -> None:
    chance = random.Random(seed)
    value = chance.choice((-1.0, 1.0)) * 10.0 ** chance.uniform(-9.0, 9.0)
    near, far = (value * (1.0 + share * RELATIVE) for share in (0.9, 1.2))
    for shape in ('  "kp": {:.12g},', "#define K ({:.12e}F) /* V */", "<td>{:.12e}</td>"):
        number = shape.replace(":.12g", ":.12e") if abs(value) > 1e6 else shape
        assert changed_value(number.format(near), number.format(value), "result.json") is None
    shape = "#define K ({:.12e}F)"
    found = changed_value(shape.format(far), shape.format(value), "drive.h")
    assert found is not None
    assert (found.line, found.name) == (1, "K")
    row = "    {{ {}, {}, 0x00000000U }},"
    assert (
        changed_value(row.format(bits(near), 7), row.format(bits(value), 8), "a_vectors.h") is None
    )
    assert changed_value(row.format(bits(near), 7), row.format(bits(value), 9), "a_vectors.h")
    assert changed_value(row.format(bits(near), 7), row.format(bits(value), 8), "a.h")


@pytest.mark.parametrize(
    ("have", "want"),
    [
        ("#define P (3)", "#define P (4)"),
        ("0.5 V", "0.5 A"),
        ("1.0", "1.0 "),
        ("1.0", "1.0\n2.0"),
        ("-1.0", "1.0"),
        ("0.0", f"{100 * NOISE}"),
        ("a1.0000001b", "a1.0000002b"),
        ("true", "false"),
    ],
)
def test_words_and_whole_numbers_have_no_last_digits(have: str, want: str) -> None:
    assert changed_value(have, want, "result.json") is not None


def archive(**arrays: object) -> bytes:
    made = io.BytesIO()
    np.savez(made, **arrays)  # type: ignore[arg-type]
    return made.getvalue()


def test_samples_are_held_against_the_largest_of_their_array() -> None:
    times, values = np.arange(5), np.array([0.0, -2.0, 1.0, np.nan, 0.5])
    have = archive(t=times, i=values)
    assert changed_sample(have, have, exact=True) is None
    for share, changed in ((0.5, False), (2.0, True)):
        moved = values + share * RELATIVE * 2.0 * np.array([0.0, 0.0, 0.0, 0.0, 1.0])
        other = archive(t=times, i=moved)
        assert "i[4] is 0.5" in str(changed_sample(other, have, exact=True))
        assert (changed_sample(other, have) is not None) is changed
    assert changed_sample(archive(t=times + 1, i=values), have)
    assert changed_sample(archive(t=times), have)
    assert changed_sample(archive(t=times, i=values[:4]), have)
    assert changed_sample(have[:-9], have)


def test_a_certificate_may_have_other_boxes() -> None:
    boxes = '["0", "1/2"],', '["0", "1/4"],\n["1/4", "1/2"],'
    assert changed_value(*boxes, "a_certificate.json") is None
    assert changed_value(*boxes, "a_stability.json") is not None
