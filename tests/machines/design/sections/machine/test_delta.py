"""Windings in delta: converted to the equivalent star, against branch
equations of the delta.
"""

from __future__ import annotations

import math
from dataclasses import astuple, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError

FloatArray = NDArray[np.float64]
SQRT3 = math.sqrt(3.0)
# Of one winding of the delta: resistance, dq inductances, flux linkage of the magnets;
# 5 pole pairs.
R, L_D, L_Q, PSI, PAIRS = 0.9, 1.5e-3, 2.4e-3, 0.045, 5
SHIFTS = np.array([0.0, 2.0 * np.pi / 3.0, 4.0 * np.pi / 3.0])[:, np.newaxis]

DESIGN = """\
dqforge: 1
name: Delta machine
machine:
  connection: delta
  pole_pairs: 5
  resistance: 0.9 Ohm
  inductance_d: 1.5 mH
  inductance_q: 2.4 mH
  magnet_flux: 45 mWb
  max_current: {value: 12 A, kind: line peak}
  max_speed: 3000 rpm
inverter:
  v_dc: 300 V
  switching_frequency: 10 kHz
"""


def changed(*pairs: tuple[str, str], text: str = DESIGN) -> Design:
    """The design with some texts replaced."""
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return load_text(text.encode(), "f.yaml")


def linear(design: Design) -> LinearMachine:
    assert isinstance(design.machine, LinearMachine)
    return design.machine


def to_phases(d: float, q: float, theta: FloatArray) -> FloatArray:
    """Three phase quantities of a dq pair over the electrical angle, shape (3, N)."""
    return np.asarray(d * np.cos(theta - SHIFTS) - q * np.sin(theta - SHIFTS), dtype=np.float64)


def to_dq(phases: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    d = 2.0 / 3.0 * np.sum(phases * np.cos(theta - SHIFTS), axis=0)
    q = -2.0 / 3.0 * np.sum(phases * np.sin(theta - SHIFTS), axis=0)
    return np.asarray(d, dtype=np.float64), np.asarray(q, dtype=np.float64)


def test_the_star_has_the_voltages_currents_and_torque_of_the_delta() -> None:
    """Branch by branch: voltages R i + d psi/dt of three windings, currents of
    lines as their differences.
    """
    machine = linear(changed())
    omega_m, i_d, i_q = 80.0, -3.0, 4.0
    omega = PAIRS * omega_m
    theta = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)

    def winding_flux(angle: FloatArray) -> FloatArray:
        return to_phases(PSI + L_D * i_d, L_Q * i_q, angle)

    windings = to_phases(i_d, i_q, theta)  # ab, bc, ca
    step = 1e-5
    slope = (winding_flux(theta + step) - winding_flux(theta - step)) / (2.0 * step)
    voltages = R * windings + omega * slope
    lines = windings - np.roll(windings, 1, axis=0)  # i_a = i_ab - i_ca

    # The star counts its angle from phase a, 30 degrees behind the winding ab.
    of_star = theta - np.pi / 6.0
    d, q = to_dq(lines, of_star)
    psi_d, psi_q = machine.flux(d, q)
    star = np.array(
        [
            to_phases(float(v_d), float(v_q), np.array([angle]))[:, 0]
            for v_d, v_q, angle in zip(
                machine.r_s * d - omega * psi_q,
                machine.r_s * q + omega * psi_d,
                of_star,
                strict=True,
            )
        ]
    ).T
    np.testing.assert_allclose(star - np.roll(star, -1, axis=0), voltages, rtol=1e-8, atol=1e-7)

    # Torque from the power of the branches behind their resistances.
    shaft = np.sum((voltages - R * windings) * windings, axis=0) / omega_m
    np.testing.assert_allclose(machine.torque(d, q), shaft, rtol=1e-7)
    np.testing.assert_allclose(
        np.sum(machine.r_s * lines**2, axis=0), np.sum(R * windings**2, axis=0), rtol=1e-12
    )


