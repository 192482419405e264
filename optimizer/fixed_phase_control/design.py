"""Integers of the current control of a phase machine, from its real numbers and the bases."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import largest_phase_voltage
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.fixed_control.codes import sine_error
from dqforge.optimizer.fixed_control.design import (
    DC_HEADROOM,
    loop_integers,
    precise_gain,
    require_scales,
    speed_filter,
    torque_code,
)
from dqforge.optimizer.fixed_control.ranges import codes, pi_ranges, require, speed_ranges
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedAxis,
    FixedHarmonic,
    FixedMidpoint,
    FixedPhaseControl,
    Measured,
    Turning,
    phase_at_rest,
    phase_gains,
)
from dqforge.optimizer.fixed_phase_control.phase_step import PhaseSteps
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.phase_control.phase_controller import AxisGains, PhaseControl
from dqforge.optimizer.steps.code_vectors import Abc, Dq
from dqforge.optimizer.steps.integer_arithmetic import Range, Ranges, Reach

_FLUX_ROOM = 1.05  # of the full scale of the flux over the largest value of any axis


_MOST_FRACTION = 14


@dataclass(frozen=True, slots=True)
class FixedPhaseFit:
    """Integers with their evidence.

    ``reaches`` are the proven ranges of every product and sum; ``shape_error`` is the largest error
    of a node of the shape over its largest value, ``sine_error`` that of sine and cosine in codes.
    """

    control: FixedPhaseControl
    reaches: tuple[Reach, ...]
    shape_error: float
    sine_error: float

    @property
    def fullest(self) -> Reach:
        """The quantity that comes nearest to its word's end."""
        return max(self.reaches, key=lambda reach: reach.share)


def fit_phase_control(
    design: Design,
    control: PhaseControl,
    width: int = 16,
    speed: tuple[LoopGains, LoopGains] | None = None,
) -> FixedPhaseFit:
    """Integers of a phase machine's control for the bases of a design.

    Args:
        design: For the bases, and the link.
        control: The real numbers.
        width: Bits of a code.
        speed: Gains of the speed loop, and of the current loop that makes its torque; None without.

    Raises:
        InputError: The bases do not hold the largest current, speed or voltage.
        NoSolutionError: A quantity can overflow, or a gain has no format.
    """
    if control.feedforward == "measured":
        raise InputError(
            "control.current_loop.feedforward: measured is not there in fixed point; write "
            "references, or export.control: float32"
        )
    if control.inductances[0] != control.inductances[1]:
        raise InputError(
            "export.control: machines with inductance_harmonics are controlled in float32 alone; "
            "write float32"
        )
    _require_bases(design, control)
    bases = design.control.bases
    flux_base = _flux_base(control.shape.flux)
    scales = (bases.current, bases.voltage, bases.speed, bases.torque, flux_base)
    made = _integers(design, control, scales, width, speed)
    codes = np.array(made.shape)[:, :-1] * (flux_base / 2 ** (width - 1))
    error = np.max(np.abs(codes - control.shape.flux)) / np.max(np.abs(control.shape.flux))
    return FixedPhaseFit(made, phase_ranges(made), float(error), sine_error(width))


def _three_rows(flux: FloatArray) -> FloatArray:
    """Flux of all phases, shape (3, N)."""
    if flux.shape[0] == 3:
        return flux
    third = flux.shape[1] // 3
    return np.stack([np.roll(flux[0], third * phase) for phase in range(3)])


def _flux_base(flux: FloatArray) -> float:
    rows = _three_rows(flux)
    axes = clarke_matrix() @ rows
    return _FLUX_ROOM * float(max(np.max(np.abs(rows)), np.max(np.abs(axes))))


def _require_bases(design: Design, control: PhaseControl) -> None:
    require_scales(design)
    bases = design.control.bases
    needed = largest_phase_voltage(control.topology, design.inverter.v_dc)
    if bases.voltage < needed * (1.0 - 1e-9):
        raise InputError(
            f"control.per_unit.voltage: {bases.voltage:.4g} V is full scale in fixed point, but "
            f"phases of {control.topology} reach {needed:.4g} V; write voltage: {needed:.4g} V"
        )


def _finest(name: str, value: float, width: int, argument: int) -> tuple[FixedGain, int]:
    """A gain to a state with the most further bits, and how many."""
    for fraction in range(min(_MOST_FRACTION, width - 2), -1, -1):
        try:
            return precise_gain(name, value * 2.0**fraction, width, argument), fraction
        except NoSolutionError:
            continue
    raise NoSolutionError(
        f"fixed point: {name}, {value:.4g} per unit, has no format of {width} bits; use other bases"
    )


