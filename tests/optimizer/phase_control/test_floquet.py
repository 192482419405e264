"""Multipliers of the current loop over a period of the back-EMF: published figures, limits that
are known in closed form, and currents that die out in the time domain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from decaying_currents import SampledDrive, decay_per_sample
from phase_drives import T_S, plain_control
from phase_loops import (
    HARMONICS,
    INDUCTANCES,
    page_control,
    plants_of,
    speed_of,
    with_one_gain,
)

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.loops.plants import current_loop
from dqforge.optimizer.phase_control.judged_box import (
    OFF_NODES,
    STARTS,
    PhasePlants,
    loop_state,
    radius,
    whole_samples,
)
from dqforge.optimizer.phase_control.phase_controller import (
    HarmonicGains,
    MidpointGains,
    PhaseControl,
    PhaseShape,
)

SAMPLES = (200, 40, 24, 16, 12)
SALIENT = (5.3e-3, 10.7e-3, 5e-3)


def radii(control: PhaseControl, share: float = 1.0) -> list[float]:
    plants = plants_of(control, share)
    return [float(radius(control, plants, speed_of(samples))[0]) for samples in SAMPLES]


@pytest.mark.parametrize("frame", ["dq", "table", "dqx", "dqy"])
def test_the_loop_without_coupling_is_as_fast_as_paper_and_pencil_had_it(
    frame: CurrentFrame,
) -> None:
    """Integrators in dq0, dqx or dqy: the frame hardly matters."""
    assert radii(page_control(frame)) == pytest.approx(
        [0.9685, 0.969, 0.972, 0.978, 0.985], abs=5e-4
    )
    assert radii(page_control(frame, bandwidth=1000.0)) == pytest.approx([0.937] * 5, abs=1.3e-3)


def test_measured_coupling_costs_stability_at_few_samples() -> None:
    found = radii(page_control("dqy", "measured"))
    assert found[:3] == pytest.approx([0.969, 0.969, 0.972], abs=1e-3)
    assert found[3:] == pytest.approx([0.993, 1.058], abs=2.5e-3)
    fast = radii(page_control("dqy", "measured", bandwidth=1000.0))
    assert fast[1] < 1.0 < fast[2]


@pytest.mark.parametrize(("share", "first_unstable"), [(0.5, 1), (0.7, 2)])
def test_a_saturated_plant_under_measured_coupling(share: float, first_unstable: int) -> None:
    found = radii(page_control("dqy", "measured"), share)
    assert found[first_unstable - 1] < 1.0 < found[first_unstable]
    assert max(radii(page_control(), share)) < 1.0


@pytest.mark.parametrize("frame", ["table", "dqy"])
def test_one_gain_for_all_axes_is_unstable_beyond_f_s_over_omega_c(frame: CurrentFrame) -> None:
    """kp T_s/L_0 > 1: theory without resistance and integrator 3.18 at 500 Hz."""

    def at(ratio: float, bandwidth: float = 500.0) -> float:
        sizes = (INDUCTANCES[0], INDUCTANCES[0], INDUCTANCES[0] / ratio)
        control = with_one_gain(page_control(frame, bandwidth=bandwidth, inductances=sizes))
        return max(radii(control)[:1])

    assert at(3.0) == pytest.approx(0.976, abs=1e-3)
    assert at(3.15) == pytest.approx(1.0, abs=1e-3)
    assert at(3.1) < 1.0
    assert at(3.3) > 1.02
    assert at(1.6, 1000.0) == pytest.approx(1.03, abs=2e-3)


def test_harmonic_integrators_must_be_dropped_at_few_samples() -> None:
    endless = HarmonicGains(HARMONICS.plane, HARMONICS.zero, 60.0, 1e9, 1.0)
    kept = radii(page_control(harmonics=endless))
    dropped = radii(page_control(harmonics=HARMONICS))
    assert kept[4] > 1.0 > max(dropped)
    assert dropped[3:] == radii(page_control())[3:]
    state = loop_state(page_control(harmonics=HARMONICS), speed_of(40))
    assert [order for order, _ in state.plane] == [-5]
    assert dict(state.zero) == pytest.approx({3: 1.0})
    half = loop_state(page_control(harmonics=HARMONICS), speed_of(5 * 6 / 0.9))
    assert dict(half.plane) == pytest.approx({-5: 0.5})


def test_harmonic_integrators_learn_at_their_rate() -> None:
    """In the plane at the rate, on the 0 axis, where each sees two halves of a wave, at half."""
    plane = page_control(harmonics=replace(HARMONICS, zero=()))
    zero = page_control(harmonics=replace(HARMONICS, plane=()))
    for control, rate in ((plane, 60.0), (zero, 30.0)):
        assert -np.log(radii(control)[0]) / T_S == pytest.approx(rate, rel=0.15)


def test_at_standstill_the_axes_are_single_loops() -> None:
    control = page_control(inductances=SALIENT)
    poles = [
        np.max(np.abs(current_loop(1.0, size, T_S, gains.kp, gains.ki).closed.poles))
        for size, gains in zip(SALIENT, control.gains, strict=True)
    ]
    assert radius(control, plants_of(control), 0.0)[0] == pytest.approx(max(poles), rel=1e-9)
    assert radius(replace(control, frame="dqy"), plants_of(control), 0.0)[0] < 1.0


def test_both_directions_are_alike() -> None:
    for frame in ("table", "dqy"):
        control = page_control(frame, "measured")
        found = [radius(control, plants_of(control), side * speed_of(16))[0] for side in (-1, 1)]
        # A node belongs to the line behind it, whichever way the rotor turns.
        assert found[0] == pytest.approx(found[1], abs=2e-3)


def test_many_plants_are_each_their_own() -> None:
    control = page_control("dqy", harmonics=HARMONICS)
    rng = np.random.default_rng(2)
    d, q, zero = np.array(INDUCTANCES)[:, np.newaxis] * rng.uniform(0.7, 1.3, (3, 5))
    many = PhasePlants(rng.uniform(0.5, 1.5, 5), d, q, zero, rng.uniform(0.9, 1.1, 5))
    together = radius(control, many, speed_of(40))
    for row in range(5):
        r_s, l_d, l_q, l_0, gain = (
            column[row : row + 1] for column in (many.r_s, many.l_d, many.l_q, many.l_0, many.gain)
        )
        one = PhasePlants(r_s, l_d, l_q, l_0, gain)
        np.testing.assert_allclose(together[row], radius(control, one, speed_of(40))[0], rtol=1e-12)


def test_a_speed_between_whole_samples_is_taken_from_its_neighbourhood() -> None:
    control = page_control("dqy")
    found = whole_samples(control, speed_of(16.49))
    assert (found.samples, found.periods) == (33, 2)
    assert found.omega_e == pytest.approx(speed_of(16.5), rel=1e-12)
    values = [float(radius(control, plants_of(control), speed_of(n))[0]) for n in (16, 16.5, 17)]
    assert values == sorted(values, reverse=True)
    mechanical = replace(control, shape=replace(control.shape, turns=2))
    assert whole_samples(mechanical, speed_of(20.1)).samples == 161
    assert whole_samples(control, speed_of(40.3)).samples == 40


def test_a_slow_rotor_is_judged_at_fixed_angles() -> None:
    """The worst angle decides then, where a period has their mean."""
    table = page_control()
    swift = float(radius(table, plants_of(table), speed_of(399))[0])
    assert radius(table, plants_of(table), speed_of(3000))[0] == pytest.approx(swift, abs=1e-4)
    control = page_control("dqy")
    whole, fixed, rest = (
        float(radius(control, plants_of(control), speed)[0])
        for speed in (speed_of(399), speed_of(401), 0.0)
    )
    assert whole < fixed < whole + 3e-3
    assert fixed == pytest.approx(rest, abs=5e-4)


CASES: list[tuple[CurrentFrame, Feedforward, Topology, int]] = [
    ("dqy", "references", "four-leg", 16),
    ("table", "references", "four-leg", 16),
    ("table", "measured", "six-leg", 12),
    ("dq", "measured", "six-leg-isolated", 16),
    ("dqx", "references", "three-wire", 16),
    ("dqx", "measured", "four-leg", 12),
    ("dqy", "measured", "six-leg", 12),
]


@pytest.mark.thinned
@pytest.mark.parametrize(("frame", "feedforward", "topology", "samples"), CASES)
def test_currents_die_out_or_grow_at_the_radius(
    frame: CurrentFrame, feedforward: Feedforward, topology: Topology, samples: int
) -> None:
    _compare(page_control(frame, feedforward, topology=topology), samples, 600)


def _compare(
    control: PhaseControl,
    samples: int,
    length: int,
    capacitance: float | None = None,
    share: float = 1.0,
) -> None:
    l_d, l_q, l_0 = (share * size for size in control.inductances)
    plant = (control.r_s, l_d, l_q, l_0, 1.0)
    omega = speed_of(samples)
    length = -(-length // samples) * samples
    starts = (np.arange(STARTS) + OFF_NODES) / STARTS * 2.0 * np.pi / samples
    sloped = control.frame in ("dqx", "dqy") and control.feedforward == "measured"
    decay = max(
        decay_per_sample(
            SampledDrive(control, omega, plant, capacitance=capacitance or 1.0, theta=start),
            300,
            length,
        )
        for start in (starts if sloped else starts[:1])
    )
    found = float(radius(control, plants_of(control, share, capacitance), omega)[0])
    assert found == pytest.approx(decay, abs=1e-3)


@pytest.mark.thinned
@pytest.mark.parametrize("frame", ["table", "dqy"])
def test_a_salient_rotor_in_the_time_domain(frame: CurrentFrame) -> None:
    _compare(page_control(frame, inductances=SALIENT), 16, 320)


@pytest.mark.slow
def test_measured_coupling_of_a_salient_rotor() -> None:
    _compare(page_control("table", "measured", inductances=SALIENT), 12, 240)


@pytest.mark.slow
def test_a_split_link_oscillates_against_its_inductance_as_the_radius_says() -> None:
    """A small capacitance and a large balance, so that the midpoint decides."""
    for balance, capacitance in ((0.03, 4e-3), (0.5, 2e-4)):
        control = replace(
            page_control(topology="split-capacitor"), midpoint=MidpointGains(balance, 10.0)
        )
        _compare(control, 40, 2000, capacitance)
        _compare(replace(control, frame="dqy", feedforward="emf"), 24, 720, capacitance)
    slow = replace(page_control(topology="split-capacitor"), midpoint=MidpointGains(0.02, 10.0))
    decay = -np.log(radius(slow, plants_of(slow, 1.0, 4e-3), speed_of(40))[0]) / T_S
    assert decay == pytest.approx(3.0 * 0.02 / 4e-3, rel=0.02)


def test_the_balance_of_a_split_link_leaves_out_what_would_make_torque() -> None:
    """With a third harmonic of 60 % that is a quarter of it: the midpoint returns slower by it."""
    machine = PhaseMachine.from_harmonics(
        [1, 3], [0.2, 0.12], [0.0, 0.0], pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=6.0,
        angles=360,
    )  # fmt: skip
    control = plain_control(
        machine, "split-capacitor", midpoint=MidpointGains(0.02, 10.0), harmonics=None
    )
    _compare(replace(control, midpoint=MidpointGains(0.5, 10.0)), 24, 1200, 2e-4)
    angle = 2.0 * np.pi * np.arange(3600) / 3600
    zero = (0.12 * np.sin(3.0 * angle)) ** 2
    kept = np.mean(1.0 - 3.0 * zero / (1.5 * 0.2**2 + 3.0 * zero))
    assert kept == pytest.approx(0.76, abs=0.01)
    decay = -np.log(radius(control, plants_of(control, 1.0, 4e-3), speed_of(40))[0]) / T_S
    assert decay == pytest.approx(kept * 3.0 * 0.02 / 4e-3, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("frame", "share"), [("dqy", 0.7), ("table", 1.0)])
def test_learning_in_the_time_domain(frame: CurrentFrame, share: float) -> None:
    _compare(page_control(frame, harmonics=HARMONICS), 40, 1600, None, share)


def test_a_shape_over_several_periods_is_taken_over_all_of_them() -> None:
    control = page_control("dqy", "measured")
    one = float(radius(control, plants_of(control), speed_of(60))[0])
    twice = PhaseShape(np.tile(shape_at_nodes(control.shape), 2), turns=2)
    both = replace(control, shape=twice)
    assert radius(both, plants_of(both), speed_of(60))[0] == pytest.approx(one, abs=2e-4)
    uneven = twice.flux * np.repeat([1.0, 0.7], control.shape.flux.shape[1])
    other = replace(control, shape=replace(twice, flux=uneven))
    assert abs(radius(other, plants_of(other), speed_of(24))[0] - one) > 1e-3


def shape_at_nodes(shape: PhaseShape) -> FloatArray:
    """Three rows of a table of one."""
    count = shape.flux.shape[1]
    return np.stack([np.roll(shape.flux[0], phase * count // 3) for phase in range(3)])
