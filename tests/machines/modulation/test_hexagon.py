"""Overmodulation on the hexagon: fundamental, geometry, and what the duty cycles make of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.modulation.registry import (
    HEXAGON,
    INSCRIBED,
    METHODS,
    SIX_STEP,
    follows_hexagon,
    overmodulated,
)
from dqforge.machines.modulation.switched_period import fundamental, reference_for
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.transforms import Pair

V_DC = 540.0
CORNERS = 2.0 / 3.0 * np.exp(1j * np.pi / 3.0 * np.arange(7))


def turning(count: int = 7200) -> FloatArray:
    return np.asarray((np.arange(count) + 0.5) * (2.0 * math.pi / count))


def made(
    name: OvermodulationName, index: float, angle: FloatArray, number: type = np.float64
) -> NDArray[np.complex128]:
    """Vectors over v_dc for a turning one of an asked amplitude over v_dc."""
    axes: list[Any] = [
        np.asarray(index * V_DC * part(angle), dtype=number) for part in (np.cos, np.sin)
    ]
    x, y = overmodulated(name, Pair(axes[0], axes[1]), np.full(angle.shape, V_DC, dtype=number))
    assert x.dtype == number
    return np.asarray((x.astype(np.float64) + 1j * y) / V_DC)


def phases(vector: NDArray[np.complex128]) -> FloatArray:
    shift = np.exp(-2j * math.pi / 3.0 * np.array([0.0, 1.0, 2.0]))
    return np.asarray((vector[..., None] * shift).real)


@pytest.mark.parametrize("number", [np.float32, np.float64])
@pytest.mark.parametrize("name", METHODS)
def test_fundamental_is_the_one_asked_for_up_to_six_step(
    name: OvermodulationName, number: type
) -> None:
    angle = turning()
    for index in np.linspace(0.5, SIX_STEP, 120):
        found = np.mean(made(name, index, angle, number) * np.exp(-1j * angle))
        assert abs(found - index) < 3.2e-5 * index


@pytest.mark.parametrize("name", METHODS)
def test_vectors_lie_in_the_hexagon_and_the_circle_in_it_is_left_alone(
    name: OvermodulationName,
) -> None:
    angle = turning(2400)
    for index in np.linspace(INSCRIBED * 1.0001, SIX_STEP, 40):
        span = np.ptp(phases(made(name, index, angle)), axis=-1)
        assert span.max() == pytest.approx(1.0, abs=1e-12)
    vector = made(name, INSCRIBED * 0.9999, angle)
    assert np.array_equal(vector * V_DC, INSCRIBED * 0.9999 * V_DC * np.exp(1j * angle)) or (
        np.abs(vector - INSCRIBED * 0.9999 * np.exp(1j * angle)).max() < 1e-15
    )
    beyond = made(name, 3.0, angle)  # more than there is makes six-step operation
    nearest = np.abs(beyond[:, None] - CORNERS).min(axis=1)
    assert np.mean(nearest > 1e-9) < 2e-3


def test_least_phase_error_keeps_the_direction_below_the_hexagon() -> None:
    angle = turning(2400)
    for index in np.linspace(INSCRIBED, HEXAGON * 0.9999, 12):
        turned = made("least-phase-error", index, angle) * np.exp(-1j * angle)
        assert np.abs(np.angle(turned)).max() < 1e-12
        # shortened onto the hexagon, or a circle within
        radius = np.max(np.abs(turned))
        side = INSCRIBED / np.cos(np.mod(angle, math.pi / 3.0) - math.pi / 6.0)
        assert np.abs(turned) == pytest.approx(np.minimum(radius, side), abs=1e-12)


def test_hexagon_at_constant_speed_has_the_fundamental_of_the_books() -> None:
    # Holtz 1993: the first range ends at the modulation index 0.952
    assert pytest.approx(0.952, abs=1e-3) == HEXAGON / SIX_STEP
    angle = turning()
    side = INSCRIBED / np.cos(np.mod(angle, math.pi / 3.0) - math.pi / 6.0)
    assert np.mean(side) == pytest.approx(HEXAGON, abs=1e-7)
    vector = made("least-phase-error", HEXAGON, angle)
    # 1e-3 V per V: the polynomial ends that far from the corner, where the gain is flat
    assert np.abs(vector) == pytest.approx(side, abs=1.5e-3)


def test_least_magnitude_error_is_the_nearest_point_of_the_hexagon() -> None:
    """By brute force over the points of the hexagon's sides, for the circle of which
    saturated space-vector modulation makes the fundamental.
    """
    angle = turning(360)
    share = np.linspace(0.0, 1.0, 4001)[:, None]
    border = (CORNERS[:-1] * (1.0 - share) + CORNERS[1:] * share).ravel()
    for index in (0.58, 0.6, 0.606, 0.6095, 0.62, 0.635):
        radius = float(reference_for("svpwm", index, 1.0))
        asked = radius * np.exp(1j * angle)
        nearest = border[np.argmin(np.abs(asked[:, None] - border), axis=1)]
        beyond = np.ptp(phases(asked), axis=-1) > 1.0
        wanted = np.where(beyond, nearest, asked)
        found = made("least-magnitude-error", index, angle)
        assert np.abs(found - wanted).max() < 1.5e-3  # 4 of them are the polynomial's


def test_least_magnitude_error_is_fed_as_saturated_space_vector_modulation() -> None:
    """The closed form of the duty cycles' saturation gives the fundamental of the same radius."""
    method = METHODS["least-magnitude-error"]
    for index in np.linspace(INSCRIBED, SIX_STEP * 0.9999, 200):
        if index < method.turning:
            radius = np.polyval(method.arc[::-1], math.sqrt(method.arc_end - index))
        else:
            radius = 1.0 / np.polyval(method.hold[::-1], math.sqrt(SIX_STEP - index))
        assert float(fundamental("svpwm", radius, 1.0)) == pytest.approx(index, rel=3e-5)


