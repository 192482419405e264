"""Columns that look like a torque are compared or refused, whatever they are called, in every
format; what nobody uses is named.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from flux_map_writers import Arrays, case_table, hdf5, mat, npz, text
from operating_tables import VENDOR

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.flux_points import check_torque
from dqforge.machines.flux_maps.map_files import read_flux_points

PAIRS = VENDOR.pole_pairs
I_D, I_Q = (
    part.ravel()
    for part in np.meshgrid(np.linspace(-120, 40, 6), np.linspace(0, 140, 6), indexing="ij")
)
PSI_D, PSI_Q = VENDOR.flux(I_D, I_Q)
TORQUE = 1.5 * PAIRS * (PSI_D * I_Q - PSI_Q * I_D)
# Names of a torque in N m of the whole machine.
NAMES = " ".join(
    (
        "torque Torque TORQUE tau tau_m tau_M tau_e tau_em tau_M_map T_e Te T_em Tem T_el",
        "Tmech T_mech T M Mi M_el T_shaft Tshaft T_avg Tavg T_mean mean_torque torque_avg",
        "Torque_Mean average_torque avgTorque T_dq T_airgap Drehmoment Drehmoment_Mittel",
        "Luftspaltmoment Wellenmoment M_mech moment couple Couple_moyen coppia Coppia_media",
        "koppel vridmoment vääntömomentti nyomaték moment_obrotowy kroutící_moment binário",
        "par par_motor tork dreiemoment ροπή момент 转矩 扭矩 トルク 토크 Electromagnetic_Torque",
        "electromagneticTorque shaft_torque Shaft_Torque torque_maxwell torque_nm",
        "maxwell_torque load_torque tau_L torque_measured T_meas TqAct trq Trq tq",
        "generated_torque torque_at_terminals Moment_an_der_Welle calibratedTorque",
    )
).split()

SYMBOLS = ("τ", "τ_m")
# Titles with units and what they make of a torque in N m.
TITLES = {
    "T [Nm]": 1.0,
    "T (N m)": 1.0,
    "T {Nm}": 1.0,
    "T <Nm>": 1.0,
    "T in Nm": 1.0,
    "T / Nm": 1.0,
    "T_Nm": 1.0,
    "M_Nm": 1.0,
    "tau [N·m]": 1.0,
    "tau (N⋅m)": 1.0,
    "Drehmoment [mNm]": 1e3,
    "Moving1.Torque [NewtonMeter]": 1.0,
    "mean(Moving1.Torque) [NewtonMeter]": 1.0,
    "Torque [kgf m]": 1.0 / 9.80665,
    "Torque [kgf·cm]": 100.0 / 9.80665,
    "Torque [in-lbf]": 1.0 / 0.1129848290276167,
    "tau_m [Nm/pp]": 1.0 / PAIRS,
    "tau per pole pair": 1.0 / PAIRS,
    "Drehmoment pro Polpaar [Nm]": 1.0 / PAIRS,
    "couple par paire de pôles [Nm]": 1.0 / PAIRS,
}

FORMATS: dict[str, tuple[Callable[[Arrays], bytes], str]] = {
    "text": (text, "map.csv"),
    "npz": (npz, "map.npz"),
    "hdf5": (hdf5, "map.h5"),
    "rows": (case_table, "cases.csv"),
    "mat": (mat, "map.mat"),
}


def with_torque(title: str, values: FloatArray = TORQUE) -> dict[str, FloatArray]:
    return {"id": I_D, "iq": I_Q, "psi_d": PSI_D, "psi_q": PSI_Q, title: values}


def judged(content: bytes, source: str, pole_pairs: int) -> str:
    """What is said of the torque in a file, '' where it is not compared."""
    try:
        points = read_flux_points(content, source)
        found = check_torque(points, pole_pairs, "peak")
    except InputError as error:
        return f"refused: {error}"
    return "" if found is None else "right"


@pytest.mark.parametrize("form", FORMATS)
def test_every_name_of_a_torque_is_compared_in_every_format(form: str) -> None:
    write, source = FORMATS[form]
    names = [*NAMES, *SYMBOLS]
    if form == "mat":
        names = [name for name in names if name.isascii()]
    for name in names:
        content = write(with_torque(name))
        assert judged(content, source, PAIRS) == "right", name
        assert judged(content, source, 3).startswith("refused: "), name


@pytest.mark.parametrize("form", ["text", "npz", "hdf5", "rows"])
def test_every_unit_of_a_torque_is_compared_in_every_format(form: str) -> None:
    write, source = FORMATS[form]
    for title, factor in TITLES.items():
        if form == "hdf5" and "/" in title:  # a slash is a group there
            continue
        content = write(with_torque(title, factor * TORQUE))
        assert judged(content, source, PAIRS) == "right", title
        twice = write(with_torque(title, 2.0 * factor * TORQUE))
        assert judged(twice, source, PAIRS).startswith("refused: "), title


@pytest.mark.parametrize(
    ("title", "phrase"),
    [
        ("Torque [Nm/m]", "torque per length"),
        ("T [Nm/mm]", "torque per length"),
        ("torque per unit length [Nm]", "torque per length"),
        ("Drehmoment je Meter [Nm]", "torque per length"),
        ("Torque [fortnights]", "unit 'fortnights'"),
    ],
)
def test_a_torque_of_an_unknown_unit_or_of_a_length_is_refused(title: str, phrase: str) -> None:
    with pytest.raises(InputError, match=phrase):
        read_flux_points(text(with_torque(title)), "map.csv")
    assert read_flux_points(text(with_torque(title)), "map.csv", torque="ignore").torque is None


@pytest.mark.parametrize(
    "title",
    [
        "time",
        "T [degC]",
        "moment of inertia",
        "Momentanwert",
        "couplers",
        "torque_ripple",
        "dTpp [Nm]",
        "Nenndrehmoment",
        "ratedTorque",
        "torque_max",
        "Rastmoment [Nm]",
        "cogging torque [Nm]",
        "M [H]",
        "torque angle [deg]",
        "torque sensor [V]",
    ],
)
def test_what_only_resembles_a_torque_is_named_as_not_used(title: str) -> None:
    points = read_flux_points(text(with_torque(title, np.arange(36.0))), "map.csv")
    assert points.torque is None
    if title != "T [degC]":  # a temperature of its own for each point is understood
        assert any(
            finding.startswith("not used of the file: ") and title.partition(" [")[0] in finding
            for finding in points.findings
        )


def test_of_two_torques_the_declared_one_is_compared() -> None:
    arrays = with_torque("Shaft_Torque", 0.95 * TORQUE - 0.3) | {"Electromagnetic_Torque": TORQUE}
    for declared, slope in (("air-gap", 1.0), ("shaft", 0.95)):
        points = read_flux_points(mat(arrays), "map.mat", torque=declared)  # type: ignore[arg-type]
        found = check_torque(points, PAIRS, "peak", declared)  # type: ignore[arg-type]
        assert found is not None
        assert found.slope == pytest.approx(slope, rel=1e-9)
    with pytest.raises(InputError, match="2 arrays may be torque"):
        read_flux_points(mat(with_torque("torque_1") | {"torque_2": 2.0 * TORQUE}), "map.mat")


def test_a_torque_per_pole_pair_of_the_file_needs_no_key_and_says_what_it_cannot_test() -> None:
    points = read_flux_points(text(with_torque("tau", TORQUE / PAIRS)), "map.csv")
    with pytest.raises(InputError, match="write torque: per-pole-pair"):
        build_flux_map(points, pole_pairs=PAIRS)
    found = build_flux_map(points, pole_pairs=3, torque="per-pole-pair").torque
    assert found is not None
    assert "does not depend on the number of pole pairs" in found.sentence


@pytest.mark.parametrize(
    ("name", "values", "declared", "refused"),
    [
        ("pole_pairs", 5.0, 5, False),
        ("n_p", 5.0, 3, True),
        ("Poles", 10.0, 5, False),
        ("number of poles", 10.0, 4, True),
        ("Polpaarzahl", 5.0, 4, True),
    ],
)
def test_pole_pairs_that_the_file_states_are_held_against_the_design(
    name: str, values: float, declared: int, refused: bool
) -> None:
    arrays = {k: v for k, v in with_torque("x").items() if k != "x"}
    for content, source in (
        (npz(arrays | {name: np.array(values)}), "map.npz"),
        (text(arrays | {name: np.full(36, values)}), "map.csv"),
    ):
        points = read_flux_points(content, source)
        if refused:
            with pytest.raises(InputError, match="the file states 5 pole pairs, the design has"):
                build_flux_map(points, pole_pairs=declared)
        else:
            build_flux_map(points, pole_pairs=declared)


# Keys that find nothing


def design(folder: Path, keys: str, arrays: Arrays) -> Path:
    (folder / "map.csv").write_bytes(text(arrays))
    path = folder / "design.yaml"
    path.write_text(f"""dqforge: 1
