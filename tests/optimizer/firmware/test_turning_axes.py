"""Both current loops of a firmware while the machine turns: against the emitted control's own map,
the loops alone, and the same recursion run step by step in the stator's frame.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    Winding,
    current_loop,
    turning_axes,
    turning_matrix,
)
from dqforge.optimizer.firmware.firmware_method import judge
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, closed_matrices

R, L_D, L_Q, T = 0.05, 8e-5, 1.4e-4, 5e-5
KP, KI = (0.35, 0.6), (300.0, 320.0)


def loops(**changes: Any) -> CurrentLoops:
    d, q = (PiController(kp, ki, T) for kp, ki in zip(KP, KI, strict=True))
    return replace(CurrentLoops(d, q, 1.0, cross=True, angle_advance=1.5), **changes)


def radius(matrix: np.ndarray) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


@pytest.mark.parametrize("omega", [0.0, 900.0, -4000.0])
def test_the_neutral_structure_has_the_poles_of_the_emitted_control(omega: float) -> None:
    one = np.ones(1)
    emitted = CurrentControl(KP, (KI[0] * T, KI[1] * T), L_D, L_Q, 1.5 * T, T)
    machines = TurningMachines(R * one, L_D * one, L_Q * one, one, omega * one)
    expected = np.linalg.eigvals(closed_matrices(machines, emitted)[0])
    found = np.linalg.eigvals(turning_matrix(R, (L_D, L_Q), loops(), omega))
    found = found[np.argsort(-np.abs(found))][: len(expected)]
    assert np.sort(np.abs(found)) == pytest.approx(np.sort(np.abs(expected)), abs=1e-9)


def test_at_rest_the_axes_are_the_loops_alone() -> None:
    filtered = replace(loops().d, filter_time=1e-4, rule="trapezoid")
    made = loops(d=filtered, delay=0.5)
    found = radius(turning_matrix(R, (L_D, L_Q), made, 0.0))
    alone = [
        abs(current_loop(Winding(R, inductance), pi, 0.5).closed.poles[0])
        for inductance, pi in ((L_D, made.d), (L_Q, made.q))
    ]
    assert found == pytest.approx(max(alone), abs=1e-9)


@pytest.mark.parametrize(
    ("delay", "advance", "cross", "time"), [(0.5, 0.0, False, 0.0), (1.5, 2.0, True, 2e-4)]
)
def test_the_map_is_the_recursion_in_small_steps(
    delay: float, advance: float, cross: bool, time: float
) -> None:
    """A machine without saliency as one complex current in the stator's frame."""
    omega, inductance, fine = 3000.0, 1e-4, 400
    pi = PiController(0.4, 500.0, T, "integral-last", filter_time=time)
    made = CurrentLoops(pi, pi, delay, cross=cross, angle_advance=advance)
    matrix = turning_matrix(R, (inductance, inductance), made, omega)

    current, measured, integral, held = 1.0 + 0.5j, 0.0j, 0.0j, {}
    share, last = T / (T + time), []
    for k in range(120):
        seen = current * cmath.exp(-1j * omega * k * T)  # in the rotor's frame
        last.append(seen)
        measured += share * (seen - measured)
        voltage = -pi.kp * measured + integral
        integral -= pi.ki * T * measured
        voltage += 1j * omega * inductance * measured if cross else 0.0
        held[k] = voltage * cmath.exp(1j * omega * (k + advance) * T)
        for n in range(fine):
            acting = held.get(math.floor(k + (n + 0.5) / fine - delay), 0.0j)
            decay = math.exp(-R / inductance * T / fine)
            current = decay * current + (1.0 - decay) / R * acting
    state = np.zeros(len(matrix))
    state[:2] = 1.0, 0.5
    for expected in last:
        assert complex(state[0], state[1]) == pytest.approx(expected, abs=2e-6)
        state = matrix @ state


def test_without_decoupling_a_slow_sampling_is_unstable_at_speed_and_said_to_be() -> None:
    bare = loops(cross=False, angle_advance=0.0)
    drive = DriveValues(15, R, L_D, L_Q, 6.1e-3, omega_m_max=1200.0)
    judged = judge(LoopProfile("vesc", "test", bare), drive)
    assert judged.current_d is not None
    assert judged.current_d.stable
    assert judged.turning is not None
    assert judged.turning.unstable_from is not None
    assert (
        "both current loops together are unstable as vesc runs them from about"
        in (judged.remarks[0])
    )
    calm = turning_axes(R, (L_D, L_Q), loops(), 15, 300.0)
    assert calm.unstable_from is None
    assert calm.radius < 1.0
