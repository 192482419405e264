"""Tables for the terminal: results become rows of text here, and nowhere are they computed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.figures import MARK
from dqforge.machines.quantities import format_quantity
from dqforge.machines.settings import Core, QFormats
from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.certificate import Certificate
from dqforge.optimizer.current_choice import OperatingPoints
from dqforge.optimizer.current_reference import ReferenceErrors
from dqforge.optimizer.data_use import COVERED, DataUse
from dqforge.optimizer.fit_alternatives import Alternative
from dqforge.optimizer.fit_choice import Trial
from dqforge.optimizer.fixed_gains import pi_integers
from dqforge.optimizer.gains import LoopGains, per_unit
from dqforge.optimizer.mtpa import PerUnitBase
from dqforge.optimizer.observer import steady_state_error
from dqforge.optimizer.observer_proof import ObserverProof
from dqforge.optimizer.piecewise import PiecewisePolynomial
from dqforge.optimizer.point_losses import LossComparison
from dqforge.optimizer.reference_fit import ReferenceFit
from dqforge.optimizer.solution import Curves, GainSet, NegativeHalf, Solution
from dqforge.reports.c_numbers import rounded_up
from dqforge.reports.certificate_text import proof_title, proven_text
from dqforge.reports.choice_text import choice_rows
from dqforge.reports.cross import TargetVerification
from dqforge.reports.data_text import data_lines
from dqforge.reports.labels import (
    WITHOUT_BRIDGE,
    core_name,
    friction_text,
    obstacle,
    operation_text,
    part_label,
    shown_parts,
)
from dqforge.reports.observed_text import loop_words, margin_words, observed_notes
from dqforge.reports.observer_text import position_parts
from dqforge.reports.robustness_text import FORM_COLUMNS, ROBUST_COLUMNS, form_rows, robust_notes, robust_rows
from dqforge.reports.schedule_text import SCHEDULE_COLUMNS, schedule_notes, schedule_rows
from dqforge.reports.simulated_format import format_text, not_simulated
from dqforge.reports.verify import Verification
from dqforge.reports.weakening_text import domain_text, errors_text, proof_text

POOR_FIT = 0.01
"""Relative copper-loss penalty from which a fit is called poor."""


@dataclass(frozen=True, slots=True)
class Table:
    """A titled table of text: ``columns`` are the headings with units, ``rows`` the cells, ``notes`` lines below."""

    title: str
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)


def _number(value: float, digits: int = 4) -> str:
    # Adding zero turns -0 into 0.
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else "none"


def _fixed(value: float) -> str:
    """A number with one decimal, or three digits where those are more; a dash where there is none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if 0.0 < abs(value) < 10.0 else f"{value + 0.0:.1f}"


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
    notes = tuple(sentence if sentence.startswith(MARK) else f"assumed: {sentence}" for sentence in design.assumptions)
    return [Table(f"{design.name}: valid", columns, rows, notes)]


def _point_rows(points: OperatingPoints, base: PerUnitBase | None) -> tuple[tuple[str, ...], ...]:
    indices = np.unique(np.linspace(0, points.torque.size - 1, 11).round().astype(int))
    rows = []
    for k in indices:
        torque, i_d, i_q = (float(values[k]) for values in (points.torque, points.i_d, points.i_q))
        cells = [torque, i_d, i_q, float(np.hypot(i_d, i_q))]
        if base is not None:
            cells += [torque / base.torque, i_d / base.current, i_q / base.current]
        rows.append((*(_number(cell) for cell in cells), _held_by(points, int(k))))
    return tuple(rows)


def _held_by(points: OperatingPoints, k: int) -> str:
    if points.held[k]:
        return "the data"
    return "current limit" if points.limited[k] else ""


