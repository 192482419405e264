"""Loops of a firmware in C: equal to the same recursion in numpy, and to the judged loops."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
import pytest
from firmware_loops import (
    CONSTANT,
    EVERY,
    INVERTER,
    MACHINE,
    VALUES,
    configured,
    infineon,
    odrive,
    st,
    ti,
    vesc,
)
from firmware_recursion import Estimate, recursion
from scipy.optimize import brentq

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware
from dqforge.machines.plants.scenario import ControlMode, Profile, Scenario, Sensorless, constant
from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
    Winding,
    current_loop,
    speed_loop,
)
from dqforge.optimizer.firmware.firmware_method import METHODS, judge, mechanics_of
from dqforge.optimizer.sampled_systems import SampledSystem
from dqforge.reports.firmware.loop_code import loop_bytes, loop_files
from dqforge.reports.firmware.target import (
    drive_with,
    firmware_drive,
    firmware_simulator,
    simulate_profile,
)
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate

DRIVE = Drive(MACHINE, INVERTER, 50e-6)
SALIENT = replace(VALUES, l_q=1.4e-4)


@pytest.fixture(scope="module")
def program() -> Iterator[Simulator]:
    """One program for every structure."""
    with firmware_simulator(vesc(), VALUES) as made:
        yield made


def random_pi(pick: np.random.Generator, t_s: float, limit: float) -> PiController:
    """A controller of the winding by any rule."""
    rate = pick.uniform(0.01, 0.2) / t_s
    return PiController(
        1e-4 * rate,
        0.05 * rate * pick.uniform(0.2, 5.0),
        t_s,
        pick.choice(["integral-first", "integral-last", "trapezoid"]),
        pick.choice(["clamp", "hold", "back-calculation", "none"]),
        None if pick.random() < 0.5 else limit * pick.uniform(0.3, 1.0),
        0.0 if pick.random() < 0.5 else t_s * pick.uniform(0.2, 3.0),
        pick.uniform(0.0, 1.0) / t_s,
    )


def random_profile(seed: int) -> LoopProfile:
    """A structure by chance, whose loops need not be good."""
    pick = np.random.default_rng(seed)
    t_s = float(pick.choice([50e-6, 1e-4, 1.0 / 30e3]))
    ratio = int(pick.choice([1, 4, 10]))
    loops = CurrentLoops(
        random_pi(pick, t_s, 27.0),
        random_pi(pick, t_s, 27.0),
        float(pick.choice([0.0, 0.5, 1.0, 1.5, 2.25])),
        bool(pick.random() < 0.5),
        bool(pick.random() < 0.5),
        pick.choice(["vector", "d-first", "q-first", "axes"]),
        pick.uniform(0.3, 1.05),
        float(pick.choice([0.0, 1.0, 1.5])),
    )
    feedback = SpeedEstimate(
        pick.choice(["ideal", "pll", "low-pass", "difference"]),
        float(pick.choice([0.0, t_s, ratio * t_s])),
        2000.0,
        pick.uniform(1e4, 1e6),
        pick.uniform(0.0, 5e-3),
        int(pick.integers(1, 30)),
        int(pick.choice([1, 1, 5])),
        bool(pick.random() < 0.5),
    )
    kp = pick.uniform(0.1, 1.0)
    speed = replace(random_pi(pick, ratio * t_s, 50.0), kp=kp, ki=kp * pick.uniform(0.0, 40.0))
    ramp = None if pick.random() < 0.5 else pick.uniform(100.0, 3000.0)
    table = ((0.0, 0.0, 0.0), (10.0, -1.0, 9.5), (30.0, -6.0, 28.0), (60.0, -20.0, 50.0))
    reference = pick.choice(["id-zero", "mtpa-linear", "table"])
    return LoopProfile(
        "vesc", "chance", loops, SpeedController(speed, feedback, ramp), None, reference, (), table
    )


def scenario_of(mode: ControlMode, count: int, t_s: float, seed: int) -> Scenario:
    """References within and far beyond the limits, over ``count`` periods."""
    pick = np.random.default_rng(seed)
    times = tuple(0.1 * count * t_s * k for k in range(10))
    size = {"speed": 100.0, "torque": 6.0, "current": 60.0}[mode]
    values = pick.uniform(-size, size, 10)
    speed = pick.uniform(-150.0, 150.0)
    return Scenario(
        count * t_s,
        mode,
        Profile(times, tuple(values)),
        Profile(times, tuple(pick.uniform(-20.0, 20.0, 10))),
        shaft=None if mode == "speed" else Profile((0.0,), (speed,)),
        v_dc=Profile((0.0, 0.5 * count * t_s), (48.0, 40.0), "linear"),
        omega_m=speed if mode == "speed" else 0.0,
        theta_e=pick.uniform(-3.0, 3.0),
        dead_time=0.0,
    )


def made_in_numpy(
    profile: LoopProfile, values: DriveValues, run: Simulation
) -> tuple[FloatArray, FloatArray]:
    """Duty cycles and current references of the recursion on what was measured."""
    duty, wanted = recursion(
        profile,
        values,
        run.scenario.mode,
        (run.reference, run.reference_d),
        (run.i_measured, run.theta_e_measured, run.omega_m_measured, run.v_dc),
    )
    return np.asarray(duty, dtype=np.float64), np.asarray(wanted, dtype=np.float64)


def wait_of(profile: LoopProfile) -> int:
    """Whole periods after which duty cycles are seen: those that act first in a period."""
    return math.ceil(profile.current.delay)


@pytest.mark.parametrize("seed", range(36))
def test_equals_the_recursion_bit_for_bit(program: Simulator, seed: int) -> None:
    profile = random_profile(seed)
    mode: ControlMode = ("speed", "torque", "current")[seed % 3]
    scenario = scenario_of(mode, 300, profile.current.d.t_s, seed)
    run = simulate_profile(profile, SALIENT, DRIVE, scenario, program=program)
    duty, wanted = made_in_numpy(profile, SALIENT, run)
    late = wait_of(profile)
    assert run.t.size > 100
    np.testing.assert_array_equal(run.duty[late:], duty[: duty.shape[0] - late])
    np.testing.assert_array_equal(run.i_d_reference, wanted[:, 0])
    np.testing.assert_array_equal(run.i_q_reference, wanted[:, 1])


def test_the_structures_by_chance_meet_every_choice() -> None:
    profiles = [random_profile(seed) for seed in range(36)]
    controllers = [pi for p in profiles for pi in (p.current.d, p.current.q)]
    assert {pi.rule for pi in controllers} == {"integral-first", "integral-last", "trapezoid"}
    assert {pi.anti_windup for pi in controllers} == {"clamp", "hold", "back-calculation", "none"}
    assert {p.current.order for p in profiles} == {"vector", "d-first", "q-first", "axes"}
    kinds = {p.speed.feedback.kind for p in profiles[::3] if p.speed is not None}
    assert kinds == {"ideal", "pll", "low-pass", "difference"}
    assert {p.reference for p in profiles} == {"id-zero", "mtpa-linear", "table"}


@pytest.mark.slow
def test_the_header_holds_what_the_bytes_say(program: Simulator) -> None:
    """The program with the numbers of its own header runs as another that is handed them."""
    profile = infineon()
    scenario = scenario_of("speed", 200, 50e-6, 7)
    handed = simulate_profile(profile, VALUES, DRIVE, scenario, program=program)
    with firmware_simulator(profile, VALUES) as own:
        built_in = simulate(own, drive_with(profile, DRIVE), scenario)
    np.testing.assert_array_equal(built_in.duty, handed.duty)
    np.testing.assert_array_equal(built_in.i_q_reference, handed.i_q_reference)


def closed_answer(closed: SampledSystem, reference: FloatArray) -> FloatArray:
    """Measured value of a closed loop from rest, one per reference."""
    x, found = np.zeros(len(closed.a)), np.zeros(reference.size)
    for k, wanted in enumerate(reference):
        found[k] = closed.c[0] @ x
        x = closed.a @ x + closed.b[:, 0] * wanted
    return found


def filtered(value: FloatArray, share: float) -> FloatArray:
    """Behind a first-order filter that begins with the first value."""
    found, now = np.zeros(value.size), value[0]
    for k, one in enumerate(value):
        now += share * (one - now)
        found[k] = now
    return found


def named(name: Firmware) -> LoopProfile:
    """The loops of a firmware as it is configured for the scooter."""
    return configured(name)[0]


@pytest.mark.parametrize("make", EVERY)
def test_small_steps_of_the_current_are_those_of_the_judged_loop(
    program: Simulator, make: Callable[[], LoopProfile]
) -> None:
    profile = make()
    pi, count = profile.current.q, 120
    scenario = Scenario(
        count * pi.t_s, "current", constant(2.0), shaft=constant(0.0), dead_time=0.0
    )
    run = simulate_profile(profile, VALUES, DRIVE, scenario, program=program)
    loop = current_loop(Winding(0.05, 1e-4), pi, profile.current.delay)
    wanted = closed_answer(loop.closed, np.full(count + 1, 2.0))
    share = pi.t_s / (pi.t_s + pi.filter_time)
    np.testing.assert_allclose(filtered(run.i_q, share), wanted, atol=2e-5)


@pytest.mark.parametrize("make", [*EVERY, *(partial(named, name) for name in METHODS)])
def test_small_steps_of_the_speed_are_those_of_the_judged_loop(
    program: Simulator, make: Callable[[], LoopProfile]
) -> None:
    """As the firmware's own estimate sees it; the axes are taken as decoupled in the judgement,
    and a back-EMF that is fed forward as cancelled, which it is but for its delay: it is left out.
    """
    profile = make()
    profile = replace(profile, current=replace(profile.current, back_emf=False, cross=False))
    assert profile.speed is not None
    speed, t_c = replace(profile.speed, ramp=None), profile.current.q.t_s
    profile = replace(profile, reference="id-zero", speed=speed)
    ratio, step = max(1, round(speed.pi.t_s / t_c)), 0.5
    count = int(0.12 / (ratio * t_c))
    scenario = Scenario(count * ratio * t_c, "speed", constant(step), dead_time=0.0)
    run = simulate_profile(profile, VALUES, DRIVE, scenario, program=program)
    estimate = Estimate(profile, 15, t_c)
    theta, omega = (x.astype(np.float32) for x in (run.theta_e_measured, run.omega_m_measured))
    seen = np.array([estimate.step(a, b) for a, b in zip(theta, omega, strict=True)], np.float64)
    loop = speed_loop(
        Winding(0.05, 1e-4), mechanics_of(VALUES, profile.current), profile.current, speed
    )
    wanted = closed_answer(loop.closed, np.full(count + 1, step))
    share = ratio * t_c / (ratio * t_c + speed.pi.filter_time)
    np.testing.assert_allclose(filtered(seen[::ratio], share), wanted, atol=0.01 * step)
    assert np.max(wanted) > 0.5 * step


def swing_kept(run: Simulation, value: FloatArray) -> float:
    """Swing about the mean in the last quarter over that in the second."""
    count = value.size
    return float(np.ptp(value[3 * count // 4 :]) / np.ptp(value[count // 4 : count // 2]))


@pytest.mark.parametrize("make", [lambda: vesc(1e6), odrive, ti, st])
def test_the_gain_margin_is_where_the_current_begins_to_swing(
    program: Simulator, make: Callable[[], LoopProfile]
) -> None:
    profile = make()
    judged = judge(profile, VALUES).current_q
    assert judged is not None

    def kept(factor: float) -> float:
        pi = profile.current.q
        more = replace(pi, kp=factor * pi.kp, ki=factor * pi.ki)
        changed = replace(profile, current=replace(profile.current, q=more))
        scenario = Scenario(
            400 * pi.t_s, "current", constant(0.01), shaft=constant(0.0), dead_time=0.0
        )
        run = simulate_profile(changed, VALUES, DRIVE, scenario, program=program)
        return swing_kept(run, run.i_q)

    assert kept(0.97 * judged.gain_margin) < 1.0 < kept(1.03 * judged.gain_margin)


def test_the_pll_makes_the_speed_swing_where_the_judged_loop_becomes_unstable(
    program: Simulator,
) -> None:
    def modulus(ki: float) -> float:
        speed = judge(vesc(ki), VALUES).speed
        assert speed is not None
        return float(abs(speed.poles[0]))

    edge = brentq(lambda ki: modulus(ki) - 1.0, 1e4, 1e5)
    assert 2e4 < edge < 4e4
    for ki in (0.9 * edge, 1.1 * edge):
        run = simulate_profile(
            vesc(ki), VALUES, DRIVE, Scenario(1.2, "speed", constant(0.01)), program=program
        )
        # Half of the run lies between the quarters: so many periods of the speed controller.
        assert swing_kept(run, run.omega_m) == pytest.approx(modulus(ki) ** 600.0, rel=0.1)


def test_duty_cycles_act_after_the_delay(program: Simulator) -> None:
    """The current begins to rise at the delay, whatever part of a period that is."""
    for delay in (0.0, 0.25, 1.0, 1.6, 3.0):
        profile = vesc()
        profile = replace(profile, current=replace(profile.current, delay=delay))
        scenario = Scenario(5 * 50e-6, "current", constant(1.0), shaft=constant(0.0), dead_time=0.0)
        run = simulate_profile(profile, VALUES, DRIVE, scenario, program=program)
        voltage = 2e3 * math.pi * (1e-4 + 0.05 * 50e-6)
        for k in (1, 2, 3, 4):
            # Until the second voltage comes, the first one has had this time to act.
            acted = min(max(k - delay, 0.0), 1.0) * 50e-6
            if k - delay <= 1.0:
                expected = voltage / 0.05 * -math.expm1(-acted * 0.05 / 1e-4)
                assert run.i_q[k] == pytest.approx(expected, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("reference", ["id-zero", "mtpa-linear", "table"])
def test_a_small_command_keeps_its_sign(
    program: Simulator, reference: Literal["id-zero", "mtpa-linear", "table"]
) -> None:
    """Half an ampere, of which a table from 0 to 10 A holds a twentieth of its first piece."""
    table = ((0.0, 0.0, 0.0), (10.0, -1.0, 9.5), (30.0, -6.0, 28.0))
    for command in (0.5, -0.5):
        profile = replace(vesc(), reference=reference, table=table)
        scenario = Scenario(
            0.001, "torque", constant(command * CONSTANT), shaft=constant(0.0), dead_time=0.0
        )
        run = simulate_profile(profile, SALIENT, DRIVE, scenario, program=program)
        np.testing.assert_allclose(run.i_q_reference[5:], command, rtol=0.06)


def test_one_period_of_delay_is_what_our_own_header_has() -> None:
    assert Drive(MACHINE, INVERTER, 50e-6).delay == 1.0


def test_what_cannot_run_is_refused(program: Simulator) -> None:
    def refused(profile: LoopProfile, scenario: Scenario, values: DriveValues = VALUES) -> str:
        with pytest.raises(InputError) as caught:
            simulate_profile(profile, values, DRIVE, scenario, program=program)
        return str(caught.value)

    steps, profile = Scenario(0.01, "speed", constant(1.0)), vesc()
    current = replace(profile.current, d=replace(profile.current.d, t_s=1e-4))
    fast = replace(profile.current, delay=3.5)
    part = replace(profile.current, delay=0.3)
    assert "no speed controller" in refused(replace(profile, speed=None), steps)
    assert "one period" in refused(replace(profile, current=current), steps)
    assert "3.5 periods" in refused(replace(profile, current=fast), steps)
    assert "averaged" in refused(
        replace(profile, current=part), replace(steps, inverter="switched")
    )
    assert "observer of vesc" in refused(profile, replace(steps, sensorless=Sensorless(9.0, 8.0)))
    assert "pole_pairs" in refused(profile, steps, replace(VALUES, pole_pairs=None))
    assert "flux linkage" in refused(
        profile, replace(steps, mode="torque"), replace(VALUES, psi_pm=0.0)
    )
    unknown = replace(profile, current=replace(profile.current, modulation="nothing"))
    with pytest.raises(InputError, match="'nothing'"):
        loop_files(unknown, VALUES)
    for wrong in (1e39, math.inf, math.nan):
        q = replace(profile.current.q, kp=wrong)
        huge = replace(profile, current=replace(profile.current, q=q))
        assert "kp = " in refused(huge, steps)
    table = replace(profile, reference="table", table=((0.0, 0.0, 0.0),))
    assert "1 points" in refused(table, steps)


def test_a_machine_with_another_back_emf_is_refused() -> None:
    design = catalogue.load("paper002-phase-waveforms")
    with pytest.raises(InputError, match="sinusoidal"):
        firmware_drive(vesc(), design)


def test_the_code_is_plain_ascii_and_names_the_firmware() -> None:
    ((name, content),) = loop_files(infineon(), VALUES).items()
    assert name == "firmware_control.h"
    text = content.decode("ascii")
    assert "structure of infineon" in text
    assert text == loop_files(infineon(), VALUES)[name].decode("ascii")
    assert len(loop_bytes(infineon(), VALUES)) % 4 == 0
