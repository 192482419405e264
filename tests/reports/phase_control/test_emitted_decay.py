"""Currents under the emitted control die out, or grow, at the radius that loops are judged by."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from emitted_decay import EmittedLoop, compiled_loop
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.design import catalogue
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.optimizer.phase_control.floquet import radius
from dqforge.optimizer.phase_control.periodic_step import PhasePlants
from dqforge.optimizer.phase_control.phase_controller import AxisGains, PhaseControl
from dqforge.optimizer.solution import Solution, solve

P, Z = near_sinusoidal(360), trapezoidal(360)
CAPACITANCE = 2e-3
T_S = 1e-4


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(catalogue.load("paper002-phase-waveforms"))


def scaled(control: PhaseControl, factor: float) -> PhaseControl:
    d, q, zero = (AxisGains(factor * gain.kp, factor * gain.ki) for gain in control.gains)
    return replace(control, gains=(d, q, zero))


def plants_of(plant: tuple[float, ...]) -> PhasePlants:
    r_s, l_d, l_q, l_0 = (np.array([size]) for size in plant[:4])
    return PhasePlants(r_s, l_d, l_q, l_0, np.ones(1), np.array([CAPACITANCE]))


def plant_of(control: PhaseControl, share: float = 1.0) -> tuple[float, ...]:
    return (control.r_s, *(share * size for size in control.inductances), CAPACITANCE)


def speed_of(samples: float) -> float:
    return 2.0 * np.pi / (samples * T_S)


def agrees(loop: EmittedLoop, samples: int, share: float = 1.0, factor: float = 1.0) -> float:
    plant, omega = plant_of(loop.control, share), speed_of(samples)
    found = float(radius(scaled(loop.control, factor), plants_of(plant), omega)[0])
    length = samples * max(1, round(12000 / samples))
    starts = np.array([0.382, 1.382, 2.382]) / 3.0 * 2.0 * np.pi / samples
    decay = max(loop.decay(omega, plant, factor, 4000, length, start) for start in starts)
    assert decay == pytest.approx(found, abs=1e-3)
    return decay


@pytest.mark.slow
def test_the_emitted_control_forgets_at_the_radius(solution: Solution, tmp_path: Path) -> None:
    control = plain_control(P, harmonics=None)
    loop = compiled_loop(tmp_path, solution, control)
    for samples, expected in ((200, 0.968), (16, 0.978)):
        assert agrees(loop, samples) == pytest.approx(expected, abs=1e-3)


CASES: list[tuple[Topology, CurrentFrame, Feedforward]] = [
    ("three-wire", "table", "references"),
    ("three-wire", "dqx", "measured"),
    ("six-leg-isolated", "dqx", "emf"),
    ("four-leg", "dqy", "measured"),
    ("four-leg", "dqx", "measured"),
    ("six-leg", "dqy", "references"),
    ("six-leg", "dq", "measured"),
    ("split-capacitor", "table", "references"),
    ("split-capacitor", "dqy", "none"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("topology", "frame", "feedforward"), CASES)
def test_every_frame_and_topology_forgets_at_its_radius(
    topology: Topology,
    frame: CurrentFrame,
    feedforward: Feedforward,
    solution: Solution,
    tmp_path: Path,
) -> None:
    """Alone and with harmonic integrators, the plant as it should be and saturated."""
    for place, harmonics in enumerate((True, False)):
        control = plain_control(Z if frame != "dqy" else P, topology, frame, feedforward)
        if not harmonics:
            control = replace(control, harmonics=None)
        folder = tmp_path / str(place)
        folder.mkdir()
        loop = compiled_loop(folder, solution, control)
        for samples in (200, 40, 24, 16, 12):
            agrees(loop, samples)
        agrees(loop, 40, share=0.6)


@pytest.mark.slow
def test_one_gain_on_all_axes_is_unstable_where_theory_says(
    solution: Solution, tmp_path: Path
) -> None:
    """L_ab/L_0 = 3.18 at 500 Hz and 10 kHz."""
    for ratio, stable in ((3.1, True), (3.3, False)):
        sizes = (8e-3, 8e-3, 8e-3 / ratio)
        control = plain_control(P, frame="dqy", harmonics=None, inductances=sizes)
        d, q, _ = control.gains
        folder = tmp_path / str(ratio)
        folder.mkdir()
        loop = compiled_loop(folder, solution, replace(control, gains=(d, q, d)))
        assert (agrees(loop, 200) < 1.0) is stable
        swing = loop.amplitude(speed_of(200), plant_of(control), 1.0, 20000, 2000)
        assert (swing < 1e-3) is stable
        assert (swing > 1.0) is not stable
