"""Frames along a back-EMF that is known at every angle: their rows, the way back, and the voltage
that currents need which are constant in them.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame
from dqforge.optimizer.phase_control.phase_records import Alphabetazero
from dqforge.optimizer.phase_control.shape_frame import Frame, RotorFrame, shape_frame
from dqforge.optimizer.steps.step_arithmetic import EXACT, Dq, Rotation

PSI, OMEGA = 0.12, -350.0
GAINS: Any = SimpleNamespace(psi_pm=PSI, l_d=4e-3, l_q=7e-3, l_0=2e-3)
THETA = np.linspace(0.1, 6.4, 41)
X = Frame(*np.random.default_rng(6).normal(size=(3, THETA.size)))


def flux(theta: FloatArray) -> Alphabetazero:
    """A back-EMF over the speed whose length and direction change with the angle, in Wb."""
    return Alphabetazero(
        -0.1 * np.sin(theta) + 0.02 * np.sin(5.0 * theta),
        0.11 * np.cos(theta) + 0.01 * np.cos(7.0 * theta),
        0.05 * np.sin(3.0 * theta) + 0.01 * np.cos(theta),
    )


def slope(of: Any) -> list[FloatArray]:
    """Derivative by the angle, by differences of the fourth order."""
    h = 1e-3
    near, far = ([of(THETA + sign * n * h) for sign in (1, -1)] for n in (1, 2))
    return [
        (8.0 * (a - b) - (c - d)) / (12.0 * h)
        for a, b, c, d in zip(*near, *far, strict=True)
    ]  # fmt: skip


F = flux(THETA)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_rows_are_at_right_angles_and_as_long_as_the_shape(frame: CurrentFrame) -> None:
    """In coordinates where a zero sequence counts root 2 times: q along the shape, d at right
    angles in the plane, and zero at right angles to both (dqx leaves it as it is). Roots of 2 are
    those of the firmware, in single precision."""
    along = shape_frame(frame)
    assert along is not None
    one = np.array([F.alpha, F.beta, np.sqrt(2.0) * F.zero])
    if frame == "dqx":
        one[2] = 0.0
    length = np.sqrt(np.sum(one**2, axis=0))
    flat = np.hypot(one[0], one[1])
    q, d = one / length, np.array([one[1], -one[0], 0.0 * flat]) / flat
    zero = np.array([one[2] * q[0], one[2] * q[1], -flat * flat / length]) / flat
    if frame == "dqx":
        zero = np.array([0.0 * flat, 0.0 * flat, np.sqrt(0.5) * PSI / length])
    asked = np.array([X.d, X.q, X.zero])
    seen = along.to_frame(EXACT, F, Alphabetazero(*asked.copy()), np.full(THETA.size, PSI))
    asked[2] *= np.sqrt(2.0)
    for row, found in zip((d, q, zero), (seen.d, seen.q, seen.zero), strict=True):
        np.testing.assert_allclose(found, length / PSI * np.sum(row * asked, axis=0), atol=2e-6)
    back = along.from_frame(EXACT, F, seen, np.full(THETA.size, PSI))
    np.testing.assert_allclose(back, [X.d, X.q, X.zero], atol=2e-6)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_coupling_is_what_inductances_need_as_the_frame_turns(frame: CurrentFrame) -> None:
    along = shape_frame(frame)
    assert along is not None
    x = X if frame == "dqy" else X._replace(zero=np.zeros(THETA.size))
    psi = np.full(THETA.size, PSI)
    rate = slope(lambda theta: along.from_frame(EXACT, flux(theta), x, psi))
    turn = Alphabetazero(*slope(flux))
    found = along.coupling(EXACT, GAINS, F, turn, x, np.full(THETA.size, OMEGA))
    for v, change, inductance in zip(found, rate, (7e-3, 7e-3, 2e-3), strict=True):
        np.testing.assert_allclose(v, OMEGA * inductance * change, rtol=1e-8, atol=1e-8)


def test_coupling_of_rotor_coordinates_is_that_of_both_inductances() -> None:
    turn = Rotation(np.cos(THETA), np.sin(THETA))
    found = RotorFrame().coupling(EXACT, GAINS, Dq(X.d, X.q), turn, np.full(THETA.size, OMEGA))

    def linked(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        d, q = 4e-3 * X.d, 7e-3 * X.q
        return d * np.cos(theta) - q * np.sin(theta), d * np.sin(theta) + q * np.cos(theta)

    for v, change in zip(found, slope(linked), strict=False):
        np.testing.assert_allclose(v, OMEGA * change, rtol=1e-8, atol=1e-8)
    assert not np.any(found.zero)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
@pytest.mark.parametrize("size", [0.0, 0.9e-9])
def test_where_the_shape_vanishes_nothing_comes_back(frame: CurrentFrame, size: float) -> None:
    along = shape_frame(frame)
    assert along is not None
    none = Alphabetazero(np.array([size]), np.zeros(1), np.zeros(1))
    x = Frame(*np.ones((3, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        back = along.from_frame(EXACT, none, x, np.full(1, PSI))
        more = along.coupling(EXACT, GAINS, none, F, x, np.full(1, OMEGA))
    assert not np.any([back.alpha, back.beta])
    assert not np.any([more.alpha, more.beta])
    just = along.from_frame(EXACT, Alphabetazero(np.array([1.1e-9]), *none[1:]), x, np.full(1, PSI))
    assert just.alpha[0] > 0.1 / 1.1e-9 * 0.9


def test_rotor_coordinates_follow_no_shape() -> None:
    assert shape_frame("dq") is shape_frame("table") is None
