"""The order of the cells, and the tree of their cuts."""

from __future__ import annotations

import numpy as np
import pytest
from random_current_loops import drives_inside, random_boxes

from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    Cell,
    Cut,
    Empty,
    Open,
    Proven,
    Refuted,
    Remainder,
    Tree,
    Verdict,
    _refuted,
    _rest_falls,
    largest_moduli,
    loop_matrices,
    parameters_of,
    search,
)

SQUARE = Cell(np.zeros(2), np.ones(2))


def middle_of_the_longer(cell: Cell) -> Cut:
    axis = int(np.argmax(cell.width))
    return Cut(axis, float(cell.middle[axis]), cell)


def examine(cell: Cell) -> Verdict[float]:
    """Proven where narrow; nothing is beyond the diagonal."""
    if cell.low.sum() >= 1.0:
        return Empty()
    return Proven(float(cell.width.max())) if cell.width.max() < 0.3 else middle_of_the_longer(cell)


def test_cells_fill_the_box() -> None:
    tree = search(SQUARE, examine, lambda cell: float(cell.low.sum()), 1000)
    assert tree.complete
    verdicts = tree.preorder()
    assert len(verdicts) == tree.examined == len(tree.nodes)
    area, waiting = 0.0, [SQUARE]
    for verdict in verdicts:
        cell = waiting.pop()
        if isinstance(verdict, Cut):
            waiting += reversed(verdict.cell.halves(verdict.axis, verdict.value))
        else:
            assert isinstance(verdict, Empty | Proven)
            area += float(np.prod(cell.width))
    assert not waiting
    assert area == 1.0


def test_the_worst_comes_first_and_a_refuted_cell_ends_it() -> None:
    seen = []

    def refuting(cell: Cell) -> Verdict[float]:
        seen.append(cell)
        corner = cell.high.min() == 1.0 and cell.width.max() < 0.1
        return Refuted(cell.high) if corner else middle_of_the_longer(cell)

    tree = search(SQUARE, refuting, lambda cell: float(cell.high.sum()), 1000)
    assert tree.counterexample is not None
    assert not tree.complete
    assert len(seen) == 9  # four cuts of each parameter lead to the corner, no cell beside them


def test_what_was_not_reached_stays_open() -> None:
    tree: Tree[float] = search(SQUARE, middle_of_the_longer, lambda _: 0.0, 5)
    assert not tree.complete
    assert len(tree.open_cells) == 6
    assert sum(isinstance(verdict, Open) for verdict in tree.preorder()) == 6


def test_a_drive_that_is_barely_unstable_refutes() -> None:
    """Of drives by chance, those whose largest eigenvalue is between 1 and 1.2."""
    rng, met = np.random.default_rng(4), 0
    for box in random_boxes(40, 3, fast=True):
        rows = drives_inside(box, rng, 20)
        points = np.array([parameters_of(box, BoxDrive(*row)) for row in rows])
        moduli = largest_moduli(loop_matrices(box, points))
        for point, modulus in zip(points, moduli, strict=True):
            found = _refuted(box, point[None], np.array([modulus]))
            if 1.0 + 1e-6 < modulus < 1.2:
                assert found is not None
                assert found == pytest.approx(point, rel=1e-6)
                met += 1
            elif modulus < 1.0:
                assert found is None
    assert met > 3


@pytest.mark.parametrize("cross", [0.0, 0.3])
@pytest.mark.parametrize(("away", "falls"), [(-2e-5, True), (-5e-6, False), (5e-6, False)])
def test_a_rest_falls_with_a_reserve_for_rounding(cross: float, away: float, falls: bool) -> None:
    """One state: 2 c r + o r^2 of a matrix o, a loop c in its norm and a rest r, against one."""
    own, frame = 1.7, 0.8
    # The reach at which the sum is one and so much more or less.
    reach = (-cross + np.sqrt(cross**2 + own * (1.0 + away))) / own
    closed = cross / (frame * own)
    remainder = Remainder(rows=(0,), groups=(((0,), reach / frame),))
    found = _rest_falls(np.array([[[frame]]]), np.array([[own]]), np.array([[[closed]]]), remainder)
    assert found == falls
