"""Whether the data of a flux map can be those of a machine: holes, units, axes, signs,
scaling and energy.

Every refusal names the fault, the place and what to write instead. Points are judged as their file
holds them, maps with d along the magnets and in peak values.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import copper_loss
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.evidence import MOST_PLACES, NOTABLE_CURL, places
from dqforge.machines.names import FluxAxes
from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.machines.flux_maps.flux_points import FluxPoints


_LEAST_VALUES = 4
_SAME = 1e-6
_MOST_CURRENT, _LEAST_CURRENT = 2e4, 1e-3
_MOST_FLUX, _LEAST_FLUX = 50.0, 1e-5
_MOST_INDUCTANCE, _LEAST_INDUCTANCE = 5.0, 1e-7

# Flux linkage at zero current over the largest one from which on it belongs to magnets, not to
# errors.
_MAGNET_SHARE = 0.03
_CLEARLY = 2.0
_AXIS: dict[FluxAxes, str] = {"magnet-d": "+d", "reluctance": "-q"}  # Where the magnets lie.

# What is exchanged, by whether the flux linkage of the magnets appears on their axis.
_EXCHANGED = {True: "i_d and i_q", False: "psi_d and psi_q"}
_NEAREST = 9

# Correlation of the currents beyond which mean inductances are not to be told apart.
_ON_A_CURVE = 0.9
_LARGEST_DIP = 0.01
_FLUX_TOLERANCE = 0.05
_FACTOR_TOLERANCE = 0.02
_WORST_MISFIT = 0.5

# What a ratio between the map's magnet flux linkage and the expected one stands for.
_FACTORS = (
    (np.sqrt(1.5), "the map looks power-invariant; write scaling: power-invariant"),
    (np.sqrt(0.5), "the map looks like r.m.s. values; write scaling: rms"),
    (
        np.sqrt(2.0),
        (
            "the map is in peak values and the expected value in r.m.s.; write scaling: peak, or "
            "correct it"
        ),
    ),
    (
        np.sqrt(2.0 / 3.0),
        "the map is in peak values, the scaling power-invariant does not hold; write scaling: peak",
    ),
    (
        np.sqrt(3.0),
        "the map looks like line-to-line flux linkages; divide psi_d and psi_q by sqrt(3)",
    ),
    (2.0, "the map looks like peak-to-peak or doubled flux linkages; divide psi_d and psi_q by 2"),
    (0.5, "the map has half of it; multiply psi_d and psi_q by 2, or correct the expected value"),
    (1e3, "the map looks like mWb; write flux_unit: mWb"),
    (1e-3, "the map has a thousandth of it; write flux_unit: Wb"),
)


def check_points(points: FluxPoints, axes: FluxAxes = "magnet-d") -> None:
    """Refuse points that cannot be a machine's.

    They are in their file's scaling and ``axes``, shape (K,).

    Raises:
        InputError: Holes, too few different currents, implausible units, exchanged columns, a wrong
            sign, or a magnet that does not lie where ``axes`` says.
    """
    check_holes(points)
    _check_spread(points)
    _check_units(points)
    _check_signs(points, axes)
    _check_magnet(points, axes)


def check_map(
    flux_map: FluxMap, source: str, expected_psi_pm: float | None = None
) -> tuple[str, ...]:
    """Refuse a map that cannot be a machine's, and say in sentences what is doubtful about it.

    Args:
        flux_map: With d along the magnets, in peak values.
        source: Name of its file.
        expected_psi_pm: Flux linkage of the magnets in Wb (peak), if known from elsewhere.

    Raises:
        InputError: A flux linkage falls while its current grows, by more than 1 % of its span; the
            mutual inductances differ by more than half of the diagonal ones; the flux linkage at
            zero current is more than 5 % from the expected one.
    """
    if expected_psi_pm is not None:
        _check_expected(flux_map, expected_psi_pm, source)
    dips = (*_dips(flux_map, "d", source), *_dips(flux_map, "q", source))
    misfit = energy_misfit(flux_map)
    about = (
        f"d psi_d/d i_q and d psi_q/d i_d differ by {100.0 * misfit:.0f} % of the inductances "
        "(r.m.s.)"
    )
    if misfit > _WORST_MISFIT:
        raise InputError(
            f"{about}; no machine has that: check that the columns belong together, or write "
            "flux_map: fit: smooth where the points leave gaps",
            source=source,
        )
    return (
        (*dips, f"{about}; they should be equal in a lossless machine; check the map")
        if misfit > NOTABLE_CURL
        else dips
    )


def energy_misfit(flux_map: FluxMap) -> float:
    """R.m.s. of d psi_d/d i_q - d psi_q/d i_d where the data are, over the r.m.s.
    of the diagonal inductances.
    """
    jet = flux_map.jet(flux_map.i_d[:, np.newaxis], flux_map.i_q)
    within = _within(flux_map)
    difference, squares = (jet.l_dq - jet.l_qd) ** 2, 0.5 * (jet.l_dd**2 + jet.l_qq**2)
    return float(np.sqrt(np.mean(difference[within]) / np.mean(squares[within])))


def _within(flux_map: FluxMap) -> NDArray[np.bool_]:
    """Which nodes lie among the data; what stands at the others is extrapolated."""
    return flux_map.inside(flux_map.i_d[:, np.newaxis], flux_map.i_q)


def check_holes(points: FluxPoints) -> None:
    """Refuse points without a finite number, and no points at all; raises `InputError`."""
    if points.i_d.size == 0:
        raise InputError("the flux map has no points", source=points.source)
    for name in ("i_d", "i_q", "psi_d", "psi_q"):
        holes = np.flatnonzero(~np.isfinite(getattr(points, name)))
        if holes.size:
            where = f"i_d = {points.i_d[holes[0]]:g} A, i_q = {points.i_q[holes[0]]:g} A"
            raise InputError(
                f"{name} has {holes.size} holes (no finite number), the first at {where}; measure "
                "them, or remove these points from the file: gaps of a grid are interpolated",
                source=points.source,
                line=None if points.lines is None else int(points.lines[holes[0]]),
            )


def _check_spread(points: FluxPoints) -> None:
    """Refuse currents with less than four different values; i_q and i_d may
    be those of a half plane.
    """
    for name, values in (("i_d", points.i_d), ("i_q", points.i_q)):
        step = _SAME * max(float(np.max(np.abs(values))), 1e-300)
        count = np.unique(np.round(values / step)).size
        both = np.unique(np.round(np.append(values, -values) / step)).size
        if both < _LEAST_VALUES or count < 2:
            raise InputError(
                f"the flux map has {count} different value{'s' * (count != 1)} of {name}; give at "
                f"least {_LEAST_VALUES}, better 10, of each current",
                source=points.source,
            )


def _check_units(points: FluxPoints) -> None:
    """Refuse sizes that no machine has; the likely reason is a prefix."""
    current = max(float(np.max(np.abs(points.i_d))), float(np.max(np.abs(points.i_q))))
    flux = max(float(np.max(np.abs(points.psi_d))), float(np.max(np.abs(points.psi_q))))
    inductance = flux / current
    found = None
    if current > _MOST_CURRENT:
        found = (
            f"the currents reach {current:g} A; they look like mA, 1000 times too large: write "
            "current_unit: mA"
        )
    elif current < _LEAST_CURRENT:
        found = (
            f"the currents reach only {current:g} A; they look like kA, 1000 times too small: "
            "write current_unit: kA"
        )
    elif flux > _MOST_FLUX:
        found = (
            f"the flux linkages reach {flux:g} Wb; they look like mWb, 1000 times too large: write "
            "flux_unit: mWb"
        )
    elif flux < _LEAST_FLUX:
        found = (
            f"the flux linkages reach only {flux:g} Wb; they look 1000 times too small: check "
            "flux_unit"
        )
    elif not _LEAST_INDUCTANCE <= inductance <= _MOST_INDUCTANCE:
        found = (
            f"{flux:g} Wb at {current:g} A would be {inductance:.3g} H; one of them looks 1000 "
            "times off: write "
        )
        found += (
            "flux_unit: mWb or current_unit: kA (A for mA)"
            if inductance > 1.0
            else "current_unit: mA, or check flux_unit"
        )
    if found:
        raise InputError(found, source=points.source)


def _plane(
    currents: FloatArray, fluxes: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Weighted plane through points (n, 2): flux linkages at zero current (2,), slopes (flux,
    current).
    """
    scale = np.max(np.abs(currents), axis=0)
    scale = np.where(
        scale > 0.0, scale, 1.0
    )  # points may all lie on one axis, or all at zero current
    terms = np.column_stack([np.ones(weights.size), currents / scale]) * weights[:, np.newaxis]
    solution = np.linalg.lstsq(terms, fluxes * weights[:, np.newaxis], rcond=None)[0]
    return solution[0], solution[1:].T / scale


