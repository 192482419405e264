"""Asymmetric flux maps: said in torque, turned back where a frame was misaligned,
kept or halved by a key.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from noisy import grid_points, mapped_design
from saturated import PM_SYRM

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine, mirrored
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, torque_from_flux
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import (
    FluxTreatment,
    asymmetry_of,
    build_flux_map,
    frame_angle,
)
from dqforge.machines.flux_maps.flux_points import FluxPoints

CURVED = SaturatedMachine(2, 0.63, PM_SYRM.flux_map(18.7 * 1.3), 18.7)
ISOTROPIC = LinearMachine(3, 0.1, 1e-3, 1e-3, 0.1, 50.0)
SALIENT = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0)
RELUCTANCE = LinearMachine(2, 0.54, 41.5e-3, 6.2e-3, 0.0, 22.0)


def misaligned(machine: Machine, angle: float) -> tuple[FloatArray, ...]:
    """Points that a bench with an encoder off by an angle in rad writes:
    its d axis lies ``angle`` behind the true one.

    The true vector is the bench's times exp(-j angle), by complex numbers.
    """
    i_d, i_q, *_ = grid_points(machine)
    true = (i_d + 1j * i_q) * np.exp(-1j * angle)
    psi_d, psi_q = machine.flux(true.real, true.imag)
    seen = (psi_d + 1j * psi_q) * np.exp(1j * angle)
    return i_d, i_q, seen.real, seen.imag


def whole_map(points: tuple[FloatArray, ...], shape: tuple[int, int] = (21, 27)) -> FluxMap:
    i_d, i_q, psi_d, psi_q = (part.reshape(shape) for part in points)
    return FluxMap(i_d[:, 0], i_q[0], psi_d, psi_q)


@pytest.mark.parametrize("machine", [CURVED, ISOTROPIC, SALIENT, RELUCTANCE])
@pytest.mark.parametrize("degrees", [-7.0, -0.3, 0.0, 1.0, 4.0])
def test_the_angle_of_a_misaligned_encoder_is_found(machine: Machine, degrees: float) -> None:
    assert np.degrees(
        frame_angle(whole_map(misaligned(machine, np.radians(degrees))))
    ) == pytest.approx(degrees, abs=0.02)


@pytest.mark.parametrize("degrees", [-3.0, 2.0])
def test_the_key_undoes_a_misaligned_encoder(degrees: float, tmp_path: Path) -> None:
    points = misaligned(CURVED, np.radians(degrees))
    told = load_design(mapped_design(tmp_path, CURVED, points))
    asymmetry = told.flux_evidence[0].asymmetry
    assert asymmetry is not None
    assert asymmetry.removes
    assert np.degrees(asymmetry.angle) == pytest.approx(degrees, abs=0.02)
    assert asymmetry.torque_most > 0.5
    assert asymmetry.torque_most_left < 0.05 * asymmetry.torque_most
    assert f"frame_angle: {degrees:.3g} deg" in " ".join(told.assumptions)
    mended = load_design(
        mapped_design(tmp_path, CURVED, points, keys=f", frame_angle: {degrees} deg")
    )
    i_d, i_q = (
        part.ravel() for part in np.meshgrid(np.linspace(-15, 0, 9), np.linspace(-15, 15, 9))
    )
    apart = np.stack(mended.machine.flux(i_d, i_q)) - np.stack(CURVED.flux(i_d, i_q))
    unmended = np.stack(told.machine.flux(i_d, i_q)) - np.stack(CURVED.flux(i_d, i_q))
    assert np.max(np.abs(apart)) < 2e-3
    assert np.max(np.abs(apart)) < 0.3 * np.max(np.abs(unmended))


def test_a_scattered_map_is_turned_too() -> None:
    i_d, i_q = np.random.default_rng(1).uniform(-50.0, 50.0, (2, 400))
    seen = (0.1 * np.exp(1j * 0.05)) + 1e-3 * (i_d + 1j * i_q)
    found = build_flux_map(
        FluxPoints("map.csv", i_d, i_q, seen.real, seen.imag),
        treatment=FluxTreatment(frame_angle=0.05),
    )
    psi_d, psi_q = found.flux_map.flux(np.array([0.0, 10.0]), np.array([0.0, 20.0]))
    np.testing.assert_allclose(psi_d, [0.1, 0.11], atol=1e-6)
    np.testing.assert_allclose(psi_q, [0.0, 0.02], atol=1e-6)


def leaning(points: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    """A real asymmetry: 2 % more psi_d where i_q > 0, 2 % less where it is below."""
    i_d, i_q, psi_d, psi_q = points
    return i_d, i_q, psi_d * (1.0 + 0.02 * np.tanh(i_q / 4.0)), psi_q


def test_a_real_asymmetry_is_said_in_torque_and_no_frame_removes_it(tmp_path: Path) -> None:
    points = leaning(grid_points(CURVED))
    design = load_design(mapped_design(tmp_path, CURVED, points))
    found = design.flux_evidence[0].asymmetry
    assert found is not None
    assert found.current == CURVED.i_max
    # The same by hand: the best of many directions on the mean of both halves.
    angle = np.linspace(0.0, np.pi, 20001)
    i_d, i_q = CURVED.i_max * np.cos(angle), CURVED.i_max * np.sin(angle)
    psi_d, psi_q = CURVED.flux(i_d, i_q)
    best = int(np.argmax(psi_d * i_q - psi_q * i_d))
    factor = 0.02 * np.tanh(i_q[best] / 4.0)
    expected = 1.5 * 2 * 2.0 * factor * psi_d[best] * i_q[best]
    assert found.torque == pytest.approx(expected, rel=2e-3)
    assert found.share == pytest.approx(
        expected / float(CURVED.torque(i_d[best : best + 1], i_q[best : best + 1])[0]), rel=2e-3
    )
    assert f"{found.torque:.3g} N m" in " ".join(design.assumptions)


def test_symmetric_maps_have_nothing_to_tell(tmp_path: Path) -> None:
    assert (
        load_design(mapped_design(tmp_path, CURVED, grid_points(CURVED))).flux_evidence[0].asymmetry
        is None
    )


@pytest.mark.parametrize(
    ("key", "factor"), [("average", 1.0), ("positive", 1.02), ("negative", 0.98)]
)
def test_a_key_says_which_half_counts(key: str, factor: float, tmp_path: Path) -> None:
    design = load_design(
        mapped_design(tmp_path, CURVED, leaning(grid_points(CURVED)), keys=f", symmetry: {key}")
    )
    i_d, i_q = np.array([-5.0, -5.0]), np.array([18.0, -18.0])
    np.testing.assert_allclose(
        design.machine.flux(i_d, i_q)[0], factor * CURVED.flux(i_d, i_q)[0], rtol=1e-3
    )
    assert design.halves is None


def test_kept_halves_are_those_of_the_file(tmp_path: Path) -> None:
    design = load_design(
        mapped_design(tmp_path, CURVED, leaning(grid_points(CURVED)), keys=", symmetry: keep")
    )
    assert design.halves is not None
    i_d, i_q = np.array([-5.0]), np.array([18.0])
    exact = CURVED.flux(i_d, i_q)
    for half, factor in zip(design.halves, (1.02, 0.98), strict=True):
        psi_d, psi_q = half.flux(i_d, i_q)
        assert psi_d == pytest.approx(factor * exact[0], rel=1e-3)
        assert psi_q == pytest.approx(exact[1], rel=1e-3)


@pytest.mark.parametrize("key", ["keep", "positive", "negative"])
def test_one_half_has_no_other_to_keep(key: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"symmetry: {key} needs points of both halves"):
        load_design(
            mapped_design(
                tmp_path,
                CURVED,
                grid_points(CURVED, (21, 14), half=True),
                keys=f", symmetry: {key}",
            )
        )


def test_fixed_point_cannot_keep_the_halves(tmp_path: Path) -> None:
    path = mapped_design(
        tmp_path,
        CURVED,
        grid_points(CURVED),
        keys=", symmetry: keep",
        control="fit: {format: q15}\n",
    )
    with pytest.raises(
        InputError, match=r":7:\d+: machine.flux_map.symmetry: keep needs references in float32"
    ):
        load_design(path)


def test_a_mirrored_map_makes_the_opposite_torque() -> None:
    whole = whole_map(leaning(grid_points(CURVED)))
    i_d, i_q = np.array([-7.0, -3.0]), np.array([9.0, -12.0])
    here = torque_from_flux(2, *whole.flux(i_d, i_q), i_d, i_q)
    there = torque_from_flux(2, *mirrored(whole).flux(i_d, -i_q), i_d, -i_q)
    np.testing.assert_allclose(there, -here, rtol=1e-12)


def test_the_measured_machine_is_nearly_symmetric_in_torque(shared_data: Path) -> None:
    """The raw halves lie 6.6 mVs apart, yet at rated current they make the same torque: by
    interpolation of SciPy.
    """
    from scipy.interpolate import RectBivariateSpline

    table = np.loadtxt(
        shared_data / "fluxmaps" / "baldor_ecs101m0h7ef4_400rpm_measured.csv",
        delimiter=",",
        skiprows=1,
    )
    found = build_flux_map(FluxPoints("baldor.csv", *table.T[:4]))
    assert found.whole is not None
    asymmetry = asymmetry_of(
        found.whole, found.flux_map, 2, 8.8 * np.sqrt(2.0), "rated current", "average"
    )
    order = np.lexsort((table[:, 1], table[:, 0]))
    i_d, i_q = np.unique(table[:, 0]), np.unique(table[:, 1])
    splines = [
        RectBivariateSpline(i_d, i_q, table[order, k].reshape(i_d.size, i_q.size)) for k in (2, 3)
    ]

    def torque(d: float, q: float) -> float:
        return float(3.0 * (splines[0].ev(d, q) * q - splines[1].ev(d, q) * d))

    angle = np.linspace(0.0, np.pi, 3601)
    amplitude = 8.8 * np.sqrt(2.0)
    mean = [
        torque(amplitude * np.cos(a), amplitude * np.sin(a))
        - torque(amplitude * np.cos(a), -amplitude * np.sin(a))
        for a in angle
    ]
    best = angle[int(np.argmax(mean))]
    d, q = amplitude * np.cos(best), amplitude * np.sin(best)
    assert asymmetry.positive == pytest.approx(torque(d, q), rel=1e-3)
    assert asymmetry.torque == pytest.approx(torque(d, q) + torque(d, -q), abs=5e-3)
    assert abs(asymmetry.share) < 2e-3
    assert 2.0 * asymmetry.largest == pytest.approx(6.6e-3, rel=0.02)
    assert not asymmetry.removes
