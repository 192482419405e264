"""Layouts that tools write flux maps in: each is written from a known machine and
comes back as that machine.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pytest
from saturated import ArctanMachine
from scipy.io import savemat

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray
from dqforge.machines.flux_maps.building import FluxMapReading, build_flux_map
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.map_files import read_flux_points
from dqforge.machines.flux_maps.map_names import choose

MACHINE = ArctanMachine()
PAIRS = MACHINE.pole_pairs
AXIS_D, AXIS_Q = np.linspace(-150.0, 60.0, 8), np.linspace(0.0, 130.0, 7)
ANGLES = np.arange(0.0, 60.0, 4.0)
MESH_D, MESH_Q = np.meshgrid(AXIS_D, AXIS_Q, indexing="ij")
PSI_D, PSI_Q = MACHINE.flux(MESH_D, MESH_Q)
TORQUE = 1.5 * PAIRS * (PSI_D * MESH_Q - PSI_Q * MESH_D)
# Shape of the ripple over the angle in degrees, over one whole period.
WAVE = np.sin(np.radians(6.0 * ANGLES))
Cells = Sequence[Sequence[object]]


def resolved(values: FloatArray, ripple: float) -> FloatArray:
    """Values (M, N) over the angle too, (M, N, K), with a ripple that its mean does not show."""
    return np.asarray(values[:, :, np.newaxis] + ripple * WAVE)


def with_end(values: FloatArray) -> FloatArray:
    """Values over the angle with the first one again at the end of the period."""
    return np.concatenate([values, values[:, :, :1]], axis=2)


def is_the_machine(points: FluxPoints, factor: float = 1.0, digits: float = 1e-9) -> None:
    """Every point lies on the machine, and all of the grid are there."""
    np.testing.assert_allclose(
        np.unique(np.round(points.i_d * factor, 3)), np.round(AXIS_D, 3), atol=2e-3
    )
    np.testing.assert_allclose(
        np.unique(np.round(points.i_q * factor, 3)), np.round(AXIS_Q, 3), atol=2e-3
    )
    assert points.i_d.size == MESH_D.size
    psi_d, psi_q = MACHINE.flux(points.i_d * factor, points.i_q * factor)
    np.testing.assert_allclose(points.psi_d * factor, psi_d, atol=digits)
    np.testing.assert_allclose(points.psi_q * factor, psi_q, atol=digits)


def built(content: bytes, source: str, **options: Any) -> FluxMapReading:
    """Map of a file with its torque compared, where it has any."""
    return build_flux_map(read_flux_points(content, source, **options), pole_pairs=PAIRS)


def text_of(rows: Cells, mark: str = ",") -> bytes:
    return "\n".join(mark.join(str(cell) for cell in row) for row in rows).encode()


def column(number: int) -> str:
    """Letters of a zero-based column of a spreadsheet."""
    return (column(number // 26 - 1) if number >= 26 else "") + chr(65 + number % 26)


def workbook(sheets: Mapping[str, Cells], extra: str = "") -> bytes:
    """A minimal .xlsx by ECMA-376, with numbers and inline texts."""
    kinds = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    packages = "http://schemas.openxmlformats.org/package/2006"
    listing = "".join(
        f'<sheet name="{escape(name)}" sheetId="{k}" r:id="rId{k}"/>'
        for k, name in enumerate(sheets, 1)
    )
    links = "".join(
        f'<Relationship Id="rId{k}" Type="{kinds}/worksheet" Target="worksheets/sheet{k}.xml"/>'
        for k in range(1, len(sheets) + 1)
    )
    overrides = "".join(
        f'<Override PartName="/xl/worksheets/sheet{k}.xml" '
        'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"/>'
        for k in range(1, len(sheets) + 1)
    )
    parts = {
        (
            "[Content_Types].xml"
        ): f'<Types xmlns="{packages}/content-types"><Default Extension="rels" ContentType='
        '"application/vnd.openxmlformats-package.relationships+xml"/><Override PartName="/xl/workbook.xml" ContentType='
        f'"application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/>{overrides}</Types>',
        "_rels/.rels": (
            f'<Relationships xmlns="{packages}/relationships"><Relationship Id="rId1" Type="{kinds}'
            '/officeDocument" Target="xl/workbook.xml"/></Relationships>'
        ),
        "xl/workbook.xml": (
            f'<workbook {main} xmlns:r="{kinds}"><sheets>{listing}</sheets></workbook>'
        ),
        "xl/_rels/workbook.xml.rels": (
            f'<Relationships xmlns="{packages}/relationships">{links}</Relationships>'
        ),
    }
    for k, rows in enumerate(sheets.values(), 1):
        body = ""
        for r, row in enumerate(rows, 1):
            cells = ""
            for c, cell in enumerate(row):
                if isinstance(cell, str):
                    cells += (
                        f'<c r="{column(c)}{r}" t="inlineStr"><is><t>{escape(cell)}</t></is></c>'
                    )
                else:
                    cells += f'<c r="{column(c)}{r}"><v>{cell!r}</v></c>'
            body += f'<row r="{r}">{cells}</row>'
        parts[f"xl/worksheets/sheet{k}.xml"] = (
            f"<worksheet {main}><sheetData>{body}{extra}</sheetData></worksheet>"
        )
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>' + part)
    return stream.getvalue()


def mat(arrays: Mapping[str, Any]) -> bytes:
    stream = io.BytesIO()
    savemat(stream, dict(arrays))
    return stream.getvalue()


def columns_of(*arrays: FloatArray) -> list[list[float]]:
    return [
        [float(cell) for cell in row]
        for row in np.column_stack([array.ravel() for array in arrays])
    ]


# Spreadsheets

MATHWORKS: Cells = [
    ["id", "iq", "fluxD", "fluxQ", "torque"],
    ["A", "A", "Wb", "Wb", "N*m"],
    *columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q, TORQUE),
]


def test_a_table_of_a_workbook_with_units_in_its_second_row() -> None:
    points = read_flux_points(workbook({"Sheet1": MATHWORKS}), "PMSM.xlsx")
    is_the_machine(points)
    found = build_flux_map(points, pole_pairs=PAIRS)
    assert found.torque is not None
    assert found.torque.slope == pytest.approx(1.0)


def test_units_of_a_workbook_scale_and_notes_beside_are_passed_over() -> None:
    rows = [["PMSM 150 kW"], [], ["id", "iq", "Fd", "Fq"], ["A", "A", "mWb", "mWb"]]
    content = workbook(
        {
            "Data": [*rows, *columns_of(MESH_D, MESH_Q, 1e3 * PSI_D, 1e3 * PSI_Q)],
            "Notes": [["none"]],
        }
    )
    is_the_machine(read_flux_points(content, "PMSM.xlsx"))


def matrix(values: FloatArray, corner: str = "iq \\ id") -> list[list[object]]:
    """Rows of a matrix file: i_d across, i_q down."""
    return [
        [corner, *AXIS_D.tolist()],
        *[[q, *row] for q, row in zip(AXIS_Q.tolist(), values.T.tolist(), strict=True)],
    ]


def test_one_sheet_per_flux_linkage() -> None:
    is_the_machine(
        read_flux_points(workbook({"psi_d": matrix(PSI_D), "psi_q": matrix(PSI_Q)}), "map.xlsx")
    )


def test_a_workbook_that_claims_a_huge_sheet_is_refused_before_it_is_laid_out() -> None:
    far = '<row r="1048576"><c r="XFD1048576"><v>1</v></c></row>'
    with pytest.raises(InputError, match="1048576 rows and 16384 columns"):
        read_flux_points(workbook({"Sheet1": MATHWORKS}, far), "map.xlsx")
    bomb = io.BytesIO(workbook({"Sheet1": MATHWORKS}))
    with zipfile.ZipFile(bomb, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/media/image1.png", bytes(64_000_001))
    assert len(bomb.getvalue()) < 100_000
    with pytest.raises(InputError, match="more than 64 MB once unpacked"):
        read_flux_points(bomb.getvalue(), "map.xlsx")


def test_damaged_workbooks_are_refused_in_one_line() -> None:
    content = workbook({"Sheet1": MATHWORKS})
    for size in range(4, len(content), len(content) // 12):
        with pytest.raises(InputError) as caught:
            read_flux_points(content[:size], "map.xlsx")
        assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match="no sheet holds numbers"):
        read_flux_points(workbook({"Sheet1": [["a", "b"]]}), "map.xlsx")


# Maps over the rotor angle

RIPPLE_FLUX, RIPPLE_TORQUE = 1.5e-3, 2.0


def angle_resolved() -> dict[str, Any]:
    psi_d, psi_q = resolved(PSI_D, RIPPLE_FLUX), resolved(PSI_Q, -RIPPLE_FLUX)
    return {"fluxD": psi_d, "fluxQ": psi_q, "torque": resolved(TORQUE, RIPPLE_TORQUE)}


def simscape() -> dict[str, Any]:
    return {"idVec": AXIS_D, "iqVec": AXIS_Q, "angleVec": ANGLES, **angle_resolved()}


def closed() -> dict[str, Any]:
    ends = {name: with_end(values) for name, values in angle_resolved().items()}
    return {"idVec": AXIS_D, "iqVec": AXIS_Q, "theta": np.append(ANGLES, 60.0), **ends}


def turned() -> dict[str, Any]:
    first = {name: np.moveaxis(values, 2, 0) for name, values in angle_resolved().items()}
    return {"iD": AXIS_D, "iQ": AXIS_Q, "theta_deg": ANGLES, **first}


def motor_cad() -> dict[str, Any]:
    names = zip(("D", "Q"), ("fluxD", "fluxQ"), strict=True)
    arrays = angle_resolved()
    over = np.broadcast_to(ANGLES, arrays["fluxD"].shape)
    maps = {f"Angular_Flux_Linkage_{axis}": arrays[name] for axis, name in names}
    maps |= {
        "Id_Peak": MESH_D,
        "Iq_Peak": MESH_Q,
        "Id_RMS": MESH_D / 2**0.5,
        "Iq_RMS": MESH_Q / 2**0.5,
    }
    return maps | {
        "Angular_Rotor_Position": over,
        "Angular_Electromagnetic_Torque": arrays["torque"],
    }


@pytest.mark.parametrize("write", [simscape, closed, turned, motor_cad])
def test_maps_over_the_angle_are_averaged_and_their_ripple_told(
    write: Callable[[], dict[str, Any]],
) -> None:
    points = read_flux_points(mat(write()), "map.mat")
    is_the_machine(points)
    sentence = next(finding for finding in points.findings if "rotor angles" in finding)
    top = float(np.max(WAVE) - np.min(WAVE))
    assert (
        f"by up to {1e3 * RIPPLE_FLUX * top:.3g} mWb, the torque by up to "
        f"{RIPPLE_TORQUE * top:.3g} N m"
    ) in sentence
    found = build_flux_map(points, pole_pairs=PAIRS).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0, rel=1e-9)


def test_a_third_dimension_without_a_name_is_asked_for() -> None:
    arrays = simscape() | {"x": ANGLES}
    del arrays["angleVec"]
    with pytest.raises(InputError, match=r"psi_d \(8, 7, 15\).*columns: {angle: NAME}"):
        read_flux_points(mat(arrays), "map.mat")
    is_the_machine(read_flux_points(mat(arrays), "map.mat", columns={"angle": "x"}))


def twin_builder() -> bytes:
    """What the Twin Builder export of Motor-CAD writes: torque against the motion,
    both ends of the period.
    """
    angles = np.append(ANGLES, 60.0)
    ends = {name: with_end(values) for name, values in angle_resolved().items()}
    rows = zip(*(ends[name].ravel() for name in ("fluxD", "fluxQ", "torque")), strict=True)
    body = "".join(
        f"{k:10d} {d:19.10e} {q:19.10e} {0.0:19.10e} {-t:19.10e}\r\n"
        for k, (d, q, t) in enumerate(rows)
    )
    axes = [
        f"({len(axis)} :" + "".join(f"  {value:g}" for value in axis) + ")"
        for axis in (AXIS_D, AXIS_Q, angles)
    ]
    return (
        f"B_BasicData\r\n  Version   1.0\r\n  Poles {2 * PAIRS}\r\nE_BasicData\r\n\r\n"
        "B_PhaseImp 3\r\n"
        "    WG_Ph1 5.0000000000e-02      0.0000000000e+00\r\nE_PhaseImp\r\n\r\nB_Sweepings\r\n\r\n"
        f"  Id_Iq     {axes[0]}\n            {axes[1]}\n  Rotate    {axes[2]}\nE_Sweepings\n\n"
        f"B_OutputMatrix DQ0\n{body}E_OutputMatrix\n"
    ).encode()


def test_the_circuit_for_twin_builder() -> None:
    points = read_flux_points(twin_builder(), "ece.txt")
    is_the_machine(points, digits=1e-6)
    found = build_flux_map(points, pole_pairs=PAIRS).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0, rel=1e-6)
    assert any("averaged over 16 rotor angles" in finding for finding in points.findings)


@pytest.mark.parametrize(
    ("old", "new", "phrase"),
    [
        ("E_OutputMatrix", "", "not closed by E_OutputMatrix"),
        ("(8 :", "(9 :", "an axis of 9 values has 8"),
        ("\r\n         7 ", "\r\n ", "this row has 4 numbers"),
        ("         5 ", "E_OutputMatrix ", "5 rows|not 5|points"),
    ],
)
def test_damaged_circuits_are_refused(old: str, new: str, phrase: str) -> None:
    with pytest.raises(InputError, match=phrase):
        read_flux_points(twin_builder().decode().replace(old, new, 1).encode(), "ece.txt")


# Names that tools give


@pytest.mark.parametrize(
    "names",
    [
        "imd imq Psid Psiq",
        "Id_Peak Iq_Peak Flux_Linkage_D Flux_Linkage_Q",
        "Id[A] Iq[A] avg(FluxD)[Wb] avg(FluxQ)[Wb]",
        "i_d_pk i_q_pk psi_d_pk psi_q_pk",
        "Curr_Id Curr_Iq Psi_d Psi_q",
    ],
)
def test_names_of_tools_are_recognised(names: str) -> None:
    rows: Cells = [names.split(), *columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q)]
    is_the_machine(read_flux_points(text_of(rows), "map.csv"))


def test_a_report_of_maxwell_gives_units_and_averages() -> None:
    titles = [
        "Id [A]",
        "Iq [A]",
        "avg(FluxD) [mWb]",
        "avg(FluxQ) [mWb]",
        "avg(Moving1.Torque) [NewtonMeter]",
    ]
    rows: Cells = [
        [f'"{title}"' for title in titles],
        *columns_of(MESH_D, MESH_Q, 1e3 * PSI_D, 1e3 * PSI_Q, TORQUE),
    ]
    found = built(text_of(rows), "report.csv")
    assert found.torque is not None
    assert found.torque.slope == pytest.approx(1.0)


def test_names_settle_the_scaling() -> None:
    rms = 2**-0.5
    arrays = {
        "Id_RMS": rms * MESH_D,
        "Iq_RMS": rms * MESH_Q,
        "psi_d_rms": rms * PSI_D,
        "psi_q_rms": rms * PSI_Q,
    }
    points = read_flux_points(mat(arrays), "map.mat")
    is_the_machine(points, 2**0.5)
    found = build_flux_map(points)
    assert found.flux_map.i_q[-1] == pytest.approx(AXIS_Q[-1])
    assert any(
        "are rms values, as the names in the file say" in finding for finding in found.findings
    )
    with pytest.raises(InputError, match="say rms values, which is not scaling: peak"):
        build_flux_map(points, scaling="peak")
    mixed = {
        "Id_Peak": MESH_D,
        "Iq_Peak": MESH_Q,
        "psi_d_rms": rms * PSI_D,
        "psi_q_rms": rms * PSI_Q,
    }
    with pytest.raises(
        InputError, match=r"Peak is a peak value by its name and psi_._rms an r\.m\.s\. value"
    ):
        read_flux_points(mat(mixed), "map.mat")


# Amplitude and angle, apparent inductances

AMPLITUDES, BETA = np.linspace(0.0, 120.0, 7), np.radians(np.linspace(0.0, 90.0, 10))


@pytest.mark.parametrize("arrange", ["table", "axes"])
@pytest.mark.parametrize("unit", ["deg", "rad", ""], ids=lambda unit: unit or "deg without a unit")
@pytest.mark.parametrize(
    ("begin", "sign", "phrase"),
    [
        (90.0, 1.0, "counted from the d axis"),
        (0.0, 1.0, "an advance"),
        (0.0, -1.0, "negative for negative i_d"),
    ],
)
def test_amplitude_and_angle(
    arrange: str, unit: str, begin: float, sign: float, phrase: str
) -> None:
    size, angle = np.meshgrid(AMPLITUDES, BETA, indexing="ij")
    psi_d, psi_q = MACHINE.flux(-size * np.sin(angle), size * np.cos(angle))
    given = sign * angle + math.radians(begin)
    shown, axis = (given, given[0]) if unit == "rad" else (np.degrees(given), np.degrees(given[0]))
    if arrange == "table":
        rows: Cells = [
            ["Is [A]", f"beta [{unit}]" if unit else "beta", "psi_d [Wb]", "psi_q [Wb]"],
            *columns_of(size, shown, psi_d, psi_q),
        ]
        content, source = text_of(rows, ";"), "map.csv"
    else:
        content, source = (
            mat(
                {"Is": AMPLITUDES, f"beta_{unit}".rstrip("_"): axis, "psi_d": psi_d, "psi_q": psi_q}
            ),
            "map.mat",
        )
    points = read_flux_points(content, source)
    np.testing.assert_allclose(points.i_d, -(size * np.sin(angle)).ravel(), atol=1e-10)
    np.testing.assert_allclose(points.i_q, (size * np.cos(angle)).ravel(), atol=1e-10)
    assert phrase in points.findings[0]


def test_apparent_inductances_with_undefined_values_at_zero_current() -> None:
    psi_m = np.broadcast_to(MACHINE.flux(np.zeros(7), AXIS_Q)[0], PSI_D.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        l_d, l_q = (PSI_D - psi_m) / MESH_D, PSI_Q / MESH_Q
    axes = {"id": AXIS_D, "iq": AXIS_Q}
    for magnets in (psi_m, psi_m[0]):
        points = read_flux_points(
            mat({**axes, "Ld_mH": 1e3 * l_d, "Lq_mH": 1e3 * l_q, "psi_m": magnets}), "map.mat"
        )
        is_the_machine(points)
        assert any("taken as apparent" in finding for finding in points.findings)
    rows: Cells = [
        ["id", "iq", "Ld [H]", "Lq [H]", "psi_m [Wb]"],
        *columns_of(MESH_D, MESH_Q, l_d, l_q, psi_m),
    ]
    is_the_machine(read_flux_points(text_of(rows), "map.csv"))


# Matrices, blocks, case tables


@pytest.mark.parametrize("corner", ["", "iq \\ id", "i_q/i_d [A]"])
@pytest.mark.parametrize("mark", [",", ";", "\t"])
@pytest.mark.parametrize("turned", [False, True])
def test_a_matrix_in_a_file_each(corner: str, mark: str, turned: bool) -> None:
    files = [matrix(values, corner) for values in (PSI_D, PSI_Q, TORQUE)]
    first, second, third = (text_of(rows, mark) for rows in files)
    if turned:
        rows = [list(map(list, zip(*file, strict=True))) for file in files]
        first, second, third = (text_of(part, mark) for part in rows)
    beside = {"psi_q": (second, "psi_q.csv"), "torque": (third, "torque.csv")}
    points = read_flux_points(first, "psi_d.csv", companions=beside)
    is_the_machine(points)
    found = build_flux_map(points, pole_pairs=PAIRS).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0)


def test_matrices_over_different_axes_or_of_one_flux_alone_are_refused() -> None:
    first = text_of(matrix(PSI_D))
    other = first.replace(b"-150.0", b"-151.0")
    with pytest.raises(InputError, match=r"its i_d differs from that in psi_d\.csv") as caught:
        read_flux_points(first, "psi_d.csv", companions={"psi_q": (other, "psi_q.csv")})
    assert caught.value.source == "psi_q.csv"
    with pytest.raises(InputError, match="no psi_d and psi_q found"):
        read_flux_points(first, "psi_d.csv")


SIDE = np.linspace(-60.0, 60.0, 20)


def ultrazohm() -> bytes:
    """The export of the UltraZohm's Javascope: six blocks of 20 x 20 numbers,
    flux linkages in mVs.
    """
    mesh_q, mesh_d = np.meshgrid(SIDE, SIDE, indexing="ij")
    psi_d, psi_q = MACHINE.flux(mesh_d, mesh_q)

    def block(values: FloatArray) -> str:
        return "".join("".join(f"{float(value)!r};" for value in row) + "\n" for row in values)

    currents = f"d-Current in A (x-Axis);\n{block(mesh_d)}q-Current in A (y-Axis);\n{block(mesh_q)}"
    return (
        "FluxMapData_ 2024-01-01_00-00-00 \nRated Current in A;10.0;\nPermanent Flux in Vs;120.0;\n"
        "Phaseresistance in Ohm;50.0;\nWindingtemperatur in Celsius Degree;40.0;\n"
        "Temperaturcoefficient of d-Flux;0.0;\nTemperaturerror of d-Flux;0.0;\n\n"
        f"FluxMap in d-Axis;\n{currents}d-Flux Values in mVs;\n{block(1e3 * psi_d)}\n"
        f"FluxMap in q-Axis;\n{currents}q-Flux Values in mVs;\n{block(1e3 * psi_q)}\n"
    ).encode()


def test_blocks_of_the_ultrazohm() -> None:
    points = read_flux_points(ultrazohm(), "FluxMapData.csv")
    assert points.i_d.size == 400
    np.testing.assert_allclose(
        np.stack([points.psi_d, points.psi_q]), MACHINE.flux(points.i_d, points.i_q), atol=1e-12
    )
    other = ultrazohm().decode().split("FluxMap in q-Axis")
    with pytest.raises(InputError, match="2 arrays may be i_d"):
        read_flux_points(
            f"{other[0]}FluxMap in q-Axis{other[1].replace('-60.0', '-61.0')}".encode(), "map.csv"
        )


def test_blocks_with_axes_of_their_own() -> None:
    rows: list[list[object]] = [
        ["psi_d [mWb]"],
        *matrix(1e3 * PSI_D),
        [],
        ["psi_q [mWb]"],
        *matrix(1e3 * PSI_Q),
    ]
    is_the_machine(read_flux_points(text_of(rows, ";"), "map.csv"))


@pytest.mark.parametrize("units", [True, False])
def test_a_case_table_with_a_row_per_quantity(units: bool) -> None:
    order = np.random.default_rng(2).permutation(MESH_D.size)
    quantities = [("Id", "A", MESH_D), ("Iq", "A", MESH_Q), ("Flux_d", "mWb", 1e3 * PSI_D)]
    quantities += [("Flux_q", "mWb", 1e3 * PSI_Q), ("Torque", "N m", TORQUE)]
    rows: list[list[object]] = [["", "Unit", *(f"Case {k}" for k in range(1, order.size + 1))]]
    for name, unit, values in quantities:
        head = [name, unit] if units else [f"{name} [{unit}]", ""]
        rows.append([*head, *values.ravel()[order].tolist()])
    points = read_flux_points(text_of(rows), "cases.csv")
    is_the_machine(points)
    found = build_flux_map(points, pole_pairs=PAIRS).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0)


# FEMAG

LENGTH = 83.56
BANNER = (
    "[******************************************************** \nFEMAG Classic Version: 9.2.x\n"
    f"[******* \nGeneral Machine Data:\n   Armature Length [mm]:      \t    {LENGTH:.3f}\n"
    "   Number of Pole pairs :     \t         3\n[*******\n"
)


def number(value: float) -> str:
    return f"\t {value:.8E}"


def psid_psiq(*, with_torque: bool) -> bytes:
    """The table of the fast Psid-Psiq identification, or one without torques,
    which then stand in a further table.
    """
    head = (
        "Function: PSID-Psiq-Identification\nI, Psi : Peak values\n\n"
        "    Id      \t    Iq      \t Angle Beta \t"
    )
    head += "   Psi_d    \t   Psi_q    \t" + (" Torque FE  \t Torque Sim \t" if with_torque else "")
    units = (
        "\n   [A]      \t   [A]      \t    [Degr]  \t [Vs/mm]    \t [Vs/mm]    \t"
        + " [Nm/mm]    \t" * 2 * with_torque
    )
    text = f"{BANNER}{head}{units}\n\n"
    tail = (
        "[*******\nFunction: Ld-Lq-Identifikation aus PSID-Psiq-Identification\n\n"
        " Curr Id    \t Curr Iq    \t"
    )
    tail += "      Ld    \t  Torque FE \t  Torque Sim\t\n     [A]    \t     [A]    \t    [H/mm]  \t"
    tail += " [Nm/mm]    \t [Nm/mm]\t\n\n"
    for k in range(AXIS_D.size):
        for n in range(AXIS_Q.size):
            currents = f" {AXIS_D[k]:.8f} \t {AXIS_Q[n]:.8f} "
            angle = math.degrees(math.atan2(AXIS_D[k], AXIS_Q[n]))
            torque = number(TORQUE[k, n] / LENGTH) * 2
            fluxes = number(PSI_D[k, n] / LENGTH) + number(PSI_Q[k, n] / LENGTH)
            text += f"{currents}\t {angle:.2f} {fluxes}{torque if with_torque else ''}\t\n"
            tail += currents + number(1e-5) + torque + "\n"
        text, tail = text + "\n", tail + "\n"
    return (text + tail + "[*******\nLosses for speed [1/min]:\t  3000.000\n").encode()


def ld_lq() -> bytes:
    head = (
        "Function: Ld-Lq-Identification RMS-values\n\n\n"
        "  Wdg.-Curr \t Angle Beta \t      Ld    \t      Lq    \t"
    )
    head += (
        "   Psi_magn \t   Psi_d    \t   Psi_q    \t     Torque \t\n"
        "   [A    ]  \t    [Degr]  \t    [H/mm]  \t"
    )
    head += "    [H/mm]  \t   [Vs/mm]  \t   [Vs/mm]  \t   [Vs/mm]  \t   [Nm/mm]  \t\n\n"
    text = BANNER + head
    for size in AMPLITUDES:
        for beta in np.linspace(0.0, -90.0, 10):
            i_d, i_q = size * math.sin(math.radians(beta)), size * math.cos(math.radians(beta))
            psi_d, psi_q = (float(part) for part in MACHINE.flux(i_d, i_q))
            torque = 1.5 * PAIRS * (psi_d * i_q - psi_q * i_d)
            fluxes = (
                1e-5,
                2e-5,
                1e-3,
                psi_d / 2**0.5 / LENGTH,
                psi_q / 2**0.5 / LENGTH,
                torque / LENGTH,
            )
            text += f" {size / 2**0.5:.8f} \t {beta:.4f} " + "".join(map(number, fluxes)) + "\t\n"
        text += "\n"
    return (text + "\n[*******\nFemag-Values:\n").encode()


@pytest.mark.parametrize("with_torque", [True, False])
@pytest.mark.parametrize("suffix", ["BATCH", "bch", "txt"])
def test_results_of_femag(suffix: str, with_torque: bool) -> None:
    points = read_flux_points(psid_psiq(with_torque=with_torque), f"PM_270_L8_001.{suffix}")
    is_the_machine(points, digits=1e-7)
    found = build_flux_map(points, pole_pairs=PAIRS).torque
    assert found is not None
    assert found.slope == pytest.approx(1.0, rel=1e-6)


def test_results_of_femag_over_amplitude_and_angle_in_rms_values() -> None:
    points = read_flux_points(ld_lq(), "PM_270_L8_056.BATCH")
    factor = 2**0.5
    psi_d, psi_q = MACHINE.flux(points.i_d * factor, points.i_q * factor)
    np.testing.assert_allclose(points.psi_d * factor, psi_d, atol=1e-7)
    np.testing.assert_allclose(points.psi_q * factor, psi_q, atol=1e-7)
    found = build_flux_map(points, pole_pairs=PAIRS)
    assert found.torque is not None
    assert found.torque.slope == pytest.approx(1.0, rel=1e-5)


WITHOUT_A_MAP = {
    "an empty one": "",
    "no load": (
        "Flux observed: \nFlux-Area k : Winding  \tKey:\t     1\n"
        "F-Path \t Displ. \t Flux_k \tVoltage Dpsi\n       \t [Degr] \t  [Vs]  \t        [V] \n"
        "1 \t     0.000 \t-0.1434     \t   -52.7704\n2 \t     3.000 \t-0.1522     \t   -28.9924\n"
    ),
    "a simulation that names flux linkages": (
        "Results for Angle I-Up [Degr]: -38.0\n  Psi_d  [Vs] 0.1\n  Psi_q  [Vs] 0.2\n"
        " beta [Degr]\t Torque [Nm]\t Psi_m [Vs]\n -10.0 \t 20.0 \t 0.1\n -20.0 \t 22.0 \t 0.1\n"
    ),
    "a table of flux linkages without currents": (
        "    Speed   \t   Psi_d    \t   Psi_q    \n   [1/min]  \t    [Vs]    \t   [Vs]     \n"
        " 100 \t 0.1 \t 0.2\n 200 \t 0.1 \t 0.2\n"
    ),
    "one column": "Losses\n1.0\n2.0\n3.0\n",
    "two columns of another unit": "  id [lb]\tiq [lb]\n 1.0\t2.0\n 2.0\t3.0\n",
    "with bytes of no text": "Magn.Temperatur[\udcb0C]:\t 60\0\0\x1a\n 1.0\t 2.0\n",
    "an identification of inductances alone": (
        "Function: Ld-Lq-Identification RMS-values\n\n  Wdg.-Curr \t Angle Beta \t      Ld    \n"
        "   [A    ]  \t    [Degr]  \t    [H/mm]  \n 1.0 \t 0.0 \t 1e-5\n 2.0 \t 0.0 \t 1e-5\n"
    ),
}


@pytest.mark.parametrize("kind", WITHOUT_A_MAP)
def test_a_femag_file_without_an_identification_is_told_so(kind: str) -> None:
    ran = (
        "*************************************************\n***** Fast cogging calculation ***  \n"
    )
    body = WITHOUT_A_MAP[kind].encode("utf-8", "surrogateescape")
    for suffix in ("BCH", "BATCH", "bch", "txt", "dat"):
        with pytest.raises(InputError) as caught:
            read_flux_points((BANNER + ran).encode() + body, f"cogging.{suffix}")
        assert str(caught.value) == (
            f"cogging.{suffix}: this file of FEMAG (Fast cogging calculation) holds no table of a "
            "Psid-Psiq or Ld-Lq identification; run one of them and name its file"
        )
    with pytest.raises(InputError, match="no table of a Psid-Psiq or Ld-Lq"):
        read_flux_points(body, "old.BATCH")  # without the banner, the suffix tells


def test_a_table_that_mentions_femag_is_a_table() -> None:
    rows: Cells = [["id", "iq", "psi_d", "psi_q"], *columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q)]
    is_the_machine(read_flux_points(b"# from FEMAG\n" + text_of(rows), "map.csv"))


def test_pole_pairs_of_femag_and_twin_builder_are_held_against_the_design() -> None:
    for content, source in (
        (psid_psiq(with_torque=False), "a.BATCH"),
        (twin_builder(), "ece.txt"),
    ):
        with pytest.raises(InputError, match="the file states 3 pole pairs, the design has 4"):
            build_flux_map(read_flux_points(content, source), pole_pairs=4)


# Temperatures and speeds


def at_several(name: str, values: Sequence[float]) -> bytes:
    rows: list[list[object]] = [["id", "iq", "psi_d", "psi_q", name]]
    for k, value in enumerate(values):
        psi_d, psi_q = PSI_D + 0.005 * k, PSI_Q
        rows.extend(
            list(row)
            for row in columns_of(MESH_D, MESH_Q, psi_d, psi_q, np.full(MESH_D.shape, value))
        )
    return text_of(rows)


@pytest.mark.parametrize(
    ("name", "key", "values", "wanted", "listed"),
    [
        ("magnet_temp [degC]", "temperature", (80.0, 20.0), 80.0, "20 degC, 80 degC"),
        ("T_mag [K]", "temperature", (353.15, 293.15), 80.0, "20 degC, 80 degC"),
        ("speed [rpm]", "speed", (1000.0, 2000.0), 1000.0 * math.pi / 30.0, "1000 rpm, 2000 rpm"),
        ("omega [rad/s]", "speed", (100.0, 200.0), 100.0, "955 rpm, 1910 rpm"),
    ],
)
def test_one_of_several_temperatures_or_speeds_is_asked_for(
    name: str, key: str, values: Sequence[float], wanted: float, listed: str
) -> None:
    content = at_several(name, values)
    with pytest.raises(InputError) as caught:
        read_flux_points(content, "map.csv")
    assert f"2 values of the {key}" in str(caught.value)
    assert f"at: {{{key}: " in str(caught.value)
    is_the_machine(read_flux_points(content, "map.csv", at={key: wanted}), digits=1e-9)
    with pytest.raises(InputError, match=f"at.{key}: there are no points at .* but at"):
        read_flux_points(content, "map.csv", at={key: 1.5 * wanted})


def test_a_single_temperature_or_one_for_each_point_is_no_coordinate() -> None:
    is_the_machine(read_flux_points(at_several("temperature [degC]", (80.0,)), "map.csv"))
    warming = np.linspace(20.0, 60.0, MESH_D.size)
    rows: Cells = [
        ["id", "iq", "psi_d", "psi_q", "temp"],
        *columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q, warming),
    ]
    is_the_machine(read_flux_points(text_of(rows), "map.csv"))


def test_an_angle_resolved_table_is_averaged() -> None:
    arrays = angle_resolved()
    shape = arrays["fluxD"].shape
    spread = [
        np.broadcast_to(part, shape) for part in (MESH_D[..., None], MESH_Q[..., None], ANGLES)
    ]
    order = np.random.default_rng(5).permutation(arrays["fluxD"].size)
    rows = columns_of(*spread, *arrays.values())
    titles = ["id [A]", "iq [A]", "theta [deg]", "psi_d [Wb]", "psi_q [Wb]", "T [Nm]"]
    points = read_flux_points(text_of([titles, *(rows[k] for k in order)]), "map.csv")
    is_the_machine(points)
    assert points.torque is not None
    assert points.lines is not None


@pytest.mark.parametrize("times", [9, 30])
def test_a_point_repeated_for_drift_is_averaged_and_its_scatter_told(times: int) -> None:
    drift = np.random.default_rng(7).normal(0.0, 2e-4, (2, times))
    zero = np.zeros(times)
    psi_m = MACHINE.psi_m + drift[0]
    rows = columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q) + columns_of(zero, zero, psi_m, drift[1])
    points = read_flux_points(text_of([["id", "iq", "psi_d", "psi_q"], *rows]), "map.csv")
    found = build_flux_map(points)
    own = int(np.any((MESH_D == 0.0) & (MESH_Q == 0.0)))
    assert found.scatter == pytest.approx(2e-4, rel=0.5)
    assert any(f"{times - 1 + own} points repeat others" in finding for finding in found.findings)
    zero_flux = found.flux_map.flux(np.zeros(1), np.zeros(1))[0][0]
    assert zero_flux == pytest.approx(MACHINE.psi_m, abs=2e-4)


def test_the_same_points_over_an_unknown_column_are_no_scatter() -> None:
    with pytest.raises(
        InputError,
        match=r"more than scatter.*columns of the file beside: state.*name what distinguishes them",
    ):
        build_flux_map(read_flux_points(at_several("state", tuple(range(9))), "map.csv"))


# Slips, limits


@pytest.mark.parametrize("name", ["i_d", "i_q"])
@pytest.mark.parametrize("value", [2432.0, -2432.0])
def test_a_slip_on_an_axis_is_named_with_its_line(name: str, value: float) -> None:
    rows = columns_of(MESH_D, MESH_Q, PSI_D, PSI_Q)
    rows[11][["i_d", "i_q"].index(name)] = value
    points = read_flux_points(text_of([["id", "iq", "psi_d", "psi_q"], *rows]), "map.csv")
    with pytest.raises(
        InputError, match=f"^map.csv:13: {name} = {value:g} A lies far from all others"
    ):
        build_flux_map(points)


def test_steps_that_grow_are_no_slips() -> None:
    axis_d, axis_q = (
        np.array([-150.0, -60.0, -20.0, -5.0, 0.0, 5.0]),
        np.array([0.0, 1.0, 4.0, 15.0, 50.0, 130.0]),
    )
    i_d, i_q = (part.ravel() for part in np.meshgrid(axis_d, axis_q, indexing="ij"))
    assert (
        build_flux_map(FluxPoints("map.csv", i_d, i_q, *MACHINE.flux(i_d, i_q))).flux_map.i_d.size
        == 6
    )


def test_an_axis_with_many_points_at_no_current_is_judged() -> None:
    i_d, i_q = (
        part.ravel()
        for part in np.meshgrid(np.linspace(-150.0, 60.0, 8), np.linspace(0.0, 130.0, 201))
    )
    assert (
        build_flux_map(FluxPoints("map.csv", i_d, i_q, *MACHINE.flux(i_d, i_q))).flux_map.i_d.size
        == 8
    )


def test_the_measured_map_of_the_bench_that_holds_no_currents_is_refused(shared_data: Path) -> None:
    for path in sorted((shared_data / "bench" / "ultrazohm").glob("*.csv")):
        with pytest.raises(InputError) as caught:
            read_flux_points(path.read_bytes(), path.name)
        assert "\n" not in str(caught.value)


# Damage

FILES: dict[str, tuple[bytes, str]] = {
    "twin builder": (twin_builder(), "ece.txt"),
    "femag": (psid_psiq(with_torque=True), "a.BATCH"),
    "femag polar": (ld_lq(), "a.BATCH"),
    "ultrazohm": (ultrazohm(), "FluxMapData.csv"),
    "blocks": (
        text_of([["psi_d [mWb]"], *matrix(PSI_D), [], ["psi_q [mWb]"], *matrix(PSI_Q)], ";"),
        "map.csv",
    ),
    "angles": (mat(motor_cad()), "map.mat"),
    "speeds": (at_several("speed [rpm]", (1000.0, 2000.0)), "map.csv"),
    "workbook": (workbook({"Sheet1": MATHWORKS}), "map.xlsx"),
}


def complaint(content: bytes, source: str) -> str:
    """What is said of a file, '' where its damage is harmless."""
    try:
        built(content, source)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.thinned
@pytest.mark.parametrize("name", FILES)
def test_damaged_files_are_refused_in_one_line_or_read(name: str) -> None:
    content, source = FILES[name]
    generator = np.random.default_rng(11)
    texts = (b"x", b"nan", b"-", b";", b"1e999", b"\n\n", b"(", b"", b"1.2.3", b"\t\t")
    for trial in range(25):
        damaged = bytearray(content)
        for _ in range(1 + trial % 3):
            place = int(generator.integers(0, len(damaged)))
            length = int(generator.choice([1, 3, 40, len(damaged) // 3]))
            damaged[place : place + length] = texts[int(generator.integers(0, len(texts)))]
        assert "\n" not in complaint(bytes(damaged), source)


@pytest.mark.parametrize("claim", ["(Peak)", "[peak]", "[A] (Peak)", "(Peak) [A]"])
def test_a_claim_in_brackets_hides_no_name(claim: str) -> None:
    """Id (Peak) beside Is and its angle, as a tool of finite elements exports them."""
    named = {
        f"Id {claim}": MESH_D,
        f"Iq {claim}": MESH_Q,
        "Is": np.hypot(MESH_D, MESH_Q),
        "beta": np.degrees(np.arctan2(MESH_Q, MESH_D)),
        "Flux_d": PSI_D,
        "Flux_q": PSI_Q,
    }
    arrays = [NamedArray("", name, values) for name, values in named.items()]
    chosen = choose(arrays, {}, "map.csv")
    assert chosen["i_d"].values is MESH_D
    assert "i" not in chosen
