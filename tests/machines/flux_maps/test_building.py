"""Maps from points: the machine behind them comes back, whatever half, order,
scaling or gaps the file has.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from saturated import ArctanMachine
from scipy.interpolate import RBFInterpolator

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import (
    FluxMapReading,
    FluxTreatment,
    build_flux_map,
    converted,
)
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.names import FluxAxes, FluxScaling

MACHINE = ArctanMachine()
AXIS_D = np.linspace(-150.0, 60.0, 22)
HALF_Q = np.linspace(0.0, 130.0, 14)
FULL_Q = np.linspace(-130.0, 130.0, 27)


def points_of(i_d: FloatArray, i_q: FloatArray) -> FluxPoints:
    """Exact points of the machine at currents of one shape."""
    i_d, i_q = np.broadcast_arrays(i_d, i_q)
    psi_d, psi_q = MACHINE.flux(i_d.ravel(), i_q.ravel())
    return FluxPoints("map.csv", i_d.ravel().copy(), i_q.ravel().copy(), psi_d, psi_q)


def grid_of(i_d: FloatArray, i_q: FloatArray) -> FluxPoints:
    return points_of(i_d[:, np.newaxis], i_q[np.newaxis, :])


def chosen(points: FluxPoints, which: object) -> FluxPoints:
    """Some of the points, by mask or indices."""
    index = np.asarray(which)
    return FluxPoints(
        points.source,
        points.i_d[index],
        points.i_q[index],
        points.psi_d[index],
        points.psi_q[index],
    )


def worst(flux_map: FluxMap, i_d: FloatArray, i_q: FloatArray) -> float:
    """Largest error of a map against the machine over its largest flux linkage."""
    expected = np.stack(MACHINE.flux(i_d, i_q))
    return float(
        np.max(np.abs(np.stack(flux_map.flux(i_d, i_q)) - expected)) / np.max(np.abs(expected))
    )


def said(reading: FluxMapReading, pattern: str) -> bool:
    return any(re.search(pattern, finding) for finding in reading.findings)


@pytest.fixture(scope="module")
def baldor(shared_data: Path) -> FluxPoints:
    table = np.loadtxt(
        shared_data / "fluxmaps" / "baldor_ecs101m0h7ef4_400rpm_measured.csv",
        delimiter=",",
        skiprows=1,
    )
    return FluxPoints("baldor.csv", *table.T[:4])


@pytest.fixture(scope="module")
def thor(shared_data: Path) -> FluxPoints:
    """SyR-e's machine, whose magnets lie on the negative q axis."""
    data = np.load(shared_data / "fluxmaps" / "thor_dq_256.npz")
    i_q, i_d = np.meshgrid(data["iq"], data["id"], indexing="ij")
    psi_d, psi_q = data["psi_d"].astype(np.float64), data["psi_q"].astype(np.float64)
    return FluxPoints("thor.npz", i_d.ravel(), i_q.ravel(), psi_d.ravel(), psi_q.ravel())


@pytest.mark.parametrize("seed", [None, 5])
@pytest.mark.parametrize(
    ("axis_q", "sentence"),
    [
        (FULL_Q, "were averaged; they agree"),
        (HALF_Q, "the half plane i_q >= 0 was mirrored"),
        (-HALF_Q[::-1], "the half plane i_q <= 0 was mirrored"),
        (np.linspace(-30.0, 130.0, 17), "the larger half i_q >= 0 was mirrored"),
        (np.linspace(-130.0, 40.0, 18), "the larger half i_q <= 0 was mirrored"),
    ],
)
def test_grids_in_any_order_are_completed_to_the_machine(
    axis_q: FloatArray, sentence: str, seed: int | None
) -> None:
    points = grid_of(AXIS_D, axis_q)
    if seed is not None:
        points = chosen(points, np.random.default_rng(seed).permutation(points.i_d.size))
    reading = build_flux_map(points)
    np.testing.assert_allclose(reading.flux_map.i_d, AXIS_D, atol=1e-9)
    np.testing.assert_allclose(reading.flux_map.i_q, FULL_Q, atol=1e-9)
    psi_d, psi_q = MACHINE.flux(AXIS_D[:, np.newaxis], FULL_Q)
    np.testing.assert_allclose(reading.flux_map.psi_d, psi_d, atol=1e-13)
    np.testing.assert_allclose(reading.flux_map.psi_q, psi_q, atol=1e-13)
    assert said(reading, sentence)
    assert reading.asymmetry < 1e-12
    assert reading.energy_misfit < 2e-3


