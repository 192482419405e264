"""The eight segments of ST's MCSDK: least largest error, checked at every count."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.optimizer.firmware.st_keys import fitted_table, measured_table, table_currents

PUBLISHED = (
    2921,
    (-1412, -2572, -4576, -5200, -5564, -10551, -12664, -15567),
    (0, 105, 463, 632, 764, 3012, 4162, 5997),
)


def hyperbola(scale: float, largest: int) -> np.ndarray:
    """i_d of the linear machine whose psi/(2 (L_q - L_d)) is that many counts."""
    i_q = np.arange(largest + 1.0)
    return scale - np.sqrt(scale * scale + i_q * i_q)


def firmware(width: int, slopes: tuple[int, ...], offsets: tuple[int, ...], i_q: int) -> int:
    """The firmware's arithmetic in Python's integers, a count at a time."""
    size = abs(i_q)
    segment = min(size // width, 7)
    return ((slopes[segment] * size) >> 15) + offsets[segment]


def test_arithmetic_is_that_of_the_firmware() -> None:
    counts = np.array([-23687, -2922, -1, 0, 1, 2920, 2921, 20446, 20447, 23687])
    found = table_currents(*PUBLISHED, counts)
    assert found.tolist() == [firmware(*PUBLISHED, int(count)) for count in counts]


@pytest.mark.parametrize(("scale", "largest"), [(53664.7, 23687), (6000.0, 12000), (900.0, 800)])
def test_error_is_that_of_every_count(scale: float, largest: int) -> None:
    wanted = hyperbola(scale, largest)
    found = fitted_table(wanted)
    every = [firmware(found.width, found.slopes, found.offsets, i) for i in range(largest + 1)]
    assert found.error == pytest.approx(np.max(np.abs(every - wanted)), abs=1e-9)
    steps = np.abs(np.diff(every))[np.arange(1, 8) * found.width - 1]
    assert found.jump == np.max(steps)


def test_published_table_against_the_best_one() -> None:
    wanted = hyperbola(53664.7, 23687)  # the machine that fits the published table best
    theirs, ours = measured_table(*PUBLISHED, wanted), fitted_table(wanted)
    assert theirs.error > 250.0
    assert theirs.jump == 25
    assert ours.error < 10.5
    assert ours.jump <= 2


def test_no_other_line_of_integers_is_better() -> None:
    """Every slope and offset that could be, tried by force on each segment."""
    rng = np.random.default_rng(8)
    wanted = hyperbola(80.0, 159) + np.cumsum(rng.normal(0.0, 0.1, 160))
    found = fitted_table(wanted)
    edges = [*(found.width * np.arange(8)), 160]
    for segment in range(8):
        i_q = np.arange(edges[segment], edges[segment + 1])
        slopes = np.arange(-65535, 20000)[:, np.newaxis]
        least = np.inf
        for part in np.array_split(slopes, 16):
            rest = (part * i_q >> 15) - wanted[i_q]
            top, bottom = rest.max(axis=1), rest.min(axis=1)
            for offset in (np.floor(-0.5 * (top + bottom)), np.ceil(-0.5 * (top + bottom))):
                error = np.maximum(np.abs(top + offset), np.abs(bottom + offset))
                least = min(least, float(error.min()))
        mine = np.max(np.abs(found.currents(i_q) - wanted[i_q]))
        assert mine <= least + 1e-9


def test_no_other_width_is_better_by_half_a_count() -> None:
    wanted = hyperbola(120.0, 299)
    found = fitted_table(wanted)
    from dqforge.optimizer.firmware import st_keys as st_mtpa

    others = [st_mtpa._with_width(wanted, width).error for width in range(20, 42)]
    assert found.error <= min(others) + 0.5


def test_a_straight_line_and_a_short_one() -> None:
    assert fitted_table(np.zeros(1000)).error == 0.0
    assert fitted_table(np.zeros(1000)).width == 125
    assert fitted_table(-np.arange(6.0)).error < 1.0
