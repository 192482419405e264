"""Poles, margins and step responses of the sampled loops with any gains, stable or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.settings import ControlSettings, SpeedLoopSettings
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError
from dqforge.optimizer.loops.closed_margins import (
    current_loops,
    current_margins,
    has_closed_margins,
)
from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
from dqforge.optimizer.loops.plants import (
    DisturbanceResponse,
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

    The margins are those of `dqforge.optimizer.loops.closed_margins`, of gains that are not
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
