"""What ``check`` and ``run`` say of a design in a few lines."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.design.plausibility.figures import MARK
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.losses.point_comparison import LossComparison
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.current_reference.data_text import data_lines
from dqforge.reports.current_reference.tables import POOR_FIT, poor_fit_text
from dqforge.reports.field_weakening.text import domain_text, errors_text, proof_text
from dqforge.reports.modulation_choice.text import choice_rows
from dqforge.reports.observers.speed_loop_text import loop_words
from dqforge.reports.pages.certificate_text import proven_text
from dqforge.reports.pages.labels import (
    operation_text,
)
from dqforge.reports.pages.table import Table
from dqforge.reports.simulation.number_format import format_text, not_simulated
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import verification_text


def check_tables(design: Design) -> list[Table]:
    """Every value with its origin, and what was assumed."""
    rows = tuple(
        (
            value.path,
            value.text,
            f"{value.si:.6g} {value.unit}".strip(),
            "inferred" if value.inferred else "",
            value.source,
        )
        for value in design.values
    )
    columns = ("key", "in the file", "in SI", "", "source")
    notes = tuple(
        sentence if sentence.startswith(MARK) else f"assumed: {sentence}"
        for sentence in design.assumptions
    )
    return [Table(f"{design.name}: valid", columns, rows, notes)]


def _errors_text(errors: ReferenceErrors) -> str:
    i_d, i_q = rounded_up(errors.i_d, 2), rounded_up(errors.i_q, 2)
    torque, loss = (
        rounded_up(100.0 * share, 2) for share in (errors.torque_relative, errors.loss_relative)
    )
    return f"i_d {i_d} A, i_q {i_q} A, torque {torque} %, copper loss +{loss} %"


def run_tables(solution: Solution, verification: Verification | None) -> list[Table]:
    """The short summary of a run."""
    fit, gains, where = solution.fit, solution.loops, operation_text(solution.fit.speed)
    polynomial = fit.d or fit.q
    plural = "" if polynomial is None or polynomial.segments == 1 else "s"
    shape = (
        ""
        if polynomial is None
        else f", degree {polynomial.degree}, {polynomial.segments} segment{plural}"
    )
    rows = [
        ("current reference", f"{fit.form}{shape}, 0 to {fit.torque_max:.4g} N m"),
        *([("  holds at", where)] if where else []),
        ("  largest errors", _errors_text(fit.errors)),
    ]
    if solution.certificate is not None:
        rows.append(("  proven bounds", proven_text(solution.certificate)))
    limits = " ".join(data_lines(solution.data, fit.torque_max))
    if limits:
        rows.append(("  end of the data", limits))
    rows += _negative_rows(solution)
    if fit.errors.loss_relative > POOR_FIT:
        rows.append(("  warning", poor_fit_text(solution.design, fit)))
    if solution.weakening is not None:
        rows.append(("field weakening", domain_text(solution.weakening)))
        rows.append(("  largest errors", errors_text(solution.weakening)))
        proven = proof_text(solution.weakening)
        if proven is not None:
            rows.append(("  proven bounds", proven))
    loops = () if gains is None else (gains.i_d, gains.i_q, gains.speed)
    rows += [(f"{loop.loop} loop", loop_words(loop)) for loop in loops if loop is not None]
    rows += [("no loops", solution.gains_left_out)] if gains is None else []
    if solution.losses is not None:
        rows += _best_rows(solution.losses)
    rows += [] if solution.choice is None else choice_rows(solution.choice)
    formats = format_text(not_simulated(solution)) if verification is not None else ""
    if solution.design.simulation is not None and formats:
        rows.append(("simulation", formats))
    told = [
        f"{evidence.source}: {text}"
        for evidence in solution.design.flux_evidence
        for text in evidence.sentences()
    ]
    rows += [("flux map", sentence) for sentence in told]
    rows.append(("verification", verification_text(verification)))
    return [Table(solution.design.name, ("", ""), tuple(rows))]


def _negative_rows(solution: Solution) -> list[tuple[str, str]]:
    """What holds for negative torques where they have a reference of their own."""
    half = solution.negative
    if half is None:
        return []
    rows = [
        ("  negative torques", f"{half.fit.form}, 0 to -{half.fit.torque_max:.4g} N m"),
        ("  largest errors", _errors_text(half.fit.errors)),
    ]
    return (
        rows
        if half.certificate is None
        else [*rows, ("  proven bounds", proven_text(half.certificate))]
    )


def _watts(value: float) -> str:
    return f"{value:.0f} W" if value >= 99.95 else format_quantity(value, "W", 3)


def _best_rows(comparison: LossComparison) -> list[tuple[str, str]]:
    rows = []
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        label = f"losses at {point.torque:.4g} N m, {point.omega_m * 30.0 / math.pi:.4g} rpm"
        if best is None:
            rows.append((label, "no alternative is feasible"))
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        budget = comparison.budget
        known = comparison.scope == "drive"
        heat = (
            f", {budget.junction_temperature[index]:.0f} degC" if known else " without the bridge"
        )
        chosen = f"{_watts(float(budget.total[index]))}{heat}"
        first_loss = (
            _watts(float(budget.total[0, 0, p])) if comparison.usable[0, 0, p] else "not feasible"
        )
        first = f"{comparison.strategies[0]} with {comparison.modulations[0]}: {first_loss}"
        rows.append((label, f"{best[0]} with {best[1]}: {chosen} ({first})"))
    return rows
