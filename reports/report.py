"""The report of a design: one HTML file that asks for nothing outside itself,
the same bytes for the same solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.loops.gains import LoopGains
from dqforge.optimizer.solution import Solution
from dqforge.reports.control.fixed_tables import control_fixed_html
from dqforge.reports.current_reference.figures import plot_errors, plot_fit, plot_mtpa
from dqforge.reports.current_reference.html import (
    penalty_text,
    reference_part,
    reference_proof_text,
)
from dqforge.reports.field_weakening.tables import weakening_part
from dqforge.reports.loops.figures import plot_gains
from dqforge.reports.loops.html import LOOP_TEXT, loop_table, tolerance_tables
from dqforge.reports.losses.figures import POINTS_SHOWN, plot_losses
from dqforge.reports.losses.html import best_loss, loss_tables, mission_part
from dqforge.reports.main_header.header import header_context
from dqforge.reports.modulation_choice.html import choice_part
from dqforge.reports.observers.html import observer_tables
from dqforge.reports.observers.speed_loop_text import left_words
from dqforge.reports.pages.certificate_text import proof_title, proven_text
from dqforge.reports.pages.figures_style import save, to_svg
from dqforge.reports.pages.html_table import HtmlTable
from dqforge.reports.pages.html_text import (
    NARROW,
    ceiling,
    count,
    degrees,
    number,
    quantity,
    share,
    symbols,
    unit_text,
)
from dqforge.reports.pages.labels import (
    FORMAT_TEXT,
    STRATEGY_TEXT,
    operation_text,
    watts,
)
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.design_run import DriveSimulation
from dqforge.reports.simulation.tables import simulation_part
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import compared
from dqforge.reports.waveforms.html import (
    waveform_part,
)

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure
if TYPE_CHECKING:
    from markupsafe import Markup


@dataclass(frozen=True, slots=True)
class Tile:
    """A key number of the summary: what it is, the number, and what stands behind it."""

    label: str | Markup
    value: str
    detail: str | Markup


def _loops(solution: Solution) -> list[LoopGains]:
    gains = solution.loops
    if gains is None:
        return []
    return [loop for loop in (gains.i_d, gains.i_q, gains.speed) if loop is not None]


def verification_text(verification: Verification | None) -> tuple[str, str]:
    """(short outcome, sentence) of the comparison of the compiled header with the model."""
    if verification is None:
        return (
            "not verified",
            "The header of this run was not compiled and not compared with its model.",
        )
    total = count(verification.vectors + verification.sweep)
    done = " and ".join(standard.upper() for standard in verification.languages)
    text = (
        f"The header was compiled as {done} with all warnings as errors. {total} results of the "
        f"compiled evaluator, those of {verification.vectors} test vectors and of "
        f"{count(verification.sweep)} further torques, equal the model bit for bit."
    )
    for check in verification.checks:
        if check.missing:
            text += (
                f" {check.standard.upper()} was not tried: it needs the Debian package "
                f"{check.missing}."
            )
    return "bit-exact", text


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
        found.append(
            Tile(symbols("Copper loss saved against i_d = 0"), share(saving.relative, 3), detail)
        )
    if _loops(solution):
        found.append(_margin_tile(_loops(solution)))
    best = best_loss(solution)
    if best is not None:
        found.append(Tile("Least total loss", best[0], symbols(f"{best[1]} {best[2]}")))
    found.append(Tile("Emitted C code", verification_text(verification)[0], compared(verification)))
    return found


def summary(solution: Solution, verification: Verification | None) -> Markup:
    """One paragraph with the key numbers."""
    fit, errors, design = solution.fit, solution.fit.errors, solution.design
    where = operation_text(fit.speed)
    sentences = [
        (
            "The current reference follows "
            f"{STRATEGY_TEXT[design.strategy]}{f' at {where}' if where else ''} up to "
            f"{quantity(fit.torque_max, 'N m')}."
        ),
        (
            f"The torque errs by at most {quantity(ceiling(errors.torque), 'N m', 3)}, "
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
        where = quantity(saving.torque, "N m")
        sentences.append(
            f"Against i_d = 0 it saves {share(saving.relative, 3)} of the copper loss at {where}."
        )
    margins = [f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in _loops(solution)]
    none = f"There are no control loops: {solution.gains_left_out}."
    sentences.append(
        f"The phase margins of the sampled loops are {', '.join(margins)}." if margins else none
    )
    speed = None if solution.loops is None else solution.loops.speed
    if speed is not None and speed.observed is not None:
        sentences.append(
            f"The speed loop is judged with the lag of its observer; {left_words(speed)}."
        )
    best = best_loss(solution)
    if best is not None:
        sentences.append(f"The alternative that loses least is {best[1]}: {best[0]} {best[2]}.")
    outcome = (
        "The emitted C was not verified."
        if verification is None
        else "The emitted C was compiled and checked."
    )
    return symbols(" ".join([*sentences, outcome]))


def _figures(solution: Solution) -> dict[str, Markup]:
    """The figures as inline SVG, by name."""
    from markupsafe import Markup

    design, positive, fit = solution.design, solution.positive, solution.fit
    drawn: dict[str, Callable[[], Figure]] = {
        "mtpa": lambda: plot_mtpa(positive, solution.curves, fit),
        "fit": lambda: plot_fit(positive, fit),
        "errors": lambda: plot_errors(fit),
    }
    gains = solution.loops
    if gains is not None:
        drawn["loops"] = lambda: plot_gains(design, gains)
    losses = solution.losses
    if losses is not None:
        drawn["losses"] = lambda: plot_losses(design, losses)
    waveforms = solution.waveforms
    if waveforms is not None:
        from dqforge.reports.waveforms.figures import plot_waveforms

        drawn["waveforms"] = lambda: plot_waveforms(waveforms)
    weakening = solution.weakening
    if weakening is not None:
        from dqforge.reports.field_weakening.figures import plot_weakening

        drawn["weakening"] = lambda: plot_weakening(weakening)
    mission = solution.mission
    if mission is not None:
        from dqforge.reports.losses.map_figures import plot_mission

        drawn["mission"] = lambda: plot_mission(mission)
    choice = solution.choice
    if choice is not None:
        from dqforge.reports.modulation_choice.figures import plot_choice

        drawn["choice"] = lambda: plot_choice(choice)
    return {name: Markup(to_svg(draw())) for name, draw in drawn.items()}


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
        "reference": reference_part(solution),
        "errors": {
            "samples": count(errors.samples),
            "proven": "" if proof is None else symbols(proven_text(proof, 3)),
            "proven_title": "" if proof is None else proof_title(proof),
            "torque": (
                f"{quantity(ceiling(errors.torque), 'N m', 3)} "
                f"({share(ceiling(errors.torque_relative, 2))} of the largest torque)"
            ),
            "loss": symbols(penalty_text(solution)),
        },
        "loops": _loop_tables(solution),
        "losses": [] if solution.losses is None else loss_tables(solution.losses),
        "mission": mission_part(solution),
        "points_left_out": 0
        if solution.losses is None
        else max(0, len(solution.losses.points) - POINTS_SHOWN),
        "waveforms": waveform_part(solution),
        "weakening": weakening_part(solution),
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
        Outcome of compiling and running the header, or None if that was skipped;
        the report says which.
    simulation:
        Outcome of the simulation, or None where there is none.
    """
    return render("pages/report.html.j2", report_context(solution, verification, simulation))


