"""What a study file says, checked: the design it starts from, the keys that vary, what is drawn,
what is asked of each row.

Keys are the dotted paths of a design's messages. Rows are the grid points of ``axes`` in their
order, the last axis quickest; where something is drawn, each grid point has ``draw.count`` rows.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any, Literal

from pydantic import Field, WithJsonSchema

from dqforge.machines.design.schema import named_schema
from dqforge.machines.entries.kinds import About, FileName, Listing, Name, Section
from dqforge.machines.errors import Places
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.records import dataclass

DistributionKind = Literal["normal", "uniform", "between"]
Sampling = Literal["random", "sobol"]
Spacing = Literal["", "linear", "log"]
SearchMethod = Literal["nsga2", "nlopt"]


@dataclass(frozen=True, slots=True)
class Axis:
    """Keys that vary in step: one value of each per step, as a design file writes it.

    Args:
        keys: K dotted paths.
        steps: N tuples of K values.
        numbers: N tuples of the K values in SI units where every one is a plain quantity, else
            empty.
        spacing: How the steps of a range lie, between whose ends a search may take any value; empty
            for values that were listed.
    """

    keys: tuple[str, ...]
    steps: tuple[tuple[YamlValue, ...], ...]
    numbers: tuple[tuple[float, ...], ...] = ()
    spacing: Spacing = ""

    @property
    def continuous(self) -> bool:
        """Whether a search takes any number between its ends, and not one of its steps."""
        several = len(self.keys) > 1 or len(self.steps) < 2
        return bool(self.numbers and self.spacing) and not several


@dataclass(frozen=True, slots=True)
class Tolerance:
    """A key that is drawn, round the value of the design or between two bounds.

    Args:
        key: Dotted path of a quantity.
        kind: ``normal`` (standard deviation ``width``, cut at ``cut`` of them), ``uniform`` (half
            width ``width``) or ``between`` (``low`` to ``high``).
        width: Share of the design's value where ``relative``, else in the SI unit of the key.
        centre: The design's value in the SI unit of the key; what ``between`` needs none of.
    """

    key: str
    kind: DistributionKind
    width: float = 0.0
    relative: bool = True
    cut: float = 3.0
    low: float = 0.0
    high: float = 0.0
    centre: float = 0.0


@dataclass(frozen=True, slots=True)
class Draw:
    """How many rows are drawn, and from which seed; ``correlations`` are triples key, key, rho."""

    count: int
    seed: int
    sampling: Sampling = "random"
    correlations: tuple[tuple[str, str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Bound:
    """A limit on an output, in SI units.

    ``output`` is a name of `dqforge.optimizer.exploration.row_outputs`; ``point`` picks the
    operating point of a loss (torque in N m, speed in rad/s, modulator or empty), None all of them.
    ``unit`` is the SI unit of both values, for a check against that of the output.
    """

    output: str
    below: float | None = None
    above: float | None = None
    point: tuple[float, float, str] | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Goal:
    """An output that is made small, or large."""

    output: str
    minimise: bool = True


@dataclass(frozen=True, slots=True)
class Search:
    """A search instead of a grid: the axes' ends are its bounds."""

    method: SearchMethod
    population: int
    generations: int
    seed: int


@dataclass(frozen=True, slots=True)
class Study:
    """One study file.

    ``design_text`` are the bytes of the design it starts from, ``design_source`` its name for
    messages, ``named`` the bytes of each file that the design names. ``header`` is the folder of a
    fixed header, ``nominal`` one that is made now, empty none. ``digest`` is the SHA-256 of what
    the study asks, in hexadecimal, whatever its comments and the order of its keys.
    ``header_files`` are the files of the folder ``header`` by their names.
    """

    name: str
    about: str
    design_text: bytes
    design_source: str
    digest: str
    named: tuple[tuple[str, bytes], ...] = ()
    sets: tuple[tuple[str, YamlValue], ...] = ()
    axes: tuple[Axis, ...] = ()
    tolerances: tuple[Tolerance, ...] = ()
    draw: Draw | None = None
    header: str = ""
    outputs: tuple[str, ...] = ()
    limits: tuple[Bound, ...] = ()
    accept: tuple[Bound, ...] = ()
    goals: tuple[Goal, ...] = ()
    sensitivity: tuple[str, ...] = ()
    search: Search | None = None
    places: Places | None = field(default=None, compare=False, repr=False)
    header_files: tuple[tuple[str, bytes], ...] = field(default=(), repr=False)

    @property
    def saltelli(self) -> bool:
        """Whether the rows are those of a design for first-order and total sensitivities: drawn by
        a Sobol sequence alone, independently of each other.
        """
        draw = self.draw
        if draw is None or draw.sampling != "sobol" or draw.correlations or self.axes:
            return False
        return bool(self.sensitivity and self.tolerances)


# The study file as a schema: every key with its meaning and default.
#
# What stands at a key of a design is judged by that key (`varied_values`, `drawn_values`), what is
# asked of an output by the kind of the output (`asked_outputs`).

MOST_ROWS = 100_000_000
LARGEST_SEED = 2**63 - 1
_VALUE: dict[str, Any] = {"type": ["number", "string", "boolean", "array", "object"]}
_QUANTITY: dict[str, Any] = {"type": ["number", "string"]}


def _object(required: list[str], **properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }


