"""What a capture is refused for, on either side of each limit, with the numbers that are said."""

from __future__ import annotations

import math
import re
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import pytest

from dqforge.machines.arrays import ComplexArray
from dqforge.machines.back_emf import checks
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.back_emf.columns import BemfSymmetry, remarks
from dqforge.machines.back_emf.harmonics import (
    HarmonicFit,
    Motion,
    fit_linear,
    quantisation_error,
    resolution,
    uncertainty,
)
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable

ORIGIN = Origin("scope.csv", np.arange(5, 105))
TURN = np.exp(-2j * np.pi / 3.0)


def refused(words: str) -> AbstractContextManager[object]:
    return pytest.raises(InputError, match=re.escape(words)) if words else nullcontext()


@pytest.mark.parametrize(
    ("periods", "samples", "words"),
    [
        (0.981, 8.01, ""),
        (0.979, 8.01, "about 0.98 electrical periods"),
        (1.0, 7.99, "about 8.0 samples in an electrical period"),
    ],
)
def test_a_period_and_eight_samples_of_it_are_enough(
    periods: float, samples: float, words: str
) -> None:
    with refused(words):
        checks.check_length(periods, samples, ORIGIN)


@pytest.mark.parametrize(("share", "words"), [(0.301, ""), (0.299, "the strongest has 30%")])
def test_a_line_stands_out(share: float, words: str) -> None:
    with refused(words):
        checks.check_line(share, ORIGIN)


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ((1.0, 1.0, 2.9), ""),
        ((1.0, 1.0, 3.1), "channel 3 reads 3.1 times more than the others"),
        ((1.0, 0.1, 1.0), "channel 2 reads 10.0 times less than the others"),
        ((1.0, 0.1, 1.0), "--scale 1,10,1, in a design scale: [1, 10, 1]"),
        ((5.0, 1.0, 1.1), "--scale 0.2,1,1"),
        ((1.0, 1.9, 9.0), "as 0.111, 0.211, 1"),
        ((1.0, 2.9), ""),
        ((1.0, 3.1), "as 0.323, 1"),
    ],
)
def test_probes_that_differ_by_three_are_named(sizes: tuple[float, ...], words: str) -> None:
    phasors: ComplexArray = np.array(sizes) * TURN ** np.arange(len(sizes))
    with refused(words):
        checks.check_ratios(phasors, ORIGIN)


@pytest.mark.parametrize(
    ("factor", "likely"),
    [(9.7, 10.0), (10.3, 10.0), (0.206, 0.2), (4.8, 5.0), (48.0, 50.0), (0.0098, 0.01)],
)
def test_a_factor_near_that_of_a_probe_is_it(factor: float, likely: float) -> None:
    assert checks._round_ratio(factor) == pytest.approx(likely)
    assert checks._round_ratio(1.08 * likely) == pytest.approx(1.08 * likely, rel=5e-3)


@pytest.mark.parametrize("sequence", [1.0, -1.0])
@pytest.mark.parametrize(
    ("lags", "words"),
    [
        ((139.0, 221.0), ""),
        ((141.0, 240.0), "channel 2 is {} degrees"),
        ((120.0, 219.0), "behind channel 1; three phases are 120 and 240"),
        ((300.0, 240.0), "a probe is connected the wrong way round"),
        ((121.0, 120.0), "channels 2 and 3 show the same voltage"),
        ((0.0, 240.0), "channels 1 and 2 show the same voltage"),
        ((120.0, 0.0), "channels 1 and 3 show the same voltage"),
        ((90.0, 200.0), "check what the probes were connected to"),
    ],
)
def test_phases_are_a_third_of_a_turn_apart(
    sequence: float, lags: tuple[float, float], words: str
) -> None:
    phasors = np.exp(-1j * sequence * np.radians([0.0, *lags]))
    said = words.format(f"{(sequence * lags[0]) % 360.0:.0f}")
    with refused(said):
        checks.check_displacements(phasors, ORIGIN)
    if not words:
        checks.check_displacements(phasors[:2], ORIGIN)


@pytest.mark.parametrize(("share", "wrong"), [(1.049, False), (0.951, False), (1.06, True)])
def test_a_speed_that_is_stated_fits_the_frequency(share: float, wrong: bool) -> None:
    speed = -share * 2.0 * np.pi * 50.0 / 4.0
    said = f"make {50.0 * share:.4g} Hz, but the capture has 50 Hz, i.e. 750 rpm or"
    with refused(said if wrong else ""):
        checks.check_speed(50.0, 4, speed, ORIGIN)
    checks.check_speed(50.0, None, speed, ORIGIN)
    checks.check_speed(50.0, 9, None, ORIGIN)
    with refused(f"or {4.0 / 1.06:.2f} pole pairs"):
        checks.check_speed(50.0, 4, 1.06 * 2.0 * np.pi * 50.0 / 4.0, ORIGIN)


