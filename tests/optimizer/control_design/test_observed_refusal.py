"""Speed loops that do not hold on their observer are refused, and sensorless control where a corner
is unstable; what the words promise is so.
"""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design import speed_range
from dqforge.optimizer.control_design.design_drive import top_speed
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.observed_remedies import _narrower, require_observed
from dqforge.optimizer.control_design.speed_range import corner_box
from dqforge.optimizer.loops.observed_margins import (
    Corner,
    CornerJudgement,
    FailingCorner,
    SpeedRange,
)
from dqforge.reports.answers.check import answer_check
from dqforge.reports.observers.speed_loop_text import (
    corner_words,
    leaving_notes,
    observed_notes,
    plain_observed,
)

_SCENARIO = """simulation:
  duration: 0.5 s
  speed: {points: [{time: 0 s, speed: 900 rpm}]}
  sensorless: {above: ABOVE rpm, below: 50 rpm}
"""


def flux_template(spread: str = "", above: str = "", tolerances: str = "") -> Design:
    text = catalogue.template().decode()
    text = text.replace("    pole: 400 rad/s\n", f"    method: flux\n{tolerances}")
    text = text.replace("    spread: 3\n", spread)
    return load_text(
        (text + (_SCENARIO.replace("ABOVE", above) if above else "")).encode(), "t.yaml"
    )


@pytest.fixture(scope="module")
def unstable() -> tuple[Design, GainSet]:
    design = flux_template("    spread: 3\n")
    return design, solve_gains(design)


@pytest.fixture(scope="module")
def chosen() -> tuple[Design, GainSet]:
    design = flux_template()
    return design, solve_gains(design)


def refused_with(unstable: tuple[Design, GainSet]) -> tuple[str, float, float]:
    """What is said of the unstable drive, with the spread and the bandwidth that it names."""
    with pytest.raises(NoSolutionError) as refused:
        require_observed(*unstable)
    text = refused.value.message
    spread = re.findall(r"to be stable it holds from control.speed_loop.spread = ([\d.]+)", text)
    least = re.findall(r"control.observer.pll_bandwidth = ([\d.]+) rad/s", text)
    return text, float(spread[0]), float(least[0])


def test_an_unstable_loop_is_refused_with_its_swing_and_what_holds(
    unstable: tuple[Design, GainSet],
) -> None:
    text, _, _ = refused_with(unstable)
    assert "is unstable at 1250 rpm (margin -33.7 deg" in text
    hertz, rpm = (
        float(found)
        for found in re.findall(r"swings at ([\d.]+) Hz, the speed by ([\d.]+) rpm", text)[0]
    )
    torque = 1.5 * 3 * 0.06 * 6.4
    swing = 8.0 * torque / (np.pi * 200e-6 * 2.0 * np.pi * hertz) * 30.0 / np.pi
    assert rpm == pytest.approx(swing, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "stable"), [(1.0, True), (0.99, False)])
def test_what_the_refusal_names_holds_and_less_does_not(
    unstable: tuple[Design, GainSet], factor: float, stable: bool
) -> None:
    _, spread, least = refused_with(unstable)
    design, control = unstable[0], unstable[0].control
    assert control.speed_loop is not None
    assert control.observer is not None
    loop = replace(control.speed_loop, spread=spread * factor)
    found = solve_gains(replace(design, control=replace(control, speed_loop=loop))).speed
    assert found is not None
    assert found.stable == stable
    observer = replace(control.observer, pll_bandwidth=least * factor)
    found = solve_gains(replace(design, control=replace(control, observer=observer))).speed
    assert found is not None
    assert found.stable == stable


