"""Duty cycles of every topology: they make the voltages asked for, all over the region, in double
and in single precision.
"""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import modulate
from dqforge.machines.names import Topology
from dqforge.machines.topologies import (
    TOPOLOGIES,
    duty_cycles,
    phase_voltages,
    shortened,
    voltage_reach,
)
from dqforge.machines.transforms import DOUBLES, Floats, Triple

V_DC = 220.0
NAMES: tuple[Topology, ...] = get_args(Topology)


def directions(count: int = 400, seed: int = 6) -> FloatArray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def acting(topology: Topology, voltages: FloatArray) -> FloatArray:
    """What acts of phase voltages: without a neutral their differences."""
    if TOPOLOGIES[topology].neutral:
        return voltages
    return np.asarray(voltages - np.mean(voltages, axis=-1, keepdims=True))


@pytest.mark.parametrize("topology", NAMES)
@pytest.mark.parametrize("share", [0.2, 0.999999])
def test_duty_cycles_make_the_voltages_of_the_whole_region(
    topology: Topology, share: float
) -> None:
    v_m = 97.0 if TOPOLOGIES[topology].midpoint else None
    wanted = directions()
    wanted *= share * voltage_reach(wanted, topology, V_DC, v_m)[:, np.newaxis]
    duty = duty_cycles(topology, wanted, V_DC, v_m=v_m)
    assert duty.shape == (400, len(TOPOLOGIES[topology].legs))
    assert np.min(duty) > 0.0
    assert np.max(duty) < 1.0
    made = phase_voltages(topology, duty, V_DC, v_m)
    np.testing.assert_allclose(made, acting(topology, wanted), atol=1e-11)


@pytest.mark.parametrize("topology", NAMES)
def test_duty_cycles_saturate_beyond_the_region(topology: Topology) -> None:
    wanted = directions()
    wanted *= 1.01 * voltage_reach(wanted, topology, V_DC)[:, np.newaxis]
    duty = duty_cycles(topology, wanted, V_DC)
    assert np.all(np.any((duty == 0.0) | (duty == 1.0), axis=-1))
    made = phase_voltages(topology, duty, V_DC)
    assert np.all(np.max(np.abs(made - acting(topology, wanted)), axis=-1) > 0.1)


def test_equations_of_four_legs_as_written() -> None:
    """d_k = 1/2 + (v_k + off)/V_dc with off = -(max + min)/2 of {v_a, v_b, v_c, 0}."""
    v = directions() * 40.0
    with_neutral = np.concatenate([v, np.zeros((400, 1))], axis=1)
    off = -0.5 * (np.max(with_neutral, axis=1) + np.min(with_neutral, axis=1))
    expected = 0.5 + (with_neutral + off[:, np.newaxis]) / V_DC
    np.testing.assert_allclose(duty_cycles("four-leg", v, V_DC), expected, atol=1e-14)


def test_equations_of_six_legs_and_a_split_link_as_written() -> None:
    v = directions() * 30.0
    duty = duty_cycles("six-leg", v, V_DC)
    np.testing.assert_allclose(duty[:, :3], 0.5 + v / (2.0 * V_DC), atol=1e-14)
    np.testing.assert_allclose(duty[:, 3:], 0.5 - v / (2.0 * V_DC), atol=1e-14)
    isolated = duty_cycles("six-leg-isolated", v, V_DC)
    middle = 0.5 * (np.max(v, axis=1) + np.min(v, axis=1))
    np.testing.assert_allclose(
        isolated[:, :3], 0.5 + (v - middle[:, np.newaxis]) / (2.0 * V_DC), atol=1e-14
    )
    v_m = np.linspace(90.0, 130.0, 400)
    split = duty_cycles("split-capacitor", v, V_DC, v_m=v_m)
    np.testing.assert_allclose(split, np.clip((v + v_m[:, np.newaxis]) / V_DC, 0.0, 1.0))


@pytest.mark.parametrize("topology", ["three-wire", "diode-neutral"])
def test_three_legs_take_the_modulators_zero_sequence(topology: Topology) -> None:
    v = directions() * 20.0
    centred = modulate("svpwm", v, v, V_DC)
    np.testing.assert_allclose(duty_cycles(topology, v, V_DC), centred.duty, atol=1e-14)
    resting = modulate("dpwmmin", v, v, V_DC)
    found = duty_cycles(topology, v, V_DC, zero_sequence=resting.zero_sequence)
    np.testing.assert_allclose(found, resting.duty, atol=1e-14)


@pytest.mark.parametrize("topology", NAMES)
def test_single_precision_is_close_and_stays_single(topology: Topology) -> None:
    v = directions() * 30.0
    double = duty_cycles(topology, v, V_DC)
    single = duty_cycles(topology, v.astype(np.float32), np.float32(V_DC), number=np.float32)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, double, atol=5e-7)


@pytest.mark.parametrize("topology", NAMES)
def test_without_a_link_all_legs_rest_at_half(topology: Topology) -> None:
    assert np.all(duty_cycles(topology, np.array([10.0, -5.0, 3.0]), 0.0) == 0.5)


@pytest.mark.parametrize("topology", NAMES)
@pytest.mark.parametrize("v_m", [None, 80.0])
def test_shortened_voltages_keep_direction_and_region(
    topology: Topology, v_m: float | None
) -> None:
    wanted = directions() * 150.0
    v, link = Triple(*wanted.T), np.full(400, V_DC)
    middle = None if v_m is None else np.full(400, v_m)
    found, limited = shortened(DOUBLES, topology, v, link, nothing=np.zeros(400), v_m=middle)
    reach = voltage_reach(wanted, topology, V_DC, v_m)
    factor = np.minimum(reach, 1.0)
    np.testing.assert_array_equal(limited, reach < 1.0)
    assert 0 < np.count_nonzero(limited) < 400
    np.testing.assert_allclose(np.stack(found, axis=-1), factor[:, np.newaxis] * wanted, rtol=1e-13)
    single = Floats(np.float32)
    narrow, _ = shortened(
        single,
        topology,
        Triple(*wanted.T.astype(np.float32)),
        link.astype(np.float32),
        nothing=np.zeros(400, dtype=np.float32),
        v_m=None if middle is None else middle.astype(np.float32),
    )
    assert narrow.a.dtype == np.float32
    np.testing.assert_allclose(np.stack(narrow), np.stack(found), rtol=1e-5, atol=1e-4)
