"""The emitted controller in the loop: against the exact sampled loops, over thousands of drives,
and its files.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design
from hidden_compilers import hide_compilers
from scipy.optimize import brentq

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    PlantErrors,
    Profile,
    Scenario,
    constant,
)
from dqforge.optimizer.loops.plants import current_loop, current_step, speed_loop, speed_step
from dqforge.optimizer.observers.reduced_order import steady_state_error
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.simulation import recorded_run as simulation_module
from dqforge.reports.simulation.design_run import (
    controller_files,
    drive_of,
    npz_bytes,
    simulate_design,
    step_figures,
)
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import (
    Simulation,
    Simulator,
    compile_simulator,
    simulate,
    simulate_many,
    simulator,
)
from dqforge.reports.simulation.tables import plain_simulation, simulation_tables

T_S = 1e-4
MACHINE = LinearMachine(
    pole_pairs=3,
    r_s=0.3,
    l_d=2e-3,
    l_q=2e-3,
    psi_pm=0.1,
    i_max=50.0,
    inertia=0.05,
    friction=0.01,
    omega_m_max=300.0,
)


def drive_design() -> Design:
    base = make_design(MACHINE)
    control = replace(
        base.control,
        t_s=T_S,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=2.0 * math.pi * 400.0),
        speed_loop=SpeedLoopSettings("symmetrical-optimum", ratio=5, spread=4.0),
    )
    return replace(base, control=control, inverter=Inverter(500.0, 1.0 / T_S), losses=None)


@pytest.fixture(scope="module")
def solved() -> Solution:
    return solve(drive_design())


@pytest.fixture(scope="module")
def program(solved: Solution) -> Iterator[Simulator]:
    with simulator(controller_files(solved), solved.design.export.prefix) as compiled:
        yield compiled


def run(program: Simulator, solved: Solution, scenario: Scenario) -> Simulation:
    return simulate(program, drive_of(solved.design), scenario)


@pytest.mark.thinned
@pytest.mark.parametrize("axis", ["d", "q"])
def test_current_step_is_that_of_the_sampled_loop(
    program: Simulator, solved: Solution, axis: str
) -> None:
    gains = solved.gains.i_d if axis == "d" else solved.gains.i_q
    step, none = constant(5.0), constant(0.0)
    references = (none, step) if axis == "d" else (step, none)
    found = run(program, solved, Scenario(0.01, "current", *references, shaft=constant(0.0)))
    expected = 5.0 * current_step(current_loop(0.3, 2e-3, T_S, gains.kp, gains.ki), 101).reference
    value, other = (found.i_d, found.i_q) if axis == "d" else (found.i_q, found.i_d)
    np.testing.assert_allclose(value, expected, atol=5e-5)
    np.testing.assert_allclose(other, 0.0, atol=5e-5)
    assert 0.5 < float(np.max(np.abs(np.diff(value)))) < 5.0


def test_disturbance_of_the_current_loop_too(program: Simulator, solved: Solution) -> None:
    """A back-EMF that the controller does not know of is a step of voltage at the winding."""
    gains = replace_psi(solved, 0.0)
    omega_m = 0.5
    scenario = Scenario(0.01, "current", constant(0.0), constant(0.0), shaft=constant(omega_m))
    found = simulate(program, drive_of(solved.design), scenario, gains=gains)
    loop = current_loop(0.3, 2e-3, T_S, solved.gains.i_q.kp, solved.gains.i_q.ki)
    expected = -3.0 * omega_m * 0.1 * current_step(loop, 101).disturbance
    np.testing.assert_allclose(found.i_q, expected, atol=1e-3 * float(np.max(np.abs(expected))))


def replace_psi(solved: Solution, psi_pm: float) -> bytes:
    return gain_bytes({**plain_control(solved), "psi_pm": psi_pm})


def test_speed_step_and_load_step_are_those_of_the_sampled_loops(
    program: Simulator, solved: Solution
) -> None:
    """At 1 rad/s the voltage is never at its limit, and what the axes do to each
    other is of second order.
    """
    speed, current = solved.gains.speed, solved.gains.i_q
    assert speed is not None
    gains = (current.kp, current.ki), 5, (speed.kp, speed.ki)
    expected = speed_step(speed_loop((0.3, 2e-3), (0.05, 0.01), T_S, *gains), 120)
    drive = Drive(MACHINE, Inverter(500.0, 1.0 / T_S), T_S, ratio=5)
    stepped = simulate(program, drive, Scenario(0.0599, "speed", constant(1.0)))
    np.testing.assert_allclose(stepped.omega_m, expected.reference, atol=5e-3)
    loaded = simulate(program, drive, Scenario(0.0599, "speed", constant(0.0), load=constant(2.0)))
    disturbed = 2.0 * expected.disturbance
    np.testing.assert_allclose(
        loaded.omega_m, disturbed, atol=5e-3 * float(np.max(np.abs(disturbed)))
    )
    assert 1.05 < float(np.max(stepped.omega_m)) < 1.6


def test_torque_reference_is_followed_through_the_emitted_references(
    program: Simulator, solved: Solution
) -> None:
    torque = Profile((0.0, 0.02), (5.0, -12.0))
    found = run(program, solved, Scenario(0.04, "torque", torque, shaft=constant(40.0)))
    before, after = np.searchsorted(found.t, [0.0199, 0.0399])
    assert float(found.torque[before]) == pytest.approx(5.0, rel=5e-4)
    assert float(found.torque[after]) == pytest.approx(-12.0, rel=5e-4)
    assert float(found.i_q_reference[after]) == pytest.approx(-12.0 / (1.5 * 3 * 0.1), rel=1e-5)


def test_duty_cycles_act_one_period_after_their_samples(
    program: Simulator, solved: Solution
) -> None:
    """No current at the samples 0 and 1: what is computed at 0 acts from 1 to 2."""
    found = run(
        program,
        solved,
        Scenario(0.001, "current", constant(5.0), constant(0.0), shaft=constant(0.0)),
    )
    np.testing.assert_array_equal(found.i_q[:2], 0.0)
    np.testing.assert_array_equal(found.duty[0], 0.5)
    assert float(found.i_q[2]) > 0.5
    assert not np.array_equal(found.duty[1], found.duty[0])


def test_speed_limit_of_the_torque_and_voltage_limit_leave_no_windup(
    program: Simulator, solved: Solution
) -> None:
    """A step far beyond the voltage: it limits the speed, and the way back takes neither
    windup nor wild currents.
    """
    reference = Profile((0.0, 4.0), (5000.0, 200.0))
    found = run(program, solved, Scenario(7.0, "speed", reference))

    def voltage_left(omega_m: float) -> float:  # at i_d = 0, with the friction to overcome
        i_q, omega_e = 0.01 * omega_m / (1.5 * 3 * 0.1), 3.0 * omega_m
        return 500.0 / math.sqrt(3.0) - math.hypot(2e-3 * omega_e * i_q, 0.3 * i_q + 0.1 * omega_e)

    most = brentq(voltage_left, 0.0, 1000.0)
    assert 0.85 * most < float(np.max(found.omega_m)) < 1.01 * most
    assert float(found.figures.peak_current[0]) < 1.5 * solved.design.i_max
    assert float(found.omega_m[-1]) == pytest.approx(200.0, abs=0.1)
    assert float(np.min(found.omega_m[found.t > 4.0])) > 170.0


def random_drive(generator: np.random.Generator) -> tuple[Drive, Scenario, bytes]:
    """A machine of any size with its own current gains, at any speed within the voltage,
    off its data by 20 %.
    """
    p = int(generator.integers(1, 8))
    i_max = float(10.0 ** generator.uniform(0.0, 2.7))
    v_dc, f_s = float(10.0 ** generator.uniform(1.2, 2.9)), 10e3
    psi = v_dc / math.sqrt(3.0) / float(generator.uniform(600.0, 3000.0))
    l_d = float(generator.uniform(0.15, 0.8)) * psi / i_max
    l_q = l_d * float(generator.uniform(0.7, 3.0))
    r_s = float(generator.uniform(0.01, 0.1)) * v_dc / i_max
    machine = LinearMachine(p, r_s, l_d, l_q, psi, i_max, inertia=1.0)
    # Magnitude optimum of L and R with a delay of 1.5 samples: kp = L/(3 t_s), ki = R/(3 t_s);
    # tracking time kp/ki.
    pis = [
        (inductance * f_s / 3.0, r_s / 3.0, min(r_s / (inductance * f_s), 1.0))
        for inductance in (l_d, l_q)
    ]
    plain = {
        "d": pis[0],
        "q": pis[1],
        "speed": (0.0, 0.0, 0.0),
        "pole_pairs": p,
        "r_s": r_s,
        "l_d": l_d,
        "l_q": l_q,
        "psi_pm": psi,
        "voltage_share": 1.0 / math.sqrt(3.0),
        "advance": 1.5 / f_s,
        "torque_max": 1.0,
        "speed_filter": 1.0,
        "ratio": 1,
    }
    speed = float(generator.uniform(-0.4, 0.4)) * v_dc / math.sqrt(3.0) / psi / p
    wrong = generator.choice([-0.2, 0.0, 0.2], size=4)
    scenario = Scenario(
        duration=0.1,
        mode="current",
        reference=constant(0.4 * i_max * float(generator.uniform(-1.0, 1.0))),
        reference_d=constant(-0.3 * i_max * float(generator.uniform(0.0, 1.0))),
        shaft=constant(speed),
        omega_m=speed,
        errors=PlantErrors(r_s=wrong[0], l_d=wrong[1], l_q=wrong[2], psi_pm=wrong[3]),
    )
    return Drive(machine, Inverter(v_dc, f_s), 1.0 / f_s), scenario, gain_bytes(plain)


@pytest.mark.slow
def test_two_thousand_drives_off_their_data_settle(program: Simulator) -> None:
    """One program, one process: machines of 1 to 500 A and 16 to 800 V, each wrong
    by 20 % in any direction.
    """
    generator = np.random.default_rng(20261121)
    runs = [random_drive(generator) for _ in range(2000)]
    found = simulate_many(program, runs, tail=0.8)
    limit = np.array([drive.machine.i_max for drive, _, _ in runs])
    assert np.all(found.bounded)
    assert float(np.max(found.tail_error / limit)) < 0.01
    assert float(np.max(found.peak_current / limit)) < 3.0
    # Ten times the gains are beyond the margin: the same sweep must see it.
    drive, scenario, gains = runs[0]
    numbers = np.frombuffer(gains[:36], dtype=np.float32) * np.float32(10.0)
    wild = simulate_many(program, [(drive, scenario, numbers.tobytes() + gains[36:])], tail=0.8)
    assert float(wild.tail_error[0]) > 0.05 * drive.machine.i_max


def test_gains_given_are_the_gains_of_the_header(program: Simulator, solved: Solution) -> None:
    scenario = Scenario(0.02, "speed", constant(30.0))
    drive = drive_of(solved.design)
    own, given = (
        simulate(program, drive, scenario, gains=g)
        for g in (b"", gain_bytes(plain_control(solved)))
    )
    np.testing.assert_array_equal(own.i_q, given.i_q)
    with pytest.raises(VerificationError, match="gains"):
        simulate(program, drive, scenario, gains=b"12345678")


def test_sensors_leave_their_mark(program: Simulator, solved: Solution) -> None:
    """With an encoder and a converter the speed holds to a count, and with an
    offset the torque oscillates.
    """
    drive = drive_of(solved.design)
    sensor = CurrentSensor(bits=12, full_scale=60.0, noise=0.02)
    scenario = Scenario(0.6, "speed", constant(50.0), encoder=Encoder(lines=2048), sensor=sensor)
    found = simulate(program, drive, scenario, tail=0.8)
    one_count = 2.0 * math.pi / 8192.0 / (5 * T_S)
    assert 1e-4 < float(found.figures.tail_error[0]) < one_count
    assert set(np.unique(np.round(found.omega_m_measured[found.t > 0.5] / one_count, 6)) % 1.0) <= {
        0.0
    }
    offset = replace(scenario, sensor=CurrentSensor(offset=(0.5, 0.0, -0.5)), encoder=Encoder())
    oscillating = simulate(program, drive, offset, tail=0.8).torque[-2000:]
    spectrum = np.abs(np.fft.rfft(oscillating - np.mean(oscillating)))
    frequency = np.fft.rfftfreq(2000, T_S)[int(np.argmax(spectrum))]
    assert float(frequency) == pytest.approx(
        3.0 * 50.0 / (2.0 * math.pi), abs=5.0
    )  # once per electrical turn


def test_switched_inverter_follows_the_averaged_one(program: Simulator, solved: Solution) -> None:
    scenario = Scenario(0.3, "speed", constant(100.0), load=constant(3.0))
    drive = drive_of(solved.design)
    averaged = simulate(program, drive, scenario)
    switched = simulate(program, drive, replace(scenario, inverter="switched"))
    np.testing.assert_allclose(switched.omega_m, averaged.omega_m, atol=0.5)
    assert float(switched.figures.peak_current[0]) > float(averaged.figures.peak_current[0])


@pytest.mark.slow
def test_speed_of_the_observer_in_the_loop() -> None:
    """Paper 001: under load the estimate errs by what the observer's theory says,
    and the drive runs on it.
    """
    design = catalogue.load("paper001-pmsm-bench")
    omega = 1500.0 * math.pi / 30.0
    scenario = Scenario(
        1.0,
        "speed",
        constant(omega),
        load=constant(0.2),
        encoder=Encoder(speed="observer"),
        omega_m=omega,
        dead_time=0.0,
    )
    found = simulate_design(replace(design, simulation=scenario)).run
    estimate = float(np.mean(found.omega_m_measured[-500:]))
    true = float(np.mean(found.omega_m[-500:]))
    assert estimate == pytest.approx(omega, rel=1e-4)  # the controller holds what it believes
    assert design.control.observer is not None
    assert design.control.observer.pole is not None
    expected = steady_state_error(
        design.machine, design.control.observer.pole, design.control.t_s, true, torque_load=0.2
    )
    assert (estimate - true) / true == pytest.approx(expected.relative, abs=2e-3)
    assert abs(expected.relative) > 5e-3


@pytest.mark.slow
def test_phase_machine_runs_with_ripple(shared_steps: FloatArray) -> None:
    """A fifth harmonic of the back-EMF makes a torque ripple of six times the electrical
    frequency under dq control; references from the table of the back-EMF make none.
    """
    base = catalogue.load("paper002-phase-waveforms")
    loop = replace(base.control.current_loop, frame="dq", harmonic_integrators=False)
    design = replace(base, control=replace(base.control, current_loop=loop))
    scenario = Scenario(
        0.3, "torque", constant(2.0), shaft=constant(30.0), omega_m=30.0, dead_time=0.0
    )
    found = simulate_design(replace(design, simulation=scenario)).run
    torque = found.torque[-1000:]
    assert float(np.mean(torque)) == pytest.approx(2.0, rel=0.02)
    assert float(np.ptp(torque)) > 0.02
    follows = simulate_design(replace(base, simulation=scenario)).run.torque[-1000:]
    assert float(np.mean(follows)) == pytest.approx(2.0, rel=2e-3)
    assert float(np.ptp(follows)) < 0.01
    assert design.phase_machine is not None
    assert shared_steps.size


@pytest.fixture
def shared_steps() -> FloatArray:
    return np.linspace(0.0, 1.0, 2001)


def test_figures_of_a_step_by_hand(shared_steps: FloatArray) -> None:
    """Second order with damping 0.5: overshoot exp(-pi/sqrt 3) = 16.3 %;
    a first-order lag rises in ln 9 tau.
    """
    t = shared_steps
    lag = 10.0 * (1.0 - np.exp(-t / 0.05))
    (first,) = step_figures(t, lag, constant(10.0))
    assert first.rise == pytest.approx(0.05 * math.log(9.0), rel=1e-3)
    assert first.settling == pytest.approx(0.05 * math.log(50.0), abs=1e-3)
    assert first.overshoot == 0.0
    w, z = 60.0, 0.5
    root = math.sqrt(1.0 - z * z)
    swing = 1.0 - np.exp(-z * w * t) * (np.cos(root * w * t) + z / root * np.sin(root * w * t))
    (second,) = step_figures(t, -4.0 * swing, constant(-4.0))
    assert second.overshoot == pytest.approx(math.exp(-math.pi / math.sqrt(3.0)), rel=1e-3)
    assert step_figures(t, lag, Profile((0.0, 1.0), (0.0, 10.0), "linear")) == ()
    assert math.isnan(step_figures(t[:40], lag[:40], constant(10.0))[0].rise)


def test_archive_is_the_same_bytes_and_reads_back(program: Simulator, solved: Solution) -> None:
    scenario = Scenario(0.02, "speed", constant(30.0), sensor=CurrentSensor(noise=0.1))
    first, second = (npz_bytes(run(program, solved, scenario)) for _ in range(2))
    assert first == second
    archive = np.load(io.BytesIO(first))
    assert archive["duty"].shape == (201, 3)
    assert archive["t"][-1] == pytest.approx(0.02)
    assert "figures" not in archive


@pytest.mark.slow
def test_unstable_drive_is_said_to_be_unstable() -> None:
    design = drive_design()
    wild = CurrentLoopSettings("given", kp=8.0, ki=100.0, min_phase_margin=0.0)
    base = solve(design)
    q = replace(base.gains.i_q, kp=80.0)
    worse = replace(base, loops=replace(base.gains, i_q=q, i_d=replace(base.gains.i_d, kp=80.0)))
    scenario = Scenario(0.1, "current", constant(5.0), constant(0.0), shaft=constant(0.0))
    narrow = replace(
        design, simulation=scenario, control=replace(design.control, current_loop=wild)
    )
    narrow = replace(narrow, machine=replace(MACHINE, i_max=0.05))
    found = simulate_design(narrow, solution=worse)
    assert not found.run.figures.bounded[0]
    assert "unstable" in simulation_tables(found)[0].notes[0]
    assert plain_simulation(found)["bounded"] is False


def test_designs_that_cannot_be_simulated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    with pytest.raises(InputError, match="section such as simulation"):
        simulate_design(drive_design())
    design = replace(drive_design(), simulation=Scenario(0.1, "speed", constant(1.0)))
    hide_compilers(monkeypatch)
    with pytest.raises(VerificationError, match="no C compiler found"):
        simulate_design(design)


def test_a_broken_header_does_not_compile(tmp_path: object, solved: Solution) -> None:
    from pathlib import Path

    files = controller_files(solved) | {"drive_control.h": b"#error broken\n"}
    with pytest.raises(VerificationError, match="does not compile"):
        compile_simulator(Path(str(tmp_path)), files, "drive")


def test_failing_programs_are_one_line(
    monkeypatch: pytest.MonkeyPatch, program: Simulator, solved: Solution
) -> None:
    monkeypatch.setattr(simulation_module, "share_tables", lambda runs: runs[:0])
    with pytest.raises(VerificationError, match="input is too short"):
        run(program, solved, Scenario(0.01, "speed", constant(1.0)))
