"""Convex regions of currents: what lies inside, against formulas and
against triangulated points.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import CurrentRegion
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.fit import flux_map_of_maps
from dqforge.machines.flux_maps.flux_points import FluxPoints


def _points(i_d: np.ndarray, i_q: np.ndarray) -> FluxPoints:
    return FluxPoints("map.csv", i_d, i_q, 0.05 + 0.25e-3 * i_d, 0.6e-3 * i_q)


def test_rectangle_knows_each_side_of_its_own() -> None:
    region = CurrentRegion.rectangle(-40.0, 5.0, 30.0)
    assert region.reach == 5.0
    assert region.covers(5.0)
    assert not region.covers(5.001)
    currents = np.array([[-40.0, 5.0, 5.1, -40.1, 0.0, 0.0], [30.0, -30.0, 0.0, 0.0, 30.1, -30.1]])
    assert region.contains(*currents).tolist() == [True, True, False, False, False, False]
    assert region.end_of_ray(0.5 * np.pi) == pytest.approx(30.0)


def test_rectangle_includes_zero_current() -> None:
    assert CurrentRegion.rectangle(-40.0, -1.0, 30.0).contains(np.zeros(1), np.zeros(1))[0]


def test_hull_is_that_of_the_points_and_their_mirror_images() -> None:
    generator = np.random.default_rng(3)
    i_d, i_q = generator.normal(-5.0, 8.0, 60), np.abs(generator.normal(0.0, 10.0, 60))
    region = CurrentRegion.hull(i_d, i_q)
    other = Delaunay(
        np.stack([np.concatenate([i_d, i_d, [0.0]]), np.concatenate([i_q, -i_q, [0.0]])], axis=1)
    )
    trial = generator.uniform(-30.0, 30.0, (2, 4000))
    assert np.array_equal(region.contains(*trial), other.find_simplex(trial.T) >= 0)


def test_common_part_of_two_regions() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    disc, box = (
        CurrentRegion.hull(20.0 * np.cos(angle), 20.0 * np.sin(angle)),
        CurrentRegion.rectangle(-30.0, 4.0, 9.0),
    )
    both = disc.within(box)
    trial = np.random.default_rng(5).uniform(-25.0, 25.0, (2, 4000))
    assert np.array_equal(both.contains(*trial), disc.contains(*trial) & box.contains(*trial))


def test_scattered_points_are_known_within_their_hull_alone() -> None:
    generator = np.random.default_rng(11)
    radius, angle = (
        20.0 * np.sqrt(generator.uniform(0.0, 1.0, 400)),
        generator.uniform(0.0, np.pi, 400),
    )
    i_d, i_q = radius * np.cos(angle), radius * np.sin(angle)
    found = build_flux_map(_points(i_d, i_q)).flux_map
    assert not found.inside(np.array([19.0]), np.array([19.0]))[0]
    assert np.all(found.inside(np.array([0.0, -15.0, 3.0]), np.array([0.0, 5.0, -15.0])))


def test_grid_without_a_corner_is_known_within_its_hull() -> None:
    d, q = (
        part.ravel()
        for part in np.meshgrid(
            np.linspace(-40.0, 0.0, 9), np.linspace(0.0, 40.0, 9), indexing="ij"
        )
    )
    kept = np.hypot(d, q) <= 40.0
    found = build_flux_map(_points(d[kept], q[kept])).flux_map
    assert not found.inside(np.array([-38.0]), np.array([38.0]))[0]
    assert found.inside(np.array([-38.0]), np.array([0.0]))[0]


def test_half_plane_covers_both_signs_of_i_q() -> None:
    d, q = (
        part.ravel()
        for part in np.meshgrid(
            np.linspace(-40.0, 0.0, 9), np.linspace(0.0, 40.0, 9), indexing="ij"
        )
    )
    found = build_flux_map(_points(d, q)).flux_map
    assert np.all(found.inside(np.array([-30.0, -30.0]), np.array([35.0, -35.0])))
    assert found.region.covers(0.0)
    assert not found.region.covers(1.0)


def test_maps_at_several_temperatures_keep_what_all_of_them_know() -> None:
    d, q = np.linspace(-40.0, 40.0, 9), np.linspace(-40.0, 40.0, 9)
    psi_d, psi_q = 0.05 + 0.25e-3 * d[:, np.newaxis] + 0.0 * q, 0.0 * d[:, np.newaxis] + 0.6e-3 * q
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    hull = CurrentRegion.hull(30.0 * np.cos(angle), 30.0 * np.sin(angle))
    maps = [FluxMap(d, q, psi_d, psi_q), FluxMap(d, q, psi_d, psi_q, hull=hull)]
    found = flux_map_of_maps(np.array([20.0, 100.0]), maps, 60.0)
    assert found.inside(np.array([25.0]), np.zeros(1))[0]
    assert not found.inside(np.array([35.0]), np.zeros(1))[0]
