"""MCAT's inputs for a design, and the constants that its gains become."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues, OwnValue, PiGains
from dqforge.optimizer.firmware.firmware_method import (
    NOTICED,
    Asked,
    Price,
    Shortfall,
    needed,
    q_current_alone,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import (
    EDITIONS,
    FLOAT_2025,
    FRACTION_BITS,
    ROOT_3,
    SPEED_I,
    SPEED_P,
    TURN,
    Edition,
    constants,
    printed,
)
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import McatSheet, kind_of

# Share of the linear range that MCAT leaves to the current loop: low-side shunts need the rest.
LARGEST_SHARE = 0.9
OVERSPEED = 1.1  # Trip of the speed over its largest value.

# Natural frequency of the tracking observer: that of the speed loop by this factor.
OBSERVER_SHARE = 8.0
MOST_ALIGN = 65535  # Largest count of a duration: 16 bits.
INPUT_DIGITS = 12  # Significant digits of the inputs: their constants have six.
Values = dict[str, float]


def own_values(asked: Asked, edition: Edition) -> dict[str, OwnValue]:
    """Inputs and constants for what is asked.

    Args:
        asked: The design and its gains.
        edition: The age of the format, and its arithmetic.

    Raises:
        InputError: A value that MCAT needs is missing, or a constant does not fit its integer; with
            its key.
    """
    inputs = _inputs(asked, edition)
    own: dict[str, OwnValue] = {**inputs, **constants(edition, inputs)}
    sheet = McatSheet(edition, own)
    own |= _gain_constants(asked, sheet)
    _check(sheet, own)
    return own


def _inputs(asked: Asked, edition: Edition) -> Values:
    drive = asked.drive
    found = {
        **_machine(asked, drive, edition),
        **_scales(asked, drive, edition),
        **_procedures(drive),
        **_current(asked),
        **_speed(asked, edition),
        **_observer(asked),
    }
    return {key: float(f"{value:.{INPUT_DIGITS}g}") for key, value in found.items()}


def _needed(value: float | None, key: str, what: str, otherwise: str = "give it") -> float:
    return needed(value, key, "MCAT", what, otherwise)


def _torque_constant(drive: DriveValues) -> float:
    psi = _needed(
        drive.psi_pm,
        "machine.magnet_flux",
        "the flux linkage of magnets, by which it finds the rotor",
        "a machine without any needs another firmware",
    )
    return 1.5 * _pairs(drive) * psi


def _pairs(drive: DriveValues) -> int:
    return int(_needed(drive.pole_pairs, "machine.pole_pairs", "the number of pole pairs"))


def _largest_speed(drive: DriveValues) -> float:
    return _needed(drive.omega_m_max, "machine.max_speed", "the largest speed") * 60.0 / TURN


def _machine(asked: Asked, drive: DriveValues, edition: Edition) -> Values:
    values = {
        "parametersPP": float(_pairs(drive)),
        "parametersRs": _needed(drive.r_s, "machine.resistance", "the resistance"),
        "parametersLd": _needed(drive.l_d, "machine.inductance_d", "both inductances"),
        "parametersLq": _needed(drive.l_q, "machine.inductance_q", "both inductances"),
    }
    values["parametersKt" if edition.fixed else "parametersKe"] = _torque_constant(drive)
    if drive.inertia:
        values["parametersJ"] = drive.inertia
    values["parametersIphNom"] = asked.design.i_max
    values["parametersUphNom"] = asked.design.inverter.v_dc / math.sqrt(3.0)
    values["parametersNnom"] = _largest_speed(drive)
    return values


def _scales(asked: Asked, drive: DriveValues, edition: Edition) -> Values:
    """Full scales: of the current measurement where it is known, else the per-unit bases."""
    design = asked.design
    sensing, v_dc = design.inverter.current_sensing, design.inverter.v_dc
    bases = design.control.bases
    amperes = bases.current if sensing is None else sensing.full_scale
    if amperes < design.i_max:
        raise InputError(
            f"{'control.per_unit.current' if sensing is None else 'inverter.current_sensing'}: a "
            f"full scale of {amperes:.4g} A does not hold the {design.i_max:.4g} A of the drive"
        )
    fastest = OVERSPEED * _largest_speed(drive)
    values = {
        "parametersImax": amperes,
        "parametersUdcbMax": max(math.sqrt(3.0) * bases.voltage, 1.5 * v_dc),
        "parametersUdcbTrip": 1.2 * v_dc,
        "parametersUdcbUnder": 0.65 * v_dc,
        "parametersUdcbOver": 1.3 * v_dc,
        "parametersNover": fastest,
        "parametersNmin": 0.05 * _largest_speed(drive),
        "parametersNmax": max(fastest, bases.speed * 60.0 / TURN),
    }
    if edition.fixed:
        values["parametersEmax"] = values["parametersUdcbMax"] / ROOT_3
    return values


def _procedures(drive: DriveValues) -> Values:
    """Durations, alignment, blocked rotor and scalar control: not asked for by a design."""
    e_m_f = _pairs(drive) * (drive.psi_pm or 0.0) * TURN / 60.0 * 0.05 * _largest_speed(drive)
    drop = (drive.r_s or 0.0) * (drive.i_max or 0.0)
    step = _needed(drive.t_s, "control.t_s", "the period of the current loop")
    return {
        "parametersEblock": 0.5 * e_m_f,
        "parametersEblockPer": 2000.0,
        "parametersUdcbIIRf0": min(100.0, 0.05 / step),
        "parametersCalibDuration": 0.2,
        "parametersFaultDuration": 2.0,
        "parametersFreewheelDuration": 1.5,
        "parametersScalarUqMin": 0.1 * drop,
        "parametersScalarVHzRatio": 100.0,
        "parametersAlignVoltage": 0.3 * drop,
        "parametersAlignDuration": min(0.4, step * math.floor(MOST_ALIGN)),
    }


def _current(asked: Asked) -> Values:
    """One natural frequency and one damping, those of the q axis."""
    drive, gains = asked.drive, asked.current_q
    l_q, r_s = drive.l_q or 0.0, drive.r_s or 0.0
    key = "control.current_loop"
    rate = math.sqrt(_needed(gains.ki, key, "an integral gain") / l_q)
    design = asked.design
    share = design.v_max * math.sqrt(3.0) / design.inverter.v_dc
    return {
        "currentLoopSampleTime": _needed(drive.t_s, "control.t_s", "the period of the loop"),
        "currentLoopF0": rate / TURN,
        "currentLoopKsi": (gains.kp + r_s) / (2.0 * rate * l_q),
        "currentLoopOutputLimit": 100.0 * min(LARGEST_SHARE, share),
    }


def _speed(asked: Asked, edition: Edition) -> Values:
    """The speed loop by natural frequency and damping where the inertia is known."""
    drive = asked.drive
    period = drive.t_speed or 10.0 * (drive.t_s or 0.0)
    values = {
        "speedLoopSampleTime": period,
        "speedLoopIncUp": _slope(asked),
        "speedLoopIncDown": _slope(asked),
        "speedLoopCutOffFreq": _cutoff(asked, period),
        "speedLoopUpperLimit": asked.design.i_max,
        "speedLoopLowerLimit": -asked.design.i_max,
        "speedLoopManualConstantTunning": 1.0,
    }
    gains = asked.speed
    if gains is None:
        return values | {"speedLoopSLKp": 0.0, "speedLoopSLKi": 0.0}
    pairs, torque = _pairs(drive), _torque_constant(drive)
    share = 1.0 if edition.fixed else edition.speed_share * period
    values["speedLoopSLKp"] = gains.kp / pairs
    values["speedLoopSLKi"] = gains.ki / pairs * share
    if drive.inertia and gains.ki > 0.0:
        rate = math.sqrt(gains.ki * torque / drive.inertia)
        values["speedLoopF0"] = rate / TURN
        values["speedLoopKsi"] = gains.kp * torque / (2.0 * rate * drive.inertia)
        values["speedLoopManualConstantTunning"] = float(edition is not FLOAT_2025)
    return values


def _slope(asked: Asked) -> float:
    """Slope of the speed reference in rpm/s: half of what the current limit can make."""
    drive = asked.drive
    if not drive.inertia:
        return _largest_speed(drive)
    return 0.5 * _torque_constant(drive) * asked.design.i_max / drive.inertia * 60.0 / TURN


def _speed_rate(asked: Asked) -> float:
    """Rate of the speed loop in rad/s: torque per speed error over the inertia."""
    gains, inertia = asked.speed, asked.drive.inertia
    if gains is None or not inertia:
        return TURN * 5.0
    return gains.kp * _torque_constant(asked.drive) / inertia


def _cutoff(asked: Asked, period: float) -> float:
    """Cut-off of the speed filter in Hz: well beyond the loop, and within its own sampling."""
    return min(max(100.0, 20.0 * _speed_rate(asked) / TURN), 0.2 / period)


def _observer(asked: Asked) -> Values:
    """Observer of the back-EMF as fast as the current loop, tracking of the angle behind it."""
    drive = asked.drive
    l_d, r_s, step = drive.l_d or 0.0, drive.r_s or 0.0, drive.t_s or 0.0
    rate = max(asked.current_q.kp / (drive.l_q or 1.0), r_s / l_d)
    if asked.pll is not None and asked.pll.ki > 0.0:
        tracking = math.sqrt(asked.pll.ki)
        ksi = asked.pll.kp / (2.0 * tracking)
    else:
        tracking = min(max(OBSERVER_SHARE * _speed_rate(asked), TURN * 20.0), 0.25 * rate)
        ksi = 1.0
    return {
        "sensorlessBemfObsrvF0": rate / TURN,
        "sensorlessBemfObsrvKsi": 1.0,
        "sensorlessTrackObsrvF0": tracking / TURN,
        "sensorlessTrackObsrvKsi": ksi,
        "sensorlessTrackObsrvIIRSpeedCutOff": min(max(400.0, 5.0 * tracking / TURN), 0.2 / step),
        "sensorlessStartupRamp": 0.5 * _slope(asked),
        "sensorlessStartupCurrent": 0.3 * asked.design.i_max,
        "sensorlessMergingSpeed": 0.1 * _largest_speed(drive),
        "sensorlessMergingCoeff": 100.0,
    }


def _gain_constants(asked: Asked, sheet: McatSheet) -> dict[str, OwnValue]:
    """Constants of the gains that are asked for: both axes, and the speed loop."""
    edition, volts, amperes = sheet.edition, sheet.volts or 1.0, sheet.amperes or 1.0
    scale = amperes / volts
    step = edition.current_share * (sheet.t_s or 0.0)
    own: Values = {}
    for axis, gains in (("D", asked.current_d), ("Q", asked.current_q)):
        own[f"M1_{axis}_KP_GAIN"] = gains.kp * scale
        own[f"M1_{axis}_KI_GAIN"] = gains.ki * scale * step
    speed = asked.speed or PiGains(0.0, 0.0)
    unit = (sheet.full_speed or 1.0) / (amperes * (sheet.pole_pairs or 1))
    own[SPEED_P] = speed.kp * unit
    own[SPEED_I] = speed.ki * unit * edition.speed_share * (sheet.t_speed or 0.0)
    return {name: printed(value) for name, value in own.items()}


def _check(sheet: McatSheet, own: Mapping[str, OwnValue]) -> None:
    """Refuse constants that the integers of a fixed-point build cannot hold."""
    if not sheet.edition.fixed:
        return
    for name, value in own.items():
        kind = kind_of(name, sheet.edition) if name.startswith("M1_") else ""
        if kind not in FRACTION_BITS or isinstance(value, str):
            continue
        largest = 65536.0 if kind == "ACC32" else 1.0
        if abs(value) > largest:
            raise InputError(
                f"control.per_unit: {name} would be {value:.4g}, and {kind} holds no more than "
                f"{largest:g}; raise the bases of current, voltage or speed"
            )


# What MCAT's file cannot hold of a design, or its firmware not run, and what that costs.


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    sheet = McatSheet(EDITIONS[held.version], held.own)
    return (
        *_currents(asked),
        *_inputs_of_d(sheet),
        *_integers(asked, held),
        *_voltage(asked, sheet),
        *_weakening(asked, sheet),
        *_decoupling(asked),
    )


def _currents(asked: Asked) -> Iterator[Shortfall]:
    lead = "MCAT's control asks for no d current"
    tail = (
        "; i_d from the header of current references has to be written to sIDQReq.fltD by the "
        "application"
    )
    return q_current_alone(asked, asked.drive.psi_pm or 0.0, lead, tail=tail)


def _inputs_of_d(sheet: McatSheet) -> Iterator[Shortfall]:
    """One F0 and ksi among the inputs; the constants hold both axes."""
    made = constants(sheet.edition, sheet.own)
    parts, prices = [], []
    for name in ("M1_D_KP_GAIN", "M1_D_KI_GAIN"):
        stands, other = sheet.number(name), made.get(name)
        if stands and other is not None and abs(other / stands - 1.0) > NOTICED:
            parts.append(f"{name} {other:.6g} instead of {stands:.6g}")
            prices.append(Price(name, other / stands - 1.0, ""))
    if parts:
        yield Shortfall(
            "the inputs in the comment have one F0 and ksi for two inductances: the constants hold "
            "the gains of both axes, but MCAT makes " + ", ".join(parts) + " once the file is "
            "loaded and saved there",
            tuple(prices),
        )


def _integers(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """What printing and, in fixed point, cutting off make of the gains."""
    for of, wished, has in (
        ("d axis", asked.current_d, held.current_d),
        ("q axis", asked.current_q, held.current_q),
        ("speed loop", asked.speed, held.speed),
    ):
        worst = 0.0 if wished is None or has is None else _largest_error(wished, has)
        if wished is not None and has is not None and worst > NOTICED:
            yield Shortfall(
                f"gains of the {of}: {has.kp:.5g} and {has.ki:.5g} run for {wished.kp:.5g} and "
                f"{wished.ki:.5g} that were asked for: the integers of the format are that coarse",
                (Price(f"gain of the {of}", worst, ""),),
            )


def _largest_error(wished: PiGains, has: PiGains) -> float:
    pairs = ((wished.kp, has.kp), (wished.ki, has.ki))
    return max((abs(is_now / was - 1.0) for was, is_now in pairs if was), default=0.0)


def _limit(asked: Asked, sheet: McatSheet) -> float:
    """Phase amplitude in V that the current loop may ask for."""
    share = (sheet.number("currentLoopOutputLimit") or 90.0) / 100.0
    return share * asked.design.inverter.v_dc / math.sqrt(3.0)


def _voltage(asked: Asked, sheet: McatSheet) -> Iterator[Shortfall]:
    limit, counted = _limit(asked, sheet), asked.design.v_max
    lost = 1.0 - limit / counted
    if lost > NOTICED:
        yield Shortfall(
            f"M1_CLOOP_LIMIT lets the current loop ask for {limit:.4g} V of the {counted:.4g} V "
            f"that the design counts on: shunts in the low side need the rest of the period; raise "
            f"currentLoopOutputLimit where the currents are measured otherwise",
            (Price("voltage", lost, ""),),
        )


def _weakening(asked: Asked, sheet: McatSheet) -> Iterator[Shortfall]:
    """No field weakening: the speed ends where the back-EMF meets the limit."""
    drive, limit = asked.drive, _limit(asked, sheet)
    if not drive.omega_m_max or not drive.pole_pairs or not drive.psi_pm:
        return
    reached = limit / (drive.pole_pairs * drive.psi_pm)
    if reached < drive.omega_m_max:
        yield Shortfall(
            f"the file holds no field weakening: the back-EMF meets the limit of {limit:.4g} V at "
            f"{reached:.4g} rad/s, before the largest speed of {drive.omega_m_max:.4g} rad/s",
            (Price("speed", 1.0 - reached / drive.omega_m_max, ""),),
        )


def _decoupling(asked: Asked) -> Iterator[Shortfall]:
    """No feedforward between the axes: what their integrals carry at the largest speed."""
    drive = asked.drive
    if not drive.omega_m_max or not drive.pole_pairs or not drive.l_q:
        return
    volts = drive.omega_m_max * drive.pole_pairs * drive.l_q * asked.design.i_max
    rate = min(gains.ki / gains.kp for gains in (asked.current_d, asked.current_q) if gains.kp)
    if volts > 0.05 * asked.design.v_max:
        yield Shortfall(
            f"the axes are not decoupled: a step of {asked.design.i_max:.4g} A in q current brings "
            f"{volts:.4g} V into the d axis at the largest speed, which its integral takes up at "
            f"{rate:.4g} rad/s",
            (Price("voltage between the axes", volts, "V"),),
        )
