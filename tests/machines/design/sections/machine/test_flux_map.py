"""What a design declares of its flux maps: temperatures and speeds, a file per flux linkage,
the kind of torque.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from saturated import ArctanMachine
from typer.testing import CliRunner

from dqforge.cli import app
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.errors import InputError

MACHINE = ArctanMachine()
AXIS_D, AXIS_Q = np.arange(-120.0, 121.0, 20.0), np.arange(0.0, 121.0, 20.0)
MESH_D, MESH_Q = np.meshgrid(AXIS_D, AXIS_Q, indexing="ij")
PSI_D, PSI_Q = MACHINE.flux(MESH_D, MESH_Q)
TORQUE = 4.5 * (PSI_D * MESH_Q - PSI_Q * MESH_D)

Numbers = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def design(folder: Path, keys: str, **files: str) -> Path:
    for name, text in files.items():
        (folder / f"{name}.csv").write_text(text)
    path = folder / "design.yaml"
    path.write_text(f"""dqforge: 1
name: Mapped
machine:
  model: flux-map
  pole_pairs: 3
  resistance: 0.05 Ohm
  max_current: 100 A
  max_speed: 6000 rpm
  flux_map: {{{keys}}}
inverter: {{v_dc: 400 V, switching_frequency: 10 kHz}}
""")
    return path


def table(titles: str, *columns: Numbers) -> str:
    rows = np.column_stack([np.ravel(column) for column in columns]).tolist()
    return "\n".join([titles, *(",".join(map(repr, row)) for row in rows)])


def matrix(values: Numbers) -> str:
    rows = [
        ",".join(map(repr, [q, *row]))
        for q, row in zip(AXIS_Q.tolist(), values.T.tolist(), strict=True)
    ]
    return "\n".join(["," + ",".join(map(repr, AXIS_D.tolist())), *rows])


def assert_is_the_machine(path: Path) -> None:
    machine = load_design(path).machine
    assert isinstance(machine, SaturatedMachine)
    found = machine.flux_map.flux(MESH_D, MESH_Q)
    np.testing.assert_allclose(np.stack(found), np.stack([PSI_D, PSI_Q]), atol=1e-9)


def test_a_file_per_flux_linkage_and_torque(tmp_path: Path) -> None:
    files = {"d": matrix(PSI_D), "q": matrix(PSI_Q), "t": matrix(TORQUE)}
    path = design(tmp_path, "file: d.csv, psi_q_file: q.csv, torque_file: t.csv", **files)
    assert_is_the_machine(path)
    values = {value.path: value.si for value in load_design(path).values}
    assert values["machine.flux_map.torque_slope"] == pytest.approx(1.0)
    path = design(
        tmp_path,
        "file: d.csv, psi_q_file: other.csv",
        other=matrix(PSI_Q).replace("-120.0", "-121.0"),
    )
    with pytest.raises(
        InputError, match=r"^.*design.yaml:9:\d+: machine.flux_map: other.csv: its i_d differs"
    ):
        load_design(path)


def test_files_of_several_temperatures_have_one_file_each(tmp_path: Path) -> None:
    files = (
        "files: [{file: d.csv, magnet_temperature: 20 degC}, {file: d.csv, magnet_temperature: 90 "
        "degC}]"
    )
    with pytest.raises(InputError, match="psi_q_file goes with file, not with files"):
        load_design(design(tmp_path, f"{files}, psi_q_file: q.csv", d=matrix(PSI_D)))


def test_one_temperature_or_speed_of_several(tmp_path: Path) -> None:
    both = [np.concatenate([part, part]) for part in (MESH_D, MESH_Q, PSI_D, PSI_Q)]
    both[2][len(MESH_D) :] += 0.005
    speed = np.repeat([1000.0, 2000.0], MESH_D.size)
    text = table("id,iq,psi_d,psi_q,speed [rpm]", *both, speed)
    assert_is_the_machine(design(tmp_path, "file: map.csv, at: {speed: 1000 rpm}", map=text))
    for keys, phrase in (
        ("", "say which: at: {speed: 1000 rpm}"),
        (", at: {speed: 1500 rpm}", "but at 1000 rpm, 2000"),
    ):
        with pytest.raises(InputError, match=phrase) as caught:
            load_design(design(tmp_path, f"file: map.csv{keys}", map=text))
        assert "design.yaml:9:" in str(caught.value)
    with pytest.raises(
        InputError, match=r"at\.temperature: the file does not say the temperature of its points"
    ):
        load_design(
            design(tmp_path, "file: map.csv, at: {speed: 1000 rpm, temperature: 80 degC}", map=text)
        )


def test_slope_and_misfit_are_printed_by_check_and_stand_in_its_data(tmp_path: Path) -> None:
    text = table("id,iq,psi_d,psi_q,T [Nm]", MESH_D, MESH_Q, PSI_D, PSI_Q, 0.95 * TORQUE - 1.0)
    path = design(tmp_path, "file: map.csv, torque: shaft", map=text)
    done = CliRunner().invoke(app, ["check", str(path)], env={"COLUMNS": "200"})
    assert done.exit_code == 0, done.output
    assert "machine.flux_map.torque_slope" in done.output
    assert "0.95000 times 3/2 p (psi_d i_q - psi_q i_d)" in " ".join(done.output.split())
    plain = json.loads(CliRunner().invoke(app, ["check", str(path), "--json"]).output)
    values = {value["path"]: value for value in plain["input"]["values"]}
    assert values["machine.flux_map.torque_slope"]["si"] == pytest.approx(0.95)
    assert values["machine.flux_map.torque_offset"]["si"] == pytest.approx(-1.0)
    assert values["machine.flux_map.torque_misfit"]["si"] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(InputError, match=r"write torque: shaft"):
        load_design(design(tmp_path, "file: map.csv", map=text))


def test_a_slip_and_a_hole_are_named_with_their_line(tmp_path: Path) -> None:
    text = table("id,iq,psi_d,psi_q", MESH_D, MESH_Q, PSI_D, PSI_Q)
    slip = text.replace("\n-20.0,", "\n2432.0,", 1)
    with pytest.raises(InputError, match=r"^map.csv:37: i_d = 2432 A lies far from all others"):
        load_design(design(tmp_path, "file: map.csv", map=slip))
    cells = text.split("\n")
    cells[5] = ",".join([*cells[5].split(",")[:3], "nan"])
    with pytest.raises(InputError, match=r"^map.csv:6: psi_q has 1 holes"):
        load_design(design(tmp_path, "file: map.csv", map="\n".join(cells)))
