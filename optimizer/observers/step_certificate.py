"""A common Lyapunov function for the emitted step of a position observer, over speeds and loads.

At a constant speed and current the step, seen from the rotor, has a fixed point
(`dqforge.optimizer.observers.parts.steady_observer`); z is the distance to it, in the scale of its
states, and z' = A(omega, i_q) z its linearisation there. Where one P satisfies

    A(omega, i_q)^T P A(omega, i_q) <= lambda^2 P,    lambda < 1

at all speeds and currents of a range, sqrt(z^T P z) falls by lambda in every sample towards the
fixed point of that sample, in whatever order speeds and currents follow each other. What is left of
an error then is what the fixed point itself moves by, over 1 - lambda.

P comes from a semidefinite programme on a coarse grid; what is stated does not rest on it: lambda
is the largest of all points of a fine sequence, by eigenvalues of L A L^-1 with P = L^T L. Between
these points nothing is enclosed, unlike in `methods.lpv_certificate`. Members of the state that a
step takes from its inputs alone (the last current) have no error and are left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.scenario import plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.methods.lpv_certificate import LyapunovSearch
from dqforge.optimizer.observers.parts import ObserverMethod, steady_observer, vector_count

# Grid of the programme: so many speeds at both ends of the current and without any.
_SPEEDS = 16

# Points at which what it found is checked: the seconds that this takes are those of a simulation.
POINTS = 20_000

# Tries for a smaller factor, and parts of the range that are given up from its low end in turn
# where there is none over the whole of it, as shares of its logarithm.
_BISECTIONS = 3
_LEFT_OUT = (0.0, 0.25, 0.5, 0.75)

# A row of A below this is that of a member that a step takes from its inputs: what central
# differences of doubles leave of a zero. A factor must stay as far below one.
_NOTHING = 1e-7


@dataclass(frozen=True, slots=True)
class StepCertificate:
    """What holds of an observer's step.

    ``contraction`` is the largest factor per sample of the norm of a small error at ``points``
    speeds and currents, for electrical speeds from ``omega_low`` to ``omega_high`` in rad/s. ``p``
    (n, n) is the matrix of the norm in the states that are ``kept`` (of all, bool), over ``scale``
    (n,).
    """

    contraction: float
    omega_low: float
    omega_high: float
    points: int
    p: FloatArray
    kept: Any
    scale: FloatArray


@dataclass(frozen=True, slots=True)
class ObserverRange:
    """An observer on the machine that it knows, and where it is to hold.

    ``omega_low``, ``omega_high`` are electrical speeds in rad/s, ``i_q`` the largest |i_q| in A at
    i_d = 0, ``t_s`` the sampling period in s.
    """

    method: ObserverMethod
    gains: Any
    machine: LinearMachine
    t_s: float
    omega_low: float
    omega_high: float
    i_q: float

    def matrices(self, omega: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivative of the step by the state (M, n, n), and the states (M, n), at M points.

        Raises:
            NoSolutionError: There is no steady state at some point; says where.
        """
        current = np.asarray(1j * i_q, dtype=np.complex128)
        found = steady_observer(
            self.method, self.gains, self.t_s, plants(self.machine), current, omega
        )
        if not np.all(found.found):
            k = int(np.argmin(found.found))
            raise NoSolutionError(f"no steady state {_place(omega[k], i_q[k])}")
        return found.jacobian, found.states

    def sequence(self, count: int) -> tuple[FloatArray, FloatArray]:
        """``count`` speeds and currents that fill the range evenly, without chance, ends among
        them, shapes (count,).
        """
        index = np.arange(count)
        share = (index * 0.6180339887498949) % 1.0
        share[:4] = (0.0, 0.0, 1.0, 1.0)
        omega = np.asarray(self.omega_low * (self.omega_high / self.omega_low) ** share)
        i_q = np.linspace(-self.i_q, self.i_q, count)[
            np.argsort((index * 0.4142135623730951) % 1.0)
        ]
        i_q[:4] = self.i_q * np.array([1.0, -1.0, 1.0, -1.0])
        return omega, i_q


def _place(omega: float, i_q: float) -> str:
    return f"at {omega / (2.0 * np.pi):.3g} Hz with i_q = {i_q:.3g} A"


