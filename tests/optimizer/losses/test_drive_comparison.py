"""Comparisons over maps and missions: who wins, what cannot be driven,
and the energy balance of a mission.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat, read_mission
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.optimizer.losses.drive_budget import BudgetOptions
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    compare_drives,
    compare_mission,
    least,
)

MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
DEVICE = SwitchDevice("mosfet", 9.5e-3, 0.86e-3, 0.86e-3, 206.5, 500.0, 0.306)
INVERTER = Inverter(500.0, 20e3, DEVICE, 64.0)
FULL = BudgetOptions(MachineLoss(2e-8, 0.2, 1e-4, 1e-9), WindingHeat(0.05, 65.0, 20.0))


def igbt() -> Inverter:
    model = device_catalogue.load("sirectifier-sii400s12")
    return Inverter(
        500.0, 8e3, model.switch_device(200.0, 500.0, 100.0, 0.2), 65.0, 2e-6, device_model=model
    )


@pytest.mark.slow
def test_the_best_is_found_by_looking_at_all() -> None:
    alternatives = Alternatives(("mtpa", "id0", "least-loss"), tuple(MODULATORS), (8e3, 2e4))
    torque, omega = np.meshgrid(np.linspace(10.0, 200.0, 6), np.linspace(20.0, 700.0, 7))
    found = compare_drives(
        MACHINE, igbt(), torque.ravel(), omega.ravel(), alternatives, i_max=283.0, options=FULL
    )
    assert found.budget.total.shape == (3, 12, 2, 42)
    for p in range(42):
        candidates = {
            (s, m, f): float(found.budget.total[s, m, f, p])
            for s in range(3)
            for m in range(12)
            for f in range(2)
            if found.usable[s, m, f, p]
        }
        if not candidates:
            assert found.best[p] == -1
            continue
        s, m, f = (int(k) for k in np.unravel_index(found.best[p], (3, 12, 2)))
        assert candidates[s, m, f] <= min(candidates.values()) * (1.0 + 1e-9)
    assert np.count_nonzero(found.best >= 0) > 25
    usable = found.usable[0, 3, 0]
    assert found.budget.torque[0, 3, 0][usable] == pytest.approx(found.torque[usable], rel=1e-9)


def test_field_weakening_makes_room_for_what_the_warm_winding_and_the_iron_add() -> None:
    """Everywhere that the torque is made the voltage is within the linear range, to rounding."""
    omega = np.linspace(300.0, 900.0, 40)
    found = compare_drives(
        MACHINE,
        INVERTER,
        np.full(40, 60.0),
        omega,
        Alternatives(("mtpa",), ("spwm", "svpwm"), (2e4,)),
        i_max=283.0,
        options=replace(FULL, winding=WindingHeat(0.5, 65.0, 20.0)),
    )
    assert np.count_nonzero(found.reached) > 50
    assert np.all(found.budget.linear[found.reached])
    at_limit = found.budget.voltage[0, 1, 0] > 0.9999 * 500.0 / np.sqrt(3.0)
    assert np.count_nonzero(at_limit & found.reached[0, 1, 0]) > 10


def test_least_loss_never_loses_to_the_others_where_its_model_is_exact() -> None:
    """MOSFETs of constant resistance with continuous modulators: the solver's
    objective is the budget itself.
    """
    torque, omega = np.meshgrid(np.linspace(10.0, 150.0, 5), np.linspace(20.0, 600.0, 5))
    options = BudgetOptions(MachineLoss(0.0, 0.5, 3e-4), ripple_resistance=None)
    found = compare_drives(
        MACHINE,
        INVERTER,
        torque.ravel(),
        omega.ravel(),
        Alternatives(("mtpa", "least-loss"), ("svpwm",), (2e4,)),
        i_max=283.0,
        options=options,
    )
    both = found.usable[0, 0, 0] & found.usable[1, 0, 0]
    gain = (found.budget.total[0, 0, 0] - found.budget.total[1, 0, 0])[both]
    # The iron's own current is left out of the objective: some parts per thousand.
    assert np.min(gain) > -2e-3 * float(np.max(found.budget.total[0, 0, 0][both]))
    assert np.max(gain) > 0.5


def test_ties_go_to_the_first() -> None:
    total = np.array([[[[2.0, 5.0, np.inf]], [[2.0 * (1 + 1e-12), 4.0, np.inf]]]])
    assert least(total).tolist() == [0, 1, -1]


MISSION = b"time [s];speed [rpm];torque [N m]\n0;300;20\n2;1500;120\n3;2500;-80\n5;500;5\n10;0;0\n"


def test_mission_is_in_balance_and_long_rows_lose_what_the_steady_budget_loses() -> None:
    mission = read_mission(MISSION, "m.csv")
    stretched = replace(mission, time=1e4 * mission.time)
    for inverter in (INVERTER, igbt()):
        options = BudgetOptions(MachineLoss(2e-8, 0.2, 1e-4, 1e-9), capacitor_esr=2e-3)
        alternatives = Alternatives(("mtpa",), ("svpwm", "dpwm1"), (8e3, 2e4))
        found = compare_mission(
            MACHINE, inverter, stretched, alternatives, i_max=283.0, options=options
        )
        for run in found.runs:
            shaft = run.driving + run.braking
            assert run.input_energy == pytest.approx(run.total + shaft, rel=1e-9)
            assert run.usable
        points = compare_drives(
            MACHINE,
            inverter,
            mission.torque,
            mission.omega_m,
            alternatives,
            i_max=283.0,
            options=options,
        )
        energy = np.sum(points.budget.total[0] * stretched.length, axis=-1).ravel()
        assert [run.total for run in found.runs] == pytest.approx(energy.tolist(), rel=1e-6)
        hottest = np.max(
            np.maximum(points.budget.junction_temperature, points.budget.diode_temperature), axis=-1
        )
        assert [run.junction_max for run in found.runs] == pytest.approx(
            hottest[0].ravel().tolist(), abs=1e-3
        )
        assert found.best == int(np.argmin(energy))


def test_winding_takes_the_temperature_of_the_mean_loss() -> None:
    mission = read_mission(MISSION, "m.csv")
    found = compare_mission(
        MACHINE,
        INVERTER,
        mission,
        Alternatives(("mtpa",), ("svpwm",), (2e4,)),
        i_max=283.0,
        options=FULL,
    )
    run = found.runs[0]
    mean = run.energy["copper"] / float(np.sum(mission.length))
    assert run.winding_temperature == pytest.approx(65.0 + 0.05 * mean, abs=1e-4)
    hot = replace(FULL, winding=WindingHeat(500.0))
    with pytest.raises(NoSolutionError, match=r"m\.csv: the mean copper loss"):
        compare_mission(
            MACHINE,
            INVERTER,
            mission,
            Alternatives(("mtpa",), ("svpwm",), (2e4,)),
            i_max=283.0,
            options=hot,
        )


def test_what_cannot_be_driven_is_listed_by_line() -> None:
    mission = read_mission(
        b"t [s];n [rpm];M [Nm]\n0;300;20\n1;1500;500\n2;9000;190\n3;500;5\n", "m.csv"
    )
    found = compare_mission(
        MACHINE, INVERTER, mission, Alternatives(("mtpa",), ("svpwm",), (2e4,)), i_max=283.0
    )
    assert found.runs[0].missed.tolist() == [3, 4]
    assert found.best == -1
    cold = compare_mission(
        MACHINE,
        INVERTER,
        mission,
        Alternatives(("mtpa",), ("svpwm",), (2e4,)),
        i_max=283.0,
        repeated=False,
    )
    assert cold.runs[0].total == pytest.approx(found.runs[0].total)