__all__ = ["plot_errors", "plot_fit", "plot_gains", "plot_losses", "plot_mtpa", "save", "to_svg"]


def fact_rows(design: Design) -> list[tuple[Markup, str]]:
    """The drive in one glance: label and value."""
    machine, inverter, control = design.machine, design.inverter, design.control
    rest = "" if isinstance(machine, LinearMachine) else " at zero current"
    facts = [
        ("pole pairs", f"{machine.pole_pairs}"),
        ("phase resistance R_s", quantity(machine.r_s, "Ohm")),
        (f"inductance L_d{rest}", quantity(machine.l_d, "H")),
        (f"inductance L_q{rest}", quantity(machine.l_q, "H")),
        ("magnet flux \u03c8_PM (peak)", quantity(machine.psi_pm, "Wb")),
        ("current limit (peak)", quantity(design.i_max, "A")),
        ("dc link", quantity(inverter.v_dc, "V")),
        ("switching frequency", quantity(inverter.f_sw, "Hz")),
        ("current control every", quantity(control.t_s, "s")),
    ]
    if machine.inertia is not None:
        facts.append(("inertia", quantity(machine.inertia, "kg m^2")))
    if machine.omega_m_max is not None:
        facts.append(("largest speed", quantity(machine.omega_m_max, "rpm")))
    if design.operation.omega_m is not None:
        facts.append(("speed of the references", quantity(design.operation.omega_m, "rpm")))
    return [(symbols(label), value) for label, value in facts]


def value_rows(design: Design) -> list[PlainData]:
    """Every value of the input file; all text of it is left to the template to escape."""
    return [
        {
            "path": value.path,
            "text": value.text,
            "si": f"{number(value.si, 6)}{NARROW}{unit_text(value.unit)}".rstrip(),
            "source": value.source,
            "inferred": value.inferred,
            "note": value.note,
        }
        for value in design.values
    ]


def other_assumptions(design: Design) -> list[str]:
    """Assumptions that the table of values does not tell already."""
    told = tuple(f"{value.path} is inferred" for value in design.values if value.inferred)
    return [sentence for sentence in design.assumptions if not sentence.startswith(told or ("\0",))]
