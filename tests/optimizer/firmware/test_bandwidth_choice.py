"""The bandwidth that a firmware's own loops can hold."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from firmware_asked import asked_of, scooter
from saturated import ArctanMachine

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.firmware.configuration import CurrentLoops, LoopProfile, PiController
from dqforge.optimizer.firmware.firmware_method import Asked, judge
from dqforge.optimizer.firmware.moteus_format import (
    MOST_SENSITIVITY,
    bandwidth_asked,
    drives_over_current,
    held_bandwidth,
    rounded_down,
)


def loops_of(asked: Asked, bandwidth: float) -> LoopProfile:
    drive = asked.drive
    assert drive.r_s is not None
    assert drive.l_d is not None
    assert drive.l_q is not None
    pi = PiController(bandwidth * drive.l_d, bandwidth * drive.r_s, 1e-4)
    return LoopProfile(
        "moteus", "test", CurrentLoops(pi, replace(pi, kp=bandwidth * drive.l_q), delay=1.0)
    )


def margins(asked: Asked, bandwidth: float) -> list[float]:
    found = []
    for drive in drives_over_current(asked):
        judged = judge(loops_of(asked, bandwidth), drive)
        assert judged.current_d is not None
        assert judged.current_q is not None
        found += [judged.current_d.phase_margin, judged.current_q.phase_margin]
    return found


def test_what_holds_is_taken_and_what_rings_is_lowered() -> None:
    asked = scooter()
    slow = held_bandwidth(1000.0, lambda bandwidth: loops_of(asked, bandwidth), asked)
    assert slow == 1000.0
    found = held_bandwidth(2e4, lambda bandwidth: loops_of(asked, bandwidth), asked)
    judged = judge(loops_of(asked, found), asked.drive)
    assert judged.current_q is not None
    assert judged.current_q.max_sensitivity == pytest.approx(MOST_SENSITIVITY, rel=5e-3)
    assert judged.current_q.max_sensitivity <= MOST_SENSITIVITY


def test_a_larger_phase_margin_of_the_design_is_kept() -> None:
    asked = scooter()
    loop = replace(asked.design.control.current_loop, min_phase_margin=1.3)
    design = replace(asked.design, control=replace(asked.design.control, current_loop=loop))
    found = held_bandwidth(
        2e4, lambda bandwidth: loops_of(asked, bandwidth), replace(asked, design=design)
    )
    assert min(margins(asked, found)) == pytest.approx(1.3, abs=0.01)
    assert min(margins(asked, found)) >= 1.3


def test_margins_hold_where_the_machine_saturates_too() -> None:
    asked = asked_of(ArctanMachine())
    assert len(drives_over_current(asked)) == 2
    found = held_bandwidth(2e4, lambda bandwidth: loops_of(asked, bandwidth), asked)
    alone = replace(asked, drive=replace(asked.drive, i_max=None))
    assert found < held_bandwidth(2e4, lambda bandwidth: loops_of(alone, bandwidth), alone)
    assert min(margins(asked, found)) >= asked.design.control.current_loop.min_phase_margin


def test_a_margin_that_no_bandwidth_keeps_is_refused() -> None:
    asked = scooter()
    loop = replace(asked.design.control.current_loop, min_phase_margin=3.2)
    design = replace(asked.design, control=replace(asked.design.control, current_loop=loop))
    impossible = replace(asked, design=design)
    with pytest.raises(NoSolutionError, match="keeps a phase margin of"):
        held_bandwidth(1e3, lambda bandwidth: loops_of(asked, bandwidth), impossible)


def test_the_slower_axis_counts() -> None:
    asked = scooter()
    assert bandwidth_asked(asked) == pytest.approx(2.0 * math.pi * 1000.0)
    assert rounded_down(6283.185) == 6283.0
    assert rounded_down(6283.0) == 6283.0
    assert rounded_down(0.0999999) == 0.09999
