"""Steps of the control in single precision, against their definitions in double: complex vectors
instead of components, limits as clips, one sample after the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.float_control.current_control import (
    ControlSteps,
    current_ramp,
    torque_ramp,
    weakened,
)
from dqforge.optimizer.float_control.records import (
    NUMBERS,
    Control,
    ControlGains,
    Measured,
    PiGains,
    ReferenceGains,
    at_rest,
)
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq

COUNT = 4000
# Roundings of single precision that a voltage or current of some hundred units gathers.
NEAR = 4e-6
_MOVING: Any = [np.float32(x) for x in (0.4, 3.0, 1e-4, 9.0, 12.0)]
MOVING = ReferenceGains(*_MOVING)


def gains(moving: ReferenceGains | None = None) -> ControlGains:
    numbers: dict[str, Any] = {name: np.float32(0.0) for name in NUMBERS}
    numbers |= {
        name: np.float32(value)
        for name, value in {
            "pole_pairs": 4.0, "l_d": 2e-3, "l_q": 3e-3, "psi_pm": 0.07, "voltage_share": 0.55,
            "advance": 150e-6, "torque_max": 5.0, "speed_filter": 0.3,
        }.items()
    }  # fmt: skip
    ratio: Any = 3
    triples: Any = np.array([[5.0, 0.4, 0.2], [7.0, 0.3, 0.1], [0.2, 0.01, 0.5]], dtype=np.float32)
    d, q, speed = (PiGains(*triple) for triple in triples)
    return ControlGains(d, q, speed, ratio=ratio, references=moving, **numbers)


def steps(**choices: Any) -> ControlSteps:
    def currents(torque: Any) -> tuple[Any, Any]:
        return np.float32(-0.25) * torque, np.float32(1.5) * torque

    return ControlSteps(currents, "svpwm", **choices)


def drawn(seed: int, *sizes: float) -> list[Any]:
    generator = np.random.default_rng(seed)
    return [(size * generator.normal(size=COUNT)).astype(np.float32) for size in sizes]


def sampled() -> tuple[Measured, Control]:
    a, b, c, theta, omega = drawn(1, 8.0, 8.0, 8.0, 1.0, 200.0)
    v_dc = np.random.default_rng(2).uniform(50.0, 600.0, COUNT).astype(np.float32)
    state = at_rest(COUNT, None)
    state.d.integral, state.q.integral = drawn(3, 40.0, 90.0)
    return Measured(Abc(a, b, c), theta, omega, v_dc), state


def exact(
    g: ControlGains, measured: Measured, integral: NDArray[Any], reference: NDArray[Any], room: Any
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Voltage in stationary coordinates, integrals and whether all was asked for."""
    a, b, c, theta, omega_m, v_dc = (
        np.asarray(x, dtype=np.float64)
        for x in (*measured.i, measured.theta_e, measured.omega_m, measured.v_dc)
    )
    turn = np.exp(2j * np.pi / 3.0)
    i = 2.0 / 3.0 * (a + b * turn + c / turn) * np.exp(-1j * theta)
    error, omega_e = reference - i, float(g.pole_pairs) * omega_m

    def by_axis(name: str, x: NDArray[Any]) -> NDArray[Any]:
        return float(getattr(g.d, name)) * x.real + 1j * float(getattr(g.q, name)) * x.imag

    flux = float(g.l_d) * i.real + float(g.psi_pm) + 1j * float(g.l_q) * i.imag
    after = integral + by_axis("ki_ts", error)
    wanted = by_axis("kp", error) + after + 1j * omega_e * flux
    most = float(g.voltage_share) * v_dc - room
    given = wanted * np.minimum(1.0, np.maximum(most, 0.0) / np.abs(wanted))
    after = after + by_axis("tracking", given - wanted)
    return given * np.exp(1j * (theta + omega_e * float(g.advance))), after, given == wanted


@pytest.mark.parametrize("injects", [False, True])
def test_the_current_control_is_its_definition(injects: bool) -> None:
    (measured, state), g = sampled(), gains()
    d, q = drawn(4, 10.0, 10.0)
    added = np.zeros(COUNT, dtype=np.complex128)
    if injects:
        state.added = AlphaBeta(*drawn(5, 3.0, 3.0))
        added = state.added.alpha.astype(np.float64) + 1j * state.added.beta
    before = state.d.integral.astype(np.float64) + 1j * state.q.integral
    duty = np.array(steps().current_control(SINGLE, g, state, measured, Dq(d, q)))
    alpha, beta = state.v
    reference = d.astype(np.float64) + 1j * q
    voltage, integral, whole = exact(g, measured, before, reference, np.abs(added))
    assert 0.2 < np.mean(whole) < 0.8
    size = 1.0 + np.abs(before) + 9.0 * np.abs(reference) + 300.0
    assert np.all(np.abs(alpha + 1j * beta - voltage - added) < NEAR * size)
    found = state.d.integral + 1j * state.q.integral
    assert np.all(np.abs(found - integral) < NEAR * size)
    np.testing.assert_array_equal(state.reference, (d, q))
    inside = np.all((duty > 0.0) & (duty < 1.0), axis=0)
    assert inside.mean() > 0.5
    made = np.array([2.0, -1.0, -1.0]) / 3.0 @ duty * measured.v_dc
    np.testing.assert_allclose(made[inside], alpha[inside], atol=4e-4)


def test_without_room_or_with_what_is_no_number_there_is_no_voltage() -> None:
    (measured, state), g = sampled(), gains()
    kept = state.d.integral.copy()
    none = np.full(COUNT, np.nan, dtype=np.float32)
    bad = Measured(measured.i, measured.theta_e, measured.omega_m, none)
    with np.errstate(invalid="ignore"):
        duty = steps().current_control(SINGLE, g, state, bad, Dq(none, none))
    np.testing.assert_array_equal(state.v, np.zeros((2, COUNT)))
    np.testing.assert_array_equal(duty, np.full((3, COUNT), 0.5))
    np.testing.assert_array_equal(state.d.integral, kept)


