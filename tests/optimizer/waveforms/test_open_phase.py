"""What constant torque costs with a phase open: known figures, and the programmes that solve it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phase_shapes import paper_machine, trapezoid_machine

from dqforge.machines.design import catalogue
from dqforge.machines.names import OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms.comparison import compare_waveforms, open_phase_price
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.solver import solve_waveforms
from dqforge.reports.waveforms.tables import plain_waveforms, waveform_tables

NEUTRALS: tuple[Topology, ...] = ("four-leg", "six-leg", "split-capacitor")


@pytest.mark.parametrize("topology", NEUTRALS)
@pytest.mark.parametrize("phase", ["a", "b", "c"])
def test_the_neutral_needs_nearly_three_times_a_phase(topology: Topology, phase: OpenPhase) -> None:
    """The paper's machine at 1 N m: 1.61 of copper, twice the peak, 2.14 A and 3.56 A in the
    neutral, 2.7 times the healthy phase peak; half and 79 % of the torque are left.
    """
    found = open_phase_price(paper_machine(), topology, phase, 1.0)
    assert found is not None
    assert found.copper == pytest.approx(1.61, abs=0.005)
    assert found.peak == pytest.approx(1.98, abs=0.03)
    assert found.neutral_rms == pytest.approx(2.14, abs=0.005)
    assert found.neutral_peak == pytest.approx(3.56, abs=0.01)
    assert found.neutral == pytest.approx(2.66, abs=0.05)
    assert found.torque_at_peak == pytest.approx(0.50, abs=0.01)
    assert found.torque_at_copper == pytest.approx(0.79, abs=0.005)


def test_a_trapezoid_pays_a_little_less() -> None:
    """1.59 times the copper."""
    found = open_phase_price(trapezoid_machine(), "four-leg", "b", 1.0)
    assert found is not None
    assert found.copper == pytest.approx(1.59, abs=0.005)


@pytest.mark.parametrize("machine", [paper_machine(), trapezoid_machine()], ids=["P", "Z"])
def test_the_programmes_find_the_same(machine: PhaseMachine) -> None:
    """Copper and neutral of the least-loss currents without the phase, by quadratic programmes."""
    limits = WaveformLimits(1000.0, "four-leg", 100.0, open_phase="b")
    solved = solve_waveforms(machine, 2.0, 78.5, limits)
    healthy = solve_waveforms(machine, 2.0, 78.5, replace(limits, open_phase=None))
    found = open_phase_price(machine, "four-leg", "b", 2.0)
    assert found is not None
    assert solved.copper[0] / healthy.copper[0] == pytest.approx(found.copper, rel=1e-6)
    through = np.sum(solved.currents[0], axis=0)
    assert np.max(np.abs(through)) == pytest.approx(found.neutral_peak, rel=1e-6)


def test_without_a_neutral_there_is_no_constant_torque() -> None:
    """Star and isolated links; and a machine whose open phase was the only one somewhere."""
    for topology in ("three-wire", "six-leg-isolated", "diode-neutral"):
        assert open_phase_price(paper_machine(), topology, "b", 1.0) is None
    flux = paper_machine().flux.copy()
    flux[0] = flux[2] = 0.0
    lone = replace(paper_machine(), flux=flux + 1e-3 * paper_machine().flux * (flux != 0.0))
    assert open_phase_price(lone, "four-leg", "b", 1.0) is None


@pytest.mark.slow
def test_the_answer_of_dqy_says_it() -> None:
    """Two notes below the table and a key of the document; nothing where all phases are there."""
    design = catalogue.load("paper002-phase-waveforms")
    open_b = replace(design.waveform, open_phase="b")
    found = compare_waveforms(design, open_b)
    notes = waveform_tables(design, found)[0].notes
    assert any("copper 1.61 times" in note and "2.7 times" in note for note in notes)
    assert any("50 % of the torque" in note and "79 %" in note for note in notes)
    plain = plain_waveforms(found)["without_phase"]
    assert plain["torque_at_copper"] == pytest.approx(0.79, abs=0.005)
    healthy = compare_waveforms(design)
    assert plain_waveforms(healthy)["without_phase"] is None
    assert not any("open" in note for note in waveform_tables(design, healthy)[0].notes)
