"""Answers of the control loops over time and frequency: closed loops to a step,
open loops to a sine.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.analysis import step_response
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.plants import PiLoop, SpeedLoop, StepResponse, current_step
from dqforge.optimizer.sampled_systems import ComplexArray

_CURRENT_TIME, _SPEED_TIME = 9.0, 22.0  # Length of a step response in 1/crossover.
_LEAST_SAMPLES = 12.0
_BELOW_CROSSOVER = 40.0
_FREQUENCIES = 160


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """How one loop answers.

    Args:
        gains: The loop.
        step: Answer of the closed loop to a unit step of its reference; of a speed loop on an
            observer that at its samples.
        frequency: Hz, ascending, shape (N,).
        gain, phase: Of the open loop there, as a factor and in degrees, shape (N,).
        phase_at_crossover: The same phase at the crossover of ``gains``, in degrees.
    """

    gains: LoopGains
    step: StepResponse
    frequency: FloatArray
    gain: FloatArray
    phase: FloatArray
    phase_at_crossover: float


def loop_responses(
    i_d: LoopGains, i_q: LoopGains, speed: LoopGains | None, zero: LoopGains | None = None
) -> tuple[LoopResponse, ...]:
    """Step and frequency responses of the loops; without the speed loop where its
    observer makes it unstable.

    Args:
        i_d, i_q: The current loops; their step responses are of one length.
        speed: The speed loop, None where there is none.
        zero: The loop of the zero-sequence current, None where nothing drives one.
    """
    currents = [i_d, i_q] if zero is None else [i_d, i_q, zero]
    loops = currents if speed is None else [*currents, speed]
    low = min(loop.crossover for loop in loops) / _BELOW_CROSSOVER
    longest = max(_CURRENT_TIME / loop.crossover for loop in currents)
    found = [
        _response(loop, step_response(loop, max(longest, _LEAST_SAMPLES * loop.t_s)), low)
        for loop in currents
    ]
    if speed is not None and (speed.observed is None or speed.observed.stable):
        found.append(_response(speed, _speed_step(speed), low))
    return tuple(found)


def _speed_step(speed: LoopGains) -> StepResponse:
    shown = _SPEED_TIME / speed.crossover
    if isinstance(speed.model, SpeedLoop):
        return step_response(speed, max(shown, _LEAST_SAMPLES * speed.t_s))
    # On an observer: the loop has the same shape as one of a current.
    return current_step(speed.model, int(max(shown / speed.t_s, _LEAST_SAMPLES)))


def _open_loop(model: PiLoop | SpeedLoop) -> PiLoop:
    return model.loop if isinstance(model, SpeedLoop) else model


def _response(gains: LoopGains, step: StepResponse, low: float) -> LoopResponse:
    """``low`` is the least angular frequency in rad/s."""
    open_loop = _open_loop(gains.model).open_loop
    omega = np.unique(
        np.append(np.geomspace(low, np.pi / open_loop.t_s, _FREQUENCIES), gains.crossover)
    )
    response = open_loop.response(omega)
    phase = _phase(response)
    at = float(phase[np.searchsorted(omega, gains.crossover)])
    return LoopResponse(gains, step, omega / (2.0 * np.pi), np.abs(response), phase, at)


def _phase(response: ComplexArray) -> FloatArray:
    """Continuous phase in degrees that begins between -270 and 90."""
    phase = np.degrees(np.unwrap(np.angle(response)))
    return np.asarray(phase - (360.0 if phase[0] > 90.0 else 0.0), dtype=np.float64)
