"""The map of starts: cells by single runs of the compiled C, and what is read off it."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import plants, steady_voltage
from dqforge.optimizer.estimator_comparison.candidate import (
    HALF_TURN,
    LOCKED,
    LOST,
    START_ANGLES,
    START_SPEEDS,
    CaptureMap,
    capture_map,
    capture_of,
)
from dqforge.optimizer.observers.conditions import loads_at
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.reports.observers.position_header import observer_files, position_harness


def design_of(method: ObserverMethodName) -> tuple[Design, PositionObserver]:
    design = catalogue.load("paper001-pmsm-bench")
    control = replace(design.control, observer=ObserverSettings(method=method))
    design = replace(design, control=control)
    _, observer = solve_observer(design)
    assert observer is not None
    return design, observer


def compiled(folder: Path, design: Design, observer: PositionObserver) -> Path:
    """The harness of the emitted header, as a programme."""
    for name, content in observer_files(design, observer).items():
        (folder / name).write_bytes(content)
    (folder / "run.c").write_text(position_harness(observer.method.code).source("bench001"))
    command = ["cc", "-std=c99", "-O1", "-ffp-contract=off", "run.c", "-o", "run", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "run"


def one_run(
    programme: Path, design: Design, observer: PositionObserver, omega: float,
    angle: float, speed: float, samples: int,
) -> int:  # fmt: skip
    """What becomes of a start, by the compiled C alone."""
    load = loads_at(design, (0.5,))[0]
    current = complex(load.i_d, load.i_q)
    volts = steady_voltage(
        plants(observer.machine), np.array([current]), np.array([omega]), observer.t_s
    )[0]
    turn = np.exp(1j * omega * observer.t_s * np.arange(samples))
    rows = np.zeros((samples, 7), dtype=np.float32)
    rows[0, :3] = 1.0, angle, omega * (1.0 + speed)
    for column, value in ((3, volts * turn), (5, current * turn)):
        rows[:, column], rows[:, column + 1] = value.real, value.imag
    out = subprocess.run([programme], input=rows.tobytes(), capture_output=True, check=True).stdout
    found = np.frombuffer(out, dtype=np.float32).reshape(-1, 2).astype(np.float64)
    error = np.angle(np.exp(1j * found[:, 0]) / turn)
    end = slice(int(0.75 * samples), None)
    if np.max(np.abs(found[end, 1] / omega - 1.0)) > 0.05:
        return LOST
    if np.max(np.abs(error[end])) < np.radians(10.0):
        return LOCKED
    return HALF_TURN if np.min(np.abs(error[end])) > np.radians(170.0) else LOST


def even_cells(found: CaptureMap) -> np.ndarray:
    """Cells (S, V, A) whose neighbours all fare alike: there single precision moves no border."""
    code = found.outcome
    even = np.zeros(code.shape, dtype=bool)
    inner = code[:, 1:-1, 1:-1]
    same = np.ones(inner.shape, dtype=bool)
    rows, columns = code.shape[1], code.shape[2]
    for i in range(3):
        for j in range(3):
            same &= code[:, i : rows - 2 + i, j : columns - 2 + j] == inner
    even[:, 1:-1, 1:-1] = same
    return even


@pytest.mark.thinned
@pytest.mark.parametrize("method", ["flux", "extended-emf", "matsui-voltage"])
def test_cells_are_what_the_compiled_c_does(method: ObserverMethodName, tmp_path: Path) -> None:
    design, observer = design_of(method)
    found = capture_of(design, observer)
    programme = compiled(tmp_path, design, observer)
    samples = round(found.duration / observer.t_s)
    generator = np.random.default_rng(18)
    even = even_cells(found)
    chosen = [
        cell
        for outcome in (LOCKED, LOST, HALF_TURN)
        for cell in generator.permutation(np.argwhere(even & (found.outcome == outcome)))[:6]
    ]
    assert len(chosen) >= 6
    for s, v, a in chosen:
        omega, angle, speed = found.omega[s], found.angles[a], found.speeds[v]
        single = one_run(programme, design, observer, omega, angle, speed, samples)
        assert single == found.outcome[s, v, a], (s, v, a)


def test_the_true_start_locks_at_once_and_half_a_turn_takes_longer() -> None:
    _, observer = design_of("flux")
    found = capture_map(
        observer,
        1j,
        np.array([0.5 * observer.omega_max]),
        np.radians([-180.0, -90.0, 0.0, 90.0, 180.0]),
        np.array([0.0]),
    )
    times = found.lock_time[0, 0]
    assert times[2] <= 2.0 * observer.t_s
    assert (times[[1, 3]] > times[2]).all()
    assert found.outcome[0, 0, 0] == found.outcome[0, 0, -1]


def test_the_map_covers_a_turn_and_a_start_the_wrong_way_round() -> None:
    assert np.degrees(START_ANGLES[[0, -1]]).tolist() == [-180.0, 180.0]
    assert {-2.0, -1.0, 0.0} <= set(START_SPEEDS.tolist())


def made(outcome: list[list[int]]) -> CaptureMap:
    """Rows of starts at the right speed, at two speeds of the drive."""
    code = np.array(outcome, dtype=np.int8)[:, None, :]
    angles = np.radians([-180.0, -90.0, 0.0, 90.0, 180.0])
    times = np.where(code == LOCKED, 1e-3, np.inf)
    return CaptureMap(np.array([100.0, 200.0]), angles, np.zeros(1), code, times, 0.1)


def test_the_range_ends_at_the_first_start_that_is_lost() -> None:
    found = made([[1, 0, 1, 1, 1], [1, 1, 0, 1, 1]])
    span = found.angle_range()
    assert np.degrees(span[0]) == pytest.approx([0.0, 180.0])
    assert np.isnan(span[1]).all()
    assert found.share == pytest.approx([0.75, 0.75])
