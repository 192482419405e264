"""What a capture is refused for, on either side of each limit, with the numbers that are said."""

from __future__ import annotations

import re
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import pytest

from dqforge.machines.arrays import ComplexArray
from dqforge.machines.back_emf import checks
from dqforge.machines.back_emf.checks import Origin
from dqforge.machines.errors import InputError

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
