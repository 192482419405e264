"""Observer and phase-locked loop of ST's Workbench: integers of public projects, poles by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.optimizer.firmware.st_scales import (
    ObservedMachine,
    constants,
    flux_of,
    observer_integers,
    observer_poles,
    placed_poles,
    tracking,
    tracking_integers,
)

# Machine, pole pairs, F1, F2, GAIN1, GAIN2, PLL_KP_GAIN, PLL_KI_GAIN; gains of the amplifiers with
# the digits that the headers cut off (9.14, 7.33, 4.57).
BUS = 3.3 / math.sqrt(3.0) / 0.09625565501973242
Project = tuple[ObservedMachine, int, int, int, int, int, int, int]
PROJECTS: tuple[Project, ...] = (
    (
        ObservedMachine(0.35, 0.0006, 4.0, 4000, 1.65 / (0.003 * 9.1361), BUS, 20e3),
        *(2, 16384, 1024, -24217, 26260, 213, 8),
    ),
    (
        ObservedMachine(0.1, 1e-5, 0.3, 23322, 1.65 / (0.01 * 7.333), 47.63, 16e3),
        *(2, 2048, 16384, -2112, 5727, 1551, 69),
    ),
    (
        ObservedMachine(0.18, 0.00015, 1.9, 10000, 1.65 / (0.003 * 4.5678), BUS, 16e3),
        *(2, 16384, 2048, -23654, 17959, 665, 29),
    ),
    (
        ObservedMachine(0.14, 0.000021, 1.0, 7500, 1.65 / (0.003 * 9.1356), BUS, 20e3),
        *(7, 16384, 8192, -20480, 18494, 1397, 49),
    ),
    (
        ObservedMachine(0.1, 0.00002, 0.4, 10002, 1.65 / (0.003 * 9.1361), BUS, 16e3),
        *(7, 16384, 8192, -20736, 24504, 2328, 103),
    ),
)


@pytest.mark.parametrize("project", PROJECTS, ids=("g431", "car", "wireless", "demo", "servo"))
def test_integers_of_projects(project: Project) -> None:
    machine, pairs, f1, f2, gain_1, gain_2, kp, ki = project
    found = observer_integers(machine)
    assert (found["F1"], found["F2"]) == (f1, f2)
    assert abs(found["GAIN1"] - gain_1) <= 1
    assert abs(found["GAIN2"] - gain_2) <= 1
    loop = tracking_integers(pairs, machine.speed, machine.rate)
    assert (loop["PLL_KP_GAIN"], loop["PLL_KI_GAIN"]) == (kp, ki)


def test_version_5_leaves_no_room_in_the_back_emf() -> None:
    """A project of Workbench 5.1 for the motor of the first one, on another power stage."""
    machine = replace(PROJECTS[0][0], current=1.65 / (0.01 * 5.18), room=1.0)
    assert abs(observer_integers(machine)["GAIN2"] - 17101) <= 1


def test_integers_place_the_poles() -> None:
    """Where whole volts of the back-EMF and rounded ones are the same; two poles that nearly
    coincide move by the root of what the integers cut off.
    """
    for machine, *_ in PROJECTS:
        exact = replace(machine, speed=machine.speed * 10.2 / machine.emf_scale)
        own = dict(observer_integers(exact))
        found = sorted(abs(pole) for pole in placed_poles(own, exact))
        assert found == pytest.approx(sorted(observer_poles(machine.decay)), abs=0.03)


def test_poles_are_those_of_the_difference_equations() -> None:
    """Errors of current and back-EMF run through the firmware's equations in real numbers."""
    machine = PROJECTS[0][0]
    own = dict(observer_integers(machine))
    k1, k2 = own["GAIN1"] / own["F1"], own["GAIN2"] / own["F2"]
    back = math.floor(machine.emf_scale) / machine.volt_seconds
    step = np.array([[1.0 - machine.decay + k1, -back], [k2, 1.0]])
    wanted = sorted(abs(np.linalg.eigvals(step)))
    assert sorted(abs(pole) for pole in placed_poles(own, machine)) == pytest.approx(wanted)


def test_a_microhenry_overflows_before_it_is_flashed() -> None:
    """With the factor of a larger motor C5 leaves 16 bits at some microhenries; the factor that is
    chosen keeps all constants within.
    """
    car = PROJECTS[1][0]
    small = replace(car, inductance=1e-6)
    assert constants(small, 2048)["C5"] > 32767
    limit = min(
        x
        for x in np.arange(1, 100) * 1e-7
        if constants(replace(car, inductance=x), 2048)["C5"] <= 32767
    )
    assert 8e-6 < limit < 9e-6
    found = observer_integers(replace(small, r_s=0.01))
    assert found["F1"] in (128, 256)
    assert max(abs(v) for v in constants(small, found["F1"]).values()) <= 32767
    assert observer_integers(replace(car, inductance=1e-10))["F1"] == 0


def test_the_phase_locked_loop_slows_down_with_the_speed() -> None:
    own = {
        "PLL_KP_GAIN": 213,
        "PLL_KI_GAIN": 8,
        "PLL_KPDIV": 16384,
        "PLL_KIDIV": 65535,
        "PWM_FREQUENCY": 20000,
        "MAX_APPLICATION_SPEED_RPM": 4000,
    }
    full, slow = (tracking(own, rpm * math.pi / 30.0) for rpm in (4000.0, 1000.0))
    assert full is not None
    assert slow is not None
    assert slow.kp == pytest.approx(full.kp / 4.0)
    assert slow.ki == pytest.approx(full.ki / 4.0)
    # 213/16384 of 27306 counts, each 1/65536 turn, 20000 times a second
    assert full.kp == pytest.approx(213 / 16384 * 32767 / 1.2 * 2 * math.pi / 65536 * 20e3)
    for pole in slow.poles:
        assert pole * pole + slow.kp * pole + slow.ki == pytest.approx(0.0, abs=1e-6 * slow.ki)


def test_a_faster_loop_is_damped_at_its_least_speed() -> None:
    found = tracking_integers(2, 4000.0, 20e3, faster=10.0)
    own = dict(found) | {"PWM_FREQUENCY": 20000, "MAX_APPLICATION_SPEED_RPM": 4000}
    loop = tracking(own, 0.36 * 4000 * math.pi / 30.0)
    assert loop is not None
    assert 0.5 * loop.kp / math.sqrt(loop.ki) == pytest.approx(1.0 / math.sqrt(2.0), rel=1e-2)


def test_flux_of_a_voltage_constant() -> None:
    # 4 V r.m.s. line to line at 1000 rpm: 3.266 V peak of phase at 104.72 rad/s, 2 pole pairs
    assert flux_of(4.0, 2) == pytest.approx(4.0 * math.sqrt(2.0 / 3.0) / 104.71976 / 2.0)
