"""Rows of a study as columns: what went in, what came out, and how each row ended."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import field
from importlib.metadata import version
from typing import Literal, Protocol, get_args, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.errors import InputError, dotted
from dqforge.machines.exploration.design_keys import DesignKey, design_key
from dqforge.machines.exploration.row_designs import (
    Recent,
    ResolvedValues,
    canonical,
    maker_of,
    plain_values,
    resolved_values,
)
from dqforge.machines.exploration.study import Axis, Draw, Study, Tolerance
from dqforge.machines.exploration.study_checks import grid_rows
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.records import dataclass

RowState = Literal["ok", "limit", "no-solution", "refused", "crashed"]
STATES: tuple[RowState, ...] = get_args(RowState)
ColumnKind = Literal["number", "choice"]
INPUT_COLUMN, OUTPUT_COLUMN = "in.", "out."  # What the names of columns begin with.
KEY_BYTES = 16  # Length of a row's key.


@dataclass(frozen=True, slots=True)
class ColumnSpec:
    """A column of every part of a study: ``in.<key>`` or ``out.<name>``, its SI unit, and for a
    choice its words in sorted order.
    """

    name: str
    unit: str = ""
    kind: ColumnKind = "number"
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RowBlock:
    """Rows ``first`` to ``first + n - 1``.

    Args:
        first: Index of the first row in the study.
        columns: By name of the column, in the order of the study's `ColumnSpec`s: numbers (n,) in
            SI units, NaN for what does not exist; of choices the places in their words, int32, -1
            for none.
        keys: Hash of each row's resolved design, uint8 (n, 16).
        states: Places in `STATES`, int8 (n,).
        messages: What the single command would print, empty for rows that ended well.
        audited: Largest relative deviation of the batch path from the single path by output, of the
            rows of this block that were computed by both.
    """

    first: int
    columns: Mapping[str, FloatArray | NDArray[np.int32]]
    keys: NDArray[np.uint8]
    states: NDArray[np.int8]
    messages: tuple[str, ...]
    audited: Mapping[str, float] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.messages)


class RowSource(Protocol):
    """Where rows come from: what an engine runs and a store writes. Picklable; it is shipped once
    to each worker, and the same rows give the same block wherever they are computed.
    """

    @property
    def count(self) -> int:
        """Number of rows."""
        ...

    @property
    def batch(self) -> int:
        """Rows per part: fixed by the kind of the study, never by the number of workers."""
        ...

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block."""
        ...

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1, computed."""
        ...


@runtime_checkable
class KnownRows(Protocol):
    """What a `RowSource` may offer besides: which rows they are, without computing them. A row that
    crashes is then named by it.
    """

    def inputs(self, first: int, end: int) -> Mapping[str, FloatArray | NDArray[np.int32]]:
        """What goes into rows first to end - 1, by key (without ``in.``), shape (n,)."""
        ...

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Hash of each of these rows' resolved design, shape (n, 16)."""
        ...


# Keys of rows: what a row is, as a hash, however the study that asks for it is written.
#
# The hash is over the version of the program, over what is asked of every row, over the words of
# the resolved design by their paths, and over its numbers in SI units in the order of their paths.
# Which of the keys vary is no part of it: the same design in another study has the same key.

_MOST_BASES = 4096

Words = tuple[int, ...]


