"""Flux maps: cubic polynomials come out exactly, derivatives are those of another spline library,
seams are smooth.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from saturated import ArctanMachine
from scipy.interpolate import CubicSpline, RectBivariateSpline

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import (
    FluxMap,
    SaturatedMachine,
    TorqueRipple,
    _spline,
    complete_by_symmetry,
    inductances,
    swing,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine, largest_torque_within
from dqforge.machines.errors import InputError
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import optimal_points

AXIS_D = np.linspace(-150.0, 60.0, 22)
AXIS_Q = np.linspace(-130.0, 130.0, 27)


def arctan_map(i_d: FloatArray = AXIS_D, i_q: FloatArray = AXIS_Q) -> FluxMap:
    psi_d, psi_q = ArctanMachine().flux(i_d[:, np.newaxis], i_q[np.newaxis, :])
    return FluxMap(i_d, i_q, psi_d, psi_q)


@pytest.fixture(scope="module")
def baldor(shared_data: Path) -> SaturatedMachine:
    """A 5.6 kW permanent-magnet-assisted reluctance machine, measured at 400 rpm."""
    data = np.load(shared_data / "fluxmaps" / "baldor_400rpm_map.npz")
    current, flux = data["i_s_dq"], data["psi_s_dq"]
    i_q, psi_d, psi_q = complete_by_symmetry(current.imag[0], flux.real, flux.imag)
    return SaturatedMachine(2, 0.63, FluxMap(current.real[:, 0].copy(), i_q, psi_d, psi_q), 19.5)


def test_cubic_polynomials_come_out_exactly() -> None:
    def psi(d: FloatArray, q: FloatArray) -> FloatArray:
        return 0.1 + 1e-3 * d - 2e-6 * q**2 + 3e-9 * d**3 - 1e-9 * d * q**2 + 1e-13 * d**3 * q**3

    flux_map = FluxMap(AXIS_D, AXIS_Q, psi(AXIS_D[:, None], AXIS_Q), psi(AXIS_D[:, None], AXIS_Q))
    generator = np.random.default_rng(1)
    d, q = generator.uniform(-150, 60, 200), generator.uniform(-130, 130, 200)
    jet = flux_map.jet(d, q)
    np.testing.assert_allclose(jet.psi_d, psi(d, q), rtol=1e-11)
    np.testing.assert_allclose(
        jet.l_dd, 1e-3 + 9e-9 * d**2 - 1e-9 * q**2 + 3e-13 * d**2 * q**3, rtol=1e-8
    )
    np.testing.assert_allclose(jet.d_qq, -4e-6 - 2e-9 * d + 6e-13 * d**3 * q, rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(flux_map.flux(d, q)[1], psi(d, q), rtol=1e-11)


def test_derivatives_equal_those_of_another_spline_library() -> None:
    flux_map = arctan_map()
    generator = np.random.default_rng(2)
    d, q = generator.uniform(-150, 60, 300), generator.uniform(-130, 130, 300)
    jet = flux_map.jet(d, q)
    other = RectBivariateSpline(AXIS_D, AXIS_Q, flux_map.psi_q, s=0)
    orders = {
        "psi_q": (0, 0),
        "l_qd": (1, 0),
        "l_qq": (0, 1),
        "q_dd": (2, 0),
        "q_dq": (1, 1),
        "q_qq": (0, 2),
    }
    for name, (in_d, in_q) in orders.items():
        expected = other.ev(d, q, dx=in_d, dy=in_q)
        np.testing.assert_allclose(getattr(jet, name), expected, rtol=1e-8, atol=1e-13)


def test_second_derivatives_are_continuous_across_cells() -> None:
    flux_map = arctan_map()
    for edge in AXIS_D[1:-1]:
        left, right = (
            flux_map.jet(np.array([edge + side]), np.array([17.3])) for side in (-1e-7, 1e-7)
        )
        for name in ("psi_d", "l_dd", "d_dd", "d_dq", "q_qq"):
            assert getattr(left, name)[0] == pytest.approx(
                getattr(right, name)[0], rel=1e-4, abs=1e-12
            )


def test_outside_the_grid_the_inductance_of_the_edge_goes_on() -> None:
    flux_map = arctan_map()
    edge, beyond = (flux_map.jet(np.array([x]), np.array([20.0])) for x in (60.0, 90.0))
    assert beyond.psi_d[0] == pytest.approx(edge.psi_d[0] + 30.0 * edge.l_dd[0], rel=1e-12)
    assert beyond.d_dd[0] == 0.0
    np.testing.assert_array_equal(
        flux_map.inside(np.array([60.0, 60.1, 0.0]), np.array([0.0, 0.0, 131.0])),
        [True, False, False],
    )
    assert flux_map.flux(np.array([90.0]), np.array([20.0]))[0][0] == beyond.psi_d[0]


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize(
    "place", [(-180.0, 20.0), (75.0, -40.0), (10.0, 150.0), (-10.0, -131.0), (80.0, 140.0)]
)
def test_derivatives_outside_are_those_of_the_continuation(
    place: tuple[float, float], even: bool
) -> None:
    axis = AXIS_D if even else -150.0 + 210.0 * np.linspace(0.0, 1.0, 22) ** 1.3
    flux_map = arctan_map(axis)
    step = 1e-3

    def flux(d: float, q: float) -> FloatArray:
        return np.array(flux_map.flux(np.array(d), np.array(q)))

    d, q = place
    jet = flux_map.jet(np.array([d]), np.array([q]))
    by_d = (flux(d + step, q) - flux(d - step, q)) / (2 * step)
    by_q = (flux(d, q + step) - flux(d, q - step)) / (2 * step)
    by_qq = (flux(d, q + step) - 2 * flux(d, q) + flux(d, q - step)) / step**2
    np.testing.assert_allclose([jet.l_dd[0], jet.l_qd[0]], by_d, rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose([jet.l_dq[0], jet.l_qq[0]], by_q, rtol=1e-6, atol=1e-11)
    np.testing.assert_allclose([jet.d_qq[0], jet.q_qq[0]], by_qq, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("even", [True, False])
def test_flux_and_inductance_have_no_step_at_the_edge(even: bool) -> None:
    axis = AXIS_D if even else -150.0 + 210.0 * np.linspace(0.0, 1.0, 22) ** 1.3
    flux_map = arctan_map(axis)
    q = np.linspace(-140.0, 140.0, 57)
    for edge in (axis[0], axis[-1]):
        sides = [flux_map.jet(np.full_like(q, edge + side), q) for side in (-1e-9, 1e-9)]
        for name in ("psi_d", "psi_q", "l_dd", "l_dq", "l_qd", "l_qq"):
            np.testing.assert_allclose(
                getattr(sides[0], name), getattr(sides[1], name), rtol=1e-9, atol=1e-13
            )


def test_flux_and_jet_agree_over_several_chunks_and_nan_passes_through() -> None:
    flux_map = arctan_map()
    generator = np.random.default_rng(3)
    d, q = generator.uniform(-200, 100, 5000), generator.uniform(-180, 180, 5000)
    d[7], q[4500] = np.nan, np.nan
    d[8], q[9] = 1e300, -1e300
    jet, (psi_d, psi_q) = flux_map.jet(d, q), flux_map.flux(d, q)
    np.testing.assert_array_equal(jet.psi_d, psi_d)
    np.testing.assert_array_equal(jet.psi_q, psi_q)
    assert np.flatnonzero(np.isnan(psi_d)).tolist() == [7, 4500]
    assert flux_map.jet(np.zeros(0), np.zeros(0)).q_qq.shape == (0,)
    assert flux_map.jet(np.zeros((2, 1)), np.zeros(3)).d_dq.shape == (2, 3)


def test_uneven_and_even_axes_give_the_same_splines() -> None:
    """A map on even points, found by arithmetic, and the same with one axis moved by
    less than anything matters.
    """
    moved = AXIS_D.copy()
    moved[5] += 1e-6
    even, uneven = arctan_map(), arctan_map(moved)
    generator = np.random.default_rng(4)
    d, q = generator.uniform(-160, 70, 400), generator.uniform(-140, 140, 400)
    np.testing.assert_allclose(even.flux(d, q), uneven.flux(d, q), rtol=1e-7, atol=1e-10)


def test_the_map_owns_its_arrays() -> None:
    psi_d, psi_q = ArctanMachine().flux(AXIS_D[:, np.newaxis], AXIS_Q[np.newaxis, :])
    flux_map = FluxMap(AXIS_D, AXIS_Q, psi_d, psi_q)
    before = flux_map.flux(np.zeros(1), np.ones(1))[0][0]
    psi_d += 1.0
    assert flux_map.flux(np.zeros(1), np.ones(1))[0][0] == before
    with pytest.raises(ValueError, match="read-only"):
        flux_map.psi_d[0, 0] = 0.0


def test_machine_offers_what_the_linear_one_does() -> None:
    """A map of constant inductances is the linear machine: flux, torque, voltage, saliency,
    torque per ampere.
    """
    linear = LinearMachine(
        4, 0.02, 350e-6, 592e-6, 0.1049, 100.0, inertia=0.05, friction=1e-3, omega_m_max=900.0
    )
    psi_d, psi_q = np.broadcast_arrays(*linear.flux(AXIS_D[:, np.newaxis], AXIS_Q))
    saturated = SaturatedMachine(
        4, 0.02, FluxMap(AXIS_D, AXIS_Q, psi_d, psi_q), 100.0, 0.05, 1e-3, 900.0
    )
    generator = np.random.default_rng(5)
    d, q, omega = (generator.uniform(-90.0, 50.0, 50) for _ in range(3))
    for name in (
        "psi_pm",
        "l_d",
        "l_q",
        "saliency",
        "torque_per_ampere",
        "inertia",
        "friction",
        "omega_m_max",
    ):
        assert getattr(saturated, name) == pytest.approx(getattr(linear, name), rel=1e-9), name
    np.testing.assert_allclose(saturated.torque(d, q), linear.torque(d, q), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        saturated.voltage(d, q, omega), linear.voltage(d, q, omega), rtol=1e-9, atol=1e-9
    )
    table = inductances(saturated, np.append(d, 0.0), np.append(q, 0.0))
    for name, expected in (("l_d", 350e-6), ("l_q", 592e-6), ("l_dd", 350e-6), ("psi_m", 0.1049)):
        np.testing.assert_allclose(getattr(table, name), expected, rtol=1e-8)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_apparent_inductances_make_up_the_flux(share_d: float, share_q: float) -> None:
    machine = SaturatedMachine(3, 0.05, arctan_map(), 120.0)
    d, q = np.array([60.0 * share_d]), np.array([120.0 * share_q])
    table, (psi_d, psi_q) = inductances(machine, d, q), machine.flux(d, q)
    assert table.psi_m[0] + table.l_d[0] * d[0] == pytest.approx(psi_d[0], rel=1e-9)
    assert table.l_q[0] * q[0] == pytest.approx(psi_q[0], rel=1e-9, abs=1e-13)
    # The chord's slope lies within those of the tangents.
    slopes = machine.jet(np.linspace(0.0, d[0], 201), np.full(201, q[0])).l_dd
    assert np.min(slopes) * (1 - 1e-3) <= table.l_d[0] <= np.max(slopes) * (1 + 1e-3)


def test_apparent_inductances_are_smooth_through_zero() -> None:
    machine = SaturatedMachine(3, 0.05, arctan_map(), 120.0)
    small = 1e-5 * 120.0
    around = np.array([-2.0, -1.01, -0.99, -1e-8, 0.0, 0.5, 0.99, 1.01, 2.0]) * small
    l_d = inductances(machine, around, np.full_like(around, 30.0)).l_d
    l_q = inductances(machine, np.full_like(around, 20.0), around).l_q
    assert np.ptp(l_d) < 1e-6 * l_d[0]
    assert np.ptp(l_q) < 1e-6 * l_q[0]


def test_flux_keeps_the_shape_of_its_arguments() -> None:
    psi_d, psi_q = arctan_map().flux(np.zeros((3, 1)), np.zeros(4))
    assert psi_d.shape == psi_q.shape == (3, 4)


def test_symmetry_completes_half_planes_and_averages_full_ones() -> None:
    half = np.linspace(0.0, 130.0, 14)
    machine = ArctanMachine()
    psi_d, psi_q = machine.flux(AXIS_D[:, None], half)
    axis, full_d, full_q = complete_by_symmetry(half, psi_d, psi_q)
    np.testing.assert_allclose(full_q, machine.flux(AXIS_D[:, None], axis)[1], atol=1e-15)
    np.testing.assert_allclose(full_d, machine.flux(AXIS_D[:, None], axis)[0], atol=1e-15)
    skewed = full_d + 1e-3 * axis / 130.0
    np.testing.assert_allclose(complete_by_symmetry(axis, skewed, full_q)[1], full_d, atol=1e-12)
    with pytest.raises(InputError, match="symmetric about 0"):
        complete_by_symmetry(np.linspace(-100.0, 130.0, 14), psi_d, psi_q)


@pytest.mark.parametrize(
    ("damage", "phrase"),
    [
        ({"i_d": AXIS_D[:3]}, "at least 4 different values of i_d"),
        ({"i_q": AXIS_Q[::-1].copy()}, "i_q must be finite and ascend"),
        ({"psi_d": np.zeros((27, 22))}, "its axes need"),
        (
            {"psi_q": np.where(np.arange(27) == 5, np.nan, np.zeros((22, 27)))},
            "hole at i_d = -150 A, i_q = -80 A",
        ),
    ],
)
def test_grids_that_cannot_be_are_refused(damage: dict[str, FloatArray], phrase: str) -> None:
    good = {"i_d": AXIS_D, "i_q": AXIS_Q, "psi_d": np.zeros((22, 27)), "psi_q": np.zeros((22, 27))}
    grid = good | damage
    with pytest.raises(InputError, match=phrase):
        FluxMap(grid["i_d"], grid["i_q"], grid["psi_d"], grid["psi_q"])


def test_machine_reads_its_properties_at_zero_current(baldor: SaturatedMachine) -> None:
    assert baldor.psi_pm == pytest.approx(0.44415, abs=2e-5)
    assert baldor.l_q > baldor.l_d > 0.0
    # The best measured grid point within 12.45 A makes 27.774 N m, at (-8 A, 8 A).
    assert baldor.torque(np.array([-8.0]), np.array([8.0]))[0] == pytest.approx(27.774, rel=2e-3)


def test_solver_holds_on_a_measured_map(baldor: SaturatedMachine) -> None:
    """A whole map: every point proves itself, and its best torque is that of a scan of all
    angles.
    """
    locus = mtpa_locus(baldor, baldor.i_max)
    angle = np.linspace(0.0, np.pi, 4001)
    for level in (40, 100, 159):
        scan = baldor.torque(
            locus.current[level] * np.cos(angle), locus.current[level] * np.sin(angle)
        )
        assert locus.torque[level] == pytest.approx(np.max(scan), rel=1e-6)
    torque, omega = np.meshgrid(
        np.linspace(-1.1, 1.1, 80) * locus.torque[-1], np.linspace(-800.0, 800.0, 81)
    )
    points = optimal_points(baldor, torque, omega, v_max=375.6)
    assert np.all(points.kkt_residual < 1e-8)
    assert set(points.active.tolist()) >= {0, 1, 2, 3}
    spline_free = points.active == 0
    current = np.hypot(points.i_d, points.i_q)[spline_free]
    np.testing.assert_allclose(
        np.interp(current, locus.current, locus.torque),
        np.abs(points.torque[spline_free]),
        atol=0.02,
    )


@given(st.integers(0, 2**32 - 1), st.integers(4, 40), st.floats(0.0, 4.0))
def test_splines_are_those_of_another_library(seed: int, count: int, uneven: float) -> None:
    draw = np.random.default_rng(seed)
    axis = np.cumsum(draw.uniform(0.1, 1.0, count) ** uneven)  # rows are interchanged where uneven
    values = draw.normal(size=(count, 2, 3))
    expected = CubicSpline(axis, values, bc_type="not-a-knot").c[::-1]
    scale = np.max(np.abs(expected), axis=(1, 2, 3), keepdims=True)
    assert np.max(np.abs(_spline(axis, values) - expected) / scale) < 1e-9


def test_a_ripple_is_the_swing_of_its_orders_together() -> None:
    """Two orders whose peaks fall together and apart, over a period in which both repeat; of a mean
    of no torque there is no share."""
    orders, period = np.array([6.0, 12.0]), np.pi / 3.0
    series = np.array([[[2.0, 0.0], [0.0, 1.5]], [[0.5, 0.0], [0.0, -0.8]]])
    angle = np.linspace(0.0, period, 20_001)
    courses = (
        2.0 * np.cos(6.0 * angle) + 0.5 * np.cos(12.0 * angle),
        1.5 * np.sin(6.0 * angle) - 0.8 * np.sin(12.0 * angle),
    )
    found = swing(orders, period, series)
    np.testing.assert_allclose(found, [np.ptp(course) for course in courses], rtol=2e-3)
    ripple = TorqueRipple((6.0, 12.0), np.hypot(series[:, 0], series[:, 1]), found)
    share = ripple.over(np.array([-4.0, 0.0]))
    assert share[0] == pytest.approx(found[0] / 4.0)
    assert np.isnan(share[1])


@pytest.mark.parametrize("extrapolate", [True, False])
@pytest.mark.parametrize("i_max", [40.0, 120.0])
def test_the_largest_torque_of_a_map_is_that_of_a_walk_along_the_limit(
    extrapolate: bool, i_max: float
) -> None:
    """The data end at 60 A of positive i_d, where that limit is not the circle any more."""
    flux_map = replace(arctan_map(), extrapolate=extrapolate)
    machine = SaturatedMachine(3, 0.05, flux_map, 120.0)
    share, angle = np.meshgrid(np.linspace(0.0, 1.0, 201), np.linspace(0.0, np.pi, 2001))
    i_d, i_q = i_max * share * np.cos(angle), i_max * share * np.sin(angle)
    torque = machine.torque(i_d, i_q)[flux_map.extrapolate | (i_d <= 60.0)]
    assert largest_torque_within(machine, i_max) == pytest.approx(torque.max(), rel=1e-5)
    along_q = machine.torque(np.zeros(1), np.array([i_max]))[0]
    assert largest_torque_within(machine, i_max, "id0") == pytest.approx(along_q, rel=1e-9)
