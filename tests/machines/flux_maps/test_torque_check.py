"""Torque in flux-map files: real maps load with it as proof, and every wrong
declaration is refused by its cause.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from saturated import ArctanMachine

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.flux_points import FileTorque, FluxPoints, TorqueCheck, check_torque
from dqforge.machines.flux_maps.map_files import read_flux_points
from dqforge.machines.names import FluxTorque

MACHINE = ArctanMachine()
THOR, PM270 = "thor_dq_256.npz", "femag_pm270l8_psidq_losses_50rps.csv"
BALDOR, BALDOR_NPZ, FEMAG11 = (
    "baldor_ecs101m0h7ef4_400rpm_measured.csv",
    "baldor_400rpm_map.npz",
    "femag_test_11x11_p6.csv",
)
LIMITS = {THOR: "22 A", PM270: "150 A", BALDOR: "18 A", BALDOR_NPZ: "18 A", FEMAG11: "300 A"}
TRUE: dict[str, dict[str, Any]] = {
    THOR: {"pole_pairs": 2, "axes": "reluctance"},
    PM270: {"pole_pairs": 4},
    BALDOR: {"pole_pairs": 2},
    BALDOR_NPZ: {"pole_pairs": 2},
    FEMAG11: {"pole_pairs": 6},
}


def design_of(folder: Path, file: str, content: bytes, keys: Mapping[str, Any]) -> Design:
    """Design with one flux map, what is declared of it by ``keys``."""
    (folder / file).write_bytes(content)
    said = {**TRUE[file], **keys}
    pole_pairs = said.pop("pole_pairs")
    lines = "\n".join(f"      {key}: {value}" for key, value in said.items())
    text = f"""dqforge: 1
name: Map
machine:
    model: flux-map
    pole_pairs: {pole_pairs}
    resistance: 0.2 Ohm
    max_current: {LIMITS[file]}
    max_speed: 3000 rpm
    flux_map:
      file: {file}
{lines}
inverter:
    v_dc: 310 V
    switching_frequency: 10 kHz
