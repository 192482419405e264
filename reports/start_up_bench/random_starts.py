"""Random drives as the bench starts them: gains by rule, and a plant that is not what they say."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, fields, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.from_machine import make_design
from dqforge.machines.design.settings import StartUpSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    ElasticBrake,
    PlantErrors,
    Profile,
    Scenario,
    constant,
)
from dqforge.machines.random_drives.random_drive import RandomDrive
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.methods.flux import design as flux_gains
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.tuning_numbers import LARGEST_TURN, ObserverTuning
from dqforge.optimizer.saliency.wave_steps import WaveGains
from dqforge.optimizer.start_up.plan import StartUpPlan, start_up_plan
from dqforge.reports.control.header import gain_bytes
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.plant_input import Drive, RunInput, run_input
from dqforge.reports.start_up.members import settings_bytes
from dqforge.reports.start_up_bench.bench_program import StartInput
from dqforge.reports.steps.observer_text import gains_bytes

# Noise of each current over the rated one, how resistance and flux differ from the data, and the
# share of the dead time that nothing compensates.
PREFIX = "bench"
NOISE, R_ERROR, PSI_ERROR, DEAD_TIME_LEFT = 5e-3, 0.3, -0.04, 0.5
RATIO = 10  # Current samples per sample of the speed controller.
_SPREAD = 3.0
_LOOP = 0.05  # bandwidth of the phase-locked loop times the sampling period
_CROSSOVER = 1.0 / 3.0  # of a current loop by the magnitude optimum, times the sampling period
_SPEED_GAIN, _FASTER = 0.7, 5.0
_LEAST_SPEED = 0.4  # of the rated speed, at which a drive has to be held
_ROWS = 1500
SETTLED = 0.3  # Length in s of the last part of a start, in which everything must hold.


def usual_errors() -> PlantErrors:
    """Resistance and flux as the bench has them."""
    return PlantErrors(r_s=R_ERROR, psi_pm=PSI_ERROR)


@dataclass(frozen=True, slots=True)
class Blocked:
    """A friction that comes during the run: ``load`` in N m from ``time`` in s on."""

    time: float
    load: float


@dataclass(frozen=True, slots=True)
class Conditions:
    """What a start meets.

    Args:
        blocked, brake: What stops the shaft during the run, None for nothing.
        duration: In s; None for that of the start.
        errors: How the plant differs from the data.
        dead_time_left: Share of the dead time that nothing compensates.
        turning: Mechanical speed in rad/s that the shaft has at the beginning.
    """

    blocked: Blocked | None = None
    brake: ElasticBrake | None = None
    duration: float | None = None
    errors: PlantErrors = field(default_factory=usual_errors)
    dead_time_left: float = DEAD_TIME_LEFT
    turning: float = 0.0


def speed_gains(drive: RandomDrive) -> tuple[float, float]:
    """Gains of the speed controller in N m s/rad and N m/rad by the symmetrical optimum, the lag of
    the observer's loop among the delays.

    Args:
        drive: What is driven.
    """
    t_s, inertia = 1.0 / drive.f_s, drive.machine.inertia or 0.0
    delay = t_s / _CROSSOVER + 0.5 * RATIO * t_s + 2.0 * t_s / _LOOP
    kp = inertia / (_SPREAD * delay)
    return kp, kp / (_SPREAD**2 * delay)


def observer_tuning(drive: RandomDrive) -> ObserverTuning:
    """Numbers of the flux observer, five times the usual correction at rest.

    Args:
        drive: What is driven.
    """
    machine = drive.machine
    usual = 0.25 * machine.r_s * (1.0 / machine.l_d + 1.0 / machine.l_q)
    bandwidth = _FASTER * min(usual, 0.02 * drive.omega_rated)
    return ObserverTuning(bandwidth, _LOOP * drive.f_s, speed_gain=_SPEED_GAIN)


def random_design(drive: RandomDrive) -> Design:
    """The design of a random drive; the dead time is what is left of it.

    Args:
        drive: What is driven.
    """
    kp, ki = speed_gains(drive)
    tuning = observer_tuning(drive)
    return make_design(
        drive.machine,
        v_dc=drive.v_dc,
        f_sw=drive.f_s,
        name="Random drive",
        prefix=PREFIX,
        inverter={"dead_time": DEAD_TIME_LEFT * drive.dead_time},
        operation={"strategy": "id0"},
        control={
            "speed_loop": {
                "method": "given",
                "kp": kp,
                "ki": ki,
                "ratio": RATIO,
                "min_phase_margin": math.radians(1.0),
            },
            "observer": {
                "method": "flux",
                "bandwidth": tuning.bandwidth,
                "speed_gain": tuning.speed_gain,
                "pll_bandwidth": tuning.pll_bandwidth,
            },
            "start_up": {"method": "i-f"},
        },
        export={"control": "float32"},
    )


def _pi(kp: float, ki_ts: float) -> list[float]:
    return [kp, ki_ts, min(1.0, ki_ts / kp)]


def control_gains(drive: RandomDrive, template: Mapping[str, object]) -> PlainData:
    """Gains of the control functions: current loops by the magnitude optimum, the speed loop by
    `speed_gains`.

    Args:
        drive: What is driven.
        template: Gains of a design of the same controller, for what all drives share.
    """
    machine, t_s = drive.machine, 1.0 / drive.f_s
    kp, ki = speed_gains(drive)
    current = {
        axis: _pi(inductance / (3.0 * t_s), machine.r_s / 3.0)
        for axis, inductance in (("d", machine.l_d), ("q", machine.l_q))
    }
    return {
        **template,
        **current,
        "speed": _pi(kp, ki * RATIO * t_s),
        "ratio": RATIO,
        "pole_pairs": float(machine.pole_pairs),
        "r_s": machine.r_s,
        "l_d": machine.l_d,
        "l_q": machine.l_q,
        "psi_pm": machine.psi_pm,
        "advance": 1.5 * t_s,
        "torque_max": drive.torque_rated,
    }


def flux_bytes_of(drive: RandomDrive) -> bytes:
    """Bytes of the gains of a drive's flux observer.

    Args:
        drive: What is driven.
    """
    t_s = 1.0 / drive.f_s
    top = min(1.2 * drive.omega_rated, LARGEST_TURN / t_s)
    return gains_bytes(METHODS["flux"], flux_gains(drive.machine, observer_tuning(drive), t_s, top))


def saturation_table(drive: RandomDrive) -> FloatArray:
    """Flux map of one cell: psi_d = psi + L_d (i_d - s i_d^2/(2 I)), psi_q = L_q i_q, as the plant
    reads it.

    Args:
        drive: What is driven.
    """
    machine = drive.machine
    cell = np.zeros((4, 4, 2))  # power of i_q, of i_d, flux (d, q)
    cell[0, 0, 0] = machine.psi_pm
    cell[0, 1, 0] = machine.l_d
    cell[0, 2, 0] = -0.5 * machine.l_d * drive.saturation / machine.i_max
    cell[1, 0, 1] = machine.l_q
    return np.concatenate([[1.0, 1.0, 0.0, 0.0], cell.reshape(-1)])


def plan_for(design: Design, settings: StartUpSettings) -> StartUpPlan:
    """The plan of a design with other settings of its start.

    Args:
        design: Of `random_design`.
        settings: Of the start.
    """
    plan = start_up_plan(replace(design, control=replace(design.control, start_up=settings)))
    assert plan is not None
    return plan


def speed_wanted(drive: RandomDrive, plan: StartUpPlan) -> float:
    """Mechanical speed in rad/s to which a drive is started: 40 % of the rated one, or a quarter
    above the hand-over where that is more.

    Args:
        drive: What is driven.
        plan: Of its start.
    """
    least = max(_LEAST_SPEED * drive.omega_rated, 1.25 * plan.hand_over)
    return least / drive.machine.pole_pairs


def duration_of(plan: StartUpPlan, omega_e: float, load: float) -> float:
    """Time in s in which a start to ``omega_e`` rad/s must have ended, its settling among it.

    Args:
        plan: Of the start.
        omega_e: Electrical speed in rad/s.
        load: Load torque in N m.
    """
    left = max(plan.rated_torque - load, 0.05 * plan.rated_torque) * plan.pole_pairs / plan.inertia
    ramp = plan.ramp_end / plan.ramp_acceleration + plan.ramp_rise
    rise = omega_e / min(plan.run_acceleration, left)
    return plan.align_time + ramp + rise + plan.fade_time + plan.patience + 0.7 + SETTLED


def random_start(
    drive: RandomDrive,
    plan: StartUpPlan,
    load: float,
    template: Mapping[str, object],
    conditions: Conditions,
    low: bytes = b"",
) -> StartInput:
    """One start of a random drive against a friction of ``load`` N m.

    Args:
        drive: What is driven.
        plan: Of its start.
        load: In N m.
        template: Gains of a design of the same controller.
        conditions: What it meets.
        low: Bytes of the gains of the estimator from standstill on.
    """
    t_s, machine = 1.0 / drive.f_s, drive.machine
    wanted = speed_wanted(drive, plan)
    length = conditions.duration or duration_of(plan, machine.pole_pairs * wanted, load)
    profile = constant(load)
    if conditions.blocked is not None:
        profile = Profile((0.0, conditions.blocked.time), (load, conditions.blocked.load))
    scenario = Scenario(
        duration=length,
        mode="speed",
        reference=constant(wanted),
        load=profile,
        dead_time=conditions.dead_time_left * drive.dead_time,
        sensor=CurrentSensor(noise=NOISE * machine.i_max),
        errors=conditions.errors,
        omega_m=conditions.turning,
        theta_e=drive.theta_e,
        seed=drive.seed,
        sub_steps=4,
        load_kind="friction",
        brake=conditions.brake,
    )
    whole = Drive(machine, Inverter(drive.v_dc, drive.f_s, dead_time=drive.dead_time), t_s, RATIO)
    stride = max(1, math.ceil(length / t_s / _ROWS))
    gains = gain_bytes(control_gains(drive, template))
    plain = run_input(whole, scenario, stride=stride, gains=gains, observer=flux_bytes_of(drive))
    tables = list(plain.tables)
    tables[5] = saturation_table(drive)
    saturated = {"kind": 1.0, "psi_pm": machine.psi_pm, "i_stop": 5.0 * machine.i_max}
    return StartInput(
        plant=RunInput(plain.parameters | saturated, tuple(tables)),
        settings=settings_bytes(plan),
        low=low,
        torque_per_ampere=machine.torque_per_ampere,
    )


_SQUARE_WAVE = (
    *("t_s", "k_p", "k_i", "omega_max", "notch", "per_ampere"),
    *("scale", "shift", "rest", "carrier", "reference"),
)


def square_wave_bytes(gains: WaveGains) -> bytes:
    """Bytes of ``<prefix>_injection_gains_t`` of a square wave on this machine.

    Args:
        gains: Of the injection.
    """
    assert {one.name for one in fields(gains)} == {*_SQUARE_WAVE, "carrier_beta", "reference_beta"}
    values = np.concatenate([np.atleast_1d(getattr(gains, name)) for name in _SQUARE_WAVE])
    return values.astype(np.float32).tobytes()
