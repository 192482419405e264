"""TI's universal motor control lab: a motor block for a design, and the loops that it then runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware import firmware_method
from dqforge.optimizer.firmware.configuration import (
    AntiWindup,
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    Number,
    Origin,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    FLOAT32_DIGITS,
    INERTIA,
    Asked,
    FirmwareMethod,
    Price,
    Shortfall,
    closed_form_currents,
    field_origins,
    float32_value,
    needed,
    other_periods,
    rounded,
)

# The macros of a motor in TI's universal motor control lab that a design decides, or that its
# loops depend on.
#
# Names and units are those of ``user_mtr1.h`` (TexasInstruments/motor-control-sdk,
# tidm_02018_universal_motorcontrol); a name ends in the unit of its value.

FIRMWARE = "TI's lab"  # Its name in messages.
VERSION = "universal lab 2024"
OLDER_LAB = "universal lab 3.03"
INSTASPIN = "user.h of InstaSPIN"

# Who says a value: the design itself, a rule for starting the motor, or the gains.
Decided = Literal["design", "start", "gains"]


@dataclass(frozen=True, slots=True)
class Key:
    """One macro: its name, whether it is a whole number, who decides it, and what it means."""

    name: str
    kind: Literal["whole", "real", "word"]
    decided: Decided
    says: str


# fmt: off
_MOTOR = (
    Key("TYPE", "word", "design", "a machine with permanent magnets"),
    Key("NUM_POLE_PAIRS", "whole", "design", "pole pairs"),
    Key("Rr_Ohm", "real", "design", "rotor resistance: none"),
    Key("Rs_Ohm", "real", "design", "resistance of a phase"),
    Key("Ls_d_H", "real", "design", "inductance of a phase, d axis"),
    Key("Ls_q_H", "real", "design", "inductance of a phase, q axis"),
    Key("RATED_FLUX_VpHz", "real", "design", "2 pi times the flux linkage (peak of phase)"),
    Key("MAGNETIZING_CURRENT_A", "real", "design", "magnetising current: none"),
    Key("MAX_CURRENT_A", "real", "design", "largest current, peak of phase"),
    Key("OVER_CURRENT_A", "real", "design", "current that trips: 125 % of the largest"),
    Key("INERTIA_Kgm2", "real", "design", "moment of inertia"),
    Key("RATED_VOLTAGE_V", "real", "design", "voltage of the dc link"),
    Key("FREQ_MAX_Hz", "real", "design", "largest electrical frequency"),
    Key("RES_EST_CURRENT_A", "real", "start", "for measuring the resistance: 10 % of the largest"),
    Key("IND_EST_CURRENT_A", "real", "start", "for measuring the inductance: minus 10 %"),
    Key("FLUX_EXC_FREQ_Hz", "real", "start", "for measuring the flux: 10 % of it"),
    Key("FREQ_MIN_Hz", "real", "start", "least frequency: 1.5 % of the largest"),
    Key("FREQ_LOW_Hz", "real", "start", "V/f profile, level 2: 10 %"),
    Key("FREQ_HIGH_Hz", "real", "start", "V/f profile: 100 %"),
    Key("VOLT_MIN_V", "real", "start", "V/f profile: 15 % of the peak phase voltage"),
    Key("VOLT_MAX_V", "real", "start", "V/f profile: 100 % of it"),
    Key("FORCE_DELTA_A", "real", "start", "step of current in forced rotation: 1 %"),
    Key("ALIGN_DELTA_A", "real", "start", "step of the current while aligning: 0.2 %"),
    Key("FLUX_CURRENT_A", "real", "start", "d current in forced rotation: 10 %"),
    Key("ALIGN_CURRENT_A", "real", "start", "current that aligns the rotor: 25 %"),
    Key("STARTUP_CURRENT_A", "real", "start", "current until the speed is SPEED_START: 50 %"),
    Key("TORQUE_CURRENT_A", "real", "start", "current of the torque mode: 50 %"),
    Key("SPEED_START_Hz", "real", "start", "speed of closed loops: 6 % of the largest frequency"),
    Key("SPEED_FORCE_Hz", "real", "start", "forced rotation: 5 %"),
    Key("ACCEL_START_Hzps", "real", "start", "slope of forced rotation: 5 % per second"),
    Key("ACCEL_MAX_Hzps", "real", "start", "slope of the speed reference: 100 % per second"),
    Key("SPEED_FS_Hz", "real", "start", "flying start: 0.5 %"),
    Key("SPEED_LPF_FC_Hz", "real", "start", "corner of the filter on the speed (eSMO)"),
    Key("GAIN_SPEED_LOW_Hz", "real", "start", "below it the LOW gains of the speed: 10 %"),
    Key("GAIN_SPEED_HIGH_Hz", "real", "start", "above it the HIGH gains: 50 %"),
    Key("GAIN_IQ_LOW_A", "real", "start", "below it the LOW gains of the q current: 10 %"),
    Key("GAIN_IQ_HIGH_A", "real", "start", "above it the HIGH gains: 50 %"),
    *(
        Key(f"{gain}_{loop}_{where}SF", "real", "gains", f"{words} of TI's own gain")
        for loop, places, words in (
            ("ID", ("",), "d current: multiple"),
            ("IQ", ("START_", "LOW_", "HIGH_"), "q current: multiple"),
            ("SPD", ("START_", "LOW_", "HIGH_"), "speed: multiple"),
        )
        for where in places
        for gain in ("KP", "KI")
    ),
)
_BOARD = (
    Key("NOMINAL_DC_BUS_VOLTAGE_V", "real", "design", "voltage of the dc link"),
    Key("PWM_FREQ_kHz", "real", "design", "PWM frequency"),
    Key("NUM_PWM_TICKS_PER_ISR_TICK", "whole", "design", "PWM periods per control step: 1, 2 or 3"),
    Key("NUM_ISR_TICKS_PER_SPEED_TICK", "whole", "design", "control steps per speed step"),
    Key("MAX_VS_MAG_PU", "real", "design", "largest voltage over that of the dc link: 1/sqrt(3)"),
    Key("ADC_FULL_SCALE_CURRENT_A", "real", "design", "current over all codes of the converter"),
)
# fmt: on

MOTOR_PREFIX = "USER_MOTOR1_"
BOARD_PREFIX = "USER_M1_"

# What `configure` writes, by the name of the macro, in the order of the file.
KEYS: Mapping[str, Key] = {
    f"{prefix}{key.name}": Key(f"{prefix}{key.name}", key.kind, key.decided, key.says)
    for prefix, keys in ((MOTOR_PREFIX, _MOTOR), (BOARD_PREFIX, _BOARD))
    for key in keys
}

# What is read beside that, to hold it against the rest.
READ_ONLY: Mapping[str, Key] = {
    "USER_MOTOR1_RATED_SPEED_KRPM": Key(
        "USER_MOTOR1_RATED_SPEED_KRPM", "real", "design", "rated speed"
    )
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, FLOAT32_DIGITS)


def kept(value: float, asked_by: str) -> float:
    """A value as the file holds it; raises InputError, naming the key of the design, where a
    float32 cannot.
    """
    return float32_value(value, asked_by, FIRMWARE)


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A value of the motor (``Rs_Ohm``) or the board (``M1_...``) as a number, None without one."""
    full = f"USER_{name}" if name.startswith("M1_") else MOTOR_PREFIX + name
    return firmware_method.number(own, full)