"""
    return load_text(text.encode(), "design.yaml", folder)


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("file", "slope", "misfit"),
    [
        (THOR, 1.00004, 0.0003),
        (PM270, 0.999996, 0.00012),
        *((file, None, None) for file in (BALDOR, BALDOR_NPZ, FEMAG11)),
    ],
)
def test_real_maps_load_and_their_torque_is_the_proof(
    shared_data: Path, tmp_path: Path, file: str, slope: float | None, misfit: float | None
) -> None:
    design = design_of(tmp_path, file, (shared_data / "fluxmaps" / file).read_bytes(), {})
    values = {value.path: value.si for value in design.values}
    said = [
        sentence for sentence in design.assumptions if "3/2 p (psi_d i_q - psi_q i_d)" in sentence
    ]
    if slope is None or misfit is None:
        assert "machine.flux_map.torque_slope" not in values
        assert not said
        return
    assert values["machine.flux_map.torque_slope"] == pytest.approx(slope, abs=6e-6)
    assert values["machine.flux_map.torque_misfit"] == pytest.approx(misfit, rel=0.2)
    assert len(said) == 1
    assert f"is {values['machine.flux_map.torque_slope']:.5f} times" in said[0]


@dataclass(frozen=True)
class Wrong:
    """A wrong declaration of a real map: keys, or columns of its file multiplied or exchanged,
    and the cause named.
    """

    file: str
    cause: str
    keys: dict[str, Any] = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    swap: tuple[str, str] | None = None


SCALING = "another scaling|write scaling"
WRONG = [
    *[
        Wrong(file, SCALING, {"scaling": way})
        for file in (THOR, PM270)
        for way in ("rms", "power-invariant")
    ],
    *[Wrong(THOR, r"write pole_pairs: 2\b", {"pole_pairs": count}) for count in (1, 3, 4, 5, 6, 8)],
    *[
        Wrong(PM270, r"write pole_pairs: 4\b", {"pole_pairs": count})
        for count in (1, 2, 3, 5, 6, 8, 12)
    ],
    Wrong(THOR, "write axes: reluctance", {"axes": "magnet-d"}),
    *[
        Wrong(file, "write axes: magnet-d", {"axes": "reluctance"})
        for file in (PM270, BALDOR, BALDOR_NPZ, FEMAG11)
    ],
    *[
        Wrong(file, "A by .* but in mA by current_unit", {"current_unit": "mA"})
        for file in (PM270, BALDOR, FEMAG11)
    ],
    *[
        Wrong(file, "Vs by .* but in mWb by flux_unit", {"flux_unit": "mWb"})
        for file in (PM270, BALDOR, FEMAG11)
    ],
    Wrong(THOR, r"current_unit: kA \(A for mA\)", {"current_unit": "mA"}),
    Wrong(THOR, "current_unit", {"current_unit": "kA"}),
    Wrong(THOR, "0.001 times off|1000 times|flux_unit", {"flux_unit": "mWb"}),
    *[
        Wrong(file, "whole machine|torque: air-gap", {"torque": "per-pole-pair"})
        for file in (THOR, PM270)
    ],
    Wrong(THOR, SCALING, {"torque": "shaft", "scaling": "rms"}),
    Wrong(PM270, r"write pole_pairs: 4\b", {"torque": "shaft", "pole_pairs": 8}),
    *[Wrong(file, "are exchanged", swap=("id", "iq")) for file in (PM270, BALDOR, FEMAG11)],
    *[Wrong(file, "are exchanged", swap=("psi_d", "psi_q")) for file in (THOR, PM270, BALDOR)],
    *[Wrong(file, "the opposite sign", times={"T": -1.0}) for file in (THOR, PM270)],
    *[Wrong(file, "negate", times={"psi_q": -1.0}) for file in (THOR, PM270, BALDOR, FEMAG11)],
    *[Wrong(file, "negate", times={"id": -1.0}) for file in (THOR, PM270, BALDOR)],
    *[Wrong(file, "opposite sign", times={"iq": -1.0, "psi_q": -1.0}) for file in (PM270,)],
    *[
        Wrong(file, "r.m.s. and peak", times={"psi_d": 0.5**0.5, "psi_q": 0.5**0.5})
        for file in (THOR, PM270)
    ],
    *[
        Wrong(file, "line-to-line", times={"psi_d": 3.0**0.5, "psi_q": 3.0**0.5})
        for file in (THOR, PM270)
    ],
    *[Wrong(file, "1000 times off|0.001 times off", times={"T": 1e3}) for file in (THOR, PM270)],
    *[
        Wrong(file, "a torque per pole pair", times={"T": 1.0 / p})
        for file, p in ((THOR, 2), (PM270, 4))
    ],
    *[Wrong(file, "one 6th of the machine", times={"T": 1.0 / 6.0}) for file in (THOR, PM270)],
    Wrong(THOR, "misfit", {"columns": "{torque: dTpp}"}),
    Wrong(PM270, "unit 'W' .* write N m", {"columns": "{torque: P_magnet}"}),
]


def test_there_are_forty_wrong_declarations_and_more() -> None:
    assert len(WRONG) >= 40
    assert {wrong.file for wrong in WRONG} == set(TRUE)


def spoilt(content: bytes, wrong: Wrong) -> bytes:
    """File with columns multiplied or exchanged."""
    if wrong.file.endswith(".npz"):
        arrays: dict[str, NDArray[Any]] = dict(np.load(io.BytesIO(content)))
        for name, factor in wrong.times.items():
            arrays[name] = arrays[name] * factor
        if wrong.swap:
            one, other = wrong.swap
            arrays[one], arrays[other] = arrays[other], arrays[one]
        stream = io.BytesIO()
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        return stream.getvalue()
    header, *rows = content.decode().split()
    titles = header.split(",")
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    places = {re.sub("_(A|Vs|Nm|V|W)$", "", title): place for place, title in enumerate(titles)}
    for name, factor in wrong.times.items():
        table[:, places[name]] *= factor
    if wrong.swap:
        pair = [places[name] for name in wrong.swap]
        table[:, pair] = table[:, pair[::-1]]
    return "\n".join(
        [header, *(",".join(repr(float(cell)) for cell in row) for row in table)]
    ).encode()


@pytest.mark.thinned
@pytest.mark.parametrize(
    "wrong", WRONG, ids=lambda wrong: f"{wrong.file[:8]}-{wrong.keys or wrong.times or wrong.swap}"
)
def test_every_wrong_declaration_of_a_real_map_is_refused_by_its_cause(
    shared_data: Path, tmp_path: Path, wrong: Wrong
) -> None:
    content = (shared_data / "fluxmaps" / wrong.file).read_bytes()
    if wrong.times or wrong.swap:
        content = spoilt(content, wrong)
    with pytest.raises(InputError) as caught:
        design_of(tmp_path, wrong.file, content, wrong.keys)
    assert re.search(wrong.cause, str(caught.value)), str(caught.value)
    assert "\n" not in str(caught.value)


# Torques of a known machine, in every spelling and unit


def points_of(machine: ArctanMachine = MACHINE) -> FluxPoints:
    i_d, i_q = (
        part.ravel()
        for part in np.meshgrid(np.linspace(-150, 60, 8), np.linspace(0, 130, 7), indexing="ij")
    )
    psi_d, psi_q = machine.flux(i_d, i_q)
    return FluxPoints("map.csv", i_d, i_q, psi_d, psi_q)


def torque_of(points: FluxPoints, pole_pairs: int = 3) -> NDArray[np.float64]:
    return np.asarray(1.5 * pole_pairs * (points.psi_d * points.i_q - points.psi_q * points.i_d))


def compared(
    values: NDArray[np.float64], declared: FluxTorque = "air-gap", **more: Any
) -> TorqueCheck | None:
    points = replace(points_of(), torque=FileTorque("T", values, **more))
    return check_torque(points, 3, "peak", declared)


HEADINGS = {
    "T_Nm": 1.0,
    "Torque [Nm]": 1.0,
    "torque [mNm]": 1e3,
    "TORQUE (N.m)": 1.0,
    "T_em [N m]": 1.0,
    "Te": 1.0,
    "M [Nm]": 1.0,
    "Drehmoment in Nm": 1.0,
    "Moment": 1.0,
    "electromagnetic_torque": 1.0,
    "Electromagnetic Torque [kNm]": 1e-3,
    "avg(Moving1.Torque) [NewtonMeter]": 1.0,
    "Torque_lbf_ft [lbf ft]": 1.0 / 1.3558179483314004,
    "airgap torque [Ncm]": 100.0,
    "Torque per pole pair [Nm]": 1.0 / 3.0,
    "T [Nm per pole pair]": 1.0 / 3.0,
    "T": 1.0,
}


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("right", [True, False])
def test_every_spelling_of_the_torque_is_compared(heading: str, right: bool) -> None:
    points = points_of()
    values = torque_of(points) * HEADINGS[heading] * (1.0 if right else 2.0)
    rows = np.column_stack([points.i_d, points.i_q, points.psi_d, points.psi_q, values])
    text = "\n".join(
        [
            f"id [A];iq [A];psi_d [Wb];psi_q [Wb];{heading}",
            *(";".join(map(repr, r.tolist())) for r in rows),
        ]
    )
    read = read_flux_points(text.encode(), "map.csv")
    if not right:
        with pytest.raises(
            InputError, match=r"likely another scaling: write scaling: rms, or .*pole_pairs: 6"
        ):
            build_flux_map(read, pole_pairs=3)
        return
    found = build_flux_map(read, pole_pairs=3).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0, rel=1e-9)
    assert found.misfit == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    "name",
    [
        "torque_ripple",
        "dTpp_Nm",
        "Tpp [Nm]",
        "cogging torque [Nm]",
        "friction_torque",
        "t",
        "rated torque",
    ],
)
def test_other_torques_and_times_are_not_compared(name: str) -> None:
    points = points_of()
    rows = np.column_stack(
        [points.i_d, points.i_q, points.psi_d, points.psi_q, np.arange(points.i_d.size)]
    )
    text = "\n".join(
        [f"id,iq,psi_d,psi_q,{name}", *(",".join(map(repr, r.tolist())) for r in rows)]
    )
    assert read_flux_points(text.encode(), "map.csv").torque is None


@pytest.mark.parametrize("factor", [0.971, 1.0, 1.029])
def test_three_percent_pass(factor: float) -> None:
    found = compared(factor * torque_of(points_of()))
    assert found is not None
    assert found.slope == pytest.approx(factor)


@pytest.mark.parametrize("factor", [0.969, 1.031])
def test_more_than_three_percent_is_refused(factor: float) -> None:
    with pytest.raises(InputError, match=f"is {factor:.4g} times"):
        compared(factor * torque_of(points_of()))


def test_a_misfit_of_more_than_three_percent_is_refused_and_told() -> None:
    torque = torque_of(points_of())
    noise = np.random.default_rng(3).normal(size=torque.size)
    noise -= torque * np.sum(noise * torque) / np.sum(torque**2)
    noise *= np.sqrt(np.mean(torque**2) / np.mean(noise**2))
    found = compared(torque + 0.029 * noise)
    assert found is not None
    assert found.misfit == pytest.approx(0.029, rel=1e-3)
    with pytest.raises(InputError, match=r"misfit 3\.1 %"):
        compared(torque + 0.031 * noise)


def test_a_shaft_torque_may_lie_below_by_friction_and_iron_loss() -> None:
    torque = torque_of(points_of())
    shaft = 0.94 * torque - 2.0
    with pytest.raises(InputError, match="write torque: shaft"):
        compared(shaft)
    found = compared(shaft, "shaft")
    assert found is not None
    assert found.slope == pytest.approx(0.94)
    assert found.offset == pytest.approx(-2.0)
    assert "-2 N m at zero" in found.sentence
    for wrong in (0.5 * shaft, 1.5 * shaft, -shaft, 0.85 * torque, torque - 60.0):
        with pytest.raises(InputError):
            compared(wrong, "shaft")


def test_ignored_absent_and_constant_torques_are_not_compared() -> None:
    torque = torque_of(points_of())
    assert compared(7.0 * torque, "ignore") is None
    assert check_torque(points_of(), 3, "peak") is None
    assert compared(np.full(torque.size, np.nan)) is None
    assert compared(np.zeros(torque.size)) is None


def test_unknown_torques_are_left_out() -> None:
    torque = torque_of(points_of())
    torque[3:9] = np.nan
    found = compared(torque)
    assert found is not None
    assert found.points == torque.size - 6
