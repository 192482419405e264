"""Microseconds per point of a flux map: the flux linkages alone, and with all their derivatives."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, complete_by_symmetry

pytestmark = pytest.mark.benchmark


def _best(call: Callable[[FloatArray, FloatArray], object], d: FloatArray, q: FloatArray) -> float:
    """Shortest of several runs, in microseconds per point."""
    seconds = []
    for _ in range(7):
        start = time.perf_counter()
        call(d, q)
        seconds.append(time.perf_counter() - start)
    return 1e6 * min(seconds) / d.size


def test_time_per_point(shared_data: Path) -> None:
    measured = np.load(shared_data / "fluxmaps" / "baldor_400rpm_map.npz")
    current, psi = measured["i_s_dq"], measured["psi_s_dq"]
    small = FluxMap(current.real[:, 0], *complete_by_symmetry(current.imag[0], psi.real, psi.imag))
    computed = np.load(shared_data / "fluxmaps" / "thor_dq_256.npz")
    large = FluxMap(computed["id"], computed["iq"], computed["psi_d"].T, computed["psi_q"].T)
    uneven = FluxMap(small.i_d + 1e-3 * np.sin(small.i_d), small.i_q, small.psi_d, small.psi_q)
    generator = np.random.default_rng(0)
    for name, flux_map in (("21 x 27", small), ("21 x 27, uneven", uneven), ("256 x 256", large)):
        for count in (100, 10_000, 1_000_000):
            d = generator.uniform(flux_map.i_d[0], flux_map.i_d[-1], count)
            q = generator.uniform(flux_map.i_q[0], flux_map.i_q[-1], count)
            jet, flux = _best(flux_map.jet, d, q), _best(flux_map.flux, d, q)
            print(
                "\n"
                f"{name}, {count:,} points: jet {jet:.3f} us/point, flux alone {flux:.3f} us/point",
                end="",
            )
