"""Whole folders of headers under cppcheck with its MISRA addon: every header that a run writes,
as a firmware includes it.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from static_checks import DEVIATIONS, program

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.names import NumberFormat, ObserverMethodName
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files

FORMATS: tuple[NumberFormat, ...] = ("float32", "q15", "q31")


def everything(name: str, formats: tuple[NumberFormat, ...] = FORMATS) -> Design:
    """A library drive with its control in every format."""
    design = catalogue.load(name)
    return replace(design, export=replace(design.export, prefix="drive", control=formats))


def observed(method: ObserverMethodName) -> Design:
    """The bench with a position observer."""
    design = everything("paper001-pmsm-bench")
    observer = ObserverSettings(method=method)
    return replace(design, control=replace(design.control, observer=observer))


DESIGNS = {
    "phases": lambda: everything("paper002-phase-waveforms"),
    "salient phases": lambda: everything("salient-phase-waveforms", ("float32",)),
    "speed observer": lambda: everything("paper001-pmsm-bench"),
    "extended EMF": lambda: observed("extended-emf"),
    "Kalman filter": lambda: observed("ekf"),
    "Matsui": lambda: observed("matsui-current"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DESIGNS)
def test_every_header_of_a_run_deviates_as_listed_only(name: str, tmp_path: Path) -> None:
    files = emitted_files(solve(DESIGNS[name]()))
    headers = [file for file in files if file.endswith(".h") and not file.endswith("_vectors.h")]
    for file in headers:
        (tmp_path / file).write_bytes(files[file])
    assert len(headers) > 2
    rules: set[str] = set()
    for file in headers:
        main = f'#include "{file}"\nint main(void)\n{{\n    return 0;\n}}\n'
        (tmp_path / "main.c").write_text(main, encoding="ascii")
        command = [program("cppcheck"), "--std=c99", "--addon=misra", "--enable=style", "-q"]
        done = subprocess.run(
            [*command, "main.c"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        found = set(re.findall(r"\[misra-c2012-([0-9.]+)\]", done.stderr))
        assert found <= set(DEVIATIONS), f"{file}: {done.stderr}"
        rules |= found
    assert rules, "the addon said nothing at all: did it run?"
