"""ST's MCSDK: its configuration for a design, in integers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.firmware_method import (
    CURRENT_SENSING,
    Asked,
    FirmwareMethod,
    needed,
    number,
)
from dqforge.optimizer.firmware.st_keys import VERSION, MtpaTable
from dqforge.optimizer.firmware.st_loops import profile, shortfalls, table_for
from dqforge.optimizer.firmware.st_scales import (
    FULL,
    LARGEST,
    LOW_SHARE,
    ObservedMachine,
    current_integers,
    current_scale,
    emf_of,
    observed_machine,
    observer_integers,
    printed,
    scales,
    speed_integers,
    st_configuration,
    tracking,
    tracking_integers,
)

_TICKS = 2000  # Hz of the timer that the speed controller is counted from.

# Voltage up to which the dc link is taken to be measured, over its nominal one: a header of the
# power stage says it, a design does not.
_BUS_ROOM = 1.5
_USUAL_DEPTH, _LEAST_DEPTH = 64, 8

# Phase in rad that the average of the speed may cost at the crossover of the speed loop.
_AVERAGING_LAG = 0.1

# Gain of the phase-locked loop at its lowest speed over the crossover of the speed loop.
_FASTER = 8.0


def configure(asked: Asked) -> Configuration:
    """The configuration for a design.

    Raises:
        InputError: The design says nothing of `inverter.current_sensing`, or a value does not fit
            16 bits; with the key.
    """
    drive = asked.drive
    own = _machine(asked) | _stage(asked) | _rates(drive)
    full, scale = current_scale(own), scales(own)
    assert full is not None
    assert scale is not None
    _require_current(drive, full)
    own |= _fitting(
        "control.current_loop", lambda: current_integers(asked.current_d, asked.current_q, scale)
    )
    own["IQMAX_A"] = own["NOMINAL_CURRENT_A"]
    table = table_for(asked, full)
    if table is not None:
        own |= _table_macros(table)
        own["IQMAX_A"] = printed(table.largest * full / FULL)
    if asked.speed is not None:
        rate = _speed_rate(drive)
        own["SPEED_LOOP_FREQUENCY_HZ"] = rate
        own |= _speed_macros(asked.speed, full, rate)
    if drive.psi_pm and drive.omega_m_max:
        own |= _observer(asked, own)
    return st_configuration(asked.design.name, own)


def _known(value: float | None, key: str) -> float:
    return needed(value, key, "the MCSDK", "it")


def _machine(asked: Asked) -> dict[str, OwnValue]:
    """Macros of the machine, and what only the motor file says."""
    drive = asked.drive
    pairs = int(_known(drive.pole_pairs, "machine.pole_pairs"))
    l_q = printed(_known(drive.l_q, "machine.inductance_q"))
    i_max = printed(_known(drive.i_max, "machine.max_current"))
    own: dict[str, OwnValue] = {
        "POLE_PAIR_NUM": pairs,
        "RS": printed(_known(drive.r_s, "machine.resistance")),
        "LS": l_q,
        "MOTOR_VOLTAGE_CONSTANT": printed(emf_of(drive.psi_pm or 0.0, pairs)),
        "NOMINAL_CURRENT_A": i_max,
        "ID_DEMAG_A": -i_max,
    }
    ratio = printed(_known(drive.l_d, "machine.inductance_d") / l_q)
    if ratio != 1.0:
        own["ld_lq_ratio"] = ratio
    if drive.omega_m_max:
        rpm = round(drive.omega_m_max * 30.0 / math.pi)
        own |= {"MOTOR_MAX_SPEED_RPM": rpm, "MAX_APPLICATION_SPEED_RPM": rpm}
    if drive.inertia:
        own["inertia"] = printed(drive.inertia * 1e6)
    if drive.viscous:
        own["friction"] = printed(drive.viscous * 1e6)
    return own


def _stage(asked: Asked) -> dict[str, float]:
    sensing = asked.design.inverter.current_sensing
    if sensing is None:
        raise InputError(
            "inverter.current_sensing: the MCSDK counts currents in integers; write "
            "current_sensing: {shunt: 10 mOhm, gain: 5.18, reference: 3.3 V}"
        )
    return {
        "NOMINAL_BUS_VOLTAGE_V": printed(_known(asked.drive.v_dc, "inverter.v_dc")),
        "RSHUNT": printed(sensing.shunt),
        "AMPLIFICATION_GAIN": printed(sensing.gain),
        "ADC_REFERENCE_VOLTAGE": printed(sensing.reference),
    }


def _rates(drive: DriveValues) -> dict[str, float]:
    f_sw, t_s = _known(drive.f_sw, "inverter.switching_frequency"), _known(drive.t_s, "control")
    every = f_sw * t_s
    if abs(every - round(every)) > 1e-6 or round(every) < 1:
        raise InputError(
            f"control.sampling_frequency: the MCSDK samples once in a whole number of carrier "
            f"periods, not in {every:.4g}; write {f_sw:g} Hz or a whole part of it"
        )
    scaling = next((2**k for k in range(5) if f_sw < 65536.0 * 2**k), 0)
    if not scaling:
        raise InputError(
            f"inverter.switching_frequency {f_sw:g} Hz: the MCSDK counts at most 1048575 Hz"
        )
    return {
        "PWM_FREQUENCY": round(f_sw),
        "PWM_FREQ_SCALING": scaling,
        "REGULATION_EXECUTION_RATE": round(every),
        "SW_DEADTIME_NS": round((drive.dead_time or 0.0) * 1e9),
    }


def _require_current(drive: DriveValues, full: float) -> None:
    i_max = _known(drive.i_max, "machine.max_current")
    if i_max * FULL / full > LARGEST:
        raise InputError(
            f"inverter.current_sensing: its full scale of {full:.4g} A is below the current limit "
            f"of {i_max:.4g} A, which the MCSDK then cannot count; lower the gain or max_current"
        )


def _fitting(key: str, work: Callable[[], dict[str, int]]) -> dict[str, int]:
    try:
        return work()
    except InputError as error:
        raise InputError(f"{key}: {error.message}; choose a slower loop") from None


def _speed_macros(speed: PiGains, full: float, rate: int) -> dict[str, int]:
    return _fitting("control.speed_loop", lambda: speed_integers(speed, full, rate))


def _speed_rate(drive: DriveValues) -> int:
    """Rate in Hz of the speed controller: the part of its timer next to what is asked."""
    wanted = 1.0 / drive.t_speed if drive.t_speed else 1000.0
    parts = [_TICKS // k for k in range(1, _TICKS + 1) if _TICKS % k == 0]
    return min(parts, key=lambda part: abs(math.log(part / wanted)))


def _observer(asked: Asked, own: Mapping[str, OwnValue]) -> dict[str, OwnValue]:
    voltage = _BUS_ROOM * (number(own, "NOMINAL_BUS_VOLTAGE_V") or 0.0) / math.sqrt(3.0)
    machine = observed_machine(own, voltage)
    assert machine is not None
    found: dict[str, OwnValue] = dict(_observer_gains(machine))
    rpm, pairs = machine.speed, int(number(own, "POLE_PAIR_NUM") or 1)
    base = tracking_integers(pairs, rpm, machine.rate)
    low = LOW_SHARE * rpm * math.pi / 30.0
    slow = tracking({**own, **base}, low)
    assert slow is not None
    crossover = _speed_crossover(asked)
    faster = max(1.0, _FASTER * crossover / slow.kp)
    found |= tracking_integers(pairs, rpm, machine.rate, faster)
    depth = _averaged(crossover, machine.rate)
    found |= {"STO_FIFO_DEPTH_DPP": depth, "STO_FIFO_DEPTH_UNIT": depth}
    return found | {"OBS_MINIMUM_SPEED_RPM": round(LOW_SHARE * rpm)}


def _averaged(crossover: float, rate: float) -> int:
    """Periods over which the speed is averaged: as many as usual, or as few as leave the speed loop
    its phase.
    """
    depth = _USUAL_DEPTH
    while depth > _LEAST_DEPTH and 0.5 * depth / rate * crossover > _AVERAGING_LAG:
        depth //= 2
    return depth


def _observer_gains(machine: ObservedMachine) -> dict[str, int]:
    found = observer_integers(machine)
    if not found["F1"]:
        raise InputError(
            f"machine.inductance_q {machine.inductance:.4g} H: at {machine.rate:g} Hz and "
            f"{machine.current:.4g} A no scale F1 makes the constants of the MCSDK's observer fit "
            "16 bits; sample faster, or measure more current"
        )
    return found


def _speed_crossover(asked: Asked) -> float:
    """Crossover in rad/s of the speed loop that is asked for, 0 without one."""
    drive, speed = asked.drive, asked.speed
    if speed is None or not drive.inertia or not drive.psi_pm or not drive.pole_pairs:
        return 0.0
    return 1.5 * drive.pole_pairs * drive.psi_pm * speed.kp / drive.inertia


def _table_macros(table: MtpaTable) -> dict[str, OwnValue]:
    return {
        "SEGDIV": table.width,
        "ANGC": _listed(table.slopes),
        "OFST": _listed(table.offsets),
    }


def _listed(values: tuple[int, ...]) -> str:
    return "{" + ",".join(str(value) for value in values) + "}"


ST = FirmwareMethod("st", VERSION, "axes", configure, profile, shortfalls, needs=(CURRENT_SENSING,))
