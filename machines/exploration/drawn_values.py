"""The sections ``tolerances`` and ``draw`` of a study: what is drawn, and how often."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.machine.magnet_flux import FLUX_KEYS
from dqforge.machines.entries.rules import Quantity, spoken
from dqforge.machines.entries.two_sided import Between
from dqforge.machines.exploration.design_keys import DesignKey, design_key
from dqforge.machines.exploration.study import Draw, Tolerance
from dqforge.machines.exploration.study_entries import (
    complaint,
    known_key,
    mapping_at,
    number_at,
    only_one,
    share_of,
)
from dqforge.machines.exploration.study_schema import StudyFile
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.places import KeyPath
from dqforge.machines.wording import shown

_KINDS = ("normal", "uniform", "between")
_SECTION = "tolerances"
_EXAMPLE = "{normal: 5 %}"

# Keys of a design that its ``control.tolerances`` are about.
_BOX: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("r_s", ("machine.resistance",)),
    ("l_d", ("machine.inductance_d",)),
    ("l_q", ("machine.inductance_q",)),
    ("psi_pm", tuple(f"machine.{key}" for key in FLUX_KEYS)),
    ("inertia", ("machine.inertia",)),
    ("v_dc", ("inverter.v_dc",)),
)

# Value of the design at a key in SI units, None where it has none.
ValueOf = Callable[[DesignKey], float | None]


def read_tolerances(
    document: YamlDocument, file: DesignFile, value_of: ValueOf
) -> tuple[Tolerance, ...]:
    """What is drawn, in the order of the keys.

    Args:
        document: The study file.
        file: The design that it starts from, with what the study sets.
        value_of: Its value at a key.

    Raises:
        InputError: A key is none of a design, or has no distribution; a width is of another unit,
            or negative.
    """
    section = document.data.get(_SECTION, {})
    path: KeyPath = (_SECTION,)
    if section == "design":
        section = {"design": "uniform"}
    elif not isinstance(section, dict):
        message = f"expected keys of the design, or the word design, got {spoken(section)}"
        raise complaint(document, path, message)
    drawn = {}
    if "design" in section:
        if section["design"] != "uniform":
            message = f"expected uniform, got {spoken(section['design'])}"
            raise complaint(document, (*path, "design"), message)
        drawn = {found.key: found for found in _box(document, file, value_of)}
    for name, entry in section.items():
        if name != "design":
            drawn[name] = _tolerance(document, (*path, name), entry, value_of)
    return tuple(drawn[name] for name in sorted(drawn))


def _box(document: YamlDocument, file: DesignFile, value_of: ValueOf) -> list[Tolerance]:
    """Uniform distributions over the box of the design's own tolerances."""
    path: KeyPath = (_SECTION, "design") if (_SECTION, "design") in document.keys else (_SECTION,)
    given = file.control.tolerances
    if given is None:
        raise complaint(
            document, path, "the design has no control.tolerances; write the keys here", key=True
        )
    found = []
    for name, choices in _BOX:
        deviation = getattr(given, name)
        if deviation is None:
            continue
        at = next(
            ((key, value) for key in choices if (value := _value(key, value_of)) is not None), None
        )
        if at is None:
            raise complaint(
                document,
                path,
                f"control.tolerances.{name} has no key to draw: the design has no {choices[0]}",
                key=True,
            )
        found.append(_deviation(deviation, *at))
    if not found:
        raise complaint(
            document, path, "control.tolerances of the design have no key to draw", key=True
        )
    return found


def _value(name: str, value_of: ValueOf) -> float | None:
    key = design_key(name)
    return None if key is None else value_of(key)


def _deviation(deviation: Quantity | Between, name: str, centre: float) -> Tolerance:
    if isinstance(deviation, Between):
        ends = sorted(centre * (1.0 + side.si) for side in (deviation.low, deviation.high))
        return Tolerance(name, "between", low=ends[0], high=ends[1], centre=centre)
    return Tolerance(name, "uniform", width=deviation.si, centre=centre)


def _tolerance(
    document: YamlDocument, path: KeyPath, entry: YamlValue, value_of: ValueOf
) -> Tolerance:
    """One key that is drawn."""
    key = known_key(document, path)
    if key.sort not in ("quantity", "real"):
        what = {"word": "a word", "count": "a whole number", "whole": "a whole number"}
        name = what.get(key.sort, "a list" if key.listed else "a section")
        raise complaint(
            document, path, f"{name} has no distribution; write values: [...] under vary", key=True
        )
    given = mapping_at(document, path, entry, (*_KINDS, "cut"), _EXAMPLE)
    kind = only_one(document, path, given, _KINDS)
    if "cut" in given and kind != "normal":
        raise complaint(document, (*path, "cut"), "goes with normal", key=True)
    centre = value_of(key)
    if kind == "between":
        return _between(document, (*path, kind), key, given[kind], centre)
    width, relative = _width(document, (*path, kind), key, given[kind])
    if centre is None or (relative and centre == 0.0):
        lack = "has no value in" if centre is None else "is 0 in"
        raise complaint(
            document,
            path,
            f"{key.name} {lack} the design, so that there is nothing to deviate from; write "
            "between: [..., ...]",
            key=True,
        )
    found = Tolerance(key.name, "uniform", width, relative, centre=centre)
    if kind == "uniform":
        return found
    return replace(found, kind="normal", cut=_cut(document, (*path, "cut"), given.get("cut", 3.0)))


