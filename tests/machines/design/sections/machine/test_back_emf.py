"""Back-EMF of design files: harmonics as written, a capture beside the design,
and what is wrong with either.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.plants.scenario import PhaseOpening

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


SPINNING = "simulation: {duration: 10 ms, shaft: {points: [{time: 0 s, speed: 100 rpm}]}, BODY}\n"
CURRENT = "current: {points: [{time: 0 s, i_d: 0 A, i_q: 1 A}]}"


def test_a_salient_machine_is_simulated() -> None:
    design = loaded(HARMONICS, SALIENT + SPINNING.replace("BODY", CURRENT))
    assert isinstance(design.phase_machine, SalientPhaseMachine)
    assert design.simulation is not None
    assert design.simulation.mode == "current"


def test_an_opening_phase_is_read_and_refused_where_nothing_answers() -> None:
    opens = CURRENT + ", open_phase: {phase: b, time: 5 ms, detected_after: 1 ms}"
    wired = TEXT + SPINNING.replace("BODY", opens)
    text = wired.replace("topology: four-leg", "topology: three-wire")
    assert text != wired
    with pytest.raises(InputError, match="detected_after: two phases of three-wire") as caught:
        loaded(HARMONICS, text)
    assert caught.value.line is not None
    scenario = loaded(HARMONICS, wired).simulation
    assert scenario is not None
    assert scenario.open_phase == PhaseOpening("b", 5e-3, 1e-3)
    assert loaded(HARMONICS, text.replace(", detected_after: 1 ms", "")).simulation is not None
