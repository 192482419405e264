"""What `dqforge explore` answers: a study computed, or gone on with, and how its rows ended."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.records import dataclass
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.study_engine.engine_settings import EngineSettings, TlsFiles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.machines.exploration.study import Study
    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.optimizer.exploration.study_plan import StudyPlan
    from dqforge.optimizer.exploration.study_search import SearchedStudy
    from dqforge.optimizer.exploration.yields import FixedHeader
    from dqforge.reports.exploration.study_view import StudyView
    from dqforge.reports.plain_data import PlainData
    from dqforge.reports.study_engine.engine_settings import StudyOutcome

_NEEDED = ("distributed", "pyarrow")


@dataclass(frozen=True, slots=True)
class Where:
    """On what a study is run, as the options of the command say it; fields as of
    `dqforge.reports.study_engine.engine_settings.EngineSettings`, ``tls`` the files of authority,
    certificate and key.
    """

    workers: int | None = None
    scheduler: str = ""
    scheduler_file: Path | None = None
    tls: tuple[str, str, str] = ("", "", "")
    mixed: bool = False
    time_limit: float | None = None

    def settings(self) -> EngineSettings:
        """The engine that is asked for.

        Raises:
            InputError: Options exclude each other.
        """
        there = self.scheduler or self.scheduler_file is not None
        if self.scheduler and self.scheduler_file is not None:
            raise InputError("--scheduler and --scheduler-file name one cluster: write one of them")
        if there and self.workers is not None:
            raise InputError("--workers counts processes of this machine: leave it out")
        if any(self.tls) and not there:
            raise InputError("TLS is for a cluster that there is: add --scheduler")
        if any(self.tls) and not (self.tls[0] and self.tls[1]):
            raise InputError("TLS takes --tls-ca-file and --tls-cert")
        return EngineSettings(
            self.workers,
            self.scheduler,
            self.scheduler_file,
            TlsFiles(*self.tls),
            self.mixed,
            self.time_limit,
        )


@dataclass(frozen=True, slots=True)
class Looked:
    """What is looked at in a folder: fields as of
    `dqforge.reports.study_store.table_query.TableRequest`, ``export`` the rows whose designs and
    headers are written.
    """

    table: str | None = None
    where: tuple[str, ...] = ()
    sort: str = ""
    first: int | None = None
    csv: Path | None = None
    export: str | None = None

    @property
    def at_rows(self) -> bool:
        """Whether rows are asked for."""
        return self.table is not None or bool(self.where or self.sort or self.first or self.csv)


@dataclass(frozen=True, slots=True)
class StudyRequest:
    """What is asked of a study.

    Args:
        study: Its file, or a folder that holds one computed.
        out: Folder of the parts, None for the usual one.
        dry_run: Whether it is only estimated.
        limit: Rows to compute, up to the end of a part; None for all.
        restart: Whether what the folder holds is taken away.
        where: On what it is computed.
        looked: What is shown of its rows, or exported.
        reuse: Folders of earlier studies from which rows are taken.
        plot: Whether a figure of all rows is asked for.
    """

    study: str
    out: Path | None = None
    dry_run: bool = False
    limit: int | None = None
    restart: bool = False
    where: Where = Where()
    looked: Looked = Looked()
    reuse: tuple[Path, ...] = ()
    plot: bool = False

    @property
    def folder(self) -> Path:
        """Where the parts go."""
        return self.out or Path("out") / Path(self.study).stem


def answer_explore(request: StudyRequest) -> Answer:
    """Compute a study, or look into the folder of one.

    Raises:
        InputError: The study is wrong, the folder holds another one, or options exclude each other.
        EngineStoppedError: The run could not go on.
    """
    if request.plot and (request.dry_run or request.looked.at_rows or request.looked.export):
        raise InputError("--plot draws all rows: leave out --dry-run, --table, --csv and --export")
    _require_extra()
    settings = request.where.settings()
    if Path(request.study).is_dir():
        return _seen(Path(request.study), request.looked) or _answer_folder(Path(request.study))
    from dqforge.machines.exploration.study_checks import read_study
    from dqforge.optimizer.exploration.study_plan import StudyPlan

    stage("reading the study")
    study = read_study(request.study)
    plan = StudyPlan(study, _header(study))
    searched = _searched(study, plan, request)
    rows: RowSource = plan
    if searched is not None:
        rows = searched.generation(0, searched.begun().ask())
    if request.dry_run:
        from dqforge.reports.exploration.study_view import estimated_study

        return estimated_study(study, rows)
    if searched is None:
        rows = _reusing(plan, request.reuse)
    answer = _computed(study, rows, searched, request, settings)
    return _seen(request.folder, request.looked) or answer


def _searched(study: Study, plan: StudyPlan, request: StudyRequest) -> SearchedStudy | None:
    """The rows of a study as its search chooses them; None where it has a grid."""
    if study.search is None:
        return None
    from dqforge.optimizer.exploration.study_search import SearchedStudy

    if request.reuse:
        raise InputError("--reuse: a search computes all rows that it chooses; leave it out")
    return SearchedStudy(plan, study.search)


def _reusing(plan: StudyPlan, folders: tuple[Path, ...]) -> RowSource:
    """The rows of a study, those of earlier ones taken from their folders."""
    if not folders:
        return plan
    from dqforge.reports.study_store.reused_rows import ReusingRows

    stage("finding the rows of earlier studies")
    found = ReusingRows(plan, tuple(folder.resolve() for folder in folders))
    found.require()
    return found


def _header(study: Study) -> FixedHeader | None:
    """The fixed header of a study, None where it names none or one that is made now."""
    if not study.header_files:
        return None
    from dqforge.reports.yields import fixed_header

    return fixed_header(dict(study.header_files), study.header)


def _seen(folder: Path, looked: Looked) -> Answer | None:
    """Rows of a folder, or what is exported of them; None where neither is asked for."""
    if looked.export is not None:
        from dqforge.reports.study_store.winners_answer import answer_export

        return answer_export(folder, looked.export)
    if not looked.at_rows:
        return None
    from dqforge.reports.study_store.table_query import TableRequest, answer_table

    asked = TableRequest(looked.table or "", looked.where, looked.sort, looked.first, looked.csv)
    return answer_table(folder, asked)


def _require_extra() -> None:
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        verb = "are" if len(missing) > 1 else "is"
        raise DqforgeError(
            f"explore: {' and '.join(missing)} {verb} missing; pip install 'dqforge[explore]'"
        )


def _computed(
    study: Study,
    rows: RowSource,
    searched: SearchedStudy | None,
    request: StudyRequest,
    settings: EngineSettings,
) -> Answer:
    """A study computed; ``rows`` are all of them, or the first ones of a search."""
    from dqforge.reports.exploration.study_view import plain_summary
    from dqforge.reports.exploration.viewing import view_of, write_pages
    from dqforge.reports.study_engine.run_search import run_search
    from dqforge.reports.study_engine.run_study import run_study
    from dqforge.reports.study_store.part_store import PartStore, study_header, study_inputs

    header = study_header(study, rows)
    only = (
        None if request.limit is None else range(min(-(-request.limit // rows.batch), header.parts))
    )
    with PartStore.open(
        request.folder,
        header,
        restart=request.restart,
        mixed=settings.mixed,
        inputs=study_inputs(study),
    ) as store:
        if searched is None:
            outcome = run_study(rows, store, settings, only)
        else:
            outcome = run_search(searched, store, settings, only)
        stage("writing the report")
        view = view_of(store, study, outcome.audited)
        written = write_pages(store, view, study_inputs(study))
        store.finish(plain_outcome(outcome) | plain_summary(view))
    return _shown(view, request.folder, outcome, written)


def _answer_folder(folder: Path) -> Answer:
    """A folder that holds a study, as it is."""
    from dqforge.reports.exploration.viewing import view_of
    from dqforge.reports.study_engine.engine_settings import study_outcome
    from dqforge.reports.study_store.part_store import PartStore
    from dqforge.reports.study_store.winners import stored_study

    store = PartStore.existing(folder)
    outcome = study_outcome(store, computed=0, seconds=0.0, workers=0)
    return _shown(view_of(store, stored_study(store), outcome.audited), folder, outcome)


def plain_outcome(outcome: StudyOutcome) -> PlainData:
    """What became of a study, for ``study.json`` and ``--json``: the same however it was run."""
    from dqforge.reports.plain_data import finite

    return {
        "rows": outcome.rows,
        "states": dict(outcome.counts),
        "failures": [
            {"state": each.state, "rows": each.count, "first": each.first, "message": each.message}
            for each in outcome.failures
        ],
        "audited": {name: finite(value) for name, value in outcome.audited.items()},
    }


def _shown(
    view: StudyView, folder: Path, outcome: StudyOutcome, written: Sequence[str] = ()
) -> Answer:
    from dqforge.reports.exploration.html import study_tables
    from dqforge.reports.exploration.study_view import plain_summary

    rows = tuple((state, f"{count:,}") for state, count in outcome.counts.items() if count)
    title = f"{view.name}: {outcome.done:,} of {outcome.rows:,} rows"
    tables = [Table(title, ("state", "rows"), rows), *study_tables(view)]
    plain = {"study": plain_outcome(outcome) | plain_summary(view) | {"out": str(folder)}}
    notes = _notes(folder, outcome, written)
    figure = partial(_figure, view)
    return Answer(view.name, tables, plain, figure, notes=notes, exit_code=_code(outcome))


def _figure(view: StudyView) -> Figure:
    from dqforge.reports.exploration.study_view import plot_study

    return plot_study(view)


def _code(outcome: StudyOutcome) -> int:
    """Rows that failed are results; a study of nothing else is a failure."""
    return 0 if outcome.succeeded or not outcome.done else 1


def _notes(folder: Path, outcome: StudyOutcome, written: Sequence[str]) -> tuple[str, ...]:
    failures = [
        f"{each.count:,} of {outcome.rows:,} rows {each.state}, first: row {each.first}: "
        f"{each.message}"
        for each in outcome.failures
    ]
    paths = " ".join(str(folder / name) for name in written)
    return (*failures, *_run_note(outcome), f"written: {paths or folder}")


def _run_note(outcome: StudyOutcome) -> list[str]:
    if not outcome.computed:
        return []
    where = f"{outcome.workers} workers" if outcome.workers else "this process"
    rate = outcome.computed / max(outcome.seconds, 1e-9)
    took = f"{outcome.computed:,} rows in {outcome.seconds:.1f} s by {where}"
    return [f"computed now: {took}, {rate:,.0f} rows/s"]
