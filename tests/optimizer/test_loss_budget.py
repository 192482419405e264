"""Loss budgets: Table 4 of paper 000 predicted from its first column, comparison, calibration, runaway."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.inverter import Inverter, SwitchDevice
from dqforge.machines.settings import LoadPoint, LossSettings, ModulationName, Strategy
from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.loss_budget import (
    LossBudget,
    LossComparison,
    _first_minimum,
    calibrate_switching,
    compare,
    loss_budget,
)

# Paper 000: Tables 5 and 6, with psi_pm and l_q - l_d as Table 2 identifies them.
MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
# The energies are placeholders: the calibration sets them. Thermal resistance and coolant temperature are
# not in the paper.
DEVICE = SwitchDevice("mosfet", 9.5e-3, 1e-3, 1e-3, 200.0, 500.0, thermal_resistance=0.306)
INVERTER = Inverter(v_dc=500.0, f_sw=100e3, device=DEVICE, coolant_temperature=64.0)
TORQUE, OMEGA_M = 130.0, 300.0
ID0 = (0.0, 2.0 * TORQUE / (3.0 * 4 * 0.1049))


def i_q_for(torque: float, i_d: float) -> float:
    return torque / (6.0 * (0.1049 - 242e-6 * i_d))


def least_current(torque: float) -> tuple[float, float]:
    """Return the MTPA currents by direct minimisation along the curve of constant torque."""
    best = minimize_scalar(
        lambda i_d: math.hypot(i_d, i_q_for(torque, i_d)),
        bounds=(-283.0, 0.0),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(best.x), i_q_for(torque, float(best.x))


MTPA = least_current(TORQUE)


def calibrated() -> Inverter:
    return replace(INVERTER, device=calibrate_switching(1064.0, MACHINE, INVERTER, *ID0, OMEGA_M, "spwm"))


def table_4() -> LossComparison:
    request = LossSettings(points=(LoadPoint(TORQUE, OMEGA_M),))
    currents: dict[Strategy, tuple[list[float], list[float]]] = {
        "id0": ([ID0[0]], [ID0[1]]),
        "mtpa": ([MTPA[0]], [MTPA[1]]),
    }
    return compare(MACHINE, calibrated(), request, currents)


@pytest.mark.parametrize(
    ("strategy", "modulation", "total", "tolerance", "junction"),
    [
        ("id0", "spwm", 1064.0, 1e-12, 112.32),  # the calibrated column
        ("mtpa", "spwm", 934.0, 0.01, 106.54),
        ("mtpa", "ddt-gdpwm", 759.0, 0.04, 98.73),
    ],
)
def test_table_4_is_predicted_from_its_first_column(
    strategy: Strategy, modulation: ModulationName, total: float, tolerance: float, junction: float
) -> None:
    result = table_4()
    index = (result.strategies.index(strategy), result.modulations.index(modulation), 0)
    assert result.budget.total[index] == pytest.approx(total, rel=tolerance)
    assert result.budget.junction_temperature[index] == pytest.approx(junction, abs=1.5)
    assert result.budget.torque[index] == pytest.approx(TORQUE, rel=1e-9)
    assert result.budget.linear[index]


def test_table_4_switching_loss_of_the_first_column_and_the_best_alternative() -> None:
    """328 W of switching loss; the paper's conclusion is that MTPA with DDT-GDPWM is best."""
    result = table_4()
    assert result.budget.switching[0, 0, 0] == pytest.approx(328.0, abs=0.5)
    # With MTPA the current lags by 32 degrees, hardly more than the 30 up to which the loss is halved.
    assert result.budget.switching[1, 2, 0] == pytest.approx(0.5 * result.budget.switching[1, 0, 0], rel=2e-3)
    assert result.best_labels == (("mtpa", "ddt-gdpwm"),)
    assert result.saving[0, 0, 0] == 0.0
    assert result.saving[1, 2, 0] == pytest.approx(100.0 * (1.0 - 759.0 / 1064.0), abs=2.5)


def test_parts_add_up_and_are_what_the_formulas_say() -> None:
    budget = loss_budget(MACHINE, INVERTER, -50.0, 120.0, 200.0, "svpwm")
    square = 50.0**2 + 120.0**2
    assert budget.copper == pytest.approx([1.5 * 2e-3 * square])
    assert budget.conduction == pytest.approx([1.5 * 9.5e-3 * square])
    assert budget.inverter == pytest.approx(budget.conduction + budget.switching)
    assert budget.total == pytest.approx(budget.copper + budget.inverter)
    v_d = 2e-3 * -50.0 - 800.0 * 592e-6 * 120.0
    v_q = 2e-3 * 120.0 + 800.0 * (350e-6 * -50.0 + 0.1049)
    assert budget.voltage == pytest.approx([math.hypot(v_d, v_q)])
    assert budget.modulation_index == pytest.approx([math.hypot(v_d, v_q) * math.pi / 1000.0])


