"""Choice of modulator and switching frequency: against direct budgets at many frequencies,
within every limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import ModulationName
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget
from dqforge.optimizer.modulation_choice.rule import (
    ChoiceLimits,
    ChoicePoints,
    SimplifiedChoice,
    decide,
    leaves,
    simplify,
)
from dqforge.optimizer.modulation_choice.solve import (
    BestChoice,
    best_choice,
    listed_frequencies,
    permitted_losses,
    rule_quantities,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents

MACHINE = LinearMachine(pole_pairs=4, r_s=20e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
NAMES: tuple[ModulationName, ...] = ("svpwm", "dpwm1", "gdpwm", "spwm")
OPTIONS = BudgetOptions(
    ripple_resistance=40.0
)  # so that the ripple makes a high frequency worth its switching


def drive() -> tuple[Inverter, ChoicePoints]:
    model = device_catalogue.load("sirectifier-sii400s12")
    inverter = Inverter(
        500.0, 8e3, model.switch_device(200.0, 500.0, 100.0, 0.2), 65.0, device_model=model
    )
    torque, speed = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(10.0, 120.0, 8), np.linspace(20.0, 350.0, 8))
    )
    return inverter, ChoicePoints(torque, speed, *mtpa_currents(MACHINE, torque))


def direct_budget(
    inverter: Inverter,
    at: ChoicePoints,
    here: Any,
    names: Sequence[ModulationName],
    frequencies: FloatArray,
) -> DriveBudget:
    i_d, i_q, omega_m = (np.atleast_1d(part[here]) for part in (at.i_d, at.i_q, at.omega_m))
    return drive_budget(MACHINE, inverter, i_d, i_q, omega_m, names, frequencies, options=OPTIONS)


def test_least_loss_is_that_of_a_direct_search() -> None:
    inverter, at = drive()
    limits = ChoiceLimits(2e3, 20e3)
    best = best_choice(MACHINE, inverter, at, NAMES, limits, options=OPTIONS)
    frequencies = np.geomspace(2e3, 20e3, 61)
    direct = direct_budget(inverter, at, slice(None), NAMES, frequencies)
    counted = np.where(direct.feasible, direct.total, np.inf)
    least = np.min(counted, axis=(0, 1))
    assert np.array_equal(best.found, np.isfinite(least))
    assert best.found.mean() > 0.9
    found = best.found
    assert np.all(best.loss[found] <= least[found] * (1.0 + 1e-4))
    assert best.loss[found] == pytest.approx(least[found], rel=2e-3)
    assert len(np.unique(np.round(best.f_sw[found], -3))) > 2  # the best frequency is no constant
    checked = np.flatnonzero(found)[::9]
    again = [
        direct_budget(inverter, at, k, [NAMES[best.modulation[k]]], best.f_sw[k : k + 1])
        for k in checked
    ]
    for k, single in zip(checked, again, strict=True):
        assert best.loss[k] == pytest.approx(float(single.total[0, 0, 0]), rel=1e-4)
        assert best.junction_temperature[k] == pytest.approx(
            float(single.junction_temperature[0, 0, 0]), abs=0.05
        )
        assert best.ripple_current[k] == pytest.approx(
            float(single.ripple_current[0, 0, 0]), rel=1e-9
        )


def test_limits_are_kept_and_cost() -> None:
    inverter, at = drive()

    def best(limits: ChoiceLimits) -> BestChoice:
        return best_choice(MACHINE, inverter, at, NAMES, limits, options=OPTIONS)

    free = best(ChoiceLimits(2e3, 20e3))
    ripple = float(np.nanmedian(free.ripple_current))
    hot = float(np.nanquantile(free.junction_temperature, 0.8))
    calm = best(ChoiceLimits(2e3, 20e3, ripple_max=ripple))
    assert np.nanmax(calm.ripple_current) <= ripple * (1.0 + 1e-9)
    both = free.found & calm.found
    assert np.all(calm.loss[both] >= free.loss[both] * (1.0 - 1e-9))
    assert np.any(calm.loss[both] > free.loss[both] * 1.001)
    cool = best(ChoiceLimits(2e3, 20e3, junction_max=hot))
    assert np.nanmax(cool.junction_temperature) <= hot
    assert cool.found.sum() < free.found.sum() or np.nanmean(cool.loss) >= np.nanmean(free.loss)
    audible = best(ChoiceLimits(16e3, 20e3))
    assert np.nanmin(audible.f_sw) >= 16e3 * (1.0 - 1e-12)


def listed_choice(
    inverter: Inverter, at: ChoicePoints, limits: ChoiceLimits, options: BudgetOptions | None
) -> tuple[tuple[tuple[ModulationName, float], ...], SimplifiedChoice]:
    """Alternatives of a short list, and the rule over torque and speed that takes one of them."""
    frequencies = listed_frequencies(limits)
    loss, kept = permitted_losses(
        MACHINE, inverter, at, NAMES, frequencies, limits, options=options
    )
    alternatives = tuple((name, float(frequency)) for name in NAMES for frequency in frequencies)
    kept = kept.reshape(len(alternatives), -1).T
    loss = np.where(kept, loss.reshape(len(alternatives), -1).T, 0.0)
    return alternatives, simplify(loss, kept, rule_quantities(at), at.weights)


def test_rule_comes_close_and_keeps_the_limits() -> None:
    inverter, at = drive()
    limits = ChoiceLimits(4e3, 16e3, ripple_max=30.0)
    alternatives, rule = listed_choice(inverter, at, limits, OPTIONS)
    assert rule.permitted
    assert 1 <= leaves(rule.rule) <= 4
    assert 0.0 <= rule.price < 0.05
    chosen = decide(rule.rule, {"torque_Nm": at.torque, "speed_rad_per_s": at.omega_m})
    total = 0.0
    for index, (name, frequency) in enumerate(alternatives):
        here = chosen == index
        if here.any():
            budget = direct_budget(inverter, at, here, [name], np.array([frequency]))
            assert np.all(budget.feasible)
            assert np.max(budget.ripple_current) <= 30.0 * (1.0 + 1e-9)
            total += float(np.sum(budget.total))
    assert rule.mean_loss == pytest.approx(total / at.torque.size, rel=1e-9)


def test_one_frequency_and_empty_ranges() -> None:
    inverter, at = drive()
    single = best_choice(MACHINE, inverter, at, NAMES, ChoiceLimits(8e3, 8e3))
    assert set(single.f_sw[single.found]) == {8e3}
    with pytest.raises(InputError, match="from 9000 to 8000 Hz are no range"):
        ChoiceLimits(9e3, 8e3)
    impossible = ChoiceLimits(4e3, 8e3, junction_max=20.0)
    assert not best_choice(MACHINE, inverter, at, NAMES, impossible).found.any()
    with pytest.raises(NoSolutionError, match="no alternative keeps all limits"):
        listed_choice(inverter, at, impossible, None)
