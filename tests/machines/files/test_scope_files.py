"""Captures as oscilloscopes write them: one machine in all layouts, and what is said
where no time can be found.
"""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
import scope_files
from scope_files import LAYOUTS, PSI, STEP, VOLTS, Files, rows

from dqforge import cli
from dqforge.machines.design.catalogue import load_design

DESIGN = """dqforge: 1
name: Capture
machine:
    model: waveform
    pole_pairs: 2
    resistance: 0.2 Ohm
    self_inductance: 1 mH
    max_current: 10 A
    back_emf: {{ {named}, highest_order: 13 }}
inverter: {{v_dc: 48 V, switching_frequency: 10 kHz}}
"""


def saved(folder: Path, files: Files) -> list[str]:
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return [name for name in files if name != "cap.csv"]


def bemf(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, object]:
    with pytest.raises(SystemExit) as ended:
        cli.main(["bemf", *words, "--json", "--harmonics", "13"])
    shown = capsys.readouterr()
    assert ended.value.code == 0, shown.err
    found: dict[str, object] = json.loads(shown.out)["bemf"]
    return found


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    with pytest.raises(SystemExit) as ended:
        cli.main(["bemf", *words])
    shown = capsys.readouterr()
    assert ended.value.code == 2, shown.out + shown.err
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    return shown.err


