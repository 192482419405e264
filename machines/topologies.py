"""The topologies of paper 002, chapter 5: their legs, what becomes of the zero sequence, which
voltages their link makes and how far the modulator goes, the duties that make them, the current
of the neutral and its copper, and the frames of currents that they permit.

A phase voltage is that of the phase's leg less what its other end is tied to: the mean of the legs
(no neutral), the neutral's leg, the phase's second leg, or the midpoint of the link. All else in
this room, and every limit of voltage elsewhere, follows from these records.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.modulation.modulators import in_linear_range
from dqforge.machines.modulation.registry import (
    INSCRIBED,
    MODULATORS,
    SIX_STEP,
    extremes,
    follows_hexagon,
)
from dqforge.machines.modulation.ripple import flux_moments
from dqforge.machines.names import CurrentFrame, ModulationName, OvermodulationName, Topology
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Floats, N, Numbers, Triple, clarke_matrix


@dataclass(frozen=True, slots=True)
class TopologyRule:
    """How the phases are fed.

    Args:
        legs: Names of the half bridges, in the order of their duty cycles; ``a2`` is the second one
            of phase a.
        neutral: Whether the legs drive a zero-sequence current.
        phase, between: Largest phase voltage, and largest difference between two, over the voltage
            of the link; None where the other one is all that limits them.
        midpoint: Whether the neutral lies on the midpoint of the link, whose voltage moves with its
            current; ``phase`` is then that of a link in halves.
        diodes: Whether the neutral hangs on two diodes to the rails, which conduct but are not
            switched.
    """

    legs: tuple[str, ...]
    neutral: bool
    phase: float | None = None
    between: float | None = None
    midpoint: bool = False
    diodes: bool = False

    @property
    def modulated(self) -> bool:
        """Whether the design's modulator makes the duty cycles: three legs that share nothing with
        the neutral, so that what is common to them is free.
        """
        return len(self.legs) == 3 and not self.midpoint


TOPOLOGIES: dict[Topology, TopologyRule] = {
    "three-wire": TopologyRule(("a", "b", "c"), neutral=False, between=1.0),
    "four-leg": TopologyRule(("a", "b", "c", "n"), neutral=True, phase=1.0, between=1.0),
    "split-capacitor": TopologyRule(("a", "b", "c"), neutral=True, phase=0.5, midpoint=True),
    # A current flows through the diodes only where a voltage of the machine forces it.
    "diode-neutral": TopologyRule(("a", "b", "c"), neutral=False, between=1.0, diodes=True),
    "six-leg": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=True, phase=1.0),
    # Two links of the same voltage, one behind the other.
    "six-leg-isolated": TopologyRule(("a", "b", "c", "a2", "b2", "c2"), neutral=False, between=2.0),
}


def leg_signs(topology: Topology) -> FloatArray:
    """How the legs add up to the phase voltages, shape (3, legs): 1 for the phase's own leg, -1 for
    that on its other end.

    Args:
        topology: The topology. Without a neutral only the differences of the rows act.
    """
    legs = TOPOLOGIES[topology].legs
    signs = np.zeros((3, len(legs)))
    for row, phase in enumerate("abc"):
        for column, leg in enumerate(legs):
            signs[row, column] = {phase: 1.0, phase + "2": -1.0, "n": -1.0}.get(leg, 0.0)
    return signs


# Which phase voltages a topology makes without overmodulation, as linear inequalities.
#
# ::
#
#     three-wire, diode-neutral   v_j - v_k <= V_dc
#     four-leg                    max - min of {v_a, v_b, v_c, 0} <= V_dc
#     six-leg                     |v_k| <= V_dc
#     six-leg-isolated            v_j - v_k <= 2 V_dc     (two links of V_dc each)
#     split-capacitor             -v_m <= v_k <= V_dc - v_m
#
# v_m is the voltage of the midpoint from the negative rail, V_dc / 2 where nothing moves it.
# Source: paper 002, chapter 5. These are all voltages that the switching states span, not only
# those of one modulator (tests hold them against the convex hulls of all states).

# Rows on the three phase voltages: each of them, and the differences between them.
VOLTAGE_ROWS = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, -1.0, 0.0],
        [0.0, 1.0, -1.0],
        [-1.0, 0.0, 1.0],
    ]
)


def largest_phase_voltage(topology: Topology, v_dc: float) -> float:
    """Largest voltage of a phase in V that a voltage vector of the topology makes.

    Two thirds of the largest difference where the neutral is not driven; a split link is taken
    with its midpoint anywhere, as far as three legs without it reach.

    Args:
        topology: The topology.
        v_dc: DC-link voltage in V.
    """
    rule = TOPOLOGIES[topology]
    if rule.neutral and not rule.midpoint:
        return v_dc
    return 2.0 / 3.0 * (rule.between or 1.0) * v_dc


def voltage_bounds(
    topology: Topology, v_dc: ArrayLike = 1.0, v_m: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Bounds low <= VOLTAGE_ROWS v <= high in V, each of shape (..., 6); infinite where there are
    none.

    Args:
        topology: The topology.
        v_dc: DC-link voltage in V, shape (...).
        v_m: Midpoint of a split link from the negative rail in V, broadcastable; half the link
            where it is not given. Others have none.
    """
    rule, link = TOPOLOGIES[topology], np.asarray(v_dc, dtype=np.float64)[..., np.newaxis]
    shares = [math.inf if share is None else share for share in (rule.phase, rule.between)]
    high = np.concatenate([link * shares[0] * np.ones(3), link * shares[1] * np.ones(3)], axis=-1)
    low = -high
    if rule.midpoint and v_m is not None:
        below = np.asarray(v_m, dtype=np.float64)[..., np.newaxis]
        low, high, below, link = np.broadcast_arrays(low, high, below, link)
        phases = np.arange(6) < 3
        low, high = np.where(phases, -below, low), np.where(phases, link - below, high)
    return low, high


