"""Current control of a design's phase machine: gains, tables and limits from its settings."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ControlSettings, CurrentLoopSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import (
    TOPOLOGIES,
    VOLTAGE_ROWS,
    controlled_frame,
    frame_obstacle,
    uses_zero_sequence,
    voltage_bounds,
    zero_sequence_inductance,
)
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.loops.loop_gains import LoopGains, analyse_current_loop, tune_current_loop
from dqforge.optimizer.loops.robustness import DriveBox
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.phase_control.judged_box import JudgedLoops, judge_loops
from dqforge.optimizer.phase_control.limited_shapes import LimitedFit, fit_limited
from dqforge.optimizer.phase_control.phase_controller import (
    MARGIN,
    PHASES,
    AxisGains,
    HarmonicGains,
    Largest,
    MidpointGains,
    PhaseControl,
    PhaseShape,
    TorqueLimit,
    flux_at,
    largest_torques,
    no_load_speed,
    torque_limit,
    torque_of,
    unit_currents,
)
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    dq_waveform,
    pointwise_currents,
)
from dqforge.optimizer.waveforms.salient_reference import largest_torque

_ANGLES = 2880


@dataclass(frozen=True, slots=True)
class PhaseLoops:
    """Current control of a phase machine with the evidence for it.

    Args:
        control: What the firmware runs.
        shape: Its table of the back-EMF and what that errs by.
        zero: The loop of the zero-sequence current, None where nothing drives one.
        limited: The currents beyond the torque limit, None where none are asked for or the link
            ends none.
        judged: How fast all of it forgets a disturbance over speeds and tolerances; None until
            judged.
    """

    control: PhaseControl
    shape: ShapeFit
    zero: LoopGains | None
    limited: LimitedFit | None = None
    judged: JudgedLoops | None = None


def phase_control(
    design: Design, i_d: LoopGains, i_q: LoopGains, *, within_link: bool = True
) -> PhaseLoops:
    """Current control of a design's phase machine.

    Args:
        design: The design, with a phase machine.
        i_d, i_q: Its current loops.
        within_link: Whether it knows where the link ends the torque, which takes a second to find;
            without it stands for points that are known to lie within.

    Raises:
        InputError: The frame is one that machine and topology cannot have.
        NoSolutionError: The loop of the zero sequence does not hold, or no table follows the
            back-EMF.
    """
    machine, inverter, control = design.phase_machine, design.inverter, design.control
    if machine is None:
        raise InputError(
            "this design's machine has a sinusoidal back-EMF: its control is that of dq"
        )
    settings, topology = control.current_loop, inverter.topology
    frame = controlled_frame(settings.frame, machine, topology)
    obstacle = frame_obstacle(frame, machine, topology)
    if obstacle:
        raise InputError(f"control.current_loop.frame: {obstacle}")
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    neutral = TOPOLOGIES[topology].neutral
    uses_zero = uses_zero_sequence(frame, topology)
    l_d, l_q = design.machine.l_d, design.machine.l_q
    l_0 = zero_sequence_inductance(machine, inverter.neutral_inductance)
    zero = zero_loop(control, i_q, machine.r_s, l_q, l_0) if neutral else None
    fit = fit_shape(phases, zero=uses_zero, turns=phases.turns, currents=frame != "dq")
    period = 2.0 * np.pi * phases.turns
    angle = period * np.arange(_ANGLES * phases.turns) / (_ANGLES * phases.turns)
    flux = flux_at(fit.shape, angle)
    sine = machine.psi_pm * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    used = sine if frame == "dq" else flux
    unit = unit_currents(used, phases.pole_pairs, zero=uses_zero)
    if isinstance(machine, SalientPhaseMachine):
        torque_max = float(_ladder(design, machine, frame).torques[-1])
    elif frame == "dq":
        torque_max = _choice(design).largest_torque()
    else:
        torque_max = design.i_max / float(np.max(np.abs(PHASES @ unit)))
    midpoint = None
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is not None:
        midpoint = midpoint_gains(
            unit[2], phases.turns, torque_max, inverter.midpoint_capacitance, inverter.v_dc
        )
    loops = [(i_d.kp, l_d), (i_q.kp, l_q), *([] if zero is None else [(zero.kp, l_0)])]
    unlimited = PhaseControl(
        frame=frame,
        feedforward=settings.feedforward,
        topology=topology,
        shape=fit.shape,
        pole_pairs=phases.pole_pairs,
        r_s=machine.r_s,
        psi_pm=machine.psi_pm,
        inductances=(l_d, l_q, l_0),
        gains=(axis_gains(i_d), axis_gains(i_q), axis_gains(zero)),
        harmonics=_harmonics(design, PHASES @ unit, PHASES @ flux, loops),
        t_s=control.t_s,
        torque_max=torque_max,
        midpoint=midpoint,
    )
    limit = _torque_limit(design, unlimited) if within_link else None
    found = replace(unlimited, torque_limit=limit)
    limited = _limited(design, phases, found) if settings.limited_waveforms else None
    found = replace(found, limited=None if limited is None else limited.shapes)
    return PhaseLoops(found, fit, zero, limited)


def voltage_margin(design: Design) -> float:
    """Share of the voltage region that steady currents leave free, of 0 to 1.

    What the firmware leaves free by the design, `MARGIN` for its PI controllers, and what dead time
    takes off either end.
    """
    inverter = design.inverter
    return design.operation.voltage_margin + MARGIN + 2.0 * inverter.dead_time * inverter.f_sw


def _harmonics(
    design: Design,
    currents: FloatArray,
    flux: FloatArray,
    loops: list[tuple[float, float]],
) -> HarmonicGains | None:
    """Harmonic integrators for currents per torque and back-EMF of the phases, shape (3, N).

    ``loops`` are (kp, inductance) of each axis that is controlled.
    """
    control, machine = design.control, design.phase_machine
    if machine is None or not control.current_loop.harmonic_integrators:
        return None
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    return harmonic_gains(
        harmonic_orders(currents, flux, phases.turns),
        control.t_s,
        min(kp / inductance for kp, inductance in loops),
        design.i_max,
        _top_speed(design),
        neutral=TOPOLOGIES[design.inverter.topology].neutral,
    )


def _torque_limit(design: Design, control: PhaseControl) -> TorqueLimit:
    """Where the link ends the torque; the swing of a split link's midpoint is taken off."""
    v_dc, margin, machine = design.inverter.v_dc, voltage_margin(design), design.phase_machine
    last = no_load_speed(control, v_dc, margin)
    if control.midpoint is not None:
        margin += SWING * min(1.0, control.midpoint.omega_e_min / last)
        last = no_load_speed(control, v_dc, margin)
    if isinstance(machine, SalientPhaseMachine):
        ladder = _ladder(design, machine, control.frame)
        largest = salient_torques(machine, ladder, control.topology, margin)
    else:
        largest = partial(largest_torques, control, margin=margin)
    return torque_limit(v_dc, last, largest)


