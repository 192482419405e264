"""The commands on configuration files of other firmware: written into, read, explained, compared,
made designs of, and verified.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from firmware_files import SCOOTER, scooter, scooter_files, scooter_fit

import dqforge
from dqforge import cli
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, Origin
from dqforge.optimizer.solution import solve
from dqforge.reports.firmware.design_made import (
    exact_text,
    merged,
    rate_text,
    read_configuration,
    speed_text,
)
from dqforge.reports.firmware.target import TARGETS
from dqforge.reports.firmware.written_files import FIRMWARE as FIRMWARE_FILES
from dqforge.reports.firmware.written_files import differing, written_firmware
from dqforge.reports.run import emitted_files

FIRMWARE = tuple(TARGETS)
Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Call:
    """One command in a folder with the scooter's design: its exit code and what it printed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scooter.yaml").write_text(SCOOTER)

    def called(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            cli.main([str(word) for word in words])
        printed = capsys.readouterr()
        assert isinstance(end.value.code, int)
        return end.value.code, printed.out, printed.err

    return called


def answered(call: Call, *words: object) -> dict[str, Any]:
    """The JSON of a command."""
    code, out, err = call(*words, "--json")
    assert (code, err) == (0, "")
    document: dict[str, Any] = json.loads(out)
    return document


def put(name: Any, folder: Path) -> list[Path]:
    """The scooter's files for a firmware, in a folder; those that a reader knows."""
    paths = []
    for file, content in scooter_files(name).items():
        (folder / file).write_bytes(content)
        if TARGETS[name].recognise(file, content.decode()):
            paths.append(folder / file)
    return paths


# export --for


@pytest.mark.thinned
@pytest.mark.parametrize("name", FIRMWARE)
def test_export_writes_what_its_reader_reads(call: Call, name: Any, tmp_path: Path) -> None:
    document = answered(call, "export", "scooter.yaml", "--for", name, "-o", "e", "--no-verify")
    files = [entry["name"] for entry in document["files"]]
    assert files == document["firmware"][name]["files"] == list(scooter_files(name))
    beside = {"dqforge-input", "dqforge-manifest.json"}
    assert {path.name for path in (tmp_path / "e").iterdir()} == {*files, *beside}
    for file, content in scooter_files(name).items():
        assert (tmp_path / "e" / file).read_bytes() == content
    known = [
        tmp_path / "e" / file
        for file in files
        if TARGETS[name].recognise(file, (tmp_path / "e" / file).read_text())
    ]
    found, _ = read_configuration(known)
    assert differing(scooter_fit(name).configuration, found) == ""
    loops = document["firmware"][name]["loops"]
    assert loops["i_q"]["stable"] is True
    judged = scooter_fit(name).judged.current_q
    assert judged is not None
    assert loops["i_q"]["phase_margin_rad"] == pytest.approx(judged.phase_margin)


def test_the_table_of_an_export_has_keys_values_and_units(call: Call) -> None:
    code, out, _ = call("export", "scooter.yaml", "--for", "vesc", "-o", "e", "--no-verify")
    assert code == 0
    row = next(line for line in out.splitlines() if "magnet flux linkage" in line)
    assert row.split()[3:7] == ["6.1259", "mWb", "foc_motor_flux_linkage", "0.00612588"]
    row = next(line for line in out.splitlines() if "pole pairs " in line)
    assert row.split("23")[-1].split("twice")[-1].split() == ["the", "pole", "pairs"]
    row = next(line for line in out.splitlines() if "foc_cc_decoupling" in line)
    assert row.split()[0:4] == ["foc_cc_decoupling", "3", "foc_cc_decoupling", "3"]
    assert "what is fed forward" in row
    assert "convention: currents and flux linkage are peak values" in out
    assert "vesc: run no motor detection afterwards" in out
    assert "delay of 0.5 periods" in out
    assert "loops as vesc runs them" in out
    assert "what the format cannot hold" in out
    assert "written: e/scooter_mcconf.xml e/scooter_mcconf.h" in out


def test_several_firmwares_are_written_at_once(call: Call, tmp_path: Path) -> None:
    words = ("--for", "vesc", "--for", "moteus", "--for", "vesc", "--no-verify")
    document = answered(call, "export", "scooter.yaml", *words)
    assert list(document["firmware"]) == ["vesc", "moteus"]
    assert (tmp_path / "out" / "scooter" / "scooter.moteus.cfg").is_file()
    assert answered(call, "verify", "out/scooter")["recomputation"]["files"] == 3


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_foreign_fields_stay_in_their_encoding(
    call: Call, tmp_path: Path, encoding: str, ends: str
) -> None:
    text = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<MCConfiguration>\n    <!-- mine -->\n'
        "    <m_ntc_motor_beta>3380</m_ntc_motor_beta>\n    <foc_motor_r>0.9</foc_motor_r>\n"
        "    <motor_description>é</motor_description>\n</MCConfiguration>\n"
    )
    path = tmp_path / "mine.xml"
    path.write_bytes(text.replace("\n", ends).encode(encoding))
    code, out, _ = call(
        "export", "scooter.yaml", "--for", "vesc", "--into", "mine.xml", "--no-verify"
    )
    assert code == 0
    assert "written: mine.xml" in out
    assert not (tmp_path / "out").exists()
    new = path.read_bytes().decode(encoding)
    assert new.count("\n") == new.count(ends)
    for kept in ("<!-- mine -->", "<m_ntc_motor_beta>3380</m_ntc_motor_beta>", ">é<"):
        assert kept in new
    assert "<foc_motor_r>0.05</foc_motor_r>" in new


