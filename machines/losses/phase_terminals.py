"""Losses of a phase machine as its terminals see them: any phase currents, any way of feeding.

The equivalent circuit is that of `machine_budget`, with waveforms in place of phasors: copper and
magnet loss as resistances in series, iron loss as a conductance beside the induced voltage. The
currents given make the torque; the iron's current comes on top, without zero sequence where the
topology carries none.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.losses.bridge_tables import BridgeTables, CurrentTable, junction_losses
from dqforge.machines.losses.machine_budget import (
    NO_EXTRA_LOSS,
    MachineLoss,
    WindingHeat,
    warm_ratio,
)
from dqforge.machines.modulation.modulators import Modulation, PhaseWaveforms, modulate
from dqforge.machines.modulation.ripple import flux_moments
from dqforge.machines.names import ModulationName, OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
    between,
    derivative,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, duty_cycles, leg_signs

_STANDSTILL = 1e-9  # Electrical speed in rad/s below which the iron loses nothing.


@dataclass(frozen=True, slots=True)
class PhaseTerminals:
    """A machine at K points over an electrical period of N angles; arrays (K,) unless said.

    Args:
        torque, shaft_power: Mean torque in N m and its power in W.
        copper, iron, magnet: Losses in W; copper at the winding temperature, without the ripple of
            switching.
        neutral: Loss in W of the neutral's conductor.
        resistance: Resistance of a phase in Ohm that makes the copper loss.
        winding_temperature: In degC, NaN without data of the winding's heat or where it is not
            steady.
        steady: False where the winding temperature runs away.
        currents, voltages: Of the phases at the terminals in A and V, shape (K, 3, N).
        between: Voltages in V half a step behind each angle, shape (K, 3, N), where corners show:
            what the link must reach.
    """

    torque: FloatArray
    shaft_power: FloatArray
    copper: FloatArray
    iron: FloatArray
    magnet: FloatArray
    neutral: FloatArray
    resistance: FloatArray
    winding_temperature: FloatArray
    steady: BoolArray
    currents: FloatArray
    voltages: FloatArray
    between: FloatArray


def allowed_currents(topology: Topology, open_phase: OpenPhase | None = None) -> FloatArray:
    """Orthonormal basis (3, m) of the phase currents that can flow.

    Args:
        topology: Without a neutral the phase currents add to zero.
        open_phase: A phase that carries none.
    """
    barred = [] if TOPOLOGIES[topology].neutral else [np.ones(3)]
    if open_phase is not None:
        barred.append(np.eye(3)["abc".index(open_phase)])
    if not barred:
        return np.eye(3)
    _, size, turned = np.linalg.svd(np.array(barred))
    return np.asarray(turned[int(np.sum(size > 1e-9)) :].T)


def inductance_over_angle(machine: AnyPhaseMachine) -> FloatArray:
    """Inductance matrices of the phases in H, shape (N, 3, 3).

    Args:
        machine: With or without saliency.
    """
    if isinstance(machine, SalientPhaseMachine):
        return machine.inductance
    return np.broadcast_to(machine.inductances, (machine.angles, 3, 3))


def phase_terminals(
    machine: AnyPhaseMachine,
    currents: FloatArray,
    omega_m: FloatArray,
    topology: Topology,
    *,
    loss: MachineLoss = NO_EXTRA_LOSS,
    heat: WindingHeat | None = None,
    open_phase: OpenPhase | None = None,
    neutral_resistance: float = 0.0,
    neutral_inductance: float = 0.0,
) -> PhaseTerminals:
    """Losses and terminal waveforms in the steady state.

    ::

        e   = omega_e (d(L i)/dtheta + f)               induced, with 3 L_n on the zero sequence
        i_t = i + g P e,  g = 2/3 k_iron / omega_e^2    P leaves what the topology can carry
        v   = (R + 2/3 k_m omega_e^2) i_t + e + R_n sum(i_t)

    Derivatives are central differences on the angles, which are antisymmetric: with constant
    inductances the power at the terminals is that of the losses and the shaft to rounding.

    Args:
        machine: The machine in phase quantities.
        currents: Phase currents in A that make the torque, shape (K, 3, N).
        omega_m: Mechanical speeds in rad/s, shape (K,).
        topology, open_phase: How the phases are fed.
        loss, heat: AC copper, iron and magnet loss; how warm the winding becomes, None keeps its
            resistance.
        neutral_resistance, neutral_inductance: Of the neutral's conductor and choke in Ohm and H.
    """
    omega = machine.pole_pairs * np.asarray(omega_m, dtype=np.float64)
    linked = np.einsum("jkl,...lj->...kj", inductance_over_angle(machine), currents)
    linked = linked + neutral_inductance * np.sum(currents, axis=-2, keepdims=True)
    induced = omega[:, None, None] * (derivative(linked, machine.turns) + machine.flux)
    basis = allowed_currents(topology, open_phase)
    part = np.einsum("kl,...lj->...kj", basis @ basis.T, induced)
    still = np.abs(omega) < _STANDSTILL
    turning = np.where(still, 1.0, omega)
    conductance = np.where(still, 0.0, loss.iron_factor(turning) / (1.5 * turning * turning))
    terminal = currents + conductance[:, None, None] * part
    size = _mean_square(terminal)
    extra = loss.ac_copper * omega * omega
    ratio, steady = np.ones(omega.shape), np.ones(omega.shape, dtype=np.bool_)
    temperature = np.full(omega.shape, np.nan)
    if heat is not None:
        ratio, steady = warm_ratio(heat, machine.r_s * size, extra)
        warmth = machine.r_s * size * (ratio + extra / ratio)
        temperature = heat.coolant_temperature + heat.thermal_resistance * warmth
    resistance = machine.r_s * (ratio + extra / ratio)
    series = resistance + loss.magnet * omega * omega / 1.5
    through = np.sum(terminal, axis=-2, keepdims=True)
    torque = np.mean(machine.torque(currents), axis=-1)
    value, slope = between(terminal, machine.turns)
    sums = (np.sum(part, axis=-2, keepdims=True) for part in (value, slope))
    drop = (series - machine.r_s)[:, None, None] * value
    drop = drop + neutral_resistance * next(sums)
    drop = drop + neutral_inductance * omega[:, None, None] * next(sums)
    return PhaseTerminals(
        torque=torque,
        shaft_power=torque * omega_m,
        copper=resistance * size,
        iron=conductance * _mean_square(part),
        magnet=loss.magnet * omega * omega * size / 1.5,
        neutral=neutral_resistance * _mean_square(through),
        resistance=resistance,
        winding_temperature=temperature,
        steady=steady,
        currents=terminal,
        voltages=series[:, None, None] * terminal + induced + neutral_resistance * through,
        between=machine.voltage(terminal, omega) + drop,
    )


def _mean_square(waveform: FloatArray) -> FloatArray:
    """Mean over the angles of the sum of squares of the rows, (K, n, N) to (K,)."""
    return np.asarray(np.mean(np.sum(waveform**2, axis=-2), axis=-1))


# Losses of every half bridge of any topology, from the waveforms of a period.
#
# A half bridge (leg) sees its own duty cycle and its own current; that of the neutral carries the
# sum of the phases, the second legs of six carry the phase currents backwards. Where the phases end
# on two legs each, or on a neutral leg, the rule is the same: leg currents are the transpose of
# what makes phase voltages of leg voltages, so that the power of the legs is that of the phases.
#
# The ripple that the legs themselves make is seen by what conducts as a current that lies its root
# mean square above and below the sampled one for half of the time each, with all signs that follow:
# exact for resistances, and it keeps what crosses zero (the legs of a split link at light load).
# What switches sees the current of the very edge: a leg that rises does so near the valley of its
# current.


@dataclass(frozen=True, slots=True)
class LegWaveforms:
    """Half bridges at K points over N angles.

    Args:
        duty, current: Duty cycles of the upper switches and currents out of the legs in A, shape
            (K, legs, N).
        clamped: True where a leg does not switch, shape (K, legs, N).
        ripple: Covariance of the ripple of the phase currents in A^2 for v_dc / f_sw = 1 V s, shape
            (K, N, 3, 3).
        rising: Ripple of each leg's current in A at its rising edge, for v_dc / f_sw = 1 V s, shape
            (K, legs, N); at the falling one it has the other sign.
        harmonic_voltage: Mean square of the switched voltage vector beside its mean, over v_dc^2,
            shape (K,); the vector is amplitude-invariant and has no zero sequence.
    """

    duty: FloatArray
    current: FloatArray
    clamped: BoolArray
    ripple: FloatArray
    rising: FloatArray
    harmonic_voltage: FloatArray


@dataclass(frozen=True, slots=True)
class LegAverages:
    """Averages over a period of each leg, arrays (2, J, T, K, legs) as in `BridgeAverages`.

    Args:
        conduction, switching, dead: As in `BridgeAverages`, but of each leg of its own.
        switched: Mean magnitude of the leg's current in A while it switches, shape (K, legs).
        link_current: Mean in A of what flows from the link, both links of isolated ones together,
            shape (K,).
        capacitor_square: Mean square in A^2 of what its capacitors carry, shape (K,); of a split
            link both halves together, for their resistances in series.
    """

    conduction: FloatArray
    switching: FloatArray
    dead: FloatArray
    switched: FloatArray
    link_current: FloatArray
    capacitor_square: FloatArray


def links_of_legs(topology: Topology) -> tuple[slice, ...]:
    """Legs of each dc link.

    Args:
        topology: How the phases are fed.
    """
    if topology == "six-leg-isolated":
        return slice(0, 3), slice(3, 6)
    return (slice(0, len(TOPOLOGIES[topology].legs)),)


def _star_duties(
    voltage: FloatArray, current: FloatArray, v_dc: float, name: ModulationName
) -> tuple[FloatArray, BoolArray]:
    """Duty cycles (K, 3, N) of three legs by a modulator, and what it clamps."""
    balanced = voltage - np.mean(voltage, axis=-2, keepdims=True)
    made = modulate(name, np.moveaxis(balanced, -2, -1), np.moveaxis(current, -2, -1), v_dc)
    return np.moveaxis(made.duty, -1, -2), np.moveaxis(made.clamped, -1, -2)


def leg_waveforms(
    topology: Topology,
    voltage: FloatArray,
    current: FloatArray,
    v_dc: float,
    inductance: FloatArray,
    *,
    modulation: ModulationName = "svpwm",
    open_phase: OpenPhase | None = None,
) -> LegWaveforms:
    """Duty cycles, currents and ripple of the legs.

    Args:
        topology: How the phases are fed.
        voltage, current: Of the phases in V and A, shape (K, 3, N).
        v_dc: Link voltage in V (of each of two isolated links).
        inductance: Matrices of the phases in H, with a choke in the neutral, shape (N, 3, 3).
        modulation: Modulator of three legs without neutral; the other topologies have their own.
        open_phase: A phase that is not connected; its legs rest.
    """
    matrix = leg_signs(topology)
    lost = None if open_phase is None else "abc".index(open_phase)
    if lost is not None:
        voltage = voltage.copy()
        voltage[:, lost] = 0.0
    if TOPOLOGIES[topology].modulated:
        duty, clamped = _star_duties(voltage, current, v_dc, modulation)
    else:
        duty = np.swapaxes(duty_cycles(topology, np.swapaxes(voltage, -1, -2), v_dc), -1, -2)
        clamped = np.zeros(duty.shape, dtype=np.bool_)
    duty = np.clip(duty, 0.0, 1.0)
    if lost is not None:
        for leg in (lost, lost + 3)[: 1 + (matrix.shape[1] == 6)]:
            duty[:, leg], clamped[:, leg] = 0.0, True
    basis = allowed_currents(topology, open_phase)
    inner = np.linalg.inv(basis.T @ inductance @ basis)
    through = basis @ inner @ basis.T @ matrix
    by_angle = np.swapaxes(duty, -1, -2)
    moments = flux_moments(by_angle)
    plane = (np.eye(3) - 1.0 / 3.0) @ matrix
    both = np.minimum(by_angle[..., :, None], by_angle[..., None, :])
    rest = both - by_angle[..., :, None] * by_angle[..., None, :]
    return LegWaveforms(
        duty=duty,
        current=np.einsum("kl,...kj->...lj", matrix, current),
        clamped=clamped,
        ripple=through @ moments @ np.swapaxes(through, -1, -2),
        rising=_rising_ripple(matrix, through, by_angle),
        harmonic_voltage=2.0
        / 3.0
        * np.mean(np.einsum("kl,...lm,km->...", plane, rest, plane, optimize=True), axis=-1),
    )


def _rising_ripple(matrix: FloatArray, through: FloatArray, duty: FloatArray) -> FloatArray:
    """Ripple of the legs' currents at their rising edges, shape (K, legs, N); see `flux_moments`.

    ``matrix`` (3, legs), ``through`` (N, 3, legs) from leg flux to phase current, ``duty`` (K, N,
    legs).
    """
    off = 1.0 - duty
    low = np.minimum(off[..., :, None], off[..., None, :])
    high = np.maximum(off[..., :, None], off[..., None, :])
    flux = -0.5 * low * (1.0 - high)  # of the leg along the last axis, at the edge of the other
    own = np.swapaxes(matrix.T @ through, -1, -2)
    return np.asarray(np.einsum("...nlj,njl->...ln", flux, own, optimize=True))


def leg_ripple(topology: Topology, wave: LegWaveforms) -> FloatArray:
    """Mean square of the ripple of each leg's current in A^2 for v_dc / f_sw = 1 V s,
    shape (K, legs, N).

    Args:
        topology: How the phases are fed.
        wave: Waveforms of the legs.
    """
    matrix = leg_signs(topology)
    return np.asarray(np.einsum("kl,...jkm,ml->...lj", matrix, wave.ripple, matrix, optimize=True))


def leg_averages(
    tables: BridgeTables, topology: Topology, wave: LegWaveforms, flux: float = 0.0
) -> LegAverages:
    """Averages of the losses of each leg, and of the current from the link.

    Args:
        tables: The device, T temperatures.
        topology: How the phases are fed.
        wave: Waveforms of K points.
        flux: v_dc / f_sw in V s, of the ripple that the devices see; 0 leaves it out.
    """
    points, legs, _ = wave.current.shape
    away = flux * np.sqrt(np.maximum(leg_ripple(topology, wave), 0.0))
    sides = (away, -away) if flux > 0.0 else (away,)
    found = np.mean([_of_legs(tables, wave, wave.current + side) for side in sides], axis=0)
    found[1] = _edge_energies(tables, wave, flux * wave.rising)
    if not tables.separate_diode:
        found = np.sum(found, axis=2, keepdims=True)
    losses = found.reshape(*found.shape[:-1], points, legs)
    link = [_link(topology, wave, part) for part in links_of_legs(topology)]
    switched = np.mean(np.where(wave.clamped, 0.0, np.abs(wave.current)), axis=-1)
    mean = sum((one[0] for one in link), np.zeros(points))
    square = sum((np.maximum(one[1] - one[0] ** 2, 0.0) for one in link), np.zeros(points))
    return LegAverages(losses[0], losses[1], losses[2], switched, mean, square)


def _of_legs(tables: BridgeTables, wave: LegWaveforms, current: FloatArray) -> FloatArray:
    """Rows of `junction_losses` with each leg as a point of one half bridge."""
    angles = current.shape[-1]

    def flat(values: FloatArray) -> FloatArray:
        return values.reshape(-1, angles, 1)

    rows = current.shape[0] * current.shape[1]
    one = PhaseWaveforms(
        theta_e=np.zeros((rows, angles)),
        weight=np.full((rows, angles), 1.0 / angles),
        voltage=np.zeros((rows, angles, 1)),
        current=flat(current),
        modulation=Modulation(
            np.zeros((rows, angles)), flat(wave.duty), wave.clamped.reshape(-1, angles, 1)
        ),
    )
    return junction_losses(tables, one, one_rail=True)


def _edge_energies(tables: BridgeTables, wave: LegWaveforms, rising: FloatArray) -> FloatArray:
    """Energies in J of a carrier period in transistor and diode of upper and lower position,
    shape (2, 2, T, rows): a row for each leg of each point.
    """
    angles = wave.current.shape[-1]
    moving = np.where(wave.clamped, 0.0, 1.0).reshape(-1, angles)
    up, down = ((wave.current + side).reshape(-1, angles) for side in (rising, -rising))

    def mean(table: CurrentTable, current: FloatArray, sign: float) -> FloatArray:
        taken = np.where(current >= 0.0 if sign > 0.0 else current < 0.0, moving, 0.0)
        return np.asarray(np.mean(taken * table.at(np.abs(current)), axis=-1))

    on, off, back = tables.turn_on, tables.turn_off, tables.recovery
    upper = mean(on, up, 1.0) + mean(off, down, 1.0), mean(back, down, -1.0)
    lower = mean(off, up, -1.0) + mean(on, down, -1.0), mean(back, up, 1.0)
    return np.stack([np.stack(upper), np.stack(lower)])


def _link(topology: Topology, wave: LegWaveforms, part: slice) -> tuple[FloatArray, FloatArray]:
    """Mean and mean square of the current that a link gives its legs.

    Through the capacitors of a split link flow what both halves have in common, the mean of what
    leaves the upper and what returns to the lower rail, and half of the neutral current each.
    """
    duty, current = wave.duty[:, part], wave.current[:, part]
    offset = 0.5 if TOPOLOGIES[topology].midpoint else 0.0
    mean = np.mean(np.sum(duty * current, axis=1), axis=-1)
    total = np.sum(current, axis=1)
    both = np.zeros_like(total)
    for j in range(current.shape[1]):
        for k in range(current.shape[1]):
            both += np.minimum(duty[:, j], duty[:, k]) * current[:, j] * current[:, k]
    on = np.sum(duty * current, axis=1)
    square = np.mean(both - 2.0 * offset * on * total + offset**2 * total**2, axis=-1)
    halves = 0.25 * np.mean(total**2, axis=-1) if offset else 0.0
    return mean - offset * np.mean(total, axis=-1), square + halves


# Iron loss that the switching of the bridge makes in the machine.
#
# The eddy-current term of the iron loss goes with the square of the rate at which the flux linkage
# changes, and that is the voltage: k_c omega_e^2 |psi|^2 = k_c |d psi/dt|^2. What the bridge
# switches beside the fundamental therefore adds k_c times the mean square of the harmonic voltage,
# and no inductance comes into it. Of a bridge with centred pulses an active vector of 2/3 v_dc
# stands for the share u_max - u_min of the carrier period, whatever the zero sequence:
#
#     < |v|^2 > = 4/9 v_dc^2 < u_max - u_min >,   < u_max - u_min > = 3 sqrt 3 / pi V / v_dc
#
# Sources: G. Bertotti, "General properties of power losses in soft ferromagnetic materials", IEEE
# Transactions on Magnetics 24(1), 1988, doi:10.1109/20.43994 (classical term); A. Boglietti, A.
# Cavagnino, M. Lazzari, M. Pastorelli, "Predicting iron losses in soft magnetic materials with
# arbitrary voltage supply: an engineering approach", IEEE Transactions on Magnetics 39(2), 2003
# (eddy-current loss by the square of the r.m.s. voltage; both quoted without the papers at hand).

# Where the series of the skin effect takes the place of its formula, whose terms cancel there.
_THIN = 0.3


_THICK = 50.0


def harmonic_voltage_square(amplitude: ArrayLike, v_dc: FloatArray | float) -> FloatArray:
    """Mean square of the harmonic voltage vector in V^2, shape (...): 4/(sqrt 3 pi) V v_dc - V^2.

    Args:
        amplitude: Fundamental phase voltage V in V (peak), any shape (...), within the linear
            range; the vector is amplitude-invariant.
        v_dc: DC-link voltage in V, a number or of a shape that fits.
    """
    volts = np.asarray(amplitude, dtype=np.float64)
    return np.asarray(
        np.maximum(4.0 / (math.sqrt(3.0) * math.pi) * volts * v_dc - volts * volts, 0.0)
    )


def sheet_factor(frequency: ArrayLike, corner: float) -> FloatArray:
    """Eddy-current loss of a sheet over that without skin effect, at frequencies
    in Hz of any shape (...).

    ::

        F = 3/x (sinh x - sin x) / (cosh x - cos x),   x = sqrt(f / corner)

    Args:
        frequency: In Hz, not negative.
        corner: Frequency in Hz at which the skin depth equals the thickness d of the sheet: rho /
            (pi mu d^2), some 1 kHz for sheets of 0.35 mm.
    """
    x = np.sqrt(np.asarray(frequency, dtype=np.float64) / corner)
    between = np.clip(x, _THIN, _THICK)
    exact = (
        3.0 / between * (np.sinh(between) - np.sin(between)) / (np.cosh(between) - np.cos(between))
    )
    return np.asarray(
        np.where(
            x < _THIN, 1.0 - x**4 / 630.0, np.where(x > _THICK, 3.0 / np.maximum(x, 1.0), exact)
        )
    )


def ripple_iron_loss(
    eddy: float,
    amplitude: ArrayLike,
    v_dc: FloatArray | float,
    f_sw: ArrayLike,
    corner: float | None = None,
) -> FloatArray:
    """Iron loss in W by the switching, shape (...): k_c < |v_h|^2 > F(f_sw).

    Args:
        eddy: k_c in W s^2/(rad^2 Wb^2), as in `MachineLoss`.
        amplitude, v_dc: Fundamental phase voltage in V (peak) and DC-link voltage in V.
        f_sw: Carrier frequency in Hz, broadcastable with the amplitude; it matters by the skin
            effect alone.
        corner: As in `sheet_factor`; None leaves the skin effect out, which overestimates at high
            carrier frequencies.
    """
    loss = eddy * harmonic_voltage_square(amplitude, v_dc)
    return np.asarray(
        loss * (np.ones(np.shape(f_sw)) if corner is None else sheet_factor(f_sw, corner))
    )
