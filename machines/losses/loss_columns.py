"""Loss columns of finite-element maps: core, magnet and mechanical loss over the currents, at one
frequency or at several, become a loss map.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.dq_machines.flux_map import FluxMap, complete_by_symmetry
from dqforge.machines.dq_machines.map_deviations import axis_of
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray, listed
from dqforge.machines.flux_maps.building import conversion_findings, converted
from dqforge.machines.flux_maps.coordinates import claims, in_si, unit_of
from dqforge.machines.flux_maps.flux_points import SAME, FluxPoints
from dqforge.machines.flux_maps.map_files import named_arrays
from dqforge.machines.flux_maps.map_names import (
    EXPECTED,
    PARTS,
    advice,
    loss_named,
    named_by_user,
    recognised,
)
from dqforge.machines.losses.loss_map import LossMap
from dqforge.machines.names import FluxAxes, FluxScaling
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

# Difference of a sum from its parts over it beyond which they contradict each other.
_SUM = 0.01
# Residual of the fit over the frequency, as a share of the largest loss, that is told.
_TOLD = 0.02


@dataclass(frozen=True, slots=True)
class DeclaredLoss:
    """What a design says of a file with losses.

    ``frequency`` in rad/s (electrical), 0 where the file has it; ``exponent`` of the iron loss with
    the frequency, None where the file tells.
    """

    pole_pairs: int
    frequency: float = 0.0
    exponent: float | None = None
    axes: FluxAxes = "magnet-d"
    scaling: FluxScaling | None = None


@dataclass(frozen=True, slots=True)
class LossMapReading:
    """A loss map with what was found; ``mechanical`` is the largest mechanical loss in W at the
    speed of the map, None where the file has none.
    """

    loss_map: LossMap
    findings: tuple[str, ...]
    mechanical: float | None = None


@dataclass(frozen=True, slots=True)
class _Rows:
    """Points of a file in A (peak, d along the magnets), rad/s and W, arrays of shape (K,)."""

    source: str
    i_d: FloatArray
    i_q: FloatArray
    omega: FloatArray
    losses: Mapping[str, FloatArray]
    lines: IndexArray | None

    def error(self, what: str, row: int) -> InputError:
        """A message about one point, with its line where the file is a text."""
        line = None if self.lines is None else int(self.lines[row])
        return InputError(f"{what} at {self.place(row)}", source=self.source, line=line)

    def place(self, row: int) -> str:
        """Where a point is, in words."""
        return f"i_d = {self.i_d[row]:.4g} A, i_q = {self.i_q[row]:.4g} A"


def read_loss_map(
    content: bytes, source: str, declared: DeclaredLoss, columns: Mapping[str, str] | None = None
) -> LossMapReading:
    """Loss map of a file with a column for each current and each loss.

    At one frequency the columns hysteresis (with f), eddy and magnet (with f^2) say how they grow,
    and a sum ``iron`` needs an exponent. At several, each point's P/f = k_h + k_e f, both zero or
    positive, by least squares.

    Args:
        content: Bytes of the file.
        source: Its name.
        declared: What the design says of it.
        columns: What currents, losses, 'frequency' and 'speed' are called where their names are not
            recognised.

    Raises:
        InputError: A column or the frequency is missing or has no unit, a loss is below zero or no
            number (with its line), the points are no grid, or nothing says how the loss grows.
    """
    rows, findings = _rows(content, source, declared, columns or {})
    i_d, i_q, cell = _grid(rows)
    omegas = np.unique(rows.omega)
    several = omegas.size > 1
    omega = float(omegas[-1])
    losses = dict(rows.losses)
    mechanical = losses.pop("mechanical", None)
    exponent, told = 1.0, list[str]()
    if several:
        if declared.exponent is not None:
            raise InputError(
                "exponent: the file has several frequencies, which tell it; remove the key",
                source=source,
            )
        iron = _sum_of_iron(rows)
        first, second, told = _over_frequency(replace(rows, losses={"iron": iron}), cell, omega)
    else:
        _sum_of_iron(rows)
        first, second = np.zeros((2, i_d.size * i_q.size))
        exponent = _at_one(losses, declared, cell, first, second, source)
    magnet = None
    if "magnet" in losses:
        ratio = (rows.omega / omega) ** 2
        size = i_d.size * i_q.size
        weight = np.bincount(cell, ratio * ratio, size)
        magnet = np.bincount(cell, losses["magnet"] * ratio, size) / weight
        left = losses["magnet"] - magnet[cell] * ratio
        told += _residual(rows, "magnet loss by f^2", left, losses["magnet"])
    whole = [
        part.reshape(i_d.size, i_q.size) for part in (first, second, magnet) if part is not None
    ]
    axis, halves = _even(i_q, whole, source)
    try:
        iron_map = FluxMap(i_d, axis, halves[0], halves[1])
        magnet_map = None if magnet is None else FluxMap(i_d, axis, halves[2], 0.0 * halves[2])
    except InputError as error:
        said = error.message.replace("flux map", "loss map")
        raise InputError(said, source=source) from None
    found = LossMap(iron_map, magnet_map, omega, exponent, source)
    most = None if mechanical is None else float(np.max(mechanical[rows.omega == omega]))
    return LossMapReading(found, (*findings, *told), most)


def _rows(
    content: bytes, source: str, declared: DeclaredLoss, columns: Mapping[str, str]
) -> tuple[_Rows, tuple[str, ...]]:
    """Points of a file, checked one by one, and what was converted."""
    arrays = named_arrays(content, source)
    chosen = _chosen(arrays, columns, source)
    size = chosen["i_d"].values.shape
    for name, array in chosen.items():
        if array.values.shape != size:
            raise InputError(
                f"{array.path} ({name}) has the shape {array.values.shape}, {chosen['i_d'].path} "
                f"{size}; save a column for each current and each loss",
                source=source,
            )
    claimed = claims({name: chosen[name] for name in ("i_d", "i_q")}, source)
    values = {
        name: in_si(key, {key: array}, {}, source)
        for name, array in chosen.items()
        for key in ("loss" if name in PARTS else name,)
    }
    flat = {name: np.atleast_1d(part).ravel() for name, part in values.items()}
    scaling: FluxScaling = declared.scaling or claimed or "peak"
    zero = np.zeros(flat["i_d"].size)
    turned = converted(
        FluxPoints(source, flat["i_d"], flat["i_q"], zero, zero), declared.axes, scaling
    )
    rows = _Rows(
        source,
        turned.i_d,
        turned.i_q,
        _speed(flat, chosen, declared, source),
        {name: flat[name] for name in PARTS if name in flat},
        chosen["i_d"].lines,
    )
    for name, part in (("i_d", rows.i_d), ("i_q", rows.i_q), ("frequency", rows.omega)):
        if not np.all(np.isfinite(part)):
            raise rows.error(f"{name} is not a number", int(np.argmin(np.isfinite(part))))
    if np.any(rows.omega <= 0.0):
        raise rows.error("the frequency is not positive", int(np.argmax(rows.omega <= 0.0)))
    for name, part in rows.losses.items():
        holes = ~np.isfinite(part)
        if np.any(holes):
            raise rows.error(f"no number for the {name} loss; compute it", int(np.argmax(holes)))
        if np.any(part < 0.0):
            row = int(np.argmin(part))
            raise rows.error(f"{name} loss {part[row]:.4g} W is below zero", row)
    return rows, conversion_findings(declared.axes, scaling)


def _chosen(
    arrays: Sequence[NamedArray], columns: Mapping[str, str], source: str
) -> dict[str, NamedArray]:
    """The column of each quantity: as the user named it, else by its name."""
    found: dict[str, list[NamedArray]] = {
        quantity: [named_by_user(arrays, name, source)] for quantity, name in columns.items()
    }
    taken = [array for group in found.values() for array in group]
    for array in arrays:
        if not array.numeric or any(array is one for one in taken):
            continue
        name = loss_named(array.name, array.unit)
        for quantity in (name,) if name else recognised(array):
            if quantity in ("i_d", "i_q", "frequency", "speed", *PARTS) and quantity not in columns:
                found.setdefault(quantity, []).append(array)
    missing = [name for name in ("i_d", "i_q") if name not in found]
    if missing:
        message = f"no {' and '.join(missing)} found among {listed(arrays)}"
        raise InputError(f"{message}; write {advice(missing)}", source=source)
    if not any(name in found for name in PARTS[:4]):
        raise InputError(
            f"no loss found among {listed(arrays)}; name columns P_iron, P_hysteresis, P_eddy or "
            "P_magnet, or write columns: {iron: NAME}",
            source=source,
        )
    for name, group in found.items():
        if len(group) > 1:
            message = f"{len(group)} columns may be the {name}: {listed(group)}"
            raise InputError(f"{message}; write columns: {{{name}: NAME}}", source=source)
    return {name: group[0] for name, group in found.items()}


def _speed(
    flat: Mapping[str, FloatArray],
    chosen: Mapping[str, NamedArray],
    declared: DeclaredLoss,
    source: str,
) -> FloatArray:
    """Electrical speed of each point in rad/s, from the file or the design."""
    name = next((name for name in ("frequency", "speed") if name in flat), "")
    if not name:
        if not declared.frequency:
            raise InputError(
                "the frequency of the losses is not given; write frequency: 200 Hz, or add "
                "a column frequency [Hz]",
                source=source,
            )
        return np.full(flat["i_d"].size, declared.frequency)
    if declared.frequency:
        raise InputError(
            f"frequency: the file has a column for it, {chosen[name].path}; remove the key",
            source=source,
        )
    if not unit_of(chosen[name], name, source):
        raise InputError(
            f"{chosen[name].path} has no unit; write it in the head, {EXPECTED[name]}",
            source=source,
        )
    return flat[name] * (declared.pole_pairs if name == "speed" else 1.0)


def _grid(rows: _Rows) -> tuple[FloatArray, FloatArray, IndexArray]:
    """Axes in A and the cell of each point; every cell must be there once at each frequency."""
    largest = max(float(np.max(np.abs(rows.i_d))), float(np.max(np.abs(rows.i_q))))
    i_d, row = axis_of(rows.i_d, SAME * largest)
    i_q, column = axis_of(rows.i_q, SAME * largest)
    i_d, i_q = (np.where(np.abs(axis) <= SAME * largest, 0.0, axis) for axis in (i_d, i_q))
    cell = row * i_q.size + column
    for omega in np.unique(rows.omega):
        at = rows.omega == omega
        count = np.bincount(cell[at], minlength=i_d.size * i_q.size)
        if np.all(count == 1):
            continue
        worst = int(np.argmax(count != 1))
        place = f"i_d = {i_d[worst // i_q.size]:.4g} A, i_q = {i_q[worst % i_q.size]:.4g} A"
        said = "is missing" if count[worst] == 0 else f"is there {count[worst]} times"
        raise InputError(
            f"the losses must be on a grid of i_d and i_q at each frequency: the point {place} "
            f"{said} at {omega / (2.0 * math.pi):.4g} Hz; save a full grid",
            source=rows.source,
        )
    return i_d, i_q, cell


def _even(
    i_q: FloatArray, parts: Sequence[FloatArray], source: str
) -> tuple[FloatArray, list[FloatArray]]:
    """Axis of both halves, and losses that are even in i_q: a half is mirrored, both averaged."""
    turned = i_q[-1] <= 0.0
    axis = -i_q[::-1] if turned else i_q
    flipped = [part[:, ::-1] if turned else part for part in parts]
    try:
        done = [complete_by_symmetry(axis, part, part) for part in flipped]
    except InputError as error:
        raise InputError(error.message, source=source) from None
    return done[0][0], [part[1] for part in done]


def _sum_of_iron(rows: _Rows) -> FloatArray:
    """Iron loss as one, W: the column, or the sum of its parts, which must agree."""
    losses = rows.losses
    none = np.zeros(rows.i_d.size)
    parts = losses.get("hysteresis", none) + losses.get("eddy", none)
    if "iron" not in losses:
        return parts
    if {"hysteresis", "eddy"} <= losses.keys():
        apart = np.abs(losses["iron"] - parts)
        if np.max(apart) > _SUM * np.max(losses["iron"]):
            row = int(np.argmax(apart))
            raise rows.error(
                f"the iron loss {losses['iron'][row]:.4g} W is not hysteresis plus eddy loss "
                f"{parts[row]:.4g} W",
                row,
            )
    return losses["iron"]


def _at_one(
    losses: Mapping[str, FloatArray],
    declared: DeclaredLoss,
    cell: IndexArray,
    first: FloatArray,
    second: FloatArray,
    source: str,
) -> float:
    """Fill both parts of the iron loss at one frequency, and give the exponent of the first."""
    if "iron" in losses and not {"hysteresis", "eddy"} & losses.keys():
        if declared.exponent is None:
            raise InputError(
                "the iron loss is given at one frequency, without its exponent; write exponent: "
                "1.6 (1 hysteresis, 2 eddy currents), or add columns P_hysteresis and P_eddy, or "
                "points at other frequencies",
                source=source,
            )
        first[cell] = losses["iron"]
        return declared.exponent
    if declared.exponent is not None:
        raise InputError(
            "exponent: hysteresis grows with f, eddy currents and magnets with f^2; remove the key",
            source=source,
        )
    # The one part that a file lacks is what the sum has beyond the other.
    whole = losses.get("iron")
    for part, name, other in (
        (first, "hysteresis", "eddy"),
        (second, "eddy", "hysteresis"),
    ):
        if name in losses:
            part[cell] = losses[name]
        elif whole is not None:
            part[cell] = np.maximum(whole - losses[other], 0.0)
    return 1.0


def _over_frequency(
    rows: _Rows, cell: IndexArray, omega: float
) -> tuple[FloatArray, FloatArray, list[str]]:
    """Hysteresis and eddy loss in W of each cell at the largest frequency: P/f = k_h + k_e f by
    least squares, none below zero.
    """
    loss = rows.losses["iron"]
    x = rows.omega / omega
    y = loss / x
    size = int(cell.max()) + 1
    n, sx, sy, sxx, sxy = (np.bincount(cell, w, size) for w in (1.0 + 0.0 * x, x, y, x * x, x * y))
    eddy = (n * sxy - sx * sy) / (n * sxx - sx * sx)
    hysteresis = (sy - eddy * sx) / n
    told = []
    for name, part in (("hysteresis", hysteresis), ("eddy-current", eddy)):
        below = part < -1e-9 * np.max(np.abs(y))
        if np.any(below):
            worst = int(np.argmin(part))
            row = int(np.argmax(cell == worst))
            told.append(
                f"P/f = k_h + k_e f gives a {name} loss below zero at {np.count_nonzero(below)} of "
                f"{size} points, least {format_quantity(part[worst], 'W')} at {rows.place(row)}; "
                "it counts as zero there"
            )
    only_first, only_second = sy / n, sxy / sxx
    hysteresis, eddy = (
        np.where(eddy < 0.0, only_first, np.where(hysteresis < 0.0, 0.0, hysteresis)),
        np.where(hysteresis < 0.0, only_second, np.maximum(eddy, 0.0)),
    )
    left = loss - hysteresis[cell] * x - eddy[cell] * x * x
    return hysteresis, eddy, told + _residual(rows, "iron loss by f and f^2", left, loss)


def _residual(rows: _Rows, what: str, left: FloatArray, loss: FloatArray) -> list[str]:
    """A sentence on what a fit over the frequency leaves, where it is worth one."""
    most = float(np.max(loss))
    worst = int(np.argmax(np.abs(left)))
    if not abs(left[worst]) > _TOLD * most:
        return []
    rms = math.sqrt(float(np.mean(left**2)))
    said = (
        f"{what} leaves {format_quantity(rms, 'W')} r.m.s., at most "
        f"{format_quantity(abs(left[worst]), 'W')} at {rows.place(worst)} and "
        f"{rows.omega[worst] / (2.0 * math.pi):.4g} Hz"
    )
    return [said]
