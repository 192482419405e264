"""Machines in ball arithmetic: flux linkages with their derivatives at balls or
power series of the currents.

Constant inductances are one formula. A flux map is one bicubic polynomial per cell of its grid:
where an interval of currents lies in several cells, each of their polynomials is followed over the
whole interval, and the true flux linkage is one of them everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import Value

if TYPE_CHECKING:
    from flint import arb


_MOST_CELLS = 9


@dataclass(frozen=True, slots=True)
class Jet:
    """Flux linkages in Wb and their derivatives by the currents, as `FluxJet` has them."""

    psi_d: Value
    psi_q: Value
    l_dd: Value
    l_dq: Value
    l_qd: Value
    l_qq: Value
    d_dd: Value
    d_dq: Value
    d_qq: Value
    q_dd: Value
    q_dq: Value
    q_qq: Value


JetFunction = Callable[[Value, Value], Jet]


def _linear(machine: LinearMachine) -> JetFunction:
    from flint import arb

    l_d, l_q, psi_pm, zero = arb(machine.l_d), arb(machine.l_q), arb(machine.psi_pm), arb(0)

    def jet(i_d: Value, i_q: Value) -> Jet:
        return Jet(
            i_d * l_d + psi_pm, i_q * l_q, l_d, zero, zero, l_q, zero, zero, zero, zero, zero, zero
        )

    return jet


def _cubic(row: list[Value], x: Value, order: int) -> list[Value]:
    """Value and derivatives up to an order of a cubic, by repeated synthetic division."""
    c0, c1, c2, c3 = row
    first = c3 * x
    sums = first + c2
    second = sums * x + c1
    found = [second * x + c0]
    if order > 0:
        once = first + sums
        found.append(once * x + second)
        if order > 1:
            found.append((first + once) * 2)
    return found


def bicubic(table: Any, i_d: Value, i_q: Value) -> list[Value]:
    """Value and derivatives by d, q, dd, dq, qq of a bicubic, rows by powers of q,
    columns by powers of d.
    """
    along_d = [_cubic(row, i_d, 2) for row in table]
    value, by_q, by_qq = _cubic([row[0] for row in along_d], i_q, 2)
    by_d, by_dq = _cubic([row[1] for row in along_d], i_q, 1)
    (by_dd,) = _cubic([row[2] for row in along_d], i_q, 0)
    return [value, by_d, by_q, by_dd, by_dq, by_qq]


@lru_cache(maxsize=1024)
def _cell(flux_map: FluxMap, row: int, column: int, *, slopes: bool) -> JetFunction:
    from flint import arb

    coefficients, corner_d, corner_q = flux_map.cell(row, column)
    at_d, at_q = arb(corner_d), arb(corner_q)
    tables = [
        [[arb(float(c)) for c in row] for row in coefficients[:, :, flux]] for flux in range(2)
    ]

    def jet(i_d: Value, i_q: Value) -> Jet:
        d, q = (bicubic(table, i_d - at_d, i_q - at_q) for table in tables)
        return Jet(d[0], q[0], d[1], d[2], q[1], q[2], d[3], d[4], d[5], q[3], q[4], q[5])

    def linkages(i_d: Value, i_q: Value) -> Jet:
        x, y = i_d - at_d, i_q - at_q
        psi_d, psi_q = (
            _cubic([_cubic(row, x, 0)[0] for row in table], y, 0)[0] for table in tables
        )
        return Jet(psi_d, psi_q, *[0] * 10)

    return jet if slopes else linkages


def jets(machine: Machine, i_d: arb, i_q: arb, *, slopes: bool = True) -> list[JetFunction]:
    """Formulas of which one holds at every point of a box of currents in A.

    Without ``slopes`` they may leave the derivatives of a flux map at zero.

    Raises:
        TypeError: The machine is neither linear nor a flux map.
        ZeroDivisionError: The box touches so many cells that nothing sharp can come of it.
    """
    if isinstance(machine, LinearMachine):
        return [_linear(machine)]
    if not isinstance(machine, SaturatedMachine):
        raise TypeError(type(machine).__name__)
    found = machine.flux_map
    spans = []
    for ball, cells in ((i_d, found.rows), (i_q, found.columns)):
        ends = np.array([float(ball.lower()), float(ball.upper())])
        first, last = cells(np.nextafter(ends, [-np.inf, np.inf]))
        spans.append(range(int(first), int(last) + 1))
    if len(spans[0]) * len(spans[1]) > _MOST_CELLS:
        raise ZeroDivisionError
    return [_cell(found, row, column, slopes=slopes) for row in spans[0] for column in spans[1]]
