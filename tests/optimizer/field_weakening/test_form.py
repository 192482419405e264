"""Parts of a reference over torque and flux linkage by hand: aims and their derivatives, the least
largest error, curves in truncated powers, and the step in double."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from one_sided import one_sided
from scipy.optimize import linprog

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.field_weakening import form
from dqforge.optimizer.field_weakening.fit import _near_mtpv
from dqforge.optimizer.field_weakening.form import (
    Aims,
    SingleSurface,
    WeakeningReference,
    error_map,
    in_double,
    level,
    surface_samples,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT

RNG = np.random.default_rng(8)


def aims_of(machine: Any, count: int, **changes: Any) -> Aims:
    drawn = RNG.uniform(0.5, 1.5, (7, count))
    known = dict(
        zip(
            ("torque", "per_torque", "flux", "per_flux", "i_d", "i_q", "per_current"),
            drawn,
            strict=True,
        )
    )
    return Aims(machine, **(known | {"i_max": 20.0, "per_excess": 0.7} | changes))


def test_errors_and_their_derivatives_are_those_of_the_machine() -> None:
    """Of a machine whose fluxes depend on both currents; beyond the current limit and within."""
    machine = one_sided("everywhere", 0.3e-3, 0.8e-3, 1.0)
    i_d, i_q = RNG.uniform(-30.0, 5.0, 40), RNG.uniform(-25.0, 25.0, 40)
    aims = aims_of(machine, 40)
    found, by_d, by_q = aims.errors(i_d, i_q)

    def written(d: FloatArray, q: FloatArray) -> FloatArray:
        psi_d, psi_q = machine.flux(d, q)
        return np.stack(
            [
                (4.5 * (psi_d * q - psi_q * d) - aims.torque) * aims.per_torque,
                (np.hypot(psi_d, psi_q) - aims.flux) * aims.per_flux,
                (d - aims.i_d) * aims.per_current,
                (q - aims.i_q) * aims.per_current,
                np.maximum(np.hypot(d, q) - 20.0, 0.0) * 0.7,
            ]
        )

    np.testing.assert_allclose(found, written(i_d, i_q), rtol=1e-12, atol=1e-12)
    h = 1e-5
    for slope, more, less in (
        (by_d, written(i_d + h, i_q), written(i_d - h, i_q)),
        (by_q, written(i_d, i_q + h), written(i_d, i_q - h)),
    ):
        np.testing.assert_allclose(slope, (more - less) / (2.0 * h), atol=1e-5)
    assert 5 < np.count_nonzero(found[4]) < 35


def test_the_largest_error_is_nearly_the_least_there_is() -> None:
    """Of currents alone, where a linear programme knows it."""
    t = np.linspace(-1.0, 1.0, 60)
    family_d, family_q = (t[:, None] ** np.arange(n) for n in (2, 3))
    base = 0.3 * t, -0.2 * t
    none = np.zeros(60)
    aims = aims_of(
        LinearMachine(3, 0.0, 1e-3, 2e-3, 0.1, 20.0), 60, per_torque=none, per_flux=none,
        i_d=np.exp(t), i_q=np.sin(3.0 * t), per_current=np.full(60, 2.0),
    )  # fmt: skip
    least = []
    for family, wanted in ((family_d, aims.i_d - base[0]), (family_q, aims.i_q - base[1])):
        one = np.ones((60, 1))
        rows = np.block([[family, -one], [-family, -one]])
        found = linprog(
            np.append(np.zeros(family.shape[1]), 1.0), rows, np.append(wanted, -wanted),
            bounds=(None, None),
        )  # fmt: skip
        least.append(2.0 * found.fun)
    found = level(aims, base, family_d, family_q, 20.0)
    assert max(least) <= found.worst <= 1.05 * max(least)
    errors, *_ = aims.errors(base[0] + family_d @ found.d, base[1] + family_q @ found.q)
    assert np.max(np.abs(errors)) == pytest.approx(found.worst, rel=1e-9)


def test_curves_of_truncated_powers_are_their_local_polynomials() -> None:
    edges, degree, end = np.array([0.0, 0.2, 0.65, 1.0]), 3, 7.0
    weights = RNG.normal(size=9)
    share = RNG.uniform(0.0, 1.0, 50)
    columns = form._functions(share, edges, degree)
    expected = sum(
        weights[3 * k + n - 1] * np.maximum(share - start, 0.0) ** n
        for k, start in enumerate(edges[:-1])
        for n in (1, 2, 3)
    )
    np.testing.assert_allclose(columns @ weights, expected, rtol=1e-12)
    h = 1e-6
    slope = form._functions(share + h, edges, degree) - form._functions(share - h, edges, degree)
    np.testing.assert_allclose(form._slopes(share, edges, degree), slope / (2 * h), atol=1e-5)
    curve = form._segments(0.4, weights, edges, degree, end)
    np.testing.assert_allclose(curve.starts, end * edges[:-1], rtol=1e-7)
    np.testing.assert_allclose(in_double(curve, end * share), 0.4 + expected, atol=1e-5)
    np.testing.assert_allclose(form._edges(3, 2.0), [0.0, 1.0 / 9.0, 4.0 / 9.0, 1.0])


@pytest.mark.parametrize("rises", [False, True])
def test_a_levelled_curve_has_the_least_largest_error(*, rises: bool) -> None:
    """In units of what is permitted; from below and rising by a ten-thousandth where asked."""
    share = np.linspace(0.0, 1.0, 80)
    edges = np.array([0.0, 0.5, 1.0])
    functions = form._functions(share, edges, 2)
    target, unit = np.sqrt(share + 0.01) - 0.6 * share**4, 0.5 + share
    slopes = form._slopes(share, edges, 2) if rises else None
    weights, worst = form._level_curve(functions, target, unit, rising=slopes)
    errors = (weights[0] + functions @ weights[1:] - target) / unit
    assert np.max(np.abs(errors)) == pytest.approx(worst, rel=1e-6)
    whole = np.column_stack([np.ones(80), functions]) / unit[:, None]
    one, wanted = np.ones((80, 1)), target / unit
    rows = np.block([[whole, 0.0 * one if rises else -one], [-whole, -one]])
    most = np.append(wanted, -wanted)
    if slopes is not None:
        assert np.max(errors) < 1e-9
        least = 1e-4 * target.max()
        assert np.min(slopes @ weights[1:]) >= least * (1.0 - 1e-6)
        rows = np.vstack([rows, np.column_stack([0.0 * one, -slopes, 0.0 * one])])
        most = np.append(most, np.full(80, -least))
    best = linprog(np.append(np.zeros(5), 1.0), rows, most, bounds=(None, None))
    assert worst == pytest.approx(best.fun, rel=1e-5)


def curve(*row: float) -> SinglePolynomial:
    return SinglePolynomial(np.zeros(1, np.float32), np.array([row], dtype=np.float32))


def surface(*rows: list[float]) -> SingleSurface:
    return SingleSurface(tuple(np.array(row, dtype=np.float32) for row in rows))


REFERENCE = WeakeningReference(
    flux_min=np.float32(0.05),
    flux_max=np.float32(0.125),
    limit=curve(4.0, 30.0),
    d=curve(0.0, -0.5, 0.125),
    q=curve(0.0, 2.0, -0.0625),
    flux=curve(0.0625, 0.015625),
    torque_mid=np.float32(2.0),
    excess_mid=np.float32(0.03125),
    surface_d=surface([-100.0, 4.0, 0.5], [64.0, -8.0], [16.0]),
    surface_q=surface([-5.0, 0.25], [3.0, 1.5]),
)


def test_the_step_in_double_is_what_the_page_says() -> None:
    """Clamped torque and flux linkage, MTPA currents, and what weakens them; not-a-number is no
    torque, at the least flux linkage where the flux linkage is none."""
    torque = np.array([0.0, 1.0, -3.0, 9.0, -9.0, np.nan, 3.0, 2.0, np.inf], dtype=np.float32)
    flux = np.array([0.1, 0.12, 0.06, 0.07, 0.2, 0.1, np.nan, 0.01, 0.05], dtype=np.float32)
    t, a = REFERENCE.limited(torque, flux)
    clamped = np.clip(np.nan_to_num(flux.astype(float), nan=0.05), 0.05, 0.125)
    np.testing.assert_allclose(a, clamped, rtol=1e-6)
    size = np.where(np.isnan(torque) | np.isnan(flux), 0.0, np.abs(torque.astype(float)))
    expected = np.minimum(size, 4.0 + 30.0 * (clamped - 0.05))
    np.testing.assert_allclose(t, expected, rtol=1e-6)
    i_d, i_q = REFERENCE.currents(torque, flux)
    delta = np.maximum(0.0625 + 0.015625 * expected - clamped, 0.0)
    x, y = expected - 2.0, delta - 0.03125
    of_d = -100.0 + 4.0 * x + 0.5 * x * x + (64.0 - 8.0 * x) * y + 16.0 * y * y
    of_q = -5.0 + 0.25 * x + (3.0 + 1.5 * x) * y
    sign = np.where(torque < 0.0, -1.0, 1.0)
    d = -0.5 * expected + 0.125 * expected**2 + delta * of_d
    q = 2.0 * expected - 0.0625 * expected**2 + delta * expected * of_q
    np.testing.assert_allclose(i_d, d, rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(i_q, sign * q, rtol=2e-5, atol=1e-6)
    assert 3 < np.count_nonzero(delta) < 9
    assert REFERENCE.coefficients == 2 + 3 + 3 + 2 + 6 + 4
    assert REFERENCE.flash == 260 + 18 * 20
    at = REFERENCE.surface_d.evaluate(EXACT, "d", np.array([1.5, -2.0]), np.array([0.5, 0.25]))
    assert at.tolist() == [-100.0 + 6.0 + 1.125 + 26.0 + 4.0, -100.0 - 8.0 + 2.0 + 20.0 + 1.0]


def test_errors_are_measured_on_a_grid_that_ends_beyond_the_largest_torque() -> None:
    machine = LinearMachine(3, 0.0, 1e-3, 2e-3, 0.08, 20.0)
    region: Any = SimpleNamespace(
        flux_min=0.05,
        flux_max=0.125,
        i_max=20.0,
        machine=machine,
        largest_torque=lambda flux: 3.0 + 40.0 * flux,
    )
    samples = surface_samples(region, 5)
    assert samples.torque.shape == samples.flux.shape == samples.most.shape == (30,)
    even = np.array([0.05, 0.06875, 0.0875, 0.10625, 0.125])
    np.testing.assert_allclose(
        samples.flux.reshape(5, 6), np.repeat(even[:, None], 6, 1), rtol=1e-6
    )
    shares = [0.0, 0.5 - np.sqrt(0.125), 0.5, 0.5 + np.sqrt(0.125), 1.0, 1.05]
    most = 3.0 + 40.0 * even
    np.testing.assert_allclose(samples.most.reshape(5, 6)[:, 0], most, rtol=1e-6)
    np.testing.assert_allclose(samples.torque.reshape(5, 6), np.outer(most, shares), rtol=1e-6)
    found = error_map(region, REFERENCE, samples)
    i_d, i_q = (part.astype(float) for part in REFERENCE.currents(samples.torque, samples.flux))
    psi_d, psi_q = 0.08 + 1e-3 * i_d, 2e-3 * i_q
    torque = 4.5 * (psi_d * i_q - psi_q * i_d) - np.minimum(samples.torque, samples.most)
    np.testing.assert_allclose(found.torque, torque, atol=1e-9)
    excess = np.hypot(psi_d, psi_q) / samples.flux.astype(float) - 1.0
    np.testing.assert_allclose(found.flux_excess, excess, atol=1e-7)
    np.testing.assert_allclose(found.current_excess, np.hypot(i_d, i_q) / 20.0 - 1.0, atol=1e-9)


def test_the_line_above_the_currents_of_mtpv_lies_as_low_as_it_can() -> None:
    """Over the squared flux linkage, above all currents that are not the limit, a margin included;
    none where the limit holds everywhere."""

    def region(lowest: float) -> Any:
        def points(torque: FloatArray, flux: FloatArray) -> Any:
            used = np.minimum(lowest + (1.05 - lowest) * np.sqrt((flux - 0.02) / 0.06), 1.0)
            size = 30.0 * np.sqrt(used)
            assert np.all(torque == 2.0 * 11.0)
            return SimpleNamespace(i_d=-0.6 * size, i_q=0.8 * size)

        flux = SimpleNamespace(flux_min=0.02, flux_max=0.1, i_max=30.0, torque_max=11.0)
        return SimpleNamespace(flux=SimpleNamespace(**vars(flux), points=points))

    found = _near_mtpv(region(0.3))
    assert found is not None
    constant, slope = found
    a = np.linspace(0.02, 0.1, 201)
    used = 0.3 + 0.75 * np.sqrt((a - 0.02) / 0.06)
    below = used < 1.0
    room = constant + slope * a[below] ** 2 - 900.0 * (used[below] + 0.003)
    assert np.min(room) == pytest.approx(0.0, abs=1e-6)
    rows = -np.column_stack([np.ones(a.size), a**2])[below]
    best = linprog(-rows.sum(axis=0), rows, -900.0 * (used[below] + 0.003), bounds=(0.0, None))
    assert found == pytest.approx(tuple(best.x), rel=1e-6)
    assert _near_mtpv(region(0.98)) is None
