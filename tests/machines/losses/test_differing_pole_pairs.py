"""Losses over a mechanical turn: of equal pole pairs written out they are those of one period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.machines.losses.phase_terminals import phase_terminals
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.flashing_choice import residual_currents
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    PhaseControl,
    PhaseShape,
)
from dqforge.optimizer.waveforms.constraint_rows import unit_currents

ONE = PhaseMachine.from_harmonics(
    [1, 3, 5],
    [0.2, 0.02, 0.006],
    [0.0, 0.3, np.pi],
    pole_pairs=5,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=10.0,
)
WHOLE = replace(ONE, flux=np.tile(ONE.flux, 5), turns=5)
LOSS = MachineLoss(ac_copper=1e-8, hysteresis=1.0, eddy=1e-2, magnet=1e-5)


def test_terminals_of_equal_pole_pairs_are_those_of_one_period() -> None:
    speeds = np.array([0.0, 100.0])
    one, whole = (
        phase_terminals(
            machine,
            np.stack([unit_currents(machine, "dqy")] * 2),
            speeds,
            "four-leg",
            loss=LOSS,
            neutral_resistance=0.1,
            neutral_inductance=1e-3,
        )
        for machine in (ONE, WHOLE)
    )
    for name in ("torque", "copper", "iron", "magnet", "neutral", "shaft_power"):
        np.testing.assert_allclose(getattr(whole, name), getattr(one, name), rtol=1e-9, atol=1e-12)
    for name in ("currents", "voltages", "between"):
        np.testing.assert_allclose(
            getattr(whole, name), np.tile(getattr(one, name), 5), rtol=1e-8, atol=1e-9
        )


def test_what_a_loop_leaves_of_voltages_has_the_orders_of_the_electrical_angle() -> None:
    control = PhaseControl(
        frame="table",
        feedforward="references",
        topology="four-leg",
        shape=PhaseShape(ONE.flux),
        pole_pairs=5,
        r_s=1.0,
        psi_pm=0.2,
        inductances=(8e-3, 8e-3, 5e-3),
        gains=(AxisGains(20.0, 4000.0), AxisGains(20.0, 4000.0), AxisGains(12.0, 2000.0)),
        harmonics=HarmonicGains((-5, 7), (3,), 60.0, 1600.0, 1.0),
        t_s=1e-4,
        torque_max=10.0,
    )
    voltages = np.sign(unit_currents(ONE, "dqy"))
    one = residual_currents(control, voltages, 300.0)
    over = replace(control, shape=PhaseShape(WHOLE.flux, 5))
    whole = residual_currents(over, np.tile(voltages, 5), 300.0, turns=5)
    np.testing.assert_allclose(whole, np.tile(one, 5), atol=1e-12)