def known(own: Mapping[str, OwnValue], name: str, otherwise: Number) -> float:
    """As `number`, with TI's own value where the file is silent."""
    value = number(own, name)
    return float(otherwise) if value is None else value


# What the macros of a motor of TI's universal lab amount to in SI units: machine, and the gains
# that its ``setupControllers`` makes of them.

TWO_PI = 2.0 * math.pi

# Share of R/L that ``setupControllers`` takes as the integral gain of the series form.
INTEGRAL_SHARE = 0.25
SPEED_TICKS = 10  # Control steps per step of the speed controller where the file does not say.

CONVENTIONS = (
    "the unit of a value stands in the name of its macro",
    "resistance and inductances are those of one phase of the star, currents are peak values",
    "RATED_FLUX_VpHz is 2 pi times the flux linkage of the magnets (peak of phase)",
    "frequencies are electrical: pole pairs times mechanical ones",
    "the firmware works out its gains: kp = BWc L, integral gain of the series form R/L Ts/4",
    "its speed controller takes Hz, its gain is meant for rad/s: it is p/(2 pi) times as fast",
    "KP_..._SF and KI_..._SF multiply these gains where MOTOR1_PI_TUNE is defined",
)


@dataclass(frozen=True, slots=True)
class Bandwidths:
    """What ``USER_setMotor1Params`` has as constants: crossover in rad/s, and the ratio by which
    the speed loop is slower.
    """

    current: float
    delta: float


