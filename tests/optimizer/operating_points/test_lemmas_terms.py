"""Derivatives that the proofs rest on, each for itself, against those of polynomials by rule."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from drives import IPM, RELUCTANCE
from flint import arb, ctx
from numpy.polynomial import polynomial

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import FluxJet, LinearMachine
from dqforge.optimizer.certificates import ball as enclosures
from dqforge.optimizer.certificates import ball as exact_conditions
from dqforge.optimizer.certificates.ball import ORDER, Condition, Local, Task
from dqforge.optimizer.current_reference.forms import CurrentReference, Proportional
from dqforge.optimizer.operating_points import mtpa_locus
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint
from dqforge.optimizer.operating_points.mtpa_locus import LossCoefficients, Terms

CONDITIONS: list[Condition] = ["loss", "voltage", "no i_d"]


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


class Polynomial:
    """A polynomial of two variables, rows by powers of i_d, columns by powers of i_q,
    with products and derivatives.
    """

    def __init__(self, table: Any) -> None:
        self.table = np.asarray(table, dtype=np.float64)

    def __call__(self, i_d: Any, i_q: Any) -> FloatArray:
        return np.asarray(polynomial.polyval2d(i_d, i_q, self.table))

    def __mul__(self, other: Polynomial | float) -> Polynomial:
        if not isinstance(other, Polynomial):
            return Polynomial(self.table * other)
        rows, columns = (
            a + b - 1 for a, b in zip(self.table.shape, other.table.shape, strict=True)
        )
        total = np.zeros((rows, columns))
        for (i, j), value in np.ndenumerate(self.table):
            total[i : i + other.table.shape[0], j : j + other.table.shape[1]] += value * other.table
        return Polynomial(total)

    def __add__(self, other: Polynomial) -> Polynomial:
        shape = tuple(max(a, b) for a, b in zip(self.table.shape, other.table.shape, strict=True))
        total = np.zeros(shape)
        for part in (self.table, other.table):
            total[: part.shape[0], : part.shape[1]] += part
        return Polynomial(total)

    def __sub__(self, other: Polynomial) -> Polynomial:
        return self + other * -1.0

    def by_d(self) -> Polynomial:
        return Polynomial(polynomial.polyder(self.table, axis=0))

    def by_q(self) -> Polynomial:
        return Polynomial(polynomial.polyder(self.table, axis=1))


GENERATOR = np.random.default_rng(17)
PSI_D, PSI_Q = (Polynomial(GENERATOR.uniform(0.3, 1.0, (4, 4)) * sign) for sign in (1.0, -1.0))
I_D, I_Q = Polynomial([[0.0], [1.0]]), Polynomial([[0.0, 1.0]])
AT_D, AT_Q = GENERATOR.uniform(0.4, 1.3, (2, 5)) * [[-1.0], [1.0]]
NAMES = [field.name for field in fields(FluxJet)]


def jet_functions() -> list[Polynomial]:
    """In the order of `FluxJet`."""
    d_d, d_q, q_d, q_q = PSI_D.by_d(), PSI_D.by_q(), PSI_Q.by_d(), PSI_Q.by_q()
    second = [d_d.by_d(), d_d.by_q(), d_q.by_q(), q_d.by_d(), q_d.by_q(), q_q.by_q()]
    return [PSI_D, PSI_Q, d_d, d_q, q_d, q_q, *second]


def jet() -> FluxJet:
    return FluxJet(*(function(AT_D, AT_Q) for function in jet_functions()))


def assert_terms(found: Terms, function: Polynomial, skip: tuple[str, ...] = ()) -> None:
    first = function.by_d(), function.by_q()
    expected = {
        "value": function,
        "d": first[0],
        "q": first[1],
        "dd": first[0].by_d(),
        "dq": first[0].by_q(),
        "qq": first[1].by_q(),
    }
    for name, wanted in expected.items():
        if name not in skip:
            np.testing.assert_allclose(
                getattr(found, name), wanted(AT_D, AT_Q), rtol=1e-11, err_msg=name
            )


TORQUE = (PSI_D * I_Q - PSI_Q * I_D) * (1.5 * IPM.pole_pairs)


def squared_voltage(machine: LinearMachine, omega: float) -> Polynomial:
    v_d, v_q = I_D * machine.r_s - PSI_Q * omega, I_Q * machine.r_s + PSI_D * omega
    return v_d * v_d + v_q * v_q


def test_torque_terms() -> None:
    assert_terms(mtpa_locus.torque_terms(IPM, jet(), AT_D, AT_Q), TORQUE)


def test_voltage_terms() -> None:
    machine = LinearMachine(4, 0.7, 1.0, 1.0, 1.0, 1.0)
    omega = np.full(AT_D.size, 1.7)
    assert_terms(
        mtpa_locus.voltage_terms(machine, jet(), AT_D, AT_Q, omega), squared_voltage(machine, 1.7)
    )


def test_loss_terms_without_and_with_the_magnitude() -> None:
    square, iron = 0.8, 0.3
    plain = LossCoefficients(np.array(square), np.array(0.0), np.array(iron))
    function = (I_D * I_D + I_Q * I_Q) * square + (PSI_D * PSI_D + PSI_Q * PSI_Q) * iron
    assert_terms(mtpa_locus.loss_terms(plain, jet(), AT_D, AT_Q, 0.2), function)
    soft, linear = 0.2, 1.3
    found = mtpa_locus.loss_terms(
        LossCoefficients(np.array(0.0), np.array(linear), np.array(0.0)), jet(), AT_D, AT_Q, soft
    )
    size = np.sqrt(AT_D**2 + AT_Q**2 + soft**2)
    expected = Terms(
        value=linear * (size - soft),
        d=linear * AT_D / size,
        q=linear * AT_Q / size,
        dd=linear * (AT_Q**2 + soft**2) / size**3,
        dq=-linear * AT_D * AT_Q / size**3,
        qq=linear * (AT_D**2 + soft**2) / size**3,
    )
    for field in fields(Terms):
        np.testing.assert_allclose(
            getattr(found, field.name), getattr(expected, field.name), rtol=1e-12
        )


def test_current_terms_and_choice_of_points() -> None:
    assert_terms(mtpa_locus.current_terms(AT_D, AT_Q), I_D * I_D + I_Q * I_Q)
    taken = LossCoefficients(np.arange(3.0), np.arange(3.0) + 5, np.arange(3.0) + 9).take(
        np.array([2, 0])
    )
    assert [part.tolist() for part in (taken.square, taken.linear, taken.iron)] == [
        [2, 0],
        [7, 5],
        [11, 9],
    ]


def test_newton_step_solves_both_equations() -> None:
    first = mtpa_locus.torque_terms(IPM, jet(), AT_D, AT_Q)
    second = mtpa_locus.current_terms(AT_D, AT_Q)
    step_d, step_q = mtpa_locus.newton_step(first, second, 3.0, np.full(AT_D.size, 2.0))
    for k in range(AT_D.size):
        matrix = np.array([[first.d[k], first.q[k]], [second.d[k], second.q[k]]])
        wanted = np.linalg.solve(matrix, [3.0 - first.value[k], 2.0 - second.value[k]])
        np.testing.assert_allclose([step_d[k], step_q[k]], wanted, rtol=1e-11)
    with np.errstate(all="raise"):
        step = mtpa_locus.newton_step(second, second, 1.0, 2.0)
    assert not np.any(np.isfinite(step))


def test_cross_of_gradients_with_its_own() -> None:
    machine = LinearMachine(4, 0.7, 1.0, 1.0, 1.0, 1.0)
    other = squared_voltage(machine, 1.7)
    found = mtpa_locus.cross_of_gradients(
        mtpa_locus.torque_terms(IPM, jet(), AT_D, AT_Q),
        mtpa_locus.voltage_terms(machine, jet(), AT_D, AT_Q, np.full(AT_D.size, 1.7)),
    )
    assert_terms(
        found, TORQUE.by_d() * other.by_q() - TORQUE.by_q() * other.by_d(), ("dd", "dq", "qq")
    )
    np.testing.assert_array_equal(found.dd, found.d)
    np.testing.assert_array_equal(found.dq, found.q)


def choice(speed: SpeedPoint | None, machine: Any = IPM, strategy: Any = "mtpa") -> CurrentChoice:
    return CurrentChoice(machine, strategy, machine.i_max, speed)


def task(speed: SpeedPoint | None, **more: Any) -> Task:
    reference = CurrentReference(Proportional(np.float32(1.0)), np.float32(1.0))
    return Task(choice(speed, **more), reference, (), False, {})


def test_torque_parts() -> None:
    found = exact_conditions.torque_parts(jet(), AT_D, AT_Q, 1.5 * IPM.pole_pairs)  # type: ignore[arg-type]
    assert_terms(Terms(*found), TORQUE)


@pytest.mark.parametrize("condition", CONDITIONS)
def test_conditions_with_their_gradients(condition: Condition) -> None:
    """Torque, the condition and the voltage excess at one current, with flux
    linkages that are polynomials.
    """
    omega_m, v_max = 0.43, 2.9
    at_d, at_q = float(AT_D[0]), float(AT_Q[0])
    balls = enclosures.Jet(*(arb(float(function(at_d, at_q))) for function in jet_functions()))
    found = task(SpeedPoint(omega_m, v_max)).local(balls, arb(at_d), arb(at_q), condition)
    excess = squared_voltage(IPM, IPM.pole_pairs * omega_m) * v_max**-2 - Polynomial([[1.0]])
    second = {
        "loss": TORQUE.by_q() * I_D - TORQUE.by_d() * I_Q,
        "voltage": excess,
        "no i_d": I_D,
    }[condition]
    expected = [
        TORQUE, TORQUE.by_d(), TORQUE.by_q(), TORQUE.by_d().by_d(), TORQUE.by_d().by_q(),
        TORQUE.by_q().by_q(),
        second, second.by_d(), second.by_q(), excess, excess.by_d(), excess.by_q(),
    ]  # fmt: skip
    for name, function in zip(Local.__dataclass_fields__, expected, strict=True):
        assert float(getattr(found, name)) == pytest.approx(
            float(function(at_d, at_q)), rel=1e-10, abs=1e-12
        ), name


def test_no_speed_is_no_excess() -> None:
    found = task(None).local(enclosures.Jet(*[arb(1)] * 12), arb(-2), arb(3), "loss")
    assert (found.excess, found.e_d, found.e_q) == (0, 0, 0)


def test_box_holds_every_cell() -> None:
    """Over several cells the hull of all, over one its own."""
    machine = catalogue.load("baldor-pmsyrm-5k6").machine
    assert isinstance(machine, SaturatedMachine)
    here = task(None, machine=machine)
    corner = machine.flux_map.cell(5, 5)[1:]
    box = arb(corner[0], 0.01), arb(corner[1], 0.01)
    assert len(enclosures.jets(machine, *box)) == 4
    found = exact_conditions.conditions_over_box(here, box, "loss")
    for shift_d in (-0.01, 0.01):
        for shift_q in (-0.01, 0.01):
            at = arb(corner[0] + shift_d), arb(corner[1] + shift_q)
            (formula,) = enclosures.jets(machine, *at)
            one = here.local(formula(*at), *at, "loss")
            for name in Local.__dataclass_fields__:
                assert getattr(found, name).overlaps(getattr(one, name)), name


@pytest.mark.parametrize("starts_limited", [False, True])
def test_conditions_change_at_kinks(starts_limited: bool) -> None:
    reference = CurrentReference(Proportional(np.float32(1.0)), np.float32(10.0))
    here = Task(choice(SpeedPoint(1.0, 1.0)), reference, (3.0, 7.0), starts_limited, {})
    first, second = ("voltage", "loss") if starts_limited else ("loss", "voltage")
    assert here.conditions(0.0, 2.9) == [first]
    assert here.conditions(3.1, 6.9) == [second]
    assert here.conditions(7.1, 10.0) == [first]
    for low, high in (
        (2.9, 3.1),
        (2.0, 3.0 - 0.9e-6),
        (3.0 + 0.9e-6, 5.0),
        (0.0, 10.0),
        (3.0, 4.0),
        (2.0, 3.0),
    ):
        assert here.conditions(low, high) == ["loss", "voltage"]
    assert here.conditions(2.0, 3.0 - 1.1e-6) == [first]
    assert here.conditions(3.0 + 1.1e-6, 5.0) == [second]
    nothing = Task(choice(None, strategy="id0"), reference, (3.0,), False, {})
    assert nothing.conditions(2.0, 4.0) == ["no i_d"]


def test_kinks_are_where_the_voltage_begins_to_limit() -> None:
    """MTPA currents below, the limit above: the voltage of the MTPA currents meets it at the
    kink.
    """
    speed = SpeedPoint(500.0, 240.0)
    limited = choice(speed)
    kinks, starts = exact_conditions._voltage_kinks(limited, limited.largest_torque())
    assert len(kinks) == 1
    assert not starts
    free = choice(None)
    volts = []
    for torque in (kinks[0] * (1 - 1e-7), kinks[0] * (1 + 1e-7)):
        i_d, i_q = free.currents(np.array([torque]))
        volts.append(float(np.hypot(*IPM.voltage(i_d, i_q, np.array([IPM.pole_pairs * 500.0])))[0]))
    assert volts[0] < 240.0 < volts[1]
    made = Task.of(
        limited,
        CurrentReference(Proportional(np.float32(1.0)), np.float32(limited.largest_torque())),
    )
    assert made.kinks == pytest.approx(tuple(kinks), rel=1e-6)
    fast = choice(SpeedPoint(900.0, 240.0))
    kinks, starts = exact_conditions._voltage_kinks(fast, fast.largest_torque())
    assert starts
    assert kinks == []
    at_d, at_q = made.exact(50.0)
    found = limited.currents(np.array([50.0]))
    assert (at_d, at_q) == pytest.approx((float(found[0][0]), float(found[1][0])), rel=1e-12)
    assert Task.of(free, made.reference).kinks == ()


def test_bicubic_and_its_derivatives() -> None:
    table = GENERATOR.uniform(-1.0, 1.0, (4, 4))  # rows by powers of q
    rows = [[Fraction(float(value)) for value in row] for row in table]
    found = enclosures.bicubic(rows, Fraction(3, 4), Fraction(-5, 4))
    function = Polynomial(table.T)
    d, q = function.by_d(), function.by_q()
    expected = [function, d, q, d.by_d(), d.by_q(), q.by_q()]
    for value, wanted in zip(found, expected, strict=True):
        assert float(value) == pytest.approx(float(wanted(0.75, -1.25)), rel=1e-12)


@pytest.mark.parametrize("machine", [IPM, RELUCTANCE])
def test_linear_formula(machine: LinearMachine) -> None:
    found = enclosures._linear(machine)(arb(-2), arb(5))
    expected = machine.jet(np.array([-2.0]), np.array([5.0]))
    for name in NAMES:
        assert float(getattr(found, name)) == pytest.approx(
            float(getattr(expected, name)[0]), rel=1e-15
        )


def test_cells_that_a_box_touches() -> None:
    """A box that ends on a grid line counts both sides; nine cells at most."""
    machine = catalogue.load("baldor-pmsyrm-5k6").machine
    assert isinstance(machine, SaturatedMachine)
    _, d_0, q_0 = machine.flux_map.cell(4, 6)
    _, d_1, q_1 = machine.flux_map.cell(5, 7)
    width_d, width_q = d_1 - d_0, q_1 - q_0

    def count(low_d: float, high_d: float, low_q: float, high_q: float) -> int:
        """Shares of the cell."""
        middle = d_0 + 0.5 * (low_d + high_d) * width_d, q_0 + 0.5 * (low_q + high_q) * width_q
        radius = 0.5 * (high_d - low_d) * width_d, 0.5 * (high_q - low_q) * width_q
        return len(enclosures.jets(machine, arb(middle[0], radius[0]), arb(middle[1], radius[1])))

    assert count(0.2, 0.8, 0.2, 0.8) == 1
    assert count(0.2, 1.2, 0.2, 0.8) == 2
    assert count(0.2, 0.8, -0.2, 0.8) == 2
    assert count(-0.2, 1.2, -0.2, 1.2) == 9
    assert len(enclosures.jets(machine, arb(d_0), arb(q_0 + 0.5 * width_q))) == 2
    assert len(enclosures.jets(machine, arb(d_0 + 0.5 * width_d), arb(q_0))) == 2
    with pytest.raises(ZeroDivisionError):
        count(-0.2, 2.2, -0.2, 1.2)
    inside = arb(d_0 + 0.3 * width_d), arb(q_0 + 0.6 * width_q)
    (formula,) = enclosures.jets(machine, *inside)
    expected = machine.jet(np.array([float(inside[0])]), np.array([float(inside[1])]))
    got = formula(*inside)
    for name in NAMES:
        wanted = float(getattr(expected, name)[0])
        assert float(getattr(got, name)) == pytest.approx(wanted, rel=1e-8, abs=1e-9), name