class RowKeys:
    """Keys of the rows of one study.

    Args:
        study: The study.
        outputs: Names of the columns that its rows have, in any order.
    """

    def __init__(self, study: Study, outputs: Sequence[str]) -> None:
        self._study = study
        self._asked = canonical([version("dqforge"), asked_of_rows(study, outputs)])
        self._said = [_sha(study.design_text), list(study.sets)]
        entries = input_keys(study)
        self._numbers = [entry for entry in entries if entry.spec.kind == "number"]
        self._words = [entry for entry in entries if entry.spec.kind == "choice"]
        self._bases: dict[Words, _Base] = {}
        self._resolved: dict[Words, ResolvedValues | None] = {}

    def of(self, inputs: Inputs) -> NDArray[np.uint8]:
        """Keys of rows, shape (n, 16), from what goes into them."""
        count = len(next(iter(inputs.values()))) if inputs else 1
        if not self._words:
            return self._base(()).keys(self._columns(inputs), count)
        codes = np.column_stack([inputs[entry.key.name] for entry in self._words])
        found = np.empty((count, KEY_BYTES), dtype=np.uint8)
        combinations, which = np.unique(codes, axis=0, return_inverse=True)
        which = which.reshape(-1)
        columns = self._columns(inputs)
        for place, combination in enumerate(combinations):
            rows = np.flatnonzero(which == place)
            some = [column[rows] for column in columns]
            base = self._base(tuple(int(code) for code in combination))
            found[rows] = base.keys(some, len(rows))
        return found

    def _columns(self, inputs: Inputs) -> list[NDArray[np.float64]]:
        return [np.asarray(inputs[entry.key.name], dtype=np.float64) for entry in self._numbers]

    def _base(self, words: Words) -> _Base:
        """What all rows with the same words share."""
        base = self._bases.get(words)
        if base is None:
            if len(self._bases) >= _MOST_BASES:
                self._bases.clear()
            base = self._bases[words] = self._made(words)
        return base

    def _made(self, words: Words) -> _Base:
        """Words of a combination put together from those of its axes one by one."""
        values = self._of(tuple(0 for _ in words))
        if values is not None:
            for place, code in enumerate(words):
                path = self._words[place].key.path
                alone = self._of(
                    tuple(code if place == other else 0 for other in range(len(words)))
                )
                if alone is None:
                    values = None
                    break
                values = values.without(path).plus(alone.below(path))
        if values is None:
            # A design that its schema refuses: what the study says of it is all there is.
            said = [*self._said, self._assigned(words)]
            values = ResolvedValues({}, {("refused",): canonical(said)})
        return _Base(self._asked, values, self._numbers)

    def _assigned(self, words: Words) -> dict[str, YamlValue]:
        return {
            entry.key.name: entry.assigned(code)
            for entry, code in zip(self._words, words, strict=True)
        }

    def _of(self, words: Words) -> ResolvedValues | None:
        """Resolved values with these words; None for a design that its schema refuses."""
        if words not in self._resolved:
            self._resolved[words] = self._read(words)
        return self._resolved[words]

    def _read(self, words: Words) -> ResolvedValues | None:
        maker, assigned = maker_of(self._study), self._assigned(words)
        try:
            found = resolved_values(maker.file(assigned))
            # A number that the design has stands for all: each row replaces it.
            missing = [
                entry
                for entry in self._numbers
                if entry.kind is not None or entry.key.path not in found.numbers
            ]
            for entry in missing:
                number = 0.0 if entry.values is None else float(entry.values[0])
                assigned[entry.key.name] = entry.key.written(number, entry.kind)
            return resolved_values(maker.file(assigned)) if missing else found
        except InputError:
            return None


class _Base:
    """A hash over all that rows share, and the places of the numbers that they do not."""

    def __init__(self, asked: str, values: ResolvedValues, varied: Sequence[InputKey]) -> None:
        paths = {entry.key.path for entry in varied}
        numbers = {**dict.fromkeys(paths, 0.0), **values.numbers}
        order = sorted(numbers, key=dotted)
        words = plain_values(ResolvedValues({}, values.words))[1]
        text = canonical([asked, words, [dotted(path) for path in order]])
        self._shared = hashlib.sha256(text.encode())
        self._numbers = np.array([numbers[path] for path in order])
        self._places = [order.index(entry.key.path) for entry in varied]

    def keys(self, columns: Sequence[NDArray[np.float64]], count: int) -> NDArray[np.uint8]:
        """Keys of rows, shape (n, 16), from their numbers in the order of the varied keys."""
        packed = np.tile(self._numbers, (count, 1))
        for place, column in zip(self._places, columns, strict=True):
            packed[:, place] = column
        packed += 0.0  # -0 is 0
        content, width = packed.astype("<f8").tobytes(), packed.shape[1] * 8
        digests = []
        for row in range(count):
            hashed = self._shared.copy()
            hashed.update(content[row * width : (row + 1) * width])
            digests.append(hashed.digest()[:KEY_BYTES])
        return np.frombuffer(b"".join(digests), dtype=np.uint8).reshape(count, KEY_BYTES)


