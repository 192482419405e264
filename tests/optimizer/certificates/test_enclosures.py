"""Balls, Taylor polynomials and machines in ball arithmetic: everything sampled lies inside,
and little else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields
from itertools import pairwise
from typing import Any

import mpmath
import numpy as np
import pytest
from drives import IPM
from flint import arb, ctx
from saturated import ArctanMachine

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import FluxJet, LinearMachine
from dqforge.optimizer.certificates.ball import (
    ORDER,
    Condition,
    Expansion,
    Task,
    as_ball,
    conditions_over_box,
    hull,
    jets,
    upper,
)
from dqforge.optimizer.current_reference.forms import CurrentReference, Proportional
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint

NAMES = [field.name for field in fields(FluxJet)]


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


FUNCTIONS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "polynomial": (lambda t: t * t * t * t * t * t - t * 3 + 1, lambda t: t**6 - 3 * t + 1),
    "quotient": (lambda t: t / (t * t + 2), lambda t: t / (t**2 + 2)),
    "root": (lambda t: (t * t + 1).sqrt() - t, lambda t: mpmath.sqrt(t**2 + 1) - t),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_expansion_holds_all_that_a_function_takes(name: str) -> None:
    series, exact = FUNCTIONS[name]
    generator = np.random.default_rng(1)
    for _ in range(40):
        low = float(generator.uniform(-2.0, 2.0))
        high = low + float(10.0 ** generator.uniform(-6.0, 0.0))
        (ball,) = Expansion(low, high).enclose(lambda t: [series(t)])
        with mpmath.workdps(40):
            values = [exact(mpmath.mpf(t)) for t in np.linspace(low, high, 21).tolist()]
            assert mpmath.mpf(float(ball.lower())) - mpmath.mpf(1e-15) <= min(values)
            assert max(values) <= mpmath.mpf(float(ball.upper())) + mpmath.mpf(1e-15)
            for value in values:
                assert ball.overlaps(arb(mpmath.nstr(value, 40), 1e-30))


def test_remainder_falls_with_the_fifth_power() -> None:
    """1/(1 + t) less its Taylor polynomial of degree 4 is of fifth order: half the width,
    a 32nd of the bound.
    """

    def difference(t: Any) -> list[Any]:
        x = t - 1
        taylor = sum(((-1) ** k * x**k / arb(2) ** (k + 1) for k in range(1, 5)), 0 * t + arb(0.5))
        return [1 / (t + 1) - taylor]

    widths = [2.0**-k for k in range(2, 10)]
    bounds = [upper(Expansion(1.0 - w, 1.0 + w).enclose(difference)[0]) for w in widths]
    ratios = [wide / narrow for wide, narrow in pairwise(bounds)]
    assert ratios[-1] == pytest.approx(2.0**ORDER, rel=0.02)
    assert all(ratio > 30.0 for ratio in ratios)


def test_narrow_balls_hold_both_ends() -> None:
    """The middle of two neighbouring doubles is one of them.

    The ball must hold the other one as well.
    """
    generator = np.random.default_rng(2)
    for low in generator.uniform(1.0, 300.0, 200).tolist():
        for high in (np.nextafter(low, np.inf), low * (1.0 + 1e-15), low * (1.0 + 1e-9)):
            expansion = Expansion(low, float(high))
            assert expansion.ball.contains(arb(low))
            assert expansion.ball.contains(arb(float(high)))
            (ball,) = expansion.enclose(lambda t: [t * 1])
            assert ball.contains(arb(low))
            assert ball.contains(arb(float(high)))


def test_poles_and_negative_roots_are_refused() -> None:
    for function in (lambda t: [1 / t], lambda t: [(t - 5).sqrt()]):
        with pytest.raises(ZeroDivisionError):
            Expansion(-1.0, 1.0).enclose(function)


def test_bounds_are_rounded_upwards() -> None:
    assert upper(arb(0)) == 0.0
    assert arb(upper(arb(1) / 3)) > arb(1) / 3
    assert upper(arb(-2)) > 2.0
    assert upper(arb("1e-400")) > 0.0
    assert upper(arb("nan")) == np.inf
    assert hull([arb(1), arb(3)]).contains(arb(2))


def library(name: str) -> SaturatedMachine:
    machine = catalogue.load(name).machine
    assert isinstance(machine, SaturatedMachine)
    return machine


MACHINES = ["abb-syrm-6k7-saturated", "baldor-pmsyrm-5k6"]


@pytest.mark.parametrize("name", MACHINES)
def test_formula_of_a_cell_is_the_machine(name: str) -> None:
    """Values and derivatives against the splines' own, and against central
    differences of the flux linkages.
    """
    machine = library(name)
    generator = np.random.default_rng(3)
    i_d, i_q = generator.uniform(-machine.i_max, machine.i_max, (2, 40))
    expected = machine.jet(i_d, i_q)
    step = 1e-4 * machine.i_max
    by_d = [
        (a - b) / (2 * step)
        for a, b in zip(machine.flux(i_d + step, i_q), machine.flux(i_d - step, i_q), strict=True)
    ]
    by_q = [
        (a - b) / (2 * step)
        for a, b in zip(machine.flux(i_d, i_q + step), machine.flux(i_d, i_q - step), strict=True)
    ]
    for index in range(i_d.size):
        at_d, at_q = arb(float(i_d[index])), arb(float(i_q[index]))
        (formula,) = jets(machine, at_d, at_q)
        found = formula(at_d, at_q)
        for field in NAMES:
            wanted = getattr(expected, field)
            assert float(getattr(found, field)) == pytest.approx(
                wanted[index], abs=1e-11 * np.max(np.abs(wanted))
            )
        slopes = (found.l_dd, found.l_qd, found.l_dq, found.l_qq)
        for slope, wanted in zip(slopes, (*by_d, *by_q), strict=True):
            assert float(slope) == pytest.approx(wanted[index], abs=2e-5 * machine.l_q)


@pytest.mark.parametrize("name", MACHINES)
def test_boxes_over_several_cells_hold_what_lies_in_them(name: str) -> None:
    machine = library(name)
    generator = np.random.default_rng(4)
    width = 2.6 * machine.i_max / 80
    counts = set()
    for _ in range(60):
        middle = generator.uniform(-1.0, 1.0, 2) * machine.i_max
        radius = generator.uniform(0.0, 0.9, 2) * width
        box = tuple(arb(float(m), float(r)) for m, r in zip(middle, radius, strict=True))
        formulas = jets(machine, *box)
        counts.add(len(formulas))
        found = [formula(*box) for formula in formulas]
        share = generator.uniform(-1.0, 1.0, (2, 200))
        sampled = machine.jet(middle[0] + radius[0] * share[0], middle[1] + radius[1] * share[1])
        for field in NAMES:
            ball = hull([as_ball(getattr(jet, field)) for jet in found])
            values = getattr(sampled, field)
            room = 1e-11 * np.max(np.abs(values))
            assert float(ball.lower()) - room <= np.min(values)
            assert np.max(values) <= float(ball.upper()) + room
    assert {1, 2, 4} <= counts
    assert max(counts) <= 9


def test_linear_machines_are_one_formula_and_others_are_refused() -> None:
    (formula,) = jets(IPM, arb(-50), arb(100))
    jet = formula(arb(-50), arb(100))
    assert float(jet.psi_d) == pytest.approx(IPM.psi_pm - 50 * IPM.l_d)
    assert float(jet.psi_q) == pytest.approx(100 * IPM.l_q)
    assert (float(jet.l_dd), float(jet.l_qq), float(jet.l_dq)) == (IPM.l_d, IPM.l_q, 0.0)
    with pytest.raises(TypeError, match="ArctanMachine"):
        jets(ArctanMachine(), arb(0), arb(0))
    with pytest.raises(ZeroDivisionError):
        jets(library(MACHINES[0]), arb(0, 10), arb(0, 10))


CONDITIONS: list[Condition] = ["loss", "voltage", "no i_d"]


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("machine", [IPM, library(MACHINES[1])], ids=["linear", "flux map"])
def test_conditions_and_their_derivatives(
    machine: LinearMachine | SaturatedMachine, condition: Condition
) -> None:
    """Against central differences of torque and voltage as the machine gives them."""
    speed = SpeedPoint(300.0, 200.0)
    choice = CurrentChoice(machine, "mtpa", machine.i_max, speed)
    reference = CurrentReference(Proportional(np.float32(1.0)), np.float32(1.0))
    task = Task(choice, reference, (), False, {})
    generator = np.random.default_rng(5)
    step = 1e-4 * machine.i_max
    omega = np.array([machine.pole_pairs * speed.omega_m])

    def excess(i_d: float, i_q: float) -> float:
        v_d, v_q = machine.voltage(np.array([i_d]), np.array([i_q]), omega)
        return float((v_d[0] ** 2 + v_q[0] ** 2) / speed.v_max**2 - 1.0)

    def torque(i_d: float, i_q: float) -> float:
        return float(machine.torque(np.array([i_d]), np.array([i_q]))[0])

    def gradient(
        function: Callable[[float, float], float], i_d: float, i_q: float
    ) -> tuple[float, float]:
        by_d = (function(i_d + step, i_q) - function(i_d - step, i_q)) / (2 * step)
        return by_d, (function(i_d, i_q + step) - function(i_d, i_q - step)) / (2 * step)

    def second(i_d: float, i_q: float) -> float:
        if condition == "no i_d":
            return i_d
        if condition == "voltage":
            return excess(i_d, i_q)
        t_d, t_q = gradient(torque, i_d, i_q)
        return t_q * i_d - t_d * i_q

    for i_d, i_q in (generator.uniform(0.1, 0.7, (10, 2)) * machine.i_max * [-1.0, 1.0]).tolist():
        at = conditions_over_box(task, (arb(i_d), arb(i_q)), condition)
        scale = torque(i_d, i_q)
        assert float(at.torque) == pytest.approx(scale, rel=1e-9)
        assert (float(at.t_d), float(at.t_q)) == pytest.approx(
            gradient(torque, i_d, i_q), abs=1e-5 * scale
        )
        assert float(at.excess) == pytest.approx(excess(i_d, i_q), abs=1e-9)
        assert (float(at.e_d), float(at.e_q)) == pytest.approx(gradient(excess, i_d, i_q), abs=1e-6)
        assert float(at.condition) == pytest.approx(second(i_d, i_q), abs=2e-6 * scale)
        expected = gradient(second, i_d, i_q)
        assert (float(at.c_d), float(at.c_q)) == pytest.approx(expected, rel=2e-4, abs=2e-5 * scale)
