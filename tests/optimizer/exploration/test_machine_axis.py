"""Budgets of many drives at once against `compare_points` of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import cast
from unittest.mock import Mock

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.machines.devices.inverter import DeviceModel, EnergyTable, Inverter
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_tables import energy_factors
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat
from dqforge.machines.names import ModulationName, Strategy
from dqforge.optimizer.exploration import machine_axis
from dqforge.optimizer.exploration.machine_axis import (
    AxisBudgets,
    DriveAxis,
    axis_currents,
    budgets_over_machines,
    drive_axis,
)
from dqforge.optimizer.losses import drive_budget
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget
from dqforge.optimizer.losses.phase_comparison import LossComparison, compare_points
from dqforge.optimizer.operating_points.points import optimal_points

ROWS = 32
MODULATIONS: tuple[ModulationName, ...] = ("spwm", "svpwm", "dpwm1", "ddt-gdpwm")
TORQUE = np.array([40.0, 130.0, 180.0, 60.0, 0.0])
OMEGA = np.array([450.0, 300.0, 200.0, 380.0, 100.0])
# Where most machines weaken their fields, one brakes, some cannot.
WEAKENED = np.array([60.0, -100.0, 30.0, 250.0]), np.array([700.0, 600.0, 900.0, 900.0])
MORE = BudgetOptions(
    MachineLoss(ac_copper=2e-9, hysteresis=0.4, eddy=4e-4, magnet=1e-8),
    WindingHeat(0.05, 65.0),
    0.01,
)


def paper000() -> tuple[LinearMachine, Inverter]:
    design = catalogue.load("paper000-ipmsm-100kw")
    assert isinstance(design.machine, LinearMachine)
    return design.machine, replace(design.inverter, dead_time=0.0)


def machines(seed: int = 1, rows: int = ROWS) -> MachineBatch:
    """Machines within 20 % of paper 000's."""
    base, _ = paper000()
    g = np.random.default_rng(seed)
    names = ("r_s", "l_d", "l_q", "psi_pm", "i_max")
    return MachineBatch.varied(
        base, rows, {name: getattr(base, name) * g.uniform(0.8, 1.2, rows) for name in names}
    )


def single(
    drives: DriveAxis,
    row: int,
    torque: FloatArray,
    omega_m: FloatArray,
    frequency: float | None = None,
    options: BudgetOptions | None = None,
    modulations: Sequence[ModulationName] = MODULATIONS,
) -> LossComparison:
    """One drive by the path of a design."""
    own = replace(
        drives.inverter,
        v_dc=float(drives.v_dc[row]),
        dead_time=float(drives.dead_time[row]),
        f_sw=float(drives.f_sw[row]) if frequency is None else frequency,
    )
    points = tuple(LoadPoint(*pair) for pair in zip(torque.tolist(), omega_m.tolist(), strict=True))
    return compare_points(
        drives.machines.machine(row),
        own,
        LossSettings(points, ("id0", "mtpa"), tuple(modulations)),
        i_max=float(drives.machines.i_max[row]),
        options=options,
        margin=0.05,
    )


def assert_like_single(
    found: AxisBudgets, wanted: LossComparison, row: int, carrier: int, rtol: float
) -> None:
    """Every number within ``rtol`` of the single path, every mark the same where it counts."""
    np.testing.assert_array_equal(found.reached[row, :, :, carrier], wanted.reached)
    np.testing.assert_array_equal(found.usable[row, :, :, carrier], wanted.usable)
    for part in fields(DriveBudget):
        got = getattr(found.budget, part.name)[row, :, :, carrier]
        expected = getattr(wanted.budget, part.name)
        if part.name == "thermal_residual":  # rounding itself
            assert np.nanmax(got, initial=0.0) < 1e-9
        elif expected.dtype == np.bool_:
            np.testing.assert_array_equal(got, expected & wanted.reached, err_msg=part.name)
        else:
            size = np.nanmax(np.abs(expected), initial=0.0)
            np.testing.assert_allclose(
                got, expected, rtol=rtol, atol=rtol * 1e-3 * size, err_msg=part.name
            )


