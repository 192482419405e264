"""Where the voltage of the link ends the torque.

In the steady state the control law makes, at the sample k, the phase voltages

    v = R (i_1 + i_2)/2 + L (i_2 - i_1)/T_s + omega_e f(theta + 1.5 omega_e T_s),
    i_j = T u(theta + j omega_e T_s)

which are straight in the torque T at every angle. Each inequality of the topology's region then
permits an interval of torques, and the largest torque is the least of their ends over all angles.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.topologies.regions import VOLTAGE_ROWS, voltage_bounds
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.linear_programme import least_cost
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, TorqueLimit
from dqforge.optimizer.phase_control.shape_vectors import (
    PHASES,
    flux_at,
    reference_currents,
)

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
    emf = omega * flux_at(control.shape, angle + 1.5 * step)
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
        raise NoSolutionError("control: no torque can be had at some speed and link voltage")
    return np.asarray(np.maximum(found.reshape(speeds.size, links.size), 0.0) + 0.0)


def _hats(nodes: FloatArray, fine: FloatArray) -> FloatArray:
    """Weights of the nodes at each value between them, shape (fine, nodes)."""
    return np.stack([np.interp(fine, nodes, unit) for unit in np.eye(nodes.size)], axis=1)
