"""What a dead time keeps up in a loop that closes over an observer, against the simulated drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario, constant
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.observed_margins import DeadTimeCycle
from dqforge.reports.observers.speed_loop_text import observed_notes
from dqforge.reports.simulation.design_run import simulate_design

BENCH = catalogue.load("paper001-pmsm-bench")


def optimum(spread: float) -> Design:
    control = replace(
        BENCH.control,
        current_loop=CurrentLoopSettings(method="symmetrical-optimum"),
        speed_loop=SpeedLoopSettings(ratio=10, spread=spread),
    )
    return replace(BENCH, control=control)


def predicted(design: Design) -> DeadTimeCycle | None:
    found = solve_gains(design).speed
    assert found is not None
    assert found.observed is not None
    return found.observed.relay


def swing(design: Design, dead_time: float | None = None) -> tuple[float, float]:
    """Frequency in rad/s and amplitude in A of the largest part of i_q at 300 rpm without load,
    after a push.
    """
    speed = 300.0 * np.pi / 30.0
    scenario = Scenario(
        duration=1.0,
        mode="speed",
        reference=constant(speed),
        omega_m=speed,
        encoder=Encoder(0, "observer"),
        load=Profile((0.0, 0.2, 0.22), (0.0, 0.1, 0.0)),
        dead_time=dead_time,
    )
    run = simulate_design(replace(design, simulation=scenario)).run
    i_q = run.i_q[run.t > 0.5]
    parts = 2.0 * np.abs(np.fft.rfft(i_q - np.mean(i_q))) / i_q.size
    place = int(np.argmax(parts))
    return 2.0 * np.pi * place / (i_q.size * design.control.t_s), float(parts[place])


@pytest.mark.parametrize("design", [BENCH, optimum(3.0)], ids=["given", "optimum"])
def test_the_simulated_drive_swings_as_predicted(design: Design) -> None:
    found = predicted(design)
    assert found is not None
    omega, current = swing(design)
    assert omega == pytest.approx(found.omega, rel=0.05)
    assert 0.5 < current / found.current < 2.0
    assert found.swing == pytest.approx(
        2.0 * 1.5 * 3.0 * 0.06 * found.current / (200e-6 * found.omega), rel=1e-9
    )
    free = 4.0 * found.lost / (np.pi * found.resistance)
    assert found.current == pytest.approx(min(free, design.i_max))
    assert found.limited == (free > design.i_max)
    assert swing(design, 0.0)[1] < 1e-3  # nothing but the dead time makes it


def test_a_slower_loop_rests_and_is_what_the_note_asks_for() -> None:
    assert predicted(optimum(8.6)) is None
    assert swing(optimum(8.6))[1] < 0.02
    gains = solve_gains(optimum(3.0)).speed
    (note,) = [text for text in observed_notes(gains) if "keeps up a swing" in text]
    assert "250 Hz" in note
    assert "compensate the dead time, or make the loop slower" in note
    assert "spread = 8.49" in note


def test_without_a_dead_time_or_an_observer_there_is_none() -> None:
    inverter = replace(BENCH.inverter, dead_time=0.0)
    assert predicted(replace(BENCH, inverter=inverter)) is None
    assert predicted(make_design(SURFACE)) is None


def test_the_describing_function_is_that_of_a_relay() -> None:
    """The fundamental of a square wave over the sine that makes it."""
    found = predicted(BENCH)
    assert found is not None
    turn = np.linspace(0.0, 2.0 * np.pi, 20_001)[:-1]
    relay = found.lost * np.sign(found.current * np.sin(turn))
    share = 2.0 * float(np.mean(relay * np.sin(turn))) / found.current
    assert share == pytest.approx(found.resistance, rel=1e-3)
