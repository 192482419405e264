"""Current references over torque and available flux linkage as the firmware evaluates them,
and their errors.

The evaluator is the list of float32 operations that the header spells out, so that the errors
stated for it are those of the very arithmetic that runs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import PENALTY_FROM
from dqforge.optimizer.curves.single_precision import (
    MultiplyAdd,
    SingleArray,
    SinglePolynomial,
    fused_multiply_add,
    multiply_add,
)
from dqforge.optimizer.field_weakening.exact import WeakeningRegion

# Code and literals of the emitted evaluator on a Cortex-M4F: fixed part, and per coefficient (its
# load, its product, its sum and the literal itself). Above what gcc 12 makes with -O2 and without
# fused multiply-add; -Os saves a third.
_BYTES = 260, 18


@dataclass(frozen=True, slots=True)
class SingleSurface:
    """A polynomial in two variables with float32 coefficients: ``rows[j]`` holds
    rising powers of x beside y^j.
    """

    rows: tuple[SingleArray, ...]

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(row.size for row in self.rows)

    def evaluate(self, x: SingleArray, y: SingleArray, muladd: MultiplyAdd) -> SingleArray:
        """Value at float32 arguments, both shape (N,): Horner's rule in y over Horner's rule in
        x.
        """
        value = self._row(len(self.rows) - 1, x, muladd)
        for power in range(len(self.rows) - 2, -1, -1):
            value = muladd(value, y, self._row(power, x, muladd))
        return value

    def _row(self, power: int, x: SingleArray, muladd: MultiplyAdd) -> SingleArray:
        row = self.rows[power]
        value = np.full(x.shape, row[-1])
        for coefficient in row[-2::-1]:
            value = muladd(value, x, np.asarray(coefficient))
        return value


@dataclass(frozen=True, slots=True)
class WeakeningReference:
    """i_d and i_q in A over torque in N m and available flux linkage in Wb.

    t = min(|T|, ``limit``(a - ``flux_min``)); delta = ``flux``(t) - a is what the MTPA currents
    ``d``(t), ``q``(t) take too much; where it is positive, i_d = d(t) + delta D(x, y) and i_q =
    q(t) + delta t Q(x, y) with x = t - ``torque_mid``, y = delta - ``excess_mid``. Both are
    continuous across delta = 0, and i_q(0) = 0, whatever the coefficients. ``d``, ``q`` and
    ``flux`` have the same segments.
    """

    flux_min: np.float32
    flux_max: np.float32
    limit: SinglePolynomial
    d: SinglePolynomial
    q: SinglePolynomial
    flux: SinglePolynomial
    torque_mid: np.float32
    excess_mid: np.float32
    surface_d: SingleSurface
    surface_q: SingleSurface

    @property
    def coefficients(self) -> int:
        """Number of constants that the emitted C spells out."""
        curves = sum(
            polynomial.coefficients.size for polynomial in (self.limit, self.d, self.q, self.flux)
        )
        return curves + self.surface_d.size + self.surface_q.size

    @property
    def flash(self) -> int:
        """Estimate of the bytes of code and constants on a Cortex-M4F, without fused
        multiply-add.
        """
        fixed, each = _BYTES
        return fixed + each * self.coefficients

    def limited(
        self, torque: SingleArray, flux: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, ...]:
        """Magnitude of the torque within the limit in N m and clamped flux linkage in Wb,
        shape (N,) each.

        NaN as a torque counts as none; NaN as a flux linkage as no torque at the least flux
        linkage, which keeps the voltage limit at every speed of the design.
        """
        muladd = fused_multiply_add if fused else multiply_add
        torque, flux = np.asarray(torque, dtype=np.float32), np.asarray(flux, dtype=np.float32)
        with np.errstate(invalid="ignore", under="ignore"):
            t = np.where(torque < 0.0, -torque, torque)
            t = np.where(np.isnan(torque) | np.isnan(flux), np.float32(0.0), t)
            a = np.where(flux >= self.flux_min, flux, self.flux_min)
            a = np.where(a > self.flux_max, self.flux_max, a)
            most = self.limit.evaluate(a - self.flux_min, muladd)
            return np.where(t > most, most, t), a

    def weakened(
        self,
        t: SingleArray,
        delta: SingleArray,
        base: tuple[SingleArray, SingleArray],
        muladd: MultiplyAdd,
    ) -> tuple[SingleArray, SingleArray]:
        """Currents in A where MTPA currents ``base`` in A take ``delta`` Wb too much,
        shape (N,).
        """
        x, y = t - self.torque_mid, delta - self.excess_mid
        i_d = muladd(delta, self.surface_d.evaluate(x, y, muladd), base[0])
        return i_d, muladd(delta * t, self.surface_q.evaluate(x, y, muladd), base[1])

    def currents(
        self, torque: SingleArray, flux: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A for float32 torques and available flux linkages, shape (N,), in the
        operations of the header.

        ``fused`` models a compiler that contracts products and sums.
        """
        muladd = fused_multiply_add if fused else multiply_add
        t, a = self.limited(torque, flux, fused=fused)
        with np.errstate(invalid="ignore", under="ignore"):
            i_d, i_q = self.d.evaluate(t, muladd), self.q.evaluate(t, muladd)
            delta = self.flux.evaluate(t, muladd) - a
            weakened_d, weakened_q = self.weakened(t, delta, (i_d, i_q), muladd)
            weakens = delta > 0.0
            i_d, i_q = np.where(weakens, weakened_d, i_d), np.where(weakens, weakened_q, i_q)
            return i_d, np.where(np.asarray(torque, dtype=np.float32) < 0.0, -i_q, i_q)


