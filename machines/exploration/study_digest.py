"""What a study asks as one mapping, and its digest: the same for every way to write it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import design_key
from dqforge.machines.exploration.resolved_values import ResolvedValues, resolved_values
from dqforge.machines.exploration.row_designs import DesignMaker
from dqforge.machines.exploration.study import Study
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.places import dotted


def canonical(value: object) -> str:
    """JSON with sorted keys and the shortest floats."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def study_digest(study: Study) -> str:
    """SHA-256 in hexadecimal of what decides the rows of a study and their order.

    A study with more rows behind the others has the same digest: how many are drawn counts only
    where there is a grid, and how many generations a search has, not at all.
    """
    asked = asked_of(study)
    if len(study.axes) == 0:
        asked.pop("draw.count", None)
    asked.pop("search.generations", None)
    return hashlib.sha256(canonical(asked).encode()).hexdigest()


def asked_of(study: Study) -> dict[str, Any]:
    """What a study asks by dotted keys, in SI units: to compare two studies, and to be written.

    Its name and text are left out.
    """
    maker = DesignMaker(study)
    asked: dict[str, Any] = {"design": _design(study, maker)}
    for name, content in study.named:
        asked[f"files.{name}"] = hashlib.sha256(content).hexdigest()
    for place, axis in enumerate(study.axes):
        steps = axis.numbers or [
            _step(study, maker, place, step) for step in range(len(axis.steps))
        ]
        # A grid is its steps; a search goes between the ends of a range as it is spaced.
        between = [axis.spacing] if study.search is not None else []
        asked[f"vary.{' and '.join(axis.keys)}"] = [place, [list(s) for s in steps], *between]
    for tolerance in study.tolerances:
        asked[f"tolerances.{tolerance.key}"] = asdict(tolerance)
    for section in ("draw", "search"):
        given = getattr(study, section)
        if given is not None:
            asked |= {f"{section}.{key}": value for key, value in asdict(given).items()}
    for section in ("limits", "accept"):
        for bound in getattr(study, section):
            asked[f"{section}.{bound.output}"] = asdict(bound)
    if study.header:
        asked["header"] = [
            [name, hashlib.sha256(content).hexdigest()] for name, content in study.header_files
        ] or study.header
    plain = {
        "outputs": study.outputs,
        "sensitivity": study.sensitivity,
        "pareto": [[goal.output, goal.minimise] for goal in study.goals],
    }
    return asked | {key: list(value) for key, value in plain.items() if value}


def _design(study: Study, maker: DesignMaker) -> str:
    """Digest of the design with what the study sets, less what varies."""
    assigned = {
        key: value
        for axis in study.axes
        for key, value in zip(axis.keys, axis.steps[0], strict=True)
    }
    values = _values(maker, assigned)
    if values is None:
        # Where the first row is none that a design may have, the text itself is what is asked.
        sets = canonical([list(pair) for pair in study.sets])
        return hashlib.sha256(study.design_text + sets.encode()).hexdigest()
    for name in assigned:
        key = design_key(name)
        values = values if key is None else values.without(key.path)
    return hashlib.sha256(canonical(plain_values(values)).encode()).hexdigest()


def _values(maker: DesignMaker, assigned: dict[str, YamlValue]) -> ResolvedValues | None:
    try:
        return resolved_values(maker.file(assigned))
    except InputError:
        return None


def _step(study: Study, maker: DesignMaker, place: int, step: int) -> list[Any]:
    """One step of an axis of words or sections."""
    axes = study.axes
    assigned = {
        key: value
        for index, axis in enumerate(axes)
        for key, value in zip(axis.keys, axis.steps[step if index == place else 0], strict=True)
    }
    values = _values(maker, assigned)
    return [_part(values, assigned, key) for key in axes[place].keys]


def _part(values: ResolvedValues | None, assigned: dict[str, YamlValue], name: str) -> Any:
    key = design_key(name)
    if values is None or key is None:
        return assigned[name]
    return plain_values(values.below(key.path))


def plain_values(values: ResolvedValues) -> list[Any]:
    """Numbers and words by their dotted paths, in the order of the paths."""
    numbers = {dotted(path): number for path, number in values.numbers.items()}
    words = {dotted(path): word for path, word in values.words.items()}
    return [sorted(numbers.items()), sorted(words.items(), key=lambda item: item[0])]
