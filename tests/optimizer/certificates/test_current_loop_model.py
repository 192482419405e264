"""The loop in four parameters against the one in physical quantities, and what encloses it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from random_current_loops import corner_drives, drives_inside, radii, random_boxes

import dqforge.optimizer.certificates.current_loop_proof as confirmation
from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.certificates.both_axes_sensitivity import extended
from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    Cell,
    CurrentLoopBox,
    Remainder,
    contracts,
    corner_points,
    drive_at,
    largest_moduli,
    loop_matrices,
    lyapunov_frame,
    parameters_of,
    remainder,
    root_cell,
    rounded,
    shrunk,
)

Change = Callable[[CurrentLoopBox], CurrentLoopBox]

BOXES = random_boxes(12, 4, fast=True)


def with_dead_time(box: CurrentLoopBox) -> CurrentLoopBox:
    """Compensated too much at worst: resistances below zero."""
    return replace(box, dead_time=(-1.2 * box.r_s[0], 0.5 * box.r_s[0]))


def parameters(box: CurrentLoopBox, drives: FloatArray) -> FloatArray:
    return np.array([parameters_of(box, BoxDrive(*row)) for row in drives])


@pytest.mark.parametrize("change", [lambda box: box, with_dead_time])
def test_poles_are_those_of_the_physical_model_for_either_sense(change: Change) -> None:
    generator = np.random.default_rng(1)
    for box in map(change, BOXES):
        drives = drives_inside(box, generator, 60)
        points = parameters(box, drives)
        points[:, 3] = np.abs(points[:, 3])
        found = largest_moduli(loop_matrices(box, points))
        np.testing.assert_allclose(found, radii(box, drives), atol=1e-12)


@pytest.mark.parametrize("change", [lambda box: box, with_dead_time])
def test_no_drive_is_lost_when_a_cell_shrinks(change: Change) -> None:
    generator = np.random.default_rng(2)
    emptied = 0
    for box in map(change, BOXES):
        points = parameters(box, drives_inside(box, generator, 3000))
        points[:, 3] = np.abs(points[:, 3])
        root = root_cell(box)
        assert ((points >= root.low - 1e-9) & (points <= root.high + 1e-9)).all()
        for _ in range(20):
            ends = np.sort(generator.uniform(root.low, root.high, (2, 4)), axis=0)
            cell = Cell(ends[0], ends[1])
            inside = np.all((points >= cell.low) & (points <= cell.high), axis=1)
            left = shrunk(box, cell)
            if left is None:
                emptied += 1
                assert not inside.any()
                continue
            assert (left.low >= cell.low).all()
            assert (left.high <= cell.high).all()
            hair = 1e-12 * np.abs(root.high)  # rounding; the checker works in rationals
            still = np.all((points >= left.low - hair) & (points <= left.high + hair), axis=1)
            assert np.all(still | ~inside)
    assert emptied > 2


@pytest.mark.parametrize("dead_time", [(-0.3, 0.2), (0.1, 0.4)])
def test_a_confirmed_box_reaches_just_as_far_as_its_drives(
    dead_time: tuple[float, float],
) -> None:
    own = BOXES[0]
    box = replace(own, dead_time=(dead_time[0] * own.r_s[0], dead_time[1] * own.r_s[0]))
    pairs: list[Any] = [tuple(map(Fraction, getattr(box, name))) for name in confirmation._PAIRS]
    exact = confirmation._Box(Fraction(box.t_s), Fraction(box.omega_e), *pairs)
    low, high = (
        np.array(ends, dtype=np.float64)
        for ends in (confirmation._root(exact).low, confirmation._root(exact).high)
    )
    points = parameters(box, corner_drives(box, 2))
    np.testing.assert_allclose(points.min(axis=0), low, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), high, rtol=1e-12)


def test_a_drive_is_found_again_from_its_parameters() -> None:
    generator = np.random.default_rng(3)
    for box in (*BOXES, with_dead_time(BOXES[0])):
        for point in parameters(box, drives_inside(box, generator, 20)):
            drive = drive_at(box, point)
            assert drive is not None
            np.testing.assert_allclose(parameters_of(box, drive), point, rtol=1e-9, atol=1e-12)
            assert box.gain[0] <= drive.gain <= box.gain[1]
            assert box.l_d[0] <= drive.l_d <= box.l_d[1]
    root = root_cell(BOXES[0])
    corner = np.array([root.low[0], root.high[1], root.high[2], 0.0])
    assert drive_at(BOXES[0], corner) is None  # least gain for b_d, largest for b_q


@pytest.mark.parametrize("negative", [False, True])
def test_the_remainder_bounds_interpolation_and_is_nearly_reached(negative: bool) -> None:
    """300 random cells: nowhere more than the bounds, at one cell more than 0.9 of that of Phi."""
    generator = np.random.default_rng(4)
    largest = np.zeros(2)
    for _ in range(300):
        box = BOXES[int(generator.integers(len(BOXES)))]
        box = with_dead_time(box) if negative else box
        root = root_cell(box)
        # single parameters too: there the bound is nearly reached
        moved = generator.uniform(size=4) < 0.6
        width = np.where(moved, generator.uniform(0.0, 1.0, 4), 0.0) * root.width
        low = generator.uniform(root.low, root.high - width)
        cell = Cell(low, low + width)
        corners = corner_points(Cell(low, np.where(width > 0.0, cell.high, np.inf)))
        corners = np.where(np.isinf(corners), low, corners)
        share = generator.uniform(0.3, 0.7, (40, 4))
        points = low + share * width
        weights = np.ones((40, len(corners)))
        for axis in np.flatnonzero(width > 0.0):
            at_high = corners[:, axis] == cell.high[axis]
            weights *= np.where(at_high[None], share[:, [axis]], 1.0 - share[:, [axis]])
        blended = np.einsum("pv,vij->pij", weights, loop_matrices(box, corners))
        blended /= weights.sum(axis=1)[:, None, None]
        error = loop_matrices(box, points) - blended
        np.testing.assert_allclose(error[:, 2:], 0.0, atol=1e-13)
        (_, e_phi), (_, e_gam) = remainder(box, cell).groups
        for place, (columns, bound) in enumerate(((slice(0, 2), e_phi), (slice(2, 4), e_gam))):
            sizes = np.linalg.norm(error[:, :2, columns], 2, axis=(1, 2))
            assert (sizes <= bound + 1e-13).all()
            if bound > 1e-9:
                largest[place] = max(largest[place], sizes.max() / bound)
    assert largest[0] > 0.9
    assert largest[1] > 0.5


def exact(box: CurrentLoopBox) -> confirmation._Box:
    return confirmation._read(confirmation.plain_inputs(box))


def in_doubles(matrix: Any) -> FloatArray:
    return np.array([[float(entry.mid()) for entry in row] for row in matrix.tolist()])


@pytest.mark.parametrize("change", [lambda box: box, with_dead_time])
def test_the_checkers_loop_is_the_finders(change: Change) -> None:
    """Both are written apart; that of a disturbance adds the voltages, and what they become."""
    generator = np.random.default_rng(5)
    for box in map(change, BOXES):
        root = root_cell(box)
        point = generator.uniform(root.low, root.high)
        ball = confirmation._loop(exact(box), [Fraction(value) for value in point])
        loop = loop_matrices(box, point[None])
        np.testing.assert_allclose(in_doubles(ball), loop[0], rtol=1e-12, atol=1e-13)
        assert max(float(entry.rad()) for entry in ball.entries()) < 1e-12
        disturbed = in_doubles(confirmation._disturbed(ball))
        np.testing.assert_allclose(disturbed, extended(loop)[0], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("change", [lambda box: box, with_dead_time])
def test_the_checker_shrinks_cells_as_the_finder_does(change: Change) -> None:
    generator = np.random.default_rng(6)
    met = [0, 0]
    for box in map(change, BOXES):
        root = root_cell(box)
        for _ in range(8):
            middle = generator.uniform(root.low, root.high)
            half = 0.5 * generator.uniform(0.02, 0.5) * root.width
            cell = Cell(np.maximum(root.low, middle - half), np.minimum(root.high, middle + half))
            rational = confirmation._Cell(
                tuple(map(Fraction, cell.low)), tuple(map(Fraction, cell.high))
            )
            found, own = confirmation._shrunk(exact(box), rational), shrunk(box, cell)
            assert (found is None) == (own is None)
            met[found is None] += 1
            if found is not None and own is not None:
                for ends, others in ((found.low, own.low), (found.high, own.high)):
                    both = np.array(ends, dtype=np.float64), others
                    np.testing.assert_allclose(*both, rtol=1e-9, atol=1e-9 * root.width[2])
    assert min(met) > 3


@pytest.mark.parametrize("change", [lambda box: box, with_dead_time])
def test_what_is_still_open_holds_the_drives_of_its_cells_and_little_else(change: Change) -> None:
    """Drives by chance and at the ends whose parameters lie in one of two cells."""
    generator, tightest = np.random.default_rng(7), np.zeros(5)
    for box in map(change, BOXES[:4]):
        drives = drives_inside(box, generator, 40_000)
        drives[:, 4] = np.abs(drives[:, 4])
        root, g = root_cell(box), drives[:, 3]
        points = np.column_stack(
            [
                g * box.decoupling[0] / drives[:, 1],
                g * box.decoupling[1] / drives[:, 2],
                drives[:, 0] / g,
                drives[:, 4] * box.t_s,
            ]
        )
        low = root.low + np.array([[0.1, 0.2, 0.1, 0.3], [0.3, 0.3, 0.2, 0.1]]) * root.width
        cells = [Cell(one, one + 0.45 * root.width) for one in low]
        inside = [np.all((points >= c.low) & (points <= c.high), axis=1) for c in cells]
        there = drives[np.logical_or(*inside)]
        found = confirmation._ranges(box, cells)
        ends = np.array([found.r_s, found.l_d, found.l_q, found.gain, found.omega_e])
        assert np.all(there >= ends[:, 0] * (1.0 - 1e-12) - 1e-12)
        assert np.all(there <= ends[:, 1] * (1.0 + 1e-12) + 1e-12)
        tightest = np.maximum(tightest, np.ptp(there, axis=0) / np.ptp(ends, axis=1))
    assert np.min(tightest) > 0.9


def border(falls: Callable[[float], bool]) -> float:
    """The largest size with which it falls."""
    low, high = 1e-9, 10.0
    assert falls(low)
    assert not falls(high)
    while high > 1.000001 * low:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if falls(middle) else (low, middle)
    return low


@pytest.mark.parametrize(("phi", "gamma"), [(1.0, 0.0), (0.0, 1.0), (0.3, 1.0)])
def test_the_checker_bears_as_much_remainder_as_the_finder(phi: float, gamma: float) -> None:
    """Where a matrix no longer serves as what corners leave out grows: in balls and in doubles, of
    which these keep a reserve of 1e-5; blocks of Phi and of Gam alone, and both.
    """
    from flint import arb, arb_mat

    box = BOXES[0]
    closed = loop_matrices(box, root_cell(box).middle[None])
    frame = lyapunov_frame(closed[0])
    assert frame is not None
    matrix = rounded(frame.T @ frame)
    held, loop = arb_mat(matrix.tolist()), arb_mat(closed[0].tolist())

    def doubles(size: float) -> bool:
        groups = ((0, 1), size * phi), ((2, 3), size * gamma)
        return contracts(matrix, matrix, closed, Remainder((0, 1), groups)).whole

    def balls(size: float) -> bool:
        return confirmation._falls(held, held, loop, (arb(size * phi), arb(size * gamma)))

    assert border(doubles) == pytest.approx(border(balls), rel=3e-5)
