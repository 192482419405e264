"""Trackers in the comparison: trials of their step against closed forms and against what physics
says without a run.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.estimator_comparison.candidate import HALF_TURN, LOCKED, EstimatorFigures
from dqforge.optimizer.estimator_comparison.compared import (
    SteadyDrives,
    estimators,
    tracked,
    tracker_candidates,
)
from dqforge.optimizer.estimator_comparison.solve import ask, compare_estimators
from dqforge.optimizer.estimators import tune_tracker
from dqforge.optimizer.harmonic_trackers import ThirdHarmonic
from dqforge.optimizer.harmonic_trackers import angle_noise as harmonic_noise
from dqforge.optimizer.saliency.injection import along_locus, angle_noise
from dqforge.optimizer.saliency.load_tables import POINTS
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Pair

ABB, SATURATED, ROUND = "abb-ipmsm-2k2", "baldor-pmsyrm-5k6", "paper001-pmsm-bench"

HARMONIC = next(c for c in tracker_candidates() if c.name == "third-harmonic")

INJECTION = next(c for c in tracker_candidates() if c.name == "injection")


@pytest.fixture(scope="module")
def salient() -> EstimatorFigures:
    return INJECTION.figures(ask(catalogue.load(ABB)))


def test_noise_is_that_of_the_closed_form(salient: EstimatorFigures) -> None:
    """The covariance of the loop by the Lyapunov equation, at no load."""
    assert salient.tracker is not None
    noise = ask(catalogue.load(ABB)).disturbances.i_noise
    expected = angle_noise(salient.tracker.gains, noise)
    assert salient.noise[0, 2] == pytest.approx(expected, rel=0.2)


def test_constants_without_cross_saturation_turn_nothing(salient: EstimatorFigures) -> None:
    """The axis of diag(L_d, L_q) is d, whatever they are: R and L leave no error at standstill."""
    assert salient.slopes is not None
    for cause in ("r_s", "l_d", "l_q", "psi_pm"):
        assert abs(salient.slopes.angle[cause][0]) < 1e-4
    assert salient.angle[0] == pytest.approx(salient.noise[0], rel=1e-3)


def test_it_holds_from_standstill_to_its_own_limit(salient: EstimatorFigures) -> None:
    assert salient.tracker is not None
    assert salient.omega_low == 0.0
    assert salient.omega_high == salient.tracker.omega_high
    beyond = ask(catalogue.load(ABB)).omega > salient.omega_high
    assert np.isinf(salient.angle[beyond]).all()
    assert np.isfinite(salient.angle[~beyond]).all()


def test_starts_lock_at_the_nearer_pole(salient: EstimatorFigures) -> None:
    """Polarity does not show: beyond 90 degrees the other pole is taken for it."""
    found = salient.capture
    assert found is not None
    right = int(np.argmin(np.abs(found.speeds)))
    angles = np.degrees(found.angles)
    assert (found.outcome[:, right, np.abs(angles) < 61.0] == LOCKED).all()
    assert (found.outcome[:, right, np.abs(angles) > 119.0] == HALF_TURN).all()


def test_cross_saturation_follows_a_machine_that_is_not_as_the_table_says() -> None:
    """At load of a saturated machine with L_d off, by hand: the loop rests at the error eps where
    Y_qd = Y_delta sin(2 chi - 2 eps), scaled by the table at the i_q that is seen, is its shift.
    """
    design = catalogue.load(SATURATED)
    asked = ask(design)
    figures = INJECTION.figures(asked)
    assert figures.slopes is not None
    load = asked.loads[3]
    jet = design.machine.jet(np.array([load.i_d]), np.array([load.i_q]))
    own = np.array([[jet.l_dd[0], jet.l_dq[0]], [jet.l_qd[0], jet.l_qq[0]]])
    table = along_locus(design, POINTS)

    def at(values: np.ndarray, eps: float) -> float:
        seen = load.i_q * np.cos(eps) - load.i_d * np.sin(eps)
        return float(np.interp(seen, table.i_q, values))

    def rest(change: float) -> float:
        s = np.sqrt(np.array([1.0 + change, 1.0]))
        y = np.linalg.inv(own * np.outer(s, s))
        along, across = 0.5 * (y[0, 0] - y[1, 1]), 0.5 * (y[0, 1] + y[1, 0])
        scale, shift = 1.0 / (table.y_delta * np.cos(2.0 * table.axis)), np.tan(2.0 * table.axis)

        def error(eps: float) -> float:
            crossed = across * np.cos(2.0 * eps) - along * np.sin(2.0 * eps)
            return float(at(scale, eps) * crossed - at(shift, eps))

        return float(brentq(error, -0.3, 0.3))

    low, high = asked.disturbances.limits("l_d")
    expected = (rest(high) - rest(low)) / (high - low)
    assert abs(expected) > 0.01
    assert figures.slopes.angle["l_d"][0] == pytest.approx(expected, rel=0.02)


def test_a_machine_without_saliency_is_refused_with_its_ratio() -> None:
    found = compare_estimators(catalogue.load(ROUND), [INJECTION])
    assert "those of this machine do by 1.08" in found.estimators[0].refusal
    assert found.pair.from_standstill is None


def test_what_is_added_moves_the_current_by_the_admittance() -> None:
    """A sine of voltage on a machine at rest makes the current of R + j w L per axis, sampled."""
    design = catalogue.load(ABB)
    machine, t_s = linearised(design.machine), design.control.t_s
    settings = ObserverSettings(method="injection", wave="sine", samples=10)
    tuned = tune_tracker(design, settings)
    drives = SteadyDrives(
        omega=np.zeros(1), current=np.zeros(1, dtype=complex), voltage=np.zeros(1, dtype=complex),
        r_s=np.full(1, machine.r_s), inductance=np.diag([machine.l_d, machine.l_q])[None],
        lost=np.zeros(1), noise=np.zeros(1), i_max=10.0,
    )  # fmt: skip
    seen: list[complex] = []

    def watched(
        gains: Any,
        state: Any,
        v: Pair,
        i: Pair,
        heard: tuple[Any, ...],
        maths: Arithmetic,
    ) -> Any:
        seen.append(complex(i[0][0], i[1][0]))
        return tuned.tracker.step(gains, state, v, i, heard, maths)

    record = replace(tuned.tracker, step=watched)
    for _ in tracked(replace(tuned, tracker=record), drives, np.zeros(1), np.zeros(1), 400):
        pass
    amplitude = np.sqrt(2.0) * np.std(np.array(seen[-200:]).real)
    z, rho = np.exp(2j * np.pi / 10), np.exp(-machine.r_s * t_s / machine.l_d)
    expected = max(tuned.gains.carrier) * (1.0 - rho) / machine.r_s / abs(z - rho)
    assert amplitude == pytest.approx(expected, rel=0.01)
    assert np.max(np.abs(np.array(seen).imag)) < 0.05 * amplitude


@cache
def summed() -> EstimatorFigures:
    """The third harmonic of a machine whose three wires carry no sum."""
    design = catalogue.load("paper002-phase-waveforms")
    loop = replace(design.control.current_loop, frame=None)
    inverter = replace(design.inverter, topology="three-wire", midpoint_capacitance=None)
    control = replace(design.control, current_loop=loop)
    return HARMONIC.figures(ask(replace(design, inverter=inverter, control=control)))


@pytest.mark.slow
def test_the_third_harmonic_is_heard_and_its_noise_is_that_of_the_closed_form() -> None:
    """Against the covariance of its linearised steps, r.m.s. over the speeds of the trials."""
    figures = summed()
    assert figures.tracker is not None
    gains = figures.tracker.gains
    asked = ask(catalogue.load("paper002-phase-waveforms"))
    record = ThirdHarmonic(
        gains.t_s, gains.amplitude, gains.phase, gains.k, gains.k_b, gains.k_p, gains.k_i,
        gains.omega_max,
    )  # fmt: skip
    heard = np.isfinite(figures.noise[:, 2])
    sigma = np.sqrt(3.0) * asked.disturbances.v_noise
    expected = [harmonic_noise(record, float(w), sigma) for w in asked.omega[heard]]
    # Beside the noise the angle swings with the harmonic itself, by amplitude and sampling.
    assert figures.noise[heard, 2][-1] == pytest.approx(
        np.sqrt(np.mean(np.square(expected))), rel=0.3
    )
    assert np.max(figures.angle[heard]) < np.radians(2.0)


def test_the_third_harmonic_tells_no_third_of_a_turn_from_another() -> None:
    capture = summed().capture
    assert capture is not None
    right = int(np.argmin(np.abs(capture.speeds)))
    angles = np.degrees(capture.angles)
    assert (capture.outcome[:, right, np.abs(angles) < 31.0] == LOCKED).all()
    assert (capture.outcome[:, right, np.abs(np.abs(angles) - 120.0) < 16.0] != LOCKED).all()


def test_six_step_estimators_stand_beside_and_are_not_flashed_in_another_drive() -> None:
    design = catalogue.load("paper002-phase-waveforms")
    chosen = [c for c in estimators() if c.name == "zero-crossing"]
    found = compare_estimators(design, chosen)
    figures = found.estimators[0].figures
    assert figures is not None
    assert (found.winner < 0).all()
    assert found.pair.at_speed is None
    inside = np.isfinite(figures.angle[:, 2])
    share = found.asked.omega / found.asked.omega_max
    assert share[inside][0] * found.asked.omega_max >= figures.omega_low
    # Offset and noise over the speed: the error of the least speed is the largest at no load.
    assert figures.angle[inside, 2][0] == np.max(figures.angle[inside, 2])
