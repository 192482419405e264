"""The documentation's figure of the design of the control of machines with any back-EMF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.phase_control.design import PhaseLoops
from dqforge.optimizer.phase_control.limited_shapes import limited_deviation, limited_torques
from dqforge.optimizer.phase_control.phase_controller import PHASES, limit_at, reference_currents
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    new_figure,
    save,
    style,
)

_DRIVE = "paper002-phase-waveforms"
_LINK = 170.0
_SHOWN = (0.0, 0.4, 1.0)


def torque_and_currents(path: Path) -> None:
    """Largest torques over the speed at a link that binds, and the current of a phase there."""
    loops = _loops()
    control, limited, table = loops.control, loops.control.limited, loops.control.torque_limit
    if limited is None or table is None:
        raise ValueError("the link of the figure binds")
    omega = np.linspace(0.0, limited.omega_e[-1], 600)
    rpm = omega * 30.0 / np.pi / control.pole_pairs
    with style():
        drawing = new_figure(
            "phase-design", 3.0, "Largest torque over the speed with and without limited waveforms."
        )
        left, right = drawing.subplots(1, 2)
        for share, line in ((1.0, "-"), (0.85, "--")):
            link = np.full(omega.size, share * _LINK)
            label = f"{share * _LINK:.0f} V"
            _, most = limited_torques(limited, omega, link)
            left.plot(rpm, most, line, color=ORANGE, label=f"waveforms, {label}")
            left.plot(rpm, limit_at(table, omega, link), line, color=BLUE, label=f"plain, {label}")
        left.set_xlabel("Speed in rpm")
        left.set_ylabel("Largest torque in N m")
        left.legend()
        speed, theta = np.array(1.05 * limited.omega_e[0]), np.linspace(0.0, 2.0 * np.pi, 721)
        plain, most = limited_torques(limited, speed, np.array(_LINK))
        for share, colour in zip(_SHOWN, (MUTED, BLUE, ORANGE), strict=True):
            torque = plain + share * (most - plain)
            away = limited_deviation(limited, 1, torque, speed, np.array(_LINK), theta)
            current = PHASES @ (torque * reference_currents(control, theta, speed) + away)
            right.plot(np.degrees(theta), current[0], color=colour, label=f"{torque:.2f} N m")
        right.axhline(0.0, color=INK, linewidth=0.5)
        right.set_xlabel("Electrical angle in deg")
        right.set_ylabel("Current of phase a in A")
        right.legend()
        drawing.tight_layout()
    save(drawing, path)


def _loops() -> PhaseLoops:
    """The four-leg drive of paper 002 on a link that its torque outgrows."""
    settings = [f"inverter.v_dc={_LINK:.0f} V", "control.current_loop.limited_waveforms=true"]
    found = solve_gains(load_text(catalogue.read_text(_DRIVE), _DRIVE, None, settings)).phases
    if found is None:
        raise ValueError("the drive of the figure is a phase machine")
    return found