# --- against the single path ----------------------------------------------------------------------


@pytest.mark.thinned
@pytest.mark.parametrize("options", [BudgetOptions(), MORE])
def test_rows_are_the_comparisons_of_single_drives(options: BudgetOptions) -> None:
    drives = drive_axis(machines(), paper000()[1])
    found = budgets_over_machines(
        drives, TORQUE, OMEGA, ("id0", "mtpa"), MODULATIONS, options=options, margin=0.05
    )
    assert found.budget.total.shape == (ROWS, 2, 4, 1, TORQUE.size)
    assert found.exact.all()
    for row in range(ROWS):
        wanted = single(drives, row, TORQUE, OMEGA, options=options)
        assert_like_single(found, wanted, row, 0, 1e-12)


@pytest.mark.thinned
@pytest.mark.parametrize("options", [BudgetOptions(), MORE])
def test_weakened_fields_are_those_of_single_drives(options: BudgetOptions) -> None:
    """The solver of single points stops where the next step would be rounding, 4e-12 of the current
    away; the crossings here are exact to rounding.
    """
    drives = drive_axis(machines(2, 12), paper000()[1])
    found = budgets_over_machines(
        drives, *WEAKENED, ("id0", "mtpa"), MODULATIONS, options=options, margin=0.05
    )
    assert 0 < np.count_nonzero(~found.reached) < 0.5 * found.reached.size
    for row in range(12):
        wanted = single(drives, row, *WEAKENED, options=options)
        assert_like_single(found, wanted, row, 0, 2e-11)


def test_links_dead_times_and_carriers_of_their_own() -> None:
    g = np.random.default_rng(3)
    _, inverter = paper000()
    drives = drive_axis(
        machines(4, 12),
        inverter,
        v_dc=inverter.v_dc * g.uniform(0.9, 1.1, 12),
        dead_time=g.uniform(0.0, 2e-6, 12),
        f_sw=g.uniform(8e3, 3e4, 12),
    )
    found = budgets_over_machines(
        drives, TORQUE, OMEGA, ("id0", "mtpa"), MODULATIONS, options=MORE, margin=0.05
    )
    for row in range(12):
        wanted = single(drives, row, TORQUE, OMEGA, options=MORE)
        assert_like_single(found, wanted, row, 0, 2e-12)


@pytest.mark.thinned
@pytest.mark.parametrize("dead_time", [0.0, 1e-6])
def test_carriers_of_all_drives(dead_time: float) -> None:
    """With a dead time, where the field is weakened, each carrier has its own currents."""
    carriers = np.array([8e3, 2e4, 1e5])
    drives = drive_axis(machines(5, 4), paper000()[1], dead_time=dead_time)
    torque, omega_m = np.append(TORQUE, 60.0), np.append(OMEGA, 700.0)
    found = budgets_over_machines(
        drives, torque, omega_m, ("id0", "mtpa"), MODULATIONS, carriers, margin=0.05
    )
    assert found.budget.total.shape == (4, 2, 4, 3, 6)
    for row in range(4):
        for place, carrier in enumerate(carriers.tolist()):
            wanted = single(drives, row, torque, omega_m, carrier)
            assert_like_single(found, wanted, row, place, 2e-11)


def test_points_of_each_drive() -> None:
    drives = drive_axis(machines(6, 3), paper000()[1])
    torque = TORQUE * np.array([[1.0], [0.9], [0.8]])
    found = budgets_over_machines(drives, torque, OMEGA, ("id0", "mtpa"), ("svpwm",), margin=0.05)
    for row in range(3):
        wanted = single(drives, row, torque[row], OMEGA, modulations=("svpwm",))
        assert_like_single(found, wanted, row, 0, 1e-12)


# --- link voltages ------------------------------------------------------------------------------


