"""Discretisation, frequency response, margins and poles against closed forms,
brute force and python-control.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dqforge.machines.errors import InputError
from dqforge.optimizer.loops.plants import PiLoop, current_loop, speed_loop
from dqforge.optimizer.sampled_systems import (
    FloatArray,
    SampledSystem,
    constant_input_states,
    delayed_plant,
    discretise,
    lift,
    loop_margins,
)

if TYPE_CHECKING:
    import control

A = np.array([[-300.0, -500.0], [800.0, -20.0]])
B = np.array([[700.0], [3.0]])
T_S = 1e-3


def transfer_system(numerator: list[float], denominator: list[float], t_s: float) -> SampledSystem:
    """Controllable canonical form of a strictly proper transfer function."""
    n = len(denominator) - 1
    a = np.zeros((n, n))
    a[0] = -np.array(denominator[1:]) / denominator[0]
    a[1:, :-1] = np.eye(n - 1)
    c = np.zeros((1, n))
    c[0, n - len(numerator) :] = np.array(numerator) / denominator[0]
    return SampledSystem(a=a, b=np.eye(n)[:, :1], c=c, d=np.zeros((1, 1)), t_s=t_s)


def as_control(system: SampledSystem) -> control.StateSpace:
    import control

    return control.ss(system.a, system.b[:, :1], system.c, system.d[:, :1], system.t_s)


# --- discretisation -------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.9, 1.0, 1.5, 3.3])
def test_first_order_lag_with_delay_has_its_textbook_coefficients(fraction: float) -> None:
    rate, gain = 400.0, 7.0
    held = discretise(np.array([[-rate]]), np.array([[gain]]), T_S, fraction * T_S)
    whole = int(fraction)
    rest = (fraction - whole) * T_S
    assert held.m == whole
    assert held.phi[0, 0] == pytest.approx(np.exp(-rate * T_S), rel=1e-13)
    assert held.gamma0[0, 0] == pytest.approx(
        gain / rate * (1 - np.exp(-rate * (T_S - rest))), rel=1e-12
    )
    late = gain / rate * np.exp(-rate * (T_S - rest)) * (1 - np.exp(-rate * rest))
    assert held.gamma1[0, 0] == pytest.approx(late, rel=1e-9, abs=1e-18)


def test_a_delay_of_whole_samples_is_not_split_by_rounding() -> None:
    held = discretise(A, B, 0.1, 3 * 0.1)  # 3 * 0.1 / 0.1 = 3.0000000000000004
    assert held.m == 3
    assert not np.any(held.gamma1)


@pytest.mark.parametrize("tau", [0.0, 0.37e-3, 1e-3, 2.6e-3])
def test_delayed_plant_follows_an_integrated_differential_equation(tau: float) -> None:
    inputs = np.random.default_rng(3).normal(size=12)

    def held(time: float) -> float:
        k = int(np.floor((time - tau) / T_S + 1e-9))
        return float(inputs[k]) if 0 <= k < len(inputs) else 0.0

    edges = np.unique(np.concatenate([np.arange(13) * T_S, np.arange(12) * T_S + tau]))
    edges = edges[edges <= 12 * T_S + 1e-12]
    state, expected = np.zeros(2), {0.0: np.zeros(2)}
    for start, stop in pairwise(edges):
        if stop - start > 1e-12:
            u = held(0.5 * (start + stop))
            slope = lambda _, x, u=u: A @ x + B[:, 0] * u  # noqa: E731
            state = solve_ivp(slope, (start, stop), state, rtol=1e-11, atol=1e-13).y[:, -1]
        expected[round(stop / T_S, 6)] = state

    plant = delayed_plant(A, B, np.eye(2), T_S, tau)
    x = np.zeros(len(plant.a))
    for k in range(12):
        np.testing.assert_allclose(plant.c @ x, expected[float(k)], rtol=1e-8, atol=1e-10)
        x = plant.a @ x + plant.b[:, 0] * inputs[k]


def test_two_inputs_share_one_delay_line() -> None:
    both = delayed_plant(A, np.hstack([B, 2.0 * B[::-1]]), np.eye(2), T_S, 1.4 * T_S)
    one = delayed_plant(A, 2.0 * B[::-1], np.eye(2), T_S, 1.4 * T_S)
    together = constant_input_states(both, np.array([0.0, 1.0]), 20) @ both.c.T
    np.testing.assert_allclose(
        together, constant_input_states(one, np.array([1.0]), 20) @ one.c.T, rtol=1e-12
    )


@pytest.mark.parametrize(("t_s", "tau"), [(0.0, 0.0), (-1.0, 0.0), (1.0, -0.1), (np.nan, 0.0)])
def test_impossible_times_are_refused(t_s: float, tau: float) -> None:
    with pytest.raises(InputError, match="sampling period"):
        discretise(A, B, t_s, tau)


def test_lifting_and_doubling_equal_plain_stepping() -> None:
    plant = delayed_plant(A, B, np.array([[1.0, 0.0]]), T_S, T_S)
    states = [np.zeros(len(plant.a))]
    for _ in range(69):
        states.append(plant.a @ states[-1] + plant.b[:, 0] * 0.3)
    np.testing.assert_allclose(
        constant_input_states(plant, np.array([0.3]), 70), states, rtol=1e-10, atol=1e-13
    )
    slow = lift(plant, 7)
    assert slow.t_s == pytest.approx(7 * T_S)
    np.testing.assert_allclose(
        constant_input_states(slow, np.array([0.3]), 10),
        np.array(states)[::7],
        rtol=1e-10,
        atol=1e-13,
    )


# --- poles and frequency response -----------------------------------------------------------------

drives = st.fixed_dictionaries(
    {
        "r_s": st.floats(1e-3, 5.0),
        "time_constant": st.floats(2e-4, 0.3),
        "t_s": st.sampled_from([1e-5, 5e-5, 1e-4, 2e-4]),
        "speed": st.floats(0.05, 0.45),  # crossover in rad per sample
        "zero": st.floats(0.01, 0.3),  # PI zero over crossover
    }
)


def loop_of(drive: dict[str, float]) -> tuple[PiLoop, list[float], list[float]]:
    """The current loop and, written out by hand, its open-loop numerator and denominator in z."""
    inductance = drive["r_s"] * drive["time_constant"]
    kp = drive["speed"] * inductance / drive["t_s"]
    ki = kp * drive["zero"] * drive["speed"] / drive["t_s"]
    phi = float(np.exp(-drive["t_s"] / drive["time_constant"]))
    gamma = -float(np.expm1(-drive["t_s"] / drive["time_constant"])) / drive["r_s"]
    step = ki * drive["t_s"]
    numerator = [gamma * (kp + step), -gamma * kp]
    denominator = [1.0, -1.0 - phi, phi, 0.0]  # (z - 1) z (z - phi)
    return current_loop(drive["r_s"], inductance, drive["t_s"], kp, ki), numerator, denominator


@settings(deadline=None)
@given(drives)
def test_current_loop_is_the_transfer_function_written_by_hand(drive: dict[str, float]) -> None:
    loop, numerator, denominator = loop_of(drive)
    omega = np.geomspace(1e-3, 1.0, 50) * np.pi / drive["t_s"]
    z = np.exp(1j * omega * drive["t_s"])
    expected = np.polyval(numerator, z) / np.polyval(denominator, z)
    np.testing.assert_allclose(loop.open_loop.response(omega), expected, rtol=1e-6)
    characteristic = np.polyadd(denominator, numerator)
    np.testing.assert_allclose(np.poly(loop.closed.a), characteristic, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "ignore:(divide by zero|invalid value)"
)  # python-control may meet the pole at z = 1
@settings(deadline=None)
@given(drives)
def test_margins_and_poles_agree_with_python_control(drive: dict[str, float]) -> None:
    import control

    loop, numerator, denominator = loop_of(drive)
    found = loop_margins(loop.open_loop)
    reference = control.tf(numerator, denominator, drive["t_s"])
    assume(
        np.min(found.crossovers) * drive["t_s"] > 0.03
    )  # below, python-control's polynomial roots lose digits
    gains, phases, stability, _, crossings, _ = control.stability_margins(
        reference, returnall=True, method="poly"
    )
    np.testing.assert_allclose(np.sort(crossings), found.crossovers, rtol=1e-6)
    assert np.degrees(abs(found.phase_margin)) == pytest.approx(np.min(np.abs(phases)), rel=1e-6)
    assert found.gain_margin == pytest.approx(np.min(gains[gains > 1.0]), rel=1e-6)
    assert found.max_sensitivity == pytest.approx(1.0 / np.min(stability), rel=1e-6)
    lag = np.mod(np.radians(phases), 2 * np.pi)
    assert found.delay_margin == pytest.approx(np.min(lag / crossings), rel=1e-6)
    expected = np.sort(np.abs(control.feedback(reference, 1).poles()))[::-1]
    np.testing.assert_allclose(np.abs(loop.closed.poles), expected, rtol=1e-6, atol=1e-7)


@pytest.mark.slow
@settings(deadline=None)
@given(drives)
def test_margins_are_where_the_loop_becomes_unstable(drive: dict[str, float]) -> None:
    loop, numerator, denominator = loop_of(drive)
    margins = loop_margins(loop.open_loop)

    def largest(factor: float, samples: int = 0) -> float:
        line = denominator + [0.0] * samples
        return float(np.max(np.abs(np.roots(np.polyadd(line, np.array(numerator) * factor)))))

    assert (
        largest(margins.gain_margin * (1 - 1e-4)) < 1.0 < largest(margins.gain_margin * (1 + 1e-4))
    )
    whole = int(margins.delay_margin / drive["t_s"])
    if len(margins.crossovers) == 1 and whole < 60:
        assert largest(1.0, whole) < 1.0 + 1e-9
        assert largest(1.0, whole + 1) > 1.0 - 1e-9


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    drive=drives,
    ratio=st.sampled_from([1, 3, 10]),
    inertia=st.floats(1e-5, 0.1),
    speed=st.floats(0.08, 0.3),
    zero=st.floats(0.05, 0.3),
    filtered=st.booleans(),
)
def test_crossings_of_two_rate_loops_hold_in_forty_digits(
    drive: dict[str, float], ratio: int, inertia: float, speed: float, zero: float, filtered: bool
) -> None:
    """Where python-control's polynomials lose their digits: the state-space response
    in long arithmetic instead.
    """
    t_s, inductance = drive["t_s"], drive["r_s"] * drive["time_constant"]
    period = ratio * t_s
    kp_current, kp_speed = 0.3 * inductance / t_s, speed * inertia / period
    model = speed_loop(
        (drive["r_s"], inductance),
        (inertia, 0.1 * inertia),
        t_s,
        (kp_current, kp_current / drive["time_constant"]),
        ratio,
        (kp_speed, kp_speed * zero * speed / period),
        period if filtered else 0.0,
    )
    loop = model.loop.open_loop
    assume(abs(model.loop.closed.poles[0]) < 1.0)
    margins = loop_margins(loop)
    grid = np.geomspace(1e-6, 1.0 - 1e-9, 20_000) * np.pi / period
    assert len(margins.crossovers) == np.count_nonzero(
        np.diff(np.sign(np.abs(loop.response(grid)) - 1.0))
    )
    with mpmath.workdps(40):
        for omega in margins.crossovers:
            z = mpmath.exp(1j * mpmath.mpf(omega) * mpmath.mpf(loop.t_s))
            matrix = z * mpmath.eye(len(loop.a)) - mpmath.matrix(loop.a.tolist())
            state = mpmath.lu_solve(matrix, mpmath.matrix(loop.b.tolist()))
            value = mpmath.fsum(float(c) * x for c, x in zip(loop.c[0], state, strict=True))
            assert abs(float(abs(value)) - 1.0) < 1e-10


# --- margins of awkward loops ---------------------------------------------------------------------


def test_a_crossing_at_the_nyquist_frequency_is_a_gain_margin() -> None:
    integrator = SampledSystem(
        a=np.eye(1), b=np.eye(1), c=np.array([[0.5]]), d=np.zeros((1, 1)), t_s=1.0
    )
    margins = loop_margins(integrator)  # z - 1 + 0.5 k: unstable from k = 4, at z = -1
    assert margins.gain_margin == pytest.approx(4.0, rel=1e-12)
    # 2 sin(w/2) = 0.5 and the phase is -90 deg - w/2
    omega = 2 * np.arcsin(0.25)
    assert margins.crossover == pytest.approx(omega, rel=1e-12)
    assert margins.phase_margin == pytest.approx(np.pi / 2 - omega / 2, rel=1e-12)
    assert margins.delay_margin == pytest.approx((np.pi / 2 - omega / 2) / omega, rel=1e-12)
    assert margins.gain_reduction == 0.0


def resonant_loop() -> SampledSystem:
    """An integrator with a lightly damped resonance that lifts the gain above one again."""
    mode = 0.995 * np.exp(0.6j)
    numerator = [0.02, 0.002]
    denominator = np.convolve([1.0, -1.0], [1.0, -2 * mode.real, abs(mode) ** 2])
    return transfer_system(numerator, list(denominator), 1e-3)


def test_the_worst_of_several_crossovers_counts() -> None:
    import control

    loop = resonant_loop()
    margins = loop_margins(loop)
    _, phases, stability, _, crossings, _ = control.stability_margins(
        as_control(loop), returnall=True, method="poly"
    )
    assert len(margins.crossovers) == 3
    np.testing.assert_allclose(margins.crossovers, np.sort(crossings), rtol=1e-6)
    assert abs(np.degrees(margins.phase_margin)) == pytest.approx(np.min(np.abs(phases)), rel=1e-6)
    assert margins.max_sensitivity == pytest.approx(1 / np.min(stability), rel=1e-6)
    assert (
        margins.crossover
        == margins.crossovers[np.argmin(np.abs(np.angle(-loop.response(margins.crossovers))))]
    )


def test_a_conditionally_stable_loop_has_both_gain_margins() -> None:
    # three integrators and two zeros: stable only between two gains
    numerator = 0.3 * np.poly([0.97, 0.97])
    loop = transfer_system(list(numerator), list(np.poly([1.0, 1.0, 1.0])), 1.0)
    margins = loop_margins(loop)
    for factor in (margins.gain_margin, margins.gain_reduction):
        closed = np.polyadd(np.poly([1.0, 1.0, 1.0]), factor * numerator)
        assert np.max(np.abs(np.roots(closed))) == pytest.approx(1.0, abs=1e-6)
    assert 0.0 < margins.gain_reduction < 1.0 < margins.gain_margin


def test_a_loop_that_never_reaches_gain_one_has_no_crossover() -> None:
    margins = loop_margins(
        SampledSystem(
            a=np.array([[0.5]]), b=np.eye(1), c=np.array([[0.1]]), d=np.zeros((1, 1)), t_s=1.0
        )
    )
    assert np.isnan(margins.crossover)
    assert margins.phase_margin == margins.delay_margin == np.inf
    assert margins.max_sensitivity == pytest.approx(1 / (1 - 0.1 / 1.5), rel=1e-12)  # at z = -1


def test_response_has_the_static_gain_at_low_frequency() -> None:
    plant = delayed_plant(A, B, np.array([[1.0, 0.0]]), T_S, 0.5 * T_S)
    static: FloatArray = -np.linalg.solve(A, B)[0]
    assert plant.response(np.array([1e-6]))[0] == pytest.approx(static[0], rel=1e-6)
