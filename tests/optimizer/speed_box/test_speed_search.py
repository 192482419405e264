"""Speed loops proven over their boxes: what is proven holds, what is not stable is not proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_speed_loops import SpeedDrive, random_speed_drive

from dqforge.optimizer.certificates.cell_queue import Proven, Tree, contracts
from dqforge.optimizer.speed_box import Chain, Effort, SpeedLoopNumbers, SpeedSearch


def searched(drive: SpeedDrive, cells: int, **changed: float) -> Tree[Chain]:
    loop = replace(drive.loop, **changed) if changed else drive.loop  # type: ignore[arg-type]
    return SpeedSearch(loop, drive.box, Effort(cells)).run()


def test_stable_loops_are_proven() -> None:
    """Of the first of the twenty below those that are quick; no drive of theirs is unstable."""
    generator = np.random.default_rng(5)
    for drive in [random_speed_drive(generator) for _ in range(7)]:
        if drive.loop.ratio > 5 or drive.loop.rho > 0.1:
            continue  # among the slow ones
        tree = searched(drive, 60)
        assert tree.complete
        assert np.max(drive.radii(drive.box.samples(2000, np.random.default_rng(1)))) < 1.0


@pytest.mark.slow
def test_of_twenty_random_loops_eighteen_are_proven() -> None:
    """With one to twenty current samples per speed sample, filtered or not."""
    generator = np.random.default_rng(5)
    trees = [searched(random_speed_drive(generator), 60) for _ in range(20)]
    assert sum(tree.complete for tree in trees) >= 18
    assert np.median([tree.examined for tree in trees]) <= 5


def hasty(drive: SpeedDrive, factor: float) -> SpeedLoopNumbers:
    """The loop with both gains of the speed controller times a factor."""
    return replace(drive.loop, scale=drive.loop.scale * factor)


def limit(drive: SpeedDrive) -> float:
    """Factor on the speed controller's gains at which a corner of the box becomes unstable."""
    from random_speed_loops import corners_of

    corners = corners_of(drive.box)
    low, high = 1.0, 100.0
    for _ in range(40):
        middle = np.sqrt(low * high)
        worst = np.max(replace(drive, loop=hasty(drive, float(middle))).radii(corners))
        low, high = (middle, high) if worst < 1.0 else (low, middle)
    return float(low)


@pytest.mark.parametrize("seed", [9, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_gains_beyond_the_limit_are_never_proven(seed: int) -> None:
    """0.3 % beyond what a corner of the box bears; the search ends with a drive, or open."""
    generator = np.random.default_rng(seed)
    for _ in range(2):
        drive = random_speed_drive(generator, 1)
        wild = replace(drive, loop=hasty(drive, 1.003 * limit(drive)))
        tree = SpeedSearch(wild.loop, wild.box, Effort(16)).run()
        assert not tree.complete
        if tree.counterexample is not None:
            assert np.max(wild.radii(tree.counterexample[np.newaxis])) >= 1.0


def test_a_drive_far_beyond_is_a_counterexample() -> None:
    drive = random_speed_drive(np.random.default_rng(4), 5)
    wild = replace(drive, loop=hasty(drive, 3.0 * limit(drive)))
    tree = SpeedSearch(wild.loop, wild.box, Effort(20)).run()
    assert tree.counterexample is not None
    assert np.max(wild.radii(tree.counterexample[np.newaxis])) >= 1.0


def test_certificates_of_another_loop_do_not_serve() -> None:
    """The chain of a cell refuses a speed controller of the wrong sign and one delay too few."""
    drive = random_speed_drive(np.random.default_rng(12), 1)
    tree = searched(drive, 40)
    chains = [node.verdict.payload for node in tree.nodes if isinstance(node.verdict, Proven)]
    assert chains
    step = drive.loop.steps(drive.box.samples(1, np.random.default_rng(1)))
    update = drive.loop.update()
    turned = update.copy()
    turned[-2:, drive.loop.moving - 1] *= -1.0
    for chain in chains:
        assert contracts(chain[0], chain[1], update[np.newaxis]).whole
        assert not contracts(chain[0], chain[1], turned[np.newaxis]).whole
    keep = np.delete(np.arange(drive.loop.size), drive.loop.size - 2)
    assert any(contracts(chain[1], chain[0], step[:, keep]).whole for chain in chains)
    assert not any(contracts(chain[1], chain[0], 1.2 * step[:, keep]).whole for chain in chains)
