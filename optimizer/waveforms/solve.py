"""The phase currents that a design asks for."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.optimizer.waveforms.comparison import (
    limits_of,
    require_phases,
)
from dqforge.optimizer.waveforms.firmware_fit import PhaseFit, fit_phases
from dqforge.optimizer.waveforms.salient_reference import fit_salient_phases


@on_design("waveform")
def solve_phases(design: Design) -> PhaseFit:
    """Phase currents per torque of a design whose machine has a non-sinusoidal back-EMF."""
    machine, limits = require_phases(design), limits_of(design, design.waveform, 0.0)
    if isinstance(machine, SalientPhaseMachine):
        return fit_salient_phases(machine, limits, design.waveform)
    return fit_phases(machine, limits, design.waveform)
