"""Tables of operating points come back as the machine that made them, in every layout and unit;
pole pairs, speeds and losses are held against each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from flux_map_writers import hdf5, mat, npz, text
from operating_tables import VENDOR, OperatingTable, operating_table

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.coordinates import Declared
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.map_files import read_flux_points

TABLE = operating_table(speeds=13, shares=9)
PAIRS = VENDOR.pole_pairs
KNOWN = Declared(PAIRS, VENDOR.r_s)
RPM, ROOT = 30.0 / math.pi, math.sqrt(2.0)
Arrays = dict[str, FloatArray]


def laboratory(table: OperatingTable = TABLE) -> Arrays:
    """What Motor-CAD's laboratory saves: matrices over speed and share of the current."""
    size, volts = np.hypot(table.i_d, table.i_q), np.hypot(table.v_d, table.v_q)
    both = {"Id": table.i_d, "Iq": table.i_q, "Vd": table.v_d, "Vq": table.v_q}
    both |= {"Stator_Current_Phase": size, "Voltage_Phase": volts}
    arrays = {f"{name}_Peak": values for name, values in both.items()}
    arrays |= {f"{name}_RMS": values / ROOT for name, values in both.items()}
    friction = np.divide(table.iron, table.speed, out=np.zeros(size.shape), where=table.speed > 0)
    return arrays | {
        "Speed": table.speed * RPM,
        "Frequency": table.speed * PAIRS / (2.0 * math.pi),
        "Shaft_Torque": table.torque - friction,
        "Electromagnetic_Torque": table.torque,
        "Total_Loss": table.copper + table.iron,
        "Stator_Copper_Loss": table.copper,
        "Iron_Loss": table.iron,
        "Power_Factor": np.ones(size.shape),
    }


def bench(table: OperatingTable = TABLE) -> Arrays:
    """A bench's columns with units, r.m.s. values, without a resistance."""
    power = table.torque * table.speed
    share = np.divide(power, power + table.copper + table.iron, out=0.0 * power, where=power > 0)
    return {
        "n [rpm]": (table.speed * RPM).ravel(),
        "Id_rms [A]": (table.i_d / ROOT).ravel(),
        "Iq_rms [A]": (table.i_q / ROOT).ravel(),
        "Ud_rms [V]": (table.v_d / ROOT).ravel(),
        "Uq_rms [V]": (table.v_q / ROOT).ravel(),
        "Drehmoment [Nm]": table.torque.ravel(),
        "eta [%]": 100.0 * share.ravel(),
        "temperature [degC]": np.full(share.size, 80.0),
    }


def polar(table: OperatingTable = TABLE) -> Arrays:
    """Amplitude and angle, frequency in rad/s, resistance in the file, millivolts."""
    return {
        "Is [A]": np.hypot(table.i_d, table.i_q).ravel(),
        "beta [deg]": np.degrees(np.arctan2(table.i_q, table.i_d)).ravel(),
        "u_d [mV]": 1e3 * table.v_d.ravel(),
        "u_q [mV]": 1e3 * table.v_q.ravel(),
        "omega_e [rad/s]": PAIRS * table.speed.ravel(),
        "Rs [mOhm]": np.full(table.speed.size, 1e3 * VENDOR.r_s),
        "T [Nm]": table.torque.ravel(),
    }


def one_speed() -> Arrays:
    """A grid over both currents as axes, at one speed, which is a single number."""
    i_d, i_q = np.linspace(-75.0, 0.0, 9), np.linspace(0.0, 140.0, 8)
    mesh_d, mesh_q = np.meshgrid(i_d, i_q, indexing="ij")
    psi_d, psi_q = VENDOR.flux(mesh_d, mesh_q)
    omega = PAIRS * 400.0 / RPM
    return {
        "id": i_d,
        "iq": i_q,
        "v_d": VENDOR.r_s * mesh_d - omega * psi_q,
        "v_q": VENDOR.r_s * mesh_q + omega * psi_d,
        "n_rpm": np.array(400.0),
        "tau_m": 1.5 * PAIRS * (psi_d * mesh_q - psi_q * mesh_d),
    }


