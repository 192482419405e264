"""Logs in the files of benches and controllers: named columns of numbers, by format."""

from __future__ import annotations

import gc
import importlib
import io
import json
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_file import LogFormat
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import (
    NamedArray,
    arrays_of_hdf5,
    arrays_of_mat4,
    arrays_of_mat5,
    arrays_of_npz,
    reading,
)
from dqforge.machines.files.text_table import Progress, read_table
from dqforge.machines.records import dataclass

# What a controller's own columns are and their units, by our names.
Preset = Mapping[str, tuple[str, str]]


@dataclass(frozen=True, slots=True)
class LogTable:
    """Columns of a log as it holds them.

    ``units`` are '' where the file gives none; ``lines`` are the one-based lines, or rows, of the
    values; ``preset`` names columns that the format itself knows; ``said`` are values of the
    machine that stand in the log, in SI units, with their key there; ``others`` names of columns
    that were not asked for, ``empty`` of columns in which no row has anything.
    """

    source: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.intp]
    preset: Preset = field(default_factory=dict)
    said: Mapping[str, tuple[float, str]] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    empty: tuple[str, ...] = ()


# A number as NumPy 2 prints it in a list, and rows that end with the delimiter of other files.
_NUMPY_CELL = re.compile(rb"np\.float\d+\(([^()\n]*)\)")
_ROW_END = re.compile(rb";[ \t]*(?=\r?\n|\Z)")

_VESC: Preset = {
    "time": ("ms_today", "ms"),
    "i_d": ("d_axis_current", "A"),
    "i_q": ("q_axis_current", "A"),
    "u_d": ("d_axis_voltage", "V"),
    "u_q": ("q_axis_voltage", "V"),
    "speed": ("erpm", "erpm"),
    "temperature": ("temp_motor", "degC"),
    "v_dc": ("input_voltage", "V"),
    "duty": ("duty_cycle", ""),
}
_BURST: Preset = {
    "time": ("time_relative_ms", "ms"),
    "current": ("current_A", "A"),
    "torque": ("measured_torque_Nm", "N m"),
    "temperature": ("motor_temperature_C", "degC"),
}
_LD: Preset = {
    "i_d": ("i_d", "A"),
    "speed": ("omega", "electrical rad/s"),
    "u_q_less_drop": ("y", "V"),
}


# Names of columns, with or without their unit, that a reader may leave the others out for.
Asked = Collection[str]
MOST_BYTES = 640_000_000  # A ride of a million rows of all that VESC Tool writes.


def read_log(
    content: bytes,
    source: str,
    form: LogFormat,
    asked: Asked = (),
    progress: Progress | None = None,
) -> LogTable:
    """Columns of a log.

    Args:
        content: Bytes of the file.
        source: Its name, for messages and, by its ending, for the format ``auto``.
        form: What it is.
        asked: Columns that a large file is read for, beside those that its format knows; all
            where it has none of them.
        progress: Told the share of a large text that is read.

    Raises:
        InputError: It is not what it claims to be, or the library that reads it is not installed.
    """
    form = by_ending(source) if form == "auto" else form
    if form in ("text", "vesc-tool"):
        return _text(content, source, asked, _VESC if form == "vesc-tool" else {}, progress)
    if form in _SAMPLED:
        return _one_base(_SAMPLED[form](content, source), source, asked)
    return _READERS[form](content, source)


def by_ending(source: str) -> LogFormat:
    """Format of a file by the ending of its name; text where that says nothing."""
    return _ENDINGS.get(PurePath(source).suffix.lower(), "text")


def _text(
    content: bytes, source: str, asked: Asked, preset: Preset, progress: Progress | None
) -> LogTable:
    content = _NUMPY_CELL.sub(rb"\1", content)
    head = content[:_HEAD]
    # Where the semicolon parts columns a row has more than the last one.
    if b";" in head and head.count(b";") <= head.count(b"\n") + 1:
        ended = _ROW_END.findall(content)
        if content.count(b";") == len(ended):
            content = _ROW_END.sub(b"", content)
    names = {*asked, *(name for name, _ in preset.values())}

    def wanted(name: str, unit: str) -> bool:
        return name in names or f"{name} [{unit}]" in names

    table = read_table(content, source, progress, wanted=wanted, most_bytes=MOST_BYTES)
    if preset and "erpm" not in table.names:
        raise InputError(
            "this is no log of VESC Tool: it has no column erpm; write format: text",
            source=source,
            line=1,
        )
    return LogTable(
        source,
        table.names,
        table.units,
        table.values,
        table.lines,
        preset,
        others=table.others,
        empty=table.empty,
    )


