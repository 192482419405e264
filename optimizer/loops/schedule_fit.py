"""Gains over the current as float32 polynomials or as a table, whichever takes
fewer bytes on the controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import Curve, SideConditions, fit_curve
from dqforge.optimizer.curves.single_precision import MultiplyAdd, SingleArray, multiply_add

# Gains in V/A in the order of the results; ki_ts is the integral gain times the sampling period.
FloatArray = NDArray[np.float64]
ScheduleForm = Literal["polynomial", "table"]
GAIN_NAMES = ("kp_d", "ki_ts_d", "kp_q", "ki_ts_q")
_CONSTANT = 1e-6  # relative range below which a gain is one number
_LARGEST_DEGREE = 6
_LARGEST_TABLE = 129
_BREAKPOINTS = np.linspace(0.1, 0.7, 13)
_DENSE = 2001
_FREE = SideConditions(exact_at_zero=False, continuous=True)

# Thumb-2 with an FPU: bytes of a multiply and an add with their literal, of what every gain takes,
# and of the rest.
_PER_POWER, _PER_GAIN, _PER_SEGMENT = 16, 12, 12
_TABLE_BASE, _TABLE_PER_GAIN = 44, 28


@dataclass(frozen=True, slots=True)
class GainEvaluator:
    """What the firmware evaluates, in its order of operations; every number is a float32.

    Args:
        end: Largest |i_q| in A; beyond it the gains stay.
        fallback: Gains by name for a current that is not a number: the constant ones, for the least
            inductance.
        constants: Gains that do not change with the current.
        starts: Of polynomials the first current of each segment, shape (S,).
        polynomials: Ascending coefficients by gain, shape (S, n + 1) each, of |i_q| less the start
            of the segment.
        inverse_step: Of a table the points per ampere.
        tables: Values at even steps from 0 by gain, shape (N,) each.
    """

    end: np.float32
    fallback: Mapping[str, np.float32]
    constants: Mapping[str, np.float32]
    starts: SingleArray = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    polynomials: Mapping[str, SingleArray] = field(default_factory=dict)
    inverse_step: np.float32 = field(default_factory=np.float32)
    tables: Mapping[str, SingleArray] = field(default_factory=dict)

    @property
    def form(self) -> ScheduleForm:
        """Whether the gains that change are polynomials or a table."""
        return "table" if self.tables else "polynomial"

    @property
    def flash(self) -> int:
        """Bytes of code and constants on a Cortex-M4F, estimated."""
        constant = 8 * len(self.constants)
        if self.tables:
            points = sum(table.size for table in self.tables.values())
            return constant + 4 * points + _TABLE_BASE + _TABLE_PER_GAIN * len(self.tables)
        powers = sum(rows.shape[0] * (rows.shape[1] - 1) for rows in self.polynomials.values())
        segments = self.starts.size * (_PER_GAIN * len(self.polynomials) + _PER_SEGMENT)
        return int(constant + _PER_POWER * powers + segments)

    def gains(self, i_q: SingleArray, muladd: MultiplyAdd = multiply_add) -> SingleArray:
        """Gains at float32 currents in A, shape (M,) -> (M, 4) in the order of `GAIN_NAMES`."""
        size = np.where(i_q < 0.0, -i_q, i_q)
        at = np.where(size <= self.end, size, np.where(size > self.end, self.end, np.float32(0.0)))
        result = np.empty((i_q.size, len(GAIN_NAMES)), dtype=np.float32)
        for column, name in enumerate(GAIN_NAMES):
            if name in self.constants:
                value = np.full(i_q.shape, self.constants[name], dtype=np.float32)
            elif name in self.tables:
                value = self._interpolated(self.tables[name], at, muladd)
            else:
                value = self._polynomial(self.polynomials[name], at, muladd)
            result[:, column] = np.where(np.isnan(i_q), self.fallback[name], value)
        return result

    def _polynomial(self, rows: SingleArray, at: SingleArray, muladd: MultiplyAdd) -> SingleArray:
        segment = np.searchsorted(self.starts[1:], at, side="right")
        local = at - self.starts[segment]
        chosen = rows[segment]
        value = chosen[:, -1]
        for power in range(rows.shape[1] - 2, -1, -1):
            value = muladd(value, local, chosen[:, power])
        return np.asarray(value, dtype=np.float32)

    def _interpolated(
        self, table: SingleArray, at: SingleArray, muladd: MultiplyAdd
    ) -> SingleArray:
        place = at * self.inverse_step
        index = np.minimum(place.astype(np.int32), np.int32(table.size - 2))
        share = place - index.astype(np.float32)
        return np.asarray(
            muladd(share, table[index + 1] - table[index], table[index]), dtype=np.float32
        )


@dataclass(frozen=True, slots=True)
class ScheduleFit:
    """An evaluator, its largest relative error by gain, and the bytes of the best of each form,
    None if none held.
    """

    evaluator: GainEvaluator
    errors: Mapping[str, float]
    flash: Mapping[ScheduleForm, int | None]


def fit_gains(
    curves: Mapping[str, Curve], end: float, fallback: Mapping[str, float], tolerance: float
) -> ScheduleFit:
    """Fit gains over |i_q| within a relative error, by the form that takes fewer bytes.

    Args:
        curves: The gains of `GAIN_NAMES` in V/A as functions of |i_q| in A.
        end: Largest current in A.
        fallback: Gains for a current that is not a number.
        tolerance: Largest relative error of a gain, in float32, with and without fused
            multiply-add.

    Raises:
        NoSolutionError: Neither form keeps the tolerance.
    """
    single_end = np.float32(end)
    dense = np.linspace(0.0, float(single_end), _DENSE)
    exact = {name: curves[name](dense) for name in GAIN_NAMES}
    varies = [
        name
        for name in GAIN_NAMES
        if np.ptp(exact[name]) > _CONSTANT * float(np.max(np.abs(exact[name])))
    ]
    common = {
        "end": single_end,
        "fallback": {name: np.float32(fallback[name]) for name in GAIN_NAMES},
        "constants": {
            name: np.float32(np.mean(exact[name])) for name in GAIN_NAMES if name not in varies
        },
    }

    def kept(evaluator: GainEvaluator | None) -> GainEvaluator | None:
        return (
            evaluator
            if evaluator is not None and max(errors_of(evaluator, curves).values()) <= tolerance
            else None
        )

    candidates: list[GainEvaluator] = []
    if not varies:
        candidates = [GainEvaluator(**common)]  # type: ignore[arg-type]
    for edges in [
        np.array([0.0, end]),
        *(np.array([0.0, share * end, end]) for share in _BREAKPOINTS),
    ] * bool(varies):
        found = kept(_polynomials(curves, varies, edges, tolerance, common))
        candidates += [] if found is None else [found]
    table = kept(_table(curves, varies, end, tolerance, common)) if varies else None
    least: dict[ScheduleForm, int | None] = {
        "polynomial": min((candidate.flash for candidate in candidates), default=None),
        "table": None if table is None else table.flash,
    }
    candidates += [] if table is None else [table]
    if not candidates:
        raise NoSolutionError(
            f"control.current_loop.schedule: neither polynomials of degree {_LARGEST_DEGREE} nor a "
            f"table of {_LARGEST_TABLE} points follow the gains within {100.0 * tolerance:g} %; "
            "check the flux data for kinks"
        )
    best = min(candidates, key=lambda candidate: candidate.flash)
    return ScheduleFit(best, errors_of(best, curves), least)


def errors_of(evaluator: GainEvaluator, curves: Mapping[str, Curve]) -> dict[str, float]:
    """Largest relative error of each gain on a dense grid of currents, in float32, fused or not.

    Args:
        evaluator: The gains as the firmware computes them.
        curves: Exact gains over the current in A, by name.
    """
    from dqforge.optimizer.curves.single_precision import fused_multiply_add

    at = np.linspace(0.0, float(evaluator.end), _DENSE).astype(np.float32)
    exact = np.stack([curves[name](at.astype(np.float64)) for name in GAIN_NAMES], axis=1)
    worst = np.zeros(len(GAIN_NAMES))
    for muladd in (multiply_add, fused_multiply_add):
        worst = np.maximum(worst, np.max(np.abs(evaluator.gains(at, muladd) / exact - 1.0), axis=0))
    return dict(zip(GAIN_NAMES, worst.tolist(), strict=True))


def _relative_error(fit: Curve, curve: Curve, end: float) -> float:
    at = np.linspace(0.0, end, 401)
    return float(np.max(np.abs(fit(at) / curve(at) - 1.0)))


def _polynomials(
    curves: Mapping[str, Curve],
    varies: list[str],
    edges: FloatArray,
    tolerance: float,
    common: Mapping[str, object],
) -> GainEvaluator | None:
    """Polynomials of the least degree for each gain on given segments, or None."""
    starts = edges[:-1].astype(np.float32)
    edges = np.append(starts.astype(np.float64), edges[-1])
    rows: dict[str, SingleArray] = {}
    for name in varies:
        for degree in range(1, _LARGEST_DEGREE + 1):
            rough = fit_curve(curves[name], edges, degree, "least-squares", _FREE)
            if _relative_error(rough, curves[name], edges[-1]) > 2.0 * tolerance:
                continue
            fit = fit_curve(curves[name], edges, degree, "minimax", _FREE, exchange=False)
            better = min(
                (rough, fit),
                key=lambda candidate: _relative_error(candidate, curves[name], edges[-1]),
            )
            if _relative_error(better, curves[name], edges[-1]) <= 0.999 * tolerance:
                rows[name] = better.coefficients.astype(np.float32)
                break
        else:
            return None
    return GainEvaluator(**common, starts=starts, polynomials=rows)  # type: ignore[arg-type]


def _table(
    curves: Mapping[str, Curve],
    varies: list[str],
    end: float,
    tolerance: float,
    common: Mapping[str, object],
) -> GainEvaluator | None:
    """The shortest table on even steps, or None."""
    for points in range(3, _LARGEST_TABLE + 1):
        inverse = np.float32((points - 1) / end)
        at = np.arange(points) / float(inverse)
        tables = {name: curves[name](np.minimum(at, end)).astype(np.float32) for name in varies}
        found = GainEvaluator(**common, inverse_step=inverse, tables=tables)  # type: ignore[arg-type]
        if max(errors_of(found, curves).values()) <= tolerance:
            return found
    return None