def _cut(document: YamlDocument, path: KeyPath, value: YamlValue) -> float:
    """Standard deviations at which a normal distribution ends."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise complaint(
            document, path, f"expected a number of standard deviations, got {spoken(value)}"
        )
    if not 0.1 <= value <= 8.0:
        raise complaint(document, path, f"expected 0.1 to 8, got {spoken(value)}; write e.g. 3")
    return float(value)


def _width(
    document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue
) -> tuple[float, bool]:
    """Width of a distribution, and whether it is a share of the design's value."""
    share = share_of(value)
    if share is not None:
        width, relative = share, True
    else:
        if key.dimension == "temperature" and isinstance(value, str):
            # A difference: 5 K are not -268 degC.
            value = value.strip().removesuffix("degC").removesuffix("°C").removesuffix("K").strip()
        width, relative = number_at(document, path, key, value)[0], False
    if width < 0.0:
        raise complaint(document, path, f"{shown(value)} is negative; write a positive width")
    if width == 0.0:
        raise complaint(document, path, "nothing is drawn of a width of 0; remove the key")
    if relative and width > 10.0:
        raise complaint(document, path, f"{shown(value)} is more than 1000 %; check the number")
    return width, relative


def _between(
    document: YamlDocument, path: KeyPath, key: DesignKey, value: YamlValue, centre: float | None
) -> Tolerance:
    """``between: [low, high]``; shares are of the design's value."""
    if not isinstance(value, list) or len(value) != 2:
        raise complaint(
            document, path, f"expected two ends, got {spoken(value)}; write [low, high]"
        )
    ends = []
    for index, end in enumerate(value):
        place, share = (*path, index), share_of(end)
        if share is None:
            ends.append(number_at(document, place, key, end)[0])
        elif centre is None or centre == 0.0:
            message = (
                f"a share needs a value of {key.name} in the design; write both ends as values"
            )
            raise complaint(document, place, message)
        else:
            ends.append(centre * (1.0 + share))
    low, high = ends
    if not low < high:
        raise complaint(document, path, "the first end is not below the second; exchange them")
    return Tolerance(key.name, "between", low=low, high=high, centre=centre or 0.0)


def read_draw(
    document: YamlDocument, file: StudyFile, tolerances: Sequence[Tolerance]
) -> Draw | None:
    """How often is drawn, None where nothing is.

    Raises:
        InputError: One of ``tolerances`` and ``draw`` is missing, or correlations contradict each
            other.
    """
    if file.draw is None:
        if tolerances:
            raise complaint(
                document,
                (_SECTION,),
                "nothing says how many are drawn; write draw: {count: 100000, seed: 1}",
                key=True,
            )
        return None
    if not tolerances:
        raise complaint(
            document, ("draw",), "nothing is drawn; write tolerances, or remove draw", key=True
        )
    names = [tolerance.key for tolerance in tolerances]
    triples: list[tuple[str, str, float]] = []
    for index, pair in enumerate(file.draw.correlations):
        path: KeyPath = ("draw", "correlations", index)
        for part, name in enumerate(pair.keys):
            if name not in names:
                raise complaint(
                    document, (*path, "keys", part), f"'{name}' is not drawn; add it to tolerances"
                )
        one, other = sorted(pair.keys)
        if one == other or any(triple[:2] == (one, other) for triple in triples):
            message = "both keys are one" if one == other else "this pair is there twice"
            raise complaint(document, (*path, "keys"), message)
        triples.append((one, other, pair.rho))
    if triples and not _possible(names, triples):
        raise complaint(
            document,
            ("draw", "correlations"),
            "no numbers have these correlations together; make them smaller",
        )
    draw = file.draw
    return Draw(draw.count, draw.seed, draw.sampling, tuple(sorted(triples)))


def _possible(names: list[str], triples: Sequence[tuple[str, str, float]]) -> bool:
    """Whether the matrix of all correlations is positive definite."""
    matrix = np.eye(len(names))
    for one, other, rho in triples:
        places = names.index(one), names.index(other)
        matrix[places] = matrix[places[::-1]] = rho
    return bool(np.linalg.eigvalsh(matrix)[0] > 1e-9)