_LIST: dict[str, Any] = {"type": "array", "items": _VALUE, "minItems": 1}
_RANGE = _object(
    ["from", "to", "count"],
    **{"from": _QUANTITY, "to": _QUANTITY},
    count={"type": "integer", "minimum": 2},
    spacing={"enum": ["linear", "log"], "default": "linear"},
)
_FILES: dict[str, Any] = {"anyOf": [{"type": "string"}, {"type": "array"}]}
_STEPS: dict[str, Any] = {
    "anyOf": [
        _LIST,
        _object(
            ["values"],
            values={"anyOf": [_LIST, {"const": "all"}]},
            one_by_one={"type": "boolean", "default": False},
        ),
        _object(["range"], range=_RANGE),
        _object(["files"], files=_FILES),
    ]
}
_TOGETHER: dict[str, Any] = {"type": "object", "additionalProperties": _STEPS, "minProperties": 1}
_VARY: dict[str, Any] = {
    "type": "object",
    "properties": {"together": _TOGETHER},
    "additionalProperties": {
        "anyOf": [*_STEPS["anyOf"], _object(["together"], together=_TOGETHER)]
    },
}
_SPREAD: dict[str, Any] = {
    "anyOf": [
        _object(["normal"], normal=_QUANTITY, cut={"type": "number", "default": 3.0}),
        _object(["uniform"], uniform=_QUANTITY),
        _object(
            ["between"],
            between={"type": "array", "items": _QUANTITY, "minItems": 2, "maxItems": 2},
        ),
    ]
}
_TOLERANCES: dict[str, Any] = {
    "anyOf": [
        {"const": "design"},
        {
            "type": "object",
            "properties": {"design": {"const": "uniform"}},
            "additionalProperties": _SPREAD,
        },
    ]
}
_BOUNDS: dict[str, Any] = {
    "type": "object",
    "additionalProperties": {
        "anyOf": [
            _QUANTITY,
            _object(
                [],
                below=_QUANTITY,
                above=_QUANTITY,
                point=_object(
                    ["torque", "speed"],
                    torque=_QUANTITY,
                    speed=_QUANTITY,
                    modulation={"type": "string"},
                ),
            ),
        ]
    },
}

Entries = dict[str, Any]  # Keys of a design, or names of outputs, with what is asked of them.


class CorrelationSection(Section):
    """Two drawn keys that are not independent."""

    keys: Annotated[Listing[str], Field(min_length=2, max_length=2)] = Field(
        description="two keys under tolerances"
    )
    rho: float = Field(
        strict=False, gt=-1.0, lt=1.0, description="correlation of their normal scores"
    )


class DrawSection(Section):
    """How many rows are drawn at each point of the grid, and from which seed."""

    count: int = Field(ge=1, le=MOST_ROWS, description="rows per point of the grid")
    seed: int = Field(ge=0, le=LARGEST_SEED, description="the same seed draws the same rows")
    sampling: Sampling = Field(
        default="random",
        description=(
            "random: every key independently; sobol: low-discrepancy points, for sensitivities"
        ),
    )
    correlations: Annotated[Listing[CorrelationSection], Field(max_length=200)] = Field(
        default=(), description="list of {keys: [a, b], rho: 0.5}"
    )


class ParetoSection(Section):
    """Outputs in a trade-off."""

    minimise: Listing[str] = Field(default=(), description="outputs to be small")
    maximise: Listing[str] = Field(default=(), description="outputs to be large")


class SearchSection(Section):
    """A search within the ranges of vary, instead of their grid."""

    method: SearchMethod = Field(
        default="nsga2", description="nsga2: evolutionary, several goals; nlopt: one goal"
    )
    population: int = Field(default=100, ge=4, le=100_000, description="rows per generation")
    generations: int = Field(default=50, ge=1, le=100_000, description="number of generations")
    seed: int = Field(ge=0, le=LARGEST_SEED, description="the same seed searches the same way")


STUDY_SCHEMA_ID = "urn:dqforge:schema:study:1"


class StudyFile(Section):
    """Study of many variants of a design."""

    dqforge_study: Literal[1] = Field(description="version of this format")
    name: Name = Field(description="one line that names the study, at most 80 characters")
    about: About = Field(default="", description="a paragraph on the study")
    design: FileName = Field(
        description="the design it starts from: a file beside the study, or a drive of the library"
    )
    vary: Annotated[Entries, WithJsonSchema(_VARY)] = Field(
        default={},
        description=(
            "keys of the design, each with values, a range or files; the rows are all "
            "combinations, the last key quickest; together: {key: [...], key: [...]} varies keys "
            "in step"
        ),
    )
    set: Annotated[Entries, WithJsonSchema({"type": "object"})] = Field(
        default={}, description="keys of the design with other values than it has"
    )
    tolerances: Annotated[Any, WithJsonSchema(_TOLERANCES)] = Field(
        default={},
        description=(
            "keys of the design that are drawn: normal, uniform or between; shares in % are of the "
            "design's value; design: the box of its control.tolerances, uniform"
        ),
    )
    draw: DrawSection | None = Field(default=None, description="how many are drawn; for tolerances")
    header: FileName | None = Field(
        default=None,
        description=(
            "one fixed header on all drawn machines: the folder beside the study that "
            "'dqforge run' wrote, or nominal: that of the design itself"
        ),
    )
    outputs: Listing[str] = Field(default=(), description="columns besides those of every study")
    limits: Annotated[Entries, WithJsonSchema(_BOUNDS)] = Field(
        default={}, description="outputs with what a row must keep: a largest value, below, above"
    )
    accept: Annotated[Entries, WithJsonSchema(_BOUNDS)] = Field(
        default={}, description="outputs with what counts as good: below, above, at a point"
    )
    pareto: ParetoSection | None = Field(default=None, description="goals")
    sensitivity: Listing[str] = Field(
        default=(), description="outputs whose dependence on the drawn keys is reported"
    )
    search: SearchSection | None = Field(default=None, description="a search instead of the grid")


def study_json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the study file, for editors and for documentation."""
    return named_schema(StudyFile, STUDY_SCHEMA_ID, "dqforge study file")
