"""What legs, neutral and midpoint of simulated phase machines do: dead time, energy, leakage of the
pulses, phases that open; and the figures of a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from simulated_phases import (
    L_N,
    L_S,
    M_S,
    T_S,
    TOPOLOGY_NAMES,
    V_DC,
    P,
    R,
    assert_close,
    drive,
    duties,
    phases,
    profiles,
)

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.modulation.ripple import flux_moments
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.plants.scenario import (
    InverterModel,
    PhaseOpening,
    PlantErrors,
    Profile,
    Scenario,
    constant,
)
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.reports.simulation.plant_input import Drive, emf_table
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulator


@pytest.fixture(scope="module")
def plant() -> Iterator[Simulator]:
    with simulator() as compiled:
        yield compiled


def resting(duty: FloatArray, dead_time: float, inverter: InverterModel) -> Scenario:
    return Scenario(
        0.06,
        "open-loop",
        Profile(),
        duties=tuple(constant(float(value)) for value in duty),
        shaft=constant(0.0),
        inverter=inverter,
        dead_time=dead_time,
    )


@pytest.mark.thinned
@pytest.mark.parametrize("topology", [name for name in TOPOLOGIES if name != "diode-neutral"])
def test_averaged_dead_time_of_every_leg_is_that_of_switching(
    plant: Simulator, topology: Topology
) -> None:
    """From within the ripple, where a leg loses nothing, to currents far above it, where it loses
    2 us of 200 V: the leg of the neutral and second legs, too.
    """
    generator = np.random.default_rng(5)
    machine = PhaseMachine.from_harmonics(
        [1.0], [1e-9], [0.0], pole_pairs=P, r_s=1.0, l_s=L_S, m_s=M_S, i_max=30.0
    )
    wired = drive(topology, machine, choke=0.0)
    stiff = replace(wired, inverter=replace(wired.inverter, midpoint_capacitance=None))
    largest = 0.0
    for size in (0.01, 0.05, 0.15):
        duty = 0.5 + size * generator.uniform(-1.0, 1.0, len(TOPOLOGIES[topology].legs))
        lost = {}
        both: tuple[InverterModel, ...] = ("averaged", "switched")
        for inverter in both:
            ideal, dead = (
                simulate(plant, stiff, resting(duty, time, inverter)).phases for time in (0.0, 2e-6)
            )
            assert ideal is not None
            assert dead is not None
            lost[inverter] = np.mean((ideal.i_phases - dead.i_phases)[-100:], axis=0)  # R = 1 Ohm
        np.testing.assert_allclose(lost["averaged"], lost["switched"], atol=0.16)
        largest = max(largest, float(np.max(np.abs(lost["switched"]))))
    assert largest > 3.0


def random_phases(generator: np.random.Generator) -> AnyPhaseMachine:
    """Unequal phases with even harmonics, half of them salient."""
    orders = np.array([1.0, 2.0, 3.0, 5.0, 7.0])
    size = 0.2 * np.array([1.0, 0.05, 0.2, 0.1, 0.05]) * generator.uniform(0.8, 1.2, (3, 5))
    lag = generator.uniform(-0.5, 0.5, (3, 5)) + 2.0 * np.pi / 3.0 * np.outer(np.arange(3), orders)
    l_s = float(10.0 ** generator.uniform(-3.0, -1.7))
    machine = PhaseMachine.from_harmonics(
        orders,
        size,
        lag,
        pole_pairs=P,
        r_s=float(generator.uniform(0.2, 1.0)),
        l_s=l_s,
        m_s=-float(generator.uniform(0.0, 0.4)) * l_s,
        i_max=30.0,
    )
    salient = bool(generator.random() < 0.5)
    return SalientPhaseMachine.with_second_harmonic(machine, -0.2 * l_s) if salient else machine


@pytest.mark.parametrize("inverter", ["averaged", "switched"])
@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_energy_is_kept_in_choke_and_midpoint_too(
    plant: Simulator, topology: Topology, inverter: InverterModel
) -> None:
    generator, of_midpoint = np.random.default_rng(20261122), 0.0
    for trial in range(5):
        scenario = Scenario(
            0.03,
            "open-loop",
            Profile(),
            duties=profiles(duties(len(TOPOLOGIES[topology].legs), 300)),
            load=constant(0.2),
            v_dc=Profile((0.0,), (V_DC,), amplitude=10.0, frequency=150.0),
            omega_m=50.0,
            inverter=inverter,
            dead_time=1e-6 if inverter == "switched" and trial % 2 else 0.0,
        )
        choke = 1e-3 if trial % 3 else 0.0
        wired = drive(topology, random_phases(generator), choke)
        light = replace(wired, inverter=replace(wired.inverter, midpoint_capacitance=20e-6))
        f = simulate(plant, light, scenario).figures
        scale = float(f.e_copper[0] + abs(f.e_shaft[0]))
        stored = float(f.e_magnetic[0] + f.e_midpoint[0])
        kept = float(f.e_in[0] - f.e_copper[0] - f.e_shaft[0])
        assert kept == pytest.approx(stored, abs=1e-6 * scale)
        assert float(f.e_magnetic[0]) > 1e-5 * scale
        of_midpoint = max(of_midpoint, float(f.e_midpoint[0]) / scale)
        kinetic = 4e-4 * float(f.omega_m[0] ** 2 - 50.0**2)
        rest = float(f.e_shaft[0] - f.e_load[0] - f.e_friction[0])
        assert rest == pytest.approx(kinetic, abs=1e-6 * scale)
    assert (of_midpoint > 1e-5) == (topology == "split-capacitor")


def test_figures_of_the_tail_are_those_of_its_samples(plant: Simulator) -> None:
    scenario = Scenario(
        0.02,
        "open-loop",
        Profile(),
        duties=profiles(duties(3, 200)),
        shaft=constant(60.0),
        sub_steps=40,
    )
    found = simulate(plant, drive("split-capacitor", phases()), scenario, tail=0.5)
    record, f = found.phases, found.figures
    assert record is not None
    late = slice(100, None)
    means = record.torque_mean[late][1:]
    assert float(f.tail_torque[0]) == pytest.approx(float(np.mean(means)), rel=1e-9)
    assert float(f.tail_ripple_means[0]) == pytest.approx(float(np.ptp(means)), rel=1e-9)
    # Between samples the torque may go a little further.
    assert (
        0.0
        <= float(f.tail_ripple[0]) - float(np.ptp(found.torque[late]))
        < 0.02 * float(f.tail_ripple[0])
    )
    trapezoid = np.trapezoid(found.torque, found.t) / 0.02
    assert float(np.mean(record.torque_mean[1:])) == pytest.approx(float(trapezoid), rel=5e-3)
    for phase, name in enumerate("abc"):
        squares = np.trapezoid(record.i_phases[late, phase] ** 2, found.t[late]) / 0.01
        assert float(getattr(f, f"tail_copper_{name}")[0]) == pytest.approx(R * squares, rel=5e-3)
    neutral = math.sqrt(np.trapezoid(record.i_neutral[late] ** 2, found.t[late]) / 0.01)
    assert float(f.tail_neutral_rms[0]) == pytest.approx(neutral, rel=5e-2)
    off = np.max(np.abs(record.v_midpoint - 0.5 * found.v_dc)[late])
    assert float(f.tail_midpoint[0]) == pytest.approx(float(off), rel=1e-12)


@pytest.mark.parametrize("inverter", ["averaged", "switched"])
@pytest.mark.parametrize("topology", TOPOLOGY_NAMES)
def test_an_open_phase_loses_its_current_and_stays_without(
    plant: Simulator, topology: Topology, inverter: InverterModel
) -> None:
    """Its diodes let the current die within the time that the link takes for it; what is left is
    another circuit.
    """
    opening = 1.0e-3 + 0.31 * T_S
    scenario = Scenario(
        3e-3,
        "open-loop",
        Profile(),
        duties=profiles(duties(len(TOPOLOGIES[topology].legs), 30)),
        shaft=constant(60.0),
        inverter=inverter,
        dead_time=1e-6,
        open_phase=PhaseOpening("b", opening),
    )
    wired = drive(topology, phases())
    found = simulate(plant, wired, scenario).phases
    whole = simulate(plant, wired, replace(scenario, open_phase=None)).phases
    assert found is not None
    assert whole is not None
    np.testing.assert_array_equal(found.i_phases[:11], whole.i_phases[:11])
    before = abs(float(whole.i_phases[10, 1]))
    assert before > 0.02
    gone = np.flatnonzero(found.i_phases[11:, 1] == 0.0)
    # Half of the link at least drives it back.
    longest = before * 2.0 * (L_S - M_S + 3.0 * L_N) / (0.5 * V_DC)
    assert gone.size
    assert gone[0] * T_S <= longest + T_S
    np.testing.assert_array_equal(found.i_phases[11 + gone[0] :, 1], 0.0)
    assert float(np.max(np.abs(found.i_phases[-5:, 0]))) > 0.05
    if not TOPOLOGIES[topology].neutral and topology != "diode-neutral":
        np.testing.assert_allclose(found.i_phases[-5:, 0], -found.i_phases[-5:, 2], rtol=1e-12)


def test_pwm_makes_the_neutral_current_of_its_flux_moments(plant: Simulator) -> None:
    """i_n = 3 V T/L_0 sqrt(mean w M w), with the moments of the legs; the voltages are those that
    the currents of 1 N m of the machine need whose zero sequence is to vanish.
    """
    design = catalogue.load("paper002-phase-waveforms")
    machine = design.phase_machine
    assert isinstance(machine, PhaseMachine)
    weights = {
        "four-leg": np.array([1.0, 1.0, 1.0, -3.0]) / 3.0,
        "split-capacitor": np.ones(3) / 3.0,
        "six-leg": np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0]) / 3.0,
    }
    expected = {"four-leg": 0.385, "split-capacitor": 0.622, "six-leg": 0.072}  # at 1800 rpm
    omega_e = 120.0 * math.pi
    duty = needed_duties(machine, omega_e, 1000)
    for topology, weight in weights.items():
        legs = duty[topology]
        scenario = Scenario(
            0.1,
            "open-loop",
            Profile(),
            duties=profiles(legs),
            shaft=constant(0.5 * omega_e),
            inverter="switched",
            dead_time=0.0,
        )
        wired = replace(design.inverter, topology=cast("Topology", topology))
        run = simulate(plant, Drive(design.machine, wired, T_S, phases=machine), scenario, tail=0.5)
        moments = flux_moments(legs)
        square = float(np.mean(np.einsum("j,njk,k->n", weight, moments, weight)))
        formula = 3.0 * 220.0 * T_S / 5e-3 * math.sqrt(square)
        assert formula == pytest.approx(expected[topology], abs=1e-3)
        assert float(run.figures.tail_neutral_rms[0]) == pytest.approx(formula, rel=1e-2)
        assert float(run.figures.tail_torque[0]) == pytest.approx(1.0, rel=2e-3)


def needed_duties(machine: PhaseMachine, omega_e: float, samples: int) -> dict[str, FloatArray]:
    """Duty cycles for the means of the phase voltages over each period, 220 V."""
    fine = 16
    theta = omega_e * T_S * (1.0 + np.arange(samples * fine) / fine + 0.5 / fine)
    spectrum = np.fft.rfft(machine.flux, axis=1)[:, :12] / machine.angles
    spectrum[:, 1:] *= 2.0
    order = np.arange(12)
    turns = np.exp(1j * np.outer(order, theta))
    f, slope = (spectrum @ turns).real, (spectrum * 1j * order @ turns).real
    g, g_slope = f - np.mean(f, axis=0), slope - np.mean(slope, axis=0)
    square = np.sum(g**2, axis=0)
    i = g / (machine.pole_pairs * square)
    i_slope = (g_slope - 2.0 * g * np.sum(g * g_slope, axis=0) / square) / (
        machine.pole_pairs * square
    )
    inductance = machine.l_s - machine.m_s
    fine_v = machine.r_s * i + omega_e * (inductance * i_slope + f)
    v = np.mean(fine_v.reshape(3, samples, fine), axis=2) / 220.0
    ends = np.vstack([v, np.zeros(samples)])
    centred = ends - 0.5 * (np.max(ends, axis=0) + np.min(ends, axis=0))
    return {
        "four-leg": 0.5 + centred.T,
        "split-capacitor": 0.5 + v.T,
        "six-leg": 0.5 + 0.5 * np.concatenate([v, -v]).T,
    }


def test_midpoint_moves_by_the_third_harmonic_of_the_neutral(plant: Simulator) -> None:
    """v_pp = 2 I/(3 omega_e C) for a current of amplitude I and three times the frequency."""
    omega_e, size = 2.0 * math.pi * 20.0, 0.006
    machine = PhaseMachine.from_harmonics(
        [1.0], [1e-9], [0.0], pole_pairs=P, r_s=R, l_s=L_S, m_s=M_S, i_max=30.0
    )
    third = Profile((0.0,), (0.5,), amplitude=size, frequency=60.0)
    scenario = Scenario(
        0.4, "open-loop", Profile(), duties=(third, third, third), shaft=constant(omega_e / P)
    )
    split = drive("split-capacitor", machine, choke=0.0)
    large = replace(split, inverter=replace(split.inverter, midpoint_capacitance=4e-3))
    found = simulate(plant, large, scenario).phases
    assert found is not None
    late = slice(-1000, None)
    current = 0.5 * float(np.ptp(found.i_neutral[late]))
    moved = float(np.ptp(found.v_midpoint[late]))
    assert moved == pytest.approx(2.0 * current / (3.0 * omega_e * 4e-3), rel=0.01)
    assert moved > 0.5


def test_errors_of_the_plant_scale_saliency_and_back_emf(plant: Simulator) -> None:
    scenario = Scenario(
        2e-3,
        "open-loop",
        Profile(),
        duties=profiles(duties(4, 20)),
        shaft=constant(60.0),
        sub_steps=20,
        errors=PlantErrors(l_d=-0.2, psi_pm=0.1),
    )
    machine = phases(salient=True)
    assert isinstance(machine, SalientPhaseMachine)
    other = SalientPhaseMachine(
        replace(machine.phases, flux=1.1 * machine.flux), 0.8 * machine.inductance
    )
    changed = simulate(plant, drive("four-leg", machine), scenario).phases
    same = simulate(plant, drive("four-leg", other), replace(scenario, errors=PlantErrors())).phases
    assert changed is not None
    assert same is not None
    assert_close(changed.i_phases, same.i_phases, 1e-12)


def test_pole_pairs_that_differ_turn_with_the_shaft(plant: Simulator) -> None:
    """Orders of thirds of the electrical angle; the controller is given the angle over all three
    periods.
    """
    orders = np.array([1.0, 1.0 / 3.0, 5.0 / 3.0])
    size, lag = np.array([0.1, 0.01, 0.004]), np.array([0.0, 0.3, -0.2])
    machine = PhaseMachine.from_harmonics(
        orders,
        np.stack([size, 1.1 * size, 0.9 * size]),
        np.stack([lag + 2.0 * np.pi / 3.0 * k for k in range(3)]),
        pole_pairs=P,
        r_s=R,
        l_s=L_S,
        m_s=M_S,
        i_max=30.0,
    )
    assert machine.turns == P
    scenario = Scenario(
        0.12,
        "open-loop",
        Profile(),
        duties=profiles(duties(4, 1200)),
        shaft=constant(60.0),
        theta_e=0.4,
    )
    found = simulate(plant, drive("four-leg", machine), scenario)
    assert found.phases is not None
    theta = 0.4 + P * 60.0 * found.t
    angle = orders[:, np.newaxis] * theta - lag[:, np.newaxis]
    f = [
        -scale * size @ np.sin(angle - 2.0 * np.pi / 3.0 * k)
        for k, scale in enumerate((1.0, 1.1, 0.9))
    ]
    expected = P * np.sum(np.stack(f, axis=1) * found.phases.i_phases, axis=1)
    assert_close(found.torque, expected, 1e-9)
    assert_close(found.theta_e_measured, theta % (6.0 * np.pi), 1e-9)
    f_in = found.figures
    stored = float(f_in.e_in[0] - f_in.e_copper[0] - f_in.e_shaft[0])
    assert stored == pytest.approx(float(f_in.e_magnetic[0]), abs=1e-6 * float(f_in.e_copper[0]))


def test_many_harmonics_are_those_of_their_sum(plant: Simulator) -> None:
    """A trapezoid has orders up to half its angles: the plant reads them from cells."""
    theta = 2.0 * np.pi * np.arange(360) / 360
    lag = 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    corner = np.arcsin(np.sin(theta - lag))
    machine = PhaseMachine(P, R, L_S, M_S, -0.1 * np.clip(corner / (np.pi / 6.0), -1.0, 1.0), 30.0)
    scenario = Scenario(
        8e-3,
        "open-loop",
        Profile(),
        duties=profiles(duties(4, 80)),
        shaft=constant(60.0),
        sub_steps=60,
    )
    few = simulate(plant, drive("four-leg", machine), scenario)
    table = emf_table(machine).reshape(-1, 7)
    assert table[-1, 0] > 150
    turns = np.outer(P * 60.0 * few.t, table[:, 0])
    f = np.cos(turns) @ table[:, 1::2] + np.sin(turns) @ table[:, 2::2]
    assert few.phases is not None
    expected = P * np.sum(f * few.phases.i_phases, axis=1)
    assert_close(few.torque, expected, 1e-10)
