"""What a mistake in a measured constant does to the drive of a hub motor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.plants import current_loop, current_step
from dqforge.optimizer.observers.parts import steady_observer
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.sampled_systems import loop_margins

HUB = """\
dqforge: 1
name: Scooter hub
machine:
  pole_pairs: 15
  resistance: 100 mOhm line-to-line
  inductance: 200 uH line-to-line
  kv: 60
  max_current: 40 A rms
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control: {observer: {method: flux}}
"""

# Factors on resistance, inductance and magnet flux linkage.
MISTAKES = {
    "nothing": (1.0, 1.0, 1.0),
    "resistance 10 % too large (leads, a warm winding)": (1.1, 1.0, 1.0),
    "resistance 25 % too small (the winding is 85 K warmer in use)": (0.75, 1.0, 1.0),
    "resistance doubled (line-to-line taken as phase)": (2.0, 1.0, 1.0),
    "inductance 30 % too large (less at full current)": (1.0, 1.3, 1.0),
    "inductance 30 % too small (measured at 100 kHz)": (1.0, 0.7, 1.0),
    "inductance doubled (line-to-line taken as phase)": (1.0, 2.0, 1.0),
    "inductance four times (doubled, and in use half)": (1.0, 4.0, 1.0),
    "magnet flux 5 % too large": (1.0, 1.0, 1.05),
    "magnet flux 1.73 times (line-to-line taken as phase)": (1.0, 1.0, np.sqrt(3.0)),
}
SHARES = np.array([0.05, 0.5])


def measuring() -> Iterator[tuple[str, ...]]:
    """Margins and overshoot of the q current, torque for what the firmware takes as its largest
    one, steady angle error of the flux observer under half the largest torque.
    """
    true = load_text(HUB.encode(), "hub.yaml")
    machine = linearised(true.machine)
    yield (
        "wrong is",
        "phase margin",
        "overshoot",
        "torque",
        "angle at 5 % of the speed",
        "angle at 50 %",
    )
    for name, (resistance, inductance, flux) in MISTAKES.items():
        believed = replace(
            machine,
            r_s=resistance * machine.r_s,
            l_d=inductance * machine.l_d,
            l_q=inductance * machine.l_q,
            psi_pm=flux * machine.psi_pm,
        )
        design = replace(true, machine=believed)
        yield (name, *_loop(design, machine), f"{100.0 / flux:.0f} %", *_angles(design, machine))


def _loop(design: Design, machine: LinearMachine) -> tuple[str, str]:
    """Phase margin and overshoot of the design's q current on the machine."""
    i_q = solve_gains(design).i_q
    loop = current_loop(machine.r_s, machine.l_q, i_q.t_s, i_q.kp, i_q.ki)
    if np.max(np.abs(loop.closed.poles)) >= 1.0:
        return "unstable", "grows"
    margin = np.degrees(loop_margins(loop.open_loop).phase_margin)
    peak = float(np.max(current_step(loop, 400).reference)) - 1.0
    return f"{margin:.0f} deg", f"{max(100.0 * peak, 0.0):.0f} %"


def _angles(design: Design, machine: LinearMachine) -> Iterator[str]:
    """Steady angle errors of the design's observer on the machine."""
    _, observer = solve_observer(design)
    assert observer is not None
    omega = SHARES * design.v_max / machine.psi_pm
    current = np.full(len(omega), complex(0.0, 0.5 * machine.i_max))
    found = steady_observer(
        observer.method,
        observer.gains,
        observer.t_s,
        plants(machine, count=len(omega)),
        current,
        omega,
    )
    holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)
    for error, held in zip(found.theta_error, holds, strict=True):
        yield f"{np.degrees(error) + 0.0:.1f} deg" if held else "lost"
