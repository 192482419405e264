"""Certificates: bounds that no torque exceeds, close to the largest errors there are,
and that see what is wrong.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import mpmath
import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, in_floats
from exact_currents import (
    Found,
    dense_torques,
    exact_currents,
    found_errors,
    mpmath_currents,
    torque_of,
    voltage_share,
)
from flint import arb, ctx
from saturated import ArctanMachine

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates.ball import ORDER, Task
from dqforge.optimizer.certificates.current_reference import Certificate, certify, interval_bounds
from dqforge.optimizer.current_reference.fit import ReferenceFit, fit_reference
from dqforge.optimizer.current_reference.forms import (
    CurrentReference,
    FixedReference,
    ReferenceErrors,
    TorqueExact,
    reference_errors,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint

# Random torques per case, to which an eighth of log-spaced ones and the neighbours of the edges
# come.
TORQUES = 180_000
IPM_SCALES = (215.0, 283.0)
# At 4775 rpm the voltage limits the current of paper 000's machine from some third of its torque
# on.
FAST = SpeedPoint(500.0, 240.0)


def free(machine: LinearMachine, speed: SpeedPoint | None = None) -> CurrentChoice:
    return CurrentChoice(machine, "mtpa", machine.i_max, speed)


def polynomial(degree: int, **changes: object) -> FitSettings:
    return replace(FitSettings(form="polynomial", degree=degree), **changes)  # type: ignore[arg-type]


def saturated(name: str) -> CurrentChoice:
    design = catalogue.load(name)
    return CurrentChoice(design.machine, "mtpa", design.i_max)


CHOICES = {
    "ipm": free(IPM),
    "inverse": free(INVERSE_SALIENT),
    "surface": free(SURFACE),
    "reluctance": free(RELUCTANCE),
    "id0": CurrentChoice(IPM, "id0", IPM.i_max),
    "fast": free(IPM, FAST),
}

CASES: dict[str, tuple[str, FitSettings]] = {
    "torque-exact": ("ipm", FitSettings()),
    "torque-exact-inverse": ("inverse", FitSettings(degree=3)),
    "polynomial-shared": ("ipm", polynomial(3)),
    "polynomial-own": ("ipm", polynomial(2, breakpoint_mode="own")),
    "polynomial-free": ("ipm", polynomial(1, segments=4, exact_at_zero=False, continuous=False)),
    "even-odd": ("ipm", FitSettings(form="even-odd", degree=3, segments=2)),
    "even-odd-inverse": ("inverse", FitSettings(form="even-odd", degree=2)),
    "closed-form": ("ipm", FitSettings(form="closed-form", degree=3)),
    "closed-form-inverse": ("inverse", FitSettings(form="closed-form", degree=2)),
    "proportional-surface": ("surface", FitSettings()),
    "proportional-id0": ("id0", FitSettings()),
    "square-root": ("reluctance", FitSettings(form="closed-form")),
    "polynomial-reluctance": ("reluctance", polynomial(4, segments=3)),
    "q15": ("ipm", polynomial(2, format="q15", full_scale=IPM_SCALES)),
    "q15-free": (
        "ipm",
        polynomial(
            2,
            format="q15",
            full_scale=IPM_SCALES,
            exact_at_zero=False,
            continuous=False,
            breakpoint_mode="own",
        ),
    ),
    "q15-surface": ("surface", polynomial(1, format="q15", full_scale=(25.0, 50.0))),
    "q31": ("ipm", polynomial(4, format="q31", full_scale=IPM_SCALES)),
    "fast": ("fast", polynomial(3, segments=3)),
    "fast-torque-exact": ("fast", FitSettings(degree=3, segments=3)),
    "abb-syrm-6k7-saturated": ("abb-syrm-6k7-saturated", polynomial(4, segments=3)),
    "baldor-pmsyrm-5k6": ("baldor-pmsyrm-5k6", polynomial(4)),
    "baldor-q15": ("baldor-pmsyrm-5k6", polynomial(3, format="q15", full_scale=(60.0, 30.0))),
}

MAGNET_CASES = [
    "torque-exact",
    "polynomial-shared",
    "even-odd-inverse",
    "closed-form",
    "q15",
    "q31",
]


@dataclass(frozen=True)
class Proven:
    choice: CurrentChoice
    fit: ReferenceFit
    certificate: Certificate


def prove(choice: CurrentChoice, settings: FitSettings) -> Proven:
    fit = fit_reference(choice, settings)
    certificate = certify(choice, fit.reference, fit.errors)
    assert certificate is not None
    return Proven(choice, fit, certificate)


_PROVEN: dict[str, Proven] = {}


def proven(name: str) -> Proven:
    """A case, proven once for all tests."""
    if name not in _PROVEN:
        machine, settings = CASES[name]
        _PROVEN[name] = prove(
            CHOICES[machine] if machine in CHOICES else saturated(machine), settings
        )
    return _PROVEN[name]


def noise(case: Proven) -> Found:
    """What the extended precision of the check itself may err by (doubles for flux maps)."""
    end, i_max, r_s = (
        float(case.fit.reference.torque_max),
        case.choice.i_max,
        case.choice.machine.r_s,
    )
    unit = 1e-17 if isinstance(case.choice.machine, LinearMachine) else 1e-12
    return Found(unit * i_max, unit * i_max, unit * end, unit * 1.5 * r_s * i_max**2, unit, unit)


def floors(case: Proven) -> Found:
    """Below these bounds are not refined: 1e-9 of full scale, for the loss in W 1e-5;
    see docs/methods/certificates.md.
    """
    end, i_max, r_s = (
        float(case.fit.reference.torque_max),
        case.choice.i_max,
        case.choice.machine.r_s,
    )
    slack = 1.02 if isinstance(case.choice.machine, LinearMachine) else 1.12
    return Found(
        *(
            slack * value
            for value in (
                1e-9 * i_max,
                1e-9 * i_max,
                1e-9 * end,
                1.5e-5 * r_s * i_max**2,
                1e-9,
                1e-9,
            )
        )
    )


def rounding(case: Proven) -> Found:
    """Errors below which rounding is most of it: 4 units of float at full scale,
    2 codes in fixed point.
    """
    end, i_max, reference = (
        float(case.fit.reference.torque_max),
        case.choice.i_max,
        case.fit.reference,
    )
    unit = 2.0 ** (2 - reference.width) if isinstance(reference, FixedReference) else 2.0**-22
    return Found(unit * i_max, unit * i_max, unit * end, 0.0, 0.0, 0.0)


@pytest.mark.thinned
@pytest.mark.parametrize("name", CASES)
def test_no_torque_exceeds_the_bounds_and_they_are_close(name: str) -> None:
    case = proven(name)
    torque = dense_torques(case.fit.reference, TORQUES, seed=1)
    assert torque.size > (200_000 if not isinstance(case.fit.reference, FixedReference) else 20_000)
    found = found_errors(case.choice, case.fit.reference, torque)
    close = 1.2 if isinstance(case.choice.machine, LinearMachine) else 1.6
    for field in fields(Found):
        bound, error = getattr(case.certificate, field.name), getattr(found, field.name)
        if field.name == "voltage_excess" and case.choice.speed is None:
            assert bound is None
            continue
        assert bound is not None
        assert bound >= error - getattr(noise(case), field.name), field.name
        factor = close if error > getattr(rounding(case), field.name) else 8.0
        assert bound <= max(factor * error, getattr(floors(case), field.name)), field.name
    assert case.certificate.torque_relative >= case.certificate.torque / float(
        case.fit.reference.torque_max
    )
    is_linear = isinstance(case.choice.machine, LinearMachine)
    assert case.certificate.model == ("equations" if is_linear else "splines")


def in_forty_digits(value: Any) -> Any:
    """An extended number, exactly."""
    high = float(value)
    return mpmath.mpf(high) + mpmath.mpf(float(value - high))


@pytest.mark.thinned
@pytest.mark.parametrize("name", MAGNET_CASES)
def test_bounds_hold_in_forty_digits_where_errors_are_largest(name: str) -> None:
    """The torques with the largest errors, and the ends, once more by the quartic in mpmath."""
    case = proven(name)
    reference, machine = case.fit.reference, case.choice.machine
    assert isinstance(machine, LinearMachine)
    torque = dense_torques(reference, 20_000, seed=2)
    exact = exact_currents(case.choice, torque.astype(np.longdouble))
    fused = not isinstance(reference, FixedReference)
    given = [current.astype(np.longdouble) for current in reference.currents(torque, fused=fused)]
    worst = [np.argsort(-np.abs(g - e))[:15] for g, e in zip(given, exact, strict=True)]
    for index in np.unique([*np.concatenate(worst), 0, 1, torque.size - 1]).tolist():
        with mpmath.workdps(40):
            for axis, current in enumerate(mpmath_currents(machine, float(torque[index]))):
                assert (
                    abs(in_forty_digits(given[axis][index]) - current)
                    <= (case.certificate.i_d, case.certificate.i_q)[axis]
                )
                assert abs(in_forty_digits(exact[axis][index]) - current) <= 1e-18 * machine.i_max


def certified_task(choice: CurrentChoice, reference: CurrentReference) -> Certificate:
    found = certify(choice, reference, reference_errors(choice, reference))
    assert found is not None
    return found


@pytest.mark.slow
def test_another_machine_has_larger_bounds() -> None:
    """Inductance 1 % off: bounds rise to the errors that this makes, which
    sampling against it confirms.
    """
    case = proven("polynomial-shared")
    other = free(replace(IPM, l_q=IPM.l_q * 1.01))
    certificate = certified_task(other, in_floats(case.fit))
    found = found_errors(other, case.fit.reference, dense_torques(case.fit.reference, 20_000, 3))
    for name in ("i_d", "i_q", "torque", "loss_relative"):
        assert getattr(certificate, name) > 5.0 * getattr(case.certificate, name)
        assert getattr(certificate, name) >= getattr(found, name)


@pytest.mark.thinned
@pytest.mark.parametrize("wrong_machine", [True, False])
def test_bounds_need_no_good_sampling(wrong_machine: bool) -> None:
    """Samples that saw too little, even nothing: the bounds are proven without them."""
    case = proven("torque-exact")
    choice = free(replace(IPM, l_q=IPM.l_q * 1.01)) if wrong_machine else case.choice
    blind = ReferenceErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, None, 0)
    certificate = certify(choice, case.fit.reference, blind)
    assert certificate is not None
    found = found_errors(choice, case.fit.reference, dense_torques(case.fit.reference, 20_000, 4))
    for name in ("i_d", "i_q", "torque", "loss", "loss_relative"):
        assert getattr(certificate, name) >= getattr(found, name)


@pytest.mark.thinned
@pytest.mark.parametrize("power", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("segment", [0, 1])
def test_mutated_coefficient_raises_the_bounds(power: int, segment: int) -> None:
    """One coefficient changed until the current of its segment's end moves
    by three times the bound.
    """
    case = proven("torque-exact")
    reference = in_floats(case.fit)
    form = reference.form
    assert isinstance(form, TorqueExact)
    length = (
        float(form.d.starts[1]) if segment == 0 else float(reference.torque_max - form.d.starts[1])
    )
    bound = case.certificate.i_d
    assert bound is not None
    rows = form.d.coefficients.copy()
    rows[segment, power] += np.float32(3.0 * bound / length**power)
    mutated = replace(reference, form=replace(form, d=replace(form.d, coefficients=rows)))
    # As for samples that did not see it: only the proof has to.
    certificate = certify(case.choice, mutated, case.fit.errors)
    assert certificate is not None
    assert certificate.i_d is not None
    assert certificate.i_d > 2.0 * bound
    found = found_errors(case.choice, mutated, dense_torques(mutated, 20_000, 5))
    assert certificate.i_d >= found.i_d
    assert certificate.torque >= found.torque


def test_mutated_integer_raises_the_bounds() -> None:
    case = proven("q15")
    reference = case.fit.reference
    assert isinstance(reference, FixedReference)
    first, *rest = reference.q.segments
    moved = (*first.constants[:-1], first.constants[-1] + (200 << first.shifts[-1]))
    mutated = replace(
        reference, q=replace(reference.q, segments=(replace(first, constants=moved), *rest))
    )
    certificate = certify(case.choice, mutated, reference_errors(case.choice, mutated))
    assert certificate is not None
    assert certificate.i_q is not None
    assert (
        certificate.i_q
        >= found_errors(case.choice, mutated, dense_torques(mutated, 0, 6)).i_q
        > 1.5
    )


@pytest.mark.thinned
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("negative", [False, True])
def test_bounds_near_rest_without_magnets(degree: int, negative: bool) -> None:
    """The vertical tangent of the square root, where polynomials err by all of the current."""
    machine = (
        replace(RELUCTANCE, l_d=RELUCTANCE.l_q, l_q=RELUCTANCE.l_d) if negative else RELUCTANCE
    )
    case = prove(free(machine), polynomial(degree, segments=2))
    end = float(case.fit.reference.torque_max)
    torque = np.unique((np.geomspace(1e-12, 1.0, 100_000) * end).astype(np.float32))
    found = found_errors(case.choice, case.fit.reference, torque)
    for name in ("i_d", "i_q", "torque", "loss", "loss_relative"):
        bound = getattr(case.certificate, name)
        assert bound is not None
        assert bound >= getattr(found, name) - getattr(noise(case), name)
    assert case.certificate.i_q is not None
    assert case.certificate.i_q <= 1.2 * found.i_q
    # Both polynomials are the same, so that the currents keep the optimal
    # angle whatever they err by.
    assert case.certificate.loss is not None
    assert case.certificate.loss <= 1e-9 * machine.r_s * machine.i_max**2


@pytest.mark.slow
def test_conditions_around_the_kink() -> None:
    """Least loss below the torque at which the voltage begins to limit, voltage above it,
    both beside it.
    """
    case = proven("fast")
    task, end = Task.of(case.choice, case.fit.reference), float(case.fit.reference.torque_max)
    (kink,) = task.kinks
    assert 0.05 * end < kink < 0.95 * end
    assert not task.starts_limited
    assert task.conditions(0.0, 0.999 * kink) == ["loss"]
    assert task.conditions(1.001 * kink, end) == ["voltage"]
    assert task.conditions(kink * (1.0 - 1e-6), kink * (1.0 + 1e-6)) == ["loss", "voltage"]
    assert task.conditions(0.0, end) == ["loss", "voltage"]
    assert task.conditions(kink - 0.5e-7 * end, kink - 0.4e-7 * end) == ["loss", "voltage"]
    i_d, i_q = case.choice.currents(np.array([0.999, 1.001]) * kink)
    share = voltage_share(case.choice, i_d, i_q)
    assert share[0] < 1.0 - 1e-6
    assert share[1] == pytest.approx(1.0, abs=1e-8)


def test_voltage_limits_from_rest_on() -> None:
    """Fast enough that field weakening begins at zero torque: no kink, and
    current flows without torque.
    """
    case = prove(free(IPM, SpeedPoint(650.0, 240.0)), polynomial(3, segments=2))
    task = Task.of(case.choice, case.fit.reference)
    assert task.starts_limited
    assert task.kinks == ()
    assert task.conditions(0.0, 1.0) == ["voltage"]
    end = float(case.fit.reference.torque_max)
    torque = dense_torques(case.fit.reference, 20_000, 7)
    torque = torque[torque < 0.98 * end]
    found = found_errors(case.choice, case.fit.reference, torque)
    assert case.certificate.voltage_excess is not None
    assert case.certificate.voltage_excess >= found.voltage_excess
    assert case.certificate.torque >= found.torque


@pytest.mark.slow
def test_loss_beside_the_kink_is_that_of_the_torque_that_is_made() -> None:
    """A coarse reference whose torque lies beyond the kink where its request does not: dense
    samples about the kink.
    """
    case = prove(free(IPM, FAST), polynomial(2, torque_max=100.0))
    (kink,) = Task.of(case.choice, case.fit.reference).kinks
    torque = np.unique(np.linspace(0.9 * kink, 1.1 * kink, 60_000).astype(np.float32))
    found = found_errors(
        case.choice, case.fit.reference, torque[torque <= case.fit.reference.torque_max]
    )
    for field in fields(Found):
        bound = getattr(case.certificate, field.name)
        assert bound is not None
        assert bound >= getattr(found, field.name)


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["polynomial-own", "fast", "baldor-pmsyrm-5k6"])
def test_intervals_make_up_the_domain_and_each_holds(name: str) -> None:
    case = proven(name)
    reference = in_floats(case.fit)
    parts = interval_bounds(case.choice, reference, case.fit.errors)
    assert parts.low.size == case.certificate.intervals
    assert (parts.low[0], parts.high[-1]) == (0.0, reference.torque_max)
    np.testing.assert_array_equal(parts.low[1:], parts.high[:-1])
    for name_of_bound in ("i_d", "i_q", "torque", "loss_relative"):
        assert np.max(getattr(parts, name_of_bound)) == getattr(case.certificate, name_of_bound)
    for index in np.linspace(0, parts.low.size - 1, 40).astype(int).tolist():
        inside = np.linspace(parts.low[index], parts.high[index], 21).astype(np.float32)
        inside = inside[(inside >= parts.low[index]) & (inside < parts.high[index])]
        found = found_errors(case.choice, reference, np.unique(inside))
        for field in fields(Found):
            assert getattr(parts, field.name)[index] >= getattr(found, field.name) - getattr(
                noise(case), field.name
            )


def test_nothing_is_claimed_of_other_machines() -> None:
    machine = ArctanMachine()
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    fit = fit_reference(choice, polynomial(3))
    assert certify(choice, fit.reference, fit.errors) is None


def test_context_of_the_library_is_left_as_it_was() -> None:
    before = ctx.prec, ctx.cap
    first = proven("torque-exact")
    again = certify(first.choice, first.fit.reference, first.fit.errors)
    assert (ctx.prec, ctx.cap) == before
    assert again is not None
    assert asdict(again) == asdict(first.certificate)
    ctx.prec, ctx.cap = 200, ORDER + 4
    try:
        assert certify(first.choice, first.fit.reference, first.fit.errors) == again
        assert (ctx.prec, ctx.cap) == (200, ORDER + 4)
    finally:
        ctx.prec, ctx.cap = before
    assert arb(1) / 3 != arb(1) / 7
    assert math.isfinite(again.torque)


def test_torque_bound_is_that_of_the_machine() -> None:
    """Shapes of the check itself: the torque of the emitted currents, by paper 000's formula."""
    i_d, i_q = np.array([-100.0, -50.0]), np.array([200.0, 20.0])
    torque = 6.0 * (IPM.psi_pm * i_q + (IPM.l_d - IPM.l_q) * i_d * i_q)
    np.testing.assert_allclose(
        np.asarray(torque_of(IPM, i_d, i_q), dtype=float), torque, rtol=1e-14
    )