BANDWIDTHS = {
    VERSION: Bandwidths(TWO_PI * 200.0, 20.0),
    OLDER_LAB: Bandwidths(TWO_PI * 400.0, 10.0),
}


def current_rule(r_s: float, inductance: float, bandwidth: float) -> PiGains:
    """TI's gains of a current controller, of the parallel form.

    Args:
        r_s, inductance: Resistance in ohm and inductance in H of a phase.
        bandwidth: BWc in rad/s.
    """
    kp = bandwidth * inductance
    return PiGains(kp, kp * INTEGRAL_SHARE * r_s / inductance)


def speed_rule(pole_pairs: int, psi_pm: float, inertia: float, bandwidths: Bandwidths) -> PiGains:
    """TI's gains of the speed controller as they act: in A s/rad and A/rad (mechanical).

    The rule makes a gain per rad/s, the controller is given electrical Hz.

    Args:
        pole_pairs, psi_pm, inertia: Pole pairs, flux linkage in Wb, inertia in kg m^2.
        bandwidths: The constants of the firmware.
    """
    acceleration = torque_per_ampere(pole_pairs, psi_pm) / inertia
    per_hertz = bandwidths.current / (bandwidths.delta * acceleration)
    kp = per_hertz * pole_pairs / TWO_PI
    return PiGains(kp, kp * bandwidths.current / bandwidths.delta**2)


def scaled(rule: PiGains, kp: float, ki: float) -> PiGains:
    """Gains of the series form with other factors: that of kp multiplies the integral, too."""
    return PiGains(rule.kp * kp, rule.ki * kp * ki)


def configuration(
    name: str,
    own: Mapping[str, OwnValue],
    origins: Mapping[str, Origin] | None = None,
    version: str = VERSION,
) -> Configuration:
    """A configuration from the macros of a motor.

    Args:
        name: Name of the motor.
        own: Values by macro, of those of `ti_keys`.
        origins: Where they stand, by macro; None where no file was read.
        version: Of the lab: its constants differ.
    """
    drive, bandwidths = _drive(own), BANDWIDTHS.get(version)
    d = q = speed = None
    if bandwidths is not None and drive.r_s is not None:
        if drive.l_d:
            d = _scaled(current_rule(drive.r_s, drive.l_d, bandwidths.current), own, "ID_", version)
        if drive.l_q:
            rule = current_rule(drive.r_s, drive.l_q, bandwidths.current)
            q = _scaled(rule, own, "IQ_HIGH_", version)
    if bandwidths is not None and drive.pole_pairs and drive.psi_pm and drive.inertia:
        rule = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, bandwidths)
        speed = _scaled(rule, own, "SPD_HIGH_", version)
    return Configuration(
        firmware="ti",
        version=version,
        name=name,
        drive=drive,
        current_d=d,
        current_q=q,
        speed=speed,
        own=dict(own),
        origins={} if origins is None else _origins(origins, version),
        conventions=CONVENTIONS if version == VERSION else CONVENTIONS[:-1],
        contradictions=contradictions(name, own, drive),
    )


def _scaled(rule: PiGains, own: Mapping[str, OwnValue], which: str, version: str) -> PiGains:
    if version != VERSION:
        return rule
    return scaled(rule, known(own, f"KP_{which}SF", 1.0), known(own, f"KI_{which}SF", 1.0))


def _positive(value: float | None) -> float | None:
    """None where a macro holds a stand-in such as 0 for what was not identified."""
    return value if value is not None and value > 0.0 else None


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs = number(own, "NUM_POLE_PAIRS")
    flux = _positive(number(own, "RATED_FLUX_VpHz"))
    most = _positive(number(own, "FREQ_MAX_Hz"))
    pwm = _positive(number(own, "M1_PWM_FREQ_kHz"))
    ticks = known(own, "M1_NUM_PWM_TICKS_PER_ISR_TICK", 1)
    steps = known(own, "M1_NUM_ISR_TICKS_PER_SPEED_TICK", SPEED_TICKS)
    t_s = ticks / (1e3 * pwm) if pwm is not None and ticks >= 1 else None
    t_speed = t_s * steps if t_s is not None and steps >= 1 else None
    return DriveValues(
        pole_pairs=None if not pairs else int(pairs),
        r_s=_positive(number(own, "Rs_Ohm")),
        l_d=_positive(number(own, "Ls_d_H")),
        l_q=_positive(number(own, "Ls_q_H")),
        psi_pm=None if flux is None else flux / TWO_PI,
        inertia=_positive(number(own, "INERTIA_Kgm2")),
        i_max=_positive(number(own, "MAX_CURRENT_A")),
        omega_m_max=None if not pairs or not most else TWO_PI * most / pairs,
        v_dc=_positive(number(own, "M1_NOMINAL_DC_BUS_VOLTAGE_V")),
        f_sw=None if pwm is None else 1e3 * pwm,
        t_s=t_s,
        t_speed=t_speed,
    )