LAYOUTS: dict[str, tuple[bytes, str, Declared, float]] = {
    "laboratory": (mat(laboratory()), "map.mat", Declared(PAIRS), 1.0),
    "laboratory, npz": (npz(laboratory()), "map.npz", Declared(PAIRS), 1.0),
    "laboratory, without pole pairs": (mat(laboratory()), "map.mat", Declared(), 1.0),
    "bench": (text(bench()), "bench.csv", KNOWN, ROOT),
    "bench, tabs": (text(bench(), "\t"), "bench.txt", KNOWN, ROOT),
    "polar": (text(polar()), "polar.csv", Declared(), 1.0),
    "one speed": (npz(one_speed()), "map.npz", KNOWN, 1.0),
    "one speed, mat": (mat(one_speed()), "map.mat", KNOWN, 1.0),
}


def is_the_machine(points: FluxPoints, factor: float) -> None:
    psi_d, psi_q = VENDOR.flux(points.i_d * factor, points.i_q * factor)
    np.testing.assert_allclose(points.psi_d * factor, psi_d, atol=1e-9)
    np.testing.assert_allclose(points.psi_q * factor, psi_q, atol=1e-9)


@pytest.mark.parametrize("name", LAYOUTS)
def test_voltages_and_speed_make_the_flux_linkages_of_the_machine(name: str) -> None:
    content, source, declared, factor = LAYOUTS[name]
    points = read_flux_points(content, source, declared=declared)
    is_the_machine(points, factor)
    assert points.i_d.size >= 72
    assert points.claimed == ("rms" if factor > 1.0 else "peak" if "laboratory" in name else "")
    assert any("follow from voltages and speed" in finding for finding in points.findings)
    found = build_flux_map(points, pole_pairs=PAIRS)
    assert found.torque is not None
    assert found.torque.slope == pytest.approx(1.0, rel=1e-9)
    probe_d, probe_q = np.array([-5.0, -30.0, -50.0]), np.array([140.0, 125.0, 130.0])
    np.testing.assert_allclose(
        np.stack(found.flux_map.flux(probe_d, probe_q)), VENDOR.flux(probe_d, probe_q), atol=3e-4
    )


def test_hdf5_holds_operating_points_too() -> None:
    is_the_machine(read_flux_points(hdf5(laboratory()), "map.h5", declared=Declared(PAIRS)), 1.0)


def changed(change: Mapping[str, Any], *without: str) -> Arrays:
    return {k: v for k, v in (laboratory() | dict(change)).items() if k not in without}


SPEED = laboratory()["Speed"]
FREQUENCY = laboratory()["Frequency"]


@pytest.mark.parametrize(
    ("arrays", "declared", "phrase"),
    [
        (laboratory(), Declared(3), r"make .*5 \(speed in rpm\) pole pairs, the design has 3"),
        (changed({"Speed": SPEED * 1.1}), Declared(5), "4.545 .*the design has 5"),
        (changed({"Speed": SPEED * 1.1}), Declared(), "no whole number"),
        (changed({}, "Speed", "Frequency"), Declared(5), "without a speed make no flux linkages"),
        (changed({}, "Stator_Copper_Loss"), Declared(5), "resistance: 0.12 Ohm"),
        (changed({}, "Frequency"), Declared(), "need the pole pairs"),
        (
            changed({}, "Frequency", "Shaft_Torque", "Electromagnetic_Torque"),
            Declared(5),
            "has no unit; write it into the name",
        ),
        (changed({"Speed": 0.0 * SPEED, "Frequency": 0.0 * SPEED}), Declared(5), "turns"),
        (changed({"Vq_Peak": SPEED[:4]}), Declared(5), "shape"),
    ],
)
def test_what_contradicts_itself_or_is_missing_is_refused(
    arrays: Arrays, declared: Declared, phrase: str
) -> None:
    with pytest.raises(InputError, match=phrase) as caught:
        read_flux_points(mat(arrays), "map.mat", declared=declared)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("speed", "unit"), [(SPEED, "rpm"), (SPEED / RPM, "rad/s")])
@pytest.mark.parametrize("beside", ["Frequency", "Electromagnetic_Torque"])
def test_the_unit_of_a_speed_is_told_by_what_stands_beside(
    speed: FloatArray, unit: str, beside: str
) -> None:
    others = {"Frequency", "Shaft_Torque", "Electromagnetic_Torque"} - {beside}
    points = read_flux_points(
        mat(changed({"Speed": speed}, *others)), "map.mat", declared=Declared(PAIRS)
    )
    is_the_machine(points, 1.0)
    if beside != "Frequency":
        assert any(f"the speed is in {unit}" in finding for finding in points.findings)
        assert any("nothing in the file tests that number" in f for f in points.findings)


