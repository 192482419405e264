"""Flux maps from arrays: every arrangement of the same numbers gives the same map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.map_files import make_flux_map, read_flux_map

I_D, I_Q = np.linspace(-120.0, 0.0, 9), np.linspace(0.0, 120.0, 11)
GRID_D, GRID_Q = np.meshgrid(I_D, I_Q, indexing="ij")
PSI_D, PSI_Q = 0.1 + 3e-4 * GRID_D, 0.1 * np.tanh(GRID_Q / 150.0)


def same(found: FluxMap, expected: FluxMap) -> None:
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-15
        )


def test_a_half_plane_is_mirrored() -> None:
    found = make_flux_map(I_D, I_Q, PSI_D, PSI_Q)
    np.testing.assert_array_equal(found.i_q, np.concatenate([-I_Q[:0:-1], I_Q]))
    np.testing.assert_array_equal(found.psi_d[:, 10:], PSI_D)
    np.testing.assert_array_equal(found.psi_q[:, :10], -PSI_Q[:, :0:-1])


def test_grids_meshes_points_and_lists_are_the_same() -> None:
    expected = make_flux_map(I_D, I_Q, PSI_D, PSI_Q)
    order = np.random.default_rng(5).permutation(PSI_D.size)
    same(make_flux_map(GRID_D, GRID_Q, PSI_D, PSI_Q), expected)
    same(make_flux_map(*(part.ravel()[order] for part in (GRID_D, GRID_Q, PSI_D, PSI_Q))), expected)
    same(make_flux_map(I_D.tolist(), I_Q.tolist(), PSI_D.tolist(), PSI_Q.tolist()), expected)


def test_rms_values_and_the_other_axes_are_converted() -> None:
    expected = make_flux_map(I_D, I_Q, PSI_D, PSI_Q)
    root = np.sqrt(2.0)
    same(make_flux_map(I_D / root, I_Q / root, PSI_D / root, PSI_Q / root, scaling="rms"), expected)
    # d of the reluctance convention is q here, and the magnets lie on its negative q axis.
    same(make_flux_map(GRID_Q, -GRID_D, PSI_Q, -PSI_D, axes="reluctance"), expected)


def test_scattered_points_say_where_they_end() -> None:
    generator = np.random.default_rng(2)
    i_d, i_q = generator.uniform(-100.0, 0.0, 250), generator.uniform(0.0, 100.0, 250)
    found = make_flux_map(i_d, i_q, 0.1 + 3e-4 * i_d, 6e-4 * i_q)
    assert found.hull is not None
    np.testing.assert_allclose(
        found.flux(np.array([-50.0]), np.array([50.0])), [[0.085], [0.03]], atol=1e-6
    )


def test_a_file_of_the_same_arrays_is_the_same_map(tmp_path: Path) -> None:
    np.savez(tmp_path / "map.npz", i_d=I_D, i_q=I_Q, psi_d=PSI_D, psi_q=PSI_Q)
    same(read_flux_map(tmp_path / "map.npz"), make_flux_map(I_D, I_Q, PSI_D, PSI_Q))
    with pytest.raises(InputError, match=r"none\.npz: there is no such file"):
        read_flux_map(tmp_path / "none.npz")


REFUSALS: list[tuple[tuple[Any, ...], str]] = [
    (
        (I_D, I_Q, PSI_D.T, PSI_Q.T),
        r"psi_d has the shape \(11, 9\), .* need \(9, 11\); give psi_d.T and psi_q.T",
    ),
    ((I_D, I_Q, PSI_D[:, 1:], PSI_Q), r"psi_d has the shape \(9, 10\), psi_q \(9, 11\)"),
    ((I_D, I_Q[1:], PSI_D, PSI_Q), r"the axes i_d and i_q need \(9, 10\)"),
    ((I_D, I_Q, PSI_D.ravel(), PSI_Q.ravel()), r"shapes \(9,\), \(11,\) and \(99,\)"),
    (
        (I_D, I_Q, np.where(GRID_D == -60.0, np.nan, PSI_D), PSI_Q),
        r"psi_d: the value at index \(4, 0\) is nan",
    ),
    (("A", I_Q, PSI_D, PSI_Q), "i_d: expected an array of numbers, got str"),
    ((I_D, I_Q, PSI_D, -PSI_Q), "flux map from arrays"),
]


@pytest.mark.parametrize(("arrays", "message"), REFUSALS)
def test_refusals_are_one_line(arrays: tuple[Any, ...], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        make_flux_map(*arrays)
    assert "\n" not in str(error.value)