_FIELDS = {
    "pole_pairs": ("USER_MOTOR1_NUM_POLE_PAIRS", "as it is"),
    "r_s": ("USER_MOTOR1_Rs_Ohm", "as it is, ohm of a phase"),
    "l_d": ("USER_MOTOR1_Ls_d_H", "as it is, H of a phase"),
    "l_q": ("USER_MOTOR1_Ls_q_H", "as it is, H of a phase"),
    "psi_pm": ("USER_MOTOR1_RATED_FLUX_VpHz", "over 2 pi, Wb (peak of phase)"),
    "inertia": ("USER_MOTOR1_INERTIA_Kgm2", "as it is, kg m^2"),
    "i_max": ("USER_MOTOR1_MAX_CURRENT_A", "as it is, A (peak of phase)"),
    "omega_m_max": ("USER_MOTOR1_FREQ_MAX_Hz", "times 2 pi over pole pairs, rad/s (mechanical)"),
    "v_dc": ("USER_M1_NOMINAL_DC_BUS_VOLTAGE_V", "as it is, V"),
    "f_sw": ("USER_M1_PWM_FREQ_kHz", "times 1000, Hz"),
    "t_s": ("USER_M1_PWM_FREQ_kHz", "PWM periods per control step, s"),
    "t_speed": ("USER_M1_NUM_ISR_TICKS_PER_SPEED_TICK", "control steps, s"),
}

_OF_GAINS = {
    "current_d.kp": ("USER_MOTOR1_Ls_d_H", "times BWc and KP_ID_SF, V/A"),
    "current_d.ki": ("USER_MOTOR1_Rs_Ohm", "times BWc/4, KP_ID_SF and KI_ID_SF, V/(A s)"),
    "current_q.kp": ("USER_MOTOR1_Ls_q_H", "times BWc and KP_IQ_HIGH_SF, V/A"),
    "current_q.ki": ("USER_MOTOR1_Rs_Ohm", "times BWc/4 and both factors, V/(A s)"),
    "speed.kp": ("USER_MOTOR1_INERTIA_Kgm2", "BWc/(delta Kctrl) p/(2 pi) KP_SPD_HIGH_SF, A s/rad"),
    "speed.ki": ("USER_MOTOR1_INERTIA_Kgm2", "the same times BWc/delta^2 KI_SPD_HIGH_SF, A/rad"),
}


def _origins(found: Mapping[str, Origin], version: str) -> dict[str, Origin]:
    return field_origins(found, _FIELDS if version == INSTASPIN else _FIELDS | _OF_GAINS)


# What a motor block of TI's lab cannot hold of a design, and what that costs.

# Factors that TI's comments give; of the proportional gain of the speed up to 100.
_ADVISED = (0.1, 10.0)
_MOST_OF_SPEED = 100.0


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the block does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    return (
        *_fixed_bandwidth(asked, held),
        *_factors(held),
        *_currents(asked, held),
        *other_periods(asked, held, FIRMWARE),
        *_range(held),
        *_field_weakening(held),
    )


def _fixed_bandwidth(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """What runs where the factors are not compiled in: the firmware's own rule."""
    drive, own = held.drive, BANDWIDTHS.get(held.version)
    gains = held.current_q
    if own is None or gains is None or drive.r_s is None or drive.l_q is None:
        return
    rule = current_rule(drive.r_s, drive.l_q, own.current)
    if _alike(gains, rule):
        return
    prices = [
        Price(f"{of} of the firmware's own rule", its / ours - 1.0, "")
        for of, its, ours in (
            ("q gain", rule.kp, gains.kp),
            ("q integral gain", rule.ki, gains.ki),
        )
        if ours
    ]
    words = (
        f"TI's lab fixes its bandwidth at {own.current / (2.0 * math.pi):.4g} Hz and its integral "
        f"gain at R/(4 L) in code; the factors KP_..._SF and KI_..._SF make {gains.kp:.4g} V/A and "
        f"{gains.ki:.4g} V/(A s) of it only where the project defines MOTOR1_PI_TUNE and sets "
        f"flagEnableTuneController; without them the q axis runs {rule.kp:.4g} V/A and "
        f"{rule.ki:.4g} V/(A s)"
    )
    if asked.speed is not None and drive.pole_pairs and drive.psi_pm and drive.inertia:
        speed = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, own)
        prices.append(Price("speed gain of the firmware's own rule", _off(speed, asked.speed), ""))
        words += (
            f", the speed controller {speed.kp:.4g} A s/rad instead of {asked.speed.kp:.4g} A s/rad"
        )
    yield Shortfall(words, tuple(prices))


