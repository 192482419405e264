"""How noisy the points of a flux map are: by repeated points, by mirror symmetry,
by differences of neighbours.

Smooth deviations, such as those of a frame that is turned or of an iron core that is not symmetric,
are no noise.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

NoiseSource = Literal["repeats", "symmetry", "neighbours", "residual"]
_FEWEST_REPEATS = 8
_NORMAL_MEDIAN = 0.6745  # Median of the magnitude of a normal variable of unit variance.

# Sum of the squares of (1, -4, 6, -4, 1): the variance of a fourth difference over that of the
# points.
_FOURTH = 70.0
_SMOOTH_ORDER = 4
_FEWEST_MIRRORED = 40


@dataclass(frozen=True, slots=True)
class FluxNoise:
    """Standard deviation of single points in Wb, of psi_d and psi_q, and what shows it."""

    d: float
    q: float
    source: NoiseSource

    @property
    def largest(self) -> float:
        """The larger one in Wb."""
        return max(self.d, self.q)


def noise_of_repeats(
    i_d: FloatArray, i_q: FloatArray, psi: FloatArray, tolerance: float
) -> FluxNoise | None:
    """Noise by the scatter of points given repeatedly, pooled; None where fewer than 8 tell it.

    ``i_d``, ``i_q`` in A of shape (K,), ``psi`` in Wb of shape (2, K); currents within
    ``tolerance`` A are the same.
    """
    keys = np.round(np.stack([i_d, i_q]) / tolerance)
    _, group, counts = np.unique(keys, axis=1, return_inverse=True, return_counts=True)
    freedom = i_d.size - counts.size
    if freedom < _FEWEST_REPEATS:
        return None
    group = group.ravel()
    means = np.stack([np.bincount(group, part) / counts for part in psi])
    spread = np.sqrt(np.sum((psi - means[:, group]) ** 2, axis=1) / freedom)
    return FluxNoise(float(spread[0]), float(spread[1]), "repeats")


def _robust(values: FloatArray) -> float:
    """Standard deviation of a normal variable by the median of its magnitude,
    which outliers do not move.
    """
    return float(np.median(np.abs(values))) / _NORMAL_MEDIAN if values.size else float(np.inf)


def _of_neighbours(axis: FloatArray, values: FloatArray) -> float:
    """Noise by fourth differences along the first axis, where its points are evenly spaced;
    inf where it cannot.
    """
    steps = np.diff(axis)
    if axis.size < 5 or np.max(np.abs(steps - np.mean(steps))) > 1e-3 * np.mean(steps):
        return np.inf
    return _robust(np.diff(values, 4, axis=0)) / float(np.sqrt(_FOURTH))


def noise_of_neighbours(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) by the differences of neighbours, along the axis that shows less.

    None otherwise.

    Curvature makes differences, too, most of all on coarse grids;
    it does so along one axis more than along the other.
    """
    found = [min(_of_neighbours(i_d, part), _of_neighbours(i_q, part.T)) for part in psi]
    return FluxNoise(found[0], found[1], "neighbours") if np.all(np.isfinite(found)) else None


def _without_smooth_part(i_d: FloatArray, i_q: FloatArray, values: FloatArray) -> FloatArray:
    """What a polynomial of total degree 4 in both currents leaves of values, shape (K,).

    Scaled to its freedom.
    """
    x, y = i_d / np.max(np.abs(i_d)), i_q / np.max(np.abs(i_q))
    powers = [(a, b) for a in range(_SMOOTH_ORDER + 1) for b in range(_SMOOTH_ORDER + 1 - a)]
    terms = np.stack([x**a * y**b for a, b in powers], axis=1)
    rest = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    return np.asarray(rest * np.sqrt(values.size / (values.size - len(powers))))


def noise_of_symmetry(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) over a whole plane by the two halves, less their smooth difference.

    None otherwise.
    """
    upper = i_q > 0.0
    if np.max(np.abs(i_q + i_q[::-1])) > 1e-6 * np.max(np.abs(i_q)) or i_d.size * np.count_nonzero(
        upper
    ) < (_FEWEST_MIRRORED):
        return None
    mirrored = psi[:, :, ::-1] * np.array([1.0, -1.0])[:, np.newaxis, np.newaxis]
    apart = ((psi - mirrored) / np.sqrt(2.0))[:, :, upper].reshape(2, -1)
    at = [part.ravel() for part in np.meshgrid(i_d, i_q[upper], indexing="ij")]
    found = [_robust(_without_smooth_part(at[0], at[1], part)) for part in apart]
    return FluxNoise(found[0], found[1], "symmetry")


def noise_of_grid(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> FluxNoise | None:
    """Noise of a grid (2, M, N) in Wb as its halves show it, unless neighbours show less.

    None where neither can.

    The halves of computed maps are mirror images to the last digit: what they show then is no
    noise, nor is it more than the points of a half plane show, which is found from neighbours
    alone.
    """
    neighbours, symmetry = noise_of_neighbours(i_d, i_q, psi), noise_of_symmetry(i_d, i_q, psi)
    if symmetry is None or neighbours is None:
        return neighbours if symmetry is None else symmetry
    same = symmetry.largest <= 1e-6 * float(np.max(np.abs(psi)))
    if same or symmetry.largest > neighbours.largest:
        return neighbours
    return symmetry


def inductance_noise(noise: FluxNoise, i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> float:
    """Noise of the incremental inductances of a spline through a grid over their mean:
    flux noise per rise of a step.

    ``psi`` has the shape (2, M, N); the mean rise per step is that of the corner to corner means.
    """
    rise_d = float(np.mean(psi[0, -1] - psi[0, 0])) / (i_d.size - 1)
    rise_q = float(np.mean(psi[1, :, -1] - psi[1, :, 0])) / (i_q.size - 1)
    return max(noise.d / max(rise_d, 1e-300), noise.q / max(rise_q, 1e-300))
