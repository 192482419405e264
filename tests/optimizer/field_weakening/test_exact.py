"""Two-dimensional references against closed forms, brute force and independent random points."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE
from saturated import ArctanMachine, saturated_reluctance, with_drop

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening, monomials
from dqforge.optimizer.field_weakening.form import (
    fit_limit,
    fit_mtpa,
    in_double,
    surface_samples,
    weakening_region,
)
from dqforge.optimizer.field_weakening.voltage_region import voltage_region
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents

LIBRARY = Path(__file__).resolve().parents[3] / "machines" / "library"
BUDGET = 0.005


def _library(name: str) -> Machine:
    return load_design(LIBRARY / f"{name}.yaml").machine


# Least flux linkage in Wb of each case; half the magnet's and less, MTPV among them.
CASES: dict[str, tuple[Machine, float]] = {
    "interior": (IPM, 0.0766),
    "interior, deep": (IPM, 0.03),
    "surface": (SURFACE, 0.07),
    "inverse": (INVERSE_SALIENT, 0.05),
    "reluctance": (RELUCTANCE, 0.2),
    "saturated": (ArctanMachine(), 0.08),
    "syrm": (_library("abb-syrm-6k7-saturated"), 0.234),
    "pmsyrm": (_library("baldor-pmsyrm-5k6"), 0.4135),
}


def bare(machine: Machine) -> Machine:
    """The machine without resistance."""
    assert isinstance(machine, LinearMachine | SaturatedMachine | ArctanMachine)
    return replace(machine, r_s=0.0)


@cache
def fitted(name: str, flash: int = 2048) -> WeakeningFit:
    """The reference of a machine without resistance, where the voltage over the
    speed is the flux linkage.
    """
    machine, flux_min = CASES[name]
    machine = bare(machine)
    return fit_weakening(
        machine,
        machine.i_max,
        300.0 * machine.pole_pairs * flux_min,
        WeakeningSettings(300.0, flash=flash),
    )


def currents(
    fit: WeakeningFit, torque: FloatArray, flux: FloatArray
) -> tuple[FloatArray, FloatArray]:
    i_d, i_q = fit.reference.currents(torque.astype(np.float32), flux.astype(np.float32))
    return i_d.astype(np.float64), i_q.astype(np.float64)


def random_points(fit: WeakeningFit, count: int, seed: int) -> tuple[FloatArray, FloatArray]:
    generator = np.random.default_rng(seed)
    flux = generator.uniform(fit.region.flux_min, 1.05 * fit.region.flux_max, count)
    return generator.uniform(-1.1, 1.1, count) * fit.region.torque_max, flux


def brute_limit(fit: WeakeningFit, flux: FloatArray) -> FloatArray:
    """Largest torque within circle and flux linkage by trying a fine polar grid of currents,
    shape (N,).
    """
    machine, i_max = fit.region.machine, fit.region.i_max
    length = i_max * np.linspace(0.0, 1.0, 700)[:, np.newaxis]
    angle = np.linspace(0.0, np.pi, 1400)
    i_d, i_q = (length * np.cos(angle)).ravel(), (length * np.sin(angle)).ravel()
    taken, torque = np.hypot(*machine.flux(i_d, i_q)), machine.torque(i_d, i_q)
    return np.array([np.max(torque[taken <= available]) for available in flux])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_torque_flux_and_current_stay_within_the_budget_at_random_points(name: str) -> None:
    fit = fitted(name)
    machine, region = fit.region.machine, fit.region
    torque, flux = random_points(fit, 60_000, 5)
    grid = np.linspace(region.flux_min, region.flux_max, 1601)
    most = np.interp(flux, grid, region.largest_torque(grid))
    i_d, i_q = currents(fit, torque, flux)
    error = machine.torque(i_d, i_q) - np.clip(torque, -most, most)
    assert np.max(np.abs(error)) <= BUDGET * region.torque_max
    assert np.max(np.hypot(*machine.flux(i_d, i_q)) / flux) <= 1.0 + BUDGET
    assert np.max(np.hypot(i_d, i_q)) <= (1.0 + BUDGET) * region.i_max
    # The stated errors are those of a grid; points in between may add a little.
    assert np.max(np.abs(error)) <= 1.03 * fit.errors.torque + 1e-6 * region.torque_max


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["interior", "inverse", "saturated", "pmsyrm"])
def test_the_granted_torque_is_the_largest_that_brute_force_finds(name: str) -> None:
    fit = fitted(name)
    flux = np.linspace(fit.region.flux_min, fit.region.flux_max, 25)
    most = brute_limit(fit, flux)
    i_d, i_q = currents(fit, np.full(flux.size, np.inf), flux)
    found = fit.region.machine.torque(i_d, i_q)
    # The grid of currents misses the optimum by a little, always downwards.
    assert np.all(found >= most - BUDGET * fit.region.torque_max)
    assert np.all(found <= most + (BUDGET + 0.01) * fit.region.torque_max)


def test_where_the_flux_linkage_suffices_the_currents_are_those_of_the_closed_form() -> None:
    fit = fitted("interior")
    torque = np.linspace(-0.99, 0.99, 401) * fit.region.torque_max
    i_d, i_q = currents(fit, torque, np.full(torque.size, np.inf))
    exact_d, exact_q = mtpa_currents(IPM, torque)
    assert np.max(np.hypot(i_d - exact_d, i_q - exact_q)) < 0.01 * IPM.i_max


def test_without_torque_the_weakened_current_is_the_straight_line_of_the_closed_form() -> None:
    fit = fitted("interior")
    flux = np.linspace(fit.region.flux_min, 0.99 * IPM.psi_pm, 50)
    i_d, i_q = currents(fit, np.zeros(50), flux)
    assert np.all(i_q == 0.0)
    # |psi| = psi_pm + l_d i_d = a
    assert np.max(np.abs(IPM.psi_pm + IPM.l_d * i_d - flux) / flux) <= BUDGET


@pytest.mark.thinned
@pytest.mark.parametrize("name", CASES)
def test_copper_loss_is_near_the_least(name: str) -> None:
    fit = fitted(name)
    assert 0.0 <= fit.errors.loss_relative < 0.04
    torque, flux = random_points(fit, 2000, 9)
    i_d, i_q = currents(fit, torque, flux)
    made = fit.region.machine.torque(i_d, i_q)
    least = fit.region.points(made, np.maximum(flux, fit.region.flux(i_d, i_q)))
    loaded = least.reached & (np.abs(made) > 0.05 * fit.region.torque_max)
    penalty = (i_d**2 + i_q**2)[loaded] / (least.i_d**2 + least.i_q**2)[loaded] - 1.0
    assert np.max(penalty) < 0.04


@pytest.mark.thinned
@pytest.mark.parametrize("name", CASES)
def test_currents_are_continuous_across_every_seam(name: str) -> None:
    fit = fitted(name)
    reference, region = fit.reference, fit.region
    # Paths that cross breakpoints of the torque, delta = 0 and the limit;
    # the step of a path bounds each jump.
    steps = 200_001
    for level in np.linspace(region.flux_min, region.flux_max, 5):
        torque = np.linspace(-1.02, 1.02, steps) * region.torque_max
        i_d, i_q = currents(fit, torque, np.full(steps, level))
        jump = np.hypot(np.diff(i_d), np.diff(i_q))
        assert np.max(jump) < 2e-3 * region.i_max, level
    for share in (0.2, 0.6, 1.0):
        flux = np.linspace(region.flux_min, region.flux_max, steps)
        i_d, i_q = currents(fit, np.full(steps, share * region.torque_max), flux)
        assert np.max(np.hypot(np.diff(i_d), np.diff(i_q))) < 2e-3 * region.i_max, share
    for start in reference.d.starts[1:]:
        either = np.array([np.nextafter(start, np.float32(0.0)), start], dtype=np.float32)
        sides = np.array(reference.currents(either, np.full(2, np.inf, dtype=np.float32)))
        assert np.hypot(*np.diff(sides).ravel()) < 1e-4 * region.i_max


def test_symmetry_clamping_and_inputs_that_are_no_numbers() -> None:
    fit = fitted("interior")
    reference, region = fit.reference, fit.region
    torque, flux = (values.astype(np.float32) for values in random_points(fit, 500, 3))
    i_d, i_q = reference.currents(torque, flux)
    mirrored_d, mirrored_q = reference.currents(-torque, flux)
    assert np.array_equal(i_d, mirrored_d)
    assert np.array_equal(i_q, -mirrored_q)

    def at(torque: float, flux: float) -> tuple[float, float]:
        d, q = reference.currents(
            np.array([torque], dtype=np.float32), np.array([flux], dtype=np.float32)
        )
        return float(d[0]), float(q[0])

    low, high, end = float(reference.flux_min), float(reference.flux_max), region.torque_max
    assert at(50.0, -1.0) == at(50.0, 0.0) == at(50.0, low)
    assert at(50.0, np.inf) == at(50.0, high)
    assert at(np.inf, 0.1) == at(2.0 * end, 0.1)
    assert at(np.nan, 0.1) == at(0.0, 0.1)
    for asked in (0.0, 50.0, -np.inf, np.nan):
        assert at(asked, np.nan) == at(0.0, low)


PMSYRM = pytest.param("pmsyrm", marks=pytest.mark.slow)


@pytest.mark.parametrize("name", ["interior", PMSYRM])
def test_fused_multiply_add_changes_currents_by_rounding_alone(name: str) -> None:
    fit = fitted(name)
    samples = surface_samples(fit.region, 60)
    plain, fused = (
        np.array(fit.reference.currents(samples.torque, samples.flux, fused=way))
        for way in (False, True)
    )
    assert 0.0 < np.max(np.abs(plain - fused)) < 1e-3 * fit.region.i_max


@pytest.mark.parametrize("name", ["interior", PMSYRM])
def test_the_smallest_candidate_is_taken_and_the_trials_lead_to_it(name: str) -> None:
    fit = fitted(name)
    assert [trial.chosen for trial in fit.trials] == [False] * (len(fit.trials) - 1) + [True]
    assert all(
        first.flash <= second.flash
        for first, second in zip(fit.trials, fit.trials[1:], strict=False)
    )
    for trial in fit.trials[:-1]:
        assert trial.grid_error > 0.95 or (
            trial.errors is not None and trial.errors.torque_relative > BUDGET
        )
    assert fit.step.flash == fit.trials[-1].flash <= 2048


def test_monomials_are_those_under_the_slanted_line() -> None:
    assert monomials(2, 2) == [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)]
    assert monomials(4, 2) == [
        (0, 0),
        (1, 0),
        (2, 0),
        (3, 0),
        (4, 0),
        (0, 1),
        (1, 1),
        (2, 1),
        (0, 2),
    ]


@pytest.mark.slow
def test_a_budget_that_cannot_be_kept_is_refused() -> None:
    needed = fitted("pmsyrm").step.flash
    for flash in (400, 1300, needed - 1):
        with pytest.raises(NoSolutionError, match=f"write flash: {needed} B"):
            fitted("pmsyrm", flash)
    assert fitted("pmsyrm", needed).step.flash == needed


def test_a_speed_that_limits_nothing_or_leaves_nothing_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="limits nothing"):
        weakening_region(IPM, IPM.i_max, 0.2)
    with pytest.raises(NoSolutionError, match="lower the speed"):
        weakening_region(
            IPM, IPM.i_max, 0.004
        )  # psi_pm - l_d i_max = 5.85 mWb is the least that can be reached


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["d", "q"])
@pytest.mark.parametrize("seed", [1, 2, 4])
def test_a_saturated_reluctance_machine_has_a_reference_whatever_its_axes_are_called(
    seed: int, axis: str
) -> None:
    """The q axis once gave an error of 95 % of the torque at every speed, and others were too steep
    at three times the base speed.
    """
    machine, v_max = with_drop(saturated_reluctance(seed, axis), 0.1)
    fit = fit_weakening(machine, machine.i_max, v_max, WeakeningSettings(300.0, flash=4096))
    assert fit.largest_torque_error <= BUDGET * fit.region.torque_max
    assert fit.voltage.voltage_excess <= BUDGET


@pytest.mark.slow
def test_the_flux_linkage_of_the_mtpa_currents_weakens_nothing_that_needs_no_weakening() -> None:
    """Where MTPA currents take less than the least flux linkage, so does the fitted curve."""
    machine, v_max = with_drop(saturated_reluctance(4, "d"), 0.1)
    region = voltage_region(machine, machine.i_max, v_max, 300.0).flux
    mtpa = fit_mtpa(region, 0.002 * region.torque_max, 0.002)
    torque = np.linspace(0.0, region.torque_max, 400)
    taken = region.flux(*region.mtpa(torque))
    below = taken < region.flux_min
    assert np.count_nonzero(below) > 10
    assert np.all(in_double(mtpa.flux, torque)[below] <= region.flux_min * 1.002)


def test_the_limit_bends_where_mtpv_gives_way_to_the_current_next_to_its_end() -> None:
    machine, v_max = with_drop(saturated_reluctance(2, "d"), 0.1)
    region = voltage_region(machine, machine.i_max, v_max, 300.0).flux
    permitted = 0.002 * region.torque_max
    limit = fit_limit(region, permitted)
    flux = np.linspace(region.flux_min, region.flux_max, 500)
    missing = region.largest_torque(flux) - in_double(limit, flux - region.flux_min)
    assert np.max(missing) <= 1.05 * permitted
    assert np.min(missing) >= -0.05 * permitted


def test_currents_of_least_loss_that_jump_are_named() -> None:
    """Saturation that swaps the axes of saliency: no reference follows."""
    machine, v_max = with_drop(saturated_reluctance(0, "d"), 0.1)
    with pytest.raises(NoSolutionError, match=r"jump from \(.*\) A to \(.*lower max_current"):
        fit_weakening(machine, machine.i_max, v_max, WeakeningSettings(150.0))
