"""Parts of a study that must not contradict each other."""

from __future__ import annotations

from math import prod

from dqforge.machines.exploration.design_keys import design_key
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_entries import complaint
from dqforge.machines.exploration.study_schema import MOST_ROWS
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.places import KeyPath


def check_overlaps(document: YamlDocument, study: Study) -> None:
    """Refuse two settings of one key, or of a key and a part of it.

    A key that is set may be drawn round its value, and parts of it may vary. Raises `InputError`.
    """
    settings = [("set", key) for key, _ in study.sets]
    settings += [("vary", key) for axis in study.axes for key in axis.keys]
    settings += [("tolerances", tolerance.key) for tolerance in study.tolerances]
    paths = [_path(key) for _, key in settings]
    for index, (section, key) in enumerate(settings):
        for before, (other_section, other) in enumerate(settings[:index]):
            mine, theirs = paths[index], paths[before]
            length = min(len(mine), len(theirs))
            if mine[:length] != theirs[:length]:
                continue
            around = len(theirs) < len(mine)
            again = section == "tolerances" and mine == theirs
            if other_section == "set" != section and (around or again):
                continue
            what = "sets it as well" if mine == theirs else "sets a part of it, or all of it"
            message = f"{other_section}.{other} {what}; leave one of the two out"
            raise complaint(document, place_of(document, section, key), message, key=True)


def _path(key: str) -> KeyPath:
    found = design_key(key)
    return () if found is None else found.path


def place_of(document: YamlDocument, section: str, key: str) -> KeyPath:
    """Where a key stands in a section, in step with others or not."""
    for path in document.keys:
        if path[0] == section and path[-1] == key:
            return path
    return (section,)


def check_search(document: YamlDocument, study: Study) -> None:
    """Refuse a search without goals or without anything to search in; raises `InputError`."""
    search = study.search
    if search is None:
        return
    path: KeyPath = ("search",)
    if not study.goals:
        raise complaint(document, path, "needs goals; write pareto: {minimise: [...]}", key=True)
    if search.method == "nlopt" and len(study.goals) != 1:
        raise complaint(
            document,
            (*path, "method"),
            f"nlopt has one goal, pareto has {len(study.goals)}; write nsga2",
        )
    if not study.axes:
        raise complaint(document, path, "needs keys to search in; write vary", key=True)
    listed = next((axis for axis in study.axes if not axis.continuous), None)
    if search.method == "nlopt" and listed is not None:
        keys = " and ".join(listed.keys)
        raise complaint(
            document,
            (*path, "method"),
            f"nlopt searches ranges of single keys, which {keys} is not; write a range, or nsga2",
        )
    if study.tolerances:
        raise complaint(
            document, path, "a search draws nothing; remove tolerances, or search", key=True
        )


def check_sensitivity(document: YamlDocument, study: Study) -> None:
    """Refuse sensitivities where nothing is drawn; raises `InputError`."""
    if study.sensitivity and not study.tolerances:
        raise complaint(
            document,
            ("sensitivity",),
            "nothing is drawn that an output could depend on; write tolerances and draw",
            key=True,
        )


def grid_rows(study: Study) -> int:
    """Points of the grid."""
    return prod(len(axis.steps) for axis in study.axes)


def row_count(study: Study) -> int:
    """Rows of a study: those of its search, or of its grid times what is drawn."""
    if study.search is not None:
        return study.search.population * study.search.generations
    return grid_rows(study) * (1 if study.draw is None else study.draw.count)


def check_size(document: YamlDocument, study: Study) -> None:
    """Refuse more rows than are taken; raises `InputError`."""
    rows = row_count(study)
    if rows <= MOST_ROWS:
        return
    most, found = (
        f"{each:.2g}".replace("e+", "e").replace("e0", "e") for each in (MOST_ROWS, rows)
    )
    if found == most:
        found = f"{rows:,}"
    what = "the search" if study.search is not None else "the grid"
    section = "search" if study.search is not None else "vary" if study.axes else "draw"
    raise document.error(
        f"{what} has {found} rows; explore takes at most {most}; {_shorter(study)}",
        (section,),
        key=True,
    )


def _shorter(study: Study) -> str:
    """What to write for fewer rows."""
    if study.search is not None:
        return "write a smaller population, or fewer generations"
    if study.draw is None:
        return "write fewer values, or draw: {count: 100000, seed: 1}"
    return "write fewer values, or a smaller draw.count"
