"""Ranges of torque that end with the data, and what an error is against its budget."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import FitBudget
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.current_reference.solve import _excess, _keeps, _range, is_hopeless


@pytest.mark.parametrize("first", [3.3217, 0.1234, 9.876])
@pytest.mark.parametrize("last", [9.99, 20.0])
def test_a_range_begins_where_it_does_to_a_millionth(first: float, last: float) -> None:
    asked = []

    def holds(torque: FloatArray) -> BoolArray:
        asked.append(torque.size)
        return np.asarray((torque >= first) & (torque <= last))

    found = _range(holds, 10.0)
    assert found is not None
    assert found[0] == pytest.approx(first, abs=1e-7)
    assert found[0] >= first
    assert found[1] == pytest.approx(min(last, 10.0), abs=10.0 / 800.0)
    assert found[1] <= last
    assert asked[0] == 800  # not at rest


def test_a_range_from_rest_begins_there_and_nothing_has_none() -> None:
    assert _range(lambda torque: torque > 0.009, 10.0) == (0.0, 10.0)
    found = _range(lambda torque: torque > 0.012, 10.0)
    assert found is not None
    assert found[0] == pytest.approx(0.012, abs=1e-6)
    assert _range(lambda torque: torque > 11.0, 10.0) is None


@pytest.mark.parametrize("torque", [0.9, 1.0, 1.1, 4.9, 5.1])
@pytest.mark.parametrize("loss", [0.9, 1.1, 15.9, 16.1])
def test_errors_are_held_against_their_budgets(torque: float, loss: float) -> None:
    errors = ReferenceErrors(0.0, 0.0, 0.0, 0.02 * torque, 0.0, 0.01 * loss, 0.0, None, 9)
    both = FitBudget(torque_error=0.02, loss_penalty=0.01)
    assert _keeps(errors, both) == (torque <= 1.0 and loss <= 1.0)
    assert _keeps(errors, FitBudget(torque_error=0.02)) == (torque <= 1.0)
    assert _keeps(errors, FitBudget(loss_penalty=0.01)) == (loss <= 1.0)
    assert _keeps(errors, FitBudget())
    assert is_hopeless(errors, both) == (torque > 5.0 or loss > 16.0)
    assert _excess(errors, both) == pytest.approx(max(torque, loss))
    assert _excess(errors, FitBudget(loss_penalty=0.01)) == pytest.approx(loss)
    assert _excess(errors, FitBudget()) == 0.0