def certify_step(asked: ObserverRange, points: int = POINTS) -> StepCertificate:
    """Find one norm in which every step of the range shrinks a small error.

    The range loses its low end, a quarter of its logarithm at a time, where there is none over the
    whole of it.

    Args:
        asked: The observer and the range.
        points: How many speeds and currents are checked.

    Raises:
        NoSolutionError: There is none even at the upper quarter; says what is in the way over the
            whole range.
    """
    reasons = []
    span = asked.omega_high / asked.omega_low
    for share in _LEFT_OUT:
        try:
            return _certified(replace(asked, omega_low=asked.omega_low * span**share), points)
        except NoSolutionError as error:
            reasons.append(error.message)
    raise NoSolutionError(f"no certificate: {reasons[0]}")


def _certified(asked: ObserverRange, points: int) -> StepCertificate:
    speeds = np.geomspace(asked.omega_low, asked.omega_high, _SPEEDS)
    omega = np.tile(speeds, 3)
    i_q = np.repeat([asked.i_q, -asked.i_q, 0.0], _SPEEDS)
    matrices, states = asked.matrices(omega, i_q)
    radius = np.max(np.abs(np.linalg.eigvals(matrices)), axis=1)
    worst = int(np.argmax(radius))
    if radius[worst] >= 1.0:
        raise NoSolutionError(
            f"a pole of modulus {radius[worst]:.5f} {_place(omega[worst], i_q[worst])}"
        )
    kept = np.any(np.abs(matrices) > _NOTHING, axis=(0, 2))
    scale = _scales(asked, states)[kept]
    grid = _scaled(matrices, kept, scale)
    p = _smallest(grid, float(radius[worst]))
    if p is None:
        raise NoSolutionError("no norm in which every step of this range shrinks all errors")
    checked = asked.sequence(points)
    factor = factors(p, _scaled(asked.matrices(*checked)[0], kept, scale))
    largest = max(float(np.max(factor)), float(np.max(factors(p, grid))))
    if not largest < 1.0 - _NOTHING:
        k = int(np.argmax(factor))
        raise NoSolutionError(
            f"the norm that was found grows {_place(checked[0][k], checked[1][k])}"
        )
    return StepCertificate(
        largest, asked.omega_low, asked.omega_high, points + grid.shape[0], p, kept, scale
    )


def _scales(asked: ObserverRange, states: FloatArray) -> FloatArray:
    """Size of each state, shape (n,): vectors by their largest norm, the angle 1 rad, the speed a
    radian per sample.
    """
    scale = np.ones(states.shape[1])
    count = 2 * vector_count(asked.method)
    for k in range(0, count, 2):
        size = float(np.max(np.hypot(states[:, k], states[:, k + 1])))
        scale[k : k + 2] = size if size > _NOTHING else 1.0
    if count < states.shape[1] - 2:
        omega = np.full(len(states), asked.omega_high)
        sizes = asked.method.sizes
        own = np.abs(states[:, count:-2]) if sizes is None else sizes(states[:, count:-2], omega)
        scale[count:-2] = np.where(np.max(own, axis=0) > _NOTHING, np.max(own, axis=0), 1.0)
    scale[-1] = 1.0 / asked.t_s
    return scale


def _scaled(matrices: FloatArray, kept: Any, scale: FloatArray) -> FloatArray:
    own = matrices[:, kept][:, :, kept]
    return np.asarray(own * scale[None, None, :] / scale[None, :, None])


def factors(p: FloatArray, matrices: FloatArray) -> FloatArray:
    """Largest factor of sqrt(z^T P z) in a step of each of M matrices, shape (M,).

    Args:
        p: Positive definite, shape (n, n).
        matrices: Shape (M, n, n).
    """
    root = np.linalg.cholesky(p).T
    turned = root @ matrices @ np.linalg.inv(root)
    largest = np.linalg.eigvalsh(np.swapaxes(turned, 1, 2) @ turned)[:, -1]
    return np.asarray(np.sqrt(largest))


def _smallest(grid: FloatArray, radius: float) -> FloatArray | None:
    """P of the smallest factor that some tries find on a grid of matrices, or None."""
    search = LyapunovSearch(grid)
    best = search.within(1.0)
    low, high = radius, 1.0
    for _ in range(_BISECTIONS if best is not None else 0):
        middle = float(np.sqrt(low * high))
        found = search.within(middle)
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best if best is not None and np.linalg.eigvalsh(best)[0] > 0.0 else None
