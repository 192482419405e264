"""Limits of flux-map files: what is decoded, not what the file weighs;
large tables are read in one piece.
"""

from __future__ import annotations

import io
import resource
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from peak_memory import run_and_measure
from saturated import ArctanMachine

from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_xml import read_numeric_table
from dqforge.machines.files.text_table import read_table
from dqforge.machines.flux_maps import building
from dqforge.machines.flux_maps import map_files as flux_map_files
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.flux_maps.map_files import read_flux_points

MACHINE = ArctanMachine()
GIBIBYTE = 2**30


def hdf5(sizes: dict[str, dict[str, Any]]) -> bytes:
    library = pytest.importorskip("h5py")
    stream = io.BytesIO()
    with library.File(stream, "w") as file:
        for name, options in sizes.items():
            file.create_dataset(name, **{"dtype": "f8", "compression": "gzip", **options})
    return stream.getvalue()


def test_chunks_that_claim_far_more_than_the_data_are_not_decoded() -> None:
    plain = {name: {"data": np.arange(20.0)} for name in ("id", "iq", "psi_d")}
    claim = {"shape": (20,), "maxshape": (None,), "chunks": (250_000_000,), "compression": None}
    content = hdf5({**plain, "psi_q": claim})
    assert len(content) < 100_000
    with pytest.raises(
        InputError, match=r"psi_q lies in chunks of 2000 MB, at most 32 MB can be read"
    ):
        read_flux_points(content, "map.h5")


def test_many_datasets_that_fit_one_by_one_are_counted_together_before_they_are_read() -> None:
    content = hdf5({f"x{k}": {"shape": (3_900_000,), "chunks": (100_000,)} for k in range(65)})
    assert len(content) < 1_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match="more than 256 MB once decoded"):
        read_flux_points(content, "map.h5")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 400_000  # kB


def test_an_array_that_claims_more_than_its_archive_holds_is_refused() -> None:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": (250_000_000,)}
    )
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("id.npy", stream.getvalue() + bytes(80))
    with pytest.raises(InputError, match=r"id\.npy claims more values than it holds"):
        read_flux_points(packed.getvalue(), "map.npz")


def grid_text(rows: int, columns: int, mark: str = ",", end: str = "\n", head: str = "") -> bytes:
    i_d, i_q = (
        x.ravel() for x in np.meshgrid(np.linspace(-150, 60, rows), np.linspace(0, 130, columns))
    )
    table = np.column_stack([i_d, i_q, *MACHINE.flux(i_d, i_q)])
    body = end.join(mark.join(map(repr, row)) for row in table.tolist())
    return f"{head}{mark.join(('id_A', 'iq_A', 'psi_d_Vs', 'psi_q_Vs'))}{end}{body}{end}".encode()


@pytest.mark.parametrize("mark", [",", ";", "\t", " "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_large_tables_of_numbers_are_read_as_small_ones_are(mark: str, end: str) -> None:
    content = grid_text(50, 40, mark, end, "# measured on the bench" + end)
    fast, usual = read_numeric_table(content, "map.csv"), read_table(content, "map.csv")
    assert fast is not None
    assert (fast.names, fast.units, fast.preamble) == (usual.names, usual.units, usual.preamble)
    np.testing.assert_array_equal(fast.values, usual.values)
    np.testing.assert_array_equal(fast.lines, usual.lines)


@pytest.mark.parametrize(
    ("place", "by"),
    [
        (-3, b"x"),
        (-3, b"\n\n"),
        (-3, b"#"),
        (-3, b",,"),
        (-3, b"1e400"),
        (5000, b"\n# a comment\n"),
        (-200, b'"'),
    ],
)
def test_what_is_no_plain_table_goes_the_usual_way(place: int, by: bytes) -> None:
    content = grid_text(50, 40)
    assert read_numeric_table(content[:place] + by + content[place:], "map.csv") is None
    assert read_numeric_table(grid_text(50, 40, ";").replace(b".", b","), "map.csv") is None
    assert read_numeric_table(grid_text(4, 4), "map.csv") is None


def test_texts_above_their_limits_are_refused_and_never_cut(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = grid_text(50, 40)
    assert read_flux_points(plain, "map.csv").i_d.size == 2000
    noted = plain.replace(b"\n", b",ok\n")
    monkeypatch.setattr(flux_map_files, "_MOST_TEXT", 50_000)
    with pytest.raises(
        InputError, match=r"is no table of plain numbers, of which at most 0\.05 MB can be read"
    ):
        read_flux_points(noted, "map.csv")
    monkeypatch.setattr(flux_map_files, "_MOST_PLAIN", 80_000)
    with pytest.raises(InputError, match=r"at most 0\.08 MB can be read"):
        read_flux_points(plain, "map.csv")


@pytest.mark.parametrize("low", [0.0, -130.0])
def test_maps_of_too_many_points_are_refused_with_the_limit(
    low: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(building, "MOST_NODES", 300)
    i_d, i_q = (
        x.ravel() for x in np.meshgrid(np.linspace(-150, 60, 18), np.linspace(low, 130, 17))
    )
    points = FluxPoints("map.csv", i_d, i_q, *MACHINE.flux(i_d, i_q))
    with pytest.raises(InputError, match="at most 300 can be used; save a coarser one"):
        build_flux_map(points)
    monkeypatch.setattr(building, "MOST_NODES", 18 * 33)
    assert build_flux_map(points).flux_map.i_d.size == 18


MEASURE = """
import sys
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.map_files import read_flux_points
from dqforge.machines.flux_maps.building import build_flux_map
try:
    build_flux_map(read_flux_points(open(sys.argv[1], "rb").read(), sys.argv[1]))
    print("read")
except InputError as error:
    print(error.message)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rows", "columns", "said"), [(700, 357, "read"), (1000, 1000, "the map has 1000000 points")]
)
def test_the_largest_maps_stay_within_a_gibibyte(
    tmp_path: Path, rows: int, columns: int, said: str
) -> None:
    place = tmp_path / "map.csv"
    place.write_bytes(grid_text(rows, columns))
    answer, peak = run_and_measure(MEASURE, str(place))
    assert answer.startswith(said)
    assert peak < GIBIBYTE
