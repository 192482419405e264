"""Optimal operating points of any machine, whole arrays of torque and speed at once.

Least loss for a torque at a speed, within the current limit and the voltage limit of the modulator,
the resistance drop included. In two currents every optimum is the meeting of two curves: the torque
and the valley of the loss, the torque and the voltage limit, the voltage limit and the current
limit, or the touching point of torque and voltage limit (MTPV); where the data of a flux map end
before, it lies on their edge. Each is solved by Newton's method from a start that a scan of the
feasible region gives, never from the user.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import (
    CurrentRegion,
    Machine,
    copper_loss,
    torque_from_flux,
)
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import (
    NO_EXTRA_LOSS,
    REFERENCE_TEMPERATURE,
    MachineLoss,
    bridge_load,
    required_device,
    resistance_factor,
    thermal_balance,
)
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import amplitude_fits
from dqforge.optimizer.operating_points.ends_of_data import hold_by_data
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    BoolArray,
    IndexArray,
    LossCoefficients,
    Problem,
    State,
    Terms,
    cross_of_gradients,
    current_terms,
    free_locus,
    loss_terms,
    newton_step,
    region_that_holds,
    torque_terms,
    voltage_terms,
)
from dqforge.optimizer.operating_points.point_solver import solve_chunk

# Points solved together: bounds the memory whatever the number of points, and keeps the arrays in
# the cache.
CHUNK = 32_768


@dataclass(frozen=True, slots=True)
class OptimalPoints:
    """Operating points, arrays of shape (N,).

    ``torque_request`` and ``torque`` in N m (equal where ``reached``), ``omega_m`` in rad/s,
    ``i_d``, ``i_q`` in A, ``voltage`` is the phase amplitude in V, ``loss`` in W by the objective's
    model. ``active`` holds codes of `Active`. ``kkt_residual`` is the largest of the relative
    violations of torque, limits, stationarity and multiplier signs. ``extrapolated`` is true where
    the currents lie beyond the data of a flux map.
    """

    torque_request: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    voltage: FloatArray
    loss: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    kkt_residual: FloatArray
    extrapolated: BoolArray


def _as_points(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    array = np.broadcast_to(np.asarray(values, dtype=np.float64), shape).ravel()
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name} must be finite; got nan or inf")
    return array


def copper_only(machine: Machine) -> LossCoefficients:
    """Coefficients of the winding alone, 3/2 R |i|^2 (1 W/A^2 for a machine without resistance:
    the same optimum).
    """
    square = np.array(1.5 * machine.r_s if machine.r_s > 0.0 else 1.0)
    return LossCoefficients(square, np.array(0.0), np.array(0.0))


def optimal_points(
    machine: Machine,
    torque: ArrayLike,
    omega_m: ArrayLike,
    *,
    v_max: ArrayLike,
    i_max: float | None = None,
    loss: LossCoefficients | None = None,
) -> OptimalPoints:
    """Currents of least loss for arrays of torque and speed.

    Args:
        machine: Any machine: linear or flux map.
        torque, omega_m: Requested torque in N m and mechanical speed in rad/s, any sign, broadcast
            together to N points.
        v_max: Largest phase-voltage amplitude in V, positive, broadcast to the points.
        i_max: Current limit in A (peak); the machine's own when None.
        loss: What is minimised, as coefficients at each point; copper loss when None.

    Raises:
        InputError: A number is not finite or a limit not positive.

    Notes:
        A negative torque is the mirror image (i_q, omega reversed) of a positive one. Where the
        torque cannot be had, the largest that can is returned with ``reached`` false, and
        ``active`` names what stands in the way. No point leaves the data of a flux map unless that
        permits it.
    """
    shape = np.broadcast_shapes(np.shape(torque), np.shape(omega_m), np.shape(v_max))
    limit = machine.i_max if i_max is None else i_max
    request, speed = _as_points(torque, shape, "torque"), _as_points(omega_m, shape, "speed")
    volts = _as_points(v_max, shape, "v_max")
    if not (limit > 0.0 and np.all(volts > 0.0)):
        raise InputError("current and voltage limits must be positive")
    coefficients = copper_only(machine) if loss is None else loss
    for values in (coefficients.square, coefficients.linear, coefficients.iron):
        _as_points(values, shape, "loss")
    spread = coefficients.spread(shape)
    sign = np.where(request < 0.0, -1.0, 1.0)
    whole = Problem(
        machine,
        free_locus(machine, limit),
        np.abs(request),
        sign * machine.pole_pairs * speed,
        volts,
        limit,
        spread,
        region_that_holds(machine, limit),
    )
    solved = [
        _solve(whole.take(np.arange(k, min(k + CHUNK, request.size))))
        for k in range(0, request.size, CHUNK)
    ]
    i_d, i_q, produced, volts_taken, losses, active, reached, residuals = (
        np.concatenate([part[column] for part in solved]) if solved else np.zeros(0)
        for column in range(8)
    )
    met = reached.astype(np.bool_)
    return OptimalPoints(
        torque_request=request,
        torque=np.where(met, request, sign * produced),
        omega_m=speed,
        i_d=i_d,
        i_q=sign * i_q,
        voltage=volts_taken,
        loss=losses,
        active=active.astype(np.int8),
        reached=met,
        kkt_residual=residuals,
        # What the region holds lies inside but for rounding, which is no extrapolation.
        extrapolated=~(
            machine.known(i_d, i_q) if whole.region is None else whole.region.contains(i_d, i_q)
        ),
    )


def _solve(problem: Problem) -> tuple[NDArray[Any], ...]:
    """Columns of one chunk: i_d, i_q, torque, voltage, loss, active, reached, residual."""
    free = replace(problem, region=None)
    state = solve_chunk(free)
    residuals, torque, voltage, losses = residual(free, state)
    again = missed_points(state, residuals)
    if again.size:
        replace_missed_points(free, state, again, residuals)
        residuals, torque, voltage, losses = residual(free, state)
    if problem.region is not None:
        hold_by_data(problem, state, problem.region)
        residuals, torque, voltage, losses = residual(problem, state)
    return state.i_d, state.i_q, torque, voltage, losses, state.active, state.reached, residuals


# Proof of optimality: how far each operating point is from the Karush-Kuhn-Tucker
# conditions of its problem.

# Share of a limit within which a point on the edge of the data counts as held by that limit, too.
_ON_A_LIMIT = 1e-6


def _norm(terms: Terms) -> FloatArray:
    """Length of the gradient, never quite zero so that it may divide."""
    return np.maximum(np.hypot(terms.d, terms.q), 1e-300)


def _two_multipliers(goal: Terms, first: Terms, second: Terms) -> tuple[FloatArray, FloatArray]:
    """Multipliers (a, b) of goal = a first + b second (gradients)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (goal.d * second.q - goal.q * second.d) * scale, (
            first.d * goal.q - first.q * goal.d
        ) * scale


