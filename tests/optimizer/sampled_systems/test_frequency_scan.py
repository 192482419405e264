"""Scans of loops against solutions one by one, and roots in brackets."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.optimizer import sampled_systems
from dqforge.optimizer.sampled_systems import (
    FloatArray,
    SampledSystem,
    bracketed_roots,
    loop_margins,
    scanned_response,
)


def _system(order: int, seed: int) -> SampledSystem:
    """A stable system whose states are of very different sizes."""
    draw = np.random.Generator(np.random.Philox(seed))
    a = draw.normal(size=(order, order))
    a *= 0.95 / np.max(np.abs(np.linalg.eigvals(a)))
    sizes = 10.0 ** draw.uniform(-4.0, 4.0, order)
    b, c = draw.normal(size=(order, 1)), draw.normal(size=(1, order))
    return SampledSystem(
        sizes[:, None] * a / sizes, 0.1 * sizes[:, None] * b, 0.1 * c / sizes, np.zeros((1, 1)), 1.0
    )


@pytest.mark.parametrize("order", [1, 2, 7, 16])
def test_a_scan_is_the_response_one_by_one(order: int) -> None:
    system = _system(order, order)
    omega = np.geomspace(1e-6, np.pi, 300)
    found = scanned_response(
        system.a, system.b[:, 0], system.c[0], 0.25, np.exp(1j * omega * system.t_s)
    )
    wanted = system.response(omega) + 0.25
    assert np.max(np.abs(found - wanted)) < 1e-12 * np.max(np.abs(wanted))


def test_a_scan_keeps_double_poles() -> None:
    a, b = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([0.0, 1.0])
    omega = np.array([1e-6, 1e-3])
    z = np.exp(1j * omega)
    found = scanned_response(a, b, np.array([1.0, 0.0]), 0.0, z)
    np.testing.assert_allclose(found * (z - 1.0) ** 2, 1.0, rtol=1e-9)


def test_roots_take_few_evaluations() -> None:
    calls: list[FloatArray] = []

    def function(x: FloatArray) -> FloatArray:
        calls.append(x)
        return np.asarray(np.array([1.0, -1.0, 1.0]) * (x**3 - np.array([2.0, 5.0, 1e-30])))

    found = bracketed_roots(function, np.array([1.0, 0.0, -1.0]), np.array([2.0, 9.0, 2.0]))
    np.testing.assert_allclose(found[:2], [2.0 ** (1 / 3), 5.0 ** (1 / 3)], rtol=4e-16)
    assert abs(found[2] - 1e-10) < 1e-14
    assert len(calls) < 75
    assert bracketed_roots(function, np.empty(0), np.empty(0)).size == 0


@pytest.mark.parametrize(("ends", "root"), [((0.0, 1.0), 0.0), ((-1.0, 1.0), 0.3)])
def test_roots_at_the_ends_and_of_steps(ends: tuple[float, float], root: float) -> None:
    low, high = np.array([ends[0]]), np.array([ends[1]])
    step = bracketed_roots(lambda x: np.where(x > root, 1.0, -1.0), low, high)
    assert abs(step[0] - root) < 1e-15


@pytest.mark.parametrize("seed", range(6))
def test_margins_need_few_solutions(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Crossings and the peak are those of a dense scan; no golden section is left to be done."""

    def never(*_: object) -> FloatArray:
        raise AssertionError("golden section")

    loop = _system(6, 100 + seed)
    real = sampled_systems._maxima
    monkeypatch.setattr(
        sampled_systems, "_maxima", lambda f, low, high: never() if len(low) else real(f, low, high)
    )
    found = loop_margins(loop)
    dense = loop.response(np.linspace(1e-6, np.pi, 200_001))
    crossed = np.count_nonzero(np.diff(np.sign(np.abs(dense) - 1.0)))
    assert len(found.crossovers) == crossed
    if crossed:
        np.testing.assert_allclose(np.abs(loop.response(found.crossovers)), 1.0, rtol=1e-10)
    peak = np.max(1.0 / np.abs(1.0 + dense))
    assert peak * (1.0 - 1e-12) <= found.max_sensitivity <= peak * (1.0 + 1e-5)