@pytest.mark.parametrize("modulation", ["spwm", "svpwm", "ddt-gdpwm"])
def test_arrays_give_what_single_points_give(modulation: ModulationName) -> None:
    i_d, i_q, omega_m = np.array([-80.0, 0.0, -10.0]), np.array([150.0, 0.0, -90.0]), np.array([100.0, 0.0, -400.0])
    hot = replace(INVERTER, device=replace(DEVICE, on_resistance_temperature_coefficient=5e-3))
    budget = loss_budget(MACHINE, hot, i_d, i_q, omega_m, modulation)
    for k in range(3):
        one = loss_budget(MACHINE, hot, i_d[k], i_q[k], omega_m[k], modulation)
        for field in fields(LossBudget):
            value = getattr(one, field.name)
            assert value.shape == (1,)
            # The residual is a difference of equal temperatures: rounding, here of some 100 degC.
            assert value[0] == pytest.approx(getattr(budget, field.name)[k], rel=1e-13, abs=1e-12)


@settings(deadline=None)
@given(st.floats(-200.0, 0.0), st.floats(-250.0, 250.0), st.floats(-500.0, 500.0))
def test_ddt_saves_between_a_third_and_half_of_the_switching_loss(i_d: float, i_q: float, omega_m: float) -> None:
    """The analytic factor runs from 1/2 to (3 - sqrt 3) / 2 at 90 degrees; conduction in MOSFETs does not change."""
    spwm, svpwm, ddt = (loss_budget(MACHINE, INVERTER, i_d, i_q, omega_m, m) for m in ("spwm", "svpwm", "ddt-gdpwm"))
    # Losses below 1e-200 W are rounded to the few digits that subnormal numbers have.
    assert np.all(ddt.switching >= 0.5 * spwm.switching * (1.0 - 1e-9) - 1e-200)
    assert np.all(ddt.switching <= 0.5 * (3.0 - math.sqrt(3.0)) * spwm.switching * (1.0 + 1e-9) + 1e-200)
    assert svpwm.switching == pytest.approx(spwm.switching, rel=1e-12)
    assert ddt.conduction == pytest.approx(spwm.conduction, rel=1e-12)


def test_alternatives_that_cannot_make_the_voltage_are_marked_and_not_chosen() -> None:
    """From 500 V, SPWM makes 250 V, the others 288.7 V; at 300, 430 and 480 rad/s, 194, 277 and 310 V are needed."""
    points = (LoadPoint(TORQUE, 300.0), LoadPoint(TORQUE, 430.0), LoadPoint(TORQUE, 480.0), LoadPoint(TORQUE, 900.0))
    request = LossSettings(points=points, strategies=("id0",))
    result = compare(MACHINE, calibrated(), request, {"id0": (np.zeros(4), np.full(4, ID0[1]))})
    assert result.budget.linear[0].tolist() == [
        [True, False, False, False],
        [True, True, False, False],
        [True, True, False, False],
    ]
    assert result.best_labels == (("id0", "ddt-gdpwm"), ("id0", "ddt-gdpwm"), None, None)
    assert result.best_strategy.tolist() == [0, 0, -1, -1]
    assert np.isnan(result.saving[0, 0]).tolist() == [False, True, True, True]
    assert np.all(np.isnan(result.saving[:, :, 1:]))  # the first alternative is not feasible there


def test_of_equally_good_alternatives_the_first_is_named() -> None:
    request = LossSettings(points=(LoadPoint(0.0, 100.0),))
    result = compare(MACHINE, INVERTER, request, {"id0": ([0.0], [0.0]), "mtpa": ([0.0], [0.0])})
    assert result.best_labels == (("id0", "spwm"),)
    assert np.all(np.isnan(result.saving))  # nothing is lost, so that there is nothing to save


def test_points_without_currents_take_no_part() -> None:
    request = LossSettings(points=(LoadPoint(130.0, 300.0),))
    result = compare(MACHINE, INVERTER, request, {"id0": ([0.0], [ID0[1]]), "mtpa": ([np.nan], [np.nan])})
    assert not np.any(result.budget.feasible[1])
    assert result.best_labels == (("id0", "ddt-gdpwm"),)


def test_comparison_refuses_currents_that_do_not_fit_the_points() -> None:
    request = LossSettings(points=(LoadPoint(130.0, 300.0), LoadPoint(60.0, 300.0)))
    with pytest.raises(InputError, match="no currents are given for the strategies mtpa"):
        compare(MACHINE, INVERTER, request, {"id0": ([0.0, 0.0], [200.0, 100.0])})
    with pytest.raises(InputError, match=r"currents of mtpa have the shape \(1,\), but the points need \(2,\)"):
        compare(MACHINE, INVERTER, request, {"id0": ([0.0, 0.0], [200.0, 100.0]), "mtpa": ([-60.0], [180.0])})


def hot_inverter(alpha: float) -> Inverter:
    return replace(INVERTER, device=replace(DEVICE, on_resistance_temperature_coefficient=alpha))


