"""Steady errors on warm machines against equations that know nothing of a sampled observer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.estimator_comparison.candidate import (
    LOAD_SHARES,
    WarmErrors,
    WarmState,
    observer_evidence,
    warm_errors,
    warm_states,
)
from dqforge.optimizer.observers.conditions import loads_at, loads_of
from dqforge.optimizer.observers.parts import closed_form_error
from dqforge.optimizer.observers.solve import solve_observer

ABB = "abb-ipmsm-2k2"


def design_with(method: ObserverMethodName, name: str = ABB) -> Design:
    design = catalogue.load(name)
    control = replace(design.control, observer=ObserverSettings(method=method))
    return replace(design, control=control)


def warm_text(temperature: str) -> Design:
    text = catalogue.template().decode()
    assert text.count("  friction: 40e-6 N m s\n") == 1
    made = text.replace(
        "  friction: 40e-6 N m s\n", f"  friction: 40e-6 N m s\n  temperature: {temperature}\n"
    )
    return load_text(made.encode(), "d.yaml")


def shown(states: tuple[WarmState, ...]) -> tuple[int, ...]:
    """The states of a table, of errors that say nothing."""
    none = np.zeros((len(states), 1, 1))
    return WarmErrors(states, np.ones(1), np.ones(1), none, none, none, none).shown


def test_states_follow_the_coefficients_of_copper_and_neodymium() -> None:
    states = warm_states(catalogue.load(ABB))
    assert [(state.winding, state.magnet) for state in states] == [(0, 0), (40, 20), (80, 40)]
    assert [state.r_s for state in states] == pytest.approx([0.0, 0.1572, 0.3144])
    assert [state.psi_pm for state in states] == pytest.approx([0.0, -0.022, -0.044])
    assert shown(states) == (2,)


def test_a_machine_at_its_operating_temperature_is_cold_when_it_is_switched_on() -> None:
    """The firmware's R holds at 100 degC, its psi at 70: switched on at 20 degC the machine has the
    values of the file again.
    """
    design = warm_text(
        "{winding: 100 degC, magnet: 70 degC, copper_coefficient: 0.4 %/K, "
        "magnet_coefficient: -0.2 %/K}"
    )
    machine = linearised(design.machine)
    cold, same, _, hot = warm_states(design)
    assert machine.r_s * (1.0 + cold.r_s) == pytest.approx(2.35)
    assert machine.psi_pm * (1.0 + cold.psi_pm) == pytest.approx(0.06)
    assert (same.r_s, same.psi_pm) == (0.0, 0.0)
    assert machine.r_s * (1.0 + hot.r_s) == pytest.approx(2.35 * (1.0 + 0.004 * 160.0))
    assert machine.psi_pm * (1.0 + hot.psi_pm) == pytest.approx(0.06 * (1.0 - 0.002 * 90.0))
    assert shown(warm_states(design)) == (0, 3)
    for kept in ("winding", "magnet"):
        one = warm_text(f"{{{kept}: 70 degC, magnet_coefficient: -0.2 %/K}}")
        assert shown(warm_states(one)) == (0, 3)


@pytest.mark.parametrize("method", ["extended-emf", "open-loop-flux"])
def test_angles_follow_the_closed_form(method: ObserverMethodName) -> None:
    """The angle of psi_a with R off; what sampling leaves is that of the state without rise."""
    design = design_with(method)
    _, observer = solve_observer(design)
    assert observer is not None
    omega = np.array([0.25, 0.5, 1.0]) * observer.omega_max
    found = warm_errors(design, observer, omega)
    believed = linearised(design.machine)
    for t, state in enumerate(found.states):
        true = replace(
            believed,
            r_s=believed.r_s * (1.0 + state.r_s),
            psi_pm=believed.psi_pm * (1.0 + state.psi_pm),
        )
        for m, load in enumerate(loads_at(design, LOAD_SHARES)):
            current = complex(load.i_d, load.i_q)
            expected = closed_form_error(true, believed, current, omega)
            exact = closed_form_error(believed, believed, current, omega)
            assert found.angle[t, m] - found.angle[0, m] == pytest.approx(
                expected - exact, rel=0.02, abs=1e-4
            )
    assert np.max(np.abs(found.angle[-1])) > np.radians(1.0)
    assert np.allclose(found.speed, 0.0, atol=1e-6)


def test_the_speed_of_the_current_model_is_that_of_its_voltage_equation() -> None:
    """omega^ psi^ = v_q - R^ i_q at i_d = 0 and L_d = L_q, v_q being that of the warm machine."""
    design = design_with("matsui-current")
    surface = replace(linearised(design.machine), l_q=linearised(design.machine).l_d)
    operation = replace(design.operation, strategy="id0")
    design = replace(design, machine=surface, operation=operation)
    _, observer = solve_observer(design)
    assert observer is not None
    found = warm_errors(design, observer, np.array([0.25, 0.5]) * observer.omega_max)
    loads = loads_at(design, LOAD_SHARES)
    for t, state in enumerate(found.states):
        for m, load in enumerate(loads):
            gap = surface.r_s * state.r_s * load.i_q / surface.psi_pm
            expected = state.psi_pm * found.omega + gap
            assert found.speed[t, m] == pytest.approx(expected, rel=0.03, abs=0.2)


def test_dead_time_turns_the_flux_observer_further() -> None:
    design = design_with("flux")
    _, observer = solve_observer(design)
    assert observer is not None
    found = warm_errors(design, observer)
    motoring = found.angle[-1, -1, 1:], found.angle_with_dead_time[-1, -1, 1:]
    assert (motoring[1] > motoring[0] + 1e-3).all()
    no_load = np.array(LOAD_SHARES) == 0.0
    both = found.angle[:, no_load], found.angle_with_dead_time[:, no_load]
    assert both[0] == pytest.approx(both[1], abs=1e-9)


def test_loads_of_a_design_are_those_at_their_shares() -> None:
    design = catalogue.load("baldor-pmsyrm-5k6")
    assert loads_of(design) == loads_at(design, (0.5, 1.0, -0.5, -1.0))
    nothing = loads_at(design, (0.0,))[0]
    jet = design.machine.jet(np.array([nothing.i_d]), np.array([0.0]))
    assert nothing.i_q == 0.0
    assert nothing.l_q == pytest.approx(float(jet.l_qq[0]))
    assert nothing.psi_pm + nothing.l_d * nothing.i_d == pytest.approx(float(jet.psi_d[0]))


def test_a_design_without_position_observer_has_no_evidence() -> None:
    assert observer_evidence(catalogue.load(ABB), None) is None
