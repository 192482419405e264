"""Flux-map files: text tables, NPZ, MATLAB and HDF5 become the same raw points.

A file is first a list of named arrays; the names that finite-element and measurement tools use are recognised among
them, and the shapes tell whether they are axes, meshes or points.
"""

from __future__ import annotations

import importlib
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.flux_points import FluxPoints
from dqforge.machines.synchronous import FloatArray
from dqforge.machines.text_table import read_table

_QUANTITIES = ("i_d", "i_q", "psi_d", "psi_q")
_MOST_BYTES = 10**9
_MOST_POINTS = 4_000_000
_MOST_LISTED = 20
_LONGEST_NAME = 100

_MATRIX, _COMPRESSED = 14, 15
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Kinds of elements of a MATLAB 5 file, with numpy's names of the numbers."""

_STRUCT, _TEXT, _NUMERIC, _COMPLEX = 2, 4, range(6, 16), 0x800
"""Classes of its variables, and the flag of complex ones."""

_TAIL = r"s?(?:axis|vec|vector|grid|mesh|map|mat|table|data|values|list)?"
_CURRENT = re.compile(rf"(?:is?|cur|current)(dq|d|q){_TAIL}|(d|q)(?:axis)?current")
_FLUX = re.compile(
    rf"(?:[ψλφϕ]s?|psis?|lambdas?|lam|phis?|flux(?:linkage)?s?|linkage|f)(dq|d|q){_TAIL}|(d|q)(?:axis)?flux(?:linkage)?"
)
_UNIT_IN_NAME = re.compile(r".+?[\s_/\[(-]+(?:in\s+)?([A-Za-zµμ][A-Za-z·*. ]*?)\s*[])]?")


def _spellings(symbols: Mapping[str, float], prefixes: str) -> dict[str, float]:
    """Factor to the SI unit of every spelling of some symbols, with and without prefixes; all in small letters too."""
    scale = {"": 1.0, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "k": 1e3}
    known = {part + symbol: scale[part] * value for symbol, value in symbols.items() for part in ("", *prefixes)}
    return known | {symbol.upper(): value for symbol, value in symbols.items()} | {k.lower(): known[k] for k in known}


_UNITS = {
    "i": _spellings({"A": 1.0, "Apk": 1.0, "Apeak": 1.0}, "uµμmk"),
    "psi": _spellings({"Wb": 1.0, "Vs": 1.0, "Wbturn": 1.0, "Wbturns": 1.0, "Wbt": 1.0}, "uµμm"),
}
_EXPECTED = {"i": "A, mA or kA", "psi": "Wb, mWb, Vs or mVs"}


@dataclass(frozen=True, slots=True)
class _Entry:
    """One array of a file: where it stands, the last part of that, its values and its declared unit ('' if none)."""

    path: str
    name: str
    values: NDArray[Any]
    unit: str = ""

    @property
    def heading(self) -> str:
        """The name with its unit behind an underscore, as it may stand in a header line."""
        return f"{self.name}_{self.unit}"

    @property
    def group(self) -> str:
        """Where the array stands without its name."""
        return self.path.removesuffix(self.name)

    @property
    def labels(self) -> tuple[str, str, str]:
        """What a user may call the array."""
        return self.path, self.name, f"{self.name} [{self.unit}]"

    @property
    def title(self) -> str:
        """Path with shape, or with what the array holds instead of numbers."""
        kind, path = self.values.dtype.kind, f"{self.path} [{self.unit}]" if self.unit else self.path
        return f"{path} {self.values.shape}" if kind in "iufc" else f"{path} ({_held(kind)})"