def _ladder(design: Design, machine: SalientPhaseMachine, frame: CurrentFrame) -> Ladder:
    """Torques of a salient machine with the currents that the firmware gives them."""
    if frame == "dq":
        return dq_currents(machine, _choice(design))
    inverter = design.inverter
    topology: Topology = "three-wire" if TOPOLOGIES[inverter.topology].diodes else inverter.topology
    return table_currents(machine, WaveformLimits(inverter.v_dc, topology, design.i_max))


def _limited(design: Design, machine: PhaseMachine, control: PhaseControl) -> LimitedFit | None:
    """Currents beyond the torque limit."""
    omega_m = design.machine.omega_m_max
    top = None if omega_m is None else machine.pole_pairs * omega_m
    margin = voltage_margin(design)
    return fit_limited(control, machine, design.inverter.v_dc, design.i_max, top, margin)


def judged(design: Design, box: DriveBox, loops: PhaseLoops) -> PhaseLoops:
    """The control with the judgement of its currents over speeds and tolerances.

    Args:
        design: The design, with a phase machine.
        box: Its tolerances.
        loops: Its control.

    Raises:
        NoSolutionError: The currents are unstable at a speed and a point of the box, which are
            named.
    """
    found = judge_loops(
        loops.control,
        box,
        _top_speed(design) / loops.control.pole_pairs,
        design.inverter.midpoint_capacitance,
        named=design.control.tolerances is not None,
    )
    return replace(loops, judged=found)