_HEAD = 1 << 16


def _arrays(
    read: Callable[[bytes, str], list[NamedArray]], content: bytes, source: str
) -> LogTable:
    """Vectors of one length among the arrays of a file: those that most have."""
    vectors = [
        array
        for array in read(content, source)
        if array.numeric
        and array.values.dtype.kind != "c"
        and max(array.values.shape, default=0) > 1
        and array.values.size == max(array.values.shape)
    ]
    sizes = [array.values.size for array in vectors]
    if not sizes:
        raise InputError(
            "no vectors of numbers; save one vector for each quantity, all of one length",
            source=source,
        )
    size = max(set(sizes), key=lambda one: (sizes.count(one), one))
    kept = [array for array in vectors if array.values.size == size]
    return LogTable(
        source,
        tuple(array.path.lstrip("/") for array in kept),
        tuple(array.unit for array in kept),
        np.column_stack([array.values.ravel().astype(float) for array in kept]),
        np.arange(1, size + 1),
    )


def _mat(content: bytes, source: str) -> LogTable:
    if content[:8] == b"\x89HDF\r\n\x1a\n" or content[:20].startswith(b"MATLAB 7.3"):
        return _arrays(arrays_of_hdf5, content, source)
    if content[:6] == b"MATLAB":
        return _arrays(arrays_of_mat5, content, source)
    return _arrays(arrays_of_mat4, content, source)


def _parquet(content: bytes, source: str) -> LogTable:
    parquet: Any = importlib.import_module("pyarrow.parquet")
    buffer: Any = importlib.import_module("pyarrow").BufferReader(content)
    with reading("Parquet", source):
        table = parquet.read_table(buffer)
        numbers = {}
        for name in table.column_names:
            values = np.asarray(table.column(name).to_numpy())
            if values.dtype.kind in "iuf":
                numbers[str(name)] = values.astype(float)
    if not numbers:
        raise InputError("no columns of numbers; save them as numbers", source=source)
    rows = len(next(iter(numbers.values())))
    return LogTable(
        source,
        tuple(numbers),
        ("",) * len(numbers),
        np.column_stack(list(numbers.values())),
        np.arange(1, rows + 1),
    )


# Channels of recorders, which may be sampled at several rates.


@dataclass(frozen=True, slots=True)
class _Channel:
    """A channel with its values, shape (N,), the times of these in s, shape (N,), where it is
    known when they were sampled, and what else tells it from one of the same name.
    """

    name: str
    unit: str
    values: FloatArray
    times: FloatArray | None
    group: str


@contextmanager
def _asking(module: str, form: str, source: str) -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        message = f"reading {form} needs {module}; install it with: pip install dqforge[logs]"
        raise InputError(message, source=source) from error


def _mdf(content: bytes, source: str) -> list[_Channel]:
    with _asking("asammdf", "MDF", source):
        library: Any = importlib.import_module("asammdf")
    found = []
    with reading("MDF", source), _opened(library, content) as log:
        for group, held in enumerate(log.groups):
            for index, channel in enumerate(held.channels):
                if index == log.masters_db.get(group):
                    continue
                signal = log.get(group=group, index=index, ignore_invalidation_bits=False)
                if signal.samples.ndim == 1 and signal.samples.dtype.kind in "iuf":
                    values = signal.samples.astype(float)
                    times = np.asarray(signal.timestamps, dtype=float)
                    unit = signal.unit or ""
                    found.append(_Channel(channel.name, unit, values, times, str(group)))
    return found


def _opened(library: Any, content: bytes) -> Any:
    """An MDF file; one that cannot be read leaves half an object, whose end is a message too."""
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        try:
            return library.MDF(io.BytesIO(content))
        except Exception as error:
            reason = str(error)
        gc.collect()
    finally:
        sys.unraisablehook = hook
    raise ValueError(reason)


def _tdms(content: bytes, source: str) -> list[_Channel]:
    with _asking("nptdms", "TDMS", source):
        library: Any = importlib.import_module("nptdms")
    found = []
    with reading("TDMS", source):
        for group in library.TdmsFile.read(io.BytesIO(content)).groups():
            for channel in group.channels():
                values = np.asarray(channel[:])
                if values.ndim != 1 or values.dtype.kind not in "iuf":
                    continue
                clocked = "wf_increment" in channel.properties
                times = np.asarray(channel.time_track(), dtype=float) if clocked else None
                unit = str(channel.properties.get("unit_string", ""))
                kept = values.astype(float)
                found.append(_Channel(channel.name, unit, kept, times, group.name))
    return found


