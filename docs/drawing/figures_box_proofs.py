"""Figure of the page on proofs over a box: the cells of one, and both sensitivities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.optimizer.certificates.both_axes_sensitivity import sensitivities
from dqforge.optimizer.certificates.cell_queue import (
    Cell,
    CurrentLoopBox,
    Cut,
    Proven,
    find_certificate,
    largest_moduli,
    loop_matrices,
    root_cell,
    shrunk,
)
from dqforge.optimizer.loops.pi_methods import current_pi
from dqforge.reports.pages.figures_style import BLUE, ORANGE, new_figure, save, style

_R, _L_D, _L_Q, _T_S = 0.05, 0.4e-3, 0.9e-3, 1e-4


def _box(turn: float = 0.34, bandwidth: float = 2000.0) -> CurrentLoopBox:
    """A salient machine that turns by up to ``turn`` rad per sample."""
    settings = CurrentLoopSettings("bandwidth", bandwidth=bandwidth)
    (kp_d, ki_d), (kp_q, ki_q) = (current_pi(_R, x, _T_S, settings) for x in (_L_D, _L_Q))
    return CurrentLoopBox(
        t_s=_T_S,
        kp=(kp_d, kp_q),
        ki_ts=(ki_d * _T_S, ki_q * _T_S),
        decoupling=(_L_D, _L_Q),
        r_s=(0.7 * _R, 1.6 * _R),
        dead_time=(0.0, 0.0),
        l_d=(0.7 * _L_D, 1.3 * _L_D),
        l_q=(0.7 * _L_Q, 1.3 * _L_Q),
        gain=(0.8, 1.2),
        omega_e=turn / _T_S,
    )


def box_proof(path: Path) -> None:
    """Cells of a proof over b_d and turn, and sensitivity over the turn."""
    with style():
        figure = _drawn(_box())
    save(figure, path)


def _drawn(box: CurrentLoopBox) -> Figure:
    figure = new_figure("box-proof", 3.4, "Cells of a proof, and sensitivity of both axes")
    left, right = (figure.add_axes((x, 0.14, 0.41, 0.8)) for x in (0.08, 0.57))
    for cell in _cells(box):
        place, size = (cell.low[0], cell.low[3]), (cell.width[0], cell.width[3])
        left.add_patch(Rectangle(place, *size, facecolor="none", edgecolor=BLUE, linewidth=0.8))
    root = root_cell(box)
    left.set(
        xlim=(0.95 * root.low[0], 1.03 * root.high[0]),
        ylim=(-0.01, 1.05 * root.high[3]),
        xlabel="$b_d$ = $g L_d\u2032$ / $L_d$",
        ylabel="Turn per sample in rad",
    )
    turns = np.linspace(0.0, 0.3, 31)
    both, alone = _sensitivities(box, turns)
    right.plot(turns, both, color=BLUE, label="both axes together")
    right.axhline(alone, color=ORANGE, label="axis by axis")
    right.set(xlabel="Turn per sample in rad", ylabel="Largest sensitivity of the corners")
    right.set_ylim(bottom=1.0)
    right.legend(loc="upper left")
    return figure


def _cells(box: CurrentLoopBox) -> list[Cell]:
    """Cells that a matrix proves."""
    found = find_certificate(box)
    assert found.complete
    cells, waiting = [], [found.root]
    for verdict in found.tree.preorder():
        cell = waiting.pop()
        if isinstance(verdict, Cut):
            waiting += reversed(verdict.cell.halves(verdict.axis, verdict.value))
        elif isinstance(verdict, Proven):
            inside = shrunk(box, cell)
            assert inside is not None
            cells.append(inside)
    return cells


def _sensitivities(box: CurrentLoopBox, turns: FloatArray) -> tuple[list[float], float]:
    """Largest sensitivity of the corners of the drives at each turn, and that at rest."""
    found = []
    for turn in turns:
        corners = [
            [g * d / l_d, g * q / l_q, r / g, turn]
            for d, q in (box.decoupling,)
            for l_d in box.l_d
            for l_q in box.l_q
            for g in box.gain
            for r in box.r_s
        ]
        still = replace(box, omega_e=turn / box.t_s)
        assert largest_moduli(loop_matrices(still, np.array(corners))).max() < 1.0
        found.append(float(sensitivities(still, np.array(corners)).max()))
    return found, found[0]
