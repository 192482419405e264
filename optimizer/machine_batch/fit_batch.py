"""Current references of many linear machines at once: `fit_reference` for columns.

What is fitted, under which conditions and in which forms is as in
`dqforge.optimizer.current_reference.fit`; minimax fits by reweighting and breakpoints from a table
make it some thousand times cheaper, and 1 or 2 % worse. Headers are made by the single path alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.errors import InputError
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.cost_model import AXES
from dqforge.optimizer.current_reference.fit import least_degree
from dqforge.optimizer.curves.fitting import SideConditions
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.machine_batch.batch_currents import (
    drives,
    largest_torques,
    strategy_currents,
)
from dqforge.optimizer.machine_batch.batch_fits import (
    BATCH_METHODS,
    fit_columns,
    local_powers,
    power_values,
    segment_points,
)
from dqforge.optimizer.machine_batch.breakpoint_table import SharedFit, breakpoint_shares
from dqforge.optimizer.machine_batch.float_references import (
    BatchErrors,
    FormColumns,
    form_errors,
)
from dqforge.optimizer.machine_batch.local_series import series_space

_TOGETHER = 512  # Machines fitted at once: their arrays stay in the cache.
_MOST_SEGMENTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceBatch:
    """Current references of N machines.

    Args:
        settings: What was asked for.
        torque_max: Ends of the domains in N m, shape (N,).
        edges, coefficients: By axis where the form has a polynomial: edges in N m, shape (S + 1,
            N), and ascending powers of t - edge in A/(N m)^k, shape (S, n + 1, N).
        errors: Largest errors, arrays of shape (N,).
        solved: False where the single path has to say what is wrong, or to answer: no torque is
            made, the domain asked for needs more current, a breakpoint lies beyond it, or the form
            does not suit the machine. All numbers are NaN there.
    """

    settings: FitSettings
    torque_max: FloatArray
    edges: dict[str, FloatArray]
    coefficients: dict[str, FloatArray]
    errors: BatchErrors
    solved: BoolArray

    def piecewise(self, axis: str, row: int) -> PiecewisePolynomial:
        """The polynomials of one machine, A over N m."""
        return PiecewisePolynomial(
            self.edges[axis][:, row].copy(), self.coefficients[axis][..., row].copy()
        )


def why_not_in_batch(settings: FitSettings) -> str | None:
    """What of fit settings columns do not have, in words; None where they have all of it.

    Args:
        settings: Of a linear machine's reference, for operation below the voltage limit.
    """
    if settings.budget is not None or settings.format not in (None, "float32"):
        return "a budget or a fixed-point format"
    if settings.method not in BATCH_METHODS:
        return f"method {settings.method}"
    if settings.segments > _MOST_SEGMENTS:
        return f"{settings.segments} segments"
    if settings.degree < least_degree(settings.form, settings):
        return f"degree {settings.degree}"
    return None


def fit_references(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy = "mtpa"
) -> ReferenceBatch:
    """Current references of many machines.

    Args:
        batch: N machines.
        settings: Form, method, degree, segments, breakpoints, side conditions, and the end of the
            domain where it is given.
        strategy: ``mtpa`` or ``id0``.

    Raises:
        InputError: The settings ask for what columns do not have (`why_not_in_batch`).
    """
    lacking = why_not_in_batch(settings)
    if lacking is not None:
        raise InputError(f"fit: {lacking} is not fitted in batches")
    end, solved = _domains(batch, settings, strategy)
    rows = np.flatnonzero(solved)
    groups = np.split(rows, np.arange(_TOGETHER, rows.size, _TOGETHER)) if rows.size else []
    parts = [_fitted(batch.taken(group), settings, strategy, end[group]) for group in groups]
    return _spread(settings, np.where(solved, end, np.nan), solved, parts)


def _domains(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy
) -> tuple[FloatArray, BoolArray]:
    """Ends of the domains in N m, and which machines can be fitted over them."""
    most = largest_torques(batch, strategy)
    end = most if settings.torque_max is None else np.full(most.shape, settings.torque_max)
    solved = drives(batch, strategy) & (end <= most * (1.0 + 1e-12))
    if settings.breakpoints:
        solved &= end > settings.breakpoints[-1]
    if settings.form in ("torque-exact", "even-odd"):
        solved &= batch.psi_pm > 0.0
    return end, solved


def _fitted(
    batch: MachineBatch, settings: FitSettings, strategy: Strategy, end: FloatArray
) -> tuple[FormColumns, BatchErrors]:
    magnet = batch.psi_pm > 0.0
    proportional = magnet & ((batch.saliency == 0.0) | (strategy == "id0"))
    rooted = ~magnet & (settings.form == "closed-form")
    edges = _edges(batch, settings, end, proportional)
    coefficients: dict[str, FloatArray] = {}
    for axis in AXES[settings.form]:
        coefficients[axis] = _axis_fit(batch, settings, strategy, edges, coefficients, axis)
        coefficients[axis][..., proportional | rooted] = 0.0
    columns = FormColumns(settings.form, edges, coefficients, proportional, rooted)
    return columns, form_errors(batch, strategy, columns, end)


def _edges(
    batch: MachineBatch, settings: FitSettings, end: FloatArray, straight: BoolArray
) -> dict[str, FloatArray]:
    """Edges of each axis in N m, shape (S + 1, N)."""
    axes, zero = AXES[settings.form], np.zeros_like(end)
    if settings.segments == 1:
        return dict.fromkeys(axes, np.stack([zero, end]))
    if settings.breakpoints is not None:
        return dict.fromkeys(axes, np.stack([zero, zero + settings.breakpoints[0], end]))
    size = np.where(straight, 1.0, np.abs(batch.saliency))
    base_torque = 0.75 * batch.pole_pairs * batch.psi_pm * (batch.psi_pm / (2.0 * size))
    bent = np.where(base_torque > 0.0, end / np.where(base_torque > 0.0, base_torque, 1.0), np.inf)
    tau = np.where(straight, 0.0, bent)
    side = SideConditions(settings.exact_at_zero, settings.continuous)
    groups = [(axis,) for axis in axes] if settings.breakpoint_mode == "own" else [axes]
    edges: dict[str, FloatArray] = {}
    for group in groups:
        shares = breakpoint_shares(SharedFit(group, settings.degree, settings.method, side), tau)
        edges |= dict.fromkeys(group, np.stack([zero, shares * end, end]))
    return edges


def _axis_fit(
    batch: MachineBatch,
    settings: FitSettings,
    strategy: Strategy,
    edges: dict[str, FloatArray],
    before: dict[str, FloatArray],
    axis: str,
) -> FloatArray:
    """Coefficients of one axis, shape (S, n + 1, N); ``before`` are those of the axes before it."""
    side, degree = SideConditions(settings.exact_at_zero, settings.continuous), settings.degree
    if settings.form == "even-odd":
        side = SideConditions(True, settings.continuous, (1,) if axis == "d" else (2,))
        degree += axis == "q"
    elif settings.flat_at_zero and axis == "d":
        side = replace(side, absent=(1,))
    space = series_space(degree, settings.segments, side)
    points = segment_points(space.nodes, edges[axis])
    if settings.form == "even-odd" and axis == "q":
        slope = -1.5 * batch.pole_pairs * batch.saliency
        d = power_values(before["d"], edges["d"], points)
        values = points / (batch.torque_per_ampere + slope * d)
    else:
        values = strategy_currents(batch, strategy, points)["dq".index(axis)]
    widths = np.diff(edges[axis], axis=0)
    series, _ = fit_columns(space, settings.method, widths, values)
    coefficients = local_powers(series, widths)
    if side.exact_at_zero:
        coefficients[0, 0] = 0.0  # but for rounding
    coefficients[0, list(side.absent)] = 0.0
    return coefficients


def _spread(
    settings: FitSettings,
    end: FloatArray,
    solved: BoolArray,
    parts: list[tuple[FormColumns, BatchErrors]],
) -> ReferenceBatch:
    """Parts side by side, with NaN where nothing was solved."""

    def spread(pieces: list[FloatArray]) -> FloatArray:
        whole = np.concatenate(pieces, axis=-1) if pieces else np.zeros((0,))
        found = np.full((*whole.shape[:-1], solved.size), np.nan)
        found[..., solved] = whole
        return found

    errors: dict[str, Any] = {
        name: spread([getattr(part, name) for _, part in parts])
        for name in ("i_d", "i_q", "torque", "torque_relative")
    }
    axes = parts[0][0].coefficients if parts else ()
    return ReferenceBatch(
        settings,
        end,
        {axis: spread([columns.edges[axis] for columns, _ in parts]) for axis in axes},
        {axis: spread([columns.coefficients[axis] for columns, _ in parts]) for axis in axes},
        BatchErrors(**errors),
        solved,
    )