def test_angles_cover_the_period() -> None:
    checks.check_coverage(np.pi / 4.0, ORIGIN)
    with refused("leave 46 degrees"):
        checks.check_coverage(np.radians(46.0), ORIGIN)


@pytest.mark.parametrize(("share", "found"), [(0.19, 0), (0.21, 1), (0.99, 1)])
def test_a_fundamental_is_larger_than_its_uncertainty(share: float, found: int) -> None:
    size = np.array([2.0, 3.0, 2.5])
    told = checks.check_certain(size, size * np.array([0.1, share, 0.05]), ORIGIN)
    assert len(told) == found
    assert not found or f"uncertain by {share:.0%}" in told[0]
    with refused("less than its uncertainty"):
        checks.check_certain(size, 1.01 * size, ORIGIN)


def test_noise_between_the_extremes_is_that_of_the_samples() -> None:
    rng = np.random.default_rng(2)
    slow = 10.0 * np.sin(np.linspace(0.0, 20.0, 20_000))
    noisy = slow + 0.05 * rng.standard_normal(slow.size)
    assert checks._noise_between(noisy) == pytest.approx(0.05, rel=0.05)
    assert checks._noise_between(np.array([0.0, 1.0, 0.0])) == 0.0


@pytest.mark.parametrize(("top", "noise", "words"), [(12.0, 0.0, ""), (9.0, 0.05, "clipped")])
def test_a_top_that_stands_still_is_clipped(top: float, noise: float, words: str) -> None:
    rng, samples = np.random.default_rng(1), 400
    sine = 10.0 * np.sin(2.0 * np.pi * np.arange(5 * samples) / samples)
    values = np.clip(sine + noise * rng.standard_normal(sine.size), -20.0, top)
    values = np.round(values / 0.02) * 0.02
    wide = Origin("scope.csv", np.arange(values.size))
    with refused(f"of channel 1 stand at {top:g} V: clipped" if words else ""):
        assert checks.check_clipping(values[None], samples, wide) == []


def test_a_flat_top_without_noise_is_told_and_not_refused() -> None:
    samples = 400
    sine = 10.0 * np.sin(2.0 * np.pi * np.arange(5 * samples) / samples)
    flat = np.round(np.minimum(sine, 9.0) / 0.02) * 0.02
    wide = Origin("scope.csv", np.arange(flat.size))
    (told,) = checks.check_clipping(flat[None], samples, wide)
    stands = np.count_nonzero(flat == flat.max())
    assert f"{stands} samples ({stands / flat.size:.1%}) of channel 1 stand at 9 V" in told


@pytest.mark.parametrize(
    ("line", "interval"),
    [
        ("Sampling rate: 500 kSa/s", 2e-6),
        ("Sample Rate,2.5 MS/s", 4e-7),
        ("Sampling Rate 1GSa/s", 1e-9),
        ("Sample rate,400000 Sa/s", 2.5e-6),
        ("sampling frequency = 8 kHz", 1.25e-4),
        ("Sampling rate 500 samples/s", 2e-3),
        ("Sample rate;250;Hz", 4e-3),
        ("Sample Rate 5 turns/s", None),
        ("Sample rate 5 Sa/div", None),
        ("Sample Interval,2.0E-6", 2e-6),
        ("XINCREMENT;4,0e-7;s", 4e-7),
        ("HResolution: 2 us", 2e-6),
        ("dt 5 ns/div", None),
        ("Increment,0.0002 , s", 2e-4),
        ("Sampling period = 3 ms", 3e-3),
        ("Time interval: 1 ms, 2 ms", None),
        ("Delta t=3 V", None),
        ("Sample Interval,0", None),
        ("Model,5 us", None),
    ],
)
def test_an_interval_is_read_with_the_whole_of_its_unit(line: str, interval: float | None) -> None:
    values = np.arange(12.0).reshape(3, 4) % 5.0
    table = TextTable(
        "scope.csv", ("CH1", "CH2", "CH3", "CH4"), ("V",) * 4, values, np.arange(3), (line,)
    )
    with refused("" if interval else "states no interval"):
        axis = checks.find_axis(table, None, None, None, ORIGIN)
        np.testing.assert_allclose(axis.values, np.arange(3) * (interval or 0.0))
    if interval:
        checks.find_axis(table, None, None, 1.0009 * interval, ORIGIN)
        with refused("but the file states"):
            checks.find_axis(table, None, None, 1.0011 * interval, ORIGIN)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("share", [0.99, 1.02])
