"""How long a simulation takes against the time it simulates: printed,
never asserted (run with ``-m benchmark -s``).
"""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.plants.scenario import Scenario, constant
from dqforge.optimizer.solution import solve
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.simulation.design_run import controller_files, drive_of
from dqforge.reports.simulation.recorded_run import simulate, simulate_many, simulator

pytestmark = pytest.mark.benchmark


@pytest.mark.parametrize(
    "name", ["paper001-pmsm-bench", "paper000-ipmsm-100kw", "baldor-pmsyrm-5k6"]
)
def test_one_second_of_drive_time(name: str) -> None:
    design = catalogue.load(name)
    solution = solve(design)
    drive = drive_of(design)
    scenario = Scenario(1.0, "speed", constant(50.0))
    start = time.perf_counter()
    with simulator(controller_files(solution), design.export.prefix) as program:
        compiled = time.perf_counter() - start
        spent = {}
        for inverter in ("averaged", "switched"):
            start = time.perf_counter()
            simulate(program, drive, replace(scenario, inverter=inverter))
            spent[inverter] = time.perf_counter() - start
        gains = gain_bytes(plain_control(solution))
        start = time.perf_counter()
        simulate_many(program, [(drive, replace(scenario, duration=0.05), gains)] * 100)
        many = (time.perf_counter() - start) / 100.0 / 0.05
    samples = 1.0 / design.control.t_s
    print(
        "\n"
        f"{name}, {samples:,.0f} samples per second of drive time: compiling {compiled:.2f} s, "
        f"averaged {spent['averaged']:.3f}, switched {spent['switched']:.3f}, in a batch "
        f"{many:.3f} seconds per second",
        end="",
    )
