"""Parts of a study that must not contradict each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from math import prod
from pathlib import Path
from typing import get_args

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import MAX_FILE_BYTES
from dqforge.machines.devices import catalogue as devices
from dqforge.machines.entries.former_keys import read_model
from dqforge.machines.entries.rules import not_one_of, spoken
from dqforge.machines.errors import InputError, KeyPath, Places, close_matches
from dqforge.machines.exploration.design_keys import (
    DesignKey,
    complaint,
    design_key,
    known_key,
    mapping_at,
    quantity_at,
    read_draw,
    read_tolerances,
)
from dqforge.machines.exploration.row_designs import (
    DesignMaker,
    read_axes,
    resolved_values,
    study_digest,
)
from dqforge.machines.exploration.study import (
    MOST_ROWS,
    Axis,
    Bound,
    Goal,
    Search,
    Study,
    StudyFile,
)
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.library_files import STUDIES
from dqforge.machines.files.positioned_yaml import (
    MAX_BYTES,
    YamlDocument,
    YamlValue,
    parse_yaml,
    read_bytes,
)
from dqforge.machines.names import ModulationName
from dqforge.machines.units.registry import DIMENSIONS


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


# Reading a study file: YAML, schema, keys of the design, what is drawn and asked, and whether
# any of its rows is a design.

_MOST_TRIED = 128  # Rows of which one must be a design.
_NAMES_FILES = frozenset({"file", "files", "psi_q_file", "torque_file", "mission"})


def read_study(path: str | Path) -> Study:
    """Study in a file.

    Raises:
        InputError: The file cannot be read, its content is wrong, or none of its rows is a design;
            with the position where there is one.
    """
    study = study_of_text(read_bytes(path), str(path), Path(path).parent)
    if study.places is None:
        return study
    # Messages of rows are stored: where the file lay when it was read is no part of them.
    return replace(study, places=replace(study.places, source=Path(path).name))


def study_of_text(text: bytes, source: str, folder: Path | None = None) -> Study:
    """Study in the bytes of a file.

    Args:
        text: Content, UTF-8.
        source: File name for messages.
        folder: Where the files lie that the study names; None where it may name none.

    Raises:
        InputError: As `read_study`.
    """
    document = _parsed(text, source)
    file = read_model(document, StudyFile)
    files = StudyFolder(folder, document)
    design_text, design_source = _design(file.design, files, document)
    study = Study(
        name=file.name,
        about=file.about,
        design_text=design_text,
        design_source=design_source,
        digest="",
        sets=_sets(document),
        axes=read_axes(document, files.listed),
        header=file.header or "",
        header_files=files.header(file.header),
        outputs=tuple(sorted(file.outputs)),
        limits=read_bounds(document, "limits"),
        accept=read_bounds(document, "accept"),
        goals=read_goals(document, file),
        sensitivity=file.sensitivity,
        search=_search(file),
        places=Places(source, document.keys, document.values, tuple(StudyFile.model_fields)),
    )
    for section in ("outputs", "sensitivity"):
        check_names(document, section, getattr(file, section))
    check_overlaps(document, study)
    maker = DesignMaker(study, files)
    places = _first_design(study, maker, files)
    first = maker.file(_assigned(study.axes, places))
    values = resolved_values(first)

    def value_of(key: DesignKey) -> float | None:
        return values.numbers.get(key.path)

    tolerances = read_tolerances(document, first, value_of)
    draw = read_draw(document, file, tolerances)
    study = replace(study, tolerances=tolerances, draw=draw)
    check_overlaps(document, study)
    check_search(document, study)
    check_sensitivity(document, study)
    check_size(document, study)
    _check_steps(document, study, maker, files, places)
    study = replace(study, named=files.named())
    return replace(study, digest=study_digest(study))


def _parsed(text: bytes, source: str) -> YamlDocument:
    """The file as YAML; raises `InputError` also for a design in the place of a study."""
    if not text.strip():
        raise InputError(
            "the file is empty; a study begins with dqforge_study: 1",
            source=source,
            line=1,
            column=1,
        )
    document = parse_yaml(text, source)
    if "dqforge" in document.data and "dqforge_study" not in document.data:
        raise document.error(
            "this is a design; a study begins with dqforge_study: 1 and names it under design",
            ("dqforge",),
            key=True,
        )
    return document


def _design(name: str, files: StudyFolder, document: YamlDocument) -> tuple[bytes, str]:
    """Bytes and name of the design: a drive of the library, or a file beside the study."""
    if catalogue.is_known(name):
        return catalogue.read_text(name), f"{name}.yaml"
    if not name.endswith((".yaml", ".yml")):
        try:
            catalogue.read_text(name)
        except InputError as error:
            message = f"{error.message}; a file beside the study ends with .yaml"
            raise complaint(document, ("design",), message) from None
    return files.design(name)


def _sets(document: YamlDocument) -> tuple[tuple[str, YamlValue], ...]:
    """Keys that the study sets; raises `InputError` where a design has none such."""
    given = document.data.get("set", {})
    found = []
    for name, value in sorted(given.items()) if isinstance(given, dict) else ():
        known_key(document, ("set", name))
        found.append((name, value))
    return tuple(found)


def _search(file: StudyFile) -> Search | None:
    given = file.search
    if given is None:
        return None
    return Search(given.method, given.population, given.generations, given.seed)


def _assigned(axes: tuple[Axis, ...], places: tuple[int, ...]) -> dict[str, YamlValue]:
    """Values of the keys that vary at a point of the grid."""
    return {
        key: value
        for axis, place in zip(axes, places, strict=True)
        for key, value in zip(axis.keys, axis.steps[place], strict=True)
    }


def _tried(axes: tuple[Axis, ...]) -> Iterator[tuple[int, ...]]:
    """Points of the grid: both ends, and others from all over it; all of a small grid."""
    counts = [len(axis.steps) for axis in axes]
    whole = prod(counts)
    stride = max(1, whole // _MOST_TRIED)
    places = dict.fromkeys([0, whole - 1, *range(0, whole, stride)])
    for index in places:
        found, left = [], index
        for count in reversed(counts):
            left, place = divmod(left, count)
            found.append(place)
        yield tuple(reversed(found))


def _first_design(study: Study, maker: DesignMaker, files: StudyFolder) -> tuple[int, ...]:
    """Point of the grid of the first row that is a design.

    Raises `InputError` where none of those tried is one, with what is said of the first.
    """
    refusals: list[InputError] = []
    for places in islice(_tried(study.axes), 2 * _MOST_TRIED):
        try:
            maker.design(_assigned(study.axes, places))
        except InputError as error:
            if files.missing:
                raise
            refusals.append(error)
        else:
            return places
    if len(refusals) > 1:
        refusals[0].message = f"no row is a design, the first: {refusals[0].message}"
    raise refusals[0]


def _check_steps(
    document: YamlDocument,
    study: Study,
    maker: DesignMaker,
    files: StudyFolder,
    places: tuple[int, ...],
) -> None:
    """Check that every value that is no number may stand at its key, and read the files that the
    rows name.

    Raises `InputError`. A design that has other reasons to be refused is a row of that state.
    """
    for index, axis in enumerate(study.axes):
        if axis.numbers:
            continue
        for place in range(len(axis.steps)):
            assigned = _assigned(study.axes, (*places[:index], place, *places[index + 1 :]))
            maker.file(assigned)
            own = {key: assigned[key] for key in axis.keys}
            for key, value in own.items():
                _check_device(document, key, value)
            if any(_names_files(key, value) for key, value in own.items()):
                try:
                    maker.design(assigned)
                except InputError:
                    if files.missing:
                        raise


def _check_device(document: YamlDocument, key: str, value: YamlValue) -> None:
    """Refuse a device that the library does not have; raises `InputError`."""
    found = design_key(key)
    if found is None or found.path[:2] != ("inverter", "device"):
        return
    name = value.get("name") if isinstance(value, dict) else value
    if isinstance(name, str) and (isinstance(value, dict) or found.path[2:] == ("name",)):
        try:
            devices.read_text(name)
        except InputError as error:
            raise complaint(document, place_of(document, "vary", key), error.message) from None


def _names_files(key: str, value: YamlValue) -> bool:
    """Whether a value may name a file."""
    if isinstance(value, dict):
        return any(_names_files(inner, part) for inner, part in value.items())
    if isinstance(value, list):
        return any(_names_files(key, part) for part in value)
    return key.rpartition(".")[2] in _NAMES_FILES


# Files that a study, its design and its rows name: found in the folder of the study, read once.

NOMINAL = "nominal"
_HEADER_ENDINGS = (".h", ".c", ".json", ".yaml")
_MOST_HEADER_FILES = 100


class StudyFolder(Mapping[str, bytes]):
    """Files in the folder of a study or below it, by the names that designs give them.

    What was asked for stays in memory. A name is looked for beside the design, then beside the
    study. ``missing`` are names that were asked for in vain.
    """

    def __init__(self, folder: Path | None, document: YamlDocument) -> None:
        self._folder, self._document = folder, document
        self._beside_design = folder
        self._found: dict[str, bytes] = {}
        self.missing: list[str] = []

    def __getitem__(self, name: str) -> bytes:
        if name not in self._found:
            contents = {
                content
                for folder in dict.fromkeys([self._beside_design, self._folder])
                if (content := self._content(folder, name)) is not None
            }
            if len(contents) != 1:
                self.missing.append(name)
                if contents:
                    raise InputError(
                        f"there is another file '{name}' beside the design than beside the study; "
                        "rename one",
                        source=self._document.source,
                    )
                raise KeyError(name)
            self._found[name] = contents.pop()
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def named(self) -> tuple[tuple[str, bytes], ...]:
        """All that was found, by name."""
        return tuple(sorted(self._found.items()))

    def _content(self, folder: Path | None, name: str) -> bytes | None:
        """Content of a file, None where there is none in the folder of the study."""
        place = self._inside(folder, name)
        if place is None:
            return None
        try:
            return read_regular_file(place, MAX_FILE_BYTES, name)
        except (InputError, OSError):
            return None

    def _inside(self, folder: Path | None, name: str) -> Path | None:
        """Where a file lies; None where there is none in the folder of the study."""
        if folder is None or self._folder is None or not name or Path(name).is_absolute():
            return None
        try:
            place = (folder.resolve() / name).resolve()
            inside = place.is_relative_to(self._folder.resolve()) and place.exists()
        except (OSError, RuntimeError, ValueError):
            return None
        return place if inside else None

    def design(self, name: str) -> tuple[bytes, str]:
        """Bytes and name of the design beside the study.

        Raises `InputError` where there is none.
        """
        place = self._place(name, ("design",), "design")
        self._beside_design = place.parent
        try:
            return read_regular_file(place, MAX_BYTES, name), name
        except InputError as error:
            raise complaint(self._document, ("design",), f"{name}: {error.message}") from None

    def _place(self, name: str, path: KeyPath, what: str) -> Path:
        """Where a part of the study lies; raises `InputError` where it is not there."""
        if self._folder is None:
            raise complaint(
                self._document, path, f"a study of the library cannot name a {what}; copy the study"
            )
        place = self._inside(self._folder, name)
        if place is not None:
            return place
        outside = Path(name).is_absolute() or ".." in Path(name).parts
        if outside:
            raise complaint(
                self._document,
                path,
                f"'{name}' lies outside the folder of the study; copy it there",
            )
        hint = self._alike(name)
        raise complaint(self._document, path, f"there is no {what} '{name}' beside the study{hint}")

    def _alike(self, name: str) -> str:
        """What a name that is not there may have been meant to be."""
        try:
            names = [entry.name for entry in self._folder.iterdir()] if self._folder else []
        except OSError:
            return ""
        matches = close_matches(name, sorted(names))
        return f"; did you mean {' or '.join(matches)}?" if matches else "; check the name"

    def header(self, name: str | None) -> tuple[tuple[str, bytes], ...]:
        """Files of the folder of a fixed header by their names, none for `NOMINAL`.

        Raises `InputError` where there is no such folder, or no header in it.
        """
        path: KeyPath = ("header",)
        if name is None or name == NOMINAL:
            return ()
        place = self._place(name, path, "folder")
        if not place.is_dir():
            raise complaint(
                self._document, path, f"'{name}' is a file; name the folder that it lies in"
            )
        names = sorted(entry.name for entry in place.iterdir() if entry.is_file())
        kept = [entry for entry in names if entry.endswith(_HEADER_ENDINGS)]
        if not any(entry.endswith(".h") for entry in kept):
            raise complaint(
                self._document,
                path,
                f"there is no header in '{name}'; name a folder that 'dqforge run' wrote, or "
                f"write {NOMINAL}",
            )
        if len(kept) > _MOST_HEADER_FILES:
            message = f"'{name}' holds {len(kept)} files; name a folder that 'dqforge run' wrote"
            raise complaint(self._document, path, message)
        try:
            return tuple(
                (entry, read_regular_file(place / entry, MAX_FILE_BYTES, entry)) for entry in kept
            )
        except InputError as error:
            raise complaint(self._document, path, f"{error.source}: {error.message}") from None

    def listed(self, pattern: str) -> list[str]:
        """Names of the files that a pattern such as ``devices/*.json`` stands for, in their order.

        Raises `InputError` without a position where there is none.
        """
        if not any(sign in pattern for sign in "*?["):
            return [pattern]
        if self._folder is None:
            raise InputError("a study of the library cannot name files; copy the study")
        if Path(pattern).is_absolute() or ".." in Path(pattern).parts:
            raise InputError(f"'{pattern}' lies outside the folder of the study; copy it there")
        try:
            places = [place for place in self._folder.glob(pattern) if place.is_file()]
        except (OSError, ValueError, NotImplementedError):
            places = []
        if not places:
            raise InputError(f"no file beside the study is called '{pattern}'; check the pattern")
        return sorted(place.relative_to(self._folder).as_posix() for place in places)


# What a study asks of outputs: columns, limits, what counts as good, goals.
#
# Which outputs a design has is not known here; the kind of quantity of a name is, so that limits
# are read with their units.

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


# The studies that ship with the package, to start from.


def names() -> list[str]:
    """Names of the studies in the library, in alphabetical order."""
    return STUDIES.names()


def read_text(name: str) -> bytes:
    """Bytes of a study in the library; raises `InputError` when there is none of this name."""
    return STUDIES.read(name)


def load(name: str) -> Study:
    """Study from the library; raises `InputError` when there is none of this name."""
    return study_of_text(read_text(name), STUDIES.source(name))
