"""The speed loop on a measured speed: against the exact loop with the angle as a state, refused,
and left alone without a measurement.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from measured_speeds import METHODS, design, settings

from dqforge.machines.design.settings import SpeedLoopSettings, SpeedMeasurementSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import SpeedMeasurementName
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.measured_speed_loop import measured_speed
from dqforge.optimizer.loops.plants import SpeedLoop
from dqforge.optimizer.sampled_systems import SampledSystem, loop_margins


def tuned(own: SpeedMeasurementSettings | None, loop: SpeedLoopSettings | None = None) -> GainSet:
    return solve_gains(design(own, loop))


def counted_loop(gains: GainSet) -> SampledSystem:
    """The exact two-rate loop whose speed is the turned angle over the period.

    The state of the drive between the samples is (integral, torque, speed, previous voltage); the
    angle moves with the mean of the speed between two current samples to third order.
    """
    speed = gains.speed
    assert speed is not None
    assert isinstance(speed.model, SpeedLoop)
    model = speed.model
    drive, ratio = model.drive, model.ratio
    n, h = drive.a.shape[0], drive.t_s
    a, b = np.eye(n + 1), np.zeros(n + 1)
    step, push = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
    step[:n, :n], push[:n] = drive.a, drive.b[:, 0]
    step[n, n] = 1.0
    step[n, 2] += 0.5 * h
    step[n, :n] += 0.5 * h * drive.a[2]
    push[n] = 0.5 * h * drive.b[2, 0]
    for _ in range(ratio):
        a, b = step @ a, step @ b + push
    # states: drive, angle turned in the last period, PI integral
    whole, inward, outward = np.zeros((n + 2, n + 2)), np.zeros(n + 2), np.zeros(n + 2)
    whole[:n, :n], inward[:n] = a[:n, :n], b[:n]
    whole[n, :n], inward[n] = a[n, :n], b[n]
    outward[n] = 1.0 / (ratio * h)
    kp, ki_ts = speed.kp, speed.ki_ts
    closed = np.zeros((n + 2, n + 2))
    # error -> torque kp e + (integral + ki e); output y
    closed[: n + 1, : n + 1] = whole[: n + 1, : n + 1]
    closed[: n + 1, n + 1] = inward[: n + 1]
    closed[n + 1, n + 1] = 1.0
    entry = np.append(inward[: n + 1] * (kp + ki_ts), ki_ts)
    return SampledSystem(closed, entry[:, None], outward[None, :], np.zeros((1, 1)), ratio * h)


def test_counts_are_the_exact_loop_with_the_angle_as_a_state() -> None:
    gains = tuned(settings("counts"))
    assert gains.measured_speed is not None
    exact = loop_margins(counted_loop(gains)).phase_margin
    assert gains.measured_speed.phase_margin[-1] == pytest.approx(exact, abs=np.radians(0.3))
    assert gains.speed is not None
    # the measurement costs degrees, so that the comparison tells something
    assert gains.speed.phase_margin - exact > np.radians(3.0)


@pytest.mark.parametrize("method", METHODS)
def test_the_delay_costs_its_phase_at_the_crossover(method: SpeedMeasurementName) -> None:
    gains = tuned(settings(method))
    found, speed = gains.measured_speed, gains.speed
    assert found is not None
    assert speed is not None
    cost = speed.phase_margin - found.phase_margin
    assert cost == pytest.approx(speed.crossover * found.delay, rel=0.05, abs=1e-3)
    assert np.all(np.diff(found.phase_margin) >= -1e-9)
    at = float(found.edges.mean_delay(np.array(found.lowest)))
    if found.lowest > 1.001e-3 * found.omega_m[-1]:
        left = speed.phase_margin - speed.crossover * at
        assert left == pytest.approx(found.required, abs=np.radians(1.5))


def test_gains_are_made_for_the_delay_and_alone_without_a_measurement() -> None:
    exact, timed = tuned(None), tuned(settings("mixed"))
    assert exact.measured_speed is None
    assert exact.speed is not None
    assert timed.speed is not None
    assert timed.speed.kp < exact.speed.kp
    base = design(None)
    assert measured_speed(base, exact.i_q, exact.speed) is None


def test_a_loop_too_fast_for_the_delay_is_refused_with_what_holds() -> None:
    exact = tuned(None).speed
    assert exact is not None
    given = SpeedLoopSettings(method="given", kp=exact.kp, ki=exact.ki)
    own = settings("capture", lines=64, lowest=60.0)
    with pytest.raises(NoSolutionError, match=r"known .* late.*holds with control\.speed_loop\.kp"):
        tuned(own, given)
    with pytest.raises(NoSolutionError) as caught:
        tuned(own, given)
    kp, ki = (float(text) for text in re.findall(r"= ([0-9.e+-]+) N m", caught.value.message))
    holding = replace(given, kp=kp, ki=ki)
    assert tuned(own, holding).measured_speed is not None


def test_a_timer_that_runs_over_is_refused() -> None:
    fast = replace(settings("mixed"), clock=1e9)
    with pytest.raises(NoSolutionError, match="overflows"):
        tuned(fast)
    with pytest.raises(NoSolutionError, match="counts as at rest"):
        tuned(settings("mixed", lines=4, lowest=1.0))
