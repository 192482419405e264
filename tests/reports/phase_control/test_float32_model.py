"""What the emitted control of phase machines does: torque, frames, limits, duties, the loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from averaged_loop import AveragedDrive
from phase_drives import T_S, near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, PhaseShape
from dqforge.optimizer.phase_control.phase_records import Alphabetazero, Control, Shape
from dqforge.optimizer.phase_control.shape_frame import Frame, shape_frame
from dqforge.optimizer.phase_control.shape_references import ShapeSteps, reference_at
from dqforge.optimizer.steps.step_arithmetic import Rotation
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.header import (
    Surroundings,
    phase_control_from,
    plain_phase_control,
)

TOPOLOGY_NAMES: tuple[Topology, ...] = get_args(Topology)


def model_of(control: PhaseControl, **around: Any) -> PhaseControlModel:
    plain = plain_phase_control(control, Surroundings("svpwm", **around))
    return phase_control_from(plain, {})


def angles(count: int = 400) -> Any:
    """Angles in rad that avoid the nodes of the tables, float32."""
    theta = 2.0 * np.pi * (np.arange(count) + 0.37) / count - np.pi
    return theta.astype(np.float32)


def turn_of(theta: Any) -> Rotation:
    return Rotation(np.cos(theta), np.sin(theta))


def reading(table: Any) -> ShapeSteps:
    nodes = table.shape[1] - 1
    return ShapeSteps(nodes, len(table), float(np.float32(nodes / (2.0 * np.pi))))


def shape_at(table: Any, place: Any, opened: Any = None) -> Alphabetazero:
    return reading(table).shape_at(SINGLE, Shape(tuple(table)), place, opened)


def slope_at(table: Any, place: Any) -> Alphabetazero:
    return reading(table).slope_at(SINGLE, Shape(tuple(table)), place)


@pytest.mark.parametrize("rows", [1, 3])
def test_the_shape_is_that_of_the_machine(rows: int) -> None:
    machine, theta = near_sinusoidal(192), angles()
    table = np.concatenate([machine.flux, machine.flux[:, :1]], axis=1).astype(np.float32)[:rows]
    place = (theta / (2.0 * np.pi)).astype(np.float32)
    found = shape_at(table, place)
    fine = near_sinusoidal(5760)
    k = np.round(np.mod(place, 1.0) * 5760).astype(int) % 5760
    a, b, c = fine.flux[:, k]
    expected = (2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0), (a + b + c) / 3.0
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-3 * machine.psi_pm)
    slope = slope_at(table, place)
    step = np.float32(1e-3)
    ahead = shape_at(table, place + step / np.float32(2.0 * np.pi))
    inside = np.floor(np.mod(place, 1.0) * 192) == np.floor(
        np.mod(place + step / (2.0 * np.pi), 1.0) * 192
    )
    for rate, one, other in zip(slope, found, ahead, strict=True):
        np.testing.assert_allclose(rate[inside], ((other - one) / step)[inside], atol=2e-4)


@pytest.mark.parametrize("zero", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("fade", [0.0, 0.5, 1.0])
def test_references_make_the_torque_of_the_faded_shape(zero: float, fade: float) -> None:
    """Whatever part of the zero sequence flows, the torque is what is asked for; where the shape
    fades, that of the faded shape."""
    machine, theta = trapezoidal(96), angles()
    model = model_of(plain_control(machine))
    f = shape_at(model.shape, (theta / (2.0 * np.pi)).astype(np.float32))
    full = np.ones_like(theta)
    turn = turn_of(theta)
    i = reference_at(
        SINGLE, model.numbers, f, turn, 2.0 * full, 0.0 * full, fade * full, zero * full
    )
    psi = machine.psi_pm
    seen = (
        fade * f.alpha - (1.0 - fade) * psi * turn[1],
        fade * f.beta + (1.0 - fade) * psi * turn[0],
        fade * f.zero,
    )
    torque = machine.pole_pairs * (
        1.5 * (seen[0] * i.alpha + seen[1] * i.beta) + 3.0 * seen[2] * i.zero
    )
    np.testing.assert_allclose(torque, 2.0, rtol=2e-6)
    if zero == 0.0:
        assert not np.any(i.zero)


@pytest.mark.parametrize("opened", [1, 2, 3])
def test_an_open_phase_gets_no_reference_and_the_torque_stays(opened: int) -> None:
    machine, theta = near_sinusoidal(96), angles()
    model = model_of(plain_control(machine))
    places = (theta / (2.0 * np.pi)).astype(np.float32)
    f = shape_at(model.shape, places, np.full(theta.shape, opened, dtype=np.uint32))
    one = np.ones_like(theta)
    i = reference_at(SINGLE, model.numbers, f, turn_of(theta), one, 0.0 * one, one, one)
    phases = np.stack(
        [
            i.alpha + i.zero,
            -0.5 * i.alpha + np.sqrt(0.75) * i.beta + i.zero,
            -0.5 * i.alpha - np.sqrt(0.75) * i.beta + i.zero,
        ]
    )
    assert np.max(np.abs(phases[opened - 1])) < 1e-6 * np.max(np.abs(phases))
    whole = shape_at(model.shape, places)
    torque = machine.pole_pairs * (
        1.5 * (whole.alpha * i.alpha + whole.beta * i.beta) + 3.0 * whole.zero * i.zero
    )
    np.testing.assert_allclose(torque, 1.0, rtol=1e-5)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_frames_lead_there_and_back_and_have_the_back_emf_on_q(frame: CurrentFrame) -> None:
    machine, theta = trapezoidal(96), angles()
    model = model_of(plain_control(machine))
    f = shape_at(model.shape, (theta / (2.0 * np.pi)).astype(np.float32))
    generator = np.random.default_rng(4)
    x = Alphabetazero(*generator.normal(size=(3, theta.size)).astype(np.float32))
    along, psi = shape_frame(frame), model.gains["psi_pm"]
    assert along is not None
    seen = along.to_frame(SINGLE, f, x, psi)
    for one, other in zip(along.from_frame(SINGLE, f, seen, psi), x, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-6)
    emf = along.to_frame(SINGLE, f, f, psi)
    assert np.max(np.abs(emf.d)) < 1e-7
    if frame == "dqy":
        assert np.max(np.abs(emf.zero)) < 1e-7
        # power-invariant but for the factor: the square of the length is kept
        length = x.alpha**2 + x.beta**2 + 2.0 * x.zero**2
        scale = (f.alpha**2 + f.beta**2 + 2.0 * f.zero**2) / model.gains["psi_pm"] ** 2
        found = seen.d**2 + seen.q**2 + seen.zero**2
        np.testing.assert_allclose(found, scale * length, rtol=2e-6)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_coupling_is_the_voltage_of_currents_that_are_constant_in_the_frame(
    frame: CurrentFrame,
) -> None:
    """Against differences of what the frame makes of constant currents, in the middle of the
    intervals of the table."""
    machine = near_sinusoidal(96)
    model = model_of(plain_control(machine))
    theta = (2.0 * np.pi * (np.arange(96) + 0.5) / 96).astype(np.float32)
    generator = np.random.default_rng(5)
    x = Frame(*generator.normal(size=(3, 96)).astype(np.float32))
    along = shape_frame(frame)
    assert along is not None
    if frame == "dqx":
        x = x._replace(zero=np.zeros_like(x.zero))
    psi, step = model.gains["psi_pm"], 0.01
    shapes = [
        shape_at(model.shape, ((theta + side) / (2.0 * np.pi)).astype(np.float32))
        for side in (-step, 0.0, step)
    ]
    before, after = (along.from_frame(SINGLE, shape, x, psi) for shape in (shapes[0], shapes[2]))
    slope = slope_at(model.shape, (theta / (2.0 * np.pi)).astype(np.float32))
    omega = np.full(96, 300.0, dtype=np.float32)
    found = along.coupling(SINGLE, model.numbers, shapes[1], slope, x, omega)
    inductances = (8e-3, 8e-3, 5e-3)
    for v, one, other, inductance in zip(found, before, after, inductances, strict=True):
        expected = 300.0 * inductance * (other - one) / (2.0 * step)
        np.testing.assert_allclose(v, expected, atol=2e-3 * max(np.max(np.abs(expected)), 1.0))


def integrals(state: Control) -> list[Any]:
    return [pi.integral for pi in (state.d, state.q, state.zero) if pi is not None]


def measured_at(rows: int, v_dc: float = 220.0, **changes: float) -> Any:
    columns = {
        "a": 0.0,
        "b": 0.0,
        "c": 0.0,
        "theta": 0.4,
        "omega": 50.0,
        "v_dc": v_dc,
        "v_m": 110.0,
    }
    columns |= changes
    return np.array([list(columns.values())] * rows, dtype=np.float32)


@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_duties_make_the_voltage_of_the_state(topology: Topology) -> None:
    """Phase voltages of the legs by the rule of the topology equal v and v_0, as long as nothing
    is clipped and where it is."""
    rule = TOPOLOGIES[topology]
    model = model_of(plain_control(near_sinusoidal(96), topology))
    theta = angles(64)
    measured = np.repeat(measured_at(1), 64, axis=0)
    measured[:, 3] = theta
    measured = measured if rule.midpoint else measured[:, :6]
    for torque in (0.5, 3.9):
        state = model.structure.at_rest(64)
        for v_dc in (220.0, 60.0):
            measured[:, 5] = v_dc
            if rule.midpoint:
                measured[:, 6] = 0.5 * v_dc
            duty = np.array(
                model.torque_control(state, measured, np.full(64, torque, dtype=np.float32))
            )
            legs = duty.astype(np.float64) * v_dc
            if len(rule.legs) == 6:
                v = legs[:3] - legs[3:]
            elif topology == "four-leg":
                v = legs[:3] - legs[3]
            else:
                v = legs - (0.5 * v_dc if rule.midpoint else 0.0)
            alpha, beta = (2.0 * v[0] - v[1] - v[2]) / 3.0, (v[1] - v[2]) / np.sqrt(3.0)
            np.testing.assert_allclose(alpha, state.v[0], atol=1e-4)
            np.testing.assert_allclose(beta, state.v[1], atol=1e-4)
            if rule.neutral:
                np.testing.assert_allclose(np.mean(v, axis=0), state.v_0, atol=1e-4)
            assert np.all((duty >= 0.0) & (duty <= 1.0))


@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_integrals_rest_while_the_voltage_is_shortened(topology: Topology) -> None:
    model = model_of(plain_control(near_sinusoidal(96), topology))
    rows = measured_at(1, v_dc=2.0, v_m=1.0)
    rows = rows if model.structure.midpoint else rows[:, :6]
    state = model.structure.at_rest(1)
    torque = np.full(1, 3.0, dtype=np.float32)
    for _ in range(20):
        model.torque_control(state, rows, torque)
    assert not np.any(integrals(state))
    assert not np.any(state.harmonic)
    free = rows.copy()
    free[:, 5], free[:, 6:] = 400.0, 200.0
    model.torque_control(state, free, torque)
    assert np.all(state.q.integral != 0.0)
    assert not np.any(state.harmonic)  # the error is beyond error_max
    model.torque_control(state, free, np.full(1, 0.2, dtype=np.float32))
    assert np.all([np.any(r) for r in state.harmonic])


@pytest.mark.parametrize("column", range(7))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_sample_makes_no_voltage_and_leaves_the_states(column: int, bad: float) -> None:
    model = model_of(plain_control(near_sinusoidal(96), "split-capacitor"))
    good = measured_at(1, a=0.2, b=-0.1, c=0.05)
    spoilt = good.copy()
    spoilt[0, column] = bad
    state = model.structure.at_rest(1)
    torque = np.full(1, 0.5, dtype=np.float32)
    model.torque_control(state, good, torque)
    before = np.array([*integrals(state), *state.harmonic[1], *state.harmonic_zero[0]])
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        duty = model.torque_control(state, spoilt, torque)
    assert all(0.0 <= one[0] <= 1.0 for one in duty)
    assert not np.any([*state.v, state.v_0])
    after = np.array([*integrals(state), *state.harmonic[1], *state.harmonic_zero[0]])
    np.testing.assert_array_equal(before, after)


def test_harmonics_and_the_shape_fade_with_the_speed() -> None:
    """Above f_s/6 an order does nothing; below 16 samples per period only the fundamental is
    left of the references."""
    model = model_of(plain_control(near_sinusoidal(96)))
    omega_e = np.array([0.79, 0.9, 1.01]) * 2.0 * np.pi / (6.0 * T_S) / 13.0
    shares = [float(x) for x in np.clip(5.0 - model.gains["harmonic_fade"] * 13 * omega_e, 0, 1)]
    assert shares == pytest.approx([1.0, 0.5, 0.0], abs=1e-5)
    samples = np.array([21.0, 18.0, 15.0])
    faded = model.gains["fade_end"] - model.gains["fade"] * 2.0 * np.pi / (samples * T_S)
    expected = (1.0 / 16.0 - 1.0 / samples) / (1.0 / 16.0 - 1.0 / 20.0)
    np.testing.assert_allclose(faded, expected, rtol=1e-5)


def balanced(machine: PhaseMachine, frame: CurrentFrame) -> tuple[float, float]:
    """Copper loss in W of 1 N m at 750 rpm in the averaged loop, and the ripple in N m."""
    control = plain_control(machine, "four-leg", frame, harmonics=None)
    trace = AveragedDrive(machine, model_of(control)).run(np.array([750.0]), np.ones(1), 0.12, 0.04)
    assert np.mean(trace.torque) == pytest.approx(1.0, rel=1e-3)
    return float(np.mean(np.sum(trace.currents**2, axis=2))), float(np.ptp(trace.torque))


@pytest.mark.slow
def test_the_averaged_loop_makes_constant_torque() -> None:
    """Ripple of the near sinusoidal machine at 750 and 1800 rpm: 0.05 and 0.2 % at the most."""
    control = plain_control(near_sinusoidal(192), harmonics=None)
    drive = AveragedDrive(near_sinusoidal(2880), model_of(control))
    trace = drive.run(np.array([750.0, 1800.0]), np.ones(2), 0.16, 0.04)
    assert np.all(trace.ripple(1.0) < np.array([5e-4, 2e-3]))
    np.testing.assert_allclose(np.mean(trace.torque, axis=0), 1.0, rtol=1e-3)


@pytest.mark.slow
def test_the_averaged_loop_saves_the_copper_that_the_frames_promise() -> None:
    """Loss of dqx over dqy: 1.0137 of the near sinusoidal machine, 1.0419 of the trapezoid."""
    for machine, ratio in ((near_sinusoidal(192), 1.0137), (trapezoidal(192), 1.0419)):
        of_x, of_y = balanced(machine, "dqx"), balanced(machine, "dqy")
        assert of_x[0] / of_y[0] == pytest.approx(ratio, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "stable"), [(3.1, True), (3.3, False)])
def test_one_gain_for_all_axes_is_unstable_where_the_zero_inductance_is_small(
    ratio: float, *, stable: bool
) -> None:
    """At 500 Hz and 10 kHz the boundary lies at L_ab / L_0 = f_s / omega_c = 3.18."""
    l_ab = 8e-3
    l_0 = l_ab / ratio
    m_s = (l_0 - l_ab) / 3.0
    machine = replace(near_sinusoidal(96), l_s=l_ab + m_s, m_s=m_s)
    control = plain_control(machine, frame="dqy", harmonics=None)
    same = (control.gains[0],) * 3
    drive = AveragedDrive(machine, model_of(replace(control, gains=same)), v_dc=2000.0)
    trace = drive.run(np.array([75.0]), np.zeros(1), 0.04, 0.04, initial=np.full((3, 1), 0.3))
    zero = np.abs(np.mean(trace.currents[:, 0], axis=1))
    assert (np.max(zero[-40:]) < 0.3) == stable
    assert (np.max(zero[-40:]) > 1.0) == (not stable)


def test_several_electrical_periods_have_their_own_shape() -> None:
    """A second period weaker than the first gets more current there."""
    machine = near_sinusoidal(96)
    flux = np.concatenate([machine.flux, 0.8 * machine.flux], axis=1)
    model = model_of(plain_control(machine, shape=PhaseShape(flux, 2), harmonics=None))
    state = model.structure.at_rest(2)
    measured = measured_at(2)[:, :6]
    measured[:, 3] = [0.4, 0.4 + 2.0 * np.pi]
    measured[:, 4] = 0.0
    model.torque_control(state, measured, np.ones(2, dtype=np.float32))
    v = np.hypot(*state.v)
    assert v[1] / v[0] == pytest.approx(1.25, rel=1e-4)