def mtpa_tables(design: Design, curves: Curves, negative: Curves | None = None) -> list[Table]:
    """Currents over torque for the design's strategy, and what i_d = 0 would draw at the end of the domain.

    ``negative`` are those of negative torques, mirrored, where these have their own.
    """
    notes = [f"limit {design.i_max:.4g} A (peak); currents are peak of phase"]
    if curves.id0 is not None and design.strategy == "mtpa":
        chosen = float(np.hypot(curves.chosen.i_d[-1], curves.chosen.i_q[-1]))
        if not curves.id0.limited[-1]:
            notes.append(
                f"i_d = 0 draws {curves.id0.i_q[-1]:.4g} A at the last torque, {design.strategy} {chosen:.4g} A"
            )
        else:
            notes.append(f"i_d = 0 reaches {curves.id0.torque[-1]:.4g} N m within the limit")
    if np.any(curves.chosen.held):
        notes.append("held by the data: the flux map ends there, currents of less loss may lie beyond it")
    base = curves.base
    per_unit_columns = () if base is None else ("torque p.u.", "i_d p.u.", "i_q p.u.")
    if base is not None:
        notes.append(f"per unit of {base.current:.5g} A and {base.torque:.5g} N m (the bases of the MTPA curve)")
    columns = ("torque N m", "i_d A", "i_q A", "|i| A", *per_unit_columns, "limited by")
    tables = [Table(f"{design.name}: {design.strategy}", columns, _point_rows(curves.chosen, base), tuple(notes))]
    if negative is not None:
        rows = _point_rows(replace(negative.chosen, torque=-negative.chosen.torque, i_q=-negative.chosen.i_q), None)
        tables.append(Table(f"{design.name}: {design.strategy}, negative torques", columns, rows))
    return tables


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
        (axis, _number(start), _number(end), "  ".join(f"{c:.5g}" for c in series[::-1]))
        for start, end, series in zip(polynomial.edges[:-1], polynomial.edges[1:], polynomial.coefficients, strict=True)
    ]


def _voltage_notes(design: Design, fit: ReferenceFit) -> tuple[str, ...]:
    where, excess = operation_text(design), fit.errors.voltage_excess
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
    columns = ("form", "format", "degree", "segments", "cycles", "constants B", "torque error %", "loss penalty %")
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
    note = f"tried in order of the cycles estimated for {core_name(core)}; the last keeps the budget at least cost"
    return Table("Forms tried for the budget", columns, rows, (note,))


def fit_tables(
    design: Design,
    fit: ReferenceFit,
    rows: tuple[Alternative, ...],
    trials: tuple[Trial, ...] = (),
    certificate: Certificate | None = None,
    data: DataUse = COVERED,
) -> list[Table]:
    """Errors of the fit beside its alternatives, what is proven of it, what data hold it, and its coefficients."""
    columns = ("", "i_d error A", "i_q error A", "torque error %", "loss penalty %", "step at zero A")
    chosen = (f"chosen: {fit.form}", *_error_cells(fit.errors))
    others = tuple((row.label, *_error_cells(row.errors)) for row in rows)
    note = (
        "largest values found in the arithmetic of the header; torque error in % of "
        f"{fit.torque_max:.4g} N m, loss penalty in % of the least copper loss from 5 % torque upwards"
    )
    proof = () if certificate is None else (f"{proof_title(certificate)}: {proven_text(certificate, 3)}",)
    limits = " ".join(data_lines(data, fit.torque_max))
    notes = (note, *proof, *([limits] if limits else []), *_voltage_notes(design, fit), *_poor_fit_notes(design, fit))
    tables = [Table(f"{design.name}: current reference, {fit.settings.method}", columns, (chosen, *others), notes)]
    if trials:
        tables.append(trial_table(trials, design.fit.core))
    coefficients = [*_coefficient_rows("i_d", fit.d), *_coefficient_rows("i_q", fit.q)]
    if coefficients:
        headings = ("axis", "from N m", "to N m", "coefficients of T - from, highest power first, A/(N m)^k")
        tables.append(Table("Coefficients", headings, tuple(coefficients)))
    return tables


def _loop_row(gains: LoopGains, unit: str, per_unit_text: str) -> tuple[str, ...]:
    return (
        gains.loop,
        gains.method,
        f"{gains.kp:.5g} {unit}",
        f"{gains.ki:.5g}",
        per_unit_text,
        _number(gains.crossover / (2.0 * math.pi)),
        margin_words(gains),
        f"{20.0 * math.log10(gains.gain_margin):.1f}" if math.isfinite(gains.gain_margin) else "none",
        _number(gains.delay_margin * 1e6, 3),
        f"{gains.max_sensitivity:.2f}",
    )


