"""NXP's motor control (MCAT): its configuration for a design, and the loops that it then runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    OwnValue,
    PiController,
    PiGains,
    PiRule,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    MAX_SPEED,
    NOTICED,
    Asked,
    FirmwareMethod,
    Price,
    Shortfall,
    needed,
    q_current_alone,
)
from dqforge.optimizer.firmware.mcat_numbers import (
    EDITIONS,
    FIXED_2022,
    FLOAT_2025,
    FRACTION_BITS,
    MCAT_ROOT_3,
    SPEED_I,
    SPEED_P,
    TURN,
    Edition,
    constants,
    printed,
)
from dqforge.optimizer.firmware.mcat_sheet import ROOT_3, McatFile, McatSheet, kind_of

_HOME = "nxp-mcuxpresso/mcux-motor_control"

SOURCES = (
    f"{_HOME} pmsm/pmsm_float/mc_algorithms/pmsm_control.c: current and speed control",
    f"{_HOME} pmsm/pmsm_frac/mc_algorithms/pmsm_control.c: the same in fractions",
    f"{_HOME} pmsm/pmsm_float/mc_state_machine/m1_sm_snsless_enc.c: filters and periods",
    f"{_HOME} freemaster/pmsm_float and pmsm_frac, mcat.js: rules for the constants",
)


def configure(asked: Asked) -> Configuration:
    """The configuration for a design: MCAT of 2025, in float or in fixed point.

    Fixed point where the gains of the current loop are asked for in integers
    (``control.current_loop.q_formats``).

    Raises:
        InputError: A value that MCAT needs is missing, or does not fit its integers; with its key.
    """
    return configured(asked, edition_for(asked))


def edition_for(asked: Asked) -> Edition:
    """Which arithmetic the design asks for."""
    loop = asked.design.control.current_loop
    return FLOAT_2025 if loop.q_formats is None else FIXED_2022


def configured(asked: Asked, edition: Edition) -> Configuration:
    """The configuration for a design in the format of one age.

    Args:
        asked: The design and its gains.
        edition: The age of the format, and its arithmetic.
    """
    newest = FIXED_2022 if edition.fixed else FLOAT_2025
    made = McatFile(asked.design.name, newest, own_values(asked, newest))
    return made.in_edition(edition.version).configuration()


def profile(found: Configuration) -> LoopProfile:
    """The loops that NXP's motor control runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    sheet = McatSheet(EDITIONS[found.version], found.own)
    axes = found.current_d, found.current_q
    if axes[0] is None or axes[1] is None or sheet.t_s is None:
        missing = "period of the current loop" if sheet.t_s is None else "gains of both axes"
        raise InputError(
            f"the configuration of NXP has no {missing}; keep M1_D_KP_GAIN to M1_Q_KI_GAIN and the "
            f"inputs (or M1_TO_THETA_GAIN) in the file"
        )
    return LoopProfile(
        firmware="nxp",
        version=found.version,
        current=_current(axes[0], axes[1], sheet, sheet.t_s),
        speed=_speed(found, sheet, sheet.t_s),
        observer=_observer(sheet),
        sources=SOURCES,
    )


def _rule(share: float) -> PiRule:
    return "trapezoid" if share == 0.5 else "integral-first"


def _current(d: PiGains, q: PiGains, sheet: McatSheet, t_s: float) -> CurrentLoops:
    """The d axis limited first, q to what it leaves; integrals are held to these limits."""
    rule = _rule(sheet.edition.current_share)
    share = sheet.constant("M1_CLOOP_LIMIT")
    if share is not None and not sheet.edition.fixed:
        share *= ROOT_3
    return CurrentLoops(
        d=PiController(d.kp, d.ki, t_s, rule),
        q=PiController(q.kp, q.ki, t_s, rule),
        delay=1.0,
        order="d-first",
        voltage_share=0.9 if share is None else min(1.0, share),
    )


def _speed(found: Configuration, sheet: McatSheet, t_s: float) -> SpeedController | None:
    """The speed of the tracking observer through its filter, then through that of the slow loop."""
    period = sheet.t_speed
    if found.speed is None or period is None or not (found.speed.kp or found.speed.ki):
        return None
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        period,
        _rule(sheet.edition.speed_share),
        limit=found.drive.i_max,
        filter_time=_filter_time(sheet, "M1_SPEED_IIR", period),
    )
    return SpeedController(pi, _estimate(sheet, t_s), _ramp(sheet, period))


