"""Fixed gains on other machines, against the analysis of one loop at a time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from drawn_machines import drawn_machines
from drives import IPM, make_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.yields import (
    LOOPS,
    MARGINS,
    FixedHeader,
    FixedLoop,
    fixed_loop,
    least_phase_margin,
    loop_outputs,
    nominal_header,
)
from dqforge.optimizer.loops.loop_gains import analyse_current_loop


@cache
def header() -> FixedHeader:
    return nominal_header(make_design())


@pytest.mark.parametrize("loop", LOOPS)
def test_margins_are_those_of_each_loop_alone(loop: str) -> None:
    fixed, drawn = fixed_loop(header(), loop), drawn_machines(IPM, 6, 4)
    ratio = np.linspace(0.9, 1.1, 6)
    found = loop_outputs(fixed, drawn.r_s, drawn.l_d if loop == "i_d" else drawn.l_q, ratio)
    for row in range(drawn.count):
        machine = drawn.machine(row)
        # A gain of the voltage is the same as a gain of the controller.
        single = analyse_current_loop(
            machine.r_s,
            machine.l_d if loop == "i_d" else machine.l_q,
            fixed.t_s,
            fixed.kp * ratio[row],
            fixed.ki * ratio[row],
        )
        assert found["stable"][row] == single.stable == 1.0
        for name in MARGINS:
            if name != "stable":
                tolerance = 1e-6 if name == "max_sensitivity" else 1e-9
                assert found[name][row] == pytest.approx(getattr(single, name), rel=tolerance)


def test_a_higher_link_leaves_less_margin_and_in_the_end_none() -> None:
    drawn = drawn_machines(IPM, 4, 1)
    fixed = fixed_loop(header(), "i_q")

    def at(ratio: float) -> dict[str, FloatArray]:
        return loop_outputs(fixed, drawn.r_s, drawn.l_q, ratio)

    margins = [at(ratio)["phase_margin"] for ratio in (0.8, 1.0, 1.3)]
    assert np.all(np.diff(margins, axis=0) < 0.0)
    beyond = at(100.0)
    assert np.all(beyond["stable"] == 0.0)
    assert np.all(np.isnan(beyond["phase_margin"]))


def test_the_least_margin_is_that_of_the_worse_loop() -> None:
    drawn = drawn_machines(IPM, 9, 1)
    found = {
        loop: loop_outputs(fixed_loop(header(), loop), drawn.r_s, inductance, 1.0)
        for loop, inductance in zip(LOOPS, (drawn.l_d, drawn.l_q), strict=True)
    }
    least = least_phase_margin(found)
    both = np.array([found[loop]["phase_margin"] for loop in LOOPS])
    assert np.array_equal(least, both.min(axis=0))
    assert {0, 1} == set(both.argmin(axis=0).tolist())


def test_what_a_header_does_not_have_is_refused_with_what_to_write() -> None:
    with pytest.raises(InputError, match=r"gains\.speed: .* write gains\.i_d\.phase_margin"):
        fixed_loop(header(), "speed")
    bare = FixedHeader(header().reference, None, FixedLoop(1.0, 0.1, 1e-4), 500.0)
    with pytest.raises(InputError, match=r"gains\.i_d: the header has no loops"):
        fixed_loop(bare, "i_d")
    assert fixed_loop(bare, "i_q").kp == 1.0
