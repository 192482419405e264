"""`dqforge verify` finds folders that were forged with care."""

from __future__ import annotations

import random
from pathlib import Path

import drawn_cases
import pytest
from forged_folders import (
    KINDS,
    LANGUAGES,
    at_hand,
    found,
    lines_drawn,
    refused,
    samples_changed,
    solved,
)

from dqforge.reports.output.folder import COMMAND, RUN, SIMULATION, VERIFIED, put_output
from dqforge.reports.output.recomputation import recompute


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


def test_a_handful_of_forged_folders_is_found(place: Path, tmp_path: Path) -> None:
    """Drawn by the commit; those whose design is changed are solved again, and left to others."""
    made = solved("samples", place)
    made.forge(tmp_path / "out", {})
    with at_hand():
        whole = recompute(tmp_path / "out")
    assert (whole.listed, whole.foreign, whole.digits) == ((), (), ())
    assert whole.tally.files == len(made.output.files)
    lines = lines_drawn("samples", made, 40, drawn_cases.seed())
    quick = [line for line in lines if "dqforge-input" not in line and "options" not in line]
    assert [line for line in quick if not found(line, place)] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_forged_folder_is_found(kind: str, place: Path) -> None:
    """Everything that is done to any file, once; `make forged` draws a thousand."""
    lines = lines_drawn(kind, solved(kind, place), 70, "all")
    assert [line for line in lines if not found(line, place)] == []


def test_samples_beside_a_run_are_computed_again(place: Path, tmp_path: Path) -> None:
    """Under the name of the run's: they are the same bytes, and each part stays whole."""
    made, out = solved("samples", place), tmp_path / "out"
    design = made.output.solution.design
    samples = {name: made.files[name] for name in made.files if name.endswith(".npz")}
    options = {COMMAND: "run", VERIFIED: ",".join(LANGUAGES)}
    put_output(out, SIMULATION, samples, design)
    put_output(out, RUN, made.output.files, design, options=options)
    put_output(out, SIMULATION, samples, design)
    with at_hand():
        recompute(out)
    (name,) = samples
    (out / name).write_bytes(samples_changed(samples[name], random.Random(0)))
    with at_hand():
        assert name in refused(out)
