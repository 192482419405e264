"""The emitted float32 controller against what the analysis says: stable at every
corner of 2,000 random drives.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import CurrentLoopMethod
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, constant
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, largest_pole
from dqforge.optimizer.loops.pi_methods import current_pi
from dqforge.reports.control.header import gain_bytes
from dqforge.reports.papers.transients import Bench, bench
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Summary, simulate_many

V_DC = 400.0
METHODS: tuple[CurrentLoopMethod, ...] = (
    "bandwidth",
    "damping",
    "magnitude-optimum",
    "symmetrical-optimum",
)


@dataclass(frozen=True)
class RandomDrive:
    """A drive with tuned gains and its tolerances (r_s, l_d, l_q, v_dc), relative."""

    machine: LinearMachine
    t_s: float
    gains: tuple[tuple[float, float], tuple[float, float]]  # (kp in V/A, ki in V/(A s)) of d and q
    box: tuple[float, float, float, float]
    omega_e: float

    @property
    def step(self) -> float:
        """A step in A that meets no limit of the voltage: the analysis is of small signals."""
        return min(0.05 * self.machine.i_max, 0.05 * V_DC / max(kp for kp, _ in self.gains))

    def corners(self) -> list[PlantErrors]:
        """The sixteen corners of the box."""
        found = []
        for signs in product((-1.0, 1.0), repeat=4):
            r_s, l_d, l_q, v_dc = (
                sign * share for sign, share in zip(signs, self.box, strict=True)
            )
            found.append(PlantErrors(r_s=r_s, l_d=l_d, l_q=l_q, v_dc=v_dc))
        return found


def random_drive(generator: np.random.Generator) -> RandomDrive | None:
    """A drive with gains by a random method, or None where that gives none."""
    r_s = 10.0 ** generator.uniform(-2.5, 0.7)
    l_d = r_s * 10.0 ** generator.uniform(-3.3, -1.5)
    machine = LinearMachine(
        pole_pairs=int(generator.integers(1, 7)),
        r_s=r_s,
        l_d=l_d,
        l_q=l_d * generator.uniform(0.6, 3.0),
        psi_pm=10.0 ** generator.uniform(-2.5, -0.5),
        i_max=V_DC / (20.0 * r_s),
        inertia=1.0,
    )
    t_s = 10.0 ** generator.uniform(-4.6, -3.6)
    settings = CurrentLoopSettings(
        method=METHODS[int(generator.integers(len(METHODS)))],
        bandwidth=generator.uniform(0.03, 0.5) / t_s,
        damping=generator.uniform(0.6, 1.5),
        spread=generator.uniform(1.8, 4.0),
    )
    gains = [
        current_pi(r_s, inductance, t_s, settings) for inductance in (machine.l_d, machine.l_q)
    ]
    if min(min(pair) for pair in gains) <= 0.0:
        return None
    box = tuple(generator.uniform(0.0, 1.0, 4) * (0.6, 0.6, 0.6, 0.3))
    most = min(0.5 * V_DC / np.sqrt(3.0) / machine.psi_pm, 0.05 / t_s)
    speed = most * generator.uniform(-1.0, 1.0)
    return RandomDrive(machine, t_s, (gains[0], gains[1]), (box[0], box[1], box[2], box[3]), speed)


def radii(drive: RandomDrive, factor: float = 1.0) -> NDArray[np.float64]:
    """Largest pole modulus of both axes together at each corner, shape (16,),
    gains times a factor.
    """
    errors, machine = drive.corners(), drive.machine
    machines = TurningMachines(
        r_s=np.array([machine.r_s * (1.0 + e.r_s) for e in errors]),
        l_d=np.array([machine.l_d * (1.0 + e.l_d) for e in errors]),
        l_q=np.array([machine.l_q * (1.0 + e.l_q) for e in errors]),
        gain=np.array([1.0 + e.v_dc for e in errors]),
        omega_e=np.full(len(errors), drive.omega_e),
    )
    (kp_d, ki_d), (kp_q, ki_q) = drive.gains
    control = CurrentControl(
        kp=(factor * kp_d, factor * kp_q),
        ki_ts=(factor * ki_d * drive.t_s, factor * ki_q * drive.t_s),
        l_d=machine.l_d,
        l_q=machine.l_q,
        advance=1.5 * drive.t_s,
        t_s=drive.t_s,
    )
    return largest_pole(machines, control)


@pytest.fixture(scope="module")
def place() -> Iterator[Bench]:
    with bench(replace(catalogue.load("paper001-pmsm-bench"), losses=None)) as found:
        yield found


def run_input(
    place: Bench, drive: RandomDrive, errors: PlantErrors, samples: float, factor: float = 1.0
) -> Any:
    """One run: a small step of both currents at constant speed, from rest.

    The simulated control measures the DC link; one that does not lets its error act
    as a gain of all voltages.
    """
    machine, gain = drive.machine, 1.0 + errors.v_dc
    plain = dict(place.gains)
    for name, (kp, ki) in zip(("d", "q"), drive.gains, strict=True):
        plain[name] = [
            gain * factor * kp,
            gain * factor * ki * drive.t_s,
            min(ki / kp * drive.t_s, 1.0),
        ]
    plain |= {
        "pole_pairs": machine.pole_pairs, "r_s": machine.r_s, "l_d": gain * machine.l_d,
        "l_q": gain * machine.l_q, "psi_pm": gain * machine.psi_pm,
        "voltage_share": 1.0 / np.sqrt(3.0), "advance": 1.5 * drive.t_s,
    }  # fmt: skip
    inverter = Inverter(topology="three-wire", v_dc=V_DC, f_sw=1.0 / drive.t_s)
    step = constant(drive.step)
    scenario = Scenario(
        samples * drive.t_s, "current", step, step,
        shaft=constant(drive.omega_e / machine.pole_pairs), dead_time=0.0,
        errors=replace(errors, v_dc=0.0), v_dc=Profile((0.0,), (V_DC,)),
    )  # fmt: skip
    return Drive(machine, inverter, drive.t_s), scenario, gain_bytes(plain)


def relative_error(runs: Summary, drives: list[RandomDrive]) -> NDArray[np.float64]:
    """Largest deviation over the last tenth, relative to the step.

    Infinite where a run left all bounds.
    """
    steps = np.array([np.sqrt(2.0) * drive.step for drive in drives])
    return np.where(runs.bounded, runs.tail_error / steps, np.inf)


@pytest.mark.slow
def test_every_corner_called_stable_is_stable(place: Bench) -> None:
    generator = np.random.default_rng(2026)
    runs, owners, count = [], [], 0
    while count < 2000:
        drive = random_drive(generator)
        if drive is None:
            continue
        count += 1
        for errors, radius in zip(drive.corners(), radii(drive), strict=True):
            if radius < 0.999:
                samples = max(10.0 / -np.log(radius), 60.0)
                runs.append(run_input(place, drive, errors, samples))
                owners.append(drive)
    assert len(runs) > 25_000
    error = relative_error(simulate_many(place.program, runs), owners)
    worst = np.argsort(error)[-5:]
    assert np.all(error < 0.1), [(error[k], owners[k], runs[k][1].errors) for k in worst]
    assert np.median(error) < 0.02


def just_outside(drive: RandomDrive) -> tuple[float, int, float] | None:
    """Factor on the gains with which one corner is just unstable, that corner and its pole.

    None where none is near.
    """
    low, high = 1.0, 20.0
    if radii(drive).max() >= 1.0 or radii(drive, high).max() < 1.0:
        return None
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if radii(drive, middle).max() >= 1.006 else (middle, high)
    found = radii(drive, high)
    return high, int(np.argmax(found)), float(np.max(found))


@pytest.mark.slow
def test_just_outside_the_controller_is_unstable(place: Bench) -> None:
    """Gains raised until the analysis refuses one corner: there the emitted
    controller oscillates at its limit.
    """
    generator = np.random.default_rng(2027)
    runs: list[Any] = []
    owners: list[RandomDrive] = []
    while len(runs) < 80:
        drive = random_drive(generator)
        found = None if drive is None else just_outside(drive)
        if drive is not None and found is not None:
            factor, corner, radius = found
            assert 1.0 <= radius < 1.02
            samples = min(25.0 / np.log(radius), 20_000.0)
            runs.append(run_input(place, drive, drive.corners()[corner], samples, factor))
            owners.append(drive)
    error = relative_error(simulate_many(place.program, runs), owners)
    assert np.all(error > 0.25), np.sort(error)[
        :5
    ]  # a lasting oscillation; every stable corner ends below 0.1
    assert np.median(error) > 2.0
