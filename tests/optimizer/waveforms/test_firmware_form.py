"""Phase currents for the firmware: stated errors against an independent evaluation,
and the choice of form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import WaveformForm
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.firmware_fit import PhaseTable, fit_phases, sample_angles

ORDERS, SHARES = np.array([1.0, 3.0, 5.0, 7.0]), np.array([0.2, 0.03, -0.01, 0.006])
MACHINE = PhaseMachine.from_harmonics(
    ORDERS,
    np.abs(SHARES),
    np.where(SHARES < 0.0, np.pi, 0.0),
    pole_pairs=2,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=6.0,
)
UNEQUAL = PhaseMachine.from_harmonics(
    [1, 3],
    [[0.2, 0.02], [0.18, 0.02], [0.21, 0.02]],
    [[0.0, 0.0], [2.1, 0.1], [-2.1, 0.2]],
    pole_pairs=2,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=6.0,
)
FOUR = WaveformLimits(220.0, "four-leg", 6.0)


def shape(theta: np.ndarray) -> np.ndarray:
    """The three flux values of `MACHINE` in double, at any angle."""
    own = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    return np.asarray(-np.sum(SHARES[:, None, None] * np.sin(ORDERS[:, None, None] * own), axis=0))


@pytest.mark.parametrize("form", ["table", "harmonics"])
@pytest.mark.parametrize("topology", ["four-leg", "three-wire"])
@pytest.mark.parametrize("error", [5e-3, 5e-4])
def test_stated_errors_hold_at_angles_off_the_grid(
    form: WaveformForm, topology: str, error: float
) -> None:
    """Against T F / (p |F|^2) of the formula itself, at 40,000 random turns and both
    contractions.
    """
    limits = replace(FOUR, topology=topology)  # type: ignore[arg-type]
    fit = fit_phases(MACHINE, limits, WaveformSettings(form=form, error=error))
    assert fit.chosen.errors.current <= error
    turn = np.random.default_rng(1).uniform(0.0, 1.0, 40_000).astype(np.float32)
    theta = 2.0 * np.pi * turn.astype(np.float64)
    flux = shape(theta)
    part = flux - np.mean(flux, axis=0) if topology == "three-wire" else flux
    exact = part / (2.0 * np.sum(part**2, axis=0))
    angle = (
        (turn,)
        if form == "table"
        else (np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32))
    )
    for fused in (False, True):
        found = fit.reference.currents(
            np.full(turn.size, 1.0, dtype=np.float32), angle, fused=fused
        )
        worst = np.max(np.abs(found - exact)) / np.max(np.abs(exact))
        assert worst <= fit.chosen.errors.current * 1.01 + 2e-7
        assert (
            np.max(np.abs(2.0 * np.sum(flux * found, axis=0) - 1.0))
            <= fit.chosen.errors.torque * 1.01 + 1e-6
        )


def test_currents_are_proportional_clamped_and_safe() -> None:
    fit = fit_phases(MACHINE, FOUR, WaveformSettings(form="table"))
    (turn,) = sample_angles(fit.reference.form, 100, 3)
    end = np.float32(fit.torque_max)
    unit = fit.reference.currents(np.ones(100, dtype=np.float32), (turn,))
    np.testing.assert_array_equal(
        fit.reference.currents(np.full(100, np.nan, np.float32), (turn,)), 0.0 * unit
    )
    np.testing.assert_array_equal(
        fit.reference.currents(np.full(100, 1e9, np.float32), (turn,)),
        fit.reference.currents(np.full(100, end, np.float32), (turn,)),
    )
    peak = fit.reference.currents(np.full(100, -end, np.float32), (turn,))
    assert np.max(np.abs(peak)) <= 6.0 * (1.0 + fit.chosen.errors.current + 1e-6)
    outside = np.array([1.0, -0.25, np.nan, 7.0], dtype=np.float32)
    at_zero = fit.reference.currents(np.ones(1, np.float32), (np.zeros(1, np.float32),))
    np.testing.assert_array_equal(
        fit.reference.currents(np.ones(4, np.float32), (outside,)), np.repeat(at_zero, 4, axis=1)
    )


def test_cheapest_needs_the_fewest_operations_and_the_other_is_listed() -> None:
    fit = fit_phases(MACHINE, FOUR, WaveformSettings())
    assert isinstance(fit.chosen.form, PhaseTable)
    assert [entry.operations for entry in fit.candidates] == sorted(
        entry.operations for entry in fit.candidates
    )
    assert fit.candidates[1].flash < fit.chosen.flash
    finer = fit_phases(MACHINE, FOUR, WaveformSettings(error=2e-4))
    assert finer.chosen.flash > fit.chosen.flash


def test_unequal_phases_have_a_row_each_and_an_open_one_stays_still() -> None:
    fit = fit_phases(UNEQUAL, FOUR, WaveformSettings(form="table"))
    assert isinstance(fit.chosen.form, PhaseTable)
    assert fit.chosen.form.entries.shape[0] == 3
    without = fit_phases(
        MACHINE, replace(FOUR, open_phase="b"), WaveformSettings(form="table", error=0.02)
    )
    turn = np.linspace(0.0, 0.99, 200).astype(np.float32)
    found = without.reference.currents(np.ones(200, np.float32), (turn,))
    assert np.max(np.abs(found[1])) < 1e-6


@pytest.mark.slow
def test_what_no_form_keeps_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="no harmonics keeps 1e-06 % of the peak"):
        fit_phases(UNEQUAL, FOUR, WaveformSettings(form="harmonics", error=1e-8))


def test_angles_that_are_tried_hold_both_zeros_both_signs_and_no_number() -> None:
    form = fit_phases(MACHINE, FOUR, WaveformSettings(form="table")).reference.form
    (turn,) = sample_angles(form, 100, 3)
    assert {bool(sign) for sign in np.signbit(turn[turn == 0.0])} == {True, False}
    assert np.isnan(turn).any()
    assert np.any(turn < 0.0)
    assert np.any((turn > 0.0) & (turn < 1e-38))
    assert np.nextafter(np.float32(1.0), np.float32(0.0)) in turn
