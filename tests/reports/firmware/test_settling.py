"""Standard steps of a firmware's loops on the scooter's drive: what settles, and why not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import RELUCTANCE, make_design
from firmware_loops import (
    EVERY,
    MACHINE,
    VALUES,
    configured,
    current_pi,
    scooter,
    speed_pi,
    vesc,
)
from hidden_compilers import hide_compilers

from dqforge.machines.errors import VerificationError
from dqforge.machines.names import Firmware
from dqforge.machines.plants.scenario import Profile, Scenario
from dqforge.optimizer.firmware.configuration import LoopProfile
from dqforge.optimizer.firmware.firmware_method import METHODS
from dqforge.reports.firmware.target import (
    Verdict,
    base_speed,
    firmware_drive,
    firmware_simulator,
    settles,
    simulate_profile,
)
from dqforge.reports.simulation.recorded_run import Simulator

NAMES = [
    "current step at rest",
    "current step at half of the base speed",
    "torque step at rest",
    "torque step at half of the base speed",
    "small speed step at rest",
    "large speed step at rest",
    "small speed step at half of the base speed",
]


@pytest.fixture(scope="module")
def program() -> Iterator[Simulator]:
    """One program for every structure."""
    with firmware_simulator(vesc(), VALUES) as made:
        yield made


def outcome(found: Verdict, name: str) -> str:
    return next(step.answer.outcome for step in found.tried if step.name == name)


@pytest.mark.slow
@pytest.mark.parametrize("make", EVERY)
def test_every_structure_settles_with_sound_gains(
    program: Simulator, make: Callable[[], LoopProfile]
) -> None:
    found = settles(make(), scooter(), VALUES, program=program)
    assert [step.name for step in found.tried] == NAMES
    assert found.settles, found.reason
    assert found.reason == ""
    assert found.left_out == ()


@pytest.mark.parametrize("name", METHODS)
def test_every_known_firmware_settles_as_it_is_configured(
    program: Simulator, name: Firmware
) -> None:
    profile, told = configured(name)
    found = settles(profile, scooter(), told, program=program)
    assert [step.name for step in found.tried] == NAMES
    assert found.settles, found.reason


def test_the_slow_pole_of_a_phase_locked_loop_ends_in_a_limit_cycle(program: Simulator) -> None:
    """A speed loop of 31 Hz on a speed with a pole at 15 rad/s, between 60 and 120 rad/s."""
    drive = firmware_drive(vesc(), scooter())
    steps = Scenario(3.0, "speed", Profile((0.0, 1.5), (60.0, 120.0)), dead_time=0.0)
    run = simulate_profile(vesc(3e4), VALUES, drive, steps, program=program)
    second = run.omega_m[run.t > 0.5]
    assert -130.0 < np.min(second) < -40.0
    assert 230.0 < np.max(second) < 300.0
    run = simulate_profile(vesc(1e6), VALUES, drive, steps, program=program)
    assert run.omega_m[(run.t > 1.2) & (run.t < 1.5)] == pytest.approx(60.0, abs=0.01)
    assert run.omega_m[run.t > 2.7] == pytest.approx(120.0, abs=0.01)


def test_a_limit_cycle_is_named_with_its_ends(program: Simulator) -> None:
    found = settles(vesc(3e4), scooter(), VALUES, program=program)
    assert not found.settles
    assert [outcome(found, name) for name in NAMES[:4]] == ["settles"] * 4
    assert [outcome(found, name) for name in NAMES[4:]] == ["limit cycle"] * 3
    assert found.reason.startswith("small speed step at rest from 0 rad/s to ")
    assert "limit cycle of the speed between -" in found.reason
    assert len(found.failures) == 3


def changed(**changes: Any) -> LoopProfile:
    """VESC's structure with another q controller."""
    profile = vesc(1e6)
    return replace(
        profile, current=replace(profile.current, q=replace(profile.current.q, **changes))
    )


