"""Back-EMF of design files: harmonics as written, a capture beside the design,
and what is wrong with either.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.design import Design
from dqforge.machines.design.loader import load_design, load_text
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine

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
waveform: {torque: 1 N m, speed: 750 rpm, ripple: 2 %, neutral_current: 1 A, slew_rate: 9 kA/s, error: 0.1 %}
export: {prefix: waves}
"""
HARMONICS = (
    "{harmonics: [{order: 1, amplitude: {value: 0.1414213562 Wb, kind: rms}}, {order: 3, share: 10 "
    "%, phase: 30 deg}]}"
)


def loaded(back: str, text: str = TEXT) -> Design:
    return load_text(text.replace("BACK", back).encode(), "waves.yaml")


def phases(design: Design) -> PhaseMachine:
    assert isinstance(design.phase_machine, PhaseMachine)
    return design.phase_machine


def test_harmonics_are_the_waveform_as_written() -> None:
    """e_a / omega = -0.2 (sin theta + 0.1 sin(3 theta - 30 deg)); b lags by 120
    degrees of the fundamental.
    """
    machine = phases(loaded(HARMONICS))
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    for phase in range(3):
        own = theta - 2.0 * np.pi / 3.0 * phase
        wanted = -0.2 * (np.sin(own) + 0.1 * np.sin(3.0 * own - np.pi / 6.0))
        np.testing.assert_allclose(machine.flux[phase], wanted, atol=1e-10)
    assert (machine.l_s, machine.m_s, machine.r_s) == (7e-3, -1e-3, 1.0)
    assert machine.symmetry == "sixth"


def test_the_drive_in_dq_is_the_fundamental() -> None:
    design = loaded(HARMONICS)
    assert isinstance(design.machine, LinearMachine)
    assert design.machine.psi_pm == pytest.approx(0.2, rel=1e-9)
    assert design.machine.l_d == design.machine.l_q == pytest.approx(8e-3)
    assert any("those of the fundamental" in text for text in design.assumptions)
    settings = design.waveform
    assert (settings.torque, settings.neutral, settings.slew) == (1.0, 1.0, 9000.0)
    assert settings.ripple == pytest.approx(0.02)
    assert settings.error == pytest.approx(1e-3)


@pytest.mark.parametrize("symmetric", ["true", "false"])
def test_capture_beside_the_design_is_taken(tmp_path: Path, symmetric: str) -> None:
    time = np.arange(6000) / 60_000.0
    size = np.array([1.0, 1.0, 1.0 if symmetric == "true" else 0.97])
    rows = [time]
    for phase in range(3):
        theta = 2.0 * np.pi * 50.0 * time - 2.0 * np.pi / 3.0 * phase
        rows.append(-20.0 * size[phase] * (np.sin(theta) + 0.1 * np.sin(3.0 * theta)))
    np.savetxt(
        tmp_path / "scope.csv",
        np.column_stack(rows),
        delimiter=",",
        header="t_s,a_V,b_V,c_V",
        comments="",
    )
    path = tmp_path / "waves.yaml"
    path.write_text(
        TEXT.replace("BACK", f"{{file: scope.csv, symmetric: {symmetric}, highest_order: 7}}"),
        encoding="utf-8",
    )
    machine = phases(load_design(path))
    amplitude = 20.0 / (2.0 * np.pi * 50.0)
    assert machine.symmetry == ("sixth" if symmetric == "true" else "none")
    assert machine.psi_pm == pytest.approx(amplitude * np.mean(size), rel=1e-4)
    lines = np.abs(np.fft.rfft(machine.flux[2]))
    assert lines[3] / lines[1] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(
    ("back", "message"),
    [
        ("{}", "write either harmonics, file or files"),
        ("{harmonics: [{order: 3, share: 10 %}]}", "needs order 1 with its amplitude"),
        ("{harmonics: [{order: 1, share: 10 %}]}", "needs order 1 with its amplitude"),
        (
            "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {order: 1, share: 1 %}]}",
            "order 1 is listed twice",
        ),
        (
            "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {order: 5}]}",
            "write either amplitude or share",
        ),
        ("{file: scope.csv}", "cannot name files"),
        ("{harmonics: []}", "a list of at least 1"),
    ],
)
def test_faults_are_named_with_their_line(back: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        loaded(back)
    assert message in str(caught.value)
    assert caught.value.line == 9


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("self_inductance: 7 mH", "self_inductance: 1.5 mH", "store no energy in some current"),
        ("  self_inductance: 7 mH\n", "", "machine needs the key 'self_inductance'"),
        ("  model: waveform\n", "", "self_inductance belongs to the model 'waveform'"),
        (
            "  max_speed",
            "  temperature: {magnet: 80 degC}\n  max_speed",
            "write it for the temperature",
        ),
        ("open_phase", "open_phase", ""),
    ],
)
def test_machines_that_cannot_be_are_refused(old: str, new: str, message: str) -> None:
    if not message:
        assert (
            loaded(HARMONICS, TEXT.replace("ripple: 2 %", "open_phase: b")).waveform.open_phase
            == "b"
        )
        return
    with pytest.raises(InputError) as caught:
        loaded(
            HARMONICS,
            TEXT.replace(old, new).replace("mutual_inductance: -1 mH", "mutual_inductance: -1 mH"),
        )
    assert message in caught.value.message


