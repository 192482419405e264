"""The page on a measured drive: its commands run as they stand there, and its figures hold."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.names import CurrentFrame
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.reports.session.losses import read_back_emf
from dqforge.reports.simulation.design_run import simulate_design

DRIVE = "vdyno-trampa-6340"
CAPTURE = "vdyno_trampa6340_0500rpm1_dec10.csv"
PAGE = (Path(__file__).resolve().parents[1] / "docs" / "methods" / "measured-drive.md").read_text(
    "utf-8"
)
COMMANDS = re.findall(r"^    dqforge (.*)$", PAGE, flags=re.MULTILINE)
LONG = ("run", "verify", "simulate")


def call(arguments: str, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and standard output of one command, which may go into a file by ``>``."""
    command, _, target = arguments.partition(" > ")
    with pytest.raises(SystemExit) as stop:
        cli.main(shlex.split(command))
    out = capsys.readouterr().out
    if target:
        Path(target).write_text(out, encoding="utf-8")
    assert isinstance(stop.value.code, int)
    return stop.value.code, out


def run_page(
    commands: list[str],
    folder: Path,
    data: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> dict[str, str]:
    """What each command prints, by its first word."""
    shutil.copy(data / "bemf" / CAPTURE, folder / CAPTURE)
    monkeypatch.chdir(folder)
    said = {}
    for command in commands:
        code, said[command.split()[0]] = call(command, capsys)
        assert code == 0, command
    return said


def test_the_commands_of_the_page_that_take_no_time_run(
    tmp_path: Path,
    shared_data: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    quick = [command for command in COMMANDS if command.split()[0] not in LONG]
    assert [command.split()[0] for command in quick] == ["bemf", "machines", "check", "dqy"]
    said = run_page(quick, tmp_path, shared_data, monkeypatch, capsys)
    assert "5.436 mWb" in said["bemf"]
    assert re.search(r"pole pairs differ by +1\.19 \+- 0\.31 %", said["bemf"])
    assert re.search(r"dq: sinusoidal +\S+ +0 +7\.1", said["dqy"])
    assert re.search(r"dqx: constant torque, no neutral +\S+ +\+0\.10 +0 ", said["dqy"])


@pytest.mark.slow
def test_all_commands_of_the_page_run(
    tmp_path: Path,
    shared_data: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    said = run_page(COMMANDS, tmp_path, shared_data, monkeypatch, capsys)
    assert "results equal the model bit for bit" in said["verify"]
    assert (tmp_path / "out" / "trampa_control.h").is_file()
    assert (tmp_path / "simulated").is_dir()


def test_the_shipped_harmonics_are_those_of_the_capture(shared_data: Path) -> None:
    """The design's waveform against the mean of the phases that is found in the file, to 0.1 % of
    its peak; the rest is the rounding of what the design writes.
    """
    machine = catalogue.load(DRIVE).phase_machine
    assert isinstance(machine, PhaseMachine)
    read = read_back_emf(
        shared_data / "bemf" / CAPTURE, pole_pairs=7, scale=(1.0, 1.0, 10.0), harmonics=13
    )
    found = read.machine(pole_pairs=7, r_s=0.035, l_s=25e-6, m_s=-5e-6, i_max=40.0)
    assert np.max(np.abs(found.flux - machine.flux)) < 1e-3 * np.max(np.abs(machine.flux))


@pytest.mark.slow
def test_the_drive_runs_on_the_measured_back_emf() -> None:
    """The figures of the page: torque ripple at 500 rpm before the step of the speed."""
    design, ripple = catalogue.load(DRIVE), {}
    frames: tuple[CurrentFrame, ...] = ("dq", "table")
    for frame in frames:
        loop = replace(design.control.current_loop, frame=frame)
        control = replace(design.control, current_loop=loop)
        run = simulate_design(replace(design, control=control)).run
        torque = run.torque[3000:4000]
        assert run.omega_m[3999] == pytest.approx(500.0 * np.pi / 30.0, rel=1e-3)
        assert np.mean(torque) == pytest.approx(0.5, rel=1e-3)
        assert run.omega_m[-1] == pytest.approx(1500.0 * np.pi / 30.0, rel=1e-3)
        ripple[frame] = float(np.ptp(torque) / np.mean(torque))
    assert ripple["dq"] == pytest.approx(0.0746, abs=1e-3)
    assert ripple["table"] == pytest.approx(0.0040, abs=3e-4)
