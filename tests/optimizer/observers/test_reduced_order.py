"""Speed observer: its equation against the machine's, a nonlinear simulation of the drive,
closed forms, refusals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers.reduced_order import (
    ReducedOrderObserver,
    errors_at_loads,
    estimate_speed,
    reduced_order_observer,
    simulate_observer,
    steady_state_error,
)

T_S = 200e-6
G = 500.0
OMEGA = 1500.0 * np.pi / 30.0
RATED = 0.47


@dataclass(frozen=True)
class Recording:
    """What the firmware sees (currents at the samples, voltages held after
    them) and the true speed.
    """

    i_d: FloatArray
    i_q: FloatArray
    v_q: FloatArray
    omega_m: FloatArray


def record(
    machine: LinearMachine,
    i_ref: Callable[[float], float],
    load: Callable[[float], float],
    omega_0: float,
    i_q_0: float,
    samples: int,
) -> Recording:
    """Full salient dq machine with load, integrated between samples; PI current control, i_d = 0,
    one sample late.
    """
    p, psi, inertia = machine.pole_pairs, machine.psi_pm, machine.inertia or 0.0
    kp, ki_ts = 2.0, 2.0 * machine.r_s / machine.l_q * T_S
    state = np.array([0.0, i_q_0, omega_0])
    integral = np.array([0.0, machine.r_s * i_q_0])
    pending = np.array(
        [-p * omega_0 * machine.l_q * i_q_0, machine.r_s * i_q_0 + p * omega_0 * psi]
    )
    rows = np.empty((samples, 4))

    def slope(_: float, x: FloatArray, v_d: float, v_q: float, torque_load: float) -> list[float]:
        i_d, i_q, omega = x
        torque = 1.5 * p * (psi + (machine.l_d - machine.l_q) * i_d) * i_q
        return [
            (v_d - machine.r_s * i_d + p * omega * machine.l_q * i_q) / machine.l_d,
            (v_q - machine.r_s * i_q - p * omega * (machine.l_d * i_d + psi)) / machine.l_q,
            (torque - torque_load - machine.friction * omega) / inertia,
        ]

    for k in range(samples):
        voltage = pending
        rows[k] = [state[0], state[1], voltage[1], state[2]]
        error = np.array([-state[0], i_ref(k * T_S) - state[1]])
        integral = integral + ki_ts * error
        omega_e = p * state[2]
        feedforward = np.array(
            [-omega_e * machine.l_q * state[1], omega_e * (machine.l_d * state[0] + psi)]
        )
        pending = integral + kp * error + feedforward
        arguments = (voltage[0], voltage[1], load(k * T_S))
        state = solve_ivp(slope, (0.0, T_S), state, args=arguments, rtol=1e-8, atol=1e-10).y[:, -1]
    return Recording(*rows.T)


def observe(
    observer: ReducedOrderObserver, machine: LinearMachine, seen: Recording, omega_0: float
) -> FloatArray:
    """Run the observer as a firmware does, decoupling with its own estimate."""
    estimate = np.empty(len(seen.i_q))
    zeta = omega_0 + observer.c * seen.i_q[0]
    for k in range(len(estimate)):
        estimate[k] = zeta - observer.c * seen.i_q[k]
        u_q = seen.v_q[k] - machine.pole_pairs * estimate[k] * machine.l_d * seen.i_d[k]
        zeta = observer.a * zeta + observer.b_u * u_q + observer.b_i * seen.i_q[k]
    return estimate


@pytest.fixture(scope="module")
def start(bench001: LinearMachine) -> Recording:
    """From standstill with 1.5 A to about 1500 rpm, then the friction current alone; no load."""
    friction_current = bench001.friction * OMEGA / bench001.torque_per_ampere
    return record(
        bench001, lambda t: 1.5 if t < 0.0788 else friction_current, lambda _: 0.0, 0.0, 0.0, 800
    )


@pytest.fixture(scope="module")
def loaded(bench001: LinearMachine) -> Recording:
    """1500 rpm under the rated torque of 0.47 N m from the beginning."""
    i_q = (RATED + bench001.friction * OMEGA) / bench001.torque_per_ampere
    return record(bench001, lambda _: i_q, lambda _: RATED, OMEGA, i_q, 400)


# --- the equation ---------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    i_q=st.floats(-20, 20),
    omega=st.floats(-700, 700),
    u_q=st.floats(-200, 200),
    g=st.floats(1, 5000),
)
def test_an_exact_estimate_stays_exact(
    bench001: LinearMachine, i_q: float, omega: float, u_q: float, g: float
) -> None:
    """With zeta = omega + c i_q the observer's derivative is that of the machine:
    d omega/dt + c di_q/dt.
    """
    m = bench001
    observer = reduced_order_observer(m, g, T_S)
    back_emf = m.pole_pairs * m.psi_pm
    di_q = (u_q - m.r_s * i_q - back_emf * omega) / m.l_q
    domega = (1.5 * back_emf * i_q - m.friction * omega) / (m.inertia or 0.0)
    zeta = omega + observer.c_continuous * i_q
    rate = observer.continuous_pole * zeta + observer.rate_u * u_q + observer.rate_i * i_q
    size = (
        abs(observer.continuous_pole * zeta)
        + abs(observer.rate_u * u_q)
        + abs(observer.rate_i * i_q)
    )
    assert rate == pytest.approx(domega + observer.c_continuous * di_q, abs=1e-12 * size + 1e-9)


def test_coefficients_of_paper_001(bench001: LinearMachine) -> None:
    """(8.21) to (8.25) print 0.2, 5.55, 0.00967, 13.05 and 900.

    The last is p psi/J, 3/2 of it belongs there.
    """
    observer = reduced_order_observer(bench001, G, T_S)
    back_emf = bench001.pole_pairs * bench001.psi_pm
    assert observer.continuous_pole == pytest.approx(-(G + 0.2))
    assert observer.rate_u / G == pytest.approx(5.55, abs=0.006)
    assert observer.c_continuous / G == pytest.approx(0.00967, abs=5e-6)
    assert back_emf / 200e-6 == pytest.approx(900.0)
    assert observer.torque_rate == pytest.approx(1350.0)
    assert bench001.r_s / back_emf == pytest.approx(13.05, abs=0.006)
    expected = G**2 * 0.0096667 - G * (13.0556 - 0.2 * 0.0096667) + 1350.0
    assert observer.rate_i == pytest.approx(expected, rel=1e-4)


def test_fast_sampling_tends_to_the_continuous_observer(bench001: LinearMachine) -> None:
    t_s = 1e-7
    observer = reduced_order_observer(bench001, G, t_s)
    assert (observer.a - 1.0) / t_s == pytest.approx(observer.continuous_pole, rel=1e-3)
    assert observer.b_u / t_s == pytest.approx(observer.rate_u, rel=1e-3)
    assert observer.b_i / t_s == pytest.approx(observer.rate_i, rel=1e-3)
    assert observer.c == pytest.approx(observer.c_continuous, rel=1e-3)


# --- the sampled observer -------------------------------------------------------------------------


def test_a_wrong_first_estimate_decays_with_the_pole(bench001: LinearMachine) -> None:
    observer = reduced_order_observer(bench001, G, T_S)
    voltage = np.random.default_rng(5).normal(scale=20.0, size=60)
    run = simulate_observer(observer, bench001, voltage, np.zeros(60), omega_0=30.0, error_0=10.0)
    np.testing.assert_allclose(run.error, 10.0 * np.exp(-(G + 0.2) * run.times), atol=1e-9)
    assert run.final_error == run.error[-1]


def test_holding_the_current_over_a_sample_would_not_be_exact(bench001: LinearMachine) -> None:
    """The reason for the sampled design: the continuous equation with i_q held errs
    whenever the current moves.
    """
    observer = reduced_order_observer(bench001, G, T_S)
    scale = (1.0 - observer.a) / -observer.continuous_pole
    held = replace(
        observer, b_u=observer.rate_u * scale, b_i=observer.rate_i * scale, c=observer.c_continuous
    )
    voltage = np.where(np.arange(100) % 20 < 10, 10.0, -10.0)
    exact = simulate_observer(observer, bench001, voltage, np.zeros(100))
    approximate = simulate_observer(held, bench001, voltage, np.zeros(100))
    assert np.max(np.abs(exact.error)) < 1e-10
    assert np.max(np.abs(approximate.error)) > 0.3


def test_estimate_speed_runs_over_recorded_data(bench001: LinearMachine) -> None:
    observer = reduced_order_observer(bench001, G, T_S)
    voltage = np.linspace(0.0, 20.0, 50)
    run = simulate_observer(observer, bench001, voltage, np.zeros(50))
    np.testing.assert_array_equal(estimate_speed(observer, voltage, run.i_q, 0.0), run.omega_hat)


# --- on the nonlinear drive -----------------------------------------------------------------------


def test_exact_parameters_without_load_give_the_speed_within_half_a_percent(
    bench001: LinearMachine, start: Recording
) -> None:
    estimate = observe(reduced_order_observer(bench001, G, T_S), bench001, start, 0.0)
    assert start.omega_m[-1] == pytest.approx(OMEGA, rel=0.02)
    error = np.abs(estimate - start.omega_m) / OMEGA
    assert error[-1] < 5e-6
    assert np.max(error) < 5e-3  # at any time of the start


def test_wrong_resistance_without_load_matters_little(
    bench001: LinearMachine, start: Recording
) -> None:
    hot = replace(bench001, r_s=1.3 * bench001.r_s)
    estimate = observe(reduced_order_observer(hot, G, T_S), hot, start, 0.0)
    found = estimate[-1] - start.omega_m[-1]
    closed = steady_state_error(bench001, G, T_S, float(start.omega_m[-1]), r_error=0.3)
    assert closed.relative == pytest.approx(-5.8e-4, rel=1e-2)
    assert found == pytest.approx(closed.total, rel=1e-2)
    assert closed.total == pytest.approx(closed.resistance, rel=1e-3)


@pytest.mark.parametrize("g", [200.0, 500.0, 1500.0])
def test_a_load_torque_shifts_the_estimate_as_the_closed_form_says(
    bench001: LinearMachine, loaded: Recording, g: float
) -> None:
    observer = reduced_order_observer(bench001, g, T_S)
    estimate = observe(observer, bench001, loaded, OMEGA)
    closed = steady_state_error(bench001, g, T_S, float(loaded.omega_m[-1]), torque_load=RATED)
    assert closed.load == pytest.approx(RATED / (200e-6 * (g + 0.2)))
    assert closed.total == pytest.approx(closed.load, rel=0.005)  # second order in g t_s
    assert estimate[-1] - loaded.omega_m[-1] == pytest.approx(closed.total, rel=1e-4)


def test_wrong_resistance_at_rated_torque_costs_four_percent(
    bench001: LinearMachine, loaded: Recording
) -> None:
    hot = replace(bench001, r_s=1.3 * bench001.r_s)
    estimate = observe(reduced_order_observer(hot, G, T_S), hot, loaded, OMEGA)
    exact = observe(reduced_order_observer(bench001, G, T_S), bench001, loaded, OMEGA)
    closed = steady_state_error(bench001, G, T_S, OMEGA, torque_load=RATED, r_error=0.3)
    assert (estimate[-1] - exact[-1]) / OMEGA == pytest.approx(-0.044, abs=5e-4)
    assert closed.relative == pytest.approx(
        -0.0141, abs=1e-4
    )  # +3.0 % from the load, -4.4 % from the resistance
    assert estimate[-1] - loaded.omega_m[-1] == pytest.approx(closed.total, rel=1e-3)
    assert closed.total == pytest.approx(closed.load + closed.resistance, rel=0.01)


def test_errors_at_loads_are_those_without_and_with_a_wrong_resistance(
    bench001: LinearMachine,
) -> None:
    observer = reduced_order_observer(bench001, G, T_S)
    damping, loads = 40e-6 / 200e-6, (0.0, 0.5, -1.0)
    found = errors_at_loads(bench001, observer, OMEGA, loads, 0.3)
    for load, at in zip(loads, found, strict=True):
        i_q = (40e-6 * OMEGA + load) / (1.5 * 3.0 * 0.06)
        by_load = load / (200e-6 * (G + damping))
        wrong = -0.3 * bench001.r_s * i_q * G / ((G + damping) * 3.0 * 0.06)
        assert (at.torque_load, at.r_error) == (load, 0.3)
        assert at.exact.resistance == 0.0
        assert at.exact.total == pytest.approx(by_load, rel=0.01, abs=1e-9)
        assert at.resistance.resistance == pytest.approx(wrong, rel=1e-9)
        assert at.resistance.total == pytest.approx(by_load + wrong, rel=0.01)
        for one in (at.exact, at.resistance):
            assert (one.i_q, one.omega_m) == pytest.approx((i_q, OMEGA))
            assert one.load == pytest.approx(by_load)


@pytest.mark.parametrize("errors", [{"psi_error": 0.05}, {"inertia_error": 0.5}, {"r_error": -0.2}])
def test_closed_form_is_where_the_simulation_ends(
    bench001: LinearMachine, errors: dict[str, float]
) -> None:
    believed = replace(
        bench001,
        r_s=bench001.r_s * (1 + errors.get("r_error", 0.0)),
        psi_pm=bench001.psi_pm * (1 + errors.get("psi_error", 0.0)),
        inertia=200e-6 * (1 + errors.get("inertia_error", 0.0)),
    )
    observer = reduced_order_observer(believed, G, T_S)
    run = simulate_observer(observer, bench001, np.full(4000, 25.0), np.full(4000, 0.1))
    closed = steady_state_error(bench001, G, T_S, float(run.omega_m[-1]), torque_load=0.1, **errors)
    assert run.i_q[-1] == pytest.approx(closed.i_q, rel=1e-6)
    assert run.final_error == pytest.approx(closed.total, rel=1e-6)


# --- refusals -------------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [0.0, -100.0, np.nan, np.inf])
def test_gain_must_be_positive(bench001: LinearMachine, g: float) -> None:
    with pytest.raises(InputError, match=r"control\.observer\.pole must be positive"):
        reduced_order_observer(bench001, g, T_S)


def test_a_pole_too_fast_for_the_sampling_is_refused_with_the_limit(
    bench001: LinearMachine,
) -> None:
    with pytest.raises(
        NoSolutionError, match=r"pole t_s = 1\.2, at most 1\); write 5000 rad/s or less"
    ):
        reduced_order_observer(bench001, 6000.0, T_S)
    assert reduced_order_observer(bench001, 5000.0, T_S).a == pytest.approx(np.exp(-5000.2 * T_S))


def test_a_machine_without_magnets_is_refused(bench001: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match=r"psi_pm = 0"):
        reduced_order_observer(replace(bench001, psi_pm=0.0), G, T_S)


def test_inertia_is_needed(bench001: LinearMachine) -> None:
    with pytest.raises(InputError, match=r"control\.observer needs machine\.inertia"):
        reduced_order_observer(replace(bench001, inertia=None), G, T_S)


def test_a_rotor_that_swings_within_a_sample_is_refused(bench001: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match="swing faster"):
        reduced_order_observer(replace(bench001, inertia=3e-8, r_s=0.01), G, T_S)
