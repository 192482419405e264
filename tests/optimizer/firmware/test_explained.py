"""What a file that says too little is told to be completed by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from firmware_asked import scooter
from nxp_designs import design_of

from dqforge.optimizer.control_design.gain_set import gains_or_reason
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import drive_values
from dqforge.optimizer.firmware.solve import OwnGains, explain, explain_own
from dqforge.optimizer.firmware.targets.vesc import VESC


def test_a_speed_loop_of_unknown_inertia_says_what_to_give() -> None:
    asked = scooter()
    held = VESC.configure(asked)
    held = replace(held, drive=replace(held.drive, inertia=None))
    alone = explain(held)
    assert alone.judged.speed is None
    missing, advice = alone.judged.remarks[-2:]
    assert missing == "the speed loop is not evaluated: inertia not known"
    assert advice.startswith("name the design of the machine with --machine DESIGN: ")
    without = explain(held, replace(asked.drive, inertia=None))
    assert without.judged.remarks[-1].startswith(
        "the design of the machine does not contain it either"
    )
    whole = explain(held, asked.drive)
    assert whole.judged.speed is not None
    assert not any("machine" in remark for remark in whole.judged.remarks)


def test_faults_are_remarks_that_say_what_is_wrong() -> None:
    asked = scooter()
    held = VESC.configure(asked)
    slow = replace(held, own={**held.own, "foc_pll_ki": 30000.0})
    judged = explain(slow, asked.drive).judged
    assert "pole at 15.1 rad/s" in " ".join(judged.faults)
    assert set(judged.faults) < set(judged.remarks)


def test_own_gains_have_the_margins_that_they_were_made_with(tmp_path: Path) -> None:
    """Those of `solve_gains`, for both axes and the speed; on another machine others."""
    design = design_of(tmp_path, inductance_q="300 uH")
    gains, _ = gains_or_reason(design)
    assert gains is not None
    assert gains.speed is not None
    d, q, speed = (PiGains(loop.kp, loop.ki) for loop in (gains.i_d, gains.i_q, gains.speed))
    drive = drive_values(design)
    drive = replace(drive, t_s=gains.i_q.t_s, t_speed=gains.speed.t_s)
    found = explain_own(OwnGains(drive, d, q, speed))
    loops = (found.current_d, found.current_q, found.speed)
    for judged, made in zip(loops, (gains.i_d, gains.i_q, gains.speed), strict=True):
        assert judged is not None
        assert judged.phase_margin == pytest.approx(made.phase_margin, rel=1e-6)
        assert judged.crossover == pytest.approx(made.margins.crossover, rel=1e-6)
        assert judged.max_sensitivity == pytest.approx(made.margins.max_sensitivity, rel=1e-4)
    assert found.remarks == ()
    heavier = explain_own(OwnGains(drive, d, q, speed), replace(drive, inertia=0.04)).speed
    assert heavier is not None
    assert found.speed is not None
    assert heavier.crossover == pytest.approx(0.5 * found.speed.crossover, rel=0.1)
    observed = explain_own(OwnGains(drive, d, q, speed, observed=True))
    assert "runs on an observer" in observed.remarks[0]
    without = explain_own(OwnGains(replace(drive, inertia=None), d, q, speed))
    assert without.speed is None
    assert "a header lacks the inertia" in without.remarks[0]
    (missing,) = explain_own(OwnGains(replace(drive, r_s=None), d, q, speed)).remarks
    assert "without the phase resistance" in missing
    (missing,) = explain_own(OwnGains(replace(drive, t_s=None), d, q, speed)).remarks
    assert "without the sampling period" in missing
