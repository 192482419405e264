"""Iron loss by the switching against pulses, sums over harmonics, and the
diffusion of flux into a sheet.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.machines.losses.phase_terminals import (
    harmonic_voltage_square,
    ripple_iron_loss,
    sheet_factor,
)
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.modulation.switched_period import switched_period
from dqforge.machines.names import ModulationName
from dqforge.optimizer.losses.drive_budget import BudgetOptions, drive_budget

V_DC = 400.0


@pytest.mark.parametrize("name", MODULATORS)
@pytest.mark.parametrize("share", [0.1, 0.6, 0.98])
def test_harmonic_voltage_is_that_of_switched_pulses_of_every_modulator(
    name: ModulationName, share: float
) -> None:
    """Of 300 carrier periods, phase by phase in time: the vector's square is 2/3
    of the sum over the phases.
    """
    amplitude = share * MODULATORS[name].linear_limit * V_DC
    period = switched_period(name, amplitude, V_DC, 300, load_angle=0.4)
    starts = np.unique(np.concatenate([[0.0], period.edges.ravel(), [2.0 * math.pi]]))
    middle, length = 0.5 * (starts[1:] + starts[:-1]), np.diff(starts)
    on = np.stack(
        [
            np.searchsorted(period.edges[:, k, 0], middle)
            > np.searchsorted(period.edges[:, k, 1], middle)
            for k in range(3)
        ],
        axis=-1,
    )
    phase = V_DC * (on - on.mean(axis=-1, keepdims=True))
    square = 2.0 / 3.0 * np.sum(length[:, None] * phase**2) / (2.0 * math.pi) - amplitude**2
    assert harmonic_voltage_square(amplitude, V_DC) == pytest.approx(square, rel=2e-3)


def test_loss_is_the_sum_of_the_eddy_losses_of_all_harmonics() -> None:
    """k_c (n omega)^2 psi_n^2 over the harmonics up to the 200th carrier,
    at a carrier ratio of 60.
    """
    amplitude, omega, eddy = 150.0, 300.0, 1e-4
    orders = np.arange(2, 12_000)
    volts = np.abs(switched_period("svpwm", amplitude, V_DC, 60).phase_voltage(orders))
    flux = volts / (orders[:, None] * omega)
    summed = float(np.sum(np.mean(eddy * (orders[:, None] * omega) ** 2 * flux**2, axis=1)))
    assert ripple_iron_loss(eddy, amplitude, V_DC, 1e4) == pytest.approx(summed, rel=0.01)


def test_skin_effect_is_that_of_the_diffusion_equation() -> None:
    """Mean flux of a sheet imposed: loss over its thickness from H = cosh(k y),
    k = (1 + j) / depth.
    """
    for ratio in (0.05, 0.5, 1.0, 2.0, 5.0, 20.0):
        wave = (1.0 + 1.0j) * ratio  # k times the thickness
        y = (np.arange(20_000) + 0.5) / 20_000 - 0.5
        field, current = np.cosh(wave * y), wave * np.sinh(wave * y)
        mean = 2.0 * np.sinh(wave / 2.0) / wave
        assert np.mean(field) == pytest.approx(mean, rel=1e-4)
        loss = float(np.mean(np.abs(current / mean) ** 2))
        # Without skin effect the current density is k^2 y for a mean of one.
        plain = abs(wave) ** 4 / 12.0
        assert sheet_factor(ratio**2 * 1000.0, 1000.0) == pytest.approx(loss / plain, rel=1e-4)
    assert sheet_factor([0.0, 1e9], 1000.0) == pytest.approx([1.0, 3e-3])
    near = sheet_factor(np.array([0.0899, 0.0901]), 1.0)
    assert np.ptp(near) < 1e-6
    assert np.diff(sheet_factor(np.geomspace(1.0, 1e8, 200), 1000.0)).max() <= 0.0


MACHINE = LinearMachine(pole_pairs=3, r_s=0.05, l_d=1e-3, l_q=2e-3, psi_pm=0.1, i_max=100.0)
INVERTER = Inverter(V_DC, 1e4, SwitchDevice("mosfet", 5e-3, 1e-4, 1e-4, 50.0, V_DC, 0.2))


def test_budget_counts_it_and_stays_in_balance() -> None:
    options = BudgetOptions(MachineLoss(hysteresis=0.1, eddy=2e-4))
    found = drive_budget(
        MACHINE,
        INVERTER,
        [-10.0, 0.0],
        [20.0, 5.0],
        [200.0, 50.0],
        tuple(MODULATORS),
        [5e3, 4e4],
        options=options,
    )
    expected = ripple_iron_loss(2e-4, found.voltage, V_DC, 1.0)
    np.testing.assert_allclose(found.ripple_iron, expected, rtol=1e-12)
    assert np.max(np.abs(found.imbalance / found.input_power)) < 1e-9
    skin = drive_budget(
        MACHINE,
        INVERTER,
        -10.0,
        [20.0],
        [200.0],
        ("svpwm",),
        [5e3, 4e4],
        options=replace(options, sheet_corner=1e3),
    )
    ratio = skin.ripple_iron[0, :, 0] / found.ripple_iron[0, 0, 0]
    np.testing.assert_allclose(ratio, sheet_factor([5e3, 4e4], 1e3), rtol=1e-12)
    for none in (BudgetOptions(), replace(options, ripple_resistance=None)):
        assert not drive_budget(
            MACHINE, INVERTER, 0.0, [20.0], [200.0], ("spwm",), options=none
        ).ripple_iron.any()
    with pytest.raises(InputError, match="sheet_corner"):
        BudgetOptions(sheet_corner=0.0)
