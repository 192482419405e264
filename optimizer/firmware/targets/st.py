"""ST's MCSDK: its configuration for a design, in integers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LimitOrder,
    LoopProfile,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    CURRENT_SENSING,
    Asked,
    FirmwareMethod,
    Price,
    Shortfall,
    needed,
    number,
)
from dqforge.optimizer.firmware.st_keys import (
    SEGMENTS,
    VERSION,
    MtpaTable,
    fitted_table,
    locus_counts,
    table_currents,
)
from dqforge.optimizer.firmware.st_scales import (
    FULL,
    LARGEST,
    LOW_SHARE,
    SPEED_UNIT,
    ObservedMachine,
    amperes,
    control_rate,
    current_integers,
    current_scale,
    emf_of,
    integers,
    low_speed,
    observed_machine,
    observer_integers,
    placed_poles,
    printed,
    scales,
    speed_integers,
    st_configuration,
    tracking,
    tracking_integers,
)
from dqforge.optimizer.operating_points.mtpa_locus import MtpaLocus, mtpa_locus

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
        rpm = round(in_rpm(drive.omega_m_max))
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
    return torque_per_ampere(drive.pole_pairs, drive.psi_pm) * speed.kp / drive.inertia


def _table_macros(table: MtpaTable) -> dict[str, OwnValue]:
    return {
        "SEGDIV": table.width,
        "ANGC": _listed(table.slopes),
        "OFST": _listed(table.offsets),
    }


def _listed(values: tuple[int, ...]) -> str:
    return "{" + ",".join(str(value) for value in values) + "}"


# The loops that ST's MCSDK runs with a configuration.

SOURCES = (
    "MCSDK 5.4.3 and 6.4 mc_tasks: PI of q, of d, circle limitation, inverse Park",
    "MCSDK pwm_curr_fdbk drivers: sampled round the crest, loaded with the next update",
    "MCSDK pid_regulator: the integral first, held to 32767 counts; its discharge is 1/divider",
    "MCSDK circle_limitation: version 5 along the direction, version 6 q after d, d up to 95 %",
    "MCSDK pwm_curr_fdbk: 32768 counts of voltage are v_dc/sqrt(3)",
    "MCSDK sto_pll_speed_pos_fdbk: observer, PI as phase-locked loop, its output averaged",
    "MCSDK speed_torq_ctrl: PI on tenths of a hertz, held to IQMAX",
    "MCSDK parameters_conversion.h: C1 to C5, scales of current, voltage and back-EMF",
)


def profile(found: Configuration) -> LoopProfile:
    """The loops that the MCSDK runs with a configuration.

    Raises:
        InputError: It says too little of the current controllers.
    """
    own, drive = found.own, found.drive
    if found.current_q is None or drive.t_s is None or drive.v_dc is None:
        raise InputError(
            "the configuration of the MCSDK does not describe its current loops fully: they need "
            "drive_parameters.h, and of power_stage_parameters.h RSHUNT, AMPLIFICATION_GAIN and "
            "NOMINAL_BUS_VOLTAGE_V"
        )
    table = _table_points(own)
    return LoopProfile(
        firmware="st",
        version=found.version,
        current=_current(found, found.current_q, drive.t_s, drive.v_dc),
        speed=_speed(found),
        observer=_flux_observer(own),
        reference="id-zero" if not table else "table",
        sources=SOURCES,
        table=table,
    )


def _table_points(own: Mapping[str, OwnValue]) -> tuple[tuple[float, float, float], ...]:
    """Ends of the segments as (command, i_d, i_q) in A."""
    full, top = current_scale(own), amperes(own, "IQMAX_A")
    width, slopes, offsets = (
        number(own, "SEGDIV"),
        integers(own.get("ANGC")),
        integers(own.get("OFST")),
    )
    if full is None or not top or not width or slopes is None or offsets is None:
        return ()
    if len(slopes) != SEGMENTS or len(offsets) != SEGMENTS:
        return ()
    edges = np.arange(1, SEGMENTS) * int(width)
    last = max(1, round(top * FULL / full))
    counts = np.unique([0, *edges[edges < last], last])
    i_d = table_currents(int(width), slopes, offsets, counts) * full / FULL
    i_q = counts * full / FULL
    return tuple(zip(i_q.tolist(), i_d.tolist(), i_q.tolist(), strict=True))


def _current(found: Configuration, q: PiGains, t_s: float, v_dc: float) -> CurrentLoops:
    d, limit = found.current_d or q, linear_voltage(v_dc)
    forward = number(found.own, "CONSTANT2_QD") is not None
    order: LimitOrder = "vector" if found.version == "5" else "d-first"
    return CurrentLoops(
        PiController(d.kp, d.ki, t_s, "integral-first", "clamp", limit),
        PiController(q.kp, q.ki, t_s, "integral-first", "clamp", limit),
        delay=1.0,
        cross=forward,
        back_emf=forward,
        order=order,
        angle_advance=number(found.own, "REV_PARK_ANGLE_COMPENSATION_FACTOR") or 0.0,
    )


def _speed(found: Configuration) -> SpeedController | None:
    gains, period = found.speed, found.drive.t_speed
    if gains is None or period is None:
        return None
    limit = amperes(found.own, "IQMAX_A") or found.drive.i_max
    controller = PiController(gains.kp, gains.ki, period, "integral-first", "clamp", limit)
    return SpeedController(controller, _estimate(found, period))


def _estimate(found: Configuration, period: float) -> SpeedEstimate:
    own, t_s, low = found.own, found.drive.t_s or period, low_speed(found.own)
    loop = None if low is None else tracking(own, low)
    if loop is not None:
        averaged = int(number(own, "STO_FIFO_DEPTH_UNIT") or 64)
        return SpeedEstimate("pll", t_s, loop.kp, loop.ki, averaged=averaged, whole=True)
    depth = number(own, "ENC_AVERAGING_FIFO_DEPTH")
    if depth:
        return SpeedEstimate("difference", period, samples=int(depth))
    return SpeedEstimate("ideal", t_s)


def _flux_observer(own: Mapping[str, OwnValue]) -> FluxObserver | None:
    machine, f1 = observed_machine(own) or observed_machine(own, 1.0), number(own, "F1")
    if machine is None or not f1:
        return None
    slow = max(abs(pole) for pole in placed_poles(own, machine))
    warnings = []
    if slow >= 1.0:
        warnings.append(f"the observer is unstable: a pole at {slow:.4g} per period")
    low = low_speed(own)
    loop = None if low is None else tracking(own, low)
    if loop is not None:
        pole = loop.poles[0]
        warnings.append(
            f"at {in_rpm(loop.speed):.4g} rpm the phase-locked loop has poles at "
            f"{pole.real:.4g} {'+-' if pole.imag else 'and'} "
            f"{abs(pole.imag) if pole.imag else loop.poles[1].real:.4g}"
            f"{' j' if pole.imag else ''} rad/s; they are faster at higher speed"
        )
    rate = -math.log(min(max(slow, 1e-12), 1.0)) * machine.rate
    return FluxObserver("state observer with phase-locked loop", rate, tuple(warnings))


# What the MCSDK cannot hold of a design, with what it costs.

_SEEN = 1e-3  # Relative change of a gain from which on its rounding is told.
_BUILTIN = 0.02  # Relative difference of the inductances from which on two are missed.


def shortfalls(asked: Asked, found: Configuration) -> tuple[Shortfall, ...]:
    """Of a configuration that `configure` has made of what was asked."""
    return (
        *_inductances(asked),
        *_table(asked, found),
        *_rounding(asked, found),
        *_lacking_speed(asked, found),
        *_tracking(found),
    )


def _inductances(asked: Asked) -> Iterator[Shortfall]:
    l_d, l_q = asked.drive.l_d, asked.drive.l_q
    if l_d is None or not l_q or abs(l_d / l_q - 1.0) < _BUILTIN:
        return
    yield Shortfall(
        f"the headers hold one inductance, LS = L_q = {l_q:.4g} H: the observer takes it for both "
        f"axes, L_d = {l_d:.4g} H stands in the motor file alone; both current controllers have "
        "their own gains",
        (Price("inductance of the observer", l_q / l_d - 1.0, ""),),
    )


def _table(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    full, width = current_scale(found.own), number(found.own, "SEGDIV")
    slopes, offsets = integers(found.own.get("ANGC")), integers(found.own.get("OFST"))
    if full is None or not width or slopes is None or offsets is None:
        return
    price = table_price(asked, full, int(width), slopes, offsets)
    yield Shortfall(
        f"d current by eight segments of integers: off by at most {price.error:.1f} counts "
        f"({price.error_current:.3f} A) from the currents of least loss, the least that the format "
        f"permits; {100.0 * price.loss:.2g} % more copper loss at most",
        (
            Price("d current", price.error_current, "A"),
            Price("copper loss", price.loss, ""),
            Price("torque", price.torque, ""),
        ),
    )


def _rounding(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    pairs: list[tuple[str, PiGains | None, PiGains | None]] = [
        ("d current", asked.current_d, found.current_d),
        ("q current", asked.current_q, found.current_q),
        ("speed", asked.speed, found.speed),
    ]
    for name, wanted, made in pairs:
        if wanted is None or made is None:
            continue
        for gain, one, other in (("kp", wanted.kp, made.kp), ("ki", wanted.ki, made.ki)):
            off = 0.0 if one == 0.0 else other / one - 1.0
            if abs(off) > _SEEN:
                yield Shortfall(
                    f"{gain} of the {name} loop is {other:.4g} instead of {one:.4g}, rounded to "
                    "integers",
                    (Price(f"{gain} of the {name} loop", off, ""),),
                )


def _lacking_speed(asked: Asked, found: Configuration) -> Iterator[Shortfall]:
    if found.speed is None:
        return
    unit = in_rpm(SPEED_UNIT)
    yield Shortfall(
        f"the speed is controlled in steps of 0.1 Hz, {unit:g} rpm",
        (Price("speed", SPEED_UNIT, "rad/s"),),
    )
    wanted, made = asked.drive.t_speed, found.drive.t_speed
    if wanted is not None and made is not None and abs(made / wanted - 1.0) > _SEEN:
        yield Shortfall(
            f"the speed controller runs at {1.0 / made:g} Hz, a part of its timer of 2000 Hz, "
            f"instead of {1.0 / wanted:.5g} Hz",
            (Price("period of the speed controller", made - wanted, "s"),),
        )


def _tracking(found: Configuration) -> Iterator[Shortfall]:
    """A phase-locked loop that is faster than Workbench's, for the speed loop's sake."""
    own = found.own
    gain, top, rate = (
        number(own, "PLL_KP_GAIN"),
        number(own, "MAX_APPLICATION_SPEED_RPM"),
        control_rate(own),
    )
    pairs = number(own, "POLE_PAIR_NUM")
    if gain is None or top is None or rate is None or pairs is None:
        return
    usual = tracking_integers(int(pairs), top, rate)["PLL_KP_GAIN"]
    if usual and gain > 1.01 * usual:
        yield Shortfall(
            f"the speed loop needs PLL_KP_GAIN {gain:g} where Workbench has {usual}: the speed is "
            f"{gain / usual:.2g} times as noisy",
            (Price("noise of the speed", gain / usual - 1.0, ""),),
        )


# The table of currents of ST's MCSDK for the machine of a design, and what it costs.

_NEGLIGIBLE = 2.0  # Counts of i_d up to which no table is needed.


@dataclass(frozen=True, slots=True)
class TablePrice:
    """What a table of currents costs.

    Args:
        error, error_current: Largest deviation of i_d from the optimum in counts and in A.
        loss: Largest copper loss beyond the optimum for the same torque, relative.
        torque: Largest torque of the table below that of the optimum at the same current, relative.
    """

    error: float
    error_current: float
    loss: float
    torque: float


def locus_of(asked: Asked) -> MtpaLocus:
    """The optimal currents of the design's machine, up to its current limit."""
    return mtpa_locus(asked.design.machine, asked.design.i_max)


