"""The MTPA locus of any machine as a table over current: starts of the batched solver,
and a characteristic.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import (
    CurrentRegion,
    FluxJet,
    LinearMachine,
    Machine,
    torque_from_flux,
)
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.losses.loss_map import LossMap

_LEVELS = 160
_ANGLES = 121
_POLISHING_STEPS = 6

# Share of an edge by which a crossing may lie beyond its corner: rounding must not let it slip
# through.
_CORNER = 1e-9


@dataclass(frozen=True, slots=True)
class MtpaLocus:
    """Points of most torque for their current, ascending in current, arrays of shape (L,): A, A,
    A and N m.

    ``held`` marks those on the edge of a flux map's data, beyond which more torque may lie.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    held: NDArray[np.bool_]

    def start(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents near the locus for torque >= 0 in N m, shape (N,).

        Beyond the table its last point.
        """
        first = float(self.torque[0])
        # Below the first level the current follows a power of the torque: 1 with a magnet,
        # 1/2 without.
        power = np.log(self.current[1] / self.current[0]) / np.log(self.torque[1] / first)
        share = np.minimum(torque / first, 1.0) ** power
        return np.interp(torque, self.torque, self.i_d) * share, np.interp(
            torque, self.torque, self.i_q
        ) * share


def _scan(machine: Machine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best of an even grid of current angles per level, shape (L,) each."""
    angle = np.linspace(0.0, np.pi, _ANGLES)
    i_d = current[:, np.newaxis] * np.cos(angle)
    i_q = current[:, np.newaxis] * np.sin(angle)
    torque = torque_from_flux(
        machine.pole_pairs, *machine.flux(i_d.ravel(), i_q.ravel()), i_d.ravel(), i_q.ravel()
    )
    best = np.argmax(torque.reshape(i_d.shape), axis=1)
    rows = np.arange(current.size)
    return i_d[rows, best], i_q[rows, best]


def free_locus(machine: Machine, i_max: float) -> MtpaLocus:
    """Table of the MTPA locus up to ``i_max`` A (peak), wherever the data of a flux map end.

    Closed form for constant inductances; otherwise a scan of all angles per level, then Newton's
    method on |i|^2 = I^2 and parallel gradients of torque and |i|^2.

    Raises:
        InputError: The machine makes no torque with positive q current.
    """
    current = i_max * np.linspace(1.0 / _LEVELS, 1.0, _LEVELS) ** 1.5
    if isinstance(machine, LinearMachine):
        i_d, i_q = mtpa_at_current(machine, current)
    else:
        i_d, i_q = _scan(machine, current)
        for _ in range(_POLISHING_STEPS):
            jet = machine.jet(i_d, i_q)
            circle = current_terms(i_d, i_q)
            stationary = cross_of_gradients(torque_terms(machine, jet, i_d, i_q), circle)
            step_d, step_q = newton_step(circle, stationary, current**2, 0.0)
            size = np.hypot(step_d, step_q)
            damping = np.minimum(1.0, 0.1 * current / np.maximum(size, 1e-300))
            i_d, i_q = i_d + damping * step_d, i_q + damping * step_q
    torque = torque_from_flux(machine.pole_pairs, *machine.flux(i_d, i_q), i_d, i_q)
    if not (torque[0] > 0.0 and np.all(np.diff(torque) > 0.0)):
        raise InputError(
            "the machine's torque does not rise with the current along its MTPA locus; check the "
            "flux data"
        )
    return MtpaLocus(current, i_d, i_q, torque, np.zeros(torque.size, dtype=np.bool_))


def mtpa_locus(machine: Machine, i_max: float) -> MtpaLocus:
    """Table of the MTPA locus up to ``i_max`` A (peak), or up to the most torque that
    the data of a flux map hold.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).

    Raises:
        InputError: As `free_locus`.
    """
    free, region = free_locus(machine, i_max), region_that_holds(machine, i_max)
    if region is None or bool(np.all(region.contains(free.i_d, free.i_q))):
        return free
    return _held_locus(machine, region, free)


def _held_locus(machine: Machine, region: CurrentRegion, free: MtpaLocus) -> MtpaLocus:
    """The locus with what lies beyond a region on its edge instead."""
    if not region.contains(free.i_d[-1:], free.i_q[-1:])[0]:
        end_d, end_q = (
            part.ravel() for part in intervals_of(machine, region, float(free.current[-1])).ends()
        )
        best = int(np.argmax(machine.torque(end_d, end_q)))
        end = np.array([end_d[best]]), np.array([end_q[best]])
        free = free_locus(machine, float(np.hypot(*end)[0]))
    else:
        end = free.i_d[-1:], free.i_q[-1:]
    held = ~region.contains(free.i_d, free.i_q)
    i_d, i_q = free.i_d.copy(), free.i_q.copy()
    i_d[held], i_q[held] = _best_on_circles(machine, region, free.current[held])
    i_d[-1:], i_q[-1:] = end
    torque = machine.torque(i_d, i_q)
    # Where less current makes as much torque, more current is no point of the locus.
    kept = torque > np.maximum.accumulate(np.append(0.0, torque[:-1]))
    return MtpaLocus(free.current[kept], i_d[kept], i_q[kept], torque[kept], held[kept])


def _best_on_circles(
    machine: Machine, region: CurrentRegion, current: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Most torque among the currents of a magnitude in A that lie on the edge of a region,
    shape (L,) each.
    """
    d, q = region.corner_d[:, np.newaxis, np.newaxis], region.corner_q[:, np.newaxis, np.newaxis]
    step_d, step_q = np.roll(d, -1, axis=0) - d, np.roll(q, -1, axis=0) - q
    square, half = step_d**2 + step_q**2, d * step_d + q * step_q
    under = half**2 - square * (d**2 + q**2 - current[:, np.newaxis] ** 2)
    share = (-half + np.array([-1.0, 1.0]) * np.sqrt(np.maximum(under, 0.0))) / square  # (K, L, 2)
    on_edge = (under >= 0.0) & (share >= -_CORNER) & (share <= 1.0 + _CORNER)
    i_d, i_q = d + share * step_d, q + share * step_q
    torque = np.where(on_edge, machine.torque(i_d, i_q), -np.inf)
    flat = np.moveaxis(torque, 1, 0).reshape(current.size, -1)
    best, rows = np.argmax(flat, axis=1), np.arange(current.size)
    found_d, found_q = (
        np.moveaxis(part, 1, 0).reshape(current.size, -1)[rows, best] for part in (i_d, i_q)
    )
    return found_d, found_q


# Currents for a torque at least copper loss (MTPA) and at i_d = 0, exactly,
# for machines with constant inductances.
#
# In per unit of i_base = psi_pm / (2 |l_q - l_d|) and T_base = 3/4 p psi_pm i_base the optimum of
# every salient machine is one curve, T = i_q (1 + sqrt(1 + i_q^2)) with |i_d| = sqrt(1 + i_q^2) - 1
# (paper 000, (5) to (19)). Its inverse has a closed form; nothing here iterates towards a
# tolerance.


@dataclass(frozen=True, slots=True)
class PerUnitBase:
    """Base current in A (peak) and base torque in N m of the MTPA curve (paper 000, (5))."""

    current: float
    torque: float


def per_unit_base(machine: LinearMachine) -> PerUnitBase:
    """Bases of the normalised MTPA curve.

    Raises:
        InputError: The machine has no saliency or no magnet, so that the curve has no scale of its
            own.
    """
    if machine.saliency == 0.0 or machine.psi_pm == 0.0:
        raise InputError(
            "per-unit MTPA needs a magnet and l_d different from l_q; this machine's curve is a "
            "straight line"
        )
    current = machine.psi_pm / (2.0 * abs(machine.saliency))
    return PerUnitBase(current=current, torque=0.75 * machine.pole_pairs * machine.psi_pm * current)


def mtpa_per_unit(torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """MTPA currents (i_d <= 0, i_q) in per unit for torque in per unit of any sign, shape (N,).

    The quartic i_d (2 - i_d)^3 + T^2 = 0 is solved by its resolvent cubic in hyperbolic form; two
    Newton steps on T = i_q (1 + sqrt(1 + i_q^2)), which is convex, then remove the rounding of that
    expression.
    """
    magnitude = np.abs(np.asarray(torque, dtype=np.float64))
    # Far below 1e-100 the curve is its tangent i_q = T/2 to every digit,
    # and the quotient below would overflow.
    safe = np.maximum(magnitude, 1e-100)
    root = -(4.0 * safe / np.sqrt(3.0)) * np.sinh(
        np.arcsinh(3.0 * np.sqrt(3.0) / (4.0 * safe)) / 3.0
    )
    half_sum = 1.0 + np.sqrt(np.maximum(1.0 + root, 0.0))
    divisor = 0.5 * (
        half_sum + np.sqrt(half_sum**2 - 2.0 * root + 4.0 * np.sqrt(0.25 * root**2 + magnitude**2))
    )
    i_q = magnitude / divisor
    for _ in range(2):
        flux = np.sqrt(1.0 + i_q * i_q)
        i_q = i_q - (i_q * (1.0 + flux) - magnitude) / (1.0 + flux + i_q * i_q / flux)
    return -(i_q * i_q) / (1.0 + np.sqrt(1.0 + i_q * i_q)), np.copysign(i_q, torque)


def _reluctance_currents(
    machine: LinearMachine, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """MTPA currents without a magnet: |i_d| = |i_q|, i_d with the sign that
    makes positive i_q drive.
    """
    current = np.sqrt(np.abs(torque) / (1.5 * machine.pole_pairs * abs(machine.saliency)))
    return -np.sign(machine.saliency) * current, np.copysign(current, torque)


def mtpa_currents(machine: LinearMachine, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents (i_d, i_q) in A with least copper loss for torque in N m, shape (N,),
    without a current limit.

    Holds for l_q > l_d (i_d < 0), l_d > l_q (i_d > 0), surface machines (i_d = 0) and
    machines without a magnet.

    Raises:
        InputError: The machine has neither magnet nor saliency.
    """
    torque = np.asarray(torque, dtype=np.float64)
    if machine.psi_pm == 0.0:
        if machine.saliency == 0.0:
            raise InputError("the machine has neither magnet flux nor saliency: it makes no torque")
        return _reluctance_currents(machine, torque)
    if machine.saliency == 0.0:
        return np.zeros_like(torque), torque / machine.torque_per_ampere
    base = per_unit_base(machine)
    i_d, i_q = mtpa_per_unit(torque / base.torque)
    return np.sign(machine.saliency) * base.current * i_d, base.current * i_q


def id0_currents(machine: LinearMachine, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents with i_d = 0 for torque in N m, shape (N,): i_q = 2 T / (3 p psi_pm) (paper 000 (4),
    corrected).

    Raises:
        InputError: The machine has no magnet.
    """
    if machine.psi_pm == 0.0:
        raise InputError(
            "strategy id0 needs magnet flux; without it no torque is made at i_d = 0: use strategy "
            "mtpa"
        )
    torque = np.asarray(torque, dtype=np.float64)
    return np.zeros_like(torque), torque / machine.torque_per_ampere


def mtpa_at_current(machine: LinearMachine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Point (i_d, i_q >= 0) in A of the MTPA curve with the given current magnitude in A (peak),
    shape (N,).

    i_d = psi/(4 dl) - sqrt((psi/(4 dl))^2 + I^2/2) with dl = l_q - l_d,
    written without cancellation.

    Args:
        machine: Any machine.
        current: Magnitudes in A (peak), shape (N,).
    """
    current = np.asarray(current, dtype=np.float64)
    if machine.saliency == 0.0:
        return np.zeros_like(current), current
    quarter = machine.psi_pm / (4.0 * abs(machine.saliency))
    half_square = 0.5 * current**2
    denominator = quarter + np.sqrt(quarter**2 + half_square)
    with np.errstate(invalid="ignore"):
        i_d = np.where(current > 0.0, -half_square / denominator, 0.0)
    return np.sign(machine.saliency) * i_d, np.sqrt(np.maximum(current**2 - i_d**2, 0.0))


# What the batched solver works on: one chunk of points, its solution as it grows,
# and the names of the limits.

IndexArray = NDArray[np.intp]


BoolArray = NDArray[np.bool_]


class Active(IntEnum):
    """What holds a point where it is; ``DATA`` that the flux map ends there."""

    NONE = 0
    VOLTAGE = 1
    CURRENT = 2
    BOTH = 3
    MTPV = 4
    UNREACHABLE = 5
    DATA = 6

    @property
    def label(self) -> str:
        """Name for tables: none, voltage, current, both, MTPV, unreachable, data."""
        return "MTPV" if self is Active.MTPV else self.name.lower()


@dataclass(frozen=True, slots=True)
class LossCoefficients:
    """Loss in W as a function of currents and flux linkage at each point's speed,
    arrays of shape (N,) or scalars.

    P = square |i|^2 + linear |i| + iron |psi|^2 + mapped(i, omega_e), with ``square`` in W/A^2
    (copper, with its AC factor, and what of the inverter is proportional to the squared current),
    ``linear`` in W/A (switching, thresholds), ``iron`` in W/Wb^2, and with a loss map that map at
    the electrical speed ``omega_e`` in rad/s.
    """

    square: FloatArray
    linear: FloatArray
    iron: FloatArray
    omega_e: FloatArray | float = 0.0
    mapped: LossMap | None = None

    def spread(self, shape: tuple[int, ...]) -> LossCoefficients:
        """Coefficients of points of a shape, one by one, shape (N,)."""
        square, linear, iron, speed = (
            np.broadcast_to(values, shape).ravel()
            for values in (self.square, self.linear, self.iron, self.omega_e)
        )
        # Only a map has a speed of each point.
        return LossCoefficients(
            square, linear, iron, 0.0 if self.mapped is None else speed, self.mapped
        )

    def take(self, index: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> LossCoefficients:
        """Coefficients of some points of those that `spread` gives."""
        square, linear, iron = self.square[index], self.linear[index], self.iron[index]
        speed = self.omega_e if self.mapped is None else np.asarray(self.omega_e)[index]
        return LossCoefficients(square, linear, iron, speed, self.mapped)


@dataclass(frozen=True, slots=True)
class Problem:
    """One chunk with torque counted positive (the q axis mirrored where it was negative),
    arrays of shape (N,).

    ``region`` is where the data of the machine are, None where they limit nothing.
    """

    machine: Machine
    locus: MtpaLocus
    torque: FloatArray
    omega_e: FloatArray
    v_max: FloatArray
    i_max: float
    loss: LossCoefficients
    region: CurrentRegion | None = None

    @property
    def soft(self) -> float:
        """Current in A over which the tip of |i| is rounded."""
        return 1e-6 * self.i_max

    def take(self, index: IndexArray) -> Problem:
        """Some of the points."""
        return Problem(
            self.machine,
            self.locus,
            self.torque[index],
            self.omega_e[index],
            self.v_max[index],
            self.i_max,
            self.loss.take(index),
            self.region,
        )


@dataclass(slots=True)
class State:
    """Solution of a chunk as it grows, arrays of shape (N,)."""

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    least: BoolArray


# Torque, squared voltage and loss at trial currents, with gradients and second derivatives, for
# many points at once.
#
# The batched solver works on these three functions alone; linear machines and flux maps differ
# only in their `FluxJet`.


@dataclass(frozen=True, slots=True)
class Terms:
    """A function of (i_d, i_q) with its derivatives, arrays of shape (N,)."""

    value: FloatArray
    d: FloatArray
    q: FloatArray
    dd: FloatArray
    dq: FloatArray
    qq: FloatArray


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
    terms = Terms(
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
    if coefficients.mapped is None:
        return terms
    more = coefficients.mapped.jet(i_d, i_q, np.asarray(coefficients.omega_e))
    return Terms(*(getattr(terms, name) + getattr(more, name) for name in more._fields))


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
