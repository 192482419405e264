"""Currents beyond those in proportion to the torque: emitted bit for bit, as they were solved."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.names import Topology
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.phase_control.limited_shapes import (
    fit_limited,
    limited_deviation,
    limited_torques,
)
from dqforge.optimizer.phase_control.phase_controller import LimitedShapes, PhaseControl
from dqforge.optimizer.phase_control.phase_records import Alphabetazero
from dqforge.optimizer.phase_control.torque_limits import LimitedSteps, TorqueSteps
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.emitted_integers import (
    phase_control_inputs,
    phase_control_programme,
)
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.header import (
    phase_control_files,
    phase_control_from,
    plain_solution_control,
)
from dqforge.reports.run import plain_solution
from dqforge.reports.verification.host import verify_files

LINK = {"four-leg": 150.0, "three-wire": 150.0, "split-capacitor": 170.0}

P = near_sinusoidal(96)


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(catalogue.load("paper002-phase-waveforms"))


@pytest.fixture(scope="module")
def document(solution: Solution) -> dict[str, Any]:
    return plain_solution(solution)


def limited_control(topology: Topology) -> PhaseControl:
    plain = plain_control(P, topology)
    fit = fit_limited(plain, P, LINK[topology], 5.94, 400.0, 0.05)
    assert fit is not None
    return replace(plain, limited=fit.shapes)


@pytest.fixture(scope="module")
def control() -> PhaseControl:
    return limited_control("four-leg")


@pytest.fixture(scope="module")
def model(solution: Solution, document: dict[str, Any], control: PhaseControl) -> PhaseControlModel:
    return phase_control_from(plain_solution_control(solution, control), document)


def table_of(model: PhaseControlModel) -> LimitedSteps:
    assert model.limited is not None
    return model.limited


def shapes_of(control: PhaseControl) -> LimitedShapes:
    assert control.limited is not None
    return control.limited


@pytest.mark.slow
@pytest.mark.parametrize("topology", ["four-leg", "three-wire", "split-capacitor"])
def test_compiled_code_is_the_model(
    solution: Solution, document: dict[str, Any], topology: Topology
) -> None:
    control = limited_control(topology)
    model = phase_control_from(plain_solution_control(solution, control), document)
    export = solution.design.export
    verification = verify_files(
        header_files(solution) | phase_control_files(solution, control),
        export.prefix,
        solution.fit.reference,
        export.vectors,
        [phase_control_programme(model)],
    )
    assert verification.languages == ("c99", "c++11")
    rows = phase_control_inputs(model)
    inside = np.isfinite(rows).all(axis=1) & (rows[:, 0] == 1)
    torque, omega_m, v_dc = rows[inside, 8], rows[inside, 5], rows[inside, 6]
    none = np.zeros(torque.size, dtype=np.uint32)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        speed = np.float32(2.0) * omega_m
        place = table_of(model).limited_place(SINGLE, torque, speed, v_dc, none)
    assert np.count_nonzero(place.sign) > 50, "the run hardly visits the table"


def test_single_precision_is_what_was_solved(
    control: PhaseControl, model: PhaseControlModel
) -> None:
    shapes, generator = shapes_of(control), np.random.default_rng(3)
    count = 2000
    omega_e = generator.uniform(-1.1, 1.1, count) * shapes.omega_e[-1]
    torque = generator.uniform(0.0, 1.0, count) * control.torque_max * np.sign(omega_e)
    v_dc = shapes.v_nominal * generator.uniform(0.8, 1.2, count)
    turn = generator.uniform(0.0, 1.0, count)
    exact = limited_deviation(shapes, 1, torque, omega_e, v_dc, 2.0 * np.pi * turn)
    single = [np.asarray(x, dtype=np.float32) for x in (torque, omega_e, v_dc, turn)]
    table = table_of(model)
    nothing = Alphabetazero(*np.zeros((3, count), dtype=np.float32))
    none = np.zeros(count, dtype=np.uint32)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = table.limited_place(SINGLE, single[0], single[1], single[2], none)
    found = np.stack(table.deviated(SINGLE, table.table, nothing, at, single[3]))
    assert np.max(np.abs(exact)) > 0.5
    assert np.max(np.abs(found - exact)) < 2e-4


def test_torques_are_those_of_the_table(control: PhaseControl, model: PhaseControlModel) -> None:
    shapes, count = shapes_of(control), 500
    omega_e = np.linspace(shapes.omega_e[0], 1.2 * shapes.omega_e[-1], count)
    _, most = limited_torques(shapes, omega_e, np.array(shapes.v_nominal))
    single = np.asarray(omega_e, dtype=np.float32)
    link = np.full(count, shapes.v_nominal, dtype=np.float32)
    much = np.full(count, 1000.0, dtype=np.float32)
    gains = replace(model.numbers, torque_max=np.zeros(count, dtype=np.float32))
    limits = TorqueSteps(None, table_of(model))
    found = limits.limited_torque(SINGLE, gains, much, single, link)
    assert np.max(np.abs(found - most)) < 1e-4 * control.torque_max
    generating = limits.limited_torque(SINGLE, gains, -much, single, link)
    assert not np.any(generating)


@pytest.mark.parametrize(
    ("key", "value"),
    [("mirrored", 1), ("v_nominal", 0.0), ("omega_e", [1.0, 1.0]), ("current", [[[[0.0]]]])],
)
def test_foreign_tables_are_refused(
    solution: Solution, document: dict[str, Any], control: PhaseControl, key: str, value: Any
) -> None:
    plain = copy.deepcopy(plain_solution_control(solution, control))
    plain["limited"][key] = value
    with pytest.raises(InputError, match="not what dqforge writes"):
        phase_control_from(plain, document)


def test_sinusoidal_references_have_no_such_table(
    solution: Solution, control: PhaseControl
) -> None:
    with pytest.raises(InputError, match=r"limited_waveforms.*write table"):
        plain_solution_control(solution, replace(control, frame="dqx"))
