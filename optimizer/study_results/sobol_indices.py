"""First-order and total sensitivities by a design that is made for them.

Of two independent samples A and B of n rows each, and D samples AB_i that are A with column i of
B, the estimators of Saltelli and others (2010, doi:10.1016/j.cpc.2009.09.018) are

    S_i = mean(f(B) (f(AB_i) - f(A))) / V,        T_i = mean((f(A) - f(AB_i))^2) / (2 V),

with V the variance of f(A) and f(B) together and f counted from its mean. That takes n (D + 2)
rows in the order of `dqforge.optimizer.exploration.saltelli_design`; where the samples come from a
Sobol sequence, a power of 2 is the best n.
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class SobolIndices:
    """First-order and total sensitivities of an output, arrays of shape (D,), from ``base`` rows of
    each sample; NaN of an output that does not change.
    """

    first: FloatArray
    total: FloatArray
    base: int


def _nothing() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class SaltelliSums:
    """What the estimators need of the rows so far.

    Args:
        inputs: Number of inputs D.
        centre: A value of the output from which it is counted; None before the first base row.
        base: Base rows so far; those with a row that is no finite number are left out.
        whole: Sums over A and B together: of the output, and of its square.
        changes, products, squares: Sums of f(AB_i) - f(A), of that times f(B), and of its square,
            shape (D,).
        left: Rows behind the last whole base row.
    """

    inputs: int
    centre: float | None = None
    base: int = 0
    whole: tuple[float, float] = (0.0, 0.0)
    changes: FloatArray = field(default_factory=_nothing)
    products: FloatArray = field(default_factory=_nothing)
    squares: FloatArray = field(default_factory=_nothing)
    left: FloatArray = field(default_factory=_nothing)

    def plus(self, output: FloatArray) -> SaltelliSums:
        """With the rows that follow, shape (n,)."""
        width = self.inputs + 2
        rows = np.concatenate([self.left, output])
        count = rows.size // width
        left = rows[count * width :].copy()
        table = rows[: count * width].reshape(count, width)
        table = table[np.all(np.isfinite(table), axis=1)]
        if not len(table):
            return replace(self, left=left)
        centre = float(np.mean(table)) if self.centre is None else self.centre
        table = table - centre
        both, change = table[:, :2], table[:, 2:] - table[:, :1]
        zero = np.zeros(self.inputs)
        return SaltelliSums(
            inputs=self.inputs,
            centre=centre,
            base=self.base + len(table),
            whole=(
                self.whole[0] + float(np.sum(both)),
                self.whole[1] + float(np.sum(both * both)),
            ),
            changes=(self.changes if self.base else zero) + np.sum(change, axis=0),
            products=(self.products if self.base else zero) + table[:, 1] @ change,
            squares=(self.squares if self.base else zero) + np.sum(change * change, axis=0),
            left=left,
        )

    def indices(self) -> SobolIndices:
        """The sensitivities."""
        unknown = np.full(self.inputs, np.nan)
        if self.base < 2:
            return SobolIndices(unknown, unknown, self.base)
        mean = self.whole[0] / (2 * self.base)
        variance = self.whole[1] / (2 * self.base) - mean * mean
        if not variance > 1e-28 * ((self.centre or 0.0) ** 2 + variance):
            return SobolIndices(unknown, unknown, self.base)
        first = (self.products - mean * self.changes) / (self.base * variance)
        return SobolIndices(first, self.squares / (2.0 * self.base * variance), self.base)


def sobol_indices(output: FloatArray, inputs: int) -> SobolIndices:
    """First-order and total sensitivities from the rows of the design in their order.

    Args:
        output: The output of each row, shape (n (D + 2),); rows behind the last whole base row, and
            base rows of which one row is no finite number, are left out.
        inputs: Number of inputs D.
    """
    return SaltelliSums(inputs).plus(np.asarray(output, dtype=np.float64)).indices()