def read_flux_points(
    content: bytes,
    source: str,
    *,
    current_unit: str | None = None,
    flux_unit: str | None = None,
    columns: Mapping[str, str] | None = None,
) -> FluxPoints:
    """Raw points of a flux-map file in its own order, grids row by row; NaN are passed on.

    A grid over two axes may have rows of i_d or of i_q: its shape tells, in a square one the physics. Among several
    maps in one file, SyR-e's `FluxMap_dq` comes first, then the one nearest to the root.

    Parameters
    ----------
    content:
        Bytes of the file.
    source:
        Its name; the suffix chooses the format: .csv, .tsv, .txt, .dat, .npz, .mat (4, 5, 7.3), .h5, .hdf5.
    current_unit, flux_unit:
        Units of the currents (A, mA, kA) and the flux linkages (Wb, mWb, Vs, mVs) where the file does not say them;
        A and Wb otherwise.
    columns:
        What 'i_d', 'i_q', 'psi_d', 'psi_q' are called in the file, where their names are not recognised. A complex
        array d + j q may be named for both axes.

    Raises
    ------
    InputError
        The file is none of its format, lacks an array, has shapes that do not fit, units that contradict each other or
        more than 4e6 points.
    """
    given = {"i": current_unit or "", "psi": flux_unit or ""}
    for kind, unit in given.items():
        if unit and _plain_unit(unit) not in _UNITS[kind]:
            raise InputError(f"the unit {unit!r} is not known; write {_EXPECTED[kind]}", source=source)
    entries = _reader(content, source)(content, source)
    chosen = _chosen(entries, columns or {}, source)
    with np.errstate(over="ignore", invalid="ignore"):  # infinities are for others to judge, as NaN are
        parts = {quantity: _scaled(quantity, chosen, given, source) for quantity in _QUANTITIES}
        points = _points(parts, source)
    return FluxPoints(source, *(np.ascontiguousarray(points[quantity].ravel()) for quantity in _QUANTITIES))


def _signature(content: bytes) -> str:
    """Format that the first bytes of a file tell, '' for text and for MATLAB 4, which has no mark."""
    if content[:4] in (b"PK\x03\x04", b"PK\x05\x06"):
        return "a ZIP archive"
    if any(content[place : place + 8] == b"\x89HDF\r\n\x1a\n" for place in (0, 512, 1024, 2048)):
        return "an HDF5 file"
    return "a MATLAB 5 file" if content[124:128] in (b"\0\1IM", b"\1\0MI") else ""


def _reader(content: bytes, source: str) -> Callable[[bytes, str], list[_Entry]]:
    """Function that reads a file's arrays, by its suffix and first bytes."""
    suffix = PurePath(source).suffix.lower()
    readers: dict[tuple[str, str], Callable[[bytes, str], list[_Entry]]] = {
        ("text", ""): _from_table,
        (".npz", "a ZIP archive"): _from_npz,
        (".mat", ""): _from_mat4,
        (".mat", "a MATLAB 5 file"): _from_mat5,
        (".mat", "an HDF5 file"): _from_hdf5,
        (".h5", "an HDF5 file"): _from_hdf5,
    }
    formats = dict.fromkeys((".csv", ".tsv", ".txt", ".dat"), "text") | dict.fromkeys((".h5", ".hdf5", ".hdf"), ".h5")
    form, found = formats.get(suffix, suffix), _signature(content)
    if form not in {key for key, _ in readers}:
        message = f"cannot read a flux map from a file with the suffix {suffix!r}"
        raise InputError(f"{message}; write .csv, .txt, .dat, .npz, .mat, .h5 or .hdf5", source=source)
    if (form, found) not in readers:
        wanted = " or ".join(mark for key, mark in readers if key == form and mark) or "text"
        message = f"the suffix {suffix} stands for {wanted}, the content is {found or 'something else'}"
        raise InputError(f"{message}; give the file the suffix of its format, or save it again", source=source)
    return readers[form, found]


def _from_table(content: bytes, source: str) -> list[_Entry]:
    """Columns of a text table."""
    table = read_table(content, source)
    columns = zip(table.names, table.units, table.values.T, strict=True)
    return [_Entry(name, name, values, unit) for name, unit, values in columns]


def _unreadable(error: Exception, form: str, source: str) -> InputError:
    """What to say of an archive that its library could not read."""
    if isinstance(error, InputError):
        return error
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return InputError(f"cannot read this {form} file ({reason}); save it again", source=source)


def _check_bytes(total: int, source: str) -> None:
    """Refuse arrays that take too much memory, as those of a small archive may."""
    if total > _MOST_BYTES:
        message = f"the arrays take more than {_MOST_BYTES / 1e9:g} GB"
        raise InputError(f"{message}; save those of the map alone", source=source)


