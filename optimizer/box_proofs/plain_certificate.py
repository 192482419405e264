"""What is stored of a proof: the inputs, the cuts, and a matrix for every cell."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.box_proofs.cell_queue import Cut, Open, Proven, Tree, Verdict
from dqforge.optimizer.box_proofs.current_loop_model import CurrentLoopBox

PlainCertificate = dict[str, Any]


def plain_inputs(box: CurrentLoopBox) -> dict[str, Any]:
    """The inputs of a proof as JSON has them."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(box).items()
    }


def plain_certificate(box: CurrentLoopBox, tree: Tree[FloatArray]) -> PlainCertificate:
    """A tree as JSON has it: a cut is its parameter (b_d, b_q, s, x by number) and value,
    followed by all below and all above; a proven cell the upper triangle of its matrix.

    Args:
        box: Control and drives.
        tree: Its cells, none of them refuted.
    """
    return {"inputs": plain_inputs(box), "tree": [_plain(verdict) for verdict in tree.preorder()]}


def _plain(verdict: Verdict[FloatArray]) -> Any:
    if isinstance(verdict, Cut):
        return [verdict.axis, verdict.value]
    if isinstance(verdict, Proven):
        return [float(entry) for entry in verdict.payload[np.triu_indices(6)]]
    return "open" if isinstance(verdict, Open) else "empty"
