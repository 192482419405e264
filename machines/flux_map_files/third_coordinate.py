"""Flux maps over a third coordinate: the rotor angle is averaged over,
a temperature or speed is asked for by name.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.flux_map_files.coordinates import Parts
from dqforge.machines.units.quantities import format_quantity

_SAME = 1e-6

# Difference over the largest value from which on two temperatures or speeds are two.
_DISTINCT = 0.01
_CLOSED = 0.02  # Difference over the ripple below which the last angle is the first one again.
_MOST_LISTED = 12
_UNITS = {"temperature": "degC", "speed": "rpm"}
_EXAMPLES = {"temperature": "80 degC", "speed": "1000 rpm"}


def cells_of(i_d: FloatArray, i_q: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Number of the pair of currents that each point has, shape (K,), and
    how often each pair occurs.
    """
    tolerance = max(_SAME * float(np.max(np.abs([i_d, i_q]), initial=0.0)), 1e-300)
    keys = np.stack([np.round(i_d / tolerance), np.round(i_q / tolerance)], axis=1) + 0.0
    order = np.lexsort(keys.T)
    new = np.any(np.diff(keys[order], axis=0) != 0.0, axis=1)
    labels = np.empty(i_d.size, dtype=np.intp)
    labels[order] = np.append(0, np.cumsum(new))
    return labels, np.bincount(labels)


def without_third(
    parts: Parts, lines: NDArray[np.intp] | None, at: Mapping[str, float], source: str
) -> tuple[Parts, NDArray[np.intp] | None, tuple[str, ...]]:
    """Points over the currents alone, the lines that they stand in, and what was done,
    in sentences.

    Args:
        parts: Quantities of points, shape (K,), with 'angle' (rad), 'temperature' (degC) or 'speed'
            (rad/s) among them or not.
        lines: Line of each point in its file, shape (K,), or None.
        at: Temperature (degC) and speed (rad/s) whose points are wanted.

    Raises:
        InputError: Several temperatures or speeds and none is asked for, or there is no such one.
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
        return parts, lines, findings
    return _averaged(parts, lines, findings)


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


def _averaged(
    parts: Parts, lines: NDArray[np.intp] | None, findings: tuple[str, ...]
) -> tuple[Parts, NDArray[np.intp] | None, tuple[str, ...]]:
    """Means over the angle of each pair of currents, and how much flux linkages
    and torque change with it.
    """
    angle = parts["angle"]
    rest = {name: part for name, part in parts.items() if name != "angle"}
    labels, counts = cells_of(parts["i_d"], parts["i_q"])
    if counts.max() < 2 or float(np.ptp(angle)) == 0.0:
        return rest, lines, findings
    order = np.lexsort([angle, labels])
    starts = np.append(0, np.cumsum(counts)[:-1])
    weights = _weights(rest, order, counts)
    total = np.add.reduceat(weights, starts)
    means = {
        name: np.add.reduceat(part[order] * weights, starts) / total for name, part in rest.items()
    }
    ripple = {
        name: np.maximum.reduceat(part[order], starts) - np.minimum.reduceat(part[order], starts)
        for name, part in rest.items()
    }
    flux = max(float(np.nanmax(ripple[name])) for name in ("psi_d", "psi_q"))
    often = (
        f"{counts.min()}" if counts.min() == counts.max() else f"{counts.min()} to {counts.max()}"
    )
    sentence = (
        f"averaged over {often} rotor angles; the flux linkages change by up to "
        f"{format_quantity(flux, 'Wb', 3)}"
    )
    if "torque" in ripple and np.any(np.isfinite(ripple["torque"])):
        worst = int(np.nanargmax(ripple["torque"]))
        sentence += (
            f", the torque by up to {format_quantity(float(ripple['torque'][worst]), 'N m', 3)} "
            f"(peak to peak) at i_d = {means['i_d'][worst]:g} A, i_q = {means['i_q'][worst]:g} A"
        )
    first = None if lines is None else np.minimum.reduceat(lines[order], starts)
    return means, first, (*findings, sentence)


def _weights(parts: Parts, order: NDArray[np.intp], counts: NDArray[np.intp]) -> FloatArray:
    """Weights of the sorted points: halves at both ends where the last angle
    repeats the first one's values.
    """
    weights = np.ones(order.size)
    if counts.min() != counts.max() or counts[0] < 3:
        return weights
    table = np.stack([parts[name][order].reshape(counts.size, -1) for name in ("psi_d", "psi_q")])
    gap = float(np.nanmax(np.abs(table[:, :, -1] - table[:, :, 0])))
    if gap <= _CLOSED * float(np.nanmax(np.ptp(table, axis=2))):
        ends = weights.reshape(counts.size, -1)
        ends[:, 0] = ends[:, -1] = 0.5
    return weights
