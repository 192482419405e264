"""The phase-locked loop of an injection as a sampled linear system: its poles, and the noise of the
angle by that of the current.

The deviation of the angle (true less estimated) and of the speed are its states, with those of the
last samples: a voltage that was asked for at one sample acts in the next period and is seen at the
end of it, the product of a longer wave counts over the whole wave.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.estimators.tracker import TrackerLoop
from dqforge.optimizer.saliency.wave_steps import WaveGains


def _seen_at(gains: WaveGains) -> tuple[tuple[int, float], ...]:
    """How many samples before the correction the errors were made that it counts, and in what
    shares; 0 is the predicted angle of now.
    """
    if len(gains.carrier) == 2:
        return ((2, 0.5), (3, 0.5))
    count = len(gains.carrier)
    return tuple((n, 1.0 / count) for n in range(count))


def wave_tracking(gains: WaveGains) -> TrackerLoop:
    """The loop for the judgement of a speed loop."""
    ahead = 1.5 if len(gains.carrier) == 2 else 0.0
    return TrackerLoop(gains.t_s, gains.k_p, gains.k_i, _seen_at(gains), ahead)


def loop_matrices(gains: WaveGains) -> tuple[FloatArray, FloatArray]:
    """Transition of (angle, speed, earlier errors) and the input of an error of the measurement in
    rad, shapes (n, n) and (n,).
    """
    seen, t_s, square = _seen_at(gains), gains.t_s, len(gains.carrier) == 2
    size = 2 + max(n for n, _ in seen)
    # 0: angle after the last correction, 1: speed, then errors of 1, 2, ... samples before
    ahead = np.zeros(size)
    ahead[0], ahead[1] = 1.0, t_s
    measured = np.zeros(size)
    for n, share in seen:
        if n == 0:
            measured += share * ahead
        else:
            measured[1 + n] += share
    a, b = np.zeros((size, size)), np.zeros(size)
    a[0], b[0] = ahead - gains.k_p * measured, -gains.k_p
    a[1], b[1] = -gains.k_i * measured, -gains.k_i
    a[1, 1] += 1.0
    if square:
        # the error of the direction that is asked for now: 1.5 samples ahead
        a[2], b[2] = a[0] + 1.5 * t_s * a[1], b[0] + 1.5 * t_s * b[1]
    else:
        a[2] = ahead
    a[3:, 2:-1] += np.eye(size - 3)
    return a, b


def largest_pole(gains: WaveGains) -> float:
    """Largest modulus of the poles: stable below 1."""
    return float(np.max(np.abs(np.linalg.eigvals(loop_matrices(gains)[0]))))


def angle_noise(gains: WaveGains, current_noise: float) -> float:
    """Standard deviation of the angle in rad without load, by white noise of the current of
    ``current_noise`` A per axis.
    """
    from scipy.linalg import solve_discrete_lyapunov

    a, b = loop_matrices(gains)
    scale = abs(gains.scale[0]) * current_noise
    if len(gains.carrier) == 2:
        # twice the sum of three samples with alternating sign, -1, 2, -1 of white noise
        taps = 2.0 * scale * np.array([1.0, 2.0, 1.0])
    else:
        taps = scale * np.sqrt(np.mean(np.square(gains.reference))) * np.ones(len(gains.carrier))
        if gains.carrier_beta:
            taps = scale * np.ones(len(gains.carrier))
    memory = len(taps) - 1
    size = len(b)
    whole = np.zeros((size + memory, size + memory))
    source = np.zeros(size + memory)
    whole[:size, :size] = a
    whole[:size, size:] = np.outer(b, taps[1:])
    source[:size], source[size] = b * taps[0], 1.0
    whole[size + 1 :, size:-1] += np.eye(memory - 1)
    covariance = solve_discrete_lyapunov(whole, np.outer(source, source))
    return float(np.sqrt(covariance[0, 0]))
