"""Drives whose voltage limits them, with bases for fixed point."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.field_weakening.voltage_region import VoltageRegion, voltage_region
from dqforge.optimizer.fixed_control.design import dc_link
from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit, fit_line, fit_mesh
from dqforge.optimizer.operating_points.solve import current_choice

RPM = np.pi / 30.0
SERVO = LinearMachine(
    pole_pairs=4, r_s=0.09, l_d=1e-4, l_q=1e-4, psi_pm=6.4e-3, i_max=15.0, inertia=1e-6
)
SMALL_IPM = LinearMachine(
    pole_pairs=3, r_s=1.1, l_d=3e-3, l_q=6e-3, psi_pm=0.05, i_max=8.0, inertia=1e-5
)

# Machine, phase voltage in V and mechanical speed in rad/s. R i is 0.6, 10, 10, 21, 18, 4, 13 and
# 3 % of the voltage.
CASES: dict[str, tuple[Machine, float, float]] = {
    "interior": (IPM, 91.9, 300.0),
    "servo": (SERVO, 13.86, 5000.0 * RPM),
    "servo with mtpv": (replace(SERVO, l_d=4e-4, l_q=4e-4), 13.86, 5000.0 * RPM),
    "small ipm": (SMALL_IPM, 41.57, 4200.0 * RPM),
    "inverse": (INVERSE_SALIENT, 45.0, 300.0),
    "reluctance": (RELUCTANCE, 300.0, 300.0),
    "syrm": (catalogue.load("abb-syrm-6k7-saturated").machine, 140.6, 300.0),
    "pmsyrm": (catalogue.load("baldor-pmsyrm-5k6").machine, 372.0, 300.0),
}
SATURATED = ("syrm", "pmsyrm")


@cache
def domain(name: str) -> VoltageRegion:
    machine, volts, speed = CASES[name]
    return voltage_region(machine, machine.i_max, volts, speed)


@cache
def weakened_design(name: str) -> Design:
    """A drive whose bases leave a fifth of room."""
    machine, volts, speed = CASES[name]
    design = make_design(IPM)
    torque = domain(name).flux.torque_max
    bases = replace(
        design.control.bases,
        current=1.25 * machine.i_max,
        voltage=1.25 * volts,
        speed=1.2 * speed,
        torque=1.1 * torque,
    )
    return replace(
        design,
        machine=machine,
        inverter=replace(design.inverter, v_dc=volts * np.sqrt(3.0)),
        control=replace(design.control, bases=bases),
        weakening=WeakeningSettings(speed),
    )


@cache
def weakened_fit(name: str, width: int) -> FixedReferenceFit:
    design = weakened_design(name)
    return fit_mesh(design, domain(name), np.inf, width, dc_link(design, width))


@cache
def line_fit(name: str, width: int) -> FixedReferenceFit:
    """The reference of the torque alone of the same drive."""
    design = weakened_design(name)
    most = domain(name).flux.torque_max
    return fit_line(design, current_choice(design), most, 0.0, width)
