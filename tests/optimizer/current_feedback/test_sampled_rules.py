"""Sampled rules against the exact machine, brute force, complex numbers and the published table."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import SampledRuleName
from dqforge.machines.plants.current_feedback import best_states, simulate_currents
from dqforge.machines.plants.fed_machine import I_D, I_Q, BridgeDrive, build_plant
from dqforge.machines.plants.regulator_rules import (
    ACTIVE,
    LEGS,
    RuleConstants,
    codes_of,
    switching_table,
)
from dqforge.machines.plants.regulator_schemes import Sampled
from dqforge.optimizer.current_feedback.sampled_rules import FeedbackInputs, next_codes
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.steps.step_arithmetic import EXACT

SALIENT = LinearMachine(pole_pairs=3, r_s=2.35, l_d=1.2e-3, l_q=2.4e-3, psi_pm=0.06, i_max=6.4)
DRIVE = BridgeDrive(SALIENT, 180.0)


def sample(count: int, seed: int) -> tuple[FeedbackInputs, FloatArray]:
    generator = np.random.default_rng(seed)
    draw = generator.uniform
    theta = draw(0.0, 2.0 * math.pi, count)
    told = FeedbackInputs(
        draw(-3.0, 0.0, count), draw(-4.0, 4.0, count), draw(-4.0, 1.0, count),
        draw(-5.0, 5.0, count), np.cos(theta), np.sin(theta), draw(-900.0, 900.0, count),
        np.full(count, 180.0),
    )  # fmt: skip
    return told, theta


def columns(told: FeedbackInputs) -> tuple[FloatArray, ...]:
    return tuple(getattr(told, member.name) for member in fields(told))


RULES: tuple[SampledRuleName, ...] = ("predictive", "circle", "look-up-table")


def constants(rule: SampledRuleName, t_s: float = 20e-6, band: float = 0.6) -> RuleConstants:
    return RuleConstants(
        rule, SALIENT.r_s, SALIENT.l_d, SALIENT.l_q, SALIENT.psi_pm, t_s, band, 3.0 * band
    )


def test_sampled_prediction_is_the_exact_best_state_one_sample_later() -> None:
    """The rule's short model against the exact solution over two samples."""
    count, t_s = 300, 20e-6
    told, theta = sample(count, 11)
    codes = np.random.default_rng(1).integers(0, 8, count)
    named = next_codes(constants("predictive", t_s), codes, *columns(told), o=EXACT)
    agreeing = 0
    for k in range(count):
        plant = build_plant(
            DRIVE, told.i_d_ref[k : k + 1], told.i_q_ref[k : k + 1], told.omega_e[k : k + 1]
        )
        time = theta[k : k + 1] / told.omega_e[k]
        state = plant.start(LEGS[codes[k : k + 1]])
        state[:, I_D], state[:, I_Q] = told.i_d[k], told.i_q[k]
        state = plant.switched(state, theta[k : k + 1], LEGS[codes[k : k + 1]])
        later = plant.advance(state, t_s)
        best = best_states(plant, later, time + t_s, LEGS[codes[k : k + 1]], t_s)
        agreeing += int(codes_of(best)[0] == named[k])
    assert agreeing >= 0.98 * count


def test_rules_in_both_precisions_name_the_same_and_survive_nan() -> None:
    told, _ = sample(400, 12)
    codes = np.random.default_rng(2).integers(0, 8, 400)
    for rule in RULES:
        named = [next_codes(constants(rule), codes, *columns(told), o=o) for o in (EXACT, SINGLE)]
        assert np.mean(named[0] == named[1]) > 0.99
        assert len(set(named[0].tolist())) >= 6
        lost = [np.full(400, math.nan) for _ in range(8)]
        np.testing.assert_array_equal(next_codes(constants(rule), codes, *lost), codes)


def test_drives_alone_are_told_what_they_are_told_together() -> None:
    told, _ = sample(300, 16)
    near = np.arange(300) % 3 == 0
    told = replace(
        told,
        i_d=np.where(near, told.i_d_ref + 0.2, told.i_d),
        i_q=np.where(near, told.i_q_ref - 0.1, told.i_q),
    )
    told.i_q[::50], told.omega_e[7::50] = math.nan, math.inf
    codes = np.random.default_rng(5).integers(0, 12, 300)
    for rule in RULES:
        for o in (EXACT, SINGLE):
            together = next_codes(constants(rule), codes, *columns(told), o=o)
            alone = [
                next_codes(
                    constants(rule), codes[k : k + 3], *(c[k : k + 3] for c in columns(told)), o=o
                )
                for k in range(0, 300, 3)
            ]
            np.testing.assert_array_equal(np.concatenate(alone), together)


