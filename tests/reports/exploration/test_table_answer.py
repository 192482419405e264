"""What is found in a study, as table, JSON and CSV; and the same by DuckDB and Polars."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from study_blocks import OK, REFUSED, Rows, filled, header

from dqforge.machines.errors import InputError
from dqforge.reports.exploration.part_file import StoreError, part_name
from dqforge.reports.exploration.part_store import PartStore
from dqforge.reports.exploration.table_query import TableRequest, answer_table
from dqforge.reports.pages.templating import to_text

WHOLE = Rows(1050).rows(0, 1050)
TOTAL = WHOLE.columns["out.losses.total"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("study") / "out"
    filled(place).close()
    return place


def test_the_table_for_people(folder: Path) -> None:
    asked = TableRequest(
        "index, inverter.device, losses.*, gains.phase_margin, message",
        ("state = ok, refused",),
        "-inverter.switching_frequency",
        first=4,
    )
    (table,) = answer_table(folder, asked).tables
    matched = int(np.isin(WHOLE.states, [OK, REFUSED]).sum())
    assert table.title == f"Made up: 4 of {matched} rows"
    assert table.columns == (
        "index",
        "inverter.device",
        "losses.total",
        "losses.junction_temperature",
        "gains.phase_margin",
        "message",
    )
    assert [row[0] for row in table.rows] == ["19", "39", "59", "79"]
    losses = TOTAL[19]
    assert table.rows[0] == (
        "19",
        "infineon-ff200r12ke3",
        f"{losses:.5g} W",
        f"{40.0 + 0.1 * losses:.5g} degC",
        f"{np.rad2deg(WHOLE.columns['out.gains.phase_margin'][19]):.5g} deg",
        "",
    )
    assert table.notes == ()


def test_rows_without_numbers_have_empty_cells(folder: Path) -> None:
    asked = TableRequest("inverter.device", ("index = 5",))
    assert answer_table(folder, asked).tables[0].rows == (("",),)
    (table,) = answer_table(folder, TableRequest("losses.total, message", ("index = 3",))).tables
    assert table.rows == (("", "inverter.v_dc 500 V is above the 80 V"),)


def test_json_has_si_numbers_and_null(folder: Path) -> None:
    asked = TableRequest("index,losses.total,state,inverter.device,key", ("index >= 3",), first=3)
    answer = answer_table(folder, asked)
    plain = json.loads(to_text("explore", answer.name, answer.plain))
    assert (plain["rows"], plain["computed"], plain["matched"]) == (1050, 1050, 1047)
    assert plain["columns"][1] == {"name": "out.losses.total", "unit": "W"}
    assert plain["table"][0] == {
        "index": 3,
        "out.losses.total": None,
        "state": "refused",
        "in.inverter.device": "fuji-2mbi300xbe120-50",
        "key": bytes(WHOLE.keys[3]).hex(),
    }
    assert plain["table"][1]["out.losses.total"] == pytest.approx(TOTAL[4], rel=1e-8)
    assert plain["table"][2]["in.inverter.device"] is None


def test_csv_holds_every_row_with_every_digit(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "rows.csv"
    answer = answer_table(folder, TableRequest("index, losses.total, message", csv=place))
    with place.open(newline="", encoding="utf-8") as file:
        heads, *rows = csv.reader(file)
    assert heads == ["index", "out.losses.total [W]", "message"]
    assert [int(row[0]) for row in rows] == list(range(1050))
    assert np.array_equal([float(row[1] or "nan") for row in rows], TOTAL, equal_nan=True)
    assert rows[3][2] == WHOLE.messages[3]
    assert answer.plain == {"csv": str(place), "written": 1050}
    assert answer.notes == (f"written: {place} (1050 rows)",)


@pytest.mark.parametrize(("first", "sort"), [(250, ""), (250, "-losses.total"), (None, "key")])
def test_csv_of_some_rows(folder: Path, tmp_path: Path, first: int | None, sort: str) -> None:
    place = tmp_path / "rows.csv"
    place.write_bytes(b"old")
    request = TableRequest("index", ("losses.total > 0",), sort, first, place)
    answer_table(folder, request)
    lines = place.read_text().splitlines()[1:]
    there = np.flatnonzero(~np.isnan(TOTAL))
    wanted = there if not sort else there[np.argsort(-TOTAL[there])]
    if sort == "key":
        wanted = np.array(sorted(there, key=lambda row: bytes(WHOLE.keys[row])))
    assert [int(line) for line in lines] == wanted[:first].tolist()
    assert [path.name for path in tmp_path.iterdir()] == ["rows.csv"]


def test_files_that_cannot_be_written(folder: Path, tmp_path: Path) -> None:
    for place, reason in (
        (tmp_path, "it is a folder"),
        (tmp_path / "no" / "rows.csv", "there is no folder"),
    ):
        with pytest.raises(InputError, match=f"cannot write {place}: {reason}"):
            answer_table(folder, TableRequest(csv=place))


def test_a_damaged_part_and_a_study_that_is_not_done(tmp_path: Path) -> None:
    filled(tmp_path / "out").close()
    path = tmp_path / "out" / "parts" / part_name(3)
    content = bytearray(path.read_bytes())
    content[1000] ^= 4
    path.write_bytes(content)
    place = tmp_path / "rows.csv"
    for request in (TableRequest(), TableRequest(csv=place)):
        with pytest.raises(StoreError) as caught:
            answer_table(tmp_path / "out", request)
        assert str(caught.value) == (
            f"{path}: it was changed since it was written; run the study again, which computes "
            "this part again"
        )
    assert not [entry for entry in tmp_path.iterdir() if entry.name != "out"]
    path.unlink()
    (table,) = answer_table(tmp_path / "out", TableRequest("index", ("losses.total < 0",))).tables
    assert (table.title, table.rows) == ("Made up: 0 of 0 rows", ())
    assert table.notes == ("950 of 1050 rows are computed",)


def test_a_study_without_any_part(tmp_path: Path) -> None:
    PartStore.open(tmp_path / "out", header()).close()
    answer = answer_table(tmp_path / "out", TableRequest())
    assert answer.plain["table"] == []
    assert answer.tables[0].notes == ("0 of 1050 rows are computed",)


def test_the_same_rows_by_duckdb_and_polars(folder: Path) -> None:
    """The lines of docs/studies/store.md."""
    import duckdb
    import polars

    page = Path(__file__).parents[3] / "docs" / "studies" / "store.md"
    text = page.read_text(encoding="utf-8").replace("out/study", str(folder))
    by_duckdb, by_polars = re.findall(r"```python\n((?:duckdb|pl)\..*?)```", text, re.S)
    rows = eval(by_duckdb, {"duckdb": duckdb}).fetchall()
    frame = eval(by_polars, {"pl": polars})
    asked = TableRequest(
        "index, inverter.device, losses.total", ("state = ok",), "losses.total", 20
    )
    own = [tuple(row.values()) for row in answer_table(folder, asked).plain["table"]]
    assert rows == own
    assert frame.rows() == own