def _axis(
    name: str,
    control: PhaseControl,
    gains: AxisGains,
    inductance: float,
    scales: tuple[float, float, float],
    width: int,
) -> FixedAxis:
    """Controller of one axis; ``scales`` are current in A, voltage in V, electrical speed."""
    current, voltage, omega_e = scales
    ohm, error, code = current / voltage, 2**width - 1, 2 ** (width - 1)
    ki, fraction = _finest(f"ki t_s of {name}", gains.ki * control.t_s * ohm, width, code)
    return FixedAxis(
        kp=precise_gain(f"kp of {name}", gains.kp * ohm, width, error),
        ki=ki,
        fraction=fraction,
        resistance=precise_gain(f"resistance of {name}", control.r_s * ohm, width, code),
        inductance=precise_gain(f"L / t_s of {name}", inductance / control.t_s * ohm, width, error),
        reactance=precise_gain(f"reactance of {name}", omega_e * inductance * ohm, width, code),
    )


def _harmonics(
    control: PhaseControl, scales: tuple[float, float, float], width: int
) -> tuple[FixedHarmonic, ...]:
    part, code = control.harmonics, 2 ** (width - 1)
    if part is None:
        return ()
    current, voltage, omega_e = scales
    found = []
    for zero, orders in ((False, part.plane), (True, part.zero)):
        inductance = control.inductances[2 if zero else 1]
        for order in orders:
            end = 2.0 * math.pi * part.frequency_max / abs(order) / omega_e  # of the base speed
            if 0.8 * end * code < 1.0:
                continue  # it fades below the first code of the speed
            reactance = abs(order) * omega_e * inductance * current / voltage
            found.append(
                FixedHarmonic(
                    order=order,
                    zero=zero,
                    reactance=precise_gain(f"reactance of order {order}", reactance, width, code),
                    fade=precise_gain(f"fade of order {order}", 5.0 / end, width, code),
                    end=round(min(end, 2.0) * code),
                )
            )
    return tuple(found)


def _midpoint(
    control: PhaseControl, bases: tuple[float, float, float], dc_base: float, width: int
) -> FixedMidpoint | None:
    if control.midpoint is None:
        return None
    current, _, omega_e = bases
    code = 2 ** (width - 1)
    fade = 0.0 if control.midpoint.omega_e_min <= 0.0 else omega_e / control.midpoint.omega_e_min
    return FixedMidpoint(
        balance=precise_gain("midpoint", control.midpoint.balance * dc_base / current, width, code),
        fade=FixedGain(code - 1, 0, float(code - 1))
        if fade <= 0.0 or fade > 2.0 ** (width - 2)
        else precise_gain("midpoint's fade", fade, width, code),
    )


def _rows(flux: FloatArray, base: float, width: int) -> tuple[tuple[int, ...], ...]:
    top = 2 ** (width - 1) - 1
    codes = np.clip(np.rint(flux / base * 2.0 ** (width - 1)), -top, top).astype(np.int64)
    closed = np.concatenate([codes, codes[:, :1]], axis=1)
    return tuple(tuple(row) for row in closed.tolist())


def _least_square(control: PhaseControl, flux_base: float) -> float:
    """Least of alpha^2 + beta^2 (+ 2 zero^2) over the period, per unit."""
    axes = clarke_matrix() @ _three_rows(control.shape.flux) / flux_base
    square = axes[0] ** 2 + axes[1] ** 2
    return float(np.min(square + (2.0 * axes[2] ** 2 if control.frame == "dqy" else 0.0)))


