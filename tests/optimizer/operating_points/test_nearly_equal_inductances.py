"""References of machines whose d current is next to nothing, or nothing at all:
every form and every format.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from one_sided import one_sided

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitBudget, FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import BreakpointMode, FitForm, FitMethod, NumberFormat
from dqforge.optimizer.current_reference.fit import ReferenceFit, alternatives, fit_reference
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.current_reference.solve import choose_fit
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

_MACHINES = (
    (4, 2e-3, 350e-6, 0.1049, 283.0),
    (3, 0.5, 1.6e-3, 0.06, 12.0),
    (5, 0.05, 50e-6, 8e-3, 60.0),
)
_RATIOS = (-1e-7, 0.0, 3e-16, 1e-9, 1e-3)
_ALL_RATIOS = tuple(sign * 10.0**power for sign in (-1.0, 1.0) for power in range(-15, -1))
_FORMS: tuple[FitForm, ...] = ("polynomial", "even-odd", "torque-exact", "closed-form")
_FORMATS: tuple[NumberFormat, ...] = ("float32", "q15", "q31")
_SATURATED = ("baldor-pmsyrm-5k6",)


def _machine(constants: tuple[int, float, float, float, float], ratio: float) -> LinearMachine:
    pole_pairs, r_s, l_d, psi_pm, i_max = constants
    return LinearMachine(pole_pairs, r_s, l_d, l_d * (1.0 + ratio), psi_pm, i_max)


def _settings(choice: CurrentChoice, **changes: Any) -> FitSettings:
    scale = (1.3 * choice.largest_torque(), 1.3 * choice.i_max)
    return replace(FitSettings(full_scale=scale), **changes)


def _check(choice: CurrentChoice, fit: ReferenceFit) -> None:
    """The machine makes the torque with the currents of the reference, to what
    codes and floats resolve.
    """
    reference = fit.reference
    torque = np.linspace(0.0, float(reference.torque_max), 257)
    i_d, i_q = (np.asarray(part, dtype=np.float64) for part in reference.currents(torque))
    if isinstance(reference, FixedReference):
        torque = reference.scale.arguments(reference.nearest(torque))
        code = reference.current_base / reference.scale.one
    else:
        code = 1e-6 * choice.i_max
    exact_d, exact_q = choice.currents(torque)
    allowed = 3.0 * code + 1e-3 * choice.i_max
    assert np.max(np.abs(i_q - exact_q)) <= allowed
    assert np.max(np.abs(i_d - exact_d)) <= allowed
    assert np.max(np.abs(choice.machine.torque(i_d, i_q) - torque)) <= 2e-3 * fit.torque_max


def _all_forms(machine: LinearMachine, forms: tuple[FitForm, ...]) -> None:
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    for number_format, form in product(_FORMATS, forms):
        settings = _settings(choice, form=form, format=number_format)
        if number_format != "float32" and form != "polynomial" and machine.saliency != 0.0:
            with pytest.raises(InputError, match="write form: polynomial"):
                fit_reference(choice, settings)
            continue
        _check(choice, fit_reference(choice, settings))


@pytest.mark.thinned
@pytest.mark.parametrize("ratio", _RATIOS)
def test_every_form_and_format(ratio: float) -> None:
    _all_forms(_machine(_MACHINES[1], ratio), _FORMS)


@pytest.mark.slow
@pytest.mark.parametrize("constants", _MACHINES)
@pytest.mark.parametrize("ratio", _ALL_RATIOS)
def test_every_form_and_format_of_many_machines(
    constants: tuple[int, float, float, float, float], ratio: float
) -> None:
    machine = _machine(constants, ratio)
    _all_forms(machine, _FORMS)
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    fit = fit_reference(choice, _settings(choice, form="polynomial"))
    assert {"format q15", "format q31"} <= {row.label for row in alternatives(choice, fit)}


def test_alternatives_of_a_float_fit_include_the_integer_formats() -> None:
    choice = CurrentChoice(_machine(_MACHINES[1], 1e-7), "mtpa", 12.0)
    rows = {
        row.label: row
        for row in alternatives(choice, fit_reference(choice, _settings(choice, form="polynomial")))
    }
    assert rows["format q15"].errors.torque_relative < 1e-3
    assert rows["format q31"].errors.torque_relative < 1e-3


def test_closed_form_that_floats_cannot_hold_is_refused_and_left_out() -> None:
    # psi_pm / (2 |l_q - l_d|) = 5e20 A: its square is no float.
    machine = LinearMachine(3, 0.05, 1e-6, 1e-6 * (1.0 + 4e-16), 0.5, 50.0)
    assert machine.saliency != 0.0
    choice = CurrentChoice(machine, "mtpa", 50.0)
    with pytest.raises(InputError, match=r"closed-form.*write form: torque-exact"):
        fit_reference(choice, _settings(choice, form="closed-form"))
    fit = fit_reference(choice, _settings(choice, form="torque-exact"))
    _check(choice, fit)
    assert "form closed-form" not in {row.label for row in alternatives(choice, fit)}


@pytest.mark.thinned
@pytest.mark.parametrize("name", _SATURATED)
@pytest.mark.parametrize("number_format", _FORMATS)
def test_id0_of_saturated_library_machines(name: str, number_format: NumberFormat) -> None:
    machine = catalogue.load(name).machine
    choice = CurrentChoice(machine, "id0", machine.i_max)
    ways: tuple[tuple[FitMethod, BreakpointMode], ...] = (
        ("minimax", "shared"),
        ("lagrange", "own"),
    )
    for method, mode in ways:
        settings = _settings(
            choice, form="polynomial", format=number_format, method=method, breakpoint_mode=mode
        )
        fit = fit_reference(choice, settings)
        _check(choice, fit)
        i_d, _ = fit.reference.currents(np.linspace(0.0, fit.torque_max, 101))
        assert np.all(i_d == 0.0)


def test_every_saturated_library_machine_with_magnets_is_in_the_list() -> None:
    designs = {name: catalogue.load(name).machine for name in catalogue.names()}
    saturated = {
        name for name, machine in designs.items() if not isinstance(machine, LinearMachine)
    }
    assert {name for name in saturated if designs[name].psi_pm > 0.0} == set(_SATURATED)
    for name in saturated - set(_SATURATED):
        choice = CurrentChoice(designs[name], "id0", designs[name].i_max)
        with pytest.raises(InputError, match="needs magnet flux"):
            fit_reference(choice, FitSettings(form="polynomial"))


@pytest.mark.thinned
@pytest.mark.parametrize("number_format", [None, "q31"])
def test_id0_within_a_budget(number_format: NumberFormat | None) -> None:
    machine = one_sided("everywhere", 0.3e-3, 0.8e-3, 1.0)
    choice = CurrentChoice(machine, "id0", machine.i_max)
    budget = FitBudget(torque_error=0.005)
    found = choose_fit(
        choice, _settings(choice, form="polynomial", format=number_format, budget=budget), budget
    )
    assert found.fit.errors.torque_relative <= 0.005
    _ = alternatives(choice, found.fit)