def test_a_half_plane_may_begin_half_a_step_from_zero() -> None:
    reading = build_flux_map(grid_of(AXIS_D, np.arange(5.0, 130.0, 10.0)))
    np.testing.assert_allclose(reading.flux_map.i_q, np.arange(-125.0, 126.0, 10.0))
    generator = np.random.default_rng(3)
    assert (
        worst(reading.flux_map, generator.uniform(-150, 60, 300), generator.uniform(-125, 125, 300))
        < 2e-4
    )


@pytest.mark.parametrize(
    ("scaling", "factor"), [("peak", 1.0), ("rms", 2**0.5), ("power-invariant", (2 / 3) ** 0.5)]
)
@pytest.mark.parametrize("axes", ["magnet-d", "reluctance"])
def test_conventions_of_the_file_are_undone(
    axes: FluxAxes, scaling: FluxScaling, factor: float
) -> None:
    right = grid_of(AXIS_D, HALF_Q)
    i_d, i_q, psi_d, psi_q = right.i_d, right.i_q, right.psi_d, right.psi_q
    if axes == "reluctance":  # the magnet on -q, the largest inductance on d
        i_d, i_q, psi_d, psi_q = i_q, -i_d, psi_q, -psi_d
    file = FluxPoints("map.csv", i_d / factor, i_q / factor, psi_d / factor, psi_q / factor)
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        np.testing.assert_allclose(
            getattr(converted(file, axes, scaling), name), getattr(right, name), rtol=1e-14
        )
    reading = build_flux_map(
        file, axes=axes, scaling=scaling, expected_psi_pm=MACHINE.psi_m, extrapolate=True
    )
    assert worst(reading.flux_map, right.i_d, right.i_q) < 1e-12
    assert reading.flux_map.extrapolate
    assert said(reading, "axes were turned") is (axes == "reluctance")
    assert said(reading, "were multiplied") is (scaling != "peak")


def test_halves_that_differ_are_averaged_and_their_distance_is_told() -> None:
    points = grid_of(AXIS_D, FULL_Q)
    skewed = FluxPoints(
        "map.csv", points.i_d, points.i_q, points.psi_d + 2e-5 * points.i_q, points.psi_q + 1e-3
    )
    reading = build_flux_map(skewed)
    assert reading.asymmetry == pytest.approx(2e-5 * 130.0, rel=1e-9)
    assert said(reading, "at most 2.6 mWb from their mean")
    assert worst(reading.flux_map, points.i_d, points.i_q) < 1e-12


def test_steps_that_differ_between_the_halves_are_evened() -> None:
    uneven = FULL_Q + np.where(FULL_Q > 0.0, 0.4, -0.2) * np.sign(FULL_Q) * np.sin(FULL_Q)
    reading = build_flux_map(grid_of(AXIS_D, uneven))
    assert reading.flux_map.i_q.size == 27
    generator = np.random.default_rng(4)
    end = reading.flux_map.i_q[-1]
    assert end == pytest.approx(min(uneven[-1], -uneven[0]))
    assert (
        worst(reading.flux_map, generator.uniform(-150, 60, 300), generator.uniform(-end, end, 300))
        < 2e-4
    )


def test_currents_equal_within_rounding_make_one_axis() -> None:
    points = grid_of(AXIS_D, FULL_Q)
    noise = np.random.default_rng(6).uniform(-2e-5, 2e-5, (2, points.i_d.size))
    reading = build_flux_map(
        FluxPoints(
            "map.csv", points.i_d + noise[0], points.i_q + noise[1], points.psi_d, points.psi_q
        )
    )
    assert reading.flux_map.psi_d.shape == (22, 27)


