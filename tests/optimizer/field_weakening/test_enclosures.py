"""Functions on boxes against symbolic derivatives, and formulas of a flux map against the map."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from one_sided import one_sided

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates.ball import Balls, Jet
from dqforge.optimizer.field_weakening.enclosures import (
    MOST_CELLS,
    Bend,
    composed,
    formulas,
    inverse_square,
    machine_parts,
    resolved,
    taylor,
)

T, X = ca.SX.sym("t"), ca.SX.sym("x")
PLACES = np.random.default_rng(1).uniform(0.2, 1.7, (2, 15))
Symbolic = Callable[[Any, Any], Any]


def derivatives(of: Any, by: tuple[Any, Any] = (T, X)) -> list[FloatArray]:
    """Value, gradient and second derivatives at the places, shape (N,) each."""
    a, b = by
    slopes = ca.gradient(of, a), ca.gradient(of, b)
    bends = ca.gradient(slopes[0], a), ca.gradient(slopes[0], b), ca.gradient(slopes[1], b)
    found = ca.Function("f", [a, b], [of, *slopes, *bends])
    rows = [[float(part) for part in found(*place)] for place in PLACES.T]
    return list(np.array(rows).T)


def bend_of(of: Any) -> Bend:
    return Bend(*(Balls.exact(part) for part in derivatives(of)))


def same(found: Bend, of: Any, within: float = 1e-11) -> None:
    for name, exact in zip(Bend.__dataclass_fields__, derivatives(of), strict=True):
        part = getattr(found, name)
        middle = part.mid if isinstance(part, Balls) else part
        np.testing.assert_allclose(np.broadcast_to(middle, exact.shape), exact, atol=within)


F = 0.7 + 1.1 * T - 0.4 * X + 0.9 * T * T * X - 0.3 * X**3 + 0.2 * T**3
G = -0.2 + 0.6 * T + 1.3 * X - 0.5 * T * X * X + 0.8 * T**2


def test_products_and_inverse_squares_have_their_derivatives() -> None:
    same(bend_of(F).times(bend_of(G)), F * G)
    available = 5.0 + 0.4 * T**3 - 0.9 * T - X
    same(inverse_square(bend_of(available)), 1.0 / available**2)


def test_polynomials_have_their_derivatives() -> None:
    row = [0.3, -1.2, 0.8, 0.05, -0.6]
    polynomial = np.polynomial.Polynomial(row)
    at = PLACES[0]
    for order in (0, 1, 2):
        found = taylor(row, Balls.exact(at), order)
        assert len(found) == order + 1
        for k, part in enumerate(found):
            assert isinstance(part, Balls)
            expected = polynomial.deriv(k)(at) if k else polynomial(at)
            np.testing.assert_allclose(part.mid, expected, atol=1e-12)


def test_a_machine_s_torque_flux_and_current_have_their_derivatives_over_both_arguments() -> None:
    """Of flux linkages with every second derivative, by the chain rule through both currents."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    psi_d = 0.1 + 0.3 * a - 0.05 * b + 0.07 * a * a - 0.11 * a * b + 0.02 * b * b
    psi_q = 0.02 - 0.04 * a + 0.5 * b - 0.06 * a * a + 0.03 * a * b - 0.08 * b * b
    d, q = F - 1.5, G + 0.4
    jets = [
        ca.gradient(psi, one) for psi in (psi_d, psi_q) for one in (a, b)
    ]  # l_dd, l_dq, l_qd, l_qq
    second = [
        ca.gradient(ca.gradient(psi, one), other)
        for psi in (psi_d, psi_q)
        for one, other in ((a, a), (a, b), (b, b))
    ]
    jet_of = ca.Function("jet", [a, b], [psi_d, psi_q, *jets, *second])
    i_d, i_q = bend_of(d), bend_of(q)
    assert isinstance(i_d.value, Balls)
    assert isinstance(i_q.value, Balls)
    rows = [
        [float(part) for part in jet_of(*place)]
        for place in zip(i_d.value.mid, i_q.value.mid, strict=True)
    ]

    def formula(_d: Any, _q: Any) -> Jet:
        return Jet(*(Balls.exact(column) for column in np.array(rows).T))

    machine = LinearMachine(3, 0.0, 1e-3, 1e-3, 0.1, 10.0)
    parts = machine_parts(machine, formula, i_d.value, i_q.value)
    linked = [ca.substitute(psi, ca.vertcat(a, b), ca.vertcat(d, q)) for psi in (psi_d, psi_q)]
    expected = (
        4.5 * (linked[0] * q - linked[1] * d),
        linked[0] ** 2 + linked[1] ** 2,
        d * d + q * q,
    )
    for part, of in zip(parts, expected, strict=True):
        same(composed(part, i_d, i_q), of, within=1e-9)


