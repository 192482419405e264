"""Overmodulation in the emitted control: bit for bit, and the voltage that its state tells."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.modulation.registry import METHODS, SIX_STEP, follows_hexagon
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import (
    ControlModel,
    control_files,
    control_from,
    control_inputs,
    control_programme,
    control_results,
    plain_control,
)
from dqforge.reports.main_header import header_files
from dqforge.reports.run import plain_solution
from dqforge.reports.verification.host import verify_files

HEXAGONAL = [name for name in MODULATORS if follows_hexagon(name)]


def bench(
    method: OvermodulationName = "least-phase-error", modulation: ModulationName = "svpwm"
) -> Design:
    loaded = catalogue.load("paper001-pmsm-bench")
    return replace(
        loaded,
        operation=replace(loaded.operation, modulation=modulation),
        inverter=replace(loaded.inverter, overmodulation=method, overmodulation_limit=1.0),
        export=replace(loaded.export, control=("float32",)),
    )


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(bench())


def model_of(solution: Solution) -> ControlModel:
    return control_from(plain_control(solution), plain_solution(solution))


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("method", "modulation"),
    [
        ("least-phase-error", "svpwm"),
        ("least-magnitude-error", "svpwm"),
        ("least-phase-error", "dpwm0"),
        ("least-magnitude-error", "ddt-gdpwm"),
    ],
)
def test_compiled_control_equals_the_model_bit_for_bit(
    method: OvermodulationName, modulation: ModulationName, solution: Solution
) -> None:
    changed = replace(solution, design=bench(method, modulation))
    model = model_of(changed)
    assert model.overmodulation == method
    assert float(model.gains["voltage_share"]) == pytest.approx(SIX_STEP)
    inputs = control_inputs(model)
    results = control_results(model, inputs)
    without = control_results(replace(model, overmodulation="none"), inputs)
    with np.errstate(invalid="ignore", divide="ignore"):
        index = np.hypot(without[:, 3], without[:, 4]) / inputs[:, 6]
    turning = METHODS[method].turning
    for low, high in ((1.0 / math.sqrt(3.0), turning), (turning, 0.9999 * SIX_STEP)):
        assert np.count_nonzero((index > low) & (index < high)) > 300
    assert np.count_nonzero(np.any(results != without, axis=1)) > 2000
    export = changed.design.export
    files = header_files(changed) | control_files(changed)
    verification = verify_files(
        files, export.prefix, changed.fit.reference, export.vectors, [control_programme(model)]
    )
    assert verification.languages == ("c99", "c++11")


@pytest.mark.thinned
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("modulation", HEXAGONAL)
def test_state_tells_the_voltage_that_the_duty_cycles_make(
    method: OvermodulationName, modulation: ModulationName, solution: Solution
) -> None:
    model = replace(model_of(solution), overmodulation=method, modulation=modulation)
    inputs = control_inputs(model)
    results = control_results(model, inputs).astype(np.float64)
    v_dc = inputs[:, 6].astype(np.float64)
    powered = np.isfinite(v_dc) & (v_dc > 0.0)
    duty = results[powered, :3]
    x = v_dc[powered] * (2.0 * duty[:, 0] - duty[:, 1] - duty[:, 2]) / 3.0
    y = v_dc[powered] * (duty[:, 1] - duty[:, 2]) / math.sqrt(3.0)
    told = results[powered, 3:5]
    assert np.hypot(x - told[:, 0], y - told[:, 1]) == pytest.approx(
        0.0, abs=1e-6 * v_dc[powered].max()
    )
    assert np.any(np.hypot(x, y) > 0.66 * v_dc[powered])


def test_without_overmodulation_the_header_does_not_know_of_it(solution: Solution) -> None:
    plain = replace(solution, design=bench("none"))
    assert "overmodulation" not in plain_control(plain)
    (text,) = control_files(plain).values()
    assert b"overmodulated" not in text
    described = plain_control(solution) | {"overmodulation": "most-noise"}
    with pytest.raises(Exception, match="control_header is not what dqforge writes"):
        control_from(described, plain_solution(solution))
