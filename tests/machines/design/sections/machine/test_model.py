"""Machines of design files: temperatures, flux maps in files beside the design,
published saturation.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from saturated import ArctanMachine

from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError

LINEAR = """\
dqforge: 1
name: Bench motor
machine:
  pole_pairs: 3
  resistance: 2 Ohm
  inductance_d: 1.61 mH
  inductance_q: 1.74 mH
  magnet_flux: 0.06 Wb
  max_current: 6.4 A
inverter:
  v_dc: 180 V
  switching_frequency: 5 kHz
export: {prefix: bench}
"""
MAPPED = """\
dqforge: 1
name: Mapped
machine:
  model: flux-map
  pole_pairs: 3
  resistance: 0.05 Ohm
  flux_map:
    file: map.csv
  max_current: 100 A
  max_speed: 6000 rpm
inverter:
  v_dc: 400 V
  switching_frequency: 10 kHz
control:
  current_loop: {method: bandwidth, bandwidth: 300 Hz}
export: {prefix: mapped}
"""
TRUTH = ArctanMachine()


def written(folder: Path, text: str, files: dict[str, ArctanMachine]) -> Path:
    """A design file and its maps, sampled every 10 A from -120 to 120 A and 0 to 120 A."""
    i_d, i_q = np.meshgrid(
        np.arange(-120.0, 121.0, 10.0), np.arange(0.0, 121.0, 10.0), indexing="ij"
    )
    for name, machine in files.items():
        psi_d, psi_q = machine.flux(i_d, i_q)
        columns = np.column_stack([part.ravel() for part in (i_d, i_q, psi_d, psi_q)])
        np.savetxt(
            folder / name, columns, delimiter=",", header="id_A,iq_A,psi_d_Vs,psi_q_Vs", comments=""
        )
    path = folder / "design.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def loaded(text: str) -> Design:
    return load_text(text.encode(), "design.yaml")


def test_copper_and_magnets_follow_their_coefficients() -> None:
    """100 K of copper at 0.393 %/K are 39.3 %; 60 K of magnets at -0.11 %/K are -6.6 %."""
    warm = (
        "  temperature: {winding: 120 degC, magnet: 80 degC, magnet_coefficient: -0.11 %/K}\n"
        "  max_current"
    )
    machine = loaded(LINEAR.replace("  max_current", warm)).machine
    assert machine.r_s == pytest.approx(2.0 * 1.393, rel=1e-12)
    assert machine.psi_pm == pytest.approx(0.06 * 0.934, rel=1e-12)
    other = warm.replace(
        "winding: 120 degC", "winding: 120, winding_reference: 25, copper_coefficient: 0.4 %/K"
    )
    assert loaded(LINEAR.replace("  max_current", other)).machine.r_s == pytest.approx(
        2.0 * 1.38, rel=1e-12
    )


def test_conversions_of_temperature_are_told() -> None:
    warm = (
        "  temperature: {winding: 120 degC, magnet: 80 degC, magnet_coefficient: -0.11 %/K}\n"
        "  max_current"
    )
    design = loaded(LINEAR.replace("  max_current", warm))
    value = next(value for value in design.values if value.path == "machine.resistance")
    assert value.si == pytest.approx(2.786)
    assert value.note == "at 120 degC, 0.393 %/K from 20 degC"
    assert any(
        "magnet flux is 0.05604 Wb at 80 degC (0.06 Wb at 20 degC)" in text
        for text in design.assumptions
    )


def test_flux_map_beside_the_design_becomes_the_machine(tmp_path: Path) -> None:
    design = load_design(written(tmp_path, MAPPED, {"map.csv": TRUTH}))
    machine = design.machine
    assert isinstance(machine, SaturatedMachine)
    assert machine.psi_pm == pytest.approx(TRUTH.psi_pm, rel=1e-5)
    i_d, i_q = np.array([-33.0, -80.0]), np.array([47.0, -15.0])
    np.testing.assert_allclose(machine.torque(i_d, i_q), TRUTH.torque(i_d, i_q), rtol=1e-4)
    assert design.fit.form == "polynomial"
    assert any("fit.form is polynomial" in text for text in design.assumptions)


def test_either_slash_leads_to_a_file_below_the_design(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    written(tmp_path / "maps", MAPPED, {"map.csv": TRUTH})
    (tmp_path / "design.yaml").write_text(
        MAPPED.replace("map.csv", "maps\\map.csv"), encoding="utf-8"
    )
    design = load_design(tmp_path / "design.yaml")
    assert isinstance(design.machine, SaturatedMachine)
    assert design.given is not None
    assert [name for name, _ in design.given.named] == ["maps/map.csv"]


def test_digest_covers_the_map(tmp_path: Path) -> None:
    path = written(tmp_path, MAPPED, {"map.csv": TRUTH})
    before = load_design(path).digest
    assert load_design(path).digest == before
    content = (tmp_path / "map.csv").read_text(encoding="ascii")
    (tmp_path / "map.csv").write_text(content.replace("1.2", "1.20", 1), encoding="ascii")
    assert load_design(path).digest != before


def test_map_of_maps_is_interpolated_over_the_magnet_temperature(tmp_path: Path) -> None:
    several = MAPPED.replace(
        "    file: map.csv\n",
        (
            "    files: [{file: cold.csv, magnet_temperature: 20 degC}, {file: hot.csv, "
            "magnet_temperature: 120 degC}]\n"
        ),
    ).replace("  max_current", "  temperature: {magnet: 70 degC}\n  max_current")
    files = {"cold.csv": ArctanMachine(psi_m=0.12), "hot.csv": ArctanMachine(psi_m=0.10)}
    assert load_design(written(tmp_path, several, files)).machine.psi_pm == pytest.approx(
        0.11, rel=1e-4
    )
    with pytest.raises(InputError, match="20 to 120"):
        load_design(written(tmp_path, several.replace("magnet: 70", "magnet: 150"), files))
    with pytest.raises(InputError, match=r"needs machine\.temperature\.magnet"):
        load_design(
            written(tmp_path, several.replace("  temperature: {magnet: 70 degC}\n", ""), files)
        )


def test_current_limit_beyond_the_map_is_refused_or_marked(tmp_path: Path) -> None:
    far = MAPPED.replace("100 A", "150 A")
    with pytest.raises(InputError, match="lies beyond the flux map, which ends at 120 A") as caught:
        load_design(written(tmp_path, far, {"map.csv": TRUTH}))
    assert (caught.value.line, caught.value.column) == (9, 16)
    permitted = far.replace("file: map.csv", "file: map.csv\n    extrapolate: true")
    design = load_design(written(tmp_path, permitted, {"map.csv": TRUTH}))
    assert any("extrapolated along its tangents" in text for text in design.assumptions)
    assert not design.machine.known(np.array([0.0]), np.array([130.0]))[0]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../map.csv", "lies outside the folder"),
        ("/etc/passwd", "lies outside the folder"),
        ("missing.csv", "there is no file 'missing.csv' beside the design file"),
        ("link.csv", "lies outside the folder"),
        (".", "this is a folder"),
    ],
)
def test_files_are_read_only_from_the_folder_of_the_design(
    tmp_path: Path, name: str, message: str
) -> None:
    folder = tmp_path / "inner"
    folder.mkdir()
    written(tmp_path, MAPPED, {"map.csv": TRUTH})
    (folder / "link.csv").symlink_to(tmp_path / "map.csv")
    path = folder / "design.yaml"
    path.write_text(MAPPED.replace("map.csv", name), encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        load_design(path)
    assert caught.value.line == 8


def test_text_without_a_folder_names_no_files() -> None:
    with pytest.raises(InputError, match="cannot name files"):
        loaded(MAPPED)


def test_faults_of_a_map_stand_at_the_key_of_its_file(tmp_path: Path) -> None:
    path = written(tmp_path, MAPPED, {"map.csv": TRUTH})
    rows = (tmp_path / "map.csv").read_text(encoding="ascii").splitlines()
    (tmp_path / "map.csv").write_text("\n".join(rows[:5]), encoding="ascii")
    with pytest.raises(InputError, match=r"map\.csv") as caught:
        load_design(path)
    assert str(caught.value).startswith(f"{path}:8:11: machine.flux_map: ")


def test_faults_of_a_row_stand_at_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, MAPPED, {"map.csv": TRUTH})
    rows = (tmp_path / "map.csv").read_text(encoding="ascii").splitlines()
    rows[40] = rows[40].rsplit(",", 1)[0] + ",nan"
    (tmp_path / "map.csv").write_text("\n".join(rows), encoding="ascii")
    with pytest.raises(InputError, match=r"^map\.csv:41: psi_q has 1 holes"):
        load_design(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "  inductance_d: 1.61 mH\n",
            "",
            "machine needs the key 'inductance_d'; write inductance_d: 1.61 mH",
        ),
        (
            "  pole_pairs: 3",
            "  model: flux-map\n  pole_pairs: 3",
            "inductance_d belongs to the model 'linear'",
        ),
        ("  pole_pairs: 3", "  model: fluxmap\n  pole_pairs: 3", "did you mean 'flux-map'?"),
        (
            "  max_current",
            "  temperature: {magnet: 80 degC}\n  max_current",
            "write magnet_coefficient: -0.11 %/K",
        ),
        (
            "  max_current",
            "  temperature: {magnet: 180, magnet_coefficient: -1 %/K}\n  max_current",
            "nothing would be left of the magnet flux",
        ),
        (
            "  max_current",
            (
                "  temperature: {winding: -60, winding_reference: 100, copper_coefficient: 1 %/K}\n"
                "  max_current"
            ),
            "resistance at -60 would be -1.2 Ohm",
        ),
        (
            "export:",
            "operation: {voltage_margin: 5 %}\nexport:",
            "operation.voltage_margin limits the voltage at a",
        ),
        (
            "export:",
            "operation: {strategy: id0, speed: 3000 rpm}\nexport:",
            "id0 cannot weaken the field",
        ),
        (
            "export:",
            "operation: {speed: 3000 rpm}\nfit: {form: closed-form}\nexport:",
            (
                "closed-form follows the MTPA locus, which operation.speed leaves; write form: "
                "torque-exact"
            ),
        ),
    ],
)
def test_keys_that_do_not_fit_are_named(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        loaded(LINEAR.replace(old, new))
    assert message in caught.value.message
    assert caught.value.line is not None


def test_speed_of_the_references_is_read() -> None:
    operation = loaded(
        LINEAR.replace(
            "export:",
            "operation: {speed: 3000 rpm, modulation: spwm, voltage_margin: 5 %}\nexport:",
        )
    ).operation
    assert operation.omega_m == pytest.approx(100.0 * np.pi)
    assert (operation.modulation, operation.voltage_margin) == ("spwm", 0.05)


def test_linear_stays_the_default() -> None:
    assert isinstance(loaded(LINEAR).machine, LinearMachine)


def test_iron_loss_and_ac_resistance_are_read_as_measured() -> None:
    """150 W of hysteresis and 250 W of eddy currents at 400 Hz and 0.12 Wb; R 30 % up at 500 Hz,
    by hand.
    """
    text = LINEAR.replace(
        "  max_current",
        "  iron_loss: {frequency: 400 Hz, flux: 0.12 Wb, hysteresis: 150 W, eddy: 250 W}\n"
        "  ac_resistance: {ratio: 1.3, frequency: 500 Hz}\n  max_current",
    )
    loss = loaded(text).machine_loss
    omega = 2.0 * np.pi * np.array([400.0, 800.0, 500.0])
    np.testing.assert_allclose(
        loss.iron_factor(omega)[:2] * 0.12**2, [400.0, 150.0 * 2 + 250.0 * 4], rtol=1e-12
    )
    assert loss.copper_factor(omega)[2] == pytest.approx(1.3, rel=1e-12)
    assert loaded(LINEAR).machine_loss.iron_factor(omega)[0] == 0.0
    with pytest.raises(InputError, match="needs hysteresis or eddy"):
        loaded(text.replace(", hysteresis: 150 W, eddy: 250 W", ""))
    with pytest.raises(InputError, match="flux must be positive"):
        loaded(text.replace("0.12 Wb", "0 Wb"))


def test_magnet_loss_and_winding_heat_are_read() -> None:
    """50 W at 400 Hz and 100 A (peak); a winding whose resistance is given
    at 20 and used at 100 degC.
    """
    text = LINEAR.replace(
        "  max_current",
        "  magnet_loss: {loss: 50 W, frequency: 400 Hz, current: {value: 100 A, kind: peak}}\n"
        "  temperature: {winding: 100 degC, winding_thermal_resistance: 0.2 K/W, winding_coolant: "
        "65 degC}\n"
        "  max_current",
    )
    design = loaded(text)
    assert design.machine_loss.magnet * (2.0 * np.pi * 400.0 * 100.0) ** 2 == pytest.approx(50.0)
    heat = design.winding
    assert heat is not None
    assert (heat.thermal_resistance, heat.coolant_temperature, heat.reference_temperature) == (
        0.2,
        65.0,
        100.0,
    )
    # One straight line through both temperatures: R(150) over R(100) is the same from either end.
    line = (1.0 + 0.00393 * 130.0) / (1.0 + 0.00393 * 80.0)
    assert 1.0 + heat.coefficient * 50.0 == pytest.approx(line, rel=1e-12)
    assert loaded(LINEAR).winding is None


def test_known_magnet_flux_shows_the_scaling_of_a_map(tmp_path: Path) -> None:
    """A map in power-invariant units cannot be told from its own numbers,
    but from a constant of the data sheet.
    """
    path = written(
        tmp_path,
        MAPPED.replace("  flux_map:", "  magnet_flux: 0.12 Wb\n  flux_map:"),
        {"map.csv": TRUTH},
    )
    assert load_design(path).machine.psi_pm == pytest.approx(0.12, rel=1e-5)
    table = np.loadtxt(tmp_path / "map.csv", delimiter=",", skiprows=1) * np.sqrt(1.5)
    np.savetxt(
        tmp_path / "map.csv",
        table,
        delimiter=",",
        header="id_A,iq_A,psi_d_Vs,psi_q_Vs",
        comments="",
    )
    with pytest.raises(InputError, match="scaling: power-invariant") as caught:
        load_design(path)
    assert caught.value.line == 9
    scaled = path.read_text(encoding="utf-8").replace(
        "map.csv", "map.csv\n    scaling: power-invariant"
    )
    path.write_text(scaled, encoding="utf-8")
    assert load_design(path).machine.psi_pm == pytest.approx(0.12, rel=1e-5)


def test_constants_do_not_stand_beside_a_saturation_model() -> None:
    text = LINEAR.replace("  pole_pairs: 3", "  model: saturation\n  pole_pairs: 3")
    text = text.replace(
        "  inductance_d: 1.61 mH\n  inductance_q: 1.74 mH\n",
        (
            "  saturation: {a_d0: 17.4, a_dd: 373, s: 5, a_q0: 52.1, a_qq: 658, t: 1, a_dq: 1120, "
            "u: 1, v: 0}\n"
        ),
    )
    with pytest.raises(InputError, match="magnet_flux does not belong to the model 'saturation'"):
        loaded(text)


def test_a_map_is_scaled_by_its_factors(tmp_path: Path) -> None:
    scale = "  map_scale: {magnet: 1.1, inductance_q: 0.9, current: 105 %}\n"
    text = MAPPED.replace("  max_current", scale + "  max_current")
    plain = load_design(written(tmp_path, MAPPED, {"map.csv": TRUTH})).machine
    design = load_design(written(tmp_path, text, {"map.csv": TRUTH}))
    machine = design.machine
    assert isinstance(machine, SaturatedMachine)
    assert isinstance(plain, SaturatedMachine)
    assert machine.psi_pm == pytest.approx(1.05 * 1.1 * plain.psi_pm, rel=1e-12)
    assert machine.l_d == pytest.approx(plain.l_d, rel=1e-9)
    assert machine.l_q == pytest.approx(0.9 * plain.l_q, rel=1e-9)
    at = np.array([-40.0]), np.array([60.0])
    before = plain.flux(at[0] / 1.05, at[1] / 1.05)
    psi_d, psi_q = machine.flux(*at)
    assert psi_d == pytest.approx(1.05 * (before[0] + 0.1 * plain.psi_pm), rel=1e-12)
    assert psi_q == pytest.approx(1.05 * 0.9 * before[1], rel=1e-12)
    told = [text for text in design.assumptions if "map_scale" in text]
    assert told == [
        "the flux map is scaled (machine.map_scale): magnet 1.1, inductance_q 0.9, current 1.05"
    ]


def test_factors_of_1_leave_a_map_as_it_is(tmp_path: Path) -> None:
    text = MAPPED.replace("  max_current", "  map_scale: {magnet: 1}\n  max_current")
    one, other = (
        load_design(written(tmp_path, part, {"map.csv": TRUTH})).machine for part in (MAPPED, text)
    )
    assert isinstance(one, SaturatedMachine)
    assert isinstance(other, SaturatedMachine)
    assert one.flux_map.psi_d.tobytes() == other.flux_map.psi_d.tobytes()
    assert one.flux_map.psi_q.tobytes() == other.flux_map.psi_q.tobytes()


def test_a_scale_needs_a_map_that_covers_the_current(tmp_path: Path) -> None:
    text = LINEAR.replace("  max_current", "  map_scale: {magnet: 1.1}\n  max_current")
    with pytest.raises(InputError, match=r"9:3: machine.map_scale scales the flux map"):
        load_text(text.encode(), "linear.yaml")
    beyond = MAPPED.replace("  max_current", "  map_scale: {current: 0.8}\n  max_current")
    with pytest.raises(InputError, match="lies beyond the flux map, which ends at 96 A"):
        load_design(written(tmp_path, beyond, {"map.csv": TRUTH}))
    far = MAPPED.replace("  max_current", "  map_scale: {current: 0.1}\n  max_current")
    with pytest.raises(InputError, match=r"machine.map_scale.current"):
        load_design(written(tmp_path, far, {"map.csv": TRUTH}))