def _off(rule: PiGains, wished: PiGains) -> float:
    return rule.kp / wished.kp - 1.0


def _factors(held: Configuration) -> Iterator[Shortfall]:
    least, most = _ADVISED
    for name, value in held.own.items():
        if not name.endswith("_SF") or "_LOW_" in name or "_START_" in name:
            continue
        largest = _MOST_OF_SPEED if "KP_SPD" in name else most
        if isinstance(value, float) and not least <= value <= largest:
            yield Shortfall(
                f"{name} {value:.4g} is outside the {least:g} to {largest:g} that TI's file advises"
            )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = held.drive
    saliency = (drive.l_q or 0.0) - (drive.l_d or 0.0)
    lead = "TI's currents of most torque per ampere (MOTOR1_MTPA)"
    return closed_form_currents(asked, held, saliency, lead)


def _range(held: Configuration) -> Iterator[Shortfall]:
    """Where nothing is known of how currents are measured."""
    i_max = held.drive.i_max
    if i_max is None or number(held.own, "M1_ADC_FULL_SCALE_CURRENT_A") is not None:
        return
    yield Shortfall(
        f"the range of the measured currents is that of the board's block: for {i_max:.4g} A "
        f"USER_M1_ADC_FULL_SCALE_CURRENT_A must be at least {i_max / TRIP_SHARE:.4g} A; "
        f"inverter.current_sensing in the design writes it"
    )


def _field_weakening(held: Configuration) -> Iterator[Shortfall]:
    """Its field weakening turns the current by at most 15 deg as delivered."""
    flux, most = number(held.own, "RATED_FLUX_VpHz"), number(held.own, "FREQ_MAX_Hz")
    v_dc = held.drive.v_dc
    if not flux or not most or not v_dc:
        return
    reached = linear_voltage(v_dc) / flux
    if reached < most:
        yield Shortfall(
            f"the back-EMF at FREQ_MAX_Hz {most:.4g} Hz is above the voltage: without MOTOR1_FWC "
            f"the speed ends at {reached:.4g} Hz, with it the current turns by at most 15 deg "
            f"(USER_M1_FWC_MAX_ANGLE), which the block does not hold",
            (Price("speed", 1.0 - reached / most, ""),),
        )


def _alike(one: PiGains, other: PiGains) -> bool:
    kp, ki = (one.kp, other.kp), (one.ki, other.ki)
    return all(math.isclose(*pair, rel_tol=1e-4) for pair in (kp, ki))


# What in a motor block of TI's lab does not fit together.

# Share of the measured range above which the lab lets no over-current threshold go.
TRIP_SHARE = 0.475

# Inertia in kg m^2 of the Teknic M2310 in TI's file, which other blocks repeat.
TEKNIC_INERTIA = 7.06154e-6
_TOLERANCE = 0.05


def contradictions(name: str, own: Mapping[str, OwnValue], drive: DriveValues) -> tuple[str, ...]:
    """Sentences on values that do not fit together, with both numbers.

    Args:
        name: Name of the motor.
        own: Values by macro.
        drive: What they amount to.
    """
    return (
        *_voltage(own),
        *_contradicted_currents(own),
        *_speeds(own, drive),
        *_copied(name, drive),
    )


def _voltage(own: Mapping[str, OwnValue]) -> Iterator[str]:
    flux, most = number(own, "RATED_FLUX_VpHz"), number(own, "FREQ_MAX_Hz")
    rated = number(own, "RATED_VOLTAGE_V")
    if not flux or not most or not rated:
        return
    emf, available = flux * most, rated / math.sqrt(3.0)
    if emf > available:
        yield (
            f"at FREQ_MAX_Hz {most:g} Hz the magnets of RATED_FLUX_VpHz {flux:g} V/Hz induce "
            f"{emf:.4g} V (peak of phase), RATED_VOLTAGE_V {rated:g} V gives {available:.4g} V: "
            f"without field weakening the speed ends at {available / flux:.4g} Hz"
        )