def _at_zero(points: FluxPoints) -> FloatArray:
    """Flux linkages (2,) at zero current, from a plane through the nearest points."""
    currents = np.stack([points.i_d, points.i_q], axis=1)
    distance = np.hypot(*(currents / np.max(np.abs(currents), axis=0)).T)
    nearest = np.argsort(distance, kind="stable")[:_NEAREST]
    fluxes = np.stack([points.psi_d, points.psi_q], axis=1)
    return _plane(currents[nearest], fluxes[nearest], 1.0 / (distance[nearest] ** 2 + _SAME))[0]


def _magnet(points: FluxPoints) -> str:
    """Axis and sign of the magnet in the file's own axes, such as '-q'; '' without
    magnets or where it is unclear.
    """
    zero = _at_zero(points)
    largest = max(float(np.max(np.abs(points.psi_d))), float(np.max(np.abs(points.psi_q))))
    main = int(np.argmax(np.abs(zero)))
    if abs(zero[main]) < max(_MAGNET_SHARE * largest, _CLEARLY * abs(zero[1 - main])):
        return ""
    return ("+" if zero[main] > 0.0 else "-") + "dq"[main]


def _check_signs(points: FluxPoints, axes: FluxAxes) -> None:
    """Refuse exchanged columns and currents that count against their flux linkages,
    by the mean inductances.
    """
    currents = np.stack([points.i_d, points.i_q], axis=1)
    fluxes = np.stack([points.psi_d, points.psi_q], axis=1)
    if abs(np.asarray(np.corrcoef(points.i_d, points.i_q))[0, 1]) > _ON_A_CURVE:
        return
    (l_dd, l_dq), (l_qd, l_qq) = _plane(currents, fluxes, np.ones(currents.shape[0]))[1]
    if min(l_dq, l_qd) > 0.0 and l_dq * l_qd > abs(l_dd * l_qq):
        magnet = _magnet(points)
        pairs = (
            _EXCHANGED[magnet[1:] == _AXIS[axes][1]] if magnet else " or ".join(_EXCHANGED.values())
        )
        raise InputError(
            f"psi_d grows with i_q and psi_q with i_d: {pairs} are exchanged, or a table is "
            "transposed; exchange them, e.g. with the key columns",
            source=points.source,
        )
    falling = [axis for axis, slope in (("d", l_dd), ("q", l_qq)) if slope < 0.0]
    if falling:
        names = " and ".join(f"psi_{axis} falls as i_{axis} grows" for axis in falling)
        raise InputError(
            f"{names}; currents must count positive into the machine: negate "
            f"{' and '.join('i_' + a for a in falling)} (or "
            f"{' and '.join('psi_' + a for a in falling)}) in the file",
            source=points.source,
        )


