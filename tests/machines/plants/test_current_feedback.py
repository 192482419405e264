"""Current-feedback PWM against other integrators, analytic frequencies,
brute force and the balance of power.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.ripple import ripple
from dqforge.machines.plants.current_feedback import (
    BRIDGE_STATES,
    Hysteresis,
    Predictive,
    RampComparison,
    Scheme,
    best_states,
    hysteresis_frequency,
    simulate_currents,
    slope_ratio,
)
from dqforge.machines.plants.fed_machine import (
    I_0,
    I_D,
    I_Q,
    Z_D,
    Z_Q,
    BridgeDrive,
    CurrentTrace,
    build_plant,
)

SALIENT = LinearMachine(pole_pairs=3, r_s=2.35, l_d=1.2e-3, l_q=2.4e-3, psi_pm=0.06, i_max=6.4)
EQUAL = LinearMachine(pole_pairs=3, r_s=2.35, l_d=1.7e-3, l_q=1.7e-3, psi_pm=0.06, i_max=6.4)
DRIVE = BridgeDrive(SALIENT, 180.0)
EQUAL_DRIVE = BridgeDrive(EQUAL, 180.0)
TIED = BridgeDrive(EQUAL, 180.0, EQUAL.l_d)
SCHEMES: list[Scheme] = [Hysteresis(0.3), RampComparison(2.0, 500.0, 10e3), Predictive(20e-6)]
RAMP = RampComparison(2.0, 500.0, 5e3)


def one(value: float) -> FloatArray:
    return np.array([value])


def stator_voltage(legs: FloatArray, v_dc: float) -> complex:
    turn = np.exp(2j * math.pi / 3.0)
    return complex(2.0 / 3.0 * v_dc * (legs[0] + legs[1] * turn + legs[2] * turn**2))


def test_plant_follows_the_machine_equations() -> None:
    """A salient machine in one switching state, against a general integrator of paper 000 (1)."""
    omega, start = 900.0, (-1.5, 3.0)
    legs = np.array([True, False, True])
    plant = build_plant(DRIVE, one(start[0]), one(start[1]), one(omega))
    vector = stator_voltage(legs.astype(float), DRIVE.v_dc)

    def slope(time: float, current: FloatArray) -> list[float]:
        v = vector * np.exp(-1j * omega * time)
        d, q = current
        return [
            (v.real - SALIENT.r_s * d + omega * SALIENT.l_q * q) / SALIENT.l_d,
            (v.imag - SALIENT.r_s * q - omega * (SALIENT.l_d * d + SALIENT.psi_pm)) / SALIENT.l_q,
        ]

    reference = solve_ivp(slope, (0.0, 1e-3), start, method="DOP853", rtol=1e-12, atol=1e-12).y[
        :, -1
    ]
    end = plant.advance(plant.start(legs[None]), 1e-3)[0]
    np.testing.assert_allclose(end[[I_D, I_Q]], reference, rtol=1e-9)


@pytest.mark.parametrize("rotating", [True, False])
def test_star_point_and_integrals_follow_their_equations(*, rotating: bool) -> None:
    """A star point that is tied to the middle of the link, and integrals of the error in rotor or
    in stator coordinates, in a frame that turns backwards with them."""
    omega, legs = -700.0, np.array([True, True, False])
    drive = BridgeDrive(SALIENT, 180.0, 0.9e-3)
    plant = build_plant(drive, one(-1.5), one(3.0), one(omega), rotating=rotating)
    vector, v_0 = stator_voltage(legs.astype(float), 180.0), 180.0 / 6.0
    begin = plant.start(legs[None], (one(2e-3), one(-1e-3)))
    begin[0, [I_D, I_Q, I_0]] += [0.4, -0.7, 0.3]

    def slope(time: float, x: FloatArray) -> list[float]:
        d, q, zero, z_d, z_q = x
        v = vector * np.exp(-1j * omega * time)
        turning = 0.0 if rotating else omega
        return [
            (v.real - 2.35 * d + omega * 2.4e-3 * q) / 1.2e-3,
            (v.imag - 2.35 * q - omega * (1.2e-3 * d + 0.06)) / 2.4e-3,
            (v_0 - 2.35 * zero) / 0.9e-3,
            -1.5 - d + turning * z_q,
            3.0 - q - turning * z_d,
        ]

    places = [I_D, I_Q, I_0, Z_D, Z_Q]
    exact = solve_ivp(slope, (0.0, 8e-4), begin[0, places], method="DOP853", rtol=1e-12, atol=1e-13)
    found = plant.advance(begin, 8e-4)[0]
    np.testing.assert_allclose(found[places], exact.y[:, -1], rtol=1e-8, atol=1e-11)


@pytest.fixture(scope="module")
def hysteresis() -> CurrentTrace:
    return simulate_currents(
        DRIVE,
        Hysteresis(0.25),
        [0.0, -1.0, 0.0, 0.0],
        [2.0, 4.0, 3.0, -3.0],
        [60.0, 200.0, 350.0, 350.0],
    )


@pytest.mark.slow
def test_hysteresis_error_may_reach_twice_the_band_but_not_more(hysteresis: CurrentTrace) -> None:
    largest = hysteresis.largest_error()
    assert np.all(largest <= 0.5 * (1.0 + 1e-6))
    assert np.all(largest > 0.25 * 1.2)
    assert np.all(hysteresis.rms_error() < 0.25)


@pytest.mark.slow
def test_hysteresis_commutates_at_the_edges_of_the_band(hysteresis: CurrentTrace) -> None:
    count = 0
    for point in range(4):
        for phase in range(3):
            time, turned_on = hysteresis.instants(point, phase)
            error = (hysteresis.phase_currents(point, time) - hysteresis.references(point, time))[
                :, phase
            ]
            np.testing.assert_allclose(error, np.where(turned_on, -0.25, 0.25), rtol=1e-8)
            assert np.all(turned_on[1:] != turned_on[:-1])
            count += time.size
    assert count == np.sum(hysteresis.commutations())


@pytest.mark.slow
def test_isolated_star_point_carries_no_current(hysteresis: CurrentTrace) -> None:
    time = np.linspace(hysteresis.time[0, 1], hysteresis.time[-1, 1], 400)
    assert np.max(np.abs(np.sum(hysteresis.phase_currents(1, time), axis=-1))) < 1e-9


@pytest.mark.slow
def test_hysteresis_with_tied_star_point_keeps_the_band_and_the_analytic_frequency() -> None:
    i_q, omega_m, band = np.array([2.0, 3.0]), np.array([150.0, 350.0]), 0.2
    trace = simulate_currents(TIED, Hysteresis(band), 0.0, i_q, omega_m)
    amplitude = np.hypot(*EQUAL.voltage(np.zeros(2), i_q, EQUAL.pole_pairs * omega_m))
    found = trace.switching_frequency()

    def frequency(voltage: FloatArray) -> FloatArray:
        return hysteresis_frequency(180.0, EQUAL.l_d, band, voltage)

    np.testing.assert_allclose(trace.largest_error(), band, rtol=1e-6)
    np.testing.assert_allclose(found.average, frequency(amplitude / math.sqrt(2.0)), rtol=2e-3)
    np.testing.assert_allclose(found.highest, frequency(0.0 * amplitude), rtol=1e-2)
    np.testing.assert_allclose(found.lowest, frequency(amplitude), rtol=1e-2)
    # A triangle between the edges of the band.
    np.testing.assert_allclose(trace.rms_error(), band / math.sqrt(3.0), rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["synchronous", "stationary"])
def test_ramp_comparison_locks_to_the_carrier(frame: str) -> None:
    scheme = RampComparison(
        RAMP.kp, RAMP.ki, RAMP.f_carrier, "synchronous" if frame == "synchronous" else "stationary"
    )
    trace = simulate_currents(DRIVE, scheme, 0.0, 2.0, [100.0, 150.0])
    assert np.all(slope_ratio(DRIVE, scheme, 0.0, 2.0, [100.0, 150.0]) < 1.0)
    for point in range(2):
        for phase in range(3):
            time, turned_on = trace.instants(point, phase)
            half = np.floor(2.0 * scheme.f_carrier * time).astype(int)
            assert np.all(
                np.diff(half) == 1
            )  # one commutation in each half of the carrier, on the falling flank up
            assert np.all(turned_on == (half % 2 == 0))


@pytest.mark.slow
def test_ramp_comparison_steeper_than_its_carrier_chatters() -> None:
    steep = RampComparison(40.0, 0.0, 5e3)
    assert slope_ratio(DRIVE, steep, 0.0, 2.0, 100.0) > 1.0
    with pytest.raises(NoSolutionError, match="chatter"):
        simulate_currents(DRIVE, steep, 0.0, 2.0, 100.0)
    with_band = simulate_currents(
        DRIVE, RampComparison(40.0, 0.0, 5e3, comparator_band=4.0), 0.0, 2.0, 350.0
    )
    assert with_band.switching_frequency().average[0] > 1.5 * steep.f_carrier


@pytest.mark.slow
def test_synchronous_regulators_leave_no_error_of_the_fundamental() -> None:
    trace = simulate_currents(
        EQUAL_DRIVE, RampComparison(2.0, 2000.0, 10e3), -1.0, 2.0, 200.0, periods=2, settling=1
    )
    fundamental = trace.spectrum([1])[0, 0]
    shifts = np.exp(-2j * math.pi / 3.0 * np.arange(3))
    np.testing.assert_allclose(fundamental, (-1.0 + 2.0j) * shifts, atol=0.01)


@pytest.mark.thinned
@pytest.mark.parametrize("ki", [0.0, 800.0])
def test_stationary_regulators_leave_the_error_of_their_impedance(ki: float) -> None:
    """The averaged loop: G (i* - i) = (R + j omega L) i + e, G = kp + ki / (j omega)."""
    scheme = RampComparison(5.0, ki, 10e3, "stationary")
    omega = 900.0
    trace = simulate_currents(
        EQUAL_DRIVE, scheme, 0.0, 2.0, omega / EQUAL.pole_pairs, settling=6 if ki else 1
    )
    gain = scheme.kp + ki / (1j * omega)
    expected = (gain * 2.0j - 1j * omega * EQUAL.psi_pm) / (
        EQUAL.r_s + 1j * omega * EQUAL.l_d + gain
    )
    assert abs(trace.spectrum([1])[0, 0, 0] - expected) < 0.02 * abs(expected)


@pytest.mark.slow
def test_ripple_of_a_slow_ramp_comparison_is_that_of_the_sine_triangle() -> None:
    scheme = RampComparison(0.3, 100.0, 10e3)
    trace = simulate_currents(EQUAL_DRIVE, scheme, 0.0, 2.0, 200.0, periods=2, settling=2)
    expected = float(ripple("spwm", EQUAL, 0.0, 2.0, 200.0, v_dc=180.0, f_sw=10e3).current)
    assert trace.current_thd()[0] * 2.0 / math.sqrt(2.0) == pytest.approx(expected, rel=0.03)
    assert trace.rms_error()[0] == pytest.approx(expected, rel=0.05)


def test_predictive_choice_is_the_best_of_all_states() -> None:
    """All 8 states carried forward by a matrix exponential written down here."""
    generator = np.random.default_rng(3)
    n, t_s, omega = 40, 40e-6, 800.0
    i_d, i_q = generator.uniform(-3.0, 0.0, n), generator.uniform(-4.0, 4.0, n)
    plant = build_plant(DRIVE, i_d, i_q, np.full(n, omega))
    legs = BRIDGE_STATES[generator.integers(0, 8, n)]
    state, time = plant.start(legs), generator.uniform(0.0, 0.01, n)
    state[:, I_D] += generator.normal(0.0, 1.0, n)
    state[:, I_Q] += generator.normal(0.0, 1.0, n)
    chosen = best_states(plant, state, time, legs, t_s)
    machine = SALIENT
    matrix = np.zeros((5, 5))
    matrix[0, :3] = [
        -machine.r_s / machine.l_d,
        omega * machine.l_q / machine.l_d,
        1.0 / machine.l_d,
    ]
    matrix[1, :2] = [-omega * machine.l_d / machine.l_q, -machine.r_s / machine.l_q]
    matrix[1, 3:] = [1.0 / machine.l_q, -omega * machine.psi_pm / machine.l_q]
    matrix[2, 3], matrix[3, 2] = omega, -omega
    step = expm(matrix * t_s)
    for k in range(n):
        errors = []
        for code in BRIDGE_STATES:
            v = stator_voltage(code.astype(float), 180.0) * np.exp(-1j * omega * time[k])
            end = step @ [state[k, I_D], state[k, I_Q], v.real, v.imag, 1.0]
            errors.append(math.hypot(end[0] - i_d[k], end[1] - i_q[k]))
        taken = int(np.flatnonzero(np.all(chosen[k] == BRIDGE_STATES, axis=-1))[0])
        assert errors[taken] <= min(errors) + 1e-9
        if taken in (0, 7):  # of the two zero vectors the nearer one
            assert np.sum(chosen[k] != legs[k]) <= 1


def test_predictive_acts_at_its_samples_only() -> None:
    trace = simulate_currents(DRIVE, Predictive(20e-6), 0.0, 3.0, 200.0)
    samples = np.concatenate([trace.instants(0, phase)[0] for phase in range(3)]) / 20e-6
    assert samples.size > 100
    time = np.linspace(trace.time[0, 0], trace.time[-1, 0], 400)  # the star point is isolated
    assert np.max(np.abs(np.sum(trace.phase_currents(0, time), axis=-1))) < 1e-9
    np.testing.assert_allclose(samples, np.round(samples), atol=1e-6)
    assert trace.switching_frequency().highest[0] <= 25e3 * (1.0 + 1e-9)


@pytest.mark.thinned
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_power_balance(scheme: Scheme) -> None:
    trace = simulate_currents(
        DRIVE, scheme, [-1.0, 0.0, 0.0], [3.0, 2.0, -2.0], [200.0, -250.0, 250.0], periods=2
    )
    power = trace.power_balance()
    np.testing.assert_allclose(power.dc_link - power.copper, power.shaft + power.stored, rtol=1e-9)
    np.testing.assert_allclose(power.dc_link - power.copper, power.shaft, rtol=5e-3)
    # The link's current once more, from samples of the phase currents.
    time = np.linspace(trace.time[0, 0], trace.time[0, 0] + trace.duration[0], 40_001)[:-1] + 1e-9
    piece = np.searchsorted(trace.time[:, 0], time, side="right") - 1
    sampled = np.mean(np.sum(180.0 * trace.legs[piece, 0] * trace.phase_currents(0, time), axis=-1))
    assert sampled == pytest.approx(power.dc_link[0], rel=2e-3)
    # Mean voltage and mean current belong together as in the steady state.
    v = trace.fundamental_voltage()
    current = trace.spectrum([1])[0, :, 0]
    omega_e = np.array([600.0, -750.0, 750.0])
    # A phasor of exp(j n theta) turns with the rotor, whichever way that does.
    v_d, v_q = SALIENT.voltage(current.real, current.imag, omega_e)
    np.testing.assert_allclose(v, v_d + 1j * v_q, atol=0.3)


def test_spectrum_and_distortion_agree_with_parseval() -> None:
    trace = simulate_currents(
        EQUAL_DRIVE, RampComparison(1.0, 300.0, 1e3), 0.0, 2.0, 300.0, periods=1, settling=2
    )
    lines = np.mean(np.abs(trace.spectrum(np.arange(301))[:, 0]) ** 2, axis=-1) / 2.0
    lines[0] *= 2.0  # the mean is no sinusoid
    partial = math.sqrt(float(np.sum(lines) - np.sum(lines[1])) / float(np.sum(lines[1])))
    assert partial == pytest.approx(trace.current_thd()[0], rel=2e-3)
    # The rest of the orders is missing, and only that.
    assert partial < trace.current_thd()[0]


@pytest.mark.slow
def test_points_together_are_as_each_alone_and_runs_repeat() -> None:
    i_q, omega_m = [1.0, 3.0], [150.0, 250.0]
    for scheme in SCHEMES[1:]:
        both = simulate_currents(DRIVE, scheme, 0.0, i_q, omega_m)
        again = simulate_currents(DRIVE, scheme, 0.0, i_q, omega_m)
        np.testing.assert_array_equal(both.state, again.state)
        for k in range(2):
            alone = simulate_currents(DRIVE, scheme, 0.0, i_q[k], omega_m[k])
            assert both.rms_error()[k] == pytest.approx(alone.rms_error()[0], rel=1e-6)
            np.testing.assert_allclose(both.instants(k, 0)[0], alone.instants(0, 0)[0], rtol=1e-9)


@pytest.mark.slow
def test_machine_without_resistance_or_magnet() -> None:
    bare = LinearMachine(pole_pairs=2, r_s=0.0, l_d=40e-3, l_q=6e-3, psi_pm=0.0, i_max=22.0)
    trace = simulate_currents(BridgeDrive(bare, 540.0), Hysteresis(0.5), 10.0, 10.0, 100.0)
    power = trace.power_balance()
    assert power.copper[0] == 0.0
    assert power.dc_link[0] == pytest.approx(float(power.shaft[0] + power.stored[0]), rel=1e-9)
    assert trace.largest_error()[0] <= 1.0 * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ("drive", "scheme", "omega_m", "words"),
    [
        (DRIVE, Hysteresis(0.0), 100.0, "band: expected a positive number in A"),
        (DRIVE, Hysteresis(1e-6), 100.0, "wider band"),
        (DRIVE, Hysteresis(0.2), 0.0, "speeds other than 0"),
        (DRIVE, Hysteresis(0.2), math.nan, "finite"),
        (DRIVE, RampComparison(-1.0, 0.0, 5e3), 100.0, "kp"),
        (DRIVE, RampComparison(1.0, -1.0, 5e3), 100.0, "ki"),
        (DRIVE, RampComparison(1.0, 0.0, math.inf), 100.0, "f_carrier"),
        (DRIVE, Predictive(0.0), 100.0, "t_s"),
        (TIED, Predictive(1e-5), 100.0, "neutral_inductance"),
    ],
)
def test_wrong_parameters_are_named(
    drive: BridgeDrive, scheme: Scheme, omega_m: float, words: str
) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(")):
        simulate_currents(drive, scheme, 0.0, 2.0, omega_m)


def test_wrong_drive_is_named() -> None:
    with pytest.raises(InputError, match="v_dc"):
        BridgeDrive(EQUAL, 0.0)
    with pytest.raises(InputError, match="neutral_inductance"):
        BridgeDrive(EQUAL, 180.0, -1e-3)
    with pytest.raises(InputError, match="periods"):
        simulate_currents(DRIVE, Hysteresis(0.2), 0.0, 2.0, 100.0, periods=0)
