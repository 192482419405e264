"""Reading a bench file: what is known, and the logs of its runs, with all faults at once."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_file import (
    Bench,
    BenchFile,
    KnownMachine,
    LoggedRun,
    LogPart,
    RunSection,
)
from dqforge.machines.bench.log_columns import (
    KINDS,
    QUANTITIES,
    ColumnFault,
    Wanted,
    dead,
    in_si,
    looks_requested,
    not_found,
    value_of,
    wanted,
)
from dqforge.machines.bench.log_files import MOST_BYTES, LogTable, read_log
from dqforge.machines.design.design import (
    flux_from_back_emf,
    flux_from_kv,
    flux_from_torque_constant,
    peak_flux,
)
from dqforge.machines.entries.former_keys import read_model
from dqforge.machines.entries.kinds import quantities
from dqforge.machines.errors import InputError, KeyPath, Places, dotted
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.files.positioned_yaml import YamlDocument, parse_yaml, read_bytes
from dqforge.machines.files.text_table import Progress

# Rows from which something can be said; fewer are refused before any fit.
_LEAST_ROWS = 3
_FLUX_KEYS = ("magnet_flux", "back_emf_constant", "torque_constant", "kv")


def read_bench(path: Path, progress: Progress | None = None) -> Bench:
    """A bench file with the logs that it names.

    Args:
        path: The file.
        progress: Told the share of a large log that is read.

    Raises:
        InputError: The file or a log cannot be read or is wrong, with the position in the bench
            file; the faults of all runs at once.
    """
    text = read_bytes(path)
    document = _parsed(text, str(path))
    file = read_model(document, BenchFile)
    pole_pairs = round(file.machine.pole_pairs.si)
    runs, faults = [], []
    for index, section in enumerate(file.runs):
        try:
            reading = _Reading(document, path.parent, pole_pairs, index, section, progress)
            runs.append(reading.run())
        except InputError as fault:
            faults += [fault, *fault.others]
    faults += _same_names(document, file)
    known, origins = _known(file.machine, pole_pairs)
    shares = {str(path[-1]): entry.si for path, entry in quantities(file.uncertainty)}
    faults += [
        document.error(
            f"uncertainty.{key}: machine has no {key} to which it could belong; write one",
            ("uncertainty", key),
        )
        for key in shares
        if key not in known
    ]
    if faults:
        first, *others = sorted(faults, key=lambda fault: (fault.line or 0, fault.column or 0))
        first.others = tuple(others)
        raise first
    entries = {name: _entries(document, name) for name in ("machine", "inverter")}
    digest = hashlib.sha256(text).hexdigest()
    places = Places(str(path), document.keys, document.values, tuple(BenchFile.model_fields))
    return Bench(
        file.name,
        file.about,
        path.name,
        digest,
        pole_pairs,
        known,
        origins,
        entries,
        file.inverter.v_dc.si if file.inverter.v_dc is not None else None,
        {key: share * known[key] for key, share in shares.items()},
        tuple(runs),
        places,
    )


def _parsed(text: bytes, source: str) -> YamlDocument:
    if not text.strip():
        raise InputError(
            "the file is empty; a bench file begins with dqforge_bench: 1",
            source=source,
            line=1,
            column=1,
        )
    document = parse_yaml(text, source)
    for key, what in (("dqforge", "design"), ("dqforge_study", "study")):
        if key in document.data and "dqforge_bench" not in document.data:
            raise document.error(
                f"this is a {what}; a bench file begins with dqforge_bench: 1", (key,), key=True
            )
    return document


def _entries(document: YamlDocument, name: str) -> dict[str, Any]:
    section = document.data.get(name, {})
    return dict(section) if isinstance(section, dict) else {}


def _same_names(document: YamlDocument, file: BenchFile) -> Iterator[InputError]:
    names = [run.name for run in file.runs]
    for index, name in enumerate(names):
        if name in names[:index]:
            before = names.index(name)
            yield document.error(
                f"runs[{index}].name: runs[{before}] has the same name; write another",
                ("runs", index, "name"),
            )


def _known(machine: KnownMachine, pole_pairs: int) -> tuple[dict[str, float], dict[str, str]]:
    """Values in SI units by the key of a design, and the keys that they come from."""
    known = {str(path[-1]): entry.si for path, entry in quantities(machine)}
    del known["pole_pairs"]
    origins = {key: key for key in known}
    if machine.resistance is not None and machine.resistance.kind == "line-to-line":
        known["resistance"] /= 2.0
    for key in ("inductance", "inductance_d", "inductance_q"):
        entry = getattr(machine, key)
        if entry is not None and entry.kind == "line-to-line":
            known[key] /= 2.0
    for key in _FLUX_KEYS:
        entry = getattr(machine, key)
        if entry is None:
            continue
        del known[key]
        # The first of the keys that are given; a design lets several agree.
        if "magnet_flux" not in origins or origins["magnet_flux"] == key:
            known["magnet_flux"] = _flux(key, entry.si, entry.kind, pole_pairs)
            origins["magnet_flux"] = key
    return known, {key: origins[key] for key in known}


def _flux(key: str, value: float, kind: str | None, pole_pairs: int) -> float:
    if key == "magnet_flux":
        return peak_flux(value, kind or "peak")
    if key == "kv":
        return flux_from_kv(value, kind or "line-to-line peak", pole_pairs)
    if key == "torque_constant":
        return flux_from_torque_constant(value, kind or "peak", pole_pairs)
    return flux_from_back_emf(value, kind or "phase peak", pole_pairs)


class _Reading:
    """One run while it is read."""

    def __init__(
        self,
        document: YamlDocument,
        folder: Path,
        pole_pairs: int,
        index: int,
        section: RunSection,
        progress: Progress | None,
    ) -> None:
        self.document = document
        self.folder = folder
        self.pole_pairs = pole_pairs
        self.path: KeyPath = ("runs", index)
        self.index = index
        self.section = section
        self.progress = progress
        self.kind = KINDS[section.kind]

    def fault(self, message: str, *path: str, key: bool = False) -> InputError:
        whole = (*self.path, *path)
        return self.document.error(f"{dotted(whole)}: {message}", whole, key=key)

    def run(self) -> LoggedRun:
        """The run; raises `InputError` with all that is wrong with it."""
        faults = list(self._settings())
        tables, contents = self._tables()
        try:
            asked, still = wanted(
                self.section.columns, self.section.kind, tables[0].preset if tables else {}
            )
            constants = {name: value_of(name, raw, self.pole_pairs) for name, raw in still.items()}
            parts, more = self._parts(tables, contents, asked)
            faults += more
            faults += self._missing(parts, constants)
        except ColumnFault as one:
            faults.append(self.fault(one.message, "columns", *one.path))
            raise _joined(faults) from None
        if faults:
            raise _joined(faults)
        gaps = tuple(_with_gaps(self.section.name, tables, parts))
        parts, cut = _rising(self.section.name, parts)
        remarks = [*gaps, *cut]
        remarks += [
            f"{self.section.name}: the column {one.column} looks like a requested current, and the "
            "file calls it measured; a setpoint is not the current that flowed"
            for one in asked
            if self.kind.currents and looks_requested(one)
        ]
        return LoggedRun(
            self.index,
            self.section.name,
            self.section.kind,
            tuple(parts),
            constants,
            self.section.voltage or ("reference" if self._is_of_a_tool else None),
            tuple(remarks),
        )

    @property
    def _is_of_a_tool(self) -> bool:
        """Whether the tool that wrote the log keeps measured currents and voltage references."""
        return self.section.format in ("vesc-tool", "moteus-ld", "motortest")

    def _settings(self) -> Iterator[InputError]:
        section = self.section
        if section.currents == "requested" and self.kind.currents:
            yield self.fault(
                "requested currents are not those that flowed, and the error of the loop would "
                "become one of the machine; log the measured ones",
                "currents",
            )
        if self.kind.currents and section.currents is None and not self._is_of_a_tool:
            yield self.fault(
                f"{section.name}: whether the currents are measured or requested must be said; "
                "write currents: measured",
                key=True,
            )
        takes_voltage = any(name.startswith(("u_", "voltage")) for name in self.kind.quantities)
        if takes_voltage and section.voltage is None and not self._is_of_a_tool:
            yield self.fault(
                f"{section.name}: whether the voltages are measured or references must be said; "
                "write voltage: reference, or measured",
                key=True,
            )
        if (section.file is None) == (section.files is None):
            yield self.fault(f"{section.name}: a run has one log; write file: log.csv", key=True)
        if section.files is not None and section.kind != "offset-sweep":
            yield self.fault("several logs are several runs; write file", "files", key=True)

    def _tables(self) -> tuple[list[LogTable], list[bytes]]:
        tables, contents = [], []
        entries = (
            {"column": raw} if isinstance(raw, str) else raw
            for raw in self.section.columns.values()
        )
        asked = {str(entry.get("column")) for entry in entries if isinstance(entry, dict)}
        names = self.section.files or ((self.section.file,) if self.section.file else ())
        for name in names:
            try:
                content = read_regular_file(self.folder / name, MOST_BYTES, shown=name)
                tables.append(read_log(content, name, self.section.format, asked, self.progress))
                contents.append(content)
            except InputError as error:
                if error.line is not None:
                    raise  # which has its place in the log
                key = "file" if self.section.files is None else "files"
                raise self.fault(f"{name}: {error.message}", key) from None
        return tables, contents

    def _parts(
        self, tables: list[LogTable], contents: list[bytes], asked: list[Wanted]
    ) -> tuple[list[LogPart], list[InputError]]:
        """Each log with the asked columns that it has; rows with a gap in any are left out."""
        parts, faults = [], []
        found: set[str] = set()
        for table, content in zip(tables, contents, strict=True):
            columns: dict[str, FloatArray] = {}
            for one in asked:
                try:
                    values = in_si(table, one, self.pole_pairs)
                except ColumnFault as fault:
                    faults.append(self.fault(fault.message, "columns", *fault.path))
                    found.add(one.quantity)
                    continue
                if values is not None:
                    columns[one.quantity] = values
            found |= columns.keys()
            whole = np.all([np.isfinite(each) for each in columns.values()], axis=0)
            kept = np.broadcast_to(whole, table.lines.shape)
            parts.append(
                LogPart(
                    table.source,
                    hashlib.sha256(content).hexdigest(),
                    {name: np.ascontiguousarray(each[kept]) for name, each in columns.items()},
                    table.lines[kept],
                    table.said,
                )
            )
            faults += self._dead(table.source, parts[-1])
        empty = [name for table in tables for name in table.empty]
        bare = [one for one in asked if one.column in empty and one.quantity not in found]
        if bare:
            names = ", ".join(one.column for one in bare)
            files = " and ".join(table.source for table in tables)
            faults.append(
                self.fault(
                    f"{files} is not filled in: no number in {names}; fill the sheet with what was "
                    "measured",
                    "file" if self.section.files is None else "files",
                )
            )
            found |= {one.quantity for one in bare}
        for one in asked:
            # What a format usually has may be missing.
            if one.quantity not in found and one.quantity in self.section.columns:
                absent = not_found(tables, one)
                faults.append(self.fault(absent.message, "columns", *absent.path))
        return parts, faults

    def _dead(self, source: str, part: LogPart) -> Iterator[InputError]:
        rows = part.rows.size
        if part.columns and rows < _LEAST_ROWS:
            yield self.fault(f"{source} has {rows} rows of all columns; it needs {_LEAST_ROWS}")
        for quantity in ("torque", "time"):
            values = part.columns.get(quantity)
            if values is not None and rows >= _LEAST_ROWS and dead(values):
                yield self.fault(
                    f"the column of {quantity} holds {values[0]:g} in all {rows} rows of {source}: "
                    "a dead channel; repair it, or leave the column out",
                    "columns",
                    quantity,
                )

    def _missing(self, parts: list[LogPart], constants: dict[str, float]) -> Iterator[InputError]:
        there = {name for part in parts for name in part.columns} | constants.keys()
        for group in self.kind.needs:
            if there.isdisjoint(group) and all(name not in self.section.columns for name in group):
                reason = (
                    ": nothing dynamic follows from rows without times"
                    if group == ("time",)
                    else ""
                )
                unit = _EXAMPLES.get(QUANTITIES[group[0]], "")
                yield self.fault(
                    f"a run of kind {self.section.kind} ({self.kind.about}) needs a column of "
                    f"{' or '.join(group)}{reason}; write {group[0]}: "
                    f"{{column: name{unit}}}",
                    "columns",
                    key=True,
                )


def _with_gaps(name: str, tables: list[LogTable], parts: list[LogPart]) -> Iterator[str]:
    """A remark on each log that has rows without a number in a column that was asked."""
    for table, part in zip(tables, parts, strict=True):
        lost = table.lines.size - part.rows.size
        if lost and part.columns:
            first = int(np.setdiff1d(table.lines, part.rows)[0])
            yield (
                f"{name}: {lost} of {table.lines.size} rows of {part.file} have a gap in a column "
                f"that is read, line {first} first; they are left out"
            )


def _rising(name: str, parts: list[LogPart]) -> tuple[list[LogPart], tuple[str, ...]]:
    """Logs without a tail whose times fall back, as a buffer that was not filled has it."""
    found, remarks = [], []
    for part in parts:
        time = part.columns.get("time")
        back = np.flatnonzero(np.diff(time) <= 0.0) if time is not None else np.empty(0, np.intp)
        kept = int(back[0]) + 1 if back.size else part.rows.size
        if time is not None and kept < part.rows.size and time[kept:].max() <= time[kept - 1]:
            left = part.rows.size - kept
            remarks.append(f"{name}: {left} rows at the end, whose times fall back, are left out")
            columns = {quantity: values[:kept] for quantity, values in part.columns.items()}
            found.append(replace(part, columns=columns, rows=part.rows[:kept]))
        else:
            found.append(part)
    return found, tuple(remarks)


_EXAMPLES = {"time": ", unit: ms", "current": ", unit: A", "voltage": ", unit: V"}


def _joined(faults: list[InputError]) -> InputError:
    first, *others = faults
    first.others = tuple(others)
    return first