def _per_unit_text(gains: LoopGains, bases: tuple[float, float], q_formats: QFormats | None) -> str:
    kp, ki_ts = per_unit(gains, *bases)
    integers = pi_integers(kp, ki_ts, q_formats)
    if integers is None:
        return f"{kp:.5g}, {ki_ts:.4g}"
    return ", ".join(f"{number.mantissa} (Q{number.shift})" for number in integers)


def gains_tables(design: Design, gains: GainSet, proof: ObserverProof | None = None) -> list[Table]:
    """Gains of each loop with their margins, and the observer with its errors and what is proven of it."""
    control, bases = design.control, design.control.bases
    current = (bases.current, bases.voltage)
    rows = [
        _loop_row(loop, "V/A", _per_unit_text(loop, current, control.current_loop.q_formats))
        for loop in (gains.i_d, gains.i_q)
    ]
    if gains.speed is not None and control.speed_loop is not None:
        text = _per_unit_text(gains.speed, (bases.speed, bases.torque), control.speed_loop.q_formats)
        rows.append(_loop_row(gains.speed, "N m s/rad", text))
    columns = (
        "loop",
        "method",
        "kp",
        "ki (kp unit)/s",
        "per unit: kp, ki t_s",
        "crossover Hz",
        "phase margin deg",
        "gain margin dB",
        "delay margin us",
        "M_s",
    )
    title, notes = f"{design.name}: gains, sampled every {control.t_s * 1e6:.4g} us", observed_notes(gains.speed)
    tables = [Table(title, columns, tuple(rows), notes)]
    tables.append(Table("Parallel, series and velocity form", FORM_COLUMNS, form_rows(gains)))
    if gains.robust is not None:
        rows_, notes = robust_rows(gains.robust), robust_notes(gains.robust)
        tables.append(Table("Worst within control.tolerances", ROBUST_COLUMNS, rows_, notes))
    if gains.schedule is not None:
        rows_, notes = schedule_rows(gains.schedule), schedule_notes(gains.schedule)
        tables.append(Table("Scheduled gains along the current reference", SCHEDULE_COLUMNS, rows_, notes))
    if gains.observer is not None:
        tables.append(_observer_table(design, gains))
    if gains.position is not None:
        tables += [Table(*part) for part in position_parts(gains.position, proof)]
    return tables


def _observer_table(design: Design, gains: GainSet) -> Table:
    observer, machine = gains.observer, design.machine
    assert observer is not None
    rows = (
        ("A", f"{observer.a:.7g}", ""),
        ("B_U", f"{observer.b_u:.7g}", "rad/(s V)"),
        ("B_I", f"{observer.b_i:.7g}", "rad/(s A)"),
        ("C", f"{observer.c:.7g}", "rad/(s A)"),
    )
    error = steady_state_error(machine, observer.g, observer.t_s, design.control.bases.speed, 1.0, r_error=0.3)
    rpm = 30.0 / math.pi
    load, resistance = error.load * rpm, error.resistance / error.i_q * rpm
    notes = (
        "steady speed error: none with exact parameters and no load;",
        f"an unknown load torque shifts the estimate by {load:.3g} rpm per N m,",
        f"a resistance that is 30 % too high by {resistance:.3g} rpm per A of i_q",
    )
    return Table(
        "Speed observer: omega_hat = zeta - C i_q; zeta' = A zeta + B_U u_q + B_I i_q",
        ("", "value", "unit"),
        rows,
        notes,
    )


