"""The emitted control of a machine whose two pole pairs differ, in the simulated drive."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.simulation.recorded_run import Simulation

DESIGN = """\
dqforge: 1
name: Two pole pairs
machine:
  model: waveform
  pole_pairs: 2
  resistance: {value: 1 Ohm, kind: phase}
  self_inductance: {value: 7 mH, kind: phase}
  mutual_inductance: -1 mH
  back_emf:
    harmonics:
      - {order: 1, amplitude: {value: 0.2 Wb, kind: peak}}
      - {mechanical_order: 1, share: 10 %}
      - {mechanical_order: 3, share: 5 %, phase: 30 deg}
  max_current: {value: 6 A, kind: peak}
  max_speed: 1800 rpm
  inertia: 1.5e-3 kg m^2
inverter:
  {v_dc: 220 V, switching_frequency: 10 kHz, topology: TOPOLOGY, dead_time: 1 us}
control: {current_loop: {method: bandwidth, bandwidth: 500 Hz, frame: FRAME}}
waveform: {torque: 1 N m, speed: 750 rpm}
simulation:
  duration: 0.6 s
  torque: {points: [{time: 0 s, torque: 1 N m}]}
  shaft: {points: [{time: 0 s, speed: 750 rpm}]}
export: {prefix: two, control: float32}
"""


def settled(topology: str, frame: str) -> tuple[float, float]:
    """Mean torque in N m, and ripple peak to peak over it, of the last two mechanical turns."""
    text = DESIGN.replace("TOPOLOGY", topology).replace("FRAME", frame)
    run: Simulation = simulate_design(load_text(text.encode(), "two.yaml")).run
    torque = run.torque[run.t > 0.6 - 2.0 * 60.0 / 750.0]
    return float(np.mean(torque)), float(np.ptp(torque) / np.mean(torque))


@pytest.mark.slow
def test_a_table_over_the_mechanical_turn_keeps_the_torque() -> None:
    mean, ripple = settled("four-leg", "table")
    assert mean == pytest.approx(1.0, rel=1e-3)
    assert ripple < 0.006


@pytest.mark.slow
@pytest.mark.parametrize(
    ("topology", "frame", "least", "most"),
    [
        ("four-leg", "dq", 0.19, 0.21),
        ("four-leg", "dqx", 0.0, 0.02),
        ("four-leg", "dqy", 0.0, 0.02),
        ("three-wire", "dq", 0.19, 0.21),
        ("three-wire", "table", 0.0, 0.006),
    ],
)
def test_frames_of_differing_pole_pairs(
    topology: str, frame: str, least: float, most: float
) -> None:
    """Constant dq currents ripple by 20 % with the mechanical turn."""
    mean, ripple = settled(topology, frame)
    assert mean == pytest.approx(1.0, rel=2e-3)
    assert least <= ripple < most


@pytest.mark.slow
def test_a_salient_machine_runs_on_a_table_over_the_angle() -> None:
    """The library drive at 1 and 3 N m, of which reluctance makes a part; constant dq currents
    ripple by 4 %.
    """
    run = simulate_design(catalogue.load("salient-phase-waveforms")).run
    turn = 60.0 / 750.0
    for end, torque, ripple in ((0.3, 1.0, 0.008), (0.6, 3.0, 0.004)):
        made = run.torque[(run.t > end - 2.0 * turn) & (run.t < end)]
        assert np.mean(made) == pytest.approx(torque, rel=2e-3)
        assert np.ptp(made) / torque < ripple