def _top_speed(design: Design) -> float:
    """Electrical top speed in rad/s: the machine's, else the base of the speed."""
    omega_m = design.machine.omega_m_max
    return design.machine.pole_pairs * (design.control.bases.speed if omega_m is None else omega_m)


def _choice(design: Design) -> CurrentChoice:
    """The constant dq currents of a torque."""
    return CurrentChoice(design.machine, design.strategy, design.i_max)


# The table of the back-EMF that the firmware gets: as small as the torque permits.

# Nodes per electrical period that are tried: multiples of 24, so that corners at multiples of 15
# degrees can lie on nodes.
SIZES = (*range(24, 481, 24), *range(576, 1537, 96))

# Torque ripple, peak to peak over the torque, that the emitted control keeps in steady state at 400
# samples per electrical period, as far as its table can.
RIPPLE = 5e-4

# Torque error of the table that is aimed at: half of the square of the ripple, since sampling
# leaves about as much.
SHAPE_ERROR = RIPPLE / 2.0**0.5

# Permitted error where no table reaches that, and of the flux where currents do not follow it.
LARGEST_ERROR = 1e-3
_SAME = 1e-9
_BAND = 1e-7
_DENSE = 7680


@dataclass(frozen=True, slots=True)
class ShapeFit:
    """A table and what it errs by.

    ``error`` is the torque that its currents make on the machine, peak to peak over the torque
    asked for; where currents do not follow it, the largest distance from the back-EMF over the
    fundamental's peak. ``samples`` are the angles that it was measured at.
    """

    shape: PhaseShape
    error: float
    samples: int


def has_equal_phases(machine: PhaseMachine) -> bool:
    """Whether b and c are phase a, a third and two thirds of the period later."""
    flux, third = machine.flux, machine.angles // 3
    scale = _SAME * float(np.max(np.abs(flux)))
    return all(bool(np.max(np.abs(np.roll(flux[0], k * third) - flux[k])) <= scale) for k in (1, 2))


