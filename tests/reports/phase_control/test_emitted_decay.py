"""Currents under the emitted control die out, or grow, at the radius that loops are judged by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from emitted_decay import EmittedLoop, compiled_loop
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.design import catalogue
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import Profile, Scenario, constant
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.phase_control.judged_box import PhasePlants, radius
from dqforge.optimizer.phase_control.phase_controller import AxisGains, MidpointGains, PhaseControl
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import simulate, simulator

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


@dataclass(frozen=True)
class RandomDrive:
    """A drive drawn at random, its speed in samples per period, and the gains' limit.

    ``limit`` is the factor on all gains at which the radius is one.
    """

    control: PhaseControl
    samples: int
    limit: float


def random_drive(seed: int) -> RandomDrive:
    """Any shape, three phases alike or not, any topology and frame; gains raised to their limit."""
    rng = np.random.default_rng(seed)
    topology = list(get_args(Topology))[seed % 6]
    frames: tuple[CurrentFrame, ...] = ("dq", "table", "dqx", "dqy")
    frames = frames if TOPOLOGIES[topology].neutral else frames[:3]
    frame = frames[int(rng.integers(len(frames)))]
    feedforward: Feedforward = ("references", "emf", "none", "measured")[int(rng.integers(4))]
    orders = np.array([1, 2, 3, 5, 7, 9])
    sizes = 0.2 * np.array([1.0, 0.04, 0.2, 0.08, 0.04, 0.03]) * rng.uniform(0.3, 1.0, 6)
    unlike = 1.0 + 0.1 * rng.uniform(-1.0, 1.0, (3, 6)) * (seed % 2)
    lag = np.outer(np.arange(3), orders) * 2.0 * np.pi / 3.0 + 0.3 * rng.standard_normal(6)
    plane = float(10.0 ** rng.uniform(-3.5, -2.0))
    machine = PhaseMachine.from_harmonics(
        orders, sizes * unlike, lag, pole_pairs=int(rng.integers(1, 6)),
        r_s=plane * float(rng.uniform(30.0, 300.0)), l_s=plane * 0.8, m_s=-plane * 0.2, i_max=10.0,
        angles=360,
    )  # fmt: skip
    l_0 = plane * float(rng.uniform(0.3, 1.2))
    salient = frame == "dq" and rng.uniform() < 0.3
    l_q = plane * (1.8 if salient else 1.0)
    control = plain_control(
        machine, topology, frame, feedforward, bandwidth=float(rng.uniform(150.0, 500.0)),
        inductances=(plane, l_q, l_0),
    )  # fmt: skip
    omega_c = control.gains[0].kp / plane
    d, q, zero = (
        AxisGains(omega_c * size, 0.1 * omega_c**2 * size) for size in control.inductances
    )
    none = AxisGains(0.0, 0.0)
    control = replace(control, gains=(d, q, zero if TOPOLOGIES[topology].neutral else none))
    if rng.uniform() < 0.5:
        control = replace(control, harmonics=None)
    if control.midpoint is not None:
        # 20 rad/s on the capacitance of all of these drives.
        control = replace(control, midpoint=MidpointGains(20.0 * CAPACITANCE / 3.0, 10.0))
    samples = int(rng.integers(20, 120))
    plants = plants_of(plant_of(control))
    low, high = 0.05, 40.0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        stable = radius(scaled(control, middle), plants, speed_of(samples))[0] < 1.0
        low, high = (middle, high) if stable else (low, middle)
    return RandomDrive(control, samples, low)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_drives_just_beyond_the_limit_oscillate_and_just_inside_decay(
    seed: int, solution: Solution, tmp_path: Path
) -> None:
    """Four per cent in all gains to either side; the radius in time agrees on both."""
    drive = random_drive(seed)
    assert 0.06 < drive.limit < 39.0
    loop = compiled_loop(tmp_path, solution, drive.control)
    plant, omega = plant_of(drive.control), speed_of(drive.samples)
    for side in (0.96, 1.04):
        factor = side * drive.limit
        decay = agrees(loop, drive.samples, factor=factor)
        swing = loop.amplitude(omega, plant, factor, 30000, 2000)
        if side < 1.0:
            assert decay < 1.0
            assert swing < 0.1  # noise of float32 at the edge of stability
        else:
            assert decay > 1.0
            assert 20.0 < swing < 1e6


PLANT = near_sinusoidal(720)

LINK = 6000.0  # V: nothing is shortened


def difference_dies(solution: Solution, control: PhaseControl, samples: int, periods: int) -> float:
    """What is left per sample, in the compiled simulation, of a torque that was asked for at first.

    The difference of two runs moves as if references and back-EMF were zero.
    """
    omega_m = speed_of(samples) / PLANT.pole_pairs
    capacitance = 4e-3 if control.topology == "split-capacitor" else None
    inverter = replace(
        solution.design.inverter,
        topology=control.topology, v_dc=LINK, midpoint_capacitance=capacitance,
    )  # fmt: skip
    drive = Drive(solution.design.machine, inverter, T_S, 1, PLANT)
    first, last = 4 * samples, (4 + periods) * samples
    runs = []
    with simulator(
        header_files(solution) | phase_control_files(solution, control),
        solution.design.export.prefix, (), control.topology,
    ) as program:  # fmt: skip
        for torque in (0.0, 2.0):
            asked = Profile((0.0, first * T_S), (torque, 0.0))
            scenario = Scenario(
                (last + 1) * T_S, "torque", asked,
                shaft=constant(omega_m), omega_m=omega_m, dead_time=0.0,
            )  # fmt: skip
            found = simulate(program, drive, scenario)
            runs.append(np.stack([found.i_d, found.i_q, found.i_zero]))
    left = np.linalg.norm(runs[1] - runs[0], axis=0)
    start = first + samples  # by then the slowest part is all that is left
    return float((left[last] / left[start]) ** (1.0 / (last - start)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topology", "frame", "feedforward", "samples", "periods"),
    [
        ("four-leg", "table", "references", 40, 6),
        ("six-leg", "dqx", "emf", 24, 10),
        ("four-leg", "dqy", "references", 40, 6),
        ("three-wire", "table", "measured", 16, 40),
        ("four-leg", "dqy", "measured", 24, 8),
    ],
)
def test_a_torque_in_the_compiled_plant_is_forgotten_at_the_radius(
    topology: Topology,
    frame: CurrentFrame,
    feedforward: Feedforward,
    samples: int,
    periods: int,
    solution: Solution,
) -> None:
    control = plain_control(P, topology, frame, feedforward, harmonics=None)
    found = float(radius(control, plants_of(plant_of(control)), speed_of(samples))[0])
    decay = difference_dies(solution, control, samples, periods)
    assert decay == pytest.approx(found, abs=3e-3 if feedforward == "measured" else 1e-3)
