"""Closed margins of current loops against roots in long arithmetic and against the scan."""

from __future__ import annotations

from dataclasses import dataclass, fields

import mpmath as mp
import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.loops.loop_gains import analyse_current_loop
from dqforge.optimizer.loops.observed_margins import (
    CurrentMargins,
    current_loops,
    current_margins,
    has_closed_margins,
)
from dqforge.optimizer.loops.pi_methods import batch_margins, close_loops, current_plants
from dqforge.optimizer.loops.plants import current_loop
from dqforge.optimizer.sampled_systems import LEAST_SHARE, LoopMargins, loop_margins

NAMES = tuple(part.name for part in fields(LoopMargins) if part.name != "crossovers")


@dataclass(frozen=True)
class Drawn:
    """N loops: Ohm, H, s, V/A, V/(A s), gain of the voltage."""

    r_s: FloatArray
    inductance: FloatArray
    t_s: FloatArray
    kp: FloatArray
    ki: FloatArray
    gain: FloatArray

    def margins(self) -> CurrentMargins:
        return current_margins(
            current_loops(self.r_s, self.inductance, self.t_s, self.kp, self.ki, self.gain)
        )


def drawn(count: int, seed: int, slowest: float = -2.0, least: float = -1.0) -> Drawn:
    """Loops of which some are unstable, some slow against their sampling; every tenth without
    resistance.
    """
    g = np.random.default_rng(seed)
    r_s = 10.0 ** g.uniform(-3.0, 1.0, count)
    inductance, t_s = r_s * 10.0 ** g.uniform(-4.0, -1.0, count), 10.0 ** g.uniform(-5, -3, count)
    r_s[::10] = 0.0
    kp = inductance / t_s * 10.0 ** g.uniform(slowest, 0.1, count)
    return Drawn(
        r_s, inductance, t_s, kp, kp * 10.0 ** g.uniform(least, 4.0, count), np.ones(count)
    )


def relative(found: float, wanted: float) -> float:
    """Deviation over the size; 0 where both are the same, nan and inf too."""
    if found == wanted or (np.isnan(found) and np.isnan(wanted)):
        return 0.0
    return abs(found - wanted) / abs(wanted)


# --- against the scan ---------------------------------------------------------------------------


def test_random_loops_have_the_margins_of_the_scan() -> None:
    loops, worst = drawn(240, 11), dict.fromkeys(NAMES, 0.0)
    found, unstable = loops.margins(), 0
    for k in range(240):
        single = current_loop(
            loops.r_s[k], loops.inductance[k], loops.t_s[k], loops.kp[k], loops.ki[k]
        )
        wanted, stable = loop_margins(single.open_loop), bool(abs(single.closed.poles[0]) < 1.0)
        assert stable == found.stable[k]
        unstable += not stable
        got = found.of(k)
        assert got.crossovers.size == wanted.crossovers.size
        for name in NAMES:
            deviation = relative(getattr(got, name), getattr(wanted, name))
            worst[name] = max(worst[name], deviation)
    assert 10 < unstable < 120
    # What is left are the roundings of the scan: its crossings of slow loops.
    assert max(worst.values()) < 2e-10
    assert worst["gain_margin"] < 1e-12
    assert worst["max_sensitivity"] < 1e-12


def test_the_voltage_s_gain_is_that_of_the_batch() -> None:
    loops = drawn(40, 5)
    gain = np.random.default_rng(6).uniform(0.8, 1.2, 40)
    found = current_margins(
        current_loops(loops.r_s, loops.inductance, 1e-4, loops.kp, loops.ki, gain)
    )
    batch = close_loops(current_plants(loops.r_s, loops.inductance, 1e-4, gain), loops.kp, loops.ki)
    wanted = batch_margins(batch)
    np.testing.assert_array_equal(found.stable, wanted.radius < 1.0)
    for name in ("crossover", "phase_margin", "gain_margin", "delay_margin"):
        held = found.stable
        np.testing.assert_allclose(
            getattr(found, name)[held], getattr(wanted, name)[held], rtol=1e-7, err_msg=name
        )


