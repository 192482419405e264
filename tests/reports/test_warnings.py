"""What `run` says to look out for before anything is flashed."""

from __future__ import annotations

from dqforge.machines.design import catalogue
from dqforge.optimizer.solution import solve
from dqforge.reports.capability import Outcome
from dqforge.reports.report import watched


def _warnings(name: str, *settings: str) -> str:
    solution = solve(catalogue.load(name, settings))
    return "\n".join(watched(Outcome(solution)))


def test_a_largest_speed_beyond_the_link_is_a_warning_unless_the_field_is_weakened() -> None:
    beyond = ("machine.max_speed=9000 rpm",)
    text = _warnings("abb-ipmsm-2k2", *beyond)
    assert "above v_dc" in text
    assert "write field_weakening: {speed: 9000 rpm}" in text
    assert "above v_dc" not in _warnings("abb-ipmsm-2k2")


def test_loops_that_are_unstable_together_are_a_warning_without_tolerances() -> None:
    slow = "control.current_loop.bandwidth=200 Hz"
    text = _warnings("abb-syrm-6k7-saturated", slow)
    assert "both current loops together are unstable above 26" in text
    assert "the decoupling uses 57.5 mH" in text
    assert "together are unstable" not in _warnings("abb-syrm-6k7-saturated")


def test_a_torque_that_tolerances_leave_open_is_a_warning() -> None:
    text = _warnings("hoverboard-hub")
    assert "the torque may be 17 % less to 25 % more than requested" in text
    assert "the torque may be" not in _warnings("mjbots-mj5208")
