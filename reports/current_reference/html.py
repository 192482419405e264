"""The current reference in the report."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.names import Core
from dqforge.optimizer.current_reference.alternatives import Alternative
from dqforge.optimizer.current_reference.cheapest import Trial
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.solution import Solution
from dqforge.reports.current_reference.data_text import data_lines
from dqforge.reports.current_reference.figures import ROUNDING
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.operating_points.html import operating_table
from dqforge.reports.pages.certificate_text import proof_title, proven_text
from dqforge.reports.pages.html_table import HtmlTable, Row, error_cells, heading_cells
from dqforge.reports.pages.html_text import (
    NARROW,
    ceiling,
    count,
    number,
    quantity,
    raised,
    share,
    symbols,
    unit_text,
)
from dqforge.reports.pages.labels import (
    core_name,
)
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
        return f"the copper loss is {least} but for rounding"
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


def errors_part(solution: Solution) -> PlainData:
    """The part of the report on torque error and loss penalty."""
    errors, proof = solution.fit.errors, solution.certificate
    return {
        "samples": count(errors.samples),
        "proven": "" if proof is None else symbols(proven_text(proof, 3)),
        "proven_title": "" if proof is None else proof_title(proof),
        "torque": (
            f"{quantity(ceiling(errors.torque), 'N m', 3)} "
            f"({share(ceiling(errors.torque_relative, 2))} of the largest torque)"
        ),
        "loss": symbols(penalty_text(solution)),
    }


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
        "of largest",
        "i_d error",
        "i_q error",
        "extra loss",
        "extra loss",
        "step at zero",
    )
    return HtmlTable(
        "The price of each option: largest errors found", heading_cells(*columns), (chosen, *rows)
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
                share(ceiling(trial.errors.torque_relative), 3),
                share(ceiling(trial.errors.loss_relative), 3),
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
