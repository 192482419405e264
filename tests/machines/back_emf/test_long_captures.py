"""Long captures: read to the end, the same through a design, in bounded memory,
and refused beyond the limit.
"""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from peak_memory import run_and_measure

from dqforge import cli
from dqforge.machines.arrays import FloatArray
from dqforge.machines.back_emf import columns as bemf_columns
from dqforge.machines.back_emf import harmonics as bemf_harmonics
from dqforge.machines.back_emf import harmonics as bemf_motion
from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import BemfCapture, BemfResult
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.errors import InputError

PSI = 10e-3
DESIGN = """dqforge: 1
name: Capture
machine:
    model: waveform
    pole_pairs: 7
    resistance: 0.2 Ohm
    self_inductance: 1 mH
    max_current: 10 A
    back_emf: {{file: {file}, scale: {scale}, highest_order: 13, symmetric: false}}
inverter: {{v_dc: 48 V, switching_frequency: 10 kHz}}
"""


def record(count: int, periods: float, noise: float = 0.0, drift: float = 0.0) -> BemfCapture:
    """Times from 0 at 50 Hz in the middle, speed rising by the share ``drift``, a fifth of 3 %."""
    length = periods / 50.0
    time: FloatArray = np.arange(count, dtype=np.float64) * (length / count)
    share = time / length - 0.5
    theta = 2.0 * np.pi * 50.0 * (time + 0.5 * drift * length * share**2)
    theta = theta - np.arange(3)[:, None] * 2.0 * np.pi / 3.0
    speed = 2.0 * np.pi * 50.0 * (1.0 + drift * share)
    volts = -speed * PSI * (np.sin(theta) + 0.03 * np.sin(5.0 * theta))
    volts = volts + noise * np.random.default_rng(5).standard_normal(volts.shape)
    return BemfCapture("scope.csv", time, None, volts, np.arange(2, count + 2))


def save(capture: BemfCapture, place: Path) -> None:
    assert capture.time is not None
    with place.open("w", encoding="utf-8") as stream:
        stream.write("t_s,a_V,b_V,c_V\n")
        np.savetxt(
            stream, np.column_stack([capture.time, *capture.voltages]), fmt="%.9e", delimiter=","
        )


def test_a_record_above_a_megabyte_is_read_to_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """1.9 MB hold 7.00 periods, on the command line as in a design."""
    monkeypatch.chdir(tmp_path)
    save(record(29_000, 7.0, noise=0.01), tmp_path / "scope.csv")
    assert (tmp_path / "scope.csv").stat().st_size > 1_850_000
    with pytest.raises(SystemExit) as ended:
        cli.main(["bemf", "scope.csv", "--json", "--harmonics", "13"])
    assert ended.value.code == 0
    shown = capsys.readouterr()
    assert shown.err == ""  # no bar in a pipe
    found = json.loads(shown.out)["bemf"]
    assert found["periods"] == pytest.approx(7.0, abs=1e-3)
    assert found["psi_pm_Wb"] == pytest.approx(PSI, rel=1e-4)
    np.testing.assert_allclose(found["noise"], 0.01, rtol=0.02)
    (tmp_path / "design.yaml").write_text(
        DESIGN.format(file="scope.csv", scale="[1, 1, 1]"), encoding="utf-8"
    )
    machine = load_design(tmp_path / "design.yaml").phase_machine
    assert machine is not None
    assert machine.psi_pm == pytest.approx(found["psi_pm_Wb"], rel=1e-8)  # as JSON prints it


