"""Lemmas where a reference errs by a good part of the currents: losses without isolation,
with numbers given.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx
from lemma_cases import MACHINE, close, interval, local, task_of

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates import current_reference as near_rest
from dqforge.optimizer.certificates.ball import ORDER, Task

SCALE = 1.5 * MACHINE.r_s


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


@pytest.mark.parametrize(("l_d", "l_q", "factor"), [(0.05, 0.25, 1.0), (0.25, 0.05, 1.5)])
def test_loss_without_a_magnet(l_d: float, l_q: float, factor: float) -> None:
    """3/2 R times the square of what the magnitudes differ by; i_d = -T/4 and
    i_q = 5 T/4 from 3 to 5 N m.
    """
    machine = LinearMachine(2, 0.5, l_d, l_q, 0.0, 20.0)
    task = task_of(machine=machine)
    here = interval(task, 3.0, 5.0)
    rounding = sum(float(part.abs_upper()) for part in here.piece.rounding(arb(5.0)))
    apart = factor * 5.0 + rounding
    loss, relative = near_rest._loss_beside(
        task, here, (arb(-1.0, 0.25), arb(5.0, 0.5)), arb(0.0, 9.0)
    )
    close(loss, SCALE * (factor * 5.0) ** 2, 1e-5)
    assert loss <= SCALE * apart**2 * (1.0 + 1e-7)
    product = 5.0 - (
        1.0 * 0.5 + 5.0 * 0.25 + 0.25 * 0.5
    )  # of two balls about the product of their middles
    close(relative, apart**2 / (2.0 * product), 1e-5)
    assert near_rest._loss_beside(task, here, (arb(0.0, 1.0), arb(5.0)), arb(0.0))[1] == math.inf


Chords = list[tuple[float, float]]


def fixed(
    patch: pytest.MonkeyPatch, exact: list[tuple[arb, arb]], **derivatives: float
) -> tuple[Chords, list[tuple[arb, arb]]]:
    """Exact currents in turn and derivatives as given, in place of a machine's.

    What was asked is recorded.
    """
    asked: Chords = []
    boxes: list[tuple[arb, arb]] = []

    def exact_between(_task: Task, low: float, high: float) -> tuple[arb, arb]:
        asked.append((low, high))
        return exact[(len(asked) - 1) % len(exact)]

    def over_box(_task: Task, box: tuple[arb, arb], condition: str) -> Any:
        assert condition == "loss"
        boxes.append(box)
        return local(**derivatives)

    patch.setattr(near_rest, "_exact_near_rest", exact_between)
    patch.setattr(near_rest, "conditions_over_box", over_box)
    return asked, boxes


DERIVATIVES = {"t_d": -0.5, "t_q": 1.5, "t_dd": 0.25, "t_dq": -0.375, "t_qq": 0.125}


@pytest.mark.parametrize(
    "derivatives", [DERIVATIVES, DERIVATIVES | {"t_dq": 0.75, "t_qq": -0.5, "t_d": 0.25}]
)
def test_loss_is_the_lagrangian_at_the_distance(
    monkeypatch: pytest.MonkeyPatch, derivatives: dict[str, float]
) -> None:
    """d^T (I - lambda/2 tau'') d with d = i - i* and lambda/2 = (i* . grad)/|grad|^2,
    over |i*|^2 as a share.
    """
    i, exact = np.array([-2.0, 3.0]), np.array([-1.75, 2.25])
    _, boxes = fixed(monkeypatch, [(arb(exact[0]), arb(exact[1]))], **derivatives)
    gradient = np.array([derivatives["t_d"], derivatives["t_q"]])
    hessian = np.array(
        [[derivatives["t_dd"], derivatives["t_dq"]], [derivatives["t_dq"], derivatives["t_qq"]]]
    )
    half = float(exact @ gradient) / float(gradient @ gradient)
    off = i - exact
    more = abs(float(off @ (np.eye(2) - half * hessian) @ off))
    task = task_of()
    loss, relative = near_rest._loss_beside(
        task, interval(task, 4.0, 4.5), (arb(i[0]), arb(i[1])), arb(0.0)
    )
    close(loss, SCALE * more, 1e-6)
    close(relative, more / float(exact @ exact), 1e-6)
    ((box_d, box_q),) = boxes
    for box, ends in ((box_d, (-2.0, -1.75)), (box_q, (2.25, 3.0))):
        assert (float(box.lower()), float(box.upper())) == pytest.approx(ends, rel=1e-6)


def test_loss_of_balls_is_the_largest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without curvature |d|^2: radii of both currents and of the exact ones add,
    and shorten the least loss.
    """
    exact = (arb(-2.0, 0.125), arb(3.0, 0.25))
    fixed(monkeypatch, [exact], t_d=-0.5, t_q=1.5)
    task = task_of()
    loss, relative = near_rest._loss_beside(
        task, interval(task, 4.0, 4.5), (arb(-3.0, 0.25), arb(3.5, 0.125)), arb(0.0)
    )
    more = (1.0 + 0.375) ** 2 + (0.5 + 0.375) ** 2
    close(loss, SCALE * more, 1e-6)
    assert relative >= more / (1.875**2 + 2.75**2)
    # Squares of balls about the squares of their middles are as wide below as above.
    assert relative <= more / (13.0 - 4.0 * 0.125 - 0.125**2 - 6.0 * 0.25 - 0.25**2) * (1.0 + 1e-6)


