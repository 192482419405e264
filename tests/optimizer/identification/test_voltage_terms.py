"""Rides that were made of known machines: what is found, how sure, and what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_files import slow_noise

from dqforge.optimizer.identification.parameters import Analysis, Parameter
from dqforge.optimizer.identification.voltage_terms import (
    SteadyRows,
    _at_least,
    _Model,
    _rounding,
    analyse_rows,
    rows_fault,
    voltage_columns,
)

TRUTH = {
    "resistance": 68.6e-3,
    "magnet_flux": 29.92e-3,
    "cross_saturation": -15.5e-6,
    "inductance_d": 199e-6,
    "inductance_q": 210e-6,
    "inverter_voltage": 38e-3,
}


def ride(seed: int, *, range_k: float = 0.0, alpha: float = 0.00393, rows: int = 900) -> SteadyRows:
    """A ride of a hub motor, as section 1.2 of the notes has them: slow speed and current, slow
    residuals.
    """
    rng = np.random.default_rng(seed)
    omega_e = 15.0 * (20.0 + slow_noise(rng, rows, 0.99, 12.0))
    i_q = 8.0 + slow_noise(rng, rows, 0.95, 14.0)
    i_d = -np.abs(slow_noise(rng, rows, 0.98, 2.0))
    temperature = 30.0 + np.linspace(0.0, range_k, rows)
    along = (i_d + 1j * i_q) / np.hypot(i_d, i_q)
    warm = TRUTH["resistance"] * (1.0 + alpha * (temperature - 20.0))
    psi_d = (
        TRUTH["magnet_flux"] + TRUTH["cross_saturation"] * np.abs(i_q) + TRUTH["inductance_d"] * i_d
    )
    drop = TRUTH["inverter_voltage"]
    u_q = warm * i_q + omega_e * psi_d + drop * along.imag + slow_noise(rng, rows, 0.8, 0.075)
    u_d = warm * i_d - omega_e * TRUTH["inductance_q"] * i_q + drop * along.real
    u_d += slow_noise(rng, rows, 0.8, 0.05)
    series = np.zeros(rows, dtype=np.intp)
    return SteadyRows(("ride",), series, omega_e, i_q, u_q, i_d, u_d, temperature)


def analysed(rows: SteadyRows) -> Analysis:
    return analyse_rows(rows, {}, reference=True)


def found(analysis: Analysis, key: str) -> Parameter:
    parameter = analysis.of(key)
    assert parameter is not None
    return parameter


def test_intervals_hold_the_truth() -> None:
    held: dict[str, list[bool]] = {}
    for seed in range(40):
        analysis = analysed(replace(ride(seed), temperature=None))
        for key, value in TRUTH.items():
            one = found(analysis, key)
            warm = 1.0393 if key == "resistance" else 1.0
            if np.isfinite(one.value):
                held.setdefault(key, []).append(one.low <= warm * value <= one.high)
    assert {key: np.mean(each) for key, each in held.items() if np.mean(each) < 0.85} == {}
    assert np.mean(np.concatenate(list(held.values()))) > 0.91
    assert len(held["cross_saturation"]) > 30


def both_ways(seed: int, angle: float) -> SteadyRows:
    """A ride in both directions, logged by an encoder that is ``angle`` rad off."""
    rows = ride(seed)
    assert rows.i_d is not None
    rng = np.random.default_rng(1000 + seed)  # noise that is not the current's
    omega_e = 300.0 * np.sin(np.arange(rows.i_q.size) / 40.0)
    i = rows.i_d + 1j * (rows.i_q - np.mean(rows.i_q))
    psi = (
        TRUTH["magnet_flux"] + TRUTH["inductance_d"] * i.real + 1j * TRUTH["inductance_q"] * i.imag
    )
    u = TRUTH["resistance"] * i + 1j * omega_e * psi + TRUTH["inverter_voltage"] * i / np.abs(i)
    u = u + slow_noise(rng, i.size, 0.8, 0.06) + 1j * slow_noise(rng, i.size, 0.8, 0.06)
    back = np.exp(-1j * angle)
    i, u = i * back, u * back
    return replace(
        rows, omega_e=omega_e, i_d=i.real, i_q=i.imag, u_d=u.real, u_q=u.imag, temperature=None
    )


@pytest.mark.parametrize("angle", [0.0, -0.02, 0.3])
def test_the_angle_of_the_encoder(angle: float) -> None:
    hits: dict[str, int] = {}
    for seed in range(10):
        analysis = analysed(both_ways(seed, angle))
        for key in ("encoder_angle", "resistance", "magnet_flux", "inductance_q"):
            one = found(analysis, key)
            truth = angle if key == "encoder_angle" else TRUTH[key]
            hits[key] = hits.get(key, 0) + (one.low <= truth <= one.high)
            assert one.status == "identified"
        assert any("deg off" in text for text in analysis.remarks) == (abs(angle) > 0.01)
    assert min(hits.values()) >= 8, hits


def test_one_direction_shows_no_angle() -> None:
    rows = both_ways(1, 0.05)
    analysis = analysed(rows.some(rows.omega_e > 0.0))
    one = found(analysis, "encoder_angle")
    assert one.status == "not identified"
    assert "both directions" in one.why


def held(current: float, seed: int) -> SteadyRows:
    """A ride whose d current was held, but for its ripple."""
    rows = ride(seed)
    assert rows.i_d is not None
    i_d = current + np.random.default_rng(seed).normal(0.0, 0.05, rows.i_d.size)
    psi = TRUTH["inductance_d"] * (i_d - rows.i_d)
    return replace(rows, temperature=None, i_d=i_d, u_q=rows.u_q + rows.omega_e * psi)


@pytest.mark.parametrize("told", [None, (199e-6, 2e-6, "steps"), (230e-6, 20e-6, "a data sheet")])
def test_a_d_current_that_was_held_is_no_magnet(told: tuple[float, float, str] | None) -> None:
    """2 A are 0.4 mWb, 1.3 % of psi_pm and five times its interval."""
    hits = 0
    for seed in range(10):
        analysis = analyse_rows(held(-2.0, seed), {}, reference=True, inductance_d=told)
        one = found(analysis, "magnet_flux")
        hits += one.low <= TRUTH["magnet_flux"] <= one.high
        assert any("is not part of psi_pm" in text for text in analysis.remarks)
    assert hits >= 8
    blind = analyse_rows(replace(held(-2.0, 1), u_d=None), {}, reference=True)
    assert any("psi_pm holds L_d times that" in text for text in blind.remarks)


def test_copper_is_recognised_and_what_is_none_too() -> None:
    copper = analysed(ride(1, range_k=60.0))
    one = found(copper, "temperature_coefficient")
    assert one.status == "identified"
    assert one.low < 0.00393 < one.high
    assert any("is that of copper" in text for text in copper.remarks)
    other = analysed(ride(0, range_k=60.0, alpha=0.0018))
    assert any("is not that of copper" in text for text in other.remarks)


def test_a_coefficient_needs_a_range_of_temperature() -> None:
    one = found(analysed(ride(1, range_k=3.7)), "resistance_slope")
    assert one.status == "not identified"
    assert "3.7 K" in one.why


def test_one_quadrant_holds_no_resistance() -> None:
    rows = ride(2)
    driving = rows.some((rows.i_q > 1.0) & (rows.omega_e > 20.0))
    one = found(analysed(driving), "resistance")
    assert one.status == "not identified"
    assert "only motoring rows" in one.why


def test_one_amplitude_holds_no_resistance() -> None:
    rows = ride(3)
    i_q = 10.0 * np.sign(rows.i_q)
    u_q = 0.07 * i_q + 0.03 * rows.omega_e + 0.2 * np.sign(i_q)
    still = replace(rows, i_q=i_q, u_q=u_q, i_d=None, u_d=None, temperature=None)
    one = found(analysed(still), "resistance")
    assert one.status == "not identified"
    assert "one amplitude of the current" in one.why


def test_the_angle_of_the_encoder_is_never_identified() -> None:
    one = found(analysed(ride(4)), "encoder_angle")
    assert one.status == "not identified"


def test_a_known_value_that_is_sqrt_3_off_is_named() -> None:
    flux = TRUTH["magnet_flux"] * np.sqrt(3.0)
    analysis = analyse_rows(ride(5), {"magnet_flux": (flux, "machine.kv")}, reference=True)
    (text,) = analysis.contradictions
    assert "a factor of 1.73 (near sqrt(3): line-to-line taken for phase" in text


def test_rows_without_a_current_or_in_step_with_the_speed() -> None:
    rows = replace(ride(6), i_d=None, u_d=None)
    assert "no current" in rows_fault(replace(rows, i_q=np.zeros(900)))
    assert "rise together" in rows_fault(replace(rows, omega_e=30.0 * rows.i_q))
    assert rows_fault(rows) == ""


@pytest.mark.parametrize("axis", ["i_d", "u_d"])
def test_an_axis_that_was_not_logged(axis: str) -> None:
    rows = replace(ride(7), u_d=None)
    rows = replace(rows, i_d=None) if axis == "i_d" else rows
    key = "inductance_d" if axis == "i_d" else "inductance_q"
    assert "was logged" in found(analysed(rows), key).why


def test_a_covariance_is_widened_to_a_floor_and_keeps_its_correlations() -> None:
    sigma, correlation = np.array([0.1, 2.0, 30.0]), np.array([[1.0, 0.6], [0.6, 1.0]])
    whole = np.eye(3)
    whole[:2, :2] = correlation
    covariance = whole * np.outer(sigma, sigma)
    floor = np.diag([0.09, 1.0, 1600.0]) + 0.01
    found = _at_least(covariance, floor)
    wide = np.sqrt([0.1, 4.0, 1600.01])
    np.testing.assert_allclose(found, whole * np.outer(wide, wide))
    np.testing.assert_allclose(_at_least(covariance, np.zeros((3, 3))), covariance)
    assert not _at_least(np.zeros((3, 3)), np.zeros((3, 3))).any()


@pytest.mark.parametrize(("name", "term"), [("i_q", "resistance"), ("omega_e", "magnet_flux")])
def test_a_rounded_current_or_speed_is_a_voltage_that_is_off_by_its_coefficient(
    name: str, term: str
) -> None:
    rows = replace(ride(8), i_d=None, u_d=None, temperature=None)
    terms = ["resistance", "magnet_flux"]
    columns = {key: voltage_columns(rows)[key] / 0.3 for key in terms}
    none = np.zeros(rows.u_q.size, dtype=np.intp)
    model = _Model(
        columns, rows.u_q / 0.3, none, none, None, np.full(rows.u_q.size, 0.3)
    )  # one axis in units of 0.3 V
    coefficients = np.array([TRUTH[key] for key in terms])
    quiet = np.full(rows.u_q.size, 1e-3)
    of_column, told = _rounding(replace(rows, steps={name: 0.4}), model, terms, coefficients, quiet)
    of_voltage, _ = _rounding(
        replace(rows, steps={"u_q": 0.4 * TRUTH[term]}), model, terms, coefficients, quiet
    )
    np.testing.assert_allclose(of_column, of_voltage, rtol=1e-9)
    assert np.all(np.diag(of_column) > 0.0)
    assert "more than its noise" in told[0]
