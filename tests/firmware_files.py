"""The scooter's drive as a design file, and what every firmware is given of it."""

from __future__ import annotations

from functools import cache

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.reports.firmware.written_files import firmware_files

SCOOTER = """dqforge: 1
name: E-scooter hub motor
machine:
  pole_pairs: 15
  resistance: {value: 100 mOhm, kind: line-to-line}
  inductance_d: {value: 200 uH, kind: line-to-line}
  inductance_q: {value: 200 uH, kind: line-to-line}
  back_emf_constant: {value: 60 rpm/V, kind: line-to-line peak}
  max_current: {value: 40 A, kind: rms}
  max_speed: 2000 rpm
  inertia: 0.01 kg m^2
inverter:
  v_dc: 48 V
  switching_frequency: 20 kHz
  current_sensing: {shunt: 0.5 mOhm, gain: 20, reference: 3.3 V, bits: 12}
control:
  current_loop: {method: bandwidth, bandwidth: 400 Hz}
  speed_loop: {method: bandwidth, bandwidth: 10 Hz, ratio: 20}
export: {prefix: scooter}
"""


def scooter(*settings: str) -> Design:
    """The design, with keys set."""
    return load_text(SCOOTER.encode(), "scooter.yaml", settings=settings)


@cache
def scooter_fit(name: Firmware) -> FirmwareFit:
    """What a firmware is given of it."""
    design = scooter()
    return solve_firmware(design, solve_gains(design), [name])[0]


@cache
def scooter_files(name: Firmware) -> dict[str, bytes]:
    """Its files for a firmware, by name."""
    return firmware_files(scooter(), scooter_fit(name))