def with_energies(inverter: Inverter, voltages: tuple[float, ...]) -> Inverter:
    """The same with turn-on energies at several voltages, twice as large from one to the next."""
    assert inverter.device is not None
    model = inverter.device_model or DeviceModel.from_switch_device(inverter.device)
    assert model.turn_on is not None
    family = model.turn_on.tables[0]
    tables = tuple(
        replace(
            family,
            curves=tuple(
                replace(curve, y=tuple(2.0**k * y for y in curve.y)) for curve in family.curves
            ),
        )
        for k in range(len(voltages))
    )
    return replace(
        inverter, device_model=replace(model, turn_on=EnergyTable(voltages, tables, 1.0))
    )


def test_energies_at_several_voltages_are_read_link_by_link() -> None:
    inverter = with_energies(paper000()[1], (400.0, 600.0))
    v_dc = np.array([450.0, 560.0, 450.0])
    assert energy_factors(inverter, v_dc) is None
    drives = drive_axis(machines(7, 3), inverter, v_dc=v_dc)
    found = budgets_over_machines(drives, TORQUE, OMEGA, ("id0", "mtpa"), MODULATIONS, margin=0.05)
    for row in range(3):
        assert_like_single(found, single(drives, row, TORQUE, OMEGA), row, 0, 1e-12)


def test_energies_of_one_voltage_follow_its_powers() -> None:
    inverter = paper000()[1]
    factors = energy_factors(inverter, np.array([0.9, 1.0, 1.1]) * inverter.v_dc)
    assert factors is not None
    assert factors[0, 1] == factors[1, 1] == 1.0
    single_table = with_energies(inverter, (400.0,))
    assert single_table.device_model is not None
    assert single_table.device_model.turn_off is not None
    steeper = replace(single_table.device_model.turn_off, exponent=1.4)
    other = replace(single_table, device_model=replace(single_table.device_model, turn_off=steeper))
    assert energy_factors(single_table, np.ones(1)) is not None
    assert energy_factors(other, np.ones(1)) is None  # turn-on and turn-off by different powers


def test_modules_with_tables_and_junctions_of_their_own() -> None:
    """An IGBT module whose events and recoveries follow different powers of the link voltage."""
    design = catalogue.load(
        "paper000-ipmsm-100kw",
        (
            "inverter.device={name: fuji-2mbi300xbe120-50}",
            "inverter.switching_frequency=10 kHz",
            "control.sampling_frequency=10 kHz",
        ),
    )
    v_dc = design.inverter.v_dc * np.linspace(0.9, 1.1, 6)
    factors = energy_factors(design.inverter, v_dc)
    assert factors is not None
    assert np.max(np.abs(factors[0] - factors[1])) > 0.01
    drives = drive_axis(machines(16, 6), replace(design.inverter, dead_time=0.0), v_dc=v_dc)
    found = budgets_over_machines(
        drives, TORQUE, OMEGA, ("id0", "mtpa"), ("svpwm", "ddt-gdpwm"), margin=0.05
    )
    for row in range(6):
        wanted = single(drives, row, TORQUE, OMEGA, modulations=("svpwm", "ddt-gdpwm"))
        assert_like_single(found, wanted, row, 0, 1e-12)
    assert np.nanmin(found.budget.diode_temperature) > design.inverter.coolant_temperature


