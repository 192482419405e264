"""Machines as data sheets print them: every spelling of a constant against factors of its own.

With p pole pairs and psi the flux linkage of the magnets (peak of phase) the voltage of a phase
peaks at p psi per rad/s, that between two terminals at sqrt(3) times as much, and the torque is
3/2 p psi per ampere. All factors below follow from that and from the definitions of the units.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design, flux_from_back_emf
from dqforge.machines.design.from_machine import make_design
from dqforge.machines.design.sections.machine_schema import MachineSection
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.entries.kinds import BackEmfConstant
from dqforge.machines.entries.rules import QuantityRule
from dqforge.machines.errors import InputError

PAIRS, PSI, R, L = 7, 0.004145328, 0.05, 30e-6
RPM = 2.0 * math.pi / 60.0
SQRT2, SQRT3 = math.sqrt(2.0), math.sqrt(3.0)

SHEET = """\
dqforge: 1
name: Hobby motor
machine:
  poles: 14
  resistance: 100 mOhm phase-to-phase
  inductance: 60 uH terminal-to-terminal
  kv: 190 rpm/V
  max_current: 20 Arms
  max_speed: 4000 rpm
inverter:
  v_dc: 24 V
  switching_frequency: 20 kHz
"""


def changed(
    *pairs: tuple[str, str], settings: tuple[str, ...] = (), folder: Path | None = None
) -> Design:
    """The sheet with some texts replaced."""
    text = SHEET
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return load_text(text.encode(), "f.yaml", folder, settings)


def linear(design: Design) -> LinearMachine:
    assert isinstance(design.machine, LinearMachine)
    return design.machine


def refusal(*pairs: tuple[str, str]) -> InputError:
    with pytest.raises(InputError) as caught:
        changed(*pairs)
    assert "\n" not in caught.value.message
    return caught.value


def test_a_hobby_motor() -> None:
    design = changed()
    machine = linear(design)
    # psi = 60 / (2 pi sqrt(3) p Kv), as the firmware of such motors has it.
    assert machine.psi_pm == pytest.approx(60.0 / (2.0 * math.pi * SQRT3 * 7 * 190), rel=1e-13)
    assert machine.r_s == pytest.approx(0.05, rel=1e-13)
    assert machine.l_d == machine.l_q == pytest.approx(30e-6, rel=1e-13)
    assert machine.i_max == pytest.approx(20.0 * SQRT2, rel=1e-13)
    # Torque constant times Kv is 90/(2 pi sqrt(3)), about 8.27 N m/A rpm/V.
    assert 1.5 * 7 * machine.psi_pm * 190 == pytest.approx(8.26993, rel=1e-6)
    told = "\n".join(design.assumptions)
    assert "as that of hobby motors; write kind: line-to-line rms" in told
    assert "derived from kv 190 rpm/V (line-to-line peak) with 7 pole pairs" in told
    assert "2 L_d to 2 L_q as it is turned" in told
    assert "resistance is taken" not in told  # its text says of which kind it is
    given = {value.path: value.text for value in design.values}
    assert given["machine.resistance"] == "100 mOhm (line-to-line)"
    assert given["machine.max_current"] == "20 A (rms)"


_PLACES = {
    "line-to-line": ("line-to-line", "line to line", "l-l", "LL", "phase-to-phase", "terminal"),
    "phase": ("phase", "per phase", "phase-to-neutral", "L-N"),
}
_MEASURES = {"rms": ("rms", "RMS", "r.m.s.", "eff"), "peak": ("peak", "pk", "PEAK")}
_TO_PEAK_OF_PHASE = {"rms": SQRT2, "peak": 1.0, "line-to-line": 1.0 / SQRT3, "phase": 1.0}


def kinds_in_words() -> Iterator[tuple[str, float]]:
    """Every spelling of every kind of a voltage, and its factor to the peak of a phase."""
    for place, measure in itertools.product(_PLACES, _MEASURES):
        factor = _TO_PEAK_OF_PHASE[place] * _TO_PEAK_OF_PHASE[measure]
        for one, other in itertools.product(_PLACES[place], _MEASURES[measure]):
            yield f"{one} {other}", factor
            yield f"{other}, {one}", factor


# One of each in V s/rad.
KE_UNITS = {
    "V/krpm": 1e-3 / RPM,
    "V/kRPM": 1e-3 / RPM,
    "V/1000rpm": 1e-3 / RPM,
    "V/1000 rpm": 1e-3 / RPM,
    "V/1000 min^-1": 1e-3 / RPM,
    "V/1000 min-1": 1e-3 / RPM,
    "V per 1000 rpm": 1e-3 / RPM,
    "mV/rpm": 1e-3 / RPM,
    "mV/min^-1": 1e-3 / RPM,
    "V s/rad": 1.0,
    "Vs/rad": 1.0,
    "V/(rad/s)": 1.0,
}


@pytest.mark.parametrize("unit", KE_UNITS)
def test_back_emf_constants(unit: str) -> None:
    section = MachineSection.model_fields["back_emf_constant"]
    rule = next(part for part in get_args(BackEmfConstant) if isinstance(part, QuantityRule))
    assert section.annotation == BackEmfConstant | None
    tried = 0
    for words, factor in kinds_in_words():
        number = PSI * PAIRS / factor / KE_UNITS[unit]
        for text in (f"{number!r} {unit} {words}", f"{number!r} {unit} ({words})"):
            found = rule.read(text)
            psi = flux_from_back_emf(found.si, found.kind or "", PAIRS)
            assert psi == pytest.approx(PSI, rel=1e-12), text
            if tried % 40 == 0:
                design = changed(("kv: 190 rpm/V", f'back_emf_constant: "{text}"'))
                assert linear(design).psi_pm == psi
            tried += 1
    assert tried == 2 * 140


@pytest.mark.parametrize(
    ("entry", "measure"),
    [
        ("190", 1.0),
        ("190 rpm/V", 1.0),
        ("190KV", 1.0),
        ("190 kv", 1.0),
        ("190 Kv", 1.0),
        ("190 kV", 1.0),
        ("190 min^-1/V", 1.0),
        ('"190 (1/min)/V"', 1.0),
        ("0.19 krpm/V", 1.0),
        (f"{190 * RPM!r} rad/s/V", 1.0),
        (f"{190 * RPM!r} rad/(s V)", 1.0),
        (f"{190 * RPM!r} (rad/s)/V", 1.0),
        ("190 rpm/V line-to-line peak", 1.0),
        ("190 rpm/Vpk phase-to-phase", 1.0),
        ("190 rpm/Vrms terminal", SQRT2),
        ("190KV, L-L rms", SQRT2),
        ("{value: 190, kind: phase rms}", SQRT2 * SQRT3),
        ("{value: 190 rpm/Vpk, kind: per phase}", SQRT3),
    ],
)
def test_speed_constants(entry: str, measure: float) -> None:
    wanted = measure / (190.0 * RPM) / SQRT3 / PAIRS
    assert linear(changed(("190 rpm/V", entry))).psi_pm == pytest.approx(wanted, rel=1e-12)


def test_a_speed_constant_of_a_delta() -> None:
    # Between two terminals it is what it is, whatever lies behind them.
    star, delta = (
        linear(
            changed(
                ("poles: 14", f"poles: 14\n  connection: {connection}"),
                ("20 Arms", "20 A rms line"),
            )
        )
        for connection in ("star", "delta")
    )
    assert star == delta


def test_one_inductance_lies_between_those_of_the_axes() -> None:
    both = "inductance: 60 uH l-l\n  inductance_d: 20 uH\n  inductance_q: {} uH"
    old = "inductance: 60 uH terminal-to-terminal"
    for q in (30, 50, 28.6):
        machine = linear(changed((old, both.format(q))))
        assert (machine.l_d, machine.l_q) == pytest.approx((20e-6, q * 1e-6))
    message = refusal((old, both.format(28))).message
    assert message == (
        "machine.inductance 30 uH (phase) contradicts inductance_d 20 uH and inductance_q 28 uH, "
        "between which it must lie; check the kinds (phase or line-to-line), or remove it"
    )
    for key in ("inductance_d", "inductance_q"):
        error = refusal((old, f"{old}\n  {key}: 20 uH"))
        assert f"is that of both axes, and {key} that of one" in error.message
        assert (error.line, error.column) == (6, 3)
    error = refusal((old, "inductance_d: 20 uH"))
    assert "needs the key 'inductance_q'" in error.message
    assert "or inductance: 1.6 mH for both axes" in error.message
    assert (
        "belongs to the model 'linear'"
        in refusal(("poles: 14", "model: waveform\n  poles: 14")).message
    )


@pytest.mark.parametrize(
    ("entry", "phrase"),
    [
        ("back_emf_constant: 5.263 V/krpm line-to-line rms", "an r.m.s. value given as peak"),
        ("torque_constant: 0.0435 Nm/Arms", "an r.m.s. value given as peak"),
        ("magnet_flux: 7.18 mWb", "a line-to-line value given as phase"),
        ("torque_constant: 0.029 Nm/Apk", "a torque constant without the 3/2"),
    ],
)
def test_what_contradicts_the_speed_constant(entry: str, phrase: str) -> None:
    error = refusal(("kv: 190 rpm/V", f"{entry}\n  kv: 190 rpm/V"))
    assert "kv 190 rpm/V (line-to-line peak) implies psi_pm = 4.145 mWb" in error.message
    assert phrase in error.message


@pytest.mark.parametrize(
    "entry", ["back_emf_constant: 3.72 V/krpm LL rms", "torque_constant: 0.0616 Nm/Arms"]
)
def test_what_agrees_with_the_speed_constant(entry: str) -> None:
    machine = linear(changed(("kv: 190 rpm/V", f"{entry}\n  kv: 190 rpm/V")))
    assert machine.psi_pm == pytest.approx(PSI, rel=1e-2)


def test_the_command_line_and_python_read_the_same() -> None:
    wanted = linear(changed())
    settings = (
        "machine.resistance=0.1 Ohm terminal",
        "machine.max_current={value: 20 A, kind: eff}",
        "machine.kv=190KV",
    )
    assert linear(changed(settings=settings)) == wanted
    made = make_design(
        LinearMachine(pole_pairs=7, r_s=1.0, l_d=L, l_q=L, psi_pm=PSI, i_max=1.0),
        v_dc=24.0,
        f_sw=20e3,
        machine={"resistance": "100 mOhm phase-to-phase", "max_current": "20 Arms"},
    )
    assert linear(made).r_s == pytest.approx(wanted.r_s)
    assert linear(made).i_max == pytest.approx(wanted.i_max)


def test_a_value_from_outside_replaces_the_kind_of_the_text() -> None:
    for setting, resistance in (
        ("90 mOhm", 90e-3),
        ("90 mOhm phase-to-phase", 45e-3),
        ("0.09", 90e-3),
        ("{value: 90 mOhm}", 90e-3),
    ):
        design = changed(settings=(f"machine.resistance={setting}",))
        assert linear(design).r_s == pytest.approx(resistance), setting
    emf = "{value: 12 Vrms/krpm, kind: line-to-line}"
    of_line = changed(
        ("kv: 190 rpm/V", f"back_emf_constant: {emf}"),
        settings=("machine.back_emf_constant=13 Vrms/krpm line-to-line",),
    )
    assert linear(of_line).psi_pm == pytest.approx(13e-3 / RPM * SQRT2 / SQRT3 / PAIRS, rel=1e-12)
    renamed = changed(("Hobby motor", "3 phase"), settings=("name=Other",))
    assert renamed.name == "Other"


# One of each in N m/A.
KT_UNITS = {
    "N m/A": 1.0,
    "Nm/A": 1.0,
    "mNm/A": 1e-3,
    "N-m/Amp": 1.0,
    "oz-in/A": 7.061551814226044e-3,
    "oz in/A": 7.061551814226044e-3,
    "ozf-in/amp": 7.061551814226044e-3,
    "lb-in/A": 0.1129848290276167,
    "kg-cm/A": 0.0980665,
}


@pytest.mark.parametrize("unit", KT_UNITS)
def test_torque_constants_and_currents(unit: str) -> None:
    # Per ampere r.m.s. sqrt(2) times as much as per ampere of the peak.
    for measure, factor in (("rms", SQRT2), ("peak", 1.0)):
        for word in _MEASURES[measure]:
            number = 1.5 * PAIRS * PSI * factor / KT_UNITS[unit]
            glued = [f"{number!r} {unit}{word}"] if unit.endswith("A") else []
            for text in (f"{number!r} {unit} {word}", f"{number!r} {unit} (phase {word})", *glued):
                design = changed(
                    ("kv: 190 rpm/V", f'torque_constant: "{text}"'),
                    ("20 Arms", f'"{20.0 / factor!r} A {word}"'),
                )
                assert linear(design).psi_pm == pytest.approx(PSI, rel=1e-12), text
                assert linear(design).i_max == pytest.approx(20.0 / factor * factor**2 / factor)


def test_servo_motors_as_their_sheets_print_them() -> None:
    # K_t in N m/A r.m.s. and K_e in V r.m.s. line-to-line per krpm say the same flux linkage
    # where K_t/K_e = 60 sqrt(3)/(2 pi 1000) = 16.54e-3, as every such sheet has it.
    for k_t, k_e, pairs in ((0.58, 35.07, 4), (1.51, 91.3, 5), (2.79, 168.7, 3)):
        both = f"torque_constant: {k_t} Nm/Arms\n  back_emf_constant: {k_e} Vrms/krpm "
        design = changed(
            ("poles: 14", f"pole_pairs: {pairs}"), ("kv: 190 rpm/V", both + "phase-to-phase")
        )
        assert linear(design).psi_pm == pytest.approx(k_t / SQRT2 / 1.5 / pairs, rel=2e-3)
        # Taken as phase values the same two contradict each other by sqrt(3).
        error = refusal(("kv: 190 rpm/V", both + "phase-to-neutral"))
        assert "a line-to-line value given as phase, or the reverse? check the kinds" in (
            error.message
        )


@pytest.mark.parametrize(
    ("word", "connection"),
    [("Y", "star"), ("wye", "star"), ("Star", "star"), ("Δ", "delta"), ("D", "delta")],
)
def test_connections_in_other_words(word: str, connection: str) -> None:
    text = SHEET.replace("20 Arms", "20 Arms line").replace(
        "poles", f"connection: '{word}'\n  poles"
    )
    told = load_text(text.encode(), "f.yaml").assumptions
    assert any("connection is delta" in sentence for sentence in told) == (connection == "delta")
    error = refusal(("poles: 14", "connection: zigzag\n  poles: 14"))
    assert "machine.connection: expected one of star, delta" in error.message


def test_channels_of_a_capture_in_other_words(tmp_path: Path) -> None:
    angle = 2.0 * math.pi * np.arange(360) / 360.0
    rows = "\n".join(
        ",".join(f"{value:.12g}" for value in (x, *np.cos(x - np.arange(3) * 2.0 * math.pi / 3.0)))
        for x in angle
    )
    (tmp_path / "f.csv").write_text(f"angle [rad],a [Wb],b [Wb],c [Wb]\n{rows}\n")
    shape = "model: waveform\n  self_inductance: 30 uH\n  back_emf: {{file: f.csv, connection: {}}}"
    found = [
        changed(
            ("kv: 190 rpm/V", shape.format(word)),
            ("  inductance: 60 uH terminal-to-terminal\n", ""),
            folder=tmp_path,
        ).machine.psi_pm
        for word in ("phase", "phase-to-neutral", "line-to-line", "Phase to phase", "terminals")
    ]
    assert found == pytest.approx([1.0, 1.0, *[1.0 / SQRT3] * 3], rel=1e-6)
