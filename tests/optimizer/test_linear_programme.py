"""The door to linear programmes: known optima of badly conditioned ones, and solvers that fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from scipy.sparse import csr_matrix

import dqforge
from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.linear_programme import least_cost


def levelling(degree: int, unit: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least largest |x^(n + 1) - polynomial| / unit on [0, 1], at points with Chebyshev's among
    them, in plain powers: cost, rows, limits.
    """
    x = 0.5 - 0.5 * np.cos(np.pi * np.arange(20 * (degree + 1) + 1) / (20 * (degree + 1)))
    columns = x[:, np.newaxis] ** np.arange(degree + 1)
    rows = np.block([[columns, -unit[:, np.newaxis]], [-columns, -unit[:, np.newaxis]]])
    target = x ** (degree + 1)
    return np.eye(degree + 2)[-1], rows, np.concatenate([target, -target])


@pytest.mark.parametrize("degree", range(1, 7))
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e5])
def test_powers_are_levelled_to_the_error_that_chebyshev_gives(degree: int, scale: float) -> None:
    known = 2.0 * 0.25 ** (degree + 1)
    unit = np.full(20 * (degree + 1) + 1, known * scale)
    cost, rows, most = levelling(degree, unit)
    x = least_cost(cost, rows / known, most / known, orthogonal=True)
    assert x is not None
    assert x[-1] == pytest.approx(1.0 / scale, rel=1e-5)


def known_programme(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Cost, rows, limits over 12 decades, and the only x that is the least by construction."""
    generator = np.random.default_rng(seed)
    x, rows = generator.normal(size=6), generator.normal(size=(40, 6))
    active = np.arange(40) < 6
    most = rows @ x + np.where(active, 0.0, generator.uniform(0.5, 2.0, 40))
    cost = -rows[active].T @ generator.uniform(0.5, 2.0, 6)
    units, sizes = 10.0 ** generator.uniform(-3.0, 3.0, 6), 10.0 ** generator.uniform(-3, 3, 40)
    return cost / units, rows * sizes[:, np.newaxis] / units, most * sizes, x * units


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("way", ["dense", "sparse", "orthogonal"])
def test_rows_and_columns_of_any_size_give_the_known_corner(seed: int, way: str) -> None:
    cost, rows, most, known = known_programme(seed)
    given = csr_matrix(rows) if way == "sparse" else rows
    x = least_cost(cost, given, most, orthogonal=way == "orthogonal")
    assert x is not None
    assert np.allclose(x, known, rtol=1e-4, atol=1e-5 * np.max(np.abs(known)))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("orthogonal", [False, True])
def test_the_solver_is_given_numbers_of_about_one(
    seed: int, orthogonal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}
    solver = scipy.optimize.linprog

    def seen(slope: FloatArray, **other: Any) -> Any:
        given.update(other, slope=slope)
        return solver(slope, **other)

    monkeypatch.setattr(scipy.optimize, "linprog", seen)
    cost, rows, most, _ = known_programme(seed)
    least_cost(cost, rows, most, orthogonal=orthogonal)
    for name in ("slope", "b_ub"):
        assert 0.7 <= np.max(np.abs(given[name])) <= 1.5
    if orthogonal:
        inner = given["A_ub"].T @ given["A_ub"]
        np.testing.assert_allclose(inner, rows.shape[0] * np.eye(6), atol=1e-9)
    else:
        assert np.min(np.max(np.abs(given["A_ub"]), axis=1)) > 0.7
        assert np.max(np.abs(given["A_ub"])) < 2.0


def test_a_row_of_rounded_zeros_limits_nothing() -> None:
    cost, rows, most, known = known_programme(3)
    noise = 1e-17 * np.max(np.abs(rows), axis=0)
    x = least_cost(cost, np.vstack([rows, noise]), np.append(most, 1e-3 * np.max(np.abs(most))))
    assert x is not None
    assert np.allclose(x, known, rtol=1e-4, atol=1e-5 * np.max(np.abs(known)))


def test_what_nothing_fulfils_and_what_has_no_least_cost_is_none() -> None:
    one = np.ones(1)
    assert least_cost(one, np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])) is None
    assert least_cost(one, np.array([[1.0]]), one) is None


@pytest.mark.parametrize("fault", ["error", "infeasible", "beyond", "above"])
@pytest.mark.parametrize("methods", [("highs-ds",), ("highs-ds", "highs-ipm")])
def test_a_method_that_fails_is_followed_by_another_or_named(
    fault: str, methods: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its status, by an answer that breaks a row, by one that is not the least."""
    cost, rows, most, known = known_programme(5)
    solver = scipy.optimize.linprog

    def faulty(slope: FloatArray, *, method: str, **given: Any) -> Any:
        found = solver(slope, method=method, **given)
        if method in methods:
            if fault in ("error", "infeasible"):
                found.status = 4 if fault == "error" else 2
            else:
                found.x = found.x + (-0.1 if fault == "beyond" else 0.1) * slope
        return found

    monkeypatch.setattr(scipy.optimize, "linprog", faulty)
    if len(methods) == 2:
        if fault == "infeasible":  # two methods say so
            assert least_cost(cost, rows, most) is None
        else:
            with pytest.raises(NoSolutionError, match="linear programme"):
                least_cost(cost, rows, most)
    else:
        x = least_cost(cost, rows, most)
        assert x is not None
        assert np.allclose(x, known, rtol=1e-4, atol=1e-5 * np.max(np.abs(known)))


@pytest.mark.parametrize("presolve", [True, False])
def test_the_last_attempt_has_the_other_choice_of_presolve(
    presolve: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    cost, rows, most, _ = known_programme(5)
    solver, asked = scipy.optimize.linprog, list[tuple[str, bool]]()

    def failing(slope: FloatArray, *, method: str, options: Any, **given: Any) -> Any:
        asked.append((method, options["presolve"]))
        found = solver(slope, method=method, options=options, **given)
        found.status = 4
        return found

    monkeypatch.setattr(scipy.optimize, "linprog", failing)
    with pytest.raises(NoSolutionError, match="could not be solved"):
        least_cost(cost, rows, most, presolve=presolve)
    first, second, last = (
        ("highs-ds", presolve),
        ("highs-ipm", presolve),
        ("highs-ds", not presolve),
    )
    assert asked == [first, second, last]


def test_every_linear_programme_goes_through_the_door() -> None:
    package = Path(dqforge.__file__).parent
    callers = [
        path.relative_to(package).as_posix()
        for room in ("machines", "optimizer", "reports")
        for path in (package / room).rglob("*.py")
        if "linprog" in path.read_text(encoding="utf-8")
    ]
    assert callers == ["optimizer/linear_programme.py"]
