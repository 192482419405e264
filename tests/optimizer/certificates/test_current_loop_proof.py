"""Drives that are proven, drives that are not, and samples inside what is."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from random_current_loops import (
    corner_drives,
    drives_inside,
    limit,
    radii,
    radius_of,
    random_boxes,
    times,
)
from zero_exclusion import excludes_zero

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.certificates import matrix_inequalities
from dqforge.optimizer.certificates.cell_queue import (
    CELL_WORK,
    WORK,
    CurrentLoopBox,
    drive_at,
    find_certificate,
    parameters_of,
)
from dqforge.optimizer.certificates.current_loop_proof import (
    CurrentLoopProof,
    _rests,
    confirm,
    plain_certificate,
    plain_inputs,
    prove_current_loops,
    prove_sensitivity,
    random_parameters,
)
from dqforge.optimizer.certificates.matrix_inequalities import Budget


def sampled_radius(box: CurrentLoopBox, count: int, seed: int = 9) -> float:
    """Largest pole modulus of corners at nine speeds and random drives."""
    inside = drives_inside(box, np.random.default_rng(seed), count)
    return float(radii(box, np.vstack([corner_drives(box, 9), inside])).max())


# Work for proofs that are to be found however long they take.
_ENDLESS = 10**6


def outcome(box: CurrentLoopBox) -> CurrentLoopProof:
    """A proof, or a counterexample that the physical model confirms."""
    proof = prove_current_loops(box, work=_ENDLESS)
    if proof.counterexample is None:
        return proof
    drive = proof.counterexample
    assert box.gain[0] <= drive.gain <= box.gain[1]
    assert box.l_d[0] <= drive.l_d <= box.l_d[1]
    assert box.l_q[0] <= drive.l_q <= box.l_q[1]
    ends = [r + c * drive.gain for r, c in zip(box.r_s, box.dead_time, strict=True)]
    assert ends[0] * (1 - 1e-12) <= drive.r_s <= ends[1] * (1 + 1e-12)
    assert radius_of(box, drive) >= 1.0 - 1e-12
    return proof


def test_drives_are_proven_or_refuted_as_sampling_has_it() -> None:
    proven = 0
    for box in (*random_boxes(6, 1, fast=False), *random_boxes(6, 2, fast=True)):
        proof = outcome(box)
        assert proof.proven == (proof.counterexample is None)
        if proof.proven:
            proven += 1
            assert sampled_radius(box, 400) < 1.0
        else:
            assert sampled_radius(box, 2000) >= 1.0
    assert proven >= 5


def test_dead_time_and_rest_alone_are_boxes_too() -> None:
    box = random_boxes(1, 1, fast=False)[0]
    compensated = replace(box, dead_time=(-1.3 * box.r_s[0], 0.4 * box.r_s[0]))
    assert outcome(compensated).proven
    assert outcome(replace(box, omega_e=0.0)).proven
    single = replace(
        box, r_s=(box.r_s[0],) * 2, l_d=(box.l_d[0],) * 2, l_q=(box.l_q[1],) * 2, gain=(1.0, 1.0)
    )
    assert outcome(single).proven
    point = replace(single, omega_e=0.0)
    assert outcome(point).proven
    assert outcome(replace(box, r_s=(0.0, box.r_s[1]))).proven


@pytest.mark.slow
def test_beyond_the_limit_a_drive_is_named_and_short_of_it_all_are_proven() -> None:
    tried = 0
    for box in random_boxes(6, 7, fast=True):
        most = limit(box)
        if most is not None and tried < 2:
            tried += 1
            assert outcome(times(box, 0.99 * most)).proven
            assert outcome(times(box, 1.003 * most)).counterexample is not None
    assert tried == 2


def test_what_is_left_open_is_stated_and_never_called_proven() -> None:
    """Fewer cells than the proof needs: shares, ranges, and a certificate that claims no more."""
    box = next(
        times(box, 0.99 * most)
        for box, most in ((box, limit(box)) for box in random_boxes(6, 7, fast=True))
        if most is not None and not find_certificate(times(box, 0.99 * most), 9).complete
    )
    proof = prove_current_loops(box, 9)
    assert not proof.proven
    assert proof.confirmation is not None
    assert not proof.confirmation.fault
    assert proof.confirmation.left_open > 0
    assert 0.0 <= proof.share < 1.0
    assert proof.sensitivity is None
    left = proof.still_open
    assert left is not None
    root = [box.r_s, box.l_d, box.l_q, box.gain, (0.0, box.omega_e)]
    ranges = [left.r_s, left.l_d, left.l_q, left.gain, left.omega_e]
    for (low, high), (least, most) in zip(ranges, root, strict=True):
        assert least - 1e-9 * most <= low <= high <= most * (1 + 1e-9)
    full = prove_current_loops(box, work=_ENDLESS)
    assert full.proven
    assert full.share == 1.0


def test_samples_of_the_share_are_drives_of_the_box() -> None:
    box = random_boxes(1, 7, fast=True)[0]
    points = random_parameters(box, 500)
    drives = [drive_at(box, point) for point in points]
    again = np.array([parameters_of(box, drive) for drive in drives if drive is not None])
    np.testing.assert_allclose(again, points, rtol=1e-9)


# Factor on the gains of the first random drive of seed 41 at which it becomes unstable.
_BORDER = 1.15829146


def _steps(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Counts the steps of the barrier method from here on."""
    counted, plain = [0], matrix_inequalities._step

    def step(
        blocks: matrix_inequalities.Blocks, unknowns: FloatArray, weight: float
    ) -> tuple[FloatArray, float] | None:
        counted[0] += 1
        return plain(blocks, unknowns, weight)

    monkeypatch.setattr(matrix_inequalities, "_step", step)
    return counted


