"""Fit of two-dimensional current references, and the choice of the smallest that keeps its
budget.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.curves.two_family_levelling import Aims, level
from dqforge.optimizer.field_weakening.border_curves import Mtpa, fit_limit, fit_mtpa, in_double
from dqforge.optimizer.field_weakening.certificate import SurfaceCertificate, certify_step
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.optimizer.field_weakening.error_chart import ErrorChart, error_chart
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.field_weakening.form import (
    SingleSurface,
    SurfaceErrors,
    WeakeningReference,
    surface_errors,
)
from dqforge.optimizer.field_weakening.resistance_drop import with_drop
from dqforge.optimizer.field_weakening.voltage_region import (
    VoltageErrors,
    VoltageRegion,
    voltage_errors,
    voltage_region,
    voltage_samples,
)

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