def asked_of_rows(study: Study, outputs: Sequence[str]) -> dict[str, object]:
    """What is asked of every row of a study: columns, points, a fixed header, files.

    Limits are none of it: what a row holds is the same, and who finds it again judges it anew.
    """
    asked: dict[str, object] = {
        "outputs": sorted(outputs),
        "points": sorted(
            [bound.output, list(bound.point)]
            for bound in (*study.limits, *study.accept)
            if bound.point
        ),
        "files": [[name, _sha(content)] for name, content in study.named],
    }
    if study.header:
        files = [[name, _sha(content)] for name, content in study.header_files]
        # One that is made now follows from the design without its tolerances.
        asked["header"] = files or _nominal(study)
    return asked


def _nominal(study: Study) -> object:
    """The design that a header of now is made of."""
    values = resolved_values(maker_of(study).file({}))
    return canonical(plain_values(values))


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def row_keys(study: Study, inputs: Inputs, outputs: Sequence[str]) -> NDArray[np.uint8]:
    """Keys of the rows of a study, shape (n, 16).

    Args:
        study: The study.
        inputs: What goes into its rows, as `row_inputs` or a search gives it.
        outputs: Names of its columns.
    """
    keys = _KEYS.of(study)
    known = keys.get(tuple(sorted(outputs)))
    if known is None:
        known = keys[tuple(sorted(outputs))] = RowKeys(study, outputs)
    return known.of(inputs)


def _none(_: Study) -> dict[tuple[str, ...], RowKeys]:
    return {}


_KEYS = Recent(_none)


# From the index of a row to what goes into it: the values of all keys that vary or are drawn.
#
# Rows are the points of the grid, the last axis quickest; where something is drawn, each point has
# ``draw.count`` rows, and every point has the same draws: its machines are those of its neighbours.

# By key, shape (n,): numbers in SI units, or places in the words of its `ColumnSpec`.
Inputs = Mapping[str, FloatArray | NDArray[np.int32]]


@dataclass(frozen=True, slots=True, eq=False)
class InputKey:
    """A key whose value differs between rows.

    Args:
        key: What stands there in a design.
        spec: Its column.
        steps: Values of its axis as a design file writes them, empty where it is drawn.
        values: Of each step the number in SI units, or the place of its word in ``spec.choices``.
        kind: Convention that the values of the study name (``line-to-line``), None for that of the
            design.
    """

    key: DesignKey
    spec: ColumnSpec
    steps: tuple[YamlValue, ...] = ()
    values: FloatArray | NDArray[np.int32] | None = None
    kind: str | None = None

    def assigned(self, value: float) -> YamlValue:
        """What a design file says for a number in SI units, or for the place of a word."""
        if self.spec.kind == "number":
            return self.key.written(float(value), self.kind)
        places = [] if self.values is None else list(self.values)
        return self.steps[places.index(value)]


def _input_keys(study: Study) -> tuple[InputKey, ...]:
    found = [_of_axis(axis, place) for axis in study.axes for place in range(len(axis.keys))]
    for tolerance in study.tolerances:
        key = _known(tolerance.key)
        found.append(InputKey(key, ColumnSpec(INPUT_COLUMN + tolerance.key, key.unit)))
    return tuple(found)


_ROW_INPUTS_KEYS = Recent(_input_keys)


def input_keys(study: Study) -> tuple[InputKey, ...]:
    """Keys that differ between rows: those of the axes in their order, then those drawn."""
    return _ROW_INPUTS_KEYS.of(study)


def input_columns(study: Study) -> tuple[ColumnSpec, ...]:
    """Their columns."""
    return tuple(entry.spec for entry in input_keys(study))


