"""Keys of rows: what a row is, as a hash, however the study that asks for it is written.

The hash is over the version of the program, over what is asked of every row, over the words of the
resolved design by their paths, and over its numbers in SI units in the order of their paths. Which
of the keys vary is no part of it: the same design in another study has the same key.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.exploration.recent import Recent
from dqforge.machines.exploration.resolved_values import ResolvedValues, resolved_values
from dqforge.machines.exploration.row_designs import maker_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_digest import canonical, plain_values
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.places import dotted
from dqforge.optimizer.exploration.row_block import KEY_BYTES
from dqforge.optimizer.exploration.row_inputs import InputKey, Inputs, input_keys

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
