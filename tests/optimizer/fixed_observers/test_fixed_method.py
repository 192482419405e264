"""Observers in integers beside their models in double precision and the true machine, on the same
trajectories.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from fixed_drives import BENCH, SideBySide, beside, fitted, motion, observed_design, turned

from dqforge.machines.names import (
    LEARNED_OBSERVERS,
    OBSERVER_KEYS,
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    TRACKER_NAMES,
)
from dqforge.machines.plants.scenario import DriveMotion
from dqforge.optimizer.fixed_observers.fixed_observer_fit import FIXED_METHODS

EVERY = pytest.mark.parametrize("name", list(FIXED_METHODS))

FIRST = pytest.mark.parametrize(
    "name",
    [
        "flux",
        *(pytest.param(name, marks=pytest.mark.slow) for name in FIXED_METHODS if name != "flux"),
    ],
)

SAMPLES = 1500

# Degrees and rpm in 16 bits: what docs/methods/position-observers.md states.
Q15_LIMITS = {
    "extended-emf": (0.015, 0.2),
    "smo": (0.015, 0.2),
    "flux": (0.015, 0.2),
    "open-loop-flux": (0.015, 0.2),
    "matsui-voltage": (0.015, 0.7),
    "matsui-current": (0.015, 0.2),
    "ekf": (0.015, 0.4),
}
Q31_LIMITS = (0.003, 0.02)


def both(first: DriveMotion, second: DriveMotion) -> DriveMotion:
    """Drives of two motions side by side."""
    parts = [field.name for field in fields(DriveMotion) if field.name != "t_s"]
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(second, name)], axis=1)
        for name in parts
    }
    return replace(first, **joined)


def steps(name: str) -> DriveMotion:
    """Two steady speeds and a ramp, a step of the load from motoring to braking; then with noise of
    0.2 % of both full scales.
    """
    k = np.arange(SAMPLES)
    ramp = np.interp(k, [0, 200, 1200, SAMPLES], [0.1, 0.1, 0.4, 0.4])
    speeds = np.stack([np.full(SAMPLES, 0.4), np.full(SAMPLES, 0.1), ramp], axis=1)
    torque = np.interp(k, [0, 700, 800, SAMPLES], [0.5, 0.5, -0.3, -0.3])[:, None] + np.zeros(
        (1, 3)
    )
    clean = motion(name, speeds, torque)
    bases = observed_design(name).control.bases
    return both(clean, clean.measured(0.002 * bases.current, 0.002 * bases.voltage, 3))


def true_errors(run: SideBySide) -> tuple[float, float]:
    """Largest errors of the angle in degrees in integers and in double precision."""
    found = [
        float(np.max(np.abs(turned(angle - run.true_angle))[100:]))
        for angle in (run.angle, run.exact_angle)
    ]
    return found[0], found[1]


def test_every_observer_with_a_key_is_there_in_integers() -> None:
    """All but those in single precision alone, trackers and those of six-step drives."""
    single = {*LEARNED_OBSERVERS, *TRACKER_NAMES, *SIX_STEP_METHODS}
    assert {*FIXED_METHODS, SPEED_OBSERVER} | single == set(OBSERVER_KEYS)


@FIRST
def test_q15_stays_beside_double_precision_in_every_step(name: str) -> None:
    run = beside(name, 16, steps(name))
    angle, speed = run.apart(1)
    assert (angle, speed) <= Q15_LIMITS[name]
    assert speed <= Q15_LIMITS[name][1]
    own, exact = true_errors(run)
    assert own <= exact + Q15_LIMITS[name][0]
    assert angle > 1e-4  # the codes are there


SHORT = [
    pytest.param(name, bits)
    for name in FIXED_METHODS
    for bits in (16, 32)
    if (name, bits) != ("ekf", 16)
]


@pytest.mark.parametrize(("name", "bits"), SHORT)
def test_every_observer_follows_a_short_ramp(name: str, bits: int) -> None:
    """Every scale and gain of a method, for a salient machine while speed and load change."""
    k = np.linspace(0.0, 1.0, 120)[:, None]
    speeds, torque = np.hstack([0.4 - 0.2 * k, -0.3 - 0.1 * k]), np.hstack([0.5 - 0.8 * k] * 2)
    drive = "abb-ipmsm-2k2"
    angle, speed = beside(name, bits, motion(name, speeds, torque, drive), drive).apart(1)
    assert angle <= (Q15_LIMITS[name][0] if bits == 16 else 1e-3)
    assert speed <= (2.0 if bits == 16 else 5e-3)


@pytest.mark.slow
@EVERY
def test_q31_stays_beside_double_precision_in_every_step(name: str) -> None:
    run = beside(name, 32, steps(name))
    angle, speed = run.apart(1)
    assert angle <= Q31_LIMITS[0]
    assert speed <= Q31_LIMITS[1]
    own, exact = true_errors(run)
    assert own <= exact + Q31_LIMITS[0]


@pytest.mark.slow
@EVERY
def test_q15_goes_through_a_reversal_as_double_precision_does(name: str) -> None:
    """Where the exact observer loses the angle near standstill, integers lose it alike."""
    k = np.arange(SAMPLES)
    speeds = np.interp(k, [0, 300, 700, SAMPLES], [0.3, 0.3, -0.3, -0.3])[:, None]
    run = beside(name, 16, motion(name, speeds, np.full((SAMPLES, 1), 0.5)))
    assert run.apart(1)[0] <= 0.1
    assert run.apart(900)[0] <= Q15_LIMITS[name][0]
    own, exact = true_errors(run)
    assert abs(own - exact) <= 0.1


@pytest.mark.slow
@EVERY
def test_rounding_leaves_no_dead_band_at_rest(name: str) -> None:
    """In a steady state the mean offsets are below half a code of what is shown: 16 bits of inputs
    and outputs swing around the angle, and no integral stands still beside it.
    """
    count = 1200
    speeds = np.tile([0.4, 0.2, 0.1], (count, 1))
    run = beside(name, 16, motion(name, speeds, np.full((count, 3), 0.5)))
    code = 360.0 / 2**16
    angle = turned(run.angle - run.exact_angle)[-600:]
    assert np.max(np.abs(angle.mean(axis=0))) < 0.5 * code
    speed = (run.speed - run.exact_speed)[-600:]
    one = fitted(name, 16).speed_step * 30.0 / np.pi
    assert np.max(np.abs(speed.mean(axis=0))) < 0.6 * one


@pytest.mark.slow
def test_a_salient_drive_is_held_alike() -> None:
    drive = "abb-ipmsm-2k2"
    assert drive != BENCH
    count = 800
    for name in ("flux", "ekf"):
        seen = motion(name, np.full((count, 1), 0.4), np.full((count, 1), 0.5), drive)
        assert beside(name, 16, seen, drive).apart(1)[0] <= 0.015
