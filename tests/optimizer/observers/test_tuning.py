"""Tuning of observers: what a design comes to, the cost of a tuning, and where it is searched."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, RELUCTANCE

from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers import tuning as module
from dqforge.optimizer.observers.judgement import judge, judge_at
from dqforge.optimizer.observers.methods.registry import method_named
from dqforge.optimizer.observers.parts import ObserverTuning, usual_disturbances
from dqforge.optimizer.observers.tuning import optimise, retuned, tune_position_observer

T_S, TOP = 1e-4, 2500.0
METHOD = method_named("extended-emf")
FIRST = ObserverTuning(600.0, 200.0, 1.0)
KNOWN = replace(usual_disturbances(IPM, 500.0, TOP), l_q=0.02, psi_pm=0.02, r_s=0.1)


@pytest.mark.parametrize("t_s", [T_S, 3e-4])
def test_a_tuned_observer_is_designed_a_fifth_above_its_speed_and_judged(t_s: float) -> None:
    settings = ObserverSettings(method="extended-emf", bandwidth=500.0, pll_bandwidth=150.0)
    found = tune_position_observer(IPM, settings, t_s, 500.0, TOP, KNOWN)
    usual = METHOD.usual(IPM, t_s, TOP)
    assert found.tuning == replace(usual, bandwidth=500.0, pll_bandwidth=150.0)
    top = min(1.2 * TOP, 0.8 / t_s)
    assert found.gains == METHOD.design(IPM, found.tuning, t_s, top)
    whole = judge(METHOD, found.gains, t_s, IPM, KNOWN, TOP)
    np.testing.assert_array_equal(found.judgement.total, whole.total)
    at = found.shown.omega
    shown = judge_at(METHOD, found.gains, t_s, IPM, KNOWN, at)
    np.testing.assert_array_equal(found.shown.total, shown.total)
    assert at[-1] == pytest.approx(TOP)
    assert np.all((at > 0.0) & (at <= TOP))
    other = retuned(found, FIRST)
    assert other.tuning == FIRST
    assert other.gains == METHOD.design(IPM, FIRST, t_s, top)
    assert other.judgement is found.judgement
    plain = tune_position_observer(IPM, settings, t_s, 500.0, TOP)
    assert plain.disturbances == usual_disturbances(IPM, 500.0, TOP)


def test_too_few_samples_per_turn_and_no_magnet_are_refused() -> None:
    settings = ObserverSettings(method="extended-emf")
    with pytest.raises(NoSolutionError, match=r"turns by 0\.801 rad .* at most 0\.8; .*10013 Hz"):
        tune_position_observer(IPM, settings, T_S, 500.0, 8010.0)
    with pytest.raises(InputError, match="needs a magnet flux"):
        tune_position_observer(RELUCTANCE, settings, T_S, 500.0, 500.0)


def test_the_cost_is_the_rms_of_the_total_error_and_large_where_nothing_holds() -> None:
    omega = np.array([200.0, 900.0, 2500.0])
    gains = METHOD.design(IPM, FIRST, T_S, 3000.0)
    total = judge_at(METHOD, gains, T_S, IPM, KNOWN, omega).total
    assert np.isfinite(total).all()
    cost = module._cost(METHOD, FIRST, IPM, T_S, KNOWN, omega)
    assert cost == pytest.approx(np.linalg.norm(total) / np.sqrt(3.0))
    lost = replace(KNOWN, acceleration=1e7)
    worst = module._cost(METHOD, replace(FIRST, pll_bandwidth=1e9), IPM, T_S, KNOWN, omega)
    assert module._cost(METHOD, FIRST, IPM, T_S, lost, omega) == pytest.approx(worst)
    assert worst >= 1.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_search_ends_at_the_bound_that_the_cost_points_to(
    way: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the bandwidths alone as a cost: a hundredth, or a hundredfold up to what is sampled."""
    seen: list[ObserverTuning] = []

    def cost(method: object, tried: ObserverTuning, *rest: object) -> float:
        omega = rest[-1]
        assert isinstance(omega, np.ndarray)
        assert omega[[0, -1]] == pytest.approx((0.05 * TOP, TOP))
        seen.append(tried)
        return -way * float(np.log(tried.bandwidth) + np.log(tried.pll_bandwidth))

    monkeypatch.setattr(module, "_cost", cost)
    found = optimise(METHOD, FIRST, IPM, T_S, KNOWN, TOP)
    assert set(METHOD.searched) >= {"bandwidth", "pll_bandwidth"}
    most = min(60_000.0, 1.0 / T_S), min(20_000.0, 0.5 / T_S)
    expected = most if way > 0.0 else (6.0, 2.0)
    assert (found.bandwidth, found.pll_bandwidth) == pytest.approx(expected, rel=5e-3)
    assert seen[0] == FIRST
    moved = [
        abs(np.log(getattr(tried, name) / getattr(FIRST, name)))
        for tried in seen[1:3]
        for name in METHOD.searched
    ]
    assert max(moved) == pytest.approx(0.7, abs=0.01)


def test_the_search_stops_after_so_many_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    trials: list[float] = []

    def noise(*_: object) -> float:
        trials.append(float(np.random.default_rng(len(trials)).random()))
        return trials[-1]

    monkeypatch.setattr(module, "_cost", noise)
    monkeypatch.setattr(module, "_EVALUATIONS", 9)
    optimise(METHOD, FIRST, IPM, T_S, KNOWN, TOP)
    assert len(trials) == 11