def losses_tables(design: Design, comparison: LossComparison) -> list[Table]:
    """One table per operating point: strategy and modulator against losses and junction temperature."""
    kinds = shown_parts(comparison.budget)
    headings = [f"{part_label(kind)} W" for kind in kinds]
    columns = ("strategy", "modulator", *headings, "total W", "junction degC", "saving %", "")
    tables = []
    budget = comparison.budget
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                mark = "best" if best == (strategy, modulation) else obstacle(comparison, index)
                cells = [*(getattr(budget, kind) for kind in kinds), budget.total, budget.junction_temperature]
                texts = [_fixed(float(cell[index])) for cell in [*cells, comparison.saving]]
                rows.append((strategy, modulation, *texts, mark))
        title = f"{design.name}: losses at {point.torque:.4g} N m, {point.omega_m * 30.0 / math.pi:.5g} rpm"
        notes = [friction_text(comparison, p), WITHOUT_BRIDGE if comparison.scope != "drive" else ""]
        tables.append(Table(title, columns, tuple(rows), tuple(note for note in notes if note)))
    return tables


def verification_text(verification: Verification | None) -> str:
    """One line on what was compiled, run and compared."""
    if verification is None:
        return "not verified (--no-verify)"
    done = " and ".join(check.standard.upper() for check in verification.checks if not check.missing)
    missing = [
        f"; {check.standard.upper()} was not tried: install the Debian package {check.missing}"
        for check in verification.checks
        if check.missing
    ]
    count = verification.vectors + verification.sweep
    return f"{count} results equal the model bit for bit, compiled as {done}{''.join(missing)}"


def target_text(outcome: TargetVerification) -> str:
    """One line on a run on an emulated core: what ran there, what did not, and what the reference costs."""
    low, high = outcome.cycles
    most = outcome.cycles_largest
    ran = "".join(f", {run.compared} of the {run.name}" for run in outcome.runs)
    left = f"; not run there: {', '.join(outcome.not_run)}" if outcome.not_run else ""
    return (
        f"on an emulated {outcome.target} all test vectors hold bit for bit{' and these results' if ran else ''}"
        f"{ran.replace(',', ':', 1)}{left}; both currents of the reference take "
        f"{outcome.instructions:.1f} instructions (mean of {outcome.costed} vectors), an estimated {low:.0f}-{high:.0f}"
        f" cycles (at most {most[0]}-{most[1]}; zero wait states) and {outcome.flash} bytes"
    )


def _errors_text(errors: ReferenceErrors) -> str:
    i_d, i_q = rounded_up(errors.i_d, 2), rounded_up(errors.i_q, 2)
    torque, loss = (rounded_up(100.0 * share, 2) for share in (errors.torque_relative, errors.loss_relative))
    return f"i_d {i_d} A, i_q {i_q} A, torque {torque} %, copper loss +{loss} %"


def _poor_fit_notes(design: Design, fit: ReferenceFit) -> tuple[str, ...]:
    return (_poor_fit_text(design, fit),) if fit.errors.loss_relative > POOR_FIT else ()


def _poor_fit_text(design: Design, fit: ReferenceFit) -> str:
    closed = (
        isinstance(design.machine, LinearMachine) and design.operation.omega_m is None and fit.form != "closed-form"
    )
    more = "closed-form, " if closed else ""
    return f"the fit costs more than {100.0 * POOR_FIT:.0f} % copper loss: try {more}a higher degree or more segments"


def run_tables(solution: Solution, verification: Verification | None) -> list[Table]:
    """The short summary of a run."""
    fit, gains, where = solution.fit, solution.loops, operation_text(solution.design)
    polynomial = fit.d or fit.q
    plural = "" if polynomial is None or polynomial.segments == 1 else "s"
    shape = "" if polynomial is None else f", degree {polynomial.degree}, {polynomial.segments} segment{plural}"
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
        rows.append(("  warning", _poor_fit_text(solution.design, fit)))
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
    told = [f"{evidence.source}: {text}" for evidence in solution.design.flux_evidence for text in evidence.sentences()]
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
    return rows if half.certificate is None else [*rows, ("  proven bounds", proven_text(half.certificate))]


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
        heat = f", {budget.junction_temperature[index]:.0f} degC" if known else " without the bridge"
        chosen = f"{_watts(float(budget.total[index]))}{heat}"
        first_loss = _watts(float(budget.total[0, 0, p])) if comparison.usable[0, 0, p] else "not feasible"
        first = f"{comparison.strategies[0]} with {comparison.modulations[0]}: {first_loss}"
        rows.append((label, f"{best[0]} with {best[1]}: {chosen} ({first})"))
    return rows
