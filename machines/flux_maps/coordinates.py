"""From the chosen arrays of a flux-map file to points: axes are spread, polar currents and
inductances converted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import MOST_POINTS, NamedArray
from dqforge.machines.flux_maps.flux_points import SQUARED
from dqforge.machines.flux_maps.map_names import (
    EXPECTED,
    FLUXES,
    KINDS,
    THIRD,
    VOLTAGES,
    advice,
    claimed,
    factor,
    is_unit,
    split_name,
)
from dqforge.machines.names import FluxScaling
from dqforge.machines.units.quantities import format_quantity

Parts = dict[str, FloatArray]


_KELVIN = 273.15
_MOST_TURN = 2.01 * math.pi  # Angles of a current beyond which a column without a unit is in deg.


_GIVEN_BY = {"i": "current_unit", "psi": "flux_unit"}


def claims(chosen: Mapping[str, NamedArray], source: str) -> Literal["", "peak", "rms"]:
    """What the names and units say of currents, flux linkages and voltages: 'peak', 'rms' or
    nothing; they must agree.
    """
    found = {
        claim: array.path
        for quantity, array in chosen.items()
        if KINDS[quantity] in ("i", "psi", "v") and (claim := claimed(array.name, array.unit))
    }
    if len(found) > 1:
        message = f"{found['peak']} is a peak value by its name and {found['rms']} an r.m.s. value"
        raise InputError(f"{message}; convert one of them in the file", source=source)
    return next(iter(found), "")


def in_si(
    quantity: str, chosen: Mapping[str, NamedArray], given: Mapping[str, str], source: str
) -> FloatArray:
    """Values of a quantity in SI (temperatures in degC) in the shape of the file,
    dimensions of length 1 dropped.
    """
    array, kind, axis = chosen[quantity], KINDS[quantity], quantity.rpartition("_")[2]
    values = array.values
    if not array.numeric:
        message = f"{array.path} holds {array.held}, not numbers"
        raise InputError(
            f"{message}; save it as a plain array or write {advice([quantity])}", source=source
        )
    if values.size > MOST_POINTS:
        message = f"{array.path} has {values.size} points, more than {MOST_POINTS}"
        raise InputError(f"{message}; save a coarser map", source=source)
    if np.iscomplexobj(values):
        other = chosen.get(f"{kind}_{'q' if axis == 'd' else 'd'}")
        if other is array:
            values = values.real if axis == "d" else values.imag
        elif np.any(values.imag):
            message = f"{array.path} is complex; save its real part"
            said = f"columns: {{{kind}_d: {array.name}, {kind}_q: {array.name}}}"
            raise InputError(f"{message}, or write {said} if it is d + j q", source=source)
    plain = np.squeeze(np.asarray(values.real, dtype=np.float64))
    unit, scale = _unit(array, kind, given.get(kind, ""), source)
    if kind == "temperature" and unit.casefold() in ("k", "kelvin"):
        return plain - _KELVIN
    if quantity == "beta" and not unit and np.nanmax(np.abs(plain), initial=0.0) > _MOST_TURN:
        return np.radians(plain)
    return plain * scale


def unit_of(array: NamedArray, quantity: str, source: str) -> str:
    """Unit of an array by its name or its file, '' where neither says one."""
    return _unit(array, KINDS[quantity], "", source)[0]


def _unit(array: NamedArray, kind: str, given: str, source: str) -> tuple[str, float]:
    """Unit and factor to SI, by the name of an array, its declared unit and the given one,
    which must agree.
    """
    in_name = split_name(array.name)[1]
    said = {
        "its name": in_name if is_unit(kind, in_name) else "",
        "the file": array.unit,
        _GIVEN_BY.get(kind, ""): given,
    }
    factors: dict[float, tuple[str, str]] = {}
    for who, unit in said.items():
        if unit and not is_unit(kind, unit):
            message = f"{array.path} has the unit {unit!r} by {who}"
            raise InputError(
                f"{message}, which is not known; write {EXPECTED[kind]}", source=source
            )
        if unit:
            factors.setdefault(factor(kind, unit), (unit, who))
    if len(factors) > 1:
        contradiction = " but in ".join(f"{unit} by {who}" for unit, who in factors.values())
        raise InputError(f"{array.path} is in {contradiction}; correct one of them", source=source)
    for scale, (unit, _) in factors.items():
        return unit, scale
    return "", 1.0


def spread(parts: Parts, source: str) -> Parts:
    """All quantities as points of one shape (K,), axes spread over their grid;
    a torque that does not fit is left out.

    The flux linkages may have a third dimension, that of the angle,
    temperature or speed among ``parts``.
    """
    parts = _apparent(parts, source)
    if parts["psi_d"].ndim == 3:
        parts = _third_dimension(parts, source)
    shape = parts["psi_d"].shape
    currents = ("i", "beta") if "i" in parts else ("i_d", "i_q")
    one, other = (parts[name] for name in currents)
    core = {name: parts[name] for name in (*currents, *FLUXES)}
    if parts["psi_q"].shape != shape or parts["psi_d"].ndim > 2 or parts["psi_d"].size == 0:
        raise _misfit(core, source)
    if one.shape == other.shape == shape:
        axes: tuple[FloatArray, FloatArray] | None = (one, other)
    else:
        axes = _rows_and_columns(one, other, parts["psi_d"], parts["psi_q"], polar="i" in parts)
    if axes is None:
        raise _misfit(core, source)
    full = dict(zip(currents, (np.broadcast_to(axis, shape) for axis in axes), strict=True))
    kept = {
        name: part for name, part in parts.items() if part.shape == shape and name not in currents
    }
    return {name: np.ascontiguousarray(part.ravel()) for name, part in {**full, **kept}.items()}


def _misfit(core: Mapping[str, FloatArray], source: str) -> InputError:
    shapes = ", ".join(f"{quantity} {values.shape}" for quantity, values in core.items())
    third = any(part.ndim == 3 for part in core.values())
    more = (
        f"; of a third dimension say what it is: columns: {{{THIRD[0]}: NAME}}, or "
        f"{', '.join(THIRD[1:])}"
    )
    message = (
        "save axes of M and N points with flux linkages of shape (M, N), or four arrays of one "
        "shape"
    )
    return InputError(
        f"the shapes do not fit together: {shapes}; {message}{more if third else ''}", source=source
    )


def _apparent(parts: Parts, source: str) -> Parts:
    """Flux linkages from the apparent inductances l_d, l_q and psi_m, where a file holds those."""
    if "l_d" not in parts:
        return parts
    if "i" in parts:
        raise InputError(
            "inductances over amplitude and angle cannot be read; save i_d and i_q, or name them "
            "where the file has both: columns: {i_d: NAME, i_q: NAME}",
            source=source,
        )
    shape = parts["l_d"].shape
    axes: tuple[FloatArray, FloatArray] | None = (parts["i_d"], parts["i_q"])
    if parts["i_d"].shape != shape or parts["i_q"].shape != shape:
        axes = _rows_and_columns(parts["i_d"], parts["i_q"], parts["l_d"], parts["l_q"], polar=True)
    if axes is None or parts["l_q"].shape != shape:
        raise _misfit({name: parts[name] for name in ("i_d", "i_q", "l_d", "l_q", "psi_m")}, source)
    i_d, i_q = (np.broadcast_to(axis, shape) for axis in axes)
    magnets = parts["psi_m"]
    if magnets.shape not in ((), shape):
        # Of the d flux linkage at i_d = 0, which is a function of i_q.
        along_q = magnets if axes[1].shape != (shape[0], 1) else magnets[:, np.newaxis]
        if along_q.size != max(axes[1].shape):
            raise _misfit(
                {name: parts[name] for name in ("i_d", "i_q", "l_d", "l_q", "psi_m")}, source
            )
        magnets = along_q
    # At zero current the quotients that the inductances are may be undefined; their products are 0.
    psi_d = magnets + np.where(i_d == 0.0, 0.0, parts["l_d"] * i_d)
    psi_q = np.where(i_q == 0.0, 0.0, parts["l_q"] * i_q)
    return {**parts, "i_d": i_d, "i_q": i_q, "psi_d": psi_d, "psi_q": psi_q}


def _third_dimension(parts: Parts, source: str) -> Parts:
    """Parts as points, where the flux linkages have a third dimension whose axis is known."""
    shape = parts["psi_d"].shape
    third = [name for name in THIRD if name in parts]
    currents = ("i", "beta") if "i" in parts else ("i_d", "i_q")
    core = {name: parts[name] for name in (*currents, *FLUXES, *third)}
    if parts["psi_q"].shape != shape or len(third) != 1:
        raise _misfit(core, source)
    over = parts[third[0]]
    if over.shape == shape and all(parts[name].shape == shape for name in currents):
        return {name: part.ravel() for name, part in parts.items() if part.shape == shape}
    for place in (2, 1, 0):
        if over.shape not in ((shape[place],), shape):
            continue
        moved = {
            name: np.moveaxis(part, place, 2) for name, part in parts.items() if part.shape == shape
        }
        flat = {name: np.mean(moved[name], axis=2) for name in FLUXES}
        one, other = (parts[name] for name in currents)
        axes: tuple[FloatArray, FloatArray] | None = (one, other)
        if not one.shape == other.shape == flat["psi_d"].shape:
            axes = _rows_and_columns(one, other, flat["psi_d"], flat["psi_q"], polar="i" in parts)
        if axes is None:
            continue
        size = moved["psi_d"].shape
        full = {
            name: np.broadcast_to(np.broadcast_to(axis, size[:2])[:, :, np.newaxis], size)
            for name, axis in zip(currents, axes, strict=True)
        }
        full |= {
            third[0]: moved.get(third[0], np.broadcast_to(over, size) if over.ndim == 1 else over)
        }
        return {name: part.ravel() for name, part in {**moved, **full}.items()}
    raise _misfit(core, source)


def _rows_and_columns(
    i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray, *, polar: bool = False
) -> tuple[FloatArray, FloatArray] | None:
    """Currents that broadcast to a grid of flux linkages, where at least one current is an axis.

    None if none does.
    """
    if psi_d.ndim != 2:
        return None
    if psi_d.shape in (i_d.shape, i_q.shape):
        mesh, axis = (i_d, i_q) if i_d.shape == psi_d.shape else (i_q, i_d)
        changes = [float(np.nansum(np.abs(np.diff(mesh, axis=k)))) for k in (0, 1)]
        along = int(changes[0] > changes[1])
        if axis.shape != (psi_d.shape[along],):
            return None
        across = axis if along else axis[:, np.newaxis]
        return (mesh, across) if mesh is i_d else (across, mesh)
    fits, turned = psi_d.shape == i_d.shape + i_q.shape, psi_d.shape == i_q.shape + i_d.shape
    if turned and not (fits and (polar or _rows_are_d(i_d, i_q, psi_d, psi_q))):
        return i_d, i_q[:, np.newaxis]
    return (i_d[:, np.newaxis], i_q) if fits else None


def _rows_are_d(i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray) -> bool:
    """Whether the rows of a square grid belong to i_d, which its shape cannot tell.

    The incremental inductances of a passive winding are positive definite, so that the flux
    linkages turn in the same sense as the currents do; a transposed grid turns the other way. Axes
    that are permuted, reversed or scaled in both the currents and the flux linkages do not change
    the sense. What has no sense at all has rows of i_d.
    """
    step_d, step_q = np.sign(np.diff(i_d)), np.sign(np.diff(i_q))
    area = turning(psi_d, psi_q)
    as_rows, as_columns = (
        np.nansum(area * np.outer(*steps)) for steps in ((step_d, step_q), (step_q, step_d))
    )
    return not bool(as_rows < -as_columns)


def turning(psi_d: FloatArray, psi_q: FloatArray) -> FloatArray:
    """Area that each cell of a grid (M, N) spans in the plane of the flux linkages, signed,
    shape (M - 1, N - 1).

    It is positive where the rows go along i_d and both currents rise.
    """
    (d_down, d_right), (q_down, q_right) = (
        (psi[1:, :-1] - psi[:-1, :-1], psi[:-1, 1:] - psi[:-1, :-1]) for psi in (psi_d, psi_q)
    )
    return np.asarray(d_down * q_right - d_right * q_down)


def _conventions(size: FloatArray, angle: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Currents (i_d, i_q) by each meaning that tools give the angle of the current."""
    along, across = size * np.cos(angle), size * np.sin(angle)
    return {
        "counted from the d axis": (along, across),
        "an advance from the q axis (i_d = -I sin, i_q = I cos)": (-across, along),
        "negative for negative i_d (i_d = I sin, i_q = I cos)": (across, along),
    }