def _contradicted_currents(own: Mapping[str, OwnValue]) -> Iterator[str]:
    most, trip = number(own, "MAX_CURRENT_A"), number(own, "OVER_CURRENT_A")
    scale = number(own, "M1_ADC_FULL_SCALE_CURRENT_A")
    if most and trip and trip < most:
        yield f"OVER_CURRENT_A {trip:g} A trips below the permitted MAX_CURRENT_A {most:g} A"
    if most and scale and most > TRIP_SHARE * scale:
        yield (
            f"MAX_CURRENT_A {most:g} A is above {TRIP_SHARE * scale:.4g} A, the 47.5 % of "
            f"ADC_FULL_SCALE_CURRENT_A {scale:g} A at which the lab trips at the latest"
        )


def _speeds(own: Mapping[str, OwnValue], drive: DriveValues) -> Iterator[str]:
    rated, most = number(own, "RATED_SPEED_KRPM"), number(own, "FREQ_MAX_Hz")
    if rated and most and drive.pole_pairs:
        needed = 1e3 * rated / 60.0 * drive.pole_pairs
        if needed > most * (1.0 + _TOLERANCE):
            yield (
                f"RATED_SPEED_KRPM {rated:g} is {needed:.4g} Hz with {drive.pole_pairs} pole "
                f"pairs, above FREQ_MAX_Hz {most:g} Hz"
            )


def _copied(name: str, drive: DriveValues) -> Iterator[str]:
    if drive.inertia is None or "teknic" in name.lower():
        return
    if math.isclose(drive.inertia, TEKNIC_INERTIA, rel_tol=1e-6):
        yield (
            f"INERTIA_Kgm2 {drive.inertia:g} is that of the Teknic M2310 in TI's file, which "
            f"other blocks repeat: the gain of the speed loop is proportional to it"
        )


# TI's universal motor control lab: a motor block for a design, and the loops that it then runs.

_LAB = "TexasInstruments/motor-control-sdk tidm_02018_universal_motorcontrol "
_OLDER = "anyway-blows/ti-c2000-motor-control-sdk 3.03 "

SOURCES = (
    _LAB + "motor_common.c: setupControllers, tuneControllerGains",
    _LAB + "user_mtr1.c USER_setMotor1Params: BWc 200 Hz, delta 20",
    _LAB + "motor1_drive.c motor1CtrlISR: series PI, d before q, no feedforward, speed in Hz",
    _LAB + "spdfr.h: speed as the filtered difference of the angle of the eSMO",
    _OLDER + "user_mtr1.c: BWc 400 Hz, delta 10",
    _OLDER + "pi.h: integral limited to the output's limits, before it is used",
)

VOLTAGE_PU = 0.66  # USER_M1_MAX_VS_MAG_PU of TI's file.
SPEED_CORNER = 200.0  # USER_MOTOR1_SPEED_LPF_FC_Hz of TI's file.
MOST_SPEED_TICKS = 65535

_START_OF_CURRENT = {
    "RES_EST_CURRENT_A": 0.1,
    "IND_EST_CURRENT_A": -0.1,
    "FORCE_DELTA_A": 0.01,
    "ALIGN_DELTA_A": 0.002,
    "FLUX_CURRENT_A": 0.1,
    "ALIGN_CURRENT_A": 0.25,
    "STARTUP_CURRENT_A": 0.5,
    "TORQUE_CURRENT_A": 0.5,
    "OVER_CURRENT_A": 1.25,
    "GAIN_IQ_LOW_A": 0.1,
    "GAIN_IQ_HIGH_A": 0.5,
}

_START_OF_FREQUENCY = {
    "FLUX_EXC_FREQ_Hz": 0.1,
    "FREQ_MIN_Hz": 0.015,
    "FREQ_LOW_Hz": 0.1,
    "FREQ_HIGH_Hz": 1.0,
    "SPEED_START_Hz": 0.06,
    "SPEED_FORCE_Hz": 0.05,
    "ACCEL_START_Hzps": 0.05,
    "ACCEL_MAX_Hzps": 1.0,
    "SPEED_FS_Hz": 0.005,
    "GAIN_SPEED_LOW_Hz": 0.1,
    "GAIN_SPEED_HIGH_Hz": 0.5,
}