@dataclass(frozen=True, slots=True)
class SurfaceErrors:
    """Largest errors over a dense set of torques and flux linkages, with and
    without fused multiply-add.

    ``torque`` in N m is the torque made less the one asked for or the largest one that can be had,
    ``torque_relative`` that over the largest torque of the machine; ``flux_excess`` is the flux
    linkage (and with it the voltage) beyond the available one, relative to it; ``current_excess``
    the current beyond the limit, relative to it. ``loss_relative`` is the copper loss above the
    least for the torque and the flux linkage that are really taken, from 5 % of the largest torque
    upwards. Found by sampling: not bounds.
    """

    torque: float
    torque_relative: float
    flux_excess: float
    current_excess: float
    loss_relative: float
    samples: int


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Where errors are measured: float32 torques in N m and flux linkages in Wb,
    and the largest torque, shape (N,).
    """

    torque: SingleArray
    flux: SingleArray
    most: FloatArray


@dataclass(frozen=True, slots=True)
class ErrorMap:
    """Errors at `SurfaceSamples`, shape (N,): torque in N m, flux and current excess
    relative (negative: none).
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    flux_excess: FloatArray
    current_excess: FloatArray


def surface_samples(region: WeakeningRegion, count: int) -> SurfaceSamples:
    """Grid of ``count`` flux linkages by ``count`` torques from zero to beyond the largest,
    denser at either end.
    """
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    even = np.linspace(0.0, 1.0, count)
    flux = (region.flux_min + (region.flux_max - region.flux_min) * even).astype(np.float32)
    # A flux linkage that rounding put below the least one is clamped by the evaluator, too.
    most = region.largest_torque(np.clip(flux.astype(np.float64), region.flux_min, None))
    torque = np.append(share, 1.05) * most[:, np.newaxis]
    spread = np.broadcast_to(flux[:, np.newaxis], torque.shape)
    limits = np.broadcast_to(most[:, np.newaxis], torque.shape)
    return SurfaceSamples(torque.astype(np.float32).ravel(), spread.ravel(), limits.ravel())


def error_map(
    region: WeakeningRegion,
    reference: WeakeningReference,
    samples: SurfaceSamples,
    *,
    fused: bool = False,
) -> ErrorMap:
    """Torque and limits of the float32 currents, by the machine in double."""
    i_d, i_q = (
        current.astype(np.float64)
        for current in reference.currents(samples.torque, samples.flux, fused=fused)
    )
    wanted = np.minimum(samples.torque.astype(np.float64), samples.most)
    psi_d, psi_q = region.machine.flux(i_d, i_q)
    torque = 1.5 * region.machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
    available = np.maximum(samples.flux.astype(np.float64), region.flux_min)
    return ErrorMap(
        i_d,
        i_q,
        torque - wanted,
        np.hypot(psi_d, psi_q) / available - 1.0,
        np.hypot(i_d, i_q) / region.i_max - 1.0,
    )


def _loss_penalty(
    region: WeakeningRegion, errors: ErrorMap, samples: SurfaceSamples, chosen: NDArray[np.intp]
) -> float:
    """Largest relative copper loss above the least at some of the samples."""
    i_d, i_q = errors.i_d[chosen], errors.i_q[chosen]
    flux = np.maximum(samples.flux[chosen].astype(np.float64), region.flux(i_d, i_q))
    best = region.points(region.machine.torque(i_d, i_q), flux)
    least = best.i_d**2 + best.i_q**2
    # At the largest torque the optimum itself is on the brink: only what could be had is compared.
    loaded = best.reached & (np.abs(best.torque) > PENALTY_FROM * region.torque_max)
    excess = (i_d**2 + i_q**2 - least)[loaded] / least[loaded]
    return float(np.max(excess, initial=0.0))


def surface_errors(
    region: WeakeningRegion, reference: WeakeningReference, count: int = 300
) -> SurfaceErrors:
    """Largest errors over ``count`` squared samples in the arithmetic of the
    emitted C (both contractions).
    """
    samples = surface_samples(region, count)
    maps = [error_map(region, reference, samples, fused=fused) for fused in (False, True)]
    torque = max(float(np.max(np.abs(found.torque))) for found in maps)
    chosen = np.arange(0, samples.torque.size, max(samples.torque.size // 3000, 1))
    return SurfaceErrors(
        torque=torque,
        torque_relative=torque / region.torque_max,
        flux_excess=max(float(np.max(found.flux_excess)) for found in maps),
        current_excess=max(float(np.max(found.current_excess)) for found in maps),
        loss_relative=_loss_penalty(region, maps[0], samples, chosen),
        samples=2 * samples.torque.size,
    )
