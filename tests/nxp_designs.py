"""Designs for the target of NXP: a scooter's hub motor, with keys changed."""

from __future__ import annotations

from pathlib import Path

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.optimizer.control_design.gain_set import gains_or_reason
from dqforge.optimizer.firmware.firmware_method import Asked, asked

SCOOTER = """dqforge: 1
name: {name}
machine:
  model: linear
  pole_pairs: 15
  resistance: {{value: 100 mOhm, kind: line-to-line}}
  inductance_d: {{value: 200 uH, kind: line-to-line}}
  inductance_q: {{value: {inductance_q}, kind: line-to-line}}
  back_emf_constant: {{value: 60 rpm/V, kind: line-to-line peak}}
  max_current: {{value: 40 A, kind: rms}}
  max_speed: 2500 rpm
  inertia: 0.02 kg m^2
inverter:
  v_dc: 48 V
  switching_frequency: 20 kHz
{inverter}control:
  current_loop: {{method: bandwidth, bandwidth: 1000 Hz{loop}}}
  speed_loop: {{method: bandwidth, bandwidth: 15 Hz}}
"""


def design_of(
    folder: Path,
    *,
    name: str = "hub motor",
    inductance_q: str = "200 uH",
    inverter: str = "",
    loop: str = "",
) -> Design:
    """The design with these keys."""
    path = folder / "scooter.yaml"
    more = f", {loop}" if loop else ""
    text = SCOOTER.format(name=name, inductance_q=inductance_q, inverter=inverter, loop=more)
    path.write_text(text, encoding="utf-8")
    return load_design(path)


def asked_for(design: Design) -> Asked:
    """What the design asks of a firmware."""
    gains, reason = gains_or_reason(design)
    assert gains is not None, reason
    return asked(design, gains.i_d, gains.i_q, gains.speed)
