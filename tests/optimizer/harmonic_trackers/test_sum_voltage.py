"""The third harmonic as a tracker of a design: usual tuning, refusals with the number, nan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.estimators import tune_tracker
from dqforge.optimizer.harmonic_trackers import (
    TRACKER,
    current_angle,
    design_third_harmonic,
    third_flux,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT

WIRED = ("inverter.topology=three-wire", "control.observer={method: third-harmonic}")
SETTINGS = ObserverSettings(method="third-harmonic")


def waves(*settings: str, name: str = "paper002-phase-waveforms") -> Design:
    return catalogue.load(name, [*WIRED, *settings])


def test_the_usual_range_begins_at_a_fifth_of_the_largest_speed() -> None:
    design = waves()
    found = tune_tracker(design, SETTINGS)
    largest = 2.0 * 1800.0 * math.pi / 30.0
    assert found.omega_low == pytest.approx(0.2 * largest, rel=0.02)
    assert found.omega_high >= largest
    assert found.tracker.hears == ("sum-voltage",)
    # 12 % of 0.2233 Wb in each of three phases, over three as an integral of 3 omega t
    assert found.gains.amplitude == pytest.approx(3.0 * 0.12 * 0.2233 / 3.0, rel=1e-6)


def test_poles_of_the_design_file_are_taken() -> None:
    settings = ObserverSettings(method="third-harmonic", pll_bandwidth=40.0, bandwidth=10.0)
    gains = design_third_harmonic(waves(), settings)
    assert gains.k_p == pytest.approx(1.0 - math.exp(-2.0 * 40.0 * 1e-4), rel=1e-9)
    assert gains.k == pytest.approx(1.0 - math.exp(-2.0 * 10.0 * 1e-4), rel=1e-9)


@pytest.mark.parametrize(
    ("name", "settings", "kind", "message"),
    [
        ("abb-ipmsm-2k2", (), NoSolutionError, "machine.model: waveform"),
        (
            "paper002-phase-waveforms",
            ("machine.back_emf.harmonics[1].share=0.1 %",),
            NoSolutionError,
            r"is 0\.10 % of the fundamental",
        ),
        (
            "paper002-phase-waveforms",
            ("inverter.topology=four-leg",),
            InputError,
            "four-leg lets the phase currents add up",
        ),
        (
            "paper002-phase-waveforms",
            ("machine.max_speed=30000 rpm",),
            NoSolutionError,
            "fewer than six samples",
        ),
    ],
)
def test_what_physics_forbids_is_refused(
    name: str, settings: tuple[str, ...], kind: type[Exception], message: str
) -> None:
    given = {setting.partition("=")[0] for setting in settings}
    wired = [key for key in WIRED if key.partition("=")[0] not in given]
    made = [*wired, *settings] if name.startswith("paper") else [WIRED[1]]
    with pytest.raises(kind, match=message):
        tune_tracker(catalogue.load(name, made), SETTINGS)


def test_a_second_harmonic_of_the_inductance_leaves_the_sum_alone() -> None:
    plain = waves().phase_machine
    assert isinstance(plain, PhaseMachine)
    machine = SalientPhaseMachine.with_second_harmonic(plain, -1e-3)
    assert current_angle(machine, third_flux(plain)[0], 10.0) < 1e-9


def test_other_harmonics_of_the_inductance_turn_the_angle() -> None:
    machine = waves(name="salient-phase-waveforms").phase_machine
    assert isinstance(machine, SalientPhaseMachine)
    # L_aa alone varies: the sum shows sum_k cos(2 theta - 240 deg k) i_k l, at most 3/2 l i.
    varied = SalientPhaseMachine.from_harmonics(machine.phases, 2.0, 1e-3, 0.0)
    angle = current_angle(varied, 0.02, 10.0)
    assert angle == pytest.approx(1.5 * 1e-3 * 10.0 / (3.0 * 0.02), rel=0.01)


def test_a_speed_loop_faster_than_the_tracker_is_refused() -> None:
    loop = "control.speed_loop={method: bandwidth, bandwidth: 200 rad/s}"
    fast = waves(loop)
    with pytest.raises(NoSolutionError, match=r"the third harmonic of the back-EMF .* is unstable"):
        require_observed(fast, solve_gains(fast))
    slow = solve_gains(waves("control.speed_loop={method: bandwidth, bandwidth: 12 rad/s}"))
    assert slow.tracker is not None
    assert slow.position is None
    require_observed(waves(), slow)


def test_a_speed_loop_on_it_is_judged_where_it_tracks_and_at_its_corners() -> None:
    design = waves("control.speed_loop={method: bandwidth, bandwidth: 12 rad/s}")
    speed, low = solve_gains(design).speed, tune_tracker(design, SETTINGS).omega_low
    assert speed is not None
    assert speed.observed is not None
    assert np.all(speed.observed.omega >= low * (1.0 - 1e-9))
    # the loop at 56.5 rad/s is late by 2/56.5 s: 2 atan(11.7/56.5) of the 72.9 deg on an encoder
    assert np.degrees(speed.observed.phase_margin) == pytest.approx(49.5, abs=0.5)
    corners = speed.observed.corners
    assert corners is not None
    assert set(corners.limits) == {"r_s", "psi_pm"}  # of the usual box, in what the loop knows
    assert corners.exact.low == pytest.approx(low)
    assert corners.exact.below is None
    assert corners.braking is not None
    assert corners.dead_time is None


def test_samples_that_are_no_number_are_foretold() -> None:
    gains = design_third_harmonic(waves(), SETTINGS)
    state = TRACKER.start(gains, np.array([0.3]), np.array([200.0]))
    zero = (np.zeros(1), np.zeros(1))
    for bad in (0.0, np.nan, np.inf, -np.inf, np.nan):
        state = TRACKER.step(gains, state, zero, zero, (np.array([bad]),), EXACT)
    assert state.omega_e[0] == pytest.approx(200.0)
    assert state.theta_e[0] == pytest.approx(0.3 + 4.0 * 200.0 * 1e-4, abs=1e-9)
