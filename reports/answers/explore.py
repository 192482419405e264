"""What `dqforge explore` answers: a study computed, or gone on with, and how its rows ended."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.acceptance import (
    StudyQuestion,
    bound_column,
    goal_columns,
    summarise,
)
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, OUTPUT_COLUMN, ColumnSpec
from dqforge.optimizer.exploration.yields import FixedHeader, FixedLoop
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.exploration.contained_rows import EngineSettings, TlsFiles
from dqforge.reports.exploration.html import render_study
from dqforge.reports.exploration.study_view import StudyView, pictured_rows
from dqforge.reports.output.folder import Manifest, from_bytes, sha256
from dqforge.reports.output.recomputation import read_listed
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.pages.html_text import counted
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.run_folder import MANIFEST, RESULT, ListedFile

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from dqforge.optimizer.exploration.row_block import RowSource
    from dqforge.optimizer.exploration.study_plan import StudyPlan
    from dqforge.optimizer.exploration.study_search import SearchedStudy
    from dqforge.reports.exploration.contained_rows import StudyOutcome
    from dqforge.reports.exploration.part_store import PartStore
    from dqforge.reports.plain_data import PlainData


_NEEDED = ("distributed", "pyarrow")


@dataclass(frozen=True, slots=True)
class Where:
    """On what a study is run, as the options of the command say it; fields as of
    `dqforge.reports.exploration.contained_rows.EngineSettings`, ``tls`` the files of authority,
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
            raise InputError("--workers counts processes of this machine: omit it")
        if any(self.tls) and not there:
            raise InputError("TLS needs an existing cluster: add --scheduler")
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
    `dqforge.reports.exploration.table_query.TableRequest`, ``export`` the rows whose designs and
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
        raise InputError("--plot draws all rows: omit --dry-run, --table, --csv and --export")
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
        raise InputError("--reuse: a search computes all rows that it chooses; omit it")
    return SearchedStudy(plan, study.search)


def _reusing(plan: StudyPlan, folders: tuple[Path, ...]) -> RowSource:
    """The rows of a study, those of earlier ones taken from their folders."""
    if not folders:
        return plan
    from dqforge.reports.exploration.summary_files import ReusingRows

    stage("finding the rows of earlier studies")
    found = ReusingRows(plan, tuple(folder.resolve() for folder in folders))
    found.require()
    return found


def _header(study: Study) -> FixedHeader | None:
    """The fixed header of a study, None where it names none or one that is made now."""
    if not study.header_files:
        return None

    return fixed_header(dict(study.header_files), study.header)


def _seen(folder: Path, looked: Looked) -> Answer | None:
    """Rows of a folder, or what is exported of them; None where neither is asked for."""
    if looked.export is not None:
        from dqforge.reports.exploration.winners import answer_export

        return answer_export(folder, looked.export)
    if not looked.at_rows:
        return None
    from dqforge.reports.exploration.table_query import TableRequest, answer_table

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
    from dqforge.reports.exploration.part_store import PartStore, study_header, study_inputs
    from dqforge.reports.exploration.run_study import run_search, run_study
    from dqforge.reports.exploration.study_view import plain_summary

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
    from dqforge.reports.exploration.contained_rows import study_outcome
    from dqforge.reports.exploration.part_store import PartStore
    from dqforge.reports.exploration.winners import stored_study

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


# A study's folder read for what is shown of it, in two passes over its parts, and the files that
# say it.


def view_study(
    store: PartStore, question: StudyQuestion, audited: Mapping[str, float], about: str = ""
) -> StudyView:
    """Everything that is shown of a study.

    Args:
        store: Its folder.
        question: What is asked of its rows together.
        audited: Largest deviation of the batch path, as `PartStore.survey` found it.
        about: What its file says of it.

    Raises:
        StoreError: A part is damaged.
    """
    header = store.header
    summary = summarise(question, store.read([*question.columns, "message"]))
    front = () if summary.front is None else summary.front.index.tolist()
    names = [column.name for column in header.columns]
    return StudyView(
        name=header.name,
        about=about,
        columns=header.columns,
        rows=header.count,
        batch=header.batch,
        summary=summary,
        pictured=pictured_rows(store, names, front),
        audited=audited,
        computed_with=header.computed_with,
    )