def configure(asked: Asked) -> Configuration:
    """The configuration for a design: the factors on TI's own gains make those that are asked for.

    Raises:
        InputError: The design says too little of its machine, or has no magnet; with the key.
    """
    drive = asked.drive
    values: dict[str, OwnValue] = {"USER_MOTOR1_TYPE": "MOTOR_TYPE_PM"}
    values |= _machine(drive)
    values |= _timing(drive)
    values |= _ti_factors(asked)
    values |= _ti_range(asked)
    own = {name: values[name] for name in KEYS if name in values}
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that the lab runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    t_s = found.drive.t_s
    if found.current_d is None or found.current_q is None or t_s is None:
        missing = (
            "USER_M1_PWM_FREQ_kHz"
            if t_s is None
            else "resistance and inductances, or is of a lab whose constants are not known"
        )
        raise InputError(
            f"the motor of TI's lab has no {missing}, which its current loops need; name the whole "
            f"user_mtr1.h"
        )
    wind_up: AntiWindup = "hold" if found.version == VERSION else "clamp"
    salient = found.drive.l_d != found.drive.l_q
    return LoopProfile(
        firmware="ti",
        version=found.version,
        current=CurrentLoops(
            d=_current(found.current_d, t_s, wind_up),
            q=_current(found.current_q, t_s, wind_up),
            delay=1.0,
            order="d-first",
            voltage_share=_given(found, "M1_MAX_VS_MAG_PU", VOLTAGE_PU) * math.sqrt(3.0),
            modulation="dpwmmin" if found.version == VERSION else "svpwm",
        ),
        speed=_speed_loop(found, t_s, wind_up),
        observer=FluxObserver("eSMO"),
        reference="mtpa-linear" if salient else "id-zero",
        sources=SOURCES,
    )


def _needed(value: float | None, key: str, what: str, otherwise: str = "give it") -> float:
    return needed(value, key, FIRMWARE, what, otherwise)


def _magnets(drive: DriveValues) -> float:
    without = "a machine without any needs another firmware"
    return _needed(drive.psi_pm, "machine.magnet_flux", "the flux linkage of magnets", without)


def _machine(drive: DriveValues) -> dict[str, OwnValue]:
    if not drive.pole_pairs:
        raise InputError(
            "machine: TI's lab needs the number of pole pairs; give poles or pole_pairs"
        )
    r_s = _needed(drive.r_s, "machine.resistance", "a resistance")
    l_d = _needed(drive.l_d, "machine.inductance_d", "inductances")
    l_q = _needed(drive.l_q, "machine.inductance_q", "inductances")
    psi = _magnets(drive)
    inertia = _needed(drive.inertia, "machine.inertia", "an inertia for its speed controller")
    i_max = _needed(drive.i_max, "machine.max_current", "a largest current")
    v_dc = _needed(drive.v_dc, "inverter.v_dc", "the voltage of the dc link")
    most = linear_voltage(v_dc) / (TWO_PI * psi)
    if drive.omega_m_max:
        most = drive.omega_m_max * drive.pole_pairs / TWO_PI
    values: dict[str, float] = {
        "Rr_Ohm": 0.0,
        "Rs_Ohm": kept(r_s, "machine.resistance"),
        "Ls_d_H": kept(l_d, "machine.inductance_d"),
        "Ls_q_H": kept(l_q, "machine.inductance_q"),
        "RATED_FLUX_VpHz": kept(TWO_PI * psi, "machine.magnet_flux"),
        "MAGNETIZING_CURRENT_A": 0.0,
        "MAX_CURRENT_A": kept(i_max, "machine.max_current"),
        "INERTIA_Kgm2": kept(inertia, "machine.inertia"),
        "RATED_VOLTAGE_V": kept(v_dc, "inverter.v_dc"),
        "FREQ_MAX_Hz": kept(most, "machine.max_speed"),
        "VOLT_MIN_V": kept(0.15 * linear_voltage(v_dc), "inverter.v_dc"),
        "VOLT_MAX_V": kept(linear_voltage(v_dc), "inverter.v_dc"),
        "SPEED_LPF_FC_Hz": SPEED_CORNER,
    }
    values |= {
        name: kept(share * i_max, "machine.max_current")
        for name, share in _START_OF_CURRENT.items()
    }
    values |= {
        name: kept(share * most, "machine.max_speed") for name, share in _START_OF_FREQUENCY.items()
    }
    named: dict[str, OwnValue] = {f"{MOTOR_PREFIX}{name}": values[name] for name in values}
    named[f"{MOTOR_PREFIX}NUM_POLE_PAIRS"] = drive.pole_pairs
    named[f"{BOARD_PREFIX}NOMINAL_DC_BUS_VOLTAGE_V"] = kept(v_dc, "inverter.v_dc")
    named[f"{BOARD_PREFIX}MAX_VS_MAG_PU"] = kept(1.0 / math.sqrt(3.0), "inverter.v_dc")
    return named


