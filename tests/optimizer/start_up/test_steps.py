"""Steps of the start-up against their definitions: the ramp's angle as the integral of its speed,
the hand-over as a turn of the frame that leaves current and voltage where they are, the current of
a short circuit as that of the differential equation.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import NUMBERS, Control, ControlGains, Pi, PiGains
from dqforge.optimizer.start_up.start_parts import Neighbours
from dqforge.optimizer.start_up.start_records import (
    Followed,
    Measured,
    Startup,
    StartupSettings,
)
from dqforge.optimizer.start_up.step import StartupSteps
from dqforge.optimizer.steps.step_arithmetic import EXACT, Abc, AlphaBeta, Arithmetic, Dq

T_S, POLE_PAIRS = 1e-4, 4.0


def number(value: Any) -> Any:
    return np.float64(value)


ZERO = number(0.0)


class _Told(Neighbours):
    """A control that keeps what it was told."""

    def __init__(self) -> None:
        self.samples: Measured | None = None
        self.reference: Dq | None = None

    def current_control(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: ControlGains,  # noqa: ARG002
        state: Control,  # noqa: ARG002
        measured: Measured,
        reference: Dq,
    ) -> Abc:
        self.samples, self.reference = replace(measured), reference
        return Abc(ZERO, ZERO, ZERO)

    def currents(self, torque: Reals) -> Iterable[Any]:
        return -torque / 0.9, torque / 0.3


def made(**changes: Any) -> StartupSettings:
    usual: dict[str, Any] = {member.name: ZERO for member in fields(StartupSettings)}
    usual |= {
        "t_s": number(T_S), "r_s_Ohm": number(0.4), "l_d_H": number(1e-3),
        "l_q_H": number(2e-3), "psi_pm_Wb": number(0.05), "ramp_A": number(5.0),
        "ramp_A_step": number(0.1), "ramp_step": number(0.5),
        "ramp_jerk": number(0.01), "ramp_end": number(200.0), "fade_samples": 10,
        "torque_per_A": number(0.3), "reluctance": number(-0.006), "method": 0,
    }  # fmt: skip
    return StartupSettings(**(usual | changes))


def gains() -> ControlGains:
    pi, numbers = PiGains(ZERO, ZERO, ZERO), dict.fromkeys(NUMBERS, ZERO)
    numbers |= {
        "pole_pairs": number(POLE_PAIRS), "l_d": number(1e-3), "l_q": number(2e-3),
        "psi_pm": number(0.05), "advance": number(1.5 * T_S),
    }  # fmt: skip
    return ControlGains(pi, pi, pi, ratio=ZERO, **numbers)


def drive() -> Startup:
    pair = Dq(ZERO, ZERO)
    control = Control(
        Pi(ZERO), Pi(ZERO), Pi(ZERO), pair, AlphaBeta(*pair), ZERO, ZERO, ZERO, held=pair
    )
    found = Startup.blank(control, Followed(ZERO, ZERO), None, ZERO)
    found.along = Dq(number(1.0), ZERO)
    return found


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_angle_of_the_ramp_is_the_integral_of_a_speed_that_reaches_its_end(
    direction: float,
) -> None:
    told, own, settings = _Told(), drive(), made()
    steps, wanted = StartupSteps(told), number(direction * 300.0)
    speeds, angles = [], []
    for time in range(600):
        own.time = time
        measured = Measured(Abc(ZERO, ZERO, ZERO), ZERO, ZERO, number(300.0))
        acted = AlphaBeta(ZERO, ZERO)
        with np.errstate(invalid="ignore"):  # no current, no active voltage
            steps.ramp(EXACT, gains(), settings, own, measured, acted, wanted)
        assert told.samples is not None
        assert told.samples.omega_m == pytest.approx(own.omega_e / POLE_PAIRS)
        speeds.append(float(own.omega_e))
        angles.append(float(told.samples.theta_e))
    assert np.unwrap(angles) == pytest.approx(T_S * np.cumsum(speeds), abs=1e-9)
    assert speeds[-1] == pytest.approx(direction * 200.0)
    assert np.all(direction * np.diff(speeds) >= 0.0)
    # it rises by the jerk to the acceleration, never faster
    rises = direction * np.diff([0.0, *speeds])
    assert rises[:40] == pytest.approx(0.01 * np.arange(1, 41))
    assert np.max(rises) == pytest.approx(0.5)
    assert told.reference == pytest.approx((5.0, 0.0))


@pytest.mark.parametrize("omega", [150.0, -150.0])
def test_the_hand_over_keeps_current_and_voltage(omega: float) -> None:
    own, settings, control = drive(), made(), gains()
    theta, current, voltage = 0.7, complex(3.0, -2.0), complex(11.0, 4.0)
    own.observer = Followed(number(theta), number(omega))
    own.control.v = AlphaBeta(number(voltage.real), number(voltage.imag))
    seen = AlphaBeta(number(current.real), number(current.imag))
    StartupSteps(_Told()).turn_frame(EXACT, control, settings, own, seen)
    i = current * np.exp(-1j * theta)
    torque = (0.3 - 0.006 * i.real) * i.imag
    held = own.control.held
    assert held is not None
    # what the torque asks for and what is held are the current that flows
    assert (held.d - torque / 0.9, held.q + torque / 0.3) == pytest.approx((i.real, i.imag))
    assert own.control.torque == pytest.approx(torque)
    assert own.control.speed.integral == pytest.approx(torque)
    # integrals and decoupling are the voltage that acts, in the frame of its period's middle
    v = voltage * np.exp(-1j * (theta + 0.5 * T_S * omega))
    d = own.control.d.integral - omega * 2e-3 * i.imag
    q = own.control.q.integral + omega * (1e-3 * i.real + 0.05)
    assert (d, q) == pytest.approx((v.real, v.imag))
    assert (own.fade.d, own.fade.q) == pytest.approx((held.d / 10.0, held.q / 10.0))
    assert own.control.omega_m == pytest.approx(omega / POLE_PAIRS)


@pytest.mark.parametrize("omega", [400.0, -900.0])
def test_the_current_of_a_short_circuit_is_that_of_its_differential_equation(omega: float) -> None:
    settings, duration = made(), 4 * T_S
    found = StartupSteps(_Told()).shorted(EXACT, settings, number(omega), number(duration))
    # d/dt (i_d, i_q, 1) of a machine with no voltage at its terminals
    system = np.array(
        [
            [-0.4 / 1e-3, omega * 2e-3 / 1e-3, 0.0],
            [-omega * 1e-3 / 2e-3, -0.4 / 2e-3, -omega * 0.05 / 2e-3],
            [0.0, 0.0, 0.0],
        ]
    )
    d, q, _ = expm(system * duration) @ np.array([0.0, 0.0, 1.0])
    assert found == pytest.approx(math.atan2(q, d), abs=1e-3)


def test_the_angle_of_a_vector_is_its_arc_tangent() -> None:
    angles = np.linspace(-math.pi, math.pi, 721)[1:-1]
    steps = StartupSteps(_Told())
    found = [steps.angle(EXACT, AlphaBeta(np.cos(one), np.sin(one))) for one in angles]
    assert np.max(np.abs(np.array(found) - angles)) < 1.1e-5
