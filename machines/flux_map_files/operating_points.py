"""Tables of operating points: flux linkages from voltages, currents, resistance and speed.

In steady state v_d = R i_d - omega psi_q and v_q = R i_q + omega psi_d, so that
psi_d = (v_q - R i_q)/omega and psi_q = -(v_d - R i_d)/omega with the electrical omega.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray
from dqforge.machines.flux_map_files.coordinates import Parts, unit_of
from dqforge.machines.flux_map_files.names import FLUXES, VOLTAGES
from dqforge.machines.flux_maps.torque_check import SQUARED
from dqforge.machines.names import FluxScaling
from dqforge.machines.units.quantities import format_quantity

# Distance over the largest current within which operating points are one point of the map.
BLUR = 2e-3

# Frequency over the largest one below which the resistive drop hides the flux linkage.
_SLOWEST = 0.05

# Distance from a whole number, over it, up to which a ratio is a number of pole pairs.
_WHOLE = 0.02
_SMALL_CURRENT = 0.1
_UNITS = {"rad/s": 1.0, "rpm": math.pi / 30.0}


@dataclass(frozen=True, slots=True)
class Declared:
    """What the design says of machine and file, None where it does not: pole pairs, phase
    resistance in Ohm of its operating points, scaling.
    """

    pole_pairs: int | None = None
    r_s: float | None = None
    scaling: FluxScaling | None = None


NOTHING = Declared()


def over_frequency(
    parts: Parts, chosen: Mapping[str, NamedArray], declared: Declared, source: str
) -> tuple[Parts, tuple[str, ...]]:
    """Voltages over the electrical frequency in place of flux linkages, NaN where it is too low,
    with the frequency (rad/s) beside, and sentences.

    The drop over the resistance is still in them; `without_drop` takes it out once the currents
    are known at each point.

    Raises:
        InputError: There is no speed, its unit cannot be told, or the pole pairs contradict speed
            and frequency.
    """
    shape = parts["v_d"].shape
    if parts["v_q"].shape != shape:
        raise InputError(
            f"v_d has the shape {shape}, v_q {parts['v_q'].shape}; give both at the same points",
            source=source,
        )
    spread = {
        name: _over(part, shape, chosen[name].path, source)
        for name, part in parts.items()
        if name in ("speed", "frequency", "resistance", "copper_loss", "loss", "efficiency")
    }
    rest = {name: part for name, part in parts.items() if name not in (*VOLTAGES, *spread)}
    omega, speed, said = _electrical(rest | spread, parts, chosen, declared, source)
    largest = float(np.nanmax(np.abs(omega), initial=0.0))
    if not largest > 0.0:
        raise InputError(
            "no operating point turns; flux linkages follow from voltages at speed", source=source
        )
    slow = ~(np.abs(omega) >= _SLOWEST * largest)
    turning = np.where(slow, np.nan, omega)
    if slow.any():
        said = (
            *said,
            (
                f"{np.count_nonzero(slow)} of {slow.size} operating points below "
                f"{100.0 * _SLOWEST:g} % of the largest frequency are left out: the drop over the "
                "resistance hides the flux linkage"
            ),
        )
    fluxes = dict(zip(FLUXES, (parts["v_q"] / turning, -parts["v_d"] / turning), strict=True))
    if speed is not None:
        spread["speed"] = speed
    return rest | spread | fluxes | {"frequency": np.broadcast_to(omega, shape)}, said


def without_drop(
    parts: Parts, declared: Declared, scaling: FluxScaling, source: str
) -> tuple[Parts, tuple[str, ...]]:
    """Flux linkages of points, shape (K,), without the drop over the resistance, and where that
    comes from.

    Points whose flux linkage is not known are left out, with what stands beside them.
    """
    known = np.isfinite(parts["psi_d"]) & np.isfinite(parts["psi_q"])
    if not known.any():
        raise InputError("no operating point is whole; fill in its numbers", source=source)
    parts = {name: part[known] for name, part in parts.items()}
    i_d, i_q, omega = parts["i_d"], parts["i_q"], parts["frequency"]
    resistance, about = _resistance(parts, declared, scaling, source)
    psi_d = parts["psi_d"] - resistance * i_q / omega
    psi_q = parts["psi_q"] + resistance * i_d / omega
    sentence = (
        f"the flux linkages of {psi_d.size} operating points follow from voltages and speed, with "
        f"{about}"
    )
    return {**parts, "psi_d": psi_d, "psi_q": psi_q}, (sentence,)


def _resistance(
    parts: Parts, declared: Declared, scaling: FluxScaling, source: str
) -> tuple[FloatArray, str]:
    """Phase resistance in Ohm of each point, and where it comes from in words."""
    i_d, i_q = parts["i_d"], parts["i_q"]
    squares = i_d**2 + i_q**2
    if declared.r_s is not None:
        found, where = np.full(squares.shape, declared.r_s), "of the design"
    elif "resistance" in parts:
        found, where = parts["resistance"], "of the file"
    elif "copper_loss" in parts and np.any(squares > 0.0):
        large = squares >= _SMALL_CURRENT**2 * float(np.max(squares))
        found = np.divide(
            parts["copper_loss"],
            1.5 * SQUARED[scaling] * squares,
            out=np.full(squares.shape, np.nan),
            where=large,
        )
        usual = np.median(found[np.isfinite(found)]) if np.isfinite(found).any() else np.nan
        found, where = np.where(large, found, usual), "by the copper loss of the file"
    else:
        raise InputError(
            "the operating points come without a resistance; write flux_map: resistance: 0.12 Ohm "
            "(of a phase, at the temperature of the file), or add a column such as R [Ohm]",
            source=source,
        )
    if not np.all(np.isfinite(found) & (found >= 0.0)):
        raise InputError("the resistance of some operating points is no number", source=source)
    low, high = (format_quantity(float(end), "Ohm", 4) for end in (np.min(found), np.max(found)))
    return found, f"the resistance {where}, " + (low if low == high else f"{low} to {high}")


def _over(part: FloatArray, shape: tuple[int, ...], path: str, source: str) -> FloatArray:
    """A quantity at each point of a shape: a single value, one per row or column, or all."""
    if part.shape == shape or part.size == 1:
        return np.broadcast_to(part.reshape(()) if part.size == 1 else part, shape)
    for axis in range(len(shape)):
        if part.shape == (shape[axis],) and shape.count(shape[axis]) == 1:
            return np.broadcast_to(
                part.reshape([-1 if k == axis else 1 for k in range(len(shape))]), shape
            )
    raise InputError(
        f"{path} has the shape {part.shape}, the voltages {shape}; give it at the same points",
        source=source,
    )


def _electrical(
    spread: Parts,
    parts: Parts,
    chosen: Mapping[str, NamedArray],
    declared: Declared,
    source: str,
) -> tuple[FloatArray, FloatArray | None, tuple[str, ...]]:
    """Electrical frequency and mechanical speed in rad/s, None where it is unknown, and what was
    found of the pole pairs.
    """
    if "frequency" not in spread and "speed" not in spread:
        raise InputError(
            "voltages without a speed make no flux linkages; name the column of the speed or the "
            "electrical frequency, columns: {speed: NAME}",
            source=source,
        )
    units = {
        name: unit_of(chosen[name], name, source)
        for name in ("frequency", "speed")
        if name in chosen
    }
    scales = {"": 1.0}
    if "speed" in spread and not units["speed"]:
        rpm = "rpm" in chosen["speed"].name.casefold()
        scales = {"rpm": _UNITS["rpm"]} if rpm else _UNITS
    if "frequency" in spread:
        omega = spread["frequency"]
        if not units["frequency"] and not re.search(
            "omega|ω|w", chosen["frequency"].name.casefold()
        ):
            omega = 2.0 * math.pi * omega  # a frequency without a unit is in Hz
        if "speed" not in spread:
            return omega, None, ()
        scale, said = _by_pole_pairs(omega, spread["speed"], scales, declared, source)
        return omega, scale * spread["speed"], said
    if declared.pole_pairs is None:
        raise InputError(
            "the flux linkages of operating points need the pole pairs, or a column of the "
            "electrical frequency",
            source=source,
        )
    scale, said = _by_torque(spread, parts, scales, declared, source)
    speed = scale * spread["speed"]
    return (
        declared.pole_pairs * speed,
        speed,
        (
            *said,
            (
                "the electrical frequency is taken as the speed times pole_pairs "
                f"{declared.pole_pairs}; nothing in the file tests that number"
            ),
        ),
    )


def _by_pole_pairs(
    omega: FloatArray,
    speed: FloatArray,
    scales: Mapping[str, float],
    declared: Declared,
    source: str,
) -> tuple[float, tuple[str, ...]]:
    """Factor to rad/s of a speed beside its electrical frequency, by the pole pairs that they
    make.
    """
    largest = float(np.nanmax(np.abs(speed), initial=0.0))
    turning = (np.abs(speed) >= _SLOWEST * largest) & (np.abs(speed) > 0.0)
    turning &= np.isfinite(speed) & np.isfinite(omega)
    if not turning.any():
        raise InputError("no operating point turns", source=source)
    ratio = float(np.median(np.abs(omega[turning] / speed[turning])))
    counts = {unit: ratio / scale for unit, scale in scales.items()}
    fits = {
        unit: round(count)
        for unit, count in counts.items()
        if round(count) >= 1 and abs(count - round(count)) <= _WHOLE * count
    }
    wanted = declared.pole_pairs
    for unit, count in reversed(fits.items()):
        if wanted is None or count == wanted:
            return scales[unit], (f"frequency and speed in the file make {count} pole pairs",)
    made = " or ".join(
        f"{count:.4g}" + (f" (speed in {unit})" if unit else "") for unit, count in counts.items()
    )
    about = f"frequency and speed in the file make {made} pole pairs"
    if wanted is None:
        raise InputError(f"{about}, no whole number; check their units", source=source)
    raise InputError(
        f"{about}, the design has {wanted}; correct pole_pairs, or the units of both", source=source
    )


def _by_torque(
    spread: Parts,
    parts: Parts,
    scales: Mapping[str, float],
    declared: Declared,
    source: str,
) -> tuple[float, tuple[str, ...]]:
    """Factor to rad/s of a speed without frequency beside it: where it has no unit, the one with
    which torque times speed is about the electrical power.
    """
    if len(scales) == 1:
        return next(iter(scales.values())), ()
    shape = parts["v_d"].shape
    if all(name in parts and parts[name].shape == shape for name in ("i_d", "i_q", "torque")):
        power = (
            1.5
            * SQUARED[declared.scaling or "peak"]
            * (parts["v_d"] * parts["i_d"] + parts["v_q"] * parts["i_q"])
        )
        product = parts["torque"] * spread["speed"]
        known = np.isfinite(product) & np.isfinite(power)
        ratio = float(np.sum(product[known] * power[known]) / np.sum(power[known] ** 2))
        for unit, scale in scales.items():
            if 0.4 <= ratio * scale <= 1.5:
                return scale, (f"the speed is in {unit}, as torque and electrical power tell",)
    raise InputError(
        "the speed of the operating points has no unit; write it into the name, such as speed_rpm",
        source=source,
    )
