"""Control in integers in the loop: beside float32 in hard transients, over thousands of drives."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    ObserverSettings,
    PerUnitBases,
    WeakeningSettings,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import NumberFormat, ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, Sensorless, constant
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.design import fit_control
from dqforge.optimizer.fixed_control.transforms import FixedControl
from dqforge.optimizer.solution import solve
from dqforge.reports.simulation.design_run import drive_of, emitted_files, simulate_design
from dqforge.reports.simulation.plant_input import Drive, integer_gain_bytes
from dqforge.reports.simulation.recorded_run import (
    Simulation,
    Simulator,
    simulate,
    simulate_many,
    simulator,
)

RPM = math.pi / 30.0
ALL: tuple[NumberFormat, ...] = ("float32", "q15", "q31")


MOST = 2400.0 * RPM


@pytest.fixture(scope="module")
def ipm() -> Design:
    """The IPM of 9.1 A, its field weakened, emitted in every format."""
    base = catalogue.load("abb-ipmsm-2k2")
    assert isinstance(base.machine, LinearMachine)
    control = replace(base.control, bases=PerUnitBases(12.5, 312.0, 1.25 * MOST, 25.0))
    return replace(
        base,
        machine=replace(base.machine, omega_m_max=MOST),
        control=control,
        losses=None,
        weakening=WeakeningSettings(omega_m=MOST),
        export=replace(base.export, control=ALL),
    )


@pytest.fixture(scope="module")
def programs(ipm: Design) -> Iterator[dict[NumberFormat, Simulator]]:
    solution = solve(ipm)
    prefix = ipm.export.prefix
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(
                simulator(emitted_files(solution, name), prefix, number_format=name)
            )
            for name in ALL
        }


Programs = dict[NumberFormat, Simulator]


def runs_of(ipm: Design, programs: Programs, scenario: Scenario) -> dict[NumberFormat, Simulation]:
    return {name: simulate(program, drive_of(ipm), scenario) for name, program in programs.items()}


def peak(run: Simulation) -> float:
    return float(run.figures.peak_current[0])


def test_what_a_step_in_integers_logs_is_what_the_machine_has() -> None:
    """Currents as the references, the torque as asked for, and the voltage of the phasors
    (r_s + j omega L) i + j omega psi.
    """
    base = catalogue.load("abb-ipmsm-2k2")
    scenario = Scenario(
        0.03, "torque", constant(5.0), shaft=constant(50.0), omega_m=50.0, dead_time=0.0
    )
    export = replace(base.export, control=("q15",))
    run = simulate_design(
        replace(base, losses=None, weakening=None, export=export, simulation=scenario)
    ).run
    machine, omega_e = base.machine, 50.0 * base.machine.pole_pairs
    assert isinstance(machine, LinearMachine)
    i_d, i_q = float(run.i_d[-1]), float(run.i_q[-1])
    assert (run.i_d_reference[-1], run.i_q_reference[-1]) == pytest.approx((i_d, i_q), abs=0.02)
    assert run.torque_reference[-1] == pytest.approx(5.0, abs=1e-3)
    assert run.torque[-1] == pytest.approx(5.0, abs=0.02)
    v_d = machine.r_s * i_d - omega_e * machine.l_q * i_q
    v_q = machine.r_s * i_q + omega_e * (machine.l_d * i_d + machine.psi_pm)
    held = float(np.hypot(run.v_alpha[-1], run.v_beta[-1]))
    assert held == pytest.approx(math.hypot(v_d, v_q), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("i_d", [0.0, -2.0, -5.0])
def test_currents_that_the_link_cannot_make_stay_as_small_as_in_float32(
    i_d: float, ipm: Design, programs: Programs
) -> None:
    """8 A are asked for at 1400 rpm from a link of 300 V, which is far too little."""
    scenario = Scenario(
        0.1,
        "current",
        Profile((0.0, 0.02), (0.0, 8.0)),
        constant(i_d),
        shaft=constant(1400.0 * RPM),
        omega_m=1400.0 * RPM,
        v_dc=constant(300.0),
    )
    found = runs_of(ipm, programs, scenario)
    assert peak(found["float32"]) < 7.5
    for run in found.values():
        assert peak(run) == pytest.approx(peak(found["float32"]), rel=0.01)
        np.testing.assert_allclose(run.i_q, found["float32"].i_q, atol=0.05)


@pytest.mark.slow
def test_braking_from_beyond_the_base_speed(ipm: Design, programs: Programs) -> None:
    """From motoring at 2200 rpm to braking, down to 1200 rpm, with the map of field weakening."""
    turning = Profile((0.0, 0.15, 0.3), (2200.0 * RPM, 2200.0 * RPM, 1200.0 * RPM), "linear")
    torque = Profile((0.0, 0.02, 0.15), (0.0, 10.0, -14.0))
    scenario = Scenario(0.3, "torque", torque, shaft=turning, omega_m=2200.0 * RPM)
    found = runs_of(ipm, programs, scenario)
    for run in found.values():
        assert peak(run) == pytest.approx(peak(found["float32"]), rel=0.02)
        # at the voltage limit hundredths of an ampere of the reference make tenths of a N m
        more = run.torque[300:1150] - found["float32"].torque[300:1150]
        assert float(np.min(more)) > -0.25
        assert float(np.mean(more)) < 0.06 * float(np.mean(found["float32"].torque[300:1150]))
        assert float(run.torque[-1]) == pytest.approx(-14.0, abs=0.1)
    # the voltage leaves less than is asked for
    assert float(np.mean(found["float32"].torque[300:1150])) < 0.75 * 10.0
    assert peak(found["float32"]) < 1.05 * ipm.machine.i_max


@pytest.mark.slow
def test_speed_control_of_the_bench_in_every_format() -> None:
    base = catalogue.load("paper001-pmsm-bench")
    design = replace(base, losses=None, export=replace(base.export, control=ALL))
    found = simulate_design(design)
    assert found.formats == ALL
    for run in found.others:
        assert run.speed_largest == pytest.approx(found.speed_largest, rel=0.01)
        assert peak(run.run) == pytest.approx(peak(found.run), rel=0.02)
        assert run.tracking[1] == pytest.approx(found.tracking[1], rel=0.02)
    names = sorted(found.files())
    prefix = design.export.prefix
    assert names == [
        f"{prefix}_simulation.npz",
        f"{prefix}_simulation_q15.npz",
        f"{prefix}_simulation_q31.npz",
    ]


T_S = 1e-4


def designed(machine: LinearMachine, v_dc: float, speed: float) -> Design:
    """A drive as the campaign in float32 has them: magnitude optimum at 10 kHz."""
    base = make_design(machine)
    bases = PerUnitBases(
        1.5 * machine.i_max,
        v_dc / math.sqrt(3.0),
        speed,
        1.5 * machine.pole_pairs * machine.psi_pm * machine.i_max,
    )
    control = replace(
        base.control,
        t_s=T_S,
        current_loop=CurrentLoopSettings("magnitude-optimum"),
        speed_loop=None,
        observer=None,
        bases=bases,
    )
    return replace(
        base,
        control=control,
        inverter=Inverter(v_dc, 1.0 / T_S),
        losses=None,
        export=replace(base.export, control=("q15",)),
    )


def random_drives(generator: np.random.Generator) -> list[tuple[Drive, Scenario, bytes]]:
    """A machine of any size with its own gains in 16 bits, and four drives of it at any speed
    within the voltage, each off the data by 20 % in another way.
    """
    p = int(generator.integers(1, 8))
    i_max = float(10.0 ** generator.uniform(0.0, 2.7))
    v_dc = float(10.0 ** generator.uniform(1.2, 2.9))
    psi = v_dc / math.sqrt(3.0) / float(generator.uniform(600.0, 3000.0))
    l_d = float(generator.uniform(0.15, 0.8)) * psi / i_max
    l_q = l_d * float(generator.uniform(0.7, 3.0))
    r_s = float(generator.uniform(0.01, 0.1)) * v_dc / i_max
    most = v_dc / math.sqrt(3.0) / psi / p
    machine = LinearMachine(p, r_s, l_d, l_q, psi, i_max, inertia=1.0, omega_m_max=0.45 * most)
    design = designed(machine, v_dc, 0.5 * most)
    gains = solve_gains(design)
    control = fit_control(design, (gains.i_d, gains.i_q, None), None, 16).control
    drive, content = Drive(machine, design.inverter, T_S), integer_gain_bytes(control)
    return [(drive, _anywhere(generator, i_max, most), content) for _ in range(4)]


def _anywhere(generator: np.random.Generator, i_max: float, most: float) -> Scenario:
    speed = float(generator.uniform(-0.4, 0.4)) * most
    wrong = generator.choice([-0.2, 0.0, 0.2], size=4)
    return Scenario(
        duration=0.1,
        mode="current",
        reference=constant(0.4 * i_max * float(generator.uniform(-1.0, 1.0))),
        reference_d=constant(-0.3 * i_max * float(generator.uniform(0.0, 1.0))),
        shaft=constant(speed),
        omega_m=speed,
        errors=PlantErrors(r_s=wrong[0], l_d=wrong[1], l_q=wrong[2], psi_pm=wrong[3]),
    )


@pytest.fixture(scope="module")
def program() -> Iterator[Simulator]:
    machine = LinearMachine(
        3, 0.3, 2e-3, 2e-3, 0.1, 50.0, inertia=0.05, friction=0.01, omega_m_max=300.0
    )
    solution = solve(designed(machine, 500.0, 400.0))
    files = emitted_files(solution, "q15")
    with simulator(files, solution.design.export.prefix, number_format="q15") as compiled:
        yield compiled


def test_gains_given_are_the_gains_of_the_header(program: Simulator) -> None:
    machine = LinearMachine(
        3, 0.3, 2e-3, 2e-3, 0.1, 50.0, inertia=0.05, friction=0.01, omega_m_max=300.0
    )
    design = designed(machine, 500.0, 400.0)
    solution = solve(design)
    (fit,) = solution.fixed
    assert isinstance(fit.control, FixedControl)
    scenario = Scenario(0.02, "current", constant(20.0), constant(-5.0), shaft=constant(100.0))
    own, given = (
        simulate(program, drive_of(design), scenario, gains=gains)
        for gains in (b"", integer_gain_bytes(fit.control))
    )
    np.testing.assert_array_equal(own.i_q, given.i_q)
    assert abs(float(own.i_q[-1]) - 20.0) < 0.1


@pytest.mark.slow
def test_two_thousand_drives_off_their_data_settle_in_16_bits(program: Simulator) -> None:
    """One program: 500 machines of 1 to 500 A and 16 to 800 V, four drives of each, each wrong by
    20 % in any direction.
    """
    generator = np.random.default_rng(20261122)
    runs = [drive for _ in range(500) for drive in random_drives(generator)]
    found = simulate_many(program, runs, tail=0.8)
    limit = np.array([drive.machine.i_max for drive, _, _ in runs])
    assert np.all(found.bounded)
    # dead bands and codes of current: 1.5 times the limit over 2^15
    assert float(np.max(found.tail_error / limit)) < 0.01
    assert float(np.max(found.peak_current / limit)) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", ["flux", "extended-emf", "ekf", "open-loop-flux", "matsui-voltage", "matsui-current"]
)
def test_control_without_encoder_in_integers(method: ObserverMethodName, ipm: Design) -> None:
    """Control on the angle of every position observer, speed steps and a load step."""
    speeds = Profile((0.0, 0.05, 0.3), (800.0 * RPM, 1200.0 * RPM, 900.0 * RPM))
    scenario = Scenario(
        0.5,
        "speed",
        speeds,
        omega_m=800.0 * RPM,
        load=Profile((0.0, 0.2), (0.0, 5.0)),
        sensorless=Sensorless(300.0 * RPM, 200.0 * RPM),
    )
    control = replace(ipm.control, observer=ObserverSettings(method=method))
    design = replace(ipm, control=control, simulation=scenario, weakening=None)
    found = simulate_design(design)
    assert found.formats == ALL
    fine = found.observed
    assert fine is not None
    assert fine.angle_rms is not None
    for run in found.others:
        coarse = run.observed
        assert coarse is not None
        assert coarse.angle_rms == pytest.approx(fine.angle_rms, rel=0.1)
        assert coarse.sensorless_share == 1.0
        assert run.tracking[1] == pytest.approx(found.tracking[1], rel=0.12)


def test_a_speed_beyond_full_scale_is_refused() -> None:
    base = catalogue.load("paper001-pmsm-bench")
    design = replace(
        base,
        losses=None,
        export=replace(base.export, control=("q15",)),
        simulation=Scenario(0.01, "speed", constant(1.1 * base.control.bases.speed)),
    )
    with pytest.raises(InputError, match=r"beyond full scale.*write control.per_unit.speed: \d+"):
        simulate_design(design)