def _integers(
    design: Design,
    control: PhaseControl,
    bases: tuple[float, float, float, float, float],
    width: int,
    loops: tuple[LoopGains, LoopGains] | None,
) -> FixedPhaseControl:
    current, voltage, speed, torque, flux = bases
    omega_e, code = control.pole_pairs * speed, 2 ** (width - 1)
    scales = (current, voltage, omega_e)
    dc_scale = max(0, math.ceil(math.log2(design.inverter.v_dc * DC_HEADROOM / voltage)))
    dc_base = voltage * 2.0**dc_scale
    # An open phase or unequal ones reach down to a part of the square of equal ones.
    least = 0.2 * _least_square(control, flux)
    unit = torque / (torque_per_ampere(control.pole_pairs, flux) * current)
    largest = unit * control.torque_max / torque / max(least, 1e-3)
    unit_bits = max(0, math.ceil(math.log2(max(largest, 1e-9))))
    samples = 2.0 * math.pi / (omega_e * control.t_s)  # per electrical period at the base speed
    begin, end = (samples / count for count in control.fade)  # over the base speed
    rate = 0.0 if control.harmonics is None else control.harmonics.rate * control.t_s
    learning, harmonic_fraction = (
        _finest("rate of the harmonics", rate, width, code)
        if rate > 0.0
        else (FixedGain(0, 0, 0.0), 0)
    )
    zero = control.gains[2]
    most = 0.0 if control.harmonics is None else control.harmonics.error_max
    return FixedPhaseControl(
        width=width,
        bases=bases,
        frame=control.frame,
        feedforward=control.feedforward,
        topology=control.topology,
        shape=_rows(control.shape.flux, flux, width),
        turns=control.shape.turns,
        fundamental=round(control.psi_pm / flux * code),
        fade=FixedGain(code - 1, 0, code - 1.0)
        if begin >= 1.0
        else precise_gain("fade", min(1.0 / (end - begin), 2.0 ** (width - 4)), width, code),
        fade_end=2 * code if begin >= 1.0 else round(end * code),
        unit=precise_gain("current per torque", unit / 2.0**unit_bits, width, code),
        unit_bits=unit_bits,
        least_square=max(1, round(least * code)),
        sample=precise_gain("turn in a sample", 2.0 / samples / control.shape.turns, width, code),
        electrical=precise_gain("back-EMF", omega_e * flux / voltage, width, code),
        d=_axis("d", control, control.gains[0], control.inductances[0], scales, width),
        q=_axis("q", control, control.gains[1], control.inductances[1], scales, width),
        zero=None
        if zero.kp == 0.0
        else _axis("0", control, zero, control.inductances[2], scales, width),
        rate=learning,
        harmonic_fraction=harmonic_fraction,
        error_max=round(most / current * code),
        harmonics=_harmonics(control, scales, width),
        midpoint=_midpoint(control, scales, dc_base, width),
        dc_scale=dc_scale,
        dc_least=round(0.5 * design.inverter.v_dc / dc_base * code),
        current_per_torque=_current_per_torque(control, torque / current, width),
        speed=None if loops is None else loop_integers(design, loops[0], width, loops[1], 0)[1],
        speed_filter=speed_filter(design, width),
        torque_max=torque_code(design, control.torque_max, width),
        ratio=1 if design.control.speed_loop is None else design.control.speed_loop.ratio,
    )


def _current_per_torque(control: PhaseControl, bases: float, width: int) -> FixedGain:
    """From the torque to the q current of sinusoids; ``bases`` in N m/A."""
    flux = torque_per_ampere(control.pole_pairs, control.psi_pm)
    return precise_gain("current per torque", bases / flux, width, 2 ** (width - 1))


# Proof that nothing overflows in the integers of a phase machine's control.


def phase_ranges(control: FixedPhaseControl) -> tuple[Reach, ...]:
    """Range of every named product and sum of the step, from any codes and any state.

    Raises:
        NoSolutionError: A quantity can leave its word; the message names it.
    """
    width, top = control.width, control.top
    found = Ranges(width, "phase control: ")
    every, angle = codes(width), Range(0, 2**width - 1)

    def held(fraction: int) -> Range:
        return Range(-top << fraction, top << fraction)

    state, turning = phase_at_rest(control, found.const(0)), held(control.harmonic_fraction)
    axes = (control.d, control.q, control.zero)
    d, q, zero = (held(0 if axis is None else axis.fraction) for axis in axes)
    state.integral = (d, q, zero)
    state.harmonic = tuple(Turning(turning, turning) for _ in control.harmonics)
    state.open_phase = Range(0, 3)
    middle = None if control.midpoint is None else Range(0, top)
    measured = Measured(Abc(every, every, every), angle, every, every, middle)
    steps, gains = PhaseSteps(control), phase_gains(control)
    steps.shaped_control(found, gains, state, measured, every, Dq(every, every))
    steps.references.sinusoids(found, gains, every)
    parts = [found, speed_ranges(control)]
    if control.speed is not None:
        parts += [pi_ranges(width, "speed", pi, form) for form, pi in control.speed.items()]
    for part in parts:
        require(part)
    return tuple(reach for part in parts for reach in part.reaches.values())