def test_gains_beyond_the_margin_are_found_unstable(program: Simulator) -> None:
    pi = current_pi(50e-6, 1.3 / 50e-6)
    found = settles(changed(kp=pi.kp, ki=pi.ki), scooter(), VALUES, program=program)
    assert outcome(found, NAMES[0]) in ("limit cycle", "divergence")


def test_a_current_controller_without_integral_leaves_an_error(program: Simulator) -> None:
    found = settles(changed(ki=0.0), scooter(), VALUES, program=program)
    assert outcome(found, NAMES[0]) == "steady error"
    assert "i_q stays at" in found.reason


@pytest.mark.slow
def test_an_integral_too_slow_never_reaches(program: Simulator) -> None:
    """Of the speed: the ramp that it is held to is not over after the longest run."""
    profile = vesc(1e6)
    assert profile.speed is not None
    slow = replace(profile, speed=replace(profile.speed, ramp=1.0))
    found = settles(slow, scooter(), VALUES, program=program)
    assert outcome(found, NAMES[5]) == "never reaches"


@pytest.mark.slow
def test_a_wrong_sign_diverges_or_swings(program: Simulator) -> None:
    found = settles(changed(kp=-0.6, ki=-300.0), scooter(), VALUES, program=program)
    assert not found.settles


def test_an_angle_turned_the_wrong_way_is_found_at_speed(program: Simulator) -> None:
    """Many periods of advance where there is no such delay: at rest all is well."""
    profile = vesc(1e6)
    turned = replace(profile, current=replace(profile.current, angle_advance=-20.0))
    found = settles(turned, scooter(), VALUES, program=program)
    assert outcome(found, NAMES[0]) == "settles"
    assert outcome(found, NAMES[1]) != "settles"


def test_what_cannot_be_tried_is_said(program: Simulator) -> None:
    design = scooter()
    still = replace(design, machine=replace(MACHINE, inertia=None))
    found = settles(vesc(1e6), still, VALUES, program=program)
    assert [step.name for step in found.tried] == NAMES[:4]
    assert "machine.inertia" in found.left_out[0]
    found = settles(replace(vesc(1e6), speed=None), design, VALUES, program=program)
    assert "no speed controller" in found.left_out[0]
    reluctance = make_design(RELUCTANCE)
    profile = replace(vesc(1e6), speed=None)
    pi = replace(profile.current.q, kp=5.0, ki=200.0)
    profile = replace(profile, current=replace(profile.current, d=pi, q=pi))
    values = replace(VALUES, psi_pm=0.0, i_max=20.0)
    found = settles(profile, reluctance, values, program=program)
    assert [step.name for step in found.tried] == NAMES[:2]
    assert "flux linkage" in found.left_out[0]


def test_the_base_speed_takes_the_whole_voltage() -> None:
    profile = vesc()
    machine = replace(MACHINE, omega_m_max=None)
    omega = base_speed(profile, machine, 20.0, 48.0)
    v_d, v_q = MACHINE.voltage(np.array([0.0]), np.array([20.0]), np.array([15.0 * omega]))
    assert float(np.hypot(v_d, v_q)[0]) == pytest.approx(0.95 * 48.0 / 3.0**0.5)
    assert base_speed(profile, replace(MACHINE, omega_m_max=50.0), 20.0, 48.0) == 50.0
    assert base_speed(profile, MACHINE, 600.0, 48.0) == 0.0


def test_a_compiler_is_asked_for_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    hide_compilers(monkeypatch)
    with pytest.raises(VerificationError, match="no C compiler found"):
        settles(vesc(1e6), scooter(), VALUES)


@pytest.mark.slow
def test_a_faster_speed_loop_than_the_hand_written_one_still_settles(program: Simulator) -> None:
    profile = vesc(1e6)
    assert profile.speed is not None
    faster = replace(profile.speed, pi=speed_pi(1e-3, 250.0))
    assert settles(replace(profile, speed=faster), scooter(), VALUES, program=program).settles
