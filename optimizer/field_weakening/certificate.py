"""Proven bounds of what a two-dimensional current reference errs by, over its whole domain,
in the emitted arithmetic.

Torque, flux linkage and magnitude of the current are functions of the machine's currents, which are
polynomials of the torque and of the excess flux linkage. The plane of these two is cut into boxes;
on each a Taylor polynomial of second degree with its remainder encloses every error
(`dqforge.optimizer.field_weakening.error_bounds`), in ball arithmetic over arrays of doubles
(`dqforge.optimizer.certificates.ball`), and boxes whose bounds lie above the largest errors
found at the centres are halved. Where the reference branches, a box counts for every branch that
rounding may let the evaluator take there.

Whoever asks for more than the limit gets the currents at the limit: they are compared with the
largest torque of all, which is enclosed for itself
(`dqforge.optimizer.field_weakening.error_bounds`).

The copper loss above the least and the distance from the exact currents are not bounded:
they stay sampled.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.enclosures import Boxes
from dqforge.optimizer.field_weakening.error_bounds import (
    STRIPS,
    CertifiedDomain,
    Enclosed,
    LargestTorque,
    boxes_between,
    enclose,
    halved,
    largest_torque,
    limit_range,
)
from dqforge.optimizer.field_weakening.form import WeakeningReference, WeakeningRegion
from dqforge.optimizer.field_weakening.voltage_region import (
    FLUX_SHARE,
    ROUNDING,
    TORQUE_SHARE,
    DropReference,
    Taken,
    VoltageRegion,
    moved,
    voltage_excess,
)

_HALVINGS = 8
_CLOSE = 1.02  # Bounds within this factor of the errors found at centres are not refined.

# Shares of torque, squared flux linkage, squared current and squared voltage below which no bound
# is refined.
_RESOLUTION = np.array([1e-6, 2e-6, 2e-6, 2e-6])

# Boxes that are looked at, and strips along the torque limit; what is left then keeps its bounds.
_BATCH = 8192
_MOST_BOXES = 200_000


@dataclass(frozen=True, slots=True)
class SurfaceCertificate:
    """Bounds of `SurfaceErrors`, in the same units.

    ``model`` says what they are proven against: the ``equations`` of a machine with constant
    inductances, or the ``splines`` through the points of a flux map. ``boxes`` counts the parts of
    the domain that were looked at. ``voltage_excess`` is that of the voltage with the resistance
    drop, relative to its limit, where a whole step is certified: for every torque, either
    direction, voltages from `LEAST_VOLTAGE` of the design's up, and speeds up to the largest one in
    proportion to the voltage.
    """

    model: Literal["equations", "splines"]
    torque: float
    torque_relative: float
    flux_excess: float
    current_excess: float
    boxes: int
    voltage_excess: float | None = None


@dataclass(slots=True)
class _Progress:
    """Largest errors found, largest bounds of what is settled (both N m, squares thrice),
    and boxes looked at.

    ``rise`` in A^2/Wb and ``room`` (a share of the squared limit) bound what else there
    is to know of the current.
    """

    found: FloatArray
    worst: FloatArray
    boxes: int = 0
    rise: float = 0.0
    room: float = 0.0

    def enough(self, bounds: FloatArray, least: FloatArray, room: FloatArray) -> NDArray[np.bool_]:
        """Which bounds, shape (4, N), need no refinement: those close to what
        was found or settled anyway.

        Smaller boxes take nothing off what rounding adds, ``room`` of shape (4, N).
        """
        aim = np.maximum(np.maximum(_CLOSE * self.found, self.worst), least)
        return np.asarray(np.all(bounds - room <= aim[:, np.newaxis], axis=0))

    def settle(self, bounds: FloatArray) -> None:
        """Count bounds of shape (4, N) among those that stay."""
        self.worst = np.maximum(self.worst, np.max(bounds, axis=1, initial=-np.inf))


@dataclass(frozen=True, slots=True)
class _Voltage:
    """The voltage that a step takes, resistance included."""

    region: VoltageRegion
    step: DropReference

    def bounds(self, domain: CertifiedDomain, boxes: Boxes, enclosed: Enclosed) -> FloatArray:
        """Bounds of |v|^2/V^2 - 1 on boxes, and what it is at their centres, shape (2, N)."""
        low, high = domain.available(boxes)
        square = self.region.flux.i_max**2
        over = Taken(
            boxes.t_low, boxes.t_high, low, high, enclosed.high, -enclosed.low,
            enclosed.excess[0], (enclosed.excess[1] + 1.0) * square,
        )  # fmt: skip
        t, a, (torque, flux, current) = (
            0.5 * (boxes.t_low + boxes.t_high),
            0.5 * (low + high),
            enclosed.centre,
        )
        if not boxes.weakens:
            a = low
        here = Taken(t, t, a, a, torque, -torque, flux, (current + 1.0) * square)
        return np.stack([voltage_excess(self.region, self.step, part) for part in (over, here)])


def _refine(
    domain: CertifiedDomain, progress: _Progress, least: FloatArray, voltage: _Voltage | None
) -> None:
    """Settle the torques that are within reach: boxes are halved until their bounds
    are close to what was found.
    """
    waiting, most = list(domain.first()), progress.boxes + _MOST_BOXES
    while waiting:
        done: list[tuple[Boxes, Enclosed, FloatArray]] = []
        for boxes in waiting:
            for start in range(0, boxes.count, _BATCH):
                part = domain.clipped(boxes.chosen(slice(start, start + _BATCH)))
                if part.count == 0:
                    continue
                enclosed = enclose(domain.region, domain.reference, part, domain.overhang)
                volts = (
                    np.zeros((2, part.count))
                    if voltage is None
                    else voltage.bounds(domain, part, enclosed)
                )
                held = np.vstack([enclosed.centre, volts[1]])[:, domain.holds(part)]
                held[0] = np.abs(held[0])
                progress.found = np.fmax(progress.found, np.fmax.reduce(held, axis=1, initial=0.0))
                torque = np.maximum(enclosed.high, -enclosed.low)
                done.append((part, enclosed, np.vstack([torque, enclosed.excess, volts[0]])))
                progress.boxes += part.count
        waiting = []
        for part, enclosed, bounds in done:
            # Rounding moves the squared voltage by what it moves flux linkage, torque and current.
            room = np.vstack([enclosed.room, np.sum(enclosed.room[1:], axis=0)])
            settled = progress.enough(bounds, least, room) | (progress.boxes > most)
            progress.settle(bounds[:, settled])
            progress.rise = max(progress.rise, float(np.max(enclosed.rise[settled], initial=0.0)))
            progress.room = max(
                progress.room, float(np.max(enclosed.room[2, settled], initial=0.0))
            )
            rest = np.flatnonzero(~settled)
            if rest.size > 0:
                waiting.append(halved(part.chosen(rest), enclosed.along[rest]))


def _strip_errors(
    domain: CertifiedDomain, largest: LargestTorque, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far the torque at the limit may lie below the largest one and above the limit,
    and what it does at centres.

    Between flux linkages in Wb, shape (N,); bounds of shape (2, N) and errors of shape (N,),
    in N m.
    """
    t_low, t_high = limit_range(domain.reference, low, high)
    t_low = np.maximum(t_low, domain.ends[0])
    most, at_centre = largest.largest(high), largest.largest(0.5 * (low + high))
    clamped = high >= float(domain.reference.flux_max)  # and with it every larger flux linkage
    most = np.where(clamped, np.maximum(most, largest.largest(largest.edges[-1:])), most)
    bounds, found = np.full((2, low.size), -np.inf), np.zeros(low.size)
    for segment, (start, end) in enumerate(pairwise(domain.ends.tolist())):
        places = np.flatnonzero((t_high >= start) & (t_low <= end))
        first, last = np.maximum(t_low[places], start), np.minimum(t_high[places], end)
        flux = domain.flux_range(segment, first, last)
        x_low, x_high = (
            flux[0] - high[places] * (1.0 + 1e-15),
            flux[1] - low[places] * (1.0 - 1e-15),
        )
        seam = np.full(places.size, domain.seam)
        for weakens, touched in ((True, x_high >= -seam), (False, x_low <= seam)):
            which = np.flatnonzero(touched)
            if which.size == 0:
                continue
            span = (np.maximum(x_low, -seam), x_high) if weakens else (seam, seam)
            boxes = boxes_between(segment, first, last, *span, weakens=weakens).chosen(which)
            enclosed = enclose(domain.region, domain.reference, domain.rounded(boxes))
            at = places[which]
            under = (most[at] - first[which]) * (1.0 + 1e-15) - enclosed.low
            bounds[:, at] = np.maximum(bounds[:, at], np.stack([under, enclosed.high]))
            middle = 0.5 * (first[which] + last[which])
            found[at] = np.fmax(found[at], np.abs(enclosed.centre[0] + middle - at_centre[at]))
    return bounds, found


