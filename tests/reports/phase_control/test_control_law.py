"""The voltage of a step of the control in closed form: feedforward, controllers and harmonics, in
phases and complex numbers written out here.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from phase_drives import T_S, near_sinusoidal, plain_control
from scipy.interpolate import RegularGridInterpolator

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.phase_control.phase_controller import AxisGains, MidpointGains, PhaseControl
from dqforge.optimizer.phase_control.phase_records import Alphabetazero, Control, TorqueLimit
from dqforge.optimizer.phase_control.shape_frame import Frame, shape_frame
from dqforge.optimizer.phase_control.torque_limits import (
    Limited,
    LimitedSteps,
    LimitSteps,
    TorqueSteps,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, AlphaBeta, Dq
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.header import (
    Surroundings,
    phase_control_from,
    plain_phase_control,
)

MACHINE = near_sinusoidal(96)
COUNT = 24
OMEGA_E = 420.0  # electrical, in rad/s
THETA = np.float32(2.0 * np.pi * (np.arange(COUNT) + 0.31) / COUNT - np.pi).astype(float)
LAGS = 2.0 * np.pi * np.arange(3)[:, None] / 3.0
L_D, L_Q, L_0 = 6e-3, 9e-3, 5e-3
GAINS = AxisGains(11.0, 2000.0), AxisGains(17.0, 5000.0), AxisGains(7.0, 3000.0)
ROOT = np.sqrt(0.75)


def control_of(
    topology: Topology, frame: CurrentFrame, feedforward: Feedforward, **changes: Any
) -> PhaseControl:
    """Unequal gains of all axes; unequal inductances in rotor coordinates alone."""
    control = plain_control(MACHINE, topology, frame, feedforward, harmonics=None)
    inductances = (L_D if frame == "dq" else L_Q, L_Q, L_0)
    gains = GAINS if TOPOLOGIES[topology].neutral else (*GAINS[:2], AxisGains(0.0, 0.0))
    return replace(control, inductances=inductances, gains=gains, **changes)


def model_of(control: PhaseControl) -> PhaseControlModel:
    """In rotor coordinates without the polynomials of a torque, which nothing here asks for."""
    turning = control.frame == "dq"
    known = replace(control, frame="table") if turning else control
    model = phase_control_from(plain_phase_control(known, Surroundings("svpwm")), {})
    made = replace(model.structure, frame="dq", salient=True) if turning else model.structure
    return replace(model, structure=made)


def flux(theta: FloatArray) -> FloatArray:
    """The table of the firmware, straight between its nodes, shape (3, N)."""
    nodes = 2.0 * np.pi * np.arange(97) / 96.0
    row = np.append(MACHINE.flux[0], MACHINE.flux[0][0])
    return np.asarray(np.interp(np.mod(theta - LAGS, 2.0 * np.pi), nodes, row))


def transformed(x: FloatArray) -> Alphabetazero:
    return Alphabetazero(
        (2.0 * x[0] - x[1] - x[2]) / 3.0, (x[1] - x[2]) / (2.0 * ROOT), np.mean(x, axis=0)
    )


def in_phases(x: Alphabetazero) -> FloatArray:
    flat = [x.alpha, -0.5 * x.alpha + ROOT * x.beta, -0.5 * x.alpha - ROOT * x.beta]
    return np.asarray(np.stack(flat) + np.asarray(x.zero))


def plane(x: Alphabetazero) -> Any:
    return x.alpha + 1j * x.beta


def wanted(
    control: PhaseControl, torque: float, theta: FloatArray, fade: float = 1.0, zero: float = 1.0
) -> Alphabetazero:
    """Currents of a torque: along the shape that has faded, with a share of its zero sequence; in
    rotor coordinates 2 A of d beside it."""
    turn = np.exp(1j * theta)
    if control.frame == "dq":
        i = (2.0 + 1j * torque / (1.5 * 2 * control.psi_pm)) * turn
        return Alphabetazero(i.real, i.imag, 0.0 * theta)
    f = transformed(flux(theta))
    seen = fade * plane(f) + (1.0 - fade) * 1j * control.psi_pm * turn
    f_0 = fade * f.zero
    scale = torque / (2 * (1.5 * np.abs(seen) ** 2 + 3.0 * zero * f_0**2))
    return Alphabetazero(scale * seen.real, scale * seen.imag, scale * zero * f_0)


def samples(i: Alphabetazero, omega_e: float, v_m: float = 2000.0) -> Any:
    """At a link that limits nothing."""
    rest = np.tile([[omega_e / 2.0, 4000.0, v_m]], (COUNT, 1))
    return np.column_stack([in_phases(i).T, THETA, rest]).astype(np.float32)


def stepped(
    control: PhaseControl, i: Alphabetazero, torque: float, omega_e: float, **v: float
) -> Control:
    """The state behind one sample of currents."""
    model = model_of(control)
    state = model.structure.at_rest(COUNT)
    rows = samples(i, omega_e, **v)
    rows = rows if model.structure.midpoint else rows[:, :6]
    asked = np.full(COUNT, torque, dtype=np.float32)
    if control.frame == "dq":
        q = asked / np.float32(1.5 * 2 * control.psi_pm)
        model.current_control(state, rows, (np.full(COUNT, 2.0, dtype=np.float32), q))
    else:
        model.torque_control(state, rows, asked)
    return state


def voltage(state: Any) -> Alphabetazero:
    return Alphabetazero(state.v.alpha, state.v.beta, state.v_0)


def same(found: Alphabetazero, expected: Alphabetazero, *, neutral: bool, within: float) -> None:
    np.testing.assert_allclose(plane(found), plane(expected), atol=within)
    np.testing.assert_allclose(found.zero, expected.zero if neutral else 0.0, atol=within)


DRIVES: list[tuple[Topology, CurrentFrame]] = [
    ("three-wire", "table"),
    ("three-wire", "dqx"),
    ("three-wire", "dq"),
    ("four-leg", "table"),
    ("four-leg", "dqx"),
    ("four-leg", "dqy"),
    ("four-leg", "dq"),
    ("six-leg", "dqy"),
    ("split-capacitor", "table"),
    ("split-capacitor", "dqx"),
]


@pytest.mark.parametrize(("topology", "frame"), DRIVES)
@pytest.mark.parametrize("omega_e", [OMEGA_E, -3400.0])
def test_references_are_fed_forward_as_the_machine_needs_them(
    topology: Topology, frame: CurrentFrame, omega_e: float
) -> None:
    """With currents on their references there is nothing left to the controllers: R at the mean of
    the two samples that bound the period in which the voltage acts, L times what the currents
    change by, and the back-EMF in its middle. At the higher speed a part of the shape has faded."""
    control = control_of(topology, frame, "references")
    neutral, torque = TOPOLOGIES[topology].neutral, 1.7
    per_period = 2.0 * np.pi / abs(omega_e) / T_S
    fade = float(np.clip((1.0 / 16.0 - 1.0 / per_period) / (1.0 / 16.0 - 1.0 / 20.0), 0.0, 1.0))
    assert fade == 1.0 or 0.1 < fade < 0.9
    zero = 1.0 if neutral and frame != "dqx" else 0.0
    step = omega_e * T_S
    now, first, second = (wanted(control, torque, THETA + n * step, fade, zero) for n in (0, 1, 2))
    state = stepped(control, now, torque, omega_e)
    emf = transformed(flux(THETA + 1.5 * step))
    if frame == "dq":
        turn = [np.exp(1j * (THETA + n * step)) for n in (1, 2)]
        a, b = (plane(i) / t for i, t in zip((first, second), turn, strict=True))
        linked = [(L_D * x.real + 1j * L_Q * x.imag) * t for x, t in zip((a, b), turn, strict=True)]
        risen = (linked[1] - linked[0]) / T_S
    else:
        risen = L_Q * (plane(second) - plane(first)) / T_S
    v = 0.5 * (plane(first) + plane(second)) + risen + omega_e * plane(emf)
    v_0 = 0.5 * (first.zero + second.zero) + L_0 * (second.zero - first.zero) / T_S
    expected = Alphabetazero(v.real, v.imag, v_0 + omega_e * emf.zero)
    same(voltage(state), expected, neutral=neutral, within=2e-4 * abs(omega_e) / OMEGA_E * 40.0)


@pytest.mark.parametrize(("topology", "frame"), DRIVES)
def test_measured_currents_are_fed_forward_as_if_they_stayed(
    topology: Topology, frame: CurrentFrame
) -> None:
    """Constant in the frame of the integrals, they need what inductances take as it turns."""
    control = control_of(topology, frame, "measured")
    neutral, step = TOPOLOGIES[topology].neutral, OMEGA_E * T_S
    zero = 1.0 if neutral and frame != "dqx" else 0.0
    now = wanted(control, 1.7, THETA, 1.0, zero)
    state = stepped(control, now, 1.7, OMEGA_E)
    along, acting = shape_frame(frame), THETA + 1.5 * step
    emf = transformed(flux(acting))
    h = 1e-5
    if along is None:
        i = plane(now) * np.exp(-1j * THETA)
        linked = control.inductances[0] * i.real + 1j * L_Q * i.imag
        v, v_0 = 1j * OMEGA_E * linked * np.exp(1j * acting), 0.0 * THETA
    else:
        psi: Any = control.psi_pm
        x: Frame = along.to_frame(EXACT, transformed(flux(THETA)), now, psi)
        later, before = (
            along.from_frame(EXACT, transformed(flux(acting + side)), x, psi) for side in (h, -h)
        )
        v = OMEGA_E * L_Q * (plane(later) - plane(before)) / (2.0 * h)
        v_0 = OMEGA_E * L_0 * (later.zero - before.zero) / (2.0 * h)
        if frame == "dqx":
            v_0 = 0.0 * THETA
    v = v + OMEGA_E * plane(emf)
    expected = Alphabetazero(v.real, v.imag, v_0 + OMEGA_E * emf.zero)
    same(voltage(state), expected, neutral=neutral, within=1e-2)


@pytest.mark.parametrize(("topology", "frame"), DRIVES)
def test_an_error_makes_what_the_controllers_of_its_axes_say(
    topology: Topology, frame: CurrentFrame
) -> None:
    """kp in rotor coordinates at the sample; the integrals in their frame, and back where the
    voltage acts."""
    control = control_of(topology, frame, "none")
    neutral, acting = TOPOLOGIES[topology].neutral, THETA + 1.5 * OMEGA_E * T_S
    zero = 1.0 if neutral and frame != "dqx" else 0.0
    drawn = np.random.default_rng(9).normal(size=(3, COUNT))
    away = drawn if neutral else drawn - np.mean(drawn, axis=0)
    now = in_phases(wanted(control, 1.7, THETA, 1.0, zero))
    state = stepped(control, transformed(now - away), 1.7, OMEGA_E)
    error, turn = transformed(away), np.exp(1j * THETA)
    e = plane(error) / turn
    gained = (GAINS[0].kp * e.real + 1j * GAINS[1].kp * e.imag) * turn
    ki_ts = [axis.ki * T_S for axis in GAINS]
    along = shape_frame(frame)
    if along is None:
        integrals = [ki_ts[0] * e.real, ki_ts[1] * e.imag, ki_ts[2] * error.zero]
        kept = (integrals[0] + 1j * integrals[1]) * np.exp(1j * acting)
        back = Alphabetazero(kept.real, kept.imag, integrals[2])
    else:
        psi: Any = control.psi_pm
        seen: Frame = along.to_frame(EXACT, transformed(flux(THETA)), error, psi)
        integrals = [gain * part for gain, part in zip(ki_ts, seen, strict=True)]
        if not neutral:
            integrals[2] = 0.0 * THETA
        back = along.from_frame(EXACT, transformed(flux(acting)), Frame(*integrals), psi)
    v = plane(back) + gained
    expected = Alphabetazero(v.real, v.imag, back.zero + GAINS[2].kp * error.zero)
    same(voltage(state), expected, neutral=neutral, within=2e-3)
    held = [pi.integral for pi in (state.d, state.q, state.zero) if pi is not None]
    for one, other in zip(held, integrals, strict=False):
        np.testing.assert_allclose(one, other, atol=2e-4)


def test_harmonics_are_those_of_their_orders() -> None:
    """An integral r of the order n makes kp r as it is now, and (R + j n omega L) r where the
    voltage acts; of the zero sequence the real part. It learns the error that turns with it."""
    control = plain_control(MACHINE, "four-leg", "table", "none")
    assert control.harmonics is not None
    control = replace(
        control, inductances=(L_D, L_Q, L_0), gains=GAINS, shape=control.shape,
        harmonics=replace(control.harmonics, plane=(-5, 7), zero=(3, 9)),
    )  # fmt: skip
    model = model_of(control)
    omega_e = 1400.0  # orders 5 to 9 fade
    acting = THETA + 1.5 * omega_e * T_S
    state = model.structure.at_rest(COUNT)
    drawn = np.random.default_rng(11).normal(size=(2, 2, 2, COUNT)).astype(np.float32)
    state.harmonic = tuple(AlphaBeta(*r) for r in drawn[0])
    state.harmonic_zero = tuple(AlphaBeta(*r) for r in drawn[1])
    now = wanted(control, 0.4, THETA)
    away = Alphabetazero(np.full(COUNT, 0.05), np.full(COUNT, -0.04), np.full(COUNT, 0.03))
    measured = samples(Alphabetazero(*(a - b for a, b in zip(now, away, strict=True))), omega_e)
    plain = stepped(
        replace(control, harmonics=None),
        Alphabetazero(*(a - b for a, b in zip(now, away, strict=True))),
        0.4,
        omega_e,
    )
    model.torque_control(state, measured[:, :6], np.full(COUNT, 0.4, dtype=np.float32))
    fades = {n: float(np.clip(5.0 - 5.0 * n * omega_e * 6.0 * T_S / (2.0 * np.pi), 0.0, 1.0))
             for n in (3, 5, 7, 9)}  # fmt: skip
    assert 0.0 < fades[7] < 1.0 == fades[3]
    added, added_0 = np.zeros(COUNT, dtype=complex), np.zeros(COUNT)
    rate = 60.0 * T_S
    for place, n in enumerate((-5, 7)):
        r = drawn[0, place, 0] + 1j * drawn[0, place, 1]
        gain = 0.5 * (GAINS[0].kp + GAINS[1].kp) * np.exp(1j * n * THETA)
        gain = gain + (1.0 + 1j * n * omega_e * 0.5 * (L_D + L_Q)) * np.exp(1j * n * acting)
        added += fades[abs(n)] * r * gain
        learnt = r + rate * fades[abs(n)] * plane(away) * np.exp(-1j * n * THETA)
        found = state.harmonic[place]
        np.testing.assert_allclose(found.alpha + 1j * found.beta, learnt, atol=1e-6)
    for place, n in enumerate((3, 9)):
        r = drawn[1, place, 0] + 1j * drawn[1, place, 1]
        gain = GAINS[2].kp * np.exp(1j * n * THETA)
        gain = gain + (1.0 + 1j * n * omega_e * L_0) * np.exp(1j * n * acting)
        added_0 += fades[n] * (r * gain).real
        learnt = r + rate * fades[n] * away.zero * np.exp(-1j * n * THETA)
        found = state.harmonic_zero[place]
        np.testing.assert_allclose(found.alpha + 1j * found.beta, learnt, atol=1e-6)
    np.testing.assert_allclose(plane(voltage(state)) - plane(voltage(plain)), added, atol=2e-3)
    np.testing.assert_allclose(state.v_0 - plain.v_0, added_0, atol=2e-3)


@pytest.mark.parametrize("frame", ["table", "dqy"])
@pytest.mark.parametrize(("omega_e", "share"), [(5.0, 0.25), (400.0, 1.0)])
def test_a_midpoint_that_is_off_takes_a_zero_sequence(
    frame: CurrentFrame, omega_e: float, share: float
) -> None:
    """Of 0.05 A/V; below its speed the zero sequence of the shape fades with the speed."""
    control = control_of("split-capacitor", frame, "none", midpoint=MidpointGains(0.05, 20.0))
    off = 6.0
    f = transformed(flux(THETA))
    plain = wanted(control, 1.7, THETA, 1.0, share)
    extra = np.full((3, COUNT), -0.05 * off)
    row = in_phases(f)
    extra = extra - row * np.sum(row * extra, axis=0) / np.sum(row * row, axis=0)
    state = stepped(
        control, transformed(in_phases(plain) + extra), 1.7, omega_e, v_m=2000.0 + off
    )  # fmt: skip
    held = [pi.integral for pi in (state.d, state.q, state.zero) if pi is not None]
    assert np.max(np.abs(held)) < 1e-4
    assert np.max(np.abs(voltage(state))) < 1e-3


@pytest.mark.parametrize("frame", ["table", "dqx", "dq"])
@pytest.mark.parametrize("opened", [1, 2, 3])
def test_an_open_phase_leaves_the_torque_to_the_others(frame: CurrentFrame, opened: int) -> None:
    """Whole shape, zero sequence and all, of the two that are left, whatever the speed."""
    control = control_of("four-leg", frame, "none", psi_pm=0.19)
    model = model_of(control)
    state = model.structure.at_rest(COUNT)
    state.open = np.full(COUNT, opened, dtype=np.uint32)
    f = flux(THETA)
    f[opened - 1] = 0.0
    now = transformed(1.7 * f / (2.0 * np.sum(f * f, axis=0)))
    rows = samples(now, 3400.0)[:, :6]
    q = np.full(COUNT, 1.7 / (1.5 * 2 * 0.19), dtype=np.float32)
    model.current_control(state, rows, (0.0 * q, q))
    assert np.max(np.abs(voltage(state))) < 2e-4
    state.open[:] = 0
    model.current_control(state, rows, (0.0 * q, q))
    assert np.max(np.abs(voltage(state))) > 1.0


@pytest.mark.parametrize("topology", ["three-wire", "four-leg", "six-leg", "split-capacitor"])
def test_a_voltage_beyond_the_link_keeps_its_direction(topology: Topology) -> None:
    """All of it is shortened by one share until a leg is full on or off; the integrals rest."""
    control = control_of(topology, "table", "none")
    model = model_of(control)
    away = Alphabetazero(*np.random.default_rng(3).normal(size=(3, COUNT)))
    found = []
    for v_dc in (4000.0, 9.0):
        state = model.structure.at_rest(COUNT)
        rows = samples(away, OMEGA_E, 0.5 * v_dc)
        rows[:, 5] = v_dc
        rows = rows if model.structure.midpoint else rows[:, :6]
        asked = np.full(COUNT, 1.7, dtype=np.float32)
        duty = np.array(model.torque_control(state, rows, asked))
        found.append((np.array(voltage(state)), state, duty))
    (whole, free, _), (cut, held, duty) = found
    share = np.sum(whole * cut, axis=0) / np.sum(whole * whole, axis=0)
    np.testing.assert_allclose(cut, share * whole, atol=1e-4)
    assert np.all((share > 0.0) & (share < 0.99))
    full = np.minimum(np.min(duty, axis=0), 1.0 - np.max(duty, axis=0))
    np.testing.assert_allclose(full, 0.0, atol=2e-6)
    assert np.any(free.q.integral)
    assert not np.any(held.q.integral)


def test_currents_of_a_start_are_added_to_those_of_a_torque() -> None:
    """d beside the torque, q as the torque that it makes along the shape; in rotor coordinates both
    to the currents of the torque."""
    asked = np.full(COUNT, 0.6, dtype=np.float32)
    d, q = np.full(COUNT, -1.2, dtype=np.float32), np.full(COUNT, 0.8, dtype=np.float32)
    per_ampere = np.float32(1.5 * 2 * MACHINE.psi_pm)
    for frame in ("table", "dq"):
        model = model_of(control_of("four-leg", "dq" if frame == "dq" else "table", "none"))
        holds = replace(model, structure=replace(model.structure, start_up=True))
        state = holds.structure.at_rest(COUNT)
        assert state.held is not None
        state.held = Dq(d, q)
        rows = samples(Alphabetazero(*np.zeros((3, COUNT))), OMEGA_E)[:, :6]
        if frame == "dq":
            steps = replace(holds.steps, currents=lambda torque: (0.5 * torque, 2.0 * torque))
            numbers, measured = holds.numbers, holds.measured(rows)
            reference, torque = steps.of_torque(SINGLE, numbers, state, measured, asked)
            np.testing.assert_allclose(reference.d, 0.5 * asked + d, rtol=1e-6)
            np.testing.assert_allclose(reference.q, 2.0 * asked + q, rtol=1e-6)
            np.testing.assert_allclose(torque, asked)
            continue
        given, limited = holds.of_torque(state, rows, asked)
        np.testing.assert_allclose(limited, asked + per_ampere * q, rtol=1e-6)
        np.testing.assert_allclose(given[0], d)
        np.testing.assert_allclose(given[1], asked / per_ampere + q, rtol=1e-6)


@pytest.mark.parametrize("nominal", [None, 250.0])
def test_the_table_of_torques_is_read_by_straight_lines(nominal: float | None) -> None:
    """At the speed that loads the nominal link as much, or at the speed itself; the last values
    hold beyond the ends, and a torque is cut to them with its sign."""
    generator = np.random.default_rng(13)
    omega_e, v_dc = np.array([10.0, 120.0, 300.0, 700.0]), np.array([0.0, 90.0, 260.0])
    table = TorqueLimit(omega_e, v_dc, generator.uniform(0.5, 3.0, (4, 3)))
    speed, link = generator.uniform(0.0, 900.0, 300), generator.uniform(20.0, 320.0, 300)
    link[:3] = 0.0, -5.0, np.inf
    limits = LimitSteps(nominal)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = limits.largest_torque(EXACT, table, speed, link)
        seen = speed if nominal is None else np.where(link > 0.0, speed * nominal / link, 700.0)
    read = RegularGridInterpolator((omega_e, v_dc), table.torque)
    inside = np.column_stack([np.clip(seen, 10.0, 700.0), np.clip(link, 0.0, 260.0)])
    np.testing.assert_allclose(found, read(inside), rtol=1e-12)
    gains: Any = SimpleNamespace(torque_max=2.0, torque_limit=table)
    torque = generator.uniform(-4.0, 4.0, 300)
    torque[5:8] = np.nan, np.inf, -np.inf
    sign = np.where(generator.uniform(size=300) < 0.5, -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        held = TorqueSteps(limits).limited_torque(EXACT, gains, torque, sign * speed, link)
    most = np.minimum(found, 2.0)
    np.testing.assert_allclose(held, np.nan_to_num(np.clip(torque, -most, most)), rtol=1e-12)
    assert np.count_nonzero(np.abs(torque) < most) > 50


def test_currents_beyond_the_proportional_ones_are_read_between_their_nodes() -> None:
    """Between speeds, shares of the torque and angles by straight lines, motoring alone; backwards
    at the opposite angle with b and c exchanged."""
    generator = np.random.default_rng(17)
    nodes, omega_e = 12, np.array([200.0, 300.0, 450.0])
    values = generator.normal(size=(3, 4, nodes + 1))
    values[..., -1] = values[..., 0]
    plain, most = np.array([2.0, 1.5, 1.0]), np.array([2.5, 2.2, 1.0])
    table = Limited(omega_e, plain, most, (values,))
    count, nominal = 400, 300.0
    omega = generator.uniform(100.0, 500.0, count) * np.where(np.arange(count) % 2, 1.0, -1.0)
    link, torque = generator.uniform(250.0, 380.0, count), generator.uniform(-3.0, 3.0, count)
    place = generator.uniform(-0.5, 1.5, count)
    opened = (np.arange(count) % 5 == 0) * 1
    load = np.abs(omega) * nominal / link
    clipped = np.clip(load, 200.0, 450.0)
    low, high = np.interp(clipped, omega_e, plain), np.interp(clipped, omega_e, most)
    for mirrored, neutral in ((True, True), (False, False)):
        steps = LimitedSteps(table, nominal, mirrored, neutral)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = steps.limited_place(EXACT, torque, omega, link, opened)
            base = Alphabetazero(*generator.normal(size=(3, count)))
            found = steps.deviated(EXACT, table, base, at, place)
            part = np.where(high > low, (np.abs(torque) - low) / (high - low), 0.0)
        motors = (load >= 200.0) & (torque * omega > 0.0) & (opened == 0)
        if not mirrored:
            motors &= omega > 0.0
        np.testing.assert_array_equal(at.sign, motors * np.sign(omega))
        read = RegularGridInterpolator(
            (omega_e, np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, nodes + 1)), values
        )
        axes = clipped, np.clip(part, 0.0, 1.0)
        turned = np.sign(omega) * place
        added = np.stack(
            [read(np.column_stack([*axes, np.mod(turned - n / 3.0, 1.0)])) for n in range(3)]
        )
        backwards = omega < 0.0
        added[1:, backwards] = added[:0:-1, backwards]
        added[:, ~motors] = 0.0
        expected = transformed(added)
        np.testing.assert_allclose(found.alpha - base.alpha, expected.alpha, atol=1e-6)
        np.testing.assert_allclose(found.beta - base.beta, expected.beta, atol=1e-6)
        zero = expected.zero if neutral else 0.0
        np.testing.assert_allclose(found.zero - base.zero, zero, atol=1e-6)
        assert np.count_nonzero(motors) > 40
        gains: Any = SimpleNamespace(torque_max=1.2, torque_limit=None)
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = TorqueSteps(None, steps).limited_torque(EXACT, gains, torque, omega, link)
        helps = (load >= 200.0) & (torque * omega > 0.0) & (mirrored | (omega > 0.0))
        end = np.where(helps, np.maximum(high, 1.2), 1.2)
        np.testing.assert_allclose(cut, np.clip(torque, -end, end), rtol=1e-12)
