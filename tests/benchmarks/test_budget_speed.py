"""Budgets of a drive per second: a whole map with many modulators and frequencies in one call,
and point by point.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.optimizer.losses.drive_budget import drive_budget

pytestmark = pytest.mark.benchmark

MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
FREQUENCIES = [4e3, 8e3, 1e4, 16e3, 2e4]


def igbt() -> Inverter:
    """Tables over current and temperature, and separate junctions of transistor and diode."""
    model = device_catalogue.load("sirectifier-sii400s12")
    return Inverter(
        500.0, 8e3, model.switch_device(200.0, 500.0, 100.0, 0.2), 65.0, 2e-6, device_model=model
    )


def test_a_hundred_thousand_budgets_in_one_call() -> None:
    """50 x 50 points, 8 modulators, 5 frequencies.

    The same budgets one by one take the ratio's multiple.
    """
    inverter, modulations = igbt(), tuple(MODULATORS)[:8]
    i_q, omega = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(1.0, 150.0, 50), np.linspace(5.0, 500.0, 50))
    )
    i_d = np.full(i_q.size, -50.0)
    drive_budget(MACHINE, inverter, i_d[:1], i_q[:1], omega[:1], modulations[:1])
    start = time.perf_counter()
    whole = drive_budget(MACHINE, inverter, i_d, i_q, omega, modulations, FREQUENCIES)
    seconds = time.perf_counter() - start
    chosen = np.random.default_rng(0).choice(whole.total.size, 40, replace=False)
    start = time.perf_counter()
    singles = []
    for index in chosen:
        m, f, p = np.unravel_index(index, whole.total.shape)
        point = drive_budget(
            MACHINE,
            inverter,
            i_d[p : p + 1],
            i_q[p : p + 1],
            omega[p : p + 1],
            (modulations[m],),
            [FREQUENCIES[f]],
        )
        singles.append(float(point.total[0, 0, 0]))
    each = (time.perf_counter() - start) / chosen.size
    ratio = each * whole.total.size / seconds
    print(
        "\n"
        f"50 x 50 x 8 x 5 = {whole.total.size:,} budgets in {seconds:.2f} s; one by one "
        f"{ratio:,.0f} times as long"
    )
    assert whole.total.size == 100_000
    assert np.all(whole.steady)
    np.testing.assert_allclose(whole.total.ravel()[chosen], singles, rtol=1e-9)
    assert ratio > 20.0  # some 300 on an idle machine: no loop over points anywhere
