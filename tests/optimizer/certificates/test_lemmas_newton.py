"""Lemmas of the interval Newton method and of what the certificate makes of it,
each for itself in plain numbers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from drives import RELUCTANCE
from flint import arb, ctx
from lemma_cases import LINE, MACHINE, close, interval, local, plain, task_of

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates import current_reference as certificate
from dqforge.optimizer.certificates import current_reference as interval_newton
from dqforge.optimizer.certificates import current_reference as near_rest
from dqforge.optimizer.certificates.ball import ORDER, Condition, Task, pieces
from dqforge.optimizer.certificates.current_reference import UNKNOWN, Bounds, Interval, newton
from dqforge.optimizer.current_reference.forms import (
    CurrentReference,
    Polynomials,
    ReferenceErrors,
    ReluctanceClosedForm,
)
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


def near_exact(scale: float) -> tuple[Task, float]:
    """A task whose currents at 4 N m are off by a small multiple of (0.6,
    -0.8) A from the exact ones.
    """
    choice = CurrentChoice(MACHINE, "mtpa", MACHINE.i_max)
    torque = 4.0
    i_d, i_q = (float(part[0]) for part in choice.currents(np.array([torque])))
    rows = [(i_d + 0.6 * scale) / torque, (i_q - 0.8 * scale) / torque]
    polynomials = [
        SinglePolynomial(np.array([0.0], np.float32), np.array([[0.0, row]], np.float32))
        for row in rows
    ]
    return task_of(form=Polynomials(*polynomials)), torque


@pytest.mark.parametrize("scale", [1e-2, 1e-3])
def test_newton_is_sharp_beside_the_exact_currents(scale: float) -> None:
    """|s| + |J^-1| 2 rad J |s| with J over the box that was taken: of second order,
    recomputed from the derivatives.
    """
    task, torque = near_exact(scale)
    here = interval(task, torque, torque)
    i_d, i_q = (float(part) for part in here.piece.currents(arb(torque)))
    exact_d, exact_q = task.exact(torque)
    off = np.abs([i_d - exact_d, i_q - exact_q])
    found = newton(task, here, "loss")
    assert off[0] <= found.i_d
    assert off[1] <= found.i_q
    at = plain(MACHINE, i_d, i_q)
    jacobian = np.array([[at["t_d"], at["t_q"]], [at["c_d"], at["c_q"]]])
    step = np.abs(np.linalg.solve(jacobian, [at["torque"] - torque, at["c"]]))
    rounding = np.array([float(part.abs_upper()) for part in here.piece.rounding(arb(torque))])
    ks = 1.5 * MACHINE.pole_pairs * abs(MACHINE.l_d - MACHINE.l_q)
    # At most one growth by what is needed: the box has 1.3 steps,
    # and what lies along the torque beside them.
    reach = np.array([1.0, 1.0]) * 1.3**2 * (np.sum(step) * 4.0) + 3 * rounding
    radius = 2.0 * ks * np.array([[reach[1], reach[0]], [2.0 * reach[0], 2.0 * reach[1]]])
    more = np.abs(np.linalg.inv(jacobian)) @ (radius @ step)
    assert np.all(np.array([found.i_d, found.i_q]) <= 1.05 * (step + more) + rounding + 1e-12)
    loss = 1.5 * MACHINE.r_s * (i_d**2 + i_q**2)
    made = np.array([at["torque"]])
    best = [float(part[0]) for part in task.choice.currents(made)]
    error = abs(at["torque"] - torque)
    close(found.torque, error + float(np.abs([at["t_d"], at["t_q"]]) @ rounding), 1e-3)
    assert found.voltage_excess == 0.0
    penalty = loss - 1.5 * MACHINE.r_s * (best[0] ** 2 + best[1] ** 2)
    assert penalty <= found.loss <= 1.3 * penalty + 1e-9
    assert (
        penalty / (loss - penalty) <= found.loss_relative <= 1.3 * penalty / (loss - penalty) + 1e-9
    )


def test_penalty_at_a_free_optimum_is_the_hessian_of_the_lagrangian() -> None:
    """d^T (I - lambda/2 tau'') d with d = missed/det (-t_q, t_d) and lambda/2 = (i .
    grad)/|grad|^2.
    """
    task = task_of()
    t_d, t_q, t_dd, t_dq, t_qq, missed, inverse = -0.5, 1.5, 0.25, -0.375, 0.125, 0.75, 0.5
    i_d, i_q = -2.0, 3.0
    half = (i_d * t_d + i_q * t_q) / (t_d**2 + t_q**2)
    shift = missed * inverse * np.array([-t_q, t_d])
    matrix = np.eye(2) - half * np.array([[t_dd, t_dq], [t_dq, t_qq]])
    more = abs(float(shift @ matrix @ shift))
    at = local(t_d=t_d, t_q=t_q, t_dd=t_dd, t_dq=t_dq, t_qq=t_qq)
    loss, relative = interval_newton._penalty(
        task, at, (arb(i_d), arb(i_q)), arb(missed), arb(inverse), "loss"
    )
    close(loss, 1.5 * MACHINE.r_s * more)
    close(relative, more / (i_d**2 + i_q**2 - more))
    # Where the loss may be all of it, there is no share.
    _, share = interval_newton._penalty(
        task, at, (arb(0.01), arb(0.01)), arb(9.0), arb(1.0), "loss"
    )
    assert share == math.inf


@pytest.mark.parametrize("condition", ["voltage", "no i_d"])
def test_penalty_elsewhere_is_the_gradient(condition: Condition) -> None:
    task = task_of()
    t_d, t_q, missed, inverse, i_d, i_q = -0.5, 1.5, 0.125, 0.5, -2.0, 3.0
    shift = missed * inverse * np.array([-t_q, t_d])
    more = abs(2.0 * float(shift @ np.array([i_d, i_q])))
    at = local(t_d=t_d, t_q=t_q, t_dd=7.0)
    loss, relative = interval_newton._penalty(
        task, at, (arb(i_d), arb(i_q)), arb(missed), arb(inverse), condition
    )
    close(loss, 1.5 * MACHINE.r_s * more)
    close(relative, more / (i_d**2 + i_q**2 - more))


def test_excess_of_the_voltage() -> None:
    """sqrt(1 + upper end + |e_d| r_d + |e_q| r_q) - 1, and nothing below the limit."""
    limited, at = task_of(SpeedPoint(30.0, 12.0)), local(e_d=-0.5, e_q=0.25)
    found = interval_newton._voltage_excess(limited, arb(0.25, 0.125), at, arb(0.5), arb(0.25))
    close(found, math.sqrt(1.0 + 0.375 + 0.25 + 0.0625) - 1.0, 1e-6)
    assert interval_newton._voltage_excess(limited, arb(-0.5), at, arb(0.0), arb(0.0)) == 0.0
    assert interval_newton._voltage_excess(limited, arb(-0.25), at, arb(0.25), arb(0.25)) == 0.0
    assert interval_newton._voltage_excess(task_of(), arb(0.5), at, arb(0.0), arb(0.0)) == 0.0


def test_torque_and_voltage_at_a_point() -> None:
    speed = SpeedPoint(20.0, 8.0)
    task, torque = task_of(speed), 4.0
    here = interval(task, torque, torque)
    i_d, i_q = -1.0, 5.0
    at = plain(MACHINE, i_d, i_q)
    error, excess = interval_newton.torque_and_voltage(task, here)
    rounding_d, rounding_q = (float(part.abs_upper()) for part in here.piece.rounding(arb(torque)))
    room = abs(at["t_d"]) * rounding_d + abs(at["t_q"]) * rounding_q
    assert float(error.lower()) == pytest.approx(at["torque"] - torque - room, rel=1e-9)
    assert float(error.upper()) == pytest.approx(at["torque"] - torque + room, rel=1e-9)
    assert float(error.rad()) == pytest.approx(room, rel=1e-4)
    volts = np.hypot(
        *MACHINE.voltage(np.array([i_d]), np.array([i_q]), np.array([MACHINE.pole_pairs * 20.0]))
    )
    assert excess == pytest.approx(float(volts[0]) / 8.0 - 1.0, rel=1e-5)
    values = interval_newton.errors_without_currents(task, here)
    close(values[2], abs(at["torque"] - torque) + room, 1e-6)
    assert values[5] == excess
    assert np.all(np.isinf(values[[0, 1, 3, 4]]))


def test_intervals_are_halved_in_the_middle() -> None:
    whole = interval(task_of(), 1.0, 4.0)
    assert whole.middle == 2.5
    bounds = np.arange(6.0)
    left, right = whole.halves(bounds)
    assert (left.low, left.high, right.low, right.high) == (1.0, 2.5, 2.5, 4.0)
    assert left.depth == right.depth == 1
    assert left.before is bounds
    np.testing.assert_array_equal(Bounds(1, 2, 3, 4, 5, 6).values(), [1, 2, 3, 4, 5, 6])
    assert np.all(np.isinf(UNKNOWN.values()))


def test_low_load_has_no_share() -> None:
    """The loss share counts from 5 % of the largest torque, 0.3 N m, upwards."""
    task = task_of()
    assert newton(task, interval(task, 0.29, 0.2999), "loss").loss_relative == 0.0
    assert newton(task, interval(task, 0.29, 0.3001), "loss").loss_relative > 0.0


def test_chord_joins_the_exact_currents() -> None:
    chord = near_rest._Chord(2.0, (-1.0, 3.0), (0.5, -0.25))
    assert tuple(map(float, chord.currents(arb(4)))) == (0.0, 2.5)
    assert chord.rounding(arb(3)) == (0, 0)
    task = task_of()
    made = near_rest._Chord.of(task, 1.0, 3.0)
    for torque in (1.0, 3.0):
        found = tuple(map(float, made.currents(arb(torque))))
        assert found == pytest.approx(task.exact(torque), rel=1e-12)


def reluctance_task(machine: LinearMachine) -> Task:
    return task_of(machine=machine)


@pytest.mark.parametrize(("l_d", "l_q"), [(0.25, 0.05), (0.05, 0.25)])
def test_exact_currents_without_a_magnet_are_roots(l_d: float, l_q: float) -> None:
    """|i_d| = |i_q| = sqrt(T/(3/2 p |L_q - L_d|)): T = 2.4 N m with 0.6 gives 2 A, 5.4 N m 3 A."""
    machine = LinearMachine(2, 0.5, l_d, l_q, 0.0, 20.0)
    i_d, i_q = near_rest._exact_near_rest(reluctance_task(machine), 2.4, 5.4)
    sign = -1.0 if l_q > l_d else 1.0
    ends = sorted((sign * 2.0, sign * 3.0))
    assert (float(i_d.lower()), float(i_d.upper())) == pytest.approx(ends, rel=1e-7)
    assert (float(i_q.lower()), float(i_q.upper())) == pytest.approx((2.0, 3.0), rel=1e-7)


def test_currents_from_rest_are_not_longer_than_those_of_more_torque() -> None:
    task = task_of()
    i_d, i_q = near_rest._exact_near_rest(task, 0.0, 2.0)
    longest = 1.01 * math.hypot(*task.exact(2.0))
    assert float(i_d.lower()) == pytest.approx(-longest, rel=1e-7)
    assert float(i_d.upper()) == pytest.approx(longest, rel=1e-7)
    assert float(i_q.upper()) == pytest.approx(longest, rel=1e-7)
    assert -1e-7 < float(i_q.lower()) <= 0.0


def test_currents_beside_a_chord_hold_the_exact_ones() -> None:
    task = task_of()
    i_d, i_q = near_rest._exact_near_rest(task, 2.0, 2.02)
    for torque in np.linspace(2.0, 2.02, 7).tolist():
        exact_d, exact_q = task.exact(torque)
        assert i_d.contains(arb(exact_d))
        assert i_q.contains(arb(exact_q))
    assert float(i_d.rad()) < 0.02
    assert float(i_q.rad()) < 0.02


@pytest.mark.parametrize(("saliency", "apart"), [(1.0, 4.0), (-1.0, 6.0)])
def test_magnitudes_apart(saliency: float, apart: float) -> None:
    """i_d = -T/4 and i_q = 5 T/4 at 4 N m: |i_q| - |i_d| is 4 where i_d must be negative,
    i_q - i_d = 6 else.
    """
    here = interval(task_of(), 4.0, 4.0)
    rounding = sum(float(part.abs_upper()) for part in here.piece.rounding(arb(4.0)))
    found = near_rest._apart(here, saliency)
    assert float(found.mid()) == pytest.approx(apart, rel=1e-9)
    assert float(found.rad()) == pytest.approx(rounding, rel=1e-4)


def test_square_root_in_rational_arithmetic() -> None:
    """Gain off by a share g: sqrt(1 + g) (1 + u)^2 - 1 of the current, (share)(2 + share) of the
    torque.
    """
    exact_gain = 1.0 / (1.5 * RELUCTANCE.pole_pairs * abs(RELUCTANCE.saliency))
    for factor in (1.001, 0.999):
        gain = np.float32(exact_gain * factor)
        found = certificate._square_root(RELUCTANCE, ReluctanceClosedForm(gain, -1), 10.0)
        off = abs(math.sqrt(float(gain) / exact_gain) - 1.0)
        share = (1.0 + off) * (1.0 + 2.0**-24) ** 2 - 1.0
        tiny = 2.0**-74.5
        close(found.i_d or 0.0, math.sqrt(exact_gain * 10.0) * share + tiny, 1e-7)
        assert found.i_q == found.i_d
        close(found.torque, 10.0 * share * (2.0 + share) + tiny, 1e-7)
        close(found.torque_relative, share * (2.0 + share), 1e-7)
        assert (found.loss, found.loss_relative, found.voltage_excess) == (0.0, 0.0, None)
    small = certificate._square_root(
        RELUCTANCE, ReluctanceClosedForm(np.float32(exact_gain), -1), 1e-60
    )
    assert (small.i_d or 0.0) >= 2.0**-74.5
    assert small.torque >= 2.0**-74.5


def errors(**values: float) -> ReferenceErrors:
    found: dict[str, Any] = dict.fromkeys(ReferenceErrors.__dataclass_fields__)
    found |= {
        "i_d": 0.1,
        "i_q": 0.2,
        "torque": 0.3,
        "loss": 0.4,
        "loss_relative": 0.5,
        "voltage_excess": None,
    }
    return ReferenceErrors(**(found | values))


def test_levels_are_what_was_sampled_or_the_resolution() -> None:
    task = task_of()
    sampled = certificate._sampled(errors())
    np.testing.assert_array_equal(sampled, [0.1, 0.2, 0.3, 0.4, 0.5, 0.0])
    assert certificate._sampled(errors(voltage_excess=0.6))[5] == 0.6
    floor = certificate._level(task, np.zeros(6))
    full = 1.5 * MACHINE.r_s * MACHINE.i_max**2
    np.testing.assert_allclose(floor, [20e-9, 20e-9, 6e-9, full * 1e-5, 1e-9, 1e-9], rtol=1e-12)
    np.testing.assert_allclose(certificate._level(task, sampled)[:5], sampled[:5])


def fake_newton(monkeypatch: pytest.MonkeyPatch, table: dict[str, Any]) -> None:
    def found(_task: Task, _interval: Interval, condition: str) -> Bounds:
        if table[condition] is None:
            raise ZeroDivisionError
        return Bounds(*table[condition])

    monkeypatch.setattr(certificate, "newton", found)


def test_worst_of_all_conditions_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    reference = CurrentReference(LINE, np.float32(6.0))
    task = Task(
        CurrentChoice(MACHINE, "mtpa", 20.0, SpeedPoint(1.0, 1.0)), reference, (3.0,), False, {}
    )
    fake_newton(monkeypatch, {"loss": (1, 20, 0.3, 40, 5, 60), "voltage": (10, 2, 0.2, 4, 50, 6)})
    best, may_fall = certificate._bounds(task, interval(task, 2.9, 3.1), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [10, 20, 0.3, 40, 50, 60])
    assert may_fall
    best, may_fall = certificate._bounds(task, interval(task, 4.0, 5.0), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [10, 2, 0.2, 4, 50, 6])
    assert not may_fall
    # Torque that is made beyond the kink, 0.3 above 2.8: its losses are
    # asked for by both conditions.
    best, may_fall = certificate._bounds(task, interval(task, 2.0, 2.8), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [1, 20, 0.3, 40, 50, 60])
    assert may_fall
    best, may_fall = certificate._bounds(task, interval(task, 2.0, 2.6), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [1, 20, 0.3, 40, 5, 60])
    assert not may_fall
    # Or below it: 0.3 below 3.2, beyond the kink; the losses of less torque count.
    best, may_fall = certificate._bounds(task, interval(task, 3.25, 3.5), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [10, 2, 0.2, 4, 50, 6])
    assert not may_fall
    best, may_fall = certificate._bounds(task, interval(task, 3.15, 3.5), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [10, 2, 0.2, 40, 50, 6])
    assert may_fall
    fake_newton(monkeypatch, {"loss": (1, 20, 0.3, 40, 5, 60), "voltage": None})
    best, _ = certificate._bounds(task, interval(task, 2.0, 2.8), np.full(6, math.inf))
    np.testing.assert_array_equal(best, [1, 20, 0.3, math.inf, math.inf, 60])


def test_second_way_can_only_lower(monkeypatch: pytest.MonkeyPatch) -> None:
    task = task_of()
    fake_newton(monkeypatch, {"loss": (1, 20, 0.3, 40, 5, 60)})
    monkeypatch.setattr(
        certificate, "bounds_near_zero_torque", lambda *_: Bounds(10, 2, 3, 4, 50, 6)
    )
    best, may_fall = certificate._bounds(task, interval(task, 2.0, 2.1), np.full(6, 1e-3))
    np.testing.assert_array_equal(best, [1, 2, 0.3, 4, 5, 6])
    assert may_fall  # 0.1 is more than 2 % of 2.1
    assert not certificate._bounds(task, interval(task, 2.0, 2.03), np.full(6, 1e-3))[1]
    best, _ = certificate._bounds(
        task, interval(task, 2.0, 2.1), np.array([1.0, 20.0, 0.3, 40.0, 5.0, 60.0])
    )
    np.testing.assert_array_equal(best, [1, 20, 0.3, 40, 5, 60])


def opened(
    bounds: list[float], before: list[float], depth: int = 0, *, may_fall: bool = False
) -> Any:
    place = Interval(pieces(task_of().reference)[0], 0.0, 1.0, depth, np.array(before))
    return certificate._Open(0.0, 0, place, np.array(bounds), may_fall)


def test_interval_is_settled_when_low_or_when_halving_does_not_help() -> None:
    level, before = np.ones(2), [1e9, 1e9]
    assert opened([1.0, 1.01], before).is_settled(level)
    assert not opened([1.0, 1.02], before).is_settled(level)
    assert opened([1.0, 1.02], before, 20).is_settled(level)
    assert not opened([1.0, 1.02], before, 19).is_settled(level)
    assert opened([1.0, 5.0], [9.0, 5.05]).is_settled(level)  # what is too high did not fall by 2 %
    assert not opened([1.0, 5.0], [9.0, 5.2]).is_settled(level)
    assert not opened([1.0, 5.0], [9.0, 5.05], may_fall=True).is_settled(level)
    assert not opened([1.0, math.inf], [9.0, math.inf]).is_settled(level)


def test_refinement_covers_the_domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds that fall with the width: every interval comes below the level, and all meet."""

    def width(_task: Task, here: Interval, _level: Any) -> tuple[Any, bool]:
        return np.full(6, here.high - here.low), True

    monkeypatch.setattr(certificate, "_bounds", width)
    parts = sorted(
        certificate._refine(task_of(), np.full(6, 0.1)), key=lambda part: part.interval.low
    )
    assert parts[0].interval.low == 0.0
    assert parts[-1].interval.high == 6.0
    assert all(a.interval.high == b.interval.low for a, b in itertools.pairwise(parts))
    assert max(part.interval.high - part.interval.low for part in parts) <= 0.101


