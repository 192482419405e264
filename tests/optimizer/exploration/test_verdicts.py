"""Values held against bounds."""

from __future__ import annotations

import numpy as np

from dqforge.optimizer.exploration.row_block import VERDICT_MARGIN, within


def test_bounds_leave_room_for_rounding_and_nothing_for_what_is_no_number() -> None:
    near, far = 1.0 + 0.5 * VERDICT_MARGIN, 1.0 + 2.0 * VERDICT_MARGIN
    values = np.array([-2.0, -far, -near, 0.0, near, far, 2.0, np.nan])
    assert within(values, 1.0, None).tolist() == [True] * 5 + [False] * 3
    assert within(values, None, -1.0).tolist() == [False] * 2 + [True] * 5 + [False]
    assert within(values, 1.0, -1.0).tolist() == [False] * 2 + [True] * 3 + [False] * 3
    assert within(values, None, None).tolist() == [True] * 7 + [False]
