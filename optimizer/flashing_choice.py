"""Topologies and controllers of a design's machine compared at its operating point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.phase_terminals import (
    LegWaveforms,
    inductance_over_angle,
    leg_waveforms,
    phase_terminals,
)
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine, PhaseMachine, derivative
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, leg_signs
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.losses.phase_comparison import PhaseBudget, phase_budget
from dqforge.optimizer.phase_control.design import phase_control
from dqforge.optimizer.phase_control.phase_controller import AxisGains, PhaseControl
from dqforge.optimizer.waveforms.comparison import (
    OpenPhasePrice,
    open_phase_price,
    operating_point,
    require_phases,
)
from dqforge.optimizer.waveforms.constraint_rows import dq_waveform, unit_currents

_KEY = "control.current_loop.frame: "

# Swing of the midpoint over the link's voltage that a split link is given capacitors for, where the
# design names none.
SPLIT_SWING = 0.02


@dataclass(frozen=True, slots=True)
class FlashComparison:
    """Rows at one operating point.

    Args:
        torque, omega_m: In N m and rad/s.
        v_dc: Of the design's link in V.
        rows: Every topology with every controller.
        without_device: Whether the switches are unknown, so that the bridge is left out.
        capacitance: Of the split link in F that its row is computed with.
        without_phase: What constant torque costs on four legs with a phase open, None where it
            cannot be made.
        unsimulated: Why no row was simulated, empty where they were; ``uncounted`` the same of the
            cycles.
    """

    torque: float
    omega_m: float
    v_dc: float
    rows: tuple[FlashRow, ...]
    without_device: bool
    capacitance: float
    without_phase: OpenPhasePrice | None = None
    unsimulated: str = "the rows were not simulated"
    uncounted: str = "the cycles were not counted"

    def row(self, topology: Topology, frame: CurrentFrame) -> FlashRow:
        """The row of a topology with a controller."""
        return next(r for r in self.rows if (r.topology, r.frame) == (topology, frame))


def variant(design: Design, topology: Topology, frame: CurrentFrame, capacitance: float) -> Design:
    """The design with another topology and controller; everything else as it is.

    Args:
        design: Any design of a phase machine.
        topology, frame: What feeds it, and how its current is controlled; ``table`` runs harmonic
            integrators.
        capacitance: Of a split link in F.
    """
    loop = replace(
        design.control.current_loop,
        frame=frame,
        feedforward="references",
        harmonic_integrators=frame == "table",
    )
    inverter = replace(design.inverter, topology=topology)
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is None:
        inverter = replace(inverter, midpoint_capacitance=capacitance)
    return replace(design, inverter=inverter, control=replace(design.control, current_loop=loop))


@on_design("waveform")
def compare_flashing(design: Design, settings: WaveformSettings | None = None) -> FlashComparison:
    """Every topology with every controller: losses, voltage, ripple and table, in closed form.

    Args:
        design: The design; its own topology is one among the others.
        settings: The operating point; that of the design when None.

    Raises:
        InputError: The machine has a sinusoidal back-EMF, or the point has no torque or no speed.
    """
    machine = require_phases(design)
    chosen = design.waveform if settings is None else settings
    torque, omega_m = operating_point(design, chosen)
    if torque == 0.0 or omega_m == 0.0:
        raise InputError("--flash compares at a torque and a speed; neither may be 0")
    capacitance = _capacitance(design, machine, torque, omega_m)
    gains = solve_gains(variant(design, "three-wire", "dq", capacitance))
    loops = gains.i_d, gains.i_q
    rows = [
        _row(variant(design, topology, frame, capacitance), loops, torque, omega_m)
        for topology in COMPARED
        for frame in compared_frames(topology)
    ]
    return FlashComparison(
        torque=torque,
        omega_m=omega_m,
        v_dc=design.inverter.v_dc,
        rows=tuple(rows),
        without_device=design.inverter.device is None,
        capacitance=capacitance,
        without_phase=open_phase_price(machine, "four-leg", chosen.open_phase or "a", torque)
        if isinstance(machine, PhaseMachine)
        else None,
    )


def _capacitance(design: Design, machine: AnyPhaseMachine, torque: float, omega_m: float) -> float:
    """Both halves of the split link in F: the design's, or what holds the midpoint at the point."""
    given = design.inverter.midpoint_capacitance
    if given is not None:
        return given
    through = np.sum(reference_currents(design, machine, "dqy", "six-leg", torque), axis=0)
    charge = np.cumsum(through - np.mean(through)) / through.size * 2.0 * math.pi
    swing = float(np.ptp(charge)) / (machine.pole_pairs * abs(omega_m))
    return max(swing / (SPLIT_SWING * design.inverter.v_dc), 1e-6)


