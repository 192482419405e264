"""The gains of one loop with the evidence for them, and their per-unit numbers.

Gains are physical (current loops V/A and V/(A s), speed loop N m s/rad and N m/rad); `per_unit` and
`dqforge.optimizer.loops.integer_gains.to_q` turn them into the numbers of a firmware.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    PerUnitBases,
    SpeedLoopSettings,
)
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.optimizer.loops.observed_margins import (
    ObservedLoop,
    current_loops,
    current_margins,
    has_closed_margins,
)
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    DriveVariants,
    PlantBatch,
    Settings,
    calmer,
    current_pi,
    current_plants,
    largest_factor,
    loop_advice,
    require_positive,
    speed_pi,
    speed_plants,
)
from dqforge.optimizer.loops.plants import (
    DisturbanceResponse,
    Edges,
    PiLoop,
    SpeedLoop,
    StepResponse,
    current_loop,
    current_step,
    disturbance_summary,
    response_length,
    speed_loop,
    speed_step,
)
from dqforge.optimizer.sampled_systems import LoopMargins, loop_margins

ComplexArray = NDArray[np.complex128]


LoopName = Literal["i_d", "i_q", "i_0", "speed"]


@dataclass(frozen=True, slots=True)
class LoopGains:
    """PI gains of one loop with the evidence for them.

    Args:
        loop: ``i_d``, ``i_q``, ``i_0`` (zero sequence) or ``speed``.
        method: The tuning method, as in the settings.
        kp, ki: Gains of the parallel form, V/A and V/(A s), or N m s/rad and N m/rad.
        t_s: Sampling period of this controller in s.
        poles: All closed-loop poles in the z plane of ``t_s``, largest modulus first, shape (n,).
        margins: Crossovers and margins of the sampled loop.
        disturbance: Answer to a unit step of the disturbance: 1 V at the winding, or 1 N m of load
            torque.
        model: The sampled loop that poles and margins are those of; of a speed loop on an encoder
            with the drive between its samples.
        inductance: Inductance of the winding in H that a current loop is meant for; None for the
            speed loop.
        observed: Of a speed loop that runs on an observer what that makes of it; poles and margins
            are then those with its lag, at the worst speed. None for all others.
    """

    loop: LoopName
    method: str
    kp: float
    ki: float
    t_s: float
    poles: ComplexArray
    margins: LoopMargins
    disturbance: DisturbanceResponse
    model: PiLoop | SpeedLoop
    inductance: float | None = None
    observed: ObservedLoop | None = None

    @property
    def ki_ts(self) -> float:
        """Integral gain per sample, ki t_s, in the unit of kp."""
        return self.ki * self.t_s

    @property
    def t_i(self) -> float:
        """Integral time T_i = kp/ki of the series form kp (1 + 1/(T_i s)), in s."""
        return self.kp / self.ki

    @property
    def velocity(self) -> tuple[float, float]:
        """(q0, q1) of the velocity form d[k] = d[k-1] + q0 e[k] + q1 e[k-1],
        in the unit of kp (paper 001, (8.9)).
        """
        return self.kp + self.ki_ts, -self.kp

    @property
    def anti_windup(self) -> float:
        """Back-calculation gain in 1/s: the integral gains anti_windup t_s (limited -
        unlimited output) per sample.

        The tracking time is T_i, but not below one sample, where the feedback is deadbeat.
        """
        return min(1.0 / self.t_i, 1.0 / self.t_s)

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0)) and (
            self.observed is None or self.observed.stable
        )

    @property
    def crossover(self) -> float:
        """Gain crossover with the smallest phase margin, in rad/s."""
        return self.margins.crossover

    @property
    def phase_margin(self) -> float:
        """Phase margin in rad."""
        return self.margins.phase_margin

    @property
    def gain_margin(self) -> float:
        """Gain margin as a factor."""
        return self.margins.gain_margin

    @property
    def delay_margin(self) -> float:
        """Delay margin in s."""
        return self.margins.delay_margin

    @property
    def delay_margin_samples(self) -> float:
        """Delay margin in sampling periods of this controller."""
        return self.margins.delay_margin / self.t_s

    @property
    def max_sensitivity(self) -> float:
        """Maximum sensitivity M_s."""
        return self.margins.max_sensitivity


@dataclass(frozen=True, slots=True)
class Decoupling:
    """Feedforward that decouples the axes: v_d += -omega_e l_q i_q, v_q +=
    omega_e (l_d i_d + psi_pm).

    ``l_d`` and ``l_q`` in H, ``psi_pm`` in Wb.
    """

    l_d: float
    l_q: float
    psi_pm: float


def decoupling(machine: Machine) -> Decoupling:
    """Decoupling values of a machine, those at zero current where it saturates."""
    return Decoupling(l_d=machine.l_d, l_q=machine.l_q, psi_pm=machine.psi_pm)


def per_unit(gains: LoopGains, in_base: float, out_base: float) -> tuple[float, float]:
    """Gains (kp, ki t_s) between per-unit quantities: physical gain times in_base/out_base.

    ``in_base`` is the base of the controlled quantity (A, or rad/s),
    ``out_base`` that of the output (V, or N m).

    Args:
        gains: The loop, gains in SI units.
        in_base: Base of the controlled quantity, in A or rad/s.
        out_base: Base of the output, in V or N m.
    """
    if not (in_base > 0.0 and out_base > 0.0):
        raise InputError(f"per-unit bases must be positive, got {in_base:g} and {out_base:g}")
    return gains.kp * in_base / out_base, gains.ki_ts * in_base / out_base


def loop_bases(bases: PerUnitBases, loop: LoopName) -> tuple[float, float]:
    """Bases of what a loop controls and of its output: A and V, or rad/s and N m.

    Args:
        bases: Per-unit bases in SI units.
        loop: Which loop.
    """
    return (bases.speed, bases.torque) if loop == "speed" else (bases.current, bases.voltage)


# Poles, margins and step responses of the sampled loops with any gains, stable or not.

MOST_POINTS = 20_000  # of a step response that is to be drawn


def analyse_current_loop(
    r_s: float,
    inductance: float,
    t_s: float,
    kp: float,
    ki: float,
    method: str = "given",
    loop: LoopName = "i_q",
    *,
    respond: bool = True,
) -> LoopGains:
    """Poles, margins and disturbance response of one current loop with any gains, stable or not.

    The margins are those of `dqforge.optimizer.loops.observed_margins`, of gains that are not
    positive by a scan. Parameters as in `dqforge.optimizer.loops.plants.current_loop`; without
    ``respond`` the disturbance response, which can be long, is left out.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        kp, ki: Gains in V/A and V/(A s).
        method: What is said of where the gains come from.
        loop: Which axis: ``i_d`` or ``i_q``.
        respond: Whether the disturbance response is simulated.
    """
    model = current_loop(r_s, inductance, t_s, kp, ki)
    response = (
        current_step(model, response_length(model.closed))
        if respond and _is_stable(model)
        else None
    )
    margins = (
        current_margins(current_loops(r_s, inductance, t_s, kp, ki)).of(0)
        if has_closed_margins(kp, ki)
        else loop_margins(model.open_loop)
    )
    found = _evidence(loop, method, (kp, ki), model, response, margins)
    return replace(found, inductance=inductance)


def analyse_speed_loop(
    machine: Machine,
    current_gains: LoopGains,
    control: ControlSettings,
    kp: float,
    ki: float,
    method: str = "given",
    *,
    respond: bool = True,
) -> LoopGains:
    """Poles, margins and disturbance response of the speed loop with any gains (N m s/rad,
    N m/rad), stable or not.

    Without ``respond`` the disturbance response, which can be long, is left out.

    Args:
        machine: Any machine, with its inertia.
        current_gains: The current loop of the q axis.
        control: Sampling period and settings of the speed loop.
        kp, ki: Gains in N m s/rad and N m/rad.
        method: What is said of where the gains come from.
        respond: Whether the disturbance response is simulated.
    """
    model = speed_model(machine, current_gains, control, (kp, ki))
    response = (
        speed_step(model, response_length(model.loop.closed))
        if respond and _is_stable(model.loop)
        else None
    )
    margins = loop_margins(model.loop.open_loop)
    return _evidence("speed", method, (kp, ki), model, response, margins)


def current_step_response(
    r_s: float, inductance: float, gains: LoopGains, duration: float
) -> StepResponse:
    """Current in A after unit steps of the reference and of a voltage, sampled over ``duration`` s.

    ``r_s`` in Ohm, ``inductance`` in H. There is a point every ``gains.t_s``, or every few of them
    where those would be more than a figure can show.
    """
    return _current_response(current_loop(r_s, inductance, gains.t_s, gains.kp, gains.ki), duration)


def speed_step_response(
    machine: Machine,
    current_gains: LoopGains,
    control: ControlSettings,
    gains: LoopGains,
    duration: float,
) -> StepResponse:
    """Speed in rad/s after unit steps of the reference and of the load, sampled over ``duration``
    s.

    There is a point every current sample, or every few speed samples where those would be
    more than a figure can show.

    Args:
        machine: Any machine, with its inertia.
        current_gains: The current loop of the q axis.
        control: Sampling period and settings of the speed loop.
        gains: The speed loop.
        duration: Length in s.
    """
    return _speed_response(
        speed_model(machine, current_gains, control, (gains.kp, gains.ki)), duration
    )


def step_response(gains: LoopGains, duration: float) -> StepResponse:
    """Current in A or speed in rad/s after unit steps of the reference and of the disturbance,
    over ``duration`` s.

    The loop is ``gains.model``; points as in `current_step_response` and `speed_step_response`.
    """
    if isinstance(gains.model, SpeedLoop):
        return _speed_response(gains.model, duration)
    return _current_response(gains.model, duration)


def _current_response(model: PiLoop, duration: float) -> StepResponse:
    stride = _stride(duration, model.closed.t_s)
    return current_step(model, _samples(duration, model.closed.t_s * stride), stride)


def _speed_response(model: SpeedLoop, duration: float) -> StepResponse:
    t_s, stride = model.loop.closed.t_s, _stride(duration, model.drive.t_s)
    if stride == 1:
        return speed_step(model, _samples(duration, t_s))
    stride = -(-stride // model.ratio)
    return speed_step(model, _samples(duration, t_s * stride), stride)


def _stride(duration: float, t_s: float) -> int:
    """Samples between two points of a response that is to be drawn."""
    return max(1, int(np.ceil(duration / (t_s * MOST_POINTS))))


def _samples(duration: float, t_s: float) -> int:
    return int(np.floor(duration / t_s + 1e-9)) + 1


def _is_stable(model: PiLoop) -> bool:
    return bool(np.abs(model.closed.poles[0]) < 1.0)


def _evidence(
    loop: LoopName,
    method: str,
    gains: tuple[float, float],
    model: PiLoop | SpeedLoop,
    response: StepResponse | None,
    margins: LoopMargins,
) -> LoopGains:
    endless = DisturbanceResponse(peak=np.inf, settling_time=np.inf)
    sampled = model.loop if isinstance(model, SpeedLoop) else model
    return LoopGains(
        loop=loop,
        method=method,
        kp=gains[0],
        ki=gains[1],
        t_s=sampled.closed.t_s,
        poles=sampled.closed.poles,
        margins=margins,
        disturbance=endless if response is None else disturbance_summary(response),
        model=model,
    )


def speed_settings(control: ControlSettings) -> SpeedLoopSettings:
    """Settings of the speed loop.

    Args:
        control: The controllers of a design.

    Raises:
        InputError: There is no speed loop.
    """
    if control.speed_loop is None:
        raise InputError(
            "control.speed_loop is missing: write its method and ratio to tune the speed loop"
        )
    if control.speed_loop.ratio < 1:
        raise InputError(
            f"control.speed_loop.ratio must be 1 or more, got {control.speed_loop.ratio}"
        )
    return control.speed_loop


def inertia_of(machine: Machine) -> float:
    """Inertia of a machine in kg m^2; raises `InputError` where it is unknown."""
    if machine.inertia is None:
        raise InputError(
            "control.speed_loop needs machine.inertia (kg m^2): write it, or leave "
            "control.speed_loop out"
        )
    return machine.inertia


def speed_model(
    machine: Machine,
    current_gains: LoopGains,
    control: ControlSettings,
    speed_gains: tuple[float, float],
) -> SpeedLoop:
    """Speed loop, closed over the current loop.

    Args:
        machine, current_gains: What turns, with its inertia, and the q axis that makes its torque.
        control: The controllers of the design.
        speed_gains: kp in N m s/rad and ki in N m/rad.
    """
    settings = speed_settings(control)
    return speed_loop(
        winding=(machine.r_s, current_gains.inductance or machine.l_q),
        mechanics=(inertia_of(machine), machine.friction),
        t_s=control.t_s,
        current_gains=(current_gains.kp, current_gains.ki),
        ratio=settings.ratio,
        speed_gains=speed_gains,
        filter_time=settings.filter_time,
    )


# PI gains of the current and speed loops by named methods, each with the margins
# its sampled loop really has.
#
# A set that is unstable or misses the required phase margin is refused.


def speed_delay(current_gains: LoopGains, t_s: float, settings: SpeedLoopSettings) -> float:
    """Sum of the small delays T in s: closed current loop, hold of the torque reference,
    measurement of the speed where there is one, and its filter.

    The current loop counts as 1/crossover, the time constant of the first-order
    system with its crossover. TI's rule knows it alone, by the bandwidth kp/L that it is meant for.

    Args:
        current_gains: The current loop of the q axis, with its crossover in rad/s.
        t_s: Sampling period of the current loops in s.
        settings: Ratio of the sampling rates and time constant of the filter in s.
    """
    inductance = current_gains.inductance
    lag = None if inductance is None else inductance / current_gains.kp
    return small_delays(current_gains.crossover, lag, t_s, settings)


def small_delays(
    crossover: float, lag: float | None, t_s: float, settings: SpeedLoopSettings
) -> float:
    """The same sum in s from numbers of the current loop.

    Args:
        crossover: Of the current loop of the q axis, in rad/s.
        lag: Its L/kp in s, for TI's rule; None where the winding is not known.
        t_s: Sampling period of the current loops in s.
        settings: Ratio of the sampling rates and time constant of the filter in s.
    """
    if settings.method == "ti" and lag is not None:
        return lag
    own, period = settings.measurement, settings.ratio * t_s
    late = 0.0 if own is None else float(Edges(own, period).mean_delay(np.array(own.omega_from)))
    return 1.0 / crossover + 0.5 * period + settings.filter_time + late


def tune_current_loop(
    r_s: float,
    inductance: float,
    t_s: float,
    settings: CurrentLoopSettings,
    loop: LoopName = "i_q",
    plants: PlantBatch | None = None,
    rule_inductance: float | None = None,
) -> LoopGains:
    """PI gains of one current loop by the method of the settings, checked on the sampled loop.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        loop: Which axis, for the messages: ``i_d``, ``i_q`` or ``i_0``.
        plants: For the method ``optimised`` the plants whose M_s is bounded, such as the corners of
            a tolerance box; None for the winding alone.
        rule_inductance: Inductance in H that the rule of a vendor takes for this axis; None for the
            axis' own.

    Raises:
        NoSolutionError: If a gain is not positive, the loop is unstable or its phase margin too
            small; says what would hold.
    """
    key, one = "control.current_loop", np.ones(1)
    bounded = current_plants(r_s * one, inductance * one, t_s, one) if plants is None else plants

    def attempt(trial: CurrentLoopSettings, *, respond: bool = False) -> LoopGains:
        kp, ki = (
            optimised_pi(
                bounded, trial.max_sensitivity, pi_scale(inductance, r_s, CURRENT_DELAY * t_s), key
            )
            if trial.method == "optimised"
            else current_pi(r_s, rule_inductance or inductance, t_s, trial)
        )
        require_positive("control.current_loop", loop, trial, (kp, ki), r_s / (2.0 * inductance))
        return analyse_current_loop(
            r_s, inductance, t_s, kp, ki, trial.method, loop, respond=respond
        )

    gains = attempt(settings, respond=True)
    _require_crossover("control.current_loop", gains)
    if not _holds(gains, settings.min_phase_margin):
        start = settings
        if (
            settings.method == "magnitude-optimum"
        ):  # no free parameter: offer the same family with one
            start = replace(settings, method="bandwidth", bandwidth=gains.kp / inductance)
        _refuse("control.current_loop", gains, start, attempt)
    return gains


def tune_speed_loop(
    machine: Machine,
    current_gains: LoopGains,
    control: ControlSettings,
    plants: PlantBatch | None = None,
    lag: float = 0.0,
) -> LoopGains:
    """PI gains of the speed loop (output: torque) by the method of the settings,
    checked on the exact two-rate loop.

    Args:
        machine: The machine; its inertia must be known.
        current_gains: Gains of the q axis.
        control: Sampling and settings; ``speed_loop`` must be there.
        plants: As in `tune_current_loop`.
        lag: By how much in s an observer tells the speed too late: a small delay of the loop.

    Raises:
        InputError: If the inertia or a setting is missing.
        NoSolutionError: If a gain is not positive, the loop is unstable or its phase margin too
            small; says what would hold.
    """
    settings, inertia = speed_settings(control), inertia_of(machine)
    t_sum = speed_delay(current_gains, control.t_s, settings) + lag

    def attempt(trial: SpeedLoopSettings, *, respond: bool = False) -> LoopGains:
        kp, ki = (
            optimised_pi(
                _nominal_plant(machine, current_gains, control) if plants is None else plants,
                trial.max_sensitivity,
                pi_scale(inertia, machine.friction, t_sum),
                "control.speed_loop",
            )
            if trial.method == "optimised"
            else speed_pi(inertia, machine.friction, t_sum, trial)
        )
        require_positive(
            "control.speed_loop", "speed", trial, (kp, ki), machine.friction / (2.0 * inertia)
        )
        return analyse_speed_loop(
            machine, current_gains, control, kp, ki, trial.method, respond=respond
        )

    gains = attempt(settings, respond=True)
    _require_crossover("control.speed_loop", gains)
    if not _holds(gains, settings.min_phase_margin):
        _refuse("control.speed_loop", gains, settings, attempt)
    return gains


def _nominal_plant(
    machine: Machine, current_gains: LoopGains, control: ControlSettings
) -> PlantBatch:
    """The speed loop's plant as one of a batch."""
    settings, one = speed_settings(control), np.ones(1)
    l_q = (current_gains.inductance or machine.l_q) * one
    variants = DriveVariants(machine.r_s * one, l_q, inertia_of(machine) * one, one, one, 0.0 * one)
    gains = (current_gains.kp, current_gains.ki)
    return speed_plants(
        variants, machine.friction, control.t_s, gains, settings.ratio, settings.filter_time
    )


