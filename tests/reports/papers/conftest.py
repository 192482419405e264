"""Paper 001 recomputed once for all tests of its room."""

from __future__ import annotations

import pytest

from dqforge.reports.papers.paper001_bench_transients import Reproduction, reproduce_paper


@pytest.fixture(scope="session")
def reproduced() -> Reproduction:
    return reproduce_paper()
