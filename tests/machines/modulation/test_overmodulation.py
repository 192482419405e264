"""Overmodulation: saturated duty cycles, their fundamental by brute force, and the inverse."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from modulators import duties

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.modulation.switched_period import fundamental, reference_for, saturate
from dqforge.machines.names import ModulationName

SIX_STEP = 2.0 / math.pi
RATIOS = [0.3, 0.51, 0.57, 0.59, 0.64, 0.68, 0.75, 0.9, 1.04, 1.1, 1.2, 2.0, 9.0]


def waves(lag: float = 0.4, count: int = 72000) -> tuple[FloatArray, FloatArray, FloatArray]:
    angle: FloatArray = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False) + math.pi / count
    shift = np.array([0.0, 2.0, -2.0]) * math.pi / 3.0
    turned = angle[:, None] - shift
    return np.asarray(angle), np.asarray(np.cos(turned)), np.asarray(np.cos(turned - lag))


@pytest.mark.thinned
@pytest.mark.parametrize("name", MODULATORS)
def test_fundamental_of_saturated_duty_cycles_in_amplitude_and_phase(name: ModulationName) -> None:
    angle, voltage, current = waves()
    for ratio in RATIOS:
        duty = saturate(name, 400.0 * ratio * voltage, current, 400.0).duty
        assert duty.min() >= 0.0
        assert duty.max() <= 1.0
        phasor = 2.0 * np.mean(duty[:, 0] * np.exp(-1j * angle))
        assert phasor == pytest.approx(
            float(fundamental(name, 400.0 * ratio, 400.0)) / 400.0, abs=2e-9
        )


@pytest.mark.parametrize(
    ("name", "amplitude", "degrees"),
    [
        ("dpwm0", SIX_STEP, -30),
        ("dpwm2", SIX_STEP, 30),
        ("dpwm3", 0.4661, 0),
        ("dpwmmin", 0.5513, 0),
    ],
)
def test_plain_saturation_would_turn_or_lose_the_fundamental(
    name: str, amplitude: float, degrees: float
) -> None:
    """What the module says of modulators whose choice is kept beyond the linear range:
    at a very large reference.
    """
    angle = (np.arange(7200) + 0.5) * (2.0 * math.pi / 7200)
    duty = np.clip([duties(name, 1e4, float(x), 0.0)[0] for x in angle], 0.0, 1.0)
    phasor = 2.0 * np.mean(duty * np.exp(1j * angle))
    assert abs(phasor) == pytest.approx(amplitude, abs=2e-4)
    assert abs(math.degrees(np.angle(phasor))) == pytest.approx(abs(degrees), abs=0.1)


@pytest.mark.parametrize("name", MODULATORS)
def test_linear_range_is_left_alone_and_rests_where_the_modulator_rests(
    name: ModulationName,
) -> None:
    _, voltage, current = waves(count=720)
    plain = modulate(name, 0.45 * voltage, current, 1.0)
    same = saturate(name, 0.45 * voltage, current, 1.0)
    np.testing.assert_allclose(same.duty, plain.duty, rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(same.clamped, plain.clamped)
    ratios = np.linspace(0.0, MODULATORS[name].linear_limit, 50)
    np.testing.assert_array_equal(fundamental(name, ratios, 1.0), ratios)
    np.testing.assert_array_equal(reference_for(name, ratios, 1.0), ratios)


@pytest.mark.parametrize("name", MODULATORS)
def test_gain_rises_steadily_to_six_step(name: ModulationName) -> None:
    end = 2.0 / math.sqrt(3.0) if name in DISCONTINUOUS else 40.0
    made = fundamental(name, np.linspace(0.3, end, 30001), 1.0)
    assert np.all(np.diff(made) > 0.0)
    assert fundamental(name, [np.inf, 1e9], 700.0) == pytest.approx(700.0 * SIX_STEP, rel=1e-12)
    if name in DISCONTINUOUS:
        assert fundamental(name, end, 1.0) == pytest.approx(SIX_STEP, rel=1e-14)
    assert made[-1] <= SIX_STEP


@settings(deadline=None)
@given(st.sampled_from(tuple(MODULATORS)), st.floats(0.0, 1.0), st.floats(10.0, 1000.0))
def test_inverse_is_consistent(name: ModulationName, share: float, v_dc: float) -> None:
    wanted = share * SIX_STEP * v_dc
    assert fundamental(name, reference_for(name, wanted, v_dc), v_dc) == pytest.approx(
        wanted, rel=1e-9, abs=1e-12
    )


def test_ends_of_the_inverse() -> None:
    assert np.isinf(reference_for("svpwm", 300.0 * SIX_STEP, 300.0))
    assert reference_for("dpwm2", 300.0 * SIX_STEP, 300.0) == pytest.approx(
        600.0 / math.sqrt(3.0), rel=1e-9
    )
    assert np.isnan(reference_for("spwm", [191.2, np.nan], 300.0)).all()
    assert reference_for("spwm", np.full((2, 3), 170.0), 300.0).shape == (2, 3)


def test_six_step_duty_cycles() -> None:
    _, voltage, current = waves(count=360)
    for name in sorted(DISCONTINUOUS):
        wave = saturate(name, 1.2 * voltage, current, 1.0)
        np.testing.assert_array_equal(wave.duty, voltage > 0.0)
        assert wave.clamped.all()