def test_table_rule_finds_sector_region_and_both_bands() -> None:
    """Sector and region by angles of complex numbers, without the comparisons of the rule."""
    told, theta = sample(500, 13)
    codes = np.random.default_rng(3).integers(0, 8, 500)
    known = constants("look-up-table", 1e-9)  # so short that nothing moves meanwhile
    named = next_codes(known, codes, *columns(told), o=EXACT)
    turn = np.exp(1j * theta)
    error = ((told.i_d_ref - told.i_d) + 1j * (told.i_q_ref - told.i_q)) * turn
    v_d, v_q = SALIENT.voltage(told.i_d_ref, told.i_q_ref, told.omega_e)
    sector = (np.angle((v_d + 1j * v_q) * turn, deg=True) % 360.0 // 60.0).astype(int)
    region = (np.round(np.angle(error, deg=True) / 60.0) % 6).astype(int)
    phases = np.abs(np.real(error[:, None] * np.exp(-2j * math.pi / 3.0 * np.arange(3))))
    largest = np.max(phases, axis=-1)
    for k in range(500):
        if largest[k] <= 0.6:
            expected = {int(codes[k])}
        elif largest[k] > 1.8:
            expected = {ACTIVE[region[k]]}
        else:
            entry = switching_table()[sector[k]][region[k]]
            expected = {entry} if entry else {0, 7}
        assert int(named[k]) in expected
    assert np.sum(largest <= 0.6) > 5
    assert np.sum((largest > 0.6) & (largest <= 1.8)) > 30


def test_angle_of_the_next_sample_is_that_of_a_rotor_that_turns_on() -> None:
    """A winding that stays without current, and half a radian in half of a sampling period."""
    told, theta = sample(500, 15)
    t_s, none = 1.0 / 900.0, np.zeros(500)
    told = replace(told, omega_e=np.sign(told.omega_e) * 900.0, i_d=none, i_q=none)
    still = RuleConstants("look-up-table", 0.0, 1e9, 1e9, 0.0, t_s)
    named = next_codes(still, np.zeros(500, dtype=np.int64), *columns(told), o=EXACT)
    error = told.i_d_ref + 1j * told.i_q_ref
    angle = np.angle(error * np.exp(1j * (theta + told.omega_e * t_s)), deg=True)
    region = (np.round(angle / 60.0) % 6).astype(int)
    assert np.mean(named == np.array(ACTIVE)[region]) > 0.985


def test_circle_rule_keeps_what_stays_and_else_takes_the_longest_time_per_commutation() -> None:
    """Roots of the error's straight path over complex numbers, with the exact machine."""
    count, t_s = 300, 20e-6
    told, theta = sample(count, 14)
    generator = np.random.default_rng(4)
    size, place = 1.0 * np.sqrt(generator.random(count)), generator.uniform(0.0, 6.28, count)
    told = replace(
        told, i_d=told.i_d_ref + size * np.cos(place), i_q=told.i_q_ref + size * np.sin(place)
    )
    codes = generator.integers(0, 8, count)
    named = next_codes(constants("circle", t_s, 0.8), codes, *columns(told), o=EXACT)
    agreeing, counts = 0, [0, 0, 0]
    for k in range(count):
        reference = told.i_d_ref[k] + 1j * told.i_q_ref[k]
        plant = build_plant(
            DRIVE, told.i_d_ref[k : k + 1], told.i_q_ref[k : k + 1], told.omega_e[k : k + 1]
        )
        state = plant.start(LEGS[codes[k : k + 1]])
        state[:, I_D], state[:, I_Q] = told.i_d[k], told.i_q[k]
        state = plant.switched(state, theta[k : k + 1], LEGS[codes[k : k + 1]])
        later = plant.advance(state, t_s)
        before = reference - (later[0, I_D] + 1j * later[0, I_Q])
        after = []
        for code in range(8):
            angle = theta[k : k + 1] + told.omega_e[k] * t_s
            end = plant.advance(plant.switched(later, angle, LEGS[[code]]), t_s)
            after.append(reference - (end[0, I_D] + 1j * end[0, I_Q]))
        if abs(after[codes[k]]) <= 0.8:
            expected, case = int(codes[k]), 0
        else:
            scores = {}
            for code in set(range(8)) - {int(codes[k])}:
                path = [after[code] - before, before]  # error over time in samples
                roots = np.roots([abs(path[0]) ** 2, 2.0 * (path[0] * np.conj(before)).real,
                                  abs(before) ** 2 - 0.64])  # fmt: skip
                leaves = max((r.real for r in roots if abs(r.imag) < 1e-12), default=0.0)
                legs = bin(code ^ int(codes[k])).count("1")
                if leaves >= 1.0:
                    scores[code] = leaves / max(legs, 1)
            case = 1 if scores else 2
            expected = (
                max(scores, key=lambda code: scores[code])
                if scores
                else int(np.argmin(np.abs(after)))
            )
        counts[case] += 1
        agreeing += int(expected == named[k])
    assert min(counts) > 10, counts
    assert agreeing >= 0.97 * count


@pytest.mark.slow
def test_fast_sampled_circle_stays_in_the_circle() -> None:
    """With samples that move the error by a twelfth of the radius it never leaves."""
    trace = simulate_currents(
        DRIVE,
        Sampled("circle", 5e-6, partial(next_codes, o=EXACT), 1.5),
        0.0,
        2.0,
        250.0,
        settling=1,
    )
    error = np.hypot(trace.state[..., I_D], trace.state[..., I_Q] - 2.0)
    assert np.max(error) <= 1.5 * 1.005
    assert np.max(error) > 1.35