def table_for(asked: Asked, full_current: float) -> MtpaTable | None:
    """The table with the least largest error for the machine of a design, saturated or not.

    None where the design asks for no d current, or optimal d currents are too small to be seen.
    """
    machine = asked.design.machine
    if asked.design.strategy != "mtpa":
        return None
    if isinstance(machine, LinearMachine) and machine.l_d == machine.l_q:
        return None
    wanted = _wanted(asked, full_current)
    if wanted.size < 16 or float(np.max(np.abs(wanted))) < _NEGLIGIBLE:
        return None
    return fitted_table(wanted)


def _wanted(asked: Asked, full_current: float) -> FloatArray:
    """Optimal i_d in counts at every count of i_q."""
    locus = locus_of(asked)
    i_d, i_q = np.concatenate(([0.0], locus.i_d)), np.concatenate(([0.0], locus.i_q))
    return locus_counts(i_d, i_q, full_current)


def table_price(
    asked: Asked,
    full_current: float,
    width: int,
    slopes: tuple[int, ...],
    offsets: tuple[int, ...],
) -> TablePrice:
    """What a table costs on the machine of a design, at every count of its q current from a
    twentieth of the largest on.
    """
    wanted = _wanted(asked, full_current)
    counts = np.arange(wanted.size)
    count = full_current / FULL
    i_d = table_currents(width, slopes, offsets, counts).astype(np.float64) * count
    i_q = counts.astype(np.float64) * count
    error = float(np.max(np.abs(i_d * FULL / full_current - wanted)))
    part = counts >= wanted.size // 20
    machine = asked.design.machine
    torque = np.asarray(machine.torque(i_d[part], i_q[part]))
    square = i_d[part] ** 2 + i_q[part] ** 2
    # The optimum at every count, too: its points of the locus are too far apart for shares of 1e-4.
    best_d = wanted * full_current / FULL
    most = np.asarray(machine.torque(best_d, i_q))
    least = np.hypot(best_d, i_q)
    best = np.interp(torque, most, least)
    within = torque <= most[-1]
    loss = float(np.max(square[within] / best[within] ** 2, initial=1.0)) - 1.0
    at_current = np.interp(np.sqrt(square), least, most)
    lost = float(np.max(1.0 - torque / at_current, initial=0.0))
    return TablePrice(error, error * full_current / FULL, max(0.0, loss), max(0.0, lost))


ST = FirmwareMethod("st", VERSION, "axes", configure, profile, shortfalls, needs=(CURRENT_SENSING,))
