"""What each topology breaks of the closed forms, and why diodes in the neutral refuse dqy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phase_shapes import paper_machine, trapezoid_machine

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms.comparison import compare_waveforms, what_diodes_block
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits, unit_currents
from dqforge.optimizer.waveforms.firmware_fit import fit_phases
from dqforge.optimizer.waveforms.solver import solve_waveforms


def design_with(topology: Topology, machine: PhaseMachine | None = None) -> Design:
    design = catalogue.load("paper002-phase-waveforms")
    return replace(
        design,
        inverter=replace(design.inverter, topology=topology),
        phase_machine=design.phase_machine if machine is None else machine,
    )


@pytest.mark.parametrize(
    ("topology", "breaks"),
    [
        ("three-wire", ("needs the neutral",)),
        ("six-leg-isolated", ("needs the neutral",)),
        ("four-leg", ()),
        ("six-leg", ()),
        ("split-capacitor", ()),
    ],
)
def test_dqy_needs_a_neutral(topology: Topology, breaks: tuple[str, ...]) -> None:
    found = {rule.rule: rule for rule in compare_waveforms(design_with(topology)).rules}
    assert found["dqy"].obstacles == breaks
    assert found["dqx"].obstacles == ()
    cheapest = found["dqx" if breaks else "dqy"].figures
    assert found["limited"].figures.copper[0] == pytest.approx(cheapest.copper[0], rel=1e-9)


@pytest.mark.parametrize("machine", [paper_machine(), trapezoid_machine()])
@pytest.mark.parametrize("torque", [1.0, -1.0])
def test_diodes_in_the_neutral_refuse_dqy_and_run_dqx(machine: PhaseMachine, torque: float) -> None:
    design = design_with("diode-neutral", machine)
    found = compare_waveforms(design, replace(design.waveform, torque=torque))
    ((rule, reason),) = found.impossible
    assert rule == "dqy"
    assert "while all phase voltages oppose it" in reason
    assert reason.endswith("use dqx")
    by_rule = {rule.rule: rule for rule in found.rules}
    assert by_rule["dqx"].obstacles == ()
    assert found.binding == ()
    np.testing.assert_allclose(by_rule["limited"].currents, by_rule["dqx"].currents, atol=1e-9)


def test_diodes_pass_what_brakes_where_all_phases_have_one_sign() -> None:
    """A third order alone: braking, the voltages oppose the neutral current; motoring, never."""
    machine = PhaseMachine.from_harmonics(
        [3], [0.2], [0.0], pole_pairs=2, r_s=0.1, l_s=1e-9, m_s=0.0, i_max=40.0
    )
    for omega_m in (150.0, -150.0):
        braking = -np.sign(omega_m) * 10.0 * machine.flux
        assert what_diodes_block(machine, braking, omega_m, "diode-neutral") == ""
        reason = what_diodes_block(machine, -braking, omega_m, "diode-neutral")
        assert "at 0 % of the angles" in reason
        assert what_diodes_block(machine, -braking, omega_m, "four-leg") == ""


def test_isolated_links_are_a_star_on_twice_the_voltage() -> None:
    machine = paper_machine()
    star = solve_waveforms(machine, 3.5, 188.5, WaveformLimits(150.0, "three-wire", 5.94))
    links = solve_waveforms(machine, 3.5, 188.5, WaveformLimits(75.0, "six-leg-isolated", 5.94))
    np.testing.assert_allclose(links.currents, star.currents, atol=1e-7)
    assert np.max(np.abs(np.sum(links.currents, axis=1))) < 1e-9


def test_firmware_behind_diodes_has_no_zero_sequence() -> None:
    machine = PhaseMachine.from_harmonics(
        [1, 3], [0.1, 0.12], [0.0, 0.0], pole_pairs=2, r_s=1.0, l_s=4e-3, m_s=0.0, i_max=20.0
    )
    limits = WaveformLimits(300.0, "diode-neutral", 20.0)
    settings = replace(catalogue.load("paper002-phase-waveforms").waveform, form="table")
    fit = fit_phases(machine, limits, settings)
    star = fit_phases(machine, replace(limits, topology="three-wire"), settings)
    assert fit.reference.torque_max == star.reference.torque_max
    largest = np.max(np.abs(unit_currents(machine, "dqx")))
    assert fit.reference.torque_max == pytest.approx(20.0 / largest, rel=1e-5)
