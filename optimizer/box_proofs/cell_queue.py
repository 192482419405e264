"""A box cut into cells until each is decided, the worst first.

What a cell is, and what proves it, the caller says; here stands the order, the tree of the cuts,
and when to stop.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import field
from typing import Generic, TypeVar

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

Payload = TypeVar("Payload")


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Least and largest value of every parameter, shape (D,)."""

    low: FloatArray
    high: FloatArray

    @property
    def middle(self) -> FloatArray:
        """The point between both."""
        return np.asarray(0.5 * (self.low + self.high), dtype=np.float64)

    @property
    def width(self) -> FloatArray:
        """How far the cell reaches in every parameter."""
        return np.asarray(self.high - self.low, dtype=np.float64)

    def halves(self, axis: int, value: float) -> tuple[Cell, Cell]:
        """The parts below and above a value of one parameter."""
        high, low = self.high.copy(), self.low.copy()
        high[axis] = low[axis] = value
        return Cell(self.low, high), Cell(low, self.high)


@dataclass(frozen=True, slots=True)
class Empty:
    """No drive of the box lies in the cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Proven(Generic[Payload]):
    """The cell is proven by ``payload``."""

    payload: Payload


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """The cell, shrunk to ``cell`` first, is cut at ``value`` of parameter ``axis``."""

    axis: int
    value: float
    cell: Cell


@dataclass(frozen=True, slots=True, eq=False)
class Refuted:
    """The drive ``point`` of the cell does what none should."""

    point: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Open:
    """Nothing is known of the cell: the search ended before."""

    cell: Cell


Verdict = Empty | Proven[Payload] | Cut | Refuted | Open


@dataclass(slots=True)
class Node(Generic[Payload]):
    """A node of the tree: its verdict and, behind a cut, the nodes below and above it."""

    verdict: Verdict[Payload]
    children: tuple[int, int] | None = None


@dataclass(slots=True)
class Tree(Generic[Payload]):
    """Nodes of a search, the root first, and how many cells were looked at."""

    nodes: list[Node[Payload]] = field(default_factory=list)
    examined: int = 0
    counterexample: FloatArray | None = None

    @property
    def open_cells(self) -> list[Cell]:
        """Cells that were not decided."""
        return [node.verdict.cell for node in self.nodes if isinstance(node.verdict, Open)]

    @property
    def complete(self) -> bool:
        """Whether every cell is decided and none refuted."""
        return self.counterexample is None and not self.open_cells

    def preorder(self) -> list[Verdict[Payload]]:
        """Verdicts in the order cut, all below, all above: the tree without its numbers."""
        found, waiting = [], [0]
        while waiting:
            node = self.nodes[waiting.pop()]
            found.append(node.verdict)
            if node.children is not None:
                waiting += reversed(node.children)
        return found


def search(
    root: Cell,
    examine: Callable[[Cell], Verdict[Payload]],
    urgency: Callable[[Cell], float],
    largest: int,
    more: Callable[[], bool] = lambda: True,
) -> Tree[Payload]:
    """Cut a box until all of it is decided, the most urgent cell first.

    Args:
        root: The box.
        examine: What a cell is: empty, proven, to be cut, refuted (which ends the search), or open.
        urgency: The larger, the sooner a cell is looked at.
        largest: How many cells are looked at; the others stay open.
        more: Whether there is work left for another cell.
    """
    tree: Tree[Payload] = Tree([Node(Open(root))])
    waiting = [(-urgency(root), 0)]
    while waiting and tree.examined < largest and more():
        _, index = heapq.heappop(waiting)
        node = tree.nodes[index]
        assert isinstance(node.verdict, Open)
        node.verdict = examine(node.verdict.cell)
        tree.examined += 1
        if isinstance(node.verdict, Refuted):
            tree.counterexample = node.verdict.point
            break
        if isinstance(node.verdict, Cut):
            halves = node.verdict.cell.halves(node.verdict.axis, node.verdict.value)
            node.children = (len(tree.nodes), len(tree.nodes) + 1)
            for place, half in zip(node.children, halves, strict=True):
                tree.nodes.append(Node(Open(half)))
                heapq.heappush(waiting, (-urgency(half), place))
    return tree
