"""Sliding-mode observer: its step against the continuous system integrated apart from it, the lag
of its filters in closed form, convergence, and bounds with a machine that is not the known one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, SURFACE
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.scenario import ComplexArray, drive_motion, plants
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.methods.smo import (
    SmoGains,
    design,
    largest_emf,
    mean_emf,
    switched_voltage,
)
from dqforge.optimizer.observers.parts import (
    ObserverState,
    ObserverTuning,
    closed_form_error,
    observe,
    steady_observer,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT

METHOD = METHODS["smo"]
T_S, OMEGA_MAX = 1e-4, 3000.0
TUNING = ObserverTuning(800.0, 200.0, omega_floor=60.0)
MACHINES = pytest.mark.parametrize(
    "machine", [IPM, SURFACE, INVERSE_SALIENT], ids=["salient", "surface", "inverse"]
)


def pair(value: complex) -> tuple[FloatArray, FloatArray]:
    return np.array([value.real]), np.array([value.imag])


def gains_of(machine: LinearMachine) -> SmoGains:
    return design(machine, TUNING, T_S, OMEGA_MAX)


# --- the continuous system ------------------------------------------------------------------------

SPEED, VOLTAGE, TIME = 900.0, 60.0 - 40.0j, 4e-3
OUTSIDE = 2.5  # Boundary layers at which the gap begins.


def integrated(machine: LinearMachine, gains: SmoGains, times: FloatArray) -> ComplexArray:
    """Stator flux, gap and filtered voltage under a constant voltage, rows of ``times``.

    The machine by its flux linkages, the EMF by its definition d(psi_s)/dt less L_d di/dt and the
    terms of the model; the layer and its filter with the rates 4 and 1 times the bandwidth.
    """
    sliding, rate = 4.0 * TUNING.bandwidth, TUNING.bandwidth
    most, layer = gains.switched, gains.switched / (sliding * machine.l_d)

    def current(time: float, psi: complex) -> complex:
        own = psi * np.exp(-1j * SPEED * time) - machine.psi_pm
        turned = complex(own.real / machine.l_d, own.imag / machine.l_q)
        return turned * complex(np.exp(1j * SPEED * time))

    def slope(time: float, y: FloatArray) -> list[float]:
        psi, gap, filtered = (complex(y[2 * n], y[2 * n + 1]) for n in range(3))
        i = current(time, psi)
        psi_rate = VOLTAGE - machine.r_s * i
        turn = complex(np.exp(1j * SPEED * time))
        own = psi_rate / turn - 1j * SPEED * (psi / turn)
        i_rate = 1j * SPEED * i + turn * complex(own.real / machine.l_d, own.imag / machine.l_q)
        cross = 1j * SPEED * (machine.l_q - machine.l_d) * i
        emf = VOLTAGE - machine.r_s * i - cross - machine.l_d * i_rate
        z = most * gap / max(abs(gap), layer)
        gap_rate = (emf - machine.r_s * gap - z) / machine.l_d
        share = 1.0 + machine.r_s / (machine.l_d * sliding)
        filtered_rate = rate * (share * z - filtered)
        rates = (psi_rate, gap_rate, filtered_rate)
        return [part for value in rates for part in (value.real, value.imag)]

    first = [machine.psi_pm, 0.0, OUTSIDE * layer, 0.0, 0.0, 0.0]
    found = solve_ivp(
        slope, (0.0, TIME), first, "DOP853", times, rtol=1e-9, atol=1e-9, max_step=1e-5
    ).y
    own = found[0::2] + 1j * found[1::2]
    own[0] = [current(t, psi) for t, psi in zip(times, own[0], strict=True)]
    return np.asarray(own, dtype=np.complex128)


@MACHINES
def test_the_step_is_its_continuous_system_sampled(machine: LinearMachine) -> None:
    """From 2.5 boundary layers off, through the saturation into the layer: what is left of the gap
    and the filtered voltage come nearer as the sampling does, at known speed.
    """
    lossy = replace(machine, r_s=20.0 * machine.r_s)
    gaps = []
    for t_s in (8e-6, 4e-6, 2e-6):
        gains = design(lossy, TUNING, t_s, OMEGA_MAX)
        gains = replace(gains, pll=replace(gains.pll, l_1=0.0, l_2=0.0))
        times = np.linspace(0.0, TIME, round(TIME / t_s) + 1)
        i, gap, filtered = integrated(lossy, gains, times)
        z = np.array(switched_voltage(EXACT, gains.switched, gains.layer, pair(gap[0])))
        rest = gains.keep * gap[0] - gains.volt * complex(*z[:, 0])
        state = ObserverState(
            (pair(rest), pair(0j), pair(i[0])), np.zeros(1), np.full(1, SPEED), True
        )
        seen = []
        for now in i[1:]:
            state = METHOD.step(gains, state, pair(VOLTAGE), pair(now), EXACT)
            seen.append(complex(state.vectors[1][0][0], state.vectors[1][1][0]))
        gaps.append(np.max(np.abs(np.array(seen) - filtered[1:])) / np.max(np.abs(filtered)))
    assert gaps[2] < 0.01
    assert gaps[0] / gaps[1] == pytest.approx(2.0, rel=0.15)  # first order
    assert gaps[1] / gaps[2] == pytest.approx(2.0, rel=0.15)


@MACHINES
def test_the_emf_of_a_period_is_its_mean(machine: LinearMachine) -> None:
    """Of the integrated machine, by a quadrature; with saliency the EMF moves within the period, of
    which the end correction knows nothing.
    """
    t_s = 1e-4
    gains = design(machine, TUNING, t_s, OMEGA_MAX)
    close = 1e-5 if machine is SURFACE else 2e-3
    fine = np.linspace(0.0, TIME, 40 * 64 + 1)
    i = integrated(machine, gains, fine)[0]
    # L_d (i[k] - i[k-1]) is the integral of all voltages: the EMF by a quadrature of the others
    weights = np.full(65, 2.0)
    weights[1::2], weights[0], weights[-1] = 4.0, 1.0, 1.0
    for k in (0, 11, 29):
        period = i[64 * k : 64 * (k + 1) + 1]
        mean = np.sum(weights * period) / np.sum(weights)
        cross = machine.r_s + 1j * SPEED * machine.saliency
        emf = VOLTAGE - cross * mean - machine.l_d * (period[-1] - period[0]) / t_s
        x = np.full(1, SPEED * t_s)
        found = mean_emf(
            EXACT, gains.volt, gains.drop, gains.saliency * x, x,
            pair(VOLTAGE), pair(period[0]), pair(period[-1]),
        )  # fmt: skip
        expected = gains.volt * emf
        assert complex(found[0][0], found[1][0]) == pytest.approx(expected, rel=close)


# --- lag and convergence --------------------------------------------------------------------------


@pytest.mark.parametrize("bandwidth", [300.0, 800.0, 2400.0])
def test_the_lag_that_is_taken_back_is_that_of_both_filters(bandwidth: float) -> None:
    """Without the correction the angle errs by what the layer and the filter lag, in closed form;
    with it by nothing.
    """
    t_s, omega = 1e-4, np.array([-2500.0, -400.0, 300.0, 1100.0, 2800.0])
    gains = design(SURFACE, replace(TUNING, bandwidth=bandwidth), t_s, OMEGA_MAX)
    plain = replace(gains, lag_r=(1.0, 0.0, 0.0), lag_m=(0.0, 0.0, 0.0))
    at = plants(SURFACE, count=len(omega)), np.full(len(omega), 12.0j), omega
    q = np.exp(-(4.0 * bandwidth + SURFACE.r_s / SURFACE.l_d) * t_s)
    tangent = np.tan(0.5 * omega * t_s)
    rho = np.exp(-bandwidth * t_s)
    # each pole p lags by the argument of 1 - p exp(-j x), the mean of a period by half of one
    lag = np.arctan((1.0 + q) / (1.0 - q) * tangent) - 0.5 * omega * t_s
    lag += np.arctan((1.0 + rho) / (1.0 - rho) * tangent)
    late = steady_observer(METHOD, plain, t_s, *at)
    right = steady_observer(METHOD, gains, t_s, *at)
    assert np.all(right.found)
    assert np.max(np.abs(right.theta_error)) < 5e-5
    held = np.abs(lag) < 1.5  # beyond, half a turn off is nearer
    assert np.count_nonzero(held) >= 2
    np.testing.assert_allclose(late.theta_error[held], -lag[held], atol=5e-5)
    assert np.max(np.abs(lag[held])) > 0.5


@MACHINES
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_it_converges_from_any_angle(machine: LinearMachine, sense: float) -> None:
    """Up to 170 degrees and a tenth of the speed off, motoring and braking."""
    first = np.radians([-170.0, -120.0, -60.0, 60.0, 120.0, 170.0])
    omega = np.broadcast_to(sense * np.repeat([700.0, 2200.0], 6), (1600, 12))
    current = 0.3j * machine.i_max * np.tile([1.0, -1.0], 6)
    motion = drive_motion(machine, T_S, omega, current)
    found = observe(
        METHOD,
        gains_of(machine),
        motion,
        motion.theta_e[0] + np.tile(first, 2),
        0.9 * omega[0],
    )
    assert np.max(np.abs(found.angle_error(motion)[1])) > 2.0
    assert np.max(np.abs(found.angle_error(motion)[-1])) < 2e-3
    np.testing.assert_allclose(found.omega_e[-1], omega[-1], rtol=1e-4)


# --- bounds ---------------------------------------------------------------------------------------


@MACHINES
def test_the_layer_is_well_damped_and_holds_twice_the_flux(machine: LinearMachine) -> None:
    for bandwidth in (50.0, 800.0, 2.0 / T_S):
        gains = design(machine, replace(TUNING, bandwidth=bandwidth), T_S, OMEGA_MAX)
        g = gains.switched * gains.volt / gains.layer
        assert 0.0 < g < 1.0
        assert 0.0 <= gains.keep - g < 1.0  # the pole of the layer: no swinging
        emf = OMEGA_MAX * (machine.psi_pm + abs(machine.l_q - machine.l_d) * machine.i_max)
        assert gains.switched > 2.0 * emf
    with pytest.raises(NoSolutionError, match=r"bandwidth: 30000 rad/s is too fast"):
        design(machine, replace(TUNING, bandwidth=3e4), T_S, OMEGA_MAX)


@MACHINES
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_it_holds_with_twice_the_resistance_and_the_flux(
    machine: LinearMachine, share: float
) -> None:
    """Both at once, or half of both: no vector of the state leaves its bound, and the angle errs by
    the closed form.
    """
    true = replace(machine, r_s=share * machine.r_s, psi_pm=share * machine.psi_pm)
    omega = np.array([400.0, -1200.0, 2900.0])
    current = 0.3j * machine.i_max * np.array([1.0, -1.0, 1.0])
    errors = {name: [share - 1.0] * 3 for name in ("r_s", "psi_pm")}
    motion = drive_motion(machine, T_S, np.broadcast_to(omega, (1500, 3)), current, errors)
    gains = gains_of(machine)
    state, largest = METHOD.start(motion.theta_e[0], motion.omega_e[0]), np.zeros(2)
    for k in range(len(motion.theta_e)):
        v = motion.v_alpha[k], motion.v_beta[k]
        state = METHOD.step(gains, state, v, (motion.i_alpha[k], motion.i_beta[k]), EXACT)
        largest = np.maximum(largest, [np.max(np.hypot(*part)) for part in state.vectors[:2]])
    assert largest[0] <= gains.layer
    assert largest[1] <= 1.2 * share * largest_emf(machine, OMEGA_MAX)
    error = EXACT.wrap(state.theta_e - motion.theta_e[-1])
    at = motion.i_d[-1] + 1j * motion.i_q[-1]
    expected = [
        float(closed_form_error(true, machine, complex(i), np.array([w]))[0])
        for i, w in zip(at, omega, strict=True)
    ]
    np.testing.assert_allclose(error, expected, atol=5e-3)


def test_beyond_the_switched_voltage_the_gap_stays_bounded_and_comes_back() -> None:
    """An EMF of four times the largest one drives the gap out of the layer, no further than its own
    resistance lets it; the switched voltage never exceeds its value, and the angle comes back.
    """
    lossy = replace(IPM, r_s=100.0 * IPM.r_s)
    gains = gains_of(lossy)
    excess = 4.0 * largest_emf(lossy, OMEGA_MAX) - gains.switched
    gap, bound = 0j, excess / lossy.r_s
    sizes = []
    for k in range(3000):
        z = switched_voltage(EXACT, gains.switched, gains.layer, pair(gap))
        assert np.hypot(*z)[0] <= gains.switched * (1.0 + 1e-12)
        emf = (gains.switched + excess if k < 1500 else 0.1 * gains.switched) * np.exp(0.1j * k)
        rest = gains.keep * gap - gains.volt * complex(z[0][0], z[1][0])
        gap = rest + gains.volt * complex(emf)
        sizes.append(abs(gap))
    assert max(sizes[:1500]) > gains.layer
    assert max(sizes) < bound + 2.0 * gains.volt * (gains.switched + excess)
    assert sizes[-1] < 0.2 * gains.layer
