"""Losses, ripple, link current and dead time of a budget against a circuit simulation of one
period by ngspice.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spice_bridge import SpiceRun, netlist, run

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ModulationName
from dqforge.optimizer.losses.drive_budget import DriveBudget, drive_budget

MACHINE = LinearMachine(
    pole_pairs=1, r_s=10e-3, l_d=1e-3, l_q=1e-3, psi_pm=0.12, i_max=200.0, omega_m_max=1e4
)
IGBT = SwitchDevice(
    *("igbt", 6e-3, 1e-3, 0.8e-3, 100.0, 300.0, 1e-6),
    on_voltage=0.9,
    diode_voltage=1.1,
    diode_resistance=4e-3,
)
MOSFET = SwitchDevice(
    "mosfet", 5e-3, 1e-3, 0.8e-3, 100.0, 300.0, 1e-6, diode_voltage=1.1, diode_resistance=4e-3
)
FREQUENCY = 100.0  # Hz, of the fundamental


@pytest.fixture(autouse=True)
def ngspice() -> None:
    if shutil.which("ngspice") is None and not os.environ.get("CI"):
        pytest.skip("ngspice is not installed")


def both(
    folder: Path, device: SwitchDevice, modulation: ModulationName, i: complex, dead_time: float
) -> tuple[SpiceRun, DriveBudget]:
    """The circuit, and the budget at the fundamental of its currents."""
    inverter = Inverter(300.0, 10e3, device, 25.0, dead_time)
    # gaps in which diodes carry are worked out from finer steps
    steps = 1600 if device.kind == "mosfet" else 400
    seen = run(folder, netlist(MACHINE, inverter, modulation, i, FREQUENCY, steps))
    current = seen.phasor(seen.i)
    # the back-EMF lies on q
    own = drive_budget(
        MACHINE, inverter, -current.imag, current.real, 2.0 * np.pi * FREQUENCY, (modulation,)
    )
    return seen, own


def conduction(device: SwitchDevice, seen: SpiceRun) -> float:
    """Loss of all devices in W by their characteristics."""
    channel = device.on_voltage * seen.transistors + device.on_resistance * seen.transistors**2
    diode = device.diode_voltage * seen.diodes + device.diode_resistance * seen.diodes**2
    return float(np.sum(seen.mean(channel + diode)))


CASES = [
    ("svpwm", IGBT, 80.0 - 40.0j, 0.0),
    ("svpwm", IGBT, 80.0 - 40.0j, 2e-6),
    ("svpwm", IGBT, -70.0 - 30.0j, 2e-6),
    ("spwm", IGBT, 60.0 + 30.0j, 1e-6),
    ("dpwmmin", IGBT, 80.0 - 40.0j, 1e-6),
    ("dpwmmax", IGBT, 90.0 + 0.0j, 0.0),
    ("svpwm", MOSFET, 80.0 - 40.0j, 1e-6),
    ("dpwmmax", MOSFET, -70.0 - 30.0j, 1e-6),
]


@pytest.mark.parametrize(
    ("modulation", "device", "i", "dead_time"),
    [pytest.param(*case, marks=[pytest.mark.slow] if k else []) for k, case in enumerate(CASES)],
)
def test_a_budget_is_that_of_the_circuit(
    tmp_path: Path, modulation: ModulationName, device: SwitchDevice, i: complex, dead_time: float
) -> None:
    seen, own = both(tmp_path, device, modulation, i, dead_time)
    assert abs(seen.phasor(seen.i)) == pytest.approx(abs(i), rel=0.05)

    def of(name: str) -> float:
        return float(getattr(own, name)[0, 0, 0])

    bridge = of("conduction") + of("dead_time")
    assert conduction(device, seen) == pytest.approx(bridge, rel=1e-3)
    energy = 0.5 * device.switching_energy / (device.reference_voltage * device.reference_current)
    switching = energy * 300.0 * seen.commutated(300.0) * FREQUENCY
    assert switching == pytest.approx(of("switching"), rel=1e-2)
    link = float(seen.mean(seen.link))
    # the circuit has no switching loss: its energies are counted at the commutations
    assert 300.0 * link == pytest.approx(of("input_power") - of("switching"), rel=1e-3)
    rms = float(np.sqrt(seen.mean((seen.link - link) ** 2)))
    assert rms == pytest.approx(of("capacitor_current"), rel=8e-3)
    assert seen.ripple() == pytest.approx(of("ripple_current"), rel=0.02)
    assert abs(seen.phasor(seen.v)) == pytest.approx(of("voltage"), rel=1e-3)


@pytest.mark.slow
def test_the_dead_time_takes_what_the_budget_tells(tmp_path: Path) -> None:
    """Without anything that makes up for it: the difference of the legs' voltages."""
    plain = Inverter(300.0, 10e3, IGBT, 25.0)
    i = 80.0 - 40.0j
    text = netlist(MACHINE, replace(plain, dead_time=2e-6), "svpwm", i, FREQUENCY)
    shift = 2e-6 * 10e3 * 300.0
    bare = text.replace(f"?{shift:g}:{-shift:g}", "?0:0")
    assert bare != text
    legs = []
    for name, netlist_text in (("with", text), ("without", bare)):
        (tmp_path / name).mkdir()
        legs.append(run(tmp_path / name, netlist_text))
    # the currents react, so that the amplitude is that of the voltage less what they take
    own = drive_budget(
        MACHINE,
        replace(plain, dead_time=2e-6),
        40.0,
        80.0,
        2.0 * np.pi * FREQUENCY,
        ("svpwm",),
    )
    lost = legs[0].phasor(legs[0].v) - legs[1].phasor(legs[1].v)
    assert abs(lost) == pytest.approx(float(own.voltage_error[0, 0, 0]), rel=0.02)
    # the drops of the devices turn with the current, by a quarter of a volt of 7.6
    assert abs(np.angle(lost / legs[1].phasor(legs[1].i))) < np.radians(4.0)
