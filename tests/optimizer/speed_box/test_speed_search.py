"""Speed loops proven over their boxes: what is proven holds, what is not stable is not proven."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_speed_loops import SpeedDrive, random_speed_drive
from scipy.linalg import expm, solve_discrete_lyapunov

from dqforge.optimizer.certificates.cell_queue import Cell, Cut, Open, Proven, Tree, contracts
from dqforge.optimizer.speed_box import (
    Chain,
    Effort,
    SpeedLoopNumbers,
    SpeedSearch,
    _falls,
    _Links,
    _nested,
    _proposed,
    _summed,
    _weighed,
    cell_corners,
    speed_scale,
)


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


def loop_of(seed: int, ratio: int) -> tuple[SpeedDrive, SpeedSearch]:
    drive = random_speed_drive(np.random.default_rng(seed), ratio)
    return drive, SpeedSearch(drive.loop, drive.box, Effort(20))


@pytest.mark.parametrize("ratio", [1, 3])
def test_matrices_of_the_middle_fall_by_one_at_every_step(ratio: int) -> None:
    """Solved by numpy alone: the first belongs to the whole cycle; the update and all samples."""
    drive, hunt = loop_of(3, ratio)
    root = drive.box.root()
    step = drive.loop.steps(root.middle[np.newaxis])[0]
    keep = np.delete(np.arange(drive.loop.size), drive.loop.size - 2)
    closed = [drive.loop.update(), *[step] * (ratio - 1), step[keep]]
    whole = closed[0]
    for one in closed[1:]:
        whole = one @ whole
    np.testing.assert_allclose(drive.loop.cycle(step), whole, atol=1e-12)
    frames = hunt._frames(root)
    assert frames is not None
    matrices = [frame.T @ frame for frame in frames]
    for before, after, one in zip(matrices, [*matrices[1:], matrices[0]], closed, strict=True):
        fall = before - one.T @ after @ one
        np.testing.assert_allclose(
            fall, np.eye(len(fall)), atol=1e-8 * float(np.linalg.norm(before))
        )
    weight = np.diag([1.0, 2.0, 0.5])
    a = np.array([[0.5, 0.4, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.3, -0.6]])
    np.testing.assert_allclose(_summed(a, weight), solve_discrete_lyapunov(a.T, weight))
    with pytest.raises(np.linalg.LinAlgError):
        _summed(a / np.max(np.abs(np.linalg.eigvals(a))), weight)


def test_a_cell_is_cut_across_what_counts_most_in_its_frame_until_it_is_narrow() -> None:
    drive, hunt = loop_of(3, 2)
    root = drive.box.root()
    frames = hunt._frames(root)
    assert frames is not None
    back = np.linalg.inv(frames[0])
    for axis, found in enumerate(hunt._reach(root, frames)):
        ends = np.stack([root.middle, root.middle])
        ends[:, axis] = root.low[axis], root.high[axis]
        low, high = (drive.loop.cycle(step) for step in drive.loop.steps(ends))
        size = float(np.linalg.svd(frames[0] @ (high - low) @ back, compute_uv=False)[0])
        assert found == pytest.approx(size, rel=1e-9)
    parts = np.random.default_rng(1).uniform(size=(4, 2, 3))
    inverse = np.linalg.inv(frames[1])
    for part, found in zip(parts, _weighed(parts, frames[1]), strict=True):
        wanted = sum(
            part[r, c] * np.linalg.norm(frames[1][:, r]) * np.linalg.norm(inverse[c])
            for r in range(2)
            for c in range(3)
        )
        assert found == pytest.approx(wanted)
    sizes = np.array([1.0, 3.0, 2.0, 4.0])
    thin = Cell(root.low, root.low + np.array([1.0, 1.0, 1.0, 0.0]) * root.width)
    cut = hunt._cut(thin, sizes)
    assert isinstance(cut, Cut)
    assert (cut.axis, cut.value) == (1, thin.middle[1])
    for share, kind in ((0.9e-6, Open), (1.1e-6, Cut)):
        narrow = Cell(root.middle, root.middle + share * root.width)
        assert isinstance(hunt._cut(narrow, sizes), kind)


def test_a_chain_is_proposed_that_falls_at_all_corners_and_none_where_a_drive_is_unstable() -> None:
    drive, hunt = loop_of(3, 2)
    root = drive.box.root()
    half = np.array([0.01, 0.01, 0.0, 0.0]) * root.width
    cell = Cell(root.middle - half, root.middle + half)
    frames = hunt._frames(cell)
    assert frames is not None
    corners = drive.loop.steps(cell_corners(cell))
    links = _Links(drive.loop.update()[np.newaxis], corners, 2)
    chain = _proposed(links, frames)
    assert chain is not None
    for a, b, closed in links.every():
        for step in closed:
            assert np.linalg.eigvalsh(chain[a] - step.T @ chain[b] @ step).min() > 0.0
    wild = _Links(links.update, 1.5 * corners, 2)
    found = _proposed(wild, frames)
    nothing = np.zeros((drive.loop.moving, drive.loop.moving + 1))
    assert _falls(chain, links, nothing).whole
    assert found is None or not _falls(found, wild, nothing).corners


def test_nested_integrals_are_derivatives_of_the_exponential() -> None:
    rng = np.random.default_rng(2)
    m, s = rng.normal(size=(2, 3, 3))
    step = 1e-3
    ahead, here, behind = (expm(m + sign * step * s) for sign in (1.0, 0.0, -1.0))
    first, second = (ahead - behind) / (2.0 * step), (ahead - 2.0 * here + behind) / step**2
    np.testing.assert_allclose(_nested(m, s, 1), first, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(_nested(m, s, 2), 0.5 * second, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("h", "emf"), [(0.5, 0.3), (0.004, 0.01), (3.0, 1e-6)])
def test_the_scale_of_the_speed_keeps_its_rise_above_its_emf_and_a_tenth(
    h: float, emf: float
) -> None:
    scale = speed_scale(h, emf)
    rise, back = h / scale, emf * scale
    assert rise == pytest.approx(max(0.1, back))
