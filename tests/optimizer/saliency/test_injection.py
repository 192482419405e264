"""Injection as a tracker: static errors at rest, noise, poles, saturation, refusals."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from locked_rotor import Rest, random_drive, track_at_rest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import InjectionWave
from dqforge.optimizer.estimators import TrackerEstimator, tune_tracker
from dqforge.optimizer.saliency.injection import (
    NOISE_ANGLE,
    TRACKER,
    InjectionGains,
    LoadedSaliency,
    along_locus,
    angle_noise,
    current_noise,
    largest_pole,
    notch,
    pll_gains,
    require_saliency,
    usual_loop,
    usual_voltage,
    wave_start,
    wave_step,
    wave_tracking,
)
from dqforge.optimizer.saliency.load_tables import POINTS
from dqforge.optimizer.saliency.sampled_injection import cross_saturation_error
from dqforge.optimizer.steps.step_arithmetic import EXACT

WAVES: tuple[InjectionWave, ...] = ("square", "sine", "rotating")
ABB, BALDOR = "abb-ipmsm-2k2", "baldor-pmsyrm-5k6"
NONE = np.zeros(1, dtype=np.complex128)


def drive(name: str) -> Design:
    design = catalogue.load(name)
    return replace(design, export=replace(design.export, control=("float32",)))


def gains_of(design: Design, wave: InjectionWave = "square", **settings: float) -> InjectionGains:
    wanted = ObserverSettings(method="injection", wave=wave, **settings)  # type: ignore[arg-type]
    found = tune_tracker(design, wanted).gains
    assert isinstance(found, InjectionGains)
    return found


def _static(wave: InjectionWave, rest: Rest, drives: int, least: float = 1.1) -> FloatArray:
    """Mean angle errors in deg of the second half of a second at rest, of every drive and angle."""
    generator, found = np.random.default_rng(17), []
    for _ in range(drives):
        design = random_drive(generator, least)
        try:
            gains = gains_of(replace(design, export=drive(ABB).export), wave)
        except NoSolutionError:
            continue
        share = 1.0 if design.inverter.v_dc > 100.0 else 1.0 / 6.0
        own = replace(rest, dead_time=share * rest.dead_time)
        errors = track_at_rest(TRACKER, gains, design, own, generator)
        found.append(np.abs(np.mean(errors[750:], axis=0)))
    assert len(found) > drives // 2
    return np.asarray(np.degrees(np.concatenate(found)), dtype=np.float64)


@pytest.mark.parametrize("wave", WAVES)
def test_the_angle_is_found_at_rest(wave: InjectionWave) -> None:
    found = _static(wave, Rest(), 1, 1.3)
    assert np.median(found) < 0.9
    assert np.percentile(found, 95) < 2.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wave", "load", "median", "high"),
    [
        ("square", 0.0, 0.9, 3.7),
        ("square", 0.3, 1.1, 3.7),
        ("sine", 0.0, 0.5, 8.7),
        ("sine", 0.3, 0.5, 5.0),
        ("rotating", 0.0, 5.4, 23.0),
        ("rotating", 0.3, 1.8, 17.0),
    ],
)
def test_what_the_dead_time_costs_at_rest(
    wave: InjectionWave, load: float, median: float, high: float
) -> None:
    """Half of 3 us left, of 0.5 us at 24 and 48 V."""
    found = _static(wave, Rest(load=load, dead_time=1.5e-6), 16)
    assert np.median(found) < median
    assert np.percentile(found, 95) < high


@pytest.mark.thinned
@pytest.mark.parametrize("wave", WAVES)
def test_noise_of_the_angle_is_the_formula(wave: InjectionWave) -> None:
    design = drive(ABB)
    gains = gains_of(design, wave)
    generator = np.random.default_rng(3)
    rest = Rest(noise=current_noise(design) / design.i_max, away=0.0)
    errors = track_at_rest(TRACKER, gains, design, rest, generator, (1600, 60))
    expected = angle_noise(gains, current_noise(design))
    assert np.std(errors[400:]) == pytest.approx(expected, rel=0.1)
    assert expected <= NOISE_ANGLE


def test_the_usual_voltage_is_raised_where_noise_would_hide_the_angle() -> None:
    design = drive(ABB)
    gains = gains_of(design)
    assert gains.carrier[0] == pytest.approx(0.28 * 540.0)
    assert usual_voltage(design) == pytest.approx(54.0)
    with pytest.raises(NoSolutionError, match=r"wander by 10\.\d deg .* write voltage: 1\d\d V"):
        gains_of(design, voltage=54.0)


@pytest.mark.parametrize("wave", WAVES)
def test_errors_decay_with_the_slowest_pole(wave: InjectionWave) -> None:
    gains = gains_of(drive(ABB), wave)
    loop = wave_tracking(gains)
    estimator = TrackerEstimator(loop)
    columns, _ = estimator.start(NONE, NONE, np.zeros(1))
    columns[:, :-1] += 0.01
    sizes = []
    for _ in range(1200):
        columns, delta, _ = estimator.step(columns, NONE, NONE)
        sizes.append(abs(float(delta[0])))
    assert sizes[-1] < 1e-4 * sizes[0]
    errors = track_at_rest(
        TRACKER, gains, drive(ABB), Rest(noise=0.0, away=0.01), np.random.default_rng(1), (900, 1)
    )[:, 0]
    assert abs(errors[-1]) < 0.02 * abs(errors[0])
    assert largest_pole(gains) < 1.0


@pytest.mark.parametrize("wave", WAVES)
def test_the_loop_of_the_judgement_stands_still_at_a_speed(wave: InjectionWave) -> None:
    gains, omega = gains_of(drive(ABB), wave), np.array([50.0])
    estimator = TrackerEstimator(wave_tracking(gains))
    columns, _ = estimator.start(omega * 0j, omega * 0j, omega)
    for _ in range(20):
        after, delta, speed = estimator.step(columns, omega * 0j, omega * 0j)
        assert float(delta[0]) == pytest.approx(0.0, abs=1e-12)
        assert float(speed[0]) == pytest.approx(50.0)
        columns = estimator.turned(after, omega * gains.t_s)


@pytest.mark.parametrize(("wave", "samples"), [("square", 2), ("sine", 10), ("rotating", 8)])
def test_the_controllers_do_not_see_the_injected_frequency(
    wave: InjectionWave, samples: int
) -> None:
    b_0, b_1, b_2, a_1, a_2 = notch(wave, samples)

    def response(z: complex) -> complex:
        return (b_0 + b_1 / z + b_2 / z**2) / (1.0 + a_1 / z + a_2 / z**2)

    assert abs(response(np.exp(2j * np.pi / samples))) < 1e-12
    assert response(1.0) == pytest.approx(1.0)
    lag = np.degrees(np.angle(response(np.exp(1j / 3.0))))
    assert abs(lag) < (1.0 if wave == "square" else 16.0)


@pytest.mark.parametrize("wave", WAVES)
def test_one_bad_sample_poisons_nothing(wave: InjectionWave) -> None:
    gains = gains_of(drive(ABB), wave)
    state = wave_start(gains, np.zeros(3), np.zeros(3))
    bad = np.array([np.nan, np.inf, 0.1])
    for k in range(40):
        i = bad if k == 15 else np.array([0.1, 0.1, 0.1])
        v = bad if k == 25 else np.zeros(3)
        state = wave_step(gains, state, (v, v), (i, i), (), EXACT)
        for part in (state.theta_e, state.omega_e, *state.added, *state.current):
            assert np.all(np.isfinite(part))
    # what is a number in its place goes on as if nothing had been
    assert abs(state.theta_e[0] - state.theta_e[2]) < 0.05


def test_cross_saturation_is_taken_off_along_the_currents_of_the_design() -> None:
    """Against the error that the flux map makes of an uncorrected tracker."""
    design = drive(BALDOR)
    loaded, gains = along_locus(design, POINTS), gains_of(design)
    expected = cross_saturation_error(design.machine, loaded.i_d, loaded.i_q)
    np.testing.assert_allclose(-loaded.axis, -expected, atol=1e-9)
    assert np.degrees(np.max(np.abs(loaded.axis))) > 4.0
    np.testing.assert_allclose(gains.shift, 0.5 * np.tan(2.0 * loaded.axis), atol=1e-12)
    assert gains.scale[-1] < gains.scale[0]
    assert loaded.ratio[0] > 4.9
    assert 2.0 < loaded.ratio[-1] < 2.2


def test_a_machine_without_saliency_is_refused_with_the_number() -> None:
    design = drive(ABB)
    machine = linearised(design.machine)
    round_ = replace(design, machine=replace(machine, l_q=machine.l_d))
    with pytest.raises(
        NoSolutionError, match=r"differ by 1\.1 or more, those .* by 1 without load"
    ):
        gains_of(round_)
    little = replace(design, machine=replace(machine, l_q=1.08 * machine.l_d))
    with pytest.raises(NoSolutionError, match=r"by 1\.08 without load"):
        gains_of(little)


def test_saliency_that_dies_under_load_is_refused_with_the_load() -> None:
    load = np.linspace(0.0, 8.0, 3)
    found = LoadedSaliency(
        -load, load, 2.0 * load, np.ones(3), np.array([0.3, 0.1, 0.02]), np.zeros(3)
    )
    with pytest.raises(NoSolutionError, match=r"at 16 N m \(i_d = -8 A, i_q = 8 A\).* by 1\.04"):
        require_saliency(found, "injection")
    turned = replace(found, y_delta=np.array([0.3, 0.2, 0.2]), axis=np.array([0.0, 0.9, 0.9]))
    with pytest.raises(NoSolutionError, match=r"at 8 N m .* 51\.6 deg beside d"):
        require_saliency(turned, "injection")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"voltage": 200.0}, "write at most 155.9 V"),
        ({"wave": "sine", "samples": 5}, "sine takes 6, 8"),
        ({"samples": 4}, "a square wave changes its sign every sample"),
        ({"pll_bandwidth": 1e4}, "write at most 4000 rad/s"),
    ],
)
def test_settings_out_of_range(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        tune_tracker(drive(ABB), ObserverSettings(method="injection", **settings))  # type: ignore[arg-type]


def test_a_loop_that_is_too_fast_for_its_delay_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="largest pole is 1"):
        gains_of(drive(BALDOR), pll_bandwidth=3500.0)


def test_control_in_integers_is_refused() -> None:
    design = catalogue.load(ABB)
    fixed = replace(design, export=replace(design.export, control=("q15",)))
    with pytest.raises(InputError, match="q15 has no injection in integers; write float32"):
        tune_tracker(fixed, ObserverSettings(method="injection"))


@pytest.mark.parametrize("wave", WAVES)
@pytest.mark.parametrize("v_dc", [540.0, 450.0])
def test_injection_serves_up_to_ten_periods_per_turn_or_the_room_of_the_voltage(
    wave: InjectionWave, v_dc: float
) -> None:
    design = drive(ABB)
    design = replace(design, inverter=replace(design.inverter, v_dc=v_dc))
    machine, gains = linearised(design.machine), gains_of(design, wave)
    samples = 4 if wave == "square" else len(gains.carrier)
    i_q = along_locus(design, POINTS).i_q[-1]
    flux = float(np.abs(machine.psi_pm + 1j * machine.l_q * i_q))
    left = v_dc / np.sqrt(3.0) - max(gains.carrier) - machine.r_s * i_q
    turn = 2.0 * np.pi / (10.0 * samples * gains.t_s)
    for limit in (1e9, 5.0):
        low, high = TRACKER.speeds(design, replace(gains, omega_max=limit))
        assert low == 0.0
        assert high == pytest.approx(min(turn, left / flux, limit), rel=1e-3)
    crowded = replace(design, inverter=replace(design.inverter, v_dc=0.6 * v_dc))
    left -= 0.4 * v_dc / np.sqrt(3.0)
    assert TRACKER.speeds(crowded, gains)[1] == pytest.approx(min(turn, left / flux), rel=1e-3)


@pytest.mark.parametrize(("bandwidth", "damping"), [(200.0, 0.7), (251.0, 1.0), (90.0, 1.6)])
def test_the_loop_has_the_poles_of_its_bandwidth(bandwidth: float, damping: float) -> None:
    t_s = 125e-6
    k_p, k_i = pll_gains(bandwidth, damping, t_s)
    # the angle and the speed that are left after a correction by the predicted angle
    left = np.linalg.eigvals([[1.0 - k_p, (1.0 - k_p) * t_s], [-k_i, 1.0 - k_i * t_s]])
    root = bandwidth * np.emath.sqrt(damping**2 - 1.0)
    wanted = np.exp((np.array([root, -root]) - damping * bandwidth) * t_s)
    np.testing.assert_allclose(np.sort_complex(left), np.sort_complex(wanted), atol=1e-7)


@pytest.mark.parametrize("wave", WAVES)
def test_what_is_told_and_emitted_of_a_wave(wave: InjectionWave) -> None:
    gains, t_s = gains_of(drive(ABB), wave), drive(ABB).control.t_s
    samples = 2 if wave == "square" else 10
    kind, voltage, hertz, loop = re.fullmatch(
        r"(\w+) wave of (\S+) V at (\S+) Hz; loop (\S+) rad/s", TRACKER.in_words(gains)
    ).groups()  # type: ignore[union-attr]
    assert kind == wave
    assert float(voltage) == pytest.approx(max(gains.carrier), rel=1e-3)
    assert float(hertz) == pytest.approx(1.0 / (samples * t_s), rel=1e-3)
    assert float(loop) == pytest.approx(usual_loop(t_s), rel=0.05)
    assert TRACKER.steps is not None
    found = TRACKER.steps(gains)
    assert {name: value for name, value, _ in found.counts} == {
        "INJECTION_SAMPLES": samples, "INJECTION_POINTS": POINTS,
    }  # fmt: skip
    assert (found.state.theta_e, found.state.n, found.state.started) == (0.0, 0, 0)
    assert (found.state.products is None) == (wave == "square")
