"""Steps of the speed loop: those of the loops' own model, and what corners leave out of a cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_speed_loops import RATIOS, SpeedDrive, random_speed_drive
from scipy.linalg import expm

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.box_proofs.cell_queue import Cell
from dqforge.optimizer.loops.loop_batch import DriveVariants, close_loops, speed_plants
from dqforge.optimizer.speed_box.speed_steps import cell_corners


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


def test_corners_err_by_no_more_than_the_remainder() -> None:
    """Random points of random cells: exact exponential against interpolated corners. The bound is
    also reached to two thirds somewhere, so that it is no looser than it need be.
    """
    generator, largest = np.random.default_rng(7), 0.0
    for drive in [random_speed_drive(generator) for _ in range(12)]:
        k = drive.loop.moving
        for cell in cells(generator, drive.box.root(), 20):
            corners = expm(drive.loop.flow(cell_corners(cell)))[:, :k]
            (_, e_phi), (_, e_gamma) = drive.loop.remainder(cell)[0].groups
            for share in (np.full(4, 0.5), *generator.uniform(size=(5, 4))):
                point = cell.low + share * cell.width
                weights = np.ones(1)
                for part in share:
                    weights = np.concatenate([weights * (1.0 - part), weights * part])
                weights = weights.reshape((2,) * 4).transpose(3, 2, 1, 0).reshape(-1)
                exact = expm(drive.loop.flow(point[np.newaxis]))[0, :k]
                error = exact - np.tensordot(weights, corners, 1)
                assert np.linalg.norm(error[:, :k], 2) <= e_phi + 1e-14
                assert np.linalg.norm(error[:, k]) <= e_gamma + 1e-14
                largest = max(largest, float(np.linalg.norm(error[:, :k], 2)) / e_phi)
    assert largest > 0.66


def test_friction_that_does_not_follow_the_torque_is_part_of_the_remainder() -> None:
    drive = random_speed_drive(np.random.default_rng(2), 5)
    cell = drive.box.root()
    plain = drive.loop.remainder(cell)[0].groups[0][1]
    uneven = replace(drive.loop, friction=0.01, uneven=0.1)
    without = replace(drive.loop, friction=0.01)
    more = uneven.remainder(cell)[0].groups[0][1] - without.remainder(cell)[0].groups[0][1]
    assert 0.01 * 0.1 * 1.3 <= more <= 0.01 * 0.1 * 1.3 * 1.2
    assert plain > 0.0
