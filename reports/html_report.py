"""The report of a design: one HTML file that asks for nothing outside itself, the same bytes for the same solution."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dqforge import __version__
from dqforge.machines.design import Design
from dqforge.optimizer.gains import LoopGains
from dqforge.optimizer.solution import Solution, signed_designs
from dqforge.reports.certificate_text import proof_title, proven_text
from dqforge.reports.control_fixed_tables import control_fixed_html
from dqforge.reports.data_text import data_lines
from dqforge.reports.drive_simulation import DriveSimulation
from dqforge.reports.figures_losses import POINTS_SHOWN
from dqforge.reports.figures_reference import ROUNDING
from dqforge.reports.header import header_context
from dqforge.reports.html_choice import choice_part
from dqforge.reports.html_mission import mission_part
from dqforge.reports.html_tables import (
    LOOP_TEXT,
    STRATEGY_TEXT,
    HtmlTable,
    alternatives_table,
    ceiling,
    coefficient_table,
    constant_rows,
    differs_from_id0,
    fact_rows,
    loop_table,
    loss_tables,
    losses_of,
    observer_tables,
    operating_table,
    other_assumptions,
    trials_table,
    value_rows,
)
from dqforge.reports.html_text import count, degrees, number, quantity, share, symbols
from dqforge.reports.html_tolerances import tolerance_tables
from dqforge.reports.html_waveforms import candidates_table, comparison_text, confirmations_table, rules_table
from dqforge.reports.labels import FORMAT_TEXT, MODULATION_LABELS, operation_text, point_text, watts
from dqforge.reports.observed_text import left_words
from dqforge.reports.reference_ir import PlainData, to_plain
from dqforge.reports.simulation_tables import simulation_part
from dqforge.reports.templating import render
from dqforge.reports.verify import Verification
from dqforge.reports.weakening_tables import weakening_html
from dqforge.reports.weakening_text import domain_text, errors_text, least_voltage_text, proof_text

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

_FORM_TEXT = {
    "proportional": "i_d is zero and i_q is proportional to the torque; this is exact.",
    "polynomial": "i_d and i_q are polynomials of the torque.",
    "torque-exact": (
        "i_d is a polynomial of the torque and i_q is the torque divided by what one ampere of i_q makes at that i_d. "
        "The torque therefore has no error but that of rounding."
    ),
    "closed-form": (
        "i_q is a polynomial of the torque and i_d follows from it by the MTPA locus. "
        "The currents therefore lie on the optimum locus."
    ),
    "reluctance": "i_q is a square root of the torque and i_d has the same magnitude; this is exact.",
}


@dataclass(frozen=True, slots=True)
class Tile:
    """A key number of the summary: what it is, the number, and what stands behind it."""

    label: str | Markup
    value: str
    detail: str | Markup


@dataclass(frozen=True, slots=True)
class Saving:
    """Copper loss in W of the chosen strategy and of i_d = 0 at the largest torque in N m that both can make."""

    torque: float
    chosen: float
    id0: float

    @property
    def relative(self) -> float:
        """What is saved, as a share of the loss at i_d = 0."""
        return 1.0 - self.chosen / self.id0


def copper_saving(solution: Solution) -> Saving | None:
    """What the strategy saves against i_d = 0, or None where the two are the same or the machine has no magnet."""
    curves, design = solution.curves, solution.design
    if curves.id0 is None or not differs_from_id0(design):
        return None
    common = np.flatnonzero(~curves.id0.limited & ~curves.chosen.limited)
    last = int(common[-1])
    chosen, id0 = (float(losses_of(design, points)[last]) for points in (curves.chosen, curves.id0))
    return Saving(float(curves.chosen.torque[last]), chosen, id0) if id0 > 0.0 else None


def _loops(solution: Solution) -> list[LoopGains]:
    gains = solution.loops
    if gains is None:
        return []
    return [loop for loop in (gains.i_d, gains.i_q, gains.speed) if loop is not None]


def verification_text(verification: Verification | None) -> tuple[str, str]:
    """(short outcome, sentence) of the comparison of the compiled header with the model."""
    if verification is None:
        return "not verified", "The header of this run was not compiled and not compared with its model."
    total = count(verification.vectors + verification.sweep)
    done = " and ".join(standard.upper() for standard in verification.languages)
    text = (
        f"The header was compiled as {done} with all warnings as errors. {total} results of the compiled evaluator, "
        f"those of {verification.vectors} test vectors and of {count(verification.sweep)} further torques, equal the "
        "model bit for bit."
    )
    for check in verification.checks:
        if check.missing:
            text += f" {check.standard.upper()} was not tried: it needs the Debian package {check.missing}."
    return "bit-exact", text


def _best_loss(solution: Solution) -> tuple[str, str, str] | None:
    """(total, alternative, comparison) at the first operating point that has a feasible alternative."""
    comparison = solution.losses
    if comparison is None:
        return None
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        if best is None:
            continue
        index = (int(comparison.best_strategy[p]), int(comparison.best_modulation[p]), p)
        alternative = f"{STRATEGY_TEXT[best[0]]} with {MODULATION_LABELS[best[1]]}"
        first = f"{STRATEGY_TEXT[comparison.strategies[0]]} with {MODULATION_LABELS[comparison.modulations[0]]}"
        saving = float(comparison.saving[index]) / 100.0
        against = f", {share(saving, 3)} below {first}" if math.isfinite(saving) and saving > 0.0 else ""
        return watts(float(comparison.budget.total[index])), alternative, f"at {point_text(point)}{against}"
    return None


def _compared(verification: Verification | None) -> str:
    if verification is None:
        return "this run skipped it"
    languages = " and ".join(standard.upper() for standard in verification.languages)
    return f"{count(verification.vectors + verification.sweep)} results equal the model, {languages}"


def _margin(loop: LoopGains) -> str:
    """Phase margin, or that the loop has none."""
    return degrees(loop.phase_margin) if loop.stable else "unstable"


def _margin_tile(loops: list[LoopGains]) -> Tile:
    worst = min(loops, key=lambda loop: (loop.stable, abs(loop.phase_margin)))
    others = [f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in loops if loop is not worst]
    detail = symbols(f"{LOOP_TEXT[worst.loop]} loop; {', '.join(others)}")
    return Tile("Smallest phase margin", _margin(worst), detail)


def tiles(solution: Solution, verification: Verification | None) -> list[Tile]:
    """The key numbers."""
    fit, chosen = solution.fit, solution.curves.chosen
    arithmetic = FORMAT_TEXT[fit.settings.format or "float32"]
    current = float(np.hypot(chosen.i_d[-1], chosen.i_q[-1]))
    limit = f"with {number(current)} of {number(solution.design.i_max)} A (peak)"
    found = [
        Tile("Largest torque", quantity(fit.torque_max, "N m"), limit),
        Tile(
            "Torque error of the reference",
            quantity(ceiling(fit.errors.torque), "N m", 3),
            f"{share(ceiling(fit.errors.torque_relative, 2))} of the largest torque, in {arithmetic}",
        ),
    ]
    saving = copper_saving(solution)
    if saving is not None:
        detail = f"{watts(saving.chosen)} instead of {watts(saving.id0)} at {quantity(saving.torque, 'N m')}"
        found.append(Tile(symbols("Copper loss saved against i_d = 0"), share(saving.relative, 3), detail))
    if _loops(solution):
        found.append(_margin_tile(_loops(solution)))
    best = _best_loss(solution)
    if best is not None:
        found.append(Tile("Least total loss", best[0], symbols(f"{best[1]} {best[2]}")))
    found.append(Tile("Emitted C code", verification_text(verification)[0], _compared(verification)))
    return found


def _penalty_text(solution: Solution) -> str:
    errors = solution.fit.errors
    least = "the least" if solution.design.strategy == "mtpa" else "that of exact i_d = 0"
    if errors.loss_relative <= ROUNDING:
        return f"the copper loss is {least} but for rounding"
    return (
        f"the copper loss lies at most {quantity(ceiling(errors.loss), 'W', 3)} or "
        f"{share(ceiling(errors.loss_relative, 2))} above {least}"
    )


def _proof_text(solution: Solution) -> str:
    """Whether the errors of the summary are proven."""
    proof = solution.certificate
    if proof is None:
        return "both are sampled"
    torque = quantity(ceiling(proof.torque), "N m", 3)
    if proof.loss_relative is None:
        return f"proven are {torque}"
    return f"proven are {torque} and {share(ceiling(proof.loss_relative, 2))}"


def summary(solution: Solution, verification: Verification | None) -> Markup:
    """One paragraph with the key numbers."""
    fit, errors, design = solution.fit, solution.fit.errors, solution.design
    where = operation_text(design)
    sentences = [
        (
            f"The current reference follows {STRATEGY_TEXT[design.strategy]}{f' at {where}' if where else ''} up to "
            f"{quantity(fit.torque_max, 'N m')}."
        ),
        (
            f"The torque errs by at most {quantity(ceiling(errors.torque), 'N m', 3)}, {_penalty_text(solution)}; "
            f"{_proof_text(solution)}."
        ),
    ]
    half = solution.negative
    if half is not None:
        proof = "sampled" if half.certificate is None else f"proven: {proven_text(half.certificate, 3)}"
        sentences.append(
            f"Negative torques have a reference of their own, up to {quantity(half.fit.torque_max, 'N m')}; its torque "
            f"errs by at most {quantity(ceiling(half.fit.errors.torque), 'N m', 3)} ({proof})."
        )
    saving = copper_saving(solution)
    if saving is not None:
        where = quantity(saving.torque, "N m")
        sentences.append(f"Against i_d = 0 it saves {share(saving.relative, 3)} of the copper loss at {where}.")
    margins = [f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in _loops(solution)]
    none = f"There are no control loops: {solution.gains_left_out}."
    sentences.append(f"The phase margins of the sampled loops are {', '.join(margins)}." if margins else none)
    speed = None if solution.loops is None else solution.loops.speed
    if speed is not None and speed.observed is not None:
        sentences.append(f"The speed loop is judged with the lag of its observer; {left_words(speed)}.")
    best = _best_loss(solution)
    if best is not None:
        sentences.append(f"The alternative that loses least is {best[1]}: {best[0]} {best[2]}.")
    outcome = "The emitted C was not verified." if verification is None else "The emitted C was compiled and checked."
    return symbols(" ".join([*sentences, outcome]))


def _figures(solution: Solution) -> dict[str, Markup]:
    """The figures as inline SVG, by name."""
    from markupsafe import Markup

    from dqforge.reports import figures

    design, fit = solution.design, solution.fit
    positive = signed_designs(design)[0]
    drawn: dict[str, Callable[[], Figure]] = {
        "mtpa": lambda: figures.plot_mtpa(positive, solution.curves, fit),
        "fit": lambda: figures.plot_fit(positive, fit),
        "errors": lambda: figures.plot_errors(positive, fit),
    }
    gains = solution.loops
    if gains is not None:
        drawn["loops"] = lambda: figures.plot_gains(design, gains)
    losses = solution.losses
    if losses is not None:
        drawn["losses"] = lambda: figures.plot_losses(design, losses)
    waveforms = solution.waveforms
    if waveforms is not None:
        from dqforge.reports.figures_waveforms import plot_waveforms

        drawn["waveforms"] = lambda: plot_waveforms(waveforms)
    weakening = solution.weakening
    if weakening is not None:
        from dqforge.reports.figures_weakening import plot_weakening

        drawn["weakening"] = lambda: plot_weakening(weakening)
    mission = solution.mission
    if mission is not None:
        from dqforge.reports.figures_drive_losses import plot_mission

        drawn["mission"] = lambda: plot_mission(mission)
    choice = solution.choice
    if choice is not None:
        from dqforge.reports.figures_choice import plot_choice

        drawn["choice"] = lambda: plot_choice(choice)
    return {name: Markup(figures.to_svg(draw())) for name, draw in drawn.items()}


def _waveform_part(solution: Solution) -> PlainData | None:
    if solution.waveforms is None or solution.phases is None:
        return None
    return {
        "text": comparison_text(solution.waveforms),
        "tables": [
            rules_table(solution.waveforms),
            candidates_table(solution.phases),
            *([confirmations_table(solution.waveforms)] if solution.waveforms.confirmations else []),
        ],
        "file": f"{solution.design.export.prefix}_waveform.h",
    }


def _weakening_part(solution: Solution) -> PlainData | None:
    fit = solution.weakening
    if fit is None:
        return None
    prefix = solution.design.export.prefix
    return {
        "domain": domain_text(fit),
        "errors": errors_text(fit),
        "proven": proof_text(fit),
        "samples": count(fit.errors.samples + fit.voltage.samples),
        "least_voltage": least_voltage_text(fit),
        "table": weakening_html(fit),
        "prefix": prefix,
    }


def _reference_part(solution: Solution) -> PlainData:
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
        "alternatives": alternatives_table(fit, solution.alternatives) if solution.alternatives else None,
        "trials": trials_table(solution.trials, solution.design.fit.core) if solution.trials else None,
    }


def _sections(
    design: Design, *, loops: bool, losses: bool, waveforms: bool, simulated: bool = False
) -> list[tuple[str, str | Markup]]:
    sections: list[tuple[str, str | Markup]] = [
        ("summary", "Summary"),
        ("machine", "Machine and assumptions"),
        ("reference", "Current reference"),
        ("errors", "Torque error and loss"),
    ]
    if loops:
        sections.append(("loops", "Control loops"))
    if losses:
        sections.append(("losses", "Loss comparison"))
    if waveforms:
        sections.append(("waveforms", "Phase currents"))
    if design.modulation_choice is not None:
        sections.append(("modulation", "Modulator and frequency"))
    if design.weakening is not None:
        sections.append(("weakening", "Field weakening"))
    if simulated:
        sections.append(("simulation", "Simulation"))
    return [*sections, ("header", f"{design.export.prefix}.h"), ("conventions", "Conventions")]


def _loop_tables(solution: Solution) -> list[HtmlTable]:
    gains, design = solution.loops, solution.design
    if gains is None:
        return []
    return [
        loop_table(design, gains),
        *tolerance_tables(gains),
        *observer_tables(design, gains, solution.fit.torque_max),
        *control_fixed_html(solution.fixed),
    ]


def _has_losses(solution: Solution) -> bool:
    return solution.losses is not None or solution.mission is not None


def report_context(
    solution: Solution, verification: Verification | None, simulation: DriveSimulation | None = None
) -> PlainData:
    """Everything that the template prints."""
    design, errors, proof = solution.design, solution.fit.errors, solution.certificate
    return {
        "name": design.name,
        "about": design.about,
        "version": __version__,
        "digest": design.digest,
        "sections": _sections(
            design,
            loops=solution.loops is not None,
            losses=_has_losses(solution),
            waveforms=solution.waveforms is not None,
            simulated=simulation is not None,
        ),
        "summary": summary(solution, verification),
        "tiles": tiles(solution, verification),
        "facts": fact_rows(design),
        "values": value_rows(design),
        "assumptions": other_assumptions(design),
        "figures": _figures(solution),
        "reference": _reference_part(solution),
        "errors": {
            "samples": count(errors.samples),
            "proven": "" if proof is None else symbols(proven_text(proof, 3)),
            "proven_title": "" if proof is None else proof_title(proof),
            "torque": (
                f"{quantity(ceiling(errors.torque), 'N m', 3)} "
                f"({share(ceiling(errors.torque_relative, 2))} of the largest torque)"
            ),
            "loss": symbols(_penalty_text(solution)),
        },
        "loops": _loop_tables(solution),
        "losses": [] if solution.losses is None else loss_tables(solution.losses),
        "mission": mission_part(solution),
        "points_left_out": 0 if solution.losses is None else max(0, len(solution.losses.points) - POINTS_SHOWN),
        "waveforms": _waveform_part(solution),
        "weakening": _weakening_part(solution),
        "choice": choice_part(solution.choice, design.export.prefix),
        "simulation": simulation_part(simulation),
        "header": header_context(solution),
        "verification": {
            "done": verification is not None,
            "text": verification_text(verification)[1],
        },
    }


def render_report(
    solution: Solution, verification: Verification | None, simulation: DriveSimulation | None = None
) -> str:
    """The report of a solution as one HTML document.

    Parameters
    ----------
    solution:
        What was solved.
    verification:
        Outcome of compiling and running the header, or None if that was skipped; the report says which.
    simulation:
        Outcome of the simulation, or None where there is none.
    """
    return render("report.html.j2", report_context(solution, verification, simulation))
