"""Logs as benches and controllers write them."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.bench.log_files import read_log
from dqforge.machines.errors import InputError
from dqforge.machines.files import text_table


def test_cells_as_numpy_prints_them(shared_data: Path) -> None:
    path = shared_data / "bench/ultrazohm/hdm06-005_plus1000rpm_u_d_V.csv"
    table = read_log(path.read_bytes(), path.name, "text")
    lines = path.read_text().splitlines()[1:]
    wanted = [
        [float(cell.removeprefix("np.float64(").removesuffix(")")) for cell in line.split(",")]
        for line in lines
    ]
    assert np.array_equal(table.values, wanted)
    assert table.names[0].startswith("encoder_offset_rad")


def test_rows_that_end_with_a_semicolon(shared_data: Path) -> None:
    path = shared_data / "bench/labmrd/step1.csv"
    table = read_log(path.read_bytes(), path.name, "text")
    assert table.names == ("column 1", "column 2", "column 3", "column 4")
    assert table.values[0].tolist() == [2.0, 0.0, -0.16394783556461334, 0.0]


def test_a_semicolon_that_parts_columns_is_kept() -> None:
    table = read_log(b"a;b\n1,5;2\n3;4,5\n", "log.csv", "auto")
    assert table.values.tolist() == [[1.5, 2.0], [3.0, 4.5]]


def test_bursts_of_motortest(shared_data: Path) -> None:
    path = shared_data / "bench/motorTest/V2207_1500KV_results_cd37f24.json"
    table = read_log(path.read_bytes(), path.name, "motortest")
    assert table.values.shape == (704, 10)
    assert table.said["kv"][0] == 1500.0


@pytest.mark.parametrize("form", ["moteus-ld", "motortest"])
def test_other_json_is_refused(form: str) -> None:
    with pytest.raises(InputError, match="no "):
        read_log(b'{"raw": 3}', "log.json", form)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no JSON"):
        read_log(b"a,b\n1,2", "log.json", form)  # type: ignore[arg-type]


def test_vectors_of_an_archive(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, i_q=np.arange(4.0), u_q=np.arange(4.0) + 1.0, other=np.zeros((2, 2)), one=3.0)
    table = read_log(path.read_bytes(), "log.npz", "auto")
    assert dict(zip(table.names, table.values.T.tolist(), strict=True)) == {
        "i_q": [0.0, 1.0, 2.0, 3.0],
        "u_q": [1.0, 2.0, 3.0, 4.0],
    }


def test_parquet(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = {"i": [1.0, 2.0], "text": ["a", "b"], "u": [3, 4]}
    parquet.write_table(arrow.table(columns), tmp_path / "log.parquet")
    table = read_log((tmp_path / "log.parquet").read_bytes(), "log.parquet", "auto")
    assert table.names == ("i", "u")
    assert table.values.tolist() == [[1.0, 3.0], [2.0, 4.0]]


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of a tenth, so that a short log is read as a long one."""
    for name, size in (("LARGE", 800_000), ("_HEAD", 1 << 15), ("_BLOCK", 1 << 17)):
        monkeypatch.setattr(text_table, name, size)


def _ride(rows: int, *, short: int | None = None) -> bytes:
    """A log of 57 columns parted by semicolons, each of one digit and a sign; ``short`` is a row
    with one cell less.
    """
    head = ";".join(["i_q", "erpm", *(f"c{place}" for place in range(55))])
    cells = [";".join([str(row % 97), str(row % 89), *["-1"] * 55]) for row in range(89 * 97)]
    lines = (cells * (rows // len(cells) + 1))[:rows]
    if short is not None:
        lines[short] = lines[short].rpartition(";")[0]
    return "\n".join([head, *lines, ""]).encode()


def test_a_long_ride_takes_the_memory_of_the_columns_asked_for(
    small_blocks: None,
) -> None:
    rows = 10_000
    content = _ride(rows)
    tracemalloc.start()
    table = read_log(content, "ride.csv", "text", {"i_q", "erpm [rpm]", "erpm"})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert table.names == ("i_q", "erpm")
    assert table.others[-1] == "c54"
    count = np.arange(rows)
    assert np.array_equal(table.values, np.column_stack([count, count]) % [97, 89])
    assert table.lines[-1] == rows + 1
    # All columns would be 4.6 MB; two are 0.2 MB beside the first lines and blocks of text.
    assert peak < 4e6


def test_a_cell_that_lacks_in_a_long_ride_is_named_whatever_is_asked_for(
    small_blocks: None,
) -> None:
    rows = 10_000
    with pytest.raises(InputError, match="56 columns") as caught:
        read_log(_ride(rows, short=8_000), "ride.csv", "text", {"i_q"})
    assert caught.value.line == 8_002


def test_a_log_without_the_columns_asked_for_names_those_it_has() -> None:
    table = read_log(b"a,b\n1,2\n3,4\n", "log.csv", "text", {"c"})
    assert table.names == ("a", "b")
