"""Designs built by hand for the tests, without any file."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    ExportSettings,
    FitSettings,
    LoadPoint,
    LossSettings,
    ObserverSettings,
    OperationSettings,
    PerUnitBases,
    SpeedLoopSettings,
    Tolerances,
    WaveformSettings,
)
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.machine_budget import NO_EXTRA_LOSS
from dqforge.machines.names import Strategy
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import CurrentReference

IPM = LinearMachine(
    pole_pairs=4,
    r_s=2e-3,
    l_d=350e-6,
    l_q=592e-6,
    psi_pm=0.1049,
    i_max=283.0,
    inertia=0.05,
    omega_m_max=942.478,
)
INVERSE_SALIENT = LinearMachine(
    pole_pairs=3, r_s=0.1, l_d=2e-3, l_q=1e-3, psi_pm=0.1, i_max=80.0, inertia=1e-3
)
SURFACE = LinearMachine(
    pole_pairs=3, r_s=0.1, l_d=1e-3, l_q=1e-3, psi_pm=0.1, i_max=50.0, inertia=1e-3
)
RELUCTANCE = LinearMachine(
    pole_pairs=2, r_s=0.54, l_d=41.5e-3, l_q=6.2e-3, psi_pm=0.0, i_max=22.0, inertia=1e-2
)
MOSFET = SwitchDevice("mosfet", 9.5e-3, 0.86e-3, 0.86e-3, 206.5, 500.0, 0.306)


def make_design(
    machine: LinearMachine = IPM,
    *,
    strategy: Strategy = "mtpa",
    fit: FitSettings | None = None,
    name: str = "test drive",
    prefix: str = "drive",
    vectors: int = 256,
) -> Design:
    """A complete design around a machine: 100 kHz control, a MOSFET inverter at 500 V,
    one point of comparison.
    """
    has_magnet = machine.psi_pm > 0.0
    control = ControlSettings(
        t_s=1e-5,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=6283.0),
        speed_loop=SpeedLoopSettings(),
        observer=ObserverSettings(500.0) if has_magnet else None,
        bases=PerUnitBases(machine.i_max, 288.675, 942.0, 240.0),
    )
    losses = LossSettings(
        (LoadPoint(5.0, 300.0),), strategies=("id0", "mtpa") if has_magnet else ("mtpa",)
    )
    return Design(
        name=name,
        about="made by the tests",
        machine=machine,
        machine_loss=NO_EXTRA_LOSS,
        phase_machine=None,
        inverter=Inverter(500.0, 100e3, MOSFET, 64.0),
        control=control,
        operation=OperationSettings(strategy),
        fit=replace(fit if fit is not None else FitSettings(), full_scale=(240.0, machine.i_max)),
        losses=losses,
        waveform=WaveformSettings(),
        export=ExportSettings(prefix, vectors),
        values=(),
        assumptions=(),
        digest="ab" * 32,
    )


def in_floats(fit: ReferenceFit) -> CurrentReference:
    """The reference of a fit that is known to be in single precision."""
    assert isinstance(fit.reference, CurrentReference)
    return fit.reference


def within_a_percent(design: Design) -> Design:
    """A design whose loops hold near its data: on some observers none holds at the corners of the
    usual tolerances, and their code can be tried all the same.
    """
    return replace(design, control=replace(design.control, tolerances=Tolerances(r_s=0.01)))


def on_observer(design: Design, observer: ObserverSettings) -> Design:
    """A design on a position observer, its speed loop by the optimum with the observer's lag."""
    loop = design.control.speed_loop
    if loop is not None:
        loop = replace(
            loop,
            method="symmetrical-optimum",
            kp=None,
            ki=None,
            spread=8.0,
            counts_observer=True,
            q_formats=None,
        )
    return replace(design, control=replace(design.control, observer=observer, speed_loop=loop))
