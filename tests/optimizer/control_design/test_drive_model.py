"""The drive that loops on an observer are judged with: its winding and shaft against an integrator,
its observers at rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import ComplexArray, plants, steady_voltage
from dqforge.optimizer.control_design.drive_model import (
    OWN,
    DriveData,
    ObservedDrive,
    PositionEstimator,
    SpeedEstimator,
    drive_cases,
    exact_cases,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.reduced_order import reduced_order_observer

T_S = 1e-4
WRONG = {"r_s": 0.3, "l_d": -0.1, "l_q": 0.15, "psi_pm": -0.04, "inertia": 0.2, "v_dc": -0.05}


def known(machine: LinearMachine) -> LinearMachine:

    return replace(machine, inertia=2e-3, friction=1e-3)


def turned(torque: FloatArray, per: complex) -> ComplexArray:
    return np.asarray(torque * per, dtype=np.complex128)


@pytest.mark.parametrize("lost", [0.0, 6.0])
def test_winding_and_shaft_move_as_their_equations_say(lost: float) -> None:
    machine: LinearMachine = known(INVERSE_SALIENT)
    data = DriveData(machine, T_S, ((1.0, 0.1),) * 2, lambda x: turned(x, 1j), 5.0, 1.0)
    drive = ObservedDrive(data, None)  # type: ignore[arg-type]
    omega, i = np.array([500.0, -700.0]), np.array([-3.0 + 8.0j, 2.0 - 0.05j])
    held = np.array([30.0 - 60.0j, -25.0 + 14.0j])
    cases = drive_cases(machine, omega, [1.5, -0.7], WRONG, lost)
    found = drive._moved(cases, i, omega, held)
    p, soft = machine.pole_pairs, 0.02 * machine.i_max
    r, psi = 1.3 * machine.r_s, 0.96 * machine.psi_pm
    l_d, l_q = 0.9 * machine.l_d, 1.15 * machine.l_q
    for n in range(2):

        def slope(_: float, x: FloatArray, n: int = n) -> list[float]:
            d, q, w, theta = x
            along = lost * complex(d, q) / np.sqrt(d * d + q * q + soft * soft)
            v = 0.95 * held[n] * np.exp(-1j * theta) - along
            torque = 1.5 * p * (psi * q + (l_d - l_q) * d * q)
            left = torque - cases.load[n] - machine.friction * w / p
            return [
                (v.real - r * d + w * l_q * q) / l_d,
                (v.imag - r * q - w * (l_d * d + psi)) / l_q,
                p * left / (1.2 * 2e-3),
                w,
            ]

        begin = [i[n].real, i[n].imag, omega[n], 0.0]
        ends = solve_ivp(slope, (0.0, T_S), begin, rtol=1e-11, atol=1e-12).y[:, -1]
        got = [found[0][n].real, found[0][n].imag, found[1][n], found[2][n]]
        # near no current the dead time's voltage turns within a step
        np.testing.assert_allclose(got, ends, rtol=3e-4 if lost else 1e-6, atol=1e-8)


def test_cases_are_broadcast_taken_repeated_and_mixed() -> None:
    machine = known(IPM)
    cases = drive_cases(machine, [100.0, 200.0, 300.0], 2.0, {"r_s": [0.1, 0.0, -0.2]}, 1.5)
    assert cases.r_s == pytest.approx(machine.r_s * np.array([1.1, 1.0, 0.8]))
    assert cases.link == pytest.approx(np.ones(3))
    assert cases.load == pytest.approx(np.full(3, 2.0))
    assert cases.taken(np.array([2, 0])).omega == pytest.approx([300.0, 100.0])
    assert cases.tiled(2).omega == pytest.approx([100.0, 200.0, 300.0] * 2)
    exact = exact_cases(machine, cases)
    assert (exact.lost == 0.0).all()
    assert exact.load == pytest.approx(cases.load)
    middle = cases.towards(exact, 0.25)
    assert middle.r_s == pytest.approx(machine.r_s * np.array([1.075, 1.0, 0.85]))
    assert middle.lost == pytest.approx(np.full(3, 1.125))
    with pytest.raises(InputError, match="error of friction is unknown; write one of r_s"):
        drive_cases(machine, 1.0, errors={"friction": 0.1})
    with pytest.raises(InputError, match="needs the inertia"):
        drive_cases(replace(IPM, inertia=None), 1.0)


@pytest.mark.parametrize("kind", ["speed", "flux"])
def test_an_observer_of_a_steady_drive_stays_where_it_starts(kind: str) -> None:
    machine: Any = known(IPM)
    omega = np.array([400.0, -900.0, 60.0])
    i = np.array([-2.0 + 9.0j, -1.0 - 4.0j, 0.5 + 1.0j])
    v = steady_voltage(plants(machine, count=3), i, omega, T_S)
    if kind == "speed":
        own: Any = SpeedEstimator(reduced_order_observer(machine, 400.0, T_S), machine)
    else:
        method = METHODS["flux"]
        gains = method.design(machine, method.usual(machine, T_S, 1000.0), T_S, 1200.0)
        own = PositionEstimator(method, gains, T_S, machine)
    columns, size = own.start(i, v, omega)
    after, delta, seen = own.step(columns, v, i)
    again = own.turned(after, omega * T_S)
    np.testing.assert_allclose(again, columns, rtol=1e-6, atol=1e-6 * np.max(size))
    assert np.max(np.abs(delta)) < (1e-9 if kind == "speed" else 0.02)
    # without an encoder's error the speed is the true one but for what sampling leaves
    assert np.max(np.abs(seen - omega) / np.abs(omega)) < 0.1
    assert (size > 0.0).all()


def test_a_steady_drive_stands_still_on_its_observer() -> None:
    machine = known(IPM)
    method = METHODS["flux"]
    gains = method.design(machine, method.usual(machine, T_S, 1000.0), T_S, 1200.0)
    data = DriveData(
        machine, T_S, ((3.0, 0.2), (5.0, 0.3)), lambda x: turned(x, -0.3 + 0.8j), 5.0, 0.4
    )  # fmt: skip
    drive = ObservedDrive(data, PositionEstimator(method, gains, T_S, machine))
    i = 3.0 * (-0.3 + 0.8j)
    torque = 1.5 * machine.pole_pairs * (
        machine.psi_pm * i.imag + (machine.l_d - machine.l_q) * i.real * i.imag
    )  # fmt: skip
    friction = machine.friction * np.array([500.0, -800.0]) / machine.pole_pairs
    drive_torque = np.full(2, 3.0)
    cases = drive_cases(machine, [500.0, -800.0], drive_torque - friction)
    states, size, asked = drive.start(cases)
    np.testing.assert_allclose(asked, drive_torque)
    np.testing.assert_allclose(states[:, 0] + 1j * states[:, 1], i)
    # the load that this current holds, whatever the reference calls it
    balanced = drive_cases(machine, [500.0, -800.0], torque - friction)
    after, _ = drive.step(balanced, states, asked)
    np.testing.assert_allclose(after, states, rtol=2e-4, atol=1e-4 * np.max(size[:, :OWN]))