@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_machine_in_all_layouts(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Magnet flux to 0.1 %, frequency to 0.01 %, the fifth to 0.2 % of the fundamental.

    The same through a design.
    """
    monkeypatch.chdir(tmp_path)
    names = saved(tmp_path, LAYOUTS[layout]())
    found = bemf(capsys, *names)
    assert found["psi_pm_Wb"] == pytest.approx(PSI, rel=1e-3)
    assert found["frequency_Hz"] == pytest.approx(50.0, rel=1e-4)
    assert found["periods"] == pytest.approx(5.0, rel=1e-3)
    amplitudes = np.array(found["amplitudes_Wb"])
    np.testing.assert_allclose(amplitudes[:, 4] / amplitudes[:, 0], 0.04, atol=2e-3)
    assert found["sequence"] == "abc"
    named = f"file: {names[0]}" if len(names) == 1 else f"files: [{', '.join(names)}]"
    (tmp_path / "design.yaml").write_text(
        DESIGN.format(named=f"{named}, symmetric: false"), encoding="utf-8"
    )
    machine = load_design(tmp_path / "design.yaml").phase_machine
    assert machine is not None
    assert machine.psi_pm == pytest.approx(found["psi_pm_Wb"], rel=1e-8)  # as JSON prints it


@pytest.mark.parametrize(
    "layout", ["Rohde & Schwarz RTO", "Rigol MSO5000", "Yokogawa DL", "PicoScope, MATLAB"]
)
def test_the_interval_of_the_header_is_that_of_the_samples(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twice the interval in the header halves the frequency and doubles the flux linkage."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(scope_files, "STEP", 2.0 * STEP)
    found = bemf(capsys, *saved(tmp_path, LAYOUTS[layout]()))
    assert found["frequency_Hz"] == pytest.approx(25.0, rel=1e-4)
    assert found["psi_pm_Wb"] == pytest.approx(2.0 * PSI, rel=1e-3)


@pytest.mark.parametrize(
    "head", ["", "CH1,CH2,CH3\n", "CH1 (V),CH2 (V),CH3 (V)\n", "a,b,c\n", "u [V],v [V],w [V]\n"]
)
@pytest.mark.parametrize("counted", [False, True])
def test_a_channel_is_never_taken_for_the_time(
    head: str,
    counted: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    columns = [np.arange(VOLTS.shape[1], dtype=np.float64), *VOLTS] if counted else list(VOLTS)
    heading = f"Sample,{head}" if counted and head else head
    (tmp_path / "scope.csv").write_text(heading + rows(columns), encoding="utf-8")
    said = refusal(capsys, "scope.csv")
    assert "--interval 2 us" in said
    assert "interval: 2 us" in said
    found = bemf(capsys, "scope.csv", "--interval", "20 us")
    assert found["psi_pm_Wb"] == pytest.approx(PSI, rel=1e-3)
    given = "file: scope.csv, interval: 20 us"
    (tmp_path / "design.yaml").write_text(DESIGN.format(named=given), encoding="utf-8")
    machine = load_design(tmp_path / "design.yaml").phase_machine
    assert machine is not None
    assert machine.psi_pm == pytest.approx(PSI, rel=1e-3)


def test_what_the_interval_contradicts_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    saved(
        tmp_path,
        scope_files.keysight() | scope_files.rigol_mso5000() | scope_files.tektronix_single(),
    )
    assert "has times already" in refusal(capsys, "scope_0.csv", "--interval", "20 us")
    assert "states 20 us" in refusal(capsys, "RigolDS1.csv", "--interval", "2 us")
    assert "--interval" in refusal(capsys, "RigolDS1.csv", "--interval", "20")
    assert "above 0" in refusal(capsys, "RigolDS1.csv", "--interval", "0 us")
    assert "three phases are needed" in refusal(capsys, "F0000CH1.CSV")
    assert "a third phase is needed" in refusal(capsys, "F0000CH1.CSV", "F0000CH2.CSV")
    assert "given twice" in refusal(capsys, "F0000CH1.CSV", "F0000CH2.CSV", "F0000CH1.CSV")


def test_channels_of_several_files_must_belong_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = saved(tmp_path, scope_files.keysight_single())
    whole = (tmp_path / "ch3.csv").read_text(encoding="utf-8")
    (tmp_path / "ch3.csv").write_text(whole.rsplit("\n", 11)[0] + "\n", encoding="utf-8")
    assert "4990 samples" in refusal(capsys, *names)
    shifted = rows([scope_files.TIME + 1e-3, VOLTS[2]])
    (tmp_path / "ch3.csv").write_text("t_s,u_V\n" + shifted, encoding="utf-8")
    assert "1 ms" in refusal(capsys, *names)
    (tmp_path / "ch3.csv").write_text("CH3V, tInc = 2e-05\n" + rows([VOLTS[2]]), encoding="utf-8")
    assert "times" in refusal(capsys, *names)


def test_compressed_captures_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dqforge.machines.back_emf.columns.MOST_BYTES", 1_000_000)
    (tmp_path / "bomb.csv.gz").write_bytes(gzip.compress(b"1,2,3,4\n" * 500_000, mtime=0))
    assert "more than 1 MB once unpacked" in refusal(capsys, "bomb.csv.gz")
    whole = gzip.compress(next(iter(scope_files.keysight().values())), mtime=0)
    (tmp_path / "cut.csv.gz").write_bytes(whole[:-2000])
    assert "cut off or damaged" in refusal(capsys, "cut.csv.gz")
    (tmp_path / "two.csv.gz").write_bytes(whole + whole)
    (tmp_path / "none.csv.gz").write_bytes(b"1,2,3,4\n" * 50)
    assert "no gzip file" in refusal(capsys, "none.csv.gz")
    (tmp_path / "tail.csv.gz").write_bytes(whole + b"tail")
    assert "cut off or damaged" in refusal(capsys, "tail.csv.gz")


@pytest.mark.parametrize("name", ["yepes2024_backEMF.mat", "yepes2024_angle.mat"])
def test_matrices_of_others_that_are_no_capture(
    name: str, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert name in refusal(capsys, str(shared_data / "bemf" / name))


def test_files_of_two_phases_of_a_drill(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two channels of one machine, a file each: as line-to-line voltages they would do,
    as phases they do not.
    """
    folder = shared_data / "bemf"
    files = [
        str(folder / name)
        for name in ("vdyno_drill_YellowA0001CH1.CSV", "vdyno_drill_RedA0001CH2.CSV")
    ]
    assert "2 channels" in refusal(capsys, *files)