def shape_error(machine: PhaseMachine, shape: PhaseShape, *, zero: bool) -> tuple[float, int]:
    """Torque of a table's currents on the machine, peak to peak over the torque, and the number
    of angles.

    It is measured between the machine's own angles too where its waveform is band-limited, so
    that it is known there; else, as with corners, at its own angles.

    Args:
        machine: The machine.
        shape: The table.
        zero: Whether the zero sequence shares the torque.
    """
    flux = machine.flux
    if _is_band_limited(flux):
        count = machine.angles * -(-_DENSE * shape.turns // machine.angles)
        flux = resampled(flux, count)
    angle = 2.0 * np.pi * shape.turns * np.arange(flux.shape[1]) / flux.shape[1]
    unit = unit_currents(flux_at(shape, angle), machine.pole_pairs, zero=zero)
    torque = torque_of(clarke_matrix() @ flux, unit, machine.pole_pairs)
    return float(np.ptp(torque)), int(angle.size)


def flux_error(machine: PhaseMachine, shape: PhaseShape) -> tuple[float, int]:
    """Largest distance of a table from the back-EMF over the fundamental's peak, at the machine's
    own angles, and their number.

    Args:
        machine: The machine.
        shape: The table.
    """
    angle = 2.0 * np.pi * shape.turns * np.arange(machine.angles) / machine.angles
    away = flux_at(shape, angle) - clarke_matrix() @ machine.flux
    largest = float(np.max(np.linalg.norm(away, axis=0)))
    return largest / machine.psi_pm, machine.angles


def fit_shape(
    machine: PhaseMachine,
    *,
    zero: bool,
    turns: int = 1,
    currents: bool = True,
) -> ShapeFit:
    """The smallest table whose currents make the torque constant within `SHAPE_ERROR`; where none
    does, the smallest within `LARGEST_ERROR`.

    The machine's own angles are among the sizes: the data say no more.

    Args:
        machine: The machine.
        zero: Whether the zero sequence shares the torque.
        turns: Electrical periods of the machine's waveform.
        currents: Whether the currents follow the table; else it serves the voltage alone, and the
            error is that of the back-EMF, `LARGEST_ERROR` at most.

    Raises:
        NoSolutionError: No table up to 1536 nodes per electrical period keeps the bound.
    """
    equal = turns == 1 and has_equal_phases(machine)
    rows = machine.flux[:1] if equal else machine.flux
    own = machine.angles // turns
    sizes = sorted({*SIZES, *([own] if own <= SIZES[-1] and own % 3 == 0 else [])})
    aim = SHAPE_ERROR if currents else LARGEST_ERROR
    fits = []
    for size in sizes:
        shape = PhaseShape(resampled(rows, size * turns), turns)
        error, samples = (
            shape_error(machine, shape, zero=zero) if currents else flux_error(machine, shape)
        )
        fits.append(ShapeFit(shape, error, samples))
        if error <= aim:
            return fits[-1]
    for fit in fits:
        if fit.error <= LARGEST_ERROR:
            return fit
    least = min(fit.error for fit in fits)
    raise NoSolutionError(
        f"machine.back_emf: no table of up to {SIZES[-1]} nodes follows it, the torque deviates by "
        f"{100.0 * least:.2g} % peak to peak where {100.0 * LARGEST_ERROR:.2g} % are permitted; "
        "smooth the measured waveform, or write control.current_loop.frame: dq"
    )


def resampled(waveform: FloatArray, count: int) -> FloatArray:
    """Periodic rows, shape (..., N), at ``count`` even angles, by trigonometric interpolation.

    Angles that the rows have themselves keep their values.
    """
    size = waveform.shape[-1]
    if size % count == 0:
        return np.asarray(waveform[..., :: size // count])
    # Values are read from a denser grid, so that a smaller one loses nothing by aliasing twice.
    factor = count // int(np.gcd(count, size))
    lines = np.fft.rfft(waveform, axis=-1)
    dense = np.fft.irfft(lines, n=size * factor, axis=-1) * factor
    return np.asarray(dense[..., :: size * factor // count])


def _is_band_limited(flux: FloatArray) -> bool:
    """Whether the upper half of the spectrum is empty, so that all between the angles is known."""
    lines = np.abs(np.fft.rfft(flux, axis=-1))
    return bool(np.max(lines[:, lines.shape[1] // 2 :]) <= _BAND * np.max(lines))


# Where the voltage of the link ends the torque of a salient machine, in dq and with a table.

_TORQUES = 65
_ROUNDING = 1e-12  # Share of a bound by which rounding alone may exceed it.


@dataclass(frozen=True, slots=True, eq=False)
class Ladder:
    """Torques from 0 to the largest in N m, shape (T,), and the phase currents in A that make them
    and their negatives, shape (2 T, 3, N).
    """

    torques: FloatArray
    currents: FloatArray


def dq_currents(machine: SalientPhaseMachine, choice: CurrentChoice) -> Ladder:
    """Constant dq currents of torques of both signs up to the current limit.

    Args:
        machine: The machine in phase quantities.
        choice: The dq currents of a torque.
    """
    torques = np.linspace(0.0, choice.largest_torque(), _TORQUES)
    i_d, i_q = choice.currents(torques)
    pairs = [
        (float(d), sign * float(q)) for sign in (1.0, -1.0) for d, q in zip(i_d, i_q, strict=True)
    ]
    turns = machine.phases.turns
    currents = np.stack([dq_waveform(i_d, i_q, machine.angles, turns) for i_d, i_q in pairs])
    return Ladder(torques, currents)


@lru_cache(maxsize=8)
def table_currents(machine: SalientPhaseMachine, limits: WaveformLimits) -> Ladder:
    """Currents of constant torque at least copper loss, of both signs up to the current limit.

    Args:
        machine: The machine in phase quantities.
        limits: With the topology and the current limit.

    Raises:
        NoSolutionError: Constant torque cannot be made at some angle.
    """
    torques = np.linspace(0.0, largest_torque(machine, limits), _TORQUES)
    both = np.concatenate([torques, -torques])
    return Ladder(torques, pointwise_currents(machine, both, limits.topology))


def salient_torques(
    machine: SalientPhaseMachine, ladder: Ladder, topology: Topology, margin: float
) -> Largest:
    """Largest torques that the link permits.

    The reluctance torque makes the currents no multiple of the torque: a ladder of torques is
    judged, and the last one counts that is permitted with all below it.

    Args:
        machine: The machine in phase quantities.
        ladder: Torques and their currents.
        topology: How the phases are fed.
        margin: Share of the region that is left free, of 0 to 1.
    """
    torques, currents = ladder.torques, ladder.currents
    low, high, rows = _region(topology, margin)
    part = _part(machine)
    # Voltages are straight in the speed: one set at rest and one per speed tell all.
    at_rest = machine.voltage(currents, np.zeros(len(currents)))
    per_speed = machine.voltage(currents, np.ones(len(currents))) - at_rest
    still, moving = (np.einsum("rk,jkn->jrn", rows, v[..., :part]) for v in (at_rest, per_speed))
    low, high = (1.0 + _ROUNDING) * low[:, np.newaxis], (1.0 + _ROUNDING) * high[:, np.newaxis]

    def largest(omega_e: FloatArray, v_dc: float) -> FloatArray:
        if v_dc <= 0.0:
            return np.zeros_like(omega_e)
        found = np.zeros_like(omega_e)
        for place, omega in enumerate(omega_e):
            found_rows = still + omega * moving
            fits = np.all((found_rows <= high * v_dc) & (found_rows >= low * v_dc), axis=(1, 2))
            both = fits[:_TORQUES] & fits[_TORQUES:]
            count = _TORQUES if both.all() else int(np.argmin(both))
            found[place] = torques[max(count - 1, 0)]
        return found

    return largest


def _region(topology: Topology, margin: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bounds over the link, shape (r,), and rows on the phase voltages, shape (r, 3)."""
    low, high = voltage_bounds(topology, 1.0 - margin)
    limited = np.isfinite(high)
    return low[limited], high[limited], VOLTAGE_ROWS[limited]


def _part(machine: SalientPhaseMachine) -> int:
    """Angles that must be looked at: bounds are alike for all phases and both signs."""
    return machine.angles // {"sixth": 6, "third": 3, "none": 1}[machine.symmetry]


# Which harmonics of the currents get integrators that turn with them.

RATE = 60.0  # Rate of learning in 1/s: a time constant of 17 ms.
CALM = 30.0  # Least ratio of the current loop's bandwidth to the rate.

# Error over the current limit above which the integrators rest: a torque step, no disturbance.
ERROR_SHARE = 1.0 / 6.0
HIGHEST = 13  # Highest order that is looked at.
WORTH = 0.05  # Share of the largest disturbance from which on an order is worth an integrator.

# Most orders in the plane and of the zero sequence; each costs a sine and two states.
MOST = (8, 4)
SLOW = 0.1  # Share of the top speed at which an order must still lie below the frequency limit.


def harmonic_orders(
    phase_currents: FloatArray, flux: FloatArray, turns: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Signed orders in the plane, and orders of the zero sequence, largest disturbance first.

    Disturbances are the dead time, whose voltage has the sign of each phase current, and errors
    of the back-EMF, which has the orders of the table. Equal phases with mirrored half waves have
    -5, 7, -11, 13 and 3, 9. The order 1 is what the plain integrators hold, and in the plane 0 is
    an offset of the sensors, which no integrator sees.

    Args:
        phase_currents: Currents of the phases per torque over the period, shape (3, N).
        flux: Back-EMF of the phases over electrical speed in Wb, shape (3, N), on the same angles.
        turns: Electrical periods that the columns span.
    """
    plane: dict[int, float] = {}
    zero: dict[int, float] = {}
    still = np.abs(phase_currents) <= 1e-9 * np.max(np.abs(phase_currents))
    for signal in (np.where(still, 0.0, np.sign(phase_currents)), flux / np.max(np.abs(flux))):
        alpha, beta, mean = clarke_matrix() @ signal
        vector = np.fft.fft(alpha + 1j * beta) / alpha.size
        line = 2.0 * np.fft.fft(mean) / mean.size
        for order in range(-HIGHEST, HIGHEST + 1):
            size = float(np.abs(vector[order * turns]))
            plane[order] = max(plane.get(order, 0.0), size)
            if order > 0:
                zero[order] = max(zero.get(order, 0.0), float(np.abs(line[order * turns])))
    for order in (0, 1):
        plane.pop(order)
    return _largest(plane, MOST[0]), _largest(zero, MOST[1])


def _largest(sizes: dict[int, float], most: int) -> tuple[int, ...]:
    """Orders worth an integrator, the strongest ones, in ascending magnitude."""
    worth = [order for order, size in sizes.items() if size >= WORTH]
    strongest = sorted(worth, key=lambda order: (-round(sizes[order], 9), abs(order), order))
    return tuple(sorted(strongest[:most], key=lambda order: (abs(order), order)))


def harmonic_gains(
    orders: tuple[tuple[int, ...], tuple[int, ...]],
    t_s: float,
    bandwidth: float,
    i_max: float,
    omega_e_max: float,
    *,
    neutral: bool,
) -> HarmonicGains | None:
    """Integrators for orders of the plane and of the zero sequence, None where none are left.

    Args:
        orders: As `harmonic_orders` finds them.
        t_s: Sampling period in s.
        bandwidth: Of the current loops in rad/s, kp over the inductance: the least of all axes.
        i_max: Current limit in A, peak.
        omega_e_max: Top speed in rad/s, electrical.
        neutral: Whether the legs drive a zero sequence.
    """
    frequency_max = 1.0 / (6.0 * t_s)
    highest = 2.0 * np.pi * frequency_max / (SLOW * omega_e_max)
    plane, zero = (tuple(m for m in part if abs(m) <= highest) for part in orders)
    zero = zero if neutral else ()
    if not plane and not zero:
        return None
    return HarmonicGains(
        plane=plane,
        zero=zero,
        rate=min(RATE, bandwidth / CALM),
        frequency_max=frequency_max,
        error_max=ERROR_SHARE * i_max,
    )


# Gains of the three axes of a phase machine: d, q and the zero sequence.

KEY = "control.current_loop.axis_gains"


def zero_loop(
    control: ControlSettings, q_axis: LoopGains, r_s: float, l_q: float, l_0: float
) -> LoopGains:
    """The loop of the zero-sequence current, by the rule of the settings.

    ``own``: by the same method on the zero-sequence inductance; gains that are given are those of
    the q axis, scaled with the inductance, so that both loops are equally fast. ``one``: the gains
    of the q axis.

    Args:
        control: Sampling and settings.
        q_axis: The loop of the q axis.
        r_s: Phase resistance in Ohm.
        l_q, l_0: Inductances of the q axis and of the zero sequence in H, a choke of the neutral
            included.

    Raises:
        NoSolutionError: The loop does not hold.
    """
    settings = control.current_loop
    if settings.axis_gains == "one":
        _require_stable(q_axis, control.t_s, l_q, l_0)
        return _one_gain(control.t_s, settings, q_axis, r_s, l_0)
    if settings.method == "given":
        settings = _given(settings, q_axis.kp * l_0 / l_q, q_axis.ki * l_0 / l_q)
    return tune_current_loop(r_s, l_0, control.t_s, settings, "i_0")


def _one_gain(
    t_s: float, settings: CurrentLoopSettings, q_axis: LoopGains, r_s: float, l_0: float
) -> LoopGains:
    """The zero sequence with the gains of the q axis, refused without the margin of a loop."""
    found = analyse_current_loop(r_s, l_0, t_s, q_axis.kp, q_axis.ki, loop="i_0")
    margin, required = np.degrees([abs(found.phase_margin), settings.min_phase_margin])
    if found.stable and margin >= required:
        return found
    reached = f"a phase margin of {margin:.1f} deg" if found.stable else "no stable loop"
    raise NoSolutionError(
        f"{KEY}: one set of gains leaves the zero sequence {reached}, required: "
        f"{required:.1f} deg; write own, or lower the gains"
    )


def axis_gains(loop: LoopGains | None) -> AxisGains:
    """Gains of one axis, none where nothing drives a current."""
    return AxisGains(0.0, 0.0) if loop is None else AxisGains(loop.kp, loop.ki)


def _given(settings: CurrentLoopSettings, kp: float, ki: float) -> CurrentLoopSettings:
    return replace(settings, method="given", kp=kp, ki=ki)


def _require_stable(q_axis: LoopGains, t_s: float, l_q: float, l_0: float) -> None:
    """Refuse one gain for all axes where the zero sequence is unstable with it.

    Its loop gain per sample is kp T_s / L_0; with one sample of delay it is unstable above one.
    """
    bandwidth = q_axis.kp / l_q
    ratio, limit = l_q / l_0, 1.0 / (t_s * bandwidth)
    if ratio < limit:
        return
    raise NoSolutionError(
        f"{KEY}: one set of gains is unstable in the zero sequence: L_ab/L_0 is {ratio:.3g}, and "
        f"f_s/omega_c permits {limit:.3g}; write own"
    )


# What keeps the midpoint of a split link where it belongs.

# Of the balance in rad/s: far below the current loops and the electrical speeds in use.
BANDWIDTH = 20.0
SWING = 0.05  # Permitted swing of the midpoint, peak to peak over the link voltage.


def midpoint_gains(
    unit_zero: FloatArray, turns: int, torque_max: float, capacitance: float, v_dc: float
) -> MidpointGains:
    """Balance and least speed of a split link.

    C dv_m/dt = 3 i_0, so that i_0 = -k (v_m - v_dc/2) has the bandwidth 3 k/C. Over a period the
    charge of the neutral current moves the midpoint by its span over omega_e C; with order 3 alone
    that is 2 I_n3/(3 omega_e C).

    Args:
        unit_zero: Zero-sequence current per torque over the period in A/(N m), shape (N,).
        turns: Electrical periods that it spans.
        torque_max: Largest torque in N m.
        capacitance: Both halves together in F.
        v_dc: Link voltage in V.

    Raises:
        NoSolutionError: The neutral current has a mean that no capacitor carries.
    """
    balance, allowed = BANDWIDTH * capacitance / 3.0, SWING * v_dc
    mean = float(np.mean(unit_zero)) * torque_max
    if abs(mean) > balance * 0.5 * allowed:
        raise NoSolutionError(
            "control.current_loop.frame: the currents for constant torque have a mean in the "
            f"neutral of up to {3.0 * abs(mean):.3g} A, which the split link does not carry; "
            "write dqx"
        )
    step = 2.0 * np.pi * turns / unit_zero.size
    charge = np.cumsum(unit_zero - np.mean(unit_zero)) * step
    return MidpointGains(
        balance, float(3.0 * torque_max * np.ptp(charge) / (capacitance * allowed))
    )