def test_with_a_folder_the_old_file_stays(call: Call, tmp_path: Path) -> None:
    (old,) = put("moteus", tmp_path)
    old.write_text(old.read_text() + "conf set id.id 7\n")
    before = old.read_bytes()
    words = ("--for", "moteus", "--into", old, "-o", "new", "--no-verify")
    assert call("export", "scooter.yaml", *words, "--set", "machine.inertia=0.02")[0] == 0
    assert old.read_bytes() == before
    new = (tmp_path / "new" / old.name).read_text()
    assert "conf set id.id 7" in new
    assert "servo.inertia_feedforward 0.02" in new
    assert answered(call, "verify", "new")["recomputation"]["listed"] == []
    (tmp_path / "new" / old.name).write_text(new.replace("id.id 7", "id.id 8"))
    code, _, err = call("verify", "new")
    assert code == 1
    assert "8, the design gives 7" in err


def test_what_does_not_settle_is_not_written(call: Call, tmp_path: Path) -> None:
    """Twice the bandwidth that the sampling permits: the current swings."""
    (old,) = [path for path in put("vesc", tmp_path) if path.suffix == ".xml"]
    before = old.read_bytes()
    given = "control.current_loop={method: given, kp: 6 V/A, ki: 300 V/(A s), min_phase_margin: 0}"
    code, out, err = call("export", "scooter.yaml", "--for", "vesc", "--into", old, "--set", given)
    assert (code, out) == (1, "")
    assert "nothing is written" in err or "unstable" in err or "margin" in err
    assert old.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["scooter.yaml", *scooter_files("vesc")]
    )


def test_a_swing_that_only_the_firmware_has_is_found_in_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slow pole of a phase-locked loop that the design's own loops know nothing of."""
    design = scooter("control.firmware={name: vesc, pll_kp: 2000, pll_ki: 30000}")
    with pytest.raises(dqforge.NoSolutionError, match=r"PLL|limit cycle|unstable|phase margin"):
        dqforge.export_for(design, "vesc")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--for", "veks"], "--for: no firmware 'veks' is known; write one of vesc"),
        (["--into", "a.xml"], "--into: its firmware is unknown"),
        (["--for", "vesc", "--for", "moteus", "--into", "a.xml"], "--into: a file is one"),
        (["--for", "vesc", "--into", "a.xml"], "a.xml: there is no such file"),
        (["--for", "vesc", "--into", "scooter.yaml"], "scooter.yaml:1: is not a file of VESC"),
        (["--for", "vesc", "--set", "control.gains=false"], "gains"),
    ],
)
def test_wrong_questions_are_refused_in_one_line(
    call: Call, words: list[str], message: str
) -> None:
    code, out, err = call("export", "scooter.yaml", *words)
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_machines_that_no_firmware_drives_are_refused(call: Call) -> None:
    code, _, err = call("export", "vdyno-trampa-6340", "--for", "vesc")
    assert code == 2
    assert "model: waveform" in err


def test_nothing_is_replaced_where_one_of_the_files_cannot_be(call: Call, tmp_path: Path) -> None:
    xml, header = (tmp_path / f"scooter_mcconf{suffix}" for suffix in (".xml", ".h"))
    xml.write_text("old\n")
    header.mkdir()
    words = ("--for", "vesc", "-o", tmp_path, "--no-verify")
    code, _, err = call("export", "scooter.yaml", *words)
    assert code == 2
    assert "it is a folder" in err
    assert xml.read_text() == "old\n"
    assert {path.name for path in tmp_path.iterdir()} == {"scooter.yaml", xml.name, header.name}


