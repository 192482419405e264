"""What a file that says too little is told to be completed by."""

from __future__ import annotations

from dataclasses import replace

from firmware_asked import scooter

from dqforge.optimizer.firmware.solve import explain
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
