"""Every kind of header runs on emulated cores, on the inputs and against the model of the host.

The rest is named.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from current_feedback_design import feedback_design
from drives import on_observer, within_a_percent
from measured_speeds import design as measured_design
from measured_speeds import settings as measured_settings
from six_step_drives import bench as six_step_bench
from start_designs import INJECTION, start_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import VerificationError
from dqforge.machines.names import LEARNED_OBSERVERS, ObserverMethodName
from dqforge.optimizer.observers.methods import ekf as ekf_method
from dqforge.optimizer.observers.methods.ekf import ekf, ekf_gains
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import header_kinds
from dqforge.reports.run import RunOutput, export_design, programmes
from dqforge.reports.verification.cortex_m import reached, run_on_target, verify_on_target
from dqforge.reports.verification.cross_tools import TARGETS
from dqforge.reports.verification.text import target_text

# Of each harness; all of them take a quarter of an hour on a core without floating point.
BENCH = "paper001-pmsm-bench"
ROWS = 2000


@pytest.fixture(autouse=True)
def tools() -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")


@pytest.fixture(autouse=True)
def quick_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search for the covariances is tested where it is written; here any will do."""
    monkeypatch.setattr(
        ekf_method,
        "_consistent",
        lambda m, t_s, top: ekf_gains(ekf(m, t_s, 1e-2, 1e5, 1e-5, top)),
    )


def bench() -> Design:
    design = catalogue.load(BENCH)
    made = on_observer(design, ObserverSettings(method="flux"))
    return replace(made, export=replace(design.export, control=("float32", "q15", "q31")))


def changed(name: str, *changes: tuple[str, str], more: str = "") -> Design:
    text = catalogue.read_text(name).decode()
    for pattern, by in changes:
        text, count = re.subn(pattern, by, text)
        assert count == 1, pattern
    return load_text((text + more).encode(), "design.yaml")


SMALL_RULE = (
    "modulation_choice: {min_frequency: 16 kHz, max_frequency: 60 kHz, modulations: [svpwm, dpwm1],"
    " ripple_current: 1 A, torques: 6, speeds: 7}\n\n"
)
DESIGNS: dict[str, Callable[[], Design]] = {
    "start": lambda: start_design(INJECTION, 1.8),
    "measured speed": lambda: measured_design(measured_settings("mixed")),
    "parameters on line": lambda: changed(
        BENCH, (r"(?m)^  per_unit:$", "  online_estimation: {}\n  commissioning: {}\n  per_unit:")
    ),
    "six-step": six_step_bench,
    "current feedback": lambda: feedback_design("predictive"),
    "control and position observer": bench,
    "speed observer": lambda: catalogue.load(BENCH),
    "phase currents": lambda: changed(
        "paper002-phase-waveforms", (r"(?m)^export:$", "export:\n  frame_tables: true")
    ),
    "salient phase currents": lambda: catalogue.load("salient-phase-waveforms"),
    "rule": lambda: changed(
        "paper000-ipmsm-100kw", (r"(?ms)^modulation_choice:.*?(?=^export:)", SMALL_RULE)
    ),
    "surface": lambda: changed(
        "paper000-ipmsm-100kw",
        (r"(?ms)^modulation_choice:.*?(?=^export:)", ""),
        more="\nfield_weakening: {}\n",
    ),
    "schedule": lambda: changed(
        "baldor-pmsyrm-5k6",
        (
            r"  current_loop:\n(    .*\n)+",
            "  current_loop:\n    method: damping\n    schedule: true\n    bandwidth: 250 Hz\n",
        ),
        (r"  degree: \d+\n  segments: \d+", "  degree: 1\n  segments: 1"),
    ),
}
KINDS = {
    "start": {"start_observer", "startup", "control", "observer"},
    "measured speed": {"speed_measurement"},
    "parameters on line": {"online_estimation", "commissioning", "speed_observer"},
    "six-step": {"six_step"},
    "current feedback": {"current_feedback"},
    "control and position observer": {
        "control",
        "control_q15",
        "control_q31",
        "reference_q15",
        "reference_q31",
        "observer",
        "observer_q15",
        "observer_q31",
    },
    "speed observer": {"speed_observer"},
    "phase currents": {"waveform", "frames"},
    "salient phase currents": {"waveform", "control"},
    "rule": {"modulation", "speed_observer"},
    "surface": {"weakening", "speed_observer"},
    "schedule": {"gains"},
}


