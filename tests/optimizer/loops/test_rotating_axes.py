"""Both current loops together without tolerances, against a winding that is integrated here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from dqforge.machines.design import catalogue
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains

SATURATED, SLOW = "abb-syrm-6k7-saturated", "control.current_loop.bandwidth=200 Hz"
J = np.array([[0.0, -1.0], [1.0, 0.0]])


def _rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _left_after(gains: GainSet, r_s: float, t_s: float, omega: float, samples: int) -> float:
    """Current in A that is left of 1 A after so many samples at an electrical speed in rad/s."""
    found = gains.rotating
    assert found is not None
    l = np.diag(found.needed)  # noqa: E741
    kp = np.array([gains.i_d.kp, gains.i_q.kp])
    ki_ts = np.array([gains.i_d.ki_ts, gains.i_q.ki_ts])
    # States: current, and a voltage that rests in stationary coordinates while the rotor turns.
    a = np.zeros((4, 4))
    a[:2, :2] = np.linalg.solve(l, -r_s * np.eye(2) - omega * J @ l)
    a[:2, 2:] = np.linalg.inv(l)
    a[2:, 2:] = -omega * J
    period = expm(a * t_s)
    i, integral, acting = np.array([1.0, 0.0]), np.zeros(2), np.zeros(2)
    for _ in range(samples):
        decoupled = omega * J @ (np.array(found.decoupled) * i)
        wanted = -kp * i + integral + decoupled
        integral = integral - ki_ts * i
        nxt = period @ np.concatenate([i, acting])
        i = nxt[:2]
        # Turned ahead of the sample; a period later the rotor has turned by omega t_s.
        acting = _rotation(omega * (CURRENT_DELAY - 1.0) * t_s) @ wanted
    return float(np.hypot(*i))


def test_the_speed_from_which_deviations_grow_is_the_one_that_is_told() -> None:
    design = catalogue.load(SATURATED, [SLOW])
    gains = solve_gains(design)
    found = gains.rotating
    assert found is not None
    assert found.stable_to is not None
    assert found.radius > 1.0
    assert found.better == "raise"
    omega_e = found.stable_to * design.machine.pole_pairs
    r_s, t_s = design.machine.r_s, design.control.t_s
    below, above = (
        _left_after(gains, r_s, t_s, way * factor * omega_e, 6000)
        for way, factor in ((1.0, 0.9), (1.0, 1.1))
    )
    assert below < 1e-3
    assert above > 10.0


@pytest.mark.thinned
def test_the_library_drives_are_stable_up_to_their_speeds() -> None:
    for name in catalogue.names():
        design = catalogue.load(name)
        if design.control.current_loop.switches or design.control.six_step is not None:
            continue
        found = solve_gains(design, proofs=False).rotating
        assert found is None or found.stable_to is None, name


@pytest.mark.parametrize("bandwidth", [200, 400])
def test_a_faster_loop_bears_what_the_decoupling_does_too_much(bandwidth: int) -> None:
    design = catalogue.load(SATURATED, [f"control.current_loop.bandwidth={bandwidth} Hz"])
    found = solve_gains(design, proofs=False).rotating
    assert found is not None
    assert (found.stable_to is None) == (bandwidth == 400)
