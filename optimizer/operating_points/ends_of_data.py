"""Optimal points where the data of a flux map end: what lies beyond them is
sought again on their edge.

The solver first looks for the optimum as if the data had no end. Where it lies inside them, it is
the optimum among the measured currents, too. Where it lies beyond, the best measured point lies on
the edge of the data: the torque curve, within the limits one connected line, has to cross the edge
to come in; and a most torque inside would have been found.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import CurrentRegion, Machine, torque_from_flux
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    Intervals,
    Problem,
    State,
    Terms,
    bracketed_roots,
    intervals_of,
    loss_terms,
    newton_step,
    voltage_terms,
)

_TOGETHER = 2048


_ROUNDING = 1e-9


def hold_by_data(problem: Problem, state: State, region: CurrentRegion) -> None:
    """Move points that lie beyond the region to the best on its edge.

    ``state`` is changed in place.

    Args:
        problem: Machine, torques and limits of the points.
        state: Currents and multipliers of the points so far.
        region: Where the data of the flux map are.
    """
    outside = np.flatnonzero(~region.contains(state.i_d, state.i_q))
    if outside.size == 0:
        return
    edges = intervals_of(problem.machine, region, problem.i_max)
    for first in range(0, outside.size, _TOGETHER):
        part = outside[first : first + _TOGETHER]
        _hold(problem.take(part), state, part, edges)


def _hold(problem: Problem, state: State, index: IndexArray, edges: Intervals) -> None:
    """Least loss for the torque where an edge has it within the limits, else the most torque,
    or the least.
    """
    state.active[index], state.reached[index], state.least[index] = Active.DATA, True, False
    state.torque[index] = problem.torque
    i_d, i_q, found = _on_the_torque_curve(problem, edges)
    state.i_d[index[found]], state.i_q[index[found]] = i_d[found], i_q[found]
    rest = np.flatnonzero(~found)
    if rest.size:
        _grant(problem.take(rest), state, index[rest], edges)


def _pairs(rows: IndexArray, count: int, score: FloatArray) -> tuple[IndexArray, BoolArray]:
    """Place of the lowest score of each row, shape (count,), and whether a
    row has any that is finite.
    """
    order = np.lexsort((score, rows))
    order = order[np.isfinite(score[order])]
    first = np.zeros(count, dtype=np.intp)
    owners, places = np.unique(rows[order], return_index=True)
    first[owners] = order[places]
    has = np.zeros(count, dtype=np.bool_)
    has[owners] = True
    return first, has


def _on_the_torque_curve(
    problem: Problem, edges: Intervals
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Least loss among the crossings of the torque curves with the edges that keep the
    voltage limit, shape (N,).
    """
    end_d, end_q = edges.ends()
    torque = problem.machine.torque(end_d, end_q)
    low, high = np.min(torque, axis=0), np.max(torque, axis=0)
    wanted = problem.torque[:, np.newaxis]
    rows, which = np.nonzero((wanted >= low) & (wanted <= high))

    def follow(places: IndexArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, slope, _ = edges.torque(which[places], share)
        return value - problem.torque[rows[places]], slope

    rising = torque[1, which] >= torque[0, which]
    share = bracketed_roots(follow, np.zeros(rows.size), np.ones(rows.size), rising=rising)
    i_d, i_q = edges.point(which, share)
    here = problem.take(rows)
    jet = problem.machine.jet(i_d, i_q)
    volts = voltage_terms(problem.machine, jet, i_d, i_q, here.omega_e).value
    lost = loss_terms(here.loss, jet, i_d, i_q, problem.soft).value
    best, found = _pairs(
        rows, problem.torque.size, np.where(volts <= _with_slack(here.v_max), lost, np.inf)
    )
    if rows.size == 0:
        return np.zeros(problem.torque.size), np.zeros(problem.torque.size), found
    return i_d[best], i_q[best], found


def _with_slack(v_max: FloatArray) -> FloatArray:
    return v_max**2 * (1.0 + _ROUNDING)


IndexArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Points on the edges that keep the voltage limit, shape (C,), and the
    row that each belongs to.
    """

    rows: IndexArray
    i_d: FloatArray
    i_q: FloatArray


def _within_voltage(problem: Problem, edges: Intervals) -> _Candidates:
    """Ends of intervals within the voltage limit, and where intervals cross it,
    for each of N points.
    """
    end_d, end_q = edges.ends()
    machine, omega = problem.machine, problem.omega_e[:, np.newaxis, np.newaxis]
    jet = machine.jet(end_d.ravel(), end_q.ravel())
    psi_d, psi_q, l_dd, l_dq, l_qd, l_qq = (
        part.reshape(end_d.shape)
        for part in (jet.psi_d, jet.psi_q, jet.l_dd, jet.l_dq, jet.l_qd, jet.l_qq)
    )
    v_d, v_q = machine.r_s * end_d - omega * psi_q, machine.r_s * end_q + omega * psi_d
    gap = v_d * v_d + v_q * v_q - problem.v_max[:, np.newaxis, np.newaxis] ** 2  # (N, 2, J)
    by_d = machine.r_s * edges.step_d - omega * (l_qd * edges.step_d + l_qq * edges.step_q)
    by_q = machine.r_s * edges.step_q + omega * (l_dd * edges.step_d + l_dq * edges.step_q)
    slope = v_d * by_d + v_q * by_q
    row, end, which = np.nonzero(gap <= 0.0)
    parts = [_Candidates(row, end_d[end, which], end_q[end, which])]
    crossing = (gap[:, 0] > 0.0) != (gap[:, 1] > 0.0)
    row, which = np.nonzero(crossing)
    zeros = np.zeros(row.size)
    parts.append(
        _voltage_roots(problem, edges, row, which, zeros, zeros + 1.0, gap[row, 0, which] <= 0.0)
    )
    # The voltage may dip below its limit between two ends that exceed it:
    # at the end of the speed range.
    dip = (gap[:, 0] > 0.0) & (gap[:, 1] > 0.0) & (slope[:, 0] < 0.0) & (slope[:, 1] > 0.0)
    row, which = np.nonzero(dip)
    if row.size:
        parts += _dips(problem, edges, row, which)
    return _Candidates(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("rows", "i_d", "i_q")
        )
    )


def _voltage_roots(
    problem: Problem,
    edges: Intervals,
    rows: IndexArray,
    which: IndexArray,
    low: FloatArray,
    high: FloatArray,
    rising: BoolArray,
) -> _Candidates:
    """Where intervals cross the voltage limit between two shares of them."""
    here = problem.take(rows)

    def follow(places: IndexArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        i_d, i_q = edges.point(which[places], share)
        jet = problem.machine.jet(i_d, i_q)
        terms = voltage_terms(problem.machine, jet, i_d, i_q, here.omega_e[places])
        slope = terms.d * edges.step_d[which[places]] + terms.q * edges.step_q[which[places]]
        return terms.value - here.v_max[places] ** 2, slope

    return _Candidates(rows, *edges.point(which, bracketed_roots(follow, low, high, rising=rising)))


def _dips(
    problem: Problem, edges: Intervals, rows: IndexArray, which: IndexArray
) -> list[_Candidates]:
    """Both ends of what the voltage limit leaves within intervals whose ends exceed it."""
    here = problem.take(rows)
    d, q = edges.step_d[which], edges.step_q[which]

    def terms_at(
        places: IndexArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        i_d, i_q = edges.point(which[places], share)
        jet = problem.machine.jet(i_d, i_q)
        terms = voltage_terms(problem.machine, jet, i_d, i_q, here.omega_e[places])
        d_, q_ = d[places], q[places]
        bend = terms.dd * d_ * d_ + 2.0 * terms.dq * d_ * q_ + terms.qq * q_ * q_
        return terms.value, terms.d * d_ + terms.q * q_, bend

    rising = np.ones(rows.size, dtype=np.bool_)
    lowest = bracketed_roots(
        lambda places, share: terms_at(places, share)[1:],
        np.zeros(rows.size),
        np.ones(rows.size),
        rising=rising,
    )
    deep = np.flatnonzero(terms_at(np.arange(rows.size), lowest)[0] <= here.v_max**2)
    row, at, low, high = rows[deep], which[deep], lowest[deep], np.ones(deep.size)
    return [
        _voltage_roots(problem, edges, row, at, np.zeros(deep.size), low, ~rising[deep]),
        _voltage_roots(problem, edges, row, at, low, high, rising[deep]),
    ]


def _grant(problem: Problem, state: State, index: IndexArray, edges: Intervals) -> None:
    """The most torque within the limits, or the least where even that is more.

    The least voltage where none is.
    """
    count = problem.torque.size
    given = _within_voltage(problem, edges)
    torque = problem.machine.torque(given.i_d, given.i_q)
    most, found = _pairs(given.rows, count, -torque)
    least, _ = _pairs(given.rows, count, torque)
    if given.rows.size:
        too_much = torque[most] > problem.torque * (1.0 + _ROUNDING)
        chosen = np.where(too_much, least, most)
        # Where the torque curve runs between two points of the edge,
        # the inner point was taken before.
        rows = np.flatnonzero(found)
        here, at = index[rows], chosen[rows]
        state.i_d[here], state.i_q[here], state.torque[here] = (
            given.i_d[at],
            given.i_q[at],
            torque[at],
        )
        state.least[here] = too_much[rows]
        state.reached[here] = False
    none = np.flatnonzero(~found)
    if none.size:
        _least_voltage(problem.take(none), state, index[none], edges)


def _least_voltage(problem: Problem, state: State, index: IndexArray, edges: Intervals) -> None:
    """Where no measured current keeps the voltage limit: the one that comes nearest to it."""
    end_d, end_q = (part.ravel() for part in edges.ends())
    psi_d, psi_q = problem.machine.flux(end_d, end_q)
    omega = problem.omega_e[:, np.newaxis]
    r_s = problem.machine.r_s
    best = np.argmin(
        (r_s * end_d - omega * psi_q) ** 2 + (r_s * end_q + omega * psi_d) ** 2, axis=1
    )
    state.i_d[index], state.i_q[index] = end_d[best], end_q[best]
    state.torque[index], state.reached[index], state.active[index] = 0.0, False, Active.UNREACHABLE


# Boundary of the allowed currents at each speed, on rays from the current of least flux.

# First ray towards positive q currents. Most torque lies there: without a magnet, or with a weak
# one and l_d < l_q, the opposite currents make as much or a little less.
RAYS = 31
ANGLES = np.linspace(-0.5 * np.pi, np.pi, RAYS)
UPPER = int(np.searchsorted(ANGLES, -1e-9))
_RADIAL_STEPS = 12
INSIDE = 1.0 - 1e-6
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Limits:
    """Current and voltage limit of a machine at N speeds, with the centre of the region they leave.

    ``centre_d``, ``centre_q`` in A, ``omega_e`` in rad/s, ``v_max`` in V (phase amplitude), shape
    (N,); ``i_max`` in A (peak).
    """

    machine: Machine
    centre_d: FloatArray
    centre_q: FloatArray
    omega_e: FloatArray
    v_max: FloatArray
    i_max: float

    def take(self, index: IndexArray) -> Limits:
        """Limits at some of the speeds, repeated as the index repeats them."""
        centre_d, centre_q = self.centre_d[index], self.centre_q[index]
        return Limits(
            self.machine, centre_d, centre_q, self.omega_e[index], self.v_max[index], self.i_max
        )

    def point(self, angle: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents in A at ray angles and radii."""
        return self.centre_d + radius * np.cos(angle), self.centre_q + radius * np.sin(angle)

    def voltage_square(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Squared phase voltage in V^2."""
        psi_d, psi_q = self.machine.flux(i_d, i_q)
        v_d = self.machine.r_s * i_d - self.omega_e * psi_q
        v_q = self.machine.r_s * i_q + self.omega_e * psi_d
        return v_d * v_d + v_q * v_q

    def circle_radius(self, angle: FloatArray) -> FloatArray:
        """Distance in A from the centre to the current circle along ray angles."""
        along = self.centre_d * np.cos(angle) + self.centre_q * np.sin(angle)
        square = along * along + self.i_max**2 - self.centre_d**2 - self.centre_q**2
        return -along + np.sqrt(np.maximum(square, 0.0))


def ray_angles() -> FloatArray:
    """Angles of the scanned rays in rad, from -pi/2 to pi, shape (K,)."""
    return ANGLES.copy()


def least_flux_current(machine: Machine, i_max: float) -> float:
    """Current on the d axis in A where the flux linkage vanishes, or the end of the limit
    that comes nearest to it.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
    """
    grid = np.linspace(-i_max, i_max, 2001)
    psi_d, _ = machine.flux(grid, np.zeros_like(grid))
    current = float(grid[np.argmin(np.abs(psi_d))])
    point, zero = np.array([current]), np.zeros(1)
    for _ in range(6):
        jet = machine.jet(point, zero)
        point = np.clip(point - jet.psi_d / jet.l_dd, -i_max, i_max)
    # Strictly inside the circle, so that rays to every side have a length.
    return float(np.clip(point[0], -INSIDE * i_max, INSIDE * i_max))


def make_limits(machine: Machine, omega_e: FloatArray, v_max: FloatArray, i_max: float) -> Limits:
    """Limits with their centre: the current of least flux, or the short-circuit current
    where that one needs too much.

    The two differ by the resistance; the second matters near the end of the speed range only.

    Args:
        machine: Any machine.
        omega_e: Electrical speeds in rad/s, shape (N,).
        v_max: Largest phase-voltage amplitudes in V (peak), shape (N,).
        i_max: Current limit in A (peak).
    """
    least = least_flux_current(machine, i_max)
    limits = Limits(
        machine, np.full_like(omega_e, least), np.zeros_like(omega_e), omega_e, v_max, i_max
    )
    broken = np.flatnonzero(limits.voltage_square(limits.centre_d, limits.centre_q) >= v_max**2)
    if broken.size:
        limits.centre_d[broken], limits.centre_q[broken] = _short_circuit(limits.take(broken))
    return limits


def _short_circuit(limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Currents of zero voltage, pulled back onto the current circle where they are larger,
    shape (N,).
    """
    machine, omega_e = limits.machine, limits.omega_e
    d, q, zero = limits.centre_d, limits.centre_q, np.zeros_like(omega_e)
    for _ in range(12):
        jet = machine.jet(d, q)
        v_d, v_q = machine.r_s * d - omega_e * jet.psi_q, machine.r_s * q + omega_e * jet.psi_d
        first = Terms(v_d, machine.r_s - omega_e * jet.l_qd, -omega_e * jet.l_qq, zero, zero, zero)
        second = Terms(v_q, omega_e * jet.l_dd, machine.r_s + omega_e * jet.l_dq, zero, zero, zero)
        step_d, step_q = newton_step(first, second, 0.0, 0.0)
        d, q = d + np.nan_to_num(step_d), q + np.nan_to_num(step_q)
        excess = np.maximum(np.hypot(d, q) / (INSIDE * limits.i_max), 1.0)
        d, q = d / excess, q / excess
    return d, q


def voltage_radius(
    limits: Limits, angle: FloatArray, radius: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Shorten rays until they end on the voltage limit; angles in rad and radii in A of shape (N,).

    Newton's method from outside: the squared voltage grows convexly along a ray of a linear
    machine, so that the steps approach from one side; a bracket keeps the steps of saturated
    machines safe. Returns the radius and whether the voltage limit was met.

    Args:
        limits: Limits with their centre.
        angle: Angles of the rays in rad, shape (N,).
        radius: Where the rays end at most, in A, shape (N,).
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    low, high, found = np.zeros_like(radius), radius.copy(), radius.copy()
    outside = limits.voltage_square(*limits.point(angle, radius)) > limits.v_max**2
    live = np.flatnonzero(outside)
    for _ in range(_RADIAL_STEPS):
        if live.size == 0:
            break
        here = limits.take(live)
        r = found[live]
        i_d, i_q = here.point(angle[live], r)
        terms = voltage_terms(limits.machine, limits.machine.jet(i_d, i_q), i_d, i_q, here.omega_e)
        gap = terms.value - here.v_max**2
        high[live] = np.where(gap > 0.0, r, high[live])
        low[live] = np.where(gap <= 0.0, r, low[live])
        with np.errstate(divide="ignore", invalid="ignore"):
            step = r - gap / (terms.d * cosine[live] + terms.q * sine[live])
        safe = (step >= low[live]) & (step <= high[live])
        found[live] = np.where(safe, step, 0.5 * (low[live] + high[live]))
        live = live[np.abs(gap) > 1e-5 * here.v_max**2]
    return found, outside


def boundary(limits: Limits, angle: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Radius in A, torque in N m and whether the voltage limit binds, on rays of shape (N,).

    Args:
        limits: Limits with their centre.
        angle: Angles of the rays in rad, shape (N,).
    """
    radius, at_voltage = voltage_radius(limits, angle, limits.circle_radius(angle))
    return radius, torque_at(limits.machine, *limits.point(angle, radius)), at_voltage


def torque_at(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Torque in N m of a machine at currents ``i_d`` and ``i_q`` in A, any one shape."""
    return torque_from_flux(machine.pole_pairs, *machine.flux(i_d, i_q), i_d, i_q)
