"""Flux-map files: tables, spreadsheets, NPZ, MATLAB, HDF5 and what finite-element
tools write become raw points.

A file is first a list of named arrays, whatever its format; the names that tools use are recognised
among them, and the shapes tell whether they are axes, meshes or points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.files.archives import arrays_of_hdf5, arrays_of_npz
from dqforge.machines.files.matlab_arrays import arrays_of_mat4, arrays_of_mat5
from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.files.number_table import read_table
from dqforge.machines.files.plain_numbers import read_numeric_table
from dqforge.machines.flux_map_files import names
from dqforge.machines.flux_map_files.coordinates import cartesian, claims, in_si, spread
from dqforge.machines.flux_map_files.loss_columns import loss_of
from dqforge.machines.flux_map_files.operating_points import (
    BLUR,
    NOTHING,
    Declared,
    over_frequency,
    without_drop,
)
from dqforge.machines.flux_map_files.text import arrays_of_layout, oriented
from dqforge.machines.flux_map_files.third_coordinate import without_third
from dqforge.machines.flux_map_files.units import EXPECTED, is_unit, per_length, per_pole_pair
from dqforge.machines.flux_maps.flux_points import FileLoss, FileTorque, FluxPoints
from dqforge.machines.names import FluxTorque

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
    arrays = _reader(content, source)(content, source)
    if companions:
        arrays = _together(arrays, source, companions)
    chosen = names.choose(arrays, columns or {}, source, torque)
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
        parts, lines, found = without_third(parts, lines, at or {}, source)
    if "l_d" in chosen:
        turned = (
            *turned,
            "flux linkages are psi_m + l_d i_d and l_q i_q: the inductances are taken as apparent",
        )
    i_d, i_q, psi_d, psi_q = (np.ascontiguousarray(parts[quantity]) for quantity in names.WANTED)
    others = _others(arrays, used)
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
        pole_pairs=names.stated_pole_pairs(arrays),
        ignored=used["torque"].path if torque == "ignore" and "torque" in used else "",
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
    return (
        "not used of the file: "
        + ", ".join(others[:_MOST_OTHERS])
        + (f" and {more} more" if more > 0 else ""),
    )


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
    from dqforge.machines.flux_map_files.sheets import sheets

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
    by_name = {found: array for array in arrays for found in names.recognised(array)}
    axes = [by_name[axis] for axis in ("i_d", "i_q") if axis in by_name]
    rest = [array for array in arrays if all(array is not axis for axis in axes)]
    own = [array for array in rest if quantity in names.recognised(array)] or rest
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
