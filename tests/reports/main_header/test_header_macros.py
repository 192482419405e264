"""Macros of the header and the numbers of its comments against values computed by hand
or from first principles.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design
from scipy.linalg import expm
from scipy.optimize import brentq

from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files

OMEGA = 6283.0  # bandwidth of the current loops of `make_design`, in rad/s
T_S = 1e-5
CURRENT, VOLTAGE, SPEED, TORQUE = 250.0, 288.675, 942.0, 240.0


@pytest.fixture(scope="module")
def found() -> Solution:
    """The drive of `make_design` with an inverter that allows less current than the machine."""
    design = make_design()
    inverter = replace(design.inverter, i_max=CURRENT)
    bases = replace(design.control.bases, current=CURRENT)
    return solve(replace(design, inverter=inverter, control=replace(design.control, bases=bases)))


@pytest.fixture(scope="module")
def text(found: Solution) -> str:
    return header_files(found)["drive.h"].decode("ascii")


@pytest.fixture(scope="module")
def macros(text: str) -> dict[str, float]:
    lines = re.findall(r"#define DRIVE_(\w+) \(([-0-9.e+]+)F?\) /\*", text)
    return {name: float(value) for name, value in lines}


def test_machine_and_sampling(macros: dict[str, float]) -> None:
    expected = {
        "POLE_PAIRS": 4,
        "R_S_OHM": 2e-3,
        "L_D_H": 350e-6,
        "L_Q_H": 592e-6,
        "PSI_PM_WB": 0.1049,
        "CURRENT_MAX_A": CURRENT,
        "BASE_CURRENT_A": CURRENT,
        "BASE_VOLTAGE_V": VOLTAGE,
        "BASE_SPEED_RAD_PER_S": SPEED,
        "BASE_TORQUE_NM": TORQUE,
        "T_S_S": T_S,
        "SPEED_RATIO": 10,
    }
    assert {name: macros[name] for name in expected} == pytest.approx(expected, rel=1e-7)


def test_largest_torque_is_that_of_the_current_limit(macros: dict[str, float]) -> None:
    angle = np.linspace(0.5 * np.pi, np.pi, 200_001)
    i_d, i_q = CURRENT * np.cos(angle), CURRENT * np.sin(angle)
    assert macros["TORQUE_MAX_NM"] == pytest.approx(
        np.max(6.0 * (0.1049 - 242e-6 * i_d) * i_q), rel=1e-7
    )


@pytest.mark.parametrize(("axis", "inductance"), [("ID", 350e-6), ("IQ", 592e-6)])
def test_current_controllers(macros: dict[str, float], axis: str, inductance: float) -> None:
    kp, ki = OMEGA * inductance, OMEGA * 2e-3
    expected = {
        "KP_V_PER_A": kp,
        "KI_V_PER_AS": ki,
        "KI_TS_V_PER_A": ki * T_S,
        "T_I_S": inductance / 2e-3,
        "ANTI_WINDUP_PER_S": 2e-3 / inductance,
        "KP_PU": kp * CURRENT / VOLTAGE,
        "KI_TS_PU": ki * T_S * CURRENT / VOLTAGE,
    }
    assert {name: macros[f"{axis}_{name}"] for name in expected} == pytest.approx(
        expected, rel=1e-6
    )


def test_speed_controller(macros: dict[str, float], found: Solution) -> None:
    """Symmetrical optimum, a = 3: T = 1/crossover of the current loop + half a speed sample;
    T_i = a^2 T.
    """
    delay = 1.0 / found.gains.i_q.crossover + 5.0 * T_S
    kp, t_i = 0.05 / (3.0 * delay), 9.0 * delay
    expected = {
        "KP_NMS_PER_RAD": kp,
        "KI_NM_PER_RAD": kp / t_i,
        "KI_TS_NMS_PER_RAD": kp / t_i * 10.0 * T_S,
        "T_I_S": t_i,
        "ANTI_WINDUP_PER_S": 1.0 / t_i,
        "KP_PU": kp * SPEED / TORQUE,
        "KI_TS_PU": kp / t_i * 10.0 * T_S * SPEED / TORQUE,
    }
    assert {name: macros[f"SPEED_{name}"] for name in expected} == pytest.approx(expected, rel=1e-6)


def test_observer_macros_follow_the_sampled_machine(macros: dict[str, float]) -> None:
    """An exact estimate stays exact for any current, speed and voltage, and an error decays
    with the asked pole 500/s.

    zeta = omega + C i_q for the exact estimate, now and after one sample of the
    machine with held voltage.
    """
    a = np.array(
        [
            [-2e-3 / 592e-6, -4 * 0.1049 / 592e-6, 1 / 592e-6],
            [6.0 * 0.1049 / 0.05, 0.0, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    step = expm(a * T_S)[:2]  # from (i_q, omega, u_q) to the next (i_q, omega)
    c = macros["OBSERVER_C_RAD_PER_AS"]
    after = step[1] + c * step[0]
    observed = np.array(
        [macros["OBSERVER_B_I_RAD_PER_AS"] + macros["OBSERVER_A"] * c, macros["OBSERVER_A"]]
    )
    np.testing.assert_allclose(observed, after[:2], rtol=1e-6)
    assert macros["OBSERVER_B_U_RAD_PER_VS"] == pytest.approx(after[2], rel=1e-6)
    assert macros["OBSERVER_A"] == pytest.approx(math.exp(-500.0 * T_S), rel=1e-7)


def open_loop(frequency: float) -> complex:
    """PI with cancelled pole, one sample of computation and a zero-order hold on the q axis,
    at a frequency in Hz.
    """
    z = np.exp(2j * np.pi * frequency * T_S)
    decay = math.exp(-2e-3 / 592e-6 * T_S)
    controller = OMEGA * 592e-6 + OMEGA * 2e-3 * T_S * z / (z - 1.0)
    return complex(controller * (1.0 - decay) / (2e-3 * z * (z - decay)))


def test_margins_in_the_comments_are_those_of_the_sampled_loop(text: str) -> None:
    block = text.partition("PI controller of i_q")[2]
    crossover, phase, gain = (
        float(value)
        for value in re.findall(
            r"Crossover ([\d.]+) Hz, phase margin ([\d.]+) deg, gain margin ([\d.]+) dB", block
        )[0]
    )
    delay, sensitivity = (
        float(v) for v in re.findall(r"margin ([\d.]+) samples.* M_s ([\d.]+)\.", block)[0]
    )
    exact = brentq(lambda f: abs(open_loop(f)) - 1.0, 100.0, 5000.0)
    margin = math.pi + np.angle(open_loop(exact))
    turn = brentq(lambda f: open_loop(f).imag, 5000.0, 40_000.0)
    assert crossover == pytest.approx(exact, rel=1e-3)
    assert phase == pytest.approx(math.degrees(margin), abs=0.06)
    assert gain == pytest.approx(-20.0 * math.log10(abs(open_loop(turn))), abs=0.06)
    assert delay == pytest.approx(margin / (2.0 * math.pi * exact * T_S), abs=0.006)
    scan = max(1.0 / abs(1.0 + open_loop(f)) for f in np.linspace(100.0, 49_900.0, 5000))
    assert sensitivity == pytest.approx(scan, abs=0.01)


def test_stated_errors_are_shares_of_the_largest_torque(
    text: str, macros: dict[str, float], found: Solution
) -> None:
    torque, percent = (
        float(value) for value in re.findall(r"torque ([-\d.e]+) N m \(([-\d.e]+) % of", text)[0]
    )
    assert percent == pytest.approx(100.0 * torque / macros["TORQUE_MAX_NM"], rel=0.02)
    assert torque >= found.fit.errors.torque
    loss, loss_percent = (
        float(v)
        for v in re.findall(r"copper loss ([-\d.e]+) W above the least \(([-\d.e]+) %", text)[0]
    )
    # Currents at 5 % of the largest torque, with hardly any i_d, and at all of it:
    # between them the share is stated.
    least, most = (
        1.5 * 2e-3 * (0.05 * macros["TORQUE_MAX_NM"] / (6.0 * 0.1049)) ** 2,
        1.5 * 2e-3 * CURRENT**2,
    )
    assert 0.01 * loss_percent * least * 0.9 <= loss <= 0.01 * loss_percent * most