def residual(
    problem: Problem, state: State
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Largest relative violation of the conditions, torque in N m, voltage in V and loss in W,
    shape (N,).

    Args:
        problem: Machine, torques and limits of the points.
        state: Currents and multipliers of the points.
    """
    machine, d, q = problem.machine, state.i_d, state.i_q
    jet = machine.jet(d, q)
    torque = torque_terms(machine, jet, d, q)
    voltage = voltage_terms(machine, jet, d, q, problem.omega_e)
    loss = loss_terms(problem.loss, jet, d, q, problem.soft)
    circle = current_terms(d, q)
    most = float(problem.locus.torque[-1])
    square = problem.v_max**2
    over_voltage = np.maximum(voltage.value / square - 1.0, 0.0)
    over_current = np.maximum(circle.value / problem.i_max**2 - 1.0, 0.0)
    residual = np.maximum(
        np.abs(torque.value - state.torque) / most, np.maximum(over_voltage, over_current)
    )
    if problem.region is not None:
        residual = np.maximum(residual, problem.region.beyond(d, q) / problem.i_max)
    active = state.active
    residual = np.where(active == Active.UNREACHABLE, 0.0, residual)
    # Near zero current the gradient of the loss vanishes; its direction is judged against a
    # thousandth of its size.
    loss_scale = np.maximum(_norm(loss), 2e-3 * problem.loss.square * problem.i_max) * _norm(torque)
    slope = np.abs(loss.d * torque.q - loss.q * torque.d) / loss_scale
    residual = np.where(active == Active.NONE, np.maximum(residual, slope), residual)
    for code, limit, gap in (
        (Active.VOLTAGE, voltage, np.abs(voltage.value / square - 1.0)),
        (Active.CURRENT, circle, np.abs(circle.value / problem.i_max**2 - 1.0)),
    ):
        chosen = (active == code) & state.reached
        _, pull = _two_multipliers(loss, torque, limit)
        wrong = np.maximum(pull * _norm(limit) / _norm(loss), 0.0)
        residual = np.where(chosen, np.maximum(residual, np.maximum(gap, wrong)), residual)
    residual = _most_torque_residual(residual, state, torque, voltage, circle)
    if problem.region is not None:
        residual = _data_residual(
            residual, problem, state, problem.region, (loss, torque, voltage, circle)
        )
    return residual, torque.value, np.sqrt(voltage.value), loss.value


def _most_torque_residual(
    residual: FloatArray, state: State, torque: Terms, voltage: Terms, circle: Terms
) -> FloatArray:
    """Add the conditions of most torque: its gradient lies between those
    of the limits that hold it.
    """
    for code, limit in ((Active.CURRENT, circle), (Active.MTPV, voltage)):
        chosen = (state.active == code) & ~state.reached
        sine = np.abs(
            (torque.d / _norm(torque)) * (limit.q / _norm(limit))
            - (torque.q / _norm(torque)) * (limit.d / _norm(limit))
        )
        residual = np.where(chosen, np.maximum(residual, sine), residual)
    by_voltage, by_current = _two_multipliers(torque, voltage, circle)
    sense = np.where(state.least, -1.0, 1.0)
    with np.errstate(invalid="ignore"):
        wrong = np.maximum(
            -sense * by_voltage * _norm(voltage), -sense * by_current * _norm(circle)
        ) / _norm(torque)
    return np.where(
        state.active == Active.BOTH, np.maximum(residual, np.maximum(wrong, 0.0)), residual
    )


def _data_residual(
    residual: FloatArray,
    problem: Problem,
    state: State,
    region: CurrentRegion,
    terms: tuple[Terms, Terms, Terms, Terms],
) -> FloatArray:
    """Add the conditions of points on the edge of the data.

    ``terms`` are loss, torque, voltage and current.

    For a torque that is reached, less loss must lie beyond the edge alone. The gradient of a most
    torque must lie between the normals of an edge and of whatever else holds the point: another
    edge, the voltage or the current.
    """
    index = np.flatnonzero(state.active == Active.DATA)
    loss, torque, voltage, circle = (_taken(term, index) for term in terms)
    d, q = state.i_d[index], state.i_q[index]
    reached = state.reached[index]
    sense = np.where(reached, -1.0, np.where(state.least[index], -1.0, 1.0))
    goal_d, goal_q = (
        sense * np.where(reached, loss.d, torque.d),
        sense * np.where(reached, loss.q, torque.q),
    )
    size = np.maximum(np.hypot(goal_d, goal_q), 1e-300)
    slack = _ON_A_LIMIT * problem.i_max
    normals = [
        (
            normal_d + 0.0 * d,
            normal_q + 0.0 * d,
            np.abs(normal_d * d + normal_q * q - offset) <= slack,
        )
        for normal_d, normal_q, offset in zip(
            region.normal_d, region.normal_q, region.offset, strict=True
        )
    ]
    for term, limit in ((voltage, problem.v_max[index] ** 2), (circle, problem.i_max**2)):
        normals.append(
            (
                term.d / _norm(term),
                term.q / _norm(term),
                np.abs(term.value / limit - 1.0) <= _ON_A_LIMIT,
            )
        )
    unit = _norm(torque)
    along = [(sign * torque.d / unit, sign * torque.q / unit, reached) for sign in (1.0, -1.0)]
    left = _outside_cone(goal_d / size, goal_q / size, [*normals, *along])
    residual[index] = np.maximum(residual[index], left)
    return residual


def _taken(terms: Terms, index: IndexArray) -> Terms:
    return Terms(*(getattr(terms, name)[index] for name in ("value", "d", "q", "dd", "dq", "qq")))


def _outside_cone(
    goal_d: FloatArray, goal_q: FloatArray, normals: list[tuple[FloatArray, FloatArray, BoolArray]]
) -> FloatArray:
    """Distance of unit vectors from the cone of those of the given unit vectors that count,
    shape (N,).
    """
    left = np.ones_like(goal_d)
    held = [normal for normal in normals if np.any(normal[2])]
    for place, (first_d, first_q, first) in enumerate(held):
        share = np.maximum(goal_d * first_d + goal_q * first_q, 0.0)
        apart = np.hypot(goal_d - share * first_d, goal_q - share * first_q)
        left = np.where(first, np.minimum(left, apart), left)
        for second_d, second_q, second in held[place + 1 :]:
            with np.errstate(divide="ignore", invalid="ignore"):
                scale = 1.0 / (first_d * second_q - first_q * second_d)
                a, b = (
                    (goal_d * second_q - goal_q * second_d) * scale,
                    (first_d * goal_q - first_q * goal_d) * scale,
                )
                between = first & second & (a >= 0.0) & (b >= 0.0) & np.isfinite(scale)
            left = np.where(between, 0.0, left)
    return left


# Total loss of a drive: as coefficients that the batched solver minimises,
# and as a budget at given currents.
#
# The solver needs the loss as P = a |i|^2 + b |i| + c |psi|^2 with coefficients that depend on the
# speed alone. Copper, iron, the channels of MOSFETs and the switching loss of continuous modulators
# have exactly this form; what an IGBT bridge and discontinuous modulators add to it is said at
# `loss_coefficients`.

_MEAN_OF_RECTIFIED_SINE = 2.0 / math.pi


@dataclass(frozen=True, slots=True)
class DriveLosses:
    """Losses of machine and inverter in W at operating points, arrays of one shape.

    ``iron`` holds the magnets, too, where a loss map has them.

    Without device data ``conduction`` and ``switching`` are zero and ``with_inverter`` is False.
    Where the junction runs away ``conduction``, ``junction_temperature`` (degC) and ``total`` are
    NaN.
    """

    copper: FloatArray
    iron: FloatArray
    conduction: FloatArray
    switching: FloatArray
    junction_temperature: FloatArray
    total: FloatArray
    with_inverter: bool


def loss_coefficients(
    machine: Machine,
    omega_m: ArrayLike,
    inverter: Inverter | None = None,
    *,
    extra: MachineLoss = NO_EXTRA_LOSS,
    modulation: ModulationName = "svpwm",
    junction_temperature: float = REFERENCE_TEMPERATURE,
) -> LossCoefficients:
    """Total loss of the drive as the batched solver minimises it.

    ::

        square  3/2 R (1 + k_ac omega_e^2)  +  3/2 R_on (MOSFET)  or  3/4 (r_CE + r_F) (IGBT)
        linear  6/pi f_sw (E_on + E_off + E_rr) v_dc / (I_ref V_ref)  +  3/pi (V_CE0 + V_F0) (IGBT)
        iron    k_h |omega_e| + k_c omega_e^2, or 0 beside the loss map of the machine

    Args:
        machine: Any machine.
        omega_m: Mechanical speed in rad/s of each point, shape (N,) or broadcastable to the points
            that are solved.
        inverter: None, or an inverter without device, leaves the inverter out.
        extra: AC copper and iron loss, or a loss map of iron and magnets.
        modulation: The modulator; only its share of switched current matters.
        junction_temperature: In degC, at which the on resistance of the transistors is taken.

    Returns:
        Arrays of the shape of ``omega_m``.

    Notes:
        Exact for MOSFETs with continuous modulators, and for IGBTs whose diode has the transistor's
        parameters. Transistor and diode of an IGBT bridge share the current evenly here; what the
        duty cycle shifts between them is in truth 3/2 |v| |i| cos(phi) (V_CE0 - V_F0) / v_dc, and
        likewise for the resistances. GDPWM and DDT-GDPWM switch half of the rectified current where
        the load angle is within 30 degrees of 0 or 180, and more beyond. The other discontinuous
        modulators count with two thirds, the mean over all load angles; in truth their share
        depends on the load angle (`dqforge.machines.modulation.registry.switching_loss_factor`).
    """
    omega_e = machine.pole_pairs * np.asarray(omega_m, dtype=np.float64)
    square = 1.5 * machine.r_s * extra.copper_factor(omega_e)
    linear = np.zeros_like(omega_e)
    if inverter is not None and inverter.device is not None:
        on, threshold = _conduction(inverter, junction_temperature)
        square = square + on
        linear = linear + threshold + _switching(inverter, modulation)
    if extra.mapped is None:
        return LossCoefficients(
            np.asarray(square), np.asarray(linear), np.asarray(extra.iron_factor(omega_e))
        )
    iron = np.zeros_like(omega_e)
    return LossCoefficients(np.asarray(square), np.asarray(linear), iron, omega_e, extra.mapped)


def _conduction(inverter: Inverter, junction_temperature: float) -> tuple[float, float]:
    """Conduction loss over |i|^2 in W/A^2 and over |i| in W/A."""
    device = required_device(inverter)
    channel = device.on_resistance * float(
        resistance_factor(device, np.asarray(junction_temperature))
    )
    if device.kind == "mosfet":
        return 1.5 * channel, 0.0
    threshold = 0.5 * (device.on_voltage + device.diode_voltage)
    return 0.75 * (channel + device.diode_resistance), 3.0 * _MEAN_OF_RECTIFIED_SINE * threshold


def _switching(inverter: Inverter, modulation: ModulationName) -> float:
    """Switching loss over |i| in W/A."""
    device = required_device(inverter)
    energy = (
        device.switching_energy
        / (device.reference_current * device.reference_voltage)
        * inverter.v_dc
    )
    return (
        3.0
        * inverter.f_sw
        * energy
        * _MEAN_OF_RECTIFIED_SINE
        * MODULATORS[modulation].mean_loss_factor
    )


def drive_losses(
    machine: Machine,
    inverter: Inverter,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_m: FloatArray,
    *,
    modulation: ModulationName = "svpwm",
    extra: MachineLoss = NO_EXTRA_LOSS,
) -> DriveLosses:
    """Losses at operating points of any machine, the junction temperature in balance.

    Args:
        machine, inverter: The drive.
        i_d, i_q, omega_m: Currents in A (peak) and mechanical speed in rad/s, arrays of one shape.
        modulation: The modulator.
        extra: AC copper and iron loss of the machine.

    Notes:
        Beyond the modulator's linear range the conduction loss of an IGBT bridge is NaN: it has no
        meaning there.
    """
    omega_e = machine.pole_pairs * omega_m
    psi_d, psi_q = machine.flux(i_d, i_q)
    copper = copper_loss(machine.r_s, i_d, i_q) * extra.copper_factor(omega_e)
    iron, in_magnets = extra.core_losses(i_d, i_q, psi_d * psi_d + psi_q * psi_q, omega_e)
    iron = iron + in_magnets
    if inverter.device is None:
        zero, unknown = np.zeros_like(copper), np.full_like(copper, np.nan)
        return DriveLosses(copper, iron, zero, zero, unknown, copper + iron, with_inverter=False)
    v_d, v_q = machine.r_s * i_d - omega_e * psi_q, machine.r_s * i_q + omega_e * psi_d
    bridge = thermal_balance(inverter, bridge_load(inverter, modulation, v_d, v_q, i_d, i_q))
    known = amplitude_fits(inverter, modulation, np.hypot(v_d, v_q) * (1.0 - 1e-9))
    known |= inverter.device.kind == "mosfet"
    conduction = np.where(known, bridge.conduction, np.nan)
    total = copper + iron + conduction + bridge.switching
    return DriveLosses(
        copper,
        iron,
        conduction,
        bridge.switching,
        bridge.junction_temperature,
        total,
        with_inverter=True,
    )


# Second look at the rare points whose optimum the batched solver missed:
# a scan of their torque curves, then Newton.
#
# Measured flux maps are bumpy: a torque curve may have two valleys of the loss, of which one breaks
# the voltage limit and the other keeps it. The scan finds the best part of the whole curve within
# the limits.

WORST = 1e-8  # Residual of a reached point from which on it is looked at again.
_ANGLES, _RADII = 361, 181
_TOGETHER = 16
_STEPS = 20


def missed_points(state: State, residuals: FloatArray) -> IndexArray:
    """Points that were reached but are no optimum.

    Args:
        state: Currents of the points and whether they were reached.
        residuals: Largest relative violation of the conditions, shape (N,).
    """
    return np.flatnonzero(state.reached & ~(residuals <= WORST))


def replace_missed_points(
    problem: Problem, state: State, index: IndexArray, residuals: FloatArray
) -> None:
    """Replace points by better ones where the scan and Newton's method find any.

    ``state`` is changed in place.

    Args:
        problem: Machine, torques and limits of N points.
        state: Their currents and multipliers.
        index: The points to replace.
        residuals: Largest relative violation of the conditions, shape (N,).
    """
    for first in range(0, index.size, _TOGETHER):
        part = index[first : first + _TOGETHER]
        here = problem.take(part)
        start_d, start_q, found = _best_on_curve(here)
        best = residuals[part]
        for code in (Active.NONE, Active.VOLTAGE):
            i_d, i_q = _polished(here, start_d, start_q, code)
            trial = State(
                i_d,
                i_q,
                here.torque.copy(),
                np.full(part.size, code, dtype=np.int8),
                np.ones(part.size, dtype=np.bool_),
                np.zeros(part.size, dtype=np.bool_),
            )
            left, _, _, _ = residual(here, trial)
            better = found & (left < best)
            chosen = part[better]
            state.i_d[chosen], state.i_q[chosen], state.active[chosen] = (
                i_d[better],
                i_q[better],
                code,
            )
            best = np.where(better, left, best)


def _best_on_curve(problem: Problem) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Point of least loss within all limits among rays that meet the torque curve,
    and whether there is one, (N,).
    """
    angle = np.linspace(0.0, np.pi, _ANGLES)[:, np.newaxis]
    radius = np.linspace(0.0, problem.i_max, _RADII)
    i_d, i_q = radius * np.cos(angle), radius * np.sin(angle)
    machine = problem.machine
    psi_d, psi_q = machine.flux(i_d, i_q)
    torque = torque_from_flux(machine.pole_pairs, psi_d, psi_q, i_d, i_q)
    above = torque[np.newaxis] >= problem.torque[:, np.newaxis, np.newaxis]
    after = np.maximum(np.argmax(above, axis=2), 1)
    rays = np.arange(_ANGLES)
    low, high = torque[rays, after - 1], torque[rays, after]
    share = (problem.torque[:, np.newaxis] - low) / np.where(high > low, high - low, 1.0)
    length = radius[after - 1] + np.clip(share, 0.0, 1.0) * radius[1]
    on_d, on_q = length * np.cos(angle[:, 0]), length * np.sin(angle[:, 0])
    psi_d, psi_q = machine.flux(on_d, on_q)
    omega = problem.omega_e[:, np.newaxis]
    volts = np.hypot(machine.r_s * on_d - omega * psi_q, machine.r_s * on_q + omega * psi_d)
    loss = problem.loss
    lost = loss.square[:, np.newaxis] * length**2 + loss.linear[:, np.newaxis] * length
    lost += loss.iron[:, np.newaxis] * (psi_d**2 + psi_q**2)
    if loss.mapped is not None:
        iron, magnet = loss.mapped.losses(on_d, on_q, np.asarray(loss.omega_e)[:, np.newaxis])
        lost += iron + magnet
    # The grid's own error must not exclude the point that touches the limit.
    kept = above.any(axis=2) & (volts <= problem.v_max[:, np.newaxis] * (1.0 + 1e-3))
    lost = np.where(kept, lost, np.inf)
    best, rows = np.argmin(lost, axis=1), np.arange(problem.torque.size)
    return on_d[rows, best], on_q[rows, best], np.isfinite(lost[rows, best])


def _polished(
    problem: Problem, i_d: FloatArray, i_q: FloatArray, code: Active
) -> tuple[FloatArray, FloatArray]:
    """Newton's method on the torque and the valley of the loss, or on the
    torque and the voltage limit.
    """
    i_d, i_q = i_d.copy(), i_q.copy()
    for _ in range(_STEPS):
        jet = problem.machine.jet(i_d, i_q)
        torque = torque_terms(problem.machine, jet, i_d, i_q)
        if code == Active.NONE:
            other = cross_of_gradients(
                loss_terms(problem.loss, jet, i_d, i_q, problem.soft), torque
            )
            step_d, step_q = newton_step(torque, other, problem.torque, 0.0)
        else:
            other = voltage_terms(problem.machine, jet, i_d, i_q, problem.omega_e)
            step_d, step_q = newton_step(torque, other, problem.torque, problem.v_max**2)
        size = np.hypot(step_d, step_q)
        finite = np.isfinite(size)
        damping = np.where(
            finite, np.minimum(1.0, 0.1 * problem.i_max / np.maximum(size, 1e-300)), 0.0
        )
        i_d = i_d + np.where(finite, damping * step_d, 0.0)
        i_q = i_q + np.where(finite, damping * step_q, 0.0)
    return i_d, i_q
