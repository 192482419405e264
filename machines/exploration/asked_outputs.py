"""What a study asks of outputs: columns, limits, what counts as good, goals.

Which outputs a design has is not known here; the kind of quantity of a name is, so that limits are
read with their units.
"""

from __future__ import annotations

from typing import get_args

from dqforge.machines.entries.rules import not_one_of, spoken
from dqforge.machines.exploration.study import Bound, Goal
from dqforge.machines.exploration.study_entries import complaint, mapping_at, quantity_at
from dqforge.machines.exploration.study_schema import StudyFile
from dqforge.machines.files.positioned_yaml import YamlDocument, YamlValue
from dqforge.machines.names import ModulationName
from dqforge.machines.places import KeyPath
from dqforge.machines.units.registry import DIMENSIONS

# Kind of quantity by the last part of an output's name.
_DIMENSION = {
    "torque_max": "torque",
    "torque": "torque",
    "torque_made": "torque",
    "i_d": "current",
    "i_q": "current",
    "ripple_current": "current",
    "capacitor_current": "current",
    "voltage": "voltage",
    "voltage_error": "voltage",
    "phase_margin": "angle",
    "delay_margin": "time",
    "crossover": "bandwidth",
    "junction_temperature": "temperature",
    "diode_temperature": "temperature",
    "winding_temperature": "temperature",
}

_POINT = ("torque", "speed", "modulation")
_SIDES = ("below", "above")


def dimension_of(output: str) -> str:
    """Kind of quantity of an output; a plain number where nothing is known of the name."""
    first, last = output.partition(".")[0], output.rpartition(".")[2]
    if last in _DIMENSION:
        return _DIMENSION[last]
    of_losses = first == "losses" and last not in ("modulation", "strategy")
    return "power" if of_losses or output == "fit.error.loss" else "number"


def read_bounds(document: YamlDocument, section: str) -> tuple[Bound, ...]:
    """The section ``limits`` or ``accept``, in the order of the names.

    Raises:
        InputError: A bound has another unit than its output, or bounds nothing.
    """
    given = document.data.get(section, {})
    found = [
        _bound(document, (section, name), entry)
        for name, entry in (given.items() if isinstance(given, dict) else ())
    ]
    return tuple(sorted(found, key=lambda bound: bound.output))


def _bound(document: YamlDocument, path: KeyPath, entry: YamlValue) -> Bound:
    output = str(path[-1])
    dimension = dimension_of(output)
    unit = DIMENSIONS[dimension].unit
    if not isinstance(entry, dict):
        if isinstance(entry, list):
            raise complaint(document, path, "expected a limit, got a list; write {below: ...}")
        return Bound(output, below=quantity_at(document, path, dimension, entry), unit=unit)
    example = f"{{below: {DIMENSIONS[dimension].example}}}"
    mapping_at(document, path, entry, (*_SIDES, "point"), example)
    sides = {
        side: quantity_at(document, (*path, side), dimension, entry[side])
        for side in _SIDES
        if side in entry
    }
    if not sides:
        raise complaint(document, path, f"needs below or above; write {example}", key=True)
    if len(sides) == 2 and not sides["above"] < sides["below"]:
        raise complaint(
            document, (*path, "above"), "nothing lies above this and below the other; exchange them"
        )
    point = _point(document, (*path, "point"), entry["point"]) if "point" in entry else None
    if point is not None and not output.startswith("losses."):
        raise complaint(
            document, (*path, "point"), "goes with losses; this output has no points", key=True
        )
    return Bound(output, sides.get("below"), sides.get("above"), point, unit)


def _point(document: YamlDocument, path: KeyPath, entry: YamlValue) -> tuple[float, float, str]:
    """Torque in N m, speed in rad/s and modulator of an operating point."""
    example = "{torque: 130 N m, speed: 300 rad/s}"
    given = mapping_at(document, path, entry, _POINT, example)
    for name in ("torque", "speed"):
        if name not in given:
            raise complaint(document, path, f"needs the key '{name}'; write {example}", key=True)
    modulation = given.get("modulation", "")
    if modulation and modulation not in get_args(ModulationName):
        message = not_one_of(modulation, get_args(ModulationName))
        raise complaint(document, (*path, "modulation"), message)
    torque = quantity_at(document, (*path, "torque"), "torque", given["torque"])
    speed = quantity_at(document, (*path, "speed"), "speed", given["speed"])
    return torque, speed, str(modulation)


def read_goals(document: YamlDocument, file: StudyFile) -> tuple[Goal, ...]:
    """Goals of ``pareto``, those to be small first.

    Raises `InputError` where there is none, or an output is there twice.
    """
    if file.pareto is None:
        return ()
    goals: list[Goal] = []
    for section, names in (("minimise", file.pareto.minimise), ("maximise", file.pareto.maximise)):
        for index, name in enumerate(names):
            if any(goal.output == name for goal in goals):
                raise complaint(
                    document, ("pareto", section, index), f"'{name}' is there twice; remove one"
                )
            goals.append(Goal(name, minimise=section == "minimise"))
    if not goals:
        raise complaint(document, ("pareto",), "needs minimise or maximise", key=True)
    return tuple(goals)


def check_names(document: YamlDocument, section: str, names: tuple[str, ...]) -> None:
    """Refuse an output that a list names twice; raises `InputError`."""
    for index, name in enumerate(names):
        if name in names[:index]:
            message = f"{spoken(name)} is there twice; remove one"
            raise complaint(document, (section, index), message)
