"""Fixed point: scales that cannot overflow, integers as good as an exhaustive search finds,
errors over all codes.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, SURFACE

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import NumberFormat
from dqforge.optimizer.current_reference.fit import ReferenceFit, fit_reference
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve
from dqforge.optimizer.curves.integer_polynomial import (
    _BROKEN,
    CodeScale,
    FixedPolynomial,
    FixedSegment,
    _changes,
    _rounded,
    _safe_scales,
    _Segment,
    _with_pairs,
    fit_fixed,
    in_code_segments,
    overflows,
)
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.steps.integer_arithmetic import Integers

SCALES = (215.0, 283.0)


def fitted(number_format: NumberFormat, degree: int = 3, **changes: object) -> ReferenceFit:
    settings = FitSettings(
        form="polynomial", degree=degree, format=number_format, full_scale=SCALES
    )
    return fit_reference(CurrentChoice(IPM, "mtpa", IPM.i_max), replace(settings, **changes))  # type: ignore[arg-type]


def in_integers(fit: ReferenceFit) -> FixedReference:
    assert isinstance(fit.reference, FixedReference)
    return fit.reference


def steps_in_exact_integers(segment: FixedSegment, x: int, width: int) -> tuple[int, int]:
    """Result and the longest product or sum in bits, by Python's unbounded integers."""
    value, bits = segment.leading, 0
    for constant, shift in zip(segment.constants, segment.shifts, strict=True):
        product = value * x
        bits = max(bits, product.bit_length() + 1, (product + constant).bit_length() + 1)
        value = (product + constant) >> shift
        assert value.bit_length() < 32
    assert bits <= 2 * width
    return value, bits


@pytest.mark.thinned
@pytest.mark.parametrize("number_format", ["q15", "q31"])
def test_no_input_overflows_and_the_accumulators_are_used(number_format: NumberFormat) -> None:
    """Stepped in unbounded integers: nothing leaves its word, and the best
    step fills it to two bits.
    """
    reference = in_integers(fitted(number_format, 4))
    longest = 0
    for polynomial in (reference.d, reference.q):
        assert polynomial is not None
        assert not polynomial.overflows()
        for segment, length in zip(polynomial.segments, polynomial.lengths(), strict=True):
            local = np.linspace(0, length, 2001).astype(int)
            found = polynomial.evaluate(segment.start + local)
            for x, result in zip(local.tolist(), found.tolist(), strict=True):
                value, bits = steps_in_exact_integers(segment, x, reference.width)
                longest = max(longest, bits)
                assert value == result
    assert longest >= 2 * reference.width - 2


def test_a_segment_of_a_few_codes_shifts_right_alone() -> None:
    """The first segment of a root: large coefficients that cancel, whose scales are lowered."""
    random = np.random.default_rng(30)
    scale = CodeScale(1.0, 1.0, 16)
    for degree, last in itertools.product((3, 4, 5), range(2, 8)):
        nodes = np.linspace(0.0, last, degree + 1)
        wanted = 270.0 * np.sqrt(nodes) * random.uniform(0.9, 1.1, nodes.size)
        row = np.linalg.solve(np.vander(nodes, increasing=True), wanted)
        in_units = row * scale.one ** (np.arange(degree + 1) - 1.0)
        real = PiecewisePolynomial(np.array([0.0, (last + 0.5) / scale.one]), in_units[np.newaxis])
        exact = np.polynomial.Polynomial(in_units)
        found = fit_fixed(real, exact, scale, exact_at_zero=True, continuous=False)
        codes = np.arange(last + 1)
        assert min(found.segments[0].shifts) >= 0
        assert not found.overflows()
        assert np.max(np.abs(found.evaluate(codes) - exact(codes / scale.one) * scale.one)) <= 1.0


def test_a_polynomial_that_no_integer_holds_is_refused() -> None:
    row = np.array([[0.0, 1e9]])
    real = PiecewisePolynomial(np.array([0.0, 1.0]), row)
    with pytest.raises(NoSolutionError, match=r"coefficient of .* overflows .* fit\.degree"):
        fit_fixed(
            real,
            lambda x: 1e9 * x,
            CodeScale(1.0, 1.0, 16),
            exact_at_zero=False,
            continuous=False,
        )


