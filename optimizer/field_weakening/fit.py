"""Fit of two-dimensional current references, and the choice of the smallest that keeps its
budget.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.field_weakening.certificate import SurfaceCertificate, certify_step
from dqforge.optimizer.field_weakening.form import (
    Aims,
    Mtpa,
    SingleSurface,
    SurfaceErrors,
    SurfaceSamples,
    WeakeningReference,
    WeakeningRegion,
    error_map,
    fit_limit,
    fit_mtpa,
    in_double,
    level,
    surface_errors,
)
from dqforge.optimizer.field_weakening.voltage_region import (
    LEAST_VOLTAGE,
    DropReference,
    VoltageErrors,
    VoltageRegion,
    voltage_errors,
    voltage_region,
    voltage_samples,
)
from dqforge.optimizer.linear_programme import least_cost
from dqforge.optimizer.operating_points.mtpa_locus import Active

_FLUX_LEVELS = 48
_TORQUE_LEVELS = 40

# Share of the permitted errors that the MTPA currents may take: the surfaces begin with them.
_MTPA_SHARE = 0.4

# Share of the permitted torque error by which the limit may stay below the largest torque. It keeps
# the fit away from MTPV itself, where the currents turn by the square root of the torque that is
# missing.
_LIMIT_SHARE = 0.4

# Largest error on the grid of the fit, over the permitted one, from which a candidate is measured
# closely.
_GOOD = 0.95

# Degrees (n, m) in torque and in excess flux linkage that are tried; the monomials x^i y^j have i/n
# + j/m <= 1.
_DEGREES = (
    (1, 1),
    (2, 1),
    (2, 2),
    (3, 2),
    (3, 3),
    (4, 2),
    (4, 3),
    (5, 3),
    (4, 4),
    (5, 4),
    (5, 5),
    (7, 4),
    (6, 6),
    (7, 7),
    (8, 8),
)


def monomials(torque_degree: int, excess_degree: int) -> list[tuple[int, int]]:
    """Exponents (i, j) with i/n + j/m <= 1, by rising j and i."""
    return [
        (i, j)
        for j in range(excess_degree + 1)
        for i in range(torque_degree + 1)
        if i * excess_degree + j * torque_degree <= torque_degree * excess_degree
    ]


@dataclass(frozen=True, slots=True)
class SurfaceTrial:
    """One candidate: degrees in torque and excess flux linkage, number of constants, bytes,
    and its errors.

    ``grid_error`` is the largest error on the grid of the fit over the permitted one; ``errors``
    (over torque and flux linkage) and ``voltage`` (over torque, voltage and speed) are those of the
    float32 arithmetic, None where ``grid_error`` rules the candidate out.
    """

    degrees: tuple[int, int]
    coefficients: int
    flash: int
    grid_error: float
    errors: SurfaceErrors | None
    voltage: VoltageErrors | None
    chosen: bool = False


@dataclass(frozen=True, slots=True)
class WeakeningFit:
    """A reference with its domain, its errors, what was tried, and proven bounds of the errors.

    ``reference`` are the currents over torque and flux linkage, ``step`` the whole step over
    torque, voltage and speed that is emitted. ``certificate`` is None for machines that are neither
    linear nor flux maps, and where no bound could be proven. ``chart`` are the errors over the
    domain.
    """

    settings: WeakeningSettings
    domain: VoltageRegion
    step: DropReference
    errors: SurfaceErrors
    voltage: VoltageErrors
    trials: tuple[SurfaceTrial, ...]
    certificate: SurfaceCertificate | None
    chart: ErrorChart

    @property
    def region(self) -> WeakeningRegion:
        """Domain of torque and available flux linkage."""
        return self.domain.flux

    @property
    def largest_torque_error(self) -> float:
        """Largest sampled error of the torque in N m, over flux linkages as over voltages and
        speeds.
        """
        return max(self.errors.torque, self.voltage.torque)

    @property
    def largest_current_excess(self) -> float:
        """Largest sampled excess of the current, over the same."""
        return max(self.errors.current_excess, self.voltage.current_excess)

    @property
    def reference(self) -> WeakeningReference:
        """Currents over torque and available flux linkage."""
        return self.step.surface


@dataclass(frozen=True, slots=True)
class _Grid:
    """Points of the weakened region, shape (N,): what is asked for, and where the fit
    stands at the MTPA currents.
    """

    aims: Aims
    torque: FloatArray
    excess: FloatArray
    base: tuple[FloatArray, FloatArray]


def _grid(
    region: WeakeningRegion, settings: WeakeningSettings, mtpa: Mtpa, limit: SinglePolynomial
) -> _Grid:
    """Points between the MTPA locus and the limit for each of many flux linkages.

    The limit itself with both aims.
    """
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _FLUX_LEVELS))
    levels = region.flux_min + (region.flux_max - region.flux_min) * share
    most = region.largest_torque(levels)
    end = in_double(limit, levels - region.flux_min)
    fine = np.linspace(0.0, region.torque_max, 2001)
    weakened = in_double(mtpa.flux, fine) > levels[:, np.newaxis]
    start = np.where(weakened.any(axis=1), fine[np.argmax(weakened, axis=1)], np.inf)
    kept = np.flatnonzero(start < end)
    across = np.append(0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _TORQUE_LEVELS)), 1.0)
    torque = start[kept, np.newaxis] + across * (end - start)[kept, np.newaxis]
    wanted = torque.copy()
    wanted[:, -1] = most[kept]  # who asks for more than the limit is to get as much as there is
    torque, wanted = torque.ravel(), wanted.ravel()
    flux = np.repeat(levels[kept], across.size)
    excess = in_double(mtpa.flux, torque) - flux
    inside = excess > 0.0
    torque, wanted, flux, excess = torque[inside], wanted[inside], flux[inside], excess[inside]
    exact = region.points(torque, flux)
    zero = np.zeros_like(torque)
    aims = Aims(
        region.machine,
        wanted,
        zero + 1.0 / (settings.torque_error * region.torque_max),
        flux,
        1.0 / (settings.voltage_excess * flux),
        exact.i_d,
        exact.i_q,
        zero,
        region.i_max,
        1.0 / (settings.voltage_excess * region.i_max),
    )
    return _Grid(aims, torque, excess, (in_double(mtpa.d, torque), in_double(mtpa.q, torque)))


def _surface(
    weights: FloatArray, exponents: list[tuple[int, int]], units: tuple[float, float]
) -> SingleSurface:
    """Coefficients by rows, from weights of monomials in scaled variables."""
    rows: list[list[float]] = []
    for (i, j), weight in zip(exponents, weights, strict=True):
        if i == 0:
            rows.append([])
        rows[-1].append(float(weight) / units[0] ** i / units[1] ** j)
    return SingleSurface(tuple(np.array(row, dtype=np.float32) for row in rows))


def _fit_surfaces(
    region: WeakeningRegion,
    grid: _Grid,
    mtpa: Mtpa,
    limit: SinglePolynomial,
    degrees: tuple[int, int],
) -> tuple[WeakeningReference, float]:
    """The reference with surfaces of given degrees, and its largest error on the
    grid over the permitted one.
    """
    torque_mid, excess_mid = (
        float(np.float32(0.5 * (np.min(values) + np.max(values))))
        for values in (grid.torque, grid.excess)
    )
    units = 0.5 * float(np.ptp(grid.torque)), 0.5 * float(np.ptp(grid.excess))
    x, y = (grid.torque - torque_mid) / units[0], (grid.excess - excess_mid) / units[1]
    exponents = monomials(*degrees)
    terms = np.stack([x**i * y**j for i, j in exponents], axis=1)
    share_d = grid.excess / units[1]
    share_q = share_d * grid.torque / units[0]
    found = level(
        grid.aims,
        grid.base,
        share_d[:, np.newaxis] * terms,
        share_q[:, np.newaxis] * terms,
        region.i_max,
    )
    reference = WeakeningReference(
        flux_min=np.float32(region.flux_min),
        flux_max=np.float32(region.flux_max),
        limit=limit,
        d=mtpa.d,
        q=mtpa.q,
        flux=mtpa.flux,
        torque_mid=np.float32(torque_mid),
        excess_mid=np.float32(excess_mid),
        surface_d=_surface(found.d / units[1], exponents, units),
        surface_q=_surface(found.q / units[1] / units[0], exponents, units),
    )
    return reference, found.worst


def fit_weakening(
    machine: Machine, i_max: float, v_max: float, settings: WeakeningSettings
) -> WeakeningFit:
    """Smallest two-dimensional reference that keeps its budget.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
        v_max: Largest phase-voltage amplitude in V; with the largest speed of the settings it gives
            the least flux linkage.
        settings: Largest speed and budget.

    Raises:
        NoSolutionError: The voltage limits nothing, leaves no torque, or no candidate keeps the
            budget.
    """
    domain = voltage_region(machine, i_max, v_max, settings.omega_m)
    region, samples = domain.flux, voltage_samples(domain)
    torque_error = settings.torque_error * region.torque_max
    mtpa = fit_mtpa(region, _MTPA_SHARE * torque_error, _MTPA_SHARE * settings.voltage_excess)
    limit = fit_limit(region, _LIMIT_SHARE * torque_error)
    grid = _grid(region, settings, mtpa, limit)
    trials: list[SurfaceTrial] = []
    for degrees in sorted(_DEGREES, key=lambda pair: len(monomials(*pair))):
        surface, worst = _fit_surfaces(region, grid, mtpa, limit, degrees)
        step = with_drop(domain, surface, settings)
        close = worst <= _GOOD
        errors = surface_errors(region, surface) if close else None
        voltage = voltage_errors(domain, step, samples) if close else None
        trial = SurfaceTrial(degrees, step.coefficients, step.flash, worst, errors, voltage)
        keeps = (
            errors is not None and voltage is not None and _keeps(errors, voltage, settings, region)
        )
        if step.flash > settings.flash:
            if keeps:
                raise NoSolutionError(_too_small(step.flash, settings))
            continue
        trials.append(replace(trial, chosen=keeps))
        if errors is not None and voltage is not None and keeps:
            return WeakeningFit(
                settings=settings,
                domain=domain,
                step=step,
                errors=errors,
                voltage=voltage,
                trials=tuple(trials),
                certificate=certify_step(domain, step),
                chart=error_chart(region, step.surface),
            )
    raise NoSolutionError(_refusal(trials, settings))


def _keeps(
    errors: SurfaceErrors,
    voltage: VoltageErrors,
    settings: WeakeningSettings,
    region: WeakeningRegion,
) -> bool:
    # The current limit is kept as well as the voltage limit.
    excess = max(
        errors.flux_excess, errors.current_excess, voltage.voltage_excess, voltage.current_excess
    )
    torque = max(errors.torque, voltage.torque)
    return torque <= settings.torque_error * region.torque_max and excess <= settings.voltage_excess


def _too_small(needed: int, settings: WeakeningSettings) -> str:
    return (
        f"field_weakening: the permitted errors take {needed} B, more than the {settings.flash} B "
        f"that are allowed; write flash: {needed} B, raise torque_error or voltage_excess, or "
        "lower the speed"
    )


def _refusal(trials: list[SurfaceTrial], settings: WeakeningSettings) -> str:
    best = min(trials, key=lambda trial: trial.grid_error) if trials else None
    found = (
        ""
        if best is None
        else f" ({best.grid_error:.3g} times the permitted ones within {settings.flash} B at best)"
    )
    return (
        f"field_weakening: no size keeps the permitted errors{found}; lower the speed, raise "
        "torque_error or voltage_excess"
    )


# What a two-dimensional reference errs by over its domain, and the lines that divide the domain:
# for people to see.

_COUNT = 56
_BORDER_POINTS = 200
_BEYOND = 1.04  # Multiple of the largest flux linkage at which the chart ends.


@dataclass(frozen=True, slots=True)
class DomainBorders:
    """Lines in the plane of available flux linkage in Wb and torque in N m.

    ``mtpa_flux`` and ``mtpa_torque``, shape (K,), are the least-loss currents, above which the
    field is weakened; ``flux`` and ``largest_torque``, shape (N,), the most torque that can be had.
    ``mtpv``, shape (N,), says where the voltage alone holds that torque.
    """

    mtpa_flux: FloatArray
    mtpa_torque: FloatArray
    flux: FloatArray
    largest_torque: FloatArray
    mtpv: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ErrorChart:
    """Errors of the float32 currents over available flux linkage in Wb and torque in N m,
    arrays of shape (N, N).

    The flux linkage varies along the first axis, the torque along the second up to the largest of
    its row. ``torque_error`` is relative to the largest torque of all, ``voltage_error`` to the
    voltage of the optimum, both signed fractions; where the optimum takes less than the least flux
    linkage, only too little is counted.
    """

    flux: FloatArray
    torque: FloatArray
    torque_error: FloatArray
    voltage_error: FloatArray
    borders: DomainBorders


def _samples(region: WeakeningRegion) -> SurfaceSamples:
    """Even grid up to the largest torque of each flux linkage, flux linkages along the first
    axis.
    """
    flux = np.linspace(region.flux_min, _BEYOND * region.flux_max, _COUNT)
    most = region.largest_torque(flux)
    torque = np.linspace(0.0, 1.0, _COUNT) * most[:, np.newaxis]
    spread, limits = (
        np.broadcast_to(row[:, np.newaxis], torque.shape).ravel() for row in (flux, most)
    )
    return SurfaceSamples(torque.astype(np.float32).ravel(), spread.astype(np.float32), limits)


def _borders(region: WeakeningRegion) -> DomainBorders:
    torque = np.linspace(0.0, region.torque_max, _BORDER_POINTS)
    taken = region.flux(*region.mtpa(torque))
    seen = taken >= region.flux_min
    flux = np.linspace(region.flux_min, _BEYOND * region.flux_max, _BORDER_POINTS)
    points = region.points(np.full(flux.size, 2.0 * region.torque_max), flux)
    return DomainBorders(
        taken[seen], torque[seen], flux, points.torque, points.active == Active.MTPV
    )


def error_chart(region: WeakeningRegion, reference: WeakeningReference) -> ErrorChart:
    """Errors of a reference over an even grid of its domain, without fused multiply-add."""
    samples = _samples(region)
    found = error_map(region, reference, samples)
    shape = (_COUNT, _COUNT)
    flux, torque = (
        values.astype(np.float64).reshape(shape) for values in (samples.flux, samples.torque)
    )
    # Where MTPA takes less than is available, that is what is aimed at.
    aim = np.minimum(region.flux(*region.mtpa(torque.ravel())), flux.ravel())
    excess = region.flux(found.i_d, found.i_q) / np.maximum(aim, 0.5 * region.flux_min) - 1.0
    excess = np.where(aim < region.flux_min, np.minimum(excess, 0.0), excess)
    return ErrorChart(
        flux=flux,
        torque=torque,
        torque_error=(found.torque / region.torque_max).reshape(shape),
        voltage_error=excess.reshape(shape),
        borders=_borders(region),
    )


# What a current reference over torque and flux linkage needs to know of the resistance drop.

# Share of the permitted voltage excess up to which a bound of the current stands for the current
# itself.
_NEGLIGIBLE = 0.1
_LEVELS = 201

# Share of the squared current limit by which the emitted currents may lie above the exact ones.
_MARGIN = 0.003

# Share of the squared current limit below which it is worth saying that MTPV takes less than the
# limit.
_WORTH = 0.97


def _single_above(value: float) -> np.float32:
    """The least float that is not below a number."""
    found = np.float32(value)
    return found if float(found) >= value else np.nextafter(found, np.float32(np.inf))


def _near_mtpv(region: VoltageRegion) -> tuple[float, float] | None:
    """(c, e): |i|^2 <= c + e a^2 at the largest torque of every flux linkage a at which the
    current is not the limit.

    The line lies as low as it can (a linear programme). None where the
    current limit holds everywhere.
    """
    flux, square = region.flux, region.flux.i_max**2
    levels = np.linspace(flux.flux_min, flux.flux_max, _LEVELS)
    points = flux.points(np.full(_LEVELS, 2.0 * flux.torque_max), levels)
    used = (points.i_d**2 + points.i_q**2) / square
    below = used < 1.0 - 1e-6
    if not np.any(used < _WORTH):
        return None
    argument, target = (levels[below] / flux.flux_max) ** 2, used[below] + _MARGIN
    rows = np.column_stack([np.ones(argument.size), argument])
    found = least_cost(rows.sum(axis=0), -rows, -target, bounds=(0.0, np.inf))
    if found is None:
        return None
    constant, slope = (float(part) * square for part in found)
    return constant, slope / flux.flux_max**2


def with_drop(
    region: VoltageRegion, surface: WeakeningReference, settings: WeakeningSettings
) -> DropReference:
    """The whole step about a surface: what the resistance takes of the voltage,
    bounded and then evaluated.
    """
    r_s, i_max = region.machine.r_s, region.flux.i_max
    share = (r_s * i_max / (LEAST_VOLTAGE * region.v_max)) ** 2
    passes = 1 if 0.5 * share <= _NEGLIGIBLE * settings.voltage_excess else 2
    near = _near_mtpv(region) if passes > 1 else None
    return DropReference(
        surface=surface,
        torque_max=np.float32(region.flux.torque_max),
        per_torque=np.float32(region.per_torque),
        square=np.float32(r_s**2),
        reserve=_single_above((r_s * i_max) ** 2),
        near=None
        if near is None
        else (_single_above(near[0] * r_s**2), _single_above(near[1] * r_s**2)),
        passes=passes,
    )


# The field-weakening reference that a design asks for.


@on_design("field_weakening")
def solve_weakening(design: Design) -> WeakeningFit | None:
    """Two-dimensional reference of the design, None where it asks for none.

    Raises:
        NoSolutionError: As `fit_weakening`.
    """
    if design.weakening is None:
        return None

    return fit_weakening(design.machine, design.i_max, design.v_max, design.weakening)
