"""What a worker must share."""

from __future__ import annotations

from dqforge import __version__
from dqforge.reports.exploration.local_cluster import (
    COMPARED,
    CPU,
    SOURCES,
    first_difference,
    worker_facts,
)


def test_facts_name_all_that_bytes_depend_on() -> None:
    facts = worker_facts()
    assert facts["dqforge"] == __version__
    assert {*COMPARED, CPU, SOURCES, "processor"} <= set(facts)
    assert all(facts.values())
    assert first_difference(facts, facts) == ""


def test_what_differs_is_said() -> None:
    here = worker_facts()
    assert first_difference(here | {"dqforge": "0.0.1"}, here) == (
        f"has dqforge 0.0.1, here is {__version__}"
    )
    assert first_difference({}, {"scipy": "1.17"}) == "has scipy none, here is 1.17"
    assert first_difference(here | {SOURCES: "0"}, here) == (
        f"has other sources of dqforge {__version__}"
    )
    assert first_difference({CPU: "AVX2 FMA3 SSE"}, {CPU: "AVX512F AVX512VL FMA3 SSE"}) == (
        "has other CPU features (AVX512F and 1 more only here, AVX2 only there)"
    )