def reference_currents(
    design: Design,
    machine: AnyPhaseMachine,
    frame: CurrentFrame,
    topology: Topology,
    torque: float,
) -> FloatArray:
    """Phase currents in A, shape (3, N), that a controller asks for.

    Args:
        design, machine: The drive.
        frame, topology: The controller; ``table`` asks for the least loss of the topology.
        torque: In N m.
    """
    zero = frame == "dqy" or (frame == "table" and TOPOLOGIES[topology].neutral)
    if frame == "dq":
        if isinstance(machine, PhaseMachine):
            i_q = torque / design.machine.torque_per_ampere
            return dq_waveform(0.0, i_q, machine.angles, machine.turns)
        return np.asarray(pointwise_dq(design, torque, machine))
    # The table of a salient machine makes no use of its saliency.
    phases = machine if isinstance(machine, PhaseMachine) else machine.phases
    return np.asarray(torque * unit_currents(phases, "dqy" if zero else "dqx"))


def pointwise_dq(design: Design, torque: float, machine: AnyPhaseMachine) -> FloatArray:
    """Sinusoidal currents in A of a salient machine by MTPA, shape (3, N).

    Args:
        design: The design, of whose machine in dq coordinates it is.
        torque: In N m.
        machine: The machine, on whose angles they are.
    """
    from dqforge.optimizer.operating_points.current_choice import CurrentChoice

    i_d, i_q = CurrentChoice(design.machine, "mtpa", design.i_max).currents(np.array([abs(torque)]))
    i_q_signed = math.copysign(float(i_q[0]), torque)
    return dq_waveform(float(i_d[0]), i_q_signed, machine.angles, machine.turns)


def _row(
    design: Design, loops: tuple[LoopGains, LoopGains], torque: float, omega_m: float
) -> FlashRow:
    """One row, or why it cannot be; ``design`` is the variant of the row."""
    topology, frame = design.inverter.topology, design.control.current_loop.frame
    assert frame is not None
    machine = require_phases(design)
    try:
        currents = reference_currents(design, machine, frame, topology, torque)
        control = phase_control(design, *loops, within_link=False).control
    except (NoSolutionError, InputError) as error:
        return _empty(topology, frame, error.message.removeprefix(_KEY))
    budget = phase_budget(
        machine,
        design.inverter,
        currents[np.newaxis],
        np.array([omega_m]),
        options=budget_options(design),
        friction=design.machine.friction,
    )
    return _filled(design, control, currents, budget, omega_m)


def _empty(topology: Topology, frame: CurrentFrame, reason: str) -> FlashRow:
    nothing = math.nan
    return FlashRow(topology, frame, reason, nothing, nothing, nothing, nothing, nothing, None, 0)


def _filled(
    design: Design,
    control: PhaseControl,
    currents: FloatArray,
    found: PhaseBudget,
    omega_m: float,
) -> FlashRow:
    """A row with its figures."""
    machine, inverter = require_phases(design), design.inverter
    terminals = phase_terminals(
        machine, currents[np.newaxis], np.array([omega_m]), inverter.topology
    )
    wave = leg_waveforms(
        inverter.topology,
        terminals.voltages,
        terminals.currents,
        inverter.v_dc,
        inductance_over_angle(machine) + inverter.neutral_inductance,
    )
    left = float(dead_time_factor("svpwm", inverter.dead_time, inverter.f_sw))
    budget, place = found.budget, (0, 0)
    link = float(found.link_demand[place]) / left if left > 0.0 else math.inf
    peak = float(np.max(np.abs(currents)))
    obstacles = [
        f"the link ends at {inverter.v_dc:.4g} V" if link > inverter.v_dc else "",
        f"{peak:.4g} A are above the limit of {design.i_max:.4g} A"
        if peak > design.i_max * (1.0 + 1e-6)
        else "",
    ]
    legs = found.leg_loss[place]
    names = TOPOLOGIES[inverter.topology].legs
    return FlashRow(
        topology=inverter.topology,
        frame=control.frame,
        obstacle=", ".join(filter(None, obstacles)),
        copper=float(budget.copper[place] + budget.ripple_copper[place]),
        bridge=float(np.sum(legs)),
        neutral_leg=float(legs[names.index("n")]) if "n" in names else math.nan,
        link=link,
        neutral=float(np.hypot(found.neutral_current[place], found.neutral_ripple[place])),
        ripple=ripple_figures(machine, inverter, control, currents, wave, omega_m),
        constants=4 * control.shape.flux.shape[0] * (control.shape.flux.shape[1] + 1),
        control=control,
    )


