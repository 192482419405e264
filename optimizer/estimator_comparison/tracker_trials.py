"""Trackers tried on drives that turn steadily: the emitted step in the loop with the machine's
answer to the voltage that it asks for.

The current of the load is held by its controller. What an injected voltage adds to it is the answer
of a linear machine, whose inductances are the incremental ones at that load, cross saturation
included; over a period with a voltage held in stator coordinates it is exact. A dead time opposes
the whole current phase by phase, so that it distorts the answer most where the load's own current
is small.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.drive_motion import ComplexArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimators.solve import TunedTracker
from dqforge.optimizer.observers.parts import EXACT, Pair

_SOFT = 0.02  # of the current limit: below, a phase takes less than the whole dead time
_PHASES = np.exp(2j * np.pi / 3.0 * np.arange(3))


@dataclass(frozen=True, slots=True, eq=False)
class SteadyDrives:
    """N drives, arrays of shape (N,).

    Args:
        omega: Electrical speed in rad/s.
        current: i_d + j i_q in A.
        voltage: v_d + j v_q in V that holds it, in the middle of a period.
        r_s: In Ohm.
        inductance: Incremental, in H, shape (N, 2, 2).
        lost: Amplitude in V of what the dead time takes from the fundamental.
        noise: Standard deviation of a measured current in A, per axis.
        i_max: Current limit in A.
        sum_flux: Integral of the sum of the phase voltages over the angle of a turn in V s, shape
            (N, K), the first value at 0 and all equally far apart; None where nothing hears it.
        sum_noise: Standard deviation of the measured sum in V, shape (N,); None likewise.
    """

    omega: FloatArray
    current: ComplexArray
    voltage: ComplexArray
    r_s: FloatArray
    inductance: FloatArray
    lost: FloatArray
    noise: FloatArray
    i_max: float
    sum_flux: FloatArray | None = None
    sum_noise: FloatArray | None = None


# A real matrix M of vectors z = x + j y as M z = p z + q conj(z), arrays of shape (N,).
Factors = tuple[ComplexArray, ComplexArray]


def _transition(drives: SteadyDrives, t_s: float) -> tuple[Factors, Factors]:
    """Factors of current and voltage over a period, in the rotor's frame at its beginning for the
    voltage and at its end for the current.
    """
    from scipy.linalg import expm

    count = len(drives.omega)
    inverse = np.linalg.inv(drives.inductance)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])[None] * drives.omega[:, None, None]
    matrix = np.zeros((count, 4, 4))
    resistance = drives.r_s[:, None, None] * np.eye(2)[None]
    matrix[:, :2, :2] = -inverse @ (resistance + turn @ drives.inductance)
    matrix[:, :2, 2:] = inverse
    matrix[:, 2:, 2:] = -turn
    step = expm(matrix * t_s)
    return _factors(step[:, :2, :2]), _factors(step[:, :2, 2:])


def _factors(m: FloatArray) -> Factors:
    straight = m[:, 0, 0] + m[:, 1, 1] + 1j * (m[:, 1, 0] - m[:, 0, 1])
    mirrored = m[:, 0, 0] - m[:, 1, 1] + 1j * (m[:, 1, 0] + m[:, 0, 1])
    halves = 0.5 * np.stack([straight, mirrored]).astype(np.complex128)
    return halves[0], halves[1]


def _applied(factors: Factors, vector: ComplexArray) -> ComplexArray:
    return np.asarray(factors[0] * vector + factors[1] * np.conj(vector))


def _dead(drives: SteadyDrives, current: ComplexArray) -> ComplexArray:
    """Voltage in V that the dead time takes at a current in stator coordinates."""
    phases = (current[:, None] * np.conj(_PHASES)).real / (_SOFT * drives.i_max)
    lost = 0.25 * np.pi * drives.lost[:, None] * np.clip(phases, -1.0, 1.0)
    return np.asarray(2.0 / 3.0 * (lost @ _PHASES))


def _summed(drives: SteadyDrives, theta: FloatArray) -> FloatArray:
    """Integral of the sum voltage at angles in rad by lines between its points, shape (N,)."""
    table = drives.sum_flux
    assert table is not None
    place = np.mod(theta, 2.0 * np.pi) / (2.0 * np.pi) * table.shape[1]
    below = place.astype(np.int64) % table.shape[1]
    rows, part = np.arange(len(theta)), place - np.floor(place)
    return np.asarray(
        (1.0 - part) * table[rows, below] + part * table[rows, (below + 1) % table.shape[1]]
    )


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


def tracked(
    tuned: TunedTracker,
    drives: SteadyDrives,
    angle: FloatArray,
    speed: FloatArray,
    samples: int,
    seed: int = 0,
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Error of the angle in rad, wrapped, and electrical speed in rad/s after each sample.

    Args:
        tuned: The tracker.
        drives: What it is tried on.
        angle: Error of its angle at the start in rad, shape (N,).
        speed: Electrical speed in rad/s that it starts with, shape (N,).
        samples: How many.
        seed: Of the noise.
    """
    generator = np.random.default_rng(seed)
    tracker, t_s, count = tuned.tracker, tuned.t_s, len(drives.omega)
    by_current, by_voltage = _transition(drives, t_s)
    dead = bool(np.any(drives.lost))
    half = np.exp(0.5j * drives.omega * t_s)
    answer = np.zeros(count, dtype=np.complex128)  # to what was added, in the rotor's frame
    acting = waiting = np.zeros(count, dtype=np.complex128)
    state = tracker.start(tuned.gains, np.asarray(EXACT.wrap(angle)), speed)
    for k in range(samples):
        theta = np.asarray(EXACT.wrap(drives.omega * t_s * k))
        turn = np.exp(1j * theta)
        whole = (drives.current + answer) * turn
        noise = generator.standard_normal((2, count)) * drives.noise
        # The fundamental that acted over the period before was held at its middle.
        before = drives.voltage * turn * np.conj(half) + acting
        seen = whole + noise[0] + 1j * noise[1]
        heard: tuple[FloatArray, ...] = ()
        if drives.sum_flux is not None and drives.sum_noise is not None:
            earlier = theta - drives.omega * t_s
            mean = (_summed(drives, theta) - _summed(drives, earlier)) / t_s
            heard = (mean + drives.sum_noise * generator.standard_normal(count),)
        state = tracker.step(tuned.gains, state, _pair(before), _pair(seen), heard, EXACT)
        yield np.asarray(EXACT.wrap(np.asarray(state.theta_e) - theta)), np.asarray(state.omega_e)
        acting = waiting
        if state.added is not None:
            waiting = np.asarray(state.added[0] + 1j * state.added[1])
        acted = acting
        if dead:
            acted = acting - _dead(drives, whole) + _dead(drives, drives.current * turn)
        answer = _applied(by_current, answer) + _applied(by_voltage, acted * np.conj(turn))