def view_of(store: PartStore, study: Study, audited: Mapping[str, float]) -> StudyView:
    """Everything that is shown of a study that a folder holds; arguments and errors as of
    `view_study`.
    """
    question = study_question(study, design_of(study, {}), store.header.columns)
    return view_study(store, question, audited, study.about)


def write_pages(store: PartStore, view: StudyView, inputs: Mapping[str, bytes]) -> tuple[str, ...]:
    """Write the report, the front and the sensitivities beside the parts; returns their names.

    Args:
        store: The study's folder.
        view: What is shown of it.
        inputs: What the study was read from, by name in the folder.

    Raises:
        StoreError: The disk is full, or the folder cannot be written.
    """
    from dqforge.reports.exploration.part_file import FRONT, REPORT, SENSITIVITY
    from dqforge.reports.exploration.summary_files import front_file, sensitivity_file

    made: dict[str, bytes] = {}
    front, found = view.summary.front, view.summary.sensitivities
    if front is not None:
        made[FRONT] = front_file(store, front.index)
    if found:
        made[SENSITIVITY] = sensitivity_file(store.header.name, store.header.digest, found)
    page = render_study(view, _listed(store, made, inputs))
    files = {REPORT: page.encode("utf-8"), **made}
    for name, content in files.items():
        store.write_beside(name, content)
    return tuple(files)


def _listed(
    store: PartStore, made: Mapping[str, bytes], inputs: Mapping[str, bytes]
) -> list[ListedFile]:
    """What lies beside the page. ``study.json`` is finished after it, so that its bytes are not
    known here.
    """
    from dqforge.reports.exploration.part_file import FRONT, PARTS, SENSITIVITY, part_files
    from dqforge.reports.exploration.part_store import STUDY_JSON

    parts = [path.stat().st_size for path in part_files(store.folder).values()]
    words = {
        FRONT: "the rows of the front, whole",
        SENSITIVITY: "on which inputs the outputs depend",
    }
    return [
        ListedFile(STUDY_JSON, "what the study requests, its columns with units, and its outcome"),
        ListedFile(
            f"{PARTS}/",
            f"the rows in {counted(len(parts), 'file')}; each carries its SHA-256",
            sum(parts),
        ),
        *(ListedFile.of(name, words[name], content) for name, content in made.items()),
        *(
            ListedFile.of(name, "what the study was read from", content)
            for name, content in inputs.items()
        ),
    ]


# What is asked of the rows of a study together, from what its file says.

MOST_SPREAD = 12  # Histograms of a study that names no outputs that matter more than others.


def study_question(study: Study, design: Design, columns: Sequence[ColumnSpec]) -> StudyQuestion:
    """The question of a study.

    Args:
        study: What its file says.
        design: The design that it starts from.
        columns: Columns of its rows.
    """
    there = {column.name: column for column in columns}
    accept = tuple(bound_column(bound, design) for bound in study.accept)
    goals = goal_columns(study)
    sensitivity = tuple(OUTPUT_COLUMN + name for name in study.sensitivity)
    asked = [each.column for each in accept] + [*sensitivity] + [goal.column for goal in goals]
    numbers = [
        name
        for name, column in there.items()
        if name.startswith(OUTPUT_COLUMN) and column.kind == "number"
    ]
    drawn = tuple(
        name
        for name in (INPUT_COLUMN + each.key for each in study.tolerances)
        if name in there and there[name].kind == "number"
    )
    return StudyQuestion(
        accept=accept,
        goals=goals,
        inputs=tuple(name for name in there if name.startswith(INPUT_COLUMN)),
        drawn=drawn,
        sensitivity=sensitivity,
        spread=tuple(dict.fromkeys(asked or numbers[:MOST_SPREAD])),
        saltelli=study.saltelli,
    )


