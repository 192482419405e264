"""Fits against an independent Remez, a conic solver, printed figures and first principles."""

from __future__ import annotations

import importlib.util
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import chebyshev

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import FitMethod
from dqforge.optimizer.curves.breakpoints import edges_from_cube, round_significant, search
from dqforge.optimizer.curves.fitting import (
    SideConditions,
    chebyshev_nodes,
    fit_curve,
    largest_error,
    squared_error_integral,
)
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_per_unit

FREE = SideConditions(exact_at_zero=False, continuous=False)
TIED = SideConditions(exact_at_zero=True, continuous=True)


def curve_d(torque: FloatArray) -> FloatArray:
    return mtpa_per_unit(torque)[0]


def curve_q(torque: FloatArray) -> FloatArray:
    return mtpa_per_unit(torque)[1]


CURVES = {"d": curve_d, "q": curve_q}


@pytest.fixture(scope="module")
def independent() -> ModuleType:
    spec = importlib.util.spec_from_file_location("remez", Path(__file__).with_name("remez.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def dense_error(axis: str, fit: PiecewisePolynomial) -> float:
    """Largest error on 40,001 even points, each evaluated in its own segment."""
    torque = np.linspace(fit.edges[0], fit.edges[-1], 40_001)
    return float(np.max(np.abs(fit(torque) - CURVES[axis](torque))))


@pytest.mark.thinned
@pytest.mark.parametrize("axis", ["d", "q"])
@pytest.mark.parametrize(
    ("degree", "edges"),
    [
        (1, (0, 5)),
        (2, (0, 1.5, 5)),
        (3, (0, 1.8, 5)),
        (4, (0, 1.7, 5)),
        (5, (0, 5)),
        (6, (0, 1, 2.4, 5)),
    ],
)
def test_minimax_is_within_a_thousandth_of_an_independent_remez(
    axis: str, degree: int, edges: tuple[float, ...], independent: ModuleType
) -> None:
    """Each segment is held against the optimum of mpmath's Remez: not below it (that
    would be a fault) and near it.
    """
    limits = np.array(edges, dtype=float)
    fit = fit_curve(CURVES[axis], limits, degree, "minimax", FREE)
    optima = []
    for index, (start, end) in enumerate(pairwise(limits)):
        optimum = independent.remez("dq".index(axis), degree, float(start), float(end))
        local = np.linspace(start, end, 20_001)
        value = np.polynomial.polynomial.polyval(local - start, fit.coefficients[index])
        attained = np.max(np.abs(value - CURVES[axis](local)))
        assert attained >= optimum * 0.999
        optima.append(optimum)
    assert dense_error(axis, fit) <= 1.001 * max(optima)


# Two segments, largest error in p.u. at the given breakpoint: computed with
# another Remez and with Sollya.
KNOWN_OPTIMA = [
    ("d", 2, 1.363, 2.378e-3),
    ("q", 2, 2.470, 1.081e-3),
    ("d", 3, 1.811, 3.328e-4),
    ("q", 3, 1.612, 3.965e-4),
    ("d", 4, 1.701, 1.036e-4),
    ("q", 4, 1.574, 3.869e-5),
]


@pytest.mark.parametrize(("axis", "degree", "seam", "optimum"), KNOWN_OPTIMA)
def test_minimax_meets_figures_from_other_tools(
    axis: str, degree: int, seam: float, optimum: float
) -> None:
    fit = fit_curve(CURVES[axis], np.array([0.0, seam, 5.0]), degree, "minimax", FREE)
    assert dense_error(axis, fit) == pytest.approx(optimum, rel=2e-3)


@pytest.mark.parametrize(
    "side",
    [
        TIED,
        SideConditions(exact_at_zero=True, continuous=False),
        SideConditions(exact_at_zero=False, continuous=True),
    ],
    ids=["both", "zero", "continuous"],
)
@pytest.mark.parametrize("degree", [2, 4])
def test_minimax_with_side_conditions_equals_a_conic_solution(
    side: SideConditions, degree: int, independent: ModuleType
) -> None:
    edges = np.array([0.0, 1.6, 5.0])
    fit = fit_curve(curve_d, edges, degree, "minimax", side)
    reference = -np.cos(np.linspace(0.0, np.pi, 400))
    blocks, rows = [], []
    for start, end in pairwise(edges):
        rows.append(start + 0.5 * (end - start) * (reference + 1.0))
        blocks.append(chebyshev.chebvander(reference, degree))
    basis = np.block([[blocks[0], np.zeros_like(blocks[1])], [np.zeros_like(blocks[0]), blocks[1]]])
    left, right = chebyshev.chebvander(np.array([-1.0, 1.0]), degree)
    equalities = []
    if side.exact_at_zero:
        equalities.append(np.concatenate([left, 0.0 * left]))
    if side.continuous:
        equalities.append(np.concatenate([right, -left]))
    bound = independent.dense_lower_bound(
        curve_d(np.concatenate(rows)), basis, np.array(equalities)
    )
    assert bound * 0.999 <= dense_error("d", fit) <= 1.001 * bound


@pytest.mark.parametrize("method", ["lagrange", "least-squares", "minimax"])
@pytest.mark.parametrize("axis", ["d", "q"])
def test_side_conditions_hold(axis: str, method: FitMethod) -> None:
    fit = fit_curve(CURVES[axis], np.array([0.0, 0.9, 2.0, 5.0]), 3, method, TIED)
    assert fit(np.zeros(1))[0] == 0.0
    np.testing.assert_allclose(fit.jumps(), 0.0, atol=1e-12)
    free = fit_curve(CURVES[axis], np.array([0.0, 0.9, 2.0, 5.0]), 3, method, FREE)
    assert np.max(np.abs(free.jumps())) > 1e-6
    assert abs(free(np.zeros(1))[0]) > 1e-7


def test_lagrange_passes_through_the_chebyshev_nodes_of_the_paper() -> None:
    fit = fit_curve(curve_q, np.array([0.0, 1.6, 5.0]), 3, "lagrange", FREE)
    # Paper 000 (25) for sigma = 3 on [1.6, 5].
    index = np.arange(1, 5)
    nodes = 0.5 * ((5.0 + 1.6) + (5.0 - 1.6) * np.cos((2 * index - 1) / 8.0 * np.pi))
    np.testing.assert_allclose(fit(nodes), curve_q(nodes), rtol=1e-13)
    np.testing.assert_allclose(np.sort(nodes), 1.6 + 1.7 * (chebyshev_nodes(4) + 1.0))


def test_least_squares_residual_is_orthogonal_to_every_polynomial() -> None:
    edges = np.array([0.0, 1.6, 5.0])
    fit = fit_curve(curve_d, edges, 3, "least-squares", FREE)
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for start, end in pairwise(edges):
        torque = start + 0.5 * (end - start) * (nodes + 1.0)
        residual = fit(torque) - curve_d(torque)
        for power in range(4):
            assert abs(np.sum(weights * residual * nodes**power)) < 1e-12


@settings(max_examples=60, deadline=None)
@given(
    degree=st.integers(1, 6),
    seam=st.floats(0.2, 4.8),
    method=st.sampled_from(["lagrange", "least-squares", "minimax"]),
    zero=st.booleans(),
    continuous=st.booleans(),
)
def test_a_polynomial_curve_is_reproduced(
    degree: int, seam: float, method: FitMethod, zero: bool, continuous: bool
) -> None:
    """A polynomial of the same degree that vanishes at zero satisfies every condition,
    so its fit is itself.
    """
    coefficients = np.concatenate([[0.0], np.linspace(1.0, -0.5, degree)])

    def curve(torque: FloatArray) -> FloatArray:
        return np.asarray(np.polynomial.polynomial.polyval(torque, coefficients))

    fit = fit_curve(
        curve, np.array([0.0, seam, 5.0]), degree, method, SideConditions(zero, continuous)
    )
    torque = np.linspace(0.0, 5.0, 101)
    scale = np.max(np.abs(curve(torque)))
    np.testing.assert_allclose(fit(torque), curve(torque), atol=1e-9 * scale)
    last = torque[torque >= seam]
    # In powers of the torque itself, the form that paper 000 prints in its Table 2.
    powers = np.polynomial.Polynomial(fit.coefficients[1])(
        np.polynomial.Polynomial([-seam, 1.0])
    ).coef
    np.testing.assert_allclose(
        np.polynomial.polynomial.polyval(last, powers), curve(last), atol=1e-8 * scale
    )


def test_squared_error_integral_equals_quadrature() -> None:
    from scipy.integrate import quad

    fit = fit_curve(curve_d, np.array([0.0, 1.55, 5.0]), 2, "lagrange", FREE)
    pieces = [
        quad(
            lambda t: float((fit(np.array([t])) - curve_d(np.array([t])))[0] ** 2),
            a,
            b,
            epsabs=1e-13,
        )[0]
        for a, b in ((0.0, 1.55), (1.55, 5.0))
    ]
    assert squared_error_integral(curve_d, fit) == pytest.approx(sum(pieces), rel=1e-7)


# Paper 000, Table 1 as recomputed independently: at the paper's breakpoints, and at the best ones.
TABLE_1 = [
    (2, 1.5545, 2.7667, 99.07, 99.26),
    (3, 1.8455, 1.5545, 99.72, 99.73),
    (4, 1.9424, 1.4576, 99.89, 99.89),
]


@pytest.mark.parametrize(("degree", "phi_d", "phi_q", "there", "best"), TABLE_1)
def test_breakpoints_of_table_1(
    degree: int, phi_d: float, phi_q: float, there: float, best: float
) -> None:
    def epsilon(axis: str, edges: FloatArray) -> float:
        return squared_error_integral(
            CURVES[axis], fit_curve(CURVES[axis], edges, degree, "lagrange", FREE)
        )

    undivided = sum(epsilon(axis, np.array([0.0, 5.0])) for axis in CURVES)
    printed = sum(
        epsilon(axis, np.array([0.0, phi, 5.0])) for axis, phi in (("d", phi_d), ("q", phi_q))
    )
    assert 100.0 * (1.0 - printed / undivided) == pytest.approx(there, abs=0.02)
    found = 0.0
    for axis in CURVES:
        objective = partial(epsilon, axis)
        edges = search(objective, objective, 2, 5.0)
        swept = min(epsilon(axis, np.array([0.0, phi, 5.0])) for phi in np.linspace(0.1, 4.9, 481))
        assert epsilon(axis, edges) <= swept * 1.001
        found += epsilon(axis, edges)
    assert 100.0 * (1.0 - found / undivided) >= best - 0.005


@pytest.mark.slow
@pytest.mark.parametrize("segments", [3, 4])
@pytest.mark.parametrize("degree", [2, 4])
def test_minimax_breakpoints_are_near_the_best_of_many_local_searches(
    segments: int, degree: int
) -> None:
    from scipy.optimize import minimize

    def fine(edges: FloatArray) -> float:
        return max(
            largest_error(curve, fit_curve(curve, edges, degree, "minimax", TIED, exchange=False))
            for curve in CURVES.values()
        )

    def coarse(edges: FloatArray) -> float:
        return max(
            largest_error(curve, fit_curve(curve, edges, degree, "lagrange", TIED))
            for curve in CURVES.values()
        )

    found = fine(search(coarse, fine, segments, 5.0))
    generator = np.random.default_rng(1)
    rival = np.inf
    for _ in range(4):
        start = generator.uniform(0.0, 1.0, segments - 1)
        outcome = minimize(
            lambda x: fine(edges_from_cube(np.clip(x, 0.0, 1.0), 5.0)),
            start,
            method="Nelder-Mead",
            options={"maxfev": 120},
        )
        rival = min(rival, float(outcome.fun))
    assert found <= 1.01 * rival


def test_search_is_repeatable_and_rounds() -> None:
    def cost(edges: FloatArray) -> float:
        return float((edges[1] - 1.23456789) ** 2)

    first, second = (search(cost, cost, 2, 5.0) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert first[1] == round_significant(first[1]) == pytest.approx(1.2346, abs=1e-3)
    np.testing.assert_array_equal(search(cost, cost, 1, 5.0), [0.0, 5.0])


@pytest.mark.parametrize(("exact_at_zero", "continuous"), [(True, False), (False, True)])
def test_lagrange_ties_only_the_segments_that_a_condition_concerns(
    *, exact_at_zero: bool, continuous: bool
) -> None:
    """A tied segment has its left end and n Chebyshev nodes, a free one n + 1 of them (paper 000,
    (25)).
    """
    edges, degree = np.array([0.0, 2.0, 5.0]), 3
    side = SideConditions(exact_at_zero, continuous)
    fit = fit_curve(curve_q, edges, degree, "lagrange", side)
    for segment, tied in enumerate((exact_at_zero, continuous)):
        start, end = edges[segment], edges[segment + 1]
        count = degree if tied else degree + 1
        angles = (2.0 * np.arange(1, count + 1) - 1.0) / (2.0 * count) * np.pi
        nodes = 0.5 * ((end + start) + (end - start) * np.cos(angles))
        np.testing.assert_allclose(fit(nodes), curve_q(nodes), rtol=1e-12)
    assert (abs(fit.coefficients[0, 0]) < 1e-12) == exact_at_zero
    assert (abs(fit.jumps()[0]) < 1e-12) == continuous


def test_jump_is_the_right_limit_minus_the_left() -> None:
    fit = PiecewisePolynomial(np.array([0.0, 2.0, 3.0]), np.array([[1.0, 1.0], [5.0, 0.0]]))
    assert fit.jumps() == pytest.approx([2.0])  # 5 against 1 + 2


def test_cube_becomes_ascending_edges_with_the_least_width() -> None:
    np.testing.assert_allclose(edges_from_cube(np.array([0.9, 0.1]), 1.0), [0.0, 0.107, 0.893, 1.0])
    np.testing.assert_allclose(edges_from_cube(np.zeros(3), 10.0), [0.0, 0.1, 0.2, 0.3, 10.0])
    np.testing.assert_allclose(edges_from_cube(np.ones(3), 10.0), [0.0, 9.7, 9.8, 9.9, 10.0])