# Line current of 12 A peak; back-EMF between terminals (peak) 5 * 0.045 = 0.225 V s/rad, and so of
# a winding; torque 3/2 * 5 * 0.045 = 0.3375 N m per ampere of a winding, over sqrt(3) per ampere of
# a line.
LINE_EMF = PAIRS * PSI
PER_WINDING = 1.5 * PAIRS * PSI
SPELLINGS = [
    ("resistance: 0.9 Ohm", "resistance: {value: 0.6 Ohm, kind: line-to-line}"),
    ("resistance: 0.9 Ohm", "resistance: {value: 0.9 Ohm, kind: phase}"),
    ("inductance_d: 1.5 mH", "inductance_d: {value: 1 mH, kind: line-to-line}"),
    ("inductance_q: 2.4 mH", "inductance_q: {value: 1.6 mH, kind: line-to-line}"),
    ("magnet_flux: 45 mWb", f"magnet_flux: {{value: {PSI / math.sqrt(2.0)}, kind: rms}}"),
    (
        "magnet_flux: 45 mWb",
        f"magnet_flux: {{value: {PSI * math.sqrt(1.5)}, kind: power-invariant}}",
    ),
    ("magnet_flux: 45 mWb", f"back_emf_constant: {{value: {LINE_EMF}, kind: line-to-line peak}}"),
    ("magnet_flux: 45 mWb", f"back_emf_constant: {{value: {LINE_EMF}, kind: phase peak}}"),
    (
        "magnet_flux: 45 mWb",
        f"back_emf_constant: {{value: {LINE_EMF / math.sqrt(2.0)}, kind: line-to-line rms}}",
    ),
    (
        "magnet_flux: 45 mWb",
        f"back_emf_constant: {{value: {LINE_EMF / math.sqrt(2.0)}, kind: phase rms}}",
    ),
    ("magnet_flux: 45 mWb", f"torque_constant: {{value: {PER_WINDING}, kind: winding peak}}"),
    (
        "magnet_flux: 45 mWb",
        f"torque_constant: {{value: {PER_WINDING * math.sqrt(2.0)}, kind: winding rms}}",
    ),
    ("magnet_flux: 45 mWb", f"torque_constant: {{value: {PER_WINDING / SQRT3}, kind: line peak}}"),
    (
        "magnet_flux: 45 mWb",
        f"torque_constant: {{value: {PER_WINDING / SQRT3 * math.sqrt(2.0)}, kind: line rms}}",
    ),
    ("{value: 12 A, kind: line peak}", f"{{value: {12.0 / SQRT3}, kind: winding peak}}"),
    ("{value: 12 A, kind: line peak}", f"{{value: {12.0 / math.sqrt(6.0)}, kind: winding rms}}"),
    ("{value: 12 A, kind: line peak}", f"{{value: {12.0 / math.sqrt(2.0)}, kind: line rms}}"),
]


@pytest.mark.parametrize(("old", "new"), SPELLINGS)
def test_every_convention_of_a_delta_is_the_same_machine(old: str, new: str) -> None:
    machine = linear(changed((old, new)))
    found = (machine.r_s, machine.l_d, machine.l_q, machine.psi_pm, machine.i_max)
    assert found == pytest.approx((0.3, 0.5e-3, 0.8e-3, PSI / SQRT3, 12.0), rel=1e-12)


def test_two_terminals_measure_two_windings_in_series_beside_one() -> None:
    """What an ohmmeter finds: R beside 2 R is 2/3 R, of which the star has half per phase."""
    between = 1.0 / (1.0 / R + 1.0 / (2.0 * R))
    machine = linear(
        changed(("resistance: 0.9 Ohm", f"resistance: {{value: {between}, kind: line-to-line}}"))
    )
    assert machine.r_s == pytest.approx(R / 3.0, rel=1e-12)


def test_losses_of_a_delta_are_those_of_its_windings() -> None:
    text = DESIGN.replace(
        "  max_speed:",
        "  iron_loss: {frequency: 200 Hz, flux: 45 mWb, eddy: 30 W}\n"
        "  magnet_loss: {loss: 4 W, frequency: 200 Hz, current: {value: 5 A, kind: winding peak}}\n"
        "  rated: {current: {value: 6 A, kind: winding peak}}\n  max_speed:",
    )
    delta = load_text(text.encode(), "f.yaml")
    star = load_text(
        text.replace("connection: delta", "connection: star")
        .replace("0.9 Ohm", "0.3 Ohm")
        .replace("1.5 mH", "0.5 mH")
        .replace("2.4 mH", "0.8 mH")
        .replace("magnet_flux: 45 mWb", f"magnet_flux: {PSI / SQRT3}")
        .replace("flux: 45 mWb, eddy", f"flux: {PSI / SQRT3}, eddy")
        .replace("value: 5 A", f"value: {5.0 * SQRT3}")  # line and winding are the same in a star
        .replace("value: 6 A", f"value: {6.0 * SQRT3}")
        .encode(),
        "f.yaml",
    )
    for a, b in zip(_numbers(delta.machine_loss), _numbers(star.machine_loss), strict=True):
        assert a == pytest.approx(b, rel=1e-12)
    assert linear(delta).psi_pm == pytest.approx(linear(star).psi_pm, rel=1e-12)


def _numbers(found: object) -> list[float]:
    assert is_dataclass(found)
    assert not isinstance(found, type)
    return [float(value) for value in astuple(found) if value is not None]


def test_rated_current_of_a_winding_is_held_against_the_limit_of_a_line() -> None:
    with pytest.raises(InputError, match=r"rated\.current is 13\.8\d+ A peak"):
        changed(
            ("  max_speed:", "  rated: {current: {value: 8 A, kind: winding peak}}\n  max_speed:")
        )


