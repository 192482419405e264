"""How long a batch may take."""

from __future__ import annotations

from dqforge.reports.exploration.contained_rows import TimeLimits


def test_a_limit_that_is_given_holds_for_every_batch() -> None:
    limits = TimeLimits(5.0, 100, [1.0] * 10)
    assert (limits.of(100), limits.of(1), limits.in_words()) == (5.0, 5.0, "5 s")


def test_a_limit_is_learned_from_what_parts_took() -> None:
    limits = TimeLimits(None, 100)
    assert limits.of(100) == 900.0
    limits.taken += [4.0, 4.0, 4.0]
    assert limits.of(100) == 120.0
    assert limits.of(50) == 60.0
    assert limits.of(1) == 10.0
    limits.taken.append(100.0)
    assert limits.of(100) == 500.0
    assert limits.in_words() == "30 usual batches"
    assert TimeLimits(None, 100, [0.01] * 3).of(100) == 60.0
