"""Linear range with dead time against gates simulated sample by sample."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from modulators import duties, phases_at
from numpy.typing import NDArray

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.names import ModulationName
from dqforge.optimizer.losses.drive_budget import drive_budget
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives

SAMPLES, GAP = 4000, 100
DELTA = GAP / SAMPLES
DEVICE = SwitchDevice("mosfet", 5e-3, 1e-3, 1e-3, 100.0, 400.0, 0.1)


def leg_average(command: float, current: float) -> float:
    """Mean of a leg over a carrier period: each gate turns on GAP samples late,
    in the gaps the current decides.
    """
    carrier = np.abs(2.0 * (np.arange(SAMPLES) + 0.5) / SAMPLES - 1.0)
    wanted = command > carrier
    upper, lower = (_late(gate) for gate in (wanted, ~wanted))
    return float(np.mean(np.where(upper, 1.0, np.where(lower, 0.0, 0.0 if current > 0.0 else 1.0))))


def _late(gate: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A periodic gate that turns on when it was wanted on for GAP samples without a break."""
    total = np.concatenate([[0], np.cumsum(np.concatenate([gate[-GAP:], gate]))])
    return np.asarray(gate & (total[GAP:-1] - total[: -GAP - 1] == GAP))


def line_error(name: ModulationName, amplitude: float, lag: float) -> float:
    """Largest error of the widest line-to-line voltage with compensated duty cycles,
    relative to v_dc.
    """
    errors = []
    for angle in np.radians(np.arange(0.5, 360.0, 3.0)):
        current, duty = phases_at(angle - lag), duties(name, amplitude, float(angle), lag)
        high, low = int(np.argmax(duty)), int(np.argmin(duty))
        made = []
        for k in (high, low):
            rests = name in DISCONTINUOUS and (duty[k] > 1.0 - 1e-9 or duty[k] < 1e-9)
            command = duty[k] + (0.0 if rests else math.copysign(DELTA, current[k]))
            made.append(leg_average(min(max(command, 0.0), 1.0), current[k]))
        errors.append(abs(made[0] - made[1] - (duty[high] - duty[low])))
    return max(errors)


@pytest.mark.parametrize("name", ["spwm", "svpwm", "dpwm1", "ddt-gdpwm"])
def test_compensated_voltage_is_made_up_to_the_limit_and_not_beyond(name: ModulationName) -> None:
    limit = MODULATORS[name].linear_limit * float(dead_time_factor(name, DELTA, 1.0))
    assert line_error(name, 0.99 * limit, 0.3) < 2.0 / SAMPLES
    assert line_error(name, 1.02 * limit, 0.3) > 5.0 / SAMPLES


def test_factor() -> None:
    assert dead_time_factor("svpwm", 2e-6, [1e4, 5e4]) == pytest.approx([0.96, 0.8])
    assert dead_time_factor("dpwm2", 2e-6, 1e4) == pytest.approx(0.98)
    assert dead_time_factor("spwm", 1e-4, 1e4) == 0.0
    assert all(dead_time_factor(name, 0.0, 1e4) == 1.0 for name in MODULATORS)


def test_budget_marks_what_dead_time_takes_at_each_frequency() -> None:
    machine = LinearMachine(3, 0.01, 1e-3, 1e-3, 0.1, 200.0)
    inverter = Inverter(400.0, 1e4, DEVICE, dead_time=2e-6)
    # Without current the amplitude is omega_e psi: 0.97 of the range of SVPWM.
    omega = 0.97 * 400.0 / math.sqrt(3.0) / 0.1 / 3.0
    found = drive_budget(machine, inverter, 0.0, 0.0, [omega], ("svpwm", "dpwm1"), [5e3, 1e4, 2e4])
    assert found.linear[..., 0].tolist() == [[True, False, False], [True, True, False]]
    ideal = drive_budget(
        machine, replace(inverter, dead_time=0.0), 0.0, 0.0, [omega], ("svpwm",), [2e4]
    )
    assert ideal.linear.all()


@pytest.mark.parametrize("strategy", ["mtpa", "least-loss"])
def test_comparison_weakens_the_field_for_it(strategy: str) -> None:
    machine = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0)
    inverter = Inverter(500.0, 2e4, DEVICE, dead_time=1e-6)
    alternatives = Alternatives((strategy,), ("svpwm", "dpwm1"), (1e4, 4e4))  # type: ignore[arg-type]
    found = compare_drives(machine, inverter, [60.0], [900.0], alternatives, i_max=283.0)
    assert found.usable.all()
    volts = found.budget.voltage[0, :, :, 0]
    for m, name in enumerate(alternatives.modulations):
        for f, frequency in enumerate(alternatives.frequencies):
            limit = 500.0 / math.sqrt(3.0) * float(dead_time_factor(name, 1e-6, frequency))
            assert volts[m, f] == pytest.approx(limit, rel=1e-5)
