"""Field-weakening references with the resistance drop: what they grant and prove,
and machines without saliency.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening import voltage_region as surface_voltage
from dqforge.optimizer.field_weakening.certificate import certify_step
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, STEPS
from dqforge.optimizer.operating_points.points import optimal_points

RPM = np.pi / 30.0
SERVO = LinearMachine(
    pole_pairs=4, r_s=0.09, l_d=1e-4, l_q=1e-4, psi_pm=6.4e-3, i_max=15.0, inertia=1e-6
)
CASES = {
    "servo": (SERVO, 13.86, 5000.0 * RPM),
    "servo with mtpv": (replace(SERVO, l_d=6e-4, l_q=6e-4), 13.86, 9000.0 * RPM),
    "reluctance": (
        LinearMachine(
            pole_pairs=2, r_s=2.5, l_d=41.5e-3, l_q=6.2e-3, psi_pm=0.0, i_max=8.0, inertia=1e-2
        ),
        100.0,
        3000.0 * RPM,
    ),
}
NAMES = [
    pytest.param(name, marks=() if name == "servo with mtpv" else pytest.mark.slow)
    for name in CASES
]


@cache
def fitted(name: str) -> WeakeningFit:
    machine, v_max, omega_m = CASES[name]
    return fit_weakening(machine, machine.i_max, v_max, WeakeningSettings(omega_m, flash=3000))


def inputs(fit: WeakeningFit, seed: int, count: int = 200_000) -> tuple[SingleArray, ...]:
    """Torques to beyond the largest, voltages from the least, speeds to the largest in proportion,
    either sign.
    """
    generator = np.random.default_rng(seed)
    share = generator.choice([LEAST_VOLTAGE, 1.0, 1.5], count)
    speed = share * fit.domain.omega_e * generator.uniform(-1.0, 1.0, count) * (1.0 - 1e-6)
    torque = generator.uniform(-1.2, 1.2, count) * fit.region.torque_max
    return (
        torque.astype(np.float32),
        (share * fit.domain.v_max).astype(np.float32),
        speed.astype(np.float32),
    )


def excess(fit: WeakeningFit, seed: int) -> float:
    """Largest |v|/v_max - 1, by the equations written out once more."""
    machine = fit.region.machine
    torque, volts, speed = inputs(fit, seed)
    i_d, i_q = (part.astype(np.float64) for part in fit.step.currents(torque, volts, speed))
    omega = speed.astype(np.float64)
    psi_d, psi_q = machine.flux(i_d, i_q)
    taken = np.hypot(machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d)
    return float(np.max(taken / volts)) - 1.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_voltage_stays_below_its_bound_which_is_near(name: str) -> None:
    fit = fitted(name)
    assert fit.certificate is not None
    bound = fit.certificate.voltage_excess
    assert bound is not None
    found = max(excess(fit, 3), fit.voltage.voltage_excess)
    assert found <= bound <= 3.0 * found


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_what_is_beyond_reach_gets_the_largest_torque_in_every_region(name: str) -> None:
    """Current limit, both limits, MTPV; motoring and generating; either direction."""
    fit, (machine, v_max, _) = fitted(name), CASES[name]
    speed = np.linspace(-1.0, 1.0, 120).astype(np.float32) * np.float32(
        fit.domain.omega_e * (1.0 - 1e-6)
    )
    for sign in (-1.0, 1.0):
        torque = np.full(speed.shape, sign * np.inf, dtype=np.float32)
        volts = np.full(speed.shape, v_max, dtype=np.float32)
        i_d, i_q = (part.astype(np.float64) for part in fit.step.currents(torque, volts, speed))
        best = optimal_points(
            machine,
            np.full(speed.shape, sign * 2.0 * fit.region.torque_max),
            speed.astype(np.float64) / machine.pole_pairs,
            v_max=volts.astype(np.float64),
            i_max=machine.i_max,
        )
        assert (
            np.max(np.abs(machine.torque(i_d, i_q) - best.torque)) <= 0.005 * fit.region.torque_max
        )


def test_beyond_the_largest_speed_torque_is_given_up_before_the_voltage() -> None:
    fit = fitted("servo with mtpv")
    speed = fit.domain.omega_e * np.linspace(1.0, 1.07, 50)
    torque = np.full(50, np.inf, dtype=np.float32)
    volts = np.full(50, fit.domain.v_max, dtype=np.float32)
    granted, flux, _, _ = fit.step.granted(torque, volts, speed.astype(np.float32))
    assert np.all(np.diff(granted) <= 0.0)
    assert granted[-1] < 0.5 * granted[0]
    assert np.all(flux >= fit.reference.flux_min)
    i_d, i_q = (
        part.astype(np.float64)
        for part in fit.step.currents(torque, volts, speed.astype(np.float32))
    )
    machine = fit.region.machine
    taken = np.sqrt(fit.domain.squared_voltage(i_d, i_q, speed))
    some = granted > 1e-3 * fit.region.torque_max
    assert np.max(taken[some] / volts[some]) <= 1.005
    assert machine.torque(i_d, i_q)[0] > 0.0


def test_trials_end_within_their_resolution_of_the_limit() -> None:
    fit = fitted("servo with mtpv")
    torque, volts, speed = inputs(fit, 5, 20_000)
    step = fit.step
    granted, flux, left, _ = step.granted(torque, volts, speed)
    asked = np.minimum(np.abs(torque), step.torque_max)
    short = granted < asked
    assert np.count_nonzero(short) > 1000
    # A little more than what was granted cannot be had: tried with the very operations.
    more = granted + np.float32(2.0 ** -(STEPS - 3)) * asked
    again, _, _, _ = step.granted(np.where(torque < 0.0, -more, more), volts, speed)
    assert np.all(again[short] < more[short])
    assert np.all(granted >= 0.0)
    assert np.all(flux >= fit.reference.flux_min)
    assert np.all(np.isfinite(left))


@pytest.mark.parametrize("part", ["more", "less", "flux", "current"])
def test_a_bound_without_one_of_its_terms_is_lower(part: str) -> None:
    """Each term counts: on made-up boxes the bound falls when the term does,
    and equals the worst of all drops.
    """
    fit = fitted("servo with mtpv")
    machine, i_max = fit.region.machine, fit.region.i_max
    generator = np.random.default_rng(6)
    count, k = 4000, 1.0 / (1.5 * machine.pole_pairs)
    a = generator.uniform(fit.region.flux_min, fit.region.flux_max, count)
    t = generator.uniform(0.3, 1.0, count) * a * i_max / k * 0.5
    terms = {
        "more": np.full(count, 0.002 * fit.region.torque_max),
        "less": np.full(count, 0.0 if part == "more" else 0.002 * fit.region.torque_max),
        "flux": np.full(count, 0.0 if part == "more" else 0.004),
        "current": np.full(count, (1.0 if part == "more" else 1.05) * i_max**2),
    }
    whole = surface_voltage.Taken(t, t, a, a, **terms)
    step = replace(fit.step, near=None)
    bound = surface_voltage.voltage_excess(fit.domain, step, whole)
    fewer = surface_voltage.Taken(
        t, t, a, a, **(terms | {part: terms[part] * (0.5 if part == "current" else 0.0)})
    )
    lower = surface_voltage.voltage_excess(fit.domain, step, fewer)
    assert np.all(lower <= bound)
    assert np.any(lower < bound * (1.0 - 1e-6))
    # By brute force over the speed, which stands for z, the bound holds for both directions.
    r_s, least = machine.r_s, LEAST_VOLTAGE * fit.domain.v_max
    for share in np.linspace(0.05, 1.0, 200):
        omega = share * 3.0 * least / a
        for sign, error in ((1.0, terms["more"]), (-1.0, -terms["less"])):
            squared = omega**2 * a**2 + 2.0 * r_s * omega * sign * k * t + (r_s * i_max) ** 2
            volts = np.maximum(squared, least**2)
            made = (
                omega**2 * a**2 * (1.0 + terms["flux"])
                + 2.0 * r_s * omega * sign * k * (t + error)
                + r_s**2 * terms["current"]
            )
            possible = (k * (t + np.abs(error)) <= a * i_max) & (squared > 0.0)
            assert np.all(((made - squared) / volts <= bound + 1e-9)[possible])


@pytest.mark.parametrize(
    "saliency", [0.0, *(pytest.param(x, marks=pytest.mark.slow) for x in (1e-4, 1e-2))]
)
@pytest.mark.parametrize(
    "reaction", [0.02, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.01, 0.05, 0.15, 0.6))]
)
def test_bounds_of_machines_without_saliency_are_near_what_is_found(
    reaction: float, saliency: float
) -> None:
    """l i_max / psi_pm small: the flux linkage hardly changes with the current,
    which the limit alone holds.
    """
    psi_pm, i_max, pole_pairs = 0.05, 20.0, 4
    l_d = reaction * psi_pm / i_max
    least, most = psi_pm * (1.0 - reaction), psi_pm * np.hypot(1.0, reaction)
    v_max = 300.0 * pole_pairs * (0.85 * least + 0.15 * most)
    machine = LinearMachine(
        pole_pairs=pole_pairs,
        r_s=0.0,
        l_d=l_d,
        l_q=l_d * (1.0 + saliency),
        psi_pm=psi_pm,
        i_max=i_max,
        inertia=1e-4,
    )
    fit = fit_weakening(machine, i_max, v_max, WeakeningSettings(300.0))
    proof, errors = fit.certificate, fit.errors
    assert proof is not None
    assert (
        errors.current_excess
        <= proof.current_excess
        <= 2.0 * max(errors.current_excess, 0.0) + 2e-6
    )
    assert errors.flux_excess <= proof.flux_excess <= 2.0 * max(errors.flux_excess, 0.0) + 2e-6
    # Sampled generously, not on the grid of the stated errors.
    generator = np.random.default_rng(8)
    flux = generator.uniform(fit.region.flux_min, fit.region.flux_max, 200_000).astype(np.float32)
    torque = (generator.uniform(0.0, 1.05, flux.size) * fit.region.torque_max).astype(np.float32)
    i_d, i_q = (part.astype(np.float64) for part in fit.reference.currents(torque, flux))
    assert np.max(np.hypot(i_d, i_q)) / i_max - 1.0 <= proof.current_excess


@pytest.mark.slow
def test_the_certificate_of_a_step_sees_a_reserve_that_is_too_small() -> None:
    """Half of what the current takes: the voltage then leaves its limit, and the bound says so."""
    fit = fitted("servo with mtpv")
    careless = replace(
        fit, step=replace(fit.step, reserve=np.float32(0.5) * fit.step.reserve, near=None, passes=1)
    )
    found = excess(careless, 9)
    assert found > 1.5 * fit.voltage.voltage_excess
    bounds = certify_step(careless.domain, careless.step)
    assert bounds is not None
    assert bounds.voltage_excess is None or bounds.voltage_excess >= found
