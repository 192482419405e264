"""Where a proof has no ground to stand on, it says so: no bound, or an infinite one."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from drives import IPM, RELUCTANCE

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings, WeakeningSettings
from dqforge.machines.errors import InputError
from dqforge.optimizer.certificates import current_reference
from dqforge.optimizer.certificates import current_reference as interval_newton
from dqforge.optimizer.certificates.ball import Balls, Task, pieces
from dqforge.optimizer.certificates.current_reference import UNKNOWN, Interval, certify
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.field_weakening import certificate as surface
from dqforge.optimizer.field_weakening import error_bounds as dual
from dqforge.optimizer.field_weakening.certificate import certify_surface
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening
from dqforge.optimizer.field_weakening.voltage_region import TORQUE_SHARE
from dqforge.optimizer.observers.methods.lpv_certificate import LyapunovSearch
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

CHOICE = CurrentChoice(IPM, "mtpa", IPM.i_max)


@pytest.fixture(scope="module")
def weakened() -> WeakeningFit:
    machine = replace(IPM, r_s=0.0)
    return fit_weakening(machine, machine.i_max, 270.0, WeakeningSettings(900.0))


def no_division(*_: object) -> object:
    raise ZeroDivisionError


def interval_of(choice: CurrentChoice) -> tuple[Task, Interval]:
    reference = fit_reference(choice, FitSettings()).reference
    piece = pieces(reference)[0]
    return Task.of(choice, reference), Interval(piece, 20.0, 20.5, 0, UNKNOWN.values())


def test_currents_on_the_edge_of_the_data_have_no_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fit = fit_reference(CHOICE, FitSettings())
    assert certify(CHOICE, fit.reference, fit.errors) is not None
    monkeypatch.setattr(CurrentChoice, "held", lambda _self, torque: np.asarray(torque) > 50.0)
    assert certify(CHOICE, fit.reference, fit.errors) is None


def test_reluctance_machines_are_proven_by_their_square_root() -> None:
    choice = CurrentChoice(RELUCTANCE, "mtpa", RELUCTANCE.i_max)
    fit = fit_reference(choice, FitSettings(form="closed-form"))
    proof = certify(choice, fit.reference, fit.errors)
    assert proof is not None
    end = float(fit.reference.torque_max)
    torque = np.linspace(end / 64.0, end, 2000, dtype=np.float32)
    i_d, i_q = fit.reference.currents(torque)
    exact = choice.currents(torque.astype(np.float64))
    assert proof.i_d is not None
    assert proof.i_q is not None
    assert np.max(np.abs(i_d - exact[0])) <= proof.i_d <= 1e-3
    assert np.max(np.abs(i_q - exact[1])) <= proof.i_q <= 1e-3


def test_an_interval_whose_conditions_cannot_be_solved_has_no_finite_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, interval = interval_of(CHOICE)
    bounds, _ = current_reference._bounds(task, interval, np.full(6, np.inf))
    assert np.isfinite(bounds[2])
    monkeypatch.setattr(current_reference, "newton", no_division)
    monkeypatch.setattr(current_reference, "bounds_near_zero_torque", no_division)
    monkeypatch.setattr(interval_newton, "torque_and_voltage", no_division)
    bounds, may_fall = current_reference._bounds(task, interval, np.zeros(6))
    assert np.all(np.isinf(bounds))
    assert may_fall


def test_torque_and_voltage_stand_where_the_currents_are_not_isolated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, interval = interval_of(CHOICE)
    monkeypatch.setattr(current_reference, "newton", no_division)
    monkeypatch.setattr(current_reference, "bounds_near_zero_torque", no_division)
    bounds, _ = current_reference._bounds(task, interval, np.zeros(6))
    assert np.isfinite(bounds[2])
    assert np.all(np.isinf(bounds[[0, 1]]))


def test_a_surface_without_a_bound_of_the_torque_has_no_certificate(
    weakened: WeakeningFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert dual.largest_torque(weakened.region) is not None

    def never(_: object, i_d: Balls, _i_q: Balls) -> object:
        return np.zeros(i_d.mid.shape, dtype=bool)

    monkeypatch.setattr(dual, "resolved", never)
    monkeypatch.setattr(dual, "_HALVINGS", 2)  # unresolved, however small
    assert dual.largest_torque(weakened.region) is None
    assert certify_surface(weakened.region, weakened.reference) is None


def test_a_surface_with_an_infinite_bound_has_no_certificate(
    weakened: WeakeningFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(_: object, progress: surface._Progress, *_others: object) -> None:
        progress.worst[:] = np.inf

    monkeypatch.setattr(surface, "_refine", endless)
    assert certify_surface(weakened.region, weakened.reference) is None


def test_the_voltage_is_not_bounded_by_bounds_that_are_too_wide() -> None:
    progress = surface._Progress(np.zeros(4), np.zeros(4))
    assert surface._voltage(cast("Any", None), progress, (TORQUE_SHARE * 2.0, 0.0, 0.0)) is None


def test_a_lyapunov_matrix_needs_its_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    import cvxpy

    matrices: FloatArray = np.diag([0.5, 0.4])[np.newaxis]
    assert LyapunovSearch(matrices).within(0.9) is not None

    def gives_up(*_: object, **__: object) -> None:
        raise cvxpy.SolverError("no")

    with monkeypatch.context() as failing:
        failing.setattr(cvxpy.Problem, "solve", gives_up)
        assert LyapunovSearch(matrices).within(0.9) is None
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(InputError, match="needs cvxpy and clarabel"):
        LyapunovSearch(matrices).within(0.9)


def test_where_two_conditions_may_hold_and_neither_is_solved_the_torque_still_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, interval = interval_of(CHOICE)
    monkeypatch.setattr(Task, "conditions", lambda *_: ["loss", "voltage"])
    monkeypatch.setattr(current_reference, "newton", no_division)
    bounds, may_fall = current_reference._bounds(task, interval, np.zeros(6))
    assert np.isfinite(bounds[2])
    assert np.all(np.isinf(bounds[[0, 1]]))
    assert may_fall
