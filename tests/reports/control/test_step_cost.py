"""Instructions of one step of the emitted current control on an emulated core."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from chain_steps import COUNT, current_control, drive_rows, solution

from dqforge.machines.transforms import Pair
from dqforge.reports.control.header import control_from, plain_control
from dqforge.reports.run import plain_solution


@pytest.mark.thinned
@pytest.mark.parametrize("flag", ["-fno-math-errno", "-fmath-errno"])
def test_a_step_of_the_current_control_takes_at_most_200_instructions(flag: str) -> None:
    """In the mean of random samples of which a third is beyond the voltage; and no sample more
    than a tenth above.
    """
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            pytest.skip(f"{name} is not installed")
    cost = current_control().compiled_with("current control", flag).cost("cortex-m4", COUNT)
    assert cost.calls == COUNT
    assert 150.0 < cost.instructions <= 200.0
    assert cost.instructions_largest <= 220


def test_a_third_of_the_costed_samples_is_beyond_the_voltage() -> None:
    model = control_from(plain_control(solution()), plain_solution(solution()))
    rows, state = drive_rows(), model.at_rest(COUNT)
    state.d.integral, state.q.integral = rows[:, 8].copy(), rows[:, 9].copy()
    reference = (rows[:, 6].copy(), rows[:, 7].copy())
    model.current_control(state, np.ascontiguousarray(rows[:, :6]), reference)
    limit = float(model.gains["voltage_share"]) * rows[:, 5]
    length = np.hypot(*Pair(*state.v))
    assert np.all(length <= limit * (1.0 + 1e-5))
    assert 0.25 < np.mean(length > limit * (1.0 - 1e-5)) < 0.4
