"""Margins of one axis over the box: near what sampling finds, never beyond it, and refused
where they are claimed too good.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq
from random_loops import WIDE, AxisDrive, axis_drive, random_axis_drive

from dqforge.machines.design.settings import Tolerances
from dqforge.optimizer.axis_margins import (
    axis_box,
    axis_gains,
    decide,
    nominal_is_stable,
    phase_claim,
    prove_margins,
    sensitivity_claim,
)
from dqforge.optimizer.loops.robustness import box_points

LOW = 10.0  # A, at which the dead time outweighs the winding


@pytest.fixture(scope="module", params=[8, pytest.param(30, marks=pytest.mark.slow)])
def drives(request: pytest.FixtureRequest) -> list[AxisDrive]:
    generator = np.random.default_rng(20_261_122)
    return [random_axis_drive(generator) for _ in range(request.param)]


def test_margins_are_proven_near_what_sampling_finds(drives: list[AxisDrive]) -> None:
    """M_s within 1 % (and three decimals), the phase margin within half a degree, of all drives;
    each in few cells.
    """
    for drive in drives:
        proven = prove_margins(drive.box, drive.gains, drive.found)
        assert proven.stable
        assert proven.max_sensitivity is not None
        assert proven.phase_margin is not None
        ratio = proven.max_sensitivity / drive.found.max_sensitivity.value
        assert 1.0 <= ratio <= 1.01
        lost = np.degrees(drive.found.phase_margin.value - proven.phase_margin)
        assert 0.0 < lost <= 0.5
        assert proven.cells < 800


def test_a_sensitivity_half_a_percent_too_low_is_refuted(drives: list[AxisDrive]) -> None:
    for drive in drives:
        claim = sensitivity_claim(
            axis_gains(drive.gains), 0.995 * drive.found.max_sensitivity.value
        )
        assert decide(claim, axis_box(drive.box, drive.gains), 200).outcome == "refuted"


def test_a_phase_margin_too_large_is_never_proven(drives: list[AxisDrive]) -> None:
    for drive in drives[: max(2, len(drives) // 5)]:
        claim = phase_claim(axis_gains(drive.gains), drive.found.phase_margin.value + 0.005)
        assert decide(claim, axis_box(drive.box, drive.gains), 300).outcome == "open"


def test_too_few_cells_leave_it_open(drives: list[AxisDrive]) -> None:
    drive = drives[0]
    claim = sensitivity_claim(axis_gains(drive.gains), 1.001 * drive.found.max_sensitivity.value)
    decision = decide(claim, axis_box(drive.box, drive.gains), 2)
    assert (decision.outcome, decision.cells) == ("open", 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "tolerances",
    [
        Tolerances(l_q=0.3),
        Tolerances(r_s=(0.0, 0.8), v_dc=(-0.2, 0.0)),
        Tolerances(r_s=0.2, l_q=0.1, v_dc=0.1, dead_time=0.4e-6, low_current=LOW),
        replace(WIDE, dead_time=(0.0, 1e-6), low_current=0.1),
    ],
)
def test_no_drive_of_the_box_is_worse_than_proven(tolerances: Tolerances) -> None:
    """Four thousand drives, among them some of negative resistance through the dead time."""
    drive = axis_drive(0.4, 2e-3, 1e-4, (3.0, 900.0), tolerances)
    assert drive is not None
    proven = prove_margins(drive.box, drive.gains, drive.found)
    assert proven.max_sensitivity is not None
    assert proven.phase_margin is not None
    points = drive.box.current_points("i_q")
    generator, many = np.random.default_rng(3), 4_000
    low, high = np.min(points.deviations, axis=0), np.max(points.deviations, axis=0)
    inside = generator.uniform(low, high, (many, low.size))
    sampled = replace(points, deviations=inside, loaded=np.zeros(many, np.bool_))
    margins = drive.margins(sampled)
    if tolerances.dead_time == 0.4e-6:
        assert np.min(drive.box.resistance(sampled)) < 0.0
    assert np.max(margins.radius) < 1.0
    assert np.max(margins.max_sensitivity) <= proven.max_sensitivity
    assert np.min(np.abs(margins.phase_margin)) >= proven.phase_margin


def test_an_unstable_loop_is_not_proven() -> None:
    """Gains far too high: M_s stays finite around loops that all are unstable, and the drive of
    the data is what says so.
    """
    drive = axis_drive(0.4, 2e-3, 1e-4, (3.0, 900.0), Tolerances(r_s=0.01))
    assert drive is not None
    box, gains = axis_box(drive.box, drive.gains), axis_gains(drive.gains)
    assert nominal_is_stable(box, gains)
    wild = replace(gains, p=gains.p * 20, q=gains.q * 20)
    assert decide(sensitivity_claim(wild, 50.0), box, 400).outcome == "proven"
    assert not nominal_is_stable(box, wild)
    loud = replace(drive.gains, kp=20.0 * drive.gains.kp, ki=20.0 * drive.gains.ki)
    assert not prove_margins(drive.box, loud, drive.found).stable


def test_the_nominal_drive_is_judged_as_its_poles_are() -> None:
    drive = axis_drive(0.4, 2e-3, 1e-4, (3.0, 900.0))
    assert drive is not None
    box = axis_box(drive.box, drive.gains)
    for share in np.geomspace(0.1, 20.0, 60):
        gains = axis_gains(drive.gains)
        factor = fmpq(*Fraction(share).limit_denominator(1000).as_integer_ratio())
        scaled = replace(gains, p=gains.p * factor, q=gains.q * factor)
        a = np.exp(-float(box.rho))
        gamma = (1.0 - a) / float(box.rho)
        p, q = float(scaled.p), float(scaled.q)
        poles = np.roots([1.0, -1.0 - a, a + gamma * (p + q), -gamma * p])
        assert nominal_is_stable(box, scaled) == (np.max(np.abs(poles)) < 1.0)


def test_points_of_the_box_keep_their_names() -> None:
    """The zero sequence has an inductance of its own, with the wider of both tolerances."""
    drive = axis_drive(0.4, 2e-3, 1e-4, (3.0, 900.0), replace(WIDE, l_d=(-0.5, 0.1)))
    assert drive is not None
    zero = axis_box(drive.box, replace(drive.gains, loop="i_0"))
    assert [float(end) for end in zero.inductance] == pytest.approx([0.5, 1.3])
    assert box_points(drive.box.zero_limits()).names == ("r_s", "v_dc", "l_0")