def _check_magnet(points: FluxPoints, axes: FluxAxes) -> None:
    """Refuse a magnet that lies elsewhere than the axes say."""
    magnet = _magnet(points)
    if magnet in ("", _AXIS[axes]):
        return
    zero = _at_zero(points)
    at_zero = f"at zero current psi_d = {zero[0]:.4g} Wb and psi_q = {zero[1]:.4g} Wb"
    lies = (
        f"{at_zero}: the magnets lie on the {'positive' if magnet[0] == '+' else 'negative'} "
        f"{magnet[1]} axis"
    )
    if magnet == "-d":
        advice = "the d axis points against the magnet; negate i_d and psi_d" + (
            ", and write axes: magnet-d" if axes == "reluctance" else ""
        )
    elif magnet == "+q":
        advice = "negate i_q and psi_q" + (
            ", and write axes: reluctance" if axes == "magnet-d" else ""
        )
    else:
        advice = f"write axes: {'reluctance' if axes == 'magnet-d' else 'magnet-d'}"
    raise InputError(
        f"{lies}, which is not the convention axes: {axes}; {advice}", source=points.source
    )


def _dips(flux_map: FluxMap, axis: str, source: str) -> tuple[str, ...]:
    """Where a flux linkage falls while the current of its own axis grows;
    a sentence for what may be noise.
    """
    psi, along = (flux_map.psi_d, 0) if axis == "d" else (flux_map.psi_q, 1)
    within = _within(flux_map)
    span = float(np.ptp(psi[within]))
    known = np.where(within, psi, -np.inf)
    fall = np.where(within, np.maximum.accumulate(known, axis=along) - psi, 0.0)
    both = within[1:] & within[:-1] if along == 0 else within[:, 1:] & within[:, :-1]
    flat = (np.diff(psi, axis=along) <= 0.0) & both
    if not np.any(flat):
        return ()
    row, column = np.unravel_index(int(np.argmax(fall)), fall.shape)
    where = (
        f"i_d = {flux_map.i_d[row]:g} A, i_q = {flux_map.i_q[column]:g} A (peak, d along the "
        "magnets)"
    )
    share = float(fall[row, column]) / span if span > 0.0 else 1.0
    if share > _LARGEST_DIP:
        found = np.argwhere(fall > _LARGEST_DIP * span)
        named = tuple(
            (float(flux_map.i_d[row]), float(flux_map.i_q[column]))
            for row, column in found[:MOST_PLACES]
        )
        every = (
            f"it does in {found.shape[0]} places ({places(named, found.shape[0])}): "
            if found.shape[0] > 1
            else ""
        )
        raise InputError(
            f"psi_{axis} falls as i_{axis} grows, most at {where}: by {100.0 * share:.2g} % of its "
            f"span; {every}measure there again, or write flux_map: fit: smooth if it is noise",
            source=source,
        )
    flats = f"psi_{axis} does not grow with i_{axis} in {np.count_nonzero(flat)} places"
    return (f"{flats}, it falls by up to {100.0 * share:.2g} % of its span, at {where}",)


