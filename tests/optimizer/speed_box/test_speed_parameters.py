"""The box of the speed loop: no drive is lost when cells are cut to what drives can reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import Tolerances
from dqforge.optimizer.certificates.cell_queue import Cell
from dqforge.optimizer.loops.robustness import DriveBox
from dqforge.optimizer.speed_box import SpeedBox, speed_box

BOX = SpeedBox(
    resistance=(0.7, 1.6),
    inductance=(0.7, 1.3),
    gain=(0.8, 1.2),
    dead_time=(-0.9, 0.2),
    torque=(0.9, 1.1),
    inertia=(0.7, 1.3),
    back_emf=(-0.02, 0.05),
)


def cut_up(box: SpeedBox, depth: int) -> list[Cell]:
    cells = [box.root()]
    for turn in range(depth):
        axis = (0, 1, 3)[turn % 3]
        halves = [half for cell in cells for half in cell.halves(axis, float(cell.middle[axis]))]
        cells = [kept for half in halves if (kept := box.contracted(half)) is not None]
    return cells


NARROW = replace(BOX, dead_time=(-0.1, 0.1))


@pytest.mark.parametrize("box", [BOX, NARROW])
def test_every_drive_stays_in_a_cell(box: SpeedBox) -> None:
    cells = cut_up(box, 9)
    volume = [float(np.prod(cell.width)) for cell in (*cells, box.root())]
    assert sum(volume[:-1]) < 0.97 * volume[-1]
    points = box.samples(3000, np.random.default_rng(3))
    held = np.zeros(len(points), dtype=np.bool_)
    for cell in cells:
        held |= np.all((points >= cell.low) & (points <= cell.high), axis=1)
    assert held.all()


def test_what_has_no_tolerance_stays_one_value() -> None:
    fixed = replace(BOX, torque=(1.0, 1.0), inertia=(1.0, 1.0), back_emf=(0.0, 0.0))
    assert fixed.root().width[2:].tolist() == [0.0, 0.0]
    assert fixed.root().width[:2].min() > 0.5


def test_cells_without_a_drive_are_dropped() -> None:
    root = NARROW.root()
    low, high = root.low.copy(), root.high.copy()
    low[0], high[1] = 1.68, 0.75  # the largest b has the least inductance, and so a large c
    assert NARROW.contracted(Cell(low, high)) is None


@pytest.mark.parametrize("seed", range(20))
def test_the_drive_of_a_cell_is_one_of_the_box(seed: int) -> None:
    """Its parameters come from a gain and an inductance of the box."""
    generator = np.random.default_rng(seed)
    cell = cut_up(BOX, 6)[int(generator.integers(20))]
    point = BOX.drive(cell)
    assert point is not None
    b, c, j, e = point
    g = np.linspace(0.8, 1.2, 4001)
    inductance = g / b
    ohm = c * inductance
    fits = (inductance >= 0.7 - 1e-9) & (inductance <= 1.3 + 1e-9)
    fits &= (ohm >= 0.7 - 0.9 * g - 1e-9) & (ohm <= 1.6 + 0.2 * g + 1e-9)
    fits &= (e * g >= -0.02 - 1e-9) & (e * g <= 0.05 + 1e-9)
    assert fits.any()
    assert 0.63 - 1e-9 <= j <= 1.43 + 1e-9


def box_of(tolerances: Tolerances) -> SpeedBox:
    design = catalogue.load("paper001-pmsm-bench")
    machine = design.machine
    return speed_box(DriveBox(design, tolerances, (machine.l_d, machine.l_q)))


def test_a_torque_without_a_tolerance_is_exact() -> None:
    """No share of rounding is added to what is not computed."""
    assert box_of(Tolerances(r_s=0.2)).torque == (1.0, 1.0)


def test_the_torque_of_a_magnet_is_just_held() -> None:
    low, high = box_of(Tolerances(psi_pm=0.1)).torque
    assert 0.9 - 1e-11 < low < 0.9
    assert 1.1 < high < 1.1 + 1e-11


@pytest.mark.parametrize("seed", range(4))
def test_a_drive_is_named_by_deviations_that_have_its_parameters(seed: int) -> None:
    """Dead time in the middle of its range; gain and inductance within theirs."""
    for b, c, j, _ in NARROW.samples(20, np.random.default_rng(seed)):
        named = {
            name: 1.0 + value for name, value in NARROW.named(np.array([b, c, j, 0.01])).items()
        }
        g, inductance = named["v_dc"], named["l_q"]
        assert g / inductance == pytest.approx(b)
        assert named["r_s"] / inductance == pytest.approx(c)  # -0.1 to 0.1 are about nothing
        assert named["torque over inertia"] == pytest.approx(j)
        assert 0.8 - 1e-9 <= g <= 1.2 + 1e-9
        assert 0.7 - 1e-9 <= inductance <= 1.3 + 1e-9