def _require_crossover(key: str, gains: LoopGains) -> None:
    """Refuse a stable loop that is so slow that the scan of its frequencies
    does not reach its crossover.
    """
    if gains.stable and not np.isfinite(gains.crossover):
        raise NoSolutionError(
            f"{key}: kp = {gains.kp:.4g} and ki = {gains.ki:.4g} are so small that the "
            f"{gains.loop} loop has no gain crossover; raise them, or check their units"
        )


def _holds(gains: LoopGains, min_phase_margin: float) -> bool:
    return gains.stable and abs(gains.phase_margin) >= min_phase_margin


def _refuse(
    key: str, gains: LoopGains, settings: Settings, attempt: Callable[[Settings], LoopGains]
) -> None:
    """Raise the error that says what the loop reaches, what it should, and what would hold."""
    required = settings.min_phase_margin

    def holds(factor: float) -> bool:
        try:
            return _holds(attempt(calmer(settings, factor)), required)
        except NoSolutionError:
            return False

    if gains.stable:
        reached = f"has a phase margin of {np.degrees(abs(gains.phase_margin)):.1f} deg"
    else:
        reached = f"is unstable (largest pole modulus {abs(gains.poles[0]):.4g})"
    factor = largest_factor(holds)
    hint = (
        "no smaller gains of this method reach it"
        if factor is None
        else loop_advice(key, settings, factor)
    )
    raise NoSolutionError(
        f"{key}: the {gains.loop} loop by method '{gains.method}' {reached}, "
        f"required: {np.degrees(required):.1f} deg; {hint}"
    )