def test_the_range_of_a_quadratic_is_met_where_its_bends_have_one_sign() -> None:
    """Above where all bend up, below where all bend down: at a corner of the box."""
    half_t, half_x = np.array([0.3]), np.array([0.2])
    for sign in (1.0, -1.0):
        for slope_t, slope_x in ((0.5, 0.9), (-0.5, -0.9)):
            numbers = np.array([1.4, slope_t, slope_x, sign * 0.8, sign * 0.6, sign * 1.7])
            bend = Bend(*(Balls.exact(np.array([x])) for x in numbers))
            low, high = bend.range(bend, half_t, half_x)
            t, x = np.meshgrid(np.linspace(-0.3, 0.3, 61), np.linspace(-0.2, 0.2, 61))
            f = 1.4 + slope_t * t + slope_x * x + sign * (0.4 * t * t + 0.6 * t * x + 0.85 * x * x)
            assert low[0] <= f.min()
            assert f.max() <= high[0]
            met, edge = (high[0], f.max()) if sign > 0.0 else (low[0], f.min())
            assert met == pytest.approx(edge, rel=1e-12)
            other = low[0] if sign > 0.0 else high[0]
            straight = 0.5 * 0.3 + 0.9 * 0.2 + 0.6 * 0.3 * 0.2
            assert other == pytest.approx(1.4 - sign * straight, rel=1e-12)


def test_formulas_of_a_map_are_those_of_every_cell_that_a_box_touches() -> None:
    """Each with the map's flux linkages and first derivatives in its cell, and second derivatives
    by differences of the first; boxes of too many cells have none."""
    machine = one_sided("everywhere", 0.3e-3, 0.8e-3, 1.0)  # cells of 5 A and 2.5 A
    middle_d, middle_q = np.array([-12.0, 3.0, 20.0, -31.0]), np.array([6.0, -21.1, 11.0, 30.0])
    half_d, half_q = np.array([1.0, 4.0, 0.5, 16.0]), np.array([0.5, 2.0, 3.0, 9.0])
    i_d, i_q = (
        Balls.between(middle - half, middle + half)
        for middle, half in ((middle_d, half_d), (middle_q, half_q))
    )
    known = resolved(machine, i_d, i_q)
    assert known.tolist() == [True, True, True, False]
    seen = np.zeros(4, dtype=int)
    generator = np.random.default_rng(3)
    inside_d = middle_d + generator.uniform(-0.99, 0.99, (6, 4)) * half_d
    inside_q = middle_q + generator.uniform(-0.99, 0.99, (6, 4)) * half_q
    held = np.zeros((6, 4), dtype=bool)
    h = 1e-4
    for places, formula in formulas(machine, i_d, i_q):
        seen[places] += 1
        for k in range(6):
            d, q = inside_d[k, places], inside_q[k, places]
            jet = formula(Balls.exact(d), Balls.exact(q))
            own = machine.jet(d, q)
            names = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qd", "l_qq")
            values = [np.broadcast_to(getattr(jet, name).mid, d.shape) for name in names]
            close = [np.abs(v - getattr(own, n)) < 1e-9 for v, n in zip(values, names, strict=True)]
            held[k, places] |= np.all(close, axis=0)
            if k == 0:
                by_d = [formula(Balls.exact(d + s), Balls.exact(q)) for s in (h, -h)]
                by_q = [formula(Balls.exact(d), Balls.exact(q + s)) for s in (h, -h)]
                for name, sides, of in (
                    ("d_dd", by_d, "l_dd"), ("d_dq", by_q, "l_dd"), ("d_qq", by_q, "l_dq"),
                    ("q_dd", by_d, "l_qd"), ("q_dq", by_q, "l_qd"), ("q_qq", by_q, "l_qq"),
                ):  # fmt: skip
                    slope = (getattr(sides[0], of).mid - getattr(sides[1], of).mid) / (2.0 * h)
                    np.testing.assert_allclose(getattr(jet, name).mid, slope, atol=1e-8)
    assert seen.tolist() == [1, MOST_CELLS, 6, 0]
    assert held[:, :3].all()