def test_negative_resistances_of_compensated_dead_time() -> None:
    r_s = np.array([-0.05, -0.5, -1.0])
    kp, ki = np.array([4.0, 4.0, 2.0]), np.array([50.0, 900.0, 2000.0])
    found = current_margins(current_loops(r_s, 2e-3, 1e-4, kp, ki))
    for k in range(3):
        single = current_loop(r_s[k], 2e-3, 1e-4, kp[k], ki[k])
        wanted, got = loop_margins(single.open_loop), found.of(k)
        assert bool(abs(single.closed.poles[0]) < 1.0) == found.stable[k]
        for name in NAMES:
            assert relative(getattr(got, name), getattr(wanted, name)) < 1e-10, name


# --- against long arithmetic --------------------------------------------------------------------

Polynomial = list[mp.mpf]


def product(one: Polynomial, two: Polynomial) -> Polynomial:
    found = [mp.mpf(0)] * (len(one) + len(two) - 1)
    for j, x in enumerate(one):
        for k, y in enumerate(two):
            found[j + k] += x * y
    return found


def on_circle(polynomial: Polynomial) -> list[mp.mpf]:
    """Angles between 0 and pi of the roots on the unit circle; multiplicity at 1 is left out."""
    first = next(k for k, value in enumerate(polynomial) if value)
    kept = polynomial[first : len(polynomial) - first]  # zeros at both ends alike
    roots = mp.polyroots(kept, maxsteps=2000, extraprec=300, asc=True)
    angles = [mp.arg(root) for root in roots if abs(abs(root) - 1) < mp.mpf(10) ** -15]
    return [angle for angle in angles if mp.mpf(10) ** -10 < angle < mp.pi - mp.mpf(10) ** -10]


def sub(one: Polynomial, two: Polynomial) -> Polynomial:
    return [x - y for x, y in zip(one, two, strict=True)]


def slope(polynomial: Polynomial) -> Polynomial:
    """z d/dz of a polynomial divided by z^(its degree/2), which is the derivative by the angle."""
    half = mp.mpf(len(polynomial) - 1) / 2
    return [(k - half) * x for k, x in enumerate(polynomial)]


def long_margins(values: tuple[float, ...]) -> dict[str, mp.mpf]:
    """Margins by the roots of polynomials in z, lowest power first, 60 digits."""
    r, inductance, t_s, kp, ki = (mp.mpf(value) for value in values)
    a = mp.exp(-r * t_s / inductance)
    b = (1 - a) / r if r else t_s / inductance
    above = [-b * kp, b * (kp + ki * t_s), mp.mpf(0), mp.mpf(0)]
    below = [mp.mpf(0), a, -(1 + a), mp.mpf(1)]
    closed = [x + y for x, y in zip(above, below, strict=True)]

    def loop(angle: mp.mpf) -> mp.mpc:
        z = mp.expj(angle)
        return mp.polyval(above, z, asc=True) / mp.polyval(below, z, asc=True)

    squares = [product(each, each[::-1]) for each in (above, below, closed)]
    crossings = on_circle(sub(squares[0], squares[1]))
    turns = on_circle(sub(product(above, below[::-1]), product(above[::-1], below)))
    level = sub(product(slope(squares[1]), squares[2]), product(squares[1], slope(squares[2])))
    peaks = [*on_circle(level), mp.pi]
    factors = [-1 / loop(angle).real for angle in turns if loop(angle).real < 0]
    margin = mp.arg(-loop(crossings[0])) if crossings else mp.inf
    return {
        "count": mp.mpf(len(crossings)),
        "crossover": crossings[0] / t_s if crossings else mp.nan,
        "phase_margin": margin,
        "delay_margin": (margin % (2 * mp.pi)) / crossings[0] * t_s if crossings else mp.inf,
        "gain_margin": min([f for f in factors if f > 1], default=mp.inf),
        "gain_reduction": max([f for f in factors if f <= 1], default=mp.mpf(0)),
        "max_sensitivity": max(1 / abs(1 + loop(angle)) for angle in peaks),
        "peaks": mp.mpf(len(peaks) - 1),
        "radius": max(
            abs(root) for root in mp.polyroots(closed, maxsteps=500, extraprec=400, asc=True)
        ),
    }


