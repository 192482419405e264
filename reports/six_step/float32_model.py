"""Float32 model of the emitted six-step control: the steps of `dqforge.optimizer.six_step.control`
on numpy's single precision, and sequences that lead through all its stages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.six_step.control import (
    SixStep,
    SixStepGains,
    blank,
    six_step_reset,
    six_step_speed_control,
    six_step_step,
    six_step_torque_control,
)
from dqforge.optimizer.steps.step_arithmetic import Abc, cast
from dqforge.reports.c_code.harness import SINGLE

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray

_LENGTH = 250  # rows of a short sequence
_LONGEST = 12_000  # rows of the sequence that goes through alignment and ramp
_FACTOR = 1.6539866862653762  # of a sine: emf over the amplitude of the flux

# Columns of the inputs: reset, torque mode, v_a, v_b, v_c, i_a, i_b, i_c, v_dc, reference.
COLUMNS = 10

# Columns of the results: stage, fault, sector, high, low, duty, angle, speed, torque, chopped leg.
RESULTS = 10


def _sequence(
    gains: SixStepGains, generator: np.random.Generator, rows: int, omega: float, torque: bool
) -> np.ndarray:
    """A rotor that turns at a speed in rad/s (electrical), slowly faster, with noise."""
    t_s, flux = gains.observer.t_s, gains.emf / _FACTOR
    speeds = omega * (1.0 + 0.3 * np.linspace(0.0, 1.0, rows))
    theta = generator.uniform(-np.pi, np.pi) + np.cumsum(speeds) * t_s
    size = np.abs(speeds) * flux
    link = 20.0 * gains.emf * gains.omega_caught
    found = np.zeros((rows, COLUMNS))
    found[0, 0] = 1.0
    found[:, 1] = float(torque)
    for phase in range(3):
        lag = theta - 2.0 * np.pi / 3.0 * phase
        noise = 0.01 * (size + 0.1) * generator.standard_normal(rows)
        found[:, 2 + phase] = 0.5 * link - np.sign(omega) * size * np.sin(lag) + noise
        found[:, 5 + phase] = gains.i_max * generator.normal(0.0, 0.5, rows)
    found[:, 8] = link
    way = 1.0 if omega >= 0.0 else -1.0
    asked = gains.torque * gains.i_max if torque else 1.3 * abs(omega) / gains.pole_pairs
    found[:, 9] = way * max(asked, 1.5 * gains.omega_least if not torque else asked)
    if rows > 200 and generator.random() < 0.3:
        found[rows // 2 :, 9] *= generator.choice([0.0, -1.0])
    unknown = generator.random((rows, 6)) < 0.002
    found[:, 2:8][unknown] = np.nan
    return found


def six_step_inputs(gains: SixStepGains, count: int, seed: int) -> SingleArray:
    """Rows for the harness, shape (rows, `COLUMNS`): many short sequences at all speeds of both
    directions, and one through alignment and ramp.

    Args:
        gains: Of the control.
        count: Rows of the short sequences, about.
        seed: Of the draws.
    """
    generator = np.random.default_rng(seed)
    whole = 2 * gains.align + round(gains.rate / gains.rise) + 6 * (gains.settle + gains.gap)
    parts = [_sequence(gains, generator, min(whole, _LONGEST), 0.0, torque=False)]
    for place in range(max(1, count // _LENGTH)):
        speed = gains.omega_caught * 10.0 ** generator.uniform(-0.5, 1.0)
        rows = max(_LENGTH, 3 * (gains.settle + gains.gap))
        way = 1.0 if place % 2 == 0 else -1.0
        parts.append(_sequence(gains, generator, rows, way * speed, torque=place % 3 == 0))
    return np.ascontiguousarray(np.concatenate(parts).astype(np.float32))


def _row(drive: SixStep, gains: SixStepGains, given: SingleArray) -> list[float]:
    if given[1] > 0.0:
        asked = six_step_torque_control(SINGLE, drive, given[9])
    else:
        asked = six_step_speed_control(SINGLE, gains, drive, given[9])
    v, i = Abc(*given[2:5]), Abc(*given[5:8])
    legs = six_step_step(SINGLE, gains, drive, v, i, given[8])
    seen = drive.observer
    found = (
        drive.stage,
        drive.fault,
        drive.sector,
        legs.high,
        legs.low,
        legs.duty,
        seen.theta_e,
        seen.omega_e,
        asked,
        legs.chopped,
    )
    return [float(number) for number in found]


def six_step_outputs(gains: SixStepGains, inputs: SingleArray) -> SingleArray:
    """What the compiled control must return for rows of inputs, shape (rows, `RESULTS`).

    Args:
        gains: Of the control, float32 values.
        inputs: Of `six_step_inputs`.
    """
    found, own = np.empty((len(inputs), RESULTS), dtype=np.float32), cast(gains, SINGLE)
    drive = blank()
    six_step_reset(SINGLE, own, drive)
    with np.errstate(all="ignore"):
        for place, given in enumerate(inputs):
            if given[0] > 0.0:
                six_step_reset(SINGLE, own, drive)
            found[place] = _row(drive, own, given)
    return found