def row_inputs(study: Study, first: int, end: int) -> Inputs:
    """What goes into rows first to end - 1 of a study on a grid, by key.

    Args:
        study: With axes, tolerances or neither.
        first, end: Range of rows, 0 <= first <= end <= `row_count`.
    """
    rows = np.arange(first, end, dtype=np.int64)
    draws = 1 if study.draw is None else study.draw.count
    places = np.unravel_index(
        rows // draws, tuple(len(axis.steps) for axis in study.axes) or (grid_rows(study),)
    )
    found: dict[str, FloatArray | NDArray[np.int32]] = {}
    entries = iter(input_keys(study))
    for axis, place in zip(study.axes, places, strict=False):
        for _ in axis.keys:
            entry = next(entries)
            if entry.values is not None:
                found[entry.key.name] = entry.values[place]
    if study.draw is not None:
        found |= _drawn(study, first, end)
    return found


def chosen_inputs(study: Study, points: FloatArray) -> Inputs:
    """What goes into rows that a search chose, by key.

    Args:
        study: With axes alone.
        points: One column per axis, shape (n, A): numbers in SI units where it is continuous, else
            the places of its steps.
    """
    found: dict[str, FloatArray | NDArray[np.int32]] = {}
    entries = iter(input_keys(study))
    for axis, column in zip(study.axes, points.T, strict=True):
        for _ in axis.keys:
            entry = next(entries)
            if axis.continuous:
                found[entry.key.name] = column.copy()
            elif entry.values is not None:
                found[entry.key.name] = entry.values[column.astype(np.intp)]
    return found


def row_assignments(study: Study, inputs: Inputs, place: int) -> dict[str, YamlValue]:
    """Keys of one row as `design_of` takes them.

    Args:
        study: The study.
        inputs: As `row_inputs`, or chosen by a search.
        place: Of the row in them.
    """
    return {
        entry.key.name: entry.assigned(inputs[entry.key.name][place]) for entry in input_keys(study)
    }


def _drawn(study: Study, first: int, end: int) -> dict[str, FloatArray]:
    """Drawn values of rows first to end - 1; each point of the grid begins with the first draw."""
    draw = study.draw
    if draw is None or first == end:
        return {tolerance.key: np.empty(0) for tolerance in study.tolerances}
    pieces = []
    while first < end:
        begin = first % draw.count
        count = min(end - first, draw.count - begin)
        pieces.append(
            draw_values(draw, study.tolerances, begin, begin + count, saltelli=study.saltelli)
        )
        first += count
    return {key: np.concatenate([piece[key] for piece in pieces]) for key in pieces[0]}


def _known(name: str) -> DesignKey:
    key = design_key(name)
    if key is None:
        raise InputError(f"{name}: no such key in a design")
    return key


def _of_axis(axis: Axis, place: int) -> InputKey:
    """One key of an axis: numbers, or words in sorted order."""
    key = _known(axis.keys[place])
    steps = tuple(step[place] for step in axis.steps)
    name = INPUT_COLUMN + key.name
    if axis.numbers:
        _, kind = key.number(steps[0])
        numbers = np.array([step[place] for step in axis.numbers])
        return InputKey(key, ColumnSpec(name, key.unit), steps, numbers, kind)
    labels = labels_of(steps)
    choices = tuple(sorted(set(labels)))
    codes = np.array([choices.index(label) for label in labels], dtype=np.int32)
    return InputKey(key, ColumnSpec(name, "", "choice", choices), steps, codes)


def labels_of(steps: tuple[YamlValue, ...]) -> tuple[str, ...]:
    """What tables call the values of an axis: their one word, or all of them where that leaves
    open which is meant.
    """
    short = tuple(_short(step) for step in steps)
    distinct = {json.dumps(step, sort_keys=True) for step in steps}
    return short if len(set(short)) == len(distinct) else tuple(_long(step) for step in steps)


def _short(value: YamlValue) -> str:
    if isinstance(value, dict):
        for key in ("name", "file"):
            if isinstance(value.get(key), str):
                return str(value[key])
    if isinstance(value, list) and len(value) == 1:
        return _short(value[0])
    return _long(value)


