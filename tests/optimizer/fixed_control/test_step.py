"""The control functions in integers against real arithmetic, and the current
loop closed through them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from drives import SURFACE, make_design
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, PerUnitBases
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import (
    Pair,
    Triple,
    clarke,
    clarke_inverse,
    clarke_matrix,
    park,
    park_inverse,
)
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.codes import FIXED_MODULATORS, Codes, rotation
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.fixed_control.transforms import (
    DutySteps,
    FixedPi,
    Measured,
    Pi,
    PiVelocity,
    ReducedOrder,
    control_at_rest,
    decoupling,
    pi_gains,
    pi_step,
    pi_velocity_step,
    reduced_order_gains,
    reduced_order_step,
)
from dqforge.optimizer.loops.integer_gains import given, quantise
from dqforge.optimizer.observers.reduced_order import estimate_speed, simulate_observer
from dqforge.optimizer.steps.code_vectors import Abc, AlphaBeta, Dq
from dqforge.optimizer.steps.integer_arithmetic import CodeArray, Integers

EXACT = Integers()
WIDTHS = (16, 32)


def one(width: int) -> float:
    return 2.0 ** (width - 1)


def codes_of(values: FloatArray, base: float, width: int) -> CodeArray:
    return np.clip(np.rint(values / base * one(width)), -one(width), one(width) - 1.0).astype(
        np.int64
    )


@pytest.mark.parametrize("width", WIDTHS)
def test_sine_and_cosine_of_every_angle(width: int) -> None:
    """All 65,536 angles of 16 bits.

    Of 32 bits the corners of the quadrants and half a million others.
    """
    quarter = 2 ** (width - 2)
    near = (np.arange(4)[:, None] * quarter + np.arange(-50, 51)).ravel() % 2**width
    random = np.random.default_rng(1).integers(0, 2**32, 500_000)
    angle = np.arange(65_536) if width == 16 else np.concatenate([near, random])
    turn = rotation(EXACT, width, angle)
    exact = angle * (2.0 * np.pi / 2.0**width)
    limit = 1.4 if width == 16 else 2.4
    assert np.max(np.abs(turn.x - one(width) * np.cos(exact))) <= limit
    assert np.max(np.abs(turn.y - one(width) * np.sin(exact))) <= limit
    opposite = rotation(EXACT, width, (2**width - angle) % 2**width)
    assert np.array_equal(opposite.y, -turn.y)
    assert np.array_equal(opposite.x, turn.x)
    # the length of the vector is what scales currents: within three codes of one
    assert np.max(np.abs(np.hypot(turn.x.astype(float), turn.y.astype(float)) - one(width))) < 3.0


@pytest.mark.parametrize("width", WIDTHS)
def test_clarke_and_park_within_their_quanta(width: int) -> None:
    generator = np.random.default_rng(2)
    phases = generator.integers(-int(one(width)), int(one(width)), (3, 100_000))
    found = clarke(Codes(EXACT, width), Triple(*phases))
    exact = clarke_matrix() @ phases
    # half a code by the shift, and the rounding of the constant times four full scales
    for values, real in ((found.x, exact[0]), (found.y, exact[1])):
        assert np.max(np.abs(values - np.clip(real, -one(width) + 1, one(width) - 1))) < 0.5 + 2.0
    vector = generator.integers(-int(one(width)) + 1, int(one(width)), (2, 100_000))
    back = clarke_inverse(Codes(EXACT, width), Pair(*vector))
    real_b = -0.5 * vector[0] + math.sqrt(0.75) * vector[1]
    assert np.array_equal(back.a, vector[0])
    assert np.max(np.abs(back.b - np.clip(real_b, -one(width) + 1, one(width) - 1))) <= 1.1
    angle = generator.integers(0, 2**width, 100_000)
    turn = rotation(EXACT, width, angle)
    theta = angle * (2.0 * np.pi / 2.0**width)
    small = np.rint(vector * 0.7).astype(np.int64)
    moved = park(Codes(EXACT, width), Pair(*small), turn)
    real = (
        small[0] * np.cos(theta) + small[1] * np.sin(theta),
        small[1] * np.cos(theta) - small[0] * np.sin(theta),
    )
    error = 0.5 + 0.7 * 2.0 * (1.4 if width == 16 else 2.4)
    assert np.max(np.abs(moved.x - real[0])) <= error
    assert np.max(np.abs(moved.y - real[1])) <= error
    again = park_inverse(Codes(EXACT, width), moved, turn)
    assert np.max(np.abs(again.x - small[0])) <= 2.0 * error
    assert np.max(np.abs(again.y - small[1])) <= 2.0 * error


def test_clarke_is_exact_within_one_code_for_balanced_currents() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 10_001)
    phases = [
        np.rint(20_000.0 * np.cos(angle - k * 2.0 * np.pi / 3.0)).astype(np.int64) for k in range(3)
    ]
    found = clarke(Codes(EXACT, 16), Triple(*phases))
    assert np.max(np.abs(found.x - 20_000.0 * np.cos(angle))) < 1.5
    assert np.max(np.abs(found.y - 20_000.0 * np.sin(angle))) < 1.5


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", FIXED_MODULATORS)
def test_duties_are_those_of_the_modulators(name: ModulationName, width: int) -> None:
    """Against the modulators in double precision, within their linear range.

    Ties may fall to the other phase.
    """
    generator = np.random.default_rng(3)
    count, v_dc, base = 4000, 300.0, 200.0
    scale = 1  # the dc link on 400 V
    angle, lag = generator.uniform(-np.pi, np.pi, (2, count))
    amplitude = generator.uniform(0.02, 1.0, count) * MODULATORS[name].linear_limit * v_dc
    shifts = np.array([0.0, 2.0, -2.0]) * np.pi / 3.0
    voltage = amplitude[:, None] * np.cos(angle[:, None] - shifts)
    current = 7.0 * np.cos((angle - lag)[:, None] - shifts)
    expected = modulate(name, voltage, current, v_dc)
    vector = AlphaBeta(
        codes_of(amplitude * np.cos(angle), base, width),
        codes_of(amplitude * np.sin(angle), base, width),
    )
    i = Abc(*(codes_of(current[:, k], 10.0, width) for k in range(3)))
    link = np.full(count, codes_of(np.array(v_dc), 400.0, width))
    found = DutySteps(width, name, scale).duties(EXACT, vector, link, i)
    duty = np.stack([found.a, found.b, found.c], axis=1)
    assert duty.min() >= 0
    assert duty.max() <= one(width)
    # what the machine sees, the voltages between the phases, is always right: four roundings
    between, wanted = (
        duty - np.roll(duty, 1, axis=1),
        expected.duty - np.roll(expected.duty, 1, axis=1),
    )
    assert np.max(np.abs(between - one(width) * wanted)) <= 5.0
    away = np.max(np.abs(duty - one(width) * expected.duty), axis=1)
    # a b c / V^2 divides by a small number where there is little voltage
    tied = away > 5.0 + (3.0 * v_dc / amplitude if name.startswith("thip") else 0.0)
    assert np.mean(tied) < (2e-3 if width == 16 else 1e-3)
    if name in DISCONTINUOUS:
        assert np.all((duty.min(axis=1) == 0) | (duty.max(axis=1) == one(width)))


def test_duties_saturate_beyond_the_dc_link() -> None:
    full = np.array([32_767, -32_768], dtype=np.int64)
    steps = DutySteps(16, "svpwm", 0)
    vector, phases = AlphaBeta(full, full), Abc(full, full, full)
    found = steps.duties(EXACT, vector, np.array([1, 1]), phases)
    assert all(np.all((part >= 0) & (part <= 32_768)) for part in (found.a, found.b, found.c))


def pi_of(kp: float, ki: float, fraction: int, width: int = 16) -> FixedPi:
    scale, error = 2.0**fraction, 2**width - 1
    return FixedPi(
        quantise(kp, width, error),
        quantise(ki * scale, width, error),
        quantise(min(ki / kp, 1.0) * scale, width, 2 ** (width - 1)),
        fraction,
    )


@pytest.mark.parametrize("width", WIDTHS)
def test_controllers_follow_real_ones(width: int) -> None:
    """Both forms over 2000 samples of noise: the integral drifts by less than its rounding allows,
    nothing more.
    """
    generator = np.random.default_rng(4)
    kp, ki, top = 0.8, 0.004, one(width) - 1.0
    parallel, velocity = pi_of(kp, ki, 14, width), pi_of(kp, ki, 12, width)
    error = np.rint(generator.uniform(-0.05, 0.05, (2000, 50)) * top).astype(np.int64)
    limit = np.full(50, int(top))
    integral = np.zeros(50, dtype=np.int64)
    state, pi = PiVelocity(integral, integral), Pi(integral)
    gains, swift_gains = pi_gains(width, parallel), pi_gains(width, velocity)
    exact = np.zeros(50)
    real_kp, real_ki = parallel.kp.realised, parallel.ki.realised * 2.0**-14
    for e in error:
        exact = exact + real_ki * e
        output = pi_step(EXACT, gains, pi, e, limit)
        swift = pi_velocity_step(EXACT, swift_gains, state, e, limit)
        assert np.max(np.abs(output - real_kp * e - exact)) < 1.0 + 2000 * 0.5 * 2.0**-14 + 0.05
        assert np.max(np.abs(swift - output)) < 2.0 + 2000 * 2.0**-12


def test_the_shift_of_the_thesis_drifts_and_ours_does_not() -> None:
    """Errors of mean zero: rounding downwards takes half a code per product and sample,
    rounding to nearest nothing.
    """
    generator = np.random.default_rng(5)
    noise = generator.integers(-40, 41, 40_000)
    error = np.concatenate([noise, -noise])
    generator.shuffle(error)
    kp, ki = given(0.1328125, 10), given(26 / 2**15, 15)
    changes = np.diff(error, prepend=0)
    theirs = ((kp.mantissa * changes) >> 10) + ((ki.mantissa * error) >> 15)
    pi = FixedPi(kp, replace(ki, shift=1), quantise(1.0, 16, 32_768), 14)
    state = PiVelocity(np.zeros((), dtype=np.int64), np.zeros((), dtype=np.int64))
    limit, gains = np.array(32_767), pi_gains(16, pi)
    for e in error[:20_000]:
        output = pi_velocity_step(EXACT, gains, state, e, limit)
    real = 0.1328125 * error[19_999] + 26 / 2**15 * error[:20_000].sum()
    assert theirs.sum() < -0.5 * error.size
    assert abs(float(output) - real) < 2.0


def test_saturation_and_back_calculation() -> None:
    """Held at the limit for long, the controller leaves it in the sample
    in which the error turns.
    """
    gains = pi_gains(16, pi_of(2.0, 0.05, 12))
    pi, limit = Pi(np.array([0, 0])), np.array([10_000, 0])
    for _ in range(5000):
        output = pi_step(EXACT, gains, pi, np.array([3000, 3000]), limit)
    assert output.tolist() == [10_000, 0]
    assert np.all(np.abs(pi.integral) <= 32_767 << 12)
    output = pi_step(EXACT, gains, pi, np.array([-3000, -3000]), limit)
    assert output[0] < 10_000
    state = PiVelocity(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))
    for _ in range(3000):
        swift = pi_velocity_step(EXACT, gains, state, np.array([3000]), np.array([10_000]))
    assert swift[0] == 10_000
    swift = pi_velocity_step(EXACT, gains, state, np.array([2000]), np.array([10_000]))
    assert swift[0] < 10_000


def fitted(design: Design, width: int) -> FixedControlFit:
    gains = solve_gains(design)
    return fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, width)


@pytest.mark.parametrize("width", WIDTHS)
def test_decoupling_in_volts(width: int) -> None:
    design = catalogue.load("paper001-pmsm-bench")
    control, machine = fitted(design, width).control, design.machine
    current, voltage, speed, _ = control.bases
    generator = np.random.default_rng(6)
    omega, i_d, i_q = generator.uniform(-0.99, 0.99, (3, 5000))
    codes = [np.rint(x * one(width)).astype(np.int64) for x in (omega, i_d, i_q)]
    feed = decoupling(EXACT, width, control.decoupling, codes[0], Dq(codes[1], codes[2]))
    omega_e = omega * speed * machine.pole_pairs
    quantum = voltage / one(width)
    loose = (
        3.0 if width == 16 else 5.0
    )  # codes; the gains are exact to some 1e-5 and 1e-10 of full scale
    assert (
        np.max(np.abs(feed.x * quantum + omega_e * machine.l_q * i_q * current)) < loose * quantum
    )
    wanted = omega_e * (machine.l_d * i_d * current + machine.psi_pm)
    assert np.max(np.abs(feed.y * quantum - wanted)) < loose * quantum


@pytest.mark.thinned
@pytest.mark.parametrize("width", WIDTHS)
def test_observer_follows_the_real_one(width: int) -> None:
    """Paper 001's machine over 0.4 s, i_d = 0: the speed within some codes
    of the observer in reals.
    """
    design = catalogue.load("paper001-pmsm-bench")
    gains, machine = solve_gains(design), design.machine
    observer, part = gains.observer, fitted(design, width).control.observer
    assert observer is not None
    assert part is not None
    count = 2000
    u_q = 40.0 + 20.0 * np.sin(np.arange(count) * 0.01)
    made = simulate_observer(observer, machine, u_q, np.full(count, 0.1))
    current, voltage, speed, _ = fitted(design, width).control.bases
    codes = codes_of(made.i_q, current, width), codes_of(u_q, voltage, width)
    zero = np.zeros((), dtype=np.int64)
    own, state = reduced_order_gains(width, part), ReducedOrder(zero, zero, Dq(zero, zero))
    found = np.zeros(count)
    for k in range(1, count):
        v, i = Dq(zero, codes[1][k - 1]), Dq(zero, codes[0][k])
        reduced_order_step(EXACT, width, own, state, v, i)
        found[k] = float(state.omega_m)
    i_q, u = (
        np.asarray(x * base / one(width), dtype=np.float64)
        for x, base in zip(codes, (current, voltage), strict=True)
    )
    exact = estimate_speed(observer, u, i_q, 0.0)
    error = found - exact / speed * one(width)
    assert np.max(np.abs(error[1:])) < 4.0


@dataclass(frozen=True)
class Course:
    """Currents (steps, drives, 2) and references (drives, 2) in A, the code in A, the code of the
    voltage in its codes per sample, the largest current over full scale.
    """

    current: FloatArray
    reference: FloatArray
    code: float
    kick: float


def random_drive(generator: np.random.Generator) -> Design:
    """A machine, a dc link and a sampling rate of any size, whose windings are not
    shorter than ten samples.
    """
    l_d = 10.0 ** generator.uniform(-4.3, -2.3)
    l_q = l_d * generator.uniform(0.5, 3.0)
    v_dc, t_s = generator.uniform(24.0, 600.0), 1.0 / generator.uniform(5e3, 40e3)
    r_s = 10.0 ** generator.uniform(-1.7, -1.0) * l_q / t_s
    pole_pairs, omega_e = int(generator.integers(1, 9)), generator.uniform(0.02, 0.15) / t_s
    psi = v_dc / math.sqrt(3.0) / omega_e * generator.uniform(0.3, 0.9)
    i_max = min(v_dc / math.sqrt(3.0) * t_s / l_q * generator.uniform(0.3, 3.0), 0.8 * psi / l_d)
    machine = LinearMachine(
        pole_pairs=pole_pairs,
        r_s=r_s,
        l_d=l_d,
        l_q=l_q,
        psi_pm=psi,
        i_max=i_max,
        omega_m_max=omega_e / pole_pairs,
    )
    design = make_design(machine)
    bases = PerUnitBases(
        1.25 * i_max,
        v_dc / math.sqrt(3.0),
        1.25 * omega_e / pole_pairs,
        1.5 * pole_pairs * psi * i_max,
    )
    control = replace(
        design.control,
        t_s=t_s,
        current_loop=CurrentLoopSettings(),
        speed_loop=None,
        observer=None,
        bases=bases,
    )
    return replace(
        design, control=control, inverter=replace(design.inverter, v_dc=v_dc, f_sw=1.0 / t_s)
    )


def period(machine: LinearMachine, omega_e: FloatArray, t_s: float) -> NDArray[np.float64]:
    """Exact transition over one period of (i_d, i_q, v_d, v_q, 1) at constant speed,
    voltage fixed in the stator.
    """
    from scipy.linalg import expm

    a = np.zeros((omega_e.size, 5, 5))
    a[:, 0, 0], a[:, 0, 1], a[:, 0, 2] = (
        -machine.r_s / machine.l_d,
        omega_e * machine.l_q / machine.l_d,
        1 / machine.l_d,
    )
    a[:, 1, 0], a[:, 1, 1], a[:, 1, 3] = (
        -omega_e * machine.l_d / machine.l_q,
        -machine.r_s / machine.l_q,
        1 / machine.l_q,
    )
    a[:, 1, 4] = -omega_e * machine.psi_pm / machine.l_q
    a[:, 2, 3], a[:, 3, 2] = omega_e, -omega_e
    return np.asarray(expm(a * t_s))


def closed_loop(
    design: Design, width: int, seed: int, drives: int = 16, steps: int = 1500
) -> Course:
    """Steps of the current reference at many speeds through the integer step:
    rounding of every quantity included.
    """
    generator = np.random.default_rng(seed)
    machine, t_s = design.machine, design.control.t_s
    assert isinstance(machine, LinearMachine)
    assert machine.omega_m_max is not None
    control = fitted(design, width).control
    i_base, v_base, speed, _ = control.bases
    omega_m = generator.uniform(-0.5, 0.5, drives) * machine.omega_m_max
    omega_e, size = (
        omega_m * machine.pole_pairs,
        generator.uniform(0.05, 0.3, drives) * machine.i_max,
    )
    beta = generator.uniform(0.5 * np.pi, 1.5 * np.pi, drives)
    reference = size[:, None] * np.stack([np.cos(beta), np.sin(beta)], axis=1)
    wanted = Dq(*(codes_of(reference[:, k], i_base, width) for k in range(2)))
    link = np.full(
        drives, codes_of(np.array(design.inverter.v_dc), v_base * 2.0**control.dc_scale, width)
    )
    step = period(machine, omega_e, t_s)
    theta = generator.uniform(0.0, 2.0 * np.pi, drives)
    current, voltage = np.zeros((drives, 2)), np.zeros((drives, 2))
    zero = np.zeros(drives, dtype=np.int64)
    state, seen = control_at_rest(zero), []
    for _ in range(steps):
        seen.append(current)
        cosine, sine = np.cos(theta), np.sin(theta)
        fixed = (
            current[:, 0] * cosine - current[:, 1] * sine,
            current[:, 0] * sine + current[:, 1] * cosine,
        )
        half = math.sqrt(0.75)
        phases = fixed[0], -0.5 * fixed[0] + half * fixed[1], -0.5 * fixed[0] - half * fixed[1]
        angle = np.mod(np.rint(theta / (2.0 * np.pi) * 2.0**width), 2.0**width).astype(np.int64)
        measured = Measured(
            Abc(*(codes_of(x, i_base, width) for x in phases)),
            angle,
            codes_of(omega_m, speed, width),
            link,
        )
        made = control.steps.current_control(EXACT, control.gains, state, measured, wanted)
        v_d, v_q = (
            voltage[:, 0] * cosine + voltage[:, 1] * sine,
            voltage[:, 1] * cosine - voltage[:, 0] * sine,
        )
        now = np.stack([current[:, 0], current[:, 1], v_d, v_q, np.ones(drives)], axis=1)
        current = np.einsum("nij,nj->ni", step, now)[:, :2]
        theta = theta + omega_e * t_s
        duty = np.stack([made.a, made.b, made.c]) / one(width) * design.inverter.v_dc
        voltage = np.stack(
            [(2.0 * duty[0] - duty[1] - duty[2]) / 3.0, (duty[1] - duty[2]) / math.sqrt(3.0)],
            axis=1,
        )
    code = i_base / one(width)
    kick = v_base / one(width) * t_s / min(machine.l_d, machine.l_q) / code
    return Course(np.array(seen), reference, code, kick)


@pytest.mark.thinned
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_loop_settles_within_the_quantum(width: int, seed: int) -> None:
    """Random drives at any speed: the mean ends within a code of the reference, the rest within
    what codes of the voltage do to the current in a sample.
    """
    course = closed_loop(random_drive(np.random.default_rng(100 + seed)), width, seed)
    error = (course.current[-300:] - course.reference) / course.code
    assert np.max(np.abs(error.mean(axis=0))) < 1.6
    assert np.max(np.abs(error)) < 5.0 + 9.0 * course.kick
    assert np.max(np.abs(course.current)) / course.code < one(width)


def test_the_answer_to_a_step_is_that_of_the_sampled_loop() -> None:
    """At standstill the integers follow the exact sampled loop, delay included,
    within some codes at every sample.
    """
    from dqforge.optimizer.loops.plants import current_loop, current_step

    design = make_design(SURFACE)
    bases = replace(design.control.bases, current=SURFACE.i_max * 1.25)
    design = replace(
        design,
        control=replace(design.control, t_s=1e-4, bases=bases, speed_loop=None, observer=None),
    )
    machine, control = replace(SURFACE, omega_m_max=1e-9), fitted(design, 16).control
    gains = solve_gains(design).i_q
    assert control.speed is None
    course = closed_loop(replace(design, machine=machine), 16, 9, drives=8, steps=200)
    loop = current_loop(SURFACE.r_s, SURFACE.l_q, gains.t_s, gains.kp, gains.ki)
    response = current_step(loop, 200).reference[:200]
    found = course.current[:, :, :] / course.reference
    tolerance = (8.0 + 6.0 * course.kick) * course.code / np.abs(course.reference)
    assert np.all(np.abs(found - response[:, None, None]) < tolerance)
