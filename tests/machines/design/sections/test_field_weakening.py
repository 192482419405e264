"""The section field_weakening of a design file: from the text to verified headers and back."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.optimizer.field_weakening.fit import solve_weakening
from dqforge.optimizer.field_weakening.voltage_region import voltage_region
from dqforge.optimizer.operating_points.characteristics import characteristics
from dqforge.optimizer.operating_points.mtpa_locus import Active, mtpa_locus
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.reports.output.folder import put_files
from dqforge.reports.run import export_design, read_folder, run_design, verify_folder
from dqforge.reports.single_headers.field_weakening import weakening_tables

LIBRARY = Path(__file__).resolve().parents[4] / "machines" / "library"
RPM = math.pi / 30.0


def design(
    section: str, *, drive: str = "paper000-ipmsm-100kw", drop: str = "", **changes: str
) -> Design:
    """A library drive with a section, without the line of a key, and with some texts replaced."""
    text = (LIBRARY / f"{drive}.yaml").read_text(encoding="utf-8")
    lines = [
        line for line in text.splitlines() if not (drop and line.strip().startswith(f"{drop}:"))
    ]
    text = "\n".join(lines) + f"\nfield_weakening: {section}\n"
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return load_text(text.encode(), "design.yaml")


def test_defaults_come_from_the_machine_and_are_stated() -> None:
    loaded = design("{}")
    assert loaded.weakening == WeakeningSettings(
        loaded.machine.omega_m_max or 0.0, 0.005, 0.005, 2048
    )
    assert any("field_weakening.speed is 9000 rpm" in sentence for sentence in loaded.assumptions)


def test_what_is_written_is_taken() -> None:
    loaded = design("{speed: 6000 rpm, torque_error: 0.8 %, voltage_excess: 0.4 %, flash: 1500 B}")
    assert loaded.weakening is not None
    assert loaded.weakening.omega_m == pytest.approx(6000.0 * RPM)
    assert loaded.weakening.torque_error == pytest.approx(0.008)
    assert loaded.weakening.voltage_excess == pytest.approx(0.004)
    assert loaded.weakening.flash == 1500
    assert not any("field_weakening" in sentence for sentence in loaded.assumptions)


def test_a_drive_without_the_section_has_no_such_reference() -> None:
    loaded = load_text((LIBRARY / "paper000-ipmsm-100kw.yaml").read_bytes(), "design.yaml")
    assert loaded.weakening is None
    assert solve_weakening(loaded) is None


def test_without_any_speed_the_section_is_refused_with_its_position() -> None:
    with pytest.raises(InputError, match=r"write \{speed: 6000 rpm\}") as caught:
        design("{}", drop="max_speed")
    assert caught.value.line is not None


def test_no_field_is_weakened_with_no_d_current() -> None:
    with pytest.raises(InputError, match="field_weakening needs"):
        design("{}", **{"strategy: mtpa": "strategy: id0"})


def test_a_speed_within_the_voltage_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="limits nothing"):
        solve_weakening(design("{speed: 300 rpm}"))


@pytest.mark.slow
def test_margin_and_modulation_set_the_voltage() -> None:
    loaded = design(
        "{}", **{"strategy: mtpa": "strategy: mtpa\n  modulation: spwm\n  voltage_margin: 10 %"}
    )
    fit = solve_weakening(loaded)
    assert fit is not None
    assert fit.domain.v_max == pytest.approx(0.9 * 0.5 * loaded.inverter.v_dc, rel=1e-12)
    whole = fit.domain.v_max / (loaded.machine.pole_pairs * (loaded.machine.omega_m_max or 0.0))
    # What the resistance takes at the largest torque there: 0.6 V of 225 V.
    assert 0.99 * whole < fit.region.flux_min < whole
    chart, settings = fit.chart, fit.settings
    assert (
        chart.torque.shape
        == chart.flux.shape
        == chart.torque_error.shape
        == chart.voltage_error.shape
    )
    assert 0.0 < np.max(np.abs(chart.torque_error)) <= settings.torque_error
    assert np.max(chart.voltage_error) <= settings.voltage_excess
    np.testing.assert_allclose(
        np.max(chart.borders.largest_torque), fit.region.torque_max, rtol=1e-6
    )


SMALL = {"bench": "paper001-pmsm-bench", "abb": "abb-ipmsm-2k2"}


@pytest.mark.parametrize("drive", SMALL.values())
@pytest.mark.parametrize("factor", [0.9, 0.98, 0.998, 1.002, 1.02, 1.15])
def test_the_section_is_refused_exactly_where_no_operating_point_is_limited(
    drive: str, factor: float
) -> None:
    """Base speed, operating points and surfaces know the same resistance;
    without it the base speed is 10 % higher.
    """
    loaded = load_text((LIBRARY / f"{drive}.yaml").read_bytes(), "design.yaml")
    v_max = loaded.inverter.v_dc / math.sqrt(3.0) * (1.0 - loaded.operation.voltage_margin)
    machine, i_max = loaded.machine, loaded.i_max
    base = characteristics(machine, v_max, i_max).base_speed
    omega_m = factor * base
    torque = np.linspace(0.0, mtpa_locus(machine, i_max).torque[-1], 200)
    found = optimal_points(machine, torque, omega_m, v_max=v_max, i_max=i_max)
    limited = bool(np.any(np.isin(found.active, [Active.VOLTAGE, Active.BOTH, Active.MTPV])))
    assert limited == (factor > 1.0)
    if limited:
        assert voltage_region(machine, i_max, v_max, omega_m).flux.flux_max > 0.0
    else:
        with pytest.raises(
            NoSolutionError, match=r"limits nothing up to .* the resistance drop included"
        ):
            voltage_region(machine, i_max, v_max, omega_m)


@pytest.mark.slow
def test_a_size_that_would_do_is_named() -> None:
    with pytest.raises(NoSolutionError, match=r"write flash: \d+ B") as caught:
        solve_weakening(design("{flash: 300 B}"))
    needed = re.search(r"write flash: (\d+) B", str(caught.value))
    assert needed is not None
    fit = solve_weakening(design(f"{{flash: {needed[1]} B}}"))
    assert fit is not None
    assert fit.step.flash == int(needed[1])


def test_a_resistance_that_takes_the_whole_voltage_is_refused() -> None:
    machine = LinearMachine(
        pole_pairs=3, r_s=40.0, l_d=6e-3, l_q=6e-3, psi_pm=0.06, i_max=6.4, inertia=1e-5
    )
    with pytest.raises(NoSolutionError, match="the resistance alone takes"):
        voltage_region(machine, 6.4, 104.0, 500.0)


@pytest.mark.slow
def test_headers_are_written_verified_rebuilt_and_a_changed_digit_is_found(tmp_path: Path) -> None:
    output = export_design(design("{}"), verify=True)
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    put_files(tmp_path, output.files)
    found = read_folder(tmp_path)
    assert "current reference with field weakening" in [part.name for part in found.further]
    assert {f"{found.prefix}_weakening.h", f"{found.prefix}_weakening_vectors.h"} <= set(
        found.files
    )
    verify_folder(tmp_path)
    plain = json.loads(output.files["result.json"])["weakening"]
    assert plain["errors"]["torque_relative"] <= 0.005
    assert (
        plain["voltage_errors"]["voltage_excess"] <= plain["certificate"]["voltage_excess"] <= 0.005
    )
    assert plain["trials"][-1]["chosen"] is True

    header = tmp_path / f"{found.prefix}_weakening.h"
    text = header.read_text(encoding="ascii")
    literal = re.search(r"float d2 = (-?\d+\.\d)", text)
    assert literal is not None
    changed = literal[1][:-1] + str((int(literal[1][-1]) + 1) % 10)
    header.write_text(text.replace(literal[1], changed, 1), encoding="ascii")
    with pytest.raises(VerificationError, match="does not give the results"):
        verify_folder(tmp_path)
    header.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        verify_folder(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["x", {}, {"flux_min": 1.0}])
def test_a_damaged_result_is_refused(damage: object, tmp_path: Path) -> None:
    output = export_design(design("{}"), verify=False)
    put_files(tmp_path, output.files)
    document = json.loads(output.files["result.json"]) | {"weakening_header": damage}
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="ascii")
    with pytest.raises(InputError, match="weakening_header is not what dqforge writes"):
        read_folder(tmp_path)


@pytest.mark.slow
def test_report_and_tables_show_errors_and_the_trials() -> None:
    output = run_design(design("{}"), verify=False)
    fit = output.solution.weakening
    assert fit is not None
    page = output.files["report.html"].decode("utf-8")
    assert page.count('id="weakening"') == 1
    assert (
        "Errors of torque and voltage over flux linkage and torque" in page
    )  # description of the figure
    assert "ipm100_weakening_reference" in page
    proof = json.loads(output.files["result.json"])["weakening"]["certificate"]
    assert fit.certificate is not None
    assert fit.certificate.torque <= proof["torque"] <= fit.certificate.torque * (1.0 + 1e-7)
    assert proof["model"] == "equations"
    assert "Proven for every torque, motoring and generating" in page
    (table,) = weakening_tables(fit)
    assert len(table.rows) == len(fit.trials)
    assert any(note.startswith("proven bounds: torque ") for note in table.notes)
    assert table.rows[-1][2] == str(fit.step.coefficients)
    assert weakening_tables(None) == []
    plain = load_text((LIBRARY / "paper000-ipmsm-100kw.yaml").read_bytes(), "design.yaml")
    assert 'id="weakening"' not in run_design(plain, verify=False).files["report.html"].decode(
        "utf-8"
    )
