"""The report of a design: one HTML file that asks for nothing outside itself, the same bytes for
the same solution; and what `run` says of a design on the terminal.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import SignedReference
from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import (
    Capabilities,
    Capability,
    Flashed,
    Outcome,
    Rows,
    Tile,
    asked_for,
)
from dqforge.reports.main_header import NEUTRAL, Dialect, header_context
from dqforge.reports.pages.answer import NUMBER_AND_UNIT, Table
from dqforge.reports.pages.html_text import (
    NARROW,
    HtmlTable,
    count,
    counted,
    number,
    quantity,
    symbols,
    unit_text,
)
from dqforge.reports.pages.templating import CHAPTERS, page_figure, render
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run_folder import FIGURES, FOLDING, ListedFile, files_table, page_scripts
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.text import compared
from dqforge.reports.verification.text import verification_text as text_verification_text

if TYPE_CHECKING:
    from markupsafe import Markup

    from dqforge.reports.simulation.design_run import DriveSimulation


Found = Sequence[tuple[Capability[Any], Any]]
FILES = "What this run wrote beside this page"  # Caption of the table of files.


@dataclass(frozen=True, slots=True)
class WrittenChapter:
    """A chapter as it stands in the report; its text is empty where nobody wrote a part of it.

    ``told`` stands beside its heading: its key number, and what it holds.
    """

    id: str
    title: str
    text: Markup
    told: Markup
    folded: bool = False


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
                f" {check.standard.upper()} was not tested: it needs the Debian package "
                f"{check.missing}."
            )
    return "bit-exact", text


def tiles(solution: Solution, found: Found, verification: Verification | None) -> list[Tile]:
    """The key numbers."""
    parts = [tile for capability, result in found for tile in capability.tiles(solution, result)]
    last = Tile("Emitted C code", verification_text(verification)[0], compared(verification))
    return [*parts, last]


def summary(outcome: Outcome, found: Found) -> Markup:
    """One paragraph with the key numbers."""
    sentences = [
        sentence
        for capability, result in found
        for sentence in capability.sentences(outcome.solution, result)
    ]
    end = (
        "The emitted C was not verified."
        if not outcome.verified
        else "The emitted C was compiled and checked."
    )
    return symbols(" ".join([*sentences, end]))


def chapters(solution: Solution, found: Found) -> list[WrittenChapter]:
    """The chapters with the parts that the capabilities write, each figure as inline SVG."""
    from markupsafe import Markup, escape

    texts: dict[Any, str] = dict.fromkeys(CHAPTERS, "")
    keys: dict[Any, str | Markup] = {}
    for capability, result in found:
        parts = capability.parts(solution, result)
        drawings = capability.figures(solution, result) if parts else {}
        prefix = solution.design.export.prefix
        figures = {
            name: page_figure(draw(), f"{prefix}-{name.replace('_', '-')}")
            for name, draw in drawings.items()
        }
        for part in parts:
            before = texts.get(part.chapter, "")
            if not before and part.chapter.opening:
                before = f"<p>{escape(part.chapter.opening)}</p>\n"
            text = render(part.template, {"data": part.data, "figures": figures})
            texts[part.chapter] = before + text
            keys[part.chapter] = keys.get(part.chapter) or part.key
    return [
        WrittenChapter(
            each.id, each.title, Markup(text), _told(keys.get(each, ""), text), each.folded
        )
        for each, text in texts.items()
    ]


def _told(key: str | Markup, text: str) -> Markup:
    """What stands beside the heading of a chapter."""
    from markupsafe import Markup

    figures = text.count('<figure class="drawing')
    tables = text.count('<figure class="table') + text.count('<details class="table')
    held = [counted(many, what) for many, what in ((figures, "figure"), (tables, "table")) if many]
    shown = [Markup("<strong>{}</strong>").format(key)] if key else []
    return Markup(" ").join([*shown, Markup(", ".join(held))])


def _contents(
    design: Design, written: Sequence[WrittenChapter], beside: HtmlTable | None
) -> list[tuple[str, str]]:
    first, *others = [(chapter.id, chapter.title) for chapter in written if chapter.text]
    return [
        ("summary", "What to flash"),
        first,
        ("evidence", "Evidence"),
        ("machine", "Machine and assumptions"),
        *others,
        ("header", f"{design.export.prefix}.h"),
        *([] if beside is None else [("files", "Files")]),
        ("conventions", "Conventions"),
    ]


def _beside(files: Sequence[ListedFile]) -> HtmlTable | None:
    """The files beside the report, None where it stands alone."""
    note = (
        "The links lead to them as long as this page lies in the folder of the run. The manifest "
        "has the whole SHA-256 of every file, this page included."
    )
    return files_table(files, FILES, note) if files else None


def report_context(
    outcome: Outcome,
    verification: Verification | None,
    capabilities: Capabilities = CAPABILITIES,
    dialect: Dialect = NEUTRAL,
    files: Sequence[ListedFile] = (),
) -> PlainData:
    """Everything that the frame of the report prints."""
    design, found = outcome.design, asked_for(capabilities, outcome)
    written, beside = chapters(outcome.solution, found), _beside(files)
    values = value_rows(design)
    return {
        "name": design.name,
        "about": design.about,
        "version": __version__,
        "digest": design.digest,
        "scripts": page_scripts(FIGURES, FOLDING),
        "sections": _contents(design, written, beside),
        "flashed": [
            tuple(
                symbols(NUMBER_AND_UNIT.sub(NARROW, text))
                for text in (row.label, row.value, row.meaning)
            )
            for row in flashed(outcome, capabilities)
        ],
        "watched": [symbols(text) for text in watched(outcome, capabilities)],
        "summary": summary(outcome, found),
        "tiles": tiles(outcome.solution, found, verification),
        "facts": fact_rows(design),
        "values": values,
        "values_told": values_told(values),
        "assumptions": other_assumptions(design),
        "chapters": [chapter for chapter in written if chapter.text],
        "header": header_context(outcome.solution, dialect),
        "signed": isinstance(outcome.solution.reference, SignedReference),
        "files": beside,
        "conventions": convention_lines(outcome.solution),
        "verification": {
            "done": verification is not None,
            "text": verification_text(verification)[1],
        },
    }


def render_report(
    solution: Solution,
    verification: Verification | None,
    simulation: DriveSimulation | None = None,
    capabilities: Capabilities = CAPABILITIES,
    dialect: Dialect = NEUTRAL,
    files: Sequence[ListedFile] = (),
) -> str:
    """The report of a solution as one HTML document.

    Args:
        solution: What was solved.
        verification: Outcome of compiling and running the header, or None if that was skipped; the
            report says which.
        simulation: Outcome of the simulation, or None where there is none.
        capabilities: Those of the product, or these and some from outside.
        dialect: Whose names the main header takes.
        files: What lies beside the report; without any it says nothing of files.
    """
    outcome = Outcome(solution, verification is not None, simulation)
    context = report_context(outcome, verification, capabilities, dialect, files)
    return render("pages/report.html.j2", context)


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
            "si": f"{number(value.si, 6)}{NARROW}{unit_text(value.unit)} {value.kind}".rstrip(),
            "source": value.source,
            "inferred": value.inferred,
            "note": value.note,
        }
        for value in design.values
    ]


def values_told(values: Sequence[PlainData]) -> str:
    """What the folded table of values says of itself."""
    inferred = sum(value["inferred"] for value in values)
    return f"{counted(len(values), 'value')}{f', {count(inferred)} inferred' if inferred else ''}"


def other_assumptions(design: Design) -> list[str]:
    """Assumptions that the table of values does not tell already."""
    told = tuple(f"{value.path} is inferred" for value in design.values if value.inferred)
    return [sentence for sentence in design.assumptions if not sentence.startswith(told or ("\0",))]


# What ``run`` says of a design: what to flash, what to look out for, the evidence.


def flashed(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> list[Flashed]:
    """The numbers to flash, in the order of the capabilities."""
    found = asked_for(capabilities, outcome)
    return [row for each, result in found for row in each.flashed(outcome.solution, result)]


def watched(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> list[str]:
    """What to look out for before anything is flashed, a sentence each."""
    found = asked_for(capabilities, outcome)
    texts = [text for each, result in found for text in each.watched(outcome.solution, result)]
    if not outcome.verified:
        texts.append("the emitted C was not compiled and not compared with its model")
    return [*texts, *_open_points(outcome.design)]


def _open_points(design: Design) -> list[str]:
    """How much of the design is inferred or left open."""
    inferred = [value.path for value in design.values if value.inferred]
    texts = []
    if inferred:
        listed = ", ".join(inferred[:3]) + (", ..." if len(inferred) > 3 else "")
        verb = "is" if len(inferred) == 1 else "are"
        texts.append(f"{listed} {verb} assumed: 'dqforge check' shows from what")
    return texts


def run_tables(
    solution: Solution,
    verification: Verification | None,
    capabilities: Capabilities = CAPABILITIES,
) -> list[Table]:
    """The short summary of a run.

    Args:
        solution: What was solved.
        verification: Outcome of compiling and running the headers, None if that was skipped.
        capabilities: Those of the product, or these and some from outside.
    """
    outcome = Outcome(solution, verification is not None)
    rows: Rows = []
    for capability, found in asked_for(capabilities, outcome):
        rows += capability.summary(solution, found)
    rows += [
        ("flux map", f"{evidence.source}: {text}")
        for evidence in solution.design.flux_evidence
        for text in evidence.sentences()
    ]
    rows.append(("verification", text_verification_text(verification)))
    first = tuple((row.label, row.value, row.meaning) for row in flashed(outcome, capabilities))
    warnings = tuple(("", text) for text in watched(outcome, capabilities))
    return [
        Table(f"{solution.design.name}: what to flash", ("", "", ""), first),
        *([Table("What to look out for", ("", ""), warnings)] if warnings else []),
        Table("Evidence", ("", ""), tuple(rows)),
    ]


# What the report says of the conventions and of the model of a machine: true for this machine.

_VELOCITY_FORM = "d[k] = d[k\u22121] + kp (e[k] \u2212 e[k\u22121]) + ki T e[k]"


def convention_lines(solution: Solution) -> list[Markup]:
    """Conventions of the numbers of a report, and what its model of the machine leaves out.

    Args:
        solution: Of a design.
    """
    from markupsafe import Markup

    lines = [
        symbols(
            "dq quantities are amplitude-invariant: currents, voltages and fluxes are peak values "
            "of a phase."
        ),
        symbols(
            f"{_axis_words(solution.design)} Electrical speed is pole pairs times mechanical speed."
        ),
        Markup(
            "Torque is 3/2 <i>p</i> (\u03c8<sub>d</sub> <i>i</i><sub>q</sub> \u2212 "
            "\u03c8<sub>q</sub> <i>i</i><sub>d</sub>); copper loss is 3/2 <i>R</i><sub>s</sub> "
            "(<i>i</i><sub>d</sub>\u00b2 + <i>i</i><sub>q</sub>\u00b2)."
        ),
    ]
    if solution.loops is not None:
        form = Markup('<span class="mono">{}</span>').format(_VELOCITY_FORM)
        lines.append(Markup("PI controllers: {}.").format(form))
    return [*lines, *(symbols(line) for line in machine_lines(solution.design))]


def _axis_words(design: Design) -> str:
    if abs(design.machine.psi_pm) < 1e-9:
        greater = "greater" if design.machine.l_d > design.machine.l_q else "smaller"
        return f"The machine has no magnets; the d axis is that of the {greater} inductance."
    return "The d axis lies along the magnet flux; negative i_d weakens the field."


def machine_lines(design: Design) -> list[str]:
    """What the model of a machine holds, and what it leaves out.

    Args:
        design: Says what is known of the machine.
    """
    lines = [_inductance_words(design)]
    if design.phase_machine is not None:
        lines.append(
            "The back-EMF has the harmonics of the design; current reference and losses in dq are "
            "those of its fundamental."
        )
    lines.append(_iron_words(design))
    return lines


def _inductance_words(design: Design) -> str:
    if not isinstance(design.machine, LinearMachine):
        return (
            "Flux linkages follow a map over both currents: saturation is part of the model, and "
            "inductances are stated at zero current where no current is named."
        )
    if isinstance(design.phase_machine, SalientPhaseMachine):
        return (
            "Inductances vary with the angle of the rotor, not with the current: saturation is not "
            "part of the model."
        )
    return "Inductances are constant: saturation is not part of the model."


def _iron_words(design: Design) -> str:
    loss = design.machine_loss
    if loss.hysteresis == 0.0 and loss.eddy == 0.0:
        return "The design gives no iron loss, and none is counted."
    return "Iron loss is counted where losses are, from the flux linkage and the electrical speed."
