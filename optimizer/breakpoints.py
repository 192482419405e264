"""Global search of the breakpoints of a split-domain fit.

The objective has several local minima once there are three segments or more, and it is cheap; so a deterministic
global method (DIRECT-L) ranks the unit cube and a derivative-free local one (Nelder-Mead, restarted once) finishes,
both from NLopt.
Nothing is random: the same input gives the same breakpoints.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqforge.machines.synchronous import FloatArray

Objective = Callable[[FloatArray], float]

_NARROWEST = 0.01
"""Least width of a segment as a share of the domain."""

_POSITION_TOLERANCE = 1e-4
"""Share of the domain at which the searches stop."""

_LOCAL_STEPS = (0.03, 0.01)
"""Size of the first simplex of the local search and of its restart, as a share of the domain."""

_DIGITS = 5
"""Breakpoints are rounded to this many significant digits: readable, the same on every machine, and the error of the
fit changes by less than 0.1 %."""


def edges_from_cube(position: FloatArray, end: float) -> FloatArray:
    """Map a point of the unit cube, shape (S - 1,), to ascending edges from 0 to ``end``, shape (S + 1,).

    Sorting makes the cube cover each set of breakpoints; the least width keeps every segment alive.
    """
    inner = np.sort(position) * (1.0 - _NARROWEST * (position.size + 1))
    inner = inner + _NARROWEST * np.arange(1, position.size + 1)
    return np.concatenate([[0.0], inner * end, [end]])


def round_significant(value: float, digits: int = _DIGITS) -> float:
    """Round to significant decimal digits."""
    return float(f"{value:.{digits - 1}e}")


def search(coarse: Objective, fine: Objective, segments: int, end: float) -> FloatArray:
    """Edges with the least objective, shape (S + 1,), inner edges rounded to five significant digits.

    Parameters
    ----------
    coarse:
        Objective of the edges for the global search; may rank only approximately, but must be cheap.
    fine:
        Objective for the local search that follows.
    segments:
        Number of segments S, at least 1.
    end:
        End of the domain.
    """
    if segments == 1:
        return np.array([0.0, end])
    import nlopt

    dimensions = segments - 1

    def minimise(algorithm: int, objective: Objective, start: FloatArray, evaluations: int, step: float) -> FloatArray:
        optimiser = nlopt.opt(algorithm, dimensions)
        optimiser.set_lower_bounds(np.zeros(dimensions))
        optimiser.set_upper_bounds(np.ones(dimensions))
        optimiser.set_min_objective(lambda x, _gradient: objective(edges_from_cube(np.array(x), end)))
        optimiser.set_maxeval(evaluations)
        optimiser.set_xtol_abs(_POSITION_TOLERANCE)
        optimiser.set_initial_step(step)
        return np.array(optimiser.optimize(start))

    best = minimise(nlopt.GN_DIRECT_L, coarse, np.full(dimensions, 0.5), 40 * dimensions**2 + 20, 1.0)
    for step in _LOCAL_STEPS:
        best = minimise(nlopt.LN_NELDERMEAD, fine, best, 40 * dimensions, step)
    edges = edges_from_cube(best, end)
    return np.array([0.0, *(round_significant(edge) for edge in edges[1:-1]), end])
