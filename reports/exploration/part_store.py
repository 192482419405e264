"""An explored folder: its parts written one by one, found again, and read by columns."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import platform
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, field, fields, is_dataclass, replace
from functools import cache
from importlib import import_module, metadata
from pathlib import Path
from posixpath import normpath
from types import TracebackType
from typing import Any, Self

from dqforge import __version__
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.row_designs import asked_of
from dqforge.machines.exploration.study import Axis, Bound, Draw, Goal, Search, Study, Tolerance
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    ColumnKind,
    ColumnSpec,
    RowSource,
)
from dqforge.reports.exploration.part_file import (
    BESIDE,
    KEY,
    MESSAGE,
    PARTS,
    WINNERS,
    PartAbout,
    PartColumns,
    PartError,
    StoreError,
    keep_folder,
    own_files,
    part_about,
    part_columns,
    part_files,
    part_name,
    read_whole,
    refuse_write,
    remove_leftovers,
    write_below,
    write_whole,
)
from dqforge.reports.operating_system.host_compiler import flush_folder
from dqforge.reports.output.folder import find_manifest, remove_empty_folders, sha256
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run_folder import MANIFEST


@dataclass(frozen=True, slots=True)
class Survey:
    """Which parts of a study are there.

    Args:
        finished: Numbers of the parts that count.
        damaged: By number, why a part that is there does not count.
        audited: Largest deviation of the batch path over the finished parts, by output.
    """

    finished: frozenset[int]
    damaged: Mapping[int, str]
    audited: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class PartStore:
    """A folder that holds one study.

    Args:
        folder: As the user named it.
        header: What the study is.
        lock: Descriptor that keeps other runs out; -1 of a folder that is only read.
    """

    folder: Path
    header: StudyHeader
    lock: int = field(default=-1, compare=False)

    @classmethod
    def open(
        cls,
        folder: Path,
        header: StudyHeader,
        *,
        restart: bool = False,
        mixed: bool = False,
        inputs: Mapping[str, bytes] | None = None,
    ) -> Self:
        """Make a folder for a study, or go on with the study that it holds.

        Args:
            folder: Made if missing.
            header: The study that is asked.
            restart: Whether what another study, or this one, left there is taken away first; files
                that no study wrote stay.
            mixed: Whether parts of other versions or another processor may stand beside new ones.
            inputs: Files from which the study can be read again, by name in the folder.

        Raises:
            InputError: The folder cannot be written, holds another study, or another run writes
                there.
        """
        lock = made_and_locked(folder)
        try:
            make_ready(folder, header, restart=restart, mixed=mixed)
            # First what says whose folder this is: a run that ends here can be gone on with.
            write_whole(folder / STUDY_JSON, header_bytes(header))
            for name, content in (inputs or {}).items():
                write_below(folder, name, content)
        except BaseException:
            os.close(lock)
            raise
        return cls(folder, header, lock)

    @classmethod
    def existing(cls, folder: Path) -> Self:
        """A folder to be read; raises `InputError` where it holds no study."""
        found = held_study(folder)
        if found is None:
            raise InputError(
                f"{folder} holds no {STUDY_JSON}; name a folder that 'dqforge explore' wrote"
            )
        return cls(folder, found)

    def survey(self) -> Survey:
        """Look at every part: its seal, its rows, and the study that it is of."""
        finished: set[int] = set()
        damaged: dict[int, str] = {}
        audited: dict[str, float] = {}
        for part, path in part_files(self.folder).items():
            try:
                about = part_about(read_whole(path))
                self._require(part, about)
            except (PartError, OSError) as error:
                damaged[part] = str(error)
                continue
            finished.add(part)
            for name, deviation in about.audited.items():
                audited[name] = max(audited.get(name, 0.0), deviation)
        return Survey(frozenset(finished), damaged, dict(sorted(audited.items())))

    def finished(self) -> frozenset[int]:
        """Numbers of the parts that need not be computed."""
        return self.survey().finished

    def _require(self, part: int, about: PartAbout) -> None:
        """Raise `PartError` where a part is not this one of this study."""
        header = self.header
        if about.digest != header.digest:
            raise PartError("it is of another study")
        if part >= header.parts or about.first != part * header.batch:
            raise PartError("it is in the place of another part")
        if about.count != header.rows_of(part):
            raise PartError(f"it has {about.count} rows of {header.rows_of(part)}")

    def write(self, part: int, data: bytes) -> None:
        """Keep a part, as `dqforge.reports.exploration.part_file.encode_part` made it.

        Raises:
            StoreError: The disk is full or the folder cannot be written; what is finished stays.
            PartError: The bytes are not those of this part of this study.
        """
        self._require(part, part_about(data))
        write_whole(self.folder / PARTS / part_name(part), data)

    def read(
        self, names: Sequence[str], parts: Collection[int] | None = None
    ) -> Iterator[PartColumns]:
        """Columns of one part after the other, in their order; parts that are not there are left
        out.

        Args:
            names: Columns of the study, ``key`` or ``message``.
            parts: Numbers of the parts, None for all.

        Raises:
            InputError: There is no such column.
            StoreError: A part is damaged.
        """
        known = (*(column.name for column in self.header.columns), KEY, MESSAGE)
        unknown = [name for name in names if name not in known]
        if unknown:
            raise InputError(f"{self.folder} has no column {unknown[0]!r}")
        for part, path in part_files(self.folder, parts).items():
            yield self._columns(part, path, names)

    def _columns(self, part: int, path: Path, names: Sequence[str]) -> PartColumns:
        try:
            found = part_columns(read_whole(path), names, self.header.columns)
            self._require(part, found.about)
        except (PartError, OSError) as error:
            raise StoreError(
                f"{path}: {error}; run the study again, which computes this part again"
            ) from error
        return found

    def finish(self, outcome: PlainData) -> Self:
        """Put into ``study.json`` what is known at the end."""
        done = replace(self, header=replace(self.header, outcome=outcome))
        write_whole(self.folder / STUDY_JSON, header_bytes(done.header))
        return done

    def write_beside(self, name: str, content: bytes) -> None:
        """Write `FRONT`, `SENSITIVITY` or `REPORT`; raises as `write`."""
        if name not in BESIDE:
            raise ValueError(f"{name} is not a file of a study")
        write_whole(self.folder / name, content)

    def close(self) -> None:
        """Let other runs into the folder; once."""
        if self.lock >= 0:
            os.close(self.lock)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


# ``study.json``: what a study asks, with what it is computed, and what its parts must have to be
# parts of it.

STUDY_JSON = "study.json"
LAYOUT = 1  # Number of the layout of an explored folder; another one is refused, not guessed.
_LIBRARIES = ("numpy", "scipy", "pyarrow", "nlopt", "cvxpy", "clarabel", "casadi")


@dataclass(frozen=True, slots=True)
class StudyHeader:
    """What stands in ``study.json``.

    Args:
        name: Title of the study.
        asked: What it asks, by dotted key and in SI units: what is compared, key by key, where a
            folder holds a study.
        study: The whole of it, from which it can be read again; not compared.
        count, batch: Number of rows, and rows per part.
        columns: Columns of every part.
        computed_with: Versions of dqforge, Python and the libraries on which bytes or last digits
            depend.
        cpu_features: Instruction sets that numpy found.
        created_by: What pyarrow writes into every part of itself.
        outcome: What is known at the end: rows by state, largest deviation of the batch path.
    """

    name: str
    asked: PlainData
    study: PlainData
    count: int
    batch: int
    columns: tuple[ColumnSpec, ...]
    computed_with: Mapping[str, str]
    cpu_features: tuple[str, ...]
    created_by: str
    outcome: PlainData = field(default_factory=dict)

    @property
    def parts(self) -> int:
        """Number of parts."""
        return -(-self.count // self.batch)

    def rows_of(self, part: int) -> int:
        """Number of rows of a part."""
        return min(self.batch, self.count - part * self.batch)

    @property
    def digest(self) -> str:
        """SHA-256 of what the rows depend on, in hexadecimal; it stands in every part.

        A drawn study that is made longer keeps its first rows, and so does a search with more
        generations: their lengths are not in it. Nor is what is picked from the rows afterwards.
        """
        plain = {
            "layout": LAYOUT,
            "dqforge": self.computed_with["dqforge"],
            "asked": self._of_rows(),
            "batch": self.batch,
            "columns": [_plain_column(column) for column in self.columns],
        }
        return hashlib.sha256(canonical(plain)).hexdigest()

    def _of_rows(self) -> PlainData:
        """What the rows and their order depend on."""
        grid = any(key.startswith("vary.") for key in self.asked)
        searched = any(key.startswith("search.") for key in self.asked)
        left_out = {"search.generations"}
        left_out |= set() if grid else {"draw.count"}
        left_out |= set() if searched else {"pareto"}
        return {key: value for key, value in self.asked.items() if key not in left_out}


def canonical(plain: object) -> bytes:
    """JSON of plain data with sorted keys, shortest numbers, and zero without its sign."""
    return json.dumps(_unsigned(plain), sort_keys=True, separators=(",", ":")).encode("ascii")


def _unsigned(plain: object) -> object:
    if isinstance(plain, Mapping):
        return {str(key): _unsigned(value) for key, value in plain.items()}
    if isinstance(plain, (list, tuple)):
        return [_unsigned(value) for value in plain]
    return plain + 0.0 if isinstance(plain, float) else plain


def differing_keys(one: StudyHeader, other: StudyHeader) -> tuple[str, ...]:
    """Keys in which two studies differ, sorted; empty where they ask the same of their rows."""
    keys = _differing(one.asked, other.asked)
    sets = _differing(_sets(one.study), _sets(other.study))
    same_file = one.study.get("design_sha256") == other.study.get("design_sha256")
    if "design" in keys and sets and same_file:
        # The same file with something else set in it: what, is known.
        keys = (keys - {"design"}) | sets
    return tuple(sorted(keys))


def _differing(one: Mapping[str, object], other: Mapping[str, object]) -> set[str]:
    return {
        key
        for key in {*one, *other}
        if key not in one or key not in other or canonical(one[key]) != canonical(other[key])
    }


def _sets(study: Mapping[str, Any]) -> PlainData:
    return {f"set.{key}": value for key, value in study.get("sets", ())}


def study_header(study: Study, source: RowSource) -> StudyHeader:
    """The header of a study that is computed here and now.

    Args:
        study: What is asked.
        source: Its rows.
    """
    return StudyHeader(
        study.name,
        _listed(asked_of(study)),
        plain_study(study),
        source.count,
        source.batch,
        tuple(source.columns),
        versions() | _searched_with(study),
        cpu_features(),
        writer_name(),
    )


def _searched_with(study: Study) -> dict[str, str]:
    """Version of the library that chooses the rows of a study; `_LIBRARIES` has nlopt."""
    if study.search is None or study.search.method != "nsga2":
        return {}
    return {"pymoo": metadata.version("pymoo")}


def _listed(asked: PlainData) -> PlainData:
    """What is asked as JSON gives it back, with lists for tuples."""
    return dict(json.loads(canonical(asked)))


@cache
def _library_versions() -> tuple[tuple[str, str], ...]:
    found = []
    for name in _LIBRARIES:
        try:
            found.append((name, metadata.version(name)))
        except metadata.PackageNotFoundError:
            continue
    return tuple(found)


def versions() -> dict[str, str]:
    """Versions on which bytes or last digits of rows depend, and the kind of processor."""
    python = ".".join(platform.python_version_tuple()[:2])
    own = {"dqforge": __version__, "python": python}
    return own | {"processor": platform.machine()} | dict(_library_versions())


def cpu_features() -> tuple[str, ...]:
    """Instruction sets that numpy found on this machine, sorted."""
    # Where numpy's own report of itself (numpy.show_runtime) takes them from.
    found = import_module("numpy._core._multiarray_umath").__cpu_features__
    return tuple(sorted(name for name, there in found.items() if there))


def writer_name() -> str:
    """What pyarrow writes of itself into each part."""
    import pyarrow as pa

    return f"parquet-cpp-arrow version {pa.cpp_version}"


def _plain_column(column: ColumnSpec) -> PlainData:
    plain: PlainData = {"name": column.name, "unit": column.unit, "kind": column.kind}
    return plain | ({"choices": list(column.choices)} if column.kind == "choice" else {})


def header_bytes(header: StudyHeader) -> bytes:
    """The file: the same bytes for the same content."""
    plain = {
        "dqforge_explored": LAYOUT,
        "name": header.name,
        "rows": header.count,
        "rows_per_part": header.batch,
        "rows_sha256": header.digest,
        "asked": header.asked,
        "study": header.study,
        "columns": [_plain_column(column) for column in header.columns],
        "computed_with": dict(sorted(header.computed_with.items())),
        "cpu_features": list(header.cpu_features),
        "created_by": header.created_by,
        "outcome": header.outcome,
    }
    seal = hashlib.sha256(canonical(plain)).hexdigest()
    return (json.dumps(plain | {"sha256": seal}, indent=1) + "\n").encode("ascii")


def header_from(content: bytes) -> StudyHeader:
    """A header as `header_bytes` wrote it.

    Raises:
        ValueError: It is none, or it was changed.
    """
    try:
        plain: Any = json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(plain, dict) or "dqforge_explored" not in plain:
        raise ValueError("it is not a study of dqforge")
    seal = plain.pop("sha256", None)
    if seal != hashlib.sha256(canonical(plain)).hexdigest():
        raise ValueError("it was changed since it was written")
    if plain["dqforge_explored"] != LAYOUT:
        raise ValueError("another version of dqforge wrote it")
    return StudyHeader(
        plain["name"],
        plain["asked"],
        plain["study"],
        plain["rows"],
        plain["rows_per_part"],
        tuple(_column(column) for column in plain["columns"]),
        plain["computed_with"],
        tuple(plain["cpu_features"]),
        plain["created_by"],
        plain["outcome"],
    )


def _column(plain: PlainData) -> ColumnSpec:
    kind: ColumnKind = "choice" if plain["kind"] == "choice" else "number"
    return ColumnSpec(plain["name"], plain["unit"], kind, tuple(plain.get("choices", ())))


# The folder of a study: made, kept from other runs, gone on with, or refused for what it holds.

_NAMED = 4


def made_and_locked(folder: Path) -> int:
    """Make a folder with its folder of parts, and keep other runs out."""
    parts = folder / PARTS
    try:
        parts.mkdir(parents=True, exist_ok=True)
        if parts.is_symlink():
            raise InputError(f"{parts} is a link; take another -o")
        if not all(os.access(place, os.W_OK | os.X_OK) for place in (folder, parts)):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return keep_folder(folder)
    except OSError as error:
        raise InputError(
            f"cannot write the folder {folder}: {error.strerror or error}; take another -o"
        ) from error


def make_ready(folder: Path, header: StudyHeader, *, restart: bool, mixed: bool) -> None:
    """Hold what a folder has against a study, and take away what must go.

    Args:
        folder: Locked.
        header: The study that is asked.
        restart, mixed: As of `dqforge.reports.exploration.part_store.PartStore.open`.

    Raises:
        InputError: The folder holds something else.
    """
    old = held_study(folder)
    remove_leftovers(folder)
    if old is None:
        _refuse_strange(folder)
    elif restart:
        _take_away(folder, old)
    else:
        _refuse_other(folder, old, header, mixed=mixed)


def held_study(folder: Path) -> StudyHeader | None:
    """The study of a folder, None where there is none; raises `InputError` on anything else."""
    path = folder / STUDY_JSON
    try:
        return header_from(read_whole(path))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}; take another -o") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not what dqforge wrote ({error}); take another -o") from error


def _refuse_other(folder: Path, old: StudyHeader, new: StudyHeader, *, mixed: bool) -> None:
    """Raise where what a folder holds cannot be gone on with."""
    then, now = old.computed_with, new.computed_with
    if then.get("dqforge") != now.get("dqforge"):
        raise InputError(
            f"{folder} was begun with dqforge {then.get('dqforge')}, this is {now.get('dqforge')}; "
            "take another -o, or --restart"
        )
    if old.digest != new.digest or new.count < old.count:
        raise InputError(_another(folder, old, new))
    other = _other_machine(old, new)
    if other and not mixed:
        raise InputError(
            f"{folder} was begun with {other}: bytes of further parts may differ in last digits; "
            "take another -o, --restart, or --mixed"
        )


def _refuse_strange(folder: Path) -> None:
    """Raise where a folder that holds no study holds what a study would write over."""
    if part_files(folder):
        raise InputError(f"{folder} holds parts without their {STUDY_JSON}; take another -o")
    there = [name for name in (MANIFEST, INPUT, *BESIDE) if os.path.lexists(folder / name)]
    if there:
        raise InputError(f"{folder} holds {there[0]}, which no study wrote; take another -o")


def _another(folder: Path, old: StudyHeader, new: StudyHeader) -> str:
    keys = differing_keys(old, new)
    count = len({*old.asked, *new.asked})
    named = ", ".join(keys[:_NAMED]) + (f" and {len(keys) - _NAMED} more" * (len(keys) > _NAMED))
    which = f"{len(keys)} of {count} keys differ: {named}" if keys else "its columns differ"
    return f"{folder} holds another study ({which}); take another -o, or --restart"


def _other_machine(old: StudyHeader, new: StudyHeader) -> str:
    """In what the libraries or the processor of an earlier run differ, empty where in nothing."""
    then, now = old.computed_with, new.computed_with
    for name in sorted({*then, *now}):
        if then.get(name) != now.get(name):
            return f"{name} {then.get(name, 'none')}, here {now.get(name, 'none')}"
    if old.created_by != new.created_by:
        return f"{old.created_by}, here {new.created_by}"
    features = sorted({*old.cpu_features} ^ {*new.cpu_features})
    where = "there" if features and features[0] in old.cpu_features else "here"
    return f"another processor ({features[0]} only {where})" if features else ""


def _take_away(folder: Path, header: StudyHeader) -> None:
    """Remove what a study wrote, its parts first: what is left of it at any time is a study."""
    names = (*BESIDE, *input_names(header.study))
    try:
        for path in own_files(folder, names):
            path.unlink(missing_ok=True)
        for winner in sorted((folder / WINNERS).glob("row-*")):
            _take_winner(winner)
        flush_folder(folder / PARTS)
    except OSError as error:
        refuse_write(folder, error)


def _take_winner(folder: Path) -> None:
    """Remove what `dqforge.reports.exploration.winners` wrote, as far as nobody changed it."""
    manifest = None if folder.is_symlink() else find_manifest(folder)
    if manifest is None:
        return
    for name, digest in manifest.files.items():
        path = folder / name
        if path.is_file() and not path.is_symlink() and sha256(path.read_bytes()) == digest:
            path.unlink()
    (folder / MANIFEST).unlink()
    remove_empty_folders(folder, {*manifest.files, MANIFEST})
    for empty in (folder, folder.parent):
        with suppress(OSError):
            empty.rmdir()


# A study as plain data, with the files from which it is read again; and the way back.

INPUT = "study-input"  # Folder in an explored folder that holds what the study was read from.
INPUT_DESIGN = f"{INPUT}/design.yaml"
_FILES, _HEADER = f"{INPUT}/files", f"{INPUT}/header"
_CONTENTS = ("design_text", "named", "header_files", "places")


def plain_study(study: Study) -> PlainData:
    """The whole of a study but for contents of files, of which it holds the names."""
    plain = {
        each.name: _plain(getattr(study, each.name))
        for each in fields(study)
        if each.name not in _CONTENTS
    }
    plain["design_sha256"] = hashlib.sha256(study.design_text).hexdigest()
    plain["named"] = [name for name, _ in study.named]
    plain["header_files"] = [name for name, _ in study.header_files]
    return plain


def _plain(value: Any) -> Any:
    """A value of a record as JSON holds it."""
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    return [_plain(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def study_inputs(study: Study) -> dict[str, bytes]:
    """The files from which a study can be read again, by their names in its folder."""
    named = {_named_place(name): content for name, content in study.named}
    own = {f"{_HEADER}/{name}": content for name, content in study.header_files}
    return {INPUT_DESIGN: study.design_text} | named | own


def _named_place(name: str) -> str:
    """Where a file lies that the design names, which is always beside or below it."""
    return f"{_FILES}/{normpath(name)}"


def input_names(plain: PlainData) -> tuple[str, ...]:
    """Names of `study_inputs` of a study that is plain."""
    named = [_named_place(name) for name in plain.get("named", ())]
    own = [f"{_HEADER}/{name}" for name in plain.get("header_files", ())]
    return (INPUT_DESIGN, *dict.fromkeys(named), *own)


def study_from(plain: PlainData, contents: Mapping[str, bytes]) -> Study:
    """A study again.

    Args:
        plain: As `plain_study` made it.
        contents: As `study_inputs` made them.
    """
    found = {key: _frozen(value) for key, value in plain.items() if key != "design_sha256"}
    found |= {
        "design_text": contents[INPUT_DESIGN],
        "named": tuple((name, contents[_named_place(name)]) for name in plain["named"]),
        "header_files": tuple(
            (name, contents[f"{_HEADER}/{name}"]) for name in plain["header_files"]
        ),
        "sets": tuple((key, value) for key, value in plain["sets"]),
        "axes": tuple(_axis(axis) for axis in plain["axes"]),
        "tolerances": tuple(Tolerance(**entry) for entry in plain["tolerances"]),
        "draw": None if plain["draw"] is None else _draw(plain["draw"]),
        "limits": tuple(_bound(entry) for entry in plain["limits"]),
        "accept": tuple(_bound(entry) for entry in plain["accept"]),
        "goals": tuple(Goal(**entry) for entry in plain["goals"]),
        "search": None if plain["search"] is None else Search(**plain["search"]),
    }
    return Study(**found)


def _frozen(value: Any) -> Any:
    return tuple(_frozen(entry) for entry in value) if isinstance(value, list) else value


def _axis(plain: PlainData) -> Axis:
    steps = tuple(tuple(step) for step in plain["steps"])
    return Axis(tuple(plain["keys"]), steps, _frozen(plain["numbers"]), plain.get("spacing", ""))


def _draw(plain: PlainData) -> Draw:
    return Draw(**(plain | {"correlations": _frozen(plain["correlations"])}))


def _bound(plain: PlainData) -> Bound:
    return Bound(**(plain | {"point": _frozen(plain["point"])}))


# Names, values and units of columns as people read them.

_FOR_PEOPLE = {"rad": "deg"}
_SHARES = ("torque_error", "loss_penalty", "torque_relative", "loss_relative")


def label(name: str) -> str:
    """A column without what says that it is an input or output.

    Args:
        name: Whole name of a column.
    """
    return name.removeprefix(INPUT_COLUMN).removeprefix(OUTPUT_COLUMN)


def people_unit(spec: ColumnSpec) -> str:
    """Unit of a column in tables and pictures: degrees for angles, percent for shares.

    Args:
        spec: The column.
    """
    if not spec.unit and spec.name.rpartition(".")[2] in _SHARES:
        return "%"
    return _FOR_PEOPLE.get(spec.unit, spec.unit)


def value_text(spec: ColumnSpec, value: float, digits: int = 5) -> str:
    """A value of a column with its unit; nothing where there is none.

    Args:
        spec: The column.
        value: A number in SI units, or the place of a word.
        digits: Significant digits.
    """
    if spec.kind == "choice":
        return spec.choices[int(value)] if value >= 0 else ""
    if not math.isfinite(value):
        return ""
    return format_quantity(float(value), people_unit(spec), digits)
