"""The evaluator in fixed point: compiled, every code of the torque compared with the integer model,
damage refused.
"""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.current_reference.plain import (
    from_plain,
    reference_harness,
    sweep_codes,
    to_plain,
    vector_codes,
)
from dqforge.reports.main_header import header_files
from dqforge.reports.verification.host import WARNINGS, verify_files

CASES: dict[str, tuple[LinearMachine, FitSettings]] = {
    "q15 shared": (IPM, FitSettings(form="polynomial", degree=4, format="q15")),
    "q15 own": (
        IPM,
        FitSettings(form="polynomial", degree=2, segments=3, breakpoint_mode="own", format="q15"),
    ),
    "q15 free": (
        IPM,
        FitSettings(
            form="polynomial",
            degree=1,
            segments=4,
            exact_at_zero=False,
            continuous=False,
            format="q15",
        ),
    ),
    "q15 straight": (SURFACE, FitSettings(form="polynomial", format="q15")),
    "q31 shared": (IPM, FitSettings(form="polynomial", degree=6, format="q31")),
    "q31 own": (IPM, FitSettings(form="polynomial", degree=3, breakpoint_mode="own", format="q31")),
}


LONG = {"q15 own", "q15 free"}


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=[pytest.mark.slow] if name in LONG else []) for name in CASES],
)
def solution(request: pytest.FixtureRequest) -> Solution:
    machine, fit = CASES[request.param]
    return solve(make_design(machine, fit=fit))


def integers(solution: Solution) -> FixedReference:
    assert isinstance(solution.fit.reference, FixedReference)
    return solution.fit.reference


@pytest.mark.thinned
def test_every_code_equals_the_model(solution: Solution) -> None:
    reference = integers(solution)
    verification = verify_files(header_files(solution), "drive", reference, 256)
    assert verification.languages == ("c99", "c++11")
    assert verification.sweep >= (65_536 if reference.width == 16 else 20_000)


@pytest.mark.thinned
def test_reference_survives_json(solution: Solution) -> None:
    reference = integers(solution)
    assert from_plain(json.loads(json.dumps(to_plain(reference)))) == reference


@pytest.mark.thinned
def test_vectors_hold_both_ends_of_the_type_and_every_breakpoint(solution: Solution) -> None:
    reference = integers(solution)
    codes = set(vector_codes(reference, 256).tolist())
    most = 2 ** (reference.width - 1)
    assert {0, 1, -1, most - 1, -most, reference.end, -reference.end} <= codes
    for start in reference.starts[1:]:
        assert {start, start - 1, -start} <= codes


@pytest.fixture(scope="module")
def found() -> Solution:
    return solve(make_design(IPM, fit=FitSettings(form="polynomial", degree=3, format="q15")))


@pytest.mark.slow
def test_one_unit_of_one_integer_is_seen(found: Solution) -> None:
    reference = integers(found)
    segment = reference.q.segments[0]
    other = replace(
        segment,
        constants=(segment.constants[0] + 2 ** (segment.shifts[0] - 1), *segment.constants[1:]),
    )
    changed = replace(
        reference, q=replace(reference.q, segments=(other, *reference.q.segments[1:]))
    )
    with pytest.raises(
        VerificationError, match="results of the current reference differ from the int16 model"
    ):
        verify_files(header_files(found), "drive", changed, 256)


@pytest.mark.slow
def test_saturation_is_emitted_where_the_ranges_need_it(found: Solution) -> None:
    """A current base that the references just reach: C and model stop at the largest code."""
    chosen = found.curves.chosen
    largest = float(np.max(np.hypot(chosen.i_d, chosen.i_q)))
    text = {}
    for base in (1.2 * largest, float(np.max(np.abs([chosen.i_d, chosen.i_q])))):
        settings = FitSettings(form="polynomial", degree=2, format="q15", full_scale=(240.0, base))
        solution = solve(replace(make_design(IPM), fit=settings))
        files = header_files(solution)
        verify_files(files, "drive", solution.fit.reference, 256)
        text[base] = files["drive.h"].decode("ascii")
    roomy, tight = text.values()
    assert "> 32767)" not in roomy
    held = r"([dq]) = \(\1_0 > 32767\) \? 32767 : \(\(\1_0 < -32767\) \? -32767 : \1_0\);"
    assert re.search(held, tight)


@pytest.mark.thinned
def test_no_code_meets_undefined_behaviour(solution: Solution, tmp_path: Path) -> None:
    """Every code of 16 bits, a million of 32 bits with the ends, under the sanitizer: no overflow,
    no bad shift.
    """
    reference = integers(solution)
    for name, content in header_files(solution).items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "main.c").write_text(reference_harness(reference).source("drive"))
    sanitize = ["-fsanitize=undefined", "-fno-sanitize-recover=all"]
    command = ["gcc", "-std=c99", "-O2", *WARNINGS, *sanitize, "main.c", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    codes = sweep_codes(reference, 1_000_000)
    codes = np.concatenate([codes, vector_codes(reference, 256)]).astype(f"i{reference.width // 8}")
    done = subprocess.run(
        [str(tmp_path / "main")],
        input=codes.tobytes(),
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr.decode()


@pytest.mark.parametrize(
    "damage",
    [
        {"torque_max": 0},
        {"torque_max": 32768},
        {"torque_max": 3.5},
        {"torque_base": -1.0},
        {"current_base": None},
        {"q": None},
        {"q": [{"start": 0, "leading": 1, "steps": []}]},
        {"q": [{"start": 5, "leading": 1, "steps": [[0, 1]]}]},
        {"q": [{"start": 0, "leading": 1, "steps": [[0, 40]]}]},
        {"q": [{"start": 0, "leading": 1, "steps": [[0, -1]]}]},
        {"q": [{"start": 0, "leading": 2**30, "steps": [[0, 15]]}]},
        {"q": [{"start": 0, "leading": True, "steps": [[0, 15]]}]},
        {"d": [{"start": 0, "leading": "1", "steps": [[0, 15]]}]},
        {"format": "q7"},
    ],
)
def test_damaged_plain_data_are_refused(found: Solution, damage: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="run the design again"):
        from_plain(to_plain(found.fit.reference) | damage)


DESIGN = """\
dqforge: 1
name: Fixed point
machine: {{pole_pairs: 4, resistance: 2 mOhm, inductance_d: 350 uH, inductance_q: 592 uH, magnet_flux: 0.1049 Wb,
  max_current: 283 A, max_speed: 9000 rpm}}
inverter: {{v_dc: 500 V, switching_frequency: 100 kHz}}
{rest}
"""


def test_design_file_asks_for_a_format() -> None:
    design = load_text(
        DESIGN.format(rest="control: {per_unit: {torque: 210 N m}}\nfit: {format: q15}").encode(),
        "design.yaml",
    )
    assert design.fit.format == "q15"
    assert design.fit.form == "polynomial"
    assert design.fit.full_scale == (210.0, 283.0)
    assert any(
        "fit.form is polynomial: q15 has no other" in remark for remark in design.assumptions
    )


def test_base_that_is_too_small_is_named() -> None:
    rest = "control: {per_unit: {torque: 178.1 N m}}\nfit: {format: q15}"
    with pytest.raises(
        InputError,
        match=r"control.per_unit.torque: 178.1 N m is full scale in q15.*write torque: 210",
    ):
        solve(load_text(DESIGN.format(rest=rest).encode(), "design.yaml"))
