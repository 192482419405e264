"""What current control of a machine with any back-EMF consists of, in double precision.

All quantities are amplitude-invariant; the zero-sequence quantity is the mean of the phases, so
that v_0 = R i_0 + L_0 di_0/dt + omega_e f_0 with L_0 = L_s + 2 M_s (and 3 L_n of a choke in the
neutral). Source: paper 002, chapters 3 to 5, as corrected in docs/methods/current-waveforms.md.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, VOLTAGE_ROWS, uses_zero_sequence, voltage_bounds
from dqforge.machines.transforms import CURRENT_DELAY, clarke_matrix
from dqforge.optimizer.linear_programme import least_cost


@dataclass(frozen=True, slots=True, eq=False)
class PhaseShape:
    """Back-EMF over electrical speed as the firmware has it: nodes joined by straight lines.

    Args:
        flux: In V s/rad (Wb), shape (1, N) for three equal phases, of which b and c lag by a third
            and two thirds of a period, or (3, N). Node j lies at theta_e = 2 pi turns j / N.
        turns: Electrical periods after which the shape repeats: 1, or the pole pairs where they
            differ.
    """

    flux: FloatArray
    turns: int = 1


@dataclass(frozen=True, slots=True)
class AxisGains:
    """PI controller of one axis: ``kp`` in V/A, ``ki`` in V/(A s); both 0 where there is none."""

    kp: float
    ki: float


@dataclass(frozen=True, slots=True)
class HarmonicGains:
    """Integrators that turn with harmonics of the electrical angle.

    Args:
        plane: Orders in alpha and beta, negative where they turn backwards, such as (-5, 7, -11,
            13).
        zero: Orders of the zero sequence, such as (3, 9).
        rate: Rate of learning in 1/s.
        frequency_max: Harmonic frequency in Hz from which on an order is left out; it fades from
            four fifths on.
        error_max: Sum of the magnitudes of the errors of all axes in A above which all of them
            rest.
    """

    plane: tuple[int, ...]
    zero: tuple[int, ...]
    rate: float
    frequency_max: float
    error_max: float


@dataclass(frozen=True, slots=True)
class MidpointGains:
    """What keeps the midpoint of a split link.

    ``balance`` in A/V: zero-sequence current (mean of the phases) per volt off half the link.
    ``omega_e_min`` in rad/s (electrical): below it the zero-sequence current of the table fades to
    nothing, in proportion to the speed.
    """

    balance: float
    omega_e_min: float


@dataclass(frozen=True, slots=True, eq=False)
class TorqueLimit:
    """Largest torque that the voltage permits.

    Between the nodes by straight lines; beyond its ends the last values hold. The speed at which a
    link ends a torque goes with its voltage but for the resistance: with ``v_nominal`` the table is
    read at |omega_e| v_nominal/v_dc, the speed that would load the nominal link as much.

    Args:
        omega_e: Electrical speeds in rad/s, ascending, shape (N,).
        v_dc: Link voltages in V, ascending, shape (M,).
        torque: In N m, of either sign, shape (N, M).
        v_nominal: Link voltage in V at which the speeds are those of the drive; None where they are
            at any.
    """

    omega_e: FloatArray
    v_dc: FloatArray
    torque: FloatArray
    v_nominal: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LimitedShapes:
    """Currents where the link ends those in proportion to the torque, motoring.

    At the speed x = |omega_e| v_nominal/v_dc and a torque T from ``plain`` to ``most`` at that
    speed the references are T u + D, with D between the nodes of speed, of the share s = (T -
    plain)/(most - plain), and of the angle by straight lines; below ``plain`` s is 0, and below the
    first speed D vanishes. D makes no torque. In reverse D is that at -theta, b and c exchanged,
    where ``mirrored``; else there is none.

    Args:
        omega_e: Electrical speeds in rad/s at the nominal link voltage, ascending, shape (W,). At
            the last one there is no torque left, nor beyond.
        plain, most: Torques in N m that proportional currents reach, and that these reach, shape
            (W,).
        deviation: D of the phases in A, shape (1, W, S, N) for equal phases, or (3, W, S, N), on
            the nodes of the table of the back-EMF; s = 0 to 1 in even steps.
        v_nominal: Link voltage in V.
        mirrored: Whether reverse motoring is the mirror of forward motoring.
    """

    omega_e: FloatArray
    plain: FloatArray
    most: FloatArray
    deviation: FloatArray
    v_nominal: float
    mirrored: bool


@dataclass(frozen=True, slots=True, eq=False)
class PhaseControl:
    """Current control of a phase machine.

    Args:
        frame, feedforward, topology: As their words say.
        shape: Back-EMF over the angle.
        pole_pairs, r_s, psi_pm: Of the machine; the flux is that of the fundamental's positive
            sequence in Wb, peak.
        inductances: (L_d, L_q, L_0) in H; L_d = L_q = L_s - M_s without saliency.
        gains: PI controllers of d, q and 0; the last one 0 where nothing drives a zero sequence.
        harmonics: Integrators of harmonics, None for none.
        t_s: Sampling period in s. Voltages act from the next sample on, for one period.
        torque_max: Largest torque in N m that the current limit permits.
        fade: Samples per electrical period (from, to): below the first the shape of the references
            fades to its fundamental, which alone is left below the second.
        torque_limit: Where the voltage ends, None where nothing limits the torque but the current.
        midpoint: For a split link, else None.
        limited: Currents beyond the torque limit, None where the torque is reduced instead.
    """

    frame: CurrentFrame
    feedforward: Feedforward
    topology: Topology
    shape: PhaseShape
    pole_pairs: int
    r_s: float
    psi_pm: float
    inductances: tuple[float, float, float]
    gains: tuple[AxisGains, AxisGains, AxisGains]
    harmonics: HarmonicGains | None
    t_s: float
    torque_max: float
    fade: tuple[float, float] = (20.0, 16.0)
    torque_limit: TorqueLimit | None = None
    midpoint: MidpointGains | None = None
    limited: LimitedShapes | None = None


# Where the voltage of the link ends the torque.
#
# In the steady state the control law makes, at the sample k, the phase voltages
#
#     v = R (i_1 + i_2)/2 + L (i_2 - i_1)/T_s + omega_e f(theta + 1.5 omega_e T_s),
#     i_j = T u(theta + j omega_e T_s)
#
# which are straight in the torque T at every angle. Each inequality of the topology's region then
# permits an interval of torques, and the largest torque is the least of their ends over all angles.

MARGIN = 0.02  # Share of the region that is left to the PI controllers.

# Nodes of the table over the nominal link voltage. At 0 there is no torque, so that the table holds
# down to any voltage; above the nominal one it holds too, but for the resistance there would be no
# difference.
LINKS = (0.0, 0.3, 0.6, 0.8, 1.0)
SPEEDS = 17  # Nodes of the table over the speed.
_FINE = (4, 9)
_ANGLES = 192
_SAFE = 1e-3
_SCAN = 241
_TIE = 1e-9


def steady_voltages(control: PhaseControl, omega_e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Phase voltages of the control law in the steady state: per torque in V/(N m), and at none
    in V, both of shape (W, A, 3), at the angles of `voltage_angles`.

    Without a neutral the mean of the phases is left out, which the legs do not make.

    Args:
        control: The control; its references are in proportion to the torque.
        omega_e: Electrical speeds in rad/s, shape (W,).
    """
    angle = voltage_angles(control, omega_e)
    omega = omega_e[:, np.newaxis]
    step = omega * control.t_s
    l_d, l_q, l_0 = control.inductances
    inductance = np.array([0.5 * (l_d + l_q), 0.5 * (l_d + l_q), l_0])[:, np.newaxis, np.newaxis]
    first, second = (reference_currents(control, angle + j * step, omega) for j in (1.0, 2.0))
    by_torque = 0.5 * control.r_s * (first + second) + inductance / control.t_s * (second - first)
    emf = omega * flux_at(control.shape, angle + CURRENT_DELAY * step)
    if not TOPOLOGIES[control.topology].neutral:
        by_torque[2], emf[2] = 0.0, 0.0
    by_torque, emf = (np.moveaxis(np.tensordot(PHASES, v, 1), 0, -1) for v in (by_torque, emf))
    return by_torque, emf