def with_rows(
    found: FlashComparison,
    rows: Sequence[FlashRow],
    *,
    unsimulated: str | None = None,
    uncounted: str | None = None,
) -> FlashComparison:
    """The comparison with rows that know more, and what is said of what they do not know.

    Args:
        found: The comparison.
        rows: Its rows, in their order.
        unsimulated, uncounted: As in the comparison; None leaves what it says.
    """
    return replace(
        found,
        rows=tuple(rows),
        unsimulated=found.unsimulated if unsimulated is None else unsimulated,
        uncounted=found.uncounted if uncounted is None else uncounted,
    )


# What a current loop leaves of a periodic disturbance, in closed form.
#
# The loop is linear and the same at every angle where its integrators live in dq0: a voltage that
# disturbs the order m of the stationary frame makes the current
#
#   di_m = dV_m / (R + j w L + kp G + ki G / (j (w - w_0))),   w = m omega_e,  G = exp(-1.5 j w T_s)
#
# with w_0 = omega_e in the plane (the integrators turn along) and 0 on the zero sequence; orders
# that have an integrator of their own vanish. 1.5 samples pass from the measurement to the middle
# of what the voltage does. Currents change nothing in each other's orders, and add up. The frames
# dqx and dqy differ in their integrators only, which is left out.

ComplexArray = NDArray[np.complex128]

DELAY = 1.5


_FADES_FROM = 0.8


def stationary(phases: FloatArray) -> tuple[ComplexArray, FloatArray]:
    """Alpha and beta as a complex waveform (N,), and the mean of the phases (N,).

    Args:
        phases: Phase quantities, shape (3, N).
    """
    turn = np.exp(2j * np.pi / 3.0 * np.arange(3))
    return np.asarray(2.0 / 3.0 * (turn @ phases)), np.asarray(np.mean(phases, axis=0))


def phases_of(plane: ComplexArray, zero: FloatArray) -> FloatArray:
    """Phase quantities (3, N) of alpha, beta and the zero sequence.

    Args:
        plane, zero: As from `stationary`.
    """
    turn = np.exp(-2j * np.pi / 3.0 * np.arange(3))
    return np.asarray(np.real(turn[:, np.newaxis] * plane) + zero)


def _integrated(
    control: PhaseControl, omega_e: float, orders: FloatArray, *, zero: bool
) -> FloatArray:
    """Share of each signed order that an integrator of its own takes away, 0 to 1."""
    share = np.zeros(orders.shape)
    if control.harmonics is None:
        return share
    for order in control.harmonics.zero if zero else control.harmonics.plane:
        frequency = abs(order * omega_e) / (2.0 * np.pi)
        left = (1.0 - frequency / control.harmonics.frequency_max) / (1.0 - _FADES_FROM)
        hit = np.abs(orders) == abs(order) if zero else orders == order
        share = np.where(hit, 1.0 if left > 0.0 else 0.0, share)
    return share


def _impedance(
    gains: AxisGains, r_s: float, inductance: float, w: FloatArray, turn: float, t_s: float
) -> ComplexArray:
    """Voltage over current in Ohm of the closed loop at angular frequencies in rad/s; infinite
    where the integrator stands.
    """
    late = np.exp(-1j * DELAY * w * t_s)
    slip = w - turn
    still = slip == 0.0
    integral = gains.ki / (1j * np.where(still, 1.0, slip)) * late
    found = r_s + 1j * w * inductance + gains.kp * late + integral
    return np.asarray(np.where(still & (gains.ki > 0.0), np.inf, found))


