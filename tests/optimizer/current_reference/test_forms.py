"""The forms of the current reference: symmetry, limits, special inputs,
and errors against exact MTPA in double.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, in_floats
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import FitForm
from dqforge.optimizer.current_reference.fit import ReferenceFit, alternatives, fit_reference
from dqforge.optimizer.current_reference.forms import (
    CurrentReference,
    FixedReference,
    Proportional,
    ReluctanceClosedForm,
    SignedReference,
    error_curves,
)
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

FORMS: list[FitForm] = ["polynomial", "even-odd", "torque-exact", "closed-form"]


def fitted(machine: LinearMachine, **settings_: Any) -> ReferenceFit:
    return fit_reference(CurrentChoice(machine, "mtpa", machine.i_max), FitSettings(**settings_))


@pytest.fixture(scope="module", params=FORMS)
def ipm_fit(request: pytest.FixtureRequest) -> ReferenceFit:
    return fitted(IPM, form=request.param)


def test_symmetry_clamp_and_not_a_number(ipm_fit: ReferenceFit) -> None:
    end = float(ipm_fit.reference.torque_max)
    torque = np.array([0.0, 50.0, -50.0, end, 2.0 * end, -np.inf, np.nan], dtype=np.float32)
    i_d, i_q = ipm_fit.reference.currents(torque)
    assert i_d[0] == 0.0
    assert i_q[0] == 0.0
    assert i_d[1] == i_d[2] < 0.0
    assert i_q[1] == -i_q[2] > 0.0
    assert i_d[3] == i_d[4] == i_d[5]
    assert i_q[3] == i_q[4] == -i_q[5]
    assert (i_d[6], i_q[6]) == (0.0, 0.0)
    assert np.hypot(i_d[3], i_q[3]) == pytest.approx(IPM.i_max, rel=1e-3)


def brute_force(machine: LinearMachine, torque: float) -> float:
    """Least |i|^2 for a torque, by scanning i_d: independent of the closed form."""
    scale = machine.i_max

    def square(i_d: float) -> float:
        return float(
            i_d**2
            + (torque / (1.5 * machine.pole_pairs * (machine.psi_pm - machine.saliency * i_d))) ** 2
        )

    sign = -1.0 if machine.saliency > 0.0 else 1.0
    outcome = minimize_scalar(
        lambda x: square(sign * x * scale),
        bounds=(0.0, 2.0),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return float(outcome.fun)


@pytest.mark.parametrize("machine", [IPM, INVERSE_SALIENT], ids=["ipm", "l_d>l_q"])
@pytest.mark.parametrize("form", FORMS)
def test_stated_errors_cover_a_dense_brute_force(machine: LinearMachine, form: FitForm) -> None:
    fit = fitted(machine, form=form)
    torque = np.linspace(0.05, 1.0, 97) * float(fit.reference.torque_max)
    i_d, i_q = (
        current.astype(float) for current in fit.reference.currents(torque.astype(np.float32))
    )
    produced = machine.torque(i_d, i_q)
    assert np.max(np.abs(produced - torque.astype(np.float32))) <= fit.errors.torque * 1.001
    least = np.array([brute_force(machine, float(t)) for t in produced])
    penalty = (i_d**2 + i_q**2) / least - 1.0
    assert np.max(penalty) <= fit.errors.loss_relative * 1.01 + 1e-12
    assert np.min(penalty) >= -1e-9


def test_torque_exact_has_only_rounding_as_torque_error() -> None:
    fit = fitted(IPM, degree=2)
    assert fit.errors.torque_relative < 3e-7
    assert fitted(IPM, form="polynomial", degree=2).errors.torque_relative > 1e-4


def test_figures_of_the_per_unit_problem() -> None:
    """Degree 2, two segments, paper's method and breakpoints over 5 p.u.: 0.15 % torque error,
    0.051 % penalty.
    """
    machine = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 1e4)
    base = 0.75 * 4 * 0.1049 * 0.1049 / (2 * 242e-6)
    common: dict[str, Any] = {
        "method": "lagrange",
        "degree": 2,
        "exact_at_zero": False,
        "continuous": False,
        "torque_max": 5 * base,
    }
    d_fit = fitted(machine, form="torque-exact", breakpoints=(1.5545 * base,), **common)
    assert d_fit.errors.loss_relative == pytest.approx(0.00051, rel=0.02)
    q_fit = fitted(machine, form="closed-form", breakpoints=(2.7667 * base,), **common)
    torque = np.linspace(0.0, 5 * base, 5001)
    assert d_fit.d is not None
    assert q_fit.q is not None
    error = machine.torque(d_fit.d(torque), q_fit.q(torque)) - torque
    assert np.max(np.abs(error)) / (5 * base) == pytest.approx(0.0015, rel=0.02)


def test_surface_machine_and_id0_need_no_polynomial() -> None:
    for fit in (fitted(SURFACE), fit_reference(CurrentChoice(IPM, "id0", 283.0), FitSettings())):
        assert fit.form == "proportional"
        assert fit.d is None
        assert fit.q is None
        assert fit.errors.torque_relative < 2e-7
        assert fit.errors.i_d == 0.0
        assert alternatives(CurrentChoice(SURFACE, "mtpa", 50.0), fit) == ()


def test_reluctance_machine_has_an_exact_square_root_and_refuses_a_division_by_zero() -> None:
    fit = fitted(RELUCTANCE, form="closed-form")
    assert fit.form == "reluctance"
    assert fit.errors.torque_relative < 3e-7
    assert fit.errors.loss_relative < 1e-12
    i_d, i_q = fit.reference.currents(np.array([10.0], dtype=np.float32))
    assert i_d[0] == i_q[0] > 0.0  # l_d > l_q: positive i_d drives
    with pytest.raises(InputError, match="write form: closed-form"):
        fitted(RELUCTANCE, form="torque-exact")


def test_domain_beyond_the_current_limit_is_refused() -> None:
    with pytest.raises(
        NoSolutionError, match=r"fit.max_torque: 250 N m is out of reach.*at most 206"
    ):
        fitted(IPM, torque_max=250.0)
    with pytest.raises(InputError, match="below the largest torque"):
        fitted(IPM, breakpoints=(300.0,))


def test_own_breakpoints_differ_per_axis_and_are_no_worse() -> None:
    shared = fitted(IPM, form="polynomial", degree=2, breakpoint_mode="shared")
    own = fitted(IPM, form="polynomial", degree=2, breakpoint_mode="own")
    assert own.d is not None
    assert own.q is not None
    assert own.d.breakpoints[0] != own.q.breakpoints[0]
    assert max(own.errors.i_d, own.errors.i_q) <= 1.005 * max(shared.errors.i_d, shared.errors.i_q)


def test_alternatives_change_one_thing_at_a_time() -> None:
    fit = fitted(IPM, degree=3)
    rows = {row.label: row for row in alternatives(CurrentChoice(IPM, "mtpa", 283.0), fit)}
    assert set(rows) == {
        "form polynomial",
        "form even-odd",
        "form closed-form",
        "method lagrange",
        "method least-squares",
        "exact at zero: off",
        "continuous: off",
    }
    assert rows["exact at zero: off"].errors.step_at_zero > 0.0 == fit.errors.step_at_zero
    assert rows["method lagrange"].errors.i_d > fit.errors.i_d
    assert rows["continuous: off"].errors.i_d <= fit.errors.i_d * 1.01


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    l_d=st.floats(1e-4, 1e-2),
    ratio=st.floats(0.2, 5.0),
    psi_pm=st.floats(0.01, 1.0),
    i_max=st.floats(5.0, 500.0),
    degree=st.integers(2, 5),
    form=st.sampled_from(FORMS),
)
def test_any_machine_gives_finite_sound_references(
    l_d: float, ratio: float, psi_pm: float, i_max: float, degree: int, form: FitForm
) -> None:
    machine = LinearMachine(3, 0.1, l_d, l_d * ratio, psi_pm, i_max)
    choice = CurrentChoice(machine, "mtpa", i_max)
    fit = fit_reference(choice, FitSettings(form=form, degree=degree, method="lagrange"))
    most = choice.largest_torque()
    torque = np.linspace(-1.0, 1.0, 101, dtype=np.float32) * np.float32(most)
    for fused in (False, True):
        i_d, i_q = fit.reference.currents(torque, fused=fused)
        assert np.all(np.isfinite(i_d))
        assert np.all(np.isfinite(i_q))
        error = machine.torque(i_d.astype(float), i_q.astype(float)) - torque.astype(float)
        assert np.max(np.abs(error)) <= fit.errors.torque * 1.2 + 1e-6 * most


def test_step_at_zero_is_the_length_of_the_current_vector_left_there() -> None:
    fit = fitted(
        IPM, form="polynomial", degree=1, segments=1, exact_at_zero=False, method="lagrange"
    )
    assert fit.d is not None
    assert fit.q is not None
    i_d, i_q = fit.d.coefficients[0, 0], fit.q.coefficients[0, 0]
    assert abs(i_q) > 1.0
    assert fit.errors.step_at_zero == pytest.approx(np.hypot(i_d, i_q), rel=1e-6)


def test_stated_errors_cover_both_contractions() -> None:
    """The larger of both counts: on these machines now the fused, now the
    separate operations err more.
    """
    larger = set()
    for machine, reach in itertools.product((IPM, INVERSE_SALIENT), (0.2, 0.4, 0.6)):
        for degree in (3, 4, 5, 6):
            choice = CurrentChoice(machine, "mtpa", machine.i_max)
            breakpoint_ = reach * CurrentChoice(machine, "mtpa", 40.0).largest_torque()
            fit = fitted(machine, degree=degree, method="lagrange", breakpoints=(breakpoint_,))
            torque = in_floats(fit).samples(4000)
            separate, fused = (
                float(
                    np.max(
                        np.abs(error_curves(choice, fit.reference, torque, fused=way).torque_error)
                    )
                )
                for way in (False, True)
            )
            assert fit.errors.torque == max(separate, fused)
            larger.add(fused > separate)
    assert larger == {True, False}


def test_a_breakpoint_at_the_end_of_the_domain_is_refused() -> None:
    with pytest.raises(InputError, match="below the largest torque"):
        fitted(IPM, torque_max=200.0, breakpoints=(200.0,))


@pytest.mark.parametrize("form", FORMS)
def test_both_signs_of_the_torque_give_the_same_bits_but_the_sign_of_i_q(form: FitForm) -> None:
    """Even and odd bit for bit, at zero, in the domain and beyond it, with and without
    contraction.
    """
    reference = fitted(IPM, form=form, degree=3).reference
    end = float(reference.torque_max)
    torque = np.concatenate(
        [np.linspace(0.0, 1.1 * end, 301), [1e-45, 1e-38, 1e30, np.inf]]
    ).astype(np.float32)
    for fused in (False, True):
        (d, q), (d_less, q_less) = (
            reference.currents(signed, fused=fused) for signed in (torque, -torque)
        )
        np.testing.assert_array_equal(d.view(np.uint32), d_less.view(np.uint32))
        np.testing.assert_array_equal(q.view(np.uint32), (-q_less).view(np.uint32))
        assert not np.signbit(q).any()


@pytest.mark.parametrize("method", ["lagrange", "least-squares", "minimax"])
@pytest.mark.parametrize("segments", [1, 2])
def test_even_odd_has_no_odd_terms_and_its_torque_does_not_err_where_i_d_does(
    method: str, segments: int
) -> None:
    """At most two thirds of the torque error of polynomials of the same degree,
    although i_d errs by more.
    """
    settings_ = {"degree": 3, "segments": segments, "method": method, "torque_max": 200.0}
    fit = fitted(IPM, form="even-odd", **settings_)
    assert fit.d is not None
    assert fit.q is not None
    assert tuple(fit.d.coefficients[0, :2]) == (0.0, 0.0)
    assert fit.q.coefficients[0, 0] == fit.q.coefficients[0, 2] == 0.0
    assert (fit.d.degree, fit.q.degree) == (3, 4)
    np.testing.assert_allclose(fit.d.jumps(), 0.0, atol=1e-9)
    np.testing.assert_allclose(fit.q.jumps(), 0.0, atol=1e-9)
    plain = fitted(IPM, form="polynomial", **settings_)
    assert fit.errors.torque < 0.65 * plain.errors.torque
    assert fit.errors.i_d > plain.errors.i_d


def test_even_odd_matches_the_torque_as_well_as_its_i_q_can() -> None:
    """The torque error is what the minimax error of the matched i_q makes,
    by the machine's torque equation.
    """
    fit = fitted(IPM, form="even-odd", degree=3, segments=1, torque_max=200.0)
    assert fit.d is not None
    assert fit.q is not None
    torque = np.linspace(0.0, 200.0, 2001)
    i_d = fit.d(torque)
    per_ampere = 1.5 * IPM.pole_pairs * (IPM.psi_pm + (IPM.l_d - IPM.l_q) * i_d)
    error = (fit.q(torque) - torque / per_ampere) * per_ampere
    assert float(np.max(np.abs(error))) == pytest.approx(fit.errors.torque, rel=2e-3)


def test_even_odd_is_for_smooth_currents_only() -> None:
    with pytest.raises(InputError, match="even-odd needs currents that are smooth at zero torque"):
        fitted(RELUCTANCE, form="even-odd")
    with pytest.raises(
        InputError, match=r"fit.degree: form: even-odd needs degree 2 or more, got 1"
    ):
        fitted(IPM, form="even-odd", degree=1)
    with pytest.raises(InputError, match=r"fit.degree: flat_at_zero needs degree 2 or more, got 1"):
        fitted(IPM, flat_at_zero=True, degree=1)


@pytest.mark.parametrize("segments", [1, 3])
def test_flat_at_zero_leaves_out_the_linear_term_of_i_d_alone(segments: int) -> None:
    flat = fitted(IPM, form="polynomial", degree=3, segments=segments, flat_at_zero=True)
    assert flat.d is not None
    assert flat.q is not None
    assert flat.d.coefficients[0, 1] == 0.0 != flat.q.coefficients[0, 1]
    assert np.all(flat.d.coefficients[1:, 1] != 0.0)
    exact = fitted(IPM, form="torque-exact", degree=3, segments=1, flat_at_zero=True).errors
    assert (
        exact.loss_relative
        < fitted(IPM, form="torque-exact", degree=3, segments=1).errors.loss_relative
    )


@pytest.mark.parametrize("width", [16, 32])
def test_samples_of_integers_meet_both_sides_of_every_breakpoint(width: int) -> None:
    first, second = FixedSegment(0, 3, (5, 9), (1, 2)), FixedSegment(700, -7, (-40, 300), (3, 0))
    third = FixedSegment(450, 1, (2, 4), (1, 1))
    end = 1000 if width == 16 else 100_000
    reference = FixedReference(
        FixedPolynomial((first, third), width, end),
        FixedPolynomial((first, second), width, end),
        128.0,
        64.0,
    )
    codes = reference.samples(40) * 2.0 ** (width - 1) / 128.0
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)
    found = np.rint(codes).astype(int)
    assert (np.diff(found) > 0).all()
    assert reference.starts == (0, 450, 700)
    if width == 16:
        np.testing.assert_array_equal(found, np.arange(end + 1))
        return
    assert {0, 1, 449, 450, 699, 700, end} <= set(found)
    assert {round(k * end / 39) for k in range(40)} <= set(found)
    assert 40 < found.size <= 40 + 10 + 6
    unit = 64.0 / 2.0**31
    torque = reference.samples(40)[5:6]
    for code, current in zip(
        reference.codes(reference.nearest(torque)), reference.currents(torque), strict=True
    ):
        assert current[0] == pytest.approx(float(code[0]) * unit)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_square_root_is_held_at_both_ends_of_its_domain(sign: int) -> None:
    """i_q = sqrt(2 T) with its sign, i_d against it or along it; not-a-number is no torque."""
    reference = CurrentReference(ReluctanceClosedForm(np.float32(2.0), sign), np.float32(8.0))
    torque = np.array([0.0, 2.0, -2.0, 8.0, 9.0, -9.0, np.inf, -np.inf, np.nan], dtype=np.float32)
    expected = np.array([0.0, 2.0, -2.0, 4.0, 4.0, -4.0, 4.0, -4.0, 0.0])
    i_d, i_q = reference.currents(torque)
    np.testing.assert_array_equal(i_q, expected)
    np.testing.assert_array_equal(i_d, -sign * np.abs(expected))


def test_a_machine_whose_halves_differ_has_a_reference_for_each() -> None:
    """Each with its own end; not-a-number is no negative torque; the torques that both know end at
    the smaller one, and samples are those of both."""
    first = CurrentReference(Proportional(np.float32(0.5)), np.float32(6.0))
    other = CurrentReference(ReluctanceClosedForm(np.float32(2.0), 1), np.float32(4.5))
    for positive, negative in ((first, other), (other, first)):
        both = SignedReference(positive, negative)
        assert both.torque_max == np.float32(4.5)
        torque = np.array([2.0, -2.0, 5.0, -5.0, 9.0, -9.0, 0.0, np.nan], dtype=np.float32)
        found = np.array(both.currents(torque))
        for k, value in enumerate(torque):
            own = negative if value < 0.0 else positive
            np.testing.assert_array_equal(
                found[:, k], np.array(own.currents(torque[k : k + 1]))[:, 0]
            )
        samples = both.samples(40)
        assert (np.diff(samples) > 0.0).all()
        assert set(samples) == {*first.samples(40), *other.samples(40)}
        assert {float(samples[-1]), 4.5, 0.0} <= {*map(float, samples)}


def test_samples_meet_both_sides_of_every_breakpoint() -> None:
    """Evenly spaced, evenly over the decades, and the floats on either side of a breakpoint."""
    fit = fitted(IPM, form="polynomial", degree=2, breakpoints=(70.0,), method="lagrange")
    reference = in_floats(fit)
    samples, end = reference.samples(41), float(reference.torque_max)
    edge = np.float32(70.0)
    expected = np.concatenate(
        [np.linspace(0.0, end, 41), end * 10.0 ** np.linspace(-6.0, 0.0, 10)]
    ).astype(np.float32)
    beside = [edge, np.nextafter(edge, np.float32(0.0))]
    np.testing.assert_allclose(samples, np.unique(np.append(expected, beside)), rtol=1e-6)
    assert {float(x) for x in beside} <= {float(x) for x in samples}
    assert samples.max() == reference.torque_max
