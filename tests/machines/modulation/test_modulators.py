"""Modulators: paper 000 (13) and (14), linear limits, clamping, and the averages over a period."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    clamped_phases,
    in_linear_range,
    linear_limit,
    modulate,
    modulation_index,
    period_waveforms,
    sector_waveforms,
    zero_sequence,
)
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import dq_to_phases

NAMES = tuple(MODULATORS)

names = st.sampled_from(NAMES)
angles = st.floats(-math.pi, math.pi)
v_dcs = st.floats(12.0, 1000.0)
fractions = st.floats(0.0, 1.0)
currents = st.floats(0.0, 500.0)


def phases(amplitude: float, angle: float) -> FloatArray:
    """Return balanced phase values, written out by phase."""
    third = 2.0 * math.pi / 3.0
    return amplitude * np.array([math.cos(angle), math.cos(angle - third), math.cos(angle + third)])


@pytest.mark.parametrize(
    ("name", "current", "expected"),
    [
        ("spwm", [5.0, 0.0, -5.0], 50.0),
        ("svpwm", [5.0, 0.0, -5.0], 45.0),  # (100 - 40 - (-30)) / 2
        ("dpwmmax", [5.0, 0.0, -5.0], 60.0),
        ("dpwmmin", [5.0, 0.0, -5.0], 30.0),
        ("dpwm1", [5.0, 0.0, -5.0], 60.0),  # |v_a| > |v_c|
        ("dpwm3", [5.0, 0.0, -5.0], 30.0),  # |v_a| > |v_c|: phase c
        ("dpwm0", [5.0, 0.0, -5.0], 30.0),  # phase a is 18 degrees past its peak: c rests
        ("dpwm2", [5.0, 0.0, -5.0], 60.0),
        (
            "ddt-gdpwm",
            [6.0, -1.0, -5.0],
            60.0,
        ),  # |i_a| > |i_c|: phase a to the positive rail, 100 - 40
        (
            "ddt-gdpwm",
            [5.0, 1.0, -6.0],
            30.0,
        ),  # |i_a| < |i_c|: phase c to the negative rail, -(-30)
        ("ddt-gdpwm", [5.0, 0.0, -5.0], 60.0),  # equal currents: the positive rail
        ("ddt-gdpwm", [-6.0, 1.0, 5.0], 60.0),  # magnitudes count, not signs
    ],
)
def test_zero_sequence_of_hand_worked_references(
    name: ModulationName, current: list[float], expected: float
) -> None:
    voltage = np.array([40.0, -10.0, -30.0])
    assert zero_sequence(name, voltage, np.array(current), 100.0) == pytest.approx(
        expected, abs=1e-12
    )


@pytest.mark.parametrize(
    ("voltage", "clamped"),
    [
        # all equal: a is the highest, c the lowest, and the highest wins the tie of the currents
        (
            [0.0, 0.0, 0.0],
            0,
        ),
        ([1.0, 1.0, -2.0], 0),
        ([-2.0, 1.0, 1.0], 1),
        ([1.0, -2.0, 1.0], 0),
    ],
)
def test_ties_are_broken_the_same_way_every_time(voltage: list[float], clamped: int) -> None:
    mask = clamped_phases("ddt-gdpwm", np.array(voltage), np.array([3.0, 3.0, -3.0]))
    assert mask.tolist() == [phase == clamped for phase in range(3)]


def test_of_two_equal_lowest_references_the_last_is_the_lowest() -> None:
    mask = clamped_phases("ddt-gdpwm", np.array([2.0, -1.0, -1.0]), np.array([1.0, 2.0, -3.0]))
    assert mask.tolist() == [False, False, True]


@settings(deadline=None)
@given(names, v_dcs, fractions, angles, currents, angles)
def test_duty_cycles_stay_in_range_and_leave_the_line_voltages_alone(
    name: ModulationName,
    v_dc: float,
    fraction: float,
    angle: float,
    current: float,
    current_angle: float,
) -> None:
    voltage = phases(fraction * linear_limit(name, v_dc), angle)
    result = modulate(name, voltage, phases(current, current_angle), v_dc)
    assert np.all(result.duty >= -1e-12)
    assert np.all(result.duty <= 1.0 + 1e-12)
    line = v_dc * (result.duty - np.roll(result.duty, 1))
    np.testing.assert_allclose(line, voltage - np.roll(voltage, 1), rtol=0.0, atol=1e-12 * v_dc)


@settings(deadline=None)
@given(v_dcs, fractions, angles, currents, angles)
def test_ddt_clamps_exactly_one_phase_and_the_one_with_the_larger_current(
    v_dc: float, fraction: float, angle: float, amplitude: float, current_angle: float
) -> None:
    voltage = phases(fraction * linear_limit("ddt-gdpwm", v_dc), angle)
    current = phases(amplitude, current_angle)
    result = modulate("ddt-gdpwm", voltage, current, v_dc)
    assert np.count_nonzero(result.clamped) == 1
    (phase,) = np.flatnonzero(result.clamped)
    assert result.duty[phase] in {0.0, 1.0}
    candidates = [k for k in range(3) if voltage[k] in {voltage.max(), voltage.min()}]
    assert phase in candidates
    assert (
        result.duty[phase] == (1.0 if voltage[phase] == voltage.max() else 0.0)
        or len(candidates) == 3
    )
    if len(candidates) == 2:
        assert abs(current[phase]) == max(abs(current[k]) for k in candidates)


@pytest.mark.parametrize("name", NAMES)
def test_other_modulators_clamp_nothing_and_duty_is_not_clipped(name: ModulationName) -> None:
    wave = period_waveforms(name, 0.0, 1.02 * linear_limit(name, 100.0), 0.0, 1.0, 100.0)
    duty = wave.modulation.duty
    assert np.any(duty > 1.0 + 1e-3) or np.any(duty < -1e-3)
    assert np.all(np.sum(wave.modulation.clamped, axis=-1) == (1 if name in DISCONTINUOUS else 0))


@pytest.mark.parametrize("name", NAMES)
def test_linear_range_ends_where_a_duty_cycle_reaches_a_rail(name: ModulationName) -> None:
    limit = linear_limit(name, 100.0)
    duty = period_waveforms(name, 0.0, limit, 0.0, 1.0, 100.0, angles=1440).modulation.duty
    assert duty.max() == pytest.approx(1.0, abs=1e-5)
    assert duty.min() == pytest.approx(0.0, abs=1e-5)
    amplitudes = np.array([0.0, limit, limit * (1.0 + 1e-15), limit * (1.0 + 1e-6), np.nan])
    assert in_linear_range(name, amplitudes, 100.0).tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("name", "index"),
    [
        ("spwm", 0.785),
        ("thipwm4", 0.881),
        *((name, 0.907) for name in NAMES if name not in {"spwm", "thipwm4"}),
    ],
)
def test_modulation_index_at_the_end_of_the_linear_range(
    name: ModulationName, index: float
) -> None:
    """Hava 1999: 0.785, 0.881 and 0.907 of the six-step voltage."""
    assert modulation_index(np.array(linear_limit(name, 540.0)), 540.0) == pytest.approx(
        index, abs=5e-4
    )


def test_svpwm_adds_half_of_the_middle_reference() -> None:
    """The known form of the SVPWM zero sequence, from the middle of the DC link."""
    wave = period_waveforms("svpwm", 10.0, 30.0, 0.0, 0.0, 100.0)
    middle = np.median(wave.voltage, axis=-1)
    np.testing.assert_allclose(
        wave.modulation.zero_sequence - 50.0, 0.5 * middle, rtol=0.0, atol=1e-12
    )


@settings(deadline=None)
@given(st.floats(-500.0, 500.0), st.floats(-500.0, 500.0), angles)
def test_inverse_park_is_amplitude_invariant_and_undone_by_the_park_transform(
    x_d: float, x_q: float, t: float
) -> None:
    a, b, c = dq_to_phases(np.array(x_d), np.array(x_q), np.array(t)).tolist()
    vector = (
        2.0 / 3.0 * (a + b * np.exp(2j * np.pi / 3) + c * np.exp(-2j * np.pi / 3)) * np.exp(-1j * t)
    )
    assert a + b + c == pytest.approx(0.0, abs=1e-9)
    assert vector == pytest.approx(complex(x_d, x_q), abs=1e-9)


def test_d_axis_lies_on_phase_a_at_angle_zero() -> None:
    np.testing.assert_allclose(
        dq_to_phases(np.array(2.0), np.array(0.0), np.array(0.0)), [2.0, -1.0, -1.0]
    )


@settings(deadline=None)
@given(
    st.floats(-200.0, 200.0),
    st.floats(-200.0, 200.0),
    st.floats(-300.0, 300.0),
    st.floats(-300.0, 300.0),
)
def test_sector_keeps_the_order_of_the_phases_and_its_weights_sum_to_one(
    v_d: float, v_q: float, i_d: float, i_q: float
) -> None:
    wave = sector_waveforms("ddt-gdpwm", v_d, v_q, i_d, i_q, 500.0)
    assert wave.theta_e.shape == wave.weight.shape == (24,)
    assert np.all(wave.weight >= 0.0)
    assert wave.weight.sum() == pytest.approx(1.0, abs=1e-13)
    assert np.all(np.diff(wave.voltage, axis=-1) <= 1e-10)


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("lag", [0.0, 0.3, 0.9, 1.4, 2.2, -0.7, math.pi])
def test_average_over_the_sector_is_the_limit_of_averages_over_the_period(
    name: ModulationName, lag: float
) -> None:
    points = (
        100.0 * math.cos(1.1),
        100.0 * math.sin(1.1),
        50.0 * math.cos(1.1 - lag),
        50.0 * math.sin(1.1 - lag),
    )
    sector = sector_waveforms(name, *points, 300.0)
    exact = sector.phase_sum(np.where(sector.modulation.clamped, 0.0, np.abs(sector.current)))
    for angles_, tolerance in ((1440, 1e-3), (144000, 1e-5)):
        period = period_waveforms(name, *points, 300.0, angles=angles_)
        average = period.phase_sum(np.where(period.modulation.clamped, 0.0, np.abs(period.current)))
        assert average == pytest.approx(exact, rel=tolerance)


def test_waveforms_broadcast_over_operating_points() -> None:
    v_q = np.linspace(10.0, 100.0, 6).reshape(2, 3)
    wave = period_waveforms("svpwm", 5.0, v_q, -3.0, 20.0, 400.0, angles=36)
    assert wave.voltage.shape == wave.current.shape == wave.modulation.duty.shape == (2, 3, 36, 3)
    assert wave.modulation.zero_sequence.shape == (2, 3, 36)
    assert wave.phase_sum(wave.current).shape == (2, 3)
    one = period_waveforms("svpwm", 5.0, v_q[1, 2], -3.0, 20.0, 400.0, angles=36)
    np.testing.assert_array_equal(wave.modulation.duty[1, 2], one.modulation.duty)
