"""Overmodulation by the emitted C in a simulated drive: the fundamental of the phase voltage, the
currents and the torque ripple that are told, and the loop beyond the linear range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.dead_time import LowHarmonics, low_harmonics
from dqforge.machines.modulation.registry import METHODS, SIX_STEP
from dqforge.machines.names import OvermodulationName
from dqforge.machines.plants.scenario import Encoder, Scenario, constant
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.simulation.design_run import controller_files, drive_of
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

T_S, V_DC = 5e-5, 100.0
OMEGA = 2.0 * math.pi * 100.33  # electrical; 199.34 samples a period, never the same twice
SAMPLES = 9967  # 50 periods
MACHINE = LinearMachine(
    pole_pairs=3, r_s=0.3, l_d=2e-3, l_q=3e-3, psi_pm=0.0955, i_max=50.0, inertia=0.05
)


def design(method: OvermodulationName, bandwidth: float = 100.0) -> Design:
    base = make_design(MACHINE)
    inverter = Inverter(V_DC, 1.0 / T_S, overmodulation=method, overmodulation_limit=1.0)
    loop = CurrentLoopSettings("bandwidth", bandwidth=2.0 * math.pi * bandwidth)
    control = replace(base.control, t_s=T_S, current_loop=loop, speed_loop=None)
    return replace(base, control=control, inverter=inverter, losses=None)


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(design("none"))


@pytest.fixture(scope="module", params=list(METHODS))
def drive(
    request: pytest.FixtureRequest, solution: Solution
) -> Iterator[tuple[Solution, Simulator]]:
    solved = replace(solution, design=design(request.param))
    with simulator(controller_files(solved), solved.design.export.prefix) as compiled:
        yield solved, compiled


def fed(
    drive: tuple[Solution, Simulator], amplitude: float, inverter: str = "averaged"
) -> Simulation:
    """The drive with no controllers but a feedforward: the asked voltage is ``amplitude`` V on the
    q axis.
    """
    solved, compiled = drive
    none = [0.0, 0.0, 0.0]
    plain = plain_control(solved) | {"d": none, "q": none, "l_d": 0.0, "l_q": 0.0}
    plain |= {"psi_pm": amplitude / OMEGA}
    scenario = Scenario(
        0.6, "current", constant(0.0), constant(0.0), shaft=constant(OMEGA / 3.0),
        omega_m=OMEGA / 3.0, encoder=Encoder(speed="exact"),
        inverter="switched" if inverter == "switched" else "averaged",
    )  # fmt: skip
    return simulate(compiled, drive_of(solved.design), scenario, gains=gain_bytes(plain))


def phase_fundamental(found: Simulation) -> float:
    """Amplitude in V of the fundamental of the phase voltage by the duty cycles, over 50 periods,
    each held for a sampling period.
    """
    duty = found.duty[-SAMPLES:]
    voltage = V_DC * (duty[:, 0] - duty.mean(axis=1))
    turn = np.exp(-1j * OMEGA * found.t[-SAMPLES:])
    return float(2.0 * np.abs(np.mean(voltage * turn)))


@pytest.mark.thinned
@pytest.mark.parametrize(("share", "inverter"), [(0.92, "averaged"), (0.97, "switched")])
def test_fundamental_currents_and_torque_ripple_are_those_told(
    drive: tuple[Solution, Simulator], share: float, inverter: str
) -> None:
    amplitude = share * SIX_STEP * V_DC
    found = fed(drive, amplitude, inverter)
    assert phase_fundamental(found) == pytest.approx(amplitude, rel=6e-5)
    last = slice(-SAMPLES, None)
    i_d, i_q = float(np.mean(found.i_d[last])), float(np.mean(found.i_q[last]))
    told = told_at(drive, i_d, i_q)
    assert float(told.index[0]) == pytest.approx(share, rel=1e-4)
    assert current_ripple(found) == pytest.approx(float(told.current[0]), rel=2e-3)
    # at the samples, 200 in a period, the largest and the least are hit as far as that goes
    torque = found.torque[last]
    assert np.ptp(torque) == pytest.approx(float(told.torque[0]), rel=0.015)
    time = found.t[last]
    for order, expected in ((6, told.torque_6), (12, told.torque_12)):
        assert amplitude_of(torque, time, order) == pytest.approx(float(expected[0]), rel=0.01)


@pytest.mark.thinned
def test_six_step_operation_is_reached(drive: tuple[Solution, Simulator]) -> None:
    found = fed(drive, SIX_STEP * V_DC)
    # the jump from corner to corner falls between two of 199 samples
    assert phase_fundamental(found) == pytest.approx(SIX_STEP * V_DC, rel=3e-4)
    duty = found.duty[-SAMPLES:]
    assert np.mean((duty < 1e-6) | (duty > 1.0 - 1e-6)) > 0.995


def test_loop_beyond_the_linear_range_holds_the_torque(drive: tuple[Solution, Simulator]) -> None:
    """Current control of 100 Hz, the frequency of the fundamental, against its harmonics from 600
    Hz on.
    """
    solved, compiled = drive
    scenario = Scenario(
        0.8, "current", constant(5.0), constant(-2.0), shaft=constant(OMEGA / 3.0),
        omega_m=OMEGA / 3.0, encoder=Encoder(speed="exact"),
    )  # fmt: skip
    found = simulate(compiled, drive_of(solved.design), scenario)
    told = told_at(drive, -2.0, 5.0)
    assert 0.94 < float(told.index[0]) < 0.945  # the linear range ends at 0.907
    torque = found.torque[-SAMPLES:]
    wanted = 1.5 * 3 * (0.0955 + (2e-3 - 3e-3) * -2.0) * 5.0
    assert float(np.mean(torque)) == pytest.approx(wanted, rel=5e-4)
    # the controllers answer the harmonics a little
    assert np.ptp(torque) == pytest.approx(float(told.torque[0]), rel=0.03)
    assert current_ripple(found) == pytest.approx(float(told.current[0]), rel=0.06)


def told_at(drive: tuple[Solution, Simulator], i_d: float, i_q: float) -> LowHarmonics:
    method = drive[0].design.inverter.overmodulation
    return low_harmonics(method, MACHINE, i_d, i_q, OMEGA / 3.0, v_dc=V_DC)


def current_ripple(found: Simulation) -> float:
    """Root mean square in A of the ripple of a phase current."""
    currents = np.stack([found.i_d, found.i_q])[:, -SAMPLES:]
    return float(np.sqrt(0.5 * np.sum(np.var(currents, axis=1))))


def amplitude_of(samples: FloatArray, time: FloatArray, order: int) -> float:
    """Amplitude of a multiple of the fundamental frequency."""
    turn = np.exp(-1j * order * OMEGA * time)
    return float(2.0 * np.abs(np.mean((samples - samples.mean()) * turn)))


@pytest.mark.slow
def test_weakening_beyond_the_linear_range_holds_the_torque_within_the_margin() -> None:
    """References of the surface at the voltage limit, which leave the controllers a margin for
    their answer to the harmonics.
    """
    keys = {
        "operation.overmodulation": "least-phase-error",
        "operation.overmodulation_limit": "98 %",
        "operation.voltage_margin": "3 %",
        "field_weakening.speed": "1500 rpm",
        "inverter.v_dc": "420 V",
        "inverter.dead_time": "0 us",
        "export.control": "float32",
    }
    loaded = catalogue.load("abb-ipmsm-2k2", [f"{key}={value}" for key, value in keys.items()])
    solved, speed = solve(loaded), 1300.0 * math.pi / 30.0
    scenario = Scenario(
        0.5, "torque", constant(20.0), shaft=constant(speed), omega_m=speed,
        encoder=Encoder(speed="exact"),
    )  # fmt: skip
    prefix = loaded.export.prefix
    with simulator(controller_files(solved), prefix) as compiled:
        found = simulate(compiled, drive_of(loaded), scenario)
    settled = found.t > 0.2
    assert float(np.mean(found.torque[settled])) == pytest.approx(20.0, rel=4e-3)
    i_d, i_q = (np.mean(x[settled], keepdims=True) for x in (found.i_d, found.i_q))
    voltage = np.hypot(*loaded.machine.voltage(i_d, i_q, np.array([3.0 * speed])))
    assert float(voltage[0]) / (SIX_STEP * 420.0) == pytest.approx(0.9506, rel=5e-3)