# export.firmware, run and verify


def test_a_folder_is_read_back(tmp_path: Path) -> None:
    """What an export writes beside its headers; the whole run goes with the campaign."""
    solved = solve(scooter("export.firmware=[moteus, odrive]"))
    files = emitted_files(solved, [FIRMWARE_FILES])
    for name in ("scooter.moteus.cfg", "scooter_odrive.json"):
        (tmp_path / name).write_bytes(files[name])
    found = written_firmware(tmp_path, solved)
    assert found == {"moteus": ("scooter.moteus.cfg",), "odrive": ("scooter_odrive.json",)}
    path = tmp_path / "scooter.moteus.cfg"
    path.write_text(path.read_text().replace("poles 30", "poles 28"))
    with pytest.raises(dqforge.VerificationError, match=r"pole_pairs is 14, not 15"):
        written_firmware(tmp_path, solved)


@pytest.mark.slow
def test_a_run_writes_verifies_and_finds_what_was_changed(call: Call, tmp_path: Path) -> None:
    firmware = ("--set", "export.firmware=[vesc, moteus]")
    code, out, _ = call("run", "scooter.yaml", *firmware, "-o", "r")
    assert code == 0
    assert "for vesc" in out
    assert "for moteus" in out
    folder = tmp_path / "r"
    result = json.loads((folder / "result.json").read_text())
    assert result["firmware"]["vesc"]["configuration"]["drive"]["pole_pairs"] == 15
    assert result["firmware"]["moteus"]["files"] == ["scooter.moteus.cfg"]
    report = (folder / "report.html").read_text()
    assert "Other firmware" in report
    assert "foc_motor_flux_linkage" in report
    found = answered(call, "verify", "r")
    assert found["firmware"] == {
        "vesc": ["scooter_mcconf.xml", "scooter_mcconf.h"],
        "moteus": ["scooter.moteus.cfg"],
    }
    path = folder / "scooter.moteus.cfg"
    path.write_text(path.read_text().replace("poles 30", "poles 28"))
    code, _, err = call("verify", "r")
    assert code == 1
    assert "scooter.moteus.cfg" in err


def test_designs_without_the_key_say_nothing_of_it(call: Call) -> None:
    assert "firmware" not in answered(call, "export", "scooter.yaml", "--no-verify")
    assert scooter().export.firmware == ()
    assert scooter("export.firmware=vesc").export.firmware == ("vesc",)
    with pytest.raises(InputError, match="'veks'"):
        scooter("export.firmware=[veks]")


# new --from


@pytest.mark.thinned
@pytest.mark.parametrize("name", FIRMWARE)
def test_a_design_is_made_of_every_file(call: Call, name: Any, tmp_path: Path) -> None:
    """It says of every value where it stands, passes the checks, and has the machine."""
    wanted = scooter_fit(name).configuration
    paths = put(name, tmp_path)
    words = [word for path in paths for word in ("--from", path)]
    found = answered(call, "new", "probe", *words)
    keys = {"inverter.v_dc": "48 V", "inverter.switching_frequency": "20 kHz"}
    keys |= {"machine.max_current": "56.6 A", "machine.inertia": "0.01 kg m^2"}
    keys |= {"machine.magnet_flux": "6.1259 mWb"}
    given = [
        word
        for key in (*found["missing"], *found["wanted"])
        for word in ("--set", f"{key}={keys[key]}")
    ]
    code, _, err = call("new", "made", *words, *given)
    assert (code, err) == (0, "")
    design = dqforge.load_design(tmp_path / "made" / "design.yaml")
    assert design.control.firmware is not None
    assert design.control.firmware.name == name
    assert design.machine.pole_pairs == 15
    for key in ("r_s", "l_d", "l_q", "psi_pm"):
        value = getattr(wanted.drive, key)
        assert value is None or getattr(design.machine, key) == pytest.approx(value, rel=1e-12)
    document = yaml.safe_load((tmp_path / "made" / "design.yaml").read_text())
    entries = [*document["machine"].values(), *document["inverter"].values()]
    quantities = [entry for entry in entries if isinstance(entry, dict) and "value" in entry]
    assert len(quantities) >= 5
    assert all("source" in entry for entry in quantities)
    if wanted.current_q is not None:
        loop = design.control.current_loop
        assert loop.method == "given"
        assert (loop.kp, loop.ki) == pytest.approx(
            (wanted.current_q.kp, wanted.current_q.ki), rel=1e-12
        )


