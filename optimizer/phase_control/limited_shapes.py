"""Currents of constant torque where the link ends those in proportion to the torque.

Least-loss waveforms of `dqforge.optimizer.waveforms.solver` on a grid of speed and torque, as
deviations D from T u(theta). D makes no torque, so that all that lies between the nodes makes the
requested torque; at a speed the voltage region is convex, so that what lies between two torques
keeps it too. Between speeds and angles it is checked on a grid of its own.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import CURRENT_DELAY, clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import (
    PHASES,
    LimitedShapes,
    PhaseControl,
    flux_at,
    is_odd,
    largest_torques,
    link_region,
    no_load_speed,
    node_place,
    phase_rows,
    reference_currents,
    torque_of,
)
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.solver import solve_waveforms

# Share of the region that the nodes leave free beyond the margin, for what lies between them and
# for links below the nominal one.
RESERVE = 0.03

# Speeds from the knee to no load, and beyond, that are tried until what lies between them keeps the
# region.
SPEEDS = ((4, 6), (6, 9), (9, 14))
SHARES = 4  # Torques at each speed.
_LADDERS, _RUNGS = 2, 33
_LEAST = 0.02
_LOW = 0.8
_END = 1.02
_CHECKED = 480


@dataclass(frozen=True, slots=True)
class LimitedFit:
    """Currents beyond the plain ones, and what they err by between their nodes.

    ``excess`` is the largest voltage over the region less the margin, relative: not positive.
    ``excess_low`` is the same at four fifths of the nominal link voltage.
    ``torque_error`` is the largest error of the torque over the largest torque.
    """

    shapes: LimitedShapes
    excess: float
    excess_low: float
    torque_error: float

    @property
    def kilobytes(self) -> float:
        """Size of the table in single precision, in kB."""
        return 4e-3 * self.shapes.deviation.size


def limited_torques(
    limited: LimitedShapes, omega_e: FloatArray, v_dc: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Largest torques in N m of the plain currents and of these, shapes broadcast together.

    Args:
        limited: The table.
        omega_e: Electrical speeds in rad/s, either sense.
        v_dc: Link voltages in V.
    """
    load = np.abs(omega_e) * limited.v_nominal / np.maximum(v_dc, 1e-9 * limited.v_nominal)
    plain, most = (
        np.interp(load, limited.omega_e, nodes) for nodes in (limited.plain, limited.most)
    )
    return np.asarray(plain), np.asarray(most)


def limited_deviation(
    limited: LimitedShapes,
    turns: int,
    torque: FloatArray,
    omega_e: FloatArray,
    v_dc: FloatArray,
    angle: FloatArray,
) -> FloatArray:
    """D on alpha, beta and 0 in A at torques in N m, shape (3, ...); all broadcast together.

    Args:
        limited: The table.
        turns: Electrical periods that its angles span.
        torque: Motoring torques in N m, of the sign of the speed.
        omega_e: Electrical speeds in rad/s.
        v_dc: Link voltages in V.
        angle: Electrical angles in rad.
    """
    torque, omega_e, v_dc, angle = np.broadcast_arrays(torque, omega_e, v_dc, angle)
    back = (omega_e < 0.0) & limited.mirrored
    plain, most = limited_torques(limited, omega_e, v_dc)
    span = np.where(most > plain, most - plain, np.inf)
    share = np.clip((np.abs(torque) - plain) / span, 0.0, 1.0)
    load = np.abs(omega_e) * limited.v_nominal / np.maximum(v_dc, 1e-9 * limited.v_nominal)
    row, above = node_place(limited.omega_e, load)
    steps = limited.deviation.shape[2] - 1
    column = np.minimum((share * steps).astype(np.intp), steps - 1)
    beside = share * steps - column
    phases = np.zeros((3, *angle.shape))
    for i, weight_i in ((row, 1.0 - above), (row + 1, above)):
        for j, weight_j in ((column, 1.0 - beside), (column + 1, beside)):
            phases += (
                weight_i
                * weight_j
                * phase_rows(limited.deviation, turns, np.where(back, -angle, angle), (i, j))
            )
    found = np.einsum("jk,k...->j...", clarke_matrix(), phases)
    found[1] = np.where(back, -found[1], found[1])
    missing = (load < limited.omega_e[0]) | ((omega_e < 0.0) & ~np.bool_(limited.mirrored))
    return np.where(missing, 0.0, found)