def test_ranges_enclose_what_happens_and_overflow_is_seen() -> None:
    segment = FixedSegment(0, -20000, (700_000_000, 5_000), (14, 16))
    x = np.arange(30_001)
    product = np.array([-20000]) * x + 700_000_000
    inner = product >> 14
    last = inner * x + 5_000
    proven, results = segment.ranges(30_000, 16)
    products, sums, values = (proven.reaches[n].range for n in ("product", "sum", "value"))
    assert products.low <= min((x * -20000).min(), (inner * x).min())
    assert products.high >= max((x * -20000).max(), (inner * x).max())
    assert sums.low <= min(product.min(), last.min())
    assert sums.high >= max(product.max(), last.max())
    assert values.low <= inner.min()
    assert values.high >= inner.max()
    found = last >> 16
    assert results.low <= found.min()
    assert found.max() <= results.high <= found.max() + 0.05 * np.ptp(found)
    assert not overflows(segment, 30_000, 16)
    assert overflows(segment, 120_000, 16)
    assert overflows(replace(segment, leading=20000, constants=(2**31 - 1, 0)), 30_000, 16)


def exhaustive_best(
    curve: FloatArray, width: int, degree: int, shifts: tuple[int, ...], near: FixedSegment
) -> float:
    """Least largest error over every leading coefficient and constant around a good solution.

    No constant at zero.
    """
    x = np.arange(curve.size)
    best = np.inf
    half = 1 << (shifts[-1] - 1)
    spans = [range(near.leading - 12, near.leading + 13)]
    for constant, shift in zip(near.constants[:-1], shifts[:-1], strict=True):
        # A change by less than 1/64 of what the shift leaves moves no result
        # by more than rounding does.
        step = max(1 << (shift - 6), 1)
        spans.append(range(constant - 96 * step, constant + 97 * step, step))
    lasts = range(half - 3 * half // 4, half + 3 * half // 4, max(half // 16, 1))
    for combination in itertools.product(*spans):
        value = np.full(x.shape, combination[0], dtype=np.int64)
        for constant, shift in zip(combination[1:], shifts[:-1], strict=True):
            value = (value * x + constant) >> shift
        product = value * x
        for last in lasts:
            best = min(best, float(np.max(np.abs(((product + last) >> shifts[-1]) - curve))))
    return best


@pytest.mark.thinned
@pytest.mark.parametrize(("degree", "width"), [(1, 8), (1, 10), (2, 8)])
@pytest.mark.parametrize("bend", [0.3, 1.0, 2.5])
def test_search_is_within_five_percent_of_an_exhaustive_one(
    degree: int, width: int, bend: float
) -> None:
    """Words small enough that all integers around the optimum can be tried."""
    scale = CodeScale(1.0, 1.0, width)

    def curve(x: FloatArray) -> FloatArray:
        return np.asarray(0.8 * np.expm1(bend * x) / np.expm1(bend))

    side = SideConditions(exact_at_zero=True, continuous=True)
    real = fit_curve(curve, np.array([0.0, 1.0]), degree, "minimax", side)
    found = fit_fixed(real, curve, scale, exact_at_zero=True, continuous=True)
    codes = np.arange(found.end + 1)
    exact = curve(scale.arguments(codes)) * scale.one
    error = float(np.max(np.abs(found.evaluate(codes) - exact)))
    segment = found.segments[0]
    assert error <= 1.05 * exhaustive_best(exact, width, degree, segment.shifts, segment)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [2, 3, 4])
def test_sixteen_bits_cost_less_than_one_code(degree: int) -> None:
    """All torques: 16 bits lie at most 0.8 codes above 32 bits, and these are the real optimum."""
    small, large, real = fitted("q15", degree), fitted("q31", degree), fitted("float32", degree)
    code = SCALES[1] / 2.0**15
    for axis in ("i_d", "i_q"):
        assert getattr(large.errors, axis) == pytest.approx(getattr(real.errors, axis), rel=2e-2)
        assert getattr(small.errors, axis) <= getattr(real.errors, axis) + 0.8 * code
    assert small.errors.samples == in_integers(small).end + 1


