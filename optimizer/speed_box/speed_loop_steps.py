"""Steps of the speed loop over one current sample, over cells of its box.

In flux linkage over voltage, phi = i L/(g t_s), speed w = omega L' kp_s/(t_s K sigma), torque
command T L'/(t_s K):

    d phi = -rho' c phi - e eta w + v
    d w   = h j b phi - (B t_s/J') (J'/J) w
    d w_f = (w - w_f) t_s/T_f
    v+ = I + (p + q) (T - b phi),   I+ = I + q (T - b phi)
    T+ = S - (1 + r) sigma y,       S+ = S - r sigma y       y = w or w_f

the last line every ratio-th sample only. K is the torque constant that the controller assumes, and

    rho' = R' t_s/L',  p = kp t_s/L',  q = ki t_s^2/L',  r = ki_s ratio t_s/kp_s
    h = kp_s t_s/(J' sigma),   eta = t_s K sigma/(L' kp_s)

with a scale sigma of the speed by which h is no smaller than a tenth and no smaller than e eta.

This is affine in each of b, c, j, e alone but for the exponential. Over a cell of width w that errs
from the interpolation of its corners by at most w^2/8 times its second derivatives,

    2 integral of exp(F t_1) F_i exp(F t_2) F_i exp(F t_3) over t_1 + t_2 + t_3 = 1

entry by entry no larger than the same with |F_i| and with F replaced by what it is at most: its
diagonal, and the moduli beside it. Where the friction meets J'/J = j/f, f is taken as 1 and the
rest belongs to the error.
"""

from __future__ import annotations

import itertools

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.cell_queue import Cell

# What the torque moves the speed by in a sample at least, in the scale of the speed: less would
# make the speed matter as much as the currents, whose errors are larger.
_COUPLED = 0.1
_MORE = 1.0 + 1e-12  # Makes up for the rounding of a bound.