def _from_npz(content: bytes, source: str) -> list[_Entry]:
    """Arrays of an NPZ archive; Python objects in it are never loaded."""
    entries = []
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _check_bytes(sum(member.file_size for member in archive.infolist()), source)
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            for name in arrays.files:
                try:
                    values = arrays[name]
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    values = np.empty((), dtype=object)
                if isinstance(values, np.ndarray):  # a member that is no array comes as bytes
                    entries.append(_Entry(name, name, values))
    except Exception as error:  # a damaged archive raises anything
        raise _unreadable(error, "NPZ", source) from error
    return entries


def _from_mat4(content: bytes, source: str) -> list[_Entry]:
    """Variables of a MATLAB 4 file."""
    from scipy.io import loadmat

    if 0 not in content[:4]:  # the first number, 0 to 4052, of the format that has no mark
        raise InputError("this is no MATLAB 4, 5 or 7.3 file; save it again", source=source)
    try:
        variables = loadmat(io.BytesIO(content))
    except Exception as error:
        raise _unreadable(error, "MATLAB", source) from error
    return [_Entry(name, name, values) for name, values in variables.items() if isinstance(values, np.ndarray)]


def _from_mat5(content: bytes, source: str) -> list[_Entry]:
    """Variables of a MATLAB 5 file (MathWorks, "MAT-File Format"), fields of structs with dotted paths."""
    # Not by scipy: damaged files crash its reader (segmentation fault in 1.17), and it inflates whatever there is.
    order = "<" if content[126:128] == b"IM" else ">"
    entries: list[_Entry] = []
    total = 0
    try:
        for kind, element in _elements(memoryview(content)[128:], order):
            variables = [(kind, element)]
            if kind == _COMPRESSED:
                inflated = zlib.decompressobj().decompress(element, _MOST_BYTES + 1 - total)
                total += len(inflated)
                _check_bytes(total, source)
                variables = list(_elements(memoryview(inflated), order))
            for inner, variable in variables:
                if inner == _MATRIX:
                    entries += _variable(variable, order)
    except Exception as error:
        raise _unreadable(error, "MATLAB", source) from error
    return entries


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Kinds and bytes of the elements of a MATLAB 5 file that stand one behind the other."""
    place = 0
    while place < len(content):
        kind, size = struct.unpack_from(f"{order}II", content, place)
        start, pad = place + 8, 0 if kind == _COMPRESSED else -size % 8
        if kind >> 16:  # up to four bytes stand within the tag
            kind, size, start, pad = kind & 0xFFFF, kind >> 16, place + 4, 4 - (kind >> 16)
        place = start + size + pad
        if start + size > len(content) or pad < 0:
            raise ValueError("it is cut off or damaged")
        yield kind, content[start : start + size]


def _variable(content: memoryview, order: str, path: str = "", name: str = "") -> Iterator[_Entry]:
    """Array of a MATLAB 5 matrix, or all arrays within a struct; cells, objects and sparse matrices hold no map."""
    parts = list(_elements(content, order))
    if not parts:
        return
    flags = struct.unpack_from(f"{order}I", parts[0][1])[0]
    form, shape = flags & 0xFF, _numbers(parts[1], order)
    name = name or bytes(parts[2][1]).decode("latin-1")
    path = path or name
    if form == _STRUCT and np.all(shape == 1):
        length, names = int(_numbers(parts[3], order)[0]), bytes(parts[4][1])
        for k, (_, field) in enumerate(parts[5:]):
            title = names[k * length : (k + 1) * length].split(b"\0")[0].decode("latin-1")
            yield from _variable(field, order, f"{path}.{title}", title)
    elif form == _TEXT:
        yield _Entry(path, name, np.broadcast_to(np.array("", dtype="U1"), shape))
    elif form in _NUMERIC:
        values = _numbers(parts[3], order)
        if flags & _COMPLEX:
            values = values + 1j * _numbers(parts[4], order)
        yield _Entry(path, name, values.reshape(shape, order="F"))


def _numbers(part: tuple[int, memoryview], order: str) -> NDArray[Any]:
    """Numbers of a MATLAB 5 element, shape (K,)."""
    return np.frombuffer(part[1], dtype=order + _STORED[part[0]])


def _from_hdf5(content: bytes, source: str) -> list[_Entry]:
    """Datasets of an HDF5 or MATLAB 7.3 file, wherever they stand in its tree."""
    try:
        h5py = importlib.import_module("h5py")
    except ImportError as error:
        name = "MAT 7.3" if source.lower().endswith(".mat") else "HDF5"
        message = f"reading {name} needs h5py; install it with: pip install dqforge[h5]"
        raise InputError(message, source=source) from error
    entries: list[_Entry] = []
    matlab, total = content[:10] == b"MATLAB 7.3", 0

    def visit(path: str, node: Any) -> None:
        nonlocal total
        # A dataset whose bytes lie in another file is not this file's; '#refs#' are the contents of MATLAB's cells.
        if not isinstance(node, h5py.Dataset) or node.shape is None or path.startswith("#"):
            return
        if node.external or node.is_virtual or "MATLAB_empty" in node.attrs:
            return
        values = _dataset(node)
        total += values.nbytes if any(values.strides) else 0
        _check_bytes(total, source)
        mirrored = matlab or "MATLAB_class" in node.attrs
        unit = node.attrs.get("units", node.attrs.get("unit", ""))
        shown = path.replace("/", ".") if matlab else path
        entries.append(_Entry(shown, path.rpartition("/")[2], values.T if mirrored else values, _text(unit)))

    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            file.visititems(visit)
    except Exception as error:
        raise _unreadable(error, "HDF5", source) from error
    return entries


def _dataset(node: Any) -> NDArray[Any]:
    """Values of an HDF5 dataset; a stand-in of its shape without memory where they cannot belong to a map."""
    numeric = node.dtype.kind in "iufc" or node.dtype.names == ("real", "imag")
    if _text(node.attrs.get("MATLAB_class", "")) == "char":
        return np.broadcast_to(np.array("", dtype="U1"), node.shape)
    if node.size > _MOST_POINTS or not numeric:
        return np.broadcast_to(np.zeros((), dtype=float if numeric else object), node.shape)
    values: NDArray[Any] = np.asarray(node[()])
    if values.dtype.names:
        values = values["real"] + 1j * values["imag"]
    return values


def _text(attribute: Any) -> str:
    """An HDF5 attribute as text, '' where it is none."""
    if isinstance(attribute, np.ndarray) and attribute.size == 1:
        attribute = attribute.item()
    if isinstance(attribute, bytes):
        return attribute.decode("utf-8", errors="replace").strip()
    return attribute.strip() if isinstance(attribute, str) else ""


def _held(kind: str) -> str:
    """What an array of a numpy kind holds, if not numbers."""
    names = {"O": "Python objects, cells or references", "U": "text", "S": "text", "b": "truth values"}
    return names.get(kind, "records")


def _plain_unit(unit: str) -> str:
    """A unit without the signs between its parts."""
    return re.sub(r"[\s*·.-]", "", unit)


def _split_name(name: str) -> tuple[str, str]:
    """Stem and unit of a name such as psi_d_mVs or 'i_d [A]', '' where it has no unit of these."""
    found = _UNIT_IN_NAME.fullmatch(name)
    if found and any(_plain_unit(found[1]) in units for units in _UNITS.values()):
        return name[: found.start(1)].rstrip(" _/[(-"), found[1]
    return name, ""


def _recognised(entry: _Entry) -> tuple[str, ...]:
    """Quantities that an array's name stands for: one, both axes of a complex array, or none."""
    if len(entry.name) > _LONGEST_NAME:
        return ()
    stem, unit = _split_name(entry.name)
    for kind, pattern in (("i", _CURRENT), ("psi", _FLUX)):
        for name in (entry.name, stem) if _plain_unit(unit) in _UNITS[kind] else (entry.name,):
            found = pattern.fullmatch(re.sub(r"[\W_]", "", name.casefold()))
            axes = (found[1] or found[2]) if found else ""
            if axes and (len(axes) == 1 or np.iscomplexobj(entry.values)):
                return tuple(f"{kind}_{axis}" for axis in axes)
    return ()


