"""Co-energy of a machine as a tensor-product spline W: psi_d = dW/di_d and psi_q = dW/di_q.

W has degree four in both currents, so that the flux linkages have no curl by construction.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.flux_maps.noise import FluxNoise
from dqforge.machines.records import dataclass

_DEGREE = 4


_CELLS = (4, 24)


CHUNK = 20_000


_GAUSS = np.polynomial.legendre.leggauss(_DEGREE + 1)


@dataclass(frozen=True, slots=True)
class SplineBasis:
    """Splines of one current in multiples of ``scale`` A, about which an even one is symmetric."""

    knots: FloatArray
    scale: float
    even: bool

    @property
    def size(self) -> int:
        """Number of functions."""
        whole = self.knots.size - _DEGREE - 1
        return whole // 2 if self.even else whole

    def rows(self, current: FloatArray, order: int = 0) -> FloatArray:
        """Derivatives by the current in A, shape (n, size)."""
        from scipy.interpolate import BSpline

        x = np.clip(current / self.scale, self.knots[0], self.knots[-1])
        count = self.knots.size - _DEGREE - 1
        spline = BSpline(self.knots, np.eye(count), _DEGREE)
        values = np.asarray(spline.derivative(order)(x) if order else spline(x)) / self.scale**order
        if not self.even:
            return values
        # Functions of one side and their mirror images have one coefficient.
        return np.asarray(values[:, : count // 2] + values[:, : count // 2 - 1 : -1])

    def products(self, order: int) -> FloatArray:
        """Integrals over the axis, in multiples of its scale, of the products of derivatives:
        shape (size, size).
        """
        edges = np.unique(self.knots)
        half = 0.5 * np.diff(edges)
        at = (
            0.5 * (edges[1:] + edges[:-1])[:, np.newaxis] + half[:, np.newaxis] * _GAUSS[0]
        ).ravel()
        weights = (half[:, np.newaxis] * _GAUSS[1]).ravel()
        rows = self.rows(at * self.scale, order) * self.scale**order
        return np.asarray(rows.T @ (weights[:, np.newaxis] * rows))


def spline_basis(low: float, high: float, count: int, *, even: bool) -> SplineBasis:
    """Splines on even cells from ``low`` to ``high`` A, for ``count`` different currents."""
    cells = int(np.clip(count - 1, *_CELLS))
    if even:
        cells += cells % 2
    scale = 0.5 * (high - low)
    inner = np.linspace(low / scale, high / scale, cells + 1)
    knots = np.concatenate([np.full(_DEGREE, inner[0]), inner, np.full(_DEGREE, inner[-1])])
    return SplineBasis(knots, scale, even)


@dataclass(frozen=True, slots=True, eq=False)
class CoEnergy:
    """W(i_d, i_q) in J/p, shape (D, Q) of its coefficients, with what was found on the way.

    ``strength`` is the penalty's, ``freedom`` the effective number of parameters, ``noise`` what
    the fit used or found, ``cuts`` how many places needed the condition of positive definite
    inductances.
    """

    d: SplineBasis
    q: SplineBasis
    coefficients: FloatArray
    strength: float
    freedom: float
    noise: FluxNoise
    cuts: int

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Flux linkages in Wb on the grid of two axes in A: shape (2, M, N)."""
        return np.stack(
            [
                self.d.rows(i_d, 1) @ self.coefficients @ self.q.rows(i_q).T,
                self.d.rows(i_d) @ self.coefficients @ self.q.rows(i_q, 1).T,
            ]
        )

    def flux_at(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Flux linkages in Wb at points (K,) in A: shape (2, K)."""
        parts = [slice(start, start + CHUNK) for start in range(0, i_d.size, CHUNK)]
        found = [
            [
                np.einsum(
                    "kd,dq,kq->k",
                    self.d.rows(i_d[part], a),
                    self.coefficients,
                    self.q.rows(i_q[part], b),
                )
                for part in parts
            ]
            for a, b in ((1, 0), (0, 1))
        ]
        return np.stack([np.concatenate(values) for values in found])

    def inductances(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Incremental inductances in H on the grid of two axes: l_dd, l_dq, l_qq, shape (3, M,
        N).
        """
        return np.stack(
            [
                self.d.rows(i_d, a) @ self.coefficients @ self.q.rows(i_q, b).T
                for a, b in ((2, 0), (1, 1), (0, 2))
            ]
        )
