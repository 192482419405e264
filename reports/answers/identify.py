"""What `dqforge identify` answers: parameters of a machine from the logs of a bench."""

from __future__ import annotations

from pathlib import Path

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.identification.bench_plan import plan_bench
from dqforge.optimizer.identification.identify import identify
from dqforge.reports.command_line.designs import load
from dqforge.reports.identification import (
    BENCH_FILE,
    MAP_NAME,
    SHEET,
    design_of,
    identification_tables,
    map_csv,
    plain_identification,
    plain_plan,
    plan_bench_file,
    plan_sheet,
    plan_tables,
)
from dqforge.reports.pages.answer import Answer, Files, shares, stage
from dqforge.reports.pages.templating import to_text
from dqforge.reports.run_folder import RESULT

DESIGN = "design.yaml"


def answer(path: Path, *, plan: bool, page: bool) -> Answer:
    """Plan a bench, or read its logs, with a page for people where files are written."""
    return answer_plan(path) if plan else answer_identify(path, page=page)


def answer_plan(name: Path) -> Answer:
    """Plan the bench for the machine of a design: points, order, and the intervals to expect.

    Raises:
        NoSolutionError: The machine has no magnets, or the voltage limit leaves no points.
    """
    design = load(str(name))
    plan = plan_bench(design)
    files = {SHEET: plan_sheet(plan), BENCH_FILE: plan_bench_file(design)}
    return Answer(
        design.name,
        plan_tables(plan),
        {"plan": plain_plan(plan)},
        files=Files(
            files, "", follow=f"fill {{out}}/{SHEET}; dqforge identify {{out}}/{BENCH_FILE}"
        ),
    )


def answer_identify(path: Path, *, page: bool = False) -> Answer:
    """Read the logs of a bench file and say what they hold.

    The exit code is 1 where two routes contradict each other; no design is written then.

    Raises:
        InputError: The bench file or a log is wrong.
        NoSolutionError: A run says nothing of what it was made for.
    """
    stage("reading the logs")
    bench = read_bench(path, shares())
    stage("identifying")
    try:
        found = identify(bench)
    except NoSolutionError as error:
        for one in (error, *error.others):
            bench.places.locate(one)
        raise
    plain = {"identification": plain_identification(found)}
    design, lacking = design_of(found)
    contents = {RESULT: to_text("identify", bench.name, plain).encode()}
    if page:
        from dqforge.reports.identification_page import PAGE, identification_page

        stage("drawing the page")
        contents[PAGE] = identification_page(found)
    if found.flux is not None:
        contents[MAP_NAME] = map_csv(found.flux.table)
    if design is not None:
        contents[DESIGN] = design
    follow = f"dqforge check {{out}}/{DESIGN}" if design is not None else ""
    return Answer(
        bench.name,
        identification_tables(found),
        plain,
        files=Files(contents, "", follow=follow),
        notes=(lacking,) if lacking else (),
        exit_code=1 if found.contradictions else 0,
    )