def test_work_is_done_once_for_all_drives(monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Mock(wraps=drive_budget.supplied_budget)
    monkeypatch.setattr(machine_axis, "supplied_budget", counted)
    v_dc = np.linspace(450.0, 550.0, 8)
    drives = drive_axis(machines(8, 8), paper000()[1], v_dc=v_dc)
    carriers = np.geomspace(8e3, 1e5, 20)
    budgets_over_machines(drives, TORQUE, OMEGA, ("mtpa",), MODULATIONS, carriers)
    assert counted.call_count == 1


def test_overmodulation_is_that_of_single_drives() -> None:
    """Beyond the circle the harmonics know the link voltage itself: row by row of it."""
    inverter = replace(paper000()[1], overmodulation="least-phase-error")
    drives = drive_axis(machines(15, 3), inverter, v_dc=np.array([470.0, 500.0, 470.0]))
    torque, omega_m = np.array([40.0, 60.0]), np.array([450.0, 760.0])
    found = budgets_over_machines(
        drives, torque, omega_m, ("id0", "mtpa"), ("svpwm", "ddt-gdpwm"), margin=0.05
    )
    share = found.budget.voltage / drives.v_dc[:, None, None, None, None]
    assert np.nanmax(share) > 1.0 / np.sqrt(3.0)
    for row in range(3):
        wanted = single(drives, row, torque, omega_m, modulations=("svpwm", "ddt-gdpwm"))
        assert_like_single(found, wanted, row, 0, 1e-9)


# --- currents -----------------------------------------------------------------------------------


def test_crossings_make_the_torque_at_the_limit_of_least_current() -> None:
    """Torque and voltage to rounding, no more current than the solver of single points takes."""
    batch = machines(9, 40)
    torque, omega_m, v_max = np.full(40, 60.0), np.full(40, 700.0), np.full(40, 270.0)
    found = axis_currents(batch, "mtpa", torque, omega_m, v_max, BudgetOptions())
    made = batch.torque(found.i_d, found.i_q)
    volts = np.hypot(*batch.voltage(found.i_d, found.i_q, batch.pole_pairs * omega_m))
    weak = volts > 0.999 * v_max
    assert np.count_nonzero(weak & found.reached) > 20
    np.testing.assert_allclose(made[found.reached], 60.0, rtol=4e-15)
    np.testing.assert_allclose(volts[weak], 270.0, rtol=4e-15)
    for row in np.flatnonzero(found.reached).tolist():
        one = optimal_points(
            batch.machine(row), 60.0, 700.0, v_max=270.0, i_max=float(batch.i_max[row])
        )
        size = np.hypot(found.i_d[row], found.i_q[row])
        assert size == pytest.approx(np.hypot(one.i_d[0], one.i_q[0]), rel=1e-11)


@pytest.mark.parametrize(
    ("psi_pm", "l_d", "l_q"),
    [(0.06, 3e-3, 3e-3), (0.0, 20e-3, 60e-3), (0.0, 60e-3, 20e-3), (0.3, 5e-3, 3e-3)],
)
def test_every_kind_of_linear_machine(psi_pm: float, l_d: float, l_q: float) -> None:
    """Without saliency, without magnet, with the d axis as the one of more inductance."""
    machine = LinearMachine(3, 0.5, l_d, l_q, psi_pm, 15.0)
    speeds = np.linspace(20.0, 900.0, 23)
    torque = np.where(np.arange(23) % 3 == 2, -1.0, 1.0) * (0.8 if psi_pm < 0.1 else 4.0)
    batch = MachineBatch.varied(machine, 23, {})
    found = axis_currents(batch, "mtpa", torque, speeds, np.full(23, 150.0), BudgetOptions())
    wanted = optimal_points(machine, torque, speeds, v_max=150.0)
    np.testing.assert_array_equal(found.reached, wanted.reached)
    assert found.reached.any()
    held = found.reached
    # Without a magnet the opposite current is as good, and the solver of points may take that.
    turned = np.where((psi_pm == 0.0) & (found.i_d * wanted.i_d < 0.0), -1.0, 1.0)[held]
    for name in ("i_d", "i_q"):
        np.testing.assert_allclose(
            getattr(found, name)[held], turned * getattr(wanted, name)[held], rtol=1e-9, atol=1e-9
        )


def test_points_on_a_limit_are_left_to_the_single_path() -> None:
    batch = machines(10, 2)
    most = batch.torque(*(np.asarray(part) for part in _at_limit(batch)))
    for factor, doubtful in ((1.0 - 1e-4, False), (1.0, True), (1.0 + 1e-4, False)):
        found = axis_currents(
            batch, "mtpa", factor * most, np.ones(2), np.full(2, 250.0), BudgetOptions()
        )
        np.testing.assert_array_equal(found.doubtful, doubtful)
    drives = drive_axis(batch, paper000()[1])
    budgets = budgets_over_machines(drives, np.array([most[0]]), np.ones(1), ("mtpa",), ("svpwm",))
    np.testing.assert_array_equal(budgets.exact, [False, True])


def _at_limit(batch: MachineBatch) -> tuple[FloatArray, FloatArray]:
    """MTPA currents at the current limit, by a fine scan of the angle and a parabola."""
    found = []
    for row in range(batch.count):
        one = batch.machine(row)
        low, high = 0.5 * np.pi, np.pi
        for _ in range(12):
            angle = np.linspace(low, high, 41)
            torque = one.torque(one.i_max * np.cos(angle), one.i_max * np.sin(angle))
            k = int(np.clip(np.argmax(torque), 1, 39))
            low, high = float(angle[k - 1]), float(angle[k + 1])
        middle = 0.5 * (low + high)
        found.append((one.i_max * np.cos(middle), one.i_max * np.sin(middle)))
    i_d, i_q = np.array(found).T
    return i_d, i_q


# --- summaries and refusals ---------------------------------------------------------------------


def test_means_and_largest_over_the_points() -> None:
    drives = drive_axis(machines(11, 2), paper000()[1])
    found = budgets_over_machines(drives, TORQUE[:3], OMEGA[:3], ("mtpa",), ("svpwm", "dpwm1"))
    total = found.budget.total
    by_hand = 0.6 * total[..., 0] + 0.3 * total[..., 1] + 0.1 * total[..., 2]
    np.testing.assert_allclose(found.mean("total", [60.0, 30.0, 10.0]), by_hand, rtol=1e-14)
    each = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    own = found.mean("total", each)
    assert np.isnan(total[0, ..., 2]).all()  # without weight it does not count
    np.testing.assert_array_equal(own[0], total[0, ..., 0])
    np.testing.assert_array_equal(own[1], total[1, ..., 2])
    np.testing.assert_allclose(found.mean("copper"), np.mean(found.budget.copper, axis=-1))
    hottest = found.budget.junction_temperature.max(axis=-1)
    np.testing.assert_array_equal(found.largest("junction_temperature"), hottest)


def test_the_inverter_s_current_limit_holds_too() -> None:
    inverter = replace(paper000()[1], i_max=20.0)
    drives = drive_axis(machines(12, 2), inverter)
    found = budgets_over_machines(drives, TORQUE[:1], OMEGA[:1], ("mtpa", "id0"), ("svpwm",))
    assert not found.reached.any()
    assert np.isnan(found.budget.total).all()
    assert not found.usable.any()


def test_without_a_device_the_bridge_is_left_out() -> None:
    inverter = replace(paper000()[1], device=None, device_model=None)
    v_dc = np.array([480.0, 500.0])
    drives = drive_axis(machines(13, 2), inverter, v_dc=v_dc)
    found = budgets_over_machines(drives, TORQUE, OMEGA, ("id0", "mtpa"), MODULATIONS, margin=0.05)
    for row in range(2):
        assert_like_single(found, single(drives, row, TORQUE, OMEGA), row, 0, 1e-12)


def test_what_is_solved_one_by_one_is_refused() -> None:
    drives = drive_axis(machines(14, 2), paper000()[1])
    with pytest.raises(InputError, match="least-loss is solved one machine at a time"):
        budgets_over_machines(drives, TORQUE, OMEGA, (cast(Strategy, "least-loss"),), ("svpwm",))
    with pytest.raises(InputError, match="give a strategy, a modulator and points"):
        budgets_over_machines(drives, TORQUE, OMEGA, ("mtpa",), ())
