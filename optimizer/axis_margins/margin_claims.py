"""Bounds of M_s and of the phase margin, each proven over the cells of a box or refuted at a drive.

    M_s <= M             where  M^2 |D_cl|^2 - |D_ol|^2 >= 0 everywhere
    phase margin >= m    where nowhere |D_cl - D_ol| = |D_ol| with |D_cl|^2 < 4 sin^2(m/2) |D_ol|^2

A cell that the Bernstein coefficients do not decide is halved. The arithmetic is rational but for
the exponential of the winding, which is enclosed; nothing is rounded to nearest.
"""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.axis_margins.box_cells import AxisBox, Cell, rational
from dqforge.optimizer.axis_margins.loop_polynomials import (
    POWERS,
    AxisGains,
    Terms,
    bases,
    tabled,
    weighted,
)

if TYPE_CHECKING:
    from flint import fmpq_mat

Outcome = Literal["proven", "refuted", "open"]
_FREQUENCIES = np.linspace(0.0, 1.0, 5)

# Shares of a cell's sides at which a drive may refute a claim.
_DRIVES = ((0.5, 0.5), (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))


@dataclass(frozen=True, slots=True)
class Decision:
    """What became of a claim, and how many cells that took."""

    outcome: Outcome
    cells: int


@dataclass(frozen=True, slots=True)
class Claim:
    """A cell is decided where one of these polynomials is never negative on it.

    A point where all are negative refutes the claim.
    """

    alternatives: tuple[Terms, ...]


def sensitivity_claim(gains: AxisGains, bound: float) -> Claim:
    """M_s is at most a bound."""
    square = rational(bound) ** 2
    return Claim((weighted((square, gains.closed_squared()), (-1, gains.open_squared())),))


def phase_claim(gains: AxisGains, margin: float) -> Claim:
    """The phase margin is at least ``margin`` in rad.

    Where |L| < 1 or |L| > 1 all over a cell there is no crossover; elsewhere |1 + L| must be large.
    """
    from flint import arb

    share = (4 * (arb(margin) / 2).sin() ** 2).upper().fmpq()
    opened, control = gains.open_squared(), gains.control_squared()
    far = weighted((1, gains.closed_squared()), (-share, opened))
    below, above = weighted((1, opened), (-1, control)), weighted((1, control), (-1, opened))
    return Claim((far, below, above))


def decide(claim: Claim, box: AxisBox, most: int) -> Decision:
    """Halve cells until each is decided, a drive refutes the claim, or there are too many.

    Args:
        claim: What is claimed of every drive at every frequency.
        box: The drives.
        most: Most cells that are looked at.
    """
    tables = [tabled(terms) for terms in claim.alternatives]
    queue: list[tuple[float, int, Cell]] = [(0.0, 0, box.root())]
    for count in range(most):
        if not queue:
            return Decision("proven", count)
        cell = heapq.heappop(queue)[-1]
        kept = box.contracted(cell)
        if kept is None:
            continue
        found = _examined(tables, box, kept)
        if found.worst >= 0.0:
            continue
        if len(tables) == 1 and _refuted(tables[0], box, kept):
            return Decision("refuted", count + 1)
        for side, half in enumerate(kept.halves(found.widest)):
            heapq.heappush(queue, (found.worst, 2 * count + side, half))
    return Decision("open", most)


@dataclass(frozen=True, slots=True)
class _Examined:
    """Least coefficient over their spread (0 where the cell is decided), and where to cut."""

    worst: float
    widest: str


def _examined(tables: list[fmpq_mat], box: AxisBox, cell: Cell) -> _Examined:
    a, gamma = box.sampled(cell.b, cell.s)
    left, right = bases(cell.c, a, gamma)
    best: tuple[float, fmpq_mat] | None = None
    for table in tables:
        coefficients = left * table * right
        entries = coefficients.entries()
        least = min(entries)
        if least >= 0:
            return _Examined(0.0, "")
        share = float(least / (max(entries) - least)) if max(entries) > least else -math.inf
        if best is None or share > best[0]:
            best = share, coefficients
    assert best is not None
    return _Examined(best[0], _widest(best[1], box, cell))


def _widest(coefficients: fmpq_mat, box: AxisBox, cell: Cell) -> str:
    """The parameter along which the coefficients change most; a and gamma change with b and s."""
    block = np.array([float(value) for value in coefficients.entries()]).reshape(POWERS)
    steps = [float(np.max(np.abs(np.diff(block, axis=axis)))) for axis in range(3)]
    (b_low, b_high), (s_low, s_high) = ((float(x), float(y)) for x, y in (cell.b, cell.s))
    b, s, rho = 0.5 * (b_low + b_high), 0.5 * (s_low + s_high), float(box.rho)
    turn = (b_high - b_low) * abs(s), (s_high - s_low) * b
    fall = math.exp(-rho * b * s)
    grow = (b_high - b_low) * fall, (s_high - s_low) * 0.5 * rho * b * b * fall
    of_b = steps[1] * _share(*turn) + steps[2] * _share(*grow)
    of_s = steps[1] * _share(turn[1], turn[0]) + steps[2] * _share(grow[1], grow[0])
    sizes = {"c": steps[0], "b": of_b, "s": of_s}
    return max(sizes, key=lambda name: sizes[name])


def _share(part: float, rest: float) -> float:
    return part / (part + rest) if part + rest > 0.0 else 0.0


def _refuted(table: fmpq_mat, box: AxisBox, cell: Cell) -> bool:
    """Whether a drive of the cell makes the polynomial negative, in rational numbers."""
    block = np.array([float(value) for value in table.entries()]).reshape(POWERS)
    c = np.array([float(end) for end in cell.c]) @ np.stack([1.0 - _FREQUENCIES, _FREQUENCIES])
    for share in _DRIVES:
        drive = box.drive(cell, share)
        if drive is None:
            continue
        a, gamma = box.sampled((drive[0], drive[0]), (drive[1], drive[1]))
        along_c = block @ float(gamma[0]) ** np.arange(3) @ float(a[0]) ** np.arange(3)
        values = np.polynomial.polynomial.polyval(c, along_c)
        if np.min(values) >= 0.0:
            continue
        at = rational(float(c[np.argmin(values)]))
        left, right = bases((at, at), a, gamma)
        if max((left * table * right).entries()) < 0:
            return True
    return False
