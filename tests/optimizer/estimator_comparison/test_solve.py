"""Who wins where and the pair to flash, against what a reader would work out by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import RELUCTANCE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.plants.scenario import drive_motion
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.estimator_comparison.candidate import (
    Candidate,
    ClosedLoop,
    EstimatorFigures,
    Question,
    StartCandidate,
    StartFigures,
    TriedStarts,
    closed_loop,
    tuned_observer,
)
from dqforge.optimizer.estimator_comparison.compared import (
    ComparedEstimator,
    ComparedStart,
    estimators,
)
from dqforge.optimizer.estimator_comparison.solve import (
    NOBODY,
    SPEED_SHARES,
    UNREACHED,
    EstimatorComparison,
    FlashedPair,
    ask,
    chosen_pair,
    compare_estimators,
    estimator_at_speed,
    winners,
    with_success,
)
from dqforge.optimizer.estimators import TRACKERS
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import observe

BENCH = "paper001-pmsm-bench"
QUICK = ("reduced-order", "extended-emf", "flux")


def candidates(*names: str) -> list[Candidate]:
    return [candidate for candidate in estimators() if candidate.name in names]


@pytest.fixture(scope="module")
def bench() -> EstimatorComparison:
    return compare_estimators(catalogue.load(BENCH), candidates=candidates(*QUICK))


def test_every_method_stands_in_the_comparison_once() -> None:
    names = [candidate.name for candidate in estimators()]
    assert len(names) == len(set(names))
    assert set(METHODS) | {"reduced-order"} <= set(names)


def test_the_winner_errs_least_of_those_that_hold(bench: EstimatorComparison) -> None:
    rows, asked = bench.estimators, bench.asked
    for s in range(len(asked.omega)):
        for m in range(len(asked.shares)):
            held = {
                k: row.figures.angle[s, m]
                for k, row in enumerate(rows)
                if row.figures is not None and row.holds is not None and row.holds[s, m]
            }
            won = bench.winner[s, m]
            if not asked.reached[s, m]:
                assert won == UNREACHED
            elif not held:
                assert won == NOBODY
            else:
                assert won == min(held, key=lambda k: held[k])
                assert held[won] <= np.radians(10.0)
    assert {NOBODY, 1} <= set(bench.winner.ravel().tolist())


def test_standstill_is_nobodys_among_observers(bench: EstimatorComparison) -> None:
    assert SPEED_SHARES[0] == 0.0
    assert (bench.winner[0] == NOBODY).all()


def test_cells_beyond_the_voltage_are_no_ones() -> None:
    """By hand: |v|^2 = (R i_d - w L_q i_q)^2 + (R i_q + w (L_d i_d + psi))^2 over v_max^2."""
    design = catalogue.load(BENCH)
    low = replace(design, inverter=replace(design.inverter, v_dc=120.0))
    asked, machine = ask(low), low.machine
    for m, load in enumerate(asked.loads):
        for s, omega in enumerate(asked.omega):
            v_d = machine.r_s * load.i_d - omega * load.l_q * load.i_q
            v_q = machine.r_s * load.i_q + omega * (load.l_d * load.i_d + load.psi_pm)
            assert asked.reached[s, m] == (np.hypot(v_d, v_q) <= low.v_max)
    assert asked.reached.any()
    assert not asked.reached.all()


def test_noise_is_that_of_trials(bench: EstimatorComparison) -> None:
    """The flux observer at half the speed and load, against 60 noisy drives."""
    asked = bench.asked
    row = bench.estimator("flux")
    assert row.figures is not None
    observer = row.figures.observer
    assert observer is not None
    s, m = SPEED_SHARES.index(0.5), 3
    load, known = asked.loads[m], asked.disturbances
    motion = drive_motion(
        observer.machine,
        observer.t_s,
        np.full((1200, 60), asked.omega[s]),
        np.full(60, complex(load.i_d, load.i_q)),
    ).measured(known.i_noise, known.v_noise, seed=3)
    error = observe(observer.method, observer.gains, motion).angle_error(motion)[600:]
    spread = np.sqrt(np.mean(np.var(error, axis=0)))
    assert spread == pytest.approx(row.figures.noise[s, m], rel=0.1)


@pytest.mark.slow
def test_the_designs_own_tuning_counts_for_its_own_method() -> None:
    design = catalogue.load(BENCH)
    control = replace(design.control, observer=ObserverSettings(method="flux", pll_bandwidth=321.0))
    asked = ask(replace(design, control=control))
    assert tuned_observer(asked, "flux").tuning.pll_bandwidth == 321.0
    assert tuned_observer(asked, "extended-emf").tuning.pll_bandwidth != 321.0


@pytest.mark.slow
def test_a_reluctance_machine_is_refused_with_its_number() -> None:
    found = compare_estimators(make_design(RELUCTANCE))
    for row in found.estimators:
        if row.candidate.name in METHODS:
            assert row.refusal.startswith("psi_pm = 0 Wb")
            assert row.figures is None
    assert found.pair.at_speed is None
    for start_up in found.starts:
        assert start_up.refusal.startswith("psi_pm = 0 Wb")
    won = set(found.winner[found.winner >= 0].tolist())
    assert {found.estimators[k].candidate.name for k in won} <= set(TRACKERS)


def test_sampling_that_is_too_slow_is_refused_with_its_number() -> None:
    design = catalogue.load(BENCH)
    slow = replace(design, control=replace(design.control, t_s=1e-3))
    found = compare_estimators(slow, candidates=candidates("flux"))
    assert "1.7 rad (electrical) per sample, at most 0.8" in found.estimators[0].refusal


def candidate(name: str, *, from_standstill: bool = False) -> Candidate:
    def never(_: Question) -> Any:
        raise AssertionError

    return Candidate(name, name, never, never, from_standstill=from_standstill)


def row(
    asked: Question,
    name: str,
    low: float,
    high: float,
    error: float,
    *,
    from_standstill: bool = False,
) -> ComparedEstimator:
    """An estimator that holds from one share of the speed to another at every load."""
    share = asked.omega / asked.omega_max
    inside = ((share >= low) & (share <= high))[:, None] & np.ones(len(asked.shares), dtype=bool)
    angle = np.where(inside, error, np.inf)
    nil = np.zeros_like(angle)
    figures = EstimatorFigures(angle, nil, nil, low * asked.omega_max, high * asked.omega_max)
    return ComparedEstimator(candidate(name, from_standstill=from_standstill), "", figures, inside)


def paired(
    asked: Question,
    rows: list[ComparedEstimator],
    starts: list[ComparedStart],
    loops: dict[str, ClosedLoop] | None = None,
) -> FlashedPair:
    found = estimator_at_speed(asked, rows, lambda _, name: (loops or {}).get(name))
    return chosen_pair(asked, rows, starts, found)


def test_the_pair_changes_hands_where_both_hold() -> None:
    asked = ask(catalogue.load(BENCH))
    rows = [
        row(asked, "short", 0.3, 1.0, 0.01),
        row(asked, "wide", 0.15, 1.0, 0.02),
        row(asked, "equal", 0.15, 1.0, 0.03),
        row(asked, "still", 0.0, 0.2, 0.02, from_standstill=True),
    ]
    pair = paired(asked, rows, [])
    assert (pair.at_speed, pair.from_standstill) == ("wide", "still")
    assert pair.up == pytest.approx(0.15 * asked.omega_max)
    assert pair.down == pytest.approx(0.09 * asked.omega_max)
    assert pair.gap is None
    assert pair.held == 1.0
    assert 0.0 < pair.held_at_speed < 1.0
    won = winners(asked, rows)
    assert won[SPEED_SHARES.index(0.5), 2] == 0
    assert won[0, 2] == 3


def test_a_gap_between_both_is_told() -> None:
    asked = ask(catalogue.load(BENCH))
    rows = [
        row(asked, "fast", 0.2, 1.0, 0.01),
        row(asked, "still", 0.0, 0.05, 0.02, from_standstill=True),
    ]
    pair = paired(asked, rows, [])
    assert pair.gap == pytest.approx((0.05 * asked.omega_max, 0.2 * asked.omega_max))
    alone = paired(asked, rows[:1], [])
    assert alone.gap == pytest.approx((0.0, 0.2 * asked.omega_max))


def test_an_estimator_whose_speed_loop_does_not_hold_is_passed_over() -> None:
    asked = ask(catalogue.load(BENCH))
    rows = [row(asked, "wide", 0.1, 1.0, 0.01), row(asked, "calm", 0.3, 1.0, 0.01)]
    least = 0.4 * asked.omega_max
    loops = {
        "wide": ClosedLoop(0.9, 100.0, True, float("nan")),
        "calm": ClosedLoop(0.9, 100.0, True, least),
    }
    pair = paired(asked, rows, [], loops)
    assert (pair.at_speed, pair.passed) == ("calm", ("wide",))
    assert pair.up == pytest.approx(least)
    quick = loops | {"wide": ClosedLoop(0.9, 100.0, True, 0.2 * asked.omega_max)}
    assert paired(asked, rows, [], quick).at_speed == "wide"
    late = loops | {"wide": ClosedLoop(0.9, 100.0, True, 0.9 * asked.omega_max)}
    assert paired(asked, rows, [], late).passed == ("wide",)
    none = {name: replace(loop, holds=False) for name, loop in loops.items()}
    pair = paired(asked, rows, [], none)
    assert (pair.at_speed, pair.passed) == ("wide", ())
    assert pair.loop == none["wide"]


@pytest.mark.slow
def test_the_speed_loop_over_the_designs_own_observer_is_that_of_tune() -> None:
    design = catalogue.load("abb-ipmsm-2k2", ["control.observer={method: flux}"])
    asked = ask(design)
    found = closed_loop(asked, "flux")
    speed = solve_gains(design).speed
    assert found is not None
    assert speed is not None
    assert speed.observed is not None
    assert speed.observed.corners is not None
    assert found.margin == speed.phase_margin
    assert found.low == speed.observed.corners.exact.low
    assert found.robust


def start(name: StartUpMethodName, success: float | None, load: float) -> ComparedStart:
    def never(*_: Any) -> Any:
        raise AssertionError

    tried = [] if success is None else [(0.0, 1.0), (0.3, success)]
    rates = tuple(TriedStarts(at, 100, round(100 * p), (0.0, 1.0), {}) for at, p in tried)
    figures = StartFigures(load, 100.0, 1.0, None, rates)
    return ComparedStart(StartCandidate(name, name, never, never), "", figures)


def test_the_start_that_succeeds_most_often_then_that_bears_most_is_flashed() -> None:
    asked = ask(catalogue.load(BENCH))
    rows = [row(asked, "fast", 0.2, 1.0, 0.01)]
    begun = [start("i-f", 0.9, 3.0), start("v-f", 0.95, 1.0), start("direct", 0.95, 2.0)]
    pair = paired(asked, rows, begun)
    assert pair.start == "direct"
    assert pair.gap is None  # the ramp turns the rotor until the estimator has it
    untried = [start("i-f", None, 1.0), start("v-f", None, 2.0), start("direct", None, 1.5)]
    before = paired(asked, rows, untried)
    assert before.start == "v-f"
    loop = ClosedLoop(0.9, 100.0, True, 0.3 * asked.omega_max)
    before = replace(before, loop=loop, passed=("wide",))
    bench = EstimatorComparison(asked, tuple(rows), tuple(untried), winners(asked, rows), before)
    after = with_success(bench, begun)
    assert after.starts == tuple(begun)
    assert after.estimator("fast") is rows[0]
    assert (after.pair.start, after.pair.at_speed) == ("direct", "fast")
    assert (after.pair.loop, after.pair.passed) == (loop, ("wide",))
    assert after.pair.up == pytest.approx(0.3 * asked.omega_max)
    lost = replace(bench, pair=replace(before, at_speed=None))
    assert with_success(lost, begun).pair.at_speed is None


def test_a_start_by_saliency_needs_an_estimator_up_to_the_hand_over() -> None:
    asked = ask(catalogue.load(BENCH))
    begun = [start("i-f", None, 1.0), start("saliency", None, 2.0)]
    still = row(asked, "still", 0.0, 0.3, 0.02, from_standstill=True)
    pair = paired(asked, [row(asked, "fast", 0.2, 1.0, 0.01), still], begun)
    assert (pair.start, pair.from_standstill) == ("saliency", "still")
    late = paired(asked, [row(asked, "fast", 0.4, 1.0, 0.01), still], begun)
    assert (late.start, late.from_standstill) == ("i-f", None)
    assert late.up == pytest.approx(0.4 * asked.omega_max)
    assert late.held == late.held_at_speed < 1.0  # the tracker is not flashed


@pytest.mark.slow
def test_without_a_speed_loop_nothing_is_said_of_its_bandwidth() -> None:
    design = catalogue.load(BENCH)
    bare = replace(design, control=replace(design.control, speed_loop=None))
    found = compare_estimators(bare, candidates=candidates("flux"))
    figures = found.estimators[0].figures
    assert figures is not None
    assert figures.left is None


def test_a_refusal_of_a_candidate_is_a_row_and_no_error() -> None:
    def refuse(_: Question) -> Any:
        raise NoSolutionError("control.observer: saliency is 1.05; at least 1.1")

    odd = Candidate("odd", "odd", lambda _: "", refuse)
    found = compare_estimators(catalogue.load(BENCH), candidates=[odd])
    assert found.estimators[0].refusal == "saliency is 1.05; at least 1.1"
