"""Torque, squared voltage and loss at trial currents, with gradients and second derivatives,
for many points at once.

The batched solver works on these three functions alone; linear machines and flux maps
differ only in their `FluxJet`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import CurrentRegion, FluxJet, Machine
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Terms:
    """A function of (i_d, i_q) with its derivatives, arrays of shape (N,)."""

    value: FloatArray
    d: FloatArray
    q: FloatArray
    dd: FloatArray
    dq: FloatArray
    qq: FloatArray


@dataclass(frozen=True, slots=True)
class LossCoefficients:
    """Loss in W as a function of currents and flux linkage at each point's speed,
    arrays of shape (N,) or scalars.

    P = square |i|^2 + linear |i| + iron |psi|^2, with ``square`` in W/A^2 (copper, with its AC
    factor, and what of the inverter is proportional to the squared current), ``linear`` in W/A
    (switching, thresholds) and ``iron`` in W/Wb^2.
    """

    square: FloatArray
    linear: FloatArray
    iron: FloatArray

    def take(self, index: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> LossCoefficients:
        """Coefficients of some points."""
        return LossCoefficients(self.square[index], self.linear[index], self.iron[index])


def torque_terms(machine: Machine, jet: FluxJet, i_d: FloatArray, i_q: FloatArray) -> Terms:
    """Torque in N m, T = 3/2 p (psi_d i_q - psi_q i_d).

    Args:
        machine: Any machine.
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    k = 1.5 * machine.pole_pairs
    return Terms(
        value=k * (jet.psi_d * i_q - jet.psi_q * i_d),
        d=k * (jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q),
        q=k * (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d),
        dd=k * (jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd),
        dq=k * (jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq),
        qq=k * (2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d),
    )


def voltage_terms(
    machine: Machine, jet: FluxJet, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray
) -> Terms:
    """Squared steady-state phase voltage in V^2, the resistance drop included.

    Args:
        machine: Any machine.
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
        omega_e: Electrical speeds in rad/s, shape (N,).
    """
    r_s = machine.r_s
    v_d, v_q = r_s * i_d - omega_e * jet.psi_q, r_s * i_q + omega_e * jet.psi_d
    d_d, d_q = r_s - omega_e * jet.l_qd, -omega_e * jet.l_qq
    q_d, q_q = omega_e * jet.l_dd, r_s + omega_e * jet.l_dq
    return Terms(
        value=v_d * v_d + v_q * v_q,
        d=2.0 * (v_d * d_d + v_q * q_d),
        q=2.0 * (v_d * d_q + v_q * q_q),
        dd=2.0 * (d_d * d_d + q_d * q_d + omega_e * (v_q * jet.d_dd - v_d * jet.q_dd)),
        dq=2.0 * (d_d * d_q + q_d * q_q + omega_e * (v_q * jet.d_dq - v_d * jet.q_dq)),
        qq=2.0 * (d_q * d_q + q_q * q_q + omega_e * (v_q * jet.d_qq - v_d * jet.q_qq)),
    )


def loss_terms(
    coefficients: LossCoefficients, jet: FluxJet, i_d: FloatArray, i_q: FloatArray, soft: float
) -> Terms:
    """Loss in W.

    ``soft`` in A rounds the tip of |i| at zero current, where it has no derivative.

    Args:
        coefficients: Of currents and flux linkages, at the speeds of the points, shape (N,).
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
        soft: Rounding of the tip in A.
    """
    square, linear, iron = coefficients.square, coefficients.linear, coefficients.iron
    magnitude = np.sqrt(i_d * i_d + i_q * i_q + soft * soft)
    slope = linear / magnitude
    bend = slope / (magnitude * magnitude)
    psi_d, psi_q = jet.psi_d, jet.psi_q
    return Terms(
        value=square * (i_d * i_d + i_q * i_q)
        + linear * (magnitude - soft)
        + iron * (psi_d * psi_d + psi_q * psi_q),
        d=(2.0 * square + slope) * i_d + 2.0 * iron * (psi_d * jet.l_dd + psi_q * jet.l_qd),
        q=(2.0 * square + slope) * i_q + 2.0 * iron * (psi_d * jet.l_dq + psi_q * jet.l_qq),
        dd=2.0 * square
        + slope
        - bend * i_d * i_d
        + 2.0 * iron * (jet.l_dd**2 + jet.l_qd**2 + psi_d * jet.d_dd + psi_q * jet.q_dd),
        dq=-bend * i_d * i_q
        + 2.0
        * iron
        * (jet.l_dd * jet.l_dq + jet.l_qd * jet.l_qq + psi_d * jet.d_dq + psi_q * jet.q_dq),
        qq=2.0 * square
        + slope
        - bend * i_q * i_q
        + 2.0 * iron * (jet.l_dq**2 + jet.l_qq**2 + psi_d * jet.d_qq + psi_q * jet.q_qq),
    )