@dataclass(frozen=True, slots=True)
class SpeedLoopNumbers:
    """The design's loop without unit, as above.

    ``friction`` is B t_s/J', ``filtering`` t_s/T_f (0 without a filter), ``integral`` r,
    ``uneven`` the largest |1/f - 1|, ``scale`` sigma.
    """

    rho: float
    h: float
    p: float
    q: float
    eta: float
    integral: float
    friction: float
    filtering: float
    ratio: int
    uneven: float
    scale: float

    @property
    def moving(self) -> int:
        """States of the drive: phi, w and, with a filter, w_f."""
        return 3 if self.filtering > 0.0 else 2

    @property
    def size(self) -> int:
        """States in all: those of the drive, v, I, T and S."""
        return self.moving + 4

    def update(self) -> FloatArray:
        """The speed controller, from all states but T to all, shape (n, n - 1)."""
        n, last = self.size, self.moving - 1
        matrix = np.zeros((n, n - 1))
        matrix[: n - 2, : n - 2] = np.eye(n - 2)
        matrix[n - 2, n - 2] = matrix[n - 1, n - 2] = 1.0
        matrix[n - 2, last] = -(1.0 + self.integral) * self.scale
        matrix[n - 1, last] = -self.integral * self.scale
        return matrix

    def flow(self, parameters: FloatArray) -> FloatArray:
        """The drive over time in samples, with v as its last column, shape (N, k + 1, k + 1)."""
        b, c, j, e = parameters.T
        k = self.moving
        flow = np.zeros((len(parameters), k + 1, k + 1))
        flow[:, 0, 0], flow[:, 0, 1], flow[:, 0, k] = -c * self.rho, -e * self.eta, 1.0
        flow[:, 1, 0], flow[:, 1, 1] = self.h * j * b, -self.friction * j
        if k == 3:
            flow[:, 2, 1], flow[:, 2, 2] = self.filtering, -self.filtering
        return flow

    def steps(self, parameters: FloatArray) -> FloatArray:
        """Steps of one current sample at parameters (b, c, j, e), shape (N, 4) -> (N, n, n)."""
        from scipy.linalg import expm

        b, k, n = parameters[:, 0], self.moving, self.size
        matrix = np.zeros((len(parameters), n, n))
        matrix[:, :k, : k + 1] = expm(self.flow(parameters))[:, :k]
        v, i, torque, total = range(k, n)
        matrix[:, v, 0], matrix[:, i, 0] = -(self.p + self.q) * b, -self.q * b
        matrix[:, v, i] = matrix[:, i, i] = 1.0
        matrix[:, v, torque], matrix[:, i, torque] = self.p + self.q, self.q
        matrix[:, torque, torque] = matrix[:, total, total] = 1.0
        return matrix

    def cycle(self, step: FloatArray) -> FloatArray:
        """One sample of the speed controller with one step ``ratio`` times, (n - 1, n - 1)."""
        whole = np.linalg.matrix_power(step, self.ratio) @ self.update()
        return np.asarray(np.delete(whole, self.size - 2, axis=0), dtype=np.float64)

    def left_out(self, cell: Cell) -> FloatArray:
        """Bounds of what the corners of a cell leave out of phi, w, w_f after a step.

        The part of each parameter, entry by entry over phi, w, w_f and v, and that of the friction,
        shape (5, k, k + 1).
        """
        slopes = self._slopes(cell)
        most = self._most(cell)
        size, k = len(most), self.moving
        found = np.zeros((len(slopes) + 1, k, size))
        for part, slope, width in zip(found, slopes, cell.width, strict=False):
            if width > 0.0:
                part[:] = 0.25 * width**2 * _nested(most, slope, 2)[:k]
        if self.friction * self.uneven > 0.0:
            rest = np.zeros_like(most)
            rest[1, 1] = self.friction * self.uneven * float(cell.high[2])
            found[-1] = _nested(most + rest, rest, 1)[:k]
        return found * _MORE

    def _slopes(self, cell: Cell) -> FloatArray:
        """Largest moduli of the flow's derivatives by b, c, j and e, shape (4, k + 1, k + 1)."""
        b, j = float(cell.high[0]), float(cell.high[2])
        slopes = np.zeros((4, self.moving + 1, self.moving + 1))
        slopes[0, 1, 0], slopes[1, 0, 0] = self.h * j, self.rho
        slopes[2, 1, 0], slopes[2, 1, 1], slopes[3, 0, 1] = self.h * b, self.friction, self.eta
        return slopes

    def _most(self, cell: Cell) -> FloatArray:
        """What the flow is at most over a cell, moduli beside the diagonal."""
        flows = self.flow(cell_corners(cell))
        diagonal = np.max(np.diagonal(flows, axis1=1, axis2=2), axis=0)
        most: FloatArray = np.max(np.abs(flows), axis=0)
        np.fill_diagonal(most, diagonal)
        return most


def _nested(most: FloatArray, slope: FloatArray, count: int) -> FloatArray:
    """Integral of exp(M t_0) S exp(M t_1) .. S exp(M t_count) over all t that add up to 1."""
    from scipy.linalg import expm

    size = len(most)
    block = np.kron(np.eye(count + 1), most) + np.kron(np.eye(count + 1, k=1), slope)
    return np.asarray(expm(block)[:size, -size:], dtype=np.float64)


def speed_scale(h: float, emf: float) -> float:
    """The scale sigma of the speed, from h and the largest e eta at sigma = 1.

    Args:
        h: kp_s t_s/J'.
        emf: Largest e eta.
    """
    return float(h / max(_COUPLED, np.sqrt(h * emf)))


def cell_corners(cell: Cell) -> FloatArray:
    """Corners of a cell, those of no width once, shape (V, D)."""
    sides = [
        (low,) if low == high else (low, high)
        for low, high in zip(cell.low.tolist(), cell.high.tolist(), strict=True)
    ]
    return np.array(list(itertools.product(*sides)))
