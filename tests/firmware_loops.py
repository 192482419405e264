"""A scooter's drive and loops with the structures that firmware of others has, written by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from drives import make_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.devices.inverter import CurrentSensing, Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import gains_or_reason
from dqforge.optimizer.firmware.configuration import (
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import METHODS, Asked, FirmwareMethod, asked, judge

# 48 V, 60 rpm/V (line to line, peak), 100 mOhm and 200 uH line to line, 15 pole pairs, 40 A rms.
PSI = 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * 15 * 60.0)
MACHINE = LinearMachine(15, 0.05, 1e-4, 1e-4, PSI, 40.0 * math.sqrt(2.0), 1e-3, 1e-4, 260.0)
INVERTER = Inverter(48.0, 20e3, current_sensing=CurrentSensing(0.5e-3, 20.0, 3.3, 12))
VALUES = DriveValues(
    15, 0.05, 1e-4, 1e-4, PSI, 1e-3, 1e-4, MACHINE.i_max, None, 48.0, 20e3, 0.0, 50e-6, 1e-3
)
CONSTANT = 1.5 * 15 * PSI  # N m/A


def scooter() -> Design:
    """The design of the drive."""
    design = make_design(MACHINE)
    return replace(design, inverter=INVERTER, control=replace(design.control, t_s=50e-6))


def current_pi(t_s: float, bandwidth: float, **changes: Any) -> PiController:
    """A current controller whose zero cancels the winding's pole; ``bandwidth`` in rad/s."""
    return replace(PiController(bandwidth * 1e-4, bandwidth * 0.05, t_s), **changes)


def speed_pi(t_s: float, crossover: float, spread: float = 16.0, **changes: Any) -> PiController:
    """A speed controller that crosses over at ``crossover`` rad/s, its zero ``spread`` times
    lower.
    """
    kp = crossover * 1e-3 / CONSTANT
    return replace(PiController(kp, kp * crossover / spread, t_s), **changes)


FAST = 2.0 * math.pi * 1000.0
SPEED = 2.0 * math.pi * 30.9


def vesc(pll_ki: float = 3e4) -> LoopProfile:
    """Backward Euler, d first, the whole excess taken back, a PLL with two real poles."""
    t_s = 50e-6
    pi = current_pi(t_s, FAST, anti_windup="back-calculation", tracking=1.0 / t_s)
    speed = SpeedController(speed_pi(1e-3, SPEED), SpeedEstimate("pll", t_s, 2000.0, pll_ki))
    loops = CurrentLoops(pi, pi, order="d-first", voltage_share=0.95)
    return LoopProfile("vesc", "hand", loops, speed, reference="mtpa-linear")


def simplefoc() -> LoopProfile:
    """Trapezoids with clamped integrals, each axis by itself, filters on currents and speed."""
    t_s = 100e-6
    pi = current_pi(t_s, 1500.0, rule="trapezoid", limit=27.7, filter_time=1e-4)
    speed = SpeedController(
        speed_pi(t_s, 40.0, rule="trapezoid", limit=40.0),
        SpeedEstimate("low-pass", t_s, filter_time=5e-3),
    )
    return LoopProfile("simplefoc", "hand", CurrentLoops(pi, pi, order="axes"), speed)


def moteus() -> LoopProfile:
    """Forward Euler, held integrals, back-EMF fed forward."""
    t_s = 1.0 / 30e3
    pi = current_pi(t_s, 2.0 * math.pi * 400.0, rule="integral-last", anti_windup="hold")
    speed = SpeedController(
        speed_pi(t_s, 60.0, anti_windup="hold"), SpeedEstimate("difference", t_s, samples=8)
    )
    loops = CurrentLoops(pi, pi, back_emf=True, order="axes", voltage_share=0.9)
    return LoopProfile("moteus", "hand", loops, speed)


