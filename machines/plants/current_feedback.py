"""PWM by current feedback on a machine's phase currents: hysteresis, ramp comparison, predictive
control and the schemes of `dqforge.machines.plants.regulator_schemes`; and one period of a
drive, switch by switch.

The regulators of paper 001, section 6.2.4, simulated at constant speed as references for what a
carrier-based modulator makes: the bridge is ideal, the currents are solved exactly between the
switching instants (`dqforge.machines.plants.fed_machine`), and comparators act at the very instant
at which their inputs cross. Nothing is random. Many operating points are stepped together, each
with a clock of its own.

References:
    L. B. Bezerra, COPPE/UFRJ 2004 (paper 001), sections 6.2.4.1, 6.2.4.2 and 6.2.4.4. D. M. Brod,
    D. W. Novotny, "Current control of VSI-PWM inverters", IEEE Transactions on Industry
    Applications IA-21(3), 1985, pp. 562-570 (error of twice the band, slopes of ramp comparison).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, copper_loss
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.modulation.modulators import modulate
from dqforge.machines.modulation.ripple import switching_instants
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.fed_machine import (
    I_D,
    I_Q,
    Z_D,
    Z_Q,
    BridgeDrive,
    Controller,
    CurrentTrace,
    LegByLeg,
    Plant,
    build_plant,
    follow,
)
from dqforge.machines.plants.regulator_schemes import (
    Circle,
    FurtherScheme,
    Sampled,
    Trajectory,
    check_further,
    check_further_points,
    further_start,
    further_work,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, phases_to_dq

# All switching states of the bridge, (8, 3).
BRIDGE_STATES: BoolArray = np.array(
    [[bool(code >> leg & 1) for leg in range(3)] for code in range(8)]
)


# Voltage errors, in terms of the DC link, at which two switching states count as equally good.
_EQUAL_STATES = 1e-9


@dataclass(frozen=True, slots=True)
class Hysteresis:
    """Three independent comparators (paper 001, 6.2.4.1): a leg goes down at the error +band,
    up at -band.

    Args:
        band: Half of the tolerance band h in A.
    """

    band: float


@dataclass(frozen=True, slots=True)
class RampComparison:
    """PI regulators of the current error whose outputs meet a triangle (paper 001, 6.2.4.2).

    ``v = kp e + ki integral(e dt)`` of both axes, turned back to phases; the upper switch is on
    while v exceeds the triangle, which reaches from -v_dc/2 to v_dc/2. The triangle runs on its
    own, asynchronous to the currents.

    Args:
        kp, ki: Gains in V/A and V/(A s); ki may be 0.
        f_carrier: Frequency of the triangle in Hz.
        frame: Coordinates in which the error is integrated: ``synchronous`` leaves no error of the
            fundamental.
        comparator_band: Hysteresis of the comparators in V, from edge to edge. Without it a loop
            that is steeper than the triangle chatters infinitely fast (`slope_ratio`).
    """

    kp: float
    ki: float
    f_carrier: float
    frame: Literal["synchronous", "stationary"] = "synchronous"
    comparator_band: float = 0.0


@dataclass(frozen=True, slots=True)
class Predictive:
    """The switching state with the least predicted current error, one sample ahead (paper 001,
    6.2.4.4).

    The model is exact, and the state chosen at a sample acts from there on. A computing time of one
    sample would change nothing, since the switching state until then is known; errors of the model
    would.

    Args:
        t_s: Sampling period in s.
    """

    t_s: float


Scheme = Hysteresis | RampComparison | Predictive


class _HysteresisController(LegByLeg):
    def __init__(self, scheme: Hysteresis) -> None:
        self.interval = math.inf
        self.scale = self._band = scheme.band

    def margin(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        error = plant.phase_errors(state, plant.omega_e * time)
        return np.where(legs, error, -error) - self._band

    def decide(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        return legs


class _RampController(LegByLeg):
    def __init__(self, scheme: RampComparison, v_dc: float) -> None:
        self.interval = 0.5 / scheme.f_carrier
        self.scale = v_dc
        self._scheme = scheme

    def margin(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        scheme = self._scheme
        v_d = scheme.kp * (plant.i_d - state[..., I_D]) + scheme.ki * state[..., Z_D]
        v_q = scheme.kp * (plant.i_q - state[..., I_Q]) + scheme.ki * state[..., Z_Q]
        turn = time * scheme.f_carrier
        triangle = self.scale * (2.0 * np.abs(turn - np.floor(turn) - 0.5) - 0.5)
        above = dq_to_phases(v_d, v_q, plant.omega_e * time) - triangle[..., None]
        return np.where(legs, -above, above) - 0.5 * scheme.comparator_band

    def decide(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        return legs


class _PredictiveController(LegByLeg):
    def __init__(self, scheme: Predictive) -> None:
        self.interval = scheme.t_s
        self.scale = 1.0
        self._scheme = scheme

    def margin(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        return np.full(legs.shape, -1.0)

    def decide(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        return best_states(plant, state, time, legs, self._scheme.t_s)


def best_states(
    plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray, t_s: float
) -> BoolArray:
    """Switching states (N, 3) with the least current error after the sampling period t_s in s.

    Of equally good states (both zero vectors are) the one with the fewest commutations, then the
    first of `BRIDGE_STATES`. The prediction is exact for the machine of the plant.

    Args:
        plant: The drive at N points.
        state, time, legs: State (N, 9), time in s from the angle 0 (N,), and the present switching
            state (N, 3).
        t_s: Sampling period in s.
    """
    tried = np.broadcast_to(BRIDGE_STATES[:, None, :], (8, *legs.shape))
    ends = plant.advance(
        plant.switched(np.broadcast_to(state, (8, *state.shape)), plant.omega_e * time, tried), t_s
    )
    error = np.hypot(ends[..., I_D] - plant.i_d, ends[..., I_Q] - plant.i_q)
    machine = plant.drive.machine
    close = _EQUAL_STATES * plant.drive.v_dc * t_s / min(machine.l_d, machine.l_q)
    moves = np.sum(tried != legs, axis=-1)
    chosen = np.argmin(np.where(error <= np.min(error, axis=0) + close, moves, 4), axis=0)
    return np.asarray(BRIDGE_STATES[chosen])


def slope_ratio(
    drive: BridgeDrive, scheme: RampComparison, i_d: ArrayLike, i_q: ArrayLike, omega_m: ArrayLike
) -> FloatArray:
    """Steepest slope of the regulators' output over that of the triangle, shape (...).

    Below 1 each leg switches exactly twice per carrier period, whatever the angle; above it
    comparators may meet the triangle more than once (Brod and Novotny 1985). An upper bound, from
    the largest phase voltage of the bridge, 2/3 v_dc, plus the amplitude of the phase voltage V
    that the references need:

        kp (2/3 v_dc + V) / L_min / (2 v_dc f_carrier),   L_min the smaller inductance

    The integral part and the turning of the references, which are slow beside the carrier,
    are left out.

    Args:
        drive, scheme: The drive and its regulators.
        i_d, i_q, omega_m: References in A (peak) and mechanical speed in rad/s, broadcastable to
            the shape (...).
    """
    d, q, omega = (np.asarray(value, dtype=np.float64) for value in (i_d, i_q, omega_m))
    machine = drive.machine
    voltage = np.hypot(*machine.voltage(d, q, machine.pole_pairs * omega))
    slope = scheme.kp * (2.0 / 3.0 * drive.v_dc + voltage) / min(machine.l_d, machine.l_q)
    return np.asarray(slope / (2.0 * drive.v_dc * scheme.f_carrier))


def hysteresis_frequency(
    v_dc: float, inductance: float, band: float, voltage: ArrayLike
) -> FloatArray:
    """Switching frequency in Hz of a hysteresis regulator whose star point is tied to
    the middle of the DC link.

    A phase then is a half bridge on an inductance: the error crosses the band 2 h with the
    slopes (v_dc/2 -+ v) / L,

        f = ((v_dc/2)^2 - v^2) / (2 v_dc h L),   average over a sinusoid v of amplitude V:
            v^2 -> V^2 / 2

    Args:
        v_dc, inductance, band: DC-link voltage in V, inductance of the phase in H, half of the band
            h in A.
        voltage: Voltage v in V that the reference current needs, any shape; its root mean square
            for the average.
    """
    v = np.asarray(voltage, dtype=np.float64)
    return np.asarray((0.25 * v_dc**2 - v**2) / (2.0 * v_dc * band * inductance))


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")


def _not_negative(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise InputError(f"{name}: expected 0 or a positive number in {unit}, got {value!r}")


def _check_scheme(drive: BridgeDrive, scheme: Scheme) -> None:
    if isinstance(scheme, Hysteresis):
        _positive("band", scheme.band, "A")
        return
    if drive.neutral_inductance is not None:
        raise InputError(
            "neutral_inductance: only hysteresis regulates three currents; leave the star point "
            "isolated"
        )
    if isinstance(scheme, RampComparison):
        _positive("kp", scheme.kp, "V/A")
        _positive("f_carrier", scheme.f_carrier, "Hz")
        _not_negative("ki", scheme.ki, "V/(A s)")
        _not_negative("comparator_band", scheme.comparator_band, "V")
        return
    _positive("t_s", scheme.t_s, "s")


def _controller(scheme: Scheme, drive: BridgeDrive) -> Controller:
    if isinstance(scheme, Hysteresis):
        return _HysteresisController(scheme)
    if isinstance(scheme, RampComparison):
        return _RampController(scheme, drive.v_dc)
    return _PredictiveController(scheme)


def _points(*values: ArrayLike) -> list[FloatArray]:
    arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
    return [np.array(array).ravel() for array in arrays]


def simulate_currents(
    drive: BridgeDrive,
    scheme: Scheme | FurtherScheme,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    *,
    periods: int = 1,
    settling: int = 1,
) -> CurrentTrace:
    """Simulate a current regulator at constant speed with sinusoidal back-EMF.

    Args:
        drive: Machine and bridge.
        scheme: The regulator.
        i_d, i_q, omega_m: References in A (peak) and mechanical speed in rad/s, not 0; broadcast, N
            points in all.
        periods: Electrical periods that are observed.
        settling: Electrical periods before them; the currents start on their references.

    Returns:
        Currents, switching instants and what follows from them, for N points in C order.

    Raises:
        InputError: A parameter is out of range, or a band so narrow that a point would commutate
            more than a million times.
        NoSolutionError: The comparators of ramp comparison chatter.
    """
    if isinstance(scheme, Sampled | Circle | Trajectory):
        check_further(drive, scheme)
    else:
        _check_scheme(drive, scheme)
    if periods < 1 or settling < 0:
        raise InputError(
            f"periods, settling: expected at least 1 and 0, got {periods} and {settling}"
        )
    d, q, omega_m_flat = _points(i_d, i_q, omega_m)
    if not (np.all(np.isfinite([d, q, omega_m_flat])) and np.all(omega_m_flat != 0.0)):
        raise InputError(
            "i_d, i_q, omega_m: expected finite currents and speeds other than 0; a period is "
            "simulated"
        )
    machine = drive.machine
    omega_e = machine.pole_pairs * omega_m_flat
    period = 2.0 * math.pi / np.abs(omega_e)
    if isinstance(scheme, Sampled | Circle | Trajectory):
        plant = build_plant(drive, d, q, omega_e)
        check_further_points(plant, scheme)
        _check_count(float(np.max(period * further_work(plant, scheme))) * (periods + settling))
        v_d, v_q = machine.voltage(d, q, omega_e)
        suggested = dq_to_phases(v_d, v_q, np.zeros(d.size)) > 0.0
        steering, state, legs = further_start(plant, scheme, suggested)
        return follow(plant, steering, state, legs, settling * period, periods * period)
    _check_work(drive, scheme, float(np.max(period)) * (periods + settling))
    rotating = not isinstance(scheme, RampComparison) or scheme.frame == "synchronous"
    plant = build_plant(drive, d, q, omega_e, rotating=rotating)
    v_d, v_q = machine.voltage(d, q, omega_e)
    legs = dq_to_phases(v_d, v_q, np.zeros(d.size)) > 0.0
    integral = None
    if isinstance(scheme, RampComparison):
        legs = np.zeros_like(legs)  # the triangle starts at its top
        if scheme.ki > 0.0:
            integral = (v_d / scheme.ki, v_q / scheme.ki)
    controller = _controller(scheme, drive)
    return follow(
        plant, controller, plant.start(legs, integral), legs, settling * period, periods * period
    )


def _check_work(drive: BridgeDrive, scheme: Scheme, duration: float) -> None:
    machine = drive.machine
    count: float = duration
    if isinstance(scheme, Hysteresis):
        count *= 6.0 * float(
            hysteresis_frequency(drive.v_dc, min(machine.l_d, machine.l_q), scheme.band, 0.0)
        )
    else:
        count *= 6.0 * scheme.f_carrier if isinstance(scheme, RampComparison) else 3.0 / scheme.t_s
    _check_count(count)


def _check_count(count: float) -> None:
    if count > 1e6:
        raise InputError(
            f"about {count:.2g} commutations per point would be simulated, at most 1e6 are; "
            "choose a wider band, a slower carrier, a longer sampling period, or fewer periods"
        )


# One electrical period of a drive, switch by switch: exact currents, and the losses that they
# make.
#
# The other way to a budget, and a check of the averaged one: no averages over carrier periods, and
# currents that are not taken to be sinusoidal. Between switching instants machine and inverter are
# linear with constant coefficients in rotor coordinates, where the voltage vector of a switching
# state turns backwards; the matrix exponential carries currents and voltage from one instant to
# the next without error, and the periodic steady state is the fixed point of the period.

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
    on = pulses.state[:, None, :].astype(np.bool_)
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
        copper=float(np.sum(weight * copper_loss(machine.r_s, i_d, i_q))),
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