def link_demand(voltages: FloatArray, topology: Topology) -> FloatArray:
    """Least dc-link voltage in V, shape (...), that phase voltages over a period need.

    Args:
        voltages: Phase voltages in V, shape (..., 3, N).
        topology: The topology. A split link counts in halves; of two isolated links it is each
            one's.
    """
    rule, demands = TOPOLOGIES[topology], []
    if rule.phase is not None:
        demands.append(np.max(np.abs(voltages), axis=(-2, -1)) / rule.phase)
    if rule.between is not None:
        between = np.max(voltages, axis=-2) - np.min(voltages, axis=-2)
        demands.append(np.max(between, axis=-1) / rule.between)
    return np.asarray(np.max(demands, axis=0))


def voltage_reach(
    voltages: FloatArray, topology: Topology, v_dc: ArrayLike, v_m: ArrayLike | None = None
) -> FloatArray:
    """Largest multiple of phase voltages that is within the region, shape (...); infinite for
    those that make no difference.

    Args:
        voltages: Phase voltages in V, shape (..., 3).
        topology, v_dc, v_m: As of `voltage_bounds`.
    """
    rows = voltages @ VOLTAGE_ROWS.T
    low, high = voltage_bounds(topology, v_dc, v_m)
    bound = np.where(rows > 0.0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        multiples = np.where(rows == 0.0, math.inf, bound / rows)
    return np.asarray(np.min(multiples, axis=-1))


def sine_share(topology: Topology) -> float:
    """Largest amplitude of sinusoidal phase voltages over the link's voltage.

    Args:
        topology: The topology.
    """
    rule = TOPOLOGIES[topology]
    single = math.inf if rule.phase is None else rule.phase
    return min(single, math.inf if rule.between is None else rule.between / math.sqrt(3.0))


# How large the fundamental of a phase voltage may be: of the modulator where the three legs have
# one to choose, else of the topology; more with overmodulation.

_ROUNDING = 1e-12


_CENTRED: ModulationName = "svpwm"


def linear_share(topology: Topology, modulation: ModulationName) -> float:
    """Largest amplitude of the fundamental over the link's voltage, without overmodulation.

    Args:
        topology: The topology.
        modulation: The design's modulator, which three legs without a neutral have.
    """
    if TOPOLOGIES[topology].modulated:
        return MODULATORS[modulation].linear_limit
    return sine_share(topology)


def overmodulation_of(inverter: Inverter, modulation: ModulationName) -> OvermodulationName:
    """The method by which voltages go beyond the linear range; ``none`` where they do not.

    Args:
        inverter: Topology and method of overmodulation.
        modulation: The modulator, which must make all of the hexagon; others keep their linear
            range.
    """
    if TOPOLOGIES[inverter.topology].modulated and follows_hexagon(modulation):
        return inverter.overmodulation
    return "none"


def fundamental_share(inverter: Inverter, modulation: ModulationName) -> float:
    """Largest amplitude of the fundamental over the link's voltage: the one place that says so for
    operating points, maps, references, budgets and the emitted control.

    Args:
        inverter: Topology and overmodulation.
        modulation: As of `linear_share`.
    """
    if overmodulation_of(inverter, modulation) != "none":
        return max(INSCRIBED, inverter.overmodulation_limit * SIX_STEP)
    return linear_share(inverter.topology, modulation)


def contradiction(key: str, topology: Topology, modulation: ModulationName) -> str:
    """Why a modulator cannot be chosen, as a sentence that begins with the key; empty where it can.

    The default stands for the topology's own: it is centred likewise.

    Args:
        key: What the sentence is about.
        topology, modulation: As of `linear_share`.
    """
    if TOPOLOGIES[topology].modulated or modulation == _CENTRED:
        return ""
    return (
        f"{key}: {topology} has its own modulator, centred between the rails, so "
        f"{modulation} is not available; omit it"
    )


def amplitude_limit(inverter: Inverter, modulation: ModulationName, margin: float = 0.0) -> float:
    """Largest phase-voltage amplitude in V (peak) of the fundamental.

    Args:
        inverter: Topology, DC link and overmodulation.
        modulation: As of `linear_share`.
        margin: Share of 0 to 1 that is kept for control.
    """
    return fundamental_share(inverter, modulation) * inverter.v_dc * (1.0 - margin)


def amplitude_fits(
    inverter: Inverter, modulation: ModulationName, amplitude: FloatArray | float
) -> BoolArray:
    """Where a phase-voltage amplitude (V, peak, any shape) is within the linear range, or that of
    overmodulation; false for NaN.

    Args:
        inverter, modulation: As of `amplitude_limit`.
        amplitude: In V, any shape.
    """
    linear = overmodulation_of(inverter, modulation) == "none"
    if linear and TOPOLOGIES[inverter.topology].modulated:
        return in_linear_range(modulation, amplitude, inverter.v_dc)
    limit = amplitude_limit(inverter, modulation) * (1.0 + _ROUNDING)
    return np.asarray(amplitude <= limit)


# Duty cycles of the legs for phase voltages, and the phase voltages that duty cycles make.
#
# Written once for every kind of number, as the zero sequence of the modulators is. Potentials of
# the legs are those from the negative rail (of isolated ends: each from its own link's)::
#
#     three-wire, diode-neutral   v_k + V0                                  V0 of the modulator
#     four-leg                    v_k + V0, V0   V0 = (V_dc - max - min) / 2 of {v_a, v_b, v_c, 0}
#     six-leg                     (V_dc + v_k) / 2, (V_dc - v_k) / 2
#     six-leg-isolated            the same of v_k - (max + min) / 2
#     split-capacitor             v_k + v_m
#
# and a duty cycle is the potential over V_dc. Each reaches all voltages of its topology's region
# (`dqforge.machines.topologies`). Source: paper 002, chapter 5.


def leg_potentials(
    o: Numbers[N, Any],
    topology: Topology,
    v: Triple[N],
    v_dc: N,
    *,
    nothing: N,
    v_m: N | None = None,
    zero_sequence: N | None = None,
) -> tuple[N, ...]:
    """Potentials of the legs from the negative rail, in the order of their duty cycles.

    Args:
        o: The arithmetic.
        topology: The topology.
        v: Phase voltages, within the region; nothing is clipped.
        v_dc: DC-link voltage in the unit of the phase voltages.
        nothing: The number 0.
        v_m: Midpoint of a split link from the negative rail; half the link where it is not given.
        zero_sequence: V0 of the design's modulator, which three legs without a neutral take; the
            mean of the extremes is centred where it is not given.
    """
    rule = TOPOLOGIES[topology]
    if rule.midpoint:
        middle = o.halved(v_dc) if v_m is None else v_m
        return tuple(o.total("leg: v + v_m", phase, middle) for phase in v)
    if rule.modulated:
        zero = _centred(o, v, v_dc) if zero_sequence is None else zero_sequence
        return tuple(o.total("leg: v + V0", phase, zero) for phase in v)
    if "n" in rule.legs:
        zero = _centred(o, v, v_dc, nothing)
        return (*(o.total("leg: v + V0", phase, zero) for phase in v), zero)
    if not rule.neutral:
        (high,), (low,) = extremes(o, v)
        shift = o.negative(o.halved(o.total("leg: max + min", high, low)))
        v = Triple(*(o.total("leg: v less the mean of extremes", phase, shift) for phase in v))
    upper = tuple(o.halved(o.total("leg: V_dc + v", v_dc, phase)) for phase in v)
    lower = tuple(o.halved(o.total("leg: V_dc - v", v_dc, o.negative(phase))) for phase in v)
    return upper + lower


def _centred(o: Numbers[N, Any], v: Triple[N], v_dc: N, *others: N) -> N:
    """What centres the highest and lowest of the phases, and of other potentials, in the link."""
    (high,), (low,) = extremes(o, v)
    for other in others:
        high = o.choose(o.at_least(high, other), high, other)
        low = o.choose(o.at_least(low, other), other, low)
    return o.halved(o.total("leg: V0", v_dc, o.negative(high), o.negative(low)))


def shortened(
    o: Numbers[N, Any],
    topology: Topology,
    v: Triple[N],
    v_dc: N,
    *,
    nothing: N,
    v_m: N | None = None,
) -> tuple[Triple[N], Any]:
    """Phase voltages shortened along their direction into the region, and the condition that they
    had to be.

    Args:
        o, topology, v_dc, nothing, v_m: As of `leg_potentials`.
        v: Phase voltages wanted.
    """
    rule = TOPOLOGIES[topology]
    (high,), (low,) = extremes(o, v)
    if rule.midpoint:
        middle = o.halved(v_dc) if v_m is None else v_m
        above = o.total("region: V_dc - v_m", v_dc, o.negative(middle))
        v, upwards = _within(o, v, high, above)
        _, (low,) = extremes(o, v)  # what brought down the highest brought up the lowest
        v, downwards = _within(o, v, o.negative(low), middle)
        return v, upwards | downwards
    if rule.between is None:
        up, down = o.magnitude(high), o.magnitude(low)
        return _within(o, v, o.choose(o.at_least(up, down), up, down), v_dc)
    if rule.neutral:
        high = o.choose(o.at_least(high, nothing), high, nothing)
        low = o.choose(o.at_least(low, nothing), nothing, low)
    span = o.total("region: max - min", high, o.negative(low))
    most = v_dc if rule.between == 1.0 else o.twice("region: both links", v_dc)
    return _within(o, v, span, most)


def _within(o: Numbers[N, Any], v: Triple[N], size: N, most: N) -> tuple[Triple[N], Any]:
    """Phase voltages times ``most / size`` where the size is larger, and where it is."""
    fits = o.at_least(most, size)
    scaled = (o.ratio("region", o.product("region: v times limit", x, most), size) for x in v)
    return Triple(*(o.choose(fits, x, y) for x, y in zip(v, scaled, strict=True))), ~fits


def duty_cycles(
    topology: Topology,
    voltages: ArrayLike,
    v_dc: ArrayLike,
    *,
    v_m: ArrayLike | None = None,
    zero_sequence: ArrayLike | None = None,
    number: type[np.floating[Any]] = np.float64,
) -> FloatArray:
    """Duty cycles of the upper switches, shape (..., legs), from 0 to 1; 1/2 without a link.

    Args:
        topology: The topology.
        voltages: Phase voltages in V, shape (..., 3).
        v_dc: DC-link voltage in V, broadcastable to (...).
        v_m, zero_sequence: As of `leg_potentials`, in V, broadcastable to (...).
        number: The floating-point type of the arithmetic.
    """
    phases = Triple(*np.moveaxis(np.asarray(voltages, dtype=number), -1, 0))
    link = np.asarray(v_dc, dtype=number)
    potentials = leg_potentials(
        Floats(number),
        topology,
        phases,
        link,
        nothing=np.zeros_like(phases.a),
        v_m=None if v_m is None else np.asarray(v_m, dtype=number),
        zero_sequence=None if zero_sequence is None else np.asarray(zero_sequence, dtype=number),
    )
    powered = link > 0.0
    scale = np.where(powered, number(1.0) / np.where(powered, link, number(1.0)), number(0.0))
    legs = np.stack(np.broadcast_arrays(*potentials), axis=-1) * scale[..., np.newaxis]
    return np.asarray(
        np.clip(np.where(powered[..., np.newaxis], legs, number(0.5)), number(0.0), number(1.0))
    )


def phase_voltages(
    topology: Topology, duty: FloatArray, v_dc: ArrayLike, v_m: ArrayLike | None = None
) -> FloatArray:
    """Phase voltages in V, shape (..., 3), of duty cycles or switching states.

    Without a neutral they are those whose mean is zero; only their differences act.

    Args:
        topology: The topology.
        duty: Duty cycles of the upper switches, shape (..., legs).
        v_dc, v_m: Link, and midpoint of a split one (half of it where it is not given), in V, shape
            (...).
    """
    rule, link = TOPOLOGIES[topology], np.asarray(v_dc, dtype=np.float64)
    voltages = duty @ leg_signs(topology).T * link[..., np.newaxis]
    if rule.midpoint:
        middle = 0.5 * link if v_m is None else np.asarray(v_m, dtype=np.float64)
        return np.asarray(voltages - middle[..., np.newaxis])
    if not rule.neutral:
        voltages = voltages - np.mean(voltages, axis=-1, keepdims=True)
    return np.asarray(voltages)


# The current that the pulses themselves drive through the neutral.
#
# ::
#
#     i_n,rms = 3 (V_dc T_s / L_0) sqrt(mean w' M w),   M = < g_j g_k > of the legs' harmonic
#     fluxes
#     w = (1, 1, 1, -3) / 3  four legs,   (1, 1, 1) / 3  split link,   (1, 1, 1, -1, -1, -1) / 3
#     six
#
# w is what each leg adds to the mean of the phase voltages, L_0 = L_s + 2 M_s + 3 L_n that of the
# phases with a choke in the neutral. Resistance and motion of the rotor within a period are left
# out. On a split link it is sqrt(3)/8 V_dc T_s / L_0 where the voltages vanish, as large as it
# gets.


def zero_weights(topology: Topology) -> FloatArray:
    """What each leg adds to the zero sequence of the phases, shape (legs,); all 0 where none acts.

    Args:
        topology: The topology.
    """
    weights = np.mean(leg_signs(topology), axis=0)
    return weights if TOPOLOGIES[topology].neutral else np.zeros_like(weights)


def neutral_ripple_squares(topology: Topology, duty: FloatArray) -> FloatArray:
    """Mean square of the harmonic flux of the zero sequence in each carrier period, in
    (V_dc T_s)^2, shape (...).

    Args:
        topology: The topology.
        duty: Duty cycles of its legs, shape (..., legs).
    """
    weights = zero_weights(topology)
    squares = np.einsum("j,...jk,k->...", weights, flux_moments(duty), weights)
    return np.asarray(np.maximum(squares, 0.0))


def neutral_ripple(
    topology: Topology,
    voltages: FloatArray,
    *,
    v_dc: float,
    t_s: float,
    l_0: float,
    v_m: ArrayLike | None = None,
) -> FloatArray:
    """Root mean square of the neutral current of the pulses over an electrical period in A, shape
    (...).

    Args:
        topology: The topology; without a neutral there is none.
        voltages: Phase voltages in V at evenly spaced angles, shape (..., 3, N), within the region.
        v_dc, t_s, l_0: Link in V, carrier period in s, zero-sequence inductance in H.
        v_m: Midpoint of a split link in V, shape (N,) or a number; half the link where it is not
            given.
    """
    duty = duty_cycles(topology, np.swapaxes(voltages, -1, -2), v_dc, v_m=v_m)
    squares = np.mean(neutral_ripple_squares(topology, duty), axis=-1)
    return np.asarray(3.0 * v_dc * t_s / l_0 * np.sqrt(squares))


# Which frame the currents of a phase machine are controlled in, and which ones it cannot have.

# Distance of the back-EMF from its fundamental, over the fundamental's peak, up to which constant
# dq currents serve: the torque ripple stays below twice that.
SINUSOIDAL = 0.005

# Least length of the back-EMF vector over its largest for constant torque: the current for a torque
# grows as the inverse.
WEAKEST = 0.05

_NO_NEUTRAL = {
    "three-wire": "its star point is not connected",
    "six-leg-isolated": "no current returns from one link to the other",
    "diode-neutral": (
        "a current out of its neutral holds the neutral at the upper rail, where no phase voltage "
        "is positive, and motoring currents of dqy ask for positive ones at that angle"
    ),
}


@dataclass(frozen=True, slots=True)
class FrameChoice:
    """A frame, and why it is the one that the machine asks for."""

    frame: CurrentFrame
    reason: str


def flux_axes(machine: AnyPhaseMachine) -> FloatArray:
    """Back-EMF over electrical speed in Wb on alpha, beta and 0 (mean of the phases),
    shape (3, N).

    Args:
        machine: The machine in phase quantities.
    """
    return np.asarray(clarke_matrix() @ machine.flux)


def uses_zero_sequence(frame: CurrentFrame, topology: Topology) -> bool:
    """Whether the currents for a torque have a zero sequence.

    Only dqy and the table share the torque among all three axes; dqx is the frame of currents
    without zero sequence on any topology, and dq that of sinusoidal ones.

    Args:
        frame: The frame.
        topology: How the phases are fed.
    """
    return TOPOLOGIES[topology].neutral and frame in ("dqy", "table")


def zero_sequence_inductance(machine: AnyPhaseMachine, choke: float = 0.0) -> float:
    """Inductance L_0 in H that a zero-sequence current meets: L_s + 2 M_s, and 3 L_n of a choke.

    That of a salient machine is the mean over the angle.

    Args:
        machine: The machine in phase quantities.
        choke: Inductance L_n in the neutral in H.
    """
    if isinstance(machine, SalientPhaseMachine):
        return float(np.mean(np.sum(machine.inductance, axis=(1, 2))) / 3.0) + 3.0 * choke
    return machine.l_s + 2.0 * machine.m_s + 3.0 * choke


def distance_from_sine(machine: AnyPhaseMachine, topology: Topology) -> float:
    """Largest distance of the back-EMF vector from its fundamental, over the fundamental's peak.

    The zero sequence counts where the legs drive one.

    Args:
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    axes = flux_axes(machine)
    angle = phases.theta
    axes[0] += machine.psi_pm * np.sin(angle)
    axes[1] -= machine.psi_pm * np.cos(angle)
    used = axes if TOPOLOGIES[topology].neutral else axes[:2]
    return float(np.max(np.linalg.norm(used, axis=0)) / machine.psi_pm)


def _weakest(machine: AnyPhaseMachine, *, zero: bool) -> tuple[float, float]:
    """Least length of the back-EMF vector over its largest, and the angle in degrees.

    With ``zero`` all three axes count, weighted as the torque weighs them.
    """
    axes = flux_axes(machine) * np.array([[1.0], [1.0], [np.sqrt(2.0)]])
    length = np.linalg.norm(axes if zero else axes[:2], axis=0)
    where = int(np.argmin(length))
    largest = float(np.max(length))
    share = float(length[where]) / largest if largest > 0.0 else 0.0
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    return share, float(np.degrees(phases.theta[where]))


def tables_obstacle(machine: AnyPhaseMachine | None) -> str:
    """Why a machine has no frame tables, and what to write instead; empty where it has.

    Args:
        machine: The machine, None where its back-EMF is sinusoidal.
    """
    if machine is None:
        return (
            "with a sinusoidal back-EMF dqx and dqy are dq; leave the key out, or write "
            "machine.model: waveform with its back_emf"
        )
    if isinstance(machine, SalientPhaseMachine):
        return (
            "the decoupling terms of paper 002 hold for machines without saliency; leave out "
            "frame_tables, or machine.inductance_harmonics"
        )
    return ""


def frame_obstacle(frame: CurrentFrame, machine: AnyPhaseMachine, topology: Topology) -> str:
    """Why a machine on a topology cannot be controlled in a frame, with what to write instead.

    Empty where it can.

    Args:
        frame: The frame.
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    if frame == "dq":
        return ""
    if isinstance(machine, SalientPhaseMachine) and frame != "table":
        return (
            f"{frame} needs inductances that do not vary with the angle, this machine has "
            "inductance_harmonics; write table or dq"
        )
    neutral = TOPOLOGIES[topology].neutral
    if frame == "dqy" and not neutral:
        others = [
            name for name in ("dqx", "table") if not frame_obstacle(name, machine, topology)
        ] or ["dq"]
        return (
            f"dqy needs a zero-sequence current, and {topology} drives none: "
            f"{_NO_NEUTRAL[topology]}; write {' or '.join(others)}"
        )
    share, where = _weakest(machine, zero=frame == "table" and neutral)
    if share >= WEAKEST:
        return ""
    vector = "vector" if frame == "table" and neutral else "alpha-beta vector"
    instead = (
        "write table"
        if frame != "table" and not frame_obstacle("table", machine, topology)
        else "write dq, and accept the torque ripple"
    )
    return (
        f"the back-EMF's {vector} falls to {100.0 * share:.2g} % of its largest at {where:.0f} "
        f"degrees, {frame} needs {100.0 * WEAKEST:.0f} %: the current for constant torque would "
        f"grow without bound; {instead}"
    )


def choose_frame(machine: AnyPhaseMachine, topology: Topology) -> FrameChoice:
    """The frame of a design that names none.

    Args:
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    distance = distance_from_sine(machine, topology)
    away = f"the back-EMF is up to {100.0 * distance:.2g} % of its peak off a sine"
    if distance <= SINUSOIDAL:
        return FrameChoice("dq", f"{away}, sinusoidal currents serve up to {SINUSOIDAL:.1%}")
    obstacle = frame_obstacle("table", machine, topology)
    if obstacle:
        return FrameChoice("dq", obstacle.split(";")[0])
    return FrameChoice("table", f"{away}, references over the angle keep the torque constant")


def controlled_frame(
    wanted: CurrentFrame | None, machine: AnyPhaseMachine, topology: Topology
) -> CurrentFrame:
    """The frame that a design has: the one it names, else the one that its machine asks for.

    Args:
        wanted: What the design names, None for nothing.
        machine: The machine in phase quantities.
        topology: How its phases are fed.
    """
    return choose_frame(machine, topology).frame if wanted is None else wanted


# What a zero-sequence current saves in copper, and what the pulses drive through the neutral.


@dataclass(frozen=True, slots=True)
class NeutralBalance:
    """Copper that the neutral saves and costs.

    Args:
        saved: Copper loss that currents of constant torque save with a zero sequence, in W/(N m)^2.
        ripple: Neutral current of the pulses at standstill in A, r.m.s., where it is largest on a
            split link.
        cost: Its copper loss in W.
    """

    saved: float
    ripple: float
    cost: float

    @property
    def break_even(self) -> float:
        """Torque in N m from which on it saves more than it costs; infinite where never."""
        return math.sqrt(self.cost / self.saved) if self.saved > 0.0 else math.inf


def neutral_balance(
    machine: PhaseMachine, topology: Topology, v_dc: float, f_sw: float, l_0: float
) -> NeutralBalance:
    """Saving and cost of the neutral.

    A third of the neutral current flows in each phase, so that its copper loss is R I_n^2/3.

    Args:
        machine: The machine.
        topology: How its phases are fed.
        v_dc: Link voltage in V.
        f_sw: Carrier frequency in Hz.
        l_0: Inductance in H that a zero-sequence current meets.
    """
    alpha, beta, zero = flux_axes(machine)
    plane = 1.5 * (alpha**2 + beta**2)
    scale = machine.r_s / machine.pole_pairs**2
    saved = scale * float(np.mean(1.0 / plane) - np.mean(1.0 / (plane + 3.0 * zero**2)))
    # Without voltages every carrier period is alike.
    still = np.zeros((3, 1))
    ripple = float(neutral_ripple(topology, still, v_dc=v_dc, t_s=1.0 / f_sw, l_0=l_0))
    return NeutralBalance(saved, ripple, machine.r_s * ripple**2 / 3.0)
