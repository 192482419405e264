"""What a report says of its machine is true for this machine."""

from __future__ import annotations

from dataclasses import replace

import pytest
from drives import make_design

from dqforge.machines.design import catalogue
from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.optimizer.solution import solve
from dqforge.reports.report import convention_lines, machine_lines

CONSTANT = "Inductances are constant: saturation is not part of the model."


def said(name: str) -> str:
    return " ".join(machine_lines(catalogue.load(name)))


def test_constant_inductances_are_said_of_linear_machines_alone() -> None:
    assert CONSTANT in said("paper000-ipmsm-100kw")
    for name in ("baldor-pmsyrm-5k6", "abb-syrm-6k7-saturated"):
        assert "saturation is part of the model" in said(name)
        assert "constant" not in said(name)
    salient = said("salient-phase-waveforms")
    assert "Inductances vary with the angle of the rotor" in salient
    assert "harmonics of the design" in salient
    assert "harmonics" in said("paper002-phase-waveforms")
    assert "harmonics" not in said("paper002-pmsm-nonsinusoidal")


@pytest.mark.parametrize("loss", [MachineLoss(hysteresis=1e-3), MachineLoss(eddy=1e-3)])
def test_iron_loss_is_denied_only_where_there_is_none(loss: MachineLoss) -> None:
    design = make_design()
    assert "The design gives no iron loss, and none is counted." in machine_lines(design)
    lossy = machine_lines(replace(design, machine_loss=loss))
    assert not any("no iron loss" in line for line in lossy)
    assert any(line.startswith("Iron loss is counted") for line in lossy)


def test_axes_and_controllers_are_those_of_the_machine() -> None:
    solution = solve(make_design())
    lines = [str(line) for line in convention_lines(solution)]
    assert any("The d axis lies along the magnet flux" in line for line in lines)
    assert any("PI controllers" in line for line in lines)
    plain = replace(solution, design=catalogue.load("abb-syrm-6k7"), loops=None)
    lines = [str(line) for line in convention_lines(plain)]
    assert any("no magnets; the d axis is that of the greater inductance" in line for line in lines)
    assert not any("PI controllers" in line or "magnet flux" in line for line in lines)
