"""The current reference in the report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.design.design import Design, back_emf_warning
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Core
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.fit import Alternative, ReferenceFit
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.current_reference.solve import COVERED, DataUse, Trial
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial
from dqforge.optimizer.solution import NegativeHalf, Solution
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.capability import (
    Capability,
    Draw,
    Flashed,
    Passage,
    Quantity,
    ReportPart,
    Rows,
    Tile,
    Value,
)
from dqforge.reports.current_reference.figures import ROUNDING
from dqforge.reports.current_reference.plain import (
    band_text,
    data_lines,
    plain_band,
    plain_fit,
    to_plain,
    within_text,
)
from dqforge.reports.operating_points.figures import operating_table
from dqforge.reports.operating_points.map_tables import plain_curves
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import (
    FORMAT_TEXT,
    NARROW,
    STRATEGY_TEXT,
    HtmlTable,
    Row,
    ceiling,
    core_name,
    count,
    error_cells,
    heading_cells,
    number,
    operation_text,
    percent,
    quantity,
    raised,
    share,
    significant,
    symbols,
    unit_text,
    watts,
)
from dqforge.reports.pages.templating import ERRORS, REFERENCE, proof_title, proven_text
from dqforge.reports.plain_data import PlainData

_FORM_TEXT = {
    "proportional": "i_d is zero and i_q is proportional to the torque; this is exact.",
    "polynomial": "i_d and i_q are polynomials of the torque.",
    "torque-exact": (
        "i_d is a polynomial of the torque and i_q is the torque divided by what one ampere of i_q "
        "makes at that i_d. The torque therefore has no error but that of rounding."
    ),
    "closed-form": (
        "i_q is a polynomial of the torque and i_d follows from it by the MTPA locus. "
        "The currents therefore lie on the optimum locus."
    ),
    "reluctance": (
        "i_q is a square root of the torque and i_d has the same magnitude; this is exact."
    ),
}


def penalty_text(solution: Solution) -> str:
    """What is said of the loss beside the least one."""
    errors = solution.fit.errors
    least = "the least" if solution.design.strategy == "mtpa" else "that of exact i_d = 0"
    if errors.loss_relative <= ROUNDING:
        return f"the copper loss is {least} apart from rounding"
    return (
        f"the copper loss lies at most {quantity(ceiling(errors.loss), 'W', 3)} or "
        f"{share(ceiling(errors.loss_relative, 2))} above {least}"
    )


def reference_proof_text(solution: Solution) -> str:
    """Whether the errors of the summary are proven."""
    proof = solution.certificate
    if proof is None:
        return "both are sampled"
    torque = quantity(ceiling(proof.torque), "N m", 3)
    if proof.loss_relative is None:
        return f"the proven bound is {torque}"
    return f"the proven bounds are {torque} and {share(ceiling(proof.loss_relative, 2))}"


def reference_part(solution: Solution) -> PlainData:
    """The part of the report on the current reference."""
    fit, settings = solution.fit, solution.fit.settings
    plain = to_plain(fit.reference)
    shape = ""
    if fit.d is not None or fit.q is not None:
        segments = f"{settings.segments} segment{'s' if settings.segments > 1 else ''}"
        how = "given" if settings.breakpoints is not None else "searched for"
        shape = (
            f"Method {settings.method}, degree {settings.degree}, {segments}, breakpoints {how}; "
            f"{'exact' if settings.exact_at_zero else 'not forced to be exact'} at zero torque, "
            f"{'continuous' if settings.continuous else 'not forced to be continuous'}."
        )
    return {
        "form": plain["form"],
        "optimum": solution.design.strategy == "mtpa",
        "form_text": symbols(_FORM_TEXT[plain["form"]]),
        "shape": shape,
        "data": symbols(" ".join(data_lines(solution.data, fit.torque_max))),
        "operating": operating_table(solution.design, solution.curves),
        "coefficients": coefficient_table(plain),
        "constants": constant_rows(plain),
        "alternatives": alternatives_table(fit, solution.alternatives)
        if solution.alternatives
        else None,
        "trials": trials_table(solution.trials, solution.design.fit.core)
        if solution.trials
        else None,
    }


def errors_passage(solution: Solution) -> Passage:
    """The part of the report on torque error and loss penalty."""
    errors, proof = solution.fit.errors, solution.certificate
    torque = (
        f"{quantity(ceiling(errors.torque), 'N m', 3)} "
        f"({share(ceiling(errors.torque_relative, 2))} of the largest torque)"
    )
    text = symbols(
        f"The torque deviates by at most {torque}; {penalty_text(solution)}. These values were "
        f"found by evaluating the arithmetic of the header {count(errors.samples)} times, on both "
        "sides of every breakpoint and, in single precision, with and without fused multiply-add."
    )
    texts = [text]
    if solution.torque_band is not None:
        within = band_text(solution.torque_band)
        about = within_text(solution.torque_band)
        texts.append(symbols(f"On a machine within {about} the torque is {within}."))
    bounds = "They are sampled, not proven bounds."
    if proof is not None:
        bounds = f"Bounds, {proof_title(proof)}: {proven_text(proof, 3)}."
    caption = (
        "Errors over torque in the arithmetic of the firmware, without fused multiply-add; every "
        "stroke keeps the extreme values of its interval. An error that looks like noise is "
        "rounding. The losses are on logarithmic scales."
    )
    return Passage(
        text=texts,
        outcome=symbols(bounds),
        proven=proof is not None,
        drawings=[("errors", caption)],
    )


def _power_text(power: int) -> str:
    unit = ("A", "A/(N m)")[power] if power < 2 else f"A/(N m){raised(power)}"
    return (
        f"x{raised(power)}, {unit}"
        if power > 1
        else ("constant, A" if power == 0 else f"x, {unit}")
    )


def _integer_table(segments: Sequence[PlainData], headings: Sequence[str]) -> HtmlTable:
    """Integers of each step of Horner's rule as the firmware holds them,
    one column per segment and axis.
    """
    rows = [Row(("start with", *(f"{row['leading']}" for row in segments)))]
    for step in range(max(len(row["steps"]) for row in segments)):
        cells = [row["steps"][step] if step < len(row["steps"]) else None for row in segments]
        texts = ["" if cell is None else f"{cell[0]:+d}, >> {cell[1]}" for cell in cells]
        rows.append(Row((f"step {step + 1}: times x", *texts)))
    return HtmlTable(
        "Integers; x is the code of the torque minus the start",
        heading_cells("", *headings),
        tuple(rows),
        folded=True,
    )


def coefficient_table(plain: PlainData) -> HtmlTable | None:
    """Coefficients as the firmware holds them, highest power last, one column per segment and
    axis.
    """
    segments = [
        (axis, index, row) for axis in ("d", "q") for index, row in enumerate(plain.get(axis) or ())
    ]
    if not segments:
        return None
    is_float, headings = plain["format"] == "float32", []
    for axis, index, row in segments:
        following = plain[axis][index + 1 :]
        end = following[0]["start"] if following else plain["torque_max"]
        domain = (
            f"{number(row['start'])} to {number(end)} N m"
            if is_float
            else f"codes {row['start']} to {end}"
        )
        headings.append(f"i_{axis}: {domain}")
    if not is_float:
        return _integer_table([row for _, _, row in segments], headings)
    lists = [row["coefficients"] for _, _, row in segments]
    rows = tuple(
        Row(
            (
                _power_text(power),
                *(number(row[power], 9) if power < len(row) else "" for row in lists),
            )
        )
        for power in range(max(len(row) for row in lists))
    )
    return HtmlTable(
        "Coefficients in single precision; x is the torque minus the start of the segment, in N m",
        heading_cells("Factor of", *headings),
        rows,
        folded=True,
    )


def constant_rows(plain: PlainData) -> list[tuple[str, str]]:
    """Constants of the form beside its polynomials: meaning and value."""
    meanings = {
        "gain": ("gain", "A/(N m)" if plain["form"] == "proportional" else "A^2/(N m)"),
        "magnet": ("magnet torque per ampere, 3/2 p \u03c8_PM", "N m/A"),
        "slope": ("its slope over i_d, 3/2 p (L_d - L_q)", "N m/A^2"),
        "base": ("base current \u03c8_PM / (2 |L_q - L_d|)", "A"),
    }
    return [
        (symbols(text), f"{number(plain[key], 9)}{NARROW}{unit_text(unit)}")
        for key, (text, unit) in meanings.items()
        if key in plain
    ]


def alternatives_table(fit: ReferenceFit, alternatives: Sequence[Alternative]) -> HtmlTable:
    """The reference that was chosen and what one change at a time would give."""
    chosen = Row(("this design", *error_cells(fit.errors)), "chosen")
    rows = tuple(Row((row.label, *error_cells(row.errors))) for row in alternatives)
    columns = (
        "",
        "torque error",
        "torque error, of largest",
        "i_d error",
        "i_q error",
        "extra loss",
        "extra loss, of least",
        "step at zero",
    )
    return HtmlTable(
        "The cost of each option: largest errors found", heading_cells(*columns), (chosen, *rows)
    )


def trials_table(trials: Sequence[Trial], core: Core) -> HtmlTable:
    """The forms tried for a budget in order of cost; the last is the chosen one."""
    columns = (
        "",
        "format",
        "degree",
        "segments",
        "cycles",
        "constants",
        "torque error",
        "extra loss",
    )
    rows = tuple(
        Row(
            (
                trial.form + (" (quick fit)" if trial.quick else ""),
                trial.format,
                f"{trial.degree}",
                f"{trial.segments}",
                f"{trial.cycles:.0f}",
                f"{trial.flash} B",
                percent(ceiling(trial.errors.torque_relative)),
                percent(ceiling(trial.errors.loss_relative)),
            ),
            "chosen" if trial is trials[-1] else "",
        )
        for trial in trials
    )
    return HtmlTable(
        f"Forms tried for the budget, by estimated cycles on {core_name(core)}",
        heading_cells(*columns),
        rows,
        folded=True,
        key=f"{trials[-1].form} is chosen",
    )


# The current reference as tables of the terminal.

# Share of the torque from which what the tolerances make of it is said among the warnings.
WIDE_BAND = 0.05

POOR_FIT = 0.01  # Relative copper-loss penalty from which a fit is called poor.


def _error_cells(errors: ReferenceErrors) -> tuple[str, ...]:
    values = (
        errors.i_d,
        errors.i_q,
        100.0 * errors.torque_relative,
        100.0 * errors.loss_relative,
        errors.step_at_zero,
    )
    return tuple(rounded_up(value) for value in values)


def _coefficient_rows(axis: str, polynomial: PiecewisePolynomial | None) -> list[tuple[str, ...]]:
    if polynomial is None:
        return []
    return [
        (axis, significant(start), significant(end), "  ".join(f"{c:.5g}" for c in series[::-1]))
        for start, end, series in zip(
            polynomial.edges[:-1], polynomial.edges[1:], polynomial.coefficients, strict=True
        )
    ]


def _voltage_notes(fit: ReferenceFit) -> tuple[str, ...]:
    where, excess = operation_text(fit.speed), fit.errors.voltage_excess
    if excess is None:
        return ()
    return (f"for {where}; the fit takes at most {rounded_up(100.0 * excess)} % more voltage",)


def negative_tables(half: NegativeHalf | None) -> list[Table]:
    """Fit of negative torques, mirrored, where they have their own; else nothing."""
    if half is None:
        return []
    tables = fit_tables(half.design, half.fit, (), (), half.certificate)
    return [replace(table, title=f"{table.title}, negative torques (mirrored)") for table in tables]


def trial_table(trials: tuple[Trial, ...], core: Core) -> Table:
    """What was tried for a budget, in order of cost."""
    columns = (
        "form",
        "format",
        "degree",
        "segments",
        "cycles",
        "constants B",
        "torque error %",
        "loss penalty %",
    )
    rows = tuple(
        (
            trial.form + (" (quick fit)" if trial.quick else ""),
            trial.format,
            f"{trial.degree}",
            f"{trial.segments}",
            f"{trial.cycles:.0f}",
            f"{trial.flash}",
            rounded_up(100.0 * trial.errors.torque_relative),
            rounded_up(100.0 * trial.errors.loss_relative),
        )
        for trial in trials
    )
    note = (
        f"tried in order of the cycles estimated for {core_name(core)}; the last keeps the budget "
        "at least cost"
    )
    return Table("Forms tried for the budget", columns, rows, (note,))


def fit_tables(
    design: Design,
    fit: ReferenceFit,
    rows: tuple[Alternative, ...],
    trials: tuple[Trial, ...] = (),
    certificate: Certificate | None = None,
    data: DataUse = COVERED,
) -> list[Table]:
    """Errors of the fit beside its alternatives, what is proven of it, what data hold it,
    and its coefficients.
    """
    columns = (
        "",
        "i_d error A",
        "i_q error A",
        "torque error %",
        "loss penalty %",
        "step at zero A",
    )
    chosen = (f"chosen: {fit.form}", *_error_cells(fit.errors))
    others = tuple((row.label, *_error_cells(row.errors)) for row in rows)
    note = (
        "largest values found in the arithmetic of the header; torque error in % of "
        f"{fit.torque_max:.4g} N m, loss penalty in % of the least copper loss from 5 % torque "
        "upwards"
    )
    proof = (
        ()
        if certificate is None
        else (f"{proof_title(certificate)}: {proven_text(certificate, 3)}",)
    )
    limits = " ".join(data_lines(data, fit.torque_max))
    notes = (
        note,
        *proof,
        *([limits] if limits else []),
        *_voltage_notes(fit),
        *_poor_fit_notes(design, fit),
    )
    tables = [
        Table(
            f"{design.name}: current reference, {fit.settings.method}",
            columns,
            (chosen, *others),
            notes,
        )
    ]
    if trials:
        tables.append(trial_table(trials, design.fit.core))
    coefficients = [*_coefficient_rows("i_d", fit.d), *_coefficient_rows("i_q", fit.q)]
    if coefficients:
        headings = (
            "axis",
            "from N m",
            "to N m",
            "coefficients of T - from, highest power first, A/(N m)^k",
        )
        tables.append(Table("Coefficients", headings, tuple(coefficients)))
    return tables


def _poor_fit_notes(design: Design, fit: ReferenceFit) -> tuple[str, ...]:
    return (poor_fit_text(design, fit),) if fit.errors.loss_relative > POOR_FIT else ()


def poor_fit_text(design: Design, fit: ReferenceFit) -> str:
    """What to do about a fit with large errors."""
    closed = (
        isinstance(design.machine, LinearMachine)
        and design.operation.omega_m is None
        and fit.form != "closed-form"
    )
    more = "closed-form, " if closed else ""
    return (
        f"the fit costs more than {100.0 * POOR_FIT:.0f} % copper loss: try {more}a higher degree "
        "or more segments"
    )


# What a comparison sets side by side of current references.

_SECTION = "current reference"

# Key of the bytes of constants, which a side of a comparison adds to ``header``.
CONSTANTS = "constants_B"

_ERRORS = (
    ("i_d error", "i_d", "A"),
    ("i_q error", "i_q", "A"),
    ("torque error", "torque_relative", "%"),
    ("copper loss penalty", "loss_relative", "%"),
    ("voltage excess", "voltage_excess", "%"),
)

# Shares below this are rounding, which moves with every input.
_ROUNDING = 1e-14


def _share(value: Any) -> Value:
    """A share less what is only rounding."""
    return 0.0 if abs(float(value)) < _ROUNDING else float(value)


def _checksum(reference: Any) -> Value:
    text = json.dumps(reference, sort_keys=True)
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:12]


def _errors(word: str, key: str) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(
            _SECTION,
            f"{label}, {word}",
            unit,
            ("fit", key, name),
            _share if unit == "%" else None,
        )
        for label, name, unit in _ERRORS
    )


QUANTITIES = (
    Quantity(_SECTION, "strategy", "", ("drive", "strategy")),
    Quantity(_SECTION, "holds at", "rpm", ("drive", "reference_omega_m_rad_per_s")),
    Quantity(_SECTION, "form", "", ("fit", "form")),
    Quantity(_SECTION, "method", "", ("fit", "method")),
    Quantity(_SECTION, "number format", "", ("fit", "reference", "format")),
    Quantity(_SECTION, "degree", "", ("fit", "degree")),
    Quantity(_SECTION, "segments", "", ("fit", "segments")),
    Quantity(_SECTION, "largest torque", "N m", ("fit", "torque_max_Nm")),
    *_errors("found", "errors"),
    *_errors("proven", "certificate"),
    Quantity(_SECTION, "bytes of constants", "", ("header", CONSTANTS)),
    Quantity(_SECTION, "checksum of constants", "", ("header", "reference"), _checksum),
)


# The current reference that the firmware evaluates, as records.


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
    if solution.torque_band is not None:
        rows.append(("  torque within tolerances", band_text(solution.torque_band)))
    return rows + _negative_rows(solution.negative)


def _watched(solution: Solution, _: Solution) -> list[str]:
    fit = solution.fit
    data = " ".join(data_lines(solution.data, fit.torque_max))
    band, wide = solution.torque_band, []
    if band is not None and band.independent > WIDE_BAND:
        wide = [f"the torque may be {band_text(band)}, within {within_text(band)}"]
    return [
        *_beyond_the_link(solution),
        *wide,
        *([data] if data else []),
        *([poor_fit_text(solution.design, fit)] if fit.errors.loss_relative > POOR_FIT else []),
    ]


def _beyond_the_link(solution: Solution) -> list[str]:
    """That the largest speed needs field weakening which the design does not have, or nothing."""
    design, machine = solution.design, solution.design.machine
    without = solution.weakening is None and design.phase_machine is None
    if machine.omega_m_max is None or not without:
        return []
    text = back_emf_warning(
        machine.pole_pairs,
        machine.psi_pm,
        machine.omega_m_max,
        design.inverter.v_dc,
        design.inverter.topology,
    )
    if not text:
        return []
    speed = f"{in_rpm(machine.omega_m_max):.5g} rpm"
    advice = (
        f"write field_weakening: {{speed: {speed}}}, or a smaller machine.max_speed; 'dqforge mtpa "
        "--speed' shows what the link permits"
    )
    return [f"{text}. The references of this design weaken no field: {advice}"]


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
        rows.append(Flashed("largest speed", f"{in_rpm(top):.5g} rpm", "of the machine"))
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
            f"The torque deviates by at most {quantity(ceiling(fit.errors.torque), 'N m', 3)}, "
            f"{penalty_text(solution)}; {reference_proof_text(solution)}."
        ),
    ]
    half = solution.negative
    if half is not None:
        proof = (
            "sampled" if half.certificate is None else f"proven: {proven_text(half.certificate, 3)}"
        )
        sentences.append(
            "Negative torques have their own reference, up to "
            f"{quantity(half.fit.torque_max, 'N m')}; its torque deviates by at most "
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
        errors_passage(solution).of(ERRORS, error.value),
    ]


def _plain(solution: Solution, _: Solution) -> PlainData:
    return plain_fit(
        solution.fit,
        solution.alternatives,
        solution.trials,
        solution.certificate,
        solution.data,
    ) | {"torque_band": plain_band(solution.torque_band)}


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
