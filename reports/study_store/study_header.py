"""``study.json``: what a study asks, with what it is computed, and what its parts must have to be
parts of it.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from dataclasses import field
from functools import cache
from importlib import import_module, metadata
from typing import Any

from dqforge import __version__
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_digest import asked_of
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.row_block import ColumnKind, ColumnSpec, RowSource
from dqforge.reports.plain_data import PlainData
from dqforge.reports.study_store.plain_study import plain_study

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
        raise ValueError("it is no study of dqforge")
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
