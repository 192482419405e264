"""Phase currents of machines whose pole pairs differ: over the whole mechanical turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.optimizer.harmonic_trackers import other_harmonics, third_flux
from dqforge.optimizer.waveforms.comparison import compare_waveforms
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    dq_waveform,
    spectrum,
    unit_currents,
)
from dqforge.optimizer.waveforms.firmware_fit import PhaseTable, fit_phases
from dqforge.optimizer.waveforms.salient_reference import fit_salient_phases
from dqforge.optimizer.waveforms.solver import confirm_waveforms, solve_waveforms

MACHINE = PhaseMachine.from_harmonics(
    [1.0, 3.0, 0.5, 1.5],
    [0.2, 0.02, 0.02, 0.01],
    [0.0, 0.3, 0.4, -0.7],
    pole_pairs=2,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=10.0,
    angles=240,
)
DESIGN = """\
dqforge: 1
name: Two pole pairs
machine:
  model: waveform
  pole_pairs: 2
  resistance: {value: 1 Ohm, kind: phase}
  self_inductance: 7 mH
  mutual_inductance: -1 mH
  back_emf:
    harmonics:
      - {order: 1, amplitude: 0.2 Wb}
      - {mechanical_order: 1, share: 10 %}
      - {mechanical_order: 3, share: 5 %, phase: 30 deg}
  max_current: 6 A
inverter: {v_dc: 220 V, switching_frequency: 10 kHz, topology: four-leg}
control: {current_loop: {method: bandwidth, bandwidth: 300 Hz}}
waveform: {torque: 1 N m, speed: 750 rpm, error: 0.5 %}
export: {prefix: two}
"""


@pytest.mark.parametrize("rule", ["dq", "dqx", "dqy"])
def test_closed_forms_make_the_torque_over_every_pole_pair(rule: Any) -> None:
    torque = MACHINE.torque(unit_currents(MACHINE, rule))
    assert np.mean(torque) == pytest.approx(1.0, rel=1e-12)
    if rule != "dq":
        np.testing.assert_allclose(torque, 1.0, atol=1e-12)


def test_sinusoidal_currents_ripple_with_the_mechanical_turn() -> None:
    """A back-EMF of half the order turns against the current at half the electrical frequency."""
    currents = unit_currents(MACHINE, "dq")
    lines, orders = spectrum(currents, 2)
    assert orders[2] == 1.0
    assert np.max(np.delete(lines, 2, axis=1)) < 1e-12 * np.max(lines)
    ripple = 2.0 * np.abs(np.fft.rfft(MACHINE.torque(currents))) / MACHINE.angles
    # b and c lie 480 and 240 electrical degrees behind: orders 0.5 and 1.5 are seen by the
    # fundamental as sequences that leave 1.5 turns and half a turn.
    assert np.flatnonzero(ripple > 1e-9).tolist() == [0, 3]
    np.testing.assert_allclose(
        dq_waveform(0.0, 1.0, 240, 2)[:, :120], dq_waveform(0.0, 1.0, 120), atol=1e-14
    )


@pytest.mark.parametrize("topology", ["three-wire", "four-leg", "split-capacitor", "six-leg"])
def test_a_third_of_the_turn_is_solved_as_the_whole_turn_is(topology: Any) -> None:
    """A difference of 1e-8 between the phases takes the symmetry away and changes nothing else."""
    size = {"three-wire": 0.85, "four-leg": 0.85, "split-capacitor": 1.7, "six-leg": 0.5}[topology]
    limits = WaveformLimits(120.0 * size, topology, 10.0, neutral=1.0)
    away = replace(MACHINE, flux=MACHINE.flux * (1.0 + 1e-8 * np.array([[0.0], [1.0], [-1.0]])))
    assert (MACHINE.symmetry, away.symmetry) == ("third", "none")
    found, whole = (solve_waveforms(one, 2.0, 150.0, limits) for one in (MACHINE, away))
    assert found.status == whole.status == ("solved",)
    np.testing.assert_allclose(found.currents, whole.currents, atol=2e-4)
    assert confirm_waveforms(MACHINE, found, limits)[0].verdict == "confirmed"


def test_the_table_spans_the_mechanical_turn() -> None:
    limits = WaveformLimits(200.0, "four-leg", 10.0)
    fit = fit_phases(MACHINE, limits, WaveformSettings(error=1e-3))
    table = fit.chosen.form
    assert isinstance(table, PhaseTable)
    assert table.entries.shape == (3, table.size + 1)
    assert fit.chosen.name == f"table of {table.size}"
    turn = (np.arange(240) / 240.0).astype(np.float32)
    unit = unit_currents(MACHINE, "dqy")
    found = fit.reference.currents(np.ones(240, np.float32), (turn,))
    assert np.max(np.abs(found - unit)) < 2e-3 * np.max(np.abs(unit))
    assert fit.chosen.errors.torque < 2e-3


def test_harmonics_of_the_electrical_angle_are_refused() -> None:
    settings, limits = WaveformSettings(form="harmonics"), WaveformLimits(200.0, "four-leg", 10.0)
    with pytest.raises(InputError, match="do not tell which pole pair it is"):
        fit_phases(MACHINE, limits, settings)
    salient = SalientPhaseMachine.with_second_harmonic(MACHINE, 5e-4)
    with pytest.raises(InputError, match="for pole pairs that differ, fit no form"):
        fit_salient_phases(salient, limits, WaveformSettings())


def test_a_design_of_two_pole_pairs_is_shaped() -> None:
    """Every rule makes the torque; orders are those of the electrical angle."""
    comparison = compare_waveforms(load_text(DESIGN.encode(), "two.yaml"))
    assert comparison.machine.turns == 2
    for found in comparison.rules:
        assert float(found.figures.torque[0]) == pytest.approx(1.0, rel=1e-9)
        assert found.orders[:3].tolist() == [0.0, 0.5, 1.0]
    ripple = {found.rule: float(found.figures.ripple[0]) for found in comparison.rules}
    assert ripple["dq"] > 0.1
    assert max(ripple["dqx"], ripple["dqy"], ripple["limited"]) < 1e-6


def test_the_third_harmonic_is_found_among_those_of_the_turn() -> None:
    one = PhaseMachine.from_harmonics(
        [1.0, 3.0], [0.2, 0.02], [0.0, 0.3], pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=0.0, i_max=1.0
    )
    whole = replace(one, flux=np.tile(one.flux, 2), turns=2)
    np.testing.assert_allclose(third_flux(whole), third_flux(one), rtol=1e-12)
    assert other_harmonics(whole) < 1e-12
    # Mechanical order 3 is order 1.5, where the phases of two pole pairs lag by 720 degrees.
    expected = (3.0 * 0.01 / 1.5) / (3.0 * third_flux(MACHINE)[0])
    assert other_harmonics(MACHINE) == pytest.approx(expected, rel=1e-9)
