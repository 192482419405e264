"""The current reference as tables of the terminal."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Core
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.current_reference.alternatives import Alternative
from dqforge.optimizer.current_reference.cheapest import Trial
from dqforge.optimizer.current_reference.data_use import COVERED, DataUse
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.negative_torques import NegativeHalf
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.current_reference.data_text import data_lines
from dqforge.reports.pages.certificate_text import proof_title, proven_text
from dqforge.reports.pages.labels import (
    core_name,
    operation_text,
    significant,
)
from dqforge.reports.pages.table import Table

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