def residual_currents(
    control: PhaseControl,
    disturbance: FloatArray,
    omega_e: float,
    share: float = 1.0,
    turns: int = 1,
) -> FloatArray:
    """Phase currents in A, shape (3, N), that the loop leaves of voltages.

    Args:
        control: Gains, inductances and integrators.
        disturbance: Voltages in V that act on the phases beside what the controller knows, shape
            (3, N).
        omega_e: Electrical speed in rad/s, not 0.
        share: Inductance of the plant over the model's.
        turns: Electrical periods that the waveforms span; orders between the whole ones count.
    """
    plane, zero = stationary(disturbance)
    orders = np.fft.fftfreq(plane.size, turns / plane.size).astype(np.float64)
    w = orders * omega_e
    l_ab = 0.5 * (control.inductances[0] + control.inductances[1])
    found = []
    for values, gains, inductance, turn, is_zero in (
        (plane, control.gains[1], l_ab, omega_e, False),
        (zero.astype(np.complex128), control.gains[2], control.inductances[2], 0.0, True),
    ):
        impedance = _impedance(gains, control.r_s, share * inductance, w, turn, control.t_s)
        left = 1.0 - _integrated(control, omega_e, orders, zero=is_zero)
        lines = np.fft.fft(values) * left / impedance
        found.append(np.fft.ifft(lines))
    return phases_of(found[0], np.real(found[1]))


def followed_offsets(control: PhaseControl, offset: FloatArray, omega_e: float) -> FloatArray:
    """Currents in A, shape (3,), that the machine gets because its sensors are off by ``offset``
    (3,) in A: the loop's answer at standstill of the stationary frame.

    Args:
        control: Gains and integrators.
        offset: Errors of the sensors of a, b and c.
        omega_e: Electrical speed in rad/s, not 0.
    """
    plane, zero = stationary(offset[:, np.newaxis])
    gains, gains_0 = control.gains[1], control.gains[2]
    action = gains.kp + gains.ki / (-1j * omega_e)
    answers = action / (control.r_s + action) * plane
    nothing = gains_0.kp == 0.0 and gains_0.ki == 0.0
    return -phases_of(answers, np.zeros(1) if nothing else zero)[:, 0]


def noise_gain(gains: AxisGains, r_s: float, inductance: float, t_s: float) -> float:
    """R.m.s. of a current over that of white noise of its sensor, proportional action alone.

    Args:
        gains: Of the axis.
        r_s, inductance: Of the axis in Ohm and H.
        t_s: Sampling period in s.
    """
    z = np.exp(1j * np.linspace(-np.pi, np.pi, 4096, endpoint=False))
    pole = np.exp(-r_s * t_s / inductance)
    plant = (1.0 - pole) / r_s / (z - pole) / z
    answer = gains.kp * plant / (1.0 + gains.kp * plant)
    return float(np.sqrt(np.mean(np.abs(answer) ** 2)))


# Torque ripple of a controller in closed form: what its references make, and what its loop leaves
# of dead time and of a model that is not quite the machine.

_PEAKS = 6.0  # Peak to peak of noise over its r.m.s., as it is seen in a second of samples.


def dead_time_voltages(inverter: Inverter, wave: LegWaveforms) -> FloatArray:
    """Voltages in V that dead time takes from the phases, shape (3, N).

    Half of it falls on each edge, by the sign that the leg's current has there.

    Args:
        inverter: Dead time, carrier and link.
        wave: Legs of one point.
    """
    flux = inverter.v_dc / inverter.f_sw
    current, away = wave.current[0], flux * wave.rising[0]
    signs = 0.5 * (np.sign(current + away) + np.sign(current - away))
    volts = inverter.dead_time * inverter.f_sw * inverter.v_dc
    lost = leg_signs(inverter.topology) @ np.where(wave.clamped[0], 0.0, -volts * signs)
    if not TOPOLOGIES[inverter.topology].neutral:
        lost = lost - np.mean(lost, axis=0)
    return np.asarray(lost)