@pytest.mark.parametrize("spoil", ["pole pairs", "rms", "mV", "sign"])
def test_the_torque_finds_wrong_units_of_operating_points(spoil: str) -> None:
    arrays = bench()
    if spoil == "rms":
        arrays = {k.replace("_rms", ""): v for k, v in arrays.items()}
    if spoil == "mV":
        arrays = {k.replace("[V]", "[mV]"): v for k, v in arrays.items()}
    if spoil == "sign":
        arrays["Ud_rms [V]"] = -arrays["Ud_rms [V]"]
    declared = Declared(3 if spoil == "pole pairs" else PAIRS, VENDOR.r_s)
    points = read_flux_points(text(arrays), "bench.csv", declared=declared)
    if spoil == "pole pairs":  # p cancels in the torque; the file says that nothing tests it
        assert any("nothing in the file tests that number" in f for f in points.findings)
        return
    with pytest.raises(InputError):
        build_flux_map(points, pole_pairs=PAIRS)


def test_a_table_of_several_temperatures_or_of_drifting_points_is_refused() -> None:
    hot = laboratory()
    hot["Vq_Peak"] = hot["Vq_Peak"] - 0.15 * PAIRS * TABLE.speed * TABLE.psi_d
    arrays = {name: np.concatenate([values, hot[name]]) for name, values in laboratory().items()}
    points = read_flux_points(mat(arrays), "map.mat", declared=Declared(PAIRS))
    with pytest.raises(InputError, match="more than scatter"):
        build_flux_map(points)
    rows = TABLE.speed.shape[0]
    arrays["Magnet_Temperature_degC"] = (
        np.repeat([80.0, 120.0], rows)[:, np.newaxis] + 0.0 * (arrays["Speed"])
    )
    with pytest.raises(InputError, match=r"2 values of the temperature \(80 degC, 120 degC\)"):
        read_flux_points(mat(arrays), "map.mat", declared=Declared(PAIRS))
    points = read_flux_points(
        mat(arrays), "map.mat", declared=Declared(PAIRS), at={"temperature": 80.0}
    )
    is_the_machine(points, 1.0)


@pytest.mark.parametrize(
    ("content", "source", "declared", "factor"),
    [
        (mat(laboratory()), "map.mat", Declared(PAIRS), 1.0),
        (text(bench()), "bench.csv", KNOWN, ROOT),
    ],
)
def test_the_loss_of_a_file_is_copper_and_iron(
    content: bytes, source: str, declared: Declared, factor: float
) -> None:
    """A total in W, or an efficiency: both make the loss that the table was made with."""
    points = read_flux_points(content, source, declared=declared)
    assert points.loss is not None
    moving = TABLE.speed >= 0.05 * np.max(TABLE.speed)
    expected = (TABLE.copper + TABLE.iron)[moving]
    known = np.isfinite(points.loss.values)
    assert known.sum() >= 0.8 * known.size
    np.testing.assert_allclose(points.loss.values[known], expected[known], rtol=1e-9)
    assert not any("Total_Loss" in f or "eta" in f for f in points.findings if "not used" in f)


def damaged(arrays: Arrays, generator: np.random.Generator) -> Arrays:
    """Arrays of which up to three are lost, turned, cut, made senseless or of another shape."""
    changes = (
        lambda v: v.T,
        lambda v: 0.0 * v,
        lambda v: v.ravel()[: max(1, v.size // 2)],
        lambda v: np.where(np.arange(v.size).reshape(v.shape) % 5 == 0, np.nan, v),
        lambda v: np.full(v.shape, np.nan),
        lambda v: np.array(v.flat[0]),
        lambda v: 1e150 * v,
        lambda v: v[..., np.newaxis] * np.ones(3),
    )
    kept = dict(arrays)
    for name in generator.choice(list(kept), size=int(generator.integers(1, 4)), replace=False):
        choice = int(generator.integers(0, len(changes) + 1))
        if choice == len(changes):
            del kept[name]
        else:
            kept[name] = changes[choice](kept[name])
    return kept


def complaint(content: bytes) -> str:
    """What is said of a file, '' where it is read."""
    try:
        read_flux_points(content, "map.npz", declared=KNOWN)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("write", [laboratory, one_speed])
def test_damaged_tables_are_read_or_refused_in_one_line(write: Callable[[], Arrays]) -> None:
    generator, arrays = np.random.default_rng(4), write()
    said = [complaint(npz(damaged(arrays, generator))) for _ in range(60)]
    assert not any("\n" in each for each in said)
    assert 15 < sum(map(bool, said)) < 60
