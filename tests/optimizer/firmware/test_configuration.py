"""The parts of a firmware's speed loop, stepped here one by one."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.optimizer.firmware.configuration import (
    Mechanics,
    SpeedEstimate,
    Winding,
    _lifted_average,
    _tracked,
    _turning,
)
from dqforge.optimizer.sampled_systems import SampledSystem


@pytest.mark.parametrize("ratio", [1, 3, 4])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 8, 11])
def test_an_average_seen_every_so_many_steps_is_that_of_the_outputs(ratio: int, count: int) -> None:
    generator = np.random.default_rng(ratio + 10 * count)
    a, b = 0.3 * generator.standard_normal((3, 3)), generator.standard_normal((3, 2))
    c = generator.standard_normal((1, 3))
    system = SampledSystem(a, b, c, np.zeros((1, 2)), 1e-4)
    found = _lifted_average(system, ratio, count)
    assert found.t_s == pytest.approx(ratio * 1e-4)
    x, wide = np.zeros(3), np.zeros(len(found.a))
    outputs = [0.0] * count
    for _ in range(12):
        u = generator.standard_normal(2)
        for _ in range(ratio):
            x = a @ x + b @ u
            outputs.append(float((c @ x)[0]))
        wide = found.a @ wide + found.b @ u
        assert (found.c @ wide)[0] == pytest.approx(np.mean(outputs[-count:]), abs=1e-12)


@pytest.mark.parametrize("whole", [False, True])
def test_a_tracking_loop_follows_the_angle(*, whole: bool) -> None:
    """omega and theta of the estimate, stepped beside an angle that turns."""
    period, kp, ki, omega = 2e-3, 80.0, 1600.0, 0.0
    feedback = SpeedEstimate("pll", period, kp=kp, ki=ki, whole=whole)
    made = _tracked(feedback, 2, 1, period)
    # The second state is the angle by which the rotor is ahead, the third the speed.
    state = np.array([0.4, 0.1, 0.0])
    ahead = 0.1
    for _ in range(30):
        omega += ki * period * ahead
        seen = omega + kp * ahead if whole else omega
        ahead -= period * (omega + kp * ahead)
        value = made.value @ state
        state = made.step @ state
        assert state[1] == pytest.approx(ahead, abs=1e-12)
        assert state[2] == pytest.approx(omega, abs=1e-12)
        expected = seen if whole else omega
        assert value == pytest.approx(expected, abs=1e-12)
    assert state[0] == 0.4


def test_current_speed_and_angle_keep_power_and_torque() -> None:
    winding = Winding(0.4, 2e-3, gain=0.9)
    mechanics = Mechanics(torque_constant=0.3, back_emf=0.2, inertia=5e-4, viscous=1e-3)
    a, voltage, load = _turning(winding, mechanics)
    i, omega, theta, u, t_load = 3.0, 50.0, 1.0, 12.0, 0.25
    rates = a @ [i, omega, theta] + voltage[:, 0] * u + load[:, 0] * t_load
    assert 2e-3 * rates[0] == pytest.approx(0.9 * u - 0.4 * i - 0.2 * omega)
    assert 5e-4 * rates[1] == pytest.approx(0.3 * i - 1e-3 * omega - t_load)
    assert rates[2] == omega
