"""Steps of the speed loop: those of the loops' own model, and what corners leave out of a cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_speed_loops import RATIOS, SpeedDrive, random_speed_drive
from scipy.linalg import expm

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.certificates.cell_queue import Cell
from dqforge.optimizer.loops.pi_methods import DriveVariants, close_loops, speed_plants
from dqforge.optimizer.speed_box import cell_corners


def modelled(drive: SpeedDrive, parameters: FloatArray, gain: float) -> FloatArray:
    """Largest pole modulus by the plants that tune the loop, at parameters and a gain."""
    b, c, j, e = parameters.T
    (r_s, inductance, t_s), (inertia, friction, filter_time) = drive.winding, drive.mechanics
    plants = speed_plants(
        DriveVariants(
            r_s=c / b * gain * r_s,
            l_q=gain / b * inductance,
            inertia=inertia / j,
            gain=np.full(len(b), gain),
            torque_factor=np.ones(len(b)),
            back_emf=e * gain * drive.constant,
        ),
        friction,
        t_s,
        drive.current,
        drive.loop.ratio,
        filter_time,
    )
    return close_loops(plants, *drive.speed).radius


@pytest.mark.parametrize("ratio", RATIOS)
def test_poles_are_those_of_the_two_rate_model(ratio: int) -> None:
    """Whatever gain the same four parameters come from."""
    generator = np.random.default_rng(ratio)
    for _ in range(3):
        drive = random_speed_drive(generator, ratio)
        parameters = drive.box.samples(20, generator)
        for gain in (0.8, 1.2):
            assert drive.radii(parameters) == pytest.approx(
                modelled(drive, parameters, gain), abs=1e-12
            )


def cells(generator: np.random.Generator, root: Cell, count: int) -> list[Cell]:
    found = []
    for _ in range(count):
        ends = generator.uniform(root.low, root.high, (2, root.low.size))
        width = 10.0 ** generator.uniform(-1.5, 0.0)
        middle, half = ends.mean(axis=0), 0.5 * width * np.abs(ends[1] - ends[0])
        found.append(Cell(middle - half, middle + half))
    return found


def test_corners_err_by_no_more_than_is_left_out() -> None:
    """Random points of random cells, entry by entry: exact exponential against interpolated
    corners. The bound is also reached to nine tenths somewhere, so that it is no looser than need.
    """
    generator, largest = np.random.default_rng(7), 0.0
    for drive in [random_speed_drive(generator) for _ in range(12)]:
        for cell in cells(generator, drive.box.root(), 20):
            corners = drive.loop.drive(cell_corners(cell))
            bound = np.sum(drive.loop.left_out(cell), axis=0)
            for share in (np.full(4, 0.5), *generator.uniform(size=(5, 4))):
                point = cell.low + share * cell.width
                weights = np.ones(1)
                for part in share:
                    weights = np.concatenate([weights * (1.0 - part), weights * part])
                weights = weights.reshape((2,) * 4).transpose(3, 2, 1, 0).reshape(-1)
                exact = drive.loop.drive(point[np.newaxis])[0]
                error = np.abs(exact - np.tensordot(weights, corners, 1))
                assert np.all(error <= bound + 1e-14)
                large = bound > 1e-8
                largest = max(largest, float(np.max(error[large] / bound[large], initial=0.0)))
    assert largest > 0.9


def test_friction_that_does_not_follow_the_torque_is_left_out() -> None:
    """Of the speed, and as much as it changes the exponential."""
    drive = random_speed_drive(np.random.default_rng(2), 5)
    cell = drive.box.root()
    uneven = replace(drive.loop, friction=0.01, uneven=0.1)
    rest = uneven.left_out(cell)[-1]
    assert not drive.loop.left_out(cell)[-1].any()
    assert 0.98 * 0.01 * 0.1 * 1.3 <= rest[1, 1] <= 1.05 * 0.01 * 0.1 * 1.3
    point = cell.high[np.newaxis]
    other = uneven.flow(point)
    other[0, 1, 1] -= 0.01 * 0.1 * 1.3
    error = np.abs(expm(other) - expm(uneven.flow(point)))[0, :2]
    columns = [0, 1, rest.shape[1] - 1]
    assert np.all(error <= rest[:2, columns] + 1e-15)
