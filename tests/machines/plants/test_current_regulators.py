"""The circle, the switching table, sampled rules in the loop and trajectory tracking, against
geometry and the published table.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.plants.current_feedback import simulate_currents
from dqforge.machines.plants.fed_machine import I_D, I_Q, BridgeDrive, build_plant
from dqforge.machines.plants.regulator_rules import (
    ACTIVE,
    LEGS,
    Codes,
    RuleConstants,
    codes_of,
    switching_table,
    unit_vectors,
)
from dqforge.machines.plants.regulator_schemes import (
    LEAST_WIDTH,
    Circle,
    PulsePattern,
    Sampled,
    Trajectory,
    TrajectoryController,
    amplitudes,
    continued_pattern,
    distortion,
    optimal_pattern,
    patterns_of,
    steady_trajectory,
    times_within,
)

SALIENT = LinearMachine(pole_pairs=3, r_s=2.35, l_d=1.2e-3, l_q=2.4e-3, psi_pm=0.06, i_max=6.4)
DRIVE = BridgeDrive(SALIENT, 180.0)


def vectors() -> FloatArray:
    found = unit_vectors()
    return np.asarray(found[:, 0] + 1j * found[:, 1])


def test_states_and_their_vectors() -> None:
    assert codes_of(LEGS).tolist() == list(range(8))
    angles = np.angle(vectors()[list(ACTIVE)], deg=True) % 360.0
    np.testing.assert_allclose(angles, 60.0 * np.arange(6), atol=1e-9)
    np.testing.assert_allclose(np.abs(vectors()[list(ACTIVE)]), 2.0 / 3.0)


def test_table_is_the_published_one_and_the_best_at_the_middle_of_each_sector() -> None:
    """First row as printed; each entry pushes the current along the error, as no other of the three
    does, where the counter voltage stands in the middle of its triangle.
    """
    table = switching_table()
    assert table[0] == (1, 3, 3, 0, 0, 1)  # V1 V2 V2 V0 V0 V1 as codes of the legs
    for sector in range(6):
        three = [ACTIVE[sector], ACTIVE[(sector + 1) % 6], 0]
        middle = np.mean(vectors()[three])
        for region in range(6):
            error = np.exp(1j * math.pi / 3.0 * region)
            pushes = [((vectors()[code] - middle) * np.conj(error)).real for code in three]
            assert table[sector][region] in three
            chosen = ((vectors()[table[sector][region]] - middle) * np.conj(error)).real
            assert chosen > 0.0
            assert chosen == pytest.approx(max(pushes))


def test_circle_keeps_the_error_within_it() -> None:
    trace = simulate_currents(
        DRIVE, Circle(0.5), [0.0, -1.0, 0.0], [2.0, 3.0, -2.0], [60.0, 250.0, 250.0]
    )
    error = np.hypot(
        trace.state[..., I_D] - trace.plant.i_d, trace.state[..., I_Q] - trace.plant.i_q
    )
    assert np.max(error) <= 0.5 * (1.0 + 1e-6)
    # Where it commutates it is on the circle.
    changed = np.any(trace.legs[1:] != trace.legs[:-1], axis=-1)
    assert np.sum(changed) > 50
    np.testing.assert_allclose(error[1:][changed], 0.5, rtol=1e-8)


def test_circle_takes_the_longest_predicted_time_and_some_state_always_leads_back() -> None:
    """Predicted times against the exact run; the reachable voltage lies within the hexagon."""
    generator = np.random.default_rng(5)
    count = 200
    i_d, i_q = generator.uniform(-2.0, 0.0, count), generator.uniform(-3.0, 3.0, count)
    omega = generator.uniform(-1100.0, 1100.0, count)
    plant = build_plant(DRIVE, i_d, i_q, omega)
    needed = np.hypot(*SALIENT.voltage(i_d, i_q, omega))
    assert np.all(needed < 180.0 / math.sqrt(3.0))
    state, place = plant.start(LEGS[np.zeros(count, dtype=int)]), generator.uniform(0, 6.28, count)
    state[:, I_D] += 0.05 * np.cos(place)
    state[:, I_Q] += 0.05 * np.sin(place)
    time = generator.uniform(0.0, 0.01, count)
    tried = np.broadcast_to(np.arange(8)[:, None], (8, count))
    within = times_within(plant, state, time, tried)
    assert np.all(np.max(within, axis=0) > 0.0)
    best = np.argmax(within[1:7], axis=0) + 1
    for k in range(0, count, 10):
        one = plant.part(slice(k, k + 1))
        start = one.switched(state[k : k + 1], omega[k] * time[k : k + 1], LEGS[best[k : k + 1]])
        lasts = float(within[best[k], k])
        for share, inside in ((0.5, True), (0.9, True), (1.15, False)):
            end = one.advance(start, share * lasts)[0]
            size = math.hypot(end[I_D] - i_d[k], end[I_Q] - i_q[k])
            assert (size < 0.05) == inside


def test_patterns_make_their_fundamental_and_keep_their_widths() -> None:
    for count, index in ((1, 0.4), (3, 0.8), (5, 1.0)):
        pattern = optimal_pattern(count, index)
        edges, levels = pattern.edges()
        assert edges.size == 4 * count + 2
        # Fourier series of the edges themselves.
        for order in (1, 2, 3, 5, 7):
            fine = np.exp(-1j * order * np.append(edges, 2.0 * math.pi))
            found = np.sum(levels * (fine[:-1] - fine[1:])) / (1j * order) / math.pi
            expected = pattern.amplitudes(np.array([float(order)]))[0] if order % 2 else 0.0
            assert abs(found - (-1j) * expected) < 1e-9
        assert pattern.amplitudes(np.ones(1))[0] == pytest.approx(index, abs=1e-7)
        assert np.min(np.diff(edges)) >= LEAST_WIDTH * (1.0 - 1e-6)


def test_pattern_of_two_angles_is_the_best_of_all() -> None:
    """One angle follows from the other, so that all pairs can be tried."""
    index, best = 0.9, math.inf
    for sign in (1, -1):
        for first in np.linspace(LEAST_WIDTH, 0.5 * math.pi, 4000):
            cosine = 0.5 * (sign * index * math.pi / 4.0 - 1.0) + math.cos(first)
            if abs(cosine) < 1.0 and math.acos(cosine) >= first + LEAST_WIDTH:
                pair = np.array([first, math.acos(cosine)])
                if pair[1] < 0.5 * math.pi - 0.5 * LEAST_WIDTH:
                    best = min(best, distortion(pair, sign))
    pattern = optimal_pattern(2, index)
    assert distortion(pattern.angles, pattern.sign) == pytest.approx(best, rel=2e-3)
    assert amplitudes(pattern.angles, pattern.sign, np.ones(1))[0] == pytest.approx(index)


def test_a_pattern_of_one_angle_is_led_to_where_its_fundamental_is() -> None:
    """cos x = (1 - sign b_1 pi/4) / 2; of both levels the one that distorts less is taken."""
    for index in (0.35, 0.7):
        exact = {
            sign: np.array([math.acos(0.5 * (1.0 - sign * index * math.pi / 4.0))])
            for sign in (1, -1)
        }
        begin = [PulsePattern(angle + 0.05, sign) for sign, angle in exact.items()]
        for offered in (begin, begin[:1], begin[1:]):
            found = continued_pattern(offered, index)
            assert found is not None
            signs = [pattern.sign for pattern in offered]
            best = min(signs, key=lambda sign: distortion(exact[sign], sign))
            assert found.sign == best
            np.testing.assert_allclose(found.angles, exact[best], atol=1e-7)
    assert continued_pattern(begin, 1.5) is None  # beyond 4/pi


@pytest.mark.parametrize("per_commutation", [True, False])
def test_the_circle_is_met_and_never_left(*, per_commutation: bool) -> None:
    """Each commutation happens on the circle, and leads to the state whose straight line stays
    within it longest, as it is or over its commutations."""
    radius, i_q = 1.5, 3.0
    trace = simulate_currents(DRIVE, Circle(radius, per_commutation), -1.0, i_q, 400.0, settling=0)
    ends = trace.state[1:, 0]
    error = np.hypot(-1.0 - ends[:, I_D], i_q - ends[:, I_Q])
    assert np.max(error) <= radius * (1.0 + 1e-6)
    legs = trace.legs[:, 0]
    moved = np.flatnonzero(np.any(legs[1:] != legs[:-1], axis=1))
    assert moved.size > 10
    np.testing.assert_allclose(error[moved], radius, rtol=1e-6)
    for k in moved:
        theta = 1200.0 * trace.time[k + 1, 0]
        v = vectors() * 180.0 * np.exp(-1j * theta)
        d, q = ends[k, [I_D, I_Q]]
        slope_d = (v.real - 2.35 * d + 1200.0 * 2.4e-3 * q) / 1.2e-3
        slope_q = (v.imag - 2.35 * q - 1200.0 * (1.2e-3 * d + 0.06)) / 2.4e-3
        inward = (-1.0 - d) * slope_d + (i_q - q) * slope_q
        lasts = np.maximum(2.0 * inward / (slope_d**2 + slope_q**2), 0.0)
        moves = np.sum(legs[k] != LEGS, axis=1)
        score = lasts / np.maximum(moves, 1) if per_commutation else lasts
        score[moves == 0] = 0.0
        chosen = score[int(codes_of(legs[k + 1][None])[0])]
        assert chosen == pytest.approx(score.max(), rel=1e-6)


def tracked_error(offset: tuple[float, float], *, tracking: bool) -> tuple[FloatArray, FloatArray]:
    """Times in s and distances in A from the steady trajectory."""
    scheme = Trajectory(3, 50e-6, offset, tracking)
    trace = simulate_currents(DRIVE, scheme, 0.0, 3.0, 400.0, settling=0)
    plant = trace.plant
    steady = TrajectoryController(steady_trajectory(plant, *patterns_of(plant, 3)), 1.0)
    at = np.stack([steady.steady_state(plant, time)[0] for time in trace.time])
    away = np.hypot(trace.state[:, 0, I_D] - at[:, I_D], trace.state[:, 0, I_Q] - at[:, I_Q])
    return trace.time[:, 0], away


@pytest.mark.slow
def test_trajectory_is_steady_and_tracking_removes_an_error_faster_than_the_winding() -> None:
    _, still = tracked_error((0.0, 0.0), tracking=True)
    assert np.max(still) < 1e-6
    time, alone = tracked_error((1.0, -1.0), tracking=False)
    moved, tracked = tracked_error((1.0, -1.0), tracking=True)
    late = 1.5e-3
    assert np.max(tracked[moved > late]) < 0.02
    assert np.max(alone[time > late]) > 0.1


def test_trajectory_has_the_frequency_and_fundamental_of_its_pattern() -> None:
    trace = simulate_currents(DRIVE, Trajectory(2, 100e-6), -0.5, 2.0, 300.0)
    electrical = 3.0 * 300.0 / (2.0 * math.pi)
    assert trace.switching_frequency().average[0] == pytest.approx(5.0 * electrical, rel=1e-9)
    assert trace.spectrum([1])[0, 0, 0] == pytest.approx(-0.5 + 2.0j, abs=1e-3)
    power = trace.power_balance()
    np.testing.assert_allclose(power.dc_link - power.copper, power.shaft + power.stored, rtol=1e-9)


def kept(_constants: RuleConstants, codes: Codes, *_told: Any) -> Codes:
    """A rule that never commutates."""
    return codes


def test_a_sampled_rule_acts_a_sample_later_and_is_told_what_is_there() -> None:
    asked = []

    def turning(_constants: RuleConstants, codes: Codes, *told: Any) -> Codes:
        asked.append((codes.copy(), told))
        return np.array(
            [ACTIVE[(ACTIVE.index(int(code)) + 1) % 6] if code else 1 for code in codes]
        )

    trace = simulate_currents(DRIVE, Sampled("predictive", 20e-6, turning), -0.5, 2.0, 250.0)
    for (now, _), (later, _) in pairwise(asked):
        assert later[0] == (ACTIVE[(ACTIVE.index(int(now[0])) + 1) % 6] if now[0] else 1)
    assert {codes_of(legs)[0] for legs in trace.legs} == set(ACTIVE)
    for _, (i_d_ref, i_q_ref, _d, _q, cosine, sine, omega_e, v_dc) in asked[:50]:
        assert (i_d_ref[0], i_q_ref[0], omega_e[0], v_dc[0]) == (-0.5, 2.0, 750.0, 180.0)
        assert cosine[0] ** 2 + sine[0] ** 2 == pytest.approx(1.0)
    turned = np.unwrap([math.atan2(told[5][0], told[4][0]) for _, told in asked[:50]])
    np.testing.assert_allclose(np.diff(turned), 750.0 * 20e-6, rtol=1e-9)


@pytest.mark.parametrize(
    ("scheme", "omega_m", "words"),
    [
        (Circle(0.0), 100.0, "radius: expected a positive number in A"),
        (Circle(1e-6), 100.0, "wider band"),
        (Circle(0.3), 800.0, "the bridge makes 103.9 V"),
        (Sampled("predictive", 0.0, kept), 100.0, "t_s"),
        (Sampled("circle", 20e-6, kept), 100.0, "band"),
        (Sampled("look-up-table", 20e-6, kept, 0.4, 0.2), 100.0, "outer_band"),
        (Trajectory(0, 20e-6), 100.0, "angles"),
        (Trajectory(2, 20e-6), -100.0, "positive speeds"),
    ],
)
def test_refused(scheme: Circle | Sampled | Trajectory, omega_m: float, words: str) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        simulate_currents(DRIVE, scheme, 0.0, 2.0, omega_m)
