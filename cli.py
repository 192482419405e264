"""Command line of dqforge: options in, one call per command, tables or JSON out.

Everything heavy is imported inside the command that needs it, so that ``dqforge
--help`` answers at once.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dqforge import __version__

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.errors import DqforgeError
    from dqforge.reports.pages.table import Table


app = typer.Typer(
    name="dqforge",
    help="Controller coefficients, loss budgets and checked C headers for permanent-magnet drives.",
    epilog="DESIGN is a design file, or the name of a drive that 'dqforge machines' lists.",
    invoke_without_command=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


DesignArgument = Annotated[
    str, typer.Argument(metavar="DESIGN", help="Design file, or the name of a library drive.")
]


JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


PlotOption = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="Draw into an .svg, .png or .pdf file."),
]


OutOption = Annotated[
    Path, typer.Option("-o", "--out", metavar="OUT", help="Folder to write into.")
]


NoVerifyOption = Annotated[
    bool, typer.Option("--no-verify", help="Skip compiling and running the header.")
]


SpeedOption = Annotated[
    str | None, typer.Option("--speed", metavar="SPEED", help="Mechanical speed, e.g. '3000 rpm'.")
]


TorqueOption = Annotated[
    str | None, typer.Option("--torque", metavar="TORQUE", help="One torque, e.g. '50 N m'.")
]


MapOption = Annotated[
    str | None,
    typer.Option("--map", metavar="NxM", help="Map of N torques by M speeds, with its limits."),
]


ModulationOption = Annotated[
    str,
    typer.Option(
        "--modulation",
        metavar="NAME",
        help="Whose linear range limits the voltage: spwm, svpwm, dpwm1, ...",
    ),
]


MarginOption = Annotated[
    str,
    typer.Option(
        "--margin",
        metavar="SHARE",
        help="Share of the voltage kept free for control, e.g. '5 %'; mtpa: or dead-time.",
    ),
]


ObjectiveOption = Annotated[
    str,
    typer.Option(
        "--objective",
        metavar="LOSS",
        help="What is minimised: copper, or total with iron and inverter.",
    ),
]


_loaded: ContextVar[tuple[Design, ...]] = ContextVar("_loaded", default=())

"""Designs that the command under way has loaded: its refusals name their place in the file."""


def _load(design: str) -> Design:
    """Load a design file, or a library drive when no such file exists and
    the text can be its name.
    """
    from dqforge.machines.design import catalogue, loader
    from dqforge.reports.pages.console import status

    from_library = not Path(design).exists() and design in catalogue.names()
    with status("reading the design", after=1.0):
        loaded = catalogue.load(design) if from_library else loader.load_design(design)
    _loaded.set((*_loaded.get(), loaded))
    return loaded


def _locate(error: DqforgeError) -> None:
    """Give a refusal its place in the design of the command.

    Of two designs their own solutions have done so.
    """
    designs = _loaded.get()
    if len(designs) == 1 and designs[0].places is not None:
        designs[0].places.locate(error)


def _show(tables: Sequence[Table]) -> None:
    from dqforge.reports.pages.console import show

    show(tables)


def _print_json(command: str, name: str, result: dict[str, Any]) -> None:
    from dqforge.reports.pages.envelope import to_text

    typer.echo(to_text(command, name, result), nl=False)


def _load_for(design: str, plot: Path | None, made: Path | None = None) -> Design:
    """Load a design, and refuse a figure that could not be written before anything is computed.

    ``made`` is a folder that will be there by then.
    """
    if plot is not None:
        from dqforge.reports.pages.files import check_figure_path

        check_figure_path(plot, made)
    return _load(design)


def _plot(figure: Callable[[], Any], path: Path | None) -> None:
    if path is not None:
        from dqforge.reports.pages.figures_style import save

        save(figure(), path)


def _print_version(value: bool) -> None:
    if value:
        typer.echo(f"dqforge {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    context: typer.Context,
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(2)


@app.command()
def new(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to make; it gets a file design.yaml.")
    ],
    machine: Annotated[
        str | None, typer.Option("--machine", metavar="NAME", help="Start from a library drive.")
    ] = None,
) -> None:
    """Write a commented design file to start from."""
    from dqforge.machines.design import catalogue
    from dqforge.machines.errors import InputError
    from dqforge.reports.pages.files import write_all

    content = catalogue.template(machine)
    path = folder / "design.yaml"
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    write_all(folder, {path.name: content})
    typer.echo(f"{path} written; next: dqforge check {path}")


@app.command()
def check(design: DesignArgument, json: JsonOption = False) -> None:
    """Validate a design, cross-check its data, and list every value's origin and what was
    assumed.
    """
    from dqforge.reports.result import plain_design
    from dqforge.reports.summary import check_tables

    loaded = _load(design)
    if json:
        _print_json("check", loaded.name, {"input": plain_design(loaded)})
    else:
        _show(check_tables(loaded))


@app.command()
def run(
    design: DesignArgument, out: OutOption = Path("out"), no_verify: NoVerifyOption = False
) -> None:
    """Do everything the design asks for: header, test vectors, verification,
    report.html and result.json.
    """
    from dqforge.reports.output.folder import RUN, write_output
    from dqforge.reports.pages.console import status
    from dqforge.reports.run import run_design
    from dqforge.reports.summary import run_tables

    loaded = _load(design)
    with status("solving, emitting, compiling and comparing"):
        output = run_design(loaded, verify=not no_verify)
    paths = write_output(out, RUN, output.files, loaded)
    _show(run_tables(output.solution, output.verification))
    typer.echo("written: " + " ".join(str(path) for path in paths))


@app.command()
def export(
    design: DesignArgument, out: OutOption = Path("out"), no_verify: NoVerifyOption = False
) -> None:
    """Write the header and its test vectors, and verify them."""
    from dqforge.reports.output.folder import RUN, write_output
    from dqforge.reports.run import export_design
    from dqforge.reports.verification.text import verification_text

    loaded = _load(design)
    output = export_design(loaded, verify=not no_verify)
    paths = write_output(out, RUN, output.files, loaded)
    typer.echo(verification_text(output.verification))
    typer.echo("written: " + " ".join(str(path) for path in paths))


@app.command()
def verify(
    folder: Annotated[
        Path, typer.Argument(metavar="OUT", help="Folder that 'dqforge run' or 'export' wrote.")
    ],
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            metavar="CORE",
            help="Emulated core, too: cortex-m0plus, -m3, -m4, -m7 or -m33.",
        ),
    ] = None,
) -> None:
    """Compute a folder again from its design and compare every value; compile the C, run it,
    compare every bit.
    """
    from dqforge.reports.output.recomputation import recompute
    from dqforge.reports.output.recomputation_text import recomputation_text
    from dqforge.reports.pages.console import status
    from dqforge.reports.verification.cortex_m import verify_on_target
    from dqforge.reports.verification.cross_tools import target_of
    from dqforge.reports.verification.text import target_text, verification_text
    from dqforge.reports.written_headers import read_folder, verify_written

    if target is not None:
        target_of(target)
    with status("computing again, compiling and comparing"):
        lines = [recomputation_text(recompute(folder))]
        found = read_folder(folder)
        lines.append(verification_text(verify_written(found)))
    if target is not None:
        with status(f"running on {target}"):
            outcome = verify_on_target(found.files, found.prefix, target, found.programmes)
        lines.append(target_text(outcome))
    typer.echo("\n".join(lines))


@app.command()
def compare(
    first: Annotated[
        str, typer.Argument(metavar="A", help="Design, library drive, or what 'dqforge run' wrote.")
    ],
    second: Annotated[
        str, typer.Argument(metavar="B", help="The same; differences are those of B against A.")
    ],
    json: JsonOption = False,
) -> None:
    """Compare two designs or results: machine, limits, references, gains, losses, macros."""
    from dqforge.reports.comparison.sides_compared import compare_sides
    from dqforge.reports.comparison.sources import read_side
    from dqforge.reports.comparison.tables import comparison_tables, plain_comparison
    from dqforge.reports.pages.console import status

    with status("solving"):
        comparison = compare_sides(read_side(first, _load), read_side(second, _load))
    if json:
        names = f"{comparison.a.name} | {comparison.b.name}"
        _print_json("compare", names, {"comparison": plain_comparison(comparison)})
    else:
        _show(comparison_tables(comparison))


@app.command()
def mtpa(
    design: DesignArgument,
    json: JsonOption = False,
    plot: PlotOption = None,
    speed: SpeedOption = None,
    torque: TorqueOption = None,
    chart: MapOption = None,
    modulation: ModulationOption = "svpwm",
    margin: MarginOption = "0 %",
    objective: ObjectiveOption = "copper",
) -> None:
    """Show the currents over torque; with a speed, a torque or a map also
    within the voltage limit.
    """
    loaded = _load_for(design, plot)
    if speed is not None or torque is not None or chart is not None:
        from dqforge.reports.operating_points.question import Request, answer

        request = Request(
            speed=speed,
            torque=torque,
            chart=chart,
            modulation=modulation,
            margin=margin,
            objective=objective,
        )
        reply = answer(loaded, request)
        _plot(reply.figure, plot)
        if json:
            _print_json("mtpa", loaded.name, reply.plain)
        else:
            _show(reply.tables)
        return
    from dqforge.optimizer.current_reference.signed import signed_designs
    from dqforge.optimizer.operating_points.solve import solve_curves
    from dqforge.reports.operating_points.plain import plain_curves
    from dqforge.reports.operating_points.tables import mtpa_tables

    positive, negative = signed_designs(loaded)
    curves = solve_curves(positive)
    mirrored = None if negative is None else solve_curves(negative)
    if plot is not None:
        from dqforge.reports.current_reference.figures import plot_mtpa

        _plot(lambda: plot_mtpa(positive, curves), plot)
    if json:
        further = {} if mirrored is None else {"mtpa_negative": plain_curves(mirrored)}
        _print_json("mtpa", loaded.name, {"mtpa": plain_curves(curves)} | further)
    else:
        _show(mtpa_tables(loaded, curves, mirrored))


@app.command()
def fit(design: DesignArgument, json: JsonOption = False, plot: PlotOption = None) -> None:
    """Fit the current references and show their errors beside the alternatives."""
    from dqforge.optimizer.certificates.current_reference import certify
    from dqforge.optimizer.current_reference.alternatives import alternatives
    from dqforge.optimizer.current_reference.signed import signed_designs
    from dqforge.optimizer.current_reference.solve import solve_fit
    from dqforge.optimizer.field_weakening.solve import solve_weakening
    from dqforge.optimizer.negative_torques import solve_negative
    from dqforge.optimizer.operating_points.solve import current_choice
    from dqforge.reports.current_reference.plain import plain_fit, plain_negative
    from dqforge.reports.current_reference.tables import fit_tables, negative_tables
    from dqforge.reports.field_weakening.plain import plain_weakening_fit
    from dqforge.reports.field_weakening.tables import weakening_tables
    from dqforge.reports.pages.console import status

    loaded = _load_for(design, plot)
    with status("fitting"):
        positive = signed_designs(loaded)[0]
        chosen = solve_fit(positive)
        found = chosen.fit
        rows = alternatives(current_choice(positive), found)
        proof = certify(current_choice(positive), found.reference, found.errors)
        negative = solve_negative(loaded)
        weakening = solve_weakening(loaded)
    if plot is not None:
        from dqforge.reports.current_reference.figures import plot_fit

        _plot(lambda: plot_fit(positive, found), plot)
    if json:
        _print_json(
            "fit",
            loaded.name,
            {
                "fit": plain_fit(found, rows, chosen.trials, proof, chosen.data),
                **plain_negative(negative),
                "weakening": plain_weakening_fit(weakening),
            },
        )
    else:
        tables = [
            *fit_tables(loaded, found, rows, chosen.trials, proof, chosen.data),
            *negative_tables(negative),
        ]
        _show([*tables, *weakening_tables(weakening)])


@app.command()
def tune(design: DesignArgument, json: JsonOption = False, plot: PlotOption = None) -> None:
    """Tune the controllers and the observer and show their margins."""
    from dataclasses import asdict

    from dqforge.optimizer.control_design.gain_set import solve_gains
    from dqforge.optimizer.fixed_control.solve import solve_fixed
    from dqforge.optimizer.observers.proof import prove
    from dqforge.reports.control.fixed_header import plain_fixed_evidence
    from dqforge.reports.control.fixed_tables import control_fixed_tables
    from dqforge.reports.loops.plain import plain_gains
    from dqforge.reports.loops.tables import gains_tables

    loaded = _load_for(design, plot)
    gains = solve_gains(loaded)
    fixed, proof = solve_fixed(loaded, gains), prove(gains.position)
    if plot is not None:
        from dqforge.reports.loops.figures import plot_gains

        _plot(lambda: plot_gains(gains), plot)
    if json:
        evidence = (
            {"control_fixed": {fit.control.format: plain_fixed_evidence(fit) for fit in fixed}}
            if fixed
            else {}
        )
        proven = {} if proof is None else {"observer_proof": asdict(proof)}
        _print_json("tune", loaded.name, {"gains": plain_gains(loaded, gains)} | proven | evidence)
    else:
        _show([*gains_tables(loaded, gains, proof), *control_fixed_tables(fixed)])


@app.command()
def losses(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    design: DesignArgument,
    json: JsonOption = False,
    plot: PlotOption = None,
    chart: MapOption = None,
    mission: Annotated[
        Path | None,
        typer.Option("--mission", metavar="FILE", help="Text file with time, speed and torque."),
    ] = None,
    strategies: Annotated[
        str | None,
        typer.Option(
            "--strategies", metavar="A,B", help="mtpa, id0, least-loss; default the design's."
        ),
    ] = None,
    modulations: Annotated[
        str | None,
        typer.Option("--modulations", metavar="A,B", help="Names, or all; default the design's."),
    ] = None,
    frequencies: Annotated[
        str | None,
        typer.Option("--frequencies", metavar="F,F", help="Carriers, e.g. '8 kHz, 16 kHz'."),
    ] = None,
    margin: MarginOption = "0 %",
    choice: Annotated[
        bool,
        typer.Option(
            "--choice",
            help="Best modulator and frequency over the map, and the rule: modulation_choice.",
        ),
    ] = False,
) -> None:
    """Compare the losses of strategies, modulators and frequencies at points,
    over a map or over a mission.
    """
    from dqforge.machines.errors import InputError

    loaded = _load_for(design, plot)
    if choice:
        from dqforge.reports.modulation_choice.question import answer_choice

        if (chart, mission, strategies, modulations, frequencies) != (None,) * 5 or margin != "0 %":
            raise InputError(
                "--choice takes what the section 'modulation_choice' says; leave the other options "
                "out"
            )
        found = answer_choice(loaded)
        _plot(found.figure, plot)
        if json:
            _print_json("losses", loaded.name, found.plain)
        else:
            _show(found.tables)
        return
    if chart is not None or mission is not None:
        from dqforge.reports.losses.question import LossRequest, answer
        from dqforge.reports.pages.console import status

        with status("comparing the losses", after=1.0):
            reply = answer(
                loaded, LossRequest(chart, mission, strategies, modulations, frequencies, margin)
            )
        _plot(reply.figure, plot)
        if json:
            _print_json("losses", loaded.name, reply.plain)
        else:
            _show(reply.tables)
        return
    if strategies is not None or modulations is not None or frequencies is not None:
        raise InputError(
            "--strategies, --modulations and --frequencies go with --map or --mission; add one of "
            "them"
        )
    from dqforge.optimizer.losses.solve import require_losses
    from dqforge.reports.losses.plain import plain_losses
    from dqforge.reports.losses.tables import losses_tables

    comparison = require_losses(loaded)
    if plot is not None:
        from dqforge.reports.losses.figures import plot_losses

        _plot(lambda: plot_losses(loaded, comparison), plot)
    if json:
        _print_json("losses", loaded.name, {"losses": plain_losses(comparison)})
    else:
        _show(losses_tables(loaded, comparison))


@app.command()
def dqy(
    design: DesignArgument,
    json: JsonOption = False,
    plot: PlotOption = None,
    speed: SpeedOption = None,
    torque: TorqueOption = None,
    ripple: Annotated[
        str | None,
        typer.Option(
            "--ripple", metavar="SHARE", help="Permitted deviation of the torque, e.g. '5 %'."
        ),
    ] = None,
    open_phase: Annotated[
        str | None,
        typer.Option("--open-phase", metavar="PHASE", help="A phase without current: a, b or c."),
    ] = None,
) -> None:
    """Shape the phase currents of a machine whose back-EMF is not sinusoidal: dq, dqx, dqy,
    and within all limits.
    """
    from dqforge.machines.units.quantities import parse_option
    from dqforge.optimizer.waveforms.comparison import compare_waveforms, with_point
    from dqforge.reports.waveforms.tables import plain_waveforms, waveform_tables

    loaded = _load_for(design, plot)
    settings = with_point(
        loaded.waveform,
        parse_option(torque, "torque", "--torque"),
        parse_option(speed, "speed", "--speed"),
        parse_option(ripple, "number", "--ripple"),
        open_phase,
    )
    comparison = compare_waveforms(loaded, settings)
    if plot is not None:
        from dqforge.reports.waveforms.figures import plot_waveforms

        _plot(lambda: plot_waveforms(comparison), plot)
    if json:
        _print_json("dqy", loaded.name, {"waveforms": plain_waveforms(comparison)})
    else:
        _show(waveform_tables(loaded, comparison))


@app.command()
def simulate(
    design: DesignArgument,
    out: OutOption = Path("out"),
    json: JsonOption = False,
    plot: PlotOption = None,
    switched: Annotated[
        bool, typer.Option("--switched", help="Simulate every switching instant.")
    ] = False,
) -> None:
    """Simulate the drive in the time domain, with the emitted controller
    compiled and in the loop.
    """
    from dqforge.reports.output.folder import SIMULATION, refuse_other_design, write_output
    from dqforge.reports.pages.console import progress
    from dqforge.reports.simulation.design_run import (
        require_scenario,
        simulate_design,
        simulation_files,
    )
    from dqforge.reports.simulation.tables import plain_simulation, simulation_tables

    loaded = _load_for(design, plot, out)
    require_scenario(loaded, switched=switched)
    refuse_other_design(out, loaded.digest, loaded.export.prefix)
    with progress("simulating") as report:
        found = simulate_design(loaded, switched=switched, progress=report)
    paths = write_output(out, SIMULATION, simulation_files(found), loaded)
    if plot is not None:
        from dqforge.reports.simulation.figures import plot_simulation

        _plot(lambda: plot_simulation(found), plot)
    if json:
        _print_json("simulate", loaded.name, {"simulation": plain_simulation(found)})
    else:
        _show(simulation_tables(found))
        typer.echo("written: " + " ".join(str(path) for path in paths))


@app.command()
def bemf(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Capture with time, or angle, and three phases; or a file per channel.",
        ),
    ],
    json: JsonOption = False,
    plot: PlotOption = None,
    line_to_line: Annotated[
        bool, typer.Option("--line-to-line", help="The channels are ab, bc and ca.")
    ] = False,
    pole_pairs: Annotated[
        int | None,
        typer.Option("--pole-pairs", metavar="P", help="For constants per mechanical speed."),
    ] = None,
    speed: SpeedOption = None,
    scale: Annotated[
        str | None,
        typer.Option(
            "--scale", metavar="A,B,C", help="Factors of the channels (probes), e.g. 1,1,10."
        ),
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option("--columns", metavar="T,A,B,C", help="Names or numbers of the columns."),
    ] = None,
    harmonics: Annotated[int, typer.Option("--harmonics", metavar="N", help="Highest order.")] = 25,
    interval: Annotated[
        str | None,
        typer.Option("--interval", metavar="TIME", help="Between two samples, e.g. '2 us'."),
    ] = None,
) -> None:
    """Say what a capture of the back-EMF holds: harmonics, symmetry, noise, and the magnet flux."""
    from dqforge.reports.back_emf.capture import (
        CaptureRequest,
        capture_tables,
        plain_capture,
        read_capture,
    )
    from dqforge.reports.pages.console import progress

    if plot is not None:
        from dqforge.reports.pages.files import check_figure_path

        check_figure_path(plot)
    request = CaptureRequest(line_to_line, pole_pairs, speed, scale, columns, harmonics, interval)
    with progress("reading the capture") as report:
        reading = read_capture(files, request, report)
    if plot is not None:
        from dqforge.reports.back_emf.figures import plot_capture

        _plot(lambda: plot_capture(reading), plot)
    if json:
        _print_json("bemf", reading.name, {"bemf": plain_capture(reading)})
    else:
        _show(capture_tables(reading))


@app.command()
def reproduce(
    paper: Annotated[
        str, typer.Argument(metavar="PAPER", help="Number of the paper: 000, 001 or 002.")
    ],
    json: JsonOption = False,
    figures: Annotated[
        Path | None,
        typer.Option("--figures", metavar="OUT", help="Folder for the paper's figures."),
    ] = None,
) -> None:
    """Recompute a paper's tables beside the printed values, replay its transients,
    and draw its figures.
    """
    from dqforge.reports.pages.console import status
    from dqforge.reports.papers import reproduction

    with status("recomputing"):
        found = reproduction.reproduce(paper, figures=figures is not None)
    if figures is not None:
        from dqforge.reports.output.folder import FIGURES, write_output
        from dqforge.reports.pages.figures_style import to_svg

        write_output(
            figures,
            FIGURES,
            {name: to_svg(draw()).encode("utf-8") for name, draw in found.figures.items()},
        )
    if json:
        _print_json("reproduce", f"paper {paper}", found.plain)
    else:
        _show(found.tables)


@app.command()
def machines(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Print this drive's design file.")
    ] = None,
) -> None:
    """List the library of drives, or print one."""
    from dqforge.machines.design import catalogue
    from dqforge.reports.pages.table import Table

    if name is not None:
        typer.echo(catalogue.read_text(name).decode("utf-8"), nl=False)
        return
    rows = tuple(
        (entry, loaded.name, loaded.about)
        for entry in catalogue.names()
        for loaded in [catalogue.load(entry)]
    )
    _show(
        [
            Table(
                "Library drives",
                ("name", "drive", "about"),
                rows,
                ("dqforge new DIR --machine NAME starts from one",),
            )
        ]
    )


@app.command()
def schema() -> None:
    """Print the JSON Schema of the design file."""
    import json

    from dqforge.machines.design.schema import json_schema

    typer.echo(json.dumps(json_schema(), indent=1))


def _usage_line(error: Exception) -> str:
    """One line for a wrong command line: what the parser says, and where help is."""
    context = getattr(error, "ctx", None)
    path = "dqforge" if context is None else context.command_path
    message = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{message.rstrip('.')}; see '{path} --help'"


def _open_streams() -> None:
    """Give closed standard streams somewhere to write, so that no file that is
    opened later takes their place.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8"))


