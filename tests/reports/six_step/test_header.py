"""The header of a six-step drive: bit-equal to its model, read back, refused where foreign."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from six_step_drives import bench

from dqforge.machines.errors import InputError
from dqforge.optimizer.six_step.control import CATCHING, RUNNING, STAGES
from dqforge.optimizer.six_step.design import solve_six_step
from dqforge.reports.run import export_design
from dqforge.reports.six_step.header import (
    plain_six_step,
    six_step_from,
    six_step_inputs,
    six_step_outputs,
)


@pytest.mark.thinned
@pytest.mark.parametrize("method", ["zero-crossing", "emf-integration", "diode-conduction"])
def test_the_compiled_control_equals_its_model(method: str) -> None:
    design = bench(f"control.observer.method={method}", "control.six_step.align_time=20 ms")
    output = export_design(design, verify=True)
    assert output.verification is not None
    assert "six_six_step.h" in output.files
    text = output.files["six_six_step.h"].decode()
    assert f"six_{method.replace('-', '_')}_step(" in text
    plain = json.loads(output.files["result.json"])
    assert plain["six_step"]["method"] == method
    assert plain["gains"] is None
    assert six_step_from(plain["six_step_header"]).gains.align == 200


def test_the_sequences_lead_through_every_stage_and_direction() -> None:
    made = solve_six_step(bench("control.six_step.align_time=20 ms"))
    assert made is not None
    emitted = six_step_from(plain_six_step(made))
    inputs = six_step_inputs(emitted.gains, 10_000, 3)
    results = six_step_outputs(emitted.gains, inputs)
    stages = set(results[:, 0].astype(int))
    assert stages >= {CATCHING, RUNNING, *range(2, len(STAGES))}
    running = results[:, 0] == RUNNING
    assert np.min(results[running, 7]) < 0.0 < np.max(results[running, 7])
    assert np.isnan(inputs).any()
    assert np.isfinite(results).all()
    assert set(results[running, 2].astype(int)) == set(range(6))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("method", "flux"),
        ("kp", float("inf")),
        ("align", 0),
        ("ratio", 0),
        ("crossings", [0.0]),
        ("emf", None),
    ],
)
def test_data_of_others_are_refused(key: str, value: Any) -> None:
    made = solve_six_step(bench())
    assert made is not None
    plain = plain_six_step(made)
    place = plain if key == "method" else plain["gains"]
    place = place["observer"] if key == "crossings" else place
    place[key] = value
    with pytest.raises(InputError, match="six_step_header is not what dqforge writes"):
        six_step_from(plain)
