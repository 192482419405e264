"""Six-step drives as design files, for tests."""

from __future__ import annotations

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design

BENCH = """
dqforge: 1
name: six-step bench
machine:
  model: linear
  pole_pairs: 3
  resistance: 2.35 Ohm
  inductance_d: 1.675 mH
  inductance_q: 1.675 mH
  magnet_flux: {value: 0.06 Wb, kind: peak}
  max_current: {value: 6.4 A, kind: peak}
  max_speed: 5420 rpm
  inertia: 200e-6 kg m^2
  friction: 40e-6 N m s
inverter:
  v_dc: 214 V
  switching_frequency: 20 kHz
  dead_time: 0 s
control:
  speed_loop: {ratio: 10}
  observer: {method: zero-crossing}
simulation:
  duration: 0.12 s
  torque: {points: [{time: 0 s, torque: 0.5 N m}]}
  shaft: {points: [{time: 0 s, speed: 1500 rpm}]}
export: {prefix: six}
"""


def bench(*settings: str, text: str = BENCH) -> Design:
    """The drive with keys set as on the command line."""
    return load_text(text.encode(), "six.yaml", settings=settings)
