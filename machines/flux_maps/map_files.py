"""Flux maps from arrays in memory and from files: tables, spreadsheets, NPZ, MATLAB, HDF5 and what
finite-element programs write, in the axes and the scaling that their owner declares.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePath
from typing import IO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.positioned_xml import read_numeric_table
from dqforge.machines.files.text_formats import (
    NamedArray,
    arrays_of_hdf5,
    arrays_of_mat4,
    arrays_of_mat5,
    arrays_of_npz,
    reading,
)
from dqforge.machines.files.text_table import read_table
from dqforge.machines.flux_maps import map_names
from dqforge.machines.flux_maps.coordinates import (
    BLUR,
    NOTHING,
    Declared,
    Parts,
    cartesian,
    claims,
    in_si,
    over_frequency,
    spread,
    without_drop,
)
from dqforge.machines.flux_maps.flux_points import SQUARED, FileLoss, FileTorque, FluxPoints
from dqforge.machines.flux_maps.map_names import EXPECTED, is_unit, per_length, per_pole_pair
from dqforge.machines.flux_maps.map_text import arrays_of_layout, oriented
from dqforge.machines.flux_maps.rotor_angle import Turning, averaged, cells_of, turning_points
from dqforge.machines.names import FluxAxes, FluxFitName, FluxScaling, FluxTorque
from dqforge.machines.units.quantities import format_quantity

SOURCE = "flux map from arrays"
_MOST_BYTES = 256_000_000


_QUANTITIES = ("i_d", "i_q", "psi_d", "psi_q")


def make_flux_map(
    i_d: ArrayLike,
    i_q: ArrayLike,
    psi_d: ArrayLike,
    psi_q: ArrayLike,
    *,
    axes: FluxAxes = "magnet-d",
    scaling: FluxScaling = "peak",
    fit: FluxFitName = "auto",
    extrapolate: bool = False,
) -> FluxMap:
    """A flux map of arrays: a grid, or points in any order.

    Args:
        i_d, i_q: Currents in A: axes of shapes (M,) and (N,) of a grid, or the currents of each
            point, of the shape of psi_d. The half plane i_q >= 0 is enough, it is mirrored; a full
            plane is averaged with its mirror image.
        psi_d, psi_q: Flux linkages in Wb, shape (M, N) on a grid, else any one shape.
        axes: ``magnet-d`` with d along the magnets, or ``reluctance`` with the magnets on the
            negative q axis.
        scaling: Of currents and flux linkages: ``peak``, ``rms`` or ``power-invariant``.
        fit: ``interpolate``: a spline through the points; ``smooth``: a smooth co-energy near them;
            ``auto``: smooth where noise asks for it.
        extrapolate: Whether currents beyond the map may be used; results that use them are marked.

    Raises:
        InputError: The shapes do not fit, a number is not finite, or the points are no map of a
            machine.
    """
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map
    from dqforge.machines.flux_maps.flux_points import FluxPoints

    given = (i_d, i_q, psi_d, psi_q)
    values = [_numbers(part, name) for part, name in zip(given, _QUANTITIES, strict=True)]
    points = FluxPoints(SOURCE, *_points(*values))
    treatment = FluxTreatment(fit)
    return build_flux_map(
        points, axes=axes, scaling=scaling, extrapolate=extrapolate, treatment=treatment
    ).flux_map


def read_flux_map(
    file: str | Path,
    *,
    axes: FluxAxes = "magnet-d",
    scaling: FluxScaling | None = None,
    fit: FluxFitName = "auto",
    extrapolate: bool = False,
) -> FluxMap:
    """The flux map in a file of any layout that a design may name (docs/methods/flux-maps.md).

    Args:
        file: Text, spreadsheet, NPZ, MAT, HDF5, or what finite-element tools write.
        axes, fit, extrapolate: As for `make_flux_map`.
        scaling: Likewise; None takes what the names in the file say, else peak values.

    Raises:
        InputError: The file cannot be read, or is no map of a machine as it is declared.
    """
    from dqforge.machines.flux_maps.building import FluxTreatment, build_flux_map

    points = read_flux_points(read_regular_file(file, _MOST_BYTES), str(file))
    treatment = FluxTreatment(fit)
    return build_flux_map(
        points, axes=axes, scaling=scaling, extrapolate=extrapolate, treatment=treatment
    ).flux_map


def _numbers(values: ArrayLike, name: str) -> FloatArray:
    """An array of finite numbers."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            f"{name}: expected an array of numbers, got {type(values).__name__}"
        ) from None
    if array.size and not np.all(np.isfinite(array)):
        place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        raise InputError(
            f"{name}: the value at index {place} is {array[place]}; measure it or leave its row out"
        )
    return array