def test_what_a_file_does_not_say_is_asked_for(call: Call, tmp_path: Path) -> None:
    (path,) = [path for path in put("vesc", tmp_path) if path.suffix == ".xml"]
    code, out, _ = call("new", "made", "--from", path)
    assert code == 0
    assert "missing: inverter.v_dc; write it, or give --set inverter.v_dc='48 V'" in out
    assert "missing: machine.inertia" in out
    text = (tmp_path / "made" / "design.yaml").read_text()
    assert "QUESTION: the file does not say the voltage of the dc link" in text
    assert f'source: "{path.name}:' in text
    assert "# Convention: " in text
    code, _, err = call("check", "made/design.yaml")
    assert code == 2
    assert "v_dc" in err
    code, _, err = call("new", "other", "--from", path, "--set", "machine.inertia=0.01 kg m^2")
    assert code == 2
    assert "give --set inverter.v_dc='48 V' as well" in err
    assert not (tmp_path / "other").exists()


def test_the_gains_of_a_file_are_judged_by_tune(call: Call, tmp_path: Path) -> None:
    (path,) = [path for path in put("vesc", tmp_path) if path.suffix == ".xml"]
    given = ("--set", "inverter.v_dc=48 V", "--set", "machine.inertia=0.01 kg m^2")
    assert call("new", "made", "--from", path, *given)[0] == 0
    found = answered(call, "tune", "made/design.yaml")
    judged = scooter_fit("vesc").judged
    assert judged.current_q is not None
    assert call("tune", "made/design.yaml")[1].splitlines()[-1] == (
        "next: dqforge run made/design.yaml, or dqforge export made/design.yaml --for vesc, "
        "simplefoc, ..."
    )
    margins = json.dumps(found)
    assert f"{judged.current_q.phase_margin:.9g}" in margins


def test_a_design_that_is_there_is_kept(call: Call, tmp_path: Path) -> None:
    (path,) = put("moteus", tmp_path)
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "design.yaml").write_text("mine\n")
    code, _, err = call("new", "made", "--from", path)
    assert code == 2
    assert "exists already" in err
    assert (tmp_path / "made" / "design.yaml").read_text() == "mine\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--machine", "paper001-pmsm-bench"], "--from and --machine both define the design"),
        (["--set", "inverter.v_dc=48 V", "--set", "nonsense"], "--set: expected key=value"),
        (["--from", "scooter.yaml"], "scooter.yaml:1: no known firmware"),
    ],
)
def test_wrong_wishes_of_a_new_design_are_refused(
    call: Call, tmp_path: Path, words: list[str], message: str
) -> None:
    (path,) = put("moteus", tmp_path)
    code, _, err = call("new", "made", "--from", path, *words)
    assert code == 2
    assert message in err
    assert not (tmp_path / "made").exists()


def test_a_value_that_no_machine_has_is_refused_at_its_line(call: Call, tmp_path: Path) -> None:
    (path,) = put("moteus", tmp_path)
    text = path.read_text()
    line = next(k for k, row in enumerate(text.split("\n"), 1) if "motor.resistance_ohm" in row)
    path.write_text(text.replace("motor.resistance_ohm 0.05", "motor.resistance_ohm 5e9"))
    code, _, err = call("new", "made", "--from", path, "--set", "inverter.v_dc=48 V")
    assert code == 2
    assert err.startswith(f"dqforge: {path}:{line}: motor.resistance_ohm")


def test_files_of_two_firmwares_make_no_design(call: Call, tmp_path: Path) -> None:
    (moteus,) = put("moteus", tmp_path)
    (odrive,) = put("odrive", tmp_path)
    code, _, err = call("new", "made", "--from", moteus, "--from", odrive)
    assert code == 2
    assert "name files of one firmware" in err


def test_two_files_that_contradict_each_other_are_named() -> None:
    first, second = (
        Configuration(
            "vesc",
            "1",
            "a",
            scooter_fit("vesc").configuration.drive,
            origins={"r_s": Origin("R", text, 1)},
        )
        for text in ("0.05", "0.06")
    )
    second = replace(second, drive=replace(second.drive, v_dc=48.0, r_s=0.06))
    found = merged(first, second)
    assert found.drive.r_s == first.drive.r_s
    assert found.drive.v_dc == 48.0
    assert found.contradictions == ("R 0.05 and R 0.06 do not agree: the first counts",)