def ripple_figures(
    machine: AnyPhaseMachine,
    inverter: Inverter,
    control: PhaseControl,
    currents: FloatArray,
    wave: LegWaveforms,
    omega_m: float,
) -> RippleFigures:
    """Torque ripple over the mean torque.

    Args:
        machine, inverter, control: The drive.
        currents: References in A, shape (3, N).
        wave: Legs of the point, with one row.
        omega_m: Mechanical speed in rad/s, not 0.
    """
    omega = machine.pole_pairs * omega_m
    neutral = TOPOLOGIES[inverter.topology].neutral
    dead = dead_time_voltages(inverter, wave)
    linked = np.einsum("jkl,lj->kj", inductance_over_angle(machine), currents)
    deviations = {
        "inductance": (
            -INDUCTANCE * omega * derivative(linked, machine.turns),
            1.0 + INDUCTANCE,
            1.0,
        ),
        "back_emf": (-BACK_EMF * omega * machine.flux, 1.0, 1.0 + BACK_EMF),
    }

    def ripple(voltages: FloatArray, added: FloatArray, share: float, flux: float) -> float:
        left = residual_currents(
            control, _within(voltages, neutral=neutral), omega, share, machine.turns
        )
        torque = flux * machine.torque(currents + left + added)
        return float(np.ptp(torque) / abs(np.mean(torque)))

    none = np.zeros((3, 1))
    plain = ripple(dead, none, 1.0, 1.0)
    deviating = {
        name: ripple(dead + volts, none, share, flux)
        for name, (volts, share, flux) in deviations.items()
    }
    offset = followed_offsets(control, OFFSET * np.array([1.0, 0.0, 0.0]), omega)
    deviating["offset"] = ripple(dead, offset[:, np.newaxis], 1.0, 1.0)
    deviating["noise"] = math.hypot(plain, _noise_ripple(machine, control, currents))
    return RippleFigures(plain, deviating)


def _within(voltages: FloatArray, *, neutral: bool) -> FloatArray:
    """Voltages that can drive a current."""
    return voltages if neutral else voltages - np.mean(voltages, axis=0)


def _noise_ripple(machine: AnyPhaseMachine, control: PhaseControl, currents: FloatArray) -> float:
    """Peak to peak of the torque, over its mean, that white noise of three sensors makes."""
    plane = machine.flux - np.mean(machine.flux, axis=0)
    zero = np.mean(machine.flux, axis=0)
    l_ab = 0.5 * (control.inductances[0] + control.inductances[1])
    gain = noise_gain(control.gains[1], control.r_s, l_ab, control.t_s)
    gain_0 = noise_gain(control.gains[2], control.r_s, control.inductances[2], control.t_s)
    square = gain**2 * np.sum(plane**2, axis=0) + 3.0 * gain_0**2 * zero**2
    rms = machine.pole_pairs * NOISE * np.sqrt(np.mean(square))
    return float(_PEAKS * rms / abs(np.mean(machine.torque(currents))))


# Which topology and controller this machine should have on this inverter, by watts and ripple.

# By how much the torque ripple of plain dq may be above that of the table, over the torque, for the
# simpler controller to be enough.
SMOOTH = 5e-3

# Share of the losses that more legs, or capacitors in halves, must save to be worth having.
WORTH = 5e-3


@dataclass(frozen=True, slots=True)
class Trade:
    """What another topology would change against the one to flash.

    ``copper_saved`` and ``bridge_added`` in W (the latter NaN without a device), ``neutral_leg``
    its loss in W or NaN, ``link_saved`` in V that the link could be lower, ``obstacle`` why it
    cannot be had, else empty.
    """

    topology: Topology
    copper_saved: float
    bridge_added: float
    neutral_leg: float
    link_saved: float
    obstacle: str

    @property
    def net(self) -> float:
        """Watts that it would save in all, negative where it costs; NaN where that is unknown."""
        return self.copper_saved - self.bridge_added


@dataclass(frozen=True, slots=True)
class Advice:
    """What to flash.

    ``row`` is None where nothing can be run at the point. ``dq_ripple`` is what plain dq would
    leave on the same topology, over the torque, and ``dq_saved`` the W that it would lose less.
    """

    row: FlashRow | None
    dq_ripple: float
    trades: tuple[Trade, ...]
    dq_saved: float = 0.0


