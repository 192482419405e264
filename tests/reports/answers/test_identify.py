"""`dqforge identify` from a bench file to a design that is checked."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, moteus_bench, slow_noise, write_table
from simulated_points import MeasuredMap, simulated

from dqforge import cli
from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.optimizer.identification.identify import identify
from dqforge.reports.pages.html_text import symbols

RUN = """
- name: ride
  kind: constant-speed
  file: ride.csv
  format: vesc-tool
  currents: measured
  voltage: reference
"""
MACHINE = "pole_pairs: 15\nmax_current: 60 A\nmagnet_flux: 30 mWb"
INVERTER = "{v_dc: 60 V, switching_frequency: 20 kHz}"


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stop:
        cli.main([str(argument) for argument in arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


@pytest.fixture
def ride(tmp_path: Path) -> Path:
    """Bench file of a ride as VESC Tool writes it."""
    rng = np.random.default_rng(1)
    omega_e = 15.0 * (20.0 + slow_noise(rng, 900, 0.99, 12.0))
    i_q, i_d = 8.0 + slow_noise(rng, 900, 0.95, 14.0), -np.abs(slow_noise(rng, 900, 0.98, 2.0))
    along = (i_d + 1j * i_q) / np.hypot(i_d, i_q)
    u_q = 0.07 * i_q + omega_e * (0.03 + 2e-4 * i_d) + 0.04 * along.imag
    u_d = 0.07 * i_d - omega_e * 3e-4 * i_q + 0.04 * along.real
    columns = {
        "d_axis_current": i_d,
        "q_axis_current": i_q,
        "erpm": omega_e * 30.0 / np.pi,
        "d_axis_voltage": u_d + slow_noise(rng, 900, 0.8, 0.05),
        "q_axis_voltage": u_q + slow_noise(rng, 900, 0.8, 0.05),
    }
    write_table(tmp_path / "ride.csv", columns)
    path = tmp_path / "bench.yaml"
    path.write_text(bench_text(RUN, MACHINE, INVERTER))
    return path


def test_a_design_with_sources_and_tolerances(ride: Path, tmp_path: Path) -> None:
    assert call("identify", ride, "-o", tmp_path / "one") == 0
    assert call("identify", ride, "-o", tmp_path / "two") == 0
    for name in ("design.yaml", "result.json", "report.html"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert call("check", tmp_path / "one" / "design.yaml") == 0
    design = load_design(tmp_path / "one" / "design.yaml")
    values = {value.path: value for value in design.values}
    assert "dqforge identify, bench.yaml: ride" in values["machine.resistance"].source
    assert design.machine.r_s == pytest.approx(0.07, rel=0.03)
    assert {"control.tolerances.r_s", "control.tolerances.psi_pm"} <= set(values)


def test_json_holds_covariance_and_hashes(ride: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("identify", ride, "--json") == 0
    found = json.loads(capsys.readouterr().out)["identification"]
    (analysis,) = found["analyses"]
    flux = analysis["keys"].index("magnet_flux")
    (parameter,) = (one for one in found["parameters"] if one["key"] == "magnet_flux")
    assert analysis["covariance"][flux][flux] == pytest.approx(parameter["sigma"] ** 2)
    assert len(found["logs"][0]["sha256"]) == 64
    angle = next(one for one in found["parameters"] if one["key"] == "encoder_angle")
    assert angle["status"] == "identified"
    assert angle["interval_95"][0] <= 0.0 <= angle["interval_95"][1]


def test_routes_that_contradict_each_other_write_no_design(
    tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = moteus_bench(tmp_path, shared_data, "hoverboard")
    assert call("identify", path, "-o", tmp_path / "out") == 1
    assert "two routes differ by a factor of 1.58" in capsys.readouterr().out.replace("\n", " ")
    assert not (tmp_path / "out" / "design.yaml").exists()
    assert (tmp_path / "out" / "result.json").exists()


def test_what_a_design_lacks_is_said(
    tmp_path: Path, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = moteus_bench(tmp_path, shared_data, "mj5208")
    assert call("identify", path, "-o", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "no design.yaml is written" in printed
    assert "max_current" in printed


def test_a_run_that_says_nothing_has_its_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_table(
        tmp_path / "ride.csv",
        {"erpm": np.arange(30.0), "q_axis_current": np.zeros(30), "q_axis_voltage": np.ones(30)},
    )
    path = tmp_path / "bench.yaml"
    path.write_text(bench_text(RUN, MACHINE))
    assert call("identify", path) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "bench.yaml:8:" in lines[0]
    assert "no current flows" in lines[0]


def test_a_flux_map_that_the_design_reads(tmp_path: Path, shared_data: Path) -> None:
    rows = simulated(MeasuredMap(shared_data), 1, rpm=(400.0,))
    columns = {
        "i_d [A]": rows.current.real,
        "i_q [A]": rows.current.imag,
        "u_d [V]": rows.voltage.real,
        "u_q [V]": rows.voltage.imag,
    }
    assert rows.temperature is not None
    write_table(tmp_path / "points.csv", columns | {"T [degC]": rows.temperature})
    run = """
- name: grid
  kind: flux-points
  file: points.csv
  columns: {i_d: i_d, i_q: i_q, u_d: u_d, u_q: u_q, temperature: T, speed: {value: 400 rpm}}
  currents: measured
  voltage: reference
