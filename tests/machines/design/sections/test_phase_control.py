"""Keys of the control of machines with any back-EMF: refusals with a place, and remarks."""

from __future__ import annotations

import re

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError

P = "paper002-phase-waveforms"
SALIENT = "salient-phase-waveforms"
BENCH = "paper001-pmsm-bench"
FIFTH = (
    "machine.back_emf.harmonics=[{order: 1, amplitude: 0.2 Wb}, {order: 5, amplitude: 0.2 Wb},"
    " {order: 3, amplitude: 0.05 Wb, phase: 90 deg}]"
)
STIFF = "inverter.midpoint_capacitance=4 mF"


def design(drive: str, *settings: str) -> Design:
    return load_text(catalogue.read_text(drive), f"{drive}.yaml", None, list(settings))


def written(line: str) -> bytes:
    """The design of P with a line in its current loop."""
    text = catalogue.read_text(P)
    loop = b"    method: bandwidth\n"
    assert loop in text
    return text.replace(loop, loop + f"    {line}\n".encode())


@pytest.mark.parametrize(
    ("drive", "settings", "message"),
    [
        (P, ["inverter.topology=diode-neutral", "frame=dqy"], r"holds the neutral.*dqx or table"),
        (P, ["inverter.topology=three-wire", "frame=dqy"], r"star point.*write dqx or table"),
        (P, ["inverter.topology=six-leg-isolated", "frame=dqy"], r"to the other.*write dqx"),
        (P, [FIFTH, "frame=dqx"], r"alpha-beta vector falls to .* write table"),
        (P, [FIFTH, "frame=dqy"], r"alpha-beta vector falls to .* write table"),
        (P, [FIFTH, "inverter.topology=three-wire", "frame=table"], r"write dq, and accept"),
        (SALIENT, ["frame=dqx"], r"inductance_harmonics; write table or dq"),
        (SALIENT, ["frame=dqy"], r"inductance_harmonics; write table or dq"),
        (SALIENT, ["frame=table", "limited_waveforms=true"], r"do not vary.*; remove it"),
        (P, ["frame=dqx", "limited_waveforms=true"], r"the frame is dqx; write frame: table"),
        (P, ["feedforward=measured", "export.control=q15"], r"fixed point; write references"),
        (BENCH, ["inverter.neutral_inductance=1 mH"], r"model: waveform; remove it"),
        (BENCH, ["inverter.midpoint_capacitance=1 mF"], r"model: waveform; remove it"),
        (P, ["inverter.topology=six-leg", "inverter.neutral_resistance=1 mOhm"], r"no conductor"),
        (P, ["inverter.topology=4-leg"], r"did you mean 'four-leg'"),
        (P, ["inverter.topology=3 wire"], r"did you mean 'three-wire'"),
        (BENCH, ["frame=dq"], "serves machines of model: waveform; remove it"),
        (BENCH, ["feedforward=emf"], "serves machines of model: waveform; remove it"),
        (BENCH, ["axis_gains=one"], "serves machines of model: waveform; remove it"),
        (BENCH, ["harmonic_integrators=false"], "serves machines of model: waveform; remove it"),
        (BENCH, ["limited_waveforms=true"], "serves machines of model: waveform; remove it"),
    ],
)  # fmt: skip
def test_what_cannot_be_had_is_refused(drive: str, settings: list[str], message: str) -> None:
    where = [text if "." in text else f"control.current_loop.{text}" for text in settings]
    with pytest.raises(InputError, match=message):
        design(drive, *where)
    # Without its last key the design is sound.
    design(drive, *where[:-1])


@pytest.mark.parametrize("line", ["frame: dqy", "limited_waveforms: true"])
def test_refusals_name_their_place(line: str) -> None:
    text = written(line).replace(b"topology: four-leg", b"topology: diode-neutral")
    if line.startswith("limited"):
        text = text.replace(b"limited_waveforms: true", b"frame: dqx\n    limited_waveforms: true")
    key = line.partition(":")[0]
    place = next(k for k, row in enumerate(text.decode().split("\n"), 1) if key in row)
    with pytest.raises(InputError) as caught:
        load_text(text, "drive.yaml")
    assert caught.value.line == place
    assert f"control.current_loop.{key}" in caught.value.message


def remarks(*settings: str, drive: str = P) -> str:
    return "\n".join(design(drive, *settings).assumptions)


def test_the_frame_and_its_reason_are_said() -> None:
    said = remarks()
    assert "control.current_loop.frame is table: the back-EMF is up to 12 % of its peak off" in said
    assert "the zero-sequence current follows the reference of the torque" in said
    # Without a neutral the third harmonic does not count: orders 5 and 7 together are 4 %.
    said = remarks("inverter.topology=three-wire")
    assert "frame is table: the back-EMF is up to 4 % of its peak off a sine" in said
    assert "zero-sequence" not in said
    assert "frame is table: the back-EMF is up to 12 %" in remarks(drive=SALIENT)
    # L_q - L_d of 12 mH instead of 5.4 mH.
    strong = "machine.inductance_harmonics=[{order: 2, amplitude: -4 mH}]"
    wide = "machine.self_inductance=14 mH"
    assert "frame is table: the back-EMF" in remarks(strong, wide, drive=SALIENT)
    assert "frame is dq: the back-EMF's alpha-beta vector falls to" in remarks(
        FIFTH, "inverter.topology=three-wire"
    )
    assert "current_loop.frame" not in remarks(drive=BENCH)
    assert "current_loop.frame" not in remarks("control.gains=false")


def test_the_pulses_of_a_split_link_are_weighed_in_watts() -> None:
    said = remarks("inverter.topology=split-capacitor", STIFF)
    found = re.search(
        r"drive (\S+) A \(r.m.s.\) .*, (\S+) W of copper; .* saves (\S+) W .* below (\S+) N m", said
    )
    assert found is not None
    ripple, cost, saved, even = (float(text) for text in found.groups())
    # sqrt(3)/8 V_dc T_s / L_0 of three legs at one half; R = 1 Ohm, a third of it in each phase.
    assert ripple == pytest.approx(np.sqrt(3.0) / 8.0 * 220.0 * 1e-4 / 5e-3, rel=2e-3)
    assert cost == pytest.approx(ripple**2 / 3.0, rel=2e-3)
    # dqx 3.342, dqy 3.297 W/(N m)^2.
    assert saved == pytest.approx(3.342 - 3.297, abs=1e-3)
    assert even == pytest.approx(np.sqrt(cost / saved), rel=5e-3)
    assert "through the neutral" not in remarks()
    assert "the midpoint of the link is taken as held" in remarks(
        "inverter.topology=split-capacitor"
    )


@pytest.mark.parametrize(
    ("topology", "share"),
    [("three-wire", 2 / 3), ("four-leg", 1.0), ("six-leg", 1.0), ("six-leg-isolated", 4 / 3)],
)
def test_the_base_voltage_left_open_holds_what_a_phase_reaches(topology: str, share: float) -> None:
    found = design(P, f"inverter.topology={topology}")
    assert found.control.bases.voltage == pytest.approx(share * found.inverter.v_dc)
    assert design(BENCH).control.bases.voltage == design(BENCH).inverter.v_dc / np.sqrt(3.0)


@pytest.mark.parametrize("number", ["q15", "[float32, q31]"])
def test_salient_machines_are_controlled_in_float32_alone(number: str) -> None:
    with pytest.raises(InputError, match=r"in float32 alone; write float32"):
        design(SALIENT, f"export.control={number}")
    assert design(SALIENT, "export.control=float32").phase_machine is not None
