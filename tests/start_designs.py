"""Drives without encoder for the tests, as text of design files."""

from __future__ import annotations

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design

TEXT = """
dqforge: 1
name: start
machine:
  pole_pairs: 4
  resistance: 0.36 Ohm
  inductance_d: 1.2 mH
  inductance_q: {l_q} mH
  magnet_flux: 0.05 Wb
  max_current: 10 A
  inertia: 300e-6 kg m^2
  max_speed: 3000 rpm
inverter: {{v_dc: 325 V, switching_frequency: 10 kHz, dead_time: 1 us}}
control:
  speed_loop: {{spread: 8}}
  observer: {{method: flux, speed_gain: 0.7, pll_bandwidth: 500 rad/s}}
  tolerances: {{r_s: 30 %, psi_pm: 4 %, dead_time: 50 %}}
  start_up: {start}
export: {{prefix: drive, control: float32}}
simulation:
  duration: 1 s
  encoder: none
  speed: {{points: [{{time: 0 s, speed: 1200 rpm}}]}}
  load: {{points: [{{time: 0 s, torque: 0.5 N m}}]}}
"""

INJECTION = "{observer: {method: injection}}"


def start_text(start: str = "{}", l_q: float = 1.2) -> str:
    """A design file with a section ``control.start_up`` and L_q in mH."""
    return TEXT.format(start=start, l_q=l_q)


def start_design(start: str = "{}", l_q: float = 1.2) -> Design:
    """The design of `start_text`."""
    return load_text(start_text(start, l_q).encode(), "start.yaml")
