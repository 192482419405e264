"""A modulator and a position observer from outside the package's files, through the whole chain:
check, run with the emitted C compiled and compared bit for bit, verify, and a changed header.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from worked_examples import module_of

from dqforge import cli
from dqforge.machines.errors import VerificationError
from dqforge.machines.modulation import registry as modulators
from dqforge.machines.modulation.modulator import Modulator
from dqforge.optimizer.observers.methods import registry as observers
from dqforge.optimizer.observers.parts import ObserverMethod
from dqforge.reports.run import verify_folder

MODULATOR = "machines/modulation/families/fifth_of_third_harmonic.py"
OBSERVER = "optimizer/observers/methods/back_emf.py"
DESIGN = """\
dqforge: 1
name: Worked example
machine: {pole_pairs: 3, resistance: 2.35 Ohm, inductance_d: 1.61 mH, inductance_q: 1.74 mH,
  magnet_flux: 0.06 Wb, max_current: 6.4 A, max_speed: 3000 rpm, inertia: 200e-6 kg m^2}
inverter:
  v_dc: 214 V
  switching_frequency: 10 kHz
  device: {kind: igbt, on_resistance: 7 mOhm, on_voltage: 1.05 V, diode_voltage: 0.9 V,
    diode_resistance: 5 mOhm, turn_on_energy: 6 mJ, turn_off_energy: 6 mJ,
    reverse_recovery_energy: 2 mJ, reference_current: 150 A, reference_voltage: 300 V,
    thermal_resistance: 0.4 K/W}
  coolant_temperature: 30 degC
"""
WITH_MODULATOR = """\
operation: {modulation: thipwm5, speed: 3000 rpm}
losses:
  points: [{torque: 0.47 N m, speed: 1200 rpm}]
  modulations: [svpwm, thipwm5]
export: {prefix: toy, control: [FORMAT]}
"""
WITH_OBSERVER = """\
control: {observer: {method: back-emf, pll_bandwidth: 60 rad/s}}
export: {prefix: toy}
"""


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        cli.main([str(argument) for argument in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def folder_of(design: str, tmp_path: Path) -> Path:
    """What `dqforge run` writes and verifies for a design that `dqforge check` accepts."""
    (tmp_path / "design.yaml").write_text(DESIGN + design)
    assert call("check", tmp_path / "design.yaml") == 0
    assert call("run", tmp_path / "design.yaml", "-o", tmp_path / "out") == 0
    assert call("verify", tmp_path / "out") == 0
    return tmp_path / "out"


@pytest.fixture
def modulator(tmp_path: Path) -> Iterator[Modulator]:
    with module_of(MODULATOR, tmp_path) as file, modulators.registered(*file.MODULATORS):
        yield file.MODULATORS[0]


@pytest.fixture
def observer(tmp_path: Path) -> Iterator[ObserverMethod]:
    with (
        module_of(OBSERVER, tmp_path) as file,
        observers.registered(file.METHOD, ("pll_bandwidth", "damping")),
    ):
        yield file.METHOD


def changed(header: Path, old: str, new: str) -> None:
    text = header.read_text()
    assert old in text
    header.write_text(text.replace(old, new))


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("number_format", "file", "old", "new"),
    [
        ("float32", "toy_control.h", "- (0.8F * (", "- (0.7F * ("),
        ("q15", "toy_control_q15.h", "* 26214, 15U)", "* 26213, 15U)"),
    ],
)
def test_a_modulator_goes_through_the_whole_chain(
    number_format: str, file: str, old: str, new: str, modulator: Modulator, tmp_path: Path
) -> None:
    out = folder_of(WITH_MODULATOR.replace("FORMAT", number_format), tmp_path)
    header = out / file
    assert modulator.name in header.read_text()
    rows = json.loads((out / "result.json").read_text())["losses"]["rows"]
    assert {row["modulation"] for row in rows} == {"svpwm", "thipwm5"}
    assert "THIPWM5" in (out / "report.html").read_text()
    changed(header, old, new)
    with pytest.raises(VerificationError):
        verify_folder(out)


def test_a_modulator_is_refused_outside_its_context(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "design.yaml").write_text(DESIGN + WITH_MODULATOR.replace("FORMAT", "float32"))
    assert call("check", tmp_path / "design.yaml") == 2
    assert "thipwm5" in capsys.readouterr().err


@pytest.mark.slow
def test_an_observer_goes_through_the_whole_chain(observer: ObserverMethod, tmp_path: Path) -> None:
    out = folder_of(WITH_OBSERVER, tmp_path)
    plain = json.loads((out / "result.json").read_text())
    assert plain["observer_header"]["method"] == observer.name
    assert plain["observer_header"]["gains"]["half_r"] == 1.175
    assert "loop 60 rad/s" in (out / "report.html").read_text()
    changed(out / "toy_observer.h", "(observer->i.alpha + i.alpha)", "(i.alpha)")
    with pytest.raises(VerificationError, match="position observer"):
        verify_folder(out)


def test_an_observer_takes_its_own_keys_alone(
    observer: ObserverMethod, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = f"control: {{observer: {{method: {observer.name}, speed_gain: 0.2}}}}\n"
    (tmp_path / "design.yaml").write_text(DESIGN + wrong)
    assert call("check", tmp_path / "design.yaml") == 2
    assert "'back-emf' does not use 'speed_gain'" in capsys.readouterr().err


def test_an_observer_is_refused_outside_its_context(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "design.yaml").write_text(DESIGN + WITH_OBSERVER)
    assert call("check", tmp_path / "design.yaml") == 2
    assert "back-emf" in capsys.readouterr().err