@pytest.mark.parametrize("work", [40, 200])
def test_a_search_stops_with_its_budget(work: int, monkeypatch: pytest.MonkeyPatch) -> None:
    box = times(random_boxes(1, 41, fast=True)[0], _BORDER / 1.001)
    counted, budget = _steps(monkeypatch), Budget(work)
    found = find_certificate(box, budget=budget)
    assert budget.left == 0
    assert not found.complete
    assert found.counterexample is None
    assert counted[0] + CELL_WORK * (found.tree.examined - 1) <= work


@pytest.mark.slow
@pytest.mark.parametrize("margin", [1.0001, 1.001, 1.01, 0.99])
def test_near_the_border_all_is_decided_or_given_up_within_the_work(
    margin: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is proven of stability, and of both sensitivities, together."""
    box = times(random_boxes(1, 41, fast=True)[0], _BORDER / margin)
    counted = _steps(monkeypatch)
    proof = prove_current_loops.__wrapped__(box)
    if margin < 1.0:
        assert proof.counterexample is not None
        return
    assert proof.proven
    found = prove_sensitivity.__wrapped__(box, proof.left)
    assert found.bound is None
    assert counted[0] <= WORK
    assert sampled_radius(box, 400) < 1.0


@pytest.mark.slow
def test_eighty_drives_near_their_limit() -> None:
    """1 % below the limit all are proven, 0.3 % above each has its drive."""
    tried, cells = 0, []
    for box in random_boxes(600, 11, fast=True):
        most = limit(box) if tried < 80 else None
        if most is None:
            continue
        tried += 1
        near = times(box, 0.99 * most)
        found = find_certificate(near, budget=Budget(_ENDLESS))
        cells.append(found.tree.examined)
        assert found.complete, (tried, found.tree.examined)
        assert confirm(plain_certificate(near, found.tree), plain_inputs(near)).proven
        beyond = times(box, 1.003 * most)
        drive = find_certificate(beyond).counterexample
        assert drive is not None
        assert radius_of(beyond, drive) >= 1.0 - 1e-12
    assert tried == 80
    assert np.median(cells) < 40


@pytest.mark.slow
def test_none_of_1e5_samples_inside_certified_boxes_is_unstable() -> None:
    generator, tried = np.random.default_rng(12), 0
    for box in random_boxes(40, 13, fast=True):
        most = limit(box) if tried < 10 else None
        if most is None:
            continue
        tried += 1
        near = times(box, 0.985 * most)
        assert prove_current_loops(near, work=_ENDLESS).proven
        assert radii(near, drives_inside(near, generator, 100_000)).max() < 1.0
    assert tried == 10


@pytest.mark.slow
def test_two_methods_never_contradict() -> None:
    """Sixty drives, half of them within 3 % of the border, on either side."""
    agreed = 0
    for place, box in enumerate(random_boxes(60, 17, fast=True)):
        most = limit(box) if place % 2 else None
        tried = box if most is None else times(box, most * (0.98 if place % 4 == 1 else 1.01))
        found = find_certificate(tried, budget=Budget(_ENDLESS))
        cleared = excludes_zero(tried, 12_000)
        assert not (cleared and found.counterexample is not None)
        if most is not None and place % 4 == 3:
            assert not cleared
        agreed += cleared and found.complete
    assert agreed >= 15


@pytest.mark.parametrize("axis", range(4))
@pytest.mark.parametrize("least", [Fraction(-1, 5), Fraction(1, 10)])
def test_what_corners_leave_out_is_an_eighth_of_the_squared_steps(
    axis: int, least: Fraction
) -> None:
    """The error of interpolation in each direction alone, h^2/8 of the second derivative, which the
    growth of a loop with a negative resistance raises; of the integral a third of it, and of the
    speed, whose factor in it is the time, two thirds.
    """
    low = [Fraction(2), Fraction(3), least, Fraction(1, 10)]
    high = list(low)
    high[axis] += Fraction(1, 4)
    box = SimpleNamespace(t_s=Fraction(1, 10), decoupling=(Fraction(1, 2), Fraction(1, 5)))
    cell = SimpleNamespace(low=low, high=high)
    phi, gamma = (float(bound.mid()) for bound in _rests(box, cell))  # type: ignore[arg-type]
    rho = 0.2, 0.5
    steepest = max(rho[0] * float(high[0]), rho[1] * float(high[1]))
    s = max(abs(float(low[2])), abs(float(high[2])))
    step = 0.25 * (s * rho[0], s * rho[1], steepest, 1.0)[axis]
    growth = np.exp(max(0.0, -float(low[2])) * steepest)
    assert phi == pytest.approx(growth * step**2 / 8.0, rel=1e-9)
    assert gamma == pytest.approx(growth * step**2 / (12.0 if axis == 3 else 24.0), rel=1e-9)
