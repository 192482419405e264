"""The comparison of estimators and start-ups as tables of the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.observers.judgement import ANGLE_LIMIT, SPEED_LIMIT
from dqforge.reports.estimator_comparison.pair_words import (
    cell_name,
    held_text,
    hertz,
    load_name,
    pair_lines,
    rpm,
)
from dqforge.reports.observers.position_header import dead_time_text, error_text
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart
    from dqforge.optimizer.estimator_comparison.sensitivity import Slopes
    from dqforge.optimizer.estimator_comparison.solve import EstimatorComparison

_AT = (0.1, 0.5, 1.0)  # speeds of the first table over the largest one

_SENSITIVE_AT = (0.1, 0.5)

_NEAR = 0.3  # of a speed, within which a slope counts as there

_CAUSES = {
    "r_s": ("R +10 %", 0.1),
    "l_d": ("L_d +10 %", 0.1),
    "l_q": ("L_q +10 %", 0.1),
    "psi_pm": ("psi +10 %", 0.1),
    "dead_time": ("1 V of dead time", 1.0),
}


def estimator_tables(design: Design, found: EstimatorComparison) -> list[Table]:
    """All tables.

    Args:
        design: The drive.
        found: The comparison.
    """
    known = any(row.figures is not None for row in found.estimators)
    tables = [_estimators(design, found)]
    tables += [_sensitivities(found), _winners(found)] if known else []
    tables += [_starts(found)] if any(row.figures for row in found.starts) else []
    refused = _refused(found)
    return [*tables, refused] if refused.rows else tables


def _degrees(values: FloatArray, reached: FloatArray) -> str:
    """Largest error over the loads that are reached."""
    worst = float(np.max(np.where(reached, values, 0.0)))
    return f"{math.degrees(worst):.3g}" if math.isfinite(worst) else "lost"


def _row(found: EstimatorComparison, row: ComparedEstimator) -> tuple[str, ...]:
    figures, asked = row.figures, found.asked
    assert figures is not None
    at = [int(np.argmin(np.abs(asked.omega / asked.omega_max - share))) for share in _AT]
    quiet = 0 if row.candidate.from_standstill else at[1]
    capture = figures.capture
    return (
        row.candidate.name,
        held_text(row, asked.omega_max),
        *(_degrees(figures.angle[s], asked.reached[s]) for s in at),
        _degrees(figures.noise[quiet], asked.reached[quiet]),
        "" if figures.left is None else hertz(figures.left),
        "" if capture is None else f"{100.0 * float(np.mean(capture.share)):.0f}",
        "" if row.cycles is None else f"{0.5 * sum(row.cycles):.0f}",
        "" if row.flash is None else str(row.flash),
        "flash this"
        if row.candidate.name in {found.pair.at_speed, found.pair.from_standstill}
        else "",
    )


def _estimators(design: Design, found: EstimatorComparison) -> Table:
    columns = (
        "estimator",
        "holds, Hz",
        *(f"deg at {100.0 * share:.0f} %" for share in _AT),
        "noise deg",
        "speed loop Hz",
        "starts %",
        "cycles",
        "bytes",
        "",
    )
    rows = tuple(_row(found, row) for row in found.estimators if row.figures is not None)
    title = f"{design.name}: estimators of the position"
    if not rows:
        return Table(title, notes=pair_lines(found.asked, found.pair))
    known = found.asked.disturbances
    wrong = ", ".join(
        f"{symbol} {error_text(known, name)}"
        for symbol, name in (("R", "r_s"), ("L", "l_q"), ("psi", "psi_pm"))
    )
    notes = [
        *pair_lines(found.asked, found.pair),
        (
            f"deg: r.m.s. of {wrong} wrong, {dead_time_text(known)} and noise, at the worst load; "
            f"holds: below {math.degrees(ANGLE_LIMIT):.3g} deg and {100.0 * SPEED_LIMIT:.3g} % of "
            "the speed at every load"
        ),
        "speed loop: crossover that the lag leaves; starts: share of wrong starts that lock",
        f"cycles and bytes of a step on the {design.fit.core}"
        if not found.uncounted
        else f"no cycles: {found.uncounted}",
    ]
    return Table(title, columns, rows, tuple(notes))


def _slope(slopes: Slopes, cause: str, share: float, omega_max: float) -> str:
    gap = np.abs(slopes.omega / omega_max - share)
    at = int(np.argmin(gap))
    if gap[at] > _NEAR * share:
        return "-"
    value = float(slopes.angle[cause][at]) * _CAUSES[cause][1]
    # Adding zero turns -0 into 0.
    return f"{round(math.degrees(value), 3) + 0.0:+.3g}" if math.isfinite(value) else "lost"


def _sensitivities(found: EstimatorComparison) -> Table:
    omega_max = found.asked.omega_max
    rows = []
    for row in found.estimators:
        slopes = None if row.figures is None else row.figures.slopes
        if slopes is not None:
            cells = [
                ", ".join(_slope(slopes, cause, share, omega_max) for share in _SENSITIVE_AT)
                for cause in _CAUSES
            ]
            rows.append((row.candidate.name, *cells))
    at = " and ".join(f"{100.0 * share:.0f} %" for share in _SENSITIVE_AT)
    columns = ("estimator", *(label for label, _ in _CAUSES.values()))
    notes = (f"at {at} of the speed, half the largest torque; by the slope at exact data",)
    return Table("What the angle errs by in deg (electrical)", columns, tuple(rows), notes)


def _winners(found: EstimatorComparison) -> Table:
    asked = found.asked
    pairs = asked.design.machine.pole_pairs
    rows = tuple(
        (
            hertz(omega),
            rpm(omega, pairs),
            *(cell_name(found, s, m) for m in range(len(asked.shares))),
        )
        for s, omega in reversed(list(enumerate(asked.omega.tolist())))
    )
    columns = ("Hz", "speed", *(load_name(share) for share in asked.shares.tolist()))
    notes = ("least r.m.s. error of the angle in deg among those that hold; -: none does",)
    return Table("Who wins where", columns, rows, notes)


def _start_row(found: EstimatorComparison, row: ComparedStart) -> tuple[str, ...]:
    figures = row.figures
    assert figures is not None
    pairs = found.asked.design.machine.pole_pairs
    rates = ", ".join(f"{100.0 * part.rate:.0f}" for part in figures.tried)
    return (
        row.candidate.name,
        f"{figures.largest_load:.3g}",
        rpm(figures.hand_over, pairs),
        f"{figures.duration:.2g}",
        rates or figures.untried,
        "flash this" if row.candidate.name == found.pair.start else "",
    )


def _starts(found: EstimatorComparison) -> Table:
    columns = ("start-up", "largest load N m", "hands over at", "after s", "succeed %", "")
    rows = tuple(_start_row(found, row) for row in found.starts if row.figures is not None)
    tried = next((row.figures.tried for row in found.starts if row.figures), ())
    notes: tuple[str, ...] = ()
    if tried:
        loads = ", ".join(f"{100.0 * part.load:.0f} %" for part in tried)
        of = f"succeed: of {tried[0].count} starts each at {loads} of the torque of the limit"
        notes = (f"{of} as friction, with machines drawn from the tolerances, at any angle",)
    return Table("Start-ups", columns, rows, notes)


def _refused(found: EstimatorComparison) -> Table:
    every: tuple[ComparedEstimator | ComparedStart, ...] = (*found.estimators, *found.starts)
    rows = tuple((row.candidate.name, row.refusal) for row in every if row.refusal)
    return Table("Not for this drive", ("", "because"), rows)
