"""PI gains of the current and speed loops by named methods, each with the margins
its sampled loop really has.

A set that is unstable or misses the required phase margin is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dqforge.machines.design.settings import ControlSettings, CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.loops.analysis import (
    analyse_current_loop,
    analyse_speed_loop,
    inertia_of,
    speed_settings,
)
from dqforge.optimizer.loops.loop_batch import (
    DriveVariants,
    PlantBatch,
    current_plants,
    speed_plants,
)
from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    CURRENT_DELAY,
    Settings,
    calmer,
    current_pi,
    largest_factor,
    loop_advice,
    require_positive,
    speed_pi,
)
from dqforge.optimizer.speed_measurement.edges import Edges


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
        f"required are {np.degrees(required):.1f} deg; {hint}"
    )
