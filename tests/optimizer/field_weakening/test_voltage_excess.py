"""The bound of the voltage on a box against the voltage of every drive that the box stands for."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, Taken, voltage_excess

R, V, P, I_MAX, MOST = 0.4, 60.0, 3, 30.0, 12.0
K = 1.0 / (1.5 * P)
LEAST = LEAST_VOLTAGE * V


def region(r_s: float = R) -> Any:
    machine = SimpleNamespace(r_s=r_s, pole_pairs=P)
    return SimpleNamespace(
        machine=machine, v_max=V, flux=SimpleNamespace(i_max=I_MAX, torque_max=MOST)
    )


def bounds(rows: FloatArray, reserve: float, near: tuple[float, float] | None = None) -> FloatArray:
    """Rows: torques and available flux linkages from and to, more, less, flux and current."""
    step: Any = SimpleNamespace(reserve=reserve * R**2, near=near)
    t_low, t_high, a_low, a_high, more, less, flux, current = np.asarray(rows, dtype=float).T
    return voltage_excess(
        region(), step, Taken(t_low, t_high, a_low, a_high, more, less, flux, current)
    )


def taken_voltage(
    t: float, a: float, side: float, error: float, flux: float, current: float, square: float
) -> float:
    """The largest |v|^2/V^2 - 1 over the voltages from the least one on; of the torque t + error,
    a flux linkage beyond the available one, and a squared current where ``square`` was taken."""
    found = -math.inf
    for volts in np.geomspace(LEAST, 40.0 * V, 400):
        # omega^2 a^2 + 2 R omega side K t + R^2 square = V^2
        half = R * side * K * t / a**2
        omega = -half + math.sqrt(half**2 + (volts**2 - R**2 * square) / a**2)
        v = omega**2 * a**2 * (1.0 + flux) + 2.0 * R * omega * side * K * (t + error)
        found = max(found, (v + R**2 * current) / volts**2 - 1.0)
    return found


def test_the_bound_holds_and_is_not_idle() -> None:
    """Single points: motoring with as much torque too much, generating with as much too little as
    is permitted, with more current than was taken and with less."""
    generator = np.random.default_rng(3)
    rows, shown = [], []
    for _ in range(60):
        t, a = generator.uniform(0.5, MOST), generator.uniform(0.15, 0.3)
        more, less = generator.uniform(0.0, 0.2, 2) * (1.0, 0.7)
        flux = generator.uniform(0.001, 0.02)
        current = 500.0 + generator.uniform(-100.0, 200.0)
        rows.append([t, t, a, a, more, less, flux, current])
        shown.append(
            [
                taken_voltage(t, a, 1.0, more, flux, current, 500.0),
                taken_voltage(t, a, -1.0, -less, flux, current, 500.0),
            ]
        )
    found = bounds(np.array(rows), 500.0)
    worst = np.max(shown, axis=1)
    assert np.all(worst <= found + 1e-9)
    close = worst / found
    assert np.median(close) > 0.6
    assert np.max(close) > 0.9


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_either_direction_meets_its_bound_where_the_current_is_the_least(side: float) -> None:
    """Of the torque too much motoring, too little generating: but for what is left out of the
    squares, within some percent."""
    generator = np.random.default_rng(5)
    for _ in range(25):
        t, a = generator.uniform(8.0, MOST), generator.uniform(0.13, 0.2)
        error, square = generator.uniform(0.1, 0.4), (K * t / a) ** 2
        sides = (error, 0.0) if side > 0.0 else (0.0, error)
        # what counts for both is left to generating, which it raises more
        flux, current = (0.0, square) if side > 0.0 else (0.002, square + 60.0)
        found = bounds(np.array([[t, t, a, a, *sides, flux, current]]), square)[0]
        shown = taken_voltage(t, a, side, side * error, flux, current, square)
        assert 0.93 * found < shown <= found


def test_wide_boxes_are_no_less_than_the_points_in_them() -> None:
    wide = np.array([[2.0, 5.0, 0.1, 0.15, 0.1, 0.08, 0.01, 600.0]])
    whole = bounds(wide, 500.0)[0]
    for t in np.linspace(2.0, 5.0, 7):
        for a in np.linspace(0.1, 0.15, 6):
            point = bounds(np.array([[t, t, a, a, 0.1, 0.08, 0.01, 600.0]]), 500.0)[0]
            assert point <= whole
            assert taken_voltage(t, a, 1.0, 0.1, 0.01, 600.0, 500.0) <= whole
            assert taken_voltage(t, a, -1.0, -0.08, 0.01, 600.0, 500.0) <= whole


def test_what_the_second_bound_of_the_current_takes_counts() -> None:
    """Where it falls below the first: so many A^2 that rise with the squared flux linkage."""
    row = np.array([[3.0, 3.0, 0.1, 0.12, 0.0, 0.0, 0.0, 600.0]])
    constant, slope = 300.0 * R**2, 8000.0 * R**2  # 380 A^2 at 0.1 Wb
    assert bounds(row, 500.0, (constant, slope)) == pytest.approx(bounds(row, 380.0), rel=1e-9)
    assert bounds(row, 350.0, (constant, slope)) == pytest.approx(bounds(row, 350.0), rel=1e-9)
    assert bounds(row, 380.0)[0] > bounds(row, 500.0)[0] > 0.0


def test_a_drop_of_more_than_four_times_the_squared_voltage_is_not_bounded() -> None:
    """Generating, 2 R omega k t over the squared voltage that is left beside the least current of
    the torque; by the speed at which the least voltage just has it."""
    a, shares, known = 0.05, [], []
    for t in np.geomspace(4.0, 9e3, 300):
        q = K * t / a
        turned = R * (math.sqrt(q**2 + (LEAST / R) ** 2 - 1.02 * I_MAX**2) + q)  # omega a
        drop = 2.0 * R * turned * q
        least = max(0.98 * q - 0.01 * K * MOST / a, 0.0)
        left = turned**2 - drop + (R * least) ** 2
        shares.append(drop / left if left > 0.0 else math.inf)
        known.append(np.isfinite(bounds(np.array([[t, t, a, a, 0, 0, 0, 0]]), 1.0)[0]))
    assert 3.0 < max(share for share, fine in zip(shares, known, strict=True) if fine) <= 4.0
    np.testing.assert_array_equal(known, np.array(shares) <= 4.0)
    assert 20 < sum(known) < 290


def test_without_resistance_the_flux_linkage_is_the_voltage() -> None:
    step: Any = SimpleNamespace(reserve=0.0, near=None)
    flux = np.array([0.01, -0.2])
    zero = np.ones(2)
    found = voltage_excess(region(0.0), step, Taken(zero, zero, zero, zero, zero, zero, flux, zero))
    np.testing.assert_array_equal(found, flux)