def current_terms(i_d: FloatArray, i_q: FloatArray) -> Terms:
    """Squared current magnitude in A^2.

    Args:
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    two, zero = np.full_like(i_d, 2.0), np.zeros_like(i_d)
    return Terms(i_d * i_d + i_q * i_q, 2.0 * i_d, 2.0 * i_q, two, zero, two)


def newton_step(
    first: Terms, second: Terms, target_1: FloatArray | float, target_2: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Step (d i_d, d i_q) in A towards first = target_1 and second = target_2, shape (N,).

    The step is nan or inf where the gradients are parallel.
    """
    gap_1: FloatArray = target_1 - first.value
    gap_2: FloatArray = target_2 - second.value
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (gap_1 * second.q - first.q * gap_2) * scale, (
            first.d * gap_2 - gap_1 * second.d
        ) * scale


def cross_of_gradients(first: Terms, second: Terms) -> Terms:
    """Cross product of two gradients, zero where the level curves touch, with its own gradient.

    The second derivatives are not needed and are the gradient again in place of a third-order term.

    Args:
        first, second: Values with first and second derivatives by the currents in A, shape (N,).
    """
    d = first.dd * second.q + first.d * second.dq - first.dq * second.d - first.q * second.dd
    q = first.dq * second.q + first.d * second.qq - first.qq * second.d - first.q * second.dq
    value = first.d * second.q - first.q * second.d
    return Terms(value, d, q, d, q, q)


# The edges of the measured region as short intervals along which torque and voltage are followed.
#
# Where the data of a flux map end before the current limit, an optimum that lies beyond is held on
# an edge. On a straight edge one number is left, so that every such point is the root of one
# function of it, or the end of an interval.

IndexArray = NDArray[np.intp]
_INTERVALS = 240
_FEWEST = 6
_ROOT_STEPS = 60

# Last step in shares of an interval: the convergence is quadratic, so that the root is exact to
# rounding.
_CLOSE = 1e-11

# A function along intervals: places among the roots that are looked for and shares; its value and
# slope there.
Follow = Callable[[IndexArray, FloatArray], tuple[FloatArray, FloatArray]]


