"""Tables and plain data of phase currents."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import Reals, in_rpm
from dqforge.machines.units.quantities import signed_hundredths
from dqforge.optimizer.solution import Solution
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic
from dqforge.optimizer.waveforms.comparison import RuleCurrents, WaveformComparison
from dqforge.optimizer.waveforms.firmware_fit import (
    PhaseCandidate,
    PhaseFit,
    PhasePolynomials,
    PhaseReference,
    PhaseTable,
)
from dqforge.optimizer.waveforms.solver import Confirmation
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.c_code.numbers import comment_text, float_literal, number_rows, rounded_up
from dqforge.reports.capability import Capability, Draw, Passage, Quantity, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, ceiling, quantity, share, symbols
from dqforge.reports.pages.templating import WAVEFORMS as CHAPTER
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.waveforms.float32_model import (
    model_currents,
    phase_reference_from,
    plain_phase_reference,
    waveform_inputs,
)

RULE_TEXT = {
    "dq": "dq: sinusoidal",
    "dqx": "dqx: constant torque, no neutral",
    "dqy": "dqy: constant torque, least loss",
    "limited": "within all limits",
}


_MOST_ORDERS = 50


_LISTED = 2e-3


def _row(found: RuleCurrents, base: float) -> tuple[str, ...]:
    values = found.figures
    copper, torque = float(values.copper[0]), float(values.torque[0])
    return (
        RULE_TEXT[found.rule],
        f"{copper:.4g}",
        signed_hundredths(100.0 * (copper / base - 1.0)),
        f"{100.0 * float(values.ripple[0]) / abs(torque):.3g}"
        if values.ripple[0] > 1e-9 * abs(torque)
        else "0",
        f"{float(values.rms[0]):.4g}",
        f"{float(values.peak[0]):.4g}",
        f"{float(values.neutral_rms[0]):.3g}"
        if values.neutral_rms[0] > 1e-9 * values.rms[0]
        else "0",
        f"{float(values.bus[0]):.4g}",
        ", ".join(found.obstacles) or "none",
    )


def _harmonic_rows(comparison: WaveformComparison) -> tuple[tuple[str, ...], ...]:
    """Harmonics of phase a by rule, in % of the fundamental."""
    lines, turns = [found.harmonics[0] for found in comparison.rules], comparison.machine.turns
    places = [
        place
        for place in range(2 if turns == 1 else 1, _MOST_ORDERS * turns)
        if place != turns
        and any(place < line.size and line[place] > _LISTED * line[turns] for line in lines)
    ]
    return tuple(
        (
            _order_text(place, turns),
            *(f"{100.0 * line[place] / line[turns]:.2f}" for line in lines),
        )
        for place in places
    )


def _order_text(place: int, turns: int) -> str:
    """An order of the electrical angle, as a fraction where it is not whole."""
    return f"{place // turns}" if place % turns == 0 else f"{place}/{turns}"


def _front_table(comparison: WaveformComparison) -> Table:
    """What smooth torque costs."""
    cheapest = min((loss for _, loss in comparison.front if math.isfinite(loss)), default=math.nan)
    rows = tuple(
        (
            f"{100.0 * ripple:g}",
            f"{loss:.4g}" if math.isfinite(loss) else "none",
            f"{100.0 * (loss / cheapest - 1.0):.2f}" if math.isfinite(loss) else "",
        )
        for ripple, loss in comparison.front
    )
    columns = ("permitted deviation of the torque %", "least copper loss W", "vs unrestricted %")
    return Table("The cost of smooth torque within all limits", columns, rows)


def optimality_note(comparison: WaveformComparison) -> str:
    """What is known of the optimum of a salient machine.

    Empty for others, whose programmes are convex.
    """
    if not isinstance(comparison.machine, SalientPhaseMachine):
        return ""
    if comparison.iterations == 0:
        return "within all limits: the global optimum, since each angle has its own"
    found = f"within all limits: a local optimum (IPOPT, {comparison.iterations} iterations)"
    if not math.isfinite(comparison.floor):
        return found
    copper = float(comparison.rules[-1].figures.copper[0])
    above = 100.0 * (copper / comparison.floor - 1.0)
    return (
        f"{found}; they lose {above:.2g} % more than {comparison.floor:.4g} W, which no constant "
        "torque undercuts"
    )


def waveform_tables(design: Design, comparison: WaveformComparison) -> list[Table]:
    """One row per rule: loss, ripple, currents, demand on the bus, and what it breaks;
    then harmonics of phase a.
    """
    limits = comparison.limits
    base = float(comparison.rules[0].figures.copper[0])
    columns = (
        "",
        "copper W",
        "vs sinusoidal %",
        "ripple p-p %",
        "rms A",
        "peak A",
        "neutral rms A",
        "bus V",
        "limit exceeded",
    )
    held = f"held by {', '.join(comparison.binding)}" if comparison.binding else "nothing binds"
    where = f"{comparison.torque:.4g} N m at {in_rpm(comparison.omega_m):.4g} rpm"
    notes = [
        f"{where}; dc link {limits.v_dc:.4g} V, {limits.topology}, {limits.i_max:.4g} A (peak)",
        f"within all limits: {held}",
        *filter(None, [optimality_note(comparison)]),
        *(f"{rule}: {reason}" for rule, reason in comparison.impossible),
        *_open_phase_notes(comparison),
    ]
    rows = tuple(_row(found, base) for found in comparison.rules)
    tables = [Table(f"{design.name}: phase currents", columns, rows, tuple(notes))]
    tables.append(_front_table(comparison))
    harmonics = _harmonic_rows(comparison)
    if harmonics:
        names = ("order", *(f"{found.rule} %" for found in comparison.rules))
        tables.append(
            Table("Harmonics of the current of phase a, in % of its fundamental", names, harmonics)
        )
    return tables


def _open_phase_notes(comparison: WaveformComparison) -> list[str]:
    """What constant torque costs without the open phase, against dqy with all three."""
    found = comparison.without_phase
    if found is None:
        return []
    return [
        (
            f"phase {found.phase} open, constant torque: copper {found.copper:.3g} times and phase "
            f"peak {found.peak:.3g} times those of dqy with all three; neutral "
            f"{found.neutral_rms:.3g} A r.m.s., {found.neutral_peak:.3g} A peak, "
            f"{found.neutral:.2g} times the phase peak before"
        ),
        (
            f"phase {found.phase} open: {100.0 * found.torque_at_peak:.0f} % of the torque is left "
            f"with the same phase peak, {100.0 * found.torque_at_copper:.0f} % with the same "
            "copper loss"
        ),
    ]


def _plain_confirmation(entry: Confirmation) -> PlainData:
    return {
        "torque_Nm": entry.torque,
        "omega_m_rad_per_s": entry.omega_m,
        "ripple_Nm": entry.ripple,
        "verdict": entry.verdict,
        "residuals": asdict(entry.ours) | {"largest": entry.ours.largest},
        "residuals_osqp": asdict(entry.theirs) | {"largest": entry.theirs.largest},
        "loss_difference": entry.loss_difference,
        "current_difference_A": entry.current_difference,
        "iterations": entry.iterations,
    }


def plain_phase_fit(fit: PhaseFit) -> PlainData:
    """The forms for the firmware with their errors as fractions, bytes of
    constants and operations.
    """
    return {
        "chosen": fit.chosen.name,
        "torque_max_Nm": fit.torque_max,
        "candidates": [
            {
                "form": entry.name,
                "errors": asdict(entry.errors),
                "constants_B": entry.flash,
                "operations": entry.operations,
            }
            for entry in fit.candidates
        ],
    }


def plain_waveforms(comparison: WaveformComparison) -> PlainData:
    """Operating point, limits and, per rule, currents and torque over the
    angle with their figures.
    """
    limits = comparison.limits
    return {
        "torque_Nm": comparison.torque,
        "omega_m_rad_per_s": comparison.omega_m,
        "limits": {
            "v_dc_V": limits.v_dc,
            "topology": limits.topology,
            "i_max_A": limits.i_max,
            "ripple_Nm": limits.ripple,
            "neutral_A": limits.neutral,
            "open_phase": limits.open_phase,
            "slew_A_per_s": limits.slew,
        },
        "binding": list(comparison.binding),
        "ripple_front": [
            {"deviation": ripple, "copper_W": loss} for ripple, loss in comparison.front
        ],
        "confirmations": [_plain_confirmation(entry) for entry in comparison.confirmations],
        "optimality": {"floor_W": comparison.floor, "iterations": comparison.iterations}
        if isinstance(comparison.machine, SalientPhaseMachine)
        else None,
        "without_phase": None
        if comparison.without_phase is None
        else asdict(comparison.without_phase),
        "impossible": [{"rule": rule, "reason": reason} for rule, reason in comparison.impossible],
        "theta_rad": comparison.machine.theta,
        "turns": comparison.machine.turns,
        "emf_over_omega_Wb": comparison.machine.flux,
        "rules": {
            found.rule: {
                "currents_A": found.currents,
                "torque_Nm": found.torque,
                "harmonics_A": found.harmonics[:, : _MOST_ORDERS * comparison.machine.turns],
                "copper_W": found.figures.copper[0],
                "mean_torque_Nm": found.figures.torque[0],
                "ripple_Nm": found.figures.ripple[0],
                "rms_A": found.figures.rms[0],
                "peak_A": found.figures.peak[0],
                "neutral_rms_A": found.figures.neutral_rms[0],
                "bus_V": found.figures.bus[0],
                "breaks": list(found.obstacles),
            }
            for found in comparison.rules
        },
    }


# The C header of phase currents and its test vectors, as text.

_SEED = 20_260_502


def _error_lines(fit: PhaseFit) -> list[str]:
    chosen = fit.chosen
    current, torque = (
        rounded_up(100.0 * value) for value in (chosen.errors.current, chosen.errors.torque)
    )
    lines = [
        (
            f"Form {chosen.name}: {chosen.flash} bytes of constants, some {chosen.operations} "
            "operations;"
        ),
        (
            f"currents err by at most {current} % of the peak, the torque by {torque} % of the "
            "torque asked for"
        ),
        (
            f"({chosen.errors.samples} evaluations, with and without fused multiply-add; sampled, "
            "not proven)."
        ),
    ]
    for other in fit.candidates[1:]:
        worst = rounded_up(100.0 * other.errors.current)
        lines.append(
            f"Not chosen: {other.name}, {other.flash} bytes, {other.operations} operations, "
            f"{worst} %."
        )
    return lines


def _span(design: Design) -> str:
    """The turn that a table spans."""
    turns = 1 if design.phase_machine is None else design.phase_machine.turns
    return "electrical" if turns == 1 else "mechanical"


def _angle_lines(design: Design, form: str) -> list[str]:
    """What the C takes as its angle."""
    if form != "table":
        return ["sine, cosine: of the electrical angle of the d axis from phase a."]
    span = _span(design)
    text = (
        f"turn: {span} angle of the d axis from phase a over 2 pi, 0 to below 1; others count as 0."
    )
    if span == "electrical":
        return [text]
    pairs = design.machine.pole_pairs
    return [text, f"The {pairs} pole pairs differ: at 0 the first one of the back-EMF begins."]


def _preamble(design: Design) -> list[str]:
    return [
        (
            f"{design.machine.pole_pairs} pole pairs, {design.i_max:.6g} A (peak), "
            f"{design.inverter.topology}."
        ),
        (
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
            "errors hold either way."
        ),
    ]


def _comment(design: Design, fit: PhaseFit) -> list[str]:
    rule = "with" if TOPOLOGIES[design.inverter.topology].neutral else "without"
    form = fit.reference.form
    proportional = (
        "not in proportion to" if isinstance(form, PhasePolynomials) else "proportional to"
    )
    return [
        (
            f"Constant torque at least copper loss, {rule} zero-sequence current; "
            f"{proportional} the torque."
        ),
        (
            "torque_Nm: torque in N m, clamped to +-TORQUE_MAX; i_a_A, i_b_A, i_c_A: phase "
            "currents in A."
        ),
        *_angle_lines(design, plain_phase_reference(fit.reference)["form"]),
        *_error_lines(fit),
    ]


def waveform_text(reference: PhaseReference, lines: Sequence[str], span: str, prefix: str) -> str:
    """Constants and the function of the header.

    Args:
        reference: What is evaluated.
        lines: What is said of it behind its first sentence.
        span: The turn that a table spans, ``electrical`` or ``mechanical``.
        prefix: Before the names of functions, in capitals before those of constants.
    """
    end, form = f"{prefix.upper()}_WAVEFORM_TORQUE_MAX_NM", reference.form
    most = float_literal(float(reference.torque_max))
    parts = [f"#define {end} ({most}) /* end of the torque domain, N m */"]
    name, rows = f"{prefix}_waveform_table", list[tuple[Expression, ...]]()
    angle = ["sine", "cosine"]
    if isinstance(form, PhaseTable):
        angle, (count, width) = ["turn"], form.entries.shape
        rows = [(Expression("", whole=f"{name}[{row}]"),) for row in range(count)]
        said = (
            f"/* Phase currents over the {span} turn, A/(N m); the last entry repeats the first. */"
        )
        head = f"static const float {name}[{count}][{width}] = {{"
        parts.append("\n".join([said, head, *number_rows(form.entries, 8), "};"]))

    def phase_currents(o: Arithmetic, torque: Reals, *turned: Reals) -> Abc:
        return reference.step(o, torque, turned, Expression(end), rows)

    functions = Functions()
    StepReader(prefix, functions, Block("", set())).write(
        "phase_currents",
        phase_currents,
        [Expression("number")] * (1 + len(angle)),
        into=["i_a_A", "i_b_A", "i_c_A"],
        names=["torque_Nm", *angle],
    )
    said_lines = (f" * {comment_text(line)}".rstrip() for line in lines)
    comment = ["/* Phase currents for a torque and an electrical angle.", " *", *said_lines, " */"]
    return "\n\n".join([*parts, "\n".join([*comment, *functions.texts.values()])])


def waveform_files(design: Design, fit: PhaseFit) -> dict[str, bytes]:
    """Names and bytes of the header of phase currents and of its test vectors."""
    context, prefix = title(design), design.export.prefix
    inputs = waveform_inputs(fit.reference, max(design.export.vectors, 64), _SEED)
    currents = model_currents(fit.reference, inputs)
    vectors = np.concatenate([inputs, currents], axis=1)
    header = {
        "part": "waveform",
        "subject": "phase currents",
        "preamble": _preamble(design),
        "includes": [],
        "body": waveform_text(fit.reference, _comment(design, fit), _span(design), prefix),
        "vectors": True,
    }
    text = render("c_code/header.h.j2", context | header)
    return _harness(inputs.shape[1]).files(design, text, vectors)


def _harness(inputs: int) -> Harness:
    turn = "the turn" if inputs == 2 else "sine and cosine"
    told = f"torque in N m, then {turn}; i_a, i_b and i_c in A"
    given = ", ".join(f"in[{k}]" for k in range(inputs))
    call = f"@_phase_currents({given}, &out[0], &out[1], &out[2]);"
    return Harness("waveform", told, (inputs, 3), (call,))


def waveform_programme(reference: PhaseReference) -> Programme:
    """The harness of phase currents, with what their model answers."""
    inputs = waveform_inputs(reference, SWEEP_POINTS, SWEEP_SEED)
    results = model_currents(reference, inputs)
    return Programme(_harness(inputs.shape[1]), inputs, results, "phase currents")


# Phase currents in the report: what the rules cost, and what the firmware evaluates.

_ROUNDING = 1e-9


def point_words(comparison: WaveformComparison) -> str:
    """Torque and speed for which the currents are shaped."""
    return f"{quantity(comparison.torque, 'N m')} at {quantity(comparison.omega_m, 'rpm')}"


def comparison_text(comparison: WaveformComparison) -> str:
    """The operating point, and what holds the currents there."""
    limits = comparison.limits
    where = point_words(comparison)
    held = (
        f"held by the limits of {', '.join(comparison.binding)}"
        if comparison.binding
        else "held by no limit"
    )
    source = (
        f"{quantity(limits.v_dc, 'V')} ({limits.topology}), at most {quantity(limits.i_max, 'A')} "
        "(peak)"
    )
    note = optimality_note(comparison)
    return (
        f"{where} from {source}; the last row is "
        f"{held}.{f' {note[0].upper()}{note[1:]}.' if note else ''}"
    )


def _cells(found: RuleCurrents) -> tuple[str, ...]:
    values, torque = found.figures, abs(float(found.figures.torque[0]))
    ripple, neutral = float(values.ripple[0]) / torque, float(values.neutral_rms[0])
    return (
        RULE_TEXT[found.rule],
        quantity(float(values.copper[0]), "W"),
        share(ripple, 3) if ripple > _ROUNDING else "0",
        quantity(float(values.rms[0]), "A"),
        quantity(float(values.peak[0]), "A"),
        quantity(neutral, "A", 3) if neutral > _ROUNDING * float(values.rms[0]) else "0",
        quantity(float(values.bus[0]), "V"),
        ", ".join(found.obstacles) or "none",
    )


def rules_table(comparison: WaveformComparison) -> HtmlTable:
    """One row per rule."""
    columns = ("", "copper", "ripple p-p", "r.m.s.", "peak", "neutral", "dc link", "limit exceeded")
    rows = tuple(
        Row(
            _cells(found),
            "chosen" if found.rule == "limited" else "muted" if found.obstacles else "",
        )
        for found in comparison.rules
    )
    caption = "Phase currents by rule: copper loss, torque ripple, currents, dc link needed"
    return HtmlTable(caption, tuple(symbols(text) for text in columns), rows)


def _confirmation_cells(entry: Confirmation) -> tuple[str, ...]:
    return (
        share(entry.ripple / abs(entry.torque)) if entry.torque else "0",
        entry.verdict,
        *(
            f"{side.largest:.1e}" if math.isfinite(side.largest) else "none"
            for side in (entry.ours, entry.theirs)
        ),
        f"{100.0 * entry.loss_difference:+.0e} %"
        if math.isfinite(entry.loss_difference)
        else "none",
        f"{entry.current_difference:.1e} A" if math.isfinite(entry.current_difference) else "none",
        f"{entry.iterations}",
    )


def confirmations_table(comparison: WaveformComparison) -> HtmlTable:
    """Every quadratic programme with the residuals of both solvers."""
    columns = (
        "deviation",
        "by OSQP",
        "residual here",
        "residual of OSQP",
        "loss",
        "current",
        "iterations",
    )
    rows = tuple(
        Row(_confirmation_cells(entry), "muted" if entry.verdict == "differs" else "")
        for entry in comparison.confirmations
    )
    caption = (
        "The same programmes solved by OSQP: largest residual of the optimality conditions, "
        "differences"
    )
    return HtmlTable(caption, columns, rows, folded=True)


def _candidate_cells(entry: PhaseCandidate) -> tuple[str, ...]:
    return (
        entry.name,
        share(ceiling(entry.errors.current), 3),
        share(ceiling(entry.errors.torque), 3),
        f"{entry.flash} B",
        f"{entry.operations}",
    )


def candidates_table(fit: PhaseFit) -> HtmlTable:
    """The forms for the firmware, the emitted one first."""
    columns = ("", "current error of peak", "torque error", "constants", "operations")
    rows = tuple(
        Row(_candidate_cells(entry), "chosen" if entry is fit.chosen else "")
        for entry in fit.candidates
    )
    return HtmlTable(
        "Forms for the firmware: largest errors found",
        tuple(symbols(text) for text in columns),
        rows,
    )


def waveform_passage(found: WaveformComparison, phases: PhaseFit, file: str) -> Passage:
    """The part of the report on phase currents."""
    from markupsafe import Markup

    caption = (
        "Top: back-EMF over electrical speed, and the phase currents of each rule over the "
        "electrical angle. Below: the torque they make, and the harmonics of phase a on a "
        "logarithmic scale."
    )
    tables = [rules_table(found), candidates_table(phases)]
    emitted = Markup("The currents are emitted per torque into <code>{}</code>.").format(file)
    return Passage(
        text=[comparison_text(found)],
        drawings=[("waveforms", caption)],
        tables=[*tables, confirmations_table(found)] if found.confirmations else tables,
        after=[emitted],
    )


# Phase currents of machines whose back-EMF is not sinusoidal, as records.

_SECTION = "phase currents"
_RULES = ("dq", "dqx", "dqy", "limited")


def _figures(_: Solution, comparison: WaveformComparison) -> Mapping[str, Draw]:
    from dqforge.reports.waveforms.figures import plot_waveforms

    return {"waveforms": lambda: plot_waveforms(comparison)}


def _parts(solution: Solution, found: WaveformComparison) -> list[ReportPart]:
    if solution.phases is None:
        return []
    file = f"{solution.design.export.prefix}_waveform.h"
    return [waveform_passage(found, solution.phases, file).of(CHAPTER, point_words(found))]


WAVEFORMS = Capability(
    name="waveforms",
    title="phase currents by rule",
    of=lambda outcome: outcome.solution.waveforms,
    plain=lambda _, comparison: plain_waveforms(comparison),
    tables=lambda solution, comparison: waveform_tables(solution.design, comparison),
    figures=_figures,
    parts=_parts,
    quantities=(
        Quantity(_SECTION, "torque", "N m", ("waveforms", "torque_Nm")),
        Quantity(_SECTION, "speed", "rpm", ("waveforms", "omega_m_rad_per_s")),
        *(
            Quantity(
                _SECTION, f"copper loss, {rule}", "W", ("waveforms", "rules", rule, "copper_W")
            )
            for rule in _RULES
        ),
    ),
)

PHASE_REFERENCE = Capability(
    name="waveform_fit",
    title="phase currents in the firmware",
    of=lambda outcome: outcome.solution.phases,
    plain=lambda _, fit: plain_phase_fit(fit),
    headers=(
        HeaderKind(
            name="waveform",
            files=lambda solution, fit: waveform_files(solution.design, fit),
            plain=lambda _, fit: plain_phase_reference(fit.reference),
            read=lambda own, _: phase_reference_from(own),
            programme=waveform_programme,
        ),
    ),
)
