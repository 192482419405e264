"""What overmodulation gives and costs, against the operating points and maps of the same design."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.modulation.registry import METHODS, SIX_STEP
from dqforge.machines.names import OvermodulationName
from dqforge.optimizer.operating_points.characteristics import (
    characteristics,
    limited_drive,
    map_within,
    points_within,
)
from dqforge.optimizer.overmodulation import solve_overmodulation


def drive(method: OvermodulationName = "least-phase-error", **keys: str) -> Design:
    given = {"overmodulation_limit": "100 %"} | keys
    settings = [f"operation.{key}={value}" for key, value in given.items()]
    return catalogue.load(
        "abb-ipmsm-2k2", (f"operation.overmodulation={method}", "inverter.v_dc=420 V", *settings)
    )


@pytest.mark.parametrize("method", METHODS)
def test_largest_torque_and_its_ripple_over_speed(method: OvermodulationName) -> None:
    design = drive(method)
    found = solve_overmodulation(design)
    assert found is not None
    assert found.v_max == pytest.approx(420.0 * SIX_STEP)
    assert found.linear_v_max == pytest.approx(420.0 / math.sqrt(3.0))
    assert found.index[0] == pytest.approx(math.pi / (2.0 * math.sqrt(3.0)))
    assert found.voltage[-1] == pytest.approx(1.0 / np.array(found.orders), rel=1e-3)
    largest = found.largest
    assert largest is not None
    points, ripple = largest.points, largest.harmonics
    assert np.all(points.reached | (points.torque > 0.0))
    assert np.all(points.torque > largest.linear_torque)
    assert np.all(ripple.index <= 1.0 + 1e-9)
    # at the base speed the currents of MTPA take all of the voltage
    assert points.omega_m[3] == pytest.approx(largest.figures.base_speed)
    assert ripple.index[3] == pytest.approx(1.0, rel=1e-6)
    assert points.omega_m[-1] == pytest.approx(design.machine.omega_m_max)
    gain = largest.figures.power_max / largest.linear_figures.power_max
    assert 1.08 < gain < 1.12  # the voltage is 10 % more
    plain = characteristics(design.machine, found.linear_v_max, design.i_max)
    assert plain == largest.linear_figures
    # the same point asked for by itself
    asked = points_within(
        limited_drive(design), float(points.torque[-1]) * 0.9, float(points.omega_m[-1])
    )
    assert asked.harmonics is not None
    assert 0.5 < float(asked.harmonics.torque[0] / ripple.torque[-1]) < 1.1


def test_maps_reach_further_and_margin_and_limit_count() -> None:
    linear = catalogue.load("abb-ipmsm-2k2", ("inverter.v_dc=420 V",))
    least, some, most = (
        map_within(limited_drive(design), 3, 3).figures.base_speed
        for design in (linear, drive(overmodulation_limit="95 %"), drive())
    )
    assert least < some < most
    less = solve_overmodulation(drive(speed="1200 rpm", voltage_margin="10 %"))
    assert less is not None
    assert less.v_max == pytest.approx(0.9 * 420.0 * SIX_STEP)
    assert less.limit == pytest.approx(1.0)


def test_nothing_without_the_key_and_no_torque_without_mtpa() -> None:
    linear = catalogue.load("abb-ipmsm-2k2")
    assert solve_overmodulation(linear) is None
    assert points_within(limited_drive(linear), 5.0, 100.0).harmonics is None
    other = solve_overmodulation(drive(strategy="id0"))
    assert other is not None
    assert other.largest is None
