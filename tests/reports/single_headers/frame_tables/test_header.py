"""The emitted frames: compiled, compared with their model, and read back from plain data."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.frame_tables import COLUMNS, fit_frames
from dqforge.reports.single_headers.frame_tables import (
    FrameModel,
    frame_files,
    frame_model_from,
    frame_programme,
    model_results,
    plain_frame_model,
)

DESIGN = catalogue.load("paper002-phase-waveforms", ["export.frame_tables=true"])


def found_tables() -> Any:
    assert isinstance(DESIGN.phase_machine, PhaseMachine)
    return fit_frames(DESIGN.phase_machine, DESIGN.waveform.error)


TABLES = found_tables()
MODEL = FrameModel(TABLES.chosen.table)


def compiled(folder: Path, content: bytes, language: str) -> NDArray[Any]:
    """What the compiled harness answers to the inputs of the programme, shape (N, 21)."""
    program = shutil.which("gcc" if language == "c99" else "g++")
    if program is None:
        pytest.skip(f"no compiler for {language}")
    prefix, part = DESIGN.export.prefix, frame_programme(MODEL)
    (folder / f"{prefix}_frames.h").write_bytes(content)
    (folder / "main.c").write_text(part.harness.source(prefix), encoding="ascii")
    kind = "c" if language == "c99" else "c++"
    flags = ["-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffp-contract=off"]
    subprocess.run(
        [program, "-x", kind, f"-std={language}", *flags, "main.c", "-o", "main"],
        cwd=folder,
        check=True,
    )
    answer = subprocess.run(
        [folder / "main"], input=part.inputs.tobytes(), capture_output=True, check=True
    )
    found = part.results(answer.stdout)
    assert found is not None
    return found


@pytest.mark.parametrize("language", ["c99", "c++11"])
def test_the_compiled_header_equals_its_model_bit_for_bit(tmp_path: Path, language: str) -> None:
    (content,) = frame_files(DESIGN, TABLES).values()
    found = compiled(tmp_path, content, language)
    wanted = frame_programme(MODEL).model
    np.testing.assert_array_equal(found.view(np.uint32), wanted.view(np.uint32))


def test_a_changed_entry_is_found(tmp_path: Path) -> None:
    (content,) = frame_files(DESIGN, TABLES).values()
    text = content.decode("ascii")
    entry = text.index("F,", text.index("frames_table["))
    digit = str((int(text[entry - 1]) + 1) % 10)
    found = compiled(tmp_path, f"{text[: entry - 1]}{digit}{text[entry:]}".encode(), "c99")
    with pytest.raises(VerificationError, match="results of the frames differ from the model"):
        frame_programme(MODEL).require_model(found, "here", "C", any_nan=False)


def test_decoupling_is_the_speed_times_coupling_and_back_emf() -> None:
    inputs, results = model_results(MODEL, 500)
    columns = results.T[: len(COLUMNS)].astype(np.float64)
    at = dict(zip(COLUMNS, columns, strict=True))
    omega, current = inputs[:, 1].astype(np.float64), inputs[:, 2:].T.astype(np.float64)
    for row, axis in enumerate("dq0"):
        total = sum(at[f"c_{axis}{name}"] * current[k] for k, name in enumerate("dq0"))
        total = total + (at["emf"] if axis == "q" else 0.0)
        np.testing.assert_allclose(results[:, len(COLUMNS) + row], omega * total, atol=2e-3)


def test_the_model_is_read_back_from_its_plain_data() -> None:
    plain = json.loads(json.dumps(plain_frame_model(MODEL.table)))
    again = frame_model_from(plain)
    np.testing.assert_array_equal(again.table.entries, MODEL.table.entries)
    assert again.table.parts == MODEL.table.parts
    for key, value in (
        ("parts", 2),
        ("columns", list(COLUMNS)[1:]),
        ("table", plain["table"][:2]),
        ("table", [*plain["table"][:-1], plain["table"][-1][:-1]]),
        ("table", [*plain["table"][:-1], [None, *plain["table"][-1][1:]]]),
        ("table", [row[:-1] for row in plain["table"]]),
    ):
        with pytest.raises(InputError, match="frames_header is not what dqforge writes"):
            frame_model_from(plain | {key: value})
    with pytest.raises(InputError, match="frames_header is not what dqforge writes"):
        frame_model_from({})


def test_every_member_says_what_it_is() -> None:
    (content,) = frame_files(DESIGN, TABLES).values()
    text = content.decode("ascii")
    members = re.findall(r"^    float (\w+); +/\* \S[^*]* \*/$", text, re.MULTILINE)
    assert tuple(members) == COLUMNS
    for row, column in itertools.product("dq0", repeat=2):
        said = f"coupling of the {row} axis with the current of the {column} axis, H"
        assert f"float c_{row}{column};     /* {said} */" in text


@pytest.mark.slow
def test_a_run_writes_and_verifies_the_frames(tmp_path: Path) -> None:
    from dqforge.reports.run import run_design

    output = run_design(DESIGN, verify=True)
    assert "pmsm002w_frames.h" in output.files
    result = json.loads(output.files["result.json"])
    assert result["frame_tables"]["candidates"][0]["errors"]["torque_y"] < 5e-3
    assert "Tables by size, the emitted one first" in output.files["report.html"].decode()
