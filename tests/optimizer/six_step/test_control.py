"""The control of a six-step drive by hand: start, catch, current and speed."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dqforge.optimizer.six_step import control as module
from dqforge.optimizer.six_step.control import SixStepGains
from dqforge.optimizer.six_step.sector_step import BlockGains
from dqforge.optimizer.six_step.sectors import FED, RETURN, middle
from dqforge.optimizer.steps.step_arithmetic import EXACT, Abc

# Floats stand where the functions have arrays.
control: Any = module
phases: Any = Abc
PSI, T_S = 0.1, 1e-4
OBSERVER = BlockGains(
    T_S,
    0,
    (0.5, 0.5),
    (0.0134, 0.0134),
    0.5,
    0.2,
    1.5,
    1.0,
    3.0,
    tuple(map(middle, range(6), [1] * 6)),
)
GAINS = SixStepGains(
    observer=OBSERVER,
    kp=2.0,
    ki_ts=0.1,
    emf=0.165,
    torque=0.5,
    i_max=6.0,
    duty_least=0.05,
    speed_kp=0.02,
    speed_ki_ts=0.001,
    omega_low=100.0,
    speed_scale=3.0,
    pole_pairs=4.0,
    ratio=3,
    omega_least=25.0,
    omega_caught=150.0,
    i_start=3.0,
    v_start=7.0,
    align=5,
    rise=0.002,
    rate=0.05,
    settle=4,
    gap=20,
)
SIXTH = math.pi / 3.0


def drive(stage: int, **members: object) -> Any:
    made: Any = control.blank()
    made.observer = replace(made.observer, lost=0)
    made.stage = stage
    for name, value in members.items():
        setattr(made, name, value)
    return made


@pytest.mark.parametrize("way", [1, -1])
def test_a_forced_start_is_two_blocks_and_a_linear_ramp(way: int) -> None:
    state = drive(control.ALIGNING, direction=way, rate=9.0, phase=9.0, integral=2.0)
    for k in range(1, 2 * GAINS.align + 1):
        control.six_step_force(EXACT, GAINS, state)
        assert state.count == k
        assert state.sector == (way * (k >= GAINS.align)) % 6
        assert state.stage == (control.RAMP if k == 2 * GAINS.align else control.ALIGNING)
    assert (state.rate, state.phase) == (0.0, 0.0)
    periods = math.ceil(GAINS.rate / GAINS.rise - 1e-9)
    for k in range(1, periods + 1):
        control.six_step_force(EXACT, GAINS, state)
        turned = GAINS.rise * k * (k + 1) / 2.0
        assert state.rate == pytest.approx(GAINS.rise * k)
        assert math.floor(turned) + state.phase == pytest.approx(turned)
        assert state.sector == way * (1 + math.floor(turned)) % 6
        assert state.stage == (control.RAMP if k < periods else control.CATCHING)
    assert (state.ramped, state.count, state.integral) == (1, 0, 0.0)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(
    ("speed", "ramped", "ends"),
    [
        (300.0, 0, control.RUNNING),
        (120.0, 1, control.RUNNING),
        (300.0 * 8.0, 0, control.RUNNING),
        (90.0, 0, control.ALIGNING),
        (90.0, 1, control.FAULT),
        (-300.0, 0, control.CATCHING),
        (-300.0, 1, control.FAULT),
        (0.0, 0, control.ALIGNING),
    ],
)
def test_a_rotor_is_caught_by_two_looks(way: int, speed: float, ramped: int, ends: int) -> None:
    gains = replace(GAINS, gap=10) if speed > 1000.0 else GAINS
    state = drive(control.CATCHING, direction=way, ramped=ramped, sector=3, tick=2)
    control.six_step_begin(EXACT, state, control.CATCHING)
    looks, angle, omega = gains.settle + gains.gap, 1.0, way * speed
    for k in range(1, looks + 1):
        assert state.stage == control.CATCHING
        theta = angle + omega * T_S * k
        emf = [-PSI * omega * math.sin(theta - 2.0 * math.pi / 3.0 * n) for n in range(3)]
        control.six_step_catch(EXACT, gains, state, phases(*emf))
    assert state.stage == ends
    assert state.fault == (control.NO_START if ends == control.FAULT else control.NO_FAULT)
    assert state.count == 0
    if ends == control.ALIGNING:
        assert state.sector == 0
    if ends == control.RUNNING:
        assert state.tick == 0
        assert state.speed_integral == pytest.approx(0.5 * GAINS.torque * GAINS.i_start)
        assert state.observer.sector == state.sector
        assert state.observer.direction == way
        # Both crossings are known to 10 % of 30 degrees.
        assert state.observer.omega_e == pytest.approx(omega, abs=0.11 / (gains.gap * T_S))
        ahead = theta + 0.5 * omega * T_S
        assert math.remainder(state.observer.theta_e - ahead, 2.0 * math.pi) == pytest.approx(
            0.0, abs=0.06
        )


@pytest.mark.parametrize("way", [1, -1])
def test_the_wanted_current_lies_within_its_limit(way: int) -> None:
    for torque, current in ((1.0, 2.0), (-1.0, 0.0), (5.0, 6.0)):
        state = drive(control.RUNNING, direction=way, asked=way * torque)
        assert control.six_step_wanted(EXACT, GAINS, state) == current
    for stage in (control.ALIGNING, control.RAMP):
        assert control.six_step_wanted(EXACT, GAINS, drive(stage, asked=1.0)) == GAINS.i_start


@pytest.mark.parametrize("most", [None, 0.8])
@pytest.mark.parametrize("omega", [200.0, -350.0])
@pytest.mark.parametrize("wanted", [1.0, 2.0, 40.0])
@pytest.mark.parametrize("i", [0.5, 1.5, 20.0])
def test_the_current_is_regulated_with_a_held_integral(
    most: float | None, omega: float, wanted: float, i: float
) -> None:
    gains = replace(GAINS, duty_most=most)
    state = drive(control.RUNNING, current=wanted, integral=4.0)
    state.observer.omega_e = omega
    duty = control.six_step_voltage(EXACT, gains, state, i, 100.0)
    error = wanted - i
    asked = (0.165 * abs(omega) + 4.0 + 2.0 * error) / 100.0
    assert duty == pytest.approx(min(max(asked, 0.05), most or 1.0))
    held = (asked > (most or 1.0) and error > 0.0) or (asked < 0.05 and error < 0.0)
    assert state.integral == pytest.approx(4.0 if held else 4.0 + 0.1 * error)


@pytest.mark.parametrize("stage", [control.ALIGNING, control.RAMP])
def test_a_forced_voltage_is_that_of_the_current_and_of_the_speed(stage: int) -> None:
    for i, over in ((2.0, 0.0), (7.0, 1.0), (10.0, 4.0), (30.0, 24.0)):
        state = drive(stage, rate=0.04, integral=4.0)
        emf = 0.165 * 0.04 * SIXTH / T_S if stage == control.RAMP else 0.0
        expected = min(max((7.0 + emf - 2.0 * over) / 50.0, 0.0), 1.0)
        assert control.six_step_voltage(EXACT, GAINS, state, i, 50.0) == pytest.approx(expected)
        assert state.integral == 4.0
        with np.errstate(divide="ignore"):
            assert control.six_step_voltage(EXACT, GAINS, state, i, 0.0) == 0.0


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("omega", [60.0, 180.0, 800.0])
@pytest.mark.parametrize("gap", [2.0, 40.0, 500.0, -10.0, -300.0])
def test_the_speed_controller_rises_with_the_speed(way: int, omega: float, gap: float) -> None:
    state = drive(control.RUNNING, direction=way, speed_integral=0.4, tick=0)
    state.observer.omega_e = way * omega
    # A reference in the other direction is another matter.
    error = max(gap, GAINS.omega_least - omega / 4.0)
    given = control.six_step_speed_control(EXACT, GAINS, state, way * (omega / 4.0 + error))
    scale = min(max(omega / 100.0, 1.0), 3.0)
    asked = scale * 0.02 * error + 0.4
    assert given == pytest.approx(way * min(max(asked, 0.0), 3.0))
    held = (asked >= 3.0 and error > 0.0) or (asked <= 0.0 and error < 0.0)
    assert state.speed_integral == pytest.approx(0.4 + (0.0 if held else scale**2 * 1e-3 * error))
    assert state.tick == 1
    # Between two samples of the speed the torque stays; the third period is the next.
    for tick in (2, 0):
        assert control.six_step_speed_control(EXACT, GAINS, state, way * 900.0) == given
        assert state.tick == tick


@pytest.mark.parametrize("way", [1, -1])
def test_a_drive_starts_and_stops_by_its_reference(way: int) -> None:
    state = drive(control.STOPPED, fault=control.LOST, ramped=1)
    control.six_step_speed_control(EXACT, GAINS, state, way * 24.9)
    assert state.stage == control.STOPPED
    control.six_step_speed_control(EXACT, GAINS, state, way * 25.0)
    assert (state.stage, state.direction, state.ramped, state.fault) == (
        control.CATCHING,
        way,
        0,
        0,
    )
    for reference, omega, lost, stops in (
        (0.0, 149.0, 0, True),
        (0.0, 151.0, 0, False),
        (0.0, 400.0, 1, True),
        (-way * 90.0, 149.0, 0, True),
    ):
        state = drive(control.RUNNING, direction=way, asked=1.0, speed_integral=1.0)
        state.observer.omega_e, state.observer.lost = way * omega, lost
        assert control.six_step_speed_control(EXACT, GAINS, state, reference) == 0.0
        assert state.speed_integral == 0.0
        assert state.stage == (control.STOPPED if stops else control.RUNNING)
    state = drive(control.STOPPED)
    assert control.six_step_torque_control(EXACT, state, 0.0) == 0.0
    assert control.six_step_torque_control(EXACT, state, math.nan) == 0.0
    assert state.stage == control.STOPPED
    assert control.six_step_torque_control(EXACT, state, way * 0.7) == way * 0.7
    assert (state.stage, state.direction) == (control.CATCHING, way)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("by_integral", [0, 1])
def test_the_current_is_that_of_the_phase_that_both_blocks_share(
    way: int, by_integral: int
) -> None:
    gains = replace(GAINS, observer=replace(OBSERVER, by_integral=by_integral))
    for sector in range(6):
        state = drive(control.RAMP, direction=way, sector=sector)
        before = (sector - way) % 6
        i = np.zeros(3)
        i[FED[sector]], i[RETURN[sector]] = 8.0, -7.0
        shared = 8.0 if FED[sector] == FED[before] else 7.0
        legs = control.six_step_step(EXACT, gains, state, phases(0.0, 0.0, 0.0), phases(*i), 50.0)
        assert (legs.high, legs.low, legs.chopped) == (FED[sector], RETURN[sector], FED[sector])
        emf = 0.165 * 0.002 * SIXTH / T_S
        assert legs.duty == pytest.approx((7.0 + emf - 2.0 * (shared - 6.0)) / 50.0)
    rest = control.six_step_step(
        EXACT, gains, drive(control.STOPPED), phases(0.0, 0.0, 0.0), phases(1.0, 0.0, -1.0), 50.0
    )
    assert tuple(rest) == (-1, -1, -1, 0.0)
