"""The cheapest form that keeps a budget: kept by errors sampled anew, bytes counted in the header,
none cheaper.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, SURFACE, make_design
from saturated import ArctanMachine

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import FitBudget, FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Core, FitMethod
from dqforge.optimizer.current_reference.fit import (
    _cost,
    constant_bytes,
    estimated_cycles,
    fit_reference,
    least_degree,
    possible_forms,
    reference_bytes,
)
from dqforge.optimizer.current_reference.forms import (
    CurrentReference,
    FixedReference,
    Proportional,
    ReluctanceClosedForm,
    SignedReference,
)
from dqforge.optimizer.current_reference.solve import QuickFits, choose_fit, is_hopeless
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.solution import solve
from dqforge.reports.main_header import header_files

DESIGN = """\
dqforge: 1
name: Budget
machine: {{pole_pairs: 4, resistance: 2 mOhm, inductance_d: 350 uH, inductance_q: 592 uH, magnet_flux: 0.1049 Wb,
  max_current: 283 A, max_speed: 9000 rpm}}
inverter: {{v_dc: 500 V, switching_frequency: 100 kHz}}
fit: {fit}
"""


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("machine", "budget"),
    [
        (IPM, FitBudget(torque_error=2e-3, loss_penalty=1e-3)),
        (IPM, FitBudget(torque_error=1e-6, loss_penalty=1e-3)),
        (IPM, FitBudget(loss_penalty=1e-5, flash=80)),
        (ArctanMachine(), FitBudget(torque_error=5e-3)),
        (RELUCTANCE, FitBudget(torque_error=2e-2)),
    ],
    ids=["both", "no torque error", "flash", "saturated", "reluctance"],
)
def test_budget_is_kept_by_errors_that_are_sampled_anew(
    machine: Machine, budget: FitBudget
) -> None:
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    found = choose_fit(choice, FitSettings(), budget)
    torque = np.linspace(0.0, found.fit.torque_max, 3001)[1:].astype(np.float32)
    i_d, i_q = (
        np.asarray(current, dtype=np.float64) for current in found.fit.reference.currents(torque)
    )
    error = np.max(np.abs(machine.torque(i_d, i_q) - torque)) / found.fit.torque_max
    if budget.torque_error is not None:
        assert error <= budget.torque_error
    if budget.loss_penalty is not None:
        least = np.sum(np.square(choice.currents(machine.torque(i_d, i_q))), axis=0)
        loaded = torque >= 0.05 * found.fit.torque_max
        assert np.max(((i_d**2 + i_q**2) / least - 1.0)[loaded]) <= budget.loss_penalty * 1.001
    if budget.flash is not None:
        assert reference_bytes(found.fit.reference) <= budget.flash
    assert [trial.cycles for trial in found.trials] == sorted(
        trial.cycles for trial in found.trials
    )
    assert not found.trials[-1].quick


def test_no_cheaper_form_keeps_the_budget() -> None:
    """Every candidate of fewer cycles, fitted with the minimax method, is over the budget."""
    budget = FitBudget(torque_error=2e-3, loss_penalty=1e-3)
    choice = CurrentChoice(IPM, "mtpa", IPM.i_max)
    found = choose_fit(choice, FitSettings(), budget)
    best = found.trials[-1]
    for trial in found.trials[:-1]:
        fit = fit_reference(
            choice, FitSettings(form=trial.form, degree=trial.degree, segments=trial.segments)
        )
        assert fit.errors.torque_relative > 2e-3 or fit.errors.loss_relative > 1e-3
    assert (best.form, best.degree, best.segments) == ("even-odd", 3, 1)


@pytest.mark.slow
@pytest.mark.parametrize("tied", [True, False])
@pytest.mark.parametrize(
    "machine", [IPM, ArctanMachine(), RELUCTANCE], ids=["ipm", "saturated", "reluctance"]
)
def test_quick_fits_give_no_candidate_up_that_keeps_the_budget(
    machine: Machine, *, tied: bool
) -> None:
    """With the very errors that the minimax fit reaches as the budget, no
    quick fit is called hopeless.
    """
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    settings = FitSettings(exact_at_zero=tied, continuous=tied)
    quick_fits = QuickFits(choice, settings)
    for form in possible_forms(choice):
        if form == "closed-form" and machine.psi_pm == 0.0:
            continue  # exact
        for degree in range(least_degree(form, settings), 7):
            for segments in range(1, 5):
                wanted = replace(settings, form=form, degree=degree, segments=segments)
                best, quick = fit_reference(choice, wanted).errors, quick_fits.fit(wanted).errors
                # Where single precision makes the error there is no ratio to speak of;
                # nobody asks for less.
                torque = FitBudget(torque_error=max(best.torque_relative, 1e-6))
                loss = FitBudget(loss_penalty=max(best.loss_relative, 1e-6))
                assert not is_hopeless(quick, torque)
                assert not is_hopeless(quick, loss)


@pytest.mark.thinned
@pytest.mark.parametrize("form", ["polynomial", "even-odd", "torque-exact", "closed-form"])
def test_bytes_are_the_constants_of_the_emitted_code(form: str) -> None:
    """Counted in the C text: literals of the evaluator, and the end of the domain."""
    design = make_design(fit=FitSettings(form=form, degree=3, segments=2))  # type: ignore[arg-type]
    solution = solve(design)
    text = header_files(solution)["drive.h"].decode("ascii")
    start = text.index("static inline void drive_current_reference")
    body = text[start : text.index("\n}", start)]
    literals = re.findall(r"\d[\d.e-]*F\b", body)
    # A start of a segment stands in the comparison and in the subtraction; zeros are not constants.
    constants = {literal for literal in literals if float(literal[:-1]) != 0.0}
    assert reference_bytes(solution.fit.reference) == 4 * (len(constants) + 1)
    assert constant_bytes(form, 3, 2) >= reference_bytes(solution.fit.reference)  # type: ignore[arg-type]


def test_estimates_are_the_compiled_instances() -> None:
    """Middles of what tests/benchmarks/test_firmware_cost.py finds."""
    found = [estimated_cycles("polynomial", degree, 2) for degree in (2, 3, 4)]
    assert found == pytest.approx([35.8, 41.8, 49.2], abs=1.0)
    assert estimated_cycles("torque-exact", 4, 2) == pytest.approx(57.8, abs=1.0)
    assert estimated_cycles("even-odd", 3, 1) == pytest.approx(31.5, abs=1.0)


def test_exact_references_need_no_search() -> None:
    found = choose_fit(
        CurrentChoice(SURFACE, "mtpa", SURFACE.i_max), FitSettings(), FitBudget(torque_error=1e-6)
    )
    assert found.fit.form == "proportional"
    assert len(found.trials) == 1


def test_what_cannot_be_kept_is_refused_with_the_closest() -> None:
    choice = CurrentChoice(ArctanMachine(), "mtpa", 120.0)
    with pytest.raises(
        NoSolutionError, match=r"polynomial of degree . with . segments in float32 comes closest"
    ):
        choose_fit(choice, FitSettings(), FitBudget(torque_error=1e-9, flash=60))
    with pytest.raises(NoSolutionError, match="no form has its constants in 8 bytes"):
        choose_fit(choice, FitSettings(), FitBudget(torque_error=0.1, flash=8))


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        ("{torque_error: 0.2 %, degree: 3}", "fit.degree is chosen by the budget fit.torque_error"),
        (
            "{loss_penalty: 0.2 %, form: polynomial}",
            "fit.form is chosen by the budget fit.loss_penalty",
        ),
        ("{flash: 100}", "fit.flash alone says nothing about errors"),
        ("{torque_error: 0.2 %, flash: 100 mm}", "expected a whole number"),
        ("{torque_error: 0.2 %, flash: true}", "expected a number, got true"),
        ("{torque_error: 50 %}", "fit.torque_error"),
    ],
)
def test_budgets_that_make_no_sense_are_named(fit: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_text(DESIGN.format(fit=fit).encode(), "budget.yaml")
    assert message in str(caught.value)
    assert caught.value.line == 6


def test_budget_is_read() -> None:
    design = load_text(
        DESIGN.format(fit="{torque_error: 0.2 %, loss_penalty: 0.1 %, flash: 2 KiB}").encode(),
        "b.yaml",
    )
    assert design.fit.budget == FitBudget(2e-3, 1e-3, 2048)
    plain = load_text(DESIGN.format(fit="{loss_penalty: 0.1 %, flash: 256 B}").encode(), "b.yaml")
    assert plain.fit.budget == FitBudget(None, 1e-3, 256)


def with_formats(core: Core, **changes: object) -> FitSettings:
    return replace(FitSettings(format=None, full_scale=(240.0, 283.0), core=core), **changes)  # type: ignore[arg-type]


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("core", "expected"),
    [
        ("cortex-m4", "float32"),
        ("cortex-m7", "float32"),
        ("cortex-m0plus", "q15"),
        ("cortex-m3", "q15"),
    ],
)
def test_cores_without_floating_point_get_fixed_point(core: Core, expected: str) -> None:
    budget = FitBudget(torque_error=2e-3, loss_penalty=1e-3)
    found = choose_fit(CurrentChoice(IPM, "mtpa", IPM.i_max), with_formats(core), budget)
    assert found.trials[-1].format == expected
    assert found.fit.errors.torque_relative <= 2e-3
    assert found.fit.errors.loss_relative <= 1e-3


@pytest.mark.slow
def test_more_than_sixteen_bits_hold_is_given_to_wider_formats() -> None:
    budget = FitBudget(torque_error=2e-6)
    found = choose_fit(CurrentChoice(IPM, "mtpa", IPM.i_max), with_formats("cortex-m0plus"), budget)
    assert found.trials[-1].format != "q15"
    assert found.fit.errors.torque_relative <= 2e-6


def test_full_scales_that_do_not_hold_leave_fixed_point_out() -> None:
    settings = with_formats("cortex-m0plus", full_scale=(100.0, 283.0))
    found = choose_fit(
        CurrentChoice(IPM, "mtpa", IPM.i_max), settings, FitBudget(torque_error=2e-3)
    )
    assert {trial.format for trial in found.trials} == {"float32"}


# A torque domain of some 1e-5 N m, whose sixth power floats cannot hold.
TINY = LinearMachine(1, 0.1, 62.63e-3, 59.67e-3, 1.155e-3, 5.65e-3)


@pytest.mark.parametrize("method", ["lagrange", "least-squares", "minimax"])
def test_powers_beyond_floats_are_refused_in_words(method: FitMethod) -> None:
    choice = CurrentChoice(TINY, "mtpa", TINY.i_max)
    with pytest.raises(
        NoSolutionError, match=r"fit.degree: degree 6 over a domain of .* write a lower degree"
    ):
        fit_reference(choice, FitSettings(form="polynomial", method=method, degree=6, segments=4))
    found = choose_fit(choice, FitSettings(), FitBudget(torque_error=1e-3, loss_penalty=1e-3))
    assert found.fit.errors.torque_relative <= 1e-3


def test_bytes_in_fixed_point_count_what_differs_once() -> None:
    """Words of 4 bytes for ends, starts and leading numbers, constants as wide as products; nothing
    for zeros."""
    first = FixedSegment(0, 3, (5, 9), (1, 2))
    second = FixedSegment(700, -7, (-40, 9), (3, 0))
    for width, each in ((16, 4), (32, 8)):
        d = FixedPolynomial((first,), width, 700)
        q = FixedPolynomial((first, second), width, 700)
        for reference in (FixedReference(d, q, 1.0, 1.0), FixedReference(None, q, 1.0, 1.0)):
            # 700 and 3 and -7; 5, 9 and -40
            assert reference_bytes(reference) == 4 * 3 + each * 3


def test_a_reference_for_each_sign_has_the_bytes_of_both() -> None:
    first = CurrentReference(Proportional(np.float32(0.5)), np.float32(6.0))
    other = CurrentReference(ReluctanceClosedForm(np.float32(2.0), 1), np.float32(4.5))
    both = reference_bytes(SignedReference(first, other))
    assert both == reference_bytes(first) + reference_bytes(other) == 16


def test_edges_cost_the_squared_error_of_all_curves() -> None:
    curves: list[Any] = [lambda t: -0.3 * t**2 + 0.01 * t**4, np.sinh]
    settings = FitSettings(form="polynomial", method="lagrange", degree=2, segments=2)
    edges = np.array([0.0, 0.9, 2.0])
    found = _cost(curves, settings)(edges)
    t = np.linspace(0.0, 2.0, 20001)
    side = SideConditions(settings.exact_at_zero, settings.continuous)
    total = 0.0
    for curve in curves:
        fit = fit_curve(curve, edges, 2, "lagrange", side)
        total += float(np.trapezoid((curve(t) - fit(t)) ** 2, t))
    assert found == pytest.approx(total, rel=1e-4)