# A fixed header from the folder that `dqforge run` wrote: the emitted constants of its reference
# and of its loops.

_AGAIN = "run the design again"


def read_fixed_header(folder: Path) -> FixedHeader:
    """The header of a folder as it was emitted.

    Args:
        folder: What `dqforge run` wrote.

    Raises:
        InputError: It is not what dqforge wrote, it was changed since, or it has no current
            reference.
    """
    manifest, contents = read_listed(folder)
    return _checked(manifest, contents, str(folder))


def fixed_header(files: Mapping[str, bytes], source: str) -> FixedHeader:
    """The header of a folder whose files were read before.

    Args:
        files: Contents by their names in the folder, with the manifest.
        source: Name of the folder for messages.

    Raises:
        InputError: As `read_fixed_header`.
    """
    try:
        manifest = from_bytes(files.get(MANIFEST, b""))
    except ValueError as error:
        raise InputError(
            f"is not what dqforge wrote; {_AGAIN}", source=f"{source}/{MANIFEST}"
        ) from error
    return _checked(manifest, files, source)


def _checked(manifest: Manifest, contents: Mapping[str, bytes], source: str) -> FixedHeader:
    """The header that a result describes; every file that is there is as the manifest lists it."""
    for name, digest in manifest.files.items():
        content = contents.get(name)
        if content is not None and not _is_listed(content, digest):
            raise InputError(
                f"was changed since the run that wrote it; {_AGAIN}", source=f"{source}/{name}"
            )
    result, where = contents.get(RESULT), f"{source}/{RESULT}"
    if result is None or RESULT not in manifest.files:
        raise InputError(f"has no {RESULT}; {_AGAIN}", source=source)
    try:
        return header_from_plain(strict_json(result))
    except InputError as error:
        raise InputError(error.message, source=where) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not JSON; {_AGAIN}", source=where) from error


def _is_listed(content: bytes, digest: str) -> bool:
    """Whether a content is the listed one, whatever an editor made of the ends of its lines."""
    plain = content.replace(b"\r\n", b"\n")
    return digest in (sha256(content), sha256(plain), sha256(plain.replace(b"\n", b"\r\n")))


def header_from_plain(result: Mapping[str, Any]) -> FixedHeader:
    """The header that a result describes.

    Args:
        result: What `result.json` holds.

    Raises:
        InputError: An entry that the header is made of is missing, or is not what dqforge writes.
    """
    drive, header = _entry(result, "drive"), _entry(result, "header")
    gains = result.get("gains")
    return FixedHeader(
        reference=from_plain(_entry(header, "reference", "header.reference")),
        i_d=_loop(gains, "i_d"),
        i_q=_loop(gains, "i_q"),
        v_dc=_number(drive, "v_dc_V", "drive"),
        speed=(
            None
            if drive.get("reference_omega_m_rad_per_s") is None
            else _number(drive, "reference_omega_m_rad_per_s", "drive")
        ),
        digest=str(_entry(result, "input").get("digest", "")),
    )


def _entry(plain: Mapping[str, Any], key: str, name: str = "") -> Mapping[str, Any]:
    value = plain.get(key)
    if not isinstance(value, Mapping):
        raise InputError(f"{name or key} is missing: no current reference to meet; {_AGAIN}")
    return value


def _loop(gains: object, loop: str) -> FixedLoop | None:
    plain = gains.get(loop) if isinstance(gains, Mapping) else None
    if not isinstance(plain, Mapping):
        return None
    kp, ki_ts, t_s = (_number(plain, key, f"gains.{loop}") for key in ("kp", "ki_ts", "t_s"))
    return FixedLoop.emitted(kp, ki_ts, t_s)


def _number(plain: Mapping[str, Any], key: str, where: str) -> float:
    value = plain.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{where}.{key} must be a finite number, got {value!r}; {_AGAIN}")
    return float(value)
