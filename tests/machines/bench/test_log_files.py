"""Logs as benches and controllers write them."""

from __future__ import annotations

import io
import sys
import tracemalloc
from collections.abc import Mapping, Sequence
from pathlib import Path

import nptdms
import numpy as np
import pytest

from dqforge.machines.bench.bench_file import LogFormat
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


def _tdms(channels: Mapping[str, np.ndarray], step: float | None = None) -> bytes:
    stream = io.BytesIO()
    clock = {} if step is None else {"wf_increment": step, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(stream) as writer:
        for name, values in channels.items():
            group, _, channel = name.rpartition("/")
            unit = {"unit_string": "A" if channel.startswith("i") else "V"}
            writer.write_segment(
                [nptdms.ChannelObject(group or "log", channel, values, properties=unit | clock)]
            )
    return stream.getvalue()


def _mdf(tmp_path: Path, groups: Sequence[tuple[np.ndarray, Mapping[str, np.ndarray]]]) -> bytes:
    import asammdf

    with asammdf.MDF(version="4.10") as log:
        for times, channels in groups:
            log.append(
                [
                    asammdf.Signal(values, times, name=name, unit="A" if name[0] == "i" else "V")
                    for name, values in channels.items()
                ]
            )
        return Path(log.save(tmp_path / "log.mf4")).read_bytes()


def test_channels_of_tdms() -> None:
    currents, voltages = np.array([1.0, 2.0, 4.0]), np.array([3, 2, 1], dtype=np.int16)
    table = read_log(_tdms({"i_q": currents, "u_q": voltages}, 0.5), "log.tdms", "auto")
    assert (table.names, table.units) == (("time", "i_q", "u_q"), ("s", "A", "V"))
    assert np.array_equal(table.values.T, np.stack([np.arange(3) / 2, currents, voltages]))
    plain = read_log(_tdms({"a/i_q": currents, "b/i_q": voltages}), "log.tdms", "auto")
    assert plain.names == ("a/i_q", "b/i_q")


def test_channels_of_mdf(tmp_path: Path) -> None:
    times = np.array([0.0, 0.1, 0.3])
    columns = {"i_q": np.array([1.5, 2.5, 3.5], dtype=np.float32), "u_q": np.array([7, 8, 9])}
    slow = np.array([0.0, 1.0]), {"temperature": np.array([20.0, 21.0])}
    content = _mdf(tmp_path, [(times, columns), slow])
    table = read_log(content, "log.mf4", "auto")
    assert (table.names, table.units) == (("time", "i_q", "u_q"), ("s", "A", "V"))
    assert np.array_equal(table.values.T, np.stack([times, columns["i_q"], columns["u_q"]]))
    assert table.others == ("temperature",)
    assert read_log(content, "log.mf4", "mdf", {"temperature"}).names == ("time", "temperature")
    with pytest.raises(InputError, match="i_q and temperature were not sampled at the same times"):
        read_log(content, "log.mf4", "mdf", {"temperature", "i_q"})


@pytest.mark.parametrize(
    ("module", "form", "name"), [("asammdf", "mdf", "MDF"), ("nptdms", "tdms", "TDMS")]
)
def test_recorders_damaged_or_without_their_library(
    monkeypatch: pytest.MonkeyPatch, module: str, form: LogFormat, name: str
) -> None:
    with pytest.raises(InputError, match=f"cannot read this {name} file"):
        read_log(b"MDF     4.10    TDSm" + bytes(300), "log", form)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as caught:
        read_log(b"", "log", form)
    wanted = f"reading {name} needs {module}; install it with: pip install dqforge[logs]"
    assert caught.value.message == wanted
