"""Range analysis of the control functions: sound against extremes, tight where it can be,
and its refusals.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ModulationName
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.fixed_control.codes import FIXED_MODULATORS
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.fixed_control.ranges import (
    control_ranges,
    dead_band,
    finest,
    pi_ranges,
    require,
    with_fraction,
)
from dqforge.optimizer.fixed_control.transforms import FixedPi, Pi, pi_gains, pi_step
from dqforge.optimizer.loops.integer_gains import FixedGain, given, quantise
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range, Ranges, scaled
from dqforge.reports.control.fixed_model import row_inputs, row_results


def salient() -> Design:
    """The salient machine with a base speed that holds its largest speed."""
    design = make_design(IPM)
    return replace(
        design, control=replace(design.control, bases=replace(design.control.bases, speed=1000.0))
    )


@cache
def gains_of(design: Design) -> GainSet:
    """Gains of a design, tuned once."""
    return solve_gains(design)


def fitted(design: Design, width: int, modulation: ModulationName = "svpwm") -> FixedControlFit:
    gains = gains_of(design)
    changed = replace(design, operation=replace(design.operation, modulation=modulation))
    return fit_control(changed, (gains.i_d, gains.i_q, gains.speed), gains.observer, width)


@pytest.mark.parametrize("seed", range(4))
def test_every_operation_on_ranges_holds_that_on_numbers(seed: int) -> None:
    """Exhaustive for small ranges: the hull of all results, which is also reached by products,
    sums and shifts.
    """
    generator = np.random.default_rng(seed)
    exact = Integers()
    for _ in range(60):
        a_low, b_low = (int(x) for x in generator.integers(-9, 6, 2))
        a, b = (Range(low, low + int(generator.integers(0, 9))) for low in (a_low, b_low))
        x, y = np.meshgrid(np.arange(a.low, a.high + 1), np.arange(b.low, b.high + 1))
        ranges = Ranges(16)
        limit, positive = Range(abs(b.low), abs(b.low) + 3), Range(1, 1 + abs(b.low))
        pairs = [
            (ranges.product("p", a, b), x * y),
            (ranges.total("s", a, b), x + y),
            (ranges.negative(a), -x),
            (ranges.shifted(a, 2), x >> 2),
            (ranges.clamp(a, -3, 4), np.clip(x, -3, 4)),
        ]
        for found, values in pairs:
            assert (found.low, found.high) == (values.min(), values.max())
        u, v = np.meshgrid(np.arange(a.low, a.high + 1), np.arange(limit.low, limit.high + 1))
        within = exact.within(u, v)
        found = ranges.within(a, limit)
        assert (found.low, found.high) == (within.min(), within.max())
        u, v = np.meshgrid(np.arange(a.low, a.high + 1), np.arange(positive.low, positive.high + 1))
        quotient = exact.quotient("q", u, v)
        found = ranges.quotient("q", a, positive)
        assert (found.low, found.high) == (quotient.min(), quotient.max())
        chosen = ranges.choose(ranges.at_least(a, b), a, b)
        values = exact.choose(exact.at_least(x, y), x, y)
        assert chosen.low <= values.min()
        assert values.max() <= chosen.high


def test_integer_roots_are_exact() -> None:
    o = Integers()
    small = np.arange(200_000)
    root = o.root(small)
    assert np.all((root * root <= small) & ((root + 1) * (root + 1) > small))
    near = np.arange(2**31 - 500, 2**31 - 1, dtype=np.int64)
    for offset in (-1, 0, 1):
        squares = near * near + offset
        assert np.array_equal(o.root(squares), near - (offset < 0))


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", ["paper000-ipmsm-100kw", "paper001-pmsm-bench", "abb-syrm-6k7"])
def test_extremes_stay_within_what_is_proven(name: str, width: int) -> None:
    """All functions on rows at the ends of every word; products come near their proven ends."""
    control = fitted(catalogue.load(name), width).control
    seen: dict[str, tuple[int, int]] = {}
    row_results(control, row_inputs(control, 60_000, 3), Integers(seen))
    proven: dict[str, tuple[int, int]] = {}
    for reach in control_ranges(control):
        key = reach.name.split(": ", 1)[1]
        low, high = proven.get(key, (0, 0))
        proven[key] = (min(low, reach.range.low), max(high, reach.range.high))
        assert reach.fits
    assert set(seen) == set(proven)
    for key, (low, high) in seen.items():
        assert proven[key][0] <= low, key
        assert high <= proven[key][1], key
    for key in ("kp e", "ki t_s e", "clarke: b - c", "limited - output"):
        assert max(map(abs, seen[key])) > 0.95 * max(map(abs, proven[key])), key


def test_the_corners_of_a_controller_are_its_range() -> None:
    """Brute force over all corners of error, integral and limit: output and
    integral reach the proven ends.
    """
    pi = FixedPi(
        given(3.7, 12),
        quantise(0.2 * 2.0**11, 16, 65_535),
        quantise(0.05 * 2.0**11, 16, 32_768),
        11,
    )
    proven = {
        name.removeprefix("x: "): reach
        for name, reach in pi_ranges(16, "x", pi, "parallel").reaches.items()
    }
    seen: dict[str, tuple[int, int]] = {}
    top = 32_767
    corners = itertools.product((-65_535, 65_535), (-top << 11, top << 11), (0, top))
    for error, integral, limit in corners:
        past, *given_now = (np.array(x, dtype=np.int64) for x in (integral, error, limit))
        pi_step(Integers(seen), pi_gains(16, pi), Pi(past), *given_now)
    for name in ("kp e", "ki t_s e", "integral + ki t_s e", "kp e + integral"):
        assert seen[name] == (proven[name].range.low, proven[name].range.high), name


@pytest.mark.thinned
@pytest.mark.parametrize("modulation", FIXED_MODULATORS)
def test_all_modulators_are_proven(modulation: ModulationName) -> None:
    for width in (16, 32):
        assert all(reach.fits for reach in fitted(salient(), width, modulation).reaches)


def with_gain(kp: float, formats: tuple[int, int]) -> Design:
    """A loop whose gain per unit is kp.

    Nothing is asked of its margin, so that only the integers can refuse it.
    """
    design = make_design(SURFACE)
    bases = replace(design.control.bases, current=60.0)
    physical = kp * bases.voltage / bases.current
    loop = CurrentLoopSettings(
        "given", kp=physical, ki=0.01 * physical / 1e-5, min_phase_margin=0.0, q_formats=formats
    )
    return replace(
        design, control=replace(design.control, bases=bases, current_loop=loop, speed_loop=None)
    )


def test_a_gain_that_is_too_large_is_refused_by_name() -> None:
    """Per-unit 20000 fits its word in Q0, but kp e and the integral together do not fit 32 bits."""
    pi = FixedPi(given(20_000.0, 0), given(0.5, 15), quantise(0.1, 16, 32_768), 0)
    assert finest(16, "i_q", pi, "velocity", 15) is None
    found = pi_ranges(16, "i_q", pi, "velocity")
    with pytest.raises(
        NoSolutionError,
        match=r"'i_q: kp e - last' can reach 2621400000, int32_t ends at 2147483647",
    ):
        require(found)
    most = FixedPi(given(32_767.0, 0), given(20_000.0, 0), quantise(0.1, 16, 32_768), 0)
    with pytest.raises(NoSolutionError, match=r"'i_q: kp e \+ integral' can reach 3458"):
        require(pi_ranges(16, "i_q", most, "parallel"))


def test_a_design_with_too_large_a_gain_is_refused_with_exit_code_1() -> None:
    from dqforge.optimizer.loops.loop_gains import analyse_current_loop

    design = with_gain(20_000.0, (0, 6))
    assert design.control.current_loop.kp is not None
    assert design.control.current_loop.ki is not None
    settings, machine = design.control.current_loop, design.machine
    loops = [
        analyse_current_loop(
            machine.r_s, machine.l_d, design.control.t_s, settings.kp or 0.0,
            settings.ki or 0.0, "given", name,
            respond=False,
        )
        for name in ("i_d", "i_q")
    ]  # fmt: skip
    with pytest.raises(
        NoSolutionError, match=r"'i_d: kp e - last' can reach .* no format of 16 bits"
    ) as caught:
        fit_control(design, (loops[0], loops[1], None), None, 16)
    assert caught.value.exit_code == 1


def test_the_product_of_the_thesis_can_overflow_and_ours_cannot() -> None:
    """20000 (e[k] - e[k-1]) of paper 001 needs 33 bits when reference and speed swing together.

    Kp e does not.
    """
    kp = given(19.53125, 10)
    ranges = Ranges(16)
    error = Range(-65_535, 65_535)
    change = ranges.total("e - e1", error, ranges.negative(error))
    ranges.product("kp (e - e1)", ranges.const(kp.mantissa), change)
    worst = ranges.overflowing()
    assert worst is not None
    assert worst.name == "kp (e - e1)"
    pi = FixedPi(kp, given(2.44140625, 10), quantise(0.125, 16, 32_768), 0)
    assert pi_ranges(16, "speed", pi, "velocity").overflowing() is None


@pytest.mark.parametrize("rounding", [True, False])
def test_dead_band_by_trying_every_error(rounding: bool) -> None:
    generator = np.random.default_rng(8)
    error = np.arange(-65_535, 65_536)
    for mantissa, shift in zip(
        generator.integers(1, 400, 40), generator.integers(0, 20, 40), strict=True
    ):
        gain = FixedGain(int(mantissa), int(shift), float(mantissa) * 2.0**-shift)
        moved = (
            scaled(Integers(), "x", gain, error)
            if rounding
            else (error * gain.mantissa) >> gain.shift
        )
        found = dead_band(gain, rounding=rounding)
        up, down = error[(moved != 0) & (error > 0)], error[(moved != 0) & (error < 0)]
        assert found.positive == (up.min() if up.size else found.positive)
        assert found.negative == (-down.max() if down.size else found.negative)


def test_the_program_of_the_thesis_has_a_dead_band_of_half_an_ampere() -> None:
    """26 in Q15 on an integral of one word, rounded downwards: 1261 codes of 12.8 A/32768 upwards,
    1 downwards.
    """
    found = dead_band(given(26 / 2**15, 15), rounding=False)
    assert (found.positive, found.negative) == (1261, 1)
    fit = fitted(catalogue.load("paper001-pmsm-bench"), 16)
    assert all(band.largest == 1 for band in fit.dead_bands.values())
    with pytest.raises(NoSolutionError, match="moves nothing"):
        dead_band(FixedGain(0, 0, 0.0))


def test_no_more_fractional_bits_would_fit() -> None:
    """The state of every loop is as fine as its word allows."""
    for width in (16, 32):
        control = fitted(salient(), width).control
        for name, forms in control.loops.items():
            for form, pi in forms.items():
                finer = with_fraction(pi, 1)  # the same integers, one bit more
                if finer is None or pi.fraction == width - 2:
                    continue
                more = replace(finer, fraction=pi.fraction + 1)
                assert pi_ranges(width, name, more, form).overflowing() is not None


def test_a_range_without_an_integer_is_refused() -> None:
    assert Range(3, 3).largest == 3
    with pytest.raises(ValueError, match="no integer lies from 3 to 0"):
        Range(3, 0)