def _refine_limit(
    domain: CertifiedDomain,
    largest: LargestTorque,
    progress: _Progress,
    beyond: float,
    least: float,
) -> None:
    """Settle the torques beyond reach.

    ``beyond`` in N m is how far the limit itself may lie above the largest one.
    """
    edges = np.linspace(
        float(domain.reference.flux_min), float(domain.reference.flux_max), STRIPS + 1
    )
    low, high = edges[:-1], edges[1:]
    for step in range(_HALVINGS + 1):
        progress.boxes += low.size
        sides, found = _strip_errors(domain, largest, low, high)
        bounds = np.maximum(sides[0], sides[1] + beyond)
        progress.found[0] = float(np.fmax(progress.found[0], np.fmax.reduce(found)))
        settled = bounds <= max(_CLOSE * progress.found[0], progress.worst[0], least)
        settled |= (step == _HALVINGS) | (progress.boxes > _MOST_BOXES)
        progress.worst[0] = max(progress.worst[0], float(np.max(bounds[settled], initial=-np.inf)))
        if np.all(settled):
            return
        low, high, middle = low[~settled], high[~settled], 0.5 * (low + high)[~settled]
        low, high = np.concatenate([low, middle]), np.concatenate([middle, high])


def certify_surface(
    region: WeakeningRegion,
    reference: WeakeningReference,
    step: tuple[VoltageRegion, DropReference] | None = None,
) -> SurfaceCertificate | None:
    """Prove bounds of the errors of a two-dimensional reference over its whole domain.

    Args:
        region: Machine and limits that it is to keep.
        reference: The emitted constants.
        step: The step about it with its domain, whose voltage is to be bounded as well.

    Returns:
        For every torque of either sign, whether it can be had or not, and every flux linkage from
        the least one on, with and without fused multiply-add; None for a machine that is neither
        linear nor a flux map, and where no bound could be proven.
    """
    if not isinstance(region.machine, LinearMachine | SaturatedMachine):
        return None
    try:
        return _certify(region, reference, None if step is None else _Voltage(*step))
    except ZeroDivisionError:  # intermediate results may be too large for single precision
        return None