def test_remarks_begin_at_their_limits_and_say_the_numbers(share: float, sign: float) -> None:
    """Of 3 % of asymmetry and offset, 2 degrees, 1 % of even harmonics, 5 % of noise and drift."""
    sizes = np.array([10.0, 20.0, 40.0])
    told = remarks(
        BemfSymmetry(0.03 * share, np.radians(2.0 * share), 0.01 * share, 0.0),
        sign * 0.03 * share * sizes * [1.0, 0.0, 0.5],
        0.05 * share * sizes * [0.9, 1.0, 0.1],
        sizes,
        sign * 0.05 * share,
        "V",
    )
    expected = [
        f"Phase a has an offset of {sign * 0.306:.3g} V ({sign * 3.1:+.1f}% of its",
        "Phase b has 1.02 V r.m.s. (5.1% of its",
        "by up to 3.1%.",
        "up to 2.0 degrees off",
        "Even harmonics make 1.0% of",
        f"changes by {sign * 5.1:+.1f}% over",
    ]
    assert len(told) == (len(expected) if share > 1.0 else 0)
    for text, words in zip(told, expected, strict=False):
        assert words in text


@pytest.mark.parametrize(("step", "noise"), [(0.02, 0.0), (0.02, 0.004), (0.02, 0.5)])
def test_rounding_errs_by_the_first_term_of_its_series(step: float, noise: float) -> None:
    """Mean of the rounding error against the mean of what is rounded: its fundamental."""
    total = math.hypot(noise, step / math.sqrt(12.0))
    found = float(quantisation_error(np.array([step]), np.array([total]))[0])
    before = noise / step
    assert found == pytest.approx(step / math.pi * math.exp(-2.0 * (math.pi * before) ** 2))
    if 0.0 < noise < step:
        drawn = noise * np.random.default_rng(4).standard_normal(200_000)
        level = np.linspace(0.0, step, 32, endpoint=False)
        error = [np.mean(np.round((x + drawn) / step) * step - x - drawn) for x in level]
        line = 2.0 * abs(np.mean(error * np.exp(-2j * np.pi * level / step)))
        assert line == pytest.approx(found, rel=0.01)
    assert quantisation_error(np.zeros(1), np.ones(1))[0] == 0.0


def test_a_converter_is_seen_where_few_values_occur() -> None:
    rng = np.random.default_rng(3)
    wave = np.sin(np.linspace(0.0, 30.0, 4000)) + 0.01 * rng.standard_normal(4000)
    assert resolution(np.round(wave / 0.04) * 0.04) == pytest.approx(0.04)
    assert resolution(wave) == 0.0
    assert resolution(np.sign(wave)) == 0.0


def drawn_fit(count: int, sigma: float, rng: np.random.Generator) -> HarmonicFit:
    angle = 2.0 * np.pi * np.arange(count) / count * 20.0
    motion = Motion(np.zeros(count), 1.0, 1.0, np.zeros(0), angle)
    shape = np.stack([3.0 * np.cos(angle), 2.0 * np.sin(2.0 * angle)])
    return fit_linear(motion, shape + sigma * rng.standard_normal(shape.shape), 4)


def test_the_disc_of_white_noise_is_that_of_its_chi_square() -> None:
    """Real and imaginary part err by s sqrt(2/N); of 2 N lines the 95 % disc is sqrt(2 ln 20)
    of that, but for the F distribution's 1/N.
    """
    rng, count, sigma = np.random.default_rng(6), 1000, 0.3
    inside, widths = [], []
    for _ in range(60):
        fit = drawn_fit(count, sigma, rng)
        radius, known = uncertainty(fit, 20.0)
        assert known
        apart = np.abs(fit.coefficients - [[3.0, 0.0, 0.0, 0.0], [0.0, -2j, 0.0, 0.0]])
        inside.append(apart < radius)
        widths.append(radius)
        np.testing.assert_allclose(fit.explained, [1.0 - 2.0 * 0.02 / 2.0, 1.0 - 0.045], atol=0.02)
    assert np.mean(widths) == pytest.approx(
        sigma * math.sqrt(4.0 * math.log(20.0) / count), rel=0.01
    )
    assert np.mean(inside) == pytest.approx(0.95, abs=0.04)
