"""A six-step drive designed: its waveform, errors and speed range, its loops and its start."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import SixStepSettings, filter_share
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.gains import tune_current_loop
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.optimizer.six_step.block_loops import BlockSpeedLoop, block_speed_loop
from dqforge.optimizer.six_step.block_shape import (
    BlockShape,
    block_shape,
    dq_inductances,
    phases_of,
)
from dqforge.optimizer.six_step.control import SixStepGains
from dqforge.optimizer.six_step.errors import CommutationErrors, Disturbed, commutation_errors
from dqforge.optimizer.six_step.estimator import BlockGains
from dqforge.optimizer.six_step.sectors import SECTOR
from dqforge.optimizer.six_step.start import BlockStart, plan_start

_OFFSET = 0.002  # of the link voltage, where nothing is said


_FULL_SCALE = 1.25  # of the converter of the terminal voltages, over the link voltage


_MARGIN = 1.15  # of the unseen time over that of the freewheeling


_LEAST_DUTY = 0.02  # on-time in which a converter can sample


_BLANK = 1.5  # periods that are never seen after a commutation


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
        method: ``zero-crossing`` or ``emf-integration``.
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


def _disturbed(design: Design, settings: SixStepSettings, phases: AnyPhaseMachine) -> Disturbed:
    v_dc = design.inverter.v_dc
    step = _FULL_SCALE * v_dc / 2.0**settings.voltage_bits
    offset = settings.voltage_offset
    noise = settings.voltage_noise
    l_d, l_q = dq_inductances(phases)
    away = abs(l_q - l_d)
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
    by_free = _span(omega, free + (_BLANK + 0.5) * omega * t_s <= window)[1]
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
    known = _disturbed(design, settings, phases)
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
        latency=0.5 + (1.0 - share) / share,
        blank_share=_MARGIN * limits.freewheeling / SECTOR,
        blank_least=_BLANK,
        smooth=share,
        patience=_PATIENCE,
        crossings=tuple(math.remainder(angle, 2.0 * math.pi) for angle in shape.crossings),
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
    )
    errors = commutation_errors(
        shape, known, np.geomspace(limits.low, limits.high, 5), by_integral=by_integral
    )
    wide = np.geomspace(0.3 * limits.low, limits.high, 120)
    curve = commutation_errors(shape, known, wide, by_integral=by_integral)
    return SixStepDesign(
        observer.method, phases, shape, known, errors, limits, current, speed, start, gains, curve
    )
