"""The compiled plant against SciPy, closed forms and its own energy.

Sensors against their definition.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from saturated import PM_SYRM
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    InverterModel,
    PlantErrors,
    Profile,
    Scenario,
    constant,
)
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import (
    Simulation,
    Simulator,
    simulate,
    simulate_many,
    simulator,
)

T_S = 1e-4
IPM = LinearMachine(
    pole_pairs=4,
    r_s=0.2,
    l_d=0.8e-3,
    l_q=1.9e-3,
    psi_pm=0.05,
    i_max=60.0,
    inertia=2e-3,
    friction=3e-3,
    omega_m_max=400.0,
)
LINK = Inverter(300.0, 1.0 / T_S)
LOAD = Profile((0.0, 4.32e-3), (1.0, 6.0))
RIPPLE = Profile((0.0,), (300.0,), amplitude=15.0, frequency=300.0)
Slopes = Callable[[float, FloatArray, FloatArray, float], FloatArray]


@pytest.fixture(scope="module")
def plant() -> Iterator[Simulator]:
    with simulator() as compiled:
        yield compiled


def turning(duration: float, amplitude: float = 0.2, frequency: float = 40.0) -> Scenario:
    """Duty cycles of a voltage vector that swings, from speed, under a load
    that steps within a period.
    """
    duty_a = Profile((0.0,), (0.5,), amplitude=amplitude, frequency=frequency)
    duty_b = Profile((0.0,), (0.5,), amplitude=-0.3 * amplitude, frequency=1.7 * frequency)
    return Scenario(
        duration, "open-loop", duty_a, duty_b, load=LOAD, v_dc=RIPPLE, omega_m=60.0, theta_e=0.4
    )


def stator(duty: FloatArray, v_dc: float) -> FloatArray:
    """Phase voltages from the star point of duty cycles, shape (3,)."""
    return np.asarray((duty - np.mean(duty)) * v_dc)


def by_scipy(
    slopes: Slopes, start: FloatArray, scenario: Scenario, samples: int, breaks: tuple[float, ...]
) -> FloatArray:
    """States (samples + 1, n) at the samples.

    The duty cycles of sample k act from sample k + 1 on.
    """
    states, duty = [start], np.full(3, 0.5)
    for k in range(samples):
        inside = [time for time in breaks if k * T_S < time < (k + 1) * T_S]
        edges = [k * T_S, *inside, (k + 1) * T_S]
        state = states[-1]
        for low, high in pairwise(edges):
            load = float(scenario.load.at(np.array(0.5 * (low + high))))
            held = duty

            def right(
                time: float, x: FloatArray, held: FloatArray = held, load: float = load
            ) -> FloatArray:
                v_dc = float((scenario.v_dc or constant(300.0)).at(np.array(time)))
                return slopes(time, x, stator(held, v_dc), load)

            state = solve_ivp(right, (low, high), state, method="DOP853", rtol=1e-11, atol=1e-12).y[
                :, -1
            ]
        states.append(state)
        a, b = (float(p.at(np.array(k * T_S))) for p in (scenario.reference, scenario.reference_d))
        duty = np.array([a, b, 1.5 - a - b])
    return np.stack(states)


def park(v: FloatArray, theta_e: float) -> tuple[float, float]:
    angles = theta_e - np.array([0.0, 2.0, -2.0]) * math.pi / 3.0
    return float(2.0 / 3.0 * np.sum(v * np.cos(angles))), float(
        -2.0 / 3.0 * np.sum(v * np.sin(angles))
    )


def assert_equal(found: FloatArray, expected: FloatArray, relative: float = 1e-6) -> None:
    np.testing.assert_allclose(
        found, expected, rtol=0.0, atol=relative * float(np.max(np.abs(expected)))
    )


def test_linear_machine_equals_scipy(plant: Simulator) -> None:
    scenario, m = turning(0.02), IPM

    def slopes(_: float, x: FloatArray, v: FloatArray, load: float) -> FloatArray:
        i_d, i_q, omega_m, theta_m = x
        v_d, v_q = park(v, 4.0 * theta_m)
        omega_e, psi_d, psi_q = 4.0 * omega_m, m.psi_pm + m.l_d * i_d, m.l_q * i_q
        torque = 6.0 * (psi_d * i_q - psi_q * i_d)
        i_dot = (
            (v_d - m.r_s * i_d + omega_e * psi_q) / m.l_d,
            (v_q - m.r_s * i_q - omega_e * psi_d) / m.l_q,
        )
        return np.array([*i_dot, (torque - m.friction * omega_m - load) / 2e-3, omega_m])

    expected = by_scipy(slopes, np.array([0.0, 0.0, 60.0, 0.1]), scenario, 200, (4.32e-3,))
    found = simulate(plant, Drive(m, LINK, T_S), scenario)
    assert found.t.size == 201
    for name, column in (("i_d", 0), ("i_q", 1), ("omega_m", 2)):
        assert_equal(getattr(found, name), expected[:, column])
    assert float(np.ptp(expected[:, 2])) > 5.0
    theta_e = 4.0 * expected[:, 3]
    assert_equal(np.exp(1j * found.theta_e).real, np.cos(theta_e))


def test_saturated_machine_equals_flux_linkages_integrated_by_scipy(plant: Simulator) -> None:
    """The states of the reference are flux linkages, whose currents Newton's
    method finds in the same map.
    """
    machine = SaturatedMachine(
        2, 0.63, PM_SYRM.flux_map(15.0), 15.0, inertia=0.02, omega_m_max=200.0
    )
    scenario = replace(turning(0.006, 0.4), reference_d=constant(0.52))
    guess = np.zeros(2)

    def currents(psi: FloatArray) -> FloatArray:
        for _ in range(50):
            jet = machine.jet(guess[:1], guess[1:])
            miss = psi - np.array([jet.psi_d[0], jet.psi_q[0]])
            if np.max(np.abs(miss)) < 1e-14:
                break
            guess[:] += np.linalg.solve(
                [[jet.l_dd[0], jet.l_dq[0]], [jet.l_qd[0], jet.l_qq[0]]], miss
            )
        return guess.copy()

    def slopes(_: float, x: FloatArray, v: FloatArray, load: float) -> FloatArray:
        psi_d, psi_q, omega_m, theta_m = x
        i_d, i_q = currents(x[:2])
        v_d, v_q = park(v, 2.0 * theta_m)
        psi_dot = v_d - 0.63 * i_d + 2.0 * omega_m * psi_q, v_q - 0.63 * i_q - 2.0 * omega_m * psi_d
        return np.array([*psi_dot, (3.0 * (psi_d * i_q - psi_q * i_d) - load) / 0.02, omega_m])

    start = np.array([machine.psi_pm, 0.0, 60.0, 0.2])
    expected = by_scipy(slopes, start, scenario, 60, (4.32e-3,))
    found = simulate(plant, Drive(machine, LINK, T_S), scenario)
    i_d, i_q = np.array([currents(row[:2]) for row in expected]).T
    assert float(np.max(np.abs(i_q))) > 4.0
    assert_equal(found.i_d, i_d, 2e-6)
    assert_equal(found.i_q, i_q, 2e-6)
    assert_equal(found.omega_m, expected[:, 2])


ORDERS, SHARES, LAGS = (1.0, 3.0, 5.0, 7.0), (0.05, 0.01, 0.004, 0.002), (0.0, 0.3, -0.2, 0.5)


@pytest.mark.parametrize("wired", [False, True])
def test_phase_machine_equals_phase_equations(plant: Simulator, wired: bool) -> None:
    """Currents of three phases with a 3 x 3 inductance matrix.

    The star point isolated, or at half the DC link.
    """
    phases = PhaseMachine.from_harmonics(
        ORDERS, SHARES, LAGS, pole_pairs=4, r_s=0.2, l_s=1.0e-3, m_s=-0.3e-3, i_max=60.0
    )
    machine = replace(IPM, l_d=1.3e-3, l_q=1.3e-3)
    scenario = turning(0.01)
    inverse = np.linalg.inv(np.full((3, 3), -0.3e-3) + 1.3e-3 * np.eye(3))

    def slopes(_: float, x: FloatArray, v: FloatArray, load: float) -> FloatArray:
        i, omega_m, theta_m = x[:3], x[3], x[4]
        flux = np.zeros(3)
        for order, size, lag in zip(ORDERS, SHARES, LAGS, strict=True):
            shift = np.array([0.0, 1.0, 2.0]) * 2.0 * math.pi / 3.0
            flux -= size * np.sin(order * (4.0 * theta_m - shift) - lag)
        across = v - 0.2 * i - 4.0 * omega_m * flux
        across -= 0.0 if wired else np.mean(across)
        return np.array(
            [*(inverse @ across), (4.0 * flux @ i - 3e-3 * omega_m - load) / 2e-3, omega_m]
        )

    start = np.array([0.0, 0.0, 0.0, 60.0, 0.1])
    expected = by_scipy(slopes, start, scenario, 100, (4.32e-3,))
    link = replace(LINK, topology="split-capacitor") if wired else LINK
    found = simulate(plant, Drive(machine, link, T_S, phases=phases), scenario)
    mean = np.mean(expected[:, :3], axis=1)
    assert_equal(found.i_zero, mean) if wired else np.testing.assert_array_equal(found.i_zero, 0.0)
    i_d, i_q = np.array([park(row[:3], 4.0 * row[4]) for row in expected]).T
    assert_equal(found.i_d, i_d)
    assert_equal(found.i_q, i_q)
    assert_equal(found.omega_m, expected[:, 3])
    assert_equal(found.i_measured, expected[:, :3])


def test_error_falls_with_the_fourth_power_of_the_step(plant: Simulator) -> None:
    drive = Drive(IPM, LINK, T_S)
    exact = simulate(plant, drive, replace(turning(0.01), sub_steps=64))
    errors = [
        float(
            np.max(
                np.abs(simulate(plant, drive, replace(turning(0.01), sub_steps=n)).i_q - exact.i_q)
            )
        )
        for n in (2, 4)
    ]
    assert 14.0 < errors[0] / errors[1] < 18.0


@pytest.mark.parametrize("inverter", ["averaged", "switched"])
def test_energy_is_kept(plant: Simulator, inverter: InverterModel) -> None:
    scenario = replace(turning(0.05), inverter=inverter, dead_time=1e-6)
    found = simulate(plant, Drive(IPM, LINK, T_S), scenario)
    end, figures = found.t.size - 1, found.figures
    magnetic = 0.75 * (IPM.l_d * found.i_d[end] ** 2 + IPM.l_q * found.i_q[end] ** 2)
    kinetic = 1e-3 * (found.omega_m[end] ** 2 - 60.0**2)
    scale = float(figures.e_copper[0])
    assert float(figures.e_in[0] - figures.e_copper[0] - figures.e_shaft[0]) == pytest.approx(
        magnetic, abs=1e-6 * scale
    )
    rest = figures.e_shaft[0] - figures.e_load[0] - figures.e_friction[0]
    assert float(rest) == pytest.approx(kinetic, abs=1e-6 * scale)
    assert scale > 1.0


def test_switched_inverter_tends_to_the_averaged_one(plant: Simulator) -> None:
    """At the samples, where the carrier has its extremes, the ripple vanishes with
    the carrier period squared.
    """
    scenario = turning(0.02)
    averaged = simulate(plant, Drive(IPM, LINK, T_S), scenario)
    errors = []
    for ratio in (4, 16):
        drive = Drive(IPM, replace(LINK, f_sw=ratio / T_S), T_S)
        found = simulate(plant, drive, replace(scenario, inverter="switched"))
        errors.append(float(np.max(np.hypot(found.i_d - averaged.i_d, found.i_q - averaged.i_q))))
    assert errors[1] < errors[0] / 12.0
    assert errors[1] < 1e-3 * float(averaged.figures.peak_current[0])


RL = LinearMachine(pole_pairs=1, r_s=1.0, l_d=10e-3, l_q=10e-3, psi_pm=0.0, i_max=60.0)


def held(duty: tuple[float, float], inverter: InverterModel, dead_time: float) -> Scenario:
    a, b = (constant(value) for value in duty)
    return Scenario(
        0.15,
        "open-loop",
        a,
        b,
        shaft=constant(0.0),
        inverter=inverter,
        dead_time=dead_time,
    )


@pytest.mark.parametrize("inverter", ["averaged", "switched"])
@pytest.mark.parametrize(("f_sw", "pairs"), [(10e3, 1.0), (5e3, 0.5)])
def test_dead_time_costs_its_mean_voltage(
    plant: Simulator, inverter: InverterModel, f_sw: float, pairs: float
) -> None:
    """Each leg loses t_d f V against its current: 4/3 of it along phase a,
    where b and c carry half each back.
    """
    drive = Drive(RL, Inverter(300.0, f_sw), T_S)
    found = simulate(plant, drive, held((0.7, 0.4), inverter, 2e-6))
    lost = 4.0 / 3.0 * 2e-6 * f_sw * 300.0
    assert lost == pytest.approx(8.0 * pairs)
    mean = float(np.mean(found.i_d[-200:]))  # i_d lies along phase a; R = 1 Ohm
    assert mean == pytest.approx(60.0 - lost, abs=0.02 if inverter == "averaged" else 0.3)


def test_little_current_loses_what_its_ripple_leaves(plant: Simulator) -> None:
    """Where the ripple reverses the current between rise and fall of a leg,
    dead time loses nothing: both ways.
    """
    drive = Drive(RL, Inverter(300.0, 10e3), T_S)
    ways = {}
    both: tuple[InverterModel, ...] = ("averaged", "switched")
    for inverter in both:
        ways[inverter] = [
            float(
                np.mean(
                    simulate(plant, drive, held((0.5 + step, 0.5 - step / 2), inverter, 2e-6)).i_d[
                        -200:
                    ]
                )
            )
            for step in (0.005, 0.02, 0.05, 0.1)
        ]
    assert_equal(np.array(ways["averaged"]), np.array(ways["switched"]), 0.02)
    assert ways["switched"][1] < 6.0 - 3.0  # of 6 A without dead time


def test_phase_within_its_ripple_loses_nothing_to_dead_time(plant: Simulator) -> None:
    """60 A flow from b to c.

    Ripple of a, by hand: 300 V/(2 x 10 kHz x 1 mH) (0.5 - (0.5 + 0.5 + 0.3)/3) = 1 A.
    """
    drive = Drive(replace(RL, l_d=1e-3, l_q=1e-3), Inverter(300.0, 10e3), T_S)
    both: tuple[InverterModel, ...] = ("averaged", "switched")
    for inverter in both:
        for step, lost in ((-0.025, -4.0), (-0.001, 0.0), (0.0015, 0.0), (0.025, 4.0)):
            scenario = held((0.5 + step, 0.7 - step / 2), inverter, 2e-6)
            current = float(np.mean(simulate(plant, drive, scenario).i_d[-200:]))
            # Those of b and c cancel along a; the leg of a loses 2 us x 10 kHz x 300 V = 6 V,
            # 2/3 of which are left.
            assert current == pytest.approx(300.0 * step - lost, abs=0.35)


def test_narrow_pulses_and_full_duty_switch_as_they_should(plant: Simulator) -> None:
    """A pulse shorter than the dead time does not come; a leg at full duty cycle never switches,
    and loses nothing.
    """
    drive = Drive(RL, Inverter(300.0, 10e3), T_S)
    full = simulate(plant, drive, held((1.0, 0.25), "switched", 0.0))
    assert float(full.i_d[-1]) == pytest.approx(150.0, rel=1e-6)
    dead = simulate(plant, drive, held((1.0, 0.25), "switched", 2e-6))
    assert float(np.mean(dead.i_d[-200:])) == pytest.approx(150.0 - 2.0 / 3.0 * 6.0, abs=0.3)


def test_encoder_counts_and_their_difference_are_exact(plant: Simulator) -> None:
    scenario = replace(
        held((0.5, 0.5), "averaged", 0.0),
        shaft=Profile((0.0, 0.1), (-30.0, 90.0), "linear"),
        encoder=Encoder(lines=500),
    )
    found = simulate(plant, Drive(replace(RL, pole_pairs=3), LINK, T_S, ratio=7), scenario)
    # The integral of the speed: -30 t + 600 t^2 up to 0.1 s, then 90 rad/s.
    t = found.t
    angle = np.where(t < 0.1, -30.0 * t + 600.0 * t**2, 3.0 + 90.0 * (t - 0.1))
    counts = np.floor(angle / (2.0 * np.pi) * 2000.0)
    near_edge = (
        np.abs(angle / (2.0 * np.pi) * 2000.0 - np.round(angle / (2.0 * np.pi) * 2000.0)) < 1e-6
    )
    step = 2.0 * np.pi / 2000.0
    wrapped = (3.0 * counts * step + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(
        np.exp(1j * found.theta_e_measured)[~near_edge], np.exp(1j * wrapped)[~near_edge], atol=1e-9
    )
    speed = np.diff(counts[::7]) * step / (7.0 * T_S)
    fine = ~near_edge[::7][1:] & ~near_edge[::7][:-1]
    np.testing.assert_allclose(found.omega_m_measured[7::7][fine], speed[fine], atol=1e-9)
    assert np.all(found.omega_m_measured[:7] == -30.0)
    np.testing.assert_array_equal(
        found.omega_m_measured[8::7], found.omega_m_measured[7::7][: found.t[8::7].size]
    )


def test_converters_round_and_saturate(plant: Simulator) -> None:
    sensor = CurrentSensor(
        bits=8, full_scale=20.0, offset=(0.3, 0.0, -0.1), gain_error=(0.02, 0.0, 0.0)
    )
    scenario = replace(turning(0.02), sensor=sensor)
    found = simulate(plant, Drive(IPM, LINK, T_S), scenario)
    exact = simulate(plant, Drive(IPM, LINK, T_S), turning(0.02)).i_measured
    moved = exact * (1.0 + np.array([0.02, 0.0, 0.0])) + np.array([0.3, 0.0, -0.1])
    codes = np.clip(np.floor(moved / 20.0 * 128.0 + 0.5), -128, 127)
    np.testing.assert_array_equal(found.i_measured, codes * 20.0 / 128.0)
    assert np.any(codes == 127)
    np.testing.assert_allclose(np.sum(exact, axis=1), 0.0, atol=1e-12)


def test_noise_is_normal_and_follows_its_seed(plant: Simulator) -> None:
    def measured(seed: int) -> Simulation:
        scenario = replace(
            held((0.5, 0.5), "averaged", 0.0),
            duration=1.0,
            sensor=CurrentSensor(noise=0.2),
            seed=seed,
        )
        return simulate(plant, Drive(RL, LINK, T_S), scenario)

    first, again, other = measured(1), measured(1), measured(2)
    np.testing.assert_array_equal(first.i_measured, again.i_measured)
    noise = first.i_measured.ravel()
    assert noise.size == 30003
    assert float(np.std(noise)) == pytest.approx(0.2, rel=0.02)
    assert abs(float(np.mean(noise))) < 0.2 * 4.0 / math.sqrt(noise.size)
    assert float(np.mean(noise**4)) == pytest.approx(3.0 * 0.2**4, rel=0.1)
    assert abs(float(np.corrcoef(noise[1:], noise[:-1])[0, 1])) < 0.03
    assert abs(float(np.corrcoef(noise, other.i_measured.ravel())[0, 1])) < 0.03


def test_relative_errors_change_the_plant(plant: Simulator) -> None:
    """They act as another machine would."""
    errors = PlantErrors(r_s=0.2, l_d=-0.1, l_q=0.15, psi_pm=-0.05, inertia=0.3, v_dc=0.02)
    other = replace(IPM, r_s=0.24, l_d=0.72e-3, l_q=2.185e-3, psi_pm=0.0475, inertia=2.6e-3)
    changed = simulate(
        plant, Drive(IPM, LINK, T_S), replace(turning(0.02), errors=errors, sub_steps=8)
    )
    link = Profile((0.0,), (306.0,), amplitude=15.3, frequency=300.0)
    same = simulate(plant, Drive(other, LINK, T_S), replace(turning(0.02), v_dc=link, sub_steps=8))
    np.testing.assert_allclose(changed.i_q, same.i_q, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(changed.omega_m, same.omega_m, rtol=1e-12)


def test_saturated_machine_with_constant_inductances_is_a_linear_one(plant: Simulator) -> None:
    from dqforge.machines.dq_machines.flux_map import FluxMap

    i_d, i_q = np.linspace(-100.0, 100.0, 9), np.linspace(-90.0, 90.0, 7)
    grid_d, grid_q = np.meshgrid(i_d, i_q, indexing="ij")
    flux_map = FluxMap(i_d, i_q, IPM.psi_pm + IPM.l_d * grid_d, IPM.l_q * grid_q)
    machine = SaturatedMachine(
        4, 0.2, flux_map, 60.0, inertia=2e-3, friction=3e-3, omega_m_max=400.0
    )
    errors = PlantErrors(l_d=-0.1, l_q=0.15, psi_pm=-0.05)
    scenario = replace(turning(0.02), errors=errors, sub_steps=8)
    as_map = simulate(plant, Drive(machine, LINK, T_S), scenario)
    linear = simulate(plant, Drive(IPM, LINK, T_S), scenario)
    assert_equal(as_map.i_d, linear.i_d, 1e-10)
    assert_equal(as_map.torque, linear.torque, 1e-10)


def test_many_runs_are_single_runs(plant: Simulator) -> None:
    """Figures of a batch equal those of runs alone, whatever ran before;
    a run that breaks ends alone.
    """
    saturated = SaturatedMachine(
        2, 0.63, PM_SYRM.flux_map(15.0), 15.0, inertia=0.02, omega_m_max=200.0
    )
    wild = Drive(replace(IPM, i_max=0.05), LINK, T_S)
    drives = [
        Drive(IPM, LINK, T_S),
        Drive(saturated, LINK, T_S),
        wild,
        Drive(saturated, LINK, T_S),
        Drive(IPM, LINK, T_S),
    ]
    batch = simulate_many(plant, [(drive, turning(0.01), b"") for drive in drives])
    np.testing.assert_array_equal(batch.bounded, [True, True, False, True, True])
    assert float(batch.t[2]) < 0.01
    for k in (0, 1, 3, 4):
        alone = simulate(plant, drives[k], turning(0.01))
        assert (
            float(batch.omega_m[k]) == float(alone.figures.omega_m[0]) == float(alone.omega_m[-1])
        )
        assert float(batch.peak_current[k]) >= float(np.max(np.hypot(alone.i_d, alone.i_q)))
        late = alone.t >= 0.009
        current = np.hypot(alone.i_d, alone.i_q)[late]
        assert float(batch.tail_current[k]) == pytest.approx(float(np.max(current)), rel=1e-12)