def test_a_measured_record_gives_the_same_through_a_design(
    tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = shared_data / "bemf" / "vdyno_trampa6340_0500rpm1_dec10.csv"
    with pytest.raises(SystemExit):
        cli.main(["bemf", str(source), "--json", "--harmonics", "13", "--scale", "1,1,10"])
    found = json.loads(capsys.readouterr().out)["bemf"]
    (tmp_path / "scope.csv").symlink_to(tmp_path / "data.csv")
    (tmp_path / "data.csv").write_bytes(source.read_bytes())
    (tmp_path / "design.yaml").write_text(
        DESIGN.format(file="scope.csv", scale="[1, 1, 10]"), encoding="utf-8"
    )
    machine = load_design(tmp_path / "design.yaml").phase_machine
    assert machine is not None
    assert machine.psi_pm == pytest.approx(found["psi_pm_Wb"], rel=1e-8)
    assert machine.psi_pm == pytest.approx(5.43e-3, rel=5e-3)


def in_parts(capture: BemfCapture, monkeypatch: pytest.MonkeyPatch) -> BemfResult:
    """Result of a record that counts as long."""
    with monkeypatch.context() as long:
        for module in (bemf_motion, bemf_harmonics):
            long.setattr(module, "LONG", 2000)
        return analyse(capture, harmonics=9)


@pytest.mark.parametrize("connection", ["phase", "line-to-line"])
@pytest.mark.parametrize(
    ("count", "periods", "drift"),
    [
        (5003, 3.3, 0.0),
        (5003, 7.1, 0.02),
        (20_011, 40.3, 0.1),
        (20_011, 500.7, 0.02),
        (20_011, 500.7, -0.3),
    ],
)
def test_long_records_give_what_short_ones_do(
    count: int, periods: float, drift: float, connection: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The means by which long records are kept small change nothing but the last digits."""
    capture = record(count, periods, 0.02, drift)
    if connection == "line-to-line":
        lines = capture.voltages - np.roll(capture.voltages, -1, axis=0)
        capture = BemfCapture("scope.csv", capture.time, None, lines, capture.lines, "line-to-line")
    short, long = analyse(capture, harmonics=9), in_parts(capture, monkeypatch)
    assert long.psi_pm == pytest.approx(short.psi_pm, rel=1e-9)
    assert long.psi_pm == pytest.approx(PSI, rel=2e-3)
    assert long.frequency == pytest.approx(short.frequency, rel=1e-10)
    np.testing.assert_allclose(long.amplitudes, short.amplitudes, rtol=0.0, atol=1e-9 * PSI)
    np.testing.assert_allclose(long.amplitude_uncertainty, short.amplitude_uncertainty, rtol=0.15)
    np.testing.assert_allclose(long.noise, short.noise, rtol=1e-6)
    assert long.findings == short.findings


def test_more_samples_than_the_limit_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bemf_columns, "MOST_SAMPLES", 3999)
    save(record(4000, 7.0), tmp_path / "scope.csv")
    with pytest.raises(SystemExit) as ended:
        cli.main(["bemf", str(tmp_path / "scope.csv")])
    assert ended.value.code == 2
    assert "at most 0.003999 million can be read" in capsys.readouterr().err
    (tmp_path / "design.yaml").write_text(
        DESIGN.format(file="scope.csv", scale="[1, 1, 1]"), encoding="utf-8"
    )
    with pytest.raises(InputError, match=r"at most 0\.003999 million can be read"):
        load_design(tmp_path / "design.yaml")


@pytest.mark.slow
def test_a_bar_moves_on_a_terminal(tmp_path: Path) -> None:
    save(record(4000, 7.0), tmp_path / "scope.csv")
    command = [str(Path(sys.executable).with_name("dqforge")), "bemf", str(tmp_path / "scope.csv")]
    ours, theirs = pty.openpty()
    try:
        subprocess.run(command, stdout=subprocess.PIPE, stderr=theirs, check=True)
        os.set_blocking(ours, False)
        shown = os.read(ours, 65_536)
    finally:
        os.close(ours)
        os.close(theirs)
    assert b"reading the capture" in shown


@pytest.mark.slow
def test_two_hundred_megabytes_take_less_than_a_gibibyte(tmp_path: Path) -> None:
    """Five million samples of three channels in 217 MB of text: the peak of a process of its
    own.
    """
    with (tmp_path / "scope.csv").open("w", encoding="utf-8") as stream:
        stream.write("t_s,a_V,b_V,c_V\n")
        generator = np.random.default_rng(6)
        for start in range(0, 5_000_000, 250_000):
            time = 1e-6 * (start + np.arange(250_000))
            theta = 2.0 * np.pi * 50.0 * time - np.arange(3)[:, None] * 2.0 * np.pi / 3.0
            volts = -3.0 * np.sin(theta) + 0.05 * generator.standard_normal(theta.shape)
            line = "%.6f,%.8f,%.8f,%.8f\n"
            stream.write(line * time.size % tuple(np.column_stack([time, *volts]).ravel().tolist()))
    assert (tmp_path / "scope.csv").stat().st_size > 200_000_000
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from dqforge.reports.back_emf import CaptureRequest, read_capture\n"
        "found = read_capture([Path(sys.argv[1])], CaptureRequest())\n"
        "print(found.result.psi_pm, found.result.periods)\n"
    )
    printed, peak = run_and_measure(program, str(tmp_path / "scope.csv"))
    psi, periods = (float(word) for word in printed.split())
    assert psi == pytest.approx(3.0 / (2.0 * np.pi * 50.0), rel=1e-4)
    assert periods == pytest.approx(250.0, abs=1e-2)
    assert peak < 1 << 30


def test_a_long_record_takes_its_phase_from_the_channel_that_has_it() -> None:
    """A probe that lies beside has a hundred times the noise; the phase is that of the other."""
    count, periods = 40_000, 80.0
    time = np.linspace(0.0, 0.4, count)
    place = np.linspace(-1.0, 1.0, count)
    speed = np.pi * periods
    noise = 100.0 * np.random.default_rng(3).normal(size=count)
    voltages = np.array([noise, np.sin(speed * place + 0.4 + 0.7 * place)])
    for finds in (bemf_harmonics._phase, bemf_harmonics._long_phase):
        for order in (slice(None), slice(None, None, -1)):
            places, phase = finds(time, voltages[order], speed, round(count / periods))
            turns = np.unwrap(phase)
            bent = np.polynomial.polynomial.polyfit(places, turns, 1)
            assert bent[1] == pytest.approx(0.7, abs=0.02)
            assert np.std(turns - np.polynomial.polynomial.polyval(places, bent)) < 0.01
