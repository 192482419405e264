"""The loops that are judged are those of the emitted step: its derivatives, read in double
precision on fifty random drives, behind machines that are integrated apart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.float_control.current_control import ControlSteps
from dqforge.optimizer.float_control.records import (
    NUMBERS,
    Control,
    ControlGains,
    Measured,
    Pi,
    PiGains,
)
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, closed_matrices
from dqforge.optimizer.loops.plants import speed_loop, speed_step
from dqforge.optimizer.steps.step_arithmetic import EXACT, Abc, AlphaBeta, Dq

DRIVES, T_S = 50, 1e-4
POLE_PAIRS, TORQUE_PER_AMPERE, RATIO = 3.0, 0.7, 4
STEPS = ControlSteps(lambda torque: (0.0 * torque, torque / TORQUE_PER_AMPERE), "svpwm")


def drawn(generator: np.random.Generator, low: float, high: float) -> FloatArray:
    return np.asarray(np.exp(generator.uniform(np.log(low), np.log(high), DRIVES)))


class Drives:
    """Windings and gains, a column of each per drive."""

    def __init__(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self.r_s = drawn(generator, 0.02, 2.0)
        self.l_d, self.l_q = drawn(generator, 0.2e-3, 5e-3), drawn(generator, 0.2e-3, 9e-3)
        bandwidth = drawn(generator, 300.0, 2000.0)
        self.kp = np.array([bandwidth * self.l_d, bandwidth * self.l_q])
        self.ki_ts = bandwidth * self.r_s * T_S * np.array([1.0, 1.2])[:, None]
        self.decoupled = np.array([self.l_d, self.l_q]) * generator.uniform(0.5, 1.5, (2, DRIVES))
        self.omega_e = generator.uniform(-2000.0, 2000.0, DRIVES)
        self.inertia, self.friction = drawn(generator, 1e-4, 1e-2), drawn(generator, 1e-5, 1e-2)
        self.speed_kp = self.inertia * bandwidth / 20.0
        self.speed_ki_ts = 4e-3 * self.speed_kp

    def gains(self, *, decoupled: bool = True, speed: bool = False) -> ControlGains:
        nil = np.zeros(DRIVES)
        numbers: dict[str, Any] = dict.fromkeys(NUMBERS, nil)
        numbers |= {
            "pole_pairs": nil + POLE_PAIRS, "voltage_share": nil + 0.5, "advance": nil + 1.5 * T_S,
            "torque_max": nil + 1e9, "speed_filter": nil + 1.0,
        }  # fmt: skip
        if decoupled:
            numbers |= {"l_d": self.decoupled[0], "l_q": self.decoupled[1]}
        d, q = (PiGains(self.kp[axis], self.ki_ts[axis], nil) for axis in (0, 1))
        loop = PiGains(self.speed_kp, self.speed_ki_ts, nil) if speed else PiGains(nil, nil, nil)
        ratio: Any = np.full(DRIVES, RATIO)
        return ControlGains(d, q, loop, ratio=ratio, **numbers)


def begun(integral: FloatArray) -> Control:
    def nil() -> FloatArray:
        return np.zeros(DRIVES)

    count: Any = np.zeros(DRIVES, dtype=np.int64)
    d, q, speed = (Pi(part) for part in (integral[0], integral[1], nil()))
    return Control(
        d, q, speed, Dq(nil(), nil()), AlphaBeta(nil(), nil()), nil(), nil(), count=count
    )


def sampled(i: FloatArray, omega_m: FloatArray) -> Measured:
    """The sample of currents in rotor coordinates, shape (2, DRIVES), with the rotor at phase a."""
    third = 0.5 * np.sqrt(3.0) * i[1]
    phases = Abc(i[0], -0.5 * i[0] + third, -0.5 * i[0] - third)
    return Measured(phases, np.zeros(DRIVES), omega_m, np.full(DRIVES, 1e9))


def turned(v: FloatArray, angle: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


def test_the_current_loops_that_are_judged_are_the_step_s_derivative() -> None:
    """Of both loops together, while the machine turns: every row of the controller."""
    drives = Drives(1)
    gains, advance = drives.gains(), drives.omega_e * 1.5 * T_S
    for column in range(6):
        x = np.zeros((6, DRIVES))
        x[column] = 1.0
        state = begun(x[4:].copy())
        nil = np.zeros(DRIVES)
        STEPS.current_control(
            EXACT, gains, state, sampled(x[:2], drives.omega_e / POLE_PAIRS), Dq(nil, nil)
        )
        made: Any = np.array([state.v.alpha, state.v.beta])
        found = np.concatenate([turned(made, -advance), [state.d.integral, state.q.integral]])
        for k in range(DRIVES):
            control = CurrentControl(
                (drives.kp[0, k], drives.kp[1, k]),
                (drives.ki_ts[0, k], drives.ki_ts[1, k]),
                drives.decoupled[0, k],
                drives.decoupled[1, k],
                1.5 * T_S,
                T_S,
            )
            r_s, l_d, l_q, omega_e = (
                part[k : k + 1] for part in (drives.r_s, drives.l_d, drives.l_q, drives.omega_e)
            )
            machine = TurningMachines(r_s, l_d, l_q, np.ones(1), omega_e)
            judged = closed_matrices(machine, control)[0]
            size = np.max(np.abs(judged[2:]))
            assert found[:, k] == pytest.approx(judged[2:, column], rel=1e-6, abs=1e-6 * size)


def period(drives: Drives, k: int) -> tuple[FloatArray, FloatArray]:
    """What a period without rotation makes of (i_d, i_q, omega_m), and of a voltage held in it."""
    a = np.zeros((5, 5))
    a[0, 0], a[0, 3] = -drives.r_s[k] / drives.l_d[k], 1.0 / drives.l_d[k]
    a[1, 1], a[1, 4] = -drives.r_s[k] / drives.l_q[k], 1.0 / drives.l_q[k]
    a[2, 1] = TORQUE_PER_AMPERE / drives.inertia[k]
    a[2, 2] = -drives.friction[k] / drives.inertia[k]
    whole = expm(a * T_S)
    return whole[:3, :3], whole[:3, 3:]


@pytest.mark.parametrize("filtered", [1.0, 0.3])
def test_the_speed_loop_that_is_judged_is_the_step_s(filtered: float) -> None:
    """The answer to a step of the speed reference, the currents' loop within, of the axes as they
    are judged: apart, without rotation.
    """
    drives, samples = Drives(2), 60 * RATIO
    gains = replace(
        drives.gains(decoupled=False, speed=True),
        pole_pairs=np.zeros(DRIVES),
        speed_filter=np.full(DRIVES, filtered),
    )
    periods = [period(drives, k) for k in range(DRIVES)]
    phi, gamma = (np.array(part) for part in zip(*periods, strict=True))
    state, x, v = begun(np.zeros((2, DRIVES))), np.zeros((3, DRIVES)), np.zeros((2, DRIVES))
    found = np.empty((samples, DRIVES))
    for sample in range(samples):
        found[sample] = x[2]
        STEPS.speed_control(EXACT, gains, state, sampled(x[:2], x[2]), np.ones(DRIVES))
        x = np.einsum("kij,jk->ik", phi, x) + np.einsum("kij,jk->ik", gamma, v)
        v = np.asarray([state.v.alpha, state.v.beta])
    filter_time = 0.0 if filtered == 1.0 else -T_S / np.log(1.0 - filtered)
    for k in range(DRIVES):
        judged = speed_loop(
            (drives.r_s[k], drives.l_q[k]),
            (drives.inertia[k], drives.friction[k]),
            T_S,
            (drives.kp[1, k], drives.ki_ts[1, k] / T_S),
            RATIO,
            (drives.speed_kp[k], drives.speed_ki_ts[k] / (RATIO * T_S)),
            filter_time,
        )
        expected = speed_step(judged, samples // RATIO).reference
        assert found[:, k] == pytest.approx(expected, abs=1e-6)
