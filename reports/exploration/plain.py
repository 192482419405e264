"""What the rows of a study say together, as JSON holds it: SI units, every digit."""

from __future__ import annotations

from dqforge.optimizer.study_results.acceptance import WorstRow
from dqforge.optimizer.study_results.histograms import Histogram
from dqforge.optimizer.study_results.intervals import Share
from dqforge.reports.exploration.study_view import StudyView
from dqforge.reports.plain_data import PlainData, finite
from dqforge.reports.study_store.column_texts import label
from dqforge.reports.study_store.summary_files import plain_sensitivities

QUANTILES = (0.01, 0.05, 0.5, 0.95, 0.99)


def plain_summary(view: StudyView) -> PlainData:
    """Shares with their intervals, the worst rows, the front, sensitivities and spreads.

    Args:
        view: The study.
    """
    summary, question = view.summary, view.question
    tally = summary.acceptance
    ranges = [
        {
            "output": each.label,
            "column": each.column,
            "below": each.below,
            "above": each.above,
            **_share(tally.share(place)),
            "worst": _worst(view, tally.worst[place] if tally.worst else None),
        }
        for place, each in enumerate(question.accept)
    ]
    return {
        "acceptance": {"ranges": ranges, "all": _share(tally.share_of_all())} if ranges else None,
        "front": _front(view),
        "sensitivities": [plain_sensitivities(each) for each in summary.sensitivities],
        "spread": [
            {"column": name} | _spread(histogram)
            for name, histogram in zip(question.spread, summary.spread, strict=True)
        ],
    }


def _share(share: Share) -> PlainData:
    low, high = share.interval
    return {
        "met": share.met,
        "rows": share.count,
        "share": finite(share.value),
        "interval": [low, high],
        "confidence": share.confidence,
    }


def _worst(view: StudyView, row: WorstRow | None) -> PlainData | None:
    if row is None:
        return None
    inputs: PlainData = {}
    for name, value in row.inputs.items():
        spec = view.spec(name)
        word = spec.kind == "choice"
        inputs[label(name)] = spec.choices[int(value)] if word and value >= 0 else finite(value)
    return {"row": row.index, "value": row.value, "inputs": inputs}


def _front(view: StudyView) -> PlainData | None:
    front = view.summary.front
    if front is None:
        return None
    signs = [1.0 if goal.minimise else -1.0 for goal in view.question.goals]
    return {
        "goals": [
            {"column": goal.column, "minimise": goal.minimise} for goal in view.question.goals
        ],
        "rows": front.index.tolist(),
        "values": [
            [sign * value for sign, value in zip(signs, row, strict=True)]
            for row in front.goals.tolist()
        ],
    }


def _spread(histogram: Histogram) -> PlainData:
    return {
        "rows": histogram.rows,
        "unknown": histogram.unknown,
        "least": finite(histogram.least),
        "largest": finite(histogram.largest),
        "quantiles": [[share, finite(histogram.quantile(share))] for share in QUANTILES],
    }