def test_exact_currents_are_met_over_all_torques_that_are_made(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the low end less the error to the high end with it, in parts 2 % wide,
    of which all count.
    """
    parts = [(arb(-2.0), arb(3.0)), (arb(-2.5), arb(3.5))]
    asked, boxes = fixed(monkeypatch, parts, t_d=-0.5, t_q=1.5)
    task = task_of()
    here = interval(task, 4.0, 4.5)
    near_rest._loss_beside(task, here, (arb(-2.25), arb(3.25)), arb(0.125, 0.375))
    low, high = 3.75, 5.0
    assert asked[0][0] < low
    assert asked[0][0] == pytest.approx(low, rel=1e-8)
    assert asked[-1][1] > high
    assert asked[-1][1] == pytest.approx(high, rel=1e-8)
    # A share of 1e-9 beyond both ends, neither less nor more.
    assert low / asked[0][0] - 1.0 == pytest.approx(1e-9, rel=0.2)
    assert asked[-1][1] / high - 1.0 == pytest.approx(1e-9, rel=0.2)
    assert all(one[1] == two[0] for one, two in itertools.pairwise(asked))
    assert len(asked) == math.ceil((high / low - 1.0) / 0.02)
    ((box_d, box_q),) = boxes
    assert (float(box_d.lower()), float(box_d.upper())) == pytest.approx((-2.5, -2.0), rel=1e-6)
    assert (float(box_q.lower()), float(box_q.upper())) == pytest.approx((3.0, 3.5), rel=1e-6)


@pytest.mark.parametrize(
    ("high", "low_error", "high_error", "close_together"),
    [
        (5.9, 0.0, 0.0, True),
        (6.1, 0.0, 0.0, False),
        (5.5, -0.4, 0.0, False),
        (5.5, 0.0, 0.4, True),
        (5.5, 0.0, 0.6, False),
        (5.5, 0.1, 0.4, True),
        (4.1, -4.0, 0.0, False),
    ],
)
def test_far_torques_leave_all_of_the_loss(
    monkeypatch: pytest.MonkeyPatch,
    high: float,
    low_error: float,
    high_error: float,
    close_together: bool,
) -> None:
    """Beyond 1.5 times the lower torque that is made the least loss is not asked for:
    it is 3/2 R i^2 at most.
    """
    fixed(monkeypatch, [(arb(-2.0), arb(3.0))], t_d=-0.5, t_q=1.5)
    task = task_of()
    error = arb(0.5 * (low_error + high_error), 0.5 * (high_error - low_error))
    currents = arb(-2.0, 0.25), arb(3.5)
    loss, relative = near_rest._loss_beside(task, interval(task, 4.0, high), currents, error)
    assert math.isfinite(relative) == close_together
    if not close_together:
        close(loss, SCALE * (2.25**2 + 3.5**2), 1e-6)


def test_exact_currents_that_may_vanish_leave_all_of_the_loss(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fixed(monkeypatch, [(arb(0.0, 0.5), arb(0.0, 0.5))], t_d=-0.5, t_q=1.5)
    task = task_of()
    loss, relative = near_rest._loss_beside(
        task, interval(task, 4.0, 4.5), (arb(-2.0, 0.25), arb(3.5)), arb(0.0)
    )
    close(loss, SCALE * (2.25**2 + 3.5**2), 1e-6)
    assert relative == math.inf
    fixed(monkeypatch, [(arb(-2.0), arb(3.0))])  # no gradient, no multiplier
    loss, relative = near_rest._loss_beside(
        task, interval(task, 4.0, 4.5), (arb(-2.0, 0.25), arb(3.5)), arb(0.0)
    )
    close(loss, SCALE * (2.25**2 + 3.5**2), 1e-6)
    assert relative == math.inf


def test_distance_from_currents_enclosed_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    """|i - i*| with both as balls.

    Torque, loss and voltage from their own bounds, no share at low load.
    """
    task = task_of()
    exact = arb(-2.0, 0.125), arb(3.0, 0.25)
    passed: dict[str, Any] = {}

    def loss(
        _task: Task, _interval: object, currents: tuple[arb, arb], error: arb
    ) -> tuple[float, float]:
        passed.update(currents=currents, error=error)
        return 7.0, 0.5

    monkeypatch.setattr(near_rest, "_exact_near_rest", lambda *_: exact)
    monkeypatch.setattr(near_rest, "_loss_beside", loss)
    monkeypatch.setattr(near_rest, "torque_and_voltage", lambda *_: (arb(-0.25, 0.125), 0.0625))
    here = interval(task, 4.0, 4.5)
    rounding = [float(part.abs_upper()) for part in here.piece.rounding(arb(4.25, 0.25))]
    found = near_rest.bounds_near_zero_torque(task, here)
    close(found.i_d, abs(-1.0625 - 0.0625 + 2.0) + 0.0625 * 2 + 0.125, 1e-6)
    close(found.i_q, abs(5.3125 - 3.0) + 0.3125 + 0.25, 1e-6)
    close(found.torque, 0.375, 1e-6)
    assert (found.loss, found.loss_relative, found.voltage_excess) == (7.0, 0.5, 0.0625)
    for ball, middle, width, room in zip(
        passed["currents"], (-1.0625, 5.3125), (0.0625, 0.3125), rounding, strict=True
    ):
        assert float(ball.mid()) == pytest.approx(middle, rel=1e-9)
        assert float(ball.rad()) == pytest.approx(width + room, rel=1e-7)
        assert float(ball.rad()) > width + 0.5 * room
    assert (
        near_rest.bounds_near_zero_torque(task, interval(task, 0.29, 0.2999)).loss_relative == 0.0
    )
    assert (
        near_rest.bounds_near_zero_torque(task, interval(task, 0.29, 0.3001)).loss_relative == 0.5
    )


def test_currents_from_rest_must_make_the_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hundredth more than the exact currents makes more torque; where it would not,
    nothing is said.
    """
    task = task_of()
    monkeypatch.setattr(Task, "exact", lambda *_: (-0.5, 1.0))
    # 3 (0.25 + 0.1 0.505) 1.01 = 0.9105 N m
    i_d, _ = near_rest._exact_near_rest(task, 0.0, 0.91)
    assert float(i_d.upper()) == pytest.approx(1.01 * math.hypot(0.5, 1.0), rel=1e-7)
    with pytest.raises(ZeroDivisionError):
        near_rest._exact_near_rest(task, 0.0, 0.911)
