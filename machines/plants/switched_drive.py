"""One electrical period of a drive, switch by switch: exact currents,
and the losses that they make.

The other way to a budget, and a check of the averaged one: no averages over carrier periods, and
currents that are not taken to be sinusoidal. Between switching instants machine and inverter are
linear with constant coefficients in rotor coordinates, where the voltage vector of a switching
state turns backwards; the matrix exponential carries currents and voltage from one instant to the
next without error, and the periodic steady state is the fixed point of the period.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.modulation.modulators import modulate
from dqforge.machines.modulation.ripple import switching_instants
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, phases_to_dq

_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, slots=True)
class SwitchedDrive:
    """Powers in W and currents in A over one electrical period in the periodic steady state.

    Args:
        link_power: Mean of v_dc times the current from the DC link into the bridge, whose switches
            drop no voltage here.
        copper, shaft_power: Of the machine, ripple and all.
        conduction, switching: Of the bridge, from its tables at the temperature given.
        capacitor_current, ripple_current: R.m.s. in A: of the DC-link current less its mean, and of
            a phase current less its fundamental.
        current: Mean (i_d, i_q) over the period in A.
    """

    link_power: float
    copper: float
    shaft_power: float
    conduction: float
    switching: float
    capacitor_current: float
    ripple_current: float
    current: tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Pulses:
    """Instants (n + 1,) in s, and states of the upper switches (n, 3) between them."""

    instant: FloatArray
    state: FloatArray


def _pulses(
    name: ModulationName,
    voltage: tuple[float, float],
    current: tuple[float, float],
    omega_e: float,
    v_dc: float,
    n: int,
) -> _Pulses:
    """Centred pulses of n carrier periods per electrical period.

    References are those in the middle of each.
    """
    t_s = 2.0 * math.pi / omega_e / n
    start = t_s * np.arange(n)
    theta = np.asarray(omega_e * (start + 0.5 * t_s))
    v_d, v_q, i_d, i_q = (np.full(n, value) for value in (*voltage, *current))
    # A voltage held over the carrier period in stator coordinates is smaller by
    # the mean of the rotation.
    held = 0.5 * omega_e * t_s / math.sin(0.5 * omega_e * t_s)
    phase = dq_to_phases(v_d * held, v_q * held, theta)
    duty = modulate(name, phase, dq_to_phases(i_d, i_q, theta), v_dc).duty
    edges = start[:, None, None] + switching_instants(duty, t_s)
    place = edges.transpose(0, 2, 1).reshape(-1)
    step = np.zeros((place.size, 3))
    step[np.arange(place.size), np.tile(np.arange(3), 2 * n)] = np.tile(
        np.repeat([1.0, -1.0], 3), n
    )
    order = np.argsort(place, kind="stable")
    state = np.concatenate([np.zeros((1, 3)), np.cumsum(step[order], axis=0)])
    return _Pulses(np.concatenate([[0.0], place[order], [2.0 * math.pi / omega_e]]), state)


def _propagators(machine: LinearMachine, omega_e: float, lengths: FloatArray) -> FloatArray:
    """Matrices (..., 5, 5) that carry (i_d, i_q, v_d, v_q, 1) over lengths (...) in
    s of one switching state.
    """
    l_d, l_q, r_s = machine.l_d, machine.l_q, machine.r_s
    system = np.zeros((5, 5))
    system[0] = [-r_s / l_d, omega_e * l_q / l_d, 1.0 / l_d, 0.0, 0.0]
    system[1] = [-omega_e * l_d / l_q, -r_s / l_q, 0.0, 1.0 / l_q, -omega_e * machine.psi_pm / l_q]
    system[2, 3], system[3, 2] = omega_e, -omega_e
    return _exponentials(system, lengths)


def _exponentials(matrix: FloatArray, lengths: FloatArray) -> FloatArray:
    """exp(A t) for many t by scaling and squaring of a Taylor series of order 12."""
    scaled = matrix * lengths[..., None, None]
    largest = float(np.max(np.abs(scaled).sum(axis=-1), initial=0.0))
    halvings = max(0, math.ceil(math.log2(largest / 0.25))) if largest > 0.25 else 0
    scaled = scaled / 2.0**halvings
    total = np.broadcast_to(np.eye(matrix.shape[0]), scaled.shape).copy()
    for order in range(12, 0, -1):
        total = np.eye(matrix.shape[0]) + scaled @ total / order
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)


def simulate_period(
    machine: LinearMachine,
    tables: BridgeTables,
    modulation: ModulationName,
    voltage: tuple[float, float],
    current: tuple[float, float],
    omega_m: float,
    *,
    v_dc: float,
    carrier_ratio: int,
    junction_temperature: float,
) -> SwitchedDrive:
    """Simulate the periodic steady state at a constant speed.

    Args:
        machine: A machine with constant inductances.
        tables: The device, whose losses are counted; transistor and diode have the temperature
            given.
        modulation: The modulator.
        voltage, current: References (v_d, v_q) in V, and (i_d, i_q) in A by which some modulators
            clamp.
        omega_m, v_dc, carrier_ratio: Mechanical speed in rad/s (positive), DC-link voltage in V,
            carrier periods per electrical period.
        junction_temperature: In degC.
    """
    omega_e = machine.pole_pairs * omega_m
    pulses = _pulses(modulation, voltage, current, omega_e, v_dc, carrier_ratio)
    length = np.diff(pulses.instant)
    leg = v_dc * (pulses.state - np.mean(pulses.state, axis=-1, keepdims=True))
    v_d, v_q = phases_to_dq(leg, omega_e * pulses.instant[:-1])  # at the start of each piece
    whole = _propagators(machine, omega_e, length)
    start = _periodic(whole, v_d, v_q)
    inside = _propagators(machine, omega_e, 0.5 * length[:, None] * (1.0 + _GAUSS_NODES))
    state = np.stack([start[:-1, 0], start[:-1, 1], v_d, v_q, np.ones_like(v_d)], axis=-1)
    found = np.einsum("ngij,nj->ngi", inside, state)
    time = pulses.instant[:-1, None] + 0.5 * length[:, None] * (1.0 + _GAUSS_NODES)
    weight = 0.5 * length[:, None] * _GAUSS_WEIGHTS / float(pulses.instant[-1])
    phases = dq_to_phases(found[..., 0], found[..., 1], omega_e * time)
    return _accounted(
        machine, tables, pulses, start, (found, phases, weight), omega_e, v_dc, junction_temperature
    )


def _periodic(whole: FloatArray, v_d: FloatArray, v_q: FloatArray) -> FloatArray:
    """Currents (n + 1, 2) in A at all instants of the periodic steady state."""
    from_state, from_input = whole[:, :2, :2], whole[:, :2, 2:]
    driven = np.einsum("nij,nj->ni", from_input, np.stack([v_d, v_q, np.ones_like(v_d)], axis=-1))
    through, rest = np.eye(2), np.zeros(2)
    for matrix, added in zip(from_state, driven, strict=True):
        through, rest = matrix @ through, matrix @ rest + added
    currents = [np.linalg.solve(np.eye(2) - through, rest)]
    for matrix, added in zip(from_state, driven, strict=True):
        currents.append(matrix @ currents[-1] + added)
    return np.stack(currents)


def _accounted(
    machine: LinearMachine,
    tables: BridgeTables,
    pulses: _Pulses,
    start: FloatArray,
    inside: tuple[FloatArray, FloatArray, FloatArray],
    omega_e: float,
    v_dc: float,
    temperature: float,
) -> SwitchedDrive:
    """Add up powers.

    ``inside`` holds dq states, phase currents and weights at places between the instants.
    """
    found, phases, weight = inside
    i_d, i_q = found[..., 0], found[..., 1]
    link = np.sum(pulses.state[:, None, :] * phases, axis=-1)
    mean = (float(np.sum(weight * i_d)), float(np.sum(weight * i_q)))
    ripple = 0.5 * float(np.sum(weight * ((i_d - mean[0]) ** 2 + (i_q - mean[1]) ** 2)))
    torque = (
        1.5
        * machine.pole_pairs
        * ((machine.psi_pm + machine.l_d * i_d) * i_q - machine.l_q * i_q * i_d)
    )
    size, ahead = np.abs(phases), phases >= 0.0
    on = pulses.state[:, None, :] > 0.5
    forward = on == ahead  # the transistor of the rail that is on carries its own direction
    channel = _warm(tables, tables.channel.at(size), temperature) * size
    backward = (
        channel
        if tables.synchronous or tables.diode is None
        else (_warm(tables, tables.diode.at(size), temperature) * size)
    )
    conduction = float(np.sum(weight[..., None] * np.where(forward, channel, backward)))
    at = np.abs(dq_to_phases(start[1:-1, 0], start[1:-1, 1], omega_e * pulses.instant[1:-1]))
    switched = np.any([pulses.state[1:] != pulses.state[:-1]], axis=0)
    # Pulses that fill or leave out the whole carrier period have edges that meet: they are none.
    switched &= (_neighbour(pulses, 1) > 0.0) & (_neighbour(pulses, -1) > 0.0)
    event = _warm(tables, tables.switching.at(at) + tables.recovery.at(at), temperature)
    # Each pair of edges is one event of every kind, whose halves fall to
    # the currents at both edges.
    switching = 0.5 * float(np.sum(np.where(switched, event, 0.0))) / float(pulses.instant[-1])
    link_mean = float(np.sum(weight * link))
    return SwitchedDrive(
        link_power=v_dc * link_mean,
        copper=1.5 * machine.r_s * float(np.sum(weight * (i_d**2 + i_q**2))),
        shaft_power=float(np.sum(weight * torque)) * omega_e / machine.pole_pairs,
        conduction=conduction,
        switching=switching,
        capacitor_current=math.sqrt(max(float(np.sum(weight * link**2)) - link_mean**2, 0.0)),
        ripple_current=math.sqrt(ripple),
        current=mean,
    )


def _neighbour(pulses: _Pulses, direction: int) -> FloatArray:
    """Time in s from each inner instant to the next (1) or last (-1) edge of the same phase,
    shape (n - 1, 3).
    """
    instant, changed = pulses.instant[1:-1], pulses.state[1:] != pulses.state[:-1]
    away = np.full(changed.shape, np.inf)
    for phase in range(3):
        (places,) = np.nonzero(changed[:, phase])
        gaps = (
            np.diff(instant[places], append=np.inf)
            if direction > 0
            else np.diff(instant[places], prepend=-np.inf)
        )
        away[places, phase] = np.where(
            gaps > 1e-9 * pulses.instant[-1] / max(places.size, 1), gaps, 0.0
        )
    return away


def _warm(tables: BridgeTables, values: FloatArray, temperature: float) -> FloatArray:
    """Values (K, ...) of tables at one temperature in degC."""
    if tables.temperatures.size == 1:
        return np.asarray(values[0])
    k = int(
        np.clip(
            np.searchsorted(tables.temperatures, temperature) - 1, 0, tables.temperatures.size - 2
        )
    )
    low, high = tables.temperatures[k : k + 2]
    return np.asarray(values[k] + (temperature - low) / (high - low) * (values[k + 1] - values[k]))