def fit_limited(
    control: PhaseControl,
    machine: PhaseMachine,
    v_dc: float,
    i_max: float,
    omega_e_max: float | None,
    margin: float,
) -> LimitedFit | None:
    """Currents beyond the plain ones, None where the link does not end those.

    Args:
        control: The control without them, frame ``table``.
        machine: The machine.
        v_dc: Nominal link voltage in V.
        i_max: Current limit in A, peak.
        omega_e_max: Top speed in rad/s, electrical: the table goes on to one and a half times that,
            so that it serves down to two thirds of the link voltage; None for a third beyond no
            load.
        margin: Share of the region that is left free, of 0 to 1.

    Raises:
        NoSolutionError: No grid that is tried keeps the region between its nodes.
    """
    free = no_load_speed(control, v_dc, margin)
    last = 4.0 / 3.0 * free if omega_e_max is None else 1.5 * omega_e_max
    scan = np.linspace(0.0, min(free, last), 201)
    plain = largest_torques(control, scan, v_dc, margin + RESERVE)
    knee = int(np.flatnonzero(plain >= plain[0])[-1])
    if knee == scan.size - 1:
        return None
    limits = WaveformLimits(
        v_dc=(1.0 - margin - RESERVE) * v_dc, topology=_solved(control.topology), i_max=i_max
    )
    empty = min(int(np.flatnonzero(plain > 0.0)[-1]) + 1, scan.size - 1)
    for rising, falling in SPEEDS:
        before = np.linspace(scan[knee], scan[empty], rising)
        speeds = np.unique([*before, *np.linspace(scan[empty], last, falling)])
        shapes = _shapes(control, machine, speeds, v_dc, margin, limits)
        if shapes is None:
            return None
        excess, error = _between_nodes(control, shapes, v_dc, margin)
        if excess <= 0.0:
            low, _ = _between_nodes(control, shapes, _LOW * v_dc, margin)
            return LimitedFit(shapes, excess, low, error)
    raise NoSolutionError(
        "control.current_loop.limited_waveforms: between the nodes of the table the voltage leaves "
        f"the region by {100.0 * excess:.2g} %; remove it, and the torque is reduced instead"
    )


def _shapes(
    control: PhaseControl,
    machine: PhaseMachine,
    speeds: FloatArray,
    v_dc: float,
    margin: float,
    limits: WaveformLimits,
) -> LimitedShapes | None:
    """The table on electrical speeds in rad/s, from the knee on; None where it is empty."""
    plain = largest_torques(control, speeds, v_dc, margin + RESERVE)
    most = np.array([_most(machine, speed, limits, control.torque_max) for speed in speeds])
    kept = (most > _LEAST * control.torque_max) & (most >= plain)
    kept[0] = True
    count = int(np.argmin(kept)) if not kept.all() else kept.size
    speeds, plain, most = speeds[:count], plain[:count], most[:count]
    if count < 2:
        return None
    most[0] = plain[0] = control.torque_max
    found = _deviations(control, machine, speeds, plain, most, limits)
    # A last node without torque, beyond which nothing is promised.
    return LimitedShapes(
        omega_e=np.append(speeds, _END * speeds[-1]),
        plain=np.append(plain, 0.0),
        most=np.append(np.maximum(most, plain), 0.0),
        deviation=np.concatenate([found, np.repeat(found[:, -1:, :1], SHARES, axis=2)], axis=1),
        v_nominal=v_dc,
        mirrored=is_odd(control),
    )


def _solved(topology: Topology) -> Topology:
    """The topology that the waveforms are solved for: diodes at the neutral carry no current."""
    return "three-wire" if TOPOLOGIES[topology].diodes else topology


