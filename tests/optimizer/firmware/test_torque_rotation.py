"""moteus' torque over current, fitted to machines that saturate."""

from __future__ import annotations

import numpy as np
import pytest
from drives import IPM
from saturated import ArctanMachine

from dqforge.optimizer.firmware.moteus_format import NEVER, TorqueRotation, torque_rotation

CURRENT = np.linspace(0.0, 120.0, 2001)


def largest_error(found: TorqueRotation, constant: float, torque: np.ndarray) -> float:
    return float(np.max(np.abs(found.torque(constant, CURRENT) - torque)))


def test_a_machine_that_is_one_of_these_models_is_found_again() -> None:
    true = TorqueRotation(40.0, 0.05, 12.0, 0.0, 0.0, 0.0)
    constant = 0.5

    class Model(ArctanMachine):
        def torque(self, i_d: np.ndarray, i_q: np.ndarray) -> np.ndarray:
            return true.torque(constant, i_q) + 0.0 * i_d

    found = torque_rotation(Model(), constant, 120.0)
    assert found.cutoff == pytest.approx(true.cutoff, rel=0.02)
    assert found.error < 1e-3 * found.largest
    assert largest_error(found, constant, true.torque(constant, CURRENT)) < 1e-3 * found.largest


def test_the_stated_error_is_that_of_the_machine_and_no_neighbour_is_better() -> None:
    machine = ArctanMachine()
    constant = machine.torque_per_ampere
    torque = machine.torque(np.zeros_like(CURRENT), CURRENT)
    found = torque_rotation(machine, constant, 120.0)
    assert largest_error(found, constant, torque) == pytest.approx(found.error, rel=1e-2)
    assert found.straight == pytest.approx(np.max(np.abs(constant * CURRENT - torque)), rel=1e-3)
    assert found.error < 0.2 * found.straight
    for change in ((1.03, 1.0, 1.0), (0.97, 1.0, 1.0), (1.0, 1.1, 1.0), (1.0, 1.0, 1.02)):
        near = TorqueRotation(
            found.cutoff * change[0],
            found.current_scale * change[1],
            found.torque_scale * change[2],
            *(found.error, found.straight, found.largest),
        )
        assert largest_error(near, constant, torque) > found.error * (1.0 - 1e-3)


def test_a_linear_machine_keeps_the_torque_constant_alone() -> None:
    found = torque_rotation(IPM, IPM.torque_per_ampere, IPM.i_max)
    assert found.cutoff == NEVER
    assert found.error < 1e-9