def test_repeated_points_merge_and_contradictions_are_refused() -> None:
    points = grid_of(AXIS_D, HALF_Q)
    twice = chosen(points, np.append(np.arange(points.i_d.size), [7, 30, 31]))
    reading = build_flux_map(twice)
    assert said(reading, "^3 points are given repeatedly")
    assert reading.flux_map.psi_d.shape == (22, 27)
    twice.psi_q[-1] += 0.04
    where = (
        rf"i_d = {points.i_d[31]:g} A, i_q = {points.i_q[31]:g} A .* given 2 times.*up to 0.02 Wb "
        r"from their mean"
    )
    with pytest.raises(InputError, match=where) as caught:
        build_flux_map(twice)
    assert str(caught.value).startswith("map.csv: ")


@pytest.mark.parametrize("low", [0.0, -130.0, -10.0])
def test_scattered_points_become_a_grid(low: float) -> None:
    generator = np.random.default_rng(8)
    points = points_of(generator.uniform(-150.0, 60.0, 812), generator.uniform(low, 130.0, 812))
    reading = build_flux_map(points)
    full = 812 if low == -130.0 else 2 * int(np.count_nonzero(points.i_q >= 0.0))
    count = round(full**0.5)
    assert reading.flux_map.psi_d.shape == (count, count | 1)
    assert said(
        reading,
        f"scattered points: 812 interpolated by thin-plate splines on a {count} x {count | 1} grid",
    )
    inner_d, inner_q = generator.uniform(-145.0, 55.0, 500), generator.uniform(-125.0, 125.0, 500)
    assert worst(reading.flux_map, inner_d, inner_q) < 2e-3
    np.testing.assert_array_equal(reading.flux_map.psi_d, reading.flux_map.psi_d[:, ::-1])
    np.testing.assert_array_equal(reading.flux_map.psi_q, -reading.flux_map.psi_q[:, ::-1])
    assert reading.asymmetry < (1e-3 if low == -130.0 else 1e-12)


