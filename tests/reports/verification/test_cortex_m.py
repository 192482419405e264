"""The emitted headers on emulated cores: bit for bit their model, sensitive to one unit
in the last place, costed.
"""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest
from drives import IPM, RELUCTANCE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import WaveformForm
from dqforge.optimizer.solution import solve
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.main_header import header_files
from dqforge.reports.verification.cortex_m import verify_on_target
from dqforge.reports.verification.cross_tools import TARGETS
from dqforge.reports.verification.text import target_text
from dqforge.reports.waveforms.tables import waveform_files


@pytest.fixture(autouse=True)
def tools() -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")


@cache
def polynomial(degree: int) -> dict[str, bytes]:
    return header_files(solve(make_design(IPM, fit=FitSettings(form="polynomial", degree=degree))))


@cache
def with_waveform(form: WaveformForm) -> dict[str, bytes]:
    design = catalogue.load("paper002-phase-waveforms")
    design = replace(
        design,
        export=replace(design.export, prefix="drive"),
        waveform=replace(design.waveform, form=form),
    )
    return header_files(solve(design)) | waveform_files(design, solve_phases(design))


@pytest.mark.thinned
@pytest.mark.parametrize("target", TARGETS)
def test_every_core_gives_the_bits_of_the_model(target: str) -> None:
    square_root = header_files(solve(make_design(RELUCTANCE, fit=FitSettings(form="closed-form"))))
    exact = header_files(solve(make_design(IPM)))
    for files in (
        polynomial(3),
        square_root,
        exact,
        with_waveform("table"),
        with_waveform("harmonics"),
    ):
        outcome = verify_on_target(files, "drive", target)
        assert outcome.vectors >= 256
        assert outcome.flash > 40
        assert outcome.instructions > 5.0


@pytest.mark.slow
def test_counts_grow_with_the_degree_as_the_operations_do() -> None:
    """Two multiplications and two additions more per degree: 4 instructions,
    or 2 where they are one.
    """
    counts = [
        verify_on_target(polynomial(degree), "drive", "cortex-m4").instructions
        for degree in (2, 3, 4)
    ]
    for fewer, more in pairwise(counts):
        assert 2.0 <= more - fewer <= 8.0
    soft = verify_on_target(polynomial(3), "drive", "cortex-m3").instructions
    assert soft > 8.0 * counts[1]


@pytest.mark.parametrize("part", ["drive.h", "drive_waveform.h"])
def test_one_unit_in_the_last_place_is_seen(part: str) -> None:
    files = dict(with_waveform("harmonics") if part == "drive_waveform.h" else polynomial(3))
    text = files[part].decode("ascii")
    place = text.index("static inline")
    literal = re.search(r"\d\.\d{4,}F", text[place:])
    assert literal is not None
    changed = literal[0][:-2] + str((int(literal[0][-2]) + 1) % 10) + "F"
    files[part] = (text[:place] + text[place:].replace(literal[0], changed, 1)).encode("ascii")
    with pytest.raises(VerificationError, match="do not give the results of their test vectors"):
        verify_on_target(files, "drive", "cortex-m4")


def test_what_is_missing_or_wrong_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        InputError, match=r"--target: expected one of cortex-m0plus, .* got 'cortex-m9'"
    ):
        verify_on_target(polynomial(3), "drive", "cortex-m9")
    broken = polynomial(3) | {
        "drive.h": polynomial(3)["drive.h"].replace(b"float i_d;", b"flote i_d;")
    }
    with pytest.raises(VerificationError, match=r"do not compile for cortex-m4: .*error"):
        verify_on_target(broken, "drive", "cortex-m4")
    monkeypatch.setattr(
        "shutil.which", lambda name: None if name == "qemu-system-arm" else "/bin/true"
    )
    with pytest.raises(
        VerificationError,
        match="qemu-system-arm is missing; install the Debian package qemu-system-arm",
    ):
        verify_on_target(polynomial(3), "drive", "cortex-m4")


@pytest.mark.slow
def test_more_vectors_change_the_mean_little() -> None:
    few, many = (
        verify_on_target(
            header_files(
                solve(make_design(IPM, vectors=count, fit=FitSettings(form="polynomial", degree=3)))
            ),
            "drive",
            "cortex-m3",
        )
        for count in (256, 4096)
    )
    assert many.vectors >= 4096
    assert many.costed == 1024
    assert many.instructions == pytest.approx(
        few.instructions, rel=0.05
    )  # rarer end points cost less


@pytest.mark.slow
def test_cycles_enclose_and_exceed_the_instructions_where_the_tables_say_so() -> None:
    for target in TARGETS:
        outcome = verify_on_target(polynomial(3), "drive", target)
        low, high = outcome.cycles
        assert low < high or target == "cortex-m0plus"
        assert outcome.cycles_largest[0] >= low
        assert outcome.cycles_largest[1] >= high
        assert high > outcome.instructions
        assert (low > outcome.instructions) == (target != "cortex-m7")
        assert f"{low:.0f}-{high:.0f} cycles" in target_text(outcome)


def test_the_mean_is_one_over_whole_instructions() -> None:
    outcome = verify_on_target(polynomial(3), "drive", "cortex-m4")
    total = outcome.instructions * outcome.costed
    assert total == pytest.approx(round(total), abs=1e-6)


def test_vectors_that_are_gone_are_named() -> None:
    files = polynomial(3)
    with pytest.raises(VerificationError, match="holds no test vectors"):
        verify_on_target(files | {"drive_vectors.h": b"/* empty */\n"}, "drive", "cortex-m4")


def test_a_failing_emulator_is_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TARGETS, "cortex-m4", replace(TARGETS["cortex-m4"], machine="nonsense"))
    with pytest.raises(
        VerificationError, match=r"stopped with exit code 1: .*unsupported machine type"
    ):
        verify_on_target(polynomial(3), "drive", "cortex-m4")


def test_a_compiler_without_its_library_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    compiler = tmp_path / "arm-none-eabi-gcc"
    compiler.write_text("#!/bin/sh\necho libnosys.a\n", encoding="ascii")
    compiler.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(
        VerificationError, match=r"install the Debian package libnewlib-arm-none-eabi$"
    ):
        verify_on_target(polynomial(3), "drive", "cortex-m4")
