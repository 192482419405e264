"""The order of the cells, and the tree of their cuts."""

from __future__ import annotations

import numpy as np
import pytest
from random_current_loops import (
    corner_drives,
    drives_inside,
    limit,
    radii,
    radius_of,
    random_boxes,
    times,
)
from scipy.linalg import expm

from dqforge.optimizer.certificates import cell_queue
from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    Cell,
    CurrentLoopBox,
    Cut,
    Empty,
    Open,
    Proven,
    Refuted,
    Remainder,
    Tree,
    Verdict,
    _exponential,
    _refuted,
    _rest_falls,
    _verdict,
    common_lyapunov,
    find_certificate,
    largest_moduli,
    loop_matrices,
    lyapunov_frame,
    parameters_of,
    reach_of,
    root_cell,
    rounded,
    search,
    shrunk,
    slopes,
    unstable_corner,
)
from dqforge.optimizer.certificates.matrix_inequalities import (
    Budget,
    Inequality,
    Term,
    solve_inequalities,
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


def test_the_most_unstable_corner_is_named_from_the_border_on() -> None:
    """Gains raised step by step: of the corners at five speeds by the model in physical units."""
    box, met = random_boxes(1, 3, fast=True)[0], []
    for factor in np.geomspace(1.0, 12.0, 25):
        faster = times(box, float(factor))
        drives = corner_drives(faster, 5)
        moduli = radii(faster, drives)
        found = unstable_corner(faster)
        assert (found is None) == (moduli.max() < 1.0)
        if found is not None:
            worst = drives[np.argmax(moduli)]
            own = [found.r_s, found.l_d, found.l_q, found.gain, found.omega_e]
            assert own == pytest.approx(worst)
            met.append(float(moduli.max()))
    assert 1.0 < met[0] < 1.2


def test_a_drive_that_the_search_alone_meets_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains beyond the limit of the corners, of which none is looked at first."""
    box = times(random_boxes(1, 3, fast=True)[0], 12.0)
    assert unstable_corner(box) is not None
    monkeypatch.setattr(cell_queue, "unstable_corner", lambda _: None)
    found = find_certificate(box)
    assert found.counterexample is not None
    assert radius_of(box, found.counterexample) >= 1.0
    assert found.tree.counterexample == pytest.approx(parameters_of(box, found.counterexample))


def unproven() -> tuple[CurrentLoopBox, Cell]:
    """A box that no single matrix proves, of which no drive is unstable."""
    for box in random_boxes(30, 5, fast=True):
        most = limit(box)
        if most is not None:
            near = times(box, 0.99 * most)
            inside = shrunk(near, root_cell(near))
            assert inside is not None
            if isinstance(_verdict(near, inside, inside.width, Budget(200)), Cut):
                return near, inside
    raise AssertionError


def test_a_cell_is_cut_across_what_moves_its_loops_most_until_it_is_narrow() -> None:
    """Not across a parameter that is narrow already; changes are sizes in the loop's own frame."""
    box, cell = unproven()
    frame = lyapunov_frame(loop_matrices(box, cell.middle[None])[0])
    assert frame is not None
    changes = []
    for axis in range(4):
        ends = np.array([cell.middle, cell.middle])
        ends[:, axis] = cell.low[axis], cell.high[axis]
        low, high = frame @ loop_matrices(box, ends) @ np.linalg.inv(frame)
        changes.append(float(np.linalg.svd(high - low, compute_uv=False)[0]))
    np.testing.assert_allclose(reach_of(box, cell, frame) * cell.width, changes, rtol=1e-9)
    first, second = np.argsort(changes)[::-1][:2]
    budget = Budget(10**6)
    for share, kind in ((0.9e-6, Open), (1.1e-6, Cut)):
        assert isinstance(_verdict(box, cell, cell.width / share, budget), kind)
    found = _verdict(box, cell, cell.width, budget)
    assert isinstance(found, Cut)
    axes = [
        int(np.argmax(by * cell.width))
        for by in (slopes(box, cell), np.array(changes) / cell.width)
    ]
    assert found.axis in axes
    assert found.value == cell.middle[found.axis]
    full = cell.width / 1.1e-6
    full[found.axis] = cell.width[found.axis] / 0.45e-6
    other = _verdict(box, cell, full, budget)
    assert isinstance(other, Cut)
    assert other.axis != found.axis
    assert {first, second} & {found.axis, other.axis}


def test_exponentials_are_those_of_scipy_for_small_and_large_matrices() -> None:
    rng = np.random.default_rng(3)
    for size in (0.05, 0.9, 1.1, 9.0):
        flow = rng.standard_normal((5, 4, 4)) * np.array([1.0, 0.5, 0.1, 0.7, 0.2])[:, None, None]
        flow *= size / np.abs(flow).sum(axis=2).max()
        np.testing.assert_allclose(_exponential(flow), expm(flow), rtol=1e-13, atol=1e-14 * size)


def test_matrices_that_are_kept_have_twelve_digits_and_are_symmetric() -> None:
    rng = np.random.default_rng(4)
    root = rng.standard_normal((6, 6))
    for size in (1e-7, 0.3, 5e8):
        matrix = size * root @ root.T
        plain, unit = rounded(matrix, scaled=False), rounded(matrix)
        np.testing.assert_array_equal(plain, plain.T)
        apart = np.abs(plain / matrix - 1.0)
        assert 1e-13 < apart.max() < 5.1e-12
        assert 1.0 <= np.abs(unit).max() < 2.0
        ratio = unit / matrix
        np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-11)


def test_a_common_matrix_falls_most_of_all_with_its_trace() -> None:
    """Against a conic solver: the largest t with P - A^T P A >= t T^-T T^-1, tr P = n, in the frame
    of the middle.
    """
    rng = np.random.default_rng(5)
    middle = rng.standard_normal((3, 3))
    middle *= 0.8 / np.abs(np.linalg.eigvals(middle)).max()
    corners = middle + 0.03 * rng.standard_normal((4, 3, 3))
    frame = lyapunov_frame(middle)
    assert frame is not None
    np.testing.assert_allclose(
        frame.T @ frame - middle.T @ frame.T @ frame @ middle, np.eye(3), atol=1e-10
    )
    back = np.linalg.inv(frame)
    seen, weight, unit = frame @ corners @ back, back.T @ back, np.eye(3)
    falls = [Inequality((Term(0, unit), Term(0, loop, -1.0)), slope=-weight) for loop in seen]
    columns = [unit[:, [k]] for k in range(3)]
    traces = [
        Inequality(
            tuple(Term(0, column, sign) for column in columns), constant=np.array([[-3.0 * sign]])
        )
        for sign in (1.0, -1.0)
    ]
    best = solve_inequalities([*falls, *traces], [3])
    assert best is not None
    found = common_lyapunov(corners, frame)
    assert found is not None
    assert np.trace(back.T @ found @ back) == pytest.approx(3.0)
    least = min(float(np.linalg.eigvalsh(found - loop.T @ found @ loop)[0]) for loop in corners)
    assert least == pytest.approx(best.scalar, rel=1e-4)
    asked: list[np.ndarray] = []

    def never(matrix: np.ndarray) -> bool:
        asked.append(matrix)
        return False

    common_lyapunov(corners, frame, never)
    assert len(asked) > 3
