"""MTPA loci, limit torques and currents of many machines over one flux map.

The best angle of a current changes little with the scales of the map: Newton's method on the
derivative of the torque by the angle starts from the nominal locus. A fixed number of steps, and
rotations without angle functions, give a machine the same numbers in any batch.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.scaled_machines import ScaledMachines
from dqforge.machines.dq_machines.synchronous import FluxJet
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.mtpa_locus import free_locus

_LEVELS = 32
_STEPS = 6
_LARGEST_STEP = 0.15  # Largest change of the angle in one step, in rad.

# Last change of the angle in rad above which a point counts as not found: the torque is flat there
# to its square.
_CONVERGED = 1e-9
_TORQUE_STEPS = 5
_TORQUE_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class ScaledLoci:
    """Points of most torque for their current, L of each of N machines, arrays of shape (L, N).

    ``current``, ``i_d``, ``i_q`` in A, ascending, the last at the current limit; ``torque`` in N m,
    its last row the limit torque. ``last_step`` is the largest last change of the angle in rad,
    shape (N,). ``solved`` is False, shape (N,), where the single path has to answer: a point did
    not settle, the torque does not rise along the locus, or it leaves the data of the map.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    last_step: FloatArray
    solved: BoolArray

    @property
    def torque_max(self) -> FloatArray:
        """Largest torque in N m within the current limits, shape (N,); NaN where not solved."""
        return np.where(self.solved, self.torque[-1], np.nan)


def scaled_loci(machines: ScaledMachines) -> ScaledLoci:
    """MTPA loci up to each machine's ``i_max``.

    Args:
        machines: N machines over one flux map.

    Raises:
        InputError: The nominal machine makes no torque with positive q current.
    """
    shares = np.linspace(1.0 / _LEVELS, 1.0, _LEVELS)[:, np.newaxis]
    current = shares * np.sqrt(shares) * machines.i_max
    u, v = _nominal_directions(machines, current)
    step = np.zeros_like(current)
    for _ in range(_STEPS):
        i_d, i_q = current * u, current * v
        slope, bend = _by_angle(machines.jet(i_d, i_q), i_d, i_q)
        # Where the torque bends upwards the step leads the way that it rises.
        away = np.where(bend < 0.0, -bend, np.abs(bend) + 1e-300)
        step = np.clip(slope / away, -_LARGEST_STEP, _LARGEST_STEP)
        u, v = _turned(u, v, step)
    i_d, i_q = current * u, current * v
    torque = machines.torque(i_d, i_q)
    last = np.max(np.abs(step), axis=0)
    solved = (last < _CONVERGED) & (torque[0] > 0.0) & np.all(np.diff(torque, axis=0) > 0.0, axis=0)
    if not machines.nominal.flux_map.extrapolate:
        solved &= np.all(machines.known(i_d, i_q), axis=0)
    return ScaledLoci(current, i_d, i_q, torque, last, solved)


def _nominal_directions(
    machines: ScaledMachines, current: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors of the nominal locus at currents that saturate as much, shape (L, N)."""
    nominal = machines.nominal
    locus = free_locus(nominal, nominal.i_max)
    saturating = current / machines.current
    i_d = np.interp(saturating, locus.current, locus.i_d / locus.current)
    i_q = np.interp(saturating, locus.current, locus.i_q / locus.current)
    size = np.sqrt(i_d * i_d + i_q * i_q)
    return i_d / size, i_q / size


def _by_angle(jet: FluxJet, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second derivative of T / (3/2 p) by the angle of the current, at its magnitude."""
    by_d = jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q
    by_q = jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d
    by_dd = jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd
    by_dq = jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq
    by_qq = 2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d
    slope = i_d * by_q - i_q * by_d
    bend = i_q * i_q * by_dd - 2.0 * i_d * i_q * by_dq + i_d * i_d * by_qq
    return slope, bend - i_d * by_d - i_q * by_q


def _turned(u: FloatArray, v: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors turned by small angles: by 2 atan(angle / 2), without a function of angles."""
    square = 0.25 * angle * angle
    cosine, sine = (1.0 - square) / (1.0 + square), angle / (1.0 + square)
    u, v = cosine * u - sine * v, sine * u + cosine * v
    size = np.sqrt(u * u + v * v)
    return u / size, v / size


def currents_on_loci(
    machines: ScaledMachines, loci: ScaledLoci, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Currents (i_d, i_q) in A with least copper loss for torques, shape (P, N).

    NaN where a machine is not solved, or beyond its limit torque.

    Args:
        machines: N machines over one flux map.
        loci: Their loci.
        torque: Torques of any sign in N m, shape (P, N).
    """
    target = np.broadcast_to(np.abs(torque), (np.shape(torque)[0], machines.count))
    i_d, i_q = _between_points(loci, target)
    factor = 1.5 * machines.pole_pairs
    for _ in range(_TORQUE_STEPS):
        jet = machines.jet(i_d, i_q)
        by_d = jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q
        by_q = jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d
        by_dd = jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd
        by_dq = jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq
        by_qq = 2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d
        # Torque as asked for, and gradients of torque and |i|^2 in parallel.
        missing = target / factor - (jet.psi_d * i_q - jet.psi_q * i_d)
        askew = i_d * by_q - i_q * by_d
        askew_d = by_q + i_d * by_dq - i_q * by_dd
        askew_q = i_d * by_qq - by_d - i_q * by_dq
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (by_d * askew_q - by_q * askew_d)
            step_d = (missing * askew_q + by_q * askew) * scale
            step_q = (-by_d * askew - missing * askew_d) * scale
        i_d = i_d + np.where(target > 0.0, step_d, 0.0)
        i_q = i_q + np.where(target > 0.0, step_q, 0.0)
    found = np.abs(machines.torque(i_d, i_q) - target) <= _TORQUE_ROUNDING * loci.torque[-1]
    found &= loci.solved & (target <= loci.torque[-1] * (1.0 + 1e-12))
    return np.where(found, i_d, np.nan), np.where(found, np.copysign(i_q, torque), np.nan)


def _between_points(loci: ScaledLoci, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents between the points of the loci next to torques >= 0 in N m, shape (P, N).

    Below the first point the current follows a power of the torque: 1 with a magnet, 1/2 without.
    """
    above = np.zeros(torque.shape, dtype=np.intp)
    for row in loci.torque[:-1]:
        above += torque > row
    low, high = np.maximum(above - 1, 0), np.maximum(above, 1)

    def at(
        values: FloatArray, places: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    ) -> FloatArray:
        return np.asarray(np.take_along_axis(values, places, axis=0))

    first, second = loci.torque[0], loci.torque[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (torque - at(loci.torque, low)) / (at(loci.torque, high) - at(loci.torque, low))
        linear = np.log(second / first) < 1.5 * np.log(loci.current[1] / loci.current[0])
        start = torque / first
        start = np.where(linear, start, np.sqrt(start))
    is_start = above == 0
    found = [
        np.where(
            is_start,
            start * part[0],
            at(part, low) + share * (at(part, high) - at(part, low)),
        )
        for part in (loci.i_d, loci.i_q)
    ]
    return found[0], found[1]