"""
    path = tmp_path / "bench.yaml"
    machine = "pole_pairs: 2\nmax_current: 18 A"
    path.write_text(bench_text(run, machine, "{v_dc: 540 V, switching_frequency: 8 kHz}"))
    assert call("identify", path, "-o", tmp_path / "out") == 0
    design = load_design(tmp_path / "out" / "design.yaml")
    assert isinstance(design.machine, SaturatedMachine)
    assert design.machine.r_s == pytest.approx(0.63, abs=0.002)
    page = (tmp_path / "out" / "report.html").read_text()
    assert '<section id="map">' in page
    heading = (tmp_path / "out" / "map.csv").read_text().splitlines()[0]
    assert heading.startswith("i_d [A],i_q [A],psi_d [Wb],psi_q [Wb],sigma_d [Wb],sigma_q [Wb],n,")
    assert heading.count("shared_") == 2 * 5
    deviations = design.machine.flux_map.deviations
    assert deviations is not None
    assert deviations.shared.shape == (5, 2, rows.current.size)


def test_a_planned_bench_that_is_filled_is_identified(tmp_path: Path) -> None:
    assert call("identify", "--plan", "hoverboard-hub", "-o", tmp_path) == 0
    sheet = tmp_path / "points.csv"
    heading, *points = [line.split(",") for line in sheet.read_text().splitlines()]
    rng, filled = np.random.default_rng(5), [",".join(heading)]
    for number, rpm, i_d, i_q, seconds, *_ in points:
        omega, d, q = float(rpm) * np.pi / 30.0 * 15.0, float(i_d), float(i_q)
        u_d = 0.2 * d - omega * 0.4e-3 * q + rng.normal(0.0, 0.05)
        u_q = 0.2 * q + omega * (0.021 + 0.4e-3 * d) + rng.normal(0.0, 0.05)
        filled.append(f"{number},{rpm},{i_d},{i_q},{seconds},{u_d:.5g},{u_q:.5g}")
    sheet.write_text("\n".join(filled))
    assert call("identify", tmp_path / "bench.yaml", "-o", tmp_path / "out") == 0
    machine = load_design(tmp_path / "out" / "design.yaml").machine
    assert machine.psi_pm == pytest.approx(0.021, rel=0.01)
    assert machine.l_q == pytest.approx(0.4e-3, rel=0.03)
    assert call("identify", "--plan", "abb-syrm-6k7", "-o", tmp_path / "no") == 1
    assert not (tmp_path / "no").exists()


def test_a_plan_that_is_not_filled_in_has_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("identify", "--plan", "hoverboard-hub", "-o", tmp_path) == 0
    capsys.readouterr()
    assert call("identify", tmp_path / "bench.yaml") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "points.csv is not filled in: no number in u_d, u_q; fill the sheet" in line
    sheet = tmp_path / "points.csv"
    heading, *points = sheet.read_text().splitlines()
    half = [f"{point[:-1]}{place}," for place, point in enumerate(points)]
    sheet.write_text("\n".join([heading, *half]))
    assert call("identify", tmp_path / "bench.yaml") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no number in u_q; fill the sheet" in line


def test_the_page_says_what_the_terminal_says(ride: Path, tmp_path: Path) -> None:
    """And nothing that a file names is markup, or asks for anything outside."""
    text = ride.read_text().replace("name: ride", "name: 'ride <b>&lt; $\\frac$'")
    ride.write_text(text.replace("name: Machine on a bench", "name: '<script>alert(1)</script>'"))
    assert call("identify", ride, "-o", tmp_path / "out") == 0
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<script>alert" not in page
    assert "ride <b>" not in page
    assert "ride &lt;b&gt;&amp;lt; $\\frac$" in page
    assert not re.findall(r"""(?:src|href)=["']https?:""", page)
    found = json.loads((tmp_path / "out" / "result.json").read_text())["identification"]
    for one in found["parameters"]:
        assert one["label"].split(" ")[0] in page
    for remark in found["remarks"]:
        assert str(symbols(remark)) in page
    for section in ("summary", "remarks", "residuals", "runs"):
        assert f'<section id="{section}">' in page
    assert found["logs"][0]["sha256"] in page


def test_the_page_shows_a_resistance_over_its_temperature(ride: Path, tmp_path: Path) -> None:
    log = tmp_path / "ride.csv"
    heading, *rows = log.read_text().splitlines()
    warm = np.linspace(20.0, 60.0, len(rows))
    names = heading.split(",")
    i_d, i_q = names.index("d_axis_current"), names.index("q_axis_current")
    u_d, u_q = names.index("d_axis_voltage"), names.index("q_axis_voltage")
    lines = [f"{heading},temp_motor"]
    for row, temperature in zip(rows, warm, strict=True):
        cells = [float(cell) for cell in row.split(",")]
        more = 0.07 * 0.00393 * (temperature - 20.0)
        cells[u_d] += more * cells[i_d]
        cells[u_q] += more * cells[i_q]
        lines.append(",".join(f"{cell:.9g}" for cell in (*cells, temperature)))
    log.write_text("\n".join(lines))
    line = identify(read_bench(ride)).analyses[0].over_temperature
    assert line is not None
    assert line.value[0] == pytest.approx(0.07, rel=0.03)
    assert line.value[-1] == pytest.approx(0.07 * (1.0 + 0.00393 * 40.0), rel=0.03)
    truth = 0.07 * (1.0 + 0.00393 * (line.temperature - 20.0))
    assert np.all((line.low <= truth) & (truth <= line.high))
    assert call("identify", ride, "-o", tmp_path / "out") == 0
    assert '<section id="temperature-0">' in (tmp_path / "out" / "report.html").read_text()
