"""Steps as graphs of CasADi, and readings on arrays, against the same sums in plain numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest

from dqforge.optimizer.steps.step_arithmetic import EXACT
from dqforge.optimizer.steps.step_graphs import Graphs, Number, graph

o = Graphs()
POINTS = [(0.7, -2.5), (-1.3, 0.4), (-4.0, -3.25), (7.5, 2.0), (2.0, 2.0)]

# Of two numbers: as graphs, and as numbers of Python.
WORKS: dict[str, tuple[Callable[[Any, Any], Any], Callable[[float, float], float]]] = {
    "sums": (lambda a, b: a + b * 3.0 + 0.5, lambda a, b: a + 3.0 * b + 0.5),
    "sums from the left": (lambda a, b: 0.5 + (2.0 * a + b), lambda a, b: 0.5 + 2.0 * a + b),
    "differences": (lambda a, b: (a - b) - 0.25, lambda a, b: a - b - 0.25),
    "differences from the left": (lambda a, b: 0.25 - a * b, lambda a, b: 0.25 - a * b),
    "quotients": (lambda a, b: a / b + a / 4.0, lambda a, b: a / b + 0.25 * a),
    "quotients from the left": (lambda a, b: 3.0 / a - (-b), lambda a, b: 3.0 / a + b),
    "below": (lambda a, b: o.choose(a < b, a, 9.0), lambda a, b: a if a < b else 9.0),
    "not above": (lambda a, b: o.choose(a <= b, a, 9.0), lambda a, b: a if a <= b else 9.0),
    "above": (lambda a, b: o.choose(a > b, 8.0, b), lambda a, b: 8.0 if a > b else b),
    "not below": (lambda a, b: o.choose(a >= b, 8.0, b), lambda a, b: 8.0 if a >= b else b),
    "both": (
        lambda a, b: o.choose((a < 0.0) & (b < 0.0), a, b),
        lambda a, b: a if a < 0.0 and b < 0.0 else b,
    ),
    "products": (lambda a, b: o.product("", a, o.negative(b)), lambda a, b: -a * b),
    "totals": (lambda a, b: o.total("", a, b, a * b), lambda a, b: a + b + a * b),
    "magnitudes": (lambda a, b: o.magnitude(a) - o.root(b * b), lambda a, b: abs(a) - abs(b)),
    "wrapped": (
        lambda a, b: o.wrap(a * 3.0) + o.wrap(b),
        lambda a, b: math.remainder(3.0 * a, 2.0 * math.pi) + math.remainder(b, 2.0 * math.pi),
    ),
    "cosines": (lambda a, b: o.rotation(a).cosine * b, lambda a, b: math.cos(a) * b),
    "sines": (lambda a, b: o.rotation(a).sine * b, lambda a, b: math.sin(a) * b),
    "reached": (
        lambda a, b: o.reached("", [a > -2.0, a > 0.0, a > 1.0]) + b,
        lambda a, b: sum(a > x for x in (-2.0, 0.0, 1.0)) + b,
    ),
    "entries": (
        lambda a, b: o.at([5.0, b, 3.0, a], o.reached("", [a > -2.0, a > 0.0, a > 1.0])),
        lambda a, b: [5.0, b, 3.0, a][sum(a > x for x in (-2.0, 0.0, 1.0))],
    ),
    "entries of columns": (
        lambda a, b: (
            o.at([(1.0, b), (2.0, a)], o.reached("", [a > 0.0]), 1) + o.at([(a, 4.0)], 0, 1)
        ),
        lambda a, b: (a if a > 0.0 else b) + 4.0,
    ),
    "loops": (
        lambda a, b: o.summed("", a, 3, lambda k: b * float(k + 1)),
        lambda a, b: a + 6.0 * b,
    ),
    "arrays": (lambda a, b: o.each("", 3, lambda k: a * float(k) + b)[2], lambda a, b: 2.0 * a + b),
    "constants": (lambda a, b: o.full(2.5, a) * b + a, lambda a, b: 2.5 * b + a),
    "branches": (
        lambda a, b: o.either(a < b, lambda: (a, (b, 1.0)), lambda: (b, (a, 1.0)))[1][0],
        max,
    ),
}


@pytest.mark.parametrize("name", WORKS)
def test_graphs_compute_what_their_numbers_would(name: str) -> None:
    of, plain = WORKS[name]
    x = casadi.SX.sym("x", 2)
    step = casadi.Function("step", [x], [graph(of(Number(x[0]), Number(x[1])))])
    for a, b in POINTS:
        assert float(step([a, b])) == pytest.approx(plain(a, b), rel=1e-14, abs=1e-14)


def test_arrays_of_numpy_take_graphs_one_by_one() -> None:
    a = Number(casadi.SX.sym("a"))
    found = np.array([2.0, 3.0]) * a
    assert found.shape == (2,)
    step = casadi.Function("step", [a.graph], [found[1].graph])
    assert float(step(5.0)) == 15.0


def test_places_of_arrays_are_numbers_without_what_is_behind_the_point() -> None:
    numbers = np.array([0.0, 0.99, 1.0, 2.7, 9.0])
    assert EXACT.placed("", numbers, 3).tolist() == [0, 0, 1, 2, 3]
    axis = [0.0, 1.0, 2.5, 4.0]
    assert EXACT.interval("", axis, np.array([-1.0, 1.0, 1.1, 2.6, 9.0])).tolist() == [
        0,
        0,
        1,
        2,
        2,
    ]
    assert EXACT.converted(np.array([70_000, -1]), "uint16").tolist() == [4464, 65535]
    assert EXACT.masked(np.array([0b1101]), 0b0110).tolist() == [0b0100]
    assert EXACT.at([np.array([1.0, 2.0]), np.array([3.0, 4.0])], np.array([1, 0])).tolist() == [
        3.0,
        2.0,
    ]
    assert EXACT.with_item((1.0, 2.0, 3.0), 1, 5.0) == (1.0, 5.0, 3.0)
    drives = EXACT.with_item((np.zeros(2), np.zeros(2)), np.array([0, 1]), np.array([5.0, 6.0]))
    assert [part.tolist() for part in drives] == [[5.0, 0.0], [0.0, 6.0]]