def test_a_neutral_and_waveforms_need_such_a_machine() -> None:
    linear = TEXT.replace("  model: waveform\n", "").replace(
        "  self_inductance: 7 mH\n  mutual_inductance: -1 mH\n", ""
    )
    linear = linear.replace(
        "  back_emf: BACK\n", "  inductance_d: 8 mH\n  inductance_q: 8 mH\n  magnet_flux: 0.2 Wb\n"
    )
    with pytest.raises(
        InputError, match="phase currents are shaped for a machine of model: waveform"
    ):
        load_text(linear.encode(), "linear.yaml")
    without = "".join(
        line for line in linear.splitlines(keepends=True) if not line.startswith("waveform:")
    )
    with pytest.raises(InputError, match="four-leg serves machines of model: waveform"):
        load_text(without.encode(), "linear.yaml")


SALIENT = TEXT.replace(
    "  back_emf:",
    (
        "  inductance_harmonics: [{order: 2, amplitude: -2 mH}, {order: 4, amplitude: 0.3 mH, "
        "mutual: 0 mH}]\n  back_emf:"
    ),
)


def test_saliency_is_read_about_the_d_axis() -> None:
    """L_aa, L_bc and the dq inductances as the page on phase currents writes them."""
    design = loaded(HARMONICS, SALIENT)
    machine = design.phase_machine
    assert isinstance(machine, SalientPhaseMachine)
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    own = 7e-3 - 2e-3 * np.cos(2.0 * theta) + 0.3e-3 * np.cos(4.0 * theta)
    np.testing.assert_allclose(machine.inductance[:, 0, 0], own, atol=1e-12)
    np.testing.assert_allclose(
        machine.inductance[:, 1, 1], np.roll(own, machine.angles // 3), atol=1e-12
    )
    np.testing.assert_allclose(
        machine.inductance[:, 1, 2], -1e-3 - 2e-3 * np.cos(2.0 * theta), atol=1e-12
    )
    assert isinstance(design.machine, LinearMachine)
    np.testing.assert_allclose((design.machine.l_d, design.machine.l_q), (5e-3, 11e-3), rtol=1e-12)
    assert any("l_d 5 mH, l_q 11 mH" in remark for remark in design.assumptions)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("order: 4", "order: 2", "order 2 is listed twice; remove one"),
        ("order: 4", "order: 3", "inductance_harmonics"),
        ("-2 mH}", "-9 mH}", "store no energy in some current"),
        (
            "topology: four-leg",
            "topology: diode-neutral",
            "diode-neutral is not offered for a machine with",
        ),
        (
            "error: 0.1 %",
            "form: table",
            "a table over the angle needs currents in proportion to the torque",
        ),
        ("model: waveform", "model: linear", "belongs to the model 'waveform'"),
        (
            "BACK",
            "{harmonics: [{order: 1, amplitude: 0.2 Wb, phase: 20 deg}]}",
            "write order 1 with phase: 0 deg",
        ),
    ],
)
def test_saliency_that_makes_no_machine_is_refused_at_its_place(
    old: str, new: str, message: str
) -> None:
    assert old in SALIENT
    with pytest.raises(InputError) as caught:
        loaded(HARMONICS, SALIENT.replace(old, new))
    assert message in str(caught.value)
    assert caught.value.line is not None
    assert "\n" not in str(caught.value)


def test_a_salient_machine_is_not_simulated() -> None:
    simulation = "simulation: {duration: 10 ms}\n"
    with pytest.raises(InputError, match="a machine with inductance_harmonics is not simulated"):
        loaded(HARMONICS, SALIENT + simulation)


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
                r"waves.yaml:9:37: machine.back_emf.span: turns.csv does not cover a mechanical turn: "
                r"it shows 4.5 electrical periods of 5; capture a whole turn, or write span: electrical"
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
            "{harmonics: [{order: 1, amplitude: 0.2 Wb}, {order: 2, mechanical_order: 3, share: 1 %}]}",
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