OPEN = [
    (("{value: 12 A, kind: line peak}", "12 A"), "kind: line peak} or kind: winding peak"),
    (
        ("{value: 12 A, kind: line peak}", "{value: 12 A, kind: rms}"),
        "kind: line rms} or kind: winding rms",
    ),
    (
        ("magnet_flux: 45 mWb", "torque_constant: {value: 0.3 N m/A, kind: rms}"),
        "kind: winding rms",
    ),
    (("  max_speed:", "  rated: {current: 5 A}\n  max_speed:"), "kind: winding peak"),
    (
        ("  max_speed:", "  magnet_loss: {loss: 4 W, frequency: 9 Hz, current: 5 A}\n  max_speed:"),
        "kind: winding peak",
    ),
]


@pytest.mark.parametrize(("pair", "phrase"), OPEN)
def test_a_current_that_may_be_of_lines_or_windings_is_refused(
    pair: tuple[str, str], phrase: str
) -> None:
    with pytest.raises(InputError) as caught:
        changed(pair)
    assert phrase in caught.value.message
    assert (caught.value.line or 0) > 1


def test_a_delta_with_any_shape_of_back_emf_is_refused_with_the_reason() -> None:
    waveform = (
        DESIGN.replace("inductance_d: 1.5 mH", "model: waveform")
        .replace("inductance_q: 2.4 mH", "self_inductance: 2 mH")
        .replace("magnet_flux: 45 mWb", "back_emf: {harmonics: [{order: 1, amplitude: 0.06 Wb}]}")
    )
    with pytest.raises(InputError, match="drive a current around the delta") as caught:
        load_text(waveform.encode(), "f.yaml")
    assert caught.value.line == 4
    published = """
  saturation: {a_d0: 1, a_dd: 1, s: 1, a_q0: 1, a_qq: 1, t: 1, a_dq: 1, u: 1, v: 0}
  model: saturation"""
    text = DESIGN.replace(
        "  inductance_d: 1.5 mH\n  inductance_q: 2.4 mH\n  magnet_flux: 45 mWb", published[1:]
    )
    with pytest.raises(InputError, match="published coefficients"):
        load_text(text.encode(), "f.yaml")


def test_what_was_converted_is_told() -> None:
    design = changed()
    notes = {value.path: value.note for value in design.values}
    assert "a third of the winding's value" in notes["machine.resistance"]
    assert "a third of the winding's value" in notes["machine.inductance_q"]
    assert "over sqrt(3)" in notes["machine.magnet_flux"]
    assert any("converted to the equivalent star" in text for text in design.assumptions)
    assert any("orders 3, 9, 15" in text for text in design.assumptions)
    star = changed(("  connection: delta\n", ""), ("{value: 12 A, kind: line peak}", "12 A"))
    assert not any("delta" in text for text in star.assumptions)


def _map(folder: Path, quantities: str) -> Path:
    """A design with a map of the machine above, in quantities of lines or of windings."""
    i_d, i_q = np.meshgrid(np.linspace(-15.0, 15.0, 11), np.linspace(0.0, 15.0, 6), indexing="ij")
    psi_d, psi_q = PSI / SQRT3 + 0.5e-3 * i_d, 0.8e-3 * i_q
    scale = SQRT3 if quantities == "winding" else 1.0
    columns = np.column_stack(
        [part.ravel() for part in (i_d / scale, i_q / scale, psi_d * scale, psi_q * scale)]
    )
    np.savetxt(
        folder / "map.csv",
        columns,
        delimiter=",",
        header="id_A,iq_A,psi_d_Vs,psi_q_Vs",
        comments="",
    )
    text = DESIGN.replace(
        "  inductance_d: 1.5 mH\n  inductance_q: 2.4 mH\n  magnet_flux: 45 mWb\n",
        (
            "  model: flux-map\n"
            f"  flux_map: {{file: map.csv{', quantities: ' + quantities if quantities else ''}}}\n"
        ),
    )
    path = folder / f"{quantities or 'open'}.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("quantities", ["line", "winding"])
def test_flux_maps_of_lines_and_of_windings(tmp_path: Path, quantities: str) -> None:
    machine = load_design(_map(tmp_path, quantities)).machine
    assert isinstance(machine, SaturatedMachine)
    i_d, i_q = np.array([-6.0, 0.0, 3.0]), np.array([8.0, 11.0, 1.0])
    psi_d, psi_q = machine.flux(i_d, i_q)
    np.testing.assert_allclose(psi_d, PSI / SQRT3 + 0.5e-3 * i_d, rtol=1e-9)
    np.testing.assert_allclose(psi_q, 0.8e-3 * i_q, rtol=1e-9)


def test_a_map_of_a_delta_says_what_it_holds(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"quantities: winding .* quantities: line"):
        load_design(_map(tmp_path, ""))
    path = _map(tmp_path, "winding")
    path.write_text(path.read_text().replace("connection: delta", "connection: star"))
    with pytest.raises(InputError, match="windings in delta"):
        load_design(path)
