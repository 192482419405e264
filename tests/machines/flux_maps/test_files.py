"""Flux-map files: a known map written by other libraries in every format and arrangement
comes back point by point.
"""

from __future__ import annotations

import io
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from scipy.io import loadmat, savemat
from scipy.sparse import eye_array

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files import text_formats as flux_map_arrays
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.map_files import read_flux_points

Arrays = Mapping[str, Any]

AXIS_D = np.array([-30.0, -20.0, -8.0, 0.0])
AXIS_Q = np.array([-12.0, -5.0, 1.0, 7.0, 20.0])
SQUARE_Q = np.array([0.0, 4.0, 9.0, 15.0])


def psi_d_of(i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    return np.asarray(0.1 + 2e-3 * i_d + 1e-6 * i_d**2 - 4e-6 * i_q**2)


def psi_q_of(i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    return np.asarray(5e-3 * i_q * (1.0 - 1e-3 * i_d))


def rows_of_d(i_d: FloatArray = AXIS_D, i_q: FloatArray = AXIS_Q) -> dict[str, FloatArray]:
    """A map as meshes of shape (M, N)."""
    mesh_d, mesh_q = np.meshgrid(i_d, i_q, indexing="ij")
    return {
        "id": mesh_d,
        "iq": mesh_q,
        "psi_d": psi_d_of(mesh_d, mesh_q),
        "psi_q": psi_q_of(mesh_d, mesh_q),
    }


def transposed(arrays: Arrays) -> dict[str, Any]:
    return {name: values.T for name, values in arrays.items()}


def with_axes(arrays: Arrays, i_d: FloatArray = AXIS_D, i_q: FloatArray = AXIS_Q) -> dict[str, Any]:
    return {**arrays, "id": i_d, "iq": i_q}


def renamed(arrays: Arrays, names: str) -> dict[str, Any]:
    return dict(zip(names.split(), arrays.values(), strict=True))


def as_complex(arrays: Arrays) -> dict[str, Any]:
    i_d, i_q, psi_d, psi_q = arrays.values()
    return {"i_s_dq": i_d + 1j * i_q, "psi_s_dq": psi_d + 1j * psi_q}


def npz(arrays: Arrays) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def mat5(arrays: Arrays) -> bytes:
    stream = io.BytesIO()
    savemat(stream, dict(arrays), do_compression=True)
    return stream.getvalue()


def mat4(arrays: Arrays) -> bytes:
    stream = io.BytesIO()
    savemat(stream, dict(arrays), format="4")
    return stream.getvalue()


def hdf5(arrays: Arrays) -> bytes:
    """Datasets under their paths; strings as datasets of text."""
    library = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with library.File(stream, "w") as file:
        for path, values in arrays.items():
            file[path] = values
    return stream.getvalue()


def mat73(arrays: Arrays) -> bytes:
    """What MATLAB's `save -v7.3` writes: an HDF5 file behind 512 bytes, column-major arrays,
    complex as pairs.
    """
    library = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with library.File(stream, "w", userblock_size=512) as file:
        for path, values in arrays.items():
            columns = np.atleast_2d(np.asarray(values)).T
            if np.iscomplexobj(columns):
                pairs = np.empty(columns.shape, dtype=[("real", "f8"), ("imag", "f8")])
                pairs["real"], pairs["imag"] = columns.real, columns.imag
                columns = pairs
            file.create_dataset(path, data=columns).attrs["MATLAB_class"] = np.bytes_("double")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM"
    return header + stream.getvalue()[len(header) :]


def csv(arrays: Arrays, separator: str = ",") -> bytes:
    columns = [np.ravel(values) for values in arrays.values()]
    rows = [
        separator.join(repr(float(value)) for value in row) for row in zip(*columns, strict=True)
    ]
    return "\n".join([separator.join(arrays), *rows, ""]).encode()


def assert_is_the_map(
    points: FluxPoints, i_d: FloatArray = AXIS_D, i_q: FloatArray = AXIS_Q
) -> None:
    """Every grid point is there once, with the flux linkages that belong to it."""
    found = np.array(sorted(zip(points.i_d, points.i_q, strict=True)))
    expected = np.array([(d, q) for d in np.sort(i_d) for q in np.sort(i_q)])
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    np.testing.assert_allclose(points.psi_d, psi_d_of(points.i_d, points.i_q), rtol=1e-13)
    np.testing.assert_allclose(
        points.psi_q, psi_q_of(points.i_d, points.i_q), rtol=1e-13, atol=1e-18
    )
    assert points.psi_d.dtype == np.float64


def refused(content: bytes, source: str, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        read_flux_points(content, source, **options)
    assert caught.value.source == source
    return caught.value.message


WRITERS = [
    pytest.param(npz, "map.npz", id="npz"),
    pytest.param(mat4, "map.mat", id="mat4"),
    pytest.param(mat5, "map.mat", id="mat5"),
    pytest.param(mat73, "map.mat", id="mat73"),
    pytest.param(hdf5, "map.h5", id="hdf5"),
]
ARRANGEMENTS: dict[str, dict[str, Any]] = {
    "meshes, rows of i_d": rows_of_d(),
    "meshes, rows of i_q": transposed(rows_of_d()),
    "axes, rows of i_d": with_axes(rows_of_d()),
    "axes, rows of i_q": with_axes(transposed(rows_of_d())),
    "axes as a row and a column": with_axes(
        rows_of_d(), AXIS_D[np.newaxis, :], AXIS_Q[:, np.newaxis]
    ),
    "mesh of i_d and axis of i_q": {**rows_of_d(), "iq": AXIS_Q},
    "axis of i_d and mesh of i_q, turned": {**transposed(rows_of_d()), "id": AXIS_D},
    "points": {name: values.ravel() for name, values in rows_of_d().items()},
    "complex": as_complex(rows_of_d()),
    "complex, turned": as_complex(transposed(rows_of_d())),
}


@pytest.mark.parametrize(("write", "source"), WRITERS)
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
def test_every_format_and_arrangement_comes_back(
    write: Callable[[Arrays], bytes], source: str, arrangement: str
) -> None:
    points = read_flux_points(write(ARRANGEMENTS[arrangement]), source)
    assert points.source == source
    assert_is_the_map(points)


@pytest.mark.parametrize(("write", "source"), WRITERS)
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("signs", [(1.0, 1.0), (-1.0, -1.0), (-1.0, 1.0)])
def test_a_square_grid_over_two_axes_is_turned_as_a_passive_winding_demands(
    write: Callable[[Arrays], bytes], source: str, turned: bool, signs: tuple[float, float]
) -> None:
    """Also where both or one of the axes point the other way, in the currents as in the flux
    linkages.
    """
    grid = rows_of_d(i_q=SQUARE_Q)
    values = dict(zip(grid, (signs[0], signs[1], signs[0], signs[1]), strict=True))
    fluxes = {name: values[name] * (array.T if turned else array) for name, array in grid.items()}
    points = read_flux_points(
        write(with_axes(fluxes, signs[0] * AXIS_D, signs[1] * SQUARE_Q)), source
    )
    restored = FluxPoints(
        source,
        signs[0] * points.i_d,
        signs[1] * points.i_q,
        signs[0] * points.psi_d,
        signs[1] * points.psi_q,
    )
    assert_is_the_map(restored, i_q=SQUARE_Q)


def test_a_square_grid_of_meshes_goes_by_the_meshes() -> None:
    grid = rows_of_d(i_q=SQUARE_Q)
    assert_is_the_map(read_flux_points(npz(transposed(grid)), "map.npz"), i_q=SQUARE_Q)
    assert_is_the_map(
        read_flux_points(npz({**transposed(grid), "iq": SQUARE_Q}), "map.npz"), i_q=SQUARE_Q
    )


def test_a_square_grid_without_any_sense_has_rows_of_i_d() -> None:
    flat = np.zeros((4, 4))
    points = read_flux_points(
        npz({"id": AXIS_D, "iq": SQUARE_Q, "psi_d": flat, "psi_q": flat}), "map.npz"
    )
    np.testing.assert_array_equal(points.i_d, np.repeat(AXIS_D, 4))


@pytest.mark.parametrize(
    "names",
    [
        "id iq psi_d psi_q",
        "i_d i_q psi_d psi_q",
        "Id Iq Fd Fq",
        "isd isq Fluxd Fluxq",
        "ID IQ PSID PSIQ",
        "id_A iq_A lambda_d_Vs lambda_q_Vs",
        "i_ds i_qs lambda_ds lambda_qs",
        "idVec iqVec fluxD fluxQ",
        "i_d_A i_q_A psi_s_d_Wb psi_s_q_Wb",
        "d_current q_current flux_linkage_d flux_linkage_q",
        "id iq phi_d phi_q",
        "id_A iq_A d_flux_Wb q_flux_Wb",
    ],
)
@pytest.mark.parametrize(("write", "source"), [(csv, "map.csv"), (npz, "map.npz")])
def test_names_that_tools_use_are_recognised(
    write: Callable[[Arrays], bytes], source: str, names: str
) -> None:
    assert_is_the_map(read_flux_points(write(renamed(rows_of_d(), names)), source))


@pytest.mark.parametrize("source", ["map.csv", "MAP.TXT", "map.dat"])
def test_text_tables_hold_points(source: str) -> None:
    separator = "," if source.endswith("csv") else "\t"
    assert_is_the_map(read_flux_points(csv(rows_of_d(), separator), source))


def test_extra_arrays_are_ignored_whatever_they_hold() -> None:
    extra = {
        "T": np.zeros((2, 2)),
        "name": np.array("THOR"),
        "notes": np.array([{"a": 1}], dtype=object),
    }
    assert_is_the_map(read_flux_points(npz({**with_axes(rows_of_d()), **extra}), "map.npz"))
    cells = np.array([np.zeros(3), "text"], dtype=object)
    structs = np.array([(1.0,), (2.0,)], dtype=[("id", "O")])
    others = {
        "name": "THOR",
        "cells": cells,
        "structs": structs,
        "sparse": eye_array(5, format="csc"),
        "e": [],
    }
    assert_is_the_map(read_flux_points(mat5({**with_axes(rows_of_d()), **others}), "m.mat"))


def test_nan_are_passed_on() -> None:
    grid = rows_of_d()
    grid["psi_q"][1, 2] = np.nan
    points = read_flux_points(npz(with_axes(grid)), "map.npz")
    where = np.flatnonzero(np.isnan(points.psi_q))
    assert where.size == 1
    assert (points.i_d[where[0]], points.i_q[where[0]]) == (AXIS_D[1], AXIS_Q[2])


def test_huge_and_infinite_values_are_passed_on() -> None:
    grid = rows_of_d(i_q=SQUARE_Q)
    grid["psi_d"][0, 0], grid["psi_q"][1, 1], grid["psi_q"][2, 2] = np.inf, 1e300, -1e300
    points = read_flux_points(npz(with_axes(grid, i_q=SQUARE_Q)), "map.npz")
    np.testing.assert_array_equal(points.psi_d, grid["psi_d"].ravel())


def test_points_keep_the_order_of_the_file() -> None:
    order = np.random.default_rng(3).permutation(20)
    flat = {name: values.ravel()[order] for name, values in rows_of_d().items()}
    np.testing.assert_array_equal(read_flux_points(csv(flat), "map.csv").i_q, flat["iq"])


@pytest.mark.parametrize(("write", "source"), WRITERS)
def test_grids_go_row_by_row_as_the_writer_saw_them(
    write: Callable[[Arrays], bytes], source: str
) -> None:
    grid = rows_of_d()
    np.testing.assert_array_equal(read_flux_points(write(grid), source).i_d, grid["id"].ravel())


# Units


@pytest.mark.parametrize(
    ("current", "flux", "current_factor", "flux_factor"),
    [
        ("mA", "mVs", 1e3, 1e3),
        ("kA", "Wb", 1e-3, 1.0),
        ("A", "V s", 1.0, 1.0),
        ("ma", "mWb", 1e3, 1e3),
    ],
)
def test_given_units_scale(
    current: str, flux: str, current_factor: float, flux_factor: float
) -> None:
    factors = (current_factor, current_factor, flux_factor, flux_factor)
    scaled = {n: v * f for (n, v), f in zip(with_axes(rows_of_d()).items(), factors, strict=True)}
    assert_is_the_map(
        read_flux_points(npz(scaled), "map.npz", current_unit=current, flux_unit=flux)
    )


@pytest.mark.parametrize("names", ["id_mA iq_mA psi_d_mVs psi_q_mVs", "ID_mA IQ_mA Fd_mWb Fq_mWb"])
@pytest.mark.parametrize(("write", "source"), [(csv, "map.csv"), (npz, "map.npz")])
def test_units_in_names_scale(write: Callable[[Arrays], bytes], source: str, names: str) -> None:
    scaled = renamed({name: 1e3 * values for name, values in rows_of_d().items()}, names)
    assert_is_the_map(read_flux_points(write(scaled), source))


def test_units_in_the_header_of_a_table_scale() -> None:
    scaled = {name: 1e3 * values for name, values in rows_of_d().items()}
    header = renamed(scaled, "id_[mA] iq_[mA] psi_d_[mWb] psi_q_[mWb]")
    content = csv(header).replace(b"_[", b" [")
    assert_is_the_map(read_flux_points(content, "map.csv"))
    assert_is_the_map(read_flux_points(content, "map.csv", current_unit="mA", flux_unit="mVs"))


@pytest.mark.parametrize(("write", "source"), [(csv, "map.csv"), (npz, "map.npz")])
def test_a_unit_that_contradicts_the_files_is_refused(
    write: Callable[[Arrays], bytes], source: str
) -> None:
    content = write(renamed(rows_of_d(), "id_A iq_A psi_d_Vs psi_q_Vs"))
    message = refused(content, source, current_unit="mA")
    assert "is in A by" in message
    assert "mA by current_unit" in message
    message = refused(content, source, flux_unit="mWb")
    assert "is in Vs by" in message
    assert "mWb by flux_unit" in message
    assert_is_the_map(read_flux_points(content, source, current_unit="A", flux_unit="Wb"))


def test_attributes_of_hdf5_datasets_tell_units() -> None:
    library = pytest.importorskip("h5py")
    stream = io.BytesIO(hdf5({**rows_of_d(), "id": 1e3 * rows_of_d()["id"]}))
    with library.File(stream, "r+") as file:
        file["id"].attrs["units"] = "mA"
        file["psi_d"].attrs["unit"] = np.bytes_("Wb")
    assert_is_the_map(read_flux_points(stream.getvalue(), "map.h5"))
    assert "mA by the file but in A by current_unit" in refused(
        stream.getvalue(), "map.h5", current_unit="A"
    )


def test_unknown_units_are_refused() -> None:
    content = npz(rows_of_d())
    assert (
        refused(content, "map.npz", current_unit="p.u.")
        == "the unit 'p.u.' is not known; write A, mA or kA"
    )
    assert "write Wb, mWb, Vs or mVs" in refused(content, "map.npz", flux_unit="A")


# Where arrays stand, and what they are called


SYRE = {
    "motorModel": {
        "data": {"motorName": "THOR", "p": 2.0},
        "FluxMap_dq": {**renamed(transposed(rows_of_d()), "Id Iq Fd Fq"), "T": np.zeros((5, 4))},
        "controlTrajectories": {
            "MTPA": renamed({n: np.ones(3) for n in rows_of_d()}, "id iq fd fq")
        },
        "tmpMap": renamed({n: np.ones((3, 3)) for n in rows_of_d()}, "Id Iq Fd Fq"),
        "FluxMap_dqt": {
            "data": renamed({n: np.ones((2, 3, 4)) for n in rows_of_d()}, "Id Iq Fd Fq")
        },
    }
}


def flattened(tree: Arrays, path: str = "") -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in tree.items():
        inner = (
            flattened(value, f"{path}{name}/") if isinstance(value, dict) else {path + name: value}
        )
        leaves |= {key: leaf for key, leaf in inner.items() if not isinstance(leaf, str)}
    return leaves


def test_the_map_of_a_syre_model_is_found_in_its_structs() -> None:
    assert_is_the_map(read_flux_points(mat5(SYRE), "motor.mat"))
    assert_is_the_map(read_flux_points(mat73(flattened(SYRE)), "motor.mat"))


def test_datasets_are_found_across_the_tree() -> None:
    names = "currents/id currents/iq results/flux/psi_d results/flux/psi_q"
    assert_is_the_map(read_flux_points(hdf5(renamed(with_axes(rows_of_d()), names)), "map.hdf5"))


def test_of_two_maps_the_one_nearer_to_the_root_is_read_and_a_tie_is_refused() -> None:
    grid = rows_of_d()
    other = {f"cold/{name}": 2.0 * values for name, values in grid.items()}
    assert_is_the_map(read_flux_points(hdf5({**grid, **other}), "map.h5"))
    hot = {f"hot/{name}": values for name, values in grid.items()}
    message = refused(hdf5({**hot, **other}), "map.h5")
    assert "2 arrays may be i_d: cold/id (4, 5), hot/id (4, 5)" in message
    columns = {"i_d": "hot/id", "i_q": "/hot/iq", "psi_d": "hot/psi_d", "psi_q": "hot/psi_q"}
    assert_is_the_map(read_flux_points(hdf5({**hot, **other}), "map.h5", columns=columns))
    assert "write one path" in refused(hdf5({**hot, **other}), "map.h5", columns={"psi_d": "psi_d"})


@pytest.mark.parametrize(
    ("write", "source"), [(csv, "map.csv"), (npz, "map.npz"), (mat5, "map.mat")]
)
def test_columns_name_what_is_not_recognised(write: Callable[[Arrays], bytes], source: str) -> None:
    content = write(renamed(rows_of_d(), "x1 iq y1 psi_q"))
    message = refused(content, source)
    assert message.startswith("no i_d and psi_d found among ")
    assert message.endswith("write columns: {i_d: NAME, psi_d: NAME}")
    for part in ("x1 (", "iq (", "y1 (", "psi_q ("):
        assert part in message
    assert_is_the_map(read_flux_points(content, source, columns={"i_d": "x1", "psi_d": "Y1"}))
    assert "no 'z' found among" in refused(content, source, columns={"i_d": "z"})
    assert "unknown key 'flux'" in refused(content, source, columns={"flux": "x1"})


def test_units_in_named_columns_scale_too() -> None:
    grid = rows_of_d()
    content = csv(renamed({**grid, "id": 1e3 * grid["id"]}, "first_mA iq psi_d psi_q"))
    columns = {"i_d": "first_mA"}
    assert_is_the_map(read_flux_points(content, "map.csv", columns=columns))
    content = content.replace(b"first_mA", b"x_mA").replace(b"psi_d", b"x_Vs")
    assert_is_the_map(
        read_flux_points(content, "map.csv", columns={"i_d": "x_mA", "psi_d": "x [Vs]"})
    )
    assert "columns: 'x' is the name of x [mA] (20,), x [Vs] (20,)" in refused(
        content, "map.csv", columns={"i_d": "x"}
    )


def test_a_complex_array_may_be_named_for_both_axes() -> None:
    current, flux = as_complex(rows_of_d()).values()
    content = npz({"current": current, "linkage": flux})
    columns = {"i_d": "current", "i_q": "current", "psi_d": "linkage", "psi_q": "linkage"}
    assert_is_the_map(read_flux_points(content, "map.npz", columns=columns))
    message = refused(npz({**rows_of_d(), "psi_d": flux}), "map.npz")
    assert "psi_d is complex" in message
    assert "columns: {psi_d: psi_d, psi_q: psi_d}" in message
    assert_is_the_map(
        read_flux_points(npz({**rows_of_d(), "id": rows_of_d()["id"] + 0j}), "map.npz")
    )


def test_two_names_for_one_quantity_are_refused() -> None:
    message = refused(npz({**rows_of_d(), "lambda_d": rows_of_d()["psi_d"]}), "map.npz")
    assert message.startswith("2 arrays may be psi_d: psi_d (4, 5), lambda_d (4, 5)")
    assert message.endswith("write columns: {psi_d: NAME}")


def test_long_lists_are_cut() -> None:
    message = refused(npz({f"x{k}": np.zeros(2) for k in range(25)}), "map.npz")
    assert (
        "x19 (2,) and 5 more; write columns: {i_d: NAME, i_q: NAME, psi_d: NAME, psi_q: NAME}"
        in message
    )


# What is wrong with a file


@pytest.mark.parametrize(
    ("change", "shapes"),
    [
        ({"psi_q": np.zeros((4, 4))}, "psi_q (4, 4)"),
        ({"iq": AXIS_D}, "i_q (4,)"),
        ({"id": rows_of_d()["id"].T}, "i_d (5, 4)"),
        ({"psi_d": np.zeros(20), "psi_q": np.zeros(20)}, "psi_d (20,)"),
        ({name: np.zeros((2, 3, 4)) for name in rows_of_d()}, "i_d (2, 3, 4)"),
        ({name: np.zeros(0) for name in rows_of_d()}, "i_d (0,)"),
    ],
)
def test_shapes_that_do_not_fit_are_named(change: dict[str, FloatArray], shapes: str) -> None:
    message = refused(npz({**with_axes(rows_of_d()), **change}), "map.npz")
    assert message.startswith("the shapes do not fit together: i_d ")
    assert shapes in message


def test_objects_and_text_are_refused() -> None:
    objects = np.array([{"a": 1}], dtype=object)
    assert "psi_d holds Python objects" in refused(
        npz({**rows_of_d(), "psi_d": objects}), "map.npz"
    )
    text: NDArray[np.str_] = np.array(["0.1", "0.2"])
    assert "psi_q holds text, not numbers" in refused(
        npz({**rows_of_d(), "psi_q": text}), "map.npz"
    )
    assert "psi_q holds text, not numbers" in refused(
        mat5({**rows_of_d(), "psi_q": "0.1"}), "map.mat"
    )
    assert "truth values" in refused(
        npz({**rows_of_d(), "psi_q": np.ones((4, 5), dtype=bool)}), "map.npz"
    )


def test_text_in_hdf5_is_refused() -> None:
    message = refused(hdf5({**rows_of_d(), "psi_q": "0.1"}), "map.h5")
    assert message.startswith("psi_q holds")
    library = pytest.importorskip("h5py")
    stream = io.BytesIO(hdf5({**rows_of_d(), "psi_q": np.array([48, 49], dtype=np.uint16)}))
    with library.File(stream, "r+") as file:
        file["psi_q"].attrs["MATLAB_class"] = np.bytes_("char")
    assert "psi_q holds text" in refused(stream.getvalue(), "map.h5")


@pytest.mark.parametrize(("write", "source"), WRITERS)
def test_damaged_files_are_refused_in_one_line(
    write: Callable[[Arrays], bytes], source: str
) -> None:
    content = write(rows_of_d())
    generator = np.random.default_rng(4)
    for size in range(0, len(content), max(1, len(content) // 40)):
        assert "\n" not in refused(content[:size], source)
    for _ in range(100):
        damaged = bytearray(content)
        for place in generator.integers(0, len(content), 4):
            damaged[place] ^= int(generator.integers(1, 256))
        try:
            read_flux_points(bytes(damaged), source)
        except InputError as error:
            assert "\n" not in error.message  # noqa: PT017 - some damage is harmless


@pytest.mark.parametrize(
    ("content", "source", "expected"),
    [
        (
            npz(rows_of_d()),
            "map.csv",
            "the suffix .csv stands for text, the content is a ZIP archive",
        ),
        (
            npz(rows_of_d()),
            "map.h5",
            "the suffix .h5 stands for an HDF5 file, the content is a ZIP archive",
        ),
        (
            mat5(rows_of_d()),
            "map.npz",
            "the suffix .npz stands for a ZIP archive, the content is a MATLAB 5 file",
        ),
        (csv(rows_of_d()), "map.npz", "the content is something else"),
        (csv(rows_of_d()), "map.mat", "this is no MATLAB 4, 5 or 7.3 file"),
        (bytes(100), "map.mat", "cannot read this MATLAB file"),
        (csv(rows_of_d()), "map.xlsx", "the suffix .xlsx stands for a ZIP archive"),
        (csv(rows_of_d()), "map.xls", "a file with the suffix '.xls'; write .csv"),
        (csv(rows_of_d()), "map", "a file with the suffix ''"),
        (b"", "map.npz", "the content is something else"),
    ],
)
def test_content_that_belies_its_suffix_is_refused(
    content: bytes, source: str, expected: str
) -> None:
    assert expected in refused(content, source)


def test_an_archive_that_declares_more_than_the_limit_is_not_unpacked() -> None:
    stream = io.BytesIO(npz(rows_of_d()))
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("more.npy", b"")
        archive.getinfo("psi_d.npy").file_size = 256 * 10**6 + 1
    assert refused(stream.getvalue(), "map.npz").startswith("the arrays take more than 256 MB")


def test_compressed_variables_are_counted_before_they_are_inflated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    content = mat5({**rows_of_d(), "big": np.zeros(100_000)})
    assert len(content) < 10_000
    assert_is_the_map(read_flux_points(content, "map.mat"))
    monkeypatch.setattr(flux_map_arrays, "MOST_BYTES", 700_000)
    assert "MB" in refused(content, "map.mat")


def test_more_than_four_million_points_are_refused() -> None:
    big = np.zeros(4_000_001, dtype=np.int8)
    assert "psi_d has 4000001 points" in refused(npz({**rows_of_d(), "psi_d": big}), "map.npz")
    library = pytest.importorskip("h5py")
    stream = io.BytesIO(
        hdf5({name: values for name, values in rows_of_d().items() if name != "psi_d"})
    )
    with library.File(stream, "r+") as file:
        file.create_dataset("psi_d", shape=(10**6, 10**6), chunks=(1000, 1000), dtype="f8")
    assert "psi_d has 1000000000000 points" in refused(stream.getvalue(), "map.h5")


def test_datasets_in_other_files_are_never_opened(tmp_path: Path) -> None:
    library = pytest.importorskip("h5py")
    other = tmp_path / "other.bin"
    other.write_bytes(rows_of_d()["psi_d"].tobytes())
    stream = io.BytesIO(
        hdf5({name: values for name, values in rows_of_d().items() if name != "psi_d"})
    )
    with library.File(stream, "r+") as file:
        file.create_dataset("psi_d", shape=(4, 5), dtype="f8", external=[(str(other), 0, 160)])
    assert refused(stream.getvalue(), "map.h5").startswith("no psi_d found among ")


@pytest.mark.parametrize(("source", "name"), [("map.mat", "MAT 7.3"), ("map.h5", "HDF5")])
def test_without_h5py_the_message_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, source: str, name: str
) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    message = refused(b"\x89HDF\r\n\x1a\n" + bytes(100), source)
    assert message == f"reading {name} needs h5py; install it with: pip install dqforge[h5]"


# Files made by others


def matlab_files() -> list[Path]:
    """Files written by MATLAB 5 to 7 on machines of both byte orders, which
    come with scipy's own tests.
    """
    folder = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
    found = [
        path
        for path in folder.glob("test*.mat")
        if path.read_bytes()[124:128] in (b"\0\1IM", b"\1\0MI")
    ]
    return sorted(
        path for path in found if path.name.startswith(("testdouble", "testcomplex", "testmatrix"))
    )


def test_what_matlab_wrote_is_read_as_scipy_reads_it() -> None:
    files = matlab_files()
    if not files:
        pytest.skip("scipy was installed without its tests")
    assert {path.read_bytes()[126:128] for path in files} == {b"IM", b"MI"}
    for path in files:
        variables = {name: values for name, values in loadmat(path).items() if name[0] != "_"}
        assert variables
        for name, values in variables.items():
            columns = dict.fromkeys(("i_d", "i_q", "psi_d", "psi_q"), name)
            points = read_flux_points(path.read_bytes(), path.name, columns=columns)
            np.testing.assert_array_equal(points.i_d, np.real(values).ravel())
            np.testing.assert_array_equal(
                points.psi_q, (values.imag if np.iscomplexobj(values) else values).ravel()
            )


def test_the_baldor_files_agree(shared_data: Path) -> None:
    folder = shared_data / "fluxmaps"
    raw, even = (
        read_flux_points((folder / name).read_bytes(), name)
        for name in ("baldor_ecs101m0h7ef4_400rpm_measured.csv", "baldor_400rpm_map.npz")
    )
    assert raw.i_d.size == even.i_d.size == 21 * 27
    origin = np.flatnonzero((even.i_d == 0.0) & (even.i_q == 0.0))
    assert even.psi_d[origin] == pytest.approx(0.44415, abs=5e-6)
    at_raw, at_even = np.lexsort((raw.i_q, raw.i_d)), np.lexsort((even.i_q, even.i_d))
    np.testing.assert_allclose(raw.i_d[at_raw], even.i_d[at_even], atol=1e-9)
    # The raw file's asymmetry in i_q is 3.9 and 6.6 mVs, that is twice what the
    # symmetric one differs by.
    np.testing.assert_allclose(raw.psi_d[at_raw], even.psi_d[at_even], atol=4e-3)
    np.testing.assert_allclose(raw.psi_q[at_raw], even.psi_q[at_even], atol=7e-3)


def test_the_square_map_of_thor_gives_the_torque_in_the_same_file(shared_data: Path) -> None:
    content = (shared_data / "fluxmaps" / "thor_dq_256.npz").read_bytes()
    points = read_flux_points(content, "thor_dq_256.npz")
    assert points.i_d.shape == (65_536,)
    stored = np.load(io.BytesIO(content))
    torque = 1.5 * float(stored["p"]) * (points.psi_d * points.i_q - points.psi_q * points.i_d)
    np.testing.assert_allclose(torque, stored["T"].ravel(), atol=0.02 * float(np.max(stored["T"])))


@pytest.mark.parametrize(
    ("name", "count", "psi_d"),
    [
        ("femag_pm270l8_psidq_losses_50rps.csv", 36, 0.16194),
        ("femag_test_11x11_p6.csv", 121, 1.95335),
    ],
)
def test_femag_tables(shared_data: Path, name: str, count: int, psi_d: float) -> None:
    points = read_flux_points((shared_data / "fluxmaps" / name).read_bytes(), name)
    assert points.i_d.shape == points.psi_q.shape == (count,)
    origin = np.flatnonzero((points.i_d == 0.0) & (points.i_q == 0.0))
    assert points.psi_d[origin] == pytest.approx(psi_d, abs=5e-6)
