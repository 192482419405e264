"""Speeds without a unit: told where they are far above the largest speed,
refused on the command line.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from dqforge.cli import main
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.settings import speed_keys
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import parse_option

DESIGN = """\
dqforge: 1
name: Bench motor
machine:
  pole_pairs: 3
  resistance: 2 Ohm
  inductance_d: 1.61 mH
  inductance_q: 1.74 mH
  magnet_flux: 0.06 Wb
  max_current: 6.4 A
  max_speed: 3000 rpm
  inertia: 200e-6 kg m^2
inverter:
  v_dc: 180 V
  switching_frequency: 5 kHz
  device: {kind: mosfet, on_resistance: 10 mOhm, turn_on_energy: 0.1 mJ, turn_off_energy: 0.1 mJ,
    reference_current: 10 A, reference_voltage: 180 V, thermal_resistance: 1 K/W}
"""
WAVEFORM = (
    DESIGN.replace("inductance_d: 1.61 mH", "model: waveform")
    .replace("inductance_q: 1.74 mH", "self_inductance: 2 mH")
    .replace("magnet_flux: 0.06 Wb", "back_emf: {harmonics: [{order: 1, amplitude: 0.06 Wb}]}")
)
_LOOP = "control: {speed_loop: {}}\n"
_SIMULATION = "simulation:\n  duration: 1 s\n"
_OBSERVED = "control:\n  speed_loop: {}\n  observer: {method: extended-emf}\n"
# Every key of a speed: the design with @ for its value.
KEYS = {
    "machine.max_speed": DESIGN.replace("max_speed: 3000 rpm", "max_speed: @"),
    "machine.rated.speed": DESIGN.replace("  max_speed:", "  rated: {speed: @}\n  max_speed:"),
    "operation.speed": f"{DESIGN}operation: {{speed: @}}\n",
    "control.per_unit.speed": f"{DESIGN}control: {{per_unit: {{speed: @}}}}\n",
    "control.commissioning.speed": f"{DESIGN}control: {{commissioning: {{speed: @}}}}\n",
    "losses.points[0].speed": f"{DESIGN}losses: {{points: [{{torque: 1 N m, speed: @}}]}}\n",
    "field_weakening.speed": f"{DESIGN}field_weakening: {{speed: @}}\n",
    "modulation_choice.speed": (
        f"{DESIGN}modulation_choice: {{min_frequency: 5 kHz, max_frequency: 9 kHz, speed: @}}\n"
    ),
    "waveform.speed": f"{WAVEFORM}waveform: {{speed: @}}\n",
    "simulation.speed.points[0].speed": (
        f"{DESIGN}{_LOOP}{_SIMULATION}  speed: {{points: [{{time: 0 s, speed: @}}]}}\n"
    ),
    "simulation.speed.amplitude": (
        f"{DESIGN}{_LOOP}{_SIMULATION}  speed: {{amplitude: @, frequency: 5 Hz}}\n"
    ),
    "simulation.shaft.points[0].speed": f"{DESIGN}{_SIMULATION}  torque: {{}}\n"
    "  shaft: {points: [{time: 0 s, speed: @}]}\n",
    "simulation.shaft.amplitude": (
        f"{DESIGN}{_SIMULATION}  torque: {{}}\n  shaft: {{amplitude: @, frequency: 5 Hz}}\n"
    ),
    "simulation.initial.speed": f"{DESIGN}{_SIMULATION}  torque: {{}}\n  initial: {{speed: @}}\n",
    "simulation.sensorless.above": (
        f"{DESIGN}{_OBSERVED}{_SIMULATION}  torque: {{}}\n  sensorless: {{above: @}}\n"
    ),
    "control.speed_loop.measurement.lowest": (
        f"{DESIGN}control:\n  speed_loop:\n"
        "    measurement: {method: counts, lines: 1024, lowest: @}\n"
    ),
    "control.start_up.hand_over": (
        f"{DESIGN}control:\n  observer: {{method: flux}}\n  speed_loop: {{}}\n"
        "  start_up: {method: i-f, hand_over: @}\nexport: {control: float32}\n"
    ),
    "simulation.sensorless.below": f"{DESIGN}{_OBSERVED}{_SIMULATION}  torque: {{}}\n"
    "  sensorless: {above: 9000 rad/s, below: @}\n",
}
REFUSED = (
    "machine.rated.speed",
    "operation.speed",
    "losses.points[0].speed",
    "modulation_choice.speed",
)


def _design(key: str, value: str) -> bytes:
    return KEYS[key].replace("@", value).encode()


def test_every_speed_of_the_schema_is_here() -> None:
    # The speed that chooses among the points of a flux map must be one of those in the file.
    chosen = {"machine.flux_map.at.speed"}
    assert {key.replace("[0]", "[]") for key in KEYS} | chosen == set(speed_keys(DesignFile))


@pytest.mark.parametrize("key", KEYS)
def test_a_bare_speed_far_above_the_largest_is_told(key: str) -> None:
    if key in REFUSED:
        with pytest.raises(InputError, match=r"no unit.*'3000 rpm'"):
            load_text(_design(key, "3000"), "f.yaml")
        return
    found = [
        text
        for text in load_text(_design(key, "3000"), "f.yaml").assumptions
        if "has no unit" in text
    ]
    assert len(found) == 1
    assert found[0].startswith(key)
    assert "28648 rpm" in found[0]
    assert "'3000 rpm'" in found[0]


@pytest.mark.parametrize("key", [key for key in KEYS if key != "machine.max_speed"])
@pytest.mark.parametrize("text", ["300", "3000 rpm"])
def test_other_speeds_are_not(key: str, text: str) -> None:
    # 300 rad/s are 2865 rpm, below the largest speed.
    design = load_text(_design(key, text), "f.yaml")
    assert not [sentence for sentence in design.assumptions if "has no unit" in sentence]


def test_beyond_three_times_only() -> None:
    # 3000 rpm are 314.16 rad/s, three times that 942.48.
    for value, told in (("942", False), ("943", True), ("943 rad/s", False)):
        found = load_text(_design("control.per_unit.speed", value), "f.yaml").assumptions
        assert any("has no unit" in text for text in found) is told


@pytest.mark.parametrize("text", ["3000", "3e3", "-3000", " 52.4 "])
def test_a_speed_option_needs_its_unit(text: str) -> None:
    with pytest.raises(InputError, match=r"--speed: .* has no unit") as caught:
        parse_option(text, "speed", "--speed")
    assert f"'{text.strip()} rpm'" in caught.value.message
    assert f"'{text.strip()} rad/s'" in caught.value.message
    assert parse_option("3000 rpm", "speed", "--speed") == pytest.approx(314.1592653589793)
    assert parse_option("0", "speed", "--speed") == 0.0


def test_every_command_with_a_speed_refuses_a_bare_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import typer

    from dqforge.cli import app

    capture = tmp_path / "capture.csv"
    capture.write_text("t;a;b;c\n0;1;2;3\n")
    commands = {
        name: [option for option in command.params if "--speed" in option.opts]
        for name, command in vars(typer.main.get_command(app))["commands"].items()
    }
    with_speed = sorted(name for name, options in commands.items() if options)
    assert with_speed == ["bemf", "dqy", "mtpa"]
    targets = {"bemf": str(capture), "dqy": "paper002-phase-waveforms", "mtpa": "abb-ipmsm-2k2"}
    for name in with_speed:
        with pytest.raises(SystemExit) as caught:
            main([name, targets[name], "--speed", "3000"])
        assert caught.value.code == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert "'3000 rpm' or '3000 rad/s'" in told
