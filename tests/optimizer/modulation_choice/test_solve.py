"""The choice that a design asks for: against budgets made directly, within every limit,
and its price.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drives import IPM, make_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ChoiceSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.modulation.modulators import linear_limit
from dqforge.machines.names import ModulationName
from dqforge.optimizer.losses.drive_budget import DriveBudget
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives
from dqforge.optimizer.modulation_choice.rule import decide, leaves
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, _grid, solve_choice

NAMES: tuple[ModulationName, ...] = ("svpwm", "dpwm1", "dpwm3", "ddt-gdpwm", "spwm")
SETTINGS = ChoiceSettings(
    16e3, 100e3, 942.0, modulations=NAMES, ripple_max=1.0, torques=9, speeds=10
)
CASES = {
    "ripple": SETTINGS,
    "bands": replace(SETTINGS, bands=((18e3, 26e3), (30e3, 38e3))),
    "hot": replace(SETTINGS, junction_max=95.0, ripple_max=None),
    "ratio": replace(SETTINGS, carrier_ratio=50.0, ripple_max=None),
    "id0": replace(SETTINGS, strategy="id0"),
    "one frequency": replace(SETTINGS, f_min=60e3, f_max=60e3),
}


def design(settings: ChoiceSettings | None) -> Design:
    return replace(make_design(IPM), modulation_choice=settings)


@cache
def solved(name: str) -> ModulationChoice:
    found = solve_choice(design(CASES[name]))
    assert found is not None
    return found


def grid(choice: ModulationChoice) -> tuple[np.ndarray, np.ndarray]:
    torque, speed = np.meshgrid(choice.torque, choice.omega_m, indexing="ij")
    return torque.ravel(), speed.ravel()


def direct(
    choice: ModulationChoice, name: ModulationName, frequency: float
) -> tuple[DriveBudget, np.ndarray]:
    """Budget (P,) of one alternative by the comparison of maps, and where its limits are kept."""
    drive, settings = design(choice.settings), choice.settings
    torque, speed = grid(choice)
    alternatives = Alternatives((settings.strategy,), (name,), (frequency,))
    found = compare_drives(
        drive.machine, drive.inverter, torque, speed, alternatives, i_max=drive.i_max
    )
    kept = found.usable[0, 0, 0] & (
        frequency >= settings.carrier_ratio * 4.0 * speed / (2.0 * np.pi) * (1.0 - 1e-9)
    )
    budget = found.budget
    if settings.ripple_max is not None:
        kept &= budget.ripple_current[0, 0, 0] <= settings.ripple_max * (1.0 + 1e-9)
    if settings.junction_max is not None:
        kept &= budget.junction_temperature[0, 0, 0] <= settings.junction_max
    for low, high in settings.bands:
        kept &= not low < frequency < high
    return budget, kept


@pytest.mark.thinned
@pytest.mark.parametrize("name", CASES)
def test_rules_lose_what_direct_budgets_say_and_keep_the_limits(name: str) -> None:
    choice = solved(name)
    torque, speed = grid(choice)
    for rule in choice.rules:
        assert leaves(rule.rule) <= 2**rule.questions
        decided = decide(rule.rule, {"torque_Nm": torque, "speed_rad_per_s": speed})
        assert np.array_equal(rule.taken[choice.asked], decided[choice.asked])
        assert np.all(rule.taken[~choice.asked] == -1)
        total, kept = 0.0, 0
        for index, (modulation, frequency) in enumerate(rule.alternatives):
            budget, permitted = direct(choice, modulation, frequency)
            here = rule.taken == index
            total += float(np.sum(budget.total[0, 0, 0][here]))
            kept += int(np.sum(permitted[here]))
        assert rule.mean_loss == pytest.approx(total / np.sum(choice.asked), rel=1e-9)
        assert rule.kept == pytest.approx(kept / np.sum(choice.asked))
        assert rule.permitted or name == "hot"


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["ripple", "bands", "id0"])
def test_nothing_on_a_fine_grid_beats_the_best_choice(name: str) -> None:
    choice = solved(name)
    least = np.full(choice.asked.size, np.inf)
    for modulation in NAMES:
        for frequency in np.geomspace(16e3, 100e3, 25):
            budget, kept = direct(choice, modulation, float(frequency))
            least = np.minimum(least, np.where(kept, budget.total[0, 0, 0], np.inf))
    found = choice.best.found
    assert np.all(np.isinf(least[~found]))
    assert np.all(choice.best.loss[found] <= least[found] * (1.0 + 2e-4))
    both = found & np.isfinite(least)
    assert choice.best.loss[both] == pytest.approx(
        least[both], rel=0.05
    )  # between the grid's frequencies


def test_the_grid_rises_in_even_steps_from_zero_to_the_largest() -> None:
    settings = CASES["ripple"]
    for nodes, count in zip(
        _grid(design(settings), settings), (settings.torques, settings.speeds), strict=True
    ):
        assert nodes == pytest.approx(nodes[-1] * np.arange(1, count + 1) / count, rel=1e-12)


def test_more_questions_cost_less_and_none_beats_the_best() -> None:
    choice = solved("ripple")
    means = [rule.mean_loss for rule in choice.rules]
    assert means == sorted(means, reverse=True)
    assert choice.best_mean < means[-1]
    assert 0.0 < choice.price(choice.emitted) < 0.05
    assert choice.emitted is choice.rules[2]
    assert choice.simplified().price == pytest.approx(choice.price(choice.emitted))


@pytest.mark.slow
def test_each_answer_has_the_best_frequency_of_its_own() -> None:
    """Of all multiples of 500 Hz that keep the limits everywhere in its part
    of the map none loses less.
    """
    choice = solved("ripple")
    rule = choice.emitted
    for index, (modulation, frequency) in enumerate(rule.alternatives):
        here = rule.taken == index
        mine = float(np.sum(direct(choice, modulation, frequency)[0].total[0, 0, 0][here]))
        for other in np.arange(16e3, 60e3, 500.0):
            budget, kept = direct(choice, modulation, float(other))
            if np.all(kept[here]):
                assert float(np.sum(budget.total[0, 0, 0][here])) >= mine * (1.0 - 5e-3)


def test_bands_are_avoided_and_bind() -> None:
    choice = solved("bands")
    used = [frequency for rule in choice.rules for _, frequency in rule.alternatives]
    for frequency in [*used, *choice.best.f_sw[choice.best.found].tolist()]:
        assert not 18e3 < frequency < 26e3
        assert not 30e3 < frequency < 38e3
    assert np.any(choice.best.f_sw == 38e3)
    assert np.any(choice.best.binding["avoided band"])
    assert choice.best_mean > solved("ripple").best_mean


def test_limits_bind_where_they_are_what_costs() -> None:
    """Ripple and carrier ratio of what is taken lie at their limits; without limits
    the frequency is the least.
    """
    ripple, best = solved("ripple"), solved("ripple").best
    bound = best.binding["ripple"]
    assert np.mean(bound[ripple.asked]) > 0.6
    assert np.all(best.ripple_current[bound] > 0.985)
    ratio, wanted = solved("ratio").best, solved("ratio").best.binding["carrier ratio"]
    _, speed = grid(solved("ratio"))
    assert np.any(wanted)
    assert ratio.f_sw[wanted] == pytest.approx(50.0 * 4.0 * speed[wanted] / (2.0 * np.pi), rel=0.02)
    free = solve_choice(design(replace(SETTINGS, ripple_max=None)))
    assert free is not None
    assert np.all(free.best.f_sw[free.best.found] == 16e3)
    assert np.all(free.best.binding["least frequency"][free.best.found])
    assert not np.any(free.best.binding["ripple"])


def test_points_too_hot_are_left_out() -> None:
    hot = solved("hot")
    assert np.nanmax(hot.best.junction_temperature) <= 95.0
    cut = hot.reached & ~hot.asked
    assert np.any(cut)
    assert np.all(hot.best.binding["junction"][hot.reached & ~hot.best.found])


def test_a_modulator_of_small_range_weakens_the_field_of_its_own() -> None:
    """SPWM reaches less: beyond its range it has more current, or none, while SVPWM goes on."""
    only = solve_choice(design(replace(SETTINGS, modulations=("spwm",), ripple_max=None)))
    both = solve_choice(design(replace(SETTINGS, modulations=("spwm", "svpwm"), ripple_max=None)))
    assert only is not None
    assert both is not None
    assert linear_limit("spwm", 500.0) < linear_limit("svpwm", 500.0)
    assert np.sum(only.reached) < np.sum(both.reached)


def test_the_design_of_today_is_priced_with_its_own_modulator() -> None:
    choice = solved("ripple")
    budget, kept = direct(choice, "svpwm", 100e3)
    assert choice.today.alternatives == (("svpwm", 100e3),)
    assert choice.today.mean_loss == pytest.approx(
        np.mean(budget.total[0, 0, 0][choice.asked]), rel=1e-9
    )
    assert choice.today.kept == pytest.approx(np.mean(kept[choice.asked]))
    other = solve_choice(design(replace(SETTINGS, modulations=("dpwm1",))))
    assert other is not None
    assert other.today.alternatives == (("svpwm", 100e3),)
    assert set(np.unique(other.best.modulation)) <= {-1, 0}


def test_ripple_in_the_winding_asks_for_higher_frequencies() -> None:
    calm = solve_choice(design(replace(SETTINGS, ripple_max=None, ripple_resistance=3000.0)))
    assert calm is not None
    assert np.nanmax(calm.best.f_sw) > 20e3
    assert np.any(~calm.best.binding["least frequency"][calm.best.found])


def test_without_the_section_there_is_nothing_and_without_a_way_out_an_error() -> None:
    assert solve_choice(design(None)) is None
    with pytest.raises(NoSolutionError, match="modulation_choice: at no torque and speed"):
        solve_choice(design(replace(SETTINGS, ripple_max=1e-4)))


def test_without_field_weakening_the_voltage_ends_the_map() -> None:
    """At i_d = 0 what the linear range cannot make counts as out of reach,
    not as a limit that is broken.
    """
    choice = solved("id0")
    torque, speed = grid(choice)
    i_q = torque / (6.0 * 0.1049)
    volts = 4.0 * speed * np.hypot(0.1049, 592e-6 * i_q)  # but for the resistance
    limit = linear_limit("svpwm", 500.0)
    assert not np.any(choice.reached[volts > 1.01 * limit])
    within = (volts < 0.97 * limit) & (i_q <= 283.0)
    assert np.all(choice.reached[within])
    assert np.array_equal(choice.reached, choice.asked)