def test_directions_of_the_search_change_no_result_by_more_than_one_code() -> None:
    """Chebyshev polynomials on the segment: cos(n arccos u), u from -1 to 1."""
    x = np.linspace(0.0, 300.0, 61)
    for order, powers in enumerate(_changes(4, 300)):
        values = np.polynomial.Polynomial(powers)(x)
        inner = np.clip(x / 150.0 - 1.0, -1.0, 1.0)
        assert values == pytest.approx(np.cos(order * np.arccos(inner)), abs=1e-9)


def test_pairs_of_directions_are_their_sums_and_differences() -> None:
    found = _with_pairs(np.array([[1.0, 0.0], [0.0, 2.0]]))
    assert found.tolist() == [[1.0, 0.0], [0.0, 2.0], [1.0, 2.0], [1.0, -2.0]]


def test_search_beats_rounding() -> None:
    """Against coefficients that were only rounded, at the same scales."""
    reference = in_integers(fitted("q15", 4))
    fit = fitted("q15", 4)
    assert fit.q is not None
    scale, choice = reference.scale, CurrentChoice(IPM, "mtpa", IPM.i_max)
    codes = np.arange(reference.end + 1)
    exact = choice.currents(scale.arguments(codes))[1] * scale.one / scale.result
    plain = []
    for segment, row in zip(reference.q.segments, fit.q.coefficients, strict=True):
        levels = np.cumsum([0, *segment.shifts[::-1]])
        coefficients = scale.in_codes(row)
        constants = [
            round(float(c) * 2.0 ** int(level)) + ((1 << shift) >> 1)
            for c, level, shift in zip(
                coefficients[-2::-1], levels[:0:-1], segment.shifts, strict=True
            )
        ]
        leading = round(float(coefficients[-1]) * 2.0 ** int(levels[-1]))
        plain.append(FixedSegment(segment.start, leading, tuple(constants), segment.shifts))
    rounded = FixedPolynomial(tuple(plain), 16, reference.end).evaluate(codes)
    assert np.max(np.abs(reference.q.evaluate(codes) - exact)) < 0.95 * np.max(
        np.abs(rounded - exact)
    )


def test_zero_symmetry_seams_and_saturation() -> None:
    reference = in_integers(fitted("q15", 3))
    codes = np.array([0, 1, -1, 32767, -32768, reference.end, -reference.end])
    i_d, i_q = reference.codes(codes)
    assert i_d[0] == i_q[0] == 0
    np.testing.assert_array_equal(i_d[1::2], i_d[2::2])
    np.testing.assert_array_equal(i_q[1::2], -i_q[2::2])
    assert i_q[3] == i_q[5]
    for polynomial in (reference.d, reference.q):
        assert polynomial is not None
        for start in polynomial.starts[1:]:
            before, after = polynomial.evaluate(np.array([start - 1, start]))
            assert abs(after - before) <= 4
    tight = fitted("q15", 3, full_scale=(206.0, float(np.max(np.abs(IPM_ENDS)))))
    assert np.max(np.abs(in_integers(tight).codes(np.arange(32768)))) <= 32767


IPM_ENDS = CurrentChoice(IPM, "mtpa", IPM.i_max).currents(
    np.array([CurrentChoice(IPM, "mtpa", IPM.i_max).largest_torque()])
)


def test_straight_line_needs_one_step() -> None:
    choice = CurrentChoice(SURFACE, "mtpa", SURFACE.i_max)
    fit = fit_reference(
        choice, FitSettings(form="polynomial", format="q15", full_scale=(25.0, 50.0))
    )
    reference = in_integers(fit)
    assert reference.d is None
    assert len(reference.q.segments[0].shifts) == 1
    assert fit.errors.i_q <= 0.8 * 50.0 / 2**15