def advise(found: FlashComparison) -> Advice:
    """The topology that loses least with the table, or the first that can be had where that saves
    less than `WORTH`; plain dq where its torque ripple is as good.

    Without a device the bridges cannot be weighed: then it is the first topology that can be had.

    Args:
        found: The comparison, with what was simulated of it.
    """
    tables = [_candidate(found, topology) for topology in COMPARED]
    possible = [row for row in tables if not row.obstacle]
    if not possible:
        return Advice(None, math.nan, ())
    best = possible[0]
    if not found.without_device:
        least = min(possible, key=lambda row: row.losses)
        best = least if least.losses < best.losses * (1.0 - WORTH) else best
    plain = found.row(best.topology, "dq")
    dq_ripple, ripple = _ripple(plain), _ripple(best)
    trades = tuple(_trade(row, best) for row in tables if row.topology != best.topology)
    enough = not plain.obstacle and dq_ripple <= ripple + SMOOTH
    saved = best.losses - plain.losses
    return Advice(plain if enough else best, dq_ripple, trades, saved)


def _candidate(found: FlashComparison, topology: Topology) -> FlashRow:
    """The table, or plain dq where that alone can be run."""
    table, plain = found.row(topology, "table"), found.row(topology, "dq")
    alone = table.control is None or (table.obstacle and not plain.obstacle)
    return plain if alone else table


def _ripple(row: FlashRow) -> float:
    known = row.ripple_known
    return math.nan if known is None else known.plain


def _trade(row: FlashRow, best: FlashRow) -> Trade:
    return Trade(
        row.topology,
        best.copper - row.copper,
        row.bridge - best.bridge,
        row.neutral_leg,
        best.link - row.link,
        row.obstacle,
    )


# The rows of the comparison: which topology with which controller, and what is known of each.

# What the torque ripple is asked for besides: an offset of one current sensor, noise of all of
# them, an inductance of the plant 30 % lower, and a back-EMF 5 % higher than the firmware's.
COMPARED: tuple[Topology, ...] = ("three-wire", "four-leg", "six-leg", "split-capacitor")
DEVIATIONS = ("offset", "noise", "inductance", "back_emf")
OFFSET = NOISE = 30e-3  # Of a sensor in A; the noise r.m.s.

# Relative deviations of the plant from the model in the firmware.
INDUCTANCE, BACK_EMF = -0.3, 0.05


@dataclass(frozen=True, slots=True)
class RippleFigures:
    """Torque ripple, peak to peak of the means over a PWM period, over the mean torque.

    Args:
        plain: With the design's dead time.
        deviating: With each of `DEVIATIONS` besides.
    """

    plain: float
    deviating: dict[str, float]


@dataclass(frozen=True, slots=True)
class FlashRow:
    """A topology with a controller at the operating point.

    Args:
        topology, frame: What is compared; ``table`` has harmonic integrators, the others none.
        obstacle: Why this cannot be run here; empty where it can. The numbers are NaN where it
            cannot.
        copper: Copper loss in W, of the switching's own currents and the neutral's conductor too.
        bridge: Loss of all legs in W; NaN where the design has no device.
        neutral_leg: Loss of the neutral's leg in W, NaN where there is none or it is not known.
        link: Voltage of the link in V that is needed, with what dead time takes.
        neutral: R.m.s. in A of the neutral current, that of the switching included.
        ripple: By closed form: references, and what the loop leaves of dead time and deviations.
        constants: Bytes of the table of the back-EMF.
        control: Current control of the row, None where it cannot be run.
        simulated: From the emitted C in the compiled simulation; None where it was not run.
        cycles: Mean estimate of a sample on the design's core, (low, high); None where it was not
            measured.
    """

    topology: Topology
    frame: CurrentFrame
    obstacle: str
    copper: float
    bridge: float
    neutral_leg: float
    link: float
    neutral: float
    ripple: RippleFigures | None
    constants: int
    control: PhaseControl | None = field(default=None, repr=False)
    simulated: RippleFigures | None = None
    cycles: tuple[float, float] | None = None

    @property
    def losses(self) -> float:
        """Copper and bridge in W; the copper alone where the bridge is not known."""
        return self.copper + (0.0 if self.bridge != self.bridge else self.bridge)

    @property
    def ripple_known(self) -> RippleFigures | None:
        """Simulated where it was simulated, else by closed form."""
        return self.ripple if self.simulated is None else self.simulated


def compared_frames(topology: Topology) -> tuple[CurrentFrame, ...]:
    """Controllers that are compared on a topology.

    Args:
        topology: Without a neutral there is no dqy.
    """
    if TOPOLOGIES[topology].neutral:
        return ("dq", "dqx", "dqy", "table")
    return ("dq", "dqx", "table")
