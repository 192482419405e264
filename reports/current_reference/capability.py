"""The current reference that the firmware evaluates, as records."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.negative_torques import NegativeHalf
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.capability import Capability, Draw, Flashed, ReportPart, Rows, Tile
from dqforge.reports.current_reference.data_text import data_lines
from dqforge.reports.current_reference.html import (
    errors_part,
    penalty_text,
    reference_part,
    reference_proof_text,
)
from dqforge.reports.current_reference.plain import plain_fit
from dqforge.reports.current_reference.quantities import QUANTITIES
from dqforge.reports.current_reference.tables import (
    POOR_FIT,
    fit_tables,
    negative_tables,
    poor_fit_text,
)
from dqforge.reports.operating_points.plain import plain_curves
from dqforge.reports.pages.certificate_text import proven_text
from dqforge.reports.pages.chapters import ERRORS, REFERENCE
from dqforge.reports.pages.html_text import ceiling, number, quantity, share, symbols
from dqforge.reports.pages.labels import FORMAT_TEXT, STRATEGY_TEXT, operation_text, watts
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData


def _errors_text(errors: ReferenceErrors) -> str:
    i_d, i_q = rounded_up(errors.i_d, 2), rounded_up(errors.i_q, 2)
    torque, loss = (
        rounded_up(100.0 * share, 2) for share in (errors.torque_relative, errors.loss_relative)
    )
    return f"i_d {i_d} A, i_q {i_q} A, torque {torque} %, copper loss +{loss} %"


def _summary(solution: Solution, _: Solution) -> Rows:
    fit, where = solution.fit, operation_text(solution.fit.speed)
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
    return rows + _negative_rows(solution.negative)


def _watched(solution: Solution, _: Solution) -> list[str]:
    fit = solution.fit
    data = " ".join(data_lines(solution.data, fit.torque_max))
    return [
        *([data] if data else []),
        *([poor_fit_text(solution.design, fit)] if fit.errors.loss_relative > POOR_FIT else []),
    ]


def _flashed(solution: Solution, _: Solution) -> list[Flashed]:
    design, fit, chosen = solution.design, solution.fit, solution.curves.chosen
    current = float(np.hypot(chosen.i_d[-1], chosen.i_q[-1]))
    strategy = STRATEGY_TEXT[design.strategy]
    rows = [
        Flashed(
            "largest torque",
            f"{fit.torque_max:.4g} N m",
            f"{strategy} with {current:.4g} of {design.i_max:.4g} A (peak)",
        )
    ]
    top = design.machine.omega_m_max
    if top is not None:
        rows.append(Flashed("largest speed", f"{top * 30.0 / np.pi:.5g} rpm", "of the machine"))
    return rows


def _negative_rows(half: NegativeHalf | None) -> Rows:
    """What holds for negative torques where they have a reference of their own."""
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


def _sentences(solution: Solution, _: Solution) -> list[str]:
    fit, design = solution.fit, solution.design
    where = operation_text(fit.speed)
    sentences = [
        (
            "The current reference follows "
            f"{STRATEGY_TEXT[design.strategy]}{f' at {where}' if where else ''} up to "
            f"{quantity(fit.torque_max, 'N m')}."
        ),
        (
            f"The torque errs by at most {quantity(ceiling(fit.errors.torque), 'N m', 3)}, "
            f"{penalty_text(solution)}; {reference_proof_text(solution)}."
        ),
    ]
    half = solution.negative
    if half is not None:
        proof = (
            "sampled" if half.certificate is None else f"proven: {proven_text(half.certificate, 3)}"
        )
        sentences.append(
            "Negative torques have a reference of their own, up to "
            f"{quantity(half.fit.torque_max, 'N m')}; its torque errs by at most "
            f"{quantity(ceiling(half.fit.errors.torque), 'N m', 3)} ({proof})."
        )
    saving = solution.curves.saving
    if saving is not None:
        sentences.append(
            f"Against i_d = 0 it saves {share(saving.relative, 3)} of the copper loss at "
            f"{quantity(saving.torque, 'N m')}."
        )
    return sentences


def _tiles(solution: Solution, _: Solution) -> list[Tile]:
    fit, chosen = solution.fit, solution.curves.chosen
    arithmetic = FORMAT_TEXT[fit.settings.format or "float32"]
    current = float(np.hypot(chosen.i_d[-1], chosen.i_q[-1]))
    limit = f"with {number(current)} of {number(solution.design.i_max)} A (peak)"
    tiles = [
        Tile("Largest torque", quantity(fit.torque_max, "N m"), limit),
        Tile(
            "Torque error of the reference",
            quantity(ceiling(fit.errors.torque), "N m", 3),
            (
                f"{share(ceiling(fit.errors.torque_relative, 2))} of the largest torque, in "
                f"{arithmetic}"
            ),
        ),
    ]
    saving = solution.curves.saving
    if saving is not None:
        detail = (
            f"{watts(saving.chosen)} instead of {watts(saving.id0)} at "
            f"{quantity(saving.torque, 'N m')}"
        )
        label = symbols("Copper loss saved against i_d = 0")
        tiles.append(Tile(label, share(saving.relative, 3), detail))
    return tiles


def _tables(solution: Solution, _: Solution) -> list[Table]:
    return [
        *fit_tables(
            solution.design,
            solution.fit,
            solution.alternatives,
            solution.trials,
            solution.certificate,
            solution.data,
        ),
        *negative_tables(solution.negative),
    ]


def _figures(solution: Solution, _: Solution) -> Mapping[str, Draw]:
    from dqforge.reports.current_reference.figures import plot_errors, plot_fit, plot_mtpa

    positive, fit = solution.positive, solution.fit
    return {
        "mtpa": lambda: plot_mtpa(positive, solution.curves, fit),
        "fit": lambda: plot_fit(positive, fit),
        "errors": lambda: plot_errors(fit),
    }


def _parts(solution: Solution, _: Solution) -> list[ReportPart]:
    reach, error = _tiles(solution, solution)[:2]
    return [
        ReportPart(
            REFERENCE, "current_reference/reference.html.j2", reference_part(solution), reach.value
        ),
        ReportPart(ERRORS, "current_reference/errors.html.j2", errors_part(solution), error.value),
    ]


def _plain(solution: Solution, _: Solution) -> PlainData:
    return plain_fit(
        solution.fit,
        solution.alternatives,
        solution.trials,
        solution.certificate,
        solution.data,
    )


# Its result is the whole solution: the fit with its proof, its data and its alternatives.
CURRENT_REFERENCE = Capability(
    name="fit",
    title="current reference",
    of=lambda outcome: outcome.solution,
    plain=_plain,
    flashed=_flashed,
    watched=_watched,
    summary=_summary,
    tables=_tables,
    sentences=_sentences,
    tiles=_tiles,
    figures=_figures,
    parts=_parts,
    quantities=QUANTITIES,
)

NEGATIVE_POINTS = Capability(
    name="mtpa_negative",
    title="currents over negative torques",
    of=lambda outcome: outcome.solution.negative,
    plain=lambda _, half: plain_curves(half.curves),
    always=False,
)

# Tables and words of both stand with those of the current reference.
NEGATIVE_REFERENCE = Capability(
    name="fit_negative",
    title="current reference of negative torques",
    of=lambda outcome: outcome.solution.negative,
    plain=lambda _, half: plain_fit(half.fit, (), (), half.certificate),
    always=False,
)