@pytest.mark.parametrize(
    ("machine", "scales", "form", "message"),
    [
        (
            IPM,
            (150.0, 283.0),
            "polynomial",
            r"control.per_unit.torque: 150 N m .* write torque: 210 N m",
        ),
        (
            IPM,
            (215.0, 100.0),
            "polynomial",
            r"control.per_unit.current: 100 A .* write current: 260 A",
        ),
        (
            IPM,
            SCALES,
            "torque-exact",
            "divides or takes a root, which q15 does not offer; write form: polynomial",
        ),
        (RELUCTANCE, (30.0, 22.0), "closed-form", "write form: polynomial"),
    ],
)
def test_what_fixed_point_cannot_hold_is_refused(
    machine: LinearMachine, scales: tuple[float, float], form: str, message: str
) -> None:
    settings = FitSettings(form=form, format="q15", full_scale=scales)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=message):
        fit_reference(CurrentChoice(machine, "mtpa", machine.i_max), settings)


@pytest.mark.parametrize(
    ("seams", "at_zero", "raised"),
    [
        ((None, None), False, 0.0),
        ((7.4, 20.6), False, 0.0),  # either integer beside a seam
        ((9.0, None), False, 2.0),
        ((5.0, 24.5), False, 6.5),
        ((None, 19.0), True, 8.0),
    ],
)
def test_a_broken_seam_weighs_by_how_far_it_is_broken(
    seams: tuple[float | None, float | None], at_zero: bool, raised: float
) -> None:
    """The segment is 7 + x on its codes 0 to 13; the wanted ones lie up to 3 beside it."""
    local = np.array([0, 5, 9, 0, 13])
    task = _Segment(100, 13, 16, [0], local, np.array([7.5, 15.0, 15.0]), seams, at_zero)
    segment = FixedSegment(100, 1, (7,), (0,))
    np.testing.assert_array_equal(segment.evaluate(local), 7 + local)
    assert task.error(segment) == pytest.approx(3.0 + _BROKEN * raised)


def test_results_beyond_full_scale_are_held_at_either_end() -> None:
    """Two segments, each beyond an end, beside a polynomial that holds."""
    steep = FixedPolynomial(
        (FixedSegment(0, 3, (-40_000,), (0,)), FixedSegment(20_000, -7, (30_000,), (0,))),
        16,
        32_000,
    )
    flat = FixedPolynomial(
        (FixedSegment(0, 1, (-9,), (0,)), FixedSegment(20_000, -1, (30_000,), (0,))), 16, 32_000
    )
    assert steep.saturates()
    assert not flat.saturates()
    x = np.arange(32_001)
    for made, slopes, starts in (
        (steep, (3, -7), (-40_000, 30_000)),
        (flat, (1, -1), (-9, 30_000)),
    ):
        line = np.where(x < 20_000, starts[0] + slopes[0] * x, starts[1] + slopes[1] * (x - 20_000))
        np.testing.assert_array_equal(made.evaluate(x), np.clip(line, -32_767, 32_767))
    both = in_code_segments(Integers(), {"a": steep, "b": flat}, x)
    np.testing.assert_array_equal(both[0], steep.evaluate(x))
    np.testing.assert_array_equal(both[1], flat.evaluate(x))


@pytest.mark.parametrize("width", [16, 32])
def test_scales_are_as_large_as_words_and_products_permit(width: int) -> None:
    """No scale overflows, and no scale could be two larger: one more, and a quarter less room."""
    rng = np.random.default_rng(width)
    for degree in (1, 2, 4):
        length = int(rng.integers(300, 2**15))
        row = (
            rng.normal(size=degree + 1)
            * 0.3
            * 2.0 ** (width - 1)
            / float(length) ** np.arange(degree + 1)
        )
        scales = _safe_scales(row, length, width)
        assert not overflows(_rounded(row, scales, 0), length, width)
        assert scales == sorted(scales)
        top = [*scales[:-1], scales[-1] + 2]
        shift = top[-1] - (top[-2] if degree > 1 else 0)
        assert overflows(_rounded(row, top, 0), length, width) or shift > 2 * width - 2


def test_integers_of_a_polynomial_are_its_scaled_coefficients_with_half_of_what_is_dropped() -> (
    None
):
    """Read back, the coefficients are the real ones within half an integer of their scale."""
    row = np.array([1234.56, -7.89, 0.0321])
    segment = _rounded(row, [5, 9], 40)
    assert (segment.start, segment.shifts) == (40, (4, 5))
    assert segment.leading == round(0.0321 * 2**9)
    assert segment.constants == (round(-7.89 * 2**9) + 2**3, round(1234.56 * 2**5) + 2**4)