@pytest.mark.parametrize(
    ("value", "unit", "dimension", "text"),
    [
        (1e-4, "H", "inductance", "100 uH"),
        (0.05, "Ohm", "resistance", "50 mOhm"),
        (20e3, "Hz", "frequency", "20 kHz"),
        (0.00612587588, "Wb", "flux", "6.12587588 mWb"),
        (0.0, "s", "time", "0.0 s"),
        (1e-3, "kg m^2", "inertia", "0.001 kg m^2"),
    ],
)
def test_texts_of_values_lose_nothing(value: float, unit: str, dimension: str, text: str) -> None:
    assert exact_text(value, unit, dimension) == text


# explain


@pytest.mark.thinned
@pytest.mark.parametrize("name", FIRMWARE)
def test_every_file_is_explained(call: Call, name: Any, tmp_path: Path) -> None:
    paths = put(name, tmp_path)
    found = answered(call, "explain", *paths)["explained"]
    assert found["configuration"]["firmware"] == name
    assert found["machine"]["pole_pairs"] == 15
    on = answered(call, "explain", *paths, "--machine", "scooter.yaml")["explained"]
    assert on["machine"]["inertia_kg_m2"] == 0.01
    judged = scooter_fit(name).judged
    for key, loop in (("i_q", judged.current_q), ("speed", judged.speed)):
        if loop is not None and on["loops"][key] is not None:
            margin = on["loops"][key]["phase_margin_rad"]
            assert margin == pytest.approx(loop.phase_margin, abs=2e-3)
    code, out, _ = call("explain", *paths)
    assert code == 0
    assert f"loops as {name} runs them" in out
    assert "phase margin deg" in out


def test_gains_of_ours_have_the_margins_of_tune(call: Call, tmp_path: Path) -> None:
    """Header and result, whose loops are worked out anew, against the result's own margins."""
    assert call("export", "scooter.yaml", "--no-verify", "-o", "o")[0] == 0
    gains = json.loads((tmp_path / "o" / "result.json").read_text())["gains"]
    for source in ("o/result.json", "o", "o/scooter.h"):
        loops = answered(call, "explain", source)["explained"]["loops"]
        for name in ("i_d", "i_q", "speed") if source != "o/scooter.h" else ("i_d", "i_q"):
            for key in ("crossover_rad_per_s", "phase_margin_rad", "max_sensitivity"):
                assert loops[name][key] == pytest.approx(gains[name][key], rel=1e-3)
    header = answered(call, "explain", "o/scooter.h", "--machine", "scooter.yaml")
    speed = header["explained"]["loops"]["speed"]
    assert speed["phase_margin_rad"] == pytest.approx(gains["speed"]["phase_margin_rad"], rel=1e-3)
    code, out, _ = call("explain", "o/scooter.h")
    assert code == 0
    assert "the speed loop is not evaluated" in out


def test_files_of_ours_without_gains_are_refused(call: Call, tmp_path: Path) -> None:
    head = SCOOTER.partition("control:")[0]
    (tmp_path / "bare.yaml").write_text(f"{head}control: {{gains: false}}\n")
    assert call("export", "bare.yaml", "--no-verify", "-o", "o")[0] == 0
    for path, message in (
        ("o/motor_vectors.h", "give <prefix>.h or the result.json beside it"),
        ("o/motor.h", "holds no gains"),
        ("o/result.json", "gains: is missing"),
    ):
        code, _, err = call("explain", path)
        assert code == 2
        assert message in err
        assert err.count("\n") == 1


def test_the_lag_of_an_observer_is_told(call: Call) -> None:
    assert call("export", "paper001-pmsm-bench", "--no-verify", "-o", "o")[0] == 0
    for words in (["o/result.json"], ["o/bench001.h", "--machine", "paper001-pmsm-bench"]):
        remarks = answered(call, "explain", *words)["explained"]["loops"]["remarks"]
        assert any("it runs on an observer" in remark for remark in remarks)


# compare


