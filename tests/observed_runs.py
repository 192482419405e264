"""Drives on their observer in the simulation: a program per method, machines and gains as data."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, filter_share
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, Sensorless, constant
from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import drive_cases
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.speed_range import SteadyDrives, steady_drives
from dqforge.optimizer.loops.loop_gains import LoopGains, speed_delay
from dqforge.optimizer.loops.pi_methods import speed_pi
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.solution import solve
from dqforge.reports.control.header import gain_bytes
from dqforge.reports.observers.position_header import observer_files, observer_gain_bytes
from dqforge.reports.simulation.design_run import controller_files, drive_of
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

_SHARE = 1.0 / np.sqrt(3.0)


def surface_design(
    machine: LinearMachine, v_dc: float, f_s: float, method: ObserverMethodName, dead_time: float
) -> Design:
    """The template with another machine, without saliency, on an observer."""
    base = load_text(catalogue.template(), "template.yaml")
    control = base.control
    assert control.speed_loop is not None
    loop = replace(control.speed_loop, method="symmetrical-optimum", spread=3.0)
    speed = machine.omega_m_max or 1.0
    bases = replace(
        control.bases, current=machine.i_max, speed=speed, voltage=_SHARE * v_dc,
        torque=machine.torque_per_ampere * machine.i_max,
    )  # fmt: skip
    control = replace(
        control, t_s=1.0 / f_s, observer=ObserverSettings(method=method), speed_loop=loop,
        bases=bases,
    )  # fmt: skip
    inverter = replace(
        base.inverter, v_dc=v_dc, f_sw=f_s, dead_time=dead_time, i_max=2.0 * machine.i_max
    )
    return replace(
        base, machine=machine, inverter=inverter, control=control, losses=None, simulation=None,
        operation=replace(base.operation, strategy="id0"),
        fit=replace(base.fit, torque_max=None),
    )  # fmt: skip


def random_design(
    generator: np.random.Generator, method: ObserverMethodName, dead_time: float = 0.0
) -> Design:
    """24 to 560 V, 3 to 80 A, 60 to 350 Hz, 8 to 20 kHz; one inductance."""

    def between(low: float, high: float) -> float:
        return float(np.exp(generator.uniform(np.log(low), np.log(high))))

    v_dc, i_max, hertz, f_s = between(24, 560), between(3, 80), between(60, 350), between(8e3, 2e4)
    pole_pairs = int(generator.integers(2, 7))
    omega = 2.0 * np.pi * hertz
    psi = between(0.6, 0.85) * _SHARE * v_dc / omega
    inductance = between(0.15, 0.5) * psi / i_max
    r_s = between(0.02, 0.1) * psi * omega / i_max
    torque = 1.5 * pole_pairs * psi * i_max
    inertia = torque * between(0.05, 0.4) / (omega / pole_pairs)
    machine = LinearMachine(
        pole_pairs=pole_pairs, r_s=r_s, l_d=inductance, l_q=inductance, psi_pm=psi, i_max=i_max,
        omega_m_max=omega / pole_pairs, inertia=inertia,
        friction=0.01 * torque / (omega / pole_pairs),
    )  # fmt: skip
    return surface_design(machine, v_dc, round(f_s), method, dead_time)


def with_spread(design: Design, spread: float) -> Design:
    """The same loop with another spread."""
    loop = design.control.speed_loop
    assert loop is not None
    return replace(design, control=replace(design.control, speed_loop=replace(loop, spread=spread)))


@dataclass(frozen=True, slots=True)
class Bench:
    """A compiled controller with one method of observing; ``torque_per_ampere`` is its header's."""

    program: Simulator
    torque_per_ampere: float

    def run(
        self, design: Design, gains: GainSet, scenario: Scenario, stride: int = 5
    ) -> Simulation:
        """A drive without saliency through a scenario, controlled by ``gains``."""
        assert gains.position is not None
        return simulate(
            self.program, drive_of(design), scenario, stride=stride,
            gains=self.gains_of(design, gains),
            observer=observer_gain_bytes(design, gains.position),
        )  # fmt: skip

    def gains_of(self, design: Design, gains: GainSet) -> bytes:
        """The header's references make T/K of its own machine of a torque T: what leads to torques
        counts in its own."""
        machine, control, speed = design.machine, design.control, gains.speed
        assert control.speed_loop is not None
        assert speed is not None
        scale = self.torque_per_ampere / machine.torque_per_ampere

        def pi(loop: LoopGains, factor: float = 1.0) -> list[float]:
            return [factor * loop.kp, factor * loop.ki_ts, loop.anti_windup * loop.t_s]

        return gain_bytes({
            "d": pi(gains.i_d), "q": pi(gains.i_q), "speed": pi(speed, scale),
            "pole_pairs": machine.pole_pairs, "r_s": machine.r_s, "l_d": machine.l_d,
            "l_q": machine.l_q, "psi_pm": machine.psi_pm, "voltage_share": _SHARE,
            "advance": 1.5 * control.t_s, "torque_max": self.torque_per_ampere * machine.i_max,
            "speed_filter": filter_share(control.speed_loop.filter_time, control.t_s),
            "ratio": control.speed_loop.ratio,
        })  # fmt: skip