def _chosen(entries: Sequence[_Entry], columns: Mapping[str, str], source: str) -> dict[str, _Entry]:
    """The array of each quantity: what the user named, else the names recognised in one group, else in the file."""
    if wrong := [key for key in columns if key not in _QUANTITIES]:
        raise InputError(f"columns: unknown key {wrong[0]!r}; write {', '.join(_QUANTITIES)}", source=source)
    chosen = {quantity: _named(entries, name, source) for quantity, name in columns.items()}
    wanted = [quantity for quantity in _QUANTITIES if quantity not in chosen]
    everywhere: dict[str, list[_Entry]] = {}
    groups: dict[str, dict[str, list[_Entry]]] = {}
    for entry in entries:
        for quantity in _recognised(entry):
            everywhere.setdefault(quantity, []).append(entry)
            groups.setdefault(entry.group, {}).setdefault(quantity, []).append(entry)
    complete = [group for group, found in groups.items() if all(quantity in found for quantity in wanted)]
    first = min((_rank(group) for group in complete), default=None)
    candidates = [groups[group] for group in complete if _rank(group) == first] or [everywhere]
    if missing := [quantity for quantity in wanted if quantity not in everywhere]:
        message = f"no {' and '.join(missing)} found among {_listed(entries)}"
        raise InputError(f"{message}; write {_advice(missing)}", source=source)
    for quantity in wanted:
        found = [entry for group in candidates for entry in group[quantity]]
        found = [entry for entry in found if not np.iscomplexobj(entry.values)] or found
        if len(found) > 1:
            message = f"{len(found)} arrays may be {quantity}: {_listed(found)}"
            raise InputError(f"{message}; write {_advice([quantity])}", source=source)
        chosen[quantity] = found[0]
    return chosen