def test_certificate_states_the_worst_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest of each bound over all intervals, none below what was found.

    Shares rounded upwards.
    """
    task = task_of()
    bounds = [
        np.array([1.0, 5.0, 0.7, 4.0, 0.3, 0.0]),
        np.array([2.0, 3.0, 0.4, math.inf, 0.6, 0.0]),
    ]
    place = Interval(pieces(task.reference)[0], 0.0, 1.0, 0, UNKNOWN.values())
    parts = [
        certificate._Open(0.0, number, place, bound, False) for number, bound in enumerate(bounds)
    ]
    monkeypatch.setattr(certificate, "_refine", lambda *_: parts)
    found = certificate._certify(task, errors(i_d=9.0, i_q=0.2))
    assert found is not None
    assert (found.i_d, found.i_q, found.torque, found.loss, found.loss_relative) == (
        9.0,
        5.0,
        0.7,
        None,
        0.6,
    )
    assert found.torque_relative > 0.7 / 6.0
    close(found.torque_relative, 0.7 / 6.0, 1e-12)
    assert (found.model, found.voltage_excess, found.intervals) == ("equations", None, 2)
    bounds[0][2] = math.inf
    assert certificate._certify(task, errors()) is None


def test_series_are_long_enough_for_the_remainder_and_settings_come_back() -> None:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 53, 3
    with certificate._ball_arithmetic():
        assert (ctx.prec, ctx.cap) == (80, ORDER + 1)
    assert (ctx.prec, ctx.cap) == (53, 3)
    ctx.prec, ctx.cap = before
