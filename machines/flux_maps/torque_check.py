"""The torque that a flux-map file gives, held against that of its flux linkages:
the sharpest check of a declaration.

With d and q in any frame fixed to the rotor T = 3/2 p (psi_d i_q - psi_q i_d) in peak values, so
that the ratio of the two tells a wrong scaling, a wrong number of pole pairs, a wrong unit or a
wrong sign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.names import FluxScaling, FluxTorque
from dqforge.machines.records import dataclass

if TYPE_CHECKING:  # the points' own module calls this check
    from dqforge.machines.flux_maps.flux_points import FluxPoints


# Product of two peak values over that of the same values in each scaling.
SQUARED: dict[FluxScaling, float] = {"peak": 1.0, "rms": 2.0, "power-invariant": 2.0 / 3.0}
_LARGEST = 0.03  # Deviation of the slope from 1, and misfit, from which on a map is refused.
_SHAFT_SLOPES = (0.9, 1.03)
_SHAFT_MISFIT, _SHAFT_OFFSET = 0.1, 0.25
_NEAR = 0.02
_NEAR_COUNT = 0.15
_FEWEST = 4
_MOST_PAIRS, _MOST_PARTS = 200, 12


@dataclass(frozen=True, slots=True)
class TorqueCheck:
    """How the torque of a file compares with that of its flux linkages.

    ``per_pair``: the torque is that of one pole pair, and no test of their number. ``slope`` is
    that of the least-squares line of the file's torque over the map's, through zero unless
    ``declared`` is 'shaft'; ``offset`` is where that line begins, in N m; ``misfit`` is the
    r.m.s. distance from it over the r.m.s. torque of the file; ``points`` is the number of
    points compared.
    """

    name: str
    declared: FluxTorque
    slope: float
    offset: float
    misfit: float
    points: int
    per_pair: bool = False

    @property
    def sentence(self) -> str:
        """The comparison for the user."""
        start = f", {self.offset:+.3g} N m at zero" if self.declared == "shaft" else ""
        kind = "shaft torque" if self.declared == "shaft" else "torque"
        return (
            f"the {kind} of the file ({self.name}) is {self.slope:.5f} times 3/2 p (psi_d i_q - "
            f"psi_q i_d){start}, r.m.s. misfit {100.0 * self.misfit:.2g} % over {self.points} "
            "points"
        ) + "; per pole pair, it says nothing of the pole pairs" * self.per_pair


def check_torque(
    points: FluxPoints, pole_pairs: int, scaling: FluxScaling, declared: FluxTorque = "air-gap"
) -> TorqueCheck | None:
    """Compare the torque of a file with its flux linkages.

    None where it gives none, or none but zero.

    Args:
        points: As the file holds them, in its own axes and scaling.
        pole_pairs: Of the machine.
        scaling: Of currents and flux linkages.
        declared: 'air-gap', 'shaft' (behind friction and iron loss), 'per-pole-pair', or 'ignore'.

    Raises:
        InputError: The two differ by more than 3 % (10 % below for a shaft torque); with the likely
            cause.
    """
    if points.torque is None or declared == "ignore":
        return None
    per_pair = points.torque.per_pole_pair or declared == "per-pole-pair"
    file = points.torque.values * (pole_pairs if per_pair else 1)
    of_map = (
        1.5
        * pole_pairs
        * SQUARED[scaling]
        * _cross(points.psi_d, points.psi_q, points.i_d, points.i_q)
    )
    known = np.isfinite(file) & np.isfinite(of_map)
    if np.count_nonzero(known) < _FEWEST or not np.any(of_map[known]) or not np.any(file[known]):
        return None
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # what overflows is no torque and agrees with none
        slope, offset, misfit = _line(of_map[known], file[known], through_zero=declared != "shaft")
    found = TorqueCheck(
        points.torque.name,
        declared,
        slope,
        offset,
        misfit,
        int(np.count_nonzero(known)),
        per_pair,
    )
    if not _agree(found, file[known]):
        raise InputError(_refusal(found, points, file, pole_pairs, scaling), source=points.source)
    return found


def _cross(psi_d: FloatArray, psi_q: FloatArray, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    return psi_d * i_q - psi_q * i_d


def _line(x: FloatArray, y: FloatArray, *, through_zero: bool = True) -> tuple[float, float, float]:
    """Slope, offset and relative r.m.s. misfit of the least-squares line of y over x."""
    if through_zero:
        slope, offset = float(np.sum(x * y) / np.sum(x * x)), 0.0
    else:
        centred = x - np.mean(x)
        slope = float(np.sum(centred * y) / np.sum(centred * centred))
        offset = float(np.mean(y)) - slope * float(np.mean(x))
    return slope, offset, math.sqrt(float(np.mean((y - slope * x - offset) ** 2) / np.mean(y * y)))


def _agree(found: TorqueCheck, file: FloatArray) -> bool:
    """Whether the line is that of the same machine."""
    if found.declared != "shaft":
        return abs(found.slope - 1.0) <= _LARGEST and found.misfit <= _LARGEST
    low, high = _SHAFT_SLOPES
    largest = float(np.max(np.abs(file)))
    small = abs(found.offset) <= _SHAFT_OFFSET * largest * math.sqrt(
        float(np.mean((file / largest) ** 2))
    )
    return low <= found.slope <= high and found.misfit <= _SHAFT_MISFIT and small


def _refusal(
    found: TorqueCheck, points: FluxPoints, file: FloatArray, pole_pairs: int, scaling: FluxScaling
) -> str:
    """What to say of a torque that is another one, with the likely causes."""
    about = (
        f"the torque of the file ({found.name}) is {found.slope:.4g} times 3/2 p (psi_d i_q - "
        f"psi_q i_d) with {pole_pairs} pole pairs and scaling {scaling}, misfit "
        f"{100.0 * found.misfit:.2g} %"
    )
    causes = list(_factors(found, pole_pairs, scaling)) if found.misfit <= 2.0 * _LARGEST else []
    causes += [
        cause
        for cause in _exchanges(points, file, pole_pairs * SQUARED[scaling])
        if cause not in causes
    ]
    if not causes:
        below = found.declared == "air-gap" and 0.85 <= found.slope < 1.0
        causes = ["a torque behind friction and iron loss: write torque: shaft"] if below else []
    rest = "check scaling, pole_pairs and the columns, or write torque: ignore"
    return f"{about}; likely {', or '.join(causes)}" if causes else f"{about}; {rest}"


def _near(value: float, wanted: float) -> bool:
    return abs(value / wanted - 1.0) <= _NEAR


def _factors(found: TorqueCheck, pole_pairs: int, scaling: FluxScaling) -> Iterator[str]:
    """Likely causes of a ratio between the two torques."""
    slope = abs(found.slope)
    if found.slope < 0.0:
        yield (
            "the opposite sign: the torque counts positive for a generator, or i_q and psi_q (i_d "
            "and psi_d) are both negated; negate the torque, or these two"
        )
    if _near(slope, 1.0) or slope == 0.0:
        return
    for name, squared in SQUARED.items():
        if name != scaling and _near(slope * SQUARED[scaling], squared):
            yield f"another scaling: write scaling: {name}"
    yield from _of_pole_pairs(slope, pole_pairs, per_pair=found.declared == "per-pole-pair")
    for power in (1e3, 1e-3, 1e6, 1e-6):
        if _near(slope, power):
            yield (
                f"a unit {power:g} times off: check current_unit, flux_unit and the unit of the "
                "torque"
            )
    for root, what in (
        (2.0, "r.m.s. and peak"),
        (1.5, "power-invariant and peak"),
        (3.0, "line-to-line and phase"),
    ):
        if _near(slope, math.sqrt(root)) or _near(slope, math.sqrt(1.0 / root)):
            yield (
                f"currents and flux linkages of different scaling ({what} values): convert one of "
                "them in the file"
            )


def _of_pole_pairs(slope: float, pole_pairs: int, *, per_pair: bool) -> Iterator[str]:
    """Likely causes of a ratio of whole numbers."""
    pairs = slope * pole_pairs
    count = round(pairs)
    if (
        1 <= count <= _MOST_PAIRS
        and count != pole_pairs
        and abs(pairs - count) <= min(_NEAR * pairs, _NEAR_COUNT)
    ):
        yield f"another number of pole pairs: write pole_pairs: {count}"
    if pole_pairs > 1 and not per_pair and _near(slope * pole_pairs, 1.0):
        yield "a torque per pole pair: write torque: per-pole-pair"
    if pole_pairs > 1 and per_pair and _near(slope, pole_pairs):
        yield "a torque of the whole machine: write torque: air-gap"
    for parts in range(2, _MOST_PARTS + 1):
        if _near(slope * parts, 1.0) and parts != pole_pairs:
            yield f"the torque of one {parts}th of the machine, as modelled: multiply it by {parts}"


def _exchanges(points: FluxPoints, file: FloatArray, factor: float) -> Iterator[str]:
    """Exchanges of arrays and signs under which the two torques agree."""
    i_d, i_q, psi_d, psi_q = points.i_d, points.i_q, points.psi_d, points.psi_q
    trials: list[tuple[str, FloatArray]] = [
        ("i_d and i_q (or psi_d and psi_q) are exchanged", _cross(psi_d, psi_q, i_q, i_d)),
        ("the sign of one current or flux linkage is wrong", _cross(psi_d, -psi_q, i_d, i_q)),
    ]
    turned = _transposed(points)
    if turned is not None:
        trials.append(
            ("rows and columns of the flux linkages are exchanged", _cross(psi_d, psi_q, *turned))
        )
        trials.append(("psi_d and psi_q are exchanged", _cross(psi_q, psi_d, *turned)))
    for cause, cross in trials:
        of_map = 1.5 * factor * cross
        known = np.isfinite(file) & np.isfinite(of_map)
        if np.any(of_map[known]):
            with np.errstate(over="ignore", invalid="ignore"):
                slope, _, misfit = _line(of_map[known], file[known])
            if misfit <= _LARGEST and abs(abs(slope) - 1.0) <= _LARGEST:
                yield cause


def _transposed(points: FluxPoints) -> tuple[FloatArray, FloatArray] | None:
    """Currents (i_d, i_q) with rows and columns exchanged, where the points
    are a square grid in order.
    """
    size = math.isqrt(points.i_d.size)
    if size * size != points.i_d.size:
        return None
    i_d, i_q = points.i_d.reshape(size, size), points.i_q.reshape(size, size)
    if np.ptp(i_d, axis=0).any() and np.ptp(i_d, axis=1).any():
        return None
    return i_d.T.ravel(), i_q.T.ravel()