def _rank(group: str) -> tuple[bool, int]:
    """Order of groups that hold a whole map: SyR-e's map before its trajectories, the root before branches."""
    return not re.search(r"fluxmap_dq[./]$", group.lower()), group.count(".") + group.count("/")


def _named(entries: Sequence[_Entry], name: str, source: str) -> _Entry:
    """The array that a user named by its path, by the last part of it, or by a heading with its unit."""
    wanted = name.strip().lstrip("/")
    labels = (wanted, wanted, "{} [{}]".format(*_split_name(wanted)))
    for fold in (str, str.casefold):
        for k, label in enumerate(labels):
            found = [entry for entry in entries if fold(entry.labels[k]) == fold(label)]
            if len(found) > 1:
                raise InputError(f"columns: {name!r} is the name of {_listed(found)}; write one path", source=source)
            if found:
                return found[0]
    raise InputError(f"columns: no {name!r} found among {_listed(entries)}; write one of these names", source=source)


def _listed(entries: Sequence[_Entry]) -> str:
    """Names and shapes of arrays, in one line."""
    more = f" and {len(entries) - _MOST_LISTED} more" if len(entries) > _MOST_LISTED else ""
    return ", ".join(entry.title for entry in entries[:_MOST_LISTED]) + more if entries else "no arrays at all"


def _advice(quantities: Sequence[str]) -> str:
    return "columns: {" + ", ".join(f"{quantity}: NAME" for quantity in quantities) + "}"


def _scaled(quantity: str, chosen: Mapping[str, _Entry], given: Mapping[str, str], source: str) -> FloatArray:
    """Values of a quantity in A or Wb in the shape of the file, dimensions of length 1 dropped."""
    entry, (kind, axis) = chosen[quantity], quantity.split("_")
    values = entry.values
    if values.dtype.kind not in "iufc":
        message = f"{entry.path} holds {_held(values.dtype.kind)}, not numbers"
        raise InputError(f"{message}; save it as a plain array or write {_advice([quantity])}", source=source)
    if values.size > _MOST_POINTS:
        message = f"{entry.path} has {values.size} points, more than {_MOST_POINTS}"
        raise InputError(f"{message}; save a coarser map", source=source)
    if np.iscomplexobj(values):
        if chosen[f"{kind}_{'q' if axis == 'd' else 'd'}"] is entry:
            values = values.real if axis == "d" else values.imag
        elif np.any(values.imag):
            message = f"{entry.path} is complex; save its real part"
            advice = f"columns: {{{kind}_d: {entry.name}, {kind}_q: {entry.name}}}"
            raise InputError(f"{message}, or write {advice} if it is d + j q", source=source)
    return np.squeeze(np.asarray(values.real, dtype=np.float64)) * _factor(entry, kind, given[kind], source)


