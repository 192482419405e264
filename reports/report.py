"""The report of a design: one HTML file that asks for nothing outside itself,
the same bytes for the same solution.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import SignedReference
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Capability, Outcome, Tile, asked_for
from dqforge.reports.convention_text import convention_lines
from dqforge.reports.main_header import NEUTRAL, Dialect, header_context
from dqforge.reports.pages.answer import NUMBER_AND_UNIT
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
from dqforge.reports.summary import flashed, watched
from dqforge.reports.verification.text import compared

if TYPE_CHECKING:
    from markupsafe import Markup

    from dqforge.optimizer.solution import Solution
    from dqforge.reports.simulation.design_run import DriveSimulation
    from dqforge.reports.verification.host import Verification

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
                f" {check.standard.upper()} was not tried: it needs the Debian package "
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
    from markupsafe import Markup

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
                before = render(part.chapter.opening, {})
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
            "si": f"{number(value.si, 6)}{NARROW}{unit_text(value.unit)}".rstrip(),
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
