"""The page on library drives that start from standstill: its settings are those of drives that
do, and the example has the same.
"""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dqforge

DOCS = Path(__file__).resolve().parent.parent / "docs"


@pytest.fixture(scope="module")
def settings() -> dict[str, dict[str, Any]]:
    names = runpy.run_path(str(DOCS / "drawing" / "figures_from_standstill.py"))
    found: dict[str, dict[str, Any]] = names["settings_of_the_page"]()
    return found


def test_the_page_has_the_settings_of_three_starts_and_a_third_harmonic(
    settings: dict[str, dict[str, Any]],
) -> None:
    designs = {name: dqforge.load_design(name, changes) for name, changes in settings.items()}
    starts = {
        name: design.control.start_up.method
        for name, design in designs.items()
        if design.control.start_up is not None
    }
    assert starts == {
        "abb-ipmsm-2k2": "saliency",
        "baldor-pmsyrm-5k6": "saliency",
        "paper001-pmsm-bench": "i-f",
        "paper002-phase-waveforms": "i-f",
    }
    observer = designs["paper002-phase-waveforms"].control.observer
    assert observer is not None
    assert observer.method == "third-harmonic"
    for name in starts:
        scenario = designs[name].simulation
        assert scenario is not None
        assert scenario.encoder.absent


@pytest.mark.slow
def test_the_drives_of_the_page_start(settings: dict[str, dict[str, Any]]) -> None:
    """Right way round, on the observer, without a fault on the way."""
    for name, changes in settings.items():
        design = dqforge.load_design(name, changes)
        drive = dqforge.simulate(design)
        run = drive.found.run
        target = float(drive.reference[-1])
        assert float(drive.omega_m[-1]) == pytest.approx(target, rel=0.02), name
        gap = run.theta_e_observed - run.theta_e
        error = np.angle(np.exp(1j * gap[run.t > run.t[-1] - 0.1]))
        assert np.degrees(np.max(np.abs(error))) < 15.0, name
        start = drive.to_dict()["start"]
        assert start["state"] == "RUN", name
        assert start["failed"] == [], name
