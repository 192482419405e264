"""Answers that are shown of the loops, against difference equations written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.integer_gains import loop_responses

T_S = 2e-4
MACHINE = LinearMachine(3, 2.35, 1.61e-3, 3.74e-3, 0.06, 6.4, 2e-4, 4e-5)


@pytest.mark.parametrize("speed", [False, True])
def test_responses_are_those_of_the_sampled_loops(*, speed: bool) -> None:
    """A voltage acts a sample late and is held; the phase is continuous from near -90 or -180 deg
    on, and the frequencies reach from a fortieth of the slowest crossover to half the sampling."""
    base = make_design(MACHINE)
    control = replace(
        base.control,
        t_s=T_S,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=1200.0),
        speed_loop=SpeedLoopSettings(ratio=2) if speed else None,
        observer=None,
    )
    gains = solve_gains(replace(base, control=control))
    found = loop_responses(gains.i_d, gains.i_q, gains.speed)
    assert [one.gains for one in found] == [
        one for one in (gains.i_d, gains.i_q, gains.speed) if one is not None
    ]
    slowest = min(one.gains.crossover for one in found)
    length = max(9.0 / gains.i_d.crossover, 9.0 / gains.i_q.crossover, 12.0 * T_S)
    for one, inductance in zip(found, (1.61e-3, 3.74e-3), strict=False):
        loop = one.gains
        pole = np.exp(-2.35 / inductance * T_S)
        omega = 2.0 * np.pi * one.frequency
        assert omega[0] == pytest.approx(slowest / 40.0)
        assert omega[-1] == pytest.approx(np.pi / T_S)
        assert omega.size == 161
        inside = omega < 0.999 * np.pi / T_S
        z = np.exp(1j * omega[inside] * T_S)
        answer = (loop.kp + loop.ki_ts * z / (z - 1.0)) * (1.0 - pole) / 2.35 / (z - pole) / z
        np.testing.assert_allclose(one.gain[inside], np.abs(answer), rtol=1e-9)
        turned = one.phase[inside] - np.degrees(np.angle(answer))
        np.testing.assert_allclose(turned, 360.0 * np.rint(turned / 360.0), atol=1e-6)
        assert -100.0 < one.phase[0] < -80.0
        assert np.all(np.abs(np.diff(one.phase)) < 90.0)
        at = np.interp(np.log(loop.crossover), np.log(omega), one.phase)
        assert one.phase_at_crossover == pytest.approx(float(at), abs=1e-6)
        assert one.phase_at_crossover == pytest.approx(
            np.degrees(loop.phase_margin) - 180.0, abs=1e-6
        )
        current = voltage = integral = 0.0
        samples = []
        for _ in range(13):
            samples.append(current)
            integral += loop.ki_ts * (1.0 - current)
            asked = loop.kp * (1.0 - current) + integral
            current, voltage = pole * current + (1.0 - pole) / 2.35 * voltage, asked
        seen = np.interp(np.arange(1, 13) * T_S, one.step.times, one.step.reference)
        np.testing.assert_allclose(seen, samples[1:], atol=2e-3)
        assert one.step.times[-1] == pytest.approx(length, abs=1.5 * T_S)
    if gains.speed is not None:
        shown = found[2].step.times[-1]
        least = 12.0 * gains.speed.t_s
        assert shown == pytest.approx(max(22.0 / gains.speed.crossover, least), rel=0.02)
        assert 2.0 * np.pi * found[2].frequency[0] == pytest.approx(slowest / 40.0)