name: Mapped
machine:
  model: flux-map
  pole_pairs: 5
  resistance: 0.1 Ohm
  max_current: 100 A
  flux_map: {{file: map.csv{keys}}}
inverter: {{v_dc: 400 V, switching_frequency: 10 kHz}}
""")
    return path


PLAIN = {"id": I_D, "iq": I_Q, "psi_d": PSI_D, "psi_q": PSI_Q, "P_fe": np.arange(36.0)}


@pytest.mark.parametrize(
    ("keys", "arrays", "phrase"),
    [
        (", torque: shaft", PLAIN, "torque: map.csv holds no torque"),
        (", torque: air-gap", PLAIN, "torque: map.csv holds no torque"),
        (", torque: ignore", PLAIN, "torque: map.csv holds no torque"),
        (", torque: shaft", with_torque("T", np.full(36, 80.0)), "holds no torque"),
        (", columns: {torque: P_fe}", PLAIN, "times 3/2 p|exchanged"),
        (", columns: {psi_m: P_fe}", PLAIN, "psi_m is not part of the map"),
        (", columns: {beta: P_fe}", PLAIN, "no i found|is not part of the map"),
        (", columns: {frequency: P_fe}", PLAIN, "frequency is not part of the map"),
        (", resistance: 1 Ohm", PLAIN, "resistance belongs to operating points"),
    ],
)
def test_a_key_that_finds_nothing_is_refused(
    keys: str, arrays: Arrays, phrase: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=phrase):
        load_design(design(tmp_path, keys, arrays))


@pytest.mark.parametrize(
    ("keys", "arrays"),
    [
        ("", PLAIN),
        (", torque: ignore", with_torque("tau", 7.0 * TORQUE)),
        (", torque: air-gap", with_torque("tau")),
    ],
)
def test_a_key_that_finds_its_torque_is_heard(keys: str, arrays: Arrays, tmp_path: Path) -> None:
    remarks = load_design(design(tmp_path, keys, arrays)).assumptions
    assert any("not used of the file: P_fe" in remark for remark in remarks) == ("P_fe" in arrays)


def test_the_measured_map_with_its_torque_per_pole_pair_shows_wrong_pole_pairs(
    shared_data: Path,
) -> None:
    name = "baldor_ecs101m0h7ef4_400rpm_measured.csv"
    rows = np.loadtxt(shared_data / "fluxmaps" / name, delimiter=",", skiprows=1)[:, :4]
    i_d, i_q, psi_d, psi_q = rows.T
    arrays = dict(zip(("id_A", "iq_A", "psi_d_Vs", "psi_q_Vs"), rows.T, strict=True))
    torque = 3.0 * (psi_d * i_q - psi_q * i_d)
    for title in ("tau", "tau_m", "tau_M [Nm]"):
        content = text(arrays | {title: torque})
        assert judged(content, "map.csv", 2) == "right"
        assert "another number of pole pairs: write pole_pairs: 2" in judged(content, "map.csv", 3)
