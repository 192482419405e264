"""Drives and scenarios as the numbers that the compiled simulation reads (templates plant.c.j2,
simulate_main.c.j2).
"""

from __future__ import annotations

import ctypes
import math
import struct
from dataclasses import replace
from itertools import pairwise
from typing import get_args

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import (
    MOST_ORDERS,
    FluxMap,
    FluxRipple,
    SaturatedMachine,
    ripple_of_map,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError
from dqforge.machines.names import NumberFormat, Topology
from dqforge.machines.phase_machines.phase_machine import (
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.plants.scenario import ControlMode, Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.fixed_control.transforms import IDLE, FixedControl, FixedPi
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.solution import Solution

_MODES: dict[ControlMode, float] = {"speed": 0.0, "torque": 1.0, "current": 2.0, "open-loop": 3.0}
_RELATIVE_STEP = 0.05
_HIGHEST = 13.0  # Harmonics above are small wherever a machine turns fast.
_LEAST_STEPS = 2

# the averaged dead time is a damping of up to four times the carrier frequency around zero current
_DEAD_STEPS = 4
_MOST_STEPS = 200
_STOP = 100.0
_DRIFTING = ("r_s", "psi_pm", "scale_pm")
LONGEST_DELAY = 3.0  # Most sampling periods that the program keeps duty cycles waiting.


# Names of what the compiled plant integrates, reads and writes, in the order of its structures.

# States of the plant; those from ``torque`` on serve phase machines, ``torque`` being the integral
# of the torque and ``v_midpoint`` the voltage of a split link's midpoint above its half.
STATES = (
    "i_x",
    "i_y",
    "i_zero",
    "omega_m",
    "theta_m",
    "e_in",
    "e_copper",
    "e_shaft",
    "e_load",
    "e_friction",
    "i_square",
    "torque",
    "v_midpoint",
    "neutral_square",
    "e_copper_a",
    "e_copper_b",
    "e_copper_c",
)

# Further states, where a tracker is told the voltages of the phases: their integrals, in V s.
HEARD = ("v_a", "v_b", "v_c")

# Fields of the C structure ``parameters_t``, all doubles, in this order.
PARAMETERS = (
    *("mode", "t_s", "samples", "stride", "sub_steps", "tail", "progress", "seed", "i_stop"),
    *(
        "kind",
        "pole_pairs",
        "r_s",
        "l_d",
        "l_q",
        "psi_pm",
        "scale_d",
        "scale_q",
        "scale_pm",
    ),
    *("inertia", "friction", "driven", "omega_m_0", "theta_m_0"),
    *("switched", "halves", "dead_time", "dead_band", "ripple_l_d", "ripple_l_q"),
    *("counts", "speed_ratio", "angle_error"),
    *(
        "adc_bits",
        "adc_full_scale",
        "noise",
        "offset_a",
        "offset_b",
        "offset_c",
        "gain_a",
        "gain_b",
        "gain_c",
    ),
    *("v_bits", "v_full_scale"),
    *("observed_speed", "sensorless", "sensor_above", "sensor_below"),
    *("legs", "second", "neutral", "capacitance", "l_own", "l_mutual", "l_neutral", "turns"),
    *("i_nothing", "diode_voltage", "open_phase", "open_time", "aware_time"),
    "delay",
    *("load_resists", "brake_time", "brake_stiffness", "brake_damping"),
    *("encoderless", "stop_time"),
    *("edges", "clock", "measured_ratio"),
    *("drift_begin", "drift_end", "first_r_s", "first_psi_pm", "first_scale_pm"),
    *("drift_r_s", "drift_psi_pm", "drift_scale_pm"),
)

# What is recorded at a sampling instant, in this order.
# What the templates of the plant are rendered with where nothing is said of it.
PLANT: dict[str, object] = {
    "parameters": PARAMETERS,
    "states": STATES,
    "waves": MOST_ORDERS,
    "hears": (),
}
COLUMNS = (
    *(
        "t",
        "i_d",
        "i_q",
        "i_zero",
        "omega_m",
        "theta_e",
        "torque",
        "torque_load",
        "duty_a",
        "duty_b",
        "duty_c",
    ),
    *("v_dc", "reference", "reference_d", "i_a_measured", "i_b_measured", "i_c_measured"),
    *("theta_e_measured", "omega_m_measured", "i_d_reference", "i_q_reference", "torque_reference"),
    *("v_alpha", "v_beta", "theta_e_observed", "omega_m_observed", "sensorless"),
    *("start_state", "start_fault", "start_reference"),
    *("application_state", "application_fault"),
    *("r_s", "psi_pm", "r_s_estimated", "psi_pm_estimated", "estimation_status"),
    *("duty_n", "duty_a2", "duty_b2", "duty_c2", "i_a", "i_b", "i_c", "i_n", "v_m", "torque_mean"),
)

# Figures of a run, in this order.
SUMMARY = (
    *(
        "status",
        "t",
        "peak_current",
        "tail_error",
        "tail_current",
        "i_d",
        "i_q",
        "omega_m",
        "torque",
        "i_square",
    ),
    *("e_in", "e_copper", "e_shaft", "e_load", "e_friction"),
    *("e_magnetic", "e_midpoint", "tail_torque", "tail_ripple_means", "tail_ripple"),
    *("tail_neutral_rms", "tail_copper_a", "tail_copper_b", "tail_copper_c", "tail_midpoint"),
)

# Where the switching of a bridge is counted: further states, parameters and columns.
BRIDGE_STATES = ("e_link", "charge_d", "charge_q", "torque_square", "error_d", "error_q")

BRIDGE_PARAMETERS = (
    *("band", "kp", "ki", "carrier", "comparator_band", "interval", "triangle", "most_volts"),
    *("accuracy", "grid", "usage_top", "drop_band", "synchronous"),
    *("pulses", "patterns", "family", "least_speed"),
    *("model_r", "model_l_d", "model_l_q", "model_psi"),
)

BRIDGE_COLUMNS = ("edges",)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What is simulated: a machine or a phase machine, its inverter, and the
    periods of the controllers.

    Args:
        machine: Machine in dq coordinates: constant inductances or a flux map. Its mechanics hold
            for the phase machine, too.
        inverter: DC link, carrier and dead time.
        t_s: Sampling period in s.
        ratio: Current samples per sample of the speed controller.
        phases: Machine with another back-EMF than a sine, None for others.
        delay: Sampling periods from a sample until the duty cycles made of it begin to act, 0 to
            `LONGEST_DELAY`; with a switched inverter a whole number of half carrier periods.
    """

    machine: Machine
    inverter: Inverter
    t_s: float
    ratio: int = 10
    phases: AnyPhaseMachine | None = None
    delay: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class RunInput:
    """One run: the parameters by name, and the tables (None: as in the run before); ``names`` are
    those of the parameters that the program reads.
    """

    parameters: dict[str, float]
    tables: tuple[FloatArray | None, ...]
    names: tuple[str, ...] = PARAMETERS

    def content(self) -> bytes:
        """What the program reads."""
        sizes = [-1.0 if table is None else float(table.size) for table in self.tables]
        head = np.array([*(self.parameters[name] for name in self.names), *sizes], dtype=np.float64)
        return head.tobytes() + b"".join(
            table.tobytes() for table in self.tables if table is not None
        )


def profile_table(profile: Profile | None) -> FloatArray:
    """Shape, amplitude, frequency, and the points in turn; empty for no profile."""
    if profile is None:
        return np.zeros(0)
    points = np.stack([np.array(profile.times), np.array(profile.values)], axis=1).reshape(-1)
    linear = 1.0 if profile.shape == "linear" else 0.0
    return np.concatenate([[linear, profile.amplitude, profile.frequency], points]).astype(
        np.float64
    )


def map_table(flux_map: FluxMap) -> FloatArray:
    """Numbers of cells, where the cells count from, and 32 coefficients per cell,
    rows of i_d first.
    """
    rows, columns = flux_map.i_d.size + 1, flux_map.i_q.size + 1
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    cubics, corner_d, corner_q = flux_map.cubics(row.ravel(), column.ravel())
    cells = np.moveaxis(cubics, -1, 0).reshape(-1)
    corners = np.concatenate(
        [corner_d.reshape(rows, columns)[:, 0], corner_q.reshape(rows, columns)[0]]
    )
    return np.concatenate([[float(rows), float(columns)], corners, cells])


def waves_table(ripple: FluxRipple) -> FloatArray:
    """Number of orders, the orders, and three maps for each as `map_table` writes them."""
    parts = zip(ripple.cosine, ripple.sine, ripple.torque, strict=True)
    maps = [map_table(part) for three in parts for part in three]
    return np.concatenate([[float(len(ripple.orders))], ripple.orders, *maps])


def _ripple_of(drive: Drive) -> FluxRipple | None:
    """What turns with the rotor of a machine with a flux map, None for others."""
    return ripple_of_map(drive.machine) if drive.phases is None else None


def _machine_parameters(drive: Drive, scenario: Scenario, topology: Topology) -> dict[str, float]:
    """Electrical constants of the plant, the relative errors applied."""
    machine, errors, phases = drive.machine, scenario.errors, drive.phases
    scale_d, scale_q = 1.0 + errors.l_d, 1.0 + errors.l_q
    values = no_phase_parameters() | {
        "pole_pairs": float(machine.pole_pairs),
        "r_s": machine.r_s * (1.0 + errors.r_s),
        "l_d": machine.l_d * scale_d,
        "l_q": machine.l_q * scale_q,
        "psi_pm": machine.psi_pm,
        "scale_d": scale_d,
        "scale_q": scale_q,
        "scale_pm": 1.0 + errors.psi_pm,
    }
    if phases is not None:
        wired = phase_parameters(phases, drive.inverter, topology, scenario, machine.i_max)
        return values | wired | {"kind": 2.0}
    if isinstance(machine, SaturatedMachine):
        return values | {"kind": 1.0}
    if not isinstance(machine, LinearMachine):
        raise InputError(
            f"a machine of the kind {type(machine).__name__} cannot be simulated; write it as a "
            "flux map"
        )
    return values | {"kind": 0.0, "psi_pm": machine.psi_pm * (1.0 + errors.psi_pm)}


def _drift_parameters(
    machine: Machine, scenario: Scenario, electrical: dict[str, float]
) -> dict[str, float]:
    """Begin and end in s, what changes there as it is first, and by how much it changes."""
    drift, first = scenario.drift, {f"first_{name}": electrical[name] for name in _DRIFTING}
    if drift is None:
        return first | {f"drift_{name}": 0.0 for name in ("begin", "end", *_DRIFTING)}
    constant = electrical["kind"] < 1.0
    return first | {
        "drift_begin": drift.begin,
        "drift_end": drift.end,
        "drift_r_s": machine.r_s * drift.r_s,
        "drift_psi_pm": machine.psi_pm * drift.psi_pm if constant else 0.0,
        "drift_scale_pm": 0.0 if constant else drift.psi_pm,
    }


def _observer_parameters(scenario: Scenario) -> dict[str, float]:
    """What of the observers reaches the controller; speeds mechanical, in rad/s."""
    wanted = scenario.sensorless
    return {
        "observed_speed": 1.0 if scenario.encoder.speed == "observer" else 0.0,
        "sensorless": 0.0 if wanted is None else 1.0,
        "sensor_above": 0.0 if wanted is None else wanted.above,
        "sensor_below": 0.0 if wanted is None else wanted.below,
    }


def _load_parameters(scenario: Scenario) -> dict[str, float]:
    """How the load acts, and the brake; stiffness in N m/rad, damping in N m s/rad."""
    brake = scenario.brake
    return {
        "load_resists": 1.0 if scenario.load_kind == "friction" else 0.0,
        "brake_time": 0.0 if brake is None else brake.time,
        "brake_stiffness": 0.0 if brake is None else brake.stiffness,
        "brake_damping": 0.0 if brake is None else brake.damping,
    }


def fits_carrier(drive: Drive) -> bool:
    """Whether sampling and delay are those of a switched inverter: the peaks of its carrier."""
    exact = 2.0 * drive.inverter.f_sw * drive.t_s
    halves = max(1, round(exact))
    late = drive.delay * halves
    return abs(exact - halves) <= 1e-6 and abs(late - round(late)) <= 1e-9


def carrier_halves(drive: Drive, scenario: Scenario) -> int:
    """Half carrier periods per control period.

    Raises:
        InputError: The sampling and the carrier of a switched inverter do not fit, or the delay
            does not.
    """
    exact = 2.0 * drive.inverter.f_sw * drive.t_s
    halves = max(1, round(exact))
    if scenario.inverter == "averaged" or fits_carrier(drive):
        return halves
    if abs(exact - halves) > 1e-6:
        raise InputError(
            "simulation.inverter: switched needs a sampling frequency of one or two times the "
            f"switching frequency, or a whole part of it; they are {1.0 / drive.t_s:g} Hz and "
            f"{drive.inverter.f_sw:g} Hz"
        )
    raise InputError(
        "simulation.inverter: a switched inverter takes duty cycles at the peaks of its carrier, "
        f"not {drive.delay:g} periods after the sample; write inverter: averaged"
    )


def _delay(drive: Drive) -> float:
    """Periods from sampling to loading."""
    if not 0.0 <= drive.delay <= LONGEST_DELAY:
        raise InputError(
            f"duty cycles cannot act {drive.delay:g} periods after the sample; from 0 to "
            f"{LONGEST_DELAY:g} can be simulated"
        )
    return drive.delay


def sub_steps(drive: Drive, scenario: Scenario) -> int:
    """Integration steps per control period: 1/20 of the fastest time constant,
    or of a radian of the highest speed.
    """
    if scenario.sub_steps is not None:
        return scenario.sub_steps
    machine = drive.machine
    speed = (
        machine.omega_m_max or scenario.reference.largest
        if scenario.mode == "speed"
        else machine.omega_m_max
    )
    turning = machine.pole_pairs * max(speed or 0.0, abs(scenario.omega_m))
    if scenario.shaft is not None:
        turning = max(turning, machine.pole_pairs * scenario.shaft.largest)
    if drive.phases is not None:
        turning *= min(_HIGHEST, highest_order(drive.phases))
        turning = max(turning, midpoint_frequency(drive.phases, drive.inverter))
    ripple = _ripple_of(drive)
    if ripple is not None:
        turning *= min(_HIGHEST, ripple.orders[-1])
    rate = max(machine.r_s * (1.0 + scenario.errors.r_s) / _least_inductance(drive), turning)
    dead_time = drive.inverter.dead_time if scenario.dead_time is None else scenario.dead_time
    least = _DEAD_STEPS if dead_time > 0.0 else _LEAST_STEPS
    if drive.phases is not None and len(TOPOLOGIES[drive.inverter.topology].legs) > 3:
        least *= 2  # a current meets two legs
    return int(min(max(math.ceil(rate * drive.t_s / _RELATIVE_STEP), least), _MOST_STEPS))


def _least_inductance(drive: Drive) -> float:
    """Least inductance in H that a current of the drive meets."""
    if drive.phases is not None:
        return least_inductance(drive.phases, drive.inverter.topology)
    return min(_least_inductances(drive.machine))


def _least_inductances(machine: Machine) -> tuple[float, float]:
    """Least incremental inductances in H within the current limit, on a grid."""
    if isinstance(machine, LinearMachine):
        return machine.l_d, machine.l_q
    line = np.linspace(-machine.i_max, machine.i_max, 21)
    i_d, i_q = (grid.ravel() for grid in np.meshgrid(line, line))
    jet = machine.jet(i_d, i_q)
    return float(np.min(jet.l_dd)), float(np.min(jet.l_qq))


def run_input(
    drive: Drive,
    scenario: Scenario,
    *,
    stride: int = 1,
    tail: float = 0.9,
    gains: bytes = b"",
    shape: bytes = b"",
    topology: Topology | None = None,
    observer: bytes = b"",
) -> RunInput:
    """Numbers of one run.

    Args:
        drive, scenario: What is simulated.
        stride: Samples per recorded row; 0 for no record.
        tail: Share of the duration from which the largest error and current are kept.
        gains: Bytes of the C structure of gains; empty for those of the header.
        shape: Bytes of the C structure of the back-EMF that the controller knows; empty for that of
            the header.
        topology: How the phases are fed; None for that of the inverter.
        observer: Bytes of the C structure of the position observer's gains; empty for those of its
            header.

    Raises:
        InputError: The machine has no inertia and the shaft is free, the delay does not fit the
            inverter, or what `carrier_halves` refuses.
    """
    machine, errors, sensor = drive.machine, scenario.errors, scenario.sensor
    if machine.inertia is None and scenario.shaft is None:
        raise InputError(
            "a simulation with a free shaft needs machine.inertia; write it, or simulation.shaft"
        )
    v_dc = drive.inverter.v_dc
    dead_time = drive.inverter.dead_time if scenario.dead_time is None else scenario.dead_time
    samples = max(1, round(scenario.duration / drive.t_s))
    topology = topology or drive.inverter.topology
    electrical = _machine_parameters(drive, scenario, topology)
    inductance = (
        _least_inductances(machine)
        if drive.phases is None
        else (electrical["l_d"], electrical["l_d"])
    )
    speed = scenario.encoder.speed
    parameters = (
        electrical
        | {
            "mode": _MODES[scenario.mode],
            "t_s": drive.t_s,
            "samples": float(samples),
            "stride": float(stride),
            "sub_steps": float(sub_steps(drive, scenario)),
            "tail": tail * samples * drive.t_s,
            "progress": 0.0,
            "seed": float(scenario.seed),
            "i_stop": _STOP * machine.i_max,
            "inertia": (machine.inertia or 1.0) * (1.0 + errors.inertia),
            "friction": machine.friction,
            "driven": 0.0 if scenario.shaft is None else 1.0,
            "omega_m_0": scenario.omega_m,
            "theta_m_0": scenario.theta_e / machine.pole_pairs,
            "switched": 1.0 if scenario.inverter == "switched" else 0.0,
            "halves": float(carrier_halves(drive, scenario)),
            "dead_time": dead_time,
            # Half of what a third of the link changes a current by in a dead time:
            # so near to zero it may come to rest.
            "dead_band": max(v_dc * dead_time / (6.0 * min(inductance)), 1e-9 * machine.i_max),
            "ripple_l_d": inductance[0],
            "ripple_l_q": inductance[1],
            "counts": 4.0 * scenario.encoder.lines,
            "speed_ratio": float(drive.ratio) if speed == "difference" else 0.0,
            "angle_error": scenario.encoder.misalignment,
            "adc_bits": float(sensor.bits),
            "adc_full_scale": sensor.full_scale,
            "noise": sensor.noise,
            "delay": _delay(drive),
            "edges": float(scenario.encoder.lines * scenario.encoder.edges),
            "clock": scenario.encoder.clock,
            "measured_ratio": float(drive.ratio) if speed == "measured" else 0.0,
            "v_bits": 0.0,
            "v_full_scale": 1.0,
            "encoderless": 1.0 if scenario.encoder.absent else 0.0,
            "stop_time": math.inf if scenario.stop is None else scenario.stop,
        }
        | _drift_parameters(machine, scenario, electrical)
        | _observer_parameters(scenario)
        | _load_parameters(scenario)
    )
    for index, phase in enumerate("abc"):
        parameters[f"offset_{phase}"], parameters[f"gain_{phase}"] = (
            sensor.offset[index],
            sensor.gain_error[index],
        )
    link = (Profile((0.0,), (v_dc,)) if scenario.v_dc is None else scenario.v_dc).scaled(
        1.0 + errors.v_dc
    )
    flux_map = (
        machine.flux_map if isinstance(machine, SaturatedMachine) and drive.phases is None else None
    )
    ripple = _ripple_of(drive)
    tables = (
        profile_table(scenario.reference),
        profile_table(scenario.reference_d),
        profile_table(scenario.load),
        profile_table(scenario.shaft),
        profile_table(link),
        np.zeros(0) if flux_map is None else map_table(flux_map),
        np.zeros(0) if drive.phases is None else emf_table(drive.phases, 1.0 + errors.psi_pm),
        _doubles(gains),
        np.zeros(0) if drive.phases is None else inductance_table(drive.phases, 1.0 + errors.l_d),
        duty_table([profile_table(duty) for duty in scenario.duties]),
        _doubles(shape),
        _doubles(observer),
        np.zeros(0) if ripple is None else waves_table(ripple),
    )
    return RunInput(parameters, tables)


def _doubles(content: bytes) -> FloatArray:
    return np.frombuffer(content + bytes(-len(content) % 8), dtype=np.float64)


def share_tables(runs: list[RunInput]) -> list[RunInput]:
    """The runs without tables that equal those of the run before, so that a flux map is sent
    once.
    """
    shared = runs[:1]
    for before, run in pairwise(runs):
        tables = tuple(
            None
            if old is new or (old is not None and new is not None and np.array_equal(old, new))
            else new
            for old, new in zip(before.tables, run.tables, strict=True)
        )
        shared.append(replace(run, tables=tables))
    return shared


# Phase machines, their topologies and what opens in them as the numbers that the compiled
# simulation reads (template phase_plant.c.j2).

# Where the neutral ends, as the C code numbers it.
_FLOATING, _LEG, _DIODES, _MIDPOINT, _LINK = range(5)

# Rows and columns of the six entries of a symmetric matrix, in the order of the C code.
_ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))
_NEGLIGIBLE = 1e-13
_NOTHING = 1e-12  # Share of the current limit below which a conductor has no current.


def harmonics_table(waveforms: FloatArray) -> FloatArray:
    """Harmonics of periodic waveforms: order, then cosine and sine of each, for every order.

    They are those of the interpolating trigonometric polynomial, without what is rounding.

    Args:
        waveforms: Values in any unit on an even grid over their period, shape (K, N).
    """
    count = waveforms.shape[1]
    spectrum = np.fft.rfft(waveforms, axis=1) * (2.0 / count)
    spectrum[:, 0] *= 0.5
    orders = np.arange((count + 1) // 2)  # without the highest, whose phase the table does not tell
    sizes = np.max(np.abs(spectrum[:, orders]), axis=0)
    kept = orders[sizes > _NEGLIGIBLE * np.max(sizes)]
    terms = np.empty((kept.size, 1 + 2 * waveforms.shape[0]))
    terms[:, 0] = kept
    terms[:, 1::2], terms[:, 2::2] = spectrum[:, kept].real.T, -spectrum[:, kept].imag.T
    return terms.reshape(-1)


def emf_table(phases: AnyPhaseMachine, scale: float = 1.0) -> FloatArray:
    """Harmonics of the back-EMF over electrical speed, of the phases a, b, c."""
    return harmonics_table(phases.flux * scale)


def inductance_table(phases: AnyPhaseMachine, scale: float = 1.0) -> FloatArray:
    """Harmonics of the inductances aa, bb, cc, bc, ca, ab; empty where they are constant."""
    if isinstance(phases, PhaseMachine):
        return np.zeros(0)
    return harmonics_table(np.stack([phases.inductance[:, j, k] for j, k in _ENTRIES]) * scale)


def duty_table(profiles: list[FloatArray]) -> FloatArray:
    """The tables of profiles one behind the other, each behind its length."""
    parts = [part for table in profiles for part in (np.array([float(table.size)]), table)]
    return np.concatenate(parts) if parts else np.zeros(0)


def constant_inductances(phases: AnyPhaseMachine) -> tuple[float, float]:
    """Self and mutual inductance in H, of salient machines the means over phases and angle."""
    if isinstance(phases, SalientPhaseMachine):
        mean = np.mean(phases.inductance, axis=0)
        own = float(np.trace(mean)) / 3.0
        return own, (float(np.sum(mean)) - 3.0 * own) / 6.0
    return phases.l_s, phases.m_s


def least_inductance(phases: AnyPhaseMachine, topology: Topology) -> float:
    """Least inductance in H of a current that the topology lets flow."""
    matrices = (
        phases.inductance
        if isinstance(phases, SalientPhaseMachine)
        else phases.inductances[np.newaxis]
    )
    if not TOPOLOGIES[topology].neutral:
        basis = np.array([[2.0, -1.0, -1.0], [0.0, math.sqrt(3.0), -math.sqrt(3.0)]])
        basis /= math.sqrt(6.0)
        matrices = basis @ matrices @ basis.T
    return float(np.min(np.linalg.eigvalsh(matrices)))


def midpoint_frequency(phases: AnyPhaseMachine, inverter: Inverter) -> float:
    """Frequency in rad/s with which the midpoint of a split link swings against the machine's zero
    sequence; 0 where the link is not split, or stiff.
    """
    if not TOPOLOGIES[inverter.topology].midpoint or inverter.midpoint_capacitance is None:
        return 0.0
    least = least_inductance(phases, inverter.topology)
    return math.sqrt(3.0 / (least * inverter.midpoint_capacitance))


def highest_order(phases: AnyPhaseMachine) -> float:
    """Highest harmonic of the back-EMF in electrical periods."""
    return float(emf_table(phases)[::7].max()) / turns_of(phases)


def turns_of(phases: AnyPhaseMachine) -> int:
    """Electrical periods after which the waveforms repeat."""
    return phases.turns


def neutral_end(topology: Topology) -> int:
    """Where the neutral ends, by the record of the topology."""
    rule = TOPOLOGIES[topology]
    if rule.diodes:
        return _DIODES
    if not rule.neutral:
        return _FLOATING
    if rule.midpoint:
        return _MIDPOINT
    return _LEG if "n" in rule.legs else _LINK


def no_phase_parameters() -> dict[str, float]:
    """Parameters of the phase plant for a machine in dq coordinates, on three legs."""
    return dict.fromkeys(
        (
            "second",
            "neutral",
            "capacitance",
            "l_own",
            "l_mutual",
            "l_neutral",
            "i_nothing",
            "diode_voltage",
            "open_phase",
            "open_time",
            "aware_time",
        ),
        0.0,
    ) | {"legs": 3.0, "turns": 1.0}


def phase_parameters(
    phases: AnyPhaseMachine,
    inverter: Inverter,
    topology: Topology,
    scenario: Scenario,
    i_max: float,
) -> dict[str, float]:
    """Parameters of the phase plant, the relative errors applied."""
    scale = 1.0 + scenario.errors.l_d
    own, mutual = (scale * value for value in constant_inductances(phases))
    legs, opening = TOPOLOGIES[topology].legs, scenario.open_phase
    return {
        "l_d": own - mutual,
        "l_q": own - mutual,
        "legs": float(len(legs)),
        "second": 1.0 if "a2" in legs else 0.0,
        "neutral": float(neutral_end(topology)),
        "capacitance": inverter.midpoint_capacitance or 0.0,
        "l_own": own,
        "l_mutual": mutual,
        "l_neutral": inverter.neutral_inductance,
        "turns": float(turns_of(phases)),
        "i_nothing": _NOTHING * i_max,
        "open_phase": 0.0 if opening is None else 1.0 + "abc".index(opening.phase),
        "open_time": 0.0 if opening is None else opening.time,
        "aware_time": math.inf
        if opening is None or opening.detected_after is None
        else opening.time + opening.detected_after,
    }


# Gains of a control in integers as the bytes of its C structure, for runs that are given their
# own.


def integer_gain_bytes(control: FixedControl) -> bytes:
    """Bytes of what ``simulation/integer_border.h.j2`` takes on this machine: full scales, and
    ``<prefix>_control_gains_q15_t`` or that of another width.

    One compiled program runs all controls that share the modulator, the scale of the dc link and
    the references.
    """
    current, voltage, speed, torque = control.bases
    scales = (current, voltage, voltage * 2.0**control.dc_scale, speed, torque, 1.0)
    return struct.pack("=6d", *scales) + bytes(_gains(control))


def _gains(control: FixedControl) -> ctypes.Structure:
    wide = ctypes.c_int32 if control.width == 16 else ctypes.c_int64
    number = ctypes.c_int16 if control.width == 16 else ctypes.c_int32

    class Gain(ctypes.Structure):
        _fields_ = (("mantissa", ctypes.c_int32), ("shift", ctypes.c_uint32), ("half", wide))

        @classmethod
        def of(cls, gain: FixedGain) -> Gain:
            return cls(gain.mantissa, gain.shift, 2**gain.shift // 2)

    class Pi(ctypes.Structure):
        _fields_ = (
            ("kp", Gain), ("ki", Gain), ("tracking", Gain), ("fraction", ctypes.c_uint32),
            ("half", wide), ("most", wide),
        )  # fmt: skip

        @classmethod
        def of(cls, pi: FixedPi) -> Pi:
            gains = (Gain.of(gain) for gain in (pi.kp, pi.ki, pi.tracking))
            half, most = 2**pi.fraction // 2, control.top << pi.fraction
            return cls(*gains, pi.fraction, half, most)

    class Gains(ctypes.Structure):
        _fields_ = (
            ("d", Pi), ("q", Pi),
            ("x_d", Gain), ("x_q", Gain), ("back_emf", Gain),
            ("voltage_limit", Gain), ("angle_advance", Gain), ("speed_filter", Gain),
            ("speed", Pi),
            ("dc_least", number), ("torque_max", number), ("ratio", ctypes.c_uint32),
        )  # fmt: skip

    loops = (control.i_d, control.i_q, control.speed)
    pis = [Pi.of(IDLE if forms is None else forms["parallel"]) for forms in loops]
    feed = control.decoupling
    gains = (
        feed.x_d, feed.x_q, feed.back_emf, control.limit, control.advance, control.speed_filter,
    )  # fmt: skip
    numbers = (control.dc_least, control.torque_max, control.ratio)
    return Gains(*pis[:2], *(Gain.of(gain) for gain in gains), pis[2], *numbers)


# Which number formats a simulation runs, and which emitted ones it does not.

_DEFAULT: NumberFormat = "float32"


def simulated(solution: Solution) -> tuple[NumberFormat, ...]:
    """Formats whose control functions a simulation runs: all that the design emits, float32 where
    it emits none.
    """
    emitted = solution.design.export.control
    return tuple(name for name in get_args(NumberFormat) if name in emitted) or (_DEFAULT,)


def not_simulated(solution: Solution) -> tuple[NumberFormat, ...]:
    """Formats of an emitted current reference that no simulated control functions have.

    Control functions call references in their own arithmetic.
    """
    reference = solution.fit.reference
    if not isinstance(reference, FixedReference) or reference.format in simulated(solution):
        return ()
    return (reference.format,)


def format_text(run: tuple[NumberFormat, ...], left: tuple[NumberFormat, ...]) -> str:
    """What runs and what does not, in words; empty where all that is emitted is float32."""
    if run == (_DEFAULT,) and not left:
        return ""
    text = f"runs the {' and the '.join(run)} control"
    return f"{text}; the emitted {' and '.join(left)} is not simulated" if left else text
