"""Limits of a study are read in the units of the outputs that they bound."""

from __future__ import annotations

import pytest

from dqforge.machines.exploration.study_checks import dimension_of
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.optimizer.exploration.row_outputs import LOSS_QUANTITIES, known_names, output_named

AT_POINTS = [f"losses.points.{place}.{name}" for place in (0, 12) for name in LOSS_QUANTITIES]


@pytest.mark.parametrize("name", [*known_names(), *AT_POINTS])
def test_a_limit_has_the_unit_of_its_output(name: str) -> None:
    output = output_named(name)
    assert output is not None
    assert DIMENSIONS[dimension_of(name)].unit == output.unit
