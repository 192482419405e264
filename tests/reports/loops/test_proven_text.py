"""Words on what is proven of single loops, and on what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.optimizer.axis_margins import ProvenMargins
from dqforge.optimizer.certificates.cell_queue import Cell, Node, Open, Proven, Tree
from dqforge.optimizer.changing_loops import ChangingAxis, Growth
from dqforge.optimizer.speed_box import Chain, SpeedBox, SpeedProof
from dqforge.reports.loops.proven_text import (
    changing_text,
    margin_text,
    speed_text,
    velocity_text,
)

ONE = (1.0, 1.0)
BOX = SpeedBox(ONE, ONE, ONE, (0.0, 0.0), ONE, ONE, (0.0, 0.0))
HELD: Tree[Chain] = Tree([Node(Proven((np.eye(5),)))], examined=1)
LEFT: Tree[Chain] = Tree([Node(Open(Cell(np.zeros(4), np.ones(4))))])
SCHEDULED = ChangingAxis(
    "i_q", (3e-3, 12e-3), True, False, None, 1, (Growth(1.234, 1, (0, 4)), (0.5, 12.0))
)


def test_bounds_are_rounded_to_the_safe_side() -> None:
    text = margin_text("i_d", ProvenMargins(True, 1.645, 0.7209, 114))
    assert "M_s 1.645 or less and phase margin 41.30 deg or more (114 cells" in text
    assert "proven stable for every drive in the box" in text
    assert "phase margin" not in margin_text("i_d", ProvenMargins(True, 1.645, None, 1))
    assert "nothing is proven" in margin_text("i_d", ProvenMargins(False, None, None, 4500))


def test_the_speed_loop_says_what_is_proven_and_what_is_not() -> None:
    whole = SpeedProof(1.0, 1, 1, 10, BOX, None, HELD)
    assert "proven stable for every drive in the box" in speed_text(whole)
    assert "(one cell, a cycle of 10 matrices each)" in speed_text(whole)
    part = replace(whole, share=0.97561, cells=3, leaves=2, tree=LEFT)
    assert "97.5 % of the drives in the box (2 cells" in speed_text(part)
    assert "thorough: true" in speed_text(part)
    assert "not tried to prove" in speed_text(replace(part, cells=0))


def test_changing_inductances() -> None:
    text = changing_text(SCHEDULED)
    assert "parallel form at the measured current" in text
    assert "l_q between 3 and 12 mH" in text
    assert "not with the gains of another current" in text
    assert "also with the gains" in changing_text(replace(SCHEDULED, any_current=True))
    assert "not proven" in changing_text(replace(SCHEDULED, proven=False))
    constant = replace(SCHEDULED, any_current=None, velocity=None)
    assert "however fast saturation changes" in changing_text(constant)
    slow = replace(constant, proven=False, rate=1.4842)
    assert "by a factor of 1.48 per sample at most" in changing_text(slow)
    assert "not proven for any change" in changing_text(replace(slow, rate=None))


def test_the_velocity_form_is_refused_with_its_growth() -> None:
    text = velocity_text(SCHEDULED)
    assert "not in velocity form with kp (e[k] - e[k-1])" in text
    assert "between 0.5 and 12 A every sample it grows by 1.23 per sample" in text
    assert "kp[k] e[k] - kp[k-1] e[k-1] is the parallel form" in text
    assert velocity_text(replace(SCHEDULED, velocity=None)) == ""
