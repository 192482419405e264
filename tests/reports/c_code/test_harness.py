"""What a harness gave beside its model: the same bits, or a refusal that names the first row."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.errors import VerificationError
from dqforge.reports.c_code.harness import Harness, Programme

MODEL = np.array([[1.0, np.nan], [-0.0, 4.0]], dtype=np.float32)
ROWS = Harness(
    "", "torque; i_d and i_q", (1, 2), ("@_current_reference(in[0], &out[0], &out[1]);",)
)
PART = Programme(ROWS, np.array([0.5, 0.75], dtype=np.float32), MODEL)


def test_results_have_the_shape_of_the_model_or_are_none() -> None:
    found = PART.results(MODEL.tobytes())
    assert found is not None
    assert found.shape == MODEL.shape
    assert PART.results(MODEL.tobytes()[:-1]) is None


def test_equal_bits_pass() -> None:
    PART.require_model(MODEL.copy(), "on a core", "the core", any_nan=False)


def test_the_first_row_of_other_bits_is_named() -> None:
    other = MODEL.copy()
    other[1, 0] = 0.0  # equal to the model as a number, not as bits
    with pytest.raises(VerificationError, match=r"on a core 1 of 2 results .* 0\.75: the core"):
        PART.require_model(other, "on a core", "the core", any_nan=True)


def test_another_not_a_number_counts_only_where_asked() -> None:
    other = MODEL.copy()
    other.view(np.uint32)[0, 1] ^= 0x8000_0000
    PART.require_model(other, "on a core", "the core", any_nan=True)
    with pytest.raises(VerificationError, match="compiled as c99, 1 of 2"):
        PART.require_model(other, "compiled as c99,", "C", "float32 ", any_nan=False)