def _ramp(sheet: McatSheet, period: float) -> float | None:
    step, full, pairs = sheet.constant("M1_SPEED_RAMP_UP"), sheet.full_speed, sheet.pole_pairs
    return step * full / (pairs * period) if step and full and pairs else None


def _estimate(sheet: McatSheet, t_s: float) -> SpeedEstimate:
    """The tracking observer; its speed is the output of its PI controller."""
    k_p, k_i, full = sheet.shifted("M1_TO_KP"), sheet.shifted("M1_TO_KI"), sheet.full_speed
    if not k_p or not k_i or not full:
        return SpeedEstimate("ideal", t_s)
    return SpeedEstimate(
        "pll",
        t_s,
        kp=k_p * full,
        ki=k_i * full / t_s,
        filter_time=_filter_time(sheet, "M1_TO_SPEED_IIR", t_s),
        whole=True,
    )


def _filter_time(sheet: McatSheet, name: str, period: float) -> float:
    """Time constant in s of a bilinear filter that runs with a period."""
    b_0 = sheet.constant(f"{name}_B0")
    if not b_0:
        return 0.0
    b_0 *= 2.0 if sheet.edition.fixed else 1.0
    return max(0.0, period * (1.0 - b_0) / (2.0 * b_0))


def _observer(sheet: McatSheet) -> FluxObserver | None:
    """The observer of the back-EMF in estimated dq: a PI controller around L s + R."""
    k_p, k_i = sheet.constant("M1_BEMF_DQ_KP_GAIN"), sheet.constant("M1_BEMF_DQ_KI_GAIN")
    drive, t_s = sheet.drive(), sheet.t_s
    if not k_p or not k_i or not drive.l_d or drive.r_s is None or not t_s:
        return None
    scale = _emf_scale(sheet)
    half = 0.5 * (k_p * scale + drive.r_s) / drive.l_d
    inside = half * half - k_i * scale / t_s / drive.l_d
    rate = half - math.sqrt(inside) if inside > 0.0 else half
    return FluxObserver("back-EMF observer in estimated dq with tracking of the angle", rate)


def _emf_scale(sheet: McatSheet) -> float:
    """Volts of back-EMF per ampere of the scales: 1 of a float build."""
    if not sheet.edition.fixed:
        return 1.0
    full = sheet.number("M1_E_MAX") or sheet.number("parametersEmax")
    return (full or 1.0) / (sheet.amperes or 1.0)


# MCAT's inputs for a design, and the constants that its gains become.

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
        **_mcat_design_current(asked),
        **_mcat_design_speed(asked, edition),
        **_mcat_design_observer(asked),
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
    return torque_per_ampere(_pairs(drive), psi)


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
    values["parametersUphNom"] = linear_voltage(asked.design.inverter.v_dc)
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
        values["parametersEmax"] = values["parametersUdcbMax"] / MCAT_ROOT_3
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


def _mcat_design_current(asked: Asked) -> Values:
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


def _mcat_design_speed(asked: Asked, edition: Edition) -> Values:
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


def _mcat_design_observer(asked: Asked) -> Values:
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
    lead = "MCAT's control requests no d current"
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
        if wished is None or has is None:
            continue
        worst = _largest_error(wished, has)
        if worst > NOTICED:
            yield Shortfall(
                f"gains of the {of}: {has.kp:.5g} and {has.ki:.5g} run for {wished.kp:.5g} and "
                f"{wished.ki:.5g} that were requested, the closest in this format",
                (Price(f"gain of the {of}", worst, ""),),
            )


def _largest_error(wished: PiGains, has: PiGains) -> float:
    pairs = ((wished.kp, has.kp), (wished.ki, has.ki))
    return max((abs(is_now / was - 1.0) for was, is_now in pairs if was), default=0.0)


def _limit(asked: Asked, sheet: McatSheet) -> float:
    """Phase amplitude in V that the current loop may ask for."""
    share = (sheet.number("currentLoopOutputLimit") or 90.0) / 100.0
    return share * linear_voltage(asked.design.inverter.v_dc)


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


NXP = FirmwareMethod(
    "nxp", FLOAT_2025.version, "axes", configure, profile, shortfalls, needs=(MAX_SPEED,)
)