def _one_base(channels: Sequence[_Channel], source: str, asked: Asked) -> LogTable:
    """Those channels that were sampled together: with the asked ones, else most of all.

    Raises:
        InputError: There are none, or asked ones were sampled at different times.
    """
    names = [one.name for one in channels]
    labels = [
        one.name if names.count(one.name) == 1 else f"{one.group}/{one.name}" for one in channels
    ]
    bases: dict[tuple[int, bytes], list[int]] = {}
    for place, one in enumerate(channels):
        key = one.values.size, b"" if one.times is None else one.times.tobytes()
        bases.setdefault(key, []).append(place)
    if not bases:
        raise InputError("no channels of numbers; save them as numbers", source=source)
    wanted = [
        [label for label in (labels[place] for place in places) if label in asked]
        for places in bases.values()
    ]
    apart = [found[0] for found in wanted if found]
    if len(apart) > 1:
        raise InputError(
            f"{apart[0]} and {apart[1]} were not sampled at the same times; save them resampled "
            "to one time axis",
            source=source,
        )
    chosen = max(
        zip(wanted, bases.values(), strict=True), key=lambda pair: (len(pair[0]), len(pair[1]))
    )[1]
    columns = [(labels[place], channels[place].unit, channels[place].values) for place in chosen]
    times = channels[chosen[0]].times
    if times is not None and "time" not in labels:
        columns.insert(0, ("time", "s", times))
    rows = columns[0][2].size
    return LogTable(
        source,
        tuple(name for name, _, _ in columns),
        tuple(unit for _, unit, _ in columns),
        np.column_stack([values for _, _, values in columns]),
        np.arange(1, rows + 1),
        others=tuple(label for place, label in enumerate(labels) if place not in chosen),
    )


def _json(content: bytes, source: str, what: str) -> dict[str, Any]:
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"this is no JSON of {what}; name such a file", source=source)
    return found


def _moteus(content: bytes, source: str) -> LogTable:
    """The sweep that moteus_tool stores: voltage less R i_q over electrical speed, by level."""
    found = _json(content, source, "moteus_tool")
    try:
        rows = [
            (float(level), float(point["omega"]), float(point["y"]))
            for level, points in found["raw"].items()
            for point in points
        ]
        said = _moteus_said(found.get("params", {}))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(
            "no levels of points with omega and y under raw; name a sweep of moteus_tool",
            source=source,
        ) from None
    values = np.array(rows, dtype=float).reshape(-1, 3)
    lines = np.arange(1, len(rows) + 1)
    return LogTable(
        source, ("i_d", "omega", "y"), ("A", "electrical rad/s", "V"), values, lines, _LD, said
    )


def _moteus_said(params: Mapping[str, Any]) -> dict[str, tuple[float, str]]:
    said = {}
    if "R" in params:
        said["resistance"] = (float(params["R"]), "params.R")
    if "v_per_hz" in params and "poles" in params:
        # Volts per mechanical revolution and second, over 2 pi p.
        flux = float(params["v_per_hz"]) / (np.pi * float(params["poles"]))
        said["magnet_flux"] = (flux, "params.v_per_hz")
    return said


def _motortest(content: bytes, source: str) -> LogTable:
    """Torque bursts of a locked motor as motorTest stores them."""
    found = _json(content, source, "motorTest")
    try:
        rows = found["torque_burst_test"]["data"]
        names = tuple(name for name, value in rows[0].items() if isinstance(value, (int, float)))
        values = np.array([[float(row[name]) for name in names] for row in rows])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        raise InputError(
            "no rows under torque_burst_test.data; name a result of motorTest", source=source
        ) from None
    said = {}
    if isinstance(found.get("kv_rating"), (int, float)) and found["kv_rating"] > 0:
        said["kv"] = (float(found["kv_rating"]), "kv_rating")
    lines = np.arange(1, len(rows) + 1)
    return LogTable(source, names, ("",) * len(names), values, lines, _BURST, said)


_READERS: dict[LogFormat, Callable[[bytes, str], LogTable]] = {
    "npz": lambda content, source: _arrays(arrays_of_npz, content, source),
    "hdf5": lambda content, source: _arrays(arrays_of_hdf5, content, source),
    "mat": _mat,
    "parquet": _parquet,
    "moteus-ld": _moteus,
    "motortest": _motortest,
}
_SAMPLED: dict[LogFormat, Callable[[bytes, str], list[_Channel]]] = {"mdf": _mdf, "tdms": _tdms}
_ENDINGS: dict[str, LogFormat] = {
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".mat": "mat",
    ".parquet": "parquet",
    ".mf4": "mdf",
    ".mdf": "mdf",
    ".tdms": "tdms",
}
