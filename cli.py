"""Command line of dqforge: options in, an answer out. What is heavy is loaded by its command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache, partial
from importlib import import_module
from typing import Any

try:
    import typer
except ModuleNotFoundError as error:  # before there is anything that could say it in another way
    sys.stderr.write(f"dqforge: the package {error.name} is not installed; pip install dqforge\n")
    raise SystemExit(2) from None

from dqforge.reports import answers
from dqforge.reports.command_line import flags as given
from dqforge.reports.command_line.designs import asked_sheet, forget, load, locate, respond
from dqforge.reports.command_line.flags import Sheet, application, exit_code, with_sheet
from dqforge.reports.operating_system.system import prepare_process

app = application()


@app.command()
@with_sheet
def new(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    folder: given.Folder,
    sheet: Sheet,
    machine: given.Template = None,
    source: given.Source = None,
    capture: given.CaptureOfNew = None,
    line_to_line: given.LineToLine = False,
    scale: given.Scale = None,
    flux_map: given.MapOfNew = None,
    axes: given.AxesOfNew = None,
    template: given.Blank = False,
    study: given.StudyOfNew = None,
    yes: given.Yes = False,
    sets: given.SetOfNew = None,
    json: given.Json = False,
) -> None:
    """Write a design from a data sheet or firmware.

    Without options it asks on a terminal; --template writes every key to fill in.
    """
    named = machine or source or template or study or capture or flux_map or sets
    asking = not (named or yes or json)
    texts = asked_sheet(folder, sheet, asking=asking)
    recorded = answers.library.recorded(capture, flux_map, axes, scale, line_to_line=line_to_line)
    asked = answers.library.NewRequest(machine, source, sets, texts, template, study, *recorded)
    respond("new", partial(answers.library.answer_new, folder, asked), json, out=folder)


@app.command()
def check(design: given.Design, sets: given.Set = None, json: given.Json = False) -> None:
    """Validate a design and list what was assumed.

    The data are cross-checked, and every value is listed with its origin.
    """
    respond("check", lambda: answers.check.answer_check(load(design, sets)), json)


@app.command()
def run(
    design: given.Design,
    out: given.Out = None,
    no_verify: given.NoVerify = False,
    sets: given.Set = None,
    json: given.Json = False,
    sign: given.Sign = None,
) -> None:
    """Solve, export, verify and report a design.

    Everything the design requests: headers, test vectors, verification, report, result.json.
    """
    ask = partial(answers.run.answer_run, verify=not no_verify)
    respond("run", lambda: ask(load(design, sets)), json, out=out, default=True, sign=sign)


@app.command()
def export(
    design: given.Design,
    out: given.OutOfExport = None,
    no_verify: given.NoVerify = False,
    sets: given.Set = None,
    json: given.Json = False,
    firmware: given.For = None,
    into: given.Into = None,
    sign: given.Sign = None,
) -> None:
    """Write and verify headers, or a firmware's file.

    Headers with their test vectors, or with --for the file that another firmware imports.
    """
    place = into.parent if out is None and into is not None else out
    ask = partial(answers.run.answer_export, verify=not no_verify, firmware=firmware, into=into)
    ask = partial(ask, elsewhere=out is not None)
    respond("export", lambda: ask(load(design, sets)), json, out=place, default=True, sign=sign)


@app.command()
def explain(
    files: given.Explained, machine: given.OnMachine = None, json: given.Json = False
) -> None:
    """Show what a firmware configuration means.

    Its loops in engineering units: bandwidths, margins, limits.
    """
    respond("explain", lambda: answers.compare.answer_explain(files, machine), json)


@app.command()
def verify(
    folder: given.Written,
    target: given.Core = None,
    independent: given.Independent = False,
    signature: given.Signature = None,
    json: given.Json = False,
) -> None:
    """Check what was written, number by number."""
    ask = partial(answers.verify.answer_verify, folder, target, independent, signature)
    respond("verify", ask, json)


@app.command()
def compare(
    first: given.SideA, second: given.SideB, sets: given.SetOfB = None, json: given.Json = False
) -> None:
    """Compare two designs, results or headers.

    Machine, limits, references, gains, losses, macros, in engineering units.
    """
    respond("compare", lambda: answers.compare.answer_compare(first, second, sets), json)


@app.command()
def mtpa(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    design: given.Design,
    sets: given.Set = None,
    json: given.Json = False,
    plot: given.Plot = None,
    speed: given.Speed = None,
    torque: given.Torque = None,
    chart: given.Map = None,
    modulation: given.Modulation = "svpwm",
    margin: given.Margin = "0 %",
    objective: given.Objective = "copper",
) -> None:
    """Show the least-loss currents over torque.

    With a speed, a torque or a map also within the voltage limit.
    """
    asked = answers.mtpa.Request(speed, torque, chart, modulation, margin, objective)
    respond("mtpa", lambda: answers.mtpa.answer_mtpa(load(design, sets), asked), json, plot)


@app.command()
def fit(
    design: given.Design, sets: given.Set = None, json: given.Json = False, plot: given.Plot = None
) -> None:
    """Fit the current references, with their errors.

    The errors stand beside those of the alternatives.
    """
    respond("fit", lambda: answers.fit.answer_fit(load(design, sets)), json, plot)


@app.command()
def tune(
    design: given.Design, sets: given.Set = None, json: given.Json = False, plot: given.Plot = None
) -> None:
    """Tune loops and observer, with their margins."""
    respond("tune", lambda: answers.tune.answer_tune(load(design, sets)), json, plot)


@app.command()
def estimators(
    design: given.Design,
    out: given.OutOfPair = None,
    sets: given.Set = None,
    json: given.Json = False,
    plot: given.Plot = None,
    only: given.Only = None,
    starts: given.Starts = 0,
) -> None:
    """Compare position estimators and start-ups.

    Over speed and load, and which of them to flash.
    """
    ask = partial(answers.estimators.answer_estimators, only=only, starts=starts)
    made = out is not None
    respond("estimators", lambda: ask(load(design, sets), write=made), json, plot, out)


@app.command()
def losses(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    design: given.Design,
    sets: given.Set = None,
    json: given.Json = False,
    plot: given.Plot = None,
    chart: given.Map = None,
    mission: given.Mission = None,
    points: given.Points = None,
    measured: given.Measured = None,
    strategies: given.Strategies = None,
    modulations: given.Modulations = None,
    frequencies: given.Frequencies = None,
    margin: given.Margin = "0 %",
    choice: given.Choice = False,
) -> None:
    """Compare losses of strategies and modulators."""
    asked = answers.losses.LossRequest(
        chart, mission, strategies, modulations, frequencies, margin, points, measured
    )
    ask = partial(answers.losses.answer_losses, request=asked, choice=choice)
    respond("losses", lambda: ask(load(design, sets)), json, plot)


@app.command()
def dqy(
    design: given.Design,
    sets: given.Set = None,
    json: given.Json = False,
    plot: given.Plot = None,
    speed: given.Speed = None,
    torque: given.Torque = None,
    ripple: given.Ripple = None,
    open_phase: given.OpenPhase = None,
    flash: given.Flash = False,
) -> None:
    """Shape phase currents for any back-EMF.

    By dq, dqx and dqy, and within voltage, current and ripple limits.
    """
    asked = answers.dqy.WaveformRequest(torque, speed, ripple, open_phase, flash)
    respond("dqy", lambda: answers.dqy.answer_dqy(load(design, sets), asked), json, plot)


@app.command()
def simulate(
    design: given.Design,
    out: given.Out = None,
    sets: given.Set = None,
    json: given.Json = False,
    plot: given.Plot = None,
    switched: given.Switched = False,
) -> None:
    """Simulate the drive with the emitted C.

    In the time domain, with the emitted controller compiled and in the loop.
    """
    ask = partial(answers.simulate.answer_simulate, out=out, switched=switched)
    respond(
        "simulate", lambda: ask(load(design, sets)), json, plot, out, default=True, bar="simulating"
    )


@app.command()
def bemf(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    files: given.Captures,
    json: given.Json = False,
    plot: given.Plot = None,
    line_to_line: given.LineToLine = False,
    pole_pairs: given.PolePairs = None,
    speed: given.Speed = None,
    scale: given.Scale = None,
    columns: given.Columns = None,
    harmonics: given.Harmonics = 25,
    interval: given.Interval = None,
) -> None:
    """Show what a capture of the back-EMF holds.

    Harmonics, symmetry, noise, and the flux linkage of the magnets.
    """
    asked = answers.bemf.CaptureRequest(
        line_to_line, pole_pairs, speed, scale, columns, harmonics, interval
    )
    bar = "reading the capture"
    respond("bemf", lambda: answers.bemf.answer_bemf(files, asked), json, plot, bar=bar)


@app.command()
def identify(
    bench: given.Bench,
    out: given.OutOfBench = None,
    plan: given.Plan = False,
    json: given.Json = False,
) -> int:
    """Find a machine's parameters in bench logs.

    With 95 % intervals for correlated rows, and what the logs do not hold; with --plan what to run.
    """
    ask = partial(answers.identify.answer, bench, plan=plan, page=out is not None)
    return respond("identify", ask, json, out=out)


@app.command()
def reproduce(paper: given.Paper, json: given.Json = False, figures: given.Figures = None) -> None:
    """Recompute a paper's tables and figures.

    The recomputed values stand beside the printed ones.
    """
    ask = partial(answers.reproduce.answer_reproduce, paper, figures=figures is not None)
    respond("reproduce", ask, json, out=figures)


@app.command()
def explore(  # noqa: PLR0913, PLR0917 - every option of the command is a parameter
    study: given.Study,
    out: given.OutOfStudy = None,
    workers: given.Workers = None,
    scheduler: given.Scheduler = "",
    scheduler_file: given.SchedulerFile = None,
    tls_ca_file: given.TlsAuthority = "",
    tls_cert: given.TlsCertificate = "",
    tls_key: given.TlsKey = "",
    mixed: given.Mixed = False,
    time_limit: given.TimeLimit = None,
    dry_run: given.DryRun = False,
    limit: given.Limit = None,
    restart: given.Restart = False,
    reuse: given.Reuse = None,
    table: given.TableOf = None,
    where: given.Where = None,
    sort: given.Sort = "",
    first: given.First = None,
    csv: given.CsvOf = None,
    export: given.ExportOf = None,
    plot: given.Plot = None,
    json: given.Json = False,
) -> int:
    """Compute many variants of a design.

    In parts that a later run continues; the results can be examined.
    """
    tls = (tls_ca_file, tls_cert, tls_key)
    where_run = answers.explore.Where(workers, scheduler, scheduler_file, tls, mixed, time_limit)
    seen = answers.explore.Looked(table, tuple(where or ()), sort, first, csv, export)
    asked = answers.explore.StudyRequest(
        study, out, dry_run, limit, restart, where_run, seen, tuple(reuse or ()), plot is not None
    )
    ask = partial(answers.explore.answer_explore, asked)
    return respond("explore", ask, json, plot, bar="reading the study", silent=json)


@app.command()
def serve(place: given.Served = given.HERE, port: given.Port = 0, json: given.Json = False) -> None:
    """Edit a design in the browser, with live figures."""
    import_module("dqforge.reports.browser.server").serve(place, port, as_json=json)


@app.command()
def machines(name: given.Drive = None, search: given.Find = None, json: given.Json = False) -> None:
    """List drives and motors of the library, or one."""
    respond("machines", lambda: answers.machines.answer_machines(name, search), json)


@app.command()
def schema(
    study: given.OfStudy = False,
    bench: given.OfBench = False,
    out: given.OutOfSchema = None,
    json: given.Json = False,
) -> None:
    """Print the JSON Schema of a file, for editors."""
    ask = partial(answers.library.answer_schema, study=study, bench=bench, out=out)
    respond("schema", ask, json, out=None if out is None else out.parent)


@app.command()
def doctor(json: given.Json = False) -> int:
    """List compilers, emulators and packages found.

    What each is for, and how to install missing ones.
    """
    return respond("doctor", answers.doctor.answer_doctor, json)


@cache
def _command() -> Any:
    """All commands with their options, made once however often a process asks."""
    return typer.main.get_command(app)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; errors become a line on stderr and an exit code, never a traceback."""
    prepare_process()
    forget()
    command, words = _command(), None if arguments is None else [*arguments]
    started = partial(command.main, args=words, prog_name="dqforge", standalone_mode=False)
    sys.exit(exit_code(started, locate))


if __name__ == "__main__":
    main()