def test_few_scattered_points_equal_the_global_thin_plate_spline() -> None:
    """Up to 64 points, mirror images included, there is one spline.

    Written out here from the points alone.
    """
    generator = np.random.default_rng(9)
    points = points_of(generator.uniform(-150.0, 60.0, 30), generator.uniform(1.0, 130.0, 30))
    grid = build_flux_map(points, treatment=FluxTreatment("interpolate")).flux_map
    at = np.stack([np.tile(points.i_d, 2), np.append(points.i_q, -points.i_q)], axis=1)
    flux = np.stack([np.tile(points.psi_d, 2), np.append(points.psi_q, -points.psi_q)], axis=1)
    scale = np.ptp(at, axis=0)
    nodes = np.stack(np.meshgrid(grid.i_d, grid.i_q, indexing="ij"), axis=2).reshape(-1, 2)
    expected = RBFInterpolator(at / scale, flux, kernel="thin_plate_spline", degree=1)(
        nodes / scale
    )
    np.testing.assert_allclose(grid.psi_d.ravel(), expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(grid.psi_q.ravel(), expected[:, 1], atol=1e-9)


def test_round_data_are_kept_and_their_corners_told() -> None:
    generator = np.random.default_rng(10)
    radius, angle = (
        130.0 * np.sqrt(generator.uniform(0.0, 1.0, 600)),
        generator.uniform(0.0, np.pi, 600),
    )
    reading = build_flux_map(points_of(radius * np.cos(angle), radius * np.sin(angle)))
    share = next(
        re.search(r"warning: (\d+) % of the nodes", f) for f in reading.findings if "warning" in f
    )
    assert share is not None
    length = np.hypot(reading.flux_map.i_d[:, np.newaxis], reading.flux_map.i_q)
    # The hull lies within the disc, and a little smaller disc within the hull.
    assert (
        100.0 * np.mean(length > 130.0) - 1.0
        < float(share[1])
        < 100.0 * np.mean(length > 118.0) + 1.0
    )
    inside = radius < 120.0
    assert (
        worst(reading.flux_map, (radius * np.cos(angle))[inside], (radius * np.sin(angle))[inside])
        < 2e-3
    )


def test_gaps_of_a_grid_are_filled_and_its_points_kept() -> None:
    points = grid_of(AXIS_D, HALF_Q)
    gone = np.random.default_rng(11).choice(points.i_d.size, 40, replace=False)
    left = chosen(points, np.setdiff1d(np.arange(points.i_d.size), gone))
    reading = build_flux_map(left)
    missing = 2 * 40 - int(np.count_nonzero(points.i_q[gone] == 0.0))
    assert said(reading, f"gaps of the 22 x 27 grid interpolated by thin-plate splines: {missing}$")
    assert not said(reading, "warning")
    assert worst(reading.flux_map, left.i_d, left.i_q) < 1e-12
    assert worst(reading.flux_map, points.i_d[gone], points.i_q[gone]) < 5e-3


def test_scattered_linear_machines_come_out_exactly() -> None:
    generator = np.random.default_rng(12)
    i_d, i_q = generator.uniform(-10.0, 5.0, 900), generator.uniform(-12.0, 12.0, 900)
    reading = build_flux_map(FluxPoints("map.csv", i_d, i_q, 0.1 + 2e-3 * i_d, 5e-3 * i_q))
    jet = reading.flux_map.jet(i_d[:50], i_q[:50])
    np.testing.assert_allclose(jet.l_dd, 2e-3, rtol=1e-6)
    np.testing.assert_allclose(jet.l_qq, 5e-3, rtol=1e-6)
    assert reading.energy_misfit < 1e-6


def test_zero_current_may_lie_one_step_outside() -> None:
    reading = build_flux_map(grid_of(np.linspace(-150.0, -10.0, 15), HALF_Q))
    assert said(reading, "runs from -150 to -10 A; the flux linkages at i_d = 0 are extrapolated")
    assert not said(build_flux_map(grid_of(np.linspace(-150.0, 0.0, 16), HALF_Q)), "extrapolated")


@pytest.mark.parametrize(
    ("points", "phrase"),
    [
        (
            grid_of(np.linspace(-150.0, -20.0, 14), HALF_Q),
            r"-150 to -20 A and omits zero current",
        ),
        (grid_of(np.linspace(30.0, 150.0, 14), HALF_Q), r"30 to 150 A and omits zero current"),
        (grid_of(AXIS_D, np.linspace(30.0, 130.0, 11)), r"half plane begins at \|i_q\| = 30 A"),
        (
            grid_of(np.array([-100.0, -50.0, 0.0]), HALF_Q),
            "at least 4 different values of i_d, got 3",
        ),
        (grid_of(AXIS_D, np.array([-50.0, 0.0, 50.0])), "has 3 different values of i_q"),
        (grid_of(np.array([-50.0]), HALF_Q), "has 1 different value of i_d"),
        (
            points_of(np.linspace(-50.0, 0.0, 15), np.linspace(0.0, 50.0, 15) ** 2),
            "15 points that fill no grid",
        ),
        (points_of(np.linspace(-50.0, 0.0, 30), np.zeros(30)), "has 1 different value of i_q"),
        (points_of(np.empty(0), np.empty(0)), "has no points"),
    ],
)
def test_points_that_make_no_map_are_refused(points: FluxPoints, phrase: str) -> None:
    with pytest.raises(InputError, match=phrase) as caught:
        build_flux_map(points)
    assert caught.value.source == "map.csv"


def test_points_on_a_line_are_refused() -> None:
    line = np.linspace(-40.0, 40.0, 33)
    points = FluxPoints("map.csv", line, line.copy(), 0.1 + 1e-3 * line, 2e-3 * line)
    with pytest.raises(InputError, match="lie on a line"):
        build_flux_map(points)


def test_measured_plane_is_averaged(baldor: FluxPoints, shared_data: Path) -> None:
    """The raw halves differ by 3.9 and 6.6 mV s; the authors' own symmetric map is their mean."""
    reading = build_flux_map(baldor)
    data = np.load(shared_data / "fluxmaps" / "baldor_400rpm_map.npz")
    current, flux = data["i_s_dq"], data["psi_s_dq"]
    np.testing.assert_allclose(reading.flux_map.psi_d, flux.real, atol=1e-8)
    np.testing.assert_allclose(reading.flux_map.psi_q, flux.imag, atol=1e-8)
    assert reading.asymmetry == pytest.approx(6.6e-3 / 2.0, abs=0.05e-3)
    assert said(reading, "3.32 mWb from their mean")
    assert 0.0 < reading.energy_misfit < 0.02
    symmetrised = build_flux_map(
        FluxPoints(
            "npz", *(part.ravel() for part in (current.real, current.imag, flux.real, flux.imag))
        )
    )
    zero = np.zeros(1)
    assert symmetrised.asymmetry < 1e-9
    assert symmetrised.flux_map.flux(zero, zero)[0][0] == pytest.approx(0.44415, abs=2e-5)


@pytest.mark.slow
def test_reluctance_axes_give_the_torque_of_their_authors(thor: FluxPoints) -> None:
    reading = build_flux_map(thor, axes="reluctance")
    machine = SaturatedMachine(2, 0.1967, reading.flux_map, 60.0)
    assert machine.psi_pm == pytest.approx(0.13336, abs=2e-5)
    angle = np.linspace(0.0, np.pi, 20001)
    for current, torque in ((11.3, 8.009), (22.6, 19.609), (44.0, 43.323), (60.0, 61.013)):
        scan = machine.torque(current * np.cos(angle), current * np.sin(angle))
        assert np.max(scan) == pytest.approx(torque, rel=1e-3)
    with pytest.raises(
        InputError, match=r"magnets lie on the negative q axis.*write axes: reluctance"
    ):
        build_flux_map(thor)


def test_a_sample_of_the_nodes_gives_nearly_the_same_torque(thor: FluxPoints) -> None:
    some = np.random.default_rng(13).random(thor.i_d.size) < 0.03
    machine = SaturatedMachine(
        2, 0.1967, build_flux_map(chosen(thor, some), axes="reluctance").flux_map, 60.0
    )
    angle = np.linspace(0.0, np.pi, 2001)
    assert np.max(machine.torque(44.0 * np.cos(angle), 44.0 * np.sin(angle))) == pytest.approx(
        43.323, rel=3e-3
    )


def test_computed_half_plane_gives_the_torque_of_its_corner(shared_data: Path) -> None:
    table = np.loadtxt(
        shared_data / "fluxmaps" / "femag_pm270l8_psidq_losses_50rps.csv", delimiter=",", skiprows=1
    )
    reading = build_flux_map(FluxPoints("femag.csv", *table.T[:4]))
    machine = SaturatedMachine(4, 0.0, reading.flux_map, 200.0)
    assert machine.psi_pm == pytest.approx(0.16194, abs=1e-5)
    assert machine.torque(np.array([-200.0]), np.array([200.0]))[0] == pytest.approx(
        405.2, abs=0.05
    )
    assert reading.flux_map.psi_d.shape == (6, 11)
    with pytest.raises(InputError, match="write axes: magnet-d"):
        build_flux_map(FluxPoints("femag.csv", *table.T[:4]), axes="reluctance")


@pytest.mark.slow
def test_trajectories_alone_make_the_torque_of_the_whole_map(
    thor: FluxPoints, shared_data: Path
) -> None:
    """MTPA, MTPV and field weakening as their authors publish them: the energy tells the rest, to
    2.02 % of the largest torque in the middle between the trajectories.
    """
    rows = np.concatenate(
        [
            np.loadtxt(shared_data / f"fluxmaps/thor_syre_{name}.csv", delimiter=",", skiprows=1)
            for name in ("MTPA", "MTPV", "MPFPA")
        ]
    )
    points = FluxPoints("trajectories.csv", *rows[:, :4].T)
    found = build_flux_map(points, axes="reluctance")
    assert found.fit.used == "smooth"
    assert found.fit.curl > 0.1
    assert found.energy_misfit < 0.01
    region = found.flux_map.hull
    assert region is not None
    i_d, i_q = (
        part.ravel() for part in np.meshgrid(np.linspace(-60.0, 0.0, 40), np.linspace(0, 66, 40))
    )
    within = region.contains(i_d, i_q)
    whole = build_flux_map(thor, axes="reluctance").flux_map
    plain = build_flux_map(
        points, axes="reluctance", treatment=FluxTreatment("interpolate")
    ).flux_map
    torques = []
    for flux_map in (whole, found.flux_map, plain):
        psi_d, psi_q = flux_map.flux(i_d[within], i_q[within])
        torques.append(3.0 * (psi_d * i_q[within] - psi_q * i_d[within]))
    wrong = [float(np.max(np.abs(torque - torques[0]))) for torque in torques[1:]]
    assert wrong[0] < 0.021 * float(np.max(torques[0]))
    assert wrong[0] < wrong[1]