def _factor(entry: _Entry, kind: str, given: str, source: str) -> float:
    """Factor to A or Wb, by the name of an array, its declared unit and the given one, which must agree."""
    in_name = _split_name(entry.name)[1]
    key = "current_unit" if kind == "i" else "flux_unit"
    in_name = in_name if _plain_unit(in_name) in _UNITS[kind] else ""
    said = {"its name": in_name, "the file": entry.unit, key: given}
    factors: dict[float, str] = {}
    for who, unit in said.items():
        if unit and _plain_unit(unit) not in _UNITS[kind]:
            message = f"{entry.path} has the unit {unit!r} by {who}"
            raise InputError(f"{message}, which is not known; write {_EXPECTED[kind]}", source=source)
        if unit:
            factors.setdefault(_UNITS[kind][_plain_unit(unit)], f"{unit} by {who}")
    if len(factors) > 1:
        raise InputError(f"{entry.path} is in {' but in '.join(factors.values())}; correct one of them", source=source)
    return next(iter(factors), 1.0)


def _points(parts: Mapping[str, FloatArray], source: str) -> dict[str, FloatArray]:
    """The four arrays in one shape: axes are spread over the grid."""
    i_d, i_q, psi_d, psi_q = (parts[quantity] for quantity in _QUANTITIES)
    shape = psi_d.shape
    if psi_q.shape == shape and psi_d.ndim <= 2 and psi_d.size > 0:
        if i_d.shape == shape and i_q.shape == shape:
            return dict(parts)
        axes = _rows_and_columns(i_d, i_q, psi_d, psi_q)
        if axes is not None:
            return {**parts, "i_d": np.broadcast_to(axes[0], shape), "i_q": np.broadcast_to(axes[1], shape)}
    shapes = ", ".join(f"{quantity} {values.shape}" for quantity, values in parts.items())
    advice = "save axes of M and N points with flux linkages of shape (M, N), or four arrays of one shape"
    raise InputError(f"the shapes do not fit together: {shapes}; {advice}", source=source)


def _rows_and_columns(
    i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Currents that broadcast to a grid of flux linkages, where at least one current is an axis; None if none does."""
    if psi_d.ndim != 2:
        return None
    if psi_d.shape in (i_d.shape, i_q.shape):
        mesh, axis = (i_d, i_q) if i_d.shape == psi_d.shape else (i_q, i_d)
        changes = [float(np.nansum(np.abs(np.diff(mesh, axis=k)))) for k in (0, 1)]
        along = int(changes[0] > changes[1])
        if axis.shape != (psi_d.shape[along],):
            return None
        spread = axis if along else axis[:, np.newaxis]
        return (mesh, spread) if mesh is i_d else (spread, mesh)
    fits, turned = psi_d.shape == i_d.shape + i_q.shape, psi_d.shape == i_q.shape + i_d.shape
    if turned and not (fits and _rows_are_d(i_d, i_q, psi_d, psi_q)):
        return i_d, i_q[:, np.newaxis]
    return (i_d[:, np.newaxis], i_q) if fits else None


def _rows_are_d(i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray) -> bool:
    """Whether the rows of a square grid belong to i_d, which its shape cannot tell.

    The incremental inductances of a passive winding are positive definite, so that the flux linkages turn in the same
    sense as the currents do; a transposed grid turns the other way. Axes that are permuted, reversed or scaled in both
    the currents and the flux linkages do not change the sense. What has no sense at all has rows of i_d.
    """
    (d_down, d_right), (q_down, q_right) = (
        (psi[1:, :-1] - psi[:-1, :-1], psi[:-1, 1:] - psi[:-1, :-1]) for psi in (psi_d, psi_q)
    )
    area = d_down * q_right - d_right * q_down
    step_d, step_q = np.sign(np.diff(i_d)), np.sign(np.diff(i_q))
    as_rows, as_columns = (np.nansum(area * np.outer(*steps)) for steps in ((step_d, step_q), (step_q, step_d)))
    return not bool(as_rows < -as_columns)
