"""Budgets of whole drives: balance of power, agreement with the simple budget, heat,
and what is marked.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from simple_losses import loss_budget

from dqforge.machines.design import catalogue
from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_tables import bridge_tables
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat, machine_budget
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.modulation.ripple import ripple
from dqforge.machines.names import ModulationName, Strategy
from dqforge.machines.plants.current_feedback import simulate_period
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions, drive_budget

MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
DEVICE = SwitchDevice(
    "mosfet",
    9.5e-3,
    0.86e-3,
    0.86e-3,
    206.5,
    500.0,
    0.306,
    on_resistance_temperature_coefficient=4e-3,
)
INVERTER = Inverter(500.0, 20e3, DEVICE, 64.0)
FULL = BudgetOptions(MachineLoss(1e-8, 0.2, 1e-4, 1e-9), WindingHeat(0.05, 65.0, 20.0), 2e-3, 1.5)
BARE = BudgetOptions(ripple_resistance=None)


def igbt() -> Inverter:
    model = device_catalogue.load("sirectifier-sii400s12")
    return Inverter(
        500.0, 8e3, model.switch_device(200.0, 500.0, 100.0, 0.2), 65.0, 2e-6, device_model=model
    )


@pytest.mark.slow
def test_every_watt_is_found_again_over_random_machines_and_points() -> None:
    """Power in by duty cycles and currents, losses and shaft power are three computations.

    They agree to 1e-9.
    """
    random = np.random.default_rng(7)
    inverters = [igbt(), replace(INVERTER, dead_time=2e-7)]
    for trial in range(24):
        l_d, l_q = random.uniform(1e-4, 2e-3, 2)
        machine = LinearMachine(
            int(random.integers(1, 9)), random.uniform(1e-3, 0.1), l_d, l_q, 0.1, 300.0
        )
        i_d, i_q, omega = random.uniform(-100.0, 100.0, (3, 60))
        budget = drive_budget(
            machine,
            inverters[trial % 2],
            i_d,
            i_q,
            omega,
            tuple(MODULATORS),
            [4e3, 2e4],
            options=FULL,
        )
        usable = budget.linear & budget.steady
        assert np.count_nonzero(usable) > 100
        scale = np.maximum(np.abs(budget.input_power), 1.0)
        assert np.max((np.abs(budget.imbalance) / scale)[usable]) < 1e-9
        assert np.max(budget.thermal_residual[usable]) < 1e-6
        parts = sum(getattr(budget, name) for name in PARTS)
        assert parts[usable] == pytest.approx(budget.total[usable])


def test_saturated_machines_are_in_balance_too() -> None:
    design = catalogue.load("abb-syrm-6k7-saturated")
    i_d, i_q = np.meshgrid(np.linspace(1.0, 15.0, 6), np.linspace(-15.0, 15.0, 7))
    inverter = replace(INVERTER, v_dc=540.0)
    budget = drive_budget(
        design.machine, inverter, i_d.ravel(), i_q.ravel(), 80.0, ("svpwm",), options=FULL
    )
    usable = budget.linear & budget.steady
    assert np.count_nonzero(usable) > 20
    assert np.max(np.abs(budget.imbalance[usable])) < 1e-9 * float(
        np.max(np.abs(budget.input_power[usable]))
    )


def test_constants_give_the_simple_budget() -> None:
    random = np.random.default_rng(3)
    i_d, i_q, omega = random.uniform(-150.0, 150.0, (3, 200))
    names: tuple[ModulationName, ...] = ("spwm", "svpwm", "dpwm1", "dpwm3", "gdpwm", "ddt-gdpwm")
    budget = drive_budget(MACHINE, INVERTER, i_d, i_q, omega, names, options=BARE)
    for m, name in enumerate(names):
        simple = loss_budget(MACHINE, INVERTER, i_d, i_q, omega, name)
        assert budget.total[m, 0] == pytest.approx(simple.total, rel=1e-11)
        assert budget.junction_temperature[m, 0] == pytest.approx(
            simple.junction_temperature, rel=1e-11
        )
        assert (budget.linear[m, 0] == simple.linear).all()


def test_table_4_of_paper_000() -> None:
    """Calibrated on the first column alone: 934 W within 1 %, 759 W within 3 %,
    junctions within 1.5 K.
    """
    design = catalogue.load("paper000-ipmsm-100kw")
    printed: dict[Strategy, list[tuple[float, float]]] = {
        "id0": [(1064.0, 112.32)],
        "mtpa": [(934.0, 106.54), (759.0, 98.73)],
    }
    # Least current for 130 N m along T = 3/2 p (psi - dl i_d) i_q.
    angle = np.linspace(-120.0, 0.0, 240_001)
    torque_per_i_q = 6.0 * (0.1049 - 242e-6 * angle)
    best = int(np.argmin(np.hypot(angle, 130.0 / torque_per_i_q)))
    i_d = float(angle[best])
    currents = {
        "id0": (0.0, 130.0 / (6.0 * 0.1049)),
        "mtpa": (i_d, 130.0 / float(torque_per_i_q[best])),
    }
    inverter = replace(design.inverter, dead_time=0.0)
    alternatives: list[tuple[Strategy, tuple[ModulationName, ...]]] = [
        ("id0", ("spwm",)),
        ("mtpa", ("spwm", "ddt-gdpwm")),
    ]
    for strategy, names in alternatives:
        found = drive_budget(
            design.machine,
            inverter,
            [currents[strategy][0]],
            [currents[strategy][1]],
            [300.0],
            names,
            options=BARE,
        )
        for m, (total, junction) in enumerate(printed[strategy]):
            tolerance = 0.03 if names[m] == "ddt-gdpwm" else 0.01
            assert found.total[m, 0, 0] == pytest.approx(total, rel=tolerance)
            assert found.junction_temperature[m, 0, 0] == pytest.approx(junction, abs=1.5)


@pytest.mark.slow
def test_switched_period_closes_the_balance_of_the_averaged_budget() -> None:
    """Power from the link plus the bridge's losses, all from the switched simulation,
    within 0.5 % of the budget's.
    """
    inverter = replace(igbt(), dead_time=0.0)
    assert inverter.device is not None
    inverter = replace(inverter, device=replace(inverter.device, thermal_resistance=1e-9))
    i_d, i_q, omega, carriers = -80.0, 120.0, 250.0, 480
    frequency = carriers * 4 * omega / (2.0 * math.pi)
    v_d, v_q = (
        float(v) for v in MACHINE.voltage(np.array(i_d), np.array(i_q), np.array(4 * omega))
    )
    for name in MODULATORS:
        budget = drive_budget(MACHINE, inverter, [i_d], [i_q], [omega], (name,), [frequency])
        made = simulate_period(
            MACHINE,
            bridge_tables(inverter),
            name,
            (v_d, v_q),
            (i_d, i_q),
            omega,
            v_dc=500.0,
            carrier_ratio=carriers,
            junction_temperature=65.0,
        )
        put_in = made.link_power + made.conduction + made.switching
        assert put_in == pytest.approx(float(budget.input_power[0, 0, 0]), rel=5e-3)
        assert made.shaft_power == pytest.approx(float(budget.shaft_power[0, 0, 0]), rel=5e-3)
        machine = float((budget.copper + budget.ripple_copper)[0, 0, 0])
        assert made.copper == pytest.approx(machine, rel=5e-3)


@given(st.floats(0.0, 0.5), st.floats(1.0, 250.0), st.floats(0.0, 1500.0), st.floats(0.0, 2e-7))
def test_winding_temperature_is_the_fixed_point_of_a_root_finder(
    resistance: float, current: float, omega: float, k_ac: float
) -> None:
    heat = WindingHeat(resistance, 65.0, 20.0)
    found = machine_budget(
        MACHINE,
        np.zeros(1),
        np.full(1, current),
        np.full(1, omega),
        loss=MachineLoss(ac_copper=k_ac),
        heat=heat,
    )
    extra = k_ac * (4.0 * omega) ** 2

    def imbalance(ratio: float) -> float:
        loss = 1.5 * 2e-3 * current**2 * (ratio + extra / ratio)
        return ratio - 1.0 - 0.00393 * (65.0 + resistance * loss - 20.0)

    assert found.steady[0]
    ratio = brentq(imbalance, 1.0, 1e4, xtol=1e-13)
    assert found.winding_temperature[0] == pytest.approx(20.0 + (ratio - 1.0) / 0.00393, rel=1e-9)
    assert found.copper[0] == pytest.approx(
        1.5 * 2e-3 * current**2 * (ratio + extra / ratio), rel=1e-9
    )


def test_what_runs_away_is_marked_and_nothing_else_is_undefined() -> None:
    currents = np.array([100.0, 2000.0, np.nan])
    hot = BudgetOptions(winding=WindingHeat(1.0, 65.0))
    for options, steady in ((BARE, [True, False]), (hot, [True, False])):
        budget = drive_budget(
            MACHINE, INVERTER, 0.0, currents, 10.0, ("spwm", "dpwm1"), [1e4, 2e4], options=options
        )
        assert budget.known[0, 0].tolist() == [True, True, False]
        assert budget.steady[0, 0].tolist() == [*steady, False]
        undefined = np.isnan(budget.total)
        assert (undefined == ~(budget.steady & budget.known)).all()
        assert not np.any(budget.feasible & undefined)


def test_tables_beyond_their_ends_are_marked() -> None:
    budget = drive_budget(MACHINE, igbt(), 0.0, [200.0, 700.0], 10.0, ("svpwm",))
    assert budget.within_tables[0, 0].tolist() == [True, False]


def test_dead_time_of_a_mosfet_bridge() -> None:
    """Two gaps per carrier period and phase: 2 t_d f_sw (2/pi I V_F + I^2/2
    r_F - I^2/2 R_on) per phase.
    """
    device = replace(
        DEVICE, diode_voltage=1.5, diode_resistance=4e-3, on_resistance_temperature_coefficient=0.0
    )
    inverter = replace(INVERTER, device=device, dead_time=3e-7)
    budget = drive_budget(MACHINE, inverter, 0.0, [150.0], [200.0], ("svpwm",), [4e4], options=BARE)
    per_phase = 1.5 * 150.0 * 2.0 / math.pi + (4e-3 - 9.5e-3) * 150.0**2 / 2.0
    assert budget.dead_time[0, 0, 0] == pytest.approx(3.0 * 2.0 * 3e-7 * 4e4 * per_phase, rel=1e-10)
    assert budget.voltage_error[0, 0, 0] == pytest.approx(
        4.0 / math.pi * 3e-7 * 4e4 * 500.0, rel=1e-10
    )
    none = drive_budget(
        MACHINE, replace(inverter, device=DEVICE), 0.0, [150.0], [200.0], ("svpwm",), options=BARE
    )
    assert none.dead_time[0, 0, 0] == 0.0  # nothing is known of its diode


@pytest.mark.parametrize("name", MODULATORS)
def test_ripple_current_is_that_of_the_ripple_module(name: ModulationName) -> None:
    budget = drive_budget(MACHINE, INVERTER, -60.0, [120.0], [200.0], (name,), [1e4])
    found = ripple(name, MACHINE, [-60.0], [120.0], [200.0], v_dc=500.0, f_sw=1e4)
    assert budget.ripple_current[0, 0, 0] == pytest.approx(float(found.current[0]), rel=1e-9)
    assert budget.ripple_copper[0, 0, 0] == pytest.approx(
        3.0 * 2e-3 * float(found.current[0]) ** 2, rel=1e-9
    )


def test_wrong_requests_are_refused() -> None:
    with pytest.raises(InputError, match="positive carrier frequencies"):
        drive_budget(MACHINE, INVERTER, 0.0, 1.0, 1.0, ("spwm",), [0.0])
    with pytest.raises(InputError, match="positive carrier frequencies"):
        drive_budget(MACHINE, INVERTER, 0.0, 1.0, 1.0, ())
    with pytest.raises(InputError, match="capacitor_esr"):
        BudgetOptions(capacitor_esr=-1.0)
    with pytest.raises(InputError, match="thermal resistance"):
        WindingHeat(-1.0)
