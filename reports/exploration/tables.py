"""Tables of a study for the terminal."""

from __future__ import annotations

import numpy as np

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.study_results.acceptance import AcceptedRange
from dqforge.optimizer.study_results.intervals import Share
from dqforge.reports.exploration.study_view import StudyView
from dqforge.reports.pages.table import Table
from dqforge.reports.study_store.column_texts import label, value_text

MOST_ROWS = 20  # Rows of the front that a terminal shows.


def study_tables(view: StudyView) -> list[Table]:
    """Every table that the study has something to say in.

    Args:
        view: The study.
    """
    found = [acceptance_table(view), front_table(view), sensitivity_table(view), audit_table(view)]
    return [table for table in found if table is not None]


def acceptance_table(view: StudyView) -> Table | None:
    """Shares that are accepted, None where nothing is asked.

    Args:
        view: The study.
    """
    tally, ranges = view.summary.acceptance, view.question.accept
    if not ranges:
        return None
    rows = []
    for place, each in enumerate(ranges):
        worst = tally.worst[place] if tally.worst else None
        spec = view.spec(each.column)
        rows.append(
            (
                each.label,
                range_text(view, each),
                *share_cells(tally.share(place)),
                "" if worst is None else value_text(spec, worst.value),
                "" if worst is None else f"{worst.index}",
            )
        )
    rows.append(("all of them", "", *share_cells(tally.share_of_all()), "", ""))
    heads = ("accepted", "bound", "share", "95 % interval", "worst", "row")
    return Table("Yield", heads, tuple(rows))


def range_text(view: StudyView, accepted: AcceptedRange) -> str:
    """Bounds of what is accepted.

    Args:
        view: The study.
        accepted: One range.
    """
    spec = view.spec(accepted.column)
    texts = [] if accepted.above is None else [f"above {value_text(spec, accepted.above)}"]
    texts += [] if accepted.below is None else [f"below {value_text(spec, accepted.below)}"]
    return " and ".join(texts)


def rows_text(count: int) -> str:
    """So many rows.

    Args:
        count: How many.
    """
    return "1 row" if count == 1 else f"{count} rows"


def share_cells(share: Share) -> tuple[str, str]:
    """A share and its interval in percent.

    Args:
        share: Rows that are accepted.
    """
    low, high = share.interval
    ends = f"{100.0 * low:.2f} to {100.0 * high:.2f} %"
    return (f"{100.0 * share.value:.2f} %" if share.count else "", ends)


def front_table(view: StudyView) -> Table | None:
    """The front by its first goal, None where there is none.

    Args:
        view: The study.
    """
    front, goals = view.summary.front, view.question.goals
    if front is None:
        return None
    signs = [1.0 if goal.minimise else -1.0 for goal in goals]
    specs = [view.spec(goal.column) for goal in goals]
    there = {int(row): place for place, row in enumerate(view.pictured.index.tolist())}
    order = sorted(range(front.count), key=lambda each: (*front.goals[each].tolist(), each))
    rows = []
    for each in order[:MOST_ROWS]:
        values = front.goals[each].tolist()
        goal_cells = [
            value_text(spec, sign * value)
            for spec, sign, value in zip(specs, signs, values, strict=True)
        ]
        place = there.get(int(front.index[each]))
        inputs = [
            "" if place is None else value_text(spec, view.pictured.columns[spec.name][place])
            for spec in view.varied
        ]
        rows.append((str(int(front.index[each])), *goal_cells, *inputs))
    heads = ("row", *(label(goal.column) for goal in goals), *(label(s.name) for s in view.varied))
    more = front.count - len(rows)
    notes = (f"{more} more rows lie on the front",) if more > 0 else ()
    return Table(f"Front of {rows_text(front.count)}", heads, tuple(rows), notes)


def sensitivity_table(view: StudyView) -> Table | None:
    """Sensitivities of every output asked for, None where none is.

    Args:
        view: The study.
    """
    found = view.summary.sensitivities
    if not found:
        return None
    total = any(each.total is not None for each in found)
    rows = []
    for each in found:
        for place, name in enumerate(each.inputs):
            cells = [_index(each.first[place]), _index(each.squared_correlation[place])]
            if total:
                cells.insert(1, "" if each.total is None else _index(each.total[place]))
            rows.append((label(each.output), label(name), *cells))
    heads = ("output", "input", "first order", *(("total",) * total), "squared correlation")
    return Table("Sensitivities", heads, tuple(rows))


def _index(value: float) -> str:
    return "" if np.isnan(value) else f"{round(value, 3) + 0.0:.3f}"


def audit_table(view: StudyView) -> Table | None:
    """How far rows computed together lie from those computed one by one, None where none is.

    Args:
        view: The study.
    """
    if not view.audited:
        return None
    differing = {name: value for name, value in view.audited.items() if value != 0.0}
    rows = tuple((name, format_quantity(value, "", 2)) for name, value in differing.items())
    same = len(view.audited) - len(differing)
    said = "1 output does not" if same == 1 else f"{same} outputs do not"
    notes = [f"{said} differ in a single bit"] if same else []
    if any(name.startswith("fit.error.") for name in differing):
        notes.append(
            "fits end near the least error of the currents, each at another one: errors of "
            "currents may differ by a quarter, those of the torque by more"
        )
    return Table(
        "Largest deviation of rows computed together from rows computed alone, every 1,000th row",
        ("output", "relative") if rows else (),
        rows,
        tuple(notes),
    )
