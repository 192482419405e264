"""INFORM and inductance mapping: the noise of a sequence, the axis under load, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from locked_rotor import Rest, track_at_rest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.estimators import TRACKERS, tune_tracker
from dqforge.optimizer.saliency.inform import (
    LAST,
    InformGains,
    inform_start,
    inform_step,
    sequence_noise,
    tracked_noise,
    usual_pulse,
)
from dqforge.optimizer.saliency.injection import along_locus, current_noise
from dqforge.optimizer.saliency.load_tables import POINTS
from dqforge.optimizer.steps.step_arithmetic import EXACT

BALDOR = "baldor-pmsyrm-5k6"


def drive(name: str = BALDOR) -> Design:
    design = catalogue.load(name)
    return replace(design, export=replace(design.export, control=("float32",)))


def gains_of(
    design: Design, method: ObserverMethodName = "inductance-mapping", **settings: float
) -> InformGains:
    wanted = ObserverSettings(method=method, **settings)  # type: ignore[arg-type]
    found = tune_tracker(design, wanted).gains
    assert isinstance(found, InformGains)
    return found


def _one_sequence(step: float, y_sum: float, sigma: float, trials: int, seed: int) -> FloatArray:
    """Angle errors in rad of single sequences at rest, pulses and samples written out here.

    ``step`` is V t_s Y_delta in A; without resistance.
    """
    generator = np.random.default_rng(seed)
    theta = generator.uniform(-np.pi, np.pi, trials)
    gains = InformGains(1e-4, 0.0, 0.0, 1e9, 1.0, 16.0, 0.0, (1.0,) * POINTS, (0.0,) * POINTS)
    state = inform_start(gains, np.zeros(trials), np.zeros(trials))
    i, acting = np.zeros(trials, dtype=np.complex128), np.zeros(trials, dtype=np.complex128)
    for _ in range(LAST + 1):
        noise = sigma * (generator.standard_normal((2, trials)))
        state = inform_step(
            gains, state, (i.real, i.imag), (i.real + noise[0], i.imag + noise[1]), (), EXACT
        )
        i = i + acting * y_sum + step * np.conj(acting) * np.exp(2j * theta)
        acting = state.added[0] + 1j * state.added[1]
    z = state.z.alpha + 1j * state.z.beta
    assert np.mean(np.abs(z)) == pytest.approx(1.5 * step, rel=0.2)
    return np.asarray(np.angle(z * np.exp(-2j * theta)) / 2.0)


def test_a_sequence_without_noise_is_exact() -> None:
    assert np.max(np.abs(_one_sequence(0.1, 1.0, 0.0, 200, 1))) < 1e-7


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2])
def test_the_noise_of_a_sequence_is_the_formula(share: float) -> None:
    """10,000 trials within 10 %, up to some 6 degrees."""
    found = _one_sequence(1.0, 4.0, share, 10_000, 2)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(sequence_noise(share, 1.0), rel=0.1)


def test_eight_sequences_have_the_noise_of_one_over_root_eight() -> None:
    found = np.mean(_one_sequence(1.0, 4.0, 0.1, 80_000, 3).reshape(8, -1), axis=0)
    expected = sequence_noise(0.1, 1.0) / np.sqrt(8.0)
    assert np.std(found) == pytest.approx(expected, rel=0.05)


def test_shared_samples_cost_a_quarter() -> None:
    assert sequence_noise(1.0, 1.0) == pytest.approx(0.514, abs=0.002)


def test_the_loop_has_the_noise_that_it_says() -> None:
    design = replace(drive(), machine=linearised(drive().machine))
    gains = gains_of(design)
    rest = Rest(noise=current_noise(design) / design.i_max, away=0.0)
    errors = track_at_rest(
        TRACKERS["inductance-mapping"], gains, design, rest, np.random.default_rng(5), (3000, 40)
    )
    expected = tracked_noise(gains, current_noise(design))
    assert np.std(errors[800:]) == pytest.approx(expected, rel=0.12)


def test_the_table_has_the_axis_of_the_flux_map() -> None:
    design = drive()
    loaded, gains = along_locus(design, POINTS), gains_of(design)
    np.testing.assert_allclose(gains.shift, 0.5 * np.tan(2.0 * loaded.axis), atol=1e-12)
    with pytest.raises(NoSolutionError, match=r"by -5\.07 deg at 51\.2 N m.*inductance-mapping"):
        gains_of(design, "inform")
    straight = gains_of(replace(design, machine=linearised(design.machine)), "inform")
    assert straight.shift == (0.0,) * POINTS


@pytest.mark.parametrize("method", ["inform", "inductance-mapping"])
def test_a_machine_without_saliency_is_refused(method: ObserverMethodName) -> None:
    machine = linearised(drive().machine)
    round_ = replace(drive(), machine=replace(machine, l_q=machine.l_d))
    with pytest.raises(NoSolutionError, match=rf"{method} needs inductances .* by 1 without load"):
        gains_of(round_, method)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"voltage": 200.0}, "write at most 155.9 V"),
        ({"period": 5e-4}, "a sequence takes 8 samples"),
        ({"pll_bandwidth": 1e4}, "write at most 500 rad/s"),
    ],
)
def test_settings_out_of_range(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        gains_of(drive(), "inductance-mapping", **settings)


def test_pulses_that_noise_hides_are_refused() -> None:
    with pytest.raises(NoSolutionError, match=r"write voltage: \d+\.?\d* V or more"):
        gains_of(drive(), voltage=10.0)
    assert usual_pulse(drive()) == pytest.approx(0.28 * 540.0)


def test_one_bad_sample_costs_one_sequence() -> None:
    gains = gains_of(drive())
    state = inform_start(gains, np.zeros(3), np.zeros(3))
    for k in range(60):
        bad = np.array([np.nan, np.inf, 0.1]) if k == 20 else np.full(3, 0.1)
        state = inform_step(gains, state, (bad, bad), (bad, bad), (), EXACT)
        for part in (state.theta_e, state.omega_e, *state.added, *state.current):
            assert np.all(np.isfinite(part))
    np.testing.assert_allclose(state.theta_e, state.theta_e[2], atol=1e-3)


def test_the_gains_are_those_of_the_saliency_along_the_load() -> None:
    """Poles of the loop from its roots, the tables from inductances by finite differences of the
    flux, and the speed from the voltage that the pulses leave.
    """
    design = drive()
    gains, t_s = gains_of(design, damping=0.8, pll_bandwidth=60.0), design.control.t_s
    time = gains.period * t_s
    # Angle and speed of a sequence: e, w -> e - k_p e - time w, w + k_i e.
    poles = np.roots([1.0, gains.k_p - 2.0, 1.0 - gains.k_p + gains.k_i * time])
    wanted = np.exp(np.roots([1.0, 2.0 * 0.8 * 60.0, 60.0**2]) * time)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(wanted), rtol=0.02)
    loaded = along_locus(design, POINTS)
    step = 1e-3
    for k in range(0, POINTS, 4):
        i = np.array([loaded.i_d[k], loaded.i_q[k]])
        slopes = np.empty((2, 2))
        for axis in range(2):
            ends = [i + side * step * np.eye(2)[axis] for side in (1.0, -1.0)]
            high, low = (np.array(design.machine.flux(*end)) for end in ends)
            slopes[:, axis] = (high - low) / (2.0 * step)
        inverse = np.linalg.inv(slopes)
        along, across = 0.5 * (inverse[0, 0] - inverse[1, 1]), inverse[0, 1]
        assert gains.scale[k] == pytest.approx(1.0 / (3.0 * gains.voltage * t_s * along), rel=0.02)
        assert gains.shift[k] == pytest.approx(0.5 * across / along, rel=0.05, abs=1e-3)
    machine, i_q = linearised(design.machine), loaded.i_q[-1]
    assert gains.per_ampere == pytest.approx((POINTS - 1) / i_q)
    cases = (design.inverter.v_dc, 1e9, 8.0), (1.5 * gains.voltage, 1e9, 8.0), (1e4, 40.0, 8.0)
    for v_dc, most, period in (*cases, (1e4, 1e9, 8.0), (1e4, 1e9, 40.0)):
        other = replace(design, inverter=replace(design.inverter, v_dc=v_dc))
        left = v_dc / np.sqrt(3.0) - gains.voltage - machine.r_s * i_q
        flux = float(np.abs(machine.psi_pm + 1j * machine.l_q * i_q))
        turned = min(0.3 / 6.0, 0.8 / period) / t_s
        limited = replace(gains, omega_max=most, period=period)
        expected = 0.0, min(turned, most, left / flux)
        assert TRACKERS["inform"].speeds(other, limited) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("method", ["inductance-mapping", "inform"])
def test_pulses_are_judged_and_emitted_as_they_are_told(method: ObserverMethodName) -> None:
    design = replace(drive(), machine=linearised(drive().machine))
    gains, tracker, t_s = (
        gains_of(design, method, pll_bandwidth=60.0), TRACKERS[method], design.control.t_s,
    )  # fmt: skip
    every, code = int(gains.period), method.replace("-", "_")
    assert tracker.loop is not None
    loop = tracker.loop(gains)
    # of the sequences, the mean age: 3 samples from their middle on, and half of their distance
    assert loop.seen == ((round(3.0 + 0.5 * (every - 1)), 1.0),)
    assert loop.t_s == t_s
    assert loop.k_i == pytest.approx(60.0**2 * t_s, rel=0.2)
    assert loop.lag == pytest.approx(2.0 / 60.0, rel=0.2)
    told = tracker.in_words(gains)
    assert f"six pulses of {gains.voltage:.4g} V, each {1e6 * t_s:.4g} us" in told
    assert f"every {1e3 * every * t_s:.4g} ms" in told
    assert float(told.split("loop ")[1].split(" ")[0]) == pytest.approx(60.0, rel=0.1)
    assert tracker.steps is not None
    found = tracker.steps(gains)
    assert {name: value for name, value, _ in found.counts} == {
        f"{code.upper()}_POINTS": POINTS, f"{code.upper()}_PERIOD": every,
    }  # fmt: skip
    assert found.names == {"at_load": f"{code}_at", "error_at_load": f"{code}_error"}
    assert (found.state.theta_e, found.state.n, found.state.started) == (0.0, 0, 0)
    assert type(found.state).__name__ == ("Inform" if method == "inform" else "InductanceMapping")
