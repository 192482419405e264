"""All switches off: the diodes let the currents die, and a rotor that is not too fast turns on
without any. The plant in dq coordinates against the one in phase quantities."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import InverterModel, Scenario, constant
from dqforge.reports.pages.templating import render
from dqforge.reports.simulation.plant_input import PARAMETERS, PLANT, Drive, run_input

T_S = 1e-4
MACHINE = LinearMachine(
    pole_pairs=4, r_s=0.5, l_d=2e-3, l_q=2e-3, psi_pm=0.05, i_max=20.0, inertia=1e-3
)
LINK = Inverter(100.0, 1.0 / T_S, dead_time=1e-6)
HALF = constant(0.5)

# Duty cycles for a tenth of the periods, then everything off, then the duty cycles again.
MAIN = r"""
#include <stdio.h>
#include "plant.c"

int main(void)
{
    static drive_t drive;
    static double f[6 * 3 * CELLS], points[2], terms[7];
    double link[2], flux;
    int k;

    if (fread(&drive.p, sizeof drive.p, 1U, stdin) != 1U
        || fread(link, sizeof link, 1U, stdin) != 1U) {
        return 2;
    }
    points[1] = link[0];
    drive.link.count = 1;
    drive.link.points = points;
    flux = link[1];
    terms[0] = 1.0;
    for (k = 0; k < 3; ++k) {
        terms[1 + 2 * k] = flux * sin((double)k * TWO_PI / 3.0);
        terms[2 + 2 * k] = -flux * cos((double)k * TWO_PI / 3.0);
    }
    drive.emf.count = 1;
    drive.emf.width = 3;
    drive.emf.terms = terms;
    tabulate(&drive.emf, f);
    drive.inductance.width = 6;
    drive.x[X_OMEGA_M] = drive.p.omega_m_0;
    for (k = 0; k < 100; ++k) {
        const double time = k * drive.p.t_s;
        phases_t i;
        drive.off = (k >= 10) && (k < 80);
        drive.duty[0] = 0.56;
        drive.duty[1] = 0.47;
        drive.duty[2] = 0.47;
        plant_step(&drive, time, time + drive.p.t_s);
        i = phase_currents(&drive, drive.x);
        printf("%.17g %.17g %.17g %.17g\n", i.a, i.b, i.c, drive.x[X_OMEGA_M]);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plant")
    for name in ("plant.c", "phase_plant.c"):
        (folder / name).write_text(render(f"simulation/{name}.j2", PLANT), encoding="ascii")
    (folder / "main.c").write_text(MAIN, encoding="ascii")
    command = ["cc", "-std=c99", "-O1", "-o", "plant", "main.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    return folder / "plant"


def run(
    program: Path, omega_m: float, inverter: InverterModel, *, phases: bool = False
) -> FloatArray:
    """Columns i_a, i_b, i_c in A and omega_m in rad/s after each of 100 periods."""
    angles = 2.0 * np.pi * (np.arange(24) / 24.0 - np.arange(3)[:, None] / 3.0)
    wired = PhaseMachine(4, 0.5, 2e-3, 0.0, -MACHINE.psi_pm * np.sin(angles), 20.0)
    drive = Drive(MACHINE, LINK, T_S, phases=wired if phases else None)
    scenario = Scenario(0.01, "open-loop", HALF, HALF, omega_m=omega_m, inverter=inverter)
    parameters = run_input(drive, scenario).parameters
    content = np.array([*(parameters[name] for name in PARAMETERS), 100.0, MACHINE.psi_pm])
    done = subprocess.run(
        [str(program)], input=content.tobytes(), capture_output=True, check=True, timeout=60
    )
    rows = [[float(word) for word in line.split()] for line in done.stdout.splitlines()]
    return np.array(rows)


def test_currents_die_in_the_diodes_and_come_back(program: Path) -> None:
    found = run(program, 100.0, "averaged")
    size = np.max(np.abs(found[:, :3]), axis=1)
    assert size[9] > 1.0
    assert np.all(size[14:80] < 1e-6)
    assert np.all(np.abs(np.diff(found[14:80, 3])) < 1e-9)  # no torque
    assert size[85] > 1.0


@pytest.mark.parametrize("omega_m", [0.0, 100.0, -200.0])
def test_both_plants_let_the_same_currents_die(program: Path, omega_m: float) -> None:
    switched = run(program, omega_m, "switched")[:80]
    phases = run(program, omega_m, "switched", phases=True)[:80]
    scale = float(np.max(np.abs(switched[:, :3])))
    np.testing.assert_allclose(switched[:, :3], phases[:, :3], atol=2e-3 * scale)


@pytest.mark.parametrize("phases", [False, True])
def test_diodes_carry_from_the_speed_on_at_which_two_phases_reach_the_link(
    program: Path, phases: bool
) -> None:
    """sqrt(3) 0.05 p omega_m = 100 V: below it what floats stays between the rails."""
    first = 100.0 / (np.sqrt(3.0) * MACHINE.psi_pm * MACHINE.pole_pairs)
    for share, carries in ((0.97, False), (-0.97, False), (1.05, True)):
        found = run(program, share * first, "switched", phases=phases)
        assert (np.max(np.abs(found[40:80, :3])) > 1e-3) == carries


def test_fast_rotor_charges_the_link_through_the_diodes(program: Path) -> None:
    """EMF between two phases of sqrt(3) 0.05 400 p = 138 V over a link of 100 V."""
    found, phases = (run(program, 400.0, "switched", phases=each) for each in (False, True))
    assert np.all(np.max(np.abs(found[40:80, :3]), axis=1) > 0.5)
    scale = float(np.max(np.abs(found[:80, :3])))
    np.testing.assert_allclose(found[:80, :3], phases[:80, :3], atol=2e-2 * scale)
    assert found[79, 3] < found[20, 3]  # braked