def _check_expected(flux_map: FluxMap, expected: float, source: str) -> None:
    """Refuse a map whose flux linkage at zero current is not the expected one,
    and name the usual factors.
    """
    zero = np.zeros(1)
    found = float(flux_map.flux(zero, zero)[0][0])
    ratio = found / expected if expected != 0.0 else np.inf
    if abs(found - expected) <= _FLUX_TOLERANCE * max(
        abs(expected), _MAGNET_SHARE * float(np.max(flux_map.psi_d))
    ):
        return
    meant = [text for factor, text in _FACTORS if abs(ratio / factor - 1.0) <= _FACTOR_TOLERANCE]
    raise InputError(
        f"the map has {format_quantity(found, 'Wb')} at zero current, "
        f"{format_quantity(expected, 'Wb')} (peak) is expected, {ratio:.4g} times; "
        f"{meant[0] if meant else 'check the scaling of the map, or the expected value'}",
        source=source,
    )


# The loss that a flux-map file gives, held against the copper loss that the design makes of its
# currents: what remains is iron, magnet and mechanical loss, and never negative.

_ROUNDING = 0.01  # Negative rest over the loss that digits of a file may make.


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLoss:
    """Loss of a file in W, shape (K,), NaN where it is unknown, at currents in A (peak, d along
    the magnets); ``name`` says where it is from.
    """

    name: str
    values: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def loss_findings(measured: MeasuredLoss, r_s: float) -> tuple[str, ...]:
    """What remains of a file's loss without the copper loss 3/2 R i^2, in a sentence, with a
    warning where that is negative; ``r_s`` in Ohm is that of a phase.
    """
    given = measured.values
    copper = copper_loss(r_s, measured.i_d, measured.i_q)
    known = np.isfinite(given) & np.isfinite(copper)
    if not known.any():
        return ()
    rest, loss = (given - copper)[known], given[known]
    low, high, least, most = (
        format_quantity(float(value), "W", 3)
        for value in (np.min(loss), np.max(loss), np.min(rest), np.max(rest))
    )
    where = f"R = {format_quantity(r_s, 'Ohm', 4)} of the design"
    about = (
        f"the loss of the file ({measured.name}) is {low} to {high} at {loss.size} points; "
        f"without the copper loss of {where} there remain {least} to {most}; it is compared, and "
        "no loss of the machine is made of it"
    )
    below = rest < -_ROUNDING * np.abs(loss)
    if not below.any():
        return (about,)
    worst = np.flatnonzero(known)[int(np.argmin(rest))]
    return (
        about,
        (
            f"warning: at {np.count_nonzero(below)} of {loss.size} points the file has less loss "
            f"than the copper loss of {where}, by up to {least.lstrip('-')} at i_d = "
            f"{measured.i_d[worst]:g} A, i_q = {measured.i_q[worst]:g} A (peak); check the "
            "resistance, its temperature, and the column"
        ),
    )
