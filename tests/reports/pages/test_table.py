"""Tables on narrow terminals: no number is parted from itself or its unit, nothing gets lost."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.reports.answers import check, fit, losses, mtpa, tune
from dqforge.reports.pages import answer
from dqforge.reports.pages.answer import Answer, Table, fitted

WIDTHS = (80, 100, 120, 160, 200)
NUMBERS = st.from_regex(
    r"-?[0-9]{1,4}\.[0-9]{1,6}(e-0[1-9])?( (V/A|N m s/rad|Hz|deg))?", fullmatch=True
)
WORDS = st.text("abcdefghij", min_size=1, max_size=9)
SENTENCES = st.lists(WORDS | NUMBERS, min_size=5, max_size=20).map(" ".join)


COLUMNS = st.lists(
    st.tuples(WORDS, st.sampled_from((NUMBERS, NUMBERS, WORDS, SENTENCES))), min_size=1, max_size=9
)


@st.composite
def tables(draw: st.DrawFn) -> Table:
    columns, kinds = zip(*draw(COLUMNS), strict=True)
    rows = draw(st.lists(st.tuples(*kinds), min_size=1, max_size=6))
    return Table("title", columns, tuple(rows), (draw(SENTENCES),))


def printed(table: Table, width: int, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Lines that a pipe of a width gets."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(answer, "_PIPE_WIDTH", width)
        answer.show([table])
    return capsys.readouterr().out.splitlines()


def numbers_of(table: Table) -> list[str]:
    """Short cells that hold a digit: values with their units."""
    cells = [cell for row in table.rows for cell in row]
    return [cell for cell in cells if len(cell) <= 24 and any(map(str.isdigit, cell))]


def lost(table: Table, lines: list[str]) -> list[str]:
    """Values that no line holds whole."""
    return [cell for cell in numbers_of(table) if not any(cell in line for line in lines)]


@settings(max_examples=60)
@given(tables(), st.sampled_from(WIDTHS))
def test_generated_tables_keep_their_numbers(table: Table, width: int) -> None:
    parts = fitted(table, width)
    for part in parts:
        columns = [
            [*part.columns[k : k + 1], *(row[k] for row in part.rows)]
            for k in range(len(part.columns))
        ]
        widths = [
            max(len(line) for cell in column for line in cell.split("\n")) for column in columns
        ]
        assert sum(widths) + 3 * len(widths) - 1 <= width
    shown = [cell for part in parts for row in (part.columns, *part.rows) for cell in row]
    lines = [line for cell in shown for line in cell.split("\n")]
    assert lost(table, lines) == []
    whole = {"".join(cell.split()) for cell in shown}
    assert {"".join(cell.split()) for row in table.rows for cell in row} <= whole


def test_a_row_becomes_a_column_where_few_rows_are_too_wide() -> None:
    columns = ("loop", *(f"quantity {k}" for k in range(9)))
    table = Table("gains", columns, tuple((name, *["0.095493 N m s/rad"] * 9) for name in "dq"))
    (turned,) = fitted(table, 80)
    assert turned.columns == ("loop", "d", "q")
    assert [row[0] for row in turned.rows] == list(columns[1:])
    assert fitted(table, 300) == [table]


def test_many_rows_are_parted_behind_their_first_column() -> None:
    columns = tuple(f"c{k}" for k in range(12))
    table = Table(
        "t", columns, tuple(tuple(f"{r}.{k:07d}" for k in range(12)) for r in range(9)), ("n",)
    )
    parts = fitted(table, 80)
    assert [part.columns[0] for part in parts] == ["c0"] * len(parts)
    assert sum((part.columns[1:] for part in parts), ()) == columns[1:]
    assert [part.notes for part in parts] == [()] * (len(parts) - 1) + [("n",)]
    assert [part.title for part in parts] == ["t"] + [""] * (len(parts) - 1)


MTPA = (None, None, None, "svpwm", "0 %", "copper")
ANSWERS: dict[str, Callable[[Design], Answer]] = {
    "check": check.answer_check,
    "tune": tune.answer_tune,
    "fit": fit.answer_fit,
    "mtpa": lambda design: mtpa.answer_mtpa(design, mtpa.Request(*MTPA)),
    "losses": lambda design: losses.answer_losses(design, losses.LossRequest(), choice=False),
}


@pytest.mark.thinned
@pytest.mark.parametrize("name", catalogue.names())
def test_every_drive_reads_well_at_every_width(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    design = catalogue.load(name)
    for ask in ANSWERS.values():
        try:
            shown = ask(design).tables
        except DqforgeError:
            continue  # nothing of the kind in this design
        for table in shown:
            for width in WIDTHS:
                lines = printed(table, width, capsys)
                assert max(map(len, lines)) <= width
                assert lost(table, lines) == []
