"""Control of phase machines in integers: on a sampled plant of its own, and its refusals."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from fixed_phase_loop import Loop
from phase_drives import T_S, near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES, leg_signs
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.fixed_phase_control.design import _least_square, fit_phase_control
from dqforge.optimizer.fixed_phase_control.integers import (
    Control,
    FixedPhaseControl,
    Measured,
    Turning,
    Vector,
    phase_at_rest,
    phase_gains,
)
from dqforge.optimizer.fixed_phase_control.leg_steps import LegSteps
from dqforge.optimizer.fixed_phase_control.phase_step import FrameSteps, HarmonicSteps, PhaseSteps
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, PhaseShape
from dqforge.optimizer.steps.code_vectors import Abc, Dq, Rotation
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range, Ranges

RPM = math.pi / 30.0

P, Z = near_sinusoidal(96), trapezoidal(96)


def design(voltage: float = 300.0, **bases: float) -> Any:
    """What the integers need of a design."""
    scales = {"current": 8.0, "voltage": voltage, "speed": 2000.0 * RPM, "torque": 5.0} | bases
    return SimpleNamespace(
        control=SimpleNamespace(bases=SimpleNamespace(**scales), speed_loop=None, t_s=T_S),
        machine=SimpleNamespace(omega_m_max=1800.0 * RPM),
        i_max=5.94,
        inverter=SimpleNamespace(v_dc=220.0),
        weakening=None,
    )


def integers(machine: PhaseMachine, topology: Topology, **changes: Any) -> FixedPhaseControl:
    return fit_phase_control(design(), plain_control(machine, topology, **changes)).control


CASES = [
    ("P", "four-leg", "table", 0.4),
    pytest.param("Z", "six-leg", "dqy", 0.9, marks=pytest.mark.slow),
    pytest.param("Z", "three-wire", "table", 0.9, marks=pytest.mark.slow),
    pytest.param("P", "split-capacitor", "dqx", 0.4, marks=pytest.mark.slow),
    pytest.param("P", "six-leg-isolated", "dqx", 0.4, marks=pytest.mark.slow),
    pytest.param("Z", "diode-neutral", "table", 0.9, marks=pytest.mark.slow),
    pytest.param("Z", "four-leg", "dqy", 0.9, marks=pytest.mark.slow),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "topology", "frame", "ripple"), CASES)
def test_torque_is_smooth_and_right(
    name: str, topology: Topology, frame: CurrentFrame, ripple: float
) -> None:
    machine = {"P": P, "Z": Z}[name]
    loop = Loop(machine, integers(machine, topology, frame=frame), 750.0 * RPM)
    torque = loop.torque(1.0, 0.0, 700)[500:]
    assert np.mean(torque) == pytest.approx(1.0, abs=2e-3)
    assert 100.0 * np.ptp(torque) < ripple


@pytest.mark.parametrize(
    ("name", "topology", "frame"),
    [("Z", "four-leg", "dqy"), ("P", "split-capacitor", "dqx")],
)
def test_torque_is_there_within_five_samples(
    name: str, topology: Topology, frame: CurrentFrame
) -> None:
    machine = {"P": P, "Z": Z}[name]
    loop = Loop(machine, integers(machine, topology, frame=frame), 750.0 * RPM)
    torque = loop.torque(1.0, 0.0, 22)[5:]
    assert np.all((torque > 0.98) & (torque < 1.17))


@pytest.mark.slow
def test_sinusoidal_currents_leave_the_ripple_of_the_back_emf() -> None:
    control = integers(P, "four-leg", frame="dq")
    torque = Loop(P, control, 750.0 * RPM).torque(0.0, 1.0 / (3.0 * P.psi_pm), 900)[500:]
    assert np.mean(torque) == pytest.approx(1.0, abs=5e-3)
    assert 100.0 * np.ptp(torque) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize("rows", [3, 1])
def test_flux_between_the_nodes_is_that_of_the_machine(rows: int) -> None:
    """One row serves phases that are a third of a turn apart."""
    control = integers(Z, "four-leg")
    third = Z.flux[0].size // 3
    np.testing.assert_allclose(Z.flux[1], np.roll(Z.flux[0], third), atol=1e-12)
    control = replace(control, shape=control.shape[:rows])
    angle = np.arange(65536)
    flux = PhaseSteps(control).references.flux(Integers(), phase_gains(control).shape, angle)
    found = np.stack(flux) / 2**15 * control.bases[4]
    exact = np.stack(
        [np.interp(angle / 65536.0, np.arange(97) / 96.0, np.append(row, row[0])) for row in Z.flux]
    )
    assert np.max(np.abs(found - exact)) < 3.0 * control.bases[4] / 2**15


@pytest.mark.parametrize("topology", get_args(Topology))
def test_duty_cycles_make_the_voltage(topology: Topology) -> None:
    """Leg voltages of the switching states, averaged, are the phase voltages that are asked for."""
    control, generator = integers(P, topology), np.random.default_rng(3)
    rule, code, count = TOPOLOGIES[topology], 2**15, 500
    v_dc, v_m = (np.full(count, x * code // 100) for x in (90, 43))
    v = generator.integers(-code // 6, code // 6, (3, count))
    v[2] = v[2] // 4 if control.has_zero else 0
    links = (v_dc, v_m) if rule.midpoint else (v_dc,)
    legs = LegSteps(control).duties(Integers(), Vector(*v), *links)
    made = leg_signs(topology) @ np.stack(legs) / code * v_dc * 2**control.dc_scale
    if rule.midpoint:
        made = made - v_m * 2**control.dc_scale
    if not control.has_zero:
        made = made - np.mean(made, axis=0)
    asked = np.linalg.inv(clarke_matrix()) @ v
    assert np.max(np.abs(made - asked)) <= 3.0 * 2**control.dc_scale


@pytest.mark.parametrize("place", range(4))
def test_turning_integrator_makes_its_voltage(place: int) -> None:
    """(kp + (R + j w L) exp(1.5 j n w t_s)) r, turned to now, by complex numbers."""
    control, generator, code = integers(P, "four-leg"), np.random.default_rng(4), 2**15
    part, steps, count = control.harmonics[place], HarmonicSteps(control), 300
    held = generator.integers(-code // 4, code // 4, (2, count))
    now, turn = generator.uniform(0.0, 2.0 * np.pi, (2, count))
    omega = generator.integers(-code // 2, code // 2, count)

    def rotation(angle: Any) -> Rotation[Any]:
        return Rotation(*(np.rint((code - 1) * f(angle)).astype(int) for f in (np.cos, np.sin)))

    state = Turning(*(held << control.harmonic_fraction))
    full = np.full(count, control.top)
    axis = phase_gains(control).q
    made = steps.harmonic_voltage(
        Integers(), axis, part.reactance, full, state, rotation(now), rotation(turn), omega,
        np.array(part.order),
    )  # fmt: skip
    sign = 1.0 if part.order > 0 else -1.0
    impedance = axis.resistance.value + 1j * sign * part.reactance.value * omega / code
    r = (held[0] + 1j * held[1]) * np.exp(1j * now)
    exact = (axis.kp.value + impedance * np.exp(1j * turn)) * r
    whole = np.abs(exact) < code
    assert np.count_nonzero(whole) > count // 2
    error = np.abs(made.x + 1j * made.y - exact)[whole]
    assert np.max(error) < 2e-3 * code


@pytest.mark.parametrize("topology", get_args(Topology))
def test_nothing_overflows_from_any_state(topology: Topology) -> None:
    reaches = fit_phase_control(design(), plain_control(P, topology)).reaches
    assert all(reach.fits for reach in reaches)
    assert len(reaches) > 60


def test_what_is_seen_lies_within_the_ranges() -> None:
    """Random codes reach no value that the intervals exclude."""
    control, generator = integers(P, "split-capacitor"), np.random.default_rng(5)
    ranges = Ranges(16)
    every = Range(-(2**15), 2**15 - 1)

    def held(bits: int) -> Range:
        return Range(-32767 << bits, 32767 << bits)

    def word() -> Any:
        return generator.integers(-(2**15), 2**15, 4000)

    def some(part: Range) -> Any:
        return generator.integers(part.low, part.high, 4000, endpoint=True)

    def state(of: Any) -> Control[Any]:
        """With every number that the word of a member holds."""
        found, turning = phase_at_rest(control, of(Range(0, 0))), held(control.harmonic_fraction)
        axes = (control.d, control.q, control.zero)
        d, q, zero = (of(held(0 if axis is None else axis.fraction)) for axis in axes)
        found.integral, found.open_phase = (d, q, zero), of(Range(0, 3))
        found.harmonic = tuple(Turning(of(turning), of(turning)) for _ in control.harmonics)
        return found

    angle, upper = Range(0, 65535), Range(0, 32767)
    step, gains = PhaseSteps(control).shaped_control, phase_gains(control)
    measured = Measured(Abc(every, every, every), angle, every, every, upper)
    step(ranges, gains, state(lambda part: part), measured, every, Dq(every, every))
    numbers = Integers(seen={})
    measured = Measured(Abc(word(), word(), word()), some(angle), word(), word(), some(upper))
    step(numbers, gains, state(some), measured, word(), Dq(word(), word()))
    assert numbers.seen
    for name, (low, high) in numbers.seen.items():
        found = ranges.reaches[name].range.hull(Range(0, 0))  # where the record starts
        assert found.low <= low, name
        assert high <= found.high, name


def test_open_phase_is_taken_from_the_reference() -> None:
    control = integers(P, "four-leg")
    loop = Loop(P, control, 300.0 * RPM)
    zero = np.zeros(1, dtype=np.int64)
    step, gains = PhaseSteps(control).shaped_control, phase_gains(control)
    for angle in range(0, 65536, 4096):
        state = phase_at_rest(control, zero)
        state.open_phase = np.array([2])
        measured = Measured(
            Abc(zero, zero, zero), np.array([angle]), loop.codes(0.1), loop.codes(0.5), None
        )
        step(Integers(), gains, state, measured, loop.codes(0.2), Dq(zero, zero))
        alpha, beta, none = (float(x[0]) for x in state.reference)
        a, b, c = np.linalg.inv(clarke_matrix()) @ np.array([alpha, beta, none])
        assert abs(b) <= 3.0
        assert max(abs(a), abs(c)) > 500.0


@pytest.mark.parametrize(
    ("changes", "key"),
    [({"current": 5.0}, "current"), ({"speed": 100.0}, "speed"), ({"voltage": 90.0}, "voltage")],
)
def test_bases_that_hold_too_little_are_named(changes: dict[str, float], key: str) -> None:
    with pytest.raises(InputError, match=rf"control\.per_unit\.{key}.*write {key}:"):
        fit_phase_control(design(**changes), plain_control(P))


def test_measured_coupling_is_refused() -> None:
    with pytest.raises(InputError, match="measured is not there in fixed point; write references"):
        fit_phase_control(design(), plain_control(P, frame="dqy", feedforward="measured"))


def test_gain_that_no_word_holds_is_named() -> None:
    control: PhaseControl = plain_control(P)
    large = replace(control, inductances=(8e-3, 8e-3, 5e3))
    with pytest.raises(NoSolutionError, match="L / t_s of 0"):
        fit_phase_control(design(), large)


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_errors_on_the_axes_of_a_frame_make_the_voltage_again(frame: CurrentFrame) -> None:
    """Axes are as long as the flux and at right angles, where the zero sequence counts twice: the
    sum of <b, v> b / |f|^2 is v. In dqx there is no zero sequence, and a plane's length.
    """
    control, generator, code = integers(P, "four-leg", frame=frame), np.random.default_rng(6), 2**15
    steps, count = FrameSteps(control), 400
    size, angle = generator.uniform(0.45, 0.65, count), generator.uniform(-np.pi, np.pi, count)
    f = np.stack(
        [size * np.cos(angle), size * np.sin(angle), generator.uniform(-0.25, 0.25, count)]
    )
    flux, wanted = (
        np.rint(x * code).astype(int) for x in (f, generator.uniform(-0.2, 0.2, f.shape))
    )
    axes = np.array(
        [[np.broadcast_to(x, count) for x in one] for one in steps.frame(Integers(), Vector(*flux))]
    )
    weight = np.array([1.0, 1.0, 2.0 if frame == "dqy" else 0.0])
    inner = np.einsum("ikn,jkn,k->ijn", axes, axes, weight) / code**2
    length = np.einsum("kn,k->n", (flux / code) ** 2, weight)
    count_of = 3 if frame == "dqy" else 2
    for i, j in itertools.product(range(count_of), repeat=2):
        assert np.max(np.abs(inner[i, j] - (i == j) * length)) < 3e-4
    assert np.all(axes[1, :2] == flux[:2])
    held = steps.frame_errors(Integers(), Vector(*flux), Vector(*wanted))
    exact = np.einsum("kn,kn,k->n", flux, wanted, weight) / code
    assert np.max(np.abs(held[1] - exact)) < 2.0
    made = np.array(
        [np.broadcast_to(x, count) for x in steps.frame_voltage(Integers(), Vector(*flux), held)]
    )
    if frame == "dqx":
        wanted[2] = 0
    assert np.max(np.abs(made - wanted)) < 8.0


@pytest.mark.parametrize("frame", get_args(CurrentFrame))
def test_the_least_squared_flux_is_that_of_the_three_phases(frame: CurrentFrame) -> None:
    """Amplitude-invariant axes keep two thirds of the squares, a third of the sum counted apart."""
    one = np.random.default_rng(4).normal(size=96)
    control = plain_control(Z, "four-leg", frame=frame)
    control = replace(control, shape=PhaseShape(one[None]))
    places = np.arange(one.size)
    flux = np.stack([one[(places - k * one.size // 3) % one.size] for k in range(3)])
    mean = flux.mean(axis=0)
    square = 2.0 / 3.0 * np.sum((flux - mean) ** 2, axis=0)
    whole = square + 2.0 * mean**2 if frame == "dqy" else square
    assert _least_square(control, 0.4) == pytest.approx(np.min(whole) / 0.16, rel=1e-9)