@contextmanager
def bench(method: ObserverMethodName) -> Iterator[Bench]:
    """The emitted control around the observer of a method, for machines without saliency."""
    machine = LinearMachine(
        pole_pairs=3, r_s=0.5, l_d=1e-3, l_q=1e-3, psi_pm=0.06, i_max=200.0, omega_m_max=500.0,
        inertia=1e-3, friction=1e-4,
    )  # fmt: skip
    design = with_spread(surface_design(machine, 300.0, 10e3, "flux", 0.0), 30.0)
    files = controller_files(solve(design))
    # any gains of the observer will do, but a Kalman filter must find some
    plain = load_text(catalogue.template(), "template.yaml")
    asked = replace(plain, control=replace(plain.control, observer=ObserverSettings(method=method)))
    _, position = solve_observer(asked)
    assert position is not None
    files |= observer_files(design, position)
    with simulator(files, design.export.prefix, (position.method.code,)) as program:
        yield Bench(program, machine.torque_per_ampere)


def steady_scenario(
    design: Design,
    omega: float,
    duration: float,
    load: float = 0.0,
    step: float = 1e-3,
    errors: PlantErrors | None = None,
    dead_time: float = 0.0,
) -> Scenario:
    """Steady at an electrical speed in rad/s but for a small step at a tenth of the duration."""
    omega_m = omega / design.machine.pole_pairs
    return Scenario(
        duration, "speed", Profile((0.0, 0.1 * duration), (omega_m, (1.0 + step) * omega_m)),
        load=constant(load), omega_m=omega_m, errors=errors or PlantErrors(), dead_time=dead_time,
        sensorless=Sensorless(0.0, 0.0),
    )  # fmt: skip


def swing(run: Simulation, share: float = 0.3) -> float:
    """Peak to peak of the mechanical speed in rad/s over the last share of a run."""
    return float(np.ptp(run.omega_m[run.t > (1.0 - share) * run.t[-1]]))


def tuned(design: Design) -> GainSet:
    """Gains of a design, judged with its observer."""
    return solve_gains(design)


def unjudged(design: Design) -> GainSet:
    """The same gains where they do not count the observer, without the judgement of its corners."""
    loop = design.control.speed_loop
    assert loop is not None
    assert not loop.counts_observer
    bare = replace(design, control=replace(design.control, observer=None))
    return replace(solve_gains(bare), position=solve_observer(design)[1])


# Time in s that a drive is watched for at most: open-loop flux leaves some that hardly grow.
LONGEST = 24.0


@dataclass(frozen=True, slots=True)
class Boundary:
    """A drive at the spread at which its speed loop becomes stable at an electrical speed in
    rad/s.
    """

    design: Design
    gains: GainSet
    steady: SteadyDrives
    omega: float
    spread: float

    @property
    def ratio(self) -> int:
        """Current samples per speed sample."""
        loop = self.design.control.speed_loop
        assert loop is not None
        return loop.ratio

    def at(self, factor: float) -> GainSet:
        """Gains with the spread times a factor: stable above one."""
        kp, ki = self.pi(self.spread * factor)
        assert self.gains.speed is not None
        return replace(self.gains, speed=replace(self.gains.speed, kp=kp, ki=ki))

    def pi(self, spread: float) -> tuple[float, float]:
        """kp and ki of the symmetrical optimum, the lag of the observer left out."""
        control, machine = self.design.control, self.design.machine
        assert control.speed_loop is not None
        t_sum = speed_delay(self.gains.i_q, control.t_s, control.speed_loop)
        return speed_pi(
            machine.inertia or 1.0, 0.0, t_sum, replace(control.speed_loop, spread=spread)
        )

    def pole(self, factor: float) -> complex:
        """The largest with the spread times a factor."""
        return complex(self.steady.poles(self.ratio, *self.pi(self.spread * factor))[0, 0])

    def duration(self, factor: float) -> float:
        """Time in s in which a swing grows or decays by e^12, 0.3 to `LONGEST`."""
        rate = abs(np.log(abs(self.pole(factor)))) / (self.ratio * self.design.control.t_s)
        return float(min(max(12.0 / rate, 0.3), LONGEST))


def boundary(design: Design, share: float = 0.25) -> Boundary:
    """Least stable spread at a share of the largest speed, with exact data."""
    gains = unjudged(design)
    assert gains.position is not None
    omega = share * top_speed(design)
    drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
    steady = steady_drives(drive, drive_cases(drive.data.machine, [omega]))
    found = Boundary(design, gains, steady, omega, 1.0)
    low, high = 1.05, 100.0
    for _ in range(30):
        middle = float(np.sqrt(low * high))
        stable = steady.radius(found.ratio, *found.pi(middle))[0] < 1.0
        low, high = (low, middle) if stable else (middle, high)
    return replace(found, spread=high)


STEP = 1e-3  # Step of the reference over the speed: small enough that no torque limit is met.


def swings(bench: Bench, found: Boundary, factor: float) -> bool:
    """Whether the simulated drive ends in a limit cycle."""
    scenario = steady_scenario(found.design, found.omega, found.duration(factor), step=STEP)
    run = bench.run(found.design, found.at(factor), scenario)
    size = found.omega / found.design.machine.pole_pairs
    return swing(run, 0.2) > 3.0 * STEP * size


def loaded_scenario(
    design: Design, omega: float, load: float, errors: PlantErrors, dead_time: float = 0.0
) -> Scenario:
    """Four seconds at an electrical speed in rad/s; the load in N m rises within the first 1.2."""
    found = steady_scenario(design, omega, 4.0, errors=errors, dead_time=dead_time)
    return replace(found, load=Profile((0.0, 1.2), (0.0, load), "linear"))