def certify_step(region: VoltageRegion, step: DropReference) -> SurfaceCertificate | None:
    """Prove bounds of the errors of a whole step; as `certify_surface`."""
    return certify_surface(region.flux, step.surface, (region, step))


def _certify(
    region: WeakeningRegion, reference: WeakeningReference, voltage: _Voltage | None
) -> SurfaceCertificate | None:
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        domain, largest = CertifiedDomain.of(region, reference), largest_torque(region)
        if largest is None:
            return None
        top = limit_range(reference, largest.flux[:-1], largest.flux[1:])[1]
        beyond = float(np.max(np.maximum(top - largest.torque[:-1], 0.0)))
        least = _RESOLUTION * [region.torque_max, 1.0, 1.0, 1.0]
        progress = _Progress(np.zeros(4), np.zeros(4))
        _refine_limit(domain, largest, progress, beyond, float(least[0]))
        progress.worst[0] -= beyond
        _refine(domain, progress, least, voltage)
    torque = float(progress.worst[0]) + beyond
    flux, current = (
        math.nextafter(math.sqrt(1.0 + over), math.inf) - 1.0
        for over in progress.worst[1:3].tolist()
    )
    if not all(map(math.isfinite, (torque, flux, current))):
        return None
    relative = torque / region.torque_max
    return SurfaceCertificate(
        model="equations" if isinstance(region.machine, LinearMachine) else "splines",
        torque=torque,
        torque_relative=relative,
        flux_excess=flux,
        current_excess=current,
        boxes=progress.boxes,
        voltage_excess=None
        if voltage is None
        else _voltage(voltage, progress, (relative, flux, current)),
    )


def _voltage(
    voltage: _Voltage, progress: _Progress, others: tuple[float, float, float]
) -> float | None:
    """Bound of the voltage over its limit less 1.

    None where the others are not good enough for it.
    """
    relative, flux, current = others
    if relative > TORQUE_SHARE or flux > FLUX_SHARE or current > FLUX_SHARE / 2.0:
        return None
    room = progress.room * voltage.region.flux.i_max**2
    over = (
        float(progress.worst[3])
        + moved(voltage.region, voltage.step, progress.rise, room)
        + ROUNDING
    )
    found = math.nextafter(math.sqrt(1.0 + over), math.inf) - 1.0
    return found if math.isfinite(found) else None
