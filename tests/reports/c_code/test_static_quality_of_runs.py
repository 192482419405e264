"""Whole folders of headers under cppcheck with its MISRA addon: every header that a run writes,
as a firmware includes it.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from application_replay import design as application_design
from static_checks import DEVIATIONS, program

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, SpeedMeasurementSettings
from dqforge.machines.names import NumberFormat, ObserverMethodName, SpeedMeasurementName
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files

FORMATS: tuple[NumberFormat, ...] = ("float32", "q15", "q31")


def everything(name: str, formats: tuple[NumberFormat, ...] = FORMATS) -> Design:
    """A library drive with its control in every format."""
    design = catalogue.load(name)
    return replace(design, export=replace(design.export, prefix="drive", control=formats))


def observed(method: ObserverMethodName, formats: tuple[NumberFormat, ...] = FORMATS) -> Design:
    """The bench with a position observer."""
    design = everything("paper001-pmsm-bench", formats)
    observer = ObserverSettings(method=method)
    return replace(design, control=replace(design.control, observer=observer))


def measured(method: SpeedMeasurementName) -> Design:
    """The bench with its speed from the edges of its encoder."""
    design = everything("paper001-pmsm-bench")
    loop = design.control.speed_loop
    assert loop is not None
    clock, edges = (0.0, 4) if method == "counts" else (1e7, 1)
    own = SpeedMeasurementSettings(method, 1024, clock, 16, edges, 30.0)
    control = replace(design.control, speed_loop=replace(loop, measurement=own), observer=None)
    return replace(design, control=control)


def injected(observer: str) -> Design:
    """A saturated machine with a tracker of its saliency."""
    return catalogue.load(
        "baldor-pmsyrm-5k6", [observer, "export.control=float32", "export.prefix=drive"]
    )


def third_harmonic_start() -> Design:
    """The shipped machine of any back-EMF that starts without an encoder."""
    examples = Path(__file__).resolve().parents[3] / "examples"
    return load_design(examples / "third-harmonic-start.yaml", ["export.prefix=drive"])


def programme(kind: str) -> Design:
    """The bench with the program around its functions."""
    made = application_design(kind)
    return replace(made, export=replace(made.export, prefix="drive"))


DESIGNS: dict[str, Callable[[], Design]] = {
    "phases": lambda: everything("paper002-phase-waveforms"),
    "salient phases": lambda: everything("salient-phase-waveforms", ("float32",)),
    "speed observer": lambda: everything("paper001-pmsm-bench"),
    "extended EMF": lambda: observed("extended-emf"),
    "Kalman filter": lambda: observed("ekf"),
    "learned rules": lambda: observed("neuro-fuzzy", ("float32",)),
    "learned network": lambda: observed("neural", ("float32",)),
    "counted speed": lambda: measured("counts"),
    "captured speed": lambda: measured("capture"),
    "mixed speed": lambda: measured("mixed"),
    "program, start-up": lambda: programme("start-up"),
    "program, edges": lambda: programme("edges"),
    "program, counts": lambda: programme("counts"),
    "Matsui": lambda: observed("matsui-current"),
    "injection": lambda: injected("control.observer={method: injection}"),
    "rotating injection": lambda: injected("control.observer={method: injection, wave: rotating}"),
    "start on the third harmonic": third_harmonic_start,
    "pulses": lambda: injected("control.observer={method: inductance-mapping}"),
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