def test_thermal_runaway_is_refused_with_the_worst_point_named() -> None:
    with pytest.raises(
        NoSolutionError, match=r"thermal runaway at 314\.7 N m and 10 rad/s \(500 A\).*\(1 of 2 points\)"
    ):
        loss_budget(MACHINE, hot_inverter(6e-3), 0.0, [100.0, 500.0], 10.0, "spwm")


def test_thermal_runaway_is_marked_on_request_and_in_comparisons() -> None:
    budget = loss_budget(MACHINE, hot_inverter(6e-3), 0.0, [100.0, 500.0], 10.0, "spwm", on_runaway="mark")
    assert budget.thermally_stable.tolist() == [True, False]
    assert np.isnan(budget.total).tolist() == [False, True]
    request = LossSettings(points=(LoadPoint(314.7, 10.0),), strategies=("id0",))
    assert compare(MACHINE, hot_inverter(6e-3), request, {"id0": ([0.0], [500.0])}).best_labels == (None,)


def test_budget_refuses_currents_that_are_not_numbers() -> None:
    with pytest.raises(InputError, match="must be finite"):
        loss_budget(MACHINE, INVERTER, [0.0, np.nan], 100.0, 10.0, "spwm")


def test_budget_without_device_data_is_refused() -> None:
    with pytest.raises(InputError, match="no device is given"):
        loss_budget(MACHINE, replace(INVERTER, device=None), 0.0, 100.0, 10.0, "spwm")


@settings(deadline=None)
@given(st.floats(0.0, 4e-3), st.floats(1.0, 1000.0), st.sampled_from(["spwm", "svpwm", "ddt-gdpwm"]))
def test_calibration_meets_the_measurement(alpha: float, extra: float, modulation: ModulationName) -> None:
    """The energies that made a budget are found again from its total, with a warm resistance too."""
    device = replace(DEVICE, on_resistance_temperature_coefficient=alpha, reverse_recovery_energy=0.3e-3)
    true = replace(INVERTER, device=replace(device, turn_on_energy=1e-6 * extra, turn_off_energy=1e-6 * extra))
    measured = float(loss_budget(MACHINE, true, *MTPA, OMEGA_M, modulation).total[0])
    found = calibrate_switching(measured, MACHINE, replace(INVERTER, device=device), *MTPA, OMEGA_M, modulation)
    assert true.device is not None
    assert found.switching_energy == pytest.approx(true.device.switching_energy, rel=1e-9)
    assert found.turn_on_energy / found.reverse_recovery_energy == pytest.approx(1.0 / 0.3)
    assert found.on_resistance == device.on_resistance


def test_calibration_refuses_a_measurement_below_the_other_losses() -> None:
    """Column 1 has 128.0 W of copper and 607.9 W of conduction loss."""
    with pytest.raises(
        InputError, match=r"700 W is below the copper loss of 128 W plus the conduction loss of 607\.9 W"
    ):
        calibrate_switching(700.0, MACHINE, INVERTER, *ID0, OMEGA_M, "spwm")


def test_calibration_refuses_a_point_or_a_device_without_switching_loss() -> None:
    silent = replace(INVERTER, device=replace(DEVICE, turn_on_energy=0.0, turn_off_energy=0.0))
    with pytest.raises(InputError, match="energies above zero"):
        calibrate_switching(1064.0, MACHINE, silent, *ID0, OMEGA_M, "spwm")
    with pytest.raises(InputError, match="energies above zero"):
        calibrate_switching(1064.0, MACHINE, INVERTER, 0.0, 0.0, OMEGA_M, "spwm")


def test_calibration_refuses_a_point_beyond_the_linear_range() -> None:
    with pytest.raises(InputError, match="spwm makes at most 250 V from 500 V"):
        calibrate_switching(1064.0, MACHINE, INVERTER, *ID0, 450.0, "spwm")


def test_calibration_refuses_thermal_runaway() -> None:
    with pytest.raises(NoSolutionError, match="thermal runaway"):
        calibrate_switching(1064.0, MACHINE, hot_inverter(5e-2), *ID0, OMEGA_M, "spwm")


def test_a_difference_of_rounding_is_no_advantage() -> None:
    """SPWM and SVPWM switch alike; whichever sum comes out lower in the last digits, the first is named."""
    total = np.array([[[100.0 * (1.0 + 1e-12), 100.0 * (1.0 + 1e-6)], [100.0, 100.0]]])
    strategy, modulation = _first_minimum(total)
    assert strategy.tolist() == [0, 0]
    assert modulation.tolist() == [0, 1]


def test_a_junction_hotter_than_permitted_is_not_feasible() -> None:
    """The same point with the limit just below and just above its junction temperature."""
    found = loss_budget(MACHINE, INVERTER, *ID0, OMEGA_M, "spwm")
    junction = float(found.junction_temperature[0])
    for limit, feasible in ((junction - 0.1, False), (junction + 0.1, True)):
        device = replace(DEVICE, max_junction_temperature=limit)
        budget = loss_budget(MACHINE, replace(INVERTER, device=device), *ID0, OMEGA_M, "spwm")
        assert bool(budget.cool_enough[0]) is feasible
        assert bool(budget.feasible[0]) is feasible
