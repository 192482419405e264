"""Cells of one axis's box: no drive is lost when they are cut, and what is left is enclosed."""

from __future__ import annotations

import numpy as np
from flint import fmpq

from dqforge.optimizer.axis_margins import AxisBox, Cell, Interval, rational

BOX = AxisBox(
    rho=fmpq(1, 20),
    resistance=(fmpq(7, 10), fmpq(8, 5)),
    inductance=(fmpq(7, 10), fmpq(13, 10)),
    gain=(fmpq(4, 5), fmpq(6, 5)),
    dead_time=(fmpq(-9, 10), fmpq(-4, 5)),
)


def inside(interval: Interval, value: float) -> bool:
    return bool(interval[0] <= rational(value) <= interval[1])


def cut_up(depth: int) -> list[Cell]:
    cells = [BOX.root()]
    for turn in range(depth):
        halves = [half for cell in cells for half in cell.halves("bs"[turn % 2])]
        cells = [kept for half in halves if (kept := BOX.contracted(half)) is not None]
    return cells


def test_every_drive_stays_in_a_cell_and_its_plant_is_enclosed() -> None:
    cells, generator = cut_up(7), np.random.default_rng(5)
    assert 2**5 < len(cells) <= 2**7
    sides = [[float(end) for end in interval] for interval in (BOX.resistance, BOX.inductance)]
    for _ in range(300):
        (r, inductance), g = generator.uniform(*np.transpose(sides)), generator.uniform(0.8, 1.2)
        b, s = g / inductance, r / g + generator.uniform(-0.9, -0.8)
        holding = [cell for cell in cells if inside(cell.b, b) and inside(cell.s, s)]
        assert holding
        rho = float(BOX.rho) * b * s
        for cell in holding:
            a, gamma = BOX.sampled(cell.b, cell.s)
            assert float(a[0]) <= np.exp(-rho) <= float(a[1])
            assert float(gamma[0]) <= -b * np.expm1(-rho) / rho <= float(gamma[1])


def test_a_drive_of_a_cell_is_one_of_the_box() -> None:
    for cell in cut_up(6):
        drive = BOX.drive(cell, (1.0, 0.0))
        assert drive is not None
        b, s = drive
        gains = np.linspace(0.8, 1.2, 20_001)
        of_b = (gains / float(b) >= 0.7 - 1e-9) & (gains / float(b) <= 1.3 + 1e-9)
        low, high = 0.7 / gains - 0.9, 1.6 / gains - 0.8
        assert np.any(of_b & (low <= float(s) + 1e-4) & (float(s) - 1e-4 <= high))


def test_a_cell_without_a_drive_is_dropped() -> None:
    corner = Cell((fmpq(-1), fmpq(1)), (fmpq(85, 50), fmpq(17, 10)), (fmpq(2), fmpq(21, 10)))
    assert BOX.contracted(corner) is None
