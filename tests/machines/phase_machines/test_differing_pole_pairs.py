"""Machines whose back-EMF differs from pole pair to pole pair: the waveform spans
a mechanical turn.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import (
    dynamic_model,
    frame_rms,
    loss_ratio_x_over_y,
    spectral_derivative,
    spectral_frame_angles,
    to_frame,
)
from dqforge.machines.phase_machines.phase_machine import (
    PhaseMachine,
    SalientPhaseMachine,
    between,
    derivative,
    grid,
    shift_of,
)

# Orders of the electrical angle; every machine here has its fraction of it.
ORDERS = [1.0, 3.0, 5.0]
SIZES = [0.2, 0.02, 0.006]


def machine(pole_pairs: int, share: float = 0.1, **more: Any) -> PhaseMachine:
    """Sidebands of the fundamental one mechanical order away, and one below it at order 3."""
    side = 1.0 / pole_pairs
    return PhaseMachine.from_harmonics(
        [*ORDERS, 1.0 - side, 1.0 + side, 3.0 - side],
        [*SIZES, share * 0.2, 0.5 * share * 0.2, 0.1 * share * 0.2],
        [0.0, 0.3, np.pi, 0.4, -0.7, 1.0],
        **({"pole_pairs": pole_pairs, "r_s": 1.0, "l_s": 7e-3, "m_s": -1e-3, "i_max": 10.0} | more),
    )


def repeated(one: PhaseMachine) -> PhaseMachine:
    """The same machine, its period written once for each pole pair."""
    return replace(one, flux=np.tile(one.flux, one.pole_pairs), turns=one.pole_pairs)


SAME = PhaseMachine.from_harmonics(
    ORDERS, SIZES, [0.0, 0.3, np.pi], pole_pairs=5, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=10.0
)


def test_orders_that_are_not_whole_span_the_mechanical_turn() -> None:
    """e_a / omega_e at any angle is the sum of its harmonics; equal phases lie thirds of
    the mechanical turn apart.
    """
    found = machine(5)
    assert (found.turns, found.angles) == (5, 1800)
    theta = 2.0 * np.pi * 5.0 * np.arange(1800) / 1800.0
    np.testing.assert_array_equal(found.theta, theta)
    wanted = -sum(
        size * np.sin(order * theta - lag)
        for order, size, lag in zip(
            [1, 3, 5, 0.8, 1.2, 2.8],
            [0.2, 0.02, 0.006, 0.02, 0.01, 0.002],
            [0.0, 0.3, np.pi, 0.4, -0.7, 1.0],
            strict=True,
        )
    )
    np.testing.assert_allclose(found.flux[0], wanted, atol=1e-15)
    # Two thirds of the mechanical turn are 1200 electrical degrees: 120 and three periods.
    np.testing.assert_allclose(found.flux[1], np.roll(found.flux[0], 1200), atol=1e-14)
    np.testing.assert_allclose(found.flux[2], np.roll(found.flux[0], 600), atol=1e-14)
    assert found.psi_pm == pytest.approx(0.2, rel=1e-12)


@pytest.mark.parametrize("pole_pairs", [2, 4, 5, 7])
def test_a_third_of_the_mechanical_turn_tells_all_of_equal_phases(pole_pairs: int) -> None:
    found = machine(pole_pairs)
    assert found.symmetry == "third"
    moved = np.roll(found.flux, -found.angles // 3, axis=1)
    np.testing.assert_allclose(moved, shift_of(3, pole_pairs) @ found.flux, atol=1e-13)


def test_three_pole_pairs_have_no_thirds_of_the_mechanical_turn() -> None:
    """A third of it leads from each phase to itself; the phases lag by 120 electrical degrees."""
    found = machine(3)
    assert found.symmetry == "none"
    np.testing.assert_allclose(found.flux[1], np.roll(found.flux[0], 120), atol=0.05)
    with pytest.raises(InputError, match="no third of a mechanical turn apart"):
        found.symmetrised()


def test_equal_pole_pairs_written_out_are_the_machine_of_one_period() -> None:
    """Whatever takes the grid for a period of 2 pi would say otherwise."""
    whole = repeated(SAME)
    assert whole.symmetry == SAME.symmetry == "sixth"
    assert whole.psi_pm == pytest.approx(SAME.psi_pm, rel=1e-13)
    currents = np.random.default_rng(1).normal(size=(3, SAME.angles))
    many = np.tile(currents, 5)
    np.testing.assert_allclose(
        whole.voltage(many, 300.0), np.tile(SAME.voltage(currents, 300.0), 5), atol=1e-9
    )
    np.testing.assert_allclose(whole.torque(many), np.tile(SAME.torque(currents), 5), atol=1e-12)
    assert whole.copper_loss(many) == pytest.approx(float(SAME.copper_loss(currents)), rel=1e-12)


def test_slopes_are_per_electrical_angle() -> None:
    """Of sixth order at the angles and of fourth between them; exact from the spectrum."""
    theta = grid(1800, 5)
    wave = np.sin(0.8 * theta)
    np.testing.assert_allclose(derivative(wave, 5), 0.8 * np.cos(0.8 * theta), atol=1e-9)
    middle = theta + 0.5 * theta[1]
    value, slope = between(wave, 5)
    np.testing.assert_allclose(value, np.sin(0.8 * middle), atol=1e-8)
    np.testing.assert_allclose(slope, 0.8 * np.cos(0.8 * middle), atol=1e-8)
    np.testing.assert_allclose(spectral_derivative(wave, 5), 0.8 * np.cos(0.8 * theta), atol=1e-12)


def test_the_mean_of_the_phases_keeps_what_the_pole_pairs_differ_by() -> None:
    flux = machine(5).flux * np.array([[1.03], [1.0], [0.97]])
    found = replace(machine(5), flux=flux).symmetrised()
    np.testing.assert_allclose(found.flux, machine(5).flux, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"turns": 3}, "after 1 electrical period or after all 5 of a mechanical turn, got turns"),
        ({"flux": np.ones((3, 1200 + 12))}, r"N a multiple of 60 from 120 on, got \(3, 1212\)"),
    ],
)
def test_what_spans_no_mechanical_turn_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(machine(5), **change)


def test_an_order_of_no_pole_pair_is_refused() -> None:
    with pytest.raises(InputError, match="multiples of 1/5 for the 5 pole pairs"):
        PhaseMachine.from_harmonics(
            [1.0, 1.25], [0.2, 0.1], [0.0, 0.0], pole_pairs=5, r_s=1.0, l_s=1.0, m_s=0.0, i_max=1.0
        )


def shape_of(found: PhaseMachine) -> FloatArray:
    return np.asarray(found.flux / np.max(np.abs(found.flux)))


@pytest.mark.parametrize("frame", ["dqx", "dqy"])
def test_frames_turn_with_every_pole_pair(frame: Any) -> None:
    """The voltage of the model in the frame against that of the phases, for sinusoidal currents
    of the mechanical turn: the closed forms hold at each angle.
    """
    found = machine(5)
    theta, shape = found.theta, shape_of(found)
    phases = np.stack([np.cos(0.6 * theta + k) for k in range(3)])
    current = to_frame(frame, theta, shape, phases, scaled=True)
    model = dynamic_model(frame, shape, found.l_s, found.m_s, scaled=True, turns=5)
    volts = np.einsum("jkm,mj->kj", model.inductance, spectral_derivative(current, 5)) + np.einsum(
        "jkm,mj->kj", model.coupling, current
    )
    wanted = found.inductances @ spectral_derivative(phases, 5)
    np.testing.assert_allclose(volts, to_frame(frame, theta, shape, wanted, scaled=True), atol=2e-8)


def test_angles_of_the_frames_over_the_turn_are_those_of_one_period_where_pole_pairs_agree() -> (
    None
):
    one, whole = (shape_of(part) for part in (SAME, repeated(SAME)))
    for single, many in (
        (spectral_frame_angles(one), spectral_frame_angles(whole, 5)),
        (frame_rms(one), frame_rms(whole, 5)),
    ):
        for name in single.__dataclass_fields__:
            expected = np.tile(getattr(single, name), 5 if np.ndim(getattr(single, name)) else 1)
            np.testing.assert_allclose(np.atleast_1d(getattr(many, name)), expected, atol=1e-9)
    assert loss_ratio_x_over_y(whole) == pytest.approx(loss_ratio_x_over_y(one), rel=1e-12)


def test_saliency_over_the_turn_is_that_of_every_electrical_period() -> None:
    one = SalientPhaseMachine.with_second_harmonic(SAME, 1e-3)
    whole = SalientPhaseMachine.with_second_harmonic(repeated(SAME), 1e-3)
    assert whole.turns == 5
    assert whole.symmetry == one.symmetry == "sixth"
    np.testing.assert_allclose(whole.dq_inductances, one.dq_inductances, rtol=1e-12)
    np.testing.assert_allclose(whole.slope[: one.angles], one.slope, atol=1e-13)
    currents = np.random.default_rng(2).normal(size=(3, SAME.angles))
    np.testing.assert_allclose(
        whole.voltage(np.tile(currents, 5), 200.0),
        np.tile(one.voltage(currents, 200.0), 5),
        atol=1e-9,
    )
