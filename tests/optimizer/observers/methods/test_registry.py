"""Position observers: the sampled equations against matrix exponentials, convergence, closed forms,
noise by trial.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from drives import IPM, SURFACE
from scipy.linalg import expm
from worked_examples import module_of

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import (
    OBSERVER_KEYS,
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    TRACKER_NAMES,
    ObserverMethodName,
)
from dqforge.machines.plants.scenario import DriveMotion, drive_motion, next_flux, plants
from dqforge.optimizer.observers.judgement import judge_at
from dqforge.optimizer.observers.methods.ekf import ekf_gains, first_guess, usual_noise
from dqforge.optimizer.observers.methods.extended_emf import exact_factors, factor_error
from dqforge.optimizer.observers.methods.flux import flux_of_voltage, flux_path
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.methods.registry import METHODS, method_named, registered
from dqforge.optimizer.observers.parts import (
    Disturbances,
    ObserverMethod,
    ObserverTuning,
    closed_form_error,
    observe,
    steady_observer,
)
from dqforge.optimizer.observers.pll import pll_gains
from dqforge.optimizer.observers.tuning import optimise, tune_position_observer
from dqforge.optimizer.steps.step_arithmetic import EXACT

# Of the EMF observers; those by the flux take 20 rad/s at rest, Matsui's models their usual poles.
#
# The filter takes the covariances that the stated noise implies; `test_ekf` has
# the search for better ones.
T_S = 1e-4
OMEGA_MAX = 3000.0
EVERY = pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))
TUNING = ObserverTuning(800.0, 200.0, omega_floor=60.0)
# Least lag in rad that a ramp of 3000 rad/s^2 shows; 0.02 otherwise, and none with Matsui's voltage
# model.
NO_DISTURBANCE = Disturbances(0.0, 0.0, 0.0, 0.0)
LAGS = {"matsui-current": 0.01, "ekf": 4e-5}
WRONG = {
    "r_s": [30.0, 0.0, 30.0],
    "l_d": [0.1, -0.1, 0.0],
    "l_q": [0.0, 0.05, -0.05],
    "psi_pm": [-0.1, 0.05, 0.0],
}


def _tuning(method: ObserverMethod, machine: LinearMachine = IPM) -> ObserverTuning:
    if "matsui" in method.name:
        return method.usual(machine, T_S, OMEGA_MAX)
    return TUNING if method.name in ("extended-emf", "smo") else replace(TUNING, bandwidth=20.0)


@cache
def _gains(method: ObserverMethod, machine: LinearMachine = IPM) -> object:
    if method.name == "ekf":
        noise = usual_noise(machine, 2.0 * OMEGA_MAX * machine.psi_pm, T_S)
        return ekf_gains(first_guess(machine, T_S, noise, OMEGA_MAX))
    return method.design(machine, _tuning(method, machine), T_S, OMEGA_MAX)


@cache
def _motion(name: str, machine: LinearMachine = IPM) -> DriveMotion:
    """The drives that all methods observe, simulated once."""
    if name == "directions":
        omega: FloatArray = np.broadcast_to([600.0, -600.0, 1800.0, -1800.0], (1800, 4))
        current = (
            np.array([-0.15 + 0.3j, -0.15 - 0.3j, 0.3j, -0.3 + 0.06j], dtype=np.complex128)
            * machine.i_max
        )
        return drive_motion(machine, T_S, omega, current, theta_0=np.array([0.0, 1.0, -2.0, 3.0]))
    if name == "wrong":
        omega = np.broadcast_to([400.0, -900.0, 2000.0], (2000, 3))
        return drive_motion(machine, T_S, omega, np.array([-20 + 60j, 50j, -30 - 40j]), WRONG)
    if name == "steady":
        return drive_motion(machine, T_S, np.full((1000, 1), 1200.0), np.array([-10 + 40j]))
    if name == "noise":
        return drive_motion(machine, T_S, np.full((900, 200), 900.0), np.array([30j]))
    return drive_motion(
        machine, T_S, 500.0 + 3000.0 * T_S * np.arange(2000.0)[:, None], np.array([0j])
    )


# --- parts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.5, 1.0, 2.0])
def test_poles_of_the_loop_are_those_of_the_continuous_one(damping: float) -> None:
    gains = pll_gains(300.0, damping, T_S)
    step = np.array(
        [[1.0 - gains.l_1, (1.0 - gains.l_1) * T_S], [-gains.l_2, 1.0 - gains.l_2 * T_S]]
    )
    # characteristic polynomials: a double root (damping 1) would lose half of the digits
    expected = np.poly(np.exp(np.roots([1.0, 2.0 * damping * 300.0, 300.0**2]) * T_S))
    np.testing.assert_allclose(np.poly(step), expected, atol=1e-9)


def test_loop_lags_at_a_constant_acceleration_as_stated() -> None:
    gains = pll_gains(300.0, 1.0, T_S)
    theta, omega, true = 0.0, 0.0, 0.0
    for k in range(4000):
        before = theta + T_S * omega
        true = 0.5 * 2000.0 * ((k + 1) * T_S) ** 2
        theta, omega = before + gains.l_1 * (true - before), omega + gains.l_2 * (true - before)
    assert theta - true == pytest.approx(gains.lag(2000.0), rel=1e-6)
    assert gains.lag(2000.0) == pytest.approx(-2000.0 / 300.0**2, rel=0.1)


@pytest.mark.parametrize("omega", [-2500.0, 0.0, 40.0, 3000.0])
def test_factors_of_the_emf_are_those_of_the_matrix_exponential(omega: float) -> None:
    """Current, EMF and held voltage as one linear system, sampled by scipy."""
    matrix = np.array(
        [
            [-(IPM.r_s + 1j * omega * IPM.saliency) / IPM.l_d, -1.0 / IPM.l_d, 1.0 / IPM.l_d],
            [0.0, 1j * omega, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    step = expm(matrix * T_S)
    now, last, volt = (complex(part) for part in exact_factors(IPM, 0.9, T_S, np.array(omega)))
    assert now == pytest.approx(0.1 * step[1, 1] / step[0, 1], rel=1e-9)
    assert last == pytest.approx(-now * step[0, 0], rel=1e-9)
    assert volt == pytest.approx(-now * step[0, 2], rel=1e-9)


def test_polynomials_of_the_emf_are_as_good_as_floats() -> None:
    method = METHODS["extended-emf"]
    assert factor_error(method.design(IPM, TUNING, T_S, OMEGA_MAX), IPM) < 1e-7
    assert (
        factor_error(method.design(SURFACE, TUNING, T_S, 8000.0), SURFACE) < 1e-4
    )  # omega t_s = 0.8


def test_voltage_model_has_its_stated_order() -> None:
    """Against the machine integrated in 64 sub-steps: error of a period like t_s^5,
    with saliency like t_s^3.
    """
    lossy = replace(SURFACE, r_s=1.0)
    for machine, order in ((lossy, 5), (replace(lossy, l_q=1.5e-3), 3)):
        errors = []
        for t_s in (2e-4, 1e-4):
            plant, i_0, omega = plants(machine), np.array([-2 + 6j]), np.array([1500.0])
            psi, v = plant.flux(i_0), np.array([30 + 60j])
            end = next_flux(plant, psi, v, np.zeros(1), (omega, omega), t_s, 64)
            pairs = [(x.real, x.imag) for x in (psi, v, i_0, plant.current(end, omega * t_s))]
            found = flux_of_voltage(
                EXACT, flux_path(machine, t_s), pairs[0], pairs[1], pairs[2], pairs[3], omega * t_s
            )
            errors.append(abs(complex(found[0][0], found[1][0]) - complex(end[0])))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


# --- the whole observers --------------------------------------------------------------------------


@pytest.mark.thinned
@EVERY
@pytest.mark.parametrize("machine", [IPM, SURFACE], ids=["salient", "surface"])
def test_with_exact_parameters_the_angle_converges(
    method: ObserverMethod, machine: LinearMachine
) -> None:
    """From 30 degrees and a tenth of the speed wrong, both directions, motoring and braking,
    any load.
    """
    motion = _motion("directions", machine)
    omega = motion.omega_e
    found = observe(
        method, _gains(method, machine), motion, motion.theta_e[0] + 0.5, 0.9 * omega[0]
    )
    assert np.max(np.abs(found.angle_error(motion)[-1])) < 1e-3
    np.testing.assert_allclose(found.omega_e[-1], omega[-1], atol=0.05)
    assert np.max(np.abs(found.angle_error(motion)[1])) > 0.1  # it was wrong at first


@pytest.mark.slow
def test_current_model_of_matsui_needs_an_angle_pole_above_its_speed_error() -> None:
    """180 rad/s off, a pole of the speed at 20 rad/s: the angle runs away with 200 rad/s,
    and holds with 1000.
    """
    method, motion = METHODS["matsui-current"], _motion("directions")
    ends = []
    for pole in (200.0, 1000.0):
        gains = method.design(
            IPM, replace(TUNING, bandwidth=20.0, pll_bandwidth=pole), T_S, OMEGA_MAX
        )
        found = observe(method, gains, motion, motion.theta_e[0], 0.9 * motion.omega_e[0])
        ends.append(np.abs(found.angle_error(motion)[-1, 2:]))
    assert np.min(ends[0]) > 1.0
    assert np.max(ends[1]) < 0.05


@pytest.mark.thinned
@EVERY
def test_steady_state_is_where_a_simulation_ends(method: ObserverMethod) -> None:
    """Wrong R, L_d, L_q and psi at once: the fixed point against 0.2 s of the drive."""
    motion = _motion("wrong")
    end, omega = motion.i_d[-1] + 1j * motion.i_q[-1], motion.omega_e[-1]
    found = steady_observer(method, _gains(method), T_S, plants(IPM, WRONG), end, omega)
    seen = observe(method, _gains(method), motion).angle_error(motion)[-1]
    assert found.found.all()
    np.testing.assert_allclose(found.theta_error, seen, atol=2e-5)
    assert np.max(np.abs(seen)) > 0.02


@pytest.mark.parametrize("name", ["extended-emf", "smo", "open-loop-flux"])
@pytest.mark.parametrize("wrong", ["r_s", "l_d", "l_q", "psi_pm"])
def test_error_of_wrong_parameters_is_the_closed_form(name: str, wrong: str) -> None:
    method, omega, current = METHODS[name], np.array([300.0, 1000.0, 2000.0]), -15 + 70j
    true = replace(IPM, **{wrong: getattr(IPM, wrong) * (21.0 if wrong == "r_s" else 1.2)})
    t_s = 1e-5  # sampled finely; at T_S the held voltage adds some 1e-3 rad to errors of 20 %
    gains = method.design(IPM, _tuning(method), t_s, OMEGA_MAX)
    found = steady_observer(method, gains, t_s, plants(true, count=3), np.full(3, current), omega)
    expected = closed_form_error(true, IPM, current, omega)
    np.testing.assert_allclose(found.theta_error, expected, rtol=1e-3, atol=2e-5)
    if wrong in ("r_s", "l_q"):
        assert np.max(np.abs(expected)) > 5e-3


@pytest.mark.slow
@EVERY
def test_poles_are_how_fast_a_small_error_decays(method: ObserverMethod) -> None:
    motion = _motion("steady")
    steady = steady_observer(
        method, _gains(method), T_S, plants(IPM), np.array([-10 + 40j]), np.array([1200.0])
    )
    error = observe(method, _gains(method), motion, 1e-3).angle_error(motion)[:, 0]
    error, poles = error - steady.theta_error[0], steady.poles
    # The second-order recursion that fits some of the samples: the Kalman filter is done in 60, the
    # sliding-mode observer swings once in a thousand.
    fitted = {"ekf": (31, 1), "smo": (300, 20)}.get(method.name)
    if fitted is not None:
        k, apart = fitted[0] + np.arange(30), fitted[1]
        a, b = np.linalg.lstsq(
            np.stack([error[k], error[k - apart]], axis=1), error[k + apart], rcond=None
        )[0]
        found = np.max(np.abs(np.roots([1.0, -a, -b]))) ** (1.0 / apart)
    else:
        windows = np.abs(error).reshape(10, 100).max(axis=1)
        found = np.mean((windows[4:7] / windows[3:6]) ** 0.01)
    assert found == pytest.approx(abs(poles[0, 0]), rel=4e-3)


def test_flux_errors_decay_as_the_continuous_equation_says() -> None:
    """-g/2 +- sqrt(g^2/4 - omega^2) without saliency, with a loop that is fast."""
    t_s, omega, rate = 1e-5, 150.0, 100.0
    method = METHODS["flux"]
    gains = method.design(SURFACE, ObserverTuning(rate, 8000.0, speed_gain=0.0), t_s, 1000.0)
    poles = steady_observer(
        method, gains, t_s, plants(SURFACE), np.array([0j]), np.array([omega])
    ).poles[0]
    slow = np.log(poles[:2]) / t_s
    expected = -0.5 * rate + 1j * np.sqrt(omega**2 - 0.25 * rate**2)
    assert complex(slow[np.argmax(slow.imag)]) == pytest.approx(expected, rel=0.02)


@pytest.mark.thinned
@EVERY
def test_noise_of_the_angle_is_what_a_trial_gives(method: ObserverMethod) -> None:
    omega, noise = np.array([900.0]), (0.5, 2.0)
    found = steady_observer(method, _gains(method), T_S, plants(IPM), np.array([30j]), omega)
    expected = float(found.angle_noise(*noise)[0])
    motion = _motion("noise")
    error = observe(method, _gains(method), motion.measured(*noise, seed=8)).angle_error(motion)[
        600::50
    ]
    assert np.std(error) == pytest.approx(expected, rel=0.08)


@pytest.mark.slow
@EVERY
def test_acceleration_lag_is_where_a_ramp_ends(method: ObserverMethod) -> None:
    motion, disturbances = _motion("ramp", SURFACE), replace(NO_DISTURBANCE, acceleration=3000.0)
    gains = _gains(method, SURFACE)
    seen = float(observe(method, gains, motion).angle_error(motion)[-1, 0])
    judged = float(judge_at(method, gains, T_S, SURFACE, disturbances, motion.omega_e[-1]).lag[0])
    if method.name == "matsui-voltage":  # two integrators behind the angle's own: none is left
        assert abs(seen) < 1e-6
        assert abs(judged) < 1e-9
        return
    assert seen == pytest.approx(judged, rel=0.02)
    assert abs(seen) > LAGS.get(method.name, 0.02)


@pytest.mark.slow
def test_filter_of_the_open_loop_flux_forgets_an_offset() -> None:
    """A current offset stays bounded, where a bare integrator would drift without end."""
    method = METHODS["open-loop-flux"]
    motion = drive_motion(IPM, T_S, np.full((3000, 1), 600.0), np.array([0j]))
    seen = replace(motion, v_alpha=motion.v_alpha + 0.5)
    error = np.abs(observe(method, _gains(method), seen).angle_error(motion)[:, 0])
    assert np.max(error[2500:]) == pytest.approx(np.max(error[1500:2000]), rel=0.01)
    assert (
        0.5 * 3000 * T_S / IPM.psi_pm > 1.0
    )  # what the integrator would have drifted, in flux linkages
    assert np.max(error) < 0.2


# --- tuning and range -----------------------------------------------------------------------------


def _disturbances() -> Disturbances:
    return Disturbances(i_noise=1.0, v_noise=1.0, i_load=100.0, acceleration=2000.0)


@pytest.mark.slow
@EVERY
def test_optimised_tuning_beats_the_usual_one_in_simulation(method: ObserverMethod) -> None:
    """R.m.s. angle error of ramps under noise and wrong parameters, by simulation
    and not by the judgement.
    """
    first = method.usual(IPM, T_S, OMEGA_MAX)
    first = replace(first, bandwidth=5.0 * first.bandwidth, pll_bandwidth=0.3 * first.pll_bandwidth)
    best = optimise(method, first, IPM, T_S, _disturbances(), OMEGA_MAX)
    if (
        method.name == "ekf"
    ):  # tuned by its innovations, which `test_ekf` shows to find the noise from a wrong start
        assert best == first
        return
    assert best != first
    time: FloatArray = np.arange(2000.0)[:, None] * T_S
    signs = {"r_s": 0.3 * np.array([1, -1, 1, -1]), "psi_pm": 0.1 * np.array([1, 1, -1, -1])}
    motion = drive_motion(IPM, T_S, 500.0 + 2000.0 * time, np.array([100j]), signs).measured(
        1.0, 1.0, 5
    )
    spread = []
    for tuning in (first, best):
        error = observe(method, method.design(IPM, tuning, T_S, OMEGA_MAX), motion).angle_error(
            motion
        )
        spread.append(float(np.sqrt(np.mean(error[1000:] ** 2))))
    assert spread[1] < 0.7 * spread[0]


def test_speed_range_is_bounded_by_resistance_and_noise_below_and_sampling_above() -> None:
    wide = tune_position_observer(
        IPM, ObserverSettings(method="extended-emf"), T_S, 500.0, OMEGA_MAX, _disturbances()
    )
    judgement = wide.judgement
    assert 0.0 < judgement.steady_low < 0.2 * OMEGA_MAX
    assert OMEGA_MAX <= judgement.steady_high <= 0.8 / T_S
    noisy = replace(_disturbances(), i_noise=10.0)
    loud = tune_position_observer(
        IPM, ObserverSettings(method="extended-emf"), T_S, 500.0, OMEGA_MAX, noisy
    )
    assert loud.judgement.steady_low > judgement.steady_low
    at_low = np.searchsorted(judgement.omega, judgement.steady_low)
    squares = judgement.noise**2 + sum(part**2 for part in judgement.bias.values())
    assert np.sqrt(squares[at_low]) <= np.radians(10.0)
    assert not np.sqrt(squares[at_low - 1]) <= np.radians(10.0)


def test_given_keys_win_over_the_usual_ones() -> None:
    wanted = ObserverSettings(
        method="flux", bandwidth=33.0, pll_bandwidth=150.0, damping=0.7, speed_gain=0.1
    )
    tuning = tune_position_observer(IPM, wanted, T_S, 500.0, OMEGA_MAX).tuning
    assert (tuning.bandwidth, tuning.pll_bandwidth, tuning.damping, tuning.speed_gain) == (
        33.0,
        150.0,
        0.7,
        0.1,
    )


# --- refusals -------------------------------------------------------------------------------------


def test_refusals_say_what_to_write() -> None:
    with pytest.raises(InputError, match="write one of extended-emf, smo, flux, open-loop-flux"):
        method_named("luenberger")
    with pytest.raises(NoSolutionError, match="write 5000 rad/s or less"):
        pll_gains(6000.0, 1.0, T_S)
    with pytest.raises(InputError, match="must be positive"):
        pll_gains(0.0, 1.0, T_S)
    with pytest.raises(NoSolutionError, match="write 20000 rad/s or less"):
        METHODS["extended-emf"].design(IPM, replace(TUNING, bandwidth=3e4), T_S, OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="of the voltage model"):
        METHODS["flux"].design(IPM, replace(TUNING, speed_gain=4.0), T_S, OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="too little of the flux linkage"):
        METHODS["open-loop-flux"].design(IPM, replace(TUNING, bandwidth=1e5), T_S, OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="sample at 12500 Hz or more"):
        tune_position_observer(IPM, ObserverSettings(method="flux"), T_S, 500.0, 1e4)
    with pytest.raises(InputError, match="needs a magnet flux"):
        tune_position_observer(
            replace(IPM, psi_pm=0.0), ObserverSettings(method="flux"), T_S, 500.0, 1e3
        )
    assert isinstance(_gains(METHODS["flux"]), FluxGains)


@pytest.mark.parametrize(
    ("name", "held", "refused"),
    [
        ("extended-emf", {"bandwidth": 19_990.0}, {"bandwidth": 20_010.0}),
        ("open-loop-flux", {"bandwidth": 1199.0}, {"bandwidth": 1201.0}),
        ("open-loop-flux", {"speed_gain": 19.9}, {"speed_gain": 20.1}),
        # the share of the model: 1 - exp(-800 rad/s 0.1 ms), and the gain times the turn per sample
        ("flux", {"speed_gain": 3.07}, {"speed_gain": 3.08}),
    ],
)
def test_what_is_too_fast_is_refused_from_its_limit_on(
    name: ObserverMethodName, held: dict[str, float], refused: dict[str, float]
) -> None:
    METHODS[name].design(IPM, replace(TUNING, **held), T_S, OMEGA_MAX)
    with pytest.raises(NoSolutionError):
        METHODS[name].design(IPM, replace(TUNING, **refused), T_S, OMEGA_MAX)


def test_every_word_has_its_file_and_its_keys() -> None:
    words = get_args(ObserverMethodName)
    others = (SPEED_OBSERVER, *TRACKER_NAMES, *SIX_STEP_METHODS)
    assert [*METHODS] == [word for word in words if word not in others]
    assert tuple(OBSERVER_KEYS) == words
    for name, method in METHODS.items():
        assert method.name == name
        assert set(method.searched) <= set(OBSERVER_KEYS[name])


def test_scales_are_those_of_the_machine() -> None:
    for method in METHODS.values():
        t_s, psi = method.scale(_gains(method))
        assert t_s == T_S
        assert psi == pytest.approx(IPM.psi_pm, rel=1e-3), method.name


def test_a_registered_method_is_one_of_the_package_and_leaves_no_trace(tmp_path: Path) -> None:
    """The worked example of docs/project/contributing.md: on a drive without faults its error
    dies out.
    """
    with module_of("optimizer/observers/methods/back_emf.py", tmp_path) as file:
        method = file.METHOD
    with registered(method, ("pll_bandwidth", "damping")):
        settings = ObserverSettings(method=method.name, pll_bandwidth=100.0)
        tuned = tune_position_observer(IPM, settings, T_S, 500.0, OMEGA_MAX, NO_DISTURBANCE)
        assert tuned.tuning.pll_bandwidth == 100.0
        assert np.all(tuned.shown.total < 0.02)
        with pytest.raises(ValueError, match="back-emf"), registered(method, ()):
            pass
    assert "back-emf" not in METHODS
    assert "back-emf" not in OBSERVER_KEYS
    with pytest.raises(InputError, match="no position observer"):
        method_named("back-emf")