def _long(value: YamlValue) -> str:
    return (
        value if isinstance(value, str) else json.dumps(value, sort_keys=True, ensure_ascii=False)
    )


# Drawn values of a study: row k of a key depends on the seed, the key and k alone.
#
# A batch may begin anywhere, a longer study keeps its rows, and with ``random`` sampling another
# key leaves the others as they are. Points of a Sobol sequence are those of all drawn keys
# together.

_PER_STEP = 4  # Numbers of 64 bits that Philox gives for one step of its counter.
_STEP = 0.5**53
# Random numbers lie in the middle of steps of this width, so that none is 0 or 1.
_HALF = 0.5 * _STEP

# What the library's forward jump can do; a point lies in the middle of its step here, too.
_BITS = np.uint64(11)
_BITS_OF_SOBOL = 32


def draw_values(
    draw: Draw, tolerances: Sequence[Tolerance], first: int, end: int, *, saltelli: bool = False
) -> dict[str, FloatArray]:
    """Values of every drawn key in SI units, shape (end - first,), for draws first to end - 1.

    With ``saltelli`` they are those of a design for sensitivities, keys in alphabetical order.
    """
    keys = [tolerance.key for tolerance in tolerances]
    if saltelli:
        shares = _saltelli_shares(draw, keys, first, end)
    else:
        shares = draw_shares(draw, keys, first, end)
    return {tolerance.key: values_at(tolerance, shares[tolerance.key]) for tolerance in tolerances}


def draw_shares(draw: Draw, keys: Sequence[str], first: int, end: int) -> dict[str, FloatArray]:
    """Shares of the distribution below each value, uniform in (0, 1), by key, shape (end - first,).

    Correlated keys are so in their normal scores; without correlations keys are independent.
    """
    ordered = sorted(keys)
    if draw.sampling == "sobol":
        points = _sobol(draw.seed, len(ordered), first, end)
        shares = {key: points[:, place] for place, key in enumerate(ordered)}
    else:
        shares = {key: _philox(draw.seed, key, first, end) for key in ordered}
    return shares | _correlated(draw, shares) if draw.correlations else shares


def _saltelli_shares(
    draw: Draw, keys: Sequence[str], first: int, end: int
) -> dict[str, FloatArray]:
    """Shares as `draw_shares`, of rows whose base rows are points of a Sobol sequence."""
    ordered = sorted(keys)
    base, which = saltelli_places(first, end, len(ordered))
    begin, last = int(base[0]), int(base[-1])
    points = _sobol(draw.seed, 2 * len(ordered), begin, last + 1)
    shares = saltelli_inputs(points[base - begin], which)
    return {key: shares[:, place] for place, key in enumerate(ordered)}


def _philox(seed: int, key: str, first: int, end: int) -> FloatArray:
    """Uniform numbers first to end - 1 of the stream of a key."""
    stream = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "little")
    # The high word of the key of the generator is the stream, the low one the seed.
    generator = np.random.Philox(key=(stream << 64) | seed)
    step, over = divmod(first, _PER_STEP)
    generator.advance(step)
    raw = np.asarray(generator.random_raw(end - first + over), dtype=np.uint64)[over:]
    return (raw >> _BITS).astype(np.float64) * _STEP + _HALF