def _drop_output() -> None:
    """Send what is left in the buffer of stdout nowhere: the interpreter would try, and fail,
    once more at its end.
    """
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _system_line(error: OSError) -> str:
    """One line for what the system refused; a stdout that is to blame refuses
    one character more as well.
    """
    reason = error.strerror or str(error)
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return f"standard output cannot be written: {reason}"
    named = f" {error.filename!r}" if error.filename is not None else ""
    return (
        f"the system refuses a file{named}: {reason}; is the disk, or the folder that TMPDIR "
        "names, full?"
    )


def _tell(message: str) -> None:
    """One line on stderr, if that can still be written."""
    with suppress(OSError):
        typer.echo(f"dqforge: {message}", err=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line.

    Errors become one line on stderr and an exit code, never a traceback.
    """
    from typer.exceptions import TyperException

    from dqforge.machines.errors import DqforgeError

    _open_streams()
    command = typer.main.get_command(app)
    _loaded.set(())
    given = None if arguments is None else list(arguments)
    try:
        with warnings.catch_warnings():
            # Numerical trouble ends in a message; what libraries remark on
            # themselves is nobody's business.
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            code = command.main(args=given, prog_name="dqforge", standalone_mode=False)
        sys.stdout.flush()
    except DqforgeError as error:
        _locate(error)
        _tell(str(error))
        code = error.exit_code
    except TyperException as error:
        _tell(_usage_line(error))
        code = 2
    except (typer.Abort, KeyboardInterrupt):
        _tell("interrupted")
        code = 130
    except (BrokenPipeError, SystemExit) as error:
        if not isinstance(error, BrokenPipeError) and not isinstance(
            error.__context__, BrokenPipeError
        ):
            raise
        code = 0  # the reader of a pipe has left; there is nobody to tell
        _drop_output()
    except OSError as error:
        _tell(_system_line(error))
        code = 1
        _drop_output()
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        from dqforge.machines.design.numerical import refusal_of

        refusal = refusal_of(error)
        if refusal is None:
            raise
        _locate(refusal)
        _tell(str(refusal))
        code = refusal.exit_code
    sys.exit(code if isinstance(code, int) else 0)


if __name__ == "__main__":
    main()
