"""The emitted measurement of the speed: equal to its model, near the true speed, read back, in the
loop.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_speeds import METHODS, THESIS, design, edge_instants, settings

from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import SpeedMeasurementName
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.solution import solve
from dqforge.reports.run import export_design, verify_folder
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.single_headers.speed_measurement import (
    SAMPLE,
    EdgeNumbers,
    EdgeState,
    edge_events,
    edge_numbers,
    edge_rows,
    numbers_from,
    plain_numbers,
)

RPM = np.pi / 30.0


def numbers(method: SpeedMeasurementName) -> EdgeNumbers:
    found = solve_gains(design(settings(method))).measured_speed
    assert found is not None
    return edge_numbers(found, 500.0, ("float32", "q15", "q31"))


@pytest.mark.thinned
@pytest.mark.parametrize("method", METHODS)
def test_run_emits_a_verified_header_that_fails_when_changed(
    method: SpeedMeasurementName, tmp_path: Path
) -> None:
    for name, content in export_design(design(settings(method)), verify=False).files.items():
        (tmp_path / name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "drive_speed_measurement.h"
    text = header.read_text()
    changed = text.replace("state->count = ", "state->count = 1 + ", 1)
    assert changed != text
    header.write_text(changed)
    with pytest.raises(VerificationError, match="results of the speed measurement differ"):
        verify_folder(tmp_path)


def test_the_thesis_integers() -> None:
    found = solve_gains(design(settings("capture"))).measured_speed
    assert found is not None
    own = edge_numbers(
        replace(found, edges=replace(found.edges, settings=THESIS)), 6750.0 * RPM, ("q15",)
    )
    ((width, code),) = own.codes
    assert width == 16
    # (8.6): 2^23; the clock of 33.9 ns is rounded
    assert code == pytest.approx(2**23, rel=1e-3)
    exact = replace(own, codes=((16, 2**23),))
    state = EdgeState(exact)
    for stamp in (0, 1000, 2000):
        state.edge(stamp, 1)
    state.sample(2001)
    assert state.row()[1] == 2**23 // 1000


@pytest.mark.parametrize("method", METHODS)
def test_events_reach_rest_turn_and_overflow(method: SpeedMeasurementName) -> None:
    own = numbers(method)
    events = edge_events(own, 20_000, 3)
    speeds = edge_rows(own, events)[events[:, 0] == SAMPLE, 0].copy().view(np.float32)
    assert (speeds > 0.0).any()
    assert (speeds < 0.0).any()
    assert (speeds == 0.0).any()
    assert np.isfinite(speeds).all()


@pytest.mark.parametrize("method", ["capture", "mixed"])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_steady_speed_is_found_within_a_tick(method: SpeedMeasurementName, sense: int) -> None:
    own, wanted, speed = numbers(method), settings(method), 37.3
    time = np.linspace(0.0, 0.1, 1001)
    edges = edge_instants(wanted, speed * time, time)
    state, period = EdgeState(own), 1e-3
    asked = np.arange(period, 0.1, period)
    for instant, kind in sorted([(float(t), 0) for t in edges] + [(float(t), 1) for t in asked]):
        ticks = int(instant * wanted.clock) & 0xFFFFFFFF
        if kind == 0:
            state.edge(ticks, sense)
        else:
            state.sample(ticks)
            if instant > 0.02:
                found = float(np.uint32(state.row()[0]).view(np.float32))
                assert found == pytest.approx(sense * speed, rel=1.5 / state.span)


def test_counted_edges_are_the_way_between_two_samples() -> None:
    """The way in whole numbers, the counter running over both ends of its 32 bits."""
    found = solve_gains(design(settings("counts"))).measured_speed
    assert found is not None
    own, turn = numbers("counts"), 4 * 1024
    ways = [0, 5, -7, turn, -turn, 2**31 - 1, -(2**31), 2**31 - 1, -3]
    state, position = EdgeState(own), 2**32 - 3
    state.sample(position)
    for way in ways:
        position += way
        state.sample(position % 2**32)
        bits, q15, q31 = state.row()
        exact = 2.0 * np.pi * way / turn / found.edges.period
        assert float(np.uint32(bits).view(np.float32)) == pytest.approx(exact, rel=1e-6)
        for code, width in ((q15, 16), (q31, 32)):
            signed = (code + 2**31) % 2**32 - 2**31
            most = 2 ** (width - 1) - 1
            wanted = float(np.clip(exact / 500.0 * 2.0 ** (width - 1), -most, most))
            # one edge is a whole number of codes, within half a code
            assert signed == pytest.approx(wanted, abs=0.5 * abs(way) + 1.0)


@pytest.mark.parametrize("method", ["capture", "mixed"])
def test_a_word_ends_nothing(method: SpeedMeasurementName) -> None:
    """Edges a thousand ticks apart while timer and 32 bits run over, then a turn, a rest."""
    own = numbers(method)
    state, least = EdgeState(own), float(own.scale) / 1000.0

    def speed() -> float:
        return float(np.uint32(state.row()[0]).view(np.float32))

    time = 2**32 - 40_500
    for edge in range(90):
        state.edge(time % 2**32, 1)
        if edge % 3 == 2:
            state.sample((time + 1) % 2**32)
            assert speed() == pytest.approx(least, rel=1e-6)
        time += 1000
    state.edge(time % 2**32, -1)
    state.sample((time + 1) % 2**32)
    assert speed() == 0.0
    state.edge((time + 1000) % 2**32, -1)
    state.sample((time + 1001) % 2**32)
    assert speed() == pytest.approx(-least, rel=1e-6)
    state.sample((time + 5000) % 2**32)
    assert speed() == pytest.approx(-float(own.scale) / 4000.0, rel=1e-6)
    for _ in range(own.patience):
        state.sample((time + 5000) % 2**32)
    assert speed() == 0.0


def test_numbers_read_back() -> None:
    own = numbers("mixed")
    plain = json.loads(json.dumps(plain_numbers(own)))
    assert numbers_from(plain) == own
    for key, value in (("method", "guess"), ("mask", -1), ("scale", "x"), ("codes", [[7, 1]])):
        with pytest.raises(InputError, match="speed_measurement_header"):
            numbers_from(plain | {key: value})


@pytest.mark.thinned
@pytest.mark.parametrize("method", METHODS)
def test_the_loop_settles_on_the_measured_speed(method: SpeedMeasurementName) -> None:
    own = settings(method)
    reference = Profile((0.0, 0.1, 0.25), (40.0, -60.0, 120.0))
    scenario = Scenario(
        duration=0.45,
        mode="speed",
        reference=reference,
        encoder=Encoder(own.lines, "measured", 0.0, own.edges, own.clock),
    )
    base = replace(design(own), simulation=scenario)
    found = simulate_design(base, solution=solve(base))
    assert len(found.steps) == 3
    for step in found.steps:
        assert abs(step.error) < 0.2
        assert step.overshoot < 0.6
    seen = found.run.omega_m_measured
    assert np.max(np.abs(seen - found.run.omega_m)) < 40.0
    assert len(np.unique(seen)) > (10 if method == "counts" else 50)
