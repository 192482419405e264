"""Trackers of the position in single precision, and sequences to try them: same steps, in the
numbers of the C code.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.step_arithmetic import cast
from dqforge.reports.c_code.harness import SINGLE, wrap

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.estimators.tracker import Tracker

_LENGTH = 100


@dataclass(frozen=True, slots=True)
class EmittedTracker:
    """What verification needs: the tracker and its gains (of the type ``tracker.gains``)."""

    tracker: Tracker
    gains: Any


def tracker_inputs(found: EmittedTracker, count: int, seed: int) -> SingleArray:
    """Rows (start flag, angle, speed, v_alpha, v_beta, i_alpha, i_beta, further signals), in
    sequences of 100 samples.

    Signals turn at any speed, with any amplitude and rough noise; some samples are no numbers.
    """
    generator = np.random.default_rng(seed)
    sequences, further = max(1, count // _LENGTH), len(found.tracker.hears)
    t_s = float(found.gains.t_s)
    turning = generator.choice([0.0, 0.01, 0.9], (sequences, 1))
    speed = generator.uniform(-1.0, 1.0, (sequences, 1)) * turning / t_s
    theta = generator.uniform(-np.pi, np.pi, (sequences, 1))
    angles = theta + speed * t_s * np.arange(_LENGTH)
    rows = np.zeros((sequences, _LENGTH, 7 + further))
    rows[:, 0, 0] = 1.0
    rows[:, 0, 1] = theta[:, 0] + generator.choice([0.0, 1.0, 4.0], sequences)
    rows[:, 0, 2] = speed[:, 0] * generator.choice([0.0, 0.5, 1.0, -1.0], sequences)
    size = 10.0 ** generator.uniform(-2.0, 3.0, (sequences, 1))
    for column in range(3, 7 + further):
        shift = 1.6 * (column % 2)
        noise = 0.05 * generator.standard_normal(angles.shape)
        rows[:, :, column] = size * (np.cos(angles + shift) + noise)
    bad = generator.random((sequences, _LENGTH, 4 + further)) < 0.002
    rows[:, :, 3:] = np.where(bad, generator.choice([np.nan, np.inf], bad.shape), rows[:, :, 3:])
    return np.ascontiguousarray(rows.reshape(-1, 7 + further).astype(np.float32))


def tracker_outputs(found: EmittedTracker, inputs: SingleArray) -> SingleArray:
    """What the compiled tracker must return for the rows of `tracker_inputs`: angle, speed, and of
    one that injects the voltage that it asks for and the current that it hands on.
    """
    tracker, own = found.tracker, cast(found.gains, SINGLE)
    rows = inputs.reshape(-1, _LENGTH, inputs.shape[1])
    state = tracker.start(own, wrap(rows[:, 0, 1].copy()), rows[:, 0, 2].copy())
    answers = np.empty((*rows.shape[:2], 6 if tracker.injects else 2), dtype=np.float32)
    with np.errstate(all="ignore"):  # rough sequences may leave the range of single precision
        for k in range(_LENGTH):
            v_alpha, v_beta, i_alpha, i_beta, *heard = (
                np.ascontiguousarray(rows[:, k, column]) for column in range(3, rows.shape[2])
            )
            state = tracker.step(
                own, state, (v_alpha, v_beta), (i_alpha, i_beta), tuple(heard), SINGLE
            )
            answers[:, k, 0], answers[:, k, 1] = state.theta_e, state.omega_e
            if tracker.injects:
                assert state.added is not None
                assert state.seen is not None
                for n, value in enumerate((*state.added, *state.seen)):
                    answers[:, k, 2 + n] = value
    return answers.reshape(-1, answers.shape[2])
