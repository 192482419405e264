"""Small matrix inequalities against problems whose solution is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from dqforge.optimizer.certificates.cell_queue import (
    Remainder,
    common_lyapunov,
    contracts,
    lyapunov_frame,
)
from dqforge.optimizer.certificates.matrix_inequalities import (
    Blocks,
    Budget,
    Inequality,
    Term,
    _best_length,
    _block,
    _triangle,
    _vector,
    chained_matrices,
    climb,
    solve_inequalities,
)


def random_loop(rng: np.random.Generator, radius: float, size: int = 6) -> np.ndarray:
    loop = rng.normal(size=(size, size))
    return np.asarray(loop * radius / np.max(np.abs(np.linalg.eigvals(loop))))


@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_as_long_as_the_barrier_likes_best(seed: int) -> None:
    """The zero of its slope, by bisection; no farther than where a factor has lost 95 %."""
    rng = np.random.default_rng(seed)
    stretch = rng.uniform(-0.9, 1.0, 12) / (1.0 + seed)
    gain = max(-float(np.sum(stretch)), 0.0) + float(rng.uniform(0.1, 0.5))
    low, high = 0.0, 0.95 / max(-float(stretch.min()), 1e-12)
    for _ in range(60):
        middle = 0.5 * (low + high)
        falls = gain + np.sum(stretch / (1.0 + middle * stretch)) < 0.0
        low, high = (low, middle) if falls else (middle, high)
    assert _best_length(stretch, gain) == pytest.approx(high, rel=1e-3)


def test_the_largest_gain_of_a_first_order_lag_is_found() -> None:
    """y = x, x+ = a x + w has the largest gain 1/(1 - a), at rest."""
    a = 0.8
    held = np.array([[1.0, 0.0]])
    step, output = np.array([[a, 1.0]]), np.array([[1.0, 0.0]])
    bound = Inequality(
        (Term(0, held), Term(0, step, -1.0)),
        slope=np.diag([0.0, 1.0]),
        constant=-output.T @ output,
    )
    found = solve_inequalities([bound], [1], least=True)
    assert found is not None
    assert np.isclose(np.sqrt(found.scalar), 1.0 / (1.0 - a), rtol=1e-4)


def test_one_matrix_serves_corners_and_everything_between() -> None:
    rng = np.random.default_rng(5)
    middle = random_loop(rng, 0.9)
    corners = middle + 0.01 * rng.normal(size=(16, 6, 6))
    frame = lyapunov_frame(middle)
    assert frame is not None
    matrix = common_lyapunov(corners, frame)
    assert matrix is not None
    assert contracts(matrix, matrix, corners).whole
    shares = rng.dirichlet(np.ones(16), 500)
    between = np.einsum("sv,vij->sij", shares, corners)
    fall = matrix - np.swapaxes(between, 1, 2) @ matrix @ between
    assert np.linalg.eigvalsh(fall).min() > 0.0


def test_a_remainder_is_counted_as_it_acts() -> None:
    """Just below the largest remainder every disturbance of that size contracts; far beyond none
    is promised.
    """
    rng = np.random.default_rng(6)
    loop = random_loop(rng, 0.8)[None]
    frame = lyapunov_frame(loop[0])
    assert frame is not None
    matrix = frame.T @ frame
    sizes = np.geomspace(1e-4, 1.0, 60)
    held = [
        contracts(matrix, matrix, loop, Remainder((0, 1), (((0, 1), e), ((2, 3), e)))).whole
        for e in sizes
    ]
    assert held[0]
    assert not held[-1]
    largest = sizes[np.flatnonzero(held)[-1]]
    for _ in range(200):
        disturbed = loop[0].copy()
        for columns in ((0, 1), (2, 3)):
            block = rng.normal(size=(2, 2))
            disturbed[np.ix_((0, 1), columns)] += largest * block / np.linalg.norm(block, 2)
        assert np.linalg.eigvalsh(matrix - disturbed.T @ matrix @ disturbed).min() > 0.0


def test_an_unstable_corner_has_no_matrix() -> None:
    rng = np.random.default_rng(7)
    stable, unstable = random_loop(rng, 0.9), random_loop(rng, 1.01)
    frame = lyapunov_frame(stable)
    assert frame is not None
    assert common_lyapunov(np.stack([stable, unstable]), frame) is None
    assert lyapunov_frame(unstable) is None


def test_a_cycle_closes_though_a_step_grows() -> None:
    """The second step alone is unstable, both in turn are not: a chain of two matrices, no common
    one.
    """
    steps = [np.array([[0.0, 2.0], [0.2, 0.0]])[None], np.diag([0.3, 2.0])[None]]
    links = [(0, 1, steps[0]), (1, 0, steps[1])]
    found = chained_matrices(links, [np.eye(2)] * 2, count=2)
    assert found is not None
    for a, b, step in links:
        assert contracts(found.matrices[a], found.matrices[b], step).whole
        assert not contracts(found.matrices[a], found.matrices[a], steps[1]).corners


def test_no_cycle_is_found_where_the_loop_grows() -> None:
    steps = [np.array([[0.0, 2.0], [0.2, 0.0]])[None], np.array([[[0.0, 0.3], [2.0, 0.0]]])]
    links = [(0, 1, steps[0]), (1, 0, steps[1])]
    found = chained_matrices(links, [np.eye(2)] * 2, count=2)
    held = [] if found is None else found.matrices
    assert not all(contracts(held[a], held[b], step).whole for a, b, step in links if held)


def test_vectors_keep_the_inner_product_and_the_map_is_that_of_the_product() -> None:
    generator = np.random.default_rng(2)
    a, b, p = (part + part.T for part in generator.standard_normal((3, 4, 4)))
    left = generator.standard_normal((4, 3))
    assert _vector(a) @ _vector(b) == pytest.approx(np.trace(a @ b))
    rows, columns = _triangle(4)
    np.testing.assert_allclose(_block(left) @ p[rows, columns], _vector(left.T @ p @ left))


def test_a_scalar_beside_the_matrices_is_the_largest_or_the_least() -> None:
    """t I <= A and A <= t I: the ends of the spectrum, without and with a slope of another size."""
    a = np.array([[2.0, 0.7, -0.3], [0.7, 1.0, 0.4], [-0.3, 0.4, 3.0]])
    low, *_, high = np.linalg.eigvalsh(a)
    # An unknown of its own that must not be negative changes nothing.
    term = Term(0, np.zeros((1, 3)))
    own = Inequality((Term(0, np.eye(1)),))
    for slope in (1.0, 4.0):
        below = Inequality((term,), slope=-slope * np.eye(3), constant=a)
        above = Inequality((term,), slope=slope * np.eye(3), constant=-a)
        bounded = Inequality((Term(0, np.eye(1)),), constant=np.eye(1))
        most = solve_inequalities((below, own, bounded), (1,))
        least = solve_inequalities((above, own, bounded), (1,), least=True)
        assert most is not None
        assert least is not None
        assert most.scalar == pytest.approx(low / slope, rel=1e-5)
        assert least.scalar == pytest.approx(high / slope, rel=1e-5)


def spectral_blocks(seed: int) -> tuple[Blocks, float]:
    """A - y B - t 1 >= 0 with B of trace zero, and the largest t, by a search over y; beside it an
    unknown of its own between -1 and 1.
    """
    rng = np.random.default_rng(seed)
    a, b = (part + part.T for part in rng.standard_normal((2, 4, 4)))
    b -= np.trace(b) / 4.0 * np.eye(4)
    slopes = np.zeros((2, 3, 4, 4))
    slopes[0, 0], slopes[0, 2], slopes[1, 1] = -b, -np.eye(4), np.diag([1.0, -1.0, 0.0, 0.0])

    def least(y: float) -> float:
        return float(np.linalg.eigvalsh(a - y * b)[0])

    best = minimize_scalar(lambda y: -least(y), bracket=(-1.0, 1.0), options={"xtol": 1e-13})
    return Blocks(np.stack([a, np.eye(4)]), slopes), least(float(best.x))


@pytest.mark.parametrize("seed", range(4))
def test_a_climb_ends_within_a_hundred_thousandth_of_the_largest_scalar(seed: int) -> None:
    """Not nearer than its growth of the weight makes it: order over weight is what is left."""
    blocks, most = spectral_blocks(seed)
    start = np.array([0.0, 0.0, float(np.linalg.eigvalsh(blocks.constant[0])[0]) - 1.0])
    asked: list[float] = []

    def never(unknowns: np.ndarray) -> bool:
        asked.append(float(unknowns[-1]))
        return False

    found = climb(blocks, start, never)
    assert found is not None
    assert 1e-7 < (most - found[-1]) / abs(most) < 0.6e-5
    assert len(asked) < 40
    assert climb(blocks, start, never, hopeless=most + 1e-3 * abs(most)) is None
    assert climb(blocks, start, never, hopeless=most - 1e-3 * abs(most)) is not None
    budget = Budget(5)
    assert climb(blocks, start, never, budget=budget) is None
    assert budget.left == 0
    middle = 0.5 * (start[-1] + most)
    taken = climb(blocks, start, lambda unknowns: bool(unknowns[-1] > middle))
    assert taken is not None
    assert taken[-1] == next(value for value in asked if value > middle)


def test_a_climb_to_zero_ends_by_its_weight() -> None:
    """A share of nothing is never reached: order over the heaviest weight is what is left."""
    blocks = Blocks(np.diag([0.0, 1.0])[None], -np.eye(2)[None, None])
    found = climb(blocks, np.array([-1.0]), lambda _: False)
    assert found is not None
    assert 1e-12 < -found[-1] < 2e-11


def test_a_direction_that_changes_nothing_is_followed_as_far_as_its_gain_says() -> None:
    assert _best_length(np.zeros(3), 1.0) == pytest.approx(0.95e12)
    assert 0.0 < _best_length(np.zeros(3), -1.0) < 1e-5