def _most(
    machine: PhaseMachine, omega_e: float, limits: WaveformLimits, torque_max: float
) -> float:
    """Largest torque in N m at an electrical speed in rad/s; 0 where there is none.

    Torques that can be had fill an interval: two ladders find its upper end to a thousandth of
    ``torque_max``. (A linear programme for it stops short of an answer at some speeds.)
    """
    low, high = 0.0, torque_max
    for _ in range(_LADDERS):
        ladder = np.linspace(low, high, _RUNGS)
        found = solve_waveforms(machine, ladder, omega_e / machine.pole_pairs, limits)
        holds = np.flatnonzero(found.feasible)
        if holds.size == 0:
            return 0.0
        best = int(holds[-1])
        low, high = float(ladder[best]), float(ladder[min(best + 1, _RUNGS - 1)])
    return low


def _deviations(
    control: PhaseControl,
    machine: PhaseMachine,
    speeds: FloatArray,
    plain: FloatArray,
    most: FloatArray,
    limits: WaveformLimits,
) -> FloatArray:
    """D of the phases on the nodes in A, shape (1 or 3, W, S, N)."""
    rows, nodes = control.shape.flux.shape
    period = 2.0 * np.pi * control.shape.turns
    angle = period * np.arange(nodes) / nodes
    own = period * np.arange(machine.angles + 1) / machine.angles
    flux = flux_at(control.shape, angle)
    found = np.zeros((rows, speeds.size, SHARES, nodes))
    for place, speed in enumerate(speeds):
        torques = np.linspace(plain[place], most[place], SHARES)
        solved = solve_waveforms(machine, torques, speed / machine.pole_pairs, limits)
        reference = reference_currents(control, angle, np.array(speed))
        for step in range(SHARES):
            if place == 0 or solved.status[step] == "closed form":
                continue
            closed = np.concatenate([solved.currents[step], solved.currents[step][:, :1]], axis=1)
            currents = np.stack([np.interp(angle, own, row) for row in closed])
            away = clarke_matrix() @ currents - torques[step] * reference
            # Nodes lie between the angles of the solution: what torque that leaves is taken off.
            away -= torque_of(flux, away, control.pole_pairs) * reference
            found[:, place, step] = (PHASES @ away)[:rows]
    return found


def _between_nodes(
    control: PhaseControl, shapes: LimitedShapes, v_dc: float, margin: float
) -> tuple[float, float]:
    """Largest voltage over the region less the margin, and error of the torque, on a grid between
    the nodes; both relative.
    """
    turns = control.shape.turns
    angle = 2.0 * np.pi * turns * np.arange(_CHECKED * turns) / (_CHECKED * turns)
    load = np.unique([*shapes.omega_e, *(0.5 * (shapes.omega_e[1:] + shapes.omega_e[:-1]))])
    omega = (load * v_dc / shapes.v_nominal)[:, np.newaxis, np.newaxis]
    _, most = limited_torques(shapes, omega, np.array(v_dc))
    torque = most * np.linspace(0.0, 1.0, 2 * SHARES + 1)[:, np.newaxis]
    currents = [
        torque * reference_currents(control, at, omega)
        + limited_deviation(shapes, turns, torque, omega, np.array(v_dc), at)
        for at in (angle + j * omega * control.t_s for j in (0.0, 1.0, 2.0))
    ]
    l_d, l_q, l_0 = control.inductances
    inductance = np.array([0.5 * (l_d + l_q), 0.5 * (l_d + l_q), l_0]).reshape(3, 1, 1, 1)
    voltage = 0.5 * control.r_s * (currents[1] + currents[2])
    voltage = voltage + inductance / control.t_s * (currents[2] - currents[1])
    voltage += omega * flux_at(control.shape, angle + CURRENT_DELAY * omega * control.t_s)
    if not TOPOLOGIES[control.topology].neutral:
        voltage[2] = 0.0
    low, high, rows = link_region(control, v_dc, margin)
    found = np.tensordot(rows @ PHASES, voltage, 1)
    bounds = (len(rows), 1, 1, 1)
    excess = np.maximum(found / high.reshape(bounds), found / low.reshape(bounds)) - 1.0
    made = torque_of(flux_at(control.shape, angle), currents[0], control.pole_pairs)
    return float(np.max(excess)), float(np.max(np.abs(made - torque)) / control.torque_max)
