"""Sensitivity of both axes together: found by brute force, bounded, and not by much more."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from random_current_loops import drives_inside, random_boxes

from dqforge.optimizer.certificates.both_axes_sensitivity import (
    SensitivitySearch,
    _best_start,
    _bounded_real,
    _Known,
    _parts,
    _stable,
    bordered,
    bound_sensitivity,
    extended,
    sensitivities,
)
from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    Cell,
    CurrentLoopBox,
    Cut,
    Open,
    find_certificate,
    loop_matrices,
    lyapunov_frame,
    parameters_of,
    root_cell,
)
from dqforge.optimizer.certificates.current_loop_proof import (
    confirm_sensitivity,
    plain_certificate,
    plain_inputs,
)
from dqforge.optimizer.certificates.matrix_inequalities import Blocks, Budget
from dqforge.optimizer.loops.plants import current_loop
from dqforge.optimizer.sampled_systems import loop_margins


def stable_boxes(count: int, seed: int) -> list[CurrentLoopBox]:
    boxes = random_boxes(5 * count, seed, fast=True)
    return [box for box in boxes if find_certificate(box).complete][:count]


@cache
def stable_pair() -> list[CurrentLoopBox]:
    return stable_boxes(2, 1)


@cache
def bounded(number: int) -> tuple[CurrentLoopBox, SensitivitySearch]:
    box = stable_pair()[number]
    return box, bound_sensitivity(box, 400, 10**6)  # more work than a command spends on it


NUMBERS = pytest.mark.parametrize("number", [0, pytest.param(1, marks=pytest.mark.slow)])


def points_inside(box: CurrentLoopBox, count: int) -> np.ndarray:
    rows = drives_inside(box, np.random.default_rng(2), count)
    points = np.array([parameters_of(box, BoxDrive(*row)) for row in rows])
    points[:, 3] = np.abs(points[:, 3])
    return points


def test_at_rest_it_is_the_larger_of_both_axes() -> None:
    box = replace(stable_boxes(1, 1)[0], omega_e=0.0)
    nominal = [0.5 * (low + high) for low, high in (box.r_s, box.l_d, box.l_q)]
    drive = BoxDrive(nominal[0], nominal[1], nominal[2], 1.0, 0.0)
    found = sensitivities(box, parameters_of(box, drive)[None])[0]
    alone = []
    for k in range(2):
        ki = box.ki_ts[k] / box.t_s
        loop = current_loop(nominal[0], nominal[1 + k], box.t_s, box.kp[k], ki)
        alone.append(loop_margins(loop.open_loop).max_sensitivity)
    assert found == pytest.approx(max(alone), rel=2e-3)


def test_a_cell_is_stable_where_its_middle_is() -> None:
    """Gains raised step by step, past the bound and a little beyond."""
    box, found = stable_pair()[0], []
    for factor in np.geomspace(1.0, 30.0, 60):
        faster = replace(box, kp=tuple(factor * kp for kp in box.kp))
        cell = root_cell(faster)
        loop = loop_matrices(faster, cell.middle[None])[0]
        radius = float(np.max(np.abs(np.linalg.eigvals(loop))))
        assert _stable(faster, cell) == (radius < 1.0)
        found.append(radius)
    assert min(found) < 1.0
    assert any(1.0 < radius < 1.2 for radius in found)


@NUMBERS
def test_turned_voltages_stay_stable_up_to_the_angle_of_the_bound(number: int) -> None:
    """Voltages of every drive turned by 2 asin(1/(2 M)) either way; well beyond it some are not."""
    box, found = bounded(number)
    assert np.isfinite(found.bound)
    at = parameters_of(box, found.at)
    points = np.vstack([points_inside(box, 100), at])
    matrices = loop_matrices(box, points)
    most = 2.0 * np.arcsin(0.5 / found.bound)
    worst: dict[float, float] = {}
    for share in (1.0, 3.0):
        for sign in (-1.0, 1.0):
            angle = sign * share * most
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            turned = matrices.copy()
            turned[:, :2, 2:4] = matrices[:, :2, 2:4] @ turn
            radius = float(np.abs(np.linalg.eigvals(turned)).max())
            worst[share] = max(worst.get(share, 0.0), radius)
    assert worst[1.0] < 1.0
    assert worst[3.0] > 1.0


def test_only_matrices_that_bound_the_middle_are_proposed() -> None:
    """[A B; C 1]^T diag(P, 1) [A B; C 1] < diag(P, M^2 1) with M twice the value at all
    frequencies, of the first P that is asked about."""
    box = stable_pair()[0]
    middle = np.mean(points_inside(box, 20), axis=0)[None]
    square = (2.0 * float(sensitivities(box, middle)[0])) ** 2
    closed = loop_matrices(box, middle)
    asked: list[np.ndarray] = []

    def taken(matrix: np.ndarray) -> bool:
        asked.append(matrix)
        return True

    frame = lyapunov_frame(closed[0])
    assert frame is not None
    _bounded_real(extended(closed), frame, square, taken, Budget(10**6))
    before, after = np.diag([0.0] * 6 + [square] * 2), np.diag([0.0] * 6 + [1.0] * 2)
    before[:6, :6] = after[:6, :6] = asked[0]
    whole = extended(closed)[0]
    assert np.linalg.eigvalsh(asked[0]).min() > 0.0
    assert np.linalg.eigvalsh(before - whole.T @ after @ whole).min() > 0.0


@NUMBERS
def test_the_bound_holds_is_within_a_tenth_and_is_confirmed(number: int) -> None:
    box, found = bounded(number)
    assert found.found < found.bound <= 1.1 * found.found
    assert sensitivities(box, points_inside(box, 200)).max() < found.bound
    certificate = plain_certificate(box, found.tree)
    assert confirm_sensitivity(certificate, plain_inputs(box), found.bound).proven
    # below the largest value found no certificate can hold
    refused = confirm_sensitivity(certificate, plain_inputs(box), 0.999 * found.found)
    assert "does not prove" in refused.fault


@pytest.mark.slow
def test_ten_drives_are_bounded_within_a_tenth() -> None:
    bounded_ones = 0
    for box in stable_boxes(12, 21):
        found = bound_sensitivity(box, 400, 10**6)
        if found.found > 50.0:  # within some 0.1 % of the border of stability
            continue
        assert found.found < found.bound <= 1.1 * found.found
        certificate = plain_certificate(box, found.tree)
        assert confirm_sensitivity(certificate, plain_inputs(box), found.bound).proven
        bounded_ones += 1
    assert bounded_ones >= 10


@pytest.mark.parametrize(("share", "verdict"), [(9e-6, Open), (11e-6, Cut)])
def test_a_cell_without_a_bound_is_left_open_where_it_is_too_narrow(
    share: float, verdict: type[object]
) -> None:
    """The share is of the box, whatever the units of its sides."""
    box = random_boxes(1, 5, fast=False)[0]
    known, root = _Known(box, Budget(1000)), root_cell(box)
    known.asked = 0.2  # below what any loop has
    half = 0.5 * share * root.width
    found = known.verdict(Cell(root.middle - half, root.middle + half))
    assert isinstance(found, verdict)


def test_found_values_are_the_largest_of_a_dense_grid() -> None:
    """Singular values of S = 1 + C (e^jw 1 - A)^-1 B by numpy at a thousand frequencies."""
    for box in stable_pair():
        points = points_inside(box, 3)
        found = sensitivities(box, points)
        for matrix, value in zip(loop_matrices(box, points), found, strict=True):
            inner = np.exp(1j * np.geomspace(1e-3, np.pi, 1000))[:, None, None] * np.eye(6) - matrix
            into = np.eye(6)[:, 2:4]
            whole = np.eye(2) + matrix[2:4] @ np.linalg.solve(inner, into[None].repeat(1000, 0))
            dense = float(np.linalg.svd(whole, compute_uv=False)[:, 0].max())
            assert value == pytest.approx(dense, rel=1e-4)


def test_a_climb_starts_at_the_best_multiple_of_the_unit_below_what_it_has() -> None:
    box = stable_pair()[0]
    middle = np.mean(points_inside(box, 20), axis=0)[None]
    closed = loop_matrices(box, middle)
    frame = lyapunov_frame(closed[0])
    assert frame is not None
    turn = bordered(frame, 1.0)
    back = np.linalg.inv(turn)
    seen, parts = turn @ extended(closed) @ back, _parts()
    ends = np.diag([0.0] * 6 + [1.0] * 2)
    turned = np.swapaxes(seen, 1, 2)
    slopes_of = np.concatenate(
        [parts - turned[:, None] @ parts @ seen[:, None], -(back.T @ back)[None, None]], axis=1
    )
    blocks = Blocks(9.0 * ends - turned @ ends @ seen, slopes_of)
    start = _best_start(blocks, turn)

    def least(scale: float) -> float:
        """The largest t with P = scale 1."""
        p = np.diag([scale] * 6 + [0.0] * 2)
        own = 9.0 * ends - turned[0] @ ends @ seen[0] + p - turned[0] @ p @ seen[0]
        return float(np.linalg.eigvalsh(turn.T @ own @ turn).min())

    inner = np.einsum("n,nij->ij", start[:-1], parts)
    scale = inner[0, 0]
    np.testing.assert_array_equal(inner, np.diag([scale] * 6 + [0.0] * 2))
    best = least(scale)
    assert best == pytest.approx(max(map(least, 4.0 ** np.arange(-8, 12))), abs=1e-12)
    assert start[-1] == pytest.approx(best - 0.3 * abs(best) - 0.05, rel=1e-9)