def _timing(drive: DriveValues) -> dict[str, OwnValue]:
    """PWM periods per control step, 1 to 3, and control steps per step of the speed controller."""
    f_sw = _needed(drive.f_sw, "inverter.switching_frequency", "a PWM frequency")
    pwm = kept(1e-3 * f_sw, "inverter.switching_frequency")
    ticks = 1 if drive.t_s is None else min(max(round(drive.t_s * f_sw), 1), 3)
    steps = 10 if drive.t_speed is None else round(drive.t_speed * 1e3 * pwm / ticks)
    return {
        f"{BOARD_PREFIX}PWM_FREQ_kHz": pwm,
        f"{BOARD_PREFIX}NUM_PWM_TICKS_PER_ISR_TICK": ticks,
        f"{BOARD_PREFIX}NUM_ISR_TICKS_PER_SPEED_TICK": min(max(steps, 1), MOST_SPEED_TICKS),
    }


def _ti_range(asked: Asked) -> dict[str, OwnValue]:
    """What all codes of the converter amount to, where the design says how it measures."""
    sensing = asked.design.inverter.current_sensing
    if sensing is None:
        return {}
    scale = kept(sensing.reference / sensing.slope, "inverter.current_sensing")
    return {f"{BOARD_PREFIX}ADC_FULL_SCALE_CURRENT_A": scale}


def _ti_factors(asked: Asked) -> dict[str, OwnValue]:
    """Factors on the gains that the firmware works out; the same from low to high current or
    speed.
    """
    drive, own = asked.drive, BANDWIDTHS[VERSION]
    assert drive.r_s is not None
    assert drive.l_d is not None
    assert drive.l_q is not None
    rule_d = current_rule(drive.r_s, drive.l_d, own.current)
    rule_q = current_rule(drive.r_s, drive.l_q, own.current)
    key = "control.current_loop"
    values = _pair("ID", ("",), asked.current_d, rule_d, key)
    values |= _pair("IQ", ("START_", "LOW_", "HIGH_"), asked.current_q, rule_q, key)
    wished, rule = asked.speed, _speed_rule(drive, own)
    values |= _pair("SPD", ("START_", "LOW_", "HIGH_"), wished or rule, rule, "control.speed_loop")
    return values


def _speed_rule(drive: DriveValues, own: Bandwidths) -> PiGains:
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.inertia is not None
    return speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, own)


def _pair(
    loop: str, places: tuple[str, ...], wished: PiGains, rule: PiGains, key: str
) -> dict[str, OwnValue]:
    if not wished.kp > 0.0:
        raise InputError(f"{key}: TI's lab multiplies the integral by kp, which must not be 0")
    kp = kept(wished.kp / rule.kp, key)
    ki = kept(wished.ki / wished.kp / (rule.ki / rule.kp), key)
    return {
        f"{MOTOR_PREFIX}{gain}_{loop}_{place}SF": value
        for place in places
        for gain, value in (("KP", kp), ("KI", ki))
    }


def _given(found: Configuration, name: str, otherwise: float) -> float:
    """A positive value of the file, or TI's own."""
    value = known(found.own, name, otherwise)
    return value if value > 0.0 else otherwise


def _current(gains: PiGains, t_s: float, wind_up: AntiWindup) -> PiController:
    return PiController(gains.kp, gains.ki, t_s, rule="integral-first", anti_windup=wind_up)


def _speed_loop(found: Configuration, t_s: float, wind_up: AntiWindup) -> SpeedController | None:
    if found.speed is None or found.drive.t_speed is None:
        return None
    corner = _given(found, "SPEED_LPF_FC_Hz", SPEED_CORNER)
    slope, pairs = number(found.own, "ACCEL_MAX_Hzps"), found.drive.pole_pairs
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        found.drive.t_speed,
        rule="integral-first",
        anti_windup=wind_up,
        limit=found.drive.i_max,
    )
    estimate = SpeedEstimate("low-pass", t_s, filter_time=1.0 / (TWO_PI * corner))
    ramp = TWO_PI * slope / pairs if slope and pairs else None
    return SpeedController(pi, estimate, ramp)


TI = FirmwareMethod("ti", VERSION, "axes", configure, profile, shortfalls, needs=(INERTIA,))
