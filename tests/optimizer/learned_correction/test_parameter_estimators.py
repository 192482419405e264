"""Estimators of resistance and flux linkage by gates, rules and neurons: what they move, and what
they see.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from learned_parameters import (
    GATES,
    bench,
    design_numbers,
    fuzzy_trust,
    missing,
    neural_trust,
    omega_most,
    run,
    warm_drives,
)
from learned_speed import instructions

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.online_estimation import at_rest, gains_of, sought_of, start, step
from dqforge.optimizer.steps.step_arithmetic import EXACT, AlphaBeta


def test_the_gates_open_where_the_emitted_step_moves() -> None:
    design = bench()
    gains, sought = gains_of(design), sought_of(design)
    rng = np.random.default_rng(3)
    speed, current = rng.uniform(0.0, 1.0, (2, 400)) ** 2
    numbers = design_numbers(design)
    opened = [
        GATES[n](EXACT, tuple(numbers[2 * n : 2 * n + 2]), 2.0 * speed - 1.0, 2.0 * current - 1.0)
        for n in range(2)
    ]
    for n, (w, i) in enumerate(
        zip(speed * omega_most(design), current * design.i_max, strict=True)
    ):
        state = at_rest()
        start(EXACT, gains, state)
        turn = w * design.control.t_s
        for k in range(2):
            at = AlphaBeta(-i * np.sin(k * turn), i * np.cos(k * turn))
            none: Any = 0.0
            step(sought, EXACT, gains, state, AlphaBeta(none, none), at, k * turn, w)
        assert int(state.status) == int(opened[0][n] + 2 * opened[1][n])


def test_the_voltage_beside_the_model_is_that_of_the_changed_machine() -> None:
    design = bench()
    machine, plant = design.machine, warm_drives(design, 20, 5)
    volts, omega = missing(design, plant, 7, 0.6)
    i, seen = plant.current[:, 7], plant.current[:, 7] * (1.0 + plant.sensor)
    for n in range(20):
        true = LinearMachine(
            pole_pairs=3,
            r_s=machine.r_s * 1.21,
            l_d=machine.l_d * (1.0 + plant.l_d[n]),
            l_q=machine.l_q * (1.0 + plant.l_q[n]),
            psi_pm=machine.psi_pm * 0.94,
            i_max=6.4,
        )
        model = replace(true, r_s=0.0, psi_pm=0.0, l_d=machine.l_d, l_q=machine.l_q)
        v = _steady(true, i[n], omega[n]) - _steady(model, seen[n], omega[n])
        v += plant.dead[n] * i[n] / abs(i[n])
        assert volts[n] == pytest.approx(v, rel=1e-12)


def _steady(machine: LinearMachine, i: complex, omega: float) -> complex:
    """Equations of the page, at rest in coordinates of the rotor."""
    psi_d, psi_q = machine.psi_pm + machine.l_d * i.real, machine.l_q * i.imag
    v_d = machine.r_s * i.real - omega * psi_q
    return complex(v_d, machine.r_s * i.imag + omega * psi_d)


def test_gates_that_never_open_are_no_estimation_and_wide_ones_spoil_it() -> None:
    design = bench()
    plant = warm_drives(design, 60, 6)
    shut = run(GATES, np.array([9.0, 0.0, 9.0, 0.0]), design, plant)
    assert shut.resistance == pytest.approx(np.ones((1, 60)))
    assert shut.flux == pytest.approx(np.ones((1, 60)))
    own = run(GATES, design_numbers(design), design, plant)
    wide = run(GATES, np.array([0.0, 9.0, 0.0, 0.0]), design, plant)
    assert own.resistance.mean() < 0.9
    assert own.flux.mean() < 0.5
    assert wide.criterion > 3.0 * own.criterion


def test_rules_of_one_and_neurons_of_nought_trust_alike_everywhere() -> None:
    speed, current = np.random.default_rng(0).uniform(-1.2, 1.2, (2, 300))
    assert fuzzy_trust(EXACT, tuple([0.7] * 25), speed, current) == pytest.approx(0.7)
    assert fuzzy_trust(EXACT, tuple([7.0] * 25), speed, current) == pytest.approx(1.0)
    assert neural_trust(EXACT, tuple([0.0] * 12), speed, current) == pytest.approx(0.5)
    steep = np.ravel([(1.0, 9.0, 0.0)] * 4)
    found = neural_trust(EXACT, tuple(steep), np.array([-1.0, 1.0]), np.zeros(2))
    assert found == pytest.approx([0.0, 1.0])


@pytest.mark.slow
def test_gates_cost_a_tenth_of_rules() -> None:
    assert 5.0 * instructions(GATES[0], np.array([0.4, 0.1])) < instructions(
        fuzzy_trust, np.linspace(0.0, 1.0, 25)
    )
