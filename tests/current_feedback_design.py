"""A small design whose current loop switches the bridge itself, quick to simulate."""

from __future__ import annotations

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design

TEXT = """
dqforge: 1
name: feedback
machine:
  model: linear
  pole_pairs: 3
  resistance: {value: 0.8 Ohm, kind: phase}
  inductance_d: {value: 4 mH, kind: phase}
  inductance_q: {value: 6 mH, kind: phase}
  magnet_flux: {value: 0.1 Wb, kind: peak}
  max_current: {value: 10 A, kind: peak}
  max_speed: 5000 rpm
  inertia: 1e-3 kg m^2
  friction: 1e-4 N m s
inverter:
  v_dc: 400 V
  switching_frequency: 3 kHz
  device:
    kind: igbt
    on_resistance: 40 mOhm
    on_voltage: 0.9 V
    diode_voltage: 0.8 V
    diode_resistance: 30 mOhm
    turn_on_energy: 0.3 mJ
    turn_off_energy: 0.2 mJ
    reverse_recovery_energy: 0.1 mJ
    reference_current: 10 A
    reference_voltage: 300 V
    thermal_resistance: 1 K/W
control:
  current_loop: {method: METHOD}
  speed_loop: {method: symmetrical-optimum}
losses:
  points: [{torque: 2 N m, speed: 4000 rpm}]
  modulations: [svpwm, ddt-gdpwm]
  strategies: [mtpa]
export:
  prefix: fb
"""


SIMULATION = """
simulation:
  duration: 0.4 s
  speed: {points: [{time: 0 s, speed: 1000 rpm}]}
"""


def feedback_design(method: str, *settings: str, simulated: bool = False) -> Design:
    """The design with a method, keys that are set, and a simulation."""
    text = (TEXT.replace("METHOD", method) + (SIMULATION if simulated else "")).encode()
    return load_text(text, "feedback.yaml", settings=settings)
