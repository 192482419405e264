"""Prices of currents by another rule: closed forms on linear machines, searches on a saturated
one.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, SURFACE
from firmware_asked import asked_of
from saturated import ArctanMachine
from scipy.optimize import brentq, minimize_scalar

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.firmware.firmware_method import linear_rule, price_of
from dqforge.optimizer.firmware.targets.vesc import configure, shortfalls


@pytest.mark.parametrize("machine", [IPM, INVERSE_SALIENT, SURFACE])
def test_the_closed_form_costs_nothing_on_linear_machines(machine: LinearMachine) -> None:
    price = price_of(machine, machine.i_max, linear_rule(machine.psi_pm, machine.saliency))
    assert price.torque == pytest.approx(0.0, abs=1e-5)
    assert price.copper_loss == pytest.approx(0.0, abs=1e-4)


def most_torque(machine: ArctanMachine, amplitude: float) -> float:
    """Largest torque of an amplitude by a search along the circle."""

    def lost(angle: float) -> float:
        i_d, i_q = amplitude * math.sin(angle), amplitude * math.cos(angle)
        return -float(machine.torque(np.array([i_d]), np.array([i_q]))[0])

    found = minimize_scalar(lost, bounds=(-1.5, 1.5), method="bounded", options={"xatol": 1e-9})
    return -float(found.fun)


def test_a_saturated_machine_against_searches() -> None:
    machine = ArctanMachine()
    rule = linear_rule(machine.psi_pm, machine.saliency)
    price = price_of(machine, machine.i_max, rule)
    i_d, i_q = rule(np.array([machine.i_max]))
    made = float(machine.torque(i_d, i_q)[0])
    assert price.torque == pytest.approx(1.0 - made / most_torque(machine, machine.i_max), rel=1e-3)
    needed = float(brentq(lambda i: most_torque(machine, i) - made, 1.0, machine.i_max))
    assert price.copper_loss == pytest.approx((machine.i_max / needed) ** 2 - 1.0, rel=2e-2)
    assert price.torque > 1e-3


def test_vescs_closed_form_on_a_saturated_machine_is_priced_in_its_shortfalls() -> None:
    asked = asked_of(ArctanMachine(), v_dc=400.0)
    held = configure(asked)
    assert held.own["foc_mtpa_mode"] == 1
    (lost,) = [one for one in shortfalls(asked, held) if "closed form" in one.words]
    expected = price_of(
        asked.design.machine,
        asked.design.i_max,
        linear_rule(float(held.own["foc_motor_flux_linkage"]), asked.design.machine.saliency),
    )
    assert [price.of for price in lost.prices] == ["torque", "copper loss"]
    assert lost.prices[0].value == pytest.approx(expected.torque, rel=1e-3)