def test_a_file_is_compared_with_its_design(call: Call, tmp_path: Path) -> None:
    (path,) = put("moteus", tmp_path)
    found = answered(call, "compare", path, "scooter.yaml")["comparison"]
    rows = {(row["section"], row["quantity"]): row for row in found["rows"]}
    resistance = rows["machine", "phase resistance"]
    assert (resistance["a"], resistance["b"]) == (0.05, 0.05)
    assert rows["i_q loop", "kp"]["relative"] == pytest.approx(0.0, abs=1e-3)
    assert {section for section, _ in rows} <= {
        "machine",
        "limits",
        "i_d loop",
        "i_q loop",
        "speed loop",
    }
    assert found["losses"] == []
    assert any("A is a configuration of other firmware" in note for note in found["notes"])


def test_two_files_are_compared(call: Call, tmp_path: Path) -> None:
    (one,) = put("moteus", tmp_path)
    other = tmp_path / "other.cfg"
    other.write_text(one.read_text().replace("resistance_ohm 0.05", "resistance_ohm 0.06"))
    found = answered(call, "compare", one, other)["comparison"]
    rows = {(row["section"], row["quantity"]): row for row in found["rows"]}
    assert rows["machine", "phase resistance"]["relative"] == pytest.approx(0.2)
    same = answered(call, "compare", one, one)["comparison"]
    assert same["identical"] is True


def test_keys_are_set_of_designs_alone(call: Call, tmp_path: Path) -> None:
    (path,) = put("moteus", tmp_path)
    code, _, err = call("compare", "scooter.yaml", path, "--set", "inverter.v_dc=50 V")
    assert code == 2
    assert "--set changes a design" in err


# Python


@pytest.mark.slow
def test_python_has_all_of_it(tmp_path: Path) -> None:
    (path,) = put("moteus", tmp_path)
    found = dqforge.read_firmware(path)
    assert found.configuration.firmware == "moteus"
    assert found.loops.current_q is not None
    assert math.degrees(found.loops.current_q.phase_margin) > 30.0
    assert found.plain()["configuration"]["drive"]["pole_pairs"] == 15
    design = dqforge.design_from_firmware(path, {"inverter.v_dc": "48 V"})
    made = dqforge.export_for(design, "moteus", into=path)
    assert made.loops.current_q is not None
    assert made.plain()["configuration"]["firmware"] == "moteus"
    again = dqforge.read_firmware(made.write(tmp_path / "again"))
    assert differing(made.configuration, again.configuration, whole=False) == ""
    with pytest.raises(InputError, match="no file is named"):
        dqforge.read_firmware([])
    (vesc,) = [path for path in put("vesc", tmp_path) if path.suffix == ".xml"]
    with pytest.raises(InputError, match=r"give \{'inverter.v_dc': '48 V'\}"):
        dqforge.design_from_firmware(vesc)


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["nxp", "ti"])
def test_a_file_that_holds_less_is_written_into(call: Call, name: Any, tmp_path: Path) -> None:
    path = next(path for path in put(name, tmp_path) if path.suffix == ".h")
    words = {"nxp": '"parametersJ"', "ti": "INERTIA"}[name]
    kept = [line for line in path.read_text().split("\n") if words not in line]
    path.write_text("\n".join(kept))
    document = answered(call, "export", "scooter.yaml", "--for", name, "--into", path)
    assert document["firmware"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (22500.0 / 15.0 * math.pi / 30.0, "1500 rpm"),
        (11.66667 * 2.0 * math.pi, "700.0002 rpm"),
        (100.123456789012, "100.123456789012 rad/s"),
    ],
)
def test_speeds_are_written_as_people_write_them(value: float, text: str) -> None:
    assert speed_text(value, "rad/s", "speed") == text


def test_frequencies_are_those_of_their_periods() -> None:
    assert rate_text(1e-05) == "100 kHz"
    assert rate_text(125e-6) == "8 kHz"
    third = 1.0 / 3e4
    assert rate_text(third) == "30 kHz"
    assert rate_text(math.pi * 1e-5).endswith(" kHz")
    assert math.isclose(float(rate_text(math.pi * 1e-5).split()[0]), 100.0 / math.pi, rel_tol=1e-15)


def test_the_example_of_the_carrier_goes_with_the_period_of_the_file(
    call: Call, tmp_path: Path
) -> None:
    fast = ("inverter.switching_frequency=50 kHz", "control.sampling_frequency=50 kHz")
    sets = [word for key in fast for word in ("--set", key)]
    done = call("export", "scooter.yaml", "--for", "simplefoc", *sets, "-o", "f", "--no-verify")
    assert done[0] == 0
    code, out, err = call("new", "made", "--from", "f/scooter_simplefoc.h")
    assert (code, err) == (0, "")
    assert "--set inverter.switching_frequency='50 kHz'" in out
