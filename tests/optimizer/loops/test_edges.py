"""Range, resolution and delay of a speed from edges: the thesis' numbers, and shafts that turn."""

from __future__ import annotations

import numpy as np
import pytest
from measured_speeds import METHODS, THESIS, edge_instants, settings

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import SpeedMeasurementSettings
from dqforge.machines.names import SpeedMeasurementName
from dqforge.optimizer.loops.plants import Edges

RPM = np.pi / 30.0
PERIOD = 1e-3


def test_the_numbers_of_the_thesis() -> None:
    # (8.2); 1.024 in its (8.1) and (8.2) are 1,024 lines
    assert Edges(THESIS, PERIOD).largest / RPM == pytest.approx(1_728_000.0, rel=1e-3)
    # "better than 1 % below about 17,280 rpm"
    speed = np.array([17_280.0 * RPM])
    assert Edges(THESIS, PERIOD).resolution(speed) / speed == pytest.approx(0.01, rel=1e-3)
    # "about 26 rpm": the timer runs over
    assert Edges(THESIS, PERIOD).largest / 2**16 / RPM == pytest.approx(26.4, abs=0.1)
    # goes on in 32 bits: a second, whatever the timer
    assert Edges(THESIS, 2e-3).least == pytest.approx(2.0 * np.pi / 1024.0)
    assert Edges(THESIS, PERIOD).longest_period == pytest.approx(2.22e-3, rel=1e-3)


def measured(
    own: SpeedMeasurementSettings, time: FloatArray, theta_m: FloatArray, samples: FloatArray
) -> FloatArray:
    """Speeds in rad/s at the samples by the definition of each method, without a timer's steps."""
    pitch = 2.0 * np.pi / (own.lines * own.edges)
    if own.method == "counts":
        return np.diff(np.floor(np.interp(samples, time, theta_m) / pitch)) * pitch / PERIOD
    edges = edge_instants(own, theta_m, time)
    last = np.searchsorted(edges, samples, side="right") - 1
    if own.method == "capture":
        return np.asarray(pitch / (edges[last] - edges[last - 1])[1:])
    moved = np.maximum(np.diff(last), 1)
    return np.asarray(pitch * moved / (edges[last[1:]] - edges[last[1:] - moved]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("speed", [20.0, 100.0, 400.0])
def test_a_ramp_lags_by_the_mean_delay(method: SpeedMeasurementName, speed: float) -> None:
    # incommensurable with the samples, so that every phase of edges and samples occurs
    own = settings(method, lines=257)
    slope = 2.0 * speed
    time = np.linspace(0.0, 0.2, 400_001)
    theta_m = 0.123 + speed * time + 0.5 * slope * time**2
    samples = np.arange(0.05, 0.199, PERIOD)
    found = measured(own, time, theta_m, samples)
    lag = (speed + slope * samples[1:] - found) / slope
    # counts scatter by whole ones; their mean counts
    middle = speed + slope * 0.125
    expected = float(Edges(own, PERIOD).mean_delay(np.array(middle)))
    scatter = Edges(own, PERIOD).resolution(np.array(middle)) / slope if method == "counts" else 0.0
    bound = 0.06 * expected + float(scatter) / np.sqrt(lag.size) * 3.0
    assert np.mean(lag) == pytest.approx(expected, abs=bound)


@pytest.mark.parametrize("method", METHODS)
def test_a_sine_is_seen_as_the_response_says(method: SpeedMeasurementName) -> None:
    own, mean, frequency = settings(method, lines=1024), 60.0, 2.0 * np.pi * 71.3
    time = np.linspace(0.0, 1.0, 2_000_001)
    swing = 0.02 * mean
    theta_m = mean * time - swing / frequency * np.cos(frequency * time)
    samples = np.arange(0.01, 0.99, PERIOD)
    found = measured(own, time, theta_m, samples)
    turn = np.exp(-1j * frequency * samples[1:])
    seen = 2.0 * np.mean((found - np.mean(found)) * turn) / (-1j * swing)
    wanted = complex(Edges(own, PERIOD).response(mean, np.array([frequency]))[0])
    assert abs(seen - wanted) < 0.02
    assert abs(1.0 - wanted) > 0.02  # a lag that is seen