def test_margins_are_those_of_long_arithmetic_in_slow_loops_too() -> None:
    loops = drawn(12, 21, slowest=-4.0, least=2.0)
    found = loops.margins()
    with mp.workdps(60):
        for k in range(12):
            values = (
                loops.r_s[k],
                loops.inductance[k],
                loops.t_s[k],
                loops.kp[k],
                loops.ki[k],
            )
            wanted = long_margins(tuple(float(value) for value in values))
            assert (wanted["radius"] < 1) == found.stable[k]
            assert wanted["count"] <= 1
            assert wanted["peaks"] <= 1
            for name in NAMES:
                assert relative(float(getattr(found, name)[k]), float(wanted[name])) < 1e-12, name


# --- what is handled as by the scan ---------------------------------------------------------------


def test_a_loop_too_slow_for_any_crossover_has_none() -> None:
    found = current_margins(current_loops(2.35, 1.7e-3, 1e-4, 1e-6, np.array([1e-6, 1e4]))).of(0)
    assert np.isnan(found.crossover)
    assert found.crossovers.size == 0
    assert found.phase_margin == found.delay_margin == np.inf
    # The crossover would lie at ki/R, far below what is looked for.
    assert LEAST_SHARE * np.pi / 1e-4 > 1e-6 / 2.35


def test_a_loop_whose_gain_stays_above_one_has_no_crossover() -> None:
    found = current_margins(current_loops(1.0, 1e-3, 1e-4, 50.0, 10.0))
    assert not found.stable[0]
    assert np.isnan(found.crossover[0])
    scanned = loop_margins(current_loop(1.0, 1e-3, 1e-4, 50.0, 10.0).open_loop)
    assert scanned.crossovers.size == 0
    assert found.gain_reduction[0] == pytest.approx(scanned.gain_reduction, rel=1e-12)


def test_rows_are_what_they_are_alone() -> None:
    """Neighbours change no digit, so that a study may be cut anywhere."""
    loops = drawn(50, 3)
    whole = loops.margins()
    for k in (0, 17, 49):
        alone = current_margins(
            current_loops(loops.r_s[k], loops.inductance[k], loops.t_s[k], loops.kp[k], loops.ki[k])
        )
        for name in NAMES:
            np.testing.assert_array_equal(getattr(alone, name)[0], getattr(whole, name)[k])


def test_formulas_need_positive_gains() -> None:
    kp, ki = np.array([1.0, 0.0, -1.0, np.inf, 1.0]), np.array([1.0, 1.0, 1.0, 1.0, np.nan])
    np.testing.assert_array_equal(has_closed_margins(kp, ki), [True, False, False, False, False])


def test_a_loop_with_another_sign_is_still_scanned() -> None:
    """An integral gain of zero, as rounding to integers may leave it, has no closed form here."""
    found = analyse_current_loop(0.4, 2e-3, 1e-4, 4.0, 0.0, respond=False)
    wanted = loop_margins(current_loop(0.4, 2e-3, 1e-4, 4.0, 0.0).open_loop)
    assert found.margins.max_sensitivity == wanted.max_sensitivity
    assert found.margins.crossover == wanted.crossover


@pytest.mark.parametrize("ki", [1e2, 2e3, 5e3])
@pytest.mark.parametrize("left", [1.02, 1.1, 1.24, 3.0])
def test_a_gain_takes_itself_from_both_gain_margins(ki: float, left: float) -> None:
    """A voltage that is larger by a factor leaves so much less of the margin, and asks for so much
    more of a reduction; what is left of a margin near one is still none of a reduction.
    """
    plain = current_margins(current_loops(1.0, 1e-3, 1e-4, 3.0, ki))
    gain = plain.gain_margin / left
    found = current_margins(current_loops(1.0, 1e-3, 1e-4, 3.0, ki, gain))
    assert found.gain_margin[0] == pytest.approx(left, rel=1e-9)
    if plain.gain_reduction[0] / gain[0] <= 1.0:
        assert found.gain_reduction[0] == pytest.approx(plain.gain_reduction[0] / gain[0], rel=1e-9)
    assert found.gain_reduction[0] <= 1.0