def test_the_speed_loop_works_at_every_third_sample_and_within_its_limits() -> None:
    g, state = gains(MOVING), at_rest(1, MOVING)
    omega, integral, torque = 0.0, 0.0, 0.0
    generator = np.random.default_rng(6)
    limited = 0
    for n in range(300):
        seen, asked = generator.normal(size=2) * (20.0 if n > 150 else 2.0)
        found = speed_loop(
            SINGLE, g, state, *(np.array([x], dtype=np.float32) for x in (seen, asked))
        )
        omega += float(g.speed_filter) * (seen - omega)
        if n % 3 == 0:
            error = asked - omega
            wanted = float(g.speed.kp) * error + integral + float(g.speed.ki_ts) * error
            step = 3.0 * 0.4
            given = float(np.clip(np.clip(wanted, torque - step, torque + step), -5.0, 5.0))
            limited += given != wanted
            integral += float(g.speed.ki_ts) * error + float(g.speed.tracking) * (given - wanted)
            torque = given
        np.testing.assert_allclose(float(found[0]), torque, atol=2e-5)
        np.testing.assert_allclose(float(state.omega_m[0]), omega, atol=2e-5)
    assert 20 < limited < 90


def test_an_unknown_speed_keeps_the_last_one() -> None:
    g, state = gains(), at_rest(1, None)
    one, none = np.ones(1, dtype=np.float32), np.full(1, np.nan, dtype=np.float32)
    first = speed_loop(SINGLE, g, state, one, one)
    kept = state.omega_m.copy()
    for omega, reference in ((none, one), (one * np.float32(np.inf), none)):
        np.testing.assert_array_equal(speed_loop(SINGLE, g, state, omega, reference), first)
        np.testing.assert_array_equal(state.omega_m, kept)


def test_references_move_no_faster_than_their_slopes() -> None:
    g, state = gains(MOVING), at_rest(COUNT, MOVING)
    moving = state.references
    assert moving is not None
    last, asked, *_ = drawn(7, 2.0, 2.0)
    moving.torque = last
    found = torque_ramp(SINGLE, g, state, asked)
    np.testing.assert_allclose(found, last + np.clip(asked - last, -0.4, 0.4), atol=1e-6)
    d, q, here_d, here_q = drawn(8, 4.0, 4.0, 4.0, 4.0)
    moving.current = Dq(here_d, here_q)
    way = (d + 1j * q) - (here_d + 1j * here_q)
    ramped = current_ramp(SINGLE, g, state, Dq(d, q))
    exact_ramp = here_d + 1j * here_q + way * np.minimum(1.0, 3.0 / np.abs(way))
    np.testing.assert_allclose(ramped.d + 1j * ramped.q, exact_ramp, atol=4e-6)
    np.testing.assert_array_equal(moving.current, ramped)


def test_what_the_voltage_lacks_goes_to_the_d_current_within_the_limit() -> None:
    g, state = gains(MOVING), at_rest(COUNT, MOVING)
    moving = state.references
    assert moving is not None
    d, q, v_max, size, last = drawn(9, 6.0, 10.0, 60.0, 250.0, 8.0)
    moving.square, moving.added = size**2, -np.abs(last)
    before = moving.added.astype(np.float64)
    found = weakened(SINGLE, g, state, v_max, Dq(d, q))
    lack = v_max.astype(np.float64) ** 2 - size.astype(np.float64) ** 2
    added = np.clip(before + float(MOVING.feedback) * lack, -9.0, 0.0)  # type: ignore[arg-type]
    np.testing.assert_allclose(moving.added, added, atol=2e-5)
    less = np.maximum(d + added, -12.0)
    np.testing.assert_allclose(found.d, less, atol=3e-5)
    room = np.sqrt(np.maximum(144.0 - less**2, 0.0))
    clear = np.abs(np.abs(q) - room) > 1e-2  # beside the edge either may be taken
    expected = np.where(added < 0.0, np.clip(q, -room, room), q)
    assert np.mean((expected != q) & clear) > 0.1
    np.testing.assert_allclose(found.q[clear], expected[clear], atol=5e-3)


@pytest.mark.parametrize("holds", [False, True])
def test_a_torque_asks_for_its_currents_and_what_a_start_holds(holds: bool) -> None:
    (measured, state), g = sampled(), gains()
    state.held = Dq(*drawn(11, 1.0, 1.0)) if holds else None
    (torque,) = drawn(10, 3.0)
    steps().torque_control(SINGLE, g, state, measured, torque)
    held = np.zeros((2, COUNT)) if state.held is None else np.array(state.held)
    expected = np.array([-0.25 * torque, 1.5 * torque]) + held
    np.testing.assert_allclose(np.array(state.reference), expected, atol=2e-6)
    np.testing.assert_array_equal(state.torque, torque)


def test_references_that_weaken_the_field_see_their_share_of_the_voltage() -> None:
    (measured, state), g = sampled(), gains()

    def currents(torque: Any, v_max: Any, omega_e: Any) -> tuple[Any, Any]:
        return -v_max, omega_e + np.float32(0.0) * torque

    made = ControlSteps(currents, "svpwm", weakens=True, reference_share=0.75)
    made.torque_control(SINGLE, g, state, measured, measured.omega_m)
    np.testing.assert_allclose(state.reference.d, -0.75 * 0.55 * measured.v_dc, rtol=1e-6)
    np.testing.assert_allclose(state.reference.q, 4.0 * measured.omega_m, rtol=1e-6)