def odrive() -> LoopProfile:
    """Forward Euler after a delay of 1.5 periods, the angle advanced, the vector shortened."""
    t_s = 125e-6
    pi = current_pi(t_s, 1000.0, rule="integral-last", anti_windup="none")
    speed = SpeedController(speed_pi(t_s, 40.0), SpeedEstimate("pll", t_s, 2000.0, 1e6))
    loops = CurrentLoops(pi, pi, delay=1.5, angle_advance=2.0, voltage_share=0.8)
    return LoopProfile("odrive", "hand", loops, speed)


def nxp() -> LoopProfile:
    """Trapezoids with limits of their own, a filtered speed, a ramp."""
    t_s = 100e-6
    pi = current_pi(t_s, 2.0 * math.pi * 280.0, rule="trapezoid")
    speed = SpeedController(
        speed_pi(1e-3, 60.0, rule="trapezoid"),
        SpeedEstimate("pll", t_s, 800.0, 4e5),
        ramp=500.0,
    )
    loops = CurrentLoops(pi, pi, order="d-first", voltage_share=0.9)
    return LoopProfile("nxp", "hand", loops, speed)


def st() -> LoopProfile:
    """Clamped integrals, the vector shortened, the speed as a mean over 16 periods."""
    t_s = 50e-6
    pi = current_pi(t_s, 4500.0, limit=27.7)
    speed = SpeedController(
        speed_pi(1e-3, 60.0, limit=50.0), SpeedEstimate("difference", t_s, samples=16)
    )
    return LoopProfile("st", "hand", CurrentLoops(pi, pi, voltage_share=0.95), speed)


def ti() -> LoopProfile:
    """Both voltages fed forward, d first, no delay but that of the half period."""
    t_s = 100e-6
    pi = current_pi(t_s, 1500.0)
    speed = SpeedController(speed_pi(1e-3, 40.0), SpeedEstimate("low-pass", t_s, filter_time=2e-3))
    loops = CurrentLoops(
        pi, pi, delay=0.5, cross=True, back_emf=True, order="d-first", angle_advance=1.0
    )
    return LoopProfile("ti", "hand", loops, speed)


def infineon() -> LoopProfile:
    """Back-calculation, currents from a table, q first."""
    t_s = 50e-6
    pi = current_pi(t_s, 5000.0, anti_windup="back-calculation", tracking=5000.0)
    speed = SpeedController(
        speed_pi(50e-6, 60.0, anti_windup="back-calculation", tracking=200.0),
        SpeedEstimate("pll", t_s, 1000.0, 2.5e5),
    )
    loops = CurrentLoops(pi, pi, cross=True, back_emf=True, order="q-first", angle_advance=1.5)
    table = ((0.0, 0.0, 0.0), (30.0, -1.0, 29.9), (60.0, -4.0, 59.0))
    return LoopProfile("infineon", "hand", loops, speed, reference="table", table=table)


def configured(name: Firmware) -> tuple[LoopProfile, DriveValues]:
    """The loops of a firmware as it is configured for the scooter, and what it is told."""
    design = scooter()
    loops = SpeedLoopSettings("bandwidth", bandwidth=150.0, ratio=20)
    design = replace(design, control=replace(design.control, speed_loop=loops, observer=None))
    gains, reason = gains_or_reason(design)
    assert gains is not None, reason
    method = METHODS[name]
    configuration = method.configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    return method.profile(configuration), configuration.drive


EVERY = (lambda: vesc(1e6), simplefoc, moteus, odrive, nxp, st, ti, infineon)


def assert_current_loops_hold(method: FirmwareMethod, wished: Asked) -> None:
    """The current loops of what a firmware is given are stable, with the phase margin required."""
    held = method.configure(wished)
    judged = judge(method.profile(replace(held, speed=None)), wished.drive)
    for loop in (judged.current_d, judged.current_q):
        assert loop is not None
        assert loop.stable
        assert loop.phase_margin >= wished.design.control.current_loop.min_phase_margin
