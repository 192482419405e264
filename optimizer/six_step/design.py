"""A six-step drive designed: its waveform, errors and speed range, its loops and its start."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import SixStepSettings, filter_share
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import LoopGains, tune_current_loop
from dqforge.optimizer.loops.pi_methods import speed_pi
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.optimizer.six_step.control import SixStepGains
from dqforge.optimizer.six_step.sector_step import BlockGains
from dqforge.optimizer.six_step.sectors import (
    SECTOR,
    BlockShape,
    block_shape,
    dq_inductances,
    phases_of,
)

_OFFSET = 0.002  # of the link voltage, where nothing is said
_THRESHOLD = 0.2  # V of a diode and its comparator, where nothing is said


_FULL_SCALE = 1.25  # of the converter of the terminal voltages, over the link voltage


_MARGIN = 1.15  # of the unseen time over that of the freewheeling


_LEAST_DUTY = 0.02  # on-time in which a converter can sample


_BLANK = 1.5  # periods that are never seen after a commutation, of a diode one more


_PATIENCE = 3.0


_GRID = 600


@dataclass(frozen=True, slots=True)
class BlockLimits:
    """What bounds the speeds of a six-step drive, electrical in rad/s.

    Args:
        low, high: Least and largest speed at which all of them hold.
        by_error: From which to which speed the error of the commutation stays within the limit.
        by_duty: Speed above which the duty cycle exceeds the least one without load.
        by_freewheeling: Speed up to which the phase that was switched off is free of current before
            the crossing.
        freewheeling: Angle in rad that this takes at most within the range, at the current limit.
    """

    low: float
    high: float
    by_error: tuple[float, float]
    by_duty: float
    by_freewheeling: float
    freewheeling: float


@dataclass(frozen=True, slots=True, eq=False)
class SixStepDesign:
    """A six-step drive.

    Args:
        method: One of `dqforge.machines.names.SIX_STEP_METHODS`.
        phases: The machine in phase quantities.
        shape: What its waveform makes of blocks.
        disturbed: Errors of the measured voltage.
        errors: Of the commutation at speeds of the range.
        limits: The range.
        current, speed: Loops; the latter None without one.
        start: Alignment, ramp and hand-over.
        gains: What is emitted.
        curve: Errors over the speed, beyond the range as well.
    """

    method: str
    phases: AnyPhaseMachine
    shape: BlockShape
    disturbed: Disturbed
    errors: CommutationErrors
    limits: BlockLimits
    current: LoopGains
    speed: BlockSpeedLoop | None
    start: BlockStart
    gains: SixStepGains
    curve: CommutationErrors

    @property
    def by_integral(self) -> bool:
        """Whether the integral decides."""
        return self.method == "emf-integration"

    def errors_at(self, omega: float) -> CommutationErrors:
        """Errors of the commutation at an electrical speed in rad/s."""
        known = np.array([omega])
        return commutation_errors(self.shape, self.disturbed, known, by_integral=self.by_integral)


def backwards(machine: AnyPhaseMachine) -> PhaseMachine:
    """The waveform as a machine that turns the other way sees it; inductances play no part.

    Args:
        machine: In phase quantities.
    """
    made = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    mirrored = -np.roll(made.flux[:, ::-1], 1, axis=1)
    return PhaseMachine(
        made.pole_pairs,
        made.r_s,
        made.l_s,
        made.m_s,
        mirrored[[0, 2, 1]],
        made.i_max,
        made.turns,
    )


def freewheeling_angle(design: Design, shape: BlockShape, omega: np.ndarray) -> np.ndarray:
    """Electrical angle in rad in which the phase that was switched off frees the largest current.

    L di/dt = -(d v_dc/3 + omega g_c): the mean of the star point above the rail at which its diode
    holds it, and its own back-EMF; d v_dc is what current and speed need.

    Args:
        design: Machine and current limit.
        shape: Of its waveform.
        omega: Electrical speeds in rad/s.
    """
    machine, i = design.machine, design.i_max
    applied = np.minimum(shape.emf * omega + 2.0 * machine.r_s * i, design.inverter.v_dc)
    against = applied / 3.0 + shape.level * omega
    return np.asarray(omega * 0.5 * (machine.l_d + machine.l_q) * i / against)


def _disturbed(
    design: Design,
    settings: SixStepSettings,
    phases: AnyPhaseMachine,
    shape: BlockShape,
    *,
    by_diode: bool,
) -> Disturbed:
    v_dc = design.inverter.v_dc
    step = _FULL_SCALE * v_dc / 2.0**settings.voltage_bits
    offset = settings.voltage_offset
    noise = settings.voltage_noise
    l_d, l_q = dq_inductances(phases)
    away = abs(l_q - l_d)
    if by_diode:
        rate = -(l_q - l_d) / (math.sqrt(3.0) * 0.5 * (l_d + l_q))
        return Disturbed(
            offset=(_THRESHOLD if offset is None else offset) / STAR,
            noise=0.0,
            t_s=design.control.t_s,
            filter_time=0.0,
            free=SECTOR / 6.0,
            step=away * design.i_max,
            kappa=rate * 2.0 * design.machine.r_s * design.i_max,
            bend=rate * shape.emf,
            by_diode=True,
        )
    return Disturbed(
        offset=(_OFFSET * v_dc if offset is None else offset) + 0.5 * step,
        noise=step if noise is None else noise,
        t_s=design.control.t_s,
        filter_time=settings.filter_time,
        free=SECTOR / 6.0,
        step=away * design.i_max,
        kappa=(l_q - l_d) * v_dc / (math.sqrt(3.0) * 0.5 * (l_d + l_q)),
    )


def _span(omega: np.ndarray, good: np.ndarray) -> tuple[float, float]:
    """Least and largest of the speeds that are good; nan where none is."""
    found = omega[good]
    return (float(found[0]), float(found[-1])) if found.size else (math.nan, math.nan)


def _limits(
    design: Design, shape: BlockShape, known: Disturbed, duty: float, *, by_integral: bool
) -> BlockLimits:
    """Speeds at which the blocks hold; raises `NoSolutionError` with the numbers."""
    machine, v_dc, t_s = design.machine, design.inverter.v_dc, design.control.t_s
    top = min(v_dc / shape.peak, math.pi / 12.0 / t_s)
    if machine.omega_m_max is not None:
        top = min(top, machine.pole_pairs * machine.omega_m_max)
    omega = np.geomspace(1e-4 * top, top, _GRID)
    error = commutation_errors(shape, known, omega, by_integral=by_integral).largest
    by_error = _span(omega, error <= ANGLE_LIMIT)
    if math.isnan(by_error[0]):
        k = int(np.argmin(error))
        raise NoSolutionError(
            f"control.observer: at every speed a commutation may err by more than "
            f"{math.degrees(ANGLE_LIMIT):.3g} deg, at best by {math.degrees(error[k]):.3g} deg at "
            f"{omega[k]:.4g} rad/s (electrical; saliency alone {_saliency_text(shape, known)}); "
            "measure the voltage better (control.six_step), sample faster, or choose another "
            "observer"
        )
    free = freewheeling_angle(design, shape, omega) * _MARGIN
    window = SECTOR - shape.delay
    blank = _BLANK + (1.5 if known.by_diode else 0.5)
    by_free = _span(omega, free + blank * omega * t_s <= window)[1]
    if math.isnan(by_free):
        raise NoSolutionError(
            f"control.observer: at {design.i_max:.4g} A the phase that is switched off carries "
            f"current for {math.degrees(free[0]):.3g} deg, its back-EMF crosses zero after "
            f"{math.degrees(window):.3g} deg; permit less current, or choose another observer"
        )
    by_duty = duty * v_dc / shape.emf
    low, high = max(by_error[0], by_duty), min(by_error[1], by_free)
    if not low < 0.5 * high:
        raise NoSolutionError(
            "control.observer: the voltage of the floating phase serves from "
            f"{low:.4g} rad/s (electrical; offset, noise and duty cycle) only up to {high:.4g} "
            "rad/s (freewheeling and sampling); measure it better (control.six_step), sample "
            "faster, or choose another observer"
        )
    inside = (omega >= low) & (omega <= high)
    return BlockLimits(low, high, by_error, by_duty, by_free, float(np.max(free[inside]) / _MARGIN))


def _saliency_text(shape: BlockShape, known: Disturbed) -> str:
    return f"{math.degrees(known.step / shape.slope):.3g} deg"


def _require_machine(design: Design) -> None:
    if design.machine.inertia is None:
        raise InputError(
            "control.observer: a six-step drive is started by a ramp, which needs the inertia; "
            "write machine.inertia, such as 200e-6 kg m^2"
        )


def _diode_delay(design: Design, shape: BlockShape) -> float:
    """Periods from the crossing until the diode conducts, over the squared periods of 60 degrees.

    While both chopped and resting leg lie at one rail, the floating phase stands 1.5 u off it.
    """
    device = design.inverter.device
    threshold = 0.0 if device is None else device.diode_voltage
    return threshold * design.control.t_s / (STAR * shape.slope * SECTOR**2)


@on_design("control")
def solve_six_step(design: Design) -> SixStepDesign | None:
    """The six-step drive that a design asks for, None for others.

    Raises:
        InputError: The machine has no inertia.
        NoSolutionError: The voltage of the floating phase does not show the position well enough at
            any speed, or a loop does not hold.
    """
    control = design.control
    settings, observer = control.six_step, control.observer
    if settings is None or observer is None:
        return None
    _require_machine(design)
    machine, t_s = design.machine, control.t_s
    by_integral = observer.method == "emf-integration"
    phases = phases_of(machine, design.phase_machine)
    shape, mirrored = block_shape(phases), block_shape(backwards(phases))
    if shape.spread > ANGLE_LIMIT:
        raise NoSolutionError(
            "control.observer: the zero crossings of this back-EMF lie up to "
            f"{math.degrees(shape.spread):.3g} deg off those that even blocks need, "
            f"{math.degrees(ANGLE_LIMIT):.3g} deg are permitted; choose another observer"
        )
    by_diode = observer.method == "diode-conduction"
    known = _disturbed(design, settings, phases, shape, by_diode=by_diode)
    duty = max(_LEAST_DUTY, (2.0 * design.inverter.dead_time) / t_s + 0.5 * _LEAST_DUTY)
    limits = _limits(design, shape, known, duty, by_integral=by_integral)
    l_d, l_q = dq_inductances(phases)
    current = tune_current_loop(machine.r_s, 0.5 * (l_d + l_q), t_s, control.current_loop, "i_q")
    speed = block_speed_loop(design, current, limits.low)
    start = plan_start(design, settings, shape, (limits.low, limits.high), 0.5 * (l_d + l_q))
    share = filter_share(settings.filter_time, t_s)
    estimator = BlockGains(
        t_s=t_s,
        by_integral=int(by_integral),
        delay=(shape.delay / SECTOR, mirrored.delay / SECTOR),
        threshold=(shape.threshold, mirrored.threshold),
        latency=1.0 if by_diode else 0.5 + (1.0 - share) / share,
        blank_share=_MARGIN * limits.freewheeling / SECTOR,
        blank_least=_BLANK + 1.0 if by_diode else _BLANK,
        smooth=1.0 if by_diode else share,
        patience=_PATIENCE,
        crossings=tuple(math.remainder(angle, 2.0 * math.pi) for angle in shape.crossings),
        late=_diode_delay(design, shape) if by_diode else None,
    )
    gains = SixStepGains(
        observer=estimator,
        kp=2.0 * current.kp,
        ki_ts=2.0 * current.ki_ts,
        emf=shape.emf,
        torque=shape.torque,
        i_max=design.i_max,
        duty_least=duty,
        speed_kp=0.0 if speed is None else speed.kp,
        speed_ki_ts=0.0 if speed is None else speed.ki * speed.t_s,
        omega_low=limits.low,
        speed_scale=1.0 if speed is None else speed.scale,
        pole_pairs=float(machine.pole_pairs),
        ratio=1 if speed is None else speed.ratio,
        omega_least=limits.low / machine.pole_pairs,
        omega_caught=start.omega,
        i_start=start.current,
        v_start=start.voltage,
        align=start.align,
        rise=start.rise,
        rate=start.rate,
        settle=start.settle,
        gap=start.gap,
        duty_most=1.0 - duty if by_diode else None,
    )
    errors = commutation_errors(
        shape, known, np.geomspace(limits.low, limits.high, 5), by_integral=by_integral
    )
    wide = np.geomspace(0.3 * limits.low, limits.high, 120)
    curve = commutation_errors(shape, known, wide, by_integral=by_integral)
    return SixStepDesign(
        observer.method, phases, shape, known, errors, limits, current, speed, start, gains, curve
    )


# How a six-step drive starts: two blocks that turn the rotor to a known angle, blocks at a rising
# frequency, then a look at the back-EMF with all legs at rest.
#
# A voltage is applied, not a regulated current: the current that the back-EMF of a swinging rotor
# drives damps it, with 3/2 p^2 psi^2/(2 J R) in 1/s where the winding is quick.

_CURRENT = 0.5  # of the limit


_ACCELERATION = 0.2  # of the torque of the start current


_SWINGS = 3.0  # of the rotor about its block within the ramp, at least


_STEADY = 0.8  # of that torque that a load may take, acceleration included


_ALIGN = (0.3, 3.0)  # in s, and in periods of the swing about the aligned angle


_ABOVE = 1.5  # of the hand-over over the least speed


_TURNED = math.radians(20.0)  # between both looks at the back-EMF


_MOST_TURNED = math.radians(140.0)  # the same at the largest speed, so that the direction shows


@dataclass(frozen=True, slots=True)
class BlockStart:
    """The start of a six-step drive.

    Args:
        current: In A.
        voltage: Of two phases in series for it at rest in V, what the dead time takes included.
        align: Periods of each of the two blocks; ``align_time`` in s of both.
        rise, rate: Blocks per period: rise per period and end of the ramp.
        ramp_time: In s.
        omega: Electrical speed at the hand-over in rad/s.
        load: Largest load torque in N m with which it starts.
        settle, gap: Periods with all legs at rest before the first look, and between both.
        swing: Of the rotor about the aligned angle in rad/s.
    """

    current: float
    voltage: float
    align: int
    align_time: float
    rise: float
    rate: float
    ramp_time: float
    omega: float
    load: float
    settle: int
    gap: int
    swing: float


def plan_start(
    design: Design,
    settings: SixStepSettings,
    shape: BlockShape,
    speeds: tuple[float, float],
    inductance: float,
) -> BlockStart:
    """The start of a design.

    Args:
        design: With the inertia.
        settings: What is given of it.
        shape: Of the waveform.
        speeds: Least and largest electrical speed in rad/s of the estimator.
        inductance: Of a phase in H.

    Raises:
        InputError: The current exceeds the limit.
    """
    machine, t_s, v_dc = design.machine, design.control.t_s, design.inverter.v_dc
    current = _CURRENT * design.i_max if settings.start_current is None else settings.start_current
    if current > design.i_max * (1.0 + 1e-9):
        raise InputError(
            f"control.six_step.start_current: {current:.4g} A is above the limit of the drive, "
            f"{design.i_max:.4g} A; write less"
        )
    inertia = machine.inertia or math.nan
    torque = shape.torque * current
    swing = math.sqrt(machine.pole_pairs * torque / inertia)
    align = max(_ALIGN[0], _ALIGN[1] * 2.0 * math.pi / swing)
    align = align if settings.align_time is None else settings.align_time
    omega = min(_ABOVE * speeds[0], math.sqrt(speeds[0] * speeds[1]))
    slope = machine.pole_pairs * _ACCELERATION * torque / inertia
    slope = min(slope, omega * swing / (_SWINGS * 2.0 * math.pi))
    rate = omega * t_s / (math.pi / 3.0)
    return BlockStart(
        current=current,
        voltage=2.0 * machine.r_s * current + v_dc * design.inverter.dead_time / t_s,
        align=max(1, round(0.5 * align / t_s)),
        align_time=align,
        rise=slope * t_s * t_s / (math.pi / 3.0),
        rate=rate,
        ramp_time=omega / slope,
        omega=omega,
        load=(_STEADY - _ACCELERATION) * torque,
        settle=2 + math.ceil(2.0 * 2.0 * inductance * current / (v_dc * t_s)),
        gap=max(2, min(round(_TURNED / (omega * t_s)), int(_MOST_TURNED / (speeds[1] * t_s)))),
        swing=swing,
    )


# By how much a six-step drive hands its current on too early or too late, and at which speeds that
# stays small.
#
# All in electrical rad over the electrical speed omega; dv is an offset of the voltage of the
# floating phase, sigma its noise, g' the slope at the crossing, g_c the level and x the angle at
# the commutation:
#
#     zero crossing    1.375 dv/(omega g')             1.275 sigma/(omega g')
#     integral         dv x/(omega g_c)                sigma sqrt(x t_s/omega)/g_c
#     grid of periods  omega t_s/2, and what the filter has not yet of its lag at the crossing
#   saliency         |L_q - L_d| I/g' (crossing), |L_q - L_d| I x/g_c (integral): the voltage that a
#                      current in the two phases induces in the third; and, of the integral, the
#                    change of the slope by kappa = (L_q - L_d) V_dc/(sqrt(3) L omega g') while the
#                      current rises: x |1 - 1/sqrt(1 + kappa)|
#
# Where L_d is the larger inductance, kappa is negative and flattens the crossing: all that is
# divided by g' is divided by 1 + kappa besides.
#
# The delay behind a crossing is half of the mean of the last two intervals, in which this crossing
# counts a quarter and the one two before a quarter against it: an offset, which moves them by at
# most 1.5 dv/(omega g') against each other, adds three eighths. For a sine dv x/(omega g_c) is
# (pi/3) dv/(psi omega).

# A diode is seen once a period: the crossing is known to half of one, by which the delay errs as by
# an offset. The offset is that of its threshold, over 1.5; the current falls while both legs lie at
# one rail: kappa = -(L_q - L_d) (2 R I + e omega)/(sqrt(3) L), with the mean EMF e of two phases.

_FLAT = 1e-3  # least share of a slope that is left

# A floating phase against the rail at which both others lie, over u.
STAR = 1.5


@dataclass(frozen=True, slots=True)
class Disturbed:
    """What disturbs the voltage of the floating phase.

    Args:
        offset: In V, half a step of the converter included.
        noise: Standard deviation in V.
        t_s: Period in s.
        filter_time: Time constant of the filter of the voltage in s.
        free: Electrical angle in rad from the end of the unseen time to the crossing, in which the
            filter reaches the lag that is compensated.
        step:
            |L_q - L_d| I in Wb: of the saliency at the largest current.
        kappa: (L_q - L_d) V_dc/(sqrt(3) L) in V/rad: voltage per angle that rising current induces,
            with the back-EMF where L_q is the larger one, against it where L_d is.
        bend: What adds to kappa with the speed, in V s/rad^2.
        by_diode: Whether the conduction of a diode is seen instead of a voltage.
    """

    offset: float
    noise: float
    t_s: float
    filter_time: float
    free: float
    step: float
    kappa: float
    bend: float = 0.0
    by_diode: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class CommutationErrors:
    """Parts of the error in rad (electrical), shape (N,); ``noise`` is a standard deviation."""

    omega: FloatArray
    offset: FloatArray
    noise: FloatArray
    grid: FloatArray
    saliency: FloatArray

    @property
    def largest(self) -> FloatArray:
        """All parts at once, noise three times, in rad."""
        return self.offset + 3.0 * self.noise + self.grid + self.saliency


def commutation_errors(
    shape: BlockShape, known: Disturbed, omega: FloatArray, *, by_integral: bool
) -> CommutationErrors:
    """Errors of a commutation.

    Args:
        shape: Of the waveform.
        known: What disturbs the voltage.
        omega: Electrical speeds in rad/s, above 0, shape (N,).
        by_integral: Whether the integral decides, or the delay behind the crossing.
    """
    steeper = 1.0 + (known.kappa / omega + known.bend) / shape.slope
    if by_integral:
        lever = np.full_like(omega, shape.delay / shape.level)
        noise = known.noise * np.sqrt(shape.delay * known.t_s / omega) / shape.level
        seen = np.sqrt(np.maximum(steeper, _FLAT))
        saliency = known.step * lever + shape.delay * np.abs(1.0 - 1.0 / seen)
    else:
        share = shape.delay / SECTOR
        lever = np.full_like(omega, (1.0 + 0.75 * share) / shape.slope)
        both = np.hypot(1.0 + 0.5 * share, 0.5 * share)
        noise = known.noise * both / (shape.slope * omega)
        flatter = np.clip(steeper, _FLAT, 1.0)
        lever, noise = lever / flatter, noise / flatter
        saliency = known.step / (shape.slope * flatter)
    missing = np.zeros_like(omega)
    if known.filter_time > 0.0:
        turned = omega * known.filter_time
        missing = turned * np.exp(-known.free / turned)
    grid = 0.5 * omega * known.t_s
    if known.by_diode:
        grid = grid * (1.0 + lever * shape.slope)
    return CommutationErrors(omega, known.offset * lever / omega, noise, grid + missing, saliency)


# The speed loop of a six-step drive, whose speed is known six times per turn.
#
# The speed is the mean over two blocks, old by one block on average and held for half of one more:
# 1.5 pi/(3 omega), longest at the least speed. That is one more of the small delays of the
# symmetrical optimum, and a dead time in its margin.

_FASTER = 1.25  # of the spread that rising gains may take away


_MOST = 10.0  # by which they rise


_BLOCKS = 1.5  # by which the speed is late


@dataclass(frozen=True, slots=True)
class BlockSpeedLoop:
    """A speed controller that commands torque.

    Args:
        kp, ki: In N m s/rad and N m/rad.
        t_s, ratio: Period in s, and periods of the current controller in it.
        delay: Of the speed at the least speed, in s.
        crossover, margin: In rad/s, and in rad at the least speed.
        scale: How far kp rises with the speed, and ki with its square: the delay falls as they
            rise.
    """

    kp: float
    ki: float
    t_s: float
    ratio: int
    delay: float
    crossover: float
    margin: float
    scale: float


def block_speed_loop(design: Design, current: LoopGains, omega_low: float) -> BlockSpeedLoop | None:
    """The speed loop that a design asks for.

    Args:
        design: With the inertia.
        current: Its current loop.
        omega_low: Least electrical speed in rad/s.

    Raises:
        NoSolutionError: Its margin at the least speed is too small.
    """
    settings, machine = design.control.speed_loop, design.machine
    if settings is None:
        return None
    inertia = machine.inertia or math.nan
    t_s = settings.ratio * design.control.t_s
    delay = _BLOCKS * math.pi / 3.0 / omega_low
    lag = 1.0 / current.crossover
    kp, ki = speed_pi(inertia, machine.friction, lag + 0.5 * t_s + delay, settings)
    scale = 1.0
    if settings.method != "given":
        fixed = lag + 0.5 * t_s
        scale = min(max((_FASTER * (fixed + delay) - delay) / fixed, 1.0), _MOST)

    def at(factor: float) -> tuple[float, float]:
        w = np.geomspace(1e-3, 10.0, 4000) * factor * kp / inertia
        s = 1j * w
        loop = (factor * kp + factor**2 * ki / s) / (inertia * s + machine.friction)
        loop = loop / (1.0 + lag * s)
        crossing = int(np.argmin(np.abs(np.log(np.abs(loop)))))
        late = delay / factor + 0.5 * t_s
        angle = math.pi + float(np.angle(loop[crossing])) - float(w[crossing]) * late
        return float(w[crossing]), angle

    (crossover, margin), (_, fast) = at(1.0), at(scale)
    margin = min(margin, fast)
    if margin < settings.min_phase_margin:
        better = (
            f"a spread above {settings.spread:.3g}"
            if settings.method == "symmetrical-optimum"
            else "method: symmetrical-optimum, or smaller gains"
        )
        raise NoSolutionError(
            f"control.speed_loop: kp = {kp:.4g}, ki = {ki:.4g} leave "
            f"{math.degrees(margin):.3g} deg at {omega_low:.4g} rad/s (electrical), "
            f"where the speed is {1e3 * delay:.3g} ms late, "
            f"{math.degrees(settings.min_phase_margin):.3g} deg are wanted; write {better}"
        )
    return BlockSpeedLoop(kp, ki, t_s, settings.ratio, delay, crossover, margin, scale)
