"""Figure of the page on simulated firmware: one speed loop on two phase-locked loops."""

from __future__ import annotations

import math
from pathlib import Path

from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import Profile, Scenario
from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
)
from dqforge.reports.firmware.target import firmware_simulator, simulate_profile
from dqforge.reports.pages.figures_style import INK, new_figure, save, style
from dqforge.reports.simulation.plant_input import Drive

_PSI = 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * 15 * 60.0)
_I_MAX = 40.0 * math.sqrt(2.0)
_MACHINE = LinearMachine(15, 0.05, 1e-4, 1e-4, _PSI, _I_MAX, inertia=1e-3, friction=1e-4)
_VALUES = DriveValues(15, 0.05, 1e-4, 1e-4, _PSI, i_max=_I_MAX)
_T_S, _CROSSOVER = 50e-6, 2.0 * math.pi * 31.0


def _profile(pll_ki: float) -> LoopProfile:
    """VESC's structure with a speed loop of 31 Hz, without its ramp."""
    pi = PiController(2e3 * math.pi * 1e-4, 2e3 * math.pi * 0.05, _T_S)
    kp = _CROSSOVER * 1e-3 / (1.5 * 15 * _PSI)
    speed = PiController(kp, kp * _CROSSOVER / 16.0, 1e-3, "integral-last")
    loops = CurrentLoops(pi, pi, 0.5, True, True, "d-first", 0.95)
    feedback = SpeedEstimate("pll", _T_S, 2000.0, pll_ki)
    return LoopProfile("vesc", "by hand", loops, SpeedController(speed, feedback))


@style()
def limit_cycle(path: Path) -> None:
    """Speed over time with the vendor's phase-locked loop and with two equal poles."""
    figure = new_figure(
        "firmware-simulation", 3.0, "Speed over time with two phase-locked loops", arranged=True
    )
    axes = figure.add_subplot()
    drive = Drive(_MACHINE, Inverter(48.0, 1.0 / _T_S), _T_S)
    scenario = Scenario(2.0, "speed", Profile((0.0, 1.0), (60.0, 120.0)))
    ways = ((3e4, "foc_pll_ki 30000, the default"), (1e6, "foc_pll_ki 1000000 = kp²/4"))
    with firmware_simulator(_profile(1e6), _VALUES) as program:
        for ki, label in ways:
            run = simulate_profile(
                _profile(ki), _VALUES, drive, scenario, stride=40, program=program
            )
            axes.plot(run.t, run.omega_m, label=label, linewidth=1.1)
    axes.plot(run.t, run.reference, color=INK, linewidth=0.8, linestyle="--", label="reference")
    axes.set(xlabel="Time in s", ylabel="Speed in rad/s", xlim=(0.0, 2.0))
    figure.legend(loc="outside upper center", ncols=3)
    save(figure, path)
