"""Rows that are looked for in a study: every condition against numpy, whatever the parts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_blocks import DEVICES, Rows, filled, header

from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.reports.exploration import table_query as table_rows
from dqforge.reports.exploration.part_file import part_name
from dqforge.reports.exploration.part_store import PartStore
from dqforge.reports.exploration.table_query import FoundRows, find_rows, read_query, short_name

COUNT = 1050
WHOLE = Rows(COUNT).rows(0, COUNT)
INDEX = np.arange(COUNT)
TOTAL = WHOLE.columns["out.losses.total"]
FREQUENCY = WHOLE.columns["in.inverter.switching_frequency"]
DEVICE = WHOLE.columns["in.inverter.device"]
MARGIN = WHOLE.columns["out.gains.phase_margin"]
CROSSOVER = WHOLE.columns["out.gains.i_d.crossover"]
JUNCTION = WHOLE.columns["out.losses.junction_temperature"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> PartStore:
    with filled(tmp_path_factory.mktemp("study") / "out") as found:
        return found


def asked(
    store: PartStore, where: str = "", sort: str = "", first: int | None = None, table: str = "key"
) -> FoundRows:
    conditions = [where] if where else []
    return find_rows(store, read_query(store.header, table, conditions, sort, first))


@pytest.mark.parametrize(
    ("where", "rows"),
    [
        ("losses.total < 600 W", TOTAL < 600.0),
        ("losses.total<0.6 kW and losses.total >= 500", (TOTAL < 600.0) & (TOTAL >= 500.0)),
        ("out.losses.total > 6e2", TOTAL > 600.0),
        ("losses.total != 0", ~np.isnan(TOTAL)),
        ("inverter.switching_frequency = 16 kHz", FREQUENCY == 16000.0),
        ("in.inverter.switching_frequency==16000.000001", FREQUENCY == 16000.0),
        ("inverter.switching_frequency < 16 kHz", FREQUENCY < 16000.0),
        ("inverter.switching_frequency <= 16.0000000001 kHz", FREQUENCY <= 16000.0),
        ("gains.phase_margin > 72 deg", np.deg2rad(72.0) < MARGIN),
        ("gains.i_d.crossover > 478 Hz", 2.0 * np.pi * 478.0 < CROSSOVER),
        ("losses.junction_temperature < 100 degC", JUNCTION < 100.0),
        ("gains.i_d.stable = 0", WHOLE.columns["out.gains.i_d.stable"] == 0.0),
        ("state = ok", WHOLE.states == STATES.index("ok")),
        ("state != ok", WHOLE.states != STATES.index("ok")),
        ("state = ok, limit AND index >= 1000", (WHOLE.states < 2) & (INDEX >= 1000)),
        (f"inverter.device = {DEVICES[1]}", DEVICE == 1),
        ("inverter.device = *2*", DEVICE >= 0),
        ("inverter.device != fuji*, wolf*", DEVICE == 1),
        ("message = *above the 80 V*", WHOLE.states == STATES.index("refused")),
        ("message != *", np.zeros(COUNT, dtype=bool)),
        ("index = 17", INDEX == 17),
        (f"key = {bytes(WHOLE.keys[17]).hex()}", INDEX == 17),
        ("key = *00*", np.array(["00" in bytes(key).hex() for key in WHOLE.keys])),
    ],
)
def test_conditions(store: PartStore, where: str, rows: np.ndarray) -> None:
    found = asked(store, where)
    assert found.cells["index"].tolist() == INDEX[rows].tolist()
    assert (found.matched, found.there, found.count) == (int(rows.sum()), COUNT, COUNT)
    keys = [bytes(key).hex() for key in WHOLE.keys[rows]]
    assert found.cells["key"].tolist() == keys


@pytest.mark.parametrize("first", [1, 20, 333, None])
@pytest.mark.parametrize("sign", ["", "-"])
def test_order(store: PartStore, first: int | None, sign: str) -> None:
    """What does not exist comes last, and equal rows by their index."""
    found = asked(store, sort=f"{sign}losses.total", first=first, table="losses.total")
    key = np.where(np.isnan(TOTAL), np.inf, -TOTAL if sign else TOTAL)
    order = np.lexsort([INDEX, key])[:first]
    assert found.cells["index"].tolist() == order.tolist()
    assert found.matched == COUNT


def test_order_by_words_and_texts(store: PartStore) -> None:
    found = asked(store, "state = ok", "inverter.device, -inverter.switching_frequency", 50)
    ok = np.flatnonzero(WHOLE.states == STATES.index("ok"))
    key = np.where(DEVICE[ok] < 0, 99, DEVICE[ok])
    order = ok[np.lexsort([ok, -FREQUENCY[ok], key])][:50]
    assert found.cells["index"].tolist() == order.tolist()
    keys = np.array([bytes(key).hex() for key in WHOLE.keys])
    assert asked(store, "", "-key", 9).cells["key"].tolist() == sorted(keys, reverse=True)[:9]


def test_rows_of_a_study_that_is_not_done(tmp_path: Path) -> None:
    with filled(tmp_path / "out") as whole:
        for number in (0, 4):
            (tmp_path / "out" / "parts" / part_name(number)).unlink()
        found = asked(whole, "index < 100", table="losses.total")
        assert (found.matched, found.there, found.count, found.shown) == (0, 850, 1050, 0)
    with PartStore.open(tmp_path / "new", header()) as empty:
        found = asked(empty, sort="-losses.total", table="losses.total")
    assert (found.matched, found.there, found.count, found.shown) == (0, 0, 1050, 0)


def test_columns(store: PartStore) -> None:
    read = store.header
    assert read_query(read, "losses.*").columns == (
        "out.losses.total",
        "out.losses.junction_temperature",
    )
    assert read_query(read, " index ,in.*, index").columns == (
        "index",
        "in.inverter.switching_frequency",
        "in.inverter.device",
    )
    assert len(read_query(read, "*").columns) == 11
    assert read_query(read).columns == (
        "index",
        "state",
        "in.inverter.switching_frequency",
        "in.inverter.device",
        "out.losses.total",
    )
    assert short_name(read, "out.losses.total") == "losses.total"
    assert read_query(read, "key", ["losses.total < 1"], "index").needed == (
        "key",
        "out.losses.total",
        "index",
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"table": "losses.totl"},
            "--table: the study has no column 'losses.totl'; did you mean losses.total?",
        ),
        (
            {"table": "qqqqqq"},
            "--table: the study has no column 'qqqqqq'; write one of: index, key,",
        ),
        ({"table": "x*"}, "--table: the study has no column like 'x*'"),
        ({"sort": "lossestotal"}, "--sort: the study has no column 'lossestotal'"),
        (
            {"where": ["losses.total"]},
            "--where: 'losses.total' is not a condition; write e.g. --where",
        ),
        ({"where": ["losses.total <"]}, "--where: 'losses.total <' is not a condition"),
        ({"where": [""]}, "--where: '' is not a condition"),
        ({"where": ["state = ok and"]}, "--where: state is never 'ok and'"),
        (
            {"where": ["losses.total < 5 A"]},
            "--where losses.total: expected a power such as '2.2 kW', got '5 A'",
        ),
        ({"where": ["losses.total < nan"]}, "--where losses.total: 'nan' is not a finite number"),
        ({"where": ["losses.total < 1 + 1"]}, "--where losses.total: "),
        ({"where": ["state < ok"]}, "--where: state holds words; write = or != before them"),
        ({"where": ["state = okay"]}, "--where: state is never 'okay'; did you mean ok?"),
        ({"where": ["inverter.device = abb*"]}, "--where: inverter.device is never 'abb*'; write"),
        ({"first": 0}, "--first 0: write a number of rows from 1 on"),
        ({"where": ["__import__('os') = 1"]}, "--where: the study has no column"),
        ({"where": ["message = ,"]}, "--where: 'message = ,' is not a condition"),
    ],
)
def test_what_is_not_understood(store: PartStore, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_query(store.header, **options)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_more_rows_than_can_be_sorted(store: PartStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_rows, "MOST_SORTED", 100)
    with pytest.raises(InputError, match="1050 rows match, of which 100 can be sorted"):
        asked(store, sort="losses.total")
    with pytest.raises(InputError, match="--first 101: a table has at most 100 rows"):
        asked(store, first=101)
    assert asked(store, sort="losses.total", first=100).shown == 100
    assert asked(store).shown == 100