def held_corners(stretch: float) -> float:
    """Fundamental where the place along the side is stretched: the integrals in closed form."""
    edge = math.atan(1.0 / (math.sqrt(3.0) * stretch))
    sine = math.sin(edge)
    moving = (sine + stretch * (math.atanh(sine) - sine)) / math.sqrt(3.0)
    return 6.0 / math.pi * (moving + 2.0 / 3.0 * math.sin(math.pi / 6.0 - edge))


def shortened(radius: float) -> float:
    """Fundamental where a circle is shortened onto the hexagon, in closed form."""
    edge = math.acos(1.0 / (math.sqrt(3.0) * radius))
    moving = math.atanh(math.sin(edge)) / math.sqrt(3.0)
    return 6.0 / math.pi * (moving + radius * (math.pi / 6.0 - edge))


def test_polynomials_of_least_phase_error_invert_the_closed_forms() -> None:
    method = METHODS["least-phase-error"]
    for index in np.linspace(INSCRIBED * 1.0001, HEXAGON, 400):
        radius = float(np.polyval(method.arc[::-1], math.sqrt(HEXAGON - index)))
        clipped = min(max(radius, INSCRIBED), 2.0 / 3.0)
        assert abs(radius - clipped) < 1.1e-3
        assert shortened(clipped) == pytest.approx(index, rel=3.2e-5)
    for index in np.linspace(HEXAGON, SIX_STEP * 0.99999, 400):
        hold = float(np.polyval(method.hold[::-1], math.sqrt(SIX_STEP - index)))
        assert held_corners(1.0 / hold) == pytest.approx(index, rel=4e-6)


@pytest.mark.parametrize("modulation", MODULATORS)
@pytest.mark.parametrize("name", METHODS)
def test_duty_cycles_make_the_vector_with_every_modulator_that_follows_the_hexagon(
    name: OvermodulationName, modulation: ModulationName
) -> None:
    angle = turning(720)
    current = phases(6.0 * np.exp(1j * (angle - 0.5)))
    worst = 0.0
    for index in (0.4, 0.575, 0.59, 0.606, 0.62, SIX_STEP):
        wanted = phases(made(name, index, angle)) * V_DC
        duty = np.clip(modulate(modulation, wanted, current, V_DC).duty, 0.0, 1.0)
        made_of = V_DC * (duty - duty.mean(axis=-1, keepdims=True))
        worst = max(worst, float(np.abs(made_of - wanted).max()))
    if follows_hexagon(modulation):
        assert worst < 1e-9
    else:
        assert worst > 1.0  # the corners are not to be had: such modulators are refused


def test_without_a_link_and_without_numbers_nothing_is_changed() -> None:
    values = np.array([1.0, 500.0, math.nan, 500.0, 300.0], dtype=np.float32)
    link = np.array([0.0, 0.0, 540.0, math.nan, -540.0], dtype=np.float32)
    zero = np.zeros(5, dtype=np.float32)
    for name in METHODS:
        with np.errstate(invalid="ignore"):
            found = overmodulated(name, Pair(values, zero), link)
        assert np.array_equal(found.x, values, equal_nan=True)
        assert np.array_equal(found.y, zero)
    kept: Any = Pair(values, zero)
    assert overmodulated("none", kept, link) is kept