def _points(
    i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """All four at each point, shape (K,)."""
    if psi_d.shape != psi_q.shape:
        raise InputError(
            f"psi_d has the shape {psi_d.shape}, psi_q {psi_q.shape}; give both on the same points"
        )
    if i_d.ndim == i_q.ndim == 1 and psi_d.ndim == 2:
        if psi_d.shape != (i_d.size, i_q.size):
            hint = "; give psi_d.T and psi_q.T" if psi_d.shape == (i_q.size, i_d.size) else ""
            raise InputError(
                f"psi_d has the shape {psi_d.shape}, the axes i_d and i_q need "
                f"{(i_d.size, i_q.size)}{hint}"
            )
        i_d, i_q = np.meshgrid(i_d, i_q, indexing="ij")
    if not i_d.shape == i_q.shape == psi_d.shape:
        raise InputError(
            f"i_d, i_q and psi_d have the shapes {i_d.shape}, {i_q.shape} and {psi_d.shape}; give "
            "axes (M,) and (N,) with flux linkages (M, N), or four arrays of one shape"
        )
    return i_d.ravel(), i_q.ravel(), psi_d.ravel(), psi_q.ravel()


# Flux-map files: tables, spreadsheets, NPZ, MATLAB, HDF5 and what finite-element tools write
# become raw points.
#
# A file is first a list of named arrays, whatever its format; the names that tools use are
# recognised among them, and the shapes tell whether they are axes, meshes or points.

# Bytes of a text table that is more than plain numbers; it takes some twenty times that in memory.
_Reader = Callable[[bytes, str], list[NamedArray]]
_MOST_TEXT = 32_000_000
_MOST_PLAIN = 200_000_000
_TEXTS = (".csv", ".tsv", ".txt", ".dat", ".bch", ".batch")
_SUFFIXES = ".csv, .txt, .dat, .xlsx, .npz, .mat, .h5, .hdf5, .bch or .batch"
_MOST_OTHERS = 12


def read_flux_points(
    content: bytes,
    source: str,
    *,
    current_unit: str | None = None,
    flux_unit: str | None = None,
    columns: Mapping[str, str] | None = None,
    at: Mapping[str, float] | None = None,
    companions: Mapping[str, tuple[bytes, str]] | None = None,
    torque: FluxTorque = "air-gap",
    declared: Declared = NOTHING,
) -> FluxPoints:
    """Raw points of a flux-map file in its own order, grids row by row; NaN are passed on.

    A grid over two axes may have rows of i_d or of i_q: its shape tells, in a square one the
    physics. Among several maps in one file, SyR-e's `FluxMap_dq` comes first, then the one nearest
    to the root. Maps over the rotor angle are averaged over it.

    Args:
        content: Bytes of the file.
        source:
            Its name; the suffix chooses the format: .csv, .tsv, .txt, .dat, .bch, .batch, .xlsx,
            .npz, .mat (4, 5, 7.3), .h5, .hdf5.
        current_unit, flux_unit: Units of the currents (A, mA, kA) and the flux linkages (Wb, mWb,
            Vs, mVs) where the file does not say them; A and Wb otherwise.
        columns: What 'i_d', 'i_q', 'psi_d', 'psi_q' or another of `flux_map_names.KINDS` are called
            in the file, where their names are not recognised. A complex array d + j q may be named
            for both axes.
        at: 'temperature' (degC) and 'speed' (rad/s) of the points that are wanted, where the file
            holds several.
        companions: Contents and names of further files of one matrix each: 'psi_q', 'torque'; the
            first file is then psi_d.
        torque: What the torque of the file is; of several it chooses.
        declared: What the design says; operating points are read with it.

    Raises:
        InputError: The file is none of its format, lacks an array, has shapes that do not fit,
            units that contradict each other or exceeds a limit: 4e6 values of an array, 256 MB of
            arrays, 200 MB of plain text, 32 MB of other text.
    """
    given = {"i": current_unit or "", "psi": flux_unit or ""}
    for kind, unit in given.items():
        if unit and not is_unit(kind, unit):
            raise InputError(
                f"the unit {unit!r} is not known; write {EXPECTED[kind]}", source=source
            )
    arrays = named_arrays(content, source)
    if companions:
        arrays = _together(arrays, source, companions)
    chosen = map_names.choose(arrays, columns or {}, source, torque)
    _refuse_torque_of_a_length(chosen, torque, source)
    used = dict(chosen)
    if torque == "ignore":
        chosen.pop("torque", None)
    claimed = claims(chosen, source)
    scaling = declared.scaling or claimed or "peak"
    voltages = "v_d" in chosen
    if declared.r_s is not None and not voltages:
        raise InputError(
            "resistance belongs to operating points with voltages, this file has flux linkages; "
            "remove the key",
            source=source,
        )
    told: tuple[str, ...] = ()
    with np.errstate(
        over="ignore", invalid="ignore", divide="ignore"
    ):  # infinities are for others to judge, as NaN are
        parts = {quantity: in_si(quantity, chosen, given, source) for quantity in chosen}
        if voltages:
            parts, told = over_frequency(parts, chosen, declared, source)
        parts, turned = cartesian(spread(parts, source), source)
        lines = chosen["psi_d"].lines if "psi_d" in chosen else None
        if voltages:
            lines = chosen["v_d"].lines
        lines = lines if lines is not None and lines.size == parts["psi_d"].size else None
        loss = loss_of(parts, chosen, scaling)
        if loss is not None:
            parts["loss"] = loss.values
        if voltages:
            known = np.isfinite(parts["psi_d"]) & np.isfinite(parts["psi_q"])
            lines = None if lines is None else lines[known]
            parts, more = without_drop(parts, declared, scaling, source)
            told = (*told, *more)
            if "speed" not in (at or {}):
                parts.pop("speed", None)
        parts, lines, found, turning = without_third(parts, lines, at or {}, source)
    if "l_d" in chosen:
        turned = (
            *turned,
            "flux linkages are psi_m + l_d i_d and l_q i_q: the inductances are taken as apparent",
        )
    i_d, i_q, psi_d, psi_q = (
        np.ascontiguousarray(parts[quantity]) for quantity in map_names.WANTED
    )
    deviations, beside = map_names.deviations_beside(arrays, chosen, i_d, i_q)
    others = _others([array for array in arrays if array.path not in beside], used)
    return FluxPoints(
        source,
        i_d,
        i_q,
        psi_d,
        psi_q,
        torque=_torque(used, parts),
        lines=lines,
        claimed=claimed,
        findings=(*told, *turned, *found, *_left_out(chosen, parts), *_unused(others)),
        others=others,
        loss=loss and FileLoss(loss.name, parts["loss"]),
        blur=BLUR if voltages else 0.0,
        pole_pairs=map_names.stated_pole_pairs(arrays),
        ignored=used["torque"].path if torque == "ignore" and "torque" in used else "",
        deviations=deviations,
        turning=None if turning is None else turning_points(turning, chosen, source),
    )


def _refuse_torque_of_a_length(
    chosen: Mapping[str, NamedArray], torque: FluxTorque, source: str
) -> None:
    if "torque" not in chosen or torque == "ignore":
        return
    array = chosen["torque"]
    if per_length(f"{array.name} {array.unit}"):
        raise InputError(
            f"{array.title} is a torque per length; multiply it by the length of the armature, or "
            "write torque: ignore",
            source=source,
        )


def _torque(chosen: Mapping[str, NamedArray], parts: Mapping[str, np.ndarray]) -> FileTorque | None:
    """The torque of the file at each point, where it holds one that is no constant."""
    if "torque" not in parts:
        return None
    array, values = chosen["torque"], parts["torque"]
    known = values[np.isfinite(values)]
    if known.size == 0 or (np.ptp(known) == 0.0 and known[0] != 0.0):  # 'T' may be a temperature
        return None
    return FileTorque(array.path, values, per_pole_pair(f"{array.name} {array.unit}"))


def _left_out(chosen: Mapping[str, NamedArray], parts: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """A sentence on a torque that could not be laid beside the flux linkages."""
    if "torque" in chosen and "torque" not in parts:
        return (
            (
                f"warning: {chosen['torque'].title} does not fit the flux linkages and was not "
                "compared with them"
            ),
        )
    return ()


def _others(arrays: Sequence[NamedArray], chosen: Mapping[str, NamedArray]) -> tuple[str, ...]:
    """Further arrays of numbers, without single values, which are settings."""
    taken = {array.path for array in chosen.values()}
    return tuple(
        f"{array.path} [{array.unit}]" if array.unit else array.path
        for array in arrays
        if array.numeric and array.values.size > 1 and array.path not in taken
    )


def _unused(others: Sequence[str]) -> tuple[str, ...]:
    """A sentence on what the file holds beside and nobody used."""
    if not others:
        return ()
    more = len(others) - _MOST_OTHERS
    losses = any(map(map_names.loss_named, others))
    return (
        "not used of the file: "
        + ", ".join(others[:_MOST_OTHERS])
        + (f" and {more} more" if more > 0 else "")
        + ("; losses over the currents are read by machine.loss_map" if losses else ""),
    )


def named_arrays(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of a file of any layout, by its suffix and first bytes; raises `InputError`."""
    return _reader(content, source)(content, source)


def _signature(content: bytes) -> str:
    """Format that the first bytes of a file tell, '' for text and for MATLAB 4,
    which has no mark.
    """
    if content[:4] in (b"PK\x03\x04", b"PK\x05\x06"):
        return "a ZIP archive"
    if any(content[place : place + 8] == b"\x89HDF\r\n\x1a\n" for place in (0, 512, 1024, 2048)):
        return "an HDF5 file"
    return "a MATLAB 5 file" if content[124:128] in (b"\0\1IM", b"\1\0MI") else ""


def _reader(content: bytes, source: str) -> _Reader:
    """Function that reads a file's arrays, by its suffix and first bytes."""
    suffix = PurePath(source).suffix.lower()
    readers: dict[tuple[str, str], _Reader] = {
        ("text", ""): _from_text,
        (".npz", "a ZIP archive"): arrays_of_npz,
        (".xlsx", "a ZIP archive"): _from_sheets,
        (".mat", ""): arrays_of_mat4,
        (".mat", "a MATLAB 5 file"): arrays_of_mat5,
        (".mat", "an HDF5 file"): arrays_of_hdf5,
        (".h5", "an HDF5 file"): arrays_of_hdf5,
    }
    formats = (
        dict.fromkeys(_TEXTS, "text")
        | dict.fromkeys((".h5", ".hdf5", ".hdf"), ".h5")
        | {".xlsm": ".xlsx"}
    )
    form, found = formats.get(suffix, suffix), _signature(content)
    if form not in {key for key, _ in readers}:
        message = f"cannot read a flux map from a file with the suffix {suffix!r}"
        raise InputError(f"{message}; write {_SUFFIXES}", source=source)
    if (form, found) not in readers:
        wanted = " or ".join(mark for key, mark in readers if key == form and mark) or "text"
        message = (
            f"the suffix {suffix} stands for {wanted}, the content is {found or 'something else'}"
        )
        raise InputError(
            f"{message}; give the file the suffix of its format, or save it again", source=source
        )
    return readers[form, found]


def _from_text(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of a text: of a special layout, or the columns of a table."""
    if len(content) > _MOST_PLAIN:
        message = (
            f"the file has {len(content) / 1e6:.0f} MB, at most {_MOST_PLAIN / 1e6:g} MB can be "
            "read"
        )
        raise InputError(f"{message}; save a coarser map, or as NPZ", source=source)
    if (arrays := arrays_of_layout(content, source)) is not None:
        return arrays
    table = read_numeric_table(content, source)
    if table is None:
        if len(content) > _MOST_TEXT:
            message = f"the file has {len(content) / 1e6:.0f} MB and is no table of plain numbers"
            raise InputError(
                f"{message}, of which at most {_MOST_TEXT / 1e6:g} MB can be read", source=source
            )
        table = read_table(content, source)
    columns = zip(table.names, table.units, table.values.T, strict=True)
    return [NamedArray(name, name, values, unit, table.lines) for name, unit, values in columns]


def _from_sheets(content: bytes, source: str) -> list[NamedArray]:
    """Arrays of a workbook: of its only sheet, or of all that can be read,
    with the sheets as their groups.
    """
    found: list[NamedArray] = []
    first_error: InputError | None = None
    pages = sheets(content, source)
    for sheet, text in pages:
        try:
            arrays = _from_text(text, source)
        except InputError as error:
            first_error = first_error or error
            continue
        for array in arrays:
            name = sheet if array.name == "matrix" else array.name
            path = name if len(pages) == 1 or array.name == "matrix" else f"{sheet}.{name}"
            found.append(NamedArray(path, name, array.values, array.unit, array.lines))
    if not found and first_error is not None:
        raise first_error
    return oriented(found)


def _together(
    arrays: list[NamedArray], source: str, companions: Mapping[str, tuple[bytes, str]]
) -> list[NamedArray]:
    """Arrays of a map whose quantities stand in a file each; their axes must be the same."""
    together = _only("psi_d", arrays, source)
    for quantity, (content, name) in companions.items():
        further = _only(quantity, _reader(content, name)(content, name), name)
        for axis in further[:-1]:
            own = next((array for array in together if array.name == axis.name), None)
            if own is None or not np.array_equal(own.values, axis.values):
                raise InputError(
                    f"its {axis.name} differs from that in {source}; save both over the same",
                    source=name,
                )
        together.append(further[-1])
    return oriented(together)


def _only(quantity: str, arrays: list[NamedArray], source: str) -> list[NamedArray]:
    """Axes of a file of one matrix, and the matrix with the name of its quantity."""
    by_name = {found: array for array in arrays for found in map_names.recognised(array)}
    axes = [by_name[axis] for axis in ("i_d", "i_q") if axis in by_name]
    rest = [array for array in arrays if all(array is not axis for axis in axes)]
    own = [array for array in rest if quantity in map_names.recognised(array)] or rest
    if len(axes) != 2 or len(own) != 1:
        message = f"this is no matrix of {quantity} with i_d across and i_q down"
        raise InputError(
            f"{message}; write the currents into its first row and column", source=source
        )
    axes = [
        NamedArray(name, name, axis.values, axis.unit)
        for name, axis in zip(("i_d", "i_q"), axes, strict=True)
    ]
    return [*axes, NamedArray(quantity, quantity, own[0].values, own[0].unit)]


# Flux maps over a third coordinate: the rotor angle is averaged over,
# a temperature or speed is asked for by name.

# Difference over the largest value from which on two temperatures or speeds are two.
_DISTINCT = 0.01
_MOST_LISTED = 12
_UNITS = {"temperature": "degC", "speed": "rpm"}
_EXAMPLES = {"temperature": "80 degC", "speed": "1000 rpm"}


def without_third(
    parts: Parts, lines: NDArray[np.intp] | None, at: Mapping[str, float], source: str
) -> tuple[Parts, NDArray[np.intp] | None, tuple[str, ...], Turning | None]:
    """Points over the currents alone, the lines that they stand in, and what was done,
    in sentences; and all of them over the rotor angle where they cover one.

    Args:
        parts: Quantities of points, shape (K,), with 'angle' (rad), 'temperature' (degC) or 'speed'
            (rad/s) among them or not.
        lines: Line of each point in its file, shape (K,), or None.
        at: Temperature (degC) and speed (rad/s) whose points are wanted.

    Raises:
        InputError: Several temperatures or speeds and none is asked for, or there is no such one;
            see also `averaged`.
    """
    findings: tuple[str, ...] = ()
    for name in ("temperature", "speed"):
        if name not in parts:
            if name in at:
                raise InputError(
                    f"at.{name}: the file does not say the {name} of its points", source=source
                )
            continue
        kept, sentence = _selected(name, parts, at.get(name), source)
        parts = {key: part[kept] for key, part in parts.items() if key != name}
        lines = lines if lines is None else lines[kept]
        findings += sentence
    if "angle" not in parts:
        return parts, lines, findings, None
    return averaged(parts, lines, findings, source)


def _selected(
    name: str, parts: Parts, wanted: float | None, source: str
) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Which points to keep, those at the temperature or speed that is wanted, and a sentence."""
    values = parts[name]
    everything = np.ones(values.size, dtype=bool)
    if not np.all(np.isfinite(values)):
        return everything, ()
    labels, counts = cells_of(parts["i_d"], parts["i_q"])
    step = _DISTINCT * max(float(np.max(np.abs(values), initial=0.0)), 1e-9)
    known = _distinct(values, step)
    if wanted is None:
        means = np.bincount(labels, values) / counts
        if known.size < 2 or float(np.max(np.abs(values - means[labels]))) <= 0.5 * step:
            return (
                everything,
                (),
            )  # one value, or one for each pair of currents: no coordinate of its own
        shown = ", ".join(
            format_quantity(float(value), _UNITS[name]) for value in known[:_MOST_LISTED]
        )
        more = ", ..." if known.size > _MOST_LISTED else ""
        raise InputError(
            f"the points are given at {known.size} values of the {name} ({shown}{more}); say "
            f"which: at: {{{name}: {_EXAMPLES[name]}}}",
            source=source,
        )
    kept = np.abs(values - wanted) <= 0.5 * step
    if not kept.any():
        shown = ", ".join(
            format_quantity(float(value), _UNITS[name]) for value in known[:_MOST_LISTED]
        )
        raise InputError(
            f"at.{name}: there are no points at {format_quantity(wanted, _UNITS[name])}, but at "
            f"{shown}; write one of these",
            source=source,
        )
    return kept, (
        (
            f"of {values.size} points the {np.count_nonzero(kept)} at "
            f"{format_quantity(wanted, _UNITS[name])}"
        ),
    )


def _distinct(values: FloatArray, step: float) -> FloatArray:
    """Ascending values of which two neighbours are more than a step apart."""
    ascending = np.sort(values)
    return np.asarray(ascending[np.append(True, np.diff(ascending) > step)])


# Flux maps in spreadsheets (.xlsx): each sheet becomes the text that a table
# of the same cells would be.
#
# What the sheets claim is counted in the archive first: the reader lays out every cell
# between the outermost ones.

_FILES_MOST_BYTES = 64_000_000


_MOST_CELLS = 2_000_000


_BLOCK = 1 << 20


_CELL = re.compile(rb'\br="([A-Z]{1,3})(\d{1,7})"')


_ROW = re.compile(rb'<(?:\w+:)?row\b[^>]*?\br="(\d{1,7})"')


_ANY_CELL = re.compile(rb"<(?:\w+:)?c[\s/>]")


def sheets(content: bytes, source: str) -> list[tuple[str, bytes]]:
    """Name of each sheet with numbers and its cells as text, tabs between
    them and one line per row.

    Raises:
        InputError: The file is no workbook, or its sheets take more than 64 MB or 2e6 cells.
    """
    from python_calamine import CalamineWorkbook

    found = []
    with reading("xlsx", source):
        _check_claims(content, source)
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
            if any(
                isinstance(cell, float | int) and not isinstance(cell, bool)
                for row in rows
                for cell in row
            ):
                found.append(
                    (name, "\n".join("\t".join(map(_text, row)) for row in _trimmed(rows)).encode())
                )
    if not found:
        raise InputError("no sheet holds numbers", source=source)
    return found


def _trimmed(rows: Sequence[Sequence[object]]) -> list[Sequence[object]]:
    """Rows without the columns to the left and the right that are empty throughout."""
    used = [k for row in rows for k, cell in enumerate(row) if cell != ""]
    low, high = min(used, default=0), max(used, default=0)
    return [row[low : high + 1] for row in rows]


def _text(cell: object) -> str:
    """A cell as text without tabs and line feeds."""
    return repr(cell) if isinstance(cell, float) else " ".join(str(cell).split())


def _check_claims(content: bytes, source: str) -> None:
    """Refuse workbooks that unfold to more than the limits."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > _FILES_MOST_BYTES:
            message = f"the workbook takes more than {_FILES_MOST_BYTES / 1e6:g} MB once unpacked"
            raise InputError(f"{message}; save the map alone, or as CSV", source=source)
        for member in members:
            if member.filename.startswith("xl/worksheets/") and member.filename.endswith(".xml"):
                with archive.open(member) as stream:
                    columns, rows, cells = _extent(stream)
                if max(columns * rows, cells) > _MOST_CELLS:
                    message = (
                        f"{member.filename} has {cells} cells over {rows} rows and {columns} "
                        "columns"
                    )
                    raise InputError(f"{message}; save the map alone, or as CSV", source=source)


def _extent(stream: IO[bytes]) -> tuple[int, int, int]:
    """Largest column and row that cells and rows of a sheet name, and the number of cells."""
    columns = rows = 1
    cells = 0
    rest = b""
    while block := stream.read(_BLOCK):
        text = rest + block
        cells += len(_ANY_CELL.findall(text)) - len(_ANY_CELL.findall(rest))
        for letters, row in _CELL.findall(text):
            number = 0
            for letter in letters:
                number = 26 * number + letter - 64
            columns, rows = max(columns, number), max(rows, int(row))
        rows = max([rows, *map(int, _ROW.findall(text))])
        rest = text[-64:]
    return columns, rows, cells


# Losses that a flux-map file gives beside its points: a total in W, or by an efficiency.

_PER_CENT = 1.5  # Largest efficiency beyond which a column without a unit is in per cent.


def loss_of(
    parts: Parts, chosen: Mapping[str, NamedArray], scaling: FluxScaling
) -> FileLoss | None:
    """Total loss of the machine at each point, None where the file tells none.

    An efficiency makes it with the mechanical power, or with the electrical one; only of a machine
    that drives.
    """
    if "loss" in parts:
        return FileLoss(chosen["loss"].path, parts["loss"])
    if "efficiency" not in parts or "speed" not in parts:
        return None
    share = parts["efficiency"]
    if float(np.nanmax(share, initial=0.0)) > _PER_CENT:
        share = 1e-2 * share
    usual = (share > 0.0) & (share <= 1.0)
    if "torque" in parts:
        power = parts["torque"] * parts["speed"]
        loss = power * (1.0 / np.where(usual, share, np.nan) - 1.0)
    elif "frequency" in parts:  # psi_d and psi_q are still voltages over it
        power = (
            1.5
            * SQUARED[scaling]
            * parts["frequency"]
            * (parts["psi_d"] * parts["i_q"] - parts["psi_q"] * parts["i_d"])
        )
        loss = power * (1.0 - np.where(usual, share, np.nan))
    else:
        return None
    return FileLoss(f"by {chosen['efficiency'].path}", np.where(power > 0.0, loss, np.nan))
