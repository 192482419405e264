"""A fixed reference on other machines, against the formulas of one machine at a time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drawn_machines import drawn_machines
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine, copper_loss
from dqforge.optimizer.current_reference.forms import CurrentReference, FixedReference
from dqforge.optimizer.exploration.yields import (
    LEAST_SHARE,
    TORQUES,
    FixedHeader,
    loss_penalties,
    nominal_header,
    produced_torque,
    reference_points,
    torque_errors,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents

FORMS = {
    "torque-exact": (IPM, FitSettings(form="torque-exact")),
    "polynomial": (IPM, FitSettings(form="polynomial")),
    "even-odd": (IPM, FitSettings(form="even-odd", degree=4)),
    "closed-form": (IPM, FitSettings(form="closed-form")),
    "inverse": (INVERSE_SALIENT, FitSettings(form="polynomial")),
    "proportional": (SURFACE, FitSettings()),
    "reluctance": (RELUCTANCE, FitSettings(form="closed-form")),
    "q15": (IPM, FitSettings(form="polynomial", format="q15")),
    "q31": (IPM, FitSettings(form="polynomial", format="q31")),
}


@cache
def header_of(form: str) -> tuple[LinearMachine, FixedHeader]:
    machine, settings = FORMS[form]
    return machine, nominal_header(make_design(machine, fit=settings))


@pytest.mark.parametrize("form", FORMS)
def test_errors_and_penalties_are_those_of_each_machine_alone(form: str) -> None:
    machine, header = header_of(form)
    drawn = drawn_machines(machine, 12, 3)
    points = reference_points(header)
    produced = produced_torque(points, drawn)
    errors = torque_errors(header, points, produced)
    penalties = loss_penalties(points, drawn, produced)
    for row in range(drawn.count):
        single = drawn.machine(row)
        i_d, i_q = (np.asarray(c, dtype=float) for c in header.reference.currents(points.torque))
        made = single.torque(i_d, i_q)
        least = copper_loss(single.r_s, *mtpa_currents(single, made))
        penalty = np.max(copper_loss(single.r_s, i_d, i_q) / least - 1.0)
        error = np.max(np.abs(made - points.torque)) / header.torque_max
        assert errors[row] == pytest.approx(error, rel=1e-12, abs=1e-15)
        assert penalties[row] == pytest.approx(penalty, rel=1e-9, abs=1e-13)


@pytest.mark.parametrize("form", ["torque-exact", "polynomial", "reluctance"])
def test_far_below_a_newton_metre_the_penalty_is_that_of_each_machine_too(form: str) -> None:
    machine, header = header_of(form)
    drawn = drawn_machines(machine, 5, 3)
    points = reference_points(header, np.array([0.02, 0.3]))
    penalties = loss_penalties(points, drawn, produced_torque(points, drawn))
    for row in range(drawn.count):
        single = drawn.machine(row)
        least = copper_loss(
            single.r_s, *mtpa_currents(single, single.torque(points.i_d, points.i_q))
        )
        penalty = np.max(copper_loss(single.r_s, points.i_d, points.i_q) / least - 1.0)
        assert penalties[row] == pytest.approx(penalty, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("form", FORMS)
def test_on_its_own_machine_a_header_is_as_good_as_its_fit(form: str) -> None:
    machine, header = header_of(form)
    points = reference_points(header)
    own = MachineBatch.of([machine])
    produced = produced_torque(points, own)
    # A code of 16 bits is 1/32768 of the full scale of 240 N m or of the current limit.
    coarse = 2e-3 if form == "q15" else 2e-4
    assert torque_errors(header, points, produced)[0] < coarse
    assert -1e-12 < loss_penalties(points, own, produced)[0] < coarse


def test_twenty_torques_lie_between_a_twentieth_and_all_of_full_scale() -> None:
    _, header = header_of("torque-exact")
    points = reference_points(header)
    assert points.torque.size == TORQUES
    assert points.torque[0] == pytest.approx(LEAST_SHARE * header.torque_max)
    assert points.torque[-1] == header.torque_max


def test_a_fixed_point_header_is_asked_for_torques_that_have_codes() -> None:
    _, header = header_of("q15")
    assert isinstance(header.reference, FixedReference)
    points = reference_points(header)
    codes = points.torque / header.reference.torque_base * header.reference.scale.one
    assert np.array_equal(codes, np.rint(codes))
    assert points.torque[-1] == header.torque_max
    i_d, i_q = header.reference.codes(codes.astype(np.int64))
    unit = header.reference.current_base / header.reference.scale.one
    assert np.array_equal(points.i_d, i_d * unit)
    assert np.array_equal(points.i_q, i_q * unit)


def test_single_precision_is_that_of_the_header() -> None:
    _, header = header_of("torque-exact")
    assert isinstance(header.reference, CurrentReference)
    points = reference_points(header)
    i_d, i_q = header.reference.currents(points.torque.astype(np.float32))
    assert i_d.dtype == np.float32
    assert np.array_equal(points.i_d, i_d)
    assert np.array_equal(points.i_q, i_q)


def test_a_machine_that_makes_no_torque_has_no_finite_penalty_and_warns_of_nothing() -> None:
    _, header = header_of("torque-exact")
    dead = replace(IPM, psi_pm=0.0, l_q=IPM.l_d)
    points, batch = reference_points(header), MachineBatch.of([IPM, dead])
    produced = produced_torque(points, batch)
    with np.errstate(all="raise"):
        penalties = loss_penalties(points, batch, produced)
    assert np.isfinite(penalties[0])
    assert penalties[1] == np.inf
    assert torque_errors(header, points, produced)[1] == pytest.approx(1.0)


def test_one_machine_more_changes_no_other() -> None:
    _, header = header_of("polynomial")
    points, drawn = reference_points(header), drawn_machines(IPM, 40, 8)
    few = drawn.taken(np.arange(7))
    for machines in (drawn, few):
        produced = produced_torque(points, machines)
        found = loss_penalties(points, machines, produced)[:7]
        assert np.array_equal(found, loss_penalties(points, few, produced[:, :7]))
