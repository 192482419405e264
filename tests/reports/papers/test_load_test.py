"""The load test of paper 000, run with the emitted controller."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.papers import paper000_figures as plain
from dqforge.reports.papers import paper000_load_test
from dqforge.reports.papers import paper000_whole_paper as tables
from dqforge.reports.papers.paper000_figures import plot_load_tests
from dqforge.reports.papers.paper000_load_test import LoadTest


@pytest.fixture(scope="module")
def load_tests() -> tuple[LoadTest, ...]:
    return paper000_load_test.load_tests()


@pytest.mark.slow
def test_the_load_is_carried_and_mtpa_needs_less_current(load_tests: tuple[LoadTest, ...]) -> None:
    direct, spwm, dpwm = load_tests
    for test in load_tests:
        assert test.deviation < 3.0  # of 300 rad/s
        assert test.end_error < 0.01
        assert test.torque == pytest.approx(130.0, abs=0.1)
        assert test.current == pytest.approx(test.expected, rel=5e-4)
        run = test.run
        ramp = (run.t > 2.6) & (run.t < 3.9)
        assert np.mean(run.torque[ramp]) == pytest.approx(90.0, abs=0.1)
    assert direct.current / spwm.current > 1.07
    assert dpwm.current == pytest.approx(spwm.current, rel=1e-3)
    assert "<svg" in to_svg(plot_load_tests(load_tests))
    assert len(tables.load_test_table(load_tests).rows) == 3
    assert plain.plain_load_tests(load_tests)[1]["current_A"] == spwm.current
