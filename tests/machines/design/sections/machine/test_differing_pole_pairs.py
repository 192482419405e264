"""Designs whose pole pairs differ: a capture over the mechanical turn, harmonics of the mechanical
angle, and what is wrong with either.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine

TEXT = """\
dqforge: 1
name: Waves
machine:
  model: waveform
  pole_pairs: 2
  resistance: {value: 2 Ohm, kind: line-to-line}
  self_inductance: 7 mH
  mutual_inductance: -1 mH
  back_emf: BACK
  max_current: 6 A
  max_speed: 1800 rpm
inverter: {v_dc: 220 V, switching_frequency: 10 kHz, topology: four-leg}
control: {current_loop: {method: bandwidth, bandwidth: 300 Hz}}
export: {prefix: waves}
"""


def loaded(back: str, text: str = TEXT) -> Design:
    return load_text(text.replace("BACK", back).encode(), "waves.yaml")


def phases(design: Design) -> PhaseMachine:
    assert isinstance(design.phase_machine, PhaseMachine)
    return design.phase_machine


PAIRS = TEXT.replace("pole_pairs: 2", "pole_pairs: 5")


def turning_file(folder: Path, periods: float) -> Path:
    """A capture of five pole pairs, of which one is 8 % stronger, from their beginning."""
    time = np.arange(int(100 * periods)) / 5000.0
    theta = 2.0 * np.pi * 50.0 * time + 0.01
    lag = 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    # Phases of one fifth of the turn: equal to the phase before by two thirds of the turn.
    around = np.mod(theta / 5.0 - 2.0 * lag, 2.0 * np.pi)
    stronger = 1.0 + 0.08 * np.exp(-(((around - 2.0) / 0.5) ** 2))
    volts = 2.0 * np.pi * 50.0 * 0.2 * -np.sin(theta - 10.0 * lag) * stronger
    rows = np.column_stack([time, volts.T])
    path = folder / "turns.csv"
    np.savetxt(path, rows, delimiter=",", header="t s,a V,b V,c V", comments="", fmt="%.9g")
    return path


def beside(folder: Path, back: str, text: str = PAIRS) -> Design:
    file = folder / "waves.yaml"
    file.write_text(text.replace("BACK", back))
    return load_design(file)


def test_a_capture_keeps_its_pole_pairs_over_the_mechanical_span(tmp_path: Path) -> None:
    turning_file(tmp_path, 20.0)
    whole = phases(beside(tmp_path, "{file: turns.csv, span: mechanical}"))
    assert (whole.turns, whole.angles) == (5, 1800)
    stronger = 1.0 + 0.08 * np.exp(-(((whole.theta / 5.0 - 2.0) / 0.5) ** 2))
    np.testing.assert_allclose(whole.flux[0], -0.2 * np.sin(whole.theta) * stronger, atol=4e-4)
    assert whole.symmetry == "none"
    equal = phases(beside(tmp_path, "{file: turns.csv, span: mechanical, symmetric: true}"))
    assert equal.symmetry == "third"
    np.testing.assert_allclose(equal.flux, whole.flux, atol=1e-3)


def test_a_capture_that_is_averaged_says_what_its_pole_pairs_differ_by(tmp_path: Path) -> None:
    turning_file(tmp_path, 20.0)
    design = beside(tmp_path, "{file: turns.csv}")
    assert phases(design).turns == 1
    (remark,) = [text for text in design.assumptions if "The pole pairs differ" in text]
    assert remark.startswith("turns.csv: The pole pairs differ: within a mechanical turn")
    assert remark.endswith("back_emf.span: mechanical in a design keeps it.")


@pytest.mark.parametrize(
    ("periods", "back", "text", "message"),
    [
        (
            4.5,
            "{file: turns.csv, span: mechanical}",
            PAIRS,
            (
                r"waves.yaml:9:37: machine.back_emf.span: turns.csv does not cover a mechanical "
                r"turn: it shows 4.5 electrical periods of 5; capture a whole turn, or write "
                r"span: electrical"
            ),
        ),
        (
            20.0,
            "{file: turns.csv, span: mechanical}",
            PAIRS.replace("pole_pairs: 5", "pole_pairs: 1"),
            "with one pole pair the mechanical turn is the electrical period; leave span out",
        ),
        (
            20.0,
            "{file: turns.csv, span: mechanical, symmetric: true}",
            PAIRS.replace("pole_pairs: 5", "pole_pairs: 6"),
            "phases of 6 different pole pairs lie no third of a mechanical turn apart",
        ),
        (
            20.0,
            "{span: mechanical, harmonics: [{order: 1, amplitude: 0.2 Wb}]}",
            PAIRS,
            "machine.back_emf.span is that of a capture; harmonics of pole pairs that differ are",
        ),
        (
            20.0,
            "{harmonics: [{order: 1, amplitude: 1 Wb}, {order: 2, mechanical_order: 3}]}",
            PAIRS,
            "write either order or mechanical_order of each harmonic",
        ),
        (
            20.0,
            "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {mechanical_order: 5, share: 1 %}]}",
            PAIRS,
            "order 1 is listed twice",
        ),
        (
            20.0,
            "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {mechanical_order: 1001, share: 1 %}]}",
            PAIRS,
            "mechanical_order 1001 is order 200.2 of the electrical angle; write at most 1000",
        ),
    ],
)
def test_spans_that_cannot_be_are_refused(
    tmp_path: Path, periods: float, back: str, text: str, message: str
) -> None:
    turning_file(tmp_path, periods)
    with pytest.raises(InputError, match=message):
        beside(tmp_path, back, text)


def test_harmonics_of_the_mechanical_angle_span_the_turn() -> None:
    """Order 6 of the mechanical angle of five pole pairs is 1.2 of the electrical one."""
    harmonics = (
        "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {mechanical_order: 6, share: 10 %, phase: 30 "
        "deg}]}"
    )
    found = phases(loaded(harmonics, PAIRS))
    assert found.turns == 5
    wanted = -0.2 * (np.sin(found.theta) + 0.1 * np.sin(1.2 * found.theta - np.pi / 6.0))
    np.testing.assert_allclose(found.flux[0], wanted, atol=1e-12)


def test_a_period_computed_by_others_covers_no_mechanical_turn(
    tmp_path: Path, shared_data: Path
) -> None:
    """Eight poles over 90 mechanical degrees, by finite elements (femagtools)."""
    name = "femag_test002_noload_3ph_p4_50rps.csv"
    (tmp_path / name).write_bytes((shared_data / "bemf" / name).read_bytes())
    text = TEXT.replace("pole_pairs: 2", "pole_pairs: 4")
    with pytest.raises(InputError, match="it shows 1 electrical periods of 4; capture a whole"):
        beside(tmp_path, f"{{file: {name}, span: mechanical}}", text)
