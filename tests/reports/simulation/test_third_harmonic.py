"""A machine of model: waveform on the third harmonic of its sum voltage, in the loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.solution import solve
from dqforge.reports.run import export_design
from dqforge.reports.simulation.design_run import simulate_design

RUN = """simulation={duration: 1.1 s,
  speed: {points: [{time: 0 s, speed: 0 rpm}, {time: 0.5 s, speed: 750 rpm},
                   {time: 0.7 s, speed: 750 rpm}, {time: 0.9 s, speed: 1000 rpm}], shape: linear},
  load: {points: [{time: 0 s, torque: 0 N m}, {time: 0.6 s, torque: 0.3 N m}]},
  encoder: {lines: 1024}, sensorless: {above: 500 rpm}}"""


def waves(run: str = RUN) -> Design:
    return catalogue.load(
        "paper002-phase-waveforms",
        [
            "inverter.topology=three-wire",
            "control.observer={method: third-harmonic}",
            "control.speed_loop={method: bandwidth, bandwidth: 12 rad/s}",
            "export.control=float32",
            run.replace("\n", " "),
        ],
    )


@pytest.mark.slow
@pytest.mark.parametrize("way", [1, -1])
def test_it_runs_on_the_sum_voltage_once_it_turns(way: int) -> None:
    run_text = RUN
    if way < 0:
        for text in ("speed: 750", "speed: 1000", "torque: 0.3"):
            run_text = run_text.replace(text, text.replace(": ", ": -"))
    design = waves(run_text)
    found = simulate_design(design)
    run = found.run
    alone = run.sensorless > 0.5
    assert np.mean(alone) > 0.5
    assert np.all(np.diff(alone.astype(int)) >= 0)  # it never falls back to the encoder
    # Within the ramps the loop lags by the acceleration over the square of its pole.
    last = run.t > 1.05
    assert np.max(np.abs(found.angle_error[last])) < math.radians(4.0)
    assert np.max(np.abs(found.angle_error[alone])) < math.radians(25.0)
    assert np.mean(run.omega_m[last]) == pytest.approx(way * 1000.0 * math.pi / 30.0, rel=0.1)


@pytest.mark.slow
def test_its_header_equals_its_model() -> None:
    output = export_design(waves(), verify=True)
    assert output.verification is not None
    text = output.files["pmsm002w_observer.h"].decode()
    assert "third_harmonic_step(" in text
    assert "sum" in text


def test_a_hand_over_below_its_range_is_refused() -> None:
    slow = RUN.replace("above: 500 rpm", "above: 300 rpm")
    with pytest.raises(NoSolutionError, match=r"holds from 3\d\d\.?\d* rpm on"):
        solve(waves(slow))