def largest_torques(
    control: PhaseControl, omega_e: FloatArray, v_dc: float, margin: float
) -> FloatArray:
    """Largest torque in N m of either sign that the link permits at either sense of rotation,
    shape (W,), at most that of the current limit.

    Args:
        control: The control.
        omega_e: Electrical speeds in rad/s, shape (W,), zero or positive.
        v_dc: Link voltage in V.
        margin: Share of the region that is left free, of 0 to 1.
    """
    if v_dc <= 0.0:
        return np.zeros_like(omega_e)
    count = voltage_angles(control, omega_e[:1]).size
    low, high, rows = link_region(control, v_dc, margin)
    low, high = np.tile(low, count), np.tile(high, count)
    found = np.full(omega_e.size, control.torque_max)
    for sense in (1.0,) if is_odd(control) else (1.0, -1.0):
        slope, start = (
            (v @ rows.T).reshape(omega_e.size, -1)
            for v in steady_voltages(control, sense * omega_e)
        )
        found = np.minimum(found, _end(slope, start, high))
        found = np.minimum(found, _end(-slope, -start, -low))
    return np.asarray(np.maximum(found, 0.0))


def link_region(
    control: PhaseControl, v_dc: float, margin: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds in V, shape (r,), and rows on the phase voltages, shape (r, 3), that limit at all."""
    low, high = voltage_bounds(control.topology, (1.0 - margin) * v_dc)
    limited = np.isfinite(high)
    return low[limited], high[limited], VOLTAGE_ROWS[limited]


def is_odd(control: PhaseControl) -> bool:
    """Whether both senses of rotation are alike: equal phases whose back-EMF is odd about the
    magnets' axis.
    """
    flux = control.shape.flux
    mirrored = np.roll(flux[:, ::-1], 1, axis=1)
    scale = 1e-6 * float(np.max(np.abs(flux)))
    return flux.shape[0] == 1 and bool(np.max(np.abs(flux + mirrored)) <= scale)


def voltage_angles(control: PhaseControl, omega_e: FloatArray) -> FloatArray:
    """Angles at which the voltages are looked at in rad, shape (W, A).

    The corners of the voltages are among them: where one of the three angles that they depend on
    is a node of the table. A third of a period tells all of equal phases.

    Args:
        control: The control.
        omega_e: Electrical speeds in rad/s, shape (W,).
    """
    rows, nodes = control.shape.flux.shape
    count = nodes * max(1, _ANGLES * control.shape.turns // nodes)
    part = count // 3 if rows == 1 and control.shape.turns == 1 else count
    even = 2.0 * np.pi * control.shape.turns / count * np.arange(part)
    ahead = np.array([1.0, 1.5, 2.0])[:, np.newaxis] * control.t_s
    moved = even - ahead * omega_e[:, np.newaxis, np.newaxis]
    return np.asarray(moved.reshape(omega_e.size, -1))


def _end(slope: FloatArray, start: FloatArray, bound: FloatArray) -> FloatArray:
    """Largest |T| with slope T + start <= bound for T and -T in every column, shape (W,)."""
    room = bound - start
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        torque = np.where(room >= 0.0, room / np.abs(slope), 0.0)
    return np.asarray(np.min(np.where(np.isnan(torque), np.inf, torque), axis=1))


# Largest torques in N m, shape (W,), at electrical speeds in rad/s and a link voltage in V.
Largest = Callable[[FloatArray, float], FloatArray]


def torque_limit(v_dc: float, last: float, largest: Largest) -> TorqueLimit:
    """Table of the largest torque whose straight lines promise no more than there is.

    Args:
        v_dc: Nominal link voltage in V.
        last: Electrical speed in rad/s at which no torque is left there, as `no_load_speed` finds
            it.
        largest: The torques, such as `largest_torques` with its control and margin.
    """
    links = v_dc * np.array(LINKS)
    speeds = _speeds(links, last, largest)
    fine_speeds, fine_links = _refined(speeds, _FINE[0]), _refined(links, _FINE[1])
    truth = _by_link(fine_speeds, fine_links, largest)
    truth *= np.where(truth < np.max(truth), 1.0 - _SAFE, 1.0)
    truth[-1] = 0.0
    nodes = _lower_nodes(speeds, links, fine_speeds, fine_links, truth)
    return TorqueLimit(speeds, links, nodes, v_dc)


def _by_link(omega_e: FloatArray, v_dc: FloatArray, largest: Largest) -> FloatArray:
    """Largest torques in N m where each link is loaded as the last one is at the speeds, shape
    (N, M).
    """
    columns = [largest(omega_e * (link / v_dc[-1]), float(link)) for link in v_dc]
    return np.stack(columns, axis=1)


def no_load_speed(control: PhaseControl, v_dc: float, margin: float) -> float:
    """Electrical speed in rad/s at which the back-EMF alone fills the region.

    Args:
        control: The control.
        v_dc: Link voltage in V.
        margin: Share of the region that is left free, of 0 to 1.
    """
    _, per_speed = steady_voltages(control, np.ones(1))
    low, high, rows = link_region(control, v_dc, margin)
    found = per_speed[0] @ rows.T
    return 1.0 / float(np.max(np.maximum(found / high, found / low)))


def limit_at(limit: TorqueLimit, omega_e: FloatArray, v_dc: FloatArray) -> FloatArray:
    """Largest torque in N m that the table promises, shapes broadcast together.

    Beyond its ends the table keeps its last values.

    Args:
        limit: The table.
        omega_e: Electrical speeds in rad/s, either sense.
        v_dc: Link voltages in V.
    """
    load = np.abs(omega_e)
    if limit.v_nominal is not None:
        load = load * limit.v_nominal / np.maximum(v_dc, 1e-9 * limit.v_nominal)
    rows, above = node_place(limit.omega_e, load)
    columns, beside = node_place(limit.v_dc, v_dc)
    corner = limit.torque
    left = corner[rows, columns] + beside * (corner[rows, columns + 1] - corner[rows, columns])
    after = corner[rows + 1, columns]
    right = after + beside * (corner[rows + 1, columns + 1] - after)
    return np.asarray(left + above * (right - left))


def node_place(nodes: FloatArray, value: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Interval of each value and its place in it, 0 to 1."""
    inside = np.clip(value, nodes[0], nodes[-1])
    left = np.clip(np.searchsorted(nodes, inside, side="right") - 1, 0, nodes.size - 2)
    return left, np.asarray((inside - nodes[left]) / (nodes[left + 1] - nodes[left]))


def _refined(nodes: FloatArray, parts: int) -> FloatArray:
    """Nodes with ``parts`` - 1 values evenly between each two."""
    share = np.arange(parts) / parts
    between = nodes[:-1, np.newaxis] + share * np.diff(nodes)[:, np.newaxis]
    return np.append(between.ravel(), nodes[-1])


def _speeds(links: FloatArray, last: float, largest: Largest) -> FloatArray:
    """Nodes over the speed: where straight lines are furthest off, one after another."""
    scan = np.linspace(0.0, last, _SCAN)
    torques = _by_link(scan, links, largest)[:, 1:]
    chosen = [0, scan.size - 1]
    while len(chosen) < SPEEDS:
        lines = [np.interp(scan, scan[chosen], column[chosen]) for column in torques.T]
        off = np.max(np.abs(torques - np.stack(lines, axis=1)), axis=1)
        # Steps of a ladder are off by the same: the first of them, whatever rounding makes of it.
        first = int(np.argmax(off >= (1.0 - _TIE) * np.max(off)))
        chosen = sorted({*chosen, first})
    return np.asarray(scan[chosen])


def _lower_nodes(
    speeds: FloatArray,
    links: FloatArray,
    fine_speeds: FloatArray,
    fine_links: FloatArray,
    truth: FloatArray,
) -> FloatArray:
    """Node values, shape (N, M), whose bilinear surface lies below the truth at all fine points and
    as high as it can: a linear programme.
    """
    from scipy.sparse import csr_matrix, kron

    by_speed, by_link = (
        csr_matrix(_hats(nodes, fine))
        for nodes, fine in ((speeds, fine_speeds), (links, fine_links))
    )
    surface = kron(by_speed, by_link).tocsr()
    found = least_cost(
        -np.asarray(surface.sum(axis=0)).ravel(), surface, truth.ravel(), bounds=(0.0, np.inf)
    )
    if found is None:  # a torque limit below zero at some point
        raise NoSolutionError("control: no torque is reachable at some speed and link voltage")
    return np.asarray(np.maximum(found.reshape(speeds.size, links.size), 0.0) + 0.0)


def _hats(nodes: FloatArray, fine: FloatArray) -> FloatArray:
    """Weights of the nodes at each value between them, shape (fine, nodes)."""
    return np.stack([np.interp(fine, nodes, unit) for unit in np.eye(nodes.size)], axis=1)


# The back-EMF of a table over the angle, and the currents that follow from it, in alpha-beta-0.
#
# Everything is amplitude-invariant, 0 is the mean of the phases. For 1 N m with least copper loss
#
#     u = f / (p (3/2 |f_alphabeta|^2 + 3 f_0^2)),      f_0 = 0 where no zero sequence is used

_TURN = 2.0 * np.pi / 3.0
PHASES = np.linalg.inv(clarke_matrix())  # Matrix (3, 3) from alpha, beta and 0 to the phases.


def phase_rows(
    table: FloatArray,
    turns: int,
    angle: FloatArray,
    which: tuple[NDArray[np.intp], ...] = (),
) -> FloatArray:
    """Values of the three phases at angles in rad, by straight lines between nodes, shape (3, ...).

    Args:
        table: Nodes of phase a, shape (1, ..., N), of which b and c lag by a third and two thirds
            of an electrical period, or of all phases, shape (3, ..., N).
        turns: Electrical periods that the nodes span.
        angle: Electrical angles in rad, any shape.
        which: Indices of the axes between the first and the last one, each of the angles' shape.
    """
    equal = table.shape[0] == 1
    period, count = 2.0 * np.pi * turns, table.shape[-1]
    phases = []
    for phase in range(3):
        row = table[0 if equal else phase]
        place = _remainder((angle - _TURN * phase * equal) * (count / period), count)
        # The remainder of a tiny negative number is the divisor itself.
        left = np.minimum(place.astype(np.intp), count - 1)
        part = place - left
        here, after = row[(*which, left)], np.roll(row, -1, axis=-1)[(*which, left)]
        phases.append(here + part * (after - here))
    return np.stack(phases)


def _remainder(value: FloatArray, divisor: int) -> FloatArray:
    """`numpy.mod`, bit for bit, in a quarter of its time.

    A quotient that is not whole never rounds away from zero to a whole number, so that what is left
    of a value is exact.
    """
    whole = np.asarray(value / divisor).astype(np.intp)
    left = np.asarray(value - whole * divisor)
    left += (left < 0.0) * divisor
    return left


def flux_at(shape: PhaseShape, angle: FloatArray) -> FloatArray:
    """Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).

    Args:
        shape: The table.
        angle: Electrical angles in rad, any shape.
    """
    phases = phase_rows(shape.flux, shape.turns, angle)
    return np.asarray(np.einsum("jk,k...->j...", clarke_matrix(), phases))


def unit_currents(flux: FloatArray, pole_pairs: int, *, zero: bool) -> FloatArray:
    """Currents per torque in A/(N m) on alpha, beta and 0, shape (3, ...).

    Args:
        flux: Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).
        pole_pairs: Number of pole pairs.
        zero: Whether the zero sequence shares the torque.
    """
    used = flux if zero else flux * np.array([1.0, 1.0, 0.0]).reshape(3, *[1] * (flux.ndim - 1))
    weight = pole_pairs * (1.5 * (used[0] ** 2 + used[1] ** 2) + 3.0 * used[2] ** 2)
    return np.asarray(used / weight)


def fade_share(control: PhaseControl, omega_e: FloatArray) -> FloatArray:
    """How much of the harmonics the references keep at electrical speeds in rad/s, 0 to 1: straight
    in the speed between the ends of the fading.

    Args:
        control: The control.
        omega_e: Electrical speeds in rad/s, any shape.
    """
    begin, end = (1.0 / samples for samples in control.fade)
    fraction = np.abs(omega_e) * control.t_s / (2.0 * np.pi)
    return np.asarray(np.clip((end - fraction) / (end - begin), 0.0, 1.0))


def reference_flux(control: PhaseControl, angle: FloatArray, omega_e: FloatArray) -> FloatArray:
    """The vector in Wb on alpha, beta and 0 that references are made from, shape (3, ...).

    The fundamental in dq; else the table, faded to its fundamental where there are few samples per
    period, without its zero sequence where that makes no torque.

    Args:
        control: The control.
        angle: Electrical angles in rad, any shape.
        omega_e: Electrical speeds in rad/s, broadcastable.
    """
    sine = control.psi_pm * np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)])
    if control.frame == "dq":
        return sine
    share = fade_share(control, omega_e)
    found = sine + share * (flux_at(control.shape, angle) - sine)
    found[2] *= float(uses_zero_sequence(control.frame, control.topology))
    return np.asarray(found)


def reference_currents(control: PhaseControl, angle: FloatArray, omega_e: FloatArray) -> FloatArray:
    """Currents per torque of the references in A/(N m) on alpha, beta and 0, shape (3, ...).

    Args:
        control: The control.
        angle: Electrical angles in rad, any shape.
        omega_e: Electrical speeds in rad/s, broadcastable.
    """
    return unit_currents(reference_flux(control, angle, omega_e), control.pole_pairs, zero=True)


def torque_of(flux: FloatArray, currents: FloatArray, pole_pairs: int) -> FloatArray:
    """Torque in N m of currents in A, both on alpha, beta and 0, shapes (3, ...).

    Args:
        flux: Back-EMF over electrical speed in Wb.
        currents: Currents in A.
        pole_pairs: Number of pole pairs.
    """
    plane = flux[0] * currents[0] + flux[1] * currents[1]
    return np.asarray(pole_pairs * (1.5 * plane + 3.0 * flux[2] * currents[2]))


def turned(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors on alpha, beta and 0 turned by angles in rad about the 0 axis, shape (3, ...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(
        np.broadcast_arrays(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])
    )
