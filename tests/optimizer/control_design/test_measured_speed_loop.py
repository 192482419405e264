"""The speed loop on a measured speed: against the exact loop with the angle as a state, refused,
and left alone without a measurement.
"""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from measured_speeds import METHODS, design, settings
from scipy.optimize import brentq

from dqforge.machines.design.settings import SpeedLoopSettings, SpeedMeasurementSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import SpeedMeasurementName
from dqforge.machines.units.quantities import parse_quantity
from dqforge.optimizer.control_design import measured_speed_loop as module
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
    with pytest.raises(NoSolutionError, match="overflows") as refused:
        tuned(fast)
    said = re.findall(r"a clock of ([0-9.]+ \w+) or less", refused.value.message)
    clock = parse_quantity(said[0], "frequency")
    assert tuned(replace(fast, clock=clock)).measured_speed is not None
    with pytest.raises(NoSolutionError, match="overflows"):
        tuned(replace(fast, clock=1.05 * clock))
    with pytest.raises(NoSolutionError, match="counts as at rest"):
        tuned(settings("mixed", lines=4, lowest=1.0))


@pytest.mark.parametrize(("required", "found"), [(5.0, 5.0), (0.5, 1.0), (99.9, 99.9)])
def test_the_lowest_speed_is_where_the_margin_is_the_required_one(
    required: float, found: float
) -> None:
    def judge(omega: float) -> float:
        return omega

    assert module._lowest(judge, required, 1.0, 100.0) == pytest.approx(found, rel=1e-6)  # type: ignore[arg-type]


T_S, KP, KI = 1e-3, 0.4, 30.0


def delayed_integrator(gain: float) -> module._Plant:
    """gain/(z (z - 1)), with a load that does nothing."""
    a, b = np.array([[1.0, gain], [0.0, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]])
    system = SampledSystem(a, b, np.array([[1.0, 0.0]]), np.zeros((1, 2)), T_S)
    return module._Plant(1000.0 * gain, system)


def margin_of(gain: float, factor: float) -> tuple[float, float]:
    """Phase margin in rad and crossover in rad/s of the PI around it, by its formula."""

    def loop(omega: float) -> complex:
        z = np.exp(1j * omega * T_S)
        pi = KP * factor + KI * factor**2 * T_S * z / (z - 1.0)
        return complex(pi * gain / (z * (z - 1.0)))

    at = brentq(lambda omega: abs(loop(omega)) - 1.0, 1e-2, 0.99 * np.pi / T_S)
    return float(np.angle(-loop(at))), at


def slower(factor: float) -> tuple[float, float]:
    return KP * factor, KI * factor**2


def test_the_fastest_loop_that_holds_has_the_required_margin_at_the_worst_speed() -> None:
    plants, required = [delayed_integrator(0.6), delayed_integrator(1.7)], np.radians(50.0)
    wanted = brentq(lambda factor: margin_of(1.7, factor)[0] - required, 0.05, 0.9)
    assert margin_of(0.6, wanted)[0] > required
    crossover, factor = module._left(plants, slower, required)
    assert factor == pytest.approx(wanted, rel=2e-3)
    assert factor <= wanted * (1.0 + 1e-4)
    assert crossover == pytest.approx(margin_of(0.6, wanted)[1], rel=5e-3)
    assert module._left(plants, slower, np.radians(91.0)) == (None, None)


@pytest.mark.parametrize("pole", [1.001, 1.2])
def test_a_loop_that_is_not_stable_at_one_speed_is_none_whatever_its_margin(pole: float) -> None:
    class Swings:
        omega, system = 5.0, delayed_integrator(0.6).system

        def closed(self, kp: float, ki: float) -> SimpleNamespace:
            assert ki == pytest.approx(KI * (kp / KP) ** 2)
            poles = [complex(0.0, pole if kp > 0.2 * KP else -0.9), 0.1]
            return SimpleNamespace(closed=SimpleNamespace(poles=np.array(poles)))

    plants: list[module._Plant] = [delayed_integrator(0.6), Swings()]  # type: ignore[list-item]
    _, factor = module._left(plants, slower, np.radians(20.0))
    assert factor == pytest.approx(0.2, rel=2e-3)
    assert module._left(plants[:1], slower, np.radians(20.0))[1] == pytest.approx(1.0, rel=2e-3)
