"""Verdicts of the model against drives simulated with the emitted control and observer: where a
speed loop becomes stable, by how much it swings, and at wrong data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from observed_runs import (
    Bench,
    bench,
    boundary,
    loaded_scenario,
    random_design,
    swing,
    swings,
    tuned,
    unjudged,
    with_spread,
)

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors
from dqforge.optimizer.control_design.design_drive import (
    largest_stable_factor,
    least_pll_bandwidth,
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import drive_cases
from dqforge.optimizer.control_design.speed_range import SpeedPi, limit_cycle, steady_drives
from dqforge.optimizer.loops.loop_gains import speed_delay
from dqforge.optimizer.loops.pi_methods import calmer, speed_pi

METHODS: list[ObserverMethodName] = [
    "flux", "extended-emf", "smo", "open-loop-flux", "matsui-voltage", "matsui-current", "ekf",
]  # fmt: skip


@pytest.fixture(scope="module")
def flux() -> Iterator[Bench]:
    with bench("flux") as found:
        yield found


def test_the_template_at_600_rpm_is_stable_from_spread_3_73_or_a_loop_of_730_upwards() -> None:
    text = catalogue.template().replace(b"    pole: 400 rad/s\n", b"    method: flux\n")
    design = load_text(text, "template.yaml")
    gains = tuned(design)
    loop, speed, position = design.control.speed_loop, gains.speed, gains.position
    assert loop is not None
    assert speed is not None
    assert position is not None
    machine = design.machine
    drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(position))
    cases = drive_cases(drive.data.machine, [600.0 * np.pi / 30.0 * machine.pole_pairs])
    steady = steady_drives(drive, cases)
    t_sum = speed_delay(gains.i_q, design.control.t_s, loop)

    def slower(factor: float) -> tuple[float, float]:
        return speed_pi(machine.inertia or 0.0, machine.friction, t_sum, calmer(loop, factor))

    factor = largest_stable_factor(steady, loop.ratio, slower)
    assert factor is not None
    assert 3.0 / factor == pytest.approx(3.73, abs=0.02)
    least = least_pll_bandwidth(drive, position, cases, SpeedPi(speed.kp, speed.ki, loop.ratio))
    assert least == pytest.approx(730.0, rel=0.01)


def test_a_drive_swings_below_its_least_spread_and_rests_above(flux: Bench) -> None:
    found = boundary(random_design(np.random.default_rng(1), "flux"))
    assert swings(flux, found, 0.99)
    assert not swings(flux, found, 1.01)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_verdicts_flip_within_one_percent_of_simulated_drives(method: ObserverMethodName) -> None:
    """25 machines of 24 to 560 V, 3 to 80 A, 60 to 350 Hz, 8 to 20 kHz each."""
    generator = np.random.default_rng(1)
    right: list[bool] = []
    with bench(method) as running:
        while len(right) < 25:
            try:
                found = boundary(random_design(generator, method))
            except NoSolutionError:  # not every machine has a Kalman filter
                continue
            right.append(swings(running, found, 0.99) and not swings(running, found, 1.01))
    assert all(right), (method, right)


def swing_ratio(flux: Bench, design: Design) -> tuple[float, float]:
    """Simulated over predicted swing and frequency, far in the unstable range."""
    found = boundary(design)
    factor, machine = 0.75, design.machine
    period = found.ratio * design.control.t_s
    torque_max = machine.torque_per_ampere * machine.i_max
    cycle = limit_cycle(found.pole(factor), period, torque_max, machine.inertia or 0.0)
    assert cycle is not None
    scenario = replace(loaded_scenario(design, found.omega, 0.0, PlantErrors()), duration=3.0)
    run = flux.run(design, found.at(factor), scenario, stride=1)
    late = run.t > 2.0
    tail = run.omega_m[late] - np.mean(run.omega_m[late])
    crossings = np.count_nonzero((tail[:-1] < 0.0) & (tail[1:] >= 0.0))
    return swing(run, 0.3) / cycle.swing, 2.0 * np.pi * crossings / cycle.omega


def test_an_unstable_drive_swings_by_what_is_predicted(flux: Bench) -> None:
    size, frequency = swing_ratio(flux, random_design(np.random.default_rng(5), "flux"))
    assert size == pytest.approx(1.0, abs=0.2)
    assert frequency == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_twenty_unstable_drives_swing_by_what_is_predicted(flux: Bench) -> None:
    generator = np.random.default_rng(5)
    ratios = [swing_ratio(flux, random_design(generator, "flux"))[0] for _ in range(20)]
    assert min(ratios) > 0.8, ratios
    assert max(ratios) < 1.2, ratios


def agreements(
    running: Bench,
    design: Design,
    share: float,
    errors: list[dict[str, float]],
    loaded: float = 0.3,
) -> list[bool]:
    """Whether model and simulation say the same at wrong data under a load, dead time 0."""
    design = with_spread(design, 12.0)
    gains, machine = unjudged(design), design.machine
    loop, speed = design.control.speed_loop, gains.speed
    assert isinstance(loop, SpeedLoopSettings)
    assert speed is not None
    assert gains.position is not None
    omega, load = share * top_speed(design), loaded * machine.torque_per_ampere * machine.i_max
    drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
    found = []
    for wrong in errors:
        cases = drive_cases(drive.data.machine, [omega], [load], wrong)
        stable = steady_drives(drive, cases).radius(loop.ratio, speed.kp, speed.ki)[0] < 1.0
        run = running.run(design, gains, loaded_scenario(design, omega, load, PlantErrors(**wrong)))
        size = omega / machine.pole_pairs
        rests = swing(run, 0.1) < 0.02 * size
        found.append(bool(stable == rests))
    return found


WRONG_R = [{}, {"r_s": 0.3}, {"r_s": -0.3}]


def test_wrong_resistances_do_in_simulation_what_the_model_says(flux: Bench) -> None:
    design = random_design(np.random.default_rng(1), "flux")
    assert all(agreements(flux, design, 0.1, WRONG_R))


@pytest.mark.slow
@pytest.mark.parametrize("loaded", [0.3, -0.3])
def test_wrong_resistances_of_sixteen_drives_do_what_the_model_says(
    flux: Bench, loaded: float
) -> None:
    """Motoring and braking."""
    generator = np.random.default_rng(1)
    found: list[bool] = []
    for _ in range(16):
        found += agreements(flux, random_design(generator, "flux"), 0.1, WRONG_R, loaded)
    assert sum(found) == len(found) == 48