def region_that_holds(machine: Machine, i_max: float) -> CurrentRegion | None:
    """Where the data of a machine are, None where they cover its current
    limit in A or may be left.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
    """
    region = machine.region
    return None if region is None or region.covers(min(i_max, machine.i_max)) else region


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals of the edges within the current limit, on each of which the torque rises or falls,
    arrays of J.

    An interval runs from (``d``, ``q``) by (``step_d``, ``step_q``), all in A.
    """

    machine: Machine
    d: FloatArray
    q: FloatArray
    step_d: FloatArray
    step_q: FloatArray

    def point(self, which: IndexArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents in A on some intervals at shares of them from 0 to 1."""
        return self.d[which] + share * self.step_d[which], self.q[which] + share * self.step_q[
            which
        ]

    def ends(self) -> tuple[FloatArray, FloatArray]:
        """Both ends of each interval in A, shape (2, J)."""
        return np.stack([self.d, self.d + self.step_d]), np.stack([self.q, self.q + self.step_q])

    def torque(
        self, which: IndexArray, share: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torque in N m, its derivative by the share, and the second one."""
        i_d, i_q = self.point(which, share)
        terms = torque_terms(self.machine, self.machine.jet(i_d, i_q), i_d, i_q)
        d, q = self.step_d[which], self.step_q[which]
        return (
            terms.value,
            terms.d * d + terms.q * q,
            terms.dd * d * d + 2.0 * terms.dq * d * q + terms.qq * q * q,
        )


def intervals_of(machine: Machine, region: CurrentRegion, i_max: float) -> Intervals:
    """Intervals of a region's edges within a current limit in A, split where the torque turns.

    Args:
        machine: Any machine.
        region: Where the data of its flux map are.
        i_max: Current limit in A (peak).
    """
    parts = []
    ends_d, ends_q = np.roll(region.corner_d, -1), np.roll(region.corner_q, -1)
    around = float(np.sum(np.hypot(ends_d - region.corner_d, ends_q - region.corner_q)))
    for d, q, end_d, end_q in zip(region.corner_d, region.corner_q, ends_d, ends_q, strict=True):
        first, last = _within_circle(d, q, end_d - d, end_q - q, i_max)
        if not last > first:
            continue
        length = float(np.hypot(end_d - d, end_q - q)) * (last - first)
        count = max(_FEWEST, int(np.ceil(_INTERVALS * length / min(around, 8.0 * i_max))))
        share = np.linspace(first, last, count + 1)
        node_d, node_q = d + share * (end_d - d), q + share * (end_q - q)
        parts.append((node_d[:-1], node_q[:-1], np.diff(node_d), np.diff(node_q)))
    columns = (
        [np.concatenate(column) for column in zip(*parts, strict=True)]
        if parts
        else [np.zeros(0)] * 4
    )
    return _split_where_torque_turns(Intervals(machine, *columns))


def _within_circle(
    d: float, q: float, step_d: float, step_q: float, i_max: float
) -> tuple[float, float]:
    """Shares of an edge between which it lies within the current limit.

    The second is not larger where it does not.
    """
    square, half = step_d**2 + step_q**2, d * step_d + q * step_q
    under = half**2 - square * (d**2 + q**2 - i_max**2)
    if under <= 0.0:
        return 0.0, 0.0
    root = np.sqrt(under)
    return max((-half - root) / square, 0.0), min((-half + root) / square, 1.0)


def _split_where_torque_turns(whole: Intervals) -> Intervals:
    every = np.arange(whole.d.size)
    before, after = (whole.torque(every, np.full(every.size, share))[1] for share in (0.0, 1.0))
    turning = np.flatnonzero(before * after < 0.0)
    if turning.size == 0:
        return whole

    def slope(places: IndexArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, first, second = whole.torque(turning[places], share)
        return first, second

    share = bracketed_roots(
        slope, np.zeros(turning.size), np.ones(turning.size), rising=before[turning] < 0.0
    )
    at_d, at_q = whole.point(turning, share)
    kept = np.setdiff1d(every, turning)

    def joined(name: str, first: FloatArray, second: FloatArray) -> FloatArray:
        return np.concatenate([getattr(whole, name)[kept], first, second])

    step_d, step_q = whole.step_d[turning], whole.step_q[turning]
    return Intervals(
        whole.machine,
        joined("d", whole.d[turning], at_d),
        joined("q", whole.q[turning], at_q),
        joined("step_d", share * step_d, (1.0 - share) * step_d),
        joined("step_q", share * step_q, (1.0 - share) * step_q),
    )


def bracketed_roots(
    follow: Follow,
    low: FloatArray,
    high: FloatArray,
    *,
    rising: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> FloatArray:
    """Shares where functions vanish, each between a share below and one above, shape (N,):
    Newton's method, bracketed.

    ``rising`` says that a function is negative at its lower share.

    Args:
        follow: Function values and slopes at shares, shape (N,).
        low, high: Shares on both sides of each root, shape (N,).
        rising: Whether the function is negative at ``low``, shape (N,).
    """
    low, high = low.copy(), high.copy()
    share = 0.5 * (low + high)
    live = np.arange(share.size)
    for _ in range(_ROOT_STEPS):
        if live.size == 0:
            break
        value, slope = follow(live, share[live])
        below = (value < 0.0) == rising[live]
        low[live] = np.where(below, share[live], low[live])
        high[live] = np.where(below, high[live], share[live])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            step = share[live] - value / slope
        safe = (step > low[live]) & (step < high[live])
        found = np.where(
            value == 0.0, share[live], np.where(safe, step, 0.5 * (low[live] + high[live]))
        )
        moved = np.abs(found - share[live])
        share[live] = found
        live = live[moved > _CLOSE]
    return share
