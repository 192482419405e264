"""The float arithmetic of many current references at once, and its errors.

The operations are those of `dqforge.optimizer.current_reference.forms`, with every product and sum
rounded to float32.
"""

from __future__ import annotations

from functools import cache
from math import comb

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.names import FitForm, Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.machine_batch.batch_currents import strategy_currents
from dqforge.optimizer.machine_batch.batch_fits import segment_points
from dqforge.optimizer.machine_batch.local_series import lobatto_nodes

# Torques per segment and coefficient at which errors are looked at: between them they rise by 1 %,
# seldom 2 %.
_SAMPLES = 8


@dataclass(frozen=True, slots=True, eq=False)
class BatchErrors:
    """Largest errors of references, arrays of shape (N,), as `ReferenceErrors` defines them.

    ``i_d`` and ``i_q`` in A against the exact strategy, ``torque`` in N m against the request,
    ``torque_relative`` over the largest torque: of the float32 arithmetic without fused
    multiply-add, found by sampling.
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    torque_relative: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FormColumns:
    """References of N machines in one form.

    ``edges`` in N m by axis, shape (S + 1, N), and ``coefficients`` in double, ascending powers of
    t - edge, shape (S, n + 1, N), by axis where the form has a polynomial. ``proportional`` marks
    machines whose exact reference is a straight line, ``rooted`` those whose exact one is a root.
    """

    form: FitForm
    edges: dict[str, FloatArray]
    coefficients: dict[str, FloatArray]
    proportional: BoolArray
    rooted: BoolArray


def rounded_in_turn(coefficients: FloatArray, widths: FloatArray) -> SingleArray:
    """Floats of ascending coefficients, shape (S, n + 1, N), as `SinglePolynomial.from_double`.

    Args:
        coefficients: In double.
        widths: Widths of the segments, shape (S, N).
    """
    rows = coefficients.copy()
    for power in range(rows.shape[1] - 1, 0, -1):
        change = rows[:, power] - rows[:, power].astype(np.float32)
        scale = change
        for lower in range(power - 1, 0, -1):
            scale = scale * widths
            rows[:, lower] += _monic_chebyshev(power)[lower] * scale
        rows[:, power] -= change
    # Segments that lack a power keep lacking it and are rounded plainly.
    full = np.all(coefficients[:, 1:] != 0.0, axis=1)[:, np.newaxis]
    return np.where(full, rows, coefficients).astype(np.float32)


@cache
def _monic_chebyshev(degree: int) -> tuple[float, ...]:
    """Ascending coefficients of the monic polynomial with the least largest value on [0, 1]."""
    powers = [
        (-1.0) ** (degree - k) * degree / (degree + k) * comb(degree + k, degree - k) * 4.0**k
        for k in range(degree + 1)
    ]
    return tuple(power / powers[-1] for power in powers)


def form_errors(
    batch: MachineBatch, strategy: Strategy, columns: FormColumns, end: FloatArray
) -> BatchErrors:
    """Errors of references over their domains.

    Args:
        batch: N machines.
        strategy: What is exact.
        columns: References.
        end: Ends of the domains in N m, shape (N,).
    """
    limit = end.astype(np.float32)
    edges = np.concatenate([np.zeros((1, end.size)), *columns.edges.values(), end[np.newaxis]])
    sampled = np.sort(edges, axis=0)  # with own breakpoints each axis has its edges
    degree = max((part.shape[1] - 1 for part in columns.coefficients.values()), default=1)
    points = segment_points(lobatto_nodes(_SAMPLES * (degree + 1) + 1), sampled)
    torque = np.minimum(points.astype(np.float32), limit).reshape(-1, end.size)
    i_d, i_q = (part.astype(np.float64) for part in _currents(batch, columns, torque))
    request = torque.astype(np.float64)
    exact_d, exact_q = strategy_currents(batch, strategy, request)
    worst = _largest(batch.torque(i_d, i_q) - request)
    return BatchErrors(
        _largest(i_d - exact_d), _largest(i_q - exact_q), worst, worst / limit.astype(np.float64)
    )


def _largest(error: FloatArray) -> FloatArray:
    return np.asarray(np.max(np.abs(error), axis=0))


def _currents(
    batch: MachineBatch, columns: FormColumns, torque: SingleArray
) -> tuple[SingleArray, SingleArray]:
    """(i_d, i_q) in A for torques >= 0 in N m, float32, shape (P, N)."""
    values = {
        axis: _polynomial(columns.edges[axis], coefficients, torque)
        for axis, coefficients in columns.coefficients.items()
    }
    magnet = batch.torque_per_ampere.astype(np.float32)
    turn = np.sign(batch.saliency).astype(np.float32)
    # What the exact forms of other machines in the batch divide by zero is not taken.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if columns.form in ("polynomial", "even-odd"):
            found = values["d"], values["q"]
        elif columns.form == "torque-exact":
            slope = (-1.5 * batch.pole_pairs * batch.saliency).astype(np.float32)
            found = values["d"], torque / (slope * values["d"] + magnet)
        else:
            base = (batch.psi_pm / (2.0 * np.abs(batch.saliency))).astype(np.float32)
            root = np.sqrt(values["q"] * values["q"] + base * base)
            found = turn * (base - root), values["q"]
        gain = (1.0 / batch.torque_per_ampere).astype(np.float32)
        rising = (1.0 / (1.5 * batch.pole_pairs * np.abs(batch.saliency))).astype(np.float32)
        rooted = np.sqrt(rising * torque)
        exact_d = np.where(columns.rooted, -turn * rooted, np.float32(0.0))
        exact_q = np.where(columns.rooted, rooted, gain * torque)
    exact = columns.proportional | columns.rooted
    return np.where(exact, exact_d, found[0]), np.where(exact, exact_q, found[1])


def _polynomial(edges: FloatArray, coefficients: FloatArray, torque: SingleArray) -> SingleArray:
    """Piecewise polynomials in float32 at torques (P, N)."""
    floats = rounded_in_turn(coefficients, np.diff(edges, axis=0))
    starts = edges[:-1].astype(np.float32)
    value: NDArray[np.float32] = np.zeros_like(torque)
    for segment, start in enumerate(starts):
        local = torque - start
        part = np.broadcast_to(floats[segment, -1], torque.shape)
        for power in range(floats.shape[1] - 2, -1, -1):
            part = part * local + floats[segment, power]
        value = part if segment == 0 else np.where(torque >= start, part, value)
    return value
