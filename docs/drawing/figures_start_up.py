"""Figures of the page on starts without encoder."""

from __future__ import annotations

from pathlib import Path

from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.reports.pages.figures_style import save
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.simulation.tables import plot_simulation

_DESIGN = b"""
dqforge: 1
name: start
machine:
  pole_pairs: 3
  resistance: 3.6 Ohm
  inductance_d: 36 mH
  inductance_q: 51 mH
  magnet_flux: 0.545 Wb
  max_current: 9 A
  inertia: 0.015 kg m^2
  max_speed: 1500 rpm
inverter: {v_dc: 540 V, switching_frequency: 8 kHz, dead_time: 2 us}
control:
  current_loop: {method: bandwidth, bandwidth: 200 Hz}
  speed_loop: {}
  observer: {method: flux}
  tolerances: {r_s: 30 %, psi_pm: 4 %, dead_time: 50 %}
  start_up: {method: i-f, load_torque: 4 N m}
export: {prefix: start, control: float32}
simulation:
  duration: 5 s
  stop: 4.2 s
  dead_time: 1 us
  encoder: none
  speed:
    points:
      - {time: 0 s, speed: 700 rpm}
      - {time: 2 s, speed: 60 rpm}
      - {time: 2.6 s, speed: -700 rpm}
  load: {points: [{time: 0 s, torque: 4 N m}]}
  initial: {angle: 200 deg}
  current_sensor: {noise: 0.03 A}
"""


def start_and_back(path: Path) -> None:
    """A start by a current that turns, a hand-over back and forth, a reversal and a stop."""
    design = load_text(_DESIGN, "start-up.yaml")
    save(plot_simulation(simulate_design(design)), path)


def start_on_the_third_harmonic(path: Path) -> None:
    """The shipped drive that runs on the third harmonic of its phase voltages, there and back."""
    folder = Path(__file__).resolve().parents[2] / "examples"
    design = load_design(folder / "third-harmonic-start.yaml")
    save(plot_simulation(simulate_design(design)), path)