@cache
def exported(name: str) -> RunOutput:
    return export_design(DESIGNS[name](), verify=False)


def headers(output: RunOutput) -> dict[str, bytes]:
    return {name: content for name, content in output.files.items() if name.endswith(".h")}


def parts_of(output: RunOutput, rows: int = ROWS) -> tuple[set[str], list[Programme]]:
    """Kinds of the headers that the result describes, and the first rows of their harnesses."""
    kinds, parts = programmes(json.loads(output.files["result.json"]))
    return set(kinds), [
        replace(part, inputs=part.inputs[:rows], model=part.model[:rows]) for part in parts
    ]


def test_each_kind_of_header_is_in_one_of_the_designs() -> None:
    assert set.union(*KINDS.values()) == {kind.name for kind in header_kinds(CAPABILITIES)}
    assert set(KINDS) == set(DESIGNS)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("control and position observer", "cortex-m4"),
        *(
            pytest.param(name, target, marks=pytest.mark.slow)
            for name in DESIGNS
            for target in TARGETS
        ),
    ],
)
def test_every_header_gives_the_bits_of_its_model_on_the_core(name: str, target: str) -> None:
    output = exported(name)
    kinds, parts = parts_of(output)
    assert kinds == KINDS[name]
    outcome = verify_on_target(headers(output), output.solution.design.export.prefix, target, parts)
    assert outcome.not_run == ()
    assert [run.name for run in outcome.runs] == [part.name for part in parts]
    assert all(run.compared == ROWS for run in outcome.runs)
    text = target_text(outcome)
    assert all(f"{ROWS} of the {part.name}" in text for part in parts)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_every_position_observer_runs_on_the_core(method: ObserverMethodName) -> None:
    drive = within_a_percent(on_observer(catalogue.load(BENCH), ObserverSettings(method=method)))
    single = method in LEARNED_OBSERVERS  # these are not there in integers
    export = replace(drive.export, control=("float32",) if single else ("q15", "q31"))
    output = export_design(replace(drive, export=export), verify=False)
    kinds, parts = parts_of(output)
    wanted = {"observer"} if single else {"observer", "observer_q15", "observer_q31"}
    assert wanted <= kinds
    prefix = output.solution.design.export.prefix
    for target in ("cortex-m0plus", "cortex-m7"):
        runs = run_on_target(headers(output), prefix, parts, target)
        assert [run.compared for run in runs] == [ROWS] * len(parts)


@pytest.mark.parametrize(
    ("kind", "pattern", "by"),
    [
        ("observer", r"_wrap\(observer->theta_e \+ ", "_wrap(observer->theta_e - "),
        pytest.param("control", r"zero = 0\.5F", "zero = 0.51F", marks=pytest.mark.slow),
    ],
)
def test_a_changed_header_differs_on_the_core(kind: str, pattern: str, by: str) -> None:
    output = exported("control and position observer")
    _, parts = parts_of(output)
    files = headers(output)
    text, count = re.subn(pattern, by, files[f"bench001_{kind}.h"].decode("ascii"), count=1)
    assert count == 1
    own = [part for part in parts if part.harness.header == kind]
    assert len(own) == 1
    with pytest.raises(
        VerificationError,
        match=rf"on cortex-m4 \d+ of {ROWS} results of the .* differ from the model",
    ):
        run_on_target(files | {f"bench001_{kind}.h": text.encode()}, "bench001", own, "cortex-m4")


def test_what_nothing_runs_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Headers without test vectors, where their harnesses are not given,
    and a kind that nobody has thought of.
    """
    output = exported("control and position observer")
    files = {**headers(output), "bench001_extra.h": b"/* nothing */\n"}
    monkeypatch.setattr("dqforge.reports.verification.cortex_m.build", lambda *_: None)
    monkeypatch.setattr("dqforge.reports.verification.cortex_m.emulate", lambda *_: 0)
    outcome = verify_on_target(files, "bench001", "cortex-m4")
    assert outcome.not_run == ("bench001_control.h", "bench001_extra.h", "bench001_observer.h")
    assert (
        "not run there: bench001_control.h, bench001_extra.h, bench001_observer.h;"
        in target_text(outcome)
    )


def test_includes_are_followed(tmp_path: Path) -> None:
    files = {"a.h": b'#include "b.h"\n', "b.h": b'#include <math.h>\n#include "a.h"\n', "c.h": b""}
    assert reached(files, [b'#include <x.h>\n#include "a.h"\n']) == {"a.h", "b.h"}