def _sobol(seed: int, count: int, first: int, end: int) -> FloatArray:
    """Points of a scrambled Sobol sequence, shape (end - first, count)."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(count, scramble=True, rng=np.random.default_rng(seed), bits=_BITS_OF_SOBOL)
    with warnings.catch_warnings():
        # That the number of points is no power of 2 is meant: a study takes them in batches.
        warnings.simplefilter("ignore", UserWarning)
        if first:
            sequence.fast_forward(first)
        points = np.asarray(sequence.random(end - first), dtype=np.float64)
    return points + 0.5 ** (_BITS_OF_SOBOL + 1)


def _correlated(draw: Draw, shares: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Shares of the keys that correlations name, by Cholesky's factor on their normal scores."""
    from scipy.special import ndtr, ndtri

    found: dict[str, FloatArray] = {}
    for keys in _groups(draw):
        matrix = np.eye(len(keys))
        for one, other, rho in draw.correlations:
            if one in keys:
                places = keys.index(one), keys.index(other)
                matrix[places] = matrix[places[::-1]] = rho
        factor = np.linalg.cholesky(matrix)
        scores = [ndtri(shares[key]) for key in keys]
        for place, key in enumerate(keys[1:], 1):
            # Summed term by term: a product of matrices depends on the number of rows.
            mixed = sum(factor[place, other] * scores[other] for other in range(place + 1))
            found[key] = np.clip(ndtr(mixed), _HALF, 1.0 - _STEP)
    return found


def _groups(draw: Draw) -> list[list[str]]:
    """Keys that hang together by correlations, each group and all groups in alphabetical order."""
    groups: list[set[str]] = []
    for one, other, _ in draw.correlations:
        joined = {one, other}
        apart = []
        for group in groups:
            if group & joined:
                joined |= group
            else:
                apart.append(group)
        groups = [*apart, joined]
    return sorted(sorted(group) for group in groups)


def values_at(tolerance: Tolerance, share: FloatArray) -> FloatArray:
    """Values in SI units below which a share of the distribution lies, shape of ``share``."""
    if tolerance.kind == "between":
        return tolerance.low + share * (tolerance.high - tolerance.low)
    scale = tolerance.width * (tolerance.centre if tolerance.relative else 1.0)
    if tolerance.kind == "uniform":
        return tolerance.centre + scale * (2.0 * share - 1.0)
    from scipy.special import ndtr, ndtri

    below = float(ndtr(-tolerance.cut))
    score = np.asarray(ndtri(below + share * (1.0 - 2.0 * below)), dtype=np.float64)
    return tolerance.centre + scale * np.clip(score, -tolerance.cut, tolerance.cut)


# Rows that are made for sensitivities: two samples, and each column of one within the other.
#
# Base row k of samples A and B makes D + 2 rows: A, B, and A with each column of B in its turn
# (Saltelli and others 2010, doi:10.1016/j.cpc.2009.09.018).


def saltelli_places(first: int, end: int, inputs: int) -> tuple[IndexArray, IndexArray]:
    """Where rows of the design come from: for each row its row of the base samples, and which
    sample it is of, 0 for A, 1 for B and 2 + i for A with column i of B; shape (end - first,).

    Row k belongs to base row k // (D + 2), so that a longer study begins with the same rows.

    Args:
        first, end: Rows first to end - 1.
        inputs: Number of inputs D.
    """
    rows = np.arange(first, end, dtype=np.intp)
    return rows // (inputs + 2), rows % (inputs + 2)


def saltelli_inputs(sample: FloatArray, which: IndexArray) -> FloatArray:
    """Shares of the distributions for rows of the design, shape (n, D).

    Args:
        sample: For each row the numbers in (0, 1) of its base row, those of A and then those of B,
            shape (n, 2 D).
        which: Which sample each row is of, as `saltelli_places` gives it.
    """
    inputs = sample.shape[1] // 2
    from_b = (which[:, np.newaxis] == 1) | (which[:, np.newaxis] == 2 + np.arange(inputs))
    return np.where(from_b, sample[:, inputs:], sample[:, :inputs])


# Whether values keep the bounds that a study sets them.

# Share of a bound by which a value may lie beyond it and counts as within: machines differ in the
# last digits, and are to agree.
VERDICT_MARGIN = 1e-9


def within(values: FloatArray, below: float | None, above: float | None) -> BoolArray:
    """Whether values keep their bounds, any shape; what is no number does not.

    Args:
        values: In SI units.
        below, above: Bounds in SI units, None where there is none.
    """
    kept = ~np.isnan(values)
    if below is not None:
        kept &= values <= below + VERDICT_MARGIN * abs(below)
    if above is not None:
        kept &= values >= above - VERDICT_MARGIN * abs(above)
    return np.asarray(kept)
