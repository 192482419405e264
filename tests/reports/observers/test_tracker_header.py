"""Headers of trackers: compiled and equal to their models, read back, refused when changed; the
control that adds their voltage.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.estimators import TunedTracker
from dqforge.reports.observers.float32_model import EmittedTracker, tracker_inputs, tracker_outputs
from dqforge.reports.observers.position_header import (
    emitted_estimator,
    estimator_from,
    plain_estimator,
)
from dqforge.reports.observers.speed_loop_text import plain_tracker, tracker_part
from dqforge.reports.run import RunOutput, export_design, programmes, verify_folder
from dqforge.reports.verification.cortex_m import run_on_target

BALDOR = "baldor-pmsyrm-5k6"
KEYS = {
    "square": "{method: injection}",
    "sine": "{method: injection, wave: sine, samples: 8}",
    "rotating": "{method: injection, wave: rotating}",
    "mapping": "{method: inductance-mapping, period: 2 ms}",
}
EVERY = pytest.mark.parametrize(
    "name",
    ["square", *(pytest.param(name, marks=pytest.mark.slow) for name in KEYS if name != "square")],
)


def _settings(name: str) -> list[str]:
    return [
        f"control.observer={KEYS[name]}",
        "export.control=float32",
    ]


@cache
def _output(name: str, verify: bool = True) -> RunOutput:
    return export_design(catalogue.load(BALDOR, _settings(name)), verify=verify)


@cache
def _tuned(name: str) -> TunedTracker:
    found = solve_gains(catalogue.load(BALDOR, _settings(name))).tracker
    assert found is not None
    return found


@pytest.mark.slow
@EVERY
def test_run_emits_a_verified_header_that_fails_when_changed(name: str, tmp_path: Path) -> None:
    output = _output(name)
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    for file_name, content in output.files.items():
        (tmp_path / file_name).write_bytes(content)
    verify_folder(tmp_path)
    prefix = output.solution.design.export.prefix
    header = tmp_path / f"{prefix}_observer.h"
    text = header.read_text()
    header.write_text(text.replace("_wrap(observer->theta_e + ", "_wrap(observer->theta_e - "))
    with pytest.raises(VerificationError, match="results of the position tracker differ"):
        verify_folder(tmp_path)
    header.write_text(text)
    control = tmp_path / f"{prefix}_control.h"
    whole = control.read_text()
    assert "voltage.beta + state->added.beta" in whole
    control.write_text(whole.replace("voltage.beta + state->added.beta", "voltage.beta"))
    with pytest.raises(VerificationError, match="results of the control functions differ"):
        verify_folder(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["cortex-m0plus", "cortex-m4", "cortex-m7"])
@pytest.mark.parametrize("name", KEYS)
def test_a_tracker_gives_the_bits_of_its_model_on_the_core(name: str, target: str) -> None:
    output = _output(name, verify=False)
    kinds, parts = programmes(json.loads(output.files["result.json"]))
    assert {"control", "observer"} <= set(kinds)
    some = [replace(part, inputs=part.inputs[:500], model=part.model[:500]) for part in parts]
    files = {key: content for key, content in output.files.items() if key.endswith(".h")}
    runs = run_on_target(files, output.solution.design.export.prefix, some, target)
    assert [run.compared for run in runs] == [500] * len(some)


@pytest.mark.thinned
@pytest.mark.parametrize("name", KEYS)
def test_a_tracker_reads_back_as_it_was_written(name: str) -> None:
    tuned = _tuned(name)
    plain = json.loads(json.dumps(plain_estimator(emitted_estimator(tuned))))
    again = estimator_from(plain)
    assert isinstance(again, EmittedTracker)
    inputs = tracker_inputs(again, 2000, 5)
    np.testing.assert_array_equal(
        tracker_outputs(again, inputs),
        tracker_outputs(EmittedTracker(tuned.tracker, tuned.gains), inputs),
    )
    plain["gains"].pop("scale")
    with pytest.raises(InputError, match="run the design again"):
        estimator_from(plain)


@pytest.mark.parametrize("name", KEYS)
def test_samples_that_are_no_numbers_poison_nothing(name: str) -> None:
    tuned = _tuned(name)
    found = EmittedTracker(tuned.tracker, tuned.gains)
    inputs = tracker_inputs(found, 20_000, 3)
    assert np.sum(~np.isfinite(inputs)) > 50
    assert np.all(np.isfinite(tracker_outputs(found, inputs)))


@pytest.mark.parametrize("name", KEYS)
def test_what_is_said_of_a_tracker(name: str) -> None:
    tuned = _tuned(name)
    title, _, rows, _ = tracker_part(tuned)
    assert tuned.tracker.title in title
    said = {row[0]: row[1] for row in rows}
    assert said["speeds"].startswith("from standstill to ")
    plain = plain_tracker(tuned)
    assert plain["omega_low_rad_per_s"] == 0.0
    assert plain["injects"] is True
    assert plain["hears"] == []
    result = json.loads(_output("square").files["result.json"])
    assert result["gains"]["tracker"]["method"] == "injection"
    assert result["control_header"]["injects"] is True


def test_only_the_control_of_a_design_that_injects_has_a_member_for_it() -> None:
    text = _output("square").files["baldor_control.h"].decode("ascii")
    assert "added; /* to be made besides" in text
    without = export_design(catalogue.load(BALDOR, ["export.control=float32"]), verify=False)
    assert b"added" not in without.files["baldor_control.h"]
    assert "injects" not in json.loads(without.files["result.json"])["control_header"]
    assert "tracker" not in json.loads(without.files["result.json"])["gains"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("{method: injection, pole: 400 rad/s}", "'injection' does not use 'pole'"),
        ("{method: inform, wave: sine}", "'inform' does not use 'wave'"),
        ("{method: flux, voltage: 20 V}", "'flux' does not use 'voltage'"),
        ("{method: injection, wave: triangle}", "one of square, sine, rotating"),
        ("{method: injection, voltage: 20 A}", "voltage"),
    ],
)
def test_keys_that_do_not_fit_are_refused(keys: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_text(catalogue.read_text(BALDOR), "drive.yaml", settings=[f"control.observer={keys}"])
