"""Speeds of edges against what their definitions say of drawn instants, which need no timer."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from dqforge.optimizer.speed_measurement import counted, timed
from dqforge.optimizer.steps.step_arithmetic import EXACT

MASK, PATIENCE, PERIOD = 0xFFFF, 4, 9000
Edges = list[tuple[int, int]]  # instant in ticks, sense
# Ticks from edge to edge, senses, and how many: fast and slow, to and fro, with rests.
PARTS = (
    (1500, 1, 30), (7000, 1, 6), (20_000, 1, 5), (900, -1, 20), (50_000, -1, 1), (300, -1, 9),
    (16_000, 1, 4), (60_000, 1, 1), (2500, -1, 2), (2500, 1, 2), (1, 1, 5),
)  # fmt: skip


def drawn(seed: int) -> Edges:
    rng, time, edges = np.random.default_rng(seed), 70_000, []
    for gap, sense, count in PARTS:
        for _ in range(count):
            time += int(gap * rng.uniform(0.8, 1.2)) + 1
            edges.append((time, sense))
    return edges


def series(edges: Edges, now: int, asked: list[int]) -> Edges:
    """The last edges of one sense without a rest, until now."""
    found: Edges = []
    for time, sense in (one for one in edges if one[0] <= now):
        if found:
            idle = sum(found[-1][0] < each <= time for each in asked)
            if sense != found[-1][1] or min(idle, PATIENCE) == PATIENCE:
                found = []
        found.append((time, sense))
    return found


def by_definition(edges: Edges, asked: list[int], *, mixed: bool) -> Iterator[tuple[int, int]]:
    """Edges and ticks at every question, the time as long as it is."""
    used, held, mean = 0, (0, 1), 0
    for n, now in enumerate(asked):
        own = series(edges, now, asked[:n])
        idle = sum(own[-1][0] < each for each in asked[:n]) if own else PATIENCE
        if len(own) < 2 or idle >= PATIENCE:
            held = 0, 1
            used = own[0][0] if own else 0
        elif not mixed:
            (before, _), (last, sense) = own[-2:]
            held = sense, max(last - before, now - last)
        else:
            used = max(used, own[0][0])
            new = [time for time, _ in own if time > used]
            (last, sense), elapsed = own[-1], now - own[-1][0]
            if new:
                held, mean = (len(new) * sense, last - used), (last - used) // len(new)
                used = last
            elif elapsed > mean:
                held = sense, elapsed
        yield held


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("mixed", [True, False])
def test_a_timer_that_runs_over_tells_edges_and_what_they_took(seed: int, mixed: bool) -> None:
    edges, offset = drawn(seed), 60_000
    asked = list(range(65_000, edges[-1][0] + 8 * PERIOD, PERIOD))
    scale = 0.37
    gains = timed.SpeedMeasurementGains(np.array(scale), MASK, PATIENCE)
    state, left = timed.at_rest(), list(edges)
    state.time = state.stamp = state.count = 5
    timed.start(EXACT, state)
    assert state == timed.at_rest()
    measure = timed.mixed if mixed else timed.captured
    found = []
    for now in asked:
        while left and left[0][0] <= now:
            time, sense = left.pop(0)
            timed.edge(EXACT, gains, state, (time + offset) & MASK, sense)
        measure(EXACT, gains, state, (now + offset) & MASK)
        found.append((int(state.count), int(state.span)))
        told = scale * found[-1][0] / found[-1][1]
        assert timed.rad_per_s(EXACT, gains, state) == pytest.approx(told)
    assert found == list(by_definition(edges, asked, mixed=mixed))
    # fast and slow, both ways, and rests
    assert {np.sign(count) for count, _ in found} == {-1, 0, 1}
    assert any(span > 20_000 for _, span in found)


@pytest.mark.parametrize("width", [16, 32])
def test_a_code_is_that_of_the_exact_speed_within_its_range(width: int) -> None:
    cases = [(3, 1000), (-3, 1000), (-7, 3), (900, 2), (-900, 2), (0, 1), (1, 65_000), (150, 1)]
    top = (1 << (width - 1)) - 1
    code, state = top // 200, timed.at_rest()
    state.count = np.array([count for count, _ in cases], dtype=np.int32)
    state.span = np.array([span for _, span in cases], dtype=np.uint32)
    sizes = [min(math.floor(Fraction(code * abs(count), span)), top) for count, span in cases]
    expected = [
        size * (-1 if count < 0 else 1) for size, (count, _) in zip(sizes, cases, strict=True)
    ]
    assert timed.per_unit(EXACT, width, code, state).tolist() == expected


def test_counts_are_the_way_from_sample_to_sample_of_a_counter_that_runs_over() -> None:
    state: Any = counted.at_rest()
    state.count = state.known = 3
    counted.start(EXACT, state)
    assert state == counted.at_rest()
    gains, at = counted.SpeedMeasurementGains(np.array(0.5)), (1 << 32) - 20
    for n, move in enumerate([0, 17, 100, -130, -5, 0, (1 << 31) - 1, -(1 << 31), 1 << 20]):
        at += move
        with np.errstate(over="ignore"):
            counted.sample(EXACT, state, np.uint32(at % (1 << 32)))
        assert state.count == (move if n else 0)
        assert timed.rad_per_s(EXACT, gains, state) == 0.5 * move
