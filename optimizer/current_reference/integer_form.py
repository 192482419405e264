"""The current reference in fixed point: a code of the torque in, codes of (i_d, i_q) out,
as the emitted C has it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.integer_fit import CodeScale
from dqforge.optimizer.curves.integer_polynomial import CodeArray, FixedPolynomial

# Bits of the numbers of each fixed-point format.
FIXED_WIDTHS: dict[NumberFormat, int] = {"q15": 16, "q31": 32}


@dataclass(frozen=True, slots=True)
class FixedReference:
    """Polynomials in integers with their full scales.

    Args:
        d, q: Codes of i_d and i_q over the code of the torque; ``d`` is None where i_d = 0.
        torque_base, current_base: What 2^(width - 1) codes stand for, in N m and A.
    """

    d: FixedPolynomial | None
    q: FixedPolynomial
    torque_base: float
    current_base: float

    @property
    def width(self) -> int:
        """Bits of the numbers, 16 or 32."""
        return self.q.width

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return next(name for name, width in FIXED_WIDTHS.items() if width == self.width)

    @property
    def end(self) -> int:
        """Code at which the magnitude of the torque is clamped."""
        return self.q.end

    @property
    def scale(self) -> CodeScale:
        """Full scales of torque and current."""
        return CodeScale(self.torque_base, self.current_base, self.width)

    @property
    def torque_max(self) -> float:
        """End of the domain in N m."""
        return float(self.scale.arguments(np.array(self.end)))

    def codes(self, torque: CodeArray) -> tuple[CodeArray, CodeArray]:
        """Codes of (i_d, i_q) as the emitted C returns them, for any code of the torque,
        shape (N,).
        """
        magnitude = np.minimum(np.abs(torque), self.end)
        i_d = np.zeros_like(magnitude) if self.d is None else self.d.evaluate(magnitude)
        i_q = self.q.evaluate(magnitude)
        return i_d, np.where(torque < 0, -i_q, i_q)

    def nearest(self, torque: NDArray[Any]) -> CodeArray:
        """Codes of torques in N m, shape (N,), saturated; not-a-number becomes 0."""
        share = np.clip(
            np.nan_to_num(np.asarray(torque, dtype=np.float64) / self.torque_base), -1.0, 1.0
        )
        return np.minimum(np.rint(share * self.scale.one), self.scale.one - 1.0).astype(np.int64)

    def currents(
        self,
        torque: NDArray[Any],
        *,
        fused: bool = False,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray]:
        """(i_d, i_q) in A at the codes nearest to torques in N m, shape (N,).

        Integers know no contraction.
        """
        unit = self.current_base / self.scale.one
        i_d, i_q = self.codes(self.nearest(torque))
        return np.multiply(i_d, unit, dtype=np.float64), np.multiply(i_q, unit, dtype=np.float64)

    def samples(self, count: int) -> FloatArray:
        """Torques in N m that have codes: all of them for 16 bits, else some ``count``,
        breakpoints included.
        """
        if self.width <= 16:
            return self.scale.arguments(np.arange(self.end + 1))
        even = np.linspace(0.0, self.end, count)
        low = np.geomspace(1.0, self.end, count // 4)
        starts = np.array(self.starts)
        every = np.unique(
            np.concatenate([np.rint(even), np.rint(low), starts, np.maximum(starts - 1, 0)])
        )
        return self.scale.arguments(every.astype(np.int64))

    @property
    def starts(self) -> tuple[int, ...]:
        """Codes at which segments of either current begin, ascending."""
        polynomials = [polynomial for polynomial in (self.d, self.q) if polynomial is not None]
        return tuple(sorted({start for polynomial in polynomials for start in polynomial.starts}))