@pytest.mark.parametrize("limit", [0.37, 0.9, 0.0])
def test_the_share_of_the_tolerances_is_bisected_at_both_speeds(
    unstable: tuple[Design, GainSet], limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a stand-in for the loop, which holds up to a share of the resistance's error."""
    speeds, braking = set(), set()
    full = max(corner_box(unstable[0]).limits["r_s"])

    def stand_in(*asked: object) -> SimpleNamespace:
        corners, omega, bounds = asked[3], asked[4], asked[5]
        assert isinstance(corners, tuple)
        speeds.add(omega)
        braking.add(len(corners))
        assert bounds == (np.inf, corner_box(unstable[0]).most_error)
        share = max(corner.errors.get("r_s", 0.0) for corner in corners) / full
        return SimpleNamespace(why=None if share <= limit else "unstable")

    monkeypatch.setattr(speed_range, "worst_corner", stand_in)
    found = _narrower(*unstable)
    assert found <= limit
    assert found > limit - 1.0 / 60.0
    top = top_speed(unstable[0])
    assert speeds <= {top, 0.4 * top}
    assert top in speeds
    if limit > 0.0:
        assert len(speeds) == 2
    (count,) = braking
    box = corner_box(unstable[0])
    both = [
        *box.corners(dead_time=False),
        *box.corners(dead_time=False, braking=True),
    ]
    assert count == len(both)


def test_check_refuses_what_a_run_would(unstable: tuple[Design, GainSet]) -> None:
    with pytest.raises(NoSolutionError, match="is unstable at 1250 rpm"):
        answer_check(unstable[0])


def test_an_encoder_or_a_speed_observer_is_never_refused() -> None:
    design = load_text(catalogue.template(), "t.yaml")
    require_observed(design, solve_gains(design))
    bare = replace(design, control=replace(design.control, observer=None))
    require_observed(bare, solve_gains(bare))
    require_observed(bare, None)


def test_the_rule_gives_the_template_sixty_degrees_at_54_rad_per_s(
    chosen: tuple[Design, GainSet],
) -> None:
    design, gains = chosen
    require_observed(design, gains)
    assert gains.speed is not None
    found = gains.speed.observed
    assert found is not None
    assert np.degrees(found.phase_margin) == pytest.approx(61.9, abs=0.7)
    assert found.crossover == pytest.approx(54.0, abs=1.0)
    assert any("speed_loop.spread is taken as 4" in text for text in design.assumptions)
    assert any("speed_gain is taken as 1" in text for text in design.assumptions)


def test_words_and_json_name_the_lowest_speed_and_the_corner_below_it(
    chosen: tuple[Design, GainSet],
) -> None:
    speed = chosen[1].speed
    assert speed is not None
    assert speed.observed is not None
    corners = speed.observed.corners
    assert corners is not None
    assert not corners.named
    assert corners.exact.below is not None
    plain = plain_observed(speed)["observed"]["corners"]
    assert plain["exact"]["low_rad_per_s"] == corners.exact.low
    assert plain["exact"]["failing_below"]["errors"] == corners.exact.below.corner.errors
    assert plain["exact"]["corners"] == 2**4 * 2
    words = corner_words(speed)[0]
    assert f"stable from {corners.exact.low / 2.0 / np.pi:.4g} Hz" in words
    assert corners.exact.below.corner.words in words
    notes = " ".join(observed_notes(speed))
    assert "the usual tolerances (r_s -30 to +30 %" in notes
    assert "an indication: with 2.29 V of dead time" in notes


def test_sensorless_control_below_the_lowest_speed_is_refused(
    chosen: tuple[Design, GainSet],
) -> None:
    design, gains = flux_template(above="100"), chosen[1]
    with pytest.raises(InputError) as refused:
        require_observed(design, gains)
    text = refused.value.message
    assert "simulation.sensorless.above is 100 rpm" in text
    assert "of the usual tolerances (control.tolerances names none)" in text
    assert gains.speed is not None
    assert gains.speed.observed is not None
    corners = gains.speed.observed.corners
    assert corners is not None
    assert corners.exact.below is not None
    assert corners.exact.below.corner.words in text
    least = re.findall(r"write (\d+) rpm or more", text)[0]
    assert float(least) * np.pi / 10.0 == pytest.approx(corners.exact.low, rel=0.01)
    require_observed(flux_template(above=least), gains)


def test_what_holds_at_no_speed_is_refused_with_and_without_a_simulation(
    chosen: tuple[Design, GainSet], monkeypatch: pytest.MonkeyPatch
) -> None:
    from dqforge.optimizer.control_design import observed_remedies

    monkeypatch.setattr(observed_remedies, "remedies", lambda *_: ["less"])
    gains = chosen[1]
    assert gains.speed is not None
    assert gains.speed.observed is not None
    nowhere = CornerJudgement(
        True, {"r_s": (-0.3, 0.3)}, (0.0,), SpeedRange(np.nan, np.nan, None, 2)
    )
    observed = replace(gains.speed.observed, corners=nowhere)
    broken = replace(gains, speed=replace(gains.speed, observed=observed))
    for design in (flux_template(above="100"), flux_template()):
        with pytest.raises(NoSolutionError, match="no speed at which it holds; write less"):
            require_observed(design, broken)


def judged_as(gains: GainSet, corners: CornerJudgement) -> GainSet:
    assert gains.speed is not None
    assert gains.speed.observed is not None
    observed = replace(gains.speed.observed, corners=corners)
    return replace(gains, speed=replace(gains.speed, observed=observed))


BRAKES = FailingCorner(60.0, Corner({"r_s": 0.3}, -0.5), float("inf"))


def test_a_corner_that_fails_while_braking_is_refused_by_its_name(
    chosen: tuple[Design, GainSet],
) -> None:
    """Motoring holds from 10 rad/s on, braking from 62.8 rad/s: 200 rpm of three pole pairs."""
    motoring, braking = SpeedRange(10.0, 1e3, None, 4), SpeedRange(62.8, 1e3, BRAKES, 2)
    corners = CornerJudgement(True, {"r_s": (-0.3, 0.3)}, (0.0, 0.5), motoring, braking=braking)
    gains = judged_as(chosen[1], corners)
    with pytest.raises(
        InputError, match=r"R \+30 %, load -0.5 N m: no steady state; write 200 rpm"
    ):
        require_observed(flux_template(above="199"), gains)
    require_observed(flux_template(above="200"), gains)


@pytest.mark.slow
def test_a_drive_that_stays_on_its_observer_below_the_lowest_speed_is_remarked(
    chosen: tuple[Design, GainSet],
) -> None:
    """It is handed over where all holds, and leaves the observer at 50 rpm."""
    design = flux_template(above="700")
    answered = answer_check(design)
    notes = " ".join(answered.tables[0].notes)
    assert "leaves the drive on its observer down to 2.5 Hz (electrical)" in notes
    speed = chosen[1].speed
    assert speed is not None
    assert speed.observed is not None
    corners = speed.observed.corners
    assert corners is not None
    assert corners.exact.below is not None
    assert corners.exact.below.corner.words in notes
    assert leaving_notes(speed) == ()  # without a simulation
    held = replace(corners, leaves=corners.binding.low)
    assert not held.left_unstable
    assert replace(corners, leaves=0.9 * corners.binding.low).left_unstable


def test_a_corner_is_said_with_all_that_is_wrong() -> None:
    corner = Corner({"r_s": 0.3, "psi_pm": -0.04, "inertia": 0.2}, 0.5, 1.25)
    assert corner.words == "R +30 %, psi -4 %, J +20 %, load 0.5 N m, dead time 1.25 V"
    assert Corner({}, 0.0).words == "no load"


@pytest.mark.slow
def test_a_compensated_dead_time_takes_half_the_speed_gain_and_named_tolerances_count() -> None:
    box = "  tolerances: {r_s: 30 %, psi_pm: 4 %, dead_time: 100 ns}\n"
    design = flux_template(tolerances=box)
    assert design.control.observer is not None
    assert design.control.observer.speed_gain == 0.5
    speed = solve_gains(design).speed
    assert speed is not None
    assert speed.observed is not None
    corners = speed.observed.corners
    assert corners is not None
    assert corners.named
    assert corners.limits == {"r_s": (-0.3, 0.3), "psi_pm": (-0.04, 0.04)}
    assert corners.exact.corners == 8
    # a compensation that leaves a tenth of 1 us either way
    assert sorted(corners.lost) == pytest.approx([-0.229, 0.229], abs=1e-3)