def cartesian(parts: Parts, source: str) -> tuple[Parts, tuple[str, ...]]:
    """Points with i_d and i_q, from the amplitude and the angle of the current,
    and what the angle was found to mean.

    Of the three conventions in use only one gives flux linkages that grow with their currents: the
    others turn the current by 90 degrees or mirror it.
    """
    if "i" not in parts:
        return parts, ()
    fluxes = np.stack([parts["psi_d"], parts["psi_q"]], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        every = _conventions(parts["i"], parts["beta"])
        passed = {
            name: part for name, part in every.items() if _passive(np.stack(part, axis=1), fluxes)
        }
    if len(passed) != 1:
        message = "the reference of the current angle cannot be determined from the flux linkages"
        raise InputError(
            f"{message}; save i_d and i_q instead of amplitude and angle, or name them where the "
            "file has both: columns: {i_d: NAME, i_q: NAME}",
            source=source,
        )
    ((name, (i_d, i_q)),) = passed.items()
    rest = {key: part for key, part in parts.items() if key not in ("i", "beta")}
    return {"i_d": i_d, "i_q": i_q, **rest}, (
        f"the angle of the current is {name}: the flux linkages tell",
    )


def _passive(currents: FloatArray, fluxes: FloatArray) -> bool:
    """Whether flux linkages (K, 2) grow with the currents (K, 2) of their own axis,
    by the mean inductances.
    """
    known = np.all(np.isfinite(currents) & np.isfinite(fluxes), axis=1)
    if np.count_nonzero(known) < 3:
        return False
    terms = np.column_stack([np.ones(np.count_nonzero(known)), currents[known]])
    (l_dd, l_qd), (l_dq, l_qq) = np.linalg.lstsq(terms, fluxes[known], rcond=None)[0][1:]
    return bool(l_dd > 0.0 and l_qq > 0.0 and abs(l_dq * l_qd) < l_dd * l_qq)


# Tables of operating points: flux linkages from voltages, currents, resistance and speed.
#
# In steady state v_d = R i_d - omega psi_q and v_q = R i_q + omega psi_d, so that
# psi_d = (v_q - R i_q)/omega and psi_q = -(v_d - R i_d)/omega with the electrical omega.

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
        raise InputError("the resistance of some operating points is not a number", source=source)
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
