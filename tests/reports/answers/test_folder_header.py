"""A fixed header from the folder that a run wrote."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.errors import InputError
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.exploration.yields import nominal_header
from dqforge.reports.answers.explore import fixed_header, header_from_plain, read_fixed_header
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.output.folder import RUN, write_output
from dqforge.reports.run import export_design
from dqforge.reports.run_folder import MANIFEST

BENCH = "paper001-pmsm-bench"


@cache
def design() -> Design:
    return catalogue.load(BENCH)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("bench") / "out", design())


def written(folder: Path, of: Design) -> Path:
    write_output(folder, RUN, export_design(of, verify=False).files, of)
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def test_what_is_read_is_what_the_design_gives(folder: Path) -> None:
    found, expected = read_fixed_header(folder), nominal_header(design())
    assert replace(found, reference=expected.reference) == expected
    torque = np.linspace(-1.1, 1.1, 301) * expected.torque_max
    one, other = found.reference.currents(torque), expected.reference.currents(torque)
    assert np.array_equal(one[0], other[0])
    assert np.array_equal(one[1], other[1])
    assert found.torque_max == expected.torque_max


def test_gains_are_those_that_the_c_header_spells_out(folder: Path) -> None:
    loop = read_fixed_header(folder).i_q
    assert loop is not None
    texts = [path.read_text() for path in folder.glob("*.h")]
    for name, gain in (("IQ_KP_V_PER_A (", loop.kp), ("IQ_KI_TS_V_PER_A (", loop.ki_ts)):
        spelled = next(text.split(name)[1].split("F)")[0] for text in texts if name in text)
        assert gain == float(np.float32(spelled))


def test_files_that_were_read_before_serve_as_well(folder: Path) -> None:
    files = files_of(folder)
    assert fixed_header(files, "out").i_q == read_fixed_header(folder).i_q
    few = {name: files[name] for name in (MANIFEST, "result.json")}
    assert fixed_header(few, "out").i_q == read_fixed_header(folder).i_q


def test_integers_are_read_as_integers() -> None:
    expected = nominal_header(
        make_design(fit=FitSettings(form="polynomial", format="q15"))
    ).reference
    assert isinstance(expected, FixedReference)
    plain = {
        "drive": {"v_dc_V": 500.0, "reference_omega_m_rad_per_s": None},
        "header": {"reference": to_plain(expected)},
        "gains": None,
        "input": {},
    }
    found = header_from_plain(json.loads(json.dumps(plain)))
    assert found.i_d is found.i_q is None
    assert isinstance(found.reference, FixedReference)
    codes = np.arange(-expected.end, expected.end + 1)
    assert np.array_equal(found.reference.codes(codes)[0], expected.codes(codes)[0])
    assert np.array_equal(found.reference.codes(codes)[1], expected.codes(codes)[1])


def test_a_file_that_was_changed_is_refused(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    header = next(path for path in copy.glob("*.h") if "vectors" not in path.name)
    header.write_bytes(header.read_bytes().replace(b"F)", b"1F)", 1))
    with pytest.raises(InputError, match="was changed since the run that wrote it") as error:
        read_fixed_header(copy)
    assert header.name in str(error.value)
    files = files_of(folder)
    files["result.json"] = files["result.json"].replace(b"1", b"2", 1)
    with pytest.raises(InputError, match=r"out/result\.json: was changed"):
        fixed_header(files, "out")


def test_line_ends_may_change(folder: Path) -> None:
    files = {
        name: content.replace(b"\n", b"\r\n") if name.endswith((".h", "result.json")) else content
        for name, content in files_of(folder).items()
    }
    assert fixed_header(files, "out").i_q == read_fixed_header(folder).i_q


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"header": None}, "header is missing"),
        ({"header": {"prefix": "x"}}, r"header\.reference is missing"),
        ({"drive": {"v_dc_V": "much"}}, r"drive\.v_dc_V must be a finite number, got 'much'"),
        ({"gains": {"i_d": {"kp": True}}}, r"gains\.i_d\.kp must be a finite number, got True"),
    ],
)
def test_a_result_of_another_kind_is_refused(
    folder: Path, change: dict[str, Any], words: str
) -> None:
    result: dict[str, Any] = json.loads((folder / "result.json").read_bytes())
    with pytest.raises(InputError, match=words):
        header_from_plain(result | change)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_fixed_header(tmp_path)
    with pytest.raises(InputError, match="is not what dqforge wrote"):
        fixed_header({}, "out")
