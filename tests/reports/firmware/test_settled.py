"""What does not settle is refused, with the reason; one program tries them all."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from firmware_files import scooter, scooter_fit

from dqforge.machines.design import catalogue
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.configuration import DriveValues, LoopProfile
from dqforge.optimizer.firmware.solve import solve_firmware
from dqforge.reports.firmware import design_made
from dqforge.reports.firmware.target import firmware_simulator
from dqforge.reports.simulation.recorded_run import Simulator


def test_all_firmware_shares_one_program(monkeypatch: pytest.MonkeyPatch) -> None:
    names: tuple[Firmware, ...] = ("vesc", "odrive", "infineon")
    made: list[str] = []
    told: list[str] = []

    @contextmanager
    def counted(profile: LoopProfile, values: DriveValues) -> Iterator[Simulator]:
        made.append(profile.firmware)
        with firmware_simulator(profile, values) as program:
            yield program

    monkeypatch.setattr(design_made, "firmware_simulator", counted)
    fits = [scooter_fit(name) for name in names]
    verdicts = list(design_made.settling_verdicts(scooter(), fits, told.append))
    assert made == ["vesc"]
    assert told == [verdict.firmware for verdict in verdicts] == list(names)
    # The program of another firmware gives what its own gives, to the last bit.
    alone = design_made.require_settling(scooter(), fits[1])
    assert repr(verdicts[1]) == repr(alone)  # a period that is nan equals none


@pytest.mark.slow
def test_a_refusal_names_what_is_wrong_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = scooter_fit("vesc")
    assert any("whose own lag" in remark for remark in fit.judged.remarks)
    slow = replace(fit, judged=replace(fit.judged, faults=("the PLL is slow",)))
    verdict = design_made.require_settling(scooter(), fit)
    failed = replace(
        verdict.tried[0], answer=replace(verdict.tried[0].answer, outcome="divergence")
    )
    monkeypatch.setattr(design_made, "settles", lambda *_, **__: replace(verdict, tried=(failed,)))
    for one, words in ((fit, "leaves all bounds; write control"), (slow, "; the PLL is slow; ")):
        with pytest.raises(NoSolutionError) as refused:
            design_made.require_settling(scooter(), one)
        assert words in refused.value.message
        assert "whose own lag" not in refused.value.message


def test_a_refusal_names_a_speed_loop_that_settles() -> None:
    """As fast as the samples permit is too fast for VESC's phase-locked loop."""
    loop = "control={current_loop: {method: magnitude-optimum}, speed_loop: {method: "
    fast = scooter(f"{loop}symmetrical-optimum}}}}")
    fit = solve_firmware(fast, solve_gains(fast), ["vesc"])[0]
    with firmware_simulator(fit.profile, fit.configuration.drive) as program:
        with pytest.raises(NoSolutionError) as refused:
            design_made.require_settling(fast, fit, program)
        words = refused.value.message
        named = re.search(r"method: bandwidth and bandwidth: (\d+) Hz under control.speed", words)
        assert named is not None
        assert "write control.firmware" not in words
        follows = scooter(f"{loop}bandwidth, bandwidth: {named[1]} Hz}}}}")
        slower = solve_firmware(follows, solve_gains(follows), ["vesc"])[0]
        assert design_made.require_settling(follows, slower, program).settles


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "name", "reason"),
    [
        ("baldor-pmsyrm-5k6", "simplefoc", "the speed stays at 126.5 rad/s"),
        ("baldor-pmsyrm-5k6", "moteus", "limit cycle of the speed"),
        ("thor-pmsyrm-5k", "nxp", "limit cycle of the speed"),
        ("paper000-ipmsm-100kw", "odrive", "limit cycle of the speed"),
        ("paper000-ipmsm-100kw", "st", "limit cycle of the speed"),
        ("paper001-pmsm-bench", "moteus", "limit cycle of the speed"),
    ],
)
def test_drives_of_the_library_that_a_firmware_does_not_control(
    drive: str, name: Firmware, reason: str
) -> None:
    sensing = "{shunt: 0.5 mOhm, gain: 10, reference: 3.3 V, bits: 12}"
    design = catalogue.load(drive, (f"inverter.current_sensing={sensing}",) * (name == "st"))
    fit = solve_firmware(design, solve_gains(design), [name])[0]
    with pytest.raises(NoSolutionError, match=reason):
        design_made.require_settling(design, fit)
